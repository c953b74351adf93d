"""The edges of a source cut into panels, with the waves along them, as a kernel's tables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polywigner.execution import NumpyOperations
from polywigner.geometry import Aperture
from polywigner.illumination.obliquities import direction_cosines
from polywigner.numerics import phases
from polywigner.radiometry.directions import PlaneSource, checked_source

Floats = NDArray[np.float64]
Block = tuple[Floats, NDArray[np.complex128], NDArray[np.bool_]]
_OPS = NumpyOperations(double=True)

# Rounding leaves few digits of smaller cosines; waves that graze the plane have p_z = 0.
_GRAZING = 1e-6
# With so many turns of phase on half a panel, the largest rule still has nodes to spare.
_TURNS = 48.0


@dataclass(frozen=True)
class _Element:
    """An outline with waves, at shifts (n, 2) with weights (n,)."""

    outline: Aperture
    amplitudes: NDArray[np.complex128]
    frequencies: Floats
    shifts: Floats
    weights: NDArray[np.complex128]

    @property
    def edges(self) -> int:
        """Number of edges of all copies, once for each wave."""
        return sum(map(len, self.outline.rings)) * len(self.amplitudes) * len(self.weights)


@dataclass(frozen=True)
class Radiator:
    """A source of the plane z = 0 as outlines with waves."""

    elements: tuple[_Element, ...]
    low: Floats
    """Corners (2,) of the box around it."""
    high: Floats

    @property
    def centre(self) -> Floats:
        return self.low / 2 + self.high / 2

    @property
    def amplitude(self) -> float:
        """Bound on the field of any one element."""
        return max(
            float(np.abs(e.weights).max() * np.abs(e.amplitudes).sum()) for e in self.elements
        )

    @property
    def content(self) -> float:
        """Bound on the modulus of the Fourier transform."""
        return sum(
            float(np.abs(e.weights).sum() * np.abs(e.amplitudes).sum()) * e.outline.area
            for e in self.elements
        )

    @property
    def highest_frequency(self) -> float:
        """Highest frequency of all waves, in cycles per metre."""
        return max(float(np.linalg.norm(e.frequencies, axis=1).max()) for e in self.elements)

    @property
    def perimeter(self) -> float:
        """Edges of all copies, once for each of their waves."""
        return sum(
            e.outline.polygons.length * len(e.amplitudes) * len(e.shifts) for e in self.elements
        )

    def distance(self, points: Floats) -> Floats:
        """From points (n, 3) to the box around the source."""
        x, y, z = points.T
        aside = np.maximum(np.maximum(self.low[0] - x, x - self.high[0]), 0.0)
        beside = np.maximum(np.maximum(self.low[1] - y, y - self.high[1]), 0.0)
        return np.sqrt(aside * aside + beside * beside + z * z)

    def distance_of_centre(self, points: Floats) -> Floats:
        """Distance of points (n, 3) from the centre of the box, (n,)."""
        x, y, z = points.T
        dx, dy = x - self.centre[0], y - self.centre[1]
        return np.sqrt(dx * dx + dy * dy + z * z)


def radiator_of(source: object) -> Radiator:
    """The radiating outlines of an Aperture, or of an Array in the plane z = 0.

    Raises ArgumentError for anything else, GeometryError for elements outside that plane.
    """
    elements = tuple(_elements(checked_source(source)))
    corners = []
    for element in elements:
        west, south, east, north = element.outline.bounds
        corners.append(element.shifts.min(axis=0) + np.array([west, south]))
        corners.append(element.shifts.max(axis=0) + np.array([east, north]))
    return Radiator(elements, np.min(corners, axis=0), np.max(corners, axis=0))


def _elements(source: PlaneSource) -> Iterator[_Element]:
    if isinstance(source, Aperture):
        yield _element(source, np.zeros((1, 2)), np.ones(1, np.complex128))
        return
    if source.repeated is not None:
        lit = source.weights != 0
        outline = source.repeated[0]
        assert isinstance(outline, Aperture)  # no slits: checked_source
        yield _element(outline, source.repeated[1][lit], source.weights[lit])
        return
    for element, weight in zip(source.elements_in_plane, source.weights, strict=True):
        if weight:
            yield _element(element, np.zeros((1, 2)), np.array([weight]))


def _element(outline: Aperture, shifts: Floats, weights: NDArray[np.complex128]) -> _Element:
    field = outline.illumination
    if field is None:
        return _Element(outline, np.ones(1, np.complex128), np.zeros((1, 2)), shifts, weights)
    return _Element(outline, field.amplitudes, field.frequencies, shifts, weights)


def panels_of(
    radiator: Radiator, wavelength: float, longest: float, count: int, paraxial: bool
) -> Iterator[Block]:
    """Panels times waves in blocks of at most about ``count``.

    ``longest``: of a panel, in wavelengths. Each block is (m, 12) floats: beginning x, y relative
    to the centre, direction x, y, length, p_x, p_y, |p_z|, what these miss by rounding, phase at
    the beginning in turns, all in wavelengths; amplitudes (m,); and which waves are evanescent
    (m,).
    ``paraxial``: with 1 - (p_x^2 + p_y^2)/2 in place of |p_z|, and none evanescent.
    """
    for element in radiator.elements:
        plane = element.frequencies * wavelength
        cosines = cosines_of(element.frequencies, wavelength, paraxial)
        rests = _rests_of(element.frequencies, wavelength, plane, cosines, paraxial)
        reach = reaches(plane, longest)
        for wave, amplitude in enumerate(element.amplitudes):
            pieces = pieces_of(element.outline, wavelength * reach[wave])
            begin, along, length = pieces.begin, pieces.along, pieces.length
            start = starts(begin, element.frequencies[wave])
            step = max(1, count // len(length))
            for first in range(0, len(element.weights), step):
                shifts = element.shifts[first : first + step]
                weights = element.weights[first : first + step]
                places = ((shifts - radiator.centre)[:, None] + begin) / wavelength
                rows = np.empty((len(shifts), len(length), 12))
                rows[..., :2] = places
                rows[..., 2:4] = along
                rows[..., 4] = length / wavelength
                rows[..., 5:7] = plane[wave]
                rows[..., 7] = cosines[wave].real + cosines[wave].imag  # one of them is 0
                rows[..., 8:11] = rests[wave]
                rows[..., 11] = start
                amplitudes = np.repeat(weights * amplitude, len(length))
                evanescent = np.full(amplitudes.shape, bool(cosines[wave].imag > 0))
                yield rows.reshape(-1, 12), amplitudes, evanescent


def cosines_of(frequencies: Floats, wavelength: float, paraxial: bool) -> NDArray[np.complex128]:
    """p_z of waves (m, 2); with ``paraxial`` 1 - (p_x^2 + p_y^2)/2."""
    if not paraxial:
        return direction_cosines(frequencies, wavelength)
    return (1 - ((frequencies * wavelength) ** 2).sum(axis=1) / 2).astype(np.complex128)


def _rests_of(
    frequencies: Floats,
    wavelength: float,
    plane: Floats,
    cosines: NDArray[np.complex128],
    paraxial: bool,
) -> Floats:
    """The parts of p_x, p_y and p_z of waves that rounding leaves out, (m, 3).

    Of evanescent waves, which do not travel along z, only of the first two.
    """
    x, y = plane.T
    rest = np.stack([phases.dot(_OPS, (kappa,), (wavelength,))[1] for kappa in frequencies.T])
    lost = -2 * (x * rest[0] + y * rest[1])
    z = cosines.real
    if paraxial:
        # 2 p_z = 2 - p_x^2 - p_y^2
        total, low = phases.dot(_OPS, (1.0, x, y, z), (2.0, -x, -y, -2.0))
        return np.stack([*rest, (total + (low + lost)) / 2], axis=1)
    total, low = phases.dot(_OPS, (1.0, x, y, z), (1.0, -x, -y, -z))
    upward = np.divide(total + (low + lost), 2 * z, out=np.zeros_like(z), where=z > _GRAZING)
    return np.stack([*rest, upward], axis=1)


def reaches(plane: Floats, longest: float) -> Floats:
    """Longest panels in wavelengths for waves with p_x, p_y (m, 2)."""
    return np.minimum(longest, _TURNS / (1.0 + np.linalg.norm(plane, axis=1)))


def starts(begin: Floats, kappa: Floats) -> Floats:
    """The phase of a wave at places (n, 2), in turns from -1/2 to 1/2."""
    turns = phases.dot(_OPS, tuple(kappa), (begin[:, 0], begin[:, 1]))
    return np.broadcast_to(phases.reduced(_OPS, turns), len(begin))


@dataclass(frozen=True)
class Pieces:
    """Pieces of the edges of an outline."""

    begin: Floats
    """(n, 2)."""
    along: Floats
    """Directions (n, 2)."""
    length: Floats
    """(n,)."""
    owner: NDArray[np.intp]
    """Number of the edge: the number of the vertex that it begins at."""
    share: Floats
    """Share of the edge before the piece begins, (n,)."""
    step: Floats
    """Share of the edge in the piece, (n,)."""


def pieces_of(outline: Aperture, longest: float) -> Pieces:
    """Pieces of an outline's edges, none longer than ``longest``."""
    begin = np.concatenate(outline.rings)
    edge = np.concatenate([np.roll(ring, -1, axis=0) for ring in outline.rings]) - begin
    length = np.hypot(edge[:, 0], edge[:, 1])
    pieces = np.ceil(length / longest).astype(np.intp)
    owner = np.repeat(np.arange(len(edge)), pieces)
    number = np.arange(len(owner)) - np.repeat(pieces.cumsum() - pieces, pieces)
    share = number / pieces[owner]
    return Pieces(
        begin[owner] + share[:, None] * edge[owner],
        (edge / length[:, None])[owner],
        (length / pieces)[owner],
        owner,
        share,
        (1.0 / pieces)[owner],
    )
