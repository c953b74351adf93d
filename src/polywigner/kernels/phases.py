"""The phase of an off-centre shape, exp(-2 pi i nu.c), without losing digits to a large nu.c."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from polywigner.kernels.trigonometry import cos_sin_turns

__all__ = ["growth", "rotated", "turns_to_centre"]


def turns_to_centre(ops: Any, centre: tuple[float, ...], *nu: Any) -> Any:
    """nu.centre modulo 1, from error-free products."""
    total, *others = (_turns(ops, n, c) for n, c in zip(nu, centre, strict=True))
    for other in others:
        total = total + other
    return total


def _turns(ops: Any, nu: Any, centre: float) -> Any:
    if centre == 0.0:
        return 0.0 * nu
    # in float32 the centre itself needs two floats
    high = centre if ops.double else float(np.float32(centre))
    product = nu * high
    lost = -ops.cross(product, nu, high, 1.0)
    return (product - ops.round(product)) + lost + nu * (centre - high)


def growth(ops: Any, centre: tuple[float, ...], *imag: Any) -> Any:
    """exp(2 pi Im(nu).centre), the modulus of exp(-2 pi i nu.c) for complex nu."""
    total, *others = (n * c for n, c in zip(imag, centre, strict=True))
    for other in others:
        total = total + other
    return ops.exp(2 * math.pi * total)


def rotated(ops: Any, turns: Any, cosine: Any, sine: Any) -> tuple[Any, Any]:
    """(cosine - i sine) exp(-2 pi i turns) as (real, imaginary) parts."""
    c, s = cos_sin_turns(ops, turns)
    return cosine * c - sine * s, -(cosine * s + sine * c)
