"""Weighted sums of a kernel over many places for each of many points, without storing the terms.

The sum over all pairs of a place and a point is one loop of a compiled kernel: what is read are the
places, the same for all points, and what is written is one number for each point. NumPy computes
the terms block by block.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.choice import resolved
from polywigner.execution.chunks import array_of
from polywigner.execution.evaluation import evaluate
from polywigner.execution.on_drjit import OnDrjit
from polywigner.kernels import Kernel

Array = npt.NDArray[np.float64]

# Pairs of a place and a point at a time, where terms are stored: 32 MiB in float64.
_BLOCK = 1 << 22
# Points at a time in a compiled loop; fewer points are taken several times over, each time with
# another part of the places, so that all cores have work.
_MOST_LANES, _LEAST_LANES = 1 << 18, 1 << 15
# Pairs in one launch, which Ctrl-C cannot interrupt: half a second on two cores. Of a place with
# all edges, so many edges take as long as one part of a slice does.
_MOST_PAIRS, _EDGES_OF_A_PAIR = 1 << 26, 8


def evaluate_sums(
    kernel: Kernel,
    source: Any,
    places: Array,
    weights: Array,
    points: Array,
    constants: Sequence[float],
    *,
    double: bool,
    engine: str,
) -> Array:
    """sum_j weights_j kernel(*places_j, *point, *constants) at each point, float64 (n,).

    places (m, a), weights (m,), points (n, b); the kernel takes a + b + len(constants) components
    and has one real output.
    """
    if not len(points) or not len(places):
        return np.zeros(len(points))
    if resolved(engine, len(places) * len(points)) == "numpy":
        return _by_blocks(kernel, source, places, weights, points, constants, double)
    tables = kernel.tables(source, double)
    run = OnDrjit(kernel, tables, double, resolved(engine, len(places) * len(points)))
    total = np.zeros(len(points))
    is_by_parts = places.shape[1] > 2
    edges = 1 if is_by_parts else len(getattr(tables, "edges", ())) // _EDGES_OF_A_PAIR + 1
    step = max(1, _MOST_PAIRS // edges // min(len(points), _MOST_LANES))
    for low in range(0, len(points), _MOST_LANES):
        columns = slice(low, low + _MOST_LANES)
        for start in range(0, len(places), step):
            some = slice(start, start + step)
            total[columns] += _looped(run, places[some], weights[some], points[columns], constants)
    return total


def _by_blocks(
    kernel: Kernel,
    source: Any,
    places: Array,
    weights: Array,
    points: Array,
    constants: Sequence[float],
    double: bool,
) -> Array:
    total = np.zeros(len(points))
    fixed = [np.array(value) for value in constants]
    for some, columns in _blocks(len(places), len(points)):
        components = [*places[some].T, *points[columns].T[:, :, None], *fixed]
        (values,) = evaluate(kernel, source, components, double=double, engine="numpy", outputs=1)
        total[columns] += values @ weights[some]
    return total


def _blocks(places: int, points: int) -> Iterator[tuple[slice, slice]]:
    step = min(places, _BLOCK)
    width = max(1, _BLOCK // step)
    for start in range(0, places, step):
        for low in range(0, points, width):
            yield slice(start, start + step), slice(low, low + width)


def _looped(
    run: OnDrjit, places: Array, weights: Array, points: Array, constants: Sequence[float]
) -> Array:
    """One loop over places for each lane: a point, and one of several parts of the places."""
    import drjit as dr

    real = run.entry.float_type
    number = dr.uint32_array_t(real)
    parts = min(-(-_LEAST_LANES // len(points)), len(places))
    length = -(-len(places) // parts)
    rows = np.zeros((parts * length, places.shape[1] + 1))
    rows[: len(places)] = np.column_stack([places, weights])
    rows[len(places) :, :-1] = places[0]
    columns = [array_of(real, column) for column in rows.T]
    # Neighbouring lanes are points with the same place.
    point = [array_of(real, np.tile(column, parts)) for column in points.T]
    start = array_of(number, np.repeat(np.arange(parts, dtype=np.uint32) * length, len(points)))
    # Opaque, or each wavelength and each rule would have a kernel of its own.
    fixed = [dr.opaque(real, value) for value in constants]
    last = start + dr.opaque(number, length)

    def step(row: Any, sum_: Any) -> tuple[Any, Any]:
        *place, weight = (dr.gather(real, column, row) for column in columns)
        (value,) = run.traced(*place, *point, *fixed)
        return row + 1, dr.fma(real(value), weight, sum_)

    _, total = dr.while_loop(
        (number(start), dr.zeros(real, len(start))), lambda row, _: row < last, step
    )
    dr.eval(total)
    result: Array = np.asarray(total.numpy()).reshape(parts, len(points)).sum(axis=0)
    return result
