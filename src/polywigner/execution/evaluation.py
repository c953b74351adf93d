"""Kernels on NumPy arrays: broadcast, cut into chunks, computed by NumPy or Dr.Jit.

Memory is bounded by the result plus one chunk: broadcast arguments are never expanded as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.by_cell import order_of
from polywigner.execution.choice import planned
from polywigner.execution.grids import GridPlan, plan_for_grid
from polywigner.execution.ledger import account_of
from polywigner.execution.on_drjit import OnDrjit
from polywigner.execution.on_numpy import CHUNK, OnNumpy
from polywigner.execution.operations import NumpyOperations
from polywigner.execution.pairs import Pairs, one_row_of, pairs_of
from polywigner.execution.requests import request_for
from polywigner.kernels import Kernel, SharedSlice
from polywigner.kernels.outline.tables import Tables, cut_of
from polywigner.plans import Plan, Request
from polywigner.plans.plan import GRID, LISTED, LISTED_COMPILED, POINTS_LISTED

__all__ = ["evaluate", "explained"]

# Samples at a time. Dr.Jit: launching costs little against computing, and the arguments of a chunk
# take some 10 MB.
_DRJIT_CHUNK = 1 << 18

# NumPy: of fewer samples it is not worth finding those for which there is nothing to do.
_LEAST_APART = 256

# Parts of slices in memory at a time.
_MOST_PARTS = 1 << 18

Array = npt.NDArray[Any]


def evaluate(
    kernel: Kernel,
    source: Any,
    components: Sequence[Array],
    *,
    double: bool,
    engine: str,
    outputs: int,
    into: Sequence[Array] | None = None,
) -> tuple[Array, ...]:
    """Results of a kernel for float64 or float32 components that broadcast to one shape.

    Arguments enter the frame in float64 whatever the precision of the sums. ``into``: arrays of
    that shape and precision for the results, such as both parts of a complex one.
    """
    shape = np.broadcast_shapes(*(c.shape for c in components))
    dtype = np.float64 if double else np.float32
    results = tuple(into or (np.empty(shape, dtype) for _ in range(outputs)))
    if 0 in shape:
        return results
    call = _call_of(kernel, source, components, double, engine)
    chosen = planned(call.request)
    if chosen.way.name == GRID:
        assert call.grid is not None
        call.grid.fill(results, _by_points(kernel, call.tables, components[:-2], double))
    else:
        _store(_launched(call, chosen, results))
    account_of(kernel.name, call.tables).book(chosen)
    return results


def explained(
    kernel: Kernel, source: Any, components: Sequence[Array], *, double: bool, engine: str
) -> Plan:
    """The plan by which :func:`evaluate` would carry a call out now; nothing is computed."""
    return planned(_call_of(kernel, source, components, double, engine).request)


@dataclass(frozen=True)
class _Call:
    """What is to be computed."""

    kernel: Kernel
    source: Any
    tables: Any
    components: Sequence[Array]
    double: bool
    pairs: Pairs | None
    """The arguments as rows and columns, where they are such."""
    by_places: Pairs | None
    """The same with each place a row, where slices are those of places."""
    grid: GridPlan | None
    request: Request


def _call_of(
    kernel: Kernel, source: Any, components: Sequence[Array], double: bool, engine: str
) -> _Call:
    shape = np.broadcast_shapes(*(c.shape for c in components))
    tables = kernel.tables(source, double)
    grid = None
    if engine in ("auto", "numpy") and components[-1].shape == shape:
        grid = plan_for_grid(kernel, source, components, double)
    pairs, shared = _pairs_of(kernel, components, shape), _listed_by(kernel)
    by_places = None
    if shared is not None and pairs is not None:
        by_places = _with_places_as_rows(pairs, shared.arguments)
    request = request_for(
        kernel,
        tables,
        math.prod(shape),
        double=double,
        engine=engine,
        pairs=by_places,
        families=None if grid is None else grid.families,
        account=account_of(kernel.name, tables),
    )
    return _Call(kernel, source, tables, components, double, pairs, by_places, grid, request)


def _listed_by(kernel: Kernel) -> SharedSlice | None:
    """How the parts of a kernel's slices are listed; None where they are not."""
    return None if kernel.slices is None else kernel.slices.listed


