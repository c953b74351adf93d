"""Kernels compiled by Dr.Jit, on NumPy arrays: with an outline as code, or one kernel for all.

A kernel with an outline as code takes a tenth of a second to compile, and some hundred kilobytes
of the process for good. The one whose outlines are data is a third to half as fast.
"""

from __future__ import annotations

import gc
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import drjit_float
from polywigner.execution.chunks import Fetch, Launched, array_of, parts_of_results, store
from polywigner.execution.drjit_operations import MOST_TERMS_AS_CODE, DrjitOperations
from polywigner.execution.operations import NumpyOperations
from polywigner.kernels import Kernel
from polywigner.kernels.cut.pair_grid import cells_at
from polywigner.kernels.cut.winding import pairs_of
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.functions.slices import MOST_PAIRS_AS_CODE
from polywigner.kernels.outline.frame import Frame
from polywigner.kernels.outline.tables import Tables, is_plain
from polywigner.numerics import phases

# What is remembered: of so many sources and kinds of arrays, and of each so many configurations
# (arguments that are one number, and others).
_MOST, _MOST_RECORDINGS = 64, 8
# Samples at a time: launching costs little against computing, and arguments take some 10 MB.
_CHUNK, _CHUNK_OF_DATA = 1 << 18, 1 << 17

Array = npt.NDArray[Any]
Values = tuple[Any, ...]
Function = Callable[..., Values]


class _Frozen:
    """A function that is recorded when it is first called."""

    def __init__(self, function: Function, owners: Sequence[Any]) -> None:
        import drjit

        # Dr.Jit goes through all that a function refers to in each call, but not through an object.
        held = SimpleNamespace(function=function)

        def replayed(*arguments: Any) -> Any:
            return held.function(*arguments)

        self.replayed = drjit.freeze(replayed, limit=_MOST_RECORDINGS, warn_after=1 << 30)
        self.owners = owners
        # Dr.Jit ends the process when two threads record one function at the same time.
        self.lock = threading.Lock()

    def __call__(self, *arguments: Any) -> Values:
        with self.lock, without_collection():
            try:
                found: Values = self.replayed(*arguments)
            except RuntimeError as error:
                # Dr.Jit's own, in place of what stopped the function: an interrupt, for one
                raise error.__cause__ or error from None
            return found


_paused: list[bool] = []
"""For each recording that goes on: whether garbage was collected before it."""


@contextmanager
def without_collection() -> Iterator[None]:
    """No garbage is collected meanwhile.

    Dr.Jit ends the process when an array that holds memory of NumPy's is freed in a thread that is
    recording, and whatever a collection frees would be freed there.
    """
    with _lock:
        _paused.append(gc.isenabled())
        gc.disable()
    try:
        yield
    finally:
        with _lock:
            was_enabled = _paused.pop()
            if _paused:
                _paused[0] |= was_enabled
            elif was_enabled:
                gc.enable()


_known: OrderedDict[Hashable, _Frozen] = OrderedDict()
_lock = threading.Lock()


def frozen(function: Function, owners: Sequence[Any], *kind: Hashable) -> Function:
    """A function of Dr.Jit arrays, or one that is known from an earlier call.

    It must not depend on the number of samples, nor bring memory of its own into being.

    ``owners``: the objects on which it depends, as such and not by their values; ``kind``: what
    else it depends on.
    """
    key = (*map(id, owners), *kind)
    with _lock:
        if key not in _known:
            _known[key] = _Frozen(function, owners)  # keeps the owners, and with them their ids
            while len(_known) > _MOST:
                _known.popitem(last=False)
        _known.move_to_end(key)
        return _known[key]


def is_code(kernel: Kernel, tables: Any) -> bool:
    """Whether all numbers of a source are constants of a kernel's code, not memory."""
    if isinstance(tables, Tables) and kernel.slices is not None:
        return tables.fits_code
    return isinstance(tables, Tables | OutlineTables) and len(tables.edges) <= MOST_TERMS_AS_CODE


def is_recording(kind: Any) -> bool:
    """Whether Dr.Jit records the computation, or the type belongs to another backend than LLVM."""
    import drjit

    scopes = (drjit.JitFlag.SymbolicScope, drjit.JitFlag.FreezingScope)
    return drjit.backend_v(kind) != drjit.JitBackend.LLVM or any(map(drjit.flag, scopes))


def is_known(components: Sequence[Any]) -> bool:
    """Whether arrays are evaluated, without derivatives, and nothing is being recorded."""
    import drjit

    if is_recording(components[0]):
        return False
    # what is yet to be computed is so together with the kernel
    known = (drjit.VarState.Evaluated, drjit.VarState.Literal)
    return all(c.state in known and not drjit.grad_enabled(c) for c in components)


