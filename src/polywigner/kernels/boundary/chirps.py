"""Fourier transforms of curved waves, int exp(i pi x.Qx - 2 pi i nu.x) dx, along edges.

In the axes of Q, with q1 the larger curvature and Green's theorem,

    int int exp(i pi (q1 x^2 + q2 y^2) - 2 pi i nu.x) dx dy
        = closed int E(x) exp(i pi q2 y^2 - 2 pi i nu_y y) dy,

where E, the integral of exp(i pi q1 x^2 - 2 pi i nu_x x), is a Fresnel integral. The second
curvature may be anything from -q1 to q1, zero included: spherical, cylindrical and saddle-shaped
waves are one formula. The integrand is entire, and Gauss's rules converge as soon as they resolve
its turns. Source: (Q5) of docs/curved.md.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.numerics.fresnel_integrals import fresnel_tail

__all__ = ["chirp_over_intervals", "chirp_over_rings", "primitive"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# A rule of so many nodes has 15 digits of a wave of so many turns.
_NODES, _TURNS = 32, 7.0
# Nodes of more are gigabytes for one point.
_MOST_TURNS = 1e5
# Nodes of all edges and points at a time: some 100 MiB.
_BLOCK = 1 << 18


def primitive(q: Floats, nu: Floats, x: Floats) -> tuple[Complex, Complex]:
    """E(x) = step + rest, up to a constant that is the same for all x; q > 0.

    ``q``, ``nu``: (n, 1); ``x``: (m,) near the origin, on whose side of the place nu/q of
    stationary phase the constant is 0. The step's error is that of the float 1/sqrt(q), the
    rest's that of its own size.
    """
    root = np.sqrt(math.pi * q)
    t = root * x - math.pi * nu / root
    step, rest = fresnel_tail(t, side=(nu > 0).astype(np.float64))
    factor = -np.exp(0.25j * math.pi) / np.sqrt(q)
    turns = nu * nu / q
    bend = factor * np.exp(-1j * math.pi * (turns - 2 * np.round(turns / 2)))
    return bend * step, factor * rest * np.exp(1j * math.pi * ((q * x - 2 * nu) * x))


def chirp_over_intervals(intervals: Floats, q: Floats, nu: Floats) -> Complex:
    """The transform over intervals (m, 2), for curvatures (n,) and frequencies (n,)."""
    sign = np.sign(q)
    ends = primitive(np.abs(q)[:, None], (sign * nu)[:, None], intervals.ravel())
    value = (ends[0] + ends[1]).reshape(-1, len(intervals), 2)
    total = (value[..., 1] - value[..., 0]).sum(axis=1)
    return np.where(sign < 0, total.conj(), total)


def chirp_over_rings(rings: tuple[Floats, ...], q: Floats, nu: Floats) -> Complex:
    """The transform over outlines, for curvatures (n, 2) along x and y and frequencies (n, 2).

    The first curvature is not zero and the larger; the origin lies within the outline's box.
    """
    begin = np.concatenate(rings)
    edge = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings]) - begin
    rises = edge[:, 1] != 0
    begin, edge = begin[rises], edge[rises]
    sign = np.sign(q[:, :1])
    values = np.empty(len(nu), np.complex128)
    panels = _panels(begin, edge, q, nu)
    for count in np.unique(panels).tolist():
        mine = np.flatnonzero(panels == count)
        step = max(1, _BLOCK // (len(edge) * _NODES * count))
        for some in (mine[k : k + step] for k in range(0, len(mine), step)):
            values[some] = _along(begin, edge, (sign * q)[some], (sign * nu)[some], count)
    return np.where(sign[:, 0] < 0, values.conj(), values)


def _panels(begin: Floats, edge: Floats, q: Floats, nu: Floats) -> NDArray[np.intp]:
    """Into how many panels edges are cut for each point, a power of two: (n,)."""
    most = np.zeros(len(nu))
    for end in (begin, begin + edge):
        slopes = np.abs(q[:, None] * end - nu[:, None]) * np.abs(edge)
        most = np.maximum(most, slopes.sum(axis=2).max(axis=1))
    most = np.where(np.isfinite(most), most, 0.0)  # whose values are not numbers either
    if (most > _MOST_TURNS).any():
        raise ArgumentError(
            f"expected a curved wave of up to {_MOST_TURNS:.0e} turns of phase along an edge, got "
            f"{most.max():.2g}; take lower frequencies, or points of Fresnel's field farther away"
        )
    return np.asarray(2 ** np.ceil(np.log2(np.maximum(most / _TURNS, 1.0))), dtype=np.intp)


def _along(begin: Floats, edge: Floats, q: Floats, nu: Floats, count: int) -> Complex:
    """The sum over edges, each in so many panels; all curvatures q[:, 0] above zero."""
    at, weights = _rule(count)
    x, y = ((begin[:, k, None] + at * edge[:, k, None]).ravel() for k in range(2))
    share = (edge[:, 1, None] * weights).ravel()
    (q1, q2), (nu1, nu2) = (a.T[:, :, None] for a in (q, nu))
    step, rest = primitive(q1, nu1, x)
    return np.asarray(((step + rest) * np.exp(1j * math.pi * ((q2 * y - 2 * nu2) * y))) @ share)


@lru_cache(maxsize=32)
def _rule(count: int) -> tuple[Floats, Floats]:
    """Nodes and weights of so many panels on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    at = (np.arange(count)[:, None] + (nodes + 1) / 2) / count
    return at.ravel(), np.tile(weights / (2 * count), count)
