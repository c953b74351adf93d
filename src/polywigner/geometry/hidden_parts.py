"""Visible parts of projected triangles as exact polygons, and set operations on such polygons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.errors import GEOSException
from shapely.geometry.base import BaseGeometry

from polywigner.geometry.arguments import check_most
from polywigner.numerics import Floats, Indices

Shapes = NDArray[np.object_]

# Lengths below this fraction of the body's size are treated as zero.
NOTHING = 1e-12
# Width below which a triangle counts as a line, in units of NOTHING times the body's size.
_WIDTH = 8.0
# Largest number of overlapping pairs of triangles, whose polygons take 0.5 GB; number of polygons
# in one query of the search tree; largest number of crossings, which take minutes.
_MOST_PAIRS, _BLOCK, _MOST_CROSSINGS = 1 << 20, 256, 2e8


@dataclass(frozen=True, eq=False)
class Projected:
    """Projections of n triangles, with corners in counter-clockwise order."""

    points: Floats
    """Corners in the projection plane, shape (n, 3, 2)."""
    depth: Floats
    """Coordinate of each corner along the line of sight, shape (n, 3); it grows with distance."""
    size: float
    """Size of the body."""
    ranges: Floats
    """Distance of each corner from the observer, divided by the distance of the projection plane,
    shape (n, 3); 1 for a distant observer."""

    @cached_property
    def sides(self) -> Floats:
        """Vectors from the first corner to the other corners, shape (n, 2, 2)."""
        return np.asarray(self.points[:, 1:] - self.points[:, :1])

    @cached_property
    def twice_area(self) -> Floats:
        """Twice the area of each triangle, above zero if counter-clockwise, shape (n,)."""
        first, second = self.sides[:, 0], self.sides[:, 1]
        return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])

    @property
    def has_width(self) -> NDArray[np.bool_]:
        """Mask of the triangles that rounding has not reduced to lines, shape (n,)."""
        longest = np.linalg.norm(self.sides, axis=2).max(axis=1)
        return np.asarray(self.twice_area > _WIDTH * NOTHING * self.size * longest)

    @property
    def slopes(self) -> Floats:
        """Gradient of the depth of each triangle in the projection plane, shape (n, 2)."""
        rise = self.depth[:, 1:] - self.depth[:, :1]
        across = rise[:, 0] * self.sides[:, 1, 1] - rise[:, 1] * self.sides[:, 0, 1]
        along = rise[:, 1] * self.sides[:, 0, 0] - rise[:, 0] * self.sides[:, 1, 0]
        return np.asarray(np.stack([across, along], axis=1) / self.twice_area[:, None])

    def subset(self, rows: NDArray[np.bool_]) -> Projected:
        """Return the projections of the triangles selected by a mask (n,) or by indices."""
        return Projected(self.points[rows], self.depth[rows], self.size, self.ranges[rows])


def in_perspective(corners: Floats, frame: Floats, distance: float, size: float) -> Projected:
    """Project triangles (n, 3, 3) in front of an observer at the origin.

    ``frame``: x, y and z axes of the observer as rows, with z the line of sight. ``distance``:
    distance of the projection plane. ``size``: size of the body, relative to which small lengths
    are negligible. The sign of y is reversed, so corners that the observer sees counter-clockwise
    remain counter-clockwise. The depth is distance (1 - distance/z), which is linear in the plane.
    """
    x, y, z = np.moveaxis(corners @ frame.T, -1, 0)
    scale = distance / z
    points = np.stack([x * scale, -y * scale], axis=-1)
    return Projected(points, distance * (1 - scale), size, z / distance)


# Advice for bodies with too many triangles that hide each other.
_SIMPLER = "remove hidden surfaces, or simplify the mesh"


def _overlapping_pairs(projected: Projected, polygons: Shapes) -> tuple[Indices, Indices]:
    """Return the indices (m,) and (m,) of triangles whose projections overlap.

    ``polygons`` (n,): only triangles whose polygons have overlapping boxes are compared. Each pair
    occurs once, with the smaller index first. Raises ArgumentError if there are too many pairs.
    """
    tree, pairs, total = shapely.STRtree(polygons), [np.empty((2, 0), np.intp)], 0
    for start in range(0, len(polygons), _BLOCK):
        one, other = tree.query(polygons[start : start + _BLOCK])
        once = one + start < other
        one, other = one[once] + start, other[once]
        apart = _are_separated(projected, one, other) | _are_separated(projected, other, one)
        pairs.append(np.stack([one[~apart], other[~apart]]))
        total += pairs[-1].shape[1]
        check_most(total, _MOST_PAIRS, "pairs of triangles that overlap in projection", _SIMPLER)
    one, other = np.concatenate(pairs, axis=1)
    return one, other


def _are_separated(projected: Projected, one: Indices, other: Indices) -> NDArray[np.bool_]:
    """Return a mask (m,) of pairs of triangles that are separated by a side of the first triangle.

    Triangles that only touch count as separated. ``one`` and ``other`` (m,): indices of the
    triangles of each pair.
    """
    apart = np.zeros(len(one), np.bool_)
    points, least = projected.points, NOTHING * projected.size
    for k in range(3):
        begin = points[:, k]
        edge = points[:, (k + 1) % 3] - begin
        edge = edge / np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), least)
        beyond = points[other] - begin[one, None]
        inside = edge[one, 0, None] * beyond[..., 1] - edge[one, 1, None] * beyond[..., 0]
        apart |= inside.max(axis=1) <= least
    return apart


def _nearer_parts(projected: Projected, hidden: Indices, before: Indices) -> tuple[Indices, Shapes]:
    """Return the parts of triangles that lie in front of the planes of other triangles.

    ``hidden`` and ``before``: indices (m,) of pairs of triangles that overlap in projection. For
    each pair, returns the index of the hidden triangle, and the part of the other triangle that
    lies in front of the hidden triangle's plane. Pairs without such a part are omitted.
    """
    slopes = projected.slopes
    offset = projected.points[before] - projected.points[hidden, :1]
    plane = projected.depth[hidden, :1] + (offset * slopes[hidden, None]).sum(axis=2)
    ahead = plane - projected.depth[before]
    steep = 1 + np.abs(slopes[hidden]).sum(axis=1) + np.abs(slopes[before]).sum(axis=1)
    level = (NOTHING * projected.size * steep)[:, None]
    coincide = (np.abs(ahead) <= level).all(axis=1)
    ahead[coincide] = np.where(before < hidden, 1.0, -1.0)[coincide, None]
    ahead[(np.abs(ahead) <= level) & ~coincide[:, None]] = 0.0
    is_ahead = (ahead > 0).any(axis=1)
    hidden, before, ahead = hidden[is_ahead], before[is_ahead], ahead[is_ahead]
    parts = _clipped_where_positive(projected.points[before], ahead)
    flat = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    return hidden[flat], parts[flat]


def _clipped_where_positive(points: Floats, values: Floats) -> Shapes:
    """Return the parts of triangles (n, 3, 2) in which linear functions are positive.

    ``values`` (n, 3): values of each triangle's function at its corners. At least one value per
    triangle is positive.
    """
    following, following_values = np.roll(points, -1, axis=1), np.roll(values, -1, axis=1)
    crosses = (values > 0) != (following_values > 0)
    fraction = (values / np.where(crosses, values - following_values, 1.0))[..., None]
    between = np.where(fraction == 1, following, points + fraction * (following - points))
    candidates = np.stack([points, between], axis=2).reshape(-1, 6, 2)
    used = np.stack([values > 0, crosses], axis=2).reshape(-1, 6)
    owner = np.repeat(np.arange(len(points)), used.sum(axis=1))
    rings = shapely.linearrings(candidates[used], indices=owner)
    parts = np.asarray(shapely.polygons(rings), dtype=object)
    bent = ~shapely.is_valid(parts)
    parts[bent] = shapely.convex_hull(parts[bent])
    return parts


def visible_parts(
    projected: Projected,
    polygons: Shapes,
    illuminated: Shapes,
    boxes: Shapes | None = None,
    grid: float | None = None,
) -> tuple[Indices, Shapes]:
    """Return the illuminated parts of triangles without the parts that other triangles hide.

    ``polygons`` (n,): the triangles in the projection plane. ``illuminated`` (n,): the illuminated
    part of each triangle. ``boxes`` (n,), by default ``polygons``: only triangles with overlapping
    boxes hide each other. ``grid``: grid spacing, required if edges of illuminated parts and edges
    of shadows coincide up to rounding errors.

    Returns the indices (m,) of the partly hidden triangles and their visible parts (m,), which may
    be empty; all other triangles are entirely visible. If two triangles coincide, the first one
    hides the second one. Raises ArgumentError if too many pairs of triangles overlap in projection.
    """
    one, other = _overlapping_pairs(projected, polygons if boxes is None else boxes)
    hidden, before = np.concatenate([one, other]), np.concatenate([other, one])
    crossings = float((np.bincount(hidden).astype(np.float64) ** 2).sum())
    check_most(crossings, _MOST_CROSSINGS, "crossings of edges in projection", _SIMPLER)
    hidden, shadows = _nearer_parts(projected, hidden, before)
    if not len(hidden):
        return hidden, shadows
    order = np.argsort(hidden, kind="stable")
    touched, numbers = np.unique(hidden[order], return_inverse=True)
    shadows = unions(
        shadows[order], numbers, max(projected.size, float(abs(projected.points).max()))
    )
    return touched, differences(illuminated[touched], shadows, grid)


def in_triangles(shapes: Shapes, points: Floats, ranges: Floats) -> Shapes:
    """Convert shapes (m,) in the projection plane to barycentric coordinates of triangles.

    The new coordinates are the weights of the second and third corners in space, not in projection.
    ``points``: corners (m, 3, 2) of the triangles. ``ranges`` (m, 3): see :class:`Projected`.
    """
    vertices, owner = shapely.get_coordinates(shapes, return_index=True)
    inside = barycentric(points, ranges, owner, vertices)[:, 1:]
    return np.asarray(shapely.set_coordinates(shapes.copy(), inside), dtype=object)


def barycentric(points: Floats, ranges: Floats, owner: Indices, at: Floats) -> Floats:
    """Return barycentric coordinates (m, 3), in space, of points (m, 2) in the projection plane.

    ``points`` (n, 3, 2) and ``ranges`` (n, 3): see `Projected`. ``owner`` (m,): index of the
    triangle that contains each point.
    """
    inverse = np.linalg.inv(np.stack([points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]], 2))
    inside = np.einsum("nij,nj->ni", inverse[owner], at - points[owner, 0])
    weights = np.column_stack([1 - inside.sum(axis=1), inside]) / ranges[owner]
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def edges_around(shapes: Shapes) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Return the edges of all shapes: index of the shape (m,), start and end points (m, 2).

    Exteriors are counter-clockwise, holes clockwise.
    """
    single, owner = shapely.get_parts(shapes, return_index=True)
    single, inner = shapely.get_parts(single, return_index=True)
    flat = shapely.get_type_id(single) == shapely.GeometryType.POLYGON
    polygons, owner = single[flat], owner[inner][flat]
    rings, of_polygon = shapely.get_rings(polygons, return_index=True)
    is_hole = of_polygon == np.concatenate([[-1], of_polygon[:-1]])
    points, of_ring = shapely.get_coordinates(rings, return_index=True)
    within = of_ring[1:] == of_ring[:-1]
    of_edge, begin, end = of_ring[1:][within], points[:-1][within], points[1:][within]
    # The orientation of a ring is the sign of its area. The orientation test of shapely is not
    # used, because it examines a single corner, which may be a spike after rounding. The area is
    # computed relative to a vertex of the ring, because a ring may be far smaller than its distance
    # from the origin.
    origin = begin[np.searchsorted(of_edge, of_edge)]
    (x, y), (next_x, next_y) = (begin - origin).T, (end - origin).T
    crosses = x * next_y - y * next_x
    turned = (np.bincount(of_edge, crosses, len(rings)) < 0) != is_hole
    swapped = turned[of_edge][:, None]
    begin, end = np.where(swapped, end, begin), np.where(swapped, begin, end)
    return owner[of_polygon[of_edge]], begin, end


