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
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from polywigner.kernels.arrays.element_pairs import (
    PairLists,
    PairTables,
    Parts,
    elements_by_place,
    pairs_by_difference,
    pairs_by_mean,
)
from polywigner.kernels.arrays.repeated import (
    ElementSum,
    ElementTables,
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
from polywigner.numerics.complex_pairs import Pair, unit_wave

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
    """Each number as two floats, the first one of single precision."""
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
    wave = unit_wave(ops, _turns(ops, nu, _point(record[4:8]))).conjugate()
    return Pair(record[8], record[9]) * wave


def _is_near(record: Sequence[Any], samples: Sequence[Any]) -> Any:
    """Whether the boxes of both copies meet."""
    (x, y), (width, height) = _offset(record, samples), record[10:12]
    return (abs(x) < width) & (abs(y) < height)


def _of_element(
    ops: Any, element: ElementTables, view: View, record: Sequence[Any], samples: Sequence[Any]
) -> Pair:
    """The contribution of a pair of equal elements; to W only its real part."""
    nu, offset = _point(samples[4:]), _offset(record, samples)
    factor, own = _mutual(ops, record, nu), [total + rest for total, rest in nu]
    if view is MIRRORED:
        return factor.scaled(element_wigner(ops, element, *offset, *own))
    return factor * element_ambiguity(ops, element, *own, *offset)


def _field_of(
    ops: Any, element: ElementTables, view: View, record: Sequence[Any], samples: Sequence[Any]
) -> Pair:
    """The field of an element."""
    return Pair(*element_field(ops, element, *_offset(record, samples))) * Pair(*record[8:10])


def _of_parts(
    ops: Any, parts: Parts, view: View, record: Sequence[Any], samples: Sequence[Any]
) -> Pair:
    """The contribution of a pair of different parts, by the edges of one inside the other."""
    place, nu = _point(samples[:4]), _point(samples[4:])
    pairs_of, scale = (mean_pairs, 2.0) if view is MIRRORED else (difference_pairs, 1.0)
    wave_pairs = pairs_of(parts.waves, parts.waves)
    seen = [_shifted(ops, nu, pair) for pair in wave_pairs]
    terms = [
        WaveTerms(ops, moved_off_zero(ops, x[0] + x[1], y[0] + y[1]), 2, 0.5 * scale / math.pi)
        for x, y in seen
    ]
    first, end, *others = map(ops.truncated, record[12:16])
    end = ops.select_number(_is_near(record, samples), end, first)
    t = [ops.snapped(view.side * scale * value, parts.step) for value in _offset(record, samples)]
    found = ops.sum_over_range(
        first,
        end,
        lambda row: _of_edge(ops, parts, view, terms, t, row, others),
        2 * len(terms),
    )
    total = Pair(0.0, 0.0)
    for k, (pair, frequency) in enumerate(zip(wave_pairs, seen, strict=True)):
        factor = _mutual(ops, record, frequency) * _amplitude(ops, pair, place)
        total = total + Pair(*terms[k].total(found[2 * k : 2 * k + 2])) * factor
    return total


def _shifted(ops: Any, nu: Point, pair: WavePair) -> Point:
    """The frequency that a pair of waves sees."""
    (x, x_rest), (y, y_rest) = nu
    (x, x_lost), (y, y_lost) = (_less(ops, f, s) for f, s in zip((x, y), pair.shift, strict=True))
    return (x, x_lost + x_rest), (y, y_lost + y_rest)


def _amplitude(ops: Any, pair: WavePair, place: Point) -> Pair:
    """The factor of a pair of waves at a position or lag."""
    total = Pair(0.0, 0.0)
    for amplitude, rate in pair.terms:
        term = Pair(complex(amplitude).real, complex(amplitude).imag)
        if any(rate):
            term = term * unit_wave(ops, _turns(ops, place, rate))
        total = total + term
    return Pair(total.real, 0.0) if pair.is_real else total


def _of_edge(
    ops: Any,
    parts: Parts,
    view: View,
    terms: Sequence[WaveTerms],
    t: Sequence[Any],
    row: Any,
    others: Sequence[Any],
) -> Values:
    """The sums of each wave over the parts of an edge inside the other copy, {T - p}."""
    table, side, (tx, ty) = parts.edges.in_memory(ops), view.side, t
    scale, turned = (2.0, 1.0) if view is MIRRORED else (1.0, -1.0)
    edge = ops.gather(table, row)
    ax, ay, bx, by = edge[:4]
    # a point of an edge lies in the slice at scale (p - T/2)
    x, y = scale * (ax - 0.5 * tx), scale * (ay - 0.5 * ty)
    along = [wave.along(scale * (bx - ax), scale * (by - ay)) for wave in terms]
    starts = [ops.fma(wave.nu[0], x, wave.nu[1] * y) for wave in terms]

    def up_to(part: Any, weight: Any) -> list[Any]:
        """The waves over the edge up to a part of it, without the factors of `of_edge`."""
        values: list[Any] = []
        for wave, (turns, _), start in zip(terms, along, starts, strict=True):
            half = part * (0.5 * turns)
            values += wave.added(None, half, start + half, part, (weight, 0.0))
        return values

    def against(other: Any) -> Values:
        line = [turned * value for value in ops.gather(table, other)[:4]]
        meets, enters, at_start, at_end = crossing(ops, edge, line, tx, ty, side)
        part = at_start / ops.select(meets, at_start - at_end, 1.0)
        weight = ops.select(meets, ops.select(enters, -1.0, 1.0), 0.0)
        # upward edges of the copy with the end of the edge to the left count, and downward ones
        # with the end to the right less; a tie is as if T were displaced by side (eps, -eps^2)
        low, high = (ty - line[1]) - by, (ty - line[3]) - by
        low, high = (low > 0.0, high > 0.0) if side > 0.0 else (low >= 0.0, high >= 0.0)
        up = ops.select(high, 1.0, 0.0) - ops.select(low, 1.0, 0.0)
        around = ops.select((up > 0.0) == enters, up, 0.0)
        return (around, *up_to(ops.select(meets, part, 1.0), weight))

    others = [number + (row - row) for number in others]  # of as many axes as the edges have
    around, *sums = ops.sum_over_range(*others, against, 1 + 2 * len(terms))
    sums = [a + b for a, b in zip(sums, up_to(1.0, around), strict=True)]
    shares = zip(terms, along, sums[0::2], sums[1::2], strict=True)
    return tuple(v for wave, own, *both in shares for v in wave.of_edge(own, 1.0, tuple(both)))


# ---- all pairs -------------------------------------------------------------------------------


def _sum(
    ops: Any, tables: PairTables, values: int, samples: Values, of_one: Any = None
) -> list[Any]:
    """Sum over all pairs, (real, imaginary) or the first alone; NaN arguments give NaN.

    ``of_one``: the contribution of a pair, if not that to W or A.
    """
    element = tables.element
    of_one = of_one or (_of_parts if isinstance(element, Parts) else _of_element)
    totals: list[Any] = [sum(number - number for number in samples)] * values
    for view, lists in tables.sites:
        of_pair = partial(of_one, ops, element, view)
        found = _sum_of_near(ops, lists, of_pair, values, samples)
        totals = [total + part for total, part in zip(totals, found, strict=True)]
    return totals


def _sum_of_near(
    ops: Any, lists: PairLists, of_pair: Callable[..., Pair], values: int, samples: Values
) -> list[Any]:
    """The sum over the records for the cells of samples; others than near ones may be left out."""
    records = lists.records.in_memory(ops)

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


def _fields(ops: Any, tables: PairTables, turns: Any, *places: Any) -> Values:
    """u at both ends of a lag, less the carrier, from the elements around them."""
    ends = places[:4], places[4:]
    return tuple(part for end in ends for part in _sum(ops, tables, 2, end, _field_of))


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
    "autocorrelation of equal elements",
    2,
    elements_by_place,
    _enter_both_ends,
    _fields,
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
