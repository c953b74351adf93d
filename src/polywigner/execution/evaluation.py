"""Kernels on NumPy arrays: broadcast, cut into chunks, computed by NumPy or Dr.Jit.

Memory is bounded by the result plus one chunk: broadcast arguments are never expanded as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import DATA, GRID, LISTED, Plan, planned, resolved, terms_of
from polywigner.execution.chunks import Launched, store
from polywigner.execution.on_drjit import OnDrjit, OnDrjitData, row_sums
from polywigner.execution.on_numpy import OnNumpy, entered, plan_for_grid
from polywigner.execution.operations import NumpyOperations
from polywigner.kernels import Kernel, SharedSlice
from polywigner.kernels.outline.tables import Tables

# Samples of one row at a time, of which nothing is gained by longer blocks.
_ROW_BLOCK = 1 << 18
# In shorter rows little is shared.
_LEAST_COLUMNS = 64
# Pairs of a place and a point whose terms are stored at a time: 32 MiB in float64.
_BLOCK = 1 << 22
# Of rows and samples, whose terms are long: some MB for each number of a term.
_ROWS = 1 << 18

Array = npt.NDArray[Any]
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
    """Results of a kernel for float64 or float32 components that broadcast to one shape.

    Arguments enter the frame in float64 whatever the precision of the sums. ``into``: arrays of
    that shape and precision for the results, such as both parts of a complex one. ``shear``: to
    the components that are meant, from those given; where slices are listed, block by block.
    """
    shape = np.broadcast_shapes(*(c.shape for c in components))
    dtype = np.float64 if double else np.float32
    results = tuple(into or (np.empty(shape, dtype) for _ in range(outputs)))
    if 0 in shape:
        return results
    call = _Call(kernel, source, components, double, engine)
    chosen = call.plan
    is_listed = chosen.strategy == LISTED
    if shear is not None and not (is_listed and call.pairs is not None and call.pairs.rows > 1):
        how: Any = {"double": double, "engine": engine, "outputs": outputs, "into": results}
        return evaluate(kernel, source, shear(components), **how)
    if chosen.strategy == GRID:
        assert call.grid is not None
        call.grid.fill(results, OnNumpy(kernel, call.tables, double).values)
    else:
        store(_launched(call, chosen, results, shear), results[0].size)
    return results


def explained(
    kernel: Kernel, source: Any, components: Sequence[Array], *, double: bool, engine: str
) -> Plan:
    """Return the plan by which :func:`evaluate` computes a call; nothing is computed."""
    return _Call(kernel, source, components, double, engine).plan


def evaluate_sums(
    kernel: Kernel,
    source: Any,
    places: Array,
    weights: Array,
    points: Array,
    constants: Sequence[float],
    *,
    double: bool,
    engine: str,
) -> Array:
    """sum_j weights_j kernel(*places_j, *point, *constants) at each point, float64 (n,).

    places (m, a), weights (m,), points (n, b); the kernel takes a + b + len(constants) components
    and has one real output. Terms are stored block by block.
    """
    total = np.zeros(len(points))
    if not len(points) or not len(places):
        return total
    terms = terms_of(kernel, kernel.tables(source, double))
    found = resolved(engine, len(places) * len(points), terms)
    how: Any = {"double": double, "engine": found, "outputs": 1}
    fixed = [np.array(value) for value in constants]
    step = min(len(places), _BLOCK)
    width = max(1, _BLOCK // step)
    for start in range(0, len(places), step):
        some = slice(start, start + step)
        for low in range(0, len(points), width):
            columns = slice(low, low + width)
            components = [*places[some].T, *points[columns].T[:, :, None], *fixed]
            (values,) = evaluate(kernel, source, components, **how)
            total[columns] += values @ weights[some]
    return total


def evaluate_rows(
    term: Callable[..., tuple[Any, ...]],
    table: Array,
    samples: Array,
    constants: Array,
    outputs: int,
    engine: str,
) -> tuple[Array, ...]:
    """Sums of term(ops, row, sample, constants) over the rows of a table, in double precision.

    table (m, a), samples (n, b), constants (c,); ``outputs`` arrays (n,). On Dr.Jit the rows and
    the constants are data of one loop: other ones compile nothing.
    """
    found = resolved(engine, len(samples), len(table))
    if found == "numpy":
        return _rows_on_numpy(term, table, samples.T, tuple(constants.tolist()), outputs)
    return row_sums(term, table, samples.T, constants, outputs, found)


def _rows_on_numpy(
    term: Callable[..., tuple[Any, ...]],
    table: Array,
    columns: Array,
    constants: tuple[float, ...],
    outputs: int,
) -> tuple[Array, ...]:
    ops = NumpyOperations(double=True)
    total = np.zeros((outputs, columns.shape[1]))
    step = max(1, _ROWS // columns.shape[1])
    for start in range(0, len(table), step):
        rows = tuple(table[start : start + step].T[:, :, None])
        total += [part.sum(axis=0) for part in term(ops, rows, tuple(columns), constants)]
    return tuple(total)


class _Call:
    """A kernel, its arguments, and the plan."""

    def __init__(
        self, kernel: Kernel, source: Any, components: Sequence[Array], double: bool, engine: str
    ) -> None:
        self.kernel, self.source, self.components, self.double = kernel, source, components, double
        shape = np.broadcast_shapes(*(c.shape for c in components))
        self.tables = kernel.tables(source, double)
        shared = _listed_by(kernel)
        self.pairs = None if shared is None else _places_by_frequencies(shared, components, shape)
        self.grid = None
        if engine in ("auto", "numpy") and components[-1].shape == shape:
            self.grid = plan_for_grid(kernel, source, components, double)
        self.plan = planned(
            kernel,
            self.tables,
            math.prod(shape),
            engine=engine,
            shape=None if self.pairs is None else (self.pairs.rows, self.pairs.columns),
            families=None if self.grid is None else self.grid.families,
        )


def _listed_by(kernel: Kernel) -> SharedSlice | None:
    """The way to list parts of a kernel's slices; None where they are not listed."""
    return None if kernel.slices is None else kernel.slices.listed


