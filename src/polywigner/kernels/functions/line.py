"""The transforms of slits as kernels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from polywigner.kernels.functions import slits
from polywigner.kernels.functions.membership import field_in_slits
from polywigner.kernels.functions.plane import enter_both_ends, product_of_both
from polywigner.kernels.functions.slits import slit_tables
from polywigner.kernels.kernel import (
    Kernel,
    Values,
    at_zero_frequency,
    leave_parts,
    leave_real,
    leave_wave,
)
from polywigner.numerics import phases


def _four_times(ops: Any, frame: Any, x: Any) -> Values:
    """4x in the frame as two floats: by how much the copies of two slits, doubled, approach."""
    total, rest = frame.exact_position(x)
    return phases.halves(ops, (4.0 * total, 4.0 * rest))


def _turns(ops: Any, frame: Any, upsilon: Any, xi: Any) -> Any:
    """The phase of the centre and of the carrier."""
    turns = phases.turns_to_centre(ops, frame.centre, upsilon)
    return phases.less_carrier(ops, frame, turns, xi)


AUTOCORRELATION = Kernel(
    "autocorrelation of slits",
    1,
    slit_tables,
    enter_both_ends,
    lambda ops, tables, turns, ahead, behind: (
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
        *phases.halves(ops, (*frame.detuned(ops, nu), 0.0)),
    ),
    lambda ops, tables, x, rest, *nu: (slits.wigner(ops, tables, (x, rest), nu),),
    leave_real,
)
POSITION_MARGINAL_OF_WAVES = at_zero_frequency(
    WIGNER, "position marginal of waves in slits", leads=False
)
AMBIGUITY = Kernel(
    "ambiguity of slits",
    1,
    slits.position_pairs,
    lambda ops, frame, upsilon, xi: (
        _turns(ops, frame, upsilon, xi),
        *phases.halves(ops, (*frame.frequency(ops, upsilon), 0.0)),
        *phases.halves(ops, (*frame.vector(ops, xi), 0.0)),
    ),
    lambda ops, tables, turns, upsilon, low, *xi: slits.ambiguity(ops, tables, xi, (upsilon, low)),
    leave_wave,
)
LAG_MARGINAL_OF_WAVES = at_zero_frequency(AMBIGUITY, "lag marginal of waves in slits", leads=True)
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
