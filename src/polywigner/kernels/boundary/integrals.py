"""Fields of plane waves behind an aperture, as integrals along panels of its edges.

Lengths are in wavelengths and phases in cycles. A panel is a straight piece of an edge. For each
panel and point, the axis e is parallel to the panel, n points to its left, and the origin is the
projection of the point onto the aperture plane. The point has the height z, a position on the panel
is (s, b) with constant b, and the wave has the direction cosines (along, across, p_z). The formulas
are (B1) to (B5) of docs/theory/exact_fields.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any

from polywigner.kernels.boundary.edge_waves import (
    EVANESCENT,
    TRAVELLING,
    EdgeWave,
    PanelView,
    inverse_sinh,
)
from polywigner.kernels.kernel import Kernel, Values
from polywigner.numerics import Number, phases
from polywigner.numerics.nodes import (
    SUMS,
    Rules,
    error_of,
    gauss_rules,
    node_sums,
    nodes_needed,
    rule_index,
)
from polywigner.numerics.phases import Doubled, Pair, cos_sin_cycles, unit_wave

# Largest distance [wavelengths] that a sum of two floats resolves without overflow of products.
_FARTHEST = 1e30


def point_in_wavelengths(
    ops: Any, centre: tuple[float, float], wavelength: float, x: Any, y: Any, z: Any
) -> tuple[Doubled, Doubled, Doubled]:
    """Return a point relative to the centre of the source, in wavelengths (float64 only).

    The arguments are in metres. Each coordinate of the result is the sum of two floats.
    """
    scale = phases.doubled(1 / Fraction(wavelength))
    aside = (
        phases.difference(v, c) if c else (v, 0.0) for v, c in zip((x, y), centre, strict=True)
    )
    lengths = (*aside, (z, 0.0))
    a, b, c = (phases.dot(ops, (scale,), (length,)) for length in lengths)
    return a, b, c


def distance_of(ops: Any, point: tuple[Doubled, ...]) -> Doubled:
    """Return the distance of a point from the centre as the sum of two floats."""
    highs = tuple(high for high, _ in point)
    root = ops.sqrt(sum(high * high for high in highs))
    total, lost = phases.dot(ops, (*highs, -root), (*highs, root))
    for high, low in point:
        lost = lost + 2.0 * high * low
    correction = (total + lost) / (2.0 * root)
    return root, ops.select(root < _FARTHEST, correction, 0.0)


def paraxial_distance(ops: Any, point: tuple[Doubled, ...]) -> Doubled:
    """Return the paraxial distance z + (x^2 + y^2)/(2 z) of a point as the sum of two floats."""
    (x, x_low), (y, y_low), (z, z_low) = point
    rise = (x * x + y * y) / (2.0 * z)
    total, lost = phases.dot(ops, (x, y, -rise), (x, y, 2.0 * z))
    lost = lost + 2.0 * (x * x_low + y * y_low - rise * z_low)
    correction = (total + lost) / (2.0 * z)
    high, low = phases.difference(z, -rise)
    return high, low + (z_low + ops.select(high < _FARTHEST, correction, 0.0))


Row = tuple[float, ...]
"""A panel (start relative to the centre, unit vector, length) and a wave (three direction cosines
as two floats each, phase at the start of the panel, complex amplitude divided by 2 pi, and 1 for
an evanescent wave or 0 otherwise). For an evanescent wave with p_z = i q, q replaces p_z."""

# Half-width of the strip of the complex variable v that is assumed to contain no singularities,
# about 10 % below the actual half-width pi/2. The position along the panel is a multiple of
# sinh(v).
_STRIP = 1.4


@dataclass(frozen=True)
class BoundaryFrame:
    """Coordinates of boundary integrals, relative to the centre of the source in wavelengths."""

    centre: tuple[float, float]
    wavelength: float
    double: bool
    paraxial: bool
    """Whether phases are relative to the paraxial distance instead of the distance."""


@dataclass(frozen=True)
class BoundaryTables:
    """One row for each panel and wave, and the quadrature rules for integrals along panels."""

    frame: BoundaryFrame
    edges: tuple[Row, ...]
    rules: Rules
    m: float
    """Factor m in the second term of (B3): 0 for the Rayleigh-Sommerfeld integral II, 1/2 for
    Kirchhoff's integral, and 1 for the Rayleigh-Sommerfeld integral I."""


