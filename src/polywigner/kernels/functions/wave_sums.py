"""Sums over the cut edges of a source with several waves: pair by pair, each edge cut once.

W, A and the moments of the lag slice are such sums: for each pair of waves the sum over a uniform
source at a shifted frequency, times an amplitude that depends on position or lag alone
(docs/theory.md, (I2), (I3)).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol

from polywigner.kernels.cut.clipping import (
    AHEAD,
    BEHIND,
    MIRRORED,
    Clipper,
    RowClipper,
    View,
    times,
)
from polywigner.kernels.functions.edge_terms import EdgeTerms
from polywigner.kernels.outline.tables import Edge, Tables
from polywigner.kernels.outline.waves import (
    WavePair,
    WavePairRow,
    difference_pairs,
    mean_pairs,
    rows_of,
)
from polywigner.numerics.complex_pairs import Pair

Values = tuple[Any, ...]
Views = tuple[tuple[View, float], ...]
"""Views, and which copy of the edges each is of: its points are p + side T."""
Pairings = Callable[[int, Tables], Iterator[tuple[int, Views, Sequence[WavePair]]]]
"""(group of edges, tables) -> for each group of pieces the views that it cuts the edges in, and the
pairs of waves there."""

MIRROR: Views = ((MIRRORED, -0.5),)
COPIES: Views = ((BEHIND, -0.5), (AHEAD, +0.5))


class PairSum(Protocol):
    """The sum for one pair of waves."""

    values: int

    def terms(self, edge: Edge, sides: Sequence[tuple[float, Any]]) -> Values:
        """What an edge contributes, from its cuts on each side."""

    def value(self, sums: Sequence[Any], place: Values) -> Sequence[Any]:
        """The pair's share of the result at a position or lag."""


def mean_pairings(group: int, tables: Tables) -> Iterator[tuple[int, Views, Sequence[WavePair]]]:
    """Pairs of waves for W and the moments of the lag slice."""
    for other, waves in enumerate(tables.groups):
        yield other, MIRROR, mean_pairs(tables.groups[group], waves)


def difference_pairings(
    group: int, tables: Tables
) -> Iterator[tuple[int, Views, Sequence[WavePair]]]:
    """Pairs of waves for A: the edges' field is the first factor BEHIND, the second AHEAD."""
    own = tables.groups[group]
    for other, waves in enumerate(tables.groups):
        if other == group:
            yield other, COPIES, difference_pairs(own, own)
        else:
            yield other, COPIES[:1], difference_pairs(own, waves)
            yield other, COPIES[1:], difference_pairs(waves, own)


def sum_over_waves(
    clipper: Clipper,
    pairings: Pairings,
    sum_of: Callable[[WavePair | WavePairRow, bool], PairSum],
    place: Values,
    count: int,
) -> list[Any]:
    """The ``count`` results of all pairs of waves together.

    ``sum_of``: (pair, whether the edges' and the pieces' field are one with real weights) -> its
    sum. Where edges are rows of a table and waves are several, so are pairs of waves: little code,
    and each edge cut once for each.
    """
    tables, totals = clipper.tables, [0.0] * count
    for group in range(len(tables.groups)):
        if not clipper.edges_of(group):
            continue
        if isinstance(clipper, RowClipper) and tables.waves_per_cut > 1:
            found = _sums_of_rows(clipper, group, pairings, sum_of, place, count)
        else:
            found = _sums_of_group(clipper, group, pairings, sum_of, place, count)
        for part in found:
            totals = [a + b for a, b in zip(totals, part, strict=True)]
    return totals


def _sums_of_group(
    clipper: Clipper, group: int, pairings: Pairings, sum_of: Any, place: Values, count: int
) -> Iterable[Sequence[Any]]:
    tables, results = clipper.tables, []
    for other in range(len(tables.groups)):
        is_even = other == group and not tables.phased
        found = [
            (views, sum_of(pair, is_even))
            for number, views, pairs in pairings(group, tables)
            for pair in pairs
            if number == other
        ]

        def term(edge: Edge, found: Any = found, other: int = other) -> Values:
            cuts: dict[View, Any] = {}
            values: list[Any] = []
            for views, run in found:
                for view, _ in views:
                    if view not in cuts:
                        cuts[view] = list(clipper.intervals(edge, view, other))
                values += run.terms(edge, [(side, cuts[view]) for view, side in views])
            return tuple(values)

        count_of_all = sum(run.values for _, run in found)
        sums = iter(clipper.sum_over_edges(term, count_of_all, group, other))
        for _, run in found:
            results.append(run.value([next(sums) for _ in range(run.values)], place)[:count])
    return results


def _sums_of_rows(
    clipper: RowClipper, group: int, pairings: Pairings, sum_of: Any, place: Values, count: int
) -> Iterable[Sequence[Any]]:
    for other, views, pairs in pairings(group, clipper.tables):

        def term(
            edge: Edge,
            *row: Any,
            other: int = other,
            views: Views = views,
            real: bool = pairs[0].is_real,
        ) -> Values:
            run = sum_of(WavePairRow(real, *row), False)
            cuts = [(side, list(clipper.intervals(edge, view, other))) for view, side in views]
            return tuple(run.value(run.terms(edge, cuts), place)[:count])

        yield clipper.sum_over_pairs(term, count, group, rows_of(pairs))


class TermSum:
    """The sum for a pair of waves of `EdgeTerms`: W or A."""

    def __init__(
        self, clipper: Clipper, terms: EdgeTerms, pair: WavePair | WavePairRow, scale: float
    ) -> None:
        """A point of an edge lies in the slice at ``scale (p + side T)``."""
        self.clipper, self.ops, self.function, self.pair = clipper, clipper.ops, terms, pair
        self.scale, self.values = scale, terms.values
        nu_x, nu_y = terms.nu
        turns = self.ops.fma(nu_x, clipper.tx, nu_y * clipper.ty)
        self.moved = {side: times(scale * side, turns) for side in (-0.5, 0.5)}

    def terms(self, edge: Edge, sides: Sequence[tuple[float, Any]]) -> Values:
        ops, function, scale = self.ops, self.function, self.scale
        nu_x, nu_y = function.nu
        along = self.clipper.shared(
            edge, lambda: function.along(edge.ux, edge.uy), type(function), self.pair.shift
        )
        length = scale * edge.length
        per_edge = (0.5 * length) * along[0]
        sums: Values | None = None
        for side, cuts in sides:
            start = ops.fma(nu_y, scale * edge.ay, self.moved[side])
            start = ops.fma(nu_x, scale * edge.ax, start)
            for middle, extent, *weight in cuts:
                turns = ops.fma(middle, per_edge, start)
                sums = function.added(sums, extent * per_edge, turns, extent, weight)
        if sums is None:
            return (0.0,) * self.values
        return function.of_edge(along, length, sums)

    def value(self, sums: Sequence[Any], place: Values) -> Values:
        real, imag = self.pair.amplitude(self.ops, place)
        total = self.function.total(tuple(sums))
        if isinstance(imag, float) and imag == 0.0:
            return tuple(times(real, value) for value in total)
        found = Pair(*total) * Pair(real, imag)
        return found.real, found.imag
