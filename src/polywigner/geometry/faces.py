"""Polygonal faces in space: triangles, planarity, and the orientation of closed surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.parts import polygons_in

Points = NDArray[np.float64]
Indices = NDArray[np.intp]

# Sine of the least bend at a corner of a strictly convex face, above the rounding of the sides.
_BEND = 1e-9
# Fraction of a face's area by which rounding may change the area of its triangles.
_LOST = 1e-9
# Distance to a surface, as a fraction of the size, below which a point lies on the surface.
_ON_SURFACE = 1e-9
# Points of a surface that are tested for being inside another surface.
_SAMPLES = 16


def normals_of(corners: Points) -> Points:
    """Return the normals (k, 3) of faces (k, n, 3), as long as twice the face's area."""
    relative = corners - corners[:, :1]
    return np.cross(relative[:, :-1], relative[:, 1:]).sum(axis=1)


def heights_of(points: Points, faces: Sequence[Sequence[int]]) -> Points:
    """Return the largest distance of each face's vertices from the plane of the face.

    Parameters
    ----------
    points : (n, 3)
    faces : one list of vertex numbers for each face.

    Returns
    -------
    heights : (number of faces,) in the unit of the points.
    """
    heights = np.zeros(len(faces))
    for numbers, indices in _by_size(faces):
        corners = points[indices]
        if corners.shape[1] == 3:
            continue  # three points always lie in a plane
        normals = _unit(normals_of(corners))
        relative = corners - corners.mean(axis=1, keepdims=True)
        heights[numbers] = np.abs(np.einsum("kni,ki->kn", relative, normals)).max(axis=1)
    return heights


def triangulate_faces(points: Points, faces: Sequence[Sequence[int]]) -> Indices:
    """Return triangles that cover each face once, whether the face is convex or not.

    Convex faces become fans. Other faces are projected onto their plane and become constrained
    Delaunay triangles. An edge that a face runs along in both directions may lead to a hole.

    Parameters
    ----------
    points : (n, 3)
    faces : one list of vertex numbers for each face, three or more.

    Returns
    -------
    triangles : (m, 3) vertex numbers in the order of the faces, oriented as the faces.

    Raises
    ------
    GeometryError
        A face crosses itself.
    """
    triangles, owners = [np.empty((0, 3), np.intp)], [np.empty(0, np.intp)]
    for numbers, indices in _by_size(faces):
        size = indices.shape[1]
        fans = _are_convex(points[indices]) if size > 3 else np.ones(len(indices), dtype=bool)
        steps = np.arange(1, size - 1)
        first = np.broadcast_to(indices[fans, :1], (int(fans.sum()), size - 2))
        fan = np.stack([first, indices[fans][:, steps], indices[fans][:, steps + 1]], axis=-1)
        triangles.append(fan.reshape(-1, 3))
        owners.append(np.repeat(numbers[fans], size - 2))
        for number, face in zip(numbers[~fans], indices[~fans], strict=True):
            pieces = _triangles_of(points, face, int(number))
            triangles.append(pieces)
            owners.append(np.full(len(pieces), number))
    order = np.argsort(np.concatenate(owners), kind="stable")
    return np.concatenate(triangles)[order]


def _by_size(faces: Sequence[Sequence[int]]) -> list[tuple[Indices, Indices]]:
    """Numbers (k,) and vertex numbers (k, n) of the faces of each size n."""
    sizes = np.array([len(face) for face in faces])
    groups = [np.flatnonzero(sizes == size) for size in np.unique(sizes)]
    return [
        (group, np.array([faces[k] for k in group.tolist()], dtype=np.intp)) for group in groups
    ]


