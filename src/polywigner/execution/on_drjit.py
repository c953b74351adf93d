"""Kernels that Dr.Jit compiles and evaluates at NumPy points.

A kernel with the coordinates of an outline as constants ("as code") compiles in 0.1 s and occupies
some hundred kilobytes until the process ends. A kernel that reads outlines from memory ("as data")
is compiled once for all outlines, but runs at a third to a half of the speed.
"""

from __future__ import annotations

import gc
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from types import EllipsisType, SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import drjit_float
from polywigner.execution.chunks import Fetch, Launched, array_of, parts_of_results
from polywigner.execution.drjit_operations import LANE, MOST_TERMS_AS_CODE, DrjitOperations
from polywigner.execution.operations import Drjit, NumpyOperations
from polywigner.kernels import Kernel
from polywigner.kernels.cut.pair_grid import PairGrid
from polywigner.kernels.cut.winding import Pass, pairs_of
from polywigner.kernels.functions.fourier import LinearFrame, OutlineTables
from polywigner.kernels.functions.slices import MOST_PAIRS_AS_CODE, SliceSum
from polywigner.kernels.outline import Frame, Tables, is_plain
from polywigner.numerics import phases

# Largest number of cached functions, and largest number of recordings of each function. Dr.Jit
# records a function again if an argument changes between one entry and several entries.
_MOST, _MOST_RECORDINGS = 64, 8
# Number of samples per chunk if samples are sorted by cell, and if edges are constants in the code.
# The launch of a kernel takes little time compared with a chunk. The arguments of a chunk take some
# 10 MB and 5 MB, respectively. Sorted chunks are larger, because each cell then contains more
# samples. The other chunks are smaller, because the C library would return the memory of larger
# chunks to the system. New memory would then take a third of the time.
CHUNK, _CHUNK_OF_CODE = 1 << 18, 1 << 17

Array = npt.NDArray[Any]
Values = tuple[Any, ...]
Order = npt.NDArray[np.intp] | EllipsisType
"""Indices that sort the samples of a chunk, or Ellipsis if the samples are not sorted."""
Function = Callable[..., Values]


class _Frozen:
    """A function that Dr.Jit records at its first call and replays afterwards."""

    def __init__(self, function: Function, owners: Sequence[Any]) -> None:
        import drjit

        # Dr.Jit traverses the closure of the function in each call, but not the attributes of a
        # namespace.
        cell = SimpleNamespace(function=function)

        def replayed(*arguments: Any) -> Values:
            """Call the function. Dr.Jit records the first call."""
            return cell.function(*arguments)

        self.replayed = drjit.freeze(replayed, limit=_MOST_RECORDINGS, warn_after=1 << 30)
        self.owners, self.requests = owners, 0
        # Dr.Jit aborts the process if two threads record the same function at the same time.
        self.lock = threading.Lock()

    def __call__(self, *arguments: Any) -> Values:
        """Record the function, or replay its recording, with new arguments."""
        with self.lock, without_collection():
            try:
                results: Values = self.replayed(*arguments)
            except RuntimeError as error:
                # If an exception ends the function, Dr.Jit raises a RuntimeError, so the original
                # exception is raised here.
                raise error.__cause__ or error from None
            return results


_paused: list[bool] = []
"""For each recording in progress, whether garbage collection was enabled at its start."""


