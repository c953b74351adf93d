"""Array factors with weights that are Dr.Jit arrays, differentiable."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.aligned import array_of
from polywigner.execution.derivatives import DerivativeRule, with_derivatives
from polywigner.execution.drjit_points import plane_components
from polywigner.execution.drjit_results import as_complex
from polywigner.execution.operations import DrjitOperations
from polywigner.execution.parameters import Parameter
from polywigner.numerics.phases import cos_sin_turns

__all__ = ["site_sum"]


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
