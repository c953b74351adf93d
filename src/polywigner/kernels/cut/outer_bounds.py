"""Bounds of a polygon in four directions: beyond them nothing is left of its slices.

An octagon holds the polygon, and tells in a dozen operations what the cuts of all edges would have
told: a fifth to half of the samples of a picture lie outside.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.cut.clipping import MIRRORED, View
from polywigner.kernels.outline.tables import Tables

__all__ = ["may_meet"]

_DIRECTIONS = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
# In the frame, whose unit is the size of the polygon: more than anything is rounded by.
_MARGIN = 1e-6

Mask = NDArray[np.bool_]


def _bounds(tables: Tables) -> tuple[list[float], list[float]]:
    levels = np.array([(edge.ax, edge.ay) for edge in tables.edges]) @ _DIRECTIONS.T
    return levels.min(axis=0).tolist(), levels.max(axis=0).tolist()


def may_meet(tables: Tables, view: View, tx: Any, ty: Any) -> Mask:
    """Where copies at offsets T = 2x or xi of the frame may overlap, or offsets are not numbers."""
    apart = np.zeros(np.shape(tx), bool)
    for (a, b), low, high in zip(_DIRECTIONS.tolist(), *_bounds(tables), strict=True):
        level = a * tx + b * ty
        if view is MIRRORED:
            apart |= (level < 2.0 * low - _MARGIN) | (level > 2.0 * high + _MARGIN)
        else:
            apart |= np.abs(level) > high - low + _MARGIN
    return ~apart
