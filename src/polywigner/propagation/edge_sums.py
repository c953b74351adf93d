"""Fields behind obstacles as sums over near and far edges (SB7), (SB8).

Edges with short detours are near: their boundary waves are computed for each node of the source.
Far edges are sampled, and their waves are interpolated between nodes. A smooth weight blends both
sums. Lengths are in wavelengths.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.execution import NumpyOperations
from polywigner.execution.choice import resolved
from polywigner.geometry.contours import Silhouette
from polywigner.geometry.silhouettes import Obstacles
from polywigner.kernels.boundary.edge_waves import (
    EdgeRule,
    Point,
    angle_about,
    cross,
    difference,
    dot,
    edge_change,
    path_over,
)
from polywigner.kernels.kernel import Values
from polywigner.numerics import Complex, Floats, Indices, Number, sums_by_index
from polywigner.numerics.nodes import gauss_legendre, nodes_needed
from polywigner.numerics.phases import Pair, unit_wave
from polywigner.propagation.equivalent_points import RadiatingPoint
from polywigner.propagation.source_nodes import Interpolation, interpolation_for

Flags = NDArray[np.bool_]

# Distance [wavelengths] from the point below which an edge is near. The limit for near edges,
# multiplied by _OVERLAP, is the limit at which the blend between near and far edges ends.
_CLOSE, _OVERLAP = 1.0, 1.1
# Number of pairs (point, edge) or (point, source point) per block, which take about 100 MB.
_PAIRS = 1 << 19
# Number of pairs per block whose arrays fit in the processor's cache.
_CACHED = 1 << 14
# Largest number of far nodes per table row. The number is rounded up to a multiple of _STEP, which
# limits the number of compiled kernels.
_PER_ROW, _STEP = 40, 4
# A direct sum over the equivalent points is faster if there are fewer than _LEAST_POINTS equivalent
# points or fewer than _LEAST_PAIRS edge waves. _MOST_LEVELS is the largest number of positions from
# which the largest free field is estimated.
_LEAST_POINTS, _LEAST_PAIRS, _MOST_LEVELS = 16, 1 << 20, 1 << 11
# Costs of a sample on an edge and of a boundary wave, relative to the cost of one far node at a
# sample.
_SAMPLE_COST, _POINT_COST = 8.0, 100.0
_NONE = np.zeros(1)
_OPS: Any = NumpyOperations()


class Targets(NamedTuple):
    """Positions at which the field behind obstacles is computed."""

    positions: Floats
    """Positions in wavelengths, shape (n, 3)."""
    aside: Floats
    """Positions displaced off shadow boundaries for tests of visibility, shape (n, 3)."""
    margin: Floats
    """Thickness of surfaces at each position, shape (n,)."""
    by_angles: Flags
    """Whether edge angles determine visibility, without ray tracing, shape (n,)."""

    def subset(self, some: Any) -> Targets:
        """Return the positions with the given indices or mask."""
        return Targets(*(part[some] for part in self))


@dataclass(frozen=True)
class EdgeSum:
    """A source, the edges visible from the source, and its interpolation nodes."""

    bodies: Obstacles
    points: Sequence[RadiatingPoint]
    edges: Floats
    """Edges visible from at least one source point, shape (m, 2, 3)."""
    sees: Flags
    """Whether each edge is visible from each near node, shape (k, m)."""
    nodes: Interpolation
    counts: Indices
    """Number of samples of each edge, shape (m,)."""
    error: float
    engine: str

    @classmethod
    def of(
        cls,
        bodies: Obstacles,
        points: Sequence[RadiatingPoint],
        seen: Sequence[Silhouette],
        positions: Floats,
        error: float,
        engine: str,
    ) -> EdgeSum | None:
        """Return the sum for positions (n, 3), or None if a sum over all source points is faster.

        ``error`` is the allowed error relative to the largest free field.
        """
        is_shared = all(silhouette is seen[0] for silhouette in seen)
        views = [
            silhouette.edges.reshape(-1, 6) for silhouette in (seen[:1] if is_shared else seen)
        ]
        lengths = [len(view) for view in views]
        cost = len(points) * sum(lengths) // len(views)
        if len(points) < _LEAST_POINTS or cost * len(positions) < _LEAST_PAIRS:
            return None
        ends, which = np.unique(np.concatenate(views), axis=0, return_inverse=True)
        sees = np.zeros((len(views), len(ends)), bool)
        sees[np.repeat(np.arange(len(views)), lengths), which.ravel()] = True
        edges, is_shared = ends.reshape(-1, 2, 3), bool(sees.all())
        some = positions[:: 1 + len(positions) // _MOST_LEVELS]
        level = np.abs(sum(point.wave(some.T) for point in points)).max()
        centre = np.mean([point.position for point in points], axis=0)
        allowed = error * level * np.linalg.norm(positions - centre, axis=1).min()
        nodes = interpolation_for(points, edges, allowed, _OVERLAP, is_shared)
        if nodes is None:
            return None
        blocks = _blocks(len(positions), len(edges))
        counts = [_sample_counts(edges, nodes, positions[some], error) for some in blocks]
        most = np.max(counts, axis=0)
        if most.sum() * (_SAMPLE_COST + len(nodes.far.positions)) > cost * _POINT_COST:
            return None
        if is_shared:
            sees = np.ones((len(nodes.near.positions), len(ends)), bool)
        chosen = resolved(engine, len(positions), cost)
        return cls(bodies, points, edges, sees, nodes, most, error, chosen)

    @property
    def origins(self) -> Floats:
        """Positions of the near nodes, shape (k, 3)."""
        return self.nodes.near.positions

    @property
    def views(self) -> list[tuple[Floats, Floats]]:
        """Position (3,) of each near node, and the edges (m, 2, 3) visible from this node."""
        return [(at, self.edges[row]) for at, row in zip(self.origins, self.sees, strict=True)]

    @cached_property
    def _is_oblique(self) -> bool:
        """Whether edge waves have an obliquity term.

        They have an obliquity term if a source point has a field weight.
        """
        return any(point.field for point in self.points)

    def change(self, targets: Targets, rule: EdgeRule) -> tuple[Complex, Complex]:
        """Return the change of the field due to the obstacles at n targets, and the free field.

        Both arrays have the shape (n,).
        """
        change = self._far_waves(targets.positions)
        free = np.zeros_like(change)
        for some in _blocks(len(change), max(len(self.edges), len(self.points))):
            near, free[some] = self._near_waves(targets.subset(some), rule)
            change[some] += near
        return change, free

    def _near_waves(self, targets: Targets, rule: EdgeRule) -> tuple[Complex, Complex]:
        """Return the change of the field due to shadows and near edges, and the free field.

        Both arrays have the shape (n,).
        """
        source, at = self.nodes.near, targets.positions
        of_points = source.waves_and_dipoles(at)
        waves, *dipoles = (source.fractions @ part.T for part in of_points)
        weights = np.concatenate(
            [
                _near_weight(_OPS, self.nodes.detour, tuple(source.centre), *ends, tuple(at.T))
                for ends in _ends_of_blocks(self.edges, len(at))
            ]
        )
        edges, points = np.nonzero(weights)
        rows = np.column_stack(
            [self.edges[edges].reshape(-1, 6), at[points], targets.aside[points]]
        )
        numbers, pairs = np.nonzero(self.sees[:, edges])
        change = np.zeros(len(at), np.complex128)
        for some in _blocks(len(pairs), 1):
            number, pair = numbers[some], pairs[some]
            point = points[pair]
            parts = np.stack([wave[number, point] for wave in (waves, *dipoles)], axis=1)
            columns = np.column_stack([self.origins[number], rows[pair], parts.view(np.float64)])
            real, imag = self._row_sums(partial(_change, rule), np.zeros((1, 1)), columns, 2)
            total = (real + 1j * imag) * weights[edges[pair], point]
            change += sums_by_index(point, total, len(at))
        # If all edges are far, the visibility of a single node determines whether the point is in
        # shadow.
        free, near = of_points[0].sum(axis=1), weights.any(axis=0)
        change[~near] += free[~near] * self._shadow(len(waves) // 2, targets.subset(~near))
        for k, wave in enumerate(waves):
            change[near] += wave[near] * self._shadow(k, targets.subset(near))
        return change, free

    def _shadow(self, k: int, targets: Targets) -> Floats:
        """Return -1 at points (n,) in the shadow of the near node k, and 0 at other points."""
        by_angles, origin = targets.by_angles, self.origins[k]
        shadow = np.zeros(len(by_angles))
        edges = self.edges[self.sees[k]].reshape(-1, 6)
        (angles,) = self._row_sums(_edge_angle, edges, targets.aside[by_angles], 1, origin)
        shadow[by_angles] = angles / (2.0 * math.pi)
        others = targets.subset(~by_angles)
        shadow[~by_angles] -= self.bodies.hide(origin, others.aside, others.margin)
        return shadow

    def _row_sums(
        self, term: Any, rows: Floats, columns: Floats, outputs: int, shared: Floats = _NONE
    ) -> tuple[Floats, ...]:
        """Return sums of ``term(row, column, shared)`` over rows, an array (n,) for each output.

        ``rows`` has the shape (r, p), and ``columns`` the shape (n, q).
        """
        if not len(rows) * len(columns):
            return (np.zeros(len(columns)),) * outputs
        return execution.evaluate_rows(term, rows, columns, shared, outputs, self.engine)

    def _far_waves(self, positions: Floats) -> Complex:
        """Return the sum of the waves of far edges at positions (n, 3)."""
        number = np.repeat(np.arange(len(self.counts)), self.counts)
        rules = {count: gauss_legendre(count)[:, :2] for count in np.unique(self.counts).tolist()}
        at, weight = np.concatenate([rules[count] for count in self.counts.tolist()]).T
        along = self.edges[number, 1] - self.edges[number, 0]
        samples = self.edges[number, 0] + (0.5 + 0.5 * at)[:, None] * along
        tangents = (-0.125 / math.pi) * weight[:, None] * along
        shared = np.array([self.nodes.detour, *self.nodes.far.centre])
        total = np.zeros(len(positions), np.complex128)
        for some in _blocks(len(samples), len(self.points)):
            nodes = self._far_nodes(samples[some], number[some])
            ends = self.edges[number[some]].reshape(-1, 6)
            ends = np.column_stack([samples[some], tangents[some], ends])
            rows = np.column_stack([np.repeat(ends, len(nodes) // len(ends), axis=0), nodes])
            term = partial(_far_wave, 7 if self._is_oblique else 5)
            real, imag = self._row_sums(term, rows, positions, 2, shared)
            total += real + 1j * imag
        return total

    def _far_nodes(self, samples: Floats, number: Indices) -> Floats:
        """Return table rows of the far nodes, as seen from samples (q, 3) of edges.

        ``number`` (q,) contains the edge of each sample. A row contains the directions and waves of
        several nodes. The last row of a sample is padded with zeros.
        """
        source = self.nodes.far
        waves = source.waves_and_dipoles(samples)
        away = samples[:, None] - source.positions
        length = np.linalg.norm(away, axis=2)
        if not self.sees.all():
            waves = [wave * self.sees[:, number].T for wave in waves]
        waves = [wave @ source.fractions.T for wave in waves]
        # The obliquity term of (SB5) is the derivative with respect to z of the source, divided by
        # -ik.
        waves[1:] = [wave * (-0.5j / math.pi) / length for wave in waves[1:]]
        count = len(source.positions)
        parts = math.ceil(count / _PER_ROW)
        width = parts * _STEP * math.ceil(count / parts / _STEP)
        nodes = np.zeros((len(samples), width, 3 + 2 * len(waves)))
        nodes[:, :count, :3] = away / length[..., None]
        nodes[:, :count, 3:] = np.stack(waves, axis=2).view(np.float64)
        return nodes.reshape(len(samples) * parts, -1)


def _blocks(count: int, width: int) -> list[Indices]:
    """Divide the indices from 0 to ``count`` - 1 into blocks for arrays of ``width`` columns.

    The blocks limit the size of the arrays.
    """
    return np.array_split(np.arange(count), 1 + count * width // _PAIRS)


def _ends_of_blocks(edges: Floats, count: int) -> list[tuple[Point, Point]]:
    """Return the ends of edges as columns, in blocks that fit in the processor's cache.

    ``count`` is the number of points per edge.
    """
    blocks = np.array_split(edges, 1 + len(edges) * count // _CACHED)
    return [
        (tuple(block[:, 0].T[:, :, None]), tuple(block[:, 1].T[:, :, None]))
        for block in blocks
        if len(block)
    ]


def _sample_counts(edges: Floats, nodes: Interpolation, positions: Floats, error: float) -> Indices:
    """Return the number of samples (m,) that each edge needs for waves at positions (n, 3).

    ``error`` is the allowed relative error.
    """
    source, at, ops = nodes.far, tuple(positions.T), _OPS
    radius = 0.5 * float(np.linalg.norm(np.ptp(source.origins, axis=0)))
    digits, centre, numbers = -math.log(error), tuple(source.centre), []
    for start, end in _ends_of_blocks(edges, len(positions)):
        along = difference(end, start)
        length = ops.sqrt(dot(along, along))
        slopes = [abs(_slope(along, p, centre) + _slope(along, p, at)) for p in (start, end)]
        distance = ops.maximum(_distance(ops, start, end, centre), 1e-9)
        phase = math.pi * (ops.maximum(*slopes) + 2.0 * radius * length / distance)
        # ``lateral`` is the distance between the edge and the line from the source to the point,
        # measured at the edge.
        away = ops.maximum(_distance(ops, start, end, at), _CLOSE)
        part = away / (distance + away)
        lateral = ops.sqrt(2.0 * nodes.detour * distance * part) - radius * part
        clear = ops.minimum(ops.minimum(lateral, away), distance) / (0.5 * length)
        needed, _ = nodes_needed(ops, digits, clear.min(axis=1), phase.max(axis=1))
        numbers.append(np.maximum(np.ceil(needed), 2.0))
    return np.concatenate(numbers).astype(np.intp)


def _slope(along: Point, end: Point, point: Point) -> Number:
    """Return the edge length times the derivative, along the edge, of the distance from a point.

    ``along`` is the vector of the edge, and ``end`` is the end of the edge at which the derivative
    is taken.
    """
    away = difference(end, point)
    return dot(along, away) / _OPS.maximum(_OPS.sqrt(dot(away, away)), 1e-9)


def _distance(ops: Any, start: Point, end: Point, point: Point) -> Number:
    """Return the distance between a point and an edge."""
    along, away = difference(end, start), difference(point, start)
    foot = ops.maximum(ops.minimum(dot(along, away) / dot(along, along), 1.0), 0.0)
    across = tuple(b - foot * a for a, b in zip(along, away, strict=True))
    return ops.sqrt(dot(across, across))


def _near_weight(
    ops: Any, least: Number, source: Point, start: Point, end: Point, point: Point
) -> Number:
    """Return the weight of an edge in the sum over near edges, from 0 to 1.

    ``least`` is the smallest detour of far edges.
    """
    detour, *_ = path_over(ops, source, point, start, end)
    ratio = ops.minimum(detour / least, _distance(ops, start, end, point) / _CLOSE)
    part = ops.maximum(ops.minimum((_OVERLAP - ratio) / (_OVERLAP - 1.0), 1.0), 0.0)
    return part * part * (3.0 - 2.0 * part)


def _change(rule: EdgeRule, ops: Any, _: Point, sample: Point, shared: Point) -> Values:
    """Return the real and imaginary part of the change of a node's wave by an edge.

    ``sample`` contains the node, the ends of the edge, the point and the displaced point.
    ``sample`` also contains the wave of the node at the point and, if it is not zero, the dipole of
    the node.
    """
    origin, start, end, point, aside = (sample[k : k + 3] for k in (0, 3, 6, 9, 12))
    dipole = Pair(*sample[17:19]) if len(sample) > 17 else None
    path = origin, point, start, end, aside
    change = edge_change(ops, rule, Pair(*sample[15:17]), dipole, *path)[0]
    return change.real, change.imag


def _edge_angle(ops: Any, row: Point, sample: Point, shared: Point) -> Values:
    """Return the angle in rad that an edge spans about the line from a node to a point.

    ``row`` contains the ends of the edge, ``sample`` the point, and ``shared`` the node.
    """
    return (angle_about(ops, shared, sample, row[:3], row[3:6]),)


def _far_wave(width: int, ops: Any, row: Point, point: Point, shared: Point) -> Values:
    """Return the wave of one edge sample, summed over several nodes (SB8).

    The results are the real and the imaginary part of the wave. ``width`` is the number of values
    for each node: its direction, its wave, and optionally its dipole. ``shared`` contains the
    smallest detour of far edges, and the centre of the source.
    """
    at, tangent, start, end = (row[k : k + 3] for k in (0, 3, 6, 9))
    part = 1.0 - _near_weight(ops, shared[0], shared[1:4], start, end, point)
    path = difference(point, at)
    distance = ops.sqrt(dot(path, path))
    inverse = 1.0 / ops.maximum(distance, 1e-9)
    ray = tuple(p * inverse for p in path)
    normal = cross(tangent, ray)
    real, imag = 0.0, 0.0
    for k in range(12, len(row), width):
        away = row[k : k + 3]
        below = 1.0 / ops.maximum(1.0 - dot(away, ray), 1e-14)
        factor = dot(away, normal) * below
        real, imag = real + factor * row[k + 3], imag + factor * row[k + 4]
        if width > 5:  # derivative with respect to the source's z (SB5)
            rate = (normal[2] - factor * (away[2] - ray[2])) * below
            real, imag = real + rate * row[k + 5], imag + rate * row[k + 6]
    wave = unit_wave(ops, distance).scaled(inverse * part) * Pair(real, imag)
    return wave.real, wave.imag
