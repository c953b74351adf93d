"""Derivatives of F, W and A in frequency, position or lag, vertices, and fields, in closed form.

All three are integrals of a plane wave over a polygon, the outline itself or a slice, with sides
that are parts of the outline's edges. If its boundary moves, such an integral changes by what the
wave is along it; so the derivatives in vertices, positions and lags are, like the functions
themselves, sums over the cut edges: docs/gradients.md, (G1) to (G4). Where the edges are cut does
not matter to first order. Derivatives in frequency are first moments of the slice, (G4); nothing is
divided by a frequency.

Where corners of a slice meet edges there is no derivative, but one for each side. What is found
there is the derivative on the side to which ties are decided (docs/theory.md, "Where edges
coincide"): a continuous extension from there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

from polywigner.geometry import Slits
from polywigner.kernels.cut.clipping import AHEAD, Clipper, View
from polywigner.kernels.cut.winding import PairClipper
from polywigner.kernels.functions import plane
from polywigner.kernels.functions.edge_terms import moved_off_zero
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.functions.slices import Views, difference_pairings, mean_pairings
from polywigner.kernels.kernel import Kernel
from polywigner.kernels.outline.constants import Edge
from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.outline.wave_pairs import (
    Wave,
    WavePair,
    Waves,
    difference_pairs,
    field_of,
    mean_pairs,
)
from polywigner.numerics.complex_pairs import Pair, unit_wave
from polywigner.numerics.phases import cos_sin_turns
from polywigner.numerics.polynomials import segment_moments

_ZERO = Pair(0.0, 0.0)


@dataclass(frozen=True)
class Wanted:
    """Kinds of shared numbers whose derivatives an accumulator takes.

    An accumulator has ``wanted``, ``has_constant_numbers`` (whether numbers of vertices have to be
    constants), and two methods: ``edge(begin, end, normal, at)`` for an edge between two numbered
    vertices, with dV = sum_k at_k (normal . d vertex_k), to be summed over edges; and
    ``field(number, slope, of_conjugate)`` for a weight or amplitude c, with dV = slope dc +
    of_conjugate dc*.
    """

    vertices: bool = False
    weights: bool = False
    """Weights of the elements."""
    amplitudes: bool = False
    """Amplitudes of the waves on the only element."""


@dataclass
class Slopes:
    """Derivatives of a complex value V in the numbers of each sample."""

    frequency: list[Pair]
    place: list[Pair]
    shared: Pair
    """Sum of the values that an accumulator has returned."""


@dataclass(frozen=True)
class Segment:
    """A part of an edge: along the frequency and across, middle p, q and extent dp, dq.

    ``means``: of 1, t and t^2 times exp(-2 pi i nu.x) along it, for t from -1/2 to 1/2.
    """

    p: Any
    q: Any
    dp: Any
    dq: Any
    means: tuple[Pair, Pair, Pair]

    def area(self, ops: Any) -> Pair:
        """Its term of M00, the integral of the wave over the polygon, over -dp: (G4)."""
        e0, e1, _ = self.means
        return e1.scaled(self.dq).plus(ops, e0, self.q)

    def moments(self, ops: Any) -> tuple[Pair, Pair]:
        """Its terms of M10 and 2 M01, of p and 2 q times the wave, over -dp: (G4)."""
        _, e1, e2 = self.means
        first = self.area(ops)
        second = e2.scaled(self.dq).plus(ops, e1, self.q)  # of q t times the wave
        along = second.scaled(self.dp).plus(ops, first, self.p)
        across = second.scaled(self.dq).plus(ops, first, self.q)
        return along, across


class Axes:
    """Coordinates along a frequency and across."""

    def __init__(self, ops: Any, nu: tuple[Any, Any]) -> None:
        self.ops = ops
        x, y = moved_off_zero(ops, *nu)
        self.norm = ops.sqrt(ops.fma(x, x, y * y))
        self.half = 0.5 * self.norm
        inverse = 1.0 / self.norm
        self.along = x * inverse, y * inverse

    def of(self, x: Any, y: Any) -> tuple[Any, Any]:
        """A vector along the frequency and across, (p, q)."""
        c, s = self.along
        return self.ops.fma(c, x, s * y), self.ops.fma(c, y, -s * x)

    def segment(self, p: Any, q: Any, dp: Any, dq: Any) -> Segment:
        """A segment with the middle (p, q) and the extent (dp, dq)."""
        cosine, sine = cos_sin_turns(self.ops, self.norm * p)
        e0, e1, e2 = segment_moments(self.ops, self.half * dp)
        wave = Pair(cosine, -sine)
        means = wave.scaled(e0), Pair(sine * e1, cosine * e1), wave.scaled(e2)
        return Segment(p, q, dp, dq, means)

    def gradient(self, along: Pair, twice_across: Pair) -> tuple[Pair, Pair]:
        """The derivative in nu, -2 pi i M, from the moments M in these coordinates."""
        (c, s), across = self.along, twice_across.scaled(0.5)
        x = along.scaled(c) - across.scaled(s)
        y = along.scaled(s) + across.scaled(c)
        x, y = x.scaled(-2 * math.pi), y.scaled(-2 * math.pi)
        return Pair(-x.imag, x.real), Pair(-y.imag, y.real)


# ---- F ---------------------------------------------------------------------------------------


def fourier_slopes(
    ops: Any, tables: OutlineTables, accumulator: Any, nu_x: Any, nu_y: Any
) -> Slopes:
    """Derivatives of V = F(nu) in the frame."""
    axes = Axes(ops, (nu_x, nu_y))
    rows = [
        (*edge[:4], float(begin), float(end))
        for begin, (edge, end) in enumerate(zip(tables.edges, tables.following, strict=True))
    ]

    def term(ax: Any, ay: Any, bx: Any, by: Any, begin: Any, end: Any) -> tuple[Any, ...]:
        ex, ey = bx - ax, by - ay
        segment = axes.segment(*axes.of(0.5 * (ax + bx), 0.5 * (ay + by)), *axes.of(ex, ey))
        along, across = (pair.scaled(-segment.dp) for pair in segment.moments(ops))
        e0, e1, _ = segment.means
        shared = _ZERO
        if accumulator.wanted.vertices:
            at = e0.scaled(0.5) - e1, e0.scaled(0.5) + e1
            shared = accumulator.edge(begin, end, (ey, -ex), at)
        return _parts(along, across, shared)

    along, across, shared = _pairs(ops.sum_over(rows, term, 6, like=nu_x))
    return Slopes(list(axes.gradient(along, across)), [_ZERO, _ZERO], shared)


def _parts(*pairs: Pair) -> tuple[Any, ...]:
    return tuple(part for pair in pairs for part in (pair.real, pair.imag))


def _pairs(numbers: Sequence[Any]) -> list[Pair]:
    return list(map(Pair, numbers[0::2], numbers[1::2]))


# ---- W and A ---------------------------------------------------------------------------------


def wigner_slopes(ops: Any, tables: Tables, accumulator: Any, *point: Any) -> Slopes:
    """Derivatives of W, the real part of V, at (x, y, nu_x, nu_y) in the frame."""
    return _slopes(ops, tables, True, accumulator, point[:2], point[2:])


def ambiguity_slopes(ops: Any, tables: Tables, accumulator: Any, *point: Any) -> Slopes:
    """Derivatives of V = A at (upsilon_x, upsilon_y, xi_x, xi_y) in the frame."""
    return _slopes(ops, tables, False, accumulator, point[2:], point[:2])


def _slopes(
    ops: Any,
    tables: Tables,
    of_lags: bool,
    accumulator: Any,
    place: tuple[Any, ...],
    frequency: tuple[Any, ...],
) -> Slopes:
    """``of_lags``: of the lag slice, else of the position slice."""
    weights = [Pair(1.0, 0.0)] * len(tables.groups)
    if accumulator.wanted.weights:
        weights, tables = _weights(ops, tables), tables.by_element
    pairings, scale = (mean_pairings, 2.0) if of_lags else (difference_pairings, 1.0)
    views = dict.fromkeys(view for *_, seen, _ in pairings(tables) for view, _ in seen)
    tx, ty = (scale * c for c in place)
    if accumulator.has_constant_numbers or (ops.target == "compiled" and tables.fits_code):
        clipper = Clipper(ops, tables, tx, ty)
    else:
        clipper = PairClipper(ops, tables, tx, ty, tuple(views))
    result = Slopes([_ZERO, _ZERO], [_ZERO, _ZERO], _ZERO)
    for group in range(len(tables.groups)):
        areas: list[Pair] = []
        for other in range(len(tables.groups)):
            beats = [
                _PairSlopes(clipper, accumulator, scale, views, beat, frequency, place).between(
                    group, other, weights
                )
                for own, number, views, found in pairings(tables)
                for beat in found
                if (own, number) == (group, other)
            ]

            def term(edge: Edge, beats: Any = beats, other: int = other) -> tuple[Any, ...]:
                cuts: dict[View, Any] = {}
                pairs: list[Pair] = []
                shared = _ZERO
                for beat in beats:
                    for view, _ in beat.views:
                        if view not in cuts:
                            cuts[view] = list(clipper.intervals(edge, view, other))
                    found, of_shared = beat.terms(edge, cuts)
                    pairs += found
                    shared = shared + of_shared
                return _parts(*pairs, shared)

            count = 2 * (_PairSlopes.pairs * len(beats) + 1)
            sums = iter(_pairs(clipper.sum_over_edges(term, count, group, other)))
            areas += [beat.add([next(sums) for _ in range(beat.pairs)], result) for beat in beats]
            result.shared = result.shared + next(sums)
        if accumulator.wanted.amplitudes:
            _wave_slopes(ops, tables, of_lags, accumulator, place, result, areas)
    return result


def _weights(ops: Any, tables: Tables) -> list[Pair]:
    """Return the weights of the elements, as data where edges are."""
    parts = [[part(w) for w in tables.weights] for part in (lambda w: w.real, lambda w: w.imag)]
    if ops.target != "data":
        return list(map(Pair, *parts))
    return [Pair(*(ops.lookup(part, k) for part in parts)) for k in range(len(tables.weights))]


class _PairSlopes:
    """Derivatives of the contribution of all pairs of waves with one shift of the frequency.

    V is ``scale`` times the sum over the views: of W the edges of one copy are half the boundary,
    those of the other give the conjugate.
    """

    pairs = 5

    def __init__(
        self,
        clipper: Clipper,
        accumulator: Any,
        scale: float,
        views: Views,
        beat: WavePair,
        frequency: tuple[Any, ...],
        place: tuple[Any, ...],
    ) -> None:
        self.clipper, self.ops, self.accumulator = clipper, clipper.ops, accumulator
        self.scale, self.views, self.beat = scale, views, beat
        self.axes = Axes(self.ops, beat.detuned(frequency))
        self.amplitude = Pair(*beat.amplitude(self.ops, place))
        self.rates = [Pair(*slope) for slope in beat.slopes(self.ops, place)]
        self.elements: tuple[tuple[int, Pair], ...] = ()
        self.mutual = Pair(1.0, 0.0)

    def between(self, group: int, other: int, weights: Sequence[Any]) -> _PairSlopes:
        """Return the same for edges of a group and pieces of another, weights of both included."""
        first, second = (other, group) if self.views[0][0] is AHEAD else (group, other)
        one, two = (weights[k] for k in (first, second))
        self.elements = (first, one), (second, two)
        self.mutual = one * two.conjugate()
        return self

    def terms(self, edge: Edge, cuts: dict[View, Any]) -> tuple[list[Pair], Pair]:
        """Area, the boundary's push on T, and moments; the sum for the accumulator."""
        ops, scale = self.ops, self.scale
        area, push, along, across, begin, end = [_ZERO] * 6
        long = scale * edge.length
        along_unit, across_unit = self.clipper.shared(
            edge, lambda: self.axes.of(edge.ux, edge.uy), self.beat.shift
        )
        for view, half_side in self.views:
            side = scale * half_side
            start = self.axes.of(
                ops.fma(self.clipper.tx, side, scale * edge.ax),
                ops.fma(self.clipper.ty, side, scale * edge.ay),
            )
            for middle, extent, real, imag in cuts[view]:
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
                area = area.plus(ops, _weighted(segment.area(ops), real, imag), base)
                first, second = segment.moments(ops)
                along = along.plus(ops, _weighted(first, real, imag), base)
                across = across.plus(ops, _weighted(second, real, imag), base)
                e0, e1, _ = segment.means
                e0 = _weighted(e0, real, imag).scaled(extent)
                e1 = _weighted(e1, real, imag).scaled(extent * extent)
                push = push + e0.scaled(side)
                to_end = e1.plus(ops, e0, 0.5 * middle)
                begin, end = begin + (e0 - to_end), end + to_end
        shared = _ZERO
        if self.accumulator.wanted.vertices:
            factor = (self.amplitude * self.mutual).scaled(scale**3)
            at = begin * factor, end * factor
            shared = self.accumulator.edge(edge.begin, edge.end, (edge.ey, -edge.ex), at)
        pushes = push.scaled(scale * edge.ey), push.scaled(-scale * edge.ex)
        return [area, *pushes, along, across], shared

    def add(self, sums: Sequence[Pair], result: Slopes) -> Pair:
        """Add the sums over edges to the derivatives; the integral over the slice."""
        area, *pushes, along, across = sums
        amplitude = self.amplitude * self.mutual
        for k, push in enumerate(pushes):
            moved = (push * amplitude).scaled(self.scale) + area * self.rates[k] * self.mutual
            result.place[k] = result.place[k] + moved.scaled(self.scale)
        for k, slope in enumerate(self.axes.gradient(along, across)):
            result.frequency[k] = result.frequency[k] + (slope * amplitude).scaled(self.scale)
        if self.accumulator.wanted.weights:
            value, ((first, one), (second, two)) = area.scaled(self.scale), self.elements
            value = value * self.amplitude
            found = self.accumulator.field(first, value * two.conjugate(), _ZERO)
            found = found + self.accumulator.field(second, _ZERO, value * one)
            result.shared = result.shared + found
        return area.scaled(self.scale)


