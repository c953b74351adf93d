"""Closed-form gradients of the Fourier, Wigner and ambiguity functions F, W and A.

Each function is the integral of a plane wave over a polygon: the outline for F, a slice for W and
A. Derivatives with respect to vertices, positions and lags are integrals of the wave along the
moving boundary, (G1) to (G3) of docs/gradients.md. Derivatives with respect to frequency are first
moments of the polygon, (G4). If a corner of the source lies on an edge of the copy, the result is
the one-sided derivative that the tie rule selects (docs/theory.md, "Where edges coincide").
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from polywigner.kernels.cut.clipping import AHEAD, Clipper, Cuts, Edge
from polywigner.kernels.cut.winding import PairClipper
from polywigner.kernels.functions import plane
from polywigner.kernels.functions.edge_terms import moved_off_zero
from polywigner.kernels.functions.fourier import OutlineTables
from polywigner.kernels.functions.slices import Views, difference_pairings, mean_pairings
from polywigner.kernels.kernel import Kernel, wave_sums
from polywigner.kernels.outline import Tables
from polywigner.kernels.wave_pairs import WavePair
from polywigner.numerics.phases import Pair, cos_sin_cycles, cos_sin_over_cycles, polynomial

_ZERO = Pair(0.0, 0.0)


class Accumulator(Protocol):
    """Interface of objects that compute how a transform changes with vertices and weights."""

    needs_vertices: bool
    needs_weights: bool
    has_constant_indices: bool
    """Whether the indices of vertices must be Python integers."""

    def edge(self, begin: Any, end: Any, normal: tuple[Any, Any], at: tuple[Pair, Pair]) -> Pair:
        """Return the change of the transform if the vertices ``begin`` and ``end`` of an edge move.

        ``normal`` is the outward normal, as long as the edge, and ``at`` contains the derivatives
        with respect to the scalar product of ``normal`` and the displacement of each vertex.
        """
        ...

    def weight(self, number: Any, gradient: Pair, of_conjugate: Pair) -> Pair:
        """Return the change of the transform if the weight w of element ``number`` changes.

        ``gradient`` and ``of_conjugate`` are the derivatives with respect to w and its conjugate.
        """
        ...


@dataclass
class Gradients:
    """Derivatives of a complex value with respect to frequency, position, vertices and weights."""

    frequency: list[Pair]
    position: list[Pair]
    shared: Pair
    """Change of the value due to changes of vertices and weights, summed over all edges and
    elements."""


class Axes:
    """Coordinate axes parallel and perpendicular to a spatial frequency."""

    def __init__(self, ops: Any, nu: tuple[Any, Any]) -> None:
        self.ops = ops
        x, y = moved_off_zero(ops, *nu)
        self.norm = ops.sqrt(ops.fma(x, x, y * y))
        inverse = 1.0 / self.norm
        self.along = x * inverse, y * inverse

    def of(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return the components of a vector along the frequency, and along its left normal."""
        c, s = self.along
        return self.ops.fma(c, x, s * y), self.ops.fma(c, y, -s * x)

    def segment(self, p: Any, q: Any, dp: Any, dq: Any) -> tuple[Pair, ...]:
        """Return integrals of a plane wave along a segment of a polygon's boundary, (G4).

        The segment has the midpoint (p, q) and the vector (dp, dq) in these axes. The results are
        the mean of exp(-2 pi i nu.x), the mean of t exp(-2 pi i nu.x) for t from -1/2 to 1/2 along
        the segment, and the contributions to the moments M00, M10 and 2 M01 of the polygon, each
        divided by -dp. Mjk is the integral of p^j q^k exp(-2 pi i nu.x).
        """
        ops = self.ops
        cosine, sine = cos_sin_cycles(ops, self.norm * p)
        m0, m1, m2 = _segment_moments(ops, 0.5 * self.norm * dp)
        wave = Pair(cosine, -sine)
        e0, e1, e2 = wave.scaled(m0), Pair(sine * m1, cosine * m1), wave.scaled(m2)
        area = e1.scaled(dq).plus(ops, e0, q)
        product = e2.scaled(dq).plus(ops, e1, q)
        along = product.scaled(dp).plus(ops, area, p)
        across = product.scaled(dq).plus(ops, area, q)
        return e0, e1, area, along, across

    def gradient(self, along: Pair, twice_across: Pair) -> tuple[Pair, Pair]:
        """Return the derivative -2 pi i M in the frame for the first moment M in these axes.

        ``along`` and ``twice_across`` are the sums for M10 and 2 M01 of :meth:`segment`, and the
        results are the derivatives along x and y.
        """
        (c, s), across = self.along, twice_across.scaled(0.5)
        x = (along.scaled(c) - across.scaled(s)).scaled(-2 * math.pi)
        y = (along.scaled(s) + across.scaled(c)).scaled(-2 * math.pi)
        return Pair(-x.imag, x.real), Pair(-y.imag, y.real)


