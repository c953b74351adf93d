"""Directions in which a receiver looks, by the angles alpha and psi, for one variant's arrays.

A direction is (alpha, rho sin psi, rho cos psi), rho = sqrt(1 - alpha^2): alpha is the cosine to
the receiver's x axis, rho sin psi that to its y axis. Solid angles are areas d alpha d psi: no
density has a rim at the horizon.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.illumination.obliquities import irradiance_factor
from polywigner.mitsuba.obliquity import emissions
from polywigner.mitsuba.sampling import Tabulated
from polywigner.transforms import fourier

__all__ = ["direction_of", "directions_of", "in_pixel"]

# Places of the table in a lobe, which is wavelength/size wide in direction cosines.
_IN_LOBE = 4
_FEWEST, _MOST = 32, 1024
# Along each side, so that no narrow beam passes between places of the largest table.
_MOST_WITHIN = 4
# Shares of the samples: in proportion to the far pattern, which far surfaces are seen by; to its
# root, for W and what is near; and everywhere in front.
_SHARES = (0.4, 0.4, 0.2)
# Cosine at the horizon, whose square is still a normal number of float32.
_GRAZING = 1e-9


def directions_of(
    m: Any,
    source: Aperture | Array,
    wavelength: float,
    obliquity: str,
    coherence_width: float = math.inf,
) -> Tabulated:
    """A sampler of (alpha, psi) where the far pattern g |F|^2 is, and with a share everywhere.

    Of a partly coherent source it is about as wide as the pattern is.
    """
    low, high = np.reshape(source.bounds, (2, 2))
    lobes = _IN_LOBE * (high - low) / wavelength
    # powers of two: as a literal, every new size would compile the render kernel again
    wanted = 2.0 ** np.ceil(np.log2(lobes * [2.0, math.pi]))
    counts = np.clip(wanted, _FEWEST, _MOST).astype(int)
    within = int(np.clip(np.ceil((wanted / counts).max()), 1, _MOST_WITHIN))
    pattern = _mean_pattern(source, wavelength, obliquity, counts, within)
    spread = wavelength / (2 * math.pi * coherence_width)
    if spread > 0:
        pattern = _blurred(pattern, spread * counts / np.array([2.0, math.pi]))
    kinds = (pattern, np.sqrt(pattern), np.ones_like(pattern))
    density = sum(share * kind / kind.mean() for share, kind in zip(_SHARES, kinds, strict=True))
    return Tabulated(m, density, np.array([-1.0, -math.pi / 2]), np.array([2.0, math.pi]))


def _mean_pattern(
    source: Any, wavelength: float, obliquity: str, counts: Any, within: int
) -> npt.NDArray[np.float64]:
    """g |F|^2 at the points of a grid, the mean over so many places a side around each."""
    steps = np.array([2.0, math.pi]) / counts
    shifts = (np.arange(within) + 0.5) / within - 0.5
    total: Any = 0.0
    fields = emissions(source, wavelength, obliquity)
    for shift_x in shifts:
        for shift_y in shifts:
            axes = [
                (np.arange(n + 1) + shift) * step - n * step / 2
                for n, shift, step in zip(counts, (shift_x, shift_y), steps, strict=True)
            ]
            alpha, psi = np.clip(axes[0], -1.0, 1.0), axes[1][:, None]
            rho = np.sqrt(1.0 - alpha * alpha)
            cosine = np.maximum(rho * np.cos(psi), 0.0)
            nu = np.stack(np.broadcast_arrays(alpha, rho * np.sin(psi)), axis=-1) / wavelength
            for field, forms in fields:
                factor = irradiance_factor(forms, cosine)
                total = total + np.abs(fourier(field, nu)) ** 2 * factor
    return np.maximum(np.asarray(total), 0.0)


def _blurred(values: npt.NDArray[np.float64], steps: Any) -> npt.NDArray[np.float64]:
    """Values, rows along y, blurred by a normal density of so many steps along x and y."""
    for axis, width in ((1, steps[0]), (0, steps[1])):
        half = min(values.shape[axis] - 1, math.ceil(4 * width))
        weights = np.exp(-0.5 * (np.arange(-half, half + 1) / width) ** 2)
        moved = np.moveaxis(values, axis, -1)
        rows = [np.convolve(row, weights / weights.sum(), mode="same") for row in moved]
        values = np.moveaxis(np.array(rows)[..., : moved.shape[-1]], -1, axis)
    return values


def direction_of(m: Any, angles: Any) -> Any:
    """The unit vector of (alpha, psi), in front of the receiver."""
    rho = _root(1.0 - angles.x * angles.x)
    sine, cosine = dr.sincos(angles.y)
    return m.Vector3f(angles.x, rho * sine, dr.abs(rho * cosine) + _GRAZING)


def in_pixel(m: Any, place: Any, size: tuple[int, int]) -> tuple[Any, Any]:
    """(alpha, psi) uniform in the directions of a pixel, and their solid angle.

    ``place``: on a film of so many pixels, in pixels; columns run along alpha, rows along the
    cosine to y, from -1 to 1 each.
    """
    width, height = size
    alpha = place.x * (2.0 / width) - 1.0
    row = dr.floor(place.y)
    rho = _root(1.0 - alpha * alpha)
    inverse = 1.0 / dr.select(rho > 0.0, rho, 1.0)
    low, high = (
        dr.asin(dr.clip(((row + k) * (2.0 / height) - 1.0) * inverse, -1.0, 1.0)) for k in (0, 1)
    )
    psi = low + (high - low) * (place.y - row)
    return m.Point2f(alpha, psi), (high - low) * (2.0 / width)


def _root(value: Any) -> Any:
    return dr.sqrt(dr.select(value > 0.0, value, 0.0))