def _pairs_of(kernel: Kernel, components: Sequence[Array], shape: tuple[int, ...]) -> Pairs | None:
    """The arguments as rows and columns; None where they are points."""
    pairs, shared = pairs_of(components, shape), _listed_by(kernel)
    if pairs is None and shared and all(c.size == 1 for c in components[shared.arguments]):
        return one_row_of(components, shape)
    return pairs


def _launched(call: _Call, chosen: Plan, results: Sequence[Array]) -> Launched:
    """The chunks of a call, by the way that was chosen."""
    tables, name = call.tables, chosen.way.name
    if isinstance(tables, Tables):
        tables = tables.cut_by(chosen.way.cut)
    compute: OnNumpy | OnDrjit
    if chosen.engine == "numpy":
        compute, chunk = OnNumpy(call.kernel, tables, call.double), CHUNK
    else:
        compute, chunk = OnDrjit(call.kernel, tables, call.double, chosen.engine), _DRJIT_CHUNK
    shared = _listed_by(call.kernel)
    if name in (LISTED, LISTED_COMPILED):
        assert shared is not None and call.pairs is not None and call.by_places is not None
        targets = _targets(call.pairs, call.by_places, results)
        return _by_parts(compute, shared, call.source, call.by_places, targets)
    if name == POINTS_LISTED:
        assert shared is not None and isinstance(compute, OnNumpy)
        return _listed(compute, shared, call.source, call.components, results)
    # one place is short enough to be sent with each sample
    pairs = None if isinstance(compute, OnDrjit) and _is_one_row(call.pairs) else call.pairs
    if pairs is not None and compute.takes(pairs):
        return _paired(compute, pairs, results)
    return _chunked(compute, call.components, results, chunk)


def _by_points(kernel: Kernel, tables: Any, place: Sequence[Array], double: bool) -> Any:
    """The kernel at one place, if it has any, for some frequencies."""
    compute = OnNumpy(kernel, tables, double)

    def values(nu: Sequence[Array]) -> Sequence[Array]:
        return compute.values([*(np.full(len(nu[0]), c.item()) for c in place), *nu])

    return values


Launched = Iterator[tuple[Sequence[Array], Any, Callable[[], Sequence[Array]]]]
"""(results, where in them, how to fetch them); there the work has begun already."""


def _store(launched: Launched) -> None:
    """Fetch each chunk while the next one is computed."""
    last: Any = None
    for chunk in launched:
        if last is not None:
            _write(*last)
        last = chunk
    if last is not None:
        _write(*last)


def _write(results: Sequence[Array], where: Any, fetch: Callable[[], Sequence[Array]]) -> None:
    for result, values in zip(results, fetch(), strict=True):
        result[where] = values


def _paired(compute: OnNumpy | OnDrjit, pairs: Pairs, results: Sequence[Array]) -> Launched:
    tables = [result.reshape(pairs.rows, pairs.columns) for result in results]
    for block in pairs.blocks(compute.block):
        yield tables, block, compute.of_pairs(pairs.block(*block))


def _is_one_row(pairs: Pairs | None) -> bool:
    return pairs is not None and pairs.rows == 1


def _with_places_as_rows(pairs: Pairs, places: slice) -> Pairs | None:
    """The pairs with each place a row; None where places change along both."""
    if all(c.shape == (1, pairs.columns) for c in pairs.components[places]):
        pairs = pairs.transposed()
    return None if any(c.shape[1] > 1 for c in pairs.components[places]) else pairs


def _targets(pairs: Pairs, by_places: Pairs, results: Sequence[Array]) -> list[Array]:
    """The results in the shape of the pairs with each place a row."""
    tables = [result.reshape(pairs.rows, pairs.columns) for result in results]
    return tables if by_places is pairs else [table.T for table in tables]


def _by_parts(
    compute: OnNumpy | OnDrjit,
    shared: SharedSlice,
    source: Any,
    pairs: Pairs,
    targets: Sequence[Array],
) -> Launched:
    exact = compute.kernel.tables(source, True)
    host = NumpyOperations(double=True)
    # of one row, nothing is gained by longer blocks, which take memory
    size = compute.shared_block if pairs.rows > 1 else _DRJIT_CHUNK
    for block in pairs.blocks(size):
        inner = compute.entered(pairs.block(*block))
        count = len(range(*block[0].indices(pairs.rows)))
        place = (np.broadcast_to(np.ravel(p), count) for p in inner[shared.place])
        (owners, table), is_real = shared.parts(host, exact, *place)
        ends = np.searchsorted(owners, np.arange(count + 1))
        yield targets, block, compute.of_parts(shared, inner, ends, table, is_real)


