"""The parts of the edges of one copy of a polygon that lie inside the other copy.

An edge point is p = a + t e, 0 <= t <= 1, in the coordinates of G itself; it lies inside the other
copy if another point p' lies in G:

=============  ===========  =====================================================
view           p'           slice
=============  ===========  =====================================================
``MIRRORED``   2x - p       lag slice at x, edges of either copy (mirror images)
``BEHIND``     p - xi       position slice at xi, edges of G - xi/2 inside G + xi/2
``AHEAD``      p + xi       position slice at xi, edges of G + xi/2 inside G - xi/2
=============  ===========  =====================================================

Every bound on t is affine in the offset, so one fused multiply-add and one minimum or maximum do.
Ties are broken as if the offset 2x (or xi) were shifted by an infinitesimal vector that points to
the right of every line; AHEAD and BEHIND see the same xi, so they agree.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Any

from polywigner.kernels.outline.constants import Edge, Line, Piece
from polywigner.kernels.outline.tables import Tables

# Sine of the angle below which an edge and a line are nearly parallel: where they meet at this
# angle is off by 1/0.03 ulps.
_NEARLY_PARALLEL = 0.03


@dataclass(frozen=True)
class View:
    """Sign of the offset (times the vector T handed to the clipper) and of y."""

    offset: int
    point: int

    @property
    def side(self) -> float:
        """The sign of T as seen from the edges' copy, and of its displacement at ties."""
        return float(-self.offset * self.point)


MIRRORED = View(offset=+1, point=-1)
BEHIND = View(offset=-1, point=+1)
AHEAD = View(offset=+1, point=+1)


class Clipper:
    """Cut of edges for one vector T = 2x or xi; edges and views share their terms.

    Edges are constants: what can be decided while tracing is decided then.
    """

    def __init__(self, ops: Any, tables: Tables, tx: Any, ty: Any) -> None:
        self.ops = ops
        self.tables = tables
        constants = tables.constants
        self.edges, self.lines, self.pieces = constants.edges, constants.lines, constants.pieces
        self.tx, self.ty = ops.snapped(tx, constants.step), ops.snapped(ty, constants.step)
        self._levels: dict[tuple[float, float], Any] = {}
        self._shared: dict[Hashable, Any] = {}

    def sum_over_edges(
        self, term: Callable[[Edge], tuple[Any, ...]], values: int, group: int = 0, other: int = 0
    ) -> Any:
        """The sums, one by one, of the ``values`` values that ``term`` gives for each edge.

        Of the elements of one group, that is, with one field, as cut by those of another.
        """
        totals = [0.0] * values
        for edge in (edge for edge in self.edges if edge.group == group):
            totals = [a + b for a, b in zip(totals, term(edge), strict=True)]
        return tuple(totals)

    def shared(self, edge: Edge, compute: Callable[[], Any], *what: Hashable) -> Any:
        """Return ``compute()``, called once for all edges of one direction that are constants."""
        if type(self) is not Clipper:
            return compute()
        key = (edge.ux, edge.uy, *what)
        if key not in self._shared:
            self._shared[key] = compute()
        return self._shared[key]

    def level(self, line: Line) -> Any:
        """cross(direction, T), without the products that a direction along an axis omits."""
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
        """(t0 + t1, t1 - t0, real, imag) of the edge inside each piece of a group.

        t1 - t0 = 0 if it lies outside.

        real + i imag: the weights in u(x + xi/2) u*(x - xi/2); an edge of the copy AHEAD is where
        the second factor ends, any other where the first does.
        """
        cuts: dict[int, Any] = {}
        for piece in (piece for piece in self.pieces if piece.group == group):
            real, imag = self.tables.mutual(edge, piece)
            middle, extent = self._interval(edge, view, piece, cuts)
            yield middle, extent, real, -imag if view is AHEAD else imag

    def _interval(
        self, edge: Edge, view: View, piece: Piece, cuts: dict[int, Any]
    ) -> tuple[Any, Any]:
        ops = self.ops
        low: Any = 0.0
        high: Any = 1.0
        gates: list[tuple[Any, int]] = []
        for number, side in piece.sides:
            line = self.lines[number]
            slope = line.slope(edge)
            if slope == 0.0:
                gates.append((_is_left(self._exact_distance(edge, line, view), view), side))
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

    def _cut(self, edge: Edge, line: Line, view: View, slope: float) -> Any:
        """t where the edge meets the line of the other copy."""
        scale = -view.point / slope
        size = (line.dx**2 + line.dy**2) * (edge.ex**2 + edge.ey**2)
        if slope**2 < _NEARLY_PARALLEL**2 * size:
            return self._exact_distance(edge, line, view) * scale
        start = line.start(edge, view.point)
        return self.ops.fma(self.level(line), view.offset * scale, start * scale)

    def _exact_distance(self, edge: Edge, line: Line, view: View) -> Any:
        """Distance of the edge's start left of the line, from exact differences, to one ulp."""
        s, sign = view.offset, view.point
        dx = s * self.tx + (sign * edge.ax - line.px)
        dy = s * self.ty + (sign * edge.ay - line.py)
        return self.ops.cross(line.dx, line.dy, dx, dy)


def _is_left(distance: Any, view: View) -> Any:
    return distance >= 0.0 if view is BEHIND else distance > 0.0
