"""Edges as constants of compiled code, and their parts that lie inside the other copy.

A slice is the intersection of two copies of the outline. Its boundary consists of the edges of both
copies, cut to the parts inside the other copy. This module clips edges by the sides of the convex
pieces of the other copy. Vertices lie on a grid, so nearly parallel and coincident edges are cut as
in exact arithmetic (docs/theory/edges.md). All other lines meet at a well-conditioned point.

A point of an edge is p = a + t e, 0 <= t <= 1, in the coordinates of the outline G. It lies inside
the other copy if the point p' lies in G:

=============  ===========  =====================================================
view           p'           slice
=============  ===========  =====================================================
``MIRRORED``   2x - p       lag slice at x, edges of either copy (mirror images)
``BEHIND``     p - xi       position slice at xi, edges of G - xi/2 inside G + xi/2
``AHEAD``      p + xi       position slice at xi, edges of G + xi/2 inside G - xi/2
=============  ===========  =====================================================

Every bound on t is affine in the offset, so it costs one fused multiply-add and one minimum or
maximum. Ties are decided as if the offset 2x (or xi) were shifted by an infinitesimal vector that
points to the right of every line. AHEAD and BEHIND have the same xi, so their decisions agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from polywigner.kernels.outline import Tables
from polywigner.numerics import Floats, Number
from polywigner.numerics.grid_arithmetic import (
    accurate_cross,
    rounded,
    signed_convex_pieces,
    with_vertices_on_sides,
)

# Sine of the angle below which an edge and a line count as nearly parallel. At this angle, rounding
# moves their intersection by 1/0.03 ulps.
_NEARLY_PARALLEL = 0.03

T = TypeVar("T")


@dataclass(frozen=True)
class Edge:
    """A boundary edge from a to a + e, with the polygon to its left."""

    ax: Any
    ay: Any
    ex: Any
    ey: Any
    ux: Any
    uy: Any
    length: Any
    """Signed length of e relative to a unit vector u shared by all parallel edges: e = length u. It
    is negative if e points against u."""
    real: Any = 1.0
    """Real part of the complex weight of the element that the edge bounds; ``imag`` is the
    imaginary part."""
    imag: Any = 0.0
    group: Any = 0
    """Index of the field of the element in ``Tables.groups``."""
    begin: Any = 0
    """Index of the vertex a among all vertices of all rings of all elements; ``end`` is the index
    of a + e."""
    end: Any = 0


@dataclass(frozen=True)
class Line:
    """The line through p along d. To its left, cross(d, . - p) is positive."""

    dx: float
    dy: float
    px: float
    py: float


@dataclass(frozen=True)
class Piece:
    """A convex piece, as pairs (line, side); the side is +1 if it lies left of the line."""

    sides: tuple[tuple[int, int], ...]
    real: float
    """Weight of the element. A triangle whose orientation was reversed by rounding has the opposite
    sign."""
    imag: float
    group: int


@dataclass(frozen=True)
class Constants:
    """Edges, lines and convex pieces of all elements, with coordinates on the grid."""

    edges: tuple[Edge, ...]
    lines: tuple[Line, ...]
    pieces: tuple[Piece, ...]
    step: float
    """Spacing of the grid to which offsets must be rounded."""


@lru_cache(maxsize=128)
def constants_of(tables: Tables) -> Constants:
    """Return the edges, lines and convex pieces of a source, whose elements share lines."""
    frame = tables.frame
    step = frame.grid_step(tables.double)
    group_of = dict(zip(tables.names[:, 2].tolist(), tables.names[:, 3].tolist(), strict=True))
    edges: list[Edge] = []
    pieces: list[Piece] = []
    lines: dict[Line, int] = {}
    directions: dict[tuple[float, float], tuple[float, float]] = {}
    first = 0
    for number, (aperture, weight) in enumerate(zip(tables.apertures, tables.weights, strict=True)):
        group, weight = group_of[number], complex(weight)
        for ring in aperture.rings:
            points, distinct = rounded(frame.vertices(ring), step)
            names = np.arange(first, first + len(ring))[distinct].tolist()
            first += len(ring)
            if len(points) < 3:
                continue
            for k, (ax, ay, ex, ey) in enumerate(_sides(points)):
                length = math.copysign(math.hypot(ex, ey), ey if ey else ex)
                unit = (ex / length, ey / length)
                # Edges whose directions are equal up to rounding share one unit vector u, and thus
                # one product nu.u.
                ux, uy = directions.setdefault((round(unit[0], 15), round(unit[1], 15)), unit)
                ends = names[k], names[(k + 1) % len(names)]
                edges.append(
                    Edge(ax, ay, ex, ey, ux, uy, length, weight.real, weight.imag, group, *ends)
                )
        vertices = np.concatenate(list(aperture.rings))
        joined = (with_vertices_on_sides(piece, vertices) for piece in aperture.convex_cover)
        on_grid = [rounded(frame.vertices(piece), step)[0] for piece in joined]
        for piece, sign in signed_convex_pieces(on_grid):
            sides = dict.fromkeys(_line_of(side, lines) for side in _sides(piece))
            pieces.append(Piece(tuple(sides), sign * weight.real, sign * weight.imag, group))
    return Constants(tuple(edges), tuple(lines), tuple(pieces), step)


def _sides(polygon: Floats) -> list[list[float]]:
    """Return the start point and vector of each side of a closed polygon (n, 2)."""
    return list(np.hstack([polygon, np.roll(polygon, -1, axis=0) - polygon]).tolist())


def _line_of(side: Sequence[float], lines: dict[Line, int]) -> tuple[int, int]:
    """Return the index of the line of a side, and 1 or -1 for the direction along the line."""
    ax, ay, ex, ey = side
    if ey > 0 or (ey == 0 and ex > 0):
        return lines.setdefault(Line(ex, ey, ax, ay), len(lines)), 1
    return lines.setdefault(Line(-ex, -ey, ax + ex, ay + ey), len(lines)), -1


@dataclass(frozen=True)
class View:
    """The map p' = ``offset`` T + ``point`` p; both factors are 1 or -1."""

    offset: int
    point: int

    @property
    def side(self) -> float:
        """Sign of T relative to the copy with the edges, and of the shift that decides ties."""
        return float(-self.offset * self.point)


