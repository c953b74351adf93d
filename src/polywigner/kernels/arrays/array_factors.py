"""Array factors: sums over the sites of an array, and over pairs of sites of a lattice.

The Fourier transform of an array is its element's transform times the sum of
w_k exp(-2 pi i nu.p_k) over the sites p_k (docs/theory.md, (L3)). On a lattice whose weights are a
product of two profiles it is the product of two sums, one along each direction; otherwise sites are
rows of a table.

W of equal elements on a lattice is a sum over midpoints of pairs of sites: W of the element there,
times the discrete Wigner function of the weights (L1). A is the same with differences for midpoints
(L2). For weights that are a product, so are these factors. Along one direction each is

    sum_k c_k exp(-2 pi i t (k - (N - 1)/2)),    0 <= k < N,

with products c_k of two amplitudes. For equal amplitudes the sum is sin(pi N t)/sin(pi t).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.arrays.repeated import HeldTable
from polywigner.kernels.kernel import Kernel, Values, leave_parts, leave_wave
from polywigner.numerics import Number, phases
from polywigner.numerics.complex_pairs import Pair, plane_wave
from polywigner.numerics.phases import cos_sin_turns, sin_turns
from polywigner.source.lattices import Profile, Sites, column_and_row, separated

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Pair2 = tuple[Any, Any]
Row = tuple[float, ...]

# Coefficients that one load reads.
_PACKET = 4
# Terms of a temporary array: a few tens of megabytes with its intermediates.
_BLOCK = 1 << 18


def partner(index: Any, number: Any, count: int, by_mean: bool) -> Any:
    """The other site of a pair, along a direction of ``count`` sites.

    ``number``, 0 to 2 count - 2: the sum of both indices, or their difference plus count - 1. In
    both cases there are count - |number - (count - 1)| pairs, and the waves of a factor are
    exp(-2 pi i t (index - number/2)) with t = 2 nu.b or upsilon.b.
    """
    return number - index if by_mean else index - number + (count - 1)


def _odd(ops: Any, number: Any) -> Number:
    """1 for odd numbers, 0 for even ones."""
    return abs(number - 2.0 * ops.round(0.5 * number))


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
            products: Complexes = a[site] * a[partner(site, number, self.count, by_mean)].conj()
            return products

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


def _dirichlet(ops: Any, count: Any, turns: Any) -> Number:
    """sum_k exp(-2 pi i turns (k - (count - 1)/2)), 0 <= k < count; 0 for count <= 0.

    sin(pi count t)/sin(pi t) with t reduced to half a turn: N t to an ulp of itself, so that the
    quotient errs by an ulp of N.
    """
    floor = 1e-30 if ops.double else 1e-20
    nearest = ops.round(turns)
    left = turns - nearest
    left = ops.select(abs(left) < floor, floor, left)
    quotient = sin_turns(ops, 0.5 * count * left) / sin_turns(ops, 0.5 * left)
    odd = _odd(ops, (count - 1.0) * nearest)
    return ops.select(count > 0.0, quotient * (1.0 - 2.0 * odd), 0.0 * turns)


@dataclass(frozen=True, eq=False)
class _Series:
    """Sums of cosines and sines, with coefficients by row and by term, from the centre outwards.

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
    ) -> Number:
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
    ``sine``: the factors of the last d and of the last b but one.
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
    """Rows of c_k = ``product(row, k)``, 0 <= k < length, about their centres."""
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


def factor_of(
    ops: Any, profiles: tuple[ProfileFactor, ProfileFactor], by_mean: bool, turns: Pair2
) -> Callable[[Pair2, Pair2], Pair]:
    """Return the factors of midpoints or differences at t = ``turns`` along both directions.

    As a function of steps from the first one and of numbers, along both directions.
    """
    one, two = (
        _remembered(partial(profile.at, ops, by_mean, turns=along))
        for profile, along in zip(profiles, turns, strict=True)
    )
    return lambda steps, numbers: one(steps[0], numbers[0]) * two(steps[1], numbers[1])


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


# ---- sites -----------------------------------------------------------------------------------

# Positions that miss a lattice by more than this fraction of its extent D are not computed as a
# lattice: the phase errs by 6e3 times that at |nu| D = 1000. Multiples of a pitch, counted from
# anywhere in the array, miss it by less; arrays far off the origin, by more.
_MISFIT = 2.0**-52
# Rows and columns may cross at up to this number of points for each site; others have weight 0.
_CROSSINGS_PER_SITE = 16
# Fewer sites are summed one by one: as fast, and compiled at once (benchmarks/array_cost.py).
_LEAST_SITES = 16


@dataclass(frozen=True)
class _Frame:
    """Phases are relative to the centre of the sites."""

    centre: tuple[phases.Doubled, ...]
    basis: tuple[tuple[float, ...], ...] = ()
    """Basis of the lattice; empty if sites are summed one by one."""
    content: float = 1.0


@dataclass(frozen=True)
class _Tables:
    frame: _Frame
    rows: tuple[tuple[Row, ...], ...] = ()
    """Tables of sites: position relative to the centre, each number as the sum of two floats, and
    weight. Two tables, for x and y of a grid of sites, whose sums are multiplied; none for a
    lattice."""
    factors: tuple[ProfileFactor, ...] = ()
    constant: complex = 1.0
    turns: tuple[float, ...] = ()

    @property
    def terms(self) -> int:
        return max(1, sum(map(len, self.rows)))


