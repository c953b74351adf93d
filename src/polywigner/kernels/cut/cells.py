"""The parts of edges inside the other copy, from lists for the cell in which the offset lies.

What :mod:`polywigner.kernels.cut.clipping` does for all edges and all pieces, done for those that
matter at a place: docs/theory.md, "Many edges". The kernels' formulae are the same, and so are the
decisions about edges that coincide.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any

from polywigner.kernels.cut.cell_lists import CellLists, cell_lists
from polywigner.kernels.cut.cell_tables import GATE, GATE_EXACT, CutList
from polywigner.kernels.cut.clipping import AHEAD, BEHIND, Clipper, RowClipper, View
from polywigner.kernels.outline.tables import Edge, Piece, Tables, cut_of

__all__ = [
    "CellClipper",
    "HeldLists",
    "arrays_of",
    "cell_of",
    "cell_of_offset",
    "clipper_for",
]

Interval = tuple[Any, Any, Any, Any]

# stands for infinity: far outside [0, 1], and finite when multiplied by a frequency
_FAR = 1e9


def clipper_for(
    ops: Any, tables: Tables, tx: Any, ty: Any, *views: View, arguments: tuple[Any, ...] = ()
) -> Clipper:
    """The clipper that suits the number of edges, of samples, and the engine.

    ``arguments``: of the kernel; what is not a number in them is not in the sums either.
    """
    cut = cut_of(ops.target, tables, ops.count(tx))
    if cut.endswith("cells"):
        return CellClipper(ops, tables, tx, ty, views, arguments)
    return (RowClipper if cut == "rows" else Clipper)(ops, tables, tx, ty)


def cell_of(ops: Any, lists: CellLists, x: Any, y: Any, owner: Hashable = None) -> Any:
    """The number of the cell of an offset; 0 outside of all, and for what is not a number."""
    c, s = lists.turn
    u, v = (x, y) if (c, s) == (1.0, 0.0) else (ops.fma(x, c, y * s), ops.fma(y, c, x * -s))
    u = (u - lists.low[0]) * lists.scale[0]
    v = (v - lists.low[1]) * lists.scale[1]
    width, height = lists.counts
    inside = (u >= 0.0) & (u < width) & (v >= 0.0) & (v < height)
    column, row = (ops.truncated(ops.select(inside, value, 0.0)) for value in (u, v))
    (number,) = ops.gather(_held(ops, lists, owner).map, row * width + column)
    return ops.select_number(inside, number, 0)


def cell_of_offset(
    ops: Any, tables: Tables, tx: Any, ty: Any, view: View, owner: Hashable = None
) -> Any:
    """The number of the cell of T = 2x or xi: samples sorted by it run through the same lists."""
    lists = cell_lists(tables, view.point)
    return cell_of(ops, lists, tx * view.offset, ty * view.offset, owner)


class HeldLists:
    """The lists in an engine's memory, where ``hold`` puts each table of them."""

    def __init__(self, hold: Callable[[Any], Any], lists: CellLists) -> None:
        self.map = hold(lists.map[:, None])
        self.edges = hold(lists.edges)
        self.rest = [hold(column[:, None]) for column in lists.edge_rest.T]
        self.weights = [hold(column[:, None]) for column in lists.weights.T]
        self.runs = hold(lists.runs)
        self.first_run = hold(lists.first_run[:, None])
        self.cuts = [
            tuple(hold(table) for table in (cuts.first[:, None], cuts.records, cuts.cuts))
            for cuts in (lists.plain, lists.special)
        ]


def _held(ops: Any, lists: CellLists, owner: Hashable) -> HeldLists:
    """The copy of the lists that engines share, or that an owner has for itself."""
    key = ops.key, owner
    if key not in lists.held:
        lists.held.setdefault(key, HeldLists(ops.held, lists))  # in all threads the same
    found: HeldLists = lists.held[key]
    return found


