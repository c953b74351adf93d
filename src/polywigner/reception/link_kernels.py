"""The kernel of a link between two points, for each boundary condition. Source: (RX2).

With G = exp(ikR)/(i R), lengths in wavelengths, k = 2 pi, n and m the normals of the transmitter
and of the receiver, (a, b) the shares of the boundary condition,

    K = (b + a d_n/(ik)) (b - a d_m/(ik)) G
      = b^2 G + (a b/ik) (n.r - m.r) G_1 + (a/k)^2 [n.m G_1 + (n.r)(m.r) G_2]

where G_1 = G'/R and G_(j+1) = G_j'/R, so that the gradient of G_j is G_(j+1) r.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.illumination.obliquities import Obliquity

__all__ = ["link_kernel", "link_slopes"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

_IK = 2j * math.pi


def link_kernel(
    condition: Obliquity,
    cosine: Floats,
    sine: Floats,
    distance: Floats,
    nr: Floats,
    mr: Floats,
    nm: Floats,
) -> tuple[Floats, Floats]:
    """Real and imaginary part of K (...), from exp(ikR), R, n.r, m.r and n.m.

    The latter three may be constant along axes; r is from the transmitter.
    """
    # 1/(kR) is real, and so are all factors of its powers: real and imaginary part on their own;
    # in place, since fresh memory costs more than the sums
    a, b = condition.field, condition.slope
    inverse = 1.0 / distance
    near = inverse * (0.5 / math.pi)
    both = inverse * ((a * a) * nr)
    both *= inverse
    both *= mr
    imag = -3.0 * both
    imag += (a * a) * nm
    imag *= near
    real = imag * near
    real += both
    np.subtract(b * b, real, out=real)
    if a * b:
        mixed = inverse * ((a * b) * (nr - mr))
        real += mixed
        mixed *= near
        imag += mixed
    # times -i exp(ikR)/R
    real *= inverse
    imag *= inverse
    first = real * sine
    first += np.multiply(imag, cosine, out=near)
    imag *= sine
    real *= cosine
    imag -= real
    return first, imag


def link_slopes(
    condition: Obliquity, wave: Complex, r: Floats, distance: Floats, m: Floats
) -> tuple[list[Complex], list[Complex]]:
    """Derivatives of :func:`link_kernel` in the three components of r, and in those of m."""
    a, b = condition.field, condition.slope
    cross, square = a * b / _IK, (a / (2 * math.pi)) ** 2
    green = wave / (1j * distance)
    away = sum(m[j] * r[j] for j in range(3))
    _, first, second, third = (green * part for part in _ladder(distance, 3))
    along = b * b * first + cross * second * (r[2] - away)
    along += square * (m[2] * second + r[2] * away * third)
    of_place, of_normal = [], []
    for j in range(3):
        up = 1.0 if j == 2 else 0.0
        place = along * r[j] + cross * first * (up - m[j])
        of_place.append(place + square * second * (up * away + r[2] * m[j]))
        of_normal.append((square * second * r[2] - cross * first) * r[j] + square * up * first)
    return of_place, of_normal


def _ladder(distance: Floats, most: int) -> list[Any]:
    """G_j/G for j up to ``most``."""
    found: list[Any] = [1.0]
    if most:
        inverse = 1.0 / distance
        found.append((_IK - inverse) * inverse)
    if most > 1:
        square = inverse * inverse
        found.append((_IK * _IK - 3 * _IK * inverse + 3 * square) * square)
    if most > 2:
        cubes = _IK**3 - 6 * _IK**2 * inverse + 15 * _IK * square - 15 * square * inverse
        found.append(cubes * (square * inverse))
    return found
