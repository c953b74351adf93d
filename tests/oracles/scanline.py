"""Slices by even-odd scanlines, integrated by Gauss-Legendre: a second route, in float64.

Each scanline is a few intervals between crossings of edges, found by parity; along it the
integral of exp is elementary, across it Gauss-Legendre nodes between all heights at which the
intervals can have a kink. Good to about 1e-13 of the area away from coincident edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["ambiguity", "fourier", "wigner"]

NODES = 24
CYCLES_PER_STRIP = 2.0  # 24 nodes resolve two cycles to rounding


def _segments(rings: Sequence[Any]) -> np.ndarray:
    """(n, 4) array of xa, ya, xb, yb."""
    return np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in rings])


def _kinks(segments: np.ndarray) -> np.ndarray:
    """Heights of the ends and of the crossings of all segments."""
    a, d = segments[:, :2], segments[:, 2:] - segments[:, :2]
    gap = a[None] - a[:, None]
    cross = d[:, None, 0] * d[None, :, 1] - d[:, None, 1] * d[None, :, 0]
    with np.errstate(all="ignore"):
        t = (gap[..., 0] * d[None, :, 1] - gap[..., 1] * d[None, :, 0]) / cross
        s = (gap[..., 0] * d[:, None, 1] - gap[..., 1] * d[:, None, 0]) / cross
        inside = (t > 0) & (t < 1) & (s > 0) & (s < 1)
        heights = a[:, None, 1] + t * d[:, None, 1]
    return np.unique(np.concatenate([segments[:, 1], segments[:, 3], heights[inside]]))


def _cycles(segments: np.ndarray, kinks: np.ndarray, nu: Sequence[float]) -> np.ndarray:
    """Most cycles of exp(-2 pi i nu.r) along any edge within each strip between kinks."""
    xa, ya, xb, yb = segments.T
    lower, upper = kinks[:-1, None], kinks[1:, None]
    crosses = (np.minimum(ya, yb) < upper) & (np.maximum(ya, yb) > lower)
    with np.errstate(all="ignore"):
        slope = np.where(ya != yb, (xb - xa) / (yb - ya), 0.0)
    return np.max((upper - lower) * crosses * np.abs(nu[1] + nu[0] * slope), axis=1)


def _nodes(kinks: np.ndarray, cycles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on strips between kinks, cut where the phase asks for it."""
    unit_nodes, unit_weights = np.polynomial.legendre.leggauss(NODES)
    pieces = np.maximum(1, np.ceil(cycles / CYCLES_PER_STRIP)).astype(int)
    strips = [
        np.linspace(lo, hi, n + 1) for lo, hi, n in zip(kinks[:-1], kinks[1:], pieces, strict=True)
    ]
    lower = np.concatenate([s[:-1] for s in strips])
    half = np.concatenate([np.diff(s) for s in strips]) / 2
    y = (lower + half)[:, None] + half[:, None] * unit_nodes
    return y.ravel(), (half[:, None] * unit_weights).ravel()


def _integral(copies: Sequence[Sequence[Any]], nu: Sequence[float]) -> complex:
    groups = [_segments(rings) for rings in copies]
    segments = np.concatenate(groups)
    copy = np.repeat(np.arange(len(groups)), [len(g) for g in groups])
    kinks = _kinks(segments)
    if len(kinks) < 2:
        return 0j
    y, weights = _nodes(kinks, _cycles(segments, kinks, nu))
    xa, ya, xb, yb = segments.T
    with np.errstate(all="ignore"):
        x = xa + (xb - xa) * (y[:, None] - ya) / (yb - ya)
    x[(np.minimum(ya, yb) > y[:, None]) | (np.maximum(ya, yb) <= y[:, None])] = np.inf
    order = np.argsort(x, axis=1, kind="stable")
    x = np.take_along_axis(x, order, axis=1)
    inside = np.ones(x.shape, dtype=bool)
    for k in range(len(groups)):
        inside &= np.cumsum((copy == k)[order], axis=1) % 2 == 1
    left, right, inside = x[:, :-1], x[:, 1:], inside[:, :-1] & np.isfinite(x[:, 1:])
    width = np.where(inside, right, 0) - np.where(inside, left, 0)
    middle = (np.where(inside, right, 0) + np.where(inside, left, 0)) / 2
    along = width * np.sinc(nu[0] * width) * np.exp(-2j * np.pi * nu[0] * middle)
    return complex(np.sum(weights * np.exp(-2j * np.pi * nu[1] * y) * along.sum(axis=1)))


def fourier(rings: Sequence[Any], nu: Sequence[float]) -> complex:
    """F(nu)."""
    return _integral([rings], nu)


def wigner(rings: Sequence[Any], x: Sequence[float], nu: Sequence[float]) -> float:
    """W(x, nu)."""
    forward = [2 * (np.asarray(ring, float) - x) for ring in rings]
    return _integral([forward, [-ring for ring in forward]], nu).real


def ambiguity(rings: Sequence[Any], upsilon: Sequence[float], xi: Sequence[float]) -> complex:
    """A(upsilon, xi)."""
    half = np.asarray(xi, float) / 2
    return _integral([[np.asarray(r, float) + s * half for r in rings] for s in (-1, 1)], upsilon)
