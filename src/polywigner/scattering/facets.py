"""Conducting bodies and plates as triangles, and whether their faces light each other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, triangulate
from polywigner.geometry.arguments import warn_caller
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


# ---- faces that light each other ----------------------------------------------------------------

# Distance that counts as none, as a fraction of the body's size: STL files round vertices to 1e-7.
# Beams of less than the same fraction of its square are neglected.
_NEAR = 1e-6
# Triangles that are compared each with each, half of them the largest ones; comparisons at a time.
_MOST_TRIANGLES, _BLOCK = 1500, 1 << 18
# Directions that are looked at, and pairs of triangles for each: a second or two in all.
_MOST_DIRECTIONS, _MOST_BEAMS = 256, 4096
# Rays at a time whose obstacles are looked for.
_RAYS = 64
# Points of a beam: the middle of its cross section, and points near its corners.
_NEAR_CORNER = 0.9


def warn_of_reflections(facets: Facets, travelling: Floats) -> None:
    """Warn if waves that travel along k (m, 3) go from one face of a body to another one."""
    if lights_itself(facets, travelling):
        warn_caller(
            "faces of the body light each other: what comes back by two or three reflections is "
            "left out, which is most of it in corner reflectors; pass bounces=3 (docs/rcs.md)"
        )


def lights_itself(facets: Facets, travelling: Floats) -> bool:
    """Whether a wave that travels along one of k (m, 3) goes from one face to another.

    Faces that join smoothly, or whose planes are parallel within 30 degrees, do not count: they
    are curved, or send waves on rather than back. At most 256 directions are looked at.
    """
    if not facets.casts_shadows or not len(travelling):
        return False
    pairs = _facing_pairs(facets)
    if not len(pairs[0]):
        return False
    directions = np.unique(travelling, axis=0)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    step = math.ceil(len(directions) / _MOST_DIRECTIONS)
    return any(_lights(facets, pairs, k) for k in directions[::step])


_Pairs = tuple[Indices, Indices, Floats, Floats]
"""Numbers (n,) of triangles in front of each other's planes, and the normals (n, 3) there."""


