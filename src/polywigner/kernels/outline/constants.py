"""Edges, lines and convex pieces of outlines as constants of compiled code.

A slice of the autocorrelation is the intersection of two copies of the outline. Its boundary
consists of the true edges of either copy, cut to the parts inside the other copy. "Inside" is
decided line by line against the convex pieces of the other copy.

Vertices are on a grid. Cuts of nearly parallel edges, and edges that coincide, are therefore as in
exact arithmetic (docs/theory/edges.md). All other lines meet at a well-conditioned point.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.geometry import Aperture
from polywigner.kernels.outline.frame import Frame
from polywigner.numerics.grid_arithmetic import (
    GRID,
    accurate_cross,
    rounded,
    signed_convex_pieces,
    with_vertices_on_sides,
)

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Edge:
    """A true boundary edge from a to b = a + e, the polygon to its left."""

    ax: Any
    ay: Any
    bx: Any
    """The next edge's ax: the same float, which ax + ex need not be."""
    by: Any
    ex: Any
    ey: Any
    area: Any
    """cross(a, e): twice the signed area of the triangle (origin, a, a + e)."""
    ux: Any
    uy: Any
    length: Any
    """e = length u, with one unit vector u for all parallel edges; negative if e runs against u."""
    real: Any = 1.0
    """The complex weight of the element that the edge bounds."""
    imag: Any = 0.0
    group: Any = 0
    """Number of the weight's field in ``Tables.groups``."""
    begin: Any = 0
    """Numbers of the vertices a and b among all vertices of all rings of all elements."""
    end: Any = 0


@dataclass(frozen=True)
class Line:
    """The line through p along d; left of it cross(d, . - p) is positive."""

    dx: float
    dy: float
    px: float
    py: float

    def slope(self, edge: Edge) -> float:
        """cross(d, e), without rounding first: the two may be nearly parallel."""
        return float(accurate_cross(self.dx, self.dy, edge.ex, edge.ey))

    def start(self, edge: Edge, sign: int) -> float:
        """Distance, times |d|, of ``sign`` times an edge's start to the left of the line."""
        x, y = sign * edge.ax - self.px, sign * edge.ay - self.py
        return float(accurate_cross(self.dx, self.dy, x, y))


@dataclass(frozen=True)
class Piece:
    """A convex piece: (line, side) with side +1 where the piece lies left of the line."""

    sides: tuple[tuple[int, int], ...]
    real: float
    """The element's weight; its negative for a triangle turned over by rounding."""
    imag: float = 0.0
    group: int = 0


@dataclass(frozen=True)
class Constants:
    """Edges, lines and convex pieces of all elements, on the grid."""

    edges: tuple[Edge, ...]
    lines: tuple[Line, ...]
    pieces: tuple[Piece, ...]
    step: float
    """Spacing of the grid, to which offsets must be rounded."""


def constants_of(tables: Any) -> Constants:
    """Return the constants of tables, all elements with shared lines."""
    step = GRID[tables.double]
    group_of = dict(zip(tables.names[:, 2].tolist(), tables.names[:, 3].tolist(), strict=True))
    edges: list[Edge] = []
    pieces: list[Piece] = []
    lines: dict[Line, int] = {}
    directions: dict[tuple[float, float], tuple[float, float]] = {}
    first = 0
    for number, (aperture, weight) in enumerate(zip(tables.apertures, tables.weights, strict=True)):
        group, weight = group_of[number], complex(weight)
        for ring in aperture.rings:
            points, kept = rounded(tables.frame.vertices(ring), step)
            if len(points) > 2:
                names = np.arange(first, first + len(ring))[kept]
                edges += _edges(points, names.tolist(), directions, weight, group)
            first += len(ring)
        for piece, sign in _pieces(aperture, tables.frame, step):
            sides = dict.fromkeys(_side(segment, lines) for segment in _segments_of(piece))
            pieces.append(Piece(tuple(sides), sign * weight.real, sign * weight.imag, group))
    return Constants(tuple(edges), tuple(lines), tuple(pieces), step)


def _pieces(aperture: Aperture, frame: Frame, step: float) -> list[tuple[Floats, float]]:
    """Convex pieces with signs that add up to an element on the grid."""
    vertices = np.concatenate(list(aperture.rings))
    joined = (with_vertices_on_sides(piece, vertices) for piece in aperture.convex_cover)
    return signed_convex_pieces([rounded(frame.vertices(piece), step)[0] for piece in joined])


def _segments_of(polygon: Floats) -> list[list[float]]:
    """Return start and vector of each side of a closed polygon (n, 2), (n, 4)."""
    found: list[list[float]] = np.hstack([polygon, np.roll(polygon, -1, axis=0) - polygon]).tolist()
    return found


def _side(segment: Sequence[float], lines: dict[Line, int]) -> tuple[int, int]:
    """Number of the line of a side, with one direction for both sides of it, and 1 or -1."""
    ax, ay, ex, ey = segment
    if ey > 0 or (ey == 0 and ex > 0):
        return lines.setdefault(Line(ex, ey, ax, ay), len(lines)), 1
    return lines.setdefault(Line(-ex, -ey, ax + ex, ay + ey), len(lines)), -1


def _edges(
    ring: Floats,
    names: Sequence[int],
    directions: dict[tuple[float, float], tuple[float, float]],
    weight: complex,
    group: int,
) -> Iterator[Edge]:
    """``names``: the numbers of the ring's vertices."""
    ends = np.roll(ring, -1, axis=0).tolist()
    for k, ((ax, ay, ex, ey), (bx, by)) in enumerate(zip(_segments_of(ring), ends, strict=True)):
        length = math.copysign(math.hypot(ex, ey), ey if ey else ex)
        unit = (ex / length, ey / length)
        # directions equal up to rounding share one float pair, so that nu.direction is shared
        ux, uy = directions.setdefault((round(unit[0], 15), round(unit[1], 15)), unit)
        yield Edge(
            ax, ay, bx, by, ex, ey, accurate_cross(ax, ay, ex, ey), ux, uy, length,
            weight.real, weight.imag, group, names[k], names[(k + 1) % len(names)],
        )  # fmt: skip
