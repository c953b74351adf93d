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

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from polywigner.kernels.cell_tree import Cells, Segments, divided
from polywigner.kernels.clipping import NEARLY_PARALLEL
from polywigner.kernels.lattice import accurate_cross
from polywigner.kernels.tables import Edge, Tables

__all__ = ["GATE", "GATE_EXACT", "CellLists", "CutList", "cell_lists"]

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Numbers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

# Kinds of cuts in a long row: a crossing of lines, or a comparison that decides on which side of
# a parallel line an edge lies, by levels or by exact distances.
GATE, GATE_EXACT = 1.0, 2.0
# A cell is small enough if it has fewer cuts than this, or than one to so many edges: they then
# cost less than the whole edges do.
_FEW_CUTS, _EDGES_PER_CUT = 6, 8
# Generic fractions of an edge and of a cell, where no edge ends and no sides meet by design
_ON_EDGE = (0.4863917, 0.2718356, 0.7236281)
_IN_CELL = ((0.5127639, 0.4718352), (0.3819221, 0.6180467), (0.6366198, 0.3678794))
# The cells reach further than the copies touch, by this fraction of their size
_RIM = 0.002
# Area, as a fraction, that pieces may have in common and still count as disjoint
_OVERLAP = 1e-9
# A sum of weights below this fraction of them is zero
_ROUNDING = 1e-12
# What lies to the left of sides that turn left by half a turn at most, the first and the last
# prolonged, is what lies to the left of each. A little more, and the two meet far outside.
_HALF_TURN = np.pi + 1e-9
# Vertices on one line up to this distance do not turn: the area at stake is below rounding.
_STRAIGHT = 4e-16
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
    """Of the map, in x and y."""
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
    """The same in the memory of engines."""

    @property
    def nbytes(self) -> int:
        """Memory of the lists, in float64."""
        arrays: list[npt.NDArray[Any]] = [self.map, self.edges, self.first_run, self.runs]
        for cuts in (self.plain, self.special):
            arrays += [cuts.first, cuts.records, cuts.cuts]
        return sum(array.nbytes for array in arrays)


