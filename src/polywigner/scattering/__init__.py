"""What a conducting body sends back to a radar.

====================  =========================================================================
module                what is in it
====================  =========================================================================
``cross_sections``    the radar cross section by physical optics
``patterns``          the same over azimuth and elevation
``facets``            bodies and plates as triangles, and whether they can shadow themselves
``convexity``         whether a surface bounds a convex body
``visibility``        the parts of triangles that are seen from far away
``overlaps``          which triangles stand before which, seen from far away
``surface_sums``      the Fourier transform of lit surfaces with their normals
``polarisations``     directions and polarisations, checked
====================  =========================================================================
"""

from polywigner.scattering.cross_sections import rcs
from polywigner.scattering.patterns import rcs_pattern

__all__ = ["rcs", "rcs_pattern"]
