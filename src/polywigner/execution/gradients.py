"""Kernels as custom operations of Dr.Jit, with the derivatives of ``kernels.slopes``.

To let Dr.Jit differentiate through the cuts would cost some thirty times the kernel itself, and be
wrong where a cut is the last of several. Here a kernel's sum over edges is one operation: forward
and in reverse it runs another kernel with the closed form of the derivative. The way into the frame
belongs to it, or gradients would be stored in the frame first; that out of it is Dr.Jit's to
differentiate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from polywigner.execution.frozen import is_code, is_recording
from polywigner.execution.operations import DrjitOperations, ScalarOperations
from polywigner.execution.parameters import Traced
from polywigner.execution.sinks import Forward, Reverse, contracted, reverse_of
from polywigner.execution.strides import stride_of, summed_in_strides
from polywigner.execution.table_data import TracedOperations
from polywigner.kernels import Kernel
from polywigner.kernels.slopes.differentiable import SlopeKernel, slope_kernel_of
from polywigner.kernels.slopes.slopes import Wanted
from polywigner.numerics.complex_pairs import Pair

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
    of_vertices, of_fields = map(dr.grad_enabled, (traced.vertices, traced.fields))
    wanted = Wanted(
        vertices=of_vertices,
        weights=of_fields and not traced.by_waves,
        amplitudes=of_fields and traced.by_waves,
    )

    class EdgeSum(dr.CustomOp):
        """The sum over the edges of one kernel and source."""

        def eval(self, components: Any, vertices: Any, fields: Any) -> Any:
            self.arguments = components
            self.shared = vertices if of_vertices else None, fields if of_fields else None
            return tuple(real(value) for value in kernel.edge_sum(ops, tables, *inner))

        def forward(self) -> None:
            change, *of_shared = (self.grad_in(n) for n in ("components", "vertices", "fields"))
            found = slopes.slopes(ops, tables, wanted, Forward(ops, *of_shared), *summed)
            total = Pair(found.shared[0], found.shared[1])
            changes = slopes.entered(ops, frame, change)
            for slope, part in zip((*found.frequency, *found.place), changes, strict=False):
                total = total + slope.scaled(part)
            self.set_grad_out(tuple(map(real, slopes.parts(total))))

        def backward(self) -> None:
            out = self.grad_out()
            sink = reverse_of(ops, *self.shared)
            stride = self._stride()
            if stride > 1:
                gradients = self._in_strides(stride, sink, out)
            else:
                gradients = self._gradients(sink, summed, out)
                sink.flush()
                if wanted != Wanted() and not dr.flag(dr.JitFlag.SymbolicScope):
                    # With what is added up, or a second kernel would do all of it again.
                    pairs = zip(gradients, needed, strict=True)
                    dr.schedule([gradient for gradient, is_needed in pairs if is_needed])
            self.set_grad_in("components", tuple(gradients))
            if of_vertices:
                self.set_grad_in("vertices", tuple(sink.vertices))
            if of_fields:
                self.set_grad_in("fields", tuple(sink.fields))

        def _gradients(self, sink: Reverse, summed: Sequence[Any], out: Any) -> list[Any]:
            """With respect to the arguments; the sink's part to the sink."""
            cotangent = sink.cotangent = slopes.cotangent(out)
            found = slopes.slopes(ops, tables, wanted, sink, *summed)
            parts = (
                [contracted(cotangent, slope) for slope in group]
                for group in (found.frequency, found.place)
            )
            return [real(value) for value in slopes.left(ScalarOperations(), frame, *parts)]

        def _stride(self) -> int:
            """How many samples a lane is to take, one after the other."""
            if wanted == Wanted() or is_recording(real) or isinstance(ops, TracedOperations):
                return 1
            return stride_of(dr.width(summed)) if is_code(kernel, ops, tables) else 1

        def _in_strides(self, stride: int, sink: Reverse, out: Any) -> list[Any]:
            """The same for many samples, of which few lanes have much less to add up."""
            width = dr.width(summed)
            targets = [dr.empty(real, width) if n else real(0.0) for n in needed]

            def terms(taken: Callable[[Any], Any], put: Callable[[Any, Any], None]) -> list[Any]:
                entered = kernel.enter(ops, frame, *map(taken, self.arguments))
                own = tuple(real(value) for value in entered[len(entered) - slopes.arguments :])
                found = self._gradients(sink, own, tuple(map(taken, out)))
                for target, value, is_needed in zip(targets, found, needed, strict=True):
                    if is_needed:
                        put(target, value)
                return sink.taken()

            sink.put_back(summed_in_strides(real, width, stride, sink.slots(), terms))
            sink.flush()
            return targets

        def name(self) -> str:
            return f"polywigner {kernel.name}"

    return EdgeSum
