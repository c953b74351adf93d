"""Array factors: sum_k w_k exp(-2 pi i nu.p_k) over the sites p_k of an array.

Source: docs/theory.md, (L3). On a lattice with weights that are a product, it is a product of sums
along its two directions; else sites are rows of a table. Far off the origin, positions are rounded
so much that they miss a lattice: the sums are then over the coordinates as they are given.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.illumination.lattices import Lattice, Profile, Sites, column_and_row, separated
from polywigner.kernels.arrays.factors import ProfileFactor, profile_factor
from polywigner.kernels.kernel import Kernel, Values, leave_parts, leave_wave
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair, plane_wave
from polywigner.numerics.phases import cos_sin_turns
from polywigner.plans import has_own_factor

__all__ = ["array_factor_kernel"]

# Sites that miss a lattice by more, of its extent D, are not taken for it: the phase errs by 6e3
# times that at |nu| D = 1000. Multiples of a pitch, counted from anywhere in the array, miss less.
_MISFIT = 2.0**-52
# Rows and columns may cross in so many places for each site there: those without one weigh 0.
_CROSSINGS_PER_SITE = 16

Row = tuple[float, ...]


@dataclass(frozen=True)
class FactorFrame:
    """Phases are relative to the middle of the sites."""

    centre: tuple[Any, ...]
    basis: tuple[tuple[float, ...], ...] = ()
    """Basis of the lattice; empty where sites are summed one by one."""
    content: float = 1.0


@dataclass(frozen=True)
class FactorTables:
    frame: FactorFrame
    edges: tuple[Row, ...]
    """Position relative to the middle, and weight, of every site; one dummy on a lattice.

    Each number of a position as the sum of two floats.
    """
    factors: tuple[ProfileFactor, ProfileFactor] | None = None
    constant: complex = 1.0
    turns: tuple[float, float] = (0.0, 0.0)
    axes: tuple[tuple[Row, ...], ...] = ()
    """Rows of x and of y of a grid of sites, whose sums are multiplied."""


@lru_cache(maxsize=64)
def _tables(sites: Sites, double: bool) -> FactorTables:
    lattice = sites.lattice if has_own_factor(len(sites.positions)) else None
    profiles = None if lattice is None else separated(lattice.weights)
    if lattice is None or profiles is None:
        return _table_of_sites(sites, double)
    if lattice.misfit > _MISFIT:
        return _table_of_axes(sites, double) or _table_of_sites(sites, double)
    middle = (Fraction(place) + Fraction(rest) for place, rest in lattice.middle)
    frame = FactorFrame(_doubled(middle, double), lattice.basis)
    return FactorTables(frame, ((),), *_constants(profiles, lattice))


def _constants(
    profiles: tuple[Profile, Profile], lattice: Lattice
) -> tuple[tuple[ProfileFactor, ProfileFactor], complex, tuple[float, float]]:
    """Factors, what multiplies them, and the turns per site; phases are 0 in the middle."""
    one, two = profiles
    constant = one.factor * two.factor
    for profile, count in zip(profiles, lattice.weights.shape, strict=True):
        constant *= complex(np.exp(1j * np.pi * profile.turns * (count - 1)))
    return (profile_factor(one), profile_factor(two)), constant, (one.turns, two.turns)


def _doubled(point: Any, double: bool) -> tuple[Any, ...]:
    return tuple(phases.doubled(c, double) for c in point)


def _table_of_axes(sites: Sites, double: bool) -> FactorTables | None:
    """Tables of sites where rows and columns cross, with weights that are a product; else None."""
    x, i = np.unique(sites.positions[:, 0], return_inverse=True)
    y, j = np.unique(sites.positions[:, 1], return_inverse=True)
    if len(x) * len(y) > _CROSSINGS_PER_SITE * len(sites.positions):
        return None
    weights = np.zeros((len(x), len(y)), np.complex128)
    np.add.at(weights, (i.ravel(), j.ravel()), sites.weights)
    found = column_and_row(weights)
    if found is None:
        return None
    middle = _middle(sites)
    axes = tuple(
        _rows((values - centre)[:, None], own, double)
        for values, centre, own in zip((x, y), middle, found, strict=True)
    )
    return FactorTables(FactorFrame(_doubled(middle.tolist(), double)), ((),), axes=axes)


@lru_cache(maxsize=64)
def _table_of_sites(sites: Sites, double: bool) -> FactorTables:
    middle = _middle(sites)
    rows = _rows(sites.positions - middle, sites.weights, double)
    return FactorTables(FactorFrame(_doubled(middle.tolist(), double)), rows)


def _middle(sites: Sites) -> NDArray[np.float64]:
    low, high = sites.positions.min(axis=0), sites.positions.max(axis=0)
    middle: NDArray[np.float64] = low + (high - low) / 2
    return middle


def _rows(
    places: NDArray[np.float64], weights: NDArray[np.complex128], double: bool
) -> tuple[Row, ...]:
    rows = []
    for place, weight in zip(places.tolist(), weights.tolist(), strict=True):
        both = [part for c in place for part in phases.doubled(c, double)]
        rows.append((*both, float(weight.real), float(weight.imag)))
    return tuple(rows)


def _enter(ops: Any, frame: FactorFrame, *nu: Any) -> Values:
    turns = phases.turns_to_centre(ops, frame.centre, *nu)
    if not frame.basis:
        return (turns, *nu)
    # sites are half steps from the middle: nu.b is wanted modulo 2
    half = [0.5 * component for component in nu]
    return (turns, *(2.0 * phases.turns_to_centre(ops, b, *half) for b in frame.basis))


def _sum(ops: Any, tables: FactorTables, turns: Any, *inner: Any) -> Values:
    if tables.axes:
        x, y = (
            _sum_over_sites(ops, rows, component)
            for rows, component in zip(tables.axes, inner, strict=True)
        )
        both = Pair(x[0], -x[1]) * Pair(y[0], -y[1])
        return both.real, -both.imag
    if tables.factors is None:
        return _sum_over_sites(ops, tables.edges, *inner)
    one, two = (
        factor.total(ops, along - own)
        for factor, along, own in zip(tables.factors, inner, tables.turns, strict=True)
    )
    constant = Pair(tables.constant.real, tables.constant.imag)
    total = one * two * constant
    return total.real, -total.imag


def _sum_over_sites(ops: Any, rows: tuple[Row, ...], *nu: Any) -> Values:
    def term(*row: Any) -> tuple[Any, Any]:
        *both, real, imag = row
        place = tuple(zip(both[0::2], both[1::2], strict=True))
        cosine, sine = cos_sin_turns(ops, phases.reduced(ops, phases.dot(ops, nu, place)))
        return real * cosine + imag * sine, real * sine - imag * cosine

    cosine, sine = ops.sum_over(rows, term, 2, like=nu[0])
    return cosine, sine


def _enter_complex(ops: Any, frame: FactorFrame, *parts: Any) -> Values:
    """(real, imaginary) part of the phase of the middle; nu."""
    real, imag = parts[0::2], parts[1::2]
    turns = phases.turns_to_centre(ops, frame.centre, *real)
    growth, rest = phases.dot(ops, imag, frame.centre)
    return (turns, growth + rest, *real, *imag)


def _complex_sum(ops: Any, tables: FactorTables, turns: Any, growth: Any, *nu: Any) -> Values:
    count = len(nu) // 2
    waves = [Pair(real, imag) for real, imag in zip(nu[:count], nu[count:], strict=True)]

    def term(*row: Any) -> tuple[Any, Any]:
        *both, real, imag = row
        phase = Pair(0.0, 0.0)
        for component, high, low in zip(waves, both[0::2], both[1::2], strict=True):
            phase = phase + component.scaled(high + low)
        wave = plane_wave(ops, phase) * Pair(real, imag)
        return wave.real, wave.imag

    total = Pair(*ops.sum_over(tables.edges, term, 2, like=nu[0]))
    total = total * plane_wave(ops, Pair(turns, growth))
    return total.real, total.imag


@lru_cache(maxsize=8)
def array_factor_kernel(dimension: int, is_complex: bool) -> Kernel:
    """The kernel of array factors of sites on a line, in the plane or in space."""
    if is_complex:
        return Kernel(
            "array factor, complex nu",
            dimension,
            _table_of_sites,
            _enter_complex,
            _complex_sum,
            leave_parts,
        )
    return Kernel("array factor", dimension, _tables, _enter, _sum, leave_wave)
