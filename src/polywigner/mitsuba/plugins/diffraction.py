"""Shadows that diffract in scenes: the estimator ``exact`` with ``diffraction``. Source: (SB3).

The source is represented by radiating points. The field at an illuminated point is the sum of the
waves of the radiating points that no obstacle hides, and of the boundary waves from the obstacles'
edges. One compiled loop reads the edges from tables. Lengths are in wavelengths, in the source's
frame.
"""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution import Drjit, ops_for, without_collection
from polywigner.geometry.silhouettes import Obstacle, Obstacles, Silhouette
from polywigner.kernels.boundary import edge_waves
from polywigner.kernels.boundary.edge_waves import difference, dot
from polywigner.mitsuba.plugins.exact_field import AWAY, ExactEstimator
from polywigner.mitsuba.plugins.films import changed
from polywigner.mitsuba.plugins.registration import set_mesh
from polywigner.mitsuba.plugins.samplers import opaque, single
from polywigner.mitsuba.plugins.source_parameters import SourceParameters, reach_of
from polywigner.mitsuba.scenes import surfaces
from polywigner.numerics.complex_pairs import Pair, unit_wave
from polywigner.numerics.jets import Jet, flattened, rebuilt
from polywigner.propagation import equivalent_points, shadows
from polywigner.propagation.shadows import NO_SURFACE

Floats = NDArray[np.float64]
Point = tuple[Drjit, Drjit, Drjit]
Field = tuple[Drjit, Drjit]
"""Real and imaginary part."""

# Error of |F|^2 relative to its peak; diffraction by one edge at a time is less accurate.
_ERROR = 3e-4
# Largest number of radiating points; each sample tests one ray per point for obstacles.
_MOST_POINTS = 1024
# Quadrature along edges. Measured relative errors for random edges: most 5e-7, at most 9e-6.
_RULE = edge_waves.EdgeRule.of(2.0, 16, 2)
# The edge of a half plane adds 1/(sqrt(8) pi sqrt(detour)) of the free field, the detour in
# wavelengths. Edges that add less than this fraction are left out.
_FAINT = 2e-3
_LONGEST = 1.0 / (8.0 * math.pi**2 * _FAINT**2)
# Illuminated points are shifted by this fraction of their distance, so that none lies on the
# boundary of a shadow after rounding to single precision.
_ASIDE = 1e-6
# Rays end this fraction of their length before a surface, more than single precision rounds.
_ENDS = 1e-5
# Relative error of fields in scalar variants.
_HOST_ERROR = 1e-4

_NO_PLANE = (0.0, 0.0, 0.0, 1.0)

_log = logging.getLogger("polywigner.mitsuba")


class EdgeTables(NamedTuple):
    """Edges of silhouettes in groups, with the surface that blocks the waves of each group."""

    groups: Floats
    """(g, 13), a row per group: midpoint of its edges (3), plane of the face behind them (4), and
    first and end row of its edges, its blocker's triangles and its blocker's rim (6)."""
    edges: Floats
    """(k, 12), a row per edge: its ends (6), plane of the face behind it (4), and first and end
    number of the radiating points whose waves it diffracts (2)."""
    triangles: Floats
    """(t, 10), a row per triangle of a blocker: normals of the planes through the group's midpoint
    and each side (9), and the triple product of the corners (1)."""
    rims: Floats
    """(m, 6), ends of each edge of the blockers' rims."""


