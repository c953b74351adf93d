"""Derivatives of W and A: sums over cut edges. Source: docs/gradients.md, (G2) to (G4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from polywigner.kernels.cut.clipping import MIRRORED, Clipper, RowClipper, View
from polywigner.kernels.cut.winding import clipper_for
from polywigner.kernels.functions import plane
from polywigner.kernels.functions.slices import COPIES, Views, difference_pairings
from polywigner.kernels.kernel import Kernel
from polywigner.kernels.outline.tables import Edge, Piece, Tables
from polywigner.kernels.outline.waves import Wave, WavePair, difference_pairs, mean_pairs
from polywigner.kernels.slopes.slopes import (
    Axes,
    GradientAccumulator,
    Slopes,
    Wanted,
    fourier_slopes,
)
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns
from polywigner.plans import cut_for

_ZERO = Pair(0.0, 0.0)
_Pairings = Callable[[int, Tables], Iterator[tuple[int, Views, Sequence[WavePair]]]]


@dataclass(frozen=True)
class _Slices:
    """A slice as it is made of the outline. T is 2x or xi."""

    views: Views
    """Views in which edges are cut, each moved by its number times T."""
    scale: float
    """The scale of the outline in the slice."""
    factor: float
    """V is the sum over these views times this."""
    per_place: float
    """dT/dx or dT/dxi."""
    pairings: _Pairings


def _mean_pairings(group: int, tables: Tables) -> Iterator[tuple[int, Views, Sequence[WavePair]]]:
    for other, waves in enumerate(tables.groups):
        yield other, _LAG.views, mean_pairs(tables.groups[group], waves)


# Of W the edges of one copy are half the boundary, those of the other give the conjugate.
_LAG = _Slices(((MIRRORED, -1.0),), 2.0, 2.0, 2.0, _mean_pairings)
_POSITION = _Slices(COPIES, 1.0, 1.0, 1.0, difference_pairings)


def wigner_slopes(
    ops: Any, tables: Tables, accumulator: GradientAccumulator, *point: Any
) -> Slopes:
    """Derivatives of W, the real part of V, at (x, y, nu_x, nu_y) in the frame."""
    x, y, nu_x, nu_y = point
    return _slopes(ops, tables, _LAG, accumulator, (2.0 * x, 2.0 * y), (nu_x, nu_y))


def ambiguity_slopes(
    ops: Any, tables: Tables, accumulator: GradientAccumulator, *point: Any
) -> Slopes:
    """Derivatives of V = A at (upsilon_x, upsilon_y, xi_x, xi_y) in the frame."""
    v_x, v_y, xi_x, xi_y = point
    return _slopes(ops, tables, _POSITION, accumulator, (xi_x, xi_y), (v_x, v_y))


def _slopes(
    ops: Any,
    tables: Tables,
    slices: _Slices,
    accumulator: GradientAccumulator,
    shift: tuple[Any, Any],
    frequency: tuple[Any, Any],
) -> Slopes:
    clipper = _clipper(ops, tables, shift, accumulator.wanted, slices)
    place = tuple(component / slices.per_place for component in shift)
    result = Slopes([_ZERO, _ZERO], [_ZERO, _ZERO], [0.0] * accumulator.values)
    for group in range(len(tables.groups)):
        if not clipper.edges_of(group):
            continue
        areas: list[Pair] = []
        for other in range(len(tables.groups)):
            beats = [
                _PairSlopes(clipper, slices, accumulator, other, views, beat, (frequency, place))
                for number, views, found in slices.pairings(group, tables)
                for beat in found
                if number == other
            ]

            def term(edge: Edge, beats: Any = beats) -> tuple[Any, ...]:
                cuts: dict[Any, Any] = {}
                values: list[Any] = []
                shared: list[Any] = [0.0] * accumulator.values
                for beat in beats:
                    found, of_shared = beat.terms(edge, cuts)
                    values += found
                    shared = [a + b for a, b in zip(shared, of_shared, strict=True)]
                return (*values, *shared)

            count = sum(beat.values for beat in beats) + accumulator.values
            sums = iter(clipper.sum_over_edges(term, count, group, other))
            for beat in beats:
                areas.append(beat.add([next(sums) for _ in range(beat.values)], result))
            result.shared = [a + b for a, b in zip(result.shared, sums, strict=True)]
        if accumulator.wanted.amplitudes:
            _wave_slopes(ops, tables, slices, accumulator, place, result, areas)
    return result


def _clipper(
    ops: Any, tables: Tables, shift: tuple[Any, Any], wanted: Wanted, slices: _Slices
) -> Clipper:
    """Edges of elements by name where weights matter, as is best otherwise."""
    if not wanted.weights:
        return clipper_for(ops, tables, *shift, *(view for view, _ in slices.views))
    by_name = cut_for(ops.target, tables.clips, by_pairs=False)
    return (RowClipper if by_name == "rows" else Clipper)(ops, tables, *shift)


class _PairSlopes:
    """Derivatives of the contribution of all pairs of waves with one shift of the frequency."""

    def __init__(
        self,
        clipper: Clipper,
        slices: _Slices,
        accumulator: GradientAccumulator,
        other: int,
        views: Views,
        beat: WavePair,
        point: tuple[tuple[Any, Any], tuple[Any, Any]],
    ) -> None:
        self.clipper, self.ops, self.slices = clipper, clipper.ops, slices
        self.accumulator, self.other, self.views = accumulator, other, views
        self.beat = beat
        frequency, place = point
        self.axes = Axes(self.ops, beat.detuned(frequency))
        self.amplitude = Pair(*beat.amplitude(self.ops, place))
        self.rates = [Pair(*slope) for slope in beat.slopes(self.ops, place)]
        self.values = 10

    def terms(self, edge: Edge, cuts: dict[Any, Any]) -> tuple[list[Any], list[Any]]:
        """Area, the boundary's push on T, and moments, in ten numbers; sums for the accumulator."""
        ops, scale = self.ops, self.slices.scale
        area, push, along, across, begin, end = [_ZERO] * 6
        shared: list[Any] = [0.0] * self.accumulator.values
        long = scale * edge.length
        along_unit, across_unit = self.clipper.shared(
            edge, lambda: self.axes.of(edge.ux, edge.uy), self.beat.shift
        )
        for view, side in self.views:
            start = self.axes.of(
                ops.fma(self.clipper.tx, side, scale * edge.ax),
                ops.fma(self.clipper.ty, side, scale * edge.ay),
            )
            for piece, middle, extent, real, imag in self._cuts(edge, view, cuts):
                # What is left of an edge may be nothing in the far distance, whose powers overflow.
                middle = ops.select(extent == 0.0, 1.0, middle)
                half, whole = (0.5 * long) * middle, long * extent
                segment = self.axes.segment(
                    ops.fma(half, along_unit, start[0]),
                    ops.fma(half, across_unit, start[1]),
                    whole * along_unit,
                    whole * across_unit,
                )
                base = -segment.dp
                own = segment.area(ops)
                area = area.plus(ops, _weighted(own, real, imag), base)
                first, second = segment.moments(ops)
                along = along.plus(ops, _weighted(first, real, imag), base)
                across = across.plus(ops, _weighted(second, real, imag), base)
                e0, e1, _ = segment.means
                e0 = _weighted(e0, real, imag).scaled(extent)
                e1 = _weighted(e1, real, imag).scaled(extent * extent)
                push = push + e0.scaled(side)
                to_end = e1.plus(ops, e0, 0.5 * middle)
                begin, end = begin + (e0 - to_end), end + to_end
                if self.accumulator.wanted.weights:
                    found = self._fields(edge, piece, view, own.scaled(base))
                    shared = [a + b for a, b in zip(shared, found, strict=True)]
        if self.accumulator.wanted.vertices:
            factor = self.amplitude.scaled(self.slices.factor * scale**2)
            found = self.accumulator.edge(
                edge.begin, edge.end, (edge.ey, -edge.ex), (begin * factor, end * factor)
            )
            shared = [a + b for a, b in zip(shared, found, strict=True)]
        pushes = push.scaled(scale * edge.ey), push.scaled(-scale * edge.ex)
        pairs = (area, *pushes, along, across)
        return [part for pair in pairs for part in (pair.real, pair.imag)], shared

    def _cuts(self, edge: Edge, view: View, known: dict[Any, Any]) -> Any:
        key = view, self.other
        if key not in known:
            if self.accumulator.wanted.weights:
                known[key] = list(self._named_cuts(edge, view))
            else:
                found = self.clipper.intervals(edge, view, self.other)
                known[key] = [(None, *cut) for cut in found]
        return known[key]

    def _named_cuts(self, edge: Edge, view: View) -> Iterator[tuple[Any, ...]]:
        for piece, middle, extent in self.clipper.parts(edge, view, self.other):
            real, imag = self.clipper.tables.mutual(edge, piece)
            yield piece, middle, extent, real, -imag if _is_second(view) else imag

    def _fields(self, edge: Edge, piece: Piece, view: View, area: Pair) -> list[Any]:
        """Tell the accumulator: V has the term w_k w_l* times this, k the edge's element mostly."""
        value = (area * self.amplitude).scaled(self.slices.factor)
        of_edge, of_piece = Pair(edge.real, edge.imag), Pair(piece.real, piece.imag)
        to_edge = value * (of_piece if _is_second(view) else _conjugate(of_piece))
        of_edge = of_edge.scaled(piece.sign)
        to_piece = value * (_conjugate(of_edge) if _is_second(view) else of_edge)
        if _is_second(view):
            found = (
                self.accumulator.field(piece.element, to_piece, _ZERO),
                self.accumulator.field(edge.element, _ZERO, to_edge),
            )
        else:
            found = (
                self.accumulator.field(edge.element, to_edge, _ZERO),
                self.accumulator.field(piece.element, _ZERO, to_piece),
            )
        return [a + b for a, b in zip(*found, strict=True)]

    def add(self, sums: Sequence[Any], result: Slopes) -> Pair:
        """Add the sums over edges to the derivatives; the integral over the slice."""
        area, push_x, push_y, along, across = (
            Pair(sums[k], sums[k + 1]) for k in range(0, self.values, 2)
        )
        factor, slices = self.slices.factor, self.slices
        for k, moved in enumerate((push_x, push_y)):
            moved = (moved * self.amplitude).scaled(slices.per_place)
            moved = moved + area * self.rates[k]
            result.place[k] = result.place[k] + moved.scaled(factor)
        for k, slope in enumerate(self.axes.gradient(along, across.scaled(0.5))):
            result.frequency[k] = result.frequency[k] + (slope * self.amplitude).scaled(factor)
        return area.scaled(factor)


