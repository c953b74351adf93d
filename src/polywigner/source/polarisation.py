"""Polarisations of sources: Jones vectors along the x and y axes of an aperture.

The time factor is exp(-i omega t), with exp(+i k R) in free space. The names "right" and "left"
follow IEEE: with the thumb along the wave, the fingers of that hand follow the rotation of the
field.
"""

from __future__ import annotations

import math
import re
from typing import Any, Literal, NamedTuple

import numpy as np

from polywigner.errors import ArgumentError, value_text
from polywigner.geometry.arguments import complex_array
from polywigner.numerics import Complex
from polywigner.source.normal_form import normal_form

CurrentModel = Literal["huygens", "magnetic", "electric"]


class Currents(NamedTuple):
    """Fractions of the magnetic and electric currents that replace a field u p, equation (VP1)."""

    magnetic: float
    electric: float


MODELS = {
    "huygens": Currents(0.5, 0.5),
    "magnetic": Currents(1.0, 0.0),
    "electric": Currents(0.0, 1.0),
}
"""Currents in the plane of a source, by the name of the model."""

_HALF = math.sqrt(0.5)
_NAMED = {
    "x": (1.0, 0.0),
    "y": (0.0, 1.0),
    "right": (_HALF, 1j * _HALF),
    "left": (_HALF, -1j * _HALF),
}
_SLANT = re.compile(r"([+-]?\d+(?:\.\d*)?)\s*(?:deg|°)")
_EXPECTED = (
    'expected polarisation to be "x", "y", "right", "left", a slant such as "45 deg", or a '
    "Jones vector of two complex numbers"
)


def checked_polarisation(polarisation: Any, source: Any = None) -> Complex:
    """Return the unit Jones vector (2,) along x and y, or one per element of an array, (n, 2).

    Accepts "x", "y", "right", "left", a slant from x towards y such as "45 deg", a complex Jones
    vector of any length, and for an `Array` of n elements a list with one polarisation for each
    element. Raises ArgumentError for other values.

    Examples
    --------
    >>> checked_polarisation("right").round(3)
    array([0.707+0.j   , 0.   +0.707j])
    """
    if isinstance(polarisation, str):
        return _vector_of_text(polarisation)
    count = _element_count(source)
    if isinstance(polarisation, (list, tuple)) and any(isinstance(p, str) for p in polarisation):
        if count and len(polarisation) == count:
            return np.array([checked_polarisation(p) for p in polarisation])
        raise _error(polarisation, count)
    shapes = [(2,), (count, 2)] if count else [(2,)]
    vectors = complex_array(polarisation, _expected_text(count), *shapes)
    size = np.abs(vectors).max(axis=-1, keepdims=True)
    if not (size >= np.finfo(np.float64).tiny).all():
        raise _error(polarisation, count)
    vectors = vectors / size
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def is_pair(polarisation: Any) -> bool:
    """Return whether a value is a pair of polarisations for two sources.

    Two numbers are the components of a single Jones vector.
    """
    if not isinstance(polarisation, (list, tuple)):
        polarisation = list(polarisation) if np.ndim(polarisation) > 0 else []
    kinds = (str, list, tuple, np.ndarray)
    return len(polarisation) == 2 and all(isinstance(item, kinds) for item in polarisation)


def checked_pair(polarisation: Any, first: Any, second: Any) -> tuple[Complex, Complex]:
    """Return the Jones vectors of two sources, from a pair or from one polarisation for both."""
    pair = polarisation if is_pair(polarisation) else (polarisation, polarisation)
    return checked_polarisation(pair[0], first), checked_polarisation(pair[1], second)


def _element_count(source: Any) -> int:
    """Return the number of elements of an array; 0 for other sources."""
    return len(getattr(getattr(source, "source", source), "weights", ()))


def _vector_of_text(text: str) -> Complex:
    """Return the Jones vector (2,) of a name such as "x", or of a slant such as "45 deg".

    Raises ArgumentError for other text.
    """
    name = text.strip().lower()
    if name in _NAMED:
        return np.array(_NAMED[name], np.complex128)
    slant = _SLANT.fullmatch(name)
    if slant is None:
        raise _error(text, 0)
    angle = math.radians(math.fmod(float(slant[1]), 360.0))
    return np.array([math.cos(angle), math.sin(angle)], np.complex128)


def _expected_text(count: int) -> str:
    """Return the description of valid polarisations for error messages."""
    elements = f", or a list with one of these for each of the {count} elements" if count else ""
    return f"{_EXPECTED}{elements}"


def _error(value: Any, count: int) -> ArgumentError:
    """Return the error for an invalid polarisation of a source with ``count`` elements."""
    return ArgumentError(f"{_expected_text(count)}, got {value_text(value)}")


def components(source: Any, polarisation: Complex) -> list[tuple[Any, Complex]]:
    """Return scalar sources u and vectors (2,); the sum of their products is the polarised field.

    A polarisation (2,) results in the source itself. One polarisation for each element, (n, 2),
    results in one source for the field along x and one for the field along y. A source is omitted
    if its field is zero.
    """
    if polarisation.ndim == 1:
        return [(source, polarisation)]
    form = normal_form(source)
    parts = form.weights[:, None] * polarisation
    return [
        (form.with_weights(part).public, axis)
        for part, axis in zip(parts.T, np.eye(2, dtype=np.complex128), strict=True)
        if part.any()
    ]


