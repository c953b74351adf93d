"""Shadows with diffraction: the field of a source behind opaque bodies and plates. Source: (SB1).

The source is replaced by a grid of points with the same field beyond a few wavelengths (B8). The
wave of each point is zero in the geometric shadow of the bodies. The boundary waves (SB3) of the
edges of the silhouette are added (Maggi and Rubinowicz), so the field is smooth across the boundary
of the shadow. Waves over two edges and creeping waves are neglected.

A surface behind an edge blocks the wave of the edge (SB6). Behind that surface, the wave of the
edge is the wave around a single edge, as seen from the midpoint of the first edge. The shortest
detour over the rim of the surface determines its amplitude and phase.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution import NumpyOperations
from polywigner.execution.choice import resolved
from polywigner.geometry.arguments import warn_caller
from polywigner.geometry.contours import Surface, net_contours
from polywigner.geometry.parts import connected
from polywigner.geometry.silhouettes import Obstacles, Silhouette, hits
from polywigner.kernels.boundary.edge_waves import (
    EdgeRule,
    Point,
    angle_about,
    cross,
    difference,
    dot,
    edge_wave,
    edge_wave_and_rate,
    path_over,
)
from polywigner.kernels.kernel import Values
from polywigner.numerics.phases import Pair, unit_wave
from polywigner.propagation.conducting_sheets import (
    Edge,
    change_by_sheet,
    check_source,
    flattened,
    mean_of_neighbours,
)
from polywigner.propagation.edge_sums import EdgeSum, Targets
from polywigner.propagation.equivalent_points import (
    RadiatingPoint,
    oblique_change,
    radiating_points,
    wave_ahead,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]
Number = TypeVar("Number")
"""A float, or an array of NumPy or Dr.Jit."""

DEFAULT_TOLERANCE = 1e-6
"""Default relative error of fields behind obstacles, far below the black-edge model's error."""
LEAST_TOLERANCE = 1e-8
"""The smallest tolerance of fields behind obstacles."""

# Smallest tolerance, quadrature rule on an edge, and coarser rule for the error estimate. For
# 40,000 random edges, half of the points close to shadow boundaries, the largest errors of both
# rules as a fraction of the wave were 1.5e-6 and 2e-5, 5e-9 and 3e-7, and 4e-10 and 2e-7.
_RULES = (
    (1e-4, EdgeRule.of(1.0, 12, 5), EdgeRule.of(1.0, 10, 4)),
    (1e-6, EdgeRule.of(2.0, 24, 5), EdgeRule.of(2.0, 20, 5)),
    (0.0, EdgeRule.of(4.0, 40, 5), EdgeRule.of(4.0, 32, 4)),
)
# Allowed error of the points that represent the source, as a fraction of the tolerance.
_OF_GRID = 0.1
# Error of nodes that replace these points, as a fraction of the tolerance.
_OF_NODES = 0.15
# Direction from a point to the neighbouring point at which it is decided whether the point is
# illuminated or in shadow.
ASIDE = np.array([0.57, 0.31, 0.76])
# Lengths are negligible below these fractions of the extent of all edges and points, and of the
# distances from the source. They are fifty times the rounding errors.
_FINE, _ROUNDED = 1e-9, 1e-14
# A point this close to a surface, as a multiple of the negligible length, is on the illuminated
# side of the surface.
_ON_SURFACE = 4.0
# Number of pairs of an edge and a sample below which NumPy is faster than compiled code, because of
# the time to start the code.
_FEW = 10_000
# Distance of a point from the line through the source and a corner, divided by the square root of
# its distance from the source, in wavelengths. Below the first number, derivatives of the edge
# waves lose digits; at the second number, they do not. The third number limits the search to
# directions close to a corner.
_CORNER, _BESIDE, _ALIGNED = 1e-5, 1e-4, 1e-8
# Distance from the source in wavelengths below which a warning reports that evanescent waves are
# neglected.
_NEAR = 1.0


