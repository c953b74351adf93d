"""Fields of sources behind opaque bodies and plates, with diffraction at their edges.

The source is replaced by an equivalent grid of points (B8). The wave of each point is zero in the
geometric shadow. The boundary diffraction waves (SB3) of the silhouette's edges (Maggi and
Rubinowicz) make the field continuous (SB1). Surfaces behind an edge block its wave (SB6). Double
diffraction and creeping waves are neglected.
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
    edge_change,
    edge_wave,
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
    radiating_points,
    spherical_wave,
    wave_ahead,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]
Number = TypeVar("Number")

DEFAULT_TOLERANCE = 1e-6
"""Default relative error behind obstacles, far below the error of the black-edge model."""
LEAST_TOLERANCE = 1e-8

# Each row contains the smallest tolerance, the quadrature rule, and a coarser rule for the error
# estimate. The largest relative errors of the two rules on 40,000 random edges are 1.5e-6 and 2e-5
# for the first row, 5e-9 and 3e-7 for the second, and 4e-10 and 2e-7 for the third.
_RULES = (
    (1e-4, EdgeRule.of(1.0, 12, 5), EdgeRule.of(1.0, 10, 4)),
    (1e-6, EdgeRule.of(2.0, 24, 5), EdgeRule.of(2.0, 20, 5)),
    (0.0, EdgeRule.of(4.0, 40, 5), EdgeRule.of(4.0, 32, 4)),
)
# Allowed error of the equivalent points, as a fraction of the tolerance.
_OF_GRID = 0.1
# Allowed error of the interpolation nodes, as a fraction of the tolerance.
_OF_NODES = 0.15
# Direction of the small displacement off shadow boundaries before visibility is tested.
ASIDE = np.array([0.57, 0.31, 0.76])
# Negligible lengths. _FINE is a fraction of the scene's extent, and _ROUNDED is a fraction of the
# source distance.
_FINE, _ROUNDED = 1e-9, 1e-14
# Thickness of surfaces, as a multiple of the negligible length.
_ON_SURFACE = 4.0
# Number of pairs (edge, point) below which the launch of a compiled kernel takes longer than the
# computation with NumPy.
_FEW = 10_000
# Distances from the line through the source and a corner [square root of a wavelength], divided by
# the square root of the source distance. Derivatives lose digits at distances below _CORNER, but
# not at _BESIDE. The search is limited to angles from the corner with 1 - cos(angle) below
# _ALIGNED.
_CORNER, _BESIDE, _ALIGNED = 1e-5, 1e-4, 1e-8
# Clearance [wavelengths] below which the neglected evanescent waves matter.
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
    """Return the change of the field due to obstacles, total minus free, at points (n, 3) in m.

    Also return a mask of the points inside bodies, where the total field is zero, and the estimated
    errors (n,), which are zero unless ``with_error`` is true. ``bodies`` are in wavelengths. Raises
    ArgumentError if an obstacle encloses part of the source or the source needs too many points.
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
    """Return the change due to bodies, the free field and the error (n,) at positions (n, 3).

    All lengths are in wavelengths. ``seen`` contains the silhouette for each source point. If
    ``is_sheet`` is true, the edges belong to a conducting sheet. The error is zero unless
    ``with_error`` is true.
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
    """Return a mask (n,) of points in line with a source and a corner, and steps from the line.

    The second result contains one step (3,) in wavelengths for each masked point. ``views``
    contains the positions (3,) of sources and the edges (m, 2, 3) visible from them. On the line,
    the derivatives (SB5) of the waves of both adjacent edges diverge, and their sum loses digits.
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
    """Return the equivalent points of a source, and the silhouettes seen from these points.

    ``bodies``, ``positions`` (n, 3) and both results are in wavelengths.
    """
    boxes = [np.stack([b.vertices.min(axis=0), b.vertices.max(axis=0)]) for b in bodies.bodies]
    targets = np.concatenate([np.stack(boxes), np.stack([positions, positions], axis=1)])
    error = _OF_GRID * tolerance
    sources = radiating_points(source, wavelength, method, error, targets=targets)
    return sources, bodies.silhouettes([position for position, *_ in sources])