def edge_tables(
    obstacles: Obstacles,
    points: Sequence[equivalent_points.RadiatingPoint],
    silhouettes: Sequence[Silhouette],
    margin: float,
) -> EdgeTables:
    """Return the edges of silhouettes from points of the source, in groups of one blocker.

    Parameters
    ----------
    obstacles : Obstacles
        Bodies in the source's frame, in wavelengths.
    points : sequence of RadiatingPoint
        Points of the source.
    silhouettes : sequence of Silhouette
        One for each point of the source, or a single one for all points.
    margin : float
        Points behind a face by less than this fraction of its distance count as points on it.
    """
    centre = np.mean([point.position for point in points], axis=0)
    blocked = shadows.blocked_edges(obstacles, silhouettes, centre)
    parts, groups = [], []
    for k, (silhouette, group) in enumerate(zip(silhouettes, blocked.groups, strict=True)):
        span = (0, len(points)) if len(silhouettes) < len(points) else (k, k + 1)
        rows = np.column_stack([silhouette.edges.reshape(-1, 6), silhouette.planes])
        parts.append(np.column_stack([rows, np.tile(span, (len(group), 1))]))
        groups.append(np.maximum(group, NO_SURFACE))
        on_body = rows[group == shadows.OWN_SURFACE]
        count = len(on_body)
        for number in range(*span) if count else ():
            table = np.column_stack([np.tile(points[number].row, (count, 1)), on_body])
            ranges = np.tile((number, number + 1), (count, 1))
            parts.append(np.column_stack([shadows.shadow_lines(table)[:, 7:], ranges]))
            groups.append(np.full(count, NO_SURFACE))
    edges, group = np.concatenate(parts), np.concatenate(groups)
    planes = edges[:, 6:10]
    planes[group == NO_SURFACE] = _NO_PLANE
    # rounding to single precision moves points of a surface behind it; they count as in front
    planes[:, 3] += margin * np.linalg.norm(edges[:, 3:6], axis=1) * (group >= 0)
    order = np.argsort(group, kind="stable")
    edges, group = edges[order], group[order]
    spans, triangles, rims = [], [np.empty((0, 10))], [np.empty((0, 6))]
    sizes = [0, 0]
    for number, blocker in enumerate([None, *blocked.blockers], NO_SURFACE):
        first, end = np.searchsorted(group, [number, number + 1])
        plane = edges[first, 6:10] if first < end else _NO_PLANE
        before, origin = list(sizes), np.zeros(3)
        if blocker is not None:
            origin = blocker.origin
            triangles.append(_pyramids(blocker.triangles - origin))
            rims.append(blocker.rim.reshape(-1, 6))
            sizes = [sizes[0] + len(triangles[-1]), sizes[1] + len(rims[-1])]
        numbers = [first, end, before[0], sizes[0], before[1], sizes[1]]
        spans.append([*origin, *plane, *numbers])
    return EdgeTables(np.array(spans), edges, np.concatenate(triangles), np.concatenate(rims))


def _pyramids(corners: Floats) -> Floats:
    """Return side normals and volumes (t, 10) of pyramids from the origin over triangles."""
    a, b, c = np.moveaxis(corners, 1, 0)
    sides = [np.cross(b, c), np.cross(c, a), np.cross(a, b)]
    return np.column_stack([*sides, np.einsum("tk,tk->t", a, sides[0])])


