"""Tilings of outlines: triangles, convex pieces, and trapezoids for random points.

Trapezoids keep stratified samples of the unit square stratified; triangles would fold the square.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.rings import (
    Part,
    Ring,
    area2,
    edges_of_rings,
    orientations,
    polygon_of_part,
    shoelace,
)
from polywigner.numerics import Indices


def triangulate_part(part: Part) -> tuple[Ring, Indices]:
    """Return constrained Delaunay triangles: vertices (n, 2), counter-clockwise indices (m, 3).

    Triangles may have zero area. Raises GeometryError if they do not tile the part exactly.
    """
    polygons = shapely.constrained_delaunay_triangles(polygon_of_part(part))
    corners = shapely.get_coordinates(polygons).reshape(-1, 4, 2)[:, :3] + 0.0
    vertices, numbers = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    triangles = numbers.reshape(-1, 3)
    if shoelace(vertices[triangles]) < 0:
        triangles = triangles[:, ::-1]
    if shoelace(vertices[triangles]) != shoelace(part):
        raise GeometryError(
            "expected an outline that can be triangulated, got triangles whose total area "
            "differs from the area of the outline; round its coordinates, for example with "
            "shapely.set_precision"
        )
    return vertices, triangles


def _merged_triangles(
    vertices: Ring, triangles: Indices, diagonals: Sequence[Sequence[int]]
) -> list[list[int]]:
    """Merge triangles across diagonals, in the order of the diagonals, if the result is convex.

    ``diagonals``: pairs of vertex indices. Returns the vertex indices of each convex polygon.
    """
    points = [(float(x), float(y)) for x, y in vertices]
    pieces: list[list[int]] = triangles.tolist()
    # Index of the piece on the left of each directed edge.
    owner = {(piece[k - 1], piece[k]): n for n, piece in enumerate(pieces) for k in range(3)}
    for i, j in diagonals:
        left, right = owner[i, j], owner[j, i]
        ahead, back = pieces[left], pieces[right]
        p, q = ahead.index(j), back.index(i)
        at_i = ahead[p - 2], i, back[(q + 1) % len(back)]
        at_j = back[q - 2], j, ahead[(p + 1) % len(ahead)]
        if left == right or any(area2(*(points[k] for k in at)) < 0 for at in (at_i, at_j)):
            continue
        merged = (ahead[p:] + ahead[:p])[:-1] + (back[q:] + back[:q])[:-1]
        pieces[left], pieces[right] = merged, []
        for k in range(len(merged)):
            owner[merged[k - 1], merged[k]] = left
        del owner[i, j], owner[j, i]
    return [piece for piece in pieces if piece]


def convex_pieces(part: Part) -> list[Ring]:
    """Split a part into convex counter-clockwise polygons without new vertices.

    Delaunay triangles are merged greedily, which gives at most four times the minimum number of
    pieces (Hertel and Mehlhorn 1983).
    """
    if len(part) == 1:
        ring = part[0]
        if np.all(orientations(np.roll(ring, 1, axis=0), ring, np.roll(ring, -1, axis=0)) >= 0):
            return [ring]
    vertices, triangles = triangulate_part(part)
    edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    # Each diagonal occurs twice, once in each direction. Each side of the outline occurs once.
    ends, counts = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    ends = ends[counts == 2]
    lengths = np.hypot(*(vertices[ends[:, 1]] - vertices[ends[:, 0]]).T)
    shortest_first = ends[np.argsort(lengths, kind="stable")].tolist()
    covers = [
        _merged_triangles(vertices, triangles, diagonals)
        for diagonals in (shortest_first[::-1], shortest_first)
    ]
    pieces = [vertices[piece] for piece in min(covers, key=len)]
    return [piece for piece in pieces if shoelace([piece]) > 0]


def mean_polygon(first: Ring, second: Ring) -> Ring:
    """Return the convex polygon of all midpoints (a + b)/2 of two convex rings.

    The rings (n, 2) and (m, 2) are counter-clockwise. The polygon (n + m, 2) may have collinear
    vertices.
    """
    rings, angles = [], []
    for ring in (first, second):
        lowest_first = np.roll(ring, -int(np.lexsort(ring.T)[0]), axis=0)
        side = np.roll(lowest_first, -1, axis=0) - lowest_first
        direction = np.arctan2(side[:, 1], side[:, 0]) % (2 * np.pi)
        rings.append(lowest_first)
        # Angles are made ascending, because rounding may swap the directions of two sides.
        angles.append(np.maximum.accumulate(direction))
    is_of_second = np.argsort(np.concatenate(angles), kind="stable") >= len(first)
    k: NDArray[np.intp] = np.cumsum(is_of_second) - is_of_second
    j = np.arange(len(is_of_second)) - k
    a, b = rings
    return np.asarray(a[j % len(a)] / 2 + b[k % len(b)] / 2)


# Largest area of dropped trapezoids, as a fraction of the total area; single precision does not
# resolve smaller trapezoids.
_NEGLIGIBLE = 1e-12

# Smallest divisor. Single precision does not round this number to zero.
_TINY = 1e-30


class Trapezoids(NamedTuple):
    """Trapezoids with vertical parallel sides; all fields are in metres, with shape (n,)."""

    left: NDArray[np.float64]
    width: NDArray[np.float64]
    height_left: NDArray[np.float64]
    height_right: NDArray[np.float64]
    low_left: NDArray[np.float64]
    low_right: NDArray[np.float64]

    @property
    def areas(self) -> NDArray[np.float64]:
        """Areas in m^2, shape (n,)."""
        return 0.5 * self.width * (self.height_left + self.height_right)

    @property
    def rows(self) -> NDArray[np.float64]:
        """The six fields of each trapezoid, in their order, shape (n, 6)."""
        return np.stack(self, axis=-1)

    @property
    def corners(self) -> NDArray[np.float64]:
        """Lower left, lower right, upper left and upper right corners in m, shape (n, 4, 2)."""
        x = np.stack([self.left, self.left + self.width] * 2, axis=-1)
        low, height = np.stack(self[4:], axis=-1), np.stack(self[2:4], axis=-1)
        return np.stack([x, np.concatenate([low, low + height], axis=-1)], axis=-1)

    @property
    def midpoints(self) -> NDArray[np.float64]:
        """Means of the four corners of each trapezoid in m, shape (n, 2); not the centroids."""
        height = self.height_left + self.height_right
        y = 0.5 * (self.low_left + self.low_right) + 0.25 * height
        return np.stack([self.left + 0.5 * self.width, y], axis=-1)

    def divided(self, count: int) -> Trapezoids:
        """Divide each trapezoid into ``count`` strips of equal width with ``count`` pieces each.

        The result has count^2 n trapezoids; the index of the original trapezoid varies fastest.
        """
        step = np.arange(count + 1) / count
        u, v = step[:, None, None], step[:-1, None]
        height = self.height_left + u * (self.height_right - self.height_left)
        # The axes of the following arrays are strip, piece and trapezoid.
        low = self.low_left + u * (self.low_right - self.low_left) + v * height
        left, part = self.left + u[:-1] * self.width, height / count
        parts = left, self.width / count, part[:-1], part[1:], low[:-1], low[1:]
        return Trapezoids(*(a.reshape(-1) for a in np.broadcast_arrays(*parts)))


def trapezoids(rings: Sequence[NDArray[np.float64]]) -> Trapezoids:
    """Divide the region inside rings (n, 2) into trapezoids, from left to right.

    The even-odd rule applies, so the orientation of rings does not matter. Trapezoids of less than
    1e-12 of the total area are dropped.
    """
    start, end = edges_of_rings(rings)
    rightwards = start[:, :1] <= end[:, :1]
    start, end = np.where(rightwards, start, end), np.where(rightwards, end, start)
    cuts = np.unique([*start[:, 0], *end[:, 0]])
    rows: list[NDArray[np.float64]] = []
    for left, right in pairwise(cuts):
        rows.extend(_slab(start, end, left, right))
    cells = Trapezoids(*np.array(rows).reshape(-1, 6).T)
    return Trapezoids(*cells.rows[cells.areas > _NEGLIGIBLE * cells.areas.sum()].T.copy())


def _slab(
    start: NDArray[np.float64], end: NDArray[np.float64], left: float, right: float
) -> NDArray[np.float64]:
    """Return the trapezoids (k, 6) between two vertical lines, from bottom to top.

    ``start`` and ``end`` (n, 2): left and right ends of all edges. No end lies between the lines x
    = ``left`` and x = ``right``. The columns are the fields of :class:`Trapezoids`.
    """
    across = (start[:, 0] <= left) & (end[:, 0] >= right)
    a, b = start[across], end[across]
    slope = (b[:, 1] - a[:, 1]) / (b[:, 0] - a[:, 0])
    at_left = a[:, 1] + slope * (left - a[:, 0])
    at_right = a[:, 1] + slope * (right - a[:, 0])
    order = np.argsort(at_left + at_right, kind="stable")
    low, high = order[0::2], order[1::2]
    heights = at_left[high] - at_left[low], at_right[high] - at_right[low]
    sides = np.full(low.shape, left), np.full(low.shape, right - left), *heights
    return np.stack([*sides, at_left[low], at_right[low]], axis=-1)


def point_in_trapezoid(ops: Any, row: Sequence[Any], u: Any, v: Any) -> tuple[Any, Any]:
    """Map uniform random numbers (u, v) in [0, 1] to uniform random points of a trapezoid.

    Returns x, which depends on u alone, and y. ``row``: the six fields of a :class:`Trapezoids`
    row. ``ops``: namespace of operations for the type of the numbers.
    """
    left, width, height_left, height_right, low_left, low_right = row
    # The fraction t of the width solves h0 t + (h1 - h0) t^2 / 2 = u (h0 + h1) / 2; this form of
    # the solution has no cancellation.
    root = ops.sqrt((1.0 - u) * height_left * height_left + u * height_right * height_right)
    below = height_left + root
    t = u * (height_left + height_right) / ops.select(below > _TINY, below, _TINY)
    low = low_left + t * (low_right - low_left)
    height = height_left + t * (height_right - height_left)
    return left + t * width, low + v * height
