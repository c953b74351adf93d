"""Loops over parts of tables that differ from sample to sample, for every kind of array.

A kernel that works by cells looks up in tables which edges matter at a sample's place. The classes
here are parts of the operations namespaces: they read tables at computed places, and sum up over
ranges of their rows.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["DrjitRanges", "NumpyRanges", "ScalarRanges", "aligned"]

Values = tuple[Any, ...]
Table = npt.NDArray[Any]

# Values of a temporary array that stay in the cache of one core.
_BLOCK = 1 << 14
# To find the cells takes some 3 us per cut and 60 bytes, so that there is an upper end as well: the
# regular polygon of 2900 vertices, with 8 million cuts.
_MOST_CUTS = 8_000_000
# Cuts beyond which cells are faster than constants compiled into a kernel: where samples are sorted
# by cell (the 32-gon), and where they are not (the 67-gon, which takes seconds to compile).
_CELLS_ABOVE_SORTED, _CELLS_ABOVE_UNSORTED = 1000, 4500
# NumPy: with fewer samples, to find the cells takes longer than all the cuts.
_CELLS_ABOVE_NUMPY, _MANY_SAMPLES = 4000, 1024
_CELLS_ABOVE_SCALAR = 300


class NumpyRanges:
    """Ranges for NumPy arrays: one axis before that of the samples for all rows of a range."""

    dtype: np.dtype[Any]
    run_sums: Any = None
    samples = 0
    """Of the whole that comes in chunks, where it is known."""
    at_once = 0
    """Samples computed at a time, where what they share comes as shorter arrays."""

    @property
    def key(self) -> Hashable:
        """Two namespaces with one key share tables."""
        return self.dtype

    def prefers_cells(self, clips: int, like: Any) -> bool:
        """Whether to look up in cells what matters at a place."""
        many = max(self.samples, np.size(like)) >= _MANY_SAMPLES
        return many and _CELLS_ABOVE_NUMPY < clips <= _MOST_CUTS

    def held(self, table: Table) -> Any:
        """A table (rows, columns) of numbers or floats as :meth:`gather` wants it."""
        return table.astype(self.dtype if table.dtype.kind == "f" else np.int64)

    def gather(self, table: Any, row: Any) -> Values:
        """The entries of one row of a table."""
        return tuple(np.moveaxis(table[row], -1, 0))

    def truncated(self, value: Any) -> Any:
        """A float of at least 0 as a row's number."""
        return np.asarray(value).astype(np.int64)

    def select_number(self, condition: Any, a: Any, b: Any) -> Any:
        """:meth:`select` of rows' numbers."""
        return np.where(condition, a, b)

    def needs_gradient(self, *values: Any) -> bool:
        return False

    def detached(self, value: Any) -> Any:
        return value

    def sum_over_range(
        self, first: Any, end: Any, term: Callable[[Any], Values], values: int
    ) -> list[Any]:
        """The sums of the ``values`` values ``term(row)`` for rows from ``first`` up to ``end``."""
        first, count = np.atleast_1d(first), np.atleast_1d(end - first)
        longest = int(count.max(initial=0))
        totals: list[Any] = [np.zeros(count.shape)] * values
        block = max(1, _BLOCK // max(1, count.size, self.at_once))
        for start in range(0, longest, block):
            step = np.arange(start, min(start + block, longest))
            step = step.reshape(-1, *(1,) * count.ndim)
            row = np.where(step < count, first + step, 0)
            terms = term(row)
            parts = [np.where(step < count, t, 0).sum(axis=0, dtype=np.float64) for t in terms]
            totals = [a + b for a, b in zip(totals, parts, strict=True)]
        return [total.astype(self.dtype) for total in totals]

    def sum_over_runs(
        self, first: Any, end: Any, runs: Any, term: Callable[[Any, Any], Values], values: int
    ) -> list[Any]:
        """The same over all rows of the runs ``first`` to ``end``; ``term(row, weight number)``.

        ``runs``: a table of first row, end of the rows, number of the weight.
        """
        first, end = np.atleast_1d(first), np.atleast_1d(end)
        ends = np.stack([first.ravel(), end.ravel()])
        ranges, place = np.unique(ends, axis=1, return_inverse=True)
        rows, numbers, starts = [], [], [0]
        for a, b in ranges.T.tolist():
            mine = runs[a:b]
            lengths = mine[:, 1] - mine[:, 0]
            stops = lengths.cumsum()
            rows.append(np.arange(lengths.sum()) + np.repeat(mine[:, 0] - stops + lengths, lengths))
            numbers.append(np.repeat(mine[:, 2], lengths))
            starts.append(starts[-1] + len(rows[-1]))
        row, number = np.concatenate(rows), np.concatenate(numbers)
        place = place.reshape(first.shape)
        starts_ = np.array(starts)
        return self.sum_over_range(
            starts_[place], starts_[place + 1], lambda k: term(row[k], number[k]), values
        )

    def fold(self, first: Any, end: Any, state: Values, step: Callable[..., Values]) -> Values:
        """The last ``state = step(row, *state)`` for rows from ``first`` up to ``end``."""
        count = end - first
        state = tuple(np.broadcast_to(np.asarray(s), np.shape(count)) for s in state)
        for k in range(int(count.max(initial=0))):
            active = k < count
            found = step(np.where(active, first + k, 0), *state)
            state = tuple(np.where(active, new, old) for new, old in zip(found, state, strict=True))
        return state

    def sum_over_rule(
        self,
        rule: Any,
        rules: Sequence[Table],
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        """The sums of ``term(*row, *samples)`` over the rows of one of several tables of floats.

        ``rule``: the number of each sample's table, or -1 for a sum over nothing.
        """
        rule, *arrays = np.broadcast_arrays(rule, *samples)
        totals = [np.zeros(rule.shape, self.dtype) for _ in range(values)]
        for number in np.unique(rule):
            if number < 0:
                continue
            mine = ... if (rule == number).all() else rule == number
            own = [array[mine].ravel() for array in arrays]
            count = rule[mine].size
            found = self._sums_over_table(rules[int(number)], term, values, count, own)
            for total, part in zip(totals, found, strict=True):
                total[mine] = part.reshape(total[mine].shape)
        return totals

    def _sums_over_table(
        self,
        table: Table,
        term: Callable[..., Values],
        values: int,
        count: int,
        samples: Sequence[Table],
    ) -> list[Any]:
        rows = table.astype(self.dtype)[..., None]
        totals = [np.zeros(count) for _ in range(values)]
        block = max(1, _BLOCK // max(1, count))
        for start in range(0, len(rows), block):
            terms = term(*np.moveaxis(rows[start : start + block], 1, 0), *samples)
            for total, part in zip(totals, terms, strict=True):
                total += part.sum(axis=0, dtype=np.float64)
        return totals


class ScalarRanges:
    """Ranges for Python floats."""

    key: Hashable = float
    run_sums: Any = None

    def prefers_cells(self, clips: int, like: Any) -> bool:
        """Whether to look up in cells what matters at a place."""
        return _CELLS_ABOVE_SCALAR < clips <= _MOST_CUTS

    def held(self, table: Table) -> Any:
        return table.tolist()

    def gather(self, table: Any, row: Any) -> Values:
        return tuple(table[row])

    def truncated(self, value: Any) -> Any:
        return int(value)

    def select_number(self, condition: Any, a: Any, b: Any) -> Any:
        return a if condition else b

    def needs_gradient(self, *values: Any) -> bool:
        return False

    def detached(self, value: Any) -> Any:
        return value

    def sum_over_range(
        self, first: Any, end: Any, term: Callable[[Any], Values], values: int
    ) -> list[Any]:
        totals = [0.0] * values
        for row in range(first, end):
            totals = [a + b for a, b in zip(totals, term(row), strict=True)]
        return totals

    def sum_over_runs(
        self, first: Any, end: Any, runs: Any, term: Callable[[Any, Any], Values], values: int
    ) -> list[Any]:
        totals = [0.0] * values
        for begin, stop, number, _ in runs[first:end]:
            terms = (term(row, number) for row in range(begin, stop))
            for found in terms:
                totals = [a + b for a, b in zip(totals, found, strict=True)]
        return totals

    def fold(self, first: Any, end: Any, state: Values, step: Callable[..., Values]) -> Values:
        for row in range(first, end):
            state = step(row, *state)
        return state

    def sum_over_rule(
        self,
        rule: float,
        rules: Sequence[Table],
        term: Callable[..., Values],
        values: int,
        *samples: float,
    ) -> list[Any]:
        """The sums of ``term(*row, *samples)`` over the rows of a table, or nothing for -1."""
        rows = rules[int(rule)].tolist() if rule >= 0 else []
        totals = [0.0] * values
        for row in rows:
            totals = [a + b for a, b in zip(totals, term(*row, *samples), strict=True)]
        return totals


class DrjitRanges:
    """Ranges for Dr.Jit arrays: loops of the kernel that is being traced."""

    def __init__(self, float_type: Any, sorted_by_cell: bool) -> None:
        import drjit

        self._drjit = drjit
        self._cells_above = _CELLS_ABOVE_SORTED if sorted_by_cell else _CELLS_ABOVE_UNSORTED
        self.float_type = float_type
        self._numbers = drjit.uint32_array_t(float_type)
        self.run_sums: Any = None
        """What stands for whole edges found by cells, while it is set."""

    @property
    def key(self) -> Hashable:
        """Two namespaces with one key share tables."""
        return self.float_type

    def prefers_cells(self, clips: int, like: Any) -> bool:
        """Whether to look up in cells what matters at a place."""
        return self._cells_above < clips <= _MOST_CUTS

    def held(self, table: Table) -> Any:
        """(entries in a row, the entries of all rows one after the other)."""
        kind = self.float_type if table.dtype.kind == "f" else self._numbers
        dtype: type[Any] = np.uint32
        if table.dtype.kind == "f":
            dtype = np.float64 if self._drjit.itemsize_v(self.float_type) == 8 else np.float32
        flat = aligned(table.size, dtype)
        flat[...] = table.ravel()
        return table.shape[1], kind(flat)

    def gather(self, table: Any, row: Any) -> Values:
        width, flat = table
        kind = type(flat)
        if width % 4:
            return tuple(self._drjit.gather(kind, flat, width * row + k) for k in range(width))
        # four entries at a time: one load, where each alone would be another
        module = sys.modules[kind.__module__]
        four = getattr(module, _PACKETS[kind.__name__])
        packets = width // 4
        found = (self._drjit.gather(four, flat, packets * row + k) for k in range(packets))
        return tuple(entry for packet in found for entry in packet)

    def truncated(self, value: Any) -> Any:
        return self._numbers(value)

    def select_number(self, condition: Any, a: Any, b: Any) -> Any:
        return self._drjit.select(condition, self._typed(a), self._typed(b))

    def needs_gradient(self, *values: Any) -> bool:
        return any(self._drjit.grad_enabled(value) for value in values)

    def detached(self, value: Any) -> Any:
        return self._drjit.detach(value)

    def sum_over_range(
        self, first: Any, end: Any, term: Callable[[Any], Values], values: int
    ) -> list[Any]:
        if self._drjit.itemsize_v(self.float_type) == 8:
            return self.plain_sum(first, end, term, values)

        # what rounding of the sum loses is summed up as well: of terms that cancel, it is the most
        def step(row: Any, *sums: Any) -> Values:
            added = tuple(zip(sums, term(row), strict=False))
            lost = tuple(
                total + self._lost(a, b) for total, (a, b) in zip(sums[values:], added, strict=True)
            )
            return row + 1, *(a + b for a, b in added), *lost

        sums = self._loop(first, end, step, 2 * values)
        return [a + b for a, b in zip(sums[:values], sums[values:], strict=True)]

    def _lost(self, a: Any, b: Any) -> Any:
        """The rounding error of a + b, exactly (Knuth's sum)."""
        a, b = self._drjit.detach(a), self._drjit.detach(b)
        total = a + b
        of_b = total - a
        return (a - (total - of_b)) + (b - of_b)

    def plain_sum(
        self, first: Any, end: Any, term: Callable[[Any], Values], values: int
    ) -> list[Any]:
        """:meth:`sum_over_range` for so few terms that rounding of the sum does not matter."""

        def step(row: Any, *sums: Any) -> Values:
            return row + 1, *(a + b for a, b in zip(sums, term(row), strict=True))

        return self._loop(first, end, step, values)

    def _loop(self, first: Any, end: Any, step: Callable[..., Values], values: int) -> list[Any]:
        zeros = (self.float_type(0.0) for _ in range(values))
        # max_iterations=-1: a sum, so that its reverse-mode derivative is a sum as well
        _, *totals = self._drjit.while_loop(
            (self._numbers(first), *zeros), lambda row, *_: row < end, step, max_iterations=-1
        )
        return totals

    def sum_over_runs(
        self, first: Any, end: Any, runs: Any, term: Callable[[Any, Any], Values], values: int
    ) -> list[Any]:
        def of_run(number: Any) -> Values:
            begin, stop, weight, _ = self.gather(runs, number)
            return tuple(self.plain_sum(begin, stop, lambda row: term(row, weight), values))

        return self.sum_over_range(first, end, of_run, values)

    def sum_over_rule(
        self,
        rule: Any,
        rules: Sequence[Table],
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        """The sums of ``term(*row, *samples)`` over the rows of a table; over none for rule -1."""
        ends = np.cumsum([len(table) for table in rules])
        ranges = np.stack(
            [np.append(0, ends - [len(t) for t in rules]), np.append(0, ends)], axis=1
        )
        first, end = self.gather(self.held(ranges), self.truncated(rule + 1.0))
        table = self.held(np.concatenate(rules))
        return self.sum_over_range(
            first, end, lambda row: term(*self.gather(table, row), *samples), values
        )

    def fold(self, first: Any, end: Any, state: Values, step: Callable[..., Values]) -> Values:
        def next_row(row: Any, *state: Any) -> Values:
            return row + 1, *step(row, *state)

        start = tuple(self._typed(s) for s in state)
        _, *result = self._drjit.while_loop(
            (self._numbers(first), *start), lambda row, *_: row < end, next_row
        )
        return tuple(result)

    def _typed(self, value: Any) -> Any:
        kinds = {float: self.float_type, int: self._numbers}
        return kinds[type(value)](value) if type(value) in kinds else value


_PACKETS = {"Float": "Array4f", "Float64": "Array4f64", "UInt": "Array4u"}


def aligned(size: int, dtype: Any) -> Table:
    """An uninitialised array that starts on a 64-byte boundary.

    Dr.Jit uses NumPy's memory in place and compiles a kernel anew for each alignment that it
    happens to have; here it is always the same.
    """
    kind = np.dtype(dtype)
    memory = np.empty(size * kind.itemsize + 64, np.uint8)
    start = -memory.ctypes.data % 64
    return memory[start : start + size * kind.itemsize].view(kind)
