"""Array factors: sum_k w_k exp(-2 pi i nu.p_k) over the sites p_k of an array.

Source: docs/theory.md, (L3). On a lattice with weights that are a product, it is a product of sums
along its two directions; else sites are rows of a table. Far off the origin, positions are rounded
so much that they miss a lattice: the sums are then over the coordinates as they are given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.arrays.factors import ProfileFactor, profile_factor
from polywigner.kernels.kernel import Kernel, Values, leave_parts, leave_wave
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair, plane_wave
from polywigner.source.lattices import Sites, column_and_row, separated

# Sites that miss a lattice by more, of its extent D, are not taken for it: the phase errs by 6e3
# times that at |nu| D = 1000. Multiples of a pitch, counted from anywhere in the array, miss less.
_MISFIT = 2.0**-52
# Fewer sites are summed one by one: as fast, and compiled at once (benchmarks/array_cost.py).
_LEAST_SITES = 16
# Rows and columns may cross in so many places for each site there: those without one weigh 0.
_CROSSINGS_PER_SITE = 16

Row = tuple[float, ...]


@dataclass(frozen=True)
class _Frame:
    """Phases are relative to the middle of the sites."""

    centre: tuple[phases.Doubled, ...]
    basis: tuple[tuple[float, ...], ...] = ()
    """Basis of the lattice; empty where sites are summed one by one."""
    content: float = 1.0


@dataclass(frozen=True)
class _Tables:
    frame: _Frame
    rows: tuple[tuple[Row, ...], ...] = ()
    """Tables of sites: position relative to the middle, each number as the sum of two floats, and
    weight. Two tables, for x and y of a grid of sites: sums to multiply; lattices have none."""
    factors: tuple[ProfileFactor, ...] = ()
    constant: complex = 1.0
    turns: tuple[float, ...] = ()

    @property
    def terms(self) -> int:
        return max(1, sum(map(len, self.rows)))


@lru_cache(maxsize=64)
def _tables(sites: Sites, double: bool) -> _Tables:
    lattice = sites.lattice if len(sites.positions) >= _LEAST_SITES else None
    profiles = None if lattice is None else separated(lattice.weights)
    if lattice is None or profiles is None:
        return _table_of_sites(sites, double)
    if lattice.misfit > _MISFIT:
        return _tables_of_axes(sites, double) or _table_of_sites(sites, double)
    middle = (Fraction(place) + Fraction(rest) for place, rest in lattice.middle)
    frame = _Frame(tuple(phases.doubled(c, double) for c in middle), lattice.basis)
    constant = complex(np.prod([profile.factor for profile in profiles]))
    for profile, count in zip(profiles, lattice.weights.shape, strict=True):
        # phases are 0 in the middle
        constant *= complex(np.exp(1j * np.pi * profile.turns * (count - 1)))
    factors, turns = map(profile_factor, profiles), (profile.turns for profile in profiles)
    return _Tables(frame, (), tuple(factors), constant, tuple(turns))


def _tables_of_axes(sites: Sites, double: bool) -> _Tables | None:
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
    return _summed([(x[:, None], found[0]), (y[:, None], found[1])], double)


@lru_cache(maxsize=64)
def _table_of_sites(sites: Sites, double: bool) -> _Tables:
    return _summed([(sites.positions, sites.weights)], double)


def _summed(
    axes: Sequence[tuple[NDArray[np.float64], NDArray[np.complex128]]], double: bool
) -> _Tables:
    """Tables of positions (n, d) with their weights (n,)."""
    middle: list[phases.Doubled] = []
    tables = []
    for positions, weights in axes:
        low = positions.min(axis=0)
        own = low + np.ptp(positions, axis=0) / 2
        middle += [phases.doubled(c, double) for c in own.tolist()]
        rows = zip((positions - own).tolist(), weights.tolist(), strict=True)
        tables.append(
            tuple(
                (*(part for c in place for part in phases.doubled(c, double)), w.real, w.imag)
                for place, w in rows
            )
        )
    return _Tables(_Frame(tuple(middle)), tuple(tables))


def _enter(ops: Any, frame: _Frame, *nu: Any) -> Values:
    turns = phases.turns_to_centre(ops, frame.centre, *nu)
    if not frame.basis:
        return (turns, *nu)
    # sites are half steps from the middle: nu.b is wanted modulo 2
    half = [0.5 * component for component in nu]
    return (turns, *(2.0 * phases.turns_to_centre(ops, b, *half) for b in frame.basis))


def _sum(ops: Any, tables: _Tables, turns: Any, *inner: Any) -> Values:
    if len(tables.rows) == 1:
        total = _sum_over_sites(ops, tables.rows[0], *inner)
    elif tables.rows:
        one, two = map(_sum_over_sites, (ops, ops), tables.rows, inner)
        total = one * two
    else:
        one, two = (
            factor.total(ops, along - own)
            for factor, along, own in zip(tables.factors, inner, tables.turns, strict=True)
        )
        total = one * two * Pair(tables.constant.real, tables.constant.imag)
    return total.real, -total.imag


def _sum_over_sites(ops: Any, rows: tuple[Row, ...], *nu: Any) -> Pair:
    def term(*row: Any) -> Values:
        *both, real, imag = row
        place = tuple(zip(both[0::2], both[1::2], strict=True))
        return phases.rotated(ops, phases.reduced(ops, phases.dot(ops, nu, place)), real, -imag)

    return Pair(*ops.sum_over(rows, term, 2, like=nu[0]))


def _enter_complex(ops: Any, frame: _Frame, *parts: Any) -> Values:
    """(real, imaginary) part of the phase of the middle; nu."""
    real, imag = parts[0::2], parts[1::2]
    turns = phases.turns_to_centre(ops, frame.centre, *real)
    growth, rest = phases.dot(ops, imag, frame.centre)
    return (turns, growth + rest, *real, *imag)


def _complex_sum(ops: Any, tables: _Tables, turns: Any, growth: Any, *nu: Any) -> Values:
    count = len(nu) // 2
    waves = [Pair(real, imag) for real, imag in zip(nu[:count], nu[count:], strict=True)]

    def term(*row: Any) -> tuple[Any, Any]:
        *both, real, imag = row
        phase = Pair(0.0, 0.0)
        for component, high, low in zip(waves, both[0::2], both[1::2], strict=True):
            phase = phase + component.scaled(high + low)
        wave = plane_wave(ops, phase) * Pair(real, imag)
        return wave.real, wave.imag

    total = Pair(*ops.sum_over(tables.rows[0], term, 2, like=nu[0]))
    total = total * plane_wave(ops, Pair(turns, growth))
    return total.real, total.imag


@lru_cache(maxsize=8)
def array_factor_kernel(dimension: int, is_complex: bool) -> Kernel:
    """The kernel of array factors of sites on a line, in the plane or in space."""
    if is_complex:
        steps = _table_of_sites, _enter_complex, _complex_sum, leave_parts
        return Kernel("array factor, complex nu", dimension, *steps)
    return Kernel("array factor", dimension, _tables, _enter, _sum, leave_wave)
