"""``polywigner figures``: the figures of the paper, as pictures and as the numbers behind them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from polywigner.cli import output
from polywigner.errors import ArgumentError

if TYPE_CHECKING:
    from polywigner.figures.paper import Made, Quality


_RESOLUTION = {"draft": 150, "print": 300}  # pixels per inch


def figures(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME",
            help="render, amp_spec, indmk, marginals, xforms, projs, volrender, volrender_fdtd, "
            "compar, error, emitters, sampling, appendix (default: all).",
        ),
    ] = None,
    quality: Annotated[str, "draft, or print: more samples and pixels, several minutes."] = "draft",
    out: Annotated[str | None, "Folder to write to (default: figures)."] = None,
) -> None:
    """Regenerate the figures of the paper.

    Writes NAME.png, NAME.pdf and the numbers behind them, NAME.npz, for each.
    """
    from polywigner.execution.progress import progress_bar
    from polywigner.figures.paper import check_figures, make_figure

    chosen = check_figures(list(names or []), quality)
    folder = _folder(out)
    files = {name: _files(folder, name) for name in chosen}
    output.check_writable([path for paths in files.values() for path in paths])
    level: Quality = "draft" if quality == "draft" else "print"
    with progress_bar("figures", len(chosen)) as advance:
        for name in chosen:
            _write(files[name], make_figure(name, level), level)
            advance()


def _folder(out: str | None) -> Path:
    if out is None:
        return Path("figures")
    if not out.strip():
        raise ArgumentError(
            "expected --out to name a folder, got nothing; leave it out to write to figures/"
        )
    output.check_text("--out", out)
    folder = Path(out)
    if folder.exists() and not folder.is_dir():
        raise ArgumentError(f"expected --out to name a folder, got the file {out}; name another")
    return folder


def _files(folder: Path, name: str) -> tuple[Path, ...]:
    """A .png and a .pdf of each picture, and the .npz."""
    from polywigner.figures.paper import FIGURES

    stems = [f"{name}_{part}" if part else name for part in FIGURES[name].parts]
    pictures = (folder / f"{stem}{suffix}" for stem in stems for suffix in (".png", ".pdf"))
    return *pictures, folder / f"{name}.npz"


def _write(files: tuple[Path, ...], made: Made, quality: Quality) -> None:
    import matplotlib as mpl

    resolution = _RESOLUTION[quality]
    # The same input makes the same file; letters stay text that can be searched.
    with mpl.rc_context({"pdf.fonttype": 42}), output.writing(files) as partial:
        for k, figure in enumerate(made.figures.values()):
            figure.savefig(partial[2 * k], format="png", dpi=resolution)
            figure.set_layout_engine("none")  # panels stay where they are, in half the time
            figure.savefig(
                partial[2 * k + 1], format="pdf", dpi=resolution, metadata={"CreationDate": None}
            )
        arrays = {name: values for name, (values, _) in made.values.items()}
        about = {name: text for name, (_, text) in made.values.items()}
        output.write_arrays(partial[-1], arrays, {"about": about})
