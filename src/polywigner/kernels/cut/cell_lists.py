"""Cells of the offset of two copies of an outline, and the edges and pairs that each of them lists.

Each cell lists the edges that lie inside the other copy, and the pairs whose parallelograms meet
the cell, as rows along the rings: docs/theory/edges.md, (K1).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from polywigner.kernels.cut.pair_grid import (
    CROSSING,
    INSIDE,
    LEAD,
    ROUNDED,
    START,
    WHOLE,
    Array,
    Outline,
    PairGrid,
    crossing,
)
from polywigner.numerics.grid_arithmetic import accurate_cross

# An edge that meets none and is parallel to none: the partner of whole edges.
_NO_EDGE = (877.0, 512.375, 1.0, 0.28125)
# Pairs at a time: their temporaries stay in a cache.
_BLOCK = 1 << 15
# Far beyond rounding, in units of the frame: cells count as so much larger.
_MARGIN = 1e-12
# Levels are sums of weights, which rounding parts by less: whole numbers for uniform sources.
_NO_WEIGHT, _LEVELS = 1e-15, 2.0**50
# Finer cells have fewer pairs: 64 across leave a 30-gon some 4 in each (benchmarks/call_rates.py).
_ACROSS, _MOST_ROWS = 64, 1 << 21


class _Exact:
    """The operations of :func:`crossing` on NumPy arrays of float64."""

    select = staticmethod(np.where)

    @staticmethod
    def cross(ax: Any, ay: Any, bx: Any, by: Any) -> Any:
        rough = np.asarray(ax * by - ay * bx)
        near = np.abs(rough) < ROUNDED  # of vectors shorter than 8
        if near.any():
            rough[near] = accurate_cross(*(v[near] for v in (ax, ay, bx, by)))
        return rough


@dataclass(frozen=True)
class _Cells:
    """Squares of the plane of offsets; T = 0 is a corner of four."""

    size: float
    """A power of two, so that the cell of an offset on the grid is found exactly."""
    nx: int
    ny: int

    @classmethod
    def of(cls, reach: Array, across: int) -> _Cells:
        """Cells for |T| within ``reach`` (2,), so many or more along the longer side."""
        size = 2.0 ** math.floor(math.log2(2.0 * float(reach.max()) / across))
        nx, ny = (2 * (math.floor(float(r) / size) + 1) for r in reach)
        return cls(size, nx, ny)

    @property
    def count(self) -> int:
        return self.nx * self.ny

    @property
    def corner(self) -> Array:
        return -0.5 * self.size * np.array([self.nx, self.ny])

    def middle(self, cell: Array) -> tuple[Array, Array]:
        """The middle of each cell."""
        x, y = self.corner
        return x + self.size * (cell % self.nx + 0.5), y + self.size * (cell // self.nx + 0.5)


@lru_cache(maxsize=256)
def cells_across(first: Outline, second: Outline, samples: int) -> int:
    """Cells along the longer side that so many samples are worth, and that fit into memory."""
    size = float(_reach(first, second).max())
    vectors = [o.edges[:, 2:4] - o.vertices for o in (first, second)]
    long, other_long = (float(np.hypot(*v.T).sum()) for v in vectors)
    sides = sum(
        len(other) * float(np.abs(v).sum()) for v, other in zip(vectors, vectors[::-1], strict=True)
    )
    pairs = len(vectors[0]) * len(vectors[1])
    across = 2
    while across < _ACROSS:
        # parallelograms of edges in all directions, of areas |e| |f| 2/pi on the average
        finer = across / size
        rows = long * other_long * finer**2 * 2 / math.pi + sides * finer + pairs
        wanted = 4 * across * across < samples or rows < 2 * pairs
        if not wanted or rows > max(_MOST_ROWS, 2 * pairs):
            break
        across *= 2
    return across


def pair_grid(first: Outline, second: Outline, across: int) -> PairGrid:
    """The pairs of edges of the first outline and of copies {T - p} of the second, by cells.

    The second is the first one for W, and for A the first one turned, so that its copy is shifted.
    """
    cells = _Cells.of(_reach(first, second), across)
    far = max(float(np.abs(o.vertices[:, 0]).max()) for o in (first, second)) + first.step
    leads = _leads(first, far)
    edges, others = np.concatenate([first.edges, leads]), second.edges
    lists = _Lists(first, cells, edges, others)
    found = (lists.insides(), lists.rows())
    rows, cell = (np.concatenate(parts) for parts in zip(*found, strict=True))
    rows = rows[np.argsort(cell, kind="stable")]  # those inside come first
    table = np.array([[level.real, level.imag, 0.0, 0.0] for level in lists.numbers])
    ends = np.zeros((cells.count + 1, 4), np.uint32)
    counts = [np.bincount(where, minlength=cells.count) for _, where in found]
    ends[:-1, 2] = np.cumsum(counts[0] + counts[1])
    ends[:-1, 0] = ends[:-1, 2] - counts[0] - counts[1]
    ends[:-1, 1] = ends[:-1, 0] + counts[0]
    low, size = cells.corner, cells.size
    numbers = np.array([[*low, *-low, 1.0 / size, cells.nx, cells.count, first.step]], np.float64)
    no_edge = (*_NO_EDGE[:2], *np.add(_NO_EDGE[:2], _NO_EDGE[2:]), 0.0, 0.0, 0.0, 0.0)
    others = np.vstack([others, no_edge])
    for ends_of in (edges, others):  # differences on the grid are exact
        ends_of[:, 2:4] -= ends_of[:, :2]
    names = np.vstack([first.names, np.zeros((len(leads), 4), np.uint32)])
    return PairGrid(numbers, ends, rows, edges, others, names, table)


def _reach(first: Outline, second: Outline) -> Array:
    """The largest |T_x| and |T_y| at which copies meet."""
    both = (np.abs(outline.vertices).max(axis=0) for outline in (first, second))
    found: Array = np.maximum(sum(both), 1e-300)
    return found


def _leads(outline: Outline, far: float) -> Array:
    """(2 rings, 8) lines to the first vertex of each ring, from the left and from the right.

    The left one begins outside of the other copy where T_x >= 0, the right one where T_x < 0.
    """
    points = outline.vertices[outline.starts[:-1]]
    ends = np.repeat(points, 2, axis=0)
    starts = ends.copy()
    starts[:, 0] = np.tile([-far, far], len(points))
    return np.hstack([starts, ends, np.zeros((len(ends), 4))])


class _Lists:
    """Pairs of edges by cells; the pairs of one edge in one cell are a group.

    Winding numbers are those in the middle of a cell. That of the start of an edge changes within
    the cell only if the edge and the one before it have groups there.
    """

    def __init__(self, outline: Outline, cells: _Cells, edges: Array, others: Array) -> None:
        self.cells, self.starts, self.null = cells, outline.starts, len(others)
        self.count, self.rings = len(outline.vertices), len(outline.starts) - 1
        self.numbers: dict[complex, int] = {0.0: 0}
        """The number of each level."""
        parts = zip(*_meeting(cells, edges, others, self.count), strict=True)
        cell, edge, other = (np.concatenate(part) for part in parts)
        order = np.argsort(cell * len(edges) + edge, kind="stable")
        cell, edge, other = (part.take(order) for part in (cell, edge, other))
        middle, ends = cells.middle(cell), (_rows(edges, edge), _rows(others, other))
        own, against = ((ax, ay, bx - ax, by - ay) for ax, ay, bx, by in ends)
        meets, enters, *_ = crossing(_Exact, own, against, *middle)
        weights = others[:, 5] + 1j * others[:, 6]
        self.unit = float(abs(weights).max(initial=0.0)) or 1.0
        # of any weights, sums over many cells would round
        exact = np.complex128 if (weights == 1.0).all() else np.clongdouble
        jump = weights.take(other).astype(exact) * (meets * (2 * enters - 1))
        is_own, is_lead = edge < self.count, edge >= self.count
        at = cell[is_lead] * self.rings + (edge[is_lead] - self.count) // 2
        self.leads = at, edge[is_lead], other[is_lead]
        self.at_start = np.zeros(cells.count * self.rings, exact)
        """Level of the first vertex of each ring, by cell and ring."""
        np.add.at(self.at_start, at, jump[is_lead])
        touches = _touches(cells, *ends, *middle)[is_own]
        self.edge, self.other, self.jump = (p[is_own] for p in (edge, other, jump))
        self._group(cell[is_own], touches, outline.following)

    def _group(self, cell: Array, touches: Array, following: Array) -> None:
        key = cell * self.count + self.edge
        self.first = np.flatnonzero(np.diff(key, prepend=-1))
        """The first pair of each group."""
        self.group = np.repeat(np.arange(len(self.first)), np.diff([*self.first, len(key)]))
        """The group of each pair."""
        key, self.group_edge = key[self.first], self.edge[self.first]
        ring_of = np.repeat(np.arange(self.rings), np.diff(self.starts))
        self.at = cell[self.first] * self.rings + ring_of[self.group_edge]
        """Cell and ring of each group."""
        self.head = np.diff(self.at, prepend=-1) != 0
        """Whether a group is the first of its cell and ring."""
        if not len(key):
            self.before = self.after = self.changes = self.head
            return
        total = np.add.reduceat(self.jump, self.first)
        sums = np.cumsum(total)
        base = (sums - total)[self.head] - self.at_start[self.at[self.head]]
        self.after = sums - base[np.cumsum(self.head) - 1]
        self.before = self.after - total
        """Levels of the start and the end of each group's edge."""
        preceding = np.empty_like(following)
        preceding[following] = np.arange(self.count)
        place = self._place(key, key - self.group_edge + preceding[self.group_edge])
        self.changes = np.logical_or.reduceat(touches, self.first) & (place >= 0)
        """Whether the level of the start may change within the cell."""

    def _place(self, key: Array, wanted: Array) -> Array:
        """Where keys are found, or -1."""
        place = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        return np.where(key[place] == wanted, place, -1)

    def insides(self) -> tuple[Array, Array]:
        """Edges that no edge of the other copy meets, whatever T in the cell, and inside of it.

        An edge with a group goes with those before it if the winding number of its start does not
        change: its pairs tell from where on it has another one.
        """
        first, end = self.starts[:-1], self.starts[1:]
        tail = np.append(self.head[1:], True)[: len(self.head)]
        own = self.group_edge + ~self.changes
        to_next = np.where(tail, end[self.at % self.rings], np.append(own, 0)[1:][: len(own)])
        (quiet,) = np.nonzero(np.bincount(self.at, minlength=len(self.at_start)) == 0)
        head = self.at[self.head]
        at = np.concatenate([quiet, head, self.at])
        low = np.concatenate([first[np.append(quiet, head) % self.rings], self.group_edge + 1])
        high = np.concatenate([end[quiet % self.rings], own[self.head], to_next])
        level = np.concatenate([self.at_start[quiet], self.before[self.head], self.after])
        kept = (high > low) & (abs(level) > _NO_WEIGHT * self.unit)
        counts = (high - low)[kept]
        run = np.repeat(np.arange(len(counts)), counts)
        edge = low[kept][run] + np.arange(len(run)) - (np.cumsum(counts) - counts)[run]
        table = _table(edge, self.null, INSIDE, self._number(level[kept])[run])
        order = np.lexsort((edge, at[kept][run]))
        return table[order], at[kept][run][order] // self.rings

    def rows(self) -> tuple[Array, Array]:
        """All pairs, along the rings, and edges whose start has a number that changes."""
        how = np.full(len(self.edge), CROSSING)
        how[self.first[~self.changes]] = START
        pairs = _table(self.edge, self.other, how, self._number(self.before[self.group]))
        whole = np.flatnonzero(self.changes)
        wholes = _table(self.group_edge[whole], self.null, WHOLE, 0)
        # rings whose first vertex changes: its number is that of the crossings on the way to it
        first = self.starts[:-1]
        led = self.at[self.head & self.changes & (self.group_edge == first[self.at % self.rings])]
        heads = _table(first[led % self.rings], self.null, START, 0)
        lead_at, edge, other = self.leads
        mine = np.isin(lead_at, led)
        leads = _table(edge[mine], other[mine], LEAD, 0)
        # by cell and ring; there the way to the ring, and then by edge, whole edges first
        at = np.concatenate([led, lead_at[mine], self.at[whole], self.at[self.group]])
        way = [np.full(len(led), -2), np.full(len(leads), -1)]
        place = np.concatenate([*way, 2 * self.group_edge[whole], 2 * self.edge + 1])
        order = np.lexsort((place, at))
        return np.concatenate([heads, leads, wholes, pairs])[order], at[order] // self.rings

    def _number(self, level: Array) -> Array:
        """The numbers of levels, those equal up to rounding as one."""
        scale = _LEVELS / self.unit
        _, first, found = np.unique(np.rint(level * scale), return_index=True, return_inverse=True)
        values = [complex(v) if abs(v) > _NO_WEIGHT * self.unit else 0.0 for v in level[first]]
        numbers = [self.numbers.setdefault(value, len(self.numbers)) for value in values]
        return np.array(numbers, np.uint32)[found]


