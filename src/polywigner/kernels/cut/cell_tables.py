"""What is left of edges in cells, as tables: runs of whole edges, and cuts that bound parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from polywigner.kernels.cut.cell_edges import OutlineEdges
from polywigner.kernels.outline.lines import NEARLY_PARALLEL
from polywigner.numerics.exact import accurate_cross

__all__ = [
    "GATE",
    "GATE_EXACT",
    "CutList",
    "Parts",
    "Runs",
    "cut_lists",
    "first_rows",
    "ranges_of",
    "run_rows",
]

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Numbers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

# Kinds of cuts in a long row: a crossing of lines, or a comparison that decides on which side of
# a parallel line an edge lies, by levels or by exact distances.
GATE, GATE_EXACT = 1.0, 2.0
# Rows at a time: their temporaries stay in the cache of one core.
_CHUNK = 1 << 16


@dataclass(frozen=True)
class CutList:
    """Parts of edges inside pieces, in cells, and the cuts that bound each."""

    first: npt.NDArray[np.uint32]
    """(cells + 1,) number of the first record of each cell."""
    records: npt.NDArray[np.uint32]
    """(k, 4): edge, first cut, end of the cuts, number of the weight."""
    cuts: Floats
    """(c, 4): t = O_x c0 + O_y c1 + c2, from where on (c3 = 1) or up to where (c3 = 0) the edge is
    inside. Or (c, 8), see ``_long_rows``."""


@dataclass
class Parts:
    """Parts of edges in cells: inside of all of the lines given, on the side given, of each."""

    cell: Numbers
    edge: Numbers
    weight: Complexes
    first: Numbers
    """(k + 1,) the first line of each part."""
    line: Numbers
    side: Numbers


@dataclass
class Runs:
    """Consecutive edges, from first to end, inside something of one weight in a cell."""

    cell: Numbers
    first: Numbers
    end: Numbers
    weight: Complexes

    def __getitem__(self, chosen: Flags) -> Runs:
        return Runs(self.cell[chosen], self.first[chosen], self.end[chosen], self.weight[chosen])

    @classmethod
    def joined(cls, runs: Sequence[Runs]) -> Runs:
        """All of them in order; one for two where the second goes on where the first ends."""
        names = ("cell", "first", "end", "weight")
        every = cls(*(np.concatenate([getattr(r, name) for r in runs]) for name in names))
        order = np.lexsort((every.first, every.cell))
        cell, first, end, weight = (getattr(every, name)[order] for name in names)
        goes_on = (cell[1:] == cell[:-1]) & (first[1:] == end[:-1]) & (weight[1:] == weight[:-1])
        begins = np.append(True, ~goes_on)[: len(cell)]
        ends = np.append(~goes_on, True)[-len(cell) :] if len(cell) else begins
        return cls(cell[begins], first[begins], end[ends], weight[begins])


def ranges_of(first: Numbers, end: Numbers) -> tuple[Numbers, Numbers]:
    """All numbers from each first up to its end, and which range each is from."""
    lengths = end - first
    owner = np.repeat(np.arange(len(first)), lengths)
    return np.arange(len(owner)) + (first - (lengths.cumsum() - lengths))[owner], owner


def first_rows(cell: Numbers, cells: int) -> npt.NDArray[np.uint32]:
    """(cells + 2,) where the rows of each cell begin; the cell outside comes first."""
    return np.searchsorted(cell + 1, np.arange(cells + 2)).astype(np.uint32)


def run_rows(runs: Runs, number: Numbers) -> npt.NDArray[np.uint32]:
    """The table of runs; ``number`` is that of each one's weight."""
    packed = np.column_stack([runs.first, runs.end, number, np.zeros_like(number)])
    return packed.astype(np.uint32)


def cut_lists(
    parts: Parts, number: Numbers, cells: int, lines: Floats, edges: OutlineEdges, sign: int
) -> tuple[CutList, CutList]:
    """The cuts of all parts, plain ones and others; ``number`` is that of each part's weight."""
    owner = np.repeat(np.arange(len(parts.cell)), np.diff(parts.first))
    rows, unusual_row = np.empty((len(owner), 8)), np.empty(len(owner), np.bool_)
    for start in range(0, len(owner), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        edge, line, side = parts.edge[owner[chunk]], parts.line[chunk], parts.side[chunk]
        rows[chunk], unusual_row[chunk] = _long_rows(lines, edges, sign, edge, line, side)
    unusual = np.zeros(len(parts.cell), np.bool_)
    unusual[owner[unusual_row]] = True
    lists = []
    for chosen in (~unusual, unusual):
        (mine,) = np.nonzero(chosen)
        mine = mine[np.argsort(parts.cell[mine], kind="stable")]
        own, _ = ranges_of(parts.first[mine], parts.first[mine + 1])
        end = (parts.first[mine + 1] - parts.first[mine]).cumsum()
        first = np.append(0, end)[:-1]
        table = rows[own] if chosen is unusual else _short_rows(rows[own])
        packed = np.column_stack([parts.edge[mine], first, end, number[mine]])
        lists.append(CutList(first_rows(parts.cell[mine], cells), packed.astype(np.uint32), table))
    return lists[0], lists[1]


def _long_rows(
    lines: Floats, edges: OutlineEdges, sign: int, edge: Numbers, line: Numbers, side: Numbers
) -> tuple[Floats, Flags]:
    """(c, 8): direction d, a point o of the line as seen from the edge, factor, level, ...

    With the distance ``d x (O + o)``, a crossing lies at t = distance times factor. A gate
    compares ``d x O`` to the level, or the distance to 0. (For crossings the level is the
    distance at O = 0.) Then the kind, and whether the edge is inside from the cut on. Also
    whether the row must be used as it is, and not as a short one.
    """
    dx, dy, offset, cluster, exact, px, py = lines[line].T
    (ax, ay), (ex, ey) = edges.start[edge].T, edges.vector[edge].T
    together = cluster == edges.cluster[edge]
    slope = dx * ey - dy * ex
    close = together & (exact > 0)
    slope[close] = accurate_cross(dx[close], dy[close], ex[close], ey[close])
    parallel = together & ((exact == 0) | (slope == 0))
    size = (dx**2 + dy**2) * (ex**2 + ey**2)
    nearly = close & (slope**2 < NEARLY_PARALLEL**2 * size)
    kind = np.where(parallel, np.where(exact > 0, GATE_EXACT, GATE), 0.0)
    s = sign
    factor = -s / np.where(parallel, 1.0, slope)
    rising = parallel | (slope * s > 0)
    away = s * ax - px, s * ay - py
    exactly = accurate_cross(dx, dy, *away)
    start = np.where(exact > 0, exactly, s * (dx * ay - dy * ax) - offset)
    level = np.where(parallel, offset - s * edges.offset[edge], start)
    rows = np.column_stack([dx, dy, *away, factor, level, kind, rising == (side > 0)])
    return rows, parallel | nearly


def _short_rows(rows: Floats) -> Floats:
    dx, dy, _, _, factor, start, _, begins = rows.T
    return np.column_stack([-dy * factor, dx * factor, start * factor, begins])
