"""A call on NumPy arrays as a request of `polywigner.plans`: everything that is counted of it."""

from __future__ import annotations

from typing import Any

from polywigner.execution.on_drjit_data import is_uniform, takes_data
from polywigner.execution.pairs import Pairs
from polywigner.kernels import Kernel
from polywigner.kernels.arrays.repeated import ElementSum, RepeatedTables
from polywigner.kernels.cut.slice_sums import SliceSum
from polywigner.kernels.outline.tables import Tables
from polywigner.plans import Outline, Request

__all__ = ["request_for"]


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
