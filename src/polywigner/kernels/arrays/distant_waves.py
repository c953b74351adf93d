"""Waves on a source made of distant parts, and phases between them that no rounding spoils."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from polywigner.kernels.functions.stokes import moved_off_zero
from polywigner.kernels.kernel import Values
from polywigner.kernels.outline.waves import WavePair
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns

__all__ = ["NUMBERS", "DistantWave", "Point", "less"]

Point = tuple[phases.Doubled, phases.Doubled]

NUMBERS = 8
"""Numbers that make up a wave: its frequency, the frequency moved off zero, its amplitude."""


def less(ops: Any, value: Any, constant: float) -> phases.Doubled:
    """value - constant, without rounding."""
    high, low = phases.doubled(constant, ops.double)
    total, rest = phases.difference(value, high)
    return total, rest - low


@dataclass(frozen=True)
class DistantWave:
    """A wave_pair of the waves on the source: the frequency that it sees, and its amplitude."""

    ops: Any
    nu: Point
    x: Any
    """nu again, moved off zero."""
    y: Any
    amplitude: Pair
    """Over that of the edge sum."""

    @classmethod
    def of(cls, ops: Any, wave_pair: WavePair, nu: Point, place: Point) -> DistantWave:
        first, second = (_shifted(ops, *pair) for pair in zip(nu, wave_pair.shift, strict=True))
        x, y = moved_off_zero(ops, first[0] + first[1], second[0] + second[1])
        scale = 1.0 / (2 * math.pi * ops.fma(x, x, y * y))
        return cls(ops, (first, second), x, y, _amplitude(ops, wave_pair, place).scaled(scale))

    @property
    def numbers(self) -> Values:
        return (*self.nu[0], *self.nu[1], self.x, self.y, self.amplitude.real, self.amplitude.imag)

    @classmethod
    def from_numbers(cls, ops: Any, numbers: Sequence[Any]) -> DistantWave:
        a, b, c, d, x, y, real, imag = numbers
        return cls(ops, ((a, b), (c, d)), x, y, Pair(real, imag))

    def across(self, apart: Point) -> Pair:
        """exp(-2 pi i nu.apart)."""
        cosine, sine = cos_sin_turns(self.ops, _turns(self.ops, self.nu, apart))
        return Pair(cosine, -sine)

    def along(self, x: Any, y: Any) -> Any:
        return self.ops.fma(self.x, x, self.y * y)


def _shifted(ops: Any, frequency: phases.Doubled, shift: float) -> phases.Doubled:
    if not shift:
        return frequency
    total, rest = less(ops, frequency[0], shift)
    return total, rest + frequency[1]


def _amplitude(ops: Any, wave_pair: WavePair, place: Point) -> Pair:
    """The factor of a wave_pair at a position or lag."""
    total = Pair(0.0, 0.0)
    for amplitude, rate in wave_pair.terms:
        term = Pair(complex(amplitude).real, complex(amplitude).imag)
        if any(rate):
            term = term * Pair(*cos_sin_turns(ops, _turns(ops, place, rate)))
        total = total + term
    return Pair(total.real, 0.0) if wave_pair.is_real else total


def _turns(ops: Any, one: Sequence[Any], other: Sequence[Any]) -> Any:
    return phases.reduced(ops, phases.dot(ops, tuple(one), tuple(other)))
