"""Opaque bodies and plates: their triangles, contacts, and the edges of the shadows they cast.

The silhouette of a convex body is the set of edges between a face towards the source and a face
away from the source. The silhouette of a plate is its boundary. Bodies that hide each other or
parts of themselves have the net contours of their visible surfaces (docs/theory/shadows.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.aperture import PlacedAperture, triangulate
from polywigner.geometry.arguments import checked_type
from polywigner.geometry.contours import Silhouette, Surface, net_contours
from polywigner.geometry.parts import connected
from polywigner.geometry.polyhedron import (
    Polyhedron,
    distances_from,
    normals_of,
    point_distances,
    windings_about,
)
from polywigner.numerics import Floats, Indices, index_blocks

# Distance from an edge or a plane that counts as zero, as a fraction of the size of a body.
ON = 1e-9
# Distance used for a source at infinity, in units of the body's size.
_AFAR = 1e6
# Numbers of ray-triangle pairs and of triangle pairs processed at once: about 50 MB each.
PAIRS, _PAIRS_OF_TRIANGLES = 1 << 20, 1 << 14
# Largest product of face count and source-point count for which each source point gets its own
# silhouette.
_MOST_FACES = 1 << 15
# Margin added to the half-angle of cones around bodies [rad], larger than rounding errors.
_WIDER = 1e-6
# Winding number above which a point counts as inside a body; inside, it is 1 apart from rounding
# errors.
_IN = 0.9975
# Largest distances between bodies that count as in contact: one in wavelengths, because a narrower
# slit transmits no field, and one as a fraction of the extent, for float32 coordinates.
_CLOSED, _ROUNDED = 0.05, 1e-6
# Largest difference between the unit normals of faces that count as lying in one plane.
_SKEW = 1e-5
_NOTHING_BEHIND = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Obstacle:
    """Triangles of an opaque body or plate, in any consistent unit of length."""

    vertices: Floats
    """Positions of the vertices, shape (n, 3)."""
    triangles: Indices
    """Vertex indices of each triangle, shape (t, 3), counter-clockwise as seen from the front."""
    owner: Indices
    """Index of the planar face that contains each triangle, shape (t,)."""
    normals: Floats
    """Normals of the faces, shape (f, 3), of any length."""
    is_solid: bool
    """Whether the faces enclose a volume; otherwise both sides are visible."""
    is_simple: bool
    """Whether no part can hide another part, as in a convex body or a plate."""

    def distance(self, points: Floats) -> Floats:
        """Return the unsigned distances (n,) of points (n, 3) from the nearest triangle."""
        return distances_from(self.vertices[self.triangles], points)

    def heights(self, source: Floats) -> Floats:
        """Return the signed distances (t,) of a source point (3,) from the planes of the triangles.

        The distance is positive if the source is in front of the triangle.
        """
        normals = self.normals / np.linalg.norm(self.normals, axis=1)[:, None]
        first = self.vertices[self.triangles[:, 0]]
        return np.asarray(np.einsum("tk,tk->t", normals[self.owner], source - first))

    def facing(self, source: Floats) -> Floats:
        """Return 1 for triangles that face a source, -1 for plates seen from behind, otherwise 0.

        ``source``: source point (3,). The result has the shape (t,).
        """
        facing = np.sign(self.heights(source))
        return np.maximum(facing, 0.0) if self.is_solid else facing

    @property
    def rim(self) -> Floats | None:
        """Ends (m, 2, 3) of the edges that belong to only one triangle; None for closed meshes."""
        ends = np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=2)
        keys, times = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_counts=True)
        return self.vertices[keys[times == 1]] if (times == 1).any() else None

    def silhouette(self, source: Floats) -> Indices:
        """Return the vertex indices (m, 2) of the silhouette edges for a source point (3,).

        The edges run from the first to the second vertex, with the body on their left as seen from
        the source.
        """
        facing = self.facing(source)
        start, end = self.triangles.T.ravel(), np.roll(self.triangles, -1, axis=1).T.ravel()
        sign = np.where(start < end, 1.0, -1.0) * np.tile(facing, 3)
        keys, which = np.unique(
            np.minimum(start, end) * len(self.vertices) + np.maximum(start, end),
            return_inverse=True,
        )
        net = np.bincount(which, sign)
        ends = np.stack([keys // len(self.vertices), keys % len(self.vertices)], axis=1)
        ends[net < 0.0] = ends[net < 0.0, ::-1]
        return ends[net != 0.0]

    def spanned(self, source: Floats) -> Obstacle:
        """Return a surface that spans the silhouette of a convex body; other bodies are unchanged.

        The shadows for all points near the source then end at the same edges. Only ``vertices`` and
        ``triangles`` are replaced; ``owner`` and ``normals`` no longer match them.
        """
        ends = self.silhouette(source) if self.is_solid and self.is_simple else np.empty(0)
        if not len(ends):
            return self
        centre = self.vertices[ends].mean(axis=(0, 1))
        fan = np.column_stack([ends, np.full(len(ends), len(self.vertices))])
        return replace(self, vertices=np.concatenate([self.vertices, [centre]]), triangles=fan)

    def outline(self, towards: Floats) -> Floats:
        """Return the edges (m, 2, 3) of the silhouette for a distant source in a direction (3,).

        The direction points from the origin to the source and has any length.
        """
        size = np.linalg.norm(self.vertices, axis=1).max()
        return self.vertices[self.silhouette(_AFAR * size / np.linalg.norm(towards) * towards)]

    def cut(self, origin: Floats, along: Floats) -> Floats:
        """Return the segments (k, 2, 2) in which the surface meets a plane.

        The plane contains ``origin`` (3,) and the orthonormal vectors ``along`` (2, 3). The
        segments are in coordinates along these vectors. For a plate in the plane, the segments are
        its boundary.
        """
        normal = np.cross(*along)
        height = (self.vertices - origin) @ normal
        if np.abs(height).max() <= ON * np.ptp(self.vertices, axis=0).max():
            ends = self.vertices[self.silhouette(origin + normal)]
            return np.asarray((ends - origin) @ along.T)
        at = height[self.triangles]
        start, end = self.vertices[self.triangles], self.vertices[np.roll(self.triangles, -1, 1)]
        after = np.roll(at, -1, axis=1)
        meets = (at >= 0.0) != (after >= 0.0)
        some = meets.any(axis=1)
        fraction = np.where(meets, at, 0.0) / np.where(meets, at - after, 1.0)
        points = (start + fraction[..., None] * (end - start) - origin) @ along.T
        return np.asarray(points[some][meets[some]].reshape(-1, 2, 2))


def obstacle_of(body: Polyhedron | PlacedAperture) -> Obstacle:
    """Convert a body, or a plate in its pose, to a mesh with vertices in m in the world."""
    if isinstance(body, PlacedAperture):
        flat, corners_of = triangulate(body.aperture)
        vertices = np.column_stack([flat, np.zeros(len(flat))])
        vertices = vertices @ body.pose[:3, :3].T + body.pose[:3, 3]
        owner = np.zeros(len(corners_of), np.intp)
        return Obstacle(vertices, corners_of, owner, body.normal[None], False, True)
    points, triangles = body.vertices, body.triangles
    owner = np.repeat(np.arange(len(body.faces)), [len(face) - 2 for face in body.faces])
    normals = np.zeros((len(body.faces), 3))
    np.add.at(normals, owner, normals_of(points[triangles]))
    simple = is_convex(points, triangles, normals[owner])
    return Obstacle(points, triangles, owner, normals, True, simple)


def shells(body: Obstacle) -> list[Obstacle]:
    """Split a body into surfaces without common vertices; a plate stays one obstacle."""
    parts = connected_parts(body.vertices, body.triangles)
    if not body.is_solid or len(parts) == 1:
        return [body]
    bodies = []
    for points, triangles, rows in parts:
        faces, owner = np.unique(body.owner[rows], return_inverse=True)
        normals = body.normals[faces]
        simple = is_convex(points, triangles, normals[owner.ravel()])
        bodies.append(Obstacle(points, triangles, owner.ravel(), normals, True, simple))
    return bodies


def connected_parts(points: Floats, triangles: Indices) -> list[tuple[Floats, Indices, Indices]]:
    """Return the vertices, triangles and triangle numbers (t,) of each connected part of a mesh."""
    a, b, c = triangles.T
    label = connected(len(points), np.append(a, a), np.append(b, c))[a]
    order = np.argsort(label, kind="stable")
    parts = []
    for rows in np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(order) else []:
        used, corners = np.unique(triangles[rows], return_inverse=True)
        parts.append((points[used], corners.reshape(-1, 3), rows))
    return parts


def is_convex(points: Floats, triangles: Indices, normals: Floats, error: float = ON) -> bool:
    """Return whether a closed surface is convex.

    No triangle may lie in front of a neighbour's plane, and all triangles must face away from the
    mean of their corners. Bodies that meet in one vertex fail the second condition, and so does a
    triangle without area, which could hide a concave edge. ``normals`` (t, 3): normals of the
    triangles, of any length. ``error``: accepted height in front of a plane, as a fraction of the
    size of the body.
    """
    outwards = points[triangles[:, 0]] - points[triangles].mean(axis=(0, 1))
    if not (np.einsum("tk,tk->t", outwards, normals) > 0.0).all():
        return False
    ends = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    forth, back = ends @ [len(points), 1], ends @ [1, len(points)]
    order, other = np.argsort(forth), np.argsort(back)
    if not np.array_equal(forth[order], back[other]) or (np.diff(forth[order]) == 0).any():
        return False
    near = np.tile(np.arange(len(triangles)), 3)[order]
    across = np.concatenate([triangles[:, (k + 2) % 3] for k in range(3)])[other]
    height = np.einsum("ek,ek->e", points[across] - points[triangles[near, 0]], normals[near])
    size = float(np.ptp(points, axis=0).max()) * np.linalg.norm(normals[near], axis=1)
    return bool((height <= error * size).all())


def bodies_if_any(bodies: Any) -> tuple[Polyhedron | PlacedAperture, ...]:
    """Return the obstacles as a tuple, which is empty for None and for an empty list.

    Raises ArgumentError for other objects.
    """
    is_none = bodies is None or (isinstance(bodies, (list, tuple)) and not bodies)
    return () if is_none else listed_bodies(bodies)


def listed_bodies(bodies: Any) -> tuple[Polyhedron | PlacedAperture, ...]:
    """Return a body or plate, or a list of them, as a tuple.

    Raises ArgumentError for other objects and for an empty list.
    """
    listed = tuple(bodies) if isinstance(bodies, (list, tuple)) else (bodies,)
    if not listed:
        raise ArgumentError("expected at least one body or obstacle, got an empty list")
    for body in listed:
        expected = "bodies or obstacles to be Polyhedra or placed apertures"
        advice = "call the method `placed` of an Aperture"
        checked_type(body, expected, Polyhedron, PlacedAperture, advice=advice)
        if isinstance(body, PlacedAperture) and body.aperture.illumination is not None:
            raise ArgumentError(
                "expected plates without illuminations, got an aperture with an illumination; "
                "pass only its outline"
            )
    return listed


def obstacles_of(bodies: Any, unit: float) -> Obstacles:
    """Convert obstacles to triangles, with coordinates in units of ``unit`` metres.

    Each connected surface of a body becomes one obstacle. Raises ArgumentError for other objects.
    """
    surfaces = [shell for body in listed_bodies(bodies) for shell in shells(obstacle_of(body))]
    return Obstacles([replace(body, vertices=body.vertices / unit) for body in surfaces])


@dataclass(frozen=True)
class Obstacles:
    """Opaque bodies and plates in space."""

    bodies: list[Obstacle]

    @cached_property
    def vertices(self) -> Floats:
        """Positions of the vertices of all bodies, in their order, shape (n, 3)."""
        return np.concatenate([body.vertices for body in self.bodies])

    def beyond(self, source: Floats, points: Floats) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 3) beyond all bodies, as seen from a source point (3,).

        These points are farther from the source than all vertices. The mirror image of the cone
        around the bodies, behind the source, is excluded.
        """
        rays, (axis, angle) = points - source, _cone(self.vertices - source)
        away = np.linalg.norm(rays, axis=1)
        reach = np.linalg.norm(self.vertices - source, axis=1).max()
        return (away > reach) & (rays @ -axis < np.cos(min(angle + _WIDER, np.pi)) * away)

    def silhouettes(self, sources: Sequence[Floats]) -> list[Silhouette]:
        """Return a silhouette for each source point (k, 3).

        If the number of triangles times k exceeds 32,768, all source points share the silhouette
        seen from their mean position.
        """
        faces = sum(len(body.triangles) for body in self.bodies)
        if faces * len(sources) > _MOST_FACES:
            return [self.silhouette(np.mean(sources, axis=0))] * len(sources)
        return [self.silhouette(point) for point in sources]

    def silhouette(self, source: Floats) -> Silhouette:
        """Return the shadow edges of all bodies for a point source at a position (3,)."""
        alone = self._bodies_that_hide_nothing(source)
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
        """Return the silhouette of a body that neither hides another body nor is hidden.

        ``number``: index of the body. The attribute ``planes`` is not set.
        """
        body = self.bodies[number]
        ends = body.silhouette(source)
        bodies, behind = np.full(len(ends), number), np.full(len(ends), -1)
        return Silhouette(body.vertices[ends], self._edge_numbers(number, ends), bodies, behind)

    def _bodies_that_hide_nothing(self, source: Floats) -> NDArray[np.bool_]:
        """Return a mask (k,) of the bodies that hide no part of themselves or of another body.

        The mask also excludes all bodies whose cones from the source overlap another cone.
        """
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
        """Largest distance in wavelengths at which bodies count as in contact.

        The vertices must be in wavelengths.
        """
        return max(_CLOSED, _ROUNDED * float(np.ptp(self.vertices, axis=0).max()))

    @cached_property
    def contacts(self) -> Indices:
        """Pairs of body indices (n, 2), ascending, that touch, cross or contain each other."""
        pairs = contacts(
            [body.vertices[body.triangles] for body in self.bodies],
            [body.rim for body in self.bodies],
            self.contact,
        )
        # A body with a vertex inside another body is in contact with it.
        corners = np.array([body.vertices[0] for body in self.bodies])
        numbers = range(len(self.bodies))
        alone = np.array([self._winding_numbers(corners[[k]], [k])[0] for k in numbers])
        (inner,) = np.nonzero(self._winding_numbers(corners, numbers) - alone > _IN)
        for k in numbers if len(inner) else ():
            within = inner[self._winding_numbers(corners[inner], [k]) > _IN].tolist()
            pairs += [(k, number) for number in within if number != k]
        return np.unique(np.sort(np.array(pairs, np.intp).reshape(-1, 2), axis=1), axis=0)

    def are_in_contact(self, one: Indices, other: Indices) -> NDArray[np.bool_]:
        """Return a mask (n,) of the pairs of body indices that are equal or directly in contact."""
        keys = (self.contacts @ [[len(self.bodies), 1], [1, len(self.bodies)]]).ravel()
        return np.asarray((one == other) | np.isin(one * len(self.bodies) + other, keys))

    @cached_property
    def groups(self) -> Indices:
        """Smallest index of the bodies that contacts connect to each body, shape (k,)."""
        return connected(len(self.bodies), *self.contacts.T)

    @cached_property
    def _first_faces(self) -> Indices:
        """Index of the first face of each body in the list of all faces, shape (k + 1,)."""
        return np.cumsum([0, *(len(body.normals) for body in self.bodies)])

    @cached_property
    def _first_edges(self) -> Indices:
        """Smallest number of the edges of each body, shape (k + 1,); see ``_edge_numbers``."""
        return np.cumsum([0, *(len(body.vertices) ** 2 for body in self.bodies)])

    def _edge_numbers(self, number: int, ends: Indices) -> Indices:
        """Return a number for each edge between two vertices (..., 2), numbered within a body.

        The numbers are unique among all bodies, and independent of the direction of the edge.
        """
        low, high = ends.min(axis=-1), ends.max(axis=-1)
        count = len(self.bodies[number].vertices)
        return np.asarray(self._first_edges[number] + low * count + high)

    def body_of_face(self, faces: Indices) -> Indices:
        """Return the index of the body to which each face in the list of all faces belongs."""
        return np.searchsorted(self._first_faces, faces, side="right") - 1

    def face_planes(self, source: Floats) -> Floats:
        """Return the planes (a, b, c, d), shape (f, 4), of all faces of all bodies.

        The normals (a, b, c) have length 1. The source (3,) is on the positive side:
        a x + b y + c z + d >= 0.
        """
        rows = []
        for body in self.bodies:
            normals = body.normals / np.linalg.norm(body.normals, axis=1)[:, None]
            first = np.zeros(len(normals), np.intp)
            first[body.owner[::-1]] = body.triangles[::-1, 0]
            points = body.vertices[first]
            is_behind = np.einsum("fk,fk->f", normals, source - points) < 0
            normals *= np.where(is_behind, -1.0, 1.0)[:, None]
            rows.append(np.column_stack([normals, -np.einsum("fk,fk->f", normals, points)]))
        return np.concatenate(rows)

    def flush_with(self, body: int, plane: Floats, planes: Floats) -> Indices:
        """Return the bodies with a face in a ``plane`` (4,) that contacts connect to a given body.

        ``body``: index of the body, which may be in the result. ``planes`` (f, 4): result of
        :meth:`face_planes`. A body without contacts is returned even if it has no such face.
        """
        (group,) = np.nonzero(self.groups == self.groups[body])
        if len(group) == 1:
            return group
        flush = np.abs(planes - plane) <= [_SKEW, _SKEW, _SKEW, self.contact]
        return np.intersect1d(group, self.body_of_face(np.flatnonzero(flush.all(axis=1))))

    def surface(
        self, numbers: Sequence[int], source: Floats, plane: Floats | None = None
    ) -> Surface:
        """Return the triangles of the bodies ``numbers`` that face a source point (3,).

        The triangles are counter-clockwise as seen from the source. With ``plane`` (4,), only
        triangles entirely behind this plane (on its negative side) and not edge-on are returned.
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
        """Return a mask of the points (n, 3) that a body hides from a source point (3,).

        Faces whose planes are within a distance ``within`` (n,) of the source or the point are
        ignored.
        """
        hidden = np.zeros(len(points), bool)
        within = np.broadcast_to(within, len(points))
        rays = points - source
        length = np.linalg.norm(rays, axis=1)
        for body in self.bodies:
            near, angle = _cone(body.vertices - source)
            inside = np.flatnonzero(rays @ near >= np.cos(min(angle + _WIDER, np.pi)) * length)
            triangles = body.vertices[body.triangles] - source
            for some, fraction, height in hits(triangles, rays[inside]):
                with np.errstate(invalid="ignore"):
                    behind = height * (1.0 / fraction - 1.0) > within[inside[some], None]
                hidden[inside[some]] |= behind.any(axis=1)
        return hidden

    def inside(self, points: Floats) -> NDArray[np.bool_]:
        """Return a mask of points (n, 3) inside a body, excluding points on surfaces."""
        return self._winding_numbers(points, range(len(self.bodies))) > _IN

    def _winding_numbers(self, points: Floats, numbers: Iterable[int]) -> Floats:
        """Return the total winding numbers (n,) of some bodies about points (n, 3)."""
        turns = np.zeros(len(points))
        for body in (self.bodies[number] for number in numbers):
            if not body.is_solid:
                continue
            low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
            near = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
            turns[near] += windings_about(points[near], body.vertices[body.triangles])
        return turns


def _cone(points: Floats) -> tuple[Floats, float]:
    """Return axis and half-angle (rad) of a cone around points (n, 3), with its apex at the origin.

    The half-angle is pi if it would be pi/2 or more.
    """
    directions = points / np.linalg.norm(points, axis=1)[:, None]
    axis = directions.sum(axis=0)
    length = float(np.linalg.norm(axis))
    if length < 1e-9 * len(directions):
        return np.array([0.0, 0.0, 1.0]), np.pi
    axis = axis / length
    angle = float(np.arccos(np.clip(directions @ axis, -1.0, 1.0)).max()) + 1e-9
    # A wider cone is not convex and may miss parts of a face.
    return axis, angle if angle < 0.5 * np.pi else np.pi


def hits(corners: Floats, rays: Floats) -> Iterator[tuple[slice, Floats, Floats]]:
    """Intersect rays (k, 3) from the origin with triangles (t, 3, 3), in blocks of rays.

    Yields slices of the rays, intersections (k, t), and the unsigned distances (t,) of the origin
    from the planes of the triangles. Intersections are positive fractions of the ray lengths, which
    may exceed 1 and are infinite if a ray misses a triangle.
    """
    *sides, heights = np.split(pyramids(corners), [3, 6, 9], axis=1)
    height = heights[:, 0]
    for some in index_blocks(len(rays), PAIRS // len(corners)):
        products = np.stack([rays[some] @ side.T for side in sides])
        total = products.sum(axis=0)
        sign = np.sign(total)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = height / total
        met = (products * sign >= 0.0).all(axis=0) & (at > 0.0) & (sign != 0.0)
        yield some, np.where(met, at, np.inf), np.abs(height)


def pyramids(corners: Floats) -> Floats:
    """Return side normals and heights (t, 10) of pyramids from bases (t, 3, 3) to the origin.

    The three normals are divided by twice the area of the base. The height is positive if the
    base's normal points away from the origin.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    sides = [np.cross(b, c), np.cross(c, a), np.cross(a, b)]
    rows = np.column_stack([*sides, np.einsum("tk,tk->t", a, sides[0])])
    return rows / np.linalg.norm(normals_of(corners), axis=1)[:, None]


