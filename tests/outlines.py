"""Random outlines for the geometry tests, and independent measures."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import shapely
from hypothesis import settings
from hypothesis import strategies as st

from oracles.drawn import polygons as drawn_polygons
from polywigner.geometry import Aperture

__all__ = [
    "CHEVRON",
    "apertures",
    "cells",
    "difference",
    "inside_rings",
    "poses",
    "relaxed",
    "rotated",
    "sample",
    "square_at",
    "tours",
]

# No deadline, because a shared machine can delay any example.
relaxed = settings(deadline=None, max_examples=50)

Pose = Callable[[np.ndarray], np.ndarray]

CHEVRON = np.array([[0, 0], [1, 0.5], [2, 0], [2, 0.6], [1, 1.1], [0, 0.6]])


def square_at(x: float, y: float, side: float = 1.0) -> np.ndarray:
    return np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * side + [x, y]


def rotated(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(points) @ np.array([[c, s], [-s, c]])


def difference(a: Aperture, b: Aperture) -> float:
    """Return the area of the symmetric difference of a and b, relative to the area of b."""
    return float(shapely.symmetric_difference(a.polygons, b.polygons).area) / b.area


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    """Rotations, sizes from 1e-6 to 1e3, and positions up to a thousand sizes from the origin."""
    angle = draw(st.sampled_from([0.0, 0.3, math.pi / 4]) | st.floats(0, 6.3))
    size = draw(st.sampled_from([1.0, 1e-6, 1e-3, 1e3]))
    shift = np.array(draw(st.sampled_from([(0, 0), (0.1, -0.7), (30, -20), (1e3, 2e3)])))
    return lambda points: (rotated(points, angle) + shift) * size


def _untangled(points: np.ndarray) -> np.ndarray:
    """Reverse parts of a tour until its length is minimal, so that it does not cross itself."""
    ring = points.astype(float)
    improved = True
    while improved:
        improved = False
        for i in range(len(ring) - 2):
            for j in range(i + 2, len(ring) - (i == 0)):
                a, b, c, d = ring[i], ring[i + 1], ring[j], ring[(j + 1) % len(ring)]
                now = math.dist(a, b) + math.dist(c, d)
                if math.dist(a, c) + math.dist(b, d) < now - 1e-12:
                    ring[i + 1 : j + 1] = ring[i + 1 : j + 1][::-1].copy()
                    improved = True
    return ring


@st.composite
def tours(draw: st.DrawFn) -> np.ndarray:
    """Simple rings through up to 16 points, often on a lattice."""
    lattice = st.tuples(st.integers(0, 5), st.integers(0, 5))
    anywhere = st.tuples(st.floats(0, 5), st.floats(0, 5))
    kind = draw(st.sampled_from([lattice, anywhere]))
    points = draw(st.lists(kind, min_size=4, max_size=16, unique=True))
    ring = _untangled(np.array(points, dtype=float))
    # A tour through collinear points can touch itself.
    polygon = shapely.Polygon(ring)
    valid = polygon.is_valid and polygon.area > 1e-3
    return ring if valid else CHEVRON


@st.composite
def cells(draw: st.DrawFn) -> list[np.ndarray]:
    """Unit squares of a checkerboard, which touch along edges and at corners and leave holes."""
    columns = draw(st.integers(1, 5))
    chosen = draw(st.sets(st.integers(0, 5 * columns - 1), min_size=1))
    return [square_at(k % columns, k // columns) for k in sorted(chosen)]


@st.composite
def apertures(draw: st.DrawFn) -> Aperture:
    """Convex, concave, holed, disjoint, thin and tiled apertures in any pose."""
    pose = draw(poses())
    kind = draw(st.sampled_from(["tour", "cells", "drawn"]))
    if kind == "tour":
        return Aperture(pose(draw(tours())))
    if kind == "cells":
        return Aperture([pose(ring) for ring in draw(cells())])
    parts = [
        shapely.Polygon(pose(outer), [pose(hole) for hole in holes])
        for outer, holes in draw(drawn_polygons())
    ]
    return Aperture(parts)


def inside_rings(rings: tuple[np.ndarray, ...], points: np.ndarray) -> np.ndarray:
    """Return whether points are inside by the even-odd rule, in floating point."""
    inside = np.zeros(len(points), dtype=bool)
    for ring in rings:
        for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            crosses = (ay > points[:, 1]) != (by > points[:, 1])
            if ay != by:
                at = ax + (points[:, 1] - ay) / (by - ay) * (bx - ax)
                inside ^= crosses & (points[:, 0] < at)
    return inside


def sample(aperture: Aperture, count: int, seed: int = 0) -> np.ndarray:
    """Return random points of the bounds that are off all edges of the convex cover."""
    xmin, ymin, xmax, ymax = aperture.bounds
    points = np.random.default_rng(seed).random((count, 2)) * [xmax - xmin, ymax - ymin]
    points += [xmin, ymin]
    edges = shapely.MultiLineString([np.vstack([p, p[:1]]) for p in aperture.convex_cover])
    off = shapely.distance(edges, shapely.points(points)) > 1e-9 * aperture.diameter
    return points[off]
