"""Fields at points of the plane behind a first-order system."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import real_numbers
from polywigner.illumination.array import tilted_source
from polywigner.optics import FirstOrder
from polywigner.propagation.collins import collins_field
from polywigner.propagation.fields_traced import has_derivatives
from polywigner.propagation.panels import radiator_of
from polywigner.propagation.places import (
    checked_amplitude_tolerance,
    checked_wavelength,
    warn_of_missed,
)
from polywigner.transforms.calls import checked_system
from polywigner.transforms.wavefronts import checked_wavefront

__all__ = ["field_behind", "squared_field"]


def field_behind(
    source: Any,
    points: Any,
    wavelength: Any,
    through: Any,
    tolerance: float | None,
    others: dict[str, Any],
    *,
    squared: bool = False,
    return_error: bool = False,
    precision: Any = None,
    engine: Any = "auto",
) -> Any:
    """The amplitude at points (..., 2) behind a system, and with ``return_error`` its error.

    ``others``: arguments that are for fields in front of the source; none may be given.
    ``squared``: the irradiance instead.
    """
    for name, value in others.items():
        if value is not None:
            raise ArgumentError(
                f"expected no {name} with through=, got {value!r}; the field behind a first-order "
                "system is Collins' integral"
            )
    if has_derivatives(source, points, wavelength):
        raise ArgumentError(
            "expected no derivatives with through=; pass drjit.detach(...) of the arguments, or "
            "differentiate polywigner.wigner, which takes through= as well"
        )
    system = checked_system(through)
    if execution.is_drjit(points):
        compute = partial(
            field_behind, source, wavelength=wavelength, through=system, tolerance=tolerance,
            others={}, squared=squared, return_error=return_error,
        )  # fmt: skip
        return execution.evaluate_hosted(
            compute, "points", points, 2, precision=precision, engine=engine
        )
    places = _checked_plane(points)
    length = checked_wavelength(wavelength)
    double = execution.checked_precision(precision) != "single"
    execution.checked_engine(engine)
    allowed = checked_amplitude_tolerance(tolerance, double)
    flat = places.reshape(-1, 2)
    phase: complex = 1.0
    if isinstance(source, Wavefront):
        source, lens, phase = as_lens(source, length)
        system = system @ lens
    field, error, bounds = collins_field(
        source, radiator_of(source), flat, length, system, allowed, double, engine
    )
    field = field * phase
    warn_of_missed(error, bounds, "points", stacklevel=4)
    if squared:
        field, error = squared_field(field, error)
    elif not double:
        field = field.astype(np.complex64)
    shape = places.shape[:-1]
    values = field.reshape(shape)[()]
    return (values, error.reshape(shape)[()]) if return_error else values


def as_lens(wave: Wavefront, wavelength: float) -> tuple[Any, FirstOrder, complex]:
    """A curved wave as a flat source, a lens directly behind it, and a phase.

    (x - c).Q (x - c) = x.Q x - 2 x.Q c + c.Q c: the second is a tilt, the third the phase.
    """
    checked_wavefront(wave)
    q, slope = wavelength * wave.curvature, wave.curvature @ wave.centre
    lens = FirstOrder(np.block([[np.eye(2), np.zeros((2, 2))], [q, np.eye(2)]]))
    turns = float(wave.centre @ slope) / 2
    phase = complex(np.exp(2j * np.pi * (turns - round(turns))))
    return tilted_source(wave.source, -slope), lens, phase


def squared_field(field: Any, error: Any) -> tuple[Any, Any]:
    """|U|^2, and its error."""
    modulus = np.abs(field).astype(np.float64)
    return np.square(modulus), (2 * modulus + error) * error


def _checked_plane(points: Any) -> NDArray[np.float64]:
    """Points (..., 2) of the plane behind a system."""
    expected = "expected points as real numbers of shape (..., 2) with through="
    try:
        array = real_numbers(points)
    except ValueError as error:
        raise ArgumentError(f"{expected}, in metres, got {error}") from None
    if array.ndim == 0 or array.shape[-1] != 2:
        hint = "; z is the system's" if array.ndim and array.shape[-1] == 3 else ""
        raise ArgumentError(f"{expected}, x and y in the plane behind it, got {array.shape}{hint}")
    if not np.isfinite(array).all():
        raise ArgumentError("expected finite points, got inf or nan; leave such points out")
    return array
