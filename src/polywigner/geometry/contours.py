"""Net contours of the surfaces that are visible from a point: the edges of their shadow.

Triangles are clipped to pyramids around the observer and projected. Sides shared by
two visible parts cancel, and the remaining sides bound the shadow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry.hidden_parts import (
    NOTHING,
    Projected,
    barycentric,
    edges_around,
    in_perspective,
    visible_parts,
)
from polywigner.geometry.polyhedron import axes_across
from polywigner.numerics import Columns, Floats, Indices

# Cosine of the largest half-angle of a cone that is projected onto one plane instead of six.
_NARROW = 0.5
# Relative rounding error of a difference of coordinates.
_ULPS = 8.0 * float(np.finfo(float).eps)
# Largest distance between contours that count as coincident, as a fraction of the extent of the
# projection.
_COINCIDENT = 1e-10
# Largest gap along the line of sight between surfaces that count as touching, as a fraction of the
# extent of the projection.
_TOUCHING = 1e-6
# Largest distance from the border of a projection at which a triangle side counts as lying on the
# border, as a fraction of half the width.
_BORDER = 1e-11
# Edge index that marks triangle sides on the border of a projection.
_BORDER_SIDE = -2
# Largest difference between silhouettes that count as equal, as a fraction of their extent.
_EQUAL = 1e-6
# Axes of the six pyramids, rotated away from the planes in which faces usually lie.
_CUBE = np.linalg.qr(np.array([[0.83, 0.31, 0.47], [-0.29, 0.91, 0.17], [0.41, -0.23, 0.87]]))[0]


@dataclass(frozen=True)
class Surface(Columns):
    """Illuminated triangles, whose corners are counter-clockwise as seen by the observer."""

    corners: Floats
    """Positions of the corners, shape (t, 3, 3)."""
    sides: Indices
    """Index of the edge from each corner to the next corner, shape (t, 3); -1 for edges created by
    clipping."""
    faces: Indices
    """Index of the planar face that contains each triangle, shape (t,)."""
    bodies: Indices
    """Index of the body to which each triangle belongs, shape (t,)."""


@dataclass(frozen=True)
class Silhouette:
    """Directed shadow edges, with the body on their left as seen from the source."""

    edges: Floats
    """Start and end of each edge, shape (m, 2, 3)."""
    numbers: Indices
    """Index of the mesh edge on which each edge lies, shape (m,); -1 if there is none."""
    bodies: Indices
    """Index of the body to which each edge belongs, shape (m,)."""
    behind: Indices
    """Index of the face behind each edge as seen from the source, or -1, shape (m,)."""
    touching: frozenset[tuple[int, int]] = frozenset()
    """Pairs of bodies whose surfaces touch."""
    planes: Floats = field(default_factory=partial(np.empty, (0, 4)))
    """Plane (a, b, c, d) of the face behind each edge, shape (m, 4).

    Points (x, y, z) with a x + b y + c z + d < 0 are behind the plane. Edges without a face behind
    them have (0, 0, 0, 1).
    """
    is_closed: bool = True
    """Whether the silhouette is complete: no edge has been removed or shortened."""

    @classmethod
    def of(cls, parts: Sequence[Silhouette]) -> Silhouette:
        """Concatenate silhouettes, without their planes; the result is marked as complete."""
        names = ("edges", "numbers", "bodies", "behind")
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in names
        }
        return cls(**columns, touching=frozenset().union(*(part.touching for part in parts)))

    def is_like(self, other: Silhouette) -> bool:
        """Return whether two silhouettes have the same edges, which may be divided differently."""
        keys, sums = self._lengths()
        other_keys, other_sums = other._lengths()
        within = _EQUAL * float(np.abs(self.edges).max(initial=0.0))
        return np.array_equal(keys, other_keys) and bool(
            np.allclose(sums, other_sums, 1e-6, within)
        )

    def _lengths(self) -> tuple[Indices, Floats]:
        """Return edge keys (k, 3), and for each key the total length and the centroid (k, 4).

        A key consists of the edge number, the body and the face behind the edge.
        """
        keys = np.column_stack([self.numbers, self.bodies, self.behind])
        unique, which = np.unique(keys, axis=0, return_inverse=True)
        length = np.linalg.norm(self.edges[:, 1] - self.edges[:, 0], axis=1)
        moments = length[:, None] * self.edges.mean(axis=1)
        columns = [length, *moments.T]
        sums = np.stack([np.bincount(which.ravel(), column) for column in columns], axis=1)
        return unique, np.column_stack([sums[:, 0], sums[:, 1:] / sums[:, :1]])

    def subset(self, rows: NDArray[np.bool_], edges: Floats) -> Silhouette:
        """Return the edges selected by a mask (m,), shortened to their rows of ``edges`` (m, 2, 3).

        ``edges`` has a row for each edge of this silhouette, selected or not. The result is marked
        as complete only if no edge is removed or shortened.
        """
        is_closed = self.is_closed and np.array_equal(edges, self.edges) and bool(rows.all())
        names = ("numbers", "bodies", "behind", "planes")
        columns = {name: getattr(self, name)[rows] for name in names}
        return replace(self, edges=edges[rows], is_closed=is_closed, **columns)


_NONE = np.empty(0, np.intp)
_NO_EDGES = Silhouette(np.empty((0, 2, 3)), _NONE, _NONE, _NONE)


def net_contours(surface: Surface, observer: Floats, closed: float = 0.0) -> Silhouette:
    """Return the net contours of the visible parts of a surface.

    If two visible parts share a side, the side is not a contour. ``surface``: the triangles that
    face the observer. ``observer``: position (3,) of the observer. ``closed``: approximate width,
    in the unit of the positions, up to which slits between bodies have no contours. Raises
    ArgumentError if too many triangles overlap in projection.
    """
    figures = _projections(surface, observer)
    parts = [
        _contours_in(figure, clipped, closed) for figure, clipped in figures if len(clipped.faces)
    ]
    return Silhouette.of([_NO_EDGES, *parts])


def _projections(surface: Surface, observer: Floats) -> Iterator[tuple[Projected, Surface]]:
    """Yield projections of a surface onto one plane, or onto the six faces of a cube.

    Each projection is a pair of the projected triangles and the same triangles in space, clipped to
    the part of the surface that is in this projection.
    """
    if not len(surface.faces):
        return
    corners = surface.corners - observer
    directions = corners / np.linalg.norm(corners, axis=2, keepdims=True)
    axis = directions.sum(axis=(0, 1))
    axis /= max(float(np.linalg.norm(axis)), 1e-300)
    if (directions @ axis).min() > _NARROW:
        yield _projected(surface, observer, np.stack([*axes_across(-axis), axis]), False)
        return
    for k in range(3):
        for sign in (1.0, -1.0):
            x, y, z = (_CUBE[(k + j) % 3] for j in (1, 2, 0))
            frame = np.stack([x, sign * y, sign * z])
            clipped = _clipped(surface, observer, frame)
            if len(clipped.faces):
                yield _projected(clipped, observer, frame, True)


def _projected(
    surface: Surface, observer: Floats, frame: Floats, border: bool
) -> tuple[Projected, Surface]:
    """Project a surface along the z axis of a frame; drop triangles of zero width.

    ``frame``: x, y and z axes as rows. ``border``: whether sides on the border of the 90-degree
    pyramid around the z axis are marked, so that they do not become contours.
    """
    corners = surface.corners - observer
    distance = float(np.exp(np.log(corners @ frame[2]).mean()))
    figure = in_perspective(corners, frame, distance, 1.0)
    largest = max(float(np.abs(part).max()) for part in (surface.corners, observer, corners))
    extent = float(np.ptp(figure.points.reshape(-1, 2), axis=0).max())
    size = max(extent, _ULPS * largest / NOTHING)
    figure = replace(figure, size=size)
    if border:
        on_border = np.abs(np.abs(figure.points) - distance) <= _BORDER * distance
        on_border &= np.roll(on_border, -1, axis=1)
        surface = replace(
            surface, sides=np.where(on_border.any(axis=2), _BORDER_SIDE, surface.sides)
        )
    wide = figure.has_width
    return figure.subset(wide), surface.subset(wide)


def _clipped(surface: Surface, observer: Floats, frame: Floats) -> Surface:
    """Clip a surface to the pyramid |x| <= z and |y| <= z in a frame at the observer.

    ``frame``: x, y and z axes as rows. Clipped triangles are divided into triangles; new sides have
    the index -1.
    """
    planes = np.array([[1.0, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]) @ frame
    heights: Floats = (surface.corners - observer) @ planes.T
    inside = np.asarray((heights >= 0.0).all(axis=(1, 2)))
    reaches = np.any(heights > 0.0, axis=1)
    crossing = ~inside & np.all(reaches, axis=1)
    corners, sides, owner = [], [], []
    for t in np.flatnonzero(crossing):
        ring = [*zip(surface.corners[t], surface.sides[t], strict=True)]
        for plane in planes:
            ring = _cut_ring(ring, plane, observer)
        last = len(ring) - 2
        for k in range(1, last + 1):
            first = ring[0][1] if k == 1 else -1
            sides.append([first, ring[k][1], ring[k + 1][1] if k == last else -1])
            corners.append([ring[0][0], ring[k][0], ring[k + 1][0]])
            owner.append(t)
    complete = surface.subset(inside)
    if not owner:
        return complete
    cut = surface.subset(np.array(owner))
    cut = replace(cut, corners=np.array(corners), sides=np.array(sides, np.intp))
    return Surface.of([complete, cut])


def _cut_ring(
    ring: list[tuple[Floats, int]], plane: Floats, observer: Floats
) -> list[tuple[Floats, int]]:
    """Clip a convex ring to the positive side of a plane through the observer.

    The ring consists of pairs (corner, index of the next side); a side on the plane has the index
    -1. ``plane``: normal (3,).
    """
    result: list[tuple[Floats, int]] = []
    for (corner, side), (end, _) in zip(ring, [*ring[1:], *ring[:1]], strict=True):
        here, there = plane @ (corner - observer), plane @ (end - observer)
        if here >= 0.0:
            result.append((corner, side))
        if (here >= 0.0) != (there >= 0.0):
            between = corner + here / (here - there) * (end - corner)
            result.append((between, side if here < 0.0 else -1))
    return result


def _contours_in(figure: Projected, surface: Surface, closed: float) -> Silhouette:
    """Return the net contours in one projection of a surface.

    ``closed``: approximate width up to which slits between bodies have no contours.
    """
    polygons = np.asarray(shapely.polygons(figure.points), dtype=object)
    hidden, left = visible_parts(figure, polygons, polygons)
    visible = np.setdiff1d(np.arange(len(polygons)), hidden)
    extent = float(np.ptp(figure.points.reshape(-1, 2), axis=0).max())
    within = max(_COINCIDENT * extent, 16 * NOTHING * figure.size)
    boundaries = [
        _triangle_sides(figure, surface, visible),
        _part_boundaries(figure, surface, hidden, left, within),
    ]
    segments = _Segments.of([part.subset(part.edge != _BORDER_SIDE) for part in boundaries])
    segments = segments.subset(~_occur_in_both_directions(segments))
    beside, touching = max(within, closed), max(_TOUCHING * extent, closed)
    return _Pairing(figure, surface, segments, within, beside, touching).silhouette()


@dataclass(frozen=True)
class _Segments(Columns):
    """Directed segments in a projection plane that bound the visible parts of triangles."""

    begin: Floats
    """Start points of the segments, shape (n, 2)."""
    end: Floats
    """End points of the segments, shape (n, 2)."""
    triangle: Indices
    """Index of the triangle that contains each segment, shape (n,)."""
    side: Indices
    """Index of the triangle's side on which the segment lies, or -1, shape (n,)."""
    edge: Indices
    """Index of the mesh edge on which the segment lies, or -1, shape (n,)."""

    @cached_property
    def length(self) -> Floats:
        """Length of each segment, shape (n,)."""
        return np.asarray(np.linalg.norm(self.end - self.begin, axis=1))

    @cached_property
    def unit(self) -> Floats:
        """Unit vector along each segment, shape (n, 2)."""
        return np.asarray((self.end - self.begin) / np.maximum(self.length, 1e-300)[:, None])


