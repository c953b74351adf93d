"""Evaluation of kernels at Dr.Jit points, with derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.choice import takes_data
from polywigner.execution.chunks import array_of
from polywigner.execution.drjit_operations import DrjitOperations, four_of
from polywigner.execution.on_drjit import (
    CHUNK,
    OnDrjitData,
    Values,
    fills_lanes,
    frozen,
    is_code,
    is_recordable,
    order_by_cell,
    prevents_recording,
    with_frame_as_data,
)
from polywigner.execution.operations import NumpyOperations
from polywigner.execution.points import Drjit, Points, components_of, sibling
from polywigner.kernels import Kernel
from polywigner.kernels.cut.winding import pairs_of
from polywigner.kernels.gradients import gradient_kernel_of
from polywigner.numerics.phases import Pair, cos_sin_cycles

# Largest number of samples for which traced calls read edges from memory, because compiling edges
# as code would take longer. Only calls with up to this number of samples can be recorded.
_MOST_AS_DATA = 1 << 16
# Position of the first recorded call in the sequence of calls with the same source. Up to 16 edges
# are compiled as code, which takes 10 to 20 ms per edge. Tracing takes 1 to 3 ms in each call.
_FIRST_RECORDED = 8
# Smallest number of samples, and smallest number of edges, for which samples are sorted by cell.
# Sorting blocks until the arguments are computed, and takes about 30 ns per sample.
_LEAST_SORTED, _LEAST_EDGES = 1 << 12, 40

Numbers = tuple[Any, Any]
"""Two arrays: coordinates, or real and imaginary parts. While a kernel is traced, two tuples of
arrays."""


@dataclass(frozen=True)
class Traced:
    """Vertices and weights of a source that are Dr.Jit arrays, in the frame of the source.

    While a kernel is traced, each number is a separate array.
    """

    vertices: Numbers | None = None
    """x and y coordinates of all vertices, or None if they are constant."""
    weights: Numbers | None = None
    """Real and imaginary parts of the weights of all elements, or None if they are constant."""


@dataclass(frozen=True, eq=False)
class Differentiable:
    """A source whose vertices or weights are Dr.Jit arrays with derivatives.

    The function :func:`polywigner.differentiable` returns such a source.
    """

    source: Any
    """Aperture or Array with the current values of the vertices and weights."""
    vertices: Drjit | None = None
    """Vertices of all rings as an ``Array2f``, or None if they are constant."""
    weights: Drjit | None = None
    """Weights of the elements as a ``Complex2f``, or None if they are constant."""

    @property
    def numbers(self) -> dict[str, Drjit]:
        """Dr.Jit arrays, with the keys ``"vertices"`` and ``"weights"``; constants have no key."""
        values = {"vertices": self.vertices, "weights": self.weights}
        return {name: value for name, value in values.items() if value is not None}

    def traced(self, ops: DrjitOperations, tables: Any) -> Traced:
        """Return vertices in the frame of ``tables``, and weights times ``tables.factors``.

        Constant numbers are None.
        """
        vertices = weights = None
        if self.vertices is not None:
            x, y = tables.frame.position(ops, *self.vertices)
            vertices = ops.float_type(x), ops.float_type(y)
        if self.weights is not None:
            kind, factors = type(self.weights), np.array(tables.factors, np.complex128)
            real, imag = (array_of(ops.float_type, part) for part in (factors.real, factors.imag))
            scaled = self.weights * kind(real, imag)
            weights = scaled[0], scaled[1]
        return Traced(vertices, weights)


class _Accumulator:
    def __init__(self, ops: DrjitOperations, traced: Traced) -> None:
        import drjit as dr

        self.ops = ops
        numbers = traced.vertices, traced.weights
        self.vertices, self.weights = (_followed(pair, ops.float_type) for pair in numbers)
        self.needs_vertices, self.needs_weights = map(dr.grad_enabled, numbers)
        self.has_constant_indices = self.vertices is not None and isinstance(
            self.vertices[0], tuple
        )
        self.known: dict[tuple[int, int], tuple[Any, Any]] = {}

    def edge(self, begin: Any, end: Any, normal: tuple[Any, Any], at: tuple[Pair, Pair]) -> Pair:
        """Return the sum of g (normal . v) over both vertices v of an edge.

        The derivatives of the result are meaningful, but its value is not. ``begin`` and ``end``
        are indices of vertices. ``at`` contains the derivative g for a displacement of each vertex
        by ``normal``, which is not a unit vector.
        """
        total = Pair(0.0, 0.0)
        for number, gradient in zip((begin, end), at, strict=True):
            x, y = self._looked_up(self.vertices, number)
            total = total + gradient.scaled(normal[0] * x + normal[1] * y)
        return total

    def weight(self, number: Any, gradient: Pair, of_conjugate: Pair) -> Pair:
        """Return gradient × w + of_conjugate × conj(w) for the weight w at an index.

        The derivatives of the result are meaningful, but its value is not.
        """
        x, y = self._looked_up(self.weights, number)
        return gradient * Pair(x, y) + of_conjugate * Pair(x, -y)

    def _looked_up(self, pair: Any, number: Any) -> tuple[Any, Any]:
        """Return the two numbers of the vertex or weight at an index."""
        import drjit as dr

        if isinstance(pair[0], tuple):
            return pair[0][int(number)], pair[1][int(number)]
        kind = self.ops.float_type
        is_constant = isinstance(number, int | float)
        index = dr.uint32_array_t(kind)(int(number)) if is_constant else self.ops.truncated(number)
        # An array created inside a Dr.Jit loop cannot be used outside the loop.
        if not is_constant or dr.flag(dr.JitFlag.SymbolicScope):
            return tuple(dr.gather(kind, values, index) for values in pair)
        # Each vertex is read only once. Otherwise reverse mode would write the gradient of each
        # edge to memory.
        key = id(pair), int(number)
        if key not in self.known:
            self.known[key] = tuple(dr.gather(kind, values, index) for values in pair)
        return self.known[key]


def _followed(pair: Numbers | None, kind: Any) -> Numbers | None:
    """Return zeros in memory with the derivatives of two arrays.

    Loops would lose literal zeros. None, and numbers that are separate arrays, are returned
    unchanged.
    """
    import drjit as dr

    if pair is None or isinstance(pair[0], tuple):
        return pair
    return tuple(dr.replace_grad(dr.opaque(kind, 0.0, dr.width(p)), p) for p in pair)


def kernel_with_derivatives(
    kernel: Kernel, ops: DrjitOperations, tables: Any, components: Sequence[Any], traced: Traced
) -> tuple[Any, ...]:
    """Return the results of a kernel, differentiable with respect to arguments and ``traced``."""
    import drjit as dr

    closed = gradient_kernel_of(kernel)
    if closed is None or not dr.grad_enabled((tuple(components), traced.vertices, traced.weights)):
        return kernel(ops, tables, *components)
    real = ops.float_type
    inner = kernel.enter(ops, tables.frame, *components)
    fixed = dr.detach(inner)
    values = kernel.edge_sum(ops, tables, *fixed)
    # The first argument, the phase of the centre, has no closed-form derivatives.
    summed = map(real, fixed[-2 * len(closed.points) :])
    derivatives = closed.gradients(ops, tables, _Accumulator(ops, traced), *summed)
    change = [real(value) for value in components]
    parts = closed.parts(closed.changed(ops, tables.frame, derivatives, change))
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
    """Return the result of a kernel at component arrays, as a ``Float`` or ``Complex2f``.

    The components broadcast, and the result has one entry per point. ``source`` may be a
    :class:`Differentiable`. ``shear`` converts the components to the arguments of the kernel.
    Raises ArgumentError if the number of components is wrong.
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
        # The cache is bypassed, because it may contain an equal aperture whose rings start at other
        # vertices.
        make_tables = getattr(kernel.tables, "__wrapped__", kernel.tables)
    tables = make_tables(numbers.source, ops.double)
    components = [_in_memory(c) for c in (components if shear is None else shear(components))]
    is_long_code = is_code(kernel, tables) and max(map(drjit.width, components)) > _MOST_AS_DATA
    traced = numbers.traced(ops, tables)
    # For many samples, edges as code are up to four times as fast. A function that the caller
    # freezes must not contain cached memory, so its edges must be code.
    is_code_better = is_long_code or drjit.flag(drjit.JitFlag.FreezingScope)
    order = _order(kernel, ops, tables, components, (traced.vertices, traced.weights))
    if order is None and not numbers.numbers:
        recorded = _recorded(kernel, ops, tables, components)
        if recorded is not None:
            return _typed(ops, recorded, complex_result)
    if (numbers.numbers or not is_code_better) and gradient_kernel_of(kernel) is not None:
        ops, tables = DrjitOperations(ops.float_type, "data"), with_frame_as_data(ops, tables)
    given = components
    if order is not None:
        components = [_taken(c, order) for c in components]
        ops = ops.for_lanes(*components)
    results = kernel_with_derivatives(kernel, ops, tables, components, traced)
    if order is not None:
        place = np.empty(max(map(drjit.width, given)), np.intp)
        place[order.T.ravel()] = np.arange(order.size)
        results = tuple(_taken(drjit.ravel(result), place) for result in results)
    return _typed(ops, results, complex_result)


