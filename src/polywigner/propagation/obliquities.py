"""Obliquity factors of rays: which sources, with which weights, make up a boundary condition.

A ray of cosine c that belongs to the waves m and n of a field, which leave the plane with direction
cosines p_m and p_n, carries a factor that is linear in four forms,

    1,    p_m + p_n*,    p_m p_n*,    i (p_n* - p_m)                                        (T4)

Where all waves have one cosine they are numbers. Else each is a combination of functions W (or
moments) of four fields: u, that with amplitudes p_m c_m, and those with (1 + p_m) c_m and
(p_m - i) c_m.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.illumination.direction_cosines import (
    direction_cosines,
    fields_of,
    plus_direction_cosine,
    warn_of_slopes,
)

__all__ = ["Forms", "Obliquity", "checked_obliquity", "weighted_sources"]

Obliquity = Literal["rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2", "paper"]
Forms = tuple[float, float, float, float]

# Waves whose cosines differ by less are at one angle: the rounding of their frequencies.
_SAME_COSINE = 1e-13


def checked_obliquity(obliquity: object, order: int) -> str:
    """The name of an obliquity, None for Rayleigh-Sommerfeld I; ArgumentError for others."""
    if obliquity is None:
        return "rayleigh-sommerfeld-1"
    if obliquity not in get_args(Obliquity):
        names = ", ".join(f'"{name}"' for name in get_args(Obliquity))
        raise ArgumentError(f"expected obliquity to be None or one of {names}, got {obliquity!r}")
    if obliquity == "paper" and order == 3:
        raise ArgumentError(
            'expected obliquity="paper" with order=1, got order 3; the cosine is no boundary '
            'condition of which a third order could be derived: use "rayleigh-sommerfeld-1"'
        )
    return str(obliquity)


def weighted_sources(
    source: Aperture | Array, obliquity: str, wavelength: float, order: int
) -> list[tuple[Aperture | Array, Forms]]:
    """Sources and coefficients of their forms (T4) that add up to the irradiance.

    Warns of fits whose slopes an obliquity takes: :func:`warn_of_slopes`.
    """
    warn_of_slopes(source, wavelength, obliquity)
    if obliquity == "rayleigh-sommerfeld-1":
        return [(source, (1.0, 0.0, 0.0, 0.0))]
    if obliquity == "paper":
        return [(source, (0.0, 1.0, 0.0, 0.0))]
    p = _common_cosine(source, wavelength)
    if obliquity == "rayleigh-sommerfeld-2":
        if p is None:
            return [(plus_direction_cosine(source, wavelength, 0.0), (0.0, 0.0, 1.0, 0.0))]
        return [(source, (0.0, 0.0, abs(p) ** 2, 0.0))]
    if p is not None:
        return [(source, (0.25, p.real / 2, abs(p) ** 2 / 4, p.imag / 2))]
    fields = [
        (source, (0.25, -0.25, 0.0, 0.25)),
        (plus_direction_cosine(source, wavelength, 0.0), (0.0, -0.25, 0.25, 0.25)),
        (plus_direction_cosine(source, wavelength, 1.0), (0.0, 0.25, 0.0, 0.0)),
        (plus_direction_cosine(source, wavelength, -1j), (0.0, 0.0, 0.0, -0.25)),
    ]
    return fields if order == 3 else fields[:3]


def _common_cosine(source: Aperture | Array, wavelength: float) -> complex | None:
    """The direction cosine of all waves of a source, or None if they differ."""
    still = np.zeros((1, 2))
    waves = [still if field is None else field.frequencies for field in fields_of(source)]
    cosines = direction_cosines(np.concatenate(waves), wavelength)
    same = float(np.abs(cosines - cosines[0]).max()) <= _SAME_COSINE
    return complex(cosines[0]) if same else None
