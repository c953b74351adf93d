"""Fourier transforms of slits, polygons, bodies and placed polygons at sixty digits and more.

A source is a signed sum of simplices with one common apex, each of which contributes d! times its
signed content times a divided difference of the exponential. Every float is taken as the number
that it is: phases nu.V are exact (floats are dyadic, and there is room for all their bits), so
nodes that coincide are equal, and the recursion divides by nothing else than true differences.
It loses digits as those get small, and works with as many more.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Any

import mpmath
import numpy as np

import polywigner as pw

DIGITS = 60
# Bits between the leading one of the largest product nu V and the last one of the smallest.
EXACT_DIGITS = 500

# (d! times the signed content, corners in the space of nu), all of them exact
Simplices = list[tuple[Any, tuple[tuple[Any, ...], ...]]]


def exact_arithmetic() -> Any:
    """A context with room for all bits of sums and products of floats."""
    return mpmath.workdps(EXACT_DIGITS)


def number(value: Any) -> Any:
    """A dyadic fraction in exact arithmetic."""
    return mpmath.mpf(int(value.numerator)) / int(value.denominator)


def simplices_of(source: Any) -> Simplices:
    """The signed simplices of Slits, an Aperture, a placed one, or a Polyhedron."""
    with exact_arithmetic():
        if isinstance(source, pw.Slits):
            pairs = _exact(source.intervals)
            return [(b - a, ((a,), (b,))) for a, b in pairs]
        if isinstance(source, pw.Polyhedron):
            return list(_tetrahedra(source))
        if isinstance(source, pw.Aperture):
            return [(area, corners) for area, corners in _triangles(source)]
        pose = [[mpmath.mpf(v) for v in row] for row in source.pose.tolist()]

        def placed(corner: Sequence[Any]) -> tuple[Any, ...]:
            x, y = corner
            return tuple(row[0] * x + row[1] * y + row[3] for row in pose[:3])

        triangles = _triangles(source.aperture)
        return [(area, tuple(map(placed, corners))) for area, corners in triangles]


def _exact(points: np.ndarray) -> list[tuple[Any, ...]]:
    return [tuple(map(mpmath.mpf, point)) for point in np.asarray(points, float).tolist()]


def _triangles(source: Any) -> Iterable[tuple[Any, tuple[tuple[Any, ...], ...]]]:
    apex = _exact(source.rings[0])[0]
    for ring in source.rings:
        corners = _exact(ring)
        for p, q in zip(corners, corners[1:] + corners[:1], strict=True):
            a, b, c, d = p[0] - apex[0], p[1] - apex[1], q[0] - apex[0], q[1] - apex[1]
            area = a * d - b * c
            if area:
                yield area, (apex, p, q)


def _tetrahedra(source: Any) -> Iterable[tuple[Any, tuple[tuple[Any, ...], ...]]]:
    corners = _exact(source.vertices)
    apex = corners[0]
    for triangle in source.triangles.tolist():
        a, b, c = ([u - v for u, v in zip(corners[k], apex, strict=True)] for k in triangle)
        volume = (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
        if volume:
            yield volume, (apex, *(corners[k] for k in triangle))


class _Exponential:
    """Divided differences of z -> exp(-2 pi i z) for exactly known nodes, remembered."""

    def __init__(self) -> None:
        self._turn = mpmath.mpc(0, -2 * mpmath.pi)
        self._known: dict[Any, Any] = {}

    def __call__(self, nodes: tuple[Any, ...]) -> Any:
        nodes = tuple(sorted(nodes, key=lambda z: (z.real, z.imag)))
        if nodes not in self._known:
            self._known[nodes] = self._computed(nodes)
        return self._known[nodes]

    def _computed(self, nodes: tuple[Any, ...]) -> Any:
        order = len(nodes) - 1
        if not order:
            return mpmath.exp(self._turn * nodes[0])
        i, j = max(combinations(range(order + 1), 2), key=lambda p: _gap(nodes, *p))
        if nodes[i] == nodes[j]:
            return self((nodes[i],)) / math.factorial(order)
        without_i, without_j = nodes[:i] + nodes[i + 1 :], nodes[:j] + nodes[j + 1 :]
        return (self(without_i) - self(without_j)) / (self._turn * (nodes[j] - nodes[i]))


def _gap(nodes: Sequence[Any], i: int, j: int) -> Any:
    difference = nodes[j] - nodes[i]
    return abs(difference.real) + abs(difference.imag)


def _digits_lost(phased: Iterable[tuple[Any, tuple[Any, ...]]]) -> int:
    """A difference of order d loses up to d digits per decade of its smallest distance."""
    smallest, order = mpmath.mpf(1), 1
    for _, nodes in phased:
        order = len(nodes) - 1
        gaps = (_gap(nodes, i, j) for i, j in combinations(range(len(nodes)), 2))
        smallest = min([smallest, *(gap for gap in gaps if gap)])
    return order * math.ceil(-mpmath.log10(smallest))


def fourier(simplices: Simplices, nu: Sequence[complex]) -> Any:
    """F(nu) as an mpmath number of at least DIGITS digits relative to the largest term."""
    with exact_arithmetic():
        frequency = [mpmath.mpc(complex(component)) for component in nu]
        phased = [
            (weight, tuple(mpmath.fdot(frequency, corner) for corner in corners))
            for weight, corners in simplices
        ]
        lost = _digits_lost(phased)
    with mpmath.workdps(DIGITS + lost):
        wave = _Exponential()
        return mpmath.fsum(weight * wave(nodes) for weight, nodes in phased)