def _typed(ops: DrjitOperations, results: Sequence[Drjit], is_complex: bool) -> Drjit:
    """Return real and imaginary parts as a ``Complex2f``, or a real result as a ``Float``."""
    return sibling(ops.float_type, "Complex2f")(*results[:2]) if is_complex else results[0]


def _recorded(
    kernel: Kernel, ops: DrjitOperations, tables: Any, components: Sequence[Drjit]
) -> Values | None:
    """Return the results of a recorded kernel, or None if the call is not recorded.

    Recorded calls have few samples and no derivatives, and repeat earlier calls with the source.
    """
    import drjit

    is_large = max(map(drjit.width, components)) > _MOST_AS_DATA
    if is_large or prevents_recording(ops.float_type) or drjit.grad_enabled(components):
        return None
    has_code = is_code(kernel, tables)
    if not (has_code or (takes_data(kernel, tables) and is_recordable(tables))):
        return None

    def as_data() -> OnDrjitData:
        """Return the kernel with the source in memory."""
        return OnDrjitData(kernel, tables, ops.float_type)

    def results(*arrays: Drjit) -> Values:
        """Return the results at points, which follow the arrays of a source in memory."""
        return kernel(ops, tables, *arrays) if has_code else as_data().at_points(*arrays)

    recorded = frozen(results, (kernel, tables), ops.float_type, "points")
    if recorded.requests < _FIRST_RECORDED:
        return None
    if has_code:
        return recorded(*components)
    return recorded(*as_data().constants(), *components)


