"""Sections of a field along y, and its overlap with its mirror image, as functions of x.

What is left of the phase-space functions of a plane source when two of four coordinates have been
integrated out (docs/projections.md). Everything here is along y or mirrors x; the other direction
is that of the transposed field. Coordinates are relative to the field's centre, so that no digits
are lost far from the origin.

A wave on an outline only shifts the frequency at which the transform of a section, or of an
overlap, is taken, and multiplies it with a phase (P16): what is computed once per element is taken
once per wave, or once per pair of waves. Waves (or pairs) that shift by the same are taken
together.
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
from polywigner.geometry import Aperture, Slits
from polywigner.numerics.divided_differences import simplex_plane_wave
from polywigner.numerics.phases import cos_sin_turns, mean_plane_wave, turns_to_centre
from polywigner.source import Array, Illumination

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

_OPS = NumpyOperations(double=True)

# Values of a temporary array: some tens of megabytes with its intermediates.
_BLOCK = 1 << 20

# Shifts that agree to this share of the largest are one: sums of the same terms in another order.
_EQUAL = 1e-12

Pairing = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""From the frequencies (m, 2) of the first and (m, 2) of the second wave of m pairs to a shift, to
subtract from the frequency of the overlap's transform (m, 2), and cycles (m, r) along r
coordinates."""


@dataclass(frozen=True, eq=False)
class PlaneField:
    """u = sum of weight_k u_k over outlines that may overlap; real weights for real fields.

    u_k is the illumination of the outline, or 1.
    """

    outlines: tuple[Aperture, ...]
    weights: NDArray[Any]

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) of all outlines."""
        west, south, east, north = self._boxes.T
        return float(west.min()), float(south.min()), float(east.max()), float(north.max())

    @cached_property
    def centre(self) -> NDArray[np.float64]:
        """Centre of the bounds, (2,)."""
        west, south, east, north = self.bounds
        return np.array([west / 2 + east / 2, south / 2 + north / 2])

    @cached_property
    def is_lit(self) -> bool:
        """Whether there are waves on an outline."""
        return any(outline.illumination is not None for outline in self.outlines)

    def waves(self, k: int) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
        """Amplitudes (m,) at the centre and frequencies (m, 2) of the waves on an outline."""
        illumination = self.outlines[k].illumination
        if illumination is None:
            return np.ones(1, np.complex128), np.zeros((1, 2))
        centred = illumination.moved(-self.centre)
        return centred.amplitudes, centred.frequencies

    @cached_property
    def content(self) -> float:
        """Bound on |F|: the areas times the moduli of the weights."""
        return float(sum(o.area * w for o, w in zip(self.outlines, abs(self.weights), strict=True)))

    @cached_property
    def amplitude(self) -> float:
        """Bound on |u|: the moduli of elements whose boxes meet add up."""
        boxes = shapely.box(*self._boxes.T)
        first, second = shapely.STRtree(boxes).query(boxes, predicate="intersects")
        totals = np.zeros(len(boxes))
        np.add.at(totals, first, abs(self.weights)[second])
        return float(totals.max())

    @property
    def _boxes(self) -> NDArray[np.float64]:
        return np.array([outline.bounds for outline in self.outlines])

    def transposed(self) -> PlaneField:
        """With x and y exchanged."""
        return PlaneField(tuple(map(_transposed, self.outlines)), self.weights)


def is_lit_by_waves(source: Any) -> bool:
    """Whether the field is not constant on an element of a source."""
    return any(element.illumination is not None for element in source.elements_in_plane)


def field_of(source: Aperture | Array) -> PlaneField:
    """The outlines, with the waves on them, and weights of an aperture or array of one plane."""
    if isinstance(source, Aperture):
        return PlaneField((source,), np.ones(1))
    return PlaneField(source.elements_in_plane, source.weights)


def bound_of(source: Aperture | Array) -> PlaneField:
    """A field at least as large, on the same outlines: waves count by the sum of their sizes."""
    field = field_of(source)
    if not is_lit_by_waves(source):
        return field
    return PlaneField(
        field.outlines, field.weights * np.array(list(map(field_bound, field.outlines)))
    )


def field_bound(element: Aperture | Slits) -> float:
    """Bound on the modulus of the field on an element."""
    field = element.illumination
    return 1.0 if field is None else float(np.abs(field.amplitudes).sum())


def _transposed(aperture: Aperture) -> Aperture:
    copy = Aperture._of_parts(
        [tuple(ring[::-1, ::-1] for ring in part) for part in aperture._parts]
    )
    field = aperture.illumination
    if field is None:
        return copy
    return copy.with_illumination(Illumination(field.amplitudes, field.frequencies[:, ::-1]))


# --- uniform fields


@dataclass(frozen=True)
class Sections:
    """Weighted intervals [low, high] of y, each in the section at one of ``count`` abscissae."""

    count: int
    row: Indices
    low: Floats
    high: Floats
    weight: NDArray[Any]
    element: Indices
    """Element that owns the interval."""


@dataclass(frozen=True)
class _Upright:
    """Edges that are not vertical, from left to right; + their field's weight below, - above."""

    left: Floats
    right: Floats
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


