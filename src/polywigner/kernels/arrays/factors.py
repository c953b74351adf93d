"""Array factors in phase space: what pairs of sites of a lattice contribute at one midpoint.

For equal elements at the sites of a lattice, W is a sum over midpoints of pairs of sites of the
element's W there, times a factor: the discrete Wigner function of the weights at that midpoint
(docs/theory.md, (L1)). A is the same with differences for midpoints (L2). If the weights are a
product of a profile along each direction, so are the factors, and along one direction

    sum_k c_k exp(-2 pi i t (k - (N - 1)/2)),    0 <= k < N,

with products c_k of two amplitudes. For equal amplitudes that is sin(pi N t)/sin(pi t).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.illumination.lattices import Profile
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns, sin_turns

__all__ = ["ProfileFactor", "profile_factor"]

Complexes = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Coefficients that are read at a time: one load, where each alone would be another.
_PACKET = 4
# Terms of a temporary array: a few tens of megabytes with its intermediates.
_BLOCK = 1 << 18


@dataclass(frozen=True, eq=False)
class ProfileFactor:
    """The factors of a profile of n amplitudes, by midpoint (index sum) and by difference."""

    profile: Profile

    @property
    def count(self) -> int:
        return len(self.profile.amplitudes)

    @cached_property
    def means(self) -> _Series | None:
        """For index sums 0 .. 2n - 2, in the order of growing i - j; None if uniform."""
        n, sums = self.count, np.arange(2 * self.count - 1)
        return self._mutual(np.maximum(0, sums - n + 1), np.minimum(sums, n - 1), -1)

    @cached_property
    def differences(self) -> _Series | None:
        """For i - j = -(n - 1) .. n - 1, in the order of growing i + j; None if uniform."""
        apart = np.arange(1 - self.count, self.count)
        return self._mutual(np.maximum(0, apart), np.maximum(0, -apart), 1)

    @cached_property
    def amplitudes(self) -> _Series | None:
        """One row: the amplitudes themselves; None if uniform."""
        if self.profile.is_uniform:
            return None
        own, zero = np.array(self.profile.amplitudes, np.complex128), np.zeros(1, np.intp)
        return _series(_Rows(own, np.ones_like(own), zero, zero, 1, np.array([self.count])))

    def _mutual(self, begin: Indices, other: Indices, step: int) -> _Series | None:
        if self.profile.is_uniform:
            return None
        own = np.array(self.profile.amplitudes, np.complex128)
        lengths = self.count - abs(np.arange(2 * self.count - 1) - (self.count - 1))
        return _series(_Rows(own, own.conj(), begin, other, step, lengths))

    def at_mean(self, ops: Any, index_sum: Any, turns: Any) -> Any:
        """sum over i + j = index_sum of a_i a_j* exp(-2 pi i turns (i - j)), which is real."""
        last = 2.0 * (self.count - 1)
        pairs = ops.minimum(index_sum, last - index_sum) + 1.0
        twice = turns + turns
        if self.means is None:
            return _dirichlet(ops, pairs, twice)
        return self.means.value(ops, index_sum, last, pairs, twice).real

    def at_difference(self, ops: Any, difference: Any, turns: Any) -> Pair:
        """sum over i - j = difference of a_i a_j* exp(-2 pi i turns ((i + j)/2 - (n - 1)/2))."""
        pairs = self.count - abs(difference)
        if self.differences is None:
            return Pair(_dirichlet(ops, pairs, turns), 0.0)
        last = 2.0 * (self.count - 1)
        index = difference + (self.count - 1.0)
        return self.differences.value(ops, index, last, pairs, turns)

    def total(self, ops: Any, turns: Any) -> Pair:
        """sum over i of a_i exp(-2 pi i turns (i - (n - 1)/2)); ``turns`` modulo 2."""
        count = float(self.count) + 0.0 * turns
        if self.amplitudes is None:
            return Pair(_dirichlet(ops, count, turns), 0.0)
        return self.amplitudes.value(ops, 0.0 * turns, 0.0, count, turns)


@lru_cache(maxsize=64)
def profile_factor(profile: Profile) -> ProfileFactor:
    """The factors of a profile, less its factor and its even phase."""
    return ProfileFactor(profile)


def _dirichlet(ops: Any, count: Any, turns: Any) -> Any:
    """sum_k exp(-2 pi i turns (k - (count - 1)/2)), 0 <= k < count; 0 for count <= 0.

    sin(pi count t)/sin(pi t) with t reduced to half a turn: N t to an ulp of itself, so that the
    quotient errs by an ulp of N.
    """
    floor = 1e-30 if ops.double else 1e-20
    whole = ops.round(turns)
    left = turns - whole
    left = ops.select(abs(left) < floor, floor, left)
    quotient = sin_turns(ops, 0.5 * count * left) / sin_turns(ops, 0.5 * left)
    odd = (count - 1.0) * whole
    odd = abs(odd - 2.0 * ops.round(0.5 * odd))
    return ops.select(count > 0.0, quotient * (1.0 - 2.0 * odd), 0.0 * turns)


@dataclass(frozen=True, eq=False)
class _Table:
    """Coefficients by row and by term, as packets (rows * packets of a row, terms of one)."""

    values: NDArray[np.float64]
    held: dict[Hashable, Any] = field(default_factory=dict)

    def in_memory(self, ops: Any) -> Any:
        """In an engine's memory."""
        if ops.key not in self.held:
            self.held[ops.key] = ops.held(self.values)
        return self.held[ops.key]


