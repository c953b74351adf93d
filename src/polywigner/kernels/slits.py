"""The transforms in one dimension: sums over intervals in closed form.

The lag slice of two intervals and the position slice of two shifted ones are intervals again, so
every transform is a sum of plane waves' means over intervals (docs/theory.md, (S1) to (S3)).

Of a pair, with half-lengths h and h', only the distance of the two centres depends on x or xi. It
is taken without rounding, so that slits may be as narrow as they like against their distance: the
length of the overlap is that of exact arithmetic to an ulp of itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import combinations_with_replacement, product
from typing import Any

from polywigner.geometry import Slits
from polywigner.illumination import Array
from polywigner.kernels import phases
from polywigner.kernels.frame import power_of_two
from polywigner.kernels.phases import Doubled, doubled
from polywigner.kernels.trigonometry import cos_sin_turns, mean_plane_wave

__all__ = [
    "PairTables",
    "SlitFrame",
    "SlitTables",
    "ambiguity",
    "lag_pairs",
    "lag_slice_length",
    "position_pairs",
    "position_slice_length",
    "slit_tables",
    "wigner",
]


@dataclass(frozen=True)
class Interval:
    """A slit in the frame, and the complex amplitude of the field in it."""

    begin: float
    end: float
    real: float = 1.0
    imag: float = 0.0


@dataclass(frozen=True)
class SlitFrame:
    """x' = (x - centre)/scale, nu' = scale nu; the scale is a power of two."""

    centre: tuple[float]
    scale: float

    @property
    def content(self) -> float:
        return self.scale

    def position(self, ops: Any, x: Any) -> tuple[Any]:
        total, rest = self.exact_position(x)
        return (total + rest,)

    def exact_position(self, x: Any) -> Doubled:
        """x' as the sum of two floats."""
        total, rest = phases.difference(x, self.centre[0])
        return total * (1 / self.scale), rest * (1 / self.scale)

    def vector(self, ops: Any, xi: Any) -> tuple[Any]:
        return (xi * (1 / self.scale),)

    def frequency(self, ops: Any, nu: Any) -> tuple[Any]:
        return (nu * self.scale,)


@dataclass(frozen=True)
class SlitTables:
    """The intervals in their frame; ``edges`` are what a sum runs over."""

    frame: SlitFrame
    edges: tuple[Interval, ...]


@dataclass(frozen=True)
class PairTables:
    """Pairs of intervals; ``edges`` are what a sum runs over, numbers only.

    The centres' distance at x = 0 or xi = 0, as two floats; the half-lengths; the mean of the
    centres, which does not move, as two floats; and the mutual field, real and imaginary part.
    """

    frame: SlitFrame
    edges: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class _Exact:
    """A slit in the frame as exact numbers, and its amplitude."""

    begin: Fraction
    end: Fraction
    field: complex

    @property
    def middle(self) -> Fraction:
        return (self.begin + self.end) / 2

    @property
    def half(self) -> Fraction:
        return (self.end - self.begin) / 2


@lru_cache(maxsize=256)
def _exact_slits(source: Slits | Array) -> tuple[SlitFrame, tuple[_Exact, ...]]:
    if isinstance(source, Slits):
        groups: list[tuple[Slits, complex]] = [(source, 1.0)]
    else:
        pairs = zip(source.coplanar, source.weights.tolist(), strict=True)
        groups = [(slits, weight) for slits, weight in pairs if isinstance(slits, Slits)]
    low = min(slits.bounds[0] for slits, _ in groups)
    high = max(slits.bounds[1] for slits, _ in groups)
    frame = SlitFrame((low + (high - low) / 2,), power_of_two(high - low))
    centre, scale = Fraction(frame.centre[0]), Fraction(frame.scale)
    intervals = (
        _Exact(
            (Fraction(begin) - centre) / scale, (Fraction(end) - centre) / scale, complex(weight)
        )
        for slits, weight in groups
        for begin, end in slits.intervals.tolist()
    )
    return frame, tuple(intervals)


@lru_cache(maxsize=256)
def slit_tables(source: Slits | Array, double: bool) -> SlitTables:
    """The tables of slits or an array of slits; the same for either precision."""
    frame, slits = _exact_slits(source)
    intervals = (Interval(float(s.begin), float(s.end), s.field.real, s.field.imag) for s in slits)
    return SlitTables(frame, tuple(intervals))


