"""Dr.Jit arrays in and out of functions that the host computes, with its derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.chunks import array_of
from polywigner.execution.points import (
    Parameter,
    Parameters,
    PointKind,
    Points,
    broadcast_numbers,
    checked_float,
    columns_of,
    common_float,
    is_drjit,
    is_tensor,
    read_points,
    sibling,
    widened,
)

Values = NDArray[Any]
Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


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
    components, kind = read_points([(name, points)], dimension, float_type)
    found = compute(_host_points(components, kind), precision="double" if double else "single")
    parts = found if isinstance(found, tuple) else (found,)
    made = tuple(kind.result(*_sent(np.asarray(part), float_type)) for part in parts)
    return made if isinstance(found, tuple) else made[0]


def _host_points(components: Sequence[Any], kind: PointKind) -> Floats:
    """Components as points (..., d), or (n, d) where they are no tensor."""
    found = columns_of(components)
    return found if kind.tensor is None else found.reshape(*kind.tensor[1], len(components))


def _sent(values: Values, float_type: Any) -> tuple[Any, ...]:
    """Values as Dr.Jit arrays: one, or of complex ones both parts."""
    parts = (values.real, values.imag) if np.iscomplexobj(values) else (values,)
    return tuple(array_of(float_type, part) for part in parts)


def _with_slopes(
    parts: Sequence[Any], terms: Iterable[tuple[Any, Values, Values]]
) -> tuple[Any, ...]:
    """Real values (n,), or both parts of complex ones, with derivatives that the host has found.

    ``terms``: some numbers (k,), which of them, (n, m), each value depends on, and its derivatives
    in them, (n, m).
    """
    import drjit as dr

    kind = type(parts[0])
    if not dr.width(parts[0]):
        return tuple(parts)
    totals: list[Any] = [0.0 for _ in parts]
    for numbers, index, slopes in terms:
        which = array_of(dr.uint32_array_t(kind), index if dr.width(numbers) > 1 else 0 * index)
        change = dr.gather(kind, numbers, which)
        for k, slope in enumerate((slopes.real, slopes.imag)[: len(parts)]):
            totals[k] = totals[k] + dr.block_sum(change * array_of(kind, slope), index.shape[1])
    # what is added is nothing, but for the derivatives that are missing
    nothing = dr.zeros(kind, dr.width(totals[0]))
    return tuple(
        part + dr.replace_grad(nothing, total) for part, total in zip(parts, totals, strict=True)
    )


def with_slopes(
    values: Any, fields: tuple[Any, Any], slopes: Callable[[], tuple[Floats, Floats]]
) -> Any:
    """Real values (n,), or a tensor of them, with derivatives in numbers (k,) that they lack.

    ``slopes``: with respect to their real and imaginary parts, (n, k) each.
    """
    import drjit as dr

    if not dr.grad_enabled(fields):
        return values
    both = zip(fields, slopes(), strict=True)
    terms = [(numbers, broadcast_numbers(s.shape[1:], s.shape), s) for numbers, s in both]
    if not is_tensor(values):
        return _with_slopes((values,), terms)[0]
    return type(values)(_with_slopes((values.array,), terms)[0], values.shape)


def hosted_values(
    compute: Callable[[Sequence[Any], Sequence[bool]], tuple[Floats, Sequence[Floats | None]]],
    points: Points,
    dimension: int,
) -> Any:
    """Values of points that broadcast, one a Dr.Jit array at least.

    Parameters
    ----------
    compute : (points (..., d), which derivatives are wanted) -> values (...), and derivatives
        (..., d) in each of the points that want them, else None.
    points : (name, value); with components first, or tensors (..., d), or NumPy's.

    Returns a ``Float``, or a tensor (...) where one of the points is a tensor.

    Raises ArgumentError for other types, backends and numbers of components.
    """
    import drjit as dr

    real, _ = common_float(points)
    inputs: list[list[Any]] = []
    hosts: list[Any] = []
    for name, value in points:
        components: list[Any] = []
        if is_drjit(value):
            components, kind = read_points([(name, value)], dimension, real)
            value = _host_points(components, kind)
        inputs.append(components)
        hosts.append(value)
    values, slopes = compute(hosts, [dr.grad_enabled(own) for own in inputs])
    terms = []
    for own, host, slope in zip(inputs, hosts, slopes, strict=True):
        if slope is not None:
            number = broadcast_numbers(host.shape[:-1], values.shape).reshape(-1, 1)
            columns = slope.reshape(-1, dimension).T[..., None]
            terms += [(c, number, column) for c, column in zip(own, columns, strict=True)]
    result = _sent(values, real)
    tensor = next((type(value) for _, value in points if is_tensor(value)), None)
    if tensor is None and values.ndim > 1:
        tensor = sibling(real, "TensorXf")
    whole = PointKind(real, None if tensor is None else (tensor, values.shape))
    return whole.result(*(_with_slopes(result, terms) if terms else result))


def hosted_poses(
    compute: Callable[[Any, Sequence[bool]], tuple[Values, Sequence[Complex | None]]],
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

    real, _ = common_float([(name, poses)], Parameters(fields[0], fields[1]))  # for their types
    is_traced = is_drjit(poses)
    if is_traced and (not is_tensor(poses) or tuple(poses.shape)[-2:] != (4, 4)):
        raise ArgumentError(
            f"expected {name} as a tensor (..., 4, 4), got {type(poses).__name__} of shape "
            f"{tuple(poses.shape)}"
        )
    inputs: list[Any] = [poses.array if is_traced else None, *map(_pair, fields)]
    wanted = [value is not None and dr.grad_enabled(value) for value in inputs]
    host = np.array(dr.detach(poses).numpy(), np.float64) if is_traced else poses
    values, slopes = compute(host, wanted)
    result = _sent(values, real)
    terms = []
    for number, (numbers, own) in enumerate(zip(inputs, slopes, strict=True)):
        if own is not None and number == 0:
            terms.append((numbers, 16 * np.arange(len(own))[:, None] + np.arange(12), own))
        elif own is not None:
            parts = zip(numbers, np.split(own, 2, axis=1), strict=True)
            terms += [(p, broadcast_numbers(s.shape[1:], s.shape), s) for p, s in parts]
    kind = type(poses) if is_traced else sibling(real, "TensorXf")
    whole = PointKind(real, (kind, values.shape))
    return whole.result(*(_with_slopes(result, terms) if terms else result))


class TracedField:
    """Real and imaginary part of a field, and the kind of arrays for results."""

    def __init__(self, parts: tuple[Any, Any], kind: PointKind) -> None:
        self.parts, self.kind = parts, kind

    def amplitude(self) -> Any:
        """The field."""
        return self.kind.result(*self.parts)

    def irradiance(self) -> Any:
        """Its squared modulus."""
        real, imag = self.parts
        return self.kind.result(real * real + imag * imag)


def hosted_field(
    compute: Callable[..., Complex],
    slopes: Any,
    points: Any,
    parameters: Parameters,
    *,
    precision: str | None,
    engine: str,
) -> TracedField:
    """A field with derivatives in points and in numbers of its source.

    Parameters
    ----------
    compute : (points (n, 3), precision=...) -> (n,) complex.
    slopes : :class:`polywigner.propagation.field_slopes.FieldSlopes`.
    points : (..., 3) of any kind, Dr.Jit's unless the parameters are.

    Raises
    ------
    ArgumentError for other types, backends, precisions and numbers of components.
    """
    import drjit as dr

    named = [("points", points)]
    real, double = common_float(named, parameters, precision, engine)
    found, kind = read_points(named, 3, real)
    wide = widened([real(c) for c in found])
    where = columns_of(wide)
    values = np.broadcast_to(compute(where, precision="double" if double else "single"), len(where))
    inputs = (wide, _pair(parameters.vertices), _pair(parameters.fields))
    field = _HostField(where, values, slopes, real, tuple(map(dr.grad_enabled, inputs)))
    return TracedField(dr.custom(_field_operation(), field, inputs), kind)


def _pair(parameter: Parameter | None) -> tuple[Any, Any] | None:
    return None if parameter is None else (parameter.first, parameter.second)


class _HostField:
    """A field whose values and derivatives are NumPy's, in points, vertices and fields."""

    def __init__(
        self, where: Floats, values: Complex, slopes: Any, real: Any, needed: Sequence[bool]
    ) -> None:
        self.where, self.values, self.slopes = where, values, slopes
        self.real, self.needed = real, needed

    def forward(self, changes: Any) -> Any:
        """The change of the field."""
        of_points, of_vertices, of_fields = (
            columns_of(change) if is_needed else None
            for change, is_needed in zip(changes, self.needed, strict=True)
        )
        total = np.zeros(len(self.where), np.complex128)
        if of_points is not None:
            total += (self.slopes.of_points(self.where) * of_points).sum(axis=1)
        if of_vertices is not None:
            total += self.slopes.forward(self.where, of_vertices)
        if of_fields is not None:
            total += self.slopes.of_fields(self.where) @ (of_fields @ np.array([1, 1j]))
        return _sent(total, self.real)

    def reverse(self, gradient: Any) -> Any:
        """The gradients in the inputs, None where there is none."""
        out = columns_of(gradient)
        cotangent: Complex = np.broadcast_to(out @ np.array([1, 1j]), len(self.where))
        of_points, of_vertices = self.slopes.reverse(self.where, cotangent, *self.needed[:2])
        found: list[Any] = [None, None, None]
        if self.needed[0]:
            along = (cotangent.conj()[:, None] * of_points).real
            found[0] = tuple(array_of(self.real, column) for column in along.T)
        if self.needed[1]:
            found[1] = tuple(array_of(self.real, column) for column in of_vertices.T)
        if self.needed[2]:
            found[2] = _sent(cotangent @ self.slopes.of_fields(self.where).conj(), self.real)
        return tuple(found)


@cache
def _field_operation() -> Any:
    import drjit

    class Field(drjit.CustomOp):
        """A field of the host as an operation that Dr.Jit differentiates."""

        def eval(self, field: _HostField, inputs: Any) -> Any:
            self.field = field
            return _sent(field.values, field.real)

        def forward(self) -> None:
            self.set_grad_out(self.field.forward(self.grad_in("inputs")))

        def backward(self) -> None:
            self.set_grad_in("inputs", self.field.reverse(self.grad_out()))

        def name(self) -> str:
            return "polywigner field"

    return Field
