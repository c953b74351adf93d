"""Write the figures of the paper: ``python -m paper.figures [NAME ...] [--quality print]``."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib as mpl
import numpy as np

from paper.figures import FIGURES, QUALITIES, Made, make_figure

_RESOLUTION = {"draft": 150, "print": 300}  # pixels per inch


def main() -> None:
    """Write NAME.png, NAME.pdf and the values NAME.npz for each figure."""
    parser = argparse.ArgumentParser(prog="python -m paper.figures", description=main.__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(FIGURES))
    parser.add_argument("--quality", choices=QUALITIES, default="draft")
    parser.add_argument("--out", type=Path, default=Path("out/paper_figures"))
    chosen = parser.parse_args()
    unknown = [name for name in chosen.names if name not in FIGURES]
    if unknown:
        parser.error(f"unknown figure {unknown[0]!r}; choose from {', '.join(FIGURES)}")
    chosen.out.mkdir(parents=True, exist_ok=True)
    for name in chosen.names or FIGURES:
        write(chosen.out, name, make_figure(name, chosen.quality), _RESOLUTION[chosen.quality])
        print(chosen.out / f"{name}.png")


def write(folder: Path, name: str, made: Made, resolution: int) -> None:
    """Write the panels of a figure, and its values with descriptions."""
    stems = [f"{name}_{part}" if part else name for part in FIGURES[name].parts]
    with mpl.rc_context({"pdf.fonttype": 42}):  # embeds fonts, so that text can be searched
        for stem, figure in zip(stems, made.figures.values(), strict=True):
            figure.savefig(folder / f"{stem}.png", dpi=resolution)
            figure.set_layout_engine("none")  # keep the positions of panels, in half the time
            figure.savefig(folder / f"{stem}.pdf", dpi=resolution, metadata={"CreationDate": None})
    arrays = {name: values for name, (values, _) in made.values.items()}
    about = {name: text for name, (_, text) in made.values.items()}
    np.savez_compressed(folder / f"{name}.npz", metadata=json.dumps({"about": about}), **arrays)


if __name__ == "__main__":
    main()
