"""Integrals of Gaussian waves over polygons and intervals, for W in partially coherent light.

W is the sum of an integral over each edge, (I5) of docs/theory.md. Lengths are in coherence widths.
Each integral runs along a path in the complex plane. With 10 to 36 quadrature nodes, its error is
below 1e-12 of the square of the largest lag. For complex weights, cancellation multiplies rounding
errors by the ratio of the coherence width to the largest lag.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.numerics import Number
from polywigner.numerics.phases import cos_sin_cycles, one_less_exp

Values = tuple[Any, ...]
Rules = tuple[npt.NDArray[np.float64], ...]

# Limits on the shape of the arc of integration in (I5): smallest parameter c, and largest ratio of
# height to length.
_SPREAD, _LIFT = 10.0, 0.6
# Lengths c |x_end - x_start| of an arc at which the number of quadrature nodes increases, and the
# numbers of nodes. If beta_s exceeds 8, the length is first multiplied by beta_s/8. Errors are
# below 1e-12 in double and 1e-7 in single precision, relative to the squared length of random edges
# or the length of random intervals.
_LENGTHS = (0.3, 1.0, 2.5, 4.0, 6.0, 8.0)
_OF_EDGES = {True: (10, 14, 18, 22, 26, 30, 36), False: (8, 10, 12, 14, 16, 18, 22)}
_OF_INTERVALS = {True: (10, 14, 20, 24, 28, 32, 44), False: (8, 10, 12, 16, 18, 20, 28)}
# Smallest frequency beta_s and smallest phase along the edge for which paths of steepest descent
# are used, and numbers of nodes on these paths.
_STEEP, _LONG = 8.0, 10.0
_OF_DESCENTS = {True: 10, False: 6}
# _FAR is the value of |xi| or beta above which |g| and exp(-beta^2/2) are below 4e-17. On edges
# beyond _FAR, f is as smooth as 1/Z, and the rule with the index _SMOOTH is sufficient.
_FAR, _SMOOTH = 8.7, 3.0
# _SMALL is the value of |Re Z| below which exp(-beta^2/2) - |g| is computed as a series of _TERMS
# terms. The first omitted term is 0.1^9/10! = 3e-16 in double and 0.1^5/6! = 1e-8 in single
# precision.
_SMALL, _TERMS = 0.1, {True: 9, False: 5}
# Smallest exponents of exponential functions in double and single precision. Smaller exponents
# would give subnormal numbers, which slow down the processor.
_LEAST_EXPONENT = {True: -300.0, False: -80.0}
# Smallest divisors in double and single precision, whose squares are normal numbers.
_TINY = {True: 1e-150, False: 1e-18}
_TURN = 2 * math.pi


def wave_over_edge(
    ops: Any, start: Any, end: Any, distance: Any, along: Any, across: Any
) -> Values:
    """Return the contribution of an edge to the integral of a Gaussian wave over a polygon, (I5).

    The sum over all edges is the integral of exp(-|xi|^2/2 - 2 pi i nu.xi), with xi in coherence
    widths. The contribution is a tuple of the real and the imaginary part.

    Parameters
    ----------
    start, end : array
        Positions of the ends of the edge along its unit vector, in coherence widths.
    distance : array
        Signed distance of the edge's line from the origin, in coherence widths. The distance is
        cross(xi, unit vector) for all lags xi on the edge.
    along, across : array
        Components of the frequency, nu.(unit vector) and cross(nu, unit vector), in cycles per
        coherence width.
    """
    rate, lever = _TURN * along, _TURN * across
    square = distance * distance
    outside = ops.maximum(ops.maximum(ops.minimum(start, end), -ops.maximum(start, end)), 0.0)
    is_near = ops.fma(outside, outside, square) < _FAR**2
    energy = 0.5 * ops.fma(rate, rate, lever * lever)
    decays_slowly = energy < 0.5 * _FAR**2
    arc = _Arc(ops, start, end, ops.maximum(abs(distance), _SPREAD), rate)
    rule = arc.rule(is_near | decays_slowly)
    rule = ops.select(is_near, rule, ops.minimum(rule, _SMOOTH))
    decay = ops.select(decays_slowly, ops.exp(-ops.minimum(energy, 0.5 * _FAR**2)), 0.0)
    wave = (rate, square, energy, decay, along, across * distance)
    real, imag = arc.integral(rule, is_near, _OF_EDGES, _flux, wave)
    real, imag = 0.5 * real, 0.5 * imag
    return distance * real - lever * imag, distance * imag + lever * real


def wave_over_interval(ops: Any, start: Any, end: Any, nu: Any) -> Values:
    """Return the integral of the Gaussian wave exp(-xi^2/2 - 2 pi i nu xi) over an interval.

    The ends are in coherence widths, and nu in cycles per coherence width. The result is a tuple of
    the real and the imaginary part.
    """
    rate = _TURN * nu
    arc = _Arc(ops, start, end, ops.maximum(0.0 * abs(start), _SPREAD), rate)
    everywhere = rate == rate
    rule = arc.rule(everywhere)
    real, imag = arc.integral(rule, everywhere, _OF_INTERVALS, _gaussian, (rate, nu))
    # ``undefined`` is NaN if an argument is NaN, and 0 otherwise.
    undefined = 0.0 * (start + rate)
    return real + undefined, imag + undefined


@lru_cache(maxsize=4)
def _arc_rules(sizes: tuple[int, ...]) -> Rules:
    """Return rows (node t, weight, 1 - t^2, weight times the derivative of 1 - t^2) for arcs."""
    rules = []
    for size in sizes:
        t, weight = np.polynomial.legendre.leggauss(size)
        rules.append(np.stack([t, weight, 1 - t * t, -2 * t * weight], axis=-1))
    return tuple(rules)


@lru_cache(maxsize=2)
def _descent_rules(size: int) -> Rules:
    """Return a rule for steepest descents, whose weights do not include the factor exp(-node)."""
    t, weight = np.polynomial.laguerre.laggauss(size)
    return (np.stack([t, weight * np.exp(t)], axis=-1),)


class _Arc:
    """Path between the ends of an edge in the complex plane: an arc, or two steepest descents."""

    def __init__(self, ops: Any, start: Any, end: Any, size: Any, rate: Any) -> None:
        self.ops, self.ends = ops, (start, end)
        first, last = (
            2.0 * s / (size + ops.sqrt(ops.fma(size, size, 4.0 * s * s))) for s in (start, end)
        )
        half = 0.5 * (last - first)
        reach = size * abs(half)
        self.length = 2.0 * reach * ops.maximum(abs(rate) * (1 / _STEEP), 1.0)
        self.is_steep = (abs(rate) >= _STEEP) & (self.length >= _LONG / _STEEP)
        lift = ops.minimum(abs(rate), _LIFT * reach)
        lift = ops.select(rate > 0.0, -lift, lift)
        self.samples = (size, 0.5 * (first + last), half, lift)

    def rule(self, is_needed: Any) -> Number:
        """Return the index of the quadrature rule for the arc, or -1 if the arc is not used."""
        ops, number = self.ops, 0.0
        for length in _LENGTHS:
            number = number + ops.select(self.length > length, 1.0, 0.0)
        is_needed = is_needed & (self.length > 0.0)
        return ops.select(self.is_steep, -1.0, ops.select(is_needed, number, -1.0))

    def integral(
        self, rule: Any, is_near: Any, sizes: Any, value: Callable[..., Values], wave: Values
    ) -> Values:
        """Return the complex integral of ``value(ops, p, r, *wave)`` over positions p + i r.

        Steepest descents are integrated only for samples for which ``is_near`` is true.
        """
        ops = self.ops

        def of_arc(t: Any, weight: Any, rise: Any, slope: Any, *samples: Any) -> Values:
            p, r, *step = _arc_node(ops, (t, weight, rise, slope), samples[:4])
            return _times(value(ops, p, r, *samples[4:]), step)

        def of_descents(t: Any, weight: Any, start: Any, end: Any, *wave: Any) -> Values:
            first, last = (
                _times(value(ops, p, r, *wave), step)
                for p, r, *step in (_descent_node(ops, t, weight, s, wave[0]) for s in (start, end))
            )
            return first[0] - last[0], first[1] - last[1]

        rules = _arc_rules(sizes[ops.double])
        real, imag = ops.sum_over_rule(rule, rules, of_arc, 2, *self.samples, *wave)
        rules = _descent_rules(_OF_DESCENTS[ops.double])
        descent = ops.select(self.is_steep & is_near, 0.0, -1.0)
        more = ops.sum_over_rule(descent, rules, of_descents, 2, *self.ends, *wave)
        return real + more[0], imag + more[1]


def _arc_node(ops: Any, row: Values, samples: Values) -> Values:
    """Return the position p + i r of a node on an arc and the complex step, as four numbers."""
    t, weight, rise, slope = row
    size, centre, half, lift = samples
    x = ops.fma(half, t, centre)
    spread = 1.0 / (1.0 - x * x)
    stride = (size * half * weight) * ops.fma(x, x, 1.0) * (spread * spread)
    return size * x * spread, lift * rise, stride, lift * slope


def _descent_node(ops: Any, t: Any, weight: Any, s: Any, rate: Any) -> Values:
    """Return the position p + i r of a node on the steepest descent from s, and the step.

    The step does not include the factor exp(-t).
    """
    scale = 1.0 / ops.fma(s, s, rate * rate)
    x, y = s * scale, -rate * scale
    return ops.fma(t, x, s), t * y, weight * x, weight * y


def _flux(ops: Any, p: Any, r: Any, *wave: Any) -> Values:
    """Return the integrand f = (exp(-beta^2/2) - g)/Z of (I5) at the position p + i r.

    Here beta is 2 pi |nu|, and g = exp(-beta^2/2 - Z) is the Gaussian wave.
    """
    rate, square, energy, decay, along, across = wave
    exponent = ops.fma(rate, r, -0.5 * ((p - r) * (p + r) + square))
    size = ops.exp(ops.maximum(exponent, _LEAST_EXPONENT[ops.double]))
    cycles = ops.fma(along, p, ops.fma(p, r * (1 / _TURN), across))
    cosine, sine = cos_sin_cycles(ops, 0.5 * cycles)
    x, y = -(energy + exponent), _TURN * cycles
    x = ops.select(abs(x) < _TINY[ops.double], _TINY[ops.double], x)
    is_small = abs(x) < _SMALL
    series = one_less_exp(ops, ops.select(is_small, x, 0.0), _TERMS[ops.double])
    difference = ops.select(is_small, decay * series, decay - size)
    real, imag = ops.fma(2.0 * size * sine, sine, difference), 2.0 * size * sine * cosine
    scale = 1.0 / ops.fma(x, x, y * y)
    return ops.fma(real, x, imag * y) * scale, ops.fma(imag, x, -(real * y)) * scale


def _gaussian(ops: Any, p: Any, r: Any, rate: Any, nu: Any) -> Values:
    """Return the Gaussian wave exp(-z^2/2 - 2 pi i nu z) at z = p + i r; ``rate`` is 2 pi nu."""
    exponent = ops.fma(rate, r, -0.5 * ((p - r) * (p + r)))
    size = ops.exp(ops.maximum(exponent, _LEAST_EXPONENT[ops.double]))
    cosine, sine = cos_sin_cycles(ops, ops.fma(nu, p, p * r * (1 / _TURN)))
    return size * cosine, -size * sine


def _times(a: Any, b: Any) -> Values:
    """Return the product of two complex numbers, each as two real numbers."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]
