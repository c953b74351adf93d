"""Cells of positions in which the Wigner function is smooth, and Gauss rules on them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry import Aperture
from polywigner.geometry.parts import grid_size, polygons_in
from polywigner.source import Array
from polywigner.source.support import mutual_support

Triangles = NDArray[np.float64]
"""Corners (n, 3, 2)."""


def kinks(source: Aperture | Array) -> NDArray[np.float64]:
    """The segments (T1), each once: (m, 2, 2), ends in the plane of the source."""
    phased = source.phased if isinstance(source, Array) else None
    if phased is None or phased.repeated is None:
        return _distinct(_own_kinks(source), _grid(source))
    element, positions = phased.repeated
    assert isinstance(element, Aperture)
    means = (positions[:, None] / 2 + positions / 2).reshape(-1, 1, 2)
    grid = grid_size(np.concatenate([np.concatenate(element.rings), positions]))
    (places,) = _distinct(means, grid).transpose(1, 0, 2)
    own = _distinct(_own_kinks(element), grid)
    return _distinct((own + places[:, None, None]).reshape(-1, 2, 2), grid)


def kink_count(source: Aperture | Array) -> int:
    """Upper bound on the number of segments (T1)."""
    phased = source.phased if isinstance(source, Array) else None
    if phased is None or phased.repeated is None:
        return int(sum(len(ring) for ring in _rings(source)) ** 2)
    element, positions = phased.repeated
    assert isinstance(element, Aperture)
    grid = grid_size(positions) if positions.any() else 1.0
    means = (positions[:, None] / 2 + positions / 2).reshape(-1, 1, 2)
    return len(_distinct(means, grid)) * len(np.concatenate(element.rings)) ** 2


def _rings(source: Aperture | Array) -> list[NDArray[np.float64]]:
    return [ring for element in source.elements_in_plane for ring in element.rings]


def _grid(source: Aperture | Array) -> float:
    return grid_size(np.concatenate(_rings(source)))


def _own_kinks(source: Aperture | Array) -> NDArray[np.float64]:
    rings = _rings(source)
    vertices = np.concatenate(rings)
    ends = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    first = vertices[:, None] / 2 + vertices / 2
    second = vertices[:, None] / 2 + ends / 2
    return np.stack([first, second], axis=-2).reshape(-1, 2, 2)


def _distinct(shapes: NDArray[np.float64], grid: float) -> NDArray[np.float64]:
    """Points (n, 1, 2) or segments (n, 2, 2) without repetitions, coordinates rounded to the grid.

    Segments that run opposite ways count as one, and those that shrink to a point as none.
    """
    whole = np.rint(shapes / grid)
    first, last = whole[:, 0], whole[:, -1]
    swapped = (first[:, 0] > last[:, 0]) | (
        (first[:, 0] == last[:, 0]) & (first[:, 1] > last[:, 1])
    )
    whole[swapped] = whole[swapped, ::-1]
    result: NDArray[np.float64] = np.unique(whole.reshape(len(whole), -1), axis=0) * grid
    result = result.reshape(-1, *shapes.shape[1:])
    if shapes.shape[1] == 1:
        return result
    return result[(result[:, 0] != result[:, 1]).any(axis=-1)]


# Segments of which more are not looked for, some seconds' work, and places where they meet.
_MOST_KINKS, _MOST_MEETINGS = 1 << 16, 1 << 20
_LOOKED_AT = 256


@lru_cache(maxsize=64)
def has_few_kinks(source: Aperture | Array) -> bool:
    """Whether the arrangement can be had: up to 65,536 segments that meet some million times."""
    if kink_count(source) > _MOST_KINKS:
        return False
    segments = kinks(source)
    lines = shapely.linestrings(segments)
    step = max(1, len(lines) // _LOOKED_AT)
    tree = shapely.STRtree(lines)
    looked_at = lines[::step]
    found = tree.query(looked_at, predicate="intersects").shape[1]
    return bool(found / len(looked_at) * len(lines) / 2 <= _MOST_MEETINGS)


@lru_cache(maxsize=64)
def smooth_triangles(source: Aperture | Array) -> Triangles:
    """Triangles (n, 3, 2) that tile the automean of a source and that no kink of W crosses."""
    segments = kinks(source)
    grid = grid_size(segments.reshape(-1, 2))
    noded = shapely.union_all(shapely.linestrings(segments), grid_size=grid)
    cells = np.array(polygons_in(shapely.polygonize([noded])), dtype=object)
    support = mutual_support(source).polygons
    shapely.prepare(support)
    inside = shapely.contains_properly(support, shapely.point_on_surface(cells))
    return triangulated(cells[inside])


def quartered(triangles: Triangles) -> Triangles:
    """Each triangle as four halves of its size, one after another."""
    a, b, c = triangles.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(q, axis=1) for q in quarters], axis=1).reshape(-1, 3, 2)


def triangulated(polygons: Sequence[shapely.Polygon] | NDArray[np.object_]) -> Triangles:
    """Constrained Delaunay triangles (n, 3, 2) of polygons."""
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(np.asarray(polygons)))
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    corners.setflags(write=False)
    return corners


Values = NDArray[np.float64]
Rule = tuple[Values, Values]
"""Nodes (n, 2) in metres and weights (n,) in square metres."""

# Nodes along a side for each cycle of the phase of W, which turns at twice the frequency: Gauss
# needs pi/2 for each cycle of its integrand before it converges.
NODES_PER_CYCLE = 3.5
# Rules of more nodes are made of equal panels of half as many: they cost too much to find.
_MOST_IN_ONE = 200


def gauss_rule(triangles: Triangles, rate: float, extra: float) -> Rule:
    """A rule on all triangles (n, 3, 2), for integrands of ``rate`` cycles per metre.

    Along a side of length s it has ``extra + 3.5 s rate`` nodes, at least 1. Of each triangle the
    corner opposite to the shortest side is the one in which the rule's lines meet.
    """
    nodes, weights, _ = rule_by_triangles(triangles, rate, extra)
    return nodes, weights


def rule_by_triangles(
    triangles: Triangles, rate: float, extra: float
) -> tuple[Values, Values, NDArray[np.intp]]:
    """The rule of :func:`gauss_rule`, and the number of the triangle of each node, (n,)."""
    corners, long, short = _from_apex(triangles)
    counts = _counts(long, short, rate, extra).astype(int)
    nodes, weights, owners = zip(*_by_counts(corners, counts), strict=True)
    return np.concatenate(nodes), np.concatenate(weights), np.concatenate(owners)


def node_count(triangles: Triangles, rate: float, extra: float) -> float:
    """About how many nodes :func:`gauss_rule` has, before any is made."""
    _, long, short = _from_apex(triangles)
    return float(_counts(long, short, rate, extra).prod(axis=1).sum())


def spacings(triangles: Triangles, rate: float, extra: float) -> Values:
    """The distances between nodes of :func:`gauss_rule` in each triangle, on its longer lines."""
    _, long, short = _from_apex(triangles)
    sides: Values = np.column_stack([long, short])
    result: Values = (sides / _counts(long, short, rate, extra)).max(axis=1)
    return result


def _counts(long: Values, short: Values, rate: float, extra: float) -> Values:
    sides = np.column_stack([long, short])
    result: Values = np.maximum(np.ceil(extra + NODES_PER_CYCLE * rate * sides), 1.0)
    return result


def areas(triangles: Triangles) -> Values:
    """Areas (n,) of triangles (n, 3, 2), in square metres."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    result: Values = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return result


