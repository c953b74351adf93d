"""What is left to do in each cell of offsets: whole edges to sum up, and edges to cut.

The plane of offsets is cut into cells (``cell_tree``). While the offset stays in one of them, an
edge sweeps a convex track. If the track does not touch the boundary of the other copy, the edge is
inside or outside as a whole. If it does, each chain of sides that it touches divides the track in
two, and what lies to the left of a chain of left turns are the half-planes of its sides, of right
turns the complement of the opposite ones: the other copy's field on the track is a constant plus a
sum of such convex sets (docs/theory.md, (K1)). Only those sides cut the edge then. No decision is
changed in this way; a cell leaves out what cannot matter in it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from polywigner.kernels.cut.cell_chains import Chains, with_sides_beyond
from polywigner.kernels.cut.cell_edges import OutlineEdges, main_direction
from polywigner.kernels.cut.cell_tables import (
    CutList,
    Parts,
    Runs,
    cut_lists,
    first_rows,
    ranges_of,
    run_rows,
)
from polywigner.kernels.cut.cell_tree import Cells, divided
from polywigner.kernels.outline.tables import Tables

__all__ = ["CellLists", "cell_lists", "lists_of_one_cell"]

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Numbers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

# A cell is small enough if it has fewer cuts than this, or than one to so many edges: they then
# cost less than the whole edges do.
_FEW_CUTS, _EDGES_PER_CUT = 6, 8
# Generic fractions of an edge and of a cell, where no edge ends and no sides meet by design
_ON_EDGE = (0.4863917, 0.2718356, 0.7236281)
_IN_CELL = ((0.5127639, 0.4718352), (0.3819221, 0.6180467), (0.6366198, 0.3678794))
# The cells reach further than the copies touch, by this fraction of their size
_RIM = 0.002
# Copies in their frame are apart at offsets much smaller than this
_FAR = 1024.0
# Area, as a fraction, that pieces may have in common and still count as disjoint
_OVERLAP = 1e-9
# A sum of weights below this fraction of them is zero
_ROUNDING = 1e-12
# Rows at a time: their temporaries stay in the cache of one core.
_CHUNK = 1 << 16


@dataclass(frozen=True)
class CellLists:
    """The lists of all cells for one way in which edges lie in the other copy.

    Cell 0 is outside of all and has nothing on its lists.
    """

    turn: tuple[float, float]
    """Cosine and sine of the angle by which the axes of the cells are turned."""
    low: tuple[float, float]
    """The corner of the cells, in those axes."""
    scale: tuple[float, float]
    """Cells of the map per length."""
    counts: tuple[int, int]
    """Size of the map, in x and y."""
    map: npt.NDArray[np.uint32]
    """(counts[1] * counts[0],) number of the cell."""
    edges: Floats
    """(n, 4): a and e of each edge."""
    edge_rest: Floats
    """(n, 3): cross(a, e), and the weight."""
    weights: Floats
    """(w, 2): the different weights of runs and records."""
    first_run: npt.NDArray[np.uint32]
    """(cells + 1,) number of the first run of each cell."""
    runs: npt.NDArray[np.uint32]
    """(r, 4): first edge, end of the edges, number of the weight, 0."""
    plain: CutList
    """Crossings of lines only."""
    special: CutList
    """All others."""
    held: dict[Any, Any] = field(default_factory=dict, compare=False, repr=False)
    """These lists in the memory of engines."""

    @property
    def nbytes(self) -> int:
        """Memory of the lists, in float64."""
        arrays: list[npt.NDArray[Any]] = [self.map, self.edges, self.first_run, self.runs]
        for cuts in (self.plain, self.special):
            arrays += [cuts.first, cuts.records, cuts.cuts]
        return sum(array.nbytes for array in arrays)


def cell_lists(tables: Tables, sign: int) -> CellLists:
    """The lists for edges that lie at ``O + sign (a + t e)`` in the other copy."""
    # remembered apart: those of one cell are many and quick to make, and must not oust the others
    one = tables.cut == "all in cells"
    return lists_of_one_cell(tables, sign) if one else _lists_of_cells(tables, sign)


@lru_cache(maxsize=32)
def _lists_of_cells(tables: Tables, sign: int) -> CellLists:
    edges = OutlineEdges.of(tables.edges)
    angle = main_direction(edges.vector)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corners = edges.start @ turn.T
    low = corners.min(axis=0) - (sign * corners).max(axis=0)
    high = corners.max(axis=0) - (sign * corners).min(axis=0)
    # beyond the cells the copies are apart; where they touch, both see the same
    rim = _RIM * (high - low)
    enough = max(_FEW_CUTS, len(edges) // _EDGES_PER_CUT)
    segments = edges.segments.turned(turn)
    cells = divided(segments, segments, sign, (low - rim, high + rim), enough)
    cells = with_sides_beyond(edges, cells, sign, turn)
    return _Lists(tables, edges, cells, sign, turn).result(angle)


@lru_cache(maxsize=32)
def lists_of_one_cell(tables: Tables, sign: int) -> CellLists:
    """Lists for edges as in :func:`cell_lists`, of one cell wherever the offset lies.

    Every edge is on them once for each convex piece, with all of the piece's sides.
    """
    edges = OutlineEdges.of(tables.edges)
    pieces, count = tables.pieces, len(tables.edges)
    sides = np.array([side for piece in pieces for side in piece.sides], np.int64)
    lengths = np.array([len(piece.sides) for piece in pieces])
    weights, number = np.unique([complex(p.real, p.imag) for p in pieces], return_inverse=True)
    line, side = np.tile(sides, (count, 1)).T
    parts = Parts(
        np.zeros(count * len(pieces), np.int64),
        np.repeat(np.arange(count), len(pieces)),
        np.tile(weights[number.ravel()], count),
        np.append(0, np.tile(lengths, count).cumsum()),
        line,
        side,
    )
    none = np.zeros(0, np.int64)
    nothing = Runs(none, none, none, none.astype(np.complex128))
    rows = np.tile(number.ravel(), count)
    return CellLists(
        (1.0, 0.0),
        (-_FAR, -_FAR),
        (0.5 / _FAR, 0.5 / _FAR),
        (1, 1),
        np.ones(1, np.uint32),
        *_arrays_of(edges, tables, weights),
        first_rows(none, 1),
        run_rows(nothing, none),
        *cut_lists(parts, rows, 1, _lines_of(tables), edges, sign),
    )


def _lines_of(tables: Tables) -> Floats:
    names = ((x.dx, x.dy, x.offset, x.cluster, x.exact, x.px, x.py) for x in tables.lines)
    return np.array(list(names), np.float64)


def _arrays_of(
    edges: OutlineEdges, tables: Tables, weights: Complexes
) -> tuple[Floats, Floats, Floats]:
    """``edges``, ``edge_rest`` and ``weights`` of lists."""
    return (
        np.hstack([edges.start, edges.vector]),
        np.array([(e.area, e.real, e.imag) for e in tables.edges], np.float64),
        np.column_stack([weights.real, weights.imag]),
    )


class _Lists:
    """Sorts what the cells have found into lists."""

    def __init__(
        self, tables: Tables, edges: OutlineEdges, cells: Cells, sign: int, turn: Floats
    ) -> None:
        self.tables, self.edges, self.cells, self.sign, self.turn = tables, edges, cells, sign, turn
        self.lines = _lines_of(tables)
        self.pieces = np.array([shapely.Polygon(p.corners) for p in tables.pieces])
        self.tree = shapely.STRtree(self.pieces)
        self.weights = np.array([complex(p.real, p.imag) for p in tables.pieces])
        areas = shapely.area(self.pieces).sum()
        apart = shapely.union_all(self.pieces).area > (1 - _OVERLAP) * areas
        self.simple = tables.uniform and bool(apart)
        """Whether the field is 1 inside of all edges and 0 outside."""

    def result(self, angle: float) -> CellLists:
        cells = self.cells
        chains = Chains(self.edges, cells, self.sign, self.turn)
        part, raised = self._cut(chains)
        runs = Runs.joined([self._runs(chains.key), raised])
        weights, number = np.unique(np.concatenate([runs.weight, part.weight]), return_inverse=True)
        number = number.ravel()
        plain, special = cut_lists(
            part, number[len(runs.cell) :], len(cells), self.lines, self.edges, self.sign
        )
        scale = np.exp2(np.array(cells.bits)) / cells.size
        return CellLists(
            (float(np.cos(angle)), float(np.sin(angle))),
            (float(cells.low[0]), float(cells.low[1])),
            (float(scale[0]), float(scale[1])),
            (1 << cells.bits[0], 1 << cells.bits[1]),
            (cells.map() + 1).astype(np.uint32).ravel(),
            *_arrays_of(self.edges, self.tables, weights),
            first_rows(runs.cell, len(cells)),
            run_rows(runs, number[: len(runs.cell)]),
            plain,
            special,
        )

    # ---- edges as a whole --------------------------------------------------------------------

    def _runs(self, mixed: Numbers) -> Runs:
        """Runs of edges that no side cuts: between two that are cut, all are inside, or outside."""
        n = len(self.edges)
        base = n * np.arange(len(self.cells))[:, None]
        starts = np.sort(np.concatenate([(base + self.edges.rings[:-1]).ravel(), mixed + 1]))
        ends = np.sort(np.concatenate([(base + self.edges.rings[1:]).ravel(), mixed]))
        filled = starts < ends
        starts, ends = starts[filled], ends[filled]
        cell, first = starts // n, starts % n
        weight = self._field(self._points(cell, first, 0))
        inside = weight != 0
        return Runs(cell, first, first + (ends - starts), weight)[inside]

    def _points(self, cell: Numbers, edge: Numbers, choice: int) -> Floats:
        """A point (k, 2) of each edge in the other copy, at an offset of its cell."""
        offset = self.cells.points(_IN_CELL[choice])[cell] @ self.turn
        on_edge = self.edges.start[edge] + _ON_EDGE[choice] * self.edges.vector[edge]
        return offset + self.sign * on_edge

    def _field(self, points: Floats) -> Complexes:
        weight = np.zeros(len(points), np.complex128)
        for start in range(0, len(points), _CHUNK):
            part = slice(start, start + _CHUNK)
            row, piece = self.tree.query(shapely.points(points[part]), predicate="intersects")
            np.add.at(weight[part], row, self.weights[piece])
        size = np.abs(self.weights).max()
        return np.where(np.abs(weight) > _ROUNDING * size, weight, 0)

    def _constants(self, chains: Chains) -> Complexes:
        """The field on a track less the weights of all convex sets that it lies in."""
        unknown = np.ones(len(chains.key), np.bool_)
        if self.simple:
            # to the left of one convex chain the field is 1, to its right 0
            unknown = np.diff(chains.sets) != 1
            unknown[chains.owner[chains.right | (chains.weight != 1)]] = True
        (which,) = np.nonzero(unknown)
        result = np.zeros(len(chains.key), np.complex128)
        if len(which):
            result[which] = self._levels(chains, which)
        return np.where(np.abs(result) > _ROUNDING * np.abs(self.weights).max(), result, 0)

    def _levels(self, chains: Chains, which: Numbers) -> Complexes:
        n = len(self.edges)
        cell, edge = chains.key[which] // n, chains.key[which] % n
        sets, set_owner = ranges_of(chains.sets[which], chains.sets[which + 1])
        rows, row_set = ranges_of(chains.first[sets], chains.end[sets])
        side, owner = chains.side[rows], set_owner[row_set]
        dx, dy = self.edges.vector[side].T
        scale = np.hypot(dx, dy)
        points = np.stack([self._points(cell, edge, k) for k in range(len(_ON_EDGE))])
        clearance = np.full(points.shape[:2], np.inf)
        left = np.empty((len(points), len(rows)), np.bool_)
        for k in range(len(points)):
            away = points[k, owner] - self.edges.start[side]
            distance = (dx * away[:, 1] - dy * away[:, 0]) / scale
            left[k] = distance > 0
            np.minimum.at(clearance[k], owner, np.abs(distance))
        # of several points the one farthest from all lines, where no rounding can decide
        best = clearance.argmax(axis=0)
        result = self._field(points[best, np.arange(len(which))])
        inner = left[best[owner], np.arange(len(rows))] != chains.right[sets][row_set]
        outside = np.bincount(row_set, ~inner, len(sets)) > 0
        np.subtract.at(result, set_owner, np.where(outside, 0, chains.weight[sets]))
        return result

    # ---- parts of edges ----------------------------------------------------------------------

    def _cut(self, chains: Chains) -> tuple[Parts, Runs]:
        """Parts of edges inside convex sets, and edges as a whole to make up for the rest."""
        n = len(self.edges)
        constant, count = self._constants(chains), np.diff(chains.sets)
        turns_right = np.bincount(chains.owner, chains.right, len(chains.key)) > 0
        # where the field is 1 inside of all sets only, they are one convex set together
        joint = ~turns_right & (constant == 1 - count) & (count > 1) & self.simple
        joint &= np.bincount(chains.owner, chains.weight != 1, len(chains.key)) == 0
        begins = ~joint[chains.owner]
        begins[chains.sets[:-1]] = True
        (sets,) = np.nonzero(begins)
        rows, row_set = ranges_of(chains.first, chains.end)
        right, key, side = chains.right, chains.key[chains.owner[sets]], chains.side[rows]
        lengths = np.add.reduceat(chains.end - chains.first, sets) if len(sets) else sets
        parts = Parts(
            key // n,
            key % n,
            chains.weight[sets],
            np.append(0, lengths.cumsum()),
            self.edges.line[side],
            self.edges.side[side] * np.where(right[row_set], -1, 1),
        )
        whole = (constant != 0) & ~joint
        cell, edge = chains.key[whole] // n, chains.key[whole] % n
        return parts, Runs(cell, edge, edge + 1, constant[whole])
