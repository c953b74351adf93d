"""Cells of the plane of offsets, each with the edges and sides that can meet while it lasts.

An edge a + t e, moved by an offset O, is p' = O + s (a + t e), s = +1 or -1, in the other copy of
the polygon. It meets a side of a piece there, p + r v, for the offsets in the parallelogram
``p + r v - s (a + t e)``, 0 <= r, t <= 1. The plane of offsets is cut into rectangles, and those
again, until few such parallelograms reach into each: a rectangle of which more than a stated number
do is divided in four along the axis, or in two along both, that separates them best.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Cells", "Segments", "divided"]

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]
Columns = Sequence[npt.NDArray[Any]] | npt.NDArray[Any]

# A rectangle counts as larger by this fraction of its size on each side. It makes up for rounding
# wherever cells are concerned, in float32 as well: cells are no smaller than 2^-10 of the whole.
_MARGIN = 0.02
# Divisions of an axis: the map of the cells takes 4 MB at most.
_MOST_BITS = 10
# Pairs of an edge with sides in all cells together, on average. Each takes 50 bytes (a cut in
# float64 with its share of what belongs to it) in memory, and some 200 while they are found.
_PAIRS_PER_EDGE = 2000
# A rectangle whose parts have more pairs than this fraction of its own, on average, is not divided
# further: that many edges do meet wherever one is in it.
_GAIN = 0.7
# A first division into so many parts at most, not to look at every pair again and again.
_FIRST_BITS = 4
# Pairs at a time: their temporaries stay in the cache of one core.
_CHUNK = 1 << 16


@dataclass(frozen=True)
class Segments:
    """Segments from ``middle - half`` to ``middle + half``, both (n, 2)."""

    middle: Floats
    half: Floats

    def __len__(self) -> int:
        return len(self.middle)

    def turned(self, turn: Floats) -> Segments:
        """In turned axes, the rows of a matrix."""
        return Segments(self.middle @ turn.T, self.half @ turn.T)


@dataclass(frozen=True)
class Cells:
    """Rectangles that tile a larger one, and the pairs whose parallelograms they meet."""

    low: Floats
    """(2,) the corner of the whole."""
    size: Floats
    """(2,) of the whole."""
    bits: tuple[int, int]
    """The finest division: 2^bits in x and y."""
    corner: Numbers
    """(m, 2) of each cell, in finest divisions."""
    extent: Numbers
    """(m, 2) of each cell, in finest divisions."""
    cell: Numbers
    """(k,) ascending: the cell of each pair, and its edge and side."""
    edge: Numbers
    side: Numbers

    def __len__(self) -> int:
        return len(self.corner)

    def points(self, where: tuple[float, float]) -> Floats:
        """A point (m, 2) of every cell, at fractions ``where`` of its extent."""
        unit = self.size / np.exp2(np.array(self.bits))
        return self.low + unit * (self.corner + self.extent * np.array(where))

    def meet(self, cell: Numbers, centre: Floats, e: Floats, v: Floats) -> npt.NDArray[np.bool_]:
        """Whether cells meet parallelograms with half sides e and v: a row for each pair.

        Cells count as a little larger than when the pairs were found: what does not meet here lies
        apart from all that met there.
        """
        box = self.extent[cell] * self.size / np.exp2(np.array(self.bits)) * (0.5 + 1.5 * _MARGIN)
        away = self.points((0.5, 0.5))[cell] - centre
        near = (np.abs(away) <= box + np.abs(e) + np.abs(v)).all(axis=1)
        result: npt.NDArray[np.bool_] = near & _meets(away.T, box.T, e.T, v.T)
        return result

    def map(self) -> npt.NDArray[np.uint32]:
        """(2^bits_y, 2^bits_x) the number of the cell at each finest division."""
        numbers = np.empty((1 << self.bits[1], 1 << self.bits[0]), np.uint32)
        ends = self.corner + self.extent
        for k, ((x, y), (x_end, y_end)) in enumerate(
            zip(self.corner.tolist(), ends.tolist(), strict=True)
        ):
            numbers[y:y_end, x:x_end] = k
        return numbers


@dataclass
class _Level:
    """Rectangles in the making: a corner in units of their own size, 2^-bits of the whole."""

    bits: Numbers
    corner: Numbers
    cell: Numbers
    edge: Numbers
    side: Numbers


def divided(
    edges: Segments, sides: Segments, sign: int, box: tuple[Floats, Floats], enough: int
) -> Cells:
    """Cells of a box, from corner to corner, with at most ``enough`` pairs each if possible.

    ``sign``: that of the edge's points in the other copy. Cells with more pairs are left where all
    divisions are used up, or the bound on all pairs together is, or dividing has not helped.
    """
    low, size = box[0], box[1] - box[0]
    finder = _Finder(edges, sides, sign, low, size)
    finest = min(_MOST_BITS, max(len(edges) - 1, 1).bit_length() + 2)
    level = finder.first(finest)
    finished: list[_Level] = []
    kept, most = 0, _PAIRS_PER_EDGE * len(edges)
    worth_it: npt.NDArray[np.bool_] = np.ones(len(level.bits), np.bool_)
    while True:
        counts = np.bincount(level.cell, minlength=len(level.bits))
        worth_it &= counts > enough
        splits = np.where(worth_it[:, None], finder.splits(level, finest), 0)
        open_cells = splits.sum(axis=1) > 0
        rest = _chosen(level, ~open_cells)
        active = _chosen(level, open_cells)
        kept += len(rest.cell)
        finished.append(rest)
        if not open_cells.any():
            break
        found = finder.children(active, splits[open_cells], most - kept)
        if found is None:
            finished.append(active)
            break
        level = found
        parts = np.left_shift(1, splits[open_cells]).prod(axis=1)
        parent = np.repeat(np.arange(len(parts)), parts)
        children = np.bincount(parent[level.cell], minlength=len(parts)) / parts
        worth_it = (children < _GAIN * counts[open_cells])[parent]
    return _joined(finished, low, size)


def _chosen(level: _Level, chosen: npt.NDArray[np.bool_]) -> _Level:
    number = np.cumsum(chosen) - 1
    mine = chosen[level.cell]
    return _Level(
        level.bits[chosen],
        level.corner[chosen],
        number[level.cell[mine]],
        level.edge[mine],
        level.side[mine],
    )


def _joined(levels: list[_Level], low: Floats, size: Floats) -> Cells:
    bits = np.concatenate([level.bits for level in levels])
    finest = bits.max(axis=0)
    extent = np.left_shift(1, finest - bits)
    corner = np.concatenate([level.corner for level in levels]) * extent
    starts = np.cumsum([0] + [len(level.bits) for level in levels])
    cell = np.concatenate([level.cell + n for level, n in zip(levels, starts, strict=False)])
    # neighbours get numbers close to each other: samples sorted by cell then read nearby memory
    order = np.lexsort((corner[:, 0], corner[:, 1]))
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    cell = number[cell]
    edge, side = (
        np.concatenate([getattr(level, name) for level in levels]) for name in ("edge", "side")
    )
    pairs = np.lexsort((side, edge, cell))
    return Cells(
        low, size, (int(finest[0]), int(finest[1])), corner[order], extent[order],
        cell[pairs], edge[pairs], side[pairs],
    )  # fmt: skip


class _Finder:
    """Tells which parallelograms reach into which rectangles.

    In float32, for speed: what it rounds is far below the margin of a rectangle. Components are
    arrays of their own, since NumPy is slow along short axes.
    """

    def __init__(
        self, edges: Segments, sides: Segments, sign: int, low: Floats, size: Floats
    ) -> None:
        self.low, self.size = low, size
        self.edge_half, self.side_half = _columns(edges.half), _columns(sides.half)
        self.edge_middle = _columns(sign * edges.middle)
        self.side_middle = _columns(sides.middle)
        self.count = len(edges), len(sides)

    def first(self, finest: int) -> _Level:
        """A regular division into parts no smaller than the parallelograms are on average."""
        reach = [
            float(np.abs(e).mean() + np.abs(v).mean())
            for e, v in zip(self.edge_half, self.side_half, strict=True)
        ]
        bits = np.floor(np.log2(self.size / (2 * np.array(reach))))
        bits = np.clip(bits, 0, min(_FIRST_BITS, finest)).astype(np.int64)
        none = np.zeros((1, 2), np.int64)
        whole = _Level(none, none, *np.zeros((3, 0), np.int32))
        level = self._divided(whole, bits[None], self._all_pairs(), None)
        assert level is not None
        return level

    def _all_pairs(self) -> Iterator[tuple[Numbers, Numbers, Numbers]]:
        edges, sides = self.count
        step = max(1, _CHUNK // sides)
        for start in range(0, edges, step):
            mine = np.arange(start, min(start + step, edges), dtype=np.int32)
            edge = np.repeat(mine, sides)
            yield np.zeros_like(edge), edge, np.tile(np.arange(sides, dtype=np.int32), len(mine))

    def splits(self, level: _Level, finest: int) -> Numbers:
        """(m, 2) how many bits to divide each rectangle by: (2, 0), (0, 2), (1, 1), or 0."""
        both = np.zeros((2, len(level.bits)))
        size = self.size / np.exp2(level.bits)
        middles = _columns(self.low + size * (level.corner + 0.5))
        for cell, edge, side in _chunks_of(level):
            for axis, middle in enumerate(middles):
                e, v, centre = self._pair(axis, edge, side)
                across = np.abs(middle[cell] - centre) < np.abs(e) + np.abs(v)
                both[axis] += np.bincount(cell[across], minlength=len(level.bits))
        free = finest - level.bits
        result = np.ones((len(level.bits), 2), np.int64)
        result[(both[0] * 2 < both[1]) & (free[:, 0] > 1)] = (2, 0)
        result[(both[1] * 2 < both[0]) & (free[:, 1] > 1)] = (0, 2)
        return np.minimum(result, free)

    def _pair(self, axis: int, edge: Numbers, side: Numbers) -> tuple[Any, Any, Any]:
        """A component of the half sides and the centre of parallelograms."""
        centre = self.side_middle[axis][side] - self.edge_middle[axis][edge]
        return self.edge_half[axis][edge], self.side_half[axis][side], centre

    def children(self, level: _Level, splits: Numbers, most: int) -> _Level | None:
        """The rectangles divided; None if more than ``most`` pairs would be left."""
        return self._divided(level, splits, _chunks_of(level), most)

    def _divided(
        self, level: _Level, splits: Numbers, pairs: Iterable[Any], most: int | None
    ) -> _Level | None:
        parts = np.left_shift(1, splits)
        count = parts[:, 0] * parts[:, 1]
        base = np.cumsum(count) - count
        parent = np.repeat(np.arange(len(count)), count)
        inner = np.arange(len(parent)) - base[parent]
        across = parts[parent, 0]
        place = np.stack([inner % across, inner // across], axis=1)
        bits = level.bits[parent] + splits[parent]
        corner = level.corner[parent] * parts[parent] + place
        half = 0.5 * self.size / np.exp2(bits)
        children = _columns(self.low + half * (2 * corner + 1)), _columns(half * (1 + 2 * _MARGIN))
        size = self.size / np.exp2(level.bits + splits)
        starts = _columns(self.low + level.corner * parts * size)
        sizes, number = _columns(size), parts.astype(np.int32).T
        found: list[tuple[Numbers, Numbers, Numbers]] = []
        total = 0
        for cell, edge, side in pairs:
            e, v, centre = zip(*(self._pair(axis, edge, side) for axis in (0, 1)), strict=True)
            # the range of children that the parallelogram's bounding box meets
            first, span = [], []
            for axis in (0, 1):
                unit, most_here = sizes[axis][cell], number[axis][cell]
                reach = np.abs(e[axis]) + np.abs(v[axis])
                away = centre[axis] - starts[axis][cell]
                begin = np.floor((away - reach) / unit - _MARGIN).astype(np.int32)
                end = np.floor((away + reach) / unit + _MARGIN).astype(np.int32)
                begin = np.maximum(begin, 0)
                span.append(np.maximum(np.minimum(end, most_here - 1) - begin + 1, 0))
                first.append(begin)
            times = span[0] * span[1]
            row = np.repeat(np.arange(len(cell), dtype=np.int32), times)
            step = np.arange(len(row), dtype=np.int32) - (np.cumsum(times) - times)[row]
            wide = span[0][row]
            x, y = first[0][row] + step % wide, first[1][row] + step // wide
            parent_cell = cell[row]
            child = base[parent_cell] + y * number[0][parent_cell] + x
            middle, box = ([column[child] for column in columns] for columns in children)
            sides_of = [[column[row] for column in columns] for columns in (e, v)]
            separation = [m - c[row] for m, c in zip(middle, centre, strict=True)]
            meets = _meets(separation, box, *sides_of)
            row = row[meets]
            found.append((child[meets].astype(np.int32), edge[row], side[row]))
            total += len(row)
            if most is not None and total > most:
                return None
        return _Level(bits, corner, *(np.concatenate(c) for c in zip(*found, strict=True)))


def _columns(points: Floats) -> tuple[Any, Any]:
    return points[:, 0].astype(np.float32), points[:, 1].astype(np.float32)


def _chunks_of(level: _Level) -> Iterator[tuple[Numbers, Numbers, Numbers]]:
    for start in range(0, len(level.cell), _CHUNK):
        part = slice(start, start + _CHUNK)
        yield level.cell[part], level.edge[part], level.side[part]


def _meets(away: Columns, box: Columns, e: Columns, v: Columns) -> npt.NDArray[np.bool_]:
    """Whether a box and a parallelogram of half sides e, v meet: no side of theirs parts them.

    The box's own sides have been tried.
    """
    area = np.abs(e[0] * v[1] - e[1] * v[0])
    result = np.ones(len(area), np.bool_)
    for side in (e, v):
        reach = np.abs(side[0]) * box[1] + np.abs(side[1]) * box[0] + area
        result &= np.abs(side[0] * away[1] - side[1] * away[0]) <= reach
    return result
