"""Gauss rules on rows of trapezoids that tile polygons, for integrands of known frequencies."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.numerics.nodes import chirp_node_counts, gauss_legendre

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Trapezoids = NDArray[np.float64]
"""(n, 3, 2): y, x on the left, and x on the right, of the lower and the upper side."""

# Extra nodes for a pole off the plane, times arcsinh of its distance over half of the size.
_POLE = 4.0


def trapezoids_of(rings: Iterable[Any]) -> Trapezoids:
    """Trapezoids that tile the inside of rings (n, 2), between the heights of their vertices."""
    rings = list(rings)
    begin = np.concatenate(rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    parts = []
    for low, high in pairwise(np.unique(begin[:, 1]).tolist()):
        across = (begin[:, 1] <= low) != (end[:, 1] <= low)
        a, b = begin[across], end[across]
        x = a[:, 0] + (np.array([[low], [high]]) - a[:, 1]) * ((b - a)[:, 0] / (b - a)[:, 1])
        x = x[:, np.argsort(x.sum(axis=0))].T
        parts.append(np.stack([np.broadcast_to([low, high], x[::2].shape), x[::2], x[1::2]], 1))
    return np.concatenate(parts)


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
