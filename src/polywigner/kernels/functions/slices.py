"""W and A as sums over the edges of slices (Stokes' theorem), and the areas of slices.

The sums are (W1), (W2) and (A1) of docs/theory.md, over the cut edges of one copy for W, whose
mirror images are the others, and of both copies for A. Fields of several waves, and elements with
fields of their own, are sums over pairs of waves: for each pair the sum over a uniform source at a
shifted frequency, times an amplitude that depends on position or lag alone, (I2), (I3). Each edge
is cut once for all pairs. At one place for many frequencies the slice is cut once, and its listed
boundary is summed for each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.cut.clipping import (
    AHEAD,
    BEHIND,
    MIRRORED,
    Clipper,
    View,
    times,
    total_extent,
)
from polywigner.kernels.cut.slice_sums import (
    COPIES,
    Pairings,
    SliceSum,
    Views,
    difference_pairings,
    mean_pairings,
    position_slice_parts,
    slice_parts,
)
from polywigner.kernels.functions.edge_terms import (
    EdgeTerms,
    ambiguity_terms,
    term_of_part,
    wigner_terms,
)
from polywigner.kernels.outline.constants import Edge
from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.outline.waves import (
    WavePair,
    pair_of_row,
    rows_of,
)
from polywigner.numerics.complex_pairs import Pair

# More pairs of waves are rows of a table: each compiles in some 20 ms.
MOST_PAIRS_AS_CODE = 16
# Columns of a row, a multiple of four: amplitude, shift and rate.
_ROW = 8

Values = tuple[Any, ...]
Listed = tuple[NDArray[np.intp], NDArray[np.float64]]


def sum_over_waves(
    clipper: Clipper,
    pairings: Pairings,
    sum_of: Callable[[WavePair, bool], Any],
    place: Values,
    count: int,
) -> list[Any]:
    """The ``count`` results of all pairs of waves together.

    ``sum_of``: (pair, whether the edges' and the pieces' field are one with real weights) -> its
    sum. A sum has ``values``, their number; ``terms(edge, sides)``, what an edge contributes from
    its cuts on each side; and ``value(sums, place)``, the pair's share of the result.

    Many pairs of waves are rows of a table: compiled code loops over it for each part of an edge.
    """
    tables, totals = clipper.tables, [0.0] * count
    for group in range(len(tables.groups)):
        for part in _sums_of_group(clipper, group, pairings, sum_of, place, count):
            totals = [a + b for a, b in zip(totals, part, strict=True)]
    return totals


def _sums_of_group(
    clipper: Clipper, group: int, pairings: Pairings, sum_of: Any, place: Values, count: int
) -> Iterator[Sequence[Any]]:
    tables, ops = clipper.tables, clipper.ops
    for other in range(len(tables.groups)):
        found = [(v, pairs) for number, v, pairs in pairings(group, tables) if number == other]
        is_compiled = ops.target not in ("numpy", "scalar")
        if is_compiled and sum(len(pairs) for _, pairs in found) > MOST_PAIRS_AS_CODE:
            for views, pairs in found:
                yield _sum_of_rows(clipper, (group, other), views, pairs, sum_of, place, count)
            continue
        is_even = other == group and not tables.phased
        runs = [(views, sum_of(pair, is_even)) for views, pairs in found for pair in pairs]

        def term(edge: Edge, runs: Any = runs, other: int = other) -> Values:
            cuts: dict[View, Any] = {}
            values: list[Any] = []
            for views, run in runs:
                for view, _ in views:
                    if view not in cuts:
                        cuts[view] = list(clipper.intervals(edge, view, other))
                values += run.terms(edge, [(side, cuts[view]) for view, side in views])
            return tuple(values)

        count_of_all = sum(run.values for _, run in runs)
        sums = iter(clipper.sum_over_edges(term, count_of_all, group, other))
        for _, run in runs:
            yield run.value([next(sums) for _ in range(run.values)], place)[:count]


def _sum_of_rows(
    clipper: Clipper,
    groups: tuple[int, int],
    views: Views,
    pairs: Sequence[WavePair],
    sum_of: Any,
    place: Values,
    count: int,
) -> Values:
    """Return the results of the pairs of waves of two groups by a loop over them."""
    ops, (group, other) = clipper.ops, groups
    rows = np.zeros((sum(len(pair.terms) for pair in pairs), _ROW))
    rows[:, :6] = rows_of(pairs)
    table, is_real = ops.held(rows), pairs[0].is_real

    def term(edge: Edge) -> Values:
        cuts = [(side, list(clipper.intervals(edge, view, other))) for view, side in views]

        def of_pair(row: Any) -> Values:
            run = sum_of(pair_of_row(is_real, *ops.gather(table, row)[:6]), False)
            return tuple(run.value(run.terms(edge, cuts), place)[:count])

        return tuple(ops.plain_sum(0, len(rows), of_pair, count))

    return tuple(clipper.sum_over_edges(term, count, group, other))


class TermSum:
    """The sum for a pair of waves of `EdgeTerms`: W or A."""

    def __init__(self, clipper: Clipper, terms: EdgeTerms, pair: WavePair, scale: float) -> None:
        """A point of an edge lies in the slice at ``scale (p + side T)``."""
        self.clipper, self.ops, self.function, self.pair = clipper, clipper.ops, terms, pair
        self.scale, self.values = scale, terms.values
        nu_x, nu_y = terms.nu
        turns = self.ops.fma(nu_x, clipper.tx, nu_y * clipper.ty)
        self.moved = {side: times(scale * side, turns) for side in (-0.5, 0.5)}

    def terms(self, edge: Edge, sides: Sequence[tuple[float, Any]]) -> Values:
        ops, function, scale = self.ops, self.function, self.scale
        nu_x, nu_y = function.nu
        key: Any = type(function), self.pair.shift
        if self.pair.is_constant:
            along = self.clipper.shared(edge, lambda: function.along(edge.ux, edge.uy), *key)
        else:
            along = function.along(edge.ux, edge.uy)
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


@dataclass(frozen=True)
class SharedSlice:
    """A kernel as a sum over parts of edges that depend on some of its arguments alone."""

    arguments: slice
    """Components of the place, on which the parts depend, among the caller's arguments."""
    place: slice
    """Components of the place among the arguments in the frame."""
    frequency: slice
    """Components of the frequency among the arguments in the frame."""
    list_parts: Callable[..., Listed]
    """(ops of NumPy in double precision, tables, *place) -> whose, (k, 8) rows."""
    terms: Callable[[Any, Values, bool], EdgeTerms]
    """(ops, frequency, whether weights are real) -> a part's terms."""

    def summed(self, ops: Any, columns: int, is_real: bool, *frequency: Any) -> PartSum:
        """Return the sum over rows of so many columns at a frequency."""
        return PartSum(self.terms, ops, columns == 4, is_real, frequency)

    def parts(self, ops: Any, tables: Tables, *place: Any) -> tuple[Listed, bool]:
        """Owners and rows of the parts at places (n,); and whether all weights are real.

        Rows are of four numbers where weights are 1 or -1 and no frequency is shifted: a part with
        the weight -1 is one that runs the other way.
        """
        owners, rows = self.list_parts(ops, tables, *place)
        order = np.argsort(owners, kind="stable")
        owners, rows = owners[order], rows[order]
        if (abs(rows[:, 4]) == 1.0).all() and not rows[:, 5:].any():
            rows[:, 2:4] *= rows[:, 4:5]
            rows = np.ascontiguousarray(rows[:, :4])
        return (owners, rows), not rows[:, 5:6].any()


