"""Visible parts of triangles as exact polygons, and their Fourier transforms with normals.

Parts are those seen from far away or from a place. Sums are N(nu) = sum_j n_j F_j(nu).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import execution
from polywigner.execution.progress import told
from polywigner.geometry.hidden_parts import (
    GRID,
    NOTHING,
    Projected,
    Shapes,
    edges_around,
    in_perspective,
    in_triangles,
    intersections,
    less_shadows,
    mended,
)
from polywigner.numerics.divided_differences import simplex_plane_wave
from polywigner.numerics.phases import rotated
from polywigner.scattering.facets import Facets

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Cosine below which a face is seen edge-on and counts as dark.
_EDGE_ON = 1e-12
_TRIANGLE = shapely.Polygon([(0, 0), (1, 0), (0, 1)])


@dataclass(frozen=True)
class Pieces:
    """Triangles (n,), as (n, 3) each."""

    corner: Floats
    first: Floats
    """From the corner to the next one."""
    second: Floats
    """From the corner to the last one."""
    vector: Floats
    """The normal on the lit side, times twice the area."""

    def taken(self, rows: NDArray[np.intp] | slice) -> Pieces:
        return Pieces(self.corner[rows], self.first[rows], self.second[rows], self.vector[rows])

    def __len__(self) -> int:
        return len(self.corner)


@dataclass(frozen=True, eq=False)
class Seen:
    """Visible parts of the triangles (n,) of a body."""

    signs: NDArray[np.int8]
    """(n,) 1 where the outer side is seen, -1 the other side of a plate, 0 for nothing."""
    parts: Shapes
    """(n,) visible part of each triangle, or None: all of it.

    In coordinates along its two vectors, (0, 0), (1, 0) and (0, 1) at its corners.
    """


def facing(facets: Facets, direction: Floats, some: slice = slice(None)) -> NDArray[np.int8]:
    """The sides (..., n) of some triangles that face an observer who looks along (..., 3)."""
    return _sides(direction @ facets.normal[some].T, facets.is_plate[some])


def facing_place(facets: Facets, place: Floats) -> NDArray[np.int8]:
    """The sides (n,) of triangles that face an observer at a place (3,)."""
    away = facets.corner - place
    distance = np.maximum(np.linalg.norm(away, axis=1), np.finfo(float).tiny)
    cosine = (away * facets.normal).sum(axis=1) / distance
    return _sides(cosine, facets.is_plate)


def _sides(cosine: Floats, is_plate: NDArray[np.bool_]) -> NDArray[np.int8]:
    sides = (cosine < -_EDGE_ON).astype(np.int8)
    sides -= ((cosine > _EDGE_ON) & is_plate).astype(np.int8)
    return sides


def axes_across(direction: Floats) -> Floats:
    """Axes (2, 3) of the picture of an observer who looks along a direction (3,)."""
    _, _, axes = np.linalg.svd(direction[None])
    return axes[1:] * np.array([[1.0], [-np.sign(np.linalg.det([*axes[1:], direction]))]])


def seen_along(facets: Facets, direction: Floats) -> Seen:
    """Return the visible parts for an observer far away who looks along a direction (3,)."""
    across = axes_across(direction)

    def projected(corners: Floats) -> Projected:
        depth = corners @ direction
        return Projected(corners @ across.T, depth, facets.size, np.ones_like(depth))

    return _seen(facets, facing(facets, direction), projected)


def seen_from(facets: Facets, place: Floats, frame: Floats) -> Seen:
    """Return the visible parts for an observer at a place (3,) with all triangles in front.

    ``frame``: rows x, y, z of the observer, who looks along z. A projective map makes lines
    through the place parallel, and keeps planes plane.
    """
    distance = float(((facets.corners - place) @ frame[2]).mean())

    def projected(corners: Floats) -> Projected:
        return in_perspective(corners - place, frame, distance, facets.size)

    return _seen(facets, facing_place(facets, place), projected)


def _seen(facets: Facets, signs: NDArray[np.int8], project: Callable[[Floats], Projected]) -> Seen:
    """Visible parts of facing sides, which hide all that those facing away do.

    ``project``: corners (m, 3, 3) in the picture.
    """
    parts: Shapes = np.full(len(signs), None)
    (rows,) = np.nonzero(signs)
    corners = facets.corners[rows]
    turned = signs[rows] < 0
    corners[turned] = corners[turned][:, ::-1]  # counter-clockwise as well
    projected = project(corners)
    wide = projected.has_width  # what has none shadows nothing, and is too thin to be cut
    rows, projected = rows[wide], projected.taken(wide)
    polygons = np.asarray(shapely.polygons(projected.points), dtype=object)
    touched, left = less_shadows(projected, polygons, polygons)
    if not len(touched):
        return Seen(signs, parts)
    areas, least = shapely.area(left), NOTHING * facets.size * shapely.length(polygons[touched])
    signs[rows[touched[areas <= least]]] = 0
    is_cut = (areas > least) & (shapely.area(polygons[touched]) - areas > least)
    owners = rows[touched[is_cut]]
    points, ranges = projected.points[touched[is_cut]], projected.ranges[touched[is_cut]]
    for corners in (points, ranges):
        corners[signs[owners] < 0] = corners[signs[owners] < 0][:, ::-1]
    parts[owners] = in_triangles(left[is_cut], points, ranges)
    return Seen(signs, parts)


def less_hidden(lit: Seen, seen: Seen, faces: NDArray[np.int8]) -> Seen:
    """Lit parts without the parts hidden from an observer, whom sides ``faces`` (n,) face.

    What is turned away from there adds to the field behind the body: nothing stands before that.
    """
    signs, parts = lit.signs.copy(), lit.parts.copy()
    turned = (signs != 0) & (signs == faces)
    signs[turned & (seen.signs == 0)] = 0
    (cut,) = np.nonzero(turned & (seen.signs != 0) & ~shapely.is_missing(seen.parts))
    one = parts[cut]
    one[shapely.is_missing(one)] = _TRIANGLE
    parts[cut] = intersections(mended(one), mended(seen.parts[cut]), GRID)
    return Seen(signs, parts)


def lit_pieces(facets: Facets, seen: Seen) -> Pieces:
    """Visible parts as triangles."""
    (rows,) = np.nonzero(seen.signs)
    return pieces_of(facets, rows, seen.signs[rows], seen.parts[rows])[0]


def pieces_of(
    facets: Facets, numbers: Indices, signs: NDArray[np.int8], parts: Shapes
) -> tuple[Pieces, Indices]:
    """Parts (m,) of some triangles as triangles (n,), and the number (n,) of the part of each.

    Whole ones, and fans of the boundaries of parts.
    """
    (whole,) = np.nonzero(shapely.is_missing(parts))
    (cut,) = np.nonzero(~shapely.is_missing(parts))
    owner, begin, end = edges_around(parts[cut])
    owner = cut[owner]
    first, second = facets.first[numbers[owner]], facets.second[numbers[owner]]
    share = begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0]
    weights = np.concatenate([signs[whole], signs[owner] * share])

    def at(place: Floats) -> Floats:
        return place[:, :1] * first + place[:, 1:] * second

    every = np.concatenate([whole, owner])
    pieces = Pieces(
        facets.corner[numbers[every]],
        np.concatenate([facets.first[numbers[whole]], at(begin)]),
        np.concatenate([facets.second[numbers[whole]], at(end)]),
        facets.vector[numbers[every]] * weights[:, None],
    )
    return pieces, every


# ---- sums ---------------------------------------------------------------------------------------

Signs = Callable[[slice, slice], NDArray[np.int8]]

_OPS = execution.NumpyOperations(double=True)
_TITLE = "radar cross sections"
# Triangles times directions at a time: their arrays, some twenty, stay in the cache.
_BLOCK = 1 << 14


def surface_sums(pieces: Pieces, nu: Floats, signs: Signs | None = None) -> Complex:
    """N(nu) (m, 3) at (m, 3), of triangles (n,) that count with a sign each, 0 where they are dark.

    ``signs``: the signs (i, j) of some nu and some triangles; None: all 1.
    """
    result = np.zeros((len(nu), 3), np.complex128)
    columns = max(1, min(len(pieces), _BLOCK))
    rows = _BLOCK // columns
    of_directions = [slice(k, k + rows) for k in range(0, len(nu), rows)]
    of_triangles = [slice(k, k + columns) for k in range(0, len(pieces), columns)]
    with told(_TITLE, list(product(of_directions, of_triangles))) as blocks:
        for some, part in blocks:
            own = pieces.taken(part)
            shape = len(nu[some]), len(own)
            sides = np.ones(shape, np.int8) if signs is None else signs(some, part)
            lit = np.nonzero(sides)
            turns = [(nu[some] @ v.T)[lit] for v in (own.corner, own.first, own.second)]
            values = np.zeros(shape, np.complex128)
            values[lit] = transforms(*turns) * sides[lit]
            result[some] += values @ own.vector
    return result


def transforms(corner: Floats, first: Floats, second: Floats) -> Complex:
    """F over twice the area of triangles, from nu.p of corner and both vectors. Source: (F5)."""
    real, imag = rotated(_OPS, corner, *simplex_plane_wave(_OPS, first, second))
    return np.asarray(real + 1j * imag)
