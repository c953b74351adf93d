"""How do the cost and the error of a sample of W grow with the number of vertices?

Outlines of 8 to 1024 vertices: regular polygons; deep stars; smooth random outlines that are not
convex; and jagged random outlines, whose lag slices have more and more edges ("parts": number of
terms of a sample). Arrays from and to NumPy, CPU seconds on one thread; errors are differences from
NumPy in float64, relative to the area.

    python benchmarks/wigner_cost.py [--samples 262144] [--vertices 8 16 32 ...] [--ambiguity]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.execution import NumpyOperations
from polywigner.kernels import tables_of
from polywigner.kernels.cut.clipping import MIRRORED
from polywigner.kernels.cut.winding import pairs_of
from polywigner.kernels.functions.slices import WIGNER_SUM
from polywigner.llvm import prepare

VERTICES = (8, 16, 32, 64, 128, 256, 512, 1024)
CHECKED = 48  # number of samples with an error
CYCLES = 10.0  # |nu| times the diameter, at most


def polar(radii: np.ndarray) -> pw.Aperture:
    angle = 2 * np.pi * np.arange(len(radii)) / len(radii)
    return pw.Aperture(radii[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def random_outline(count: int) -> pw.Aperture:
    rng, angle = np.random.default_rng(7), 2 * np.pi * np.arange(count) / count
    waves = [rng.normal() / k * np.cos(k * angle + 6.3 * rng.random()) for k in range(1, 9)]
    return polar(np.exp(0.4 * np.sum(waves, axis=0)))


def jagged_outline(count: int) -> pw.Aperture:
    return polar(0.5 + 0.5 * np.random.default_rng(count).random(count))


OUTLINES: dict[str, Callable[[int], pw.Aperture]] = {
    "regular": lambda n: pw.shapes.regular_polygon(n, 1.0),
    "star": lambda n: pw.shapes.star(n // 2, 1.0, 1 - 4 / n),
    "random": random_outline,
    "jagged": jagged_outline,
}


def points(source: pw.Aperture, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions in the aperture's bounds, and frequencies."""
    rng = np.random.default_rng(count)
    low, high = np.reshape(source.bounds, (2, 2))
    nu = rng.uniform(-1, 1, (count, 2)) * CYCLES / source.diameter
    return rng.uniform(low, high, (count, 2)), nu


def per_sample(call: Callable[..., Any], a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return CPU seconds per sample, best of three, and of the first call."""
    times = []
    for _ in range(4):
        start = time.process_time()
        call(a, b)
        times.append(time.process_time() - start)
    return min(times[1:]) / len(a), times[0]


def parts(source: pw.Aperture, x: np.ndarray) -> float:
    """Return the mean number of parts of edges in a lag slice."""
    tables, ops = tables_of(source, True), NumpyOperations()
    place = tables.frame.position(ops, *x.T)
    return sum(len(owner) for *_, owner, _ in WIGNER_SUM.parts(tables, place, len(x))) / len(x)


def measure(source: pw.Aperture, precision: str, samples: int, ambiguity: bool) -> list[float]:
    """Return seconds per sample and of the first call, and the largest difference from NumPy."""
    transform = pw.ambiguity if ambiguity else pw.wigner
    centre = np.reshape(source.bounds, (2, 2)).mean(axis=0)

    def call(x: np.ndarray, nu: np.ndarray, how: str = precision, engine: str = "llvm") -> Any:
        a, b = (nu, 2 * (x - centre)) if ambiguity else (x, nu)
        return transform(source, a, b, engine=engine, precision=how)

    x, nu = points(source, samples)
    seconds, first = per_sample(call, x, nu)
    expected = call(x[:CHECKED], nu[:CHECKED], "double", "numpy")
    result = call(x, nu)[:CHECKED]
    return [seconds, first, float(np.abs(result - expected).max() / source.area)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1 << 18)
    parser.add_argument("--vertices", type=int, nargs="+", default=VERTICES)
    parser.add_argument("--outlines", nargs="+", choices=OUTLINES, default=list(OUTLINES))
    parser.add_argument("--ambiguity", action="store_true", help="A instead of W")
    options = parser.parse_args()
    prepare()
    import drjit

    drjit.set_thread_count(1)
    print("| outline | n | precision | ns/sample | ratio | first call, s | parts | MB | error |")
    print("|" + "---|" * 9)
    for name in options.outlines:
        for precision in ("single", "double"):
            base: list[float] = []
            for count in options.vertices:
                source = OUTLINES[name](count)
                row = measure(source, precision, options.samples, options.ambiguity)
                base = base or row
                is_double = precision == "double"
                lists = pairs_of(tables_of(source, is_double), (MIRRORED, 0, 0), is_double)
                print(
                    f"| {name} | {count} | {precision} | {1e9 * row[0]:.0f} | "
                    f"{row[0] / base[0]:.1f} | {row[1]:.2f} | "
                    f"{parts(source, points(source, 4096)[0]):.0f} | "
                    f"{lists.nbytes / 1e6:.1f} | {row[2]:.1e} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
