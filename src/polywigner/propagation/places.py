"""Points, wavelengths and methods of propagation, checked once at the public edge."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, value_text
from polywigner.geometry.arguments import (
    checked_choice,
    checked_number,
    checked_row,
    real_numbers,
    shape_of,
    warn_caller,
)
from polywigner.source.obliquities import BoundaryCondition
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray

Angles = NDArray[np.float64]


def checked_theta(values: Any) -> Angles:
    """Angles from the normal (n,) in rad, from -pi to pi; ArgumentError for anything else."""
    return checked_angles(values, "theta", math.pi)


def checked_phi(values: Any) -> Angles:
    """Angles from the x axis (n,) in rad; ArgumentError for anything else."""
    return checked_angles(values, "phi", math.inf)


def angle_axes(theta: Angles, phi: Angles) -> dict[str, xarray.Variable]:
    """Coordinates theta and phi in rad of a dataset."""
    axes = {"theta": (theta, "angle from z"), "phi": (phi, "angle from x")}
    return {
        name: labelled_array(values, (name,), {"units": "rad", "long_name": meaning})
        for name, (values, meaning) in axes.items()
    }


def unit_vectors(theta: Angles, phi: Angles) -> NDArray[np.float64]:
    """(n, m, 3) of all angles (n,) from the z axis and (m,) from the x axis."""
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    # cos(pi/2) is 6e-17, and the horizon belongs to both sides
    cosine = np.where(np.abs(cosine) < 1e-15, 0.0, cosine)
    parts = np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), cosine)
    return np.stack(parts, axis=-1)


def checked_angles(values: Any, name: str, largest: float) -> Angles:
    """Angles (n,) in rad, at most so large; ArgumentError for anything else."""
    expected = f"expected {name} as angles (n,) in rad"
    angles = checked_row(values, expected)
    if not np.isfinite(angles).all() or np.abs(angles).max() > largest * (1 + 1e-12):
        raise ArgumentError(
            f"{expected}, finite and from -{largest:.4g} to {largest:.4g}, "
            f"got {value_text(values)}; use "
            "numpy.radians for degrees"
        )
    return angles


Method = Literal[BoundaryCondition, "fresnel", "fraunhofer"]

METHODS: tuple[str, ...] = get_args(Method)
"""Methods for a field, an amplitude with a phase."""

DEFAULT_TOLERANCE = {True: 1e-9, False: 1e-5}
"""Relative errors of fields, in double (True) and in single precision."""

# The least that can be asked for: some tens of roundings.
_LEAST = {True: 1e-13, False: 1e-6}


def checked_coordinates(points: Any, expected: str, *shape: int) -> NDArray[np.float64]:
    """Finite coordinates in metres, of axes ``shape`` at the end; ArgumentError for others."""
    try:
        array = real_numbers(points)
    except ValueError as error:
        raise ArgumentError(f"{expected}, in metres, got {error}") from None
    if array.shape[-len(shape) :] != shape:
        raise ArgumentError(f"{expected}, in metres, got shape {shape_of(points)}")
    if not np.isfinite(array).all():
        bad = ~np.isfinite(array).all(axis=-1)
        raise ArgumentError(
            f"expected finite points, got {array[bad][0].tolist()}; leave such points out"
        )
    return array


def checked_points(points: Any) -> NDArray[np.float64]:
    """Points (..., 3) in metres in front of the source, at z > 0; ArgumentError for others."""
    expected = "expected points as real numbers of shape (..., 3), components x, y, z last"
    array = checked_coordinates(points, expected, 3)
    behind = array[..., 2] <= 0
    if behind.any():
        raise ArgumentError(
            "expected points in front of the source, z > 0, got "
            f"{array[behind][0].tolist()}; sources lie in the plane z = 0 and radiate to +z"
        )
    return array


def checked_amplitude_tolerance(tolerance: float | None, double: bool) -> float:
    """A tolerance that :func:`amplitude` can keep; ArgumentError for others."""
    if tolerance is None:
        return DEFAULT_TOLERANCE[double]
    least = _LEAST[double]
    meaning = f"a number from {least:g} to 0.1"
    number = checked_number(tolerance, "tolerance", meaning)
    if not least <= number <= 0.1:
        hint = "" if number > 0.1 or double else '; precision="double" has 1e-13'
        raise ArgumentError(f"expected tolerance as {meaning}, got {value_text(tolerance)}{hint}")
    return number


def checked_method(method: Any, allowed: Collection[str] = METHODS) -> str:
    """The name of a method; ArgumentError with all names that are allowed for any other."""
    return checked_choice(method, "method", allowed)


def warn_of_missed(errors: NDArray[np.float64], allowed: NDArray[np.float64], what: str) -> None:
    """Warn of results, by their name, whose errors are larger than allowed."""
    missed = ~(errors <= allowed)
    if missed.any():
        worst = float((errors[missed] / allowed[missed]).max())
        warn_caller(
            f"{int(missed.sum())} of {len(errors)} {what} miss the tolerance, the worst by a "
            f"factor of {worst:.3g}; see return_error=True, or allow a larger tolerance"
        )