@lru_cache(maxsize=64)
def _tables(sites: Sites, double: bool) -> _Tables:
    lattice = sites.lattice if len(sites.positions) >= _LEAST_SITES else None
    profiles = None if lattice is None else separated(lattice.weights)
    if lattice is None or profiles is None:
        return _table_of_sites(sites, double)
    if lattice.misfit > _MISFIT:
        return _tables_of_axes(sites, double) or _table_of_sites(sites, double)
    centre = (Fraction(high) + Fraction(low) for high, low in lattice.middle)
    frame = _Frame(tuple(phases.doubled(c, double) for c in centre), lattice.basis)
    constant = complex(np.prod([profile.factor for profile in profiles]))
    for profile, count in zip(profiles, lattice.weights.shape, strict=True):
        # phases are 0 at the centre
        constant *= complex(np.exp(1j * np.pi * profile.cycles_per_element * (count - 1)))
    factors, turns = (
        map(profile_factor, profiles),
        (profile.cycles_per_element for profile in profiles),
    )
    return _Tables(frame, (), tuple(factors), constant, tuple(turns))


def _tables_of_axes(sites: Sites, double: bool) -> _Tables | None:
    """Return tables for sites where rows and columns cross, if the weights are a product."""
    x, i = np.unique(sites.positions[:, 0], return_inverse=True)
    y, j = np.unique(sites.positions[:, 1], return_inverse=True)
    if len(x) * len(y) > _CROSSINGS_PER_SITE * len(sites.positions):
        return None
    weights = np.zeros((len(x), len(y)), np.complex128)
    np.add.at(weights, (i.ravel(), j.ravel()), sites.weights)
    product = column_and_row(weights)
    if product is None:
        return None
    return _summed(((x[:, None], product[0]), (y[:, None], product[1])), double)


@lru_cache(maxsize=64)
def _table_of_sites(sites: Sites, double: bool) -> _Tables:
    return _summed(((sites.positions, sites.weights),), double)


def _summed(axes: tuple[tuple[Floats, Complexes], ...], double: bool) -> _Tables:
    """Return tables for positions (n, d) with their weights (n,)."""
    centre: list[phases.Doubled] = []
    tables = []
    for positions, weights in axes:
        low = positions.min(axis=0)
        offset = low + np.ptp(positions, axis=0) / 2
        centre += [phases.doubled(c, double) for c in offset.tolist()]
        rows = zip((positions - offset).tolist(), weights.tolist(), strict=True)
        tables.append(
            tuple(
                (*(part for c in site for part in phases.doubled(c, double)), w.real, w.imag)
                for site, w in rows
            )
        )
    return _Tables(_Frame(tuple(centre)), tuple(tables))


def _enter(ops: Any, frame: _Frame, *nu: Any) -> Values:
    turns = phases.turns_to_centre(ops, frame.centre, *nu)
    if not frame.basis:
        return (turns, *nu)
    # sites are half steps from the centre: nu.b counts modulo 2
    half = [0.5 * component for component in nu]
    return (turns, *(2.0 * phases.turns_to_centre(ops, b, *half) for b in frame.basis))


def _sum(ops: Any, tables: _Tables, turns: Any, *inner: Any) -> Values:
    if len(tables.rows) == 1:
        total = _sum_over_sites(ops, tables.rows[0], *inner)
    elif tables.rows:
        one, two = map(_sum_over_sites, (ops, ops), tables.rows, inner)
        total = one * two
    else:
        one, two = (
            factor.total(ops, along - turn)
            for factor, along, turn in zip(tables.factors, inner, tables.turns, strict=True)
        )
        total = one * two * Pair(tables.constant.real, tables.constant.imag)
    return total.real, -total.imag


def _sum_over_sites(ops: Any, rows: tuple[Row, ...], *nu: Any) -> Pair:
    def term(*row: Any) -> Values:
        *both, real, imag = row
        site = tuple(zip(both[0::2], both[1::2], strict=True))
        return phases.rotated(ops, phases.reduced(ops, phases.dot(ops, nu, site)), real, -imag)

    return Pair(*ops.sum_over(rows, term, 2, like=nu[0]))


def _enter_complex(ops: Any, frame: _Frame, *parts: Any) -> Values:
    """(real, imaginary) part of the phase of the centre; nu."""
    real, imag = parts[0::2], parts[1::2]
    turns = phases.turns_to_centre(ops, frame.centre, *real)
    growth, rest = phases.dot(ops, imag, frame.centre)
    return (turns, growth + rest, *real, *imag)


def _complex_sum(ops: Any, tables: _Tables, turns: Any, growth: Any, *nu: Any) -> Values:
    count = len(nu) // 2
    waves = [Pair(real, imag) for real, imag in zip(nu[:count], nu[count:], strict=True)]

    def term(*row: Any) -> tuple[Any, Any]:
        *both, real, imag = row
        phase = Pair(0.0, 0.0)
        for component, high, low in zip(waves, both[0::2], both[1::2], strict=True):
            phase = phase + component.scaled(high + low)
        wave = plane_wave(ops, phase) * Pair(real, imag)
        return wave.real, wave.imag

    total = Pair(*ops.sum_over(tables.rows[0], term, 2, like=nu[0]))
    total = total * plane_wave(ops, Pair(turns, growth))
    return total.real, total.imag


@lru_cache(maxsize=8)
def array_factor_kernel(dimension: int, is_complex: bool) -> Kernel:
    """The kernel of array factors of sites on a line, in the plane or in space."""
    if is_complex:
        steps = _table_of_sites, _enter_complex, _complex_sum, leave_parts
        return Kernel("array factor, complex nu", dimension, *steps)
    return Kernel("array factor", dimension, _tables, _enter, _sum, leave_wave)
