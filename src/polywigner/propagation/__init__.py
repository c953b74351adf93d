"""Fields and radiation patterns of sources: boundary integrals, Wigner rays and far fields.

Sources lie in the plane z = 0 and radiate to z > 0. Positions and wavelengths are in metres. A
spherical wave is exp(+i k R)/R (docs/conventions). Fields have the unit of the source's field.

======================  ========================================================================
module                  content
======================  ========================================================================
``point_grids``         checked points, angles and method names; grids of points
``irradiances``         |U|^2 at points, also for partially coherent or broadband light
``wigner_rays``         irradiance by Wigner rays, to a tolerance
``partial_coherence``   irradiance of partially coherent light
``lag_sums``            irradiance of light with a coherence width much smaller than the source
``amplitudes``          the complex field at points, by boundary integrals and in the far field
``boundary``            boundary integrals over panels of edges, to a tolerance
``vector_fields``       electric near and far fields of polarised sources
``screens``             opaque plates and openings in front of point sources and plane waves
``shadows``             fields behind opaque bodies
``equivalent_points``   point sources that replace a source behind bodies
``source_nodes``        a few nodes that replace these points
``edge_sums``           fields behind bodies, as sums over near and far edges
``collins``             fields behind first-order systems; point spread functions
``curved_fields``       fields of curved waves, as sums over cells of the source
``far_fields``          far fields as functions of direction, radiated power, beam and steering
``patterns``            radiation patterns, great circles through the beam, and cuts
``pattern_files``       readers and writers of radiation patterns
``far_field_tables``    readers of far-field files of simulators
``array_patterns``      patterns of arrays with errors; two-way patterns of radars
``element_patterns``    far fields from tables: interpolation, and fits by aperture fields
``horns``               horn apertures, and their textbook directivity
``beams``               data-sheet numbers: gain, beamwidths, sidelobes
``datasets``            fields on lines, planes, hemispheres and in volumes, W and A on grids of
                        four coordinates: in memory, lazy, or stored
``stores``              datasets on disk: zarr stores written by chunks, NetCDF files
``suggestions``         numbers of samples that a grid requires
======================  ========================================================================
"""

from __future__ import annotations

from polywigner.propagation import horns
from polywigner.propagation.amplitudes import amplitude, amplitude_with_error
from polywigner.propagation.array_patterns import array_tolerance, two_way_pattern
from polywigner.propagation.beams import BeamMetrics, CutMetrics, beam_metrics
from polywigner.propagation.datasets import (
    ambiguity_table,
    hemisphere,
    line,
    plane,
    volume,
    wigner_table,
)
from polywigner.propagation.element_patterns import FittedPattern, fit_pattern
from polywigner.propagation.far_fields import radiated_power
from polywigner.propagation.irradiances import irradiance, irradiance_with_error
from polywigner.propagation.pattern_files import read_pattern, write_pattern
from polywigner.propagation.patterns import beam_cuts, radiation_pattern
from polywigner.propagation.point_grids import METHODS
from polywigner.propagation.pupil_fields import psf
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
