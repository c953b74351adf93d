"""How accurate are W and A if edges of the two copies coincide?

    python benchmarks/degenerate_draws.py               4,000 draws
    python benchmarks/degenerate_draws.py --outlines 1000 --each 100

Random outlines with holes, parts that touch, slivers and vertices on a coarse grid, at positions
and lags at which edges coincide or nearly do, against exact clipping in rational numbers
(``tests/oracles``). Prints the largest error by function, precision and engine, relative to the
area and relative to the diameter times the perimeter, which bounds the effect of rounded
vertices.
"""

from __future__ import annotations

import argparse
import sys
from itertools import islice
from pathlib import Path

import numpy as np

import polywigner as pw

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from oracles import exact
from oracles.degenerate import outlines
from oracles.positions import frequencies, lags, outline, positions

ENGINES = ("numpy", "llvm")
PRECISIONS = ("double", "single")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--outlines", type=int, default=80)
    parser.add_argument("--each", type=int, default=25)
    parser.add_argument("--seed", type=int, default=7)
    options = parser.parse_args()
    rng, worst = np.random.default_rng(options.seed), {}
    for source, rings in islice(outlines(rng), options.outlines):
        shape, each = outline(rings), options.each
        boundary = shape.diameter * float(np.hypot(*shape.edges.T).sum())
        nu = frequencies(rng, shape, each)
        x, xi = positions(rng, shape, each), lags(rng, shape, each)
        cases = {
            "W": (
                pw.wigner,
                (x, nu),
                [exact.wigner(rings, p, f) for p, f in zip(x, nu, strict=True)],
            ),
            "A": (
                pw.ambiguity,
                (nu, xi),
                [exact.ambiguity(rings, f, p) for p, f in zip(xi, nu, strict=True)],
            ),
        }
        for name, (function, points, values) in cases.items():
            for precision in PRECISIONS:
                for engine in ENGINES:
                    result = function(source, *points, precision=precision, engine=engine)
                    error = float(np.abs(result - np.array(values)).max())
                    errors = error / source.area, error / boundary
                    worst.setdefault((name, precision, engine), []).append(errors)
    draws = options.outlines * options.each
    print(f"{draws} draws of each function, seed {options.seed}: largest error / area,")
    print("median over outlines, largest error / (diameter x perimeter)")
    for (name, precision, engine), rows in worst.items():
        by_area, by_boundary = np.transpose(rows)
        largest = f"{by_area.max():.1e} {np.median(by_area):.1e} {by_boundary.max():.1e}"
        print(f"{name} {precision:6} {engine:5} {largest}", flush=True)


if __name__ == "__main__":
    main()
