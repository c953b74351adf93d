"""Operations of kernels on Dr.Jit arrays."""

from __future__ import annotations

import sys
from collections.abc import Hashable, Sequence
from copy import copy
from typing import Any

import numpy as np

from polywigner.execution.chunks import array_of
from polywigner.execution.operations import (
    Drjit,
    Row,
    RowByRow,
    ScalarOperations,
    Table,
    Term,
    Values,
    unrolled_steps,
    unrolled_sum,
)

LANE = 4
"""Number of samples of one cell that a vector lane computes together."""
MOST_TERMS_AS_CODE = 12
"""Largest number of terms of an unrolled sum. Each term takes about 20 ms to compile."""
# Largest number of clipped edges for which `sum_large_terms` is unrolled. Code with 256 clipped
# edges compiles in 0.5 s.
_MOST_CUTS_AS_CODE = 256
# Largest number of unrolled recursion steps. With four terms per step, unrolled code of 50 steps
# compiles in 1.5 s, and of 1,450 steps in a minute. A loop takes 0.3 s and 0.7 s, respectively.
_MOST_STEPS_AS_CODE = 8


class DrjitOperations(RowByRow):
    """Operations on Dr.Jit arrays of one float type, for the LLVM or the CUDA backend.

    ``target`` is "compiled", or "data" if edges must be read from memory. ``most_as_code`` is the
    largest number of unrolled terms.
    """

    def __init__(
        self, float_type: Any, target: str = "compiled", most_as_code: float = MOST_TERMS_AS_CODE
    ) -> None:
        import drjit

        self._dr = drjit
        self.round, self.exp, self.log = drjit.round, drjit.exp, drjit.log
        self.atan2, self.sqrt = drjit.atan2, drjit.sqrt
        self.target, self.most_as_code = target, 0 if target == "data" else most_as_code
        self.float_type = self.value_type = float_type
        self.key: Hashable = float_type
        self.double = drjit.itemsize_v(float_type) == 8
        self._numbers = drjit.uint32_array_t(float_type)

    def sum_over(
        self, rows: Sequence[Row], term: Term, values: int, like: Any, *, unroll: bool = True
    ) -> Values:
        """Return the sums of ``term(*row)`` over one or more rows.

        ``values`` is the number of results of ``term``. Short sums are unrolled. Loops compile in
        less time than unrolled sums, and are nearly as fast if the terms are long. With
        ``unroll=False``, the kernel always contains a loop.
        """
        if unroll and len(rows) <= self.most_as_code:
            return unrolled_sum(rows, term)
        dr, real = self._dr, self.float_type
        columns = [array_of(real, column) for column in zip(*rows, strict=True)]

        def of_row(index: Any) -> Values:
            """Return the term of the row at an index."""
            return term(*(dr.gather(real, column, index) for column in columns))

        return self.plain_sum(0, len(rows), of_row, values)

    def sum_large_terms(self, rows: Sequence[Row], term: Term, clips: int) -> Values:
        """Return the sums of ``term(*row)`` over all rows, unrolled if compilation is fast.

        ``clips`` is the number of clipped edges in each term.
        """
        if len(rows) * clips <= _MOST_CUTS_AS_CODE:
            return unrolled_sum(rows, term)
        return self.sum_over(rows, term, len(term(*rows[0])), None, unroll=False)

    def repeated(self, count: int, state: Values, step: Term, like: Any) -> Values:
        """Return the state after ``count`` steps ``state = step(number, *state)``.

        The number starts at 0. Steps are unrolled if ``like`` has derivatives, because reverse mode
        would store all states of a loop.
        """
        if count <= _MOST_STEPS_AS_CODE or self.needs_gradient(like):
            return unrolled_steps(count, state, step)
        return self.fold(0, count, state, step)

    def needs_gradient(self, *values: Any) -> bool:
        """Return whether any value takes part in automatic differentiation."""
        return any(self._dr.grad_enabled(value) for value in values)

    def for_lanes(self, *values: Any) -> DrjitOperations:
        """Return operations for the samples ``values``, whose entries may be arrays of four.

        With arrays of four, a lane computes four samples, and reads each row of a table only once.
        """
        ops = copy(self)
        ops.value_type = max(map(type, values), key=self._dr.depth_v)
        return ops

    def in_lanes(self, values: Table) -> Drjit:
        """Return samples as a Dr.Jit array.

        Samples of shape (n,) become floats. Samples of shape (4, m) become m arrays of four, one
        for each lane.
        """
        if values.ndim < 2:
            return array_of(self.float_type, values)
        return four_of(self.float_type)(*(array_of(self.float_type, row) for row in values))

    def first(self, value: Any) -> Drjit:
        """Return the first of four samples, or the only sample."""
        return value[0] if self._dr.depth_v(value) > 1 else value

    def lookup(self, table: Sequence[float], index: Any) -> Drjit:
        """Return table[index] for valid indices. Indices may be floats, which are truncated."""
        memory = array_of(self.float_type, table)
        return self._dr.gather(self.float_type, memory, self._numbers(index))

    def select(self, condition: Any, a: Any, b: Any) -> Drjit:
        """Return ``a`` where the condition is true, and ``b`` elsewhere."""
        return self._dr.select(condition, self._typed(a), self._typed(b))

    def snapped(self, a: Any, step: float) -> Drjit:
        """Return ``a`` rounded to a multiple of ``step``; the derivative is that of ``a``."""
        return a + self._dr.detach(self._dr.round(a * (1 / step)) * step - a)

    def fma(self, a: Any, b: Any, c: Any) -> Drjit:
        """Return a b + c, rounded once."""
        return self._dr.fma(self._typed(a), self._typed(b), self._typed(c))

    def cross(self, ax: Any, ay: Any, bx: Any, by: Any) -> Drjit:
        """Return the cross product ax by - ay bx with an error of at most 1.5 ulp (Kahan)."""
        ax, ay, bx, by = (self._typed(v) for v in (ax, ay, bx, by))
        product = ay * bx
        error = self._dr.fma(-ay, bx, product)
        return self._dr.fma(ax, by, -product) + error

    def lost(self, a: Any, b: Any, product: Any) -> Drjit:
        """Return the exact product of a and b minus the rounded ``product``."""
        return self.fma(a, b, -product)

    def _typed(self, value: Any) -> Drjit:
        """Return a Python number as a Dr.Jit float, and an array unchanged."""
        return self.float_type(value) if isinstance(value, (int, float)) else value

    def on_device(self, table: Table) -> Drjit:
        """Copy a table to the memory of the engine; return its row length and its entries."""
        kind = self.float_type if table.dtype.kind == "f" else self._numbers
        return table.shape[1], array_of(kind, table)

    def gather(self, table: Any, row: Any) -> Values:
        """Return the entries of one row of a table, read in packets of four if possible."""
        width, flat = table
        kind = type(flat)
        if width % 4:
            return tuple(self._dr.gather(kind, flat, width * row + k) for k in range(width))
        packets = width // 4
        loaded = (self._dr.gather(four_of(kind), flat, packets * row + k) for k in range(packets))
        return tuple(entry for packet in loaded for entry in packet)

    def truncated(self, value: Any) -> Drjit:
        """Return row indices from nonnegative floats."""
        return self._numbers(value)

    def fold(
        self, first: Any, end: Any, state: Values, step: Term, *, is_sum: bool = False
    ) -> Values:
        """Apply ``state = step(row, *state)`` to a range of rows, and return the final state.

        The rows are ``first`` to ``end`` - 1. If ``is_sum`` is true, the state consists of sums,
        which may have derivatives.
        """

        def next_row(row: Any, *state: Any) -> Values:
            """Return the next row index and the state after a row."""
            return row + 1, *step(row, *state)

        # With max_iterations=-1, Dr.Jit assumes that the loop only adds terms, so reverse mode
        # stores no states.
        options = {"max_iterations": -1} if is_sum else {}
        start = (self._numbers(first), *map(self._initial, state))
        _, *result = self._dr.while_loop(start, lambda row, *_: row < end, next_row, **options)
        return tuple(result)

    def _initial(self, value: Any) -> Drjit:
        """Convert a float to a Dr.Jit value, or an int to row indices; keep other values."""
        kinds = {float: self.value_type, int: self._numbers}
        return kinds[type(value)](value) if type(value) in kinds else value

    def _rounded_off(self, a: Any, b: Any) -> Drjit:
        """Return the exact sum a + b minus the rounded sum, as a constant."""
        return super()._rounded_off(self._dr.detach(a), self._dr.detach(b))

    def sum_over_rule(
        self, rule: Any, rules: Sequence[Table], term: Term, values: int, *samples: Any
    ) -> Values:
        """Return the sums of ``term(*row, *samples)`` over the table ``rules[rule]``.

        ``rule`` contains indices as floats. The index -1 gives a sum of 0.
        """
        ends = np.cumsum([len(table) for table in rules])
        starts = ends - [len(table) for table in rules]
        ranges = np.stack([np.append(0, starts), np.append(0, ends)], axis=1)
        first, end = self.gather(self.on_device(ranges), self.truncated(rule + 1.0))
        table = self.on_device(np.concatenate(rules))
        return self.sum_over_range(
            first, end, lambda row: term(*self.gather(table, row), *samples), values
        )


def four_of(kind: type) -> Any:
    """Return Dr.Jit's type for arrays of four entries, which a single instruction loads."""
    names = {"Float": "Array4f", "Float64": "Array4f64", "UInt": "Array4u"}
    return getattr(sys.modules[kind.__module__], names[kind.__name__])


def ops_for(float_type: type) -> Any:
    """Return the operations on Python floats, or on arrays of a Dr.Jit float type."""
    return ScalarOperations() if float_type is float else DrjitOperations(float_type)
