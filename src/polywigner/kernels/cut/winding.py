"""Edge sums over the overlap of two copies of an outline, for compiled kernels.

If all rings of the other copy are convex, each edge is clipped by the sides of each ring. Otherwise
the winding number of the other copy is updated at each crossing while a loop follows the ring, (K1)
of docs/theory/edges.md. Outlines are passed as data, so one compiled kernel handles any outline.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any

from polywigner.kernels.cut.cell_lists import cells_across, pair_grid
from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED, Clipper, Edge, View
from polywigner.kernels.cut.pair_grid import (
    LEAD,
    START,
    WHOLE,
    ClipGrid,
    PairGrid,
    crossing,
    limit_of,
    outline_of,
)
from polywigner.kernels.outline import Tables
from polywigner.numerics import Number

Pass = tuple[View, int, int]
"""View of the edges, index of the group whose edges are cut, and index of the group on the other
copy."""
Interval = tuple[Any, Any, Any, Any]
Level = tuple[Any, ...]

# Number of samples that is assumed if the caller does not specify a number.
_MANY = 1 << 20
# Largest total size [bytes] of the cached edge pairs of all sources. Copies on devices are not
# counted.
_MOST_BYTES = 1 << 27
# Finite stand-in for infinity, whose product with a frequency is finite.
_FAR = 1e9


def pairs_of(
    tables: Tables, key: Pass, double: bool, samples: int = 0, *, is_compiled: bool = True
) -> PairGrid:
    """Return the edge pairs that can cross for a view and two groups, from the cache if possible.

    ``samples`` is the expected number of samples, or 0 if it is unknown. The result is a
    :class:`ClipGrid` if ``is_compiled`` is true and all rings of the other copy of the outline are
    convex.
    """
    view, group, other = key
    first, second = (outline_of(tables, number, double) for number in (group, other))
    second = second if view is MIRRORED else second.rotated
    across = cells_across(first, second, 1 << (samples or _MANY).bit_length())
    # The views AHEAD and BEHIND have the same edge pairs, so the key contains only ``view.point``.
    is_clipped = is_compiled and second.is_convex
    name = view.point, group, other, double, across, is_clipped
    grid: PairGrid | None = tables.pairs.get(name)
    if grid is None:
        grid = tables.pairs.setdefault(
            name, pair_grid(first, second, across, is_clipped=is_clipped)
        )
        with _cache_lock:
            _cached.append((tables.pairs, name, grid.nbytes))
            while sum(size for *_, size in _cached) > _MOST_BYTES and len(_cached) > 1:
                pairs, oldest, _ = _cached.popleft()
                pairs.pop(oldest, None)
    return grid


_cached: deque[tuple[dict[Any, Any], Hashable, int]] = deque()
"""Owner, key and size in bytes of each cached table, oldest first."""
# Mitsuba loads the sources of a scene file in several threads.
_cache_lock = threading.Lock()


def cell_of(ops: Any, pair: PairGrid, tx: Any, ty: Any) -> Number:
    """Return the index of the cell that contains an offset.

    Offsets outside the grid belong to an empty cell.
    """
    x0, y0, x1, y1, per_unit, across, empty, _ = ops.gather(pair.numbers, ops.truncated(0.0))
    inside = (tx >= x0) & (tx < x1) & (ty >= y0) & (ty < y1)
    column, row = (
        ops.truncated(ops.select(inside, (t - low) * per_unit, 0.0))
        for t, low in ((tx, x0), (ty, y0))
    )
    return ops.select(inside, row * ops.truncated(across) + column, ops.truncated(empty))


class PairClipper(Clipper):
    """Clipped edges of the cell that contains the offset of each sample."""

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
        self.ops, self.tables = ops, tables
        self.views, self.arguments, self.pairs = views, arguments, pairs
        *_, step = ops.gather(self._grid((views[0], 0, 0)).numbers, ops.truncated(0.0))
        self.tx, self.ty = ops.snapped(tx, step), ops.snapped(ty, step)
        self._current: tuple[View, Interval] | None = None

    def _grid(self, key: Pass) -> PairGrid:
        """Return the edge pairs with a key, in the memory of the engine."""
        if self.pairs is not None:
            view, group, other = key
            return self.pairs[BEHIND if view is AHEAD else view, group, other]
        grid, ops = pairs_of(self.tables, key, self.ops.double), self.ops
        if ops.key not in grid.copies:
            # setdefault is atomic, so all threads use the same copy.
            grid.copies.setdefault(ops.key, grid.on_device(ops.on_device))
        copy: PairGrid = grid.copies[ops.key]
        return copy

    def sum_over_edges(
        self, term: Callable[[Edge], Level], values: int, group: int = 0, other: int = 0
    ) -> Level:
        """Return the sums of ``term(edge)`` over the edges in all views, or NaN at NaN offsets."""
        # Infinite and NaN arguments must give NaN: x - x is NaN for these values, and 0 otherwise.
        totals = [sum(value - value for value in (self.tx, self.ty, *self.arguments))] * values
        for view in self.views:
            for part in self._sums(view, self._grid((view, group, other)), term, values):
                totals = [a + b for a, b in zip(totals, part, strict=True)]
        self._current = None
        return tuple(totals)

    def intervals(self, edge: Edge, view: View, group: int = 0) -> Iterator[Interval]:
        """Yield the part of the edge whose term ``sum_over_edges`` is computing.

        Only the current view yields a part, in the form of :meth:`Clipper.intervals`.
        """
        if self._current is not None and self._current[0] is view:
            yield self._current[1]

    def _sums(
        self, view: View, grid: PairGrid, term: Callable[[Edge], Level], values: int
    ) -> Iterator[Level]:
        """Yield the sum over edges inside the outline's other copy, and the sum over other rows."""
        ops, tables, count = self.ops, self.tables, 2 if self.tables.phased else 1
        tx, ty = view.side * self.tx, view.side * self.ty

        def level_of(number: Any) -> Level:
            """Return the weighted winding number at an index."""
            return tuple(ops.gather(grid.levels, number)[:count])

        def part(number: Any, edge: Any, ends_sum: Any, extent: Any, level: Level) -> Level:
            """Return the term of the part of an edge from t0 to t1, given t0 + t1 and t1 - t0."""
            ax, ay, ex, ey, _, real, imag, _ = edge or ops.gather(grid.first, number)
            begin, end, _, _ = ops.gather(grid.names, number)
            weight, phase = tables.mutual(real, imag, *level, *(0.0,) * (2 - count))
            phase = -phase if view is AHEAD else phase
            self._current = view, (ends_sum, extent, weight, phase)
            # This sum uses the edge vector in place of the unit vector, so the argument for the
            # length is 1.
            return term(Edge(ax, ay, ex, ey, ex, ey, 1.0, real, imag, begin=begin, end=end))

        def of_inside(row: Any) -> Level:
            """Return the term of an edge that lies inside the other copy of the outline."""
            number, _, _, level = ops.gather(grid.rows, row)
            return part(number, None, 1.0, 1.0, level_of(level))

        def of_clipped(row: Any) -> Level:
            """Return the term of an edge that is clipped by the sides of a convex ring."""
            number, begin, end, level = ops.gather(grid.rows, row)
            edge = ops.gather(grid.first, number)
            low, high = self._clipped(grid, edge, (begin, end), tx, ty, view.side)
            return part(number, edge, low + high, ops.maximum(high - low, 0.0), level_of(level))

        def visit(row: Any) -> tuple[Any, Level, Level, Callable[[Level], Level]]:
            """Return the arguments of ``ops.sum_over_rows`` for a pair of edges."""
            number, other, kind, level = ops.gather(grid.rows, row)
            edge, other_edge = ops.gather(grid.first, number), ops.gather(grid.second, other)
            meets, enters, start, end = crossing(ops, edge, other_edge, tx, ty, view.side)
            jump: Level = (ops.select(meets, ops.select(enters, 1.0, -1.0), 0.0),)
            if not tables.uniform:
                jump = tuple(jump[0] * weight for weight in other_edge[5 : 5 + count])
            fraction = ops.select(meets, end / ops.select(meets, end - start, 1.0), 1.0)

            def of_level(level: Level) -> Level:
                """Return the term of a row for the winding number before its crossing."""
                weights = (
                    ops.select(kind == WHOLE, before, ops.select(kind == LEAD, 0.0, by))
                    for before, by in zip(level, jump, strict=True)
                )
                return part(number, edge, 2.0 - fraction, fraction, tuple(weights))

            return kind == START, level_of(level), jump, of_level

        cell = cell_of(ops, grid, ops.first(tx), ops.first(ty))
        inside, row, end, _ = ops.gather(grid.cells, cell)
        yield ops.sum_over_range(inside, row, of_inside, values)
        if isinstance(grid, ClipGrid):
            yield ops.sum_over_range(row, end, of_clipped, values)
            return
        yield ops.sum_over_rows(row, end, visit, values, count)

    def _clipped(
        self, grid: PairGrid, edge: Any, rows: tuple[Any, Any], tx: Any, ty: Any, side: float
    ) -> tuple[Any, Any]:
        """Return the part of an edge to the left of all sides from row ``rows[0]`` to ``rows[1]``.

        The part runs from ``low`` to ``high``, which are fractions of the edge. The part is empty
        if ``high`` is less than ``low``.
        """
        ops = self.ops
        ax, ay, ex, ey = edge[:4]

        def step(row: Any, low: Any, high: Any) -> tuple[Any, Any]:
            """Return the part of the edge from ``low`` to ``high``, clipped by another side."""
            (number,) = ops.gather(grid.sides, row)
            cx, cy, fx, fy = ops.gather(grid.second, number)[:4]
            slope = ops.cross(fx, fy, ex, ey)
            level = ops.cross(fx, fy, tx - (cx + ax), ty - (cy + ay))
            is_parallel = slope == 0.0
            bound = level * (1.0 / ops.select(is_parallel, 1.0, slope))
            is_left = level > limit_of(ops, fx, fy, side)
            bound = ops.select(is_parallel, ops.select(is_left, _FAR, -_FAR), bound)
            begins, ends = (slope < 0.0) & (bound > low), (slope >= 0.0) & (bound < high)
            return ops.select(begins, bound, low), ops.select(ends, bound, high)

        low, high = ops.fold(*rows, (0.0, 1.0), step)
        return low, high
