"""Gauss rules on triangles: products of two rules on lines from the corner opposite the short side.

They integrate polynomials exactly and converge spectrally for smooth integrands.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from polywigner.numerics.nodes import gauss_legendre

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Triangles = NDArray[np.float64]
"""Corners (n, 3, 2)."""

# Largest number of nodes along a side in the table of counts.
_MOST = 4096


@lru_cache(maxsize=256)
def unit_rule(count: int) -> tuple[Floats, Floats]:
    """Return the Gauss-Legendre nodes and weights on [0, 1], read-only."""
    nodes, weights = gauss_legendre(count)[:, :2].T / 2
    rule = nodes + 0.5, weights.copy()
    for array in rule:
        array.setflags(write=False)
    return rule


def areas(triangles: Triangles) -> Floats:
    """Areas (n,) of triangles (n, 3, 2), in square metres."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def from_apex(triangles: Triangles) -> tuple[Triangles, Floats, Floats]:
    """Return corners, starting opposite to the shortest side; longest sides; shortest sides."""
    sides = np.linalg.norm(triangles[:, (1, 2, 0)] - triangles[:, (2, 0, 1)], axis=-1)
    apex = sides.argmin(axis=1)
    order = (apex[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(triangles, order[:, :, None], axis=1)
    return corners, sides.max(axis=1), sides.min(axis=1)


def rule_of_counts(corners: Triangles, counts: Indices) -> tuple[Floats, Floats, Indices]:
    """Return nodes (m, 2), weights (m,) and the triangle (m,) of each node.

    ``counts`` (n, 2): nodes from the first corner to the opposite side, and along this side.
    """
    nodes, weights, owners = [], [], []
    for shared in np.unique(counts, axis=0):
        members = np.flatnonzero((counts == shared).all(axis=1))
        (u, of_u), (v, of_v) = (unit_rule(count) for count in shared.tolist())
        apex, first, second = corners[members].transpose(1, 0, 2)[:, :, None, None]
        along = first - apex + v[:, None] * (second - first)
        nodes.append((apex + u[:, None, None] * along).reshape(-1, 2))
        on_unit = np.outer(of_u * u, of_v).ravel()
        weights.append(np.outer(2 * areas(corners[members]), on_unit).ravel())
        owners.append(np.repeat(members, len(on_unit)))
    return np.concatenate(nodes), np.concatenate(weights), np.concatenate(owners)


def counts_for(cycles: Floats, error: float) -> Indices:
    """Return the numbers of nodes that integrate waves of ``cycles`` over an interval.

    The remainder of n nodes for q cycles is at most (pi e q/(4 n))^(2n), relative to the integral
    of the modulus.
    """
    n = np.arange(1.0, _MOST + 1)
    reach = 4 * n / (math.pi * math.e) * error ** (0.5 / n)
    return np.searchsorted(reach, cycles) + 1
