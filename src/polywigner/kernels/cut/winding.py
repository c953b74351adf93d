"""Sums over the boundary of a slice: the parts of edges of one copy that lie inside the other.

The weight of an edge is the winding number of its start in the other copy, kept running along its
ring; each crossing with an edge of the other copy adds 1 or -1 from there to the edge's end
(docs/theory/edges.md, (K1)). In a collection the winding number of each element counts as often as
its weight says. All that is told of an outline is data, so that one compiled loop serves all.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED, Clipper, View
from polywigner.kernels.cut.pair_grid import (
    LEAD,
    START,
    WHOLE,
    CrossProducts,
    PairGrid,
    cells_across,
    crossing,
    outline_of,
    pair_grid,
)
from polywigner.kernels.outline.constants import Edge, Piece
from polywigner.kernels.outline.tables import Tables

Pass = tuple[View, int, int]
"""View of edges, number of their field, and number of the other copy's field."""
Interval = tuple[Any, Any, Any, Any]
Level = tuple[Any, ...]
Array = npt.NDArray[Any]

# Where nobody knows how many samples there will be; as many as NumPy is called with.
_MANY, _SOME = 1 << 20, 1 << 9
# Lists that are kept, of all sources; engines have copies of as much.
_MOST_BYTES = 1 << 27


def clipper_for(
    ops: Any, tables: Tables, tx: Any, ty: Any, *views: View, arguments: tuple[Any, ...] = ()
) -> Clipper:
    """Return the clipper that suits the number of edges and the engine.

    ``arguments``: of the kernel; NaN in them gives NaN in the sums.
    """
    # Dr.Jit has no derivatives of nested loops
    if ops.needs_gradient(tx, ty, *arguments) or (ops.target == "compiled" and tables.fits_code):
        return Clipper(ops, tables, tx, ty)
    return PairClipper(ops, tables, tx, ty, views, arguments)


def pairs_of(tables: Tables, key: Pass, double: bool, samples: int = 0) -> PairGrid:
    """Return the lists of pairs of edges for so many samples; the latest lists are kept."""
    view, group, other = key
    first, second = (outline_of(tables, number, double) for number in (group, other))
    second = second if view is MIRRORED else second.turned
    across = cells_across(first, second, 1 << (samples or _MANY).bit_length())
    name = view.point, group, other, double, across  # AHEAD has the lists of BEHIND
    found: PairGrid | None = tables.pairs.get(name)
    if found is None:
        found = tables.pairs.setdefault(name, pair_grid(first, second, across))
        _kept.append((tables.pairs, name, found.nbytes))
        while sum(size for *_, size in _kept) > _MOST_BYTES and len(_kept) > 1:
            pairs, oldest, _ = _kept.popleft()
            pairs.pop(oldest, None)
    return found


_kept: deque[tuple[dict[Any, Any], Hashable, int]] = deque()
"""Owner, key and size of each list, oldest first."""


def held_pairs(ops: Any, tables: Tables, key: Pass, samples: int = 0) -> PairGrid:
    """Lists of pairs of edges in the memory of an engine."""
    grid = pairs_of(tables, key, ops.double, samples)
    if ops.key not in grid.copies:
        grid.copies.setdefault(ops.key, grid.held(ops.held))  # in all threads the same
    return grid.copies[ops.key]


def cell_of(ops: Any, pair: PairGrid, tx: Any, ty: Any) -> Any:
    """The number of the cell of an offset on the grid; an empty one's outside of all cells."""
    x0, y0, x1, y1, per_unit, across, empty, _ = ops.gather(pair.numbers, ops.truncated(0.0))
    inside = (tx >= x0) & (tx < x1) & (ty >= y0) & (ty < y1)
    column, row = (
        ops.truncated(ops.select(inside, (t - low) * per_unit, 0.0))
        for t, low in ((tx, x0), (ty, y0))
    )
    return ops.select_number(inside, row * ops.truncated(across) + column, ops.truncated(empty))


def _snapped(ops: Any, pair: PairGrid, *offset: Any) -> tuple[Any, ...]:
    """An offset on the grid of the vertices."""
    *_, step = ops.gather(pair.numbers, ops.truncated(0.0))
    return tuple(ops.snapped(t, step) for t in offset)


