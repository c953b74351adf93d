"""Array factors: sums over the sites of an array, and over pairs of sites of a lattice.

The Fourier transform of an array is its element's transform times the sum of w_k exp(-2 pi i
nu.p_k) over the sites p_k (docs/theory.md, (L3)). On a lattice whose weights are a product of two
profiles, the factor is the product of two sums, one along each direction. For other arrays the sum
runs over the sites one by one.

W of equal elements on a lattice is a sum over midpoints of pairs of sites: W of the element at the
midpoint, times the discrete Wigner function of the weights (L1). A is such a sum over differences
of sites (L2). If the weights are a product, these factors are products as well. Along one direction
each factor is

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

from polywigner.kernels.element_pairs import DeviceTable
from polywigner.kernels.functions.fourier import LinearFrame
from polywigner.kernels.kernel import Kernel, Values, leave_wave
from polywigner.numerics import Complex, Number, phases
from polywigner.numerics.phases import Pair, cos_sin_cycles, sin_cycles
from polywigner.source.lattices import Profile, Sites, separated

Pair2 = tuple[Any, Any]
Row = tuple[float, ...]

# Number of coefficients that an engine reads with one load instruction.
_PACKET = 4
# Largest number of terms in a temporary array, which then takes some tens of megabytes together
# with intermediate results.
_BLOCK = 1 << 18


def partner(index: Any, number: Any, count: int, by_mean: bool) -> Any:
    """Return the index of the second site of a pair, along a direction of ``count`` sites.

    ``number``, from 0 to 2 count - 2, is the sum of the indices of both sites (``by_mean``), or
    their difference plus count - 1. In both cases count - |number - (count - 1)| pairs of sites
    have the same number. Their array factor is a sum of the waves exp(-2 pi i t
    (index - number/2)), with t = 2 nu.b or upsilon.b.
    """
    return number - index if by_mean else index - number + (count - 1)


def _odd(ops: Any, number: Any) -> Number:
    """Return 1 for odd numbers and 0 for even numbers."""
    return abs(number - 2.0 * ops.round(0.5 * number))


@dataclass(frozen=True, eq=False)
class ProfileFactor:
    """Array factors along one direction of a lattice, for a profile of n amplitudes."""

    profile: Profile

    @property
    def count(self) -> int:
        return len(self.profile.amplitudes)

    @cached_property
    def _amplitudes(self) -> Complex:
        return np.array(self.profile.amplitudes, np.complex128)

    @cached_property
    def means(self) -> _Series:
        """Table of products a_i a_j*: one row for each i + j, in order of increasing i - j."""
        return self._mutual(by_mean=True)

    @cached_property
    def differences(self) -> _Series:
        """Table of products a_i a_j*: one row for each i - j, in order of increasing i + j."""
        return self._mutual(by_mean=False)

    @cached_property
    def _all(self) -> _Series:
        """Table with one row, the amplitudes of all sites."""
        return _series(np.array([self.count]), lambda row, k: self._amplitudes[k])

    def _mutual(self, by_mean: bool) -> _Series:
        a, last = self._amplitudes, self.count - 1

        def product(number: NDArray[np.intp], k: NDArray[np.intp]) -> Complex:
            site = np.maximum(0, number - last) + k
            products: Complex = a[site] * a[partner(site, number, self.count, by_mean)].conj()
            return products

        return _series(self.count - abs(np.arange(2 * last + 1) - last), product)

    def at(self, ops: Any, by_mean: bool, number: Any, cycles: Any) -> Pair:
        """Return the array factor of all pairs of sites that have the same ``number``.

        :func:`partner` defines the number of a pair. The factor is evaluated at t = ``cycles``. The
        pair (i, j) has the weight a_i a_j*. With ``by_mean``, the factor is real.
        """
        last = self.count - 1.0
        pairs = self.count - abs(number - last)
        if self.profile.is_uniform:
            return Pair(_dirichlet(ops, pairs, cycles), 0.0)
        series = self.means if by_mean else self.differences
        return series.value(ops, number, 2.0 * last, pairs, cycles)

    def total(self, ops: Any, cycles: Any) -> Pair:
        """Return sum_k a_k exp(-2 pi i t (k - (n - 1)/2)) at t = ``cycles``, modulo 2."""
        count = float(self.count) + 0.0 * cycles
        if self.profile.is_uniform:
            return Pair(_dirichlet(ops, count, cycles), 0.0)
        return self._all.value(ops, 0.0 * cycles, 0.0, count, cycles)


@lru_cache(maxsize=64)
def profile_factor(profile: Profile) -> ProfileFactor:
    """Return the array factors of a profile, without its constant factor and its linear phase."""
    return ProfileFactor(profile)


def _dirichlet(ops: Any, count: Any, cycles: Any) -> Number:
    """Return sum_k exp(-2 pi i t (k - (N - 1)/2)) over 0 <= k < N = ``count`` at t = ``cycles``."""
    floor = 1e-30 if ops.double else 1e-20
    nearest = ops.round(cycles)
    remainder = cycles - nearest
    remainder = ops.select(abs(remainder) < floor, floor, remainder)
    quotient = sin_cycles(ops, 0.5 * count * remainder) / sin_cycles(ops, 0.5 * remainder)
    odd = _odd(ops, (count - 1.0) * nearest)
    return ops.select(count > 0.0, quotient * (1.0 - 2.0 * odd), 0.0 * cycles)


@dataclass(frozen=True, eq=False)
class _Series:
    """Sums of cosines and sines, one for each row of a table of coefficients.

    Row r is the sum of p_k cos(2 pi t m_k) - i q_k sin(2 pi t m_k) with complex p and q. The
    multiple m_k is k for an odd number of terms, and k + 1/2 for an even number. The terms are
    ordered from the centre of the row outwards.
    """

    packets: int
    """Number of packets of coefficients in each row."""
    tables: tuple[DeviceTable | None, ...]
    """Real and imaginary parts of p, then of q. Each table has the shape (rows * packets per row,
    coefficients per packet)."""

    def value(self, ops: Any, row: Any, last: float, pairs: Any, cycles: Any) -> Pair:
        """Return the sum of a row at t = ``cycles``, or 0 if the row does not exist.

        ``pairs``: number of pairs of sites, which is the number of terms of the row.
        """
        exists = (row >= 0.0) & (row <= last)
        # Row indices of the table are integers, because float32 rounds integers above 2^24, which
        # profiles of more than 8,200 sites need.
        known = ops.select(exists, row, 0.0)
        start, nil = ops.truncated(known) * self.packets, 0.0 * known + 0.0 * cycles
        # If the number of terms is even, the centre of the row lies between two terms.
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
        if table is None:
            return 0.0
        memory, last = table.in_memory(ops), start + (self.packets - 1)

        def step(packet: Any, previous: Any, b: Any, d: Any) -> tuple[Any, ...]:
            for coefficient in reversed(ops.gather(memory, last - packet)):
                previous = b
                d = ops.fma(basis.slope, b, ops.fma(basis.sign, d, coefficient))
                b = ops.fma(basis.sign, b, d)
            return previous, b, d

        previous, _, d = ops.repeated(self.packets, (nil, nil, nil), step, basis.slope)
        first, second = ends
        return first * d + second * previous


class _Basis:
    """Clenshaw's recurrence in Reinsch's form for cosines and sines of multiples k or k + 1/2.

    This form is stable at multiples of half a cycle, where Clenshaw's original form loses n^2 ulps.
    ``cosine`` and ``sine`` are the factors of the last d and of the second-last b of the
    recurrence.
    """

    def __init__(self, ops: Any, cycles: Any, half: Any) -> None:
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
    """Return the rows c_k = ``product(row, k)``, 0 <= k < length, as sums about their centres."""
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
        # Both halves of a row of odd length contain the central term.
        odd = rows[n % 2 == 1]
        p[odd, 0] /= 2
    tables = (_unless_zero(t, part, packet) for t in (p, q) for part in ("real", "imag"))
    return _Series(packets, tuple(tables))


def _unless_zero(values: Complex, part: str, packet: int) -> DeviceTable | None:
    parts: NDArray[np.float64] = getattr(values, part)
    if not (np.abs(parts) > 1e-17 * np.abs(values).max(initial=0.0)).any():
        return None
    return DeviceTable(np.ascontiguousarray(parts).reshape(-1, packet))


def factor_of(
    ops: Any, profiles: tuple[ProfileFactor, ProfileFactor], by_mean: bool, cycles: Pair2
) -> Callable[[Pair2, Pair2], Pair]:
    """Return a function that computes the array factor of the pairs of sites that share a node.

    A node is the midpoint of two sites (``by_mean``) or the difference of two sites.

    ``cycles``: t along both directions. The function takes the steps from the first contributing
    node to the node, and the two numbers of the node for :func:`partner`, each along both
    directions.
    """
    first, second = (
        _remembered(partial(profile.at, ops, by_mean, cycles=along))
        for profile, along in zip(profiles, cycles, strict=True)
    )
    return lambda steps, numbers: first(steps[0], numbers[0]) * second(steps[1], numbers[1])


def _remembered(compute: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    """Return a version of ``compute(argument)`` that caches its results by step."""
    known: dict[float, Any] = {}

    def of(step: Any, argument: Any) -> Any:
        # A step that is an array of an engine cannot be a key of the cache.
        if not isinstance(step, float):
            return compute(argument)
        if step not in known:
            known[step] = compute(argument)
        return known[step]

    return of


# Largest deviation of the sites from a lattice, as a fraction of the extent D of the lattice, for
# which the closed form is used. The error of the phase in radians is 6e3 times this fraction at
# |nu| D = 1000. Rounded multiples of a pitch deviate by less. Rounded positions far from the origin
# deviate by more.
_MISFIT = 2.0**-52
# Smallest number of sites for which the array factor of a lattice is computed in closed form. Fewer
# sites are summed one by one, which is as fast and compiles sooner (benchmarks/array_cost.py).
_LEAST_SITES = 16


@dataclass(frozen=True)
class _Tables:
    frame: LinearFrame
    """Frame whose rows are the basis vectors of the lattice. It has no rows if sites are summed one
    by one."""
    rows: tuple[Row, ...] = ()
    """One row for each site: its position relative to the centre, each coordinate as two floats,
    and its weight. Empty for a lattice."""
    factors: tuple[ProfileFactor, ...] = ()
    constant: complex = 1.0
    cycles: tuple[float, ...] = ()

    @property
    def terms(self) -> int:
        return max(1, len(self.rows))


@lru_cache(maxsize=64)
def _tables(sites: Sites, double: bool) -> _Tables:
    lattice = sites.lattice if len(sites.positions) >= _LEAST_SITES else None
    profiles = None if lattice is None else separated(lattice.weights)
    if lattice is None or profiles is None or lattice.misfit > _MISFIT:
        return _table_of_sites(sites, double)
    centre = (Fraction(high) + Fraction(low) for high, low in lattice.centre)
    frame = LinearFrame(tuple(phases.doubled(c, double) for c in centre), lattice.basis, 1.0)
    constant = complex(np.prod([profile.factor for profile in profiles]))
    for profile, count in zip(profiles, lattice.weights.shape, strict=True):
        # The phases of the weights are relative to the centre of the lattice.
        constant *= complex(np.exp(1j * np.pi * profile.cycles_per_element * (count - 1)))
    factors, cycles = (
        map(profile_factor, profiles),
        (profile.cycles_per_element for profile in profiles),
    )
    return _Tables(frame, (), tuple(factors), constant, tuple(cycles))


@lru_cache(maxsize=64)
def _table_of_sites(sites: Sites, double: bool) -> _Tables:
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
    cycles = phases.cycles_to_centre(ops, frame.centre, *nu)
    if not frame.rows:
        return (cycles, *nu)
    # The sites lie at multiples of b/2 from the centre, so nu.b is reduced modulo 2.
    half = [0.5 * component for component in nu]
    return (cycles, *(2.0 * phases.cycles_to_centre(ops, b, *half) for b in frame.rows))


def _sum(ops: Any, tables: _Tables, cycles: Any, *inner: Any) -> Values:
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
    total = first * second * Pair(tables.constant.real, tables.constant.imag)
    return total.real, -total.imag


@lru_cache(maxsize=8)
def array_factor_kernel(dimension: int) -> Kernel:
    """Return the kernel of array factors of sites on a line, in the plane or in space."""
    return Kernel("array factor", dimension, _tables, _enter, _sum, leave_wave)
