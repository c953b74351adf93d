"""Phases of waves in cycles, complex numbers as pairs of real arrays, and means of plane waves.

The phase nu.p is computed from error-free products, so large phases keep all their digits. Numbers
may be ``Doubled``, the unrounded sum of two floats.

The mean of a plane wave over a segment, triangle or tetrahedron with the phases p_k at its n + 1
corners is n! times the divided difference of the exponential function at -2 pi i p_k (Hermite and
Genocchi). The recursion divides by the largest phase difference, or uses the Taylor series if all
phases are close together, so narrow triangles and zero frequency need no special treatment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from typing import Any

import numpy as np

from polywigner.numerics import Number

_SINE_DOUBLE = (
    25.132741228718345, -64.83584404672554, 67.07762091738222, -38.51295534186807,
    14.182954388478867, -3.646752364831226, 0.6927968586177335, -0.10127479441363349,
    0.011700148974859654, -0.0010057071302593576,
)  # fmt: skip
_SINE_SINGLE = (
    25.13274115471077, -64.8358227214753, 67.07662306642158, -38.495830637736184,
    14.049443530985526, -3.1612498251959376,
)  # fmt: skip


def polynomial(ops: Any, coefficients: Sequence[float], x: Any) -> Number:
    """Return a polynomial of x with the coefficients in ascending order (Horner's rule)."""
    *others, before, last = coefficients
    total = ops.fma(x, last, before)
    for c in others[::-1]:
        total = ops.fma(total, x, c)
    return total


def _sine_over_reduced(ops: Any, r: Any) -> Number:
    """Return sin(2 pi r)/r for |r| up to 1/2. The value at r = 0 is 2 pi."""
    coefficients = _SINE_DOUBLE if ops.double else _SINE_SINGLE
    square = r * r
    return polynomial(ops, coefficients, square) * (0.25 - square)


def _sine_of_reduced(ops: Any, r: Any) -> Number:
    """Return sin(2 pi r) for |r| up to 1/2."""
    if ops.target == "numpy":
        return np.sin(2 * math.pi * r)
    return _sine_over_reduced(ops, r) * r


def sin_cycles(ops: Any, cycles: Any) -> Number:
    """Return sin(2 pi cycles)."""
    r = cycles - ops.round(cycles)
    return np.sin(2 * math.pi * r) if ops.target == "numpy" else _sine_over_reduced(ops, r) * r


def cos_sin_cycles(ops: Any, cycles: Any) -> tuple[Any, Any]:
    """Return cos(2 pi cycles) and sin(2 pi cycles)."""
    # For jets, which are numbers with their derivatives, cosine and sine are computed together,
    # because the derivative of each contains the other.
    if hasattr(ops, "cos_sin_cycles"):
        cosine, sine = ops.cos_sin_cycles(cycles)
        return cosine, sine
    r = cycles - ops.round(cycles)
    return _sine_of_reduced(ops, 0.25 - abs(r)), _sine_of_reduced(ops, r)


def cos_sin_over_cycles(ops: Any, cycles: Any) -> tuple[Any, Any, Any]:
    """Return cos(2 pi cycles), sin(2 pi cycles), and sin(2 pi cycles)/cycles.

    The quotient is valid for |cycles| < 1/2, including 0.
    """
    r = cycles - ops.round(cycles)
    ratio = _sine_over_reduced(ops, r)
    return _sine_of_reduced(ops, 0.25 - abs(r)), ratio * r, ratio


def sinc(ops: Any, cycles: Any) -> Any:
    """Return sinc(c) = sin(pi c)/(pi c) for c = ``cycles``."""
    half = 0.5 * cycles
    reduced = half - ops.round(half)
    ratio = _sine_over_reduced(ops, reduced)
    # Near 0, the derivative of a quotient with the divisor c would have an error of one ulp divided
    # by c.
    near = abs(half) < 0.5
    quotient = ratio * reduced / ops.select(near, 1.0, half)
    return ops.select(near, ratio, quotient) * (0.5 / math.pi)


def sinc_less_one(ops: Any, cycles: Any, terms: int) -> Any:
    """Return sinc(cycles) - 1 from its power series, which is accurate for small arguments."""
    square = (math.pi * cycles) * (math.pi * cycles)
    coefficients = [(-1.0) ** k / math.factorial(2 * k + 1) for k in range(1, terms + 1)]
    return polynomial(ops, coefficients, square) * square


def mean_plane_wave(ops: Any, start: Any, end: Any) -> tuple[Any, Any]:
    """Return the mean of exp(-2 pi i p) over phases p from ``start`` to ``end``, in cycles.

    The results are two real numbers, and the mean is cosine - i sine = exp(-pi i (start + end))
    sinc(end - start).
    """
    scale = sinc(ops, end - start)
    cosine, sine = cos_sin_cycles(ops, 0.5 * (start + end))
    return scale * cosine, scale * sine


Doubled = tuple[Any, Any]

# Factor that splits a float64 into a number of 24 bits, which float32 represents exactly, and a
# remainder.
_SPLIT = 2.0**29 + 1


def doubled(value: Fraction | float, double: bool = True) -> tuple[float, float]:
    """Return the nearest float64 or float32 number, and the remainder."""
    exact = Fraction(value)
    high = float(exact) if double else float(np.float32(float(exact)))
    return high, float(exact - Fraction(high))


def dot(ops: Any, nu: tuple[Any, ...], point: tuple[Any, ...]) -> Doubled:
    """Return the scalar product nu.point as an unrounded sum of two floats.

    The components of both vectors are floats or ``Doubled``. The error is about the square of an
    ulp of |nu| |point|, even if the products cancel.
    """
    total: Any = None
    low: Any = 0.0
    for component, coordinate in zip(nu, point, strict=True):
        product, lost = _product(ops, component, coordinate)
        if total is None:
            total, low = product, lost
        else:
            total, lost_sum = difference(total, -product)
            low = low + (lost + lost_sum)
    return total, low


def _product(ops: Any, nu: Any, coordinate: Any) -> Doubled:
    """Return a product of two numbers, floats or `Doubled`, as an unrounded sum of two floats."""
    nu_high, nu_low = nu if isinstance(nu, tuple) else (nu, 0.0)
    if not isinstance(coordinate, tuple):
        coordinate = (coordinate, 0.0) if ops.double else doubled(coordinate, False)
    high, low = coordinate
    product = nu_high * high
    lost = ops.lost(nu_high, high, product)
    if isinstance(nu, tuple):
        lost = lost + nu_low * high
    return product, lost + nu_high * low


def difference(a: Any, b: Any) -> Doubled:
    """Return the rounded difference a - b, and its rounding error (Knuth).

    The sum of both results is exactly a - b.
    """
    rounded = a - b
    virtual = rounded - a
    return rounded, (a - (rounded - virtual)) - (b + virtual)


def cross(ops: Any, a: Doubled, b: Doubled, c: Doubled, d: Doubled) -> Number:
    """Return a d - b c with an error of about the square of an ulp of the products."""
    lost = (a[0] * d[1] + a[1] * d[0]) - (b[0] * c[1] + b[1] * c[0])
    return ops.cross(a[0], b[0], c[0], d[0]) + lost


def split(ops: Any, number: Doubled) -> Doubled:
    """Return a number as the sum of two floats; the first float is exact in float32."""
    total, low = number
    if not ops.double:
        return number
    # Veltkamp's method splits the number.
    scaled = total * _SPLIT
    high = scaled - (scaled - total)
    return high, (total - high) + low


def reduced(ops: Any, cycles: Doubled) -> Any:
    """Return a number of cycles minus the nearest integer, as a float from -1/2 to 1/2."""
    total, low = cycles
    return (total - ops.round(total)) + low


def cycles_to_centre(ops: Any, centre: tuple[Any, ...], *nu: Any) -> Number:
    """Return the phase nu.centre in cycles, modulo 1."""
    return reduced(ops, dot(ops, nu, centre))


def less_carrier(ops: Any, frame: Any, cycles: Any, *xi: Any) -> Number:
    """Return a phase minus ``frame.carrier . xi`` at the lag ``xi``, in cycles modulo 1."""
    if not any(frame.carrier):
        return cycles
    return cycles - cycles_to_centre(ops, frame.carrier, *xi)


def rotated(ops: Any, cycles: Any, cosine: Any, sine: Any) -> tuple[Any, Any]:
    """Return the real and imaginary part of (cosine - i sine) exp(-2 pi i cycles).

    ``cosine`` and ``sine`` are results of `mean_plane_wave`.
    """
    c, s = cos_sin_cycles(ops, cycles)
    return cosine * c - sine * s, -(cosine * s + sine * c)


@dataclass(frozen=True)
class Pair:
    """A complex number as a pair of real numbers, which may be arrays or Python floats."""

    real: Any
    imag: Any

    def __add__(self, other: Pair) -> Pair:
        return Pair(self.real + other.real, self.imag + other.imag)

    def __sub__(self, other: Pair) -> Pair:
        return Pair(self.real - other.real, self.imag - other.imag)

    def __mul__(self, other: Any) -> Pair:
        """Return the product with another pair, or with a real number."""
        if not isinstance(other, Pair):
            return self.scaled(other)
        return Pair(
            self.real * other.real - self.imag * other.imag,
            self.real * other.imag + self.imag * other.real,
        )

    def conjugate(self) -> Pair:
        """Return the complex conjugate."""
        return Pair(self.real, -self.imag)

    def scaled(self, factor: Any) -> Pair:
        """Return the product with a real number."""
        return Pair(self.real * factor, self.imag * factor)

    def plus(self, ops: Any, other: Pair, factor: Any) -> Pair:
        """Return this number plus ``other`` times a real ``factor``, with fused multiply-adds."""
        return Pair(ops.fma(other.real, factor, self.real), ops.fma(other.imag, factor, self.imag))

    def norm(self) -> Number:
        """Return the squared modulus."""
        return self.real * self.real + self.imag * self.imag


def select(ops: Any, condition: Any, a: Pair, b: Pair) -> Pair:
    """Return the complex number ``a`` if the condition is true, otherwise ``b``."""
    return Pair(ops.select(condition, a.real, b.real), ops.select(condition, a.imag, b.imag))


def unit_wave(ops: Any, cycles: Any) -> Pair:
    """Return exp(2 pi i cycles) for real cycles."""
    return Pair(*cos_sin_cycles(ops, cycles))


def one_less_exp(ops: Any, x: Any, terms: int) -> Number:
    """Return 1 - exp(-x) from its power series, which is accurate for small arguments."""
    coefficients = [(-1.0) ** k / math.factorial(k + 1) for k in range(terms)]
    return polynomial(ops, coefficients, x) * x


# Phase difference [cycles] below which a divided difference is a Taylor series. The recursion
# divides by at least 0.63 rad, so errors grow by a factor of at most 1/0.63 per order.
_SERIES_BELOW = 0.1
# Number k of terms of the Taylor series in double and in single precision. For triangles, the first
# omitted term is (k+1) 0.63^k/(k+2)!, which is 2e-18 and 7e-9, respectively. For tetrahedra, it is
# (k+1)(k+2)/2 0.63^k/(k+3)!, which is 1e-19 and 6e-9.
_TERMS_DOUBLE, _TERMS_SINGLE = 16, 9


def simplex_plane_wave(ops: Any, *corners: Any) -> tuple[Any, Any]:
    """Return the mean of a plane wave over a segment, triangle or tetrahedron.

    The mean is divided by 1, 2 or 6, respectively. One corner has the phase 0, and ``corners``
    contains the phases at the other corners in cycles. The results are two real numbers, and the
    value is cosine - i sine.
    """
    if len(corners) == 1:
        return mean_plane_wave(ops, 0.0, corners[0])
    first, last, between, size = _farthest(ops, (0.0, *corners))
    small = size < _SERIES_BELOW
    if len(between) == 1:
        ahead = Pair(*mean_plane_wave(ops, between[0], last))
        behind = Pair(*mean_plane_wave(ops, first, between[0]))
    else:
        ahead, behind = _shifted(ops, last, between), _shifted(ops, first, between)
    divisor = 2 * math.pi * ops.select(small, 1.0, last - first)
    quotient = Pair((ahead.imag - behind.imag) / divisor, (behind.real - ahead.real) / divisor)
    # Large phases are replaced by zero, so that the unused series does not overflow.
    near = [ops.select(small, corner, 0.0) * (2 * math.pi) for corner in corners]
    value = select(ops, small, _series(ops, near), quotient)
    return value.real, value.imag


def _shifted(ops: Any, origin: Any, others: Sequence[Any]) -> Pair:
    """Return cosine and sine of :func:`simplex_plane_wave` for phases ``origin`` and ``others``."""
    phase = Pair(*cos_sin_cycles(ops, origin))
    return phase * Pair(*simplex_plane_wave(ops, *(other - origin for other in others)))


def _farthest(ops: Any, nodes: Sequence[Any]) -> tuple[Any, Any, list[Any], Any]:
    """Return the two phases that are farthest apart, all other phases, and the largest distance."""
    (first, last, *between), origin = nodes, nodes[0]
    largest = abs(last)

    def chosen(wins: Any, a: Any, b: Any) -> Any:
        """Return ``a`` if the current pair of phases is the farthest so far, otherwise ``b``."""
        return a if a is b else ops.select(wins, a, b)

    for i, j in list(combinations(range(len(nodes)), 2))[1:]:
        size = abs(nodes[j] if nodes[i] is origin else nodes[j] - nodes[i])
        wins = size > largest
        largest = ops.maximum(size, largest)
        first, last = chosen(wins, nodes[i], first), chosen(wins, nodes[j], last)
        others = [node for k, node in enumerate(nodes) if k not in (i, j)]
        between = [chosen(wins, a, b) for a, b in zip(others, between, strict=True)]
    return first, last, between, largest


def _series(ops: Any, nodes: Sequence[Any]) -> Pair:
    """Return the Taylor series of :func:`simplex_plane_wave` for small ``corners`` in radians."""
    count = len(nodes)
    powers: list[Any] = [nodes[-1]]
    for node in nodes[-2::-1]:
        powers.append(node + powers[-1])
    sums = [1 / math.factorial(count), powers[-1] * (1 / math.factorial(count + 1))]
    for k in range(2, _TERMS_DOUBLE if ops.double else _TERMS_SINGLE):
        powers[0] = powers[0] * nodes[-1]
        for m, node in enumerate(nodes[-2::-1], start=1):
            powers[m] = ops.fma(node, powers[m], powers[m - 1])
        factor = (1.0 if k % 4 < 2 else -1.0) / math.factorial(k + count)
        sums[k % 2] = ops.fma(powers[-1], factor, sums[k % 2])
    return Pair(*sums)
