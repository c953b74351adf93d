"""Divided differences of a wave of orders 1 to 3: means over segments, triangles, tetrahedra.

Over a simplex with phases p_0, ..., p_n (in turns) at its corners the mean of exp(-2 pi i p) is n!
times exp[z_0, ..., z_n] at z = -2 pi i p (Hermite and Genocchi). The first order is a sinc times a
wave. A higher one is the quotient of two of the order below, at the two corners whose phases lie
farthest apart; or where all lie close together its Taylor series, with complete homogeneous
symmetric polynomials h_k of the phases. So nothing is divided by a small number, and slivers and
nu = 0 are no special cases.

One recursion serves real phases and complex ones (evanescent waves): `_Real` and `_Complex` contain
the operations on either kind of number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

from polywigner.numerics import Number
from polywigner.numerics.complex_pairs import Pair, mean_wave, plane_wave, select
from polywigner.numerics.phases import cos_sin_turns, mean_plane_wave

# Below this largest separation (in turns; 0.63 rad) the Taylor series is summed; above it the
# recursion divides by at least that, and loses at most a factor 1/0.63 of accuracy an order.
_SERIES_BELOW = 0.1
# First omitted term of the series at k = 16 and 9, for triangles (k+1) 0.63^k/(k+2)!: 2e-18 and
# 7e-9; for tetrahedra (k+1)(k+2)/2 0.63^k/(k+3)!: 1e-19 and 6e-9.
_TERMS_DOUBLE, _TERMS_SINGLE = 16, 9


def simplex_plane_wave(ops: Any, *corners: Any) -> tuple[Any, Any]:
    """exp[0, -2 pi i u, -2 pi i v, ...] for real phases u, v, ... in turns, as (cosine, sine) part.

    The value is ``cosine - i sine``; 1/n! for n corners at zero. n = 2 is half a wave's mean over a
    triangle with phases 0, u, v at its corners, n = 3 a sixth of that over a tetrahedron.
    """
    value = _over_simplex(ops, _Real, corners, 0.0)
    return value.real, value.imag


def simplex_complex_wave(ops: Any, *corners: Pair, level: Any = 0.0) -> Pair:
    """exp[0, -2 pi i u, -2 pi i v, ...] exp(-2 pi level) for complex phases u, v, ... in turns."""
    return _over_simplex(ops, _Complex, corners, level)


def _over_simplex(ops: Any, kind: Any, corners: Sequence[Any], level: Any) -> Pair:
    """The divided difference at 0 and the corners; of real phases its conjugate."""
    if len(corners) == 1:
        return kind.mean(ops, kind.origin, corners[0], level)
    first, last, between, size = _farthest(ops, kind, (kind.origin, *corners))
    small = size < kind.size_of(_SERIES_BELOW)
    if len(between) == 1:
        ahead = kind.mean(ops, between[0], last, level)
        behind = kind.mean(ops, first, between[0], level)
    else:
        ahead = _shifted(ops, kind, last, between, level)
        behind = _shifted(ops, kind, first, between, level)
    quotient = kind.quotient(ops, small, ahead, behind, last - first)
    # the series sees arguments clamped to its domain: no overflow in the branch not taken
    near = [kind.select(ops, small, corner, kind.origin) * (2 * math.pi) for corner in corners]
    return select(ops, small, kind.total(ops, *_series(ops, kind, near), level), quotient)


def _shifted(ops: Any, kind: Any, origin: Any, others: Sequence[Any], level: Any) -> Pair:
    """The divided difference at ``origin`` and the others, relative to the former."""
    phase, level = kind.phase_and_level(ops, origin, level)
    return phase * _over_simplex(ops, kind, [other - origin for other in others], level)


def _farthest(ops: Any, kind: Any, nodes: Sequence[Any]) -> tuple[Any, Any, list[Any], Any]:
    """The two nodes that lie farthest apart, the others, and the size of their difference."""
    (first, last, *between), origin = nodes, nodes[0]
    largest = kind.size(last)

    def chosen(wins: Any, a: Any, b: Any) -> Any:
        return a if a is b else kind.select(ops, wins, a, b)

    for i, j in list(combinations(range(len(nodes)), 2))[1:]:
        size = kind.size(nodes[j] if nodes[i] is origin else nodes[j] - nodes[i])
        wins = size > largest
        largest = ops.maximum(size, largest)
        first, last = chosen(wins, nodes[i], first), chosen(wins, nodes[j], last)
        others = [node for k, node in enumerate(nodes) if k not in (i, j)]
        between = [chosen(wins, a, b) for a, b in zip(others, between, strict=True)]
    return first, last, between, largest


def _series(ops: Any, kind: Any, nodes: Sequence[Any]) -> tuple[Any, Any]:
    """sum_k i^k h_k/(k + n)! of n nodes in radians: terms of even k, and of odd k over i."""
    count = len(nodes)
    powers: list[Any] = [nodes[-1]]  # h_k of the last node, of the last two, ...
    for node in nodes[-2::-1]:
        powers.append(node + powers[-1])
    sums = [kind.unit * (1 / math.factorial(count)), powers[-1] * (1 / math.factorial(count + 1))]
    for k in range(2, _TERMS_DOUBLE if ops.double else _TERMS_SINGLE):
        powers[0] = powers[0] * nodes[-1]
        for m, node in enumerate(nodes[-2::-1], start=1):
            powers[m] = _fma(ops, node, powers[m], powers[m - 1])
        factor = (1.0 if k % 4 < 2 else -1.0) / math.factorial(k + count)
        sums[k % 2] = _fma(ops, powers[-1], factor, sums[k % 2])
    return sums[0], sums[1]


def _fma(ops: Any, a: Any, b: Any, c: Any) -> Any:
    return a * b + c if isinstance(a, Pair) else ops.fma(a, b, c)


class _Real:
    """Real phases, floats or arrays; of the value, the conjugate: cosine + i sine."""

    origin, unit = 0.0, 1.0

    @staticmethod
    def size(value: Any) -> Number:
        return abs(value)

    @staticmethod
    def size_of(length: float) -> float:
        return length

    @staticmethod
    def select(ops: Any, condition: Any, a: Any, b: Any) -> Any:
        return ops.select(condition, a, b)

    @staticmethod
    def mean(ops: Any, start: Any, end: Any, level: Any) -> Pair:
        return Pair(*mean_plane_wave(ops, start, end))

    @staticmethod
    def phase_and_level(ops: Any, turns: Any, level: Any) -> tuple[Pair, Any]:
        return Pair(*cos_sin_turns(ops, turns)), level

    @staticmethod
    def quotient(ops: Any, small: Any, ahead: Pair, behind: Pair, distance: Any) -> Pair:
        """(ahead - behind)/(2 pi i distance)."""
        divisor = 2 * math.pi * ops.select(small, 1.0, distance)
        return Pair((ahead.imag - behind.imag) / divisor, (behind.real - ahead.real) / divisor)

    @staticmethod
    def total(ops: Any, even: Any, odd: Any, level: Any) -> Pair:
        return Pair(even, odd)


class _Complex:
    """Complex phases as pairs, whose sizes are squared."""

    origin, unit = Pair(0.0, 0.0), Pair(1.0, 0.0)

    @staticmethod
    def size(value: Pair) -> Number:
        return value.norm()

    @staticmethod
    def size_of(length: float) -> float:
        return length**2

    @staticmethod
    def select(ops: Any, condition: Any, a: Pair, b: Pair) -> Pair:
        return select(ops, condition, a, b)

    @staticmethod
    def mean(ops: Any, start: Pair, end: Pair, level: Any) -> Pair:
        return mean_wave(ops, start, end, level)

    @staticmethod
    def phase_and_level(ops: Any, turns: Pair, level: Any) -> tuple[Pair, Any]:
        return plane_wave(ops, Pair(turns.real, 0.0)), level - turns.imag

    @staticmethod
    def quotient(ops: Any, small: Any, ahead: Pair, behind: Pair, distance: Pair) -> Pair:
        """(ahead - behind)/(-2 pi i distance)."""
        safe = select(ops, small, Pair(1.0, 0.0), distance)
        return (ahead - behind) / (safe * Pair(0.0, -2 * math.pi))

    @staticmethod
    def total(ops: Any, even: Pair, odd: Pair, level: Any) -> Pair:
        """even - i odd, times exp(-2 pi level)."""
        value = Pair(even.real + odd.imag, even.imag - odd.real)
        return value.scaled(ops.exp(-2 * math.pi * level))
