"""Integrals of chirps, exp(i pi (c t^2 - 2 f t)): Fresnel integrals that keep their digits."""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

_TERMS = 12
_A = math.sqrt((_TERMS + 0.5) * math.pi)
_SQUARES = ((np.arange(_TERMS) + 0.5) * math.pi / _A) ** 2
_WEIGHTS = np.exp(-_SQUARES)
_TURN = cmath.exp(-0.25j * math.pi)
# Beyond, the step is 0 or 1 to the last digit.
_FARTHEST = 60.0


def fresnel_tail(t: NDArray[np.float64], side: Any = 0.0) -> tuple[NDArray[Any], NDArray[Any]]:
    """Two parts of T(t) = (1/sqrt pi) exp(-i pi/4) int_t^inf exp(i s^2) ds.

    T(t) = step + exp(i t^2) rest: (step less ``side``, rest), ``side`` 1 where T is near 1. Each
    is as good as its own size, and so are differences of T at places far from its bend.
    """
    exponent = 2 * _A * _TURN * np.clip(t, -_FARTHEST, _FARTHEST)
    # 1/(exp(z) + 1), less 1 where that is asked for: -1/(exp(-z) + 1)
    sign = 1.0 - 2.0 * side
    with np.errstate(over="ignore"):
        step = sign / (np.exp(sign * exponent) + 1.0)
    square = t * t
    fourth = square * square
    real, imag = np.zeros_like(t), np.zeros_like(t)
    for weight, node in zip(_WEIGHTS.tolist(), _SQUARES.tolist(), strict=True):
        term = weight / (fourth + node * node)
        real += term
        imag -= node * term
    return step, (t / (_A * _TURN)) * (square * real + 1j * imag)


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
