"""Transforms of a disc, and polygons that converge to the disc.

F and W at the centre are Bessel functions. At other points, slices are intersections of two discs,
whose transform is a smooth integral.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np

import polywigner as pw

ANGLES = 0.15 + 2 * np.pi * np.arange(5) / 5
CYCLES = (0.2, 0.7, 1.9)  # |nu| R, and |upsilon| R
OFFSETS = (0.2, 0.5, 0.8)  # |x|/R, and |xi|/(2 R)
NODES = 120  # of a smooth integrand with at most 16 cycles

Array = np.ndarray


def _directions(sizes: Any, turn: float = 0.0) -> Array:
    unit = np.column_stack([np.cos(ANGLES + turn), np.sin(ANGLES + turn)])
    return (np.asarray(sizes)[:, None, None] * unit).reshape(-1, 2)


def _jinc(z: Array) -> Array:
    """Return 2 J1(z)/z."""
    return np.array([float(2 * mpmath.besselj(1, t) / t) for t in np.ravel(z)]).reshape(z.shape)


def lens(radius: float, offset: Array, nu: Array) -> Array:
    """Return the transform (n,) at nu of the intersection of discs around +offset and -offset (n,
    2).

    Chords along the offset have half-length sqrt(R^2 - t^2) - |offset|; with t = T sin(phi) the
    integrand is smooth.
    """
    size = np.linalg.norm(offset, axis=1)
    along = offset / size[:, None]
    nu_s = (nu * along).sum(axis=1)
    nu_t = nu[:, 1] * along[:, 0] - nu[:, 0] * along[:, 1]
    node, weight = np.polynomial.legendre.leggauss(NODES)
    phi = np.pi / 2 * node
    reach = np.sqrt(radius**2 - size**2)[:, None]
    t = reach * np.sin(phi)
    half = np.sqrt(radius**2 - t**2) - size[:, None]
    chord = 2 * half * np.sinc(2 * nu_s[:, None] * half) * np.cos(2 * np.pi * nu_t[:, None] * t)
    return np.asarray((chord * reach * np.cos(phi) * weight).sum(axis=1) * np.pi / 2)


NU, X = _directions(CYCLES), _directions(OFFSETS, 0.4)
SOME = np.resize(NU, (len(X), 2))
_MARGINAL = [2 * math.acos(s) - 2 * s * math.sqrt(1 - s * s) for s in OFFSETS]


def _inscribed(polygon: pw.Aperture) -> pw.Aperture:
    return pw.shapes.regular_polygon(len(polygon.rings[0]), 1.0)


# For each name: the value for a polygon, the value for the unit disc, and the order of convergence.
# The order is 4 if all sides contribute alike, 3 if a slice cuts some sides, and 2 if the areas
# differ.
QUANTITIES: dict[str, tuple[Callable[[pw.Aperture], Array], Array, int]] = {
    "F": (lambda g: pw.fourier(g, NU), np.pi * _jinc(2 * np.pi * np.hypot(*NU.T)), 4),
    "W at the centre": (
        lambda g: pw.wigner(g, (0.0, 0.0), NU),
        4 * np.pi * _jinc(4 * np.pi * np.hypot(*NU.T)),
        4,
    ),
    "W elsewhere": (lambda g: pw.wigner(g, X, SOME), lens(2.0, 2 * X, SOME), 3),
    "W elsewhere, inscribed": (
        lambda g: pw.wigner(_inscribed(g), X, SOME),
        lens(2.0, 2 * X, SOME),
        2,
    ),
    "A(0, xi)": (
        lambda g: pw.ambiguity(g, (0.0, 0.0), 2 * X).real,
        np.repeat(_MARGINAL, len(ANGLES)),
        3,
    ),
    "A elsewhere": (lambda g: pw.ambiguity(g, SOME, 2 * X), lens(1.0, X, SOME), 3),
}


def errors(name: str, sides: tuple[int, ...]) -> Array:
    """Return the errors (len(sides),) of n-gons with the area of the unit disc."""
    of_polygon, exact, _ = QUANTITIES[name]
    result = [np.abs(of_polygon(pw.shapes.disc(1.0, n)) - exact).max() / np.pi for n in sides]
    return np.array(result)


def orders(error: Array) -> Array:
    """Return the orders of convergence, log2 of the ratio of successive errors."""
    return np.log2(error[:-1] / error[1:])
