"""Loops over parts of tables that differ from sample to sample, for Dr.Jit arrays.

What the classes of :mod:`polywigner.execution.ranges` are for other arrays.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np

from polywigner.execution.chunks import array_of
from polywigner.execution.ranges import Table, Values


class DrjitRanges:
    """Ranges for Dr.Jit arrays: loops of the kernel that is being traced."""

    target = "compiled"

    def __init__(self, float_type: Any) -> None:
        import drjit

        self._drjit = drjit
        self.float_type = float_type
        self.key: Hashable = float_type
        """Two namespaces with one key share tables."""
        self._numbers = drjit.uint32_array_t(float_type)

    def count(self, like: Any) -> int:
        """Samples computed at a time: they do not matter to a compiled kernel."""
        return 0

    def held(self, table: Table) -> Any:
        """(entries in a row, the entries of all rows one after the other)."""
        kind = self.float_type if table.dtype.kind == "f" else self._numbers
        return table.shape[1], array_of(kind, table)

    def gather(self, table: Any, row: Any) -> Values:
        width, flat = table
        kind = type(flat)
        if width % 4:
            return tuple(self._drjit.gather(kind, flat, width * row + k) for k in range(width))
        # four entries at a time: one load, where each alone would be another
        four, packets = packet_type(kind), width // 4
        found = (self._drjit.gather(four, flat, packets * row + k) for k in range(packets))
        return tuple(entry for packet in found for entry in packet)

    def truncated(self, value: Any) -> Any:
        return self._numbers(value)

    def select_number(self, condition: Any, a: Any, b: Any) -> Any:
        return self._drjit.select(condition, self._initial(a), self._initial(b))

    def needs_gradient(self, *values: Any) -> bool:
        return any(self._drjit.grad_enabled(value) for value in values)

    def _kind(self, like: Any) -> Any:
        return self.float_type if like is None or isinstance(like, float) else type(like)

    def sum_over_range(
        self, first: Any, end: Any, term: Callable[[Any], Values], values: int, like: Any = None
    ) -> list[Any]:
        if self._drjit.itemsize_v(self.float_type) == 8:
            return self.plain_sum(first, end, term, values, like)

        # what rounding of the sum loses is summed up as well: of terms that cancel, it is the most
        def step(row: Any, *sums: Any) -> Values:
            added = tuple(zip(sums, term(row), strict=False))
            lost = tuple(
                total + self._lost(a, b) for total, (a, b) in zip(sums[values:], added, strict=True)
            )
            return row + 1, *(a + b for a, b in added), *lost

        sums = self._loop(first, end, step, 2 * values, like)
        return [a + b for a, b in zip(sums[:values], sums[values:], strict=True)]

    def sum_over_some(
        self,
        first: Any,
        end: Any,
        keep: Callable[..., Any],
        term: Callable[..., Values],
        values: int,
        *samples: Any,
    ) -> list[Any]:
        return self.sum_over_range(first, end, lambda row: term(row, *samples), values)

    def _lost(self, a: Any, b: Any) -> Any:
        """The rounding error of a + b, exactly (Knuth's sum)."""
        a, b = self._drjit.detach(a), self._drjit.detach(b)
        total = a + b
        of_b = total - a
        return (a - (total - of_b)) + (b - of_b)

    def plain_sum(
        self, first: Any, end: Any, term: Callable[[Any], Values], values: int, like: Any = None
    ) -> list[Any]:
        """:meth:`sum_over_range` for so few terms that rounding of the sum does not matter."""

        def step(row: Any, *sums: Any) -> Values:
            return row + 1, *(a + b for a, b in zip(sums, term(row), strict=True))

        return self._loop(first, end, step, values, like)

    def _loop(
        self, first: Any, end: Any, step: Callable[..., Values], values: int, like: Any
    ) -> list[Any]:
        zeros = (self._kind(like)(0.0) for _ in range(values))
        # max_iterations=-1: a sum, so that its reverse-mode derivative is a sum as well
        _, *totals = self._drjit.while_loop(
            (self._numbers(first), *zeros), lambda row, *_: row < end, step, max_iterations=-1
        )
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
        def of_run(number: Any) -> Values:
            begin, stop, weight, _ = self.gather(runs, number)
            return tuple(self.plain_sum(begin, stop, lambda row: term(row, weight), values, like))

        return self.sum_over_range(first, end, of_run, values, like)

    def sum_over_rows(
        self,
        first: Any,
        end: Any,
        visit: Callable[[Any], tuple[Any, Values, Values, Callable[[Values], Values]]],
        values: int,
        levels: int,
    ) -> list[Any]:
        def step(row: Any, *state: Any) -> Values:
            level, sums, lost = state[:levels], state[levels : levels + values], state[-values:]
            sets, start, jumps, term = visit(row)
            level = tuple(self._drjit.select(sets, a, b) for a, b in zip(start, level, strict=True))
            added = tuple(zip(sums, term(level), strict=True))
            if compensates:
                lost = tuple(a + self._lost(*pair) for a, pair in zip(lost, added, strict=True))
            level = tuple(a + b for a, b in zip(level, jumps, strict=True))
            return row + 1, *level, *(a + b for a, b in added), *(lost if compensates else ())

        # in single precision what rounding of the sums loses is summed up as well
        compensates = self._drjit.itemsize_v(self.float_type) == 4
        count = levels + (2 if compensates else 1) * values
        _, *state = self._drjit.while_loop(
            (self._numbers(first), *(self.float_type(0.0) for _ in range(count))),
            lambda row, *_: row < end,
            step,
            max_iterations=-1,
        )
        sums = state[levels:]
        return [sum(sums[k::values][1:], sums[k]) for k in range(values)]

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

        start = tuple(self._initial(s) for s in state)
        _, *result = self._drjit.while_loop(
            (self._numbers(first), *start), lambda row, *_: row < end, next_row
        )
        return tuple(result)

    def _initial(self, value: Any) -> Any:
        kinds = {float: self.float_type, int: self._numbers}
        return kinds[type(value)](value) if type(value) in kinds else value


def packet_type(kind: Any) -> Any:
    """The type of four values of a type, which a lane computes together or loads at once."""
    return getattr(sys.modules[kind.__module__], _PACKETS[kind.__name__])


_PACKETS = {"Float": "Array4f", "Float64": "Array4f64", "UInt": "Array4u"}
