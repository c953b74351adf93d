"""Radiometry of sources in SI units: radiance, radiant intensity, flux and power.

Sources are apertures or arrays of apertures in the plane z = 0, where |u|^2 is the irradiance in
W/m^2. They radiate to z > 0. Wavelengths are in metres, and directions are unit vectors.

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
