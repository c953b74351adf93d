"""Irradiance of partially coherent light as a double integral of the mutual intensity.

The quadrature sums over all pairs of nodes with the degree of coherence exp(-xi^2/(2 width^2)).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

Kernel = Callable[[Any, Any, float], Any]
"""Places (n, 2) and points (m, 3) and the wavelength to waves (m, n)."""


def first_integral(x: Any, points: Any, wavelength: float) -> Any:
    """Return the first Rayleigh-Sommerfeld kernel, which multiplies the field in the opening."""
    k = 2 * np.pi / wavelength
    away = points[:, None, :2] - x
    height = points[:, 2, None]
    reach = np.sqrt((away**2).sum(axis=-1) + height**2)
    return height / reach**2 * (1 + 1j / (k * reach)) * np.exp(1j * k * reach) / (1j * wavelength)


def second_integral(x: Any, points: Any, wavelength: float) -> Any:
    """Return the second Rayleigh-Sommerfeld kernel, for the normal derivative over ik."""
    away = points[:, None, :2] - x
    reach = np.sqrt((away**2).sum(axis=-1) + points[:, 2, None] ** 2)
    return np.exp(2j * np.pi * reach / wavelength) / (1j * wavelength * reach)


def parabolic(x: Any, points: Any, wavelength: float) -> Any:
    """Return Fresnel's kernel without exp(ikz)."""
    away = points[:, None, :2] - x
    spread = wavelength * points[:, 2, None]
    return np.exp(1j * np.pi * (away**2).sum(axis=-1) / spread) / (1j * spread)


def irradiance(
    x: Any, weights: Any, points: Any, wavelength: float, width: float, kernel: Kernel
) -> Any:
    """Return the irradiance (m,) at points (m, 3) from nodes (n, 2) with weighted fields (n,)."""
    distance2 = ((x[:, None] - x) ** 2).sum(axis=-1)
    degree = np.exp(-distance2 / (2 * width**2))
    waves = kernel(x, np.asarray(points, dtype=np.float64), wavelength) * weights
    return np.einsum("mi,ij,mj->m", waves, degree, waves.conj(), optimize=True).real


def irradiance_of_tilts(
    x: Any,
    waves: list[tuple[Any, Any]],
    points: Any,
    wavelength: float,
    width: float,
    a: float,
    b: float,
) -> Any:
    """Return the irradiance by a sum over tilts on a dense grid.

    The kernel is a times the first kernel plus b times the second kernel. ``waves`` contains
    weights (n,) times the field of each plane wave, and the spatial frequency (2,) of the wave. The
    normal derivative of a wave of frequency t is ik p_z(t) times its field.
    """
    reach = 6.5 / (2 * np.pi * width)
    t = np.linspace(-reach, reach, 81)
    tilts = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)
    shares = np.exp(-2 * (np.pi * width) ** 2 * (tilts**2).sum(axis=1))
    points, field = np.asarray(points, dtype=np.float64), 0.0
    for weights, frequency in waves:
        tilted = np.exp(2j * np.pi * (x @ tilts.T)) * weights[:, None]
        cosine = np.sqrt(1 - wavelength**2 * ((tilts + frequency) ** 2).sum(axis=1) + 0j)
        field = field + a * (first_integral(x, points, wavelength) @ tilted)
        field = field + b * cosine * (second_integral(x, points, wavelength) @ tilted)
    return np.abs(field) ** 2 @ shares / shares.sum()
