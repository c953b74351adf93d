"""Radiance, radiant intensity, flux and power of sources in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.execution import Engine, Precision, checked_precision
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import checked_wavelength, takes_frequency
from polywigner.numerics import index_blocks
from polywigner.radiometry.directions import (
    PlaneSource,
    checked_bandwidth,
    checked_directions,
    checked_plane_positions,
    checked_radiator,
    directions_and_weights,
    largest_lag,
    longest_path,
    power_by_lags,
    wavelengths_of_band,
)
from polywigner.transforms import fourier, wigner
from polywigner.transforms.public_transforms import energy_of
from polywigner.transforms.wavefronts import mean_over_tilts
from polywigner.transforms.xarray_arguments import takes_xarray

# Allowed relative error of the mean radiant intensity over a band.
_BAND_ERROR = 1e-12


@takes_frequency
@takes_xarray("x", "direction", units="W m-2 sr-1", long_name="radiance L(x, s)")
def radiance(
    source: PlaneSource | Wavefront,
    x: ArrayLike,
    direction: ArrayLike,
    wavelength: float,
    *,
    precision: Precision = None,
    engine: Engine = "auto",
) -> NDArray[np.float64]:
    """Return the radiance of a source at positions x in directions s.

    The radiance is ``L(x, s) = W(x, s_par/wavelength)/wavelength^2``, where W is the Wigner
    function and s_par contains the first two components of s. The integral of the radiance over
    positions and projected solid angle is the power (docs/radiometry.md, (E1)). Like W, the
    radiance can be negative: only integrals over position or direction are measurable. The paper
    defines the radiance as W/(4 pi A lambda^2). The factor 4 pi is an error, and the division by
    the area A gives a mean over the aperture (docs/corrections.md).

    Parameters
    ----------
    source : Aperture, Array or Wavefront
        Source in the plane z = 0 with |u|^2 in W/m^2. A Wavefront may be curved or partially
        coherent.
    x : array_like, shape (..., 2)
        Positions in m. Positions may lie outside the source, since W extends over the automean of
        the source.
    direction : array_like, shape (..., 3)
        Unit vectors with z >= 0; they broadcast against ``x``.
    wavelength : float
        Wavelength in m, or ``frequency=`` in Hz.
    precision, engine : str, optional
        See :func:`fourier`.

    Returns
    -------
    ndarray of float, shape (...)
        Radiance in W/(m^2 sr). The error is at most 1e-12 int |u|^2/wavelength^2, or
        5e-6 int |u|^2/wavelength^2 in single precision, where the integral extends over the source.
        DataArrays give a DataArray, as in :func:`fourier`.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range.
    GeometryError
        If an Array has elements outside the plane z = 0.
    EngineError
        If the engine is not available.

    Examples
    --------
    >>> import polywigner as pw
    >>> round(float(pw.radiance(pw.shapes.square(10e-3), (0, 0), (0, 0, 1), 3.2e-3)), 3)  # W/m^2/sr
    39.063
    """
    radiator = checked_radiator(source, partly=True)
    length = checked_wavelength(wavelength)
    nu = checked_directions(direction)[..., :2] / length
    result = wigner(radiator, checked_plane_positions(x), nu, precision=precision, engine=engine)
    return result / result.dtype.type(length**2)


@takes_frequency
@takes_xarray("direction", units="W sr-1", long_name="radiant intensity")
def radiant_intensity(
    source: PlaneSource | Wavefront,
    direction: ArrayLike,
    wavelength: float,
    *,
    bandwidth: float | None = None,
    precision: Precision = None,
    engine: Engine = "auto",
) -> NDArray[np.float64]:
    """Return the radiant intensity of a source in directions s.

    The radiant intensity is ``cos(theta) |F(s_par/wavelength)|^2/wavelength^2``, where F is the
    Fourier transform of the field, and s_par contains the first two components of s. The integral
    of the radiant intensity over the hemisphere is :func:`power` (docs/radiometry.md, (E2)).

    Parameters
    ----------
    source, wavelength, precision, engine
        As in :func:`radiance`.
    direction : array_like, shape (..., 3)
        Unit vectors with z >= 0.
    bandwidth : float, optional
        Bandwidth in Hz. The result is the mean over all frequencies that differ from the frequency
        of the wavelength by at most half of the bandwidth (docs/coherence.md, (PC6)). By default
        the source has one wavelength.

    Returns
    -------
    ndarray of float, shape (...)
        Radiant intensity in W/sr, zero or more. A DataArray gives a DataArray, as in
        :func:`fourier`.

    Raises
    ------
    ArgumentError, GeometryError, EngineError
        As :func:`radiance`.

    Examples
    --------
    >>> import polywigner as pw
    >>> round(float(pw.radiant_intensity(pw.shapes.square(10e-3), (0, 0, 1), 3.2e-3)), 6)  # W/sr
    0.000977
    """
    radiator = checked_radiator(source, partly=True)
    length = checked_wavelength(wavelength)
    directions = checked_directions(direction)
    if bandwidth is not None:
        band = checked_bandwidth(bandwidth, length)
        parts = wavelengths_of_band(length, band, longest_path(radiator), _BAND_ERROR)
        how: dict[str, Any] = {"precision": precision, "engine": engine}
        # Each wavelength is a separate call, because phases due to path lengths depend on
        # wavelength.
        total = sum(w * radiant_intensity(radiator, directions, node, **how) for node, w in parts)
        return np.asarray(total)[()]

    def squared_spectrum(source: PlaneSource | Wavefront, nu: NDArray[np.float64]) -> Any:
        """Return |F|^2/wavelength^2 at spatial frequencies."""
        return np.square(np.abs(fourier(source, nu, precision=precision, engine=engine)) / length)

    nu = directions[..., :2] / length
    if isinstance(radiator, Wavefront) and not radiator.is_coherent:
        double = checked_precision(precision) != "single"
        of_coherent: Any = partial(squared_spectrum, radiator.coherent)
        squares = mean_over_tilts(of_coherent, radiator, nu, double=double)
    else:
        squares = squared_spectrum(radiator, nu)
    return (directions[..., 2] * squares).astype(squares.dtype, copy=False)[()]


# Number of radiance values per block, which take 32 MB.
_BLOCK = 1 << 22


@takes_frequency
@takes_xarray(
    "x", units="W m-2", long_name="flux vector J(x)", components={"flux_component": "xyz"}
)
def flux_vector(
    source: PlaneSource | Wavefront, x: ArrayLike, wavelength: float, *, engine: Engine = "auto"
) -> NDArray[np.float64]:
    """Return the flux vector of a source at positions x.

    The flux vector is ``J(x) = int L(x, s) s dOmega`` over the directions s with z > 0, where L is
    the :func:`radiance`. J_z is the radiated power per area, to which only waves with |nu| <
    1/wavelength contribute (docs/radiometry.md, (E3)). J_z can be negative, and is not zero outside
    the source. The components of J along the plane are zero for fields that are real up to a
    constant phase. The formula in the paper lacks the z component of the direction.

    Parameters
    ----------
    source, wavelength, engine
        As in :func:`radiance`.
    x : array_like, shape (..., 2)
        Positions in m.

    Returns
    -------
    ndarray of float, shape (..., 3)
        Flux vector in W/m^2. The error is at most 1e-12 int |u|^2/wavelength^2, where the integral
        extends over the source. A DataArray gives a DataArray, as in :func:`fourier`, with the
        components along ``flux_component``.

    Raises
    ------
    ArgumentError, GeometryError, EngineError
        As :func:`radiance`.

    Notes
    -----
    The function computes the Wigner function in about 15 (diameter/wavelength)^2 + 1000 directions
    for each position, in blocks of limited memory. Terminals show a progress bar for computations
    that take several seconds.

    Examples
    --------
    >>> import polywigner as pw
    >>> round(float(pw.flux_vector(pw.shapes.square(10e-3), (0, 0), 3.2e-3)[2]), 2)  # W/m^2
    0.95
    """
    radiator = checked_radiator(source, partly=True)
    length = checked_wavelength(wavelength)
    positions = checked_plane_positions(x)
    rows = positions.reshape(-1, 1, 2)
    total = np.zeros((len(rows), 3))
    for directions, solid_angle in directions_and_weights(largest_lag(radiator), length):
        weighted = directions * solid_angle[:, None]
        for block in index_blocks(len(rows), _BLOCK // len(directions)):
            values = radiance(radiator, rows[block], directions, length, engine=engine)
            total[block] += values @ weighted
    return total.reshape(*positions.shape[:-1], 3)


@takes_frequency
def power(source: PlaneSource | Wavefront, wavelength: float, *, engine: Engine = "auto") -> float:
    """Return the power that a source radiates through a distant hemisphere.

    The power is the integral of :func:`radiant_intensity` over the hemisphere. The power equals the
    integral of |u|^2 over the source minus the evanescent part of this integral
    (docs/radiometry.md, (E4)).

    Parameters
    ----------
    source, wavelength, engine
        As in :func:`radiance`.

    Returns
    -------
    float
        Power in W, accurate to 1e-12 of the integral of |u|^2 over the source.

    Raises
    ------
    ArgumentError, GeometryError, EngineError
        As :func:`radiance`.

    Notes
    -----
    The function computes the Fourier transform in about 15 (diameter/wavelength)^2 + 1000
    directions. For sources wider than 600 wavelengths the power is an integral over lags
    (docs/radiometry.md, (E5)). This integral takes less than a second and is accurate to 1e-8,
    unless the source has small parts, many elements or strongly inclined waves. Terminals show a
    progress bar for computations that take several seconds.

    Examples
    --------
    >>> import polywigner as pw
    >>> round(pw.power(pw.shapes.square(10e-3), frequency=94e9) * 1e6, 2)  # uW
    93.38
    """
    radiator = checked_radiator(source, partly=True)
    length = checked_wavelength(wavelength)
    wide = power_by_lags(radiator, length, "paper")
    if wide is not None:
        return wide
    blocks = directions_and_weights(largest_lag(radiator), length)
    return float(sum(w @ radiant_intensity(radiator, s, length, engine=engine) for s, w in blocks))


@dataclass(frozen=True)
class EnergyBudget:
    """Propagating and evanescent parts of the power on a source, in W.

    Examples
    --------
    >>> import polywigner as pw
    >>> budget = pw.energy_budget(pw.shapes.square(10e-3), 3.2e-3)
    >>> round(budget.evanescent_fraction, 4)
    0.0663
    """

    total: float
    """Integral of |u|^2 over the source, or of |F|^2 over all spatial frequencies."""
    propagating: float
    """Part of ``total`` at |nu| < 1/wavelength, which reaches a distant hemisphere."""

    @property
    def evanescent(self) -> float:
        """Evanescent part of ``total``, with |nu| > 1/wavelength, which stays near the aperture."""
        return self.total - self.propagating

    @property
    def propagating_fraction(self) -> float:
        """Propagating fraction of the total; NaN for a source whose elements cancel each other."""
        return self.propagating / self.total if self.total > 0 else float("nan")

    @property
    def evanescent_fraction(self) -> float:
        """Evanescent fraction of the total; NaN for a source whose elements cancel each other."""
        return self.evanescent / self.total if self.total > 0 else float("nan")


@takes_frequency
def energy_budget(
    source: PlaneSource | Wavefront, wavelength: float, *, engine: Engine = "auto"
) -> EnergyBudget:
    """Return the radiated and the evanescent power of a source (docs/radiometry.md, (E4)).

    The function takes as long as :func:`power`.

    Parameters
    ----------
    source, wavelength, engine
        As in :func:`radiance`.

    Returns
    -------
    EnergyBudget
        Powers in W, accurate to 1e-12 of the total.

    Raises
    ------
    ArgumentError, GeometryError, EngineError
        As :func:`radiance`.

    Examples
    --------
    >>> import polywigner as pw
    >>> budget = pw.energy_budget(pw.shapes.square(10e-3), 3.2e-3)
    >>> round(budget.propagating / budget.total, 4)
    0.9337
    """
    radiator = checked_radiator(source, partly=True)
    return EnergyBudget(energy_of(radiator), power(radiator, wavelength, engine=engine))
