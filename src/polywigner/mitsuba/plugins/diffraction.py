"""Field of a source behind obstacles, with diffraction at their edges.

The field is the sum of the waves of the visible radiating points and of the boundary waves of the
edges, (SB3) of docs/theory/shadows.md. Lengths are in wavelengths, in the source's frame.
"""

from __future__ import annotations

import hashlib
import logging
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
from polywigner.geometry.contours import Silhouette
from polywigner.geometry.silhouettes import Obstacle, Obstacles
from polywigner.kernels.boundary import edge_waves
from polywigner.kernels.boundary.edge_waves import difference, dot
from polywigner.mitsuba.plugins.exact_field import AWAY, ExactEstimator
from polywigner.mitsuba.plugins.films import changed
from polywigner.mitsuba.plugins.registration import scene_errors, set_mesh
from polywigner.mitsuba.plugins.samplers import opaque, single_number
from polywigner.mitsuba.plugins.shadow_tables import (
    EdgeTables,
    NodeTables,
    edge_tables,
    node_tables,
)
from polywigner.mitsuba.plugins.source_parameters import SourceParameters, reach_of
from polywigner.mitsuba.scenes import surfaces
from polywigner.numerics.jets import Jet, flattened, rebuilt
from polywigner.numerics.phases import Pair, unit_wave
from polywigner.propagation import equivalent_points, shadows
from polywigner.propagation.equivalent_points import dipole_obliquity
from polywigner.propagation.source_nodes import (
    EDGE_AMPLITUDE,
    SourceNodes,
    all_points,
    nodes_for,
)

Floats = NDArray[np.float64]
Values = tuple[Drjit, ...]
Point = tuple[Drjit, Drjit, Drjit]
Field = tuple[Drjit, Drjit]
"""Real and imaginary parts of a field."""
NodeWave = Callable[[Drjit], Values]
"""Function from a node's index to the node's wave at a point."""

# Allowed error of the far-field pattern |F|^2, relative to its peak. The approximation of single
# diffraction has a larger error.
_ERROR = 3e-4
# Largest number of radiating points of a source. Each sample traces one ray per point.
_MOST_POINTS = 1024
# Quadrature rules for edges near a shadow boundary, and for other edges. The largest errors for
# random edges are 9e-6 and 7e-6 of the wave without obstacles.
_RULE, _FAR_RULE = edge_waves.EdgeRule.of(2.0, 16, 2), edge_waves.EdgeRule.of(0.8, 9, 3)
# Edges that contribute less than _FAINT to |U|^2 are ignored. Their contribution is estimated with
# |U| of the free field, or with _WEAK if this |U| is smaller. Both constants are fractions of the
# peak values without obstacles.
_FAINT, _WEAK = 4e-5, 0.1
# Largest rounding error of the excess, as a fraction of the detour via the edge. The excess is the
# additional length of a path over an end of an edge, compared with the shortest path over the line
# of the edge.
_ROUNDED = 0.01
# _FEW_FACES is the largest product of the numbers of faces and radiating points for which each
# radiating point can have a separate silhouette. _MOST_FACES is the largest product of the numbers
# of faces and nodes for which each node has a separate silhouette.
_FEW_FACES, _MOST_FACES = 1 << 15, 1 << 17
# Amplitude transmission of a surface below which the surface counts as opaque.
_OPAQUE = 2e-3
# Shift of illuminated points, as a fraction of their distance from the source's centre. The shift
# keeps the points off shadow boundaries despite rounding to single precision.
_ASIDE = 1e-6
# _ENDS is the tolerance for positions on a surface, as a fraction of their distance from the
# source's centre. _SHORT is the gap between the end of a ray and a surface, as a fraction of the
# ray's length. Both fractions exceed the rounding error of single precision, even at grazing
# incidence.
_ENDS, _SHORT = 1e-5, 4e-5
# Relative tolerance of fields in scalar variants.
_HOST_ERROR = 1e-4

_log = logging.getLogger("polywigner.mitsuba")


class _Edge(NamedTuple):
    """Edge, and the shortest path from the source's centre to a point via the edge."""

    row: Drjit
    """Row of the edge in ``EdgeTables.edges``."""
    detour: Drjit
    foot: Drjit
    """Position of the bend, as a fraction of the edge's length."""


