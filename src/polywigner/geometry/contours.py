"""Net contours of the surfaces that are visible from a point: the edges of their shadow.

Triangles are clipped to pyramids around the observer and projected. Their visible parts are exact
polygons. Segments that two polygons share cancel, and the other segments bound the shadow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry.hidden_parts import (
    NOTHING,
    Projected,
    edges_around,
    in_perspective,
    less_shadows,
)

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Cosine of the largest half-angle of a cone that is projected onto one plane.
_NARROW = 0.5
# Relative rounding error of a difference of coordinates.
_ULPS = 8.0 * float(np.finfo(float).eps)
# Distance of two coincident contours, as a fraction of the extent of the figure.
_BESIDE = 1e-10
# Distance of two touching surfaces along the line of sight, in the same unit.
_TOUCHING = 1e-6
# Distance of sides of triangles on the border of a figure, as a fraction of its extent.
_BORDER = 1e-11
# Difference of two equal silhouettes, as a fraction of their extent.
_EQUAL = 1e-6
# Axes of the six pyramids, rotated out of the planes in which faces of bodies usually lie.
_CUBE = np.linalg.qr(np.array([[0.83, 0.31, 0.47], [-0.29, 0.91, 0.17], [0.41, -0.23, 0.87]]))[0]


@dataclass(frozen=True)
class Surface:
    """Illuminated triangles, counter-clockwise for the observer."""

    corners: Floats
    """Positions of the corners, shape (t, 3, 3)."""
    sides: Indices
    """Number of the edge from each corner to the next, shape (t, 3); -1 for edges of a cut."""
    faces: Indices
    """Number of the planar face that contains each triangle, shape (t,)."""
    bodies: Indices
    """Number of the body of each triangle, shape (t,)."""

    @classmethod
    def of(cls, parts: Sequence[Surface]) -> Surface:
        """Concatenate surfaces."""
        names = [item.name for item in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def subset(self, rows: NDArray[np.bool_] | Indices) -> Surface:
        """Return a subset of the triangles."""
        return Surface(*(getattr(self, item.name)[rows] for item in fields(self)))


@dataclass(frozen=True)
class Silhouette:
    """Directed edges of shadows, with the body on the left as seen from the source."""

    edges: Floats
    """Begin and end of each edge, shape (m, 2, 3)."""
    numbers: Indices
    """Number of the mesh edge that contains each edge, shape (m,); -1 if none does."""
    bodies: Indices
    """Number of the body of each edge, shape (m,)."""
    behind: Indices
    """Number of the face behind each edge as seen from the source, shape (m,); -1 for none."""
    touching: frozenset[tuple[int, int]] = frozenset()
    """Pairs of bodies that continue each other's surfaces."""
    planes: Floats = field(default_factory=partial(np.empty, (0, 4)))
    """Plane (a, b, c, d) of the face behind each edge, shape (m, 4).

    Points (x, y, z) with a x + b y + c z + d < 0 are behind the plane. Edges without a face behind
    them have (0, 0, 0, 1).
    """
    is_closed: bool = True
    """Whether no edge has been removed or shortened."""

    @classmethod
    def of(cls, parts: Sequence[Silhouette]) -> Silhouette:
        """Concatenate silhouettes, without their planes."""
        names = ("edges", "numbers", "bodies", "behind")
        edges, numbers, bodies, behind = (
            np.concatenate([getattr(part, name) for part in parts]) for name in names
        )
        touching = frozenset[tuple[int, int]]().union(*(part.touching for part in parts))
        return cls(edges, numbers, bodies, behind, touching)

    def is_like(self, other: Silhouette) -> bool:
        """Return whether another silhouette has the same edges, which may be split elsewhere."""
        keys, sums = self._lengths()
        other_keys, other_sums = other._lengths()
        within = _EQUAL * float(np.abs(self.edges).max(initial=0.0))
        return np.array_equal(keys, other_keys) and bool(
            np.allclose(sums, other_sums, 1e-6, within)
        )

    def _lengths(self) -> tuple[Indices, Floats]:
        """Return lengths (k,) and centroids of all edges of one number before one face."""
        keys = np.column_stack([self.numbers, self.bodies, self.behind])
        unique, which = np.unique(keys, axis=0, return_inverse=True)
        length = np.linalg.norm(self.edges[:, 1] - self.edges[:, 0], axis=1)
        moments = length[:, None] * self.edges.mean(axis=1)
        columns = [length, *moments.T]
        sums = np.stack([np.bincount(which.ravel(), column) for column in columns], axis=1)
        return unique, np.column_stack([sums[:, 0], sums[:, 1:] / sums[:, :1]])

    def subset(self, rows: NDArray[np.bool_], edges: Floats) -> Silhouette:
        """Return the masked edges, shortened to ``edges`` (m, 2, 3)."""
        return replace(
            self,
            edges=edges[rows],
            planes=self.planes[rows],
            numbers=self.numbers[rows],
            bodies=self.bodies[rows],
            behind=self.behind[rows],
            is_closed=self.is_closed and np.array_equal(edges, self.edges) and bool(rows.all()),
        )


