"""Opaque bodies and plates as triangles: how a source sees each of them, and which ones meet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry.aperture import PlacedAperture, triangulate
from polywigner.geometry.parts import connected
from polywigner.geometry.polyhedron import (
    Polyhedron,
    distances_from,
    dot_products,
    point_distances,
)

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Places this close are on an edge or in a plane, as a fraction of a body's size.
ON = 1e-9
# Sizes of a body from which its outline is that seen from infinity.
_AFAR = 1e6
# Pairs of a point, a ray or a triangle with a triangle at a time: some 50 MB.
PAIRS, _PAIRS_OF_TRIANGLES = 1 << 20, 1 << 14


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
        return distances_from(self.vertices[self.triangles], points)

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


def contacts(
    meshes: Sequence[Floats], rims: Sequence[Floats | None], within: float
) -> list[tuple[int, int]]:
    """Return pairs of meshes (t, 3, 3) that cross, or whose distance is at most ``within``.

    ``rims``: edges (m, 2, 3) of the rims of sheets, None for closed meshes. A sheet is in contact
    where something comes close to its rim, or passes through it: not where something stands on it.
    """
    boxes = np.array([[mesh.min(axis=(0, 1)), mesh.max(axis=(0, 1))] for mesh in meshes])
    # edges as triangles without area
    ends = [
        mesh if rim is None else rim[:, [0, 1, 1]] for mesh, rim in zip(meshes, rims, strict=True)
    ]
    pairs = []
    for one, other in np.column_stack(_overlapping(boxes, boxes, within)).tolist():
        if one < other and (
            any(_are_near(*some, within) for some in _near(ends[one], ends[other], within))
            or any(_cross(*some, within).any() for some in _near(meshes[one], meshes[other], 0.0))
        ):
            pairs.append((one, other))
    return pairs


def _overlapping(boxes: Floats, others: Floats, within: float) -> tuple[Indices, Indices]:
    """Numbers of boxes (n, 2, 3) and (m, 2, 3), lowest and highest corner, that are near."""
    low, high = boxes[:, 0] - within, boxes[:, 1] + within
    tree = shapely.STRtree(shapely.box(*others[:, 0, :2].T, *others[:, 1, :2].T))
    one, other = tree.query(shapely.box(*low[:, :2].T, *high[:, :2].T))
    near = (others[other, 0, 2] <= high[one, 2]) & (others[other, 1, 2] >= low[one, 2])
    return one[near], other[near]


def _near(one: Floats, other: Floats, within: float) -> Iterator[tuple[Floats, Floats]]:
    """Triangles (n, 3, 3) of both meshes whose boxes are near, some at a time."""
    boxes = [np.stack([mesh.min(axis=1), mesh.max(axis=1)], axis=1) for mesh in (one, other)]
    rows = []
    for mine, theirs in (boxes, boxes[::-1]):
        if not len(theirs):
            return
        low, high = theirs[:, 0].min(axis=0) - within, theirs[:, 1].max(axis=0) + within
        rows.append(np.flatnonzero(((mine[:, 0] <= high) & (mine[:, 1] >= low)).all(axis=1)))
    first, second = _overlapping(boxes[0][rows[0]], boxes[1][rows[1]], within)
    for start in range(0, len(first), _PAIRS_OF_TRIANGLES):
        some = slice(start, start + _PAIRS_OF_TRIANGLES)
        yield one[rows[0][first[some]]], other[rows[1][second[some]]]


def _are_near(one: Floats, other: Floats, within: float) -> bool:
    """Whether any pair of triangles (n, 3, 3) crosses or is within a distance of each other."""
    for mine, theirs in ((one, other), (other, one)):
        if (point_distances(np.moveaxis(mine, 1, 0), theirs) <= within).any():
            return True
    for k, j in product(range(3), repeat=2):
        ends = one[:, k], one[:, (k + 1) % 3], other[:, j], other[:, (j + 1) % 3]
        if (_between_segments(*ends) <= within).any():
            return True
    return bool(_cross(one, other, 0.0).any())


def _between_segments(start: Floats, end: Floats, begin: Floats, stop: Floats) -> Floats:
    """Distances (n,) of pairs of segments (Ericson, Real-Time Collision Detection, 5.1.9)."""
    along, beside, apart = end - start, stop - begin, start - begin
    a, e, b = dot_products(along, along), dot_products(beside, beside), dot_products(along, beside)
    c, f = dot_products(along, apart), dot_products(beside, apart)
    area = a * e - b * b
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(area > 1e-12 * a * e, np.clip((b * f - c * e) / area, 0.0, 1.0), 0.0)
        t = np.where(e > 0.0, np.clip((b * s + f) / e, 0.0, 1.0), 0.0)
        s = np.where(a > 0.0, np.clip((b * t - c) / a, 0.0, 1.0), 0.0)
    return np.linalg.norm(apart + s[:, None] * along - t[:, None] * beside, axis=1)


def _cross(one: Floats, other: Floats, depth: float) -> NDArray[np.bool_]:
    """Whether a side of one triangle (n, 3, 3) passes through the other, by more than a depth."""
    found = np.zeros(len(one), bool)
    for mine, theirs in ((one, other), (other, one)):
        a, b, c = np.moveaxis(theirs, 1, 0)
        normal = np.cross(b - a, c - a)
        height = np.stack([dot_products(mine[:, k] - a, normal) for k in range(3)])
        far = np.abs(height) > depth * np.linalg.norm(normal, axis=1)
        for k in range(3):
            j = (k + 1) % 3
            p, along = mine[:, k], mine[:, j] - mine[:, k]
            sides = (a, b), (b, c), (c, a)
            turns = np.stack([dot_products(np.cross(s - p, e - p), along) for s, e in sides])
            inside = (turns > 0.0).all(axis=0) | (turns < 0.0).all(axis=0)
            found |= inside & far[k] & far[j] & (height[k] * height[j] < 0.0)
    return found