class Shadows:
    """Field of a source behind obstacles, for one variant of Mitsuba."""

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
        with scene_errors("cannot compute diffraction: ", ArgumentError):
            points = equivalent_points.radiating_points(
                spec.at_origin, wavelength, spec.obliquity, _ERROR, _MOST_POINTS
            )
            bodies = [surfaces.in_frame(body, pose, scale) for body in bodies]
            obstacles = Obstacles(bodies)
            nodes, silhouettes = _nodes_and_silhouettes(obstacles, points)
            tables = edge_tables(obstacles, nodes, silhouettes, _ENDS)
        faces = sum(len(body.triangles) for body in bodies)
        numbers = faces, len(tables.edges), len(nodes.positions), len(points)
        _log.info("shadows: %d faces, %d edges, %d nodes of %d points", *numbers)
        if len(silhouettes) < len(nodes.positions):
            bodies = [body.spanned(nodes.centre) for body in bodies]
        self._obstacles = _scene_of(m, bodies)
        self._start = opaque(m, max(surfaces.BEHIND, surfaces.ROUNDING * reach * scale))
        self._centre = tuple(nodes.centre.tolist())
        near = np.abs(nodes.origins).max(axis=0) + AWAY
        self._near = [opaque(m, value) for value in (near / scale).tolist()]
        self._is_oblique = any(point.field for point in points)
        # A single node has no interference pattern, only its obliquity factor.
        self._is_single = self._is_oblique and len(nodes.positions) == 1
        self._is_blocked = len(tables.triangles) > 0
        if self._jit:
            self._load(nodes, tables)
        else:
            seen = [surfaces.before_plane(s) for s in obstacles.silhouettes(list(nodes.origins))]
            self._on_host = partial(
                shadows.diffracted, obstacles, points, seen, tolerance=_HOST_ERROR
            )

    def intensity_or_free(self, point: mi.Point3f, free: Callable[[mi.Point3f], Drjit]) -> Drjit:
        """Return |U|^2 at a point in front of the source.

        The point is in the source's frame, in scene units. Within about three wavelengths of the
        source, ``free(point)`` computes |U|^2 without obstacles.
        """
        z, x, y = point.z, abs(point.x), abs(point.y)
        far = (z > self._near[2]) | (x > self._near[0]) | (y > self._near[1])
        if not self._jit:
            return self.intensity(point) if far else free(point)
        return dr.if_stmt((point,), far, self.intensity, free, mode="symbolic")

    def intensity(self, point: mi.Point3f) -> Drjit:
        """Return |U|^2 behind obstacles at a point, for a source with |u|^2 = 1.

        The point is in the source's frame, in scene units.
        """
        at = tuple(c * self._inverse for c in (point.x, point.y, point.z))
        if not self._jit:
            # The factor moves the point slightly towards the source, so that rounding does not put
            # a point on a surface behind this surface.
            change, free, _ = self._on_host(
                positions=(1.0 - _ENDS) * np.array([at]), engine="numpy"
            )
            return float(np.abs(free + change)[0] ** 2)
        away = self._ops.sqrt(sum(c * c for c in at))
        x, y, z = (c + _ASIDE * u * away for c, u in zip(at, shadows.ASIDE.tolist(), strict=True))
        real, imag = self._field((x, y, z))
        return real * real + imag * imag

    def _load(self, nodes: SourceNodes, tables: EdgeTables) -> None:
        """Copy the tables to the device, and set the numbers of nodes, groups and points."""
        m, ops = self._m, self._ops
        every = *node_tables(nodes), *tables
        names = (*NodeTables._fields, *EdgeTables._fields)
        self._tables = {
            name: ops.on_device(table.astype(np.float32))
            for name, table in zip(names, every, strict=True)
        }
        counts = len(nodes.positions), len(tables.groups), len(nodes.points)
        self._counts = [m.UInt32(dr.opaque(m.UInt32, count)) for count in counts]
        self._few_nodes = len(nodes.positions) if nodes.is_reduced else 0
        self._inverse_peak = opaque(m, 1.0 / nodes.peak)
        self._has_edges = len(tables.edges) > 0  # A body around the source has no silhouette.

    def _field(self, at: Point) -> Field:
        """Return the complex field with obstacles at a point in wavelengths, for |u|^2 = 1.

        The phase due to the distance from the source's centre is omitted.
        """
        m, ops = self._m, self._ops
        wave_of = self._waves_of_nodes(at)

        def add_node(number: Drjit, real: Drjit, imag: Drjit, *free: Drjit) -> tuple[Drjit, ...]:
            """Add the wave of a node, with and without obstacles, to the sums of waves."""
            row = ops.gather(self._tables["nodes"], number)
            parts = wave_of(number)
            hidden = self._hidden(row, self._path(row, at)[0])
            return (
                real + dr.select(hidden, 0.0, parts[0]),
                imag + dr.select(hidden, 0.0, parts[1]),
                free[0] + parts[0],
                free[1] + parts[1],
            )

        zero = m.Float(0.0)
        *field, real, imag = ops.fold(0, self._counts[0], (zero,) * 4, add_node)
        if not self._has_edges:
            return field
        level = ops.sqrt((real * real + imag * imag) * dot(at, at)) * self._inverse_peak
        # Square of the relative amplitude below which an edge wave is ignored.
        faint = (_FAINT / ops.maximum(level, _WEAK)) ** 2

        def add_group(number: Drjit, real: Drjit, imag: Drjit) -> Field:
            """Add the changes of the field that the edges of a group cause."""
            group = ops.gather(self._tables["groups"], number)
            weight = self._transmission(group, at)

            def add_edge(number: Drjit, real: Drjit, imag: Drjit) -> Field:
                """Add the change of the field that an edge causes, unless the change is faint."""
                row = ops.gather(self._tables["edges"], number)
                centre = tuple(m.Float(c) for c in self._centre)
                detour, _, foot, excess = edge_waves.path_over(ops, centre, at, row[:3], row[3:6])
                # The wave from an end of an edge has the amplitude EDGE_AMPLITUDE sqrt(1/excess -
                # 1/detour), relative to the wave of a long edge.
                least = faint * detour * ops.maximum(excess * EDGE_AMPLITUDE**-2, 1.0)
                fraction = dr.select(detour < row[16], 1.0, 1.0 + _ROUNDED - excess / detour)
                edge = _Edge(row, detour, foot)

                def add_waves(real: Drjit, imag: Drjit) -> Field:
                    """Add the change of the field that the edge causes."""
                    change = self._edge_change(edge, at, wave_of) * weight
                    return real + change.real, imag + change.imag

                return self._if(row[18] * fraction > least, add_waves, (real, imag))

            first, end = m.UInt32(group[7]), m.UInt32(group[8])
            end = dr.select(weight.norm() > _OPAQUE**2, end, first)
            return ops.fold(first, end, (real, imag), add_edge)

        return ops.fold(0, self._counts[1], field, add_group)

    def _waves_of_nodes(self, at: Point) -> NodeWave:
        """Return a function that returns the wave of a node at a point, given the node's index.

        The function returns the real and imaginary parts of the wave, followed by the parts of its
        dipole contribution, if any.
        """
        m, ops, count = self._m, self._ops, self._few_nodes

        def radiated(number: Drjit) -> tuple[Values, Values]:
            """Return a radiating point's wave, and the fraction of it that each node represents."""
            row = ops.gather(self._tables["points"], number)
            ahead, turns = self._path(row, at)
            wave = equivalent_points.wave_ahead(ops, ahead, row[3:5], row[5:7], turns)
            parts = [wave.real, wave.imag]
            if self._is_oblique:
                dipole = equivalent_points.spherical_wave(ops, ahead, turns) * Pair(*row[3:5])
                parts += [dipole.real, dipole.imag]
            return tuple(parts), row[8 : 8 + count]

        if not count:
            return lambda number: radiated(number)[0]
        width = 4 if self._is_oblique else 2

        def add_point(number: Drjit, *sums: Drjit) -> Values:
            """Add the wave of a radiating point to the waves of all nodes."""
            parts, fractions = radiated(number)
            products = (part * fraction for fraction in fractions for part in parts)
            return tuple(a + b for a, b in zip(sums, products, strict=True))

        sums = ops.fold(0, self._counts[2], (m.Float(0.0),) * (width * count), add_point)
        waves = [sums[start : start + width] for start in range(0, len(sums), width)]

        def wave_of(number: Drjit) -> Values:
            """Return the wave of the node at an index."""
            chosen = waves[0]
            for k, wave in enumerate(waves[1:], 1):
                chosen = tuple(map(partial(dr.select, number == k), wave, chosen))
            return chosen

        return wave_of

    def _edge_change(self, edge: _Edge, at: Point, wave_of: NodeWave) -> Pair:
        """Return the change in the field that an edge causes.

        Near a shadow boundary, each boundary wave is weighted by the node's wave at the point.
        Elsewhere, the weight is the node's wave at the edge.
        """
        m, row = self._m, edge.row
        span = m.UInt32(row[10]), m.UInt32(row[11])

        def near(real: Drjit, imag: Drjit) -> Field:
            """Add the changes of the field, weighted by the nodes' waves at the point."""
            return self._summed(span, partial(self._change_at, wave_of), edge, at, (real, imag))

        def far(real: Drjit, imag: Drjit) -> Field:
            """Add the changes of the field, weighted by the nodes' waves at the edge."""
            by_centre = edge.detour > row[17]
            last = m.UInt32(self._counts[0])
            ends = dr.select(by_centre, last, span[0]), dr.select(by_centre, last + 1, span[1])
            return self._summed(ends, self._change_from, edge, at, (real, imag))

        zero = m.Float(0.0)
        is_near = edge.detour < row[16]
        return Pair(*dr.if_stmt((zero, zero), is_near, near, far, mode="symbolic"))

    def _summed(
        self,
        span: tuple[Drjit, Drjit],
        change_of: Callable[[Drjit, _Edge, Point], Pair],
        edge: _Edge,
        at: Point,
        start: Field,
    ) -> Field:
        """Return ``start`` plus the changes of the field that an edge causes, for a span of nodes.

        ``change_of(node, edge, at)`` returns the change of the wave of one node at a point.
        """

        def add(number: Drjit, real: Drjit, imag: Drjit) -> Field:
            """Add the change of the wave of one node."""
            change = change_of(number, edge, at)
            return real + change.real, imag + change.imag

        total: Field = self._ops.fold(*span, start, add)
        return total

    def _change_at(self, wave_of: NodeWave, number: Drjit, edge: _Edge, at: Point) -> Pair:
        """Return the change in a node's wave due to an edge, weighted by the wave at the point."""
        node = self._ops.gather(self._tables["nodes"], number)
        real, imag, *dipole = wave_of(number)
        of_dipole = Pair(*dipole) if self._is_oblique else None
        path, blocked = self._boundary(node, number, edge, at)
        return self._changed(_RULE, path, Pair(real, imag), of_dipole, blocked)

    def _change_from(self, number: Drjit, edge: _Edge, at: Point) -> Pair:
        """Return the change in a node's wave due to an edge, weighted by the wave at the edge."""
        ops, row = self._ops, edge.row
        node = ops.gather(self._tables["nodes"], number)
        path, blocked = self._boundary(node, number, edge, at)
        weight, dipole = self._wave_at_edge(number, edge)
        ahead, turns = self._path(node, at)
        wave = equivalent_points.spherical_wave(ops, ahead, turns)
        if not self._is_single:
            return self._changed(_FAR_RULE, path, wave * weight, None, blocked)
        foot = tuple(a + edge.foot * (b - a) for a, b in zip(row[:3], row[3:6], strict=True))
        weight = weight + dipole * dipole_obliquity(ops, ahead)
        weight = weight - dipole * dipole_obliquity(ops, difference(foot, path[0]))
        return self._changed(_FAR_RULE, path, wave * weight, wave * dipole, blocked)

    def _changed(
        self,
        rule: edge_waves.EdgeRule,
        path: Sequence[Point],
        wave: Pair,
        dipole: Pair | None,
        blocked: Any,
    ) -> Pair:
        """Return the change of a wave due to an edge; see :func:`edge_waves.edge_change`."""
        when = self._when if dipole is None else self._when_jets
        how = {"when": when, "blocked": blocked}
        return edge_waves.edge_change(self._ops, rule, wave, dipole, *path, **how)[0]

    def _wave_at_edge(self, number: Drjit, edge: _Edge) -> tuple[Pair, Pair]:
        """Return the wave of a node at an edge, and its dipole contribution without obliquity.

        Both values are relative to a unit spherical wave from the node.
        """
        m, row = self._m, edge.row
        along = edge.foot * row[15]
        interval = m.UInt32(dr.minimum(along, row[15] - 1.0))
        first = m.UInt32(row[14]) + interval * (self._counts[0] + 1)
        sample = self._ops.gather(self._tables["samples"], first + number)
        part = along - m.Float(interval)
        real, imag = (a + part * (b - a) for a, b in zip(sample[:2], sample[2:4], strict=True))
        return Pair(real, imag), Pair(*sample[4:6])

    def _boundary(
        self, node: Drjit, number: Drjit, edge: _Edge, at: Point
    ) -> tuple[tuple[Point, ...], Any]:
        """Return the node, the point and the ends of an edge, and the blocked part of its wave.

        ``node`` is the row of the node, and ``number`` is its index, which selects the ends of the
        edge. The blocked part is None if no face of the scene blocks boundary waves.
        """
        m, ops, row = self._m, self._ops, edge.row
        step = m.UInt32(row[13])
        ends = ops.gather(self._tables["ends"], m.UInt32(row[12]) + number * step)
        source, start, end = (node[0], node[1], 0.0 * node[0]), ends[:3], ends[3:6]
        blocked = None
        if self._is_blocked:
            blocked = shadows.behind_face(ops, source, start, end, row[6:10], at, 0.0)
        return (source, at, start, end), blocked

    @staticmethod
    def _if(condition: Drjit, compute: Callable[..., Any], state: Any) -> Any:
        """Return ``compute(*state)`` where a condition is true, and ``state`` elsewhere."""
        return dr.if_stmt(state, condition, compute, lambda *state: state, mode="symbolic")

    def _transmission(self, group: Drjit, at: Point) -> Pair:
        """Return the complex amplitude transmission from a group of edges to a point."""
        m, ops = self._m, self._ops
        free = m.Float(1.0), m.Float(0.0)
        if not self._is_blocked:
            return Pair(*free)
        triangles, rims = self._tables["triangles"], self._tables["rims"]
        ahead = difference(at, group[:3])
        margin = _ENDS * ops.sqrt(dot(at, at))

        def is_hit(number: Drjit, hits: Drjit) -> tuple[Drjit]:
            """Return 1 if the line to the point meets a triangle, otherwise ``hits``."""
            row = ops.gather(triangles, number)
            shares = [dot(row[k : k + 3], ahead) for k in (0, 3, 6)]
            total = shares[0] + shares[1] + shares[2]
            sign = dr.select(total < 0.0, -1.0, 1.0)
            hit = (row[9] * sign > 0.0) & ((total - row[9]) * sign > margin)
            for share in shares:
                hit &= share * sign >= 0.0
            return (dr.select(hit, 1.0, hits),)

        def over(number: Drjit, detour: Drjit, share: Drjit) -> Field:
            """Update the least detour and the largest transmission with another rim edge."""
            row = ops.gather(rims, number)
            longer, passed = shadows.transmission_over(ops, group[:3], at, row[:3], row[3:6])
            return ops.minimum(longer, detour), ops.maximum(passed, share)

        def behind(real: Drjit, imag: Drjit) -> Field:
            """Return the transmission for a point behind the plane of the face."""
            span = m.UInt32(group[9]), m.UInt32(group[10])
            (hits,) = ops.fold(*span, (m.Float(0.0),), is_hit)
            first, end = m.UInt32(group[11]), m.UInt32(group[12])
            end = dr.select(hits > 0.5, end, first)
            detour, share = ops.fold(first, end, (m.Float(1e6), m.Float(0.0)), over)
            wave = unit_wave(ops, detour).scaled(share)
            return dr.select(hits > 0.5, wave.real, real), dr.select(hits > 0.5, wave.imag, imag)

        return Pair(*self._if(dot(group[3:6], at) + group[6] < 0.0, behind, free))

    def _path(self, row: Drjit, at: Point) -> tuple[Point, Drjit]:
        """Return the vector from a node or radiating point to ``at``, and its length minus |at|.

        ``row`` starts with the x and y coordinates of the node or radiating point.
        """
        ops, (x, y, z) = self._ops, at
        a, b = row[:2]
        ahead = x - a, y - b, z
        length = ops.sqrt(ahead[0] * ahead[0] + ahead[1] * ahead[1] + z * z)
        sum_ = length + ops.sqrt(x * x + y * y + z * z)
        return ahead, (a * (a - 2.0 * x) + b * (b - 2.0 * y)) / sum_

    def _hidden(self, row: Drjit, ahead: Point) -> Drjit:
        """Return whether obstacles block the line of sight from a node to node + ``ahead``."""
        m = self._m
        path = m.Vector3f(*ahead)
        part = self._start / path.z
        part = dr.select(part < 0.5, part, 0.5)
        distance = dr.norm(path)
        ray = m.Ray3f(m.Point3f(row[0], row[1], 0.0) + path * part, path / distance)
        ray.maxt = distance * (1.0 - part - _SHORT)
        return self._obstacles.ray_test(ray)

    def _when(self, condition: Drjit, compute: Callable[..., Any], *arguments: Any) -> Field:
        """Return ``compute(*arguments)`` where a condition is true, and zeros elsewhere."""
        zeros = (self._m.Float(0.0),) * 2
        return dr.if_stmt(arguments, condition, compute, lambda *_: zeros, mode="symbolic")

    def _when_jets(
        self, condition: Drjit, compute: Callable[..., Any], *arguments: Any
    ) -> tuple[Jet, Jet]:
        """Apply `_when` to a function whose arguments and results have derivatives."""

        def flat(*parts: Drjit) -> tuple[Drjit, ...]:
            """Evaluate ``compute`` for flattened arguments, and flatten its results."""
            return tuple(flattened(compute(*rebuilt(arguments, parts))))

        zeros = (self._m.Float(0.0),) * 4
        state = tuple(flattened(arguments))
        parts = dr.if_stmt(state, condition, flat, lambda *_: zeros, mode="symbolic")
        return Jet(self._ops, parts[0], parts[1:2]), Jet(self._ops, parts[2], parts[3:])