def _table(*columns: Any) -> Array:
    found = np.empty((len(columns[0]), len(columns)), np.uint32)
    for number, column in enumerate(columns):
        found[:, number] = column
    return found


def _rows(table: Array, number: Array) -> tuple[Array, ...]:
    """The columns of some rows."""
    return tuple(column.take(number) for column in table.T[:4])


def _meeting(
    cells: _Cells, edges: Array, others: Array, own: int
) -> Iterator[tuple[Array, Array, Array]]:
    """(cell, edge, other edge) wherever the parallelogram of two edges meets a cell; by blocks.

    Edges from ``own`` on are lines from the left and the right,
    each for its half of the cells.
    """
    step = max(1, _BLOCK // len(others))
    c, d = others[:, :2], others[:, 2:4]
    for start in range(0, len(edges), step):
        number = np.arange(start, min(start + step, len(edges)))
        a, b = edges[number, None, :2], edges[number, None, 2:4]
        low = (np.minimum(a, b) + np.minimum(c, d) - cells.corner) / cells.size
        high = (np.maximum(a, b) + np.maximum(c, d) - cells.corner) / cells.size
        least, most = np.zeros((len(number), 1, 2)), np.full((len(number), 1, 2), cells.ny - 1.0)
        most[..., 0] = cells.nx - 1.0
        is_lead, is_right = number >= own, (number - own) % 2 == 1
        least[is_lead & ~is_right, :, 0] = cells.nx // 2
        most[is_lead & is_right, :, 0] = cells.nx // 2 - 1
        low, high = np.maximum(np.floor(low), least), np.minimum(np.floor(high), most)
        spans = np.maximum(high - low + 1.0, 0.0).astype(np.int64).reshape(-1, 2)
        counts = spans.prod(axis=1)
        pair = np.repeat(np.arange(len(counts)), counts)
        place = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
        row, column = np.divmod(place, spans[:, 0].take(pair))
        x, y = _rows(low.astype(np.int64).reshape(-1, 2), pair)
        cell = (y + row) * cells.nx + x + column
        meets = _near(cells, a, b, c, d, pair, cell)
        pair = pair[meets]
        i, j = np.divmod(pair, len(others))
        yield cell[meets], number.take(i), j


def _near(cells: _Cells, a: Array, b: Array, c: Array, d: Array, pair: Array, cell: Array) -> Array:
    """Whether cells meet the parallelograms of pairs, whose boxes they meet."""
    e, f, middle = b - a, d - c, 0.5 * (a + b + c + d).reshape(-1, 2)
    half = 0.5 * cells.size
    (x, y), (px, py) = cells.middle(cell), _rows(middle, pair)
    x, y = x - px, y - py
    area = 0.5 * abs(e[..., 0] * f[:, 1] - e[..., 1] * f[:, 0])
    meets = np.ones(len(cell), bool)
    for vector in (e, f):
        u, v = (np.broadcast_to(vector[..., k], area.shape).ravel() for k in range(2))
        size = half * (abs(u) + abs(v))
        level = abs(u.take(pair) * y - v.take(pair) * x)
        meets &= level <= (area.ravel() + size + _MARGIN).take(pair)
    return meets


def _touches(cells: _Cells, edge: Any, other: Any, x: Array, y: Array) -> Array:
    """Whether cells meet the sides on which the start of the first edge is on the other one."""
    (ax, ay, _, _), (cx, cy, dx, dy) = edge, other
    half, fx, fy = 0.5 * cells.size, dx - cx, dy - cy
    px, py = x - (ax + 0.5 * (cx + dx)), y - (ay + 0.5 * (cy + dy))
    inside = abs(px) <= 0.5 * abs(fx) + half + _MARGIN
    inside &= abs(py) <= 0.5 * abs(fy) + half + _MARGIN
    return inside & (abs(fx * py - fy * px) <= half * (abs(fx) + abs(fy)) + _MARGIN)
