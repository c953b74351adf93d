"""Wigner function and the area of its lag slice, by cutting edges (Stokes' theorem).

``W = 1/(pi^2 |nu|^2) sum_e (c/q) sum_pieces sin(2 pi dt q) sin(2 pi [nu.(2a - 2x) + (t0 + t1) q])``
with q = nu.e, c = cross(nu, e), and [t0, t1] the part of edge e inside the mirrored polygon. The
two copies are mirror images, so the edges of one, doubled, are the whole boundary; only the real
part is left, in which nothing cancels as nu goes to 0. In a collection each cut edge carries the
weight of its element times the conjugate of that of the piece, and cosines appear: (W2). Several
waves on the elements are several frequencies: (I2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from polywigner.kernels.cut.cells import clipper_for
from polywigner.kernels.cut.clipping import MIRRORED, Clipper, RowClipper, times, total_extent
from polywigner.kernels.functions.stokes import moved_off_zero, segment_wave
from polywigner.kernels.outline.tables import Edge, Tables
from polywigner.kernels.outline.waves import Beat, RowBeat, mean_beats, rows_of
from polywigner.numerics.trigonometry import sin_turns

__all__ = ["floored", "kept_off_zero", "lag_slice_area", "ratio_along", "wigner"]

Cuts = Sequence[tuple[Any, Any, Any, Any]]


def wigner(ops: Any, tables: Tables, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Any:
    """W(x, nu) in the units of the frame, for arguments in it: docs/theory.md, (W1), (W2), (I2)."""
    clipper = clipper_for(ops, tables, 2.0 * x, 2.0 * y, MIRRORED)
    groups = [k for k in range(len(tables.groups)) if clipper.edges_of(k)]
    if isinstance(clipper, RowClipper) and tables.waves_per_cut > 1:
        return _sum_over_rows(tables, clipper, groups, (x, y), (nu_x, nu_y))
    total: Any = 0.0
    for group in groups:
        beats = _beats_with(group, tables, clipper, (nu_x, nu_y))

        def term(edge: Edge, beats: Any = beats) -> tuple[Any, ...]:
            values: list[Any] = []
            for other, found in beats:
                cuts = list(clipper.intervals(edge, MIRRORED, other))
                for beat in found:
                    values += beat.terms(edge, cuts)
            return tuple(values)

        flat = [beat for _, found in beats for beat in found]
        sums = iter(clipper.sum_over_edges(term, sum(beat.values for beat in flat), group))
        for beat in flat:
            total = total + beat.value([next(sums) for _ in range(beat.values)], (x, y))
    return total


def _beats_with(
    group: int, tables: Tables, clipper: Clipper, nu: tuple[Any, Any]
) -> list[tuple[int, list[_EvenBeat | _PhasedBeat]]]:
    """For each group of pieces, what its waves beat with those of a group of edges."""
    result = []
    for other, waves in enumerate(tables.groups):
        found = mean_beats(tables.groups[group], waves)
        even = group == other and not tables.phased
        kind = _EvenBeat if even else _PhasedBeat
        result.append((other, [kind(clipper, beat, nu) for beat in found]))
    return result


def _sum_over_rows(
    tables: Tables,
    clipper: RowClipper,
    groups: Sequence[int],
    position: tuple[Any, Any],
    nu: tuple[Any, Any],
) -> Any:
    """The same with pairs of waves as rows of a table as well: little code, cut once for each."""
    total: Any = 0.0
    for group in groups:
        for other, waves in enumerate(tables.groups):
            beats = mean_beats(tables.groups[group], waves)
            is_real = beats[0].is_real

            def term(edge: Edge, *row: Any, other: int = other, is_real: bool = is_real) -> Any:
                beat = _PhasedBeat(clipper, RowBeat(is_real, *row), nu)
                sums = beat.terms(edge, list(clipper.intervals(edge, MIRRORED, other)))
                return (beat.value(sums, position),)

            (part,) = clipper.sum_over_pairs(term, 1, group, rows_of(beats))
            total = total + part
    return total


class _EvenBeat:
    """The sum over edges for real weights, which is even in the frequency: (W1)."""

    values = 1

    def __init__(self, clipper: Clipper, beat: Beat, nu: tuple[Any, Any]) -> None:
        self.clipper, self.ops, self.beat = clipper, clipper.ops, beat
        self.nu_x, self.nu_y = floored(self.ops, *beat.detuned(nu))
        self.nu_t = self.ops.fma(self.nu_x, clipper.tx, self.nu_y * clipper.ty)

    def terms(self, edge: Edge, cuts: Cuts) -> tuple[Any]:
        ops, nu_x, nu_y = self.ops, self.nu_x, self.nu_y
        along, ratio = self.clipper.shared(
            edge, lambda: ratio_along(ops, nu_x, nu_y, edge.ux, edge.uy), self.beat.shift
        )
        q = along * edge.length
        start = ops.fma(nu_x, 2 * edge.ax, ops.fma(nu_y, 2 * edge.ay, -self.nu_t))
        total: Any = None
        for middle, extent, mutual, _ in cuts:
            size = times(mutual, sin_turns(ops, extent * q))
            phase = sin_turns(ops, ops.fma(middle, q, start))
            total = size * phase if total is None else ops.fma(size, phase, total)
        return (0.0 if total is None else ratio * total,)

    def value(self, sums: Sequence[Any], position: tuple[Any, Any]) -> Any:
        square = self.ops.fma(self.nu_x, self.nu_x, self.nu_y * self.nu_y)
        amplitude, _ = self.beat.amplitude(self.ops, position)
        return times(amplitude, sums[0] / (math.pi**2 * square))


class _PhasedBeat:
    """The sum over edges for complex weights, which is not even: (W2).

    Cosines count as well. They sum to zero at nu = 0, so that cos - 1 stands for cos.
    """

    def __init__(self, clipper: Clipper, beat: Beat | RowBeat, nu: tuple[Any, Any]) -> None:
        self.ops, self.beat = clipper.ops, beat
        self.nu_x, self.nu_y = moved_off_zero(self.ops, *beat.detuned(nu))
        self.nu_t = self.ops.fma(self.nu_x, clipper.tx, self.nu_y * clipper.ty)
        self.values = 1 if beat.is_real else 2

    def terms(self, edge: Edge, cuts: Cuts) -> tuple[Any, ...]:
        ops, nu_x, nu_y = self.ops, self.nu_x, self.nu_y
        q = ops.fma(nu_x, edge.ex, nu_y * edge.ey)
        c = ops.fma(nu_x, edge.ey, nu_y * -edge.ex)
        start = ops.fma(nu_x, 2 * edge.ax, ops.fma(nu_y, 2 * edge.ay, -self.nu_t))
        first: Any = 0.0
        second: Any = 0.0
        for middle, extent, real, imag in cuts:
            sine, cosine = segment_wave(ops, 2.0 * extent * q, ops.fma(middle, q, start))
            first = ops.fma(extent, real * sine - imag * cosine, first)
            if self.values == 2:
                second = ops.fma(extent, real * cosine + imag * sine, second)
        return (c * first, c * second) if self.values == 2 else (c * first,)

    def value(self, sums: Sequence[Any], position: tuple[Any, Any]) -> Any:
        square = self.ops.fma(self.nu_x, self.nu_x, self.nu_y * self.nu_y)
        real, imag = self.beat.amplitude(self.ops, position)
        total = times(real, sums[0])
        if self.values == 2:
            total = total - imag * sums[1]
        return total * (2.0 / (math.pi * square))


def floored(ops: Any, nu_x: Any, nu_y: Any) -> tuple[Any, Any]:
    """nu, moved off 0 by so little that W, even in nu, changes by less than rounding."""
    floor = 1e-9 if ops.double else 1e-6
    tiny = (abs(nu_x) < floor) & (abs(nu_y) < floor)  # false if either is not a number
    return ops.select(tiny, floor, nu_x), ops.select(tiny, 0.0, nu_y)


def ratio_along(ops: Any, nu_x: Any, nu_y: Any, ux: Any, uy: Any) -> tuple[Any, Any]:
    """nu.u, kept off 0, and cross(nu, u)/(nu.u)."""
    along, across = kept_off_zero(ops, nu_x, nu_y, ux, uy)
    return along, across / along


def kept_off_zero(ops: Any, nu_x: Any, nu_y: Any, ux: Any, uy: Any) -> tuple[Any, Any]:
    """nu.u, kept off 0, and cross(nu, u)."""
    # Its square is a normal number: lanes that wait for others in a loop have q = 0, and processors
    # take a hundred times as long for subnormal ones.
    floor = 1e-30 if ops.double else 1e-18
    along = ops.fma(nu_x, ux, nu_y * uy)
    along = ops.select(abs(along) < floor, floor, along)
    return along, ops.fma(nu_x, uy, nu_y * -ux)


def lag_slice_area(ops: Any, tables: Tables, x: Any, y: Any) -> Any:
    """R_x(x) of elements without illumination: the area of the lag slice, in the frame."""
    clipper = clipper_for(ops, tables, 2.0 * x, 2.0 * y, MIRRORED)

    def term(edge: Edge) -> tuple[Any]:
        lever = ops.fma(
            clipper.ty, 2.0 * edge.ex, ops.fma(clipper.tx, -2.0 * edge.ey, 4.0 * edge.area)
        )
        # the imaginary parts of two elements and of the same two the other way round cancel
        return (lever * total_extent(clipper, edge, MIRRORED)[0],)

    (total,) = clipper.sum_over_edges(term, values=1)
    return total
