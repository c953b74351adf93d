"""Dr.Jit arrays of any kind: points and numbers as components, and results of the same kind.

Points come as components first (``Point2f``, ``Array2f``, ``ArrayXf`` of two rows) or as
``TensorXf`` with the components last; the result is a ``Float``, or a tensor without the last
axis. Complex results come as Dr.Jit's ``Complex2f``; for tensors as a tensor of shape (..., 2)
with real and imaginary part last, since Dr.Jit has no complex tensors.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.chunks import array_of
from polywigner.execution.drjit_operations import DrjitOperations
from polywigner.geometry.arguments import real_numbers
from polywigner.numerics.phases import cos_sin_turns
from polywigner.toolchain import llvm

Drjit: TypeAlias = Any
"""A Dr.Jit array of any variant of Mitsuba, whose classes depend on the variant; in scalar variants
a Python number or a vector of them."""

Points = Sequence[tuple[str, Any]]
"""(name, value) of several arguments."""


def is_drjit(value: Any) -> bool:
    """Whether a value is a Dr.Jit array; does not import Dr.Jit."""
    # Where another thread is importing it, the module is there without its names.
    is_array = getattr(sys.modules.get("drjit"), "is_array_v", None)
    return is_array is not None and is_array(value)


def is_tensor(value: Any) -> bool:
    return is_drjit(value) and bool(sys.modules["drjit"].is_tensor_v(value))


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


def common_float(
    points: Points,
    parameters: Parameters | None = None,
    precision: str | None = None,
    engine: str = "auto",
) -> tuple[Any, bool]:
    """The float type of all arrays, and whether it is double. Raises ArgumentError."""
    types = {own_float(name, value) for name, value in points if is_drjit(value)}
    types |= set() if parameters is None else parameters.types
    if len(types) > 1:
        found = " and ".join(sorted(f"{t.__module__}.{t.__name__}" for t in types))
        raise ArgumentError(
            f"expected arrays of one backend and precision, got {found}; convert one of them"
        )
    float_type = types.pop()
    double = _is_double(float_type)
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
    return float_type, double


def checked_float(name: str, value: Any, precision: str | None, engine: str) -> tuple[Any, bool]:
    """The float type behind an array, and whether it is double. Raises ArgumentError."""
    return common_float([(name, value)], None, precision, engine)


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


def _is_double(float_type: Any) -> bool:
    return bool(float_type.__name__.endswith("64"))


def sibling(float_type: Any, name: str) -> Any:
    """The type of a name, such as ``"Array2f"``, of the backend and precision of a float type."""
    suffix = "64" if _is_double(float_type) else ""
    return getattr(sys.modules[float_type.__module__], name + suffix)


def tensor_of(float_type: Any, points: Any) -> Any:
    """NumPy points as a tensor of the module that a float type is from."""
    return sibling(float_type, "TensorXf")(array_of(float_type, points), np.shape(points))


# ---- points --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PointKind:
    """The kind of array that points are."""

    float_type: Any
    tensor: tuple[Any, tuple[int, ...]] | None
    """Type and broadcast shape of tensors, without the last axis; None for other arrays."""

    def points(self, components: Sequence[Any]) -> Any:
        """Points of these components."""
        if self.tensor is None and len(components) > 1:
            return sibling(self.float_type, f"Array{len(components)}f")(*components)
        return self._joined(components, (len(components),))

    def result(self, *parts: Any) -> Any:
        """A real result, or a complex one of two parts."""
        if self.tensor is None and len(parts) > 1:
            return sibling(self.float_type, "Complex2f")(*parts)
        return self._joined(parts, (2,) if len(parts) > 1 else ())

    def _joined(self, parts: Sequence[Any], last: tuple[int, ...]) -> Any:
        """One part as it is, or a tensor of several, which are its last axis."""
        if self.tensor is None:
            return parts[0]
        import drjit

        kind, shape = self.tensor
        if len(parts) == 1 or 0 in shape:
            return kind(parts[0], (*shape, *last))
        size = int(np.prod(shape))
        flat = drjit.empty(self.float_type, len(parts) * size)
        index = drjit.arange(drjit.uint32_array_t(self.float_type), size)
        for k, part in enumerate(parts):
            drjit.scatter(flat, part, len(parts) * index + k)
        return kind(flat, (*shape, *last))

    def turned(self, value: Any, turns: Any) -> Any:
        """A result, real or complex, times exp(2 pi i turns)."""
        import drjit

        wave = cos_sin_turns(DrjitOperations(self.float_type), turns)
        factor = self.result(*wave)
        if self.tensor is not None or drjit.is_complex_v(value):
            return product_of_complex(value, factor)
        return factor * value


def read_points(points: Points, dimension: int, float_type: Any) -> tuple[list[Any], PointKind]:
    """The components of several points, one after the other, and the kind of all.

    What is no Dr.Jit array is converted to their kind, or to a tensor where none is.

    Raises ArgumentError where kinds, shapes or numbers of components disagree.
    """
    import drjit

    tensor = next((type(value) for _, value in points if is_tensor(value)), None)
    if tensor is None and any(is_drjit(value) for _, value in points):
        flat = [
            component
            for name, value in points
            for component in _components_first(name, value, float_type, dimension)
        ]
        widths = {drjit.width(component) for component in flat} - {1}
        if len(widths) > 1:
            found = " and ".join(map(str, sorted({drjit.width(component) for component in flat})))
            raise ArgumentError(
                f"expected as many points in each argument, or one, got {found}; pass arrays of "
                "one width"
            )
        return flat, PointKind(float_type, None)
    shape, flat = _components_last(points, float_type, dimension)
    return flat, PointKind(float_type, (tensor or sibling(float_type, "TensorXf"), shape))


def _components_first(name: str, value: Any, float_type: Any, dimension: int) -> tuple[Any, ...]:
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


def _components_last(
    points: Points, float_type: Any, dimension: int
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
        return shape, [drjit.zeros(float_type, 0)] * (dimension * len(points))
    index_type = drjit.uint32_array_t(float_type)
    components = []
    for flat, own in zip(flats, shapes, strict=True):
        where = array_of(index_type, broadcast_numbers(own, shape))
        components += [
            drjit.gather(float_type, flat, dimension * where + k) for k in range(dimension)
        ]
    return shape, components


def broadcast_numbers(own: tuple[int, ...], shape: tuple[int, ...]) -> NDArray[Any]:
    """The number of the entry of an array of shape ``own`` at each place of a broadcast shape."""
    return np.broadcast_to(np.arange(int(np.prod(own)), dtype=np.uint32).reshape(own), shape)


def _wrong_components(name: str, dimension: int, got: object) -> ArgumentError:
    plural = "s" if dimension > 1 else ""
    return ArgumentError(f"expected {name} with {dimension} component{plural}, got {got}")


def components_of_all(points: Points, dimension: int) -> tuple[list[list[Any]], PointKind]:
    """The components of several points, at least one a Dr.Jit array, and the kind of all."""
    flat, kind = read_points(points, dimension, common_float(points)[0])
    return [flat[k : k + dimension] for k in range(0, len(flat), dimension)], kind


def in_plane(value: Any) -> Any:
    """The first two components of points with three; anything else as it is."""
    import drjit

    if is_tensor(value):
        return value[..., :2] if value.shape and value.shape[-1] == 3 else value
    if drjit.depth_v(value) == 2 and len(value) == 3:
        return sibling(own_float("nu", value), "Array2f")(value[0], value[1])
    return value


def shifted_points(points: Any, shift: Any) -> Any:
    """Frequencies of any kind of Dr.Jit array, each moved by ``shift`` (d,)."""
    offset = np.asarray(shift, dtype=np.float64).tolist()
    components, kind = read_points([("nu", points)], len(offset), own_float("nu", points))
    return kind.points([c + value for c, value in zip(components, offset, strict=True)])


def matrix_times(matrix: Any, components: Sequence[Any]) -> list[Any]:
    """The components of a matrix times a vector, without the elements that are zero."""
    return [
        sum((c * m for c, m in zip(components, row, strict=True) if m), 0.0)
        for row in matrix.tolist()
    ]


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
    if is_tensor(value):
        return _times(value, factor.real, factor.imag)
    return value * type(value)(factor.real, factor.imag)


def product_of_complex(a: Any, b: Any) -> Any:
    """The product of two complex results of one kind, shape and type."""
    if not is_tensor(a):
        return a * b
    return _times(a, *_parts(b)) if len(a.array) else a


def _times(value: Any, real: Any, imag: Any) -> Any:
    """A complex tensor times real and imaginary parts."""
    a, b = _parts(value)
    kind = PointKind(type(value.array), (type(value), tuple(value.shape[:-1])))
    return kind.result(a * real - b * imag, a * imag + b * real)


def _parts(value: Any) -> list[Any]:
    """Real and imaginary part of a complex tensor."""
    import drjit

    kind = type(value.array)
    even = 2 * drjit.arange(drjit.uint32_array_t(kind), len(value.array) // 2)
    return [drjit.gather(kind, value.array, even + odd) for odd in (0, 1)]


# ---- numbers of a source -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Parameter:
    """Numbers in pairs: x and y of points, or real and imaginary parts."""

    first: Any
    second: Any

    @property
    def float_type(self) -> Any:
        return type(self.first)

    @property
    def values(self) -> NDArray[np.float64]:
        """The numbers now, (n, 2)."""
        return columns_of((self.first, self.second))

    def taken(self, index: Any) -> Parameter:
        """Some of the numbers, by their index (k,)."""
        import drjit

        numbers = array_of(drjit.uint32_array_t(self.float_type), index)
        return Parameter(
            *(drjit.gather(self.float_type, part, numbers) for part in (self.first, self.second))
        )


@dataclass(frozen=True)
class Traced:
    """Numbers of a source in its frame that are Dr.Jit's; None where there are none.

    Inside a kernel that is being traced each number is an array of its own: tuples of them.
    """

    vertices: tuple[Any, Any] | None = None
    """x and y of all vertices."""
    fields: tuple[Any, Any] | None = None
    """Real and imaginary parts of all weights, or of the amplitudes of all waves."""
    by_waves: bool = False
    """Whether ``fields`` are amplitudes of waves."""


@dataclass(frozen=True, eq=False)
class Parameters:
    """Numbers of a source that are Dr.Jit's."""

    vertices: Parameter | None = None
    fields: Parameter | None = None
    """Weights of the elements, or amplitudes of the waves."""
    by_waves: bool = False
    factors: Callable[[Any], NDArray[np.complex128]] | None = None
    """Tables of the source -> by how much each of the fields is larger in them, (n,)."""

    @property
    def types(self) -> set[Any]:
        """Their float types."""
        return {p.float_type for p in (self.vertices, self.fields) if p is not None}

    def traced(self, ops: DrjitOperations, tables: Any) -> Traced:
        """These numbers in the frame of tables."""
        vertices = fields = None
        if self.vertices is not None:
            corners = self.vertices.first, self.vertices.second
            x, y = tables.frame.position(ops, *corners)
            vertices = ops.float_type(x), ops.float_type(y)
        if self.fields is not None and self.factors is not None:
            ratio = self.factors(tables)
            real, imag = (array_of(ops.float_type, part) for part in (ratio.real, ratio.imag))
            a, b = self.fields.first, self.fields.second
            fields = a * real - b * imag, a * imag + b * real
        return Traced(vertices, fields, self.by_waves)


