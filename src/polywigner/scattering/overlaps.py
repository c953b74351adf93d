"""Which triangles stand before which in a picture: candidates in bulk, no set operations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["Projected", "occluders"]

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Lengths that count as none, as a fraction of the size of the whole: a hundred times what rounding
# does to a projection, and still too little to shadow anything.
NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class Projected:
    """Triangles (n,) as seen along a direction, counter-clockwise."""

    points: Floats
    """(n, 3, 2) corners across the direction."""
    depth: Floats
    """(n, 3) of the corners along the direction; what has less is nearer to the observer."""
    size: float
    """Of the whole body."""
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


def occluders(
    seen: Projected, polygons: NDArray[np.object_]
) -> tuple[Indices, NDArray[np.object_]]:
    """Numbers of hidden triangles (m,), and polygons (m,) that stand before each of them.

    A polygon is the part of a triangle that is nearer than the plane of the hidden one.
    ``polygons``: the triangles as such. Where two coincide, the first one hides the other.
    """
    tree = shapely.STRtree(polygons)
    one, other = tree.query(polygons)
    once = one < other
    one, other = one[once], other[once]
    apart = _apart(seen, one, other) | _apart(seen, other, one)
    one, other = one[~apart], other[~apart]
    hidden, before = np.concatenate([one, other]), np.concatenate([other, one])
    return _nearer_parts(seen, hidden, before)


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
) -> tuple[Indices, NDArray[np.object_]]:
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


def _cut(points: Floats, ahead: Floats) -> NDArray[np.object_]:
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
