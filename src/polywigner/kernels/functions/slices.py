"""Wigner and ambiguity functions as sums over the edges of slices, (W1), (W2) and (A1).

A slice is the intersection of two copies of the source. For fields of several plane waves, each
pair of waves contributes the sum for a uniform source at a shifted frequency, times an amplitude
that depends only on position or lag, (I2) and (I3). Edges are clipped once for all pairs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED, Clipper, Cuts, Edge, View
from polywigner.kernels.cut.pair_grid import PairGrid, cut_edges, rows_at
from polywigner.kernels.cut.winding import PairClipper, Pass, pairs_of
from polywigner.kernels.functions.edge_terms import (
    AreaTerms,
    EdgeTerms,
    ambiguity_terms,
    scaled,
    wigner_terms,
)
from polywigner.kernels.outline import Tables
from polywigner.kernels.wave_pairs import (
    WavePair,
    difference_pairs,
    mean_pairs,
    pair_of_row,
    rows_of,
)
from polywigner.numerics.phases import Pair

Values = tuple[Any, ...]
Array = NDArray[Any]
Views = tuple[tuple[View, float], ...]
"""Pairs of a view and a side. The point p of an edge becomes the point ``scale (p + side T)`` of
the slice at the offset T."""
Pairing = tuple[int, int, Views, Sequence[WavePair]]
"""Group whose edges are clipped, group of the other copy, views of the edges, and pairs of
waves."""

# Numbers of pairs (sample, edge) and of pairs (part of an edge, frequency) per block with NumPy.
# The arrays of a block take about 2 MB.
_CUT, _SUMMED = 1 << 14, 1 << 14
# Number of samples for which the lists of edge pairs are optimised with NumPy.
_SAMPLES = 1 << 9
# Largest number of wave pairs that compiled code contains as constants. Compilation takes 20 ms per
# pair.
MOST_PAIRS_AS_CODE = 16
# Columns of a table of wave pairs: amplitude, shift and rate, padded to a multiple of four.
_ROW = 8


@dataclass(frozen=True, eq=False)
class SliceSum:
    """Sum over the edges of a slice, the second step of a kernel of W or A."""

    views: tuple[View, ...]
    """Views of the clipped edges: one view for W, two views for A."""
    scale: float
    """Ratio of the offset T to the position or lag: 2 for W, 1 for A."""
    position: slice
    """Indices of the position or lag among the arguments in the frame."""
    frequency: slice
    pairings: Callable[[Tables], Sequence[Pairing]]
    terms: Callable[[Any, Tables, Values, bool, bool], EdgeTerms]
    """Function (ops, tables, frequency, is_even, is_real) that returns the terms of a pair of
    waves.

    ``is_even`` specifies real weights and equal fields, and ``is_real`` that only the real part is
    required.
    """
    values: int
    """Number of results: 1 for a real sum, or 2 for the real part and minus the imaginary part."""
    arguments: slice | None = None
    """Indices of the position or lag among the caller's arguments. None if frequencies cannot share
    a slice."""

    def __call__(self, ops: Any, tables: Tables, *inner: Any) -> Values:
        """Return the sums over edges, by the method that suits the operations ``ops``."""
        if ops.target != "numpy":
            return self._compiled(ops, tables, inner)
        x, y, *nu = map(np.asarray, (*inner[self.position], *inner[self.frequency]))
        # Infinite and NaN arguments must give NaN: 0 x is NaN for these values, and 0 otherwise.
        zero = np.asarray(0.0 * (x + y + (nu[0] + nu[1])))
        shape, columns = zero.shape or (1,), 1
        # All frequencies along the second axis use the slices of the positions along the first
        # axis.
        is_shared = len(shape) == 2 and x.shape == y.shape == (len(zero), 1)
        if is_shared:
            columns, (x, y) = shape[1], (x[:, 0], y[:, 0])
            nu = list(np.broadcast_arrays(*nu, zero[:1])[:2])
        elif not x.shape == y.shape == nu[0].shape == nu[1].shape == (zero.size,):
            x, y, *nu = (np.broadcast_to(a, shape).reshape(-1) for a in (x, y, *nu))
            zero = zero.reshape(-1)
        totals = np.empty((self.values, *zero.shape))
        totals[...] = zero
        # Each temporary array has one entry per pair (sample, edge) or per pair (position,
        # frequency).
        step = max(1, min(_CUT, 16 * _CUT // (columns or 1)) // len(tables.edges))
        for rows, pair, is_even, owner, part in self.parts(tables, (x, y), step):
            in_rows = nu if len(nu[0]) == 1 else [n[rows] for n in nu]
            shifted = in_rows if pair.is_unit else pair.detuned(in_rows)
            terms = self.terms(ops, tables, tuple(shifted), is_even, pair.is_real)
            count, sums = rows.stop - rows.start, []
            if is_shared:
                sums = _row_sums(terms, owner, part, count, np.shape(in_rows[0]))
            else:
                for value in terms.at(owner).of_part(*part):
                    sums.append(np.bincount(owner, value, count))
            values = terms.total(tuple(sums))
            if not pair.is_unit:
                points = [p[rows, None] if is_shared else p[rows] for p in (x, y)]
                values = _with_amplitude(values, pair.amplitude(ops, points))
            for total, value in zip(totals, values, strict=False):
                total[rows] += value
        return self._as_waves(list(totals.reshape(self.values, *shape)))

    def _compiled(self, ops: Any, tables: Tables, inner: Values) -> Values:
        """Return the sums over edges for Dr.Jit arrays and Python floats."""
        # Dr.Jit cannot differentiate nested loops, so gradients need an unrolled loop over edges.
        if ops.needs_gradient(*inner) or (ops.target == "compiled" and tables.fits_code):
            offset = (self.scale * c for c in inner[self.position])
            return self._summed(Clipper(ops, tables, *offset), inner)
        return self.by_pairs(ops, tables, None, *inner)

    def by_pairs(
        self, ops: Any, tables: Tables, pairs: Mapping[Pass, PairGrid] | None, *inner: Any
    ) -> Values:
        """Return the sums from edge pairs. ``pairs`` defaults to the edge pairs of ``tables``."""
        tx, ty = (self.scale * c for c in inner[self.position])
        return self._summed(PairClipper(ops, tables, tx, ty, self.views, inner, pairs), inner)

    def passes(self, tables: Tables) -> list[Pass]:
        """Return the keys of all edge pairs that the sums need."""
        fields = range(len(tables.groups))
        views = {view.point: view for view in reversed(self.views)}.values()
        return [(view, field, other) for view in views for field in fields for other in fields]

    def after(self, count: int) -> SliceSum:
        """Return the same sum for a kernel with ``count`` additional arguments in front."""
        position, frequency = (
            slice(s.start + count, s.stop + count) for s in (self.position, self.frequency)
        )
        return replace(self, position=position, frequency=frequency, arguments=None)

    def _summed(self, clipper: Clipper, inner: Values) -> Values:
        """Return W or A, without its unit, as sums over the edges that ``clipper`` clips."""
        nu = inner[self.frequency]

        def sum_of(views: Views, pair: WavePair, is_even: bool) -> TermSum:
            """Return the sum over edges for a pair of waves."""
            shifted = pair.detuned(nu)
            terms = self.terms(clipper.ops, clipper.tables, shifted, is_even, pair.is_real)
            return TermSum(clipper, terms, views, pair, self.scale)

        totals, position = [0.0] * self.values, inner[self.position]
        for sums in self._sums_of_pairings(clipper, sum_of, position):
            totals = [a + b for a, b in zip(totals, sums, strict=True)]
        return self._as_waves(totals)

    def _as_waves(self, totals: Sequence[Any]) -> Values:
        """Return a real sum, or the real part and minus the imaginary part of a complex sum."""
        return tuple(totals) if self.values == 1 else (totals[0], -totals[1])

    def _sums_of_pairings(
        self, clipper: Clipper, sum_of: Callable[[Views, WavePair, bool], TermSum], position: Values
    ) -> Iterator[Sequence[Any]]:
        """Yield the sums over edges for all pairs of waves, which the caller adds.

        ``sum_of(views, pair, is_even)`` returns the `TermSum` of a pair of waves.
        """
        tables, ops, count = clipper.tables, clipper.ops, self.values
        pairings: dict[tuple[int, int], list[tuple[Views, Sequence[WavePair]]]] = {}
        for group, other, views, pairs in self.pairings(tables):
            pairings.setdefault((group, other), []).append((views, pairs))
        for (group, other), wave_pairs in pairings.items():
            if ops.target != "scalar" and sum(len(p) for _, p in wave_pairs) > MOST_PAIRS_AS_CODE:
                for views, pairs in wave_pairs:
                    yield _sum_of_rows(
                        clipper, (group, other), views, pairs, sum_of, position, count
                    )
                continue
            is_even = other == group and not tables.phased
            runs = [sum_of(views, pair, is_even) for views, pairs in wave_pairs for pair in pairs]
            for run, sums in clipper.sums_of_runs(runs, group, other):
                yield run.value(sums, position)[:count]

    def parts(
        self, tables: Tables, position: Sequence[Array], step: int
    ) -> Iterator[tuple[slice, WavePair, bool, Array, tuple[Any, ...]]]:
        """Yield the parts of edges of slices for each pair of waves, in blocks of positions, (K1).

        The results are a Python slice that selects the positions of a block (up to ``step``), the
        pair of waves, a flag for even terms, the index of each part's position within the block,
        and the parts. A part is a tuple (centre x, centre y, vector x, vector y, real weight,
        imaginary weight) in the lag slice or position slice.
        """
        lists = tables.lists.get(self.pairings)
        if lists is None:
            lists = tables.lists.setdefault(self.pairings, list(self._lists(tables)))
        count = len(position[0])
        for k in range(0, count, step):
            rows = slice(k, min(k + step, count))
            t = np.empty(rows.stop - k, np.complex128)
            t.real, t.imag = position[0][rows], position[1][rows]
            for pairs, is_even, grid, sign, side in lists:
                cells = grid.cell_map
                numbers = np.rint((sign * self.scale / cells.step) * t.view(np.float64))
                offset = (cells.step * numbers).view(np.complex128)
                row, owner = rows_at(cells, offset)
                owner, end, vector, weight = cut_edges(grid.pair_rows, row, owner, offset, sign)
                vector *= self.scale
                centre = self.scale * end - 0.5 * vector
                centre += (self.scale * sign * side) * offset.take(owner)
                imag: Any = 0.0
                # The weights of the edges of the copy AHEAD are conjugated.
                if weight.dtype.kind == "c":
                    weight, imag = weight.real, -weight.imag if side > 0.0 else weight.imag
                part = centre.real, centre.imag, vector.real, vector.imag, weight, imag
                for pair in pairs:
                    yield rows, pair, is_even, owner, part

    def _lists(self, tables: Tables) -> Iterator[tuple[Any, ...]]:
        """Yield the edge pairs of each view, as the entries of ``Tables.lists``.

        An entry contains the pairs of waves, a flag for even terms, the edge pairs, the sign of the
        offset, and the side of the copy.
        """
        for group, other, views, pairs in self.pairings(tables):
            is_even = other == group and not tables.phased
            for view, side in views:
                key = view, group, other
                grid = pairs_of(tables, key, True, _SAMPLES, is_compiled=False)
                yield pairs, is_even, grid, view.side, side

    def listed(self, ops: Any, tables: Tables, *position: Array) -> tuple[Array, Array, bool]:
        """Return the parts of edges of the slices at all positions, for compiled code.

        The results are indices (n + 1,), a table (parts, 4 or 8), and whether all weights are real.
        The parts of position k are the rows from ``indices[k]`` to ``indices[k + 1]`` - 1. If all
        weights are 1 or -1 and no frequency is shifted, a row contains the centre and the vector of
        a part, and parts with a weight of -1 are reversed. In all other cases, a row also contains
        the complex weight and the frequency shift.
        """
        owners, rows, count = [np.empty(0, np.intp)], [np.empty((0, _ROW))], len(position[0])
        for _, pair, _, owner, (*geometry, real, imag) in self.parts(tables, position, count):
            values = (np.broadcast_to(a, count) for a in pair.amplitude(ops, position))
            factor = Pair(*(a[owner] for a in values)) * Pair(real, imag)
            columns = (*geometry, factor.real, factor.imag, *pair.shift)
            owners.append(owner)
            rows.append(np.stack([np.broadcast_to(c, len(owner)) for c in columns], axis=-1))
        number, table = np.concatenate(owners), np.concatenate(rows)
        order = np.argsort(number, kind="stable")
        table, is_real = table[order], not table[:, 5].any()
        if (abs(table[:, 4]) == 1.0).all() and not table[:, 5:].any():
            table[:, 2:4] *= table[:, 4:5]
            table = np.ascontiguousarray(table[:, :4])
        ends = np.searchsorted(number[order], np.arange(count + 1))
        return ends, table, is_real

    def of_listed(
        self, ops: Any, tables: Tables, columns: int, is_real: bool, nu: Values
    ) -> PartSum:
        """Return the sum over rows of :meth:`listed` with 4 or 8 columns, at frequencies ``nu``."""

        def terms(shifted: Values) -> EdgeTerms:
            """Return the terms at a frequency minus the shift of a pair of waves."""
            return self.terms(ops, tables, shifted, is_real, self.values == 1)

        return PartSum(terms, nu, columns == 4, is_real, self._as_waves)


def _row_sums(
    terms: EdgeTerms, owner: Array, part: Sequence[Any], count: int, shape: tuple[int, ...]
) -> list[Array]:
    """Return the sums of terms over the edge parts of each position, for tables of frequencies.

    ``owner`` contains the position of each part in ascending order, ``count`` is the number of
    positions, and ``shape`` the shape of the table of frequencies.
    """
    rows, columns = shape
    results = [np.zeros((count, columns)) for _ in range(terms.values)]
    begins, step = np.flatnonzero(np.diff(owner, prepend=-1)), max(1, _SUMMED // (len(owner) or 1))
    numbers = [p[:, None] if np.ndim(p) else p for p in part]
    for k in range(0, columns if len(owner) else 0, step):
        block = slice(k, k + step)
        in_block = terms.at(owner if rows > 1 else slice(None), block)
        for result, value in zip(results, in_block.of_part(*numbers), strict=True):
            result[owner[begins], block] = np.add.reduceat(value, begins, axis=0)
    return results


def _with_amplitude(total: Values, amplitude: tuple[Any, Any]) -> Values:
    """Return a sum, real or complex, times a complex amplitude."""
    real, imag = amplitude
    if isinstance(imag, float) and imag == 0.0:
        return tuple(scaled(real, value) for value in total)
    product = Pair(*total) * Pair(real, imag)
    return product.real, product.imag


def _sum_of_rows(
    clipper: Clipper,
    groups: tuple[int, int],
    views: Views,
    pairs: Sequence[WavePair],
    sum_of: Any,
    position: Values,
    count: int,
) -> Values:
    """Return the sums for many pairs of waves, which a loop reads from memory.

    The arguments are those of :meth:`SliceSum._sums_of_pairings`, for one pair of groups.
    """
    ops, (group, other) = clipper.ops, groups
    rows = np.zeros((sum(len(pair.terms) for pair in pairs), _ROW))
    rows[:, :6] = rows_of(pairs)
    table, is_real = ops.on_device(rows), pairs[0].is_real

    def term(edge: Edge) -> Values:
        cuts = {view: list(clipper.intervals(edge, view, other)) for view, _ in views}

        def of_pair(row: Any) -> Values:
            run = sum_of(views, pair_of_row(is_real, *ops.gather(table, row)[:6]), False)
            return tuple(run.value(run.terms(edge, cuts), position)[:count])

        return tuple(ops.plain_sum(0, len(rows), of_pair, count))

    return tuple(clipper.sum_over_edges(term, count, group, other))


class TermSum:
    """Sum over edges for a pair of waves, in compiled code."""

    def __init__(
        self, clipper: Clipper, terms: EdgeTerms, views: Views, pair: WavePair, scale: float
    ) -> None:
        self.clipper, self.ops, self.function, self.pair = clipper, clipper.ops, terms, pair
        self.views, self.scale, self.values = views, scale, terms.values
        if not terms.by_part:
            nu_x, nu_y = terms.nu
            cycles = self.ops.fma(nu_x, clipper.tx, nu_y * clipper.ty)
            self.moved = {side: scaled(scale * side, cycles) for side in (-0.5, 0.5)}

    def terms(self, edge: Edge, cuts: Cuts) -> Values:
        """Return the contribution of an edge: the sum over its parts in all views."""
        ops, function, scale = self.ops, self.function, self.scale
        if function.by_part:
            return self._part_terms(edge, cuts)
        nu_x, nu_y = function.nu
        key: Any = type(function), self.pair.shift
        if self.pair.is_constant:
            along = self.clipper.shared(edge, lambda: function.along(edge.ux, edge.uy), *key)
        else:
            along = function.along(edge.ux, edge.uy)
        length = scale * edge.length
        per_edge = (0.5 * length) * along[0]
        sums: Values | None = None
        for view, side in self.views:
            start = ops.fma(nu_y, scale * edge.ay, self.moved[side])
            start = ops.fma(nu_x, scale * edge.ax, start)
            for ends_sum, extent, real, imag in cuts[view]:
                cycles = ops.fma(ends_sum, per_edge, start)
                sums = function.added(sums, extent * per_edge, cycles, extent, (real, imag))
        if sums is None:
            return (0.0,) * self.values
        return function.of_edge(along, length, sums)

    def _part_terms(self, edge: Edge, cuts: Cuts) -> Values:
        """Return the contribution of an edge for terms that need each part separately."""
        ops, scale, clipper = self.ops, self.scale, self.clipper
        total: Values = (0.0,) * self.values
        for view, side in self.views:
            tx, ty = (2.0 * side * t for t in (clipper.tx, clipper.ty))
            for ends_sum, extent, *weight in cuts[view]:
                remains = extent > 0.0
                t = 0.5 * scale * ops.select(remains, ends_sum, 0.0)
                fraction = scale * ops.select(remains, extent, 0.0)
                x = ops.fma(t, edge.ex, scale * edge.ax + (0.5 * scale) * tx)
                y = ops.fma(t, edge.ey, scale * edge.ay + (0.5 * scale) * ty)
                values = self.function.of_part(
                    x, y, fraction * edge.ex, fraction * edge.ey, *weight
                )
                total = tuple(a + b for a, b in zip(total, values, strict=True))
        return total

    def value(self, sums: Sequence[Any], position: Values) -> Values:
        """Return the contribution of a pair of waves to W or A from the sums over edges."""
        amplitude = self.pair.amplitude(self.ops, position)
        return _with_amplitude(self.function.total(tuple(sums)), amplitude)


class PartSum:
    """Sum over a list of parts of edges, in compiled code."""

    def __init__(
        self, terms: Any, nu: Values, is_plain: bool, is_real: bool, as_waves: Any
    ) -> None:
        self._at, self.nu, self.is_plain, self.is_real = terms, nu, is_plain, is_real
        self.terms, self._as_waves = terms(nu), as_waves
        self.values = self.terms.values

    def term(self, *row: Any) -> Values:
        """Return the contribution of one row of the list."""
        if self.is_plain:
            values: Values = self.terms.of_part(*row, 1.0, 0.0)
            return values
        (nu_x, nu_y), (shift_x, shift_y) = self.nu, row[6:]
        terms = self._at((nu_x - shift_x, nu_y - shift_y))
        total: Values = terms.total(terms.of_part(*row[:5], 0.0 if self.is_real else row[5]))
        return total

    def total(self, sums: Values) -> Values:
        """Return the values of the slice sum from the sums over all rows."""
        values: Values = self._as_waves(self.terms.total(sums) if self.is_plain else sums)
        return values


_MIRROR: Views = ((MIRRORED, -0.5),)
_BOTH: Views = ((BEHIND, -0.5), (AHEAD, +0.5))


def mean_pairings(tables: Tables) -> list[Pairing]:
    """Return the pairs of waves that contribute to the Wigner function."""
    groups = list(enumerate(tables.groups))
    return [
        (k, n, _MIRROR, mean_pairs(field, other, k == n))
        for k, field in groups
        for n, other in groups
    ]


def difference_pairings(tables: Tables) -> list[Pairing]:
    """Return the pairs of waves that contribute to the ambiguity function.

    The field on the clipped edges is the first factor of the product for the view BEHIND, and the
    second factor for the view AHEAD.
    """
    pairings: list[Pairing] = []
    for k, field in enumerate(tables.groups):
        for n, other in enumerate(tables.groups):
            if k == n:
                pairings.append((k, n, _BOTH, difference_pairs(field, field)))
                continue
            pairings.append((k, n, _BOTH[:1], difference_pairs(field, other)))
            pairings.append((k, n, _BOTH[1:], difference_pairs(other, field)))
    return pairings


WIGNER_SUM = SliceSum(
    views=(MIRRORED,),
    scale=2.0,
    position=slice(0, 2),
    frequency=slice(2, 4),
    pairings=mean_pairings,
    terms=wigner_terms,
    values=1,
    arguments=slice(0, 2),
)
AMBIGUITY_SUM = SliceSum(
    views=(BEHIND, AHEAD),
    scale=1.0,
    position=slice(3, 5),
    frequency=slice(1, 3),
    pairings=difference_pairings,
    terms=ambiguity_terms,
    values=2,
    arguments=slice(2, 4),
)
# The sum for the area of a slice needs no frequency, so the lag is passed in its place.
AREA_SUM = replace(
    AMBIGUITY_SUM,
    position=slice(0, 2),
    frequency=slice(0, 2),
    terms=AreaTerms,
    values=1,
    arguments=None,
)
