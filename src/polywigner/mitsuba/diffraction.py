"""Shadows that diffract in scenes: the estimator ``exact`` with ``diffraction``. Source: (SB3).

Each point in place of the source adds its light where obstacles let it pass, and boundary waves of
their edges, which are data of one loop. Lengths are in wavelengths, in the source's frame.
"""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache, partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution import NumpyOperations, ops_for
from polywigner.geometry.faces import connected
from polywigner.geometry.silhouettes import Obstacle, Obstacles, Silhouette
from polywigner.kernels.boundary.edge_waves import (
    EdgeRule,
    difference,
    dot,
    edge_wave,
    edge_wave_and_rate,
    least_detour,
)
from polywigner.mitsuba.edge_tables import edge_tables
from polywigner.mitsuba.exact import AWAY
from polywigner.mitsuba.placement import matrix_of, reach_of
from polywigner.mitsuba.sampling import opaque, single
from polywigner.mitsuba.scene_order import sorted_emitters, sorted_shapes
from polywigner.mitsuba.sources import SourceSpec
from polywigner.mitsuba.visibility import ROUNDING
from polywigner.numerics.complex_pairs import Pair, unit_wave
from polywigner.numerics.jets import Jet, flattened, rebuilt
from polywigner.propagation.blockers import (
    Blocker,
    behind_face,
    transmission_over,
)
from polywigner.propagation.equivalent_points import (
    oblique_change,
    radiating_points,
    wave_ahead,
)
from polywigner.propagation.shadows import ASIDE

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

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
# Chords of curved shapes leave out so much of a wavelength; most points of a rim, and halvings.
_SAGITTA, _MOST_CHORDS, _MOST_HALVINGS = 0.01, 1024, 6
# Faces in the way of light: they take a gigabyte.
_MOST_FACES = 1 << 21
# Nearer to the plane of a source than this, in wavelengths, edges are no obstacles to its light.
_BEHIND = 1e-3
_TRANSPARENT = int(mi.BSDFFlags.Null) | int(mi.BSDFFlags.Transmission)

_log = logging.getLogger("polywigner.mitsuba")


def children_of(node: Any) -> list[Any]:
    """Return the objects directly nested in an object of Mitsuba."""
    found: list[Any] = []

    class Callback(mi.TraversalCallback):  # each variant has its own
        def put(self, name: str, value: Any, *_: Any) -> None:
            if isinstance(value, mi.Object):
                found.append(value)

    node.traverse(Callback())
    return found


def meshes_in(scene: Any, wavelength: float) -> Iterator[tuple[Floats, Indices]]:
    """Corners and triangles of all opaque shapes of a scene, in its units; ``wavelength`` too."""
    groups = {
        shape.id(): children_of(shape)
        for shape in children_of(scene)
        if shape.class_name() == "ShapeGroupPlugin"
    }
    count = 0
    for shape in sorted_shapes(scene):
        for points, faces in _triangles(shape, groups, wavelength):
            count += len(faces)
            if count > _MOST_FACES:
                raise SceneError(
                    f"expected at most {_MOST_FACES} faces in a scene with diffraction, those of "
                    "instances and spheres included, got more; simplify the meshes"
                )
            yield points, faces


