"""The operations namespace of Dr.Jit arrays, traced into a kernel."""

from __future__ import annotations

import sys
from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np

from polywigner.execution.chunks import array_of
from polywigner.execution.operations import (
    Row,
    RowByRow,
    ScalarOperations,
    Table,
    Term,
    Values,
    unrolled_steps,
    unrolled_sum,
)

MOST_TERMS_AS_CODE = 12
"""Terms of a sum that are code of a kernel: each takes some 20 ms to compile."""
# Cuts of all terms that are whole transforms: 256 compile in half a second.
_MOST_CUTS_AS_CODE = 256
# Steps of a recursion of four terms each: 50 compile in 1.5 s, and 1450 in a minute; as a loop they
# compile in 0.3 s and 0.7 s and run as fast.
_MOST_STEPS_AS_CODE = 8


class DrjitOperations(RowByRow):
    """Dr.Jit arrays of one float type, of the LLVM or the CUDA backend."""

    target = "compiled"

    def __init__(self, float_type: Any) -> None:
        import drjit

        self._dr = drjit
        self.float_type = float_type
        self.key: Hashable = float_type
        self.double = drjit.itemsize_v(float_type) == 8
        self._numbers = drjit.uint32_array_t(float_type)

    def sum_over(
        self, rows: Sequence[Row], term: Term, values: int, like: Any, *, unroll: bool = True
    ) -> Values:
        """The sums, one by one, of the ``values`` values that ``term(*row)`` gives for each row.

        Unrolled into the kernel, or beyond some rows a loop of the kernel over a table: it runs
        nearly as fast where a term is long, and compiles at once. ``unroll=False``: a loop for any
        number of rows.
        """
        if unroll and len(rows) <= MOST_TERMS_AS_CODE:
            return unrolled_sum(rows, term)
        dr, real = self._dr, self.float_type
        columns = [array_of(real, column) for column in zip(*rows, strict=True)]

        def of_row(index: Any) -> Values:
            return term(*(dr.gather(real, column, index) for column in columns))

        return self.plain_sum(0, len(rows), of_row, values)

    def sum_large_terms(self, rows: Sequence[Row], term: Term, clips: int) -> Values:
        """Sums of terms of so many clips: a loop where code would take too long."""
        if len(rows) * clips <= _MOST_CUTS_AS_CODE:
            return unrolled_sum(rows, term)
        return self.sum_over(rows, term, len(term(*rows[0])), None, unroll=False)

    def repeated(self, count: int, state: Values, step: Term, like: Any) -> Values:
        """The last ``state = step(number, *state)`` for numbers from 0 up to ``count``.

        A loop of the kernel for many of them, unless derivatives in ``like`` are wanted: in reverse
        they would need all states.
        """
        if count <= _MOST_STEPS_AS_CODE or self.needs_gradient(like):
            return unrolled_steps(count, state, step)
        return self.fold(0, count, state, step)

    def needs_gradient(self, *values: Any) -> bool:
        return any(self._dr.grad_enabled(value) for value in values)

    def lookup(self, table: Sequence[float], index: Any) -> Any:
        """table[index], for whole numbers that are in range, floats or not."""
        memory = array_of(self.float_type, table)
        return self._dr.gather(self.float_type, memory, self._numbers(index))

    def select(self, condition: Any, a: Any, b: Any) -> Any:
        return self._dr.select(condition, self._typed(a), self._typed(b))

    # Comparisons, not dr.minimum: on some LLVM versions that aborts the process.
    def minimum(self, a: Any, b: Any) -> Any:
        a, b = self._typed(a), self._typed(b)
        return self._dr.select(a < b, a, b)

    def maximum(self, a: Any, b: Any) -> Any:
        a, b = self._typed(a), self._typed(b)
        return self._dr.select(a > b, a, b)

    def round(self, a: Any) -> Any:
        return self._dr.round(a)

    def snapped(self, a: Any, step: float) -> Any:
        """The nearest multiple of ``step``, a power of two; differentiates as ``a``."""
        return a + self._dr.detach(self._dr.round(a * (1 / step)) * step - a)

    def exp(self, a: Any) -> Any:
        return self._dr.exp(a)

    def log(self, a: Any) -> Any:
        return self._dr.log(a)

    def atan2(self, y: Any, x: Any) -> Any:
        return self._dr.atan2(y, x)

    def sqrt(self, a: Any) -> Any:
        return self._dr.sqrt(a)

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        return self._dr.fma(self._typed(a), self._typed(b), self._typed(c))

    def cross(self, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
        """ax by - ay bx to 1.5 ulp of the result (Kahan)."""
        ax, ay, bx, by = (self._typed(v) for v in (ax, ay, bx, by))
        product = ay * bx
        error = self._dr.fma(-ay, bx, product)
        return self._dr.fma(ax, by, -product) + error

    def lost(self, a: Any, b: Any, product: Any) -> Any:
        """The rounding error of ``product`` = a b, exactly."""
        return self.fma(a, b, -product)

    def _typed(self, value: Any) -> Any:
        return self.float_type(value) if isinstance(value, (int, float)) else value

    def held(self, table: Table) -> Any:
        """(entries in a row, the entries of all rows one after the other)."""
        kind = self.float_type if table.dtype.kind == "f" else self._numbers
        return table.shape[1], array_of(kind, table)

    def gather(self, table: Any, row: Any) -> Values:
        width, flat = table
        kind = type(flat)
        if width % 4:
            return tuple(self._dr.gather(kind, flat, width * row + k) for k in range(width))
        # four entries at a time: one load, where each alone would be another
        four, packets = getattr(sys.modules[kind.__module__], _PACKETS[kind.__name__]), width // 4
        found = (self._dr.gather(four, flat, packets * row + k) for k in range(packets))
        return tuple(entry for packet in found for entry in packet)

    def truncated(self, value: Any) -> Any:
        return self._numbers(value)

    def select_number(self, condition: Any, a: Any, b: Any) -> Any:
        return self._dr.select(condition, self._initial(a), self._initial(b))

    def fold(
        self, first: Any, end: Any, state: Values, step: Term, *, is_sum: bool = False
    ) -> Values:
        def next_row(row: Any, *state: Any) -> Values:
            return row + 1, *step(row, *state)

        # max_iterations=-1: of a sum the reverse-mode derivative is a sum as well
        options = {"max_iterations": -1} if is_sum else {}
        start = (self._numbers(first), *map(self._initial, state))
        _, *result = self._dr.while_loop(start, lambda row, *_: row < end, next_row, **options)
        return tuple(result)

    def _initial(self, value: Any) -> Any:
        kinds = {float: self.float_type, int: self._numbers}
        return kinds[type(value)](value) if type(value) in kinds else value

    def _rounded_off(self, a: Any, b: Any) -> Any:
        return super()._rounded_off(self._dr.detach(a), self._dr.detach(b))

    def sum_over_rule(
        self, rule: Any, rules: Sequence[Table], term: Term, values: int, *samples: Any
    ) -> Values:
        ends = np.cumsum([len(table) for table in rules])
        starts = ends - [len(table) for table in rules]
        ranges = np.stack([np.append(0, starts), np.append(0, ends)], axis=1)
        first, end = self.gather(self.held(ranges), self.truncated(rule + 1.0))
        table = self.held(np.concatenate(rules))
        return self.sum_over_range(
            first, end, lambda row: term(*self.gather(table, row), *samples), values
        )


# Types of four values that a lane loads at once.
_PACKETS = {"Float": "Array4f", "Float64": "Array4f64", "UInt": "Array4u"}


class TracedOperations(DrjitOperations):
    """Edges are rows of tables, and never code."""

    target = "data"

    def sum_over(self, rows: Any, term: Any, values: int, like: Any, *, unroll: bool = True) -> Any:
        return super().sum_over(rows, term, values, like, unroll=False)


class UnrolledOperations(DrjitOperations):
    """Terms of a sum are code, however many: where each has arrays of its own."""

    def sum_over(self, rows: Any, term: Any, values: int, like: Any, *, unroll: bool = True) -> Any:
        if unroll:
            return self.sum_large_terms(rows, term, 0)
        return super().sum_over(rows, term, values, like, unroll=False)


def ops_for(float_type: Any) -> Any:
    """The operations of a float type: ``float``, or a Dr.Jit type such as ``mi.Float``."""
    return ScalarOperations() if float_type is float else DrjitOperations(float_type)
