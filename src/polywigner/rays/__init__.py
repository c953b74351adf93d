"""Rays that carry the Wigner function through ray optics (docs/signed_rays.md).

A ray has a position, a direction and a weight in watts. The weight is negative where the Wigner
function W is negative, so only sums over many rays are meaningful. Rays carry W exactly through
first-order systems, such as free space and thin lenses, and approximately through aberrations.

===================  ==========================================================================
module               content
===================  ==========================================================================
``sampling``         positions in the automean; rays drawn from W of a source: :func:`sample_rays`
``bundles``          datasets of rays before and after a ray tracer; irradiance in the pixels of a
                     plane and its standard error; source files for OpticStudio
===================  ==========================================================================
"""

from polywigner.rays.bundles import load, rebuild, save, traced
from polywigner.rays.sampling import sample_rays

__all__ = ["load", "rebuild", "sample_rays", "save", "traced"]
