"""Fields of plane waves behind an aperture, by steepest descent from the ends of its edges.

The phase along an edge is stationary at the position from which the diffracted ray (Keller's cone)
reaches the point. Gauss-Legendre nodes integrate the inner part, where the phase is within a few
cycles of its stationary value c. Outside, the path of integration is deformed into the complex
plane. The number of quadrature nodes does not depend on the wavelength. The formulas are (B10) and
(B11) of docs/theory/exact_fields.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import numpy as np

from polywigner.kernels.boundary.edge_waves import (
    TRAVELLING,
    PanelView,
    path_difference,
    root,
    swept_angle,
    wave_difference,
)
from polywigner.kernels.boundary.integrals import (
    BoundaryTables,
    rounded_cycles,
    seen_from,
    seen_in_parabolic_waves,
    wave_on_panel,
    weighted,
)
from polywigner.kernels.kernel import Values
from polywigner.numerics import Number
from polywigner.numerics.nodes import SUMS, Rules, error_of, node_sums, nodes_needed, rule_index
from polywigner.numerics.phases import Pair

# Numbers of Gauss-Laguerre nodes for tails, which are integrals from an end of an edge to infinity.
_SIZES = (2, 3, 4, 5, 6, 8, 10)
# Logarithms of the numerators of the error bound (B11). With n Gauss-Laguerre nodes, the integral
# of exp(-2 pi y) times (1 + iy/x^2)^-2 has an error of at most sqrt(2) (2n + 1) n!^2/(2 pi
# x^2)^(2n). The bound also holds for products of such factors whose powers add up to -2, if each
# factor has a larger x^2.
_BOUNDS = tuple(math.log(math.sqrt(2) * (2 * n + 1) * math.factorial(n) ** 2) for n in _SIZES)
# Distance [half-lengths of the edge] that represents "no singularity". A singularity at this
# distance lies outside the Bernstein ellipses of all quadrature rules.
_NO_SINGULARITY = 100.0
# Number of phase cycles along an edge above which two tails need fewer quadrature nodes than the
# edge.
_FEW = 2.0


@cache
def _tail_rules() -> Rules:
    """Return nodes y and weights (n, 2) for integrals of exp(-2 pi y) times a smooth function."""
    rules = (np.polynomial.laguerre.laggauss(n) for n in _SIZES)
    return tuple(np.stack(rule, axis=1) / (2.0 * math.pi) for rule in rules)


def steepest_edge_sum(ops: Any, tables: BoundaryTables, *inner: Any) -> Values:
    """Return the field of travelling waves at a point, and the error estimate.

    Each row of ``tables`` is a complete edge. The field does not include the phase of the distance
    from the centre of the source.
    """
    rows = [row[:-1] for row in tables.edges]
    oblique = any(row[5] or row[7] for row in rows)

    def term(*row: Any) -> Values:
        return _edge(ops, tables, row, inner, oblique)

    total: Values = ops.sum_over(rows, term, 3, like=inner[0], unroll=False)
    return total


@dataclass(frozen=True)
class _End:
    """A position on an edge, and the phase of the wave at this position."""

    t: Any
    s: Any
    radius: Any
    slope: Any
    """Derivative of the phase along the edge, multiplied by the distance R from the point."""
    phase: Any
    """Phase R + p_e s, in cycles."""
    beyond: Any
    """Phase minus the stationary phase, in cycles."""


@dataclass(frozen=True)
class _Line:
    """Quantities that are constant along the line of an edge, for one point and one wave."""

    view: PanelView
    upright: Any
    """Squared sine of the angle between the direction of the wave and the edge."""
    least: Any
    """Stationary phase c, in cycles."""
    ahead: Any
    """Path difference N of (B2) minus the excess of the phase over the stationary phase."""
    alpha: Any
    """Constant a of (B2)."""
    beta: Any
    """Constant b' of (B2)."""
    excess: Any
    """Difference N' - N of the path differences of (B2)."""
    mirror_factor: float
    """Factor 1/2 - m in the second term of (B3)."""
    curved: float
    """1 for spherical waves and 0 for parabolic waves."""

    @classmethod
    def spherical(cls, ops: Any, view: PanelView, alpha: Any, mirror_factor: float) -> _Line:
        """Return the line of an edge for spherical waves."""
        upright = view.across * view.across + view.pz * view.pz
        least = ops.sqrt(upright * (view.b * view.b + view.z * view.z))
        direct = view.pz * view.z - view.b * view.across
        # This form of ``ahead`` is accurate close to the shadow boundary.
        bent = alpha * alpha / (least + abs(direct))
        ahead = ops.select(direct > 0.0, bent, least - direct)
        beta = view.pz * view.b - view.z * view.across
        return cls(
            view, upright, least, ahead, alpha, beta, 2.0 * (view.pz * view.z), mirror_factor, 1.0
        )

    @classmethod
    def parabolic(cls, view: PanelView) -> _Line:
        """Return the line of an edge for paraxial waves, with z in place of R and ``least``."""
        ahead = view.b * view.b / (2.0 * view.z)
        return cls(view, 1.0, view.z, ahead, view.b, 0.0, 0.0, 0.0, 0.0)

    def end(self, ops: Any, t: Any) -> _End:
        """Return the position at the distance t from the start of the edge."""
        view, s = self.view, self.view.first + t
        foot2 = view.b * view.b + view.z * view.z
        radius = ops.sqrt(s * s + foot2) if self.curved else view.z + 0.0 * s
        slope, phase = s + view.along * radius, radius + view.along * s
        return _End(t, s, radius, slope, phase, slope * slope / (self.least + phase))

    def inner_part(self, ops: Any, begin: _End, end: _End, digits: Any) -> tuple[_End, _End]:
        """Return the ends of the inner part of an edge, which may be the complete edge or empty."""
        view = self.view
        rim = ops.exp((digits + _BOUNDS[-1]) / (2.0 * _SIZES[-1])) / (2.0 * math.pi)
        foot = -view.along * (self.least + rim) - self.upright * view.first
        half = ops.sqrt(rim * (2.0 * self.least + self.curved * rim))
        low, high = (
            ops.maximum(ops.minimum(t / self.upright, view.length), 0.0)
            for t in (foot - half, foot + half)
        )
        has_foot = (begin.slope < 0.0) & (end.slope > 0.0)
        cycles = ops.select(has_foot, begin.beyond + end.beyond, abs(end.beyond - begin.beyond))
        is_cut = cycles > _FEW + ops.select(low < high, rim, 0.0)
        low, high = ops.select(is_cut, low, 0.0), ops.select(is_cut, high, view.length)
        return self.end(ops, low), self.end(ops, high)

    def angles(self, ops: Any, begin: _End, low: _End, high: _End, end: _End) -> tuple[Any, Any]:
        """Return the integrals of a/(N R) over both outer parts, and of b'/(N' R) over the edge."""
        view = self.view
        level, height = view.b * view.across, view.pz * view.z

        def angle(factor: Any, level: Any, first: _End, last: _End) -> Number:
            """Return the integral of factor/(M R) between two positions on the edge."""
            ends, length = ((first.s, first.radius), (last.s, last.radius)), last.t - first.t
            if self.curved:
                swept = swept_angle(ops, view, factor, level, *ends, length)
            else:
                swept = 2.0 * ops.atan2(factor * length, factor * factor + first.s * last.s)
            return ops.select(last.t > first.t, swept, 0.0)

        outside = (angle(self.alpha, level - height, *ends) for ends in ((begin, low), (high, end)))
        mirrored = angle(self.beta, level + height, begin, end) if self.curved else 0.0
        return sum(outside), mirrored

    def inner_sums(
        self, ops: Any, rules: Rules, low: _End, high: _End, digits: Any, free: Pair,
        moment: Values, phase: Values,
    ) -> tuple[Values, Values]:  # fmt: skip
        """Return the sums of :func:`node_sums` over the inner part, and their expected errors."""
        view, mirror_factor, tiny = self.view, self.mirror_factor, 1e-300 if ops.double else 1e-37
        half, foot2 = 0.5 * (high.t - low.t), view.b * view.b + view.z * view.z
        is_curved = bool(self.curved)

        def node(
            at: Any, w: Any, v1: Any, v2: Any, half: Any, begin: Any, first: Any, foot2: Any,
            *data: Any,
        ) -> Values:  # fmt: skip
            """Return the contribution of a node to (B3), without the wave e in the second term."""
            (*wave, b, z, across, pz, beta, excess, free_r, free_i), moment = data[:13], data[13:]
            t = half * (1.0 + at)
            s, t = first + t, begin + t
            radius = ops.sqrt(s * s + foot2) if is_curved else z
            edge = wave_on_panel(ops, t, radius, *wave)
            alpha, path = path_difference(ops, t, s, radius, wave[3], b, z, across, pz, *moment)
            over = 0.5 * alpha / ops.maximum(path, tiny)
            value = wave_difference(ops, edge, Pair(free_r, free_i), path).scaled(over)
            # The rounding errors of E and e do not cancel, so |E - e| is replaced by its upper
            # bound.
            size = abs(over) * ops.minimum(2.0, 2.0 * math.pi * path)
            if mirror_factor:
                value = value + edge.scaled(mirror_factor * beta / (path + excess))
                size = size + abs(mirror_factor * beta / (path + excess))
            step = half / radius
            real, imag, _, *last = node_sums(step * value.real, step * value.imag, w, v1, v2)
            return real, imag, w * step * size, *last

        needed, expected = self._nodes_needed(ops, low, high, half, foot2, digits)
        rule = ops.select(half > 0.0, rule_index(ops, needed), -1.0)
        sums = ops.sum_over_rule(
            rule, rules, node, SUMS, half, low.t, low.s, foot2, *phase,
            view.b, view.z, view.across, view.pz, self.beta, self.excess,
            free.real, free.imag, *moment,
        )  # fmt: skip
        return sums, expected

    def _nodes_needed(
        self, ops: Any, low: _End, high: _End, half: Any, foot2: Any, digits: Any
    ) -> tuple[Any, tuple[Any, ...]]:
        """Return the result of :func:`nodes_needed` for the part from ``low`` to ``high``."""
        half = ops.maximum(half, 1e-30)
        rates = low.slope / low.radius, high.slope / high.radius
        outside = ops.maximum(ops.maximum(low.s, -high.s), 0.0)
        nearest = ops.sqrt(outside * outside + foot2)
        # The integrand for parabolic waves has no singularity.
        if not self.curved:
            nearest = nearest + _NO_SINGULARITY * half
        if self.mirror_factor:
            # ``tilt`` is a lower bound on the sine of the angle between the point and the mirrored
            # ray.
            tilt = self.view.pz + self.view.z / ops.maximum(low.radius, high.radius)
            nearest = nearest * ops.minimum(tilt, 1.0)
        # ``largest`` limits the ellipses of the quadrature rule. If the phase is quadratic in the
        # position and changes by q radians, the logarithm of the integrand grows by q sinh(u)
        # cosh(u) within the ellipse of parameter u. The rule assumes a growth of 2 q sinh(u). The
        # excess is below 1 for ellipses up to ``largest``.
        bend = (0.5 * math.pi) * half * abs(rates[1] - rates[0])
        largest = 0.7 + ops.sqrt(1.0 + 1.0 / ops.maximum(bend, 1e-6))
        swing = half * ops.maximum(abs(rates[0]), abs(rates[1]))
        # ``extra`` is 1 + log(pi N). The first term is the largest excess of the growth. The second
        # term is necessary because the integrand may be larger by the factor pi N at complex
        # positions at which E = e.
        path = self.ahead + ops.maximum(low.beyond, high.beyond)
        extra = 1.0 + ops.log(ops.maximum(math.pi * path, 1.0))
        clear = ops.minimum(nearest / half, largest)
        needed, (_, growth, last) = nodes_needed(ops, digits + extra, clear, 2.0 * math.pi * swing)
        return needed, (digits, growth + extra, last + extra)

    def tail(self, ops: Any, at: _End, sign: Any, digits: Any, wave: Pair) -> tuple[Pair, Any]:
        """Return ``sign`` times the integral from the position ``at`` to infinity, and a bound.

        ``wave`` is the wave at this position. The error is at most exp(-digits) times the bound.
        """
        path = at.beyond + self.ahead
        slope2, mirror_factor, curved = at.slope * at.slope, self.mirror_factor, self.curved
        half, beta = 0.5 * self.alpha, mirror_factor * self.beta

        def node(
            y: Any, weight: Any,
            slope2: Any, phase: Any, path: Any, excess: Any, half: Any, beta: Any,
        ) -> Values:  # fmt: skip
            """Return the integrand of (B10), divided by the wave E at the end of the edge."""
            speed = root(ops, Pair(slope2 - curved * (y * y), 2.0 * phase * y))
            value = _quotient(weight * half, Pair(path, y) * speed)
            if mirror_factor:
                value = value + _quotient(weight * beta, Pair(path + excess, y) * speed)
            return value.real, value.imag

        rule = ops.select(sign == 0.0, -1.0, _tail_rule(ops, at.beyond, digits))
        real, imag = ops.sum_over_rule(
            rule, _tail_rules(), node, 2,
            slope2, at.phase, path, self.excess, half, beta,
        )  # fmt: skip
        total = (wave * Pair(-imag, real)).scaled(sign)
        size = abs(half) / ops.maximum(path, 1e-30)
        if mirror_factor:
            size = size + abs(beta) / (path + self.excess)
        slowest = 2.0 * math.pi * ops.maximum(abs(at.slope), 1e-30)
        return total, abs(sign) * size / slowest


