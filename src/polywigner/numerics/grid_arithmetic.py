"""Exact arithmetic with vertices that are rounded to a grid.

Sums and differences of an offset and two coordinates on the grid are exact in the float type of the
kernel. Cross products are accurate to an ulp, and their signs are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from polywigner.numerics import Floats

# The number 2^27 + 1, which splits a 53-bit number into two halves (Veltkamp's method).
_SPLIT = 134217729.0


def vertices_on_grid(polygon: Floats, step: float) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return vertices, rounded to multiples of ``step``, without repeated vertices.

    The second result is a mask of the vertices that are not repeated.
    """
    points = np.round(polygon / step) * step + 0.0
    distinct = (points != np.roll(points, 1, axis=0)).any(axis=1)
    return points[distinct], distinct


def accurate_cross(ax: Any, ay: Any, bx: Any, by: Any) -> Any:
    """Return the cross product of two vectors with an error of about one ulp (Dekker).

    The result is 0 only if the exact cross product is 0.
    """
    first, second = ax * by, ay * bx
    lost = product_error(ax, by, first) - product_error(ay, bx, second)
    return (first - second) + lost


def product_error(a: Any, b: Any, product: Any) -> Any:
    """Return the exact product of two float64 numbers minus the rounded ``product`` (Dekker)."""
    a_high = a * _SPLIT
    a_high = a_high - (a_high - a)
    b_high = b * _SPLIT
    b_high = b_high - (b_high - b)
    a_low, b_low = a - a_high, b - b_high
    return ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def _is_convex(polygon: Floats) -> bool:
    """Return whether a ring is convex, is counter-clockwise, and winds only once.

    Vertices may lie on straight sides.
    """
    before = polygon - np.roll(polygon, 1, axis=0)
    following = np.roll(polygon, -1, axis=0) - polygon
    crosses = accurate_cross(*before.T, *following.T)
    ahead = (before * following).sum(axis=1)
    if (crosses < 0).any() or ((crosses == 0) & (ahead <= 0)).any():
        return False
    # The exterior angles of a ring that winds n times add up to 2 pi n.
    return bool(np.arctan2(crosses, ahead).sum() < 3 * np.pi)


def with_vertices_on_sides(piece: Floats, vertices: Floats) -> Floats:
    """Return a piece with additional vertices at all ``vertices`` that lie exactly on its sides.

    Adjacent pieces then have common end points even after rounding.
    """
    ends = np.roll(piece, -1, axis=0)
    # The exact test is slow, so vertices within a wide tolerance are selected first.
    sides = shapely.linestrings(np.stack([piece, ends], axis=1))
    tree = shapely.STRtree(shapely.points(vertices))
    side, vertex = tree.query(sides, "dwithin", 1e-12 * float(np.abs(vertices).max()))
    along = ((vertices[vertex] - piece[side]) * (ends - piece)[side]).sum(axis=1)
    order = np.lexsort((along, side))
    inside = [
        (k, n)
        for k, n in zip(side[order].tolist(), vertex[order].tolist(), strict=True)
        if _is_between(piece[k], ends[k], vertices[n])
    ]
    if not inside:
        return piece
    return np.insert(piece, [k + 1 for k, _ in inside], vertices[[n for _, n in inside]], axis=0)


def _is_between(a: Floats, b: Floats, c: Floats) -> bool:
    """Return whether c lies exactly on the segment from a to b and differs from both."""
    (ax, ay), (bx, by), (cx, cy) = ([Fraction(v) for v in p.tolist()] for p in (a, b, c))
    dx, dy, x, y = bx - ax, by - ay, cx - ax, cy - ay
    return dx * y == dy * x and 0 < dx * x + dy * y < dx * dx + dy * dy


def signed_convex_pieces(pieces: Sequence[Floats]) -> list[tuple[Floats, float]]:
    """Return convex pieces with vertices on a grid, and weights of 1 or -1.

    The weighted sum of the new pieces equals the union of ``pieces``. Rounding may make a piece
    non-convex, or reverse the orientation of a narrow piece. Such a piece is divided into
    triangles, whose contributions along common sides cancel exactly.
    """
    result: list[tuple[Floats, float]] = []
    for piece in pieces:
        if len(piece) < 3:
            continue
        if _is_convex(piece):
            result.append((piece, 1.0))
            continue
        for k in range(1, len(piece) - 1):
            triangle = piece[[0, k, k + 1]]
            area = accurate_cross(*(triangle[1] - triangle[0]), *(triangle[2] - triangle[0]))
            if area:
                result.append((triangle if area > 0 else triangle[::-1], float(np.sign(area))))
    return result
