"""A point source behind an opening as an integral along its edges. Source: (B9).

S is the source, P the point, D their distance, rho and R the distances of a place on the edge from
either. The detour rho + R - D, the angle about the axis from S to P, and the boundary wave all
vanish or diverge together where the edge meets the axis, the boundary of the shadow: what is
integrated here is their sum, which stays smooth there.
"""

from __future__ import annotations

import math
from typing import Any

from polywigner.numerics.phases import cos_sin_turns, sinc


def spherical_edge(
    ops: Any, source: tuple[Any, ...], point: tuple[Any, ...], place: tuple[Any, ...],
    along: tuple[Any, ...], mirrored: float,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """(real, imaginary) integrand of U/U_incident, times 2 pi, and the detour. Lengths in waves.

    ``place`` on an edge of direction ``along`` (x, y) of the plane z = 0, which parts the point
    from the source; ``mirrored``: what the field at the point's mirror image counts beside its own.
    """
    q = tuple(a - b for a, b in zip((*place, 0.0), source, strict=True))
    r = tuple(a - b for a, b in zip(point, (*place, 0.0), strict=True))
    d = ops.sqrt(sum((a - b) ** 2 for a, b in zip(point, source, strict=True)))
    rho, radius = (ops.sqrt(sum(c * c for c in v)) for v in (q, r))
    both, product = rho + radius + d, rho * radius
    dot = sum(a * b for a, b in zip(q, r, strict=True))
    # (D^2 - (rho - R)^2)/2 and ((rho + R)^2 - D^2)/2: one cancels, and their product is |q x r|^2
    large = product + ops.maximum(dot, -dot)
    small = ops.maximum(sum(c * c for c in _cross(q, r)) / large, 1e-300)
    inner, outer = ops.select(dot > 0.0, large, small), ops.select(dot > 0.0, small, large)
    detour = 2.0 * outer / both
    # the angle about the axis turns by ahead.r/D over h^2 for each unit of length
    ahead = _cross(q, (*along, 0.0))
    turn = sum(a * b for a, b in zip(ahead, r, strict=True)) * d
    c, s = cos_sin_turns(ops, detour)
    # 2 pi times (wave past the axis less boundary wave), over h^2
    c2, s2 = cos_sin_turns(ops, 0.5 * detour)
    slope = 4.0 * math.pi / (inner * both) * sinc(ops, detour)
    boundary = 0.5 / (inner * product)
    real = turn * (slope * s2 + boundary * c)
    imag = turn * (boundary * s - slope * c2)
    if mirrored:
        # the boundary wave alone: no wave past the axis on the source's side of the plane
        turn = (ahead[0] * r[0] + ahead[1] * r[1] - ahead[2] * r[2]) * d
        wave = -0.5 * mirrored * turn / (product * (outer + 2.0 * q[2] * r[2]))
        real, imag = real + wave * c, imag + wave * s
    return real, imag, detour


def _cross(a: tuple[Any, ...], b: tuple[Any, ...]) -> tuple[Any, ...]:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
