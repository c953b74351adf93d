"""Ambiguity function and the area of the position slice: two shifted copies of a polygon."""

from __future__ import annotations

import math
from typing import Any

from polywigner.kernels.clipping import AHEAD, BEHIND, clipper_for, times, total_extent
from polywigner.kernels.stokes import moved_off_zero, segment_wave
from polywigner.kernels.tables import Edge, Tables

__all__ = ["ambiguity", "position_slice_area"]

# Which copy an edge belongs to: its points are p + shift xi.
_COPIES = ((BEHIND, -0.5), (AHEAD, +0.5))


def ambiguity(
    ops: Any, tables: Tables, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> tuple[Any, Any]:
    """A(upsilon, xi) in the frame, as (cosine part, sine part) with A = cosine - i sine.

    ``A = i/(2 pi |v|^2) sum c [sinc(q) exp(-2 pi i v.m) - 1]`` over the cut edges of both copies,
    v = upsilon, q = v.e, c = cross(v, e), m the middle: the edge sum of the paper with the
    sum of c, which vanishes, taken out, so that nothing is lost as v goes to 0. (Cheaper than
    triangles, and cut edges are many; the frame has no slivers that would make it less accurate.)
    Source: docs/theory.md, (A1).
    """
    clipper = clipper_for(ops, tables, xi_x, xi_y)
    v_x, v_y = moved_off_zero(ops, upsilon_x, upsilon_y)
    shift = ops.fma(v_x, clipper.tx, v_y * clipper.ty)

    def term(edge: Edge) -> tuple[Any, Any]:
        q = ops.fma(v_x, edge.ex, v_y * edge.ey)
        c = ops.fma(v_x, edge.ey, v_y * -edge.ex)
        at_vertex = ops.fma(v_x, edge.ax, v_y * edge.ay)
        cosine: Any = 0.0
        sine: Any = 0.0
        for view, side in _COPIES:
            start = ops.fma(shift, side, at_vertex)
            for middle, extent, real, imag in clipper.intervals(edge, view):
                where = ops.fma(0.5 * middle, q, start)
                wave_sine, wave_cosine = segment_wave(ops, extent * q, where)
                share = times(real, extent)
                cosine = ops.fma(share, wave_sine, cosine)
                sine = ops.fma(share, wave_cosine, sine)
                if tables.phased:
                    turned = imag * extent
                    cosine = ops.fma(-turned, wave_cosine, cosine)
                    sine = ops.fma(turned, wave_sine, sine)
        return c * cosine, c * sine

    cosine, sine = clipper.sum_over_edges(term, values=2)
    scale = 1.0 / (2 * math.pi * ops.fma(v_x, v_x, v_y * v_y))
    return cosine * scale, -sine * scale


def position_slice_area(ops: Any, tables: Tables, xi_x: Any, xi_y: Any) -> tuple[Any, Any]:
    """R_xi(xi), the area of the position slice in the frame, weighted by the mutual field.

    As real and imaginary part; the latter is there only for complex fields.
    """
    clipper = clipper_for(ops, tables, xi_x, xi_y)

    def term(edge: Edge) -> tuple[Any, ...]:
        lever = ops.fma(clipper.tx, edge.ey, clipper.ty * -edge.ex)
        real: Any = 0.0
        imag: Any = 0.0
        for view, side in _COPIES:
            share = ops.fma(lever, side, edge.area)
            extent, turned = total_extent(clipper, edge, view)
            real = ops.fma(share, extent, real)
            if tables.phased:
                imag = ops.fma(share, turned, imag)
        return (real, imag) if tables.phased else (real,)

    real, *imag = clipper.sum_over_edges(term, values=2 if tables.phased else 1)
    return 0.5 * real, 0.5 * imag[0] if imag else 0.0 * real
