"""Dr.Jit arrays in and out of functions that the host computes, with its derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.execution.chunks import array_of
from polywigner.execution.drjit_arrays import check_request, checked_float, common_float
from polywigner.execution.drjit_points import (
    as_complex,
    as_result,
    components_of,
    from_components,
    is_drjit,
    is_tensor,
)
from polywigner.execution.gradients import DerivativeRule, with_derivatives
from polywigner.execution.parameters import Parameter, Parameters, tensor_of

Values = NDArray[Any]


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
    is_tensor = drjit.is_tensor_v(points)
    own = tuple(points.shape)
    if dimension == 1 and len(own) == 1 and not is_tensor:  # one component: a Float
        own = (1, *own)
    if own[-1 if is_tensor else 0] != dimension or not (is_tensor or len(own) == 2):
        raise ArgumentError(
            f"expected {name} with {dimension} components, got {type(points).__name__} of shape "
            f"{own}; use Array{dimension}f, components first, or a tensor (..., {dimension})"
        )
    host = np.array(points.numpy(), np.float64).reshape(own)
    found = compute(host if is_tensor else host.T, precision="double" if double else "single")
    parts = found if isinstance(found, tuple) else (found,)
    tensor = (type(points), own[:-1]) if is_tensor else None
    made = tuple(from_components(np.asarray(part), float_type, tensor) for part in parts)
    return made if isinstance(found, tuple) else made[0]


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
        hosts.append(_read_points(components, shape))
    wanted = [own is not None and dr.grad_enabled(own) for own in inputs]
    values, slopes = compute(hosts, wanted)
    shapes = [
        host.shape if own is not None else () for host, own in zip(hosts, inputs, strict=True)
    ]
    result = array_of(real, values)
    if any(wanted):
        result = with_derivatives(_rule_of_values(real, result, slopes, shapes), *inputs)
    tensors = [value for _, value in points if is_tensor(value)]
    flat = not tensors and values.ndim < 2
    like = tensors[0] if tensors else None
    return as_result(result, None if flat else values.shape, like, real)


def _rule_of_values(
    real: Any, result: Any, slopes: Sequence[Floats | None], shapes: Sequence[tuple[int, ...]]
) -> DerivativeRule:
    def forward(_: Any, changes: Any) -> Any:
        total: Any = 0.0
        for own, change, shape in zip(slopes, changes, shapes, strict=True):
            if own is not None:
                total = total + (own * _read_points(change, shape[:-1])).sum(axis=-1)
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


def _read_points(components: Sequence[Any], shape: tuple[int, ...] | None) -> Floats:
    """Components as points (..., d), of no shape (n, d)."""
    import drjit as dr

    columns = [np.array(dr.detach(c), np.float64).ravel() for c in components]
    found = np.stack(np.broadcast_arrays(*columns), axis=-1)
    if shape is None:
        return found
    size = int(np.prod(shape))
    return np.broadcast_to(found, (size, len(columns))).reshape(*shape, len(columns))


Complex = NDArray[np.complex128]


class HostSlopes(Protocol):
    """Derivatives of a complex field at points (n, 3)."""

    def of_points(self, points: Floats) -> Complex:
        """Derivatives in the points, (n, 3)."""

    def forward(self, points: Floats, change: Floats) -> Complex:
        """Derivatives along a change (v, 2) of all vertices, (n,)."""

    def reverse(
        self, points: Floats, cotangent: Complex, of_points: bool, of_vertices: bool
    ) -> tuple[Complex, Floats]:
        """Derivatives in points, and sum_j Re(cotangent_j* dU_j/d vertex), (v, 2), as wanted."""

    def of_fields(self, points: Floats) -> Complex:
        """Derivatives in weights or amplitudes, in which the field is linear, (n, k)."""


class TracedField:
    """Real and imaginary part of a field, and what kind of array results are to be."""

    def __init__(self, parts: tuple[Any, Any], shape: tuple[int, ...] | None, like: Any) -> None:
        self.parts, self.shape, self.like = parts, shape, like

    def amplitude(self) -> Any:
        """The field."""
        return as_complex(self.parts, self.shape, self.like)

    def irradiance(self) -> Any:
        """Its squared modulus."""
        real, imag = self.parts
        value = real * real + imag * imag
        return value if self.shape is None else type(self.like)(value, self.shape)


def hosted_field(
    compute: Callable[..., Complex],
    slopes: HostSlopes,
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
    points : (..., 3) of any kind, Dr.Jit's unless the parameters are.

    Raises
    ------
    ArgumentError for other types, backends, precisions and numbers of components.
    """
    import drjit as dr

    named = [("points", points)]
    float_type = common_float(named, parameters)
    double = dr.itemsize_v(float_type) == 8
    check_request(float_type, double, precision, engine)
    found, shape = components_of("points", points, float_type, 3)
    width = max(map(dr.width, found))
    place = dr.arange(dr.uint32_array_t(float_type), width)
    wide = tuple(
        c if dr.width(c) == width else dr.gather(float_type, c, 0 * place)
        for c in map(float_type, found)
    )
    where = _read(wide)
    values = np.broadcast_to(compute(where, precision="double" if double else "single"), len(where))
    inputs = (wide, _pair(parameters.vertices), _pair(parameters.fields))
    rule = _rule_of_field(where, values, slopes, float_type, tuple(map(dr.grad_enabled, inputs)))
    parts = with_derivatives(rule, *inputs)
    like = points if shape is None or dr.is_tensor_v(points) else tensor_of(float_type, [0.0])
    return TracedField(parts, shape, like)