@contextmanager
def without_collection() -> Iterator[None]:
    """Disable garbage collection within the block, and restore its earlier state afterwards.

    If a thread frees an array in NumPy's memory while the thread records, Dr.Jit aborts the
    process.
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


def frozen(function: Function, owners: Sequence[Any], *kind: Hashable) -> _Frozen:
    """Return a recorded version of a function of Dr.Jit arrays, from the cache if possible.

    The function must not depend on the number of samples, and must not allocate memory. The key of
    the cache consists of ``owners``, compared by identity, and ``kind``. If the key is known, the
    cached function is returned and ``function`` is ignored. The attribute ``requests``
    of the result counts the calls of :func:`frozen` with this key.
    """
    key = (*map(id, owners), *kind)
    with _lock:
        if key not in _known:
            # References to the owners prevent their ids from being reused.
            _known[key] = _Frozen(function, owners)
            while len(_known) > _MOST:
                _known.popitem(last=False)
        _known.move_to_end(key)
        _known[key].requests += 1
        return _known[key]


def is_code(kernel: Kernel, tables: Any) -> bool:
    """Return whether the coordinates of a source are constants in the code of a kernel."""
    if isinstance(tables, Tables) and kernel.slices is not None:
        return tables.fits_code
    return isinstance(tables, Tables | OutlineTables) and len(tables.edges) <= MOST_TERMS_AS_CODE


def is_recordable(tables: Tables | OutlineTables) -> bool:
    """Return whether code that reads a source from memory can be recorded."""
    if isinstance(tables, OutlineTables):
        return True
    # A recorded function must not read arrays other than its arguments from memory, such as
    # quadrature nodes and tables of waves.
    return tables.coherence is None and tables.waves_per_cut <= MOST_PAIRS_AS_CODE


def prevents_recording(kind: Any) -> bool:
    """Return whether calls cannot be recorded: within another recording, or without LLVM.

    ``kind`` is a Dr.Jit float type.
    """
    import drjit

    scopes = (drjit.JitFlag.SymbolicScope, drjit.JitFlag.FreezingScope)
    return drjit.backend_v(kind) != drjit.JitBackend.LLVM or any(map(drjit.flag, scopes))


class OnDrjit:
    """A kernel for one source, which Dr.Jit traces and compiles."""

    def __init__(self, kernel: Kernel, tables: Any, double: bool, engine: str) -> None:
        self.kernel, self.tables = kernel, tables
        self.ops = DrjitOperations(drjit_float(engine, double))
        self.entry = DrjitOperations(drjit_float(engine, double=True))
        self.is_code = is_code(kernel, self.tables)

    def points(self, components: Sequence[Array], results: Sequence[Array]) -> Launched:
        """Yield results chunk by chunk; the components broadcast to the shape of the results."""
        kind = self.ops.float_type
        run: Callable[..., tuple[Any, ...]] = self._traced
        if self.is_code and not prevents_recording(kind):
            run = frozen(self._traced, (self.kernel, self.tables), kind)
        for arguments, targets in parts_of_results(components, results, _CHUNK_OF_CODE):
            yield (
                targets,
                ...,
                _fetching(run(*(array_of(self.entry.float_type, array) for array in arguments))),
            )

    def _traced(self, *arguments: Any) -> tuple[Any, ...]:
        """Return the results of the kernel at Dr.Jit arrays of coordinates."""
        inner = self.kernel.enter(self.entry, self.tables.frame, *arguments)
        if not self.ops.double:
            inner = tuple(self.ops.float_type(a) for a in inner)
        sums = self.kernel.edge_sum(self.ops, self.tables, *inner)
        return self.kernel.leave(self.ops, self.tables.frame, inner, sums)

    def of_parts(self, inner: tuple[Any, ...], ends: Array, table: Array, is_real: bool) -> Fetch:
        """Start computing samples that share slices, and return a function that fetches results.

        The results have the shape (rows, columns). ``inner`` contains the arguments of the kernel
        in the frame of the source. The slice of row k consists of the edge parts ``ends[k]`` to
        ``ends[k + 1]`` - 1 in ``table``. ``is_real`` specifies that all weights are real.
        """
        ops, slices = self.ops, self.kernel.slices
        assert slices is not None
        shape = np.broadcast_shapes(*(np.shape(a) for a in inner))
        row, column = _split(ops.float_type, *shape)
        limits = ops.on_device(ends[:, None].astype(np.uint32))
        (first,), (end,) = (ops.gather(limits, row + k) for k in (0, 1))
        rows = ops.on_device(table if len(table) else np.zeros((1, table.shape[1])))
        at = tuple(self._looked_up(values, shape, row, column) for values in inner)
        nu = at[slices.frequency]
        run = slices.of_listed(ops, self.tables, table.shape[1], is_real, nu)
        sums = ops.plain_sum(
            first, end, lambda number: run.term(*ops.gather(rows, number)), run.values
        )
        # The differences a - a are NaN for infinite and NaN arguments, and 0 otherwise.
        lost = sum(a - a for a in (*at[slices.position], *nu))
        total = run.total(tuple(value + lost for value in sums))
        return _fetching(self.kernel.leave(ops, self.tables.frame, at, total), shape)

    def _looked_up(self, values: Any, shape: tuple[int, int], row: Any, column: Any) -> Drjit:
        """Return entries of an argument, broadcast to ``shape``, at indices of rows and columns."""
        import drjit

        kind, (rows, columns) = self.ops.float_type, shape
        if np.ndim(values) == 0:
            return drjit.opaque(kind, float(values))
        sample = drjit.fma(row, drjit.opaque(type(row), columns), column)
        index = {(rows, 1): row, (1, columns): column}.get(values.shape, sample)
        return drjit.gather(kind, array_of(kind, values), index)


def _fetching(results: Sequence[Any], shape: tuple[int, ...] = (-1,)) -> Fetch:
    """Start the computation of results, and return a function that waits for the results."""
    import drjit

    drjit.eval(results)
    return lambda: tuple(np.asarray(r.numpy()).reshape(shape) for r in results)


def _split(kind: Any, rows: int, columns: int) -> tuple[Any, Any]:
    """Return the row and the column of each sample.

    Samples are ordered row by row. The compiled code contains no literals.
    """
    import drjit

    index = drjit.arange(drjit.uint32_array_t(kind), rows * columns)
    # With literals, Dr.Jit would compile a kernel for each number of columns. The quotient is
    # correct for fewer than 2^21 samples, because two float32 rounding errors are then smaller than
    # half a sample.
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
    """Return the sums of ``term(ops, row, sample, constants)`` over the rows of a table.

    A compiled loop computes the ``outputs`` sums, each of shape (n,). ``table`` has the shape (m,
    a), and ``columns`` the shape (b, n), with one column for each sample.
    """
    import drjit as dr

    kind = drjit_float(engine, True)
    ops = DrjitOperations(kind)
    rows = ops.on_device(np.ascontiguousarray(table))
    sample = tuple(array_of(kind, column) for column in columns)
    shared = tuple(dr.opaque(kind, float(value)) for value in constants)

    def step(row: Any, *total: Any) -> Values:
        """Return the sums after a row of the table."""
        parts = term(ops, ops.gather(rows, row), sample, shared)
        return tuple(a + b for a, b in zip(total, parts, strict=True))

    end = dr.opaque(dr.uint32_array_t(kind), len(table))
    start = (dr.zeros(kind, columns.shape[1]),) * outputs
    return tuple(np.array(part) for part in ops.fold(0, end, start, step))


# Smallest number of edges for which samples are sorted by cell (benchmarks/call_rates.py).
_LEAST_EDGES_SORTED = 5
# Smallest number of samples per cell for which a vector lane computes several samples.
_LEAST_PER_CELL = 8
# Dr.Jit records a function again if two arguments that had equal sizes get different sizes, or vice
# versa. The size of table k is a multiple of _SIZES plus k + 1 times _APART, so no two tables have
# equal sizes.
_SIZES, _APART = 256, 8


Send = Callable[[Array], tuple[int, Any]]
"""Function that copies a table to the memory of an engine, and returns the table's width and the
copy."""


class OnDrjitData:
    """A kernel that Dr.Jit compiles; the compiled code reads the source from memory."""

    def __init__(self, kernel: Kernel, tables: Any, float_type: Any, samples: int = 0) -> None:
        self.kernel, self.frame = kernel, tables.frame
        self.ops = DrjitOperations(float_type)
        self.host, self.dtype = NumpyOperations(), np.float64 if self.ops.double else np.float32
        self.source: _Slices | _Edges
        if isinstance(tables, Tables):
            self.source = _Slices(kernel, tables, self.ops, samples)
        else:
            self.source = _Edges(kernel, tables)
        self.state = self.source.state(self.ops, self._sent)

    def points(self, components: Sequence[Array], results: Sequence[Array]) -> Launched:
        """Yield results chunk by chunk; the components broadcast to the shape of the results."""
        for arguments, targets in parts_of_results(components, results, CHUNK):
            yield targets, *self._begun(arguments)

    def _begun(self, arguments: Sequence[Array]) -> tuple[Any, Fetch]:
        """Start the computation of a chunk of samples.

        Returns the sample index of each result (Ellipsis if the order is unchanged), and a function
        that waits for the results.
        """
        import drjit

        ops, kind, source = self.ops, self.ops.float_type, self.source
        with np.errstate(invalid="ignore", over="ignore"):
            entered = self.kernel.enter(self.host, self.frame, *arguments)
            inner = [np.asarray(a, self.dtype) for a in entered]
            order = source.order(inner)
        inner = [a if a.ndim == 0 or order is ... else a.take(order) for a in inner]

        def summed(*arrays: Any) -> Values:
            """Return the sums from the tables of the source, followed by the samples."""
            tables, values = iter(arrays[: len(source.numbers)]), arrays[len(source.numbers) :]
            lanes = ops.for_lanes(*values)
            return source.summed(lanes, lambda table: (table.shape[1], next(tables)), *values)

        run: Any = summed
        if is_recordable(source.tables):
            run = frozen(summed, source.owners, kind, *source.forms)
        sums = run(*self.state, *(ops.in_lanes(a) for a in inner))
        drjit.eval(sums)

        def fetch() -> tuple[Array, ...]:
            """Wait for the sums, and return the results of the chunk."""
            values = tuple(np.asarray(value.numpy()) for value in sums)
            with np.errstate(invalid="ignore", over="ignore"):
                return self.kernel.leave(self.host, self.frame, tuple(inner), values)

        return order, fetch

    def constants(self) -> list[Drjit]:
        """Return the tables of the source and the centre of its frame, for :meth:`at_points`."""
        return [*self.state, _centre_in_memory(self.ops, self.frame)]

    def at_points(self, *arrays: Drjit) -> Values:
        """Return the results at Dr.Jit points.

        ``arrays`` are the arrays of :meth:`constants`, followed by the components of the points.
        """
        ops, count = self.ops, len(self.state)
        tables, (centre, *components) = iter(arrays[:count]), arrays[count:]
        frame = _frame_as_data(ops, self.frame, centre)
        inner = self.kernel.enter(ops, frame, *components)
        sums = self.source.summed(ops, lambda table: (table.shape[1], next(tables)), *inner)
        return self.kernel.leave(ops, frame, inner, sums)

    def _sent(self, number: int, table: Array) -> Drjit:
        """Pad the table with the index ``number`` to a unique size, and copy it to the engine."""
        width = -(-table.size // _SIZES) * _SIZES + _APART * (number + 1)
        padded = np.zeros(width, table.dtype)
        padded[: table.size] = table.ravel()
        return self.ops.on_device(padded[:, None])[1]


class _Slices:
    """Edge pairs of a source as data, for Wigner and ambiguity functions."""

    def __init__(self, kernel: Kernel, tables: Tables, ops: DrjitOperations, samples: int) -> None:
        import drjit

        assert kernel.slices is not None
        self.slices, self.tables = kernel.slices, tables
        self.is_on_cpu = drjit.backend_v(ops.float_type) == drjit.JitBackend.LLVM
        self.sorts = len(tables.edges) >= _LEAST_EDGES_SORTED
        self.pairs = {
            key: pairs_of(tables, key, ops.double, samples) for key in self.slices.passes(tables)
        }
        self.numbers = [
            getattr(grid, part.name) for grid in self.pairs.values() for part in fields(grid)
        ]
        self.forms = list(map(type, self.pairs.values()))
        self.owners = (kernel,) if is_plain(tables) else (kernel, tables)

    def state(self, ops: DrjitOperations, send: Callable[[int, Array], Any]) -> list[Any]:
        """Return tables of edge pairs in the memory of the engine, from the cache if possible."""
        sent, number = [], 0
        for grid in self.pairs.values():
            key = ops.key, number
            if key not in grid.copies:
                tables = [getattr(grid, part.name) for part in fields(grid)]
                grid.copies[key] = [send(number + k, table) for k, table in enumerate(tables)]
            sent += grid.copies[key]
            number += len(grid.copies[key])
        return sent

    def order(self, inner: Sequence[Array]) -> Order:
        """Return indices that sort samples by cell, or Ellipsis if there are few edges."""
        if not self.sorts:
            return ...
        key, grid = next(iter(self.pairs.items()))
        samples = max(a.size for a in inner)
        grids = self.pairs.values()
        is_grouped = self.is_on_cpu and fills_lanes(self.slices, self.tables, grids, samples)
        return order_by_cell(self.slices, key, grid, inner, is_grouped=is_grouped)

    def summed(self, ops: DrjitOperations, send: Send, *inner: Any) -> Values:
        """Return the sums over edge pairs at the kernel's arguments ``inner``, for each sample.

        ``send(table)`` returns the width of a table and its copy in memory.
        """
        pairs = {key: grid.on_device(send) for key, grid in self.pairs.items()}
        return self.slices.by_pairs(ops, self.tables, pairs, *inner)


def fills_lanes(slices: SliceSum, tables: Tables, grids: Iterable[PairGrid], samples: int) -> bool:
    """Return whether each SIMD lane should compute several samples in the same cell.

    Samples in the same cell of one grid may lie in different cells of another grid. The second view
    of a sum mirrors offsets. The mirror images of offsets in the same cell can lie in different
    cells if one of the offsets lies on the border of the cell. Terms for partly coherent light do
    not support several samples per lane.
    """
    first, *others = grids
    is_single = tables.coherence is None and len(slices.views) == 1 and not others
    return is_single and samples >= _LEAST_PER_CELL * len(first.cells)


def order_by_cell(
    slices: SliceSum, key: Pass, grid: PairGrid, inner: Sequence[Array], *, is_grouped: bool
) -> Array:
    """Return indices that sort samples by the cell that contains their offset.

    If ``is_grouped`` is true, the result has the shape (4, m), and each column contains samples of
    the same cell. The last sample of a cell is repeated to fill its last column.
    """
    cells = grid.cell_map
    scale = key[0].side * slices.scale / cells.step
    # Offsets are rounded to the grid in the same way as in the kernel.
    offsets = cells.step * np.rint(scale * np.stack(inner[slices.position]))
    # A grid has fewer than 2^16 cells, and NumPy sorts 16-bit integers in linear time.
    cell = cells.at(offsets).astype(np.uint16)
    order = np.argsort(cell, kind="stable")
    if not is_grouped:
        return order
    counts = np.bincount(cell)
    columns = -(-counts // LANE)
    owner, last = np.arange(len(counts)).repeat(columns), counts.cumsum() - 1
    column = np.arange(len(owner)) - (columns.cumsum() - columns)[owner]
    first = (last - counts + 1)[owner] + LANE * column
    return order.take(np.minimum(first + np.arange(LANE)[:, None], last[owner]))


class _Edges:
    forms = ()

    def __init__(self, kernel: Kernel, tables: OutlineTables) -> None:
        self.kernel, self.tables, self.owners = kernel, tables, (kernel,)
        rows = np.zeros((len(tables.edges), 8))
        rows[:, :5] = tables.edges
        self.numbers: list[Array] = [rows, np.array([[len(rows)]], np.uint32)]

    def state(self, ops: DrjitOperations, send: Callable[[int, Array], Any]) -> list[Any]:
        """Return the table of edges and the number of edges, in the memory of the engine."""
        return [send(k, table) for k, table in enumerate(self.numbers)]

    def order(self, inner: Sequence[Array]) -> Order:
        """Return Ellipsis, because samples are not sorted."""
        return ...

    def summed(self, ops: DrjitOperations, send: Send, *inner: Any) -> Values:
        """Return the sums over edges at the kernel's arguments ``inner``, for each sample.

        ``send(table)`` returns the width of a table and its copy in memory.
        """
        rows, count = (send(table) for table in self.numbers)
        (end,) = ops.gather(count, ops.truncated(0.0))
        sums: Values = self.kernel.edge_sum(_OverRows(ops, rows, end), self.tables, *inner)
        return sums


class _OverRows(DrjitOperations):
    def __init__(self, ops: DrjitOperations, rows: tuple[int, Any], end: Any) -> None:
        super().__init__(ops.float_type)
        self.rows, self.end = rows, end

    def sum_over(
        self, rows: Any, term: Any, values: int, like: Any, *, unroll: bool = True
    ) -> Values:
        """Return the sums of ``term``, in a loop over the rows in memory instead of ``rows``."""
        columns = len(rows[0])
        return self.plain_sum(
            0, self.end, lambda row: term(*self.gather(self.rows, row)[:columns]), values
        )


@dataclass(frozen=True)
class _DataFrame(Frame):
    def position(self, ops: Any, *x: Any) -> tuple[Any, ...]:
        """Return positions in the frame; its centre is rounded to one float per coordinate."""
        pairs: Any = self.centre
        nearest: Any = tuple(high for high, _ in pairs)
        return Frame.position(replace(self, centre=nearest), ops, *x)


def with_frame_as_data(ops: DrjitOperations, tables: Any) -> Tables:
    """Return tables whose centre is read from memory instead of being compiled into the code."""
    centre = _centre_in_memory(ops, tables.frame)
    return replace(tables, frame=_frame_as_data(ops, tables.frame, centre))


def _centre_in_memory(ops: DrjitOperations, frame: Frame | LinearFrame) -> Drjit:
    """Return the coordinates of a frame's centre, each as a pair of floats, in one array."""
    pairs = (c if isinstance(c, tuple) else phases.doubled(c, ops.double) for c in frame.centre)
    return array_of(ops.float_type, list(pairs))


def _frame_as_data(
    ops: DrjitOperations, frame: Frame | LinearFrame, centre: Drjit
) -> Frame | LinearFrame:
    """Return a frame whose centre is read from the array of :func:`_centre_in_memory`."""
    pairs: Any = tuple(ops.gather((2, centre), ops.truncated(k)) for k in range(len(frame.centre)))
    if not isinstance(frame, Frame):
        return replace(frame, centre=pairs)
    values = {field.name: getattr(frame, field.name) for field in fields(Frame)}
    return _DataFrame(**values | {"centre": pairs})
