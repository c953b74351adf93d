"""What a call on NumPy arrays asks for: places and frequencies, and everything that is counted."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.execution.on_drjit_data import is_uniform, takes_data
from polywigner.kernels import Kernel
from polywigner.kernels.arrays.repeated import ElementSum, RepeatedTables
from polywigner.kernels.cut.slice_sums import SliceSum
from polywigner.kernels.outline.tables import Tables
from polywigner.plans import Outline, Request

# In shorter rows little is shared.
_LEAST_COLUMNS = 64

Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Components of shape (rows, 1) or (1, columns) each."""

    components: tuple[Array, ...]
    rows: int
    columns: int

    def blocks(self, size: int) -> Iterator[tuple[slice, slice]]:
        """Rows and columns of blocks of about ``size`` samples, most of them of one shape."""
        columns = min(self.columns, size)
        rows = max(1, size // columns)
        for r in range(0, self.rows, rows):
            for c in range(0, self.columns, columns):
                yield slice(r, r + rows), slice(c, c + columns)

    def block(self, rows: slice, columns: slice) -> tuple[Array, ...]:
        """The components of a block, in float64."""
        chosen = (
            c[rows] if len(c) > 1 else c[:, columns] if self.columns == c.shape[1] else c
            for c in self.components
        )
        return tuple(c.astype(np.float64, copy=False) for c in chosen)

    def transposed(self) -> Pairs:
        """Rows as columns, and columns as rows."""
        return Pairs(tuple(c.T for c in self.components), self.columns, self.rows)


def one_row_of(components: Sequence[Array], shape: tuple[int, ...]) -> Pairs | None:
    """Components of which some are one number each, in one row; None for a short one."""
    columns = math.prod(shape)
    if columns < _LEAST_COLUMNS:
        return None
    whole = (c if c.size == 1 else np.broadcast_to(c, shape) for c in components)
    return Pairs(tuple(c.reshape(1, -1) for c in whole), 1, columns)


def pairs_of(components: Sequence[Array], shape: tuple[int, ...]) -> Pairs | None:
    """Components that broadcast to ``shape`` as rows and columns; None where they are none."""
    dimensions = len(shape)
    whole = [c.reshape((1,) * (dimensions - c.ndim) + c.shape) for c in components]
    best: tuple[int, int] | None = None
    for k in range(1, dimensions):
        rows, columns = math.prod(shape[:k]), math.prod(shape[k:])
        if rows < 2 or columns < _LEAST_COLUMNS:
            continue
        if all(c.size == math.prod(c.shape[:k]) or c.size == math.prod(c.shape[k:]) for c in whole):
            best = min(best or (rows + columns, k), (rows + columns, k))
    if best is None:
        return None
    k = best[1]

    def flat(component: Array) -> Array:
        if component.size == math.prod(component.shape[k:]):
            return np.broadcast_to(component.reshape(component.shape[k:]), shape[k:]).reshape(1, -1)
        leading = component.reshape(component.shape[:k])
        return np.broadcast_to(leading, shape[:k]).reshape(-1, 1)

    return Pairs(tuple(map(flat, whole)), math.prod(shape[:k]), math.prod(shape[k:]))


def request_for(
    kernel: Kernel,
    tables: Any,
    samples: int,
    *,
    double: bool,
    engine: str,
    pairs: Pairs | None = None,
    families: int | None = None,
) -> Request:
    """What is asked for; ``pairs``: with each place a row."""
    outline, is_array = None, False
    terms = getattr(tables, "terms", 0) or len(tables.edges)
    if kernel.slices is not None:
        outline = _outline_of(kernel, tables)
    elif isinstance(tables, RepeatedTables) and isinstance(tables.element, Tables):
        outline, is_array = _outline_of(kernel, tables.element), True
    return Request(
        kernel.name,
        samples,
        outline,
        terms,
        is_array,
        rows=0 if pairs is None else pairs.rows,
        columns=0 if pairs is None else pairs.columns,
        families=families,
        double=double,
        engine=engine,
        takes_data=takes_data(kernel, tables),
    )


def _outline_of(kernel: Kernel, tables: Tables) -> Outline:
    cut, slices = kernel.edge_sum, kernel.slices
    exact = sum(line.exact for line in tables.lines)
    return Outline(
        max(1, len(tables.edges)),
        max(1, len(tables.pieces)),
        max(1, tables.clips),
        max(1, len(tables.lines)),
        exact / max(1, len(tables.lines)),
        tables.waves_per_cut,
        len(cut.views) if isinstance(cut, (SliceSum, ElementSum)) else 0,
        is_uniform=is_uniform(kernel, tables),
        allows_lists=slices is not None and slices.listed is not None,
        weighs_lags=tables.coherence is not None,
    )
