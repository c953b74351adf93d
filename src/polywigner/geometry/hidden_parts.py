"""The parts of triangles in a figure that other triangles hide, as exact polygons.

Radar cross sections use the visible parts as surfaces, and silhouettes use their contours. The set
operations on arrays of polygons are at the end of the module.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.errors import GEOSException

from polywigner.errors import ArgumentError

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Shapes = NDArray[np.object_]

# Lengths that count as none, as a fraction of the size of the whole: a hundred times what rounding
# does to a projection, and still too little to shadow anything.
NOTHING = 1e-12
# Least width of triangles that are cut, in the same unit: parts whose area is below NOTHING times
# their outline count as hidden, and whole triangles must be larger.
_WIDTH = 8.0
# Pairs of triangles that overlap as they are seen: half a gigabyte of polygons. Of long ones that
# stand before one, any two may cross: so many take a minute or two.
_MOST_PAIRS, _BLOCK, _MOST_CROSSINGS = 1 << 20, 256, 2e7


@dataclass(frozen=True, eq=False)
class Projected:
    """Triangles (n,) as seen along a direction, counter-clockwise."""

    points: Floats
    """(n, 3, 2) corners across the direction."""
    depth: Floats
    """(n, 3) of the corners along the direction; a smaller depth is nearer to the observer."""
    size: float
    """Size of the whole body."""
    ranges: Floats
    """(n, 3) of the corners from an observer who is near, relative to each other; far away, 1."""

    @cached_property
    def sides(self) -> Floats:
        """(n, 2, 2) from the first corner to the others."""
        return np.asarray(self.points[:, 1:] - self.points[:, :1])

    @cached_property
    def area(self) -> Floats:
        """(n,) twice the area."""
        first, second = self.sides[:, 0], self.sides[:, 1]
        return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])

    @property
    def has_width(self) -> NDArray[np.bool_]:
        """(n,) whether they are more than lines, after rounding."""
        longest = np.linalg.norm(self.sides, axis=2).max(axis=1)
        return np.asarray(self.area > _WIDTH * NOTHING * self.size * longest)

    @property
    def slopes(self) -> Floats:
        """Change of depth with the place (n, 2)."""
        rise = self.depth[:, 1:] - self.depth[:, :1]
        across = rise[:, 0] * self.sides[:, 1, 1] - rise[:, 1] * self.sides[:, 0, 1]
        along = rise[:, 1] * self.sides[:, 0, 0] - rise[:, 0] * self.sides[:, 1, 0]
        return np.asarray(np.stack([across, along], axis=1) / self.area[:, None])

    def taken(self, rows: NDArray[np.bool_]) -> Projected:
        return Projected(self.points[rows], self.depth[rows], self.size, self.ranges[rows])


def in_perspective(corners: Floats, frame: Floats, distance: float, size: float) -> Projected:
    """Return triangles (n, 3, 3) as an observer at the origin sees them, all in front.

    Parameters
    ----------
    corners : (n, 3, 3) corners of the triangles.
    frame : rows x, y, z of the observer, who looks along z.
    distance : distance of the plane onto which the triangles are projected.
    size : size of the whole, to which lengths that count as none are relative.

    Notes
    -----
    The map is projective: it makes lines through the observer parallel and keeps planes plane.
    """
    x, y, z = np.moveaxis(corners @ frame.T, -1, 0)
    scale = distance / z
    points = np.stack([x * scale, -y * scale], axis=-1)
    return Projected(points, distance * (1 - scale), size, z / distance)


def _too_many(triangles: int) -> ArgumentError:
    return ArgumentError(
        f"expected a body whose triangles hardly overlap as they are seen, got {triangles} of "
        "which too many do; leave out what is hidden, or simplify the mesh"
    )


def _overlapping(seen: Projected, polygons: Shapes) -> tuple[Indices, Indices]:
    """Numbers of both triangles (m,) of pairs that overlap, each once.

    ``polygons``: the triangles or boxes around them; only those whose boxes meet are compared.
    """
    tree, found, total = shapely.STRtree(polygons), [np.empty((2, 0), np.intp)], 0
    for start in range(0, len(polygons), _BLOCK):
        one, other = tree.query(polygons[start : start + _BLOCK])
        once = one + start < other
        one, other = one[once] + start, other[once]
        apart = _apart(seen, one, other) | _apart(seen, other, one)
        found.append(np.stack([one[~apart], other[~apart]]))
        total += found[-1].shape[1]
        if total > _MOST_PAIRS:
            raise _too_many(len(polygons))
    one, other = np.concatenate(found, axis=1)
    return one, other


def _apart(seen: Projected, one: Indices, other: Indices) -> NDArray[np.bool_]:
    """Whether an edge of the one separates both."""
    apart = np.zeros(len(one), np.bool_)
    points, least = seen.points, NOTHING * seen.size
    for k in range(3):
        begin = points[:, k]
        edge = points[:, (k + 1) % 3] - begin
        edge = edge / np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), least)
        beyond = points[other] - begin[one, None]
        inside = edge[one, 0, None] * beyond[..., 1] - edge[one, 1, None] * beyond[..., 0]
        apart |= inside.max(axis=1) <= least
    return apart


def _before_planes(
    seen: Projected, polygons: Shapes, hidden: Indices, before: Indices, bodies: Indices
) -> tuple[NDArray[np.bool_], Indices, Shapes]:
    """Convex bodies that are entirely in front of the planes of triangles that they overlap.

    Returns which pairs these are, and once for each the hidden triangle and the body's outline.
    """
    whole = np.zeros(len(hidden), np.bool_)
    numbers, outlines = [np.empty(0, np.intp)], [np.empty(0, object)]
    slopes, label = seen.slopes, bodies[before]
    order = np.argsort(label, kind="stable")
    starts = np.flatnonzero(np.diff(label[order], prepend=-1))
    for pairs in np.split(order, starts) if len(starts) else ():
        if not len(pairs) or label[pairs[0]] < 0:
            continue
        members = np.flatnonzero(bodies == label[pairs[0]])
        rows, which = np.unique(hidden[pairs], return_inverse=True)
        if len(members) < 2 or len(pairs) < 2 * len(rows):
            continue
        points, depth = seen.points[members].reshape(-1, 2), seen.depth[members].ravel()
        plane = seen.depth[rows, :1] - (seen.points[rows, 0] * slopes[rows]).sum(axis=1)[:, None]
        ahead = plane + slopes[rows] @ points.T - depth
        level = NOTHING * seen.size * (1 + np.abs(slopes[rows]).sum(axis=1))
        # of two that coincide only one hides the other: these are compared one by one
        in_front = (ahead >= -level[:, None]).all(axis=1) & (ahead > level[:, None]).any(axis=1)
        if in_front.any():
            whole[pairs[in_front[which]]] = True
            extent = max(seen.size, float(np.abs(points).max()))
            outline = unions(polygons[members], np.zeros(len(members), np.intp), extent)
            numbers.append(rows[in_front])
            outlines.append(np.repeat(outline, len(numbers[-1])))
    return whole, np.concatenate(numbers), np.concatenate(outlines)


def _nearer_parts(seen: Projected, hidden: Indices, before: Indices) -> tuple[Indices, Shapes]:
    """Numbers of hidden triangles, and the parts of others nearer than the planes of these."""
    slopes = seen.slopes
    place = seen.points[before] - seen.points[hidden, :1]
    plane = seen.depth[hidden, :1] + (place * slopes[hidden, None]).sum(axis=2)
    ahead = plane - seen.depth[before]  # how far the corners stand before the hidden plane
    steep = 1 + np.abs(slopes[hidden]).sum(axis=1) + np.abs(slopes[before]).sum(axis=1)
    level = (NOTHING * seen.size * steep)[:, None]
    coincide = (np.abs(ahead) <= level).all(axis=1)
    ahead[coincide] = np.where(before < hidden, 1.0, -1.0)[coincide, None]
    ahead[(np.abs(ahead) <= level) & ~coincide[:, None]] = 0.0
    stands = (ahead > 0).any(axis=1)
    hidden, before, ahead = hidden[stands], before[stands], ahead[stands]
    parts = _cut(seen.points[before], ahead)
    flat = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    return hidden[flat], parts[flat]


def _cut(points: Floats, ahead: Floats) -> Shapes:
    """The parts of triangles (n, 3, 2) where a linear function, given at the corners, is positive.

    It is so at one corner at least (Sutherland and Hodgman 1974). Parts without area may be lines.
    """
    following, there = np.roll(points, -1, axis=1), np.roll(ahead, -1, axis=1)
    crosses = (ahead > 0) != (there > 0)
    share = (ahead / np.where(crosses, ahead - there, 1.0))[..., None]
    between = np.where(share == 1, following, points + share * (following - points))
    candidates = np.stack([points, between], axis=2).reshape(-1, 6, 2)
    kept = np.stack([ahead > 0, crosses], axis=2).reshape(-1, 6)
    owner = np.repeat(np.arange(len(points)), kept.sum(axis=1))
    rings = shapely.linearrings(candidates[kept], indices=owner)
    parts = np.asarray(shapely.polygons(rings), dtype=object)
    bent = ~shapely.is_valid(parts)  # by rounding: they are convex
    parts[bent] = shapely.convex_hull(parts[bent])
    return parts


def less_shadows(
    seen: Projected,
    polygons: Shapes,
    lit: Shapes,
    boxes: Shapes | None = None,
    grid: float | None = None,
    bodies: Indices | None = None,
) -> tuple[Indices, Shapes]:
    """Return numbers of triangles behind others (m,), and their lit parts less the shadows.

    ``polygons``: the triangles as such; ``lit``: the part of each triangle; ``boxes``: around the
    triangles, those of several pictures apart; None: of one picture; ``grid``: of corners, where
    edges of lit parts may be those of shadows but for rounding; ``bodies``: numbers (n,) of the
    convex bodies that the triangles belong to, whose faces cast one shadow; -1 for none.
    Of two triangles that coincide the first one hides the other.

    Raises ArgumentError for more pairs that overlap than fit in memory.
    """
    one, other = _overlapping(seen, polygons if boxes is None else boxes)
    hidden, before = np.concatenate([one, other]), np.concatenate([other, one])
    covered, covers = np.empty(0, np.intp), np.empty(0, object)
    if bodies is not None:
        whole, covered, covers = _before_planes(seen, polygons, hidden, before, bodies)
        hidden, before = hidden[~whole], before[~whole]
    if float((np.bincount(hidden).astype(np.float64) ** 2).sum()) > _MOST_CROSSINGS:
        raise _too_many(len(polygons))
    hidden, shadows = _nearer_parts(seen, hidden, before)
    hidden, shadows = np.concatenate([hidden, covered]), np.concatenate([shadows, covers])
    if not len(hidden):
        return hidden, shadows
    order = np.argsort(hidden, kind="stable")
    touched, numbers = np.unique(hidden[order], return_inverse=True)
    shadows = unions(shadows[order], numbers, max(seen.size, float(abs(seen.points).max())))
    return touched, differences(lit[touched], shadows, grid)


def in_triangles(shapes: Shapes, points: Floats, ranges: Floats) -> Shapes:
    """Shapes (m,) of the picture in coordinates of triangles (m, 3, 2), as :class:`Projected`."""
    inverse = np.linalg.inv(np.stack([points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]], 2))
    places, owner = shapely.get_coordinates(shapes, return_index=True)
    inside = np.einsum("nij,nj->ni", inverse[owner], places - points[owner, 0])
    shares = np.column_stack([1 - inside.sum(axis=1), inside]) / ranges[owner]
    inside = shares[:, 1:] / shares.sum(axis=1, keepdims=True)
    return np.asarray(shapely.set_coordinates(shapes.copy(), inside), dtype=object)


def edges_around(shapes: Shapes) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Return numbers (m,) of shapes, and starts and ends (m, 2) of the edges of their polygons.

    Exteriors are counter-clockwise, holes clockwise.
    """
    single, owner = shapely.get_parts(shapes, return_index=True)
    single, inner = shapely.get_parts(single, return_index=True)  # polygons in collections
    flat = shapely.get_type_id(single) == shapely.GeometryType.POLYGON
    polygons, owner = single[flat], owner[inner][flat]
    rings, of_polygon = shapely.get_rings(polygons, return_index=True)
    is_hole = of_polygon == np.concatenate([[-1], of_polygon[:-1]])
    points, of_ring = shapely.get_coordinates(rings, return_index=True)
    within = of_ring[1:] == of_ring[:-1]
    of_edge, begin, end = of_ring[1:][within], points[:-1][within], points[1:][within]
    # By area: shapely looks at one corner, which after rounding may be that of a spike.
    crosses = begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0]
    turned = (np.bincount(of_edge, crosses, len(rings)) < 0) != is_hole
    swapped = turned[of_edge][:, None]
    begin, end = np.where(swapped, end, begin), np.where(swapped, begin, end)
    return owner[of_polygon[of_edge]], begin, end


