"""Accumulators of derivatives in vertices and fields: forward into a change, in reverse over all
samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from polywigner.execution.operations import DrjitOperations
from polywigner.kernels.slopes.slopes import Wanted
from polywigner.numerics.complex_pairs import Pair

__all__ = ["ForwardAccumulator", "ReverseAccumulator", "contracted", "reverse_accumulator"]


def contracted(cotangent: Pair, slope: Pair) -> Any:
    """Re(cotangent* slope), for literal zeros as well."""
    total: Any = 0.0
    for weight, part in ((cotangent.real, slope.real), (cotangent.imag, slope.imag)):
        if not isinstance(weight, float) and not isinstance(part, float):
            total = total + weight * part
    return total


def _index(ops: DrjitOperations, number: Any) -> Any:
    import drjit as dr

    kind = dr.uint32_array_t(ops.float_type)
    return kind(number) if isinstance(number, (int, float)) else ops.truncated(number)


class ForwardAccumulator:
    """Sums up the derivative for given changes of vertices and fields."""

    values = 2

    def __init__(self, ops: DrjitOperations, wanted: Wanted, vertices: Any, fields: Any) -> None:
        self.ops, self.wanted, self.vertices, self.fields = ops, wanted, vertices, fields

    def edge(self, begin: Any, end: Any, normal: tuple[Any, Any], at: tuple[Pair, Pair]) -> Any:
        total = Pair(0.0, 0.0)
        for number, slope in zip((begin, end), at, strict=True):
            x, y = self._gathered(self.vertices, number)
            total = total + slope.scaled(normal[0] * x + normal[1] * y)
        return total.real, total.imag

    def field(self, number: Any, slope: Pair, of_conjugate: Pair) -> Any:
        x, y = self._gathered(self.fields, number)
        total = slope * Pair(x, y) + of_conjugate * Pair(x, -y)
        return total.real, total.imag

    def _gathered(self, pair: Any, number: Any) -> tuple[Any, Any]:
        import drjit as dr

        if isinstance(pair[0], tuple):
            return pair[0][int(number)], pair[1][int(number)]
        index = _index(self.ops, number)
        x, y = (dr.gather(self.ops.float_type, values, index) for values in pair)
        return x, y


class ReverseAccumulator:
    """Adds up gradients with respect to vertices and fields over all samples."""

    values = 0
    cotangent: Pair
    """The gradient in each sample's value."""

    def __init__(self, ops: DrjitOperations, wanted: Wanted, vertices: int, fields: int) -> None:
        self.ops, self.wanted = ops, wanted
        self.counts = vertices, fields
        self.targets = [self._zeros(count) for count in self.counts for _ in range(2)]
        self.waiting: dict[tuple[int, int], Any] = {}

    @property
    def vertices(self) -> Sequence[Any]:
        """The gradient in x and in y."""
        return self.targets[:2]

    @property
    def fields(self) -> Sequence[Any]:
        """The gradient in real and in imaginary parts."""
        return self.targets[2:]

    def edge(self, begin: Any, end: Any, normal: tuple[Any, Any], at: tuple[Pair, Pair]) -> Any:
        for number, slope in zip((begin, end), at, strict=True):
            value = contracted(self.cotangent, slope)
            for axis, component in enumerate(normal):
                self._add(axis, number, value * component)
        return ()

    def field(self, number: Any, slope: Pair, of_conjugate: Pair) -> Any:
        total, turned = slope + of_conjugate, slope - of_conjugate
        self._add(2, number, contracted(self.cotangent, total))
        self._add(3, number, contracted(self.cotangent, Pair(-turned.imag, turned.real)))
        return ()

    def flush(self) -> None:
        """Add what could wait, as its edges were not rows of a table."""
        for (slot, number), value in self.waiting.items():
            self._put(slot, number, value)
        self.waiting.clear()

    def _zeros(self, count: int) -> Any:
        import drjit as dr

        return dr.zeros(self.ops.float_type, count)

    def _add(self, slot: int, number: Any, value: Any) -> None:
        if self._may_wait(number):
            key = slot, int(number)
            self.waiting[key] = self.waiting.get(key, 0.0) + value
        else:
            self._put(slot, number, value)

    def _may_wait(self, number: Any) -> bool:
        import drjit as dr

        # What a loop computes does not exist after it.
        return isinstance(number, int | float) and not dr.flag(dr.JitFlag.SymbolicScope)

    def _put(self, slot: int, number: Any, value: Any) -> None:
        import drjit as dr

        value = self.ops.float_type(value)
        index = _index(self.ops, number)
        dr.scatter_reduce(dr.ReduceOp.Add, self.targets[slot], value, index)


class _ReverseByLanes(ReverseAccumulator):
    """Gradients where each number is an array of its own, and Dr.Jit adds them up."""

    def _zeros(self, count: int) -> Any:
        return tuple(self.ops.float_type(0.0) for _ in range(count))

    def _may_wait(self, number: Any) -> bool:
        return True

    def _put(self, slot: int, number: Any, value: Any) -> None:
        found = list(self.targets[slot])
        found[number] = self.ops.float_type(value)
        self.targets[slot] = tuple(found)


def reverse_accumulator(
    ops: DrjitOperations, wanted: Wanted, vertices: Any, fields: Any
) -> ReverseAccumulator:
    """An accumulator for arrays of these numbers, or for tuples of arrays, as far as wanted."""
    import drjit as dr

    pairs = vertices if wanted.vertices else None, fields if wanted.fields else None
    if any(pair is not None and isinstance(pair[0], tuple) for pair in pairs):
        counts = [0 if pair is None else len(pair[0]) for pair in pairs]
        return _ReverseByLanes(ops, wanted, *counts)
    counts = [0 if pair is None else dr.width(pair[0]) for pair in pairs]
    return ReverseAccumulator(ops, wanted, *counts)
