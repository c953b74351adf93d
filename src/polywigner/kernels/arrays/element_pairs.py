"""Pairs of equal elements at any positions, each pair in coordinates of its own.

The pair (k, l) contributes to W(x, nu) near the midpoint of its centres, and to A(upsilon, xi) near
their difference (docs/theory.md, (L1), (L2)). Cells of about the size of an element list the pairs
that matter at a sample: the cost of a sample grows linearly with the number of elements, if their
density stays. Each pair holds the midpoint and the difference of its centres to twice the digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture
from polywigner.kernels.arrays.repeated import (
    ElementTables,
    HeldTable,
    RepeatedTables,
    element_tables,
)
from polywigner.kernels.cut.clipping import BEHIND, MIRRORED, View
from polywigner.kernels.outline.frame import (
    Frame,
    vertices_for,
)
from polywigner.numerics import phases
from polywigner.source import Array
from polywigner.source.normal_form import normal_form

# Fewer elements are cut by each other in one frame (benchmarks/array_cost.py).
_LEAST_ELEMENTS = 6
# Rounding to 24 bits moves a point by less than this fraction of its distance from the centre:
# lists of pairs reach that much further.
_MARGIN = 2.0**-21
# Most cells that list pairs; more of them find no fewer pairs.
_MOST_CELLS, _CELLS_PER_PAIR = 1 << 20, 64

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class _Elements:
    """Positions and weights of the elements."""

    frame: Frame
    """The frame of the element, moved to the centre of all elements."""
    element: ElementTables
    positions: phases.Doubled
    """(n, 2) centres of the elements in m, less the centre of all."""
    weights: Complexes
    half: Floats
    """(2,) half the width and height of the element, in the frame."""


def is_scattered(array: Array) -> bool:
    """Whether an array is one element, repeated at enough places."""
    copies = normal_form(array).lattice
    if copies is None or not isinstance(copies.element.outline, Aperture):
        return False
    return len(array) >= _LEAST_ELEMENTS


def _scattered(array: Array, double: bool) -> _Elements:
    copies = normal_form(array).lattice
    assert copies is not None
    positions, tables = copies.positions, element_tables(copies.element.shape, double)
    own, low = tables.frame, positions.min(axis=0)
    shift = low + np.ptp(positions, axis=0) / 2
    middle = (shift + own.centre).tolist()
    # fields are held relative to the element's carrier, which is counted with all of x or xi
    turns = positions @ np.array(own.carrier)
    weights = copies.weights * np.exp(-2j * np.pi * (turns - np.rint(turns)))
    return _Elements(
        replace(own, centre=(middle[0], middle[1])),
        tables,
        phases.difference(positions, shift),
        weights,
        np.array(own.reach),
    )


# ---- pairs -----------------------------------------------------------------------------------


@lru_cache(maxsize=32)
def pairs_by_mean(array: Array, double: bool) -> PairTables:
    """Return the pairs by the midpoint of their centres, for W."""
    return _tables(_scattered(array, double), MIRRORED, double)


@lru_cache(maxsize=32)
def pairs_by_difference(array: Array, double: bool) -> PairTables:
    """Return the pairs by the difference of their centres, for A."""
    return _tables(_scattered(array, double), BEHIND, double)


@lru_cache(maxsize=32)
def elements_by_place(array: Array, double: bool) -> PairTables:
    """Return the elements by their centres, each as a pair with itself, for R."""
    elements = _scattered(array, double)
    high, _ = place = _in_frame(elements)
    weights, reach = elements.weights, _reach(elements, 1.0, len(high))
    unused = np.zeros((len(high), 4))
    columns = [*_columns(place, double), unused, weights.real, weights.imag, reach]
    lists = _listed(high, reach, np.column_stack(columns))
    return RepeatedTables(elements.frame, elements.element, (MIRRORED, lists))


def _tables(elements: _Elements, view: View, double: bool) -> PairTables:
    lists = view, _pairs(elements, view, double)
    return RepeatedTables(elements.frame, elements.element, lists, len(elements.weights))


def _reach(elements: _Elements, scale: float, count: int) -> Floats:
    """Half of the box in which each pair contributes, (count, 2)."""
    return np.broadcast_to(scale * elements.half * (1 + _MARGIN), (count, 2))


def _in_frame(elements: _Elements) -> phases.Doubled:
    """Return the centres in the frame, less the centre of all."""
    matrix = elements.frame.inverse_transpose
    high, low = (vertices_for(matrix, (0.0, 0.0), part) for part in elements.positions)
    return high, low


def _pairs(elements: _Elements, view: View, double: bool) -> PairLists:
    """Pairs of elements; the first bears the first factor of the mutual field.

    Columns: the position in the frame and the vector across it, each component as two floats; the
    mutual weight; half of the box in which the pair contributes.
    """
    weights, (high, low) = elements.weights, _in_frame(elements)
    first, second = (index.ravel() for index in np.indices((len(weights),) * 2))
    mutual = weights[first] * weights[second].conj()
    if view is MIRRORED:
        # each pair once: the other order is conjugate
        once = first <= second
        first, second, mutual = first[once], second[once], mutual[once]
        mutual[first < second] *= 2.0
    total, lost = phases.difference(high[first], -high[second])
    mean = total / 2, (lost + (low[first] + low[second])) / 2
    total, lost = phases.difference(high[first], high[second])
    apart = total, lost + (low[first] - low[second])
    place, across = (mean, apart) if view is MIRRORED else (apart, mean)
    # the copies meet at offsets below the sum of both half-widths
    reach = _reach(elements, 1.0 if view is MIRRORED else 2.0, len(first))
    columns = [*_columns(place, double), *_columns(across, double), mutual.real, mutual.imag]
    return _listed(place[0], reach, np.column_stack([*columns, reach]))


def _columns(vector: phases.Doubled, double: bool) -> list[Floats]:
    """x and y of vectors, each as a float of the kernel's and the rest."""
    total, rest = vector
    high = total if double else total.astype(np.float32).astype(np.float64)
    low = (total - high) + rest
    return [high[:, 0], low[:, 0], high[:, 1], low[:, 1]]


