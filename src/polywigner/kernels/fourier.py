"""Fourier transform of a polygon, and ambiguity function of two shifted copies of it."""

from __future__ import annotations

import math
from typing import Any

from polywigner.kernels.clipping import AHEAD, BEHIND, clipper_for, total_extent
from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.stokes import segment_wave, triangle_complex_wave, triangle_plane_wave
from polywigner.kernels.tables import Edge, Tables

__all__ = ["ambiguity", "fourier", "fourier_complex", "position_slice_area"]


def _corners(tables: Tables) -> list[tuple[float, ...]]:
    """Begin, end, and twice the area of the triangle with the origin, of every edge."""
    return [(e.ax, e.ay, e.bx, e.by, e.area) for e in tables.edges]


def fourier(ops: Any, tables: Tables, nu_x: Any, nu_y: Any) -> tuple[Any, Any]:
    """F(nu) in the frame, as (cosine part, sine part) with F = cosine - i sine. Source: (F2)."""

    def term(ax: Any, ay: Any, bx: Any, by: Any, area: Any) -> tuple[Any, Any]:
        start = ops.fma(nu_x, ax, nu_y * ay)
        end = ops.fma(nu_x, bx, nu_y * by)
        cosine, sine = triangle_plane_wave(ops, start, end)
        return cosine * area, sine * area

    cosine, sine = ops.sum_over(_corners(tables), term, 2, like=nu_x)
    return cosine, sine


def fourier_complex(ops: Any, tables: Tables, nu_x: Pair, nu_y: Pair) -> Pair:
    """F(nu) for complex nu in the frame: linear-analytic in nu, no conjugate anywhere."""

    def term(ax: Any, ay: Any, bx: Any, by: Any, area: Any) -> tuple[Any, Any]:
        start = nu_x.scaled(ax) + nu_y.scaled(ay)
        end = nu_x.scaled(bx) + nu_y.scaled(by)
        wave = triangle_complex_wave(ops, start, end).scaled(area)
        return wave.real, wave.imag

    return Pair(*ops.sum_over(_corners(tables), term, 2, like=nu_x.real))


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
    v_x, v_y = _moved_off_zero(ops, upsilon_x, upsilon_y)
    shift = ops.fma(v_x, clipper.tx, v_y * clipper.ty)

    def term(edge: Edge) -> tuple[Any, Any]:
        q = ops.fma(v_x, edge.ex, v_y * edge.ey)
        c = ops.fma(v_x, edge.ey, v_y * -edge.ex)
        at_vertex = ops.fma(v_x, edge.ax, v_y * edge.ay)
        cosine: Any = 0.0
        sine: Any = 0.0
        for view, side in _COPIES:
            start = ops.fma(shift, side, at_vertex)
            for middle, extent, weight in clipper.intervals(edge, view):
                where = ops.fma(0.5 * middle, q, start)
                wave_sine, wave_cosine = segment_wave(ops, extent * q, where)
                share = extent if weight > 0 else -extent
                cosine = ops.fma(share, wave_sine, cosine)
                sine = ops.fma(share, wave_cosine, sine)
        return c * cosine, c * sine

    cosine, sine = clipper.sum_over_edges(term, values=2)
    scale = 1.0 / (2 * math.pi * ops.fma(v_x, v_x, v_y * v_y))
    return cosine * scale, -sine * scale


def _moved_off_zero(ops: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """A frequency, or if it is so small that its square underflows, one that is just larger.

    Changes A by the floor times the diameter, far below rounding.
    """
    floor = 1e-140 if ops.double else 1e-16
    tiny = (abs(x) < floor) & (abs(y) < floor)  # false if either is not a number
    return ops.select(tiny, floor, x), ops.select(tiny, 0.0, y)


def position_slice_area(ops: Any, tables: Tables, xi_x: Any, xi_y: Any) -> Any:
    """R_xi(xi), the area of the position slice, in the frame."""
    clipper = clipper_for(ops, tables, xi_x, xi_y)

    def term(edge: Edge) -> tuple[Any]:
        lever = ops.fma(clipper.tx, edge.ey, clipper.ty * -edge.ex)
        total: Any = 0.0
        for view, side in _COPIES:
            share = ops.fma(lever, side, edge.area)
            total = ops.fma(share, total_extent(ops, clipper, edge, view), total)
        return (total,)

    (total,) = clipper.sum_over_edges(term, values=1)
    return 0.5 * total