def _triangle_sides(figure: Projected, surface: Surface, rows: Indices) -> _Segments:
    """Return the sides of entirely visible triangles as segments.

    ``rows``: indices (m,) of the triangles.
    """
    points = figure.points[rows]
    return _Segments(
        points.reshape(-1, 2),
        np.roll(points, -1, axis=1).reshape(-1, 2),
        np.repeat(rows, 3),
        np.tile(np.arange(3), len(rows)),
        surface.sides[rows].ravel(),
    )


def _part_boundaries(
    figure: Projected, surface: Surface, rows: Indices, parts: NDArray[np.object_], within: float
) -> _Segments:
    """Return the boundaries of the visible parts of partly hidden triangles as segments.

    ``rows``: indices (m,) of the triangles. ``parts`` (m,): visible part of each triangle.
    ``within``: largest distance at which a segment counts as lying on a side of its triangle.
    """
    polygons, owner = shapely.get_parts(parts, return_index=True)
    has_width = shapely.area(polygons) > NOTHING * figure.size * shapely.length(polygons)
    number, begin, end = edges_around(polygons[has_width])
    triangle = rows[owner[has_width]][number]
    corners = figure.points[triangle]
    along = np.roll(corners, -1, axis=1) - corners
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    distances = [np.abs(_cross_products(along, point[:, None] - corners)) for point in (begin, end)]
    off = np.maximum(*distances)
    nearest = off.argmin(axis=1)
    side = np.where(off[np.arange(len(off)), nearest] <= within, nearest, -1)
    edge = np.where(side >= 0, surface.sides[triangle, side], -1)
    return _Segments(begin, end, triangle, side, edge)