# Argument x below which spherical Bessel functions are computed from power series, because the
# upward recurrence loses 3/x^3 ulps. At x = 1 the first omitted term of j_2 is 1e-17 with _DOUBLE
# terms and 2e-9 with _SINGLE terms.
_BELOW, _DOUBLE, _SINGLE = 1.0, 9, 4


def _segment_moments(ops: Any, half: Any) -> tuple[Any, Any, Any]:
    """Return the moments of order 0, 1 and 2 of a plane wave along a segment.

    The moment of order n is the integral of t^n exp(-4 pi i half t) over t from -1/2 to 1/2: j_0,
    -i j_1/2 and (j_0 - 2 j_2)/12, with spherical Bessel functions j_n of 2 pi half. The moment of
    order 1 is imaginary, so the second result is its imaginary part.
    """
    j0, j1, j2 = _bessel(ops, half)
    return j0, -0.5 * j1, ops.fma(j2, -1 / 6, j0 * (1 / 12))


def _bessel(ops: Any, half: Any) -> tuple[Any, Any, Any]:
    """Return the spherical Bessel functions j_0, j_1 and j_2 of the argument 2 pi half."""
    x = 2 * math.pi * half
    small = abs(x) < _BELOW
    inverse = 1.0 / ops.select(small, 1.0, x)
    cosine, sine, ratio = cos_sin_over_cycles(ops, half)
    j0 = ops.select(small, ratio * (0.5 / math.pi), sine * inverse)
    # The series is evaluated for all x, and must not overflow for large x, where it is not used.
    square = ops.select(small, x * x, 0.0)
    coefficients = [1 / 15]
    for k in range(1, (_DOUBLE if ops.double else _SINGLE) + 1):
        coefficients.append(coefficients[-1] * -0.5 / (k * (2 * k + 5)))
    series = square * polynomial(ops, coefficients, square)
    j1 = ops.select(small, (x * (1 / 3)) * (j0 + series), (j0 - cosine) * inverse)
    return j0, j1, ops.select(small, series, ops.fma(3.0 * inverse, j1, -j0))


def fourier_gradients(
    ops: Any, tables: OutlineTables, accumulator: Accumulator, nu_x: Any, nu_y: Any
) -> Gradients:
    """Return the derivatives of the Fourier transform F(nu) in the frame."""
    axes = Axes(ops, (nu_x, nu_y))
    rows = [
        (*edge[:4], float(begin), float(end))
        for begin, (edge, end) in enumerate(zip(tables.edges, tables.following, strict=True))
    ]

    def term(ax: Any, ay: Any, bx: Any, by: Any, begin: Any, end: Any) -> tuple[Any, ...]:
        ex, ey = bx - ax, by - ay
        dp, dq = axes.of(ex, ey)
        midpoint = axes.of(0.5 * (ax + bx), 0.5 * (ay + by))
        e0, e1, _, along, across = axes.segment(*midpoint, dp, dq)
        shared = _ZERO
        if accumulator.needs_vertices:
            at = e0.scaled(0.5) - e1, e0.scaled(0.5) + e1
            shared = accumulator.edge(begin, end, (ey, -ex), at)
        return _parts(along.scaled(-dp), across.scaled(-dp), shared)

    along, across, shared = _pairs(ops.sum_over(rows, term, 6, like=nu_x))
    return Gradients(list(axes.gradient(along, across)), [_ZERO, _ZERO], shared)


def _parts(*pairs: Pair) -> tuple[Any, ...]:
    """Return complex numbers as a flat tuple of real and imaginary parts."""
    return tuple(part for pair in pairs for part in (pair.real, pair.imag))


def _pairs(numbers: Sequence[Any]) -> list[Pair]:
    """Return complex numbers from alternating real and imaginary parts."""
    return list(map(Pair, numbers[0::2], numbers[1::2]))


