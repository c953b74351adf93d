"""Whether points lie inside a source."""

from __future__ import annotations

from typing import Any

from polywigner.kernels.slits import SlitTables
from polywigner.kernels.tables import Tables

__all__ = ["in_slits", "winding"]


def winding(ops: Any, tables: Tables, x: Any, y: Any) -> Any:
    """1.0 inside the polygon, 0.0 outside, for a point of the frame.

    Every edge that crosses the horizontal line through the point to its right counts, up as +1 and
    down as -1. Lower ends belong to an edge and upper ends do not, so that of two polygons that
    share an edge exactly one has each of its points.
    """

    def term(ax: Any, ay: Any, bx: Any, by: Any) -> tuple[Any]:
        left = ops.cross(bx - ax, by - ay, x - ax, y - ay)
        up = (ay <= y) & (by > y) & (left > 0.0)
        down = (ay > y) & (by <= y) & (left < 0.0)
        return (ops.select(up, 1.0, 0.0) - ops.select(down, 1.0, 0.0),)

    rows = [(edge.ax, edge.ay, edge.bx, edge.by) for edge in tables.edges]
    (total,) = ops.sum_over(rows, term, 1, like=x)
    return total


def in_slits(ops: Any, tables: SlitTables, x: Any) -> Any:
    """1.0 in a slit, its begin included, 0.0 elsewhere."""
    total: Any = 0.0
    for a, b in tables.edges:
        total = total + ops.select((x >= a) & (x < b), 1.0, 0.0)
    return total
