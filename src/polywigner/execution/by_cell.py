"""Samples in the order of the cells in which their edges are looked up.

Lanes of a vector that run through the same lists take the same steps. Where one list is all that a
sample needs, a lane takes four samples of one cell: it reads each row once for all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.aligned import aligned, array_of
from polywigner.execution.drjit_ranges import packet_type
from polywigner.execution.frozen import frozen, is_recording
from polywigner.execution.operations import DrjitOperations
from polywigner.kernels import Kernel
from polywigner.kernels.cut.cell_lists import cell_lists
from polywigner.kernels.cut.cells import arrays_of
from polywigner.kernels.cut.clipping import MIRRORED
from polywigner.kernels.outline.tables import cut_of

__all__ = ["ByCell", "Groups", "grouped", "order_of", "sorts", "traced_by_cell"]

# Samples at a time: they stay in the cache of a core while they are shuffled.
_CHUNK = 1 << 18
# Samples of one cell that a lane computes together: as many as Dr.Jit has packets for.
_TOGETHER = 4
# Numbers of a cache line: arrays of a multiple of them that follow each other are aligned alike.
_LINE = 16
# Numbers of 32 bits, four times as fast as one by one; before NumPy 2 on few processors only.
_SORTS_BY_VECTORS = int(np.__version__.split(".")[0]) >= 2

Numbers = npt.NDArray[Any]


def order_of(cell: Numbers) -> Numbers:
    """The indices that bring the numbers of cells into their order."""
    bits, most = (len(cell) - 1).bit_length(), int(cell.max(initial=0))
    if _SORTS_BY_VECTORS and most < 1 << (32 - bits):
        # number of the cell and number of the sample in one
        key = cell.astype(np.uint32)
        key <<= np.uint32(bits)
        key |= np.arange(len(cell), dtype=np.uint32)
        key.sort()
        key &= np.uint32((1 << bits) - 1)
        return key
    # NumPy sorts numbers of 16 bits in linear time.
    return np.argsort(cell.astype(np.uint16) if most < 1 << 16 else cell, kind="stable")


@dataclass(frozen=True, eq=False)
class Groups:
    """Groups of samples that lie in one cell."""

    order: Numbers
    """All samples, sorted by their cells."""
    cells: Numbers
    """The cell of each group; there are a multiple of a cache line's numbers."""
    first: Numbers
    """Where in the order group 0 would begin, for each cell, if all groups were of this cell."""
    last: Numbers
    """Where in the order the samples of each cell end."""


