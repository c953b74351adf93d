"""Polyhedra: solid bodies bounded by planar faces; their triangles and closed surfaces."""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any, SupportsIndex, final

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.arguments import Immutable, finite_array, frozen, warn_caller
from polywigner.geometry.convex import triangulate_part
from polywigner.geometry.parts import connected, polygons_in
from polywigner.geometry.rings import rings_of_polygon
from polywigner.numerics import Indices, index_blocks

# Largest distance of a vertex from the plane of its face, as a fraction of the body's diameter;
# coordinates with ten digits are accurate enough.
_PLANAR = 1e-9

# Relative rounding error of radii and distances.
_ROUNDING = 1e-14
# Number of points whose distances to all points are computed at once: 80 MB for 10,000 points.
_ROWS = 1024

# Smallest sine of the angle between adjacent sides of a face that counts as convex.
_BEND = 1e-9
# Largest relative change in the area of a face when its outline is repaired.
_LOST = 1e-9
# Distance from a surface that counts as zero, as a fraction of the size of the surface.
_ON_SURFACE = 1e-9
# Approximate number of a surface's triangles that are tested for lying inside another surface.
_SAMPLES = 16

# Number of point-triangle pairs processed at once: about 50 MB.
_PAIRS = 1 << 18
# Smallest divisor, to avoid a division by zero.
_TINY = 1e-300

Vertices = NDArray[np.float64]


@final
class Polyhedron(Immutable):
    """A uniform solid with planar polygonal faces.

    Parameters
    ----------
    vertices : array_like, shape (n, 3)
        Positions in metres; any other unit works if it is used consistently.
    faces : iterable of sequences of int
        Three or more vertex numbers for each face, counter-clockwise from outside. Faces need not
        be convex. The faces may form several closed surfaces: separate bodies, which may touch,
        and cavities. A surface inside another surface is the wall of a cavity, and a surface
        inside a cavity is a body. A surface with inverted orientation is reversed.

    Raises
    ------
    GeometryError
        If a coordinate is not finite, a face is not planar or crosses itself, a surface is not
        closed or not consistently oriented, or the volume is zero.

    Warns
    -----
    PolywignerWarning
        If a surface inside another surface has the same orientation; it is treated as a cavity.

    Examples
    --------
    >>> import polywigner as pw
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> body = pw.Polyhedron(corners, [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
    >>> round(body.volume, 6)
    0.166667
    """

    vertices: Vertices
    """Positions in metres, shape (n, 3), read-only."""
    faces: tuple[tuple[int, ...], ...]
    """Vertex indices of each face, counter-clockwise seen from outside."""

    def __init__(self, vertices: ArrayLike, faces: Iterable[Iterable[SupportsIndex]]) -> None:
        expected = "expected vertices to be an (n, 3) array of numbers"
        points = finite_array(vertices, expected, (None, 3), error=GeometryError) + 0.0
        numbers = _checked_faces(faces, len(points))
        _check_closed(numbers)
        _check_planar(points, numbers)
        numbers, volume = _oriented(points, numbers)
        if volume <= 1e-15 * float(np.max(np.ptp(points, axis=0))) ** 3:
            raise GeometryError("expected faces that enclose a volume, got a volume of zero")
        self._set(vertices=points, faces=numbers)

    @cached_property
    def volume(self) -> float:
        """Volume in m^3."""
        return _volume_inside(self.vertices, self.faces)

    @cached_property
    def bounds(self) -> tuple[float, ...]:
        """Bounds (xmin, ymin, zmin, xmax, ymax, zmax) in metres."""
        return (*self.vertices.min(axis=0).tolist(), *self.vertices.max(axis=0).tolist())

    @cached_property
    def diameter(self) -> float:
        """Largest distance between two vertices in metres."""
        return _largest_distance(self.vertices)

    @cached_property
    def triangles(self) -> NDArray[np.intp]:
        """Vertex indices (m, 3) of triangles that cover the faces, with the same orientation."""
        return frozen(triangulate_faces(self.vertices, self.faces))

    @property
    def _key(self) -> tuple[bytes, tuple[tuple[int, ...], ...]]:
        """Vertices and faces, which are equal for equal bodies."""
        return self.vertices.tobytes(), self.faces

    def __repr__(self) -> str:
        return (
            f"Polyhedron({len(self.vertices)} vertices, {len(self.faces)} faces, "
            f"volume {self.volume:.6g})"
        )


