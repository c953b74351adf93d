"""Uniform sampling of positions in an aperture, in its own coordinates, inside a renderer.

Positions come out relative to the aperture and keep single precision wherever the aperture stands
in the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from polywigner.engines import ops_for
from polywigner.geometry.trapezoids import Trapezoids, point_in_trapezoid, trapezoids

__all__ = ["Cells", "cells_of"]


def cells_of(m: Any, rings: Sequence[npt.NDArray[np.float64]]) -> Cells:
    """The sampler of positions inside boundary rings, for the variant ``m``."""
    return Cells(m, trapezoids(rings))


class Cells:
    """The trapezoids of an aperture as tables of one variant's arrays."""

    def __init__(self, m: Any, cells: Trapezoids) -> None:
        self._m, self._ops = m, ops_for(m.Float)
        self._count = cells.left.size
        columns = cells.columns
        if dr.is_jit_v(m.Float):
            self._columns = [m.Float(column.tolist()) for column in columns]
        else:
            self._columns = [column.tolist() for column in columns]
        self._choice = m.DiscreteDistribution((cells.areas / np.max(cells.areas)).tolist())

    def sample(self, sample: Any) -> Any:
        """A point, uniform in the aperture, for a uniform point of the unit square."""
        m, u, index = self._m, sample.x, 0
        if self._count > 1:
            index, u = self._choice.sample_reuse(sample.x)
        return m.Point2f(*point_in_trapezoid(self._ops, self._row(index), u, sample.y))

    def _row(self, index: Any) -> list[Any]:
        if dr.is_jit_v(self._m.Float):
            return [dr.gather(self._m.Float, column, index) for column in self._columns]
        return [column[index] for column in self._columns]