def grouped(cell: Numbers, size: int) -> Groups:
    """Samples in groups of ``size`` of one cell, in the order of the cells."""
    counts = np.bincount(cell)
    groups = -(-counts // size)
    total, ends = int(groups.sum()), counts.cumsum()
    cells = aligned(-(-total // _LINE) * _LINE, np.uint32)
    cells[:total] = np.repeat(np.arange(len(counts), dtype=np.uint32), groups)
    cells[total:] = cells[total - 1]
    before = ends - counts - size * (groups.cumsum() - groups)
    return Groups(order_of(cell), cells, before, ends - 1)


def sorts(kernel: Kernel, tables: Any, float_type: Any, components: Sequence[Any]) -> bool:
    """Whether Dr.Jit arrays may be evaluated and sorted, and edges are looked up in cells.

    Not where derivatives are taken, nor within a function that is being recorded.
    """
    import drjit

    if kernel.slices is None or drjit.backend_v(float_type) != drjit.JitBackend.LLVM:
        return False  # on a GPU the numbers of the cells would have to come over
    if not cut_of("sorted", tables).endswith("cells"):
        return False
    recording = drjit.flag(drjit.JitFlag.SymbolicScope) or drjit.flag(drjit.JitFlag.FreezingScope)
    return not recording and not any(map(drjit.grad_enabled, components))


@dataclass(frozen=True, eq=False)
class Begun:
    """Samples of which the cells are known."""

    cell: Numbers
    rows: Any
    """Their arguments in the frame, rows of a table of so many entries, of which so many count."""
    width: int
    arguments: int

    def groups(self, size: int) -> Groups:
        """In the order of the cells."""
        return grouped(self.cell, size)


class ByCell:
    """A kernel of a source that takes samples by their cells."""

    def __init__(self, kernel: Kernel, tables: Any, entry: DrjitOperations, kind: Any) -> None:
        """Arguments enter the frame by ``entry``; sums are of the float type ``kind``."""
        import drjit

        assert kernel.slices is not None
        self.kernel, self.slices, self.entry = kernel, kernel.slices, entry
        self.tables = tables.cut_by(cut_of("sorted", tables))
        on_cpu = drjit.backend_v(kind) == drjit.JitBackend.LLVM
        self.packet = _TOGETHER if on_cpu else 1
        # of two copies, each has a cell of its own
        self.size = self.packet if len(self.slices.views) == 1 else 1
        self.ops = DrjitOperations(kind)

    def __call__(self, arguments: Sequence[Any]) -> tuple[Any, ...]:
        """Results for a chunk of samples; not yet evaluated."""
        begun = self.begun(arguments)
        return self.finished(begun, begun.groups(self.size))

    def begun(self, arguments: Sequence[Any]) -> Begun:
        """A chunk of samples and their cells; waits for whatever is being computed."""
        import drjit

        kernel, frame, ops = self.kernel, self.tables.frame, self.ops
        inner = [ops.float_type(a) for a in kernel.enter(self.entry, frame, *arguments)]
        count = max(map(drjit.width, inner))
        cell = self.slices.cell_index(ops, self.tables, *inner, owner=kernel.name)
        width, rows = ops.packed(inner, count)
        drjit.eval(rows, cell)
        return Begun(np.broadcast_to(cell.numpy(), count), rows, width, len(inner))

    def finished(self, begun: Begun, groups: Groups) -> tuple[Any, ...]:
        """The results of a chunk; not yet evaluated."""
        import drjit

        kernel, ops = self.kernel, self.ops
        cells, where = self._samples(groups)
        traced = partial(self._summed, begun.width, begun.arguments)
        summed: Callable[..., tuple[Any, ...]] = traced
        if self.size > 1 and not is_recording(ops.float_type):
            memory = partial(arrays_of, ops, self.tables, MIRRORED, kernel.name)
            # the lists too: they may be made anew, and a recording is of those it was made with
            lists = cell_lists(self.tables, MIRRORED.point)
            owners = (kernel, self.tables, lists)
            summed = frozen(lambda: (traced, memory()), owners, ops.float_type, "by cell")
        found = summed(begun.rows, cells, *where)
        drjit.eval(found)
        results = tuple(drjit.empty(ops.float_type, len(begun.cell)) for _ in found)
        for result, values in zip(results, found, strict=True):
            for k, one in enumerate(where):
                drjit.scatter(result, values[k] if self.size > 1 else values, one)
        return results

    def _summed(
        self, width: int, count: int, rows: Any, cells: Any, *where: Any
    ) -> tuple[Any, ...]:
        """Results for groups of samples, whose ``count`` arguments are in rows of a table."""
        ops, frame = self.ops, self.tables.frame
        columns = zip(*(ops.gather((width, rows), one) for one in where), strict=True)
        kind = packet_type(ops.float_type) if self.size > 1 else ops.float_type
        inner = [kind(*column) for column in columns][:count]
        known = [cells] if self.size > 1 else None
        # lists of its own: while Dr.Jit records, it puts other arrays in their place
        sums = self.slices.in_cells(ops, self.tables, known, self.kernel.name, *inner)
        return self.kernel.leave(ops, frame, inner, sums)

    def _samples(self, groups: Groups) -> tuple[Any, list[Any]]:
        """The cell of each group, and its samples; a cell's last one again where it has no more."""
        import drjit

        number = drjit.uint32_array_t(self.ops.float_type)
        cells, order, first, last = (
            array_of(number, values)
            for values in (groups.cells, groups.order, groups.first, groups.last)
        )
        # modulo 2^32, where the first of a cell may lie before 0
        place = drjit.gather(number, first, cells) + self.size * drjit.arange(number, len(cells))
        end = drjit.gather(number, last, cells)
        where = [
            drjit.gather(number, order, drjit.minimum(place + k, end)) for k in range(self.size)
        ]
        drjit.eval(where)
        return cells, where


def traced_by_cell(
    kernel: Kernel, tables: Any, float_type: Any, components: Sequence[Any]
) -> tuple[Any, ...]:
    """Results of a kernel for Dr.Jit arrays that :func:`sorts` has accepted; evaluated."""
    import drjit

    run = ByCell(kernel, tables, DrjitOperations(float_type), float_type)
    number = drjit.uint32_array_t(float_type)
    width = max(drjit.width(component) for component in components)
    drjit.eval(components)
    results: tuple[Any, ...] = ()
    if width <= _CHUNK:
        results = run(components)
        # Dr.Jit ends the process when several threads have arrays yet to be scattered into
        drjit.eval(results)
        return results

    def begun(start: int) -> tuple[Any, Begun]:
        first = drjit.opaque(number, start)  # else there would be a kernel for each chunk
        where = first + drjit.arange(number, min(_CHUNK, width - start))
        chunk = [
            drjit.gather(float_type, c, where) if drjit.width(c) == width else c for c in components
        ]
        return where, run.begun(chunk)

    last = begun(0)
    for start in range(_CHUNK, width + _CHUNK, _CHUNK):
        where, chunk = last
        # Sorted by one thread while others compute what was launched before;
        groups = chunk.groups(run.size)
        if start < width:
            last = begun(start)  # which waits for that.
        found = run.finished(chunk, groups)
        results = results or tuple(drjit.empty(float_type, width) for _ in found)
        for result, values in zip(results, found, strict=True):
            drjit.scatter(result, values, where)
        drjit.eval(results)
    return results
