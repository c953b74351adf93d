"""Kernels on NumPy arrays: broadcast, cut into chunks, computed by NumPy or Dr.Jit.

Memory is bounded by the result plus one chunk: broadcast arguments are never expanded as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import planned
from polywigner.execution.chunks import Launched, store
from polywigner.execution.grids import GridPlan, plan_for_grid
from polywigner.execution.on_drjit import OnDrjit
from polywigner.execution.on_drjit_data import OnDrjitData
from polywigner.execution.on_numpy import OnNumpy
from polywigner.execution.operations import NumpyOperations
from polywigner.execution.requests import Pairs, one_row_of, pairs_of, request_for
from polywigner.kernels import Kernel, SharedSlice
from polywigner.kernels.outline.tables import Tables
from polywigner.plans import Plan, Request
from polywigner.plans.plan import DATA, GRID, LISTED, LISTED_COMPILED

# Samples of one row at a time, of which nothing is gained by longer blocks.
_ROW_BLOCK = 1 << 18

Array = npt.NDArray[Any]
Shear = Callable[[Sequence[Array]], Sequence[Array]]


def evaluate(
    kernel: Kernel,
    source: Any,
    components: Sequence[Array],
    *,
    double: bool,
    engine: str,
    outputs: int,
    into: Sequence[Array] | None = None,
    shear: Shear | None = None,
) -> tuple[Array, ...]:
    """Results of a kernel for float64 or float32 components that broadcast to one shape.

    Arguments enter the frame in float64 whatever the precision of the sums. ``into``: arrays of
    that shape and precision for the results, such as both parts of a complex one. ``shear``: to
    the components that are meant, from those given; where slices are listed, block by block.
    """
    shape = np.broadcast_shapes(*(c.shape for c in components))
    dtype = np.float64 if double else np.float32
    results = tuple(into or (np.empty(shape, dtype) for _ in range(outputs)))
    if 0 in shape:
        return results
    call = _call_of(kernel, source, components, double, engine)
    chosen = planned(call.request)
    if shear is not None:
        if chosen.way.name not in (LISTED, LISTED_COMPILED) or _one_place(call):
            how: Any = {"double": double, "engine": engine, "outputs": outputs, "into": results}
            return evaluate(kernel, source, shear(components), **how)
        call = replace(call, shear=shear)
    if chosen.way.name == GRID:
        assert call.grid is not None
        call.grid.fill(results, OnNumpy(kernel, call.tables, double).values)
    else:
        store(_launched(call, chosen, results))
    return results


def explained(
    kernel: Kernel, source: Any, components: Sequence[Array], *, double: bool, engine: str
) -> Plan:
    """The plan by which :func:`evaluate` would carry a call out; nothing is computed."""
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
    """These pairs with each place a row, where slices are those of places."""
    grid: GridPlan | None
    request: Request
    shear: Shear | None = None


def _one_place(call: _Call) -> bool:
    return call.by_places is None or call.by_places.rows == 1


def _call_of(
    kernel: Kernel, source: Any, components: Sequence[Array], double: bool, engine: str
) -> _Call:
    shape = np.broadcast_shapes(*(c.shape for c in components))
    tables = kernel.tables(source, double)
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
    )
    grid = None
    if engine in ("auto", "numpy") and components[-1].shape == shape:
        grid = plan_for_grid(kernel, source, components, double)
        if grid is not None:
            request = replace(request, families=grid.families)
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
    if name == DATA:
        data = OnDrjitData(
            call.kernel, tables, call.double, chosen.engine, results[0].size, len(results)
        )
        return data.points(call.components, results)
    if isinstance(tables, Tables):
        tables = tables.cut_by(chosen.way.cut)
    compute: OnNumpy | OnDrjit
    if chosen.engine == "numpy":
        compute = OnNumpy(call.kernel, tables, call.double)
    else:
        compute = OnDrjit(call.kernel, tables, call.double, chosen.engine)
    if name in (LISTED, LISTED_COMPILED):
        assert call.pairs is not None and call.by_places is not None
        targets = _targets(call.pairs, call.by_places, results)
        exact = call.kernel.tables(call.source, True)
        return _by_parts(compute, exact, call.by_places, targets, call.shear)
    pairs = call.by_places or call.pairs
    # one place is short enough to be sent with each sample
    is_short = pairs is None or (isinstance(compute, OnDrjit) and pairs.rows == 1)
    if call.pairs and pairs and not is_short:
        return _paired(compute, pairs, _targets(call.pairs, pairs, results))
    return compute.points(call.components, results)


def _paired(compute: OnNumpy | OnDrjit, pairs: Pairs, targets: Sequence[Array]) -> Launched:
    for block in pairs.blocks(compute.block):
        yield targets, block, compute.of_pairs(pairs.block(*block))


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
    exact: Tables,
    pairs: Pairs,
    targets: Sequence[Array],
    shear: Shear | None,
) -> Launched:
    """The slice of each place listed once, from tables in double precision."""
    shared, host = _listed_by(compute.kernel), NumpyOperations(double=True)
    assert shared is not None
    size = compute.shared_block if pairs.rows > 1 else _ROW_BLOCK
    for block in pairs.blocks(size):
        arguments = pairs.block(*block)
        inner = compute.entered(arguments if shear is None else shear(arguments))
        count = len(range(*block[0].indices(pairs.rows)))
        place = (np.broadcast_to(np.ravel(p), count) for p in inner[shared.place])
        (owners, table), is_real = shared.parts(host, exact, *place)
        ends = np.searchsorted(owners, np.arange(count + 1))
        yield targets, block, compute.of_parts(shared, inner, ends, table, is_real)
