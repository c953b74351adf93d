"""Every place with every frequency by Dr.Jit, with what belongs to a place found once for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.on_numpy import block_of
from polywigner.kernels import SharedSlice
from polywigner.kernels.arrays.lattice_pairs import Copies, SharedCopies

if TYPE_CHECKING:
    from polywigner.execution.on_drjit import OnDrjit

__all__ = ["of_copies", "of_parts", "split"]

# Samples of one place that a lane of a compiled kernel computes together; cuts in one kernel up to
# which it does so where they are code.
_TOGETHER, _FEW_TOGETHER = 4, 64

Array = npt.NDArray[Any]
Fetch = Callable[[], tuple[Array, ...]]


@dataclass(frozen=True)
class _Runs:
    """Columns in runs of one length, the last of which may overlap the one before."""

    length: int
    starts: list[int]


def _runs(columns: int, clips: int) -> _Runs:
    count = _TOGETHER if clips <= _FEW_TOGETHER else 1
    length = -(-columns // count)
    return _Runs(length, [min(k * length, columns - length) for k in range(count)])


def of_copies(
    compute: OnDrjit,
    shared: SharedCopies,
    copies: Copies,
    entered: tuple[Any, ...],
    block: tuple[slice, slice],
) -> Fetch:
    """Results for a block of rows and columns, which are ``entered`` into the frame."""
    import drjit

    ops, kind, (rows, columns) = compute.ops, compute.ops.float_type, block
    inner = tuple(block_of(entered, block))
    shape = np.broadcast_shapes(*(np.shape(a) for a in inner))
    ends = copies.ends[rows.start : rows.stop + 1]
    mine = slice(ends[0], ends[-1])
    listed = [c[mine] for c in (copies.x, copies.y, copies.number, copies.number)]
    # a table of no rows is none
    table = ops.held(np.stack(listed, axis=1) if ends[-1] > ends[0] else np.zeros((1, 4)))
    factors = ops.held(np.stack([f[:, columns].ravel() for f in copies.factors], axis=1))
    limits = ops.held((ends - ends[0])[:, None].astype(np.uint32))
    runs = _runs(shape[1], compute.kernel.copies * compute.tables.clips)
    row, column = split(kind, shape[0], runs.length)
    (first,), (end,) = (ops.gather(limits, row + k) for k in (0, 1))
    places = [column + drjit.opaque(type(column), start) for start in runs.starts]
    own = [compute.looked_up(inner, shape, row, place) for place in places]
    width = drjit.opaque(type(column), shape[1])

    def terms(number: Any) -> tuple[Any, ...]:
        x, y, which, _ = ops.gather(table, number)
        found: tuple[Any, ...] = ()
        for place, arguments in zip(places, own, strict=True):
            factor = ops.gather(factors, ops.truncated(which) * width + place)
            nu = arguments[shared.frequency]
            found += shared.term(ops, compute.tables.part, (x, y), nu, factor)
        return found

    sums = iter(ops.plain_sum(first, end, terms, len(own) * shared.values))
    results = []
    for arguments in own:
        # what lies at infinity or is not a number is so in the result
        lost = sum(a - a for a in (*arguments[shared.place], *arguments[shared.frequency]))
        total = tuple(next(sums) + lost for _ in range(shared.values))
        results.append(compute.kernel.leave(ops, compute.tables.frame, arguments, total))
    return _fetching(compute.dtype, results, runs, shape)


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
    spans = _runs(columns, 0)
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
