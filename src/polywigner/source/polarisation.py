"""Polarisations of sources: Jones vectors in the x and y of an aperture.

Waves turn as exp(-i omega t) (the convention exp(+i k R) of free space), seen with z towards the
reader; "right" and "left" are IEEE's: the thumb along the wave, fingers as the field turns.
"""

from __future__ import annotations

import math
import re
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.source.normal_form import normal_form

Complexes = NDArray[np.complex128]

CurrentModel = Literal["huygens", "magnetic", "electric"]


class Currents(NamedTuple):
    """Shares of the magnetic and of the electric current that stand for a field u p: (VP1)."""

    magnetic: float
    electric: float


MODELS = {
    "huygens": Currents(0.5, 0.5),
    "magnetic": Currents(1.0, 0.0),
    "electric": Currents(0.0, 1.0),
}
"""Models of polarised sources, by the currents in their plane."""

_HALF = math.sqrt(0.5)
_NAMED = {
    "x": (1.0, 0.0),
    "y": (0.0, 1.0),
    "right": (_HALF, 1j * _HALF),
    "left": (_HALF, -1j * _HALF),
}
_SLANT = re.compile(r"([+-]?\d+(?:\.\d*)?)\s*(?:deg|°)")
_EXPECTED = (
    'expected polarisation as "x", "y", "right", "left", a slant such as "45 deg", or a Jones '
    "vector of two complex numbers"
)


def checked_polarisation(polarisation: Any, source: Any = None) -> Complexes:
    """Unit Jones vector (2,) in the source's x and y, or one (n, 2) for each element of an array.

    Parameters
    ----------
    polarisation
        "x", "y", "right", "left", a slant from x towards y such as "45 deg"; or a Jones vector
        (2,), complex, of any length; for an `Array` of n elements also vectors (n, 2), or a list of
        n names. ArgumentError for anything else.
    source
        The source that has it; None: one vector alone is allowed.

    >>> checked_polarisation("right").round(3)
    array([0.707+0.j   , 0.   +0.707j])
    """
    if isinstance(polarisation, str):
        return _of_text(polarisation)
    count = _count(source)
    if isinstance(polarisation, (list, tuple)) and any(isinstance(p, str) for p in polarisation):
        if count and len(polarisation) == count:
            return np.array([checked_polarisation(p) for p in polarisation])
        raise _error(polarisation, count)
    try:
        vectors = np.array(polarisation, np.complex128)
    except (TypeError, ValueError, OverflowError):
        raise _error(polarisation, count) from None
    shapes = [(2,), (count, 2)] if count else [(2,)]
    if vectors.shape not in shapes or np.ma.is_masked(polarisation):
        raise _error(polarisation, count)
    size = np.abs(vectors).max(axis=-1, keepdims=True)
    if not (np.isfinite(size).all() and (size >= np.finfo(np.float64).tiny).all()):
        raise _error(polarisation, count)
    vectors = vectors / size
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def is_pair(polarisation: Any) -> bool:
    """Whether there is a polarisation for each of two sources, not one for both."""
    if not isinstance(polarisation, (list, tuple)):
        polarisation = list(polarisation) if np.ndim(polarisation) > 0 else []
    kinds = (str, list, tuple, np.ndarray)
    return len(polarisation) == 2 and all(isinstance(one, kinds) for one in polarisation)


def checked_pair(polarisation: Any, first: Any, second: Any) -> tuple[Complexes, Complexes]:
    """Jones vectors of two sources, from one of :func:`checked_polarisation` for both or a pair."""
    one, other = polarisation if is_pair(polarisation) else (polarisation, polarisation)
    return checked_polarisation(one, first), checked_polarisation(other, second)


def _count(source: Any) -> int:
    """Number of elements of an array; zero for another source, and for none."""
    return len(getattr(getattr(source, "source", source), "weights", ()))


def _of_text(text: str) -> Complexes:
    name = text.strip().lower()
    if name in _NAMED:
        return np.array(_NAMED[name], np.complex128)
    slant = _SLANT.fullmatch(name)
    if slant is None:
        raise _error(text, 0)
    angle = math.radians(math.fmod(float(slant[1]), 360.0))
    return np.array([math.cos(angle), math.sin(angle)], np.complex128)


def _error(value: Any, count: int) -> ArgumentError:
    each = f", or one for each of the {count} elements" if count else ""
    return ArgumentError(f"{_EXPECTED}{each}, got {value_text(value)}")


