"""Opaque bodies and plates as triangles: how a source of light sees each of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry.aperture import PlacedAperture, triangulate
from polywigner.geometry.parts import connected
from polywigner.geometry.polyhedron import Polyhedron

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Places this close are on an edge or in a plane, as a fraction of a body's size.
ON = 1e-9
# Sizes of a body from which its outline is that seen from infinity.
_AFAR = 1e6
# Pairs of a point and a triangle at a time: some 50 MB.
PAIRS = 1 << 20


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
        step = max(1, PAIRS // len(corners))
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

    @property
    def rim(self) -> Floats | None:
        """Edges (m, 2, 3) of a plate or an open mesh that belong to one triangle; None for none."""
        ends = np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=2)
        keys, times = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_counts=True)
        return self.vertices[keys[times == 1]] if (times == 1).any() else None

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
        if np.abs(height).max() <= ON * np.ptp(self.vertices, axis=0).max():
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
    convex = _is_convex(points, points[[face[0] for face in body.faces]], normals)
    # a convex surface of several bodies would have vertices before its faces
    return Obstacle(points, triangles, owner, normals, True, convex)


def shells(body: Obstacle) -> list[Obstacle]:
    """The connected surfaces of a body, each a body; of a plate its only one."""
    a, b, c = body.triangles.T
    label = connected(len(body.vertices), np.append(a, a), np.append(b, c))
    numbers = np.unique(label[a])
    if not body.is_solid or len(numbers) == 1:
        return [body]
    found = []
    for number in numbers:
        rows = label[a] == number
        used, corners = np.unique(body.triangles[rows], return_inverse=True)
        faces, owner = np.unique(body.owner[rows], return_inverse=True)
        points, normals = body.vertices[used], body.normals[faces]
        triangles = corners.reshape(-1, 3)
        simple = _is_convex(
            points, points[triangles[np.unique(owner, return_index=True)[1], 0]], normals
        )
        found.append(Obstacle(points, triangles, owner.ravel(), normals, True, simple))
    return found


def _is_convex(points: Floats, places: Floats, normals: Floats) -> bool:
    """Whether no point (n, 3) is in front of a face, by a place in each and the normals."""
    offsets = np.einsum("fk,fk->f", normals, places)
    size = float(np.ptp(points, axis=0).max()) * np.linalg.norm(normals, axis=1)
    return bool((normals @ points.T - offsets[:, None] <= ON * size[:, None]).all())


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
