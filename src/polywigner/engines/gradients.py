"""Kernels as custom operations of Dr.Jit, with the derivatives of ``kernels.slopes``.

To let Dr.Jit differentiate through the cuts would cost some thirty times the kernel itself, and be
wrong where a cut is the last of several. Here a kernel's sum over edges is one operation: forward
and in reverse it runs another kernel with the closed form of the derivative. The way into the frame
belongs to it, lest gradients be stored in the frame first; the way out is Dr.Jit's to differentiate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from polywigner.engines.operations import DrjitOperations, ScalarOperations
from polywigner.engines.parameters import Traced
from polywigner.kernels import Kernel
from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.differentiable import SlopeKernel, slope_kernel_of
from polywigner.kernels.slopes import Wanted

__all__ = ["differentiable"]


def differentiable(
    kernel: Kernel, ops: DrjitOperations, tables: Any, components: Sequence[Any], traced: Traced
) -> tuple[Any, ...]:
    """The results of a kernel, with derivatives in its arguments and in what is ``traced``."""
    import drjit as dr

    slopes = slope_kernel_of(kernel)
    shared = (traced.vertices, traced.fields)
    if slopes is None or not dr.grad_enabled((tuple(components), shared)):
        return kernel(ops, tables, *components)
    inner = kernel.enter(ops, tables.frame, *components)
    typed = tuple(ops.float_type(value) for value in components)
    operation = _operation(kernel, ops, tables, dr.detach(inner), slopes, traced, typed)
    sums = dr.custom(operation, typed, traced.vertices, traced.fields)
    return kernel.leave(ops, tables.frame, inner, sums)


def _operation(
    kernel: Kernel,
    ops: DrjitOperations,
    tables: Any,
    inner: Sequence[Any],
    slopes: SlopeKernel,
    traced: Traced,
    components: Sequence[Any],
) -> Any:
    import drjit as dr

    real, frame = ops.float_type, tables.frame
    needed = [dr.grad_enabled(value) for value in components]
    summed = tuple(real(value) for value in inner[len(inner) - slopes.arguments :])

    class EdgeSum(dr.CustomOp):
        """The sum over the edges of one kernel and source."""

        def eval(self, components: Any, vertices: Any, fields: Any) -> Any:
            self.vertices, self.fields = vertices, fields
            return tuple(real(value) for value in kernel.edge_sum(ops, tables, *inner))

        def forward(self) -> None:
            names = ("components", "vertices", "fields")
            of_components, *of_shared = (self.grad_in(name) for name in names)
            sink = _Forward(ops, *of_shared)
            found = slopes.slopes(ops, tables, self._wanted(), sink, *summed)
            total = Pair(found.shared[0], found.shared[1])
            changes = slopes.entered(ops, frame, of_components)
            for slope, change in zip((*found.frequency, *found.place), changes, strict=False):
                total = total + slope.scaled(change)
            self.set_grad_out(tuple(map(real, slopes.parts(total))))

        def backward(self) -> None:
            out = self.grad_out()
            cotangent = slopes.cotangent(out)
            sink = _reverse_of(ops, cotangent, self.vertices, self.fields)
            found = slopes.slopes(ops, tables, self._wanted(), sink, *summed)
            sink.flush()
            contracted = (
                [_contracted(cotangent, slope) for slope in group]
                for group in (found.frequency, found.place)
            )
            gradients = [real(value) for value in slopes.left(ScalarOperations(), frame, *contracted)]
            if not dr.flag(dr.JitFlag.SymbolicScope) and (self._wanted() != Wanted()):
                # Together with what is added up, or a second kernel would do all of it again.
                dr.schedule(
                    [g for g, is_needed in zip(gradients, needed, strict=True) if is_needed]
                )
            self.set_grad_in("components", tuple(gradients))
            if self.vertices is not None:
                self.set_grad_in("vertices", tuple(sink.vertices))
            if self.fields is not None:
                self.set_grad_in("fields", tuple(sink.fields))

        def _wanted(self) -> Wanted:
            fields = self.fields is not None
            return Wanted(
                vertices=self.vertices is not None,
                weights=fields and not traced.by_waves,
                amplitudes=fields and traced.by_waves,
            )

        def name(self) -> str:
            return f"polywigner {kernel.name}"

    return EdgeSum


def _contracted(cotangent: Pair, slope: Pair) -> Any:
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


class _Forward:
    """Sums up the derivative for given changes of vertices and fields."""

    values = 2

    def __init__(self, ops: DrjitOperations, vertices: Any, fields: Any) -> None:
        self.ops, self.vertices, self.fields = ops, vertices, fields

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
            return pair[0][number], pair[1][number]
        index = _index(self.ops, number)
        x, y = (dr.gather(self.ops.float_type, values, index) for values in pair)
        return x, y


class _Reverse:
    """Adds up gradients with respect to vertices and fields over all samples."""

    values = 0

    def __init__(self, ops: DrjitOperations, cotangent: Pair, vertices: int, fields: int) -> None:
        self.ops, self.cotangent = ops, cotangent
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
            value = _contracted(self.cotangent, slope)
            for axis, component in enumerate(normal):
                self._add(axis, number, value * component)
        return ()

    def field(self, number: Any, slope: Pair, of_conjugate: Pair) -> Any:
        total, turned = slope + of_conjugate, slope - of_conjugate
        self._add(2, number, _contracted(self.cotangent, total))
        self._add(3, number, _contracted(self.cotangent, Pair(-turned.imag, turned.real)))
        return ()

    def flush(self) -> None:
        """What could wait, as its edges were not rows of a table."""
        for (slot, number), value in self.waiting.items():
            self._put(slot, number, value)
        self.waiting.clear()

    def _zeros(self, count: int) -> Any:
        import drjit as dr

        return dr.zeros(self.ops.float_type, count)

    def _add(self, slot: int, number: Any, value: Any) -> None:
        if self._may_wait(number):
            self.waiting[slot, number] = self.waiting.get((slot, number), 0.0) + value
        else:
            self._put(slot, number, value)

    def _may_wait(self, number: Any) -> bool:
        import drjit as dr

        # What a loop computes does not exist after it.
        return isinstance(number, int) and not dr.flag(dr.JitFlag.SymbolicScope)

    def _put(self, slot: int, number: Any, value: Any) -> None:
        import drjit as dr

        value = self.ops.float_type(value)
        index = _index(self.ops, number)
        dr.scatter_reduce(dr.ReduceOp.Add, self.targets[slot], value, index)


class _ReverseByLanes(_Reverse):
    """The same where each number is an array of its own, whose gradients Dr.Jit adds up."""

    def _zeros(self, count: int) -> Any:
        return tuple(self.ops.float_type(0.0) for _ in range(count))

    def _may_wait(self, number: Any) -> bool:
        return True

    def _put(self, slot: int, number: Any, value: Any) -> None:
        found = list(self.targets[slot])
        found[number] = self.ops.float_type(value)
        self.targets[slot] = tuple(found)


def _reverse_of(ops: DrjitOperations, cotangent: Pair, vertices: Any, fields: Any) -> _Reverse:
    import drjit as dr

    first = next((pair[0] for pair in (vertices, fields) if pair is not None), None)
    if isinstance(first, tuple):
        counts = [0 if pair is None else len(pair[0]) for pair in (vertices, fields)]
        return _ReverseByLanes(ops, cotangent, *counts)
    counts = [0 if pair is None else dr.width(pair[0]) for pair in (vertices, fields)]
    return _Reverse(ops, cotangent, *counts)
