"""Shadows that diffract: the field of a source behind opaque bodies and plates. Source: (SB1).

The source is a grid of points that radiate as it does from some wavelengths on (B8). Behind bodies
the wave of each point is cut off where it is hidden, and the boundary waves (SB3) of the edges of
the silhouette that it sees are added (Maggi and Rubinowicz): the sum is smooth across the boundary
of the shadow. Waves over two edges, and those that creep around a body, are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import NumpyOperations
from polywigner.execution.choice import resolved
from polywigner.geometry.arguments import checked_number, warn_caller
from polywigner.geometry.silhouettes import Obstacles, Silhouette
from polywigner.kernels.boundary.edge_waves import (
    EdgeRule,
    Point,
    angle_about,
    edge_wave,
    edge_wave_and_rate,
)
from polywigner.numerics.complex_pairs import Pair
from polywigner.propagation.blockers import (
    NO_SURFACE,
    OWN_SURFACE,
    Blocker,
    behind_face,
    blocked_edges,
    shadow_lines,
)
from polywigner.propagation.equivalent_points import (
    RadiatingPoint,
    oblique_change,
    radiating_points,
    wave_ahead,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

DEFAULT_TOLERANCE = 1e-6
"""Relative error of fields behind obstacles: far below the error of black edges, one at a time."""
LEAST_TOLERANCE = 1e-8
"""The smallest tolerance of fields behind obstacles."""

# From a tolerance on, nodes of an edge, and coarser ones whose difference is the estimated error.
# Measured before 40,000 edges at random, half near shadows' boundaries, the largest errors were
# 1.5e-6 and 2e-5, 5e-9 and 3e-7, 4e-10 and 2e-7 of the wave.
_RULES = (
    (1e-4, EdgeRule.of(1.0, 12, 5), EdgeRule.of(1.0, 10, 4)),
    (1e-6, EdgeRule.of(2.0, 24, 5), EdgeRule.of(2.0, 20, 5)),
    (0.0, EdgeRule.of(4.0, 40, 5), EdgeRule.of(4.0, 32, 4)),
)
# Share of the tolerance that points in place of the source may take.
_OF_GRID = 0.1
# Direction from a point to the place beside it where light and shadow are told apart.
ASIDE = np.array([0.57, 0.31, 0.76])
# Lengths that count as none: a fraction of the extent of edges and points, and one of distances
# from the source, fifty times their rounding.
_FINE, _ROUNDED = 1e-9, 1e-14
# Points this close to a surface are on its illuminated side, in lengths that count as none.
_ON_SURFACE = 4.0
# Pairs of an edge and a sample below which NumPy is faster than the start of a compiled loop.
_FEW = 10_000
# Distance of a place from the line through the source and a corner, over the root of its distance
# from the source, in wavelengths: below the first number derivatives lose digits, at the second
# they do not. Lines at an angle whose cosine is below one less the third are not looked at.
_CORNER, _BESIDE, _ALIGNED = 1e-5, 1e-4, 1e-8
# Nearer to the source than this, in wavelengths, its waves that fade are not left out unseen.
_NEAR = 1.0


def checked_shadow_tolerance(tolerance: float | None) -> float:
    """A tolerance that fields behind obstacles keep; ArgumentError for others."""
    if tolerance is None:
        return DEFAULT_TOLERANCE
    meaning = f"a number from {LEAST_TOLERANCE:g} to 0.1 with obstacles"
    number = checked_number(tolerance, "tolerance", meaning)
    if not LEAST_TOLERANCE <= number <= 0.1:
        raise ArgumentError(f"expected tolerance as {meaning}, got {tolerance!r}")
    return number


def shadow_of(
    source: Any,
    bodies: Obstacles,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str,
    with_error: bool = False,
) -> tuple[Complex, NDArray[np.bool_], Floats]:
    """Return the change that obstacles make to the field at points (n, 3), in m, of a source.

    ``bodies`` in wavelengths. Also whether a point is in a body, where the field is zero, and the
    estimated error (n,); zeros unless ``with_error``. ``source``: whatever :func:`equivalent_grid`
    takes, or a PointSource.

    Raises ArgumentError for obstacles around the source, and sources that take too many points.
    """
    places = points / wavelength
    sources, seen = _seen(source, bodies, places, wavelength, method, tolerance)
    change, free, off = diffracted(bodies, sources, seen, places, engine, with_error, tolerance)
    if with_error and len(sources) > 1:
        off += _OF_GRID * tolerance * np.abs(free).max(initial=0.0)
    return change, bodies.inside(places), off


def diffracted(
    bodies: Obstacles,
    sources: Sequence[RadiatingPoint],
    seen: Sequence[Silhouette],
    places: Floats,
    engine: str,
    with_error: bool = False,
    tolerance: float = DEFAULT_TOLERANCE,
) -> tuple[Complex, Complex, Floats]:
    """Change by bodies, free field, and error at places (n, 3) of points with their silhouettes."""
    rule, coarser = next(rules for least, *rules in _RULES if tolerance >= least)
    shadow = _Shadow.of(bodies, sources, seen, places)
    change, free, off = shadow.summed(engine, rule, coarser if with_error else None)
    near, across = _near_corners(sources, seen, places)
    if near.any():
        # the mean over places on a line, an error of the fourth order in their distance
        change[near] = 0.0
        for number, share in ((1, 4 / 6), (-1, 4 / 6), (2, -1 / 6), (-2, -1 / 6)):
            beside = places[near] + number * across
            change[near] += (
                share * _Shadow.of(bodies, sources, seen, beside).summed(engine, rule)[0]
            )
    return change, free, off


def _near_corners(
    sources: Sequence[RadiatingPoint], seen: Sequence[Silhouette], places: Floats
) -> tuple[NDArray[np.bool_], Floats]:
    """Whether places (n, 3) are on a line through a point of the source and a corner.

    There the derivatives (SB5) of the two edges grow without bound, and their sum loses its digits.
    Also displacements (k, 3) across the line of these places, over which the field is smooth.
    """
    near = np.zeros(len(places), bool)
    for point, silhouette in zip(sources, seen, strict=True):
        if not point.field:
            continue
        corners = silhouette.edges.reshape(-1, 3) - point.place
        corners /= np.linalg.norm(corners, axis=1)[:, None]
        axes = places - point.place
        distance = np.linalg.norm(axes, axis=1)
        rows, columns = np.nonzero(axes @ corners.T > (1.0 - _ALIGNED) * distance[:, None])
        aside = np.linalg.norm(np.cross(axes[rows], corners[columns]), axis=1)
        near[rows[aside < _CORNER * np.sqrt(distance[rows])]] = True
    axes = places[near] - np.mean([place for place, *_ in sources], axis=0)
    across = np.cross(axes, ASIDE)
    length = np.linalg.norm(across, axis=1) / np.sqrt(np.linalg.norm(axes, axis=1))
    return near, _BESIDE * across / np.maximum(length, 1e-300)[:, None]


def _seen(
    source: Any, bodies: Obstacles, places: Floats, wavelength: float, method: str, tolerance: float
) -> tuple[list[RadiatingPoint], list[Silhouette]]:
    """Points in place of a source, as bodies and places need them, and their silhouettes."""
    boxes = [np.stack([b.vertices.min(axis=0), b.vertices.max(axis=0)]) for b in bodies.bodies]
    targets = np.concatenate([np.stack(boxes), np.stack([places, places], axis=1)])
    error = _OF_GRID * tolerance
    sources = radiating_points(source, wavelength, method, error, targets=targets)
    _check_clearance(bodies, sources)
    return sources, bodies.silhouettes([place for place, *_ in sources])


class _Edges(NamedTuple):
    """Edges of silhouettes, with one surface behind them or with none."""

    table: Floats
    """(k, 17) point of the source, ends, and plane of the face behind; for each such point."""
    blocker: Blocker | None


class _Shadow(NamedTuple):
    """Obstacles as the points of a source see them, and points that may be in their shadow."""

    bodies: Obstacles
    sources: Sequence[RadiatingPoint]
    edges: list[_Edges]
    samples: Floats
    """(n, 7): points, places aside, and 1 where the angles of edges tell light from shadow."""
    resolution: Floats
    """(n,) lengths that count as none."""

    @classmethod
    def of(
        cls,
        bodies: Obstacles,
        sources: Sequence[RadiatingPoint],
        seen: Sequence[Silhouette],
        places: Floats,
    ) -> _Shadow:
        """Silhouettes that points see, for places (n, 3) in wavelengths."""
        found = blocked_edges(bodies, seen, np.mean([place for place, *_ in sources], axis=0))
        group = np.concatenate(found.groups)
        # beyond all bodies the angles of all edges tell what is lit; else rays do
        if found.blockers or not all(silhouette.is_closed for silhouette in seen):
            by_angles = np.zeros(len(places), bool)
        else:
            by_angles = np.all([bodies.beyond(place, places) for place, *_ in sources], axis=0)
        table = np.concatenate(
            [
                np.column_stack(
                    [np.tile(point.row, (len(s.edges), 1)), s.edges.reshape(-1, 6), s.planes]
                )
                for point, s in zip(sources, seen, strict=True)
            ]
        )
        resolution = _resolution(table[:, 7:13].reshape(-1, 3), table[:, :3], places)
        aside = places + resolution[:, None] * ASIDE
        edges = []
        for number, blocker in enumerate(found.blockers):
            rows = table[group == number]
            planes = np.unique(rows[:, 13:], axis=0)
            heights = places @ planes[:, :3].T + planes[:, 3]
            if (heights < -_ON_SURFACE * resolution[:, None]).any():
                edges.append(_Edges(rows, blocker))
            else:  # nothing is behind the surface
                group[group == number] = NO_SURFACE
        lines = shadow_lines(table[group == OWN_SURFACE])
        edges.append(_Edges(np.concatenate([table[group < 0], lines]), None))
        return cls(bodies, sources, edges, np.column_stack([places, aside, by_angles]), resolution)

    def summed(
        self, engine: str, rule: EdgeRule, coarser: EdgeRule | None = None
    ) -> tuple[Complex, Complex, Floats]:
        """Change of the field, free field, and error (0 without a coarser rule) at samples (n,)."""
        is_oblique = any(point.field for point in self.sources)
        count = len(self.samples)
        change, free = np.zeros((2, count), np.complex128)
        error = np.zeros(count)
        # "auto" is planned for the edges of all groups together
        chosen = resolved(engine, count, sum(len(edges.table) for edges in self.edges))
        for edges in self.edges:
            is_small = engine == "auto" and len(edges.table) * count < _FEW
            real, imag, off = execution.evaluate_rows(
                partial(_edge, rule, coarser, is_oblique, edges.blocker is not None),
                edges.table,
                self._samples_of(edges),
                np.zeros(1),
                3,
                "numpy" if is_small else chosen,
            )
            change, error = change + real + 1j * imag, error + off
        for point in self.sources:
            wave = point.wave(self.samples[:, :3].T)
            change -= np.where(self.hidden(point), wave, 0.0)
            free += wave
        return change, free, error

    def hidden(self, point: RadiatingPoint) -> NDArray[np.bool_]:
        """Samples that rays from a point of the source do not reach, where rays are asked."""
        found, by_rays = np.zeros(len(self.samples), bool), self.samples[:, 6] == 0.0
        within = _ON_SURFACE * self.resolution[by_rays]
        found[by_rays] = self.bodies.hide(point.place, self.samples[by_rays, 3:6], within)
        return found

    def _samples_of(self, edges: _Edges) -> Floats:
        """Samples for some edges: (n, 7); of blocked edges (n, 10).

        The added columns are the resolution, and the real and imaginary part of the amplitude of
        edge waves behind the blocker.
        """
        if edges.blocker is None:
            return self.samples
        hidden = edges.blocker.hides(self.samples[:, 3:6], _ON_SURFACE * self.resolution)
        point = tuple(self.samples[:, :3].T)
        found = edges.blocker.transmission(NumpyOperations(double=True), point, hidden)
        parts = (np.broadcast_to(part, len(hidden)) for part in (found.real, found.imag))
        return np.column_stack([self.samples, self.resolution, *parts])


def _resolution(ends: Floats, sources: Floats, points: Floats) -> Floats:
    """Lengths (n,) far above rounding at points (n, 3), and far below all that matters there.

    ``ends``: (m, 3) of edges; ``sources``: (k, 3).
    """
    if not len(ends):
        return np.zeros(len(points))
    low, high = ends.min(axis=0), ends.max(axis=0)
    radius = 0.5 * float(np.linalg.norm(high - low))
    away = np.linalg.norm(points - sources.mean(axis=0), axis=1)
    local = np.minimum(np.linalg.norm(points - 0.5 * (low + high), axis=1) + radius, away)
    largest = max(float(np.abs(part).max()) for part in (ends, sources))
    return _FINE * local + _ROUNDED * (away + largest)


def _edge(
    rule: EdgeRule,
    coarser: EdgeRule | None,
    is_oblique: bool,
    is_blocked: bool,
    ops: Any,
    row: Point,
    sample: Point,
    _: Point,
) -> Any:
    """Change of the field by an edge that a point of the source sees; and its error.

    ``is_oblique``: whether the point has a weight of the field, whose edge waves (SB5) depend on
    the direction from the point to the edge; ``is_blocked``: whether a surface is behind the edge.
    """
    source, field, slope, start, end = row[:3], row[3:5], row[5:7], row[7:10], row[10:13]
    point, aside, by_angles = sample[:3], sample[3:6], sample[6]
    blocked = None
    if is_blocked:
        margin = _ON_SURFACE * sample[7]
        blocked = behind_face(ops, source, start, end, row[13:17], point, margin)
    path = source, point, start, end, aside
    ahead = tuple(a - b for a, b in zip(point, source, strict=True))
    bend = Pair(0.0, 0.0)
    if is_oblique:
        boundary, rate = edge_wave_and_rate(ops, rule, *path, blocked=blocked)
        bend = oblique_change(ops, ahead, field, rate)
    else:
        boundary = Pair(*edge_wave(ops, rule, *path, blocked=blocked))
    off = 0.0 * boundary.real
    wave = wave_ahead(ops, ahead, field, slope)
    if coarser is not None:
        other = boundary - Pair(*edge_wave(ops, coarser, *path, blocked=blocked))
        off = ops.sqrt(wave.norm() * other.norm()) / (2.0 * math.pi)
    change = (wave * boundary).scaled(-0.5 / math.pi) + bend
    if is_blocked:
        change = change * Pair(*sample[8:10])
        return change.real, change.imag, off
    angle = wave.scaled(by_angles * angle_about(ops, source, aside, start, end) / (2.0 * math.pi))
    return angle.real + change.real, angle.imag + change.imag, off


def _check_clearance(bodies: Obstacles, sources: Sequence[RadiatingPoint]) -> None:
    places = np.array([place for place, *_ in sources])
    if bodies.inside(places).any():
        raise ArgumentError("expected obstacles away from the source, got a body around it")
    nearest = min(float(body.distance(places).min()) for body in bodies.bodies)
    if nearest < _NEAR and len(sources) > 1:
        warn_caller(
            f"an obstacle is {nearest:.2g} wavelengths from the source: waves that fade within a "
            "wavelength are left out of its shadow"
        )
