"""Divided differences of a plane wave: means over segments, triangles and tetrahedra.

The mean of exp(-2 pi i p) over a simplex with phases p_0, ..., p_n (in cycles) at its corners is n!
times the divided difference exp[z_0, ..., z_n] at z = -2 pi i p (Hermite and Genocchi). The divided
difference of first order is a sinc times a wave. A divided difference of higher order is the
quotient of two differences of the order below, at the two corners whose phases are farthest apart.
If all phases are close together, it is the Taylor series with complete homogeneous symmetric
polynomials h_k of the phases. No formula divides by a small number, so slivers and nu = 0 need no
special treatment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

from polywigner.numerics.complex_pairs import Pair, select
from polywigner.numerics.phases import cos_sin_cycles, mean_plane_wave

# Largest difference of phases, in cycles, for which the Taylor series of a divided difference is
# summed. For larger differences (0.63 rad and more) the recursion divides by at least 0.63, so
# errors grow by at most 1/0.63 per order.
_SERIES_BELOW = 0.1
# Number of terms of this Taylor series in double and in single precision. The first omitted term
# for triangles is (k+1) 0.63^k/(k+2)!: 2e-18 and 7e-9; for tetrahedra (k+1)(k+2)/2 0.63^k/(k+3)!:
# 1e-19 and 6e-9.
_TERMS_DOUBLE, _TERMS_SINGLE = 16, 9


def simplex_plane_wave(ops: Any, *corners: Any) -> tuple[Any, Any]:
    """Return exp[0, -2 pi i u, -2 pi i v, ...] for real phases u, v, ... in cycles.

    The result consists of two real numbers, the parts of ``cosine - i sine``. For n phases of zero
    the value is 1/n!. With n = 2 it is half of the mean of the wave over a triangle with phases 0,
    u, v at its corners; with n = 3 a sixth of the mean over a tetrahedron.
    """
    value = _conjugate_difference(ops, corners)
    return value.real, value.imag


def _conjugate_difference(ops: Any, corners: Sequence[Any]) -> Pair:
    """Return the complex conjugate of the divided difference at 0 and the corners."""
    if len(corners) == 1:
        return Pair(*mean_plane_wave(ops, 0.0, corners[0]))
    first, last, between, size = _farthest(ops, (0.0, *corners))
    small = size < _SERIES_BELOW
    if len(between) == 1:
        ahead = Pair(*mean_plane_wave(ops, between[0], last))
        behind = Pair(*mean_plane_wave(ops, first, between[0]))
    else:
        ahead, behind = _shifted(ops, last, between), _shifted(ops, first, between)
    divisor = 2 * math.pi * ops.select(small, 1.0, last - first)
    quotient = Pair((ahead.imag - behind.imag) / divisor, (behind.real - ahead.real) / divisor)
    # Arguments of the series are clamped to its range, so that the unused branch does not overflow.
    near = [ops.select(small, corner, 0.0) * (2 * math.pi) for corner in corners]
    return select(ops, small, _series(ops, near), quotient)


def _shifted(ops: Any, origin: Any, others: Sequence[Any]) -> Pair:
    """Return the conjugate divided difference at ``origin`` and the other phases."""
    phase = Pair(*cos_sin_cycles(ops, origin))
    return phase * _conjugate_difference(ops, [other - origin for other in others])


def _farthest(ops: Any, nodes: Sequence[Any]) -> tuple[Any, Any, list[Any], Any]:
    """Return the two nodes that are farthest apart, the other nodes, and the distance."""
    (first, last, *between), origin = nodes, nodes[0]
    largest = abs(last)

    def chosen(wins: Any, a: Any, b: Any) -> Any:
        return a if a is b else ops.select(wins, a, b)

    for i, j in list(combinations(range(len(nodes)), 2))[1:]:
        size = abs(nodes[j] if nodes[i] is origin else nodes[j] - nodes[i])
        wins = size > largest
        largest = ops.maximum(size, largest)
        first, last = chosen(wins, nodes[i], first), chosen(wins, nodes[j], last)
        others = [node for k, node in enumerate(nodes) if k not in (i, j)]
        between = [chosen(wins, a, b) for a, b in zip(others, between, strict=True)]
    return first, last, between, largest


def _series(ops: Any, nodes: Sequence[Any]) -> Pair:
    """Return sum_k i^k h_k/(k + n)! for n nodes in radians."""
    count = len(nodes)
    powers: list[Any] = [nodes[-1]]
    for node in nodes[-2::-1]:
        powers.append(node + powers[-1])
    sums = [1 / math.factorial(count), powers[-1] * (1 / math.factorial(count + 1))]
    for k in range(2, _TERMS_DOUBLE if ops.double else _TERMS_SINGLE):
        powers[0] = powers[0] * nodes[-1]
        for m, node in enumerate(nodes[-2::-1], start=1):
            powers[m] = ops.fma(node, powers[m], powers[m - 1])
        factor = (1.0 if k % 4 < 2 else -1.0) / math.factorial(k + count)
        sums[k % 2] = ops.fma(powers[-1], factor, sums[k % 2])
    return Pair(*sums)
