"""Phased arrays off any lattice: pairs of elements from lists for the cell of a sample.

The pair (k, l) contributes to W(x, nu) what the element alone has at x less the pair's midpoint,
and to A(upsilon, xi) what it has at xi less its difference (docs/theory.md, (L1), (L2)). Of the n^2
pairs those within the element's size of x (or xi) matter. Cells of about that size list them: what
a sample costs grows linearly with the number of elements, if their density stays.
"""

from __future__ import annotations

from typing import Any

from polywigner.kernels.arrays.pair_lists import sum_over_pairs
from polywigner.kernels.arrays.repeated import ElementSum, at_both_ends
from polywigner.kernels.arrays.scattered_sites import (
    ScatterFrame,
    ScatterTables,
    is_scattered,
    pairs_by_difference,
    pairs_by_mean,
)
from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED
from polywigner.kernels.functions.elements import ambiguity, field, wigner
from polywigner.kernels.functions.plane import product_of_both
from polywigner.kernels.kernel import (
    Kernel,
    Values,
    at_zero_frequency,
    leave_real,
    leave_wave,
)
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns

__all__ = [
    "AMBIGUITY",
    "AUTOCORRELATION",
    "LAG_MARGINAL",
    "POSITION_MARGINAL",
    "WIGNER",
    "is_scattered",
]


def _doubled_place(ops: Any, frame: ScatterFrame, x: Any, y: Any) -> Values:
    """A place in the frame relative to the middle; in single precision as two floats."""
    return frame.element.vector(ops, x - frame.middle[0], y - frame.middle[1])


def _enter_wigner(ops: Any, frame: ScatterFrame, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Values:
    place = _doubled_place(ops, frame, x, y)
    carrier = frame.carrier
    own = (nu_x - carrier[0], nu_y - carrier[1]) if any(carrier) else (nu_x, nu_y)
    return (*_halves(ops, place), *own, *frame.element.frequency(ops, *own))


def _halves(ops: Any, place: Values) -> Values:
    """Each component as two floats that single precision holds."""
    halves: list[Any] = []
    for component in place:
        halves += phases.halves(ops, (component, 0.0))
    return tuple(halves)


def _wigner_sum(
    ops: Any,
    tables: ScatterTables,
    x: Any,
    x_rest: Any,
    y: Any,
    y_rest: Any,
    nu_x: Any,
    nu_y: Any,
    own_x: Any,
    own_y: Any,
) -> Values:
    element = tables.element

    def term(px: Any, qx: Any, py: Any, qy: Any, dx: Any, dy: Any, re: Any, im: Any) -> Any:
        cosine, sine = cos_sin_turns(ops, nu_x * dx + nu_y * dy)
        factor = re * cosine + im * sine
        left = ((x - px) + (x_rest - qx), (y - py) + (y_rest - qy))
        return (factor * wigner(ops, element, *left, own_x, own_y),)

    total: Values = tuple(sum_over_pairs(ops, tables.sites.lists, (x, y), term, 1))
    return total


def _enter_ambiguity(
    ops: Any, frame: ScatterFrame, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> Values:
    turns = phases.turns_to_centre(ops, frame.exact_middle, upsilon_x, upsilon_y)
    turns = phases.less_carrier(ops, frame, turns, xi_x, xi_y)
    lag = _halves(ops, frame.element.vector(ops, xi_x, xi_y))
    own = frame.element.frequency(ops, upsilon_x, upsilon_y)
    return (turns, *lag, upsilon_x, upsilon_y, *own)


def _ambiguity_sum(
    ops: Any,
    tables: ScatterTables,
    turns: Any,
    xi_x: Any,
    x_rest: Any,
    xi_y: Any,
    y_rest: Any,
    upsilon_x: Any,
    upsilon_y: Any,
    own_x: Any,
    own_y: Any,
) -> Values:
    element = tables.element

    def term(px: Any, qx: Any, py: Any, qy: Any, mx: Any, my: Any, re: Any, im: Any) -> Any:
        cosine, sine = cos_sin_turns(ops, upsilon_x * mx + upsilon_y * my)
        factor = Pair(re, im) * Pair(cosine, -sine)
        left = ((xi_x - px) + (x_rest - qx), (xi_y - py) + (y_rest - qy))
        one, two = ambiguity(ops, element, own_x, own_y, *left)
        whole = factor * Pair(one, -two)
        return whole.real, -whole.imag

    total: Values = tuple(sum_over_pairs(ops, tables.sites.lists, (xi_x, xi_y), term, 2))
    return total


def _enter_both_ends(ops: Any, frame: ScatterFrame, *arguments: Any) -> Values:
    x, y, xi_x, xi_y = arguments
    turns = phases.less_carrier(ops, frame, 0.0 * xi_x, xi_x, xi_y)
    inner: list[Any] = []
    for side in (0.5, -0.5):
        inner += _halves(ops, _doubled_place(ops, frame, x + side * xi_x, y + side * xi_y))
    return (turns, *inner)


def _field(ops: Any, tables: ScatterTables, x: Any, x_rest: Any, y: Any, y_rest: Any) -> Values:
    """u at one place, less the carrier, from all elements."""
    total = Pair(0.0, 0.0)
    for px, qx, py, qy, re, im in tables.sites.elements:
        left = ((x - px) + (x_rest - qx), (y - py) + (y_rest - qy))
        total = total + Pair(*field(ops, tables.element, *left)) * Pair(re, im)
    return total.real, total.imag


WIGNER = Kernel(
    "wigner of scattered elements",
    2,
    pairs_by_mean,
    _enter_wigner,
    ElementSum((MIRRORED,), _wigner_sum),
    leave_real,
)
POSITION_MARGINAL = at_zero_frequency(
    WIGNER, "position marginal of scattered elements", leads=False
)
AMBIGUITY = Kernel(
    "ambiguity of scattered elements",
    2,
    pairs_by_difference,
    _enter_ambiguity,
    ElementSum((BEHIND, AHEAD), _ambiguity_sum),
    leave_wave,
)
LAG_MARGINAL = at_zero_frequency(AMBIGUITY, "lag marginal of scattered elements", leads=True)
AUTOCORRELATION = Kernel(
    "autocorrelation of scattered elements",
    2,
    pairs_by_mean,
    _enter_both_ends,
    at_both_ends(_field),
    product_of_both,
)