def contacts(
    meshes: Sequence[Floats], rims: Sequence[Floats | None], within: float
) -> list[tuple[int, int]]:
    """Return pairs of meshes (t, 3, 3) that cross, or have a corner ``within`` of the other mesh.

    ``rims``: boundary edges (m, 2, 3) of each sheet, or None for a closed mesh. A body that stands
    on the interior of a sheet is not in contact with the sheet.
    """
    boxes = np.array([[mesh.min(axis=(0, 1)), mesh.max(axis=(0, 1))] for mesh in meshes])
    # Edges of a rim are represented by triangles without area.
    ends = [
        mesh if rim is None else rim[:, [0, 1, 1]] for mesh, rim in zip(meshes, rims, strict=True)
    ]
    pairs = []
    for one, other in np.column_stack(_overlapping_boxes(boxes, boxes, within)).tolist():
        if one < other and (
            any(_are_near(*some, within) for some in _near(ends[one], ends[other], within))
            or any(_cross(*some, within).any() for some in _near(meshes[one], meshes[other], 0.0))
        ):
            pairs.append((one, other))
    return pairs


def _overlapping_boxes(boxes: Floats, others: Floats, within: float) -> tuple[Indices, Indices]:
    """Return indices (m,) and (m,) of pairs of boxes, at most ``within`` apart along each axis.

    A box (2, 3) is given by its lower and upper corners. Each pair consists of one of ``boxes``
    (n, 2, 3) and one of ``others``.
    """
    low, high = boxes[:, 0] - within, boxes[:, 1] + within
    tree = shapely.STRtree(shapely.box(*others[:, 0, :2].T, *others[:, 1, :2].T))
    one, other = tree.query(shapely.box(*low[:, :2].T, *high[:, :2].T))
    near = (others[other, 0, 2] <= high[one, 2]) & (others[other, 1, 2] >= low[one, 2])
    return one[near], other[near]