def slice_gradients(
    ops: Any, tables: Tables, accumulator: Accumulator, *point: Any, is_wigner: bool
) -> Gradients:
    """Return the derivatives of the Wigner function or the ambiguity function in the frame.

    The point is (x, y, nu_x, nu_y) or (upsilon_x, upsilon_y, xi_x, xi_y). The Wigner function is
    the real part of the differentiated value.
    """
    position, frequency = (point[:2], point[2:]) if is_wigner else (point[2:], point[:2])
    weights = [Pair(1.0, 0.0)] * len(tables.groups)
    if accumulator.needs_weights:
        weights, tables = _weights(ops, tables), tables.by_element
    pairings, scale = (mean_pairings, 2.0) if is_wigner else (difference_pairings, 1.0)
    views = dict.fromkeys(view for *_, sides, _ in pairings(tables) for view, _ in sides)
    tx, ty = (scale * c for c in position)
    if accumulator.has_constant_indices or (ops.target == "compiled" and tables.fits_code):
        clipper = Clipper(ops, tables, tx, ty)
    else:
        clipper = PairClipper(ops, tables, tx, ty, tuple(views))
    result = Gradients([_ZERO, _ZERO], [_ZERO, _ZERO], _ZERO)
    for group in range(len(tables.groups)):
        for other in range(len(tables.groups)):
            pairs = [
                _WavePairGradients(
                    clipper, accumulator, scale, sides, pair, frequency, position,
                    (group, other), weights,
                )
                for first, second, sides, wave_pairs in pairings(tables)
                for pair in wave_pairs
                if (first, second) == (group, other)
            ]  # fmt: skip
            for pair, sums in clipper.sums_of_runs(pairs, group, other):
                pair.add_to(_pairs(sums), result)
    return result


def _weights(ops: Any, tables: Tables) -> list[Pair]:
    """Return the complex weights of all elements, in memory if the edges are read from memory."""
    parts = [[part(w) for w in tables.weights] for part in (lambda w: w.real, lambda w: w.imag)]
    if ops.target != "data":
        return list(map(Pair, *parts))
    return [Pair(*(ops.lookup(part, k) for part in parts)) for k in range(len(tables.weights))]


class _WavePairGradients:
    """Derivatives of W or A for a pair of plane waves, also with respect to weights."""

    values = 12

    def __init__(
        self,
        clipper: Clipper,
        accumulator: Accumulator,
        scale: float,
        views: Views,
        pair: WavePair,
        frequency: tuple[Any, ...],
        position: tuple[Any, ...],
        groups: tuple[int, int],
        weights: Sequence[Pair],
    ) -> None:
        self.clipper, self.ops, self.accumulator = clipper, clipper.ops, accumulator
        self.scale, self.views, self.shift = scale, views, pair.shift
        self.axes = Axes(self.ops, pair.detuned(frequency))
        self.rates = [Pair(*rate) for rate in pair.gradient(self.ops, position)]
        group, other = groups
        self.first, self.second = (other, group) if views[0][0] is AHEAD else (group, other)
        self.first_weight, self.second_weight = weights[self.first], weights[self.second]
        self.mutual = self.first_weight * self.second_weight.conjugate()
        self.wave = Pair(*pair.amplitude(self.ops, position))
        self.amplitude = self.wave * self.mutual

    def terms(self, edge: Edge, cuts: Cuts) -> tuple[Any, ...]:
        """Return the contribution of an edge to the sums of :meth:`add_to`."""
        ops, scale, clipper = self.ops, self.scale, self.clipper
        area, motion, along, across, begin, end = [_ZERO] * 6
        long = scale * edge.length
        along_unit, across_unit = clipper.shared(
            edge, lambda: self.axes.of(edge.ux, edge.uy), self.shift
        )
        for view, half_side in self.views:
            side = scale * half_side
            start = self.axes.of(
                ops.fma(clipper.tx, side, scale * edge.ax),
                ops.fma(clipper.ty, side, scale * edge.ay),
            )
            for ends_sum, extent, real, imag in cuts[view]:
                # The position of an edge part of length zero may be so large that its powers
                # overflow.
                ends_sum = ops.select(extent == 0.0, 1.0, ends_sum)
                half, length = (0.5 * long) * ends_sum, long * extent
                e0, e1, *moments = self.axes.segment(
                    ops.fma(half, along_unit, start[0]),
                    ops.fma(half, across_unit, start[1]),
                    length * along_unit,
                    length * across_unit,
                )
                base = -(length * along_unit)
                area, along, across = (
                    total.plus(ops, _weighted(moment, real, imag), base)
                    for total, moment in zip((area, along, across), moments, strict=True)
                )
                e0 = _weighted(e0, real, imag).scaled(extent)
                e1 = _weighted(e1, real, imag).scaled(extent * extent)
                motion = motion + e0.scaled(side)
                to_end = e1.plus(ops, e0, 0.5 * ends_sum)
                begin, end = begin + (e0 - to_end), end + to_end
        shared = _ZERO
        if self.accumulator.needs_vertices:
            factor = self.amplitude.scaled(scale**3)
            at = begin * factor, end * factor
            shared = self.accumulator.edge(edge.begin, edge.end, (edge.ey, -edge.ex), at)
        motions = motion.scaled(scale * edge.ey), motion.scaled(-scale * edge.ex)
        return _parts(area, *motions, along, across, shared)

    def add_to(self, sums: Sequence[Pair], result: Gradients) -> None:
        """Add the derivatives of the pair of waves to ``result``, from its sums over all edges."""
        area, *motions, along, across, shared = sums
        result.shared = result.shared + shared
        for k, motion in enumerate(motions):
            moved = (motion * self.amplitude).scaled(self.scale) + area * self.rates[
                k
            ] * self.mutual
            result.position[k] = result.position[k] + moved.scaled(self.scale)
        for k, gradient in enumerate(self.axes.gradient(along, across)):
            change = (gradient * self.amplitude).scaled(self.scale)
            result.frequency[k] = result.frequency[k] + change
        if self.accumulator.needs_weights:
            value = area.scaled(self.scale) * self.wave
            change = self.accumulator.weight(
                self.first, value * self.second_weight.conjugate(), _ZERO
            )
            change = change + self.accumulator.weight(self.second, _ZERO, value * self.first_weight)
            result.shared = result.shared + change


