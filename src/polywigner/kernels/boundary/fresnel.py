"""Fresnel fields of plane waves behind an aperture as integrals along its edges. Source: (B6).

Panels, their axes and tables are those of `boundary`, but the third
component of a wave is 1 - p_par^2/2, and the distance that phases are relative to is
z + rho^2/(2 z). The integrand has no singularity: nodes lie in the length.
"""

from __future__ import annotations

import math
from typing import Any

from polywigner.kernels.boundary.edge_waves import wave_difference
from polywigner.kernels.boundary.integrals import (
    BoundaryTables,
    free_wave,
    offset_of,
    rounded_turns,
    square_along,
    weighted,
)
from polywigner.kernels.kernel import Values
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.nodes import SUMS, missed, node_sums, nodes_needed, rule_of
from polywigner.numerics.phases import cos_sin_turns

__all__ = ["fresnel_edge_sum"]

# Beyond the largest of the ellipses that rules are chosen by.
_NO_SINGULARITY = 100.0


def fresnel_edge_sum(ops: Any, tables: BoundaryTables, *inner: Any) -> Values:
    """(real part, imaginary part, error) of the field but for the phase of the distance."""

    oblique = any(row[5] or row[7] for row in tables.edges)

    def term(*row: Any) -> Values:
        return _panel(ops, tables, row[:-1], inner, oblique)

    total: Values = ops.sum_over(tables.edges, term, 3, like=inner[0], unroll=False)
    return total


def _panel(ops: Any, tables: BoundaryTables, row: Values, inner: Values, oblique: bool) -> Values:
    x, y, ex, ey, length, *cosines, start, _, _ = row
    z, digits = inner[4] + inner[5], inner[9]
    offset = offset_of(inner, x, y)
    px, py, one = (cosines[0], cosines[1]), (cosines[2], cosines[3]), (1.0, 0.0)
    # from the place where the wave would go through the plane on its way to the point
    if oblique:
        dx = phases.cross(ops, px, offset[0], one, offset[2])
        dy = phases.cross(ops, py, offset[1], one, offset[2])
    else:
        dx, dy = -(offset[0][0] + offset[0][1]), -(offset[1][0] + offset[1][1])
    first, b = ex * dx + ey * dy, ex * dy - ey * dx
    free = free_wave(ops, cosines, offset, inner, start)
    along = px[0] * ex + py[0] * ey
    half = 0.5 * length
    swing = ops.maximum(abs(first), abs(first + length)) / z
    needed, expected = nodes_needed(ops, digits, _NO_SINGULARITY, 2 * math.pi * half * swing)
    seen = (half, first, b, 0.5 / z, *square_along(row, inner), along, start, *free)
    sums = ops.sum_over_rule(rule_of(ops, needed), tables.rules, _node(ops), SUMS, *seen)
    size = abs(x) + abs(y) + length
    aside = abs(inner[0]) + abs(inner[2])
    turns = rounded_turns(ops, size * (1.0 + (aside + size) / z), inner[6], 1.0)
    return weighted(row, sums[0], sums[1], missed(ops, sums, expected, turns))


def _node(ops: Any) -> Any:
    tiny = 1e-300 if ops.double else 1e-37

    def node(
        at: Any, w: Any, v1: Any, v2: Any, half: Any, first: Any, b: Any, inverse: Any,
        constant: Any, slope: Any, along: Any, start: Any, free_r: Any, free_i: Any,
    ) -> Values:  # fmt: skip
        t = half * (1.0 + at)
        s = first + t
        distance2 = s * s + b * b
        turns = (constant + t * (slope + t)) * inverse + (along * t + start)
        edge = Pair(*cos_sin_turns(ops, turns))
        value = wave_difference(ops, edge, Pair(free_r, free_i), distance2 * inverse)
        factor = half * b / ops.maximum(distance2, tiny)
        return node_sums(factor * value.real, factor * value.imag, w, v1, v2)

    return node