class PairClipper(Clipper):
    """Cuts the edges that are on the lists of a sample's cell."""

    def __init__(
        self,
        ops: Any,
        tables: Tables,
        tx: Any,
        ty: Any,
        views: tuple[View, ...],
        arguments: tuple[Any, ...] = (),
        pairs: Mapping[Pass, PairGrid] | None = None,
    ) -> None:
        """``pairs``: lists in the engine's memory, in place of the tables' own."""
        self.ops, self.tables = ops, tables
        self.views, self.arguments = views, arguments
        self.samples, self.pairs = ops.count(tx), pairs
        self.tx, self.ty = _snapped(ops, self._pair((views[0], 0, 0)), tx, ty)
        self._now: tuple[View, Interval] | None = None

    def _pair(self, key: Pass) -> PairGrid:
        if self.pairs is not None:
            view, group, other = key
            return self.pairs[BEHIND if view is AHEAD else view, group, other]
        return held_pairs(self.ops, self.tables, key, self.samples)

    def sum_over_edges(
        self, term: Callable[[Edge], Level], values: int, group: int = 0, other: int = 0
    ) -> Any:
        # what lies at infinity or is not a number is so in the result
        totals = [sum(value - value for value in (self.tx, self.ty, *self.arguments))] * values
        for view in self.views:
            found = _Pass(self, view, self._pair((view, group, other)), term, values)
            for part in found.sums():
                totals = [a + b for a, b in zip(totals, part, strict=True)]
        self._now = None
        return tuple(totals)

    def intervals(self, edge: Edge, view: View, group: int = 0) -> Iterator[Interval]:
        if self._now is not None and self._now[0] is view:
            yield self._now[1]

    def at(self, view: View, interval: Interval) -> None:
        """The interval that :meth:`intervals` is to give for the edge that comes next."""
        self._now = view, interval

    def cell(self, key: Pass) -> Any:
        """The cells of samples, which are best taken in their order."""
        side = key[0].side
        return cell_of(self.ops, self._pair(key), side * self.tx, side * self.ty)


@dataclass(frozen=True, eq=False)
class _Pass:
    """The sums over the edges of one copy."""

    clipper: PairClipper
    view: View
    pair: PairGrid
    term: Callable[[Edge], Level]
    values: int

    @property
    def ops(self) -> Any:
        return self.clipper.ops

    @property
    def tables(self) -> Tables:
        return self.clipper.tables

    @property
    def offset(self) -> tuple[Any, Any]:
        """T as seen from the edges' copy."""
        return self.view.side * self.clipper.tx, self.view.side * self.clipper.ty

    def sums(self) -> Iterator[list[Any]]:
        """Over whole edges, and along the rows."""
        ops, pair = self.ops, self.pair
        cell = cell_of(ops, pair, *self.offset)
        run, run_end, row, row_end = ops.gather(pair.cells, cell)
        yield ops.sum_over_runs(run, run_end, pair.runs, self._whole, self.values)
        yield ops.sum_over_rows(row, row_end, self._visited, self.values, self._levels)

    @property
    def _levels(self) -> int:
        return 2 if self.tables.phased else 1

    def _level(self, number: Any) -> Level:
        return tuple(self.ops.gather(self.pair.levels, number)[: self._levels])

    def _whole(self, number: Any, level: Any) -> Level:
        return self._last_part(number, None, 1.0, self._level(level))

    def _visited(self, row: Any) -> tuple[Any, Level, Level, Callable[[Level], Level]]:
        ops, pair = self.ops, self.pair
        number, other, how, level = ops.gather(pair.rows, row)
        edge, against = ops.gather(pair.first, number), ops.gather(pair.second, other)
        meets, enters, start, end = crossing(ops, edge, against, *self.offset, self.view.side)
        sign = ops.select(meets, ops.select(enters, 1.0, -1.0), 0.0)
        jump = (sign,)
        if not self.tables.uniform:
            jump = tuple(sign * weight for weight in against[5 : 5 + self._levels])
        part = ops.select(meets, end / ops.select(meets, end - start, 1.0), 1.0)

        def term(level: Level) -> Level:
            weight = tuple(
                ops.select(how == WHOLE, before, ops.select(how == LEAD, 0.0, by))
                for before, by in zip(level, jump, strict=True)
            )
            return self._last_part(number, edge, part, weight)

        return how == START, self._level(level), jump, term

    def _last_part(self, number: Any, edge: Any, part: Any, level: Level) -> Level:
        """Contribution of the last part of an edge, a fraction of its length, at a level."""
        ax, ay, bx, by, area, real, imag, _ = edge or self.ops.gather(self.pair.first, number)
        begin, end, _, _ = self.ops.gather(self.pair.names, number)
        # e = length u with length 1: what the kernels compute of u and length stays the same
        ex, ey = bx - ax, by - ay
        found = Edge(
            ax, ay, bx, by, ex, ey, area, ex, ey, 1.0, 0.0, 0.0, real, imag,
            begin=begin, end=end,
        )  # fmt: skip
        real, imag = self.tables.mutual(found, Piece((), *level))
        self.clipper.at(self.view, (2.0 - part, part, real, -imag if self.view is AHEAD else imag))
        return self.term(found)


