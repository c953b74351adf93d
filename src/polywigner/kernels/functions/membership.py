"""The field of a source at points."""

from __future__ import annotations

from typing import Any

from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.outline.waves import field_of
from polywigner.numerics.complex_pairs import Pair


def field(ops: Any, tables: Tables, x: Any, y: Any) -> tuple[Any, Any]:
    """(real, imaginary) part of u at a point of the frame, less the carrier's phase.

    The weights of the elements around the point, times their waves.

    Every edge that crosses the horizontal line through the point to its right counts, up with its
    element's weight and down with the negative. Lower ends belong to an edge and upper ends do not,
    so that of two polygons that share an edge exactly one has each of its points.
    """

    def term(ax: Any, ay: Any, bx: Any, by: Any, real: Any, imag: Any) -> tuple[Any, Any]:
        left = ops.cross(bx - ax, by - ay, x - ax, y - ay)
        up = (ay <= y) & (by > y) & (left > 0.0)
        down = (ay > y) & (by <= y) & (left < 0.0)
        winding = ops.select(up, 1.0, 0.0) - ops.select(down, 1.0, 0.0)
        return real * winding, imag * winding

    total = Pair(0.0, 0.0)
    for group, waves in enumerate(tables.groups):
        edges = [edge for edge in tables.edges if edge.group == group]
        if edges:
            rows = [(e.ax, e.ay, e.bx, e.by, e.real, e.imag) for e in edges]
            weight = Pair(*ops.sum_over(rows, term, 2, like=x))
            total = total + (weight * Pair(*field_of(ops, waves, (x, y))))
    undefined = _zero_or_nan(x) + _zero_or_nan(y)
    return total.real + undefined, total.imag + undefined


def _zero_or_nan(value: Any) -> Any:
    """NaN where the value is no finite number: all comparisons with a NaN are false, as outside."""
    return value - value
