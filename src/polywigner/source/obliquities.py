"""Obliquity factors: the dependence of a source's field on the angle to its normal.

A boundary condition is a pair (a, b). In a direction with the cosine c, it multiplies a wave with
the direction cosine p_m, equation (D1), by a c + b p_m, and the irradiance of two waves m and n by

    g = (a c + b p_m) (a c + b p_n*).

Sources whose waves have different cosines are split into sources with a common factor, equations
(D2) and (D3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import IlluminationError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_choice, checked_length
from polywigner.numerics import Floats
from polywigner.source.array import Array
from polywigner.source.normal_form import (
    PublicSource,
    RepeatedElement,
    Source,
    SourceElement,
    coherent_form,
    normal_form,
)


def direction_cosines(frequencies: Floats, wavelength: float) -> NDArray[np.complex128]:
    """Return p = sqrt(1 - (wavelength |kappa|)^2), shape (...), for kappa (..., d) in 1/m.

    p is the cosine of the angle between a wave and the normal of the plane, equation (D1), and is
    positive imaginary for evanescent waves.
    """
    sine = np.linalg.norm(np.asarray(frequencies, dtype=np.float64) * wavelength, axis=-1)
    # A product of two roots is accurate for sines near 1 and does not overflow.
    return np.sqrt((1 - sine).astype(np.complex128)) * np.sqrt(1 + sine)


def times_direction_cosine(
    source: PublicSource | Source, wavelength: float, constant: complex = 0.0
) -> PublicSource:
    """Return a flat source with amplitudes c_m multiplied by p_m + constant.

    p_m is the direction cosine of wave m, equation (D1). The curvature and the partial coherence of
    the source are dropped. Raises IlluminationError if all products are zero, as for waves that
    graze the plane, |kappa| = 1/wavelength.
    """
    length, form = checked_length(wavelength, "wavelength"), normal_form(source)

    def scaled(element: SourceElement) -> SourceElement:
        """Return an element with the amplitude of each wave multiplied by p_m + constant."""
        factors = direction_cosines(element.frequencies, length) + constant
        amplitudes = factors * element.amplitudes
        # Scaling the weight keeps a uniform element uniform, so that faster kernels are used.
        if element.has_unit_field or not amplitudes.any():
            return replace(element, weight=element.weight * amplitudes[0])
        return replace(element, amplitudes=amplitudes)

    elements = [scaled(element) for element in form.distinct]
    if not any(element.weight for element in elements):
        raise grazing_error(length)
    if form.repeated is None:
        return coherent_form(elements, form.dimension).public
    element, weights = elements[0], form.weights * elements[0].weight
    copies = RepeatedElement(replace(element, weight=1.0), form.repeated.positions, weights)
    return coherent_form(copies, form.dimension).public


def grazing_error(wavelength: float) -> IlluminationError:
    """Return the error for a field whose waves all graze the plane of the source."""
    return IlluminationError(
        "expected waves that leave the plane of the source, got only grazing waves, whose "
        f"spatial frequency is 1/wavelength; use a wavelength other than {wavelength:g} m"
    )


DefaultCondition = Literal["rayleigh-sommerfeld-1"]
BoundaryCondition = Literal["rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2"]
ObliquityName = Literal[BoundaryCondition, "paper"]


class Forms(NamedTuple):
    """Coefficients of the factor g = square c^2 + linear c + constant, equation (D2).

    The coefficients are floats or arrays of any engine.
    """

    square: float
    linear: float
    constant: float

    def irradiance(self, cosine: Any) -> Any:
        """Return the factor g of the irradiance at a cosine of the angle to the normal."""
        return self.square * cosine * cosine + self.linear * cosine + self.constant

    def radiance(self, cosine: Any) -> Any:
        """Return the factor h = g/cos in the radiance h W/lambda^2, for a cosine above zero.

        The radiance is equation (R1). With the normal derivative, h is unbounded at grazing
        directions, but the power is finite.
        """
        return (
            self.square * cosine + self.linear + (self.constant / cosine if self.constant else 0.0)
        )

    def at_lags(self, q: Floats) -> Floats:
        """Return the integral of g exp(i q s_x) over the directions s of a hemisphere, shape (n,).

        ``q`` (n,) above zero: distance of two points times 2 pi/wavelength.
        """
        total = self.square * (np.sin(q) / q - np.cos(q)) / q**2 + self.constant * np.sin(q) / q
        if self.linear:
            count = int(np.ceil(q.max())) + 40
            angle = (np.arange(count) + 0.5) * (np.pi / count)
            mean = np.cos(angle - q[:, None] * np.sin(angle)).mean(axis=1)
            total = total + self.linear * mean / q
        return np.asarray(2.0 * np.pi * total)


@final
@dataclass(frozen=True)
class Obliquity:
    """An obliquity: a boundary condition (a, b), or the factor of the paper."""

    name: ObliquityName
    title: str
    """Name of the obliquity in figures."""
    field: float
    """Weight a of the field in the aperture; 0 for the factor of the paper."""
    slope: float
    """Weight b = 1 - a of the normal derivative of the field."""

    @property
    def is_boundary_condition(self) -> bool:
        """Whether the obliquity is a boundary condition."""
        return self.field + self.slope > 0

    @property
    def needs_normal_derivative(self) -> bool:
        """Whether the factor depends on the directions of the waves (b is not 0)."""
        return self.slope > 0

    @property
    def mirrored(self) -> float:
        """Factor of the mirror image's field in the field at a point, equation (B2).

        The factor is -1 for "rayleigh-sommerfeld-1", 0 for "kirchhoff" and 1 for
        "rayleigh-sommerfeld-2".
        """
        return self.slope - self.field

    def amplitude(self, cosine: Any, p: Any = 1.0) -> Any:
        """Return the factor of the field at a cosine of the angle to the normal.

        ``p`` is the direction cosine of the wave in the aperture, equation (D1). The factor of the
        paper is the square root of the cosine for all waves.
        """
        if not self.is_boundary_condition:
            return np.sqrt(cosine)
        return self.field * cosine + self.slope * p

    def terms(self, source: Aperture | Array, wavelength: float) -> list[tuple[Any, Forms]]:
        """Return up to three flat sources and their forms, whose irradiances add up.

        There is one source if all waves leave at the same angle; otherwise, see equations (D2) and
        (D3).
        """
        if not self.is_boundary_condition:
            return [(source, Forms(0.0, 1.0, 0.0))]
        a, b, mixed = self.field, self.slope, self.field * self.slope
        p = direction_cosines(normal_form(source).frequencies, wavelength)
        if not b or float(np.abs(p - p[0]).max()) <= _SAME_COSINE:
            # The coefficients are Python floats, because a NumPy scalar times a Dr.Jit array is a
            # NumPy array.
            return [(source, Forms(a * a, float(2 * mixed * p[0].real), float(abs(b * p[0]) ** 2)))]
        weighted = times_direction_cosine(source, wavelength)
        if not a:
            return [(weighted, Forms(0.0, 0.0, b * b))]
        # The sum p_m + p_n* equals (1 + p_m)(1 + p_n*) - 1 - p_m p_n*.
        return [
            (source, Forms(a * a, -mixed, 0.0)),
            (weighted, Forms(0.0, -mixed, b * b)),
            (times_direction_cosine(source, wavelength, 1.0), Forms(0.0, mixed, 0.0)),
        ]


_ALL = (
    Obliquity("rayleigh-sommerfeld-1", "Rayleigh-Sommerfeld I", 1.0, 0.0),
    Obliquity("kirchhoff", "Kirchhoff", 0.5, 0.5),
    Obliquity("rayleigh-sommerfeld-2", "Rayleigh-Sommerfeld II", 0.0, 1.0),
    Obliquity("paper", "cos θ", 0.0, 0.0),
)
OBLIQUITIES: dict[str, Obliquity] = {each.name: each for each in _ALL}
CONDITIONS = {name: each for name, each in OBLIQUITIES.items() if each.is_boundary_condition}
DEFAULT: DefaultCondition = "rayleigh-sommerfeld-1"
DERIVATIVE_OF = {
    "rayleigh-sommerfeld-1": "rayleigh-sommerfeld-2",
    "kirchhoff": "kirchhoff",
    "rayleigh-sommerfeld-2": "rayleigh-sommerfeld-1",
}
"""The boundary condition with a and b exchanged, which the z derivative of a field obeys."""

# Largest difference between direction cosines that count as equal, due to rounding.
_SAME_COSINE = 1e-13


def obliquity_of(name: object) -> Obliquity:
    """Return the obliquity with a given name; None means the default.

    Raises ArgumentError for unknown names.
    """
    if name is None:
        return OBLIQUITIES[DEFAULT]
    return OBLIQUITIES[checked_choice(name, "obliquity", OBLIQUITIES)]
