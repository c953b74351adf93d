"""Fields from rasters by FFT convolution with the Rayleigh-Sommerfeld kernel, with NumPy or
diffractio.

Pixels at the edges are weighted by their open fraction.
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import shapely

import polywigner as pw

__all__ = ["NumpyRaster", "PeerRaster", "Raster", "available"]


def available() -> bool:
    return find_spec("diffractio") is not None


class Raster:
    """A window of pixels around source and plane; a call computes the plane."""

    def __init__(
        self, aperture: pw.Aperture, wavelength: float, height: float, half: float, pitch: float
    ) -> None:
        self.wavelength, self.height, self.pitch = wavelength, height, pitch
        count = 2 * int(np.ceil(half / pitch - 1e-9))
        self.x = (np.arange(count) - (count - 1) / 2) * pitch
        self.open = _coverage(aperture, self.x, pitch)

    def __call__(self) -> np.ndarray:
        raise NotImplementedError


class NumpyRaster(Raster):
    """Two FFTs of twice the width, including the transform of the kernel."""

    def __call__(self) -> np.ndarray:
        count = len(self.x)
        lag = self.pitch * (np.arange(2 * count) - count)
        r2 = lag[:, None] ** 2 + lag**2 + self.height**2
        r, k = np.sqrt(r2), 2 * np.pi / self.wavelength
        kernel = self.height / (2 * np.pi * r2) * (1 / r - 1j * k) * np.exp(1j * k * r)
        padded = np.fft.fft2(self.open, s=(2 * count, 2 * count))
        field = np.fft.ifft2(padded * np.fft.fft2(np.fft.ifftshift(kernel)))
        return np.asarray(field[:count, :count] * self.pitch**2)


class PeerRaster(Raster):
    """The raster of diffractio."""

    def __init__(
        self, aperture: pw.Aperture, wavelength: float, height: float, half: float, pitch: float
    ) -> None:
        from diffractio.scalar_fields_XY import Scalar_field_XY

        super().__init__(aperture, wavelength, height, half, pitch)
        self.field = Scalar_field_XY(x=self.x, y=self.x, wavelength=wavelength)
        self.field.u = self.open.astype(complex)

    def __call__(self) -> np.ndarray:
        return np.asarray(self.field.RS(self.height, amplification=(1, 1), matrix=True))


def _coverage(aperture: pw.Aperture, x: np.ndarray, pitch: float) -> np.ndarray:
    """Return the open fraction of every pixel."""
    low, high = x - pitch / 2, x + pitch / 2
    share = np.zeros((len(x), len(x)))
    near = np.flatnonzero(np.abs(x) < max(abs(v) for v in aperture.bounds) + pitch)
    i, j = np.meshgrid(near, near, indexing="ij")
    boxes = shapely.box(low[j], low[i], high[j], high[i])
    shapely.prepare(aperture.polygons)
    share[i, j] = shapely.area(shapely.intersection(boxes, aperture.polygons)) / pitch**2
    return share