class PartSum:
    """A sum over parts at given frequencies: shared terms, a part's term, the result."""

    def __init__(
        self, terms: Any, ops: Any, is_plain: bool, is_real: bool, frequency: Values
    ) -> None:
        self.ops, self.frequency = ops, frequency
        self.is_plain, self.is_real = is_plain, is_real
        self._at = terms
        self.terms: EdgeTerms = terms(ops, frequency, is_real)
        self.values = self.terms.values

    def term(self, *row: Any) -> Values:
        """Contribution of a part (x, y, dx, dy), or of all columns of a row."""
        if self.is_plain:
            return term_of_part(self.ops, self.terms, (*row, 1.0, 0.0))
        (nu_x, nu_y), (shift_x, shift_y) = self.frequency, row[6:]
        # a part with a frequency of its own
        terms = self._at(self.ops, (nu_x - shift_x, nu_y - shift_y), self.is_real)
        part = (*row[:5], 0.0 if self.is_real else row[5])
        return terms.total(term_of_part(self.ops, terms, part))

    def total(self, sums: Values) -> Values:
        """The kernel's sums from the sums of all terms: W, or A as cosine and sine part."""
        first, *second = self.terms.total(sums) if self.is_plain else sums
        return (first, *(-value for value in second))


def doubled_position(x: Any, y: Any, *frequency: Any) -> tuple[Any, Any]:
    """The offset between the copies: 2x."""
    return 2.0 * x, 2.0 * y


