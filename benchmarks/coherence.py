"""How many times slower is a partially coherent source than a coherent source?

python benchmarks/coherence.py

W of a square, a hexagon, a chevron and two chevrons at 4096 random points, and at one position on a
grid of 64 x 64 frequencies; the radiant intensity in 2000 directions, a mean over tilts; and the
irradiance of rays at 50 points. Both sources in turn. Coherence widths are relative to the side of
the source's bounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.transforms.wavefronts import TILT_ERROR, tilts_of

SIDE, WAVELENGTH = 10e-3, 3.2e-3
SOURCES = {
    "square": pw.shapes.square(SIDE),
    "hexagon": pw.shapes.regular_polygon(6, SIDE / 2),
    "chevron": pw.shapes.chevron(SIDE, 0.6 * SIDE, 0.2 * SIDE),
    "two chevrons": pw.shapes.chevron_pair(SIDE, 0.6 * SIDE, 0.2 * SIDE),
}
MOST_TILTS = 3000
SHARES = (3.0, 1.0, 0.3, 0.1, 0.03, 0.01)


def fastest(*calls: Callable[[], Any], rounds: int = 5) -> list[float]:
    """Return the shortest time of each call in s, of calls in turn."""
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(rounds + 1):
        for call, took in zip(calls, times, strict=True):
            start = time.perf_counter()
            call()
            took.append(time.perf_counter() - start)
    return [min(took[1:]) for took in times]


def main() -> None:
    draw = np.random.default_rng(1)
    x, nu = draw.uniform(-0.4 * SIDE, 0.4 * SIDE, (4096, 2)), draw.normal(0, 1.5 / SIDE, (4096, 2))
    axis = np.linspace(-4, 4, 64) / SIDE
    grid = np.stack(np.meshgrid(axis, axis), -1)
    sine = draw.uniform(-0.6, 0.6, (2000, 2))
    directions = np.column_stack([sine, np.sqrt(1 - (sine**2).sum(-1))])
    points = np.stack([np.linspace(-10, 10, 50), np.zeros(50), np.full(50, 30.0)], axis=-1) * SIDE
    calls = {
        "points": lambda s: pw.wigner(s, x, nu, engine="numpy"),
        "points, compiled": lambda s: pw.wigner(s, x, nu, engine="llvm"),
        "grid of nu": lambda s: pw.wigner(s, x[0], grid),
        "intensity": lambda s: pw.radiant_intensity(s, directions, WAVELENGTH),
        "rays": lambda s: pw.irradiance(s, points, WAVELENGTH),
    }
    print("source         width/side  tilts  " + "  ".join(f"{name:>20}" for name in calls))
    for name, source in SOURCES.items():
        for share in SHARES:
            partly = source.partially_coherent(share * SIDE)
            tilts = len(tilts_of(partly, TILT_ERROR[True])[1])  # for the radiant intensity
            cells = []
            for what, call in calls.items():
                if what == "intensity" and tilts > MOST_TILTS:
                    cells.append(" " * 20)
                    continue
                alone, took = fastest(partial(call, source), partial(call, partly))
                cells.append(f"{1e3 * took:8.1f} ms  x {took / alone:6.1f}")
            print(f"{name:14} {share:10g}  {tilts:5d}  " + "  ".join(cells), flush=True)


if __name__ == "__main__":
    main()