def enter(ops: Any, frame: BoundaryFrame, x: Any, y: Any, z: Any, digits: Any) -> Values:
    """Return the coordinates of a point and its distance, each as the sum of two floats.

    The arguments x, y and z are in metres. The first eight results are x, y, z and the distance in
    wavelengths, relative to the centre of the source. The last two results are the phase of the
    distance in cycles, modulo 1, and ``digits``, which is minus the natural logarithm of the
    allowed error.
    """
    point = point_in_wavelengths(ops, frame.centre, frame.wavelength, x, y, z)
    distance = (paraxial_distance if frame.paraxial else distance_of)(ops, point)
    numbers = (*point, distance)
    parts = numbers if frame.double else tuple(phases.split(ops, n) for n in numbers)
    return (*(part for pair in parts for part in pair), phases.reduced(ops, distance), digits)


def leave(ops: Any, frame: BoundaryFrame, inner: Values, sums: Values) -> Values:
    """Return the field, including the phase factor exp(2 pi i distance), and its absolute error."""
    real, imag, error = sums
    cosine, sine = cos_sin_cycles(ops, inner[8])
    return real * cosine - imag * sine, real * sine + imag * cosine, error


def leave_phase(ops: Any, frame: Any, inner: Values, sums: Values) -> Values:
    """Return the field without the phase of the distance, and its absolute error."""
    return sums


def edge_sum(ops: Any, tables: BoundaryTables, *inner: Any) -> Values:
    """Return the real and imaginary part of the field at a point, and the absolute error.

    The field does not include the phase of the distance from the centre of the source to the point.
    """
    totals: Values = ()
    for wave, flag in ((TRAVELLING, 0.0), (EVANESCENT, 1.0)):
        rows = [row[:-1] for row in tables.edges if row[-1] == flag]
        if not rows:
            continue

        oblique = wave is TRAVELLING and any(row[5] or row[7] for row in rows)

        def term(*row: Any, wave: EdgeWave = wave, oblique: bool = oblique) -> Values:
            return _panel(ops, tables, row, inner, wave, oblique)

        sums = ops.sum_over(rows, term, 3, like=inner[0], unroll=False)
        totals = tuple(a + b for a, b in zip(totals, sums, strict=True)) if totals else sums
    return totals


def _panel(
    ops: Any, tables: BoundaryTables, row: Values, inner: Values, wave: EdgeWave, oblique: bool
) -> Values:
    """Return the field of a panel and its error estimate, times the amplitude of the wave.

    ``oblique`` is true if the direction of any wave differs from z.
    """
    view, free, moment, phase = seen_from(ops, row, inner, wave, oblique)
    shared, sine, depth = wave.shared_data(ops, view, free, moment)
    mirror_factor = 0.5 - tables.m

    def node(t: Any, s: Any, radius: Any, scale: Any, weights: Values, *pair: Any) -> Values:
        edge = wave_on_panel(ops, t, radius, *pair[:5])
        value = wave.integrand(ops, mirror_factor, edge, t, s, radius, pair[3], *pair[5:])
        value = value.scaled(scale)
        return node_sums(value.real, value.imag, *weights)

    sums, expected = sums_over_panel(
        ops, tables.rules, view, (sine, depth, inner[9]), node, SUMS,
        *phase, view.b, view.z, view.across, view.pz, *shared,
    )  # fmt: skip
    error = error_of(ops, sums, expected, rounded_cycles(ops, row, inner))
    e, mirrored, grazing = Pair(*shared[:2]), Pair(*shared[2:4]), shared[4]
    amplitude = mirrored.scaled(mirror_factor) - e.scaled(0.5)
    closed_form = (wave.closed_form(ops, view) * amplitude).scaled(grazing)
    return weighted(row, sums[0] + closed_form.real, sums[1] + closed_form.imag, error)


def seen_from(
    ops: Any, row: Values, inner: Values, wave: EdgeWave, oblique: bool
) -> tuple[PanelView, Pair, Values, Values]:
    """Return a panel in coordinates relative to a point, and the wave at the point.

    The results are the panel, the unobstructed wave at the point, the moment (empty for waves along
    z), and arguments of :func:`wave_on_panel`.
    """
    x, y, ex, ey, length, *cosines, start, _, _ = row
    px, _, py, _, pz, _ = cosines
    # In float32 kernels, the sum of a number and its remainder rounds to the number.
    z, distance = inner[4] + inner[5], inner[6] + inner[7]
    offset = _offset_of(inner, x, y)
    dx, dy = -(offset[0][0] + offset[0][1]), -(offset[1][0] + offset[1][1])
    first, b = ex * dx + ey * dy, ex * dy - ey * dx
    view = panel_view(ops, first, length, b, z, (px * ex + py * ey, py * ex - px * ey, pz))
    free = Pair(*_free_wave(ops, cosines[: 2 * wave.directions], offset, inner, start))
    moment = _moment(ops, cosines, offset, ex, ey) if oblique else ()
    square = _square_along(inner[0] + inner[1], inner[2] + inner[3], *row[:4])
    return view, free, moment, (*square, distance, view.along, start)


