"""Ambiguity function and the area of the position slice: two shifted copies of a polygon."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from polywigner.kernels.cut.cells import clipper_for
from polywigner.kernels.cut.clipping import (
    AHEAD,
    BEHIND,
    Clipper,
    RowClipper,
    View,
    times,
    total_extent,
)
from polywigner.kernels.functions.stokes import moved_off_zero, segment_wave
from polywigner.kernels.outline.tables import Edge, Tables
from polywigner.kernels.outline.waves import Beat, RowBeat, difference_beats, rows_of
from polywigner.numerics.complex_pairs import Pair

__all__ = ["COPIES", "Views", "ambiguity", "pairings", "position_slice_area"]

# Which copy an edge belongs to: its points are p + shift xi.
COPIES = ((BEHIND, -0.5), (AHEAD, +0.5))


def ambiguity(
    ops: Any, tables: Tables, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> tuple[Any, Any]:
    """A(upsilon, xi) in the frame, as (cosine part, sine part) with A = cosine - i sine.

    ``A = i/(2 pi |v|^2) sum c [sinc(q) exp(-2 pi i v.m) - 1]`` over the cut edges of both copies,
    v = upsilon, q = v.e, c = cross(v, e), m the middle: the edge sum of the paper with the
    sum of c, which vanishes, taken out, so that nothing is lost as v goes to 0. (Cheaper than
    triangles, and cut edges are many; the frame has no slivers that would make it less accurate.)
    Source: docs/theory.md, (A1), (I3).
    """
    clipper = clipper_for(ops, tables, xi_x, xi_y, BEHIND, AHEAD)
    total = Pair(0.0, 0.0)
    groups = [k for k in range(len(tables.groups)) if clipper.edges_of(k)]
    if isinstance(clipper, RowClipper) and tables.waves_per_cut > 1:
        total = _sum_over_rows(tables, clipper, groups, (upsilon_x, upsilon_y), (xi_x, xi_y))
        return total.real, -total.imag
    for group in groups:
        beats = _beats_with(group, tables, clipper, (upsilon_x, upsilon_y))

        def term(edge: Edge, beats: Any = beats) -> tuple[Any, ...]:
            cuts: dict[tuple[View, int], Any] = {}
            values: list[Any] = []
            for other, views, beat in beats:
                for view, _ in views:
                    if (view, other) not in cuts:
                        cuts[view, other] = list(clipper.intervals(edge, view, other))
                values += beat.terms(edge, [(side, cuts[view, other]) for view, side in views])
            return tuple(values)

        sums = iter(clipper.sum_over_edges(term, 2 * len(beats), group))
        for _, _, beat in beats:
            total = total + beat.value((next(sums), next(sums)), (xi_x, xi_y))
    return total.real, -total.imag


Views = tuple[tuple[View, float], ...]


def _beats_with(
    group: int, tables: Tables, clipper: Clipper, upsilon: tuple[Any, Any]
) -> list[tuple[int, Views, _Beat]]:
    """For each group of pieces, the views it cuts a group of edges in, and the beats there.

    The edges' field is the first factor in the view BEHIND, the second in the view AHEAD.
    """
    return [
        (other, views, _Beat(clipper, beat, upsilon))
        for other, views, beats in pairings(group, tables)
        for beat in beats
    ]


def pairings(group: int, tables: Tables) -> Iterator[tuple[int, Views, tuple[Beat, ...]]]:
    """For each group of pieces, the views that it cuts a group of edges in, and the beats there."""
    own = tables.groups[group]
    for other, waves in enumerate(tables.groups):
        if other == group:
            yield other, COPIES, difference_beats(own, own)
        else:
            yield other, COPIES[:1], difference_beats(own, waves)
            yield other, COPIES[1:], difference_beats(waves, own)


def _sum_over_rows(
    tables: Tables,
    clipper: RowClipper,
    groups: Sequence[int],
    upsilon: tuple[Any, Any],
    lag: tuple[Any, Any],
) -> Pair:
    """The same with pairs of waves as rows of a table as well: little code, cut once for each."""
    total = Pair(0.0, 0.0)
    for group in groups:
        for other, views, beats in pairings(group, tables):

            def term(edge: Edge, *row: Any, other: int = other, views: Views = views) -> Any:
                beat = _Beat(clipper, RowBeat(False, *row), upsilon)
                cuts = [(side, list(clipper.intervals(edge, v, other))) for v, side in views]
                part = beat.value(beat.terms(edge, cuts), lag)
                return part.real, part.imag

            total = total + Pair(*clipper.sum_over_pairs(term, 2, group, rows_of(beats)))
    return total


class _Beat:
    """The sum over edges of one copy or both, at one frequency."""

    def __init__(self, clipper: Clipper, beat: Beat | RowBeat, upsilon: tuple[Any, Any]) -> None:
        self.ops, self.beat, self.phased = clipper.ops, beat, clipper.tables.phased
        self.v_x, self.v_y = moved_off_zero(self.ops, *beat.detuned(upsilon))
        self.shift = self.ops.fma(self.v_x, clipper.tx, self.v_y * clipper.ty)

    def terms(self, edge: Edge, sides: Sequence[tuple[float, Any]]) -> tuple[Any, Any]:
        ops, v_x, v_y = self.ops, self.v_x, self.v_y
        q = ops.fma(v_x, edge.ex, v_y * edge.ey)
        c = ops.fma(v_x, edge.ey, v_y * -edge.ex)
        at_vertex = ops.fma(v_x, edge.ax, v_y * edge.ay)
        real_sum: Any = 0.0
        imag_sum: Any = 0.0
        for side, cuts in sides:
            start = ops.fma(self.shift, side, at_vertex)
            for middle, extent, real, imag in cuts:
                wave_sine, wave_cosine = segment_wave(
                    ops, extent * q, ops.fma(0.5 * middle, q, start)
                )
                share = times(real, extent)
                real_sum = ops.fma(share, wave_sine, real_sum)
                imag_sum = ops.fma(share, wave_cosine, imag_sum)
                if self.phased:
                    turned = imag * extent
                    real_sum = ops.fma(-turned, wave_cosine, real_sum)
                    imag_sum = ops.fma(turned, wave_sine, imag_sum)
        return c * real_sum, c * imag_sum

    def value(self, sums: tuple[Any, Any], lag: tuple[Any, Any]) -> Pair:
        scale = 1.0 / (2 * math.pi * self.ops.fma(self.v_x, self.v_x, self.v_y * self.v_y))
        total = Pair(sums[0] * scale, sums[1] * scale)
        real, imag = self.beat.amplitude(self.ops, lag)
        if isinstance(real, float) and isinstance(imag, float) and (real, imag) == (1.0, 0.0):
            return total
        return total * Pair(real, imag)


def position_slice_area(ops: Any, tables: Tables, xi_x: Any, xi_y: Any) -> tuple[Any, Any]:
    """R_xi(xi), the area of the position slice in the frame, weighted by the mutual field.

    As real and imaginary part; the latter is there only for complex fields.
    """
    clipper = clipper_for(ops, tables, xi_x, xi_y, BEHIND, AHEAD)

    def term(edge: Edge) -> tuple[Any, ...]:
        lever = ops.fma(clipper.tx, edge.ey, clipper.ty * -edge.ex)
        real: Any = 0.0
        imag: Any = 0.0
        for view, side in COPIES:
            share = ops.fma(lever, side, edge.area)
            extent, turned = total_extent(clipper, edge, view)
            real = ops.fma(share, extent, real)
            if tables.phased:
                imag = ops.fma(share, turned, imag)
        return (real, imag) if tables.phased else (real,)

    real, *imag = clipper.sum_over_edges(term, values=2 if tables.phased else 1)
    return 0.5 * real, 0.5 * imag[0] if imag else 0.0 * real
