"""Gauss rules on rows of trapezoids that tile polygons, for integrands of known frequencies."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.numerics.nodes import chirp_node_counts, gauss_legendre

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Trapezoids = NDArray[np.float64]
"""(n, 3, 2): y, x on the left, and x on the right, of the lower and the upper side."""

# Pairs of edges and heights at a time.
_BATCH = 1 << 20
# Extra nodes for a pole off the plane, times arcsinh of its distance over half of the size.
_POLE = 4.0


def trapezoids_of(polygons: Any) -> tuple[Trapezoids, Indices]:
    """Trapezoids that tile polygons, between the heights of their vertices, and their numbers."""
    rings, of_ring = shapely.get_rings(polygons, return_index=True)
    places, ring = shapely.get_coordinates(rings, return_index=True)
    is_edge = ring[1:] == ring[:-1]
    edges = np.stack([places[:-1], places[1:]], axis=1)[is_edge]
    owner = of_ring[ring[:-1][is_edge]]
    counts = np.bincount(owner)
    parts, owners = [], []
    for count in np.unique(counts[counts > 0]).tolist():
        same = np.flatnonzero(counts == count)
        step = max(1, _BATCH // count**2)
        for some in np.split(same, range(step, len(same), step)):
            of_some = edges[np.isin(owner, some)].reshape(len(some), count, 2, 2)
            trapezoids, number = _between_heights(of_some)
            parts.append(trapezoids)
            owners.append(some[number])
    return np.concatenate(parts), np.concatenate(owners)


def _between_heights(edges: Floats) -> tuple[Trapezoids, Indices]:
    """Trapezoids of polygons of equally many edges (n, m, 2, 2), and their numbers."""
    (x, y), (end_x, end_y) = edges.transpose(2, 3, 0, 1)[..., None, :]
    heights = np.sort(y[:, 0])
    low, high = heights[:, :-1, None], heights[:, 1:, None]
    across = ((y <= low) != (end_y <= low)) & (low < high)
    slope = (end_x - x) / np.where(end_y == y, np.inf, end_y - y)
    ends = np.stack([np.where(across, x + (level - y) * slope, np.inf) for level in (low, high)])
    ends = np.take_along_axis(ends, np.argsort(ends.sum(axis=0), axis=-1)[None], axis=-1)
    pairs = ends[..., : 2 * (ends.shape[-1] // 2)].transpose(1, 2, 3, 0)
    left, right = pairs[:, :, ::2], pairs[:, :, 1::2]
    levels = np.broadcast_to(np.stack([low, high], axis=-1), left.shape)
    here = np.isfinite(right).all(axis=-1)
    return np.stack([levels, left, right], axis=-2)[here], np.nonzero(here)[0]


def node_counts(
    trapezoids: Trapezoids, rates: Floats, error: float, nearest: float = math.inf
) -> Indices:
    """Numbers of rows of trapezoids and of nodes on a row, (n, 2).

    ``rates`` : (2,) or (n, 2) largest frequencies of the integrand along x and y in 1/m.
    ``nearest`` : distance of its poles from the plane in m.
    """
    y, left, right = trapezoids.transpose(1, 0, 2)
    height, width = np.diff(y)[:, 0], (right - left).max(axis=1)
    aslant = np.maximum(abs(np.diff(left)), abs(np.diff(right)))[:, 0]
    over_x, over_y = rates[..., 0], rates[..., 1]
    cycles = np.stack([over_y * height + over_x * aslant, over_x * width], axis=1)
    sizes = np.stack([np.maximum(height, aslant), width], axis=1) / 2
    with np.errstate(divide="ignore"):
        poles = np.ceil(_POLE / np.arcsinh(nearest / sizes))
    return np.asarray(chirp_node_counts(math.pi * cycles, error) + poles.astype(np.intp))


def rows_of(trapezoids: Trapezoids, counts: Indices) -> tuple[Floats, Floats, Floats]:
    """x (..., m, n), y (..., m) and weights (..., m, n) of the nodes on trapezoids (..., 3, 2).

    ``counts`` : (2,) m and n, which they share.
    """
    (share, of_rows), (place, on_row) = (_unit_rule(count) for count in counts.tolist())
    lines = trapezoids[..., :1] + share * np.diff(trapezoids)
    y, left, right = (lines[..., k, :] for k in range(3))
    length = (right - left)[..., None]
    height = np.diff(trapezoids[..., 0, :])[..., None]
    return left[..., None] + length * place, y, height * of_rows[:, None] * length * on_row


def rule_on(
    trapezoids: Trapezoids, rates: Floats, error: float, extra: int
) -> tuple[Floats, Floats, Indices]:
    """Nodes (n, 2) and weights (n,) on all trapezoids, and the number of the trapezoid of each.

    ``extra`` : nodes in addition to :func:`node_counts`.
    """
    counts = node_counts(trapezoids, rates, error) + extra
    nodes, weights, owners = [], [], []
    for shared in np.unique(counts, axis=0):
        some = np.flatnonzero((counts == shared).all(axis=1))
        x, y, amounts = rows_of(trapezoids[some], shared)
        nodes.append(np.stack([x, np.broadcast_to(y[..., None], x.shape)], axis=-1).reshape(-1, 2))
        weights.append(amounts.ravel())
        owners.append(np.repeat(some, amounts[0].size))
    return np.concatenate(nodes), np.concatenate(weights), np.concatenate(owners)


@lru_cache(maxsize=1024)
def _unit_rule(count: int) -> tuple[Floats, Floats]:
    """Nodes and weights on [0, 1]."""
    nodes, weights = gauss_legendre(count)[:, :2].T / 2
    return nodes + 0.5, weights
