"""Flux and power: radiance integrated over all directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.execution import Engine
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import checked_wavelength, takes_frequency
from polywigner.radiometry.directional import radiance, radiant_intensity
from polywigner.radiometry.directions import PlaneSource, checked_positions, checked_radiator
from polywigner.radiometry.hemisphere import directions_and_weights, largest_lag
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.xarray_arguments import takes_xarray

__all__ = ["EnergyBudget", "energy_budget", "flux_vector", "power"]

# Values of the radiance at a time: 32 MB.
_BLOCK = 1 << 22


@takes_frequency
@takes_xarray(
    "x", units="W m-2", long_name="flux vector J(x)", components={"flux_component": "xyz"}
)
def flux_vector(
    source: PlaneSource | Wavefront, x: ArrayLike, wavelength: float, *, engine: Engine = "auto"
) -> NDArray[np.float64]:
    """Flux vector J(x) = int L(x, s) s dOmega over the directions of z > 0.

    J_z is what leaves the plane per area, the part of |u|^2 that |nu| < 1/lambda carries
    (docs/radiometry.md, (E3)); it is negative in places, and not zero beside the source. Along the
    plane J is zero for fields that are real up to a constant phase. Differs from the paper, which
    leaves out the z component of the direction.

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, |u|^2 on it in W/m^2; or one with a
        curved or partly coherent wave.
    x : (..., 2) positions in m.
    wavelength : in m.
    engine : see :func:`fourier`.

    Returns
    -------
    (..., 3) in W/m^2. Accurate to 1e-12 int |u|^2/lambda^2. Cost: W in some
    15 (diameter/wavelength)^2 + 1000 directions for each position; memory is bounded. A terminal
    shows a bar where that takes more than seconds.
    An ``xarray.DataArray`` gives one, as in :func:`fourier`, J along ``flux_component``.

    Raises
    ------
    As :func:`radiance` does.

    >>> import polywigner as pw
    >>> round(float(pw.flux_vector(pw.shapes.square(10e-3), (0, 0), 3.2e-3)[2]), 2)  # W/m^2
    0.95
    """
    radiator = checked_radiator(source, partly=True)
    length = checked_wavelength(wavelength)
    positions = checked_positions(x)
    places = positions.reshape(-1, 1, 2)
    total = np.zeros((len(places), 3))
    for directions, solid_angle in directions_and_weights(
        largest_lag(radiator), length, len(places)
    ):
        weighted = directions * solid_angle[:, None]
        size = max(1, _BLOCK // len(directions))
        for first in range(0, len(places), size):
            part = slice(first, first + size)
            total[part] += radiance(radiator, places[part], directions, length, engine=engine) @ (
                weighted
            )
    return total.reshape(*positions.shape[:-1], 3)


@takes_frequency
def power(source: PlaneSource | Wavefront, wavelength: float, *, engine: Engine = "auto") -> float:
    """Power that a source radiates through a far hemisphere, int |F|^2 d nu over |nu| < 1/lambda.

    The integral of :func:`radiant_intensity`; less than int |u|^2 dx by what is evanescent
    (docs/radiometry.md, (E4)).

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, |u|^2 on it in W/m^2; or one with a
        curved or partly coherent wave.
    wavelength : in m.
    engine : see :func:`fourier`.

    Returns
    -------
    In W. Accurate to 1e-12 of int |u|^2. Cost: F in some 15 (diameter/wavelength)^2 + 1000
    directions; a terminal shows a bar where that takes more than seconds.

    Raises
    ------
    As :func:`radiance` does.

    >>> import polywigner as pw
    >>> round(pw.power(pw.shapes.square(10e-3), frequency=94e9) * 1e6, 2)  # uW
    93.38
    """
    radiator = checked_radiator(source, partly=True)
    length = checked_wavelength(wavelength)
    blocks = directions_and_weights(largest_lag(radiator), length)
    return float(sum(w @ radiant_intensity(radiator, s, length, engine=engine) for s, w in blocks))


@dataclass(frozen=True)
class EnergyBudget:
    """The shares of int |u|^2 of a source, in W.

    >>> import polywigner as pw
    >>> budget = pw.energy_budget(pw.shapes.square(10e-3), 3.2e-3)
    >>> round(budget.evanescent_share, 4)
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
    def propagating_share(self) -> float:
        """Propagating part over the total; NaN for a source whose elements cancel each other."""
        return self.propagating / self.total if self.total > 0 else float("nan")

    @property
    def evanescent_share(self) -> float:
        """Evanescent part over the total; NaN for a source whose elements cancel each other."""
        return self.evanescent / self.total if self.total > 0 else float("nan")


@takes_frequency
def energy_budget(
    source: PlaneSource | Wavefront, wavelength: float, *, engine: Engine = "auto"
) -> EnergyBudget:
    """The power of a source, radiated and evanescent (docs/radiometry.md, (E4)).

    Parameters
    ----------
    source : Aperture or Array of apertures in the plane z = 0, |u|^2 on it in W/m^2; or one with a
        curved or partly coherent wave.
    wavelength : in m.
    engine : see :func:`fourier`.

    Returns
    -------
    :class:`EnergyBudget`, in W; accurate to 1e-12 of the total. Cost as of :func:`power`.

    Raises
    ------
    As :func:`radiance` does.

    >>> import polywigner as pw
    >>> budget = pw.energy_budget(pw.shapes.square(10e-3), 3.2e-3)
    >>> round(budget.propagating / budget.total, 4)
    0.9337
    """
    radiator = checked_radiator(source, partly=True)
    return EnergyBudget(energy_of(radiator), power(radiator, wavelength, engine=engine))