def _moment(ops: Any, cosines: Any, offset: Any, ex: Any, ey: Any) -> Values:
    """Return the components of p x (P - Q) along a panel, to its right and along z.

    ``cosines`` is the direction p of the wave, and ``offset`` the point P minus the start Q of the
    panel. The products are computed without cancellation, because P - Q may be long and almost
    parallel to p.
    """
    px, py, pz = zip(cosines[::2], cosines[1::2], strict=True)
    x, y, z = offset
    moment_x, moment_y = phases.cross(ops, py, pz, y, z), phases.cross(ops, pz, px, z, x)
    moment_z = phases.cross(ops, px, py, x, y)
    return ex * moment_x + ey * moment_y, ey * moment_x - ex * moment_y, moment_z


def panel_view(
    ops: Any, first: Any, length: Any, b: Any, z: Any, cosines: tuple[Any, Any, Any]
) -> PanelView:
    """Return a panel that starts at (first, b) relative to a point.

    ``first`` is the coordinate along the panel, and ``b`` is the coordinate to its left.

    ``cosines`` are the direction cosines of the wave along these axes and z.
    """
    last, foot2 = first + length, b * b + z * z
    ends = (ops.sqrt(first * first + foot2), ops.sqrt(last * last + foot2))
    return PanelView(first, last, length, *ends, b, z, *cosines)


def sums_over_panel(
    ops: Any, rules: Rules, view: PanelView, bounds: tuple[Any, Any, Any],
    node: Callable[..., Values], values: int, *data: Any,
) -> tuple[Values, Values]:  # fmt: skip
    """Return the integrals of the values of ``node`` along a panel, and their expected errors.

    The variable of integration is the length along the panel, or an angle if the point is close to
    the panel.

    Parameters
    ----------
    bounds : tuple
        The two bounds that ``shared_data`` of the wave returns, and minus the natural logarithm of
        the allowed error.
    node : callable
        Function (t, s, radius, step / radius, weights, *data) that returns the values at a node.
    values : int
        Number of values that ``node`` returns.
    """
    sine, depth, digits = bounds
    far, clear, swing, half = _lengthwise(ops, view, sine, depth)
    near_clear, near_swing, midpoint, span = _anglewise(ops, view, sine, depth)
    clear, swing = ops.select(far, clear, near_clear), ops.select(far, swing, near_swing)
    needed, expected = nodes_needed(ops, digits, clear, 2 * math.pi * swing)
    rule, foot2 = rule_index(ops, needed), view.b * view.b + view.z * view.z

    def far_node(
        at: Any, w: Any, v1: Any, v2: Any, half: Any, first: Any, foot2: Any, *data: Any
    ) -> Values:
        t = half * (1.0 + at)
        s = first + t
        radius = ops.sqrt(s * s + foot2)
        return node(t, s, radius, half / radius, (w, v1, v2), *data)

    def near_node(
        at: Any, w: Any, v1: Any, v2: Any,
        midpoint: Any, span: Any, away: Any, first: Any, *data: Any,
    ) -> Values:  # fmt: skip
        """Return the values at s = away sinh v, at the distance away cosh v from the point."""
        grown = ops.exp(midpoint + span * at)
        shrunk = 1.0 / grown
        s, radius = 0.5 * away * (grown - shrunk), 0.5 * away * (grown + shrunk)
        return node(s - first, s, radius, span, (w, v1, v2), *data)

    far_rule, near_rule = ops.select(far, rule, -1.0), ops.select(far, -1.0, rule)
    far_data = (half, view.first, foot2, *data)
    far_sums = ops.sum_over_rule(far_rule, rules, far_node, values, *far_data)
    near_data = (midpoint, span, ops.sqrt(foot2), view.first, *data)
    near_sums = ops.sum_over_rule(near_rule, rules, near_node, values, *near_data)
    return tuple(a + b for a, b in zip(far_sums, near_sums, strict=True)), expected


