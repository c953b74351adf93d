"""What does a sample of W or A cost for all pairs of positions and frequencies?

The same samples as an outer product (``x`` of shape (n, 1, 2), ``nu`` of shape (m, 2); lags and
frequency shifts likewise) and as two lists of n m points in random order, in turns in one process:
CPU nanoseconds per sample of the outer product on one thread, best of several, and in brackets the
ratio of the lists. "Difference" is the largest between both, relative to the energy, in single and
double precision.

    python benchmarks/outer_products.py [--samples 1048576] [--columns 1024] [--engines llvm numpy]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import shapely

import polywigner as pw
from polywigner.llvm import prepare
from polywigner.source.array import mutual_support
from polywigner.source.arrays import grid_positions

CYCLES = 10.0  # |nu| times the diameter, at most
REPEATS = 5


def _array() -> pw.Array:
    return pw.phased_array(pw.shapes.square(0.8), grid_positions(4, 4, 1.0))


SOURCES: dict[str, Callable[[], Any]] = {
    "square": lambda: pw.shapes.square(1.0),
    "chevron": lambda: pw.shapes.chevron(1.0, 1.0, 0.4),
    "two chevrons": lambda: pw.shapes.chevron_pair(1.0, 1.0, 0.4),
    "18 hexagons": lambda: pw.shapes.hexagonal_segments(0.2),
    "64-gon": lambda: pw.shapes.regular_polygon(64, 1.0),
    "1024-gon": lambda: pw.shapes.regular_polygon(1024, 1.0),
    "square, cosine taper": lambda: pw.shapes.square(1.0).with_illumination(
        pw.cosine_taper(1.0, 1.0)
    ),
    "chevron, cosine taper": lambda: pw.shapes.chevron(1.0, 1.0, 0.4).with_illumination(
        pw.cosine_taper(1.0, 1.0)
    ),
    "4 x 4 squares": _array,
}


def places(source: Any, count: int) -> np.ndarray:
    """Return positions inside the automean."""
    support = mutual_support(source)
    rng, low, high = np.random.default_rng(count), *np.reshape(support.bounds, (2, 2))
    result = np.empty((0, 2))
    while len(result) < count:
        more = rng.uniform(low, high, (4 * count, 2))
        result = np.concatenate([result, more[shapely.contains_xy(support.polygons, *more.T)]])
    return result[:count]


def compare(call: Callable[..., Any], rows: np.ndarray, columns: np.ndarray) -> list[float]:
    """Return seconds per sample as an outer product and as a list, and the largest difference."""
    order = np.random.default_rng(0).permutation(len(rows) * len(columns))
    lists = [
        np.ascontiguousarray(np.broadcast_to(p, (len(rows), len(columns), 2)).reshape(-1, 2)[order])
        for p in (rows[:, None, :], columns)
    ]
    best, outer = [np.inf, np.inf], np.empty(0)
    for _ in range(REPEATS + 1):
        for k, arguments in enumerate(((rows[:, None, :], columns), lists)):
            start = time.process_time()
            values = call(*arguments)
            best[k] = min(best[k], time.process_time() - start)
            if k:
                difference = np.abs(values - outer.ravel()[order]).max()
            else:
                outer = values
    return [*(seconds / len(order) for seconds in best), float(difference)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1 << 20)
    parser.add_argument("--columns", type=int, default=1 << 10)
    parser.add_argument("--engines", nargs="+", default=["llvm", "numpy"])
    parser.add_argument("--sources", nargs="+", choices=SOURCES, default=list(SOURCES))
    parser.add_argument("--transforms", nargs="+", default=["wigner", "ambiguity"])
    options = parser.parse_args()
    if "llvm" in options.engines:
        prepare()
        import drjit

        drjit.set_thread_count(1)
    cases = [(e, p) for e in options.engines for p in ("single", "double")]
    heads = [f"{engine}, {precision}" for engine, precision in cases]
    print(f"| | {' | '.join(heads)} | difference |\n|" + "---|" * (len(cases) + 2))
    for transform in options.transforms:
        for name in options.sources:
            rows = [measure(SOURCES[name](), transform, *case, options) for case in cases]
            shown = [f"{1e9 * outer:.3g} ({each / outer:.1f})" for outer, each, _ in rows]
            differences = {
                p: max(r[2] for r, (_, q) in zip(rows, cases, strict=True) if q == p)
                for p in ("single", "double")
            }
            result = " / ".join(f"{value:.0e}" for value in differences.values())
            print(f"| {transform}, {name} | {' | '.join(shown)} | {result} |", flush=True)


def measure(
    source: Any, transform: str, engine: str, precision: str, options: argparse.Namespace
) -> list[float]:
    """Return the row of a case."""
    samples = options.samples if engine == "llvm" else options.samples // 16
    corners = len(source.rings[0]) if isinstance(source, pw.Aperture) else 0
    if engine == "numpy" and corners > 100:
        samples //= 8
    rows = places(source, max(2, samples // options.columns))
    low, high = np.reshape(mutual_support(source).bounds, (2, 2))
    size = float(np.hypot(*(high - low)))
    nu = np.random.default_rng(1).uniform(-1, 1, (options.columns, 2)) * CYCLES / size
    energy = float(pw.lag_marginal(source, (0.0, 0.0)).real)

    def call(first: np.ndarray, second: np.ndarray) -> Any:
        how: Any = {"engine": engine, "precision": precision}
        if transform == "wigner":
            return pw.wigner(source, first, second, **how)
        return pw.ambiguity(source, second, 2 * first - (low + high), **how)

    outer, scattered, difference = compare(call, rows, nu)
    return [outer, scattered, difference / energy]


if __name__ == "__main__":
    main()
