"""Fresnel fields of plane waves behind an aperture as integrals along its edges. Source: (B6).

Panels, their axes and tables are those of :mod:`polywigner.kernels.boundary`, but the third
component of a wave is 1 - p_par^2/2. The integrand has no singularity: nodes lie in the length.
"""

from __future__ import annotations

import math
from typing import Any

from polywigner.kernels.boundary import BoundaryTables, free_wave, offset_of, weighted
from polywigner.kernels.kernel import Values
from polywigner.kernels.nodes import SUMS, missed, node_sums, nodes_needed, rule_of
from polywigner.kernels.trigonometry import cos_sin_turns

__all__ = ["fresnel_edge_sum"]

# Beyond the largest of the ellipses that rules are chosen by.
_NO_SINGULARITY = 100.0
_CLOSE = 0.5


def fresnel_edge_sum(ops: Any, tables: BoundaryTables, *inner: Any) -> Values:
    """(real part, imaginary part, error) of the field but for the phase of the distance."""

    def term(*row: Any) -> Values:
        return _panel(ops, tables, row[:-1], inner)

    total: Values = ops.sum_over(tables.edges, term, 3, like=inner[0], unroll=False)
    return total


def _panel(ops: Any, tables: BoundaryTables, row: Values, inner: Values) -> Values:
    x, y, ex, ey, length, *cosines, start, _, _ = row
    z, digits = inner[4] + inner[5], inner[9]
    offset = offset_of(inner, x, y)
    # from the place where the wave would go through the plane on its way to the point
    dx = cosines[0] * z - (offset[0][0] + offset[0][1])
    dy = cosines[2] * z - (offset[1][0] + offset[1][1])
    first, b = ex * dx + ey * dy, ex * dy - ey * dx
    free_r, free_i = free_wave(ops, cosines, offset, inner, start)
    half = 0.5 * length
    swing = ops.maximum(abs(first), abs(first + length)) / z
    needed, expected = nodes_needed(ops, digits, _NO_SINGULARITY, 2 * math.pi * half * swing)
    sums = ops.sum_over_rule(
        rule_of(ops, needed), tables.rules, _node(ops), SUMS, half, first, b, z
    )
    real, imag = sums[0] * free_r - sums[1] * free_i, sums[0] * free_i + sums[1] * free_r
    turns = 0.5 * swing * (abs(first) + abs(b) + length)
    return weighted(row, real, imag, missed(ops, sums, expected, turns))


def _node(ops: Any) -> Any:
    tiny = 1e-300 if ops.double else 1e-37

    def node(at: Any, w: Any, v1: Any, v2: Any, half: Any, first: Any, b: Any, z: Any) -> Values:
        s = first + half * (1.0 + at)
        distance2 = s * s + b * b
        turns = distance2 / (2.0 * z)
        cosine, sine = cos_sin_turns(ops, turns)
        close = turns < _CLOSE
        c, d = cos_sin_turns(ops, 0.5 * ops.select(close, turns, 0.0))
        real = ops.select(close, -2.0 * d * d, cosine - 1.0)
        imag = ops.select(close, 2.0 * d * c, sine)
        factor = half * b / ops.maximum(distance2, tiny)
        return node_sums(factor * real, factor * imag, w, v1, v2)

    return node
