"""Silhouettes of opaque bodies and plates, seen from a point: the edges of the shadow they throw.

A silhouette is the set of directed edges between a face towards the source and one away from it,
or of a plate all edges. Behind a surface in its shadow an edge has no part in the light
(docs/theory/shadows.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.aperture import PlacedAperture, triangulate
from polywigner.geometry.convex import triangulate_part
from polywigner.geometry.polyhedron import Polyhedron

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Probes beside an edge are off it by so much of its distance: beyond rounding, within any face.
_ASIDE = 1e-7
# Surfaces whose depths differ by less than this share touch; places this close are on an edge.
_TOUCH, _ON = 1e-5, 1e-9
# A point sees the source if all that is in the way is nearer than this to it, as a share.
_BEFORE = 1e-7
# Sizes of a body from which its outline is that seen from infinity.
_AFAR = 1e6
# Faces times points of a source, beyond which these share the silhouette that their middle sees.
_MOST_FACES = 1 << 15
# Wavelengths; products of six such lengths are numbers still.
_FARTHEST = 1e50
# Cones around bodies are wider by this angle, in rad: beyond rounding.
_WIDER = 1e-6
# Pairs of a ray and a triangle at a time: some 50 MB.
_PAIRS = 1 << 20
# Pairs of an edge and one that may hide it, and of a piece and a triangle, at 0.3 us each: ten
# minutes. A piece takes 300 bytes.
_MOST_PAIRS, _PIECES = 1 << 31, 512


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

    def _facing(self, source: Floats) -> Floats:
        """1 for triangles that a source sees from their front, -1 for the back of a plate."""
        first = self.vertices[self.triangles[:, 0]]
        facing = np.sign(np.einsum("tk,tk->t", self.normals[self.owner], source - first))
        return np.maximum(facing, 0.0) if self.is_solid else facing

    def borders(self, source: Floats) -> Indices:
        """Vertices (m, 2) of all edges of faces that a source sees from their front."""
        some = self.triangles[self._facing(source) != 0.0]
        pairs = np.concatenate([some, np.roll(some, -1, axis=1)], axis=0).reshape(2, -1).T
        return np.unique(np.sort(pairs, axis=1), axis=0)

    def silhouette(self, source: Floats) -> tuple[Indices, Indices]:
        """Vertices (m, 2) of the directed edges of the silhouette, and a face (m,) of each."""
        facing = self._facing(source)
        start, end = self.triangles.T.ravel(), np.roll(self.triangles, -1, axis=1).T.ravel()
        sign = np.where(start < end, 1.0, -1.0) * np.tile(facing, 3)
        keys, which = np.unique(
            np.minimum(start, end) * len(self.vertices) + np.maximum(start, end),
            return_inverse=True,
        )
        net = np.bincount(which, sign)
        face = np.zeros(len(keys), np.intp)
        towards = sign * net[which] > 0.0
        face[which[towards]] = np.tile(self.owner, 3)[towards]
        ends = np.stack([keys // len(self.vertices), keys % len(self.vertices)], axis=1)
        ends[net < 0.0] = ends[net < 0.0, ::-1]
        return ends[net != 0.0], face[net != 0.0]

    def outline(self, towards: Floats) -> Floats:
        """Edges (m, 2, 3) of the silhouette seen from afar, in the direction ``towards`` (3,)."""
        size = np.linalg.norm(self.vertices, axis=1).max()
        ends, _ = self.silhouette(_AFAR * size / np.linalg.norm(towards) * towards)
        return self.vertices[ends]

    def cut(self, origin: Floats, along: Floats) -> Floats:
        """Lines (k, 2, 2) in which a plane with the axes ``along`` (2, 3) meets the surface."""
        normal = np.cross(*along)
        height = (self.vertices - origin) @ normal
        if np.abs(height).max() <= _ON * np.ptp(self.vertices, axis=0).max():
            ends = self.vertices[self.silhouette(origin + normal)[0]]
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
    triangles: list[list[int]] = []
    numbers: list[int] = []
    normals: list[Floats] = []
    for number, face in enumerate(body.faces):
        corners = body.vertices[list(face)] - body.vertices[face[0]]
        normals.append(np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0))
        triangles += [[face[k] for k in corner] for corner in _triangles(corners, normals[-1])]
        numbers += [number] * (len(triangles) - len(numbers))
    directions, points = np.array(normals), body.vertices
    offsets = np.einsum("fk,fk->f", directions, points[[face[0] for face in body.faces]])
    size = float(np.ptp(points, axis=0).max()) * np.linalg.norm(directions, axis=1)
    convex = bool((directions @ points.T - offsets[:, None] <= _ON * size[:, None]).all())
    # a convex surface of several bodies would have vertices before its faces
    return Obstacle(
        points, np.array(triangles, np.intp), np.array(numbers, np.intp), directions, True, convex
    )


def _triangles(corners: Floats, normal: Floats) -> list[list[int]]:
    """Triangles of one planar face, as numbers of its corners in the face's own sense."""
    if len(corners) == 3:
        return [[0, 1, 2]]
    k = int(np.abs(normal).argmax())
    flat = corners[:, [(k + 1) % 3, (k + 2) % 3]]
    flat = flat if normal[k] > 0.0 else flat[:, ::-1]
    places, triangles = triangulate_part((flat,))
    number = {place.tobytes(): corner for corner, place in enumerate(flat + 0.0)}
    return [[number[places[corner].tobytes()] for corner in some] for some in triangles]


