"""Rays that carry the Wigner function through ray optics (docs/signed_rays.md).

A ray has a position, a direction and a weight in watts. The weight is negative where the Wigner
function W is negative, so only sums over many rays are meaningful. Rays carry W exactly through
first-order systems, such as free space and thin lenses, and approximately through aberrations.

===================  ==========================================================================
module               content
===================  ==========================================================================
``sampling``         positions in the automean; rays drawn from W of a source: :func:`sample_rays`
``bundles``          rays as a dataset, before and after a ray tracer, the irradiance in the pixels
                     of a plane, with its standard error, and source files of OpticStudio
===================  ==========================================================================
"""

from polywigner.rays.bundles import load, rebuild, save, traced
from polywigner.rays.sampling import sample_rays

__all__ = ["load", "rebuild", "sample_rays", "save", "traced"]
