"""Positions and lags at which edges of both copies of an outline coincide, with some jitter.

A reflection at x maps an edge onto its line if x is on that line, and onto a parallel edge if x is
midway between both lines. A shift by xi does so for xi along an edge, or between two such
points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

PARALLEL = 2e-2  # sine of the angle below which two edges count as parallel
ULPS = 4
OFFSETS = (1e-15, 1e-14, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9)  # relative to the diameter
SMALLEST, LARGEST = 1e-12, 1e3  # |nu| D


@dataclass(frozen=True)
class Outline:
    """Vertices, edges, and parallel pairs of edges of an aperture."""

    starts: np.ndarray
    edges: np.ndarray
    parallel: np.ndarray
    parts: tuple[np.ndarray, ...]
    diameter: float


def outline(rings: list[np.ndarray]) -> Outline:
    """Return the outline of oriented rings."""
    starts = np.concatenate(rings)
    edges = np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in rings])
    length = np.hypot(*edges.T)
    cross = edges[:, None, 0] * edges[None, :, 1] - edges[:, None, 1] * edges[None, :, 0]
    parallel = np.argwhere(np.abs(cross) < PARALLEL * length[:, None] * length)
    spread = starts[:, None] - starts[None]
    return Outline(starts, edges, parallel, tuple(rings), float(np.hypot(*spread.T).max()))


def _choose(rng: np.random.Generator, rows: np.ndarray) -> np.ndarray:
    return rows[rng.integers(len(rows))]


def _fraction(rng: np.random.Generator) -> float:
    return float(rng.choice([0, 0.25, 0.5, 0.75, 1, 1 / 3, rng.random(), rng.random()]))


def _on_edge(rng: np.random.Generator, shape: Outline, k: int) -> np.ndarray:
    return shape.starts[k] + _fraction(rng) * shape.edges[k]


def _position(rng: np.random.Generator, shape: Outline) -> np.ndarray:
    """Return a special position without jitter."""
    count = len(shape.starts)
    kind = rng.integers(9)
    if kind == 0:
        return _choose(rng, shape.starts)
    if kind == 1:  # edge midpoint
        k = rng.integers(count)
        return shape.starts[k] + shape.edges[k] / 2
    if kind == 2:  # a centre: of the bounds, of the bounds of a part, of the vertices of a part
        part = shape.parts[rng.integers(len(shape.parts))]
        box = shape.starts if rng.random() < 0.5 else part
        return _choose(rng, np.array([(box.min(0) + box.max(0)) / 2, part.mean(0)]))
    if kind in (3, 4):  # midpoint of two vertices: centres of symmetry, corners of the automean
        return (_choose(rng, shape.starts) + _choose(rng, shape.starts)) / 2
    if kind == 5:  # on an edge or its line
        k = rng.integers(count)
        return shape.starts[k] + (1.5 * rng.random() - 0.25) * shape.edges[k]
    if kind in (6, 7):  # midway between two parallel edges
        e, f = _choose(rng, shape.parallel)
        return (_on_edge(rng, shape, e) + _on_edge(rng, shape, f)) / 2
    return (_choose(rng, shape.starts) + _on_edge(rng, shape, rng.integers(count))) / 2


def _lag(rng: np.random.Generator, shape: Outline) -> np.ndarray:
    """Return a special lag without jitter."""
    count = len(shape.starts)
    kind = rng.integers(8)
    if kind == 0:
        return np.zeros(2)
    if kind == 1:  # an edge vector
        return shape.edges[rng.integers(count)] * rng.choice([-1, 1])
    if kind in (2, 3):  # along an edge
        return shape.edges[rng.integers(count)] * (2 * rng.random() - 1)
    if kind in (4, 5):
        return _choose(rng, shape.starts) - _choose(rng, shape.starts)
    if kind == 6:  # maps an edge onto the line of a parallel edge
        e, f = _choose(rng, shape.parallel)
        return _on_edge(rng, shape, e) - _on_edge(rng, shape, f)
    return _choose(rng, shape.starts) - _on_edge(rng, shape, rng.integers(count))


def _jittered(rng: np.random.Generator, point: np.ndarray, diameter: float) -> np.ndarray:
    """Return the point, or a point a few ulps or 1e-15 to 1e-9 diameters away."""
    kind = rng.integers(3)
    if kind == 0:
        return point
    if kind == 1:
        return point + rng.integers(-ULPS, ULPS + 1, 2) * np.spacing(point)
    angle = 2 * np.pi * rng.random()
    size = rng.choice(OFFSETS) * diameter * rng.choice([0, 1, 1], 2)
    return point + size * np.array([np.cos(angle), np.sin(angle)])


def positions(rng: np.random.Generator, shape: Outline, count: int) -> np.ndarray:
    """Return special positions x (count, 2)."""
    return np.array([_jittered(rng, _position(rng, shape), shape.diameter) for _ in range(count)])


def lags(rng: np.random.Generator, shape: Outline, count: int) -> np.ndarray:
    """Return special lags xi (count, 2)."""
    return np.array([_jittered(rng, _lag(rng, shape), shape.diameter) for _ in range(count)])


def _direction(rng: np.random.Generator, shape: Outline) -> Any:
    """Return a random unit vector, or one along or across an edge up to 0 or 1e-16 to 1e-3."""
    kind = rng.integers(6)
    angle = 2 * np.pi * rng.random()
    if kind <= 1:
        return np.array([np.cos(angle), np.sin(angle)])
    if kind == 2:
        return _choose(rng, np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]]))
    ex, ey = shape.edges[rng.integers(len(shape.edges))]
    across = np.array([-ey, ex] if kind <= 4 else [ex, ey]) / np.hypot(ex, ey)
    tilt = 10.0 ** -rng.integers(3, 17) if rng.random() < 0.5 else 0.0
    return across + tilt * np.array([np.cos(angle), np.sin(angle)])


def frequencies(rng: np.random.Generator, shape: Outline, count: int) -> np.ndarray:
    """Return spatial frequencies (count, 2): zero, and |nu| D from 1e-12 to 1e3."""
    result = [np.zeros(2)]
    while len(result) < count:
        if rng.random() < 0.7:  # range of large values of the transforms
            size = 10 ** rng.uniform(-1, 1.7)
        else:
            size = 10 ** rng.uniform(np.log10(SMALLEST), np.log10(LARGEST))
        result.append(size / shape.diameter * _direction(rng, shape))
    size = np.array([np.hypot(*nu) for nu in result]) * shape.diameter
    return np.array(result) * np.minimum(1, LARGEST / np.maximum(size, 1e-300))[:, None]
