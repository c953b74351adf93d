"""Whether the surface of a polyhedron bounds a convex body, and where faces see each other.

Convexity takes time linear in the edges: K. Mehlhorn et al., "Checking geometric programs or
verification of geometric structures", Comput. Geom. 12, 85 (1999). A closed surface bounds a convex
body if it is convex at every edge, if a point lies behind all faces, and if one ray from there
meets one face only.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Polyhedron

__all__ = ["corners_of_body", "corners_where_parts_touch", "is_convex", "lit_corners"]

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Sine of the angle by which faces in one plane may bend the wrong way after rounding. A dent this
# shallow shadows no more than this fraction of a body.
_FLAT = 1e-9
# Faces that meet at less than this are one bent face, as in ``sheets``: cosine of 30 degrees.
_SMOOTH = math.cos(math.radians(30))
# A part touches another within this fraction of the size of both: vertices of STL files are rounded
# to 1e-7. Triangles of parts are compared each with each, up to so many.
_TOUCHING = 1e-6
_MOST_TOUCHING = 1500
# Directions at a time.
_BLOCK = 1 << 14


def is_convex(body: Polyhedron) -> bool:
    """Whether no face can stand before another; False where rounding leaves it open."""
    found = _edges(body)
    if found is None:
        return False
    normals, _, _, height = found
    if (height > _FLAT).any():
        return False
    points = body.vertices
    centre = points.mean(axis=0)
    first = np.array([face[0] for face in body.faces])
    depth = ((points[first] - centre) * normals).sum(axis=1)
    return bool((depth > 0).all()) and _is_met_once(body, centre)


def corners_of_body(body: Polyhedron) -> Floats:
    """Outward normals (n, 2, 3) of both faces at concave edges, where these bend by 30 degrees.

    None of a body with faces that have no area, or edges at which it touches itself.
    """
    found = _edges(body)
    if found is None:
        return np.empty((0, 2, 3))
    normals, one, other, height = found
    both = np.stack([normals[one[height > _FLAT]], normals[other[height > _FLAT]]], axis=1)
    return _bent(both)


def corners_where_parts_touch(
    triangles: Floats, is_plate: NDArray[np.bool_], part: Indices
) -> Floats:
    """Normals (n, 2, 3) into the room between a face, and one of another part that ends on it.

    Parameters
    ----------
    triangles : (n, 3, 3) corners, counter-clockwise seen from outside.
    is_plate : (n,) which of them have two outer sides.
    part : (n,) numbers of the parts that they belong to.
    """
    if part[-1] == 0 or len(triangles) > _MOST_TOUCHING:
        return np.empty((0, 2, 3))
    small = _TOUCHING * float(np.linalg.norm(np.ptp(triangles.reshape(-1, 3), axis=0)))
    sides = np.roll(triangles, -1, axis=1) - triangles
    normals = np.cross(sides[:, 0], sides[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # heights (n, n, 3) of the corners of triangles, the second axis, over the planes of the first
    heights = np.einsum("ik,jck->ijc", normals, triangles)
    heights -= (normals * triangles[:, 0]).sum(axis=1)[:, None, None]
    flat = np.abs(heights) < small
    on_edge = flat & np.roll(flat, -1, axis=2) & (part[:, None] != part)[..., None]
    face, ending, edge = np.nonzero(on_edge & ~flat.all(axis=2, keepdims=True))
    begin, along = triangles[ending, edge], sides[ending, edge]
    # the part of the edge over the face: above each side's line, in the face's plane
    inwards = np.cross(normals[face, None], sides[face])
    inwards /= np.linalg.norm(inwards, axis=2, keepdims=True)
    at_begin = (inwards * (begin[:, None] - triangles[face])).sum(axis=2) + small
    slope = (inwards * along[:, None]).sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -at_begin / slope
    low = np.where(slope > 0, crossing, np.where(at_begin < 0, np.inf, 0.0)).max(axis=1)
    high = np.where(slope < 0, crossing, 1.0).min(axis=1)
    length = np.minimum(high, 1) - np.maximum(low, 0)
    touches = length * np.linalg.norm(along, axis=1) > 4 * small
    face, ending = face[touches], ending[touches]
    corners = []
    for one in (1.0, -1.0):
        for other in (1.0, -1.0):
            # outer sides, on which the other face has a corner
            seen = (one * heights[face, ending] > small).any(axis=1)
            seen &= (other * heights[ending, face] > small).any(axis=1)
            seen &= is_plate[face] if one < 0 else True
            seen &= is_plate[ending] if other < 0 else True
            both = [one * normals[face[seen]], other * normals[ending[seen]]]
            corners.append(np.stack(both, axis=1))
    return _bent(np.concatenate(corners))


def lit_corners(corners: Floats, travelling: Floats) -> bool:
    """Whether a wave that travels along k (m, 3) goes from one face of a corner to the other.

    Corners (n, 2, 3) as above. Near the edge the reflected wave meets the other face if it runs
    towards its plane.
    """
    both = np.concatenate([corners, corners[:, ::-1]])
    for start in range(0, len(travelling) if len(both) else 0, _BLOCK):
        k = travelling[start : start + _BLOCK]
        for first, second in both:
            onto = k @ first
            after = k @ second - 2 * onto * (first @ second)
            if ((onto < -_FLAT) & (after < -_FLAT)).any():
                return True
    return False


def _bent(corners: Floats) -> Floats:
    """Corners (n, 2, 3) that are no smooth face, each once."""
    bent = corners[(corners[:, 0] * corners[:, 1]).sum(axis=1) < _SMOOTH]
    return np.unique(bent.round(6), axis=0)


def _edges(body: Polyhedron) -> tuple[Floats, Indices, Indices, Floats] | None:
    """Normals of faces; of each edge its face, the face beyond it and how far that rises above.

    None where a face has no area, or bodies share an edge.
    """
    faces, points = body.faces, body.vertices
    counts = np.array([len(face) for face in faces])
    owner = np.repeat(np.arange(len(faces)), counts)
    begin = np.array([vertex for face in faces for vertex in face])
    last = np.cumsum(counts) - 1
    end = np.append(begin[1:], 0)
    end[last] = begin[last - counts + 1]
    normals = _normals(points, begin, end, owner, len(faces))
    here, there = _neighbours(begin, end, len(points))
    if here is None or there is None or not np.isfinite(normals).all():
        return None
    along = points[end] - points[begin]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    # From an edge into the face beyond it: above the plane of this one, where it is concave.
    inwards = np.cross(normals[owner[there]], along[there])
    height = (normals[owner[here]] * inwards).sum(axis=1)
    return normals, owner[here], owner[there], height


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
