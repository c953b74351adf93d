"""Pairs of the elements of a source that are many or far apart, each in coordinates of its own.

W and A of a coherent source are sums over the pairs of its elements: of equal ones at any places,
or of different parts far from each other. The pair (k, l) contributes to W(x, nu) near the midpoint
of its centres, and to A(upsilon, xi) near their difference (docs/theory.md, (L1), (L2)). Cells of
about the size of an element list the pairs that matter at a sample: what a sample costs grows
linearly with the number of elements, if their density stays.

In one frame for all, vertices are rounded to ulps of the distance between elements, and the edge
sum of a slice that is not quite closed, by this rounding, is multiplied by the distance again: the
error grows with the square of distance over size. So each element is held relative to its own
centre, in one unit for all, and each pair knows the midpoint and the difference of its centres to
twice the digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.kernels.arrays.repeated import (
    ElementTables,
    HeldTable,
    RepeatedTables,
    element_tables,
)
from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED, View
from polywigner.kernels.cut.pair_grid import outline_of
from polywigner.kernels.outline.frame import (
    Frame,
    frame_along,
    frame_of,
    power_of_two,
    vertices_for,
)
from polywigner.kernels.outline.tables import Element, build_tables, grouped
from polywigner.kernels.outline.waves import Waves, carrier_of, difference_pairs
from polywigner.numerics import phases
from polywigner.plans import sums_over_places

# In one frame, the error is some ulps times the square of a source's size over its area, which may
# be so large (docs/accuracy.md): 1e-13 of the area in double precision, 5e-6 in single. Below,
# kernels that find edges by cells lose little; sums over pairs take up to 16 times as long where
# parts are a few of their sizes apart, and 50 times where they fill the source.
_LEAST_SPREAD = {True: 32.0, False: 16.0}  # by double precision or not
# The source is so many times larger than its largest part, or more.
_LEAST_RATIO = 3.0
# Pairs of parts: their records take 128 bytes each.
_MOST_PAIRS = 1 << 13
# Pairs of waves are code, of some 20 ms to compile each.
_MOST_WAVE_PAIRS = 16
# Rounding to 24 bits moves a place by less than this share of its distance from the middle: lists
# of pairs reach that much further.
_MARGIN = 2.0**-21
# Most cells that list pairs; more of them find no fewer pairs.
_MOST_CELLS, _CELLS_PER_PAIR = 1 << 20, 64

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Parts:
    """The edges of different elements, each about its own centre, and the field on all."""

    edges: HeldTable
    """(n, 8) edges in an outline's form, on a grid with the spacing ``step``."""
    step: float
    waves: Waves
    """With phases relative to the middle of the source."""


@dataclass(frozen=True, eq=False)
class _Elements:
    """Where elements are, and with which weights."""

    frame: Frame
    """The frame of the elements, moved to the middle of their centres."""
    element: ElementTables | Parts
    """One element for all copies, or parts: a range of edges for each."""
    places: phases.Doubled
    """(n, 2) centres in the user's unit, less the middle."""
    weights: Complexes
    halves: Floats
    """(n, 2) or (2,) half the width and height, in the frame."""
    ends: NDArray[np.intp]
    """(n + 1,) where the edges of each part begin."""


# ---- equal elements --------------------------------------------------------------------------


def is_scattered(array: Array) -> bool:
    """Whether an array is one element, repeated at enough places."""
    phased = array.phased
    if phased is None or phased.repeated is None:
        return False
    return isinstance(phased.repeated[0], Aperture) and sums_over_places(len(array))


