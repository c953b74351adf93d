"""Shadows that diffract in scenes: the estimator ``exact`` with ``diffraction``. Source: (SB3).

Each point in place of the source adds its light where obstacles let it pass, and boundary waves of
their edges, which are data of one loop. Lengths are in wavelengths, in the source's frame.
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
from polywigner.kernels.boundary.edge_waves import (
    EdgeRule,
    difference,
    dot,
    edge_wave,
    edge_wave_and_rate,
    least_detour,
)
from polywigner.mitsuba.plugins.exact_field import AWAY, ExactEstimator
from polywigner.mitsuba.plugins.films import changed
from polywigner.mitsuba.plugins.samplers import opaque, single
from polywigner.mitsuba.plugins.source_parameters import SourceParameters, reach_of
from polywigner.mitsuba.scenes.surfaces import (
    BEHIND,
    ROUNDING,
    before_plane,
    bodies_of,
    in_frame,
    is_receiver,
    matrix_of,
    meshes_in,
    sorted_emitters,
)
from polywigner.numerics.complex_pairs import Pair, unit_wave
from polywigner.numerics.jets import Jet, flattened, rebuilt
from polywigner.propagation.equivalent_points import (
    RadiatingPoint,
    oblique_change,
    radiating_points,
    wave_ahead,
)
from polywigner.propagation.shadows import (
    ASIDE,
    NO_SURFACE,
    OWN_SURFACE,
    Blocker,
    behind_face,
    blocked_edges,
    diffracted,
    shadow_lines,
    transmission_over,
)

Floats = NDArray[np.float64]

# Error of |F|^2 over its peak: shadows of one edge at a time deserve no more.
_ERROR = 3e-4
# Points in place of a source: each looks for obstacles, at each sample.
_MOST_POINTS = 1024
# Measured before edges at random: within 9e-6, most within 5e-7.
_RULE = EdgeRule.of(2.0, 16, 2)
# An edge of half a plane adds 1/(sqrt(8) pi sqrt(detour)) to the field that would be there without:
# below this share it is left out.
_FAINT = 2e-3
_LONGEST = 1.0 / (8.0 * math.pi**2 * _FAINT**2)
# Places are taken beside themselves by this fraction of their distance, which single precision can
# tell from the boundaries of shadows.
_ASIDE = 1e-6
# Fraction of a ray that is left out at its end, on a surface; in single precision.
_ENDS = 1e-5
# Relative error of fields in scalar variants.
_ON_HOST = 1e-4

_log = logging.getLogger("polywigner.mitsuba")


class EdgeTables(NamedTuple):
    """Edges of silhouettes in groups, with the surface that blocks the waves of each group."""

    groups: Floats
    """(g, 13) midpoint of the edges; plane of the face behind; first and end of their edges, of
    the triangles of the surface, and of the edges of its rim."""
    edges: Floats
    """(k, 12) ends, plane of the face behind, first and end of the points of the source."""
    triangles: Floats
    """(t, 10) normals of the planes through the midpoint and each side, and their triple
    product."""
    rims: Floats
    """(m, 6)."""


def edge_tables(
    obstacles: Obstacles,
    points: Sequence[RadiatingPoint],
    seen: Sequence[Silhouette],
    margin: float,
) -> EdgeTables:
    """Return the edges that points of a source see, in groups of one blocker.

    Parameters
    ----------
    obstacles : bodies, in wavelengths.
    points : points of the source.
    seen : a silhouette for each point, or one for all.
    margin : depth behind a face, as a fraction of its distance, up to which points lie on it.
    """
    shared = len(seen) < len(points)
    found = blocked_edges(obstacles, seen, np.mean([point.place for point in points], axis=0))
    parts, groups = [], []
    for k, (silhouette, group) in enumerate(zip(seen, found.groups, strict=True)):
        count, span = len(group), (0, len(points)) if shared else (k, k + 1)
        rows = np.column_stack([silhouette.edges.reshape(-1, 6), silhouette.planes])
        parts.append(np.column_stack([rows, np.tile(span, (count, 1))]))
        groups.append(np.maximum(group, NO_SURFACE))
        own = rows[group == OWN_SURFACE]
        for number in range(*span) if len(own) else ():
            table = np.column_stack([np.tile(points[number].row, (len(own), 1)), own])
            lines = shadow_lines(table)[:, 7:]
            parts.append(np.column_stack([lines, np.tile((number, number + 1), (len(own), 1))]))
            groups.append(np.full(len(own), NO_SURFACE))
    edges, group = np.concatenate(parts), np.concatenate(groups)
    planes = edges[:, 6:10]
    planes[group == NO_SURFACE] = 0.0, 0.0, 0.0, 1.0
    # places on the surface count as before it, which single precision rounds
    planes[:, 3] += margin * np.linalg.norm(edges[:, 3:6], axis=1) * (group >= 0)
    order = np.argsort(group, kind="stable")
    edges, group = edges[order], group[order]
    blockers: list[Blocker | None] = [None, *found.blockers]
    spans, triangles, rims = [], [np.empty((0, 10))], [np.empty((0, 6))]
    for number, blocker in enumerate(blockers, NO_SURFACE):
        first, end = np.searchsorted(group, [number, number + 1])
        plane = edges[first, 6:10] if first < end else np.array([0.0, 0.0, 0.0, 1.0])
        before = sum(map(len, triangles)), sum(map(len, rims))
        if blocker is not None:
            triangles.append(_pyramids(blocker.triangles - blocker.origin))
            rims.append(blocker.rim.reshape(-1, 6))
        after = sum(map(len, triangles)), sum(map(len, rims))
        origin = np.zeros(3) if blocker is None else blocker.origin
        spans.append([*origin, *plane, first, end, before[0], after[0], before[1], after[1]])
    return EdgeTables(np.array(spans), edges, np.concatenate(triangles), np.concatenate(rims))


def _pyramids(corners: Floats) -> Floats:
    """(t, 10) normals of the sides of pyramids from the origin over triangles, and volumes."""
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
        self._inverse = opaque(m, spec.scene_unit / wavelength)
        try:
            source = spec.at_origin
            points = radiating_points(source, wavelength, spec.obliquity, _ERROR, _MOST_POINTS)
            scale = spec.scene_unit / wavelength
            own = [in_frame(body, pose, scale) for body in bodies]
            obstacles, places = Obstacles(own), [point.place for point in points]
            seen = obstacles.silhouettes(places)
            shared = seen[-1] is seen[0]
            seen = [before_plane(silhouette) for silhouette in (seen[:1] if shared else seen)]
            tables = edge_tables(obstacles, points, seen, _ENDS)
        except ArgumentError as error:
            raise SceneError(f"with diffraction: {error}") from None
        self._obstacles = _scene_of(m, own)
        self._start = opaque(m, max(BEHIND, ROUNDING * reach * scale))
        self._middle = np.mean([point.place for point in points], axis=0)
        near = np.abs([point.place for point in points]).max(axis=0) + AWAY
        self._near = [opaque(m, value) for value in (near / scale).tolist()]
        rows = np.array([[*point.row, 0.0] for point in points])
        self._is_oblique = any(point.field for point in points)
        faces = sum(len(body.triangles) for body in own)
        _log.info(
            "shadows: %d faces, %d edges of %d points; waves of edges below %g of the light are "
            "left out, as by detours beyond %.3g wavelengths",
            faces, len(tables.edges), len(points), _FAINT, _LONGEST,
        )  # fmt: skip
        self._tables = tables
        self._is_blocked = len(tables.triangles) > 0
        whole = seen * len(points) if shared else seen
        self._on_host = partial(diffracted, obstacles, points, whole, tolerance=_ON_HOST)
        if self._jit:
            self._held = [self._ops.held(t.astype(np.float32)) for t in (rows, *tables)]
            self._ends = [m.UInt32(dr.opaque(m.UInt32, len(t))) for t in (rows, tables.groups)]

    def either(self, point: Any, plain: Callable[[Any], Any]) -> Drjit:
        """|U|^2 at a point in front; by ``plain``, without shadows, beside the source."""
        z, x, y = point.z, abs(point.x), abs(point.y)
        far = (z > self._near[2]) | (x > self._near[0]) | (y > self._near[1])
        if not self._jit:
            return self.intensity(point) if far else plain(point)
        return dr.if_stmt((point,), far, self.intensity, plain, mode="symbolic")

    def intensity(self, point: Any) -> Drjit:
        """|U|^2 at a point in front, in units of the scene; in the unit of |u|^2."""
        place = tuple(c * self._inverse for c in (point.x, point.y, point.z))
        if not self._jit:
            # before the surface that the point is on, by more than rounding
            change, free, _ = self._on_host(
                places=(1.0 - _ENDS) * np.array([place]), engine="numpy"
            )
            return float(np.abs(free + change)[0] ** 2)
        # beside the boundaries of shadows and their corners, by more than rounding
        away = self._ops.sqrt(sum(c * c for c in place))
        place = tuple(c + _ASIDE * u * away for c, u in zip(place, ASIDE.tolist(), strict=True))
        real, imag = self._traced(place)
        return real * real + imag * imag

    def _traced(self, place: Any) -> tuple[Drjit, Drjit]:
        m, ops = self._m, self._ops
        points, groups, edges, *_ = self._held
        zero = m.Float(0.0)

        def lit(number: Any, real: Any, imag: Any) -> tuple[Drjit, Drjit]:
            row = ops.gather(points, number)
            wave, ahead = self._wave(ops, row, place)
            hidden = self._hidden(row[:2], ahead)
            return (
                real + dr.select(hidden, 0.0, wave.real),
                imag + dr.select(hidden, 0.0, wave.imag),
            )

        def of_group(number: Any, real: Any, imag: Any) -> tuple[Drjit, Drjit]:
            group = ops.gather(groups, number)
            weight = self._transmission(group, place)

            def of_edge(number: Any, real: Any, imag: Any) -> tuple[Drjit, Drjit]:
                row = ops.gather(edges, number)

                def of_point(number: Any, real: Any, imag: Any) -> tuple[Drjit, Drjit]:
                    change = self._change(ops, ops.gather(points, number), row, place) * weight
                    return real + change.real, imag + change.imag

                def visible(real: Any, imag: Any) -> tuple[Drjit, Drjit]:
                    return ops.fold(m.UInt32(row[10]), m.UInt32(row[11]), (real, imag), of_point)

                matters = self._matters(ops, row, place)
                return dr.if_stmt(
                    (real, imag), matters, visible, lambda *state: state, mode="symbolic"
                )

            first, end = m.UInt32(group[7]), m.UInt32(group[8])
            end = dr.select(weight.norm() > _FAINT**2, end, first)
            return ops.fold(first, end, (real, imag), of_edge)

        real, imag = ops.fold(0, self._ends[0], (zero, zero), lit)
        if not len(self._tables.edges):  # a body around the source has no rim
            return real, imag
        return ops.fold(0, self._ends[1], (real, imag), of_group)

    def _transmission(self, group: Any, place: Any) -> Pair:
        """Amplitude at a place of the waves of a group of edges, over the free one."""
        m, ops = self._m, self._ops
        if not self._is_blocked:
            return Pair(m.Float(1.0), m.Float(0.0))
        *_, triangles, rims = self._held
        ahead = difference(place, group[:3])

        def is_hit(number: Any, hits: Any) -> tuple[Drjit]:
            row = ops.gather(triangles, number)
            shares = [dot(row[k : k + 3], ahead) for k in (0, 3, 6)]
            total = shares[0] + shares[1] + shares[2]
            sign = dr.select(total < 0.0, -1.0, 1.0)
            # the triangle's plane is before the place, which does not lie on it
            met = (row[9] * sign > 0.0) & (row[9] * sign < total * sign * (1.0 - _ENDS))
            for share in shares:
                met &= share * sign >= 0.0
            return (dr.select(met, 1.0, hits),)

        def over(number: Any, detour: Any, share: Any) -> tuple[Drjit, Drjit]:
            row = ops.gather(rims, number)
            path = group[:3], place, row[:3], row[3:6]
            longer, passed = transmission_over(ops, *path)
            return ops.minimum(longer, detour), ops.maximum(passed, share)

        def behind(real: Any, imag: Any) -> tuple[Drjit, Drjit]:
            span = m.UInt32(group[9]), m.UInt32(group[10])
            (hits,) = ops.fold(*span, (m.Float(0.0),), is_hit)
            first, end = m.UInt32(group[11]), m.UInt32(group[12])
            end = dr.select(hits > 0.5, end, first)
            state = m.Float(1e6), m.Float(0.0)
            detour, share = ops.fold(first, end, state, over)
            wave = unit_wave(ops, detour).scaled(share)
            return dr.select(hits > 0.5, wave.real, real), dr.select(hits > 0.5, wave.imag, imag)

        free = m.Float(1.0), m.Float(0.0)
        is_behind = dot(group[3:6], place) + group[6] < 0.0
        return Pair(*dr.if_stmt(free, is_behind, behind, lambda *state: state, mode="symbolic"))

    def _wave(self, ops: Any, row: Any, place: Any) -> tuple[Pair, tuple[Drjit, Drjit, Drjit]]:
        """The wave of a point of the source, relative to the phase of the distance from its frame's
        origin; and the path to the place."""
        ahead, turns = self._path(ops, row, place)
        return wave_ahead(ops, ahead, tuple(row[3:5]), tuple(row[5:7]), turns), ahead

    @staticmethod
    def _path(ops: Any, row: Any, place: Any) -> tuple[tuple[Drjit, Drjit, Drjit], Drjit]:
        """From a point of the source to a place, and cycles beyond the distance of the origin."""
        x, y, z = place
        a, b = row[:2]
        ahead = x - a, y - b, z
        way = ops.sqrt(ahead[0] * ahead[0] + ahead[1] * ahead[1] + z * z)
        turns = (a * (a - 2.0 * x) + b * (b - 2.0 * y)) / (way + ops.sqrt(x * x + y * y + z * z))
        return ahead, turns

    def _hidden(self, at: Any, ahead: Any) -> Drjit:
        m = self._m
        way = m.Vector3f(*ahead)
        part = self._start / way.z
        part = dr.select(part < 0.5, part, 0.5)
        distance = dr.norm(way)
        ray = m.Ray3f(m.Point3f(at[0], at[1], 0.0) + way * part, way / distance)
        ray.maxt = distance * (1.0 - part - _ENDS)
        return self._obstacles.ray_test(ray)

    def _matters(self, ops: Any, row: Any, place: Any) -> Drjit:
        """Whether the detour over an edge is short."""
        middle = tuple(self._middle.tolist())
        return least_detour(ops, middle, place, row[:3], row[3:6]) < _LONGEST

    def _change(self, ops: Any, seen: Any, row: Any, place: Any) -> Pair:
        wave, _ = self._wave(ops, seen, place)
        source = seen[0], seen[1], 0.0 * seen[0]
        path = source, place, row[:3], row[3:6]
        blocked = None
        if self._is_blocked:
            blocked = behind_face(ops, *path[:1], *path[2:], row[6:10], place, 0.0)
        if not self._is_oblique:
            boundary = Pair(*edge_wave(ops, _RULE, *path, when=self._when, blocked=blocked))
            return wave * boundary.scaled(-0.5 / math.pi)
        boundary, rate = edge_wave_and_rate(ops, _RULE, *path, when=self._when, blocked=blocked)
        ahead, turns = self._path(ops, seen, place)
        bend = oblique_change(ops, ahead, tuple(seen[3:5]), rate, turns)
        return wave * boundary.scaled(-0.5 / math.pi) + bend

    def _when(
        self, condition: Any, compute: Callable[..., Any], *arguments: Any
    ) -> tuple[Drjit, Drjit] | tuple[Jet, Jet]:
        zero = self._m.Float(0.0)

        def taken(*parts: Any) -> tuple[Drjit, ...]:
            return tuple(flattened(compute(*rebuilt(arguments, parts))))

        # values of jets and their derivatives are arguments and results of their own
        count = 4 if self._is_oblique else 2
        state = tuple(flattened(arguments))
        parts = dr.if_stmt(state, condition, taken, lambda *_: (zero,) * count, mode="symbolic")
        if not self._is_oblique:
            return parts
        return Jet(self._ops, parts[0], parts[1:2]), Jet(self._ops, parts[2], parts[3:])


def _scene_of(m: Any, bodies: list[Obstacle]) -> mi.Scene:
    """A scene of the triangles of all bodies, which nothing lights."""
    counts = np.cumsum([0, *(len(body.vertices) for body in bodies)])
    vertices = np.concatenate([body.vertices for body in bodies])
    faces = np.concatenate([body.triangles + n for body, n in zip(bodies, counts, strict=False)])
    mesh = m.Mesh("obstacles", len(vertices), len(faces))
    params = mi.traverse(mesh)
    params["vertex_positions"] = vertices.ravel().tolist()
    params["faces"] = faces.ravel().tolist()
    params.update()
    return mi.load_dict({"type": "scene", "mesh": mesh})


def cast_shadows(scene: Any) -> None:
    """Tell the sources and receivers with diffraction of a scene the surfaces in their way."""
    plugins = [p for p in (*sorted_emitters(scene), *scene.sensors()) if hasattr(p, "estimator")]
    plugins = [plugin for plugin in plugins if plugin.spec.diffraction]
    if plugins and any(shape.is_medium_transition() for shape in scene.shapes()):
        raise SceneError(
            "expected no fog in a scene with diffraction, got some; leave either of them out"
        )
    meshes_at = cache(lambda wavelength: list(meshes_in(scene, wavelength)))  # mostly of one
    for plugin in plugins:
        spec, pose = plugin.spec, np.array(matrix_of(plugin.to_world))
        wavelength = single(getattr(plugin, "wavelength", spec.wavelength), "wavelength")
        pose[:3, 3] += pose[:3, :2] @ spec.centre
        meshes = meshes_at(wavelength / spec.scene_unit)
        digest = hashlib.sha256(str(wavelength).encode())
        for array in (pose, *(part for mesh in meshes for part in mesh)):
            digest.update(np.ascontiguousarray(array).tobytes())
        if plugin.estimator.shadows_key == digest.hexdigest():
            continue
        bodies = bodies_of(meshes)
        m = getattr(mi, mi.variant())
        shadows = None
        if bodies:
            shadows = Shadows(m, spec, wavelength, bodies, pose, reach_of(scene, plugin))
        plugin.estimator.cast(digest.hexdigest(), shadows)


@contextmanager
def scene_known(scene: Any) -> Iterator[None]:
    """Within, receivers and sources whose light diffracts know their scene."""
    cast_shadows(scene)
    for plugin in (*scene.emitters(), *scene.sensors()):
        if hasattr(plugin, "stand_at"):
            plugin.stand_at(reach_of(scene, plugin))
    scenes = [(sensor, "scene", scene) for sensor in scene.sensors() if is_receiver(sensor)]
    # a scene that is freed while Dr.Jit records a kernel ends the process
    with without_collection(), changed([(ExactEstimator, "tells", True), *scenes]):
        yield