def _near(one: Floats, other: Floats, within: float) -> Iterator[tuple[Floats, Floats]]:
    """Yield pairs of triangles whose boxes are at most ``within`` apart.

    The pairs consist of a triangle of the mesh ``one`` (t, 3, 3) and a triangle of the mesh
    ``other``. The pairs are yielded in blocks of two arrays (n, 3, 3).
    """
    boxes = [np.stack([mesh.min(axis=1), mesh.max(axis=1)], axis=1) for mesh in (one, other)]
    rows = []
    for mine, theirs in (boxes, boxes[::-1]):
        if not len(theirs):
            return
        low, high = theirs[:, 0].min(axis=0) - within, theirs[:, 1].max(axis=0) + within
        rows.append(np.flatnonzero(((mine[:, 0] <= high) & (mine[:, 1] >= low)).all(axis=1)))
    first, second = _overlapping_boxes(boxes[0][rows[0]], boxes[1][rows[1]], within)
    for some in index_blocks(len(first), _PAIRS_OF_TRIANGLES):
        yield one[rows[0][first[some]]], other[rows[1][second[some]]]


def _are_near(one: Floats, other: Floats, within: float) -> bool:
    """Return whether the triangles (n, 3, 3) of any pair cross, or have near corners.

    A near corner is at most ``within`` away from the other triangle.
    """
    is_near = any(
        (point_distances(np.moveaxis(corners, 1, 0), triangles) <= within).any()
        for corners, triangles in ((one, other), (other, one))
    )
    return is_near or bool(_cross(one, other, 0.0).any())


def _cross(one: Floats, other: Floats, depth: float) -> NDArray[np.bool_]:
    """Return a mask (n,) of the pairs of triangles (n, 3, 3) that cross by more than ``depth``.

    Both ends of the crossing edge are farther than ``depth`` from the plane of the other triangle.
    """
    crosses = np.zeros(len(one), bool)
    for mine, theirs in ((one, other), (other, one)):
        a, b, c = np.moveaxis(theirs, 1, 0)
        normal = np.cross(b - a, c - a)
        height = np.stack([np.vecdot(mine[:, k] - a, normal) for k in range(3)])
        far = np.abs(height) > depth * np.linalg.norm(normal, axis=1)
        for k in range(3):
            j = (k + 1) % 3
            p, along = mine[:, k], mine[:, j] - mine[:, k]
            sides = (a, b), (b, c), (c, a)
            turns = np.stack([np.vecdot(np.cross(s - p, e - p), along) for s, e in sides])
            inside = (turns > 0.0).all(axis=0) | (turns < 0.0).all(axis=0)
            crosses |= inside & far[k] & far[j] & (height[k] * height[j] < 0.0)
    return crosses