def _weighted(value: Pair, real: Any, imag: Any) -> Pair:
    if isinstance(imag, float) and imag == 0.0:
        return value if isinstance(real, float) and real == 1.0 else value.scaled(real)
    return value * Pair(real, imag)


def _wave_slopes(
    ops: Any,
    tables: Tables,
    of_lags: bool,
    accumulator: Any,
    place: Sequence[Any],
    result: Slopes,
    areas: Sequence[Pair],
) -> None:
    """Tell the accumulator the derivatives in the amplitudes of the only element's waves."""
    waves = tables.groups[0]
    pairs_of = partial(mean_pairs, is_same=False) if of_lags else difference_pairs
    beats = mean_pairs(waves, waves, True) if of_lags else difference_pairs(waves, waves)
    for (m, one), (n, other) in product(enumerate(waves), repeat=2):
        (pair,) = pairs_of((one,), (other,))
        ((_, rate),) = pair.terms
        beat = min(range(len(beats)), key=lambda k: math.dist(beats[k].shift, pair.shift))
        area = areas[beat]
        if of_lags:  # real: the sum over both copies' edges, half of which is the real part
            area = Pair(area.real, 0.0)
        value = area * Pair(*field_of(ops, (Wave(1.0, rate),), place))
        first, second = complex(one.amplitude), complex(other.amplitude)
        by_first = value * Pair(second.real, -second.imag)
        found = accumulator.field(m, by_first, _ZERO)
        found = found + accumulator.field(n, _ZERO, value * Pair(first.real, first.imag))
        result.shared = result.shared + found


