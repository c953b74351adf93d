"""Gauss rules on intervals, triangles and trapezoids, with error estimates.

An integrand on [-1, 1] that is bounded by M inside the ellipse with the foci -1 and 1 and the
half-axes cosh u and sinh u has Legendre coefficients c_n of about M exp(-n u). The error of the
rule with n nodes is about M exp(-2 n u). For a wave whose phase changes by w radians over half of
the interval, M is exp(w sinh u). These formulas define the number of nodes. The error is then
estimated as c_n^2/M from the values at the nodes, equation (B5). Triangles and trapezoids are
bilinear images of the unit square, called cells, with products of two Gauss rules.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache, reduce
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.numerics import Floats, Indices, Number

Rules = tuple[Floats, ...]
"""Quadrature rules as tables with the columns node, weight, and weights in the last two Legendre
coefficients."""

# Number of rules for each doubling of the number of nodes, and numbers of nodes of the smallest and
# largest rules. The selected rule has on average a sixteenth more nodes than necessary.
_STEPS, _SMALLEST, _LARGEST = 8, 4, 724
_SIZES = tuple(
    math.ceil(_SMALLEST * 2 ** (k / _STEPS))
    for k in range(math.ceil(_STEPS * math.log2(_LARGEST / _SMALLEST)) + 1)
)
# Parameters u of the ellipses of the error bound. The smallest ellipse passes through the imaginary
# unit i. If a singularity lies inside this ellipse, the bound uses _CHORD and _GROWTH.
_ELLIPSES = (math.asinh(1.0), 1.2, 1.6, 2.1, 2.8)
# Constants of the bounds u >= 0.88 sinh u and sinh u <= 1.135 u, which hold for sinh u up to 1.
_CHORD, _GROWTH = 0.88, 1.135
# Safety factor of the error estimate. With this factor, the estimate exceeded the error on all of
# 270,000 panels, at distances from 1e-4 to 100 wavelengths and tolerances from 0.1 to 1e-9. Without
# the factor, a few of 10,000 errors were larger than estimated.
_SAFETY = 8.0
# Largest ratio of the squares of the last Legendre coefficients to their expected size for which
# the bound M is used.
_SURPRISE = 1e3
SUMS = 7


@lru_cache(maxsize=1)
def gauss_rules() -> Rules:
    """Return all Gauss-Legendre rules on [-1, 1] as `Rules`, from the smallest to the largest."""
    return tuple(gauss_legendre(n) for n in _SIZES)


def gauss_legendre(n: int) -> Floats:
    """Return the columns of `Rules` for the Gauss-Legendre rule with n nodes on [-1, 1].

    Newton's method starts from Tricomi's approximation, whose error is proportional to 1/n^4.
    """
    angle = math.pi * (np.arange(n, 0, -1) - 0.25) / (n + 0.5)
    x = (1 - (1 - 1 / n) / (8 * n * n)) * np.cos(angle)
    for _ in range(4):
        last, before = _legendre(n, x)
        slope = n * (before - x * last) / (1 - x * x)
        x = x - last / slope
    last, before = _legendre(n, x)
    slope = n * (before - x * last) / (1 - x * x)
    weight = 2 / ((1 - x * x) * slope * slope)
    _, second = _legendre(n - 1, x)
    return np.stack([x, weight, (n - 0.5) * weight * before, (n - 1.5) * weight * second], axis=1)


def _legendre(n: int, x: Floats) -> tuple[Any, Any]:
    """Return the values of the Legendre polynomials of degree n and n - 1."""
    before, last = np.ones_like(x), x
    for k in range(2, n + 1):
        before, last = last, ((2 * k - 1) * x * last - (k - 1) * before) / k
    return last, before


def nodes_needed(ops: Any, digits: Any, gap: Any, radians: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return the number of quadrature nodes for a relative error of exp(-digits).

    Parameters
    ----------
    digits : array
        Negative natural logarithm of the allowed relative error.
    gap : array
        Distance of the singularities from the interval, in half-lengths of the interval.
    radians : array
        Phase over half of the interval in radians.

    Returns
    -------
    needed : array
        Number of nodes, not rounded.
    expected : tuple of array
        Digits, log(M), and log(c_n), for :func:`error_of`.
    """
    inside = ops.minimum(gap, 1.0)
    needed = digits / (2 * _CHORD * inside) + 0.5 * _GROWTH * radians
    growth = inside * radians
    for u in _ELLIPSES:
        grown = math.sinh(u) * radians
        nodes = (digits + grown) * (0.5 / u)
        better = (gap >= math.sinh(u)) & (nodes < needed)
        needed = ops.select(better, nodes, needed)
        growth = ops.select(better, grown, growth)
    last = inside * (radians - _CHORD * needed)
    for u in _ELLIPSES:
        bound = ops.select(gap >= math.sinh(u), math.sinh(u) * radians - u * needed, 0.0)
        last = ops.minimum(last, bound)
    return needed, (digits, growth, last)