# The following functions correct results of GEOS. GEOS returns lines and points where polygons
# touch, does not accept such results as arguments, and may lose a polygon if edges almost coincide.

# Grid spacing as a fraction of the extent, above rounding errors.
GRID = 1e-14
# Grid spacings tried after a failure of GEOS, as fractions of the extent.
_GRIDS = (GRID, 1e-12, 1e-10)
# Rounding error of areas, as a fraction of the extent times the perimeter.
_ROUNDING = 1e-14


def intersections(one: Shapes, other: Shapes, grid: float | None = None) -> Shapes:
    """Return the intersection of each pair of polygons (m,), which may be an empty polygon.

    ``grid``: spacing of the grid to which vertices are rounded; None for no rounding.
    """
    return _overlay(shapely.intersection, one, other, grid)


def differences(one: Shapes, other: Shapes, grid: float | None = None) -> Shapes:
    """Return the first polygon of each pair without the second polygon, shape (m,).

    ``grid``: spacing of the grid to which vertices are rounded; if None, vertices are rounded only
    for pairs that would otherwise lose area.
    """
    result = _overlay(shapely.difference, one, other, grid)
    if grid is None and len(one):
        common = _overlay(shapely.intersection, one, other, None)
        extent = float(np.abs(shapely.total_bounds(one)).max())
        lost = shapely.area(one) - shapely.area(result) - shapely.area(common)
        some = np.abs(lost) > _ROUNDING * extent * shapely.length(one)
        result[some] = _overlay(shapely.difference, one[some], other[some], GRID * extent)
    return result


