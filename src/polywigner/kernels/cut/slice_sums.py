"""Sums over the edges of one copy of an outline that lie inside the other copy."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED, View
from polywigner.kernels.cut.pair_grid import PairGrid
from polywigner.kernels.cut.winding import (
    ListedClipper,
    ListedParts,
    PairClipper,
    Pass,
    clipper_for,
)
from polywigner.kernels.outline.tables import Tables
from polywigner.kernels.outline.waves import WavePair, difference_pairs, mean_pairs
from polywigner.numerics.complex_pairs import Pair

Values = tuple[Any, ...]

# Samples and edges at a time: temporary arrays of some 2 MB.
_LISTED = 1 << 14


@dataclass(frozen=True, eq=False)
class SliceSum:
    """A kernel's sum over edges that are cut: called like any other, or with known cells."""

    views: tuple[View, ...]
    """In which views edges are cut: one for W, two for A."""
    offset: Callable[..., tuple[Any, Any]]
    """(*arguments in the frame) -> the offset T = 2x or xi between the copies."""
    summed: Callable[..., Values]
    """(clipper, *arguments in the frame) -> sums."""
    listed: Any = None
    """`SharedSlice` that lists parts of edges for many frequencies; None: parts are not listed."""

    def __call__(self, ops: Any, tables: Tables, *inner: Any) -> Values:
        if ops.target == "numpy":
            return self._listed(ops, tables, inner)
        offset = self.offset(*inner)
        clipper = clipper_for(ops, tables, *offset, *self.views, arguments=inner)
        return self.summed(clipper, *inner)

    def _listed(self, ops: Any, tables: Tables, inner: Values) -> Values:
        """The sums on NumPy: over parts of edges, which are listed for some samples at a time."""
        shape = np.broadcast_shapes(*map(np.shape, inner)) or (1,)
        flat = [np.broadcast_to(a, shape).ravel() for a in inner]
        size = max(1, _LISTED // len(tables.edges))
        found = []
        for start in range(0, flat[0].size, size):
            some = [a[start : start + size] for a in flat]
            clipper = ListedClipper(ops, tables, self.views, *self.offset(*some))
            sums = self.summed(clipper, *(a[clipper.owner] for a in some))
            # what lies at infinity or is not a number is so in the result
            lost = sum(a - a for a in some)
            results = [np.zeros(len(some[0]), ops.dtype) for _ in sums]
            for result, values in zip(results, sums, strict=True):
                result[clipper.owner] = values
            found.append([result + lost for result in results])
        columns = (np.concatenate(column) for column in zip(*found, strict=True))
        return tuple(column.reshape(shape) for column in columns)

    def by_pairs(
        self, ops: Any, tables: Tables, pairs: Mapping[Pass, PairGrid] | None, *inner: Any
    ) -> Values:
        """Sums by lists of pairs in an engine's memory, by default the tables' own."""
        return self.summed(self._clipper(ops, tables, pairs, inner), *inner)

    def cell(
        self, ops: Any, tables: Tables, pairs: Mapping[Pass, PairGrid] | None, *inner: Any
    ) -> Any:
        """The number of the cell in which pairs are looked up: samples are best sorted by it."""
        return self._clipper(ops, tables, pairs, inner).cell((self.views[0], 0, 0))

    def _clipper(
        self, ops: Any, tables: Tables, pairs: Mapping[Pass, PairGrid] | None, inner: Values
    ) -> PairClipper:
        return PairClipper(ops, tables, *self.offset(*inner), self.views, inner, pairs)

    def passes(self, tables: Tables) -> list[Pass]:
        """All lists that the sums read."""
        fields = range(len(tables.groups))
        views = {view.point: view for view in reversed(self.views)}.values()
        return [(view, own, other) for view in views for own in fields for other in fields]

    def after(self, count: int) -> SliceSum:
        """Return the sum for arguments behind so many others."""
        return replace(
            self,
            offset=lambda *inner: self.offset(*inner[count:]),
            summed=lambda clipper, *inner: self.summed(clipper, *inner[count:]),
            listed=None,
        )


# ---- pairs of waves --------------------------------------------------------------------------

Views = tuple[tuple[View, float], ...]
"""Views, and which copy of the edges each is of: its points are p + side T."""
Pairings = Callable[[int, Tables], Iterator[tuple[int, Views, Sequence[WavePair]]]]
"""(group of edges, tables) -> for each group of pieces the views that it cuts the edges in, and the
pairs of waves there."""

MIRROR: Views = ((MIRRORED, -0.5),)
COPIES: Views = ((BEHIND, -0.5), (AHEAD, +0.5))


def mean_pairings(group: int, tables: Tables) -> Iterator[tuple[int, Views, Sequence[WavePair]]]:
    """Pairs of waves for W and the moments of the lag slice."""
    for other, waves in enumerate(tables.groups):
        yield other, MIRROR, mean_pairs(tables.groups[group], waves, other == group)


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


# ---- parts of edges that bound slices, listed once for each position or lag --------------------

PART_COLUMNS = 8
"""Middle and vector of a part, in the frame and as a lag; the complex weight; the shift of nu."""

Listed = tuple[NDArray[np.intp], NDArray[np.float64]]


def slice_parts(ops: Any, tables: Tables, x: Any, y: Any) -> Listed:
    """The parts of the slices at positions (n,) of the frame: whose each is (k,), rows (k, 8).

    They do not depend on the frequency: W and the moments (T1) at one position are plain sums over
    them, by a kernel that is the same for all sources. ``ops``: of NumPy in double precision.
    """
    return _listed(ops, tables, mean_pairings, (x, y), 2.0)


def position_slice_parts(ops: Any, tables: Tables, x: Any, y: Any) -> Listed:
    """Parts of the position slices at lags (n,), for A; vectors and middles are positions."""
    return _listed(ops, tables, difference_pairings, (x, y), 1.0)


def _listed(
    ops: Any, tables: Tables, pairings: Pairings, place: tuple[Any, Any], scale: float
) -> Listed:
    """A point of an edge lies in the slice at ``scale (p + side T)``, T = ``scale`` times place."""
    count = place[0].size
    offset = tuple(np.broadcast_to(scale * c, count) for c in place)
    owners, rows = [np.empty(0, np.intp)], [np.empty((0, PART_COLUMNS))]
    for group in range(len(tables.groups)):
        for other, views, pairs in pairings(group, tables):
            for view, side in views:
                found = ListedParts(ops, tables, (view, group, other), *offset)
                edge, owner = found.edge, found.owner
                t, s = 1.0 - 0.5 * found.part, scale * found.part
                tx, ty = (side * t[owner] for t in offset)
                x, y = edge.ax + tx + t * edge.ex, edge.ay + ty + t * edge.ey
                weight = Pair(*(np.broadcast_to(w, len(owner)) for w in found.weight))
                weight = weight.conjugate() if view is AHEAD else weight
                for pair in pairs:
                    amplitude = (np.broadcast_to(a, count) for a in pair.amplitude(ops, place))
                    whole = Pair(*(a[owner] for a in amplitude)) * weight
                    table = np.empty((len(owner), PART_COLUMNS))
                    columns = (scale * x, scale * y, s * edge.ex, s * edge.ey)
                    table[:, :6] = np.stack([*columns, whole.real, whole.imag], axis=-1)
                    table[:, 6:] = pair.shift
                    owners.append(owner)
                    rows.append(table)
    return np.concatenate(owners), np.concatenate(rows)
