"""Obliquity factors: how strong a wave that leaves a source is at an angle to the normal.

At the cosine c the field of a wave that leaves the plane with the direction cosine p_m (D1) carries

    a c + b p_m

of a boundary condition (a, b), and the irradiance of two waves m and n

    g = (a c + b p_m) (a c + b p_n*).

So g is linear in three forms: p_m p_n*, p_m + p_n* and 1. If all waves have one cosine, the forms
are numbers. Otherwise each form is a combination of functions W of fields with amplitudes p_m c_m
and (1 + p_m) c_m, see (D2) and (D3). The paper's factor g = c is no boundary condition.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, IlluminationError, PolywignerWarning
from polywigner.geometry import Aperture, PlacedAperture, Slits
from polywigner.geometry.arguments import checked_length
from polywigner.source.array import Array, repeated_element
from polywigner.source.waves import Illumination

_Element = Aperture | PlacedAperture | Slits
AnySource = _Element | Array


def direction_cosines(
    frequencies: NDArray[np.float64], wavelength: float
) -> NDArray[np.complex128]:
    """p = sqrt(1 - (wavelength |kappa|)^2) of waves with frequencies (..., d), complex (...).

    (D1): the cosine of the angle between a wave's direction and the normal of the plane; i times a
    number above zero for evanescent waves, |kappa| > 1/wavelength. The wavelength in metres.
    Accurate to a few roundings of kappa, near grazing too.
    """
    sine = np.linalg.norm(np.asarray(frequencies, dtype=np.float64) * wavelength, axis=-1)
    # As a product of two roots, which loses nothing to the square of a sine near 1, and does not
    # overflow.
    return np.sqrt((1 - sine).astype(np.complex128)) * np.sqrt(1 + sine)


def fields_of(source: AnySource) -> tuple[Illumination | None, ...]:
    """The fields of the elements of a source, None for those without; equal elements count once."""
    elements = source.distinct if isinstance(source, Array) else (source,)
    return tuple(dict.fromkeys(_field_of(element) for element in elements))


def times_direction_cosine(source: Any, wavelength: float, constant: complex = 0.0) -> Any:
    """The source with amplitudes (p_m + constant) c_m in place of c_m, p_m as in (D1).

    An element without a field is a wave at normal incidence, p = 1. Weights of arrays belong to
    elements, and stay as they are; equal elements of a `phased_array` stay that. ArgumentError for
    polyhedra; IlluminationError if all waves graze the plane, |kappa| = 1/wavelength.
    """
    length = checked_length(wavelength, "wavelength")
    elements = source.distinct if isinstance(source, Array) else (source,)
    scaled, factors = zip(*(_scaled(e, length, constant) for e in elements), strict=True)
    weights = np.array(factors) * (source.weights if isinstance(source, Array) else 1.0)
    if not weights.any():
        raise grazing_error(length)
    if not isinstance(source, Array):
        (whole,), (factor,) = scaled, factors
        still = np.zeros((1, 1 if isinstance(whole, Slits) else 2))
        return whole if factor == 1 else _with_field(whole, Illumination([factor], still))
    if source.repeated is not None:
        return repeated_element(scaled[0], source.repeated[1], weights)
    return Array(scaled, weights)


def _scaled(element: object, wavelength: float, constant: complex) -> tuple[_Element, complex]:
    """(an element, a number): their product is the element wanted.

    The number keeps elements without a field so, whose kernels are faster; it is 0 for grazing
    waves.
    """
    if not isinstance(element, Aperture | PlacedAperture | Slits):
        raise ArgumentError(
            "expected a source of apertures or slits, which waves leave at an angle, got "
            f"{type(element).__name__}"
        )
    field = _field_of(element)
    if field is None:
        return element, 1.0 + constant
    factors = direction_cosines(field.frequencies, wavelength) + constant
    amplitudes = factors * field.amplitudes
    if not amplitudes.any():
        return element, 0.0
    return _with_field(element, Illumination(amplitudes, field.frequencies)), 1.0


def grazing_error(wavelength: float) -> IlluminationError:
    """The error for a field that does not leave the plane."""
    return IlluminationError(
        "expected a field with waves that leave the plane, got waves that graze it only, with "
        f"frequencies of 1/wavelength; use another wavelength than {wavelength:g} m"
    )


def _field_of(element: object) -> Illumination | None:
    flat = element.aperture if isinstance(element, PlacedAperture) else element
    field: Illumination | None = getattr(flat, "illumination", None)
    return field


def _with_field(element: _Element, field: Illumination) -> _Element:
    if isinstance(element, PlacedAperture):
        return replace(element, aperture=element.aperture.with_illumination(field))
    return element.with_illumination(field)


BoundaryCondition = Literal["rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2"]
ObliquityName = Literal[BoundaryCondition, "paper"]

Forms = tuple[float, float, float]
"""Coefficients of the square, of the first power and of one in the factor g (D2)."""


@final
@dataclass(frozen=True)
class Obliquity:
    """An obliquity: a boundary condition (a, b), or the paper's factor, which is none."""

    name: ObliquityName
    title: str
    """Its name in figures."""
    field: float
    """a: the part of the field in the opening in the far field."""
    slope: float
    """b = 1 - a: the part of its derivative along the normal."""

    @property
    def is_boundary_condition(self) -> bool:
        return self.field + self.slope > 0

    @property
    def takes_slopes(self) -> bool:
        """Whether the factor depends on the directions of the waves, by the normal derivative."""
        return self.slope > 0

    @property
    def mirrored(self) -> float:
        """Share of the field at a point's mirror image in the field at the point (B2)."""
        return self.slope - self.field

    def forms(self, p: complex) -> Forms:
        """Return the coefficients of the forms (D2) of waves that have one direction cosine p."""
        if not self.is_boundary_condition:
            return (0.0, 1.0, 0.0)
        a, b = self.field, self.slope
        return (a * a, 2 * a * b * p.real, (b * abs(p)) ** 2)

    def of_pairs(self, cosine: Any, p: Any, q: Any) -> Any:
        """Return g of pairs of waves of real direction cosines p and q, at a cosine."""
        if not self.is_boundary_condition:
            return cosine
        return (self.field * cosine + self.slope * p) * (self.field * cosine + self.slope * q)


