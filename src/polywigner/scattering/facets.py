"""Conducting bodies and plates as triangles, which is all that scattering sees of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, triangulate
from polywigner.geometry.parts import connected
from polywigner.source import Array

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Facets that meet at less than this are of one bent face, as in meshes of smooth bodies.
SMOOTH = math.cos(math.radians(30))


# Sine of the angle by which faces in one plane may bend the wrong way after rounding. A dent this
# shallow shadows no more than this fraction of a body.
_FLAT = 1e-9
# Grid of normals and of heights over the body's size: planes on one point of it are one plane.
# Their waves lose step by some of this many turns for each wavelength of the body's size.
_ONE_PLANE = 1e-12
# Vertices within this fraction of the size are one: STL files round to 1e-7.
_ONE_VERTEX = 1e-6


@dataclass(frozen=True, eq=False)
class _Faces:
    """Faces (n,) of a body, and pairs (m,) of them that meet at edges, each in both orders."""

    body: Polyhedron
    normals: Floats
    """(n, 3), NaN where a face has no area."""
    areas: Floats
    one: Indices
    other: Indices
    height: Floats
    """(m,) sine of the angle by which the other face rises above the one: concave edges."""
    is_simple: bool
    """Whether all faces have areas, and no more than two of them meet at each edge."""

    def least_area(self) -> float:
        """The area of the smallest face in m^2; faces that join smoothly are one."""
        smooth = (self.normals[self.one] * self.normals[self.other]).sum(axis=1) > SMOOTH
        labels = connected(len(self.areas), self.one[smooth], self.other[smooth])
        sums = np.bincount(labels, self.areas)
        return float(sums[np.bincount(labels) > 0].min())

    def is_convex(self) -> bool:
        """Whether no face can stand before another; False where rounding leaves it open."""
        if not self.is_simple or (self.height > _FLAT).any():
            return False
        points = self.body.vertices
        centre = points.mean(axis=0)
        first = np.array([face[0] for face in self.body.faces])
        depth = ((points[first] - centre) * self.normals).sum(axis=1)
        # a ray through the middle of the first triangle meets it alone: it passes between three
        # planes through the centre, in front of it
        corners = points[self.body.triangles] - centre
        ray = corners[0].mean(axis=0)
        sides = [np.cross(corners[:, k], corners[:, (k + 1) % 3]) @ ray >= 0 for k in range(3)]
        return bool((depth > 0).all()) and int(np.all(sides, axis=0).sum()) == 1


def _faces_of(body: Polyhedron) -> _Faces:
    faces, points = body.faces, body.vertices
    counts = np.array([len(face) for face in faces])
    owner = np.repeat(np.arange(len(faces)), counts)
    begin = np.array([vertex for face in faces for vertex in face])
    last = np.cumsum(counts) - 1
    end = np.append(begin[1:], 0)
    end[last] = begin[last - counts + 1]
    origin = points[begin[last - counts + 1]][owner]
    crosses = np.cross(points[begin] - origin, points[end] - origin)
    sums = np.stack([np.bincount(owner, crosses[:, k], len(faces)) for k in range(3)], axis=1)
    areas, along = np.linalg.norm(sums, axis=1), points[end] - points[begin]
    with np.errstate(invalid="ignore", divide="ignore"):
        normals = sums / areas[:, None]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
    keys, reverse = begin * len(points) + end, end * len(points) + begin
    here, there = np.argsort(keys, kind="stable"), np.argsort(reverse, kind="stable")
    # from an edge into the face beyond it: above the plane of this one, where it is concave
    inwards = np.cross(normals[owner[there]], along[there])
    height = (normals[owner[here]] * inwards).sum(axis=1)
    is_simple = bool((np.diff(keys[here]) != 0).all() and np.isfinite(normals).all())
    return _Faces(body, normals, areas / 2, owner[here], owner[there], height, is_simple)


Body = Aperture | PlacedAperture | Polyhedron | Array | Sequence[Any]

_EXPECTED = "expected a body (Polyhedron, Aperture, placed Aperture, or an Array or list of these)"


@dataclass(frozen=True, eq=False)
class Facets:
    """Triangles (n,) in space, about the centre of the box around all of them."""

    corner: Floats
    """(n, 3)"""
    first: Floats
    """(n, 3) from the corner to the next one, counter-clockwise seen from outside."""
    second: Floats
    """(n, 3) from the corner to the last one."""
    is_plate: NDArray[np.bool_]
    """(n,) which triangles have two outer sides."""
    casts_shadows: bool
    """Whether one triangle may stand before another."""
    middle: Floats
    """(3,) the centre of the box, in the body's frame."""
    least_face: float
    """Root of the area of the smallest face; facets that join smoothly are one."""

    @cached_property
    def vector(self) -> Floats:
        """Outward normals times twice the area, (n, 3)."""
        return np.cross(self.first, self.second)

    @cached_property
    def normal(self) -> Floats:
        """Outward unit normals, (n, 3)."""
        return self.vector / np.linalg.norm(self.vector, axis=1, keepdims=True)

    @cached_property
    def corners(self) -> Floats:
        """(n, 3, 3): triangle, corner, component."""
        return self.corner[:, None] + np.stack(
            [np.zeros_like(self.first), self.first, self.second], axis=1
        )

    @cached_property
    def plane(self) -> Indices:
        """(n,) numbers of planes, the same for triangles in one, after rounding."""
        height = (self.normal * self.corner).sum(axis=1, keepdims=True) / self.size
        rows = np.round(np.concatenate([self.normal, height], axis=1) / _ONE_PLANE)
        return np.asarray(np.unique(rows + 0.0, axis=0, return_inverse=True)[1].ravel())

    @cached_property
    def surface(self) -> Indices:
        """(n,) numbers of surfaces, the same for triangles that join smoothly at common edges."""
        points = np.round(self.corners.reshape(-1, 3) / (_ONE_VERTEX * self.size))
        _, number = np.unique(points + 0.0, axis=0, return_inverse=True)
        begin = number.reshape(-1, 3)
        edges = np.sort(np.stack([begin, np.roll(begin, -1, axis=1)], axis=2), axis=2)
        keys = (edges[..., 0] * len(points) + edges[..., 1]).ravel()
        order = np.argsort(keys, kind="stable")
        (same,) = np.nonzero(keys[order][1:] == keys[order][:-1])
        one, other = order[same] // 3, order[same + 1] // 3
        cosine = (self.normal[one] * self.normal[other]).sum(axis=1)
        both_sides = self.is_plate[one] & self.is_plate[other]
        smooth = np.where(both_sides, np.abs(cosine), cosine) > SMOOTH
        return connected(len(begin), one[smooth], other[smooth])

    @cached_property
    def size(self) -> float:
        """Diagonal of the box around all triangles."""
        points = self.corners.reshape(-1, 3)
        return float(np.linalg.norm(np.ptp(points, axis=0)))


