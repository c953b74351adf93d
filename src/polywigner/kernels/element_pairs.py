"""Wigner, ambiguity and autocorrelation functions of equal elements at any positions.

The functions are sums over pairs of elements, (L1) and (L2) of docs/theory.md. A pair contributes
to W(x, nu) near the midpoint of its elements, and to A(upsilon, xi) near the difference of their
positions. A grid of cells lists the pairs that contribute in each cell, so at constant density the
cost of a sample is proportional to the number of elements.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture
from polywigner.kernels.cut.clipping import BEHIND, MIRRORED, View
from polywigner.kernels.functions import plane, separable
from polywigner.kernels.functions.plane import product_of_both, tables_of
from polywigner.kernels.functions.separable import SeparableTables, separable_tables
from polywigner.kernels.functions.slices import AMBIGUITY_SUM, WIGNER_SUM
from polywigner.kernels.kernel import Kernel, Values, leave_real, leave_wave
from polywigner.kernels.outline import Frame, Tables, vertices_for
from polywigner.numerics import Floats, Mask, Number, phases
from polywigner.numerics.phases import Pair, unit_wave
from polywigner.source import Array
from polywigner.source.normal_form import normal_form

ElementTables = Tables | SeparableTables


def element_tables(aperture: Aperture, double: bool) -> ElementTables:
    """Return the constants of an element for kernels in float64 (``double``) or float32."""
    return separable_tables(aperture, double) or tables_of(aperture, double)


def element_wigner(ops: Any, tables: ElementTables, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Number:
    """Return the Wigner function W(x, nu) of an element, for arguments in its frame.

    The frequency is relative to the carrier. The result does not include the factor
    ``frame.measure``.
    """
    if isinstance(tables, SeparableTables):
        return separable.wigner(ops, tables, x, y, nu_x, nu_y)
    return WIGNER_SUM(ops, tables, x, y, nu_x, nu_y)[0]


def element_ambiguity(ops: Any, tables: ElementTables, *arguments: Any) -> Pair:
    """Return the ambiguity function A(upsilon, xi) of an element, for arguments in its frame.

    ``arguments`` are the components of upsilon and of xi. The complex result does not include the
    factor ``frame.measure`` or the phases of the centre and the carrier.
    """
    if isinstance(tables, SeparableTables):
        cosine, sine = separable.ambiguity(ops, tables, *arguments)
    else:
        cosine, sine = AMBIGUITY_SUM(ops, tables, 0.0, *arguments)
    return Pair(cosine, -sine)


def element_field(ops: Any, tables: ElementTables, x: Any, y: Any) -> tuple[Any, Any]:
    """Return the real and imaginary part of an element's field at a point in its frame.

    The field does not include the carrier.
    """
    if isinstance(tables, SeparableTables):
        return separable.field(ops, tables, x, y)
    return plane.field(ops, tables, x, y)


Element = TypeVar("Element")
Sites = TypeVar("Sites")


@dataclass(frozen=True)
class RepeatedTables(Generic[Element, Sites]):
    """An array of equal elements: the element, and the positions and weights of its copies."""

    frame: Any
    element: Element
    sites: Sites
    terms: int = 1
    """Number of copies that are summed at each sample. The choice of the engine depends on this
    number."""


@dataclass(frozen=True, eq=False)
class DeviceTable:
    """A two-dimensional table that is copied once into the memory of each engine."""

    values: NDArray[Any]
    copies: dict[Hashable, Any] = field(default_factory=dict)

    def in_memory(self, ops: Any) -> Any:
        """Return the table in the memory of an engine. The first call copies the table."""
        if ops.key not in self.copies:
            self.copies[ops.key] = ops.on_device(self.values)
        return self.copies[ops.key]


# Smallest number of elements for which W and A are computed as sums over pairs. An array with fewer
# elements is faster to compute as a single source (benchmarks/array_cost.py).
_LEAST_ELEMENTS = 6
# Upper bound on the rounding error of a float32 position, relative to its distance from the centre
# of the array.
_MARGIN = 2.0**-21
# Largest number of cells, and largest number of cells per pair. More cells would not shorten the
# lists of pairs.
_MOST_CELLS, _CELLS_PER_PAIR = 1 << 20, 64


def is_scattered(array: Array) -> bool:
    """Return whether an array consists of six or more shifted copies of one aperture.

    With fewer than 24 elements, copies are recognised only in phased arrays.
    """
    copies = normal_form(array).copies
    if copies is None or not isinstance(copies.element.outline, Aperture):
        return False
    return len(array) >= _LEAST_ELEMENTS


@lru_cache(maxsize=64)
def _tables(array: Array, double: bool, view: View | None) -> PairTables:
    """Return the records of all pairs of elements.

    ``view`` is ``MIRRORED`` for W, ``BEHIND`` for A, and None for R. For R, each element forms a
    pair only with itself. A record contains the midpoint and the difference of the two positions
    (for A, the difference first), the product of one weight and the conjugate of the other weight,
    and the half-width and half-height of the box in which the pair contributes. Each coordinate is
    the sum of two floats.
    """
    copies = normal_form(array).copies
    assert copies is not None
    positions, element = copies.positions, element_tables(copies.element.shape, double)
    local, low = element.frame, positions.min(axis=0)
    shift = low + np.ptp(positions, axis=0) / 2
    x, y = (shift + local.centre).tolist()
    frame = replace(local, centre=(x, y))
    # Stored fields omit the carrier, a plane wave across the complete array. Therefore the phase of
    # this wave at each element is removed from the weight.
    cycles = positions @ np.array(local.carrier)
    weights = copies.weights * np.exp(-2j * np.pi * (cycles - np.rint(cycles)))
    high, low = (
        vertices_for(local.rows, (0.0, 0.0), part) for part in phases.difference(positions, shift)
    )
    scale = 1.0
    if view is None:
        centre, across = (high, low), (0.0 * high, 0.0 * high)
    else:
        first, second = (index.ravel() for index in np.indices((len(weights),) * 2))
        # For W the reversed pair contributes the complex conjugate, so each pair is stored once.
        if view is MIRRORED:
            first, second = first[first <= second], second[first <= second]
        weights = weights[first] * weights[second].conj()
        if view is MIRRORED:
            weights[first < second] *= 2.0
        total, lost = phases.difference(high[first], -high[second])
        mean = total / 2, (lost + (low[first] + low[second])) / 2
        total, lost = phases.difference(high[first], high[second])
        apart = total, lost + (low[first] - low[second])
        centre, across = (mean, apart) if view is MIRRORED else (apart, mean)
        # A pair contributes to W within one half-width of the element from the midpoint, and to A
        # within two half-widths from the difference.
        scale = 1.0 if view is MIRRORED else 2.0
    reach = np.broadcast_to(scale * np.array(local.reach) * (1 + _MARGIN), centre[0].shape)
    columns = (*_columns(centre, double), *_columns(across, double), weights.real, weights.imag)
    lists = _listed(centre[0], reach, np.column_stack([*columns, reach]))
    terms = 1 if view is None else len(array)
    return RepeatedTables(frame, element, (view or MIRRORED, lists), terms)


def _columns(vector: phases.Doubled, double: bool) -> list[Floats]:
    """Return each coordinate of vectors as a float of the kernel's precision and a remainder."""
    total, low = vector
    high = total if double else total.astype(np.float32).astype(np.float64)
    low = (total - high) + low
    return [high[:, 0], low[:, 0], high[:, 1], low[:, 1]]


