"""Contributions of an edge to the field at a point, for travelling and evanescent waves.

The contribution is the integral (B3) of docs/theory/exact_fields.md. R is the distance from the
point P to the position Q on the edge. N = R - p.(P - Q) and N' = R - p'.(P - Q) are path
differences for the direction p of the wave and its mirror image p'. E is the wave at the edge, and
e and e' are the waves at the point along p and p'. The integrand times R is

    a (E - e)/2N + b' [(1/2 - m) E - e/2]/N'

where m is the factor of (B3), and a and b' are constants of the edge, (B2). On the ray of
the wave through the point, E - e and N vanish, so their quotient is computed without cancellation.
If the point is close to the plane and to the mirrored ray, where E - e' and N' vanish, the wave
*grazes* the point. The integrand times R is then

    a (E - e)/2N + (1/2 - m) b' (E - e')/N' + b'/N' [(1/2 - m) e' - e/2]

and its last term is integrated in closed form, (B4).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from polywigner.numerics import Number
from polywigner.numerics.jets import JetOperations
from polywigner.numerics.phases import Pair, cos_sin_cycles, one_less_exp, select, unit_wave

Values = tuple[Any, ...]
Point = tuple[Any, ...]

# Phase difference [cycles] below which the difference of two waves is computed as a product, to
# avoid cancellation.
_CLOSE = 0.5
# A travelling wave grazes a point if the point is below the height _LOW above the plane
# [wavelengths], and the sine of its angle to the mirrored ray is below _GRAZING.
_LOW, _GRAZING = 1.0, 0.3
# Decay exponent of an evanescent wave, divided by 2 pi, below which the wave grazes a point. The
# wave has then decayed by a factor of less than exp(pi).
_LOST = 0.5
# Distance [half-lengths of the panel] that represents "no singularity". A singularity at this
# distance lies outside the Bernstein ellipses of all quadrature rules.
_NONE = 100.0


@dataclass(frozen=True)
class PanelView:
    """A straight piece of an edge, in coordinates relative to a point.

    Lengths are in wavelengths. The position s along the panel runs from ``first`` to ``last``. The
    panel has the constant coordinate ``b`` to the left of its direction, and the point lies at the
    height ``z`` above the origin. The wave has the direction cosines (``along``, ``across``, p_z).
    """

    first: Any
    last: Any
    length: Any
    """Length last - first, which may be smaller than the rounding errors of ``first`` and
    ``last``."""
    radius_first: Any
    radius_last: Any
    b: Any
    z: Any
    along: Any
    across: Any
    pz: Any
    """Direction cosine p_z of a travelling wave, or q with p_z = i q of an evanescent wave."""


class _Travelling:
    """Travelling waves, whose direction cosine p_z is real and at least 0."""

    directions = 3
    """Number of direction cosines that determine the unobstructed wave."""

    def shared_data(
        self, ops: Any, view: PanelView, free: Pair, moment: Values
    ) -> tuple[Values, Any, Any]:
        """Return the data that all quadrature nodes of a panel share, and two bounds.

        ``free`` is the unobstructed wave e at the point P. ``moment`` contains the components of p
        x (P - Q) along the panel, to its right and along z, for the direction p of the wave and the
        start Q of the panel. ``moment`` is empty for waves along z. The data are the waves e and
        e', a flag for waves that graze the point, and the moment. The first bound is a lower bound
        on the sine of the angle to the mirrored ray, and the second bound is None.
        """
        z, pz = view.z, view.pz
        tilt = ops.minimum(pz + z / ops.maximum(view.radius_first, view.radius_last), 1.0)
        is_grazing = (z < _LOW) & (tilt < _GRAZING)
        turn = 2.0 * (pz * z)
        mirrored = free * unit_wave(ops, turn).conjugate()
        grazing = ops.select(is_grazing, 1.0, 0.0)
        data = (free.real, free.imag, mirrored.real, mirrored.imag, grazing, *moment)
        return data, ops.select(is_grazing, _NONE, tilt), None

    def closed_form(self, ops: Any, view: PanelView) -> Pair:
        """Return the integral of b'/(N' R) along the panel, (B4), whose imaginary part is 0.

        N' is the path difference of the mirrored wave, and b' is ``pz`` b - ``across`` z.
        """
        beta = view.pz * view.b - view.z * view.across
        first, last = (view.first, view.radius_first), (view.last, view.radius_last)
        level = view.b * view.across + view.pz * view.z
        angle = swept_angle(ops, view, beta, level, first, last, view.length)
        return Pair(angle, 0.0 * angle)

    def integrand(
        self, ops: Any, mirror_factor: float, edge: Pair, t: Any, s: Any, radius: Any,
        along: Any, b: Any, z: Any, across: Any, pz: Any,
        free_r: Any, free_i: Any, mirrored_r: Any, mirrored_i: Any, grazing: Any, *moment: Any,
    ) -> Pair:  # fmt: skip
        """Return the integrand of (B3) times R at the length t from the start of a panel.

        ``edge`` is the wave E at this length, ``radius`` is the distance R from the point, and
        ``mirror_factor`` is 1/2 - m. The other arguments are fields of :class:`PanelView` and the
        data of :meth:`shared_data`.
        """
        tiny = 1e-300 if ops.double else 1e-37
        lean, path = path_difference(ops, t, s, radius, along, b, z, across, pz, *moment)
        mirror = path + 2.0 * (pz * z)
        free, mirrored = Pair(free_r, free_i), Pair(mirrored_r, mirrored_i)
        first = wave_difference(ops, edge, free, path).scaled(0.5 * lean / ops.maximum(path, tiny))
        second = edge.scaled(mirror_factor) - free.scaled(0.5)
        if mirror_factor:
            smooth = wave_difference(ops, edge, mirrored, mirror).scaled(mirror_factor)
            second = select(ops, grazing > 0.5, smooth, second)
        else:
            second = second.scaled(1.0 - grazing)
        return first + second.scaled((pz * b - across * z) / ops.maximum(mirror, tiny))


class _Evanescent:
    """Evanescent waves, whose direction cosine p_z = i q is imaginary, with q > 0."""

    directions = 2

    def shared_data(
        self, ops: Any, view: PanelView, free: Pair, moment: Values
    ) -> tuple[Values, Any, Any]:
        """Return the data and bounds of :meth:`_Travelling.shared_data` for evanescent waves.

        ``free`` omits the decay exp(-2 pi q z). The data are e, e', a flag for waves that graze the
        point, the decay, 1 - decay, and 1/decay. The first bound is None, and the second bound is
        the least distance from the mirrored ray.
        """
        height = view.pz * view.z
        exponent = 2.0 * math.pi * height
        decay, small = ops.exp(-exponent), exponent < 1.0
        # The first omitted term of the series is 1/19! = 8e-18.
        series = one_less_exp(ops, ops.select(small, exponent, 0.0), 18)
        decayed = ops.select(small, series, 1.0 - decay)
        is_grazing = height < _LOST
        growth = 1.0 / ops.select(is_grazing, decay, 1.0)
        here, mirrored = free.scaled(decay), free.scaled(growth)
        grazing = ops.select(is_grazing, 1.0, 0.0)
        data = (
            here.real, here.imag, mirrored.real, mirrored.imag, grazing, decay, decayed, growth
        )  # fmt: skip
        return data, None, ops.select(is_grazing, _NONE * (1.0 + height), height)

    def closed_form(self, ops: Any, view: PanelView) -> Pair:
        """Return the complex integral of :meth:`_Travelling.closed_form` for evanescent waves."""
        # If ``along`` is negative, s is reversed, so that the factor 1 + |along| in the logarithm
        # is never 0.
        sign = ops.select(view.along < 0.0, -1.0, 1.0)
        begin = _total(ops, view, view.first, view.radius_first)
        end = _total(ops, view, view.last, view.radius_last)
        lift, constant = view.pz * view.b, view.b * view.across
        real, imag = 0.0, 0.0
        for side in (1.0, -1.0):
            x = -view.z * (view.across + side * view.pz)
            low, high = lift + side * (begin + constant), lift + side * (end + constant)
            real = real + side * ops.atan2(x * (high - low), x * x + low * high)
            imag = imag - side * 0.5 * ops.log((x * x + high * high) / (x * x + low * low))
        return Pair(sign * real, sign * imag)

    def integrand(
        self, ops: Any, mirror_factor: float, edge: Pair, t: Any, s: Any, radius: Any,
        along: Any, b: Any, z: Any, across: Any, q: Any,
        free_r: Any, free_i: Any, mirrored_r: Any, mirrored_i: Any, grazing: Any,
        decay: Any, decayed: Any, growth: Any,
    ) -> Pair:  # fmt: skip
        """Return the result of :meth:`_Travelling.integrand` for evanescent waves.

        N' is the conjugate of N, and b' is minus the conjugate of a.
        """
        path = radius + (s * along + b * across)
        height = q * z
        norm = path * path + height * height
        free, mirrored = Pair(free_r, free_i), Pair(mirrored_r, mirrored_i)
        factor = Pair(z * across, q * b) * Pair(path, height).scaled(1.0 / norm)
        first = wave_difference(ops, edge, free, path, decay, decayed)
        second = edge.scaled(mirror_factor) - free.scaled(0.5)
        if mirror_factor:
            smooth = wave_difference(ops, edge, mirrored, path, growth, -decayed * growth)
            second = select(ops, grazing > 0.5, smooth.scaled(mirror_factor), second)
        else:
            second = second.scaled(1.0 - grazing)
        return factor * first.scaled(0.5) - factor.conjugate() * second


EdgeWave = _Travelling | _Evanescent
TRAVELLING, EVANESCENT = _Travelling(), _Evanescent()


def path_difference(
    ops: Any, t: Any, s: Any, radius: Any, along: Any, b: Any, z: Any, across: Any, pz: Any,
    *moment: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """Return the constant a of (B2), and the path difference N = R - p.(P - Q) in wavelengths.

    R is the distance from the position Q on the panel to the point P. The result is accurate even
    if P - Q is parallel to the direction p of the wave. ``moment`` is the argument of
    :meth:`_Travelling.shared_data`. The constant a is the first component of ``moment``, or b for
    waves along z.
    """
    if not moment:
        return b, (s * s + b * b) / (radius + z)
    lean, run, side = moment
    ahead = pz * z - (s * along + b * across)
    e, n = run + pz * t, side + across * t
    crossed = lean * lean + (e * e + n * n)
    return lean, ops.select(ahead > 0.0, crossed / (radius + abs(ahead)), radius - ahead)


def wave_difference(
    ops: Any, edge: Pair, free: Pair, path: Any, factor: Any = None, lost: Any = None
) -> Pair:
    """Return the wave E at an edge minus the wave e at a point, without cancellation.

    The wave at the point is e = E exp(-2 pi i path) factor, with ``path`` in cycles. ``factor`` is
    1 by default, and ``lost`` is 1 - factor.
    """
    close = abs(path) < _CLOSE
    c, d = cos_sin_cycles(ops, 0.5 * ops.select(close, path, 0.0))
    if factor is None:
        turned = Pair(2.0 * (d * d), 2.0 * (d * c))
    else:
        turned = Pair(lost + 2.0 * factor * (d * d), 2.0 * factor * (d * c))
    return select(ops, close, edge * turned, edge - free)


def swept_angle(
    ops: Any, view: PanelView, factor: Any, level: Any, first: Values, last: Values, length: Any
) -> Number:
    """Return the integral of factor/(M R) along a part of an edge, (B4).

    M = R + p_e s + level, with p_e = ``view.along``, is either N or N', and ``factor`` is a for N
    and b' for N'. ``first`` and ``last`` contain the position s and the distance R at the ends.
    """
    begin, end = (_total(ops, view, *at) for at in (first, last))
    rise = factor * length * (begin + end) / (first[1] + last[1])
    return 2.0 * ops.atan2(rise, factor * factor + (begin + level) * (end + level))


def _total(ops: Any, view: PanelView, s: Any, radius: Any) -> Number:
    """Return (1 + |p_e|) (R + s), or (1 + |p_e|) (R - s) if p_e = ``view.along`` is negative."""
    t = ops.select(view.along < 0.0, -s, s)
    foot2 = view.b * view.b + view.z * view.z
    total = ops.select(t < 0.0, foot2 / (radius + abs(t)), radius + abs(t))
    return (1.0 + abs(view.along)) * total


def angle_about(ops: Any, source: Point, point: Point, start: Point, end: Point) -> Number:
    """Return the angle that an edge subtends about the axis from a source to a point.

    The angle is in radians, and positive if the rotation from start to end is right-handed about
    the axis.
    """
    axis = difference(point, source)
    inverse = 1.0 / ops.sqrt(dot(axis, axis))
    axis = tuple(a * inverse for a in axis)
    # Differences of the complete vectors would lose digits, so only the components perpendicular to
    # the axis are used.
    first, last = (_across(axis, difference(end_point, point)) for end_point in (start, end))
    return ops.atan2(dot(axis, cross(first, last)), dot(first, last))


def _across(axis: Point, vector: Point) -> Point:
    """Return the component of a vector perpendicular to a unit vector ``axis``."""
    along = dot(axis, vector)
    return tuple(v - along * a for v, a in zip(vector, axis, strict=True))


@dataclass(frozen=True)
class EdgeRule:
    """Quadrature rule for the boundary wave of a straight edge."""

    cycles: float
    """Largest excess of the path over the shortest path, in wavelengths, for which the wave is
    integrated along the edge."""
    nodes: tuple[tuple[float, float], ...]
    """Gauss-Legendre nodes on [-1, 1] with weights, for the part along the edge."""
    tails: tuple[tuple[float, float], ...]
    """Gauss-Laguerre nodes with weights, for the complex path of integration beyond the part along
    the edge."""

    @classmethod
    def of(cls, cycles: float, nodes: int, tails: int) -> EdgeRule:
        """Return a rule: ``nodes`` nodes along an edge, and ``tails`` nodes beyond ``cycles``."""
        along = np.stack(np.polynomial.legendre.leggauss(nodes), axis=-1)
        beyond = np.stack(np.polynomial.laguerre.laggauss(tails), axis=-1) / (2.0 * math.pi)
        return cls(cycles, *(tuple((t, w) for t, w in rule.tolist()) for rule in (along, beyond)))


def _always(_: Any, compute: Callable[..., tuple[Any, Any]], *arguments: Any) -> tuple[Any, Any]:
    """Return ``compute(*arguments)``, and ignore the condition."""
    return compute(*arguments)


class _EdgePaths:
    def __init__(
        self, ops: Any, source: Point, point: Point, start: Point, along: Point, length: Any
    ) -> None:
        from_source, to_point = difference(start, source), difference(point, start)
        s_first, s_last = -dot(from_source, along), dot(to_point, along)
        first = tuple(-q - s_first * t for q, t in zip(from_source, along, strict=True))
        last = tuple(r - s_last * t for r, t in zip(to_point, along, strict=True))
        least = 1e-12 if ops.double else 1e-6
        h_first, h_last = (ops.maximum(ops.sqrt(dot(v, v)), least) for v in (first, last))
        over, under = 1.0 / h_first, 1.0 / h_last
        near = tuple(a * over + b * under for a, b in zip(first, last, strict=True))
        away = tuple(a * over - b * under for a, b in zip(first, last, strict=True))
        axis = difference(point, source)
        gap, height = s_last - s_first, h_first + h_last
        # Product of the distances of the source and the point from the line of the edge.
        self.distance_product = product = h_first * h_last
        self.shortest = shortest = ops.sqrt(gap * gap + height * height)
        self.distance = ops.sqrt(dot(axis, axis))
        # ``total`` and ``detour`` are the sum and the difference of two lengths: the shortest path
        # over the line of the edge, and the distance from the source to the point.
        self.total = shortest + self.distance
        self.detour = product * dot(near, near) / self.total
        # ``closing`` is 1 - cos(angle) for the angle at the edge between the directions to the
        # source and to the point. It is 2 at the shadow boundary.
        self.closing = 0.5 * dot(away, away)
        # ``turn`` is the product of three factors: the distance of the source from the line of the
        # edge, the distance of the point from this line, and the sine of the angle at the edge
        # between the directions to the source and to the point. It is positive to the left of the
        # edge.
        self.turn = dot(cross(from_source, along), to_point)

        def root_at(s: Any) -> Number:
            """Return the variable v of (SB3) at the position s along the edge."""
            a, b = s - s_first, s - s_last
            rho, radius = ops.sqrt(a * a + h_first * h_first), ops.sqrt(b * b + h_last * h_last)
            lean = a * radius + b * rho
            size = ops.sqrt(product * product + lean * lean) + product
            return lean * ops.sqrt(2.0 / (size * (rho + radius + shortest)))

        # ``low`` and ``high`` are the values of v at the ends of the edge. The square of v is the
        # detour over an end minus the shortest detour. The sign of v is negative at positions
        # before the shortest detour.
        self.low, self.high = root_at(0.0 * length), root_at(length)

    def plate_turn(self, ops: Any, in_front: Any) -> Number:
        """Return 2 h h' cos(angle/2) for a plate that ends at the edge; negative at hidden points.

        The angle lies between the directions from the edge to the source and to the point. The
        distances of the source and the point from the line of the edge are h and h'. See
        :func:`edge_wave` for ``in_front``.
        """
        near = 2.0 * self.distance_product * ops.sqrt(ops.maximum(1.0 - 0.5 * self.closing, 0.0))
        steep = abs(self.turn) / ops.sqrt(0.5 * ops.maximum(self.closing, 1.0))
        size = ops.select(self.closing > 1.0, steep, near)
        return ops.select(self._is_hidden(in_front), -size, size)

    def _is_hidden(self, in_front: Any) -> Any:
        """Return whether ``in_front`` is 0 and the point lies on the shadow side of the edge."""
        return (self.turn < 0.0) & (in_front < 0.5)

    def angle(self, ops: Any, limit: float, in_front: Any = 0.0) -> Number:
        """Return the angle that an edge subtends about the axis from the source to the point.

        The angle is in radians, and negative on the shadow side of the edge unless ``in_front`` is
        1. Only the part of the edge with |v| < ``limit`` is included, where v^2 is the detour over
        the edge minus the shortest detour.
        """
        low, high = (_clamped(ops, v, limit) for v in (self.low, self.high))
        # Near the shadow boundary, ``turn`` replaces the square root of the detour, which would
        # lose digits by cancellation.
        closing = ops.maximum(self.closing, 1.0)
        steep = ops.sqrt(2.0 / (self.distance_product * self.total * closing))
        root = ops.select(self.closing > 1.0, abs(self.turn) * steep, ops.sqrt(self.detour))
        angle = ops.atan2((high - low) * root, self.detour + low * high)
        return ops.select(self._is_hidden(in_front), -angle, angle)


def _clamped(ops: Any, v: Any, limit: float) -> Number:
    """Return v limited to the range from -``limit`` to ``limit``."""
    return ops.maximum(ops.minimum(v, limit), -limit)


def edge_wave(
    ops: Any, rule: EdgeRule, source: Point, point: Point, start: Point, end: Point,
    aside: Point | None = None, when: Callable[..., tuple[Any, Any]] = _always,
    blocked: Any = None, in_front: Any = None,
) -> Pair:  # fmt: skip
    """Return 2 pi times the ratio of the boundary wave of an edge to the unobstructed wave.

    The boundary wave is the integral of the wave of a point source along a directed edge of a
    silhouette, (SB3). The square v^2 of the variable of integration is the detour minus the
    shortest detour. The integrand is exp(2 pi i v^2) times a smooth even function, whose poles at
    the shadow boundary are integrated in closed form. Beyond ``rule.cycles`` the path of
    integration is complex.

    Parameters
    ----------
    rule : EdgeRule
        Quadrature nodes along the edge and on the complex path.
    source, point, start, end : tuple of arrays
        Coordinates of the point source, the observer and the two ends of the edge, in wavelengths.
    aside : tuple of arrays, optional
        Position near the point that decides on which side of the shadow boundary the point lies.
    when : callable, optional
        Function (condition, compute, arguments) that returns the computed numbers, or zeros if the
        condition is false.
    blocked : array, optional
        Fraction, from 0 to 1, of the shadow boundary that another surface hides. If the fraction is
        1, the step of the wave at the shadow boundary is omitted, (SB5).
    in_front : array, optional
        For edges of conducting plates: 1 if the point and the source lie on the same side of the
        plate, 0 otherwise. The result is then the boundary wave of the incident field, (SB9). By
        default the edge is black.
    """
    along = difference(end, start)
    length = ops.sqrt(dot(along, along))
    along = tuple(a / length for a in along)
    paths = _EdgePaths(ops, source, point, start, along, length)
    detour, total_path = paths.detour, paths.total
    distance = paths.distance
    # A conducting edge multiplies the integrand of (SB3) by a factor, (SB9). This factor changes
    # ``turn`` and ``half_closing``, and cancels a square root in ``density``.
    is_black = in_front is None
    if is_black:
        turn, half_closing, side = paths.turn, 0.5 * paths.closing, 0.0
    else:
        turn, half_closing, side = paths.plate_turn(ops, in_front), 1.0, in_front
    slant = 0.5 / paths.shortest
    foot = 4.0 * paths.distance_product * slant
    # ``branch`` is |v|^2 at the branch point of the integrand that is nearest to v = 0.
    branch = foot if is_black else 2.0 * paths.shortest

    def density(q: Any) -> Number:
        """Return the smooth factor of the integrand at q = v^2."""
        stretched = 1.0 + slant * q
        growing = q * stretched + foot if is_black else foot
        return slant / ((total_path + q) * ops.sqrt(stretched * growing))

    limit = math.sqrt(rule.cycles)
    low, high = (_clamped(ops, v, limit) for v in (paths.low, paths.high))
    pole = density(ops.select(detour < 0.5 * branch, -detour, 0.0))
    tiny = 1e-300 if ops.double else 1e-37

    def near_foot(low: Any, high: Any) -> tuple[Any, Any]:
        """Return the integral from ``low`` to ``high`` of the integrand without its pole."""
        scale = ops.sqrt(ops.minimum(branch, 4.0 * rule.cycles))
        first, last = (
            inverse_sinh(ops, v, ops.sqrt(v * v + 1.0)) for v in (low / scale, high / scale)
        )
        midpoint, half = 0.5 * (first + last), 0.5 * (last - first)
        real, imag = 0.0, 0.0
        for at, weight in rule.nodes:
            grown = ops.exp(midpoint + half * at)
            shrunk = 1.0 / grown
            v = 0.5 * scale * (grown - shrunk)
            q = v * v
            c, s = cos_sin_cycles(ops, detour + q)
            factor = weight * (grown + shrunk) / ops.maximum(detour + q, tiny)
            value = density(q)
            real, imag = real + factor * (c * value - pole), imag + factor * s * value
        size = 2.0 * turn * distance * scale * half
        return size * real, size * imag

    def beyond(v: Any) -> tuple[Any, Any]:
        """Return the integral from v to infinity, along a complex path on which the wave decays."""
        q = v * v
        total, grown = Pair(0.0, 0.0), Pair(ops.sqrt(foot), 0.0)
        for y, weight in rule.tails:
            stretched = Pair(1.0 + slant * q, slant * y)
            z = Pair(q, y)
            risen = z * stretched
            # The arguments of ``risen`` and ``growing`` are below 180 degrees, but their sum may
            # exceed 180 degrees. Therefore the root of each factor is computed separately.
            growing = root(ops, Pair(risen.real + foot, risen.imag)) if is_black else grown
            rooted = root(ops, risen) * growing
            below = Pair(detour + q, y) * Pair(total_path + q, y) * rooted
            norm = weight / (below.real * below.real + below.imag * below.imag)
            total = total + Pair(below.real * norm, -below.imag * norm)
        wave = unit_wave(ops, detour + q) * total
        return -wave.imag, wave.real

    def outside(start: Any, end: Any) -> tuple[Any, Any]:
        """Return the sum of the integrals from the inner part to ``start`` and to ``end``."""
        # If v does not change sign along the edge, the integrals from the limit to infinity cancel.
        has_foot = (start < 0.0) & (end >= 0.0)
        real, imag = when(has_foot, beyond, 0.0 * start + limit)
        count = ops.select(has_foot, 2.0, 0.0)
        real, imag = count * real, count * imag
        for sign, v in ((-1.0, start), (1.0, end)):
            off = beyond(ops.maximum(abs(v), limit))
            sign = ops.select(v < 0.0, -sign, sign)
            real, imag = real - sign * off[0], imag - sign * off[1]
        size = 2.0 * turn * distance * slant
        return size * real, size * imag

    real, imag = when(low < high, near_foot, low, high)
    ends = paths.low, paths.high
    farther = when((low > ends[0]) | (high < ends[1]) | (low == high), outside, *ends)
    step = 4.0 * distance * pole * ops.sqrt(half_closing * paths.distance_product * total_path)
    if blocked is not None:
        step = step * (1.0 - blocked * ops.exp(-2.0 * math.pi * paths.detour))
    # The angle is discontinuous if the axis from the source to the point meets the edge. All edges
    # use the same position near the point, so that the sum over all edges is smooth.
    paths_aside = paths if aside is None else _EdgePaths(ops, source, aside, start, along, length)
    step = step * paths_aside.angle(ops, limit, side)
    return Pair(real + step + farther[0], imag + farther[1])


def edge_wave_and_rate(
    ops: Any, rule: EdgeRule, source: Point, point: Point, start: Point, end: Point,
    aside: Point | None = None, when: Callable[..., tuple[Any, Any]] = _always,
    blocked: Any = None, in_front: Any = None,
) -> tuple[Pair, Pair]:  # fmt: skip
    """Return the complex result of :func:`edge_wave`, and its derivative along z at the source.

    The derivative is with respect to the z coordinate of the source in wavelengths.
    """
    jets = JetOperations(ops)
    (height,) = jets.variables(source[2:])
    point, start, end = (jets.constants(some) for some in (point, start, end))
    aside = None if aside is None else jets.constants(aside)
    flags = (None if flag is None else jets.constants((flag,))[0] for flag in (blocked, in_front))
    source_jets = (*jets.constants(source[:2]), height)
    wave = edge_wave(jets, rule, source_jets, point, start, end, aside, when, *flags)
    parts = wave.real, wave.imag
    return Pair(*(part.value for part in parts)), Pair(*(part.derivatives[0] for part in parts))


def edge_change(
    ops: Any, rule: EdgeRule, wave: Pair, dipole: Pair | None, *path: Any, **how: Any
) -> tuple[Pair, Pair]:
    """Return the change of a point source's wave due to an edge, and the result of `edge_wave`.

    ``path`` contains the source, the point, the ends of the edge, and optionally the position near
    the point. ``wave`` is the wave at the point. ``dipole`` is the part of this wave that depends
    on the direction, without obliquity, or None if this part is zero, (SB5). ``how`` contains
    further arguments of :func:`edge_wave`.
    """
    if dipole is None:
        boundary = edge_wave(ops, rule, *path, **how)
        return wave * boundary.scaled(-0.5 / math.pi), boundary
    boundary, rate = edge_wave_and_rate(ops, rule, *path, **how)
    # The derivative contributes the factor i/(2 pi), and the boundary wave the factor -1/(2 pi).
    bend = (dipole * rate).scaled(0.25 / math.pi**2)
    return wave * boundary.scaled(-0.5 / math.pi) + Pair(bend.imag, -bend.real), boundary


def path_over(
    ops: Any, source: Point, point: Point, start: Point, end: Point
) -> tuple[Any, Any, Any, Any]:
    """Return the shortest path from a source over a straight edge to a point.

    The results are the detour, the cosine of the deflection at the edge (1 for a straight path),
    the position of the bend as a fraction of the edge from 0 to 1, and the excess length compared
    with the shortest path over the infinite line of the edge.
    """
    along = difference(end, start)
    length = ops.sqrt(dot(along, along))
    inverse = 1.0 / length
    from_source, to_point = difference(start, source), difference(point, start)
    s, t = -dot(from_source, along) * inverse, dot(to_point, along) * inverse
    h, g = (
        ops.sqrt(ops.maximum(dot(v, v) - at * at, 0.0))
        for v, at in ((from_source, s), (to_point, t))
    )
    foot = (s * g + t * h) / ops.maximum(h + g, 1e-6)
    foot = ops.maximum(ops.minimum(foot, length), 0.0) * inverse
    first = tuple(q + foot * a for q, a in zip(from_source, along, strict=True))
    last = tuple(r - foot * a for r, a in zip(to_point, along, strict=True))
    axis = difference(point, source)
    rho, radius, distance = (ops.sqrt(dot(v, v)) for v in (first, last, axis))
    product, ahead, normal = rho * radius, dot(first, last), cross(first, last)
    # ``bent`` is product - ahead, in a form that is accurate for almost straight paths.
    bent = dot(normal, normal) / ops.maximum(product + ahead, 1e-30)
    bent = ops.select(ahead > 0.0, bent, product - ahead)
    excess = rho + radius - ops.sqrt((t - s) * (t - s) + (h + g) * (h + g))
    detour = 2.0 * bent / (rho + radius + distance)
    return detour, ahead / ops.maximum(product, 1e-30), foot, excess


def inverse_sinh(ops: Any, sinh: Any, cosh: Any) -> Number:
    """Return the number v with the hyperbolic sine ``sinh`` and the hyperbolic cosine ``cosh``."""
    logarithm = ops.log(abs(sinh) + cosh)
    return ops.select(sinh < 0.0, -logarithm, logarithm)


def root(ops: Any, z: Pair) -> Pair:
    """Return the principal square root; it loses digits near the negative real axis."""
    real = ops.sqrt(0.5 * (ops.sqrt(z.real * z.real + z.imag * z.imag) + z.real))
    return Pair(real, 0.5 * z.imag / real)


def difference(a: Point, b: Point) -> Point:
    """Return the vector a - b."""
    return tuple(x - y for x, y in zip(a, b, strict=True))


def dot(a: Point, b: Point) -> Number:
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Point, b: Point) -> Point:
    """Return the vector product of two vectors."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
