"""Interpolation nodes that replace the equivalent points of a source behind obstacles (SB7).

The ratio of the diffracted field to the free field is a smooth function of the source point. This
ratio is evaluated at a few nodes and interpolated by Lagrange polynomials. The result is exact in
free space. Lengths are in wavelengths.
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
"""Ratio of an edge wave to the free wave, times the square root of the detour."""
NEAR = 0.3
# Largest estimated interpolation error for each number of nodes along x or y, relative to the
# largest free field. Odd numbers of nodes include the centre. The estimate is four to ten times too
# large.
_LIMITS = {1: 1e-3, 3: 8e-3, 5: 8e-3, 7: 8e-3}
# Relative error below which the centre alone represents the source.
_BY_CENTRE = 5e-4
# Lower limit of the detour that separates near edges from far edges. The separating detour is the
# smallest detour times one of the factors in _RATIOS.
_LEAST_DETOUR, _RATIOS = 0.05, tuple(1.5**k for k in range(10))
_MOST_NODES = 225
# Smallest distance between far edges and the line of sight, in units of half the source size.
_CLEAR = 1.5
# Allowed ratio of the estimated to the requested error for far edges. For plates, boxes and balls
# the estimate was at least ten times too large.
_FAR_ERROR = 5.0
_FAR_COST = 0.1
# Number of direction cosines along each axis in the search for the largest far field.
_DIRECTIONS = 33
# Number of pairs (edge position, source point) per block, which take about 100 MB.
_BLOCK = 1 << 21


@dataclass(frozen=True)
class SourceNodes:
    """Nodes of a source, and the equivalent points that the nodes replace."""

    points: Sequence[RadiatingPoint]
    positions: Floats
    """Positions of the nodes in wavelengths, shape (k, 3)."""
    fractions: Floats
    """Weight of each node for each of the n points, shape (k, n). Columns sum to 1."""

    @property
    def is_reduced(self) -> bool:
        """Whether there are fewer nodes than equivalent points."""
        return len(self.positions) < len(self.points)

    @cached_property
    def origins(self) -> Floats:
        """Positions of the equivalent points in wavelengths, shape (n, 3)."""
        return np.array([point.position for point in self.points])

    @cached_property
    def centre(self) -> Floats:
        """Mean position of the equivalent points, shape (3,)."""
        return np.mean(self.origins, axis=0)

    @cached_property
    def peak(self) -> float:
        """Largest modulus of the far field over a grid of directions, times the distance."""
        sines = np.linspace(-1.0, 1.0, _DIRECTIONS)
        x, y = (part.ravel() for part in np.meshgrid(sines, sines))
        z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
        rays = np.stack([x, y, z], axis=1)[x * x + y * y <= 1.0]
        phases = np.exp(-2j * math.pi * rays @ self.origins.T)
        field, slope = (np.array([p[k] for p in self.points]) for k in (1, 2))
        return float(np.abs(phases @ slope + rays[:, 2] * (phases @ field)).max())

    def waves_at(self, targets: Floats) -> tuple[Complex, Floats]:
        """Return the waves (q, k + 1) of nodes at points (q, 3), relative to unit spherical waves.

        The last column is the wave of the entire source relative to a unit wave from its centre.
        Also return the detours (q,) above which the last column is accurate enough.
        """
        parts, detours = zip(*map(self._waves_at, self.blocks_of(targets)), strict=True)
        return np.concatenate(parts), np.concatenate(detours)

    def blocks_of(self, targets: Floats) -> list[Floats]:
        """Divide positions (q, 3) into blocks that limit memory."""
        return np.array_split(targets, 1 + len(targets) * len(self.points) // _BLOCK)

    def waves_of_points(self, targets: Floats) -> Complex:
        """Return the waves (q, n) of the equivalent points at positions (q, 3)."""
        return np.stack([point.wave(targets.T) for point in self.points], axis=1)

    def waves_and_dipoles(self, targets: Floats) -> list[Complex]:
        """Return the waves (q, n) of the equivalent points, and their dipoles without obliquity.

        The list contains both arrays (q, n), or only the waves if all dipoles are zero.
        """
        units = _unit_waves(targets, self.origins)
        field, slope = (np.array([point[k] for point in self.points]) for k in (1, 2))
        if not field.any():
            return [units * slope]
        ahead = targets[:, None] - self.origins
        inverse = 1.0 / np.linalg.norm(ahead, axis=2)
        dipoles = units * field
        obliquity = ahead[..., 2] * inverse * (1.0 + (0.5j / math.pi) * inverse)
        return [dipoles * obliquity + units * slope, dipoles]

    def _waves_at(self, targets: Floats) -> tuple[Complex, Floats]:
        """Return the waves and detours of :meth:`waves_at` for a block of points."""
        waves = self.waves_of_points(targets)
        parts, units = self._over_units(targets, waves)
        moments = waves / units[:, -1:]
        x, y = (self.origins - self.centre)[:, :2].T
        first = np.hypot(*np.abs(moments @ np.stack([x, y], axis=1)).T)
        second = np.abs(moments @ np.stack([x * x, y * y, x * y], axis=1)).max(axis=1)
        curvature = 1.0 / np.linalg.norm(targets - self.centre, axis=1)
        # The estimated error is slope/detour + bend/sqrt(detour).
        slope = 0.5 * np.sqrt(2.0 * curvature) * first * EDGE_AMPLITUDE / self.peak
        bend = math.pi * curvature * second * EDGE_AMPLITUDE / self.peak
        root = 0.5 * (bend + np.sqrt(bend * bend + 4.0 * slope * _BY_CENTRE)) / _BY_CENTRE
        return parts, root * root

    def dipoles_at(self, targets: Floats) -> Complex:
        """Return the dipoles of :meth:`waves_at` without obliquity, shape (q, k + 1)."""
        field = np.array([point.field for point in self.points])
        parts = [
            self._over_units(some, field * _unit_waves(some, self.origins))[0]
            for some in self.blocks_of(targets)
        ]
        return np.concatenate(parts)

    def _over_units(self, targets: Floats, waves: Complex) -> tuple[Complex, Complex]:
        """Return the waves of :meth:`waves_at` for point waves (q, n), and the unit waves."""
        units = _unit_waves(targets, np.concatenate([self.positions, self.centre[None]]))
        parts = np.column_stack([waves @ self.fractions.T, waves.sum(axis=1)])
        return parts / units, units


def _unit_waves(targets: Floats, starts: Floats) -> Complex:
    """Return the spherical waves (q, k) at q positions from k starting points."""
    waves = [spherical_wave(NumpyOperations(), tuple((targets - start).T)) for start in starts]
    return np.stack([wave.real + 1j * wave.imag for wave in waves], axis=1)


def all_points(points: Sequence[RadiatingPoint]) -> SourceNodes:
    """Return the equivalent points of a source as its nodes."""
    return SourceNodes(points, np.array([point.position for point in points]), np.eye(len(points)))


def nodes_for(points: Sequence[RadiatingPoint], edges: Floats) -> SourceNodes:
    """Return the nodes of a source for edges with ends (m, 2, 3)."""
    every = all_points(points)
    allowed = {count: limit * every.peak for count, limit in _LIMITS.items()}
    return _few_nodes(every, _WavesAtEdges.of(every, edges), _relative_to_observer(NEAR), allowed)


class Interpolation(NamedTuple):
    """Nodes for near edges and for far edges."""

    near: SourceNodes
    far: SourceNodes
    detour: float
    """Smallest detour of far edges."""


def interpolation_for(
    points: Sequence[RadiatingPoint], edges: Floats, error: float, overlap: float, is_shared: bool
) -> Interpolation | None:
    """Return the cheapest nodes for edges with ends (m, 2, 3), or None if too many are needed.

    ``error`` is the largest allowed product of the error of an edge wave and the distance of the
    edge from the source. ``overlap`` is the largest detour of near edges, as a multiple of the
    smallest detour of far edges. ``is_shared`` is true if the same edges are visible from all
    points.
    """
    every = all_points(points)
    waves = _WavesAtEdges.of(every, edges)
    allowed = dict.fromkeys(range(1, _MOST_NODES), error)
    allowed_far = dict.fromkeys(range(1, _MOST_NODES), _FAR_ERROR * error)
    reach = 0.5 * float(np.linalg.norm(np.ptp(every.origins, axis=0)))
    least = max(_LEAST_DETOUR, 0.5 * (_CLEAR * reach) ** 2 / float(waves.distance.min()))
    choices = []
    for detour in [least * ratio for ratio in _RATIOS]:
        far = _few_nodes(every, waves, _relative_to_edge(detour), allowed_far)
        if len(far.positions) <= _MOST_NODES:
            near_wave = _relative_to_observer(overlap * detour, 1.0)
            near = _few_nodes(every, waves, near_wave, allowed) if is_shared else every
            cost = math.sqrt(detour) * len(near.positions) + _FAR_COST * len(far.positions)
            choices.append((cost, Interpolation(near, far, detour)))
    return min(choices, key=lambda choice: choice[0])[1] if choices else None


@dataclass(frozen=True)
class _WavesAtEdges:
    """Waves of the equivalent points at positions on edges, summed over x or over y."""

    distance: Floats
    """Distances from the centre of the source, shape (q,)."""
    axes: list[tuple[Floats, Complex]]
    """Coordinates (k,) about the centre, and waves (q, k), along x and along y."""

    @classmethod
    def of(cls, source: SourceNodes, edges: Floats) -> _WavesAtEdges:
        """Return the waves of a source at five positions on each edge (m, 2, 3)."""
        start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
        squares = np.maximum((along * along).sum(axis=1), 1e-300)
        nearest = np.clip(((source.centre - start) * along).sum(axis=1) / squares, 0.0, 1.0)
        one = np.ones_like(nearest)
        fractions = [0.0 * one, 0.5 * nearest, nearest, 0.5 + 0.5 * nearest, one]
        targets = np.concatenate([start + part[:, None] * along for part in fractions])
        positions, owners = [], []
        for at, centre in zip(source.origins[:, :2].T, source.centre, strict=False):
            values, which = np.unique(at, return_inverse=True)
            positions.append(values - centre)
            owners.append(np.eye(len(values))[which.ravel()])
        parts = [
            [waves @ owner for owner in owners]
            for waves in map(source.waves_of_points, source.blocks_of(targets))
        ]
        sums = [np.concatenate(part) for part in zip(*parts, strict=True)]
        distance = np.linalg.norm(targets - source.centre, axis=1)
        return cls(distance, list(zip(positions, sums, strict=True)))


EdgeWave = Callable[[Floats, Floats], NDArray[Any]]
"""Relative edge wave for source distances (q, 1) and coordinates (k,) on the source."""


def _relative_to_observer(detour: float, curvature: float = 0.0) -> EdgeWave:
    """Return a function that computes the edge wave relative to the wave at the observation point.

    The function is valid in the far field. ``detour`` is in wavelengths. ``curvature`` is the
    factor, 0 or 1, of the quadratic phase of the source coordinate.
    """

    def wave(distance: Floats, at: Floats) -> Complex:
        """Return the relative edge waves (q, k)."""
        cycles = (np.sqrt(2.0 * detour / distance) + 0.5 * curvature * at / distance) * at
        return np.asarray(EDGE_AMPLITUDE / math.sqrt(detour) * np.exp(2j * math.pi * cycles))

    return wave


def _relative_to_edge(detour: float) -> EdgeWave:
    """Return a function that computes the edge wave relative to the wave at the edge.

    ``detour`` is in wavelengths.
    """

    def wave(distance: Floats, at: Floats) -> Floats:
        """Return the relative edge waves (q, k)."""
        ratio = 1.0 + at / np.sqrt(2.0 * detour * distance)
        return np.asarray(EDGE_AMPLITUDE / math.sqrt(detour) / ratio)

    return wave


def _few_nodes(
    every: SourceNodes, waves: _WavesAtEdges, wave: EdgeWave, allowed: Mapping[int, float]
) -> SourceNodes:
    """Return the smallest set of nodes whose interpolation error is allowed.

    The result is ``every`` if no set is smaller. ``allowed`` contains, for each number of nodes
    along an axis, the largest allowed product of the error and the distance of the edge.
    """
    numbers = []
    for at, sums in waves.axes:
        # If all points have the same coordinate along this axis, a single node is enough.
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
    """Return Gauss nodes (k,) for coordinates (n,), and the Lagrange polynomials (k, n)."""
    centre, half = 0.5 * (at.max() + at.min()), 0.5 * np.ptp(at)
    nodes = centre + half * gauss_legendre(count)[:, 0]
    others = [np.delete(nodes, k) for k in range(count)]
    factors = [
        np.prod((at[:, None] - some) / (node - some), axis=1)
        for node, some in zip(nodes, others, strict=True)
    ]
    return nodes, np.array(factors)
