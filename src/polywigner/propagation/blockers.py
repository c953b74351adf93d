"""Surfaces behind edges, which block the waves of these edges (SB6).

A point source illuminates an edge, and a surface is behind the edge. Behind that surface the wave
of the edge is the wave around a single edge, seen from the midpoint of the first: the least detour
over the rim of the surface sets its amplitude and phase.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry.contours import Surface, net_contours
from polywigner.geometry.parts import connected
from polywigner.geometry.silhouettes import Obstacles, Silhouette, hits
from polywigner.kernels.boundary.edge_waves import Point, cross, difference, dot, path_over
from polywigner.numerics.complex_pairs import Pair, unit_wave

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Asymptote of the wave around an edge: 1/(_STEEP sqrt(detour)) of the free wave, in wavelengths.
_STEEP = 2.0 * math.pi * math.sqrt(2.0)
# Detour in wavelengths at which this wave is cut down to 1/e. Waves over two edges are left out,
# except near the boundary of the second shadow, where they keep the field continuous.
_SECOND = 16.0
# Triangles of a body that is not convex, above which the face behind the edge stands for it.
_MOST_TRIANGLES = 256


@dataclass(frozen=True)
class Blocker:
    """The surface behind an edge. Lengths in wavelengths."""

    origin: Floats
    """(3,) midpoint of the edge."""
    triangles: Floats
    """(t, 3, 3) of the surface, facing the origin."""
    rim: Floats
    """(m, 2, 3) edges of the surface as the origin sees it."""

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
        """Amplitude at a point of the wave from the origin, over the free one."""
        detour, amplitude = 1e30, 0.0
        for edge in self.rim:
            origin, start, end = (tuple(p) for p in (self.origin, *edge))
            longer, share = transmission_over(ops, origin, point, start, end)
            detour, amplitude = ops.minimum(longer, detour), ops.maximum(share, amplitude)
        if not len(self.rim):
            return Pair(1.0, 0.0)
        wave = unit_wave(ops, detour).scaled(amplitude)
        return Pair(ops.select(hidden, wave.real, 1.0), ops.select(hidden, wave.imag, 0.0))


def transmission_over(
    ops: Any, source: Point, point: Point, start: Point, end: Point
) -> tuple[Any, Any]:
    """Detour of the shortest path over an edge, and amplitude of the wave around the edge."""
    detour, cosine = path_over(ops, source, point, start, end)
    # half of the angle by which the path bends, as in Kirchhoff's obliquity
    share = ops.sqrt(ops.maximum(0.5 + 0.5 * cosine, 0.0)) / (1.0 + _STEEP * ops.sqrt(detour))
    return detour, share * ops.exp(detour * (-1.0 / _SECOND))


def behind_face(
    ops: Any, source: Point, start: Point, end: Point, plane: Point, point: Point, margin: Any
) -> Any:
    """1 on the boundary of an edge's shadow behind a face, 0 in front of the plane of the face.

    In between d^2/(d^2 + a^2), with the distances d of the point from this plane, less a margin,
    and a from the plane of the source and the edge.
    """
    depth = ops.maximum(-(dot(plane, point) + plane[3]) - margin, 0.0)
    normal = cross(difference(start, source), difference(end, source))
    lateral = dot(normal, difference(point, source))
    square = depth * depth * dot(normal, normal)
    return square / ops.maximum(square + lateral * lateral, 1e-30)


# Nothing is behind an edge, or a surface of the body that the edge belongs to.
NO_SURFACE, OWN_SURFACE = -1, -2


@dataclass(frozen=True)
class BlockedEdges:
    """Edges of silhouettes by the surface behind them."""

    blockers: list[Blocker]
    groups: list[Indices]
    """For each silhouette, the number of the blocker of each edge; NO_SURFACE, OWN_SURFACE."""


def blocked_edges(bodies: Obstacles, seen: Sequence[Silhouette], source: Floats) -> BlockedEdges:
    """Return the blockers of the edges of silhouettes, seen from near one source (3,).

    Edges that the silhouettes have in common have one blocker.
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
    # the faces of a convex body block as one
    is_simple = np.array([body.is_simple for body in bodies.bodies])
    keys = np.column_stack([number[rows], np.where(is_simple[body], -1 - body, behind[rows])])
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    which = which.ravel()
    group[rows] = which
    length = np.linalg.norm(ends[rows, 1] - ends[rows, 0], axis=1)
    middle = 0.5 * ends[rows].sum(axis=1) * length[:, None]
    sums = [np.bincount(which, middle[:, k]) / np.bincount(which, length) for k in range(3)]
    planes = bodies.face_planes(source)
    blockers = []
    for k, origin in zip(first, np.stack(sums, axis=1), strict=True):
        plane = planes[behind[rows[k]]]
        numbers = np.flatnonzero(walls == walls[body[k]])
        flush = np.setdiff1d(bodies.flush_with(body[k], plane, planes), numbers)
        blockers.append(_blocker(bodies, numbers, flush, plane, origin))
    return BlockedEdges(blockers, _split(group, seen))


def shadow_lines(table: Floats) -> Floats:
    """Rows (k, 17) of the lines in which edges cast shadows on faces, in the opposite direction.

    ``table``: point of a source, seven numbers; ends of an edge; plane of the face behind.
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
    """The surface of some bodies behind a plane, as an edge with this midpoint sees it.

    ``flush``: other bodies in contact with these, which go on in the plane. Slits are closed.
    """
    if len(flush):
        nearer = plane - [0.0, 0.0, 0.0, bodies.contact]
        both = np.concatenate([numbers, flush]).tolist()
        surface = _in_plane(bodies.surface(both, origin, nearer), plane, 2.0 * bodies.contact)
        rim = net_contours(surface, origin, bodies.contact).ends
        return Blocker(origin, surface.corners, rim)
    surface = bodies.surface(numbers.tolist(), origin, plane)
    if len(numbers) == 1 and bodies.bodies[numbers[0]].is_simple:
        body = bodies.bodies[numbers[0]]
        return Blocker(origin, surface.corners, body.vertices[body.silhouette(origin)])
    if len(surface.faces) > _MOST_TRIANGLES:
        extent = float(np.ptp(surface.corners.reshape(-1, 3), axis=0).max())
        surface = _in_plane(surface, plane, 1e-9 * extent)
    return Blocker(origin, surface.corners, net_contours(surface, origin).ends)


def _in_plane(surface: Surface, plane: Floats, within: float) -> Surface:
    height = np.abs(surface.corners @ plane[:3] + plane[3]).max(axis=1)
    return surface.taken(height <= within)