def rule_index(ops: Any, needed: Any) -> Number:
    """Return the index in :func:`gauss_rules` of the smallest rule with ``needed`` nodes or more.

    If no rule is large enough, the index of the largest rule is returned.
    """
    # The offset is slightly below 0.5, so that the exact size of a rule is not rounded up.
    steps = (_STEPS / math.log(2)) * ops.log(ops.maximum(needed, 1.0) * (1 / _SMALLEST))
    return ops.minimum(ops.maximum(ops.round(steps + 0.4999), 0.0), len(_SIZES) - 1.0)


def node_sums(real: Any, imag: Any, weight: Any, last: Any, second: Any) -> tuple[Any, ...]:
    """Return the contributions of a quadrature node to an integral and to its error estimate.

    ``real`` and ``imag`` are the parts of the integrand at the node. ``weight``, ``last`` and
    ``second`` are the weights in a row of `Rules`. The results are contributions to the complex
    integral, to the integral of the modulus, and to the last two complex Legendre coefficients.
    """
    size = weight * (abs(real) + abs(imag))
    return (
        real * weight, imag * weight, size,
        real * last, imag * last, real * second, imag * second,
    )  # fmt: skip


def error_of(ops: Any, sums: tuple[Any, ...], expected: tuple[Any, ...], cycles: Any) -> Number:
    """Return an absolute error estimate of an integral, including rounding errors.

    ``sums`` contains the sums of :func:`node_sums` over all nodes, and ``expected`` the second
    result of :func:`nodes_needed`. ``cycles`` is an upper bound on the sum of all phases, in
    cycles.
    """
    size, a, b, c, d = sums[2:]
    digits, growth, last = expected
    ulp = 2.0**-52 if ops.double else 2.0**-23
    floor = 1e-290 if ops.double else 1e-30
    mean = 0.5 * size
    ratio = ((a * a + b * b) + (c * c + d * d)) / (mean * mean + floor)
    as_expected = ratio < _SURPRISE * ops.exp(2.0 * last)
    estimate = ops.select(as_expected, ratio * ops.exp(-growth), ratio)
    # Legendre coefficients may be small by chance, so the estimate is at least the allowed error.
    least = ops.minimum(ops.sqrt(ratio), ops.exp(-digits))
    fraction = ops.minimum(_SAFETY * ops.maximum(estimate, least), 2.0)
    return mean * (fraction + ulp * (4.0 + 2.0 * cycles))


Rule = tuple[Floats, Floats]
"""Nodes and weights of a quadrature rule, as read-only arrays. The sum of the weights is 1."""


@lru_cache(maxsize=64)
def gaussian_rule(bandwidth: float, error: float) -> Rule:
    """Return a quadrature rule for the mean of a function of a standard normal variable x.

    The rule has an absolute error of ``error`` for waves exp(i w x) with |w| up to ``bandwidth``.
    """
    tail = math.sqrt(2 * math.log(2 / error))
    half = math.ceil(tail * (bandwidth + tail) / (2 * math.pi))
    nodes: Any
    weights: Any
    # The Gauss-Hermite rule with n nodes has the error bandwidth^(2n) n!/(2n)!.
    with np.errstate(over="ignore"):
        errors = np.cumprod(bandwidth**2 / (4 * np.arange(1, 2 * half + 1) - 2))
    sufficient = np.flatnonzero(errors <= error)
    if len(sufficient):
        nodes, weights = np.polynomial.hermite_e.hermegauss(int(sufficient[0]) + 1)
    else:
        nodes = np.arange(-half, half + 1) * (2 * math.pi / (bandwidth + tail))
        weights = np.exp(-(nodes**2) / 2)
    return _normalised_rule(nodes, weights)


