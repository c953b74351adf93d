"""W and A of sources made of small distant parts: sums over the pairs of parts near a place.

Each pair of parts is cut as in `cut.clipping`, with the decisions of its rows,
at the offset from the pair's own midpoint (W) or difference (A); the phase of the pair as a whole
is counted apart, in turns without rounding: docs/theory.md, (W2), (A1), (I2), (I3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from polywigner.kernels.arrays.distant_parts import (
    DistantFrame,
    DistantTables,
    pairs_by_difference,
    pairs_by_mean,
)
from polywigner.kernels.arrays.pair_lists import sum_over_near_pairs
from polywigner.kernels.cut.clipping import BEHIND, MIRRORED, View
from polywigner.kernels.functions import plane
from polywigner.kernels.functions.edge_terms import WaveTerms, moved_off_zero
from polywigner.kernels.kernel import Kernel, Values, at_zero_frequency, leave_real, leave_wave
from polywigner.kernels.outline.waves import WavePair, difference_pairs, mean_pairs
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns

__all__ = [
    "AMBIGUITY",
    "LAG_MARGINAL",
    "LAG_MARGINAL_OF_FIELDS",
    "NUMBERS",
    "POSITION_MARGINAL",
    "WIGNER",
    "DistantWave",
    "Point",
    "less",
]

Point = tuple[phases.Doubled, phases.Doubled]

NUMBERS = 8
"""Numbers that make up a wave: its frequency, the frequency moved off zero, its amplitude."""


def less(ops: Any, value: Any, constant: float) -> phases.Doubled:
    """value - constant, without rounding."""
    high, low = phases.doubled(constant, ops.double)
    total, rest = phases.difference(value, high)
    return total, rest - low


@dataclass(frozen=True)
class DistantWave:
    """A wave_pair of the waves on the source: the frequency that it sees, and its amplitude."""

    ops: Any
    nu: Point
    x: Any
    """nu again, moved off zero."""
    y: Any
    amplitude: Pair
    """Over that of the edge sum."""

    @classmethod
    def of(cls, ops: Any, wave_pair: WavePair, nu: Point, place: Point) -> DistantWave:
        first, second = (_shifted(ops, *pair) for pair in zip(nu, wave_pair.shift, strict=True))
        x, y = moved_off_zero(ops, first[0] + first[1], second[0] + second[1])
        scale = 1.0 / (2 * math.pi * ops.fma(x, x, y * y))
        return cls(ops, (first, second), x, y, _amplitude(ops, wave_pair, place).scaled(scale))

    @property
    def numbers(self) -> Values:
        return (*self.nu[0], *self.nu[1], self.x, self.y, self.amplitude.real, self.amplitude.imag)

    @classmethod
    def from_numbers(cls, ops: Any, numbers: Sequence[Any]) -> DistantWave:
        a, b, c, d, x, y, real, imag = numbers
        return cls(ops, ((a, b), (c, d)), x, y, Pair(real, imag))

    def across(self, apart: Point) -> Pair:
        """exp(-2 pi i nu.apart)."""
        cosine, sine = cos_sin_turns(self.ops, _turns(self.ops, self.nu, apart))
        return Pair(cosine, -sine)

    def along(self, x: Any, y: Any) -> Any:
        return self.ops.fma(self.x, x, self.y * y)


def _shifted(ops: Any, frequency: phases.Doubled, shift: float) -> phases.Doubled:
    if not shift:
        return frequency
    total, rest = less(ops, frequency[0], shift)
    return total, rest + frequency[1]


def _amplitude(ops: Any, wave_pair: WavePair, place: Point) -> Pair:
    """The factor of a wave_pair at a position or lag."""
    total = Pair(0.0, 0.0)
    for amplitude, rate in wave_pair.terms:
        term = Pair(complex(amplitude).real, complex(amplitude).imag)
        if any(rate):
            term = term * Pair(*cos_sin_turns(ops, _turns(ops, place, rate)))
        total = total + term
    return Pair(total.real, 0.0) if wave_pair.is_real else total


def _turns(ops: Any, one: Sequence[Any], other: Sequence[Any]) -> Any:
    return phases.reduced(ops, phases.dot(ops, tuple(one), tuple(other)))


# stands for infinity: far outside [0, 1], and finite when multiplied by a frequency
_FAR = 1e9


# ---- into the frame --------------------------------------------------------------------------


def _halves(ops: Any, numbers: Sequence[phases.Doubled], scale: float) -> list[Any]:
    """Each number times a power of two, as two floats that single precision holds."""
    return [scale * half for number in numbers for half in phases.halves(ops, number)]


def _enter_wigner(ops: Any, frame: DistantFrame, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Values:
    unit = math.sqrt(frame.content)
    place = [less(ops, c, m) for c, m in zip((x, y), frame.middle, strict=True)]
    nu = [less(ops, f, c) for f, c in zip((nu_x, nu_y), frame.carrier, strict=True)]
    return (*_halves(ops, place, 1 / unit), *_halves(ops, nu, unit))


def _enter_ambiguity(
    ops: Any, frame: DistantFrame, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> Values:
    unit = math.sqrt(frame.content)
    turns = phases.turns_to_centre(ops, frame.exact_middle, upsilon_x, upsilon_y)
    turns = phases.less_carrier(ops, frame, turns, xi_x, xi_y)
    upsilon = [(f, 0.0 * f) for f in (upsilon_x, upsilon_y)]
    lag = [(c, 0.0 * c) for c in (xi_x, xi_y)]
    return (turns, *_halves(ops, upsilon, unit), *_halves(ops, lag, 1 / unit))


# ---- one pair --------------------------------------------------------------------------------


class _Held:
    """The rows of edges and sides in an engine's memory."""

    def __init__(self, ops: Any, tables: DistantTables) -> None:
        self.edges, self.sides = ops.held(tables.edge_rows), ops.held(tables.side_rows)


