"""How accurate are W, R and A if all edges coincide, and F far from the origin?

Random outlines with (nearly) mirror symmetry, at their centres, at lags of 0 and along edges:
regular and irregular polygons of 3 to 1000 vertices, sheared, rotated and shifted, and rings of
them. And array factors of lattices 10 to 10,000 diameters off the origin, rotated or not. Prints
the largest errors, relative to the area or to the sum of weights, and their seeds. Takes some
seconds for each outline.

    python benchmarks/coincident_accuracy.py [--outlines 500] [--arrays 200] [--seed 0]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import shapely

import polywigner as pw

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from oracles import exact

SAMPLES = 264  # more than NumPy computes without chunks
MOST_VERTICES = 40  # takes seconds for more vertices
CYCLES = (0.0, 0.7, 4.0)  # |nu| times the diameter
DECADES = (1, 10, 100, 1000)
Worst = dict[tuple[str, ...], tuple[float, int]]


def outline(seed: int) -> tuple[str, list[np.ndarray], np.ndarray]:
    """Return kind, rings (a hole second), and centre."""
    rng = np.random.default_rng([1, seed])
    n = int(np.exp(rng.uniform(np.log(3), np.log(1000))))
    angle = 2 * np.pi * np.arange(n) / n + rng.uniform(0, 7)
    if rng.random() < 0.3 and n > 5:
        half = np.sort(rng.uniform(0.2, 1.0, n // 2)).cumsum()
        half *= np.pi / half[-1]
        angle = np.concatenate([half, half + np.pi])
    points = np.column_stack([np.cos(angle), np.sin(angle)])
    ratio = 1.0 - 10 ** rng.uniform(-2, -0.2)
    gap = 2 * np.pi - np.ptp(angle), np.diff(angle).max()
    if rng.random() < 0.5:
        stretch = np.diag([1.0, 10 ** rng.uniform(-0.8, 0)])
        points = points @ (stretch @ np.array([[1.0, rng.uniform(-1, 1)], [0.0, 1.0]])).T
    turn = rng.uniform(0, 7)
    points = points @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    centre = rng.choice([0.0, 1.0, 30.0]) * rng.normal(size=2)
    rings = [points] if rng.random() < 0.6 or max(gap) > 2.5 else [points, ratio * points]
    kind = "polygon" if len(rings) == 1 else "ring"
    return kind, [ring + centre for ring in rings], centre


def places(rng: np.random.Generator, ring: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions relative to the centre, and lags."""
    edges = np.roll(ring, -1, axis=0) - ring
    edge = edges[rng.integers(len(edges))]
    jitter = 10 ** rng.uniform(-17, -9, (2, 1)) * rng.normal(size=(2, 2))
    lags = [np.zeros(2), edge * rng.choice([1.0, 0.5, 1 / 3]), jitter[1]]
    return np.stack([np.zeros(2), *jitter]), np.stack(lags)


