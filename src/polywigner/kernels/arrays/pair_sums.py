"""W, A and R of element pairs: sums over the pairs of elements that matter at a place.

The pair's slice is cut at the offset from its own midpoint (W) or difference (A); the phase of the
pair as a whole is counted apart, in turns without rounding: docs/theory.md, (W2), (A1), (L1), (L2).

Of equal elements a pair contributes W or A of the one element at that offset. Different parts are
cut edge by edge: the weight of an edge is the winding number of its end in the other copy, and each
crossing with an edge of the other copy takes back, or adds, the part of the edge up to it
(docs/theory/edges.md, (K1)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from polywigner.kernels.arrays.element_pairs import (
    PairLists,
    PairTables,
    Parts,
    pairs_by_difference,
    pairs_by_mean,
)
from polywigner.kernels.arrays.repeated import (
    ElementSum,
    ElementTables,
    at_both_ends,
    element_ambiguity,
    element_field,
    element_wigner,
)
from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED, View
from polywigner.kernels.cut.pair_grid import crossing
from polywigner.kernels.functions import plane
from polywigner.kernels.functions.edge_terms import WaveTerms, moved_off_zero
from polywigner.kernels.functions.plane import product_of_both
from polywigner.kernels.kernel import Kernel, Values, at_zero_frequency, leave_real, leave_wave
from polywigner.kernels.outline.frame import Frame
from polywigner.kernels.outline.waves import WavePair, difference_pairs, mean_pairs
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns

Point = tuple[phases.Doubled, phases.Doubled]

# ---- into the frame --------------------------------------------------------------------------


def _less(ops: Any, value: Any, constant: float) -> phases.Doubled:
    """value - constant, without rounding."""
    high, low = phases.doubled(constant, ops.double)
    total, rest = phases.difference(value, high)
    return total, rest - low


def _place(ops: Any, frame: Frame, *place: Any) -> Values:
    """A place relative to the middle, in the frame, as two floats a component."""
    less = (_less(ops, c, m) for c, m in zip(place, frame.centre, strict=True))
    total, rest = (frame.vector(ops, *part) for part in zip(*less, strict=True))
    return _halves(ops, *zip(total, rest, strict=True))


def _frequency(ops: Any, frame: Frame, carrier: Sequence[float], *nu: Any) -> Values:
    """A frequency less the carrier, in the frame, as two floats a component."""
    less = tuple(_less(ops, f, c) for f, c in zip(nu, carrier, strict=True))
    return _halves(ops, *(phases.dot(ops, less, row) for row in frame.inverse_transpose))


def _halves(ops: Any, *numbers: phases.Doubled) -> Values:
    """Each number as two floats, of which single precision holds the first."""
    return tuple(half for number in numbers for half in phases.halves(ops, number))


def _enter_wigner(ops: Any, frame: Frame, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Values:
    return (*_place(ops, frame, x, y), *_frequency(ops, frame, frame.carrier, nu_x, nu_y))


def _enter_ambiguity(
    ops: Any, frame: Frame, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> Values:
    turns = phases.turns_to_centre(ops, frame.centre, upsilon_x, upsilon_y)
    turns = phases.less_carrier(ops, frame, turns, xi_x, xi_y)
    lag = _halves(ops, *((c, 0.0 * c) for c in frame.vector(ops, xi_x, xi_y)))
    return (turns, *lag, *_frequency(ops, frame, (0.0, 0.0), upsilon_x, upsilon_y))


def _enter_both_ends(ops: Any, frame: Frame, x: Any, y: Any, xi_x: Any, xi_y: Any) -> Values:
    turns = phases.less_carrier(ops, frame, 0.0 * xi_x, xi_x, xi_y)
    ends = (_place(ops, frame, x + side * xi_x, y + side * xi_y) for side in (0.5, -0.5))
    return (turns, *(number for end in ends for number in end))


# ---- one pair --------------------------------------------------------------------------------


def _point(numbers: Sequence[Any]) -> Point:
    a, b, c, d = numbers
    return (a, b), (c, d)


def _offset(record: Sequence[Any], samples: Sequence[Any]) -> tuple[Any, Any]:
    """The place relative to the pair's own midpoint or difference."""
    (x, x_rest), (y, y_rest) = _point(samples[:4])
    (px, px_rest), (py, py_rest) = _point(record[:4])
    return (x - px) + (x_rest - px_rest), (y - py) + (y_rest - py_rest)


def _turns(ops: Any, one: Sequence[Any], other: Sequence[Any]) -> Any:
    return phases.reduced(ops, phases.dot(ops, tuple(one), tuple(other)))


def _mutual(ops: Any, record: Sequence[Any], nu: Point) -> Pair:
    """The mutual weight of a pair, times exp(-2 pi i nu.(its difference or midpoint))."""
    cosine, sine = cos_sin_turns(ops, _turns(ops, nu, _point(record[4:8])))
    return Pair(record[8], record[9]) * Pair(cosine, -sine)


