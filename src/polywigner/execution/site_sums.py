"""Array factors with weights that are Dr.Jit arrays, differentiable."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.drjit_points import plane_components
from polywigner.execution.drjit_results import as_complex
from polywigner.execution.operations import DrjitOperations
from polywigner.execution.parameters import Parameter
from polywigner.numerics.trigonometry import cos_sin_turns

__all__ = ["site_sum"]


def site_sum(nu: Any, positions: NDArray[np.float64], weights: Parameter) -> Any:
    """sum_k w_k exp(-2 pi i nu.p_k), (L3), for ``nu`` of any kind of Dr.Jit points in the plane.

    positions (n, 2). Differentiable in nu and the weights (n,).
    """
    import drjit as dr

    components, shape = plane_components("nu", nu)
    ops = DrjitOperations(weights.float_type)
    kind, number = ops.float_type, dr.uint32_array_t(ops.float_type)
    places = [kind(column.tolist()) for column in positions.T]
    count = len(positions)

    def loop(step: Any, *start: Any) -> Any:
        """``step(index, x, y, *sums)`` over all sites."""

        def body(index: Any, *sums: Any) -> Any:
            x, y = (dr.gather(kind, column, index) for column in places)
            return index + 1, *step(index, x, y, *sums)

        return dr.while_loop((number(0), *start), lambda index, *_: index < count, body)[1:]

    class SiteSum(dr.CustomOp):
        def eval(self, nu: Any, real: Any, imag: Any) -> Any:
            self.nu, self.weights = nu, (real, imag)
            return tuple(self._summed(lambda x, y, a, b: (a, b)))

        def forward(self) -> None:
            du, dv = self.grad_in("nu")
            of_weights = self.grad_in("real"), self.grad_in("imag")

            def term(x: Any, y: Any, a: Any, b: Any) -> Any:
                turned = -2 * math.pi * (x * du + y * dv)  # of i w
                return -turned * b, turned * a

            moved = self._summed(term)
            changed = self._summed(lambda x, y, a, b: (a, b), of_weights)
            self.set_grad_out(tuple(a + b for a, b in zip(moved, changed, strict=True)))

        def backward(self) -> None:
            p, q = self.grad_out()
            grads = [dr.zeros(kind, count) for _ in range(2)]

            def step(index: Any, x: Any, y: Any, of_x: Any, of_y: Any) -> Any:
                cosine, sine = self._wave(x, y)
                for target, value in zip(
                    grads, (p * cosine - q * sine, p * sine + q * cosine), strict=True
                ):
                    dr.scatter_reduce(dr.ReduceOp.Add, target, value, index)
                a, b = (dr.gather(kind, part, index) for part in self.weights)
                real, imag = a * cosine + b * sine, b * cosine - a * sine
                slope = 2 * math.pi * (p * imag - q * real)
                return of_x + slope * x, of_y + slope * y

            found = loop(step, kind(0.0), kind(0.0))
            self.set_grad_in("nu", tuple(found))
            self.set_grad_in("real", grads[0])
            self.set_grad_in("imag", grads[1])

        def _wave(self, x: Any, y: Any) -> Any:
            return cos_sin_turns(ops, dr.fma(self.nu[0], x, self.nu[1] * y))

        def _summed(self, term: Any, weights: Any = None) -> Any:
            chosen = weights or self.weights

            def step(index: Any, x: Any, y: Any, real: Any, imag: Any) -> Any:
                cosine, sine = self._wave(x, y)
                a, b = term(x, y, *(dr.gather(kind, part, index) for part in chosen))
                return real + (a * cosine + b * sine), imag + (b * cosine - a * sine)

            return loop(step, kind(0.0), kind(0.0))

    sums = dr.custom(SiteSum, tuple(components), weights.first, weights.second)
    return as_complex(sums, shape, nu)
