"""Contributions of clipped edges to the Wigner function W and the ambiguity function A.

A part of an edge has the vector d and the midpoint m. The term of the part depends on nu.d, nu.m
and cross(nu, d). `EvenTerms` implements (W1) of docs/theory.md for real weights, and `WaveTerms`
implements (W2) and (A1) for all weights. All forms avoid cancellation as nu goes to 0.
"""

from __future__ import annotations

import math
from typing import Any

from polywigner.numerics import Number
from polywigner.numerics.phases import sin_cycles, sinc_less_one


def segment_wave(ops: Any, half: Any, midpoint: Any) -> tuple[Any, Any]:
    """Return sinc(l) sin(2 pi m) and sinc(l) cos(2 pi m) - 1, the mean of a wave along a segment.

    ``half`` is l/2, where l is the phase along the segment in cycles, and sinc(l) is sin(pi l)/(pi
    l). ``midpoint`` is the phase m at the midpoint in cycles. Below a quarter of a cycle the second
    value uses the series of sinc - 1, whose first omitted term is 0.62^9/19! = 1e-19, or 0.62^6/13!
    = 9e-12 in float32.
    """
    small = abs(half) < 0.125
    series = sinc_less_one(ops, ops.select(small, 2.0 * half, 0.0), 8 if ops.double else 5)
    divisor = 2 * math.pi * ops.select(small, 1.0, half)
    less_one = ops.select(small, series, sin_cycles(ops, half) / divisor - 1.0)
    half_sine = sin_cycles(ops, 0.5 * midpoint)
    cosine_less_one = -2.0 * half_sine * half_sine
    sine = sin_cycles(ops, midpoint)
    cosine = ops.fma(less_one, cosine_less_one, less_one + cosine_less_one)
    return ops.fma(less_one, sine, sine), cosine


def moved_off_zero(
    ops: Any, x: Any, y: Any, floors: tuple[float, float] = (1e-140, 1e-13)
) -> tuple[Any, Any]:
    """Return a frequency, or (floor, 0) if the magnitudes of both components are below a floor.

    ``floors`` are the floors in float64 and float32. With the default floors, the square of the
    frequency does not underflow. Terms are of the order of the squared frequency. The rounding
    errors of the sum of terms, up to 6e-8 of the sum, must not underflow either. A floor of 1e-16
    would make errors in float32 eight times as large.
    """
    floor = floors[0] if ops.double else floors[1]
    tiny = (abs(x) < floor) & (abs(y) < floor)
    return ops.select(tiny, floor, x), ops.select(tiny, 0.0, y)


Values = tuple[Any, ...]


def scaled(factor: Any, value: Any) -> Number:
    """Return factor * value, without a multiplication if the factor is the constant 1 or -1."""
    if isinstance(factor, float) and abs(factor) == 1.0:
        return value if factor > 0 else -value
    return factor * value


class EdgeTerms:
    """Contributions of all parts of edges at one nonzero frequency.

    A part has the vector d = ``extent`` ``length`` u. Its term does not depend on how d is divided
    into these factors. The unit vector u of constant edges is shared by parallel edges. For edges
    in memory, u is the edge vector or d, and ``length`` is 1. The sign of a term must change if d
    is reversed.
    """

    values: int
    """Number of results: 1 for a real sum, 2 for the real and the imaginary part."""
    ops: Any
    nu: Values
    by_part = False
    """Whether only :meth:`of_part` is implemented, because parts of an edge share no factors."""

    def at(self, *index: Any) -> EdgeTerms:
        """Return the terms at some of the frequencies, selected by an array index."""
        terms, nu = object.__new__(type(self)), tuple(component[index] for component in self.nu)
        terms.__dict__.update(self.__dict__, nu=nu)
        return terms

    def along(self, ux: Any, uy: Any) -> Values:
        """Return nu.u, and other quantities that depend only on the direction u of an edge."""
        raise NotImplementedError

    def added(
        self, sums: Values | None, half: Any, midpoint: Any, extent: Any, weight: Values
    ) -> Values:
        """Return ``sums`` plus the term of one part of an edge. Initially, ``sums`` is None.

        ``half`` and ``midpoint`` are nu.d/2 and nu.m in cycles. ``extent`` is the length of the
        part as a fraction of the edge. ``weight`` is complex: the product of both elements' weights
        and the jump or level of the other copy. The result does not include the factors that
        :meth:`of_edge` applies.
        """
        raise NotImplementedError

    def of_edge(self, along: Values, length: Any, sums: Values) -> Values:
        """Return the term from the sums of :meth:`added` over some or all parts of an edge.

        ``length`` is the length of the edge in units of u. The result must be linear in ``sums``,
        because some strategies call this method for each part and others once per edge.
        """
        raise NotImplementedError

    def of_part(self, x: Any, y: Any, dx: Any, dy: Any, real: Any, imag: Any) -> Values:
        """Return the term of a part of an edge from its centre, vector and weight."""
        nu_x, nu_y = self.nu
        along = self.along(dx, dy)
        midpoint = self.ops.fma(nu_x, x, nu_y * y)
        sums = self.added(None, 0.5 * along[0], midpoint, 1.0, (real, imag))
        return self.of_edge(along, 1.0, sums)

    def total(self, sums: Values) -> Values:
        """Return W, or the real and the imaginary part of W or A, from the sum over all edges."""
        raise NotImplementedError