def unions(polygons: Shapes, numbers: Indices, extent: float) -> Shapes:
    """Return the unions (k,) of polygons (m,) that have the same number.

    ``numbers`` (m,) ascend from 0 to k - 1. ``extent``: size of the figure.
    """
    groups = np.asarray(shapely.geometrycollections(polygons, indices=numbers))[:, None]
    sums = np.bincount(numbers, shapely.area(polygons))
    try:
        result = shapely.union_all(groups, axis=1)
        some = sums - shapely.area(result) > _ROUNDING * extent**2
        result[some] = shapely.union_all(groups[some], grid_size=GRID * extent, axis=1)
    except GEOSException:
        every = groups[:, 0]
        result = [_retried(partial(shapely.union_all, group), group) for group in every]
    return polygonal(result)


def mended(shapes: Shapes) -> Shapes:
    """Return a copy of shapes (m,); polygons that rounding has made invalid are repaired."""
    bent = ~shapely.is_valid(shapes)
    result, some = shapes.copy(), shapes[bent]
    valid = shapely.make_valid(some, method="structure", keep_collapsed=False)
    both = [polygonal(valid), polygonal(shapely.make_valid(some, method="linework"))]
    change = [np.abs(shapely.area(one) - shapely.area(some)) for one in both]
    change = [
        np.where(shapely.is_valid(one), a, np.inf) for one, a in zip(both, change, strict=True)
    ]
    result[bent] = np.where(change[0] <= change[1], *both)
    return polygonal(result)