def _triangles(
    shape: Any, groups: dict[str, list[Any]], wavelength: float
) -> Iterator[tuple[Floats, Indices]]:
    """Corners and triangles of an opaque shape; of each shape in the group of an instance."""
    params = mi.traverse(shape)
    if shape.class_name() == "Instance":
        name = str(shape).split('name = "', 1)[1].rsplit('",\n    prim_count', 1)[0]
        pose = np.array(matrix_of(params["to_world"]))
        for own in groups[name]:
            for points, faces in _triangles(own, groups, wavelength):
                yield points @ pose[:3, :3].T + pose[:3, 3], faces
        return
    bsdf = shape.bsdf()
    if bsdf is None or bsdf.flags() & _TRANSPARENT or shape.class_name() == "ShapeGroupPlugin":
        return
    if "faces" in params:
        places = np.array(dr.detach(params["vertex_positions"]), np.float64).reshape(-1, 3)
        yield places, np.array(params["faces"], np.intp).reshape(-1, 3)
        return
    kind = shape.class_name()
    if kind not in _SHAPES:
        raise SceneError(
            f"expected meshes, rectangles, disks, spheres and cylinders with diffraction, got a "
            f"{kind} {shape.id()!r}; make it a mesh"
        )
    pose = np.array(matrix_of(params["to_world"]))
    size = float(np.linalg.norm(pose[:3, :3], axis=0)[:2].max())
    points, faces = _SHAPES[kind](size / wavelength)
    yield points @ pose[:3, :3].T + pose[:3, 3], faces


def _rectangle(_: float) -> tuple[Floats, Indices]:
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _revolved(profile: Any, radius: float) -> tuple[Floats, Indices]:
    """The surface of a profile (n, 2) of radii and heights about the z axis."""
    count = int(np.clip(math.pi * math.sqrt(0.5 * radius / _SAGITTA), 32, _MOST_CHORDS))
    angles = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.ones(count)])
    points = np.concatenate([rim * [size, size, height] for size, height in profile])
    k = np.arange((len(profile) - 1) * count)
    following = k - k % count + (k + 1) % count
    lower = np.column_stack([k, following, following + count])
    return points, np.concatenate([lower, np.column_stack([k, following + count, k + count])])


