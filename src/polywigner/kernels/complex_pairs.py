"""Complex arithmetic on pairs of real arrays, for kernels with complex spatial frequencies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from polywigner.kernels.trigonometry import cos_sin_turns

__all__ = ["Pair", "plane_wave", "select", "sinc"]


@dataclass(frozen=True)
class Pair:
    """real + i imag, of any engine's arrays or Python floats."""

    real: Any
    imag: Any

    def __add__(self, other: Pair) -> Pair:
        return Pair(self.real + other.real, self.imag + other.imag)

    def __sub__(self, other: Pair) -> Pair:
        return Pair(self.real - other.real, self.imag - other.imag)

    def __mul__(self, other: Pair) -> Pair:
        return Pair(
            self.real * other.real - self.imag * other.imag,
            self.real * other.imag + self.imag * other.real,
        )

    def __truediv__(self, other: Pair) -> Pair:
        return (self * Pair(other.real, -other.imag)).scaled(1.0 / other.norm())

    def scaled(self, factor: Any) -> Pair:
        return Pair(self.real * factor, self.imag * factor)

    def norm(self) -> Any:
        """Squared modulus."""
        return self.real * self.real + self.imag * self.imag


def select(ops: Any, condition: Any, a: Pair, b: Pair) -> Pair:
    return Pair(ops.select(condition, a.real, b.real), ops.select(condition, a.imag, b.imag))


def plane_wave(ops: Any, turns: Pair) -> Pair:
    """exp(-2 pi i turns) for complex turns."""
    cosine, sine = cos_sin_turns(ops, turns.real)
    return Pair(cosine, -sine).scaled(ops.exp(2 * math.pi * turns.imag))


def _sinh(ops: Any, y: Any) -> Any:
    """sinh to full relative accuracy: by its series where the difference of exponentials cancels.

    First omitted term of the series: 0.5^14/15! = 5e-17 of sinh.
    """
    small = abs(y) < 0.5
    clamped = ops.select(small, y, 0.0)
    square = clamped * clamped
    series: Any = 1 / math.factorial(13)
    for order in (11, 9, 7, 5, 3, 1):
        series = ops.fma(series, square, 1 / math.factorial(order))
    growing = ops.exp(ops.select(small, 0.0, y))
    return ops.select(small, series * clamped, 0.5 * (growing - 1.0 / growing))


def sinc(ops: Any, z: Pair) -> Pair:
    """sin(pi z)/(pi z) for complex z."""
    floor = 1e-30 if ops.double else 1e-15
    nonzero = z.norm() >= floor * floor
    safe = select(ops, nonzero, z, Pair(floor, 0.0))
    cosine, sine = cos_sin_turns(ops, 0.5 * safe.real)
    sinh = _sinh(ops, math.pi * safe.imag)
    cosh = ops.sqrt(ops.fma(sinh, sinh, 1.0))
    return Pair(sine * cosh, cosine * sinh) / safe.scaled(math.pi)