@dataclass(frozen=True, eq=False)
class PairLists:
    """Pairs of elements of an array, sorted by the cells of a grid.

    A pair contributes to the samples inside a box, and belongs to the cell that contains the lower
    corner of the box. Boxes are no larger than cells, so the pairs of a sample belong to four
    adjacent cells. The records in these cells form two contiguous ranges of the table.
    """

    low: tuple[float, float]
    scale: tuple[float, float]
    counts: tuple[int, int]
    """Number of cells with samples along each axis. The table has one additional row and one
    additional column of cells."""
    starts: DeviceTable
    """Index of the first record of each cell, row by row. Shape (number of cells + 1, 1)."""
    records: DeviceTable

    def runs(self, ops: Any, x: Any, y: Any) -> Iterator[tuple[Any, Any]]:
        """Yield start and end of the two ranges of records that may contribute at each point."""
        starts = self.starts.in_memory(ops)
        u, v = ((p - low) * s for p, low, s in zip((x, y), self.low, self.scale, strict=True))
        rows, columns = self.counts
        inside = (u >= 0.0) & (u < float(rows)) & (v >= 0.0) & (v < float(columns))
        i, j = (ops.truncated(ops.select(inside, value, 0.0)) for value in (u, v))
        for step in (0, 1):
            cell = (i + step) * (columns + 1) + j
            (begin,), (end,) = ops.gather(starts, cell), ops.gather(starts, cell + 2)
            yield begin, ops.select(inside, end, begin)


