"""Interpolation of band-limited functions from a few samples around a place.

A wave sampled at ``rate`` times what its degree asks for is what a kernel phi of ``width`` samples,
summed over its samples, makes of it, up to the kernel's transform at the wave: Poisson's formula.
Source: A. H. Barnett, J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41, C479 (2019), with
phi(z) = exp(beta (sqrt(1 - z^2) - 1)), a polynomial between any two samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["RATE", "Interpolation", "interpolation"]

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
            even, odd = (_polynomial(ops, part.tolist(), square) for part in (row[0::2], row[1::2]))
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


def _polynomial(ops: Any, coefficients: list[float], x: Any) -> Any:
    total: Any = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        total = ops.fma(total, x, coefficient)
    return total


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
