"""Radiometry of sources, in watts: radiance, radiant intensity, flux and power.

Sources are apertures, and arrays of them, in the plane z = 0, with |u|^2 the irradiance on them in
W/m^2; they radiate to z > 0. Wavelengths are in metres, directions unit vectors (..., 3).

===================  ==========================================================================
module               content
===================  ==========================================================================
``directions``       checked sources and directions; integrals over directions, exact to rounding
``flux``             radiance, radiant intensity, flux, power and evanescent power in SI units
===================  ==========================================================================
"""

from polywigner.radiometry.flux import (
    EnergyBudget,
    energy_budget,
    flux_vector,
    power,
    radiance,
    radiant_intensity,
)

__all__ = [
    "EnergyBudget",
    "energy_budget",
    "flux_vector",
    "power",
    "radiance",
    "radiant_intensity",
]
