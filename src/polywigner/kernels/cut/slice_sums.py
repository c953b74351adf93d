"""Sums over the edges of one copy of an outline that lie inside the other copy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.cut.clipping import MIRRORED, View
from polywigner.kernels.cut.pair_grid import PairGrid
from polywigner.kernels.cut.winding import ListedClipper, PairClipper, Pass, clipper_for
from polywigner.kernels.outline.tables import Tables, cut_of

_DIRECTIONS = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
# In the frame, whose unit is the size of the polygon: more than anything is rounded by.
_MARGIN = 1e-6

Mask = NDArray[np.bool_]


def _bounds(tables: Tables) -> tuple[list[float], list[float]]:
    levels = np.array([(edge.ax, edge.ay) for edge in tables.edges]) @ _DIRECTIONS.T
    return levels.min(axis=0).tolist(), levels.max(axis=0).tolist()


def may_meet(tables: Tables, view: View, tx: Any, ty: Any) -> Mask:
    """Where copies at offsets T = 2x or xi of the frame may overlap, or offsets are not numbers."""
    apart = np.zeros(np.shape(tx), bool)
    for (a, b), low, high in zip(_DIRECTIONS.tolist(), *_bounds(tables), strict=True):
        level = a * tx + b * ty
        if view is MIRRORED:
            apart |= (level < 2.0 * low - _MARGIN) | (level > 2.0 * high + _MARGIN)
        else:
            apart |= np.abs(level) > high - low + _MARGIN
    return ~apart


Values = tuple[Any, ...]

# Samples and edges at a time: temporary arrays of some 2 MB.
_LISTED = 1 << 17


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
    serves_all: bool = True
    """Whether compiled sums of one source serve all: not where they measure by its frame."""

    def __call__(self, ops: Any, tables: Tables, *inner: Any) -> Values:
        if ops.target == "numpy" and cut_of("numpy", tables, max(map(ops.count, inner))) == "pairs":
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

    def support_mask(self, tables: Tables, *inner: Any) -> Any:
        """Where, on NumPy arrays, the sums may differ from 0."""
        return may_meet(tables, self.views[0], *self.offset(*inner))

    def after(self, count: int) -> SliceSum:
        """Return the sum for arguments behind so many others."""
        return replace(
            self,
            offset=lambda *inner: self.offset(*inner[count:]),
            summed=lambda clipper, *inner: self.summed(clipper, *inner[count:]),
            listed=None,
        )