def facets_of(body: Any) -> Facets:
    """The triangles of a body; found once for a body that is the same again.

    Raises ArgumentError for anything but bodies and plates of uniform metal.
    """
    return _facets(_parts(body))


def _parts(body: Any) -> tuple[Any, ...]:
    if isinstance(body, Array):
        if not (body.weights == 1).all():
            raise ArgumentError(
                "expected an Array of bodies with all weights 1, got others; a conductor has no "
                "weight, so leave the weights out"
            )
        body = body.elements
    parts = tuple(body) if isinstance(body, Iterable) else (body,)
    if not parts:
        raise ArgumentError(f"{_EXPECTED}, got an empty list")
    for part in parts:
        if not isinstance(part, (Aperture, PlacedAperture, Polyhedron)):
            raise ArgumentError(f"{_EXPECTED}, got {type(part).__name__}")
        if not isinstance(part, Polyhedron) and _outline(part).illumination is not None:
            raise ArgumentError(
                "expected a plate without an illumination, got one with; the radar lights it, so "
                "take it off by with_illumination(None)"
            )
    return parts


# Hashes of bodies read all of their vertices, some ms for a million; building triangles takes more.
@lru_cache(maxsize=16)
def _facets(parts: tuple[Any, ...]) -> Facets:
    corners, plates = [], []
    for part in parts:
        found = part.vertices[part.triangles] if isinstance(part, Polyhedron) else _of_plate(part)
        area = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
        found = found[np.abs(area).max(axis=1) > 0]
        corners.append(found)
        plates.append(np.full(len(found), not isinstance(part, Polyhedron)))
    every = np.concatenate(corners)
    low, high = every.min(axis=(0, 1)), every.max(axis=(0, 1))
    middle = low + (high - low) / 2
    every = every - middle
    is_plate = np.concatenate(plates)
    bodies = [_faces_of(part) for part in parts if isinstance(part, Polyhedron)]
    areas = [_outline(part).area for part in parts if not isinstance(part, Polyhedron)]
    least = min(*areas, *(body.least_area() for body in bodies), math.inf)
    shadows = len(parts) > 1 or not (is_plate.all() or bodies[0].is_convex())
    return Facets(
        every[:, 0],
        every[:, 1] - every[:, 0],
        every[:, 2] - every[:, 0],
        is_plate,
        shadows,
        middle,
        math.sqrt(least),
    )


def _outline(plate: Aperture | PlacedAperture) -> Aperture:
    return plate.aperture if isinstance(plate, PlacedAperture) else plate


def _of_plate(plate: Aperture | PlacedAperture) -> Floats:
    """(n, 3, 3)"""
    pose = plate.pose if isinstance(plate, PlacedAperture) else np.eye(4)
    points, triangles = triangulate(_outline(plate))
    placed: Floats = points @ pose[:3, :2].T + pose[:3, 3]
    return placed[triangles]
