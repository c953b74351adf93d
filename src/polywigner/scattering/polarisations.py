"""Directions and polarisations of a radar, checked once at the public edge."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import real_numbers, shape_of

__all__ = [
    "Channel",
    "Polarisation",
    "checked_channel",
    "checked_polarisations",
    "checked_unit_vectors",
    "checked_wavelengths",
    "spherical_axes",
]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

Channel = Literal["vv", "hh", "vh", "hv"]
Polarisation = Channel | Sequence[ArrayLike]

_EXPECTED = "expected polarisation as None, or one of 'vv', 'hh', 'vh', 'hv' (receiver first)"

# As in illumination.directions: vectors that passed through single precision pass.
_UNIT = 1e-6


def checked_unit_vectors(name: str, vectors: Any) -> Floats:
    """Unit vectors (..., 3), of length 1 after rounding; ArgumentError for anything else."""
    expected = f"expected {name} as unit vectors of shape (..., 3)"
    try:
        array = real_numbers(vectors)
    except ValueError as error:
        raise ArgumentError(f"{expected}, got {error}") from None
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ArgumentError(f"{expected}, got shape {shape_of(vectors)}")
    lengths = np.linalg.norm(array, axis=-1, keepdims=True)
    wrong = ~(np.abs(lengths[..., 0] - 1) <= _UNIT)
    if wrong.any():
        raise ArgumentError(
            f"{expected}, got {array[wrong][0].tolist()}, of length "
            f"{lengths[wrong][0, 0]:.6g}; divide it by its length"
        )
    return np.asarray(array / lengths)


def checked_wavelengths(wavelength: Any) -> Floats:
    """Wavelengths (...) in m; ArgumentError for anything but finite numbers above zero."""
    expected = "expected wavelengths as numbers above zero, in m"
    try:
        array = real_numbers(wavelength)
    except ValueError as error:
        raise ArgumentError(f"{expected}, got {error}") from None
    with np.errstate(over="ignore", under="ignore", divide="ignore"):
        usable = (array > 0) & np.isfinite(array**2) & np.isfinite(1 / array**2)
    if not usable.all():
        raise ArgumentError(f"{expected}, got {array[~usable].flat[0]:g}; check its unit")
    return array


def checked_channel(polarisation: Any) -> Channel:
    """The name of a channel; ArgumentError for anything else."""
    if not isinstance(polarisation, str) or polarisation not in get_args(Channel):
        raise ArgumentError(f"{_EXPECTED}, got {polarisation!r}")
    return cast(Channel, polarisation)


def checked_polarisations(
    polarisation: Polarisation, to_radar: Floats, to_transmitter: Floats
) -> tuple[Complex, Complex]:
    """Polarisations of the receiver and of the transmitter (..., 3), across their directions.

    Raises ArgumentError for anything but names of channels and such vectors.
    """
    if isinstance(polarisation, str):
        receiver, transmitter = (
            spherical_axes(towards)[letter]
            for letter, towards in zip(
                checked_channel(polarisation), (to_radar, to_transmitter), strict=True
            )
        )
        return receiver.astype(np.complex128), transmitter.astype(np.complex128)
    try:
        given, sent = (np.array(p, np.complex128) for p in polarisation)
    except (TypeError, ValueError):
        raise ArgumentError(
            f"{_EXPECTED}, or a pair of vectors (receiver, transmitter), got {polarisation!r}"
        ) from None
    return (
        _across("the receiver's polarisation", given, to_radar),
        _across("the transmitter's polarisation", sent, to_transmitter),
    )


def spherical_axes(towards: Floats) -> dict[str, Floats]:
    """Unit vectors of the polar angle from +z (v) and of the azimuth (h) at directions (..., 3).

    Along z the azimuth counts as 0.
    """
    x, y, z = np.moveaxis(towards, -1, 0)
    across = np.hypot(x, y)
    at_pole = across == 0
    divisor = np.where(at_pole, 1.0, across)
    cosine, sine = np.where(at_pole, 1.0, x / divisor), y / divisor
    return {
        "v": np.stack([z * cosine, z * sine, -across], axis=-1),
        "h": np.stack([-sine, cosine, np.zeros_like(z)], axis=-1),
    }


def _across(name: str, vectors: Complex, towards: Floats) -> Complex:
    expected = f"expected {name} as unit vectors (..., 3) across the direction"
    if vectors.ndim == 0 or vectors.shape[-1] != 3:
        raise ArgumentError(f"{expected}, got shape {vectors.shape}")
    lengths = np.linalg.norm(vectors, axis=-1)
    wrong = ~(np.abs(lengths - 1) <= _UNIT)
    if wrong.any():
        raise ArgumentError(
            f"{expected}, got one of length {lengths[wrong][0]:.6g}; divide it by its length"
        )
    try:
        along = np.abs((vectors * towards).sum(axis=-1))
    except ValueError:
        raise ArgumentError(
            f"{expected}, got shape {vectors.shape} for directions {towards.shape}"
        ) from None
    if (along > _UNIT).any():
        raise ArgumentError(
            f"{expected}, got one that leans by {np.degrees(np.arcsin(min(1, along.max()))):.3g} "
            "degrees towards it; take that part off"
        )
    return vectors
