"""Transforms on tensor-product grids of frequencies, in NumPy.

Whoever wants a picture asks for a grid: ``nu`` of shape (n, m, 2), made by ``numpy.meshgrid``. It
is recognised by its values, whatever its spacing, and computed from its axes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.engines.choice import resolved
from polywigner.engines.operations import NumpyOperations
from polywigner.kernels import GridTables, Kernel, fourier_on_grid

__all__ = ["GridPlan", "evaluate_on_grid", "plan_for_grid"]

# Shorter sides are not worth the axes' tables.
_LEAST_SIDE = 8
# Longer ones are tiled: the tables of a tile's axes fit into memory.
_TILE = 512
# What lies too near the origin is computed point by point, at 20 times the cost.
_MOST_BELOW = 1 / 8
# Beyond this |nu| in the frame squares overflow.
_LARGEST = {True: 1e150, False: 1e18}
# A family of oblique edges takes 8 ns a point, its members 0.3 ns each, and an edge in a compiled
# kernel 3 ns on two cores; to compile that takes 20 ms or more.
_EDGES_PER_FAMILY = 3
_NOT_WORTH_COMPILING = 1 << 20

Array = npt.NDArray[Any]
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
        return _Grid(x[:, 0].copy(), y[0].copy(), transposed=False)
    if _is_grid(x.T, y.T):
        return _Grid(x[0].copy(), y[:, 0].copy(), transposed=True)
    return None


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
    def cheap(self) -> bool:
        """Whether a compiled kernel would gain nothing, or not what compiling it costs."""
        families = len(self.tables.oblique)
        few = families * len(self.grid.x) * len(self.grid.y) <= _NOT_WORTH_COMPILING
        return few or _EDGES_PER_FAMILY * families <= self.tables.edges

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

    def _tile(self, nu: tuple[Array, Array], point_by_point: PointByPoint) -> tuple[Array, Array]:
        ops = NumpyOperations(double=True)
        with np.errstate(invalid="ignore", divide="ignore"):  # of points that are then replaced
            real, imag, below = fourier_on_grid(ops, self.tables, *nu, self.double)
        if below.any():
            i, j = np.nonzero(below)
            real[i, j], imag[i, j] = point_by_point((nu[0][i], nu[1][j]))
        return real, imag


def plan_for_grid(
    kernel: Kernel, source: Any, components: Sequence[Array], double: bool
) -> GridPlan | None:
    """How to compute a kernel from the axes of a grid; None where that cannot be done."""
    if kernel.on_grid is None:
        return None
    grid = _grid_of(*components)
    tables = kernel.on_grid(source) if grid else None
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
) -> tuple[Array, Array] | None:
    """Real and imaginary part on a grid, or None where that is no grid, or not the best way."""
    if engine not in ("auto", "numpy"):
        return None
    plan = plan_for_grid(kernel, source, components, double)
    if plan is None:
        return None
    samples = components[0].size
    if not plan.cheap and resolved(engine, samples, plan.tables.edges) != "numpy":
        return None
    dtype = np.float64 if double else np.float32
    results = (np.empty(components[0].shape, dtype), np.empty(components[0].shape, dtype))
    plan.fill(results, point_by_point)
    return results
