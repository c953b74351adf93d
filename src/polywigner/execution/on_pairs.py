"""A kernel that sums over the boundary of slices, on NumPy arrays: compiled once for all outlines.

All that is told of an outline, its frame as well, is memory of the engine. Samples are taken in the
order of their cells, so that lanes of a vector run through the same lists.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.aligned import aligned, array_of
from polywigner.execution.choice import drjit_float
from polywigner.execution.chunks import Fetch, Launched, parts_of_results
from polywigner.execution.frozen import frozen
from polywigner.execution.operations import DrjitOperations
from polywigner.kernels import Kernel
from polywigner.kernels.outline.frame import Frame
from polywigner.kernels.outline.pair_grid import PairGrid

__all__ = ["OnPairs"]

_CHUNK = 1 << 17
# Of fewer samples, or edges, to sort them takes longer than it saves (benchmarks/slice_cost.py).
_LEAST_SAMPLES_SORTED, _LEAST_EDGES_SORTED = 1 << 13, 5
# Dr.Jit records a function anew where arrays of different sizes have come to be of one size, or the
# other way round. Sizes are multiples of the first number here, plus a different one of the second.
_SIZES, _APART = 256, 8
# Arguments of a sample, and numbers of a frame, read at once.
_WIDTH, _FRAME = 4, 12

Array = npt.NDArray[Any]
Values = tuple[Any, ...]


class OnPairs:
    """A kernel of a source."""

    def __init__(self, kernel: Kernel, tables: Any, double: bool, engine: str) -> None:
        self.tables = tables
        self.ops = DrjitOperations(drjit_float(engine, double))
        self.entry = DrjitOperations(drjit_float(engine, double=True))
        self.traced = _Traced(
            kernel, kernel.edge_sum, self.ops, self.entry, tables.frame.axes != (0, 1)
        )
        self.sorts = engine == "llvm" and len(tables.edges) >= _LEAST_EDGES_SORTED

    def points(self, components: Sequence[Array], results: Sequence[Array]) -> Launched:
        """Results for components that broadcast to their shape, chunk by chunk."""
        samples = results[0].size
        key = self.tables.across(samples), self.ops.key, "data"
        held = self.tables.kept(key, lambda: self._sent(self.tables.grid(samples)))
        for arguments, targets in parts_of_results(components, results, _CHUNK):
            yield targets, *self._begun(held, arguments)

    def _begun(self, held: Sequence[Any], arguments: Sequence[Array]) -> tuple[Any, Fetch]:
        """Begins to compute the results of a chunk; waits for them when they are fetched."""
        import drjit

        count, traced = len(arguments[0]), self.traced
        rows = aligned(_WIDTH * count, np.float64)
        for column, argument in enumerate(arguments):
            rows.reshape(count, _WIDTH)[:, column] = argument
        number = drjit.uint32_array_t(self.ops.float_type)
        memory, where = self.entry.float_type(rows), number(_counted(count))
        order: Any = ...
        if self.sorts and count >= _LEAST_SAMPLES_SORTED:
            cells = traced.recorded("cells")(*held[:2], memory, where)
            # there are fewer than 2^16 cells: NumPy sorts such numbers in linear time
            order = np.argsort(cells.numpy().astype(np.uint16), kind="stable")
            where = array_of(number, order)
        found = traced.recorded("sums")(*held, memory, where)
        drjit.eval(found)
        return order, lambda: tuple(np.asarray(value.numpy()) for value in found)

    def _sent(self, grid: PairGrid) -> list[Any]:
        """The frame and the lists in the engine's memory."""
        frame, found = self.tables.frame, []
        matrices = np.ravel([frame.matrix, frame.inverse_transpose])
        numbers = np.array([*frame.centre, *matrices, frame.norm, frame.content])
        tables = [getattr(grid, part.name) for part in fields(grid)]
        for number, table in enumerate([numbers, *tables]):
            width = -(-table.size // _SIZES) * _SIZES + _APART * (number + 1)
            padded = np.zeros(width, table.dtype)
            padded[: table.size] = table.ravel()
            ops = self.entry if number == 0 else self.ops
            found.append(ops.held(padded[:, None])[1])
        return found


@dataclass(frozen=True)
class _Traced:
    """The functions that are compiled; they know nothing of an outline."""

    kernel: Kernel
    sum: Any
    """The kernel's sum over the boundary, which knows the offsets and their cells."""
    ops: DrjitOperations
    entry: DrjitOperations
    is_turned: bool
    """Whether axes of the frame are turned against the user's."""

    def recorded(self, name: str) -> Any:
        """One of the functions, as recorded by an earlier call if there was one."""
        function = getattr(self, name)
        key = self.ops.float_type, name, self.is_turned
        return frozen(lambda: (function, ()), (self.kernel,), *key)

    def cells(self, frame: Any, numbers: Any, rows: Any, where: Any) -> Any:
        """The cells of samples."""
        pair = PairGrid((8, numbers), *(None,) * 6)
        _, offset, _ = self._entered(frame, pair, rows, where)
        return self.sum.cells(self.ops, pair, offset)

    def sums(self, frame: Any, *arrays: Any) -> Values:
        """The kernel's results for samples."""
        *tables, rows, where = arrays
        pair = PairGrid(*((8 if k < 2 else 4, table) for k, table in enumerate(tables)))
        inner, offset, rest = self._entered(frame, pair, rows, where)
        sums = self.sum.on_grid(self.ops, pair, offset, *rest)
        return self.kernel.leave(self.ops, self._frame(self.ops, frame), inner, sums)

    def _entered(
        self, frame: Any, pair: PairGrid, rows: Any, where: Any
    ) -> tuple[Values, Values, Values]:
        """The arguments in the frame, the offset on the grid, and the integrand's arguments."""
        arguments = self.entry.gather((_WIDTH, rows), where)[: self.sum.arguments]
        inner = self.kernel.enter(self.entry, self._frame(self.entry, frame), *arguments)
        inner = tuple(self.ops.float_type(a) for a in inner)
        offset, rest = self.sum.split(*inner)
        return inner, self.sum.snapped(self.ops, pair, *offset), rest

    def _frame(self, ops: DrjitOperations, numbers: Any) -> Frame:
        """The frame, with numbers that are memory."""
        found = self.entry.gather((_FRAME, numbers), self.entry.truncated(0.0))
        cx, cy, xx, xy, yx, yy, ax, ay, bx, by, norm, content = found
        if not self.is_turned:
            xy = yx = ay = bx = 0.0
        matrices = ((xx, xy), (yx, yy)), ((ax, ay), (bx, by))
        return Frame((cx, cy), *matrices, norm, ops.float_type(content), (0.0, 0.0))


@lru_cache(maxsize=8)
def _counted(count: int) -> Array:
    """0, 1, ... in aligned memory."""
    found = aligned(count, np.uint32)
    found[:] = np.arange(count)
    return found
