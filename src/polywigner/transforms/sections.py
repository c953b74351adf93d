"""Sections of a field along y, and overlaps of a field with its mirror image.

Projections of phase-space functions consist of such sections and overlaps (docs/projections.md).
Callers exchange x and y of the field for the other direction. Coordinates are relative to the
centre of the field. A plane wave on the source shifts the frequency of a transform and multiplies
the transform by a phase factor, equation (P16), so each overlap is computed once for all waves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.execution import NumpyOperations
from polywigner.geometry import Aperture
from polywigner.geometry.hidden_parts import edges_around
from polywigner.geometry.parts import shifted
from polywigner.geometry.rings import edges_of_rings
from polywigner.numerics import Complex, Floats, Indices, cluster_indices, index_blocks
from polywigner.numerics.phases import (
    cos_sin_cycles,
    cycles_to_centre,
    mean_plane_wave,
    simplex_plane_wave,
)
from polywigner.source import Array
from polywigner.source.normal_form import SourceElement, normal_form

_OPS = NumpyOperations()

# Number of values in a temporary array. The array and its intermediate results take some tens of
# megabytes.
_BLOCK = 1 << 20

# Difference below which frequency shifts are treated as equal, as a fraction of the largest shift,
# because sums in a different order differ by rounding errors.
_EQUAL = 1e-12

Pairing = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Function (first frequencies, second frequencies), each of shape (m, 2), of m pairs of waves. The
function returns the frequency shifts of the transform, and the phase rates: the frequencies of a
pair's phase along the coordinates of a tile."""


@dataclass(frozen=True, eq=False)
class PlaneField:
    """The elements of a plane source, relative to the centre of its bounding box."""

    elements: tuple[SourceElement, ...]
    weights: NDArray[Any]
    """Weights of the elements, which are real for an aperture."""
    centre: Floats
    """Centre of the bounding box of the source in m."""

    @cached_property
    def is_uniform(self) -> bool:
        """Whether the field is constant on each element."""
        return all(element.has_unit_field for element in self.elements)

    def transposed(self) -> PlaneField:
        """Return the field with x and y exchanged."""
        elements = [
            replace(
                element,
                outline=Aperture._of_parts(
                    [tuple(r[::-1, ::-1] for r in part) for part in element.outline._parts]
                ),
                frequencies=element.frequencies[:, ::-1],
            )
            for element in self.elements
            if isinstance(element.outline, Aperture)
        ]
        return PlaneField(tuple(elements), self.weights, self.centre[::-1])


def field_of(source: Aperture | Array) -> PlaneField:
    """Return the field of an aperture, or of an array in one plane."""
    weights = np.ones(1) if isinstance(source, Aperture) else source.weights
    form = normal_form(source).in_plane
    centre = np.reshape(form.bounds, (2, 2)).mean(axis=0)
    return PlaneField(form.moved(-centre).elements, weights, centre)


@dataclass(frozen=True)
class Sections:
    """Weighted intervals of y. Each interval belongs to one of ``count`` values of x."""

    count: int
    row: Indices
    low: Floats
    high: Floats
    weight: NDArray[Any]
    element: Indices
    """Index of the element that contains the interval."""


@dataclass(frozen=True)
class _EdgesFromLeft:
    """All edges of a field that are not vertical, directed from left to right."""

    left: Floats
    right: Floats
    step: NDArray[Any]
    """Change in the field where the edge is crossed in the direction of +y."""
    element: Indices


def _edges_from_left(field: PlaneField) -> _EdgesFromLeft:
    """Return the edges of a field that are not vertical, directed from left to right."""
    rings = [(k, ring) for k, element in enumerate(field.elements) for ring in element.rings]
    start, end = edges_of_rings([ring for _, ring in rings])
    element = np.repeat([k for k, _ in rings], [len(ring) for _, ring in rings])
    run = end[:, 0] - start[:, 0]
    used = run != 0
    start, end, element, run = start[used], end[used], element[used], run[used]
    forward = run[:, None] > 0
    left, right = np.where(forward, start, end), np.where(forward, end, start)
    return _EdgesFromLeft(left, right, np.sign(run) * field.weights[element], element)


def _y_on_line(left: Floats, right: Floats, x: Floats) -> Floats:
    """Return the y coordinate at ``x`` of the line through the points ``left`` and ``right``."""
    fraction = (x - left[..., 0]) / (right[..., 0] - left[..., 0])
    return left[..., 1] * (1 - fraction) + right[..., 1] * fraction


def sections(field: PlaneField, x: Floats) -> Sections:
    """Return the intervals of y inside the outlines at each x.

    Both coordinates are relative to the centre. At a vertical edge, the intervals are those to the
    right of the edge.
    """
    edges = _edges_from_left(field)
    row, edge = np.nonzero((edges.left[:, 0] <= x[:, None]) & (x[:, None] < edges.right[:, 0]))
    height = _y_on_line(edges.left[edge], edges.right[edge], x[row])
    order = np.lexsort((height, edges.element[edge], row))
    # With increasing y, edges alternately enter and leave an outline.
    below, above = order[0::2], order[1::2]
    element = edges.element[edge[below]]
    weight = field.weights[element]
    return Sections(len(x), row[below], height[below], height[above], weight, element)


