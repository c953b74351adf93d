"""Integrals of chirps exp(i pi (c t^2 - 2 f t)), with the curvature c, over intervals and polygons.

Integrals along a line are differences of Fresnel integrals. The transform of a curved wave over a
polygon is int exp(i pi x.Qx - 2 pi i nu.x) dx with the curvature matrix Q. In the principal axes of
Q, with the curvatures q1 and q2, Green's theorem gives

    int int exp(i pi (q1 x^2 + q2 y^2) - 2 pi i nu.x) dx dy
        = closed int G(x) exp(i pi q2 y^2 - 2 pi i nu_y y) dy,

where q1 is the larger curvature and G(x) is the integral of exp(i pi q1 t^2 - 2 pi i nu_x t) from 0
to x. The integrand is an entire function, so Gauss rules converge as soon as they resolve its
oscillations. Source: equations (Q5) of docs/curved.md and (O6) of docs/first_order.md.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.numerics.nodes import gauss_rules

_TERMS = 12
_A = math.sqrt((_TERMS + 0.5) * math.pi)
_SQUARES = ((np.arange(_TERMS) + 0.5) * math.pi / _A) ** 2
_WEIGHTS = np.exp(-_SQUARES)
_TURN = cmath.exp(-0.25j * math.pi)
# Largest exponent for which the step of the Fresnel integral differs from 0 and 1.
_FARTHEST = 60.0


def fresnel_tail(t: Floats, side: Any = 0.0) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the Fresnel integral T from t to infinity, as two parts.

    T(t) = (1/sqrt pi) exp(-i pi/4) int_t^inf exp(i s^2) ds = step + exp(i t^2) remainder. The
    results are step - ``side`` and the remainder, each with a small relative error. ``side`` is 1
    if T is near 1, and 0 otherwise.
    """
    exponent = 2 * _A * _TURN * np.clip(t, -_FARTHEST, _FARTHEST)
    # The step is 1/(exp(z) + 1). The step minus 1 is -1/(exp(-z) + 1), without cancellation.
    sign = 1.0 - 2.0 * side
    with np.errstate(over="ignore"):
        step = sign / (np.exp(sign * exponent) + 1.0)
    square = t * t
    fourth = square * square
    real, imag = np.zeros_like(t), np.zeros_like(t)
    for weight, node in zip(_WEIGHTS.tolist(), _SQUARES.tolist(), strict=True):
        term = weight / (fourth + node * node)
        real += term
        imag -= node * term
    return step, (t / (_A * _TURN)) * (square * real + 1j * imag)


# A Gauss rule with 8 nodes is accurate to rounding errors for up to _FEW_CYCLES phase cycles.
# For more cycles, differences of Fresnel integrals lose at most one digit.
_RULE, _FEW_CYCLES = legendre.leggauss(8), 1 / 16
# Phase over the longest interval [half cycles] below which a curvature is treated as 0.
_FLAT = 1e-20


def chirp_integral(end: Any, curvature: Any, frequency: Any) -> Complex:
    """Return the integral of a chirp, exp(i pi (c t^2 - 2 f t)), from t = 0 to ``end``.

    Parameters
    ----------
    end : array_like
        Upper limit of integration, in units of length.
    curvature : array_like
        Curvature c in 1/length^2, which may be positive, negative or zero.
    frequency : array_like
        Frequency f in 1/length. All three arguments broadcast against each other.
    """
    b, c, f = (np.asarray(values, np.float64) for values in (end, curvature, frequency))
    sign = np.where(c < 0, -1.0, 1.0)
    f = sign * f
    longest = float(abs(b).max(initial=0.0)) or 1.0
    c = np.maximum(abs(c), _FLAT / longest**2)
    short = abs(b) * np.maximum(abs(f), abs(c * b - f)) < _FEW_CYCLES
    value = _by_fresnel(b, c, f)
    if short.any():
        value[short] = _by_gauss(*(np.broadcast_to(v, short.shape)[short] for v in (b, c, f)))
    if (sign < 0).any():
        value.imag *= sign
    return value