def _largest_distance(points: Vertices) -> float:
    """Return the largest distance between any two of several points (n, 3)."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    offsets = points - centre
    radii = np.linalg.norm(offsets, axis=1)
    farthest = offsets[int(radii.argmax())]
    largest = float(np.linalg.norm(offsets - farthest, axis=1).max())
    # A point at radius r is at most r + max(radii) away from any other point.
    ends = offsets[radii >= (1 - _ROUNDING) * (largest - radii.max())]
    squares = (ends**2).sum(axis=1)
    for block in index_blocks(len(ends), _ROWS):
        squared_distances = squares[block, None] + squares - 2 * ends[block] @ ends.T
        largest = max(largest, float(np.sqrt(squared_distances.max())))
    return largest


def _checked_faces(faces: Any, count: int) -> tuple[tuple[int, ...], ...]:
    """Return faces as tuples of vertex indices from 0 to ``count`` - 1.

    Raises GeometryError for other values, and for faces with fewer than three different vertices.
    """
    try:
        numbers = tuple(tuple(operator.index(k) for k in face) for face in faces)
    except (TypeError, ValueError, OverflowError):
        raise GeometryError(
            "expected faces to be lists of vertex indices, got indices that are not whole numbers"
        ) from None
    for n, face in enumerate(numbers):
        if len(face) < 3 or len(set(face)) != len(face):
            raise GeometryError(
                f"expected three or more different vertices per face, got {list(face)} as face {n}"
            )
        wrong = [k for k in face if not 0 <= k < count]
        if wrong:
            raise GeometryError(
                f"expected vertex indices from 0 to {count - 1}, got {wrong[0]} in face {n}"
            )
    return numbers


def _check_closed(faces: Sequence[tuple[int, ...]]) -> None:
    """Raise GeometryError unless each directed edge occurs as often as its reverse.

    Faces that occur repeatedly, with any first vertex, also raise this error.
    """
    starts = [face.index(min(face)) for face in faces]
    canonical = Counter(f[k:] + f[:k] for f, k in zip(faces, starts, strict=True))
    repeated, count = next(iter(canonical.most_common(1)), ((), 0))
    if count > 1:
        raise GeometryError(
            f"expected each face only once, got the face {list(repeated)[:20]} {count} times; "
            "remove the repetitions"
        )
    edges = Counter((f[k - 1], f[k]) for f in faces for k in range(len(f)))
    for (a, b), count in edges.items():
        if count > max(1, edges[b, a]):
            raise GeometryError(
                f"expected consistently oriented faces, got two faces with an edge from vertex {a} "
                f"to vertex {b}; reverse one of them"
            )
        if edges[b, a] < count:
            raise GeometryError(
                f"expected a closed surface, got an edge from vertex {a} to vertex {b} with a "
                "face on only one side; add the missing face, or read an open mesh with "
                "polywigner.read_sheets"
            )


def _check_planar(points: Vertices, faces: Sequence[tuple[int, ...]]) -> None:
    """Raise GeometryError if a face crosses itself, or is not planar to 1e-9 of the diameter."""
    heights = heights_of(points, faces)
    diameter = float(np.linalg.norm(np.ptp(points, axis=0)))
    for n in np.flatnonzero(heights > _PLANAR * diameter).tolist():
        raise GeometryError(
            f"expected planar faces, got face {n} with a vertex {heights[n]:.3g} m away from "
            "its plane; split the face into triangles"
        )
    triangulate_faces(points, faces)


def _oriented(
    points: Vertices, faces: tuple[tuple[int, ...], ...]
) -> tuple[tuple[tuple[int, ...], ...], float]:
    """Return the faces, counter-clockwise as seen from outside, and the volume of the solid."""
    surfaces = closed_surfaces(faces)
    members = [[faces[k] for k in surface] for surface in surfaces]
    volumes = [_volume_inside(points, member) for member in members]
    around = np.zeros((len(surfaces),) * 2, dtype=bool)
    if len(surfaces) > 1:
        around = nesting_of([points[triangulate_faces(points, member)] for member in members])
    depths = around.sum(axis=0)
    total, oriented = 0.0, list(faces)
    for n, (surface, volume) in enumerate(zip(surfaces, volumes, strict=True)):
        sign = -1 if depths[n] % 2 else 1
        total += sign * abs(volume)
        if volume * sign < 0:
            for k in surface:
                oriented[k] = faces[k][::-1]
        outermost = np.flatnonzero(around[:, n] & (depths == 0))
        if sign < 0 and len(outermost) and volume * volumes[outermost[0]] > 0:
            warn_caller(
                f"the closed surface with face {surface[0]} lies inside another closed "
                "surface and counts as a cavity, although both have the same orientation; "
                "remove the inner surface if the body is solid there"
            )
    return tuple(oriented), total


def _volume_inside(points: Vertices, faces: Sequence[Sequence[int]]) -> float:
    """Return the volume inside a closed surface; negative if its faces point inwards."""
    centred = points - points.mean(axis=0)
    return sum(
        float((centred[indices[:, 0]] * normals_of(centred[indices])).sum()) / 6
        for _, indices in _by_size(faces)
    )


def normals_of(corners: Vertices) -> Vertices:
    """Return normals (k, 3) of faces (k, n, 3); their lengths are twice the areas of the faces.

    A normal points to the side from which the corners are counter-clockwise.
    """
    relative = corners - corners[:, :1]
    return np.cross(relative[:, :-1], relative[:, 1:]).sum(axis=1)


def axes_across(direction: Vertices) -> Vertices:
    """Return unit vectors (..., 2, 3) perpendicular to ``direction``, the axes of an image."""
    first = _unit(np.cross(direction, np.eye(3)[np.abs(direction).argmin(axis=-1)]))
    return np.stack([first, np.cross(first, direction)], axis=-2)


def heights_of(points: Vertices, faces: Sequence[Sequence[int]]) -> Vertices:
    """Return the largest distance (f,) of each face's vertices from the plane of the face.

    The plane contains the mean of the vertices.
    """
    heights = np.zeros(len(faces))
    for numbers, indices in _by_size(faces):
        corners = points[indices]
        if corners.shape[1] == 3:
            continue
        normals = _unit(normals_of(corners))
        relative = corners - corners.mean(axis=1, keepdims=True)
        heights[numbers] = np.abs(np.einsum("kni,ki->kn", relative, normals)).max(axis=1)
    return heights


def triangulate_faces(points: Vertices, faces: Sequence[Sequence[int]]) -> Indices:
    """Return vertex indices (m, 3) of triangles that cover each face once, in the order of faces.

    Faces that are not convex become constrained Delaunay triangles. A face may contain an edge
    twice, once in each direction, as a bridge to a hole. Raises GeometryError if a face crosses
    itself.
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
    """Group faces by their number n of vertices: face numbers (k,) and vertex indices (k, n)."""
    sizes = np.array([len(face) for face in faces])
    groups = [np.flatnonzero(sizes == size) for size in np.unique(sizes)]
    return [
        (group, np.array([faces[k] for k in group.tolist()], dtype=np.intp)) for group in groups
    ]


