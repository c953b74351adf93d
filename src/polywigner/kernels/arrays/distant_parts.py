"""Sources made of small parts far from each other: each part in coordinates of its own.

A slice of such a source is a union of small slices, one for each pair of parts. In one frame for
all, vertices are rounded to ulps of the distance, and the edge sum of a slice that is not quite
closed, by this rounding, is multiplied by the distance again: the error grows with the square of
distance over size. So each part is held relative to its own centre, in one unit for all, and each
pair of parts knows the midpoint and the difference of their centres to twice the digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.kernels.arrays.pair_lists import PairLists, pair_lists
from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED, View
from polywigner.kernels.outline.frame import Frame, frame_along, frame_of, power_of_two
from polywigner.kernels.outline.tables import Element, Tables, build_tables, grouped
from polywigner.kernels.outline.waves import Waves, carrier_of, difference_pairs
from polywigner.numerics import phases

__all__ = ["DistantFrame", "DistantTables", "distant_parts", "pairs_by_difference", "pairs_by_mean"]

# In one frame, the error is some ulps times the square of a source's size over its area, which may
# be so large (docs/accuracy.md): 1e-13 of the area in double precision, 5e-6 in single. Below,
# kernels that find edges by cells lose little; sums over pairs take up to 16 times as long where
# parts are a few of their sizes apart, and 50 times where they fill the source.
_LEAST_SPREAD = {True: 32.0, False: 16.0}  # by double precision or not
# The source is so many times larger than its largest part, or more.
_LEAST_RATIO = 3.0
# Pairs of a part and a convex piece of another: their records take 128 bytes each.
_MOST_PAIRS = 1 << 13
# Pairs of waves are code, of some 20 ms to compile each.
_MOST_WAVE_PAIRS = 16
# Rounding to 24 bits moves a place by less than this share of its distance from the middle: lists
# of pairs reach that much further.
_MARGIN = 2.0**-21
# Most cells that list pairs; more of them find no fewer pairs.
_MOST_CELLS, _CELLS_PER_PAIR = 1 << 18, 64
# Columns of a record, filled up so that four can be read at a time.
_COLUMNS = 16

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class DistantFrame:
    """The unit in which parts are held, and the point from which their centres are counted."""

    part: Frame
    middle: tuple[float, float]
    exact_middle: tuple[phases.Doubled, ...]
    carrier: tuple[float, ...]

    @property
    def content(self) -> float:
        return self.part.content


@dataclass(frozen=True, eq=False)
class DistantTables:
    """The edges and convex pieces of all parts as data, and the pairs that matter at a place."""

    frame: DistantFrame
    waves: Waves
    """The field on all parts, with phases relative to the middle."""
    edge_rows: Floats
    """(n, 8): a, e, and offset and number of direction of the line; two zeros."""
    side_rows: Floats
    """(m, 8), piece by piece: direction, a point and offset of the line, number of direction,
    whether cuts must be exact, and the side of the line on which the piece lies."""
    grid: float | None
    """Spacing to which offsets must be rounded; None if no line needs it."""
    lists: tuple[tuple[View, PairLists], ...]
    """Pairs of the edges of a part and a piece, for each way in which copies lie."""
    held: dict[Any, Any] = field(default_factory=dict)

    @cached_property
    def terms(self) -> int:
        """Edges that a sample may loop through."""
        return len(self.edge_rows)


@dataclass(frozen=True)
class _Part:
    """A connected polygon, and the weight of the element that it is of."""

    outline: Aperture
    weight: complex

    @cached_property
    def box(self) -> Floats:
        return np.reshape(self.outline.bounds, (2, 2))

    @cached_property
    def centre(self) -> Floats:
        return self.box[0] + (self.box[1] - self.box[0]) / 2


@dataclass(frozen=True)
class _Distant:
    """The parts of a source, its middle, and the field on all."""

    parts: tuple[_Part, ...]
    middle: tuple[float, float]
    carrier: tuple[float, ...]
    frame: Frame
    waves: Waves


def _connected(aperture: Aperture, weight: complex) -> list[_Part]:
    return [_Part(Aperture(polygon), weight) for polygon in aperture.polygons.geoms]


@lru_cache(maxsize=256)
def distant_parts(source: Aperture | Array, double: bool) -> _Distant | None:
    """The parts of a source if they are small and far apart, few, and have one field; else None.

    ``double``: for results in double precision, which need them farther apart.
    """
    elements = source.elements_in_plane
    if not isinstance(elements[0], Aperture):
        return None
    low, high = _extent([element.bounds for element in elements])
    boxes = np.array([p.bounds for element in elements for p in element.polygons.geoms])
    if len(boxes) < 2 or len(boxes) ** 2 > _MOST_PAIRS:
        return None
    size = float(np.hypot(*(high - low)))
    largest = float(np.hypot(*(boxes[:, 2:] - boxes[:, :2]).T).max())
    if size < _LEAST_RATIO * largest or _spread(elements) < _LEAST_SPREAD[double]:
        return None
    weights = [1.0] if isinstance(source, Aperture) else source.weights.tolist()
    middle = (low + (high - low) / 2).tolist()
    unit, half = power_of_two(largest), np.full((1, 2), largest / 2)
    frame = frame_along(half, np.zeros(2), (1.0, 0.0), (unit, unit))
    carrier = carrier_of((e.illumination for e in elements), 2)
    wide = replace(frame, centre=(middle[0], middle[1]), carrier=carrier)
    fields = [Element((), (), w, e.illumination) for e, w in zip(elements, weights, strict=True)]
    groups, members = grouped(fields, wide)
    if len(groups) > 1 or len(difference_pairs(groups[0], groups[0])) > _MOST_WAVE_PAIRS:
        return None
    parts = [
        part
        for element, (weight, _, _) in zip(elements, members, strict=True)
        for part in _connected(element, weight)
    ]
    if len(parts) * sum(len(p.outline.convex_cover) for p in parts) > _MOST_PAIRS:
        return None
    return _Distant(tuple(parts), (middle[0], middle[1]), carrier, frame, groups[0])


def _extent(boxes: Sequence[Any]) -> tuple[Floats, Floats]:
    bounds = np.array(boxes)
    return bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)


def _spread(elements: Sequence[Aperture]) -> float:
    """The square of the size over the area, in one frame for all: needles are stretched there."""
    frame = frame_of(np.concatenate([ring for element in elements for ring in element.rings]))
    square = sum((2.0 * reach) ** 2 for reach in frame.reach)
    return square * (frame.content / sum(element.area for element in elements))


@dataclass(frozen=True, eq=False)
class _Rows:
    """The tables of all parts, each about its own centre, and where those of a part are."""

    tables: Tables
    edge_rows: Floats
    side_rows: Floats
    edge_ends: list[int]
    """(n + 1,) by part."""
    owner: NDArray[np.intp]
    """The part of each piece."""
    sign: Floats
    side_ends: list[int]
    """(pieces + 1,)"""


def _rows(distant: _Distant, double: bool) -> _Rows:
    elements = [
        Element(
            [ring - part.centre for ring in part.outline.rings],
            [piece - part.centre for piece in part.outline.convex_cover],
        )
        for part in distant.parts
    ]
    tables = build_tables(elements, double=double, frame=distant.frame)
    edge_rows = [(e.ax, e.ay, e.ex, e.ey, e.offset, e.cluster, 0.0, 0.0) for e in tables.edges]
    side_rows, side_ends = [], [0]
    for piece in tables.pieces:
        for number, side in piece.sides:
            x = tables.lines[number]
            side_rows.append((x.dx, x.dy, x.px, x.py, x.offset, x.cluster, x.exact, side))
        side_ends.append(len(side_rows))
    owners = [edge.element for edge in tables.edges]
    return _Rows(
        tables,
        np.array(edge_rows, np.float64),
        np.array(side_rows, np.float64),
        np.searchsorted(owners, np.arange(len(distant.parts) + 1)).tolist(),
        np.array([piece.element for piece in tables.pieces], np.intp),
        np.array([piece.sign for piece in tables.pieces]),
        side_ends,
    )


@lru_cache(maxsize=32)
def pairs_by_mean(source: Aperture | Array, double: bool) -> DistantTables:
    """For W: pairs by the midpoint of their centres."""
    return _tables(source, double, (MIRRORED,))


@lru_cache(maxsize=32)
def pairs_by_difference(source: Aperture | Array, double: bool) -> DistantTables:
    """For A: pairs by the difference of their centres."""
    return _tables(source, double, (BEHIND, AHEAD))


def _tables(source: Aperture | Array, double: bool, views: Sequence[View]) -> DistantTables:
    distant = distant_parts(
        source, False
    )  # fewer are so for double precision, and these are among them
    assert distant is not None
    rows = _rows(distant, double)
    pairs = _Pairs(distant, rows, double)
    middle = tuple(phases.doubled(c, double) for c in distant.middle)
    return DistantTables(
        DistantFrame(distant.frame, distant.middle, middle, distant.carrier),
        distant.waves,
        rows.edge_rows,
        rows.side_rows,
        rows.tables.grid,
        tuple((view, pairs.listed(view)) for view in views),
    )


class _Pairs:
    """Records of the edges of one part and a convex piece of another, or of its own."""

    def __init__(self, distant: _Distant, rows: _Rows, double: bool) -> None:
        self.rows, self.double, parts = rows, double, distant.parts
        self.unit = float(np.sqrt(distant.frame.content))
        self.centres = np.array([part.centre for part in parts])
        self.middle = np.array(distant.middle)
        self.weights = np.array([part.weight for part in parts])
        self.half = np.array([np.ptp(part.box, axis=0) / 2 for part in parts]) / self.unit
        count, pieces = len(parts), len(rows.owner)
        self.bounding = np.repeat(np.arange(count), pieces)
        self.piece = np.tile(np.arange(pieces), count)

    def listed(self, view: View) -> PairLists:
        """``first``: the part that bears the first factor of the mutual field."""
        one, other = self.bounding, self.rows.owner[self.piece]
        first, second = (other, one) if view is AHEAD else (one, other)
        c = self.centres
        apart = phases.difference(c[first], c[second])
        (a, a_rest), (b, b_rest) = (phases.difference(c[k], self.middle) for k in (first, second))
        total, lost = phases.difference(a, -b)
        mean = total / 2, (lost + (a_rest + b_rest)) / 2
        place, across = (mean, apart) if view is MIRRORED else (apart, mean)
        mutual = self.weights[first] * self.weights[second].conj() * self.rows.sign[self.piece]
        edge_ends, side_ends = np.array(self.rows.edge_ends), np.array(self.rows.side_ends)
        ranges = [
            edge_ends[one],
            edge_ends[one + 1],
            side_ends[self.piece],
            side_ends[self.piece + 1],
        ]
        # the copies meet at offsets below the sum of both half-widths
        reach = (self.half[first] + self.half[second]) * (0.5 if view is MIRRORED else 1.0)
        columns = [*self._columns(place), *self._columns(across), mutual.real, mutual.imag, *ranges]
        columns += list((reach * (1 + _MARGIN)).T)
        records = np.zeros((len(one), _COLUMNS))
        records[:, : len(columns)] = np.stack(columns, axis=-1)
        centres = place[0] / self.unit
        farthest = reach.max(axis=0) + _MARGIN * (np.abs(centres).max(axis=0) + reach.max(axis=0))
        support = np.stack([-farthest, farthest])
        return pair_lists(centres, support, records, min(_MOST_CELLS, _CELLS_PER_PAIR * len(one)))

    def _columns(self, number: phases.Doubled) -> list[Floats]:
        """x and y of points in the unit of the parts, as two floats each."""
        total, rest = (value / self.unit for value in number)
        high = total if self.double else total.astype(np.float32).astype(np.float64)
        low = (total - high) + rest
        return [high[:, 0], low[:, 0], high[:, 1], low[:, 1]]