class OnDrjit:
    """A kernel of a source, traced with Dr.Jit."""

    def __init__(self, kernel: Kernel, tables: Any, double: bool, engine: str) -> None:
        self.kernel, self.tables = kernel, tables
        self.ops = DrjitOperations(drjit_float(engine, double))
        self.entry = DrjitOperations(drjit_float(engine, double=True))
        self.is_code = is_code(kernel, self.tables)

    def points(self, components: Sequence[Array], results: Sequence[Array]) -> Launched:
        """Results for components that broadcast to their shape, chunk by chunk."""
        kind = self.ops.float_type
        whole: Callable[..., tuple[Any, ...]] = self._traced
        if self.is_code and not is_recording(kind):
            whole = frozen(self._traced, (self.kernel, self.tables), kind)
        for arguments, targets in parts_of_results(components, results, _CHUNK):
            yield (
                targets,
                ...,
                _fetching(whole(*(array_of(self.entry.float_type, array) for array in arguments))),
            )

    def _traced(self, *arguments: Any) -> tuple[Any, ...]:
        """Results for arrays of ``entry``'s type."""
        inner = self.kernel.enter(self.entry, self.tables.frame, *arguments)
        if not self.ops.double:
            inner = tuple(self.ops.float_type(a) for a in inner)
        sums = self.kernel.edge_sum(self.ops, self.tables, *inner)
        return self.kernel.leave(self.ops, self.tables.frame, inner, sums)

    def of_parts(self, inner: tuple[Any, ...], ends: Array, table: Array, is_real: bool) -> Fetch:
        """Results for rows and columns in the frame, the parts of row k at ``ends[k:k + 2]``."""
        ops, slices = self.ops, self.kernel.slices
        assert slices is not None
        shape = np.broadcast_shapes(*(np.shape(a) for a in inner))
        row, column = _split(ops.float_type, *shape)
        limits = ops.held(ends[:, None].astype(np.uint32))
        (first,), (end,) = (ops.gather(limits, row + k) for k in (0, 1))
        rows = ops.held(table if len(table) else np.zeros((1, table.shape[1])))
        at = tuple(self._looked_up(values, shape, row, column) for values in inner)
        nu = at[slices.frequency]
        run = slices.of_listed(ops, self.tables, table.shape[1], is_real, nu)
        sums = ops.plain_sum(
            first, end, lambda number: run.term(*ops.gather(rows, number)), run.values
        )
        # what lies at infinity or is not a number is so in the result
        lost = sum(a - a for a in (*at[slices.place], *nu))
        total = run.total(tuple(value + lost for value in sums))
        return _fetching(self.kernel.leave(ops, self.tables.frame, at, total), shape)

    def _looked_up(self, values: Any, shape: tuple[int, int], row: Any, column: Any) -> Any:
        """An argument in the frame, of one shape or another, at each sample's row and column."""
        import drjit

        kind, (rows, columns) = self.ops.float_type, shape
        if np.ndim(values) == 0:
            return drjit.opaque(kind, float(values))
        whole = drjit.fma(row, drjit.opaque(type(row), columns), column)
        place = {(rows, 1): row, (1, columns): column}.get(values.shape, whole)
        return drjit.gather(kind, array_of(kind, values), place)


def _fetching(results: Sequence[Any], shape: tuple[int, ...] = (-1,)) -> Fetch:
    """Begins to compute results; waits for them when they are fetched."""
    import drjit

    drjit.eval(results)
    return lambda: tuple(np.asarray(r.numpy()).reshape(shape) for r in results)


def _split(kind: Any, rows: int, columns: int) -> tuple[Any, Any]:
    """Row and column of each of rows x columns samples."""
    import drjit

    index = drjit.arange(drjit.uint32_array_t(kind), rows * columns)
    # Opaque, or there would be a kernel for each number of columns. A division of fewer than
    # 2^21 samples: half a sample is more than two roundings, to float32, of the quotient.
    row = type(index)((kind(index) + 0.5) * drjit.opaque(kind, 1 / columns))
    return row, index - row * drjit.opaque(type(index), columns)


