"""Unions without hairline cracks: coordinates rounded to a grid far below any accuracy asked for.

Polygons that share an edge in exact arithmetic miss each other by some ulp in floating point, and
a plain union keeps the gaps as slivers. On a grid of 2^-44 of the size (6e-14) they close.
Vertices are put back to the exact values they were given with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from polywigner.geometry.exact import Ring
from polywigner.geometry.rings import extent, rings_of_polygon, without_slight_bends

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
