"""Gauss-Legendre nodes on triangles, which converge spectrally where a function has no kinks."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np


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


def nodes_on(source: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) on a source of the plane, and its field there times the area of each."""
    parts = []
    for element, weight in zip(
        source.elements_in_plane, getattr(source, "weights", [1.0]), strict=True
    ):
        fans = [(p[0], b, c) for p in element.convex_cover for b, c in pairwise(p[1:])]
        points, areas = triangle_nodes(np.array(fans), count)
        field = 1.0 if element.illumination is None else element.illumination(points)
        parts.append((points, weight * areas * field))
    return np.concatenate([x for x, _ in parts]), np.concatenate([u for _, u in parts])
