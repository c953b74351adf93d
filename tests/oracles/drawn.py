"""Random apertures for hypothesis: convex, concave, holed, disjoint, thin, with coincident edges.

Tiles and lattice polygons have many parallel, collinear and coincident edges. Half of them are
rotated, and some are jittered by 1e-16 to 1e-4.
"""

from __future__ import annotations

import math
from functools import reduce

import numpy as np
import shapely
from hypothesis import assume
from hypothesis import strategies as st

from oracles.references import Polygons

LEAST_CLEARANCE = 1e-2  # larger than the jitter, so that rings do not touch themselves

_angles = st.floats(0, 2 * math.pi)
_sizes = st.floats(0.2, 1.0)


@st.composite
def _round_ring(draw: st.DrawFn, convex: bool) -> np.ndarray:
    """Draw a star-shaped ring around the origin, on an ellipse if ``convex``."""
    count = draw(st.integers(3, 9))
    # With relative steps from 0.6 to 1, no angle between vertices reaches 180 degrees, so the
    # origin is inside the ring.
    gaps = np.array(draw(st.lists(st.floats(0.6, 1), min_size=count, max_size=count)))
    angle = 2 * math.pi * np.cumsum(gaps / gaps.sum())
    radius = np.ones(count)
    if not convex:
        radius = np.array(draw(st.lists(_sizes, min_size=count, max_size=count)))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _apply(polygons: Polygons, matrix: np.ndarray, shift: np.ndarray) -> Polygons:
    return [
        (outer @ matrix.T + shift, [hole @ matrix.T + shift for hole in holes])
        for outer, holes in polygons
    ]


@st.composite
def _posed(draw: st.DrawFn, polygons: Polygons, squeeze: float = 1.0) -> Polygons:
    """Draw polygons squeezed along y, rotated and shifted; half of them stay along the axes."""
    angle = draw(st.sampled_from([0.0, draw(_angles)]))
    shift = np.array([draw(st.floats(-2, 2)), draw(st.floats(-2, 2))])
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    return _apply(polygons, turn @ np.diag([1.0, squeeze]), shift)


@st.composite
def _plain(draw: st.DrawFn) -> Polygons:
    return draw(_posed([(draw(_round_ring(draw(st.booleans()))), [])]))


@st.composite
def _holed(draw: st.DrawFn) -> Polygons:
    ring = draw(_round_ring(draw(st.booleans())))
    return draw(_posed([(ring, [ring * draw(st.floats(0.1, 0.8))])]))


@st.composite
def _disjoint(draw: st.DrawFn) -> Polygons:
    first, second = draw(_round_ring(True)), draw(_round_ring(False))
    offset = np.array([draw(st.floats(2.01, 3.0)), draw(st.floats(-2, 2))])
    return draw(_posed([(first, []), (second + offset, [])]))


@st.composite
def _sliver(draw: st.DrawFn) -> Polygons:
    squeeze = 10.0 ** -draw(st.integers(1, 3))
    return draw(_posed([(draw(_round_ring(draw(st.booleans()))), [])], squeeze))


@st.composite
def _tiles(draw: st.DrawFn) -> Polygons:
    """Draw tiles of a grid, which share edges and corners."""
    columns = np.cumsum([0.0, *draw(st.lists(st.sampled_from([0.5, 1.0]), min_size=3, max_size=3))])
    rows = np.cumsum([0.0, *draw(st.lists(st.sampled_from([0.3, 0.6]), min_size=2, max_size=2))])
    cells = draw(st.sets(st.integers(0, 5), min_size=1))
    angle = draw(st.sampled_from([0.0, draw(_angles)]))
    c, s = math.cos(angle), math.sin(angle)

    def corner(i: int, j: int) -> list[float]:  # equal floats for all tiles
        return [c * columns[i] - s * rows[j], s * columns[i] + c * rows[j]]

    def tile(cell: int) -> np.ndarray:
        i, j = cell % 3, cell // 3
        return np.array([corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)])

    return [(tile(cell), []) for cell in sorted(cells)]


def _clearance(ring: np.ndarray) -> float:
    """Return the smallest distance between a vertex and an edge that does not end there."""
    edges = shapely.linestrings(np.stack([ring, np.roll(ring, -1, axis=0)], axis=1))
    distance = shapely.distance(shapely.points(ring)[:, None], edges)
    own = np.arange(len(ring))
    distance[own, own] = distance[own, own - 1] = np.inf
    return float(distance.min())


@st.composite
def _lattice(draw: st.DrawFn) -> Polygons:
    """Draw a concave star-shaped polygon with corners on a 6 x 6 lattice, rotated and jittered."""
    points = draw(st.sets(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=4, max_size=9))
    away = np.array(sorted(points), float) - 2.4 + np.array([0.0, 0.03])
    ring = away[np.argsort(np.arctan2(away[:, 1], away[:, 0]))] / 5
    assume(shapely.Polygon(ring).is_valid and _clearance(ring) > LEAST_CLEARANCE)
    shake = draw(st.sampled_from([0.0, 10.0 ** -draw(st.integers(4, 16))]))
    offsets = np.random.default_rng(draw(st.integers(0, 999))).normal(size=ring.shape)
    return draw(_posed([(ring + shake * offsets, [])]))


def polygons() -> st.SearchStrategy[Polygons]:
    kinds = [_plain(), _holed(), _disjoint(), _sliver(), _tiles(), _lattice()]
    return reduce(lambda a, b: a | b, kinds)
