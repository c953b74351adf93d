"""Kernels with the derivatives of ``kernels.slopes``, in closed form, as one custom operation.

To let Dr.Jit differentiate through the cuts would cost some thirty times the kernel itself, and be
wrong where a cut is the last of several. Here a kernel's sum over edges is one operation: forward
and in reverse it runs another kernel with the closed form of the derivative. The way into the frame
belongs to it, or gradients would be stored in the frame first; that out of it is Dr.Jit's to
differentiate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from polywigner.execution.on_drjit_data import with_frame_as_data
from polywigner.execution.operations import DrjitOperations, ScalarOperations
from polywigner.execution.points import Traced
from polywigner.kernels import Kernel
from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.slopes.slopes import Wanted
from polywigner.kernels.slopes.slopes_of_slices import SlopeKernel, slope_kernel_of
from polywigner.numerics.complex_pairs import Pair
from polywigner.plans import cut_for


@dataclass(frozen=True, eq=False)
class DerivativeRule:
    """A function of some inputs, and how changes go forward through it and gradients back.

    An input is an array, a tuple of arrays, or None; the functions get all of them without
    derivatives.
    """

    name: str
    value: Callable[..., Any]
    """(*inputs) -> a tuple of arrays, or one array."""
    forward: Callable[[Any, Any], Any]
    """(inputs, their changes) -> the change of the value."""
    reverse: Callable[[Any, Any], tuple[Any, ...]]
    """(inputs, the gradient in the value) -> that in each input, None where it has none."""


def with_derivatives(rule: DerivativeRule, *inputs: Any) -> Any:
    """The value of a function, which Dr.Jit then differentiates by its rule."""
    import drjit

    return drjit.custom(_operation(), rule, inputs)


@cache
def _operation() -> Any:
    import drjit

    class Operation(drjit.CustomOp):
        """A function and its derivatives, by a rule."""

        def eval(self, rule: DerivativeRule, inputs: Any) -> Any:
            self.rule, self.inputs = rule, inputs
            return rule.value(*inputs)

        def forward(self) -> None:
            self.set_grad_out(self.rule.forward(self.inputs, self.grad_in("inputs")))

        def backward(self) -> None:
            self.set_grad_in("inputs", self.rule.reverse(self.inputs, self.grad_out()))

        def name(self) -> str:
            return f"polywigner {self.rule.name}"

    return Operation


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


def kernel_with_derivatives(
    kernel: Kernel, ops: DrjitOperations, tables: Any, components: Sequence[Any], traced: Traced
) -> tuple[Any, ...]:
    """The results of a kernel, with derivatives in its arguments and in what is ``traced``."""
    import drjit as dr

    slopes = slope_kernel_of(kernel)
    shared = (traced.vertices, traced.fields)
    if slopes is None or not dr.grad_enabled((tuple(components), shared)):
        return kernel(ops, tables, *components)
    if isinstance(tables, Tables) and ops.target == "compiled" and not dr.grad_enabled(shared):
        # The function is found in the same way: of A, the phase of the centre multiplies both.
        samples = dr.width(tuple(components))
        cut = cut_for("derivatives", tables.clips, tables.fits_pairs, samples)
        tables = tables.cut_by(cut)
        if cut == "pairs":
            tables = with_frame_as_data(ops, tables)
    inner = kernel.enter(ops, tables.frame, *components)
    typed = tuple(ops.float_type(value) for value in components)
    edge_sum = _EdgeSum(kernel, ops, tables, slopes, traced, typed, dr.detach(inner))
    sums = with_derivatives(edge_sum.rule, typed, *shared)
    return kernel.leave(ops, tables.frame, inner, sums)


class _EdgeSum:
    """The sum over the edges of one kernel and source, for arguments that are in its frame."""

    def __init__(
        self,
        kernel: Kernel,
        ops: DrjitOperations,
        tables: Any,
        slopes: SlopeKernel,
        traced: Traced,
        components: Sequence[Any],
        inner: Sequence[Any],
    ) -> None:
        import drjit as dr

        self.kernel, self.ops, self.tables, self.slopes = kernel, ops, tables, slopes
        self.real, self.inner = ops.float_type, inner
        # Derivatives depend on the last arguments.
        self.summed = tuple(map(self.real, inner[-slopes.arguments :]))
        self.needed = [dr.grad_enabled(value) for value in components]
        vertices, fields = map(dr.grad_enabled, (traced.vertices, traced.fields))
        self.wanted = Wanted(
            vertices=vertices,
            weights=fields and not traced.by_waves,
            amplitudes=fields and traced.by_waves,
        )
        self.rule = DerivativeRule(kernel.name, self._value, self._forward, self._reverse)

    def _value(self, *_: Any) -> tuple[Any, ...]:
        return tuple(map(self.real, self.kernel.edge_sum(self.ops, self.tables, *self.inner)))

    def _forward(self, _: Any, changes: Any) -> tuple[Any, ...]:
        of_arguments, *of_shared = changes
        accumulator = ForwardAccumulator(self.ops, self.wanted, *of_shared)
        found = self.slopes.slopes(self.ops, self.tables, accumulator, *self.summed)
        total = Pair(found.shared[0], found.shared[1])
        entered = self.slopes.entered(self.ops, self.tables.frame, of_arguments)
        for slope, change in zip((*found.frequency, *found.place), entered, strict=False):
            total = total + slope.scaled(change)
        return tuple(map(self.real, self.slopes.parts(total)))

    def _reverse(self, inputs: Any, out: Any) -> tuple[Any, ...]:
        import drjit as dr

        _, vertices, fields = inputs
        accumulator = reverse_accumulator(self.ops, self.wanted, vertices, fields)
        gradients = self._gradients(accumulator, out)
        accumulator.flush()
        if self.wanted != Wanted() and not dr.flag(dr.JitFlag.SymbolicScope):
            # With what is added up, or a second kernel would do all of it again.
            pairs = zip(gradients, self.needed, strict=True)
            dr.schedule([gradient for gradient, is_needed in pairs if is_needed])
        return (
            tuple(gradients),
            tuple(accumulator.vertices) if self.wanted.vertices else None,
            tuple(accumulator.fields) if self.wanted.fields else None,
        )

    def _gradients(self, accumulator: ReverseAccumulator, out: Any) -> list[Any]:
        """The gradients in the arguments; the accumulator takes those that it is for."""
        cotangent = accumulator.cotangent = self.slopes.cotangent(out)
        found = self.slopes.slopes(self.ops, self.tables, accumulator, *self.summed)
        parts = (
            [contracted(cotangent, slope) for slope in group]
            for group in (found.frequency, found.place)
        )
        left = self.slopes.left(ScalarOperations(), self.tables.frame, *parts)
        return [self.real(value) for value in left]
