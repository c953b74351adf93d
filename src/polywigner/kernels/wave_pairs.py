"""Plane waves on a source, and the contributions of pairs of waves to W and A.

The field on a source is ``sum_m c_m exp(2 pi i kappa_m.x)``. W and A are sums over pairs of waves,
(I2) and (I3) of docs/theory.md. Each term is W or A of the uniform source at a shifted frequency,
times a factor that depends only on position or lag. Pairs with the same frequency shift form one
`WavePair`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import numpy as np

from polywigner.numerics import cluster_indices
from polywigner.numerics.phases import Pair, cos_sin_cycles

# Relative difference below which frequencies are treated as equal. Sums of frequencies in a
# different order differ by rounding errors.
_EQUAL = 1e-14

Vector = tuple[Any, ...]


@dataclass(frozen=True)
class Wave:
    """A plane wave in the frame of a source, relative to the carrier."""

    amplitude: complex
    frequency: Vector


Waves = tuple[Wave, ...]
UNIFORM: Waves = (Wave(1.0, (0.0, 0.0)),)


def carrier_of(illuminations: Iterable[Any], dimension: int) -> Vector:
    """Return the carrier frequency of a source: the centre of the frequencies of its waves.

    The centre is the midpoint of the range of the frequencies along each axis. The illumination
    None is uniform.
    """
    still = np.zeros((1, dimension))
    frequencies = np.concatenate([still if i is None else i.frequencies for i in illuminations])
    return tuple((frequencies.min(axis=0) / 2 + frequencies.max(axis=0) / 2).tolist())


def waves_in_frame(illumination: Any, frame: Any) -> Waves:
    """Return the plane waves of an illumination in a frame, relative to the frame's carrier.

    The illumination None is uniform.
    """
    if illumination is None:
        pairs = [(1.0, [0.0] * len(frame.centre))]
    else:
        pairs = list(zip(illumination.amplitudes, illumination.frequencies.tolist(), strict=True))
    waves = []
    for amplitude, frequency in pairs:
        cycles = sum(
            Fraction(k) * Fraction(c) for k, c in zip(frequency, frame.centre, strict=True)
        )
        phase = np.exp(2j * np.pi * float(cycles - round(cycles)))
        relative = (k - c for k, c in zip(frequency, frame.carrier, strict=True))
        waves.append(Wave(complex(amplitude * phase), tuple(frame.exact_frequency(*relative))))
    return tuple(waves)


def field_of(ops: Any, waves: Waves, point: Sequence[Any]) -> tuple[Any, Any]:
    """Return the real and imaginary part of the field at a point, without the carrier."""
    return _sum_of_waves(ops, tuple((w.amplitude, w.frequency) for w in waves), point)


@dataclass(frozen=True)
class WavePair:
    """Pairs of plane waves with the same frequency shift."""

    shift: Vector
    """Frequency to be subtracted from the frequency argument of W or A."""
    terms: tuple[tuple[Any, Vector], ...]
    """Amplitude of each pair, and the frequency with which it oscillates over positions or lags."""
    is_real: bool
    """Whether the terms include their complex conjugates, so that the sum is real."""

    def amplitude(self, ops: Any, point: Sequence[Any]) -> tuple[Any, Any]:
        """Return the real and imaginary part of the amplitude at a position or lag."""
        real, imag = _sum_of_waves(ops, self.terms, point, imaginary=not self.is_real)
        return real, imag

    def gradient(self, ops: Any, point: Sequence[Any]) -> list[tuple[Any, Any]]:
        """Return the real and imaginary part of the derivative of the amplitude along each axis."""
        result = []
        for k in range(len(point)):
            turned = tuple((2j * math.pi * f[k] * a, f) for a, f in self.terms if f[k])
            real, imag = _sum_of_waves(ops, turned, point, imaginary=not self.is_real)
            result.append((real, imag))
        return result

    def detuned(self, frequency: Sequence[Any]) -> tuple[Any, ...]:
        """Return a frequency minus the frequency shift of the pairs."""
        pairs = zip(frequency, self.shift, strict=True)
        return tuple(f if _is_zero(s) else f - s for f, s in pairs)

    @cached_property
    def is_unit(self) -> bool:
        """Whether the pair belongs to a uniform source, with a shift of 0 and an amplitude of 1."""
        return self.is_constant and not any(self.shift) and self.terms == ((1.0, (0.0, 0.0)),)

    @property
    def is_constant(self) -> bool:
        """Whether the shift consists of Python floats."""
        return all(isinstance(component, float) for component in self.shift)


def rows_of(wave_pairs: Sequence[WavePair]) -> list[tuple[float, ...]]:
    """Return all pairs of waves as rows (real, imag, shift x, shift y, rate x, rate y)."""
    return [
        (complex(amplitude).real, complex(amplitude).imag, *wave_pair.shift, *rate)
        for wave_pair in wave_pairs
        for amplitude, rate in wave_pair.terms
    ]


def pair_of_row(is_real: bool, real: Any, imag: Any, *vectors: Any) -> WavePair:
    """Return the pair of waves in a row of `rows_of`."""
    return WavePair(vectors[:2], ((Pair(real, imag), vectors[2:]),), is_real)


def _is_zero(number: Any) -> bool:
    """Return whether a number is the constant 0.0. The result is False for arrays."""
    # The values of arrays are not available while a function is traced.
    return isinstance(number, float) and number == 0.0


def _sum_of_waves(
    ops: Any,
    terms: tuple[tuple[Any, Vector], ...],
    point: Sequence[Any],
    imaginary: bool = True,
) -> tuple[Any, Any]:
    """Return the real and imaginary part of the sum of a exp(2 pi i f.x) over terms (a, f).

    ``point`` is x. If ``imaginary`` is false, the imaginary part is 0.0.
    """
    real: Any = 0.0
    imag: Any = 0.0
    for amplitude, frequency in terms:
        if all(map(_is_zero, frequency)):
            real, imag = real + amplitude.real, imag + amplitude.imag
            continue
        cycles = sum(f * p for f, p in zip(frequency, point, strict=True))
        cosine, sine = cos_sin_cycles(ops, cycles)
        real = real + (cosine * amplitude.real - sine * amplitude.imag)
        if imaginary:
            imag = imag + (cosine * amplitude.imag + sine * amplitude.real)
    return real, imag if imaginary else 0.0


@lru_cache(maxsize=1024)
def mean_pairs(first: Waves, second: Waves, is_same: bool) -> tuple[WavePair, ...]:
    """Return the pairs of waves that contribute to the Wigner function W.

    ``is_same`` specifies that both fields belong to the same elements. The pairs (m, n) and (n, m)
    are then complex conjugates and form a single pair with twice the amplitude.
    """
    pairs = [
        (mean, (2.0 if is_same and m < n else 1.0) * amplitude, difference)
        for m, n, amplitude, mean, difference in _products(first, second)
        if not is_same or m <= n
    ]
    return _merged(pairs, is_real=is_same)


@lru_cache(maxsize=1024)
def difference_pairs(first: Waves, second: Waves) -> tuple[WavePair, ...]:
    """Return the pairs of waves that contribute to the ambiguity function A."""
    pairs = [(diff, amplitude, mean) for _, _, amplitude, mean, diff in _products(first, second)]
    return _merged(pairs, is_real=False)


def _products(first: Waves, second: Waves) -> Iterator[tuple[int, int, complex, Vector, Vector]]:
    """Yield m, n, the product a_m a_n* of amplitudes, and mean and difference of frequencies."""
    for (m, wave), (n, second_wave) in product(enumerate(first), enumerate(second)):
        components = list(zip(wave.frequency, second_wave.frequency, strict=True))
        mean = tuple(0.5 * (a + b) for a, b in components)
        amplitude = wave.amplitude * complex(second_wave.amplitude).conjugate()
        yield m, n, amplitude, mean, tuple(a - b for a, b in components)


def _merged(pairs: Sequence[tuple[Vector, complex, Vector]], is_real: bool) -> tuple[WavePair, ...]:
    """Return pairs of waves (shift, amplitude, rate), merged into one `WavePair` for each shift."""
    shifts = np.array([shift for shift, _, _ in pairs])
    numbers = cluster_indices(shifts, _EQUAL * max(1.0, float(np.abs(shifts).max())))
    collected: dict[int, tuple[Vector, dict[Vector, complex]]] = {}
    for number, (shift, amplitude, rate) in zip(numbers.tolist(), pairs, strict=True):
        _, terms = collected.setdefault(number, (shift, {}))
        terms[rate] = terms.get(rate, 0.0) + amplitude
    return tuple(
        WavePair(shift, tuple((a, r) for r, a in terms.items()), is_real)
        for shift, terms in collected.values()
    )