def _section_spectra(intervals: Sections, nu: Floats) -> Complex:
    """Return the Fourier transforms of weighted intervals, one row for each position x."""

    def term(chosen: Indices) -> tuple[Floats, Floats]:
        """Return the real and the negative imaginary part of the terms of ``chosen`` intervals."""
        low, high = intervals.low[chosen, None], intervals.high[chosen, None]
        cosine, sine = mean_plane_wave(_OPS, nu * low, nu * high)
        factor = intervals.weight[chosen, None] * (high - low)
        return cosine * factor, sine * factor

    return _row_sums(intervals.row, intervals.count, len(nu), term)


def _row_sums(
    row: Indices, count: int, columns: int, term: Callable[[Indices], tuple[Floats, Floats]]
) -> Complex:
    """Return sums of cosine - i sine over all entries of a row, shape (count, columns).

    ``row`` contains the ascending row of each entry. ``term`` returns cosine and sine for the
    indices of entries.
    """
    total = np.zeros((count, columns), np.complex128)
    rank = np.arange(len(row)) - np.searchsorted(row, row)
    for k in range(rank.max(initial=-1) + 1):
        chosen = np.flatnonzero(rank == k)
        cosine, sine = term(chosen)
        total[row[chosen]] += cosine - 1j * sine
    return total


def column_spectra(field: PlaneField, x: Floats, nu: Floats) -> Complex:
    """Return the Fourier transform of the field along y for each x and frequency, equation (P9).

    The result has one row for each x. Both x and y are relative to the centre of the field.
    """
    intervals = sections(field, x)
    at = x[intervals.row]
    # Waves with the same frequency along y are summed before the transform.
    weights: dict[float, Complex] = {}
    for k, element in enumerate(field.elements):
        inside = np.flatnonzero(intervals.element == k)
        waves = zip(element.amplitudes.tolist(), element.frequencies.tolist(), strict=True)
        for amplitude, (along, across) in waves:
            weight = weights.setdefault(across, np.zeros(len(at), np.complex128))
            phases = np.exp(2j * np.pi * along * at[inside])
            weight[inside] += intervals.weight[inside] * amplitude * phases
    total = np.zeros((len(x), len(nu)), np.complex128)
    for across, weight in weights.items():
        total += _section_spectra(replace(intervals, weight=weight), nu - across)
    return total


def column_integrals(field: PlaneField, x: Floats) -> NDArray[Any]:
    """Return the integral of the field along y for each x, relative to the centre.

    The result is real for a real field.
    """
    values = column_spectra(field, x, np.zeros(1))[:, 0]
    return values.real if field.is_uniform and not np.iscomplexobj(field.weights) else values


def phase_factor(centre: float, nu: Floats) -> Complex:
    """Return exp(-2 pi i nu centre) for frequencies (n,), from error-free products."""
    cosine, sine = cos_sin_cycles(_OPS, cycles_to_centre(_OPS, (centre,), nu))
    return np.asarray(cosine - 1j * sine)


@dataclass(frozen=True)
class Overlaps:
    """Boundary edges of weighted regions. Each region belongs to one of ``count`` rows."""

    count: int
    row: Indices
    begin: Floats
    end: Floats
    weight: NDArray[Any]
    first: Indices
    second: Indices
    """Index of the second element. A region is the intersection of ``first`` and ``second``."""


Image = tuple[tuple[float, float], Floats]
"""Images of a field: scale factors along x and y, and the shift after scaling of each image."""


def overlaps(field: PlaneField, ahead: Image, behind: Image) -> Overlaps:
    """Return the intersections of each image in ``ahead`` with the same image in ``behind``.

    The weight of an intersection is the weight of its first element times the conjugate of the
    weight of its second element.
    """
    images, others = _image_polygons(field, *ahead), _image_polygons(field, *behind)
    pairs = [
        np.nonzero(((a[:, None, :2] < b[:, 2:]) & (b[:, :2] < a[:, None, 2:])).all(axis=-1))
        for a, b in zip(shapely.bounds(images), shapely.bounds(others), strict=True)
    ]
    row = np.repeat(np.arange(len(pairs)), [len(first) for first, _ in pairs])
    first, second = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    pieces = shapely.intersection(images[row, first], others[row, second])
    weight = field.weights[first] * np.conj(field.weights[second])
    owner, begin, end = edges_around(pieces)
    return Overlaps(len(images), row[owner], begin, end, weight[owner], first[owner], second[owner])


def _image_polygons(field: PlaneField, scale: tuple[float, float], shifts: Floats) -> NDArray[Any]:
    """Return the polygons of elements, scaled and then shifted, shape (shifts, elements)."""
    outlines: list[Any] = [element.outline for element in field.elements]
    polygons: NDArray[Any] = np.array([outline.polygons for outline in outlines], dtype=object)
    scaled = shapely.transform(polygons, lambda points: points * scale)
    copies = shifted(np.tile(scaled, len(shifts)), np.repeat(shifts, len(polygons), axis=0))
    return copies.reshape(len(shifts), len(polygons))