def _nodes_and_silhouettes(
    obstacles: Obstacles, points: Sequence[equivalent_points.RadiatingPoint]
) -> tuple[SourceNodes, list[Silhouette]]:
    """Return the nodes of a source, and either a single silhouette or one per node."""
    every = all_points(points)
    central = surfaces.before_plane(obstacles.silhouette(every.centre))
    nodes = nodes_for(points, central.edges)
    faces = sum(len(body.triangles) for body in obstacles.bodies)
    if faces * len(nodes.positions) > _MOST_FACES:
        return nodes, [central]
    seen = [obstacles.silhouette(position) for position in nodes.positions]
    is_small = faces * len(points) <= _FEW_FACES
    if is_small and not all(silhouette.is_like(seen[0]) for silhouette in seen):
        nodes, seen = every, [obstacles.silhouette(position) for position in every.positions]
    return nodes, [surfaces.before_plane(silhouette) for silhouette in seen]


def _scene_of(m: Any, bodies: list[Obstacle]) -> mi.Scene:
    """Return a scene for ray tests that contains all bodies as one mesh."""
    counts = np.cumsum([0, *(len(body.vertices) for body in bodies)])
    vertices = np.concatenate([body.vertices for body in bodies])
    faces = np.concatenate([body.triangles + n for body, n in zip(bodies, counts, strict=False)])
    mesh = m.Mesh("obstacles", len(vertices), len(faces))
    set_mesh(mesh, vertex_positions=vertices, faces=faces)
    return mi.load_dict({"type": "scene", "mesh": mesh})


