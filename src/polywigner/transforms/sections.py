"""Sections of a field along y, and its overlap with its mirror image, as functions of x.

What is left of the phase-space functions of a plane source when two of four coordinates have been
integrated out (docs/projections.md). Everything here is along y or mirrors x; the other direction
is that of the transposed field. Coordinates are relative to the field's centre, so that no digits
are lost far from the origin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.execution import NumpyOperations
from polywigner.numerics.divided_differences import simplex_plane_wave
from polywigner.numerics.phases import cos_sin_turns, mean_plane_wave, turns_to_centre
from polywigner.transforms.fields import PlaneField

__all__ = [
    "Copies",
    "Overlaps",
    "Sections",
    "mirrored_correlation",
    "overlap_spectra",
    "overlaps",
    "phase",
    "section_lengths",
    "section_spectra",
    "sections",
]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

_OPS = NumpyOperations(double=True)

# Values of a temporary array: some tens of megabytes with its intermediates.
_BLOCK = 1 << 20


@dataclass(frozen=True)
class Sections:
    """Weighted intervals [low, high] of y, each in the section at one of ``count`` abscissae."""

    count: int
    row: Indices
    low: Array
    high: Array
    weight: NDArray[Any]
    element: Indices
    """Whose interval it is."""


@dataclass(frozen=True)
class _Upright:
    """Edges that are not vertical, from left to right; + their field's weight below, - above."""

    left: Array
    right: Array
    step: NDArray[Any]
    """Step of the field on passing the edge upwards."""
    element: Indices


def _upright(field: PlaneField) -> _Upright:
    rings = [(k, ring) for k, outline in enumerate(field.outlines) for ring in outline.rings]
    start = np.concatenate([ring for _, ring in rings]) - field.centre
    end = np.concatenate([np.roll(ring, -1, axis=0) for _, ring in rings]) - field.centre
    element = np.repeat([k for k, _ in rings], [len(ring) for _, ring in rings])
    run = end[:, 0] - start[:, 0]
    used = run != 0
    start, end, element, run = start[used], end[used], element[used], run[used]
    forward = run[:, None] > 0
    return _Upright(
        np.where(forward, start, end),
        np.where(forward, end, start),
        np.sign(run) * field.weights[element],
        element,
    )


def _height(left: Array, right: Array, x: Array) -> Array:
    """The edges' y at x, between the ends whatever the rounding."""
    share = (x - left[..., 0]) / (right[..., 0] - left[..., 0])
    return left[..., 1] * (1 - share) + right[..., 1] * share


def sections(field: PlaneField, x: Array) -> Sections:
    """The intervals of y in the outlines at abscissae x (n,), relative to the centre's y.

    At the abscissa of a vertical edge: those to the right of it.
    """
    edges, at = _upright(field), x - field.centre[0]
    row, edge = np.nonzero((edges.left[:, 0] <= at[:, None]) & (at[:, None] < edges.right[:, 0]))
    height = _height(edges.left[edge], edges.right[edge], at[row])
    order = np.lexsort((height, edges.element[edge], row))
    # Going up, edges enter and leave an outline in turn.
    below, above = order[0::2], order[1::2]
    element = edges.element[edge[below]]
    weight = field.weights[element]
    return Sections(len(x), row[below], height[below], height[above], weight, element)


def section_lengths(found: Sections) -> NDArray[Any]:
    """(count,) integral of the field over each section."""
    lengths = np.zeros(found.count, found.weight.dtype)
    np.add.at(lengths, found.row, found.weight * (found.high - found.low))
    return lengths


def section_spectra(found: Sections, nu: Array) -> Complex:
    """(count, n) Fourier transforms of the field on the sections at nu (n,)."""

    def term(chosen: Indices) -> tuple[Any, Any]:
        low, high = found.low[chosen, None], found.high[chosen, None]
        cosine, sine = mean_plane_wave(_OPS, nu * low, nu * high)
        share = found.weight[chosen, None] * (high - low)
        return cosine * share, sine * share

    return _row_sums(found.row, found.count, len(nu), term)


def _row_sums(
    row: Indices, count: int, columns: int, term: Callable[[Indices], tuple[Any, Any]]
) -> Complex:
    """Sums of cosine - i sine over the entries of each row, all rows at a time; row ascends."""
    total = np.zeros((count, columns), np.complex128)
    rank = np.arange(len(row)) - np.searchsorted(row, row)
    for k in range(rank.max(initial=-1) + 1):
        chosen = np.flatnonzero(rank == k)
        cosine, sine = term(chosen)
        total[row[chosen]] += cosine - 1j * sine
    return total


def phase(centre: float, nu: Array) -> Complex:
    """exp(-2 pi i nu centre), from error-free products."""
    cosine, sine = cos_sin_turns(_OPS, turns_to_centre(_OPS, (centre,), nu))
    return cosine - 1j * sine


@dataclass(frozen=True)
class Overlaps:
    """Boundary edges (m, 2) of weighted regions, each of one of ``count`` rows."""

    count: int
    row: Indices
    begin: Array
    end: Array
    weight: NDArray[Any]
    first: Indices
    second: Indices
    """Which elements have the region in common."""


