"""Radar cross sections of conducting bodies.

====================  =========================================================================
module                what is in it
====================  =========================================================================
``cross_sections``    the radar cross section by physical optics
``section_patterns``  cross sections over azimuth and elevation
``beams``             sums over lit surfaces, and over beams of polygons after two or three
                      reflections
``facets``            bodies and plates as triangles: which join smoothly, which shadow others
``interreflections``  whether faces light each other, as a warning
``near_fields``       the cross section near the antennas of a radar, over pieces of plane waves
``antennas``          antennas at their places, their fields and polarisations
``visibility``        the parts of triangles that are seen from far away, and what stands before
``surface_sums``      the Fourier transform of lit surfaces with their normals
====================  =========================================================================
"""

from polywigner.scattering.cross_sections import rcs
from polywigner.scattering.section_patterns import rcs_pattern

__all__ = ["rcs", "rcs_pattern"]
