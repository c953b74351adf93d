"""Cells of the plane of offsets, each with the edges and sides that can meet while it lasts.

An edge a + t e, moved by an offset O, is p' = O + s (a + t e), s = +1 or -1, in the other copy of
the polygon. It meets a side of a piece there, p + r v, for the offsets in the parallelogram
``p + r v - s (a + t e)``, 0 <= r, t <= 1. The plane of offsets is cut into rectangles, and those
again, until few such parallelograms reach into each: a rectangle of which more than a stated number
do is divided in four along the axis, or in two along both, that separates them best.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.kernels.cut.cell_finder import MARGIN, Finder, Level, Segments, meets

__all__ = ["Cells", "divided"]

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]

# Divisions of an axis: the map of the cells takes 4 MB at most.
_MOST_BITS = 10
# Pairs of an edge with sides in all cells together, on average. Each takes 50 bytes (a cut in
# float64 with its share of what belongs to it) in memory, and some 200 while they are found.
_PAIRS_PER_EDGE = 2000
# A rectangle whose parts have more pairs than this fraction of its own, on average, is not divided
# further: that many edges do meet wherever one is in it.
_GAIN = 0.7


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
        box = self.extent[cell] * self.size / np.exp2(np.array(self.bits)) * (0.5 + 1.5 * MARGIN)
        away = self.points((0.5, 0.5))[cell] - centre
        near = (np.abs(away) <= box + np.abs(e) + np.abs(v)).all(axis=1)
        result: npt.NDArray[np.bool_] = near & meets(away.T, box.T, e.T, v.T)
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


def divided(
    edges: Segments,
    sides: Segments,
    sign: int,
    box: tuple[Floats, Floats],
    enough: int,
) -> Cells:
    """Cells of a box, from corner to corner, with at most ``enough`` pairs each if possible.

    ``sign``: that of the edge's points in the other copy. Cells with more pairs are left where all
    divisions are used up, or the bound on all pairs together is, or dividing has not helped.
    """
    low, size = box[0], box[1] - box[0]
    finder = Finder(edges, sides, sign, low, size)
    finest = min(_MOST_BITS, max(len(edges) - 1, 1).bit_length() + 2)
    level = finder.first(finest)
    finished: list[Level] = []
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


def _chosen(level: Level, chosen: npt.NDArray[np.bool_]) -> Level:
    number = np.cumsum(chosen) - 1
    mine = chosen[level.cell]
    return Level(
        level.bits[chosen],
        level.corner[chosen],
        number[level.cell[mine]],
        level.edge[mine],
        level.side[mine],
    )


def _joined(levels: list[Level], low: Floats, size: Floats) -> Cells:
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