def polygonal(shapes: Any) -> Shapes:
    """Return a copy of shapes (m,) without lines and points.

    Shapes without polygons become empty polygons; missing shapes (None) remain.
    """
    result = np.array(shapes, dtype=object)
    kinds = shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON
    mixed = ~np.isin(shapely.get_type_id(result), kinds) & ~shapely.is_missing(result)
    parts, owner = shapely.get_parts(result[mixed], return_index=True)
    # Parts are extracted twice, because geometry collections may be nested.
    parts, inner = shapely.get_parts(parts, return_index=True)
    flat = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    owner, number = np.unique(owner[inner][flat], return_inverse=True)
    result[mixed] = shapely.Polygon()
    if len(owner):
        result[np.flatnonzero(mixed)[owner]] = shapely.multipolygons(parts[flat], indices=number)
    return result


def _overlay(
    operation: Callable[..., BaseGeometry], one: Shapes, other: Shapes, grid: float | None
) -> Shapes:
    """Return the polygonal results of a set operation of shapely on pairs of polygons (m,).

    If GEOS fails, invalid polygons are repaired, and each pair is computed on coarser grids.
    """
    try:
        return polygonal(operation(one, other, grid_size=grid))
    # GEOS does not report which pair of polygons fails, so the pairs are computed one by one.
    except GEOSException:
        pairs = zip(mended(one), mended(other), strict=True)
        return polygonal([_retried(partial(operation, *pair), pair, grid) for pair in pairs])


def _retried(
    compute: Callable[..., BaseGeometry],
    shapes: BaseGeometry | Sequence[BaseGeometry],
    first: float | None = None,
) -> BaseGeometry:
    """Return the result of an operation; while GEOS fails, repeat it on coarser grids.

    ``compute``: function of the keyword ``grid_size``. ``shapes``: operands, whose extent
    determines the grid spacings. ``first``: first grid spacing, or None for no grid. Raises
    GEOSException if the coarsest grid fails too.
    """
    extent = float(np.ptp(shapely.get_coordinates(shapes), axis=0).max(initial=0.0))
    *grids, last = first, *(size * extent for size in _GRIDS)
    for grid in grids:
        with suppress(GEOSException):
            return compute(grid_size=grid)
    return compute(grid_size=last)
