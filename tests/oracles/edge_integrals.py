"""Fields of a plane wave behind a polygon, as integrals along its edges with 25 digits.

The vector potential of Miyamoto and Wolf and the solid angle of the polygon give Kirchhoff's field
at P and at the mirror point. Their difference and sum are the fields of Rayleigh and Sommerfeld.
Gauss rules of 16 nodes on pieces of at most two cycles of phase err by about 1e-18.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import mpmath
import numpy as np
from mpmath import mp

DIGITS, NODES, CYCLES = 25, 16, 2.0
METHODS = ("rayleigh-sommerfeld-1", "kirchhoff", "rayleigh-sommerfeld-2", "fresnel")

Vector = tuple[Any, Any, Any]


@cache
def rule() -> list[tuple[Any, Any]]:
    """Return Gauss-Legendre nodes and weights on [0, 1]."""
    with mp.workdps(DIGITS + 5):
        nodes = []
        for start in np.polynomial.legendre.leggauss(NODES)[0].tolist():
            x = mpmath.findroot(lambda t: mpmath.legendre(NODES, t), start)
            slope = NODES * mpmath.legendre(NODES - 1, x) / (1 - x * x)
            nodes.append(((1 + x) / 2, 1 / ((1 - x * x) * slope**2)))
    return nodes


def fields(
    rings: Sequence[np.ndarray], point: Sequence[float], wavelength: float, p: Sequence[float]
) -> list[complex]:
    """Return the fields of METHODS at a point, of the wave with direction cosines p (2,)."""
    with mp.workdps(DIGITS):
        x, y, z = (mp.mpf(float(v)) / mp.mpf(wavelength) for v in point)
        px, py = (mp.mpf(float(v)) for v in p)
        wave = (px, py, mp.sqrt(1 - px * px - py * py))
        sums = [mp.mpc(0)] * 3
        for start, end in edges(rings, wavelength):
            parts = integrals_along(start, end, (x, y, z), wave)
            sums = [a + b for a, b in zip(sums, parts, strict=True)]
        above, below, parabolic = sums
        solid = sum(
            solid_angle([(a / wavelength_, b / wavelength_) for a, b in ring], (x, y, z))
            for ring, wavelength_ in ((exact(ring), mp.mpf(wavelength)) for ring in rings)
        )
        across = px * x + py * y
        front = (solid + above) / (4 * mp.pi) * mp.expjpi(2 * (across + wave[2] * z))
        back = (below - solid) / (4 * mp.pi) * mp.expjpi(2 * (across - wave[2] * z))
        paraxial = across + (1 - (px * px + py * py) / 2) * z
        fresnel = parabolic * mp.expjpi(2 * paraxial) / (2 * mp.pi)
        return [complex(v) for v in (front - back, front, front + back, fresnel)]


def exact(ring: np.ndarray) -> list[tuple[Any, Any]]:
    return [(mp.mpf(float(a)), mp.mpf(float(b))) for a, b in ring]


def edges(rings: Sequence[np.ndarray], wavelength: float) -> Iterator[tuple[Any, Any]]:
    """Yield the ends of edges in wavelengths."""
    for ring in rings:
        points = [(a / mp.mpf(wavelength), b / mp.mpf(wavelength)) for a, b in exact(ring)]
        yield from zip(points, points[1:] + points[:1], strict=True)


def integrals_along(start: Any, end: Any, point: Vector, p: Vector) -> tuple[Any, Any, Any]:
    """Return the integrals of an edge for the point, its mirror point, and Fresnel's (B6)."""
    (x, y, z), (px, py, pz) = point, p
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = mp.sqrt(dx * dx + dy * dy)
    ex, ey = dx / length, dy / length
    # Fresnel: relative to the position where the ray through the point crosses the plane
    foot = (x - z * px, y - z * py)
    rates = []
    for qx, qy in (start, end):
        radius = mp.sqrt((x - qx) ** 2 + (y - qy) ** 2 + z * z)
        along = ex * (qx - x) + ey * (qy - y)
        rates += [abs(along / radius + px * ex + py * ey)]
        rates += [abs(ex * (qx - foot[0]) + ey * (qy - foot[1])) / z]
    pieces = int(mp.ceil(length * max(rates) / CYCLES)) + 1
    above, below, parabolic = mp.mpc(0), mp.mpc(0), mp.mpc(0)
    for k in range(pieces):
        for node, weight in rule():
            t = (k + node) / pieces
            qx, qy = start[0] + t * dx, start[1] + t * dy
            rx, ry = x - qx, y - qy
            radius = mp.sqrt(rx * rx + ry * ry + z * z)
            flat = px * rx + py * ry
            for side in (1, -1):
                path = radius - (flat + side * pz * z)
                # e.(p x (P - Q)), with z = side z
                turn = ex * (py * side * z - pz * ry) + ey * (pz * rx - px * side * z)
                term = weight * turn * (mp.expjpi(2 * path) - 1) / (path * radius)
                above, below = (above + term, below) if side > 0 else (above, below + term)
            gx, gy = qx - foot[0], qy - foot[1]
            square = gx * gx + gy * gy
            b = ex * gy - ey * gx
            parabolic += weight * b * (mp.expjpi(square / z) - 1) / square
    step = length / pieces
    return above * step, below * step, parabolic * step


def solid_angle(ring: Sequence[Any], point: Vector) -> Any:
    """Return the solid angle of a polygon of the plane z = 0 as a fan of triangles, > 0 in front."""
    corners = [(a - point[0], b - point[1], -point[2]) for a, b in ring]
    total = mp.mpf(0)
    for second, third in zip(corners[1:], corners[2:], strict=False):
        a, b, c = corners[0], second, third
        lengths = [mp.sqrt(sum(v * v for v in corner)) for corner in (a, b, c)]
        dots = [sum(u * v for u, v in zip(*pair, strict=True)) for pair in ((b, c), (c, a), (a, b))]
        triple = (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
        below = lengths[0] * lengths[1] * lengths[2]
        below += sum(d * size for d, size in zip(dots, lengths, strict=True))
        total -= 2 * mp.atan2(triple, below)
    return total
