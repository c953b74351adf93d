"""Complex arithmetic on pairs of real arrays, for kernels with complex spatial frequencies.

A wave exp(-2 pi i p) with complex p grows as exp(2 pi Im p). Waves are computed relative to a
``level``, exp(2 pi level) at least as large as any of them, so that none overflows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from polywigner.numerics import Number
from polywigner.numerics.phases import cos_sin_turns


@dataclass(frozen=True)
class Pair:
    """real + i imag, of any engine's arrays or Python floats."""

    real: Any
    imag: Any

    def __add__(self, other: Pair) -> Pair:
        return Pair(self.real + other.real, self.imag + other.imag)

    def __sub__(self, other: Pair) -> Pair:
        return Pair(self.real - other.real, self.imag - other.imag)

    def __mul__(self, other: Any) -> Pair:
        """The product with a pair, or with a real number."""
        if not isinstance(other, Pair):
            return self.scaled(other)
        return Pair(
            self.real * other.real - self.imag * other.imag,
            self.real * other.imag + self.imag * other.real,
        )

    def __truediv__(self, other: Pair) -> Pair:
        return (self * other.conjugate()).scaled(1.0 / other.norm())

    def conjugate(self) -> Pair:
        return Pair(self.real, -self.imag)

    def scaled(self, factor: Any) -> Pair:
        return Pair(self.real * factor, self.imag * factor)

    def plus(self, ops: Any, other: Pair, factor: Any) -> Pair:
        """self + other factor, rounded once where the engine can."""
        return Pair(ops.fma(other.real, factor, self.real), ops.fma(other.imag, factor, self.imag))

    def norm(self) -> Number:
        """Squared modulus."""
        return self.real * self.real + self.imag * self.imag


def select(ops: Any, condition: Any, a: Pair, b: Pair) -> Pair:
    return Pair(ops.select(condition, a.real, b.real), ops.select(condition, a.imag, b.imag))


def unit_wave(ops: Any, turns: Any) -> Pair:
    """exp(2 pi i turns) for real turns."""
    return Pair(*cos_sin_turns(ops, turns))


def plane_wave(ops: Any, turns: Pair, level: Any = 0.0) -> Pair:
    """exp(-2 pi i turns) exp(-2 pi level)."""
    wave = unit_wave(ops, turns.real).conjugate()
    return wave.scaled(ops.exp(2 * math.pi * (turns.imag - level)))


def mean_wave(ops: Any, start: Pair, end: Pair, level: Any = 0.0) -> Pair:
    """Mean of exp(-2 pi i p) exp(-2 pi level) over the straight path from ``start`` to ``end``."""
    top = Pair(0.5 * (start.real + end.real), ops.maximum(start.imag, end.imag))
    return plane_wave(ops, top, level) * _decaying_sinc(ops, end - start)


def _decaying_sinc(ops: Any, z: Pair) -> Pair:
    """sin(pi z)/(pi z) exp(-pi |Im z|) for complex z; nowhere larger than 1."""
    floor = 1e-30 if ops.double else 1e-15
    nonzero = z.norm() >= floor * floor
    safe = select(ops, nonzero, z, Pair(floor, 0.0))
    cosine, sine = cos_sin_turns(ops, 0.5 * safe.real)
    growth = math.pi * abs(safe.imag)
    decay = ops.exp(-growth)
    cosh = 0.5 + 0.5 * (decay * decay)
    sinh = decaying_sinh(ops, growth, decay)
    sinh = ops.select(safe.imag < 0.0, -sinh, sinh)
    return Pair(sine * cosh, cosine * sinh) / safe.scaled(math.pi)


def decaying_sinh(ops: Any, a: Any, decay: Any) -> Number:
    """sinh(a) exp(-a) for a >= 0, exp(-a) given: by the series of sinh where 1 - exp(-2a) cancels.

    First omitted term of the series: 0.5^14/15! = 5e-17 of sinh.
    """
    small = a < 0.5
    clamped = ops.select(small, a, 0.0)
    square = clamped * clamped
    series: Any = 1 / math.factorial(13)
    for order in (11, 9, 7, 5, 3, 1):
        series = ops.fma(series, square, 1 / math.factorial(order))
    return ops.select(small, series * clamped * decay, 0.5 - 0.5 * (decay * decay))
