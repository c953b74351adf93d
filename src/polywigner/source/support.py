"""The support of the Wigner function of a source, or a slightly larger region."""

from __future__ import annotations

import shapely

from polywigner.geometry import Aperture, automean
from polywigner.source.array import Array

# The exact region is a union over all pairs of convex pieces: 0.7 s for 30 pieces, 2.3 s (and
# 60,000 trapezoids) for 60 pieces.
_MOST_PAIRS = 500


def mutual_support(source: Aperture | Array) -> Aperture:
    """Return a region that contains all x with W(x, nu) != 0, for any weights and fields.

    The region is the automean {(a + b)/2} of an aperture, or of the support of an array, for up to
    500 pairs of convex pieces. In other cases it is the convex hull, which contains the automean.

    Raises
    ------
    GeometryError
        For arrays of slits, and if elements do not lie in the plane z = 0.
    """
    if isinstance(source, Array):
        if source.dimension > 1 and len(source) ** 2 > 2 * _MOST_PAIRS:  # a piece at least of each
            outlines = [element.polygons for element in source.elements_in_plane]
            return Aperture(shapely.GeometryCollection(outlines).convex_hull)
        source = source.support
    pieces = len(source.convex_cover)
    if pieces * (pieces + 1) <= 2 * _MOST_PAIRS:
        return automean(source)
    return Aperture(source.polygons.convex_hull)
