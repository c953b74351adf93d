"""Integrals of powers times a wave over a segment, by spherical Bessel functions."""

from __future__ import annotations

import math
from typing import Any

from polywigner.numerics.trigonometry import cos_sin_over_turns

__all__ = ["segment_moments"]

# Largest power -> x = pi turns below which Bessel functions come from series, since the recurrence
# upwards loses (2n - 1)!!/x^(n+1) ulps, 3 for either; and the number of terms in double and single
# precision. Omitted term of j_2 for x = 1: 1e-17 and 2e-9; for x = 2 of j_2: 4e-18 and 8e-10, of
# j_4: 4e-17 and 9e-11.
_SERIES = {2: (1.0, 9, 4), 4: (2.0, 10, 6)}


def segment_moments(ops: Any, half: Any, order: int) -> tuple[Any, ...]:
    """e_n = integral of t^n exp(-4 pi i half t) over -1/2 < t < 1/2, n = 0 ... order (2 or 4).

    ``half`` the turns of the wave over half of the segment. Real for even n; for odd n the
    imaginary part. By spherical Bessel functions of x = 2 pi half: ``e0 = j0, e1 = -j1/2, e2 = (j0
    - 2 j2)/12, e3 = (2 j3 - 3 j1)/40, e4 = (7 j0 - 20 j2 + 8 j4)/560``. Absolute errors of a few
    ulps of 2^-n/(n + 1).
    """
    fma = ops.fma
    j0, j1, j2, *higher = _bessel(ops, half, order)
    found = j0, -0.5 * j1, fma(j2, -1 / 6, j0 * (1 / 12))
    if not higher:
        return found
    j3, j4 = higher
    return (
        *found,
        fma(j3, 1 / 20, j1 * (-3 / 40)),
        fma(j4, 1 / 70, fma(j2, -1 / 28, j0 * (1 / 80))),
    )


def _bessel(ops: Any, half: Any, order: int) -> list[Any]:
    """j_0 ... j_order of x = 2 pi half.

    Where x is small the even ones come from series and the odd ones from their neighbours, x (j_n-1
    + j_n+1)/(2n + 1), which loses nothing; else from the recurrence upwards.
    """
    below, double, single = _SERIES[order]
    x = 2 * math.pi * half
    small = abs(x) < below
    inverse = 1.0 / ops.select(small, 1.0, x)
    cosine, sine, ratio = cos_sin_over_turns(ops, half)
    values = [ops.select(small, ratio * (0.5 / math.pi), sine * inverse)]
    square = ops.select(small, x * x, 0.0)  # no overflow in the branch not taken
    power: Any = 1.0
    for n in range(2, order + 1, 2):
        power = square * power
        even = power * _over_power(ops, n, square, double if ops.double else single)
        odd = (x * (1 / (2 * n - 1))) * (values[-1] + even)
        values.append(ops.select(small, odd, _next(ops, n - 1, values, inverse, cosine)))
        values.append(ops.select(small, even, _next(ops, n, values, inverse, cosine)))
    return values


def _next(ops: Any, n: int, values: list[Any], inverse: Any, cosine: Any) -> Any:
    """j_n from those before it; j_-1 is the cosine over x."""
    if n == 1:
        return (values[0] - cosine) * inverse
    return ops.fma((2.0 * n - 1.0) * inverse, values[n - 1], -values[n - 2])


def _over_power(ops: Any, n: int, square: Any, terms: int) -> Any:
    """j_n(x)/x^n by its series in x^2."""
    coefficients = [1 / math.prod(range(1, 2 * n + 2, 2))]
    for k in range(1, terms + 1):
        coefficients.append(coefficients[-1] * -0.5 / (k * (2 * n + 2 * k + 1)))
    total: Any = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        total = ops.fma(total, square, coefficient)
    return total
