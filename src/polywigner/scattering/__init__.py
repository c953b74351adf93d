"""Radar cross sections of conducting bodies.

====================  =========================================================================
module                what is in it
====================  =========================================================================
``cross_sections``    the radar cross section by physical optics, and its patterns
``facet_beams``       sums over lit surfaces, and over beams of polygons after two or three
                      reflections
``facets``            bodies and plates as triangles: which join smoothly, shadow others, or light
                      each other
``near_fields``       the cross section near the antennas of a radar, over pieces of plane waves
``antennas``          antennas at their places, their fields and polarisations
``visibility``        the parts of triangles that are seen, and their Fourier transforms
====================  =========================================================================
"""

from polywigner.scattering.cross_sections import rcs, rcs_pattern

__all__ = ["rcs", "rcs_pattern"]
