"""How exact are W and A where edges of the two copies coincide?

    python benchmarks/degenerate_draws.py               4,000 draws
    python benchmarks/degenerate_draws.py --outlines 1000 --each 100

Random outlines with holes, parts that touch, slivers and vertices on a coarse grid, at positions
and lags at which edges coincide or nearly do, against exact clipping in rational numbers
(``tests/oracles``). Prints the largest error over the area, by function, precision and engine.
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
    """Print a table of errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--outlines", type=int, default=80)
    parser.add_argument("--each", type=int, default=25)
    parser.add_argument("--seed", type=int, default=7)
    options = parser.parse_args()
    rng, worst = np.random.default_rng(options.seed), {}
    for source, rings in islice(outlines(rng), options.outlines):
        shape, each = outline(rings), options.each
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
                    error = float(np.abs(result - np.array(values)).max()) / source.area
                    worst.setdefault((name, precision, engine), []).append(error)
    draws = options.outlines * options.each
    print(f"{draws} draws of each function: largest error / area, median over outlines")
    for (name, precision, engine), errors in worst.items():
        print(f"{name} {precision:6} {engine:5} {max(errors):.1e} {np.median(errors):.1e}")


if __name__ == "__main__":
    main()