def _unit(vectors: Vertices) -> Vertices:
    """Return vectors (..., 3) divided by their lengths; zero vectors stay zero."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.nan_to_num(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _are_convex(corners: Vertices) -> NDArray[np.bool_]:
    """Return a mask (k,) of the planar faces with corners (k, n, 3) that are strictly convex."""
    sides = _unit(np.roll(corners, -1, axis=1) - corners)
    following = np.roll(sides, -1, axis=1)
    normals = _unit(normals_of(corners))
    bends = np.einsum("kni,ki->kn", np.cross(sides, following), normals)
    total = np.arctan2(bends, (sides * following).sum(axis=2)).sum(axis=1)
    return (bends > _BEND).all(axis=1) & (total < 3 * np.pi)


def _triangles_of(points: Vertices, face: Indices, number: int) -> Indices:
    """Return the vertex indices (m, 3) of triangles that cover a face of any simple shape.

    ``face``: vertex indices (n,). ``number``: index of the face, for the error message. Raises
    GeometryError if the face crosses itself.
    """
    corners = points[face]
    normal = _unit(normals_of(corners[None]))[0]
    flat = (corners - corners.mean(axis=0)) @ axes_across(-normal).T + 0.0
    vertex = {corner.tobytes(): int(k) for corner, k in zip(flat, face, strict=True)}
    outline = shapely.Polygon(flat)
    area = float(normals_of(corners[None])[0] @ normal) / 2
    # The outline contains each bridge to a hole twice, once in each direction. make_valid removes
    # these bridges.
    valid = outline if outline.is_valid else shapely.make_valid(outline)
    pieces = [np.empty((0, 2))]
    for part in polygons_in(shapely.orient_polygons(valid)):
        vertices, triangles = triangulate_part(tuple(rings_of_polygon(part)))
        pieces.append(vertices[triangles.ravel()])
    numbers = [vertex.get(corner.tobytes(), -1) for corner in np.concatenate(pieces)]
    is_complete = abs(valid.area - area) <= _LOST * area
    if not (area > 0 and is_complete and min(numbers, default=-1) >= 0):
        raise GeometryError(
            f"expected faces that do not cross themselves, got face {number} with vertices "
            f"{face[:8].tolist()}; split it into triangles"
        )
    return np.array(numbers, dtype=np.intp).reshape(-1, 3)


def closed_surfaces(faces: Sequence[Sequence[int]]) -> list[Indices]:
    """Split the faces of a closed mesh into closed surfaces, as arrays of face numbers.

    Surfaces that touch at vertices or edges are separate. Surfaces with a common face, such as two
    boxes side by side, count as one.
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
    _, starts, face_counts = np.unique(keys[order], return_index=True, return_counts=True)
    # Edges that belong to exactly two faces connect these faces.
    pairs = starts[face_counts == 2]
    labels = connected(len(faces), owner[order[pairs]], owner[order[pairs + 1]])
    if (face_counts != 2).any():
        # A surface is closed if each edge occurs equally often in both directions.
        _, numbers = np.unique(np.stack([keys, labels[owner]]), axis=1, return_inverse=True)
        balance = np.bincount(numbers.ravel(), np.where(begin < end, 1, -1))
        is_open = np.zeros(len(faces), dtype=bool)
        is_open[labels[owner[balance[numbers.ravel()] != 0]]] = True
        labels = np.where(is_open[labels], int(is_open.argmax()), labels)
    return [np.flatnonzero(labels == label) for label in np.unique(labels)]