def _scattered(array: Array, double: bool) -> _Elements:
    phased = array.phased
    assert phased is not None and phased.repeated is not None
    element, positions = phased.repeated
    assert isinstance(element, Aperture)
    tables = element_tables(element, double)
    own, low = tables.frame, positions.min(axis=0)
    shift = low + np.ptp(positions, axis=0) / 2
    middle = (shift + own.centre).tolist()
    # fields are held relative to the element's carrier, which is counted with all of x or xi
    turns = positions @ np.array(own.carrier)
    weights = phased.weights * np.exp(-2j * np.pi * (turns - np.rint(turns)))
    return _Elements(
        replace(own, centre=(middle[0], middle[1])),
        tables,
        phases.difference(positions, shift),
        weights,
        np.array(own.reach),
        np.zeros(len(positions) + 1, np.intp),
    )


# ---- different parts -------------------------------------------------------------------------


@dataclass(frozen=True)
class _Distant:
    """Connected polygons with the weights of their elements, and the field on all.

    The frame has the unit of the largest part, and its centre in the middle of the source.
    """

    parts: tuple[tuple[Aperture, complex], ...]
    frame: Frame
    waves: Waves


@lru_cache(maxsize=256)
def distant_parts(source: Aperture | Array, double: bool) -> _Distant | None:
    """The parts of a source if they are small and far apart, few, and have one field; else None.

    ``double``: for results in double precision, which need them farther apart.
    """
    elements = source.elements_in_plane
    if not isinstance(elements[0], Aperture):
        return None
    boxes = np.array([p.bounds for element in elements for p in element.polygons.geoms])
    if len(boxes) < 2 or len(boxes) ** 2 > _MOST_PAIRS:
        return None
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    size = float(np.hypot(*(high - low)))
    largest = float(np.hypot(*(boxes[:, 2:] - boxes[:, :2]).T).max())
    if size < _LEAST_RATIO * largest or _spread(elements) < _LEAST_SPREAD[double]:
        return None
    weights = [1.0] if isinstance(source, Aperture) else source.weights.tolist()
    unit, half = power_of_two(largest), np.full((1, 2), largest / 2)
    middle = (low + (high - low) / 2).tolist()
    frame = replace(
        frame_along(half, np.zeros(2), (1.0, 0.0), (unit, unit)),
        centre=(middle[0], middle[1]),
        carrier=carrier_of((e.illumination for e in elements), 2),
    )
    fields = [Element((), (), w, e.illumination) for e, w in zip(elements, weights, strict=True)]
    groups, members = grouped(fields, frame)
    if len(groups) > 1 or len(difference_pairs(groups[0], groups[0])) > _MOST_WAVE_PAIRS:
        return None
    parts = tuple(
        (Aperture(polygon), weight)
        for element, (weight, _, _) in zip(elements, members, strict=True)
        for polygon in element.polygons.geoms
    )
    return _Distant(parts, frame, groups[0])


def _spread(elements: tuple[Aperture, ...]) -> float:
    """The square of the size over the area, in one frame for all: needles are stretched there."""
    frame = frame_of(np.concatenate([ring for element in elements for ring in element.rings]))
    square = sum((2.0 * reach) ** 2 for reach in frame.reach)
    return square * (frame.content / sum(element.area for element in elements))


def _different(source: Aperture | Array, double: bool) -> _Elements:
    # fewer are distant parts for double precision, and these are among them
    distant = distant_parts(source, False)
    assert distant is not None
    parts, frame = distant.parts, distant.frame
    boxes = np.array([np.reshape(part.bounds, (2, 2)) for part, _ in parts])
    centres = boxes[:, 0] + np.ptp(boxes, axis=1) / 2
    elements = [
        Element(
            [ring - centre for ring in part.rings], [piece - centre for piece in part.convex_cover]
        )
        for (part, _), centre in zip(parts, centres, strict=True)
    ]
    tables = build_tables(elements, double=double, frame=replace(frame, centre=(0.0, 0.0)))
    outline = outline_of(tables, 0, double)
    return _Elements(
        frame,
        Parts(HeldTable(outline.edges), outline.step, distant.waves),
        phases.difference(centres, np.array(frame.centre)),
        np.array([weight for _, weight in parts]),
        np.ptp(boxes, axis=1) / (2.0 * np.sqrt(frame.content)),
        np.searchsorted(outline.names[:, 2], np.arange(len(parts) + 1)),
    )


