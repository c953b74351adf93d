"""Exact arithmetic on vertices: whole numbers, orientations, set operations on a grid."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from polywigner.geometry.rings import extent, rings_of_polygon, without_slight_bends

__all__ = [
    "Ring",
    "area_and_error",
    "combined_on_grid",
    "cross_products",
    "estimated_area",
    "grid_size",
    "groups_apart",
    "orientations",
    "polygons_in",
    "restored",
    "shoelace",
    "signed_area",
    "straightened",
    "total_area",
    "turn",
    "union_on_grid",
    "whole_numbers",
]

Ring = NDArray[np.float64]
"""Vertices of a closed ring, shape (n, 2), the first one not repeated at the end."""

# (3 + 16 u) u with u = 2^-53 bounds the rounding error of the cross product below in units of
# |product 1| + |product 2| (Shewchuk 1997, "ccwerrboundA").
_UNDERFLOW = float(np.finfo(float).tiny)
_CROSS_ERROR = (3.0 + 16.0 * 2.0**-53) * 2.0**-53


def cross_products(a: Ring, b: Ring, c: Ring) -> tuple[Ring, Ring]:
    """Twice the signed area of the triangles (a, b, c), and a bound on its rounding error.

    a, b, c broadcast against each other, shape (..., 2); both results have shape (...).
    """
    first = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1])
    second = (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    return first - second, _CROSS_ERROR * (np.abs(first) + np.abs(second))


def turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Twice the signed area of one triangle (a, b, c), with the exact sign; for scalar loops."""
    first = (b[0] - a[0]) * (c[1] - a[1])
    second = (b[1] - a[1]) * (c[0] - a[0])
    value = first - second
    if abs(value) > _CROSS_ERROR * (abs(first) + abs(second)):
        return value
    ax, ay, bx, by, cx, cy = (Fraction(v) for v in (*a, *b, *c))
    return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))


def orientations(a: Ring, b: Ring, c: Ring) -> NDArray[np.int8]:
    """Exact sign of the turn a -> b -> c: +1 left, -1 right, 0 straight. Shapes as above."""
    a, b, c = np.broadcast_arrays(a, b, c)
    value, bound = cross_products(a, b, c)
    signs = np.sign(value).astype(np.int8)
    near = np.abs(value) <= bound
    if near.any():
        corners, _ = whole_numbers(np.stack([a[near], b[near], c[near]]))
        (bx, by), (cx, cy) = (corners[k].T - corners[0].T for k in (1, 2))
        exact = bx * cy - by * cx
        signs[near] = (exact > 0).astype(np.int8) - (exact < 0).astype(np.int8)
    return signs


def whole_numbers(values: NDArray[np.float64]) -> tuple[NDArray[Any], int]:
    """Finite floats as Python's integers n of the same shape, each of value n * 2^exponent.

    Sums and products of them are exact, and tens of times faster than those of fractions.
    """
    mantissas, exponents = np.frexp(values)
    exponent = int(exponents.min()) - 53
    whole = np.ldexp(mantissas, 53).astype(np.int64).astype(object)
    return whole << (exponents - 53 - exponent).astype(object), exponent


def shoelace(rings: Iterable[Ring]) -> Fraction:
    """Exact sum of the signed areas of rings; counter-clockwise counts positive."""
    rings = list(rings)
    if not rings:
        return Fraction(0)
    whole, exponent = whole_numbers(np.concatenate(rings))
    twice = 0
    for points in np.split(whole, np.cumsum([len(ring) for ring in rings[:-1]])):
        x0, y0 = points[-1]
        for x1, y1 in points.tolist():
            twice += x0 * y1 - x1 * y0
            x0, y0 = x1, y1
    return Fraction(twice) * Fraction(2) ** (2 * exponent - 1)


def signed_area(ring: Ring) -> float:
    """Signed area of one ring, rounded once."""
    return float(shoelace([ring]))


def area_and_error(ring: Ring) -> tuple[float, float]:
    """Signed area of one ring in floating point, and a bound on its rounding error.

    Tens of times as fast as :func:`signed_area`; for coordinates up to 1e150.
    """
    x, y = (ring - ring[0]).T
    first, second = x[:-1] * y[1:], x[1:] * y[:-1]
    twice = float((first - second).sum())
    # u for each difference, two to a product, u for the product, its difference, and each sum: all
    # of at most the sum of the products' sizes, doubled here; and what underflows.
    share = (len(ring) + 8) * 2.0**-53
    error = share * float((np.abs(first) + np.abs(second)).sum()) + len(ring) * _UNDERFLOW
    return twice / 2, error


def estimated_area(ring: Ring) -> float:
    """Signed area of one ring, with the exact sign; for large rings less exact than rounding."""
    area, error = area_and_error(ring)
    return area if abs(area) > error else signed_area(ring)


def total_area(rings: Iterable[Ring]) -> float:
    """Sum of the signed areas of rings, rounded once."""
    return float(shoelace(rings))


# 256 ulp of a coordinate as large as the size: above the few ulp by which computed vertices are
# off, and a factor 20 below the 1e-12 to which areas and transforms are promised.
_GRID = 2.0**-44

# Lines along x and y by turns tell the copies of a lattice apart in two rounds.
_ROUNDS = 32


