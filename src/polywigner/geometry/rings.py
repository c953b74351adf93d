"""Rings of vertices: exact orientations and areas, cleaning of user input, and plots."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, GeometryError
from polywigner.geometry.arguments import finite_array
from polywigner.quantities import parse_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Ring = NDArray[np.float64]
"""Vertices of a closed ring, shape (n, 2); the first vertex is not repeated."""

Part = tuple[Ring, ...]
"""One polygon: its exterior (counter-clockwise) followed by its holes (clockwise)."""


# Rounding error of a cross product, relative to the sum of the magnitudes of its two products
# (Shewchuk 1997, "ccwerrboundA").
_CROSS_ERROR = (3.0 + 16.0 * 2.0**-53) * 2.0**-53


def area2(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Return twice the signed area of the triangle (a, b, c), positive if it is counter-clockwise.

    The sign is exact.
    """
    first = (b[0] - a[0]) * (c[1] - a[1])
    second = (b[1] - a[1]) * (c[0] - a[0])
    value = first - second
    if abs(value) > _CROSS_ERROR * (abs(first) + abs(second)):
        return value
    ax, ay, bx, by, cx, cy = (Fraction(v) for v in (*a, *b, *c))
    return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))


def orientations(a: Ring, b: Ring, c: Ring) -> NDArray[np.int8]:
    """Return the exact orientation of triangles: 1 counter-clockwise, -1 clockwise, 0 collinear.

    The corners a, b and c have shape (..., 2) and are broadcast against each other.
    """
    a, b, c = np.broadcast_arrays(a, b, c)
    first = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1])
    second = (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    signs = np.sign(first - second).astype(np.int8)
    near = np.abs(first - second) <= _CROSS_ERROR * (np.abs(first) + np.abs(second))
    if near.any():
        corners, _ = whole_numbers(np.stack([a[near], b[near], c[near]]))
        (bx, by), (cx, cy) = (corners[k].T - corners[0].T for k in (1, 2))
        exact = bx * cy - by * cx
        signs[near] = (exact > 0).astype(np.int8) - (exact < 0).astype(np.int8)
    return signs


def whole_numbers(values: NDArray[np.float64]) -> tuple[NDArray[Any], int]:
    """Convert floats to Python integers n and one exponent e, so that n * 2^e is exact.

    Integer arithmetic is exact and tens of times faster than Fractions.
    """
    mantissas, exponents = np.frexp(values)
    exponent = int(exponents.min()) - 53
    whole = np.ldexp(mantissas, 53).astype(np.int64).astype(object)
    return whole << (exponents - 53 - exponent).astype(object), exponent


def shoelace(rings: Iterable[Ring]) -> Fraction:
    """Return the exact total signed area of rings; counter-clockwise rings are positive."""
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


def edges_of_rings(rings: Sequence[Ring]) -> tuple[Ring, Ring]:
    """Return the start and end points (n, 2) of the edges of all rings."""
    return np.concatenate(rings), np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])


def signed_area(ring: Ring) -> float:
    """Return the signed area of one ring, positive if counter-clockwise, with the exact sign."""
    x, y = (ring - ring[0]).T
    first, second = x[:-1] * y[1:], x[1:] * y[:-1]
    area = float((first - second).sum()) / 2
    # The bound is twice the rounding error of the sum.
    error = (len(ring) + 8) * 2.0**-53 * float((np.abs(first) + np.abs(second)).sum())
    return area if abs(area) > error else float(shoelace([ring]))


# Largest area that counts as zero, relative to the diameter times the largest coordinate.
_ZERO_AREA = 2.0**-50


def rounding_tolerance(coordinates: Ring) -> float:
    """Return 64 ulp of the largest coordinate, a bound on the errors of rotations and shifts."""
    return float(2.0**-46 * np.abs(coordinates).max())


