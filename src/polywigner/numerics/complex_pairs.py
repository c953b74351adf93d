"""Complex arithmetic on pairs of real arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from polywigner.numerics import Number
from polywigner.numerics.phases import cos_sin_cycles


@dataclass(frozen=True)
class Pair:
    """The complex number real + i imag, for arrays of any engine or Python floats."""

    real: Any
    imag: Any

    def __add__(self, other: Pair) -> Pair:
        return Pair(self.real + other.real, self.imag + other.imag)

    def __sub__(self, other: Pair) -> Pair:
        return Pair(self.real - other.real, self.imag - other.imag)

    def __mul__(self, other: Any) -> Pair:
        """Return the product with a pair, or with a real number."""
        if not isinstance(other, Pair):
            return self.scaled(other)
        return Pair(
            self.real * other.real - self.imag * other.imag,
            self.real * other.imag + self.imag * other.real,
        )

    def conjugate(self) -> Pair:
        return Pair(self.real, -self.imag)

    def scaled(self, factor: Any) -> Pair:
        return Pair(self.real * factor, self.imag * factor)

    def plus(self, ops: Any, other: Pair, factor: Any) -> Pair:
        """Return self + other factor, by fused multiply-adds if the engine has them."""
        return Pair(ops.fma(other.real, factor, self.real), ops.fma(other.imag, factor, self.imag))

    def norm(self) -> Number:
        """Return the squared modulus."""
        return self.real * self.real + self.imag * self.imag


def select(ops: Any, condition: Any, a: Pair, b: Pair) -> Pair:
    return Pair(ops.select(condition, a.real, b.real), ops.select(condition, a.imag, b.imag))


def unit_wave(ops: Any, cycles: Any) -> Pair:
    """Return exp(2 pi i cycles) for real cycles."""
    return Pair(*cos_sin_cycles(ops, cycles))


def decaying_sinh(ops: Any, a: Any, decay: Any) -> Number:
    """Return sinh(a) exp(-a) for a >= 0, with ``decay`` = exp(-a).

    For small a, 1 - exp(-2a) would cancel, so the series of sinh is used. Its first omitted term is
    0.5^14/15! = 5e-17 of sinh.
    """
    small = a < 0.5
    clamped = ops.select(small, a, 0.0)
    square = clamped * clamped
    series: Any = 1 / math.factorial(13)
    for order in (11, 9, 7, 5, 3, 1):
        series = ops.fma(series, square, 1 / math.factorial(order))
    return ops.select(small, series * clamped * decay, 0.5 - 0.5 * (decay * decay))
