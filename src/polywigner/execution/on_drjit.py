"""A kernel of a source compiled by Dr.Jit, on NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import drjit_float
from polywigner.execution.chunks import Fetch, Launched, aligned, parts_of_results
from polywigner.execution.frozen import frozen, is_code, is_recording
from polywigner.execution.operations import DrjitOperations, NumpyOperations
from polywigner.kernels import Kernel, SharedSlice
from polywigner.kernels.arrays.repeated import RepeatedTables
from polywigner.kernels.outline.tables import Tables, cut_of

# Samples at a time: launching costs little against computing, and the arguments of a chunk
# take some 10 MB.
_CHUNK = 1 << 18
# Samples at a time where arguments are pairs: nothing is fed from memory.
_PAIRS_CHUNK = 1 << 20

Array = npt.NDArray[Any]


class OnDrjit:
    """A kernel of a source, traced with Dr.Jit."""

    block = shared_block = _PAIRS_CHUNK

    def __init__(self, kernel: Kernel, tables: Any, double: bool, engine: str) -> None:
        self.kernel, self.tables = kernel, _cut(tables)
        self.ops = DrjitOperations(drjit_float(engine, double))
        self.entry = DrjitOperations(drjit_float(engine, double=True))
        self.dtype = np.dtype(np.float64 if double else np.float32)
        self.memory: dict[tuple[int, int], Array] = {}
        self.turn = 0
        self.is_code = is_code(kernel, self.ops, self.tables)

    def points(self, components: Sequence[Array], results: Sequence[Array]) -> Launched:
        """Results for components that broadcast to their shape, chunk by chunk."""
        for arguments, targets in parts_of_results(components, results, _CHUNK):
            yield targets, ..., self._begun(arguments)

    def _begun(self, arguments: Sequence[Array]) -> Fetch:
        """Begins to compute the results of a chunk; waits for them when they are fetched.

        Meanwhile the next chunk may begin, but not yet the one after it.
        """
        self.turn ^= 1
        whole: Callable[..., tuple[Any, ...]] = self.traced
        kind = self.ops.float_type
        if self.is_code and not is_recording(kind):
            owners = (self.kernel, self.tables)
            whole = frozen(lambda: (self._kept().traced, ()), owners, kind)
        return _fetching(whole(*self._sent_all(arguments)))

    def _kept(self) -> OnDrjit:
        """A copy for a frozen function, which is to keep no memory of chunks."""
        kept = copy(self)
        kept.memory = {}
        return kept

    def traced(self, *arguments: Any) -> tuple[Any, ...]:
        """Results for arrays of ``entry``'s type."""
        inner = self.kernel.enter(self.entry, self.tables.frame, *arguments)
        if not self.ops.double:
            inner = tuple(self.ops.float_type(a) for a in inner)
        return self._of_inner(inner)

    def of_pairs(self, arguments: Sequence[Array]) -> Fetch:
        """Results (rows, columns) for arguments of shape (rows, 1) and (1, columns)."""
        self.turn ^= 1
        entered = self.entered(arguments)
        shape = np.broadcast_shapes(*(np.shape(a) for a in entered))
        inner = self.looked_up(entered, shape, *split(self.ops.float_type, *shape))
        return _fetching(self._of_inner(inner), shape)

    def of_parts(
        self, shared: SharedSlice, inner: tuple[Any, ...], ends: Array, table: Array, is_real: bool
    ) -> Fetch:
        """Results for rows and columns in the frame, the parts of row k at ``ends[k:k + 2]``."""
        self.turn ^= 1
        return of_parts(self, shared, inner, ends, table, is_real)

    def looked_up(
        self, inner: Sequence[Any], shape: tuple[int, int], row: Any, column: Any
    ) -> tuple[Any, ...]:
        """Arguments in the frame, of one shape or another, at each sample's row and column."""
        import drjit

        kind, (rows, columns) = self.ops.float_type, shape

        def found(slot: int, values: Any) -> Any:
            if np.ndim(values) == 0:
                return drjit.opaque(kind, float(values))
            memory = self._sent(slot, values.ravel(), kind)
            whole = drjit.fma(row, drjit.opaque(type(row), columns), column)
            place = {(rows, 1): row, (1, columns): column}.get(values.shape, whole)
            return drjit.gather(kind, memory, place)

        return tuple(found(slot, values) for slot, values in enumerate(inner))

    def entered(self, arguments: Sequence[Array]) -> tuple[Any, ...]:
        """The arguments in the frame, in the shapes that they have."""
        with np.errstate(invalid="ignore", over="ignore"):
            return self.kernel.enter(NumpyOperations(double=True), self.tables.frame, *arguments)

    def _of_inner(self, inner: tuple[Any, ...]) -> tuple[Any, ...]:
        sums = self.kernel.edge_sum(self.ops, self.tables, *inner)
        return self.kernel.leave(self.ops, self.tables.frame, inner, sums)

    def _sent_all(self, arrays: Sequence[Array]) -> tuple[Any, ...]:
        kind = self.entry.float_type
        return tuple(self._sent(slot, array, kind) for slot, array in enumerate(arrays))

    def _sent(self, slot: int, array: Array, kind: Any) -> Any:
        """The chunk as an engine's array, in memory that every other chunk uses.

        Dr.Jit uses NumPy's memory in place and compiles a kernel anew for each alignment that it
        happens to have; here the alignment is always the same.
        """
        key = slot, self.turn
        if key not in self.memory or len(self.memory[key]) < array.size:
            dtype = np.float64 if kind is self.entry.float_type else np.float32
            self.memory[key] = aligned(array.size, dtype)
        memory = self.memory[key][: array.size]
        memory[...] = array
        return kind(memory)


