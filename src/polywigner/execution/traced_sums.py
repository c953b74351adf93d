"""Sums with derivatives: of slits in their ends, of array factors in weights, over rays."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.chunks import array_of
from polywigner.execution.drjit_points import (
    as_complex,
    as_result,
    as_tensor,
    components_of,
    is_drjit,
    is_tensor,
    nothing,
    own_float,
    plane_components,
    point_components,
    tensor_components,
)
from polywigner.execution.gradients import DerivativeRule, contracted, with_derivatives
from polywigner.execution.operations import DrjitOperations
from polywigner.execution.parameters import Parameter, TracedOperations
from polywigner.kernels import Kernel
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns

Slopes = Sequence[tuple[Pair, Pair]]


def with_end_slopes(
    values: Any,
    points: Sequence[tuple[str, Any]],
    intervals: Parameter,
    slopes: Callable[..., Slopes],
    complex_result: bool,
) -> Any:
    """Values of points (of one dimension), with derivatives in begins and ends of intervals.

    ``slopes(ops, *points)``: of each interval the derivatives in its begin and in its end.
    """
    import drjit as dr

    real = intervals.float_type
    shape = None
    if any(is_tensor(value) for _, value in points):
        shape, components = tensor_components(points, real, 1)
    else:
        components = [c for name, value in points for c in point_components(name, value, real, 1)]
    # phases of places far off lose digits in single precision
    double = DrjitOperations(dr.float64_array_t(real))
    places = [double.float_type(dr.detach(c)) for c in components]
    count = 2 if complex_result else 1

    def value(*_: Any) -> Any:
        return tuple(dr.zeros(real, max(map(dr.width, places))) for _ in range(count))

    def forward(_: Any, change: Any) -> Any:
        columns = [double.float_type(part) for part in change]
        total = Pair(double.float_type(0.0), double.float_type(0.0))
        number = dr.uint32_array_t(real)
        for k, both in enumerate(slopes(double, *places)):
            for slope, column in zip(both, columns, strict=True):
                own = dr.gather(double.float_type, column, number(k))
                total = total + slope.scaled(own)
        return tuple(real(part) for part in (total.real, total.imag)[:count])

    def reverse(_: Any, gradient: Any) -> Any:
        out = [double.float_type(part) for part in gradient]
        cotangent = Pair(out[0], out[1] if count == 2 else 0.0)
        sums = [
            [dr.sum(double.float_type(contracted(cotangent, slope))) for slope in both]
            for both in slopes(double, *places)
        ]
        return tuple(real(dr.concat(list(column))) for column in zip(*sums, strict=True))

    rule = DerivativeRule("ends of slits", value, forward, reverse)
    parts = with_derivatives(rule, intervals.first, intervals.second)
    if shape is not None:
        return values + as_tensor(parts, shape, points)
    return values + (as_complex(parts, None, None) if complex_result else parts[0])


def site_sum(nu: Any, positions: NDArray[np.float64], weights: Parameter) -> Any:
    """sum_k w_k exp(-2 pi i nu.p_k), (L3), for ``nu`` of any kind of Dr.Jit points in the plane.

    positions (n, 2). Differentiable in nu and the weights (n,).
    """
    import drjit as dr

    components, shape = plane_components("nu", nu)
    ops = DrjitOperations(weights.float_type)
    kind, number = ops.float_type, dr.uint32_array_t(ops.float_type)
    places = [array_of(kind, column) for column in positions.T]
    count = len(positions)

    def loop(step: Any, *start: Any) -> Any:
        """``step(index, x, y, *sums)`` over all sites."""

        def body(index: Any, *sums: Any) -> Any:
            x, y = (dr.gather(kind, column, index) for column in places)
            return index + 1, *step(index, x, y, *sums)

        return dr.while_loop((number(0), *start), lambda index, *_: index < count, body)[1:]

    def wave(nu: Any, x: Any, y: Any) -> Any:
        return cos_sin_turns(ops, dr.fma(nu[0], x, nu[1] * y))

    def summed(nu: Any, weights: Any, term: Any) -> Any:
        """Sums of terms, made of place and weight, times the waves."""

        def step(index: Any, x: Any, y: Any, real: Any, imag: Any) -> Any:
            cosine, sine = wave(nu, x, y)
            a, b = term(x, y, *(dr.gather(kind, part, index) for part in weights))
            return real + (a * cosine + b * sine), imag + (b * cosine - a * sine)

        return loop(step, kind(0.0), kind(0.0))

    def value(nu: Any, weights: Any) -> Any:
        return tuple(summed(nu, weights, lambda x, y, a, b: (a, b)))

    def forward(inputs: Any, changes: Any) -> Any:
        (nu, weights), ((du, dv), of_weights) = inputs, changes

        def term(x: Any, y: Any, a: Any, b: Any) -> Any:
            turned = -2 * math.pi * (x * du + y * dv)  # of i w
            return -turned * b, turned * a

        both = zip(summed(nu, weights, term), value(nu, of_weights), strict=True)
        return tuple(a + b for a, b in both)

    def reverse(inputs: Any, gradient: Any) -> Any:
        (nu, weights), (p, q) = inputs, gradient
        grads = [dr.zeros(kind, count) for _ in range(2)]

        def step(index: Any, x: Any, y: Any, of_x: Any, of_y: Any) -> Any:
            cosine, sine = wave(nu, x, y)
            found = p * cosine - q * sine, p * sine + q * cosine
            for target, part in zip(grads, found, strict=True):
                dr.scatter_reduce(dr.ReduceOp.Add, target, part, index)
            a, b = (dr.gather(kind, part, index) for part in weights)
            real, imag = a * cosine + b * sine, b * cosine - a * sine
            slope = 2 * math.pi * (p * imag - q * real)
            return of_x + slope * x, of_y + slope * y

        of_nu = tuple(loop(step, kind(0.0), kind(0.0)))
        return of_nu, tuple(grads)

    rule = DerivativeRule("array factor", value, forward, reverse)
    sums = with_derivatives(rule, tuple(components), (weights.first, weights.second))
    return as_complex(sums, shape, nu)


def float_of(*named: tuple[str, Any]) -> Any:
    """The float type of those of some arguments that are Dr.Jit arrays, None if none is."""
    return next((own_float(name, value) for name, value in named if is_drjit(value)), None)


def has_gradient(value: Any) -> bool:
    """Whether derivatives are asked of a Dr.Jit array."""
    import drjit as dr

    return bool(dr.grad_enabled(value))


def values_of(value: Any, dimension: int) -> Any:
    """The numbers of Dr.Jit points now, (..., d), without derivatives; others as they are."""
    import drjit as dr

    if not is_drjit(value):
        return value
    array = np.array(dr.detach(value), np.float64)
    return array if dr.is_tensor_v(value) or dimension == 1 else array.T


def ray_sum(
    functions: Callable[[Any, Any], Sequence[Any]],
    rule: tuple[NDArray[np.float64], NDArray[np.float64]],
    points: Any,
    wavelength: Any,
    factors: Callable[[Any, Any, Any], Sequence[Any]],
    float_type: Any,
) -> Any:
    """sum_j w_j functions(x_j, nu_j).factors(c_j, 1/|r_j|, wavelength) at each point, (T2).

    ``functions``: W, or the moments (T1), of ``Array2f`` positions and frequencies. ``rule``:
    places (m, 2) and weights (m,). points: (..., 3) of any kind. Memory: some arrays of as many
    entries as there are rays.
    """
    import drjit as dr

    number = dr.uint32_array_t(float_type)
    module = sys.modules[float_type.__module__]
    pair = module.Array2f64 if dr.itemsize_v(float_type) == 8 else module.Array2f
    components, shape = components_of("points", points, float_type, 3)
    if not dr.width(components):
        return as_result(nothing(float_type), shape, points, float_type)
    nodes, weights = rule
    count = len(weights)
    ray = dr.arange(number, count * dr.width(components))
    node, point = ray % count, ray // count
    x, y, weight = (
        dr.gather(float_type, array_of(float_type, column), node) for column in (*nodes.T, weights)
    )
    along: Sequence[Any] = [dr.gather(float_type, part, point) for part in components]
    dx, dy, dz = along[0] - x, along[1] - y, along[2]
    inverse = 1.0 / dr.sqrt(dx * dx + dy * dy + dz * dz)
    length = float_type(wavelength)
    scale = inverse / length
    found = functions(pair(x, y), pair(dx * scale, dy * scale))
    value = sum(a * b for a, b in zip(found, factors(dz * inverse, inverse, length), strict=True))
    return as_result(dr.block_sum(value * weight, count), shape, points, float_type)


def traced_sums(kernel: Kernel, source: Any, *points: Any) -> tuple[Any, ...]:
    """All results of a kernel for ``Array2f`` points; its derivatives are Dr.Jit's to find.

    Right where points that are cut by have none: elsewhere the operations are smooth.
    """
    kind = type(points[0][0])
    ops = TracedOperations(kind)  # as code they would take ten times as long to compile
    components = [part for point in points for part in point]
    return kernel(ops, kernel.tables(source, ops.double), *components)


def with_slopes(
    values: Any,
    fields: tuple[Any, Any],
    slopes: Callable[[], tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> Any:
    """Real values (n,), or a tensor of them, with derivatives in numbers (k,) that they lack.

    ``slopes``: with respect to their real and imaginary parts, (n, k) each.
    """
    import drjit as dr

    flat = values.array if dr.is_tensor_v(values) else values
    kind, width = type(flat), dr.width(flat)

    def value(*_: Any) -> Any:
        return dr.zeros(kind, width)

    def forward(_: Any, change: Any) -> Any:
        columns = (np.array(part, np.float64) for part in change)
        return array_of(kind, sum(s @ c for s, c in zip(slopes(), columns, strict=True)))

    def reverse(_: Any, gradient: Any) -> Any:
        out = np.broadcast_to(np.array(gradient, np.float64), width)
        return tuple(array_of(kind, out @ slope) for slope in slopes())

    total = flat + with_derivatives(DerivativeRule("fields", value, forward, reverse), *fields)
    return type(values)(total, values.shape) if dr.is_tensor_v(values) else total
