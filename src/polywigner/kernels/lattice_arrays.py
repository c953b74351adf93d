"""Wigner and ambiguity functions of phased arrays on a lattice.

W(x, nu) is a sum over the midpoints of pairs of elements. Each term is W of one element at x minus
the midpoint, times an array factor, (L1) of docs/theory.md. A(upsilon, xi) is a similar sum over
differences of element positions, (L2). Only midpoints or differences within an element's size of x
or xi contribute, so the cost does not depend on the number of elements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from polywigner.geometry import Aperture
from polywigner.kernels.array_factors import ProfileFactor, pair_factor, profile_factor
from polywigner.kernels.element_pairs import (
    ElementTables,
    RepeatedTables,
    element_ambiguity,
    element_tables,
    element_wigner,
)
from polywigner.kernels.kernel import Kernel, Values, leave_real, leave_wave
from polywigner.kernels.outline import Frame
from polywigner.numerics import phases
from polywigner.numerics.phases import unit_wave
from polywigner.source import Array
from polywigner.source.lattices import Lattice, Profile, separated
from polywigner.source.normal_form import SourceElement, normal_form

# Smallest number of elements for which W and A of a lattice use array factors. An array with fewer
# elements is computed as a single source (benchmarks/array_cost.py).
_LEAST_ELEMENTS = 4
# Distance [node spacings] from an end of an interval within which the contribution of a node is
# smaller than rounding errors.
_EDGE = 4e-15

Pair2 = tuple[float, ...]


@dataclass(frozen=True)
class _Nodes:
    """Midpoints or differences of the positions of all pairs of elements of a lattice."""

    scale: float
    """Spacing in lattice steps: 1 for differences, 1/2 for midpoints."""
    windows: tuple[tuple[float, float, int, int], ...]
    """Tuple (low, high, first node, number of nodes) for each lattice direction. Node h contributes
    at t if low < t - h < high."""

    def nearest(self, ops: Any, frame: _ArrayFrame, x: Any, y: Any) -> Values:
        """Return the indices of the first midpoint or difference that contributes.

        The unit of the indices is ``scale`` lattice steps. For midpoints, (x, y) is a position
        relative to the first element. For differences, (x, y) is a lag. The other results are (x,
        y) minus the first midpoint or difference, in the element's frame.
        """
        i, j = (
            0.0 * x + float(start)
            # If an element is larger than the lattice, all copies overlap, so every node
            # contributes.
            if high - low >= steps
            else ops.round((x * row[0] + y * row[1]) * (1 / self.scale) - high + 0.5)
            for (low, high, start, steps), row in zip(self.windows, frame.inverse, strict=True)
        )
        (ax, ay), (bx, by) = ((self.scale * u, self.scale * v) for u, v in frame.basis)
        offset = x - (i * ax + j * bx), y - (i * ay + j * by)
        return (i, j, *frame.element.vector(ops, *offset))

    def rows(self, frame: _ArrayFrame) -> list[tuple[float, float, float, float]]:
        """Return the lattice steps and vectors from the first contributing node to each node.

        The vectors are in the frame of the element.
        """
        counts = (
            min(steps, max(1, math.ceil(high - low - _EDGE)))
            for low, high, _, steps in self.windows
        )
        steps = [(float(k), float(m)) for k, m in product(*map(range, counts))]
        vectors = self.scale * np.array(steps) @ np.array(frame.basis) + frame.element.centre
        on_frame = frame.element.vertices(vectors).tolist()
        return [(*step, x, y) for step, (x, y) in zip(steps, on_frame, strict=True)]


@dataclass(frozen=True)
class _ArrayFrame:
    """Coordinates of an array on a lattice: the element's frame and the basis vectors."""

    element: Frame
    origin: Pair2
    """Centre of the first element."""
    centre: Pair2
    """Mean of the centres of the elements."""
    basis: tuple[Pair2, Pair2]
    inverse: tuple[Pair2, Pair2]
    """Matrix that converts positions to lattice coordinates."""
    cycles: Pair2
    """Phase difference of the weights of adjacent elements along each direction, in cycles."""
    means: _Nodes
    differences: _Nodes

    @property
    def measure(self) -> float:
        """Area of a unit square of the element's frame, in the user's units."""
        return self.element.measure

    @property
    def carrier(self) -> tuple[float, ...]:
        """Frequency of the carrier of the element, in the user's units."""
        return self.element.carrier

    @property
    def relative_cycles(self) -> Pair2:
        """Phase step of the weights minus phase step of the carrier, per basis vector [cycles]."""
        return tuple(
            cycles_per_site - float(np.dot(self.carrier, b))
            for cycles_per_site, b in zip(self.cycles, self.basis, strict=True)
        )


