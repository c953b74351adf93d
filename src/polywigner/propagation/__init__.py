"""Fields of sources at points in front of them: exact boundary integrals, rays, far fields.

Sources lie in the plane z = 0 and radiate to z > 0. Points are (..., 3) in metres, wavelengths in
metres; a free wave is exp(+i k R)/R (docs/conventions). Fields have the unit of the source's field.

===================  ==========================================================================
module               content
===================  ==========================================================================
``point_grids``      points, angles, grids of points and names of methods, checked
``irradiances``      |U|^2 at points: Wigner rays to a tolerance, and mixtures of waves;
                     ``partial_coherence`` and ``lag_sums`` for partially coherent light
``quadrature``       Gauss rules on triangles, and on rows of trapezoids
``amplitudes``       the complex field at points, by boundary integrals and in the far field
``boundary``         boundary integrals over panels of edges, to a tolerance
``vector_fields``    electric fields of polarised sources, near and far
``screens``          opaque plates and openings in front of point sources and plane waves
``shadows``          fields behind opaque bodies, by ``equivalent_points`` of the source
``collins``          fields behind first-order systems; point spread functions
``curved_fields``    fields of curved waves, as sums over cells of the source
``far_fields``       far fields as functions of direction, their power, and the search for the beam
``patterns``         radiation patterns, great circles through the beam, and the cuts of both
``pattern_files``    radiation patterns read and written; ``far_field_tables`` of simulators
``array_patterns``   arrays with errors, and radars of two arrays
``element_patterns`` far fields from tables: interpolation, and fits by apertures
``beams``            numbers of data sheets: gain, beamwidths, sidelobes
``datasets``         lines, planes, hemispheres, volumes: in memory, lazy, or stored
``phase_space_tables`` W and A over a grid of their four coordinates
``stores``           datasets on disk: zarr stores written by chunks, NetCDF files
``suggestions``      how many samples a grid needs
===================  ==========================================================================
"""

from __future__ import annotations

from polywigner.propagation import horns
from polywigner.propagation.amplitudes import amplitude, amplitude_with_error
from polywigner.propagation.array_patterns import array_tolerance, two_way_pattern
from polywigner.propagation.beams import BeamMetrics, CutMetrics, beam_metrics
from polywigner.propagation.datasets import hemisphere, line, plane, volume
from polywigner.propagation.element_patterns import FittedPattern, fit_pattern
from polywigner.propagation.far_fields import radiated_power
from polywigner.propagation.irradiances import irradiance, irradiance_with_error
from polywigner.propagation.pattern_files import read_pattern, write_pattern
from polywigner.propagation.patterns import beam_cuts, radiation_pattern
from polywigner.propagation.phase_space_tables import ambiguity_table, wigner_table
from polywigner.propagation.point_grids import METHODS
from polywigner.propagation.point_spread import psf
from polywigner.propagation.screens import PlaneWave, PointSource, Screen
from polywigner.propagation.stores import write_netcdf
from polywigner.propagation.suggestions import AxisSampling, Sampling, suggest_sampling
from polywigner.propagation.vector_fields import field

__all__ = [
    "METHODS",
    "AxisSampling",
    "BeamMetrics",
    "CutMetrics",
    "FittedPattern",
    "PlaneWave",
    "PointSource",
    "Sampling",
    "Screen",
    "ambiguity_table",
    "amplitude",
    "amplitude_with_error",
    "array_tolerance",
    "beam_cuts",
    "beam_metrics",
    "field",
    "fit_pattern",
    "hemisphere",
    "horns",
    "irradiance",
    "irradiance_with_error",
    "line",
    "plane",
    "psf",
    "radiated_power",
    "radiation_pattern",
    "read_pattern",
    "suggest_sampling",
    "two_way_pattern",
    "volume",
    "wigner_table",
    "write_netcdf",
    "write_pattern",
]