def cast_shadows(scene: mi.Scene) -> None:
    """Set the scene's obstacles for all sources and receivers with diffraction.

    Raises SceneError if a source or receiver has diffraction and the scene contains fog.
    """
    plugins = [
        p for p in (*surfaces.sorted_emitters(scene), *scene.sensors()) if hasattr(p, "estimator")
    ]
    plugins = [plugin for plugin in plugins if plugin.spec.diffraction]
    if plugins and any(shape.is_medium_transition() for shape in scene.shapes()):
        raise SceneError(
            "diffraction is not supported in a scene with fog; remove the fog, or omit diffraction"
        )
    meshes_at = cache(lambda wavelength: list(surfaces.meshes_in(scene, wavelength)))
    for plugin in plugins:
        spec, pose = plugin.spec, np.array(surfaces.matrix_of(plugin.to_world))
        wavelength = single_number(getattr(plugin, "wavelength", spec.wavelength), "wavelength")
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
    """Pass the scene to receivers, and obstacles to plugins with diffraction, in a ``with`` block.

    The obstacles remain set after the block.
    """
    cast_shadows(scene)
    for plugin in (*scene.emitters(), *scene.sensors()):
        if hasattr(plugin, "stand_at"):
            plugin.stand_at(reach_of(scene, plugin))
    scenes = [
        (sensor, "scene", scene) for sensor in scene.sensors() if surfaces.is_receiver(sensor)
    ]
    # Freeing a scene while Dr.Jit records a kernel crashes the process.
    with without_collection(), changed([(ExactEstimator, "scene_is_known", True), *scenes]):
        yield