@dataclass(frozen=True)
class _Edges:
    """Silhouette edges of all source points, grouped by the surfaces behind them."""

    groups: list[tuple[Floats, Blocker | None]]
    """Edges (k, 17) for each blocker. The columns are the source point (7), both ends of the edge
    (6), and the plane of the face behind the edge (4)."""
    targets: Targets
    are_blocked: bool

    @property
    def count(self) -> int:
        """Number of edges in all groups."""
        return sum(len(rows) for rows, _ in self.groups)

    @classmethod
    def of(
        cls,
        bodies: Obstacles,
        sources: Sequence[RadiatingPoint],
        seen: Sequence[Silhouette],
        positions: Floats,
    ) -> _Edges:
        """Return the silhouette edges of all source points, and the field positions."""
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
            else:  # No position is behind the surface.
                group[group == number] = NO_SURFACE
        lines = shadow_lines(table[group == OWN_SURFACE])
        are_blocked = bool(groups) or len(lines) > 0
        groups.append((np.concatenate([table[group < 0], lines]), None))
        # Edge angles determine visibility only beyond all bodies. Other points need ray tracing.
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
    """Return the change of the field due to bodies, the free field and the error at the targets.

    The error is zero without a ``coarser`` rule. ``few`` is a faster sum over a few nodes of the
    source, or None if no faster sum is available.
    """
    if few is not None:
        change, free = few.change(edges.targets, rule)
        error = few.error * np.abs(free).max() if coarser is not None else 0.0
        return change, free, np.full(len(change), error)
    positions, aside, margin, by_angles = edges.targets
    count = len(positions)
    samples = np.column_stack([positions, aside, by_angles])
    change, free, error = *np.zeros((2, count), np.complex128), np.zeros(count)
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
    """Return the length scale (n,) of rounding errors at points (n, 3).

    ``ends`` (m, 3) of edges and ``sources`` (k, 3) have the same unit.
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
    """Return the change of the field by one edge for one source point, and its error (SB3), (SB5).

    The three results are real part, imaginary part and error. ``row`` is a row of
    ``_Edges.groups``. ``sample`` contains the point, the displaced point, and 1 if edge angles
    determine visibility. For blocked edges, ``sample`` also contains the thickness of surfaces and
    the complex transmission.
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
    dipole = spherical_wave(ops, ahead) * Pair(*field) if is_oblique else None
    wave = wave_ahead(ops, ahead, field, slope)
    change, boundary = edge_change(ops, rule, wave, dipole, *path, **sides)
    off = 0.0 * boundary.real
    if coarser is not None:
        other = boundary - edge_wave(ops, coarser, *path, **sides)
        off = ops.sqrt(wave.norm() * other.norm()) / (2.0 * math.pi)
    if is_blocked:
        change = change * Pair(*sample[8:10])
        return change.real, change.imag, off
    angle = wave.scaled(by_angles * angle_about(ops, source, aside, start, end) / (2.0 * math.pi))
    return angle.real + change.real, angle.imag + change.imag, off


def _check_clearance(bodies: Obstacles, sources: Sequence[RadiatingPoint]) -> None:
    """Raise ArgumentError if an obstacle encloses the source; warn if an obstacle is close."""
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

# Ratio of the amplitude of the free wave to the amplitude of an edge wave far from the shadow
# boundary, divided by the square root of the detour in wavelengths.
_STEEP = 2.0 * math.pi * math.sqrt(2.0)
# Detour [wavelengths] that attenuates doubly diffracted waves to 1/e. These waves only keep the
# field continuous across the second shadow boundary.
_SECOND = 16.0
# Largest number of triangles of a nonconvex surface behind an edge. Finer meshes are reduced to one
# face.
_MOST_TRIANGLES = 256


@dataclass(frozen=True)
class Blocker:
    """The surface behind an edge, in wavelengths."""

    origin: Floats
    """Midpoint of the edge, shape (3,)."""
    triangles: Floats
    """Triangles that face the origin, shape (t, 3, 3)."""
    rim: Floats
    """Silhouette of the surface, seen from the origin, shape (m, 2, 3)."""

    def hides(self, points: Floats, within: Floats) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 3) that the surface hides from ``self.origin``.

        Points less than ``within`` (n,) wavelengths behind the plane of a triangle are visible.
        """
        hidden = np.zeros(len(points), bool)
        if len(self.triangles):
            for some, share, height in hits(self.triangles - self.origin, points - self.origin):
                with np.errstate(invalid="ignore"):
                    behind = height * (1.0 / share - 1.0) > within[some, None]
                hidden[some] = behind.any(axis=1)
        return hidden

    def transmission(self, ops: Any, point: Point, hidden: Any) -> Pair:
        """Return the wave from the origin at a point, relative to the free wave.

        The result is 1 if ``hidden`` is false or the surface has no rim.
        """
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
    """Return the detour of the path over an edge [wavelengths], and the wave's real amplitude.

    The detour is never negative. The amplitude at a point in the shadow is relative to the free
    wave: 1 for a straight path, and smaller for longer detours and larger deflections.
    """
    detour, cosine, *_ = path_over(ops, source, point, start, end)
    # Kirchhoff's obliquity factor is the cosine of half the bending angle.
    share = ops.sqrt(ops.maximum(0.5 + 0.5 * cosine, 0.0)) / (1.0 + _STEEP * ops.sqrt(detour))
    return detour, share * ops.exp(detour * (-1.0 / _SECOND))


def behind_face(
    ops: Any, source: Point, start: Point, end: Point, plane: Point, point: Point, margin: Number
) -> Number:
    """Return the weight d^2/(d^2 + a^2) of an edge's shadow behind a face, 0 in front of the face.

    The length d is the depth of the point behind the face minus ``margin``, and a is the distance
    of the point from the plane through source and edge. ``plane`` contains the unit normal n
    towards the front and the offset c of the face, on which n.x + c = 0.
    """
    depth = ops.maximum(-(dot(plane, point) + plane[3]) - margin, 0.0)
    normal = cross(difference(start, source), difference(end, source))
    lateral = dot(normal, difference(point, source))
    square = depth * depth * dot(normal, normal)
    weight: Number = square / ops.maximum(square + lateral * lateral, 1e-30)
    return weight


# Group indices of edges without a surface behind them, and of edges with a surface of the same body
# behind them.
NO_SURFACE, OWN_SURFACE = -1, -2


@dataclass(frozen=True)
class BlockedEdges:
    """Silhouette edges, grouped by the surface behind them."""

    blockers: list[Blocker]
    groups: list[Indices]
    """Index of each edge's blocker, NO_SURFACE or OWN_SURFACE, for each silhouette."""