def _fetching(results: Sequence[Any], shape: tuple[int, ...] = (-1,)) -> Fetch:
    """Begins to compute results; waits for them when they are fetched."""
    import drjit

    drjit.eval(results)
    return lambda: tuple(np.asarray(r.numpy()).reshape(shape) for r in results)


def _cut(tables: Any) -> Any:
    """Tables with edges to be cut as planned, or as suits a compiled kernel."""
    if isinstance(tables, RepeatedTables):
        return replace(tables, element=_cut(tables.element))
    return tables.cut_by(cut_of("compiled", tables)) if isinstance(tables, Tables) else tables


# Samples of one place that a lane of a compiled kernel computes together.
_TOGETHER = 4


@dataclass(frozen=True)
class _Runs:
    """Columns in runs of one length, the last of which may overlap the one before."""

    length: int
    starts: list[int]


def _runs(columns: int) -> _Runs:
    length = -(-columns // _TOGETHER)
    return _Runs(length, [min(k * length, columns - length) for k in range(_TOGETHER)])


def of_parts(
    compute: OnDrjit,
    shared: SharedSlice,
    inner: tuple[Any, ...],
    ends: Array,
    table: Array,
    is_real: bool,
) -> Fetch:
    """Results for rows and columns in the frame, the parts of row k at ``ends[k:k + 2]``.

    A part is looked up once for several columns, since that takes as long as to compute its
    term: the columns are taken in a few runs of one length, the last of which may overlap the
    one before.
    """
    import drjit

    ops, kind = compute.ops, compute.ops.float_type
    rows, columns = np.broadcast_shapes(*(np.shape(a) for a in inner))
    spans = _runs(columns)
    row, column = split(kind, rows, spans.length)
    limits = ops.held(ends[:, None].astype(np.uint32))
    (first,), (end,) = (ops.gather(limits, row + k) for k in (0, 1))
    held = ops.held(table if len(table) else np.zeros((1, table.shape[1])))
    runs, arguments, lost = [], [], []
    for start in spans.starts:
        at = column + drjit.opaque(type(column), start)
        mine = compute.looked_up(inner, (rows, columns), row, at)
        frequency = mine[shared.frequency]
        runs.append(shared.summed(ops, table.shape[1], is_real, *frequency))
        arguments.append(mine)
        # what lies at infinity or is not a number is so in the result
        lost.append(sum(a - a for a in (*mine[shared.place], *frequency)))

    def terms(number: Any) -> tuple[Any, ...]:
        part = ops.gather(held, number)
        return tuple(value for run in runs for value in run.term(*part))

    count = runs[0].values
    sums = ops.plain_sum(first, end, terms, _TOGETHER * count)
    results: list[tuple[Any, ...]] = []
    for k, run in enumerate(runs):
        own = run.total(tuple(value + lost[k] for value in sums[k * count : (k + 1) * count]))
        results.append(compute.kernel.leave(ops, compute.tables.frame, arguments[k], own))
    return _fetching_runs(compute.dtype, results, spans, (rows, columns))


def _fetching_runs(
    dtype: np.dtype[Any], results: Sequence[tuple[Any, ...]], runs: _Runs, shape: tuple[int, ...]
) -> Fetch:
    """Begins to compute results by runs of columns; waits for them when they are fetched."""
    import drjit

    drjit.eval(results)

    def fetch() -> tuple[Array, ...]:
        found = tuple(np.empty(shape, dtype) for _ in results[0])
        for start, values in zip(runs.starts, results, strict=True):
            for whole, value in zip(found, values, strict=True):
                own = value.numpy().reshape(shape[0], runs.length)
                whole[:, start : start + runs.length] = own
        return found

    return fetch


def split(kind: Any, rows: int, columns: int) -> tuple[Any, Any]:
    """Row and column of each of rows x columns samples."""
    import drjit

    index = drjit.arange(drjit.uint32_array_t(kind), rows * columns)
    # Opaque, or there would be a kernel for each number of columns. A division of fewer than
    # 2^21 samples: half a sample is more than two roundings, to float32, of the quotient.
    row = type(index)((kind(index) + 0.5) * drjit.opaque(kind, 1 / columns))
    return row, index - row * drjit.opaque(type(index), columns)
