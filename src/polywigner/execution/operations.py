"""The operations namespaces over which the kernels are written.

A kernel is straight-line code in ``+ - * /``, comparisons, ``abs`` and the methods here. The same
lines run on NumPy arrays, on Python floats (Mitsuba's scalar variants), and, traced, on Dr.Jit
arrays of any backend.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from polywigner.execution.chunks import array_of
from polywigner.execution.drjit_ranges import DrjitRanges
from polywigner.execution.ranges import NumpyRanges, ScalarRanges
from polywigner.numerics.exact import SPLIT_DOUBLE, SPLIT_SINGLE, accurate_cross, product_error
from polywigner.plans import unrolls_cuts, unrolls_steps, unrolls_terms

# NumPy: calls on short arrays cost more than what they compute.
_FEW_SAMPLES = 256
# Values of a temporary array that stay in the cache of one core.
_BLOCK = 1 << 14

Row = tuple[float, ...]
Values = tuple[Any, ...]


def _unrolled_sum(rows: Sequence[Row], term: Callable[..., Values]) -> Values:
    totals = term(*rows[0])
    for row in rows[1:]:
        totals = tuple(a + b for a, b in zip(totals, term(*row), strict=True))
    return totals


def _repeated(count: int, state: Values, step: Callable[..., Values]) -> Values:
    for number in range(count):
        state = step(number, *state)
    return state


class _Unfused:
    """What types without a fused multiply-add share."""

    double: bool
    round: Any

    def sum_large_terms(
        self, rows: Sequence[Row], term: Callable[..., Values], clips: int
    ) -> Values:
        """Sums of terms of much code, that of so many clips: one after the other."""
        return _unrolled_sum(rows, term)

    def repeated(self, count: int, state: Values, step: Callable[..., Values], _: Any) -> Values:
        """The last ``state = step(number, *state)`` for numbers from 0 up to ``count``."""
        return _repeated(count, state, step)

    def refined(
        self, rough: Any, reach: float, compute: Callable[..., Any], *arguments: Any
    ) -> Any:
        """``compute(*arguments)``, of use where ``|rough| <= reach``; elsewhere its sign is."""
        return compute(*arguments)

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """a b + c, rounded twice."""
        return a * b + c

    def cross(self, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
        """ax by - ay bx to about one ulp of the result."""
        return accurate_cross(ax, ay, bx, by, SPLIT_DOUBLE if self.double else SPLIT_SINGLE)

    def lost(self, a: Any, b: Any, product: Any) -> Any:
        """What ``product``, a b rounded, misses of it, exactly."""
        return product_error(a, b, product, SPLIT_DOUBLE if self.double else SPLIT_SINGLE)

    def snapped(self, a: Any, step: float) -> Any:
        """The nearest multiple of ``step``, a power of two."""
        return self.round(a * (1 / step)) * step


class NumpyOperations(_Unfused, NumpyRanges):
    """NumPy arrays of float64 (``double``) or float32."""

    def __init__(self, double: bool, broadcast_size: int = 0) -> None:
        self.double, self.broadcast_size = double, broadcast_size
        self.dtype = np.dtype(np.float64 if double else np.float32)

    def sum_over(
        self,
        rows: Sequence[Row],
        term: Callable[..., Values],
        values: int,
        like: Any,
        *,
        unroll: bool = True,
    ) -> Values:
        """The sums, one by one, of the ``values`` values that ``term(*row)`` gives for each row.

        Takes as many rows at once, on an axis before that of the samples ``like``, as fit a cache.
        """
        # Of few samples, in float64 throughout: what is constant in a term is not rounded first.
        samples = max(np.size(like), self.broadcast_size)
        table = np.array(rows, np.float64 if samples <= _FEW_SAMPLES else self.dtype)
        axes = (1,) * max(1, np.ndim(like))
        block = max(1, _BLOCK // max(1, samples))
        totals: list[Any] = [0.0] * values
        for start in range(0, len(table), block):
            terms = term(*table[start : start + block].T.reshape(table.shape[1], -1, *axes))
            # in float64: of many rows, one after the other, float32 would lose a digit
            totals = [
                total + part.sum(axis=0, dtype=np.float64)
                for total, part in zip(totals, terms, strict=True)
            ]
        return tuple(np.asarray(total, self.dtype) for total in totals)

    def refined(
        self, rough: Any, reach: float, compute: Callable[..., Any], *arguments: Any
    ) -> Any:
        """``compute(*arguments)`` where ``|rough| <= reach``, ``rough`` elsewhere."""
        shape = np.shape(rough)
        if np.size(rough) <= _FEW_SAMPLES or any(np.shape(a) != shape for a in arguments):
            return compute(*arguments)
        near = np.abs(rough) <= reach
        if near.any():
            rough[near] = compute(*(a[near] for a in arguments))
        return rough

    def lookup(self, table: Sequence[float], index: Any) -> Any:
        """table[index], for whole numbers that are in range, floats or not."""
        return np.asarray(table, self.dtype)[np.asarray(index).astype(np.intp)]

    def select(self, condition: Any, a: Any, b: Any) -> Any:
        return np.where(condition, self._typed(a), self._typed(b))

    def minimum(self, a: Any, b: Any) -> Any:
        return np.minimum(a, b)

    def maximum(self, a: Any, b: Any) -> Any:
        return np.maximum(a, b)

    def round(self, a: Any) -> Any:
        return np.rint(a)

    def exp(self, a: Any) -> Any:
        return np.exp(self._typed(a))

    def log(self, a: Any) -> Any:
        return np.log(a)

    def atan2(self, y: Any, x: Any) -> Any:
        return np.arctan2(y, x)

    def sqrt(self, a: Any) -> Any:
        return np.sqrt(a)

    def _typed(self, value: Any) -> Any:
        # np.where promotes Python floats to float64
        return self.dtype.type(value) if isinstance(value, (int, float)) else value

    def cross(self, ax: Any, ay: Any, bx: Any, by: Any) -> Any:
        return super().cross(*map(self._typed, (ax, ay, bx, by)))

    def lost(self, a: Any, b: Any, product: Any) -> Any:
        return super().lost(self._typed(a), self._typed(b), product)


class ScalarOperations(_Unfused, ScalarRanges):
    """Python floats: the scalar variants of Mitsuba."""

    double = True

    def sum_over(
        self,
        rows: Sequence[Row],
        term: Callable[..., Values],
        values: int,
        like: Any,
        *,
        unroll: bool = True,
    ) -> Values:
        """The sums, one by one, of the ``values`` values that ``term(*row)`` gives for each row."""
        return _unrolled_sum(rows, term)

    def lookup(self, table: Sequence[float], index: Any) -> Any:
        """table[index], for a whole number that is in range, a float or not."""
        return table[int(index)]

    def select(self, condition: Any, a: Any, b: Any) -> Any:
        return a if condition else b

    def minimum(self, a: Any, b: Any) -> Any:
        return a if a < b else b

    def maximum(self, a: Any, b: Any) -> Any:
        return a if a > b else b

    def round(self, a: Any) -> Any:
        return math.floor(a + 0.5)

    def exp(self, a: Any) -> Any:
        return math.exp(a)

    def log(self, a: Any) -> Any:
        return math.log(a)

    def atan2(self, y: Any, x: Any) -> Any:
        return math.atan2(y, x)

    def sqrt(self, a: Any) -> Any:
        return math.sqrt(a)


class DrjitOperations(DrjitRanges):
    """Dr.Jit arrays of one float type, of the LLVM or the CUDA backend."""

    def __init__(self, float_type: Any) -> None:
        import drjit

        super().__init__(float_type)
        self._dr = drjit
        self.double = drjit.itemsize_v(float_type) == 8

    def sum_large_terms(
        self, rows: Sequence[Row], term: Callable[..., Values], clips: int
    ) -> Values:
        """Sums of terms of much code, that of so many clips: a loop if that is too much."""
        if unrolls_cuts(len(rows) * clips):
            return _unrolled_sum(rows, term)
        return self.sum_over(rows, term, len(term(*rows[0])), None, unroll=False)

    def refined(
        self, rough: Any, reach: float, compute: Callable[..., Any], *arguments: Any
    ) -> Any:
        """``compute(*arguments)``, of use where ``|rough| <= reach``; elsewhere its sign is."""
        return compute(*arguments)

    def lookup(self, table: Sequence[float], index: Any) -> Any:
        """table[index], for whole numbers that are in range, floats or not."""
        memory = array_of(self.float_type, table)
        return self._dr.gather(
            self.float_type, memory, self._dr.uint32_array_t(self.float_type)(index)
        )

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
        """The nearest multiple of ``step``, a power of two; the derivative is that of ``a``."""
        return a + self._dr.detach(self._dr.round(a * (1 / step)) * step - a)

    def sum_over(
        self,
        rows: Sequence[Row],
        term: Callable[..., Values],
        values: int,
        like: Any,
        *,
        unroll: bool = True,
    ) -> Values:
        """The sums, one by one, of the ``values`` values that ``term(*row)`` gives for each row.

        Unrolled into the kernel, or beyond some rows a loop of the kernel over a table: it runs
        nearly as fast where a term is long, and compiles at once. ``unroll=False``: a loop for any
        number of rows.
        """
        if unroll and unrolls_terms(len(rows)):
            return _unrolled_sum(rows, term)
        dr, real = self._dr, self.float_type
        columns = [array_of(real, column) for column in zip(*rows, strict=True)]

        def step(index: Any, *sums: Any) -> Values:
            terms = term(*(dr.gather(real, column, index) for column in columns))
            return index + 1, *(a + b for a, b in zip(sums, terms, strict=True))

        start = (dr.uint32_array_t(real)(0), *(real(0.0) for _ in range(values)))
        # max_iterations=-1: a sum, so that its reverse-mode derivative is a sum as well
        _, *totals = dr.while_loop(
            start, lambda index, *_: index < len(rows), step, max_iterations=-1
        )
        return tuple(totals)

    def repeated(self, count: int, state: Values, step: Callable[..., Values], like: Any) -> Values:
        """The last ``state = step(number, *state)`` for numbers from 0 up to ``count``.

        A loop of the kernel for many of them, unless derivatives in ``like`` are wanted: in reverse
        they would need all states.
        """
        if unrolls_steps(count) or self.needs_gradient(like):
            return _repeated(count, state, step)
        return self.fold(0, count, state, step)

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
        """What ``product``, a b rounded, misses of it, exactly."""
        return self.fma(a, b, -product)

    def _typed(self, value: Any) -> Any:
        return self.float_type(value) if isinstance(value, (int, float)) else value


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