def _unit(vectors: Points) -> Points:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.nan_to_num(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _are_convex(corners: Points) -> NDArray[np.bool_]:
    """Return a mask (k,) of convex faces: equal signs of all bends, one turn in total."""
    sides = _unit(np.roll(corners, -1, axis=1) - corners)
    following = np.roll(sides, -1, axis=1)
    normals = _unit(normals_of(corners))
    bends = np.einsum("kni,ki->kn", np.cross(sides, following), normals)
    turns = np.arctan2(bends, (sides * following).sum(axis=2)).sum(axis=1)
    return (bends > _BEND).all(axis=1) & (turns < 3 * np.pi)


def _triangles_of(points: Points, face: Indices, number: int) -> Indices:
    """Constrained Delaunay triangles (m, 3) of one face."""
    corners = points[face]
    normal = _unit(normals_of(corners[None]))[0]
    x = _unit(np.cross(normal, np.eye(3)[np.abs(normal).argmin()]))
    flat = (corners - corners.mean(axis=0)) @ np.stack([x, np.cross(normal, x)], axis=1) + 0.0
    vertex = {corner.tobytes(): int(k) for corner, k in zip(flat, face, strict=True)}
    outline = shapely.Polygon(flat)
    area = float(normals_of(corners[None])[0] @ normal) / 2
    # An edge to a hole, run along in both directions, is left out of the valid polygon.
    parts = polygons_in(outline if outline.is_valid else shapely.make_valid(outline))
    pieces = [
        shapely.get_coordinates(shapely.constrained_delaunay_triangles(part)).reshape(-1, 4, 2)
        for part in parts
    ]
    found = np.concatenate([np.empty((0, 4, 2)), *pieces])[:, :3] + 0.0
    sides = found[:, 1:] - found[:, :1]
    twice = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    is_whole = abs(np.abs(twice).sum() / 2 - area) <= _LOST * area
    is_known = all(corner.tobytes() in vertex for corner in found.reshape(-1, 2))
    if not (area > 0 and is_whole and is_known):
        raise GeometryError(
            f"expected faces that do not cross themselves, got face {number} with vertices "
            f"{face[:8].tolist()}; split it into triangles"
        )
    numbers = [[vertex[corner.tobytes()] for corner in triangle] for triangle in found]
    result = np.array(numbers, dtype=np.intp)
    return result if twice.sum() > 0 else result[:, ::-1]


def connected(count: int, one: Indices, other: Indices) -> Indices:
    """Return labels (count,), equal for items that pairs (one, other) connect."""
    labels = np.arange(count)
    while True:
        least = np.minimum(labels[one], labels[other])
        before = labels.copy()
        for side in (one, other):
            np.minimum.at(labels, labels[side], least)
        labels = labels[labels]
        if (labels == before).all():
            return labels


def closed_surfaces(faces: Sequence[Sequence[int]]) -> list[Indices]:
    """Return the face numbers of each closed surface among faces that are closed together.

    Surfaces that touch in vertices or along edges are separate. Surfaces that share a face, as two
    boxes side by side do, count as one.
    """
    if not len(faces):
        return []
    counts = np.array([len(face) for face in faces])
    owner = np.repeat(np.arange(len(faces)), counts)
    begin = np.array([k for face in faces for k in face], dtype=np.int64)
    last = np.cumsum(counts) - 1
    end = np.roll(begin, -1)
    end[last] = begin[last - counts + 1]
    keys = np.minimum(begin, end) * (int(begin.max()) + 1) + np.maximum(begin, end)
    order = np.argsort(keys, kind="stable")
    _, starts, times = np.unique(keys[order], return_index=True, return_counts=True)
    pairs = starts[times == 2]  # two faces meet at the edge, and no other
    labels = connected(len(faces), owner[order[pairs]], owner[order[pairs + 1]])
    if (times != 2).any():
        # A surface is closed if each of its edges runs as often forwards as backwards.
        _, numbers = np.unique(np.stack([keys, labels[owner]]), axis=1, return_inverse=True)
        balance = np.bincount(numbers.ravel(), np.where(begin < end, 1, -1))
        is_open = np.zeros(len(faces), dtype=bool)
        is_open[labels[owner[balance[numbers.ravel()] != 0]]] = True
        labels = np.where(is_open[labels], int(is_open.argmax()), labels)
    return [np.flatnonzero(labels == label) for label in np.unique(labels)]


def nesting_of(surfaces: Sequence[Points]) -> NDArray[np.bool_]:
    """Return which closed surfaces lie around which others.

    Parameters
    ----------
    surfaces : triangles (m, 3, 3) of each surface.

    Returns
    -------
    around : (n, n) whether the first surface lies around the second one.
    """
    low = np.array([triangles.min(axis=(0, 1)) for triangles in surfaces])
    high = np.array([triangles.max(axis=(0, 1)) for triangles in surfaces])
    around = np.logical_and(low[:, None] <= low, high[:, None] >= high).all(axis=2)
    around = np.array(around, dtype=np.bool_)
    np.fill_diagonal(around, False)
    for outer, inner in np.argwhere(around):
        around[outer, inner] = _lies_inside(surfaces[inner], surfaces[outer])
    return around


# A rotation without symmetry, so that rays along z meet edges of boxes in no more than a point.
_TURN = np.linalg.qr(np.array([[0.31, 0.83, -0.47], [-0.62, 0.55, 0.71], [0.91, 0.13, 0.38]]))[0]


def _lies_inside(inner: Points, outer: Points) -> bool:
    """Whether all centroids of one surface's triangles that are not on the other lie inside it."""
    centroids = inner[:: max(1, len(inner) // _SAMPLES)].mean(axis=1) @ _TURN
    corners = outer @ _TURN
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    shadows = shapely.STRtree(shapely.polygons(corners[:, :, :2]))
    point, hit = shadows.query(shapely.points(centroids[:, :2]), predicate="intersects")
    normals = normals_of(corners)[hit]
    with np.errstate(invalid="ignore", divide="ignore"):
        slopes = normals[:, :2] / normals[:, 2:]
    offsets = centroids[point] - corners[hit, 0]
    heights = -(slopes * offsets[:, :2]).sum(axis=1) - offsets[:, 2]
    heights[~np.isfinite(heights)] = np.nan  # triangles seen edge-on
    crossings = np.bincount(point[heights > 0], minlength=len(centroids))
    on_surface = np.zeros(len(centroids), dtype=bool)
    on_surface[point[np.abs(heights) <= _ON_SURFACE * size]] = True
    is_inside = crossings[~on_surface] % 2 == 1
    return bool(len(is_inside)) and bool(is_inside.all())
