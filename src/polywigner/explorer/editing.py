"""Outlines changed by hand: new ones from old ones, with nothing of the page in it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import shapely

from polywigner.explorer.state import Point, Ring
from polywigner.geometry import Aperture

Rings = tuple[Ring, ...]

_DIGITS = 6


def rings_of_aperture(aperture: Aperture, per_metre: float = 1) -> Rings:
    """Outlines in units, rounded to a millionth of the size, as one would type them."""
    size = aperture.diameter * per_metre
    digits = max(0, _DIGITS - 1 - math.floor(math.log10(size)))
    return tuple(
        tuple((_round(x * per_metre, digits), _round(y * per_metre, digits)) for x, y in ring)
        for ring in aperture.rings
    )


def snapped(rings: Sequence[Sequence[Point]], step: float) -> Rings:
    """Vertices on a raster of this step; step 0 leaves them where they are."""
    if not step > 0:
        return tuple(tuple((float(x), float(y)) for x, y in ring) for ring in rings)
    # a raster of 0.1 has 0.3 on it, not 0.30000000000000004
    digits = max(0, 3 - math.floor(math.log10(step)))

    def on_raster(value: float) -> float:
        return _round(round(value / step) * step, digits)

    return tuple(tuple((on_raster(x), on_raster(y)) for x, y in ring) for ring in rings)


def _round(value: float, digits: int) -> float:
    return round(value, digits) + 0.0  # no -0.0


def rounded(point: Point, step: float) -> Point:
    """To the digits of a step, as one would type it."""
    digits = max(0, -math.floor(math.log10(step)))
    return _round(point[0], digits), _round(point[1], digits)


def rounded_where_new(rings: Rings, before: Rings, step: float) -> Rings:
    """Vertices to the digits of a step that a mouse has moved; those from before stay exact."""
    known = {point for ring in before for point in ring}
    return tuple(tuple(p if p in known else rounded(p, step) for p in ring) for ring in rings)


def rows_of_rings(rings: Rings) -> list[tuple[int, float, float]]:
    """One row (number of the outline from 1, x, y) for each vertex: the table."""
    return [(number, x, y) for number, ring in enumerate(rings, 1) for x, y in ring]


def rings_of_rows(rows: Sequence[tuple[int, float, float]]) -> Rings:
    """Outlines of a table that have three vertices or more."""
    numbers = dict.fromkeys(number for number, _, _ in rows)
    rings = [tuple((x, y) for n, x, y in rows if n == number) for number in numbers]
    return tuple(ring for ring in rings if len(ring) >= 3)


def without_vertex(rings: Rings, row: int) -> tuple[Rings, str]:
    """Without the vertex of one row of the table; further as :func:`without_lost`."""
    rows = rows_of_rings(rings)
    del rows[row]
    left = [tuple((x, y) for n, x, y in rows if n == k + 1) for k in range(len(rings))]
    return without_lost(rings, dict(enumerate(left)))


def without_lost(rings: Rings, left: Mapping[int, Ring]) -> tuple[Rings, str]:
    """Outlines with three vertices left, and a sentence about the others, if there are any.

    What lies in an outline that goes would change from a hole to an aperture, or back: it goes too.

    Parameters
    ----------
    rings : outlines before.
    left : what is left of each, by its number from 0; none of those that are gone altogether.
    """
    short = {k for k in range(len(rings)) if len(left.get(k, ())) < 3}
    gone = set(short)
    around = [_around(rings, k) for k in range(len(rings))] if short else []
    for k in sorted(range(len(around)), key=lambda k: len(around[k])):  # outer ones first
        if len(around[k] & gone) % 2:
            gone.add(k)
    kept = tuple(left[k] for k in range(len(rings)) if k not in gone)
    return kept, _farewell(short, gone - short)


def _around(rings: Rings, k: int) -> set[int]:
    """Numbers of the outlines around one."""
    x, y = np.array(rings[k]).T
    others = (j for j in range(len(rings)) if j != k)
    return {j for j in others if shapely.contains_xy(shapely.Polygon(rings[j]), x, y).all()}


def _farewell(short: set[int], inside: set[int]) -> str:
    if not short:
        return ""
    text = f"{_named(short)} had too few corners left, and went"
    if inside:
        text += f"; so did {_named(inside).lower()} in it, which would have changed sides"
    return f"{text}. Undo brings back what went."


def _named(numbers: set[int]) -> str:
    return f"Outline{'s' * (len(numbers) > 1)} {', '.join(str(k + 1) for k in sorted(numbers))}"


def with_vertex_near(rings: Rings, point: Point) -> Rings:
    """With a new vertex at a point, in the edge that is nearest to it."""
    edges = [
        (_distance(point, a, ring[(k + 1) % len(ring)]), number, k)
        for number, ring in enumerate(rings)
        for k, a in enumerate(ring)
    ]
    if not edges:
        return rings
    _, number, k = min(edges)
    ring = rings[number]
    changed = (*ring[: k + 1], point, *ring[k + 1 :])
    return (*rings[:number], changed, *rings[number + 1 :])


def _distance(point: Point, a: Point, b: Point) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    px, py = point[0] - a[0], point[1] - a[1]
    square = dx * dx + dy * dy
    t = min(1.0, max(0.0, (px * dx + py * dy) / square)) if square else 0.0
    return math.hypot(px - t * dx, py - t * dy)


def with_vertex_at(rings: Rings, row: int, point: Point) -> Rings:
    """With the vertex of one row of the table at a point."""
    starts = [sum(map(len, rings[:number])) for number in range(len(rings))]
    return tuple(
        tuple(point if start + k == row else p for k, p in enumerate(ring))
        for start, ring in zip(starts, rings, strict=True)
    )


def _plain(value: float) -> float:
    return float(f"{value:.12g}") + 0.0  # 0.1, not 0.10000000000000009


def with_vertex_after(rings: Rings, row: int) -> Rings:
    """With a new vertex in the middle of the edge that begins at one row of the table."""
    for number, ring in enumerate(rings):
        if row < len(ring):
            (ax, ay), (bx, by) = ring[row], ring[(row + 1) % len(ring)]
            middle = (_plain((ax + bx) / 2), _plain((ay + by) / 2))
            changed = (*ring[: row + 1], middle, *ring[row + 1 :])
            return (*rings[:number], changed, *rings[number + 1 :])
        row -= len(ring)
    return rings
