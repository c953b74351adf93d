"""Kernels with the derivatives of ``kernels.slopes``, in closed form.

To let Dr.Jit differentiate through the cuts would cost some thirty times the kernel itself, and be
wrong where a cut is the last of several. Here a kernel's sum over edges is one operation: forward
and in reverse it runs another kernel with the closed form of the derivative. The way into the frame
belongs to it, or gradients would be stored in the frame first; that out of it is Dr.Jit's to
differentiate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from polywigner.execution.accumulators import (
    ForwardAccumulator,
    ReverseAccumulator,
    contracted,
    reverse_accumulator,
)
from polywigner.execution.derivatives import DerivativeRule, with_derivatives
from polywigner.execution.operations import DrjitOperations, ScalarOperations
from polywigner.execution.parameters import Traced
from polywigner.execution.table_data import with_frame_as_data
from polywigner.kernels import Kernel
from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.slopes.slope_kernels import SlopeKernel, slope_kernel_of
from polywigner.kernels.slopes.slopes import Wanted
from polywigner.numerics.complex_pairs import Pair
from polywigner.plans import cut_for

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
