"""Whether the surface of a polyhedron bounds a convex body, in time linear in its edges.

K. Mehlhorn et al., "Checking geometric programs or verification of geometric structures", Comput.
Geom. 12, 85 (1999): a closed surface bounds a convex body if it is convex at every edge, if a point
lies behind all faces, and if one ray from there meets one face only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Polyhedron

__all__ = ["is_convex"]

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Sine of the angle by which faces in one plane may bend the wrong way after rounding. A dent this
# shallow shadows no more than this fraction of a body.
_FLAT = 1e-9


def is_convex(body: Polyhedron) -> bool:
    """Whether no face can stand before another; False where rounding leaves it open."""
    faces, points = body.faces, body.vertices
    counts = np.array([len(face) for face in faces])
    owner = np.repeat(np.arange(len(faces)), counts)
    begin = np.array([vertex for face in faces for vertex in face])
    last = np.cumsum(counts) - 1
    end = np.append(begin[1:], 0)
    end[last] = begin[last - counts + 1]
    normals = _normals(points, begin, end, owner, len(faces))
    if not np.isfinite(normals).all():
        return False
    here, there = _neighbours(begin, end, len(points))
    if here is None or there is None:
        return False
    along = points[end] - points[begin]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    # From an edge into the face beyond it: above the plane of this one, where it is concave.
    inwards = np.cross(normals[owner[there]], along[there])
    if ((normals[owner[here]] * inwards).sum(axis=1) > _FLAT).any():
        return False
    centre = points.mean(axis=0)
    depth = ((points[begin[last]] - centre) * normals).sum(axis=1)
    return bool((depth > 0).all()) and _is_met_once(body, centre)


def _normals(points: Floats, begin: Indices, end: Indices, owner: Indices, count: int) -> Floats:
    """Unit normals (count, 3), NaN where a face has no area."""
    origin = points[begin[np.searchsorted(owner, np.arange(count))]][owner]
    crosses = np.cross(points[begin] - origin, points[end] - origin)
    sums = np.stack([np.bincount(owner, crosses[:, k], count) for k in range(3)], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(sums / np.linalg.norm(sums, axis=1, keepdims=True))


def _neighbours(begin: Indices, end: Indices, count: int) -> tuple[Indices | None, Indices | None]:
    """Numbers of edges, and of those that run the other way; None where bodies share an edge."""
    keys, reverse = begin * count + end, end * count + begin
    order, other = np.argsort(keys), np.argsort(reverse)
    if (np.diff(keys[order]) == 0).any():
        return None, None
    return order, other


def _is_met_once(body: Polyhedron, centre: Floats) -> bool:
    """Whether the ray from the centre through the middle of the first triangle meets it alone."""
    corners = body.vertices[body.triangles] - centre
    ray = corners[0].mean(axis=0)
    # The ray passes between three planes through the centre, in front of it.
    sides = np.stack([np.cross(corners[:, k], corners[:, (k + 1) % 3]) @ ray for k in range(3)])
    return int((sides >= 0).all(axis=0).sum()) == 1
