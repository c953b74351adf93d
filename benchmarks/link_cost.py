"""What does a coupling cost compared with Gauss rules on both sources?

    python benchmarks/link_cost.py

Brute force with the same kernel in NumPy: with doubled nodes along a side until the last two
results differ by 1e-6, as a user without the exact result must do; and with the smallest even
number of nodes for which the error is below 1e-6. Squares are ideal for this rule. Both divide by
the aperture power. Ratios above 1: the coupling is faster.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.reception.couplings import link_kernel
from polywigner.source.obliquities import CONDITIONS

METHOD, TOLERANCE, ROUNDS = "rayleigh-sommerfeld-1", 1e-6, 7
MOST = 1 << 24  # number of kernel values
BLOCK = 1 << 16


def pose(x: float, z: float, tilt: float = 0.0) -> np.ndarray:
    """Return a pose that faces the transmitter except for a tilt about y."""
    c, s = math.cos(math.pi + tilt), math.sin(math.pi + tilt)
    return np.array([[c, 0, s, x], [0, 1, 0, 0], [-s, 0, c, z], [0, 0, 0, 1]])


# Side of both squares, and the pose, in wavelengths.
CASES = {
    "3.1 wavelengths, 1.9 apart": (3.1, pose(0, 1.9)),
    "3.1 wavelengths, 20 apart": (3.1, pose(0, 20)),
    "3.1 wavelengths, 20 apart, tilted": (3.1, pose(8, 20, 0.3)),
    "3.1 wavelengths, 300 apart, 45 degrees": (3.1, pose(300, 300)),
    "10 wavelengths, 20 apart": (10.0, pose(0, 20)),
    "10 wavelengths, 1000 apart": (10.0, pose(0, 1000)),
    "10 wavelengths, 1000 apart, 45 degrees": (10.0, pose(1000, 1000)),
}


def brute_force(side: float, to_transmitter: np.ndarray, count: int) -> complex:
    """Return a Gauss rule of ``count`` nodes along each side of both squares."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    x, y = (grid.ravel() * side / 2 for grid in np.meshgrid(nodes, nodes, indexing="ij"))
    shares = np.outer(weights, weights).ravel() / 4 * side
    plane = np.stack([x, y, np.zeros_like(x), np.ones_like(x)])
    there = (to_transmitter @ plane)[:3]
    normal = to_transmitter[:3, 2].reshape(3, 1, 1)
    total = np.zeros(2)
    step = max(1, BLOCK // len(x))
    for start in range(0, len(x), step):
        some = slice(start, start + step)
        r = there[:, None, :] - plane[:3, some, None]
        distance = np.sqrt((r * r).sum(axis=0))
        phase, away = 2 * np.pi * distance, (normal * r).sum(axis=0)
        sight: Any = SimpleNamespace(
            wave=(np.cos(phase), np.sin(phase)),
            distance=distance,
            rise=r[2],
            away=away,
            lean=normal[2],
        )
        kernel = link_kernel(CONDITIONS[METHOD], sight)
        total += [shares[some] @ (part @ shares) for part in kernel]
    return complex(*total)


def doubled(side: float, to_transmitter: np.ndarray) -> complex:
    """Return the result of doubled rules whose last two results agree."""
    count = 4
    before = brute_force(side, to_transmitter, count)
    while True:
        count *= 2
        value = brute_force(side, to_transmitter, count)
        if abs(value - before) <= TOLERANCE * abs(value):
            return value
        before = value


def fewest(side: float, to_transmitter: np.ndarray, exact: complex) -> int | None:
    """Return the smallest number of nodes along a side, or None if the search is too slow."""
    count = 4
    while count**4 <= MOST:
        if abs(brute_force(side, to_transmitter, count) - exact) <= TOLERANCE * abs(exact):
            return count
        count += 2
    return None


def seconds(action: Callable[[], Any]) -> float:
    """Return the CPU time of the process."""
    start = time.process_time()
    action()
    return time.process_time() - start


def main() -> None:
    print("| squares of | coupling, ms | doubling, ms | ratio | told, ms (nodes) | ratio |")
    print("|---|---|---|---|---|---|")
    for name, (side, place) in CASES.items():
        square = pw.shapes.square(side)
        exact = pw.coupling(square, square, place, 1.0, METHOD, 1e-10, normalise="aperture")
        count = fewest(side, place, exact)
        if count is None:
            print(f"| {name} | more than {round(MOST**0.25)} nodes | | | | |")
            continue
        peers: list[Callable[[], Any]] = [
            partial(pw.coupling, square, square, place, 1.0, METHOD, normalise="aperture"),
            partial(doubled, side, place),
            partial(brute_force, side, place, count),
        ]
        times = np.array([[seconds(peer) for peer in peers] for _ in range(ROUNDS)])
        best, ratio = 1e3 * times.min(axis=0), np.median(times / times[:, :1], axis=0)
        figures = f"{best[0]:.2f} | {best[1]:.2f} | {ratio[1]:.2f}"
        print(f"| {name} | {figures} | {best[2]:.2f} ({count}) | {ratio[2]:.2f} |", flush=True)
    square = pw.shapes.square(3.1)
    poses = np.array([pose(x, 300.0) for x in np.linspace(-200, 200, 1000)])
    each = min(seconds(lambda: pw.coupling(square, square, poses, 1.0)) for _ in range(3)) / 1000
    print(f"\n1000 poses 300 wavelengths away in one call: {1e6 * each:.0f} us each")


if __name__ == "__main__":
    main()