def blocked_edges(bodies: Obstacles, seen: Sequence[Silhouette], source: Floats) -> BlockedEdges:
    """Return the blockers of silhouette edges, seen from a source position (3,)."""
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
    is_own = (walls[front[rows]] == walls[body]) | bodies.are_in_contact(front[rows], body)
    group[rows[is_own]] = OWN_SURFACE
    rows, body = rows[~is_own], body[~is_own]
    if not len(rows):
        return BlockedEdges([], _split(group, seen))
    planes = bodies.face_planes(source)
    # A convex body is a single blocker, except at faces that other bodies continue.
    is_single = np.array([body.is_simple for body in bodies.bodies])[body]
    faces, one, face = np.unique(behind[rows], return_index=True, return_inverse=True)
    is_continued = [
        bool((walls[bodies.flush_with(body[k], planes[f], planes)] != walls[body[k]]).any())
        for f, k in zip(faces, one, strict=True)
    ]
    is_single &= ~np.array(is_continued)[face.ravel()]
    keys = np.column_stack([number[rows], np.where(is_single, -1 - body, behind[rows])])
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    which = which.ravel()
    group[rows] = which
    length = np.linalg.norm(ends[rows, 1] - ends[rows, 0], axis=1)
    midpoints = 0.5 * ends[rows].sum(axis=1) * length[:, None]
    sums = [np.bincount(which, midpoints[:, k]) / np.bincount(which, length) for k in range(3)]
    blockers = []
    for k, origin in zip(first, np.stack(sums, axis=1), strict=True):
        plane = planes[behind[rows[k]]]
        numbers = np.flatnonzero(walls == walls[body[k]])
        flush = np.setdiff1d(bodies.flush_with(body[k], plane, planes), numbers)
        blockers.append(_blocker(bodies, numbers, flush, plane, origin))
    return BlockedEdges(blockers, _split(group, seen))


def shadow_lines(table: Floats) -> Floats:
    """Return the shadows (k, 17) that edges cast on the faces behind them; ends are exchanged.

    The rows of ``table`` (k, 17) have the format of ``_Edges.groups``.
    """
    source, plane = table[:, None, :3], table[:, None, 13:]
    ends = table[:, 7:13].reshape(-1, 2, 3)[:, ::-1] - source
    height = (plane[..., :3] * source).sum(axis=2) + plane[..., 3]
    share = -height / (plane[..., :3] * ends).sum(axis=2)
    ends = source + share[..., None] * ends
    return np.column_stack([table[:, :7], ends.reshape(-1, 6), table[:, 13:]])


def _split(group: Indices, seen: Sequence[Silhouette]) -> list[Indices]:
    """Divide the group index of all edges into one array for each silhouette."""
    return np.split(group, np.cumsum([len(s.numbers) for s in seen])[:-1])


def _blocker(
    bodies: Obstacles, numbers: Indices, flush: Indices, plane: Floats, origin: Floats
) -> Blocker:
    """Return the surface of bodies behind a plane, seen from the midpoint of an edge.

    ``numbers`` and ``flush`` are indices of bodies. The adjoining bodies in ``flush`` continue the
    plane, and slits between these bodies are closed. ``plane`` (4,) contains the unit normal and
    the offset.
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
    """Return surface triangles with all corners at most ``within`` away from a plane (4,)."""
    height = np.abs(surface.corners @ plane[:3] + plane[3]).max(axis=1)
    return surface.subset(height <= within)