def outline_errors(seed: int, engines: list[str]) -> Iterator[tuple[tuple[str, ...], float]]:
    """Yield ((kind, function, engine, precision), error over area) for each form of the call."""
    kind, rings, centre = outline(seed)
    rng = np.random.default_rng([2, seed])
    source = pw.Aperture(shapely.Polygon(rings[0], rings[1:]))
    offsets, xi = places(rng, rings[0])
    x = centre + offsets
    direction = rng.normal(size=2)
    nu = np.outer(CYCLES, direction / np.hypot(*direction)) / source.diameter
    oriented = [ring[:: (-1) ** k] for k, ring in enumerate(rings)]
    slices = [exact.lag_region(oriented, place) for place in x]
    means = [exact.position_region(oriented, lag) for lag in xi]
    expected = {
        "W": np.array(
            [complex(exact.transform(s, k)).real for s, k in zip(slices, nu, strict=True)]
        ),
        "R": np.array([float(s.area) for s in slices]),
        "A": np.array([complex(exact.transform(s, k)) for s, k in zip(means, nu, strict=True)]),
    }
    every = np.arange(SAMPLES) % len(x)
    for engine in engines:
        for precision in ("double", "single"):
            how: dict[str, Any] = {"engine": engine, "precision": precision}
            few = precision == "single" or (engine == "numpy" and len(rings[0]) > MOST_VERTICES)
            for rows in (np.arange(len(x)),) if few else (np.arange(len(x)), every):
                got = {
                    "W": pw.wigner(source, x[rows], nu[rows], **how),
                    "R": pw.position_marginal(source, x[rows], **how),
                    "A": pw.ambiguity(source, nu[rows], xi[rows], **how),
                }
                for name, values in got.items():
                    error = np.abs(values - expected[name][rows]).max() / source.area
                    yield (kind, name, engine, precision), float(error)
            table = pw.wigner(source, x[:, None], nu[None, :].repeat(8, axis=1), **how)
            error = np.abs(np.diagonal(table[:, ::8]) - expected["W"]).max() / source.area
            yield (kind, "W", engine, precision), float(error)


def lattice(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions (n, 2), the pitch, and the rotation (2, 2) of the rows."""
    rng = np.random.default_rng([3, seed])
    counts, pitch = rng.integers(4, 24, 2), 10 ** rng.uniform(-3, 1) * rng.uniform(0.5, 1.5, 2)
    turn = rng.choice([0.0, rng.uniform(0, 7)])
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    i, j = (k.ravel() for k in np.indices(counts))
    sites = np.column_stack([i * pitch[0], j * pitch[1]]) @ turned
    away = rng.normal(size=2)
    extent = np.hypot(*np.ptp(sites, axis=0))
    return sites + 10 ** rng.uniform(1, 4) * extent * away / np.hypot(*away), pitch, turned


def exact_factor(sites: np.ndarray, nu: np.ndarray) -> complex:
    """Return the array factor with exact phases."""
    p, q = (Fraction(c) for c in nu.tolist())
    turns = [p * Fraction(x) + q * Fraction(y) for x, y in sites.tolist()]
    return complex(np.exp(-2j * np.pi * np.array([float(t - round(t)) for t in turns])).sum())


def lattice_errors(seed: int, engines: list[str]) -> Iterator[tuple[tuple[str, ...], float]]:
    """Yield ((|nu| D, engine), error over the number of sites)."""
    sites, pitch, turned = lattice(seed)
    rng, extent = np.random.default_rng([4, seed]), np.hypot(*np.ptp(sites, axis=0))
    for decade in DECADES:
        nu = rng.normal(size=(4, 2))
        nu *= decade / extent / np.hypot(*nu.T)[:, None]
        lobes = (np.round(nu @ turned.T * pitch) / pitch) @ turned
        nu = np.concatenate([nu, lobes + 0.1 * rng.normal(size=lobes.shape) / extent])
        expected = np.array([exact_factor(sites, row) for row in nu])
        for engine in engines:
            error = np.abs(pw.array_factor(sites, None, nu, engine=engine) - expected).max()
            yield (f"lattice, |nu| D = {decade}", engine), float(error) / len(sites)


def _report(worst: Worst) -> None:
    for key in sorted(worst):
        error, seed = worst[key]
        print(f"{', '.join(key):44} {error:.1e}   (seed {seed})", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--outlines", type=int, default=500)
    parser.add_argument("--arrays", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engines", nargs="+", default=["numpy", "llvm"])
    options = parser.parse_args()
    searches = ((outline_errors, options.outlines), (lattice_errors, options.arrays))
    for errors, count in searches:
        worst: Worst = {}
        for seed in range(options.seed, options.seed + count):
            for key, error in errors(seed, options.engines):
                worst[key] = max(worst.get(key, (0.0, seed)), (error, seed))
        _report(worst)


if __name__ == "__main__":
    main()
