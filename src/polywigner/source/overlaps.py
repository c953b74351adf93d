"""A warning for arrays whose elements cover the same area."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.affinity import translate

from polywigner.errors import GeometryError
from polywigner.geometry.arguments import warn_caller
from polywigner.geometry.slits import Slits

if TYPE_CHECKING:
    from polywigner.source.array import Array

# The search ends after this many pairs: a table of a million equal positions has 5e11.
_MOST_PAIRS = 1000
# Overlaps below this fraction of an element are rounding errors of elements that touch.
_TOUCHING = 1e-9
# Elements per query of the tree. The first query has one, which is enough if all coincide.
_MOST_ROWS = 4096

Numbers = NDArray[np.intp]
Sizes = NDArray[np.float64]


def warn_of_overlaps(array: Array) -> None:
    """Warn if elements of an array cover the same area, or slits the same length.

    Elements that only touch do not overlap. The warning names the pair with the largest overlap.
    """
    if len(array) < 2:
        return
    try:
        bounds, sizes, shared_areas = _outlines(array)
    except GeometryError:  # elements in space have no common plane
        return
    margins = np.tile(_TOUCHING * (bounds[:, 2:] - bounds[:, :2]), 2) * (1, 1, -1, -1)
    boxes = shapely.box(*(bounds + margins).T)
    tree = shapely.STRtree(boxes)
    overlaps: list[tuple[float, int, int]] = []
    start, rows = 0, 1
    while start < len(boxes) and len(overlaps) < _MOST_PAIRS:
        first, second = tree.query(boxes[start : start + rows])
        first = first + start
        first, second = first[second > first], second[second > first]
        shared = shared_areas(first, second)
        real = shared > _TOUCHING * sizes[first]
        columns = (values[real].tolist() for values in (shared, first, second))
        overlaps += zip(*columns, strict=True)
        start, rows = start + rows, min(2 * rows, _MOST_ROWS)
    if not overlaps:
        return
    area, one, other = max(overlaps, key=lambda pair: (pair[0], -pair[1], -pair[2]))
    more = len(overlaps) - 1
    unit = "m" if array.dimension == 1 else "m^2"
    others = f", and {more} other pair{'s' * (more > 1)}" if more else ""
    limit = " or more" if len(overlaps) >= _MOST_PAIRS else ""
    warn_caller(
        f"elements {one} and {other} overlap by {area:.4g} {unit}{others}{limit}, counted from 0: "
        "their fields add up there; check the positions, their unit and the element's size"
    )


def _outlines(array: Array) -> tuple[Sizes, Sizes, Callable[[Numbers, Numbers], Sizes]]:
    """Bounds (n, 4) and areas (n,) of the elements, and the function for shared areas of pairs."""
    if array.repeated is None:
        shapes = np.array([_shape(element) for element in array.elements_in_plane], object)
        return (
            shapely.bounds(shapes),
            shapely.area(shapes),
            lambda first, second: shapely.area(shapely.intersection(shapes[first], shapes[second])),
        )
    element, positions = array.repeated
    shape = _shape(element)
    shifts = np.column_stack([positions, np.zeros((len(positions), 2 - positions.shape[1]))])
    bounds = shapely.bounds(shape) + np.tile(shifts, 2)
    grid = _TOUCHING * (bounds[0, 2:] - bounds[0, :2])

    def shared_areas(first: Numbers, second: Numbers) -> Sizes:
        # pairs of a lattice have few different distances
        apart = np.round((shifts[second] - shifts[first]) / grid)
        distances, which = np.unique(apart, axis=0, return_inverse=True)
        copies = np.array([translate(shape, *distance) for distance in distances * grid], object)
        areas = np.asarray(shapely.area(shapely.intersection(shape, copies)))
        return areas[which.reshape(-1)]

    return bounds, np.full(len(shifts), shape.area), shared_areas


def _shape(element: Any) -> Any:
    """The outline of an aperture; of slits, rectangles of height 1, whose area is their length."""
    if not isinstance(element, Slits):
        return element.polygons
    begin, end = element.intervals.T
    return shapely.union_all(shapely.box(begin, 0.0, end, 1.0))
