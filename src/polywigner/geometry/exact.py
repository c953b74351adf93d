"""Exact predicates on float64 coordinates: orientation, convexity and area without rounding.

A filter settles nearly every case in floating point; whole numbers do the rest.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

Ring = NDArray[np.float64]
"""Vertices of a closed ring, shape (n, 2), the first one not repeated at the end."""

# (3 + 16 u) u with u = 2^-53 bounds the rounding error of the cross product below in units of
# |product 1| + |product 2| (Shewchuk 1997, "ccwerrboundA").
_UNDERFLOW = float(np.finfo(float).tiny)
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
    """Signed area of one ring, rounded once."""
    return float(shoelace([ring]))


def area_and_error(ring: Ring) -> tuple[float, float]:
    """Signed area of one ring in floating point, and a bound on its rounding error.

    Tens of times as fast as :func:`signed_area`; for coordinates up to 1e150.
    """
    x, y = (ring - ring[0]).T
    first, second = x[:-1] * y[1:], x[1:] * y[:-1]
    twice = float((first - second).sum())
    # u for each difference, two to a product, u for the product, its difference, and each sum: all
    # of at most the sum of the products' sizes, doubled here; and what underflows.
    share = (len(ring) + 8) * 2.0**-53
    error = share * float((np.abs(first) + np.abs(second)).sum()) + len(ring) * _UNDERFLOW
    return twice / 2, error


def estimated_area(ring: Ring) -> float:
    """Signed area of one ring, with the exact sign; for large rings less exact than rounding."""
    area, error = area_and_error(ring)
    return area if abs(area) > error else signed_area(ring)
