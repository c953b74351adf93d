"""Phased arrays on a lattice: the element's functions near x or xi, times array factors.

For copies of one element at the sites p_k of a lattice, a pair of sites contributes to W(x, nu)
what the element alone has at x less the midpoint of the sites, and to A(upsilon, xi) what it has
at xi less their difference (docs/theory.md, (L1), (L2)). Only the few midpoints (or differences)
within an element's size of x (or xi) count, however many elements there are.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from polywigner.geometry import Aperture
from polywigner.illumination import Array
from polywigner.illumination.lattices import Lattice, Profile, separated
from polywigner.kernels.arrays.array_frames import ArrayFrame, array_frame, steps_of
from polywigner.kernels.arrays.factors import ProfileFactor, profile_factor
from polywigner.kernels.arrays.repeated import ElementSum, RepeatedTables, at_both_ends
from polywigner.kernels.arrays.site_weights import LatticeSites, Weights
from polywigner.kernels.arrays.weight_tables import fits_a_table
from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED
from polywigner.kernels.functions.elements import ambiguity, element_tables, field, wigner
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
from polywigner.plans import sums_over_lattice

__all__ = [
    "AMBIGUITY",
    "AUTOCORRELATION",
    "LAG_MARGINAL",
    "POSITION_MARGINAL",
    "WIGNER",
    "is_on_lattice",
]


ArrayTables = RepeatedTables[LatticeSites]


def _lattice(array: Array) -> Lattice | None:
    phased = array.phased
    if phased is None or not isinstance(_element(phased), Aperture):
        return None
    return phased.sites.lattice if sums_over_lattice(len(array)) else None


def _element(array: Array) -> Any:
    """The one element of a phased array."""
    assert array.repeated is not None
    return array.repeated[0]


def is_on_lattice(array: Array) -> bool:
    """Whether an array is one element, repeated on a lattice."""
    return _lattice(array) is not None


@lru_cache(maxsize=64)
def _tables(array: Array, double: bool) -> ArrayTables:
    lattice = _lattice(array)
    assert lattice is not None and array.phased is not None
    element = _element(array.phased)
    tables = element_tables(element, double)
    profiles = separated(lattice.weights)
    turns = (0.0, 0.0) if profiles is None else (profiles[0].turns, profiles[1].turns)
    factors, values = None, lattice.weights
    if profiles is not None:
        factors = (_scaled(profiles[0]), _scaled(profiles[1]))
        i, j = np.indices(values.shape)
        values = values * np.exp(-2j * np.pi * (turns[0] * i + turns[1] * j))
    frame = array_frame(lattice, element, tables.frame, turns, double)
    sites = LatticeSites(factors, Weights(values))
    by_pairs = factors is None and not fits_a_table(values.shape, double)
    terms = values.size if by_pairs else 1
    return RepeatedTables(frame, tables, sites, terms)


def _scaled(profile: Profile) -> ProfileFactor:
    """The factor of a profile whose constant is not 1 in modulus takes it into its amplitudes."""
    size = abs(profile.factor)
    if profile.is_uniform and size == 1.0:
        return profile_factor(profile)
    amplitudes = tuple(size * amplitude for amplitude in profile.amplitudes)
    return profile_factor(Profile(amplitudes, profile.turns, profile.factor / size))


def _site_turns(ops: Any, frame: ArrayFrame, nu_x: Any, nu_y: Any) -> tuple[Any, Any]:
    """nu.b modulo 1 along both directions."""
    one, two = (phases.turns_to_centre(ops, b, nu_x, nu_y) for b in frame.basis)
    return one, two


def _enter_wigner(ops: Any, frame: ArrayFrame, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Values:
    """First midpoint in half steps, x from there in the element's frame, turns, nu."""
    from_origin = (x - frame.origin[0], y - frame.origin[1])
    t = frame.coordinates(*from_origin)
    first, second = (w.first(ops, 2.0 * c) for w, c in zip(frame.means, t, strict=True))
    left = frame.element.vector(ops, *frame.less(*from_origin, first, second, 0.5))
    turns = _site_turns(ops, frame, nu_x, nu_y)
    along = (t - own for t, own in zip(turns, frame.turns, strict=True))
    return (first, second, *left, *along, *frame.element.detuned(ops, nu_x, nu_y))


def _wigner_sum(
    ops: Any,
    tables: ArrayTables,
    first: Any,
    second: Any,
    x: Any,
    y: Any,
    turns_1: Any,
    turns_2: Any,
    nu_x: Any,
    nu_y: Any,
) -> Values:
    frame, element = tables.frame, tables.element

    factor = tables.sites.at_means(ops, (turns_1, turns_2))

    def term(k: Any, m: Any, dx: Any, dy: Any) -> tuple[Any]:
        left = (x - dx, y - dy)
        counts = frame.may_count(*left)
        weight = factor((k, m), (first + k, second + m), counts)
        return (weight * wigner(ops, element, *left, nu_x, nu_y),)

    total: Values = ops.sum_large_terms(steps_of(frame, frame.means, 0.5), term, element.clips)
    return total


