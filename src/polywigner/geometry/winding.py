"""Split rings that cross themselves or each other into simple parts, by winding number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, GeometryError
from polywigner.geometry.exact import Ring, orientations
from polywigner.geometry.grid import grid_size, polygons_in, union_on_grid
from polywigner.geometry.parts import part_of_ring
from polywigner.geometry.rings import Part, clean_ring, part_of_polygon

__all__ = ["enclosed", "split_ring", "winding_numbers"]

# Bounds the memory of one step.
_PAIRS_AT_ONCE = 1_000_000

_RULES = ("nonzero", "evenodd")


def winding_numbers(ring: Ring, points: Ring) -> NDArray[np.int64]:
    """How many times the ring (n, 2) runs counter-clockwise around each of the points (m, 2).

    Counts signed crossings of the ray towards +x, with exact orientations; points on the ring
    itself get the value of one of its sides.
    """
    return _turns(ring, np.roll(ring, -1, axis=0), points)


def _turns(start: Ring, end: Ring, points: Ring) -> NDArray[np.int64]:
    """Winding numbers (m,) of closed rings given by their edges, start and end (n, 2)."""
    tree = shapely.STRtree(shapely.linestrings(np.stack([start, end], axis=1)))
    farthest = np.column_stack([np.full(len(points), start[:, 0].max()), points[:, 1]])
    rays = shapely.linestrings(np.stack([points, farthest], axis=1))
    numbers = np.zeros(len(points), dtype=np.int64)
    step = max(1, _PAIRS_AT_ONCE // len(start))
    for first in range(0, len(points), step):
        # Edges elsewhere do not meet the ray: not even their boxes do.
        place, edge = tree.query(rays[first : first + step])
        place += first
        a, b, point = start[edge], end[edge], points[place]
        side = orientations(a, b, point)
        upward = (a[:, 1] <= point[:, 1]) & (b[:, 1] > point[:, 1]) & (side > 0)
        downward = (a[:, 1] > point[:, 1]) & (b[:, 1] <= point[:, 1]) & (side < 0)
        np.add.at(numbers, place, upward.astype(np.int64) - downward)
    return numbers


def split_ring(vertices: Any, winding: str) -> list[Part]:
    """The parts of the region where the ring's winding number is not zero, or is odd.

    Raises
    ------
    ArgumentError for an unknown `winding`; GeometryError for vertices that do not make a ring, or
    one that encloses no area.
    """
    if winding not in _RULES:
        raise ArgumentError(f"expected winding to be one of {_RULES}, got {winding!r}")
    ring = clean_ring(vertices, "the ring")
    if shapely.is_valid(shapely.Polygon(ring)):
        return [part_of_ring(ring)]
    kept = enclosed([ring], winding)
    if not kept:
        raise GeometryError(
            f"expected a ring that encloses an area, got none by the {winding!r} rule"
        )
    return [part_of_polygon(polygon) for polygon in kept]


def enclosed(rings: Sequence[Ring], winding: str) -> list[shapely.Polygon]:
    """The region that the rings (n, 2) together run around: not zero times, or an odd number.

    The rings may cross themselves and each other. Polygons that are apart or touch in points;
    none where no area is enclosed.
    """
    # Faces of the arrangement of the rings' edges, noded on a grid: passes that differ by rounding
    # only, as in a curve run through twice, then leave no hairline faces between them.
    points = np.concatenate(rings)
    following = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    # One line per ring: GEOS takes many times longer over as many lines as there are edges.
    lines = [shapely.LineString(np.concatenate([ring, ring[:1]])) for ring in rings]
    noded = shapely.union_all(lines, grid_size=grid_size(points))
    faces = polygons_in(shapely.polygonize([noded]))
    inside = shapely.get_coordinates(shapely.point_on_surface(faces)).reshape(-1, 2)
    numbers = _turns(points, following, inside)
    chosen = numbers != 0 if winding == "nonzero" else numbers % 2 == 1
    kept = [face for face, keep in zip(faces, chosen, strict=True) if keep]
    return polygons_in(union_on_grid(kept, points)) if kept else []
