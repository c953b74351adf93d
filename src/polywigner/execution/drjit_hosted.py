"""Dr.Jit arrays in and out of what is computed on the host: sums that are adapted to each point."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.drjit_arrays import checked_float
from polywigner.execution.drjit_results import from_components

__all__ = ["evaluate_hosted"]

Values = NDArray[Any]


def evaluate_hosted(
    compute: Callable[..., Any],
    name: str,
    points: Any,
    dimension: int,
    *,
    precision: str | None,
    engine: str,
) -> Any:
    """Results of a function of NumPy points for Dr.Jit points, as the kinds of arrays they have.

    Parameters
    ----------
    compute : (points (..., d), precision=...) -> (...) real or complex, or a tuple of such.
    name, points, dimension : of the argument, a Dr.Jit array; and how many components it has.
    precision, engine : as asked for; they must be the array's own.

    Raises
    ------
    ArgumentError for other types, backends, precisions and numbers of components, and for points
    that derivatives are asked of, which there are none of.
    """
    import drjit

    float_type, double = checked_float(name, points, precision, engine)
    if drjit.grad_enabled(points):
        raise ArgumentError(
            f"expected {name} without derivatives, of which a sum adapted to each point has none, "
            f"got some with; pass drjit.detach({name})"
        )
    is_tensor = drjit.is_tensor_v(points)
    own = tuple(points.shape)
    if dimension == 1 and len(own) == 1 and not is_tensor:  # one component: a Float
        own = (1, *own)
    if own[-1 if is_tensor else 0] != dimension or not (is_tensor or len(own) == 2):
        raise ArgumentError(
            f"expected {name} with {dimension} components, got {type(points).__name__} of shape "
            f"{own}; use Array{dimension}f, components first, or a tensor (..., {dimension})"
        )
    host = np.array(points.numpy(), np.float64).reshape(own)
    found = compute(host if is_tensor else host.T, precision="double" if double else "single")
    parts = found if isinstance(found, tuple) else (found,)
    tensor = (type(points), own[:-1]) if is_tensor else None
    made = tuple(from_components(np.asarray(part), float_type, tensor) for part in parts)
    return made if isinstance(found, tuple) else made[0]