def row_sums(
    term: Callable[..., tuple[Any, ...]],
    table: npt.NDArray[np.float64],
    columns: npt.NDArray[np.float64],
    constants: npt.NDArray[np.float64],
    outputs: int,
    engine: str,
) -> tuple[npt.NDArray[np.float64], ...]:
    """Sums of a term over the rows of a table, see :func:`evaluate_rows`: one loop over memory."""
    import drjit as dr

    kind = drjit_float(engine, True)
    ops = DrjitOperations(kind)
    held = ops.held(np.ascontiguousarray(table))
    sample = tuple(array_of(kind, column) for column in columns)
    shared = tuple(dr.opaque(kind, float(value)) for value in constants)

    def step(row: Any, *total: Any) -> Any:
        parts = term(ops, ops.gather(held, row), sample, shared)
        return tuple(a + b for a, b in zip(total, parts, strict=True))

    end = dr.opaque(dr.uint32_array_t(kind), len(table))
    start = (dr.zeros(kind, columns.shape[1]),) * outputs
    return tuple(np.array(part) for part in ops.fold(0, end, start, step))


# Of fewer samples, or edges, to sort them takes longer than it saves (benchmarks/call_rates.py).
_LEAST_SAMPLES_SORTED, _LEAST_EDGES_SORTED = 1 << 15, 5
# Dr.Jit records a function anew where arrays of different sizes have come to be of one size, or the
# other way round. Sizes are multiples of the first number here, plus a different one of the second.
_SIZES, _APART = 256, 8


Hold = Callable[[Array], tuple[int, Any]]
"""Table of numbers -> its width, and the same numbers in an engine's memory."""


