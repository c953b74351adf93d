"""Closed-form transforms of slits, which are intervals on a line, (S1) to (S3) of docs/theory.md.

Lag slices and position slices of two intervals are intervals as well. The distance between the
centres is computed without rounding, so overlaps are accurate to an ulp even for slits much
narrower than the distance between them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial, reduce
from itertools import combinations_with_replacement, product
from typing import Any

from polywigner.geometry import Slits
from polywigner.kernels.functions.gauss_schell import wave_over_interval
from polywigner.kernels.functions.plane import at_both_ends, enter_both_ends, product_of_both
from polywigner.kernels.kernel import Kernel, Values, leave_real, leave_wave
from polywigner.kernels.outline import Frame, power_of_two
from polywigner.kernels.wave_pairs import (
    Wave,
    WavePair,
    Waves,
    carrier_of,
    difference_pairs,
    field_of,
    mean_pairs,
    waves_in_frame,
)
from polywigner.numerics import Number, phases
from polywigner.numerics.phases import Doubled, Pair, doubled, sinc, unit_wave
from polywigner.source import Array
from polywigner.source.normal_form import normal_form

Interval = tuple[Fraction, Fraction, Waves]
"""Start and end of a slit in the frame as exact numbers, and plane waves in the slit."""


def _field_between(ops: Any, begin: float, end: float, waves: Waves, x: Any) -> Pair:
    """Return the field in an interval that includes its start but not its end."""
    inside = ops.select((x >= begin) & (x < end), 1.0, 0.0)
    # Comparisons with NaN are false, so ``inside`` alone would be 0 at NaN.
    return Pair(*field_of(ops, waves, (x,))).scaled(inside) + Pair(x - x, x - x)


@dataclass(frozen=True)
class SlitTables:
    """The slits of a source as intervals in their frame."""

    frame: Frame
    edges: tuple[tuple[Any, ...], ...]
    """`Interval` of each slit. For the Fourier transform: start and length of each slit, as two
    floats each."""


@dataclass(frozen=True)
class SlitPairs:
    """Pairs of slits and of their plane waves, with one row of numbers for each pair.

    A row starts with the distance between the centres at x = 0 or xi = 0 (two floats), both
    half-lengths, and the mean of the centres (two floats). These are followed by the complex
    product of one field and the conjugate of the other, the shift to subtract from the frequency,
    and the frequency of the product along 4x or xi.
    """

    frame: Frame
    edges: tuple[tuple[float, ...], ...]
    coherence_width: float = math.inf

    @property
    def terms(self) -> int:
        """Number of terms in the sum, on which the choice of the engine depends.

        A pair of slits counts as half an edge.
        """
        return -(-len(self.edges) // 2)


@lru_cache(maxsize=256)
def _slit_tables(source: Slits | Array) -> SlitTables:
    """Return the slits and their plane waves as exact intervals in the frame of the source."""
    elements = normal_form(source).elements
    low, high = normal_form(source).bounds
    carrier = carrier_of((element.illumination for element in elements), 1)
    unit, half = power_of_two(high - low), (high - low) / 2
    matrix, rows = ((1 / unit,),), ((unit,),)
    frame = Frame((low + half,), matrix, rows, 1.0, unit, (half / unit,), carrier)
    centre, scale = Fraction(frame.centre[0]), Fraction(frame.measure)
    intervals = []
    for element in elements:
        waves = tuple(
            Wave(element.weight * wave.amplitude, wave.frequency)
            for wave in waves_in_frame(element.illumination, frame)
        )
        assert isinstance(element.outline, Slits)
        for begin, end in element.outline.intervals.tolist():
            low_end, high_end = ((Fraction(value) - centre) / scale for value in (begin, end))
            intervals.append((low_end, high_end, waves))
    return SlitTables(frame, tuple(intervals))


@lru_cache(maxsize=256)
def pair_tables(source: Slits | Array, double: bool, of_lags: bool) -> SlitPairs:
    """Return the pairs of slits that contribute to the Wigner or the ambiguity function.

    If ``of_lags`` is true, the slits I_k and I_l contribute to the lag slice at x, the intersection
    of 2(I_k - x) and 2(x - I_l). The reversed pair contributes the complex conjugate, so each pair
    is stored once. Otherwise, they contribute to the position slice at xi, the intersection of I_k
    - xi/2 and I_l + xi/2.
    """

    def paired(items: Iterable[Any]) -> Iterable[tuple[Any, Any]]:
        """Return unordered pairs of items for W, and ordered pairs for A."""
        return combinations_with_replacement(items, 2) if of_lags else product(items, repeat=2)

    tables = _slit_tables(source)
    rows: list[tuple[Any, ...]] = []
    for (k, (begin, end, waves)), (m, (begin2, end2, waves2)) in paired(enumerate(tables.edges)):
        centre, centre2 = (begin + end) / 2, (begin2 + end2) / 2
        total, apart = centre + centre2, centre - centre2
        gap, mean, scale = (2 * total, apart, 2) if of_lags else (apart, total / 2, 1)
        halves = float(scale * (end - begin) / 2), float(scale * (end2 - begin2) / 2)
        row = (*doubled(gap, double), *halves, *doubled(mean, double))
        # In the lag slice of one slit, the pairs of waves (v, w) and (w, v) have conjugate fields.
        for v, w in paired(waves) if k == m else product(waves, waves2):
            twice = 2.0 if of_lags and not (k == m and v is w) else 1.0
            mutual = v.amplitude * complex(w.amplitude).conjugate() * twice
            (a,), (b,) = v.frequency, w.frequency
            wave = ((a + b) / 2, (a - b) / 4) if of_lags else (a - b, (a + b) / 2)
            rows.append((*row, mutual.real, mutual.imag, *wave))
    return SlitPairs(tables.frame, tuple(rows))


def _overlap(
    ops: Any, shift: Doubled, gap: Any, gap_low: Any, half: Any, other: Any
) -> tuple[Any, Any]:
    """Return the length of the overlap of two intervals, and its centre minus the mean centre.

    The first centre minus the second is gap + gap_low - shift, and ``half`` and ``other`` are the
    half-lengths of the first and the second interval. The length is 0 for separate intervals.
    """
    apart, lost = phases.difference(gap, shift[0])
    distance = apart + (lost + (gap_low - shift[1]))
    shorter = ops.minimum(half, other)
    length = ops.minimum(2.0 * shorter, half + other - abs(distance))
    reach = 0.5 * abs(other - half)
    offset = ops.maximum(-reach, ops.minimum(reach, 0.5 * distance))
    return ops.maximum(length, 0.0), ops.select(other >= half, offset, -offset)


def _sum(ops: Any, tables: SlitPairs, shift: Doubled, nu: Doubled) -> Values:
    """Return the complex sum over pairs of slits. ``shift`` is 4x for W, and xi for A."""

    def term(
        gap: Any, gap_low: Any, half: Any, other: Any, mean: Any, mean_low: Any, real: Any,
        imag: Any, detuning: Any, rate: Any,
    ) -> Values:  # fmt: skip
        length, offset = _overlap(ops, shift, gap, gap_low, half, other)
        detuned, width = (nu[0], nu[1] - detuning), tables.coherence_width
        mutual = Pair(real, imag) * unit_wave(ops, rate * (shift[0] + shift[1]))
        frequency = detuned[0] + detuned[1]
        if width < math.inf:
            scale = 1.0 / width
            centre, reach = (mean + (mean_low + offset)) * scale, length * (0.5 * scale)
            ends = centre - reach, centre + reach
            value = Pair(*wave_over_interval(ops, *ends, frequency * width)).scaled(width)
        else:
            cycles = phases.reduced(ops, phases.dot(ops, (detuned,), ((mean, mean_low),)))
            cycles = cycles + frequency * offset
            value = unit_wave(ops, -cycles).scaled(sinc(ops, frequency * length) * length)
        value = value * mutual
        return value.real, value.imag

    total: Values = ops.sum_over(tables.edges, term, 2, like=shift[0])
    return total


@dataclass(frozen=True, eq=False)
class LineField:
    """A field on the interval from -half to half, as a sum of plane waves."""

    half: float
    waves: Waves

    @property
    def pairs(self) -> int:
        """Number of pairs of plane waves, counted once for both orders."""
        return len(self.waves) * (len(self.waves) + 1) // 2

    def wigner(self, ops: Any, x: Any, nu: Any, width: float = math.inf) -> Number:
        """Return W(x, nu) of the field for a coherence width, with all arguments in the frame."""
        pairs = mean_pairs(self.waves, self.waves, True)
        return _over_pairs(ops, pairs, x, nu, _length(ops, self.half - abs(x), 4.0), width).real

    def ambiguity(self, ops: Any, upsilon: Any, xi: Any) -> Pair:
        """Return the ambiguity function A(upsilon, xi) of the field."""
        pairs = difference_pairs(self.waves, self.waves)
        return _over_pairs(ops, pairs, xi, upsilon, _length(ops, 2.0 * self.half - abs(xi), 1.0))

    def fourier(self, ops: Any, nu: Any) -> Pair:
        """Return the Fourier transform F(nu) of the field."""
        length = 2.0 * self.half
        total = Pair(0.0, 0.0)
        for wave in self.waves:
            amplitude = Pair(wave.amplitude.real, wave.amplitude.imag)
            total = total + amplitude.scaled(sinc(ops, length * (nu - wave.frequency[0])))
        return total.scaled(length)

    def field(self, ops: Any, x: Any) -> Pair:
        """Return the field at a position. The interval includes only its lower end."""
        return _field_between(ops, -self.half, self.half, self.waves, x)


def _length(ops: Any, overlap: Any, scale: float) -> Number:
    """Return ``scale`` times the length of an overlap, but at least 0, or NaN for NaN positions."""
    return scale * ops.maximum(overlap, 0.0) + (overlap - overlap)


def _over_pairs(
    ops: Any, pairs: Sequence[WavePair], position: Any, frequency: Any, length: Any,
    width: float = math.inf,
) -> Pair:  # fmt: skip
    """Return W or A of a field on an interval as a sum over pairs of waves, (I4) or (I6).

    ``position`` and ``frequency`` are x and nu, or xi and upsilon. ``length`` is the length of the
    slice, and ``width`` the coherence width.
    """
    total = Pair(0.0, 0.0)
    for pair in pairs:
        nu = frequency - pair.shift[0]
        if width < math.inf:
            half = length * (0.5 / width)
            transform = wave_over_interval(ops, -half, half, nu * width)[0] * width
        else:
            transform = sinc(ops, length * nu) * length
        total = total + Pair(*pair.amplitude(ops, (position,))).scaled(transform)
    return total


def _field(ops: Any, tables: SlitTables, x: Any) -> Values:
    """Return the real and imaginary part of the field at a position, without the carrier.

    The position is in the frame.
    """
    intervals = ((float(begin), float(end), waves) for begin, end, waves in tables.edges)
    total = reduce(Pair.__add__, (_field_between(ops, *interval, x) for interval in intervals))
    return total.real, total.imag


@lru_cache(maxsize=256)
def _segment_tables(source: Slits, double: bool) -> SlitTables:
    """Return the start and length of each slit as two floats each, for the Fourier transform."""
    tables = _slit_tables(source)
    rows = ((*doubled(a, double), *doubled(b - a, double)) for a, b, _ in tables.edges)
    return SlitTables(tables.frame, tuple(rows))


def _enter_fourier(ops: Any, frame: Frame, nu: Any) -> Values:
    """Return the phase nu.c of the centre c in cycles, and nu in the frame as two floats."""
    cycles = phases.cycles_to_centre(ops, frame.centre, nu)
    return (cycles, *phases.split(ops, (*frame.frequency(ops, nu), 0.0)))


def _fourier(ops: Any, tables: SlitTables, cycles: Any, *nu: Any) -> Values:
    """Return the real part and minus the imaginary part of the Fourier transform of slits."""

    def term(begin: Any, begin_low: Any, length: Any, length_low: Any) -> Values:
        total, low = phases.dot(ops, (nu,), ((length, length_low),))
        wave = phases.mean_plane_wave(ops, 0.0, total + low)
        phase = phases.reduced(ops, phases.dot(ops, (nu,), ((begin, begin_low),)))
        real, imag = phases.rotated(ops, phase, *wave)
        return real * length, -imag * length

    total: Values = ops.sum_over(tables.edges, term, 2, like=nu[0])
    return total


def _enter_wigner(ops: Any, frame: Frame, x: Any, nu: Any) -> Values:
    """Return the shift 4x of both copies of a slit, and nu minus the carrier, in the frame.

    Each number is the sum of two floats.
    """
    # If x changes by dx, the distance between the two copies of a slit changes by 4 dx.
    scale = 4.0 / frame.measure
    total, low = phases.difference(x, frame.centre[0])
    shift = phases.split(ops, (total * scale, low * scale))
    return (*shift, *phases.split(ops, (*frame.detuned(ops, nu), 0.0)))


def _enter_ambiguity(ops: Any, frame: Frame, upsilon: Any, xi: Any) -> Values:
    """Return the phase of the centre and carrier in cycles, and upsilon and xi as float pairs.

    A has the factor exp(-2 pi i phase).
    """
    cycles = phases.cycles_to_centre(ops, frame.centre, upsilon)
    cycles = phases.less_carrier(ops, frame, cycles, xi)
    shift = phases.split(ops, (*frame.frequency(ops, upsilon), 0.0))
    return (cycles, *shift, *phases.split(ops, (*frame.vector(ops, xi), 0.0)))


def _ambiguity(ops: Any, tables: SlitPairs, cycles: Any, *inner: Any) -> Values:
    """Return the real part and minus the imaginary part of the ambiguity function."""
    real, imag = _sum(ops, tables, inner[2:], inner[:2])
    return real, -imag


def _wigner(ops: Any, tables: SlitPairs, shift: Any, shift_low: Any, *nu: Any) -> Values:
    """Return the Wigner function of slits, for the results of :func:`_enter_wigner`."""
    return _sum(ops, tables, (shift, shift_low), nu)[:1]


FOURIER = Kernel("fourier of slits", 1, _segment_tables, _enter_fourier, _fourier, leave_wave)
AUTOCORRELATION = Kernel(
    "autocorrelation of slits",
    1,
    lambda source, double: _slit_tables(source),
    enter_both_ends,
    at_both_ends(_field),
    product_of_both,
)
WIGNER = Kernel(
    "wigner of slits", 1, partial(pair_tables, of_lags=True), _enter_wigner, _wigner, leave_real
)
AMBIGUITY = Kernel(
    "ambiguity of slits",
    1,
    partial(pair_tables, of_lags=False),
    _enter_ambiguity,
    _ambiguity,
    leave_wave,
)
