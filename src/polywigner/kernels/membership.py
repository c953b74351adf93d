"""The field of a source at points."""

from __future__ import annotations

from typing import Any

from polywigner.kernels.slits import SlitTables
from polywigner.kernels.tables import Tables

__all__ = ["field", "field_in_slits"]


def field(ops: Any, tables: Tables, x: Any, y: Any) -> tuple[Any, Any]:
    """(real, imaginary) part of u at a point of the frame: the weights of the elements around it.

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

    rows = [(e.ax, e.ay, e.bx, e.by, e.real, e.imag) for e in tables.edges]
    real, imag = ops.sum_over(rows, term, 2, like=x)
    undefined = _zero_or_nan(x) + _zero_or_nan(y)
    return real + undefined, imag + undefined


def field_in_slits(ops: Any, tables: SlitTables, x: Any) -> tuple[Any, Any]:
    """(real, imaginary) part of u; a slit has its begin and not its end."""
    real = imag = _zero_or_nan(x)
    for slit in tables.edges:
        inside = ops.select((x >= slit.begin) & (x < slit.end), 1.0, 0.0)
        real = real + inside * slit.real
        imag = imag + inside * slit.imag
    return real, imag


def _zero_or_nan(value: Any) -> Any:
    """NaN where the value is no finite number: all comparisons with a NaN are false, as outside."""
    return value - value
