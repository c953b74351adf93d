"""The transforms of rectangles whose fields are products, as kernels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from polywigner.kernels.functions import plane, separable
from polywigner.kernels.functions.separable import enter_frequency, separable_tables
from polywigner.kernels.kernel import Kernel, at_zero_frequency, leave_wave

__all__ = [
    "AMBIGUITY",
    "AUTOCORRELATION",
    "FOURIER",
    "LAG_MARGINAL",
    "POSITION_MARGINAL",
    "WIGNER",
]


def _both_ends(ops: Any, tables: Any, turns: Any, px: Any, py: Any, mx: Any, my: Any) -> Any:
    ahead = separable.field(ops, tables, px, py)
    return (*ahead, *separable.field(ops, tables, mx, my))


WIGNER = replace(
    plane.WIGNER,
    name="wigner of a product",
    tables=separable_tables,
    edge_sum=lambda ops, tables, *inner: (separable.wigner(ops, tables, *inner),),
)
AMBIGUITY = replace(
    plane.AMBIGUITY,
    name="ambiguity of a product",
    tables=separable_tables,
    edge_sum=lambda ops, tables, turns, *inner: separable.ambiguity(ops, tables, *inner),
)
FOURIER = Kernel(
    "fourier of a product",
    2,
    separable_tables,
    enter_frequency,
    lambda ops, tables, turns, *nu: separable.fourier(ops, tables, *nu),
    leave_wave,
)
AUTOCORRELATION = replace(
    plane.AUTOCORRELATION,
    name="autocorrelation of a product",
    tables=separable_tables,
    edge_sum=_both_ends,
)
POSITION_MARGINAL = at_zero_frequency(WIGNER, "position marginal of a product", leads=False)
LAG_MARGINAL = at_zero_frequency(AMBIGUITY, "lag marginal of a product", leads=True)
