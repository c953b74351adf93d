"""Kernels on Dr.Jit arrays: component arrays in and out, traced, differentiable."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.chunks import array_of
from polywigner.execution.drjit_operations import DrjitOperations, TracedOperations
from polywigner.execution.on_drjit import is_code, with_frame_as_data
from polywigner.execution.points import Drjit, Points, components_of, sibling, split
from polywigner.geometry import Slits
from polywigner.kernels import Kernel
from polywigner.kernels.outline.wave_pairs import waves_in_frame
from polywigner.kernels.slopes import Wanted, gradient_kernel_of, slopes_in_ends
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns
from polywigner.source import Illumination

# Samples up to which edges are data: compiling them as code costs more than it saves.
_MOST_AS_DATA = 1 << 16

Numbers = tuple[Any, Any]
"""Pairs of numbers: two arrays, or two tuples of arrays in a kernel that is being traced."""


@dataclass(frozen=True)
class Traced:
    """Numbers of a source in its frame that are Dr.Jit arrays; None: they are constants.

    While a kernel is traced each number is a separate array, and the pairs consist of tuples.
    """

    vertices: Numbers | None = None
    """x and y of all vertices."""
    fields: Numbers | None = None
    """Real and imaginary parts of all weights, or of the amplitudes of all waves."""
    by_waves: bool = False
    """Whether ``fields`` are amplitudes of waves."""


@dataclass(frozen=True, eq=False)
class Differentiable:
    """A source with the present values of its numbers, and the Dr.Jit arrays that contain them.

    Made by :func:`polywigner.differentiable`.
    """

    source: Any
    """An Aperture or an Array, or Slits with ``intervals``."""
    vertices: Drjit | None = None
    """``Array2f``."""
    weights: Drjit | None = None
    """``Complex2f``."""
    amplitudes: Drjit | None = None
    """``Complex2f``."""
    intervals: Drjit | None = None
    """``Array2f``."""

    @property
    def numbers(self) -> dict[str, Drjit]:
        """The Dr.Jit arrays by name."""
        names = ("vertices", "weights", "amplitudes", "intervals")
        values = {name: getattr(self, name) for name in names}
        return {name: value for name, value in values.items() if value is not None}

    def traced(self, ops: DrjitOperations, tables: Any) -> Traced:
        """Return the numbers in the frame of tables."""
        vertices = fields = None
        if self.vertices is not None:
            x, y = tables.frame.position(ops, *self.vertices)
            vertices = ops.float_type(x), ops.float_type(y)
        if self.weights is not None:
            fields = _scaled(self.weights, np.array(tables.factors, np.complex128))
        elif self.amplitudes is not None:
            frequencies = self.source.illumination.frequencies
            waves = waves_in_frame(
                Illumination(np.ones(len(frequencies)), frequencies), tables.frame
            )
            fields = _scaled(self.amplitudes, np.array([w.amplitude for w in waves], np.complex128))
        return Traced(vertices, fields, by_waves=self.amplitudes is not None)


def _scaled(numbers: Drjit, factors: NDArray[np.complex128]) -> Numbers:
    """Return the parts of complex numbers times factors."""
    kind = type(numbers)
    real, imag = (array_of(type(numbers[0]), part) for part in (factors.real, factors.imag))
    scaled = numbers * kind(real, imag)
    return scaled[0], scaled[1]


class _Accumulator:
    """Sums of slopes in vertices and fields, times the changes of these."""

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
        self.has_constant_numbers = self.vertices is not None and isinstance(
            self.vertices[0], tuple
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
        if not is_constant or dr.flag(
            dr.JitFlag.SymbolicScope
        ):  # arrays of a loop do not exist after it
            return tuple(dr.gather(kind, values, index) for values in pair)
        # Once for all edges; otherwise each edge would accumulate gradients in memory.
        key = id(pair), int(number)
        if key not in self.known:
            self.known[key] = tuple(dr.gather(kind, values, index) for values in pair)
        return self.known[key]


def _followed(pair: Numbers | None, kind: Any) -> Numbers | None:
    """Return zeros with the derivatives of arrays of numbers.

    The zeros are in memory, because loops drop constants.
    """
    import drjit as dr

    if pair is None or isinstance(pair[0], tuple):
        return pair
    return tuple(dr.replace_grad(dr.opaque(kind, 0.0, dr.width(p)), p) for p in pair)


def kernel_with_derivatives(
    kernel: Kernel, ops: DrjitOperations, tables: Any, components: Sequence[Any], traced: Traced
) -> tuple[Any, ...]:
    """Return results of a kernel with derivatives in its arguments and in ``traced`` numbers."""
    import drjit as dr

    slopes = gradient_kernel_of(kernel)
    if slopes is None or not dr.grad_enabled((tuple(components), traced.vertices, traced.fields)):
        return kernel(ops, tables, *components)
    real = ops.float_type
    inner = kernel.enter(ops, tables.frame, *components)
    fixed = dr.detach(inner)
    values = kernel.edge_sum(ops, tables, *fixed)
    # Derivatives depend on the last arguments.
    summed = map(real, fixed[-slopes.arguments :])
    derivatives = slopes.slopes(ops, tables, _Accumulator(ops, traced), *summed)
    change = [real(value) for value in components]
    parts = slopes.parts(slopes.changed(ops, tables.frame, derivatives, change))
    sums = tuple(
        dr.replace_grad(real(value), real(part)) for value, part in zip(values, parts, strict=True)
    )
    return kernel.leave(ops, tables.frame, inner, sums)


def evaluate_traced(
    kernel: Kernel,
    source: Any,
    points: Points,
    *,
    complex_result: bool,
    shear: Callable[[Sequence[Drjit]], Sequence[Drjit]] | None = None,
) -> Drjit:
    """Return a ``Float`` or ``Complex2f`` of a kernel at component arrays of one float type.

    ``source`` may be a :class:`Differentiable`. ``shear`` maps the components to those of the
    kernel. Raises ArgumentError for a wrong number of components.
    """
    import drjit

    components: Sequence[Drjit] = [
        component
        for name, value in points.items()
        for component in components_of(name, value, kernel.dimension)
    ]
    ops = DrjitOperations(type(components[0]))
    numbers = source if isinstance(source, Differentiable) else Differentiable(source)
    make_tables: Any = kernel.tables_for
    if numbers.vertices is not None:
        # Equal apertures may begin their rings elsewhere and share tables in the cache.
        make_tables = getattr(kernel.tables, "__wrapped__", kernel.tables)
    tables = make_tables(numbers.source, ops.double)
    components = [_in_memory(c) for c in (components if shear is None else shear(components))]
    is_long_code = is_code(kernel, tables) and max(map(drjit.width, components)) > _MOST_AS_DATA
    traced = numbers.traced(ops, tables)
    # Edges as data compile once for all outlines. For many samples edges as code are up to four
    # times as fast. A function that the caller freezes may not contain cached memory.
    is_code_better = is_long_code or drjit.flag(drjit.JitFlag.FreezingScope)
    if (numbers.numbers or not is_code_better) and gradient_kernel_of(kernel) is not None:
        ops, tables = TracedOperations(ops.float_type), with_frame_as_data(ops, tables)
    results = kernel_with_derivatives(kernel, ops, tables, components, traced)
    return sibling(ops.float_type, "Complex2f")(*results[:2]) if complex_result else results[0]


def _in_memory(component: Drjit) -> Drjit:
    """Return a component, a constant that is not finite as an array in memory.

    Dr.Jit folds constants into the code and drops NaN.
    """
    import drjit

    if component.state != drjit.VarState.Literal or drjit.grad_enabled(component):
        return component
    value = component[0]
    if math.isfinite(value):
        return component
    return drjit.opaque(type(component), value, drjit.width(component))


def with_end_slopes(
    value: Drjit, name: str, slits: Slits, intervals: Drjit, points: Points
) -> Drjit:
    """Return F, W or A (``name``) of slits with derivatives in the ends of the slits, (G5)."""
    import drjit as dr

    if not dr.grad_enabled(intervals):
        return value
    real = type(intervals[0])
    # Phases far from the origin lose digits in single precision.
    ops = DrjitOperations(dr.float64_array_t(real))
    at = [ops.float_type(dr.detach(c)) for point in points.values() for c in split(point)]
    ends = [ops.float_type(end) for end in intervals]
    total = Pair(ops.float_type(0.0), ops.float_type(0.0))
    for k, slopes in enumerate(slopes_in_ends(ops, name, slits, *at)):
        for slope, end in zip(slopes, ends, strict=True):
            total = total + slope.scaled(dr.gather(ops.float_type, end, dr.uint32_array_t(real)(k)))
    # The value of this sum is zero; it has the missing derivatives.
    parts = [
        dr.replace_grad(dr.zeros(real, dr.width(part)), real(part))
        for part in (total.real, total.imag)
    ]
    return value + (type(value)(*parts) if dr.is_complex_v(value) else parts[0])


def site_sum(nu: Drjit, positions: NDArray[np.float64], weights: Drjit) -> Drjit:
    """Return sum_k w_k exp(-2 pi i nu.p_k), (L3), with derivatives in nu and in the weights.

    ``nu`` is an ``Array2f``, ``positions`` (n, 2), ``weights`` a ``Complex2f`` (n,).
    """
    import drjit as dr

    nu_x, nu_y = components_of("nu", nu, 2)
    ops = DrjitOperations(type(weights[0]))
    columns = [array_of(ops.float_type, column) for column in positions.T] + list(weights)

    def term(row: Drjit) -> tuple[Drjit, Drjit]:
        x, y, a, b = (dr.gather(ops.float_type, column, row) for column in columns)
        cosine, sine = cos_sin_turns(ops, dr.fma(nu_x, x, nu_y * y))
        return a * cosine + b * sine, b * cosine - a * sine

    return type(weights)(*ops.plain_sum(0, len(positions), term, 2))
