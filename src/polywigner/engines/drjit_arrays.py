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
from polywigner.engines.by_cell import sorts, traced_by_cell
from polywigner.engines.gradients import differentiable
from polywigner.engines.operations import DrjitOperations
from polywigner.engines.parameters import Parameters, Traced, tensor_of
from polywigner.engines.ranges import aligned
from polywigner.engines.table_data import TracedOperations, as_data
from polywigner.errors import ArgumentError
from polywigner.kernels import Kernel

__all__ = [
    "as_complex",
    "as_result",
    "checked_float",
    "components_of",
    "evaluate_traced",
    "from_components",
    "in_plane",
    "is_drjit",
    "own_float",
    "plane_components",
    "product_of_complex",
    "shifted_points",
    "times_complex",
]


# A kernel with edges as code is 3 to 4 times as fast as one that reads them, which gains more than
# the 0.2 to 1 s that it takes to compile for each new outline from so many samples on.
_WORTH_COMPILING = 1 << 22


def is_drjit(value: Any) -> bool:
    """Whether a value is a Dr.Jit array; does not import Dr.Jit."""
    return "drjit" in sys.modules and sys.modules["drjit"].is_array_v(value)


def evaluate_traced(
    kernel: Kernel,
    source: Any,
    points: Sequence[tuple[str, Any]],
    *,
    precision: str | None,
    engine: str,
    complex_result: bool,
    parameters: Parameters | None = None,
) -> Any:
    """Result of a kernel whose arguments are points, at least one of them a Dr.Jit array.

    ``points`` are (name, value); what is not a Dr.Jit array is converted to the arrays' type.
    ``parameters``: numbers of the source that are Dr.Jit arrays, of the same type.

    Raises
    ------
    ArgumentError when types, backends or precisions disagree, or a point has the wrong number
    of components.
    EngineError when the arrays are LLVM's and no usable LLVM library is loaded.
    """
    float_type = _common_float(points, parameters)
    if not any(is_drjit(value) for _, value in points):
        points = [(name, tensor_of(float_type, value)) for name, value in points]
    ops = DrjitOperations(float_type)
    _check_request(float_type, ops.double, precision, engine)
    tensors = any(_is_tensor(value) for _, value in points)
    if tensors:
        shape, components = _tensor_components(points, float_type, kernel.dimension)
    else:
        components = [
            component
            for name, value in points
            for component in _components(name, value, float_type, kernel.dimension)
        ]
    tables = _tables(kernel, source, ops.double, parameters)
    if parameters is None and sorts(kernel, tables, float_type, components):
        results = traced_by_cell(kernel, tables, float_type, components)
    else:
        traced = Traced() if parameters is None else parameters.traced(ops, tables)
        if parameters is not None and _is_data(parameters, components):
            ops = TracedOperations(float_type)
            tables = as_data(ops, tables)
        results = differentiable(kernel, ops, tables, components, traced)
    if tensors:
        return _as_tensor(results, shape, points)
    if complex_result:
        return as_complex(results, None, None)
    return results[0]


def _tables(kernel: Kernel, source: Any, double: bool, parameters: Parameters | None) -> Any:
    """Those of the kernel, with vertices numbered as the parameters are.

    Equal apertures may begin their rings elsewhere, and share tables of the cache.
    """
    if parameters is None or parameters.vertices is None:
        return kernel.tables(source, double)
    return getattr(kernel.tables, "__wrapped__", kernel.tables)(source, double)


def _is_data(parameters: Parameters, components: Sequence[Any]) -> bool:
    """Whether a source is better data of a kernel than its code."""
    import drjit

    changes = parameters.vertices is not None or parameters.fields is not None
    return changes and max(map(drjit.width, components)) < _WORTH_COMPILING


def own_float(name: str, value: Any) -> Any:
    """The float type behind a Dr.Jit array. Raises ArgumentError for other types."""
    return _float_type(name, value)


def components_of(
    name: str, value: Any, float_type: Any, dimension: int
) -> tuple[list[Any], tuple[int, ...] | None]:
    """Components of points of any kind, and the shape without the last axis of what is a tensor."""
    if not is_drjit(value):
        value = tensor_of(float_type, value)
    if _is_tensor(value):
        shape, found = _tensor_components([(name, value)], float_type, dimension)
        return found, shape
    return list(_components(name, value, float_type, dimension)), None


