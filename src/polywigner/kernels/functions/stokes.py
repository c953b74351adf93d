"""Plane-wave integrals over one edge of a boundary."""

from __future__ import annotations

import math
from typing import Any

from polywigner.numerics.phases import sin_turns, sinc_less_one

__all__ = [
    "moved_off_zero",
    "segment_wave",
]


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
