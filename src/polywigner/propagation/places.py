"""Points, wavelengths and methods of propagation, checked once at the public edge."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_wavelength, shape_of
from polywigner.geometry.numbers import real_numbers

__all__ = [
    "METHODS",
    "Method",
    "checked_method",
    "checked_name",
    "checked_points",
    "checked_wavelength",
]

Method = Literal[
    "rayleigh-sommerfeld-1", "rayleigh-sommerfeld-2", "kirchhoff", "fresnel", "fraunhofer"
]

METHODS: tuple[str, ...] = get_args(Method)
"""What a field, an amplitude with a phase, can be computed by."""


def checked_points(points: Any) -> NDArray[np.float64]:
    """Points (..., 3) in metres as float64.

    Raises ArgumentError for anything but finite real numbers (..., 3), and for points that are not
    in front of the source, at z > 0.
    """
    expected = "expected points as real numbers of shape (..., 3)"
    try:
        array = real_numbers(points)
    except ValueError as error:
        raise ArgumentError(f"{expected}, in metres, got {error}") from None
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ArgumentError(f"{expected}, components x, y, z last, got shape {shape_of(points)}")
    if not np.isfinite(array).all():
        bad = ~np.isfinite(array).all(axis=-1)
        raise ArgumentError(
            f"expected finite points, got {array[bad][0].tolist()}; leave such points out"
        )
    behind = array[..., 2] <= 0
    if behind.any():
        raise ArgumentError(
            "expected points in front of the source, z > 0, got "
            f"{array[behind][0].tolist()}; sources lie in the plane z = 0 and radiate to +z"
        )
    return array


def checked_method(method: Any, allowed: Sequence[str] = METHODS) -> str:
    """The name of a method; ArgumentError with all names that are allowed for any other."""
    return checked_name("method", method, allowed)


def checked_name(argument: str, name: Any, allowed: Sequence[str]) -> str:
    """One of the names allowed for an argument; ArgumentError that lists them for any other."""
    if not isinstance(name, str) or name not in allowed:
        names = ", ".join(f'"{each}"' for each in allowed)
        raise ArgumentError(f"expected {argument} to be one of {names}, got {name!r}")
    return name
