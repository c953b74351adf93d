"""Far field of a few multipoles, whose power is exact with a Gauss rule on the sphere."""

from __future__ import annotations

from typing import Any

import numpy as np

FREE_SPACE = 376.730313412  # ohm


def field(theta: Any, phi: Any) -> tuple[Any, Any]:
    """Return rE_theta and rE_phi in V of two electric dipoles, a magnetic dipole and a quadrupole.

    The time factor is exp(+j omega t). For negative theta, the unit vectors of (-theta, phi) are
    minus those of (theta, phi + pi).
    """
    polar = np.cos(theta) * np.cos(phi) + 0.5j * np.sin(phi) + 0.3 * np.sin(2 * theta)
    azimuthal = -np.sin(phi) + 0.5j * np.cos(theta) * np.cos(phi) + 0.2 * np.sin(theta)
    return polar, azimuthal


def intensity(theta: Any, phi: Any) -> Any:
    """Return the radiant intensity in W/sr."""
    return sum(np.abs(part) ** 2 for part in field(theta, phi)) / (2 * FREE_SPACE)


def _power() -> float:
    node, weight = np.polynomial.legendre.leggauss(40)
    mean = intensity(np.arccos(node)[:, None], 2 * np.pi * np.arange(40) / 40).mean(axis=1)
    return float(2 * np.pi * (weight @ mean))


POWER = _power()
"""Watts through a sphere."""
