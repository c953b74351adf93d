"""Peaks of band-limited functions between samples.

|F|^2 of what lies within a width D has no finer structure than 1/D. Around a peak it is
cos^2(pi d D) of the peak or more, at a distance d along an axis: so much of the peak has the sample
next to it, and windows about all such samples find the peak.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

# Samples of a window on either side of its middle, and how often windows are made smaller by this
# factor: 4^-8 of a sample leaves 1e-9 of the peak.
_WINDOW, _ROUNDS = 4, 8
_EQUAL = 1e-9
# Samples that are followed: peaks and their neighbours.
_MOST = 256


def largest(places: Floats, values: Floats, step: Floats, width: Floats) -> tuple[Floats, Floats]:
    """Return the samples that may be next to the largest peak, the best first.

    Parameters
    ----------
    places, values : (n, 2) and (n,).
    step, width : (2,) distances of samples, and the widths D; their products are 1/2 or less.
    """
    part = float(np.cos(math.pi * width * step / 2).prod()) ** 2
    best = np.argsort(-values, kind="stable")[:_MOST]
    best = best[values[best] >= min(part, 1 - _EQUAL) * values[best[0]]]
    return places[best], values[best]


def climbed(
    evaluate: Callable[[Floats], tuple[Floats, Any]], places: Floats, step: Floats, width: Floats
) -> tuple[Floats, Floats]:
    """Return the places (n, 2) of the largest peak, or of several equal ones, and its value (n,).

    Parameters
    ----------
    evaluate : places (n, m, 2), moved to where the function is asked for, and its values (n, m).
    places : (n, 2) of samples, as :func:`largest` returns them.
    step, width : as of :func:`largest`.
    """
    around = np.arange(-_WINDOW, _WINDOW + 1) / _WINDOW
    window = np.stack(np.meshgrid(around, around), axis=-1).reshape(-1, 2)
    values = np.empty(0)
    for _ in range(_ROUNDS):
        near, values = evaluate(places[:, None] + step * window)
        step = step / _WINDOW
        best = np.arange(len(near)), values.argmax(axis=-1)
        apart = np.unique((near[best] / step).round(), axis=0, return_index=True)[1]
        places, values = largest(near[best][apart], values[best][apart], step, width)
    return places, values