_ALL = (
    Obliquity("rayleigh-sommerfeld-1", "Rayleigh-Sommerfeld I", 1.0, 0.0),
    Obliquity("kirchhoff", "Kirchhoff", 0.5, 0.5),
    Obliquity("rayleigh-sommerfeld-2", "Rayleigh-Sommerfeld II", 0.0, 1.0),
    Obliquity("paper", "cos θ", 0.0, 0.0),
)
OBLIQUITIES: dict[str, Obliquity] = {each.name: each for each in _ALL}
CONDITIONS = {name: each for name, each in OBLIQUITIES.items() if each.is_boundary_condition}
DEFAULT: BoundaryCondition = "rayleigh-sommerfeld-1"

# Waves whose cosines differ by less are at one angle: the rounding of their frequencies.
_SAME_COSINE = 1e-13


def checked_obliquity(obliquity: object) -> str:
    """The name of an obliquity, None for Rayleigh-Sommerfeld I; ArgumentError for others."""
    if obliquity is None:
        return DEFAULT
    if not isinstance(obliquity, str) or obliquity not in OBLIQUITIES:
        names = ", ".join(f'"{name}"' for name in OBLIQUITIES)
        raise ArgumentError(f"expected obliquity to be None or one of {names}, got {obliquity!r}")
    return obliquity


def warn_of_slopes(source: AnySource, wavelength: float, name: str) -> None:
    """A PolywignerWarning where an obliquity takes slopes that a fit does not know.

    Slopes of a fit's evanescent waves: a field given as waves, such as a taper, has its own.
    """
    if name not in OBLIQUITIES or not OBLIQUITIES[name].takes_slopes:
        return
    for field in fields_of(source):
        if field is None or not field.is_fit:
            continue
        evanescent = int((direction_cosines(field.frequencies, wavelength).imag > 0).sum())
        if evanescent:
            warnings.warn(
                f"{evanescent} of the {len(field)} waves of a fitted field are evanescent, and "
                f"{name!r} takes their slopes, which values on the aperture do not fix; use "
                '"rayleigh-sommerfeld-1", or fit frequencies below 1/wavelength alone',
                PolywignerWarning,
                stacklevel=3,
            )
            return


def weighted_sources(
    source: Aperture | Array, obliquity: str, wavelength: float
) -> list[tuple[Aperture | Array, Forms]]:
    """Sources and coefficients of their forms (D2) that add up to the irradiance.

    One source where all waves leave at one angle, as those of a steered aperture, of a TE10 mode
    and of elements without a field; else up to three: (D2), (D3).
    """
    warn_of_slopes(source, wavelength, obliquity)
    chosen = OBLIQUITIES[obliquity]
    p = _common_cosine(source, wavelength) if chosen.takes_slopes else 0j
    if p is not None:
        return [(source, chosen.forms(p))]
    a, b, mixed = chosen.field, chosen.slope, chosen.field * chosen.slope
    turned = times_direction_cosine(source, wavelength)
    if not a:
        return [(turned, (0.0, 0.0, b * b))]
    # p_m + p_n* = (1 + p_m)(1 + p_n*) - 1 - p_m p_n*
    return [
        (source, (a * a, -mixed, 0.0)),
        (turned, (0.0, -mixed, b * b)),
        (times_direction_cosine(source, wavelength, 1.0), (0.0, mixed, 0.0)),
    ]


def irradiance_factor(forms: Any, cosine: Any) -> Any:
    """g at a cosine, to leading order, from the coefficients of the forms (D2)."""
    first, mixed, both = forms
    return first * cosine * cosine + mixed * cosine + both


def emission_factor(forms: Any, cosine: Any) -> Any:
    """Return h = g/cos for a cosine above zero: the factor of a radiance h W/lambda^2, see (R1).

    Floats or arrays of any engine; dimensionless. Where a boundary condition takes slopes, h grows
    without bound towards grazing directions; the cosine of the projected area makes it finite.
    """
    first, mixed, both = forms
    return first * cosine + mixed + (both / cosine if both else 0.0)


def _common_cosine(source: Aperture | Array, wavelength: float) -> complex | None:
    """The direction cosine of all waves of a source, or None if they differ."""
    still = np.zeros((1, 2))
    waves = [still if field is None else field.frequencies for field in fields_of(source)]
    cosines = direction_cosines(np.concatenate(waves), wavelength)
    same = float(np.abs(cosines - cosines[0]).max()) <= _SAME_COSINE
    # not NumPy's number, whose products with arrays of Dr.Jit are NumPy's
    return complex(cosines[0]) if same else None