def columns_of(arrays: Sequence[Any]) -> NDArray[np.float64]:
    """The numbers of Dr.Jit arrays now, as columns (n, k)."""
    import drjit

    found = [np.array(drjit.detach(array), np.float64).ravel() for array in arrays]
    return np.stack(np.broadcast_arrays(*found), axis=-1)


def plane_points(name: str, value: Any) -> Parameter:
    """Points (n,) as ``Array2f``, components first, or a tensor (n, 2).

    Raises ArgumentError for anything else.
    """
    kinds = "points: Array2f, components first, or a tensor (n, 2)"
    return _parameter(value, f"expected {name} as Dr.Jit {kinds}", is_complex=False)


def complex_numbers(name: str, value: Any) -> Parameter:
    """Numbers (n,): ``Complex2f``, a real ``Float``, or a tensor (n,) or (n, 2) of both parts.

    Raises ArgumentError for anything else.
    """
    kinds = "numbers: Complex2f, Float, or a tensor (n,) or (n, 2)"
    return _parameter(value, f"expected {name} as Dr.Jit {kinds}", is_complex=True)


def _parameter(value: Any, expected: str, is_complex: bool) -> Parameter:
    got = type(value).__name__
    if is_drjit(value):  # else its import could come before a library of LLVM is chosen
        import drjit

        if not drjit.is_jit_v(value) or not drjit.is_float_v(value):
            pass
        elif drjit.itemsize_v(drjit.leaf_t(value)) < 4:
            got += " of 16 bit"
        elif is_tensor(value) and not (is_complex and value.ndim == 1):
            got = f"a tensor of shape {tuple(value.shape)}"
            if value.ndim == 2 and value.shape[1] == 2:
                return Parameter(*_parts(value))
        else:
            value = value.array if is_tensor(value) else value
            if is_complex and drjit.depth_v(value) == 1:
                return Parameter(value, drjit.zeros(type(value), drjit.width(value)))
            if drjit.depth_v(value) == len(value) == 2 and drjit.is_complex_v(value) == is_complex:
                return Parameter(*widened((value[0], value[1])))
    raise ArgumentError(
        f"{expected}, floats of the LLVM or CUDA backend, got {got}; build sources from plain "
        "numbers, or convert them"
    )


def widened(arrays: Sequence[Any]) -> tuple[Any, ...]:
    """Arrays of one width, or of one entry, all of one width."""
    import drjit

    width = max(map(drjit.width, arrays))
    index = drjit.arange(drjit.uint32_array_t(type(arrays[0])), width)
    return tuple(
        a if drjit.width(a) == width else drjit.gather(type(a), a, 0 * index) for a in arrays
    )
