"""Phases nu.p in turns, from error-free products: none loses digits because it is large.

A number may be a ``Doubled``, the unrounded sum of two floats; so may a spatial frequency.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np

from polywigner.numerics.trigonometry import cos_sin_turns

__all__ = [
    "Doubled",
    "cross",
    "difference",
    "dot",
    "doubled",
    "exp_turns",
    "growth_of",
    "halves",
    "less_carrier",
    "level",
    "reduced",
    "rotated",
    "turns_to_centre",
]

Doubled = tuple[Any, Any]

# pi minus its nearest float64
_PI_REST = 1.2246467991473532e-16
# Splits a float64 into one of 24 bits, which float32 can hold, and the rest.
_SPLIT = 2.0**29 + 1
_PI_SINGLE = float(np.float32(math.pi))


def doubled(value: Fraction | float, double: bool = True) -> tuple[float, float]:
    """A number as (nearest float, rest), of float64 or of float32."""
    exact = Fraction(value)
    high = float(exact) if double else float(np.float32(float(exact)))
    return high, float(exact - Fraction(high))


def dot(ops: Any, nu: tuple[Any, ...], point: tuple[Any, ...]) -> Doubled:
    """nu.point as (sum, rest), both of them floats or ``Doubled`` by component.

    Good to about the square of an ulp of |nu| |point|, however much cancels.
    """
    total: Any = None
    rest: Any = 0.0
    for component, coordinate in zip(nu, point, strict=True):
        product, lost = _product(ops, component, coordinate)
        if total is None:
            total, rest = product, lost
        else:
            total, lost_sum = _sum(total, product)
            rest = rest + (lost + lost_sum)
    return total, rest


def _product(ops: Any, nu: Any, coordinate: Any) -> Doubled:
    nu_high, nu_low = nu if isinstance(nu, tuple) else (nu, 0.0)
    high, low = coordinate if isinstance(coordinate, tuple) else _fitting(ops, coordinate)
    product = nu_high * high
    lost = ops.lost(nu_high, high, product)
    if isinstance(nu, tuple):
        lost = lost + nu_low * high
    return product, lost + nu_high * low


def _fitting(ops: Any, constant: float) -> tuple[float, float]:
    """A constant as the two floats that float32 needs for it."""
    return (constant, 0.0) if ops.double else doubled(constant, False)


def _sum(a: Any, b: Any) -> Doubled:
    """a + b and what its rounding loses (Knuth)."""
    total = a + b
    virtual = total - a
    return total, (a - (total - virtual)) + (b - virtual)


def difference(a: Any, b: Any) -> Doubled:
    """a - b as the nearest float and what that leaves out, exactly (Knuth)."""
    rounded = a - b
    virtual = rounded - a
    return rounded, (a - (rounded - virtual)) - (b + virtual)


def cross(ops: Any, a: Doubled, b: Doubled, c: Doubled, d: Doubled) -> Any:
    """a d - b c, good to the square of an ulp of the products, however much cancels."""
    lost = (a[0] * d[1] + a[1] * d[0]) - (b[0] * c[1] + b[1] * c[0])
    return ops.cross(a[0], b[0], c[0], d[0]) + lost


def halves(ops: Any, number: Doubled) -> Doubled:
    """A sum of two floats with a first number that float32 can hold as well (Veltkamp)."""
    total, rest = number
    if not ops.double:
        return number
    scaled = total * _SPLIT
    high = scaled - (scaled - total)
    return high, (total - high) + rest


def reduced(ops: Any, turns: Doubled) -> Any:
    """A ``Doubled`` modulo 1."""
    total, rest = turns
    return (total - ops.round(total)) + rest


def turns_to_centre(ops: Any, centre: tuple[Any, ...], *nu: Any) -> Any:
    """nu.centre modulo 1."""
    return reduced(ops, dot(ops, nu, centre))


def less_carrier(ops: Any, frame: Any, turns: Any, *xi: Any) -> Any:
    """Turns minus those of the frame's carrier along a lag, modulo 1."""
    if not any(frame.carrier):
        return turns
    return turns - turns_to_centre(ops, frame.carrier, *xi)


def exp_turns(ops: Any, turns: Doubled) -> Any:
    """exp(pi turns), good to an ulp or two also where the exponent is large."""
    total, rest = turns
    high, low = (math.pi, _PI_REST) if ops.double else (_PI_SINGLE, math.pi - _PI_SINGLE)
    exponent = total * high
    lost = ops.lost(total, high, exponent) + (total * low + rest * high)
    return ops.exp(exponent) * (1.0 + lost)


def growth_of(ops: Any, frame: Any, inner: tuple[Any, ...], *imag: Any) -> Any:
    """exp(pi h), h the largest Im(nu).x over the frame's box; exp(2 pi h) bounds the wave there.

    ``inner``: Im nu in the frame, ``imag``: in the source's unit. Half of the exponent, so that the
    product with a small sum overflows only where the transform does.
    """
    total, rest = dot(ops, imag, frame.centre)
    total, lost = _sum(total, level(frame, inner))
    return exp_turns(ops, (total, rest + lost))


def level(frame: Any, inner: tuple[Any, ...]) -> Any:
    """The largest Im(nu).x, in turns, over the box |x_k| <= reach_k of the frame."""
    total: Any = 0.0
    for component, reach in zip(inner, frame.reach, strict=True):
        total = total + abs(component) * reach
    return total


def rotated(ops: Any, turns: Any, cosine: Any, sine: Any) -> tuple[Any, Any]:
    """(cosine - i sine) exp(-2 pi i turns) as (real, imaginary) parts."""
    c, s = cos_sin_turns(ops, turns)
    return cosine * c - sine * s, -(cosine * s + sine * c)
