"""Exact and Fresnel fields with derivatives in points and in numbers of the source."""

from __future__ import annotations

from functools import partial
from typing import Any

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.propagation.field_slopes import FieldSlopes
from polywigner.propagation.places import checked_method, checked_wavelength
from polywigner.propagation.screens import Screen
from polywigner.radiometry.directions import checked_source
from polywigner.transforms import Differentiable
from polywigner.transforms.traced_sources import parameters_of

__all__ = ["has_derivatives", "traced_field"]

# Default tolerance of derivatives, which are sums of float64.
_TOLERANCE = 1e-9


def has_derivatives(source: Any, points: Any, wavelength: Any) -> bool:
    """Whether an argument is there to be differentiated in."""
    if isinstance(source, Differentiable) or execution.is_drjit(wavelength):
        return True
    return execution.is_drjit(points) and execution.has_gradient(points)


def traced_field(
    compute: Any,
    source: Any,
    points: Any,
    wavelength: Any,
    method: Any,
    tolerance: float | None,
    *,
    precision: str | None,
    engine: str,
) -> execution.TracedField:
    """The field of a source, by ``compute(plain source, points, wavelength, method, ...)``.

    Raises ArgumentError for a wavelength that is an array, for Fraunhofer's field, and for screens.
    """
    if isinstance(source, Screen):
        raise ArgumentError(
            "expected no derivatives of fields behind a Screen, which has none; pass "
            "drjit.detach(...) of the points"
        )
    name = checked_method(method)
    if name == "fraunhofer":
        raise ArgumentError(
            'expected a method other than "fraunhofer" with derivatives; differentiate the '
            "transform pw.fourier instead, or pass drjit.detach(...) of what needs none"
        )
    if execution.is_drjit(wavelength):
        raise ArgumentError(
            'expected a wavelength without derivatives, which only method="wigner" has, got a '
            f"{type(wavelength).__name__}; pass a float"
        )
    traced = source if isinstance(source, Differentiable) else Differentiable(source)
    checked_source(traced.source)
    length = checked_wavelength(wavelength)
    by_waves = traced.amplitudes is not None
    own = _TOLERANCE if tolerance is None else tolerance
    slopes = FieldSlopes(traced.source, length, name, own, by_waves)
    return execution.hosted_field(
        partial(compute, traced.source, wavelength=length, method=name, tolerance=tolerance),
        slopes,
        points,
        parameters_of(traced),
        precision=execution.checked_precision(precision),
        engine=execution.checked_engine(engine),
    )
