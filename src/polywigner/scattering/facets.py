"""Conducting bodies and plates as triangles, their visible parts, and their Fourier transforms."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.execution.progress import with_progress
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron
from polywigner.geometry.arguments import warn_caller
from polywigner.geometry.hidden_parts import (
    GRID,
    NOTHING,
    Projected,
    Shapes,
    edges_around,
    in_perspective,
    in_triangles,
    intersections,
    mended,
    visible_parts,
)
from polywigner.geometry.parts import connected
from polywigner.geometry.polyhedron import axes_across, normals_of
from polywigner.geometry.silhouettes import listed_bodies, obstacle_of, shells
from polywigner.numerics import Columns, Complex, Floats, Indices, cluster_indices, index_blocks
from polywigner.numerics.phases import rotated, simplex_plane_wave
from polywigner.source import Array

Sides = NDArray[np.int8]
"""1 for the outer side of a triangle, -1 for the back of a plate, 0 for neither."""

Body = Aperture | PlacedAperture | Polyhedron | Array | Sequence[Any]

# Smallest cosine between normals of adjacent triangles of a smooth face.
SMOOTH = math.cos(math.radians(30))
# Tolerance on the normals of coplanar triangles, and on their plane offsets relative to the body
# size. Multiplied by the body size in wavelengths, it is the phase error in cycles.
_ONE_PLANE = 1e-12
# Distance within which vertices count as identical, relative to the body size. Coordinates in STL
# files are rounded to 1e-7.
_ONE_VERTEX = 1e-6


@dataclass(frozen=True, eq=False)
class Facets:
    """Surface of a body as n triangles, relative to the centre of its bounding box."""

    corner: Floats
    """First corners in m, shape (n, 3)."""
    first: Floats
    """Vectors to the second corners, counter-clockwise from outside, shape (n, 3)."""
    second: Floats
    """Vectors to the third corners, shape (n, 3)."""
    is_plate: NDArray[np.bool_]
    """Whether the triangle belongs to a plate, which has two outer sides, shape (n,)."""
    casts_shadows: bool
    """Whether a triangle may hide another triangle."""
    centre: Floats
    """Centre of the bounding box in the body's frame in m, shape (3,)."""

    @cached_property
    def vector(self) -> Floats:
        """Outward normals times twice the areas in m^2, shape (n, 3)."""
        return np.cross(self.first, self.second)

    @cached_property
    def normal(self) -> Floats:
        """Outward unit normals, shape (n, 3)."""
        return self.vector / np.linalg.norm(self.vector, axis=1, keepdims=True)

    @cached_property
    def corners(self) -> Floats:
        """Corners relative to the body's centre in m, shape (triangle, corner, component)."""
        return self.corner[:, None] + np.stack(
            [np.zeros_like(self.first), self.first, self.second], axis=1
        )

    @cached_property
    def plane(self) -> Indices:
        """Index of the plane of each triangle, shape (n,)."""
        height = (self.normal * self.corner).sum(axis=1, keepdims=True) / self.size
        return cluster_indices(np.concatenate([self.normal, height], axis=1), _ONE_PLANE)

    @cached_property
    def neighbours(self) -> tuple[Indices, Indices]:
        """Indices of pairs of triangles with a common edge, as two arrays (k,)."""
        points = np.round(self.corners.reshape(-1, 3) / (_ONE_VERTEX * self.size)).astype(np.int64)
        _, number = np.unique(points, axis=0, return_inverse=True)
        begin = number.reshape(-1, 3)
        edges = np.sort(np.stack([begin, np.roll(begin, -1, axis=1)], axis=2), axis=2)
        keys = (edges[..., 0] * len(points) + edges[..., 1]).ravel()
        order = np.argsort(keys, kind="stable")
        (same,) = np.nonzero(keys[order][1:] == keys[order][:-1])
        return order[same] // 3, order[same + 1] // 3

    @cached_property
    def surface(self) -> Indices:
        """Index of the smooth face that contains each triangle, shape (n,)."""
        first, second = self.neighbours
        cosine = (self.normal[first] * self.normal[second]).sum(axis=1)
        both_sides = self.is_plate[first] & self.is_plate[second]
        smooth = np.where(both_sides, np.abs(cosine), cosine) > SMOOTH
        return connected(len(self.corner), first[smooth], second[smooth])

    @cached_property
    def least_face(self) -> float:
        """Square root of the area of the smallest face, in m."""
        areas = np.bincount(self.surface, np.linalg.norm(self.vector, axis=1) / 2)
        return math.sqrt(areas[np.bincount(self.surface) > 0].min())

    @cached_property
    def size(self) -> float:
        """Diagonal of the bounding box in m."""
        points = self.corners.reshape(-1, 3)
        return float(np.linalg.norm(np.ptp(points, axis=0)))