def _is_second(view: View) -> bool:
    """Whether an edge seen so is where the second factor of u u* ends."""
    return view.offset > 0 and view.point > 0


def _conjugate(value: Pair) -> Pair:
    return Pair(value.real, -value.imag)


def _weighted(value: Pair, real: Any, imag: Any) -> Pair:
    if isinstance(imag, float) and imag == 0.0:
        return value if isinstance(real, float) and real == 1.0 else value.scaled(real)
    return value * Pair(real, imag)


def _wave_slopes(
    ops: Any,
    tables: Tables,
    slices: _Slices,
    accumulator: GradientAccumulator,
    place: Sequence[Any],
    result: Slopes,
    areas: Sequence[Pair],
) -> None:
    """Tell the accumulator the derivatives in the amplitudes of the only element's waves."""
    waves = tables.groups[0]
    by_mean = slices is _LAG
    beats = (mean_pairs if by_mean else difference_pairs)(waves, waves)
    for m, one in enumerate(waves):
        for n, other in enumerate(waves):
            shift, rate = _mean(one, other), _difference(one, other)
            if not by_mean:
                shift, rate = rate, shift
            beat = min(range(len(beats)), key=lambda k: math.dist(beats[k].shift, shift))
            area = areas[beat]
            if by_mean:  # real: the sum over both copies' edges, half of which is the real part
                area = Pair(area.real, 0.0)
            value = area * _wave(ops, rate, place)
            first, second = complex(one.amplitude), complex(other.amplitude).conjugate()
            for number, slope, conjugate in (
                (m, value * Pair(second.real, second.imag), _ZERO),
                (n, _ZERO, value * Pair(first.real, first.imag)),
            ):
                found = accumulator.field(number, slope, conjugate)
                result.shared = [a + b for a, b in zip(result.shared, found, strict=True)]


