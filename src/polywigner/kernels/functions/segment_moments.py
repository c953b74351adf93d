"""Integrals of powers times a wave over a segment, by spherical Bessel functions."""

from __future__ import annotations

import math
from typing import Any

from polywigner.numerics.trigonometry import cos_sin_turns

__all__ = ["segment_moments"]

# |w|/2 below which spherical Bessel functions come from series, since their recurrence upwards
# loses (2n - 1)!!/x^(n+1) ulps: 3 at n = 4. Omitted term of j_4/x^4 relative to the first: 2e-17
# after 10 terms and 2e-9 after 6.
_SERIES_BELOW = 2.0
_TERMS_DOUBLE, _TERMS_SINGLE = 10, 6


def segment_moments(ops: Any, turns: Any) -> tuple[Any, ...]:
    """e_n = integral of t^n exp(-2 pi i turns t) over -1/2 < t < 1/2, n = 0 ... 4.

    Real for even n; for odd n the imaginary part. By spherical Bessel functions of x = pi turns:
    ``e0 = j0, e1 = -j1/2, e2 = (j0 - 2 j2)/12, e3 = (2 j3 - 3 j1)/40, e4 = (7 j0 - 20 j2 +
    8 j4)/560``. Absolute errors of a few ulps of 2^-n/(n + 1).
    """
    x = math.pi * turns
    small = abs(x) < _SERIES_BELOW
    near = _bessel_by_series(ops, ops.select(small, x, 0.0))
    far = _bessel_upwards(ops, turns, ops.select(small, 1.0, x))
    j0, j1, j2, j3, j4 = (ops.select(small, a, b) for a, b in zip(near, far, strict=True))
    fma = ops.fma
    return (
        j0,
        -0.5 * j1,
        fma(j2, -1 / 6, j0 * (1 / 12)),
        fma(j3, 1 / 20, j1 * (-3 / 40)),
        fma(j4, 1 / 70, fma(j2, -1 / 28, j0 * (1 / 80))),
    )


def _bessel_by_series(ops: Any, x: Any) -> tuple[Any, ...]:
    """j_0 ... j_4: j_n/x^n for n = 3 and 4 by series, the others by recurrence downwards."""
    square = x * x
    terms = _TERMS_DOUBLE if ops.double else _TERMS_SINGLE

    def reduced(n: int) -> Any:
        total: Any = 1.0
        for k in range(terms, 0, -1):
            total = ops.fma(square * total, -0.5 / (k * (2 * n + 2 * k + 1)), 1.0)
        return total * (1.0 / math.prod(range(1, 2 * n + 2, 2)))

    values = [reduced(4), reduced(3)]
    for n in (3, 2, 1):
        values.append(ops.fma(values[-1], 2.0 * n + 1.0, -square * values[-2]))
    result, power = [], 1.0
    for value in reversed(values):
        result.append(value * power)
        power = power * x
    return tuple(result)


def _bessel_upwards(ops: Any, turns: Any, x: Any) -> tuple[Any, ...]:
    """j_0 ... j_4 for x = pi turns that is not small."""
    cosine, sine = cos_sin_turns(ops, 0.5 * turns)
    inverse = 1.0 / x
    values = [sine * inverse]
    values.append((values[0] - cosine) * inverse)
    for n in (1, 2, 3):
        values.append(ops.fma((2.0 * n + 1.0) * inverse, values[-1], -values[-2]))
    return tuple(values)