def _array_frame(
    lattice: Lattice, profiles: tuple[Profile, Profile], element: Aperture, frame: Frame
) -> _ArrayFrame:
    """Return the coordinates of an array from its lattice, its element and the element's frame."""
    basis, centre = np.array(lattice.basis), np.array(frame.centre)
    inverse = np.linalg.inv(basis.T)
    # The extent of the element limits the nodes that contribute, because W vanishes outside the
    # hull of the element and A vanishes at lags beyond its size.
    outline = (np.concatenate(element.rings) - centre) @ inverse.T
    low, high = outline.min(axis=0), outline.max(axis=0)
    origin, count = np.array(lattice.origin) + centre, np.array(lattice.weights.shape) - 1

    def nodes(scale: float, *columns: Any) -> _Nodes:
        """Return nodes from the columns of their windows."""
        return _Nodes(scale, tuple(zip(*(column.tolist() for column in columns), strict=True)))

    return _ArrayFrame(
        frame,
        tuple(origin.tolist()),
        tuple((origin + (count / 2) @ basis).tolist()),
        lattice.basis,
        (tuple(inverse[0].tolist()), tuple(inverse[1].tolist())),
        tuple(profile.cycles_per_element for profile in profiles),
        nodes(0.5, 2 * low, 2 * high, 0 * count, 2 * count + 1),
        nodes(1.0, low - high, high - low, -count, 2 * count + 1),
    )


ArrayTables = RepeatedTables[ElementTables, tuple[ProfileFactor, ...]]


def _lattice(array: Array) -> tuple[Lattice, tuple[Profile, Profile], SourceElement] | None:
    """Return the lattice of an array, the profiles of its weights, and its element.

    The result is None for fewer than four elements, for elements that do not form a lattice, and if
    the weights are not separable.
    """
    copies = normal_form(array).copies
    if copies is None or copies.lattice is None or len(array) < _LEAST_ELEMENTS:
        return None
    profiles = separated(copies.lattice.weights)
    return None if profiles is None else (copies.lattice, profiles, copies.element)


def is_on_lattice(array: Array) -> bool:
    """Return whether an array has four or more copies of an element on a lattice.

    The weights must be separable.
    """
    return _lattice(array) is not None


@lru_cache(maxsize=64)
def _tables(array: Array, double: bool) -> ArrayTables:
    """Return the coordinates, the element and the array factors of an array on a lattice."""
    separable = _lattice(array)
    assert separable is not None
    lattice, profiles, element = separable
    tables = element_tables(element.shape, double)
    frame = _array_frame(lattice, profiles, element.shape, tables.frame)
    return RepeatedTables(frame, tables, tuple(map(profile_factor, profiles)))


def _site_cycles(ops: Any, frame: _ArrayFrame, *nu: Any) -> list[Any]:
    """Return the phases nu.b in cycles for both basis vectors b, modulo 1."""
    return [phases.cycles_to_centre(ops, b, *nu) for b in frame.basis]