def _from_apex(triangles: Triangles) -> tuple[Triangles, Values, Values]:
    """Corners with that opposite to the shortest side first; the longest side, and the shortest."""
    sides = np.linalg.norm(triangles[:, (1, 2, 0)] - triangles[:, (2, 0, 1)], axis=-1)
    apex = sides.argmin(axis=1)
    order = (apex[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(triangles, order[:, :, None], axis=1)
    return corners, sides.max(axis=1), sides.min(axis=1)


def _by_counts(
    corners: Triangles, counts: NDArray[np.int_]
) -> Iterator[tuple[Values, Values, NDArray[np.intp]]]:
    for count in np.unique(counts, axis=0):
        owners = np.flatnonzero((counts == count).all(axis=1))
        chosen = corners[owners]
        u, u_weights = _legendre(int(count[0]))
        v, v_weights = _legendre(int(count[1]))
        apex, first = chosen[:, None, None, 0], chosen[:, None, None, 1]
        second = chosen[:, None, None, 2]
        u, v = u[:, None, None], v[None, :, None]
        nodes = apex + u * (first - apex + v * (second - first))
        weights = (u_weights * u[:, 0, 0])[:, None] * v_weights
        per_triangle = weights.size
        weights = 2 * areas(chosen)[:, None] * weights.reshape(1, -1)
        yield nodes.reshape(-1, 2), weights.ravel(), np.repeat(owners, per_triangle)


@lru_cache(maxsize=256)
def _legendre(count: int) -> tuple[Values, Values]:
    """Nodes and weights on [0, 1]; of many, some more than ``count``."""
    panels = 1 if count <= _MOST_IN_ONE else -(-2 * count // _MOST_IN_ONE)
    nodes, weights = np.polynomial.legendre.leggauss(-(-count // panels))
    places = (np.arange(panels)[:, None] + (nodes + 1) / 2) / panels
    return places.ravel(), np.tile(weights / (2 * panels), panels)
