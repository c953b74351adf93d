"""The Fourier transform, with its normals, of what is lit and seen of a body from far away."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from polywigner.scattering.facets import Facets
from polywigner.scattering.surface_sums import Pieces, surface_slopes, surface_sums
from polywigner.scattering.visibility import facing, less_hidden, lit_pieces, seen_along

__all__ = ["lit_slopes", "lit_sums"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def lit_sums(facets: Facets, k: Floats, s: Floats, nu: Floats, monostatic: bool) -> Complex:
    """N(nu) (m, 3) of what is lit along k and seen from s, (m, 3) each."""
    if not facets.casts_shadows:
        return surface_sums(_whole(facets), nu, lambda some, part: facing(facets, k[some], part))
    result = np.zeros((len(nu), 3), np.complex128)
    for rows, pieces in _lit(facets, k, s, monostatic):
        result[rows] = surface_sums(pieces, nu[rows])
    return result


def lit_slopes(facets: Facets, k: Floats, s: Floats, nu: Floats, monostatic: bool) -> Complex:
    """dN_i/dnu_a (m, 3, 3) of what is lit, which stays."""
    if not facets.casts_shadows:
        return surface_slopes(_whole(facets), nu, lambda some, part: facing(facets, k[some], part))
    result = np.zeros((len(nu), 3, 3), np.complex128)
    for rows, pieces in _lit(facets, k, s, monostatic):
        result[rows] = surface_slopes(pieces, nu[rows])
    return result


def _whole(facets: Facets) -> Pieces:
    return Pieces(facets.corner, facets.first, facets.second, facets.vector)


def _lit(
    facets: Facets, k: Floats, s: Floats, monostatic: bool
) -> Iterator[tuple[NDArray[np.intp], Pieces]]:
    """What is lit of each pair of directions, and the numbers of the samples that have it."""
    ways, owner = np.unique(np.concatenate([k, s], axis=1), axis=0, return_inverse=True)
    order = np.argsort(owner.ravel(), kind="stable")
    ends = np.searchsorted(owner.ravel()[order], np.arange(1, len(ways)))
    last, lit = None, None
    groups = np.split(order, ends) if len(ways) else []
    for way, rows in zip(ways, groups, strict=True):
        if lit is None or (way[:3] != last).any():  # ways of one transmitter follow each other
            last, lit = way[:3], seen_along(facets, way[:3])
        seen = lit
        if not monostatic:
            seen = less_hidden(lit, seen_along(facets, -way[3:]), facing(facets, -way[3:]))
        yield rows, lit_pieces(facets, seen)
