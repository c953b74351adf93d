"""The operations namespaces over which the kernels are written, of NumPy arrays and Python floats.

A kernel is straight-line code in ``+ - * /``, comparisons, ``abs`` and the methods here. The same
lines run on NumPy arrays, on Python floats (Mitsuba's scalar variants), and, traced, on Dr.Jit
arrays of any backend, whose namespace is in module `drjit_operations`. A kernel that works by cells
looks up in tables which edges matter at a sample's place: the methods on tables sum up over ranges
of their rows that differ from sample to sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.numerics.grid_arithmetic import (
    SPLIT_DOUBLE,
    SPLIT_SINGLE,
    accurate_cross,
    product_error,
)

# NumPy: calls on short arrays cost more than what they compute.
_FEW_SAMPLES = 256
# Values of a temporary array that stay in the cache of one core.
_BLOCK = 1 << 14
# Rows that are listed at a time, of which most are then left out.
_LISTED = 1 << 17

Array = npt.NDArray[Any]
Table = npt.NDArray[Any]
Row = tuple[float, ...]
Values = tuple[Any, ...]
Term = Callable[..., Values]


def unrolled_sum(rows: Sequence[Row], term: Term) -> Values:
    """The sums of ``term(*row)``, one row after the other."""
    totals = term(*rows[0])
    for row in rows[1:]:
        totals = _added(totals, term(*row))
    return totals


def unrolled_steps(count: int, state: Values, step: Term) -> Values:
    """The last ``state = step(number, *state)`` for numbers from 0 up to ``count``."""
    for number in range(count):
        state = step(number, *state)
    return state


def _added(a: Sequence[Any], b: Sequence[Any]) -> Values:
    return tuple(p + q for p, q in zip(a, b, strict=True))


class Operations:
    """Methods that types may share."""

    target: str
    double: bool
    key: Hashable
    """Two namespaces with one key share tables."""

    def needs_gradient(self, *values: Any) -> bool:
        return False


class _Unfused(Operations):
    """Operations of number types without a fused multiply-add."""

    round: Any

    def sum_large_terms(self, rows: Sequence[Row], term: Term, clips: int) -> Values:
        """Sums of terms of much code, one after the other."""
        return unrolled_sum(rows, term)

    def repeated(self, count: int, state: Values, step: Term, _: Any) -> Values:
        """The last ``state = step(number, *state)`` for numbers from 0 up to ``count``."""
        return unrolled_steps(count, state, step)

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """a b + c, rounded twice."""
        return a * b + c

    def cross(self, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
        """ax by - ay bx to about one ulp of the result."""
        return accurate_cross(ax, ay, bx, by, SPLIT_DOUBLE if self.double else SPLIT_SINGLE)

    def lost(self, a: Any, b: Any, product: Any) -> Any:
        """The rounding error of ``product`` = a b, exactly."""
        return product_error(a, b, product, SPLIT_DOUBLE if self.double else SPLIT_SINGLE)

    def snapped(self, a: Any, step: float) -> Any:
        """The nearest multiple of ``step``, a power of two."""
        return self.round(a * (1 / step)) * step


class NumpyOperations(_Unfused):
    """NumPy arrays of float64 (``double``) or float32.

    Rows come on an axis before that of the samples.
    """

    target = "numpy"

    def __init__(self, double: bool) -> None:
        self.double = double
        self.dtype = self.key = np.dtype(np.float64 if double else np.float32)
        if double and type(self) is NumpyOperations:  # no type to keep: without a call
            self.__dict__["select"] = np.where

    def sum_over(
        self, rows: Sequence[Row], term: Term, values: int, like: Any, *, unroll: bool = True
    ) -> Values:
        """The sums, one by one, of the ``values`` values that ``term(*row)`` gives for each row.

        Takes as many rows at once, on an axis before that of the samples ``like``, as fit a cache.
        """
        # Of few samples, in float64 throughout: what is constant in a term is not rounded first.
        samples = int(np.size(like))
        table = np.array(rows, np.float64 if samples <= _FEW_SAMPLES else self.dtype)
        axes = (1,) * max(1, np.ndim(like))
        block = max(1, _BLOCK // max(1, samples))
        totals: Values = (0.0,) * values
        for start in range(0, len(table), block):
            terms = term(*table[start : start + block].T.reshape(table.shape[1], -1, *axes))
            # in float64: of many rows, one after the other, float32 would lose a digit
            totals = _added(totals, [part.sum(axis=0, dtype=np.float64) for part in terms])
        return tuple(np.asarray(total, self.dtype) for total in totals)

    def select(self, condition: Any, a: Any, b: Any) -> Any:
        return np.where(condition, self._typed(a), self._typed(b))

    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)
    round = staticmethod(np.rint)
    log = staticmethod(np.log)
    atan2 = staticmethod(np.arctan2)
    sqrt = staticmethod(np.sqrt)

    def exp(self, a: Any) -> Any:
        return np.exp(self._typed(a))

    def _typed(self, value: Any) -> Any:
        # np.where promotes Python floats to float64
        return self.dtype.type(value) if isinstance(value, (int, float)) else value

    def cross(self, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
        return super().cross(*map(self._typed, (ax, ay, bx, by)))

    def lost(self, a: Any, b: Any, product: Any) -> Any:
        return super().lost(self._typed(a), self._typed(b), product)

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

    def sum_over_some(
        self, first: Any, end: Any, keep: Callable[..., Any], term: Term, values: int, *samples: Any
    ) -> list[Any]:
        """The sums of ``term(row, *samples)`` for rows from ``first`` up to ``end``.

        Where ``keep(row, *samples)`` is false, ``term`` is 0, and need not be computed: the others
        are computed as a list.
        """
        shape = np.broadcast_shapes(np.shape(first), *map(np.shape, samples)) or (1,)
        count = math.prod(shape)
        begin, stop = (np.broadcast_to(a, shape).ravel() for a in (first, end))
        flat = [np.ravel(a if np.size(a) == 1 else np.broadcast_to(a, shape)) for a in samples]
        totals = [np.zeros(count) for _ in range(values)]

        def of(owner: Array) -> list[Array]:
            """Samples of some owners; single numbers as they are."""
            return [a[owner] if len(a) == count else a for a in flat]

        for owner, row in _listed(begin, stop - begin):
            (kept,) = np.nonzero(keep(row, *of(owner)))
            for part in (kept[k : k + _BLOCK] for k in range(0, len(kept), _BLOCK)):
                own = owner[part]
                terms = term(row[part], *of(own))
                for total, found in zip(totals, terms, strict=True):
                    np.add.at(total, own, found)
        return [total.reshape(shape).astype(self.dtype) for total in totals]

    def sum_over_rule(
        self, rule: Any, rules: Sequence[Table], term: Term, values: int, *samples: Any
    ) -> list[Any]:
        """The sums of ``term(*row, *samples)`` over the rows of one of several tables of floats.

        ``rule``: the number of each sample's table, or -1 for a sum over nothing.
        """
        rule, *arrays = np.broadcast_arrays(rule, *samples)
        totals = [np.zeros(rule.shape, self.dtype) for _ in range(values)]
        for number in np.unique(rule[rule >= 0]):
            mine = ... if (rule == number).all() else rule == number
            own = [array[mine].ravel() for array in arrays]
            table = rules[int(number)].astype(self.dtype)[..., None]
            count = rule[mine].size
            sums: Values = (np.zeros(count),) * values
            block = max(1, _BLOCK // max(1, count))
            for start in range(0, len(table), block):
                terms = term(*np.moveaxis(table[start : start + block], 1, 0), *own)
                sums = _added(sums, [part.sum(axis=0, dtype=np.float64) for part in terms])
            for total, part in zip(totals, sums, strict=True):
                total[mine] = part.reshape(total[mine].shape)
        return totals


def _listed(first: Array, counts: Array) -> Iterator[tuple[Array, Array]]:
    """Owner and number of each row in ranges of rows, some at a time."""
    ends = counts.cumsum()
    starts = ends - counts
    for begin in range(0, int(ends[-1]) if len(ends) else 0, _LISTED):
        number = np.arange(begin, min(begin + _LISTED, int(ends[-1])))
        owner = np.searchsorted(ends, number, side="right")
        yield owner, first[owner] + (number - starts[owner])


class RowByRow(Operations):
    """Sums over tables by a loop that takes one row after the other.

    ``sum_over_some`` and ``sum_over_rule`` are those of :class:`NumpyOperations`.
    """

    gather: Callable[[Any, Any], Values]
    select: Callable[[Any, Any, Any], Any]
    fold: Callable[..., Values]
    """(first, end, state, step) -> the last ``state = step(row, *state)``; ``is_sum``: whether the
    state holds sums, which may have derivatives."""

    def plain_sum(self, first: Any, end: Any, term: Term, values: int) -> Values:
        """:meth:`sum_over_range` for so few terms that rounding of the sum does not matter."""

        def step(row: Any, *sums: Any) -> Values:
            return _added(sums, term(row))

        return self.fold(first, end, (0.0,) * values, step, is_sum=True)

    def sum_over_range(self, first: Any, end: Any, term: Term, values: int) -> Values:
        def visit(row: Any) -> tuple[Any, Values, Values, Term]:
            return True, (), (), lambda _: term(row)

        return self.sum_over_rows(first, end, visit, values, 0)

    def sum_over_some(
        self, first: Any, end: Any, keep: Callable[..., Any], term: Term, values: int, *samples: Any
    ) -> Values:
        return self.sum_over_range(first, end, lambda row: term(row, *samples), values)

    def sum_over_rows(
        self,
        first: Any,
        end: Any,
        visit: Callable[[Any], tuple[Any, Values, Values, Term]],
        values: int,
        levels: int,
    ) -> Values:
        """The sums of ``term(level)`` over rows, each with a level that jumps from row to row.

        ``visit(row)``: whether it begins a new level, the level then, its jump behind the row, and
        the term. In single precision what rounding of the sums loses is summed up as well: of terms
        that cancel, it is the most.
        """

        def step(row: Any, *state: Any) -> Values:
            level, sums, lost = state[:levels], state[levels : levels + values], state[-values:]
            sets, start, jumps, term = visit(row)
            level = tuple(self.select(sets, a, b) for a, b in zip(start, level, strict=True))
            terms = term(level)
            if self.double:
                return *_added(level, jumps), *_added(sums, terms)
            rest = [self._rounded_off(a, b) for a, b in zip(sums, terms, strict=True)]
            return *_added(level, jumps), *_added(sums, terms), *_added(lost, rest)

        count = levels + (1 if self.double else 2) * values
        sums = self.fold(first, end, (0.0,) * count, step, is_sum=True)[levels:]
        return sums if self.double else _added(sums[:values], sums[values:])

    def _rounded_off(self, a: Any, b: Any) -> Any:
        """The rounding error of a + b, exactly (Knuth's sum)."""
        total = a + b
        of_b = total - a
        return (a - (total - of_b)) + (b - of_b)


class ScalarOperations(_Unfused, RowByRow):
    """Python floats: the scalar variants of Mitsuba."""

    target = "scalar"
    double = True
    key = float

    def sum_over(
        self, rows: Sequence[Row], term: Term, values: int, like: Any, *, unroll: bool = True
    ) -> Values:
        """The sums, one by one, of the ``values`` values that ``term(*row)`` gives for each row."""
        return unrolled_sum(rows, term)

    def select(self, condition: Any, a: Any, b: Any) -> Any:
        return a if condition else b

    select_number = select
    exp = staticmethod(math.exp)
    log = staticmethod(math.log)
    atan2 = staticmethod(math.atan2)
    sqrt = staticmethod(math.sqrt)

    def minimum(self, a: Any, b: Any) -> Any:
        return a if a < b else b

    def maximum(self, a: Any, b: Any) -> Any:
        return a if a > b else b

    def round(self, a: Any) -> Any:
        return math.floor(a + 0.5)

    def held(self, table: Table) -> Any:
        return table.tolist()

    def gather(self, table: Any, row: Any) -> Values:
        return tuple(table[row])

    def truncated(self, value: Any) -> Any:
        return int(value)

    def fold(
        self, first: Any, end: Any, state: Values, step: Term, *, is_sum: bool = False
    ) -> Values:
        for row in range(first, end):
            state = step(row, *state)
        return state

    def sum_over_some(
        self, first: Any, end: Any, keep: Callable[..., Any], term: Term, values: int, *samples: Any
    ) -> Values:
        totals: Values = (0.0,) * values
        for row in range(first, end):
            if keep(row, *samples):
                totals = _added(totals, term(row, *samples))
        return totals

    def sum_over_rule(
        self, rule: float, rules: Sequence[Table], term: Term, values: int, *samples: float
    ) -> Values:
        totals: Values = (0.0,) * values
        for row in rules[int(rule)].tolist() if rule >= 0 else ():
            totals = _added(totals, term(*row, *samples))
        return totals
