"""Kernels with the derivatives of ``kernels.slopes``, in closed form.

To let Dr.Jit differentiate through the cuts would cost some thirty times the kernel itself, and be
wrong where a cut is the last of several. Here a kernel's sum over edges has its value from one
kernel, and its derivatives from another: a sum of slopes times what they are slopes in. It is
linear, and Dr.Jit's to differentiate in any direction, as is the way into the frame and out of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from polywigner.execution.drjit_operations import DrjitOperations
from polywigner.execution.on_drjit_data import with_frame_as_data
from polywigner.execution.points import Traced
from polywigner.kernels import Kernel
from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.slopes import Wanted, slope_kernel_of
from polywigner.numerics.complex_pairs import Pair
from polywigner.plans import cut_for


class _Accumulator:
    """Sums up slopes in vertices and fields, times these."""

    def __init__(self, ops: DrjitOperations, traced: Traced) -> None:
        import drjit as dr

        self.ops = ops
        self.vertices, self.fields = (
            _followed(pair, ops.float_type) for pair in (traced.vertices, traced.fields)
        )
        vertices, fields = map(dr.grad_enabled, (traced.vertices, traced.fields))
        self.wanted = Wanted(
            vertices=vertices,
            weights=fields and not traced.by_waves,
            amplitudes=fields and traced.by_waves,
        )
        self.known: dict[tuple[int, int], tuple[Any, Any]] = {}

    def edge(self, begin: Any, end: Any, normal: tuple[Any, Any], at: tuple[Pair, Pair]) -> Pair:
        total = Pair(0.0, 0.0)
        for number, slope in zip((begin, end), at, strict=True):
            x, y = self._looked_up(self.vertices, number)
            total = total + slope.scaled(normal[0] * x + normal[1] * y)
        return total

    def field(self, number: Any, slope: Pair, of_conjugate: Pair) -> Pair:
        x, y = self._looked_up(self.fields, number)
        return slope * Pair(x, y) + of_conjugate * Pair(x, -y)

    def _looked_up(self, pair: Any, number: Any) -> tuple[Any, Any]:
        import drjit as dr

        if isinstance(pair[0], tuple):
            return pair[0][int(number)], pair[1][int(number)]
        kind = self.ops.float_type
        is_constant = isinstance(number, int | float)
        index = dr.uint32_array_t(kind)(int(number)) if is_constant else self.ops.truncated(number)
        if not is_constant or dr.flag(dr.JitFlag.SymbolicScope):  # a loop's do not exist after it
            return tuple(dr.gather(kind, values, index) for values in pair)
        # once for all edges, or each would add up gradients in memory for itself
        key = id(pair), int(number)
        if key not in self.known:
            self.known[key] = tuple(dr.gather(kind, values, index) for values in pair)
        return self.known[key]


def _followed(pair: Any, kind: Any) -> Any:
    """Zeros with the derivatives of arrays of numbers, which are not looked up themselves.

    They are in memory, since loops drop constants that they would add up.
    """
    import drjit as dr

    if pair is None or isinstance(pair[0], tuple):
        return pair
    return tuple(dr.replace_grad(dr.opaque(kind, 0.0, dr.width(p)), p) for p in pair)


def kernel_with_derivatives(
    kernel: Kernel, ops: DrjitOperations, tables: Any, components: Sequence[Any], traced: Traced
) -> tuple[Any, ...]:
    """Results of a kernel with derivatives in its arguments and in ``traced`` numbers."""
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
    real = ops.float_type
    inner = kernel.enter(ops, tables.frame, *components)
    fixed = dr.detach(inner)
    values = kernel.edge_sum(ops, tables, *fixed)
    # Derivatives depend on the last arguments.
    summed = map(real, fixed[-slopes.arguments :])
    found = slopes.slopes(ops, tables, _Accumulator(ops, traced), *summed)
    total = found.shared
    entered = slopes.entered(ops, tables.frame, [real(value) for value in components])
    for slope, change in zip((*found.frequency, *found.place), entered, strict=False):
        total = total + slope.scaled(change)
    pairs = zip(values, slopes.parts(total), strict=True)
    sums = tuple(dr.replace_grad(real(value), real(linear)) for value, linear in pairs)
    return kernel.leave(ops, tables.frame, inner, sums)
