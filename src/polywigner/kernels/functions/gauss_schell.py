"""Gaussian waves over polygons and intervals: the closed form of W in partly coherent light.

In units of the width of coherence, with beta = 2 pi nu, the integrand of W is the Gaussian wave
g(xi) = exp(-xi^2/2 - i beta.xi) = exp(-beta^2/2 - Z), Z = (xi + i beta)^2/2: the divergence of

    (xi + i beta) f(xi)/2,   f = (exp(-beta^2/2) - g)/Z,

which has no singularity, so that its integral over a polygon is the sum over edges of
``(d + i beta_n)/2 int f ds`` (docs/coherence.md, (PC8)): s runs along the edge, d is the distance
of its line from the origin, beta_n the frequency across the edge, beta_s the one along it.

f is analytic in s, and the nodes lie on paths in the complex plane where it does not oscillate:

- Gauss-Legendre nodes of an arc that s = c x/(1 - x^2), c = 10 or d, spreads over edges of any
  length, and that is lifted by up to beta_s towards the saddle point of the wave;
- for a wave with beta_s >= 8, whose saddle point adds less than exp(-32), the descents from both
  ends, s = s_end + t/(s_end + i beta_s), on which g falls as exp(-t): Gauss-Laguerre nodes.

With 36 nodes at most both miss less than 1e-12 of the square of the largest lag. Rounding costs
(the width over the largest lag) ulps where weights are complex, and nothing where they are real.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from polywigner.numerics.trigonometry import cos_sin_turns

__all__ = ["Rows", "gaussian_rule", "wave_over_edge", "wave_over_interval"]

Rows = tuple[tuple[float, ...], ...]
Values = tuple[Any, Any]

# Nodes for lags of up to so many widths, in double and in single precision: errors of random edges
# and intervals below 1e-12 and 1e-7 of the square of the largest lag, or of the lag.
_NODES = {
    1: ((0.8, 16, 12), (1.6, 22, 14), (4.5, 28, 18), (math.inf, 48, 28)),
    2: ((0.8, 16, 12), (1.6, 20, 14), (4.5, 28, 16), (math.inf, 36, 24)),
}
# Of c and of the arc's height over its length.
_SPREAD, _LIFT = 10.0, 0.6
# beta_s, and its phase along the edge, from which on waves are integrated by descents.
_STEEP, _LONG = 8.0, 10.0
# |Re Z| below which exp(-beta^2/2) - |g| is a series, with so many terms in double and single
# precision: the first omitted ones are 0.1^9/10! = 3e-16 and 0.1^5/6! = 1e-8.
_SMALL, _TERMS = 0.1, {True: 9, False: 5}
# exp of what is less may be a subnormal number, with which processors are slow.
_LEAST_EXPONENT = {True: -300.0, False: -80.0}
# Its square is a normal number.
_TINY = {True: 1e-150, False: 1e-18}


@lru_cache(maxsize=16)
def gaussian_rule(reach: float, double: bool, dimension: int = 2) -> Rows:
    """Nodes for lags of up to ``reach`` widths, as rows of a table; 1 dimension: for intervals.

    Node, weight, 1 - node^2 and its slope times the weight, for arcs; then node and weight of a
    descent, the weight without exp(-t), and 1 at the first end, 0 at the last.
    """
    size = next(n[0] if double else n[1] for most, *n in _NODES[dimension] if reach <= most)
    t, weight = np.polynomial.legendre.leggauss(size)
    fall, share = np.polynomial.laguerre.laggauss(size // 2)
    share = share * np.exp(fall)
    first = np.arange(size) < size // 2
    columns = (t, weight, 1 - t * t, -2 * t * weight, np.tile(fall, 2), np.tile(share, 2), first)
    return tuple(tuple(row) for row in np.stack(columns, axis=-1).astype(float).tolist())


def wave_over_edge(
    ops: Any, rows: Rows, start: Any, end: Any, distance: Any, along: Any, across: Any
) -> Values:
    """The share of an edge in the integral of a Gaussian wave over a polygon, a complex number.

    Source: (PC8).

    Parameters
    ----------
    rows : of :func:`gaussian_rule`.
    start, end : places of the edge's ends along its unit vector, in widths of coherence.
    distance : cross(xi, unit vector) of its points, in the same unit.
    along, across : nu.(unit vector) and cross(nu, unit vector), in cycles per width.
    """
    turn = 2 * math.pi
    path = _Path(ops, start, end, distance, turn * along)
    most = 0.5 * (path.rate * path.rate + (turn * across) * (turn * across))
    still = ops.select(path.is_steep, 0.0, ops.exp(-ops.minimum(most, -path.least)))

    def term(*row: Any) -> Values:
        p, r, dp, dr = path.node(*row)
        exponent = path.exponent(p, r)
        size = ops.exp(ops.maximum(exponent, path.least))
        turns = _turns(ops, along, p, across * distance, r)
        cosine, sine = cos_sin_turns(ops, 0.5 * turns)
        x = -(most + exponent)
        x = ops.select(abs(x) < _TINY[ops.double], _TINY[ops.double], x)
        y = turn * turns
        small = abs(x) < _SMALL
        series = still * _one_less_exp(ops, ops.select(small, x, 0.0))
        falls = ops.select(small, series, still - size)
        real, imag = ops.fma(2.0 * size * sine, sine, falls), 2.0 * size * sine * cosine
        scale = 1.0 / ops.fma(x, x, y * y)
        f_real = ops.fma(real, x, imag * y) * scale
        f_imag = ops.fma(imag, x, -(real * y)) * scale
        return f_real * dp - f_imag * dr, f_real * dr + f_imag * dp

    real, imag = ops.sum_over(rows, term, 2, like=start)
    lever = turn * across
    return 0.5 * (distance * real - lever * imag), 0.5 * (distance * imag + lever * real)


def wave_over_interval(ops: Any, rows: Rows, start: Any, end: Any, nu: Any) -> Values:
    """The integral of exp(-xi^2/2 - 2 pi i nu xi) over an interval, a complex number."""
    path = _Path(ops, start, end, 0.0 * start, 2 * math.pi * nu)

    def term(*row: Any) -> Values:
        p, r, dp, dr = path.node(*row)
        size = ops.exp(ops.maximum(path.exponent(p, r), path.least))
        cosine, sine = cos_sin_turns(ops, _turns(ops, nu, p, 0.0, r))
        return size * (cosine * dp + sine * dr), size * (cosine * dr - sine * dp)

    real, imag = ops.sum_over(rows, term, 2, like=start)
    return real, imag


class _Path:
    """The path of nodes from one end of an edge to the other, as s = p + i r."""

    def __init__(self, ops: Any, start: Any, end: Any, distance: Any, rate: Any) -> None:
        self.ops, self.start, self.end, self.rate = ops, start, end, rate
        self.square, self.least = distance * distance, _LEAST_EXPONENT[ops.double]
        self.size = ops.maximum(abs(distance), _SPREAD)
        first, last = self._spread(start), self._spread(end)
        self.middle, self.half = 0.5 * (first + last), 0.5 * (last - first)
        reach = self.size * abs(self.half)
        self.is_steep = (abs(rate) >= _STEEP) & (2.0 * abs(rate) * reach >= _LONG)
        lift = ops.minimum(abs(rate), _LIFT * reach)
        self.lift = ops.select(rate > 0.0, -lift, lift)
        self.descents = self._descent(start), self._descent(end)

    def _spread(self, s: Any) -> Any:
        """The x of s = c x/(1 - x^2)."""
        root = self.ops.sqrt(self.ops.fma(self.size, self.size, 4.0 * s * s))
        return 2.0 * s / (self.size + root)

    def _descent(self, s: Any) -> Values:
        """1/(s + i beta_s)."""
        ops, rate = self.ops, self.rate
        scale = 1.0 / ops.select(self.is_steep, ops.fma(s, s, rate * rate), 1.0)
        return s * scale, -rate * scale

    def node(
        self, t: Any, weight: Any, rise: Any, slope: Any, fall: Any, share: Any, is_first: Any
    ) -> tuple[Any, Any, Any, Any]:
        """p, r, and what the node weighs, a complex number."""
        ops = self.ops
        x = ops.fma(self.half, t, self.middle)
        spread = 1.0 / (1.0 - x * x)
        stride = self.size * self.half * weight * ops.fma(x, x, 1.0) * spread * spread
        at_first = is_first > 0.5
        end = ops.select(at_first, self.start, self.end)
        (ax, ay), (bx, by) = self.descents
        down = ops.select(at_first, ax, bx), ops.select(at_first, ay, by)
        share = ops.select(at_first, share, -share)
        steep = self.is_steep
        return (
            ops.select(steep, ops.fma(fall, down[0], end), self.size * x * spread),
            ops.select(steep, fall * down[1], self.lift * rise),
            ops.select(steep, share * down[0], stride),
            ops.select(steep, share * down[1], self.lift * slope),
        )

    def exponent(self, p: Any, r: Any) -> Any:
        """log |g|."""
        return self.ops.fma(self.rate, r, -0.5 * ((p - r) * (p + r) + self.square))


def _turns(ops: Any, along: Any, p: Any, across: Any, r: Any) -> Any:
    """The phase of 1/g in turns."""
    return ops.fma(along, p, ops.fma(p, r * (0.5 / math.pi), across))


def _one_less_exp(ops: Any, x: Any) -> Any:
    """1 - exp(-x) for small x, to the rounding of x."""
    series: Any = 0.0
    for k in range(_TERMS[ops.double], 0, -1):
        series = ops.fma(series, x, -((-1.0) ** k) / math.factorial(k))
    return series * x