def waves_of_cycles(cycles: Any) -> Complex:
    """Return the waves exp(2 pi i cycles)."""
    return np.exp(2j * math.pi * (cycles - np.rint(cycles)))


def _by_gauss(b: Floats, c: Floats, f: Floats) -> Complex:
    """Return the chirp integral from 0 to b by a Gauss rule, which is accurate for few cycles."""
    nodes, weights = _RULE
    total = np.zeros(b.shape, np.complex128)
    for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
        t = b * (0.5 + 0.5 * node)
        total += 0.5 * weight * np.exp(1j * math.pi * (t * (c * t - 2 * f)))
    return b * total


def _by_fresnel(b: Floats, c: Floats, f: Floats) -> Complex:
    """Return the chirp integral from 0 to b by two Fresnel integrals, for curvatures c > 0.

    The result is inaccurate for small phases.
    """
    root = np.sqrt(math.pi * c)
    begin, side = -f * (root / c), (f > 0).astype(np.float64)
    first_step, first = fresnel_tail(begin, side)
    step, last = fresnel_tail(root * b + begin, side)
    bend = waves_of_cycles(-0.5 * f * (f / c))
    value = first - last * waves_of_cycles(0.5 * b * (c * b - 2 * f))
    value += bend * (first_step - step)
    return np.asarray(value * (np.exp(0.25j * math.pi) / np.sqrt(c)))


# Largest phase along an edge [cycles]. A larger phase would need gigabytes for a single point.
_MOST_CYCLES = 1e5
# Phase on each piece of an edge [cycles], far below the limit of the largest Gauss rule.
_CYCLES = 200.0
# Only every fourth Gauss rule is used, so there are two rules for each doubling of the number of
# nodes.
_STRIDE = 4
# Numbers of quadrature nodes and of (point, edge) pairs per block. A block fits into the cache of a
# core.
_BLOCK, _PAIRS = 1 << 13, 1 << 16
# Number of quadrature nodes below which a batch is combined with the batch of the next larger rule.
_FEW = 1 << 9


def chirp_over_intervals(intervals: Floats, q: Floats, nu: Floats) -> Complex:
    """Return the transform of curved waves over a set of intervals, shape (n,).

    The transform is the integral of exp(i pi (q t^2 - 2 nu t)) over all ``intervals`` (k, 2). ``q``
    and ``nu``, shape (n,), contain the curvature and the frequency of each result.
    """
    value = chirp_integral(intervals.ravel(), q[:, None], nu[:, None])
    value = value.reshape(-1, len(intervals), 2)
    return np.asarray((value[..., 1] - value[..., 0]).sum(axis=1))


