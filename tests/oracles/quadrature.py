"""Quadrature that converges spectrally for functions with kinks along known segments.

W is analytic in x between the segments that vertices and edges span midway, A in xi between those
that they span by difference. Gauss-Legendre nodes on the triangulated cells see no kink.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

__all__ = ["lag_nodes", "position_nodes", "triangle_nodes"]

SMALLEST_CELL = 1e-13  # of the whole: slivers left by rounding the crossings


def triangle_nodes(triangles: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 2) and weights (n,) on triangles (m, 3, 2), by collapsing the square."""
    node, weight = np.polynomial.legendre.leggauss(order)
    node, weight = (node + 1) / 2, weight / 2
    s, t = (grid.ravel() for grid in np.meshgrid(node, node))
    unit = (weight[:, None] * weight).ravel() * s.reshape(order, order).ravel()
    a, b, c = (triangles[:, k, None, :] for k in range(3))
    points = a + s[:, None] * (b - a) + (s * t)[:, None] * (c - b)
    e, f = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 1]
    area = np.abs(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0])
    return points.reshape(-1, 2), (area[:, None] * unit).ravel()


def _nodes(segments: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    length = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    lines = shapely.linestrings(segments[length > 0])
    cells = shapely.get_parts(shapely.polygonize(shapely.get_parts(shapely.union_all(lines))))
    area = shapely.area(cells)
    cells = cells[area > SMALLEST_CELL * area.sum()]
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(cells))
    triangles = shapely.get_parts(triangles)
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    return triangle_nodes(corners, order)


def _vertices_and_edges(rings: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    edges = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings]
    return np.concatenate([np.asarray(ring) for ring in rings]), np.concatenate(edges)


def position_nodes(rings: Sequence[Any], order: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights for functions of x such as W(., nu)."""
    vertices, edges = _vertices_and_edges(rings)
    return _nodes(((vertices[:, None, None] + edges) / 2).reshape(-1, 2, 2), order)


def lag_nodes(rings: Sequence[Any], order: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights for functions of xi such as A(upsilon, .)."""
    vertices, edges = _vertices_and_edges(rings)
    segments = (vertices[:, None, None] - edges).reshape(-1, 2, 2)
    return _nodes(np.concatenate([segments, -segments]), order)
