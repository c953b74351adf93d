"""How far are Wigner rays from the diffraction integrals?

Tables in decibels against Rayleigh-Sommerfeld I and Kirchhoff, with rays of the same obliquity: on
boresight from 0.5 to 50 wavelengths, and over -80 to 80 degrees at 5, 10, 30 and 100 wavelengths,
as root mean square and largest value at points within 30 dB of the peak. References are boundary
integrals. --write updates recorded/propagation_tables.md.

    python benchmarks/propagation_tables.py [--write]
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.errors import PolywignerWarning

WAVELENGTH = 299_792_458 / 94e9
SIDE = 10e-3
CONDITIONS = {"rayleigh-sommerfeld-1": "RS-I", "kirchhoff": "Kirchhoff"}
BORESIGHT = (0.5, 1, 1.5, 2, 2.5, 3, 4, 5, 7, 10, 20, 50)
DISTANCES = (5, 10, 30, 100)
DEGREES = np.arange(-80, 81, 2.0)
SEEN = 1e-3  # relative to the peak
TOLERANCE = 1e-4  # of sums over points, below the errors of rays
PAGE = Path(__file__).resolve().parent / "recorded" / "propagation_tables.md"


def sources() -> dict[str, Any]:
    """Return sources about 10 mm wide at 94 GHz (three wavelengths), an array and two chevrons."""
    square = pw.shapes.square(SIDE)
    l_shape = [(-5, -5), (5, -5), (5, -1.5), (-1.5, -1.5), (-1.5, 5), (-5, 5)]
    chevron = pw.shapes.chevron(12e-3, 8e-3, 3e-3)
    pair = [*chevron.moved((-7e-3, 0)).rings, *chevron.moved((7e-3, 0)).rings]
    places = pw.arrays.grid_positions(4, 4, WAVELENGTH)
    phases = np.exp(2j * np.pi * places[:, 0] * np.sin(np.radians(20)) / WAVELENGTH)
    return {
        "square": square,
        "triangle": pw.shapes.triangle(SIDE, SIDE),
        "L": pw.Aperture(np.array(l_shape) * 1e-3),
        "chevrons": pw.Aperture(pair),
        "TE10 horn": square.with_illumination(pw.te_mode(SIDE, SIDE)),
        "array, 20 deg": pw.phased_array(pw.shapes.square(0.7 * WAVELENGTH), places, phases),
    }


def centre_of(source: Any) -> np.ndarray:
    outline = source.support if isinstance(source, pw.Array) else source
    return np.append(outline.centre, 0.0)


def decibels(source: Any, points: np.ndarray, condition: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of rays (n,), NaN for sums below zero, and the reference."""
    reference = pw.irradiance(source, points, WAVELENGTH, condition)
    rays = pw.irradiance(source, points, WAVELENGTH, obliquity=condition, tolerance=TOLERANCE)
    with np.errstate(invalid="ignore", divide="ignore"):
        return 10 * np.log10(rays / reference), reference


def on_boresight(source: Any, condition: str) -> np.ndarray:
    points = centre_of(source) + np.array([(0, 0, z * WAVELENGTH) for z in BORESIGHT])
    return decibels(source, points, condition)[0]


def off_axis(source: Any, condition: str, distance: float) -> np.ndarray:
    """Return the rms and the largest error (2,) over the cut phi = 0."""
    theta = np.radians(DEGREES)
    arc = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=-1)
    errors, reference = decibels(source, centre_of(source) + distance * WAVELENGTH * arc, condition)
    errors = abs(errors[reference > SEEN * reference.max()])
    return np.array([np.sqrt((errors**2).mean()), errors.max()])


def number(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.3f}" if abs(value) < 1 else f"{value:.2f}"


def boresight_table(condition: str) -> list[str]:
    heads = [f"{z:g}" for z in BORESIGHT]
    lines = [f"| source | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    for name, source in sources().items():
        errors = on_boresight(source, condition)
        lines.append(f"| {name} | {' | '.join(map(number, errors))} |")
    return lines


def off_axis_table(condition: str) -> list[str]:
    heads = [f"{d:g}" for d in DISTANCES]
    lines = [f"| source | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    for name, source in sources().items():
        result = [off_axis(source, condition, d) for d in DISTANCES]
        cells = [f"{number(rms)} ({number(largest)})" for rms, largest in result]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def page() -> str:
    lines = [
        "# Tables: Wigner rays against diffraction integrals",
        "",
        "These tables give the error of Wigner rays against exact diffraction integrals. Use them",
        "to decide how far from a source rays are good enough. The page on",
        "[fields at points](../../docs/propagation.md#wigner-rays) explains the results.",
        "",
        "Errors are in dB, for rays with the obliquity of the integral. A dash stands where a sum",
        "of rays is below zero. The frequency is 94 GHz (wavelength 3.19 mm). The sources are a",
        "10 mm square, a triangle and an L as wide, two chevrons (26 mm wide together), a square",
        "horn in TE10, and 4 x 4 patches of 0.7 wavelengths at a pitch of one, steered to 20",
        "degrees. This page is written by",
        "`benchmarks/propagation_tables.py --write`.",
    ]
    for condition, short in CONDITIONS.items():
        lines += ["", f"## {short}, on boresight, distance in wavelengths", ""]
        lines += boresight_table(condition)
        lines += ["", f"## {short}, over -80 to 80 degrees, distance in wavelengths", ""]
        lines += ["Root mean square (largest) where the integral is within 30 dB of its peak.", ""]
        lines += off_axis_table(condition)
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="write recorded/propagation_tables.md")
    options = parser.parse_args()
    warnings.simplefilter("ignore", PolywignerWarning)  # the tables show the errors of rays
    start = time.perf_counter()
    text = page()
    print(text)
    print(f"{time.perf_counter() - start:.1f} s")
    if options.write:
        PAGE.write_text(text, encoding="utf-8")
        print(f"wrote {PAGE.name}")


if __name__ == "__main__":
    main()
