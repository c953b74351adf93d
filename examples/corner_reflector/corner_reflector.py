"""Radar cross section of a corner reflector by one, two and three reflections.

python corner_reflector.py [FOLDER]

A triangular trihedral, an open mesh with legs of 100 mm, at 77 GHz over azimuth, at an elevation of
35.26 degrees above one of its plates; azimuth 45 degrees is the axis. Writes corner_reflector.png,
and prints the values on the axis and 4 pi a^4/(3 lambda^2). Takes half a minute.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import numpy as np

import polywigner as pw

WAVELENGTH = 299_792_458 / 77e9
LEG = 0.1
MESH = Path(__file__).parent / "trihedral.obj"
ELEVATION = math.atan(1 / math.sqrt(2))
AZIMUTH = np.radians(np.arange(-30, 120.1, 0.25))


def main(folder: Path) -> None:
    body = pw.read_sheets(MESH, unit="mm")
    closed = 10 * math.log10(4 * math.pi * LEG**4 / (3 * WAVELENGTH**2))
    figure, axes = plt.subplots(figsize=(7.2, 4.0), layout="constrained")
    for bounces, colour, width in ((3, "#c23b22", 1.6), (2, "#1f77b4", 1.0), (1, "0.55", 1.0)):
        result = pw.rcs_pattern(
            body, WAVELENGTH, AZIMUTH, ELEVATION, polarisation="vv", bounces=bounces, progress=False
        )
        level = 10 * np.log10(np.maximum(result["rcs"].values[:, 0], 1e-9))
        name = {1: "one reflection", 2: "two", 3: "three"}[bounces]
        axes.plot(np.degrees(AZIMUTH), level, color=colour, lw=width, label=name)
        on_axis = level[np.abs(AZIMUTH - math.pi / 4).argmin()]
        print(f"{name:15} {on_axis:8.2f} dBsm on the axis")
    print(f"{'closed form':15} {closed:8.2f} dBsm")
    axes.axhline(closed, color="k", lw=0.7, ls=":")
    axes.text(-29, closed + 1, r"$4\pi a^4/(3\lambda^2)$", fontsize=9)
    axes.set_xlim(-30, 120)
    axes.set_ylim(-60, 20)
    axes.set_xticks(np.arange(-30, 121, 15))
    axes.set_xlabel("azimuth (degrees)")
    axes.set_ylabel("radar cross section, vv (dBsm)")
    axes.set_title("trihedral of 100 mm at 77 GHz, elevation 35.26°", fontsize=10)
    axes.grid(alpha=0.3, lw=0.5)
    axes.legend(frameon=False, loc="center", bbox_to_anchor=(0.5, 0.66))
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "corner_reflector.png", dpi=150)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A corner reflector by its reflections.")
    parser.add_argument("folder", nargs="?", type=Path, default=Path())
    main(parser.parse_args().folder)
