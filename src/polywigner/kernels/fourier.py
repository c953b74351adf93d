"""Fourier transform of a polygon, and ambiguity function of two shifted copies of it."""

from __future__ import annotations

from typing import Any

from polywigner.kernels.clipping import AHEAD, BEHIND, Clipper
from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.stokes import triangle_complex_wave, triangle_plane_wave
from polywigner.kernels.tables import Tables

__all__ = ["ambiguity", "fourier", "fourier_complex", "position_slice_area"]


def fourier(ops: Any, tables: Tables, nu_x: Any, nu_y: Any) -> tuple[Any, Any]:
    """F(nu) in the frame, as (cosine part, sine part) with F = cosine - i sine."""
    cosine: Any = 0.0
    sine: Any = 0.0
    for edge in tables.edges:
        start = ops.fma(nu_x, edge.ax, nu_y * edge.ay)
        end = ops.fma(nu_x, edge.ax + edge.ex, nu_y * (edge.ay + edge.ey))
        c, s = triangle_plane_wave(ops, start, end)
        cosine = ops.fma(c, edge.area, cosine)
        sine = ops.fma(s, edge.area, sine)
    return cosine, sine


def fourier_complex(ops: Any, tables: Tables, nu_x: Pair, nu_y: Pair) -> Pair:
    """F(nu) for complex nu in the frame: linear-analytic in nu, no conjugate anywhere."""
    total = Pair(0.0, 0.0)
    for edge in tables.edges:
        start = nu_x.scaled(edge.ax) + nu_y.scaled(edge.ay)
        end = nu_x.scaled(edge.ax + edge.ex) + nu_y.scaled(edge.ay + edge.ey)
        total = total + triangle_complex_wave(ops, start, end).scaled(edge.area)
    return total


# Which copy an edge belongs to: its points are y + shift xi.
_COPIES = ((BEHIND, -0.5), (AHEAD, +0.5))


def ambiguity(
    ops: Any, tables: Tables, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> tuple[Any, Any]:
    """A(upsilon, xi) in the frame, as (cosine part, sine part) with A = cosine - i sine.

    Source: maths, section 4; the boundary of (G - xi/2) & (G + xi/2) is made of the edges of
    either copy inside the other.
    """
    clipper = Clipper(ops, tables, xi_x, xi_y)
    shift = ops.fma(upsilon_x, clipper.tx, upsilon_y * clipper.ty)
    cosine: Any = 0.0
    sine: Any = 0.0
    for edge in tables.edges:
        q = ops.fma(upsilon_x, edge.ex, upsilon_y * edge.ey)
        at_vertex = ops.fma(upsilon_x, edge.ax, upsilon_y * edge.ay)
        lever = ops.fma(clipper.tx, edge.ey, clipper.ty * -edge.ex)  # cross(xi, e)
        for view, side in _COPIES:
            start = ops.fma(shift, side, at_vertex)
            twice_area = ops.fma(lever, side, edge.area)
            for middle, extent, weight in clipper.intervals(edge, view):
                low, high = 0.5 * (middle - extent), 0.5 * (middle + extent)
                c, s = triangle_plane_wave(ops, ops.fma(low, q, start), ops.fma(high, q, start))
                share = extent * twice_area * weight
                cosine = ops.fma(c, share, cosine)
                sine = ops.fma(s, share, sine)
    return cosine, sine


def position_slice_area(ops: Any, tables: Tables, xi_x: Any, xi_y: Any) -> Any:
    """R_xi(xi), the area of the position slice, in the frame."""
    clipper = Clipper(ops, tables, xi_x, xi_y)
    total: Any = 0.0
    for edge in tables.edges:
        lever = ops.fma(clipper.tx, edge.ey, clipper.ty * -edge.ex)
        for view, side in _COPIES:
            extent_sum: Any = 0.0
            for _, extent, weight in clipper.intervals(edge, view):
                extent_sum = ops.fma(extent, weight, extent_sum)
            total = ops.fma(ops.fma(lever, side, edge.area), extent_sum, total)
    return 0.5 * total
