"""Pairs of elements of an array, sorted into cells, and sums over those that matter at a place."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["PairLists", "pair_lists", "sum_over_near_pairs", "sum_over_pairs"]

# Cells are of the element's size, or larger where there would be more of them.
_MOST_CELLS = 1 << 20

Vector = tuple[float, float]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PairLists:
    """Pairs sorted by the cell of a grid in which the region begins where they contribute.

    A region is no larger than a cell, so that what contributes to a sample begins in its cell or
    in one of three neighbours: two runs of records. ``records``: midpoint or difference in the
    frame, as two floats a component; the other, in the user's unit; the mutual weight as real
    and imaginary part.
    """

    low: Vector
    scale: Vector
    counts: tuple[int, int]
    """Cells that samples may be in; before them in both directions one more for records."""
    first: NDArray[np.int64]
    """Where the records of each cell begin, row by row."""
    records: Floats
    held: dict[Hashable, Any] = field(default_factory=dict)


def pair_lists(
    centres: Floats, support: Floats, records: Floats, most_cells: int = _MOST_CELLS
) -> PairLists:
    """The records sorted into the cells of a grid over the region in which anything contributes."""
    reach_low, reach_high = support.min(axis=0), support.max(axis=0)
    low, high = centres.min(axis=0) + reach_low, centres.max(axis=0) + reach_high
    size = (reach_high - reach_low) * (1 + 1e-9)  # rounding must not make a region span three cells
    while True:
        counts = np.floor((high - low) / size) + 1
        if float(np.prod(counts + 1.0)) <= most_cells:
            break
        size = size * 1.25
    counts = counts.astype(np.int64)
    begin = np.clip(np.floor((centres + reach_low - low) / size).astype(np.int64), 0, counts - 1)
    cells = (begin[:, 0] + 1) * (counts[1] + 1) + begin[:, 1] + 1
    order = np.argsort(cells, kind="stable")
    first = np.searchsorted(cells[order], np.arange(int(np.prod(counts + 1)) + 1))
    return PairLists(
        (float(low[0]), float(low[1])),
        (float(1 / size[0]), float(1 / size[1])),
        (int(counts[0]), int(counts[1])),
        first.astype(np.int64),
        records[order],
    )


class _Held:
    """The lists in an engine's memory."""

    def __init__(self, ops: Any, lists: PairLists) -> None:
        self.first = ops.held(lists.first[:, None])
        self.records = ops.held(lists.records)


def sum_over_pairs(ops: Any, lists: PairLists, place: Any, term: Any, values: int) -> Any:
    """The sums of ``term`` of the records that may contribute at a place."""
    records = _held(ops, lists).records

    def of_record(row: Any) -> Any:
        return term(*ops.gather(records, row))

    totals: list[Any] = [0.0] * values
    for begin, end in _runs(ops, lists, place):
        sums = ops.sum_over_range(begin, end, of_record, values)
        totals = [total + part for total, part in zip(totals, sums, strict=True)]
    return totals


def sum_over_near_pairs(
    ops: Any, lists: PairLists, place: Any, near: Any, term: Any, values: int, samples: Any
) -> Any:
    """The sums of ``term(record, *samples)`` of the records with ``near(record, *samples)``.

    ``term`` is 0 for others; an engine may leave them out.
    """
    records = _held(ops, lists).records
    totals: list[Any] = [0.0] * values
    for begin, end in _runs(ops, lists, place):
        sums = ops.sum_over_some(
            begin,
            end,
            lambda row, *own: near(ops.gather(records, row), *own),
            lambda row, *own: term(ops.gather(records, row), *own),
            values,
            *samples,
        )
        totals = [total + part for total, part in zip(totals, sums, strict=True)]
    return totals


def _held(ops: Any, lists: PairLists) -> _Held:
    if ops.key not in lists.held:
        lists.held[ops.key] = _Held(ops, lists)
    found: _Held = lists.held[ops.key]
    return found


def _runs(ops: Any, lists: PairLists, place: Any) -> Iterator[tuple[Any, Any]]:
    """The two runs of records for the cell of each place."""
    held = _held(ops, lists)
    u, v = ((p - low) * s for p, low, s in zip(place, lists.low, lists.scale, strict=True))
    rows, columns = lists.counts
    inside = (u >= 0.0) & (u < float(rows)) & (v >= 0.0) & (v < float(columns))
    i, j = (ops.truncated(ops.select(inside, value, 0.0)) for value in (u, v))
    for step in (0, 1):
        cell = (i + step) * (columns + 1) + j
        (begin,), (end,) = ops.gather(held.first, cell), ops.gather(held.first, cell + 2)
        yield begin, ops.select_number(inside, end, begin)
