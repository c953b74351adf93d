"""Array factors of arrays with arbitrary element positions, and of arrays on a lattice.

The array factor of F is the sum of w_k exp(-2 pi i nu.p_k) over elements with weights w_k and
positions p_k, (L3) of docs/theory.md. For W and A of a lattice, array factors are sums over pairs
of elements with the same midpoint (L1) or difference (L2). If the weights are a product of two
profiles, the array factor is a product of two sums of N terms, one sum for each lattice direction:

    sum_k c_k exp(-2 pi i t (k - (N - 1)/2)),    0 <= k < N,

where t is a frequency in cycles per period. For c_k = 1 the sum is sin(pi N t)/sin(pi t).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.element_pairs import DeviceTable
from polywigner.kernels.functions.fourier import LinearFrame
from polywigner.kernels.kernel import Kernel, Values, leave_wave, wave_sums
from polywigner.numerics import Complex, Number, phases
from polywigner.numerics.phases import Pair, cos_sin_cycles, sin_cycles
from polywigner.source.lattices import Profile, Sites, separated

Pair2 = tuple[Any, Any]
Row = tuple[float, ...]

# Number of coefficients that Dr.Jit reads with one load instruction.
_PACKET = 4
# Largest number of terms in a temporary array. The array and its intermediate results then take
# some tens of megabytes.
_BLOCK = 1 << 18


def _odd(ops: Any, number: Any) -> Number:
    """Return 1 for an odd integer and 0 for an even integer, as floats."""
    return abs(number - 2.0 * ops.round(0.5 * number))


@dataclass(frozen=True, eq=False)
class ProfileFactor:
    """Array factors along one lattice direction, for the amplitudes of a profile.

    The array factors do not include the constant factor and the phase of the profile.
    """

    profile: Profile

    @property
    def count(self) -> int:
        """Number of elements along the lattice direction."""
        return len(self.profile.amplitudes)

    @cached_property
    def _amplitudes(self) -> Complex:
        """Amplitudes of the profile, shape (count,)."""
        return np.array(self.profile.amplitudes, np.complex128)

    @cached_property
    def means(self) -> _Series:
        """Products a_i a_j* of two amplitudes, with one row for each sum i + j."""
        return self._products(by_mean=True)

    @cached_property
    def differences(self) -> _Series:
        """Products a_i a_j* of two amplitudes, with one row for each difference i - j."""
        return self._products(by_mean=False)

    @cached_property
    def _all(self) -> _Series:
        """Amplitudes of all elements, as coefficients of a sum with a single row."""
        return _series(np.array([self.count]), lambda row, k: self._amplitudes[k])

    def _products(self, by_mean: bool) -> _Series:
        """Return the products a_i a_j* with one row for each i + j (``by_mean``) or i - j."""
        a, last = self._amplitudes, self.count - 1

        def product(number: NDArray[np.intp], k: NDArray[np.intp]) -> Complex:
            """Return term ``k`` of row ``number``."""
            site = np.maximum(0, number - last) + k
            other = number - site if by_mean else site - number + last
            return np.asarray(a[site] * a[other].conj())

        return _series(self.count - abs(np.arange(2 * last + 1) - last), product)

    def at(self, ops: Any, by_mean: bool, number: Any, cycles: Any) -> Pair:
        """Return the sum of a_i a_j* exp(-2 pi i t s) over all pairs with the same ``number``.

        If ``by_mean`` is true, ``number`` is i + j, and s is (i - j)/2. If it is false, ``number``
        is i - j + N - 1, and s is (i + j - N + 1)/2. ``cycles`` is t, a frequency in cycles per
        period.
        """
        last = self.count - 1.0
        pairs = self.count - abs(number - last)
        if self.profile.is_uniform:
            return Pair(_dirichlet(ops, pairs, cycles), 0.0)
        series = self.means if by_mean else self.differences
        return series.value(ops, number, 2.0 * last, pairs, cycles)

    def total(self, ops: Any, cycles: Any) -> Pair:
        """Return the sum of a_k exp(-2 pi i t (k - (N - 1)/2)) over the N amplitudes a_k.

        ``cycles`` is t, a frequency in cycles per period, modulo 2.
        """
        count = float(self.count) + 0.0 * cycles
        if self.profile.is_uniform:
            return Pair(_dirichlet(ops, count, cycles), 0.0)
        return self._all.value(ops, 0.0 * cycles, 0.0, count, cycles)


profile_factor = lru_cache(maxsize=64)(ProfileFactor)


def _dirichlet(ops: Any, count: Any, cycles: Any) -> Number:
    """Return the array factor sin(pi N t)/sin(pi t) of N = ``count`` equal amplitudes of 1."""
    floor = 1e-30 if ops.double else 1e-20
    nearest = ops.round(cycles)
    remainder = cycles - nearest
    remainder = ops.select(abs(remainder) < floor, floor, remainder)
    quotient = sin_cycles(ops, 0.5 * count * remainder) / sin_cycles(ops, 0.5 * remainder)
    odd = _odd(ops, (count - 1.0) * nearest)
    return ops.select(count > 0.0, quotient * (1.0 - 2.0 * odd), 0.0 * cycles)


@dataclass(frozen=True, eq=False)
class _Series:
    """Trigonometric sums, one for each row of a table of coefficients.

    The sum of a row consists of the terms p_k cos(2 pi t m_k) - i q_k sin(2 pi t m_k) with complex
    coefficients p_k and q_k. The multiple m_k is k for an odd number of terms, and k + 1/2 for an
    even number.
    """

    packets: int
    tables: tuple[DeviceTable | None, ...]
    """Coefficients Re p, Im p, Re q and Im q. An entry is None if all its coefficients are zero."""

    def value(self, ops: Any, row: Any, last: float, pairs: Any, cycles: Any) -> Pair:
        """Return the trigonometric sum of a row at t = ``cycles``, or 0 if the row does not exist.

        ``last`` is the index of the last row, and ``pairs`` the number of terms of the row.
        """
        exists = (row >= 0.0) & (row <= last)
        # The index of a packet is a product of integers, because float32 rounds integers above
        # 2^24. Tables for more than 8,200 elements have more than 2^24 packets.
        known = ops.select(exists, row, 0.0)
        start, nil = ops.truncated(known) * self.packets, 0.0 * known + 0.0 * cycles
        is_even = _odd(ops, ops.select(exists, pairs, 1.0)) < 0.5
        basis = _Basis(ops, cycles, is_even)
        ends = (basis.cosine, basis.cosine, basis.sine, basis.sine)
        p_real, p_imag, q_real, q_imag = (
            self._sum(ops, basis, table, start, nil, end)
            for table, end in zip(self.tables, ends, strict=True)
        )
        real, imag = p_real + q_imag, p_imag - q_real
        zero = 0.0 * cycles
        return Pair(ops.select(exists, real + zero, zero), ops.select(exists, imag + zero, zero))

    def _sum(
        self, ops: Any, basis: _Basis, table: DeviceTable | None, start: Any, nil: Any, ends: Any
    ) -> Number:
        """Return the sums of the rows of a table from packet ``start`` on, by Clenshaw's method.

        ``ends`` contains the factors of the last two states of the recurrence. These factors differ
        between sums of cosines and sums of sines.
        """
        if table is None:
            return 0.0
        memory, last = table.in_memory(ops), start + (self.packets - 1)

        def step(packet: Any, previous: Any, b: Any, d: Any) -> tuple[Any, ...]:
            """Return the state of the recurrence after one more packet of coefficients."""
            for coefficient in reversed(ops.gather(memory, last - packet)):
                previous = b
                d = ops.fma(basis.slope, b, ops.fma(basis.sign, d, coefficient))
                b = ops.fma(basis.sign, b, d)
            return previous, b, d

        previous, _, d = ops.repeated(self.packets, (nil, nil, nil), step, basis.slope)
        first, second = ends
        return first * d + second * previous


class _Basis:
    """Clenshaw's recurrence for sums of cosines and sines, in Reinsch's form.

    Near multiples of half a cycle, Clenshaw's original form loses n^2 ulps in a sum of n terms.
    """

    def __init__(self, ops: Any, cycles: Any, half: Any) -> None:
        """Prepare sums at t = ``cycles``, with multiples k + 1/2 if ``half`` is true, else k."""
        cos_half, sin_half = cos_sin_cycles(ops, 0.5 * cycles)
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
    lengths: NDArray[np.intp], product: Callable[[NDArray[np.intp], NDArray[np.intp]], Complex]
) -> _Series:
    """Return trigonometric sums; row r has ``lengths[r]`` coefficients ``product(r, k)``."""
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
        # In a row of odd length, the central term is its own mirror image, so it was added twice.
        odd = rows[n % 2 == 1]
        p[odd, 0] /= 2
    tables = (_table_of_part(t, part, packet) for t in (p, q) for part in ("real", "imag"))
    return _Series(packets, tuple(tables))


def _table_of_part(values: Complex, part: str, packet: int) -> DeviceTable | None:
    """Return the "real" or "imag" ``part`` of coefficients as a table, or None if all are zero.

    Each row of the table contains ``packet`` numbers.
    """
    parts: NDArray[np.float64] = getattr(values, part)
    if not (np.abs(parts) > 1e-17 * np.abs(values).max(initial=0.0)).any():
        return None
    return DeviceTable(np.ascontiguousarray(parts).reshape(-1, packet))


def pair_factor(
    ops: Any,
    profiles: Sequence[ProfileFactor],
    by_mean: bool,
    numbers: Pair2,
    cycles: Pair2,
) -> Pair:
    """Return the array factor of all pairs of elements with the same midpoint or difference.

    ``numbers`` and ``cycles`` contain the arguments of :meth:`ProfileFactor.at` along both lattice
    directions. The result includes the squared modulus of both profiles' constant factors.
    """
    first, second = (
        profile.at(ops, by_mean, number, along)
        for profile, number, along in zip(profiles, numbers, cycles, strict=True)
    )
    scale = abs(profiles[0].profile.factor * profiles[1].profile.factor) ** 2
    return (first * second).scaled(scale)


# Largest deviation of element positions from a lattice, relative to the extent D of the lattice. At
# |nu| D = 1000 the phase error in radians is 6e3 times this fraction. Positions that are rounded
# multiples of a pitch deviate by less than this fraction.
_MISFIT = 2.0**-52
# Smallest number of elements for which the array factor of a lattice is computed as a product. For
# fewer elements, a plain sum is as fast and compiles in less time (benchmarks/array_cost.py).
_LEAST_SITES = 16


@dataclass(frozen=True)
class _Tables:
    frame: LinearFrame
    """Frame whose rows are the basis vectors of the lattice. The frame of other arrays has no
    rows."""
    rows: tuple[Row, ...] = ()
    """For each element, the position relative to the centre (two floats per coordinate) and the
    weight. Empty for a lattice."""
    factors: tuple[ProfileFactor, ...] = ()
    constant: complex = 1.0
    cycles: tuple[float, ...] = ()

    @property
    def terms(self) -> int:
        """Number of terms in the sum, on which the choice of the engine depends."""
        return max(1, len(self.rows))


@lru_cache(maxsize=64)
def _tables(sites: Sites, double: bool) -> _Tables:
    """Return the array factors of a lattice, or the rows of a plain sum for other arrays."""
    lattice = sites.lattice if len(sites.positions) >= _LEAST_SITES else None
    profiles = None if lattice is None else separated(lattice.weights)
    if lattice is None or profiles is None or lattice.misfit > _MISFIT:
        return _table_of_sites(sites, double)
    centre = (Fraction(high) + Fraction(low) for high, low in lattice.centre)
    frame = LinearFrame(tuple(phases.doubled(c, double) for c in centre), lattice.basis, 1.0)
    constant = complex(np.prod([profile.factor for profile in profiles]))
    for profile, count in zip(profiles, lattice.weights.shape, strict=True):
        # The phases of the weights are relative to the first element. Array factors require phases
        # relative to the centre of the lattice.
        constant *= complex(np.exp(1j * np.pi * profile.cycles_per_element * (count - 1)))
    cycles = tuple(profile.cycles_per_element for profile in profiles)
    return _Tables(frame, (), tuple(map(profile_factor, profiles)), constant, cycles)


def _table_of_sites(sites: Sites, double: bool) -> _Tables:
    """Return the weights of the elements, and their positions relative to the array's centre."""
    low = sites.positions.min(axis=0)
    centre = low + np.ptp(sites.positions, axis=0) / 2
    rows = zip((sites.positions - centre).tolist(), sites.weights.tolist(), strict=True)
    table = [
        (*(part for c in site for part in phases.doubled(c, double)), w.real, w.imag)
        for site, w in rows
    ]
    frame = LinearFrame(tuple(phases.doubled(c, double) for c in centre.tolist()), (), 1.0)
    return _Tables(frame, tuple(table))