def as_result(value: Any, shape: tuple[int, ...] | None, like: Any, float_type: Any) -> Any:
    """A real result for points of a kind: a ``Float``, or a tensor of a shape."""
    if shape is None:
        return value
    kind = type(like) if is_drjit(like) else type(tensor_of(float_type, [0.0]))
    return kind(value, shape)


def plane_components(name: str, value: Any) -> tuple[list[Any], tuple[int, ...] | None]:
    """x and y of Dr.Jit points, and of tensors their shape without the last axis."""
    kind = _float_type(name, value)
    if _is_tensor(value):
        shape, found = _tensor_components([(name, value)], kind, 2)
        return found, shape
    return list(_components(name, value, kind, 2)), None


def as_complex(results: tuple[Any, Any], shape: tuple[int, ...] | None, like: Any) -> Any:
    """Real and imaginary parts as the kind of complex result that points ``like`` give."""
    if shape is not None:
        return _as_tensor(results, shape, [("", like)])
    float_type = type(results[0])
    module = sys.modules[float_type.__module__]
    double = sys.modules["drjit"].itemsize_v(float_type) == 8
    return (module.Complex2f64 if double else module.Complex2f)(*results)


def in_plane(value: Any) -> Any:
    """The first two components of points with three; anything else as it is."""
    import drjit

    if _is_tensor(value):
        return value[..., :2] if value.shape and value.shape[-1] == 3 else value
    if drjit.depth_v(value) == 2 and len(value) == 3:
        module = sys.modules[_float_type("nu", value).__module__]
        double = drjit.itemsize_v(drjit.leaf_t(value)) == 8
        return (module.Array2f64 if double else module.Array2f)(value[0], value[1])
    return value


def shifted_points(points: Any, shift: Any) -> Any:
    """Points of any kind of Dr.Jit array, each moved by ``shift`` (d,)."""
    import drjit

    offset = np.asarray(shift, dtype=np.float64).tolist()
    if _is_tensor(points):
        if not points.shape or points.shape[-1] != len(offset):
            return points  # refused with advice further on
        flat = points.array
        component = drjit.arange(drjit.uint32_array_t(type(flat)), len(flat)) % len(offset)
        table = drjit.gather(type(flat), type(flat)(offset), component)
        return type(points)(flat + table, points.shape)
    if drjit.depth_v(points) == 2 and len(points) == len(offset):
        return type(points)(*(points[k] + value for k, value in enumerate(offset)))
    return points + offset[0] if drjit.depth_v(points) == 1 and len(offset) == 1 else points


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
    if not _is_tensor(value):
        return value * type(value)(factor.real, factor.imag)
    import drjit

    flat = value.array
    index = drjit.arange(drjit.uint32_array_t(type(flat)), len(flat))
    other = drjit.gather(type(flat), flat, index ^ 1)  # the imaginary part's place is odd
    signed = drjit.select(index & 1 == 1, factor.imag, -factor.imag) * other
    return type(value)(flat * factor.real + signed, value.shape)