def _lengthwise(ops: Any, view: PanelView, sine: Any, depth: Any) -> tuple[Any, ...]:
    """Return whether the rule along a panel suffices, and the clearance, phase and half-length.

    The clearance is the distance to the nearest singularity in half-lengths of the panel. The phase
    is the change of phase over half of the panel, in cycles.
    """
    half = 0.5 * view.length
    outside = ops.maximum(ops.maximum(view.first, -view.last), 0.0)
    nearest = ops.sqrt(outside * outside + (view.b * view.b + view.z * view.z))
    swing = ops.maximum(
        abs(view.first / view.radius_first + view.along),
        abs(view.last / view.radius_last + view.along),
    )
    clear = nearest * sine if depth is None else depth / ops.maximum(swing, 1e-30)
    return nearest >= half, ops.minimum(clear, nearest) / half, half * swing, half


def _anglewise(ops: Any, view: PanelView, sine: Any, depth: Any) -> tuple[Any, ...]:
    """Return the clearance, phase, centre and half-length for the variable v in s = away sinh v."""
    away = ops.sqrt(view.b * view.b + view.z * view.z)
    low = inverse_sinh(ops, view.first / away, view.radius_first / away)
    high = inverse_sinh(ops, view.last / away, view.radius_last / away)
    midpoint, span = 0.5 * (low + high), 0.5 * (high - low)
    swing = ops.maximum(
        abs(view.first + view.along * view.radius_first),
        abs(view.last + view.along * view.radius_last),
    )
    clear = _STRIP * sine if depth is None else depth / ops.maximum(swing, 1e-30)
    # At distant points, the interval of v may round to 0. The rule along the panel is used at these
    # points.
    return ops.minimum(clear, _STRIP) / ops.maximum(span, 1e-30), span * swing, midpoint, span


def rounded_cycles(ops: Any, row: Values, inner: Values) -> Number:
    """Return the phase, in cycles, whose rounding error contributes to the error of a panel."""
    size = abs(row[0]) + abs(row[1]) + row[4]
    return _rounded_cycles(ops, size, inner[6] + inner[7], abs(row[5]) + abs(row[7]))


def _rounded_cycles(ops: Any, size: Any, distance: Any, slope: Any) -> Number:
    """Return the phase, in cycles, whose rounding error contributes to the error of a panel.

    ``size`` is the largest distance of the panel from the centre of the source. The rounding error
    of the distance is the same for all panels. Far outside the shadow pattern this error cancels,
    except for the fraction ``slope``.
    """
    ulp = 2.0**-52 if ops.double else 2.0**-23
    return size + ulp * (slope * distance + ops.minimum(distance, 4.0 * size * size))


def weighted(row: Values, real: Any, imag: Any, error: Any) -> Values:
    """Return a panel integral and its error estimate, times the complex amplitude in ``row``."""
    r, i = row[-2:]
    return real * r - imag * i, real * i + imag * r, error * (abs(r) + abs(i))


def _square_along(x: Any, y: Any, begin_x: Any, begin_y: Any, ex: Any, ey: Any) -> tuple[Any, Any]:
    """Return the coefficients of radius^2 - distance^2 = constant + t (slope + t) along a panel.

    ``radius`` is the distance between a point at (x, y), at any height, and the position t on the
    panel. ``distance`` is the distance of this point from the centre of the source.
    """
    constant = begin_x * (begin_x - 2.0 * x) + begin_y * (begin_y - 2.0 * y)
    return constant, 2.0 * (ex * (begin_x - x) + ey * (begin_y - y))


def _offset_of(inner: Values, x: Any, y: Any) -> tuple[phases.Doubled, ...]:
    """Return the vector from a position (x, y, 0) to the point, with two floats per coordinate."""
    offset = []
    for high, low, origin in ((inner[0], inner[1], x), (inner[2], inner[3], y)):
        rounded, lost = phases.difference(high, origin)
        offset.append((rounded, lost + low))
    return (*offset, (inner[4], inner[5]))


def _free_wave(ops: Any, cosines: Any, offset: Any, inner: Values, start: Any) -> Values:
    """Return the unobstructed wave at the point, divided by exp(2 pi i distance).

    For evanescent waves, ``cosines`` and the result omit p_z and the decay. ``start`` is the phase
    of the wave at the start of the panel, in cycles.
    """
    floats = (*cosines, -1.0, 0.0)
    direction = tuple(zip(floats[::2], floats[1::2], strict=True))
    offsets = (*offset[: len(direction) - 1], (inner[6], inner[7]))
    cycles = phases.reduced(ops, phases.dot(ops, direction, offsets)) + start
    return cos_sin_cycles(ops, cycles)


def wave_on_panel(
    ops: Any, t: Any, radius: Any,
    constant: Any, slope: Any, distance: Any, along: Any, start: Any,
) -> Pair:  # fmt: skip
    """Return the wave from a position on a panel at the point, divided by exp(2 pi i distance).

    The phase of the result in cycles is radius - distance + along t + start, where t is the length
    from the start of the panel.
    """
    cycles = (constant + t * (slope + t)) / (radius + distance) + along * t + start
    return unit_wave(ops, cycles)