def _overlap_spectra(regions: Overlaps, nu: Floats, nu_y: float = 0.0) -> Complex:
    """Return the sums of the regions' Fourier transforms over each row, shape (rows, n).

    The transforms follow equation (F2). The n frequencies are (nu, nu_y), and the regions are
    multiplied by their weights.
    """
    begin, end = regions.begin, regions.end
    factor = regions.weight * (begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0])

    def term(chosen: Indices) -> tuple[Floats, Floats]:
        """Return the real and the negative imaginary part of the terms of the ``chosen`` edges."""
        cycles = [nu * v[chosen, :1] + nu_y * v[chosen, 1:] for v in (begin, end)]
        cosine, sine = simplex_plane_wave(_OPS, *cycles)
        return cosine * factor[chosen, None], sine * factor[chosen, None]

    return _row_sums(regions.row, regions.count, len(nu), term)


def mutual_spectra(
    field: PlaneField, regions: Overlaps, nu: Floats, points: Floats, pairing: Pairing
) -> Complex:
    """Return the Fourier transforms of overlaps at (nu, 0), summed over all pairs of waves.

    The result has one row for each row of ``regions``. For each row, ``points`` contains the
    coordinates by which the rates of ``pairing`` are multiplied.
    """
    if field.is_uniform:
        return _overlap_spectra(regions, nu)
    total = np.zeros((regions.count, len(nu)), np.complex128)
    for mutual, first, second in _overlaps_by_pair(regions, len(field.elements)):
        ahead, behind = field.elements[first], field.elements[second]
        i, j = (k.ravel() for k in np.indices((len(ahead.amplitudes), len(behind.amplitudes))))
        shifts, rates = pairing(ahead.frequencies[i], behind.frequencies[j])
        amplitudes = ahead.amplitudes[i] * behind.amplitudes[j].conj()
        for shift, members in _distinct_shifts(shifts):
            envelope = np.exp(2j * np.pi * (points @ rates[members].T)) @ amplitudes[members]
            weighted = replace(mutual, weight=mutual.weight * envelope[mutual.row])
            total += _overlap_spectra(weighted, nu - shift[0], -shift[1])
    return total


def _overlaps_by_pair(regions: Overlaps, elements: int) -> Iterator[tuple[Overlaps, int, int]]:
    """Yield the overlaps of each pair of elements, and the indices of both elements."""
    pair = regions.first * elements + regions.second
    for number in np.unique(pair).tolist():
        members = np.flatnonzero(pair == number)
        first, second = divmod(number, elements)
        arrays = {
            f.name: getattr(regions, f.name)[members] for f in fields(regions) if f.name != "count"
        }
        yield replace(regions, **arrays), first, second


def _distinct_shifts(shifts: Floats) -> Iterator[tuple[list[float], Indices]]:
    """Yield each distinct frequency shift, and the indices of pairs of waves with this shift."""
    number = cluster_indices(shifts, _EQUAL * float(np.abs(shifts).max()))
    for k in range(number.max() + 1):
        members = np.flatnonzero(number == k)
        yield shifts[members].mean(axis=0).tolist(), members


def mirrored_correlation(field: PlaneField, x: Floats, lag: Floats) -> NDArray[Any]:
    """Return twice the integral of the product of a uniform field and its mirror image.

    The image is reflected about the vertical line at x, moved up by the lag, and conjugated,
    equation (P5). The result has one row for each x and one column for each lag.
    """
    edges = _edges_from_left(field)
    left, right = edges.left, edges.right
    values = np.zeros((len(x), len(lag)), edges.step.dtype)
    for row, abscissa in enumerate(x):
        # An edge of the field and an edge of the image overlap for x from ``low`` to ``high``.
        low = np.maximum(left[:, None, 0], 2 * abscissa - right[:, 0])
        high = np.minimum(right[:, None, 0], 2 * abscissa - left[:, 0])
        i, j = np.nonzero(low < high)
        begin, end = low[i, j], high[i, j]
        rise = [
            _y_on_line(left[i], right[i], at) - _y_on_line(left[j], right[j], 2 * abscissa - at)
            for at in (begin, end)
        ]
        weight = -edges.step[i] * np.conj(edges.step[j]) * (end - begin)
        for part in index_blocks(len(weight), _BLOCK // max(1, len(lag))):
            distances = _mean_distance(lag - rise[0][part, None], lag - rise[1][part, None])
            values[row] += weight[part] @ distances
    return values


def _mean_distance(u: Floats, v: Floats) -> Floats:
    """Return the mean of |t| for t between u and v."""
    a, b = np.abs(u), np.abs(v)
    total = a + b
    # If the product u v is negative, ``total`` is positive, so the division is valid.
    crosses_zero = u * v < 0
    squares = (a * a + b * b) / np.where(crosses_zero, total, 1.0)
    return 0.5 * np.where(crosses_zero, squares, total)
