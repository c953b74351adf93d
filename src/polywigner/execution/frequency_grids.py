"""F on grids of frequencies, computed by NumPy from the axes of the grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import GRID, chosen
from polywigner.execution.operations import NumpyOperations
from polywigner.kernels import GridTables, Kernel, OutlineSum, fourier_on_grid

Array = npt.NDArray[Any]

# Shorter sides are not worth the axes' tables.
_LEAST_SIDE = 8
# Longer ones are tiled: the tables of a tile's axes fit into memory.
_TILE = 512
# What lies too near the origin is computed point by point, at 20 times the cost.
_MOST_BELOW = 1 / 8
# Beyond this |nu| in the frame squares overflow.
_LARGEST = {True: 1e150, False: 1e18}

PointByPoint = Callable[[Sequence[Array]], Sequence[Array]]
"""(nu_x, nu_y) of some points -> real and imaginary part there."""


@dataclass(frozen=True)
class _Grid:
    """Points (x[i], y[j]); the given arrays are indexed [i, j], or [j, i] if ``transposed``."""

    x: Array
    y: Array
    transposed: bool


def _grid_of(x: Array, y: Array) -> _Grid | None:
    if x.ndim != 2 or x.shape != y.shape or min(x.shape) < _LEAST_SIDE:
        return None
    if _is_grid(x, y):
        return _Grid(_axis(x[:, 0]), _axis(y[0]), transposed=False)
    if _is_grid(x.T, y.T):
        return _Grid(_axis(x[0]), _axis(y[:, 0]), transposed=True)
    return None


def _axis(values: Array) -> Array:
    """An axis by itself, in the precision in which arguments enter a frame."""
    return np.array(values, np.float64)


def _is_grid(x: Array, y: Array) -> bool:
    """Whether x does not change along the second axis nor y along the first; not so for NaN."""
    if x[0, 0] != x[0, -1] or y[0, 0] != y[-1, 0]:  # most arrays are done with here
        return False
    return bool((x == x[:, :1]).all() and (y == y[:1]).all())


@dataclass(frozen=True)
class GridPlan:
    """A Fourier transform on a grid, to be computed from its axes."""

    tables: GridTables
    grid: _Grid
    double: bool

    @property
    def families(self) -> int:
        """Number of families of edges that are equal up to a translation."""
        return len(self.tables.families)

    def keeps_digits(self) -> bool:
        """Whether most points lie far enough from the origin, and none too far."""
        below = 1.0
        for scale, nu in zip(self.tables.scales, (self.grid.x, self.grid.y), strict=True):
            if not np.abs(nu).max() * scale < _LARGEST[self.double]:
                return False
            below *= float(np.mean(np.abs(nu * scale) < self.tables.floor(self.double)))
        return below < _MOST_BELOW

    def fill(self, results: Sequence[Array], point_by_point: PointByPoint) -> None:
        """Write real and imaginary part to two arrays.

        The few points near the origin that the grid's formula is not for go to ``point_by_point``.
        """
        targets = [result.T if self.grid.transposed else result for result in results]
        for i in range(0, len(self.grid.x), _TILE):
            for j in range(0, len(self.grid.y), _TILE):
                nu = self.grid.x[i : i + _TILE], self.grid.y[j : j + _TILE]
                for target, part in zip(targets, self._tile(nu, point_by_point), strict=True):
                    target[i : i + _TILE, j : j + _TILE] = part

    def _tile(self, nu: tuple[Array, Array], point_by_point: PointByPoint) -> tuple[Array, ...]:
        ops = NumpyOperations(double=True)
        with np.errstate(invalid="ignore", divide="ignore"):  # of points that are then replaced
            *parts, below = fourier_on_grid(ops, self.tables, *nu, self.double)
        if below.any():
            i, j = np.nonzero(below)
            for part, values in zip(parts, point_by_point((nu[0][i], nu[1][j])), strict=True):
                part[i, j] = values
        return tuple(parts)


def plan_for_grid(
    kernel: Kernel, source: Any, components: Sequence[Array], double: bool
) -> GridPlan | None:
    """Plan to compute a kernel from the axes of a grid; None where that cannot be done."""
    if not isinstance(kernel.edge_sum, OutlineSum):
        return None
    grid = _grid_of(*components)
    tables = None if grid is None else kernel.edge_sum.on_grid(source)
    if grid is None or tables is None:
        return None
    plan = GridPlan(tables, grid, double)
    return plan if plan.keeps_digits() else None


def evaluate_on_grid(
    kernel: Kernel,
    source: Any,
    components: Sequence[Array],
    point_by_point: PointByPoint,
    *,
    double: bool,
    engine: str,
    into: Sequence[Array] | None = None,
) -> tuple[Array, ...] | None:
    """The results on a grid, or None where that is no grid, or not the best way.

    ``into``: arrays for them.
    """
    if engine not in ("auto", "numpy"):
        return None
    plan = plan_for_grid(kernel, source, components, double)
    if plan is None:
        return None
    size = components[-1].size
    if chosen(kernel, plan.tables, size, engine=engine, families=plan.families)[0] != GRID:
        return None
    dtype = np.float64 if double else np.float32
    shape = components[-1].shape
    results = tuple(into or (np.empty(shape, dtype) for _ in range(2)))
    plan.fill(results, point_by_point)
    return results
