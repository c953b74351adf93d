"""Derivatives of F, W and A in frequency, position or lag, vertices, and fields, in closed form.

All three are integrals of a plane wave over a polygon, the outline itself or a slice, with sides
that are parts of the outline's edges. If its boundary moves, such an integral changes by what the
wave is along it; so the derivatives in vertices, positions and lags are, like the functions
themselves, sums over the cut edges: docs/gradients.md, (G1) to (G4). Where the edges are cut does
not matter to first order. Derivatives in frequency are first moments of the slice, with the formula
of :mod:`polywigner.kernels.functions.moments`; nothing is divided by a frequency.

Where corners of a slice meet edges there is no derivative, but one for each side. What is found
there is the derivative on the side to which ties are decided (docs/theory.md, "Where edges
coincide"): a continuous extension from there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from polywigner.geometry import Slits
from polywigner.kernels.functions.edge_terms import moved_off_zero
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.outline.waves import Wave, Waves, field_of
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns
from polywigner.numerics.polynomials import segment_moments


@dataclass(frozen=True)
class Wanted:
    """Kinds of derivatives that an accumulator takes."""

    vertices: bool = False
    weights: bool = False
    """Weights of the elements."""
    amplitudes: bool = False
    """Amplitudes of the waves on the only element."""

    @property
    def fields(self) -> bool:
        """Whether weights or amplitudes are among them."""
        return self.weights or self.amplitudes


class GradientAccumulator(Protocol):
    """Takes derivatives in numbers that all samples share.

    Methods return what is to be summed over the edges, the same number of values each time.
    """

    wanted: Wanted
    values: int

    def edge(self, begin: Any, end: Any, normal: tuple[Any, Any], at: tuple[Pair, Pair]) -> Any:
        """An edge between two numbered vertices: dV = sum_k at_k (normal . d vertex_k)."""

    def field(self, number: Any, slope: Pair, of_conjugate: Pair) -> Any:
        """A weight or an amplitude c: dV = slope dc + of_conjugate dc*."""


@dataclass
class Slopes:
    """Derivatives of a complex value V in the numbers of each sample."""

    frequency: list[Pair]
    place: list[Pair]
    shared: list[Any]
    """Sums of the values that an accumulator has returned."""


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
        """Its term of M00, the integral of the wave over the polygon, over -dp: (T3)."""
        e0, e1, _ = self.means
        return e1.scaled(self.dq).plus(ops, e0, self.q)

    def moments(self, ops: Any) -> tuple[Pair, Pair]:
        """Its terms of M10 and 2 M01, of p and 2 q times the wave, over -dp: (T3)."""
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
        e0, e1, e2 = segment_moments(self.ops, self.half * dp, 2)
        wave = Pair(cosine, -sine)
        means = wave.scaled(e0), Pair(sine * e1, cosine * e1), wave.scaled(e2)
        return Segment(p, q, dp, dq, means)

    def gradient(self, along: Pair, across: Pair) -> tuple[Pair, Pair]:
        """The derivative in nu, -2 pi i M, from the moments M in these coordinates."""
        c, s = self.along
        x = along.scaled(c) - across.scaled(s)
        y = along.scaled(s) + across.scaled(c)
        return times_i(x.scaled(-2 * math.pi)), times_i(y.scaled(-2 * math.pi))


def times_i(value: Pair) -> Pair:
    """i value."""
    return Pair(-value.imag, value.real)


def fourier_slopes(
    ops: Any, tables: OutlineTables, accumulator: GradientAccumulator, nu_x: Any, nu_y: Any
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
        shared: Any = (0.0,) * accumulator.values
        if accumulator.wanted.vertices:
            at = e0.scaled(0.5) - e1, e0.scaled(0.5) + e1
            shared = accumulator.edge(begin, end, (ey, -ex), at)
        return (along.real, along.imag, across.real, across.imag, *shared)

    sums = ops.sum_over(rows, term, 4 + accumulator.values, like=nu_x)
    zero = Pair(0.0, 0.0)
    frequency = axes.gradient(Pair(*sums[:2]), Pair(*sums[2:4]).scaled(0.5))
    return Slopes(list(frequency), [zero, zero], list(sums[4:]))


def slopes_in_ends(ops: Any, name: str, source: Slits, *points: Any) -> list[tuple[Pair, Pair]]:
    """Derivatives of F, W or A (``name``) in the begin and in the end of each slit.

    ``points``: nu; x and nu; upsilon and xi. ``ops``: in double precision, whatever they are.
    """
    field = _Field(ops, source)
    known: dict[str, Callable[..., Pair]] = {
        "fourier": _of_f,
        "wigner": _of_w,
        "ambiguity": _of_a,
    }
    slope = known[name]
    return [
        (slope(field, begin, *points).scaled(-1.0), slope(field, end, *points))
        for begin, end in source.intervals.tolist()
    ]


class _Field:
    def __init__(self, ops: Any, source: Slits) -> None:
        self.ops, self.rows = ops, [tuple(row) for row in source.intervals.tolist()]
        self.waves: Waves = (Wave(1.0, (0.0,)),)
        if source.illumination is not None:
            amplitudes, frequencies = (
                source.illumination.amplitudes,
                source.illumination.frequencies,
            )
            pairs = zip(amplitudes.tolist(), frequencies.tolist(), strict=True)
            self.waves = tuple(Wave(a, tuple(f)) for a, f in pairs)

    def inner(self, y: Any) -> Pair:
        """The waves at a place, inside a slit or not."""
        return Pair(*field_of(self.ops, self.waves, (y,)))

    def at(self, y: Any) -> Pair:
        """u, which a slit has at its begin and not at its end."""
        ops = self.ops

        def term(begin: Any, end: Any) -> tuple[Any]:
            return (ops.select((y >= begin) & (y < end), 1.0, 0.0),)

        (inside,) = ops.sum_over(self.rows, term, 1, like=y)
        return self.inner(y).scaled(inside)

    def wave(self, turns: Any) -> Pair:
        """exp(-2 pi i turns)."""
        cosine, sine = cos_sin_turns(self.ops, turns)
        return Pair(cosine, -sine)


def _of_f(field: _Field, end: float, nu: Any) -> Pair:
    return field.inner(end) * field.wave(nu * end)


def _of_w(field: _Field, end: float, x: Any, nu: Any) -> Pair:
    """Twice the real part of one copy's contribution, at the lag 2(end - x)."""
    product = field.inner(end) * _conjugate(field.at(2.0 * x - end))
    return Pair((product * field.wave(2.0 * (end - x) * nu)).real * 4.0, 0.0)


def _of_a(field: _Field, end: float, upsilon: Any, xi: Any) -> Pair:
    own = field.inner(end)
    ahead = own * _conjugate(field.at(end - xi)) * field.wave(upsilon * (end - 0.5 * xi))
    behind = field.at(end + xi) * _conjugate(own) * field.wave(upsilon * (end + 0.5 * xi))
    return ahead + behind


def _conjugate(value: Pair) -> Pair:
    return Pair(value.real, -value.imag)
