"""Sources as signed simplices in exact arithmetic: corners, contents, phases and moments.

For assertions that must not depend on what they check: every float is the rational number that it
is, and nothing is rounded before the end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits

__all__ = ["Simplex", "corners_of", "phase_of", "simplices_of", "small_frequency_limit"]

Array = NDArray[Any]
Point = tuple[Fraction, ...]


@dataclass(frozen=True)
class Simplex:
    """d! times the signed content, and the corners in the space of nu."""

    weight: Fraction
    corners: tuple[Point, ...]


def simplices_of(source: Any) -> list[Simplex]:
    """Signed simplices with one corner in common, their first, whose sum the source is."""
    if isinstance(source, Slits):
        ends = [tuple((Fraction(x),) for x in pair) for pair in source.intervals.tolist()]
        return [Simplex(b[0] - a[0], (a, b)) for a, b in ends]
    if isinstance(source, Polyhedron):
        corners = _exact(source.vertices)
        return _fan([[corners[k] for k in face] for face in source.triangles.tolist()])
    if isinstance(source, PlacedAperture):
        pose = [[Fraction(value) for value in row] for row in source.pose.tolist()]
        return [
            Simplex(s.weight, tuple(_placed(pose, corner) for corner in s.corners))
            for s in simplices_of(source.aperture)
        ]
    rings = [_exact(ring) for ring in source.rings]
    return _fan([[p, q] for r in rings for p, q in zip(r, r[1:] + r[:1], strict=True)])


def corners_of(source: Any) -> Array:
    """Vertices (n, d) in the space of nu, as floats."""
    if isinstance(source, Slits):
        return source.intervals.reshape(-1, 1)
    if isinstance(source, Polyhedron):
        return source.vertices
    if isinstance(source, Aperture):
        return np.concatenate(source.rings)
    flat = np.concatenate(source.aperture.rings)
    return flat @ source.pose[:3, :2].T + source.pose[:3, 3]


def _exact(points: Array) -> list[Point]:
    return [tuple(Fraction(x) for x in point) for point in points.tolist()]


def _placed(pose: list[list[Fraction]], corner: Point) -> Point:
    x, y = corner
    return tuple(row[0] * x + row[1] * y + row[3] for row in pose[:3])


def _fan(faces: list[list[Point]]) -> list[Simplex]:
    """The cones from one corner over all faces that do not contain it."""
    apex = faces[0][0]
    found = []
    for face in faces:
        rows = [[x - a for x, a in zip(corner, apex, strict=True)] for corner in face]
        weight = _determinant(rows)
        if weight:
            found.append(Simplex(weight, (apex, *face)))
    return found


def _determinant(rows: Sequence[Sequence[Fraction]]) -> Fraction:
    if len(rows) == 2:
        return rows[0][0] * rows[1][1] - rows[0][1] * rows[1][0]
    (a, b, c), lower = rows[0], rows[1:]
    minors = [[[row[j] for j in range(3) if j != k] for row in lower] for k in range(3)]
    first, second, third = (_determinant(minor) for minor in minors)
    return a * first - b * second + c * third


def phase_of(nu: Sequence[float], point: Sequence[Any]) -> complex:
    """exp(-2 pi i nu.point), the product exact and reduced modulo one turn."""
    turns = sum(Fraction(n) * Fraction(x) for n, x in zip(nu, point, strict=True))
    reduced = float(turns - round(turns))
    return complex(math.cos(2 * math.pi * reduced), -math.sin(2 * math.pi * reduced))


def small_frequency_limit(
    simplices: list[Simplex], centre: Sequence[float], nu: Sequence[float]
) -> complex:
    """F(nu) to second order in nu.(x - centre), from exact moments.

    The next term is (2 pi |nu| D)^3/6 of the content.
    """
    d = len(simplices[0].corners) - 1
    middle = [Fraction(c) for c in centre]
    frequency = [Fraction(n) for n in nu]
    zeroth = first = second = Fraction(0)
    for simplex in simplices:
        turns = [
            sum((n * (x - c) for n, x, c in zip(frequency, p, middle, strict=True)), Fraction(0))
            for p in simplex.corners
        ]
        total = sum(turns, Fraction(0))
        squares = sum((t * t for t in turns), Fraction(0))
        zeroth += simplex.weight / math.factorial(d)
        first += simplex.weight * total / math.factorial(d + 1)
        second += simplex.weight * (total * total + squares) / math.factorial(d + 2)
    turn = 2 * math.pi
    near = complex(float(zeroth) - turn**2 * float(second) / 2, -turn * float(first))
    return near * phase_of(nu, centre)