@dataclass(frozen=True)
class Silhouette:
    """Directed edges of shadows, the body at one side of each."""

    edges: Floats
    """(m, 2, 3)."""
    planes: Floats
    """(m, 4): an edge has a part in the light of points P with planes[:3].P + planes[3] >= 0."""

    @property
    def counts_everywhere(self) -> bool:
        """Whether no edge is in front of another surface."""
        return bool((self.planes == _EVERYWHERE).all())


_EVERYWHERE = np.array([0.0, 0.0, 0.0, 1.0])


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
    found = [obstacle_of(body) for body in listed_bodies(bodies)]
    found = [replace(body, vertices=body.vertices / unit) for body in found]
    if not all((np.abs(body.vertices) < _FARTHEST).all() for body in found):
        raise ArgumentError(
            f"expected obstacles within {_FARTHEST:g} wavelengths, got one beyond; check its unit"
        )
    return Obstacles(found)


@dataclass(frozen=True)
class Obstacles:
    """Opaque bodies and plates in space, with the questions that light asks of them."""

    bodies: list[Obstacle]

    def reach(self, source: Floats) -> float:
        """Largest distance of any body from a source."""
        return max(
            float(np.linalg.norm(body.vertices - source, axis=1).max()) for body in self.bodies
        )

    def silhouettes(self, sources: Sequence[Floats]) -> list[Silhouette]:
        """Return silhouettes for places (k, 3) of one source; of a large mesh one for all."""
        if len(sources) * sum(len(body.triangles) for body in self.bodies) > _MOST_FACES:
            return [self.silhouette(np.mean(sources, axis=0))] * len(sources)
        return [self.silhouette(place) for place in sources]

    def silhouette(self, source: Floats) -> Silhouette:
        """Return the edges of the shadows that all bodies throw, seen from a source (3,)."""
        places, numbers, faces = [], [], []
        for number, body in enumerate(self.bodies):
            ends, face = body.silhouette(source)
            places.append(body.vertices[ends])
            numbers.append(np.full(len(face), number))
            faces.append(face)
        edges = np.concatenate(places)
        if self._apart(source):
            return Silhouette(edges, np.tile(_EVERYWHERE, (len(edges), 1)))
        return self._seen(source, edges, np.concatenate(numbers), np.concatenate(faces))

    def _apart(self, source: Floats) -> bool:
        """Whether no body, seen from a source, can hide a part of another or of itself."""
        if not all(body.is_simple for body in self.bodies):
            return False
        cones = [_cone(body.vertices - source) for body in self.bodies]
        axes, angles = (
            np.array([axis for axis, _ in cones]),
            np.array([angle for _, angle in cones]),
        )
        return all(
            (np.arccos(np.clip(axes[:k] @ axes[k], -1.0, 1.0)) > angles[:k] + angles[k]).all()
            for k in range(1, len(cones))
        )

    def _seen(self, source: Floats, edges: Floats, number: Indices, face: Indices) -> Silhouette:
        """The parts of edges that a source sees, with their own face on one side of them only."""
        lines = [body.vertices[body.borders(source)] - source for body in self.bodies]
        cones = [_cone(body.vertices - source) for body in self.bodies]
        starts, ends, owner = _pieces(edges - source, lines, cones)
        middle = 0.5 * (starts + ends)
        aside = np.cross(starts, ends)
        aside *= (_ASIDE * np.linalg.norm(middle, axis=1) / np.linalg.norm(aside, axis=1))[:, None]
        # the body is at one side of its edge, light or a surface farther away at the other
        _, body_of, face_of = self._first_hits(source, middle - aside)
        beyond, other, other_face = self._first_hits(source, middle + aside)
        solid = np.array([body.is_solid for body in self.bodies])[number[owner]]
        kept = (body_of == number[owner]) & (~solid | (face_of == face[owner]))
        kept &= beyond > 1.0 + _TOUCH
        planes = np.tile(_EVERYWHERE, (len(starts), 1))
        for k in np.flatnonzero(kept & np.isfinite(beyond)):
            body = self.bodies[other[k]]
            normal = body.normals[other_face[k]] / np.linalg.norm(body.normals[other_face[k]])
            place = beyond[k] * (middle[k] + aside[k])
            normal = -np.sign(normal @ place) * normal
            margin = _BEFORE * float(np.linalg.norm(place))
            planes[k] = *normal, margin - normal @ (place + source)
        return Silhouette(np.stack([starts[kept], ends[kept]], axis=1) + source, planes[kept])

    def _first_hits(self, source: Floats, rays: Floats) -> tuple[Floats, Indices, Indices]:
        """Where rays (n, 3) meet a surface first, in their lengths; its body and its face."""
        best, length = np.full(len(rays), np.inf), np.linalg.norm(rays, axis=1)
        body_of, face_of = np.full(len(rays), -1), np.full(len(rays), -1)
        pairs = 0
        for number, body in enumerate(self.bodies):
            axis, angle = _cone(body.vertices - source)
            near = np.flatnonzero(rays @ axis >= np.cos(min(angle + _WIDER, np.pi)) * length)
            pairs += len(near) * len(body.triangles)
            _check_pairs(pairs)
            for some, share in _hits(body, source, rays[near]):
                nearest = share.argmin(axis=1)
                found = share[np.arange(len(nearest)), nearest]
                better = np.flatnonzero(found < best[near[some]] * (1.0 - _ON))
                at = near[some][better]
                best[at] = found[better]
                body_of[at], face_of[at] = number, body.owner[nearest[better]]
        return best, body_of, face_of

    def hide(self, source: Floats, points: Floats) -> NDArray[np.bool_]:
        """Whether a body hides points (n, 3) from a source; their own surface does not count."""
        found = np.zeros(len(points), bool)
        for body in self.bodies:
            near, angle = _cone(body.vertices - source)
            rays = points - source
            length = np.linalg.norm(rays, axis=1)
            inside = np.flatnonzero(rays @ near >= np.cos(min(angle + _WIDER, np.pi)) * length)
            for some, share in _hits(body, source, rays[inside]):
                found[inside[some]] |= (share < 1.0 - _BEFORE).any(axis=1)
        return found

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
    return axis, float(np.arccos(np.clip(directions @ axis, -1.0, 1.0)).max()) + 1e-9


