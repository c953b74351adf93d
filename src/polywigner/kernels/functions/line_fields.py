"""Sums of a few waves on one interval, and their transforms in one dimension.

On [-h, h], with waves c_m exp(2 pi i kappa_m x):

    W(x, nu) = sum_mn c_m c_n* exp(2 pi i d x) L sinc(L (nu - s/2))
    A(v, xi) = sum_mn c_m c_n* exp(i pi s xi) l sinc(l (v - d))

with s = kappa_m + kappa_n, d = kappa_m - kappa_n, L = 4(h - |x|) and l = 2h - |xi| (or 0), the
lengths of the slices. Source: docs/theory.md, (I4), which is (S2) for one interval around zero.

Pairs with one mean (or difference) share their sinc, and pairs with one rate their wave: waves at
multiples of one frequency, as tapers have them, take 2m - 1 of the one and m of the other. W of
seven waves takes a fifth of the time that it has pair by pair, as ``slits`` sums up many slits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from polywigner.kernels.functions.gauss_schell import wave_over_interval
from polywigner.kernels.functions.slits import Interval
from polywigner.kernels.outline.waves import WavePair, Waves, difference_pairs, mean_pairs
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns, sinc

__all__ = ["LineField", "line_field"]

# Rates that agree to this, in cycles per unit of the frame or of the largest, are one.
_EQUAL = 1e-14


@dataclass(frozen=True, eq=False)
class LineField:
    """A field on the interval from -half to half."""

    half: float
    waves: Waves
    means: _WavePairs
    differences: _WavePairs

    @property
    def pairs(self) -> int:
        return len(self.waves) * (len(self.waves) + 1) // 2

    def wigner(self, ops: Any, x: Any, nu: Any, width: float = math.inf) -> Any:
        """W, which is real, of light that is coherent over a width in the frame."""
        length = _length(ops, self.half - abs(x), 4.0)
        return self.means.total(ops, x, nu, length, width).real

    def ambiguity(self, ops: Any, upsilon: Any, xi: Any) -> Pair:
        length = _length(ops, 2.0 * self.half - abs(xi), 1.0)
        return self.differences.total(ops, xi, upsilon, length)

    def fourier(self, ops: Any, nu: Any) -> Pair:
        length = 2.0 * self.half
        real: Any = 0.0
        imag: Any = 0.0
        for wave in self.waves:
            share = sinc(ops, length * (nu - wave.frequency[0]))
            real = ops.fma(share, wave.amplitude.real, real)
            imag = ops.fma(share, wave.amplitude.imag, imag)
        return Pair(real, imag).scaled(length)

    def field(self, ops: Any, x: Any) -> Pair:
        """u, which the lower end has and the upper one has not."""
        undefined = x - x  # not a number where x is none
        real, imag = Interval(-self.half, self.half, self.waves).field(ops, x)
        return Pair(real + undefined, imag + undefined)


def _length(ops: Any, left: Any, scale: float) -> Any:
    """Length that is left of an interval, at least 0; not a number where the place is none."""
    return scale * ops.maximum(left, 0.0) + (left - left)


@dataclass(frozen=True)
class _WavePairs:
    """Pairs of waves by what is subtracted from the frequency, and by their rates."""

    rates: tuple[float, ...]
    """Not negative."""
    shifts: tuple[float, ...]
    terms: tuple[tuple[tuple[complex, int, float], ...], ...]
    """For each shift: amplitudes, number of the rate, and its sign."""
    is_real: bool

    def total(
        self, ops: Any, place: Any, frequency: Any, length: Any, width: float = math.inf
    ) -> Pair:
        """The sum over pairs, each with the length times its sinc, or an interval of (I6)."""
        waves = [cos_sin_turns(ops, rate * place) if rate else (1.0, 0.0) for rate in self.rates]
        real: Any = 0.0
        imag: Any = 0.0
        for shift, terms in zip(self.shifts, self.terms, strict=True):
            nu = frequency - shift
            if width < math.inf:
                half = length * (0.5 / width)
                share = wave_over_interval(ops, -half, half, nu * width)[0] * width
            else:
                share = sinc(ops, length * nu) * length
            amplitude = _amplitude(ops, terms, waves)
            real = real + share * amplitude.real
            imag = imag if self.is_real else imag + share * amplitude.imag
        return Pair(real, imag)


def _amplitude(
    ops: Any, terms: Sequence[tuple[complex, int, float]], waves: Sequence[tuple[Any, Any]]
) -> Pair:
    real: Any = 0.0
    imag: Any = 0.0
    for amplitude, number, sign in terms:
        (cosine, sine), a, b = waves[number], amplitude.real, amplitude.imag
        if a:
            real, imag = real + a * cosine, imag + (a * sign) * sine
        if b:
            real, imag = real - (b * sign) * sine, imag + b * cosine
    return Pair(real, imag)


def _wave_pairs(found: Sequence[WavePair], is_real: bool) -> _WavePairs:
    sizes = sorted({abs(rate) for wave_pair in found for _, (rate,) in wave_pair.terms})
    tolerance = _EQUAL * max(1.0, sizes[-1])
    rates: list[float] = []
    for size in sizes:
        if not rates or size - rates[-1] > tolerance:
            rates.append(0.0 if size <= tolerance else size)

    def number(size: float) -> int:
        return min(range(len(rates)), key=lambda k: abs(rates[k] - size))

    terms = tuple(
        tuple(
            (amplitude, number(abs(rate)), -1.0 if rate < 0.0 else 1.0)
            for amplitude, (rate,) in wave_pair.terms
        )
        for wave_pair in found
    )
    return _WavePairs(
        tuple(rates), tuple(wave_pair.shift[0] for wave_pair in found), terms, is_real
    )


def line_field(half: float, waves: Waves) -> LineField:
    """The field of waves, each of one frequency, on an interval."""
    means, differences = mean_pairs(waves, waves), difference_pairs(waves, waves)
    return LineField(half, waves, _wave_pairs(means, True), _wave_pairs(differences, False))