def _sphere(radius: float) -> tuple[Floats, Indices]:
    """An icosahedron, its triangles halved along each side until chords are near the sphere."""
    g = (1.0 + math.sqrt(5.0)) / 2.0
    base = [(0.0, a, b * g) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    points = np.array([np.roll(place, k) for k in range(3) for place in base])
    points /= np.linalg.norm(points[0])
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    near = (apart > 0.0) & (apart < 1.1)
    faces = np.array(
        [
            (a, b, c) if np.linalg.det(points[[a, b, c]]) > 0.0 else (a, c, b)
            for a in range(12)
            for b in range(a + 1, 12)
            for c in range(b + 1, 12)
            if near[a, b] and near[b, c] and near[a, c]
        ]
    )
    wanted = 0.5 * math.log2(max(1.0, 0.15 * radius / _SAGITTA))
    for _ in range(min(_MOST_HALVINGS, max(2, math.ceil(wanted)))):
        pairs = np.sort(np.concatenate([faces, np.roll(faces, -1, axis=1)]).reshape(2, -1).T)
        edges, which = np.unique(pairs, axis=0, return_inverse=True)
        middles = points[edges].mean(axis=1)
        middles /= np.linalg.norm(middles, axis=1)[:, None]
        ab, bc, ca = (which.reshape(-1, 3) + len(points)).T
        a, b, c = faces.T
        points = np.concatenate([points, middles])
        faces = np.concatenate(
            [np.column_stack(t) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
        )
    return points, faces


_SHAPES: dict[str, Callable[[float], tuple[Floats, Indices]]] = {
    "Rectangle": _rectangle,
    "Disk": partial(_revolved, [(1.0, 0.0), (0.0, 0.0)]),
    "Cylinder": partial(_revolved, [(1.0, 0.0), (1.0, 1.0)]),
    "Sphere": _sphere,
}


def _bodies(points: Floats, faces: Indices) -> list[Obstacle]:
    """The connected parts of a mesh, corners at one place taken as one."""
    points, number = np.unique(points, axis=0, return_inverse=True)
    faces = number.reshape(-1)[faces]
    a, b, c = np.moveaxis(points[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    kept = np.linalg.norm(normals, axis=1) > 0.0
    faces, normals = faces[kept], normals[kept]
    a, b, c = faces.T
    part = connected(len(points), np.append(a, a), np.append(b, c))[a]
    found = []
    order = np.argsort(part, kind="stable")
    for some in np.split(order, np.flatnonzero(np.diff(part[order])) + 1) if len(part) else ():
        used, corners = np.unique(faces[some], return_inverse=True)
        found.append(_body(points[used], corners.reshape(-1, 3), normals[some]))
    return found


def bodies_of(meshes: Iterable[tuple[Floats, Indices]]) -> list[Obstacle]:
    """Bodies and sheets of meshes, given by corners and triangles."""
    return [body for mesh in meshes for body in _bodies(*mesh)]


def _body(points: Floats, faces: Indices, normals: Floats) -> Obstacle:
    count = len(points)
    directed = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    forth, back = directed @ [count, 1], directed @ [1, count]
    is_solid = len(np.unique(forth)) == len(forth) and np.array_equal(np.sort(forth), np.sort(back))
    size = float(np.ptp(points, axis=0).max())
    units = normals / np.linalg.norm(normals, axis=1)[:, None]
    # triangles in one plane are one face
    height = np.einsum("tk,tk->t", units, points[faces[:, 0]] - points[0]) / size
    planes = np.column_stack([units, height]).round(5) + 0.0
    _, first, owner = np.unique(planes, axis=0, return_index=True, return_inverse=True)
    owner = owner.ravel()
    if not is_solid:
        flat = np.abs((points - points[0]) @ units[0]).max() <= 1e-6 * size
        return Obstacle(points, faces, owner, normals[first], False, bool(flat))
    inner = points - points.mean(axis=0)
    if np.einsum("tk,tk->", inner[faces[:, 0]], normals) < 0.0:  # inside out
        return _body(points, faces[:, ::-1], -normals)
    # convex where no corner opposite to an edge is in front of the face at its other side
    order, other = np.argsort(forth), np.argsort(back)
    face = np.tile(np.arange(len(faces)), 3)
    opposite = np.concatenate([faces[:, (k + 2) % 3] for k in range(3)])
    mine, across = face[order], opposite[other]
    height = np.einsum("ek,ek->e", points[across] - points[faces[mine, 0]], units[mine])
    convex = bool((height <= 1e-6 * size).all())
    return Obstacle(points, faces, owner, normals[first], True, convex)


class Shadows:
    """The field of a source behind obstacles, for one variant's arrays."""

    def __init__(
        self,
        m: Any,
        spec: SourceSpec,
        wavelength: float,
        bodies: list[Obstacle],
        pose: Floats,
        reach: float,
    ) -> None:
        self._m, self._jit = m, dr.is_jit_v(m.Float)
        self._ops = ops_for(m.Float) if self._jit else NumpyOperations(double=True)
        self._inverse = opaque(m, spec.scene_unit / wavelength)
        try:
            source = spec.centred.at_origin
            points = radiating_points(source, wavelength, spec.obliquity, _ERROR, _MOST_POINTS)
            scale = spec.scene_unit / wavelength
            own = [in_frame(body, pose, scale) for body in bodies]
            obstacles, places = Obstacles(own), [point.place for point in points]
            seen = obstacles.silhouettes(places)
            shared = seen[-1] is seen[0]
            seen = [before_plane(silhouette) for silhouette in (seen[:1] if shared else seen)]
            tables, self._blockers = edge_tables(obstacles, points, seen, _ENDS)
        except ArgumentError as error:
            raise SceneError(f"with diffraction: {error}") from None
        self._obstacles = _scene_of(m, own)
        self._start = opaque(m, max(_BEHIND, ROUNDING * reach * scale))
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
        self._points, self._tables = rows, tables
        self._is_blocked = len(tables.triangles) > 0
        if self._jit:
            self._held = [self._ops.held(t.astype(np.float32)) for t in (rows, *tables)]
            self._ends = [m.UInt32(dr.opaque(m.UInt32, len(t))) for t in (rows, tables.groups)]

    def either(self, point: Any, plain: Callable[[Any], Any]) -> Any:
        """|U|^2 at a point in front; by ``plain``, without shadows, beside the source."""
        z, x, y = point.z, abs(point.x), abs(point.y)
        far = (z > self._near[2]) | (x > self._near[0]) | (y > self._near[1])
        if not self._jit:
            return self.intensity(point) if far else plain(point)
        return dr.if_stmt((point,), far, self.intensity, plain, mode="symbolic")

    def intensity(self, point: Any) -> Any:
        """|U|^2 at a point in front, in units of the scene; in the unit of |u|^2."""
        place = tuple(c * self._inverse for c in (point.x, point.y, point.z))
        # beside the boundaries of shadows and their corners, by more than rounding
        away = self._ops.sqrt(sum(c * c for c in place))
        place = tuple(c + _ASIDE * u * away for c, u in zip(place, ASIDE.tolist(), strict=True))
        real, imag = self._traced(place) if self._jit else self._plain(place)
        return real * real + imag * imag

    def _traced(self, place: Any) -> tuple[Any, Any]:
        m, ops = self._m, self._ops
        points, groups, edges, *_ = self._held
        zero = m.Float(0.0)

        def lit(number: Any, real: Any, imag: Any) -> Any:
            row = ops.gather(points, number)
            wave, ahead = self._wave(ops, row, place)
            hidden = self._hidden(row[:2], ahead)
            return (
                real + dr.select(hidden, 0.0, wave.real),
                imag + dr.select(hidden, 0.0, wave.imag),
            )

        def of_group(number: Any, real: Any, imag: Any) -> Any:
            group = ops.gather(groups, number)
            weight = self._transmission(group, place)

            def of_edge(number: Any, real: Any, imag: Any) -> Any:
                row = ops.gather(edges, number)

                def of_point(number: Any, real: Any, imag: Any) -> Any:
                    change = self._change(ops, ops.gather(points, number), row, place) * weight
                    return real + change.real, imag + change.imag

                def visible(real: Any, imag: Any) -> Any:
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

        def is_hit(number: Any, hits: Any) -> Any:
            row = ops.gather(triangles, number)
            shares = [dot(row[k : k + 3], ahead) for k in (0, 3, 6)]
            total = shares[0] + shares[1] + shares[2]
            sign = dr.select(total < 0.0, -1.0, 1.0)
            # the triangle's plane is before the place, which does not lie on it
            met = (row[9] * sign > 0.0) & (row[9] * sign < total * sign * (1.0 - _ENDS))
            for share in shares:
                met &= share * sign >= 0.0
            return (dr.select(met, 1.0, hits),)

        def over(number: Any, detour: Any, share: Any) -> Any:
            row = ops.gather(rims, number)
            path = group[:3], place, row[:3], row[3:6]
            longer, passed = transmission_over(ops, *path)
            return ops.minimum(longer, detour), ops.maximum(passed, share)

        def behind(real: Any, imag: Any) -> Any:
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

    def _plain(self, place: Any) -> tuple[float, float]:
        """The field at one place in a scalar variant, by NumPy."""
        total, ops = 0j, self._ops
        for row in self._points:
            wave, ahead = self._wave(ops, tuple(row), place)
            if not self._hidden(row[:2].tolist(), ahead):
                total += complex(wave.real, wave.imag)
        weights = [self._weight(blocker, place) for blocker in self._blockers]
        for (_, *values), weight in zip(self._tables.groups, weights, strict=True):
            table = self._tables.edges[int(values[6]) : int(values[7])]
            some = table[np.asarray(self._matters(ops, tuple(table.T), place), bool)]
            seen = [k for a, b in some[:, 10:].astype(int).tolist() for k in range(a, b)]
            if seen and abs(weight) > _FAINT:
                counts = (some[:, 11] - some[:, 10]).astype(int)
                rows = np.repeat(some, counts, axis=0)
                points = tuple(self._points[seen].T)
                change = self._change(ops, points, tuple(rows.T), place)
                total += weight * complex(np.sum(change.real), np.sum(change.imag))
        return total.real, total.imag

    def _weight(self, blocker: Blocker | None, place: Any) -> complex:
        if blocker is None:
            return 1.0
        point = np.array([[float(c) for c in place]])
        hidden = blocker.hides(point, _ENDS * np.linalg.norm(point, axis=1))
        found = blocker.transmission(self._ops, tuple(point.T), hidden)
        return complex(np.ravel(found.real)[0], np.ravel(found.imag)[0])

    def _wave(self, ops: Any, row: Any, place: Any) -> tuple[Pair, Any]:
        """The wave of a point of the source, relative to the phase of the distance from its frame's
        origin; and the path to the place."""
        ahead, turns = self._path(ops, row, place)
        return wave_ahead(ops, ahead, tuple(row[3:5]), tuple(row[5:7]), turns), ahead

    @staticmethod
    def _path(ops: Any, row: Any, place: Any) -> tuple[Any, Any]:
        """From a point of the source to a place, and cycles beyond the distance of the origin."""
        x, y, z = place
        a, b = row[:2]
        ahead = x - a, y - b, z
        way = ops.sqrt(ahead[0] * ahead[0] + ahead[1] * ahead[1] + z * z)
        turns = (a * (a - 2.0 * x) + b * (b - 2.0 * y)) / (way + ops.sqrt(x * x + y * y + z * z))
        return ahead, turns

    def _hidden(self, at: Any, ahead: Any) -> Any:
        m = self._m
        way = m.Vector3f(*ahead)
        part = self._start / way.z
        part = dr.select(part < 0.5, part, 0.5)
        distance = dr.norm(way)
        ray = m.Ray3f(m.Point3f(at[0], at[1], 0.0) + way * part, way / distance)
        ray.maxt = distance * (1.0 - part - _ENDS)
        return self._obstacles.ray_test(ray)

    def _matters(self, ops: Any, row: Any, place: Any) -> Any:
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

    def _when(self, condition: Any, compute: Callable[..., Any], *arguments: Any) -> Any:
        if not self._jit:
            return compute(*arguments)
        zero = self._m.Float(0.0)

        def taken(*parts: Any) -> tuple[Any, ...]:
            return tuple(flattened(compute(*rebuilt(arguments, parts))))

        # values of jets and their derivatives are arguments and results of their own
        count = 4 if self._is_oblique else 2
        state = tuple(flattened(arguments))
        parts = dr.if_stmt(state, condition, taken, lambda *_: (zero,) * count, mode="symbolic")
        if not self._is_oblique:
            return parts
        return Jet(self._ops, parts[0], parts[1:2]), Jet(self._ops, parts[2], parts[3:])


def in_frame(body: Obstacle, pose: Floats, scale: float) -> Obstacle:
    """A body in the frame of a pose, then scaled."""
    vertices = (body.vertices - pose[:3, 3]) @ pose[:3, :3] * scale
    return replace(body, vertices=vertices, normals=body.normals @ pose[:3, :3])


def _scene_of(m: Any, bodies: list[Obstacle]) -> Any:
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


def before_plane(seen: Silhouette) -> Silhouette:
    """The parts of edges before the plane of the source."""
    start, end = np.moveaxis(seen.edges, 1, 0)
    low, high = start[:, 2] - _BEHIND, end[:, 2] - _BEHIND
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = start + np.where(low == high, 0.0, low / (low - high))[:, None] * (end - start)
    first = np.where(low[:, None] < 0.0, cut, start)
    last = np.where(high[:, None] < 0.0, cut, end)
    kept = (np.maximum(low, high) > 0.0) & (np.linalg.norm(last - first, axis=1) > 0.0)
    return seen.taken(kept, np.stack([first, last], axis=1))


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
        pose[:3, 3] += pose[:3, :2] @ (spec.centred.centre / spec.scene_unit)
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
