"""Dr.Jit arrays in and out of functions that the host computes, with its derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

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
    inputs = (poses.array if is_traced else None, *map(_pair, fields))
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


@dataclass(frozen=True, eq=False)
class DerivativeRule:
    """A function of some inputs, and how changes go forward through it and gradients back.

    An input is an array, a tuple of arrays, or None; the functions get all of them without
    derivatives.
    """

    name: str
    value: Callable[..., Any]
    """(*inputs) -> a tuple of arrays, or one array."""
    forward: Callable[[Any, Any], Any]
    """(inputs, their changes) -> the change of the value."""
    reverse: Callable[[Any, Any], tuple[Any, ...]]
    """(inputs, the gradient in the value) -> that in each input, None where it has none."""


def with_derivatives(rule: DerivativeRule, *inputs: Any) -> Any:
    """The value of a function, which Dr.Jit then differentiates by its rule."""
    import drjit

    return drjit.custom(_operation(), rule, inputs)


@cache
def _operation() -> Any:
    import drjit

    class Operation(drjit.CustomOp):
        """A function and its derivatives, by a rule."""

        def eval(self, rule: DerivativeRule, inputs: Any) -> Any:
            self.rule, self.inputs = rule, inputs
            return rule.value(*inputs)

        def forward(self) -> None:
            self.set_grad_out(self.rule.forward(self.inputs, self.grad_in("inputs")))

        def backward(self) -> None:
            self.set_grad_in("inputs", self.rule.reverse(self.inputs, self.grad_out()))

        def name(self) -> str:
            return f"polywigner {self.rule.name}"

    return Operation


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
    real, double = common_float(named, parameters, precision, engine)
    found, kind = read_points(named, 3, real)
    wide = widened([real(c) for c in found])
    where = columns_of(wide)
    values = np.broadcast_to(compute(where, precision="double" if double else "single"), len(where))
    inputs = (wide, _pair(parameters.vertices), _pair(parameters.fields))
    rule = _rule_of_field(where, values, slopes, real, tuple(map(dr.grad_enabled, inputs)))
    return TracedField(with_derivatives(rule, *inputs), kind)


def _pair(parameter: Parameter | None) -> tuple[Any, Any] | None:
    return None if parameter is None else (parameter.first, parameter.second)


def _rule_of_field(
    where: Floats, values: Complex, slopes: HostSlopes, real: Any, needed: Sequence[bool]
) -> DerivativeRule:
    """A field whose values and derivatives are NumPy's."""

    def forward(_: Any, changes: Any) -> Any:
        of_points, of_vertices, of_fields = (
            columns_of(change) if is_needed else None
            for change, is_needed in zip(changes, needed, strict=True)
        )
        total = np.zeros(len(where), np.complex128)
        if of_points is not None:
            total += (slopes.of_points(where) * of_points).sum(axis=1)
        if of_vertices is not None:
            total += slopes.forward(where, of_vertices)
        if of_fields is not None:
            total += slopes.of_fields(where) @ (of_fields @ np.array([1, 1j]))
        return _sent(total, real)

    def reverse(_: Any, gradient: Any) -> Any:
        out = columns_of(gradient)
        cotangent: Complex = np.broadcast_to(out @ np.array([1, 1j]), len(where))
        of_points, of_vertices = slopes.reverse(where, cotangent, *needed[:2])
        found: list[Any] = [None, None, None]
        if needed[0]:
            along = (cotangent.conj()[:, None] * of_points).real
            found[0] = tuple(array_of(real, column) for column in along.T)
        if needed[1]:
            found[1] = tuple(array_of(real, column) for column in of_vertices.T)
        if needed[2]:
            found[2] = _sent(cotangent @ slopes.of_fields(where).conj(), real)
        return tuple(found)

    return DerivativeRule("field", lambda *_: _sent(values, real), forward, reverse)
