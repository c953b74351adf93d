"""Gauss rules on triangles for integrals of the Wigner function over position."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from polywigner.propagation.arrangement import Triangles

__all__ = [
    "NODES_PER_CYCLE",
    "Rule",
    "areas",
    "gauss_rule",
    "node_count",
    "rule_by_triangles",
    "spacings",
]

Values = NDArray[np.float64]
Rule = tuple[Values, Values]
"""Nodes (n, 2) in metres and weights (n,) in square metres."""

# Nodes along a side for each cycle of the phase of W, which turns at twice the frequency: Gauss
# needs pi/2 for each cycle of its integrand before it converges.
NODES_PER_CYCLE = 3.5
# Rules of more nodes are made of equal panels of half as many: they cost too much to find.
_MOST_IN_ONE = 200


def gauss_rule(triangles: Triangles, rate: float, extra: float) -> Rule:
    """A rule on all triangles (n, 3, 2), for integrands of ``rate`` cycles per metre.

    Along a side of length s it has ``extra + 3.5 s rate`` nodes, at least 1. Of each triangle the
    corner opposite to the shortest side is the one in which the rule's lines meet.
    """
    nodes, weights, _ = rule_by_triangles(triangles, rate, extra)
    return nodes, weights


def rule_by_triangles(
    triangles: Triangles, rate: float, extra: float
) -> tuple[Values, Values, NDArray[np.intp]]:
    """The rule of :func:`gauss_rule`, and the number of the triangle of each node, (n,)."""
    corners, long, short = _from_apex(triangles)
    counts = _counts(long, short, rate, extra).astype(int)
    nodes, weights, owners = zip(*_by_counts(corners, counts), strict=True)
    return np.concatenate(nodes), np.concatenate(weights), np.concatenate(owners)


def node_count(triangles: Triangles, rate: float, extra: float) -> float:
    """About how many nodes :func:`gauss_rule` has, before any is made."""
    _, long, short = _from_apex(triangles)
    return float(_counts(long, short, rate, extra).prod(axis=1).sum())


def spacings(triangles: Triangles, rate: float, extra: float) -> Values:
    """The distances between nodes of :func:`gauss_rule` in each triangle, on its longer lines."""
    _, long, short = _from_apex(triangles)
    sides: Values = np.column_stack([long, short])
    result: Values = (sides / _counts(long, short, rate, extra)).max(axis=1)
    return result


def _counts(long: Values, short: Values, rate: float, extra: float) -> Values:
    sides = np.column_stack([long, short])
    result: Values = np.maximum(np.ceil(extra + NODES_PER_CYCLE * rate * sides), 1.0)
    return result


def areas(triangles: Triangles) -> Values:
    """Areas (n,) of triangles (n, 3, 2), in square metres."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    result: Values = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return result


def _from_apex(triangles: Triangles) -> tuple[Triangles, Values, Values]:
    """Corners with that opposite to the shortest side first; the longest side, and the shortest."""
    sides = np.linalg.norm(triangles[:, (1, 2, 0)] - triangles[:, (2, 0, 1)], axis=-1)
    apex = sides.argmin(axis=1)
    order = (apex[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(triangles, order[:, :, None], axis=1)
    return corners, sides.max(axis=1), sides.min(axis=1)


def _by_counts(
    corners: Triangles, counts: NDArray[np.int_]
) -> Iterator[tuple[Values, Values, NDArray[np.intp]]]:
    for count in np.unique(counts, axis=0):
        owners = np.flatnonzero((counts == count).all(axis=1))
        chosen = corners[owners]
        u, u_weights = _legendre(int(count[0]))
        v, v_weights = _legendre(int(count[1]))
        apex, first = chosen[:, None, None, 0], chosen[:, None, None, 1]
        second = chosen[:, None, None, 2]
        u, v = u[:, None, None], v[None, :, None]
        nodes = apex + u * (first - apex + v * (second - first))
        weights = (u_weights * u[:, 0, 0])[:, None] * v_weights
        per_triangle = weights.size
        weights = 2 * areas(chosen)[:, None] * weights.reshape(1, -1)
        yield nodes.reshape(-1, 2), weights.ravel(), np.repeat(owners, per_triangle)


@lru_cache(maxsize=256)
def _legendre(count: int) -> tuple[Values, Values]:
    """Nodes and weights on [0, 1]; of many, some more than ``count``."""
    panels = 1 if count <= _MOST_IN_ONE else -(-2 * count // _MOST_IN_ONE)
    nodes, weights = np.polynomial.legendre.leggauss(-(-count // panels))
    places = (np.arange(panels)[:, None] + (nodes + 1) / 2) / panels
    return places.ravel(), np.tile(weights / (2 * panels), panels)
