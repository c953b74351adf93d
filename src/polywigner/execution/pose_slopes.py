"""Complex values of poses that the host computes, with derivatives that it computes as well."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.aligned import array_of
from polywigner.execution.derivatives import DerivativeRule, with_derivatives
from polywigner.execution.drjit_arrays import check_request
from polywigner.execution.drjit_points import is_tensor, own_float
from polywigner.execution.drjit_results import as_complex

__all__ = ["hosted_poses"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def hosted_poses(
    compute: Callable[[Floats, bool], tuple[NDArray[Any], Complex | None]], name: str, poses: Any
) -> Any:
    """Values of poses that are a Dr.Jit tensor (..., 4, 4), with derivatives in its entries.

    ``compute``: (poses (..., 4, 4), whether derivatives are wanted) -> values (...), real or
    complex, and derivatives (..., 3, 4) in the first three rows, or None.
    Returns a tensor (...), of complex values (..., 2) with real and imaginary part last.

    Raises ArgumentError for other kinds of Dr.Jit arrays.
    """
    import drjit as dr

    kind = own_float(name, poses)
    if not is_tensor(poses) or tuple(poses.shape)[-2:] != (4, 4):
        raise ArgumentError(
            f"expected {name} as a tensor (..., 4, 4), got {type(poses).__name__} of shape "
            f"{tuple(poses.shape)}"
        )
    check_request(kind, dr.itemsize_v(kind) == 8, None, "auto")
    shape = tuple(poses.shape)[:-2]
    wanted = dr.grad_enabled(poses)
    values, slopes = compute(np.array(dr.detach(poses).numpy(), np.float64), wanted)
    parts = (values.real, values.imag) if np.iscomplexobj(values) else (values,)
    floats = tuple(array_of(kind, part) for part in parts)
    if slopes is not None:
        floats = with_derivatives(_rule(kind, floats, slopes.reshape(-1, 3, 4)), poses.array)
    if len(floats) == 1:
        return type(poses)(floats[0], shape)
    return as_complex((floats[0], floats[1]), shape, poses)


def _rule(kind: Any, values: tuple[Any, ...], slopes: Complex) -> DerivativeRule:
    def forward(_: Any, changes: Any) -> Any:
        change = np.array(changes[0], np.float64).reshape(-1, 4, 4)[:, :3]
        found = (slopes * change).sum(axis=(1, 2))
        return array_of(kind, found.real), array_of(kind, found.imag)

    def reverse(_: Any, gradient: Any) -> Any:
        real, imag = (np.broadcast_to(np.array(g, np.float64), len(slopes)) for g in gradient)
        found = np.zeros((len(slopes), 4, 4))
        found[:, :3] = real[:, None, None] * slopes.real + imag[:, None, None] * slopes.imag
        return (array_of(kind, found.ravel()),)

    return DerivativeRule("coupling", lambda *_: values, forward, reverse)
