"""Set operations on arrays of polygons that return polygons only.

GEOS also returns the lines and points along which polygons touch, refuses these mixtures as
arguments, fails at times where edges almost coincide, and may then lose a polygon silently.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.errors import GEOSException

Shapes = NDArray[np.object_]

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


def unions(polygons: Shapes, numbers: NDArray[np.intp], extent: float) -> Shapes:
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
