"""Fields, frequencies and spherical waves of sources, for sums over places on them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture, Wavefront
from polywigner.transforms.wavefronts import flat_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def field_at(element: Aperture, x: Floats) -> Any:
    field: Any = element.illumination
    return 1.0 if field is None else field(x)


def waves_of(element: Aperture) -> Any:
    field: Any = element.illumination
    if field is None:
        return [(1.0, np.zeros(2))]
    return list(zip(field.amplitudes.tolist(), field.frequencies, strict=True))


def largest_rates(source: Wavefront, points: Floats, wavelength: float) -> Floats:
    """Most cycles per metre along x and y of the field on the source times the waves, (n, 2)."""
    low, high = np.reshape(source.bounds, (2, 2))
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    away = corners - points[:, None, :2]
    # across each axis the source is nearest, where the slope along the axis is largest
    beside = np.maximum(np.maximum(low - points[:, :2], points[:, :2] - high), 0.0)[:, ::-1]
    distance = np.sqrt(away**2 + (beside**2 + points[:, 2:] ** 2)[:, None])
    slopes = away / (wavelength * distance) + (corners - source.centre) @ source.curvature
    fields = [element.illumination for element in flat_of(source).elements_in_plane]
    waves = [abs(field.frequencies).max(axis=0) for field in fields if field is not None]
    return np.asarray(abs(slopes).max(axis=1) + np.max([np.zeros(2), *waves], axis=0))


def highest(source: Wavefront) -> float:
    """Highest frequency of the waves on a source in 1/m."""
    fields = [element.illumination for element in flat_of(source).elements_in_plane]
    waves = [field.frequencies for field in fields if field is not None]
    return max((float(np.linalg.norm(w, axis=1).max()) for w in waves), default=0.0)


def slope(z: Floats, radius: Floats, k: float) -> Complex:
    """Derivative along the normal of a spherical wave, over the wave times -ik."""
    return np.asarray((z / radius) * (1 + 1j / (k * radius)))
