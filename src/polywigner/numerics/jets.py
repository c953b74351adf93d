"""Automatic differentiation in forward mode, for formulas of kernels.

A jet is a number with its derivatives. Jets of jets contain second derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from polywigner.numerics import Mask, Number
from polywigner.numerics.phases import cos_sin_cycles

# Smallest divisor in derivatives. Derivatives of roots and angles with a smaller divisor are
# inaccurate.
_LEAST = 1e-150

Derivatives = tuple[Any, ...]


class Jet:
    """A number or array, and its derivatives with respect to variables.

    The derivatives of a constant are an empty tuple. All arrays in a formula must be jets, because
    Dr.Jit arrays do not accept jets as operands.
    """

    def __init__(self, ops: Any, value: Any, derivatives: Derivatives = ()) -> None:
        self.ops, self.value, self.derivatives = ops, value, derivatives

    def chained(self, value: Any, derivative: Any) -> Jet:
        """Return f(x) as a jet from the value and the derivative of f, where x is this jet."""
        return Jet(self.ops, value, tuple(derivative * d for d in self.derivatives))

    def __add__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.ops, self.value + other, self.derivatives)
        return Jet(self.ops, self.value + other.value, _sums(self.derivatives, other.derivatives))

    def __mul__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return self.chained(self.value * other, other)
        first, second = self.chained(0.0, other.value), other.chained(0.0, self.value)
        derivatives = _sums(first.derivatives, second.derivatives)
        return Jet(self.ops, self.value * other.value, derivatives)

    def __truediv__(self, other: Any) -> Jet:
        return self * (1.0 / other)

    def __rtruediv__(self, other: Any) -> Jet:
        inverse = 1.0 / self.value
        return self.chained(other * inverse, -other * inverse * inverse)

    def __neg__(self) -> Jet:
        return self.chained(-self.value, -1.0)

    def __sub__(self, other: Any) -> Jet:
        return self + -other

    def __rsub__(self, other: Any) -> Jet:
        return -self + other

    def __abs__(self) -> Jet:
        negative = self.value < 0.0
        derivatives = tuple(self.ops.select(negative, -d, d) for d in self.derivatives)
        return Jet(self.ops, abs(self.value), derivatives)

    def __lt__(self, other: Any) -> Mask:
        return self.value < _value_of(other)

    def __gt__(self, other: Any) -> Mask:
        return self.value > _value_of(other)

    def __ge__(self, other: Any) -> Mask:
        return self.value >= _value_of(other)

    __radd__, __rmul__ = __add__, __mul__


def _sums(a: Derivatives, b: Derivatives) -> Derivatives:
    """Return the sum of two tuples of derivatives. An empty tuple stands for zeros."""
    return tuple(p + q for p, q in zip(a, b, strict=True)) if a and b else a or b


def _value_of(number: Any) -> Number:
    """Return the value of a jet without derivatives; a number that is not a jet is unchanged."""
    return number.value if isinstance(number, Jet) else number


class JetOperations:
    """Operations of kernels on jets and on Python floats."""

    def __init__(self, ops: Any) -> None:
        self._ops, self.double = ops, ops.double

    def variables(self, values: Sequence[Any]) -> tuple[Jet, ...]:
        """Return numbers as independent variables: jets with unit vectors as derivatives."""
        count = range(len(values))
        return tuple(
            Jet(self._ops, value, tuple(0.0 * value + float(m == n) for m in count))
            for n, value in enumerate(values)
        )

    def constants(self, values: Iterable[Any]) -> tuple[Jet, ...]:
        """Return numbers as jets that do not depend on the variables."""
        return tuple(Jet(self._ops, value) for value in values)

    def select(self, condition: Any, a: Any, b: Any) -> Jet:
        """Return ``a`` if the condition is true, otherwise ``b``, as a jet."""
        first, second = (number.derivatives if isinstance(number, Jet) else () for number in (a, b))
        if first or second:
            count = len(first or second)
            pairs = zip(first or (0.0,) * count, second or (0.0,) * count, strict=True)
            first = tuple(self._ops.select(condition, p, q) for p, q in pairs)
        return Jet(self._ops, self._ops.select(condition, _value_of(a), _value_of(b)), first)

    def maximum(self, a: Any, b: Any) -> Jet:
        """Return the larger of two jets or numbers, as a jet."""
        return self.select(a > b, a, b)

    def minimum(self, a: Any, b: Any) -> Jet:
        """Return the smaller of two jets or numbers, as a jet."""
        return self.select(a < b, a, b)

    def sqrt(self, a: Jet) -> Jet:
        """Return the square root of a jet."""
        root = self._ops.sqrt(a.value)
        return a.chained(root, 0.5 / self._ops.maximum(root, _LEAST))

    def cos_sin_cycles(self, a: Jet) -> tuple[Jet, Jet]:
        """Return cos(2 pi a) and sin(2 pi a) as jets."""
        cosine, sine = cos_sin_cycles(self._ops, a.value)
        rate = 2.0 * math.pi
        return a.chained(cosine, -rate * sine), a.chained(sine, rate * cosine)

    def exp(self, a: Jet) -> Jet:
        """Return the exponential function of a jet."""
        value = self._ops.exp(a.value)
        return a.chained(value, value)

    def log(self, a: Jet) -> Jet:
        """Return the natural logarithm of a jet."""
        return a.chained(self._ops.log(a.value), 1.0 / a.value)

    def atan2(self, y: Jet, x: Jet) -> Jet:
        """Return the angle of the vector (x, y) in radians as a jet."""
        inverse = 1.0 / self._ops.maximum(y.value * y.value + x.value * x.value, _LEAST)
        by_y, by_x = y.chained(0.0, x.value * inverse), x.chained(0.0, -y.value * inverse)
        derivatives = _sums(by_y.derivatives, by_x.derivatives)
        return Jet(self._ops, self._ops.atan2(y.value, x.value), derivatives)


def flattened(numbers: Iterable[Any]) -> list[Any]:
    """Return the values and derivatives of jets, and numbers that are not jets, as a flat list."""
    parts: list[Any] = []
    for number in numbers:
        parts += [number.value, *number.derivatives] if isinstance(number, Jet) else [number]
    return parts


def rebuilt(like: Iterable[Any], parts: Iterable[Any]) -> list[Any]:
    """Return jets and numbers with the structure of ``like``; the inverse of :func:`flattened`."""
    remaining = iter(parts)
    return [
        Jet(number.ops, next(remaining), tuple(next(remaining) for _ in number.derivatives))
        if isinstance(number, Jet)
        else next(remaining)
        for number in like
    ]
