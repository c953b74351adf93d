"""Silhouettes of opaque bodies and plates, seen from a point: the edges of the shadow they cast.

The silhouette of a convex body is the set of edges between a face towards the source and a face
away from it; that of a plate is its boundary. Bodies that hide each other or parts of themselves
have the net contours of their visible surfaces (docs/theory/shadows.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.aperture import PlacedAperture
from polywigner.geometry.contours import Silhouette, Surface, net_contours
from polywigner.geometry.obstacles import ON, PAIRS, Obstacle, contacts, obstacle_of, shells
from polywigner.geometry.parts import connected
from polywigner.geometry.polyhedron import Polyhedron, windings_about

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Faces times points of a source, beyond which these share the silhouette that their middle sees.
_MOST_FACES = 1 << 15
# Cones around bodies are wider by this angle, in rad: beyond rounding.
_WIDER = 1e-6
# Winding number of bodies about a point inside them, less rounding.
_IN = 0.9975
# Bodies this close together are one, in wavelengths: a narrower slit passes no light to speak of.
# Also as a fraction of their extent, for coordinates in single precision.
_CLOSED, _ROUNDED = 0.05, 1e-6
# Components of the normals of faces in one plane differ by less.
_SKEW = 1e-5


_NOTHING_BEHIND = np.array([0.0, 0.0, 0.0, 1.0])


def bodies_if_any(bodies: Any) -> tuple[Polyhedron | PlacedAperture, ...]:
    """Obstacles as a tuple, see :func:`listed_bodies`; () for None and for no obstacles."""
    is_none = bodies is None or (isinstance(bodies, (list, tuple)) and not bodies)
    return () if is_none else listed_bodies(bodies)


def listed_bodies(bodies: Any) -> tuple[Polyhedron | PlacedAperture, ...]:
    """One or several obstacles, Polyhedra or apertures in a pose, as a tuple."""
    listed = tuple(bodies) if isinstance(bodies, (list, tuple)) else (bodies,)
    if not listed:
        raise ArgumentError("expected at least one obstacle, got none; leave obstacles out")
    for body in listed:
        if not isinstance(body, (Polyhedron, PlacedAperture)):
            raise ArgumentError(
                "expected obstacles as Polyhedra and placed apertures, got "
                f"{type(body).__name__}; place an Aperture by its method placed"
            )
        if isinstance(body, PlacedAperture) and body.aperture.illumination is not None:
            raise ArgumentError(
                "expected obstacles without illuminations, got an aperture with one; "
                "pass its outline alone"
            )
    return listed


def obstacles_of(bodies: Any, unit: float) -> Obstacles:
    """The obstacles that a user lists, in units of ``unit`` metres."""
    found = [shell for body in listed_bodies(bodies) for shell in shells(obstacle_of(body))]
    return Obstacles([replace(body, vertices=body.vertices / unit) for body in found])


@dataclass(frozen=True)
class Obstacles:
    """Opaque bodies and plates in space, with the questions that light asks of them."""

    bodies: list[Obstacle]

    @cached_property
    def vertices(self) -> Floats:
        """(n, 3) of all bodies."""
        return np.concatenate([body.vertices for body in self.bodies])

    def beyond(self, source: Floats, points: Floats) -> NDArray[np.bool_]:
        """Whether points (n, 3) are farther from a source than all bodies, and none is behind it.

        The line through the source and such a point meets bodies between these two only.
        """
        rays, (axis, angle) = points - source, _cone(self.vertices - source)
        away = np.linalg.norm(rays, axis=1)
        reach = np.linalg.norm(self.vertices - source, axis=1).max()
        return (away > reach) & (rays @ -axis < np.cos(min(angle + _WIDER, np.pi)) * away)

    def silhouettes(self, sources: Sequence[Floats]) -> list[Silhouette]:
        """Return silhouettes for places (k, 3) of one source; of a large mesh one for all."""
        if len(sources) * sum(len(body.triangles) for body in self.bodies) > _MOST_FACES:
            return [self.silhouette(np.mean(sources, axis=0))] * len(sources)
        return [self.silhouette(place) for place in sources]

    def silhouette(self, source: Floats) -> Silhouette:
        """Return the edges of the shadows that all bodies cast, seen from a source (3,)."""
        alone = self._alone(source)
        parts = [self._mesh_silhouette(number, source) for number in np.flatnonzero(alone).tolist()]
        if not alone.all():
            parts.append(
                net_contours(self.surface(np.flatnonzero(~alone).tolist(), source), source)
            )
        seen = Silhouette.of(parts)
        planes = np.tile(_NOTHING_BEHIND, (len(seen.edges), 1))
        (rows,) = np.nonzero(seen.behind >= 0)
        if len(rows):
            planes[rows] = self.face_planes(source)[seen.behind[rows]]
        return replace(seen, planes=planes)

    def _mesh_silhouette(self, number: int, source: Floats) -> Silhouette:
        body = self.bodies[number]
        ends = body.silhouette(source)
        own, none = np.full(len(ends), number), np.full(len(ends), -1)
        return Silhouette(body.vertices[ends], self._edge_numbers(number, ends), own, none)

    def _alone(self, source: Floats) -> NDArray[np.bool_]:
        """Return a mask of the bodies that hide no part of another or of themselves."""
        cones = [_cone(body.vertices - source) for body in self.bodies]
        axes = np.array([axis for axis, _ in cones])
        angles = np.array([angle for _, angle in cones])
        alone = np.array([body.is_simple for body in self.bodies])
        for k in range(1, len(cones)):
            apart = np.arccos(np.clip(axes[:k] @ axes[k], -1.0, 1.0)) > angles[:k] + angles[k]
            alone[:k] &= apart
            alone[k] &= apart.all()
        return alone

    @cached_property
    def contact(self) -> float:
        """Distance up to which bodies are in contact."""
        return max(_CLOSED, _ROUNDED * float(np.ptp(self.vertices, axis=0).max()))

    @cached_property
    def contacts(self) -> Indices:
        """Pairs (n, 2) of bodies that touch, cross or contain each other, or almost touch."""
        pairs = contacts(
            [body.vertices[body.triangles] for body in self.bodies],
            [body.rim for body in self.bodies],
            self.contact,
        )
        # bodies of which a place is in another one
        places = np.array([body.vertices[0] for body in self.bodies])
        numbers = range(len(self.bodies))
        own = np.array([self._turns(places[[k]], [k])[0] for k in numbers])
        (inner,) = np.nonzero(self._turns(places, numbers) - own > _IN)
        for k in numbers if len(inner) else ():
            within = inner[self._turns(places[inner], [k]) > _IN].tolist()
            pairs += [(k, number) for number in within if number != k]
        return np.unique(np.sort(np.array(pairs, np.intp).reshape(-1, 2), axis=1), axis=0)

    def are_one(self, one: Indices, other: Indices) -> NDArray[np.bool_]:
        """Whether bodies (n,) and (n,) are the same or in contact."""
        keys = (self.contacts @ [[len(self.bodies), 1], [1, len(self.bodies)]]).ravel()
        return np.asarray((one == other) | np.isin(one * len(self.bodies) + other, keys))

    @cached_property
    def groups(self) -> Indices:
        """Numbers (k,) that bodies have in common which contacts connect."""
        return connected(len(self.bodies), *self.contacts.T)

    @cached_property
    def _first_faces(self) -> Indices:
        return np.cumsum([0, *(len(body.normals) for body in self.bodies)])

    @cached_property
    def _first_edges(self) -> Indices:
        return np.cumsum([0, *(len(body.vertices) ** 2 for body in self.bodies)])

    def _edge_numbers(self, number: int, ends: Indices) -> Indices:
        """Numbers of the edges between vertices (..., 2) of a body, of all bodies."""
        low, high = ends.min(axis=-1), ends.max(axis=-1)
        count = len(self.bodies[number].vertices)
        return np.asarray(self._first_edges[number] + low * count + high)

    def body_of_face(self, faces: Indices) -> Indices:
        """Numbers of the bodies of faces."""
        return np.searchsorted(self._first_faces, faces, side="right") - 1

    def face_planes(self, source: Floats) -> Floats:
        """Planes (f, 4) of all faces, at whose positive side the source is."""
        rows = []
        for body in self.bodies:
            normals = body.normals / np.linalg.norm(body.normals, axis=1)[:, None]
            first = np.zeros(len(normals), np.intp)
            first[body.owner[::-1]] = body.triangles[::-1, 0]
            places = body.vertices[first]
            normals *= np.where(np.einsum("fk,fk->f", normals, source - places) < 0, -1.0, 1.0)[
                :, None
            ]
            rows.append(np.column_stack([normals, -np.einsum("fk,fk->f", normals, places)]))
        return np.concatenate(rows)

    def flush_with(self, body: int, plane: Floats, planes: Floats) -> Indices:
        """Numbers of bodies that contacts connect to a body, and that go on in a plane of its face.

        ``planes``: (f, 4) of all faces.
        """
        (group,) = np.nonzero(self.groups == self.groups[body])
        if len(group) == 1:
            return group
        flush = np.abs(planes - plane) <= [_SKEW, _SKEW, _SKEW, self.contact]
        return np.intersect1d(group, self.body_of_face(np.flatnonzero(flush.all(axis=1))))

    def surface(
        self, numbers: Sequence[int], source: Floats, plane: Floats | None = None
    ) -> Surface:
        """Return the triangles of some bodies that face a source.

        ``plane``: only those behind it, with the source in front of their own planes.
        """
        parts = []
        for number in numbers:
            body = self.bodies[number]
            facing = body.facing(source)
            if plane is not None:
                low = body.vertices @ plane[:3] + plane[3]
                size = float(np.ptp(body.vertices, axis=0).max())
                facing = np.where((low[body.triangles] > ON * size).any(axis=1), 0.0, facing)
                height = body.heights(source)
                facing = np.where(np.abs(height) > ON * size, facing, 0.0)
            rows = np.flatnonzero(facing)
            triangles = body.triangles[rows]
            triangles = np.where((facing[rows] < 0)[:, None], triangles[:, ::-1], triangles)
            ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)
            parts.append(
                Surface(
                    body.vertices[triangles],
                    self._edge_numbers(number, ends),
                    self._first_faces[number] + body.owner[rows],
                    np.full(len(rows), number),
                )
            )
        return Surface.of(parts)

    def hide(
        self, source: Floats, points: Floats, within: Floats | float = 0.0
    ) -> NDArray[np.bool_]:
        """Whether a surface lies strictly between a source and points (n, 3).

        Surfaces in whose plane the source or a point is, up to a distance ``within`` (n,), do not
        count.
        """
        hidden = np.zeros(len(points), bool)
        within = np.broadcast_to(within, len(points))
        rays = points - source
        length = np.linalg.norm(rays, axis=1)
        for body in self.bodies:
            near, angle = _cone(body.vertices - source)
            inside = np.flatnonzero(rays @ near >= np.cos(min(angle + _WIDER, np.pi)) * length)
            triangles = body.vertices[body.triangles] - source
            for some, share, height in hits(triangles, rays[inside]):
                with np.errstate(invalid="ignore"):
                    behind = height * (1.0 / share - 1.0) > within[inside[some], None]
                hidden[inside[some]] |= behind.any(axis=1)
        return hidden

    def inside(self, points: Floats) -> NDArray[np.bool_]:
        """Whether points (n, 3) are in a body, its surface left out."""
        return self._turns(points, range(len(self.bodies))) > _IN

    def _turns(self, points: Floats, numbers: Iterable[int]) -> Floats:
        """Winding numbers (n,) of some bodies about points (n, 3), by solid angles."""
        found = np.zeros(len(points))
        for body in (self.bodies[number] for number in numbers):
            if not body.is_solid:
                continue
            low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
            near = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
            found[near] += windings_about(points[near], body.vertices[body.triangles])
        return found


def _cone(places: Floats) -> tuple[Floats, float]:
    """Axis and half-angle of a cone from the origin around places (n, 3)."""
    directions = places / np.linalg.norm(places, axis=1)[:, None]
    axis = directions.sum(axis=0)
    length = float(np.linalg.norm(axis))
    if length < 1e-9 * len(directions):
        return np.array([0.0, 0.0, 1.0]), np.pi
    axis = axis / length
    angle = float(np.arccos(np.clip(directions @ axis, -1.0, 1.0)).max()) + 1e-9
    # a cone of half-angle pi/2 or more is not convex: it may leave out a face between its vertices
    return axis, angle if angle < 0.5 * np.pi else np.pi


def hits(corners: Floats, rays: Floats) -> Iterator[tuple[slice, Floats, Floats]]:
    """Return where rays (k, 3) from the origin meet triangles (t, 3, 3).

    Yields slices of the rays, (k, t) fractions of their lengths, infinite for none, and the
    heights (t,) of the origin above the triangles.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    sides = [np.cross(b, c), np.cross(c, a), np.cross(a, b)]
    volume = np.einsum("tk,tk->t", a, sides[0])
    height = np.abs(volume) / np.linalg.norm(np.cross(b - a, c - a), axis=1)
    step = max(1, PAIRS // len(corners))
    for start in range(0, len(rays), step):
        some = slice(start, start + step)
        shares = np.stack([rays[some] @ side.T for side in sides])
        total = shares.sum(axis=0)
        sign = np.sign(total)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = volume / total
        met = (shares * sign >= 0.0).all(axis=0) & (at > 0.0) & (sign != 0.0)
        yield some, np.where(met, at, np.inf), height