def _enter_wigner(ops: Any, frame: _ArrayFrame, x: Any, y: Any, nu_x: Any, nu_y: Any) -> Values:
    """Return (first midpoint, x - midpoint, phases in cycles, nu - carrier).

    Each of the four results has two components. The first midpoint that contributes is counted
    in half lattice steps from the first element. The phases are nu.b minus the phase difference
    of adjacent weights, for both basis vectors b. The position and the frequency are in the
    frame of the element, in its units.
    """
    nearest = frame.means.nearest(ops, frame, x - frame.origin[0], y - frame.origin[1])
    cycles = _site_cycles(ops, frame, nu_x, nu_y)
    along = (t - cycles_per_site for t, cycles_per_site in zip(cycles, frame.cycles, strict=True))
    return (*nearest, *along, *frame.element.detuned(ops, nu_x, nu_y))


def _wigner_sum(ops: Any, tables: ArrayTables, *inner: Any) -> Values:
    """Return W as a sum over midpoints, (L1), for the results of :func:`_enter_wigner`."""
    first, second, x, y, *cycles, nu_x, nu_y = inner
    frame, element = tables.frame, tables.element
    twice = cycles[0] + cycles[0], cycles[1] + cycles[1]

    def term(k: Any, m: Any, dx: Any, dy: Any) -> tuple[Any]:
        offset = (x - dx, y - dy)
        weight = pair_factor(ops, tables.sites, True, (first + k, second + m), twice).real
        return (weight * element_wigner(ops, element, *offset, nu_x, nu_y),)

    total: Values = ops.sum_large_terms(frame.means.rows(frame), term, element.clips)
    return total


def _enter_ambiguity(
    ops: Any, frame: _ArrayFrame, upsilon_x: Any, upsilon_y: Any, xi_x: Any, xi_y: Any
) -> Values:
    """Return (centre phase, difference in lattice steps, xi - difference, upsilon.b, upsilon).

    All results but the first have two components. The phases are in cycles, and upsilon.b is
    reduced modulo 2. A has the factor exp(-2 pi i centre phase). The lag and the frequency shift
    are in the frame of the element.
    """
    cycles = phases.cycles_to_centre(ops, frame.centre, upsilon_x, upsilon_y)
    cycles = phases.less_carrier(ops, frame, cycles, xi_x, xi_y)
    nearest = frame.differences.nearest(ops, frame, xi_x, xi_y)
    inner = frame.element.frequency(ops, upsilon_x, upsilon_y)
    # Midpoints are multiples of half a basis vector b, so upsilon.b is reduced modulo 2 cycles.
    along = (2.0 * t for t in _site_cycles(ops, frame, 0.5 * upsilon_x, 0.5 * upsilon_y))
    return (cycles, *nearest, *along, *inner)


def _ambiguity_sum(ops: Any, tables: ArrayTables, cycles: Any, *inner: Any) -> Values:
    """Return the real part and the negated imaginary part of A as a sum over differences, (L2).

    The arguments are the results of :func:`_enter_ambiguity`.
    """
    first, second, x, y, *along, upsilon_x, upsilon_y = inner
    frame, element, relative_cycles = tables.frame, tables.element, tables.frame.relative_cycles
    lowest = [profile.count - 1.0 for profile in tables.sites]

    def term(k: Any, m: Any, dx: Any, dy: Any) -> tuple[Any, Any]:
        i, j = first + k, second + m
        numbers = i + lowest[0], j + lowest[1]
        weight = pair_factor(ops, tables.sites, False, numbers, (along[0], along[1]))
        if any(relative_cycles):
            weight = weight * unit_wave(ops, i * relative_cycles[0] + j * relative_cycles[1])
        value = weight * element_ambiguity(ops, element, upsilon_x, upsilon_y, x - dx, y - dy)
        return value.real, -value.imag

    total: Values = ops.sum_large_terms(frame.differences.rows(frame), term, 4 * element.clips)
    return total


WIGNER = Kernel(
    "wigner of a lattice",
    2,
    _tables,
    _enter_wigner,
    _wigner_sum,
    leave_real,
)
AMBIGUITY = Kernel(
    "ambiguity of a lattice",
    2,
    _tables,
    _enter_ambiguity,
    _ambiguity_sum,
    leave_wave,
)