def facets_of(body: Any) -> Facets:
    """Return the triangles of a body or plate, cached for equal bodies.

    Raises ArgumentError for other objects, and for plates with an illumination.
    """
    return _facets(_bodies(body))


def _bodies(body: Any) -> tuple[Polyhedron | PlacedAperture, ...]:
    """Return bodies and plates as a tuple; raise ArgumentError for other objects."""
    if isinstance(body, Array):
        if not (body.weights == 1).all():
            raise ArgumentError("expected an Array of bodies without weights; omit the weights")
        body = body.elements
    parts = body if isinstance(body, Iterable) else [body]
    return listed_bodies(
        [part.placed(np.eye(4)) if isinstance(part, Aperture) else part for part in parts]
    )


# Hashing a million vertices takes some ms, which is less than the computation of their triangles.
@lru_cache(maxsize=16)
def _facets(parts: tuple[Polyhedron | PlacedAperture, ...]) -> Facets:
    """Return the triangles of all bodies and plates."""
    surfaces = [surface for part in parts for surface in shells(obstacle_of(part))]
    corners, plates = [], []
    for surface in surfaces:
        points = surface.vertices[surface.triangles]
        points = points[np.abs(normals_of(points)).max(axis=1) > 0]
        corners.append(points)
        plates.append(np.full(len(points), not surface.is_solid))
    triangles = np.concatenate(corners)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    centre = low + (high - low) / 2
    triangles = triangles - centre
    return Facets(
        triangles[:, 0],
        triangles[:, 1] - triangles[:, 0],
        triangles[:, 2] - triangles[:, 0],
        np.concatenate(plates),
        len(surfaces) > 1 or not surfaces[0].is_simple,
        centre,
    )


# Cosine of the incidence angle below which faces count as edge-on and dark.
_EDGE_ON = 1e-12
_TRIANGLE = shapely.Polygon([(0, 0), (1, 0), (0, 1)])


@dataclass(frozen=True)
class Pieces(Columns):
    """Illuminated or visible surface as n triangles."""

    corner: Floats
    """First corners in m, shape (n, 3)."""
    first: Floats
    """Vectors to the second corners, shape (n, 3)."""
    second: Floats
    """Vectors to the third corners, shape (n, 3)."""
    vector: Floats
    """Normals on the illuminated side, times twice the areas, shape (n, 3)."""

    def __len__(self) -> int:
        return len(self.corner)


@dataclass(frozen=True, eq=False)
class Visible:
    """Visible sides and parts of the n triangles of a body."""

    signs: Sides
    """Visible side, shape (n,)."""
    parts: Shapes
    """Visible polygon, None for the entire triangle, shape (n,). Coordinates are along two sides,
    so the corners of the triangle are (0, 0), (1, 0) and (0, 1)."""


def facing(facets: Facets, direction: Floats, block: slice = slice(None)) -> Sides:
    """Return the sides of triangles that face distant observers who look along ``direction``.

    The result contains values of `Sides`, and has the shape (..., n) for directions (..., 3).
    """
    return _sides(direction @ facets.normal[block].T, facets.is_plate[block])


def facing_point(facets: Facets, point: Floats) -> Sides:
    """Return the sides of triangles that face a point (3,), as in :func:`facing`, shape (n,).

    The point is relative to the body's centre, in m.
    """
    away = facets.corner - point
    distance = np.maximum(np.linalg.norm(away, axis=1), np.finfo(float).tiny)
    return _sides((away * facets.normal).sum(axis=1) / distance, facets.is_plate)


