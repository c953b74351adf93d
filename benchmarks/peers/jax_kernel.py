"""The kernels of the package compiled by JAX (XLA) instead of Dr.Jit."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import polywigner as pw
from polywigner.execution import NumpyOperations
from polywigner.kernels.functions import plane

__all__ = ["available", "wigner_kernel"]


def available() -> bool:
    return find_spec("jax") is not None


class _Operations(NumpyOperations):
    """NumPy's functions, replaced by jax.numpy's if they differ."""

    target = "code"

    def select(self, condition: Any, a: Any, b: Any) -> Any:
        import jax.numpy as jnp

        return jnp.where(condition, self._typed(a), self._typed(b))

    def minimum(self, a: Any, b: Any) -> Any:
        import jax.numpy as jnp

        return jnp.minimum(a, b)

    def maximum(self, a: Any, b: Any) -> Any:
        import jax.numpy as jnp

        return jnp.maximum(a, b)

    def round(self, a: Any) -> Any:
        import jax.numpy as jnp

        return jnp.round(a)


def wigner_kernel(source: pw.Aperture, precision: str) -> Callable[..., Any]:
    """Return (x, y, nu_x, nu_y) -> W for NumPy or JAX arrays, compiled at the first call."""
    import jax

    jax.config.update("jax_enable_x64", True)
    double = precision == "double"
    ops, tables = _Operations(double), plane.WIGNER.tables(source, double)
    compiled = jax.jit(lambda *arguments: plane.WIGNER(ops, tables, *arguments)[0])
    return lambda *arguments: compiled(*arguments).block_until_ready()