def arrays_of(ops: Any, tables: Tables, view: View, owner: Hashable) -> list[Any]:
    """The lists in an engine's memory, but the map of the cells, as a plain list of its arrays."""
    held = _held(ops, cell_lists(tables, view.point), owner)
    found = [held.edges, *held.rest, *held.weights, held.runs, held.first_run]
    found += [table for cuts in held.cuts for table in cuts]
    return [flat for _, flat in found]


class CellClipper(Clipper):
    """Cuts the edges that are on the lists of a sample's cell."""

    def __init__(
        self,
        ops: Any,
        tables: Tables,
        tx: Any,
        ty: Any,
        views: tuple[View, ...],
        arguments: tuple[Any, ...],
        cells: Sequence[Any] | None = None,
        owner: Hashable = None,
        lists: tuple[CellLists, HeldLists] | None = None,
    ) -> None:
        """``cells``: of samples, for each view, where they are known; ``owner``: whose lists.

        ``lists``: for all views, where others than those of the tables are wanted.
        """
        super().__init__(ops, tables, tx, ty)
        self.views, self.arguments, self.cells, self.owner = views, arguments, cells, owner
        self.lists = lists
        self._now: tuple[View, Interval] | None = None

    def sum_over_edges(
        self, term: Callable[[Edge], tuple[Any, ...]], values: int, group: int = 0
    ) -> Any:
        # what lies at infinity or is not a number is so in the result
        given = map(self.ops.detached, (self.tx, self.ty, *self.arguments))
        totals = [sum(value - value for value in given)] * values
        for view in self.views:
            for part in _Pass(self, view, term, values).sums():
                totals = [a + b for a, b in zip(totals, part, strict=True)]
        self._now = None
        return tuple(totals)

    def lists_of(self, view: View) -> tuple[CellLists, HeldLists]:
        """The lists for a view, as they are and in an engine's memory."""
        if self.lists is not None:
            return self.lists
        lists = cell_lists(self.tables, view.point)
        return lists, _held(self.ops, lists, self.owner)

    def shared(self, edge: Edge, compute: Callable[[], Any], *what: Hashable) -> Any:
        return compute()

    def intervals(self, edge: Edge, view: View, group: int = 0) -> Iterator[Interval]:
        if self._now is not None and self._now[0] is view:
            yield self._now[1]

    def at(self, view: View, interval: Interval) -> None:
        """The interval that :meth:`intervals` is to give for the edge that comes next."""
        self._now = view, interval


