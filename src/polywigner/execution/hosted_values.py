"""Real values of several arguments that the host computes, with derivatives that it computes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.aligned import array_of
from polywigner.execution.derivatives import DerivativeRule, with_derivatives
from polywigner.execution.drjit_arrays import check_request, common_float
from polywigner.execution.drjit_points import components_of, is_drjit, is_tensor
from polywigner.execution.drjit_results import as_result

__all__ = ["hosted_values"]

Floats = NDArray[np.float64]
Computed = tuple[Floats, Sequence[Floats | None]]


def hosted_values(
    compute: Callable[[Sequence[Any], Sequence[bool]], Computed],
    points: Sequence[tuple[str, Any]],
    dimension: int,
) -> Any:
    """Values of points that broadcast, of which one at least is a Dr.Jit array.

    Parameters
    ----------
    compute : (points (..., d), which derivatives are wanted) -> values (...), and derivatives
        (..., d) in each of the points that want them, else None.
    points : (name, value); with components first, or tensors (..., d), or NumPy's.

    Returns a ``Float``, or a tensor (...) where one of the points is a tensor.

    Raises ArgumentError for other types, backends and numbers of components.
    """
    import drjit as dr

    real = common_float(points, None)
    check_request(real, dr.itemsize_v(real) == 8, None, "auto")
    inputs: list[tuple[Any, ...] | None] = []
    hosts: list[Any] = []
    for name, value in points:
        if not is_drjit(value):
            inputs.append(None)
            hosts.append(value)
            continue
        components, shape = components_of(name, value, real, dimension)
        inputs.append(tuple(components))
        hosts.append(_read(components, shape))
    wanted = [own is not None and dr.grad_enabled(own) for own in inputs]
    values, slopes = compute(hosts, wanted)
    shapes = [
        host.shape if own is not None else () for host, own in zip(hosts, inputs, strict=True)
    ]
    result = array_of(real, values)
    if any(wanted):
        result = with_derivatives(_rule(real, result, slopes, shapes), *inputs)
    tensors = [value for _, value in points if is_tensor(value)]
    flat = not tensors and values.ndim < 2
    like = tensors[0] if tensors else None
    return as_result(result, None if flat else values.shape, like, real)


def _rule(
    real: Any, result: Any, slopes: Sequence[Floats | None], shapes: Sequence[tuple[int, ...]]
) -> DerivativeRule:
    def forward(_: Any, changes: Any) -> Any:
        total: Any = 0.0
        for own, change, shape in zip(slopes, changes, shapes, strict=True):
            if own is not None:
                total = total + (own * _read(change, shape[:-1])).sum(axis=-1)
        return array_of(real, total)

    def reverse(_: Any, gradient: Any) -> Any:
        out = np.array(gradient, np.float64)
        found: list[Any] = []
        for own, shape in zip(slopes, shapes, strict=True):
            if own is None:
                found.append(None)
                continue
            size = int(np.prod(own.shape[:-1]))
            down = _summed_to(
                own * np.broadcast_to(out, size).reshape(own.shape[:-1])[..., None], shape
            )
            found.append(tuple(array_of(real, c) for c in down.reshape(-1, shape[-1]).T))
        return tuple(found)

    return DerivativeRule("values", lambda *_: result, forward, reverse)


def _summed_to(values: Floats, shape: tuple[int, ...]) -> Floats:
    """Sums over the axes along which an array of a shape was broadcast."""
    extra = values.ndim - len(shape)
    values = values.sum(axis=tuple(range(extra)))
    axes = tuple(k for k, n in enumerate(shape) if n == 1 and values.shape[k] > 1)
    return np.asarray(values.sum(axis=axes, keepdims=True))


def _read(components: Sequence[Any], shape: tuple[int, ...] | None) -> Floats:
    """Components as points (..., d), of no shape (n, d)."""
    import drjit as dr

    columns = [np.array(dr.detach(c), np.float64).ravel() for c in components]
    found = np.stack(np.broadcast_arrays(*columns), axis=-1)
    if shape is None:
        return found
    size = int(np.prod(shape))
    return np.broadcast_to(found, (size, len(columns))).reshape(*shape, len(columns))
