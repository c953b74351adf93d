"""Unions without hairline cracks: coordinates rounded to a grid far below any accuracy asked for.

Polygons that share an edge in exact arithmetic miss each other by some ulp in floating point, and
a plain union keeps the gaps as slivers. On a grid of 2^-44 of the size (6e-14) they close.
Vertices are put back to the exact values they were given with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from polywigner.geometry.exact import Ring
from polywigner.geometry.rings import extent, rings_of_polygon, without_slight_bends

__all__ = [
    "combined_on_grid",
    "grid_size",
    "polygons_in",
    "restored",
    "straightened",
    "union_on_grid",
]

# 256 ulp of a coordinate as large as the size: above the few ulp by which computed vertices are
# off, and a factor 20 below the 1e-12 to which areas and transforms are promised.
_GRID = 2.0**-44


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


def union_on_grid(
    geometries: Sequence[BaseGeometry], originals: Ring | None = None
) -> BaseGeometry:
    """Union of polygons with hairline gaps and overlaps closed and original vertices kept.

    `originals` (n, 2): the vertices to keep exactly; None means those of `geometries`.
    """
    points = shapely.get_coordinates(list(geometries)) if originals is None else originals
    grid = grid_size(points)
    return _cleaned(shapely.union_all(list(geometries), grid_size=grid), points, grid)


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