def _is_near(record: Sequence[Any], samples: Sequence[Any]) -> Any:
    """Whether the boxes of both copies meet."""
    (x, y), (width, height) = _offset(record, samples), record[10:12]
    return (abs(x) < width) & (abs(y) < height)


class _OfElement:
    """The contributions of pairs of equal elements; to W only their real parts."""

    def __init__(self, ops: Any, element: ElementTables, view: View) -> None:
        self.ops, self.element, self.is_mean = ops, element, view is MIRRORED

    def __call__(self, record: Sequence[Any], samples: Sequence[Any]) -> Pair:
        nu, offset = _point(samples[4:]), _offset(record, samples)
        factor, own = _mutual(self.ops, record, nu), [total + rest for total, rest in nu]
        if self.is_mean:
            return factor.scaled(element_wigner(self.ops, self.element, *offset, *own))
        cosine, sine = element_ambiguity(self.ops, self.element, *own, *offset)
        return factor * Pair(cosine, -sine)


class _OfParts:
    """The contributions of pairs of different parts, in one view."""

    def __init__(self, ops: Any, parts: Parts, view: View) -> None:
        self.ops, self.parts, self.view = ops, parts, view
        self.edges = parts.edges.in_memory(ops)
        is_mean = view is MIRRORED
        self.waves = (mean_pairs if is_mean else difference_pairs)(parts.waves, parts.waves)
        # a point of an edge lies in the slice at scale (p - T/2), T as seen from the edges' copy
        self.scale, self.side = 2.0 if is_mean else 1.0, -1.0 if view is AHEAD else 1.0
        self.turned = 1.0 if is_mean else -1.0

    def __call__(self, record: Sequence[Any], samples: Sequence[Any]) -> Pair:
        ops = self.ops
        place, nu = _point(samples[:4]), _point(samples[4:])
        t = [self.scale * self.side * value for value in _offset(record, samples)]
        t = [ops.snapped(value, self.parts.step) for value in t]
        shifted: list[Point] = [_point(self._less(nu, pair)) for pair in self.waves]
        terms = [self._terms(frequency) for frequency in shifted]
        first, end, *others = map(ops.truncated, record[12:16])
        end = ops.select_number(_is_near(record, samples), end, first)
        found = ops.sum_over_range(
            first, end, lambda row: self._of_edge(row, others, t, terms), 2 * len(terms)
        )
        total = Pair(0.0, 0.0)
        for k, (pair, frequency) in enumerate(zip(self.waves, shifted, strict=True)):
            factor = _mutual(ops, record, frequency) * self._amplitude(pair, place)
            total = total + Pair(*terms[k].total(found[2 * k : 2 * k + 2])) * factor
        return total

    def _less(self, nu: Point, pair: WavePair) -> list[Any]:
        """The frequency that a pair of waves sees."""
        numbers: list[Any] = []
        for (frequency, rest), shift in zip(nu, pair.shift, strict=True):
            total, lost = _less(self.ops, frequency, shift)
            numbers += [total, lost + rest]
        return numbers

    def _terms(self, nu: Point) -> WaveTerms:
        at = moved_off_zero(self.ops, *(total + rest for total, rest in nu))
        return WaveTerms(self.ops, at, 2, 0.5 * self.scale / math.pi)

    def _amplitude(self, pair: WavePair, place: Point) -> Pair:
        """The factor of a pair of waves at a position or lag."""
        total = Pair(0.0, 0.0)
        for amplitude, rate in pair.terms:
            term = Pair(complex(amplitude).real, complex(amplitude).imag)
            if any(rate):
                term = term * Pair(*cos_sin_turns(self.ops, _turns(self.ops, place, rate)))
            total = total + term
        return Pair(total.real, 0.0) if pair.is_real else total

    def _of_edge(
        self, row: Any, others: Sequence[Any], t: Sequence[Any], terms: Sequence[WaveTerms]
    ) -> Values:
        """The sums of each wave over the parts of an edge inside the other copy."""
        ops, (tx, ty) = self.ops, t
        edge = ops.gather(self.edges, row)
        ax, ay, bx, by = edge[:4]
        waves = []
        for wave in terms:
            along = wave.along(bx - ax, by - ay)
            start = ops.fma(wave.nu[0], ax - 0.5 * tx, wave.nu[1] * (ay - 0.5 * ty))
            waves.append((wave, along, 0.5 * self.scale * along[0], self.scale * start))

        def up_to(part: Any, share: Any) -> list[Any]:
            """The waves over the edge up to a part of it."""
            return [
                value
                for wave, _, per_edge, start in waves
                for value in wave.added(
                    None, part * per_edge, ops.fma(part, per_edge, start), part, (share, 0.0)
                )
            ]

        def against(other: Any) -> Values:
            line = [self.turned * value for value in ops.gather(self.edges, other)[:4]]
            meets, enters, at_start, at_end = crossing(ops, edge, line, tx, ty, self.side)
            part = at_start / ops.select(meets, at_start - at_end, 1.0)
            share = ops.select(meets, ops.select(enters, -1.0, 1.0), 0.0)
            # upward edges of the copy with the end of the edge to the left count, and downward ones
            # with the end to the right less; a tie is as if T were displaced by side (eps, -eps^2)
            y, y_next = (ty - line[1]) - by, (ty - line[3]) - by
            low, high = (y > 0.0, y_next > 0.0) if self.side > 0 else (y >= 0.0, y_next >= 0.0)
            up = ops.select(high, 1.0, 0.0) - ops.select(low, 1.0, 0.0)
            around = ops.select((up > 0.0) == enters, up, 0.0)
            return (around, *up_to(ops.select(meets, part, 1.0), share))

        others = [number + (row - row) for number in others]  # of as many axes as the edges have
        around, *sums = ops.sum_over_range(*others, against, 1 + 2 * len(waves), like=tx)
        sums = [a + b for a, b in zip(sums, up_to(1.0, around), strict=True)]
        pairs = zip(waves, sums[0::2], sums[1::2], strict=True)
        return tuple(
            value
            for (wave, along, *_), *both in pairs
            for value in wave.of_edge(along, self.scale, tuple(both))
        )


