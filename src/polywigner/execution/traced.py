"""Kernels on Dr.Jit arrays: arrays of the caller's own kind in and out, traced, differentiable."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.choice import DATA, chosen, takes_data
from polywigner.execution.chunks import array_of
from polywigner.execution.drjit_operations import DrjitOperations, TracedOperations
from polywigner.execution.on_drjit import (
    OnDrjitData,
    frozen,
    is_code,
    is_known,
    with_frame_as_data,
)
from polywigner.execution.points import (
    Parameter,
    Parameters,
    Points,
    Traced,
    common_float,
    own_float,
    read_points,
)
from polywigner.kernels import Kernel
from polywigner.kernels.slopes import Wanted, slope_kernel_of
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns

# Tracing a kernel takes as long as computing so many samples (benchmarks/questions/latency.py).
# More are better computed with what they are used for, without being stored.
_MOST_RECORDED = 1 << 16


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
    if slopes is None or not dr.grad_enabled((tuple(components), traced.vertices, traced.fields)):
        return kernel(ops, tables, *components)
    real = ops.float_type
    inner = kernel.enter(ops, tables.frame, *components)
    fixed = dr.detach(inner)
    values = kernel.edge_sum(ops, tables, *fixed)
    # Derivatives depend on the last arguments.
    summed = map(real, fixed[-slopes.arguments :])
    found = slopes.slopes(ops, tables, _Accumulator(ops, traced), *summed)
    change = [real(value) for value in components]
    parts = slopes.parts(slopes.changed(ops, tables.frame, found, change))
    sums = tuple(
        dr.replace_grad(real(value), real(part)) for value, part in zip(values, parts, strict=True)
    )
    return kernel.leave(ops, tables.frame, inner, sums)


def evaluate_traced(
    kernel: Kernel,
    source: Any,
    points: Points,
    *,
    precision: str | None,
    engine: str,
    complex_result: bool,
    parameters: Parameters | None = None,
) -> Any:
    """Result of a kernel whose arguments are points, at least one of them a Dr.Jit array.

    ``points`` are (name, value); what is not a Dr.Jit array is converted to the arrays' type.
    ``parameters``: numbers of the source that are Dr.Jit arrays, of the same type.

    Raises
    ------
    ArgumentError when types, backends, precisions or numbers of points disagree, or a point has the
    wrong number of components.
    EngineError when the arrays are LLVM's and no usable LLVM library is loaded.
    """
    import drjit

    float_type, double = common_float(points, parameters, precision, engine)
    components, kind = read_points(points, kernel.dimension, float_type)
    outputs = 2 if complex_result else 1
    if not min(map(drjit.width, components)):  # Dr.Jit has no arithmetic of no numbers with one
        return kind.result(*(drjit.zeros(float_type, 0) for _ in range(outputs)))
    tables = _tables(kernel, source, double, parameters)
    components = [_unfolded(component) for component in components]
    ops = DrjitOperations(float_type)
    results = _launched(kernel, ops, tables, components, parameters, outputs)
    return kind.result(*results[:outputs])


def _launched(
    kernel: Kernel,
    ops: DrjitOperations,
    tables: Any,
    components: Sequence[Any],
    parameters: Parameters | None,
    outputs: int,
) -> tuple[Any, ...]:
    """Results of a kernel for components, one or more of them wide."""
    import drjit

    changes = parameters is not None and bool(parameters.types)
    width = max(map(drjit.width, components))
    as_code = is_code(kernel, tables)
    is_long_code = as_code and width > _MOST_RECORDED
    if not changes and is_known(components):
        is_data = takes_data(kernel, tables) and not is_long_code
        if is_data and chosen(kernel, tables, width, engine="llvm")[0] == DATA:
            data = OnDrjitData(kernel, tables, ops.double, "llvm", width, outputs)
            return data.of_arrays(components)
        if as_code and not is_long_code:
            code, kind = partial(kernel, ops, tables), ops.float_type
            return frozen(code, (kernel, tables), kind, "as it is")(*components)
    traced = Traced() if parameters is None else parameters.traced(ops, tables)
    # of many samples, derivatives in points as code are up to four times as fast
    as_data = changes or (any(map(drjit.grad_enabled, components)) and not is_long_code)
    if as_data and slope_kernel_of(kernel) is not None:
        ops, tables = TracedOperations(ops.float_type), with_frame_as_data(ops, tables)
    return kernel_with_derivatives(kernel, ops, tables, components, traced)


def _unfolded(component: Any) -> Any:
    """A component as it is, but a constant that is no number as one that is looked up.

    Dr.Jit folds constants into the code, and drops NaN in doing so.
    """
    import drjit

    if component.state != drjit.VarState.Literal or drjit.grad_enabled(component):
        return component
    value = component[0]
    if math.isfinite(value):
        return component
    return drjit.opaque(type(component), value, drjit.width(component))


def _tables(kernel: Kernel, source: Any, double: bool, parameters: Parameters | None) -> Any:
    """Tables of the kernel, with vertices numbered as the parameters are.

    Equal apertures may begin their rings elsewhere, and share tables of the cache.
    """
    if parameters is None or parameters.vertices is None:
        return kernel.tables_for(source, double)
    return getattr(kernel.tables, "__wrapped__", kernel.tables)(source, double)


def with_end_slopes(
    values: Any,
    points: Points,
    intervals: Parameter,
    slopes: Callable[..., Sequence[tuple[Pair, Pair]]],
    complex_result: bool,
) -> Any:
    """Values of points (of one dimension), with derivatives in begins and ends of intervals.

    ``slopes(ops, *points)``: of each interval the derivatives in its begin and in its end.
    """
    import drjit as dr

    ends = intervals.first, intervals.second
    if not dr.grad_enabled(ends):
        return values
    real = intervals.float_type
    components, kind = read_points(points, 1, real)
    # phases of places far off lose digits in single precision
    double = DrjitOperations(dr.float64_array_t(real))
    places = [double.float_type(dr.detach(c)) for c in components]
    columns = [double.float_type(end) for end in ends]
    total = Pair(double.float_type(0.0), double.float_type(0.0))
    for k, both in enumerate(slopes(double, *places)):
        for slope, column in zip(both, columns, strict=True):
            number = dr.uint32_array_t(real)(k)
            total = total + slope.scaled(dr.gather(double.float_type, column, number))
    # a sum whose value is nothing, and whose derivatives are those that are missing
    parts = (total.real, total.imag)[: 1 + complex_result]
    return values + kind.result(
        *(dr.replace_grad(dr.zeros(real, dr.width(part)), real(part)) for part in parts)
    )


def site_sum(nu: Any, positions: NDArray[np.float64], weights: Parameter) -> Any:
    """sum_k w_k exp(-2 pi i nu.p_k), (L3), for ``nu`` of any kind of Dr.Jit points in the plane.

    positions (n, 2). Differentiable in nu and the weights (n,).
    """
    import drjit as dr

    components, kind = read_points([("nu", nu)], 2, own_float("nu", nu))
    ops = DrjitOperations(weights.float_type)
    columns = [array_of(ops.float_type, column) for column in positions.T]
    columns += [weights.first, weights.second]

    def term(row: Any) -> tuple[Any, Any]:
        x, y, a, b = (dr.gather(ops.float_type, column, row) for column in columns)
        cosine, sine = cos_sin_turns(ops, dr.fma(components[0], x, components[1] * y))
        return a * cosine + b * sine, b * cosine - a * sine

    return kind.result(*ops.plain_sum(0, len(positions), term, 2))
