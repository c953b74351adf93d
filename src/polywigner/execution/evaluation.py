"""Evaluation of kernels at NumPy points, by NumPy or by compiled code.

Arguments are broadcast chunk by chunk, so a call needs memory only for its result and one chunk.
NumPy always computes in double precision. Fourier transforms on a grid of frequencies use the axes
of the grid, equation (F4).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import (
    DATA,
    GRID,
    LISTED,
    Plan,
    drjit_float,
    planned,
    resolved,
    terms_of,
)
from polywigner.execution.chunks import Launched, parts_of_results, ready, store
from polywigner.execution.on_drjit import OnDrjit, OnDrjitData, row_sums
from polywigner.execution.operations import NumpyOperations
from polywigner.kernels import GridTables, Kernel, fourier_on_grid
from polywigner.kernels.functions.slices import SliceSum

Array = npt.NDArray[Any]

# Smallest number of frequencies along each axis of a grid for which a Fourier transform is computed
# from the axes of the grid.
_LEAST_SIDE = 8
# Largest number of frequencies along each axis of a block. It limits the memory for the tables
# along the axes.
_TILE = 512
# Largest fraction of frequencies that are too close to the origin for equation (F4). Each of these
# frequencies takes 20 times as long as the others.
_MOST_BELOW = 1 / 8

PointByPoint = Callable[[Sequence[Array]], Sequence[Array]]
"""Function (nu_x, nu_y) that returns the real and the imaginary part of the Fourier transform."""


@dataclass(frozen=True)
class GridPlan:
    """A Fourier transform on a grid of frequencies, computed from the axes of the grid."""

    tables: GridTables
    x: Array
    y: Array
    transposed: bool
    """Whether the first axis of the results corresponds to y instead of x."""

    @property
    def families(self) -> int:
        """Number of families of parallel edges; edges parallel to an axis count as one family."""
        oblique = sum(not family.is_straight for family in self.tables.families)
        return oblique + (oblique < len(self.tables.families))

    def keeps_digits(self) -> bool:
        """Return whether most frequencies are far enough from the origin for equation (F4)."""
        below = 1.0
        for scale, nu in zip(self.tables.scales, (self.x, self.y), strict=True):
            below *= float(np.mean(np.abs(nu * scale) < self.tables.floor))
        return below < _MOST_BELOW

    def fill(self, results: Sequence[Array], point_by_point: PointByPoint) -> None:
        """Write the real and the imaginary part of the Fourier transform to two arrays.

        ``point_by_point`` computes the values near the origin, where equation (F4) loses digits.
        """
        ops = NumpyOperations()
        targets = [result.T if self.transposed else result for result in results]
        for i in range(0, len(self.x), _TILE):
            for j in range(0, len(self.y), _TILE):
                x, y = self.x[i : i + _TILE], self.y[j : j + _TILE]
                # Equation (F4) divides by the frequency. Its results near the origin are replaced
                # below.
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
    """Return a plan for a grid of frequencies, or None if the axes of the grid cannot be used.

    The result is None if the points do not form a grid of at least 8 x 8 frequencies, or if many
    frequencies are too close to the origin. It is also None for compiled engines, and for kernels
    and sources without tables for grids.
    """
    if kernel.grid_tables is None or engine not in ("auto", "numpy"):
        return None
    x, y = components
    if x.ndim != 2 or x.shape != y.shape or min(x.shape) < _LEAST_SIDE:
        return None
    transposed = not _are_axes_of_grid(x, y)
    if transposed:
        x, y = x.T, y.T
        if not _are_axes_of_grid(x, y):
            return None
    tables = kernel.grid_tables(source)
    if tables is None:
        return None
    axes = np.array(x[:, 0], np.float64), np.array(y[0], np.float64)
    plan = GridPlan(tables, *axes, transposed)
    return plan if plan.keeps_digits() else None


def _are_axes_of_grid(x: Array, y: Array) -> bool:
    """Return whether x varies only along the first axis of an array, and y along the second."""
    # Comparing the corners quickly excludes most arrays that are not a grid.
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
    """Compute the Fourier transform from the axes of a grid, if the points form a grid.

    Returns False, and leaves ``into`` unchanged, if the points do not form a grid or another method
    is faster.
    """
    plan = plan_for_grid(kernel, source, components, engine)
    if plan is None:
        return False
    size = components[-1].size
    choice = planned(kernel, plan.tables, size, engine=engine, families=plan.families)
    if choice.strategy == GRID:
        plan.fill(into, point_by_point)
    return choice.strategy == GRID


# Number of samples per chunk on NumPy. Temporary arrays below 128 KiB stay in the cache of a core.
# Larger arrays cause page faults that take longer than the computation.
_CHUNK = 3 << 12
# Number of samples per block if all frequencies at a position share its slice: with NumPy, and in
# compiled code. Compiled code stores only positions and frequencies, so its blocks can be larger.
_SHARED_BLOCK, _LARGE_BLOCK = 1 << 18, 1 << 20
# Smallest number of frequencies per position for which the slice at each position is computed only
# once.
_LEAST_COLUMNS = 64
# Largest number of (table row, point) pairs in memory. One array of pairs takes 32 MiB in float64.
_BLOCK = 1 << 22
# Largest product of table rows and samples per block. Temporary arrays take 2 MB for each result of
# a term.
_ROWS = 1 << 18

_HOST = NumpyOperations()

Shear = Callable[[Sequence[Array]], Sequence[Array]]


def evaluate(
    kernel: Kernel,
    source: Any,
    components: Sequence[Array],
    *,
    double: bool,
    engine: str,
    outputs: int,
    into: Sequence[Array] | None = None,
    shear: Shear | None = None,
) -> tuple[Array, ...]:
    """Return the results of a kernel at NumPy points.

    Arguments are converted to the frame of the source in float64, even if sums use float32. Raises
    EngineError if the requested engine is not available.

    Parameters
    ----------
    components : sequence of ndarray
        Components of the points in float64 or float32. The components must broadcast against each
        other.
    double : bool
        Whether sums and new arrays use float64 instead of float32.
    engine : str
        Requested engine.
    outputs : int
        Number of results.
    into : sequence of ndarray, optional
        Arrays for the results, of the broadcast shape, which are also returned. By default new
        arrays are returned.
    shear : callable, optional
        Function that converts the components to the arguments of the kernel, block by block if
        slices are shared.
    """
    shape = np.broadcast(*components).shape
    dtype = np.float64 if double else np.float32
    results = tuple(into or [np.empty(shape, dtype) for _ in range(outputs)])
    samples, is_explained = math.prod(shape), _is_explained.get()
    if not samples and not is_explained:
        return results
    if samples < _LEAST_COLUMNS and engine in ("auto", "numpy") and not is_explained:
        values = _on_numpy(kernel, kernel.tables_for(source, True), components, shear)
        for result, value in zip(results, values, strict=False):
            result[...] = value.reshape(shape)
        return results
    rows = shared_rows(kernel.edge_sum, components, shape)
    if shear is not None and (rows is None or rows.rows == 1):
        components, shear = shear(components), None
        rows = shared_rows(kernel.edge_sum, components, shape)
    grid = plan_for_grid(kernel, source, components, engine)
    tables = kernel.tables_for(source, double)
    plan = planned(
        kernel,
        tables,
        samples,
        engine=engine,
        shape=None if rows is None else (rows.rows, rows.columns),
        families=None if grid is None else grid.families,
    )
    if is_explained:
        raise _ExplainedError(plan)
    if plan.strategy != LISTED and shear is not None:
        components = shear(components)
    if plan.strategy == GRID and grid is not None:
        exact = kernel.tables_for(source, True)
        grid.fill(results, lambda points: _on_numpy(kernel, exact, points))
    elif plan.strategy == LISTED and rows is not None:
        store(_in_row_blocks(kernel, source, double, plan.engine, rows, results, shear), samples)
    elif plan.engine == "numpy":
        tables = kernel.tables_for(source, True)
        store(_in_chunks(kernel, tables, components, results), samples)
    else:
        compiled: OnDrjit | OnDrjitData
        if plan.strategy == DATA:
            compiled = OnDrjitData(kernel, tables, drjit_float(plan.engine, double), samples)
        else:
            compiled = OnDrjit(kernel, tables, double, plan.engine)
        store(compiled.points(components, results), samples)
    return results


class _ExplainedError(Exception):
    def __init__(self, plan: Plan) -> None:
        self.plan = plan


_is_explained: ContextVar[bool] = ContextVar("_is_explained", default=False)


def explained(call: Callable[[], object]) -> Plan | None:
    """Run ``call()`` up to its first kernel, and return the plan of this kernel.

    Returns None if the call evaluates no kernel on NumPy arrays.
    """
    token = _is_explained.set(True)
    try:
        call()
    except _ExplainedError as error:
        return error.plan
    finally:
        _is_explained.reset(token)
    return None


def _on_numpy(
    kernel: Kernel, tables: Any, components: Sequence[Array], shear: Shear | None = None
) -> tuple[Array, ...]:
    """Compute the results (n,) of a kernel with NumPy; the components of points are broadcast."""
    # Infinite and NaN arguments give NaN without a warning.
    with np.errstate(invalid="ignore", over="ignore"):
        if shear is not None:
            components = shear(components)
        shape = np.broadcast(*components).shape
        flat = []
        for c in components:
            c = c if c.shape == shape else np.broadcast_to(c, shape)
            flat.append(c.astype(np.float64, copy=False).reshape(-1))
        inner = kernel.enter(_HOST, tables.frame, *flat)
        return kernel.leave(_HOST, tables.frame, inner, kernel.edge_sum(_HOST, tables, *inner))


def _in_chunks(
    kernel: Kernel, tables: Any, components: Sequence[Array], results: Sequence[Array]
) -> Launched:
    """Yield chunks of samples, computed by NumPy, for :func:`store`."""
    for arguments, targets in parts_of_results(components, results, _CHUNK):
        yield targets, ..., ready(_on_numpy(kernel, tables, arguments)[: len(results)])


@dataclass(frozen=True, eq=False)
class SharedRows:
    """Arguments of W or A for several frequencies at each position.

    Samples at one position form a row and share a slice. Each argument has the shape (rows, 1) or
    (1, columns).
    """

    components: tuple[Array, ...]
    rows: int
    columns: int
    transposed: bool = False
    """Whether rows and columns are exchanged in the results."""

    def blocks(self, size: int) -> Iterator[tuple[tuple[slice, slice], tuple[Array, ...]]]:
        """Yield blocks of about ``size`` samples, and the arguments of each block in float64."""
        columns = min(self.columns, size)
        rows = max(1, size // columns)
        for r in range(0, self.rows, rows):
            for c in range(0, self.columns, columns):
                block = slice(r, r + rows), slice(c, c + columns)
                parts = (
                    a[block[0]] if len(a) > 1 else a[:, block[1]] if a.shape[1] > 1 else a
                    for a in self.components
                )
                yield block, tuple(a.astype(np.float64, copy=False) for a in parts)

    def targets(self, results: Sequence[Array]) -> list[Array]:
        """Return views of the result arrays with the shape (rows, columns)."""
        if self.transposed:
            return [result.reshape(self.columns, self.rows).T for result in results]
        return [result.reshape(self.rows, self.columns) for result in results]


def shared_rows(
    edge_sum: object, components: Sequence[Array], shape: tuple[int, ...]
) -> SharedRows | None:
    """Return the arguments as rows of samples at the same position.

    ``edge_sum`` is the attribute ``edge_sum`` of the kernel, and ``shape`` is the broadcast shape
    of the components.

    The result is None if the kernel computes no slices, or if the broadcast axes cannot be divided
    into axes of positions and axes of at least 64 frequencies.
    """
    positions = edge_sum.arguments if isinstance(edge_sum, SliceSum) else None
    if positions is None or math.prod(shape) < _LEAST_COLUMNS:
        return None
    padded = [c.reshape((1,) * (len(shape) - c.ndim) + c.shape) for c in components]
    for k in range(len(shape)):
        in_head = [math.prod(c.shape[k:]) == 1 for c in padded]
        in_tail = [math.prod(c.shape[:k]) == 1 for c in padded]
        if not all(a or b for a, b in zip(in_head, in_tail, strict=True)):
            continue
        head, tail = math.prod(shape[:k]), math.prod(shape[k:])
        transposed = not (tail >= _LEAST_COLUMNS and all(in_head[positions]))
        if transposed and not (head >= _LEAST_COLUMNS and all(in_tail[positions])):
            continue
        flat = [
            np.broadcast_to(c.reshape(c.shape[:k]), shape[:k]).reshape(-1, 1)
            if is_row
            else np.broadcast_to(c.reshape(c.shape[k:]), shape[k:]).reshape(1, -1)
            for c, is_row in zip(padded, in_head, strict=True)
        ]
        if transposed:
            return SharedRows(tuple(f.T for f in flat), tail, head, transposed=True)
        return SharedRows(tuple(flat), head, tail)
    return None


def _in_row_blocks(
    kernel: Kernel,
    source: Any,
    double: bool,
    engine: str,
    rows: SharedRows,
    results: Sequence[Array],
    shear: Shear | None,
) -> Launched:
    """Yield blocks of rows for :func:`store`; the samples of a row share a slice."""
    slices, exact = kernel.edge_sum, kernel.tables_for(source, True)
    assert isinstance(slices, SliceSum)
    compiled = None
    if engine != "numpy":
        compiled = OnDrjit(kernel, kernel.tables_for(source, double), double, engine)
    is_large = compiled is not None and rows.rows > 1
    targets = rows.targets(results)
    for block, arguments in rows.blocks(_LARGE_BLOCK if is_large else _SHARED_BLOCK):
        count = len(range(*block[0].indices(rows.rows)))
        # Positions far from the source may cause an overflow.
        with np.errstate(invalid="ignore", over="ignore"):
            sheared = arguments if shear is None else shear(arguments)
            inner = kernel.enter(_HOST, exact.frame, *sheared)
            if compiled is not None:
                position = [np.broadcast_to(p, (count, 1))[:, 0] for p in inner[slices.position]]
                fetch = compiled.of_parts(inner, *slices.listed(_HOST, exact, *position))
                yield targets, block, fetch
                continue
            sums = slices(_HOST, exact, *inner)
            values = kernel.leave(_HOST, exact.frame, inner, sums)
        yield targets, block, ready(tuple(values[: len(results)]))


def evaluate_sums(
    kernel: Kernel,
    source: Any,
    positions: Array,
    weights: Array,
    points: Array,
    constants: Sequence[float],
    *,
    double: bool,
    engine: str,
) -> Array:
    """Return, for each point, the weighted sum of a kernel over all positions.

    The sum of weight × kernel(*position, *point, *constants) over all positions has the shape (n,).
    The kernel must have one real result. The memory use is proportional to the number of positions.

    Parameters
    ----------
    positions : ndarray, shape (m, a)
        First arguments of the kernel.
    weights : ndarray, shape (m,)
        Real weight of each position.
    points : ndarray, shape (n, b)
        Next arguments of the kernel.
    constants : sequence of float
        Last arguments of the kernel.
    """
    total = np.zeros(len(points))
    terms = terms_of(kernel, kernel.tables_for(source, double))
    actual = resolved(engine, len(positions) * len(points), terms)
    how: Any = {"double": double, "engine": actual, "outputs": 1}
    fixed = [np.array(value) for value in constants]
    step = max(1, _BLOCK // len(positions))
    for start in range(0, len(points), step):
        block = slice(start, start + step)
        components = [*positions.T, *points[block].T[:, :, None], *fixed]
        (values,) = evaluate(kernel, source, components, **how)
        total[block] = values @ weights
    return total


def evaluate_rows(
    term: Callable[..., tuple[Any, ...]],
    table: Array,
    samples: Array,
    constants: Array,
    outputs: int,
    engine: str,
) -> tuple[Array, ...]:
    """Return the sums of ``term(ops, row, sample, constants)`` over the rows of a table.

    Sums use double precision. Compiled code reads rows and constants from memory, so a call with
    other values compiles nothing.

    Parameters
    ----------
    term : callable
        Function that returns ``outputs`` numbers. ``row``, ``sample`` and ``constants`` are tuples.
    table : ndarray, shape (m, a)
        Rows over which ``term`` is summed.
    samples : ndarray, shape (n, b)
        Samples, each with one result per output.
    constants : ndarray, shape (c,)
        Constant arguments of ``term``.

    Returns
    -------
    tuple of ndarray, each of shape (n,)
    """
    actual = resolved(engine, len(samples), len(table))
    if actual != "numpy":
        return row_sums(term, table, samples.T, constants, outputs, actual)
    columns, total = tuple(samples.T), np.zeros((outputs, len(samples)))
    step = max(1, _ROWS // len(samples))
    for start in range(0, len(table), step):
        rows = tuple(table[start : start + step].T[:, :, None])
        terms = term(_HOST, rows, columns, tuple(constants.tolist()))
        shape = len(rows[0]), len(samples)  # Terms are broadcast to this shape.
        total += [np.broadcast_to(part, shape).sum(axis=0) for part in terms]
    return tuple(total)
