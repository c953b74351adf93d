"""The support of the Wigner function of a source, or a slightly larger region."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry import Aperture, automean
from polywigner.geometry.parts import union_on_grid
from polywigner.source.array import Array
from polywigner.source.normal_form import normal_form

# The exact region is a union over all pairs of convex pieces: 0.7 s for 30 pieces, 2.3 s (and
# 60000 trapezoids) for 60 pieces.
_MOST_PAIRS = 500
# The union of copies on a lattice takes 4 s for 16000 vertices.
_MOST_VERTICES = 4096


def mutual_support(source: Aperture | Array) -> Aperture:
    """Return a region that contains all x with W(x, nu) != 0, for any weights and fields.

    The region is the automean {(a + b)/2} of an aperture, or of the support of an array, for up to
    500 pairs of convex pieces. For equal elements on a lattice it is the union of the automeans of
    the element at the midpoints of all sites, for up to 4096 vertices. In other cases it is the
    convex hull, which contains the automean.

    Raises GeometryError for arrays of slits, and if elements do not lie in the plane z = 0.
    """
    if isinstance(source, Aperture):
        return _of_aperture(source)
    copies = _copies_on_lattice(source)
    if copies is not None:
        return Aperture(union_on_grid(copies))
    if source.dimension > 1 and len(source) ** 2 > 2 * _MOST_PAIRS:  # each has a piece at least
        outlines = [element.polygons for element in source.elements_in_plane]
        return Aperture(shapely.GeometryCollection(outlines).convex_hull)
    return _of_aperture(source.support)


def _of_aperture(aperture: Aperture) -> Aperture:
    pieces = len(aperture.convex_cover)
    if pieces * (pieces + 1) <= 2 * _MOST_PAIRS:
        return automean(aperture)
    return Aperture(aperture.polygons.convex_hull)


def _copies_on_lattice(array: Array) -> list[shapely.MultiPolygon] | None:
    """Return the element's automean at all midpoints of a lattice; None if that is impossible."""
    copies = normal_form(array).repeated if array.repeated is not None else None
    if copies is None or copies.sites is None:
        return None
    element, lattice = copies.element.shape, copies.sites
    sums = _sums(np.argwhere(lattice.weights != 0))
    if len(sums) * sum(map(len, element.rings)) > _MOST_VERTICES:
        return None
    mean = _of_aperture(element).polygons
    if len(sums) * len(shapely.get_coordinates(mean)) > 2 * _MOST_VERTICES:
        return None
    midpoints = np.array(lattice.origin) + sums / 2 @ np.array(lattice.basis)
    return [shapely.transform(mean, lambda p, at=at: p + at) for at in midpoints]


def _sums(sites: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the distinct sums (m, 2) of two sites (n, 2), which are integers >= 0."""
    is_sum = np.zeros(tuple(2 * sites.max(axis=0) + 1), dtype=bool)
    for site in sites:
        is_sum[tuple((sites + site).T)] = True
    return np.argwhere(is_sum).astype(np.float64)
