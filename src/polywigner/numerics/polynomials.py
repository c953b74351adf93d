"""Polynomials along a segment, their moments with a wave, and band-limited interpolation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import zip_longest
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.numerics.phases import cos_sin_over_turns, polynomial

Polynomial = Sequence[Any]
"""Coefficients of 1, t, t^2, ..."""


def added(first: Polynomial, second: Polynomial) -> list[Any]:
    """The sum."""
    return [b if a is None else a if b is None else a + b for a, b in zip_longest(first, second)]


def scaled(polynomial: Polynomial, factor: Any) -> list[Any]:
    """A multiple; nothing is multiplied by a constant 1."""
    if isinstance(factor, float) and factor == 1.0:
        return list(polynomial)
    return [coefficient * factor for coefficient in polynomial]


def multiplied(first: Polynomial, second: Polynomial) -> list[Any]:
    """The product."""
    result: list[Any] = [None] * (len(first) + len(second) - 1)
    for i, a in enumerate(first):
        for j, b in enumerate(second):
            product = b if isinstance(a, float) and a == 1.0 else a * b
            known = result[i + j]
            result[i + j] = product if known is None else known + product
    return result


# Largest power -> x = pi turns below which Bessel functions come from series, since the recurrence
# upwards loses (2n - 1)!!/x^(n+1) ulps, 3 for either; and the number of terms in double and single
# precision. Omitted term of j_2 for x = 1: 1e-17 and 2e-9; for x = 2 of j_2: 4e-18 and 8e-10, of
# j_4: 4e-17 and 9e-11.
_SERIES = {2: (1.0, 9, 4), 4: (2.0, 10, 6)}


def segment_moments(ops: Any, half: Any, order: int) -> tuple[Any, ...]:
    """e_n = integral of t^n exp(-4 pi i half t) over -1/2 < t < 1/2, n = 0 ... order (2 or 4).

    ``half`` the turns of the wave over half of the segment. Real for even n; for odd n the
    imaginary part. By spherical Bessel functions of x = 2 pi half: ``e0 = j0, e1 = -j1/2, e2 = (j0
    - 2 j2)/12, e3 = (2 j3 - 3 j1)/40, e4 = (7 j0 - 20 j2 + 8 j4)/560``. Absolute errors of a few
    ulps of 2^-n/(n + 1).
    """
    fma = ops.fma
    j0, j1, j2, *higher = _bessel(ops, half, order)
    found = j0, -0.5 * j1, fma(j2, -1 / 6, j0 * (1 / 12))
    if not higher:
        return found
    j3, j4 = higher
    return (
        *found,
        fma(j3, 1 / 20, j1 * (-3 / 40)),
        fma(j4, 1 / 70, fma(j2, -1 / 28, j0 * (1 / 80))),
    )


def _bessel(ops: Any, half: Any, order: int) -> list[Any]:
    """j_0 ... j_order of x = 2 pi half.

    Where x is small the even ones come from series and the odd ones from their neighbours, x (j_n-1
    + j_n+1)/(2n + 1), which loses nothing; else from the recurrence upwards.
    """
    below, double, single = _SERIES[order]
    x = 2 * math.pi * half
    small = abs(x) < below
    inverse = 1.0 / ops.select(small, 1.0, x)
    cosine, sine, ratio = cos_sin_over_turns(ops, half)
    values = [ops.select(small, ratio * (0.5 / math.pi), sine * inverse)]
    square = ops.select(small, x * x, 0.0)  # no overflow in the branch not taken
    power: Any = 1.0
    for n in range(2, order + 1, 2):
        power = square * power
        even = power * _over_power(ops, n, square, double if ops.double else single)
        odd = (x * (1 / (2 * n - 1))) * (values[-1] + even)
        values.append(ops.select(small, odd, _next(ops, n - 1, values, inverse, cosine)))
        values.append(ops.select(small, even, _next(ops, n, values, inverse, cosine)))
    return values


def _next(ops: Any, n: int, values: list[Any], inverse: Any, cosine: Any) -> Any:
    """j_n from those before it; j_-1 is the cosine over x."""
    if n == 1:
        return (values[0] - cosine) * inverse
    return ops.fma((2.0 * n - 1.0) * inverse, values[n - 1], -values[n - 2])


def _over_power(ops: Any, n: int, square: Any, terms: int) -> Any:
    """j_n(x)/x^n by its series in x^2."""
    coefficients = [1 / math.prod(range(1, 2 * n + 2, 2))]
    for k in range(1, terms + 1):
        coefficients.append(coefficients[-1] * -0.5 / (k * (2 * n + 2 * k + 1)))
    return polynomial(ops, coefficients, square)


RATE = 2.5
# Samples under the kernel: the worst wave errs by 5e-13 and 6e-8, as measured.
_WIDTH = {True: 13, False: 8}
# Degree of the kernel's polynomials: a higher one changes nothing.
_DEGREE = {True: 13, False: 8}
# Terms of the kernel's transform: more change nothing.
_TERMS = 24
# beta over Barnett's estimate, pi width (1 - 1/(2 rate)): the best, as measured
_SHARE_OF_BETA = 0.99

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Interpolation:
    """A kernel of ``width`` samples."""

    width: int
    coefficients: Floats
    """(width, terms) the weight of each sample as a polynomial of s, twice the distance of a place
    from the middle of the samples, -1 <= s <= 1."""

    def weights(self, ops: Any, s: Any) -> list[Any]:
        """Weights of all samples around a place; those on either side are mirror images."""
        square = s * s
        first, last = [], []
        for row in self.coefficients[: (self.width + 1) // 2]:
            even, odd = (polynomial(ops, part.tolist(), square) for part in (row[0::2], row[1::2]))
            first.append(ops.fma(s, odd, even))
            last.append(ops.fma(-s, odd, even))
        return first + last[: self.width // 2][::-1]

    def transform(self, frequencies: Floats) -> Floats:
        """The factor on waves of so many periods a sample when they are summed over the samples.

        Up to 1/(2 RATE) periods, the most that a table has.
        """
        u = 2 * (2 * RATE * frequencies) ** 2 - 1
        return np.asarray(np.polynomial.chebyshev.chebval(u, self._transform), dtype=np.float64)

    @cached_property
    def _transform(self) -> Floats:
        """The transform, an entire function of the square of the frequency, in Chebyshev's terms.

        By itself, it is an integral for every pair of sites of a row. Waves turn by 9 radians under
        the kernel at most, so that the terms fall below an ulp from the 16th on.
        """
        node, weight = np.polynomial.legendre.leggauss(40)
        values = np.polynomial.polynomial.polyval(node, self.coefficients.T)  # (width, nodes)
        place = np.arange(self.width)[:, None] - (self.width - 1) / 2 - node / 2
        u = np.polynomial.chebyshev.chebpts1(_TERMS)
        frequencies = np.sqrt((u + 1) / 2) / (2 * RATE)
        waves = np.cos(2 * np.pi * np.multiply.outer(frequencies, place))
        exact = (waves * (values * (weight / 2))).sum(axis=(-2, -1))
        found = np.polynomial.chebyshev.chebfit(u, exact, _TERMS - 1)
        return np.asarray(found, dtype=np.float64)


@lru_cache(maxsize=2)
def interpolation(double: bool) -> Interpolation:
    """The kernel of a precision."""
    width, degree = _WIDTH[double], _DEGREE[double]
    beta = _SHARE_OF_BETA * math.pi * width * (1 - 1 / (2 * RATE))
    nodes = np.polynomial.chebyshev.chebpts1(degree + 1)
    place = np.arange(width)[:, None] - (width - 1) / 2 - nodes / 2
    kernel = np.exp(beta * (np.sqrt(1 - (2 / width * place) ** 2) - 1))
    rows = [
        np.polynomial.chebyshev.cheb2poly(np.polynomial.chebyshev.chebfit(nodes, row, degree))
        for row in kernel
    ]
    return Interpolation(width, np.array(rows))
