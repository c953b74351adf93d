"""Radar cross sections of conducting bodies.

====================  =========================================================================
module                content
====================  =========================================================================
``cross_sections``    radar cross sections by physical optics, and patterns
``facet_beams``       sums over illuminated surfaces, and over beams after up to three reflections
``facets``            bodies and plates as triangles: visible parts, Fourier transforms, and
                      mutual illumination of faces
``near_fields``       antennas and their fields near a body; cross sections from these fields
====================  =========================================================================
"""

from polywigner.scattering.cross_sections import rcs, rcs_pattern

__all__ = ["rcs", "rcs_pattern"]