def seen_in_parabolic_waves(
    ops: Any, row: Values, inner: Values, oblique: bool
) -> tuple[PanelView, Pair, Values, Any]:
    """Return a panel of an edge relative to a point, for the parabolic waves of (B6).

    ``row`` is a row of panel data, and ``inner`` contains the point as x, y and z, each as two
    floats. ``oblique`` must be true for a plane wave at oblique incidence.

    The results are the panel, the unobstructed wave, arguments of :func:`wave_on_panel` with the
    height z as the distance, and the phase, in cycles, whose rounding error contributes to the
    error of the panel. The origin is the position at which the ray of the wave through the point
    crosses the plane.
    """
    x, y, ex, ey, length, *cosines, start, _, _ = row
    z, offset = inner[4] + inner[5], _offset_of(inner, x, y)
    px, py, one = (cosines[0], cosines[1]), (cosines[2], cosines[3]), (1.0, 0.0)
    if oblique:
        dx = phases.cross(ops, px, offset[0], one, offset[2])
        dy = phases.cross(ops, py, offset[1], one, offset[2])
    else:
        dx, dy = -(offset[0][0] + offset[0][1]), -(offset[1][0] + offset[1][1])
    first, b = ex * dx + ey * dy, ex * dy - ey * dx
    view = panel_view(ops, first, length, b, z, (0.0, 0.0, 1.0))
    free = Pair(*_free_wave(ops, cosines, offset, inner, start))
    size, aside = abs(x) + abs(y) + length, abs(inner[0]) + abs(inner[2])
    cycles = _rounded_cycles(ops, size * (1.0 + (aside + size) / z), inner[6], 1.0)
    along = px[0] * ex + py[0] * ey
    square = _square_along(inner[0] + inner[1], inner[2] + inner[3], *row[:4])
    return view, free, (*square, z, along, start), cycles


# STRIPS integrates u G, u (1/R - 2 pi i) G/R, and t u (1/R - 2 pi i) G/R along single panels, for
# gradients (G6) and polarised fields (VP4). u is the field, t the length from the start of the
# panel, R the distance from the point, and G = exp(2 pi i R)/R. Panels are arguments, so one
# compiled kernel handles all outlines.

# Logarithm of the growth of the integrand for complex v. Within the strip of half-width _STRIP,
# 1/R^2 exceeds its value on the panel by a factor of up to 1/cos^2(1.4) = 35.
_GROWN = 3.6


@dataclass(frozen=True)
class _Strips:
    frame: None
    edges: tuple[tuple[()], ...]
    rules: Rules


@cache
def _tables(source: None, double: bool) -> _Strips:
    """Return tables without panels, because panels are arguments of the kernel."""
    return _Strips(None, ((),), gauss_rules())


def _strip(
    ops: Any, tables: _Strips, x: Any, y: Any, z: Any, begin_x: Any, begin_y: Any, ex: Any, ey: Any,
    length: Any, along: Any, start: Any, digits: Any,
) -> Values:  # fmt: skip
    """Return the integrals of u G, u (1/R - 2 pi i) G/R, and t u (1/R - 2 pi i) G/R along a panel.

    Here u is the wave at the length t, R is the distance from the point, and G = exp(2 pi i R)/R.
    The results are six real numbers, without the factor exp(2 pi i |(x, y, z)|).
    """
    dx, dy = begin_x - x, begin_y - y
    first, b = ex * dx + ey * dy, ex * dy - ey * dx
    view = panel_view(ops, first, length, b, z, (along, 0.0, 0.0))

    def node(t: Any, s: Any, radius: Any, scale: Any, weights: Values, *phase: Any) -> Values:
        wave = wave_on_panel(ops, t, radius, *phase).scaled(weights[0] * scale)
        inverse = 1.0 / radius
        rise = wave * Pair(inverse * inverse, -2 * math.pi * inverse)
        parts = (wave, rise, rise.scaled(t))
        return tuple(number for part in parts for number in (part.real, part.imag))

    distance = ops.sqrt(x * x + y * y + z * z)
    phase = (*_square_along(x, y, begin_x, begin_y, ex, ey), distance, along, start)
    bounds = (1.0, None, digits + _GROWN)
    sums, _ = sums_over_panel(ops, tables.rules, view, bounds, node, 6, *phase)
    return sums


STRIPS = Kernel(
    "strips along edges", 3, _tables, lambda ops, frame, *arguments: arguments, _strip, leave_phase
)
