"""Loops over parts of tables that differ from sample to sample, for every kind of array.

A kernel that works by cells looks up in tables which edges matter at a sample's place. The classes
here are parts of the operations namespaces: they read tables at computed places, and sum up over
ranges of their rows. Those for Dr.Jit arrays are in module `drjit_ranges`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

# Rows that are listed at a time, of which most are then left out.
_LISTED = 1 << 17


def sums_of_some(
    first: Array,
    end: Array,
    keep: Callable[..., Any],
    term: Callable[..., Sequence[Any]],
    values: int,
    samples: Sequence[Any],
) -> list[Array]:
    """The sums of ``term(row, *samples)`` for rows from ``first`` up to ``end`` that are kept.

    In float64. Of arrays (n, 1) and (1, m), ranges and what is kept are for the n.
    """
    shape = np.broadcast_shapes(np.shape(first), *map(np.shape, samples)) or (1,)
    by_rows = len(shape) == 2 and np.shape(first) == (shape[0], 1)
    flat = [np.asarray(a) for a in (first, end, *samples)]
    if not by_rows:
        flat = [a if a.size == 1 else np.broadcast_to(a, shape).ravel() for a in flat]
        flat[:2] = [np.broadcast_to(a.ravel(), math.prod(shape)) for a in flat[:2]]
    begin, counts, samples = flat[0].ravel(), (flat[1] - flat[0]).ravel(), tuple(flat[2:])
    column = (slice(None), None) if by_rows else slice(None)
    totals = [np.zeros(shape if by_rows else len(begin)) for _ in range(values)]
    for owner, row in _listed(begin, counts):
        kept = keep(row[column], *_of(samples, owner, len(begin)))
        (kept,) = np.nonzero(np.ravel(kept))
        for part in _blocks(kept, max(1, _BLOCK * len(begin) // totals[0].size)):
            own = owner[part]
            terms = term(row[part][column], *_of(samples, own, len(begin)))
            for total, found in zip(totals, terms, strict=True):
                np.add.at(total, own, found)
    return [total.reshape(shape) for total in totals]


def _listed(first: Array, counts: Array) -> Iterator[tuple[Array, Array]]:
    """Whose, and row, of all rows from each first on; some at a time."""
    ends = counts.cumsum()
    starts = ends - counts
    for begin in range(0, int(ends[-1]) if len(ends) else 0, _LISTED):
        number = np.arange(begin, min(begin + _LISTED, int(ends[-1])))
        owner = np.searchsorted(ends, number, side="right")
        yield owner, first[owner] + (number - starts[owner])


def _blocks(numbers: Array, size: int) -> Iterator[Array]:
    return (numbers[k : k + size] for k in range(0, len(numbers), size))


def _of(samples: Sequence[Array], owner: Array, count: int) -> list[Array]:
    """The samples of some owners, of ``count``; what is one for all as it is."""
    return [a[owner] if a.ndim and len(a) == count else a for a in samples]


Values = tuple[Any, ...]
Table = npt.NDArray[Any]

# Values of a temporary array that stay in the cache of one core.
_BLOCK = 1 << 14


class NumpyRanges:
    """Ranges for NumPy arrays: one axis before that of the samples for all rows of a range."""

    target = "numpy"
    dtype: np.dtype[Any]
    broadcast_size: int
    """Samples computed at a time, where what they share comes as shorter arrays."""

    @property
    def key(self) -> Hashable:
        """Two namespaces with one key share tables."""
        return self.dtype

    def count(self, like: Any) -> int:
        """Samples computed at a time."""
        return max(int(np.size(like)), self.broadcast_size)

    def held(self, table: Table) -> Any:
        """A table (rows, columns) of numbers or floats as :meth:`gather` wants it."""
        # by columns: of each, so many numbers are taken as fit a cache, without new pages of memory
        return table.astype(self.dtype if table.dtype.kind == "f" else np.int64, order="F")

    def gather(self, table: Any, row: Any) -> Values:
        """The entries of one row of a table."""
        return tuple(table[:, k].take(row) for k in range(table.shape[1]))

    def truncated(self, value: Any) -> Any:
        """A float of at least 0 as a row's number."""
        return np.asarray(value).astype(np.int64)

    def select_number(self, condition: Any, a: Any, b: Any) -> Any:
        """:meth:`select` of rows' numbers."""
        return np.where(condition, a, b)

    def needs_gradient(self, *values: Any) -> bool:
        return False

    def sum_over_range(
        self, first: Any, end: Any, term: Callable[[Any], Values], values: int, like: Any = None
    ) -> list[Any]:
        """The sums of the ``values`` values ``term(row)`` for rows from ``first`` up to ``end``.

        ``like``: of which kind they are, if they are not floats.
        """
        first, count = np.atleast_1d(first), np.atleast_1d(end - first)
        longest = int(count.max(initial=0))
        totals: list[Any] = [np.zeros(count.shape)] * values
        block = max(1, _BLOCK // max(1, count.size, self.broadcast_size))
        for start in range(0, longest, block):
            step = np.arange(start, min(start + block, longest))
            step = step.reshape(-1, *(1,) * count.ndim)
            row = np.where(step < count, first + step, 0)
            terms = term(row)
            parts = [np.where(step < count, t, 0).sum(axis=0, dtype=np.float64) for t in terms]
            totals = [a + b for a, b in zip(totals, parts, strict=True)]
        return [total.astype(self.dtype) for total in totals]

    def sum_over_some(
        self,
        first: Any,
        end: Any,
        keep: Callable[..., Any],
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        """The sums of ``term(row, *samples)`` for rows from ``first`` up to ``end``.

        Where ``keep(row, *samples)`` is false, ``term`` is 0, and need not be computed: the others
        are computed as a list. Of arrays (n, 1) and (1, m), ranges and what is kept are for the n.
        """
        totals = sums_of_some(first, end, keep, term, values, samples)
        return [total.astype(self.dtype) for total in totals]

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

    target = "scalar"
    key: Hashable = float

    def count(self, like: Any) -> int:
        """Samples computed at a time."""
        return 1

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

    def sum_over_range(
        self, first: Any, end: Any, term: Callable[[Any], Values], values: int, like: Any = None
    ) -> list[Any]:
        totals = [0.0] * values
        for row in range(first, end):
            totals = [a + b for a, b in zip(totals, term(row), strict=True)]
        return totals

    def sum_over_some(
        self,
        first: Any,
        end: Any,
        keep: Callable[..., Any],
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        totals = [0.0] * values
        for row in range(first, end):
            if keep(row, *samples):
                terms = term(row, *samples)
                totals = [a + b for a, b in zip(totals, terms, strict=True)]
        return totals

    def sum_over_runs(
        self,
        first: Any,
        end: Any,
        runs: Any,
        term: Callable[[Any, Any], Values],
        values: int,
        like: Any = None,
    ) -> list[Any]:
        totals = [0.0] * values
        for begin, stop, number, _ in runs[first:end]:
            terms = (term(row, number) for row in range(begin, stop))
            for found in terms:
                totals = [a + b for a, b in zip(totals, found, strict=True)]
        return totals

    def sum_over_rows(
        self,
        first: Any,
        end: Any,
        visit: Callable[[Any], tuple[Any, Values, Values, Callable[[Values], Values]]],
        values: int,
        levels: int,
    ) -> list[Any]:
        totals, level = [0.0] * values, (0.0,) * levels
        for row in range(first, end):
            sets, start, jumps, term = visit(row)
            level = start if sets else level
            totals = [a + b for a, b in zip(totals, term(level), strict=True)]
            level = tuple(a + b for a, b in zip(level, jumps, strict=True))
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
