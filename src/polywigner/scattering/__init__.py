"""Radar cross sections of conducting bodies.

==================== =========================================================================
module content ====================
========================================================================= ``cross_sections`` radar
cross sections by physical optics, and their patterns over angles ``facet_beams`` fields of
illuminated surfaces, after one to three reflections ``facets`` bodies and plates as triangles:
visible parts, Fourier transforms, and
                      mutual illumination of faces
``near_fields``       antennas and their fields near a body; cross sections from these fields
====================  =========================================================================
"""

from polywigner.scattering.cross_sections import rcs, rcs_pattern

__all__ = ["rcs", "rcs_pattern"]
