"""Angles from the normal of a source, and about it, as unit vectors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_row, warn_of_degrees

__all__ = ["checked_angles", "checked_phi", "checked_theta", "unit_vectors"]

Angles = NDArray[np.float64]


def checked_theta(values: Any) -> Angles:
    """Angles from the normal (n,) in rad, from -pi to pi; ArgumentError for anything else."""
    return checked_angles(values, "theta", math.pi)


def checked_phi(values: Any) -> Angles:
    """Angles from the x axis (n,) in rad; ArgumentError for anything else."""
    return checked_angles(values, "phi", math.inf)


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
            f"{expected}, finite and from -{largest:.4g} to {largest:.4g}, got {values!r}; use "
            "numpy.radians for degrees"
        )
    warn_of_degrees(name, angles)
    return angles
