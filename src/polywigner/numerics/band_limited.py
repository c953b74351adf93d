"""Band-limited functions: interpolation over frequencies, and peaks between samples.

The spectrum |F|^2 of a source of width D varies on scales of 1/D and more. At a distance d from a
peak, along an axis, it is at least cos^2(pi d D) times the peak. The sample next to the largest
peak is therefore at least this fraction of the peak, and the peak lies in a window around one of
the samples that reach this fraction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Numbers of Chebyshev nodes that are tried in turn. Each rule contains the nodes of the rule before
# it.
_RULES = (5, 9, 17, 33, 65)


def in_band(compute: Callable[[float], Complex], frequencies: Floats, tolerance: float) -> Complex:
    """Return a smooth function at many frequencies, by interpolation if that saves calls.

    The number of Chebyshev nodes is doubled until the polynomial predicts the values at the next
    nodes to ``tolerance`` of the largest value.

    Parameters
    ----------
    compute : callable
        frequency -> complex ndarray, shape (k,).
    frequencies : ndarray, shape (n,)
        Frequencies in any unit.
    tolerance : float
        Allowed error, relative to the largest value of each component.

    Returns
    -------
    complex ndarray, shape (n, k)
    """
    low, high = float(frequencies.min()), float(frequencies.max())
    steps = _RULES[-1] - 1
    nodes_in_band = (low + high) / 2 - (high - low) / 2 * np.cos(
        np.pi * np.arange(steps + 1) / steps
    )
    known: dict[int, Complex] = {}
    nodes, values = np.empty(0), np.empty((0, 0), np.complex128)
    for count in _RULES:
        if count >= len(frequencies):
            break
        numbers = range(0, steps + 1, steps // (count - 1))
        known |= {k: compute(float(nodes_in_band[k])) for k in numbers if k not in known}
        predicted = _interpolated(nodes, values, nodes_in_band[numbers]) if len(nodes) else None
        nodes, values = nodes_in_band[numbers], np.array([known[k] for k in numbers])
        if predicted is not None:
            errors = np.abs(predicted - values).max(axis=0)
            if (errors <= tolerance * np.abs(values).max(axis=0)).all():
                return _interpolated(nodes, values, frequencies)
    return np.array([compute(float(frequency)) for frequency in frequencies])


def _interpolated(nodes: Floats, values: Complex, frequencies: Floats) -> Complex:
    """Return the polynomial through values at Chebyshev nodes, at frequencies (n,)."""
    low, high = nodes[[0, -1]]
    if low == high:
        return np.repeat(values[:1], len(frequencies), axis=0)
    scaled = [(2 * x - low - high) / (high - low) for x in (nodes, frequencies)]
    coefficients = chebyshev.chebfit(scaled[0], values, len(nodes) - 1)
    return np.asarray(chebyshev.chebval(scaled[1], coefficients).T, np.complex128)


# A peak is searched in a window of _WINDOW samples on either side of its estimated position. The
# window shrinks by the factor _WINDOW in each of _ROUNDS rounds, so the position of the peak is
# accurate to 4^-8 of a sample. Since a peak is quadratic, its relative height is accurate to the
# square of this, about 1e-9.
_WINDOW, _ROUNDS = 4, 8
_EQUAL = 1e-9
# Largest number of samples around which the largest peak is searched.
_MOST = 256


def largest(points: Floats, values: Floats, step: Floats, width: Floats) -> tuple[Floats, Floats]:
    """Return the samples that may lie next to the largest peak, in descending order.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Positions of the samples.
    values : ndarray, shape (n,)
        Values of the samples.
    step : ndarray, shape (2,)
        Distance between samples along each axis.
    width : ndarray, shape (2,)
        Width D of the source along each axis; ``step * width`` is at most 1/2.

    Returns
    -------
    points, values : ndarray
        Up to 256 samples.
    """
    fraction = float(np.cos(math.pi * width * step / 2).prod()) ** 2
    best = np.argsort(-values, kind="stable")[:_MOST]
    best = best[values[best] >= min(fraction, 1 - _EQUAL) * values[best[0]]]
    return points[best], values[best]


def climbed(
    evaluate: Callable[[Floats], tuple[Floats, Any]], points: Floats, step: Floats, width: Floats
) -> tuple[Floats, Floats]:
    """Return the positions (n, 2) and heights (n,) of the largest peak, or of several equal peaks.

    Parameters
    ----------
    evaluate : callable
        (points (n, m, 2)) -> the points moved into the domain of the function, and values (n, m).
    points : ndarray, shape (n, 2)
        Samples, as :func:`largest` returns them.
    step, width : ndarray, shape (2,)
        As for :func:`largest`.
    """
    around = np.arange(-_WINDOW, _WINDOW + 1) / _WINDOW
    window = np.stack(np.meshgrid(around, around), axis=-1).reshape(-1, 2)
    values = np.empty(0)
    for _ in range(_ROUNDS):
        near, values = evaluate(points[:, None] + step * window)
        step = step / _WINDOW
        best = np.arange(len(near)), values.argmax(axis=-1)
        distinct = np.unique((near[best] / step).round(), axis=0, return_index=True)[1]
        points, values = largest(near[best][distinct], values[best][distinct], step, width)
    return points, values