class EvenTerms(EdgeTerms):
    """Terms of the Wigner function for real weights, (W1), which are even in the frequency."""

    values = 1

    def __init__(self, ops: Any, nu: Values) -> None:
        self.ops, self.nu = ops, nu

    def along(self, ux: Any, uy: Any) -> Values:
        """Return nu.u, bounded away from 0, and cross(nu, u)/(nu.u)."""
        ops, (nu_x, nu_y) = self.ops, self.nu
        # The square of nu.u must be a normal number, because subnormal arithmetic is a hundred
        # times slower. In SIMD lanes that have finished a loop, nu.u is 0.
        floor = 1e-30 if ops.double else 1e-18
        along = ops.fma(nu_x, ux, nu_y * uy)
        along = ops.select(abs(along) < floor, floor, along)
        return along, ops.fma(nu_x, uy, nu_y * -ux) / along

    def added(
        self, sums: Values | None, half: Any, midpoint: Any, extent: Any, weight: Values
    ) -> Values:
        """Add the product of sin(pi nu.d), sin(2 pi nu.m) and the real weight to the sum."""
        size = scaled(weight[0], sin_cycles(self.ops, half))
        phase = sin_cycles(self.ops, midpoint)
        return (size * phase if sums is None else self.ops.fma(size, phase, sums[0]),)

    def of_edge(self, along: Values, length: Any, sums: Values) -> Values:
        """Return the sum times cross(nu, u)/(nu.u)."""
        return (along[1] * sums[0],)

    def total(self, sums: Values) -> Values:
        """Return the sum divided by pi^2 |nu|^2."""
        nu_x, nu_y = self.nu
        return (sums[0] / (math.pi**2 * self.ops.fma(nu_x, nu_x, nu_y * nu_y)),)


class WaveTerms(EdgeTerms):
    """Sine and cosine terms of W and A for complex weights and one pair of waves, (W2) and (A1)."""

    def __init__(self, ops: Any, nu: Values, values: int, factor: float = 1.0) -> None:
        """Store a nonzero frequency.

        ``values`` is 1 for the sine part only, otherwise 2. The totals are ``factor``/|nu|^2 times
        the sums.
        """
        self.ops, self.nu, self.values, self.factor = ops, nu, values, factor

    def along(self, ux: Any, uy: Any) -> Values:
        """Return nu.u and cross(nu, u) for the vector u of an edge."""
        nu_x, nu_y = self.nu
        return self.ops.fma(nu_x, ux, nu_y * uy), self.ops.fma(nu_x, uy, nu_y * -ux)

    def added(
        self, sums: Values | None, half: Any, midpoint: Any, extent: Any, weight: Values
    ) -> Values:
        """Add the sine and cosine of :func:`segment_wave`, times weight and extent, to the sums."""
        ops, (real, imag) = self.ops, weight
        sine, cosine = segment_wave(ops, half, midpoint)
        waves = _with(ops, sums, scaled(real, extent), sine, cosine)
        if isinstance(imag, float) and imag == 0.0:
            return waves
        factor = scaled(extent, imag)
        return ops.fma(-factor, cosine, waves[0]), ops.fma(factor, sine, waves[1])

    def of_edge(self, along: Values, length: Any, sums: Values) -> Values:
        """Return the sums times the length of the edge and cross(nu, u)."""
        across = scaled(length, along[1])
        return tuple(across * value for value in sums[: self.values])

    def total(self, sums: Values) -> Values:
        """Return the sums times ``factor``/|nu|^2."""
        nu_x, nu_y = self.nu
        scale = self.factor / self.ops.fma(nu_x, nu_x, nu_y * nu_y)
        return tuple(value * scale for value in sums)


class AreaTerms(EdgeTerms):
    """Contributions of edges to the area of a slice, the integral of cross(x, dx)/2 along them."""

    values, by_part = 1, True

    def __init__(self, ops: Any, _: Any, nu: Values, is_even: bool, is_real: bool) -> None:
        self.ops, self.nu = ops, nu

    def of_part(self, x: Any, y: Any, dx: Any, dy: Any, real: Any, imag: Any) -> Values:
        """Return cross(x, d)/2 for the centre x and vector d of a part, times its real weight.

        The result is a tuple of one value. ``imag`` is not used.
        """
        return (scaled(real, 0.5 * self.ops.fma(x, dy, y * -dx)),)

    def total(self, sums: Values) -> Values:
        """Return the sum unchanged."""
        return sums


def wigner_terms(ops: Any, _: Any, nu: Values, is_even: bool, is_real: bool) -> EdgeTerms:
    """Return the terms of the Wigner function at a frequency.

    ``is_even`` specifies that weights are real, and ``is_real`` that only the real part is
    required.
    """
    if is_even:
        # W is even in nu, so a small shift of nu from 0 changes W by less than rounding errors.
        return EvenTerms(ops, moved_off_zero(ops, nu[0], nu[1], (1e-9, 1e-6)))
    return WaveTerms(ops, moved_off_zero(ops, *nu), 1 if is_real else 2, 1 / math.pi)


def ambiguity_terms(ops: Any, _: Any, nu: Values, is_even: bool, is_real: bool) -> EdgeTerms:
    """Return the terms of the ambiguity function at a frequency shift upsilon = ``nu``."""
    return WaveTerms(ops, moved_off_zero(ops, *nu), 2, 0.5 / math.pi)


def _with(ops: Any, sums: Values | None, factor: Any, *waves: Any) -> Values:
    """Return the sums plus ``factor`` times each wave. None stands for sums of 0."""
    if sums is None:
        return tuple(scaled(factor, wave) for wave in waves)
    return tuple(ops.fma(factor, wave, total) for wave, total in zip(waves, sums, strict=True))
