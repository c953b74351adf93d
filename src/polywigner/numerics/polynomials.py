"""Moments of a wave along a segment."""

from __future__ import annotations

import math
from typing import Any

from polywigner.numerics.phases import cos_sin_over_turns, polynomial

# x = pi turns below which Bessel functions come from series, since the recurrence upwards loses
# 3/x^3 ulps; and the number of terms in double and single precision. The omitted term of j_2 for
# x = 1 is 1e-17 and 2e-9.
_BELOW, _DOUBLE, _SINGLE = 1.0, 9, 4


def segment_moments(ops: Any, half: Any) -> tuple[Any, Any, Any]:
    """e_n = integral of t^n exp(-4 pi i half t) over -1/2 < t < 1/2, n = 0, 1, 2.

    ``half``: the turns of the wave over half of the segment. Real for even n; for n = 1 the
    imaginary part. By spherical Bessel functions of x = 2 pi half: ``e0 = j0, e1 = -j1/2, e2 =
    (j0 - 2 j2)/12``. Absolute errors of a few ulps of 2^-n/(n + 1).
    """
    j0, j1, j2 = _bessel(ops, half)
    return j0, -0.5 * j1, ops.fma(j2, -1 / 6, j0 * (1 / 12))


def _bessel(ops: Any, half: Any) -> tuple[Any, Any, Any]:
    """j_0, j_1 and j_2 of x = 2 pi half.

    For small x j_2 comes from its series, and j_1 from its neighbours, x (j_0 + j_2)/3, which loses
    nothing; else both come from the recurrence upwards.
    """
    x = 2 * math.pi * half
    small = abs(x) < _BELOW
    inverse = 1.0 / ops.select(small, 1.0, x)
    cosine, sine, ratio = cos_sin_over_turns(ops, half)
    j0 = ops.select(small, ratio * (0.5 / math.pi), sine * inverse)
    square = ops.select(small, x * x, 0.0)  # no overflow in the branch not taken
    series = square * _over_power(ops, 2, square, _DOUBLE if ops.double else _SINGLE)
    j1 = ops.select(small, (x * (1 / 3)) * (j0 + series), (j0 - cosine) * inverse)
    return j0, j1, ops.select(small, series, ops.fma(3.0 * inverse, j1, -j0))


def _over_power(ops: Any, n: int, square: Any, terms: int) -> Any:
    """j_n(x)/x^n by its series in x^2."""
    coefficients = [1 / math.prod(range(1, 2 * n + 2, 2))]
    for k in range(1, terms + 1):
        coefficients.append(coefficients[-1] * -0.5 / (k * (2 * n + 2 * k + 1)))
    return polynomial(ops, coefficients, square)
