"""Components of points of any kind of Dr.Jit array, and results of that kind."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.chunks import array_of
from polywigner.execution.parameters import tensor_of
from polywigner.geometry.arguments import real_numbers


def is_drjit(value: Any) -> bool:
    """Whether a value is a Dr.Jit array; does not import Dr.Jit."""
    # Where another thread is importing it, the module is there without its names.
    is_array = getattr(sys.modules.get("drjit"), "is_array_v", None)
    return is_array is not None and is_array(value)


def is_tensor(value: Any) -> bool:
    import drjit

    return is_drjit(value) and drjit.is_tensor_v(value)


def own_float(name: str, value: Any) -> Any:
    """The one-dimensional float type behind a Dr.Jit array. Raises ArgumentError for others."""
    import drjit

    if not drjit.is_jit_v(value):
        raise ArgumentError(
            f"expected {name} as a Dr.Jit array of the LLVM or CUDA backend, got "
            f"{type(value).__name__}; pass NumPy arrays instead"
        )
    found = drjit.array_t(value) if is_tensor(value) else drjit.leaf_t(value)
    if not drjit.is_float_v(found) or drjit.itemsize_v(found) not in (4, 8):
        raise ArgumentError(
            f"expected {name} of 32 or 64 bit real floats, got {type(value).__name__}"
        )
    return found


def host_points(name: str, value: Any) -> NDArray[np.float64]:
    """Points that are no Dr.Jit array. Raises ArgumentError for other than real numbers."""
    try:
        return real_numbers(value)
    except ValueError as error:
        numbers = isinstance(value, np.ndarray) and not np.ma.is_masked(value)
        got = f"an array of {value.dtype}" if numbers else error
        raise ArgumentError(
            f"expected {name} as real numbers, components last, got {got}"
        ) from None


def nothing(float_type: Any) -> Any:
    """An array without entries."""
    import drjit

    return drjit.zeros(float_type, 0)


def common_width(components: Sequence[Any]) -> int:
    """How many points there are. Raises ArgumentError where arguments disagree."""
    import drjit

    widths = {drjit.width(component) for component in components}
    if len(widths - {1}) > 1:
        found = " and ".join(str(width) for width in sorted(widths))
        raise ArgumentError(
            f"expected as many points in each argument, or one, got {found}; pass arrays of one "
            "width"
        )
    return next(iter(widths - {1}), 1)


def point_components(name: str, value: Any, float_type: Any, dimension: int) -> tuple[Any, ...]:
    """The components of an array with components first, or of NumPy points (d,) or (n, d)."""
    if not is_drjit(value):
        array = host_points(name, value)
        if array.ndim not in (1, 2) or array.shape[-1] != dimension:
            hint = f"an array of shape {array.shape}; use ({dimension},) or (n, {dimension})"
            raise _wrong_components(name, dimension, hint)
        return tuple(array_of(float_type, row) for row in np.atleast_2d(array).T)
    import drjit

    if drjit.depth_v(value) == 1 and dimension == 1:
        return (value,)
    if drjit.depth_v(value) != 2 or len(value) != dimension:
        count = len(value) if drjit.depth_v(value) == 2 else f"an array {type(value).__name__}"
        hint = f"{count}; use Array{dimension}f, components first"
        raise _wrong_components(name, dimension, hint)
    return tuple(value[k] for k in range(dimension))


def tensor_components(
    points: Sequence[tuple[str, Any]], float_type: Any, dimension: int
) -> tuple[tuple[int, ...], list[Any]]:
    """The broadcast shape without the last axis, and the flat components of all points."""
    import drjit

    flats, shapes = [], []
    for name, value in points:
        if is_tensor(value):
            shape, flat = tuple(value.shape), value.array
        elif is_drjit(value):
            raise ArgumentError(
                f"expected {name} as a tensor like the other argument, got "
                f"{type(value).__name__}; use one kind of array for all points"
            )
        else:
            array = host_points(name, value)
            shape, flat = array.shape, array_of(float_type, array)
        if not shape or shape[-1] != dimension:
            hint = f"a tensor of shape {shape}; use (..., {dimension})"
            raise _wrong_components(name, dimension, hint)
        flats.append(flat)
        shapes.append(shape[:-1])
    try:
        shape = np.broadcast_shapes(*shapes)
    except ValueError:
        raise ArgumentError(f"expected shapes that broadcast, got {shapes}") from None
    if 0 in shape:
        return shape, [nothing(float_type)] * (dimension * len(points))
    index_type = drjit.uint32_array_t(float_type)
    components = []
    for flat, own in zip(flats, shapes, strict=True):
        where = array_of(index_type, np.broadcast_to(_indices(own), shape))
        components += [
            drjit.gather(float_type, flat, dimension * where + k) for k in range(dimension)
        ]
    return shape, components


def components_of(
    name: str, value: Any, float_type: Any, dimension: int
) -> tuple[list[Any], tuple[int, ...] | None]:
    """Components of points of any kind, and the shape without the last axis of what is a tensor."""
    if not is_drjit(value):
        value = tensor_of(float_type, host_points(name, value))
    if is_tensor(value):
        shape, found = tensor_components([(name, value)], float_type, dimension)
        return found, shape
    return list(point_components(name, value, float_type, dimension)), None


def plane_components(name: str, value: Any) -> tuple[list[Any], tuple[int, ...] | None]:
    """x and y of Dr.Jit points, and of tensors their shape without the last axis."""
    kind = own_float(name, value)
    if is_tensor(value):
        shape, found = tensor_components([(name, value)], kind, 2)
        return found, shape
    return list(point_components(name, value, kind, 2)), None


def in_plane(value: Any) -> Any:
    """The first two components of points with three; anything else as it is."""
    import drjit

    if is_tensor(value):
        return value[..., :2] if value.shape and value.shape[-1] == 3 else value
    if drjit.depth_v(value) == 2 and len(value) == 3:
        module = sys.modules[own_float("nu", value).__module__]
        double = drjit.itemsize_v(drjit.leaf_t(value)) == 8
        return (module.Array2f64 if double else module.Array2f)(value[0], value[1])
    return value


def shifted_points(points: Any, shift: Any) -> Any:
    """Points of any kind of Dr.Jit array, each moved by ``shift`` (d,)."""
    import drjit

    if drjit.width(points) == 0:
        return points
    offset = np.asarray(shift, dtype=np.float64)
    if is_tensor(points):
        if not points.shape or points.shape[-1] != len(offset):
            return points  # refused with advice further on
        flat = points.array
        component = drjit.arange(drjit.uint32_array_t(type(flat)), len(flat)) % len(offset)
        table = drjit.gather(type(flat), array_of(type(flat), offset), component)
        return type(points)(flat + table, points.shape)
    if drjit.depth_v(points) == 2 and len(points) == len(offset):
        return type(points)(*(points[k] + value for k, value in enumerate(offset.tolist())))
    return points + float(offset[0]) if drjit.depth_v(points) == 1 and len(offset) == 1 else points


def _wrong_components(name: str, dimension: int, got: object) -> ArgumentError:
    plural = "s" if dimension > 1 else ""
    return ArgumentError(f"expected {name} with {dimension} component{plural}, got {got}")


def _indices(shape: tuple[int, ...]) -> Any:
    return np.arange(int(np.prod(shape)), dtype=np.uint32).reshape(shape)


def as_complex(results: tuple[Any, Any], shape: tuple[int, ...] | None, like: Any) -> Any:
    """Real and imaginary parts as the kind of complex result that points ``like`` give."""
    if shape is not None:
        return as_tensor(results, shape, [("", like)])
    float_type = type(results[0])
    module = sys.modules[float_type.__module__]
    double = sys.modules["drjit"].itemsize_v(float_type) == 8
    return (module.Complex2f64 if double else module.Complex2f)(*results)


def as_result(value: Any, shape: tuple[int, ...] | None, like: Any, float_type: Any) -> Any:
    """A real result for points of a kind: a ``Float``, or a tensor of a shape."""
    if shape is None:
        return value
    kind = type(like) if is_drjit(like) else type(tensor_of(float_type, [0.0]))
    return kind(value, shape)


def from_components(
    values: np.ndarray, float_type: Any, tensor: tuple[Any, tuple[int, ...]] | None
) -> Any:
    """NumPy values as a ``Float``, a ``Complex2f`` or, of (type, shape), a tensor."""
    is_complex = np.iscomplexobj(values)
    parts = (values.real, values.imag) if is_complex else (values,)
    floats = tuple(array_of(float_type, part) for part in parts)
    if tensor is not None:
        return as_tensor_of(tensor[0], floats, tensor[1])
    return as_complex((floats[0], floats[1]), None, None) if is_complex else floats[0]


def as_tensor(results: tuple[Any, ...], shape: tuple[int, ...], points: Any) -> Any:
    tensor_type = next(type(value) for _, value in points if is_tensor(value))
    return as_tensor_of(tensor_type, results, shape)


def as_tensor_of(tensor_type: Any, results: tuple[Any, ...], shape: tuple[int, ...]) -> Any:
    import drjit

    if len(results) == 1 or 0 in shape:
        return tensor_type(results[0], (*shape, 2)[: len(shape) + len(results) - 1])
    flat = drjit.empty(type(results[0]), 2 * int(np.prod(shape)))
    index = drjit.arange(drjit.uint32_array_t(type(results[0])), int(np.prod(shape)))
    for k, part in enumerate(results):
        drjit.scatter(flat, part, 2 * index + k)
    return tensor_type(flat, (*shape, 2))


def times_complex(value: Any, factor: Any) -> Any:
    """A complex result of any kind (NumPy, ``Complex2f``, tensor (..., 2)) times a number.

    Of Dr.Jit, ``factor`` may have arrays of one entry as real and imaginary part.
    """
    if not is_drjit(value):
        if factor.imag:
            return value * factor
        # By parts: the product with a complex number makes NaN of an infinite value.
        scaled = np.array(value)
        scaled.real *= factor.real
        scaled.imag *= factor.real
        return scaled[()]
    import drjit

    if not drjit.width(value):
        return value
    if not is_tensor(value):
        return value * type(value)(factor.real, factor.imag)
    flat = value.array
    index = drjit.arange(drjit.uint32_array_t(type(flat)), len(flat))
    other = drjit.gather(type(flat), flat, index ^ 1)  # the imaginary part's place is odd
    imag = type(flat)(factor.imag)  # a choice between Python's floats is one of float32
    signed = drjit.select(index & 1 == 1, imag, -imag) * other
    return type(value)(flat * factor.real + signed, value.shape)


def product_of_complex(a: Any, b: Any) -> Any:
    """The product of two complex results of one kind, shape and type."""
    if not is_tensor(a):
        return a * b
    import drjit

    if not len(a.array):
        return a
    kind = type(a.array)
    even = 2 * drjit.arange(drjit.uint32_array_t(kind), len(a.array) // 2)
    a_real, a_imag, b_real, b_imag = (
        drjit.gather(kind, value.array, even + odd) for value in (a, b) for odd in (0, 1)
    )
    flat = drjit.empty(kind, len(a.array))
    drjit.scatter(flat, a_real * b_real - a_imag * b_imag, even)
    drjit.scatter(flat, a_real * b_imag + a_imag * b_real, even + 1)
    return type(a)(flat, a.shape)
