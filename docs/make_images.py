"""Make the pictures of the README and the examples: ``python docs/make_images.py [NAME ...]``.

Renders every example with its own settings (a few minutes), and reduces the results to what a page
needs: at most 860 pixels wide and 300 KiB.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

import polywigner as pw
from polywigner.cli import main as polywigner
from polywigner.figures import draw_projections

ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "examples"
IMAGES = Path(__file__).parent / "images"
WIDEST = 860  # pixels
LARGEST = 300  # KiB

CHEVRONS = EXAMPLES / "two_chevrons" / "chevrons.geojson"
COMMANDS = {
    "two_chevrons_transforms": ["transform", str(CHEVRONS), "--frequency", "94 GHz"],
    **{path.parent.name: ["render", str(path)] for path in sorted(EXAMPLES.glob("*/scene.xml"))},
}


def main(names: list[str]) -> None:
    IMAGES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in names or ["first_picture", "projections", *COMMANDS]:
            if name == "first_picture":
                made = first_picture(Path(folder))
            elif name == "projections":
                made = projections(Path(folder))
            else:
                made = Path(folder) / f"{name}.png"
                if polywigner([*COMMANDS[name], "--out", str(made)]) != 0:
                    sys.exit(f"{name} failed")
            reduce(made, IMAGES / f"{name}.png")


def first_picture(folder: Path) -> Path:
    script = EXAMPLES / "first_picture.py"
    environment = {**os.environ, "MPLBACKEND": "agg"}
    subprocess.run([sys.executable, str(script)], cwd=folder, env=environment, check=True)
    return folder / "wigner.png"


def projections(folder: Path) -> Path:
    chevrons = pw.shapes.chevron_pair(20e-3, 12e-3, 4e-3)
    figure = draw_projections(pw.projections(chevrons, "wigner", samples=257))
    figure.savefig(folder / "projections.png")
    return folder / "projections.png"


def reduce(source: Path, target: Path) -> None:
    with Image.open(source) as picture:
        colours = picture.convert("RGB")
    for width in range(min(WIDEST, colours.width), 0, -50):
        height = round(colours.height * width / colours.width)
        small = colours.resize((width, height), Image.Resampling.LANCZOS)
        # Six bits of each channel look like eight and compress better.
        small.point(lambda value: value & 0xFC | value >> 6).save(target, optimize=True)
        if target.stat().st_size <= LARGEST * 1024:
            break
    print(f"{target} ({target.stat().st_size / 1024:.0f} KiB)")


if __name__ == "__main__":
    main(sys.argv[1:])
