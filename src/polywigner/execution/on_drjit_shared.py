"""Every place with every frequency by Dr.Jit, with what belongs to a place found once for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.chunks import Fetch
from polywigner.kernels import SharedSlice

if TYPE_CHECKING:
    from polywigner.execution.on_drjit import OnDrjit

__all__ = ["of_parts", "split"]

# Samples of one place that a lane of a compiled kernel computes together.
_TOGETHER = 4

Array = npt.NDArray[Any]


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
    return _fetching(compute.dtype, results, spans, (rows, columns))


def _fetching(
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