def nesting_of(surfaces: Sequence[Vertices]) -> NDArray[np.bool_]:
    """Return a matrix (n, n), whose entries state whether closed surface i encloses surface j.

    Each surface consists of triangles (m, 3, 3).
    """
    low = np.array([triangles.min(axis=(0, 1)) for triangles in surfaces])
    high = np.array([triangles.max(axis=(0, 1)) for triangles in surfaces])
    around = np.logical_and(low[:, None] <= low, high[:, None] >= high).all(axis=2)
    around = np.array(around, dtype=np.bool_)
    np.fill_diagonal(around, False)
    for outer, inner in np.argwhere(around):
        around[outer, inner] = _lies_inside(surfaces[inner], surfaces[outer])
    return around


def _lies_inside(inner: Vertices, outer: Vertices) -> bool:
    """Return whether the triangles ``inner`` (m, 3, 3) lie inside the closed surface ``outer``.

    The centroids of about 16 of the triangles must all be inside. Centroids on the surface are
    ignored; if all centroids are on the surface, the result is False.
    """
    centroids = inner[:: max(1, len(inner) // _SAMPLES)].mean(axis=1)
    size = float(np.ptp(outer.reshape(-1, 3), axis=0).max())
    centroids = centroids[distances_from(outer, centroids) > _ON_SURFACE * size]
    windings = np.abs(windings_about(centroids, outer))
    return bool(len(windings)) and bool((np.round(windings) % 2 == 1).all())


def distances_from(corners: Vertices, points: Vertices) -> Vertices:
    """Return the distance of each point (n, 3) from the nearest of the triangles (m, 3, 3)."""
    blocks = [points[some, None] for some in index_blocks(len(points), _PAIRS // len(corners))]
    return np.concatenate(
        [np.empty(0), *(point_distances(block, corners).min(axis=1) for block in blocks)]
    )


def point_distances(points: Vertices, corners: Vertices) -> Vertices:
    """Return the distances of points (..., 3) from triangles (..., 3, 3), which are broadcast."""
    best = np.array(np.inf)
    above = np.array(True)
    normal = np.cross(
        corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    )
    for k in range(3):
        side = corners[..., (k + 1) % 3, :] - corners[..., k, :]
        ahead = points - corners[..., k, :]
        fraction = np.vecdot(ahead, side) / np.maximum(np.vecdot(side, side), _TINY)
        off = ahead - np.clip(fraction, 0.0, 1.0)[..., None] * side
        best = np.minimum(best, np.linalg.norm(off, axis=-1))
        above = above & (np.vecdot(ahead, np.cross(normal, side)) >= 0.0)
    area = np.linalg.norm(normal, axis=-1)
    height = np.abs(np.vecdot(ahead, normal)) / np.maximum(area, _TINY)
    return np.where(above & (area > 0.0), height, best)


def windings_about(points: Vertices, corners: Vertices) -> Vertices:
    """Return the winding numbers (n,) of a closed surface (m, 3, 3) about points (n, 3).

    The numbers are sums of solid angles. They are 1 for points inside a surface whose corners are
    counter-clockwise as seen from outside, and 1/2 for points on a face. Source: A. Van Oosterom
    and J. Strackee, "The solid angle of a plane triangle", 1983.
    """
    windings = np.empty(len(points))
    for block in index_blocks(len(points), _PAIRS // len(corners)):
        a, b, c = np.moveaxis(corners - points[block, None, None], -2, 0)
        x, y, z = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        below = x * y * z + np.vecdot(a, b) * z + np.vecdot(b, c) * x + np.vecdot(c, a) * y
        triple = np.vecdot(a, np.cross(b, c))
        windings[block] = np.arctan2(triple, below).sum(axis=1) / (2 * np.pi)
    return windings
