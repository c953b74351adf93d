"""Derivatives in the ends of slits, added to values that lack them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from polywigner.execution.accumulators import contracted
from polywigner.execution.derivatives import DerivativeRule, with_derivatives
from polywigner.execution.drjit_points import is_tensor, point_components, tensor_components
from polywigner.execution.drjit_results import as_complex, as_tensor
from polywigner.execution.operations import DrjitOperations
from polywigner.execution.parameters import Parameter
from polywigner.numerics.complex_pairs import Pair

__all__ = ["with_end_slopes"]

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
