"""Gauss rules on polygons: on triangles, without kinks of W inside, and on rows of trapezoids."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry import Aperture, Wavefront
from polywigner.geometry.parts import grid_size, polygons_in
from polywigner.numerics.nodes import chirp_node_counts, gauss_legendre
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.support import mutual_support

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Triangles = NDArray[np.float64]
"""Corners (n, 3, 2)."""
Trapezoids = NDArray[np.float64]
"""(n, 3, 2): y, x on the left, and x on the right, of the lower and the upper side."""
Polygons = Sequence[shapely.Polygon] | NDArray[np.object_]
Rule = tuple[Floats, Floats]
"""Nodes (n, 2) in metres and weights (n,) in square metres."""

# Nodes along a side per cycle of the phase of W, which oscillates at twice the frequency. Gauss
# rules converge above pi/2 nodes per cycle of the integrand.
NODES_PER_CYCLE = 3.5
# Pairs of edges and heights per block.
_BATCH = 1 << 20
# Additional nodes near a pole off the plane, times arcsinh of (its distance over half the size).
_POLE = 4.0


# ---- triangles -----------------------------------------------------------------------------------


def quartered(triangles: Triangles) -> Triangles:
    """Divide each triangle into four of half its size, one after another."""
    a, b, c = triangles.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(q, axis=1) for q in quarters], axis=1).reshape(-1, 3, 2)


def triangulated(polygons: Polygons) -> Triangles:
    """Constrained Delaunay triangles (n, 3, 2) of polygons."""
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(np.asarray(polygons)))
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    corners.setflags(write=False)
    return corners


def gauss_rule(triangles: Triangles, rate: float, extra: float) -> Rule:
    """Return a rule on all triangles (n, 3, 2), for integrands of ``rate`` cycles per metre.

    Along a side of length s it has ``extra + 3.5 s rate`` nodes, at least 1. The lines of the rule
    meet in the corner opposite to the shortest side of each triangle.
    """
    nodes, weights, _ = rule_by_triangles(triangles, rate, extra)
    return nodes, weights


def rule_by_triangles(
    triangles: Triangles, rate: float, extra: float
) -> tuple[Floats, Floats, Indices]:
    """Return the rule of :func:`gauss_rule`, and the index (n,) of the triangle of each node."""
    corners, long, short = _from_apex(triangles)
    counts = _counts(long, short, rate, extra).astype(np.intp)
    nodes, weights, owners = [], [], []
    for shared in np.unique(counts, axis=0):
        members = np.flatnonzero((counts == shared).all(axis=1))
        (u, of_u), (v, of_v) = (_unit_rule(count) for count in shared.tolist())
        apex, first, second = corners[members].transpose(1, 0, 2)[:, :, None, None]
        along = first - apex + v[:, None] * (second - first)
        nodes.append((apex + u[:, None, None] * along).reshape(-1, 2))
        on_unit = np.outer(of_u * u, of_v).ravel()
        weights.append(np.outer(2 * areas(corners[members]), on_unit).ravel())
        owners.append(np.repeat(members, len(on_unit)))
    return np.concatenate(nodes), np.concatenate(weights), np.concatenate(owners)


def node_count(triangles: Triangles, rate: float, extra: float) -> float:
    """Estimate the number of nodes of :func:`gauss_rule`."""
    _, long, short = _from_apex(triangles)
    return float(_counts(long, short, rate, extra).prod(axis=1).sum())


def spacings(triangles: Triangles, rate: float, extra: float) -> Floats:
    """Distances (n,) between nodes of :func:`gauss_rule` along the longer lines of triangles."""
    _, long, short = _from_apex(triangles)
    sides = np.column_stack([long, short])
    return np.asarray((sides / _counts(long, short, rate, extra)).max(axis=1))


def _counts(long: Floats, short: Floats, rate: float, extra: float) -> Floats:
    sides = np.column_stack([long, short])
    return np.asarray(np.maximum(np.ceil(extra + NODES_PER_CYCLE * rate * sides), 1.0))


def areas(triangles: Triangles) -> Floats:
    """Areas (n,) of triangles (n, 3, 2), in square metres."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def _from_apex(triangles: Triangles) -> tuple[Triangles, Floats, Floats]:
    """Return corners, starting opposite to the shortest side; longest sides; shortest sides."""
    sides = np.linalg.norm(triangles[:, (1, 2, 0)] - triangles[:, (2, 0, 1)], axis=-1)
    apex = sides.argmin(axis=1)
    order = (apex[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(triangles, order[:, :, None], axis=1)
    return corners, sides.max(axis=1), sides.min(axis=1)


# ---- triangles where W is smooth -----------------------------------------------------------------

# Largest number of segments of kinks, some seconds of work, and of points where they meet.
_MOST_KINKS, _MOST_MEETINGS = 1 << 16, 1 << 20
# Segments in the sample that estimates the number of meetings.
_COUNTED = 256


@lru_cache(maxsize=64)
def _kinks(source: Aperture | Array) -> Floats | None:
    """Return the ends (m, 2, 2) of the kink segments (T1) without repetitions; None: too many."""
    form = normal_form(source)
    elements, means = form.in_plane.elements, np.zeros((1, 2))
    grid = 0.0
    if form.lattice is not None:
        elements, positions = (form.lattice.element,), form.lattice.positions
        means = (positions[:, None] / 2 + positions / 2).reshape(-1, 2)
        grid = grid_size(positions) if positions.any() else 1.0
        means = np.unique(np.rint(means / grid), axis=0) * grid
    rings = [ring for element in elements for ring in element.rings]
    vertices = np.concatenate(rings)
    if len(means) * len(vertices) ** 2 > _MOST_KINKS:
        return None
    ends = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    first = vertices[:, None] / 2 + vertices / 2
    second = vertices[:, None] / 2 + ends / 2
    segments = np.stack([first, second], axis=-2).reshape(-1, 2, 2)
    grid = max(grid, grid_size(vertices))
    return _distinct((_distinct(segments, grid) + means[:, None, None]).reshape(-1, 2, 2), grid)


def _distinct(segments: Floats, grid: float) -> Floats:
    """Round segments (n, 2, 2) to the grid and remove repetitions and points.

    Segments of opposite directions are equal.
    """
    steps = np.rint(segments / grid)
    order = np.lexsort((steps[..., 1], steps[..., 0]), axis=1)
    steps = np.take_along_axis(steps, order[..., None], axis=1)
    distinct = np.unique(steps.reshape(-1, 4), axis=0).reshape(-1, 2, 2) * grid
    return np.asarray(distinct[(distinct[:, 0] != distinct[:, 1]).any(axis=-1)])


@lru_cache(maxsize=64)
def has_few_kinks(source: Aperture | Array) -> bool:
    """Whether W has at most 65,536 segments of kinks, which meet at most about 1e6 times."""
    segments = _kinks(source)
    if segments is None:
        return False
    lines = shapely.linestrings(segments)
    sample = lines[:: max(1, len(lines) // _COUNTED)]
    meetings = shapely.STRtree(lines).query(sample, predicate="intersects").shape[1]
    return bool(meetings / len(sample) * len(lines) / 2 <= _MOST_MEETINGS)


@lru_cache(maxsize=64)
def smooth_triangles(source: Aperture | Array) -> Triangles:
    """Triangles (n, 3, 2) that tile the automean of a source and that no kink of W crosses.

    The source must satisfy :func:`has_few_kinks`.
    """
    segments = _kinks(source)
    assert segments is not None
    grid = grid_size(segments.reshape(-1, 2))
    noded = shapely.union_all(shapely.linestrings(segments), grid_size=grid)
    cells = np.array(polygons_in(shapely.polygonize([noded])), dtype=object)
    support = mutual_support(source).polygons
    shapely.prepare(support)
    inside = shapely.contains_properly(support, shapely.point_on_surface(cells))
    return triangulated(cells[inside])


# ---- rows of trapezoids --------------------------------------------------------------------------


def trapezoids_of(polygons: Polygons) -> tuple[Trapezoids, Indices]:
    """Return trapezoids that tile polygons, and the index of the polygon of each.

    The parallel sides lie at the heights of vertices.
    """
    rings, of_ring = shapely.get_rings(polygons, return_index=True)
    vertices, ring = shapely.get_coordinates(rings, return_index=True)
    is_edge = ring[1:] == ring[:-1]
    edges = np.stack([vertices[:-1], vertices[1:]], axis=1)[is_edge]
    owner = of_ring[ring[:-1][is_edge]]
    counts = np.bincount(owner)
    parts, owners = [], []
    for count in np.unique(counts[counts > 0]).tolist():
        same = np.flatnonzero(counts == count)
        step = max(1, _BATCH // count**2)
        for some in np.split(same, range(step, len(same), step)):
            of_some = edges[np.isin(owner, some)].reshape(-1, count, 2, 2)
            trapezoids, indices = _between_heights(of_some)
            parts.append(trapezoids)
            owners.append(some[indices])
    return np.concatenate(parts), np.concatenate(owners)


def _between_heights(edges: Floats) -> tuple[Trapezoids, Indices]:
    """Return trapezoids of n polygons with m edges each, (n, m, 2, 2), and indices of polygons."""
    (x, y), (end_x, end_y) = edges.transpose(2, 3, 0, 1)[..., None, :]
    heights = np.sort(y[:, 0])
    low, high = heights[:, :-1, None], heights[:, 1:, None]
    across = ((y <= low) != (end_y <= low)) & (low < high)
    slope = (end_x - x) / np.where(end_y == y, np.inf, end_y - y)
    ends = np.stack([np.where(across, x + (level - y) * slope, np.inf) for level in (low, high)])
    ends = np.take_along_axis(ends, np.argsort(ends.sum(axis=0), axis=-1)[None], axis=-1)
    pairs = ends[..., : 2 * (ends.shape[-1] // 2)].transpose(1, 2, 3, 0)
    left, right = pairs[:, :, ::2], pairs[:, :, 1::2]
    levels = np.broadcast_to(np.stack([low, high], axis=-1), left.shape)
    is_inside = np.isfinite(right).all(axis=-1)
    return np.stack([levels, left, right], axis=-2)[is_inside], np.nonzero(is_inside)[0]


def node_counts(
    trapezoids: Trapezoids, rates: Floats, error: float, nearest: float = math.inf
) -> Indices:
    """Return the number of rows, and of nodes on a row, for each of n trapezoids, (n, 2).

    ``rates``: largest frequencies of the integrand along x and y in 1/m, (2,) or (n, 2).
    ``nearest``: distance of the poles of the integrand from the plane in m.
    """
    y, left, right = trapezoids.transpose(1, 0, 2)
    height, width = np.diff(y)[:, 0], (right - left).max(axis=1)
    aslant = np.maximum(abs(np.diff(left)), abs(np.diff(right)))[:, 0]
    over_x, over_y = rates[..., 0], rates[..., 1]
    cycles = np.stack([over_y * height + over_x * aslant, over_x * width], axis=1)
    sizes = np.stack([np.maximum(height, aslant), width], axis=1) / 2
    with np.errstate(divide="ignore"):
        poles = np.ceil(_POLE / np.arcsinh(nearest / sizes))
    return np.asarray(chirp_node_counts(math.pi * cycles, error) + poles.astype(np.intp))


def rows_of(trapezoids: Trapezoids, counts: Indices) -> tuple[Floats, Floats, Floats]:
    """Return x (..., m, n), y (..., m) and weights (..., m, n) of nodes on trapezoids (..., 3, 2).

    Each trapezoid has m rows of n nodes; ``counts``: (m, n).
    """
    (up, of_rows), (along, on_row) = (_unit_rule(count) for count in counts.tolist())
    lines = trapezoids[..., :1] + up * np.diff(trapezoids)
    y, left, right = (lines[..., k, :] for k in range(3))
    length = (right - left)[..., None]
    height = np.diff(trapezoids[..., 0, :])[..., None]
    return left[..., None] + length * along, y, height * of_rows[:, None] * length * on_row


def rule_on(
    trapezoids: Trapezoids, rates: Floats, error: float, extra: int
) -> tuple[Floats, Floats, Indices]:
    """Return a rule on all trapezoids, and the index (n,) of the trapezoid of each node.

    The rule has ``extra`` nodes more than :func:`node_counts` along each line.
    """
    counts = node_counts(trapezoids, rates, error) + extra
    nodes, weights, owners = [], [], []
    for shared in np.unique(counts, axis=0):
        members = np.flatnonzero((counts == shared).all(axis=1))
        x, y, amounts = rows_of(trapezoids[members], shared)
        nodes.append(np.stack([x, np.broadcast_to(y[..., None], x.shape)], axis=-1).reshape(-1, 2))
        weights.append(amounts.ravel())
        owners.append(np.repeat(members, amounts[0].size))
    return np.concatenate(nodes), np.concatenate(weights), np.concatenate(owners)


@lru_cache(maxsize=1024)
def _unit_rule(count: int) -> Rule:
    """Nodes and weights on [0, 1]."""
    nodes, weights = gauss_legendre(count)[:, :2].T / 2
    return nodes + 0.5, weights


def largest_rates(source: Wavefront, points: Floats, wavelength: float) -> Floats:
    """Return the highest frequencies along x and y of the field times the wave to each point.

    In cycles per metre, (n, 2), over the source, for points (n, 3).
    """
    low, high = np.reshape(source.bounds, (2, 2))
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    away = corners - points[:, None, :2]
    # across each axis the source is nearest, where the slope along the axis is largest
    outside = np.maximum(np.maximum(low - points[:, :2], points[:, :2] - high), 0.0)[:, ::-1]
    distance = np.sqrt(away**2 + (outside**2 + points[:, 2:] ** 2)[:, None])
    slopes = away / (wavelength * distance) + (corners - source.centre) @ source.curvature
    return np.asarray(abs(slopes).max(axis=1) + abs(normal_form(source).frequencies).max(axis=0))
