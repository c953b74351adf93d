"""Numbers of a source that are data of a kernel: those that are Dr.Jit arrays, and whole tables."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.chunks import array_of
from polywigner.execution.operations import DrjitOperations
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.outline.frame import Frame
from polywigner.kernels.outline.tables import Tables
from polywigner.numerics import phases


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
        import drjit as dr

        columns = [np.array(dr.detach(part), np.float64) for part in (self.first, self.second)]
        return np.stack(np.broadcast_arrays(*columns), axis=-1)

    def taken(self, index: Any) -> Parameter:
        """Some of the numbers, by their index (k,)."""
        import drjit as dr

        numbers = array_of(dr.uint32_array_t(self.float_type), index)
        return Parameter(
            *(dr.gather(self.float_type, part, numbers) for part in (self.first, self.second))
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
    """Which of the two."""


def plane_points(name: str, value: Any) -> Parameter:
    """Points (n,) as ``Array2f``, components first, or a tensor (n, 2).

    Raises ArgumentError for anything else.
    """
    import drjit as dr

    expected = f"expected {name} as Dr.Jit points: Array2f, components first, or a tensor (n, 2)"
    _check_float(value, expected)
    if dr.is_tensor_v(value):
        if value.ndim != 2 or value.shape[1] != 2:
            raise ArgumentError(f"{expected}, got a tensor of shape {tuple(value.shape)}")
        return _columns(value.array, 2)
    if dr.depth_v(value) != 2 or len(value) != 2 or dr.is_complex_v(value):
        raise ArgumentError(f"{expected}, got {type(value).__name__}")
    return _of_one_width(value[0], value[1])


def complex_numbers(name: str, value: Any) -> Parameter:
    """Numbers (n,): ``Complex2f``, a real ``Float``, or a tensor (n,) or (n, 2) of both parts.

    Raises ArgumentError for anything else.
    """
    import drjit as dr

    expected = f"expected {name} as Dr.Jit numbers: Complex2f, Float, or a tensor (n,) or (n, 2)"
    _check_float(value, expected)
    if dr.is_tensor_v(value):
        if value.ndim == 1:
            return Parameter(value.array, dr.zeros(dr.array_t(value), len(value.array)))
        if value.ndim != 2 or value.shape[1] != 2:
            raise ArgumentError(f"{expected}, got a tensor of shape {tuple(value.shape)}")
        return _columns(value.array, 2)
    if dr.is_complex_v(value) and dr.depth_v(value) == 2:
        return _of_one_width(value.real, value.imag)
    if dr.depth_v(value) != 1:
        raise ArgumentError(f"{expected}, got {type(value).__name__}")
    return Parameter(value, dr.zeros(type(value), dr.width(value)))


def _check_float(value: Any, expected: str) -> None:
    if "drjit" not in sys.modules or not sys.modules["drjit"].is_jit_v(value):
        raise ArgumentError(
            f"{expected}, of the LLVM or CUDA backend, got {type(value).__name__}; for plain "
            "numbers build the source from them"
        )
    dr = sys.modules["drjit"]
    if not dr.is_float_v(value) or dr.itemsize_v(dr.leaf_t(value)) < 4:
        raise ArgumentError(f"{expected} of 32 or 64 bit floats, got {type(value).__name__}")


def _columns(flat: Any, count: int) -> Parameter:
    import drjit as dr

    kind = type(flat)
    row = dr.arange(dr.uint32_array_t(kind), len(flat) // count)
    return Parameter(*(dr.gather(kind, flat, count * row + k) for k in range(count)))


def _of_one_width(first: Any, second: Any) -> Parameter:
    import drjit as dr

    width = max(dr.width(first), dr.width(second))
    index = dr.arange(dr.uint32_array_t(type(first)), width)
    wide = (
        p if dr.width(p) == width else dr.gather(type(p), p, 0 * index) for p in (first, second)
    )
    return Parameter(*wide)


def tensor_of(float_type: Any, points: Any) -> Any:
    """NumPy points as a tensor of the module that a float type is from."""
    module = sys.modules[float_type.__module__]
    double = float_type.__name__.endswith("64")
    kind = module.TensorXf64 if double else module.TensorXf
    return kind(array_of(float_type, points), np.shape(points))


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


class TracedOperations(DrjitOperations):
    """Edges are rows of tables, and never code."""

    target = "data"

    def sum_over(self, rows: Any, term: Any, values: int, like: Any, *, unroll: bool = True) -> Any:
        return super().sum_over(rows, term, values, like, unroll=False)


class UnrolledOperations(DrjitOperations):
    """Terms of a sum are code, however many: where each has arrays of its own."""

    def sum_over(self, rows: Any, term: Any, values: int, like: Any, *, unroll: bool = True) -> Any:
        if unroll:
            return self.sum_large_terms(rows, term, 0)
        return super().sum_over(rows, term, values, like, unroll=False)


@dataclass(frozen=True)
class _DataFrame(Frame):
    """A frame whose centre is in memory, as pairs of floats."""

    def position(self, ops: Any, x: Any, y: Any) -> tuple[Any, Any]:
        pairs: Any = self.centre
        nearest = tuple(high for high, _ in pairs)
        kept = {field.name: getattr(self, field.name) for field in fields(Frame)}
        return Frame(**{**kept, "centre": nearest}).position(ops, x, y)


def with_frame_as_data(ops: DrjitOperations, tables: Tables) -> Tables:
    """Tables with the centre of their frame in memory; their lists are so in any case."""
    held = _Held(ops)
    pairs = [phases.doubled(c, ops.double) for c in tables.frame.centre]
    centre = [(held.add(high), held.add(low)) for high, low in pairs]
    held.send()
    return replace(tables, frame=_framed(tables.frame, held, centre))


def as_data(ops: DrjitOperations, tables: Any) -> Any:
    """Tables of an aperture or an array with arrays of one entry in place of numbers."""
    held = _Held(ops)
    pairs = [phases.doubled(c, ops.double) for c in tables.frame.centre]
    centre = [(held.add(high), held.add(low)) for high, low in pairs]
    if isinstance(tables, OutlineTables):
        held.send()
        return replace(tables, frame=_framed(tables.frame, held, centre))
    names = ("dx", "dy", "offset", "px", "py")
    lines = [{name: held.add(getattr(line, name)) for name in names} for line in tables.lines]
    weights = [(held.add(piece.real), held.add(piece.imag)) for piece in tables.pieces]
    held.send()
    pieces = tables.pieces
    if not tables.uniform:
        pieces = tuple(
            replace(piece, real=held[real], imag=held[imag])
            for piece, (real, imag) in zip(pieces, weights, strict=True)
        )
    found = zip(tables.lines, lines, strict=True)
    return replace(
        tables,
        frame=_framed(tables.frame, held, centre),
        lines=tuple(replace(line, **{n: held[k] for n, k in own.items()}) for line, own in found),
        pieces=pieces,
    )


def _framed(frame: Frame, held: _Held, centre: Sequence[tuple[int, int]]) -> _DataFrame:
    kept = {field.name: getattr(frame, field.name) for field in fields(Frame)}
    kept["centre"] = tuple((held[high], held[low]) for high, low in centre)
    return _DataFrame(**kept)


class _Held:
    """Numbers of one array, looked up one by one."""

    def __init__(self, ops: DrjitOperations) -> None:
        self.ops = ops
        self.values: list[float] = []
        self.memory: Any = None

    def add(self, value: float) -> int:
        self.values.append(float(value))
        return len(self.values) - 1

    def send(self) -> None:
        self.memory = array_of(self.ops.float_type, self.values)

    def __getitem__(self, index: int) -> Any:
        import drjit as dr

        kind = self.ops.float_type
        return dr.gather(kind, self.memory, dr.uint32_array_t(kind)(index))