def shadow_of(
    source: Any,
    bodies: Obstacles,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str,
    with_error: bool = False,
    edge: Edge = "black",
) -> tuple[Complex, NDArray[np.bool_], Floats]:
    """Return the change of the field at points (n, 3) in m that obstacles cause.

    Also return a mask of the points inside a body, where the field is zero, and the estimated
    errors (n,), which are zero unless ``with_error``. ``bodies`` are in wavelengths, and
    plates in one plane if the edge is not "black". ``source`` is a source that
    :func:`equivalent_grid` accepts, or a PointSource.

    Raises ArgumentError for obstacles around the source, and for sources that need too many points.
    """
    positions = points / wavelength
    if edge != "black":
        bodies = flattened(bodies)
    sources, seen = _seen(source, bodies, positions, wavelength, method, tolerance)
    origins = np.array([position for position, *_ in sources])
    if edge != "black":
        check_source(bodies, origins)
    _check_clearance(bodies, sources)
    compute: Any = partial(
        diffracted, bodies, sources, engine=engine, with_error=with_error, tolerance=tolerance
    )
    if edge == "black":
        change, free, off = compute(seen, positions)
    else:
        compute = partial(compute, is_sheet=True)
        least = 2.0 * _ON_SURFACE * _resolution(bodies.vertices, origins, positions)
        change, free, off = change_by_sheet(compute, edge, bodies, sources, positions, least)
    if with_error and len(sources) > 1:
        off += _OF_GRID * tolerance * np.abs(free).max(initial=0.0)
    return change, bodies.inside(positions), off


def diffracted(
    bodies: Obstacles,
    sources: Sequence[RadiatingPoint],
    seen: Sequence[Silhouette],
    positions: Floats,
    engine: str,
    with_error: bool = False,
    tolerance: float = DEFAULT_TOLERANCE,
    is_sheet: bool = False,
) -> tuple[Complex, Complex, Floats]:
    """Return the change by bodies, the free field and the error at positions in wavelengths.

    With ``is_sheet``, the edges belong to a conducting sheet. Its plane is the plane in ``seen``,
    with the normal towards the source.
    """
    rule, coarser = next(rules for least, *rules in _RULES if tolerance >= least)
    edges = _Edges.of(bodies, sources, seen, positions)
    opaque = bodies
    if len(seen) > 1 and all(silhouette is seen[0] for silhouette in seen):
        centre = np.mean([point.position for point in sources], axis=0)
        opaque = Obstacles([body.spanned(centre) for body in bodies.bodies])
    few = None
    if not (edges.are_blocked or is_sheet):
        few = EdgeSum.of(opaque, sources, seen, positions, _OF_NODES * tolerance, engine)
    summed = partial(_summed, opaque, sources, engine=engine, rule=rule, few=few, is_sheet=is_sheet)
    change, free, off = summed(edges, coarser=coarser if with_error else None)
    views = [(p.position, s.edges) for p, s in zip(sources, seen, strict=True) if p.field]
    if views and few is not None:
        views = few.views
    near, across = _near_corners(views, positions)
    if near.any():
        change[near], *_ = mean_of_neighbours(
            lambda beside: summed(_Edges.of(bodies, sources, seen, beside)), positions[near], across
        )
    return change, free, off


def _near_corners(
    views: Sequence[tuple[Floats, Floats]], positions: Floats
) -> tuple[NDArray[np.bool_], Floats]:
    """Return a mask of points (n, 3) on a line through a point of the source and a corner.

    ``views``: points (3,) of the source, and the edges (m, 2, 3) that they see. On these lines the
    derivatives (SB5) of the waves of two edges diverge, and their sum loses its digits. Also return
    displacements (k, 3) across the line, over which the field is smooth.
    """
    near = np.zeros(len(positions), bool)
    for origin, edges in views:
        corners = np.unique(edges.reshape(-1, 3), axis=0) - origin
        corners /= np.linalg.norm(corners, axis=1)[:, None]
        axes = positions - origin
        distance = np.linalg.norm(axes, axis=1)
        rows, columns = np.nonzero(axes @ corners.T > (1.0 - _ALIGNED) * distance[:, None])
        aside = np.linalg.norm(np.cross(axes[rows], corners[columns]), axis=1)
        near[rows[aside < _CORNER * np.sqrt(distance[rows])]] = True
    if not near.any():
        return near, np.empty((0, 3))
    axes = positions[near] - np.mean([origin for origin, _ in views], axis=0)
    across = np.cross(axes, ASIDE)
    length = np.linalg.norm(across, axis=1) / np.sqrt(np.linalg.norm(axes, axis=1))
    return near, _BESIDE * across / np.maximum(length, 1e-300)[:, None]


