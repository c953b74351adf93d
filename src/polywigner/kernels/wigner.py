"""Wigner function and the area of its lag slice, by cutting edges (Stokes' theorem).

``W = 1/(pi^2 |nu|^2) sum_e (c/q) sum_pieces sin(2 pi dt q) sin(2 pi [nu.(2a - 2x) + (t0 + t1) q])``
with q = nu.e, c = cross(nu, e), and [t0, t1] the part of edge e inside the mirrored polygon. The
two copies are mirror images, so the edges of one, doubled, are the whole boundary; only the real
part is left, in which nothing cancels as nu goes to 0. In a collection each cut edge carries the
field of its element times the conjugate of that of the piece; docs/theory.md, (W2).
"""

from __future__ import annotations

import math
from typing import Any

from polywigner.kernels.clipping import MIRRORED, Clipper, clipper_for, times, total_extent
from polywigner.kernels.stokes import moved_off_zero, segment_wave
from polywigner.kernels.tables import Edge, Tables
from polywigner.kernels.trigonometry import sin_turns

__all__ = ["lag_slice_area", "wigner"]


def _floored(ops: Any, nu_x: Any, nu_y: Any) -> tuple[Any, Any]:
    """nu, moved off 0 by so little that W, even in nu, changes by less than rounding."""
    floor = 1e-9 if ops.double else 1e-6
    tiny = (abs(nu_x) < floor) & (abs(nu_y) < floor)  # false if either is not a number
    return ops.select(tiny, floor, nu_x), ops.select(tiny, 0.0, nu_y)


def wigner(ops: Any, tables: Tables, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Any:
    """W(x, nu) in the units of the frame, for arguments in it: docs/theory.md, (W1), (W2)."""
    clipper = clipper_for(ops, tables, 2.0 * x, 2.0 * y)
    if tables.phased:
        return _phased(ops, clipper, nu_x, nu_y)
    nu_x, nu_y = _floored(ops, nu_x, nu_y)
    nu_t = ops.fma(nu_x, clipper.tx, nu_y * clipper.ty)

    def term(edge: Edge) -> tuple[Any]:
        along, ratio = clipper.shared(edge, lambda: _ratio(ops, nu_x, nu_y, edge.ux, edge.uy))
        q = along * edge.length
        start = ops.fma(nu_x, 2 * edge.ax, ops.fma(nu_y, 2 * edge.ay, -nu_t))
        total: Any = 0.0
        for middle, extent, mutual, _ in clipper.intervals(edge, MIRRORED):
            product = sin_turns(ops, extent * q) * sin_turns(ops, ops.fma(middle, q, start))
            total = total + times(mutual, product)
        return (ratio * total,)

    (total,) = clipper.sum_over_edges(term, values=1)
    return total / (math.pi**2 * ops.fma(nu_x, nu_x, nu_y * nu_y))


def _phased(ops: Any, clipper: Clipper, nu_x: Any, nu_y: Any) -> Any:
    """W of a collection with complex weights, which is not even in nu: (W2).

    Cosines count as well. They sum to zero at nu = 0, so that cos - 1 stands for cos.
    """
    nu_x, nu_y = moved_off_zero(ops, nu_x, nu_y)
    nu_t = ops.fma(nu_x, clipper.tx, nu_y * clipper.ty)

    def term(edge: Edge) -> tuple[Any]:
        q = ops.fma(nu_x, edge.ex, nu_y * edge.ey)
        c = ops.fma(nu_x, edge.ey, nu_y * -edge.ex)
        start = ops.fma(nu_x, 2 * edge.ax, ops.fma(nu_y, 2 * edge.ay, -nu_t))
        total: Any = 0.0
        for middle, extent, real, imag in clipper.intervals(edge, MIRRORED):
            sine, cosine = segment_wave(ops, 2.0 * extent * q, ops.fma(middle, q, start))
            total = ops.fma(extent, real * sine - imag * cosine, total)
        return (c * total,)

    (total,) = clipper.sum_over_edges(term, values=1)
    return total * (2.0 / (math.pi * ops.fma(nu_x, nu_x, nu_y * nu_y)))


def _ratio(ops: Any, nu_x: Any, nu_y: Any, ux: Any, uy: Any) -> tuple[Any, Any]:
    """nu.u, kept off 0, and cross(nu, u)/(nu.u)."""
    floor = 1e-30 if ops.double else 1e-20
    along = ops.fma(nu_x, ux, nu_y * uy)
    along = ops.select(abs(along) < floor, floor, along)
    return along, ops.fma(nu_x, uy, nu_y * -ux) / along


def lag_slice_area(ops: Any, tables: Tables, x: Any, y: Any) -> Any:
    """R_x(x), the area of the lag slice, in the frame."""
    clipper = clipper_for(ops, tables, 2.0 * x, 2.0 * y)

    def term(edge: Edge) -> tuple[Any]:
        lever = ops.fma(
            clipper.ty, 2.0 * edge.ex, ops.fma(clipper.tx, -2.0 * edge.ey, 4.0 * edge.area)
        )
        # the imaginary parts of two elements and of the same two the other way round cancel
        return (lever * total_extent(clipper, edge, MIRRORED)[0],)

    (total,) = clipper.sum_over_edges(term, values=1)
    return total