def grid_size(points: Ring) -> float:
    """A power of two near 2^-44 of the extent (or of the distance from the origin, if larger)."""
    scale = max(extent(points), float(np.abs(points).max()))
    return float(_GRID * 2.0 ** np.ceil(np.log2(scale)))


def polygons_in(geometry: BaseGeometry) -> list[shapely.Polygon]:
    """The polygons of any geometry; points and lines, which have no area, are left out."""
    if geometry.geom_type == "Polygon":
        return [] if geometry.is_empty else [geometry]
    return [p for part in getattr(geometry, "geoms", ()) for p in polygons_in(part)]


def restored(geometry: BaseGeometry, originals: Ring, reach: float) -> BaseGeometry:
    """Move each vertex to the nearest of `originals` (n, 2) within `reach`, if that stays valid."""
    tree = shapely.STRtree(shapely.points(originals))

    def moved(points: Ring) -> Ring:
        index, nearest = tree.query_nearest(
            shapely.points(points), max_distance=reach, all_matches=False
        )
        out = points.copy()
        out[index] = originals[nearest]
        return out

    exact = shapely.transform(geometry, moved)
    return exact if shapely.is_valid(exact) else geometry


def straightened(geometry: BaseGeometry, reach: float) -> BaseGeometry:
    """Drop vertices within `reach` of the line between the kept ones, if that stays valid."""
    parts = [
        [without_slight_bends(ring, reach) for ring in rings_of_polygon(polygon)]
        for polygon in polygons_in(geometry)
    ]
    left = sum(len(ring) + 1 for rings in parts for ring in rings)
    if left >= shapely.get_num_coordinates(geometry):
        return geometry
    polygons = [shapely.Polygon(outer, holes) for outer, *holes in parts]
    simple = polygons[0] if len(polygons) == 1 else shapely.MultiPolygon(polygons)
    return simple if shapely.is_valid(simple) else geometry


def _is_hairline(region: BaseGeometry, width: float) -> bool:
    return bool(region.area <= width * region.length)


def _without_hairlines(polygon: shapely.Polygon, width: float) -> shapely.Polygon:
    """Close holes that are cracks no wider than the grid."""
    holes = [hole for hole in polygon.interiors if not _is_hairline(shapely.Polygon(hole), width)]
    return shapely.Polygon(polygon.exterior, holes)


def groups_apart(geometries: Sequence[BaseGeometry], gap: float) -> list[NDArray[np.intp]]:
    """Numbers of geometries in groups that lines along x and y part from each other by a gap.

    GEOS's union of many that lie apart takes ten times as long as those of the groups.
    """
    bounds = shapely.bounds(list(geometries))
    groups = [np.arange(len(bounds))]
    for turn in range(_ROUNDS):
        axis, parted = turn % 2, []
        for group in groups:
            order = group[np.argsort(bounds[group, axis], kind="stable")]
            reached = np.maximum.accumulate(bounds[order, axis + 2])
            cuts = np.nonzero(bounds[order[1:], axis] > reached[:-1] + gap)[0] + 1
            parted += np.split(order, cuts)
        if turn and len(parted) == len(groups):
            break
        groups = parted
    return [np.sort(group) for group in groups]


def _union(geometries: Sequence[BaseGeometry], grid: float) -> BaseGeometry:
    array = np.array(geometries, dtype=object)
    groups = groups_apart(geometries, 2 * grid)
    if len(groups) == 1:
        return shapely.union_all(array, grid_size=grid)
    found = [
        shapely.union_all(array[group], grid_size=grid) if len(group) > 1 else array[group[0]]
        for group in groups
    ]
    return shapely.MultiPolygon([polygon for part in found for polygon in polygons_in(part)])


def union_on_grid(
    geometries: Sequence[BaseGeometry], originals: Ring | None = None
) -> BaseGeometry:
    """Union of polygons with hairline gaps and overlaps closed and original vertices kept.

    `originals` (n, 2): the vertices to keep exactly; None means those of `geometries`.
    """
    points = shapely.get_coordinates(list(geometries)) if originals is None else originals
    grid = grid_size(points)
    return _cleaned(_union(geometries, grid), points, grid)


def combined_on_grid(
    operation: Callable[..., BaseGeometry], one: BaseGeometry, other: BaseGeometry
) -> BaseGeometry:
    """``shapely.intersection`` or ``shapely.difference`` of two, cleaned as unions are.

    An empty collection where no area is left.
    """
    points = shapely.get_coordinates([one, other])
    grid = grid_size(points)
    found = operation(one, other, grid_size=grid)
    if not any(not _is_hairline(polygon, grid) for polygon in polygons_in(found)):
        return shapely.MultiPolygon()
    return _cleaned(found, points, grid)


def _cleaned(found: BaseGeometry, points: Ring, grid: float) -> BaseGeometry:
    """Without cracks and slivers, with the vertices of ``points`` as they were."""
    polygons = [_without_hairlines(polygon, grid) for polygon in polygons_in(found)]
    wide = [polygon for polygon in polygons if not _is_hairline(polygon, grid)] or polygons
    joined = wide[0] if len(wide) == 1 else shapely.MultiPolygon(wide)
    return straightened(restored(joined, points, grid), grid)