@lru_cache(maxsize=16)
def _facing_pairs(facets: Facets) -> _Pairs:
    """Pairs of triangles of different surfaces that see each other if nothing is in between."""
    rows, small = _representatives(facets), _NEAR * facets.size
    normal, surface, is_plate = facets.normal[rows], facets.surface[rows], facets.is_plate[rows]
    corners = facets.corners[rows]
    level = (normal * corners[:, 0]).sum(axis=1)
    columns: list[list[Indices]] = []
    for start in range(0, len(rows), max(1, _BLOCK // len(rows))):
        some = slice(start, start + max(1, _BLOCK // len(rows)))
        bent = np.abs(normal[some] @ normal.T) < SMOOTH
        bent &= surface[some, None] != surface
        # heights of the others over the planes of some, and of some over the planes of the others
        heights = np.einsum("ik,jck->ijc", normal[some], corners) - level[some, None, None]
        back = np.einsum("jk,ick->ijc", normal, corners[some]) - level[None, :, None]
        for one, other in product((1, -1), repeat=2):
            faces = bent & ((one * heights).max(axis=2) > small)
            faces &= (other * back).max(axis=2) > small
            faces &= (is_plate[some, None] if one < 0 else True) & (is_plate if other < 0 else True)
            first, second = np.nonzero(faces)
            sides = np.full(len(first), one), np.full(len(first), other)
            columns.append([first + start, second, *sides])
    first, second, one_side, other_side = (
        np.concatenate(column) for column in zip(*columns, strict=True)
    )
    normals = one_side[:, None] * normal[first], other_side[:, None] * normal[second]
    return rows[first], rows[second], *normals


def _representatives(facets: Facets) -> Indices:
    """Numbers of triangles: all, or the largest ones and some of the others."""
    order = np.argsort(-np.linalg.norm(facets.vector, axis=1), kind="stable")
    if len(order) <= _MOST_TRIANGLES:
        return order
    half = _MOST_TRIANGLES // 2
    return np.concatenate([order[:half], order[half :: math.ceil(len(order) / half)]])


def _lights(facets: Facets, pairs: _Pairs, k: Floats) -> bool:
    """Whether a wave along k (3,) goes from the one triangle to the other of one of the pairs."""
    one, other, normal, other_normal = pairs
    onto = normal @ k
    after = other_normal @ k - 2 * onto * (normal * other_normal).sum(axis=1)
    (rows,) = np.nonzero((onto < -_NEAR) & (after < -_NEAR))
    some = rows[:: math.ceil(max(1, len(rows)) / _MOST_BEAMS)]
    places, ways, lengths = _beams(facets, one[some], other[some], normal[some], k)
    for start in range(0, len(places), _RAYS):
        few = slice(start, start + _RAYS)
        free = ~_blocked(facets, places[few], np.broadcast_to(-k, places[few].shape), np.inf)
        free[free] = ~_blocked(facets, places[few][free], ways[few][free], lengths[few][free])
        if free.any():
            return True
    return False


def _beams(
    facets: Facets, one: Indices, other: Indices, normal: Floats, k: Floats
) -> tuple[Floats, Floats, Floats]:
    """Points (m, 3) whose reflected rays meet the other triangle, the rays and their lengths."""
    ways = k - 2 * (normal @ k)[:, None] * normal
    across = np.cross(ways, np.eye(3)[np.abs(ways).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    axes = np.stack([across, np.cross(ways, across), ways], axis=2)
    both = [facets.corners[rows] @ axes for rows in (one, other)]
    low = np.maximum(*(part[..., :2].min(axis=1) for part in both))
    high = np.minimum(*(part[..., :2].max(axis=1) for part in both))
    (near,) = np.nonzero((low < high).all(axis=1))
    flat = [np.asarray(shapely.polygons(part[near, :, :2])) for part in both]
    shared = shapely.intersection(*flat)
    wide = shapely.area(shared) > _NEAR * facets.size**2
    shared, near = shared[wide], near[wide]
    middle = shapely.get_coordinates(shapely.centroid(shared))
    corners, owner = shapely.get_coordinates(shared, return_index=True)
    points = np.concatenate([middle, middle[owner] + _NEAR_CORNER * (corners - middle[owner])])
    rows = near[np.concatenate([np.arange(len(near)), owner])]
    depths = [_depths(part[rows], points) for part in both]
    lengths = depths[1] - depths[0]
    ahead = lengths > _NEAR * facets.size
    rows, lengths = rows[ahead], lengths[ahead]
    there = np.column_stack([points[ahead], depths[0][ahead]])
    return (axes[rows] @ there[:, :, None])[..., 0], ways[rows], lengths


def _depths(triangles: Floats, points: Floats) -> Floats:
    """Third coordinates (n,) of the planes of triangles (n, 3, 3) at points (n, 2)."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(first, second)
    beyond = ((points - triangles[:, 0, :2]) * normal[:, :2]).sum(axis=1)
    return np.asarray(triangles[:, 0, 2] - beyond / normal[:, 2])


def _blocked(
    facets: Facets, start: Floats, along: Floats, lengths: Floats | float
) -> NDArray[np.bool_]:
    """Whether rays (n, 3) of some lengths (n,) meet a triangle beyond where they start."""
    small = _NEAR * facets.size
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = along @ facets.normal.T
        height = (facets.normal * facets.corner).sum(axis=1) - start @ facets.normal.T
        distance = height / slope
        meets = (distance > small) & (distance < np.reshape(lengths, (-1, 1)) - small)
        ray, facet = np.nonzero(meets)
        place = start[ray] + distance[ray, facet][:, None] * along[ray]
    corners = facets.corners[facet]
    sides = np.roll(corners, -1, axis=1) - corners
    inside = np.cross(sides, place[:, None] - corners) @ facets.normal[facet][:, :, None]
    blocked = np.zeros(len(start), np.bool_)
    blocked[ray[(inside[..., 0] > 0).all(axis=1)]] = True
    return blocked
