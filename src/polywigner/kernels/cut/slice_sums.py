"""Sums over the edges of one copy of an outline that lie inside the other copy."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from polywigner.kernels.cut.cell_lists import CellLists, lists_of_one_cell
from polywigner.kernels.cut.cells import CellClipper, HeldLists, cell_of_offset, clipper_for
from polywigner.kernels.cut.clipping import View
from polywigner.kernels.cut.outer_bounds import may_meet
from polywigner.kernels.outline.tables import Tables

__all__ = ["SliceSum"]

Values = tuple[Any, ...]


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
    """How parts of edges are listed for many frequencies, a `SharedSlice`; None if they are not."""
    serves_all: bool = True
    """Whether compiled sums of one source serve all: not where they measure by its frame."""

    def __call__(self, ops: Any, tables: Tables, *inner: Any) -> Values:
        offset = self.offset(*inner)
        clipper = clipper_for(ops, tables, *offset, *self.views, arguments=inner)
        return self.summed(clipper, *inner)

    def cell_index(self, ops: Any, tables: Tables, *inner: Any, owner: Hashable = None) -> Any:
        """The number of the cell in which edges are looked up: samples are best sorted by it."""
        return cell_of_offset(ops, tables, *self.offset(*inner), self.views[0], owner)

    def cells(self, ops: Any, tables: Tables, *inner: Any) -> list[Any]:
        """The numbers of the cells in which edges are looked up, for each view."""
        offset = self.offset(*inner)
        return [cell_of_offset(ops, tables, *offset, view) for view in self.views]

    def in_cells(
        self, ops: Any, tables: Tables, cells: Sequence[Any] | None, owner: Hashable, *inner: Any
    ) -> Values:
        """The sums of samples whose cells are known, or None; ``owner``: whose lists to read."""
        offset = self.offset(*inner)
        clipper = CellClipper(ops, tables, *offset, self.views, inner, cells, owner)
        return self.summed(clipper, *inner)

    def in_one_cell(
        self, ops: Any, tables: Tables, lists: CellLists, hold: Callable[[Any], Any], *inner: Any
    ) -> Values:
        """The sums by lists of one cell, of which ``hold`` gives each table in an engine's memory.

        Of the source itself, nothing else is in the kernel.
        """
        held, cell = HeldLists(hold, lists), ops.truncated(1.0)
        clipper = CellClipper(
            ops,
            tables,
            *self.offset(*inner),
            self.views,
            inner,
            [cell] * len(self.views),
            lists=(lists, held),
        )
        return self.summed(clipper, *inner)

    def lists(self, tables: Tables) -> CellLists:
        """For :meth:`in_one_cell`: of all views, since one mirrors, and two differ by an offset."""
        return lists_of_one_cell(tables, self.views[0].point)

    def support_mask(self, tables: Tables, *inner: Any) -> Any:
        """Where, on NumPy arrays, the sums may differ from 0."""
        return may_meet(tables, self.views[0], *self.offset(*inner))

    def after(self, count: int) -> SliceSum:
        """For arguments of which the first so many are others'."""
        return replace(
            self,
            offset=lambda *inner: self.offset(*inner[count:]),
            summed=lambda clipper, *inner: self.summed(clipper, *inner[count:]),
            listed=None,
        )
