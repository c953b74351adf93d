"""Radiation patterns as arrays: read and checked, and cut along meridians."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError

__all__ = ["angle_between", "checked_pattern", "cuts_of", "front_of"]

# Two meridians half a turn apart, and the horizon, to the rounding of degrees.
_SAME_ANGLE = 1e-9
_OPPOSITE = 1e-6

_ATTRIBUTES = (
    "radiated_power", "aperture_power", "frequency", "peak_directivity", "peak_theta", "peak_phi",
)  # fmt: skip

Levels = NDArray[np.float64]


def checked_pattern(pattern: Any) -> tuple[Levels, Levels, Levels, dict[str, float]]:
    """Theta (n,), phi (m,), directivity (n, m) in dBi, and the numbers among the attributes.

    Raises ArgumentError for anything but a pattern, one without angles, and what is no number.
    """
    try:
        dims = tuple(pattern["directivity"].dims)
        theta, phi = (np.asarray(pattern[name].values, np.float64) for name in ("theta", "phi"))
        levels = np.asarray(pattern["directivity"].values, np.float64)
        about = {name: float(pattern.attrs[name]) for name in _ATTRIBUTES}
    except (TypeError, KeyError, IndexError, AttributeError, ValueError):
        dims = ()
    if sorted(dims) != ["phi", "theta"]:
        raise ArgumentError(
            "expected a pattern with directivity over theta and phi, got "
            f"{type(pattern).__name__} without; use what polywigner.radiation_pattern returned"
        )
    levels = levels if dims[0] == "theta" else levels.T
    if not levels.size or np.isnan(levels).any():
        what = "angles that are not a number" if levels.size else "no angles"
        raise ArgumentError(f"expected a pattern with numbers at its angles, got {what}")
    return theta, phi, levels, about


def front_of(theta: Levels, levels: Levels) -> tuple[Levels, Levels]:
    """Theta and levels (n, m) without what lies behind the plane, where nothing is radiated."""
    front = np.abs(theta) <= math.pi / 2 + _SAME_ANGLE
    return theta[front], levels[front]


def cuts_of(theta: Levels, phi: Levels, levels: Levels) -> Iterator[tuple[float, Levels, Levels]]:
    """(phi, theta (k,), levels (k,)) along meridians, with theta from one horizon to the other.

    Half a meridian where the other half is not among the levels (n, m) over theta and phi.
    """
    order = np.argsort(theta)
    is_whole = theta.min() < -_SAME_ANGLE
    left = np.full(len(phi), True)
    for j, angle in enumerate(phi):
        if not left[j]:
            continue
        left[j] = False
        opposite = np.flatnonzero(
            left & (np.abs((phi - angle) % (2 * math.pi) - math.pi) < _OPPOSITE)
        )
        if is_whole or not opposite.size:
            yield float(angle), theta[order], levels[order, j]
            continue
        left[opposite[0]] = False
        back = order[::-1] if theta[order[0]] > _SAME_ANGLE else order[:0:-1]
        places = np.concatenate([-theta[back], theta[order]])
        yield float(angle), places, np.concatenate([levels[back, opposite[0]], levels[order, j]])


def angle_between(a: float, b: float) -> float:
    """The angle between two whole meridians."""
    rest = (a - b) % math.pi
    return min(rest, math.pi - rest)
