"""A loss written in JAX, and its gradient: ``python with_jax.py``, with JAX installed.

`dr.wrap` converts a function of JAX arrays to a function of Dr.Jit arrays with derivatives. JAX
compiles a loss of the Wigner function of a square, and Dr.Jit propagates its gradient to the
vertices. (`dr.wrap` does not support the opposite direction, `jax.grad` through Dr.Jit. Both
libraries compute in single precision here, the default of JAX.)
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import polywigner as pw
from polywigner.llvm import require

require()  # before Dr.Jit, which loads its LLVM library once

import drjit as dr  # noqa: E402
from drjit.llvm.ad import TensorXf  # noqa: E402

SQUARE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
NU = np.stack([np.linspace(0.0, 2.0, 33), np.full(33, 0.1)], axis=-1)
X = np.array([0.05, 0.1])


@dr.wrap(source="drjit", target="jax")
@jax.jit
def mean_square(values: Any) -> Any:
    """Return the mean of W^2."""
    return jnp.mean(values**2)


def loss_and_gradient(ring: np.ndarray = SQUARE) -> tuple[float, np.ndarray]:
    """Return the mean of W^2 along a line of frequencies, and its derivatives (n, 2)."""
    vertices = TensorXf(ring.astype(np.float32))
    dr.enable_grad(vertices)
    loss = mean_square(pw.wigner(pw.differentiable(vertices=vertices), X, NU))
    dr.backward(loss)
    return float(loss.array[0]), np.array(vertices.grad)


if __name__ == "__main__":
    value, gradient = loss_and_gradient()
    print(f"mean of W^2 {value:.6f}, its gradient\n{gradient}")
