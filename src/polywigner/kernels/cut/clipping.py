"""Clipping of an outline by a copy of the outline, with edges as constants in compiled code.

Edges are clipped by the sides of convex pieces. Vertices lie on a grid, so nearly parallel and
coincident edges are clipped as in exact arithmetic (docs/theory/edges.md). A point p of an edge
lies inside the other copy if p' lies inside the outline:

=============  ===========  =====================================================
view           p'           slice
=============  ===========  =====================================================
``MIRRORED``   2x - p       lag slice at x, edges of either copy (mirror images)
``BEHIND``     p - xi       position slice at xi, edges of G - xi/2 inside G + xi/2
``AHEAD``      p + xi       position slice at xi, edges of G + xi/2 inside G - xi/2
=============  ===========  =====================================================

Ties are decided as if the offset 2x or xi were displaced by an infinitesimal vector that points to
the right of every line.
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
    signed_convex_pieces,
    vertices_on_grid,
    with_vertices_on_sides,
)

# Sine of the angle below which an edge and a line are treated as nearly parallel. At this angle,
# rounding moves their intersection by 1/0.03 ulps.
_NEARLY_PARALLEL = 0.03

T = TypeVar("T")


@dataclass(frozen=True)
class Edge:
    """Boundary edge from a to a + e. The polygon lies to the left of the edge."""

    ax: Any
    ay: Any
    ex: Any
    ey: Any
    ux: Any
    uy: Any
    length: Any
    """Signed length: e is ``length`` times the unit vector u, which parallel edges share."""
    real: Any = 1.0
    """Real part of the element's weight."""
    imag: Any = 0.0
    group: Any = 0
    """Index of the group of the edge in ``Tables.groups``."""
    begin: Any = 0
    """Index of the start vertex among the vertices of all elements."""
    end: Any = 0


@dataclass(frozen=True)
class Line:
    dx: float
    dy: float
    px: float
    py: float


@dataclass(frozen=True)
class Piece:
    """Convex piece of an element, as a sequence of pairs (line index, side).

    The side is 1 if the piece lies to the left of the line, and -1 otherwise.
    """

    sides: tuple[tuple[int, int], ...]
    real: float
    """Real part of the weight, with the opposite sign if rounding reversed the orientation of the
    piece."""
    imag: float
    group: int


@dataclass(frozen=True)
class Constants:
    """Edges, lines and convex pieces of all elements, with coordinates on a grid."""

    edges: tuple[Edge, ...]
    lines: tuple[Line, ...]
    pieces: tuple[Piece, ...]
    step: float
    """Spacing of the grid to which offsets must be rounded."""


@lru_cache(maxsize=128)
def constants_of(tables: Tables) -> Constants:
    """Return the edges, lines and convex pieces of a source."""
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
            points, distinct = vertices_on_grid(frame.vertices(ring), step)
            names = np.arange(first, first + len(ring))[distinct].tolist()
            first += len(ring)
            if len(points) < 3:
                continue
            for k, (ax, ay, ex, ey) in enumerate(_sides(points)):
                length = math.copysign(math.hypot(ex, ey), ey if ey else ex)
                unit = (ex / length, ey / length)
                # Nearly equal directions share a unit vector u, so the product nu.u is computed
                # only once.
                ux, uy = directions.setdefault((round(unit[0], 15), round(unit[1], 15)), unit)
                ends = names[k], names[(k + 1) % len(names)]
                edges.append(
                    Edge(ax, ay, ex, ey, ux, uy, length, weight.real, weight.imag, group, *ends)
                )
        vertices = np.concatenate(list(aperture.rings))
        joined = (with_vertices_on_sides(piece, vertices) for piece in aperture.convex_cover)
        on_grid = [vertices_on_grid(frame.vertices(piece), step)[0] for piece in joined]
        for piece, sign in signed_convex_pieces(on_grid):
            sides = dict.fromkeys(_line_of(side, lines) for side in _sides(piece))
            pieces.append(Piece(tuple(sides), sign * weight.real, sign * weight.imag, group))
    return Constants(tuple(edges), tuple(lines), tuple(pieces), step)


def _sides(polygon: Floats) -> list[list[float]]:
    """Return the start point and the vector of each side of a polygon, as four numbers."""
    return list(np.hstack([polygon, np.roll(polygon, -1, axis=0) - polygon]).tolist())


def _line_of(side: Sequence[float], lines: dict[Line, int]) -> tuple[int, int]:
    """Return the index of the line through a side, and 1 or -1 for the side's direction.

    A new line is added to ``lines``.
    """
    ax, ay, ex, ey = side
    if ey > 0 or (ey == 0 and ex > 0):
        return lines.setdefault(Line(ex, ey, ax, ay), len(lines)), 1
    return lines.setdefault(Line(-ex, -ey, ax + ex, ay + ey), len(lines)), -1


@dataclass(frozen=True)
class View:
    """Map from a point p of an edge to p' = ``offset`` T + ``point`` p for the offset T.

    The factors ``offset`` and ``point`` are 1 or -1. The point p lies inside the other copy of the
    outline if p' lies inside the outline.
    """

    offset: int
    point: int

    @property
    def side(self) -> float:
        """Sign of the offset relative to the copy that contains the edges; it decides ties."""
        return float(-self.offset * self.point)