MIRRORED = View(offset=+1, point=-1)
BEHIND = View(offset=-1, point=+1)
AHEAD = View(offset=+1, point=+1)

Cuts = dict[View, list[tuple[Any, Any, Any, Any]]]
"""The parts of an edge in each view, as `Clipper.intervals` yields them."""


class Clipper:
    """Cuts of edges for one offset T = 2x or xi; edges and views share common subexpressions.

    Edges are constants, so parallel edges are recognised during tracing.
    """

    def __init__(self, ops: Any, tables: Tables, tx: Any, ty: Any) -> None:
        self.ops, self.tables = ops, tables
        constants = constants_of(tables)
        self.edges, self.lines, self.pieces = constants.edges, constants.lines, constants.pieces
        self.tx, self.ty = ops.snapped(tx, constants.step), ops.snapped(ty, constants.step)
        self._levels: dict[tuple[float, float], Any] = {}
        self._shared: dict[Hashable, Any] = {}

    def sum_over_edges(
        self, term: Callable[[Edge], tuple[Any, ...]], values: int, group: int = 0, other: int = 0
    ) -> tuple[Any, ...]:
        """Return the sums of the ``values`` results of ``term(edge)`` over the edges of a group.

        A group consists of the elements that have the same field. Their edges are cut by the
        elements of the group ``other``.
        """
        totals = [0.0] * values
        for edge in (edge for edge in self.edges if edge.group == group):
            totals = [a + b for a, b in zip(totals, term(edge), strict=True)]
        return tuple(totals)

    def sums_of_runs(
        self, runs: Sequence[Any], group: int, other: int
    ) -> Iterator[tuple[Any, list[Any]]]:
        """Yield (run, results) for several sums, from one pass over the edges of a group.

        A run is the sum for one pair of waves. Its attributes are ``views``, a sequence of
        (view, side); ``values``, the number of its results; and ``terms(edge, cuts)``, the
        contribution of an edge.
        """
        views = dict.fromkeys(view for run in runs for view, _ in run.views)

        def term(edge: Edge) -> tuple[Any, ...]:
            cuts: Cuts = {view: list(self.intervals(edge, view, other)) for view in views}
            return tuple(value for run in runs for value in run.terms(edge, cuts))

        values = iter(self.sum_over_edges(term, sum(run.values for run in runs), group, other))
        for run in runs:
            yield run, [next(values) for _ in range(run.values)]

    def shared(self, edge: Edge, compute: Callable[[], T], *what: Hashable) -> T:
        """Return ``compute()``; if edges are constants, parallel edges share the result."""
        if type(self) is not Clipper:
            return compute()
        key = (edge.ux, edge.uy, *what)
        if key not in self._shared:
            self._shared[key] = compute()
        value: T = self._shared[key]
        return value

    def level(self, line: Line) -> Number:
        """Return cross(direction, T) of a line; lines parallel to an axis need only one product."""
        key = (line.dx, line.dy)
        if key not in self._levels:
            x, y = self.tx * -line.dy, self.ty
            if line.dx == 0.0:
                self._levels[key] = x
            else:
                self._levels[key] = self.ops.fma(y, line.dx, x) if line.dy else y * line.dx
        return self._levels[key]

    def intervals(
        self, edge: Edge, view: View, group: int = 0
    ) -> Iterator[tuple[Any, Any, Any, Any]]:
        """Yield (t0 + t1, t1 - t0, real, imag) for the part of an edge inside each piece.

        The length t1 - t0 is 0 if the edge lies outside the piece. real + i imag is the product of
        the weights in u(x + xi/2) u*(x - xi/2). Edges of the copy AHEAD bound the second factor,
        all other edges the first factor.
        """
        cuts: dict[int, Any] = {}
        for piece in (piece for piece in self.pieces if piece.group == group):
            real, imag = self.tables.mutual(edge.real, edge.imag, piece.real, piece.imag)
            ends_sum, extent = self._interval(edge, view, piece, cuts)
            yield ends_sum, extent, real, -imag if view is AHEAD else imag

    def _interval(
        self, edge: Edge, view: View, piece: Piece, cuts: dict[int, Any]
    ) -> tuple[Any, Any]:
        ops = self.ops
        low: Any = 0.0
        high: Any = 1.0
        gates: list[tuple[Any, int]] = []
        for number, side in piece.sides:
            line = self.lines[number]
            # The cross product is accurate to an ulp, because the edge and the line may be nearly
            # parallel.
            slope = float(accurate_cross(line.dx, line.dy, edge.ex, edge.ey))
            if slope == 0.0:
                distance = self._exact_distance(edge, line, view)
                gates.append((distance >= 0.0 if view is BEHIND else distance > 0.0, side))
                continue
            if number not in cuts:
                cuts[number] = (self._cut(edge, line, view, slope), slope * view.point > 0)
            cut, rising = cuts[number]
            if rising == (side > 0):
                low = ops.maximum(low, cut)
            else:
                high = ops.minimum(high, cut)
        length = ops.maximum(high - low, 0.0)
        for lies_left, side in gates:
            inside = (length, 0.0) if side > 0 else (0.0, length)
            length = ops.select(lies_left, *inside)
        return low + high, length

    def _cut(self, edge: Edge, line: Line, view: View, slope: float) -> Number:
        """Return the fraction t at which the edge meets a line of the other copy."""
        scale = -view.point / slope
        size = (line.dx**2 + line.dy**2) * (edge.ex**2 + edge.ey**2)
        if slope**2 < _NEARLY_PARALLEL**2 * size:
            return self._exact_distance(edge, line, view) * scale
        x, y = view.point * edge.ax - line.px, view.point * edge.ay - line.py
        start = float(accurate_cross(line.dx, line.dy, x, y))
        return self.ops.fma(self.level(line), view.offset * scale, start * scale)

    def _exact_distance(self, edge: Edge, line: Line, view: View) -> Number:
        """Return cross(line, start of the edge) to one ulp, positive to the left of the line."""
        s, sign = view.offset, view.point
        dx = s * self.tx + (sign * edge.ax - line.px)
        dy = s * self.ty + (sign * edge.ay - line.py)
        return self.ops.cross(line.dx, line.dy, dx, dy)