def product_of_complex(a: Any, b: Any) -> Any:
    """The product of two complex results of one kind, shape and type."""
    if not _is_tensor(a):
        return a * b
    import drjit

    kind = type(a.array)
    even = 2 * drjit.arange(drjit.uint32_array_t(kind), len(a.array) // 2)
    a_real, a_imag, b_real, b_imag = (
        drjit.gather(kind, value.array, even + odd) for value in (a, b) for odd in (0, 1)
    )
    flat = drjit.empty(kind, len(a.array))
    drjit.scatter(flat, a_real * b_real - a_imag * b_imag, even)
    drjit.scatter(flat, a_real * b_imag + a_imag * b_real, even + 1)
    return type(a)(flat, a.shape)


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


def checked_float(name: str, value: Any, precision: str | None, engine: str) -> tuple[Any, bool]:
    """The float type behind an array, and whether it is double. Raises ArgumentError."""
    import drjit

    found = _float_type(name, value)
    double = drjit.itemsize_v(found) == 8
    _check_request(found, double, precision, engine)
    return found, double


def from_components(
    values: np.ndarray, float_type: Any, double: bool, tensor: tuple[Any, tuple[int, ...]] | None
) -> Any:
    """NumPy values as a ``Float``, a ``Complex2f`` or, of (type, shape), a tensor."""
    is_complex = np.iscomplexobj(values)
    parts = (values.real, values.imag) if is_complex else (values,)
    floats = [
        float_type(np.array(part, np.float64 if double else np.float32).ravel()) for part in parts
    ]
    if tensor is not None:
        return _as_tensor_of(tensor[0], tuple(floats), tensor[1])
    if not is_complex:
        return floats[0]
    module = sys.modules[float_type.__module__]
    return (module.Complex2f64 if double else module.Complex2f)(*floats)


def _common_float(points: Sequence[tuple[str, Any]], parameters: Parameters | None) -> Any:
    types = {_float_type(name, value) for name, value in points if is_drjit(value)}
    types |= set() if parameters is None else parameters.types
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


def _wrong_components(name: str, dimension: int, got: object) -> ArgumentError:
    plural = "s" if dimension > 1 else ""
    return ArgumentError(f"expected {name} with {dimension} component{plural}, got {got}")


def _components(name: str, value: Any, float_type: Any, dimension: int) -> tuple[Any, ...]:
    """The components of an array with components first, or of NumPy points (d,) or (n, d)."""
    if not is_drjit(value):
        array = np.asarray(value, dtype=np.float64)
        if array.ndim not in (1, 2) or array.shape[-1] != dimension:
            hint = f"an array of shape {array.shape}; use ({dimension},) or (n, {dimension})"
            raise _wrong_components(name, dimension, hint)
        return tuple(float_type(np.array(row)) for row in np.atleast_2d(array).T)
    import drjit

    if drjit.depth_v(value) == 1 and dimension == 1:
        return (value,)
    if drjit.depth_v(value) != 2 or len(value) != dimension:
        count = len(value) if drjit.depth_v(value) == 2 else f"an array {type(value).__name__}"
        hint = f"{count}; use Array{dimension}f, components first"
        raise _wrong_components(name, dimension, hint)
    return tuple(value[k] for k in range(dimension))


def _tensor_components(
    points: Sequence[tuple[str, Any]], float_type: Any, dimension: int
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
        if not shape or shape[-1] != dimension:
            hint = f"a tensor of shape {shape}; use (..., {dimension})"
            raise _wrong_components(name, dimension, hint)
        flats.append(flat)
        shapes.append(shape[:-1])
    try:
        shape = np.broadcast_shapes(*shapes)
    except ValueError:
        raise ArgumentError(f"expected shapes that broadcast, got {shapes}") from None
    index_type = drjit.uint32_array_t(float_type)
    components = []
    for flat, own in zip(flats, shapes, strict=True):
        memory = aligned(int(np.prod(shape)), np.uint32)
        memory[...] = np.broadcast_to(_indices(own), shape).ravel()
        where = index_type(memory)
        components += [
            drjit.gather(float_type, flat, dimension * where + k) for k in range(dimension)
        ]
    return shape, components


def _indices(shape: tuple[int, ...]) -> Any:
    return np.arange(int(np.prod(shape)), dtype=np.uint32).reshape(shape)


def _as_tensor(results: tuple[Any, ...], shape: tuple[int, ...], points: Any) -> Any:
    tensor_type = next(type(value) for _, value in points if _is_tensor(value))
    return _as_tensor_of(tensor_type, results, shape)


def _as_tensor_of(tensor_type: Any, results: tuple[Any, ...], shape: tuple[int, ...]) -> Any:
    import drjit

    if len(results) == 1:
        return tensor_type(results[0], shape)
    flat = drjit.empty(type(results[0]), 2 * int(np.prod(shape)))
    index = drjit.arange(drjit.uint32_array_t(type(results[0])), int(np.prod(shape)))
    for k, part in enumerate(results):
        drjit.scatter(flat, part, 2 * index + k)
    return tensor_type(flat, (*shape, 2))
