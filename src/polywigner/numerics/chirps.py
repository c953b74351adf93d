"""Integrals of chirps, exp(i pi (c t^2 - 2 f t)): Fresnel integrals that keep all of their digits.

With the stationary place t0 = f/c and r = sqrt(pi |c|) (t - t0), the integral from t outwards,
away from t0, is the chirp at t times T(|r|)/sqrt(pi |c|), T(r) = int_0^inf exp(i (2 r s + s^2)) ds,
which is smooth and falls off as i/(2 r). Source: (O6).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

__all__ = ["chirp_integral", "fresnel_tail", "waves_of_turns"]

Complex = NDArray[np.complex128]

# (r + SCALE) T(r) as a Chebyshev series in (r - SCALE)/(r + SCALE): of so many terms the last ones
# are below 1e-16.
_SCALE, _TERMS = 2.0, 44
# Over less than a turn of phase a Gauss rule of so many nodes misses nothing (pi^40/40! = 1e-28);
# over more, differences of tails lose no more than a digit.
_NODES, _FEW_TURNS = 20, 1.0
# Values at a time, which stay in the cache of a core.
_BLOCK = 1 << 13


def chirp_integral(end: Any, curvature: float, frequency: Any) -> Complex:
    """The integral of exp(i pi (c t^2 - 2 f t)) over t from 0 to ``end``, to rounding of ``end``.

    ``curvature``: c, in 1/length^2, of either sign, or zero; ``frequency``: f, in 1/length, which
    broadcasts against ``end``.
    """
    b, f = np.asarray(end, np.float64), np.asarray(frequency, np.float64)
    if curvature < 0:
        return np.conj(chirp_integral(b, -curvature, -f))
    turns = abs(b) * np.maximum(abs(f), abs(curvature * b - f))
    short = turns < _FEW_TURNS
    found = _by_tails(b, curvature, f)
    b, f = (np.broadcast_to(values, short.shape)[short] for values in (b, f))
    found[short] = _by_rule(b, curvature, f)
    return found


def waves_of_turns(turns: Any) -> Complex:
    """exp(2 pi i turns)."""
    angle = 2 * math.pi * (turns - np.rint(turns))
    return np.asarray(np.cos(angle) + 1j * np.sin(angle))


def fresnel_tail(r: Any) -> Complex:
    """T(r) of r at least 0, to 1e-15 of itself."""
    r = np.asarray(r, np.float64)
    values = np.empty(r.shape, np.complex128)
    flat, into = r.ravel(), values.reshape(-1)
    for start in range(0, flat.size, _BLOCK):
        some = slice(start, start + _BLOCK)
        into[some] = _series_at(flat[some])
    return values


def _series_at(r: Any) -> Complex:
    at = 2.0 * ((r - _SCALE) / (r + _SCALE))
    parts = []
    for series in zip(*((c.real, c.imag) for c in _series()), strict=True):
        first, second = np.zeros_like(at), np.zeros_like(at)
        for coefficient in series[:0:-1]:  # Clenshaw's recurrence
            np.subtract(coefficient, second, out=second)
            second += at * first
            first, second = second, first
        parts.append((0.5 * at * first - second + series[0]) / (r + _SCALE))
    return np.asarray(parts[0] + 1j * parts[1])


@lru_cache(maxsize=1)
def _series() -> tuple[complex, ...]:
    angle = math.pi * (np.arange(_TERMS) + 0.5) / _TERMS
    r = _SCALE / np.tan(angle / 2) ** 2  # at the Chebyshev nodes cos(angle)
    nodes, weights = legendre.leggauss(_NODES)
    pieces = 16  # that the path is integrated in
    nodes = ((nodes + 1 + 2 * np.arange(pieces)[:, None]) / pieces - 1).ravel()
    weights = np.tile(weights / pieces, pieces)
    # on s = p exp(i pi/4) the integrand falls off as exp(-p^2 - sqrt(2) r p): to e^-40 by `reach`
    reach = np.minimum(6.4, 40 / (math.sqrt(2) * r))[:, None]
    p = reach * (nodes + 1) / 2
    integrand = np.exp(-p * p + (1j - 1) * math.sqrt(2) * r[:, None] * p) * (weights * reach / 2)
    values = (r + _SCALE) * integrand.sum(axis=1) * np.exp(0.25j * math.pi)
    # whole multiples of the angles, less whole turns: these are exact
    multiples = np.outer(np.arange(_TERMS), 2 * np.arange(_TERMS) + 1) % (4 * _TERMS)
    terms = np.cos(multiples * (math.pi / (2 * _TERMS))) @ values * (2 / _TERMS)
    terms[0] /= 2
    return tuple(complex(term) for term in terms)


def _by_rule(b: Any, c: float, f: Any) -> Complex:
    nodes, weights = legendre.leggauss(_NODES)
    total = np.zeros(b.shape, np.complex128)
    for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
        t = b * (0.5 + 0.5 * node)
        total += 0.5 * weight * np.exp(1j * math.pi * (t * (c * t - 2 * f)))
    return b * total


def _by_tails(b: Any, c: float, f: Any) -> Complex:
    """For some turns of phase between 0 and b; anything for fewer."""
    if c == 0:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray((waves_of_turns(-b * f) - 1) / (-2j * math.pi * f))
    root = math.sqrt(math.pi * c)
    begins, ends = -f * (root / c), (c * b - f) * (root / c)
    from_begin, from_end = np.where(begins < 0, -1.0, 1.0), np.where(ends < 0, -1.0, 1.0)
    wave = waves_of_turns(0.5 * b * (c * b - 2 * f))
    found = from_begin * fresnel_tail(abs(begins)) - from_end * wave * fresnel_tail(abs(ends))
    across = from_end - from_begin  # 2 or -2 where the stationary place lies between
    whole = waves_of_turns(0.125 - 0.5 * f * np.where(across, f / c, 0.0)) * math.sqrt(math.pi)
    return np.asarray((found + 0.5 * across * whole) / root)