class OnDrjitData:
    """A kernel of a source, on NumPy arrays."""

    def __init__(
        self, kernel: Kernel, tables: Any, double: bool, engine: str, samples: int, outputs: int
    ) -> None:
        self.outputs = outputs
        self.kernel, self.frame = kernel, tables.frame
        self.ops = DrjitOperations(drjit_float(engine, double))
        self.host, self.out = NumpyOperations(True), NumpyOperations(double)
        self.dtype = self.out.dtype
        self.source: _Slices | _Edges
        if isinstance(tables, Tables):
            self.source = _Slices(kernel, tables, double, samples)
        else:
            self.source = _Edges(kernel, tables)
        self.state = self.source.state(self.ops, self._sent)

    def points(self, components: Sequence[Array], results: Sequence[Array]) -> Launched:
        """Results for components that broadcast to their shape, chunk by chunk."""
        for arguments, targets in parts_of_results(components, results, _CHUNK_OF_DATA):
            yield targets, *self._begun(arguments)

    def of_arrays(self, components: Sequence[Any]) -> Values:
        """Results as Dr.Jit arrays, for arrays of one width or the other 1 that are evaluated."""
        host = np.broadcast_arrays(*(np.asarray(c.numpy(), np.float64) for c in components))
        results = [np.empty(host[0].shape, self.dtype) for _ in range(self.outputs)]
        store(self.points(host, results), results[0].size)
        return tuple(array_of(self.ops.float_type, values) for values in results)

    def _begun(self, arguments: Sequence[Array]) -> tuple[Any, Fetch]:
        """Begins to compute the results of a chunk; waits for them when they are fetched."""
        import drjit

        ops, kind, source = self.ops, self.ops.float_type, self.source
        with np.errstate(invalid="ignore", over="ignore"):
            found = self.kernel.enter(self.host, self.frame, *arguments)
            inner = [np.asarray(a, self.dtype) for a in found]
            order = source.order(inner)
        inner = [a if a.ndim == 0 else a[order] for a in inner]

        def summed(*arrays: Any) -> Values:
            tables = iter(arrays[: len(source.numbers)])
            values = arrays[len(source.numbers) :]
            return source.summed(ops, lambda table: (table.shape[1], next(tables)), *values)

        run: Any = summed
        if source.is_recorded:
            run = frozen(summed, source.owners, kind)
        sums = run(*self.state, *(array_of(kind, a) for a in inner))
        drjit.eval(sums)

        def fetch() -> tuple[Array, ...]:
            found = tuple(np.asarray(value.numpy()) for value in sums)
            with np.errstate(invalid="ignore", over="ignore"):
                return self.kernel.leave(self.out, self.frame, tuple(inner), found)

        return order, fetch

    def _sent(self, number: int, table: Array) -> Any:
        width = -(-table.size // _SIZES) * _SIZES + _APART * (number + 1)
        padded = np.zeros(width, table.dtype)
        padded[: table.size] = table.ravel()
        return self.ops.held(padded[:, None])[1]


class _Slices:
    """Outlines that are cut: lists of the pairs of edges that can meet.

    ``numbers``: the source as tables; ``owners``: on which objects a kernel depends beside them;
    ``is_recorded``: whether it needs no other memory.
    """

    def __init__(self, kernel: Kernel, tables: Tables, double: bool, samples: int) -> None:
        assert kernel.slices is not None
        self.slices, self.tables = kernel.slices, tables
        self.sorts = len(tables.edges) >= _LEAST_EDGES_SORTED
        self.pairs = {
            key: pairs_of(tables, key, double, samples) for key in self.slices.passes(tables)
        }
        self.numbers = [
            getattr(grid, part.name) for grid in self.pairs.values() for part in fields(grid)
        ]
        self.owners = (kernel,) if is_plain(tables) else (kernel, tables)
        # nodes of rules and tables of waves are memory of their own
        self.is_recorded = tables.coherence is None and tables.waves_per_cut <= MOST_PAIRS_AS_CODE

    def state(self, ops: DrjitOperations, send: Callable[[int, Array], Any]) -> list[Any]:
        """The tables in memory of the engine; those of the latest lists are kept."""
        found, number = [], 0
        for grid in self.pairs.values():
            key = ops.key, number
            if key not in grid.copies:
                tables = [getattr(grid, part.name) for part in fields(grid)]
                grid.copies[key] = [send(number + k, table) for k, table in enumerate(tables)]
            found += grid.copies[key]
            number += len(grid.copies[key])
        return found

    def order(self, inner: Sequence[Array]) -> Any:
        """The order in which samples are best taken."""
        if not self.sorts or inner[-1].size < _LEAST_SAMPLES_SORTED:
            return ...
        x, y = inner[self.slices.place]
        (view, *_), grid = next(iter(self.pairs.items()))
        cell = cells_at(grid.on_host, view.side * self.slices.scale * (x + 1j * y))
        # there are fewer than 2^16 cells: NumPy sorts such numbers in linear time
        return np.argsort(cell.astype(np.uint16), kind="stable")

    def summed(self, ops: DrjitOperations, hold: Hold, *inner: Any) -> Values:
        """The kernel's sums, from tables of another source of this kind."""
        pairs = {key: grid.held(hold) for key, grid in self.pairs.items()}
        return self.slices.by_pairs(ops, self.tables, pairs, *inner)


class _Edges:
    """An outline whose edges are summed up."""

    is_recorded = True

    def __init__(self, kernel: Kernel, tables: OutlineTables) -> None:
        self.kernel, self.tables, self.owners = kernel, tables, (kernel,)
        rows = np.zeros((len(tables.edges), 8))
        rows[:, :5] = tables.edges
        self.numbers: list[Array] = [rows, np.array([[len(rows)]], np.uint32)]

    def state(self, ops: DrjitOperations, send: Callable[[int, Array], Any]) -> list[Any]:
        return [send(k, table) for k, table in enumerate(self.numbers)]

    def order(self, inner: Sequence[Array]) -> Any:
        return ...

    def summed(self, ops: DrjitOperations, hold: Hold, *inner: Any) -> Values:
        rows, count = (hold(table) for table in self.numbers)
        (end,) = ops.gather(count, ops.truncated(0.0))
        found: Values = self.kernel.edge_sum(_OverRows(ops, rows, end), self.tables, *inner)
        return found


class _OverRows(DrjitOperations):
    """Sums are over the rows of a table in memory."""

    def __init__(self, ops: DrjitOperations, rows: tuple[int, Any], end: Any) -> None:
        super().__init__(ops.float_type)
        self.rows, self.end = rows, end

    def sum_over(self, rows: Any, term: Any, values: int, like: Any, *, unroll: bool = True) -> Any:
        columns = len(rows[0])
        return self.plain_sum(
            0, self.end, lambda row: term(*self.gather(self.rows, row)[:columns]), values
        )


# ---- outlines whose numbers are data of a traced kernel ------------------------------------------


@dataclass(frozen=True)
class _DataFrame(Frame):
    """A frame whose centre is in memory, as pairs of floats."""

    def position(self, ops: Any, x: Any, y: Any) -> tuple[Any, Any]:
        pairs: Any = self.centre
        nearest: Any = tuple(high for high, _ in pairs)
        return Frame.position(replace(self, centre=nearest), ops, x, y)


def with_frame_as_data(ops: DrjitOperations, tables: Any) -> Any:
    """Tables with the centre of their frame in memory; their lists are so in any case."""
    pairs = [phases.doubled(c, ops.double) for c in tables.frame.centre]
    numbers = iter(_looked_up(ops, [number for pair in pairs for number in pair]))
    own = {field.name: getattr(tables.frame, field.name) for field in fields(Frame)}
    own["centre"] = tuple((next(numbers), next(numbers)) for _ in pairs)
    return replace(tables, frame=_DataFrame(**own))


def _looked_up(ops: DrjitOperations, values: Sequence[float]) -> list[Any]:
    """Numbers of one array, each an array of one entry."""
    import drjit

    kind = ops.float_type
    memory, index = array_of(kind, values), drjit.uint32_array_t(kind)
    return [drjit.gather(kind, memory, index(k)) for k in range(len(values))]
