"""A kernel compiled once for all outlines, which come as data with every call.

A kernel with an outline as code takes a tenth of a second to compile, and some hundred kilobytes
of the process for good. This one is for any outline, and a third to half as fast.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import drjit_float, is_uniform
from polywigner.execution.chunks import Fetch, Launched, array_of, parts_of_results, store
from polywigner.execution.drjit_operations import DrjitOperations
from polywigner.execution.frozen import frozen
from polywigner.execution.operations import NumpyOperations
from polywigner.kernels import Kernel
from polywigner.kernels.cut.pair_grid import PairGrid
from polywigner.kernels.cut.winding import pairs_of
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.outline.frame import Frame
from polywigner.kernels.outline.tables import Tables
from polywigner.numerics import phases

_CHUNK = 1 << 17
# Of fewer samples, or edges, to sort them takes longer than it saves (benchmarks/call_rates.py).
_LEAST_SAMPLES_SORTED, _LEAST_EDGES_SORTED = 1 << 13, 5
# Dr.Jit records a function anew where arrays of different sizes have come to be of one size, or the
# other way round. Sizes are multiples of the first number here, plus a different one of the second.
_SIZES, _APART = 256, 8

Array = npt.NDArray[Any]
Values = tuple[Any, ...]
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
        self.host, self.out = NumpyOperations(double=True), NumpyOperations(double)
        self.dtype = np.dtype(np.float64 if double else np.float32)
        self.source: _Slices | _Edges
        if isinstance(tables, Tables):
            self.source = _Slices(kernel, tables, double, samples)
        else:
            self.source = _Edges(kernel, tables)
        self.state = [self._sent(k, table) for k, table in enumerate(self.source.numbers)]

    def points(self, components: Sequence[Array], results: Sequence[Array]) -> Launched:
        """Results for components that broadcast to their shape, chunk by chunk."""
        for arguments, targets in parts_of_results(components, results, _CHUNK):
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
            entered = self.kernel.enter(self.host, self.frame, *arguments)
            inner = [np.asarray(a, self.dtype) for a in entered]
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
        self.host, self.sorts = NumpyOperations(double), len(tables.edges) >= _LEAST_EDGES_SORTED
        self.pairs = {
            key: pairs_of(tables, key, double, samples) for key in self.slices.passes(tables)
        }
        self.numbers = [
            getattr(grid, part.name) for grid in self.pairs.values() for part in fields(grid)
        ]
        self.owners = (kernel,) if is_uniform(kernel, tables) else (kernel, tables)
        # of partly coherent light the nodes of rules are memory of their own
        self.is_recorded = tables.coherence is None

    def order(self, inner: Sequence[Array]) -> Any:
        """The order in which samples are best taken."""
        if not self.sorts or inner[-1].size < _LEAST_SAMPLES_SORTED:
            return ...
        cell = self.slices.cell(self.host, self.tables, self._held, *inner)
        # there are fewer than 2^16 cells: NumPy sorts such numbers in linear time
        return np.argsort(cell.astype(np.uint16), kind="stable")

    @cached_property
    def _held(self) -> dict[Any, PairGrid]:
        return {key: grid.held(self.host.held) for key, grid in self.pairs.items()}

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


def as_data(ops: DrjitOperations, tables: Any) -> Any:
    """Tables of an aperture or an array with arrays of one entry in place of numbers."""
    found = with_frame_as_data(ops, tables)
    if isinstance(tables, OutlineTables):
        return found
    names = ("dx", "dy", "offset", "px", "py")
    values = [getattr(line, name) for line in tables.lines for name in names]
    weights = [part for piece in tables.pieces for part in (piece.real, piece.imag)]
    numbers = iter(_looked_up(ops, values + weights))
    lines = tuple(replace(line, **{n: next(numbers) for n in names}) for line in tables.lines)
    pieces = tables.pieces
    if not tables.uniform:
        pieces = tuple(replace(p, real=next(numbers), imag=next(numbers)) for p in pieces)
    return replace(found, lines=lines, pieces=pieces)


def _looked_up(ops: DrjitOperations, values: Sequence[float]) -> list[Any]:
    """Numbers of one array, each an array of one entry."""
    import drjit

    kind = ops.float_type
    memory, index = array_of(kind, values), drjit.uint32_array_t(kind)
    return [drjit.gather(kind, memory, index(k)) for k in range(len(values))]