def _weighted(value: Pair, real: Any, imag: Any) -> Pair:
    """Return ``value`` times real + i imag, without multiplications by constants 1 and 0."""
    if isinstance(imag, float) and imag == 0.0:
        return value if isinstance(real, float) and real == 1.0 else value.scaled(real)
    return value * Pair(real, imag)


@dataclass(frozen=True)
class GradientKernel:
    """Closed-form derivatives of the second step of a kernel, the sum over edges."""

    gradients: Callable[..., Gradients]
    """Function (ops, tables, accumulator, *arguments) that returns `Gradients`. The arguments are
    the components of all ``points`` in the frame, two components for each point."""
    parts: Callable[[Pair], tuple[Any, ...]]
    """Function that converts a complex value to the values that the kernel's sum over edges
    returns."""
    points: tuple[str, ...]
    """Kind of each argument of the kernel, ``"frequency"`` or ``"position"``."""

    def changed(self, ops: Any, frame: Any, gradients: Gradients, change: Sequence[Any]) -> Pair:
        """Return the change of the transform for a ``change`` of its arguments in user units."""
        total = gradients.shared
        for number, name in enumerate(self.points):
            count = len(change) // len(self.points)
            components = change[count * number : count * (number + 1)]
            in_frame = (frame.frequency if name == "frequency" else frame.vector)(ops, *components)
            for gradient, part in zip(getattr(gradients, name), in_frame, strict=True):
                total = total + gradient.scaled(part)
        return total


def _real(value: Pair) -> tuple[Any, ...]:
    """Return the real part as a tuple of one number, like the edge sums of real transforms."""
    return (value.real,)


_FOURIER = GradientKernel(fourier_gradients, wave_sums, ("frequency",))
_KNOWN = {
    plane.WIGNER: GradientKernel(
        partial(slice_gradients, is_wigner=True), _real, ("position", "frequency")
    ),
    plane.AMBIGUITY: GradientKernel(
        partial(slice_gradients, is_wigner=False), wave_sums, ("frequency", "position")
    ),
    plane.FOURIER: _FOURIER,
    plane.FOURIER_PLACED: _FOURIER,
}


def gradient_kernel_of(kernel: Kernel) -> GradientKernel | None:
    """Return the closed-form derivatives of a kernel; None if Dr.Jit differentiates the kernel."""
    return _KNOWN.get(kernel)