_NONE = np.empty(0, np.intp)
_NO_EDGES = Silhouette(np.empty((0, 2, 3)), _NONE, _NONE, _NONE)


def net_contours(surface: Surface, observer: Floats, closed: float = 0.0) -> Silhouette:
    """Return the net contours of the visible parts of a surface.

    Parameters
    ----------
    surface : Surface
        The triangles that face the observer.
    observer : ndarray, shape (3,)
        Position of the observer.
    closed : float, default 0.0
        Approximate width up to which slits between bodies have no contours.

    Returns
    -------
    Silhouette
        Directed edges of the shadow.

    Raises
    ------
    ArgumentError
        If too many triangles overlap in projection.
    """
    figures = _figures(surface, observer)
    parts = [
        _contours_in(figure, clipped, closed) for figure, clipped in figures if len(clipped.faces)
    ]
    return Silhouette.of([_NO_EDGES, *parts])


def _figures(surface: Surface, observer: Floats) -> Iterator[tuple[Projected, Surface]]:
    """Project a surface; yield figures with their triangles, except triangles without width."""
    if not len(surface.faces):
        return
    corners = surface.corners - observer
    directions = corners / np.linalg.norm(corners, axis=2, keepdims=True)
    axis = directions.sum(axis=(0, 1))
    axis /= max(float(np.linalg.norm(axis)), 1e-300)
    if (directions @ axis).min() > _NARROW:
        _, _, axes = np.linalg.svd(axis[None])
        x = axes[1]
        yield _projected(surface, observer, np.stack([x, np.cross(axis, x), axis]), False)
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
    """Project a surface along the z axis of a frame; ``border``: whether it has been clipped."""
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
        surface = replace(surface, sides=np.where(on_border.any(axis=2), -2, surface.sides))
    wide = figure.has_width
    return figure.subset(wide), surface.subset(wide)