def _sides(cosine: Floats, is_plate: NDArray[np.bool_]) -> Sides:
    """Return the sides of triangles that face an observer, as in :func:`facing`.

    ``cosine``: cosine between the outward normals and the direction from the observer, negative for
    the outer side.
    """
    sides = (cosine < -_EDGE_ON).astype(np.int8)
    sides -= ((cosine > _EDGE_ON) & is_plate).astype(np.int8)
    return sides


def visible_along(facets: Facets, direction: Floats) -> Visible:
    """Return the parts of triangles that a distant observer looking along ``direction`` sees.

    ``direction`` (3,): unit vector from the observer to the body.
    """
    across = axes_across(direction)

    def projected(corners: Floats) -> Projected:
        """Project corners (n, 3, 3) along parallel lines onto the image."""
        depth = corners @ direction
        return Projected(corners @ across.T, depth, facets.size, np.ones_like(depth))

    return _visible(facets, facing(facets, direction), projected)


def visible_from(facets: Facets, point: Floats, frame: Floats) -> Visible:
    """Return the parts of triangles that an observer at a point sees.

    ``point`` (3,) is relative to the body's centre, in m. The rows of ``frame`` are the observer's
    axes; z is the viewing direction. All triangles must be in front of the observer. The
    perspective image maps planes to planes.
    """
    distance = float(((facets.corners - point) @ frame[2]).mean())

    def projected(corners: Floats) -> Projected:
        """Project corners (n, 3, 3) in perspective onto the image."""
        return in_perspective(corners - point, frame, distance, facets.size)

    return _visible(facets, facing_point(facets, point), projected)


def _visible(facets: Facets, signs: Sides, project: Callable[[Floats], Projected]) -> Visible:
    """Return the visible parts of the sides ``signs``, computed from projections onto an image.

    Hidden sides of closed bodies cast no additional shadows.
    """
    parts: Shapes = np.full(len(signs), None)
    (rows,) = np.nonzero(signs)
    corners = facets.corners[rows]
    is_reversed = signs[rows] < 0
    # Make all triangles counter-clockwise.
    corners[is_reversed] = corners[is_reversed][:, ::-1]
    projected = project(corners)
    wide = projected.has_width
    rows, projected = rows[wide], projected.subset(wide)
    polygons = np.asarray(shapely.polygons(projected.points), dtype=object)
    touched, left = visible_parts(projected, polygons, polygons)
    if not len(touched):
        return Visible(signs, parts)
    areas, least = shapely.area(left), NOTHING * facets.size * shapely.length(polygons[touched])
    signs[rows[touched[areas <= least]]] = 0
    is_cut = (areas > least) & (shapely.area(polygons[touched]) - areas > least)
    owners = rows[touched[is_cut]]
    points, ranges = projected.points[touched[is_cut]], projected.ranges[touched[is_cut]]
    for corners in (points, ranges):
        corners[signs[owners] < 0] = corners[signs[owners] < 0][:, ::-1]
    parts[owners] = in_triangles(left[is_cut], points, ranges)
    return Visible(signs, parts)


def less_hidden(illuminated: Visible, visible: Visible, faces: Sides) -> Visible:
    """Return the illuminated parts, except for parts that are hidden from a receiver.

    ``faces`` are the sides that face the receiver. Illuminated sides that face away from the
    receiver remain, because they contribute to the forward field.
    """
    signs, parts = illuminated.signs.copy(), illuminated.parts.copy()
    faces_receiver = (signs != 0) & (signs == faces)
    signs[faces_receiver & (visible.signs == 0)] = 0
    (cut,) = np.nonzero(faces_receiver & (visible.signs != 0) & ~shapely.is_missing(visible.parts))
    before = parts[cut]
    before[shapely.is_missing(before)] = _TRIANGLE
    parts[cut] = intersections(mended(before), mended(visible.parts[cut]), GRID)
    return Visible(signs, parts)


