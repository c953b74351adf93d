"""Fields that the host computes for Dr.Jit points, with derivatives that it computes as well."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from polywigner.execution.aligned import array_of
from polywigner.execution.derivatives import DerivativeRule, with_derivatives
from polywigner.execution.drjit_arrays import check_request, common_float
from polywigner.execution.drjit_points import components_of
from polywigner.execution.drjit_results import as_complex
from polywigner.execution.parameters import Parameter, Parameters, tensor_of

__all__ = ["HostSlopes", "TracedField", "hosted_field"]

Floats = NDArray[np.float64]
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
    rule = _rule(where, values, slopes, float_type, tuple(map(dr.grad_enabled, inputs)))
    parts = with_derivatives(rule, *inputs)
    like = points if shape is None or dr.is_tensor_v(points) else tensor_of(float_type, [0.0])
    return TracedField(parts, shape, like)


def _pair(parameter: Parameter | None) -> tuple[Any, Any] | None:
    return None if parameter is None else (parameter.first, parameter.second)


def _rule(
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
