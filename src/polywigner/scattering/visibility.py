"""The parts of triangles that are seen from far away or from a place, as exact polygons."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.scattering.facets import Facets
from polywigner.scattering.overlays import Shapes, differences, intersections, mended, unions
from polywigner.scattering.surface_sums import Pieces

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Lengths that count as none, as a fraction of the size of the whole: a hundred times what rounding
# does to a projection, and still too little to shadow anything.
NOTHING = 1e-12
# Pairs of triangles that overlap as they are seen: half a gigabyte of polygons. Of long ones that
# stand before one, any two may cross: so many take a minute or two.
_MOST_PAIRS, _BLOCK, _MOST_CROSSINGS = 1 << 20, 256, 2e7


@dataclass(frozen=True, eq=False)
class Projected:
    """Triangles (n,) as seen along a direction, counter-clockwise."""

    points: Floats
    """(n, 3, 2) corners across the direction."""
    depth: Floats
    """(n, 3) of the corners along the direction; a smaller depth is nearer to the observer."""
    size: float
    """Size of the whole body."""
    ranges: Floats
    """(n, 3) of the corners from an observer who is near, relative to each other; far away, 1."""

    @cached_property
    def sides(self) -> Floats:
        """(n, 2, 2) from the first corner to the others."""
        return np.asarray(self.points[:, 1:] - self.points[:, :1])

    @cached_property
    def area(self) -> Floats:
        """(n,) twice the area."""
        first, second = self.sides[:, 0], self.sides[:, 1]
        return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])

    @property
    def has_width(self) -> NDArray[np.bool_]:
        """(n,) whether they are more than lines, after rounding."""
        longest = np.linalg.norm(self.sides, axis=2).max(axis=1)
        return np.asarray(self.area > NOTHING * self.size * longest)

    @property
    def slopes(self) -> Floats:
        """Change of depth with the place (n, 2)."""
        rise = self.depth[:, 1:] - self.depth[:, :1]
        across = rise[:, 0] * self.sides[:, 1, 1] - rise[:, 1] * self.sides[:, 0, 1]
        along = rise[:, 1] * self.sides[:, 0, 0] - rise[:, 0] * self.sides[:, 1, 0]
        return np.asarray(np.stack([across, along], axis=1) / self.area[:, None])

    def taken(self, rows: NDArray[np.bool_]) -> Projected:
        return Projected(self.points[rows], self.depth[rows], self.size, self.ranges[rows])


def _too_many(triangles: int) -> ArgumentError:
    return ArgumentError(
        f"expected a body whose triangles hardly overlap as they are seen, got {triangles} of "
        "which too many do; leave out what is hidden, or simplify the mesh"
    )


def _overlapping(seen: Projected, polygons: Shapes) -> tuple[Indices, Indices]:
    """Numbers of both triangles (m,) of pairs that overlap, each once.

    ``polygons``: the triangles or boxes around them; only those whose boxes meet are compared.
    """
    tree, found, total = shapely.STRtree(polygons), [np.empty((2, 0), np.intp)], 0
    for start in range(0, len(polygons), _BLOCK):
        one, other = tree.query(polygons[start : start + _BLOCK])
        once = one + start < other
        one, other = one[once] + start, other[once]
        apart = _apart(seen, one, other) | _apart(seen, other, one)
        found.append(np.stack([one[~apart], other[~apart]]))
        total += found[-1].shape[1]
        if total > _MOST_PAIRS:
            raise _too_many(len(polygons))
    one, other = np.concatenate(found, axis=1)
    return one, other


def _apart(seen: Projected, one: Indices, other: Indices) -> NDArray[np.bool_]:
    """Whether an edge of the one separates both."""
    apart = np.zeros(len(one), np.bool_)
    points, least = seen.points, NOTHING * seen.size
    for k in range(3):
        begin = points[:, k]
        edge = points[:, (k + 1) % 3] - begin
        edge = edge / np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), least)
        beyond = points[other] - begin[one, None]
        inside = edge[one, 0, None] * beyond[..., 1] - edge[one, 1, None] * beyond[..., 0]
        apart |= inside.max(axis=1) <= least
    return apart


def _nearer_parts(
    seen: Projected, hidden: Indices, before: Indices
) -> tuple[Indices, Shapes]:
    """Numbers of hidden triangles, and the parts of others nearer than the planes of these."""
    slopes = seen.slopes
    place = seen.points[before] - seen.points[hidden, :1]
    plane = seen.depth[hidden, :1] + (place * slopes[hidden, None]).sum(axis=2)
    ahead = plane - seen.depth[before]  # how far the corners stand before the hidden plane
    steep = 1 + np.abs(slopes[hidden]).sum(axis=1) + np.abs(slopes[before]).sum(axis=1)
    level = (NOTHING * seen.size * steep)[:, None]
    coincide = (np.abs(ahead) <= level).all(axis=1)
    ahead[coincide] = np.where(before < hidden, 1.0, -1.0)[coincide, None]
    ahead[(np.abs(ahead) <= level) & ~coincide[:, None]] = 0.0
    stands = (ahead > 0).any(axis=1)
    hidden, before, ahead = hidden[stands], before[stands], ahead[stands]
    parts = _cut(seen.points[before], ahead)
    flat = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    return hidden[flat], parts[flat]


def _cut(points: Floats, ahead: Floats) -> Shapes:
    """The parts of triangles (n, 3, 2) where a linear function, given at the corners, is positive.

    It is so at one corner at least (Sutherland and Hodgman 1974). Parts without area may be lines.
    """
    following, there = np.roll(points, -1, axis=1), np.roll(ahead, -1, axis=1)
    crosses = (ahead > 0) != (there > 0)
    share = (ahead / np.where(crosses, ahead - there, 1.0))[..., None]
    between = np.where(share == 1, following, points + share * (following - points))
    candidates = np.stack([points, between], axis=2).reshape(-1, 6, 2)
    kept = np.stack([ahead > 0, crosses], axis=2).reshape(-1, 6)
    owner = np.repeat(np.arange(len(points)), kept.sum(axis=1))
    rings = shapely.linearrings(candidates[kept], indices=owner)
    parts = np.asarray(shapely.polygons(rings), dtype=object)
    bent = ~shapely.is_valid(parts)  # by rounding: they are convex
    parts[bent] = shapely.convex_hull(parts[bent])
    return parts


# Cosine below which a face is seen edge-on and counts as dark.
_EDGE_ON = 1e-12
_TRIANGLE = shapely.Polygon([(0, 0), (1, 0), (0, 1)])


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
        x, y, z = np.moveaxis((corners - place) @ frame.T, -1, 0)
        scale = distance / z
        points = np.stack([x * scale, -y * scale], axis=-1)
        return Projected(points, distance * (1 - scale), facets.size, z / distance)

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


def less_shadows(
    seen: Projected,
    polygons: Shapes,
    lit: Shapes,
    boxes: Shapes | None = None,
    grid: float | None = None,
) -> tuple[Indices, Shapes]:
    """Return numbers of triangles behind others (m,), and their lit parts less the shadows.

    ``polygons``: the triangles as such; ``lit``: the part of each triangle; ``boxes``: around the
    triangles, those of several pictures apart; None: of one picture; ``grid``: of corners, where
    edges of lit parts may be those of shadows but for rounding.
    Of two triangles that coincide the first one hides the other.

    Raises ArgumentError for more pairs that overlap than fit in memory.
    """
    one, other = _overlapping(seen, polygons if boxes is None else boxes)
    hidden, before = np.concatenate([one, other]), np.concatenate([other, one])
    if float((np.bincount(hidden).astype(np.float64) ** 2).sum()) > _MOST_CROSSINGS:
        raise _too_many(len(polygons))
    hidden, shadows = _nearer_parts(seen, hidden, before)
    if not len(hidden):
        return hidden, shadows
    order = np.argsort(hidden, kind="stable")
    touched, numbers = np.unique(hidden[order], return_inverse=True)
    shadows = unions(shadows[order], numbers, max(seen.size, float(abs(seen.points).max())))
    return touched, differences(lit[touched], shadows, grid)


def in_triangles(shapes: Shapes, points: Floats, ranges: Floats) -> Shapes:
    """Shapes (m,) of the picture in coordinates of triangles (m, 3, 2), as :class:`Projected`."""
    inverse = np.linalg.inv(np.stack([points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]], 2))
    places, owner = shapely.get_coordinates(shapes, return_index=True)
    inside = np.einsum("nij,nj->ni", inverse[owner], places - points[owner, 0])
    shares = np.column_stack([1 - inside.sum(axis=1), inside]) / ranges[owner]
    inside = shares[:, 1:] / shares.sum(axis=1, keepdims=True)
    return np.asarray(shapely.set_coordinates(shapes.copy(), inside), dtype=object)


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
    parts[cut] = intersections(mended(one), mended(seen.parts[cut]))
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
    owner, begin, end = _edges(parts[cut])
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


def _edges(shapes: Shapes) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Numbers of shapes, and begins and ends (m, 2) of the edges around their polygons.

    Counter-clockwise, holes clockwise.
    """
    single, owner = shapely.get_parts(shapes, return_index=True)
    single, inner = shapely.get_parts(single, return_index=True)  # polygons in collections
    flat = shapely.get_type_id(single) == shapely.GeometryType.POLYGON
    polygons, owner = single[flat], owner[inner][flat]
    rings, of_polygon = shapely.get_rings(polygons, return_index=True)
    is_hole = of_polygon == np.concatenate([[-1], of_polygon[:-1]])
    points, of_ring = shapely.get_coordinates(rings, return_index=True)
    within = of_ring[1:] == of_ring[:-1]
    of_edge, begin, end = of_ring[1:][within], points[:-1][within], points[1:][within]
    # By area: shapely looks at one corner, which after rounding may be that of a spike.
    crosses = begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0]
    turned = (np.bincount(of_edge, crosses, len(rings)) < 0) != is_hole
    swapped = turned[of_edge][:, None]
    begin, end = np.where(swapped, end, begin), np.where(swapped, begin, end)
    return owner[of_polygon[of_edge]], begin, end
