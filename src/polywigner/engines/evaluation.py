"""Kernels on NumPy arrays: broadcast, cut into chunks, computed by NumPy or Dr.Jit.

Memory is bounded by the result plus one chunk: broadcast arguments are never expanded as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from polywigner.engines import by_cell
from polywigner.engines.choice import resolved
from polywigner.engines.grids import evaluate_on_grid
from polywigner.engines.on_drjit import OnDrjit
from polywigner.engines.on_numpy import CHUNK, OnNumpy
from polywigner.engines.operations import NumpyOperations
from polywigner.engines.pairs import Pairs, pairs_of
from polywigner.kernels import Kernel, shared_slice

__all__ = ["evaluate"]

# Samples at a time. Dr.Jit: launching costs little against computing, and the arguments of a chunk
# take some 10 MB.
_DRJIT_CHUNK = 1 << 18

Array = npt.NDArray[Any]


def evaluate(
    kernel: Kernel,
    source: Any,
    components: Sequence[Array],
    *,
    double: bool,
    engine: str,
    outputs: int,
) -> tuple[Array, ...]:
    """Results of a kernel for float64 or float32 components that broadcast to one shape.

    Arguments enter the frame in float64 whatever the precision of the sums.
    """
    shape = np.broadcast_shapes(*(c.shape for c in components))
    tables = kernel.tables(source, double)
    if kernel.on_grid:
        components = [c.astype(np.float64, copy=False) for c in components]
        by_points = OnNumpy(kernel, tables, double)
        found = evaluate_on_grid(
            kernel, source, components, by_points, double=double, engine=engine
        )
        if found:
            return found
    dtype = np.float64 if double else np.float32
    results = tuple(np.empty(shape, dtype) for _ in range(outputs))
    # pieces that are cut are code, terms of a plain sum are data
    terms = 1 if kernel.copies else len(tables.edges)
    engine = resolved(engine, int(np.prod(shape)), terms)
    pairs = pairs_of(components, shape)
    compute: OnNumpy | OnDrjit
    if engine == "numpy":
        compute, chunk = OnNumpy(kernel, tables, double), CHUNK
        compute.ops.samples = int(np.prod(shape))
    else:
        compute, chunk = OnDrjit(kernel, tables, double, engine), _DRJIT_CHUNK
        if kernel.order and compute.ops.prefers_cells(tables.clips_for_cells, None):
            chunk = by_cell.CHUNK
    if pairs is not None and _fill_shared(compute, source, pairs, results):
        return results
    if pairs is not None and compute.takes(pairs):
        _fill_pairs(compute, pairs, results)
        return results
    for arguments, targets in _chunks(components, results, chunk):
        order = _order(kernel, tables, compute.ops, arguments)
        values = compute([argument[order] for argument in arguments])
        for target, value in zip(targets, values, strict=True):
            target[order] = value
    return results


def _fill_pairs(compute: OnNumpy | OnDrjit, pairs: Pairs, results: Sequence[Array]) -> None:
    tables = [result.reshape(pairs.rows, pairs.columns) for result in results]
    for rows, columns in pairs.blocks(compute.block):
        values = compute.of_pairs(pairs.block(rows, columns))
        for table, value in zip(tables, values, strict=True):
            table[rows, columns] = value


def _fill_shared(
    compute: OnNumpy | OnDrjit, source: Any, pairs: Pairs, results: Sequence[Array]
) -> bool:
    """Fill in the results from slices cut once for each row or column, if these are few enough."""
    shared = shared_slice(compute.kernel)
    if shared is None:
        return False
    tables = compute.tables
    targets = [result.reshape(pairs.rows, pairs.columns) for result in results]
    if all(c.shape == (1, pairs.columns) for c in pairs.components[shared.arguments]):
        pairs, targets = pairs.transposed(), [target.T for target in targets]
    if any(c.shape[1] > 1 for c in pairs.components[shared.arguments]):
        return False
    if isinstance(compute, OnDrjit) and compute.sums_whole_edges(pairs):
        for rows, columns, values in compute.of_blocks(pairs):
            for target, value in zip(targets, values, strict=True):
                target[rows, columns] = value
        return True
    by_cells = compute.ops.prefers_cells(tables.clips_for_cells, None)
    if by_cells or not compute.shares(pairs.columns):
        return False
    exact = compute.kernel.tables(source, True)
    host = NumpyOperations(double=True)
    for rows, columns in pairs.blocks(compute.shared_block):
        inner = compute.entered(pairs.block(rows, columns))
        count = len(range(*rows.indices(pairs.rows)))
        place = (np.broadcast_to(np.ravel(p), count) for p in inner[shared.place])
        (owners, table), is_real = shared.parts(host, exact, *place)
        ends = np.searchsorted(owners, np.arange(count + 1))
        values = compute.of_parts(shared, inner, ends, table, is_real)
        for target, value in zip(targets, values, strict=True):
            target[rows, columns] = value
    return True


def _order(kernel: Kernel, tables: Any, ops: Any, arguments: Sequence[Array]) -> Any:
    """The order in which to take the samples: all, or by the cell in which each has its edges."""
    if kernel.order is None or not ops.prefers_cells(tables.clips_for_cells, arguments[0]):
        return ...
    host = NumpyOperations(double=True)
    with np.errstate(invalid="ignore", over="ignore"):
        inner = kernel.enter(host, tables.frame, *arguments)
        cell = kernel.order(host, tables, *inner)
        return by_cell.order_of(cell)


def _chunks(
    components: Sequence[Array], results: Sequence[Array], size: int
) -> Iterator[tuple[Sequence[Array], Sequence[Array]]]:
    count = len(components)
    read: list[list[Literal["readonly"]]] = [["readonly"]] * count
    write: list[list[Literal["writeonly"]]] = [["writeonly"]] * len(results)
    with np.nditer(
        [*components, *results],
        flags=["external_loop", "buffered", "zerosize_ok"],
        op_flags=[*read, *write],
        op_dtypes=[np.dtype(np.float64)] * count + [result.dtype for result in results],
        order="C",
        buffersize=size,
    ) as iterator:
        for chunk in iterator:
            if chunk[0].size:
                yield chunk[:count], chunk[count:]