def _mean(one: Wave, other: Wave) -> tuple[float, ...]:
    return tuple((a + b) / 2 for a, b in zip(one.frequency, other.frequency, strict=True))


def _difference(one: Wave, other: Wave) -> tuple[float, ...]:
    return tuple(a - b for a, b in zip(one.frequency, other.frequency, strict=True))


def _wave(ops: Any, rate: Sequence[float], place: Sequence[Any]) -> Pair:
    if not any(rate):
        return Pair(1.0, 0.0)
    turns = sum(f * p for f, p in zip(rate, place, strict=True))
    return Pair(*cos_sin_turns(ops, turns))


@dataclass(frozen=True)
class SlopeKernel:
    """Derivatives of the sum over edges of a kernel."""

    slopes: Callable[..., Slopes]
    """(ops, tables, accumulator, *arguments in the frame)."""
    arguments: int
    """Number of arguments in the frame that it takes, counted from the last."""
    frequency_leads: bool = True
    """Whether a frequency is the first argument, before a place if there is any."""
    has_place: bool = True
    is_wave: bool = True
    """Whether sums are (cosine, sine) of V = cosine - i sine; else the real part."""

    def parts(self, value: Pair) -> tuple[Any, ...]:
        """The kernel's sums of V."""
        return (value.real, -value.imag) if self.is_wave else (value.real,)

    def entered(self, ops: Any, frame: Any, change: Sequence[Any]) -> tuple[Any, ...]:
        """Changes of the arguments in the frame: of the frequency, then of the place."""
        if not self.has_place:
            return tuple(frame.frequency(ops, *change))
        first, second = change[:2], change[2:]
        frequency, place = (first, second) if self.frequency_leads else (second, first)
        return (*frame.frequency(ops, *frequency), *frame.vector(ops, *place))


_WIGNER = SlopeKernel(wigner_slopes, 4, frequency_leads=False, is_wave=False)
_AMBIGUITY = SlopeKernel(ambiguity_slopes, 4)
_FOURIER = SlopeKernel(fourier_slopes, 2, has_place=False)
_KNOWN = {
    plane.WIGNER: _WIGNER,
    plane.AMBIGUITY: _AMBIGUITY,
    plane.FOURIER: _FOURIER,
    plane.FOURIER_PLACED: _FOURIER,
}


def slope_kernel_of(kernel: Kernel) -> SlopeKernel | None:
    """The derivatives of a kernel, or None if they are Dr.Jit's to find."""
    return _KNOWN.get(kernel)
