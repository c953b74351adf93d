"""A few nodes that represent the points of a source in shadows, and their waves at edges.

The field of a radiating point behind obstacles, divided by its free field, is a smooth function of
the position of the point. It is evaluated at a few nodes of the source and interpolated. The wave
of a node is the sum of the waves of all radiating points, each multiplied by a Lagrange polynomial;
it is exact in free space. Lengths are in wavelengths. Source: (SB7).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.execution import NumpyOperations
from polywigner.numerics.nodes import gauss_legendre
from polywigner.propagation.equivalent_points import RadiatingPoint, spherical_wave

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

EDGE_AMPLITUDE = 1.0 / (math.sqrt(8.0) * math.pi)
"""Amplitude of the wave around an edge over the free wave, times the square root of the detour."""
NEAR = 0.3
"""Detour below which the edge wave is computed with the weights of the nodes at the point."""
# Numbers of nodes along x or y, and the largest error of an edge's wave by interpolation, over the
# largest free field, for which each number is used. The numbers are odd, so that the centre is a
# node. With several nodes, the error is overestimated by a factor of four to ten.
_LIMITS = {1: 1e-3, 3: 8e-3, 5: 8e-3, 7: 8e-3}
# Largest error, in the same unit, for which the centre replaces all nodes.
_BY_CENTRE = 5e-4
# Least limit between the detours of near and of far edges, and the ratios to it that are tried.
_LEAST_DETOUR, _RATIOS = 0.05, tuple(1.5**k for k in range(10))
# Largest number of nodes.
_MOST_NODES = 225
# Least distance on a far edge between the edge and the line from the centre of the source to the
# point, over half of the size of the source.
_CLEAR = 1.5
# Factor by which the estimated error of far nodes may exceed the allowed error. The estimate was at
# least ten times too large for plates, boxes and balls, with tolerances of 1e-4 and 1e-6.
_FAR_ERROR = 5.0
# Ratio of the costs of a far node and a near node, if all detours are below 1.
_FAR_COST = 0.1
# Number of directions along each axis of the hemisphere in which the largest far field is searched.
_DIRECTIONS = 33
# Number of positions on edges times number of radiating points per block (some 100 MB).
_BLOCK = 1 << 21


@dataclass(frozen=True)
class SourceNodes:
    """Nodes of a source, and the radiating points that they represent."""

    points: Sequence[RadiatingPoint]
    """The n radiating points."""
    positions: Floats
    """Positions (k, 3) of the nodes."""
    fractions: Floats
    """Fractions (k, n) of each radiating point that each node represents; they add up to 1."""

    @property
    def is_reduced(self) -> bool:
        """Whether there are fewer nodes than radiating points."""
        return len(self.positions) < len(self.points)

    @cached_property
    def origins(self) -> Floats:
        """Positions (n, 3) of the radiating points."""
        return np.array([point.position for point in self.points])

    @cached_property
    def centre(self) -> Floats:
        """Mean position (3,) of the radiating points."""
        return np.mean(self.origins, axis=0)

    @cached_property
    def peak(self) -> float:
        """Largest far field over all directions, times the distance."""
        sines = np.linspace(-1.0, 1.0, _DIRECTIONS)
        x, y = (part.ravel() for part in np.meshgrid(sines, sines))
        z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
        rays = np.stack([x, y, z], axis=1)[x * x + y * y <= 1.0]
        phases = np.exp(-2j * math.pi * rays @ self.origins.T)
        field, slope = (np.array([p[k] for p in self.points]) for k in (1, 2))
        return float(np.abs(phases @ slope + rays[:, 2] * (phases @ field)).max())

    def waves_at(self, places: Floats) -> tuple[Complex, Floats]:
        """Return the waves of the nodes, and of the entire source, at positions (q, 3).

        The waves (q, k + 1) are relative to a unit wave from the node, and for the entire source
        from the centre. Also return the detours (q,) from which on the wave of the source is
        accurate enough.
        """
        parts, detours = zip(*map(self._waves_at, self.blocks_of(places)), strict=True)
        return np.concatenate(parts), np.concatenate(detours)

    def blocks_of(self, places: Floats) -> list[Floats]:
        """Divide positions (q, 3) into blocks whose waves from all points fit in memory."""
        return np.array_split(places, 1 + len(places) * len(self.points) // _BLOCK)

    def waves_of_points(self, places: Floats) -> Complex:
        """Return the waves (q, n) of the radiating points at positions (q, 3)."""
        return np.stack([point.wave(places.T) for point in self.points], axis=1)

    def waves_and_dipoles(self, places: Floats) -> list[Complex]:
        """Return these waves, and their parts from weights of the field without obliquity, (q, n).

        The second array is left out if no point has a weight of the field.
        """
        units = _unit_waves(places, self.origins)
        field, slope = (np.array([point[k] for point in self.points]) for k in (1, 2))
        if not field.any():
            return [units * slope]
        ahead = places[:, None] - self.origins
        inverse = 1.0 / np.linalg.norm(ahead, axis=2)
        dipoles = units * field
        obliquity = ahead[..., 2] * inverse * (1.0 + (0.5j / math.pi) * inverse)
        return [dipoles * obliquity + units * slope, dipoles]

    def _waves_at(self, places: Floats) -> tuple[Complex, Floats]:
        waves = self.waves_of_points(places)
        parts, units = self._over_units(places, waves)
        moments = waves / units[:, -1:]
        x, y = (self.origins - self.centre)[:, :2].T
        first = np.hypot(*np.abs(moments @ np.stack([x, y], axis=1)).T)
        second = np.abs(moments @ np.stack([x * x, y * y, x * y], axis=1)).max(axis=1)
        curvature = 1.0 / np.linalg.norm(places - self.centre, axis=1)
        # The estimated error is slope/detour + bend/sqrt(detour).
        slope = 0.5 * np.sqrt(2.0 * curvature) * first * EDGE_AMPLITUDE / self.peak
        bend = math.pi * curvature * second * EDGE_AMPLITUDE / self.peak
        root = 0.5 * (bend + np.sqrt(bend * bend + 4.0 * slope * _BY_CENTRE)) / _BY_CENTRE
        return parts, root * root

    def dipoles_at(self, places: Floats) -> Complex:
        """Return the dipoles (q, k + 1) of the waves of :meth:`waves_at`, without obliquity."""
        field = np.array([point.field for point in self.points])
        parts = [
            self._over_units(some, field * _unit_waves(some, self.origins))[0]
            for some in self.blocks_of(places)
        ]
        return np.concatenate(parts)

    def _over_units(self, places: Floats, waves: Complex) -> tuple[Complex, Complex]:
        """Return the waves of the nodes and of the source over unit waves, and the unit waves.

        ``waves``: waves (q, n) of the radiating points at positions (q, 3). Both results have the
        shape (q, k + 1), with a last column for the entire source.
        """
        units = _unit_waves(places, np.concatenate([self.positions, self.centre[None]]))
        parts = np.column_stack([waves @ self.fractions.T, waves.sum(axis=1)])
        return parts / units, units


def _unit_waves(places: Floats, starts: Floats) -> Complex:
    """Return unit spherical waves (q, k) from the points ``starts`` (k, 3) at positions (q, 3)."""
    waves = [spherical_wave(NumpyOperations(), tuple((places - start).T)) for start in starts]
    return np.stack([wave.real + 1j * wave.imag for wave in waves], axis=1)


def all_points(points: Sequence[RadiatingPoint]) -> SourceNodes:
    """Return the radiating points of a source as its nodes."""
    return SourceNodes(points, np.array([point.position for point in points]), np.eye(len(points)))


def nodes_for(points: Sequence[RadiatingPoint], edges: Floats) -> SourceNodes:
    """Return the nodes of a source for edges with ends (m, 2, 3): few if all edges are far away."""
    every = all_points(points)
    allowed = {count: limit * every.peak for count, limit in _LIMITS.items()}
    return _few_nodes(every, _WavesAtEdges.of(every, edges), _turned_by(NEAR), allowed)


class Interpolation(NamedTuple):
    """Nodes of a source that interpolate the waves of near and of far edges."""

    near: SourceNodes
    far: SourceNodes
    detour: float
    """Detour from which on an edge is far."""


def interpolation_for(
    points: Sequence[RadiatingPoint], edges: Floats, error: float, overlap: float, is_shared: bool
) -> Interpolation | None:
    """Return the nodes with the least cost for edges with ends (m, 2, 3); None if there are none.

    Parameters
    ----------
    points : sequence of RadiatingPoint
        Points of the source.
    edges : ndarray, shape (m, 2, 3)
        Ends of the edges, in wavelengths.
    error : float
        Allowed error of the wave of an edge, times the distance from the source.
    overlap : float
        Largest detour of near edges over the least detour of far edges.
    is_shared : bool
        Whether all points see the same edges. If not, the near nodes are all points.
    """
    every = all_points(points)
    waves = _WavesAtEdges.of(every, edges)
    allowed = dict.fromkeys(range(1, _MOST_NODES), error)
    allowed_far = dict.fromkeys(range(1, _MOST_NODES), _FAR_ERROR * error)
    reach = 0.5 * float(np.linalg.norm(np.ptp(every.origins, axis=0)))
    least = max(_LEAST_DETOUR, 0.5 * (_CLEAR * reach) ** 2 / float(waves.distance.min()))
    choices = []
    for detour in [least * ratio for ratio in _RATIOS]:
        far = _few_nodes(every, waves, _divided_at(detour), allowed_far)
        if len(far.positions) <= _MOST_NODES:
            turned = _turned_by(overlap * detour, 1.0)
            near = _few_nodes(every, waves, turned, allowed) if is_shared else every
            cost = math.sqrt(detour) * len(near.positions) + _FAR_COST * len(far.positions)
            choices.append((cost, Interpolation(near, far, detour)))
    return min(choices, key=lambda choice: choice[0])[1] if choices else None


@dataclass(frozen=True)
class _WavesAtEdges:
    """Waves of the points of a source at positions on edges, summed over one axis of the source."""

    distance: Floats
    """(q,) from the centre of the source."""
    axes: list[tuple[Floats, Complex]]
    """For x and y: positions (k,) from the centre, and the waves (q, k) of their points."""

    @classmethod
    def of(cls, source: SourceNodes, edges: Floats) -> _WavesAtEdges:
        """Sum the waves at both ends of edges (m, 2, 3), next to the source, and in between."""
        start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
        squares = np.maximum((along * along).sum(axis=1), 1e-300)
        nearest = np.clip(((source.centre - start) * along).sum(axis=1) / squares, 0.0, 1.0)
        one = np.ones_like(nearest)
        fractions = [0.0 * one, 0.5 * nearest, nearest, 0.5 + 0.5 * nearest, one]
        places = np.concatenate([start + part[:, None] * along for part in fractions])
        positions, owners = [], []
        for at, centre in zip(source.origins[:, :2].T, source.centre, strict=False):
            values, which = np.unique(at, return_inverse=True)
            positions.append(values - centre)
            owners.append(np.eye(len(values))[which.ravel()])
        parts = [
            [waves @ owner for owner in owners]
            for waves in map(source.waves_of_points, source.blocks_of(places))
        ]
        sums = [np.concatenate(part) for part in zip(*parts, strict=True)]
        distance = np.linalg.norm(places - source.centre, axis=1)
        return cls(distance, list(zip(positions, sums, strict=True)))


EdgeWave = Callable[[Floats, Floats], NDArray[Any]]
"""Wave of an edge, for distances (q, 1) from the source and positions (k,) along its axis."""


def _turned_by(detour: float, curvature: float = 0.0) -> EdgeWave:
    """Return the wave of an edge over the wave at a point far behind it.

    Over the source, its phase changes by 2 pi sqrt(2 detour/distance) times the position. The
    detour itself changes by half of the squared position over the distance, if ``curvature`` is 1.
    """

    def wave(distance: Floats, at: Floats) -> Complex:
        cycles = (np.sqrt(2.0 * detour / distance) + 0.5 * curvature * at / distance) * at
        return np.asarray(EDGE_AMPLITUDE / math.sqrt(detour) * np.exp(2j * math.pi * cycles))

    return wave


def _divided_at(detour: float) -> EdgeWave:
    """Return the wave of an edge over the wave at the edge.

    It diverges at positions that have the point on the boundary of their shadow.
    """

    def wave(distance: Floats, at: Floats) -> Floats:
        ratio = 1.0 + at / np.sqrt(2.0 * detour * distance)
        return np.asarray(EDGE_AMPLITUDE / math.sqrt(detour) / ratio)

    return wave


def _few_nodes(
    every: SourceNodes, waves: _WavesAtEdges, wave: EdgeWave, allowed: Mapping[int, float]
) -> SourceNodes:
    """Return the first nodes along each axis with an error that is small enough.

    ``allowed``: errors for each number of nodes along an axis, times the distance of the edge.
    """
    numbers = []
    for at, sums in waves.axes:
        # points with one coordinate have one node along this axis
        for count in [count for count in allowed if count == 1 or len(at) > 1]:
            nodes, fractions = _axis(at, count)
            distance = waves.distance[:, None]
            change = wave(distance, at) - wave(distance, nodes) @ fractions
            error = waves.distance * np.abs((sums * change).sum(axis=1))
            if error.max() <= allowed[count]:
                numbers.append(count)
                break
    if len(numbers) < 2 or math.prod(numbers) >= len(every.points):
        return every
    (x, first), (y, second) = (
        _axis(at, count) for at, count in zip(every.origins[:, :2].T, numbers, strict=True)
    )
    positions = np.array([[a, b, every.origins[0, 2]] for a in x for b in y])
    fractions = first[:, None] * second[None, :]
    return SourceNodes(every.points, positions, fractions.reshape(len(positions), -1))


def _axis(at: Floats, count: int) -> tuple[Floats, Floats]:
    """Return Gauss nodes (k,) over coordinates (n,), and their Lagrange polynomials (k, n) there.

    The polynomial of a node is 1 at this node and 0 at the other nodes.
    """
    centre, half = 0.5 * (at.max() + at.min()), 0.5 * np.ptp(at)
    nodes = centre + half * gauss_legendre(count)[:, 0]
    others = [np.delete(nodes, k) for k in range(count)]
    factors = [
        np.prod((at[:, None] - some) / (node - some), axis=1)
        for node, some in zip(nodes, others, strict=True)
    ]
    return nodes, np.array(factors)
