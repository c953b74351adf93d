"""Exact slices of convex polygons and of rings of two, fast enough for a thousand vertices.

As in :mod:`oracles.exact` every float is the rational number that it is. The intersection of two
convex polygons is that of their half-planes, taken in the order of their directions; what a ring
has of a slice is a sum over its outer and inner outline with signs. Transforms are the edge sum of
the paper with 50 digits, so that what it loses to a small frequency does not matter.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from fractions import Fraction
from functools import cmp_to_key
from typing import Any

import mpmath
import numpy as np

__all__ = ["Signed", "area", "lag_slice", "position_slice", "transform"]

Point = tuple[Fraction, Fraction]
Line = tuple[Fraction, Fraction, Fraction]
"""(dx, dy, cross(direction, p)): the half-plane to its left."""
Signed = list[tuple[int, list[Point]]]
"""Convex polygons that count as 1 or -1."""

DIGITS = 50


def _points(ring: Any) -> list[Point]:
    return [(Fraction(x), Fraction(y)) for x, y in np.asarray(ring, float).tolist()]


def _lines(points: Sequence[Point]) -> list[Line]:
    lines = []
    for (ax, ay), (bx, by) in zip(points, [*points[1:], points[0]], strict=True):
        dx, dy = bx - ax, by - ay
        lines.append((dx, dy, dx * ay - dy * ax))
    return lines


def _cross(a: Line, b: Line) -> Fraction:
    return a[0] * b[1] - a[1] * b[0]


def _compare(a: Line, b: Line) -> int:
    """By direction, counter-clockwise from the x axis."""
    halves = [d[1] < 0 or (d[1] == 0 and d[0] < 0) for d in (a, b)]
    if halves[0] != halves[1]:
        return 1 if halves[0] else -1
    turn = _cross(a, b)
    return -1 if turn > 0 else int(turn < 0)


def _meeting(a: Line, b: Line) -> Point:
    turn = _cross(a, b)
    return (a[2] * b[0] - b[2] * a[0]) / turn, (a[2] * b[1] - b[2] * a[1]) / turn


def _outside(line: Line, p: Point) -> bool:
    return line[0] * p[1] - line[1] * p[0] <= line[2]


def _common(*polygons: Sequence[Point]) -> list[Point]:
    """The corners of the intersection of convex polygons; none if it has no area."""
    lines: list[Line] = []
    for line in sorted((e for p in polygons for e in _lines(p)), key=cmp_to_key(_compare)):
        if lines and _compare(lines[-1], line) == 0:  # of two parallel ones the inner
            dx, dy, offset = lines[-1]
            size = (line[0] * dx + line[1] * dy) / (dx * dx + dy * dy)
            if line[2] > offset * size:
                lines[-1] = line
        else:
            lines.append(line)
    kept: deque[Line] = deque()
    corners: deque[Point] = deque()
    for line in lines:
        while corners and _outside(line, corners[-1]):
            kept.pop(), corners.pop()
        while corners and _outside(line, corners[0]):
            kept.popleft(), corners.popleft()
        if kept:
            if _cross(kept[-1], line) <= 0:
                return []
            corners.append(_meeting(kept[-1], line))
        kept.append(line)
    while corners and _outside(kept[0], corners[-1]):
        kept.pop(), corners.pop()
    if len(kept) < 3:
        return []
    return [*corners, _meeting(kept[-1], kept[0])]


def _slice(first: list[list[Point]], second: list[list[Point]]) -> Signed:
    return [
        ((-1) ** (i + j), common)
        for i, p in enumerate(first)
        for j, q in enumerate(second)
        if (common := _common(p, q))
    ]


def lag_slice(rings: Sequence[Any], x: Sequence[float]) -> Signed:
    """2 (G - x) intersected with 2 (x - G); ``rings``: counter-clockwise, a hole second."""
    px, py = map(Fraction, map(float, x))
    copies = (
        [[(2 * s * (a - px), 2 * s * (b - py)) for a, b in _points(ring)] for ring in rings]
        for s in (1, -1)
    )
    return _slice(*copies)


def position_slice(rings: Sequence[Any], xi: Sequence[float]) -> Signed:
    """(G - xi/2) intersected with (G + xi/2)."""
    hx, hy = (Fraction(float(c)) / 2 for c in xi)
    copies = (
        [[(a + s * hx, b + s * hy) for a, b in _points(ring)] for ring in rings] for s in (-1, 1)
    )
    return _slice(*copies)


def _sides(slice_: Signed) -> Any:
    for sign, corners in slice_:
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
            yield sign, a, b


def area(slice_: Signed) -> Fraction:
    """Of the slice, exactly."""
    total = sum((s * (a[0] * b[1] - a[1] * b[0]) for s, a, b in _sides(slice_)), Fraction(0))
    return total / 2


def transform(slice_: Signed, nu: Sequence[float]) -> complex:
    """The integral of exp(-2 pi i nu.r) over the slice, rounded once."""
    x, y = map(Fraction, map(float, nu))
    if x == 0 == y:
        return complex(area(slice_))

    def number(value: Fraction) -> Any:
        return mpmath.mpf(value.numerator) / value.denominator

    with mpmath.workdps(DIGITS):
        total = mpmath.mpc(0)
        for sign, a, b in _sides(slice_):
            ex, ey = b[0] - a[0], b[1] - a[1]
            middle = x * (a[0] + b[0]) + y * (a[1] + b[1])  # twice that, in turns
            wave = mpmath.expjpi(-number(middle)) * mpmath.sincpi(number(x * ex + y * ey))
            total += sign * number(x * ey - y * ex) * wave
        return complex(total * mpmath.mpc(0, 1) / (2 * mpmath.pi * number(x * x + y * y)))