def visible_pieces(facets: Facets, visible: Visible) -> Pieces:
    """Return the visible parts of a body, divided into triangles."""
    (rows,) = np.nonzero(visible.signs)
    return pieces_of(facets, rows, visible.signs[rows], visible.parts[rows])[0]


def pieces_of(
    facets: Facets, numbers: Indices, signs: Sides, parts: Shapes
) -> tuple[Pieces, Indices]:
    """Divide m parts of triangles into triangles; also return the part index of each triangle.

    ``numbers``, ``signs`` and ``parts``: index of the original triangle, its visible side, and the
    part as in :class:`Visible`. A cut part becomes triangles between the first corner of its
    original triangle and each edge of the part. Areas may be negative; a negative area reverses
    ``Pieces.vector``.
    """
    (complete,) = np.nonzero(shapely.is_missing(parts))
    (cut,) = np.nonzero(~shapely.is_missing(parts))
    owner, begin, end = edges_around(parts[cut])
    owner = cut[owner]
    first, second = facets.first[numbers[owner]], facets.second[numbers[owner]]
    measure = begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0]
    weights = np.concatenate([signs[complete], signs[owner] * measure])

    def at(point: Floats) -> Floats:
        """Map coordinates along two sides of the cut triangles to vectors (k, 3)."""
        return point[:, :1] * first + point[:, 1:] * second

    rows = np.concatenate([complete, owner])
    pieces = Pieces(
        facets.corner[numbers[rows]],
        np.concatenate([facets.first[numbers[complete]], at(begin)]),
        np.concatenate([facets.second[numbers[complete]], at(end)]),
        facets.vector[numbers[rows]] * weights[:, None],
    )
    return pieces, rows


Signs = Callable[[slice, slice], Sides]

_OPS = execution.NumpyOperations()
_TITLE = "radar cross sections"
# Largest product of the numbers of triangles and directions per block. About twenty arrays of this
# size fit into the processor's cache.
_AT_ONCE = 1 << 14


