"""Endless random outlines with edges that coincide, touch or are nearly parallel in the copies.

Regular polygons and lattices have centres of symmetry and edges along lags. After rotation, scaling
and jitter, these properties hold only up to rounding. Vertices lie on any floats or on a grid of
2^-40, where cross products of edges and offsets are often exactly 0, or next to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import shapely

import polywigner as pw
from polywigner.errors import GeometryError

Rings = list[np.ndarray]
GRID = 2.0**-40


def _regular(rng: np.random.Generator) -> Rings:
    count = int(rng.choice([3, 4, 5, 6, 8, 12, 16, 31]))
    angle = 2 * np.pi * (np.arange(count) / count + rng.choice([0.0, rng.random()]))
    return [np.column_stack([np.cos(angle), np.sin(angle)])]


def _star(rng: np.random.Generator) -> Rings:
    count = int(rng.integers(3, 13))
    angle = 2 * np.pi * (np.arange(count) + 0.8 * rng.random(count)) / count
    radius = 0.3 + 0.7 * rng.random(count)
    return [radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])]


def _tiles(rng: np.random.Generator) -> Rings:
    """Return squares of a checkerboard, with collinear edges, touching corners and holes."""
    chosen = rng.choice(12, size=rng.integers(1, 10), replace=False)
    boxes = [shapely.box(k % 4, k // 4, k % 4 + 1, k // 4 + 1) for k in chosen.tolist()]
    joined = shapely.union_all(boxes)
    polygons = getattr(joined, "geoms", [joined])
    return [np.array(r.coords)[:-1] / 4 for p in polygons for r in (p.exterior, *p.interiors)]


def _frame(rng: np.random.Generator) -> Rings:
    """Return a polygon with a similar hole."""
    (ring,) = _regular(rng) if rng.random() < 0.5 else _star(rng)
    return [ring, ring[::-1] * rng.choice([0.5, 0.25 + 0.5 * rng.random()])]


def _lattice(rng: np.random.Generator) -> Rings:
    """Return a star-shaped polygon with corners on a 6 x 6 lattice."""
    points = np.unique(rng.integers(0, 6, (rng.integers(4, 10), 2)), axis=0) - [2.4, 2.37]
    return [points[np.argsort(np.arctan2(points[:, 1], points[:, 0]))] / 5]


KINDS: list[Callable[[np.random.Generator], Rings]] = [_regular, _star, _tiles, _frame, _lattice]


def _posed(rng: np.random.Generator, rings: Rings) -> Rings:
    """Squeeze, rotate, jitter, round, scale and move rings at random."""

    def sometimes() -> bool:
        return bool(rng.random() < 0.4)

    matrix = np.eye(2)
    if sometimes():
        matrix = np.diag([1.0, 10.0 ** -rng.integers(1, 7)])
    if sometimes():
        c, s = np.cos(angle := 6.3 * rng.random()), np.sin(angle)
        matrix = np.array([[c, -s], [s, c]]) @ matrix
    rings = [ring @ matrix.T for ring in rings]
    if sometimes():
        size = 10.0 ** -rng.integers(5, 17)
        rings = [ring + size * rng.normal(size=ring.shape) for ring in rings]
    if sometimes():
        rings = [np.round(ring / GRID) * GRID for ring in rings]
    if sometimes():
        rings = [ring * 10.0 ** rng.integers(-6, 4) for ring in rings]
    if sometimes():
        size = max(float(np.ptp(ring)) for ring in rings)
        shift = size * rng.normal(size=2) * rng.choice([1, 30])
        rings = [ring + shift for ring in rings]
    return rings


def outlines(rng: np.random.Generator) -> Iterator[tuple[pw.Aperture, Rings]]:
    """Yield apertures and their rings; outer rings are counter-clockwise."""
    while True:
        rings = _posed(rng, KINDS[rng.integers(len(KINDS))](rng))
        try:
            aperture = _aperture(rings)
        except (GeometryError, ValueError):  # self-intersecting, or without area
            continue
        yield aperture, [np.array(ring) for ring in aperture.rings]


def _aperture(rings: Rings) -> pw.Aperture:
    polygons = [shapely.Polygon(ring) for ring in rings]
    holes = [hole for hole in polygons if not hole.exterior.is_ccw]
    outer = [
        shapely.Polygon(part.exterior, [h.exterior for h in holes if part.contains(h)])
        for part in polygons
        if part.exterior.is_ccw
    ]
    return pw.Aperture(outer)
