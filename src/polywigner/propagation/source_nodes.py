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
    def origins(self) -> Floats:
        """(n, 3) positions of the radiating points."""
        return np.array([point.position for point in self.points])

    @cached_property
    def centre(self) -> Floats:
        """(3,) mean position of the radiating points."""
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
        """Return waves of the nodes, and of the source, at places (q, 3).

        The waves (q, k + 1) are relative to a unit wave from the node, and for the source from the
        centre. Also return detours (q,) from which on the second is accurate enough.
        """
        parts, detours = zip(*map(self._waves_at, self.blocks_of(places)), strict=True)
        return np.concatenate(parts), np.concatenate(detours)

    def blocks_of(self, places: Floats) -> list[Floats]:
        """Divide places (q, 3) into blocks, whose waves from all radiating points fit in memory."""
        return np.array_split(places, 1 + len(places) * len(self.points) // _BLOCK)

    def waves_of_points(self, places: Floats) -> Complex:
        """Return the waves (q, n) of the radiating points at places (q, 3)."""
        return np.stack([point.wave(places.T) for point in self.points], axis=1)

    def _waves_at(self, places: Floats) -> tuple[Complex, Floats]:
        waves = self.waves_of_points(places)
        starts = np.concatenate([self.positions, self.centre[None]])
        units = np.stack([_unit_wave(places - start) for start in starts], axis=1)
        parts = np.column_stack([waves @ self.fractions.T, waves.sum(axis=1)]) / units
        moments = waves / units[:, -1:]
        x, y = (self.origins - self.centre)[:, :2].T
        first = np.hypot(*np.abs(moments @ np.stack([x, y], axis=1)).T)
        second = np.abs(moments @ np.stack([x * x, y * y, x * y], axis=1)).max(axis=1)
        curvature = 1.0 / np.linalg.norm(places - self.centre, axis=1)
        # error: slope/detour + bend/sqrt(detour)
        slope = 0.5 * np.sqrt(2.0 * curvature) * first * EDGE_AMPLITUDE / self.peak
        bend = math.pi * curvature * second * EDGE_AMPLITUDE / self.peak
        root = 0.5 * (bend + np.sqrt(bend * bend + 4.0 * slope * _BY_CENTRE)) / _BY_CENTRE
        return parts, root * root

    def dipoles_at(self, places: Floats) -> Complex:
        """Return the dipoles (q, k + 1) of the waves of :meth:`waves_at`, without obliquity."""
        starts = np.concatenate([self.positions, self.centre[None]])
        parts = []
        for some in self.blocks_of(places):
            units = np.stack([_unit_wave(some - start) for start in starts], axis=1)
            waves = np.stack([p.field * _unit_wave(some - p.position) for p in self.points], axis=1)
            parts.append(np.column_stack([waves @ self.fractions.T, waves.sum(axis=1)]) / units)
        return np.concatenate(parts)


def _unit_wave(ahead: Floats) -> Complex:
    wave = spherical_wave(NumpyOperations(), tuple(ahead.T))
    return np.asarray(wave.real + 1j * wave.imag)


def all_points(points: Sequence[RadiatingPoint]) -> SourceNodes:
    """Return the radiating points of a source as its nodes."""
    return SourceNodes(points, np.array([point.position for point in points]), np.eye(len(points)))


def nodes_for(points: Sequence[RadiatingPoint], edges: Floats) -> SourceNodes:
    """Return the nodes of a source for edges with ends (m, 2, 3), few if all edges are far away."""
    every = all_points(points)
    start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    squares = np.maximum((along * along).sum(axis=1), 1e-300)
    nearest = np.clip(((every.centre - start) * along).sum(axis=1) / squares, 0.0, 1.0)
    fractions = [0.0 * nearest, 0.5 * nearest, nearest, 0.5 + 0.5 * nearest, 0.0 * nearest + 1.0]
    places = np.concatenate([start + part[:, None] * along for part in fractions])
    rules = [
        # points with one coordinate have one node along this axis
        [_axis(at, count) for count in _LIMITS if count == 1 or np.ptp(at) > 0.0]
        for at in every.origins[:, :2].T
    ]
    # Along each axis, the first rule whose error is small enough.
    is_enough = _errors(every, places, rules) <= np.array([*_LIMITS.values()]) * every.peak
    chosen = [rules[k][row.argmax()] for k, row in enumerate(is_enough) if row.any()]
    if len(chosen) < 2 or math.prod(len(nodes) for nodes, _ in chosen) >= len(points):
        return every
    (x, first), (y, second) = chosen
    positions = np.array([[a, b, every.origins[0, 2]] for a in x for b in y])
    fractions = first[:, None] * second[None, :]
    return SourceNodes(points, positions, fractions.reshape(len(positions), -1))


def _axis(at: Floats, count: int) -> tuple[Floats, Floats]:
    """Return Gauss nodes (k,) over coordinates (n,), and their Lagrange polynomials (k, n) there.

    Each node has one polynomial, which is 1 at the node and 0 at the other nodes.
    """
    centre, half = 0.5 * (at.max() + at.min()), 0.5 * np.ptp(at)
    nodes = centre + half * gauss_legendre(count)[:, 0]
    others = [np.delete(nodes, k) for k in range(count)]
    factors = [
        np.prod((at[:, None] - some) / (node - some), axis=1)
        for node, some in zip(nodes, others, strict=True)
    ]
    return nodes, np.array(factors)


def _errors(
    source: SourceNodes, places: Floats, rules: Sequence[Sequence[tuple[Floats, Floats]]]
) -> Floats:
    """Estimate the errors (axis, rule) of the waves of edges by interpolation, times the distance.

    ``rules``: results of :func:`_axis` for x and y. Over the source, the phase of the wave of an
    edge changes by 2 pi sqrt(2 detour/distance) times the position, if the point is far behind the
    edge.
    """
    worst = np.array(
        [[0.0 if k < len(row) else np.inf for k in range(len(_LIMITS))] for row in rules]
    )
    for block in source.blocks_of(places):
        waves = source.waves_of_points(block)
        distance = np.linalg.norm(block - source.centre, axis=1)
        phase = 2j * math.pi * np.sqrt(2.0 * NEAR / distance)[:, None]
        for k, of_axis in enumerate(rules):
            exact = np.exp(phase * (source.origins[:, k] - source.centre[k]))
            for j, (nodes, fractions) in enumerate(of_axis):
                few = np.exp(phase * (nodes - source.centre[k])) @ fractions
                error = distance * np.abs((waves * (exact - few)).sum(axis=1))
                worst[k, j] = max(worst[k, j], error.max(initial=0.0))
    return worst * (EDGE_AMPLITUDE / math.sqrt(NEAR))