def _pair(parameter: Parameter | None) -> tuple[Any, Any] | None:
    return None if parameter is None else (parameter.first, parameter.second)


def _rule_of_field(
    where: Floats, values: Complex, slopes: HostSlopes, real: Any, needed: Sequence[bool]
) -> DerivativeRule:
    """A field whose values and derivatives are NumPy's."""

    def sent(values: Complex) -> Any:
        return array_of(real, values.real), array_of(real, values.imag)

    def forward(_: Any, changes: Any) -> Any:
        of_points, of_vertices, of_fields = (
            _read(change) if is_needed else None
            for change, is_needed in zip(changes, needed, strict=True)
        )
        total = np.zeros(len(where), np.complex128)
        if of_points is not None:
            total += (slopes.of_points(where) * of_points).sum(axis=1)
        if of_vertices is not None:
            total += slopes.forward(where, of_vertices)
        if of_fields is not None:
            total += slopes.of_fields(where) @ (of_fields @ np.array([1, 1j]))
        return sent(total)

    def reverse(_: Any, gradient: Any) -> Any:
        out = _read(gradient)
        cotangent: Complex = np.broadcast_to(out @ np.array([1, 1j]), len(where))
        of_points, of_vertices = slopes.reverse(where, cotangent, *needed[:2])
        found: list[Any] = [None, None, None]
        if needed[0]:
            along = (cotangent.conj()[:, None] * of_points).real
            found[0] = tuple(array_of(real, column) for column in along.T)
        if needed[1]:
            found[1] = tuple(array_of(real, column) for column in of_vertices.T)
        if needed[2]:
            found[2] = sent(cotangent @ slopes.of_fields(where).conj())
        return tuple(found)

    return DerivativeRule("field", lambda *_: sent(values), forward, reverse)


def _read(columns: Any) -> Floats:
    """Arrays of Dr.Jit as columns (n, k)."""
    import drjit as dr

    found = [np.array(dr.detach(column), np.float64).ravel() for column in columns]
    return np.stack(np.broadcast_arrays(*found), axis=-1)


ComputedOfPoses = tuple[NDArray[Any], Sequence[Complex | None]]


def hosted_poses(
    compute: Callable[[Any, Sequence[bool]], ComputedOfPoses],
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
        floats = with_derivatives(_rule_of_poses(kind, floats, slopes), *inputs)
    like = poses if is_drjit(poses) else tensor_of(kind, [0.0])
    if len(floats) == 1:
        return type(like)(floats[0], values.shape)
    return as_complex((floats[0], floats[1]), values.shape, like)


def _rule_of_poses(
    kind: Any, values: tuple[Any, ...], slopes: Sequence[Complex | None]
) -> DerivativeRule:
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
