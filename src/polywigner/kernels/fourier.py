"""Fourier transform of a polygon."""

from __future__ import annotations

from typing import Any

from polywigner.kernels import phases
from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.stokes import triangle_complex_wave, triangle_plane_wave
from polywigner.kernels.tables import Tables

__all__ = ["fourier", "fourier_complex"]


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
    """F(nu) exp(-2 pi level) for complex nu in the frame: analytic in nu, no conjugate anywhere.

    The level is that of the largest wave in the frame's box, so that no term overflows.
    """
    level = phases.level(tables.frame, (nu_x.imag, nu_y.imag))

    def term(ax: Any, ay: Any, bx: Any, by: Any, area: Any) -> tuple[Any, Any]:
        start = nu_x.scaled(ax) + nu_y.scaled(ay)
        end = nu_x.scaled(bx) + nu_y.scaled(by)
        wave = triangle_complex_wave(ops, start, end, level).scaled(area)
        return wave.real, wave.imag

    return Pair(*ops.sum_over(_corners(tables), term, 2, like=nu_x.real))