def _launched(call: _Call, chosen: Plan, results: Sequence[Array], shear: Shear | None) -> Launched:
    """The chunks of a call, by the way that was chosen."""
    kernel, tables, double, pairs = call.kernel, call.tables, call.double, call.pairs
    if chosen.strategy == DATA:
        samples = results[0].size
        data = OnDrjitData(kernel, tables, double, chosen.engine, samples, len(results))
        return data.points(call.components, results)
    compute: OnNumpy | OnDrjit
    if chosen.engine == "numpy":
        compute = OnNumpy(kernel, tables, double)
    else:
        compute = OnDrjit(kernel, tables, double, chosen.engine)
    if chosen.strategy == LISTED:
        assert pairs is not None
        exact = kernel.tables(call.source, True)
        return _by_parts(compute, exact, pairs, pairs.targets(results), shear)
    return compute.points(call.components, results)


def _by_parts(
    compute: OnNumpy | OnDrjit,
    exact: Tables,
    pairs: Pairs,
    targets: Sequence[Array],
    shear: Shear | None,
) -> Launched:
    """The slice of each place listed once, from tables in double precision."""
    shared, host = _listed_by(compute.kernel), NumpyOperations(double=True)
    assert shared is not None
    size = compute.shared_block if pairs.rows > 1 else _ROW_BLOCK
    for block, arguments in pairs.blocks(size):
        sheared = arguments if shear is None else shear(arguments)
        inner = entered(compute.kernel, compute.tables.frame, sheared)
        count = len(range(*block[0].indices(pairs.rows)))
        place = (np.broadcast_to(np.ravel(p), count) for p in inner[shared.place])
        with np.errstate(invalid="ignore", over="ignore"):  # of places far beyond the source
            (owners, table), is_real = shared.parts(host, exact, *place)
        ends = np.searchsorted(owners, np.arange(count + 1))
        yield targets, block, compute.of_parts(shared, inner, ends, table, is_real)


@dataclass(frozen=True, eq=False)
class Pairs:
    """Components of shape (rows, 1) or (1, columns) each."""

    components: tuple[Array, ...]
    rows: int
    columns: int
    transposed: bool = False
    """Whether rows are columns of the results."""

    def blocks(self, size: int) -> Iterator[tuple[tuple[slice, slice], tuple[Array, ...]]]:
        """Rows and columns of blocks of about ``size`` samples, and their components in float64."""
        columns = min(self.columns, size)
        rows = max(1, size // columns)
        for r in range(0, self.rows, rows):
            for c in range(0, self.columns, columns):
                place = slice(r, r + rows), slice(c, c + columns)
                own = (
                    a[place[0]] if len(a) > 1 else a[:, place[1]] if a.shape[1] > 1 else a
                    for a in self.components
                )
                yield place, tuple(a.astype(np.float64, copy=False) for a in own)

    def targets(self, results: Sequence[Array]) -> list[Array]:
        """The results, rows by columns."""
        if self.transposed:
            return [result.reshape(self.columns, self.rows).T for result in results]
        return [result.reshape(self.rows, self.columns) for result in results]


def _places_by_frequencies(
    shared: SharedSlice, components: Sequence[Array], shape: tuple[int, ...]
) -> Pairs | None:
    """The arguments with each place a row, of the frequencies it meets; None where they are not."""
    pairs, places, count = pairs_of(components, shape), shared.arguments, math.prod(shape)
    if pairs is None:
        if count < _LEAST_COLUMNS or any(c.size > 1 for c in components[places]):
            return None
        whole = (c if c.size == 1 else np.broadcast_to(c, shape) for c in components)
        return Pairs(tuple(c.reshape(1, -1) for c in whole), 1, count)
    if all(c.shape == (1, pairs.columns) for c in pairs.components[places]):
        turned = tuple(c.T for c in pairs.components)
        pairs = Pairs(turned, pairs.columns, pairs.rows, transposed=True)
    return None if any(c.shape[1] > 1 for c in pairs.components[places]) else pairs


def pairs_of(components: Sequence[Array], shape: tuple[int, ...]) -> Pairs | None:
    """Components that broadcast to ``shape`` as rows and columns; None where they are none."""
    dimensions = len(shape)
    whole = [c.reshape((1,) * (dimensions - c.ndim) + c.shape) for c in components]
    best: tuple[int, int] | None = None
    for k in range(1, dimensions):
        rows, columns = math.prod(shape[:k]), math.prod(shape[k:])
        if rows < 2 or columns < _LEAST_COLUMNS:
            continue
        if all(c.size == math.prod(c.shape[:k]) or c.size == math.prod(c.shape[k:]) for c in whole):
            best = min(best or (rows + columns, k), (rows + columns, k))
    if best is None:
        return None
    k = best[1]

    def flat(component: Array) -> Array:
        if component.size == math.prod(component.shape[k:]):
            return np.broadcast_to(component.reshape(component.shape[k:]), shape[k:]).reshape(1, -1)
        leading = component.reshape(component.shape[:k])
        return np.broadcast_to(leading, shape[:k]).reshape(-1, 1)

    return Pairs(tuple(map(flat, whole)), math.prod(shape[:k]), math.prod(shape[k:]))
