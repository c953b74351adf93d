"""Sine and cosine of an angle in turns, by polynomial, and the plane-wave mean over a segment.

An angle in turns is reduced by one exact subtraction, which library functions of radians cannot
do: their reduction costs as much as the polynomial, and in float32 fails for large arguments.

``sin(2 pi r) = r (1/4 - r^2) Q(r^2)`` on ``|r| <= 1/2``: both zeros are taken out, so that Q is
smooth and short. The coefficients are Chebyshev interpolants of Q in ``r^2`` on [0, 1/4], computed
with 50 digits (Q errs by 1.5e-16 at degree 9 and 7.4e-8 at degree 5). Measured over [-1/2, 1/2],
rounding included, the sine errs by at most 5.6e-16 in float64 and 2.3e-7 in float32.
"""

from __future__ import annotations

import math
from typing import Any

__all__ = [
    "cos_sin_over_turns",
    "cos_sin_turns",
    "mean_plane_wave",
    "sin_turns",
    "sinc",
    "sinc_less_one",
]

_SINE_DOUBLE = (
    25.132741228718345, -64.83584404672554, 67.07762091738222, -38.51295534186807,
    14.182954388478867, -3.646752364831226, 0.6927968586177335, -0.10127479441363349,
    0.011700148974859654, -0.0010057071302593576,
)  # fmt: skip
_SINE_SINGLE = (
    25.13274115471077, -64.8358227214753, 67.07662306642158, -38.495830637736184,
    14.049443530985526, -3.1612498251959376,
)  # fmt: skip


def _sine_over_reduced(ops: Any, r: Any) -> Any:
    """sin(2 pi r)/r for |r| <= 1/2, 2 pi at r = 0."""
    coefficients = _SINE_DOUBLE if ops.double else _SINE_SINGLE
    square = r * r
    q = ops.fma(square, coefficients[-1], coefficients[-2])
    for c in coefficients[-3::-1]:
        q = ops.fma(q, square, c)
    return q * (0.25 - square)


def _sine_of_reduced(ops: Any, r: Any) -> Any:
    """sin(2 pi r) for |r| <= 1/2."""
    return _sine_over_reduced(ops, r) * r


def sin_turns(ops: Any, turns: Any) -> Any:
    """sin(2 pi turns)."""
    return _sine_of_reduced(ops, turns - ops.round(turns))


def cos_sin_turns(ops: Any, turns: Any) -> tuple[Any, Any]:
    """cos(2 pi turns) and sin(2 pi turns)."""
    r = turns - ops.round(turns)
    return _sine_of_reduced(ops, 0.25 - abs(r)), _sine_of_reduced(ops, r)


def cos_sin_over_turns(ops: Any, turns: Any) -> tuple[Any, Any, Any]:
    """cos(2 pi turns), sin(2 pi turns), and for |turns| < 1/2 sin(2 pi turns)/turns, at 0 too."""
    r = turns - ops.round(turns)
    ratio = _sine_over_reduced(ops, r)
    return _sine_of_reduced(ops, 0.25 - abs(r)), ratio * r, ratio


def sinc(ops: Any, turns: Any) -> Any:
    """sin(pi turns)/(pi turns), the modulus of the mean plane wave over a segment so long."""
    half = 0.5 * turns
    reduced = half - ops.round(half)
    ratio = _sine_over_reduced(ops, reduced)
    # Nothing is divided by a small number, for the sake of derivatives: those of a quotient would
    # cancel, and err by an ulp over the turns.
    near = abs(half) < 0.5
    quotient = ratio * reduced / ops.select(near, 1.0, half)
    return ops.select(near, ratio, quotient) * (0.5 / math.pi)


def sinc_less_one(ops: Any, turns: Any, terms: int) -> Any:
    """sinc(turns) - 1 by its series, for small arguments: no digits are lost to the 1."""
    square = (math.pi * turns) * (math.pi * turns)
    series: Any = 0.0
    for k in range(terms, 0, -1):
        series = ops.fma(series, square, (-1.0) ** k / math.factorial(2 * k + 1))
    return series * square


def mean_plane_wave(ops: Any, start: Any, end: Any) -> tuple[Any, Any]:
    """Mean of exp(-2 pi i p) over p from ``start`` to ``end`` (turns): cosine part, sine part.

    The value is ``cosine - i sine`` = exp(-pi i (start + end)) sinc(end - start).
    """
    scale = sinc(ops, end - start)
    cosine, sine = cos_sin_turns(ops, 0.5 * (start + end))
    return scale * cosine, scale * sine
