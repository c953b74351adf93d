"""Complex values of poses that the host computes, with derivatives that it computes as well."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.aligned import array_of
from polywigner.execution.derivatives import DerivativeRule, with_derivatives
from polywigner.execution.drjit_arrays import check_request, common_float, is_drjit
from polywigner.execution.drjit_points import is_tensor
from polywigner.execution.drjit_results import as_complex
from polywigner.execution.parameters import Parameter, Parameters, tensor_of

__all__ = ["hosted_poses"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Computed = tuple[NDArray[Any], Sequence[Complex | None]]


def hosted_poses(
    compute: Callable[[Any, Sequence[bool]], Computed],
    name: str,
    poses: Any,
    fields: Sequence[Parameter | None],
) -> Any:
    """Values of poses, with derivatives in their entries and in weights of sources.

    Parameters
    ----------
    compute : (poses (..., 4, 4), which derivatives are wanted) -> values (...), real or complex,
        and derivatives (n, m) for each kind wanted: the first three rows of each pose, m = 12; the
        real and imaginary parts of each of ``fields``, one after the other; else None.
    poses : a Dr.Jit tensor, or an array of NumPy's.

    Returns a tensor (...), of complex values (..., 2) with real and imaginary part last.

    Raises ArgumentError for other kinds of Dr.Jit arrays.
    """
    import drjit as dr

    kind = common_float([(name, poses)], Parameters(fields[0], fields[1]))  # for their types
    if is_drjit(poses) and (not is_tensor(poses) or tuple(poses.shape)[-2:] != (4, 4)):
        raise ArgumentError(
            f"expected {name} as a tensor (..., 4, 4), got {type(poses).__name__} of shape "
            f"{tuple(poses.shape)}"
        )
    check_request(kind, dr.itemsize_v(kind) == 8, None, "auto")
    inputs = (poses.array if is_drjit(poses) else None, *map(_pair, fields))
    wanted = [value is not None and dr.grad_enabled(value) for value in inputs]
    host = np.array(dr.detach(poses).numpy(), np.float64) if is_drjit(poses) else poses
    values, slopes = compute(host, wanted)
    parts = (values.real, values.imag) if np.iscomplexobj(values) else (values,)
    floats = tuple(array_of(kind, np.ravel(part)) for part in parts)
    if any(wanted):
        floats = with_derivatives(_rule(kind, floats, slopes), *inputs)
    like = poses if is_drjit(poses) else tensor_of(kind, [0.0])
    if len(floats) == 1:
        return type(like)(floats[0], values.shape)
    return as_complex((floats[0], floats[1]), values.shape, like)


def _pair(parameter: Parameter | None) -> tuple[Any, Any] | None:
    return None if parameter is None else (parameter.first, parameter.second)


def _rule(kind: Any, values: tuple[Any, ...], slopes: Sequence[Complex | None]) -> DerivativeRule:
    def forward(_: Any, changes: Any) -> Any:
        count = max(len(own) for own in slopes if own is not None)
        found = np.zeros(count, np.complex128)
        for place, (own, change) in enumerate(zip(slopes, changes, strict=True)):
            if own is not None and place == 0:
                rows = np.array(change, np.float64).reshape(-1, 16)[:, :12]
                found += (own * rows).sum(axis=1)
            elif own is not None:
                found += own @ np.concatenate([np.array(part, np.float64) for part in change])
        return array_of(kind, found.real), array_of(kind, found.imag)

    def reverse(_: Any, gradient: Any) -> Any:
        real, imag = (np.array(part, np.float64) for part in gradient)
        turned = (real - 1j * imag)[:, None]
        found: list[Any] = [None] * len(slopes)
        for place, own in enumerate(slopes):
            if own is None:
                continue
            down = (turned * own).real
            if place == 0:
                found[0] = array_of(kind, np.pad(down, ((0, 0), (0, 4))).ravel())
            else:
                found[place] = tuple(array_of(kind, p) for p in np.split(down.sum(axis=0), 2))
        return tuple(found)

    return DerivativeRule("coupling", lambda *_: values, forward, reverse)
