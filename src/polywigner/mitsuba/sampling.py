"""Uniform sampling of positions in an aperture, in its own coordinates.

The aperture is cut by vertical lines through its vertices into trapezoids, and a point of the unit
square is mapped to one of them: the first coordinate picks the trapezoid and the abscissa, the
second the ordinate. For a rectangle this is an affine map and for any convex polygon the abscissa
is monotone in the first coordinate, so stratified samples stay stratified; a triangle mesh, with
its fold along every diagonal, would lose that. Positions come out relative to the aperture and
keep single precision wherever the aperture stands in the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

__all__ = ["Cells", "Trapezoids", "cells_of", "trapezoids"]

# Vertices that should share an abscissa and differ in the last digits make trapezoids of no
# account; dropping them changes the density by less than single precision can tell.
_NEGLIGIBLE = 1e-12

# Smaller than any height of an aperture and above zero in single precision.
_TINY = 1e-30


@dataclass(frozen=True, eq=False)
class Trapezoids:
    """Trapezoids with vertical parallel sides; read-only float64 arrays (n,), metres."""

    left: npt.NDArray[np.float64]
    width: npt.NDArray[np.float64]
    low_left: npt.NDArray[np.float64]
    low_right: npt.NDArray[np.float64]
    high_left: npt.NDArray[np.float64]
    high_right: npt.NDArray[np.float64]

    @property
    def areas(self) -> npt.NDArray[np.float64]:
        """Areas (n,), m^2."""
        heights = self.high_left - self.low_left + self.high_right - self.low_right
        return 0.5 * self.width * heights


def trapezoids(rings: Sequence[npt.NDArray[np.float64]]) -> Trapezoids:
    """The trapezoids between the boundary rings (n, 2) of an aperture, from left to right.

    Cost: number of vertices times number of edges.
    """
    start = np.concatenate(rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    rightwards = start[:, :1] <= end[:, :1]
    start, end = np.where(rightwards, start, end), np.where(rightwards, end, start)
    cuts = np.unique([*start[:, 0], *end[:, 0]])
    rows: list[npt.NDArray[np.float64]] = []
    for left, right in pairwise(cuts):
        rows.extend(_slab(start, end, left, right))
    table = np.array(rows).reshape(-1, 6)
    found = Trapezoids(*table.T)
    kept = table[found.areas > _NEGLIGIBLE * found.areas.sum()].T.copy()
    kept.flags.writeable = False
    return Trapezoids(*kept)


def _slab(
    start: npt.NDArray[np.float64], end: npt.NDArray[np.float64], left: float, right: float
) -> npt.NDArray[np.float64]:
    """The trapezoids between two neighbouring cuts, from below upwards."""
    across = (start[:, 0] <= left) & (end[:, 0] >= right)
    a, b = start[across], end[across]
    slope = (b[:, 1] - a[:, 1]) / (b[:, 0] - a[:, 0])
    at_left = a[:, 1] + slope * (left - a[:, 0])
    at_right = a[:, 1] + slope * (right - a[:, 0])
    order = np.argsort(at_left + at_right, kind="stable")
    # Edges alternate between entering and leaving the aperture; touching parts tie, and either
    # order of a tie gives the same trapezoids.
    low, high = order[0::2], order[1::2]
    sides = (at_left[low], at_right[low], at_left[high], at_right[high])
    return np.stack([np.full(low.shape, left), np.full(low.shape, right - left), *sides], axis=-1)


def cells_of(m: Any, rings: Sequence[npt.NDArray[np.float64]]) -> Cells:
    """The sampler of positions inside boundary rings, for the variant ``m``."""
    return Cells(m, trapezoids(rings))


class Cells:
    """The trapezoids of an aperture as tables of one variant's arrays."""

    def __init__(self, m: Any, cells: Trapezoids) -> None:
        self._m = m
        self._count = cells.left.size
        # Heights are differences of coordinates: formed here, in double precision.
        columns = (
            cells.left,
            cells.width,
            cells.high_left - cells.low_left,
            cells.high_right - cells.low_right,
            cells.low_left,
            cells.low_right,
        )
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
        left, width, height_left, height_right, low_left, low_right = self._row(index)
        # Solves (h0 t + (h1 - h0) t^2 / 2) = u (h0 + h1) / 2 without cancellation.
        root = dr.sqrt((1.0 - u) * height_left * height_left + u * height_right * height_right)
        below = height_left + root
        t = u * (height_left + height_right) / dr.select(below > _TINY, below, _TINY)
        low = low_left + t * (low_right - low_left)
        height = height_left + t * (height_right - height_left)
        return m.Point2f(left + t * width, low + sample.y * height)

    def _row(self, index: Any) -> list[Any]:
        if dr.is_jit_v(self._m.Float):
            return [dr.gather(self._m.Float, column, index) for column in self._columns]
        return [column[index] for column in self._columns]
