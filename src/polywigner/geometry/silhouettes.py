"""Silhouettes of opaque bodies and plates, seen from a point: the edges of the shadow they cast.

The silhouette of a convex body is the set of edges between a face towards the source and a face
away from it; that of a plate is its boundary. Bodies that hide each other or parts of themselves
have the net contours of their visible surfaces (docs/theory/shadows.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.aperture import PlacedAperture, triangulate
from polywigner.geometry.contours import Surface, net_contours
from polywigner.geometry.polyhedron import Polyhedron

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Places this close are on an edge or in a plane, as a fraction of a body's size.
_ON = 1e-9
# Sizes of a body from which its outline is that seen from infinity.
_AFAR = 1e6
# Faces times points of a source, beyond which these share the silhouette that their middle sees.
_MOST_FACES = 1 << 15
# Cones around bodies are wider by this angle, in rad: beyond rounding.
_WIDER = 1e-6
# Pairs of a ray and a triangle at a time: some 50 MB.
_PAIRS = 1 << 20


@dataclass(frozen=True)
class Obstacle:
    """Triangles of a body or a plate, as a source of light sees them. Lengths of any one unit."""

    vertices: Floats
    """(n, 3)."""
    triangles: Indices
    """(t, 3) vertices, counter-clockwise seen from the front."""
    owner: Indices
    """(t,) the planar face that each triangle is a part of."""
    normals: Floats
    """(f, 3) of the faces, of any length."""
    is_solid: bool
    """Whether the faces enclose a volume; otherwise both their sides are seen."""
    is_simple: bool
    """Whether no part hides another from any place: a convex body, a plate."""

    def distance(self, points: Floats) -> Floats:
        """Distance of points (n, 3) from the nearest face, (n,)."""
        corners = self.vertices[self.triangles]
        step = max(1, _PAIRS // len(corners))
        blocks = [points[low : low + step] for low in range(0, len(points), step)]
        return np.concatenate([_from_triangles(corners, block).min(axis=1) for block in blocks])

    def heights(self, source: Floats) -> Floats:
        """Heights (t,) of a source above the planes of the triangles."""
        normals = self.normals / np.linalg.norm(self.normals, axis=1)[:, None]
        first = self.vertices[self.triangles[:, 0]]
        return np.asarray(np.einsum("tk,tk->t", normals[self.owner], source - first))

    def facing(self, source: Floats) -> Floats:
        """1 for triangles that a source sees from their front, -1 for the back of a plate."""
        facing = np.sign(self.heights(source))
        return np.maximum(facing, 0.0) if self.is_solid else facing

    def silhouette(self, source: Floats) -> Indices:
        """Vertices (m, 2) of the directed edges of the silhouette, whether visible or not."""
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

    def outline(self, towards: Floats) -> Floats:
        """Edges (m, 2, 3) of the silhouette seen from afar, in the direction ``towards`` (3,)."""
        size = np.linalg.norm(self.vertices, axis=1).max()
        return self.vertices[self.silhouette(_AFAR * size / np.linalg.norm(towards) * towards)]

    def cut(self, origin: Floats, along: Floats) -> Floats:
        """Lines (k, 2, 2) in which a plane with the axes ``along`` (2, 3) meets the surface."""
        normal = np.cross(*along)
        height = (self.vertices - origin) @ normal
        if np.abs(height).max() <= _ON * np.ptp(self.vertices, axis=0).max():
            ends = self.vertices[self.silhouette(origin + normal)]
            return np.asarray((ends - origin) @ along.T)
        at = height[self.triangles]
        start, end = self.vertices[self.triangles], self.vertices[np.roll(self.triangles, -1, 1)]
        after = np.roll(at, -1, axis=1)
        meets = (at >= 0.0) != (after >= 0.0)
        some = meets.any(axis=1)
        share = np.where(meets, at, 0.0) / np.where(meets, at - after, 1.0)
        places = (start + share[..., None] * (end - start) - origin) @ along.T
        return np.asarray(places[some][meets[some]].reshape(-1, 2, 2))


def obstacle_of(body: Polyhedron | PlacedAperture) -> Obstacle:
    """Triangles of a body, or of a plate in its pose."""
    if isinstance(body, PlacedAperture):
        flat, corners_of = triangulate(body.aperture)
        vertices = np.column_stack([flat, np.zeros(len(flat))])
        vertices = vertices @ body.pose[:3, :3].T + body.pose[:3, 3]
        owner = np.zeros(len(corners_of), np.intp)
        return Obstacle(vertices, corners_of, owner, body.normal[None], False, True)
    points, triangles = body.vertices, body.triangles
    owner = np.repeat(np.arange(len(body.faces)), [len(face) - 2 for face in body.faces])
    corners = points[triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros((len(body.faces), 3))
    np.add.at(normals, owner, areas)
    offsets = np.einsum("fk,fk->f", normals, points[[face[0] for face in body.faces]])
    size = float(np.ptp(points, axis=0).max()) * np.linalg.norm(normals, axis=1)
    convex = bool((normals @ points.T - offsets[:, None] <= _ON * size[:, None]).all())
    # a convex surface of several bodies would have vertices before its faces
    return Obstacle(points, triangles, owner, normals, True, convex)


@dataclass(frozen=True)
class Silhouette:
    """Directed edges (m,) of shadows, the body on the left of each as the source sees it."""

    edges: Floats
    """(m, 2, 3)."""
    planes: Floats
    """(m, 4): points P with planes[:3].P + planes[3] < 0 are behind the plane of the face that an
    edge casts its shadow on; (0, 0, 0, 1) for edges with nothing behind them."""
    numbers: Indices
    """(m,) numbers of the edges of meshes that the edges are parts of."""
    behind: Indices
    """(m,) numbers of the faces behind the edges; -1 for none."""
    touching: frozenset[tuple[int, int]] = frozenset()
    """Pairs of bodies that continue each other's surfaces."""
    is_closed: bool = True
    """Whether no part of the edges has been taken away."""

    def taken(self, rows: NDArray[np.bool_], edges: Floats) -> Silhouette:
        """Parts (k, 2, 3) of some of the edges (m,)."""
        return replace(
            self,
            edges=edges[rows],
            planes=self.planes[rows],
            numbers=self.numbers[rows],
            behind=self.behind[rows],
            is_closed=self.is_closed and np.array_equal(edges, self.edges) and bool(rows.all()),
        )


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
    obstacles = [obstacle_of(body) for body in listed_bodies(bodies)]
    return Obstacles([replace(body, vertices=body.vertices / unit) for body in obstacles])


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
            parts.append(self._net_silhouette(np.flatnonzero(~alone).tolist(), source))
        return Silhouette(
            np.concatenate([part.edges for part in parts]),
            np.concatenate([part.planes for part in parts]),
            np.concatenate([part.numbers for part in parts]),
            np.concatenate([part.behind for part in parts]),
            parts[-1].touching,
        )

    def _mesh_silhouette(self, number: int, source: Floats) -> Silhouette:
        body = self.bodies[number]
        ends = body.silhouette(source)
        count = len(ends)
        planes = np.tile(_NOTHING_BEHIND, (count, 1))
        numbers = self._edge_numbers(number, ends)
        return Silhouette(body.vertices[ends], planes, numbers, np.full(count, -1))

    def _net_silhouette(self, numbers: Sequence[int], source: Floats) -> Silhouette:
        found = net_contours(self.surface(numbers, source), source)
        planes = np.tile(_NOTHING_BEHIND, (len(found.ends), 1))
        (rows,) = np.nonzero(found.behind >= 0)
        planes[rows] = self.face_planes(source)[found.behind[rows]]
        return Silhouette(found.ends, planes, found.edges, found.behind, found.touching)

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

    def body_of_edge(self, numbers: Indices) -> Indices:
        """Numbers of the bodies of edges of meshes."""
        return np.searchsorted(self._first_edges, numbers, side="right") - 1

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
                facing = np.where((low[body.triangles] > _ON * size).any(axis=1), 0.0, facing)
                height = body.heights(source)
                facing = np.where(np.abs(height) > _ON * size, facing, 0.0)
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
                    np.full(len(rows), number if body.is_solid and body.is_simple else -1),
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
        """Whether points (n, 3) are in a body, its surface left out, by their solid angles."""
        found = np.zeros(len(points), bool)
        for body in self.bodies:
            if not body.is_solid:
                continue
            low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
            near = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
            step = max(1, _PAIRS // len(body.triangles))
            for start in range(0, len(near), step):
                mine = near[start : start + step]
                corners = body.vertices[body.triangles][None] - points[mine][:, None, None]
                found[mine] |= _solid_angle(corners).sum(axis=1) > 3.99 * np.pi
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
    step = max(1, _PAIRS // len(corners))
    for start in range(0, len(rays), step):
        some = slice(start, start + step)
        shares = np.stack([rays[some] @ side.T for side in sides])
        total = shares.sum(axis=0)
        sign = np.sign(total)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = volume / total
        met = (shares * sign >= 0.0).all(axis=0) & (at > 0.0) & (sign != 0.0)
        yield some, np.where(met, at, np.inf), height


def _solid_angle(corners: Floats) -> Floats:
    """Solid angle of triangles (..., 3, 3) seen from the origin (Van Oosterom and Strackee)."""
    a, b, c = np.moveaxis(corners, -2, 0)
    x, y, z = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    triple = np.einsum("...k,...k", a, np.cross(b, c))
    below = (
        x * y * z
        + np.einsum("...k,...k", a, b) * z
        + np.einsum("...k,...k", b, c) * x
        + np.einsum("...k,...k", c, a) * y
    )
    return 2.0 * np.arctan2(triple, below)


def _from_triangles(corners: Floats, points: Floats) -> Floats:
    """Distances (n, t) of points (n, 3) from triangles (t, 3, 3)."""
    best = np.full((len(points), len(corners)), np.inf)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    above = np.ones(best.shape, bool)
    for k in range(3):
        start, side = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        ahead = points[:, None] - start
        share = np.einsum("ntk,tk->nt", ahead, side) / np.einsum("tk,tk->t", side, side)
        off = ahead - np.clip(share, 0.0, 1.0)[:, :, None] * side
        best = np.minimum(best, np.linalg.norm(off, axis=2))
        above &= np.einsum("ntk,tk->nt", ahead, np.cross(normal, side)) >= 0.0
    height = np.einsum("ntk,tk->nt", ahead, normal) / np.linalg.norm(normal, axis=1)
    return np.where(above, np.abs(height), best)
