"""Kernels on Dr.Jit arrays: arrays of the caller's own type in and out, traced, differentiable.

Points come as components first (``Point2f``, ``Array2f``, ``ArrayXf`` of two rows) or as
``TensorXf`` with the components last; the result is a ``Float``, or a tensor without the last
axis. Complex results come as Dr.Jit's ``Complex2f``; for tensors as a tensor of shape (..., 2)
with real and imaginary part last, since Dr.Jit has no complex tensors.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from polywigner.engines import llvm
from polywigner.engines.operations import DrjitOperations
from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture
from polywigner.kernels import Kernel, tables_of

__all__ = ["evaluate_traced", "is_drjit"]


def is_drjit(value: Any) -> bool:
    """Whether a value is a Dr.Jit array; does not import Dr.Jit."""
    return "drjit" in sys.modules and sys.modules["drjit"].is_array_v(value)


def evaluate_traced(
    kernel: Kernel,
    aperture: Aperture,
    points: Sequence[tuple[str, Any]],
    *,
    precision: str | None,
    engine: str,
    complex_result: bool,
) -> Any:
    """Result of a kernel whose arguments are points, at least one of them a Dr.Jit array.

    ``points`` are (name, value); what is not a Dr.Jit array is converted to the arrays' type.

    Raises
    ------
    ArgumentError when types, backends or precisions disagree, or a point has not two components.
    EngineError when the arrays are LLVM's and no usable LLVM library is loaded.
    """
    float_type = _common_float(points)
    ops = DrjitOperations(float_type)
    _check_request(float_type, ops.double, precision, engine)
    tensors = any(_is_tensor(value) for _, value in points)
    if tensors:
        shape, components = _tensor_components(points, float_type)
    else:
        components = [c for name, value in points for c in _components(name, value, float_type)]
    results = kernel(ops, tables_of(aperture, ops.double), *components)
    if tensors:
        return _as_tensor(results, shape, points)
    if complex_result:
        module = sys.modules[float_type.__module__]
        return (module.Complex2f64 if ops.double else module.Complex2f)(*results)
    return results[0]


def _is_tensor(value: Any) -> bool:
    import drjit

    return is_drjit(value) and drjit.is_tensor_v(value)


def _float_type(name: str, value: Any) -> Any:
    """The one-dimensional float type behind a Dr.Jit array of any shape."""
    import drjit

    if not drjit.is_jit_v(value):
        raise ArgumentError(
            f"expected {name} as a Dr.Jit array of the LLVM or CUDA backend, got "
            f"{type(value).__name__}; pass NumPy arrays instead"
        )
    found = drjit.array_t(value) if _is_tensor(value) else drjit.leaf_t(value)
    if not drjit.is_float_v(found) or drjit.itemsize_v(found) not in (4, 8):
        raise ArgumentError(
            f"expected {name} of 32 or 64 bit real floats, got {type(value).__name__}"
        )
    return found


def _common_float(points: Sequence[tuple[str, Any]]) -> Any:
    types = {_float_type(name, value) for name, value in points if is_drjit(value)}
    if len(types) > 1:
        found = " and ".join(sorted(f"{t.__module__}.{t.__name__}" for t in types))
        raise ArgumentError(
            f"expected arrays of one backend and precision, got {found}; convert one of them"
        )
    return types.pop()


def _check_request(float_type: Any, double: bool, precision: str | None, engine: str) -> None:
    own = "double" if double else "single"
    if precision not in (None, own):
        raise ArgumentError(
            f"expected precision={own!r} or None for arrays of {float_type.__name__}, got "
            f"{precision!r}; convert the arrays instead"
        )
    backend = "cuda" if ".cuda" in float_type.__module__ else "llvm"
    if engine not in ("auto", backend):
        raise ArgumentError(
            f"expected engine={backend!r} or 'auto' for arrays of {float_type.__module__}, got "
            f"{engine!r}; convert the arrays instead"
        )
    if backend == "llvm":
        llvm.require()


def _wrong_components(name: str, count: object) -> ArgumentError:
    return ArgumentError(f"expected {name} with 2 components, got {count}")


def _components(name: str, value: Any, float_type: Any) -> tuple[Any, Any]:
    """The two components of an array with components first, or of a NumPy point (..., 2)."""
    if not is_drjit(value):
        array = np.asarray(value, dtype=np.float64)
        if array.ndim not in (1, 2) or array.shape[-1] != 2:
            raise _wrong_components(name, f"an array of shape {array.shape}; use (2,) or (n, 2)")
        rows = np.atleast_2d(array).T
        return float_type(np.array(rows[0])), float_type(np.array(rows[1]))
    import drjit

    if drjit.depth_v(value) != 2 or len(value) != 2:
        count = len(value) if drjit.depth_v(value) == 2 else f"an array {type(value).__name__}"
        raise _wrong_components(name, f"{count}; use Point2f or Array2f")
    return value[0], value[1]


def _tensor_components(
    points: Sequence[tuple[str, Any]], float_type: Any
) -> tuple[tuple[int, ...], list[Any]]:
    """The broadcast shape without the last axis, and the flat components of all points."""
    import drjit

    flats, shapes = [], []
    for name, value in points:
        if _is_tensor(value):
            shape, flat = tuple(value.shape), value.array
        elif is_drjit(value):
            raise ArgumentError(
                f"expected {name} as a tensor like the other argument, got "
                f"{type(value).__name__}; use one kind of array for all points"
            )
        else:
            array = np.asarray(value, dtype=np.float64)
            shape, flat = array.shape, float_type(np.array(array.ravel()))
        if not shape or shape[-1] != 2:
            raise _wrong_components(name, f"a tensor of shape {shape}; use (..., 2)")
        flats.append(flat)
        shapes.append(shape[:-1])
    try:
        shape = np.broadcast_shapes(*shapes)
    except ValueError:
        raise ArgumentError(f"expected shapes that broadcast, got {shapes}") from None
    index_type = drjit.uint32_array_t(float_type)
    components = []
    for flat, own in zip(flats, shapes, strict=True):
        where = index_type(np.broadcast_to(_indices(own), shape).ravel().copy())
        components += [drjit.gather(float_type, flat, 2 * where + k) for k in (0, 1)]
    return shape, components


def _indices(shape: tuple[int, ...]) -> Any:
    return np.arange(int(np.prod(shape)), dtype=np.uint32).reshape(shape)


def _as_tensor(results: tuple[Any, ...], shape: tuple[int, ...], points: Any) -> Any:
    import drjit

    tensor_type = next(type(value) for _, value in points if _is_tensor(value))
    if len(results) == 1:
        return tensor_type(results[0], shape)
    flat = drjit.empty(type(results[0]), 2 * int(np.prod(shape)))
    index = drjit.arange(drjit.uint32_array_t(type(results[0])), int(np.prod(shape)))
    for k, part in enumerate(results):
        drjit.scatter(flat, part, 2 * index + k)
    return tensor_type(flat, (*shape, 2))
