"""Plane-wave integrals over one triangle of a fan, and over one edge of a boundary.

The transform of a polygon is a signed sum over the triangles (origin, p, p') spanned by its
edges. One triangle contributes ``cross(p, p') exp[0, a, b]``, the second divided difference of
the exponential at ``0``, ``a = -2 pi i nu.p`` and ``b = -2 pi i nu.p'``. Unlike the edge sum of
the paper's eq. (FVT) it has no division by nu, stays accurate for slivers, and a boundary that
closes only up to rounding costs no more than rounding (docs/theory.md, (F2)).
"""

from __future__ import annotations

import math
from typing import Any

from polywigner.numerics.complex_pairs import Pair, mean_wave, select
from polywigner.numerics.trigonometry import mean_plane_wave, sin_turns, sinc_less_one

__all__ = [
    "moved_off_zero",
    "segment_wave",
    "triangle_complex_wave",
    "triangle_plane_wave",
]

# Below this largest separation (in turns; 0.63 rad) the Taylor series is summed; above it the
# recursion divides by at least that, and loses at most a factor 1/0.63 of accuracy.
_SERIES_BELOW = 0.1
# First omitted term of the series, (k+1) 0.63^k/(k+2)!: 2e-18 at k = 16, 7e-9 at k = 9.
_TERMS_DOUBLE, _TERMS_SINGLE = 16, 9


def _series(ops: Any, a: Any, b: Any) -> tuple[Any, Any]:
    """exp[0, -ia, -ib] = sum_k (-i)^k h_k(a, b) / (k+2)!, h_k complete homogeneous symmetric."""
    terms = _TERMS_DOUBLE if ops.double else _TERMS_SINGLE
    h: Any = a + b
    power = b
    cosine: Any = 0.5
    sine: Any = h * (1 / 6)
    for k in range(2, terms):
        power = power * b
        h = ops.fma(a, h, power)
        term = (1.0 if k % 4 < 2 else -1.0) / math.factorial(k + 2)
        if k % 2:
            sine = ops.fma(h, term, sine)
        else:
            cosine = ops.fma(h, term, cosine)
    return cosine, sine


def triangle_plane_wave(ops: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """Twice the mean of exp(-2 pi i p) over a triangle with p = 0, u, v (turns) at its corners.

    Precisely exp[0, -2 pi i u, -2 pi i v], which is 1/2 at u = v = 0. Returned as
    (cosine part, sine part), the value being ``cosine - i sine``. Source: Hermite-Genocchi
    formula; recursion over the pair of points that lie farthest apart.
    """
    size_u, size_v, size_w = abs(u), abs(v), abs(u - v)
    u_wins = (size_u >= size_v) & (size_u >= size_w)
    v_wins = size_v >= size_w
    # first and last lie farthest apart, middle is the third point
    last = ops.select(u_wins, u, v)
    middle = ops.select(u_wins, v, ops.select(v_wins, u, 0.0))
    first = ops.select(u_wins, 0.0, ops.select(v_wins, 0.0, u))
    distance = last - first
    small = abs(distance) < _SERIES_BELOW
    divisor = 2 * math.pi * ops.select(small, 1.0, distance)
    cos_a, sin_a = mean_plane_wave(ops, first, middle)
    cos_b, sin_b = mean_plane_wave(ops, middle, last)
    # (g_b - g_a)/(-2 pi i d) with g = cos - i sin
    cos_large = (sin_b - sin_a) / divisor
    sin_large = (cos_a - cos_b) / divisor
    # the series sees arguments clamped to its domain: no overflow in the branch not taken
    a = 2 * math.pi * ops.select(small, u, 0.0)
    b = 2 * math.pi * ops.select(small, v, 0.0)
    cos_small, sin_small = _series(ops, a, b)
    return ops.select(small, cos_small, cos_large), ops.select(small, sin_small, sin_large)


def triangle_complex_wave(ops: Any, u: Pair, v: Pair, level: Any = 0.0) -> Pair:
    """:func:`triangle_plane_wave` for complex u and v, times exp(-2 pi level)."""
    size_u, size_v, size_w = u.norm(), v.norm(), (u - v).norm()
    u_wins = (size_u >= size_v) & (size_u >= size_w)
    v_wins = size_v >= size_w
    origin = Pair(0.0, 0.0)
    last = select(ops, u_wins, u, v)
    middle = select(ops, u_wins, v, select(ops, v_wins, u, origin))
    first = select(ops, u_wins, origin, select(ops, v_wins, origin, u))
    distance = last - first
    small = distance.norm() < _SERIES_BELOW**2
    divisor = select(ops, small, Pair(1.0, 0.0), distance) * Pair(0.0, -2 * math.pi)
    difference = mean_wave(ops, middle, last, level) - mean_wave(ops, first, middle, level)
    turn = Pair(0.0, -2 * math.pi)
    a, b = (turn * select(ops, small, corner, origin) for corner in (u, v))
    h, power = a + b, b
    series = Pair(0.5, 0.0) + h.scaled(1 / 6)
    for k in range(2, _TERMS_DOUBLE if ops.double else _TERMS_SINGLE):
        power = power * b
        h = a * h + power
        series = series + h.scaled(1 / math.factorial(k + 2))
    series = series.scaled(ops.exp(-2 * math.pi * level))
    return select(ops, small, series, difference / divisor)


def segment_wave(ops: Any, half: Any, middle: Any) -> tuple[Any, Any]:
    """sinc(l) sin(2 pi m) and sinc(l) cos(2 pi m) - 1, for half of l and m in turns.

    The second without cancellation where both are near 1. Series of sinc - 1 below a quarter
    turn: first omitted term 0.62^9/19! = 1e-19, in float32 0.62^6/13! = 9e-12.
    """
    small = abs(half) < 0.125
    series = sinc_less_one(ops, ops.select(small, 2.0 * half, 0.0), 8 if ops.double else 5)
    divisor = 2 * math.pi * ops.select(small, 1.0, half)
    less_one = ops.select(small, series, sin_turns(ops, half) / divisor - 1.0)
    half_sine = sin_turns(ops, 0.5 * middle)
    cosine_less_one = -2.0 * half_sine * half_sine
    sine = sin_turns(ops, middle)
    both = ops.fma(less_one, cosine_less_one, less_one + cosine_less_one)
    return ops.fma(less_one, sine, sine), both


def moved_off_zero(ops: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """A frequency, or if it is so small that its square underflows, one that is just larger.

    Changes a transform by the floor times the diameter, far below rounding. Terms are of the order
    of the square; what rounding loses of their sum, 6e-8 of it and less, must not underflow either:
    at 1e-16, compiled kernels took it for 0 and errors were eight times as large.
    """
    floor = 1e-140 if ops.double else 1e-13
    tiny = (abs(x) < floor) & (abs(y) < floor)  # false if either is not a number
    return ops.select(tiny, floor, x), ops.select(tiny, 0.0, y)