def _enter_ambiguity(
    ops: Any, frame: ArrayFrame, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> Values:
    """Phase of the middle and carrier; first difference, xi from there, turns, upsilon."""
    turns = phases.turns_to_centre(ops, frame.middle, upsilon_x, upsilon_y)
    turns = phases.less_carrier(ops, frame, turns, xi_x, xi_y)
    t = frame.coordinates(xi_x, xi_y)
    first, second = (w.first(ops, c) for w, c in zip(frame.differences, t, strict=True))
    left = frame.element.vector(ops, *frame.less(xi_x, xi_y, first, second, 1.0))
    inner = frame.element.frequency(ops, upsilon_x, upsilon_y)
    # midpoints are half steps: upsilon.b is wanted modulo 2
    along = (2.0 * t for t in _site_turns(ops, frame, 0.5 * upsilon_x, 0.5 * upsilon_y))
    return (turns, first, second, *left, *along, *inner)


def _ambiguity_sum(
    ops: Any,
    tables: ArrayTables,
    turns: Any,
    first: Any,
    second: Any,
    xi_x: Any,
    xi_y: Any,
    turns_1: Any,
    turns_2: Any,
    upsilon_x: Any,
    upsilon_y: Any,
) -> Values:
    frame, element = tables.frame, tables.element
    slope = frame.slope

    factor_of = tables.sites.at_differences(ops, (turns_1, turns_2))

    def term(k: Any, m: Any, dx: Any, dy: Any) -> tuple[Any, Any]:
        steps = (first + k, second + m)
        factor = factor_of((k, m), steps)
        if any(slope):
            phase = steps[0] * slope[0] + steps[1] * slope[1]
            factor = factor * Pair(*cos_sin_turns(ops, phase))
        cosine, sine = ambiguity(ops, element, upsilon_x, upsilon_y, xi_x - dx, xi_y - dy)
        part_here = factor * Pair(cosine, -sine)
        return part_here.real, -part_here.imag

    rows = steps_of(frame, frame.differences, 1.0)
    total: Values = ops.sum_large_terms(rows, term, 4 * element.clips)
    return total


def _enter_both_ends(ops: Any, frame: ArrayFrame, x: Any, y: Any, xi_x: Any, xi_y: Any) -> Values:
    """Phase of the carrier; for both ends the first site and the place relative to it."""
    turns = phases.less_carrier(ops, frame, 0.0 * xi_x, xi_x, xi_y)
    inner: list[Any] = []
    for side in (0.5, -0.5):
        place = (x + side * xi_x - frame.origin[0], y + side * xi_y - frame.origin[1])
        t = frame.coordinates(*place)
        first, second = (w.first(ops, c) for w, c in zip(frame.sites, t, strict=True))
        inner += [
            first,
            second,
            *frame.element.vector(ops, *frame.less(*place, first, second, 1.0)),
        ]
    return (turns, *inner)


def _field(ops: Any, tables: ArrayTables, first: Any, second: Any, x: Any, y: Any) -> Values:
    """u at one place, less the carrier: that of the elements around it, which may overlap."""
    frame, element = tables.frame, tables.element
    total = Pair(0.0, 0.0)
    for k, m, dx, dy in steps_of(frame, frame.sites, 1.0):
        i, j = first + k, second + m
        weight, exists = tables.sites.weights.at(ops, i, j)
        phase = ops.select(exists, i * frame.slope[0] + j * frame.slope[1], 0.0)
        own = Pair(*field(ops, element, x - dx, y - dy))
        total = total + own * weight * Pair(*cos_sin_turns(ops, phase))
    return total.real, total.imag


WIGNER = Kernel(
    "wigner of a lattice",
    2,
    _tables,
    _enter_wigner,
    ElementSum((MIRRORED,), _wigner_sum),
    leave_real,
)
POSITION_MARGINAL = at_zero_frequency(WIGNER, "position marginal of a lattice", leads=False)
AMBIGUITY = Kernel(
    "ambiguity of a lattice",
    2,
    _tables,
    _enter_ambiguity,
    ElementSum((BEHIND, AHEAD), _ambiguity_sum),
    leave_wave,
)
LAG_MARGINAL = at_zero_frequency(AMBIGUITY, "lag marginal of a lattice", leads=True)
AUTOCORRELATION = Kernel(
    "autocorrelation of a lattice",
    2,
    _tables,
    _enter_both_ends,
    at_both_ends(_field),
    product_of_both,
)
