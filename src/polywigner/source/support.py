"""Where a source's Wigner function may differ from zero: its mutual support, or a little more."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry import Aperture, automean
from polywigner.geometry.parts import union_on_grid
from polywigner.source.array import Array
from polywigner.source.normal_form import normal_form

# The exact region costs a hull for each pair of convex pieces and a union of them: 0.7 s for
# 30 pieces anywhere, 2.3 s (and 60000 trapezoids) for 60.
_MOST_PAIRS = 500
# Copies on a lattice cost less, but their union still 4 s for 16000 vertices.
_MOST_VERTICES = 4096


def mutual_support(source: Aperture | Array) -> Aperture:
    """Region beyond which W(x, nu) of a source is zero, whatever the weights and fields.

    Of an aperture its automean, of an array the automean of its support, {(a + b)/2}, for up to 500
    pairs of convex pieces; of equal elements on a lattice as long as the copies of the element's
    automean at the midpoints of all pairs of sites have up to 4096 vertices. Beyond these the
    convex hull, which any automean lies in.

    Raises GeometryError for arrays whose elements do not lie in the plane z = 0, and those of
    slits.
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
    """The element's automean at all midpoints of a lattice; None if there is none, or too many."""
    copies = normal_form(array).repeated if array.repeated is not None else None
    if copies is None or copies.sites is None:
        return None
    element, lattice = copies.element.shape, copies.sites
    lit = np.argwhere(lattice.weights != 0)
    sums = _sums(lit)
    if len(sums) * sum(map(len, element.rings)) > _MOST_VERTICES:
        return None
    mean = _of_aperture(element).polygons
    if len(sums) * len(shapely.get_coordinates(mean)) > 2 * _MOST_VERTICES:
        return None
    places = np.array(lattice.origin) + sums / 2 @ np.array(lattice.basis)
    return [shapely.transform(mean, lambda p, at=at: p + at) for at in places]


def _sums(sites: NDArray[np.intp]) -> NDArray[np.float64]:
    """All different sums (m, 2) of two of the sites (n, 2), whole numbers from 0 upwards."""
    taken = np.zeros(tuple(2 * sites.max(axis=0) + 1), dtype=bool)
    for site in sites:
        taken[tuple((sites + site).T)] = True
    return np.argwhere(taken).astype(np.float64)
