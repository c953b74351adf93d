"""Sections of an aperture along y, and its overlap with its mirror image, as functions of x.

What is left of the phase-space functions of an aperture when two of four coordinates have been
integrated out (docs/projections.md). Everything here is along y or mirrors x; the other direction
is that of the :func:`transposed` aperture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.engines import NumpyOperations
from polywigner.geometry import Aperture
from polywigner.kernels.phases import turns_to_centre
from polywigner.kernels.stokes import triangle_plane_wave
from polywigner.kernels.trigonometry import cos_sin_turns, mean_plane_wave

__all__ = [
    "Sections",
    "mirrored_correlation",
    "overlap_edges",
    "overlap_spectra",
    "phase",
    "section_lengths",
    "section_spectra",
    "sections",
    "transposed",
]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

_OPS = NumpyOperations(double=True)

# Values of a temporary array: some tens of megabytes with its intermediates.
_BLOCK = 1 << 20


def transposed(aperture: Aperture) -> Aperture:
    """The aperture with x and y exchanged."""
    return Aperture._of_parts(
        [tuple(ring[::-1, ::-1] for ring in part) for part in aperture._parts]
    )


@dataclass(frozen=True)
class Sections:
    """Intervals [low, high] of y, each in the section at one of ``count`` abscissae."""

    count: int
    row: Indices
    low: Array
    high: Array


def _upright(aperture: Aperture) -> tuple[Array, Array, Array]:
    """Left and right ends (n, 2) of the edges that are not vertical, and +1 below, -1 above.

    Relative to the centre, so that no digits are lost far from the origin.
    """
    start = np.concatenate(aperture.rings) - aperture.centre
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in aperture.rings]) - aperture.centre
    run = end[:, 0] - start[:, 0]
    start, end, run = start[run != 0], end[run != 0], run[run != 0]
    forward = run[:, None] > 0
    return np.where(forward, start, end), np.where(forward, end, start), np.sign(run)


def _height(left: Array, right: Array, x: Array) -> Array:
    """The edges' y at x, between the ends whatever the rounding."""
    share = (x - left[..., 0]) / (right[..., 0] - left[..., 0])
    return left[..., 1] * (1 - share) + right[..., 1] * share


def sections(aperture: Aperture, x: Array) -> Sections:
    """The intervals of y in the aperture at abscissae x (n,), relative to the centre's y.

    At the abscissa of a vertical edge: those to the right of it.
    """
    left, right, _ = _upright(aperture)
    at = x - aperture.centre[0]
    row, edge = np.nonzero((left[:, 0] <= at[:, None]) & (at[:, None] < right[:, 0]))
    height = _height(left[edge], right[edge], at[row])
    order = np.lexsort((height, row))
    # Going up, edges enter and leave the aperture in turn.
    return Sections(len(x), row[order][0::2], height[order][0::2], height[order][1::2])


def section_lengths(found: Sections) -> Array:
    """(count,) total length of each section."""
    lengths = np.zeros(found.count)
    np.add.at(lengths, found.row, found.high - found.low)
    return lengths


def section_spectra(found: Sections, nu: Array) -> Complex:
    """(count, n) Fourier transforms of the sections' indicator functions at nu (n,)."""

    def term(chosen: Indices) -> tuple[Any, Any]:
        low, high = found.low[chosen, None], found.high[chosen, None]
        cosine, sine = mean_plane_wave(_OPS, nu * low, nu * high)
        return cosine * (high - low), sine * (high - low)

    return _row_sums(found.row, found.count, len(nu), term)


def _row_sums(
    row: Indices, count: int, columns: int, term: Callable[[Indices], tuple[Any, Any]]
) -> Complex:
    """Sums of (cosine, -sine) over the entries of each row, all rows at a time; row ascends."""
    total = np.zeros((count, columns), np.complex128)
    rank = np.arange(len(row)) - np.searchsorted(row, row)
    for k in range(rank.max(initial=-1) + 1):
        chosen = np.flatnonzero(rank == k)
        cosine, sine = term(chosen)
        total.real[row[chosen]] += cosine
        total.imag[row[chosen]] -= sine
    return total


def phase(centre: float, nu: Array) -> Complex:
    """exp(-2 pi i nu centre), from error-free products."""
    cosine, sine = cos_sin_turns(_OPS, turns_to_centre(_OPS, (centre,), nu))
    return cosine - 1j * sine


@dataclass(frozen=True)
class _Edges:
    """Boundary edges (m, 2) of regions, each of one of ``count`` rows."""

    count: int
    row: Indices
    begin: Array
    end: Array


def overlap_edges(first: Any, second: Any) -> _Edges:
    """The boundaries of the intersections of two arrays of shapely polygons, pair by pair."""
    common = shapely.intersection(first, second)
    parts, row = shapely.get_parts(common, return_index=True)
    inner, index = shapely.get_parts(parts, return_index=True)
    plane = shapely.get_type_id(inner) == shapely.GeometryType.POLYGON
    polygons, row = shapely.orient_polygons(inner[plane]), row[index[plane]]
    rings, owner = shapely.get_rings(polygons, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    same = ring[:-1] == ring[1:]
    begin, end = points[:-1][same], points[1:][same]
    return _Edges(len(common), row[owner][ring[:-1][same]], begin, end)


def overlap_spectra(edges: _Edges, nu: Array) -> Complex:
    """(count, n) Fourier transforms of the regions at the frequencies (nu, 0). Source: (F2)."""
    twice_area = edges.begin[:, 0] * edges.end[:, 1] - edges.begin[:, 1] * edges.end[:, 0]

    def term(chosen: Indices) -> tuple[Any, Any]:
        begin, end = edges.begin[chosen, :1], edges.end[chosen, :1]
        cosine, sine = triangle_plane_wave(_OPS, nu * begin, nu * end)
        return cosine * twice_area[chosen, None], sine * twice_area[chosen, None]

    return _row_sums(edges.row, edges.count, len(nu), term)


def mirrored_correlation(aperture: Aperture, x: Array, lag: Array) -> Array:
    """(n, m): twice the area that the aperture shares with its mirror image, at x (n,), lag (m,).

    The image is that in the vertical line at x, moved up by the lag. Source: docs/projections.md,
    (P5). No edges are cut: the sum is continuous in all its arguments.
    """
    left, right, sign = _upright(aperture)
    signs = sign[:, None] * sign
    found = np.zeros((len(x), len(lag)))
    for row, abscissa in enumerate(x - aperture.centre[0]):
        # Edges i of the one and j of the other lie above each other from low to high.
        low = np.maximum(left[:, None, 0], 2 * abscissa - right[:, 0])
        high = np.minimum(right[:, None, 0], 2 * abscissa - left[:, 0])
        i, j = np.nonzero(low < high)
        begin, end = low[i, j], high[i, j]
        rise = [
            _height(left[i], right[i], at) - _height(left[j], right[j], 2 * abscissa - at)
            for at in (begin, end)
        ]
        weight = -signs[i, j] * (end - begin)
        step = max(1, _BLOCK // max(1, len(lag)))
        for k in range(0, len(weight), step):
            part = slice(k, k + step)
            distances = _mean_distance(lag - rise[0][part, None], lag - rise[1][part, None])
            found[row] += weight[part] @ distances
    return found


def _mean_distance(u: Array, v: Array) -> Array:
    """Mean of |t| over t from u to v."""
    a, b = np.abs(u), np.abs(v)
    total = a + b
    across = u * v < 0  # then total > 0
    return 0.5 * np.where(across, (a * a + b * b) / np.where(across, total, 1.0), total)
