"""Rays that carry the Wigner function through ray optics, and back (docs/signed_rays.md).

A ray has a position, a direction and a weight in watts, which is negative where W is: single rays
mean nothing, sums over many do. Through systems of first order, of free space and thin lenses, rays
carry W exactly; through aberrations approximately.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``sampling``         rays drawn from W of a source: :func:`sample_rays`
``bundles``          rays as a dataset: checked, after ray optics of your own, and rebuilt to
                     irradiance in the pixels of a plane, with its standard error
``files``            .npz, .csv, NetCDF and source files of OpticStudio, written and read
===================  ==========================================================================
"""

from polywigner.rays.bundles import rebuild, traced
from polywigner.rays.files import load, save
from polywigner.rays.sampling import sample_rays

__all__ = ["load", "rebuild", "sample_rays", "save", "traced"]
