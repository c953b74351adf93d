"""The field of a source at points in front of it: exact boundary integrals, rays, far fields.

Sources lie in the plane z = 0 and radiate to z > 0. Points are (..., 3) in metres, wavelengths in
metres; a free wave is exp(+i k R)/R (docs/conventions). Fields are in the unit of the source's.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``places``           checked points, wavelengths and names of methods
``irradiances``      |U|^2 at points
``rays``             sums of Wigner rays; ``ray_kernels`` what is summed
``arrangement``      where the Wigner function is smooth; ``rays_rules`` Gauss rules there
``rays_adaptive``    rules refined to a tolerance; ``rays_sampling`` drawn places instead
``amplitudes``       the complex field at points, by boundary integrals and in the far field
``boundary``         sums along edges to a tolerance; ``panels`` pieces of edges with their waves
``screens``          opaque plates and openings lit by point sources and plane waves
``behind``           fields behind first-order systems: ``collins`` by the rank of B,
                     ``astigmatic`` of other curvatures along one axis than along the other;
                     ``spread`` the light of a point behind a lens
``builders``         lines, planes, hemispheres and volumes: ``grids`` of points and ``datasets``
``patterns``         radiation patterns, the far field over angles; ``pattern_files`` writes them
``beams``            what a data sheet says of a pattern: gain, beamwidths, sidelobes, from
                     ``pattern_cuts``, cuts along meridians
``stores``           arrays larger than memory: in chunks, on disk, by many, taken up when killed
``exports``          datasets to NetCDF and VTK files
``suggestions``      how many samples a grid needs: ``suggestions_fields`` bands of fields, and
                     ``suggestions_noise`` samples per pixel
``wigner_tables``    W and A on grids of four coordinates
===================  ==========================================================================
"""

from __future__ import annotations

from polywigner.propagation import horns
from polywigner.propagation.amplitudes import amplitude
from polywigner.propagation.beams import BeamMetrics, CutMetrics, beam_metrics
from polywigner.propagation.builders import hemisphere, line, plane, volume
from polywigner.propagation.exports import write_netcdf, write_vti
from polywigner.propagation.far_fields import radiated_power
from polywigner.propagation.irradiances import irradiance
from polywigner.propagation.pattern_files import write_pattern
from polywigner.propagation.patterns import radiation_pattern
from polywigner.propagation.places import METHODS
from polywigner.propagation.screens import PlaneWave, PointSource, Screen
from polywigner.propagation.spread import psf
from polywigner.propagation.stores_checks import verify_store
from polywigner.propagation.suggestions import AxisSampling, Sampling, suggest_sampling
from polywigner.propagation.wigner_tables import ambiguity_table, wigner_table

__all__ = [
    "METHODS",
    "AxisSampling",
    "BeamMetrics",
    "CutMetrics",
    "PlaneWave",
    "PointSource",
    "Sampling",
    "Screen",
    "ambiguity_table",
    "amplitude",
    "beam_metrics",
    "hemisphere",
    "horns",
    "irradiance",
    "line",
    "plane",
    "psf",
    "radiated_power",
    "radiation_pattern",
    "suggest_sampling",
    "verify_store",
    "volume",
    "wigner_table",
    "write_netcdf",
    "write_pattern",
    "write_vti",
]