def _listed(centres: Floats, reach: Floats, records: Floats) -> PairLists:
    """Return the records of pairs of elements, sorted by the cells of a grid.

    A pair contributes at points up to ``reach`` (n, 2) away from its centre along each axis.
    """
    farthest = reach.max(axis=0)
    farthest += _MARGIN * (np.abs(centres).max(axis=0) + farthest)
    low, high = centres.min(axis=0) - farthest, centres.max(axis=0) + farthest
    # Cells are slightly larger than boxes, so that no box spans three cells after rounding.
    size = 2 * farthest * (1 + 1e-9)
    most = min(_MOST_CELLS, _CELLS_PER_PAIR * len(records))
    while np.prod(np.floor((high - low) / size) + 2) > most:
        size = size * 1.25
    counts = np.floor((high - low) / size).astype(np.int64) + 1
    begin = np.clip(np.floor((centres - farthest - low) / size).astype(np.int64), 0, counts - 1)
    cells = (begin[:, 0] + 1) * (counts[1] + 1) + begin[:, 1] + 1
    order = np.argsort(cells, kind="stable")
    first = np.searchsorted(cells[order], np.arange(int(np.prod(counts + 1)) + 1))
    return PairLists(
        (float(low[0]), float(low[1])),
        (float(1 / size[0]), float(1 / size[1])),
        (int(counts[0]), int(counts[1])),
        DeviceTable(first.astype(np.int64)[:, None]),
        DeviceTable(records[order]),
    )


PairTables = RepeatedTables[ElementTables, tuple[View, PairLists]]

Point = tuple[phases.Doubled, phases.Doubled]


def _difference(ops: Any, value: Any, constant: float) -> phases.Doubled:
    """Return ``value`` minus a constant as an unrounded sum of two floats."""
    high, low = phases.doubled(constant, ops.double)
    total, low = phases.difference(value, high)
    return total, low - low


def _position(ops: Any, frame: Frame, *point: Any) -> Values:
    """Return the coordinates of a position in the frame, each as the sum of two floats."""
    less = (_difference(ops, c, m) for c, m in zip(point, frame.centre, strict=True))
    total, low = (frame.vector(ops, *part) for part in zip(*less, strict=True))
    return _split(ops, *zip(total, low, strict=True))


def _frequency(ops: Any, frame: Frame, carrier: Sequence[float], *nu: Any) -> Values:
    """Return the components of a frequency minus the carrier in the frame, as two floats each."""
    less = tuple(_difference(ops, f, c) for f, c in zip(nu, carrier, strict=True))
    return _split(ops, *(phases.dot(ops, less, row) for row in frame.rows))


def _split(ops: Any, *numbers: phases.Doubled) -> Values:
    """Return each number as the sum of two floats. The first float is exact in float32."""
    return tuple(half for number in numbers for half in phases.split(ops, number))


