"""Gauss rules on triangles and trapezoids.

Triangles and trapezoids are represented as cells: images of the unit square under a bilinear map of
(u, v). The side u = 0 of a triangle is a single corner. A product of two rules on [0, 1] integrates
polynomials over a cell exactly and converges spectrally for smooth integrands.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.numerics.nodes import unit_rule

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Triangles = NDArray[np.float64]
"""Corners of triangles, shape (n, 3, 2)."""
Cells = NDArray[np.float64]
"""Corners of cells, shape (n, 4, 2), at (u, v) = (0, 0), (1, 0), (0, 1) and (1, 1)."""

# Number of quadrature nodes along a side per cycle of phase of the field. W oscillates at twice the
# frequency of the field, and Gauss rules converge above pi/2 nodes per cycle of the integrand.
NODES_PER_CYCLE = 3.5
# Largest number of quadrature nodes along a side that :func:`counts_for` returns.
LARGEST = 4096


def areas(triangles: Triangles) -> Floats:
    """Return the areas (n,) of triangles (n, 3, 2)."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def cells_of(triangles: Triangles) -> Cells:
    """Return triangles as cells, with the corner u = 0 opposite to the shortest side."""
    order = (_side_lengths(triangles).argmin(axis=1)[:, None] + np.array([0, 1, 0, 2])) % 3
    return np.take_along_axis(triangles, order[:, :, None], axis=1)


def _side_lengths(triangles: Triangles) -> Floats:
    """Return the lengths (n, 3) of the sides opposite to the corners."""
    return np.asarray(np.linalg.norm(triangles[:, (1, 2, 0)] - triangles[:, (2, 0, 1)], axis=-1))


def cell_rules(cells: Cells, counts: Indices) -> Iterator[tuple[Indices, Floats, Floats]]:
    """Yield the rules of all cells that have the same numbers of nodes.

    ``counts`` (n, 2): numbers of nodes along u and along v. Yields the indices (k,) of the cells,
    nodes (k, along u, along v, 2) and weights (k, along u, along v).
    """
    for shared in np.unique(counts, axis=0):
        members = np.flatnonzero((counts == shared).all(axis=1))
        (u, of_u), (v, of_v) = (unit_rule(count) for count in shared.tolist())
        u, v = u[:, None, None], v[:, None]
        origin, *others = cells[members].transpose(1, 0, 2)[:, :, None, None]
        lower, left, twist = others[0] - origin, others[1] - origin, others[2] - others[1]
        twist = twist - lower
        along_u, along_v = lower + v * twist, left + u * twist
        jacobian = along_u[..., 0] * along_v[..., 1] - along_u[..., 1] * along_v[..., 0]
        yield members, origin + u * lower + v * along_v, np.abs(jacobian) * np.outer(of_u, of_v)


def rule_of_counts(cells: Cells, counts: Indices) -> tuple[Floats, Floats, Indices]:
    """Return nodes (m, 2), weights (m,), and the index (m,) of the cell of each node.

    ``counts``: see :func:`cell_rules`.
    """
    rules = [
        (nodes.reshape(-1, 2), weights.ravel(), np.repeat(members, weights[0].size))
        for members, nodes, weights in cell_rules(cells, counts)
    ]
    nodes, weights, owners = (np.concatenate(parts) for parts in zip(*rules, strict=True))
    return nodes, weights, owners


def counts_for(cycles: Floats, error: float) -> Indices:
    """Return numbers of nodes that integrate a wave with ``cycles`` of phase over an interval.

    A number above ``LARGEST`` means that no rule is sufficient. The remainder of n nodes for q
    cycles is at most (pi e q/(4 n))^(2n), relative to the integral of the modulus.
    """
    n = np.arange(1.0, LARGEST + 1)
    reach = 4 * n / (math.pi * math.e) * error ** (0.5 / n)
    return np.searchsorted(reach, cycles) + 1


def triangles_of(
    polygons: Sequence[shapely.Polygon] | NDArray[np.object_],
) -> tuple[Triangles, Indices]:
    """Return constrained Delaunay triangles (m, 3, 2), and the index (m,) of their polygons."""
    collections = shapely.constrained_delaunay_triangles(np.asarray(polygons))
    parts, owner = shapely.get_parts(collections, return_index=True)
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    corners.setflags(write=False)
    return corners, owner


def gauss_rule(triangles: Triangles, rate: float, extra: float) -> tuple[Floats, Floats]:
    """Return nodes (m, 2) and weights (m,) of a Gauss rule on triangles (n, 3, 2).

    The integrand has up to ``rate`` cycles per metre. Along a side of length s the rule has ``extra
    + 3.5 s rate`` nodes, at least 1. In each triangle, the lines of nodes meet in the corner
    opposite to the shortest side.
    """
    nodes, weights, _ = rule_by_triangles(triangles, rate, extra)
    return nodes, weights


def rule_by_triangles(
    triangles: Triangles, rate: float, extra: float
) -> tuple[Floats, Floats, Indices]:
    """Return the rule of :func:`gauss_rule`, and the index (m,) of the triangle of each node."""
    counts = _counts(_extents(triangles), rate, extra)
    return rule_of_counts(cells_of(triangles), counts.astype(np.intp))


def node_count(triangles: Triangles, rate: float, extra: float) -> float:
    """Estimate the number of nodes of :func:`gauss_rule`."""
    return float(_counts(_extents(triangles), rate, extra).prod(axis=1).sum())


def spacings(triangles: Triangles, rate: float, extra: float) -> Floats:
    """Return the largest distance between neighbouring nodes of :func:`gauss_rule`, shape (n,)."""
    extents = _extents(triangles)
    return np.asarray((extents / _counts(extents, rate, extra)).max(axis=1))


def _extents(triangles: Triangles) -> Floats:
    """Return the lengths (n, 2) of the longest and the shortest side of each triangle."""
    sides = _side_lengths(triangles)
    return np.column_stack([sides.max(axis=1), sides.min(axis=1)])


def _counts(extents: Floats, rate: float, extra: float) -> Floats:
    return np.asarray(np.maximum(np.ceil(extra + NODES_PER_CYCLE * rate * extents), 1.0))


def quartered(triangles: Triangles) -> Triangles:
    """Divide each triangle into four at the midpoints of its sides; the four stay together."""
    a, b, c = triangles.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(q, axis=1) for q in quarters], axis=1).reshape(-1, 3, 2)
