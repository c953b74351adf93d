"""Integrals of chirps, exp(i pi (c t^2 - 2 f t)): Fresnel integrals that keep their digits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from polywigner.numerics.fresnel_integrals import fresnel_tail

__all__ = ["chirp_integral", "waves_of_turns"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Over less of a turn of phase a Gauss rule of so many nodes misses nothing; over more, differences
# of Fresnel integrals lose no more than a digit.
_RULE, _FEW_TURNS = legendre.leggauss(8), 1 / 16
# Half turns by which a wave may bend that counts as flat: as good as none.
_FLAT = 1e-20


def chirp_integral(end: Any, curvature: Any, frequency: Any) -> Complex:
    """The integral of exp(i pi (c t^2 - 2 f t)) over t from 0 to ``end``, to rounding of ``end``.

    ``curvature``: c, in 1/length^2, of either sign, or zero; ``frequency``: f, in 1/length. All
    broadcast against each other.
    """
    b, c, f = (np.asarray(values, np.float64) for values in (end, curvature, frequency))
    sign = np.where(c < 0, -1.0, 1.0)
    f = sign * f
    longest = float(abs(b).max(initial=0.0)) or 1.0
    c = np.maximum(abs(c), _FLAT / longest**2)
    short = abs(b) * np.maximum(abs(f), abs(c * b - f)) < _FEW_TURNS
    found = _by_tails(b, c, f)
    if short.any():
        found[short] = _by_rule(*(np.broadcast_to(v, short.shape)[short] for v in (b, c, f)))
    if (sign < 0).any():
        found.imag *= sign
    return found


def waves_of_turns(turns: Any) -> Complex:
    """exp(2 pi i turns)."""
    angle = np.asarray(2 * math.pi * (turns - np.rint(turns)))
    wave = np.empty(angle.shape, np.complex128)
    np.cos(angle, out=wave.real)
    np.sin(angle, out=wave.imag)
    return wave


def _by_rule(b: Floats, c: Floats, f: Floats) -> Complex:
    nodes, weights = _RULE
    total = np.zeros(b.shape, np.complex128)
    for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
        t = b * (0.5 + 0.5 * node)
        total += 0.5 * weight * np.exp(1j * math.pi * (t * (c * t - 2 * f)))
    return b * total


def _by_tails(b: Floats, c: Floats, f: Floats) -> Complex:
    """For c > 0 and some of a turn of phase between 0 and b; of fewer digits for less.

    As differences of (step + rest) of :func:`fresnel_tail`: steps stand in for the place f/c of
    stationary phase, and are equal unless it is near 0 or b, or between them.
    """
    root = np.sqrt(math.pi * c)
    begin, side = -f * (root / c), (f > 0).astype(np.float64)
    first_step, first = fresnel_tail(begin, side)
    step, last = fresnel_tail(root * b + begin, side)
    bend = waves_of_turns(-0.5 * f * (f / c))
    found = first - last * waves_of_turns(0.5 * b * (c * b - 2 * f))
    found += bend * (first_step - step)
    return np.asarray(found * (np.exp(0.25j * math.pi) / np.sqrt(c)))
