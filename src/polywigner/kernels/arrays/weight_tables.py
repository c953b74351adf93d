"""Array factors of any weights on a lattice, from a table that is periodic in the frequency.

Weights that are no product of two profiles have factors (L1) of up to n1 n2 terms at a midpoint.
Each is a trigonometric polynomial of 2 nu.b along both directions, of the degree that the pairs of
sites at this midpoint give it. It is tabulated at a somewhat higher rate than that asks for, and
interpolated: a non-uniform FFT of type 2.

What a look-up costs is the memory that it touches, and how much there is of it. So a midpoint has
one period of samples, as many as its own degree needs, and those of a look-up lie one after the
other: as many along the first direction as it takes, four each of the second.

Factors of differences (L2) are the same: a difference d has n - |d| pairs along a direction, as
many as the index sum d + n - 1, and waves that turn half as fast. They are complex: two tables.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.polynomials import RATE, interpolation

__all__ = [
    "DifferenceTable",
    "Direction",
    "MeanTable",
    "Taps",
    "difference_table",
    "fits_a_table",
    "mean_table",
]

Complexes = NDArray[np.complex128]

# Samples that are read at a time.
_PACKET = 4
# Larger tables are not made; the factors are then summed pair by pair.
_MOST_BYTES = 1 << 28


@dataclass(frozen=True)
class Direction:
    """Along one direction, by midpoint: how many samples a period has."""

    step: int
    """Samples that are read together, from multiples of so many on."""
    periods: tuple[float, ...]
    """Samples of a period, by midpoint."""
    starts: tuple[float, ...]
    """Samples of all midpoints before."""

    @property
    def total(self) -> float:
        return self.starts[-1] + self.periods[-1]

    def has(self, index_sum: Any) -> Any:
        """Whether there is such a midpoint."""
        return (index_sum >= 0.0) & (index_sum < float(len(self.periods)))

    def taps(self, ops: Any, index_sum: Any, turns: Any) -> Taps:
        """The samples that count at nu.b = ``turns`` for a midpoint."""
        row = ops.select(self.has(index_sum), index_sum, 0.0)
        period, start = (ops.lookup(values, row) for values in (self.periods, self.starts))
        kernel = interpolation(ops.double)
        middle = 0.5 * (kernel.width - 1)
        t = turns + turns
        whole = ops.round(t)
        u = (t - whole) * period
        first = ops.round(u - middle)
        weights = kernel.weights(ops, 2.0 * (u - first - middle))
        if self.step > 1:
            first, weights = self._aligned(ops, first, weights)
        places, signed = [], []
        odd, frequency = _odd(ops, row), 1.0 / period
        for q in range(0, len(weights), self.step):
            place = first + float(q)
            periods = ops.round((place + 0.5) * frequency - 0.5)
            places.append(ops.truncated((place - periods * period) * (1 / self.step)))
            # an odd index sum has waves of half periods
            sign = 1.0 - 2.0 * (_odd(ops, periods + whole) * odd)
            signed += [sign * weight for weight in weights[q : q + self.step]]
        return Taps(signed, places, ops.truncated(period), ops.truncated(start))

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


@dataclass(frozen=True)
class Taps:
    """Weights of samples, their places in a period in steps, and where the midpoint's begin."""

    weights: list[Any]
    places: list[Any]
    period: Any
    start: Any


def _odd(ops: Any, whole: Any) -> Any:
    """1 for odd numbers, 0 for even ones."""
    return abs(whole - 2.0 * ops.round(0.5 * whole))


@dataclass(frozen=True, eq=False)
class MeanTable:
    """The factors of all midpoints, prepared for interpolation."""

    directions: tuple[Direction, Direction]
    values: NDArray[Any]
    """(packets, 4): four samples along the second direction, and after them those of the next place
    along the first."""
    held: dict[Hashable, Any] = field(default_factory=dict)

    def at(self, ops: Any, counts: Any, taps: tuple[Taps, Taps]) -> Any:
        """The factor at a midpoint; anything where it does not count, at little cost."""
        if ops.key not in self.held:
            self.held[ops.key] = ops.held(self.values)
        table = self.held[ops.key]
        one, two = taps
        per_row = int(self.directions[1].total) // _PACKET
        block = one.start * per_row + two.start // _PACKET * one.period
        # one place for all samples that want nothing
        rows = [ops.select_number(counts, block + place, 0) for place in one.places]
        step = ops.select_number(counts, one.period, 0)
        total: Any = 0.0
        for k, place in enumerate(two.places):
            column = place * step
            lines: list[Any] = [0.0] * _PACKET
            for row, weight in zip(rows, one.weights, strict=True):
                values = ops.gather(table, column + row)
                lines = [ops.fma(v, weight, s) for v, s in zip(values, lines, strict=True)]
            for line, other in zip(lines, two.weights[_PACKET * k :], strict=False):
                total = ops.fma(line, other, total)
        return total


