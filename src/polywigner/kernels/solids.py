"""Fourier transform of polyhedra: signed tetrahedra and third divided differences.

A body is the signed sum of the tetrahedra (origin, a, b, c) over the triangles of its faces' fans.
Each contributes ``det(a, b, c) exp[0, z_a, z_b, z_c]`` with z = -2 pi i nu.p: no division by nu, no
face normals, and non-convex faces need no triangulation (docs/theory.md, (F3)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import combinations
from typing import Any

from polywigner.geometry import Polyhedron
from polywigner.kernels.complex_pairs import Pair, plane_wave, select
from polywigner.kernels.stokes import triangle_complex_wave

__all__ = ["SolidFrame", "SolidTables", "solid_tables", "solid_transform", "tetrahedron_wave"]

# As in ``stokes``: below this largest separation (turns) the series, above it the recursion.
_SERIES_BELOW = 0.1
# First omitted term, (k+1)(k+2)/2 0.63^k/(k+3)!: 1e-19 at k = 16, 6e-9 at k = 9.
_TERMS_DOUBLE, _TERMS_SINGLE = 16, 9

Point = tuple[float, float, float]


@dataclass(frozen=True)
class SolidFrame:
    """x' = (x - centre)/scale, nu' = scale nu; the scale is a power of two."""

    centre: Point
    scale: float

    @property
    def content(self) -> float:
        return self.scale**3

    def frequency(self, ops: Any, *nu: Any) -> tuple[Any, ...]:
        return tuple(component * self.scale for component in nu)


@dataclass(frozen=True)
class SolidTables:
    """The body in its frame; ``edges`` are what a sum runs over.

    Each is a tetrahedron: ax, ay, az, bx, ..., cz, and det(a, b, c), six times its signed volume.
    """

    frame: SolidFrame
    edges: tuple[tuple[float, ...], ...]


@lru_cache(maxsize=64)
def solid_tables(body: Polyhedron, double: bool) -> SolidTables:
    """The tables of a polyhedron; the same for either precision."""
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    centre = low + (high - low) / 2
    scale = math.ldexp(1.0, math.frexp(body.diameter)[1])
    inner = (body.vertices - centre) / scale
    corners = inner[body.triangles].reshape(-1, 9).tolist()
    rows = [(*row, _determinant(*row)) for row in corners]
    frame = SolidFrame((float(centre[0]), float(centre[1]), float(centre[2])), scale)
    return SolidTables(frame, tuple(row for row in rows if row[-1]))


def _determinant(*row: float) -> float:
    """det(a, b, c), correctly rounded."""
    ax, ay, az, bx, by, bz, cx, cy, cz = map(Fraction, row)
    value = ax * (by * cz - bz * cy) - ay * (bx * cz - bz * cx) + az * (bx * cy - by * cx)
    return float(value)


def solid_transform(ops: Any, tables: SolidTables, nu: tuple[Pair, Pair, Pair]) -> Pair:
    """F(nu) in the frame; nu complex, or real with imaginary parts 0.0. Source: (F3)."""

    def term(*row: Any) -> tuple[Any, Any]:
        corners = (_dot(nu, row[0:3]), _dot(nu, row[3:6]), _dot(nu, row[6:9]))
        wave = tetrahedron_wave(ops, *corners).scaled(row[9])
        return wave.real, wave.imag

    return Pair(*ops.sum_over(tables.edges, term, 2, like=nu[0].real))


def _dot(nu: tuple[Pair, Pair, Pair], point: tuple[Any, ...]) -> Pair:
    x, y, z = (component.scaled(c) for component, c in zip(nu, point, strict=True))
    return x + y + z


def tetrahedron_wave(ops: Any, u: Pair, v: Pair, w: Pair) -> Pair:
    """exp[0, -2 pi i u, -2 pi i v, -2 pi i w]: six times the mean of a wave over a tetrahedron, /6.

    1/6 at u = v = w = 0. Recursion over the two nodes that lie farthest apart.
    """
    origin = Pair(0.0, 0.0)
    nodes = (origin, u, v, w)
    first, last, left, right = origin, u, v, w
    largest: Any = (u - origin).norm()
    for i, j in list(combinations(range(4), 2))[1:]:
        k, m = (n for n in range(4) if n not in (i, j))
        size = (nodes[j] - nodes[i]).norm()
        wins = size > largest
        largest = ops.maximum(size, largest)
        first = select(ops, wins, nodes[i], first)
        last = select(ops, wins, nodes[j], last)
        left = select(ops, wins, nodes[k], left)
        right = select(ops, wins, nodes[m], right)
    small = largest < _SERIES_BELOW**2
    distance = last - first
    divisor = select(ops, small, Pair(1.0, 0.0), distance) * Pair(0.0, -2 * math.pi)
    difference = _shifted_triangle(ops, last, left, right) - _shifted_triangle(
        ops, first, left, right
    )
    return select(ops, small, _series(ops, small, u, v, w), difference / divisor)


def _shifted_triangle(ops: Any, a: Pair, b: Pair, c: Pair) -> Pair:
    """exp[a, b, c] for nodes in turns."""
    return plane_wave(ops, a) * triangle_complex_wave(ops, b - a, c - a)


def _series(ops: Any, small: Any, u: Pair, v: Pair, w: Pair) -> Pair:
    """sum_k h_k(a, b, c)/(k + 3)!; arguments clamped to its domain."""
    turn, origin = Pair(0.0, -2 * math.pi), Pair(0.0, 0.0)
    a, b, c = (turn * select(ops, small, node, origin) for node in (u, v, w))
    one = Pair(1.0, 0.0)
    h_c, h_bc, h_abc = one, one, one
    total = Pair(1 / 6, 0.0)
    for k in range(1, _TERMS_DOUBLE if ops.double else _TERMS_SINGLE):
        h_c = h_c * c
        h_bc = h_bc * b + h_c
        h_abc = h_abc * a + h_bc
        total = total + h_abc.scaled(1 / math.factorial(k + 3))
    return total
