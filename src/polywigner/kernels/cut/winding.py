"""Sums over the boundary of a slice: the parts of edges of one copy that lie inside the other.

The weight of an edge is the winding number of its start in the other copy, kept running along its
ring; each crossing with an edge of the other copy adds 1 or -1 from there to the edge's end
(docs/theory/edges.md, (K1)). In a collection the winding number of each element counts as often as
its weight says. All that is told of an outline is data, so that one compiled loop serves all.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from polywigner.kernels.cut.cell_lists import cells_across, pair_grid
from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED, Clipper, Edge, View
from polywigner.kernels.cut.pair_grid import LEAD, START, WHOLE, PairGrid, crossing, outline_of
from polywigner.kernels.outline.tables import Tables

Pass = tuple[View, int, int]
"""View of edges, number of their field, and number of the other copy's field."""
Interval = tuple[Any, Any, Any, Any]
Level = tuple[Any, ...]

# Samples where their number is unknown.
_MANY = 1 << 20
# Lists that are kept, of all sources; engines have copies of as much.
_MOST_BYTES = 1 << 27


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


def cell_of(ops: Any, pair: PairGrid, tx: Any, ty: Any) -> Any:
    """The number of the cell of an offset on the grid; an empty one's outside of all cells."""
    x0, y0, x1, y1, per_unit, across, empty, _ = ops.gather(pair.numbers, ops.truncated(0.0))
    inside = (tx >= x0) & (tx < x1) & (ty >= y0) & (ty < y1)
    column, row = (
        ops.truncated(ops.select(inside, (t - low) * per_unit, 0.0))
        for t, low in ((tx, x0), (ty, y0))
    )
    return ops.select_number(inside, row * ops.truncated(across) + column, ops.truncated(empty))


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
        self.pairs = pairs
        *_, step = ops.gather(self._pair((views[0], 0, 0)).numbers, ops.truncated(0.0))
        self.tx, self.ty = ops.snapped(tx, step), ops.snapped(ty, step)
        self._now: tuple[View, Interval] | None = None

    def _pair(self, key: Pass) -> PairGrid:
        if self.pairs is not None:
            view, group, other = key
            return self.pairs[BEHIND if view is AHEAD else view, group, other]
        grid, ops = pairs_of(self.tables, key, self.ops.double), self.ops
        if ops.key not in grid.copies:
            grid.copies.setdefault(ops.key, grid.held(ops.held))  # in all threads the same
        found: PairGrid = grid.copies[ops.key]
        return found

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
        """Over edges inside the other copy, and along the other rows."""
        ops, pair = self.ops, self.pair
        cell = cell_of(ops, pair, *self.offset)
        inside, row, end, _ = ops.gather(pair.cells, cell)
        yield ops.sum_over_range(inside, row, self._inside, self.values)
        yield ops.sum_over_rows(row, end, self._visited, self.values, self._levels)

    @property
    def _levels(self) -> int:
        return 2 if self.tables.phased else 1

    def _level(self, number: Any) -> Level:
        return tuple(self.ops.gather(self.pair.levels, number)[: self._levels])

    def _inside(self, row: Any) -> Level:
        number, _, _, level = self.ops.gather(self.pair.rows, row)
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
        ax, ay, ex, ey, _, real, imag, _ = edge or self.ops.gather(self.pair.first, number)
        begin, end, _, _ = self.ops.gather(self.pair.names, number)
        # e = length u with length 1: what the kernels compute of u and length stays the same
        edge = Edge(ax, ay, ex, ey, ex, ey, 1.0, real, imag, begin=begin, end=end)
        real, imag = self.tables.mutual(real, imag, *level, *(0.0,) * (2 - self._levels))
        self.clipper.at(self.view, (2.0 - part, part, real, -imag if self.view is AHEAD else imag))
        return self.term(edge)