# ---- NumPy ---------------------------------------------------------------------------------------


class ListedParts:
    """Parts of edges inside the other copy, of all samples one after the other.

    They are found in double precision, in which sums and products of coordinates on the grid of
    single precision are exact.
    """

    def __init__(self, ops: Any, tables: Tables, key: Pass, tx: Array, ty: Array) -> None:
        """Find the parts of one pass, for offsets (n,) of NumPy."""
        # from the same lists for any number of samples, so that they round in the same way
        pair, self.key = pairs_of(tables, key, ops.double, _SOME).columns, key
        side = key[0].side
        self.tx, self.ty = offset = _on_grid(pair, tx), _on_grid(pair, ty)
        tx, ty = (side * t for t in offset)
        spans = _taken(pair.cells, _cells(pair, tx, ty))
        levels, products = pair.levels[:, 0], CrossProducts(ops.double)
        if tables.phased:
            levels = levels + 1j * pair.levels[:, 1]
        parts = [
            _runs(pair, levels, spans[0], spans[1]),
            _rows(products, pair, levels, spans[2], spans[3], tx, ty, side, tables.uniform),
        ]
        self.owner, number, part, level = (
            np.concatenate(column) for column in zip(*parts, strict=True)
        )
        columns = _taken(pair.first, number)
        ax, ay, bx, by, area, real, imag, _ = (c.astype(ops.dtype, copy=False) for c in columns)
        ex, ey, one = bx - ax, by - ay, np.ones_like(ax)
        self.edge = Edge(ax, ay, bx, by, ex, ey, area, ex, ey, one, 0.0, 0.0, real, imag)
        weight: Any = level.real.astype(ops.dtype), level.imag.astype(ops.dtype)
        self.weight = tables.mutual(self.edge, Piece((), *weight))
        self.part = part.astype(ops.dtype)


def _on_grid(pair: PairGrid, offset: Array) -> Array:
    """An offset on the grid of the vertices."""
    step = float(pair.numbers[0, 7])
    return np.asarray(np.rint(np.asarray(offset, np.float64) * (1 / step)) * step)


def _cells(pair: PairGrid, tx: Array, ty: Array) -> Array:
    """The number of the cell of each offset on the grid; an empty one's outside of all cells."""
    x0, y0, x1, y1, per_unit, across, empty, _ = pair.numbers[0].tolist()
    inside = (tx >= x0) & (tx < x1) & (ty >= y0) & (ty < y1)
    x, y = (np.where(inside, (t - low) * per_unit, 0.0) for t, low in ((tx, x0), (ty, y0)))
    return np.where(inside, np.floor(y) * across + np.floor(x), empty).astype(np.intp)


def _taken(table: Array, rows: Array) -> list[Array]:
    """The columns of some rows of a table."""
    return [column.take(rows) for column in table.T]


def _flat(first: Array, end: Array) -> tuple[Array, Array]:
    """Owner and number of each row in the ranges from first to end."""
    counts = end.astype(np.intp) - first
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) + (first - (np.cumsum(counts) - counts))[owner]