Copies = Callable[[float], Callable[[Array], Array]]
"""From a value to the map of points (m, 2) to one of the two images of the field."""


def overlaps(field: PlaneField, at: Array, ahead: Copies, behind: Copies) -> Overlaps:
    """The regions that two images of the field have in common, for every value ``at`` (n,).

    ``ahead(value)`` and ``behind(value)`` map points (m, 2) to those images. The weight of a region
    is that of its first element times the conjugate of that of the second.
    """
    one, other = _images(field, at, ahead), _images(field, at, behind)
    row, first, second = _meeting(shapely.bounds(one), shapely.bounds(other))
    pieces = shapely.intersection(one[row, first], other[row, second])
    weight = field.weights[first] * np.conj(field.weights[second])
    rings, piece = _outlines(pieces)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    same = ring[:-1] == ring[1:]
    owner = piece[ring[:-1][same]]
    begin, end = points[:-1][same], points[1:][same]
    return Overlaps(len(at), row[owner], begin, end, weight[owner], first[owner], second[owner])


def _images(field: PlaneField, at: Array, copies: Copies) -> NDArray[Any]:
    """(n, elements) polygons."""
    images = [[shapely.transform(o.polygons, copies(v)) for o in field.outlines] for v in at]
    return np.array(images, dtype=object).reshape(len(at), len(field.outlines))


def _meeting(one: Array, other: Array) -> tuple[Indices, Indices, Indices]:
    """(row, element, element) wherever boxes (n, elements, 4) meet, rows ascending."""
    pairs = [_pairs(a, b) for a, b in zip(one, other, strict=True)]
    row = np.repeat(np.arange(len(pairs)), [len(first) for first, _ in pairs])
    first, second = (np.concatenate([pair[k] for pair in pairs]) for k in range(2))
    return row, first, second


def _pairs(one: Array, other: Array) -> tuple[Indices, Indices]:
    a, b = one[:, None], other[None]
    meet = (a[..., :2] < b[..., 2:]) & (b[..., :2] < a[..., 2:])
    first, second = np.nonzero(meet.all(axis=-1))
    return first, second


def _outlines(geometries: NDArray[Any]) -> tuple[NDArray[Any], Indices]:
    """All rings of the polygons among geometries, outer ones counter-clockwise, and whose."""
    parts, index = shapely.get_parts(geometries, return_index=True)
    inner, outer = shapely.get_parts(parts, return_index=True)
    plane = shapely.get_type_id(inner) == shapely.GeometryType.POLYGON
    polygons, owner = shapely.orient_polygons(inner[plane]), index[outer[plane]]
    rings, polygon = shapely.get_rings(polygons, return_index=True)
    return rings, owner[polygon]


def overlap_spectra(found: Overlaps, nu: Array, nu_y: float = 0.0) -> Complex:
    """(count, n) Fourier transforms of the regions at the frequencies (nu, nu_y). Source: (F2)."""
    twice_area = found.begin[:, 0] * found.end[:, 1] - found.begin[:, 1] * found.end[:, 0]
    share = found.weight * twice_area

    def term(chosen: Indices) -> tuple[Any, Any]:
        turns = [nu * v[chosen, :1] + nu_y * v[chosen, 1:] for v in (found.begin, found.end)]
        cosine, sine = simplex_plane_wave(_OPS, *turns)
        return cosine * share[chosen, None], sine * share[chosen, None]

    return _row_sums(found.row, found.count, len(nu), term)


def mirrored_correlation(field: PlaneField, x: Array, lag: Array) -> NDArray[Any]:
    """(n, m): twice what the field shares with its mirror image, at x (n,) and lag (m,).

    The image is that in the vertical line at x, moved up by the lag, and conjugated. Source:
    docs/projections.md, (P5). No edges are cut: the sum is continuous in all its arguments.
    """
    edges = _upright(field)
    left, right = edges.left, edges.right
    found = np.zeros((len(x), len(lag)), edges.step.dtype)
    for row, abscissa in enumerate(x - field.centre[0]):
        # Edges i of the one and j of the other lie above each other from low to high.
        low = np.maximum(left[:, None, 0], 2 * abscissa - right[:, 0])
        high = np.minimum(right[:, None, 0], 2 * abscissa - left[:, 0])
        i, j = np.nonzero(low < high)
        begin, end = low[i, j], high[i, j]
        rise = [
            _height(left[i], right[i], at) - _height(left[j], right[j], 2 * abscissa - at)
            for at in (begin, end)
        ]
        weight = -edges.step[i] * np.conj(edges.step[j]) * (end - begin)
        size = max(1, _BLOCK // max(1, len(lag)))
        for k in range(0, len(weight), size):
            part = slice(k, k + size)
            distances = _mean_distance(lag - rise[0][part, None], lag - rise[1][part, None])
            found[row] += weight[part] @ distances
    return found


def _mean_distance(u: Array, v: Array) -> Array:
    """Mean of |t| over t from u to v."""
    a, b = np.abs(u), np.abs(v)
    total = a + b
    across = u * v < 0  # then total > 0
    return 0.5 * np.where(across, (a * a + b * b) / np.where(across, total, 1.0), total)
