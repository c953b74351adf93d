"""A point source behind an opening as an integral along its edges. Source: (B9).

S is the source, P the point, D their distance, rho and R the distances of a place on the edge from
either. The detour rho + R - D, the angle about the axis from S to P, and the boundary wave all
vanish or diverge together where the edge meets the axis, the boundary of the shadow: what is
integrated here is their sum, which stays smooth there.
"""

from __future__ import annotations

import math
from typing import Any

from polywigner.numerics.trigonometry import cos_sin_turns, sinc

__all__ = ["spherical_edge"]


def spherical_edge(
    ops: Any, source: tuple[Any, ...], point: tuple[Any, ...], place: tuple[Any, ...],
    along: tuple[Any, ...], is_beyond: Any,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """(real, imaginary) integrand of U/U_incident, times 2 pi, and the detour. Lengths in waves.

    ``place`` on an edge of direction ``along`` (x, y) of the plane z = 0; ``is_beyond``: whether
    the plane parts the point from the source. If it does not, there is no wave past the axis.
    """
    q = tuple(a - b for a, b in zip((*place, 0.0), source, strict=True))
    r = tuple(a - b for a, b in zip(point, (*place, 0.0), strict=True))
    axis = tuple(a - b for a, b in zip(point, source, strict=True))
    d2, q2, r2 = (sum(c * c for c in v) for v in (axis, q, r))
    d, rho, radius = ops.sqrt(d2), ops.sqrt(q2), ops.sqrt(r2)
    cross = _cross(q, axis)
    h2 = sum(c * c for c in cross) / d2
    # the angle about the axis turns by so much over h^2 for each unit of length
    ahead = _cross(q, (*along, 0.0))
    turn = sum(a * b for a, b in zip(axis, ahead, strict=True)) / d
    apart = rho - radius
    # D^2 - (rho - R)^2: small where the place lies on the axis outside of S and P
    inner = (d - apart) * (d + apart)
    detour = rho + radius - d
    small = detour < 0.1 * d
    detour = ops.select(
        small & is_beyond, 4.0 * h2 * d2 / ops.select(inner > 0.0, inner, d2) / (rho + radius + d),
        detour,
    )  # fmt: skip
    c, s = cos_sin_turns(ops, detour)
    # beyond: 2 pi times (wave past the axis less boundary wave), over h^2
    c2, s2 = cos_sin_turns(ops, 0.5 * detour)
    safe = ops.select(inner > 0.0, inner, d2)
    slope = 2.0 * math.pi * 4.0 * d2 / (safe * (rho + radius + d)) * sinc(ops, detour)
    boundary = d2 / (safe * rho * radius)
    near = (turn * (slope * s2 + boundary * c), turn * (boundary * s - slope * c2))
    # on one side: the boundary wave alone
    outside = -turn * d2 / (rho * radius * ops.maximum(detour * (rho + radius + d), 1e-300))
    return (
        ops.select(is_beyond, near[0], outside * c),
        ops.select(is_beyond, near[1], outside * s),
        detour,
    )


def _cross(a: tuple[Any, ...], b: tuple[Any, ...]) -> tuple[Any, ...]:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
