"""From a radiance to a diffraction integral: the factor h of the emitted radiance.

The Wigner radiance W/lambda^2 leaves the choice of the diffraction integral open. A floor
parallel to the aperture receives (R1), to leading order,

    I = (1/lambda^2) int W g / |r|^2 dx,

and a renderer that lights it with the radiance L collects int L cos^2(theta) / |r|^2 dx: one
cosine from the emitter, one from the receiver. Hence L = h W/lambda^2 with h = g/cos^2. The
emitter cannot know the receiver, so h is defined by that parallel floor.

Of fields of several waves g belongs to pairs of waves, and what stands for g W is a sum of Wigner
functions of up to three fields, with factors that depend on the angle alone: (D2) and (D3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.illumination.direction_cosines import (
    direction_cosines,
    fields_of,
    times_direction_cosine,
    warn_of_slopes,
)

__all__ = [
    "OBLIQUITIES",
    "Emission",
    "check_obliquity",
    "depends_on_wavelength",
    "emission_factor",
    "emissions",
]

OBLIQUITIES = ("rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2", "paper")

# Whatever the directions of the waves.
_OF_ANY_FIELD = {"rayleigh-sommerfeld-1": (0.0, 0.0, 1.0), "paper": (0.0, 1.0, 0.0)}


@dataclass(frozen=True)
class Emission:
    """One term of a radiance: the Wigner function of a source times h(theta)."""

    source: Aperture | Array
    coefficients: tuple[float, float, float]
    """(a, b, d) of h = a/cos^2 + b/cos + d."""


def check_obliquity(name: str) -> str:
    """``name`` itself, or a SceneError that lists what there is."""
    if name not in OBLIQUITIES:
        raise SceneError(
            f"expected an obliquity, got {name!r}; use one of {', '.join(OBLIQUITIES)}"
        )
    return name


def depends_on_wavelength(source: Aperture | Array, name: str) -> bool:
    """Whether `emissions` do: if the directions of waves matter and there are oblique ones."""
    return name not in _OF_ANY_FIELD and any(field is not None for field in fields_of(source))


def emissions(source: Aperture | Array, wavelength: float, name: str) -> tuple[Emission, ...]:
    """Terms that add up to the radiance of a source, times wavelength^2, for an obliquity.

    One term if all its waves leave at one angle, as those of a steered aperture, of a TE10 mode and
    of elements without a field do; else up to three.

    Raises IlluminationError where nothing radiates, because all waves graze the aperture.
    """
    check_obliquity(name)
    if name in _OF_ANY_FIELD:
        return (Emission(source, _OF_ANY_FIELD[name]),)
    warn_of_slopes(source, wavelength, name)
    cosines = _cosines(source, wavelength)
    if len(cosines) == 1 and cosines[0] != 0:
        p = complex(cosines[0])  # not NumPy's, whose products with arrays of Dr.Jit are NumPy's
        square = abs(p) ** 2
        if name == "rayleigh-sommerfeld-2":
            return (Emission(source, (square, 0.0, 0.0)),)
        return (Emission(source, (square / 4, p.real / 2, 0.25)),)
    turned = times_direction_cosine(source, wavelength)
    if name == "rayleigh-sommerfeld-2":
        return (Emission(turned, (1.0, 0.0, 0.0)),)
    both = times_direction_cosine(source, wavelength, add_one=True)
    return (
        Emission(source, (0.0, -0.25, 0.25)),
        Emission(turned, (0.25, -0.25, 0.0)),
        Emission(both, (0.0, 0.25, 0.0)),
    )


def emission_factor(coefficients: tuple[float, float, float], cosine: Any) -> Any:
    """h(theta) for the cosine of the angle from the aperture's normal, above zero.

    Floats or arrays of any engine; dimensionless. All but that of Rayleigh-Sommerfeld I grow
    without bound towards grazing directions; the two cosines of a parallel floor make the received
    part finite again.
    """
    square, single, constant = coefficients
    if square == 0 and single == 0:
        return constant
    inverse = 1.0 / cosine
    return constant + inverse * (single + inverse * square)


def _cosines(source: Aperture | Array, wavelength: float) -> NDArray[np.complex128]:
    """All different direction cosines of the waves of a source."""
    normal = np.ones(1, np.complex128)
    return np.unique(
        np.concatenate(
            [
                normal if field is None else direction_cosines(field.frequencies, wavelength)
                for field in fields_of(source)
            ]
        )
    )
