"""Kernels on NumPy arrays: chunk by chunk, and F on grids of frequencies from their axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import GRID, planned
from polywigner.execution.chunks import Fetch, Launched, parts_of_results, ready
from polywigner.execution.operations import NumpyOperations
from polywigner.kernels import GridTables, Kernel, OutlineSum, PartSum, SharedSlice, fourier_on_grid

CHUNK = 3 << 12
"""Samples at a time: a temporary array stays in the cache of one core, and below 128 KiB, from
which on the C library maps memory anew: page faults cost more than what is computed."""
_HOST = NumpyOperations(double=True)
# Where slices are cut once for many samples: rows enough to cut at a time.
_SHARED_CHUNK = 1 << 18

Array = npt.NDArray[Any]


def entered(kernel: Kernel, frame: Any, arguments: Sequence[Array]) -> tuple[Any, ...]:
    """Arguments in a frame, in double precision and the shapes that they have."""
    with np.errstate(invalid="ignore", over="ignore"):
        return kernel.enter(_HOST, frame, *arguments)


class OnNumpy:
    """A kernel of a source, computed by NumPy."""

    shared_block = _SHARED_CHUNK

    def __init__(self, kernel: Kernel, tables: Any, double: bool) -> None:
        self.kernel, self.tables = kernel, tables
        self.ops = NumpyOperations(double)

    def points(self, components: Sequence[Array], results: Sequence[Array]) -> Launched:
        """Results for components that broadcast to their shape, chunk by chunk."""
        for arguments, targets in parts_of_results(components, results, CHUNK):
            yield targets, ..., ready(self.values(arguments))

    def values(self, arguments: Sequence[Array]) -> tuple[Array, ...]:
        """The results of a chunk."""
        ops, frame = self.ops, self.tables.frame
        # what lies at infinity or is not a number is so in the result; no need to warn
        with np.errstate(invalid="ignore", over="ignore"):
            inner = entered(self.kernel, frame, arguments)
            if not ops.double:
                inner = tuple(a.astype(np.float32) for a in inner)
            sums = self.kernel.edge_sum(ops, self.tables, *inner)
            return self.kernel.leave(ops, frame, inner, sums)

    def of_parts(
        self, shared: SharedSlice, inner: tuple[Any, ...], ends: Array, table: Array, is_real: bool
    ) -> Fetch:
        """Results for rows and columns in the frame, the parts of row k at ``ends[k:k + 2]``."""
        inner = tuple(np.asarray(a, self.ops.dtype) for a in inner)
        rows, columns = np.broadcast_shapes((len(ends) - 1, 1), *(a.shape for a in inner))
        own = max(np.shape(f)[0] for f in inner[shared.frequency])  # rows, if each has its own
        nu = [np.broadcast_to(f, (own, columns)) for f in inner[shared.frequency]]
        run = shared.summed(self.ops, table.shape[1], is_real, *(f[:1, :1] for f in nu))
        sums = [np.zeros((rows, columns), self.ops.dtype) for _ in range(run.values)]
        table = table.astype(self.ops.dtype)
        with np.errstate(invalid="ignore", over="ignore"):
            for some in _slices(columns, CHUNK):
                at = [f[:, some] for f in nu]
                run = shared.summed(self.ops, table.shape[1], is_real, *at)

                def run_of(mine: Any, at: Any = at, run: PartSum = run) -> PartSum:
                    if own == 1:
                        return run
                    rows = (f[mine] for f in at)
                    return shared.summed(self.ops, table.shape[1], is_real, *rows)

                _sum_parts(run_of, ends, table, [total[:, some] for total in sums])
            # what lies at infinity or is not a number is so in the result
            for argument in (*inner[shared.place], *nu):
                if not np.isfinite(argument).all():
                    sums = [total + (argument - argument) for total in sums]
            total = shared.summed(self.ops, table.shape[1], is_real, *nu).total(tuple(sums))
            return ready(self.kernel.leave(self.ops, self.tables.frame, inner, total))


def _slices(length: int, step: int) -> Iterator[slice]:
    return (slice(k, k + step) for k in range(0, length, step))


def _sum_parts(
    run_of: Callable[[Any], PartSum], ends: Array, table: Array, sums: Sequence[Array]
) -> None:
    """Fill in the sums (rows, columns) over each row's parts.

    Rows with as many parts are taken together, so that nothing is computed in vain. ``run_of``:
    (numbers of rows) -> how to sum at their frequencies.
    """
    counts = np.diff(ends)
    for count in np.unique(counts[counts > 0]):
        (rows,) = np.nonzero(counts == count)
        for some in _slices(len(rows), max(1, CHUNK // (sums[0].shape[1] * count))):
            parts = table[ends[rows[some]] + np.arange(count)[:, None]]
            terms = run_of(rows[some]).term(*np.moveaxis(parts, -1, 0)[..., None])
            for total, found in zip(sums, terms, strict=True):
                total[rows[some]] = found.sum(axis=0)


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
        """Families of edges that are equal up to a translation; all along the axes are one."""
        return len(self.tables.oblique) + bool(self.tables.straight)

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
    chosen = planned(kernel, plan.tables, size, engine=engine, families=plan.families)
    if chosen.strategy != GRID:
        return None
    dtype = np.float64 if double else np.float32
    shape = components[-1].shape
    results = tuple(into or (np.empty(shape, dtype) for _ in range(2)))
    plan.fill(results, point_by_point)
    return results