def _order(
    kernel: Kernel,
    ops: DrjitOperations,
    tables: Any,
    components: Sequence[Drjit],
    numbers: Sequence[Any],
) -> NDArray[np.intp] | None:
    """Return indices that sort samples by cell, or None if sorting saves no time.

    The shape is (n,) or (4, m), as for :func:`order_by_cell`.
    """
    import drjit

    slices, count = kernel.slices, max(map(drjit.width, components))
    if slices is None or count < _LEAST_SORTED or len(tables.edges) < _LEAST_EDGES:
        return None
    if prevents_recording(ops.float_type):
        return None
    arrays = [np.broadcast_to(drjit.detach(c).numpy(), count) for c in components]
    keys = slices.passes(tables)
    grids = [pairs_of(tables, key, ops.double) for key in keys]
    starts = range(0, count, CHUNK)
    is_grouped = fills_lanes(slices, tables, grids, count // len(starts))
    is_grouped &= not drjit.grad_enabled((*components, *numbers))
    parts = []
    # Samples are sorted chunk by chunk, so that the samples of one SIMD vector are close in memory.
    for start in starts:
        chunk = [a[start : start + CHUNK] for a in arrays]
        inner = kernel.enter(NumpyOperations(), tables.frame, *chunk)
        order = order_by_cell(slices, keys[0], grids[0], inner, is_grouped=is_grouped)
        parts.append(start + order)
    return np.concatenate(parts, axis=-1)


def _taken(values: Drjit, index: NDArray[np.intp]) -> Drjit:
    """Return the entries of an array with the specified indices.

    An array with a single entry is broadcast.
    """
    import drjit

    if drjit.width(values) == 1:
        return values
    kind, number = type(values), drjit.uint32_array_t(values)
    if index.ndim > 1:
        return four_of(kind)(*(_taken(values, row) for row in index))
    return drjit.gather(kind, values, array_of(number, index))


def _in_memory(component: Drjit) -> Drjit:
    """Return a component, moved to memory if it is an infinite or NaN constant.

    Compiled code would lose NaN constants.
    """
    import drjit

    if component.state != drjit.VarState.Literal or drjit.grad_enabled(component):
        return component
    value = component[0]
    if math.isfinite(value):
        return component
    return drjit.opaque(type(component), value, drjit.width(component))


def site_sum(nu: Drjit, positions: NDArray[np.float64], weights: Drjit) -> Drjit:
    """Return an array factor (L3), differentiable with respect to frequencies and weights.

    The factor is the sum of w exp(-2 pi i nu.p) over the positions p, shape (n, 2). ``nu`` is an
    ``Array2f``, and ``weights`` a ``Complex2f`` with one entry per position.
    """
    import drjit as dr

    nu_x, nu_y = components_of("nu", nu, 2)
    ops = DrjitOperations(type(weights[0]))
    columns = [array_of(ops.float_type, column) for column in positions.T] + list(weights)

    def term(row: Drjit) -> tuple[Drjit, Drjit]:
        """Return the real and the imaginary part of the term of one position."""
        x, y, a, b = (dr.gather(ops.float_type, column, row) for column in columns)
        cosine, sine = cos_sin_cycles(ops, dr.fma(nu_x, x, nu_y * y))
        return a * cosine + b * sine, b * cosine - a * sine

    return type(weights)(*ops.plain_sum(0, len(positions), term, 2))


def with_jacobian(
    values: NDArray[np.float64], jacobian: NDArray[np.float64], numbers: Sequence[Drjit]
) -> Drjit:
    """Return values as a ``Float`` with specified derivatives.

    Each column of ``jacobian`` contains the derivatives of all values with respect to one entry of
    ``numbers``, a sequence of Dr.Jit floats, in the order of the entries.
    """
    import drjit as dr

    kind = type(numbers[0])
    change, column = dr.zeros(kind, len(values)), 0
    for array in numbers:
        for entry in range(dr.width(array)):
            part = dr.gather(kind, array, dr.uint32_array_t(kind)(entry))
            change = change + array_of(kind, jacobian[:, column]) * part
            column += 1
    return dr.replace_grad(array_of(kind, values), change)
