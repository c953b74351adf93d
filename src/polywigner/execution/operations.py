"""Operations of kernels on NumPy arrays and Python floats.

A kernel uses ``+ - * /``, comparisons, ``abs``, and the methods of an operations object. The same
kernel runs on NumPy arrays, on Python floats for Mitsuba's scalar variants, and on Dr.Jit arrays of
any backend (module `drjit_operations`).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from polywigner.numerics.grid_arithmetic import accurate_cross, product_error

# Number of values in a temporary array that fits into the cache of a core.
_BLOCK = 1 << 14
# Largest number of table rows listed at once, before rows that do not contribute are removed.
_LISTED = 1 << 17

Numbers: TypeAlias = Any
"""Numbers that a kernel can process: NumPy arrays, Python floats or Dr.Jit arrays."""
Drjit: TypeAlias = Any
"""A Dr.Jit array of any variant of Mitsuba, or a Python number or vector in scalar variants."""


def is_drjit(value: object) -> bool:
    """Return whether a value is a Dr.Jit array, without importing Dr.Jit."""
    return has_drjit((value,))


def has_drjit(values: Iterable[object]) -> bool:
    """Return whether any of the values is a Dr.Jit array."""
    # While another thread imports Dr.Jit, the module may lack names.
    is_array = getattr(sys.modules.get("drjit"), "is_array_v", None)
    return is_array is not None and any(map(is_array, values))


Array = npt.NDArray[Any]
Table = npt.NDArray[Any]
Row = tuple[float, ...]
Values = tuple[Any, ...]
Term = Callable[..., Values]


def unrolled_sum(rows: Sequence[Row], term: Term) -> Values:
    """Return the sums of ``term(*row)`` over one or more rows, row by row."""
    totals = term(*rows[0])
    for row in rows[1:]:
        totals = _sums(totals, term(*row))
    return totals


def unrolled_steps(count: int, state: Values, step: Term) -> Values:
    """Return the state after ``count`` steps ``state = step(number, *state)``, from number 0."""
    for number in range(count):
        state = step(number, *state)
    return state


def _sums(a: Sequence[Any], b: Sequence[Any]) -> Values:
    """Return the sums of corresponding entries of two sequences."""
    return tuple(p + q for p, q in zip(a, b, strict=True))


class Operations:
    """Attributes and methods of all operations classes."""

    target: str
    double: bool
    key: Hashable
    """Key of tables in the memory of an engine. Operations with equal keys share the tables."""

    def needs_gradient(self, *values: Any) -> bool:
        """Return False, because only Dr.Jit arrays take part in automatic differentiation."""
        return False

    def first(self, value: Any) -> Any:
        """Return the first of the samples that are computed together."""
        return value


class _Unfused(Operations):
    double = True
    round: Any
    cross = staticmethod(accurate_cross)
    lost = staticmethod(product_error)

    def sum_large_terms(self, rows: Sequence[Row], term: Term, clips: int) -> Values:
        """Return the sums of ``term(*row)`` over all rows; ``clips`` has no effect."""
        return unrolled_sum(rows, term)

    def repeated(self, count: int, state: Values, step: Term, _: Any) -> Values:
        """Return the state after ``count`` steps ``state = step(number, *state)``."""
        return unrolled_steps(count, state, step)

    def fma(self, a: Any, b: Any, c: Any) -> Numbers:
        """Return a b + c, rounded twice."""
        return a * b + c

    def snapped(self, a: Any, step: float) -> Numbers:
        """Return ``a`` rounded to a multiple of ``step``, a power of two."""
        return self.round(a * (1 / step)) * step


class NumpyOperations(_Unfused):
    """Operations on NumPy arrays of float64."""

    target = "numpy"
    key = "numpy"

    def sum_over(
        self, rows: Sequence[Row], term: Term, values: int, like: Any, *, unroll: bool = True
    ) -> Values:
        """Return the sums of ``term(*row)`` over all rows.

        Rows are evaluated along an additional first axis, in blocks that fit into the cache.
        ``like`` has the shape of the samples, and ``values`` is the number of results of ``term``.
        """
        table, axes = np.array(rows, np.float64), (1,) * max(1, np.ndim(like))
        block = max(1, _BLOCK // max(1, int(np.size(like))))
        totals: Values = (0.0,) * values
        for start in range(0, len(table), block):
            terms = term(*table[start : start + block].T.reshape(table.shape[1], -1, *axes))
            totals = _sums(totals, [part.sum(axis=0) for part in terms])
        return tuple(np.asarray(total) for total in totals)

    select = staticmethod(np.where)
    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)
    round = staticmethod(np.rint)
    log = staticmethod(np.log)
    atan2 = staticmethod(np.arctan2)
    sqrt = staticmethod(np.sqrt)
    exp = staticmethod(np.exp)

    def on_device(self, table: Table) -> Numbers:
        """Return a copy of a table in the memory layout that :meth:`gather` requires."""
        # Contiguous columns stay in the processor's cache.
        return table.astype(np.float64 if table.dtype.kind == "f" else np.int64, order="F")

    def gather(self, table: Any, row: Any) -> Values:
        """Return the entries of one row of a table."""
        return tuple(table[:, k].take(row) for k in range(table.shape[1]))

    def truncated(self, value: Any) -> Numbers:
        """Return row indices from nonnegative floats."""
        return np.asarray(value).astype(np.int64)

    def sum_over_some(
        self, first: Any, end: Any, keep: Callable[..., Any], term: Term, values: int, *samples: Any
    ) -> list[Any]:
        """Return the sums of ``term(row, *samples)`` over row indices ``first`` to ``end`` - 1.

        Each sample may have its own ``first`` and ``end``. Rows for which ``keep(row, *samples)``
        is false are skipped, because their ``term`` is 0.
        """
        shape = np.broadcast_shapes(np.shape(first), *map(np.shape, samples)) or (1,)
        count = math.prod(shape)
        begin, stop = (np.broadcast_to(a, shape).ravel() for a in (first, end))
        flat = [np.ravel(a if np.size(a) == 1 else np.broadcast_to(a, shape)) for a in samples]
        totals = [np.zeros(count) for _ in range(values)]

        def of(owner: Array) -> list[Array]:
            """Return the samples to which the listed rows belong."""
            return [a[owner] if len(a) == count else a for a in flat]

        for owner, row in _row_blocks(begin, stop - begin):
            (chosen,) = np.nonzero(keep(row, *of(owner)))
            for part in (chosen[k : k + _BLOCK] for k in range(0, len(chosen), _BLOCK)):
                terms = term(row[part], *of(owner[part]))
                for total, values_of_term in zip(totals, terms, strict=True):
                    np.add.at(total, owner[part], values_of_term)
        return [total.reshape(shape) for total in totals]

    def sum_over_rule(
        self, rule: Any, rules: Sequence[Table], term: Term, values: int, *samples: Any
    ) -> list[Any]:
        """Return the sums of ``term(*row, *samples)`` over the table ``rules[rule]``.

        The index -1 gives a sum of 0.
        """
        rule, *arrays = np.broadcast_arrays(rule, *samples)
        totals = [np.zeros(rule.shape) for _ in range(values)]
        for number in np.unique(rule[rule >= 0]):
            chosen = ... if (rule == number).all() else rule == number
            flat = [array[chosen].ravel() for array in arrays]
            table = rules[int(number)][..., None]
            count = rule[chosen].size
            sums: Values = (np.zeros(count),) * values
            block = max(1, _BLOCK // max(1, count))
            for start in range(0, len(table), block):
                terms = term(*np.moveaxis(table[start : start + block], 1, 0), *flat)
                sums = _sums(sums, [part.sum(axis=0) for part in terms])
            for total, part in zip(totals, sums, strict=True):
                total[chosen] = part.reshape(total[chosen].shape)
        return totals


def _row_blocks(first: Array, counts: Array) -> Iterator[tuple[Array, Array]]:
    """Yield blocks of samples and their rows. Sample k has ``counts[k]`` rows from ``first[k]``."""
    ends = counts.cumsum()
    starts = ends - counts
    for begin in range(0, int(ends[-1]) if len(ends) else 0, _LISTED):
        number = np.arange(begin, min(begin + _LISTED, int(ends[-1])))
        owner = np.searchsorted(ends, number, side="right")
        yield owner, first[owner] + (number - starts[owner])


class RowByRow(Operations):
    """Operations that sum over tables in a loop over rows."""

    gather: Callable[[Any, Any], Values]
    select: Callable[[Any, Any, Any], Any]
    fold: Callable[..., Values]
    """Function (first, end, state, step) that repeats ``state = step(row, *state)`` for all rows
    and returns the final state. With ``is_sum``, the state consists of sums, which may have
    derivatives."""

    # dr.minimum and dr.maximum are not used, because they abort the process with some versions of
    # LLVM.
    def minimum(self, a: Any, b: Any) -> Numbers:
        """Return the smaller of two values."""
        return self.select(a < b, a, b)

    def maximum(self, a: Any, b: Any) -> Numbers:
        """Return the larger of two values."""
        return self.select(a > b, a, b)

    def plain_sum(self, first: Any, end: Any, term: Term, values: int) -> Values:
        """Return the uncompensated sums of ``term(row)`` over rows ``first`` to ``end`` - 1."""

        def step(row: Any, *sums: Any) -> Values:
            """Return the sums after a row."""
            return _sums(sums, term(row))

        return self.fold(first, end, (0.0,) * values, step, is_sum=True)

    def sum_over_range(self, first: Any, end: Any, term: Term, values: int) -> Values:
        """Return the sums of ``term(row)`` over rows ``first`` to ``end`` - 1.

        The sums are compensated in single precision.
        """

        def visit(row: Any) -> tuple[Any, Values, Values, Term]:
            """Return a term that does not depend on a level."""
            return True, (), (), lambda _: term(row)

        return self.sum_over_rows(first, end, visit, values, 0)

    def sum_over_some(
        self, first: Any, end: Any, keep: Callable[..., Any], term: Term, values: int, *samples: Any
    ) -> Values:
        """Return the sums of ``term(row, *samples)`` over a range of rows.

        ``keep`` is not called, because terms of rows that it excludes are 0.
        """
        return self.sum_over_range(first, end, lambda row: term(row, *samples), values)

    def sum_over_rows(
        self,
        first: Any,
        end: Any,
        visit: Callable[[Any], tuple[Any, Values, Values, Term]],
        values: int,
        levels: int,
    ) -> Values:
        """Return the sums of ``term(level)`` over rows, where the level changes from row to row.

        The level starts at 0. ``visit(row)`` returns a flag, a level, a change and ``term``. If the
        flag is true, the returned level becomes the current level before the term is computed. The
        change is added to the level afterwards. ``levels`` and ``values`` are the numbers of levels
        and of sums. In single precision the sums are compensated, because terms may cancel.
        """

        def step(row: Any, *state: Any) -> Values:
            """Return the level, the sums and their rounding errors after a row."""
            level, sums, lost = state[:levels], state[levels : levels + values], state[-values:]
            sets, start, jumps, term = visit(row)
            level = tuple(self.select(sets, a, b) for a, b in zip(start, level, strict=True))
            terms = term(level)
            if self.double:
                return *_sums(level, jumps), *_sums(sums, terms)
            errors = [self._rounded_off(a, b) for a, b in zip(sums, terms, strict=True)]
            return *_sums(level, jumps), *_sums(sums, terms), *_sums(lost, errors)

        count = levels + (1 if self.double else 2) * values
        sums = self.fold(first, end, (0.0,) * count, step, is_sum=True)[levels:]
        return sums if self.double else _sums(sums[:values], sums[values:])

    def _rounded_off(self, a: Any, b: Any) -> Numbers:
        """Return the exact sum a + b minus the rounded sum (Knuth)."""
        total = a + b
        of_b = total - a
        return (a - (total - of_b)) + (b - of_b)


class ScalarOperations(_Unfused, RowByRow):
    """Operations on Python floats, for the scalar variants of Mitsuba."""

    target = "scalar"
    key = float

    def sum_over(
        self, rows: Sequence[Row], term: Term, values: int, like: Any, *, unroll: bool = True
    ) -> Values:
        """Return the sums of ``term(*row)`` over one or more rows."""
        return unrolled_sum(rows, term)

    def select(self, condition: Any, a: Any, b: Any) -> Numbers:
        """Return ``a`` if the condition is true, otherwise ``b``."""
        return a if condition else b

    exp = staticmethod(math.exp)
    log = staticmethod(math.log)
    atan2 = staticmethod(math.atan2)
    sqrt = staticmethod(math.sqrt)

    def round(self, a: Any) -> Numbers:
        """Return the nearest integer. Values midway between two integers are rounded up."""
        return math.floor(a + 0.5)

    def on_device(self, table: Table) -> Numbers:
        """Return a table as nested lists."""
        return table.tolist()

    def gather(self, table: Any, row: Any) -> Values:
        """Return the entries of one row of a table."""
        return tuple(table[row])

    def truncated(self, value: Any) -> Numbers:
        """Return a row index from a nonnegative float."""
        return int(value)

    def fold(
        self, first: Any, end: Any, state: Values, step: Term, *, is_sum: bool = False
    ) -> Values:
        """Apply ``state = step(row, *state)`` to all rows, and return the final state.

        The rows are ``first`` to ``end`` - 1.
        """
        for row in range(first, end):
            state = step(row, *state)
        return state

    def sum_over_rule(
        self, rule: float, rules: Sequence[Table], term: Term, values: int, *samples: float
    ) -> Values:
        """Return the sums of ``term(*row, *samples)`` over the table ``rules[rule]``.

        The index -1 gives a sum of 0.
        """
        totals: Values = (0.0,) * values
        for row in rules[int(rule)].tolist() if rule >= 0 else ():
            totals = _sums(totals, term(*row, *samples))
        return totals