class Shadows:
    """The field of a source behind obstacles, for one variant's arrays."""

    def __init__(
        self,
        m: Any,
        spec: SourceParameters,
        wavelength: float,
        bodies: list[Obstacle],
        pose: Floats,
        reach: float,
    ) -> None:
        self._m, self._jit = m, dr.is_jit_v(m.Float)
        self._ops = ops_for(m.Float)
        scale = spec.scene_unit / wavelength
        self._inverse = opaque(m, scale)
        try:
            points = equivalent_points.radiating_points(
                spec.at_origin, wavelength, spec.obliquity, _ERROR, _MOST_POINTS
            )
            bodies = [surfaces.in_frame(body, pose, scale) for body in bodies]
            obstacles, positions = Obstacles(bodies), np.array([point.position for point in points])
            silhouettes = obstacles.silhouettes(list(positions))
            shared = silhouettes[-1] is silhouettes[0]
            silhouettes = [
                surfaces.before_plane(s) for s in (silhouettes[:1] if shared else silhouettes)
            ]
            tables = edge_tables(obstacles, points, silhouettes, _ENDS)
        except ArgumentError as error:
            raise SceneError(f"with diffraction: {error}") from None
        faces = sum(len(body.triangles) for body in bodies)
        _log.info("shadows: %d faces, %d edges, %d points", faces, len(tables.edges), len(points))
        self._obstacles = _scene_of(m, bodies)
        self._start = opaque(m, max(surfaces.BEHIND, surfaces.ROUNDING * reach * scale))
        self._centre = tuple(positions.mean(axis=0).tolist())
        near = np.abs(positions).max(axis=0) + AWAY
        self._near = [opaque(m, value) for value in (near / scale).tolist()]
        self._is_oblique = any(point.field for point in points)
        self._is_blocked = len(tables.triangles) > 0
        every = silhouettes * len(points) if shared else silhouettes
        self._on_host = partial(shadows.diffracted, obstacles, points, every, tolerance=_HOST_ERROR)
        if self._jit:
            rows = np.array([[*point.row, 0.0] for point in points])
            self._tables = [self._ops.on_device(t.astype(np.float32)) for t in (rows, *tables)]
            counts = len(rows), len(tables.groups)
            self._counts = [m.UInt32(dr.opaque(m.UInt32, count)) for count in counts]
            self._has_edges = len(tables.edges) > 0  # a body around the source has no rim

    def either(self, point: mi.Point3f, free: Callable[[mi.Point3f], Drjit]) -> Drjit:
        """Return |U|^2 at a point in front; close to the source ``free`` computes it unshadowed."""
        z, x, y = point.z, abs(point.x), abs(point.y)
        far = (z > self._near[2]) | (x > self._near[0]) | (y > self._near[1])
        if not self._jit:
            return self.intensity(point) if far else free(point)
        return dr.if_stmt((point,), far, self.intensity, free, mode="symbolic")

    def intensity(self, point: mi.Point3f) -> Drjit:
        """Return |U|^2 at a point in front in units of the scene, relative to |u|^2 = 1."""
        at = tuple(c * self._inverse for c in (point.x, point.y, point.z))
        if not self._jit:
            # the point moves in front of its surface by more than rounding errors
            change, free, _ = self._on_host(
                positions=(1.0 - _ENDS) * np.array([at]), engine="numpy"
            )
            return float(np.abs(free + change)[0] ** 2)
        # shifted off the boundaries of shadows and their corners by more than rounding errors
        away = self._ops.sqrt(sum(c * c for c in at))
        x, y, z = (c + _ASIDE * u * away for c, u in zip(at, shadows.ASIDE.tolist(), strict=True))
        real, imag = self._field((x, y, z))
        return real * real + imag * imag

    def _field(self, at: Point) -> Field:
        m, ops = self._m, self._ops
        points, groups, edges, *_ = self._tables

        def add_point(number: Drjit, real: Drjit, imag: Drjit) -> Field:
            row = ops.gather(points, number)
            ahead, turns = self._path(row, at)
            wave, hidden = self._wave(row, ahead, turns), self._hidden(row, ahead)
            return (
                real + dr.select(hidden, 0.0, wave.real),
                imag + dr.select(hidden, 0.0, wave.imag),
            )

        def add_group(number: Drjit, real: Drjit, imag: Drjit) -> Field:
            group = ops.gather(groups, number)
            weight = self._transmission(group, at)

            def add_edge(number: Drjit, real: Drjit, imag: Drjit) -> Field:
                row = ops.gather(edges, number)

                def add_change(number: Drjit, real: Drjit, imag: Drjit) -> Field:
                    change = self._change(ops.gather(points, number), row, at) * weight
                    return real + change.real, imag + change.imag

                def add_changes(real: Drjit, imag: Drjit) -> Field:
                    span = m.UInt32(row[10]), m.UInt32(row[11])
                    return ops.fold(*span, (real, imag), add_change)

                is_short = (
                    edge_waves.path_over(ops, self._centre, at, row[:3], row[3:6])[0] < _LONGEST
                )
                return self._if(is_short, add_changes, (real, imag))

            first, end = m.UInt32(group[7]), m.UInt32(group[8])
            end = dr.select(weight.norm() > _FAINT**2, end, first)
            return ops.fold(first, end, (real, imag), add_edge)

        zero = m.Float(0.0)
        field = ops.fold(0, self._counts[0], (zero, zero), add_point)
        return ops.fold(0, self._counts[1], field, add_group) if self._has_edges else field

    @staticmethod
    def _if(condition: Drjit, compute: Callable[..., Any], state: Any) -> Any:
        """Return ``compute(*state)`` where the condition holds, and the state elsewhere."""
        return dr.if_stmt(state, condition, compute, lambda *state: state, mode="symbolic")

    def _transmission(self, group: Drjit, at: Point) -> Pair:
        """Return the amplitude of a group's waves at a point relative to free propagation."""
        m, ops = self._m, self._ops
        free = m.Float(1.0), m.Float(0.0)
        if not self._is_blocked:
            return Pair(*free)
        *_, triangles, rims = self._tables
        ahead = difference(at, group[:3])

        def is_hit(number: Drjit, hits: Drjit) -> tuple[Drjit]:
            row = ops.gather(triangles, number)
            shares = [dot(row[k : k + 3], ahead) for k in (0, 3, 6)]
            total = shares[0] + shares[1] + shares[2]
            sign = dr.select(total < 0.0, -1.0, 1.0)
            # the ray meets the triangle's plane clearly before the point
            hit = (row[9] * sign > 0.0) & (row[9] * sign < total * sign * (1.0 - _ENDS))
            for share in shares:
                hit &= share * sign >= 0.0
            return (dr.select(hit, 1.0, hits),)

        def over(number: Drjit, detour: Drjit, share: Drjit) -> Field:
            row = ops.gather(rims, number)
            longer, passed = shadows.transmission_over(ops, group[:3], at, row[:3], row[3:6])
            return ops.minimum(longer, detour), ops.maximum(passed, share)

        def behind(real: Drjit, imag: Drjit) -> Field:
            span = m.UInt32(group[9]), m.UInt32(group[10])
            (hits,) = ops.fold(*span, (m.Float(0.0),), is_hit)
            first, end = m.UInt32(group[11]), m.UInt32(group[12])
            end = dr.select(hits > 0.5, end, first)
            detour, share = ops.fold(first, end, (m.Float(1e6), m.Float(0.0)), over)
            wave = unit_wave(ops, detour).scaled(share)
            return dr.select(hits > 0.5, wave.real, real), dr.select(hits > 0.5, wave.imag, imag)

        return Pair(*self._if(dot(group[3:6], at) + group[6] < 0.0, behind, free))

    def _path(self, row: Drjit, at: Point) -> tuple[Point, Drjit]:
        """Return the vector from a radiating point, and its extra cycles over the origin's path."""
        ops, (x, y, z) = self._ops, at
        a, b = row[:2]
        ahead = x - a, y - b, z
        length = ops.sqrt(ahead[0] * ahead[0] + ahead[1] * ahead[1] + z * z)
        sum_ = length + ops.sqrt(x * x + y * y + z * z)
        return ahead, (a * (a - 2.0 * x) + b * (b - 2.0 * y)) / sum_

    def _wave(self, row: Drjit, ahead: Point, turns: Drjit) -> Pair:
        """Return the wave of a point of the source, relative to the phase from the origin."""
        return equivalent_points.wave_ahead(
            self._ops, ahead, tuple(row[3:5]), tuple(row[5:7]), turns
        )

    def _hidden(self, row: Drjit, ahead: Point) -> Drjit:
        """Return whether an obstacle is between a point of the source and the end of a vector."""
        m = self._m
        path = m.Vector3f(*ahead)
        part = self._start / path.z
        part = dr.select(part < 0.5, part, 0.5)
        distance = dr.norm(path)
        ray = m.Ray3f(m.Point3f(row[0], row[1], 0.0) + path * part, path / distance)
        ray.maxt = distance * (1.0 - part - _ENDS)
        return self._obstacles.ray_test(ray)

    def _change(self, point: Drjit, row: Drjit, at: Point) -> Pair:
        """Return the boundary wave of an edge for a point of the source."""
        ops, source, ends = self._ops, (point[0], point[1], 0.0 * point[0]), (row[:3], row[3:6])
        ahead, turns = self._path(point, at)
        wave = self._wave(point, ahead, turns)
        blocked = None
        if self._is_blocked:
            blocked = shadows.behind_face(ops, source, *ends, row[6:10], at, 0.0)
        options: dict[str, Any] = {"when": self._when, "blocked": blocked}
        path = source, at, *ends
        if not self._is_oblique:
            boundary = Pair(*edge_waves.edge_wave(ops, _RULE, *path, **options))
            return wave * boundary.scaled(-0.5 / math.pi)
        boundary, rate = edge_waves.edge_wave_and_rate(ops, _RULE, *path, **options)
        bend = equivalent_points.oblique_change(ops, ahead, tuple(point[3:5]), rate, turns)
        return wave * boundary.scaled(-0.5 / math.pi) + bend

    def _when(
        self, condition: Drjit, compute: Callable[..., Any], *arguments: Any
    ) -> Field | tuple[Jet, Jet]:
        """Return ``compute(*arguments)`` where the condition holds, and zero elsewhere."""

        def flat(*parts: Drjit) -> tuple[Drjit, ...]:
            return tuple(flattened(compute(*rebuilt(arguments, parts))))

        # Dr.Jit's if_stmt takes arrays: values and derivatives of jets are passed separately
        zeros = (self._m.Float(0.0),) * (4 if self._is_oblique else 2)
        state = tuple(flattened(arguments))
        parts = dr.if_stmt(state, condition, flat, lambda *_: zeros, mode="symbolic")
        if not self._is_oblique:
            return parts
        return Jet(self._ops, parts[0], parts[1:2]), Jet(self._ops, parts[2], parts[3:])


