"""Moments of a wave along a segment, and band-limited interpolation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.numerics.phases import cos_sin_over_turns, polynomial

# x = pi turns below which Bessel functions come from series, since the recurrence upwards loses
# 3/x^3 ulps; and the number of terms in double and single precision. The omitted term of j_2 for
# x = 1 is 1e-17 and 2e-9.
_BELOW, _DOUBLE, _SINGLE = 1.0, 9, 4


def segment_moments(ops: Any, half: Any) -> tuple[Any, Any, Any]:
    """e_n = integral of t^n exp(-4 pi i half t) over -1/2 < t < 1/2, n = 0, 1, 2.

    ``half``: the turns of the wave over half of the segment. Real for even n; for n = 1 the
    imaginary part. By spherical Bessel functions of x = 2 pi half: ``e0 = j0, e1 = -j1/2, e2 =
    (j0 - 2 j2)/12``. Absolute errors of a few ulps of 2^-n/(n + 1).
    """
    j0, j1, j2 = _bessel(ops, half)
    return j0, -0.5 * j1, ops.fma(j2, -1 / 6, j0 * (1 / 12))


def _bessel(ops: Any, half: Any) -> tuple[Any, Any, Any]:
    """j_0, j_1 and j_2 of x = 2 pi half.

    For small x j_2 comes from its series, and j_1 from its neighbours, x (j_0 + j_2)/3, which loses
    nothing; else both come from the recurrence upwards.
    """
    x = 2 * math.pi * half
    small = abs(x) < _BELOW
    inverse = 1.0 / ops.select(small, 1.0, x)
    cosine, sine, ratio = cos_sin_over_turns(ops, half)
    j0 = ops.select(small, ratio * (0.5 / math.pi), sine * inverse)
    square = ops.select(small, x * x, 0.0)  # no overflow in the branch not taken
    series = square * _over_power(ops, 2, square, _DOUBLE if ops.double else _SINGLE)
    j1 = ops.select(small, (x * (1 / 3)) * (j0 + series), (j0 - cosine) * inverse)
    return j0, j1, ops.select(small, series, ops.fma(3.0 * inverse, j1, -j0))


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