@lru_cache(maxsize=32)
def cell_lists(tables: Tables, sign: int) -> CellLists:
    """The lists for edges that lie at ``O + sign (a + t e)`` in the other copy."""
    edges = _Edges.of(tables.edges)
    angle = _main_direction(edges.vector)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corners = edges.start @ turn.T
    low = corners.min(axis=0) - (sign * corners).max(axis=0)
    high = corners.max(axis=0) - (sign * corners).min(axis=0)
    # beyond the cells the copies are apart; where they touch, both see the same
    rim = _RIM * (high - low)
    enough = max(_FEW_CUTS, len(edges) // _EDGES_PER_CUT)
    segments = edges.segments.turned(turn)
    cells = divided(segments, segments, sign, (low - rim, high + rim), enough)
    cells = _with_sides_beyond(edges, cells, sign, turn)
    return _Lists(tables, edges, cells, sign, turn).result(angle)


def _main_direction(vectors: Floats) -> float:
    """The angle, modulo a right angle, at which edges have the greatest length."""
    angles = np.arctan2(vectors[:, 1], vectors[:, 0]) % (np.pi / 2)
    bins = np.round(angles * 1e6).astype(np.int64)
    _, which = np.unique(bins, return_inverse=True)
    lengths = np.bincount(which.ravel(), np.hypot(*vectors.T))
    if lengths.max() < 2 * lengths.min():
        return 0.0
    return float(angles[which.ravel() == lengths.argmax()][0])


@dataclass(frozen=True)
class _Edges:
    """The edges as arrays, (n, 2) or (n,); they are the sides of the other copy as well."""

    start: Floats
    vector: Floats
    offset: Floats
    cluster: Floats
    weight: Complexes
    line: Numbers
    side: Numbers
    rings: Numbers
    """The first edge of each ring, and n."""

    @classmethod
    def of(cls, edges: Sequence[Edge]) -> _Edges:
        floats = np.array([(e.ax, e.ay, e.ex, e.ey, e.offset, e.cluster) for e in edges])
        numbers = np.array([(e.line, e.side) for e in edges], np.int64)
        weight = np.array([complex(e.real, e.imag) for e in edges])
        starts = [(e.ax, e.ay) for e in edges]
        first = [0]
        for k, edge in enumerate(edges):
            if (edge.bx, edge.by) == starts[first[-1]]:
                first.append(k + 1)
        return cls(
            floats[:, :2], floats[:, 2:4], floats[:, 4], floats[:, 5], weight,
            numbers[:, 0], numbers[:, 1], np.array(first),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.start)

    @property
    def segments(self) -> Segments:
        return Segments(self.start + self.vector / 2, self.vector / 2)

    @cached_property
    def before(self) -> Numbers:
        """The number of the edge before each."""
        before = np.arange(-1, len(self) - 1)
        before[self.rings[:-1]] = self.rings[1:] - 1
        return before

    @cached_property
    def next(self) -> Numbers:
        """The number of the edge after each."""
        return np.argsort(self.before)

    @property
    def turns(self) -> Floats:
        """The angle by which the outline turns to the left where each edge begins."""
        (ex, ey), (fx, fy) = self.vector[self.before].T, self.vector.T
        cross = accurate_cross(ex, ey, fx, fy)
        longer = np.maximum(np.hypot(ex, ey), np.hypot(fx, fy))
        ahead = ex * fx + ey * fy
        straight = (np.abs(cross) <= _STRAIGHT * longer) & (ahead > 0)
        return np.where(straight, 0.0, np.arctan2(cross, ahead))


@dataclass
class _Parts:
    """Parts of edges in cells: inside of all of the lines given, on the side given, of each."""

    cell: Numbers
    edge: Numbers
    weight: Complexes
    first: Numbers
    """(k + 1,) the first line of each part."""
    line: Numbers
    side: Numbers


class _Lists:
    """Sorts what the cells have found into lists."""

    def __init__(
        self, tables: Tables, edges: _Edges, cells: Cells, sign: int, turn: Floats
    ) -> None:
        self.tables, self.edges, self.cells, self.sign, self.turn = tables, edges, cells, sign, turn
        self.lines = np.array(
            [(x.dx, x.dy, x.offset, x.cluster, x.exact, x.px, x.py) for x in tables.lines]
        )
        self.pieces = np.array([shapely.Polygon(p.corners) for p in tables.pieces])
        self.tree = shapely.STRtree(self.pieces)
        self.weights = np.array([complex(p.real, p.imag) for p in tables.pieces])
        areas = shapely.area(self.pieces).sum()
        apart = shapely.union_all(self.pieces).area > (1 - _OVERLAP) * areas
        self.simple = tables.uniform and bool(apart)
        """Whether the field is 1 inside of all edges and 0 outside."""

    def result(self, angle: float) -> CellLists:
        cells = self.cells
        chains = _Chains(self.edges, cells, self.sign, self.turn)
        part, raised = self._cut(chains)
        runs = _Runs.joined([self._runs(chains.key), raised])
        weights, number = np.unique(np.concatenate([runs.weight, part.weight]), return_inverse=True)
        number = number.ravel()
        first_run, run_rows = self._run_rows(runs, number[: len(runs.cell)])
        plain, special = self._cut_lists(part, number[len(runs.cell) :])
        scale = np.exp2(np.array(cells.bits)) / cells.size
        return CellLists(
            (float(np.cos(angle)), float(np.sin(angle))),
            (float(cells.low[0]), float(cells.low[1])),
            (float(scale[0]), float(scale[1])),
            (1 << cells.bits[0], 1 << cells.bits[1]),
            (cells.map() + 1).astype(np.uint32).ravel(),
            np.hstack([self.edges.start, self.edges.vector]),
            np.array([(e.area, e.real, e.imag) for e in self.tables.edges], np.float64),
            np.column_stack([weights.real, weights.imag]),
            first_run,
            run_rows,
            plain,
            special,
        )

    # ---- edges as a whole --------------------------------------------------------------------

    def _runs(self, mixed: Numbers) -> _Runs:
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
        return _Runs(cell, first, first + (ends - starts), weight)[inside]

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

    def _constants(self, chains: _Chains) -> Complexes:
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

    def _levels(self, chains: _Chains, which: Numbers) -> Complexes:
        n = len(self.edges)
        cell, edge = chains.key[which] // n, chains.key[which] % n
        sets, set_owner = _ranges(chains.sets[which], chains.sets[which + 1])
        rows, row_set = _ranges(chains.first[sets], chains.end[sets])
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

    def _cut(self, chains: _Chains) -> tuple[_Parts, _Runs]:
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
        rows, row_set = _ranges(chains.first, chains.end)
        right, key, side = chains.right, chains.key[chains.owner[sets]], chains.side[rows]
        lengths = np.add.reduceat(chains.end - chains.first, sets) if len(sets) else sets
        parts = _Parts(
            key // n,
            key % n,
            chains.weight[sets],
            np.append(0, lengths.cumsum()),
            self.edges.line[side],
            self.edges.side[side] * np.where(right[row_set], -1, 1),
        )
        whole = (constant != 0) & ~joint
        cell, edge = chains.key[whole] // n, chains.key[whole] % n
        return parts, _Runs(cell, edge, edge + 1, constant[whole])

    # ---- packing -----------------------------------------------------------------------------

    def _first(self, cell: Numbers) -> npt.NDArray[np.uint32]:
        """(cells + 2,) where the rows of each cell begin; the cell outside comes first."""
        return np.searchsorted(cell + 1, np.arange(len(self.cells) + 2)).astype(np.uint32)

    def _run_rows(
        self, runs: _Runs, number: Numbers
    ) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint32]]:
        packed = np.column_stack([runs.first, runs.end, number, np.zeros_like(number)])
        return self._first(runs.cell), packed.astype(np.uint32)

    def _cut_lists(self, parts: _Parts, number: Numbers) -> tuple[CutList, CutList]:
        owner = np.repeat(np.arange(len(parts.cell)), np.diff(parts.first))
        rows, unusual_row = np.empty((len(owner), 8)), np.empty(len(owner), np.bool_)
        for start in range(0, len(owner), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            edge, line, side = parts.edge[owner[chunk]], parts.line[chunk], parts.side[chunk]
            rows[chunk], unusual_row[chunk] = self._long_rows(edge, line, side)
        unusual = np.zeros(len(parts.cell), np.bool_)
        unusual[owner[unusual_row]] = True
        lists = []
        for chosen in (~unusual, unusual):
            (mine,) = np.nonzero(chosen)
            mine = mine[np.argsort(parts.cell[mine], kind="stable")]
            own, _ = _ranges(parts.first[mine], parts.first[mine + 1])
            end = (parts.first[mine + 1] - parts.first[mine]).cumsum()
            first = np.append(0, end)[:-1]
            table = rows[own] if chosen is unusual else _short_rows(rows[own])
            packed = np.column_stack([parts.edge[mine], first, end, number[mine]])
            lists.append(CutList(self._first(parts.cell[mine]), packed.astype(np.uint32), table))
        return lists[0], lists[1]

    def _long_rows(self, edge: Numbers, line: Numbers, side: Numbers) -> tuple[Floats, Flags]:
        """(c, 8): direction d, a point o of the line as seen from the edge, factor, level, ...

        With the distance ``d x (O + o)``, a crossing lies at t = distance times factor. A gate
        compares ``d x O`` to the level, or the distance to 0. (For crossings the level is the
        distance at O = 0.) Then the kind, and whether the edge is inside from the cut on. Also
        whether the row must be used as it is, and not as a short one.
        """
        dx, dy, offset, cluster, exact, px, py = self.lines[line].T
        (ax, ay), (ex, ey) = self.edges.start[edge].T, self.edges.vector[edge].T
        together = cluster == self.edges.cluster[edge]
        slope = dx * ey - dy * ex
        close = together & (exact > 0)
        slope[close] = accurate_cross(dx[close], dy[close], ex[close], ey[close])
        parallel = together & ((exact == 0) | (slope == 0))
        size = (dx**2 + dy**2) * (ex**2 + ey**2)
        nearly = close & (slope**2 < NEARLY_PARALLEL**2 * size)
        kind = np.where(parallel, np.where(exact > 0, GATE_EXACT, GATE), 0.0)
        s = self.sign
        factor = -s / np.where(parallel, 1.0, slope)
        rising = parallel | (slope * s > 0)
        start = s * (dx * ay - dy * ax) - offset
        level = np.where(parallel, offset - s * self.edges.offset[edge], start)
        rows = np.column_stack(
            [dx, dy, s * ax - px, s * ay - py, factor, level, kind, rising == (side > 0)]
        )
        return rows, parallel | nearly


def _short_rows(rows: Floats) -> Floats:
    dx, dy, _, _, factor, start, _, begins = rows.T
    return np.column_stack([-dy * factor, dx * factor, start * factor, begins])


@dataclass
class _Runs:
    """Consecutive edges, from first to end, inside something of one weight in a cell."""

    cell: Numbers
    first: Numbers
    end: Numbers
    weight: Complexes

    def __getitem__(self, chosen: Flags) -> _Runs:
        return _Runs(self.cell[chosen], self.first[chosen], self.end[chosen], self.weight[chosen])

    @classmethod
    def joined(cls, runs: Sequence[_Runs]) -> _Runs:
        """All of them in order; one for two where the second goes on where the first ends."""
        names = ("cell", "first", "end", "weight")
        every = cls(*(np.concatenate([getattr(r, name) for r in runs]) for name in names))
        order = np.lexsort((every.first, every.cell))
        cell, first, end, weight = (getattr(every, name)[order] for name in names)
        goes_on = (cell[1:] == cell[:-1]) & (first[1:] == end[:-1]) & (weight[1:] == weight[:-1])
        begins = np.append(True, ~goes_on)[: len(cell)]
        ends = np.append(~goes_on, True)[-len(cell) :] if len(cell) else begins
        return cls(cell[begins], first[begins], end[ends], weight[begins])


def _ranges(first: Numbers, end: Numbers) -> tuple[Numbers, Numbers]:
    """All numbers from each first up to its end, and which range each is from."""
    lengths = end - first
    owner = np.repeat(np.arange(len(first)), lengths)
    return np.arange(len(owner)) + (first - (lengths.cumsum() - lengths))[owner], owner


class _Chains:
    """The sides that each edge meets in each cell, as the bounds of convex sets.

    Neighbours are a chain, and the chain's jump of the field is the sum of those of its parts that
    turn one way, with their ends prolonged, less that of the line of each side that two such parts
    have in common. A part bounds a convex set: to its left, or if it turns to the right, to its
    right, where its weight counts negative.
    """

    key: Numbers
    """(g,) cell * n + edge of each edge that meets any side, ascending."""
    sets: Numbers
    """(g + 1,) the first set of each."""
    owner: Numbers
    """(c,) which edge in which cell each set is for."""
    first: Numbers
    """(c,) the first row of each set, and the end of its rows."""
    end: Numbers
    side: Numbers
    """(r,) the side of each row."""
    weight: Complexes
    """(c,) the field inside of a set."""
    right: Flags
    """(c,) whether a set lies to the right of its sides."""

    def __init__(self, edges: _Edges, cells: Cells, sign: int, turn: Floats) -> None:
        key, self.side, chain, whole = _neighbours(edges, cells)
        new_key = np.append(True, key[1:] != key[:-1])[: len(key)]
        self.key = key[new_key]
        starts = np.append(True, chain[1:] != chain[:-1])[: len(chain)]
        ends = np.append(starts[1:], True)[: len(chain)]
        # a part is known by its first row, and the last
        first, last, right = self._one_way(edges, starts)
        before = ~starts[first]
        after = ~ends[last]
        # R, whose ends are common with others: the two half-planes, less what they have in common
        folded = right & (last == first + 1) & (before | after)
        own = key[last] // len(edges), key[last] % len(edges)
        track, corner = edges.segments.turned(turn), edges.start[self.side[last]] @ turn.T
        half = track.half[own[1]]
        seen = cells.meet(own[0], corner - sign * track.middle[own[1]], half, 0 * half)
        # the lines of common sides, one less for each, and one more for each half-plane
        joint = np.flatnonzero(before)
        extra = folded[joint].astype(int) + folded[joint - 1] - 1
        lines = [(first[joint], extra), (np.flatnonzero(starts & ends), 1)]
        lines += [(first[folded & ~before], 1), (last[folded & ~after], 1)]
        # of a whole ring, the first side is the last as well
        lines.append((np.flatnonzero(starts & whole[chain]), -1))
        kept = seen | ~folded
        line = np.concatenate([rows for rows, _ in lines])
        times = np.concatenate([np.broadcast_to(sign_, len(rows)) for rows, sign_ in lines])
        line, times = line[times != 0], times[times != 0]
        first, end = np.append(first[kept], line), np.append(last[kept], line) + 1
        times = np.append(np.where(right[kept], -1, 1), times)
        right = np.append((right & ~folded)[kept], np.zeros(len(line), np.bool_))
        owner = (np.cumsum(new_key) - 1)[first]
        order = np.argsort(owner, kind="stable")
        self.first, self.end, self.owner = first[order], end[order], owner[order]
        self.right = right[order]
        self.weight = times[order] * edges.weight[self.side[self.first]]
        self.sets = np.searchsorted(self.owner, np.arange(len(self.key) + 1))

    def _one_way(self, edges: _Edges, starts: Flags) -> tuple[Numbers, Numbers, Flags]:
        """First and last row of each part of a chain that turns one way, and whether right."""
        # a vertex is known by the row of the side after it
        (vertex,) = np.nonzero(~starts)
        turn = edges.turns[self.side[vertex]]
        right = _filled(np.sign(turn)) < 0
        goes_on = (vertex[1:] == vertex[:-1] + 1) & (right[1:] == right[:-1])
        begins = _up_to(np.cumsum(np.abs(turn)), np.append(True, ~goes_on)[: len(vertex)])
        ends = np.append(begins[1:], True)[: len(vertex)]
        return vertex[begins] - 1, vertex[ends], right[begins]


def _with_sides_beyond(edges: _Edges, cells: Cells, sign: int, turn: Floats) -> Cells:
    """Cells that list the next side as well wherever a listed one ends on the track.

    A side that ends at the rim of a track may be found there, by rounding, and the next one not.
    Its prolongation would cut the track where the outline has turned off. Tracks are a little
    wider here than where sides were found: of those that end beyond, nothing comes back.
    """
    n, corner = len(edges), edges.start @ turn.T
    middle = edges.segments.turned(turn).middle
    half = edges.segments.turned(turn).half
    key, side = cells.cell.astype(np.int64) * n + cells.edge, cells.side.astype(np.int64)
    listed = key * n + side  # ascending
    new = listed
    while len(new):
        found = []
        for beyond, forward in ((edges.next, True), (edges.before, False)):
            key, side = new // n, new % n
            other = beyond[side]
            wanted = key * n + other
            missing = listed[np.searchsorted(listed, wanted) % len(listed)] != wanted
            key, side, wanted = key[missing], side[missing], wanted[missing]
            vertex = corner[other[missing] if forward else side]
            cell, edge = key // n, key % n
            h = half[edge]
            seen = cells.meet(cell, vertex - sign * middle[edge], h, np.zeros_like(h))
            found.append(wanted[seen])
        new = np.unique(np.concatenate(found))
        listed = np.union1d(listed, new) if len(new) else listed
    key, side = listed // n, listed % n
    return replace(cells, cell=key // n, edge=key % n, side=side)


def _neighbours(edges: _Edges, cells: Cells) -> tuple[Numbers, Numbers, Numbers, Flags]:
    """Key, side, and number of the chain of each row; whether a chain is a whole ring.

    Chains are in one piece, in their order; a whole ring ends with the side it begins with.
    """
    n = len(edges)
    key, side = cells.cell.astype(np.int64) * n + cells.edge, cells.side
    ring = np.repeat(np.arange(len(edges.rings) - 1), np.diff(edges.rings))
    follows = (key[1:] == key[:-1]) & (side[1:] == side[:-1] + 1)
    follows &= ring[side[1:]] == ring[side[:-1]]
    label = np.cumsum(np.append(True, ~follows)[: len(key)]) - 1
    # a chain that reaches the last side of a ring goes on at the first
    pair = key * len(edges.rings) + ring[side]
    (at_first,) = np.nonzero(np.isin(side, edges.rings[:-1]))
    (at_last,) = np.nonzero(np.isin(side, edges.rings[1:] - 1))
    _, first, last = np.intersect1d(pair[at_first], pair[at_last], return_indices=True)
    own = np.arange(label[-1] + 1 if len(label) else 0)
    own[label[at_first[first]]] = label[at_last[last]]
    moved = label != own[label]
    order = np.lexsort((np.arange(len(label)), moved, own[label], key))
    key, side, chain = key[order], side[order], own[label][order]
    size = np.bincount(chain)
    starts = np.flatnonzero(np.append(True, chain[1:] != chain[:-1])[: len(chain)])
    first = np.zeros(len(size), np.int64)
    first[chain[starts]] = starts
    whole = size == np.diff(edges.rings)[ring[side[first]]] if len(side) else size > 0
    (again,) = np.nonzero(whole[chain[starts]])
    ends = np.append(starts[1:], len(chain))[again]
    key, side, chain = (np.insert(a, ends, a[starts[again]]) for a in (key, side, chain))
    return key, side, chain, whole


def _up_to(angle: Floats, begins: Flags) -> Flags:
    """Where parts begin that turn by half a turn at most, as many vertices in each as can be.

    ``angle``: all that is turned up to each vertex; ``begins``: where a part has to.
    """
    result = begins.copy()
    (first,) = np.nonzero(begins)
    last = np.append(first[1:], len(begins))
    turned = np.append(0.0, angle)
    while len(first):
        first = np.searchsorted(angle, turned[first] + _HALF_TURN, side="right")
        inside = first < last
        first, last = first[inside], last[inside]
        result[first] = True
    return result


def _filled(signs: Floats) -> Floats:
    """Signs, with that of the one before where there is none, for which either is right."""
    known = np.maximum.accumulate(np.where(signs != 0, np.arange(len(signs)), 0))
    return signs[known] if len(signs) else signs
