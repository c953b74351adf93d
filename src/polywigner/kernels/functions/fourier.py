"""Fourier transform of a polygon: a signed sum over the triangles (origin, p, p') of its edges.

One triangle contributes ``cross(p, p') exp[0, a, b]``, the second divided difference of the
exponential at ``0``, ``a = -2 pi i nu.p`` and ``b = -2 pi i nu.p'``. Unlike the edge sum of the
paper's eq. (FVT) it has no division by nu, stays accurate for slivers, and a boundary that closes
only up to rounding costs no more than rounding (docs/theory.md, (F2)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.kernels.outline.frame import Frame, frame_of
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.divided_differences import simplex_complex_wave, simplex_plane_wave
from polywigner.numerics.exact import exact_cross

__all__ = ["OutlineTables", "fourier", "fourier_complex", "outline_tables"]


@dataclass(frozen=True)
class OutlineTables:
    """A boundary in a frame; nothing is cut here, so neither lines nor convex pieces are needed."""

    frame: Any
    edges: tuple[tuple[float, ...], ...]
    """Begin (x, y) and end of every edge, and cross(begin, end), twice the area of its triangle."""
    following: tuple[int, ...] = ()
    """The number of the edge that begins where each ends; vertices are numbered like edges."""


def outline_tables(
    rings: Sequence[npt.NDArray[np.float64]], frame: Frame | None = None
) -> OutlineTables:
    """The tables of a polygon to the left of its rings, in its own frame or a wider one."""
    frame = frame or frame_of(np.concatenate(rings))
    edges: list[tuple[float, ...]] = []
    following: list[int] = []
    for ring in rings:
        corners = frame.vertices(ring).tolist()
        first = len(edges)
        following += [*range(first + 1, first + len(corners)), first]
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
            edges.append((*a, *b, exact_cross(*a, *b)))
    return OutlineTables(frame, tuple(edges), tuple(following))


def fourier(ops: Any, tables: OutlineTables, nu_x: Any, nu_y: Any) -> tuple[Any, Any]:
    """F(nu) in the frame, as (cosine part, sine part) with F = cosine - i sine. Source: (F2)."""

    def term(ax: Any, ay: Any, bx: Any, by: Any, area: Any) -> tuple[Any, Any]:
        start = ops.fma(nu_x, ax, nu_y * ay)
        end = ops.fma(nu_x, bx, nu_y * by)
        cosine, sine = simplex_plane_wave(ops, start, end)
        return cosine * area, sine * area

    cosine, sine = ops.sum_over(tables.edges, term, 2, like=nu_x)
    return cosine, sine


def fourier_complex(ops: Any, tables: OutlineTables, nu_x: Pair, nu_y: Pair) -> Pair:
    """F(nu) exp(-2 pi level) for complex nu in the frame: analytic in nu, no conjugate anywhere.

    The level is that of the largest wave in the frame's box, so that no term overflows.
    """
    level = phases.level(tables.frame, (nu_x.imag, nu_y.imag))

    def term(ax: Any, ay: Any, bx: Any, by: Any, area: Any) -> tuple[Any, Any]:
        start = nu_x.scaled(ax) + nu_y.scaled(ay)
        end = nu_x.scaled(bx) + nu_y.scaled(by)
        wave = simplex_complex_wave(ops, start, end, level=level).scaled(area)
        return wave.real, wave.imag

    return Pair(*ops.sum_over(tables.edges, term, 2, like=nu_x.real))
