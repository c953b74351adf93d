"""Fourier transforms of slits, polygons, bodies and placed polygons at sixty digits and more.

A source is a signed sum of simplices with one common apex, each of which contributes d! times its
signed content times a divided difference of the exponential, as in :mod:`oracles.exact`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

import polywigner as pw
from oracles.exact import nodes_at, rational, sum_over_simplices

DIGITS = 60

# Simplices as exact pairs: d! times the signed content, and the corners in the space of nu.
Simplices = list[tuple[Any, tuple[tuple[Any, ...], ...]]]


def simplices_of(source: Any) -> Simplices:
    """Return the signed simplices of Slits, an Aperture, a PlacedAperture or a Polyhedron."""
    if isinstance(source, pw.Slits):
        return [(b - a, ((a,), (b,))) for a, b in _exact(source.intervals)]
    if isinstance(source, pw.Polyhedron):
        return list(_tetrahedra(source))
    if isinstance(source, pw.Aperture):
        return list(_triangles(source))
    pose = _exact(source.pose)

    def placed(corner: Sequence[Any]) -> tuple[Any, ...]:
        x, y = corner
        return tuple(row[0] * x + row[1] * y + row[3] for row in pose[:3])

    triangles = _triangles(source.aperture)
    return [(area, tuple(map(placed, corners))) for area, corners in triangles]


def _exact(points: np.ndarray) -> list[tuple[Any, ...]]:
    return [tuple(map(rational, point)) for point in np.asarray(points, float).tolist()]


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


def fourier(simplices: Simplices, nu: Sequence[complex]) -> Any:
    """Return F(nu) as an mpmath number with DIGITS digits relative to the largest term."""
    terms = [(weight, nodes_at(nu, corners)) for weight, corners in simplices]
    return sum_over_simplices(terms, DIGITS)


def rounded(source: Any, nu: Iterable[Sequence[complex]]) -> np.ndarray:
    """Return F (n,) of a source at rows of nu (n, d), rounded once."""
    tiling = simplices_of(source)
    return np.array([complex(fourier(tiling, row)) for row in nu])