MIRRORED = View(offset=+1, point=-1)
BEHIND = View(offset=-1, point=+1)
AHEAD = View(offset=+1, point=+1)

Cuts = dict[View, list[tuple[Any, Any, Any, Any]]]
"""Parts of an edge that `Clipper.intervals` yields, for each view."""


class Clipper:
    """Clipped edges for one offset between two copies of an outline.

    The offset T is 2x for the Wigner function and xi for the ambiguity function. Parallel edges
    share common subexpressions.
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
        """Return the sum of each of the ``values`` results of ``term(edge)`` over a group's edges.

        Elements with the same field form a group. ``term`` clips the edge, so the group ``other``,
        whose elements clip the edges, is not used here.
        """
        totals = [0.0] * values
        for edge in (edge for edge in self.edges if edge.group == group):
            totals = [a + b for a, b in zip(totals, term(edge), strict=True)]
        return tuple(totals)

    def sums_of_runs(
        self, runs: Sequence[Any], group: int, other: int
    ) -> Iterator[tuple[Any, list[Any]]]:
        """Yield the results of several sums, from one pass over the edges of a group.

        Each run has the attributes ``views``, a sequence of (view, side); ``values``, the number of
        results; and ``terms(edge, cuts)``, the contribution of an edge.
        """
        views = dict.fromkeys(view for run in runs for view, _ in run.views)

        def term(edge: Edge) -> tuple[Any, ...]:
            cuts: Cuts = {view: list(self.intervals(edge, view, other)) for view in views}
            return tuple(value for run in runs for value in run.terms(edge, cuts))

        values = iter(self.sum_over_edges(term, sum(run.values for run in runs), group, other))
        for run in runs:
            yield run, [next(values) for _ in range(run.values)]

    def shared(self, edge: Edge, compute: Callable[[], T], *what: Hashable) -> T:
        """Return ``compute()``, computed once for all parallel constant edges."""
        if type(self) is not Clipper:
            return compute()
        key = (edge.ux, edge.uy, *what)
        if key not in self._shared:
            self._shared[key] = compute()
        value: T = self._shared[key]
        return value

    def level(self, line: Line) -> Number:
        """Return the cross product of the direction of a line and the offset."""
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
        """Yield the parts of an edge inside the convex pieces of the other copy of the outline.

        A part is (t0 + t1, t1 - t0, real, imag), where t0 and t1 are its ends as fractions of the
        edge. The number real + i imag is the weight of the edge times the conjugate weight of the
        piece, or its complex conjugate for the view ``AHEAD``. The length t1 - t0 is 0 if the edge
        lies outside the piece.
        """
        cuts: dict[int, Any] = {}
        for piece in (piece for piece in self.pieces if piece.group == group):
            real, imag = self.tables.mutual(edge.real, edge.imag, piece.real, piece.imag)
            ends_sum, extent = self._interval(edge, view, piece, cuts)
            yield ends_sum, extent, real, -imag if view is AHEAD else imag

    def _interval(
        self, edge: Edge, view: View, piece: Piece, cuts: dict[int, Any]
    ) -> tuple[Any, Any]:
        """Return t0 + t1 and t1 - t0 of :meth:`intervals` for one convex piece.

        ``cuts`` caches the intersections of the edge with lines.
        """
        ops = self.ops
        low: Any = 0.0
        high: Any = 1.0
        gates: list[tuple[Any, int]] = []
        for number, side in piece.sides:
            line = self.lines[number]
            # The edge and the line may be nearly parallel, so their cross product must be accurate
            # to an ulp.
            slope = float(accurate_cross(line.dx, line.dy, edge.ex, edge.ey))
            if slope == 0.0:
                level = self._exact_level(edge, line, view)
                gates.append((level >= 0.0 if view is BEHIND else level > 0.0, side))
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
        """Return the fraction of an edge at which its line meets ``line`` of the other copy.

        The fraction may lie outside the range from 0 to 1.
        """
        scale = -view.point / slope
        size = (line.dx**2 + line.dy**2) * (edge.ex**2 + edge.ey**2)
        if slope**2 < _NEARLY_PARALLEL**2 * size:
            return self._exact_level(edge, line, view) * scale
        x, y = view.point * edge.ax - line.px, view.point * edge.ay - line.py
        start = float(accurate_cross(line.dx, line.dy, x, y))
        return self.ops.fma(self.level(line), view.offset * scale, start * scale)

    def _exact_level(self, edge: Edge, line: Line, view: View) -> Number:
        """Return the cross product of a line's direction and the vector to the start of an edge.

        The vector begins on the line, and ``view`` maps the start. The result is accurate to an
        ulp.
        """
        s, sign = view.offset, view.point
        dx = s * self.tx + (sign * edge.ax - line.px)
        dy = s * self.ty + (sign * edge.ay - line.py)
        return self.ops.cross(line.dx, line.dy, dx, dy)