class _Pass:
    """The sums over the edges of one copy."""

    def __init__(
        self,
        clipper: CellClipper,
        view: View,
        term: Callable[[Edge], tuple[Any, ...]],
        values: int,
    ) -> None:
        self.clipper, self.view, self.term, self.values = clipper, view, term, values
        self.ops = ops = clipper.ops
        self.x, self.y = clipper.tx * view.offset, clipper.ty * view.offset
        self.lists, self.held = clipper.lists_of(view)
        if clipper.cells is not None:
            self.cell = clipper.cells[clipper.views.index(view)]
        else:
            at = ops.detached(self.x), ops.detached(self.y)
            self.cell = cell_of(ops, self.lists, *at, clipper.owner)

    def sums(self) -> Iterator[list[Any]]:
        ops, held = self.ops, self.held
        if len(self.lists.runs):
            first, end = self._range(held.first_run)
            yield ops.sum_over_runs(first, end, held.runs, self._whole, self.values, self.x)
        for kind, cuts in enumerate((self.lists.plain, self.lists.special)):
            if len(cuts.records):
                first, end = self._range(held.cuts[kind][0])
                yield ops.sum_over_range(first, end, self._part(kind, cuts), self.values, self.x)

    def _range(self, table: Any) -> tuple[Any, Any]:
        (first,), (end,) = (self.ops.gather(table, self.cell + k) for k in (0, 1))
        return first, end

    def _edge(self, number: Any) -> Edge:
        ax, ay, ex, ey = self.ops.gather(self.held.edges, number)
        area, real, imag = (self.ops.gather(column, number)[0] for column in self.held.rest)
        # e = length u with length 1: what the kernels compute of u and length stays the same
        return Edge(ax, ay, ax + ex, ay + ey, ex, ey, area, ex, ey, 1.0, 0.0, 0.0, real, imag)

    def _whole(self, number: Any, weight: Any) -> tuple[Any, ...]:
        return self._term(number, 1.0, 1.0, weight)

    def _term(self, number: Any, middle: Any, extent: Any, weight: Any) -> tuple[Any, ...]:
        edge = self._edge(number)
        real, imag = self.clipper.tables.mutual(edge, Piece((), *self._weight(weight)))
        imag = -imag if self.view is AHEAD else imag
        self.clipper.at(self.view, (middle, extent, real, imag))
        return self.term(edge)

    def _weight(self, number: Any) -> Any:
        if (self.lists.weights == (1.0, 0.0)).all():
            return 1.0, 0.0
        return tuple(self.ops.gather(column, number)[0] for column in self.held.weights)

    def _part(self, kind: int, cuts: CutList) -> Callable[[Any], tuple[Any, ...]]:
        _, records, rows = self.held.cuts[kind]
        cut_at = self._special_cut if kind else self._plain_cut

        def part(record: Any) -> tuple[Any, ...]:
            number, first, end, weight = self.ops.gather(records, record)
            low, high = self._interval_between(first, end, lambda row, *o: cut_at(rows, row, *o))
            return self._term(number, low + high, self.ops.maximum(high - low, 0.0), weight)

        return part

    def _interval_between(
        self, first: Any, end: Any, cut_at: Callable[..., tuple[Any, Any]]
    ) -> tuple[Any, Any]:
        """The last of the cuts from which on, and the first up to which, the edge is inside."""
        ops = self.ops
        x, y = ops.detached(self.x), ops.detached(self.y)

        def step(row: Any, low: Any, high: Any, *rows: Any) -> tuple[Any, ...]:
            cut, begins = cut_at(row, x, y)
            later, sooner = (begins > 0.5) & (cut > low), (begins < 0.5) & (cut < high)
            found = ops.select(later, cut, low), ops.select(sooner, cut, high)
            if not rows:
                return found
            return (
                *found,
                ops.select_number(later, row, rows[0]),
                ops.select_number(sooner, row, rows[1]),
            )

        ends = ops.filled(x, 0.0), ops.filled(x, 1.0)
        if not ops.needs_gradient(self.x, self.y):
            low, high = ops.fold(first, end, ends, step)
            return low, high
        # which cuts they are has no derivative; where they lie has
        none = (1 << 32) - 1
        *_, at_low, at_high = ops.fold(first, end, (*ends, none, none), step)
        found = []
        for row, default in ((at_low, 0.0), (at_high, 1.0)):
            cut, _ = cut_at(ops.select_number(row == none, first, row), self.x, self.y)
            found.append(ops.select(row == none, default, cut))
        return found[0], found[1]

    def _plain_cut(self, rows: Any, row: Any, x: Any, y: Any) -> tuple[Any, Any]:
        of_x, of_y, constant, begins = self.ops.gather(rows, row)
        return self.ops.fma(x, of_x, self.ops.fma(y, of_y, constant)), begins

    def _special_cut(self, rows: Any, row: Any, x: Any, y: Any) -> tuple[Any, Any]:
        ops = self.ops
        dx, dy, ox, oy, factor, level, kind, begins = ops.gather(rows, row)
        distance = ops.cross(dx, dy, x + ox, y + oy)
        of_offset = ops.fma(y, dx, x * -dy)
        if self.view is BEHIND:  # the complement of what AHEAD sees
            exactly, roughly = distance >= 0.0, of_offset >= level
        else:
            exactly, roughly = distance > 0.0, of_offset > level
        left = ((kind == GATE) & roughly) | ((kind == GATE_EXACT) & exactly)
        parallel = ops.select(left, -_FAR, _FAR)
        return ops.select(kind > 0.5, parallel, distance * factor), begins