def _hits(body: Obstacle, source: Floats, rays: Floats) -> Any:
    """(slice of rays, (k, t) where they meet triangles, in shares of their length, or infinite)."""
    a, b, c = np.moveaxis(body.vertices[body.triangles] - source, 1, 0)
    sides = [np.cross(b, c), np.cross(c, a), np.cross(a, b)]
    volume = np.einsum("tk,tk->t", a, sides[0])
    step = max(1, _PAIRS // len(body.triangles))
    for start in range(0, len(rays), step):
        some = slice(start, start + step)
        shares = np.stack([rays[some] @ side.T for side in sides])
        total = shares.sum(axis=0)
        sign = np.sign(total)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = volume / total
        met = (shares * sign >= 0.0).all(axis=0) & (at > 0.0) & (sign != 0.0)
        yield some, np.where(met, at, np.inf)


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


def _pieces(
    edges: Floats, lines: list[Floats], cones: list[tuple[Floats, float]]
) -> tuple[Floats, Floats, Indices]:
    """Cut edges (m, 2, 3), seen from the origin, where lines (n, 2, 3) of bodies cross them.

    Returns starts and ends (k, 3) of the pieces, and the number (k,) of their edge.
    """
    starts, ends, owner = [], [], []
    axes, angles = np.array([axis for axis, _ in cones]), np.array([angle for _, angle in cones])
    columns = [(some[:, 0], some[:, 1], np.cross(some[:, 0], some[:, 1])) for some in lines]
    counts = np.array([len(some) for some in lines])
    nearby, pairs, pieces = [], 0, 0
    for edge in edges:  # counted before any is cut
        axis, angle = _cone(edge)
        apart = np.arccos(np.clip(axes @ axis, -1.0, 1.0))
        nearby.append(np.flatnonzero(apart <= angle + angles + _WIDER).tolist())
        pairs += int(counts[nearby[-1]].sum())
        _check_pairs(pairs)
    for k, (a, b) in enumerate(edges):
        normal = np.cross(a, b)
        if not normal.any():  # seen end on: no angle, and no wave
            continue
        c, d, planes = (
            np.concatenate(part) for part in zip(*(columns[n] for n in nearby[k]), strict=True)
        )
        cuts = _cuts(a, b, normal, c, d, planes)
        places = np.unique(np.concatenate([[0.0, 1.0], cuts]))
        places = places[np.append(True, np.diff(places) > _ON)]
        places[-1] = 1.0
        pieces += len(places) - 1
        _check_pairs(pieces * _PIECES)
        points = a + places[:, None] * (b - a)
        starts.append(points[:-1])
        ends.append(points[1:])
        owner.append(np.full(len(places) - 1, k))
    if not owner:
        return np.empty((0, 3)), np.empty((0, 3)), np.empty(0, np.intp)
    return np.concatenate(starts), np.concatenate(ends), np.concatenate(owner)


def _check_pairs(count: int) -> None:
    if count > _MOST_PAIRS:
        raise ArgumentError(
            f"expected obstacles with at most {_MOST_PAIRS} pairs of an edge and a surface that "
            "may hide it, got more; simplify their meshes"
        )


def _cuts(a: Floats, b: Floats, normal: Floats, c: Floats, d: Floats, planes: Floats) -> Floats:
    """Shares of the edge from a to b at which lines from c to d cross it, or end on it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        # where the edge passes through the plane of a line, and there between its ends
        first, second = planes @ a, planes @ b
        at = first / (first - second)
        place = a + at[:, None] * (b - a)
        turn = np.einsum("mk,mk->m", np.cross(c, place), planes)
        rest = np.einsum("mk,mk->m", np.cross(place, d), planes)
        found = [at[(turn >= 0.0) & (rest >= 0.0)]]
        for ends in (c, d):
            on = np.abs(ends @ normal) <= _ON * np.linalg.norm(normal) * np.linalg.norm(
                ends, axis=1
            )
            low, high = np.cross(a, ends) @ normal, np.cross(b, ends) @ normal
            found.append((low / (low - high))[on & (ends @ (a + b) > 0.0)])
    shares = np.concatenate(found)
    return shares[(shares > 0.0) & (shares < 1.0)]
