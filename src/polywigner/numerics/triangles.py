"""Gauss rules on triangles: products of two rules on lines from the corner opposite the short side.

They integrate polynomials exactly and converge spectrally for smooth integrands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.numerics.nodes import unit_rule

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Triangles = NDArray[np.float64]
"""Corners (n, 3, 2)."""

# Nodes along a side per cycle of the phase of a field. W oscillates at twice its frequency, and
# Gauss rules converge above pi/2 nodes per cycle of the integrand.
NODES_PER_CYCLE = 3.5
# Largest number of nodes along a side in the table of counts.
_MOST = 4096


def areas(triangles: Triangles) -> Floats:
    """Return the areas (n,) of triangles (n, 3, 2)."""
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


def triangulated(polygons: Sequence[shapely.Polygon] | NDArray[np.object_]) -> Triangles:
    """Return the constrained Delaunay triangles (n, 3, 2) of polygons."""
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(np.asarray(polygons)))
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    corners.setflags(write=False)
    return corners


def gauss_rule(triangles: Triangles, rate: float, extra: float) -> tuple[Floats, Floats]:
    """Return nodes (m, 2) and weights (m,) of a rule on triangles (n, 3, 2).

    The integrand has up to ``rate`` cycles per metre. Along a side of length s the rule has ``extra
    + 3.5 s rate`` nodes, at least 1. The lines of nodes meet in the corner opposite to the shortest
    side of each triangle.
    """
    nodes, weights, _ = rule_by_triangles(triangles, rate, extra)
    return nodes, weights


def rule_by_triangles(
    triangles: Triangles, rate: float, extra: float
) -> tuple[Floats, Floats, Indices]:
    """Return the rule of :func:`gauss_rule`, and the index (m,) of the triangle of each node."""
    corners, long, short = from_apex(triangles)
    return rule_of_counts(corners, _counts(long, short, rate, extra).astype(np.intp))


def node_count(triangles: Triangles, rate: float, extra: float) -> float:
    """Estimate the number of nodes of :func:`gauss_rule`."""
    _, long, short = from_apex(triangles)
    return float(_counts(long, short, rate, extra).prod(axis=1).sum())


def spacings(triangles: Triangles, rate: float, extra: float) -> Floats:
    """Return the largest distance between neighbouring nodes of :func:`gauss_rule`, (n,)."""
    _, long, short = from_apex(triangles)
    sides = np.column_stack([long, short])
    return np.asarray((sides / _counts(long, short, rate, extra)).max(axis=1))


def _counts(long: Floats, short: Floats, rate: float, extra: float) -> Floats:
    sides = np.column_stack([long, short])
    return np.asarray(np.maximum(np.ceil(extra + NODES_PER_CYCLE * rate * sides), 1.0))


def quartered(triangles: Triangles) -> Triangles:
    """Divide each triangle at the midpoints of its sides into four, in order of the triangles."""
    a, b, c = triangles.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(q, axis=1) for q in quarters], axis=1).reshape(-1, 3, 2)
