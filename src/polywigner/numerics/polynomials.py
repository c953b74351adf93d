"""Moments of a wave along a segment, and smooth functions by polynomials."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from polywigner.numerics.phases import cos_sin_over_turns, polynomial

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

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


# Numbers of Chebyshev's nodes, each with the nodes of the one before.
_RULES = (5, 9, 17, 33, 65)


def in_band(compute: Callable[[float], Complex], frequencies: Floats, tolerance: float) -> Complex:
    """Smooth values (n, k) at frequencies (n,), by a polynomial if it takes fewer of them.

    The number of Chebyshev's nodes is doubled until the polynomial predicts the values at the next
    nodes to ``tolerance`` of the largest value.
    """
    low, high = float(frequencies.min()), float(frequencies.max())
    steps = _RULES[-1] - 1
    places = (low + high) / 2 - (high - low) / 2 * np.cos(np.pi * np.arange(steps + 1) / steps)
    known: dict[int, Complex] = {}
    nodes, values = np.empty(0), np.empty((0, 0), np.complex128)
    for count in _RULES:
        if count >= len(frequencies):
            break
        numbers = range(0, steps + 1, steps // (count - 1))
        known |= {k: compute(float(places[k])) for k in numbers if k not in known}
        predicted = _interpolated(nodes, values, places[numbers]) if len(nodes) else None
        nodes, values = places[numbers], np.array([known[k] for k in numbers])
        if predicted is not None:
            errors = np.abs(predicted - values).max(axis=0)
            if (errors <= tolerance * np.abs(values).max(axis=0)).all():
                return _interpolated(nodes, values, frequencies)
    return np.array([compute(float(frequency)) for frequency in frequencies])


def _interpolated(nodes: Floats, values: Complex, frequencies: Floats) -> Complex:
    """Values (n, k) at frequencies (n,) of the polynomial through nodes, ends included."""
    low, high = nodes[[0, -1]]
    if low == high:
        return np.repeat(values[:1], len(frequencies), axis=0)
    scaled = [(2 * x - low - high) / (high - low) for x in (nodes, frequencies)]
    coefficients = chebyshev.chebfit(scaled[0], values, len(nodes) - 1)
    return np.asarray(chebyshev.chebval(scaled[1], coefficients).T, np.complex128)
