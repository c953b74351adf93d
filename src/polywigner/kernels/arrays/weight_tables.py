"""Array factors of any weights on a lattice, from a table that is periodic in the frequency.

Weights that are no product of two profiles have factors (L1) of up to n1 n2 terms at a midpoint.
Each is a trigonometric polynomial of 2 nu.b along both directions, of the degree that the pairs of
sites at this midpoint give it. It is tabulated at a somewhat higher rate than that asks for, and
interpolated: a non-uniform FFT of type 2. Factors of differences (L2) are the same, in waves that
turn half as fast; they are complex: two tables.

What a look-up costs is the memory that it touches, and how much there is of it. So a midpoint has
one period of samples, as many as its own degree needs, and those of a look-up lie one after the
other: as many along the first direction as it takes, four each of the second.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.arrays.repeated import HeldTable
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.polynomials import RATE, interpolation

Complexes = NDArray[np.complex128]

# Samples that are read at a time.
_PACKET = 4
# Larger tables are not made; the factors are then summed pair by pair.
_MOST_BYTES = 1 << 28


def partner(index: Any, number: Any, count: int, by_mean: bool) -> Any:
    """The other site of a pair, along a direction of so many sites.

    ``number``, 0 to 2 count - 2: the sum of both indices, or their difference plus count - 1. In
    both cases there are count - |number - (count - 1)| pairs, and the waves of a factor are
    exp(-2 pi i t (index - number/2)) with t = 2 nu.b or upsilon.b.
    """
    return number - index if by_mean else index - number + (count - 1)


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


def _odd(ops: Any, whole: Any) -> Any:
    """1 for odd numbers, 0 for even ones."""
    return abs(whole - 2.0 * ops.round(0.5 * whole))


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
