"""Lengths in wavelengths as sums of two floats, so that their turns are right at any distance.

A length of 1e12 wavelengths, rounded once, is known to 1e-4 of a turn; as a ``Doubled`` to 1e-20.
Points, centres and wavelengths are taken as the floats that they are, exactly.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from polywigner.numerics import phases
from polywigner.numerics.phases import Doubled

__all__ = ["distance_of", "paraxial_distance", "point_in_wavelengths"]

# Farther off, in wavelengths, a sum of two floats has no turns either, and the errors of products
# are too large for floats.
_FARTHEST = 1e30


def point_in_wavelengths(
    ops: Any, centre: tuple[float, float], wavelength: float, x: Any, y: Any, z: Any
) -> tuple[Doubled, Doubled, Doubled]:
    """(x, y, z) less the centre, over the wavelength. ``ops``: of float64."""
    scale = phases.doubled(1 / Fraction(wavelength))
    # most sources are centred at the origin
    aside = (
        phases.difference(v, c) if c else (v, 0.0) for v, c in zip((x, y), centre, strict=True)
    )
    lengths = (*aside, (z, 0.0))
    a, b, c = (phases.dot(ops, (scale,), (length,)) for length in lengths)
    return a, b, c


def distance_of(ops: Any, point: tuple[Doubled, ...]) -> Doubled:
    """sqrt(x^2 + y^2 + z^2) by one step of Newton's method from its nearest float."""
    highs = tuple(high for high, _ in point)
    root = ops.sqrt(sum(high * high for high in highs))
    total, rest = phases.dot(ops, (*highs, -root), (*highs, root))
    for high, low in point:
        rest = rest + 2.0 * high * low
    correction = (total + rest) / (2.0 * root)
    return root, ops.select(root < _FARTHEST, correction, 0.0)


def paraxial_distance(ops: Any, point: tuple[Doubled, ...]) -> Doubled:
    """z + (x^2 + y^2)/(2 z), Fresnel's distance."""
    (x, x_low), (y, y_low), (z, z_low) = point
    rise = (x * x + y * y) / (2.0 * z)
    total, rest = phases.dot(ops, (x, y, -rise), (x, y, 2.0 * z))
    rest = rest + 2.0 * (x * x_low + y * y_low - rise * z_low)
    correction = (total + rest) / (2.0 * z)
    high, low = phases.difference(z, -rise)
    return high, low + (z_low + ops.select(high < _FARTHEST, correction, 0.0))
