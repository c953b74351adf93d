"""Radiometry of sources, in watts: radiance, radiant intensity, flux and power.

Sources are apertures or arrays of apertures in the plane z = 0, with |u|^2 the irradiance in W/m^2.
They radiate to z > 0. Wavelengths are in metres, and directions are unit vectors (..., 3).

===================  ==========================================================================
module               content
===================  ==========================================================================
``directions``       checks of sources and directions; integrals over directions
``flux``             radiance, radiant intensity, flux, power and evanescent power
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

__all__ = ["EnergyBudget", "energy_budget", "flux_vector", "power", "radiance", "radiant_intensity"]
