"""Make tests/data/coincident_edges.npz: run ``python -m oracles.generate`` in tests/.

Takes a minute on one core with gmpy2 installed, a few without. One shape per group of arrays: its
rings (stacked, with their lengths and roles), 128 frequencies, positions and lags with the index
of their frequency, and W and A from :mod:`oracles.exact`, rounded once to float64.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from oracles import exact
from oracles.positions import frequencies, lags, outline, positions
from oracles.shapes import Polygons, awkward_shapes

SEED = 20220205
FREQUENCIES = 128
POSITIONS = 500
LAGS = 300
TARGET = Path(__file__).parents[1] / "data" / "coincident_edges.npz"


def _rings(polygons: Polygons) -> dict[str, np.ndarray]:
    rings = [(ring, k) for outer, holes in polygons for k, ring in enumerate([outer, *holes])]
    return {
        "vertices": np.concatenate([ring for ring, _ in rings]),
        "lengths": np.array([len(ring) for ring, _ in rings], np.uint8),
        "hole": np.array([k > 0 for _, k in rings]),
    }


def references(polygons: Polygons, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """All arrays of one shape."""
    rings = exact.oriented(polygons)
    shape = outline(rings)
    nu = frequencies(rng, shape, FREQUENCIES)
    x, xi = positions(rng, shape, POSITIONS), lags(rng, shape, LAGS)
    x_nu = rng.integers(FREQUENCIES, size=POSITIONS).astype(np.uint8)
    xi_nu = rng.integers(FREQUENCIES, size=LAGS).astype(np.uint8)
    return {
        **_rings(polygons),
        "nu": nu,
        "x": x,
        "x_nu": x_nu,
        "wigner": np.array([exact.wigner(rings, p, nu[k]) for p, k in zip(x, x_nu, strict=True)]),
        "xi": xi,
        "xi_nu": xi_nu,
        "ambiguity": np.array(
            [exact.ambiguity(rings, nu[k], p) for p, k in zip(xi, xi_nu, strict=True)]
        ),
    }


def main() -> None:
    """Write the file."""
    arrays = {}
    for number, (name, polygons) in enumerate(awkward_shapes().items()):
        start = time.perf_counter()
        for key, value in references(polygons, np.random.default_rng([SEED, number])).items():
            arrays[f"{name}/{key}"] = value
        print(f"{name}: {time.perf_counter() - start:.1f} s", file=sys.stderr, flush=True)
    TARGET.parent.mkdir(exist_ok=True)
    np.savez_compressed(TARGET, **arrays)
    print(f"{TARGET.name}: {TARGET.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