def _runs(pair: PairGrid, levels: Array, first: Array, end: Array) -> tuple[Array, ...]:
    """(owner, edge, part, level) of edges that lie inside as a whole."""
    owner, run = _flat(first, end)
    begin, stop, level, _ = _taken(pair.runs, run)
    of_run, number = _flat(begin, stop)
    return owner[of_run], number, np.ones(len(number)), levels[level[of_run]]


def _rows(
    products: CrossProducts,
    pair: PairGrid,
    levels: Array,
    first: Array,
    end: Array,
    tx: Array,
    ty: Array,
    side: float,
    is_uniform: bool,
) -> tuple[Array, ...]:
    """Parts of edges behind crossings of other pairs, with the level that runs along the rings."""
    owner, row = _flat(first, end)
    number, other, how, set_to = _taken(pair.rows, row)
    edge, against = _taken(pair.first, number), _taken(pair.second, other)
    meets, enters, start, stop = crossing(products, edge, against, tx[owner], ty[owner], side)
    jump = np.where(meets, np.where(enters, 1.0, -1.0), 0.0)
    sums: Any = np.float64
    if not is_uniform:  # of any weights, sums over many samples would round
        is_complex = levels.dtype.kind == "c"
        jump = jump * (against[5] + 1j * against[6] if is_complex else against[5])
        sums = np.clongdouble if is_complex else np.longdouble
    before = np.cumsum(jump, dtype=sums) - jump
    # each ring of a sample begins with a row that sets the level
    last = np.maximum.accumulate(np.where(how == START, np.arange(len(row)), 0))
    level = before + (levels[set_to] - before)[last]
    level = np.where(how == WHOLE, level, np.where(how == LEAD, 0.0, jump)).astype(levels.dtype)
    (kept,) = np.nonzero(level)
    owner, number, meets, level, start, stop = (
        values.take(kept) for values in (owner, number, meets, level, start, stop)
    )
    part = np.where(meets, stop / np.where(meets, stop - start, 1.0), 1.0)
    return owner, number, part, level


# `dataclasses.astuple` copies each number deeply: half of the time of a call with one sample.
_NUMBERS_OF = attrgetter(*(part.name for part in fields(Edge)))


class ListedClipper(Clipper):
    """Takes listed parts as samples of their own, each of one edge."""

    def __init__(
        self, ops: Any, tables: Tables, views: tuple[View, ...], tx: Array, ty: Array
    ) -> None:
        """For offsets (n,): ``owner`` (k,) is whose the parts are."""
        self.ops, self.tables = ops, tables
        groups = range(len(tables.groups))
        keys = [(view, own, other) for view in views for own in groups for other in groups]
        self.listed = [ListedParts(ops, tables, key, tx, ty) for key in keys]
        first = self.listed[0]
        self.owner, self.edge = first.owner, first.edge
        if len(keys) > 1:
            self.owner = np.concatenate([parts.owner for parts in self.listed])
            columns = zip(*(_NUMBERS_OF(parts.edge) for parts in self.listed), strict=True)
            self.edge = Edge(*(np.concatenate(c) if np.ndim(c[0]) else c[0] for c in columns))
        ends = np.cumsum([len(parts.owner) for parts in self.listed])
        self.places = [
            slice(end - len(p.owner), end) for p, end in zip(self.listed, ends, strict=True)
        ]
        self.tx, self.ty = (t[self.owner].astype(ops.dtype) for t in (first.tx, first.ty))
        self._pair = 0, 0

    def sum_over_edges(
        self, term: Callable[[Edge], Level], values: int, group: int = 0, other: int = 0
    ) -> Any:
        """The sums of each sample, once for each of its parts; others' terms count as 0."""
        self._pair = group, other
        found = (np.broadcast_to(value, self.owner.shape) for value in term(self.edge))
        sums = (np.bincount(self.owner, value).astype(self.ops.dtype) for value in found)
        return tuple(total[self.owner] for total in sums)

    def intervals(self, edge: Edge, view: View, group: int = 0) -> Iterator[Interval]:
        part, real, imag = (np.zeros(len(self.owner), self.ops.dtype) for _ in range(3))
        for parts, place in zip(self.listed, self.places, strict=True):
            if parts.key == (view, *self._pair):
                part[place] = parts.part
                real[place], imag[place] = parts.weight
        yield 2.0 - part, part, real, view.side * imag if self.tables.phased else 0.0
