"""Kernels with the derivatives of ``kernels.slopes``, in closed form.

To let Dr.Jit differentiate through the cuts would cost some thirty times the kernel itself, and be
wrong where a cut is the last of several. Here a kernel's sum over edges is one operation: forward
and in reverse it runs another kernel with the closed form of the derivative. The way into the frame
belongs to it, or gradients would be stored in the frame first; that out of it is Dr.Jit's to
differentiate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from polywigner.execution.accumulators import (
    ForwardAccumulator,
    ReverseAccumulator,
    contracted,
    reverse_accumulator,
)
from polywigner.execution.derivatives import DerivativeRule, with_derivatives
from polywigner.execution.frozen import is_code, is_recording
from polywigner.execution.operations import DrjitOperations, ScalarOperations
from polywigner.execution.parameters import Traced
from polywigner.execution.strides import stride_of, summed_in_strides
from polywigner.execution.table_data import TracedOperations
from polywigner.kernels import Kernel
from polywigner.kernels.slopes.slope_kernels import SlopeKernel, slope_kernel_of
from polywigner.kernels.slopes.slopes import Wanted
from polywigner.numerics.complex_pairs import Pair

__all__ = ["kernel_with_derivatives"]


def kernel_with_derivatives(
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
        self.real, self.inner, self.summed = ops.float_type, inner, self._last(inner, ops)
        self.needed = [dr.grad_enabled(value) for value in components]
        vertices, fields = map(dr.grad_enabled, (traced.vertices, traced.fields))
        self.wanted = Wanted(
            vertices=vertices,
            weights=fields and not traced.by_waves,
            amplitudes=fields and traced.by_waves,
        )
        self.rule = DerivativeRule(kernel.name, self._value, self._forward, self._reverse)

    def _last(self, inner: Sequence[Any], ops: DrjitOperations) -> tuple[Any, ...]:
        """Arguments in the frame that the derivatives depend on, the last ones."""
        return tuple(ops.float_type(value) for value in inner[-self.slopes.arguments :])

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

        arguments, vertices, fields = inputs
        accumulator = reverse_accumulator(self.ops, self.wanted, vertices, fields)
        stride = self._stride()
        if stride > 1:
            gradients = self._in_strides(stride, accumulator, arguments, out)
        else:
            gradients = self._gradients(accumulator, self.summed, out)
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

    def _gradients(
        self, accumulator: ReverseAccumulator, summed: Sequence[Any], out: Any
    ) -> list[Any]:
        """The gradients in the arguments; the accumulator takes those that it is for."""
        cotangent = accumulator.cotangent = self.slopes.cotangent(out)
        found = self.slopes.slopes(self.ops, self.tables, accumulator, *summed)
        parts = (
            [contracted(cotangent, slope) for slope in group]
            for group in (found.frequency, found.place)
        )
        left = self.slopes.left(ScalarOperations(), self.tables.frame, *parts)
        return [self.real(value) for value in left]

    def _stride(self) -> int:
        """How many samples a lane is to take, one after the other."""
        import drjit as dr

        traced = isinstance(self.ops, TracedOperations)
        if self.wanted == Wanted() or is_recording(self.real) or traced:
            return 1
        code = is_code(self.kernel, self.ops, self.tables)
        return stride_of(dr.width(self.summed)) if code else 1

    def _in_strides(
        self, stride: int, accumulator: ReverseAccumulator, arguments: Any, out: Any
    ) -> list[Any]:
        """The gradients of many samples, of which few lanes have much less to add up."""
        import drjit as dr

        real, width = self.real, dr.width(self.summed)
        targets = [dr.empty(real, width) if n else real(0.0) for n in self.needed]

        def terms(taken: Callable[[Any], Any], put: Callable[[Any, Any], None]) -> list[Any]:
            inner = self.kernel.enter(self.ops, self.tables.frame, *map(taken, arguments))
            own = self._last(inner, self.ops)
            found = self._gradients(accumulator, own, tuple(map(taken, out)))
            for target, value, is_needed in zip(targets, found, self.needed, strict=True):
                if is_needed:
                    put(target, value)
            return accumulator.taken()

        slots = accumulator.slots()
        accumulator.put_back(summed_in_strides(real, width, stride, slots, terms))
        accumulator.flush()
        return targets