def _clipped(surface: Surface, observer: Floats, frame: Floats) -> Surface:
    """Clip a surface to the pyramid of 90 degrees around the z axis of a frame."""
    planes = np.array([[1.0, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]) @ frame
    heights: Floats = (surface.corners - observer) @ planes.T
    inside = np.asarray((heights >= 0.0).all(axis=(1, 2)))
    reaches = np.any(heights > 0.0, axis=1)
    crossing = ~inside & np.all(reaches, axis=1)
    corners, sides, owner = [], [], []
    following = int(surface.sides.max(initial=0)) + 1
    for t in np.flatnonzero(crossing):
        ring = [*zip(surface.corners[t], surface.sides[t], strict=True)]
        for plane in planes:
            ring = _cut_ring(ring, plane, observer)
        # the fan of triangles has diagonals that are no edges of the mesh
        for k in range(1, len(ring) - 1):
            three = ring[0], ring[k], ring[k + 1]
            diagonals = following + t * 16 + k
            corners.append([corner for corner, _ in three])
            sides.append(
                [
                    ring[0][1] if k == 1 else diagonals - 1,
                    ring[k][1],
                    ring[k + 1][1] if k == len(ring) - 2 else diagonals,
                ]
            )
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
    """Clip a convex ring of (corner, number of the following side) to the half-space of a plane."""
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
    """Return the net contours in one figure."""
    polygons = np.asarray(shapely.polygons(figure.points), dtype=object)
    hidden, left = less_shadows(figure, polygons, polygons)
    pairing = _Pairing(figure, surface, closed)
    visible = np.ones(len(polygons), bool)
    visible[hidden] = False
    pairing.add_sides(np.flatnonzero(visible))
    pairing.add_parts(hidden, left)
    return pairing.resolved()


class _Pairing:
    """Boundaries of visible parts as segments, from which shared segments are removed."""

    def __init__(self, figure: Projected, surface: Surface, closed: float) -> None:
        self.figure, self.surface = figure, surface
        extent = float(np.ptp(figure.points.reshape(-1, 2), axis=0).max())
        self.within = max(_BESIDE * extent, 16 * NOTHING * figure.size)
        self.beside = max(self.within, closed)
        self.touching = max(_TOUCHING * extent, closed)
        self.begin: list[Floats] = []
        self.end: list[Floats] = []
        self.triangle: list[Indices] = []
        self.side: list[Indices] = []

    def add_sides(self, rows: Indices) -> None:
        """Add all sides of completely visible triangles."""
        points = self.figure.points[rows]
        self._add(
            points.reshape(-1, 2),
            np.roll(points, -1, axis=1).reshape(-1, 2),
            np.repeat(rows, 3),
            np.tile(np.arange(3), len(rows)),
        )

    def add_parts(self, rows: Indices, parts: NDArray[np.object_]) -> None:
        """Add the boundaries of visible parts of triangles."""
        polygons, owner = shapely.get_parts(parts, return_index=True)
        some = shapely.area(polygons) > NOTHING * self.figure.size * shapely.length(polygons)
        number, begin, end = edges_around(polygons[some])
        triangle = rows[owner[some]][number]
        # a segment belongs to the side of its triangle that contains both of its ends
        corners = self.figure.points[triangle]
        along = np.roll(corners, -1, axis=1) - corners
        along /= np.linalg.norm(along, axis=2, keepdims=True)
        off = np.zeros((len(begin), 3))
        for point in (begin, end):
            away = point[:, None] - corners
            height = along[..., 0] * away[..., 1] - along[..., 1] * away[..., 0]
            off = np.maximum(off, np.abs(height))
        best = off.argmin(axis=1)
        near = off[np.arange(len(off)), best] <= self.within
        self._add(begin, end, triangle, np.where(near, best, -1))

    def _add(self, begin: Floats, end: Floats, triangle: Indices, side: Indices) -> None:
        on_border = (side >= 0) & (self.surface.sides[triangle, side] == -2)
        self.begin.append(begin[~on_border])
        self.end.append(end[~on_border])
        self.triangle.append(triangle[~on_border])
        self.side.append(side[~on_border])

    def resolved(self) -> Silhouette:
        """Return the net contours: all segments that no two surfaces share."""
        begin, end = np.concatenate(self.begin), np.concatenate(self.end)
        triangle, side = np.concatenate(self.triangle), np.concatenate(self.side)
        edge = np.where(side >= 0, self.surface.sides[triangle, side], -1)
        left = ~_cancelling(edge, begin, end)
        begin, end = begin[left], end[left]
        triangle, side, edge = triangle[left], side[left], edge[left]
        length = np.linalg.norm(end - begin, axis=1)
        self.segments = begin, end, triangle, side, edge, length
        free: list[list[tuple[float, float]]] = [[(0.0, float(size))] for size in length]
        pieces: list[tuple[int, float, float, int]] = []
        touching = set()
        for one, other in self._candidates(begin, end, edge, length, triangle):
            for low, high, at in _shared(begin, end, length, free, one, other, self.within):
                kind = self._nearer(one, other, 0.5 * (low + high), at)
                if kind > 0:
                    pieces.append((one, low, high, other))
                elif kind < 0:
                    first, last = sorted(_on(begin, end, length, one, other, (low, high)))
                    pieces.append((other, first, last, one))
                elif side[one] >= 0 and side[other] >= 0 and edge[one] != edge[other]:
                    both = self.surface.bodies[triangle[[one, other]]]
                    if both[0] != both[1]:
                        touching.add((int(both.min()), int(both.max())))
        for k, intervals in enumerate(free):
            pieces += [
                (k, low, high, -1)
                for low, high in intervals
                # shorter pieces are the ends of closed slits
                if high - low > self.beside or high - low == length[k]
            ]
        pieces = [piece for piece in pieces if piece[2] - piece[1] > self.within]
        rows = np.array([piece[0] for piece in pieces], np.intp)
        behind = np.array([piece[3] for piece in pieces], np.intp)
        ends = [self._lifted(rows, np.array([piece[k] for piece in pieces])) for k in (1, 2)]
        faces = np.where(behind >= 0, self.surface.faces[triangle[behind]], -1)
        bodies = self.surface.bodies[triangle[rows]]
        return Silhouette(np.stack(ends, axis=1), edge[rows], bodies, faces, frozenset(touching))

    def _candidates(
        self, begin: Floats, end: Floats, edge: Indices, length: Floats, triangle: Indices
    ) -> list[tuple[int, int]]:
        """Return pairs of segments that may run along each other in opposite directions."""
        lines = shapely.linestrings(np.stack([begin, end], axis=1))
        boxes = shapely.box(*(shapely.bounds(lines) + self.beside * np.array([-1, -1, 1, 1])).T)
        one, other = shapely.STRtree(boxes).query(boxes)
        one, other = one[one < other], other[one < other]
        along = (end - begin) / np.maximum(length, 1e-300)[:, None]
        some = np.einsum("nk,nk->n", along[one], along[other]) < -0.5
        one, other = one[some], other[some]
        # segments run along each other if their distance is below a tolerance
        shift = begin[other] - begin[one]
        t0 = np.einsum("nk,nk->n", end[other] - begin[one], along[one])
        t1 = np.einsum("nk,nk->n", shift, along[one])
        low, high = np.maximum(t0, 0.0), np.minimum(t1, length[one])
        off1 = _cross(along[one], shift)
        off0 = _cross(along[one], end[other] - begin[one])
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (off1 - off0) / (t1 - t0)
            ends = (off0 + slope * (low - t0), off0 + slope * (high - t0))
        off = np.abs(ends).max(axis=0)
        some = (high - low > self.within) & (off <= self.beside)
        # slits are between different bodies
        bodies = self.surface.bodies[triangle]
        some &= (off <= self.within) | (bodies[one] != bodies[other])
        one, other, off = one[some], other[some], off[some]
        same = (edge[one] == edge[other]) & (edge[one] >= 0)
        order = np.lexsort([off, ~same])
        return list(zip(one[order].tolist(), other[order].tolist(), strict=True))

    def _nearer(self, one: int, other: int, at: float, at_other: float) -> int:
        """Return 1 if the first segment is in front of the second, -1 if behind, else 0."""
        _, _, triangle, _, edge, _ = self.segments
        if edge[one] >= 0 and edge[one] == edge[other]:
            return 0
        if self.surface.faces[triangle[one]] == self.surface.faces[triangle[other]]:
            return 0
        (here, steep), (there, steep_there) = self._depth(one, at), self._depth(other, at_other)
        gap = there - here
        if abs(gap) <= self.touching + self.within * (steep + steep_there):
            return 0
        return 1 if gap > 0 else -1

    def _depth(self, row: int, at: float) -> tuple[float, float]:
        """Return the depth of a segment, and its slope in the figure if it is not on a side."""
        begin, end, triangle, side, _, length = self.segments
        t, k = triangle[row], side[row]
        point = begin[row] + at / length[row] * (end[row] - begin[row])
        depth, corners = self.figure.depth[t], self.figure.points[t]
        if k >= 0:
            along = corners[(k + 1) % 3] - corners[k]
            share = (point - corners[k]) @ along / (along @ along)
            return float(depth[k] + share * (depth[(k + 1) % 3] - depth[k])), 0.0
        slope = self.figure.subset(np.array([t])).slopes[0]
        return float(depth[0] + (point - corners[0]) @ slope), float(np.abs(slope).sum())

    def _lifted(self, rows: Indices, at: Floats) -> Floats:
        """Return the points (m, 3) in space at lengths along segments."""
        begin, end, triangle, side, _, length = (part[rows] for part in self.segments)
        points = begin + (at / length)[:, None] * (end - begin)
        corners, k = self.figure.points[triangle], np.maximum(side, 0)
        n = np.arange(len(rows))
        first, last = corners[n, k], corners[n, (k + 1) % 3]
        along = last - first
        share = np.einsum("nk,nk->n", points - first, along) / np.einsum("nk,nk->n", along, along)
        share = np.clip(share, 0.0, 1.0)
        ranges, space = self.figure.ranges[triangle], self.surface.corners[triangle]
        near, far = share * ranges[n, k], (1.0 - share) * ranges[n, (k + 1) % 3]
        share = (near / (near + far))[:, None]
        on_side = (1.0 - share) * space[n, k] + share * space[n, (k + 1) % 3]
        # on the edge of a shadow: barycentric coordinates in the triangle
        edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
        inner = np.linalg.solve(edges, (points - corners[:, 0])[..., None])[..., 0]
        shares = np.column_stack([1.0 - inner.sum(axis=1), inner]) / ranges
        shares /= shares.sum(axis=1, keepdims=True)
        return np.where((side >= 0)[:, None], on_side, np.einsum("nc,nck->nk", shares, space))


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _cancelling(edge: Indices, begin: Floats, end: Floats) -> NDArray[np.bool_]:
    """Return a mask (n,) of the segments that are one edge in both directions."""
    order = np.argsort(edge, kind="stable")
    first, second = order[:-1], order[1:]
    same = (edge[first] == edge[second]) & (edge[first] >= 0)
    same &= (begin[first] == end[second]).all(axis=1) & (end[first] == begin[second]).all(axis=1)
    same[1:] &= ~(same[1:] & same[:-1])
    gone = np.zeros(len(edge), bool)
    gone[first[same]] = gone[second[same]] = True
    return gone


def _on(
    begin: Floats, end: Floats, length: Floats, one: int, other: int, at: tuple[float, ...]
) -> list[float]:
    """Convert lengths along one segment to lengths along the other one."""
    unit = (end[one] - begin[one]) / length[one]
    along = (end[other] - begin[other]) / length[other]
    return [
        float(np.clip((begin[one] + t * unit - begin[other]) @ along, 0.0, length[other]))
        for t in at
    ]


def _shared(
    begin: Floats, end: Floats, length: Floats, free: list[list[tuple[float, float]]],
    one: int, other: int, least: float,
) -> Iterator[tuple[float, float, float]]:  # fmt: skip
    """Remove the intervals that two opposite segments share from the free intervals.

    Yields begin and end along the first segment, and the midpoint along the other one.
    """
    for low, high in list(free[one]):
        for start, stop in list(free[other]):
            t1, t0 = _on(begin, end, length, other, one, (start, stop))
            first, last = max(low, t0), min(high, t1)
            if last - first <= least:
                continue
            u1, u0 = _on(begin, end, length, one, other, (first, last))
            free[one] = _without(free[one], first, last)
            free[other] = _without(free[other], u0, u1)
            yield first, last, 0.5 * (u0 + u1)


def _without(
    intervals: list[tuple[float, float]], low: float, high: float
) -> list[tuple[float, float]]:
    """Subtract an interval from intervals."""
    parts = [[(a, min(b, low)), (max(a, high), b)] for a, b in intervals]
    return [(a, b) for pair in parts for a, b in pair if b > a]