@lru_cache(maxsize=256)
def lag_pairs(source: Slits | Array, double: bool) -> PairTables:
    """What pairs of slits contribute to the lag slice at x: 2(I_k - x) & 2(x - I_l).

    The pair (l, k) gives the mirror image with the conjugate field, and is counted with (k, l).
    """
    frame, slits = _exact_slits(source)
    rows = []
    for (k, one), (m, other) in combinations_with_replacement(enumerate(slits), 2):
        mutual = one.field * other.field.conjugate() * (1.0 if k == m else 2.0)
        gap, mean = 2 * (one.middle + other.middle), one.middle - other.middle
        rows.append(_row(gap, 2 * one.half, 2 * other.half, mean, mutual, double))
    return PairTables(frame, tuple(rows))


@lru_cache(maxsize=256)
def position_pairs(source: Slits | Array, double: bool) -> PairTables:
    """What pairs of slits contribute to the position slice: (I_k - xi/2) & (I_l + xi/2)."""
    frame, slits = _exact_slits(source)
    rows = []
    for one, other in product(slits, slits):
        mutual = one.field * other.field.conjugate()
        gap, mean = one.middle - other.middle, (one.middle + other.middle) / 2
        rows.append(_row(gap, one.half, other.half, mean, mutual, double))
    return PairTables(frame, tuple(rows))


def _row(
    gap: Fraction, half: Fraction, other: Fraction, mean: Fraction, mutual: complex, double: bool
) -> tuple[float, ...]:
    parts = (*doubled(gap, double), float(half), float(other), *doubled(mean, double))
    return (*parts, mutual.real, mutual.imag)


def _overlap(
    ops: Any, shift: Doubled, gap: Any, rest: Any, half: Any, other: Any
) -> tuple[Any, Any]:
    """Length of the overlap, and how far its middle lies from the mean of the centres.

    The centres are ``gap`` + ``rest`` - ``shift`` apart. While the shorter interval lies inside the
    other, the middle is its centre; then it stays where the far ends were in line.
    """
    apart, lost = phases.difference(gap, shift[0])
    distance = apart + (lost + (rest - shift[1]))
    shorter = ops.minimum(half, other)
    length = ops.minimum(2.0 * shorter, half + other - abs(distance))
    reach = 0.5 * abs(other - half)
    aside = ops.maximum(-reach, ops.minimum(reach, 0.5 * distance))
    return ops.maximum(length, 0.0), ops.select(other >= half, aside, -aside)


def _waves(ops: Any, tables: PairTables, shift: Doubled, nu: Doubled) -> Any:
    """The slices' transform, with the fields: (real, imaginary) part."""
    whole = nu[0] + nu[1]

    def term(
        gap: Any, rest: Any, half: Any, other: Any, mean: Any, low: Any, real: Any, imag: Any
    ) -> tuple[Any, Any]:
        length, aside = _overlap(ops, shift, gap, rest, half, other)
        half_turns = 0.5 * whole * length
        mean_wave, _ = mean_plane_wave(ops, -half_turns, half_turns)
        turns = phases.reduced(ops, phases.dot(ops, (nu,), ((mean, low),))) + whole * aside
        cosine, sine = cos_sin_turns(ops, turns)
        size = mean_wave * length
        return size * (cosine * real + sine * imag), size * (cosine * imag - sine * real)

    return ops.sum_over(tables.edges, term, 2, like=nu[0])


def _lengths(ops: Any, tables: PairTables, shift: Doubled) -> Any:
    def term(
        gap: Any, rest: Any, half: Any, other: Any, mean: Any, low: Any, real: Any, imag: Any
    ) -> tuple[Any, Any]:
        length, _ = _overlap(ops, shift, gap, rest, half, other)
        return length * real, length * imag

    return ops.sum_over(tables.edges, term, 2, like=shift[0])


def wigner(ops: Any, tables: PairTables, shift: Doubled, nu: Doubled) -> Any:
    """W: the transform of the lag slice, real because the slice is Hermitian; shift = 4x'."""
    return _waves(ops, tables, shift, nu)[0]


def ambiguity(ops: Any, tables: PairTables, shift: Doubled, upsilon: Doubled) -> tuple[Any, Any]:
    """A as (cosine part, sine part), A = cosine - i sine; shift = xi'."""
    real, imag = _waves(ops, tables, shift, upsilon)
    return real, -imag


def lag_slice_length(ops: Any, tables: PairTables, shift: Doubled) -> Any:
    """R_x; shift = 4x'."""
    return _lengths(ops, tables, shift)[0]


def position_slice_length(ops: Any, tables: PairTables, shift: Doubled) -> tuple[Any, Any]:
    """R_xi as (real, imaginary) part; shift = xi'."""
    real, imag = _lengths(ops, tables, shift)
    return real, imag
