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
from dataclasses import dataclass
from typing import Any, Protocol

from polywigner.kernels.functions.stokes import moved_off_zero
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns
from polywigner.numerics.polynomials import segment_moments

__all__ = ["Axes", "GradientAccumulator", "Segment", "Slopes", "Wanted", "times_i"]


@dataclass(frozen=True)
class Wanted:
    """Which derivatives an accumulator is to have."""

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
    """Takes derivatives with respect to what samples have in common.

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
    """Derivatives of a complex value V with respect to what each sample has of its own."""

    frequency: list[Pair]
    place: list[Pair]
    shared: list[Any]
    """The sums of what an accumulator has returned."""


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
