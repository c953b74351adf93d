"""Moments of the lag slice, the derivatives of W in frequency; W and moments by listed parts.

The six moments (T1) are sums over the edges of one copy, cut by the pieces of the other, as W is:
docs/theory/rays.md, (T3). In the frame, with coordinates p along nu and q across, d is a part of an
edge, m its middle, Q_n the coefficients along it of the integral over q of the function whose
moment is wanted, and e_n the integral of t^n exp(-i w t) from -1/2 to 1/2. Nothing is divided by
nu. The other copy's edges, mirror images, give the conjugate for even functions and its negative
for odd ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

from polywigner.geometry import Wavefront
from polywigner.kernels.cut.clipping import MIRRORED, Clipper
from polywigner.kernels.cut.slice_sums import PART_COLUMNS, SliceSum, mean_pairings
from polywigner.kernels.functions.edge_terms import moved_off_zero, term_of_part, wigner_terms
from polywigner.kernels.functions.partly_coherent import coherence_of, term_of_lags
from polywigner.kernels.functions.plane import WIGNER, tables_of
from polywigner.kernels.functions.slices import doubled_position, sum_over_waves
from polywigner.kernels.kernel import Kernel, Values, leave_real
from polywigner.kernels.outline.frame import Frame, Matrix
from polywigner.kernels.outline.tables import Edge
from polywigner.kernels.outline.waves import WavePair
from polywigner.numerics.phases import cos_sin_turns
from polywigner.numerics.polynomials import Polynomial, added, multiplied, scaled, segment_moments

# Whether each of the six moments is of a function odd in the lag.
_ODD = (False, True, False, False, True, True)
_COUNT = len(_ODD)

Cuts = Sequence[tuple[Any, Any, Any, Any]]


def _lag_moments(clipper: Clipper, x: Any, y: Any, *frequencies: Any) -> Values:
    """The moments (T1) in the frame, |xi| in the user's unit over the frame's largest.

    ``frequencies``: the detuned one, by which the waves of the field are taken relative to the
    carrier, and the whole one, along which tau is measured, if it is another; two components each,
    in the frame.
    """

    def sum_of(pair: WavePair, is_even: bool) -> _Moments:
        return _Moments(clipper, pair, frequencies[:2], frequencies[2:])

    return tuple(sum_over_waves(clipper, mean_pairings, sum_of, (x, y), _COUNT))


class RayFrame:
    """Coordinates along a frequency and across, and the six functions in them."""

    def __init__(
        self, ops: Any, frame: Frame, nu: Sequence[Any], ray: Sequence[Any], is_aligned: bool
    ) -> None:
        """``nu``: the detuned frequency; ``ray`` the whole one, the same if ``is_aligned``."""
        self.ops, self.is_aligned = ops, is_aligned
        self.nu = moved_off_zero(ops, *nu)
        norm = ops.sqrt(ops.fma(self.nu[0], self.nu[0], self.nu[1] * self.nu[1]))
        self.along = self.nu[0] / norm, self.nu[1] / norm
        # tau = ray[0] p + ray[1] q
        self.ray = (norm, 0.0) if is_aligned else self.turned(*ray)
        self.metric = self._metric(frame)

    def turned(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Components along the frequency and across."""
        fma, (c, s) = self.ops.fma, self.along
        return fma(c, x, s * y), fma(c, y, -s * x)

    def turns(self, x: Any, y: Any) -> Any:
        """nu.xi."""
        return self.ops.fma(self.nu[0], x, self.nu[1] * y)

    def _metric(self, frame: Frame) -> tuple[Any, Any, Any]:
        """|xi|^2 = metric . (p^2, 2 p q, q^2)."""
        (xx, xy), (_, yy) = metric_of(frame)
        if xy == 0.0 and xx == yy:
            return xx, 0.0, xx
        (c, s), fma = self.along, self.ops.fma
        return (
            fma(c * c, xx, fma(2.0 * xy, c * s, s * s * yy)),
            fma(c * s, yy - xx, xy * (c * c - s * s)),
            fma(s * s, xx, fma(-2.0 * xy, c * s, c * c * yy)),
        )

    def of_part(
        self, p: Polynomial, q: Polynomial, middle: Any, length: Any
    ) -> tuple[list[Any], list[Any]]:
        """Real and imaginary parts of a part of an edge's terms in the six E, by (T3).

        p and q along it, for t from -1/2 to 1/2, and the turns nu.xi at its middle and over it.
        """
        ops = self.ops
        cosine, sine = cos_sin_turns(ops, middle)
        means = segment_moments(ops, 0.5 * length, 4)
        real, imag = [], []
        for polynomial in self._integrals(p, q):
            even, odd = _contracted(ops, polynomial, means)
            real.append(-p[1] * ops.fma(cosine, even, sine * odd))
            imag.append(-p[1] * ops.fma(cosine, odd, -sine * even))
        return real, imag

    def _integrals(self, p: Polynomial, q: Polynomial) -> list[Polynomial]:
        """Integrals over q, from 0, of the six functions, as polynomials along a segment."""
        a = scaled(p, self.ray[0])
        pp, pq, qq = multiplied(p, p), multiplied(p, q), multiplied(q, q)
        g_pp, g_pq, g_qq = self.metric
        square = added(scaled(pp, g_pp), scaled(qq, g_qq / 3))  # of |xi|^2, over q
        aa = multiplied(a, a)
        functions = [[1.0], a, aa, square, multiplied(a, square), multiplied(a, aa)]
        if not (isinstance(g_pq, float) and g_pq == 0.0):
            mixed = scaled(pq, g_pq)
            functions[3] = added(functions[3], mixed)
            functions[4] = added(functions[4], multiplied(a, mixed))
        if not self.is_aligned:
            b = scaled(q, self.ray[1])
            bb = multiplied(b, b)
            functions[1] = added(a, scaled(b, 1 / 2))
            functions[2] = added(aa, added(multiplied(a, b), scaled(bb, 1 / 3)))
            across = added(scaled(pp, g_pp / 2), scaled(qq, g_qq / 4))
            across = added(across, scaled(pq, 2 / 3 * g_pq))
            functions[4] = added(functions[4], multiplied(b, across))
            rest = added(scaled(aa, 3 / 2), added(multiplied(a, b), scaled(bb, 1 / 4)))
            functions[5] = added(functions[5], multiplied(b, rest))
        return [multiplied(function, q) for function in functions]


