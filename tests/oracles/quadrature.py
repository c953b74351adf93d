"""Gauss-Legendre nodes on triangles, with spectral convergence for smooth functions."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import shapely


def triangle_nodes(triangles: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes (n, 2) and weights (n,) on triangles (m, 3, 2), by collapsed squares."""
    node, weight = np.polynomial.legendre.leggauss(order)
    node, weight = (node + 1) / 2, weight / 2
    s, t = (grid.ravel() for grid in np.meshgrid(node, node))
    unit = (weight[:, None] * weight).ravel() * s.reshape(order, order).ravel()
    a, b, c = (triangles[:, k, None, :] for k in range(3))
    points = a + s[:, None] * (b - a) + (s * t)[:, None] * (c - b)
    e, f = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 1]
    area = np.abs(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0])
    return points.reshape(-1, 2), (area[:, None] * unit).ravel()


def triangles_of(polygons: Any) -> np.ndarray:
    """Return triangles (n, 3, 2) that cover polygons once."""
    pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(polygons))
    return shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]


def graded(triangles: np.ndarray, near: Any, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Halve triangles until all are small; return triangles (n, 3, 3) and the index of each
    original.

    Small: no corner is more than ``longest`` from the centroid, nor more than 0.6 of the distance
    between the centroid and any of the points ``near`` (m, 3).
    """
    done, origins = [triangles[:0]], [np.arange(0)]
    todo, origin = triangles, np.arange(len(triangles))
    while len(todo):
        centroid = todo.mean(axis=1)
        reach = np.linalg.norm(todo - centroid[:, None], axis=2).max(axis=1)
        limit = np.full(len(todo), longest)
        for point in np.reshape(near, (-1, 3)):
            limit = np.minimum(limit, 0.6 * np.linalg.norm(centroid - point, axis=1))
        small = reach <= limit
        done.append(todo[small])
        origins.append(origin[small])
        a, b, c = np.moveaxis(todo[~small], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        four = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        todo = np.concatenate([np.stack(three, axis=1) for three in four])
        origin = np.tile(origin[~small], 4)
    return np.concatenate(done), np.concatenate(origins)


def graded_in_plane(outline: Any, near: Any, longest: float) -> np.ndarray:
    """Return triangles (n, 3, 2) of an aperture in the plane z = 0, graded towards points."""
    flat = triangles_of(outline.polygons)
    corners = np.concatenate([flat, np.zeros((len(flat), 3, 1))], axis=2)
    return graded(corners, near, longest)[0][..., :2]


def nodes_on(source: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 2) on a plane source, and its field there times the area per point."""
    parts = []
    for element, weight in zip(
        source.elements_in_plane, getattr(source, "weights", [1.0]), strict=True
    ):
        fans = [(p[0], b, c) for p in element.convex_cover for b, c in pairwise(p[1:])]
        points, areas = triangle_nodes(np.array(fans), count)
        field = 1.0 if element.illumination is None else element.illumination(points)
        parts.append((points, weight * areas * field))
    return np.concatenate([x for x, _ in parts]), np.concatenate([u for _, u in parts])
