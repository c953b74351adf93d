"""Conversion of the Dr.Jit arrays of callers to component arrays, and of results to tensors.

Callers pass points as component arrays (``Point2f``, ``Array2f``, ``ArrayXf`` with two rows,
``Float`` in one dimension) or as a ``TensorXf`` with the components on the last axis. The result is
a ``Float`` or ``Complex2f``, or a tensor without the last axis. Complex tensors have an additional
last axis for the real and the imaginary part.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import llvm
from polywigner.errors import ArgumentError
from polywigner.execution.chunks import array_of
from polywigner.execution.drjit_operations import DrjitOperations
from polywigner.execution.operations import Drjit, Numbers, is_drjit
from polywigner.geometry.arguments import broadcast_shape, real_numbers
from polywigner.numerics.chirps import waves_of_cycles
from polywigner.numerics.phases import cos_sin_cycles

Points = Mapping[str, Any]
"""Points, with the names of the arguments as keys."""


def _is_tensor(value: Any) -> bool:
    """Return whether a value is a Dr.Jit tensor."""
    return is_drjit(value) and bool(sys.modules["drjit"].is_tensor_v(value))


def sibling(float_type: type, name: str) -> Callable[..., Drjit]:
    """Return the Dr.Jit type ``name`` with the backend and precision of a float type.

    ``name`` is the name of the type in single precision, such as "Array2f".
    """
    suffix = "64" if float_type.__name__.endswith("64") else ""
    kind: Callable[..., Drjit] = getattr(sys.modules[float_type.__module__], name + suffix)
    return kind


def _float_of(name: str, value: Drjit) -> type:
    """Return the float type of a Dr.Jit array. Raises ArgumentError if entries are not floats."""
    import drjit

    if not drjit.is_jit_v(value):
        raise ArgumentError(
            f"expected {name} to be a Dr.Jit array of the LLVM or CUDA backend, got "
            f"{type(value).__name__}; pass such an array, or NumPy arrays"
        )
    kind: type = drjit.array_t(value) if _is_tensor(value) else drjit.leaf_t(value)
    if not drjit.is_float_v(kind) or drjit.itemsize_v(kind) not in (4, 8):
        raise ArgumentError(
            f"expected {name} to be a Dr.Jit array of 32-bit or 64-bit floats, got "
            f"{type(value).__name__}"
        )
    return kind


def _common_float(arrays: Points, precision: str | None, engine: str) -> type:
    """Return the common float type of arrays.

    Raises ArgumentError if the types differ from each other or from the options of a call, and
    EngineError if no usable LLVM library is loaded.
    """
    types = {_float_of(name, value) for name, value in arrays.items()}
    if len(types) > 1:
        names = " and ".join(sorted(f"{t.__module__}.{t.__name__}" for t in types))
        raise ArgumentError(
            f"expected Dr.Jit arrays with the same backend and precision, got {names}; convert "
            "one of them"
        )
    float_type = types.pop()
    actual = "double" if float_type.__name__.endswith("64") else "single"
    if precision not in (None, actual):
        raise ArgumentError(
            f"expected precision={actual!r} or None for arrays of type {float_type.__name__}, "
            f"got {precision!r}; to change the precision, convert the arrays"
        )
    backend = "cuda" if ".cuda" in float_type.__module__ else "llvm"
    if engine not in ("auto", backend):
        raise ArgumentError(
            f"expected engine={backend!r} or 'auto' for arrays of {float_type.__module__}, "
            f"got {engine!r}; to use another engine, convert the arrays"
        )
    if backend == "llvm":
        llvm.require()
    return float_type


def component_arrays(
    points: Points, parameters: Points, precision: str | None, engine: str
) -> tuple[dict[str, Drjit], Callable[[Drjit], Drjit]]:
    """Return points as component arrays, and a function that converts results for the caller.

    The function returns the kind of Dr.Jit array that the caller uses for points. Points that are
    not Dr.Jit arrays are converted like component arrays if another argument is a component array,
    and like tensors otherwise. Complex tensors have a last axis of length 2.

    Parameters
    ----------
    points : mapping
        Points, with the names of the arguments as keys.
    parameters : mapping
        Dr.Jit arrays of the source, with their names as keys.
    precision, engine : str
        Options of the call, with which the types of the arrays must agree.

    Raises
    ------
    ArgumentError
        If types, backends, precisions or numbers of points disagree.
    EngineError
        If the arrays use the LLVM backend and no usable LLVM library is loaded.
    """
    import drjit

    drjit_points = {name: value for name, value in points.items() if is_drjit(value)}
    float_type = _common_float({**parameters, **drjit_points}, precision, engine)
    tensor = next((type(value) for value in drjit_points.values() if _is_tensor(value)), None)
    shape: tuple[int, ...] | None = None
    if drjit_points and tensor is None:
        arrays = {name: _component_array(name, p, float_type) for name, p in points.items()}
    else:
        arrays, shape = _from_tensors(points, float_type)
    widths = {drjit.width(array) for array in arrays.values()}
    if len(widths - {1}) > 1:
        raise ArgumentError(
            "expected the same number of points in each argument, or a single point, got "
            f"{' and '.join(map(str, sorted(widths)))} points; pass arrays with equal numbers "
            "of points"
        )
    size = 0 if 0 in widths else max(widths)
    # Dr.Jit cannot add a number to an empty array, so results are computed for a single point.
    if not size:
        arrays = {name: drjit.zeros(type(array), 1) for name, array in arrays.items()}

    def restored(value: Drjit) -> Drjit:
        """Return a result with one entry per point, as an array or a tensor."""
        if not size:
            value = drjit.zeros(type(value), 0)
        elif drjit.width(value) != size:
            value = value + drjit.zeros(type(value), size)
        if shape is None:
            return value
        last = (2,) if drjit.is_complex_v(value) else ()
        flat = value
        if last:
            flat = drjit.ravel(value) if size else drjit.zeros(float_type, 0)
        return (tensor or sibling(float_type, "TensorXf"))(flat, (*shape, *last))

    return arrays, restored


def _component_array(name: str, value: Any, float_type: type) -> Drjit:
    """Return points as a component array, or raise ArgumentError."""
    import drjit

    if not is_drjit(value):
        array = _numpy_points(name, value)
        if array.ndim not in (1, 2) or not 0 < array.shape[-1] < 4:
            raise ArgumentError(
                f"expected {name} of shape (d,) or (n, d), because the other argument has d "
                f"components, got an array of shape {array.shape}"
            )
        return joined([array_of(float_type, column) for column in np.atleast_2d(array).T])
    if drjit.depth_v(value) == 1:
        return value
    return joined([value[k] for k in range(len(value))])


def _from_tensors(points: Points, float_type: type) -> tuple[dict[str, Drjit], tuple[int, ...]]:
    """Return points in tensors as flat component arrays, and their shape without components.

    Raises ArgumentError if an argument is neither a tensor nor an array with 1 to 3 components, or
    if the shapes do not broadcast.
    """
    import drjit

    flat: dict[str, Drjit] = {}
    shapes: dict[str, tuple[int, ...]] = {}
    for name, value in points.items():
        if _is_tensor(value):
            shapes[name], flat[name] = tuple(value.shape), value.array
        elif is_drjit(value):
            raise ArgumentError(
                f"expected {name} to be a tensor, like the other argument, got "
                f"{type(value).__name__}; use one kind of array for all points"
            )
        else:
            array = _numpy_points(name, value)
            shapes[name], flat[name] = array.shape, array_of(float_type, array)
        if not shapes[name] or not 0 < shapes[name][-1] < 4:
            raise ArgumentError(
                f"expected {name} with 1 to 3 components on its last axis, got shape {shapes[name]}"
            )
    shape = broadcast_shape(*(full[:-1] for full in shapes.values()))
    arrays = {}
    for name, (*before, dimension) in shapes.items():
        kind: Any = float_type if dimension == 1 else sibling(float_type, f"Array{dimension}f")
        if 0 in shape:
            arrays[name] = drjit.zeros(kind, 0)
            continue
        numbers = np.arange(int(np.prod(before)), dtype=np.uint32).reshape(before)
        index = array_of(drjit.uint32_array_t(float_type), np.broadcast_to(numbers, shape))
        arrays[name] = drjit.gather(kind, flat[name], index)
    return arrays, shape


def _numpy_points(name: str, value: Any) -> NDArray[np.float64]:
    """Return real numbers of any shape, possibly NaN or infinite, as a float64 NumPy array.

    Raises ArgumentError for other values, with ``name`` in the message. Arrays of other
    libraries are converted.
    """
    try:
        return real_numbers(value)
    except ValueError as error:
        numbers = isinstance(value, np.ndarray) and not np.ma.is_masked(value)
        got = f"an array of {value.dtype}" if numbers else error
        raise ArgumentError(
            f"expected {name} to be real numbers with the components on the last axis, got {got}"
        ) from None


def components_of(name: str, point: Drjit, dimension: int) -> list[Drjit]:
    """Return the ``dimension`` components of a component array, or raise ArgumentError."""
    components = split(point)
    if len(components) != dimension:
        plural = "s" if dimension > 1 else ""
        raise ArgumentError(
            f"expected {name} with {dimension} component{plural}, got {len(components)}; pass "
            f"an Array{dimension}f, or a tensor of shape (..., {dimension})"
        )
    return components


def split(point: Any) -> list[Any]:
    """Return the components of NumPy points, shape (..., d), or of a Dr.Jit component array."""
    if isinstance(point, np.ndarray):
        return [point[..., k] for k in range(point.shape[-1])]
    return [point] if sys.modules["drjit"].depth_v(point) == 1 else list(point)


def joined(components: Sequence[Any]) -> Numbers:
    """Return points with the specified components. This is the inverse of :func:`split`."""
    if not is_drjit(components[0]):
        return np.stack(np.broadcast_arrays(*components), axis=-1)
    if len(components) == 1:
        return components[0]
    return sibling(type(components[0]), f"Array{len(components)}f")(*components)


def shifted(point: Drjit, shift: NDArray[np.float64]) -> Drjit:
    """Return a component array, translated by the vector ``shift``."""
    components = components_of("nu", point, len(shift))
    return joined([c + s for c, s in zip(components, shift.tolist(), strict=True)])


def matrix_times(matrix: NDArray[np.float64], components: Sequence[Any]) -> list[Any]:
    """Return the components of matrix × vector, without multiplications by zero."""
    return [
        sum((c * m for c, m in zip(components, row, strict=True) if m), 0.0)
        for row in matrix.tolist()
    ]


def unit_wave(cycles: Numbers) -> Numbers:
    """Return exp(2 pi i cycles) as a complex NumPy array or a ``Complex2f``."""
    if not is_drjit(cycles):
        return waves_of_cycles(cycles)
    cosine, sine = cos_sin_cycles(DrjitOperations(type(cycles)), cycles)
    return sibling(type(cycles), "Complex2f")(cosine, sine)


def times_complex(value: Numbers, factor: complex) -> Numbers:
    """Return a complex NumPy array or a ``Complex2f`` times a number."""
    if is_drjit(value):
        return value * type(value)(factor.real, factor.imag)
    return value * factor


def numbers_of(name: str, value: Any, kind: str) -> Drjit:
    """Return the vertices of a source as an ``Array2f``, or its weights as a ``Complex2f``.

    ``kind`` is the name of the type. Vertices may also be a tensor of shape (n, 2). Weights may
    also be a ``Float``, or a tensor of shape (n,) or (n, 2). Raises ArgumentError for other values.
    """
    is_complex, got = kind == "Complex2f", type(value).__name__
    if is_drjit(value):
        import drjit

        if _is_tensor(value):
            if value.ndim == 2 and value.shape[1] == 2 and drjit.is_float_v(value):
                return drjit.unravel(sibling(type(value.array), kind), value.array)
            got = f"a tensor of shape {tuple(value.shape)}"
            value = value.array if is_complex and value.ndim == 1 else None
        if drjit.is_jit_v(value) and drjit.is_float_v(value):
            pair = sibling(drjit.leaf_t(value), kind)
            if is_complex and drjit.depth_v(value) == 1:
                return pair(value, drjit.zeros(type(value), drjit.width(value)))
            if drjit.depth_v(value) == len(value) == 2 and drjit.is_complex_v(value) == is_complex:
                # The addition of zeros broadcasts both parts to the same width.
                return pair(value[0], value[1]) + drjit.zeros(pair, drjit.width(value))
    forms = "a Float, or a tensor (n,) or (n, 2)" if is_complex else "or a tensor (n, 2)"
    raise ArgumentError(
        f"expected {name} to be a Dr.Jit {kind}, {forms}, with floats of the LLVM or CUDA "
        f"backend, got {got}; convert the numbers, or build the source from plain numbers"
    )


def columns_of(pairs: Drjit) -> NDArray[np.float64]:
    """Return the current values of an ``Array2f`` or ``Complex2f``, shape (n, 2)."""
    import drjit

    parts = [np.array(drjit.detach(pairs[k]), np.float64).ravel() for k in (0, 1)]
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def entries(pairs: Drjit, index: NDArray[np.integer[Any]]) -> Drjit:
    """Return the entries of an ``Array2f`` or ``Complex2f`` with the specified indices."""
    import drjit

    numbers = array_of(drjit.uint32_array_t(type(pairs[0])), index)
    return drjit.gather(type(pairs), pairs, numbers)
