"""The transforms of slits as kernels."""

from __future__ import annotations

from dataclasses import replace

from polywigner.kernels import slits
from polywigner.kernels.kernel import (
    Kernel,
    leave_parts,
    leave_real,
    leave_wave,
)
from polywigner.kernels.membership import field_in_slits
from polywigner.kernels.plane import enter_frequency, product_of_both
from polywigner.kernels.slits import slit_tables

__all__ = [
    "AMBIGUITY",
    "AUTOCORRELATION",
    "LAG_MARGINAL",
    "LAG_MARGINAL_OF_FIELDS",
    "POSITION_MARGINAL",
    "WIGNER",
]


AUTOCORRELATION = Kernel(
    "autocorrelation of slits",
    1,
    slit_tables,
    lambda ops, frame, x, xi: (
        *frame.position(ops, x + 0.5 * xi),
        *frame.position(ops, x - 0.5 * xi),
    ),
    lambda ops, tables, ahead, behind: (
        *field_in_slits(ops, tables, ahead),
        *field_in_slits(ops, tables, behind),
    ),
    product_of_both,
)
WIGNER = Kernel(
    "wigner of slits",
    1,
    slit_tables,
    lambda ops, frame, x, nu: (*frame.position(ops, x), *frame.frequency(ops, nu)),
    lambda ops, tables, *inner: (slits.wigner(ops, tables, *inner),),
    leave_real,
)
AMBIGUITY = Kernel(
    "ambiguity of slits",
    1,
    slit_tables,
    lambda ops, frame, upsilon, xi: (
        *enter_frequency(ops, frame, upsilon),
        *frame.vector(ops, xi),
    ),
    lambda ops, tables, turns, *inner: slits.ambiguity(ops, tables, *inner),
    leave_wave,
)
POSITION_MARGINAL = Kernel(
    "position marginal of slits",
    1,
    slit_tables,
    lambda ops, frame, x: frame.position(ops, x),
    lambda ops, tables, x: (slits.lag_slice_length(ops, tables, x),),
    leave_real,
)
LAG_MARGINAL = Kernel(
    "lag marginal of slits",
    1,
    slit_tables,
    lambda ops, frame, xi: frame.vector(ops, xi),
    lambda ops, tables, xi: slits.position_slice_length(ops, tables, xi),
    leave_real,
)
LAG_MARGINAL_OF_FIELDS = replace(
    LAG_MARGINAL, name="complex lag marginal of slits", leave=leave_parts
)