def _scene_of(m: Any, bodies: list[Obstacle]) -> mi.Scene:
    """Return a scene of the triangles of all bodies, without lights."""
    counts = np.cumsum([0, *(len(body.vertices) for body in bodies)])
    vertices = np.concatenate([body.vertices for body in bodies])
    faces = np.concatenate([body.triangles + n for body, n in zip(bodies, counts, strict=False)])
    mesh = m.Mesh("obstacles", len(vertices), len(faces))
    set_mesh(mesh, vertex_positions=vertices, faces=faces)
    return mi.load_dict({"type": "scene", "mesh": mesh})


def cast_shadows(scene: mi.Scene) -> None:
    """Pass the surfaces of a scene to its sources and receivers with diffraction."""
    plugins = [
        p for p in (*surfaces.sorted_emitters(scene), *scene.sensors()) if hasattr(p, "estimator")
    ]
    plugins = [plugin for plugin in plugins if plugin.spec.diffraction]
    if plugins and any(shape.is_medium_transition() for shape in scene.shapes()):
        raise SceneError(
            "expected no fog in a scene with diffraction, got some; remove the fog or leave "
            "diffraction out"
        )
    meshes_at = cache(lambda wavelength: list(surfaces.meshes_in(scene, wavelength)))
    for plugin in plugins:
        spec, pose = plugin.spec, np.array(surfaces.matrix_of(plugin.to_world))
        wavelength = single(getattr(plugin, "wavelength", spec.wavelength), "wavelength")
        pose[:3, 3] += pose[:3, :2] @ spec.centre
        meshes = meshes_at(wavelength / spec.scene_unit)
        digest = hashlib.sha256(str(wavelength).encode())
        for array in (pose, *(part for mesh in meshes for part in mesh)):
            digest.update(np.ascontiguousarray(array).tobytes())
        if plugin.estimator.shadows_key == digest.hexdigest():
            continue
        bodies, cast = surfaces.bodies_of(meshes), None
        if bodies:
            m, reach = getattr(mi, mi.variant()), reach_of(scene, plugin)
            cast = Shadows(m, spec, wavelength, bodies, pose, reach)
        plugin.estimator.set_shadows(digest.hexdigest(), cast)


@contextmanager
def scene_known(scene: mi.Scene) -> Iterator[None]:
    """Pass the scene to its receivers, and to its sources with diffraction."""
    cast_shadows(scene)
    for plugin in (*scene.emitters(), *scene.sensors()):
        if hasattr(plugin, "stand_at"):
            plugin.stand_at(reach_of(scene, plugin))
    scenes = [
        (sensor, "scene", scene) for sensor in scene.sensors() if surfaces.is_receiver(sensor)
    ]
    # the process crashes if a scene is freed while Dr.Jit records a kernel
    with without_collection(), changed([(ExactEstimator, "scene_is_known", True), *scenes]):
        yield
