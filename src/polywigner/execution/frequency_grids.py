"""Fourier transforms on grids of frequencies, computed by NumPy from the axes, (F4)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import GRID, planned
from polywigner.execution.operations import NumpyOperations
from polywigner.kernels import GridTables, Kernel, OutlineSum, fourier_on_grid

Array = npt.NDArray[Any]

# Smallest number of frequencies along both axes of a grid for which tables along the axes save
# work.
_LEAST_SIDE = 8
# Largest number of frequencies along an axis of a tile, so that the tables along the axes fit into
# memory.
_TILE = 512
# Largest fraction of frequencies that may be too close to the origin for formula (F4). Each of
# these frequencies costs 20 times as much.
_MOST_BELOW = 1 / 8

PointByPoint = Callable[[Sequence[Array]], Sequence[Array]]
"""Function (nu_x, nu_y) -> real and imaginary part at these frequencies."""


@dataclass(frozen=True)
class GridPlan:
    """A Fourier transform at the frequencies (x[i], y[j]), to be computed from the two axes."""

    tables: GridTables
    x: Array
    y: Array
    transposed: bool
    """Whether the results have the indices [j, i]."""

    @property
    def families(self) -> int:
        """Number of families of parallel edges; all edges along the axes count as one family."""
        oblique = sum(not family.is_straight for family in self.tables.families)
        return oblique + (oblique < len(self.tables.families))

    def keeps_digits(self) -> bool:
        """Return whether (F4) is accurate at most frequencies, which are far from the origin."""
        below = 1.0
        for scale, nu in zip(self.tables.scales, (self.x, self.y), strict=True):
            below *= float(np.mean(np.abs(nu * scale) < self.tables.floor))
        return below < _MOST_BELOW

    def fill(self, results: Sequence[Array], point_by_point: PointByPoint) -> None:
        """Write the real and the imaginary part of F to two arrays.

        ``point_by_point`` computes the few values near the origin, where (F4) loses digits.
        """
        ops = NumpyOperations()
        targets = [result.T if self.transposed else result for result in results]
        for i in range(0, len(self.x), _TILE):
            for j in range(0, len(self.y), _TILE):
                x, y = self.x[i : i + _TILE], self.y[j : j + _TILE]
                # Inaccurate results near the origin, and their warnings, are replaced below.
                with np.errstate(invalid="ignore", divide="ignore"):
                    *parts, below = fourier_on_grid(ops, self.tables, x, y)
                if below.any():
                    at = np.nonzero(below)
                    values = point_by_point((x[at[0]], y[at[1]]))
                    for part, exact in zip(parts, values, strict=True):
                        part[at] = exact
                for target, part in zip(targets, parts, strict=True):
                    target[i : i + _TILE, j : j + _TILE] = part


def plan_for_grid(
    kernel: Kernel, source: Any, components: Sequence[Array], engine: str
) -> GridPlan | None:
    """Return a plan to compute F from the axes of a grid; None for other kernels or points."""
    if not isinstance(kernel.edge_sum, OutlineSum) or engine not in ("auto", "numpy"):
        return None
    x, y = components
    if x.ndim != 2 or x.shape != y.shape or min(x.shape) < _LEAST_SIDE:
        return None
    transposed = not _is_grid(x, y)
    if transposed:
        x, y = x.T, y.T
        if not _is_grid(x, y):
            return None
    tables = kernel.edge_sum.on_grid(source)
    if tables is None:
        return None
    axes = np.array(x[:, 0], np.float64), np.array(y[0], np.float64)
    plan = GridPlan(tables, *axes, transposed)
    return plan if plan.keeps_digits() else None


def _is_grid(x: Array, y: Array) -> bool:
    """Return whether x is constant along the second axis and y along the first; False for NaN."""
    # This fast test rejects most arrays that are no grid.
    if x[0, 0] != x[0, -1] or y[0, 0] != y[-1, 0]:
        return False
    return bool((x == x[:, :1]).all() and (y == y[:1]).all())


def evaluate_on_grid(
    kernel: Kernel,
    source: Any,
    components: Sequence[Array],
    point_by_point: PointByPoint,
    into: Sequence[Array],
    engine: str,
) -> bool:
    """Write F to arrays if the points form a grid and this saves work; return whether it did."""
    plan = plan_for_grid(kernel, source, components, engine)
    if plan is None:
        return False
    size = components[-1].size
    choice = planned(kernel, plan.tables, size, engine=engine, families=plan.families)
    if choice.strategy == GRID:
        plan.fill(into, point_by_point)
    return choice.strategy == GRID