@lru_cache(maxsize=64)
def gaussian_product_rule(bandwidths: tuple[float, ...], error: float) -> Rule:
    """Return a quadrature rule for the mean of a function of independent normal variables.

    The nodes have the shape (n, variables). ``bandwidths`` contains the argument of
    :func:`gaussian_rule` for each variable. The nodes with the smallest weights are omitted; the
    sum of their weights is at most a tenth of ``error``.
    """
    rules = [gaussian_rule(width, error / (2 * len(bandwidths))) for width in bandwidths]
    nodes = np.stack(np.meshgrid(*(n for n, _ in rules), indexing="ij"), -1)
    flat = reduce(np.multiply.outer, (weights for _, weights in rules)).ravel()
    order = np.argsort(flat)
    remaining = np.sort(order[np.cumsum(flat[order]) > error / 10])
    return _normalised_rule(nodes.reshape(-1, len(bandwidths))[remaining], flat[remaining])


@lru_cache(maxsize=64)
def uniform_rule(bandwidth: float, error: float) -> Rule:
    """Return a quadrature rule for the mean of a function of t over the interval from -1 to 1.

    The function consists of waves exp(i w t) with |w| up to ``bandwidth``. The rule has two more
    nodes than the error bound requires, because the integrand also contains powers of the
    frequency.
    """
    count = int(counts_for_cycles(np.array(bandwidth / math.pi), error)) + 2
    return _normalised_rule(*np.polynomial.legendre.leggauss(count))


def chirp_node_counts(radians: Any, error: float) -> Indices:
    """Return the numbers of Gauss-Legendre nodes for waves with a linear or quadratic phase.

    The derivative of the phase on [-1, 1] is at most ``radians``. The error of the rule with n
    nodes is about the sum of the Chebyshev coefficients of order 2n and higher. For exp(i w x), the
    coefficient of order k is J_k(w). For exp(i w x^2/2), the coefficient of order 2k is J_k(w/4).
    Debye's approximation is J_k(k/cosh a) = exp(-k (a - tanh a)).
    """
    a = np.geomspace(20.0, 1e-2, 400)
    degrees = -math.log(error) / (a - np.tanh(a))
    linear, bent = np.interp([radians, np.divide(radians, 4)], degrees / np.cosh(a), degrees)
    return np.ceil(np.maximum(linear / 2, bent)).astype(np.intp) + 1


def _normalised_rule(nodes: Floats, weights: Floats) -> Rule:
    """Return nodes and weights as read-only arrays. The weights are scaled to a sum of 1."""
    weights = weights / weights.sum()
    for array in (nodes, weights):
        array.setflags(write=False)
    return nodes, weights


@lru_cache(maxsize=1024)
def unit_rule(count: int) -> Rule:
    """Return the nodes and weights of the Gauss-Legendre rule on [0, 1]."""
    nodes, weights = gauss_legendre(count)[:, :2].T / 2
    return nodes + 0.5, weights


Triangles = NDArray[np.float64]
"""Corners of n triangles, shape (n, 3, 2)."""
Cells = NDArray[np.float64]
"""Corners of n cells, shape (n, 4, 2), at (u, v) = (0, 0), (1, 0), (0, 1) and (1, 1)."""

# Number of quadrature nodes along a side per phase cycle of the field. W oscillates at twice the
# frequency of the field, and Gauss rules converge with more than pi/2 nodes per cycle of the
# integrand.
NODES_PER_CYCLE = 3.5
# Largest number of quadrature nodes along a side. :func:`counts_for_cycles` returns a larger number
# if more nodes are necessary.
LARGEST = 4096


