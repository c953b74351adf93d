"""Kernels on NumPy arrays: broadcast, cut into chunks, computed by NumPy or Dr.Jit.

Memory is bounded by the result plus one chunk: broadcast arguments are never expanded as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from polywigner.engines.choice import drjit_float, resolved
from polywigner.engines.grids import evaluate_on_grid
from polywigner.engines.operations import DrjitOperations, NumpyOperations
from polywigner.engines.pairs import Pairs, pairs_of
from polywigner.engines.ranges import aligned
from polywigner.kernels import Kernel, parts_of

__all__ = ["OnDrjit", "evaluate"]

# Samples at a time. NumPy: a temporary stays in the cache of one core. Dr.Jit: launching costs
# little against computing, and the arguments of a chunk take some 10 MB.
_NUMPY_CHUNK = 1 << 13
_DRJIT_CHUNK = 1 << 18
# Nothing is fed from memory where arguments are pairs.
_PAIRS_CHUNK = 1 << 20
# Where samples are sorted by cell: enough for some in each of the many cells.
_SORTED_CHUNK = 1 << 20
# Edges are traced in groups of about this many clips: beyond it, compilation time grows faster
# than linearly (0.4 s for one group of 1000 in float32, 1 s in float64, on one core).
_CLIPS_PER_KERNEL = 1000

Array = npt.NDArray[Any]


def evaluate(
    kernel: Kernel,
    source: Any,
    components: Sequence[Array],
    *,
    double: bool,
    engine: str,
    outputs: int,
) -> tuple[Array, ...]:
    """Results of a kernel for float64 argument components that broadcast to one shape.

    Arguments enter the frame in float64 whatever the precision of the sums.
    """
    shape = np.broadcast_shapes(*(c.shape for c in components))
    tables = kernel.tables(source, double)
    if kernel.on_grid:
        by_points = _Numpy(kernel, tables, double)
        found = evaluate_on_grid(
            kernel, source, components, by_points, double=double, engine=engine
        )
        if found:
            return found
    dtype = np.float64 if double else np.float32
    results = tuple(np.empty(shape, dtype) for _ in range(outputs))
    # pieces that are cut are code, terms of a plain sum are data
    terms = 1 if kernel.copies else len(tables.edges)
    engine = resolved(engine, int(np.prod(shape)), terms)
    compute: _Numpy | OnDrjit
    if engine == "numpy":
        compute, chunk = _Numpy(kernel, tables, double), _NUMPY_CHUNK
        compute.ops.samples = int(np.prod(shape))
    else:
        compute, chunk = OnDrjit(kernel, tables, double, engine), _DRJIT_CHUNK
        if kernel.order and compute.ops.prefers_cells(tables.clips_for_cells, None):
            chunk = _SORTED_CHUNK
        pairs = pairs_of(components, shape)
        if pairs is not None and compute.takes(pairs):
            _fill_pairs(compute, pairs, results)
            return results
    for arguments, targets in _chunks(components, results, chunk):
        order = _order(kernel, tables, compute.ops, arguments)
        values = compute([argument[order] for argument in arguments])
        for target, value in zip(targets, values, strict=True):
            target[order] = value
    return results


def _fill_pairs(compute: OnDrjit, pairs: Pairs, results: Sequence[Array]) -> None:
    tables = [result.reshape(pairs.rows, pairs.columns) for result in results]
    for rows, columns in pairs.blocks(_PAIRS_CHUNK):
        values = compute.of_pairs(pairs.block(rows, columns))
        for table, value in zip(tables, values, strict=True):
            table[rows, columns] = value


def _order(kernel: Kernel, tables: Any, ops: Any, arguments: Sequence[Array]) -> Any:
    """The order in which to take the samples: all, or by the cell in which each has its edges."""
    if kernel.order is None or not ops.prefers_cells(tables.clips_for_cells, arguments[0]):
        return ...
    host = NumpyOperations(double=True)
    with np.errstate(invalid="ignore", over="ignore"):
        inner = kernel.enter(host, tables.frame, *arguments)
        cell = kernel.order(host, tables, *inner)
        # NumPy sorts numbers of 16 bits in linear time
        small = cell.max(initial=0) < 1 << 16
        return np.argsort(cell.astype(np.uint16) if small else cell, kind="stable")


def _chunks(
    components: Sequence[Array], results: Sequence[Array], size: int
) -> Iterator[tuple[Sequence[Array], Sequence[Array]]]:
    count = len(components)
    read: list[list[Literal["readonly"]]] = [["readonly"]] * count
    write: list[list[Literal["writeonly"]]] = [["writeonly"]] * len(results)
    with np.nditer(
        [*components, *results],
        flags=["external_loop", "buffered", "zerosize_ok"],
        op_flags=[*read, *write],
        order="C",
        buffersize=size,
    ) as iterator:
        for chunk in iterator:
            if chunk[0].size:
                yield chunk[:count], chunk[count:]


class _Numpy:
    def __init__(self, kernel: Kernel, tables: Any, double: bool) -> None:
        self.kernel, self.tables = kernel, tables
        self.host = NumpyOperations(double=True)
        self.ops = NumpyOperations(double)

    def __call__(self, arguments: Sequence[Array]) -> tuple[Array, ...]:
        frame = self.tables.frame
        # what lies at infinity or is not a number is so in the result; no need to warn
        with np.errstate(invalid="ignore", over="ignore"):
            inner = self.kernel.enter(self.host, frame, *arguments)
            if not self.ops.double:
                inner = tuple(a.astype(np.float32) for a in inner)
            sums = self.kernel.edge_sum(self.ops, self.tables, *inner)
            return self.kernel.leave(self.ops, frame, inner, sums)


class OnDrjit:
    """A kernel of a source, traced with Dr.Jit."""

    def __init__(self, kernel: Kernel, tables: Any, double: bool, engine: str) -> None:
        self.kernel, self.tables = kernel, tables
        self.ops = DrjitOperations(drjit_float(engine, double), sorted_by_cell=True)
        self.entry = DrjitOperations(drjit_float(engine, double=True))
        self.memory: dict[int, Array] = {}
        in_a_loop = kernel.copies and self.ops.prefers_rows(tables.clips, None)
        if kernel.order is not None and self.ops.prefers_cells(tables.clips_for_cells, None):
            in_a_loop = True
        self.parts = [tables] if in_a_loop else parts_of(kernel, tables, _CLIPS_PER_KERNEL)

    def __call__(self, arguments: Sequence[Array]) -> tuple[Array, ...]:
        inner = self.kernel.enter(self.entry, self.tables.frame, *self._sent_all(arguments))
        if not self.ops.double:
            inner = tuple(self.ops.float_type(a) for a in inner)
        return self._of_inner(inner)

    def traced(self, part: Any, arguments: Sequence[Any]) -> tuple[Any, ...]:
        """What one of the ``parts`` contributes to the results, for arrays of ``entry``'s type."""
        inner = self.kernel.enter(self.entry, self.tables.frame, *arguments)
        if not self.ops.double:
            inner = tuple(self.ops.float_type(a) for a in inner)
        sums = self.kernel.edge_sum(self.ops, part, *inner)
        return self.kernel.leave(self.ops, self.tables.frame, inner, sums)

    def of_pairs(self, arguments: Sequence[Array]) -> tuple[Array, ...]:
        """The same for arguments of shape (rows, 1) and (1, columns), in shape (rows, columns)."""
        import drjit

        kind = self.ops.float_type
        rows, columns = np.broadcast_shapes(*(a.shape for a in arguments))
        index = drjit.arange(drjit.uint32_array_t(kind), rows * columns)
        # Opaque, or there would be a kernel for each number of columns. A division of fewer than
        # 2^21 samples: half a sample is more than two roundings, to float32, of the quotient.
        row = type(index)((kind(index) + 0.5) * drjit.opaque(kind, 1 / columns))
        column = index - row * drjit.opaque(type(index), columns)
        places = {(rows, 1): row, (1, columns): column}

        def expanded(slot: int, values: Any) -> Any:
            if np.ndim(values) == 0:
                return kind(float(values))
            memory = self._sent(slot, values.ravel(), kind)
            place = places.get(values.shape)
            return memory if place is None else drjit.gather(kind, memory, place)

        entered = self._entered(arguments)
        inner = tuple(expanded(slot, values) for slot, values in enumerate(entered))
        return tuple(values.reshape(rows, columns) for values in self._of_inner(inner))

    def takes(self, pairs: Pairs) -> bool:
        """Whether samples of one row lie in one cell, where edges are looked up by cells."""
        kernel, tables = self.kernel, self.tables
        if kernel.order is None or not self.ops.prefers_cells(tables.clips_for_cells, None):
            return True
        few = slice(0, 2)
        inner = self._entered(pairs.block(few, few))
        return np.shape(kernel.order(NumpyOperations(double=True), tables, *inner))[-1] == 1

    def _entered(self, arguments: Sequence[Array]) -> tuple[Any, ...]:
        with np.errstate(invalid="ignore", over="ignore"):
            return self.kernel.enter(NumpyOperations(double=True), self.tables.frame, *arguments)

    def _of_inner(self, inner: tuple[Any, ...]) -> tuple[Array, ...]:
        import drjit

        frame = self.tables.frame
        if len(self.parts) > 1:
            drjit.eval(inner)
        sums: tuple[Any, ...] = ()
        for part in self.parts:
            terms = self.kernel.edge_sum(self.ops, part, *inner)
            sums = tuple(a + b for a, b in zip(sums, terms, strict=True)) if sums else terms
            if len(self.parts) > 1:
                drjit.eval(sums)
        results = self.kernel.leave(self.ops, frame, inner, sums)
        drjit.eval(results)
        return tuple(np.asarray(r.numpy()) for r in results)

    def _sent_all(self, arrays: Sequence[Array]) -> tuple[Any, ...]:
        kind = self.entry.float_type
        return tuple(self._sent(slot, array, kind) for slot, array in enumerate(arrays))

    def _sent(self, slot: int, array: Array, kind: Any) -> Any:
        """The chunk as an engine's array, in memory that all chunks use in turn.

        Dr.Jit uses NumPy's memory in place and compiles a kernel anew for each alignment that it
        happens to have; here the alignment is always the same. Every chunk is finished, and its
        results fetched, before the next one is sent.
        """
        if slot not in self.memory or len(self.memory[slot]) < array.size:
            dtype = np.float64 if kind is self.entry.float_type else np.float32
            self.memory[slot] = aligned(array.size, dtype)
        memory = self.memory[slot][: array.size]
        memory[...] = array
        return kind(memory)