def _enter_wigner(ops: Any, frame: Frame, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Values:
    """Return the position, and the frequency minus the carrier, in the frame.

    Each coordinate is the sum of two floats.
    """
    return (*_position(ops, frame, x, y), *_frequency(ops, frame, frame.carrier, nu_x, nu_y))


def _enter_ambiguity(
    ops: Any, frame: Frame, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> Values:
    """Return the phase of the centre and the carrier in cycles, and xi and upsilon in the frame.

    A has the factor exp(-2 pi i phase). Each component of xi and upsilon is the sum of two floats.
    """
    cycles = phases.cycles_to_centre(ops, frame.centre, upsilon_x, upsilon_y)
    cycles = phases.less_carrier(ops, frame, cycles, xi_x, xi_y)
    lag = _split(ops, *((c, 0.0 * c) for c in frame.vector(ops, xi_x, xi_y)))
    return (cycles, *lag, *_frequency(ops, frame, (0.0, 0.0), upsilon_x, upsilon_y))


def _enter_both_ends(ops: Any, frame: Frame, x: Any, y: Any, xi_x: Any, xi_y: Any) -> Values:
    """Return the negated carrier phase in cycles, and x + xi/2 and x - xi/2 in the frame.

    Each coordinate is the sum of two floats.
    """
    cycles = phases.less_carrier(ops, frame, 0.0 * xi_x, xi_x, xi_y)
    ends = (_position(ops, frame, x + side * xi_x, y + side * xi_y) for side in (0.5, -0.5))
    return (cycles, *(number for end in ends for number in end))


def _point(numbers: Sequence[Any]) -> Point:
    """Return four numbers as a point with two `Doubled` coordinates."""
    a, b, c, d = numbers
    return (a, b), (c, d)


def _offset(record: Sequence[Any], samples: Sequence[Any]) -> tuple[Any, Any]:
    """Return the position or lag of a sample minus the centre in the record of a pair."""
    (x, x_low), (y, y_low) = _point(samples[:4])
    (px, px_low), (py, py_low) = _point(record[:4])
    return (x - px) + (x_low - px_low), (y - py) + (y_low - py_low)


def _of_pair(
    ops: Any, element: ElementTables, view: View, record: Sequence[Any], samples: Sequence[Any]
) -> Pair:
    """Return the contribution of a pair of elements to W or A, for the record of the pair."""
    nu, offset = _point(samples[4:]), _offset(record, samples)
    cycles = phases.reduced(ops, phases.dot(ops, nu, _point(record[4:8])))
    factor = Pair(record[8], record[9]) * unit_wave(ops, cycles).conjugate()
    frequency = [total + low for total, low in nu]
    if view is MIRRORED:
        return factor.scaled(element_wigner(ops, element, *offset, *frequency))
    return factor * element_ambiguity(ops, element, *frequency, *offset)


def _field_of(
    ops: Any, element: ElementTables, view: View, record: Sequence[Any], samples: Sequence[Any]
) -> Pair:
    """Return the field of an element at a sample, times the weight of the element."""
    return Pair(*element_field(ops, element, *_offset(record, samples))) * Pair(*record[8:10])


def _sum(
    ops: Any, tables: PairTables, values: int, samples: Values,
    of_pair: Callable[..., Pair] = _of_pair,
) -> list[Any]:  # fmt: skip
    """Return the sum of each of the ``values`` results of ``of_pair`` over all pairs."""
    view, lists = tables.sites
    records = lists.records.in_memory(ops)

    def is_near(row: Any, *samples: Any) -> Mask:
        """Return whether a sample lies in the box in which a pair of elements contributes."""
        record = ops.gather(records, row)
        (x, y), (width, height) = _offset(record, samples), record[10:12]
        return (abs(x) < width) & (abs(y) < height)

    def term(row: Any, *samples: Any) -> Values:
        value = of_pair(ops, tables.element, view, ops.gather(records, row), samples)
        return (value.real, value.imag)[:values]

    undefined = sum(number - number for number in samples)
    totals: list[Any] = [undefined] * values
    for first, end in lists.runs(ops, samples[0], samples[2]):
        sums = ops.sum_over_some(first, end, is_near, term, values, *samples)
        totals = [total + part for total, part in zip(totals, sums, strict=True)]
    return totals


def _wigner_sum(ops: Any, tables: PairTables, *samples: Any) -> Values:
    """Return W as a sum over pairs of elements, without the factor ``frame.measure``."""
    return tuple(_sum(ops, tables, 1, samples))


def _ambiguity_sum(ops: Any, tables: PairTables, cycles: Any, *samples: Any) -> Values:
    """Return the real part and the negated imaginary part of A, a sum over pairs of elements."""
    real, imag = _sum(ops, tables, 2, samples)
    return real, -imag


def _fields(ops: Any, tables: PairTables, cycles: Any, *positions: Any) -> Values:
    """Return the complex fields at both ends of a lag, as four real numbers."""
    ends = positions[:4], positions[4:]
    return tuple(part for end in ends for part in _sum(ops, tables, 2, end, _field_of))


WIGNER = Kernel(
    "wigner of element pairs",
    2,
    partial(_tables, view=MIRRORED),
    _enter_wigner,
    _wigner_sum,
    leave_real,
)
AMBIGUITY = Kernel(
    "ambiguity of element pairs",
    2,
    partial(_tables, view=BEHIND),
    _enter_ambiguity,
    _ambiguity_sum,
    leave_wave,
)
AUTOCORRELATION = Kernel(
    "autocorrelation of equal elements",
    2,
    partial(_tables, view=None),
    _enter_both_ends,
    _fields,
    product_of_both,
)