def extent(points: NDArray[np.floating[Any]]) -> float:
    """Return the diagonal of the bounding box, an upper bound on the diameter."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def sides_of(bounds: Sequence[float]) -> NDArray[np.float64]:
    """Return the side lengths (d,) of a box given by its lower and upper corners."""
    return np.ptp(np.reshape(bounds, (2, -1)), axis=0)


def without_straight_vertices(ring: Ring) -> Ring:
    """Drop vertices that lie exactly between their neighbours; keep the tips of spikes.

    If fewer than three vertices would remain, the ring is returned unchanged.
    """
    previous, following = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
    is_forward = np.sum((ring - previous) * (following - ring), axis=1) > 0
    corners = ring[~(is_forward & (orientations(previous, ring, following) == 0))]
    return corners if len(corners) >= 3 else ring


def clean_ring(vertices: Any, name: str = "a ring") -> Ring:
    """Return a ring as float64, without repeated and exactly collinear vertices.

    A closing vertex is dropped. Raises GeometryError unless there are three different vertices with
    finite coordinates.
    """
    expected = f"expected {name} to be real numbers of shape (n, 2), without z"
    ring = finite_array(vertices, expected, (None, 2), error=GeometryError)
    # Subnormal numbers become 0.0, because GEOS does not terminate for 5e-324. Without -0.0, equal
    # rings have equal bytes.
    ring[np.abs(ring) < np.finfo(np.float64).tiny] = 0.0
    count = len(np.unique(ring, axis=0))
    if count < 3:
        raise GeometryError(f"expected at least 3 different vertices in {name}, got {count}")
    return without_straight_vertices(ring[np.any(ring != np.roll(ring, 1, axis=0), axis=1)])


def spans_area(ring: Ring) -> bool:
    """Return whether the area of a ring exceeds its rounding error."""
    zero = _ZERO_AREA * extent(ring) * float(np.abs(ring).max())
    return abs(signed_area(ring)) > zero


def hull_spans_area(ring: Ring) -> bool:
    """Return whether the area of a ring's convex hull exceeds its rounding error."""
    return spans_area(shapely.get_coordinates(shapely.convex_hull(shapely.linestrings(ring))))


def oriented(ring: Ring, counter_clockwise: bool) -> Ring:
    """Return the ring, reversed if it has the other orientation."""
    return ring if (signed_area(ring) > 0) == counter_clockwise else ring[::-1]


def polygon_of_part(part: Part) -> shapely.Polygon:
    """Convert a part to a shapely Polygon with the same coordinates."""
    return shapely.Polygon(part[0], part[1:])


def part_of_polygon(polygon: shapely.Polygon) -> Part:
    """Convert a valid shapely Polygon to a part, without vertices on straight lines."""
    outer, *holes = (clean_ring(ring) for ring in rings_of_polygon(polygon))
    return (oriented(outer, True), *(oriented(hole, False) for hole in holes))


def rings_of_polygon(polygon: shapely.Polygon, name: str = "the polygon") -> list[Ring]:
    """Return the rings of a shapely Polygon, exterior first, each closed by its first vertex.

    Raises GeometryError if the polygon is empty or has nonzero heights. ``name``: name in the
    message.
    """
    if polygon.is_empty:
        raise GeometryError(f"expected {name} to have vertices, got an empty polygon")
    if shapely.has_z(polygon):
        heights = shapely.get_coordinates(polygon, include_z=True)[:, 2]
        if np.any(heights != 0) and not np.isnan(heights).all():
            raise GeometryError(
                f"expected {name} in the plane z = 0, got nonzero z coordinates; drop them with "
                "shapely.force_2d(polygon)"
            )
    return [shapely.get_coordinates(ring) for ring in (polygon.exterior, *polygon.interiors)]


_FILL, _LINE = "#9ecae1", "#2166ac"


def plot_rings(rings: Sequence[Ring], ax: Axes | None, unit: str) -> Axes:
    """Plot filled rings (in m) on ``ax`` or on new axes, in a ``unit`` such as "mm"."""
    scale = parse_unit(unit)
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.subplots()[1]
    if not hasattr(ax, "add_patch"):
        raise ArgumentError(f"expected matplotlib axes, got {type(ax).__name__}")
    closed = [np.append(ring, ring[:1], axis=0) for ring in rings]
    draw_rings(ax, closed, scale, facecolor=_FILL, edgecolor=_LINE)
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.set_xlabel(f"x ({unit})")
    ax.set_ylabel(f"y ({unit})")
    return ax


def draw_rings(ax: Axes, rings: Sequence[Ring], metres: float, **style: Any) -> None:
    """Draw rings in m, which repeat their first vertex at the end, as one patch.

    Rings of the opposite orientation are holes. ``metres``: unit of the axes in m. ``style``:
    arguments of matplotlib's PathPatch.
    """
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    paths: list[Any] = [Path(ring / metres, closed=True) for ring in rings]
    path = Path.make_compound_path(*paths)
    ax.add_patch(PathPatch(path, **style))
    ax.update_datalim(path.vertices)