Stokes = tuple[float, float, float, float]
"""Stokes parameters S0 to S3 of a wave towards the observer, with respect to x and y; S3 > 0 is
left-handed (IEEE)."""

# Rounding error of weights and Jones vectors.
_ROUNDING = 1e-12


def stokes_vector(polarisation: Complex) -> Stokes:
    """Return (1, S1, S2, S3) of a unit Jones vector (2,), with S3 = 2 Im(p_x p_y*).

    Mitsuba uses the same sign convention for S3: S3 is -1 for "right", which is called left-handed
    circular polarisation in optics.

    Examples
    --------
    >>> stokes_vector(checked_polarisation("right"))
    (1.0, 0.0, 0.0, -1.0)
    """
    x, y = (complex(value) for value in polarisation)
    product = 2 * x * y.conjugate()
    values = (abs(x) ** 2 - abs(y) ** 2, product.real, product.imag)
    s1, s2, s3 = (round(value, 15) + 0.0 for value in values)
    return (1.0, s1, s2, s3)


def stokes_fields(source: Any, polarisation: Complex) -> list[tuple[Any, Stokes]]:
    """Return scalar sources and their Stokes vectors, which together form a polarised field.

    The Stokes parameters of the field are the sum of irradiance times Stokes vector. For one
    polarisation per element (n, 2), the sources are u_x, u_y, u_x + u_y and u_x + i u_y. A source
    is omitted if its field is zero.
    """
    if polarisation.ndim == 1:
        return [(source, stokes_vector(polarisation))]
    form = normal_form(source)
    x, y = form.weights * polarisation.T
    fields: list[tuple[Complex, Stokes]] = [
        (x, (1.0, 1.0, -1.0, -1.0)),
        (y, (1.0, -1.0, -1.0, -1.0)),
        (x + y, (0.0, 0.0, 1.0, 0.0)),
        (x + 1j * y, (0.0, 0.0, 0.0, 1.0)),
    ]
    least = _ROUNDING * np.abs(form.weights).max()
    return [
        (form.with_weights(weights).public, stokes)
        for weights, stokes in fields
        if np.abs(weights).max() > least
    ]


def ludwig_axes(x: Any, y: Any, z: Any) -> tuple[tuple[Any, Any, Any], tuple[Any, Any, Any]]:
    """Return unit vectors of fields along x and y that radiate in the direction (x, y, z), z >= 0.

    The arguments are floats or arrays of any engine. The vectors are q - (q.s)(z + s)/(1 + z.s) for
    q = x and q = y. They follow from x and y by the smallest rotation that turns z into the
    direction s. With Kirchhoff's condition, the product with a scalar far field is the field of a
    Huygens source.

    References
    ----------
    A. C. Ludwig, "The definition of cross polarization", IEEE Trans. Antennas Propag. 21, 116
    (1973).

    Examples
    --------
    >>> ludwig_axes(0.0, 0.6, 0.8)
    ((1.0, -0.0, -0.0), (-0.0, 0.8, -0.6))
    """
    scale = 1.0 / (1.0 + z)
    mixed = -x * y * scale
    return (1.0 - x * x * scale, mixed, -x), (mixed, 1.0 - y * y * scale, -y)


def polarisation_text(polarisation: Complex) -> str:
    """Format Jones vectors (2,) or (n, 2) for a scene: "1, 0.5j; ..."."""
    rows = np.atleast_2d(polarisation).tolist()
    return "; ".join(", ".join(str(value) for value in row) for row in rows)


def polarisation_name(polarisation: Complex) -> str:
    """Format Jones vectors (2,) or (n, 2) for messages: "y", "45 deg", "right".

    Examples
    --------
    >>> polarisation_name(checked_polarisation("45 deg")), polarisation_name(np.array([0, 1]))
    ('45 deg', 'y')
    """
    if polarisation.ndim == 2:
        return "one per element"
    for name, vector in _NAMED.items():
        if np.abs(polarisation - vector).max() <= _ROUNDING:
            return name
    x, y = polarisation.tolist()
    if not np.iscomplex(polarisation).any():
        return f"{math.degrees(math.atan2(y.real, x.real)):.6g} deg"
    return f"({x:.4g}, {y:.4g})"


def polarisation_of_text(text: str, source: Any) -> Complex:
    """Parse Jones vectors in a scene: names, slants or "1, 0.5j", separated by ";".

    Returns one unit vector (2,), or one for each element of ``source``, (n, 2), if they differ.
    Raises ArgumentError for other text.

    Examples
    --------
    >>> polarisation_of_text("1, 1j", None).round(3)
    array([0.707+0.j   , 0.   +0.707j])
    """
    parts = [part for part in text.split(";") if part.strip()]
    vectors = [checked_polarisation(_complex_numbers(part)) for part in parts]
    if len(vectors) == 1:
        return vectors[0]
    if not vectors or len(vectors) != _element_count(source):
        raise _error(text, _element_count(source))
    jones = np.array(vectors)
    same = np.abs(jones - jones[0]).max() <= _ROUNDING
    return jones[0] if same else jones


def _complex_numbers(text: str) -> str | list[complex]:
    """Split text such as "1, 0.5j" into complex numbers; return other text unchanged."""
    if "," not in text:
        return text
    try:
        return [complex(number.replace(" ", "")) for number in text.split(",")]
    except ValueError:
        return text