def areas(triangles: Triangles) -> Floats:
    """Return the unsigned area of each triangle."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def cells_of(triangles: Triangles) -> Cells:
    """Return triangles as cells; the two corners at u = 0 coincide, opposite the shortest side."""
    order = (_side_lengths(triangles).argmin(axis=1)[:, None] + np.array([0, 1, 0, 2])) % 3
    return np.take_along_axis(triangles, order[:, :, None], axis=1)


def _side_lengths(triangles: Triangles) -> Floats:
    """Return, for each triangle, the length of the side opposite each corner."""
    return np.asarray(np.linalg.norm(triangles[:, (1, 2, 0)] - triangles[:, (2, 0, 1)], axis=-1))


def cell_rules(cells: Cells, counts: Indices) -> Iterator[tuple[Indices, Floats, Floats]]:
    """Yield quadrature rules, one for each group of cells with the same numbers of nodes.

    ``counts`` contains the numbers of nodes along u and v for each cell, shape (n, 2). A rule
    consists of the indices of k cells, the nodes, shape (k, nodes along u, nodes along v, 2), and
    the weights. The weights of a cell add up to its area.
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


def rule_over_cells(cells: Cells, counts: Indices) -> tuple[Floats, Floats, Indices]:
    """Return the nodes (n, 2) and weights of a Gauss rule on cells, and the cell of each node.

    ``counts`` is the argument of :func:`cell_rules`. The weights of a cell add up to its area.
    """
    rules = [
        (nodes.reshape(-1, 2), weights.ravel(), np.repeat(members, weights[0].size))
        for members, nodes, weights in cell_rules(cells, counts)
    ]
    nodes, weights, owners = (np.concatenate(parts) for parts in zip(*rules, strict=True))
    return nodes, weights, owners


def counts_for_cycles(cycles: Floats, error: float) -> Indices:
    """Return the numbers of nodes for waves with ``cycles`` cycles over the integration interval.

    A number above ``LARGEST`` means that no rule is sufficient. With n nodes and q cycles, the
    error is at most (pi e q/(4 n))^(2n), relative to the integral of the modulus.
    """
    n = np.arange(1.0, LARGEST + 1)
    largest = 4 * n / (math.pi * math.e) * error ** (0.5 / n)
    return np.searchsorted(largest, cycles) + 1


def triangles_of(
    polygons: Sequence[shapely.Polygon] | NDArray[np.object_],
) -> tuple[Triangles, Indices]:
    """Return constrained Delaunay triangles of polygons, and the polygon index of each triangle."""
    collections = shapely.constrained_delaunay_triangles(np.asarray(polygons))
    parts, owner = shapely.get_parts(collections, return_index=True)
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    corners.setflags(write=False)
    return corners, owner


def gauss_rule(triangles: Triangles, rate: float, extra: float) -> tuple[Floats, Floats, Indices]:
    """Return the nodes and weights of a Gauss rule on triangles, and the triangle of each node.

    The integrand has up to ``rate`` phase cycles per metre. Along a side of length s the rule has
    ``extra + 3.5 s rate`` nodes, rounded up, but at least 1. The weights of a triangle add up to
    its area.
    """
    counts = _side_counts(_extreme_sides(triangles), rate, extra)
    return rule_over_cells(cells_of(triangles), counts.astype(np.intp))


def node_count(triangles: Triangles, rate: float, extra: float) -> float:
    """Estimate the number of nodes of :func:`gauss_rule`."""
    return float(_side_counts(_extreme_sides(triangles), rate, extra).prod(axis=1).sum())


def spacings(triangles: Triangles, rate: float, extra: float) -> Floats:
    """Return the mean distance of adjacent nodes of :func:`gauss_rule` in each triangle.

    The result is the larger of the distances along the longest and the shortest side.
    """
    lengths = _extreme_sides(triangles)
    return np.asarray((lengths / _side_counts(lengths, rate, extra)).max(axis=1))


def _extreme_sides(triangles: Triangles) -> Floats:
    """Return the lengths of the longest and the shortest side of each triangle, shape (n, 2)."""
    sides = _side_lengths(triangles)
    return np.column_stack([sides.max(axis=1), sides.min(axis=1)])


def _side_counts(lengths: Floats, rate: float, extra: float) -> Floats:
    """Return the numbers of nodes of :func:`gauss_rule` along sides, as floats."""
    return np.asarray(np.maximum(np.ceil(extra + NODES_PER_CYCLE * rate * lengths), 1.0))


def quartered(triangles: Triangles) -> Triangles:
    """Divide each triangle at the midpoints of its sides into four consecutive triangles."""
    a, b, c = triangles.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(q, axis=1) for q in quarters], axis=1).reshape(-1, 3, 2)