def _wigner(clipper: Clipper, x: Any, y: Any, *nu: Any) -> Values:
    """W(x, nu) in the units of the frame, for arguments in it: docs/theory.md, (W1), (W2), (I2)."""

    def sum_of(pair: WavePair, is_even: bool) -> TermSum:
        terms = wigner_terms(clipper.ops, pair.detuned(nu), is_even, pair.is_real)
        return TermSum(clipper, terms, pair, 2.0)

    return tuple(sum_over_waves(clipper, mean_pairings, sum_of, (x, y), 1))


def _lag_slice_area(clipper: Clipper, x: Any, y: Any) -> Values:
    """R_x(x) of elements without illumination: the area of the lag slice, in the frame."""
    ops = clipper.ops

    def term(edge: Edge) -> Values:
        lever = ops.fma(
            clipper.ty, 2.0 * edge.ex, ops.fma(clipper.tx, -2.0 * edge.ey, 4.0 * edge.area)
        )
        # the imaginary parts of two elements and of the same two the other way round cancel
        return (lever * total_extent(clipper, edge, MIRRORED)[0],)

    found: Values = clipper.sum_over_edges(term, values=1)
    return found


_LISTED = SharedSlice(
    arguments=slice(0, 2),
    place=slice(0, 2),
    frequency=slice(2, 4),
    list_parts=slice_parts,
    terms=lambda ops, nu, is_real: wigner_terms(ops, nu, is_real, True),
)
WIGNER_SUM = SliceSum((MIRRORED,), doubled_position, _wigner, _LISTED)
LAG_SLICE_AREA = SliceSum((MIRRORED,), doubled_position, _lag_slice_area)


def _lag(*inner: Any) -> tuple[Any, Any]:
    """The offset between the copies: xi, the last of the arguments."""
    return inner[-2], inner[-1]


def _ambiguity(clipper: Clipper, turns: Any, v_x: Any, v_y: Any, *xi: Any) -> Values:
    """A(upsilon, xi) in the frame, as (cosine part, sine part) with A = cosine - i sine."""

    def sum_of(pair: WavePair, is_even: bool) -> TermSum:
        terms = ambiguity_terms(clipper.ops, pair.detuned((v_x, v_y)))
        return TermSum(clipper, terms, pair, 1.0)

    real, imag = sum_over_waves(clipper, difference_pairings, sum_of, xi, 2)
    return real, -imag


def _position_slice_area(clipper: Clipper, *xi: Any) -> Values:
    """R_xi(xi), the area of the position slice in the frame, weighted by the mutual field.

    As real and imaginary part; the latter is there only for complex fields.
    """
    ops, is_phased = clipper.ops, clipper.tables.phased

    def term(edge: Edge) -> Values:
        lever = ops.fma(clipper.tx, edge.ey, clipper.ty * -edge.ex)
        real: Any = 0.0
        imag: Any = 0.0
        for view, side in COPIES:
            share = ops.fma(lever, side, edge.area)
            extent, turned = total_extent(clipper, edge, view)
            real = ops.fma(share, extent, real)
            if is_phased:
                imag = ops.fma(share, turned, imag)
        return (real, imag) if is_phased else (real,)

    real, *imag = clipper.sum_over_edges(term, values=2 if is_phased else 1)
    # not 0 times it: Dr.Jit makes a constant of that, which is as wide as the first samples were
    return 0.5 * real, 0.5 * imag[0] if imag else real - real


_LISTED_LAGS = SharedSlice(
    arguments=slice(2, 4),
    place=slice(3, 5),
    frequency=slice(1, 3),
    list_parts=position_slice_parts,
    terms=lambda ops, upsilon, is_real: ambiguity_terms(ops, upsilon),
)
AMBIGUITY_SUM = SliceSum((BEHIND, AHEAD), _lag, _ambiguity, _LISTED_LAGS)
POSITION_SLICE_AREA = SliceSum((BEHIND, AHEAD), _lag, _position_slice_area)