# ---- all pairs -------------------------------------------------------------------------------


def _sum(ops: Any, tables: PairTables, values: int, samples: Values) -> list[Any]:
    """The sum over all pairs, (real, imaginary) or the first alone; with what is not a number."""
    totals: list[Any] = [sum(number - number for number in samples)] * values
    for view, lists in tables.sites.lists:
        found = _sum_in_view(ops, tables.element, view, lists, values, samples)
        totals = [total + part for total, part in zip(totals, found, strict=True)]
    return totals


def _sum_in_view(
    ops: Any, element: Any, view: View, lists: PairLists, values: int, samples: Values
) -> list[Any]:
    """The sum over the records for the cells of samples; others than near ones may be left out."""
    records = lists.records.in_memory(ops)
    of_pair = (_OfParts if isinstance(element, Parts) else _OfElement)(ops, element, view)

    def is_near(row: Any, *samples: Any) -> Any:
        return _is_near(ops.gather(records, row), samples)

    def term(row: Any, *samples: Any) -> Values:
        found = of_pair(ops.gather(records, row), samples)
        return (found.real, found.imag)[:values]

    totals: list[Any] = [0.0] * values
    for first, end in lists.runs(ops, samples[0], samples[2]):
        sums = ops.sum_over_some(first, end, is_near, term, values, *samples)
        totals = [total + part for total, part in zip(totals, sums, strict=True)]
    return totals


def _wigner_sum(ops: Any, tables: PairTables, *samples: Any) -> Values:
    return tuple(_sum(ops, tables, 1, samples))


def _ambiguity_sum(ops: Any, tables: PairTables, turns: Any, *samples: Any) -> Values:
    real, imag = _sum(ops, tables, 2, samples)
    return real, -imag


def _field(ops: Any, tables: PairTables, *place: Any) -> Values:
    """u at one place, less the carrier, from all elements."""
    total = Pair(0.0, 0.0)
    for *centre, real, imag in tables.sites.elements.tolist():
        own = Pair(*element_field(ops, tables.element, *_offset(centre, place)))
        total = total + own * Pair(real, imag)
    return total.real, total.imag


WIGNER = Kernel(
    "wigner of element pairs",
    2,
    pairs_by_mean,
    _enter_wigner,
    ElementSum((MIRRORED,), _wigner_sum),
    leave_real,
)
AMBIGUITY = Kernel(
    "ambiguity of element pairs",
    2,
    pairs_by_difference,
    _enter_ambiguity,
    ElementSum((BEHIND, AHEAD), _ambiguity_sum),
    leave_wave,
)
AUTOCORRELATION = Kernel(
    "autocorrelation of element pairs",
    2,
    pairs_by_mean,
    _enter_both_ends,
    at_both_ends(_field),
    product_of_both,
)
POSITION_MARGINAL = at_zero_frequency(WIGNER, "position marginal of element pairs", leads=False)
LAG_MARGINAL = at_zero_frequency(AMBIGUITY, "lag marginal of element pairs", leads=True)

# of parts, derivatives are those in one frame
WIGNER_OF_PARTS = replace(WIGNER, in_one_frame=plane.WIGNER)
AMBIGUITY_OF_PARTS = replace(AMBIGUITY, in_one_frame=plane.AMBIGUITY)
POSITION_MARGINAL_OF_PARTS = replace(POSITION_MARGINAL, in_one_frame=plane.POSITION_MARGINAL)
LAG_MARGINAL_OF_FIELDS = replace(LAG_MARGINAL, in_one_frame=plane.LAG_MARGINAL_OF_FIELDS)
LAG_MARGINAL_OF_PARTS = replace(LAG_MARGINAL, leave=leave_real, in_one_frame=plane.LAG_MARGINAL)