# ---- cells -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PairLists:
    """Pairs sorted by the cell of a grid in which the region begins where they contribute.

    A region is no larger than a cell, so that what contributes to a sample begins in its cell or
    in one of three neighbours: two runs of records.
    """

    low: tuple[float, float]
    scale: tuple[float, float]
    counts: tuple[int, int]
    """Cells that samples may be in; before them in both directions one more for records."""
    starts: HeldTable
    """(cells + 1, 1) where the records of each cell begin, row by row."""
    records: HeldTable

    def runs(self, ops: Any, x: Any, y: Any) -> Iterator[tuple[Any, Any]]:
        """The first and the end of the two runs of records for the cell of each place."""
        starts = self.starts.in_memory(ops)
        u, v = ((p - low) * s for p, low, s in zip((x, y), self.low, self.scale, strict=True))
        rows, columns = self.counts
        inside = (u >= 0.0) & (u < float(rows)) & (v >= 0.0) & (v < float(columns))
        i, j = (ops.truncated(ops.select(inside, value, 0.0)) for value in (u, v))
        for step in (0, 1):
            cell = (i + step) * (columns + 1) + j
            (begin,), (end,) = ops.gather(starts, cell), ops.gather(starts, cell + 2)
            yield begin, ops.select_number(inside, end, begin)


def _listed(centres: Floats, reach: Floats, records: Floats) -> PairLists:
    """The records sorted into the cells of a grid over the region in which anything contributes."""
    farthest = reach.max(axis=0)
    farthest += _MARGIN * (np.abs(centres).max(axis=0) + farthest)
    low, high = centres.min(axis=0) - farthest, centres.max(axis=0) + farthest
    size = 2 * farthest * (1 + 1e-9)  # rounding must not make a region span three cells
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
        HeldTable(first.astype(np.int64)[:, None]),
        HeldTable(records[order]),
    )


PairTables = RepeatedTables[ElementTables, tuple[View, PairLists]]
