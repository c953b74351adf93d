"""Sums over the boundary of a slice: the parts of edges of one copy that lie inside the other.

This is the only cut. The weight of an edge is the winding number of its start in the other copy,
kept running along its ring; each crossing with an edge of the other copy adds 1 or -1 from there to
the edge's end (docs/theory/edges.md, (K2)). All that is told of an outline is data, so that one
compiled loop serves all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from polywigner.kernels.outline.pair_grid import (
    LEAD,
    NO_WINDING,
    START,
    WHOLE,
    PairGrid,
    crossing,
    levels,
)

__all__ = ["Integrand", "cell_of", "several", "sum_over_slice"]

Values = tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Integrand:
    """What is summed over the parts of edges."""

    values: int
    """How many numbers a sum is."""
    at: Callable[..., Values]
    """(ops, (T_x, T_y), *arguments) -> what the terms of a sample have in common."""
    term: Callable[..., Values]
    """(ops, what they have in common, ends of an edge, fraction) -> values of its last part."""
    total: Callable[..., Values]
    """(ops, what they have in common, sums) -> results."""


def several(integrand: Integrand, count: int) -> Integrand:
    """An integrand at so many sets of arguments: edges are cut once for all of them."""

    def parted(values: Sequence[Any]) -> list[Sequence[Any]]:
        size = len(values) // count
        return [values[size * k : size * (k + 1)] for k in range(count)]

    def at(ops: Any, offset: Values, *arguments: Any) -> Values:
        return tuple(v for own in parted(arguments) for v in integrand.at(ops, offset, *own))

    def term(ops: Any, shared: Values, edge: Values, part: Any) -> Values:
        return tuple(
            v for own in parted(shared) for v in integrand.term(ops, tuple(own), edge, part)
        )

    def total(ops: Any, shared: Values, sums: Values) -> Values:
        pairs = zip(parted(shared), parted(sums), strict=True)
        return tuple(
            v for own, mine in pairs for v in integrand.total(ops, tuple(own), tuple(mine))
        )

    return Integrand(count * integrand.values, at, term, total)


def cell_of(ops: Any, pair: PairGrid, tx: Any, ty: Any) -> Any:
    """The number of the cell of an offset on the grid; an empty one's outside of all cells."""
    x0, y0, x1, y1, per_unit, across, empty, _ = ops.gather(pair.numbers, ops.truncated(0.0))
    inside = (tx >= x0) & (tx < x1) & (ty >= y0) & (ty < y1)
    column, row = (
        ops.truncated(ops.select(inside, (t - low) * per_unit, 0.0))
        for t, low in ((tx, x0), (ty, y0))
    )
    return ops.select_number(inside, row * ops.truncated(across) + column, ops.truncated(empty))


def sum_over_slice(
    ops: Any,
    pair: PairGrid,
    offset: Values,
    integrand: Integrand,
    *arguments: Any,
    sides: Sequence[float] = (1.0,),
) -> Values:
    """The integrand over the edges of the first outline inside the copy {T - p} of the second.

    ``offset``: T, on the grid; ``pair``: tables held by ``ops``. ``sides``: 1 for T, -1 for -T,
    where ties are decided with the opposite displacement: the two are one intersection, seen from
    one copy and from the other.
    """
    totals: list[Any] = [0.0] * integrand.values
    for side in sides:
        seen = tuple(side * t for t in offset)
        shared = integrand.at(ops, seen, *arguments)
        sums = _sums(ops, pair, seen, integrand, shared, side)
        totals = [total + sum(part) for total, *part in zip(totals, *sums, strict=True)]
    return integrand.total(ops, shared, tuple(totals))


def _sums(
    ops: Any, pair: PairGrid, offset: Values, integrand: Integrand, shared: Values, side: float
) -> list[Any]:
    """The sums over whole edges, over pairs that cross in any case, and along the other rows."""
    cells = ops.gather(pair.cells, cell_of(ops, pair, *offset))
    run, run_end, first, end, row, row_end = cells[:6]

    def whole(number: Any, level: Any, *shared: Any) -> Values:
        found = integrand.term(ops, shared, ops.gather(pair.first, number), None)
        weight = ops.as_float(level) - NO_WINDING
        return tuple(weight * value for value in found)

    def crossed(row: Any, tx: Any, ty: Any, *shared: Any) -> Values:
        number, other, jump, _ = ops.gather(pair.crossings, row)
        edge = ops.gather(pair.first, number)
        start, end = levels(ops, edge, ops.gather(pair.second, other), tx, ty)
        found = integrand.term(ops, shared, edge, end / (end - start))
        weight = ops.as_float(jump) - NO_WINDING
        return tuple(weight * value for value in found)

    def change(row: Any, tx: Any, ty: Any, *_: Any) -> tuple[Any, Any, Any, Values]:
        number, other, how, level = ops.gather(pair.rows, row)
        edge = ops.gather(pair.first, number)
        meets, enters, start, end = crossing(
            ops, edge, ops.gather(pair.second, other), tx, ty, side
        )
        jump = ops.select(meets, ops.select(enters, 1.0, -1.0), 0.0)
        part = ops.select(meets, end / ops.select(meets, end - start, 1.0), 1.0)
        return how == START, ops.as_float(level) - NO_WINDING, jump, (how, *edge, part)

    def weight(level: Any, jump: Any, how: Any, *_: Any) -> Any:
        return ops.select(how == WHOLE, level, ops.select(how == LEAD, 0.0, jump))

    def last_part(how: Any, *values: Any) -> Values:
        *edge, part, _, _ = values[:7]
        return integrand.term(ops, values[7:], edge, part)

    count = integrand.values
    return [
        ops.sum_over_listed(run, run_end, pair.runs, whole, count, *shared),
        ops.sum_over_each(first, end, crossed, count, *offset, *shared),
        ops.sum_over_rows(row, row_end, change, weight, last_part, count, *offset, *shared),
    ]