@dataclass
class _Pairing:
    """Segments of a projection, paired along the intervals that two segments have in common."""

    figure: Projected
    surface: Surface
    segments: _Segments
    within: float
    """Largest distance between points that count as coincident."""
    beside: float
    """Largest distance between segments that count as running along each other."""
    touching: float
    """Largest gap along the line of sight between surfaces that count as touching."""

    def __post_init__(self) -> None:
        """Initialise, for each segment, the intervals that it shares with no other segment."""
        # Intervals of each segment that no other segment shares.
        self.free = [[(0.0, float(length))] for length in self.segments.length]

    def silhouette(self) -> Silhouette:
        """Return the segments without a partner, and the nearer segments of all pairs.

        Pairs of segments at equal depth cancel, because the surfaces on both sides of them join.
        Call this method only once, because it removes the paired intervals from ``free``.
        """
        s, bodies = self.segments, self.surface.bodies
        # Each piece consists of a segment, the start and end of an interval on this segment, and
        # the segment behind the interval (or -1).
        pieces: list[tuple[int, float, float, int]] = []
        touching = set()
        for j, k in self._candidates():
            for low, high, at in self._shared_intervals(j, k):
                order = self._depth_order(j, k, 0.5 * (low + high), at)
                if order > 0:
                    pieces.append((j, low, high, k))
                elif order < 0:
                    first, last = sorted(self._projected_lengths(j, k, low, high))
                    pieces.append((k, first, last, j))
                elif s.side[j] >= 0 and s.side[k] >= 0 and s.edge[j] != s.edge[k]:
                    pair = bodies[s.triangle[[j, k]]]
                    if pair[0] != pair[1]:
                        touching.add((int(pair.min()), int(pair.max())))
        for k, intervals in enumerate(self.free):
            pieces += [
                (k, low, high, -1)
                for low, high in intervals
                # Shorter pieces are dropped, because they are the ends of closed slits.
                if high - low > self.beside or high - low == s.length[k]
            ]
        pieces = [piece for piece in pieces if piece[2] - piece[1] > self.within]
        rows, behind = (np.array([piece[k] for piece in pieces], np.intp) for k in (0, 3))
        ends = [self._in_space(rows, np.array([piece[k] for piece in pieces])) for k in (1, 2)]
        faces = np.where(behind >= 0, self.surface.faces[s.triangle[behind]], -1)
        edges = np.stack(ends, axis=1)
        return Silhouette(edges, s.edge[rows], bodies[s.triangle[rows]], faces, frozenset(touching))

    def _candidates(self) -> list[tuple[int, int]]:
        """Return pairs of segments that may run along each other in opposite directions.

        Each pair occurs once. Pairs on one mesh edge come first, then the nearest pairs.
        """
        s = self.segments
        lines = shapely.linestrings(np.stack([s.begin, s.end], axis=1))
        boxes = shapely.box(*(shapely.bounds(lines) + self.beside * np.array([-1, -1, 1, 1])).T)
        j, k = shapely.STRtree(boxes).query(boxes)
        is_opposite = (j < k) & (np.einsum("nk,nk->n", s.unit[j], s.unit[k]) < -0.5)
        j, k = j[is_opposite], k[is_opposite]
        unit, to_end, to_begin = s.unit[j], s.end[k] - s.begin[j], s.begin[k] - s.begin[j]
        t0, t1 = (np.einsum("nk,nk->n", point, unit) for point in (to_end, to_begin))
        off0, off1 = (_cross_products(unit, point) for point in (to_end, to_begin))
        low, high = np.maximum(t0, 0.0), np.minimum(t1, s.length[j])
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (off1 - off0) / (t1 - t0)
            off = np.abs([off0 + slope * (t - t0) for t in (low, high)]).max(axis=0)
        is_near = (high - low > self.within) & (off <= self.beside)
        # Only slits between different bodies are closed.
        bodies = self.surface.bodies[s.triangle]
        is_near &= (off <= self.within) | (bodies[j] != bodies[k])
        j, k, off = j[is_near], k[is_near], off[is_near]
        is_one_edge = (s.edge[j] == s.edge[k]) & (s.edge[j] >= 0)
        order = np.lexsort([off, ~is_one_edge])
        return list(zip(j[order].tolist(), k[order].tolist(), strict=True))

    def _projected_lengths(self, j: int, k: int, *lengths: float) -> list[float]:
        """Return the points on segments k that are nearest to points on segments j.

        The points are lengths from the starts of the segments.
        """
        s = self.segments
        points = (s.begin[j] + t * s.unit[j] for t in lengths)
        return [float(np.clip((p - s.begin[k]) @ s.unit[k], 0.0, s.length[k])) for p in points]

    def _shared_intervals(self, j: int, k: int) -> Iterator[tuple[float, float, float]]:
        """Yield the intervals that two opposite segments share, and remove them from ``free``.

        Yields the start and end of each interval along segment j, and its midpoint along segment k.
        """
        for low, high in list(self.free[j]):
            for start, stop in list(self.free[k]):
                t1, t0 = self._projected_lengths(k, j, start, stop)
                first, last = max(low, t0), min(high, t1)
                if last - first <= self.within:
                    continue
                u1, u0 = self._projected_lengths(j, k, first, last)
                self.free[j] = _without_interval(self.free[j], first, last)
                self.free[k] = _without_interval(self.free[k], u0, u1)
                yield first, last, 0.5 * (u0 + u1)

    def _depth_order(self, j: int, k: int, at_j: float, at_k: float) -> int:
        """Return 1 if segment j is in front of segment k, -1 if it is behind, and 0 otherwise.

        ``at_j`` and ``at_k``: position of the same point, as the length from the start of each
        segment.
        """
        s, faces = self.segments, self.surface.faces
        is_one_edge = s.edge[j] >= 0 and s.edge[j] == s.edge[k]
        if is_one_edge or faces[s.triangle[j]] == faces[s.triangle[k]]:
            return 0
        (depth_j, slope_j), (depth_k, slope_k) = self._depth(j, at_j), self._depth(k, at_k)
        gap = depth_k - depth_j
        if abs(gap) <= self.touching + self.within * (slope_j + slope_k):
            return 0
        return 1 if gap > 0 else -1

    def _depth(self, row: int, at: float) -> tuple[float, float]:
        """Return the depth of a point on a segment, and the slope of the depth.

        The depth grows with the distance from the observer. ``at``: length from the start of
        segment ``row``. The slope is |d/dx| + |d/dy| of the depth; it is 0 on a side of a triangle,
        where the depth is interpolated along the side.
        """
        s = self.segments
        t, k = s.triangle[row], s.side[row]
        point = s.begin[row] + at * s.unit[row]
        depth, corners = self.figure.depth[t], self.figure.points[t]
        if k >= 0:
            along = corners[(k + 1) % 3] - corners[k]
            fraction = (point - corners[k]) @ along / (along @ along)
            return float(depth[k] + fraction * (depth[(k + 1) % 3] - depth[k])), 0.0
        slope = self.figure.subset(np.array([t])).slopes[0]
        return float(depth[0] + (point - corners[0]) @ slope), float(np.abs(slope).sum())

    def _in_space(self, rows: Indices, at: Floats) -> Floats:
        """Return positions (m, 3) in space of points on segments.

        ``rows``: indices (m,) of the segments. ``at`` (m,): lengths from their starts.
        """
        s = self.segments.subset(rows)
        points = s.begin + at[:, None] * s.unit
        corners, k = self.figure.points[s.triangle], np.maximum(s.side, 0)
        n = np.arange(len(rows))
        first, last = corners[n, k], corners[n, (k + 1) % 3]
        along = last - first
        fraction = np.einsum("nk,nk->n", points - first, along) / np.einsum(
            "nk,nk->n", along, along
        )
        fraction = np.clip(fraction, 0.0, 1.0)
        ranges, space = self.figure.ranges[s.triangle], self.surface.corners[s.triangle]
        near, far = fraction * ranges[n, k], (1.0 - fraction) * ranges[n, (k + 1) % 3]
        fraction = (near / (near + far))[:, None]
        on_side = (1.0 - fraction) * space[n, k] + fraction * space[n, (k + 1) % 3]
        # Points inside a triangle are interpolated with barycentric coordinates.
        inside = np.einsum("nc,nck->nk", barycentric(corners, ranges, n, points), space)
        return np.where((s.side >= 0)[:, None], on_side, inside)


def _cross_products(a: Floats, b: Floats) -> Floats:
    """Return the cross products a_x b_y - a_y b_x of vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _occur_in_both_directions(segments: _Segments) -> NDArray[np.bool_]:
    """Return a mask (n,) of the segments whose reversed copies are also present.

    Only segments on the same mesh edge, with exactly equal ends, count as copies.
    """
    edge, begin, end = segments.edge, segments.begin, segments.end
    order = np.argsort(edge, kind="stable")
    first, second = order[:-1], order[1:]
    same = (edge[first] == edge[second]) & (edge[first] >= 0)
    same &= (begin[first] == end[second]).all(axis=1) & (end[first] == begin[second]).all(axis=1)
    same[1:] &= ~(same[1:] & same[:-1])
    mask = np.zeros(len(edge), bool)
    mask[first[same]] = mask[second[same]] = True
    return mask


def _without_interval(
    intervals: list[tuple[float, float]], low: float, high: float
) -> list[tuple[float, float]]:
    """Return intervals without their overlaps with the interval from ``low`` to ``high``."""
    parts = [[(a, min(b, low)), (max(a, high), b)] for a, b in intervals]
    return [(a, b) for pair in parts for a, b in pair if b > a]
