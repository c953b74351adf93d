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
from polywigner.radiometry.directions import (
    PlaneSource,
    checked_bandwidth,
    checked_directions,
    checked_positions,
    checked_radiator,
    directions_and_weights,
    largest_lag,
    longest_path,
    power_by_lags,
    wavelengths_of_band,
)
from polywigner.transforms import fourier, wigner
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.wavefronts import mean_over_tilts
from polywigner.transforms.xarray_arguments import takes_xarray

# Error of the mean over a band, relative to the largest intensity.
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
    """Compute the radiance L(x, s) = W(x, s_par/lambda)/lambda^2 at positions, into directions.

    The radiance can be negative, as W: only integrals over position or direction are measurable.
    Integrated over both, with the projected solid angle, it gives the power (docs/radiometry.md,
    (E1)). In the paper's W/(4 pi A lambda^2) the 4 pi is spurious, and A makes it a mean over the
    aperture (docs/corrections.md).

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, |u|^2 on it in W/m^2; or one with a
        curved or partly coherent wave.
    x : (..., 2) positions in m, outside of the source too: in its automean.
    direction : (..., 3) unit vectors with z >= 0; broadcasts against ``x``.
    wavelength : in m.
    normalisation : "si"; or "paper", without the power |u|^2 A of the source: per m^4 and sr, A
        the area of the aperture, or of the union of an array's elements.
    precision, engine : see :func:`fourier`.

    Returns
    -------
    (...) real, in W/(m^2 sr). Accurate to 1e-12 (single precision: 5e-6) int |u|^2/lambda^2.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for an Array whose
    elements do not lie in the plane z = 0; EngineError without the engine.

    >>> import polywigner as pw
    >>> round(float(pw.radiance(pw.shapes.square(10e-3), (0, 0), (0, 0, 1), 3.2e-3)), 3)  # W/m^2/sr
    39.063
    """
    radiator = checked_radiator(source, partly=True)
    length = checked_wavelength(wavelength)
    nu = checked_directions(direction)[..., :2] / length
    result = wigner(radiator, checked_positions(x), nu, precision=precision, engine=engine)
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
    """Compute the radiant intensity cos(theta) |F(s_par/lambda)|^2/lambda^2 into directions.

    Its integral over the hemisphere is :func:`power` (docs/radiometry.md, (E2)).

    Parameters
    ----------
    source, wavelength, precision, engine : as of :func:`radiance`.
    direction : (..., 3) unit vectors with z >= 0.
    bandwidth : in Hz; the mean over light of all frequencies that are at most half of it from that
        of the wavelength (docs/coherence.md, (PC6)). None: light of the one wavelength.

    Returns
    -------
    (...) real, not negative, in W/sr.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`.

    Raises as :func:`radiance` does.

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
        # each call takes the phases of path lengths at its own wavelength
        total = sum(w * radiant_intensity(radiator, directions, one, **how) for one, w in parts)
        return np.asarray(total)[()]

    def per_frequency(source: PlaneSource | Wavefront, nu: NDArray[np.float64]) -> Any:
        """|F|^2/lambda^2."""
        return np.square(np.abs(fourier(source, nu, precision=precision, engine=engine)) / length)

    nu = directions[..., :2] / length
    if isinstance(radiator, Wavefront) and not radiator.is_coherent:
        double = checked_precision(precision) != "single"
        of_coherent: Any = partial(per_frequency, radiator.coherent)
        result = mean_over_tilts(of_coherent, radiator, nu, double=double)
    else:
        result = per_frequency(radiator, nu)
    return (directions[..., 2] * result).astype(result.dtype, copy=False)[()]


# Values of the radiance per block: 32 MB.
_BLOCK = 1 << 22


@takes_frequency
@takes_xarray(
    "x", units="W m-2", long_name="flux vector J(x)", components={"flux_component": "xyz"}
)
def flux_vector(
    source: PlaneSource | Wavefront, x: ArrayLike, wavelength: float, *, engine: Engine = "auto"
) -> NDArray[np.float64]:
    """Compute the flux vector J(x) = int L(x, s) s dOmega over the directions of z > 0.

    J_z is the radiated power per area, the part of |u|^2 with |nu| < 1/lambda (docs/radiometry.md,
    (E3)). It can be negative, and is not zero outside of the source. The components along the plane
    are zero for fields that are real up to a constant phase. The paper leaves out the z component
    of the direction.

    Parameters
    ----------
    source, wavelength, engine : as of :func:`radiance`.
    x : (..., 2) positions in m.

    Returns
    -------
    (..., 3) in W/m^2. Accurate to 1e-12 int |u|^2/lambda^2. Cost: W in some
    15 (diameter/wavelength)^2 + 1000 directions for each position; memory is bounded. A terminal
    shows a bar where that takes more than seconds.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`, J along ``flux_component``.

    Raises as :func:`radiance` does.

    >>> import polywigner as pw
    >>> round(float(pw.flux_vector(pw.shapes.square(10e-3), (0, 0), 3.2e-3)[2]), 2)  # W/m^2
    0.95
    """
    radiator = checked_radiator(source, partly=True)
    length = checked_wavelength(wavelength)
    positions = checked_positions(x)
    rows = positions.reshape(-1, 1, 2)
    total = np.zeros((len(rows), 3))
    for directions, solid_angle in directions_and_weights(largest_lag(radiator), length, len(rows)):
        weighted = directions * solid_angle[:, None]
        size = max(1, _BLOCK // len(directions))
        for first in range(0, len(rows), size):
            some = slice(first, first + size)
            result = radiance(radiator, rows[some], directions, length, engine=engine)
            total[some] += result @ weighted
    return total.reshape(*positions.shape[:-1], 3)


@takes_frequency
def power(source: PlaneSource | Wavefront, wavelength: float, *, engine: Engine = "auto") -> float:
    """Compute the power through a far hemisphere, int |F|^2 d nu over |nu| < 1/lambda.

    It is the integral of :func:`radiant_intensity`, and int |u|^2 dx less its evanescent part
    (docs/radiometry.md, (E4)).

    Parameters
    ----------
    source, wavelength, engine : as of :func:`radiance`.

    Returns
    -------
    In W. Accurate to 1e-12 of int |u|^2. Cost: F in some 15 (diameter/wavelength)^2 + 1000
    directions. Beyond 600 wavelengths by lags (docs/radiometry.md, (E5)), accurate to 1e-8 and done
    within a second, where small parts, many elements or steep waves do not forbid it; a terminal
    shows a bar where it takes more than seconds.

    Raises as :func:`radiance` does.

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
    """Propagating and evanescent parts of int |u|^2 of a source, in W.

    >>> import polywigner as pw
    >>> budget = pw.energy_budget(pw.shapes.square(10e-3), 3.2e-3)
    >>> round(budget.evanescent_fraction, 4)
    0.0663
    """

    total: float
    """int |u|^2 dx = int |F|^2 d nu."""
    propagating: float
    """The part at |nu| < 1/lambda, which reaches the far hemisphere."""

    @property
    def evanescent(self) -> float:
        """The part at |nu| > 1/lambda, which stays at the aperture, in W."""
        return self.total - self.propagating

    @property
    def propagating_fraction(self) -> float:
        """Propagating part over the total; NaN for a source whose elements cancel each other."""
        return self.propagating / self.total if self.total > 0 else float("nan")

    @property
    def evanescent_fraction(self) -> float:
        """Evanescent part over the total; NaN for a source whose elements cancel each other."""
        return self.evanescent / self.total if self.total > 0 else float("nan")


@takes_frequency
def energy_budget(
    source: PlaneSource | Wavefront, wavelength: float, *, engine: Engine = "auto"
) -> EnergyBudget:
    """Compute the radiated and the evanescent power of a source (docs/radiometry.md, (E4)).

    Parameters
    ----------
    source, wavelength, engine : as of :func:`radiance`.

    Returns
    -------
    :class:`EnergyBudget`, in W; accurate to 1e-12 of the total. Cost as of :func:`power`.

    Raises as :func:`radiance` does.

    >>> import polywigner as pw
    >>> budget = pw.energy_budget(pw.shapes.square(10e-3), 3.2e-3)
    >>> round(budget.propagating / budget.total, 4)
    0.9337
    """
    radiator = checked_radiator(source, partly=True)
    return EnergyBudget(energy_of(radiator), power(radiator, wavelength, engine=engine))
