"""W, A and R of arrays of equal elements: sums over the pairs of elements that matter at a point.

A pair contributes W or A of the one element at the offset from its own midpoint (W) or difference
(A). The phase of the pair is added apart, in cycles without rounding: docs/theory.md, (W2), (A1),
(L1), (L2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from polywigner.kernels.arrays.element_pairs import (
    PairLists,
    PairTables,
    elements_by_place,
    pairs_by_difference,
    pairs_by_mean,
)
from polywigner.kernels.arrays.repeated import (
    ElementTables,
    element_ambiguity,
    element_field,
    element_wigner,
)
from polywigner.kernels.cut.clipping import MIRRORED, View
from polywigner.kernels.functions.plane import product_of_both
from polywigner.kernels.kernel import Kernel, Values, leave_real, leave_wave
from polywigner.kernels.outline.frame import Frame
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


# ---- all pairs -------------------------------------------------------------------------------


def _sum(
    ops: Any, tables: PairTables, values: int, samples: Values, of_one: Any = _of_element
) -> list[Any]:
    """Sum over all pairs, (real, imaginary) or the first alone; NaN arguments give NaN.

    ``of_one``: the contribution of a pair, by default to W or A.
    """
    view, lists = tables.sites
    sums = _sum_of_near(ops, lists, partial(of_one, ops, tables.element, view), values, samples)
    undefined = sum(number - number for number in samples)
    return [undefined + part for part in sums]


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
    _wigner_sum,
    leave_real,
)
AMBIGUITY = Kernel(
    "ambiguity of element pairs",
    2,
    pairs_by_difference,
    _enter_ambiguity,
    _ambiguity_sum,
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
