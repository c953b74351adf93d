"""The transforms of slits as kernels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from polywigner.kernels import slits
from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.kernel import (
    Kernel,
    Values,
    leave_complex,
    leave_parts,
    leave_real,
    leave_wave,
)
from polywigner.kernels.membership import field_in_slits
from polywigner.kernels.plane import enter_complex_frequency, enter_frequency, product_of_both
from polywigner.kernels.slits import slit_tables

__all__ = [
    "AMBIGUITY",
    "AUTOCORRELATION",
    "FOURIER",
    "FOURIER_COMPLEX",
    "LAG_MARGINAL",
    "LAG_MARGINAL_OF_FIELDS",
    "POSITION_MARGINAL",
    "WIGNER",
]


def _complex_sum(ops: Any, tables: Any, turns: Any, growth: Any, real: Any, imag: Any) -> Values:
    total = slits.fourier_complex(ops, tables, Pair(real, imag))
    return total.real, total.imag


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
FOURIER = Kernel(
    "fourier of slits",
    1,
    slit_tables,
    enter_frequency,
    lambda ops, tables, turns, nu: slits.fourier(ops, tables, nu),
    leave_wave,
)
FOURIER_COMPLEX = Kernel(
    "fourier of slits, complex nu",
    1,
    slit_tables,
    enter_complex_frequency,
    _complex_sum,
    leave_complex,
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
