"""Bounds of a polygon in four directions: beyond them nothing is left of its slices.

An octagon holds the polygon, and tells in a dozen operations what the cuts of all edges would have
told: a fifth to half of the samples of a picture lie outside.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.outline.tables import Tables

__all__ = ["may_hold_lags", "may_overlap"]

_DIRECTIONS = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
# In the frame, whose unit is the size of the polygon: more than anything is rounded by.
_MARGIN = 1e-6

Mask = NDArray[np.bool_]


def _bounds(tables: Tables) -> tuple[list[float], list[float]]:
    levels = np.array([(edge.ax, edge.ay) for edge in tables.edges]) @ _DIRECTIONS.T
    return levels.min(axis=0).tolist(), levels.max(axis=0).tolist()


def may_hold_lags(tables: Tables, x: Any, y: Any) -> Mask:
    """Where positions of the frame lie in the bounds; also where they are not numbers."""
    outside = np.zeros(np.shape(x), bool)
    for (a, b), low, high in zip(_DIRECTIONS.tolist(), *_bounds(tables), strict=True):
        level = a * x + b * y
        outside |= (level < low - _MARGIN) | (level > high + _MARGIN)
    return ~outside


def may_overlap(tables: Tables, xi_x: Any, xi_y: Any) -> Mask:
    """Where lags of the frame are no longer than the bounds are wide; or not numbers."""
    apart = np.zeros(np.shape(xi_x), bool)
    for (a, b), low, high in zip(_DIRECTIONS.tolist(), *_bounds(tables), strict=True):
        apart |= np.abs(a * xi_x + b * xi_y) > high - low + _MARGIN
    return ~apart