class _Moments:
    """The sums over edges at one frequency."""

    values = 2 * _COUNT

    def __init__(
        self,
        clipper: Clipper,
        wave_pair: WavePair,
        nu: Sequence[Any],
        ray: Sequence[Any],
    ) -> None:
        self.ops, self.wave_pair = clipper.ops, wave_pair
        self.offset = clipper.tx, clipper.ty
        frame = clipper.tables.frame
        is_aligned = not ray and wave_pair.is_still
        self.axes = RayFrame(self.ops, frame, wave_pair.detuned(nu), ray or nu, is_aligned)

    def terms(self, edge: Edge, sides: Sequence[tuple[float, Cuts]]) -> tuple[Any, ...]:
        ((_, cuts),) = sides
        fma, axes = self.ops.fma, self.axes
        place = 2.0 * edge.ax - self.offset[0], 2.0 * edge.ay - self.offset[1]
        start, step = axes.turned(*place), axes.turned(edge.ex, edge.ey)
        turns_at_start, turns_per_step = axes.turns(*place), axes.turns(edge.ex, edge.ey)
        real: list[Any] = [0.0] * _COUNT
        imag: list[Any] = [0.0] * _COUNT
        for somewhere, extent, mutual_real, mutual_imag in cuts:
            # A cut edge may be empty and far away, where powers overflow.
            middle = self.ops.select(extent == 0.0, 1.0, somewhere)
            extent = 2.0 * extent
            p = [fma(middle, step[0], start[0]), extent * step[0]]
            q = [fma(middle, step[1], start[1]), extent * step[1]]
            turns = fma(middle, turns_per_step, turns_at_start)
            found = axes.of_part(p, q, turns, extent * turns_per_step)
            for k, (first, second) in enumerate(zip(*found, strict=True)):
                real[k] = real[k] + (mutual_real * first - mutual_imag * second)
                imag[k] = imag[k] + (mutual_real * second + mutual_imag * first)
        return (*real, *imag)

    def value(self, sums: Sequence[Any], position: tuple[Any, Any]) -> list[Any]:
        amplitude = self.wave_pair.amplitude(self.ops, position)
        return weighted_moments(amplitude, sums[:_COUNT], sums[_COUNT:])


def weighted_moments(weight: Sequence[Any], real: Sequence[Any], imag: Sequence[Any]) -> list[Any]:
    """2 Re of weight times the six sums for even functions, -2 Im for odd ones."""
    c, s = weight
    return [
        -2.0 * (c * b + s * a) if odd else 2.0 * (c * a - s * b)
        for odd, a, b in zip(_ODD, real, imag, strict=True)
    ]


def _contracted(ops: Any, polynomial: Polynomial, means: Sequence[Any]) -> tuple[Any, Any]:
    """sum_n coefficient_n e_n as (real, imaginary) part; even e_n are real, odd ones imaginary."""
    parts: list[Any] = [0.0, 0.0]
    for n, coefficient in enumerate(polynomial):
        parts[n % 2] = ops.fma(coefficient, means[n], parts[n % 2])
    return parts[0], parts[1]


def metric_of(frame: Frame) -> tuple[tuple[float, float], tuple[float, float]]:
    """The matrix of |xi|^2 in the frame, over ``scale_of(frame)^2``: 1 where it is no needle."""
    (a, b), (c, d) = frame.inverse_transpose
    size = scale_of(frame) ** 2
    cross = (a * c + b * d) / size
    return ((a * a + b * b) / size, cross), (cross, (c * c + d * d) / size)


