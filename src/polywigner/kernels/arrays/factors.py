"""Array factors in phase space: the pairs of sites of a lattice with one midpoint or difference.

For equal elements at the sites of a lattice, W is a sum over midpoints of pairs of sites of the
element's W there, times a factor: the discrete Wigner function of the weights at that midpoint
(docs/theory.md, (L1)). A is the same with differences for midpoints (L2); `partner` says how both
count. If the weights are a product of a profile along each direction, so are the factors, and along
one direction

    sum_k c_k exp(-2 pi i t (k - (N - 1)/2)),    0 <= k < N,

with products c_k of two amplitudes. For equal amplitudes that is sin(pi N t)/sin(pi t).

Factors of other weights have up to n1 n2 terms at a midpoint: trigonometric polynomials of 2 nu.b
along both directions, of the degree that the pairs of sites there give them. They are tabulated at
a somewhat higher rate, and interpolated: a non-uniform FFT of type 2. Factors of differences, which
turn half as fast, are complex: two tables. What a look-up costs is the memory that it touches, so
that a midpoint has as many samples as its own degree needs, and those of a look-up lie one after
the other: as many along the first direction as it takes, four each of the second. Where a table
would be too large, pairs are added up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.illumination.lattices import Profile
from polywigner.kernels.arrays.repeated import HeldTable
from polywigner.numerics.complex_pairs import Pair, unit_wave
from polywigner.numerics.phases import cos_sin_turns, sin_turns
from polywigner.numerics.polynomials import RATE, interpolation
from polywigner.plans import tabulates_products

Complexes = NDArray[np.complex128]
Pair2 = tuple[Any, Any]
Factor = Callable[[Pair2, Pair2, Any], Pair]
"""(steps from the first, numbers along both directions, whether they count) -> the factor."""

# Coefficients or samples that are read at a time: one load, where each alone would be another.
_PACKET = 4
# Terms of a temporary array: a few tens of megabytes with its intermediates.
_BLOCK = 1 << 18
# Larger tables are not made; the factors are then summed pair by pair.
_MOST_BYTES = 1 << 28


def partner(index: Any, number: Any, count: int, by_mean: bool) -> Any:
    """The other site of a pair, along a direction of so many sites.

    ``number``, 0 to 2 count - 2: the sum of both indices, or their difference plus count - 1. In
    both cases there are count - |number - (count - 1)| pairs, and the waves of a factor are
    exp(-2 pi i t (index - number/2)) with t = 2 nu.b or upsilon.b.
    """
    return number - index if by_mean else index - number + (count - 1)


def _odd(ops: Any, whole: Any) -> Any:
    """1 for odd numbers, 0 for even ones."""
    return abs(whole - 2.0 * ops.round(0.5 * whole))


# ---- profiles --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ProfileFactor:
    """The factors of a profile of n amplitudes."""

    profile: Profile

    @property
    def count(self) -> int:
        return len(self.profile.amplitudes)

    @cached_property
    def _amplitudes(self) -> Complexes:
        return np.array(self.profile.amplitudes, np.complex128)

    @cached_property
    def means(self) -> _Series:
        """By index sum, in the order of growing i - j."""
        return self._mutual(by_mean=True)

    @cached_property
    def differences(self) -> _Series:
        """By difference, in the order of growing i + j."""
        return self._mutual(by_mean=False)

    @cached_property
    def _all(self) -> _Series:
        """One row: the amplitudes themselves."""
        return _series(np.array([self.count]), lambda row, k: self._amplitudes[k])

    def _mutual(self, by_mean: bool) -> _Series:
        a, last = self._amplitudes, self.count - 1

        def product(number: NDArray[np.intp], k: NDArray[np.intp]) -> Complexes:
            site = np.maximum(0, number - last) + k
            found: Complexes = a[site] * a[partner(site, number, self.count, by_mean)].conj()
            return found

        return _series(self.count - abs(np.arange(2 * last + 1) - last), product)

    def at(self, ops: Any, by_mean: bool, number: Any, turns: Any) -> Pair:
        """The factor of a number of `partner` at t = ``turns``; real for means."""
        last = self.count - 1.0
        pairs = self.count - abs(number - last)
        if self.profile.is_uniform:
            return Pair(_dirichlet(ops, pairs, turns), 0.0)
        series = self.means if by_mean else self.differences
        return series.value(ops, number, 2.0 * last, pairs, turns)

    def total(self, ops: Any, turns: Any) -> Pair:
        """sum over i of a_i exp(-2 pi i turns (i - (n - 1)/2)); ``turns`` modulo 2."""
        count = float(self.count) + 0.0 * turns
        if self.profile.is_uniform:
            return Pair(_dirichlet(ops, count, turns), 0.0)
        return self._all.value(ops, 0.0 * turns, 0.0, count, turns)


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
    odd = _odd(ops, (count - 1.0) * whole)
    return ops.select(count > 0.0, quotient * (1.0 - 2.0 * odd), 0.0 * turns)


@dataclass(frozen=True, eq=False)
class _Series:
    """Sums of cosines and sines, coefficients by row and by term, from the middle outwards.

    In row r, p_k cos(2 pi t m_k) - i q_k sin(2 pi t m_k) with m_k = k or k + 1/2, p and q complex.
    A table of zeros only is None.
    """

    packets: int
    """Number of packets of a row."""
    tables: tuple[HeldTable | None, ...]
    """Real and imaginary part of p, then of q: (rows * packets of a row, terms of a packet)."""

    def value(self, ops: Any, row: Any, last: float, pairs: Any, turns: Any) -> Pair:
        """The sum of a row at ``turns``; 0 for rows that do not exist. ``pairs``: its length."""
        exists = (row >= 0.0) & (row <= last)
        # Whole numbers: in float32, those beyond 2^24 (rows of 8200 sites) would be rounded.
        known = ops.select(exists, row, 0.0)
        start, nil = ops.truncated(known) * self.packets, 0.0 * known + 0.0 * turns
        is_even = _odd(ops, ops.select(exists, pairs, 1.0)) < 0.5  # middles between two terms
        basis = _Basis(ops, turns, is_even)
        ends = (basis.cosine, basis.cosine, basis.sine, basis.sine)
        p_real, p_imag, q_real, q_imag = (
            self._sum(ops, basis, table, start, nil, end)
            for table, end in zip(self.tables, ends, strict=True)
        )
        real, imag = p_real + q_imag, p_imag - q_real
        zero = 0.0 * turns
        return Pair(ops.select(exists, real + zero, zero), ops.select(exists, imag + zero, zero))

    def _sum(
        self, ops: Any, basis: _Basis, table: HeldTable | None, start: Any, nil: Any, ends: Any
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


def _series(
    lengths: NDArray[np.intp], product: Callable[[NDArray[np.intp], NDArray[np.intp]], Complexes]
) -> _Series:
    """Rows of c_k = ``product(row, k)``, 0 <= k < length, about their middles."""
    count, terms = len(lengths), (int(lengths.max()) + 1) // 2
    packet = min(terms, _PACKET)
    packets = -(-terms // packet)
    p, q = np.zeros((2, count, packets * packet), np.complex128)
    k, size = np.arange(terms), max(1, _BLOCK // terms)
    for start in range(0, count, size):
        rows = np.arange(start, min(start + size, count))[:, None]
        n = lengths[rows]
        up, down = n // 2 + k, (n + 1) // 2 - 1 - k
        exists = down >= 0
        ahead = np.where(exists, product(rows, np.where(exists, up, 0)), 0.0)
        behind = np.where(exists, product(rows, np.where(exists, down, 0)), 0.0)
        p[rows, k], q[rows, k] = ahead + behind, ahead - behind
        odd = rows[n % 2 == 1]  # whose middle is one term
        p[odd, 0] /= 2
    tables = (_unless_zero(t, part, packet) for t in (p, q) for part in ("real", "imag"))
    return _Series(packets, tuple(tables))


def _unless_zero(values: Complexes, part: str, packet: int) -> HeldTable | None:
    parts: NDArray[np.float64] = getattr(values, part)
    if not (np.abs(parts) > 1e-17 * np.abs(values).max(initial=0.0)).any():
        return None
    return HeldTable(np.ascontiguousarray(parts).reshape(-1, packet))


# ---- tables of any weights -------------------------------------------------------------------


@dataclass(frozen=True)
class _Direction:
    """Along one direction, by midpoint or difference: how many samples a period has."""

    step: int
    """Samples that are read together, from multiples of so many on."""
    periods: tuple[float, ...]
    """Samples of a period."""
    starts: tuple[float, ...]
    """Samples of all before."""

    @property
    def total(self) -> float:
        return self.starts[-1] + self.periods[-1]

    def taps(self, ops: Any, number: Any, turns: Any) -> _Taps:
        """The samples that count at t = ``turns``."""
        row = ops.select((number >= 0.0) & (number < float(len(self.periods))), number, 0.0)
        period, start = (ops.lookup(values, row) for values in (self.periods, self.starts))
        kernel = interpolation(ops.double)
        middle = 0.5 * (kernel.width - 1)
        whole = ops.round(turns)
        u = (turns - whole) * period
        first = ops.round(u - middle)
        weights = kernel.weights(ops, 2.0 * (u - first - middle))
        if self.step > 1:
            first, weights = self._aligned(ops, first, weights)
        places, signed = [], []
        odd, frequency = _odd(ops, row), 1.0 / period
        for q in range(0, len(weights), self.step):
            place = first + float(q)
            periods = ops.round((place + 0.5) * frequency - 0.5)
            inner = place - periods * period
            # of a frequency that is no number the weights are none; the place must be in the table
            inner = ops.select(inner >= 0.0, inner, 0.0)
            places.append(ops.truncated(inner * (1 / self.step)))
            # an odd index sum has waves of half periods
            sign = 1.0 - 2.0 * (_odd(ops, periods + whole) * odd)
            signed += [sign * weight for weight in weights[q : q + self.step]]
        return signed, places, ops.truncated(period), ops.truncated(start)

    def _aligned(self, ops: Any, first: Any, weights: list[Any]) -> tuple[Any, list[Any]]:
        """From a multiple of the step on, with weights of 0 on either side."""
        step = self.step
        aligned = step * ops.round((first - 0.5 * (step - 1)) * (1 / step))
        left = first - aligned
        weights = weights + [0.0] * (-(len(weights) + step - 1) % step + step - 1)
        shift = step // 2
        while shift:  # the bits of what is left
            here = left >= float(shift)
            left = ops.select(here, left - float(shift), left)
            behind = [0.0] * shift + weights[:-shift]
            weights = [ops.select(here, b, w) for b, w in zip(behind, weights, strict=True)]
            shift //= 2
        return aligned, weights


_Taps = tuple[list[Any], list[Any], Any, Any]
"""Weights of samples, their places in a period in steps; the period, and where it begins."""


@dataclass(frozen=True, eq=False)
class FactorTable:
    """The factors of all midpoints or differences, prepared for interpolation."""

    directions: tuple[_Direction, _Direction]
    parts: tuple[HeldTable, ...]
    """Real part, and of differences the imaginary one, each (packets, 4): four samples along the
    second direction, and after them those of the next place along the first."""

    def at(self, ops: Any, counts: Any, taps: tuple[_Taps, _Taps]) -> Pair:
        """The factor; anything where it does not count, at little cost."""
        (weights, places, period, start), (others, columns, _, begin) = taps
        per_row = int(self.directions[1].total) // _PACKET
        block = start * per_row + begin // _PACKET * period
        # one place for all samples that want nothing
        rows = [ops.select_number(counts, block + place, 0) for place in places]
        step = ops.select_number(counts, period, 0)
        totals: list[Any] = []
        for part in self.parts:
            table, total = part.in_memory(ops), 0.0
            for k, place in enumerate(columns):
                lines: list[Any] = [0.0] * _PACKET
                for row, weight in zip(rows, weights, strict=True):
                    values = ops.gather(table, place * step + row)
                    lines = [ops.fma(v, weight, s) for v, s in zip(values, lines, strict=True)]
                for line, other in zip(lines, others[_PACKET * k :], strict=False):
                    total = ops.fma(line, other, total)
            totals.append(total)
        return Pair(totals[0], totals[1] if totals[1:] else 0.0)


def factor_table(weights: Complexes, by_mean: bool, double: bool) -> FactorTable | None:
    """The table of weights (n1, n2), or None if it would be too large."""
    if not fits_a_table(weights.shape, double, 1 if by_mean else 2):
        return None
    directions = first, second = _directions(weights.shape)
    dtype = np.dtype(np.float64 if double else np.float32)
    parts = ("real",) if by_mean else ("real", "imag")
    values = [np.empty(int(first.total * second.total), dtype) for _ in parts]
    ones, twos = (
        [_line(count, h, by_mean, int(period), double) for h, period in enumerate(d.periods)]
        for count, d in zip(weights.shape, directions, strict=True)
    )
    begin = 0
    for one in ones:
        for two in twos:
            samples = _samples(weights, one, two)
            samples = samples.reshape(len(samples), -1, _PACKET).swapaxes(0, 1)
            for table, part in zip(values, parts, strict=True):
                table[begin : begin + samples.size] = getattr(samples, part).ravel()
            begin += samples.size
    return FactorTable(directions, tuple(HeldTable(v.reshape(-1, _PACKET)) for v in values))


def fits_a_table(shape: tuple[int, ...], double: bool, parts: int = 1) -> bool:
    """Whether weights of a shape (n1, n2) have a table of so many parts, told without making it."""
    first, second = _directions(shape)
    return int(first.total * second.total) * (8 if double else 4) * parts <= _MOST_BYTES


def _directions(shape: tuple[int, ...]) -> tuple[_Direction, _Direction]:
    return _direction(shape[0], 1), _direction(shape[1], _PACKET)


def _direction(count: int, step: int) -> _Direction:
    pairs = count - abs(np.arange(2 * count - 1) - (count - 1))
    periods = np.ceil(RATE * pairs / step) * step
    starts = np.cumsum(periods) - periods
    return _Direction(step, tuple(periods.tolist()), tuple(starts.tolist()))


_Line = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64], Complexes]
"""Along one direction: sites, their partners, each pair's factor that undoes the interpolation, and
the wave of the first pair, from which an FFT counts, at each sample of a period."""


def _line(count: int, number: int, by_mean: bool, period: int, double: bool) -> _Line:
    sites = np.arange(max(0, number - count + 1), min(count - 1, number) + 1)
    kappa = (sites - number / 2) / period
    shifts: Complexes = np.exp(-2j * np.pi * kappa[0] * np.arange(period))
    gains: NDArray[np.float64] = np.reciprocal(interpolation(double).transform(kappa))
    return sites, partner(sites, number, count, by_mean), gains, shifts


def _samples(weights: Complexes, one: _Line, two: _Line) -> Complexes:
    """One period of a midpoint's factor along both directions.

    By FFT along one and the other, not by matrices of waves: those of a long row would take its
    length cubed in memory, and small products of matrices starve where threads share a processor.
    """
    mutual = weights[np.ix_(one[0], two[0])] * weights[np.ix_(one[1], two[1])].conj()
    gains, shifts = (one[2][:, None] * two[2]), (one[3][:, None], two[3])
    along = np.fft.fft(mutual * gains, len(shifts[1]), axis=1) * shifts[1]
    return np.fft.fft(along, len(shifts[0]), axis=0) * shifts[0]


# ---- all weights -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LatticeWeights:
    """The weights at the sites of a lattice, less their even phase."""

    values: Complexes
    """(n1, n2)"""
    profiles: tuple[ProfileFactor, ProfileFactor] | None
    """Where the weights are a product of two profiles."""

    @cached_property
    def _rows(self) -> tuple[tuple[float, ...], ...]:
        flat = self.values.ravel()
        return tuple(flat.real.tolist()), tuple(flat.imag.tolist())

    @cached_property
    def _tables(self) -> dict[tuple[bool, bool], FactorTable | None]:
        return {}

    def sums_pairs(self, double: bool) -> bool:
        """Whether a sample may add up all pairs of sites."""
        return self.profiles is None and not fits_a_table(self.values.shape, double)

    def _at(self, ops: Any, i: Any, j: Any) -> Pair:
        """The weight of a site; 0 where there is none."""
        rows, columns = self.values.shape
        exists = (i >= 0.0) & (i < float(rows)) & (j >= 0.0) & (j < float(columns))
        row, column = (ops.truncated(ops.select(exists, value, 0.0)) for value in (i, j))
        real, imag = (ops.lookup(table, row * columns + column) for table in self._rows)
        return Pair(ops.select(exists, real, 0.0), ops.select(exists, imag, 0.0))

    def factor(self, ops: Any, by_mean: bool, turns: Pair2) -> Factor:
        """The factors of midpoints or differences at t = ``turns`` along both directions."""
        table = self._table(by_mean, ops.double)
        if table is None and self.profiles is None:
            return lambda steps, numbers, counts: self._sum(ops, by_mean, numbers, turns)
        if table is None:
            assert self.profiles is not None
            one, two = (
                _remembered(partial(profile.at, ops, by_mean, turns=along))
                for profile, along in zip(self.profiles, turns, strict=True)
            )
            return lambda steps, numbers, _: one(steps[0], numbers[0]) * two(steps[1], numbers[1])
        return self._looked_up(ops, table, turns)

    def _table(self, by_mean: bool, double: bool) -> FactorTable | None:
        """The factors as a table, if that is the best way."""
        amplitudes = None
        if self.profiles is not None:
            amplitudes = sum(f.count for f in self.profiles if not f.profile.is_uniform)
        if not tabulates_products(self.values.size, amplitudes):
            return None
        if (by_mean, double) not in self._tables:
            self._tables[by_mean, double] = factor_table(self.values, by_mean, double)
        return self._tables[by_mean, double]

    def _looked_up(self, ops: Any, table: FactorTable, turns: Pair2) -> Factor:
        first, second = (
            _remembered(partial(direction.taps, ops, turns=along))
            for direction, along in zip(table.directions, turns, strict=True)
        )
        last = [2.0 * (n - 1) for n in self.values.shape]

        def factor(steps: Pair2, numbers: Pair2, counts: Any) -> Pair:
            for number, most in zip(numbers, last, strict=True):
                counts = counts & (number >= 0.0) & (number <= most)
            taps = first(steps[0], numbers[0]), second(steps[1], numbers[1])
            found = table.at(ops, counts, taps)
            return Pair(ops.select(counts, found.real, 0.0), ops.select(counts, found.imag, 0.0))

        return factor

    def _sum(self, ops: Any, by_mean: bool, numbers: Pair2, turns: Pair2) -> Pair:
        """The factor of weights that are no product, by adding up all pairs."""
        counts = self.values.shape
        like = 0.0 * numbers[0]

        def term(i: Any, j: Any) -> tuple[Any, Any]:
            sites = i + like, j + like
            others = (
                partner(site, number, count, by_mean)
                for site, number, count in zip(sites, numbers, counts, strict=True)
            )
            one, other = self._at(ops, *sites), self._at(ops, *others)
            phase = (i - 0.5 * numbers[0]) * turns[0] + (j - 0.5 * numbers[1]) * turns[1]
            pair = one * other.conjugate() * unit_wave(ops, phase).conjugate()
            return pair.real, pair.imag

        sites = [(float(i), float(j)) for i in range(counts[0]) for j in range(counts[1])]
        return Pair(*ops.sum_over(sites, term, 2, like=numbers[0]))


def _remembered(compute: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    """``compute`` of the second argument, once for every constant that comes first."""
    known: dict[float, Any] = {}

    def of(step: Any, argument: Any) -> Any:
        if not isinstance(step, float):  # a row of an engine's table
            return compute(argument)
        if step not in known:
            known[step] = compute(argument)
        return known[step]

    return of