def _enter(ops: Any, frame: LinearFrame, *nu: Any) -> Values:
    """Return the phase nu.c of the centre c in cycles, and the frequency nu.

    The factor exp(-2 pi i nu.c) is applied by :func:`leave_wave`. For a lattice, nu is replaced by
    nu.b modulo 2 cycles for both basis vectors b.
    """
    cycles = phases.cycles_to_centre(ops, frame.centre, *nu)
    if not frame.rows:
        return (cycles, *nu)
    # Elements lie at multiples of half a basis vector b from the centre, so nu.b is reduced modulo
    # 2 cycles.
    half = [0.5 * component for component in nu]
    return (cycles, *(2.0 * phases.cycles_to_centre(ops, b, *half) for b in frame.rows))


def _sum(ops: Any, tables: _Tables, cycles: Any, *inner: Any) -> Values:
    """Return the real part and the negated imaginary part of the array factor about the centre."""

    def term(*row: Any) -> Values:
        *coordinates, real, imag = row
        site = tuple(zip(coordinates[0::2], coordinates[1::2], strict=True))
        return phases.rotated(ops, phases.reduced(ops, phases.dot(ops, inner, site)), real, -imag)

    if tables.rows:
        real, imag = ops.sum_over(tables.rows, term, 2, like=inner[0])
        return real, -imag
    first, second = (
        factor.total(ops, along - per_element)
        for factor, along, per_element in zip(tables.factors, inner, tables.cycles, strict=True)
    )
    return wave_sums(first * second * Pair(tables.constant.real, tables.constant.imag))


@lru_cache(maxsize=8)
def array_factor_kernel(dimension: int) -> Kernel:
    """Return the kernel of the sum of w_k exp(-2 pi i nu.p_k) over k, in 1, 2 or 3 dimensions."""
    return Kernel("array factor", dimension, _tables, _enter, _sum, leave_wave)