def components(source: Any, polarisation: Complexes) -> list[tuple[Any, Complexes]]:
    """Scalar sources u and vectors (2,) whose products add up to the polarised field.

    One source where all elements have one polarisation; else the parts along x and along y.
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
"""S0 to S3 along x and y, seen with the wave towards the reader; S3 > 0 is left (IEEE)."""

# Weights of sums of fields below this are rounding.
_ROUNDING = 1e-12


def stokes_vector(polarisation: Complexes) -> Stokes:
    """Return (1, S1, S2, S3) of a unit Jones vector (2,), with S3 = 2 Im(p_x p_y*).

    This sign of S3 is Mitsuba's: minus one for "right", which optics calls left.

    >>> stokes_vector(checked_polarisation("right"))
    (1.0, 0.0, 0.0, -1.0)
    """
    x, y = (complex(value) for value in polarisation)
    both = 2 * x * y.conjugate()
    own = (abs(x) ** 2 - abs(y) ** 2, both.real, both.imag)
    s1, s2, s3 = (round(value, 15) + 0.0 for value in own)
    return (1.0, s1, s2, s3)


def stokes_fields(source: Any, polarisation: Complexes) -> list[tuple[Any, Stokes]]:
    """Scalar sources and the Stokes vectors by which their irradiances add up to the field's.

    The source itself where all of it has one polarisation, (2,). Of one for each element (n, 2) the
    fields u_x, u_y, u_x + u_y and u_x + i u_y, but dark ones, whose real irradiances (or functions
    W) make the complex one of u_x and u_y*.
    """
    if polarisation.ndim == 1:
        return [(source, stokes_vector(polarisation))]
    form = normal_form(source)
    x, y = form.weights * polarisation.T
    each: list[tuple[Complexes, Stokes]] = [
        (x, (1.0, 1.0, -1.0, -1.0)),
        (y, (1.0, -1.0, -1.0, -1.0)),
        (x + y, (0.0, 0.0, 1.0, 0.0)),
        (x + 1j * y, (0.0, 0.0, 0.0, 1.0)),
    ]
    least = _ROUNDING * np.abs(form.weights).max()
    lit = [(weights, stokes) for weights, stokes in each if np.abs(weights).max() > least]
    return [(form.with_weights(weights).public, stokes) for weights, stokes in lit]


def ludwig_axes(x: Any, y: Any, z: Any) -> tuple[tuple[Any, Any, Any], tuple[Any, Any, Any]]:
    """Return the unit vectors that fields along x and y have in the direction (x, y, z), z >= 0.

    Floats or arrays of any engine. q - (q.s)(z + s)/(1 + z.s) for q = x and q = y: the plane's axes
    turn as z turns into s the shortest way. Times a scalar far field it has the scalar's
    irradiance; of Kirchhoff's condition it is Huygens' source.

    Source: A. C. Ludwig, "The definition of cross polarization", IEEE Trans. Antennas Propag. 21,
    116 (1973).

    >>> ludwig_axes(0.0, 0.6, 0.8)
    ((1.0, -0.0, -0.0), (-0.0, 0.8, -0.6))
    """
    share = 1.0 / (1.0 + z)
    both = -x * y * share
    return (1.0 - x * x * share, both, -x), (both, 1.0 - y * y * share, -y)


def polarisation_text(polarisation: Complexes) -> str:
    """Return the text of Jones vectors (2,) or (n, 2) for a scene: "1, 0.5j; ..."."""
    rows = np.atleast_2d(polarisation).tolist()
    return "; ".join(", ".join(str(value) for value in row) for row in rows)


def polarisation_name(polarisation: Complexes) -> str:
    """Return a short text of Jones vectors (2,) or (n, 2) for people: "y", "45 deg", "right".

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


def polarisation_of_text(text: str, source: Any) -> Complexes:
    """Return the Jones vectors of a scene's text: names, slants or "1, 0.5j", one or many by ";".

    >>> polarisation_of_text("1, 1j", None).round(3)
    array([0.707+0.j   , 0.   +0.707j])
    """
    parts = [part for part in text.split(";") if part.strip()]
    vectors = [checked_polarisation(_numbers(part)) for part in parts]
    if len(vectors) == 1:
        return vectors[0]
    if not vectors or len(vectors) != _count(source):
        raise _error(text, _count(source))
    found = np.array(vectors)
    same = np.abs(found - found[0]).max() <= _ROUNDING
    return found[0] if same else found


def _numbers(text: str) -> Any:
    """Return a text, or the list of complex numbers that it has between commas."""
    if "," not in text:
        return text
    try:
        return [complex(number.replace(" ", "")) for number in text.split(",")]
    except ValueError:
        return text
