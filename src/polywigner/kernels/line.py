"""The transforms of slits as kernels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from polywigner.kernels import phases, slits
from polywigner.kernels.kernel import (
    Kernel,
    Values,
    leave_parts,
    leave_real,
    leave_wave,
)
from polywigner.kernels.membership import field_in_slits
from polywigner.kernels.plane import product_of_both
from polywigner.kernels.slits import slit_tables

__all__ = [
    "AMBIGUITY",
    "AUTOCORRELATION",
    "LAG_MARGINAL",
    "LAG_MARGINAL_OF_FIELDS",
    "POSITION_MARGINAL",
    "WIGNER",
]


def _four_times(ops: Any, frame: Any, x: Any) -> Values:
    """4x in the frame as two floats: by how much the copies of two slits, doubled, approach."""
    total, rest = frame.exact_position(x)
    return phases.halves(ops, (4.0 * total, 4.0 * rest))


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
    slits.lag_pairs,
    lambda ops, frame, x, nu: (
        *_four_times(ops, frame, x),
        *phases.halves(ops, (*frame.frequency(ops, nu), 0.0)),
    ),
    lambda ops, tables, x, rest, *nu: (slits.wigner(ops, tables, (x, rest), nu),),
    leave_real,
)
AMBIGUITY = Kernel(
    "ambiguity of slits",
    1,
    slits.position_pairs,
    lambda ops, frame, upsilon, xi: (
        phases.turns_to_centre(ops, frame.centre, upsilon),
        *phases.halves(ops, (*frame.frequency(ops, upsilon), 0.0)),
        *phases.halves(ops, (*frame.vector(ops, xi), 0.0)),
    ),
    lambda ops, tables, turns, upsilon, low, *xi: slits.ambiguity(ops, tables, xi, (upsilon, low)),
    leave_wave,
)
POSITION_MARGINAL = Kernel(
    "position marginal of slits",
    1,
    slits.lag_pairs,
    lambda ops, frame, x: _four_times(ops, frame, x),
    lambda ops, tables, *x: (slits.lag_slice_length(ops, tables, x),),
    leave_real,
)
LAG_MARGINAL = Kernel(
    "lag marginal of slits",
    1,
    slits.position_pairs,
    lambda ops, frame, xi: phases.halves(ops, (*frame.vector(ops, xi), 0.0)),
    lambda ops, tables, *xi: slits.position_slice_length(ops, tables, xi),
    leave_real,
)
LAG_MARGINAL_OF_FIELDS = replace(
    LAG_MARGINAL, name="complex lag marginal of slits", leave=leave_parts
)
