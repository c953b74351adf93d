"""Radiometry of sources in SI units: radiance, radiant intensity, flux and power.

A source is an aperture or an array of apertures in the plane z = 0 and radiates into z > 0. In this
plane, |u|^2 is the irradiance in W/m^2. Wavelengths are in metres, and directions are unit vectors.

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