class _Sum:
    """The sums over the edges of one part inside a piece of another, for a pair at a time."""

    def __init__(self, ops: Any, tables: DistantTables, view: View, values: int) -> None:
        self.ops, self.tables, self.view, self.values = ops, tables, view, values
        if ops.key not in tables.held:
            tables.held[ops.key] = _Held(ops, tables)
        self.held: _Held = tables.held[ops.key]
        # a point of an edge lies in the slice at scale (p + side T)
        self.scale = 2.0 if view is MIRRORED else 1.0
        self.side = 0.5 if view.offset * view.point > 0 else -0.5

    def near(self, record: Sequence[Any], *samples: Any) -> Any:
        """Whether the boxes of both copies meet."""
        (x, y), (width, height) = self._offset(record, samples), record[14:16]
        return (abs(x) < width) & (abs(y) < height)

    def of_pair(self, record: Sequence[Any], *samples: Any) -> Values:
        """The sum over the edges of the pair."""
        ops, waves = self.ops, self._waves(samples)
        dx, dx_rest, dy, dy_rest, real, imag = record[4:10]
        first_edge, end_edge, first_side, end_side = map(ops.truncated, record[10:14])
        end_edge = ops.select_number(self.near(record, *samples), end_edge, first_edge)
        place = self._offset(record, samples)
        if self.view is MIRRORED:
            place = [2.0 * value for value in place]
        if self.tables.grid is not None:
            place = [ops.snapped(value, self.tables.grid) for value in place]
        sums = ops.sum_over_range(
            first_edge,
            end_edge,
            lambda row: self._of_edge(row, (first_side, end_side), place, waves),
            2 * len(waves),
        )
        total = Pair(0.0, 0.0)
        for k, wave in enumerate(waves):
            factor = wave.across(((dx, dx_rest), (dy, dy_rest))) * wave.amplitude
            total = total + Pair(sums[2 * k], sums[2 * k + 1]) * (Pair(real, imag) * factor)
        return (total.real, total.imag)[: self.values]

    def _offset(self, record: Sequence[Any], samples: Sequence[Any]) -> list[Any]:
        """The place relative to the pair's own midpoint or difference."""
        px, px_rest, py, py_rest = record[:4]
        x, x_rest, y, y_rest = samples[:4]
        return [(x - px) + (x_rest - px_rest), (y - py) + (y_rest - py_rest)]

    def _waves(self, samples: Sequence[Any]) -> list[DistantWave]:
        return [
            DistantWave.from_numbers(self.ops, samples[k : k + NUMBERS])
            for k in range(4, len(samples), NUMBERS)
        ]

    def _of_edge(
        self, row: Any, sides: tuple[Any, Any], offset: Sequence[Any], waves: Sequence[DistantWave]
    ) -> Values:
        """(sine, cosine less one) of each wave over what is left of an edge."""
        ops, (tx, ty) = self.ops, offset
        edge = ops.gather(self.held.edges, row)[:6]
        ax, ay, ex, ey = edge[:4]
        low, high = self._interval(edge, sides, tx, ty)
        middle, extent = low + high, ops.maximum(high - low, 0.0)
        values: list[Any] = []
        for wave in waves:
            terms = WaveTerms(ops, (wave.x, wave.y), 2)
            along = terms.along(ex, ey)
            per_edge = (0.5 * self.scale) * along[0]
            start = self.scale * wave.along(ax + self.side * tx, ay + self.side * ty)
            turns = ops.fma(middle, per_edge, start)
            sums = terms.added(None, extent * per_edge, turns, extent, (1.0, 0.0))
            values += terms.of_edge(along, self.scale, sums)
        return tuple(values)

    def _interval(
        self, edge: Sequence[Any], sides: tuple[Any, Any], tx: Any, ty: Any
    ) -> tuple[Any, Any]:
        """From where on and up to where the edge is inside all sides, at least 0 and at most 1."""
        ops = self.ops

        def step(row: Any, low: Any, high: Any) -> Values:
            line = ops.gather(self.held.sides, row)
            cut, rising = self._cut(edge, line, tx, ty)
            begins = rising == (line[7] > 0.0)
            return (
                ops.maximum(low, ops.select(begins, cut, -_FAR)),
                ops.minimum(high, ops.select(begins, _FAR, cut)),
            )

        low, high = ops.fold(*sides, (0.0, 1.0), step)
        return low, high

    def _cut(self, edge: Sequence[Any], line: Sequence[Any], tx: Any, ty: Any) -> tuple[Any, Any]:
        """Where the edge meets the line of the other copy, and whether it enters the left side.

        A parallel edge enters it before all t if it lies to the left, else after all t. See
        :class:`polywigner.kernels.cut.clipping.Clipper`, whose decisions these are.
        """
        ops, point = self.ops, self.view.point
        ax, ay, ex, ey, own_offset, own_cluster = edge
        dx, dy, px, py, offset, cluster, exact, _ = line
        tx, ty = self.view.offset * tx, self.view.offset * ty
        slope = ops.cross(dx, dy, ex, ey)
        distance = ops.cross(dx, dy, tx + (point * ax - px), ty + (point * ay - py))
        level, least = ops.fma(ty, dx, tx * -dy), offset - point * own_offset
        is_exact = exact > 0.5
        if self.view is BEHIND:  # the complement of what AHEAD sees
            left = ops.select(is_exact, distance, level - least) >= 0.0
        else:
            left = ops.select(is_exact, distance, level - least) > 0.0
        parallel = (own_cluster == cluster) & ((slope == 0.0) | (exact < 0.5))
        cut = distance * -point / ops.select(parallel, 1.0, slope)
        cut = ops.select(parallel, ops.select(left, -_FAR, _FAR), cut)
        return cut, parallel | (slope * point > 0.0)


