"""Accuracy of Wigner rays close to a square: the comparison of the paper, and improvements.

python near_field.py [--out FOLDER]

A uniform square of 10 mm at 94 GHz, on boresight from half a wavelength to fifty, and around it at
5, 10 and 30 wavelengths. Writes boresight.png and off_axis.png, and prints the differences from
Kirchhoff's exact field in dB.
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.errors import PolywignerWarning
from polywigner.figures import draw_lines
from polywigner.figures.levels import summary

WAVELENGTH = 299_792_458 / 94e9
SQUARE = pw.shapes.square(10e-3)

# Rays with the paper's obliquity, and with the obliquity of Kirchhoff's boundary condition.
RAYS: dict[str, dict[str, Any]] = {
    "paper": {"obliquity": "paper"},
    "matched": {"obliquity": "kirchhoff"},
}


def compared(place: Any, *others: str) -> Any:
    """Return fields by rays, by other methods, and last by Kirchhoff's integral."""
    result = place(method=(*others, "kirchhoff"))
    for name, how in RAYS.items():
        result[name] = place(method="wigner", **how)["wigner"]
    return result[[*RAYS, *others, "kirchhoff"]]


def boresight() -> Any:
    ends = [(0, 0, 0.5 * WAVELENGTH), (0, 0, 50 * WAVELENGTH)]
    return compared(
        lambda **how: pw.line(SQUARE, ends, 1486, WAVELENGTH, **how),
        "rayleigh-sommerfeld-1",
        "fraunhofer",
    )


def off_axis(distance: float) -> Any:
    theta = np.radians(np.linspace(-80, 80, 321))
    return compared(
        lambda **how: pw.hemisphere(SQUARE, distance * WAVELENGTH, theta, 0.0, WAVELENGTH, **how)
    )


def report(title: str, result: Any) -> None:
    print(f"{title}: largest and rms difference from Kirchhoff, where it is above -30 dB, in dB")
    for name, field in result.items():
        if name != "kirchhoff":
            apart = summary(field.values, result["kirchhoff"].values)
            print(f"  {name:24} {apart.largest:+8.3f}  {apart.rms:7.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path(), help="folder of the figures")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    # The first wavelengths show where rays fail.
    warnings.simplefilter("ignore", PolywignerWarning)

    axis = boresight()
    far = axis.where(axis["z"] >= 2.999 * WAVELENGTH, drop=True)
    report("boresight from 3 wavelengths on", far)
    title = "10 mm square, 94 GHz, boresight"
    draw_lines(axis, title=title).savefig(out / "boresight.png")

    arcs = {f"{distance} wavelengths": off_axis(distance) for distance in (5, 10, 30)}
    for name, result in arcs.items():
        report(name, result)
    title = "10 mm square, 94 GHz, plane through its centre and along two of its sides"
    draw_lines(arcs, floor_db=-45, title=title).savefig(out / "off_axis.png")
    for name in ("boresight.png", "off_axis.png"):
        print(out / name)


if __name__ == "__main__":
    main()
