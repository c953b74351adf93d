"""Rings of vertices: exact orientation and area, and clean rings from the input of callers.

Clean rings are float64 and finite, without repeated vertices, and of known orientation.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.arguments import finite_array

Ring = NDArray[np.float64]
"""Vertices of a closed ring, shape (n, 2), the first one not repeated at the end."""

Part = tuple[Ring, ...]
"""One polygon: its exterior (counter-clockwise) followed by its holes (clockwise)."""

# Exact predicates: a filter settles nearly every case in floating point, whole numbers do the rest.

# (3 + 16 u) u with u = 2^-53 bounds the rounding error of the cross product below in units of
# |product 1| + |product 2| (Shewchuk 1997, "ccwerrboundA").
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
    """Signed area of one ring, with the exact sign; rounded once where rounding matters."""
    x, y = (ring - ring[0]).T
    first, second = x[:-1] * y[1:], x[1:] * y[:-1]
    area = float((first - second).sum()) / 2
    # u for each difference, two to a product, u for the product, its difference, and each sum: all
    # of at most the sum of the products' sizes, doubled here.
    error = (len(ring) + 8) * 2.0**-53 * float((np.abs(first) + np.abs(second)).sum())
    return area if abs(area) > error else float(shoelace([ring]))


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
    expected = f"expected {name} as an (n, 2) array of real numbers, without z"
    # + 0.0 turns -0.0 into 0.0, so that content compares
    ring = finite_array(vertices, expected, (None, 2), error=GeometryError) + 0.0
    count = different_vertices(ring)
    if count < 3:
        raise GeometryError(f"expected at least 3 different vertices in {name}, got {count}")
    return without_straight_vertices(_without_repeats(ring))


def spans_area(ring: Ring) -> bool:
    """Whether the ring's area is more than rounding of its coordinates could make it."""
    zero = _ZERO_AREA * extent(ring) * float(np.abs(ring).max())
    return abs(signed_area(ring)) > zero


def hull_spans_area(ring: Ring) -> bool:
    """Whether the vertices are apart from one line; the areas of a figure of eight cancel."""
    return spans_area(shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(ring))))


def oriented(ring: Ring, counter_clockwise: bool) -> Ring:
    """The ring, reversed if it has the other orientation."""
    return ring if (signed_area(ring) > 0) == counter_clockwise else ring[::-1]


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
