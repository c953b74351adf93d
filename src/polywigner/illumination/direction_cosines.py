"""Fields whose waves are weighted by their direction cosines, for obliquity factors.

The waves exp(2 pi i kappa_m.x) of a field leave a plane with direction cosines p_m (D1), and the
obliquity factors of diffraction integrals are products of these (D2). Products of sums over waves
are the sesquilinear functions W and A of fields with amplitudes p_m c_m.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, IlluminationError
from polywigner.geometry import Aperture, PlacedAperture, Slits
from polywigner.geometry.arguments import checked_length
from polywigner.illumination.array import Array, phased_array
from polywigner.illumination.waves import Illumination

__all__ = [
    "AnySource",
    "direction_cosines",
    "fields_of",
    "grazing_error",
    "plus_direction_cosine",
    "times_direction_cosine",
]

_Element = Aperture | PlacedAperture | Slits
AnySource = _Element | Array
_Source = TypeVar("_Source", bound=AnySource)


def direction_cosines(
    frequencies: NDArray[np.float64], wavelength: float
) -> NDArray[np.complex128]:
    """p = sqrt(1 - (wavelength |kappa|)^2) of waves with frequencies (..., d), complex (...).

    (D1): the cosine of the angle between a wave's direction and the normal of the plane; i times a
    number above zero for evanescent waves, |kappa| > 1/wavelength, which decay away from the plane.
    Accurate to a few roundings of kappa, near grazing too. The wavelength in metres.
    """
    sine = np.linalg.norm(np.asarray(frequencies, dtype=np.float64) * wavelength, axis=-1)
    # As a product of two roots, which loses nothing to the square of a sine near 1, and does not
    # overflow.
    return np.sqrt((1 - sine).astype(np.complex128)) * np.sqrt(1 + sine)


def fields_of(source: AnySource) -> tuple[Illumination | None, ...]:
    """The fields of the elements of a source, None for those without; equal elements count once."""
    if not isinstance(source, Array):
        return (_field_of(source),)
    elements = source.elements if source.repeated is None else (source.repeated[0],)
    return tuple(dict.fromkeys(_field_of(element) for element in elements))


def times_direction_cosine(source: _Source, wavelength: float, add_one: bool = False) -> _Source:
    """The source with amplitudes p_m c_m in place of c_m, p_m the direction cosine of wave m (D1).

    An element without a field is a wave at normal incidence, p = 1. Weights of arrays belong to
    elements, not to directions, and stay as they are; equal elements of a `phased_array` stay that.
    For what it is good for see (D2) and (D3).

    Parameters
    ----------
    source
        An Aperture (placed or not), Slits, or an Array of them.
    wavelength
        In metres.
    add_one
        (p_m + 1) c_m instead.

    Returns
    -------
    A source of the same kind, of the same outlines.

    Raises
    ------
    ArgumentError for polyhedra and other things, and for wavelengths that are not above zero;
    IlluminationError if all waves graze the plane, |kappa| = 1/wavelength, so that nothing is left.
    """
    return plus_direction_cosine(source, wavelength, 1.0 if add_one else 0.0)


def plus_direction_cosine(source: _Source, wavelength: float, constant: complex) -> _Source:
    """The source with amplitudes (p_m + constant) c_m: :func:`times_direction_cosine`."""
    length = checked_length(wavelength, "wavelength")
    if isinstance(source, Array):
        return cast(_Source, _of_array(source, length, constant))
    scaled, factor = _of_element(source, length, constant)
    if factor == 0:
        raise grazing_error(length)
    whole = scaled if factor == 1 else _with_field(scaled, _constant(factor, scaled))
    return cast(_Source, whole)


def _of_array(array: Array, wavelength: float, constant: complex) -> Array:
    elements = array.elements if array.repeated is None else (array.repeated[0],)
    scaled, factors = zip(*(_of_element(e, wavelength, constant) for e in elements), strict=True)
    weights = array.weights * np.array(factors)
    if not weights.any():
        raise grazing_error(wavelength)
    if array.repeated is not None:
        return phased_array(scaled[0], array.repeated[1], weights)
    return Array(scaled, weights)


def _of_element(element: object, wavelength: float, constant: complex) -> tuple[_Element, complex]:
    """(an element, a number): their product is the element wanted.

    The number is there so that elements without a field stay so, whose kernels are faster; and it
    is 0 for an element of grazing waves alone.
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
    """The error for a field of which nothing leaves the plane."""
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


def _constant(value: complex, element: _Element) -> Illumination:
    return Illumination([value], np.zeros((1, 1 if isinstance(element, Slits) else 2)))