def scale_of(frame: Frame) -> float:
    """The unit of lengths: the longer axis of the frame, in the user's unit."""
    return max(math.hypot(*row) for row in frame.inverse_transpose)


def _enter(ops: Any, frame: Frame, x: Any, y: Any, nu_x: Any, nu_y: Any, *ray: Any) -> Values:
    inner = WIGNER.enter(ops, frame, x, y, nu_x, nu_y)
    if not ray and not any(frame.carrier):
        return inner
    return (*inner, *frame.frequency(ops, *(ray or (nu_x, nu_y))))


def _leave(ops: Any, frame: Frame, inner: Values, sums: Values) -> Values:
    """Scaled to the user's units: areas, and areas times squares of lengths."""
    square = scale_of(frame) ** 2
    factors = (1.0, 1.0, 1.0, square, square, 1.0)
    return tuple(s * (f * frame.content) for s, f in zip(sums, factors, strict=True))


_OVER_SLICE = SliceSum((MIRRORED,), doubled_position, _lag_moments, serves_all=False)
LAG_MOMENTS = Kernel("lag moments", 2, tables_of, _enter, _OVER_SLICE, _leave)
# Along a ray whose frequency is not that of the moments, as that of a curved wave.
LAG_MOMENTS_ALONG = replace(LAG_MOMENTS, name="lag moments along rays apart")


# ---- sums over listed parts --------------------------------------------------------------------


@dataclass(frozen=True)
class PartTables:
    """Properties of a source for sums over parts, a part for each sample of a kernel."""

    frame: Frame
    is_aligned: bool
    is_real: bool
    coherence: Matrix | None = None
    terms: ClassVar[int] = 1


@lru_cache(maxsize=256)
def _part_tables(source: Any, double: bool) -> PartTables:
    """Tables of a source, or of a Wavefront of partly coherent light."""
    tables = tables_of(source.source if isinstance(source, Wavefront) else source, True)
    still = all(not any(wave.frequency) for group in tables.groups for wave in group)
    is_real = len(tables.groups) == 1 and not tables.phased
    light = None
    if isinstance(source, Wavefront):
        light = coherence_of(tables.frame, source.coherence_width)
    return PartTables(tables.frame, still and not any(tables.frame.carrier), is_real, light)


def _enter_part(ops: Any, frame: Frame, *arguments: Any) -> Values:
    """(part, detuned frequency of its waves, whole frequency, and of the ray if it is another)."""
    part, shifts, nu = arguments[:6], arguments[6:PART_COLUMNS], arguments[PART_COLUMNS:]
    detuned = frame.detuned(ops, *nu[:2])
    shifted = (n - s for n, s in zip(detuned, shifts, strict=True))
    whole = (frame.frequency(ops, *nu[k : k + 2]) for k in range(0, len(nu), 2))
    return (*part, *shifted, *(component for one in whole for component in one))


def _part_wigner(ops: Any, tables: PartTables, *inner: Any) -> Values:
    """A part's term of (W1) or (W2)."""
    terms = wigner_terms(ops, inner[6:8], tables.is_real, True)
    weight = (inner[4], 0.0 if tables.is_real else inner[5])
    return terms.total(term_of_part(ops, terms, (*inner[:4], *weight)))


def _partly_coherent(ops: Any, tables: PartTables, *inner: Any) -> Values:
    """Term of (I5) of a part and of its mirror image."""
    assert tables.coherence is not None
    x, y, dx, dy, real, imag = inner[:6]
    found = term_of_lags(ops, tables.coherence, inner[6:8], (x, y), (dx, dy))
    if tables.is_real:
        return (2.0 * real * found[0],)
    return (2.0 * (real * found[0] - imag * found[1]),)


def _part_moments(ops: Any, tables: PartTables, *inner: Any) -> Values:
    """A part's term of (T3)."""
    x, y, dx, dy, real, imag = inner[:6]
    is_aligned = tables.is_aligned and len(inner) == 10
    axes = RayFrame(ops, tables.frame, inner[6:8], inner[-2:], is_aligned)
    (p, q), (dp, dq) = axes.turned(x, y), axes.turned(dx, dy)
    found = axes.of_part([p, dp], [q, dq], axes.turns(x, y), axes.turns(dx, dy))
    return tuple(weighted_moments((real, imag), *found))


PART_WIGNER = Kernel("wigner by parts", 0, _part_tables, _enter_part, _part_wigner, leave_real)
PART_PARTLY_COHERENT = replace(
    PART_WIGNER, name="wigner by parts of partly coherent light", edge_sum=_partly_coherent
)
PART_MOMENTS = Kernel("lag moments by parts", 0, _part_tables, _enter_part, _part_moments, _leave)
PART_MOMENTS_ALONG = replace(PART_MOMENTS, name="lag moments by parts, apart")