def _seen(
    source: Any,
    bodies: Obstacles,
    positions: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
) -> tuple[list[RadiatingPoint], list[Silhouette]]:
    """Return the points that represent a source, and their silhouettes of the bodies."""
    boxes = [np.stack([b.vertices.min(axis=0), b.vertices.max(axis=0)]) for b in bodies.bodies]
    targets = np.concatenate([np.stack(boxes), np.stack([positions, positions], axis=1)])
    error = _OF_GRID * tolerance
    sources = radiating_points(source, wavelength, method, error, targets=targets)
    return sources, bodies.silhouettes([position for position, *_ in sources])


@dataclass(frozen=True)
class _Edges:
    """Edges that the points of a source see, and the points where their waves are computed."""

    groups: list[tuple[Floats, Blocker | None]]
    """Rows (k, 17) of edges by the surface behind them: point of the source, seven numbers; ends;
    and plane of the face behind."""
    targets: Targets
    are_blocked: bool
    """Whether a surface blocks waves of edges, or edges have shadow lines."""

    @property
    def count(self) -> int:
        return sum(len(rows) for rows, _ in self.groups)

    @classmethod
    def of(
        cls,
        bodies: Obstacles,
        sources: Sequence[RadiatingPoint],
        seen: Sequence[Silhouette],
        positions: Floats,
    ) -> _Edges:
        """Return the edges of the silhouettes, for fields at positions (n, 3)."""
        centre = np.mean([point.position for point in sources], axis=0)
        blocked = blocked_edges(bodies, seen, centre)
        group = np.concatenate(blocked.groups)
        table = np.concatenate(
            [
                np.column_stack(
                    [np.tile(p.row, (len(s.edges), 1)), s.edges.reshape(-1, 6), s.planes]
                )
                for p, s in zip(sources, seen, strict=True)
            ]
        )
        resolution = _resolution(table[:, 7:13].reshape(-1, 3), table[:, :3], positions)
        margin = _ON_SURFACE * resolution
        groups: list[tuple[Floats, Blocker | None]] = []
        for number, blocker in enumerate(blocked.blockers):
            rows = table[group == number]
            planes = np.unique(rows[:, 13:], axis=0)
            heights = positions @ planes[:, :3].T + planes[:, 3]
            if (heights < -margin[:, None]).any():
                groups.append((rows, blocker))
            else:  # nothing is behind the surface
                group[group == number] = NO_SURFACE
        lines = shadow_lines(table[group == OWN_SURFACE])
        are_blocked = bool(groups) or len(lines) > 0
        groups.append((np.concatenate([table[group < 0], lines]), None))
        # Illumination is decided from the angles of the edges for points beyond all bodies, and by
        # tracing rays for other points.
        by_angles = np.zeros(len(positions), bool)
        if not blocked.blockers and all(silhouette.is_closed for silhouette in seen):
            by_angles = np.all([bodies.beyond(p.position, positions) for p in sources], axis=0)
        aside = positions + resolution[:, None] * ASIDE
        return cls(groups, Targets(positions, aside, margin, by_angles), are_blocked)


def _summed(
    bodies: Obstacles,
    sources: Sequence[RadiatingPoint],
    edges: _Edges,
    engine: str,
    rule: EdgeRule,
    few: EdgeSum | None,
    coarser: EdgeRule | None = None,
    is_sheet: bool = False,
) -> tuple[Complex, Complex, Floats]:
    """Return the change of the field, the free field, and the error (0 without a coarser rule)."""
    if few is not None:
        change, free = few.change(edges.targets, rule)
        error = few.error * np.abs(free).max() if coarser is not None else 0.0
        return change, free, np.full(len(change), error)
    positions, aside, margin, by_angles = edges.targets
    count = len(positions)
    samples = np.column_stack([positions, aside, by_angles])
    change, free, error = *np.zeros((2, count), np.complex128), np.zeros(count)
    # The engine is chosen from the number of edges of all groups together.
    chosen = resolved(engine, count, edges.count)
    is_oblique = any(point.field for point in sources)
    for rows, surface in edges.groups:
        columns = samples
        if surface is not None:
            hidden = surface.hides(aside, margin)
            passed = surface.transmission(NumpyOperations(), tuple(positions.T), hidden)
            parts = (np.broadcast_to(part, count) for part in (passed.real, passed.imag))
            columns = np.column_stack([samples, margin, *parts])
        real, imag, off = execution.evaluate_rows(
            partial(_edge, rule, coarser, is_oblique, surface is not None, is_sheet),
            rows,
            columns,
            np.zeros(1),
            3,
            "numpy" if engine == "auto" and len(rows) * count < _FEW else chosen,
        )
        change, error = change + real + 1j * imag, error + off
    for point in sources:
        wave, hidden = point.wave(positions.T), np.zeros(count, bool)
        hidden[~by_angles] = bodies.hide(point.position, aside[~by_angles], margin[~by_angles])
        change -= np.where(hidden, wave, 0.0)
        free += wave
    return change, free, error