# ---- pairs -----------------------------------------------------------------------------------


def _elements(source: Aperture | Array, double: bool) -> _Elements:
    if isinstance(source, Array) and is_scattered(source):
        return _scattered(source, double)
    return _different(source, double)


@lru_cache(maxsize=32)
def pairs_by_mean(source: Aperture | Array, double: bool) -> PairTables:
    """For W: pairs by the midpoint of their centres."""
    return _tables(_elements(source, double), (MIRRORED,), double)


@lru_cache(maxsize=32)
def pairs_by_difference(source: Aperture | Array, double: bool) -> PairTables:
    """For A: pairs by the difference of their centres."""
    return _tables(_elements(source, double), (BEHIND, AHEAD), double)


@lru_cache(maxsize=32)
def elements_by_place(array: Array, double: bool) -> PairTables:
    """For R: equal elements by their centres, each as a pair with itself."""
    elements = _scattered(array, double)
    place, weights = _in_frame(elements), elements.weights
    reach = np.broadcast_to(elements.halves * (1 + _MARGIN), place[0].shape)
    unused = np.zeros((len(reach), 4))
    columns = [*_columns(place, double), unused, weights.real, weights.imag, reach, unused]
    lists = _listed(place[0], reach, np.column_stack(columns))
    return RepeatedTables(elements.frame, elements.element, ((MIRRORED, lists),))


def _tables(elements: _Elements, views: tuple[View, ...], double: bool) -> PairTables:
    element, places = elements.element, _in_frame(elements)
    views = views if isinstance(element, Parts) else views[:1]
    lists = tuple((view, _pairs(elements, places, view, double)) for view in views)
    terms = len(element.edges.values) if isinstance(element, Parts) else len(elements.weights)
    return RepeatedTables(elements.frame, element, lists, terms)


def _in_frame(elements: _Elements) -> phases.Doubled:
    """The centres in the frame, less the middle."""
    matrix = elements.frame.inverse_transpose
    high, low = (vertices_for(matrix, (0.0, 0.0), part) for part in elements.places)
    return high, low


def _pairs(elements: _Elements, places: phases.Doubled, view: View, double: bool) -> PairLists:
    """Pairs of elements; the first bears the first factor of the mutual field.

    Columns: the place in the frame and the vector across it, each component as two floats; the
    mutual weight; half of the box in which the pair contributes; the ranges of the edges that bound
    a slice and of the others.
    """
    weights, ends, (high, low) = elements.weights, elements.ends, places
    first, second = (index.ravel() for index in np.indices((len(weights),) * 2))
    mutual = weights[first] * weights[second].conj()
    if view is MIRRORED and not isinstance(elements.element, Parts):
        # each pair once: the other order is conjugate
        once = first <= second
        first, second, mutual = first[once], second[once], mutual[once]
        mutual[first < second] *= 2.0
    total, lost = phases.difference(high[first], -high[second])
    mean = total / 2, (lost + (low[first] + low[second])) / 2
    total, lost = phases.difference(high[first], high[second])
    apart = total, lost + (low[first] - low[second])
    place, across = (mean, apart) if view is MIRRORED else (apart, mean)
    own, other = (second, first) if view is AHEAD else (first, second)
    # the copies meet at offsets below the sum of both half-widths
    halves = np.broadcast_to(elements.halves, high.shape)
    reach = (halves[first] + halves[second]) * (0.5 if view is MIRRORED else 1.0) * (1 + _MARGIN)
    ranges = ends[own], ends[own + 1], ends[other], ends[other + 1]
    columns = [*_columns(place, double), *_columns(across, double), mutual.real, mutual.imag]
    return _listed(place[0], reach, np.column_stack([*columns, reach, *ranges]))


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


PairTables = RepeatedTables[ElementTables | Parts, tuple[tuple[View, PairLists], ...]]
"""The pairs, for each way in which copies lie; for one if elements are equal."""
