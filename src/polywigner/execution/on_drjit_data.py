"""A kernel compiled once for all outlines, which come as data with every call.

A kernel with an outline as code takes a tenth of a second to compile, and some hundred kilobytes
of the process for good. This one is for any outline, and a third to half as fast.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from polywigner.execution.aligned import array_of
from polywigner.execution.choice import drjit_float
from polywigner.execution.chunks import Fetch, Launched, parts_of_results
from polywigner.execution.frozen import frozen
from polywigner.execution.operations import DrjitOperations, NumpyOperations
from polywigner.kernels import Kernel
from polywigner.kernels.cut.cells import HeldLists
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.outline.waves import UNIFORM

__all__ = ["OnDrjitData", "takes_data"]

_CHUNK = 1 << 18
# Dr.Jit records a function anew where arrays of different sizes have come to be of one size, or the
# other way round. Sizes are multiples of the first number here, plus a different one of the second.
_SIZES, _APART = 256, 8

Array = npt.NDArray[Any]
Values = tuple[Any, ...]
Hold = Callable[[Array], tuple[int, Any]]
"""Table of numbers -> its width, and the same numbers in an engine's memory."""


def takes_data(kernel: Kernel, tables: Any) -> bool:
    """Whether there is such a kernel: for W, A and F of uniform outlines."""
    if isinstance(tables, OutlineTables):
        return kernel.name == "fourier"
    if kernel.slices is None or not kernel.slices.serves_all:
        return False
    if not isinstance(tables, Tables) or tables.coherence is not None:
        return False
    return tables.groups == (UNIFORM,)


class _Source(Protocol):
    """A source as tables."""

    numbers: list[Array]
    form: Hashable
    """What a kernel depends on beside these numbers."""

    def summed(self, ops: DrjitOperations, hold: Hold, *inner: Any) -> Values:
        """The kernel's sums, from tables of another source of this form."""


class OnDrjitData:
    """A kernel of a source, on NumPy arrays."""

    def __init__(self, kernel: Kernel, tables: Any, double: bool, engine: str) -> None:
        self.kernel, self.frame = kernel, tables.frame
        self.ops = DrjitOperations(drjit_float(engine, double))
        self.host, self.out = NumpyOperations(double=True), NumpyOperations(double)
        self.dtype = np.dtype(np.float64 if double else np.float32)
        self.source: _Source
        if isinstance(tables, Tables):
            self.source = _Slices(kernel, tables)
        else:
            self.source = _Edges(kernel, tables)
        self.state = [self._sent(k, table) for k, table in enumerate(self.source.numbers)]

    def points(self, components: Sequence[Array], results: Sequence[Array]) -> Launched:
        """Results for components that broadcast to their shape, chunk by chunk."""
        for arguments, targets in parts_of_results(components, results, _CHUNK):
            yield targets, ..., self._begun(arguments)

    def of_arrays(self, components: Sequence[Any]) -> Values:
        """Results as Dr.Jit arrays, for arrays of one width or the other 1 that are evaluated."""
        host = np.broadcast_arrays(*(np.asarray(c.numpy(), np.float64) for c in components))
        return tuple(array_of(self.ops.float_type, values) for values in self._begun(host)())

    def _begun(self, arguments: Sequence[Array]) -> Fetch:
        """Begins to compute the results of a chunk; waits for them when they are fetched."""
        import drjit

        ops, kind, source = self.ops, self.ops.float_type, self.source
        with np.errstate(invalid="ignore", over="ignore"):
            entered = self.kernel.enter(self.host, self.frame, *arguments)
            inner = [np.asarray(a, self.dtype) for a in entered]

        def summed(*arrays: Any) -> Values:
            tables = iter(arrays[: len(source.numbers)])
            values = arrays[len(source.numbers) :]
            return source.summed(ops, lambda table: (table.shape[1], next(tables)), *values)

        recorded = frozen(lambda: (summed, ()), (self.kernel,), kind, source.form)
        sums = recorded(*self.state, *(array_of(kind, a) for a in inner))
        drjit.eval(sums)

        def fetch() -> tuple[Array, ...]:
            found = tuple(np.asarray(value.numpy()) for value in sums)
            with np.errstate(invalid="ignore", over="ignore"):
                return self.kernel.leave(self.out, self.frame, tuple(inner), found)

        return fetch

    def _sent(self, number: int, table: Array) -> Any:
        width = -(-table.size // _SIZES) * _SIZES + _APART * (number + 1)
        padded = np.zeros(width, table.dtype)
        padded[: table.size] = table.ravel()
        return self.ops.held(padded[:, None])[1]


class _Slices:
    """An outline that is cut: lists of edges and of the sides that cut each."""

    def __init__(self, kernel: Kernel, tables: Tables) -> None:
        assert kernel.slices is not None
        self.slices, self.tables = kernel.slices, tables
        self.lists = lists = kernel.slices.lists(tables)
        self.numbers: list[Array] = []
        HeldLists(self._listed, lists)
        self.form: Hashable = (
            tables.grid,
            tables.uniform,
            tables.phased,
            bool((lists.weights == (1.0, 0.0)).all()),
            len(lists.plain.records) > 0,
            len(lists.special.records) > 0,
        )

    def _listed(self, table: Array) -> None:
        self.numbers.append(table)

    def summed(self, ops: DrjitOperations, hold: Hold, *inner: Any) -> Values:
        return self.slices.in_one_cell(ops, self.tables, self.lists, hold, *inner)


class _Edges:
    """An outline whose edges are summed up."""

    form: Hashable = "edges"

    def __init__(self, kernel: Kernel, tables: OutlineTables) -> None:
        self.kernel, self.tables = kernel, tables
        rows = np.zeros((len(tables.edges), 8))
        rows[:, :5] = tables.edges
        self.numbers: list[Array] = [rows, np.array([[len(rows)]], np.uint32)]

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