def _resolution(ends: Floats, sources: Floats, points: Floats) -> Floats:
    """Return lengths (n,) that are negligible at points (n, 3), far above rounding errors.

    ``ends`` (m, 3) are ends of edges, and ``sources`` (k, 3) are positions.
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
    is_sheet: bool,
    ops: Any,
    row: Point,
    sample: Point,
    _: Point,
) -> Values:
    """Return the change of the field by one edge for one point of the source, and its error.

    ``sample`` contains a point, its neighbour, and 1 if the angles of edges decide between light
    and shadow. For blocked edges it also contains the depth up to which points lie on a surface,
    and the real and imaginary part of the amplitude of edge waves behind the blocker.
    ``is_oblique``: whether the point of the source has a weight of the field, whose edge waves
    (SB5) depend on the direction from the point to the edge. ``is_blocked``: whether a surface is
    behind the edge. ``is_sheet``: whether the edge belongs to a conducting sheet in the
    plane of the row.
    """
    source, field, slope, start, end = row[:3], row[3:5], row[5:7], row[7:10], row[10:13]
    point, aside, by_angles = sample[:3], sample[3:6], sample[6]
    blocked = in_front = None
    if is_sheet:
        in_front = ops.select(dot(row[13:16], aside) + row[16] > 0.0, 1.0, 0.0)
    if is_blocked:
        blocked = behind_face(ops, source, start, end, row[13:17], point, sample[7])
    path = source, point, start, end, aside
    sides: dict[str, Any] = {"blocked": blocked, "in_front": in_front}
    ahead = tuple(a - b for a, b in zip(point, source, strict=True))
    bend = Pair(0.0, 0.0)
    if is_oblique:
        boundary, rate = edge_wave_and_rate(ops, rule, *path, **sides)
        bend = oblique_change(ops, ahead, field, rate)
    else:
        boundary = Pair(*edge_wave(ops, rule, *path, **sides))
    off = 0.0 * boundary.real
    wave = wave_ahead(ops, ahead, field, slope)
    if coarser is not None:
        other = boundary - Pair(*edge_wave(ops, coarser, *path, **sides))
        off = ops.sqrt(wave.norm() * other.norm()) / (2.0 * math.pi)
    change = (wave * boundary).scaled(-0.5 / math.pi) + bend
    if is_blocked:
        change = change * Pair(*sample[8:10])
        return change.real, change.imag, off
    angle = wave.scaled(by_angles * angle_about(ops, source, aside, start, end) / (2.0 * math.pi))
    return angle.real + change.real, angle.imag + change.imag, off


def _check_clearance(bodies: Obstacles, sources: Sequence[RadiatingPoint]) -> None:
    positions = np.array([position for position, *_ in sources])
    if bodies.inside(positions).any():
        raise ArgumentError(
            "an obstacle encloses a part of the source; move the obstacle away from the source"
        )
    low, high = positions.min(axis=0) - _NEAR, positions.max(axis=0) + _NEAR
    boxes = [(body, body.vertices.min(axis=0), body.vertices.max(axis=0)) for body in bodies.bodies]
    near = [body for body, least, most in boxes if (least < high).all() and (most > low).all()]
    nearest = min((float(body.distance(positions).min()) for body in near), default=np.inf)
    if nearest < _NEAR and len(sources) > 1:
        warn_caller(
            f"an obstacle is only {nearest:.2g} wavelengths away from the source, so its shadow "
            "is inaccurate: evanescent waves are neglected"
        )


# ---- surfaces behind edges -----------------------------------------------------------------------

# Far from a shadow boundary, the wave around an edge tends to 1/(_STEEP sqrt(detour)) of the free
# wave, with the detour in wavelengths.
_STEEP = 2.0 * math.pi * math.sqrt(2.0)
# Detour in wavelengths at which the wave around a second edge is attenuated to 1/e. Waves over two
# edges are neglected except close to the boundary of the second shadow, where they keep the field
# continuous.
_SECOND = 16.0
# If a body that is not convex has more triangles than this, only its face behind the edge blocks
# the wave of the edge.
_MOST_TRIANGLES = 256


@dataclass(frozen=True)
class Blocker:
    """The surface behind an edge. Lengths are in wavelengths."""

    origin: Floats
    """Midpoint (3,) of the edge."""
    triangles: Floats
    """Triangles (t, 3, 3) of the surface that face the origin."""
    rim: Floats
    """Edges (m, 2, 3) of the surface's silhouette from the origin."""

    def hides(self, points: Floats, within: Floats) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 3) that the surface hides from the origin.

        The surface does not hide points whose distance from its planes is below ``within`` (n,).
        """
        hidden = np.zeros(len(points), bool)
        if len(self.triangles):
            for some, share, height in hits(self.triangles - self.origin, points - self.origin):
                with np.errstate(invalid="ignore"):
                    behind = height * (1.0 / share - 1.0) > within[some, None]
                hidden[some] = behind.any(axis=1)
        return hidden

    def transmission(self, ops: Any, point: Point, hidden: Any) -> Pair:
        """Return the amplitude at a point of the wave from the origin, over the free wave."""
        detour, amplitude = 1e30, 0.0
        for edge in self.rim:
            origin, start, end = (tuple(p) for p in (self.origin, *edge))
            longer, share = transmission_over(ops, origin, point, start, end)
            detour, amplitude = ops.minimum(longer, detour), ops.maximum(share, amplitude)
        if not len(self.rim):
            return Pair(1.0, 0.0)
        wave = unit_wave(ops, detour).scaled(amplitude)
        return Pair(ops.select(hidden, wave.real, 1.0), ops.select(hidden, wave.imag, 0.0))


def transmission_over(ops: Any, source: Point, point: Point, start: Point, end: Point) -> Values:
    """Return the detour of the shortest path over an edge, and the amplitude of its wave."""
    detour, cosine, *_ = path_over(ops, source, point, start, end)
    # Cosine of half the angle by which the path bends, as in Kirchhoff's obliquity.
    share = ops.sqrt(ops.maximum(0.5 + 0.5 * cosine, 0.0)) / (1.0 + _STEEP * ops.sqrt(detour))
    return detour, share * ops.exp(detour * (-1.0 / _SECOND))


def behind_face(
    ops: Any, source: Point, start: Point, end: Point, plane: Point, point: Point, margin: Number
) -> Number:
    """Return the weight d^2/(d^2 + a^2) of an edge's shadow behind a face, 0 in front of the face.

    The point lies at the distance d plus a margin behind the plane of the face, and at the distance
    a from the plane through the source and the edge.
    """
    depth = ops.maximum(-(dot(plane, point) + plane[3]) - margin, 0.0)
    normal = cross(difference(start, source), difference(end, source))
    lateral = dot(normal, difference(point, source))
    square = depth * depth * dot(normal, normal)
    weight: Number = square / ops.maximum(square + lateral * lateral, 1e-30)
    return weight


# Group numbers of edges without a surface behind them, and of edges in front of a surface of the
# same body.
NO_SURFACE, OWN_SURFACE = -1, -2


@dataclass(frozen=True)
class BlockedEdges:
    """Edges of silhouettes, grouped by the surface behind them."""

    blockers: list[Blocker]
    groups: list[Indices]
    """For each silhouette, the number of the blocker of each edge, or NO_SURFACE or OWN_SURFACE."""


def blocked_edges(bodies: Obstacles, seen: Sequence[Silhouette], source: Floats) -> BlockedEdges:
    """Return the blockers of the edges of silhouettes, seen from close to a source position (3,).

    An edge of several silhouettes has a single blocker.
    """
    number, front, behind = (
        np.concatenate([getattr(s, name) for s in seen]) for name in ("numbers", "bodies", "behind")
    )
    ends = np.concatenate([s.edges for s in seen])
    group = np.full(len(number), NO_SURFACE)
    touching = frozenset[tuple[int, int]]().union(*(s.touching for s in seen))
    pairs = np.array(sorted(touching), np.intp).reshape(-1, 2)
    walls = connected(len(bodies.bodies), *pairs.T)
    (rows,) = np.nonzero(behind >= 0)
    body = bodies.body_of_face(behind[rows])
    is_own = (walls[front[rows]] == walls[body]) | bodies.are_one(front[rows], body)
    group[rows[is_own]] = OWN_SURFACE
    rows, body = rows[~is_own], body[~is_own]
    if not len(rows):
        return BlockedEdges([], _split(group, seen))
    # All faces of a convex body form one blocker.
    is_simple = np.array([body.is_simple for body in bodies.bodies])
    keys = np.column_stack([number[rows], np.where(is_simple[body], -1 - body, behind[rows])])
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    which = which.ravel()
    group[rows] = which
    length = np.linalg.norm(ends[rows, 1] - ends[rows, 0], axis=1)
    midpoints = 0.5 * ends[rows].sum(axis=1) * length[:, None]
    sums = [np.bincount(which, midpoints[:, k]) / np.bincount(which, length) for k in range(3)]
    planes = bodies.face_planes(source)
    blockers = []
    for k, origin in zip(first, np.stack(sums, axis=1), strict=True):
        plane = planes[behind[rows[k]]]
        numbers = np.flatnonzero(walls == walls[body[k]])
        flush = np.setdiff1d(bodies.flush_with(body[k], plane, planes), numbers)
        blockers.append(_blocker(bodies, numbers, flush, plane, origin))
    return BlockedEdges(blockers, _split(group, seen))


def shadow_lines(table: Floats) -> Floats:
    """Return rows (k, 17) of the shadow lines that edges cast on faces, in the opposite direction.

    Each row of ``table`` contains seven numbers of a point of the source, the ends of an edge, and
    the plane of the face behind the edge.
    """
    source, plane = table[:, None, :3], table[:, None, 13:]
    ends = table[:, 7:13].reshape(-1, 2, 3)[:, ::-1] - source
    height = (plane[..., :3] * source).sum(axis=2) + plane[..., 3]
    share = -height / (plane[..., :3] * ends).sum(axis=2)
    ends = source + share[..., None] * ends
    return np.column_stack([table[:, :7], ends.reshape(-1, 6), table[:, 13:]])


def _split(group: Indices, seen: Sequence[Silhouette]) -> list[Indices]:
    return np.split(group, np.cumsum([len(s.numbers) for s in seen])[:-1])


def _blocker(
    bodies: Obstacles, numbers: Indices, flush: Indices, plane: Floats, origin: Floats
) -> Blocker:
    """Return the surface of some bodies behind a plane, seen from the midpoint of an edge.

    ``flush`` are other bodies in contact with these bodies, which continue the plane. Slits between
    them are closed.
    """
    if len(flush):
        nearer = plane - [0.0, 0.0, 0.0, bodies.contact]
        both = np.concatenate([numbers, flush]).tolist()
        surface = _in_plane(bodies.surface(both, origin, nearer), plane, 2.0 * bodies.contact)
        rim = net_contours(surface, origin, bodies.contact).edges
        return Blocker(origin, surface.corners, rim)
    surface = bodies.surface(numbers.tolist(), origin, plane)
    if len(numbers) == 1 and bodies.bodies[numbers[0]].is_simple:
        body = bodies.bodies[numbers[0]]
        return Blocker(origin, surface.corners, body.vertices[body.silhouette(origin)])
    if len(surface.faces) > _MOST_TRIANGLES:
        extent = float(np.ptp(surface.corners.reshape(-1, 3), axis=0).max())
        surface = _in_plane(surface, plane, 1e-9 * extent)
    return Blocker(origin, surface.corners, net_contours(surface, origin).edges)


def _in_plane(surface: Surface, plane: Floats, within: float) -> Surface:
    height = np.abs(surface.corners @ plane[:3] + plane[3]).max(axis=1)
    return surface.subset(height <= within)