def surface_sums(pieces: Pieces, nu: Floats, signs: Signs | None = None) -> Complex:
    """Return the Fourier transform N, equation (SC1), in m^2 at frequencies nu (m, 3) in 1/m.

    ``signs``: function that returns the signs for a slice of frequencies and a slice of triangles,
    0 for dark triangles. By default all signs are 1. The result has the shape (m, 3).
    """
    result = np.zeros((len(nu), 3), np.complex128)
    columns = max(1, min(len(pieces), _AT_ONCE))
    of_directions = index_blocks(len(nu), _AT_ONCE // columns)
    of_triangles = index_blocks(len(pieces), columns)
    with with_progress(_TITLE, list(product(of_directions, of_triangles))) as blocks:
        for rows_here, columns_here in blocks:
            block = pieces.subset(columns_here)
            shape = len(nu[rows_here]), len(block)
            sides = np.ones(shape, np.int8) if signs is None else signs(rows_here, columns_here)
            lit = np.nonzero(sides)
            vectors = block.corner, block.first, block.second
            values = np.zeros(shape, np.complex128)
            values[lit] = (
                triangle_transforms(*((nu[rows_here] @ v.T)[lit] for v in vectors)) * sides[lit]
            )
            result[rows_here] += values @ block.vector
    return result


def triangle_transforms(corner: Floats, first: Floats, second: Floats) -> Complex:
    """Return the Fourier transforms of triangles divided by twice their areas, equation (F5).

    The arguments are dot products of the frequency with the first corner and with both sides, in
    cycles. Waves are exp(-2 pi i nu.x).
    """
    real, imag = rotated(_OPS, corner, *simplex_plane_wave(_OPS, first, second))
    return np.asarray(real + 1j * imag)


# Distance that counts as zero, relative to the body size. STL coordinates are rounded to 1e-7.
_NEAR = 1e-6
# Largest number of directions tested for mutual illumination.
_MOST_DIRECTIONS = 256
# Smallest and largest number of rays per direction.
_FEWEST_RAYS, _MOST_RAYS = 16, 128
# Largest product of the total numbers of rays and triangles, which takes a second or two.
_MOST_TESTS = 1 << 21
# Largest product of the numbers of rays and triangles per block.
_BLOCK = 1 << 18
# Steps of quasi-random numbers. Source: M. Roberts, "The unreasonable effectiveness of quasirandom
# sequences" (2018).
_STEPS = 0.7548776662466927, 0.5698402909980532


def warn_of_reflections(facets: Facets, travelling: Floats) -> None:
    """Warn if waves along ``travelling`` (n, 3) are reflected from one face to another."""
    if illuminates_itself(facets, travelling):
        warn_caller(
            "faces of the body illuminate each other, but paths with two or three reflections, "
            "which dominate in corner reflectors, are not included; pass bounces=3 (docs/rcs.md)"
        )


def illuminates_itself(facets: Facets, travelling: Floats) -> bool:
    """Return whether waves along ``travelling`` are reflected from one face to another.

    Tests up to 256 directions with up to 128 rays each.
    """
    if not facets.casts_shadows or not len(travelling):
        return False
    directions = np.unique(travelling, axis=0)
    tests = _MOST_TESTS // len(facets.corner)
    most = min(max(tests // _FEWEST_RAYS, 1), _MOST_DIRECTIONS)
    directions = directions[:: math.ceil(len(directions) / most)]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rays = np.arange(min(max(tests // len(directions), _FEWEST_RAYS), _MOST_RAYS))
    blocks = np.array_split(rays, math.ceil(len(rays) * len(facets.corner) / _BLOCK))
    return any(_reflects_to_another(facets, k, b, len(rays)) for k in directions for b in blocks)


def _reflects_to_another(facets: Facets, k: Floats, rays: Indices, count: int) -> bool:
    """Return whether any of the rays with the indices ``rays`` is reflected to another face.

    There are ``count`` rays along ``k`` in total. Faces that are parallel to within 30 degrees
    reflect waves forwards, and count as one face.
    """
    signs = facing(facets, k)
    if not signs.any():
        return False
    # Half of the rays are distributed by projected area, and half equally among triangles.
    area = np.abs((facets.vector @ k) * signs)
    weights = np.cumsum(area / area.sum() + (signs != 0) / np.count_nonzero(signs))
    facet = np.searchsorted(weights, (rays + 0.5) / count * weights[-1])
    a, b = (np.outer(_STEPS, rays + 0.5) % 1)[..., None]
    # Fold the parallelogram into the triangle.
    a, b = np.where(a + b > 1, [1 - a, 1 - b], [a, b])
    point = facets.corner[facet] + a * facets.first[facet] + b * facets.second[facet]
    lit = _first_met(facets, point, np.broadcast_to(-k, point.shape)) < 0
    facet, point, normal = facet[lit], point[lit], facets.normal[facet[lit]]
    other = _first_met(facets, point, k - 2 * (normal @ k)[:, None] * normal)
    facet, normal, other = (part[other >= 0] for part in (facet, normal, other))
    is_bent = np.abs((normal * facets.normal[other]).sum(axis=1)) < SMOOTH
    return bool((is_bent & (facets.surface[facet] != facets.surface[other])).any())


def _first_met(facets: Facets, start: Floats, along: Floats) -> Indices:
    """Return the index of the first triangle that each ray meets, or -1, shape (n,).

    Rays begin at ``start`` (n, 3) and continue along ``along`` (n, 3).
    """
    # Barycentric coordinates are dot products with dual vectors of the triangle.
    squared = np.square(facets.vector).sum(axis=1, keepdims=True)
    duals = np.cross(facets.second, facets.vector), np.cross(facets.vector, facets.first)
    vectors = facets.normal, *(dual / squared for dual in duals)
    height, u, v = (start @ w.T - (facets.corner * w).sum(axis=1) for w in vectors)
    slope, u_rate, v_rate = (along @ w.T for w in vectors)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = -height / slope
        u, v = u + distance * u_rate, v + distance * v_rate
        met = (distance > _NEAR * facets.size) & (u > 0) & (v > 0) & (u + v < 1)
    distance = np.where(met, distance, np.inf)
    return np.where(met.any(axis=1), distance.argmin(axis=1), -1)
