"""Axes of the pictures in SI units, from a state alone."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from polywigner.explorer.sources import source_of
from polywigner.explorer.state import State
from polywigner.illumination.texts import direction

Values = NDArray[np.float64]

_LOBES = 8.0  # half width of frequency axes in 1/diagonal, as `polywigner transform` has it
_MARGIN = 1.05
_BEAM = 3.0  # half width of the near field's plane: the source's box and three lobes
_ANGLES = 361
_WIDE = 0.5  # sine of the angle from which a beam is seen without spreading it
_UPRIGHT = 1e-9  # of a direction's part in the plane: it has no azimuth


def _box(state: State) -> tuple[float, float, float]:
    """The centre of the source's bounds, and half of their longer side, in m."""
    xmin, ymin, xmax, ymax = source_of(state).bounds
    half = max(xmax - xmin, ymax - ymin) / 2
    return float(xmin / 2 + xmax / 2), float(ymin / 2 + ymax / 2), float(half)


def reach_of(state: State) -> float:
    """The largest direction cosine shown: the state's own, or eight lobes of the source."""
    _, _, half = _box(state)
    return state.reach or min(1.0, _LOBES * state.wavelength / (2 * math.sqrt(2) * half))


def frequency_half(state: State) -> float:
    """Half width of the axes of nu, in 1/m."""
    return reach_of(state) / state.wavelength


def position_window(state: State) -> tuple[float, float, float]:
    """Centre and half width of the axes of x, in m: a little more than the bounds."""
    x, y, half = _box(state)
    return x, y, _MARGIN * half


def lag_half(state: State) -> float:
    """Half width of the axes of xi, in m: the largest lag of two points of the source."""
    return _MARGIN * 2 * _box(state)[2]


def plane_half(state: State) -> float:
    """Half width of the plane of the near field, in m."""
    _, _, half = _box(state)
    sine = min(0.7, _BEAM * state.wavelength / (2 * half))
    return half + state.metres(state.distance) * sine / math.sqrt(1 - sine * sine)


def azimuths(state: State) -> tuple[float, float]:
    """Azimuths of the far field's cuts in rad: of the steered beam, or 0, and pi/2 more."""
    first = 0.0
    if state.steering.strip():
        x, y, _ = direction(state.steering)
        first = math.atan2(y, x) if math.hypot(x, y) > _UPRIGHT else 0.0
    return first, first + math.pi / 2


def angles(state: State) -> Values:
    """Angles from the normal of the far field's cuts, in rad: all, unless the beam is narrow."""
    reach = reach_of(state)
    largest = math.pi / 2 if reach > _WIDE and not state.reach else math.asin(reach)
    return np.linspace(-largest, largest, _ANGLES)


def square(half: float, samples: int, x: float = 0.0, y: float = 0.0) -> Values:
    """(samples, samples, 2): y along the first axis, x along the second."""
    axis = np.linspace(-half, half, samples)
    return np.stack(np.meshgrid(x + axis, y + axis), axis=-1)
