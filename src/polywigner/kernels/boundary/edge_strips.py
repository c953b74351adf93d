"""Fields of strips along an aperture's edges: derivatives of exact fields. Source: (G5), (G6).

Lengths are in wavelengths, phases in turns, axes those of `boundary`. For a
panel and a point these are the integrals of 1 and t, t the length from the panel's beginning, times

    u G and u (1/R - 2 pi i) G/R,  G = exp(2 pi i R)/R

or, for Fresnel's field, of 1 and t times u exp(pi i rho^2/z), all against the phase of the point's
distance from the centre, R or rho^2/(2 z). Panels are arguments here, as points are: one compiled
kernel does for all outlines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

from polywigner.kernels.boundary.integrals import (
    edge_wave,
    panel_view,
    square_along,
    sums_over_panel,
)
from polywigner.kernels.kernel import Kernel, Values
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.nodes import Rules, gauss_rules, nodes_needed, rule_of
from polywigner.numerics.phases import cos_sin_turns

# Beyond the largest of the ellipses that rules are chosen by.
_NO_SINGULARITY = 100.0
# On the edge of the strip kept clear in the angle, 1/R^2 is larger than on the panel by 1/cos^2 of
# 1.4, a factor of 35.
_GROWN = 3.6


@dataclass(frozen=True)
class _Tables:
    """The rules; and one term, which the arguments tell all of."""

    frame: None
    edges: tuple[tuple[()], ...]
    rules: Rules


@cache
def _tables(source: None, double: bool) -> _Tables:
    return _Tables(None, ((),), gauss_rules())


def _enter(ops: Any, frame: None, *arguments: Any) -> Values:
    return arguments


def _leave(ops: Any, frame: None, inner: Values, sums: Values) -> Values:
    return sums


def _seen(x: Any, y: Any, begin_x: Any, begin_y: Any, ex: Any, ey: Any) -> tuple[Any, Any]:
    """Where a panel begins in its own axes, s and b, from the point's foot."""
    dx, dy = begin_x - x, begin_y - y
    return ex * dx + ey * dy, ex * dy - ey * dx


def _strip(
    ops: Any, tables: _Tables, x: Any, y: Any, z: Any, begin_x: Any, begin_y: Any, ex: Any, ey: Any,
    length: Any, along: Any, start: Any, digits: Any,
) -> Values:  # fmt: skip
    first, b = _seen(x, y, begin_x, begin_y, ex, ey)
    view = panel_view(ops, first, length, b, z, (along, 0.0, 0.0))

    def node(t: Any, s: Any, radius: Any, scale: Any, weights: Values, *phase: Any) -> Values:
        wave = edge_wave(ops, t, radius, *phase).scaled(weights[0] * scale)
        inverse = 1.0 / radius
        rise = wave * Pair(inverse * inverse, -2 * math.pi * inverse)
        parts = (wave, wave.scaled(t), rise, rise.scaled(t))
        return tuple(number for part in parts for number in (part.real, part.imag))

    distance = ops.sqrt(x * x + y * y + z * z)
    phase = (*square_along(x, y, begin_x, begin_y, ex, ey), distance, along, start)
    bounds = (1.0, None, digits + _GROWN)
    sums, _ = sums_over_panel(ops, tables.rules, view, bounds, node, 8, *phase)
    return sums


def _fresnel_strip(
    ops: Any, tables: _Tables, x: Any, y: Any, z: Any, begin_x: Any, begin_y: Any, ex: Any, ey: Any,
    length: Any, along: Any, start: Any, digits: Any,
) -> Values:  # fmt: skip
    first, _ = _seen(x, y, begin_x, begin_y, ex, ey)
    constant, slope = square_along(x, y, begin_x, begin_y, ex, ey)
    half, inverse = 0.5 * length, 0.5 / z
    swing = ops.maximum(
        abs(2.0 * inverse * first + along), abs(2.0 * inverse * (first + length) + along)
    )
    needed, _ = nodes_needed(ops, digits, _NO_SINGULARITY, 2 * math.pi * half * swing)

    def node(
        at: Any, w: Any, _: Any, __: Any,
        half: Any, constant: Any, slope: Any, inverse: Any, along: Any, start: Any,
    ) -> Values:  # fmt: skip
        t = half * (1.0 + at)
        turns = (constant + t * (slope + t)) * inverse + (along * t + start)
        cosine, sine = cos_sin_turns(ops, turns)
        weight = w * half
        real, imag = cosine * weight, sine * weight
        return real, imag, t * real, t * imag

    data = (half, constant, slope, inverse, along, start)
    return tuple(ops.sum_over_rule(rule_of(ops, needed), tables.rules, node, 4, *data))


STRIPS = Kernel("strips along edges", 3, _tables, _enter, _strip, _leave)
FRESNEL_STRIPS = Kernel("strips along edges, fresnel", 3, _tables, _enter, _fresnel_strip, _leave)