def _height(left: Floats, right: Floats, x: Floats) -> Floats:
    """The edges' y at x, between the ends whatever the rounding."""
    share = (x - left[..., 0]) / (right[..., 0] - left[..., 0])
    return left[..., 1] * (1 - share) + right[..., 1] * share


def sections(field: PlaneField, x: Floats) -> Sections:
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


def section_spectra(found: Sections, nu: Floats) -> Complex:
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


def phase(centre: float, nu: Floats) -> Complex:
    """exp(-2 pi i nu centre), from error-free products."""
    cosine, sine = cos_sin_turns(_OPS, turns_to_centre(_OPS, (centre,), nu))
    return cosine - 1j * sine


@dataclass(frozen=True)
class Overlaps:
    """Boundary edges (m, 2) of weighted regions, each of one of ``count`` rows."""

    count: int
    row: Indices
    begin: Floats
    end: Floats
    weight: NDArray[Any]
    first: Indices
    second: Indices
    """Elements ``first`` and ``second`` whose common region it is."""


Copies = Callable[[float], Callable[[Floats], Floats]]
"""From a value to the map of points (m, 2) to one of the two images of the field."""


def overlaps(field: PlaneField, at: Floats, ahead: Copies, behind: Copies) -> Overlaps:
    """The regions that two images of the field have in common, for every value ``at`` (n,).

    ``ahead(value)`` and ``behind(value)`` map points (m, 2) to those images. The weight of a region
    is that of its first element times the conjugate of that of the second.
    """
    one, other = _images(field, at, ahead), _images(field, at, behind)
    row, first, second = _meeting(shapely.bounds(one), shapely.bounds(other))
    pieces = shapely.intersection(one[row, first], other[row, second])
    weight = field.weights[first] * np.conj(field.weights[second])
    begin, end, owner, _ = edges_of(pieces)
    return Overlaps(len(at), row[owner], begin, end, weight[owner], first[owner], second[owner])


def _images(field: PlaneField, at: Floats, copies: Copies) -> NDArray[Any]:
    """(n, elements) polygons."""
    images = [[shapely.transform(o.polygons, copies(v)) for o in field.outlines] for v in at]
    return np.array(images, dtype=object).reshape(len(at), len(field.outlines))


def _meeting(one: Floats, other: Floats) -> tuple[Indices, Indices, Indices]:
    """(row, element, element) wherever boxes (n, elements, 4) meet, rows ascending."""
    pairs = [_pairs(a, b) for a, b in zip(one, other, strict=True)]
    row = np.repeat(np.arange(len(pairs)), [len(first) for first, _ in pairs])
    first, second = (np.concatenate([pair[k] for pair in pairs]) for k in range(2))
    return row, first, second


def _pairs(one: Floats, other: Floats) -> tuple[Indices, Indices]:
    a, b = one[:, None], other[None]
    meet = (a[..., :2] < b[..., 2:]) & (b[..., :2] < a[..., 2:])
    first, second = np.nonzero(meet.all(axis=-1))
    return first, second


