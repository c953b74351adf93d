"""A kernel of a source compiled by Dr.Jit, on NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import drjit_float
from polywigner.execution.chunks import Fetch, Launched, array_of, parts_of_results
from polywigner.execution.drjit_operations import DrjitOperations
from polywigner.execution.frozen import frozen, is_code, is_recording
from polywigner.execution.operations import NumpyOperations
from polywigner.kernels import Kernel, SharedSlice
from polywigner.kernels.arrays.repeated import RepeatedTables
from polywigner.kernels.outline.tables import Tables, cut_of

# Samples at a time: launching costs little against computing, and the arguments of a chunk
# take some 10 MB.
_CHUNK = 1 << 18

Array = npt.NDArray[Any]


class OnDrjit:
    """A kernel of a source, traced with Dr.Jit."""

    # samples at a time where slices are listed: only rows and columns come from memory
    shared_block = 1 << 20

    def __init__(self, kernel: Kernel, tables: Any, double: bool, engine: str) -> None:
        self.kernel, self.tables = kernel, _cut(tables)
        self.ops = DrjitOperations(drjit_float(engine, double))
        self.entry = DrjitOperations(drjit_float(engine, double=True))
        self.is_code = is_code(kernel, self.ops, self.tables)

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

    def entered(self, arguments: Sequence[Array]) -> tuple[Any, ...]:
        """The arguments in the frame, in the shapes that they have."""
        with np.errstate(invalid="ignore", over="ignore"):
            return self.kernel.enter(NumpyOperations(double=True), self.tables.frame, *arguments)

    def of_parts(
        self, shared: SharedSlice, inner: tuple[Any, ...], ends: Array, table: Array, is_real: bool
    ) -> Fetch:
        """Results for rows and columns in the frame, the parts of row k at ``ends[k:k + 2]``."""
        ops = self.ops
        shape = np.broadcast_shapes(*(np.shape(a) for a in inner))
        row, column = _split(ops.float_type, *shape)
        limits = ops.held(ends[:, None].astype(np.uint32))
        (first,), (end,) = (ops.gather(limits, row + k) for k in (0, 1))
        held = ops.held(table if len(table) else np.zeros((1, table.shape[1])))
        at = tuple(self._looked_up(values, shape, row, column) for values in inner)
        frequency = at[shared.frequency]
        run = shared.summed(ops, table.shape[1], is_real, *frequency)
        sums = ops.plain_sum(
            first, end, lambda number: run.term(*ops.gather(held, number)), run.values
        )
        # what lies at infinity or is not a number is so in the result
        lost = sum(a - a for a in (*at[shared.place], *frequency))
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


def _cut(tables: Any) -> Any:
    """Tables with edges to be cut as planned, or as suits a compiled kernel."""
    if isinstance(tables, RepeatedTables):
        return replace(tables, element=_cut(tables.element))
    return tables.cut_by(cut_of("compiled", tables)) if isinstance(tables, Tables) else tables


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