# ---- all pairs -------------------------------------------------------------------------------


def _total(
    ops: Any, tables: DistantTables, place: Point, waves: Sequence[DistantWave], values: int
) -> list[Any]:
    """The sum over all pairs, (real, imaginary) or the first alone; with what is not a number."""
    totals = [_unknown(place, waves)] * values
    samples = [*place[0], *place[1], *(number for wave in waves for number in wave.numbers)]
    for view, lists in tables.lists:
        run = _Sum(ops, tables, view, values)
        where = place[0][0], place[1][0]
        found = sum_over_near_pairs(ops, lists, where, run.near, run.of_pair, values, samples)
        totals = [total + part for total, part in zip(totals, found, strict=True)]
    return totals


def _unknown(place: Point, waves: Sequence[DistantWave]) -> Any:
    """0, or not a number where an argument is infinite or none."""
    numbers = [place[0][0], place[1][0], waves[0].x, waves[0].y]
    return sum(number - number for number in numbers)


def _wigner_sum(ops: Any, tables: DistantTables, *inner: Any) -> Values:
    place, nu = _points(inner)
    wave_pairs = mean_pairs(tables.waves, tables.waves)
    waves = [DistantWave.of(ops, wave_pair, nu, place) for wave_pair in wave_pairs]
    # pairs come in both orders, of which one is the other's conjugate; so do those of waves
    return (2.0 * _total(ops, tables, place, waves, 1)[0],)


def _ambiguity_sum(ops: Any, tables: DistantTables, turns: Any, *inner: Any) -> Values:
    upsilon, lag = _points(inner)
    wave_pairs = difference_pairs(tables.waves, tables.waves)
    waves = [DistantWave.of(ops, wave_pair, upsilon, lag) for wave_pair in wave_pairs]
    real, imag = _total(ops, tables, lag, waves, 2)
    return real, -imag


def _points(inner: Sequence[Any]) -> tuple[Point, Point]:
    a, b, c, d, *rest = inner
    e, f, g, h = rest
    return ((a, b), (c, d)), ((e, f), (g, h))


WIGNER = Kernel(
    "wigner of distant parts",
    2,
    pairs_by_mean,
    _enter_wigner,
    _wigner_sum,
    leave_real,
    in_one_frame=plane.WIGNER,
)
AMBIGUITY = Kernel(
    "ambiguity of distant parts",
    2,
    pairs_by_difference,
    _enter_ambiguity,
    _ambiguity_sum,
    leave_wave,
    in_one_frame=plane.AMBIGUITY,
)
POSITION_MARGINAL = replace(
    at_zero_frequency(WIGNER, "position marginal of distant parts", leads=False),
    in_one_frame=plane.POSITION_MARGINAL,
)
LAG_MARGINAL_OF_FIELDS = replace(
    at_zero_frequency(AMBIGUITY, "lag marginal of distant parts", leads=True),
    in_one_frame=plane.LAG_MARGINAL_OF_FIELDS,
)
LAG_MARGINAL = replace(LAG_MARGINAL_OF_FIELDS, leave=leave_real, in_one_frame=plane.LAG_MARGINAL)
