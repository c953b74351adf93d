"""Slices of the autocorrelation in rational arithmetic, and their transforms with many digits.

Every float is an exact rational number. A slice is cut by horizontal lines through all vertices and
all crossings of edges. Between two neighbouring lines no edges cross, so each strip is a row of
trapezoids, even if edges coincide, touch or are nearly parallel. Nothing is rounded until mpmath
evaluates the phases 2 pi nu.V.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import combinations, pairwise
from typing import Any

import mpmath
import numpy as np

try:  # optional, ten times faster for the generation of reference data
    from gmpy2 import mpq
except ImportError:
    mpq = Fraction


Node = tuple[Any, Any]
Rings = Sequence[Any]  # oriented (n, 2) rings: outer rings CCW, holes CW

DIGITS = 50


def rational(value: float) -> Any:
    """Return the exact rational value of a float."""
    return mpq(*float(value).as_integer_ratio())


@dataclass(frozen=True)
class Region:
    """Trapezoids with horizontal sides: (y0, y1, left0, right0, left1, right1, weight)."""

    trapezoids: tuple[tuple[Any, ...], ...]

    @property
    def area(self) -> Any:
        """Return the area as an exact rational number."""
        total = rational(0.0)
        for y0, y1, l0, r0, l1, r1, weight in self.trapezoids:
            total += weight * (y1 - y0) * ((r0 - l0) + (r1 - l1)) / 2
        return total


def _exact_rings(rings: Rings) -> list[list[tuple[Any, Any]]]:
    return [[(rational(x), rational(y)) for x, y in np.asarray(ring, float)] for ring in rings]


@dataclass(frozen=True)
class _Edge:
    """Non-horizontal edge from its lower end (xa, ya) to its upper end (xb, yb)."""

    xa: Any
    ya: Any
    xb: Any
    yb: Any
    slope: Any  # dx/dy
    copy: int  # number of the copy that the edge bounds
    winding: int  # change of the winding number across the edge towards +x

    def x_at(self, y: Any) -> Any:
        return self.xa + self.slope * (y - self.ya)


def _edges(rings: list[list[tuple[Any, Any]]], copy: int) -> list[_Edge]:
    edges = []
    for ring in rings:
        for (xa, ya), (xb, yb) in zip(ring, ring[1:] + ring[:1], strict=True):
            if ya < yb:  # upwards: the inside of a CCW ring is on the left, at smaller x
                edges.append(_Edge(xa, ya, xb, yb, (xb - xa) / (yb - ya), copy, -1))
            elif ya > yb:
                edges.append(_Edge(xb, yb, xa, ya, (xa - xb) / (ya - yb), copy, +1))
    return edges


def _near_pairs(edges: list[_Edge]) -> Iterable[tuple[int, int]]:
    """Yield pairs of edges with overlapping bounds, by floats with a margin above rounding."""
    ends = np.array([[float(e.xa), float(e.ya), float(e.xb), float(e.yb)] for e in edges])
    slack = 1e-9 * (np.abs(ends).max() + 1e-300)
    x0, x1 = np.minimum(ends[:, 0], ends[:, 2]) - slack, np.maximum(ends[:, 0], ends[:, 2]) + slack
    y0, y1 = ends[:, 1] - slack, ends[:, 3] + slack
    meet = (x0[:, None] <= x1) & (x0 <= x1[:, None]) & (y0[:, None] <= y1) & (y0 <= y1[:, None])
    for i, j in np.argwhere(np.triu(meet, 1)):
        yield int(i), int(j)


def _crossing_heights(edges: list[_Edge]) -> set[Any]:
    heights = set()
    for i, j in _near_pairs(edges):
        e, f = edges[i], edges[j]
        if e.slope == f.slope:
            continue
        y = (f.xa - e.xa + e.slope * e.ya - f.slope * f.ya) / (e.slope - f.slope)
        if max(e.ya, f.ya) < y < min(e.yb, f.yb):
            heights.add(y)
    return heights


def _row(active: list[_Edge], y0: Any, y1: Any, copies: int) -> dict[tuple[int, int], int]:
    """Return the pairs of edges that bound the region between y0 and y1, with its weight."""
    middle = (y0 + y1) / 2
    order = sorted(((e.x_at(middle), k) for k, e in enumerate(active)), key=lambda item: item[0])
    winding = [0] * copies
    row: dict[tuple[int, int], int] = {}
    for (x_left, left), (x_right, right) in pairwise(order):
        winding[active[left].copy] += active[left].winding
        weight = int(np.prod(winding))
        if weight and x_left != x_right:
            row[id(active[left]), id(active[right])] = weight
    return row


def _trapezoids(edges: list[_Edge], copies: int) -> tuple[tuple[Any, ...], ...]:
    heights = {y for e in edges for y in (e.ya, e.yb)} | _crossing_heights(edges)
    levels = sorted(heights)
    by_id = {id(e): e for e in edges}
    result: list[tuple[Any, ...]] = []
    open_since: dict[tuple[int, int, int], Any] = {}

    def close(keys: Iterable[tuple[int, int, int]], y1: Any) -> None:
        for key in list(keys):
            y0 = open_since.pop(key)
            left, right = by_id[key[0]], by_id[key[1]]
            result.append(
                (y0, y1, left.x_at(y0), right.x_at(y0), left.x_at(y1), right.x_at(y1), key[2])
            )

    for y0, y1 in pairwise(levels):
        active = [e for e in edges if e.ya <= y0 and y1 <= e.yb]
        row = {(*pair, w) for pair, w in _row(active, y0, y1, copies).items()}
        close(open_since.keys() - row, y0)
        for key in row - open_since.keys():
            open_since[key] = y0
    if levels:
        close(list(open_since), levels[-1])
    return tuple(result)


def _turns_clockwise(ring: list[tuple[Any, Any]]) -> bool:
    ahead = ring[1:] + ring[:1]
    return sum(x * v - u * y for (x, y), (u, v) in zip(ring, ahead, strict=True)) < 0


def oriented(polygons: Iterable[tuple[Any, Iterable[Any]]]) -> list[np.ndarray]:
    """Return rings of (outer, holes) polygons with outer rings CCW and holes CW."""
    rings = []
    for outer, holes in polygons:
        for ring, is_hole in [(outer, False), *((hole, True) for hole in holes)]:
            points = np.asarray(ring, float)
            flip = _turns_clockwise(_exact_rings([points])[0]) != is_hole
            rings.append(points[::-1] if flip else points)
    return rings


def _region(*copies: list[list[tuple[Any, Any]]]) -> Region:
    """Return the product of the winding numbers of one or more copies with exact rings."""
    edges = [e for k, rings in enumerate(copies) for e in _edges(rings, k)]
    return Region(_trapezoids(edges, len(copies)) if edges else ())


def lag_region(rings: Rings, x: Sequence[float], other: Rings | None = None) -> Region:
    """Return 2 (G - x) intersected with 2 (x - H); H is G unless ``other`` is given."""
    px, py = map(rational, x)
    forward, backward = (
        [[(s * 2 * (a - px), s * 2 * (b - py)) for a, b in ring] for ring in _exact_rings(copy)]
        for s, copy in ((1, rings), (-1, rings if other is None else other))
    )
    return _region(forward, backward)


def position_region(rings: Rings, xi: Sequence[float], other: Rings | None = None) -> Region:
    """Return (G - xi/2) intersected with (H + xi/2); H is G unless ``other`` is given."""
    hx, hy = (rational(c) / 2 for c in xi)
    behind, ahead = (
        [[(a + s * hx, b + s * hy) for a, b in ring] for ring in _exact_rings(copy)]
        for s, copy in ((-1, rings), (1, rings if other is None else other))
    )
    return _region(behind, ahead)


def _triangles(shape: Region) -> list[tuple[Any, tuple[Node, ...]]]:
    """Return triangles as (twice the signed area, corners)."""
    triangles: list[tuple[Any, tuple[Node, ...]]] = []
    for y0, y1, l0, r0, l1, r1, weight in shape.trapezoids:
        height = weight * (y1 - y0)
        if r0 != l0:
            triangles.append((height * (r0 - l0), ((l0, y0), (r0, y0), (l1, y1))))
        if r1 != l1:
            triangles.append((height * (r1 - l1), ((r0, y0), (r1, y1), (l1, y1))))
    return triangles


def _to_mpf(value: Any) -> Any:
    return mpmath.mpf(int(value.numerator)) / int(value.denominator)


def nodes_at(nu: Sequence[complex], corners: Iterable[Sequence[Any]]) -> tuple[Node, ...]:
    """Return nu.corner in cycles, (Re, Im), as exact rational numbers."""
    parts = [(rational(complex(c).real), rational(complex(c).imag)) for c in nu]
    return tuple(
        (
            sum((p * x for (p, _), x in zip(parts, corner, strict=True)), rational(0.0)),
            sum((q * x for (_, q), x in zip(parts, corner, strict=True)), rational(0.0)),
        )
        for corner in corners
    )


class _Exponential:
    """Divided differences of q -> exp(-2 pi i q) for exact q = (Re q, Im q)."""

    def __init__(self) -> None:
        self._known: dict[Node, Any] = {}
        self._slope = mpmath.mpc(0, -2 * mpmath.pi)

    def _exponent(self, re: Any, im: Any) -> Any:
        return self._slope * mpmath.mpc(_to_mpf(re), _to_mpf(im))

    def __call__(self, nodes: tuple[Node, ...]) -> Any:
        """Return the divided difference over nodes, dividing by the largest node difference."""
        order = len(nodes) - 1
        if not order:
            if nodes[0] not in self._known:
                self._known[nodes[0]] = mpmath.exp(self._exponent(*nodes[0]))
            return self._known[nodes[0]]
        i, j = max(combinations(range(order + 1), 2), key=lambda p: _gap(nodes, *p))
        if nodes[i] == nodes[j]:
            return self(nodes[i : i + 1]) / math.factorial(order)
        without_i, without_j = nodes[:i] + nodes[i + 1 :], nodes[:j] + nodes[j + 1 :]
        apart = (b - a for a, b in zip(nodes[i], nodes[j], strict=True))
        return (self(without_i) - self(without_j)) / self._exponent(*apart)


def _gap(nodes: Sequence[Node], i: int, j: int) -> Any:
    return abs(nodes[j][0] - nodes[i][0]) + abs(nodes[j][1] - nodes[i][1])


def _log10(value: Any) -> float:
    """Return log10 of a positive rational number that may be too small for a float."""
    bits = int(value.numerator).bit_length() - int(value.denominator).bit_length()
    return bits * math.log10(2)


def sum_over_simplices(terms: Sequence[tuple[Any, tuple[Node, ...]]], digits: int) -> Any:
    """Return the sum of weights times divided differences, as an mpmath number.

    A difference of order d loses up to d digits per decade of its smallest distance.
    """
    smallest, order = 0.0, 1
    for _, nodes in terms:
        order = len(nodes) - 1
        gaps = (_gap(nodes, i, j) for i, j in combinations(range(order + 1), 2))
        smallest = min([smallest, *(_log10(gap) for gap in gaps if gap)])
    with mpmath.workdps(digits + int(-order * smallest) + 2):
        wave = _Exponential()
        return mpmath.fsum(_to_mpf(weight) * wave(nodes) for weight, nodes in terms)


def transform(shape: Region, nu: Sequence[complex], digits: int = DIGITS) -> Any:
    """Return the integral of exp(-2 pi i nu.r) over a region, as an mpmath complex number."""
    terms = [(twice, nodes_at(nu, corners)) for twice, corners in _triangles(shape)]
    return mpmath.mpc(sum_over_simplices(terms, digits))


@lru_cache(maxsize=64)
def _region_of(key: tuple[tuple[tuple[float, float], ...], ...]) -> Region:
    return _region(_exact_rings(key))


def plain_region(rings: Rings) -> Region:
    return _region_of(tuple(tuple(map(tuple, np.asarray(r, float).tolist())) for r in rings))


def area(rings: Rings) -> float:
    """Return the area, rounded once."""
    return float(plain_region(rings).area)


def fourier(rings: Rings, nu: Sequence[complex]) -> complex:
    """Return F(nu), rounded once; nu may be complex."""
    return complex(transform(plain_region(rings), nu))


def wigner(rings: Rings, x: Sequence[float], nu: Sequence[float]) -> float:
    """Return W(x, nu), rounded once."""
    return float(transform(lag_region(rings, x), nu).real)


def ambiguity(rings: Rings, upsilon: Sequence[float], xi: Sequence[float]) -> complex:
    """Return A(upsilon, xi), rounded once."""
    return complex(transform(position_region(rings, xi), upsilon))
