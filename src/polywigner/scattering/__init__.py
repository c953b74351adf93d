"""What a conducting body sends back to a radar.

====================  =========================================================================
module                what is in it
====================  =========================================================================
``cross_sections``    the radar cross section by physical optics
``patterns``          the same over azimuth and elevation
``facets``            bodies and plates as triangles, and whether they can shadow themselves
``section_slopes``    its derivatives in directions
``near_sections``     the cross section near the antennas of a radar; arguments, loops
``near_fields``       what comes back there, as a sum over pieces of plane waves
``antennas``          antennas at their places, and their fields
``convexity``         whether a surface bounds a convex body
``sheets``            facets that join smoothly as one face
``visibility``        the parts of triangles that are seen from far away
``overlaps``          which triangles stand before which, seen from far away
``surface_sums``      the Fourier transform of lit surfaces with their normals
``polarisations``     directions and polarisations, checked
====================  =========================================================================
"""

from polywigner.scattering.cross_sections import rcs
from polywigner.scattering.patterns import rcs_pattern

__all__ = ["rcs", "rcs_pattern"]
