"""Waves on an interval, every place with every frequency: what either has of its own, once.

With g_s = 1/(pi (nu - s)) for each shift s of the frequency,

    sum_s a_s L sinc(L (nu - s)) = sin(pi L nu) sum_s a_s cos(pi L s) g_s
                                 - cos(pi L nu) sum_s a_s sin(pi L s) g_s

whose sums are products of matrices: places by shifts, and shifts by frequencies. What is left for
each pair of a place and a frequency is one sine and one cosine, however many waves there are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.trigonometry import cos_sin_turns

__all__ = ["are_pairs", "sum_of_pairs"]

# Frequencies closer to a shift than this, in cycles per unit of the frame, take sines of their own:
# the two terms cancel, and lose 1/(pi |nu - s|) in accuracy.
_NEAR = 0.125

Floats = NDArray[np.float64]


def are_pairs(place: Any, frequency: Any) -> bool:
    """Whether places (n, 1) meet frequencies (1, m) in arrays of NumPy, or the other way round."""
    if not isinstance(place, np.ndarray) or not isinstance(frequency, np.ndarray):
        return False
    if place.ndim != 2 or frequency.ndim != 2:
        return False
    (rows, one), (other, columns) = place.shape, frequency.shape
    return (rows > 1 and columns > 1 and one == other == 1) or (
        one > 1 and other > 1 and rows == columns == 1
    )


def sum_of_pairs(
    ops: Any, shifts: Sequence[float], amplitudes: Any, frequency: Any, length: Any
) -> Pair:
    """The sum over shifts for amplitudes (n, shifts), frequencies (1, m) and lengths (n, 1)."""
    moved = np.array(shifts)[:, None]
    apart = np.asarray(frequency, np.float64) - moved
    exact = np.asarray(length, np.float64)
    near = ~(abs(apart) >= _NEAR).all(axis=0)  # and what is not a number
    shares = (1.0 / (math.pi * np.where(near, 1.0, apart))).astype(ops.dtype)
    turns = exact * (math.pi * moved.T)
    table = np.concatenate([amplitudes * np.cos(turns), amplitudes * -np.sin(turns)])
    cosine, sine = cos_sin_turns(ops, (0.5 * length) * frequency)
    sincs = exact * np.sinc(exact * apart[:, None, near])

    def total(own: Floats, part: Floats) -> Any:
        whole = part.astype(ops.dtype) @ shares
        found = sine * whole[: len(own)]
        found += cosine * whole[len(own) :]
        found[:, near] = np.einsum("ns,snm->nm", own, sincs)
        return found

    if not np.iscomplexobj(amplitudes):
        return Pair(total(amplitudes, table), 0.0)
    return Pair(total(amplitudes.real, table.real), total(amplitudes.imag, table.imag))