def edges_of(geometries: Any) -> tuple[Floats, Floats, Indices, Floats]:
    """Edges of the polygons among geometries, counter-clockwise but for holes.

    Begins and ends (n, 2), numbers (n,) of the geometries, and first corners (n, 2) of the rings.
    """
    parts, index = shapely.get_parts(geometries, return_index=True)
    inner, outer = shapely.get_parts(parts, return_index=True)
    plane = shapely.get_type_id(inner) == shapely.GeometryType.POLYGON
    polygons, owner = shapely.orient_polygons(inner[plane]), index[outer[plane]]
    rings, polygon = shapely.get_rings(polygons, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    edge = np.flatnonzero(ring[1:] == ring[:-1])
    own = ring[edge]
    return points[edge], points[edge + 1], owner[polygon[own]], points[np.searchsorted(ring, own)]


def overlap_spectra(found: Overlaps, nu: Floats, nu_y: float = 0.0) -> Complex:
    """(count, n) Fourier transforms of the regions at the frequencies (nu, nu_y). Source: (F2)."""
    twice_area = found.begin[:, 0] * found.end[:, 1] - found.begin[:, 1] * found.end[:, 0]
    share = found.weight * twice_area

    def term(chosen: Indices) -> tuple[Any, Any]:
        turns = [nu * v[chosen, :1] + nu_y * v[chosen, 1:] for v in (found.begin, found.end)]
        cosine, sine = simplex_plane_wave(_OPS, *turns)
        return cosine * share[chosen, None], sine * share[chosen, None]

    return _row_sums(found.row, found.count, len(nu), term)


def mirrored_correlation(field: PlaneField, x: Floats, lag: Floats) -> NDArray[Any]:
    """Twice the product of the field and its mirror image at x (n,) and lag (m,), (n, m).

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


def _mean_distance(u: Floats, v: Floats) -> Floats:
    """Mean of |t| over t from u to v."""
    a, b = np.abs(u), np.abs(v)
    total = a + b
    across = u * v < 0  # then total > 0
    return 0.5 * np.where(across, (a * a + b * b) / np.where(across, total, 1.0), total)


# --- fields that are sums of plane waves


def column_spectra(field: PlaneField, x: Floats, nu: Floats) -> Complex:
    """(n, m): the field's transform along y at abscissae x (n,), but for the centre's phase."""
    total = np.zeros((len(x), len(nu)), np.complex128)
    for own, found in _by_wave(field, x):
        total += section_spectra(found, nu - own)
    return total


def column_integrals(field: PlaneField, x: Floats) -> NDArray[np.float64] | Complex:
    """(n,): the integral of the field along y at abscissae x (n,); real of real weights."""
    found = column_spectra(field, x, np.zeros(1))[:, 0]
    return found if field.is_lit or np.iscomplexobj(field.weights) else found.real


def _by_wave(field: PlaneField, x: Floats) -> list[tuple[float, Sections]]:
    """Frequencies along y, and the sections with the fields of all waves that have this one."""
    found = sections(field, x)
    if not field.is_lit:
        return [(0.0, found)]
    place = (x - field.centre[0])[found.row]
    weights: dict[float, Complex] = {}
    for k in range(len(field.outlines)):
        own = np.flatnonzero(found.element == k)
        amplitudes, frequencies = field.waves(k)
        for amplitude, (along, across) in zip(amplitudes, frequencies.tolist(), strict=True):
            weight = weights.setdefault(across, np.zeros(len(found.row), np.complex128))
            weight[own] += found.weight[own] * amplitude * np.exp(2j * np.pi * along * place[own])
    return [(across, replace(found, weight=weight)) for across, weight in weights.items()]


def mutual_spectra(
    field: PlaneField, found: Overlaps, nu: Floats, places: Floats, pairing: Pairing
) -> Complex:
    """(rows, m): the sum over all pairs of waves of the overlaps' transforms at (nu, 0).

    ``places``: (rows, r), what the phase of a pair runs along; see ``Pairing``.
    """
    if not field.is_lit:
        return overlap_spectra(found, nu)
    total = np.zeros((found.count, len(nu)), np.complex128)
    for own, first, second in _by_pair(found, len(field.outlines)):
        (one, ahead), (other, behind) = field.waves(first), field.waves(second)
        i, j = (index.ravel() for index in np.indices((len(one), len(other))))
        shifts, rates = pairing(ahead[i], behind[j])
        amplitudes = one[i] * other[j].conj()
        for shift, members in _groups(shifts):
            envelope = np.exp(2j * np.pi * (places @ rates[members].T)) @ amplitudes[members]
            lit = replace(own, weight=own.weight * envelope[own.row])
            total += overlap_spectra(lit, nu - shift[0], -shift[1])
    return total


def _by_pair(found: Overlaps, elements: int) -> Iterator[tuple[Overlaps, int, int]]:
    """The overlaps of every pair of elements that has some."""
    pair = found.first * elements + found.second
    for number in np.unique(pair).tolist():
        own = np.flatnonzero(pair == number)
        first, second = divmod(number, elements)
        edges = {f.name: getattr(found, f.name)[own] for f in fields(found) if f.name != "count"}
        yield replace(found, **edges), first, second


def _groups(shifts: Floats) -> Iterator[tuple[list[float], NDArray[np.intp]]]:
    """Shifts that are equal but for rounding, and which."""
    unit = _EQUAL * max(float(np.abs(shifts).max()), np.finfo(np.float64).tiny / _EQUAL)
    _, number = np.unique(np.round(shifts / unit), axis=0, return_inverse=True)
    for k in range(number.max() + 1):
        members = np.flatnonzero(number.ravel() == k)
        yield shifts[members].mean(axis=0).tolist(), members