# Set operations on arrays of polygons that return polygons only. GEOS also returns the lines and
# points along which polygons touch, refuses these mixtures as arguments, fails at times where edges
# almost coincide, and may then lose a polygon silently.

# Grid of set operations as a fraction of the figure: above rounding, far below what is cut.
GRID = 1e-14
# Grids where GEOS fails, as fractions of the extent. The last one moves edges by less than rounding
# to single precision does.
_GRIDS = (GRID, 1e-12, 1e-10)
# Rounding of areas, as a fraction of the extent times a length of the outline.
_ROUNDING = 1e-14


def intersections(one: Shapes, other: Shapes, grid: float | None = None) -> Shapes:
    """Intersections (m,) of polygons (m,) and (m,); ``grid``: of their corners."""
    return _overlay(shapely.intersection, one, other, grid)


def differences(one: Shapes, other: Shapes, grid: float | None = None) -> Shapes:
    """Polygons (m,) less other polygons (m,); ``grid``: of their corners.

    Without a grid GEOS may lose a narrow polygon. It has done so if the area is less than that of
    the polygon less the intersection.
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
    """Unions of the polygons (m,) that have the same number.

    Parameters
    ----------
    polygons : (m,) polygons.
    numbers : (m,) their numbers from 0 on, in ascending order.
    extent : a length of the figure.

    Notes
    -----
    GEOS may lose one of two polygons whose common edges differ by rounding. It does not on a grid,
    which takes twice as long. The grid is used only if areas show an overlap or a loss.
    """
    groups = np.asarray(shapely.geometrycollections(polygons, indices=numbers))[:, None]
    sums = np.bincount(numbers, shapely.area(polygons))
    try:
        result = shapely.union_all(groups, axis=1)  # along an axis of length one: of each group
        some = sums - shapely.area(result) > _ROUNDING * extent**2
        result[some] = shapely.union_all(groups[some], grid_size=GRID * extent, axis=1)
    except GEOSException:
        every = groups[:, 0]
        result = [_alone(partial(shapely.union_all, group), group) for group in every]
    return polygonal(result)


def mended(shapes: Shapes) -> Shapes:
    """Polygons made valid: without spikes turned inside out or holes over the edge by rounding.

    Each of GEOS' methods may lose a part, so the result with the more similar area is taken.
    """
    bent = ~shapely.is_valid(shapes)
    result, some = shapes.copy(), shapes[bent]
    methods: tuple[dict[str, Any], ...] = (
        {"method": "structure", "keep_collapsed": False},
        {"method": "linework"},
    )
    both = [polygonal(shapely.make_valid(some, **how)) for how in methods]
    change = [np.abs(shapely.area(one) - shapely.area(some)) for one in both]
    change = [
        np.where(shapely.is_valid(one), a, np.inf) for one, a in zip(both, change, strict=True)
    ]
    result[bent] = np.where(change[0] <= change[1], *both)
    return polygonal(result)


def polygonal(shapes: Any) -> Shapes:
    """Shapes (m,) without their lines and points."""
    result = np.array(shapes, dtype=object)
    kinds = shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON
    mixed = ~np.isin(shapely.get_type_id(result), kinds) & ~shapely.is_missing(result)
    parts, owner = shapely.get_parts(result[mixed], return_index=True)
    parts, inner = shapely.get_parts(parts, return_index=True)  # of collections in collections
    flat = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    owner, number = np.unique(owner[inner][flat], return_inverse=True)
    result[mixed] = shapely.Polygon()
    if len(owner):
        result[np.flatnonzero(mixed)[owner]] = shapely.multipolygons(parts[flat], indices=number)
    return result


def _overlay(
    operation: Callable[..., Any], one: Shapes, other: Shapes, grid: float | None
) -> Shapes:
    try:
        return polygonal(operation(one, other, grid_size=grid))
    except GEOSException:  # does not name the pair that fails
        pairs = zip(mended(one), mended(other), strict=True)
        return polygonal([_alone(partial(operation, *pair), pair, grid) for pair in pairs])


def _alone(compute: Callable[..., Any], shapes: Any, first: float | None = None) -> Any:
    """Return the result of one operation on the first grid on which GEOS does not fail."""
    extent = float(np.ptp(shapely.get_coordinates(shapes), axis=0).max(initial=0.0))
    *grids, last = first, *(size * extent for size in _GRIDS)
    for grid in grids:
        with suppress(GEOSException):
            return compute(grid_size=grid)
    return compute(grid_size=last)