@dataclass(frozen=True, eq=False)
class _Series:
    """Sums of cosines and sines, coefficients by row and by term, from the middle outwards.

    In row r, p_k cos(2 pi t m_k) - i q_k sin(2 pi t m_k) with m_k = k or k + 1/2, p and q complex.
    A table of zeros only is None.
    """

    packets: int
    """Number of packets of a row."""
    p_real: _Table | None
    p_imag: _Table | None
    q_real: _Table | None
    q_imag: _Table | None

    def value(self, ops: Any, row: Any, last: float, pairs: Any, turns: Any) -> Pair:
        """The sum of a row at ``turns``; 0 for rows that do not exist. ``pairs``: its length."""
        exists = (row >= 0.0) & (row <= last)
        # Whole numbers: in float32, those beyond 2^24 (rows of 8200 sites) would be rounded.
        known = ops.select(exists, row, 0.0)
        start, nil = ops.truncated(known) * self.packets, 0.0 * known + 0.0 * turns
        is_even = ops.select(exists, pairs, 1.0)
        is_even = abs(is_even - 2.0 * ops.round(0.5 * is_even)) < 0.5  # middles between two terms
        basis = _Basis(ops, turns, is_even)
        p_real = self._sum(ops, basis, self.p_real, start, nil, basis.cosine)
        p_imag = self._sum(ops, basis, self.p_imag, start, nil, basis.cosine)
        q_real = self._sum(ops, basis, self.q_real, start, nil, basis.sine)
        q_imag = self._sum(ops, basis, self.q_imag, start, nil, basis.sine)
        real, imag = p_real + q_imag, p_imag - q_real
        zero = 0.0 * turns
        return Pair(ops.select(exists, real + zero, zero), ops.select(exists, imag + zero, zero))

    def _sum(
        self, ops: Any, basis: _Basis, table: _Table | None, start: Any, nil: Any, ends: Any
    ) -> Any:
        if table is None:
            return 0.0
        memory, last = table.in_memory(ops), start + (self.packets - 1)

        def step(packet: Any, after: Any, b: Any, d: Any) -> tuple[Any, ...]:
            for coefficient in reversed(ops.gather(memory, last - packet)):
                after = b
                d = ops.fma(basis.slope, b, ops.fma(basis.sign, d, coefficient))
                b = ops.fma(basis.sign, b, d)
            return after, b, d

        after, _, d = ops.repeated(self.packets, (nil, nil, nil), step, basis.slope)
        first, second = ends
        return first * d + second * after


class _Basis:
    """Clenshaw's recursion in Reinsch's form for cosines and sines of whole or half multiples.

    Stable where the plain form loses n^2 ulps, at whole turns and at half ones. ``cosine`` and
    ``sine``: what the last d and the last but one b are multiplied with.
    """

    def __init__(self, ops: Any, turns: Any, half: Any) -> None:
        cos_half, sin_half = cos_sin_turns(ops, 0.5 * turns)
        cosine = cos_half * cos_half - sin_half * sin_half
        ahead = cosine >= 0.0
        self.sign = ops.select(ahead, 1.0, -1.0)
        self.slope = ops.select(ahead, -4.0 * sin_half * sin_half, 4.0 * cos_half * cos_half)
        self.cosine = (
            ops.select(half, cos_half, 1.0),
            ops.select(half, ops.select(ahead, 0.0, -2.0 * cos_half), -0.5 * self.slope),
        )
        self.sine = (
            ops.select(half, sin_half, 0.0),
            ops.select(half, ops.select(ahead, 2.0 * sin_half, 0.0), 2.0 * sin_half * cos_half),
        )


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of one[begin + m] other[begin_other + step m], 0 <= m < length."""

    one: Complexes
    other: Complexes
    begin: Indices
    begin_other: Indices
    step: int
    lengths: Indices

    def terms(self, rows: slice, number: Indices) -> Complexes:
        """Packets of a number (rows, terms), 0 where a row has none."""
        exists = (number >= 0) & (number < self.lengths[rows, None])
        m = np.where(exists, number, 0)
        found: Complexes = self.one[self.begin[rows, None] + m]
        found = found * self.other[self.begin_other[rows, None] + self.step * m]
        return np.where(exists, found, 0.0)


def _series(rows: _Rows) -> _Series:
    """Rows of c_k in the order of growing multiples, symmetric about 0."""
    count, terms = len(rows.lengths), (int(rows.lengths.max()) + 1) // 2
    packet = min(terms, _PACKET)
    packets = -(-terms // packet)
    p, q = np.zeros((2, count, packets * packet), np.complex128)
    k, size = np.arange(terms), max(1, _BLOCK // terms)
    for block in (slice(start, start + size) for start in range(0, count, size)):
        n = rows.lengths[block, None]
        up, down = rows.terms(block, n // 2 + k), rows.terms(block, (n + 1) // 2 - 1 - k)
        p[block, :terms], q[block, :terms] = up + down, up - down
        odd = np.flatnonzero(n % 2) + block.start  # whose middle is one term
        p[odd, 0] /= 2
    tables = (_unless_zero(t, part, packet) for t in (p, q) for part in ("real", "imag"))
    return _Series(packets, *tables)


def _unless_zero(values: Complexes, part: str, packet: int) -> _Table | None:
    parts: NDArray[np.float64] = getattr(values, part)
    if not (np.abs(parts) > 1e-17 * np.abs(values).max(initial=0.0)).any():
        return None
    return _Table(np.ascontiguousarray(parts).reshape(-1, packet))
