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

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from polywigner.kernels.lattice import exact_cross
from polywigner.kernels.tables import Edge, Line, Piece, Tables

__all__ = ["AHEAD", "BEHIND", "MIRRORED", "Clipper", "View"]

_NEARLY_PARALLEL = 0.03  # see tables._TRANSVERSAL


@dataclass(frozen=True)
class View:
    """Sign of the offset (times the vector T handed to the clipper) and of y."""

    offset: int
    point: int


MIRRORED = View(offset=+1, point=-1)
BEHIND = View(offset=-1, point=+1)
AHEAD = View(offset=+1, point=+1)


class Clipper:
    """Cuts edges for one vector T = 2x or xi; shares what edges and views have in common."""

    def __init__(self, ops: Any, tables: Tables, tx: Any, ty: Any) -> None:
        self.ops = ops
        self.tables = tables
        if tables.grid is not None:
            tx, ty = ops.snapped(tx, tables.grid), ops.snapped(ty, tables.grid)
        self.tx, self.ty = tx, ty
        self._levels: dict[tuple[float, float], Any] = {}

    def level(self, line: Line) -> Any:
        """cross(direction, T)."""
        key = (line.dx, line.dy)
        if key not in self._levels:
            self._levels[key] = _cross_with_constant(self.ops, line.dx, line.dy, self.tx, self.ty)
        return self._levels[key]

    def intervals(self, edge: Edge, view: View) -> Iterator[tuple[Any, Any, float]]:
        """(t0 + t1, t1 - t0, weight) of the edge inside each piece; t1 - t0 = 0 if outside."""
        cuts: dict[int, tuple[Any, bool]] = {}
        for piece in self.tables.pieces:
            yield (*self._interval(edge, view, piece, cuts), piece.weight)

    def _interval(
        self, edge: Edge, view: View, piece: Piece, cuts: dict[int, tuple[Any, bool]]
    ) -> tuple[Any, Any]:
        ops = self.ops
        low: Any = 0.0
        high: Any = 1.0
        gates: list[tuple[Any, int]] = []
        for number, side in piece.sides:
            line = self.tables.lines[number]
            slope = _slope(line, edge)
            if self._is_parallel(edge, line, slope):
                gates.append((self._lies_left(edge, line, view), side))
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

    def _is_parallel(self, edge: Edge, line: Line, slope: float) -> bool:
        own = self.tables.lines[edge.line]
        return own.cluster == line.cluster and (not line.exact or slope == 0.0)

    def _cut(self, edge: Edge, line: Line, view: View, slope: float) -> Any:
        """t where the edge meets the line of the other copy."""
        own = self.tables.lines[edge.line]
        if line.exact and own.cluster == line.cluster:
            size = (line.dx**2 + line.dy**2) * (edge.ex**2 + edge.ey**2)
            if slope**2 < _NEARLY_PARALLEL**2 * size:
                return self._exact_level(edge, line, view) * (-view.point / slope)
        start = view.point * (line.dx * edge.ay - line.dy * edge.ax) - line.offset
        scale = -view.point / slope
        return self.ops.fma(self.level(line), view.offset * scale, start * scale)

    def _exact_level(self, edge: Edge, line: Line, view: View) -> Any:
        """How far the edge's start lies left of the line, from exact differences, to one ulp."""
        s, sign = view.offset, view.point
        dx = s * self.tx + (sign * edge.ax - line.px)
        dy = s * self.ty + (sign * edge.ay - line.py)
        return self.ops.cross(line.dx, line.dy, dx, dy)

    def _lies_left(self, edge: Edge, line: Line, view: View) -> Any:
        """Whether an edge parallel to a line lies to the left of it in the other copy."""
        if line.exact:
            distance = self._exact_level(edge, line, view)
            return distance >= 0.0 if view is BEHIND else distance > 0.0
        own = self.tables.lines[edge.line]
        if view is MIRRORED:
            return self.level(line) > own.offset + line.offset
        if view is AHEAD:
            return self.level(line) > line.offset - own.offset
        # not (level > ...), so that it is the exact complement of what AHEAD sees
        return self.level(line) <= own.offset - line.offset


def _slope(line: Line, edge: Edge) -> float:
    """cross(direction, e); without rounding first where the two may be nearly parallel."""
    if line.exact:
        return exact_cross(line.dx, line.dy, edge.ex, edge.ey)
    return line.dx * edge.ey - line.dy * edge.ex


def _cross_with_constant(ops: Any, dx: float, dy: float, x: Any, y: Any) -> Any:
    """dx y - dy x without the products that a direction along an axis makes superfluous."""
    if dx == 0.0:
        return x * -dy
    if dy == 0.0:
        return y * dx
    return ops.fma(y, dx, x * -dy)