def _tail_rule(ops: Any, beyond: Any, digits: Any) -> Number:
    """Return the index of the smallest rule whose error bound (B11) is at most exp(-digits)."""
    decay = ops.log(2.0 * math.pi * ops.maximum(beyond, 0.1))
    number = 0.0
    for size, bound in zip(_SIZES[:-1], _BOUNDS[:-1], strict=True):
        number = number + ops.select(digits + bound > 2.0 * size * decay, 1.0, 0.0)
    return number


def _quotient(real: Any, divisor: Pair) -> Pair:
    """Return a real number divided by a complex number."""
    return divisor.conjugate().scaled(real / divisor.norm())


def _edge(ops: Any, tables: BoundaryTables, row: Values, inner: Values, oblique: bool) -> Values:
    """Return the field of an edge and its error estimate, times the amplitude of the wave."""
    if tables.frame.paraxial:
        view, free, phase, cycles = seen_in_parabolic_waves(ops, row, inner, oblique)
        line, moment = _Line.parabolic(view), ()
    else:
        view, free, moment, phase = seen_from(ops, row, inner, TRAVELLING, oblique)
        alpha = moment[0] if moment else view.b
        line = _Line.spherical(ops, view, alpha, 0.5 - tables.m)
        cycles = rounded_cycles(ops, row, inner)
    digits = inner[9]
    begin, end = line.end(ops, 0.0 * view.length), line.end(ops, view.length)
    low, high = line.inner_part(ops, begin, end, digits)
    sums, expected = line.inner_sums(ops, tables.rules, low, high, digits, free, moment, phase)
    outside, mirrored = line.angles(ops, begin, low, high, end)
    # The wave e of (B2) is constant along the edge, so it is taken out of the integrals.
    total = Pair(sums[0], sums[1]) - free.scaled(0.5 * (outside + mirrored))
    size, missing = abs(outside) + abs(mirrored), error_of(ops, sums, expected, cycles)
    for at, sign in _signed_ends(ops, begin, low, high, end):
        wave = wave_on_panel(ops, at.t, at.radius, *phase)
        tail, bound = line.tail(ops, at, sign, digits, wave)
        total, size = total + tail, size + bound
        missing = missing + bound * ops.exp(-digits)
    ulp = 2.0**-52 if ops.double else 2.0**-23
    missing = missing + size * ulp * (4.0 + 2.0 * cycles)
    return weighted(row, total.real, total.imag, missing)


def _signed_ends(
    ops: Any, begin: _End, low: _End, high: _End, end: _End
) -> tuple[tuple[_End, Any], ...]:
    """Return three positions on an edge with the signs of their tails; 0 stands for no tail."""
    is_left, is_right = low.t > 0.0, high.t < end.t
    low_on_edge, high_on_edge = is_left & (low.t < end.t), is_right & (high.t > 0.0)
    limit = _End(
        *(
            ops.select(low_on_edge, getattr(low, field.name), getattr(high, field.name))
            for field in fields(_End)
        )
    )
    one = 1.0 + 0.0 * end.t
    limits = ops.select(low_on_edge, one, 0.0) + ops.select(high_on_edge, one, 0.0)
    return (
        (begin, ops.select(high.t <= 0.0, one, ops.select(is_left, -one, 0.0))),
        (limit, limits),
        (end, ops.select(low.t >= end.t, one, ops.select(is_right, -one, 0.0))),
    )
