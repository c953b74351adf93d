"""Make vertices and edges that differ by rounding agree exactly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from polywigner.geometry.exact import Ring
from polywigner.geometry.rings import Part, rounding_tolerance

__all__ = ["weld"]


def _joined_vertices(points: Ring, reach: float) -> Ring:
    """Replace each point by the first point of the set within reach (itself, mostly)."""
    geometries = shapely.points(points)
    later, earlier = shapely.STRtree(geometries).query(
        geometries, predicate="dwithin", distance=reach
    )
    target = np.arange(len(points))
    np.minimum.at(target, later, earlier)
    return points[target]


def _with_vertices_on_edges(ring: Ring, tree: shapely.STRtree, points: Ring, reach: float) -> Ring:
    """Insert into each edge the points that lie within reach of it."""
    if not len(ring):  # all of it was within reach of one point
        return ring
    following = np.roll(ring, -1, axis=0)
    edges = shapely.linestrings(np.stack([ring, following], axis=1))
    edge, point = tree.query(edges, predicate="dwithin", distance=reach)
    order = np.argsort(edge, kind="stable")
    bounds = np.searchsorted(edge[order], np.arange(len(ring) + 1))
    inserted: list[Ring] = []
    for number, (start, end) in enumerate(zip(ring, following, strict=True)):
        inserted.append(start[None])
        near = points[point[order[bounds[number] : bounds[number + 1]]]]
        near = near[np.any(near != start, axis=1) & np.any(near != end, axis=1)]
        along = (near - start) @ (end - start)
        inside = (along > 0) & (along < (end - start) @ (end - start))
        inserted.append(near[inside][np.argsort(along[inside], kind="stable")])
    return np.concatenate(inserted)


def weld(parts: Sequence[Part]) -> list[Part]:
    """Parts with nearly equal vertices made equal, and vertices put into the edges they touch.

    Nothing moves by more than 64 ulp of the largest coordinate. Afterwards, parts that touch
    along an edge share the very same chain of vertices there.
    """
    rings = [ring for part in parts for ring in part]
    reach = max(rounding_tolerance(ring) for ring in rings)
    sizes = [len(ring) for ring in rings]
    joined = np.split(_joined_vertices(np.concatenate(rings), reach), np.cumsum(sizes)[:-1])
    points = np.unique(np.concatenate(joined), axis=0)
    tree = shapely.STRtree(shapely.points(points))
    kept = [ring[np.any(ring != np.roll(ring, 1, axis=0), axis=1)] for ring in joined]
    welded = iter([_with_vertices_on_edges(ring, tree, points, reach) for ring in kept])
    return [tuple(next(welded) for _ in part) for part in parts]
