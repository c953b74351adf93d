"""Samples in the order of the cells in which their edges are looked up.

Lanes of a vector that run through the same lists take the same steps, and read the same rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.engines.aligned import aligned
from polywigner.engines.operations import DrjitOperations
from polywigner.kernels import Kernel

__all__ = ["CHUNK", "order_of", "sorts", "traced_by_cell"]

# Samples at a time: enough for some in each of the many cells.
CHUNK = 1 << 20
# Of arrays of the engine fewer, which stay in the cache of a core while they are shuffled.
_TRACED_CHUNK = 1 << 18
# With fewer, to sort them takes longer than it saves.
_FEW = 1 << 13


def order_of(cell: npt.NDArray[Any]) -> npt.NDArray[np.intp]:
    """The indices that bring the numbers of cells into their order."""
    # NumPy sorts numbers of 16 bits in linear time.
    small = cell.max(initial=0) < 1 << 16
    return np.argsort(cell.astype(np.uint16) if small else cell, kind="stable")


def sorts(kernel: Kernel, tables: Any, float_type: Any, components: Sequence[Any]) -> bool:
    """Whether Dr.Jit arrays are worth evaluating and sorting.

    Not where derivatives are taken, nor within a function that is being recorded.
    """
    import drjit

    if kernel.order is None or drjit.backend_v(float_type) != drjit.JitBackend.LLVM:
        return False  # on a GPU the numbers of the cells would have to come over
    if not _operations(float_type).prefers_cells(tables.clips_for_cells, None):
        return False
    recording = drjit.flag(drjit.JitFlag.SymbolicScope) or drjit.flag(drjit.JitFlag.FreezingScope)
    widths = {drjit.width(component) for component in components}
    whole = max(widths) >= _FEW and widths <= {1, max(widths)}
    return whole and not recording and not any(map(drjit.grad_enabled, components))


def traced_by_cell(
    kernel: Kernel, tables: Any, float_type: Any, components: Sequence[Any]
) -> tuple[Any, ...]:
    """Results of a kernel for Dr.Jit arrays that :func:`sorts` has accepted; evaluated."""
    import drjit

    ops = _operations(float_type)
    number = drjit.uint32_array_t(float_type)
    width = max(drjit.width(component) for component in components)
    drjit.eval(components)

    def taken(where: Any) -> list[Any]:
        return [
            drjit.gather(float_type, c, where) if drjit.width(c) == width else c for c in components
        ]

    results: tuple[Any, ...] = ()
    for start in range(0, width, _TRACED_CHUNK):
        first = drjit.opaque(number, start)  # else there would be a kernel for each chunk
        count = min(_TRACED_CHUNK, width - start)
        where = first + drjit.arange(number, count)
        inner = kernel.enter(ops, tables.frame, *taken(where))
        cell = kernel.order(ops, tables, *inner) if kernel.order else first
        if drjit.width(cell) > 1:  # else it is one place for all frequencies
            order = aligned(count, np.uint32)
            order[...] = order_of(cell.numpy())
            where = first + number(order)
        values = kernel(ops, tables, *taken(where))
        results = results or tuple(drjit.empty(float_type, width) for _ in values)
        for result, value in zip(results, values, strict=True):
            drjit.scatter(result, value, where, mode=drjit.ReduceMode.Permute)
        drjit.eval(results)
    return results


def _operations(float_type: Any) -> DrjitOperations:
    return DrjitOperations(float_type, sorted_by_cell=True)
