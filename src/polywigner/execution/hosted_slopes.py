"""Fields that the host computes for Dr.Jit points, with derivatives that it computes as well."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

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
        """(n, 3)."""

    def forward(self, points: Floats, change: Floats) -> Complex:
        """Along a change (v, 2) of all vertices, (n,)."""

    def reverse(
        self, points: Floats, cotangent: Complex, of_points: bool, of_vertices: bool
    ) -> tuple[Complex, Floats]:
        """:meth:`of_points`, and sum_j Re(cotangent_j* dU_j/d vertex), (v, 2); those wanted."""

    def of_fields(self, points: Floats) -> Complex:
        """Of weights or amplitudes, in which the field is linear, (n, k)."""


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
    operation = _operation(where, values, slopes, float_type, tuple(map(dr.grad_enabled, inputs)))
    parts = dr.custom(operation, *inputs)
    like = points if shape is None or dr.is_tensor_v(points) else tensor_of(float_type, [0.0])
    return TracedField(parts, shape, like)


def _pair(parameter: Parameter | None) -> tuple[Any, Any] | None:
    return None if parameter is None else (parameter.first, parameter.second)


def _operation(
    where: Floats,
    values: Complex,
    slopes: HostSlopes,
    real: Any,
    needed: Sequence[bool],
) -> Any:
    import drjit as dr

    dtype = np.float64 if dr.itemsize_v(real) == 8 else np.float32

    def sent(values: Floats) -> Any:
        return real(np.array(values, dtype))

    class HostedField(dr.CustomOp):
        """A field whose values and derivatives are NumPy's."""

        def eval(self, points: Any, vertices: Any, fields: Any) -> Any:
            return sent(values.real), sent(values.imag)

        def forward(self) -> None:
            change = [
                _read(self.grad_in(name)) if is_needed else None
                for name, is_needed in zip(("points", "vertices", "fields"), needed, strict=True)
            ]
            total = np.zeros(len(where), np.complex128)
            if change[0] is not None:
                total += (slopes.of_points(where) * change[0]).sum(axis=1)
            if change[1] is not None:
                total += slopes.forward(where, change[1])
            if change[2] is not None:
                total += slopes.of_fields(where) @ (change[2] @ np.array([1, 1j]))
            self.set_grad_out((sent(total.real), sent(total.imag)))

        def backward(self) -> None:
            out = _read(self.grad_out())
            cotangent: Complex = np.broadcast_to(out @ np.array([1, 1j]), len(where))
            of_points, of_vertices = slopes.reverse(where, cotangent, *needed[:2])
            if needed[0]:
                found = cotangent.conj()[:, None] * of_points
                self.set_grad_in("points", tuple(map(sent, found.real.T)))
            if needed[1]:
                self.set_grad_in("vertices", tuple(map(sent, of_vertices.T)))
            if needed[2]:
                of_fields = cotangent @ slopes.of_fields(where).conj()
                self.set_grad_in("fields", (sent(of_fields.real), sent(of_fields.imag)))

        def name(self) -> str:
            return "polywigner field"

    return HostedField


def _read(columns: Any) -> Floats:
    """Arrays of Dr.Jit as columns (n, k)."""
    import drjit as dr

    found = [np.array(dr.detach(column), np.float64).ravel() for column in columns]
    return np.stack(np.broadcast_arrays(*found), axis=-1)
