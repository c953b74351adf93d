"""Rings of callers made clean: float64, finite, no repeats, known orientation."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.arguments import real_numbers
from polywigner.geometry.exact import (
    Ring,
    area_and_error,
    cross_products,
    estimated_area,
    orientations,
    signed_area,
)

Part = tuple[Ring, ...]
"""One polygon: its exterior (counter-clockwise) followed by its holes (clockwise)."""

# Beyond these the area over- or underflows float64; a change of unit is the answer.
LARGEST_COORDINATE = 1e100
SMALLEST_EXTENT = 1e-100

# Points on a slanted line are off it by about one unit in the last place u = 2^-53 of the largest
# coordinate m, so such a ring of diameter d spans an area up to a few u * m * d: that is "zero".
_ZERO_AREA = 2.0**-50


def rounding_tolerance(coordinates: Ring) -> float:
    """64 ulp of the largest coordinate: more than rotating, shifting and printing move a vertex."""
    return float(2.0**-46 * np.abs(coordinates).max())


def extent(points: Ring) -> float:
    """Diagonal of the bounding box, an upper bound on the diameter."""
    size = points.max(axis=0) - points.min(axis=0)
    return float(np.hypot(size[0], size[1]))


def _as_array(vertices: Any, name: str) -> NDArray[np.float64]:
    expected = f"expected {name} as an (n, 2) array of real numbers"
    try:
        array = real_numbers(vertices)
    except ValueError as error:
        raise GeometryError(f"{expected}, got {error}") from None
    if array.ndim != 2 or array.shape[1] != 2:
        hint = "; drop the z column" if array.ndim == 2 and array.shape[1] == 3 else ""
        raise GeometryError(f"{expected}, got shape {array.shape}{hint}")
    return array


def _without_repeats(ring: Ring) -> Ring:
    """Drop vertices equal to their predecessor, the closing one included."""
    return ring[np.any(ring != np.roll(ring, 1, axis=0), axis=1)]


def without_straight_vertices(ring: Ring) -> Ring:
    """Drop vertices that lie exactly on the segment between their neighbours.

    The tips of spikes (out and straight back) are kept, so that validation finds them.
    """
    before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
    onward = np.sum((ring - before) * (after - ring), axis=1) > 0
    kept = ring[~(onward & (orientations(before, ring, after) == 0))]
    return kept if len(kept) >= 3 else ring


def _certainly_within(points: Ring, start: Ring, end: Ring, reach: float) -> NDArray[np.bool_]:
    """Mask of points that lie within reach of segments, whatever the rounding."""
    chord = end - start
    value, bound = cross_products(start, end, points)
    near = np.abs(value) + bound <= reach * np.hypot(chord[..., 0], chord[..., 1])
    between = np.sum((points - start) * chord, axis=-1) > 0
    return near & between & (np.sum((end - points) * chord, axis=-1) > 0)


def without_slight_bends(ring: Ring, reach: float) -> Ring:
    """Drop vertices within `reach` of the segment between the kept vertices next to them.

    Runs of such vertices go or stay as a whole, so that a second pass changes nothing and it does
    not matter where the ring starts. A closing repeat is dropped.
    """
    ring = _without_repeats(ring)
    slight = _certainly_within(ring, np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0), reach)
    anchors = np.nonzero(~slight)[0]
    if len(anchors) < 3 or len(anchors) == len(ring):
        return ring
    run = np.cumsum(~slight)[slight] - 1  # the number of the anchor before; -1 is the last one
    first, last = ring[anchors[run]], ring[anchors[(run + 1) % len(anchors)]]
    bent = ~_certainly_within(ring[slight], first, last, reach)
    keep = ~slight
    keep[slight] = np.isin(run % len(anchors), run[bent] % len(anchors))
    return ring[keep]


def different_vertices(ring: Ring) -> int:
    """Number of different vertices of a ring; 3 for more than three."""
    for count in range(3):
        if not len(ring):
            return count
        ring = ring[(ring != ring[0]).any(axis=1)]
    return 3


def clean_ring(vertices: Any, name: str = "a ring") -> Ring:
    """Return one ring as float64 without repeats and straight vertices, in its own orientation.

    GeometryError for anything but at least three different, finite vertices.
    """
    ring = _as_array(vertices, name)
    if not np.isfinite(ring).all():
        row = int(np.argmin(np.isfinite(ring).all(axis=1)))
        x, y = ring[row]
        raise GeometryError(
            f"expected finite coordinates in {name}, got ({x}, {y}) as vertex {row}; remove it"
        )
    if len(ring) and np.abs(ring).max() > LARGEST_COORDINATE:
        raise GeometryError(
            f"expected coordinates below {LARGEST_COORDINATE:g} in {name}, "
            f"got {np.abs(ring).max():g}; choose a larger unit"
        )
    ring = ring + 0.0  # turns -0.0 into 0.0, so that content compares
    count = different_vertices(ring)
    if count < 3:
        raise GeometryError(f"expected at least 3 different vertices in {name}, got {count}")
    size = extent(ring)
    if size < SMALLEST_EXTENT:
        raise GeometryError(
            f"expected {name} to be larger than {SMALLEST_EXTENT:g}, got a size of {size:g}; "
            "choose a smaller unit"
        )
    return without_straight_vertices(_without_repeats(ring))


def spans_area(ring: Ring) -> bool:
    """Whether the ring's area is more than rounding of its coordinates could make it."""
    zero = _ZERO_AREA * extent(ring) * float(np.abs(ring).max())
    area, error = area_and_error(ring)
    if abs(abs(area) - zero) <= error:
        area = signed_area(ring)
    return abs(area) > zero


def hull_spans_area(ring: Ring) -> bool:
    """Whether the vertices are apart from one line; the areas of a figure of eight cancel."""
    return spans_area(shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(ring))))


def oriented(ring: Ring, counter_clockwise: bool) -> Ring:
    """The ring, reversed if it does not run the way asked for."""
    return ring if (estimated_area(ring) > 0) == counter_clockwise else ring[::-1]


def polygon_of_part(part: Part) -> shapely.Polygon:
    """The part as a shapely Polygon, same floats."""
    return shapely.Polygon(part[0], part[1:])


def part_of_polygon(polygon: shapely.Polygon) -> Part:
    """The rings of a valid shapely Polygon as a part."""
    outer, *holes = (clean_ring(ring) for ring in rings_of_polygon(polygon))
    return (oriented(outer, True), *(oriented(hole, False) for hole in holes))


def rings_of_polygon(polygon: shapely.Polygon, name: str = "the polygon") -> list[Ring]:
    """The vertices of a shapely Polygon as they are, exterior first; heights must be zero."""
    if polygon.is_empty:
        raise GeometryError(f"expected {name} to have vertices, got an empty polygon")
    if shapely.has_z(polygon):
        heights = shapely.get_coordinates(polygon, include_z=True)[:, 2]
        if np.any(heights != 0) and not np.isnan(heights).all():
            raise GeometryError(
                f"expected {name} in the plane z = 0, got other heights; "
                "drop them with shapely.force_2d(polygon)"
            )
    return [shapely.get_coordinates(ring) for ring in (polygon.exterior, *polygon.interiors)]