def chirp_over_rings(rings: tuple[Floats, ...], q: Floats, nu: Floats) -> Complex:
    """Return the transform of curved waves over an outline, shape (n,).

    The transform is the integral of exp(i pi (q1 x^2 + q2 y^2) - 2 pi i nu.x). ``q`` and ``nu``,
    shape (n, 2), contain the curvatures and the frequency of each result along both axes. ``rings``
    are polygons (m, 2), counter-clockwise, or clockwise for holes. The first curvature must have
    the larger magnitude. The origin must lie inside the bounding box of the outline.
    """
    begin = np.concatenate(rings)
    edge = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings]) - begin
    rises = edge[:, 1] != 0
    begin, edge = begin[rises], edge[rises]
    blocks = index_blocks(len(nu), _PAIRS // len(edge))
    return np.concatenate([_over_edges(begin, edge, q[block], nu[block]) for block in blocks])


def _over_edges(begin: Floats, edge: Floats, q: Floats, nu: Floats) -> Complex:
    """Return the transform of curved waves over the polygon inside the edges, shape (points,).

    ``begin`` and ``edge`` (edges, 2) are start points and vectors of the edges.
    """
    cycles = _edge_cycles(begin, edge, q, nu)
    pieces = np.ceil(cycles / _CYCLES).clip(1.0).astype(np.intp)
    points, edges = (np.repeat(n.ravel(), pieces.ravel()) for n in np.indices(cycles.shape))
    count = pieces[points, edges]
    last = np.cumsum(pieces.ravel())
    number = np.arange(len(points)) - np.repeat(last - pieces.ravel(), pieces.ravel())
    extent = edge[edges] / count[:, None]
    start = begin[edges] + extent * number[:, None]
    rules = _rule_indices(cycles[points, edges] / count)
    values = np.zeros(len(nu), np.complex128)
    for rule, members in _batches(rules):
        at, weights = gauss_rules()[rule].T[:2]
        for some in index_blocks(len(members), _BLOCK // len(at)):
            block = members[some]
            owners = points[block]
            integrand = _integrand(start[block], extent[block], at, q[owners], nu[owners])
            # For a matrix product, BLAS would start threads, which takes longer than the product.
            total = np.einsum("kn,n->k", integrand, weights)
            np.add.at(values, owners, total * (0.5 * extent[block, 1]))
    return values


def _edge_cycles(begin: Floats, edge: Floats, q: Floats, nu: Floats) -> Floats:
    """Return upper bounds on the cycles of phase along each edge, shape (points, edges).

    Raises ArgumentError above 1e5 cycles.
    """
    most = np.zeros((len(nu), len(edge)))
    for end in (begin, begin + edge):
        first, second = ((q[:, None, k] * end[:, k] - nu[:, None, k]) * edge[:, k] for k in (0, 1))
        most = np.maximum(most, np.maximum(abs(first + second), abs(second)))
    # Infinite and NaN bounds are ignored, because the results at their points are NaN.
    most = np.where(np.isfinite(most), most, 0.0)
    if (most > _MOST_CYCLES).any():
        raise ArgumentError(
            f"the phase of the curved wave changes by {most.max():.2g} cycles along an edge of the "
            f"outline, but at most {_MOST_CYCLES:.0e} are allowed; use lower frequencies, or "
            "points farther from the source and from its images behind an optical system"
        )
    return most


def _rule_indices(cycles: Floats) -> NDArray[np.intp]:
    """Return indices in :func:`gauss_rules` of rules for waves with ``cycles`` cycles of phase."""
    needed = 0.5 * math.pi * cycles + 8.0 * np.cbrt(cycles) + 4.0
    sizes = [len(rule) for rule in gauss_rules()[::_STRIDE]]
    return np.asarray(np.searchsorted(sizes, needed) * _STRIDE)


def _batches(rules: NDArray[np.intp]) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Yield the index of a rule and the indices of the pieces that it integrates.

    Small groups of pieces are combined with the group of the next larger rule.
    """
    present = np.unique(rules).tolist()
    members = np.zeros(0, np.intp)
    for rule in present:
        members = np.concatenate([members, np.flatnonzero(rules == rule)])
        if len(members) * len(gauss_rules()[rule]) >= _FEW or rule == present[-1]:
            yield rule, members
            members = members[:0]


def _integrand(start: Floats, extent: Floats, at: Floats, q: Floats, nu: Floats) -> Complex:
    """Return the integrand (k, n) of the contour integral at Gauss nodes on pieces of edges.

    ``at`` (n,) are nodes from -1 to 1. ``start`` and ``extent`` (k, 2) are the start points and
    the vectors of the pieces, and ``q`` and ``nu`` (k, 2) their curvatures and frequencies as
    in :func:`chirp_over_rings`. The result does not include the factor dy/d(at), half of the y
    component of ``extent``.
    """
    x, y = (start[:, k, None] + (0.5 + 0.5 * at) * extent[:, k, None] for k in (0, 1))
    (q1, q2), (nu1, nu2) = (values.T[:, :, None] for values in (q, nu))
    value = chirp_integral(x, q1, nu1)
    value *= waves_of_cycles(y * (0.5 * q2 * y - nu2))
    return value
