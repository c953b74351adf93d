"""Fourier, autocorrelation, Wigner and ambiguity transforms of polygons, in closed form.

The public names are loaded on first use, so that ``import polywigner`` and the command line's
``--help`` cost nothing.
"""

from __future__ import annotations

import importlib

# as type checkers know it: the module `typing` takes longer to import than all that is here
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from polywigner import errors as errors
    from polywigner import radar as radar
    from polywigner import rays as rays
    from polywigner import testing as testing
    from polywigner.citations import cite as cite
    from polywigner.geometry import Aperture as Aperture
    from polywigner.geometry import Polyhedron as Polyhedron
    from polywigner.geometry import Slits as Slits
    from polywigner.geometry import Wavefront as Wavefront
    from polywigner.geometry import automean as automean
    from polywigner.geometry import lag_slice as lag_slice
    from polywigner.geometry import position_slice as position_slice
    from polywigner.geometry import read_aperture as read_aperture
    from polywigner.geometry import read_polyhedron as read_polyhedron
    from polywigner.geometry import read_sheets as read_sheets
    from polywigner.geometry import shapes as shapes
    from polywigner.optics import FirstOrder as FirstOrder
    from polywigner.propagation import AxisSampling as AxisSampling
    from polywigner.propagation import BeamMetrics as BeamMetrics
    from polywigner.propagation import CutMetrics as CutMetrics
    from polywigner.propagation import PlaneWave as PlaneWave
    from polywigner.propagation import PointSource as PointSource
    from polywigner.propagation import Sampling as Sampling
    from polywigner.propagation import Screen as Screen
    from polywigner.propagation import ambiguity_table as ambiguity_table
    from polywigner.propagation import amplitude as amplitude
    from polywigner.propagation import amplitude_with_error as amplitude_with_error
    from polywigner.propagation import array_tolerance as array_tolerance
    from polywigner.propagation import beam_cuts as beam_cuts
    from polywigner.propagation import beam_metrics as beam_metrics
    from polywigner.propagation import field as field
    from polywigner.propagation import fit_pattern as fit_pattern
    from polywigner.propagation import hemisphere as hemisphere
    from polywigner.propagation import horns as horns
    from polywigner.propagation import irradiance as irradiance
    from polywigner.propagation import irradiance_with_error as irradiance_with_error
    from polywigner.propagation import line as line
    from polywigner.propagation import plane as plane
    from polywigner.propagation import psf as psf
    from polywigner.propagation import radiated_power as radiated_power
    from polywigner.propagation import radiation_pattern as radiation_pattern
    from polywigner.propagation import read_pattern as read_pattern
    from polywigner.propagation import suggest_sampling as suggest_sampling
    from polywigner.propagation import two_way_pattern as two_way_pattern
    from polywigner.propagation import volume as volume
    from polywigner.propagation import wigner_table as wigner_table
    from polywigner.propagation import write_netcdf as write_netcdf
    from polywigner.propagation import write_pattern as write_pattern
    from polywigner.quantities import SPEED_OF_LIGHT as SPEED_OF_LIGHT
    from polywigner.radiometry import EnergyBudget as EnergyBudget
    from polywigner.radiometry import energy_budget as energy_budget
    from polywigner.radiometry import flux_vector as flux_vector
    from polywigner.radiometry import power as power
    from polywigner.radiometry import radiance as radiance
    from polywigner.radiometry import radiant_intensity as radiant_intensity
    from polywigner.rays import sample_rays as sample_rays
    from polywigner.reception import coupling as coupling
    from polywigner.scattering import rcs as rcs
    from polywigner.scattering import rcs_pattern as rcs_pattern
    from polywigner.source import Array as Array
    from polywigner.source import Illumination as Illumination
    from polywigner.source import arrays as arrays
    from polywigner.source import cosine_taper as cosine_taper
    from polywigner.source import fit_illumination as fit_illumination
    from polywigner.source import phased_array as phased_array
    from polywigner.source import read_polarisation as read_polarisation
    from polywigner.source import read_source as read_source
    from polywigner.source import segmented_pupil as segmented_pupil
    from polywigner.source import steering as steering
    from polywigner.source import taylor_taper as taylor_taper
    from polywigner.source import te_mode as te_mode
    from polywigner.source import uniform as uniform
    from polywigner.source import write_source as write_source
    from polywigner.transforms import Aberration as Aberration
    from polywigner.transforms import ambiguity as ambiguity
    from polywigner.transforms import array_factor as array_factor
    from polywigner.transforms import autocorrelation as autocorrelation
    from polywigner.transforms import differentiable as differentiable
    from polywigner.transforms import explain as explain
    from polywigner.transforms import fit_zernike as fit_zernike
    from polywigner.transforms import fourier as fourier
    from polywigner.transforms import lag_marginal as lag_marginal
    from polywigner.transforms import mtf as mtf
    from polywigner.transforms import otf as otf
    from polywigner.transforms import partially_coherent_image as partially_coherent_image
    from polywigner.transforms import position_marginal as position_marginal
    from polywigner.transforms import projections as projections
    from polywigner.transforms import sample_automean as sample_automean
    from polywigner.transforms import strehl as strehl
    from polywigner.transforms import (
        transmission_cross_coefficient as transmission_cross_coefficient,
    )
    from polywigner.transforms import wavefront_error as wavefront_error
    from polywigner.transforms import wigner as wigner
    from polywigner.transforms import zernike as zernike

__version__ = "0.1.0"

_NAMES = {
    "polywigner": "errors radar rays testing",
    "polywigner.citations": "cite",
    "polywigner.geometry": """
        Aperture Polyhedron Slits Wavefront automean lag_slice position_slice read_aperture
        read_polyhedron read_sheets shapes
    """,
    "polywigner.source": """
        Array Illumination arrays cosine_taper fit_illumination phased_array
        read_polarisation read_source segmented_pupil steering taylor_taper te_mode uniform
        write_source
    """,
    "polywigner.optics": "FirstOrder",
    "polywigner.propagation": """
        AxisSampling BeamMetrics CutMetrics PlaneWave PointSource Sampling Screen
        ambiguity_table amplitude amplitude_with_error array_tolerance beam_cuts beam_metrics
        field fit_pattern hemisphere horns irradiance irradiance_with_error line plane psf
        radiated_power radiation_pattern read_pattern
        suggest_sampling two_way_pattern volume wigner_table write_netcdf
        write_pattern
    """,
    "polywigner.quantities": "SPEED_OF_LIGHT",
    "polywigner.radiometry": """
        EnergyBudget energy_budget flux_vector power radiance radiant_intensity
    """,
    "polywigner.rays": "sample_rays",
    "polywigner.reception": "coupling",
    "polywigner.scattering": "rcs rcs_pattern",
    "polywigner.transforms": """
        Aberration ambiguity array_factor autocorrelation differentiable explain fit_zernike
        fourier lag_marginal mtf otf partially_coherent_image position_marginal projections
        sample_automean strehl transmission_cross_coefficient wavefront_error wigner zernike
    """,
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        import difflib

        near = difflib.get_close_matches(name, __all__, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise AttributeError(f"module 'polywigner' has no attribute {name!r}{hint}")
    if home == __name__:  # a subpackage or module
        value: Any = importlib.import_module(f"{home}.{name}")
    else:
        value = getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