def _listed(
    compute: OnNumpy,
    shared: SharedSlice,
    source: Any,
    components: Sequence[Array],
    results: Sequence[Array],
) -> Launched:
    """NumPy: every slice's parts are listed, and summed at the slice's own frequency."""
    exact = compute.kernel.tables(source, True)
    flat = [result.reshape(-1) for result in results]
    size = max(1, min(CHUNK, _MOST_PARTS // len(exact.edges)))
    start = 0
    for arguments in _chunks(components, results[0].shape, size):
        count = len(arguments[0])
        targets = [result[start : start + count] for result in flat]
        yield targets, ..., compute.listed(shared, exact, arguments)
        start += count


def _order(compute: OnNumpy, arguments: Sequence[Array], count: int) -> Any:
    """The order in which to take the samples: all, or by the cell in which each has its edges.

    Without those that lie too far off to have a value other than 0.
    """
    slices, tables = compute.kernel.slices, compute.tables
    if slices is None:
        return ...
    by_cells = cut_of("numpy", tables, count).endswith("cells")
    if not by_cells and count < _LEAST_APART:
        return ...
    inner = compute.entered(arguments)
    if by_cells:
        return order_of(slices.cell_index(compute.host, tables, *inner))
    with np.errstate(invalid="ignore", over="ignore"):
        mask = slices.support_mask(tables, *inner)
    for argument in inner:  # 0 times what is not finite is not 0
        mask |= ~np.isfinite(argument)
    (order,) = np.nonzero(mask)
    return ... if len(order) == len(mask) else order


def _chunked(
    compute: OnNumpy | OnDrjit,
    components: Sequence[Array],
    results: Sequence[Array],
    size: int,
) -> Launched:
    flat = [result.reshape(-1) for result in results]
    start = 0
    one_frequency = _is_one_frequency(compute, components)
    for arguments in _chunks(components, results[0].shape, size):
        if one_frequency is not None:  # one number in all: so is what depends on it alone
            arguments[one_frequency] = [f[:1] for f in arguments[one_frequency]]
        count = max(map(len, arguments))
        order = _order(compute, arguments, count) if isinstance(compute, OnNumpy) else ...
        targets = [result[start : start + count] for result in flat]
        if order is not ... and len(order) < count:
            for target in targets:
                target[:] = 0.0
        if order is ... or len(order):
            some = [a if len(a) < count else a[order] for a in arguments]
            yield targets, order, compute(some)
        start += count


def _is_one_frequency(compute: OnNumpy | OnDrjit, components: Sequence[Array]) -> slice | None:
    """Where components are a frequency that NumPy need not repeat for each place; None if none."""
    shared = _listed_by(compute.kernel)
    if shared is None or not isinstance(compute, OnNumpy):
        return None
    if cut_of("numpy", compute.tables, CHUNK).endswith("cells"):
        return None
    half = len(components) // 2
    frequency = slice(half, None) if shared.arguments.start == 0 else slice(0, half)
    return frequency if all(c.size == 1 for c in components[frequency]) else None


def _chunks(
    components: Sequence[Array], shape: tuple[int, ...], size: int
) -> Iterator[list[Array]]:
    """The components in float64, broadcast to a shape, chunk by chunk in C order."""
    whole = [c if c.shape == shape else np.broadcast_to(c, shape) for c in components]
    arguments: list[Any]
    if 0 < whole[0].size <= size:
        yield [c.astype(np.float64, copy=False).reshape(-1) for c in whole]
        return
    with np.nditer(
        whole,
        flags=["external_loop", "buffered", "zerosize_ok"],
        op_flags=[["readonly"]] * len(whole),
        op_dtypes=[np.dtype(np.float64)] * len(whole),
        order="C",
        buffersize=size,
    ) as iterator:
        for chunk in iterator:
            # of one operand nditer gives the array itself
            arguments = list(chunk) if len(whole) > 1 else [chunk]
            if arguments[0].size:
                yield arguments
