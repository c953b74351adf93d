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

# Radians of phase from the centre of a panel to its ends.
_LONGEST_PANEL = 400.0
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
    trapezoids: Trapezoids, rates: Floats, error: float, nearest: float = math.inf, extra: int = 0
) -> Indices:
    """Panels and nodes of each panel over the rows of trapezoids and on each row, (n, 2, 2).

    ``rates`` : (2,) or (n, 2) largest frequencies of the integrand along x and y in 1/m.
    ``nearest`` : distance of its poles from the plane in m.
    """
    y, left, right = trapezoids.transpose(1, 0, 2)
    height, width = np.diff(y)[:, 0], (right - left).max(axis=1)
    aslant = np.maximum(abs(np.diff(left)), abs(np.diff(right)))[:, 0]
    over_x, over_y = rates[..., 0], rates[..., 1]
    cycles = np.stack([over_y * height + over_x * aslant, over_x * width], axis=1)
    panels = np.maximum(np.ceil(math.pi * cycles / _LONGEST_PANEL), 1.0)
    counts = chirp_node_counts(math.pi * cycles / panels, error) + extra
    sizes = np.stack([np.maximum(height, aslant), width], axis=1) / 2
    with np.errstate(divide="ignore"):
        poles = np.ceil(_POLE / np.arcsinh(nearest * panels / sizes))
    return np.stack([panels, counts + poles], axis=2).astype(np.intp)


def rows_of(trapezoids: Trapezoids, counts: Indices) -> tuple[Floats, Floats, Floats]:
    """x (..., m, n), y (..., m) and weights (..., m, n) of the nodes on trapezoids (..., 3, 2).

    ``counts`` : (2, 2), one of :func:`node_counts` that they share.
    """
    (share, of_rows), (place, on_row) = (_unit_rule(*each) for each in counts.tolist())
    lines = trapezoids[..., :1] + share * np.diff(trapezoids)
    y, left, right = (lines[..., k, :] for k in range(3))
    length = (right - left)[..., None]
    height = np.diff(trapezoids[..., 0, :])[..., None]
    return left[..., None] + length * place, y, height * of_rows[:, None] * length * on_row


def rule_on(
    trapezoids: Trapezoids, rates: Floats, error: float, extra: int
) -> tuple[Floats, Floats, Indices]:
    """Nodes (n, 2) and weights (n,) on all trapezoids, and the number of the trapezoid of each."""
    counts = node_counts(trapezoids, rates, error, extra=extra)
    nodes, weights, owners = [], [], []
    kinds, kind = np.unique(counts.reshape(len(counts), -1), axis=0, return_inverse=True)
    for number, shared in enumerate(kinds):
        some = np.flatnonzero(kind == number)
        x, y, amounts = rows_of(trapezoids[some], shared.reshape(2, 2))
        nodes.append(np.stack([x, np.broadcast_to(y[..., None], x.shape)], axis=-1).reshape(-1, 2))
        weights.append(amounts.ravel())
        owners.append(np.repeat(some, amounts[0].size))
    return np.concatenate(nodes), np.concatenate(weights), np.concatenate(owners)


def _unit_rule(panels: int, count: int) -> tuple[Floats, Floats]:
    """Nodes and weights on [0, 1]."""
    nodes, weights = _legendre(count)
    nodes = (np.arange(panels)[:, None] + (nodes + 1) / 2) / panels
    return nodes.ravel(), np.tile(weights / (2 * panels), panels)


@lru_cache(maxsize=256)
def _legendre(count: int) -> tuple[Floats, Floats]:
    nodes, weights = gauss_legendre(count)[:, :2].T
    return nodes, weights
