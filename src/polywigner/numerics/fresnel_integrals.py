"""Fresnel integrals of real arguments to the rounding of floats, by a trapezoidal rule.

Source: M. Alazah, S. N. Chandler-Wilde, S. La Porte, "Computing Fresnel integrals via modified
trapezium rules", Numer. Math. 128, 635 (2014): errors below 1e-15 for twelve terms and all t.
"""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["fresnel_tail"]

_TERMS = 12
_A = math.sqrt((_TERMS + 0.5) * math.pi)
_SQUARES = ((np.arange(_TERMS) + 0.5) * math.pi / _A) ** 2
_WEIGHTS = np.exp(-_SQUARES)
_TURN = cmath.exp(-0.25j * math.pi)
# Beyond, the step is 0 or 1 to the last digit.
_FARTHEST = 60.0


def fresnel_tail(t: NDArray[np.float64], side: Any = 0.0) -> tuple[NDArray[Any], NDArray[Any]]:
    """Two parts of T(t) = (1/sqrt pi) exp(-i pi/4) int_t^inf exp(i s^2) ds.

    T(t) = step + exp(i t^2) rest: (step less ``side``, rest), ``side`` 1 where T is near 1. Each
    is as good as its own size, and so are differences of T at places far from its bend.
    """
    exponent = 2 * _A * _TURN * np.clip(t, -_FARTHEST, _FARTHEST)
    # 1/(exp(z) + 1), less 1 where that is asked for: -1/(exp(-z) + 1)
    sign = 1.0 - 2.0 * side
    with np.errstate(over="ignore"):
        step = sign / (np.exp(sign * exponent) + 1.0)
    square = t * t
    fourth = square * square
    real, imag = np.zeros_like(t), np.zeros_like(t)
    for weight, node in zip(_WEIGHTS.tolist(), _SQUARES.tolist(), strict=True):
        term = weight / (fourth + node * node)
        real += term
        imag -= node * term
    return step, (t / (_A * _TURN)) * (square * real + 1j * imag)
