"""Few points of a source from which its shadows are computed, and their waves at edges.

The field of a radiating point behind obstacles, over its free field, is a smooth function of the
position of the point. It is evaluated at a few nodes of the source and interpolated. The wave of a
node is the sum of the waves of all radiating points, each times a Lagrange polynomial: exact in
free space. Lengths are in wavelengths. Source: (SB7).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from polywigner.execution import NumpyOperations
from polywigner.numerics.nodes import gauss_legendre
from polywigner.propagation.equivalent_points import RadiatingPoint, spherical_wave

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

EDGE_AMPLITUDE = 1.0 / (math.sqrt(8.0) * math.pi)
"""Amplitude of the wave around an edge over the free wave, times the root of the detour."""
NEAR = 0.3
"""Detour below which the wave of an edge has the weights of the nodes at the point."""
# Numbers of nodes along x or y, odd, so that the centre is a node. Values: the largest errors
# of the wave of an edge by interpolation, over the largest free field, for which each number is
# used. The error is estimated four to ten times too large for several nodes.
_LIMITS = {1: 1e-3, 3: 8e-3, 5: 8e-3, 7: 8e-3}
# Largest error in the same unit if the centre replaces all nodes.
_BY_CENTRE = 5e-4
# Directions along an axis of the hemisphere in which the largest far field is searched.
_DIRECTIONS = 33
# Positions on edges, times radiating points, per block: some 100 MB.
_BLOCK = 1 << 21


@dataclass(frozen=True)
class SourceNodes:
    """Nodes of a source, and the radiating points for which they stand."""

    points: Sequence[RadiatingPoint]
    """The n radiating points."""
    positions: Floats
    """(k, 3)"""
    fractions: Floats
    """(k, n): each node's fraction of each radiating point; the sum over nodes is 1."""

    @property
    def is_reduced(self) -> bool:
        """Whether there are fewer nodes than radiating points."""
        return len(self.positions) < len(self.points)

    @cached_property
    def centre(self) -> Floats:
        """(3,) mean position of the radiating points."""
        return np.mean([point.position for point in self.points], axis=0)

    @cached_property
    def peak(self) -> float:
        """Largest far field over all directions, times the distance."""
        sines = np.linspace(-1.0, 1.0, _DIRECTIONS)
        x, y = (part.ravel() for part in np.meshgrid(sines, sines))
        z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
        rays = np.stack([x, y, z], axis=1)[x * x + y * y <= 1.0]
        positions = np.array([point.position for point in self.points])
        phases = np.exp(-2j * math.pi * rays @ positions.T)
        field, slope = (np.array([p[k] for p in self.points]) for k in (1, 2))
        return float(np.abs(phases @ slope + rays[:, 2] * (phases @ field)).max())

    def waves_at(self, places: Floats) -> tuple[Complex, Floats]:
        """Return waves of the nodes, and of the source, at places (q, 3).

        The waves (q, k + 1) are relative to a unit wave from the node, and for the source from the
        centre. Also return detours (q,) from which on the second is accurate enough.
        """
        blocks = np.array_split(places, 1 + len(places) * len(self.points) // _BLOCK)
        parts, detours = zip(*(self._waves_at(block) for block in blocks), strict=True)
        return np.concatenate(parts), np.concatenate(detours)

    def _waves_at(self, places: Floats) -> tuple[Complex, Floats]:
        waves = np.stack([point.wave(places.T) for point in self.points], axis=1)
        origins = np.concatenate([self.positions, self.centre[None]])
        units = np.stack([_unit_wave(places - origin) for origin in origins], axis=1)
        parts = np.column_stack([waves @ self.fractions.T, waves.sum(axis=1)]) / units
        moments = waves / units[:, -1:]
        x, y = (np.array([p.position for p in self.points]) - self.centre)[:, :2].T
        first = np.hypot(*np.abs(moments @ np.stack([x, y], axis=1)).T)
        second = np.abs(moments @ np.stack([x * x, y * y, x * y], axis=1)).max(axis=1)
        curvature = 1.0 / np.linalg.norm(places - self.centre, axis=1)
        # error: slope/detour + bend/sqrt(detour)
        slope = 0.5 * np.sqrt(2.0 * curvature) * first * EDGE_AMPLITUDE / self.peak
        bend = math.pi * curvature * second * EDGE_AMPLITUDE / self.peak
        root = 0.5 * (bend + np.sqrt(bend * bend + 4.0 * slope * _BY_CENTRE)) / _BY_CENTRE
        return parts, root * root


def _unit_wave(ahead: Floats) -> Complex:
    wave = spherical_wave(NumpyOperations(), tuple(ahead.T))
    return np.asarray(wave.real + 1j * wave.imag)


def all_points(points: Sequence[RadiatingPoint]) -> SourceNodes:
    """Return the radiating points of a source as its nodes."""
    return SourceNodes(points, np.array([p.position for p in points]), np.eye(len(points)))


def nodes_for(points: Sequence[RadiatingPoint], edges: Floats) -> SourceNodes:
    """Return the nodes of a source for edges with ends (m, 2, 3), few if all edges are far away."""
    every = all_points(points)
    start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    squares = np.maximum((along * along).sum(axis=1), 1e-300)
    nearest = np.clip(((every.centre - start) * along).sum(axis=1) / squares, 0.0, 1.0)
    fractions = [0.0 * nearest, 0.5 * nearest, nearest, 0.5 + 0.5 * nearest, 0.0 * nearest + 1.0]
    places = np.concatenate([start + part[:, None] * along for part in fractions])
    limits = {count: limit * every.peak for count, limit in _LIMITS.items()}
    counts = [
        next((n for n, most in limits.items() if _error(points, places, k, n) <= most), len(points))
        for k in range(2)
    ]
    return every if math.prod(counts) >= len(points) else _grid(points, counts)


def _grid(points: Sequence[RadiatingPoint], counts: Sequence[int]) -> SourceNodes:
    """Return Gauss nodes over the bounds of radiating points."""
    (x, first), (y, second) = (_axis(points, k, count) for k, count in enumerate(counts))
    height = points[0].position[2]
    positions = np.array([[a, b, height] for a in x for b in y])
    fractions = first[:, None] * second[None, :]
    return SourceNodes(points, positions, fractions.reshape(len(positions), -1))


def _axis(points: Sequence[RadiatingPoint], axis: int, count: int) -> tuple[Floats, Floats]:
    """Return nodes (k,) along x or y, and their Lagrange polynomials (k, n) at the points."""
    at = np.array([point.position[axis] for point in points])
    centre, half = 0.5 * (at.max() + at.min()), 0.5 * np.ptp(at)
    nodes = centre + half * gauss_legendre(count)[:, 0]
    others = [np.delete(nodes, k) for k in range(count)]
    factors = [
        np.prod((at[:, None] - some) / (node - some), axis=1)
        for node, some in zip(nodes, others, strict=True)
    ]
    return nodes, np.array(factors)


def _error(points: Sequence[RadiatingPoint], places: Floats, axis: int, count: int) -> float:
    """Estimate the error of the waves of edges by interpolation along x or y, times the distance.

    Over the source, the phase of the wave of an edge changes by 2 pi sqrt(2 detour/distance) times
    the position, if the point is far behind the edge.
    """
    nodes, fractions = _axis(points, axis, count)
    at, centre = np.array([point.position for point in points]), all_points(points).centre
    worst = 0.0
    for block in np.array_split(places, 1 + len(places) * len(points) // _BLOCK):
        waves = np.stack([point.wave(block.T) for point in points], axis=1)
        distance = np.linalg.norm(block - centre, axis=1)
        rate = np.sqrt(2.0 * NEAR / distance)[:, None]
        exact, few = (
            np.exp(2j * math.pi * rate * (some - centre[axis])) for some in (at[:, axis], nodes)
        )
        error = distance * np.abs((waves * (exact - few @ fractions)).sum(axis=1))
        worst = max(worst, float(error.max(initial=0.0)))
    return worst * EDGE_AMPLITUDE / math.sqrt(NEAR)