@dataclass(frozen=True, eq=False)
class DifferenceTable:
    """The factors of all differences, which count from 0 for the lowest, in real and imaginary."""

    real: MeanTable
    imag: MeanTable

    @property
    def directions(self) -> tuple[Direction, Direction]:
        return self.real.directions

    def at(self, ops: Any, counts: Any, taps: tuple[Taps, Taps]) -> Pair:
        """As of a ``MeanTable``, for taps at half the turns."""
        return Pair(self.real.at(ops, counts, taps), self.imag.at(ops, counts, taps))


def mean_table(weights: Complexes, double: bool) -> MeanTable | None:
    """The table of weights (n1, n2), or None if it would be too large."""
    found = _tables(weights, double, _of_sum, ("real",))
    return None if found is None else found[0]


def difference_table(weights: Complexes, double: bool) -> DifferenceTable | None:
    """The tables of weights (n1, n2), or None if they would be too large."""
    found = _tables(weights, double, _of_difference, ("real", "imag"))
    return None if found is None else DifferenceTable(*found)


def fits_a_table(shape: tuple[int, ...], double: bool) -> bool:
    """Whether weights of a shape (n1, n2) have a `mean_table`: told without making it."""
    return not _is_too_large(_directions(shape), double, 1)


def _directions(shape: tuple[int, ...]) -> tuple[Direction, Direction]:
    return _direction(shape[0], 1), _direction(shape[1], _PACKET)


def _is_too_large(directions: tuple[Direction, Direction], double: bool, parts: int) -> bool:
    entries = int(directions[0].total * directions[1].total)
    return entries * (8 if double else 4) * parts > _MOST_BYTES


def _tables(
    weights: Complexes, double: bool, pairs_of: Pairs, parts: tuple[str, ...]
) -> list[MeanTable] | None:
    directions = first, second = _directions(weights.shape)
    if _is_too_large(directions, double, len(parts)):
        return None
    entries = int(first.total * second.total)
    dtype = np.dtype(np.float64 if double else np.float32)
    values: list[NDArray[Any]] = [np.empty(entries, dtype) for _ in parts]
    ones, twos = (
        [_midpoint(pairs_of(count, h), int(period), double) for h, period in enumerate(d.periods)]
        for count, d in zip(weights.shape, directions, strict=True)
    )
    begin = 0
    for one in ones:
        for two in twos:
            mutual = weights[one.sites, two.sites] * weights[one.partners, two.partners].conj()
            samples = _samples(mutual, one, two).reshape(one.period, -1, _PACKET).swapaxes(0, 1)
            for table, part in zip(values, parts, strict=True):
                table[begin : begin + samples.size] = getattr(samples, part).ravel()
            begin += samples.size
    return [MeanTable(directions, table.reshape(-1, _PACKET)) for table in values]


def _samples(mutual: Complexes, one: _Midpoint, two: _Midpoint) -> Complexes:
    """One period of a midpoint's factor along both directions.

    By FFT along one and the other, not by matrices of waves: those of a long row would take its
    length cubed in memory, and small products of matrices starve where threads share a processor.
    """
    along = np.fft.fft(mutual * (one.gains[:, None] * two.gains), two.period, axis=1) * two.shifts
    return np.fft.fft(along, one.period, axis=0) * one.shifts[:, None]


Pairs = Callable[[int, int], tuple[slice, slice]]
"""(sites along a direction, number of the midpoint or difference) -> its pairs: sites, partners."""


def _of_sum(count: int, index_sum: int) -> tuple[slice, slice]:
    first, last = max(0, index_sum - count + 1), min(count - 1, index_sum)
    return slice(first, last + 1), slice(last, first - 1 if first else None, -1)


def _of_difference(count: int, number: int) -> tuple[slice, slice]:
    apart = number - (count - 1)
    length, sites, partners = count - abs(apart), max(0, apart), max(0, -apart)
    return slice(sites, sites + length), slice(partners, partners + length)


def _direction(count: int, step: int) -> Direction:
    pairs = count - abs(np.arange(2 * count - 1) - (count - 1))
    periods = np.ceil(RATE * pairs / step) * step
    starts = np.cumsum(periods) - periods
    return Direction(step, tuple(periods.tolist()), tuple(starts.tolist()))


@dataclass(frozen=True, eq=False)
class _Midpoint:
    """Along one direction: the pairs of a midpoint, and their waves at the samples of a period."""

    sites: slice
    partners: slice
    """Partners of ``sites`` in these pairs, in the same order."""
    period: int
    gains: NDArray[np.float64]
    """By pair: what makes up for the interpolation."""
    shifts: Complexes
    """By sample: the wave of the first pair, from which an FFT counts."""


def _midpoint(pairs: tuple[slice, slice], period: int, double: bool) -> _Midpoint:
    sites, partners = pairs
    count = sites.stop - sites.start
    kappa: NDArray[Any] = (np.arange(count) - (count - 1) / 2) / period
    shifts: Complexes = np.exp(-2j * np.pi * kappa[0] * np.arange(period))
    gains: NDArray[np.float64] = np.reciprocal(interpolation(double).transform(kappa))
    return _Midpoint(sites, partners, period, gains, shifts)