@dataclass(frozen=True)
class SlopeKernel:
    """Derivatives of the sum over edges of a kernel."""

    slopes: Callable[..., Slopes]
    """(ops, tables, accumulator, *arguments in the frame)."""
    arguments: int
    """Number of arguments in the frame that it takes, counted from the last."""
    parts: Callable[[Pair], tuple[Any, ...]]
    """(V) -> the kernel's sums."""
    points: tuple[str, ...]
    """The kernel's points: ``"frequency"``, ``"place"``."""

    def changed(self, ops: Any, frame: Any, found: Slopes, change: Sequence[Any]) -> Pair:
        """Return the change of V for changes of all components of all points."""
        total = found.shared
        for number, name in enumerate(self.points):
            pair = change[2 * number : 2 * number + 2]
            own = change if len(self.points) == 1 else pair  # frequencies in space have three
            in_frame = (frame.frequency if name == "frequency" else frame.vector)(ops, *own)
            for slope, part in zip(getattr(found, name), in_frame, strict=True):
                total = total + slope.scaled(part)
        return total


def _wave(value: Pair) -> tuple[Any, ...]:
    """(cosine, sine) of V = cosine - i sine."""
    return value.real, -value.imag


def _real(value: Pair) -> tuple[Any, ...]:
    return (value.real,)


