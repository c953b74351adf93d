"""Sums over rays from places to points, of Dr.Jit arrays, with derivatives."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.aligned import array_of
from polywigner.execution.derivatives import DerivativeRule, with_derivatives
from polywigner.execution.drjit_points import components_of, is_drjit, nothing, own_float
from polywigner.execution.drjit_results import as_result
from polywigner.execution.table_data import TracedOperations
from polywigner.kernels import Kernel

__all__ = ["float_of", "has_gradient", "ray_sum", "traced_sums", "values_of", "with_slopes"]


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
