"""A kernel of a source on NumPy arrays, chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.chunks import Fetch, Launched, parts_of_results, ready
from polywigner.execution.operations import NumpyOperations
from polywigner.kernels import Kernel, PartSum, SharedSlice
from polywigner.kernels.outline.tables import cut_of

CHUNK = 3 << 12
"""Samples at a time: a temporary array stays in the cache of one core, and below 128 KiB, from
which on the C library maps memory anew: page faults cost more than what is computed."""
# Of fewer samples it is not worth finding those for which there is nothing to do.
_LEAST_MASKED = 256
# Where slices are cut once for many samples: rows enough to cut at a time.
_SHARED_CHUNK = 1 << 18

Array = npt.NDArray[Any]


class OnNumpy:
    """A kernel of a source, computed by NumPy."""

    shared_block = _SHARED_CHUNK

    def __init__(self, kernel: Kernel, tables: Any, double: bool) -> None:
        self.kernel, self.tables = kernel, tables
        self.host = NumpyOperations(double=True)
        self.ops = NumpyOperations(double)

    def points(self, components: Sequence[Array], results: Sequence[Array]) -> Launched:
        """Results for components that broadcast to their shape, chunk by chunk."""
        for arguments, targets in parts_of_results(components, results, CHUNK):
            count = len(arguments[0])
            order = self._order(arguments, count)
            if order is not ... and len(order) < count:
                for target in targets:
                    target[:] = 0.0
            if order is ... or len(order):
                values = self.values([a[order] for a in arguments])
                yield targets, order, ready(values)

    def _order(self, arguments: Sequence[Array], count: int) -> Any:
        """Order of the samples, without samples too far off to have a value other than 0."""
        slices, tables = self.kernel.slices, self.tables
        if slices is None or count < _LEAST_MASKED or cut_of("numpy", tables, count) == "pairs":
            return ...
        inner = self.entered(arguments)
        with np.errstate(invalid="ignore", over="ignore"):
            mask = slices.support_mask(tables, *inner)
        for argument in inner:  # 0 times what is not finite is not 0
            mask |= ~np.isfinite(argument)
        (order,) = np.nonzero(mask)
        return ... if len(order) == len(mask) else order

    def values(self, arguments: Sequence[Array]) -> tuple[Array, ...]:
        """The results of a chunk."""
        ops, frame = self.ops, self.tables.frame
        # what lies at infinity or is not a number is so in the result; no need to warn
        with np.errstate(invalid="ignore", over="ignore"):
            inner = self.kernel.enter(self.host, frame, *arguments)
            if not ops.double:
                inner = tuple(a.astype(np.float32) for a in inner)
            sums = self.kernel.edge_sum(ops, self.tables, *inner)
            return self.kernel.leave(ops, frame, inner, sums)

    def entered(self, arguments: Sequence[Array]) -> tuple[Any, ...]:
        """The arguments in the frame, in the shapes that they have."""
        with np.errstate(invalid="ignore", over="ignore"):
            return self.kernel.enter(self.host, self.tables.frame, *arguments)

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