_FOURIER = SlopeKernel(fourier_slopes, 2, _wave, ("frequency",))
_KNOWN = {
    plane.WIGNER: SlopeKernel(wigner_slopes, 4, _real, ("place", "frequency")),
    plane.AMBIGUITY: SlopeKernel(ambiguity_slopes, 4, _wave, ("frequency", "place")),
    plane.FOURIER: _FOURIER,
    plane.FOURIER_PLACED: _FOURIER,
}


def slope_kernel_of(kernel: Kernel) -> SlopeKernel | None:
    """The derivatives of a kernel, or None if they are Dr.Jit's to find."""
    return _KNOWN.get(kernel)


# ---- slits -----------------------------------------------------------------------------------


def slopes_in_ends(ops: Any, name: str, source: Slits, *points: Any) -> list[tuple[Pair, Pair]]:
    """Derivatives of F, W or A (``name``) in the begin and in the end of each slit.

    ``points``: nu; x and nu; upsilon and xi. ``ops``: in double precision, whatever they are.
    """
    field = _Field(ops, source)
    slope = getattr(field, name)
    return [
        (slope(begin, *points).scaled(-1.0), slope(end, *points))
        for begin, end in source.intervals.tolist()
    ]


class _Field:
    """The field on slits, and derivatives of its transforms in the ends of a slit."""

    def __init__(self, ops: Any, source: Slits) -> None:
        self.ops, self.rows = ops, [tuple(row) for row in source.intervals.tolist()]
        self.waves: Waves = (Wave(1.0, (0.0,)),)
        lit = source.illumination
        if lit is not None:
            pairs = zip(lit.amplitudes.tolist(), lit.frequencies.tolist(), strict=True)
            self.waves = tuple(Wave(a, tuple(f)) for a, f in pairs)

    def inner(self, y: Any) -> Pair:
        """The waves at a place, inside a slit or not."""
        return Pair(*field_of(self.ops, self.waves, (y,)))

    def at(self, y: Any) -> Pair:
        """u, which a slit has at its begin and not at its end."""

        def term(begin: Any, end: Any) -> tuple[Any]:
            return (self.ops.select((y >= begin) & (y < end), 1.0, 0.0),)

        (inside,) = self.ops.sum_over(self.rows, term, 1, like=y)
        return self.inner(y).scaled(inside)

    def fourier(self, end: float, nu: Any) -> Pair:
        return self.inner(end) * unit_wave(self.ops, -nu * end)

    def wigner(self, end: float, x: Any, nu: Any) -> Pair:
        """Twice the real part of one copy's contribution, at the lag 2(end - x)."""
        product = self.inner(end) * self.at(2.0 * x - end).conjugate()
        return Pair((product * unit_wave(self.ops, 2.0 * (x - end) * nu)).real * 4.0, 0.0)

    def ambiguity(self, end: float, upsilon: Any, xi: Any) -> Pair:
        own = self.inner(end)
        ahead, behind = (unit_wave(self.ops, upsilon * (s * xi - end)) for s in (0.5, -0.5))
        first = own * self.at(end - xi).conjugate() * ahead
        return first + self.at(end + xi) * own.conjugate() * behind
