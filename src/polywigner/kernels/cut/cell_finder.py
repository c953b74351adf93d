"""Which rectangles of offsets the pairs of an edge and a side, that can meet there, reach into.

A pair meets for the offsets in a parallelogram; see ``cell_tree``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["MARGIN", "Finder", "Level", "Segments", "meets"]

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]
Columns = Sequence[npt.NDArray[Any]] | npt.NDArray[Any]

# A rectangle counts as larger by this fraction of its size on each side. It makes up for rounding
# wherever cells are concerned, in float32 as well: cells are no smaller than 2^-10 of the whole.
MARGIN = 0.02
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


@dataclass
class Level:
    """Rectangles in the making: a corner in units of their own size, 2^-bits of the whole."""

    bits: Numbers
    corner: Numbers
    cell: Numbers
    edge: Numbers
    side: Numbers


class Finder:
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

    def first(self, finest: int) -> Level:
        """A regular division into parts no smaller than the parallelograms are on average."""
        reach = [
            float(np.abs(e).mean() + np.abs(v).mean())
            for e, v in zip(self.edge_half, self.side_half, strict=True)
        ]
        bits = np.floor(np.log2(self.size / (2 * np.array(reach))))
        bits = np.clip(bits, 0, min(_FIRST_BITS, finest)).astype(np.int64)
        none = np.zeros((1, 2), np.int64)
        whole = Level(none, none, *np.zeros((3, 0), np.int32))
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

    def splits(self, level: Level, finest: int) -> Numbers:
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

    def children(self, level: Level, splits: Numbers, most: int) -> Level | None:
        """The rectangles divided; None if more than ``most`` pairs would be left."""
        return self._divided(level, splits, _chunks_of(level), most)

    def _divided(
        self, level: Level, splits: Numbers, pairs: Iterable[Any], most: int | None
    ) -> Level | None:
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
        children = _columns(self.low + half * (2 * corner + 1)), _columns(half * (1 + 2 * MARGIN))
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
                begin = np.floor((away - reach) / unit - MARGIN).astype(np.int32)
                end = np.floor((away + reach) / unit + MARGIN).astype(np.int32)
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
            both = meets(separation, box, *sides_of)
            row = row[both]
            found.append((child[both].astype(np.int32), edge[row], side[row]))
            total += len(row)
            if most is not None and total > most:
                return None
        return Level(bits, corner, *(np.concatenate(c) for c in zip(*found, strict=True)))


def _columns(points: Floats) -> tuple[Any, Any]:
    return points[:, 0].astype(np.float32), points[:, 1].astype(np.float32)


def _chunks_of(level: Level) -> Iterator[tuple[Numbers, Numbers, Numbers]]:
    for start in range(0, len(level.cell), _CHUNK):
        part = slice(start, start + _CHUNK)
        yield level.cell[part], level.edge[part], level.side[part]


def meets(away: Columns, box: Columns, e: Columns, v: Columns) -> npt.NDArray[np.bool_]:
    """Whether a box and a parallelogram of half sides e, v meet: no side of theirs parts them.

    The box's own sides have been tried.
    """
    area = np.abs(e[0] * v[1] - e[1] * v[0])
    result = np.ones(len(area), np.bool_)
    for side in (e, v):
        reach = np.abs(side[0]) * box[1] + np.abs(side[1]) * box[0] + area
        result &= np.abs(side[0] * away[1] - side[1] * away[0]) <= reach
    return result
