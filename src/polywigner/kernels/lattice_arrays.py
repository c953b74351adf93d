"""Phased arrays on a lattice: the element's functions near x or xi, times array factors.

For copies of one element at the sites p_k of a lattice, a pair of sites contributes to W(x, nu)
what the element alone has at x less the midpoint of the sites, and to A(upsilon, xi) what it has
at xi less their difference (docs/theory.md, (L1), (L2)). Only the few midpoints (or differences)
within an element's size of x (or xi) count, however many elements there are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture, automean
from polywigner.illumination import Array
from polywigner.illumination.lattices import Lattice, Profile, separated
from polywigner.kernels import ambiguity, phases
from polywigner.kernels.complex_pairs import Pair
from polywigner.kernels.factors import ProfileFactor, profile_factor
from polywigner.kernels.frame import Frame
from polywigner.kernels.kernel import (
    Kernel,
    Values,
    at_zero_frequency,
    leave_real,
    leave_wave,
)
from polywigner.kernels.membership import field
from polywigner.kernels.plane import product_of_both, tables_of
from polywigner.kernels.repeated import RepeatedTables, at_both_ends
from polywigner.kernels.trigonometry import cos_sin_turns
from polywigner.kernels.weight_tables import MeanTable, mean_table
from polywigner.kernels.wigner import wigner

__all__ = [
    "AMBIGUITY",
    "AUTOCORRELATION",
    "LAG_MARGINAL",
    "POSITION_MARGINAL",
    "WIGNER",
    "is_on_lattice",
]

# Fewer elements are summed pair by pair.
_LEAST_ELEMENTS = 4
# With fewer sites of any weights, the pairs of a midpoint are summed one by one.
_LEAST_TABULATED = 64
# What lies within this of the edge of a region contributes less than rounding.
_EDGE = 4e-15

Pair2 = tuple[float, float]


@dataclass(frozen=True)
class Window:
    """Which whole numbers h along one direction have t - h in the open interval (low, high)."""

    low: float
    high: float
    start: int
    """The first of those that the lattice has, ..."""
    steps: int
    """... and how many it has."""

    @property
    def _is_all(self) -> bool:
        """Whether the interval holds no fewer: elements much larger than the lattice."""
        return self.high - self.low >= self.steps

    @property
    def count(self) -> int:
        """The most that there can be."""
        if self._is_all:
            return self.steps
        return max(1, math.ceil(self.high - self.low - _EDGE))

    def first(self, ops: Any, t: Any) -> Any:
        if self._is_all:
            return 0.0 * t + float(self.start)
        return ops.round(t - self.high + 0.5)


@dataclass(frozen=True)
class ArrayFrame:
    """The frame of the element, and the lattice."""

    element: Frame
    origin: Pair2
    """The centre of the element's frame at the first site."""
    basis: tuple[Pair2, Pair2]
    inverse: tuple[Pair2, Pair2]
    """From positions to lattice coordinates."""
    turns: Pair2
    """By which the phase of the weights grows from site to site, along each direction."""
    middle: tuple[phases.Doubled, ...]
    """Of the elements' centres."""
    means: tuple[Window, Window]
    differences: tuple[Window, Window]
    sites: tuple[Window, Window]

    @property
    def content(self) -> float:
        return self.element.content

    @property
    def carrier(self) -> tuple[float, ...]:
        return self.element.carrier

    @property
    def slope(self) -> Pair2:
        """The turns less those of the carrier, which is counted with all of a lag or position."""
        one, two = (
            own - float(np.dot(self.carrier, b))
            for own, b in zip(self.turns, self.basis, strict=True)
        )
        return one, two

    def coordinates(self, x: Any, y: Any) -> tuple[Any, Any]:
        """A vector in steps of the lattice."""
        (xx, xy), (yx, yy) = self.inverse
        return x * xx + y * xy, x * yx + y * yy

    def less(self, x: Any, y: Any, first: Any, second: Any, scale: float) -> tuple[Any, Any]:
        """A vector minus steps of the lattice times ``scale``."""
        (ax, ay), (bx, by) = self.basis
        return (
            x - (first * (scale * ax) + second * (scale * bx)),
            y - (first * (scale * ay) + second * (scale * by)),
        )

    def step(self, first: float, second: float) -> tuple[Any, Any]:
        """A constant number of steps, in the frame."""
        exact = np.array(self.basis).T @ np.array([first, second])
        (shifted,) = self.element.vertices((exact + np.array(self.element.centre))[None, :])
        return float(shifted[0]), float(shifted[1])


@dataclass(frozen=True, eq=False)
class Weights:
    """The weights at the sites (n1, n2), less their even phase."""

    values: NDArray[np.complex128]

    @property
    def shape(self) -> tuple[int, int]:
        return self.values.shape[0], self.values.shape[1]

    @cached_property
    def real(self) -> tuple[float, ...]:
        return tuple(self.values.real.ravel().tolist())

    @cached_property
    def imag(self) -> tuple[float, ...]:
        return tuple(self.values.imag.ravel().tolist())

    @cached_property
    def _tables(self) -> dict[bool, MeanTable | None]:
        return {}

    def table(self, double: bool) -> MeanTable | None:
        """The factors of midpoints as a table, where it is worth making and not too large."""
        if self.values.size < _LEAST_TABULATED:
            return None
        if double not in self._tables:
            self._tables[double] = mean_table(self.values, double)
        return self._tables[double]

    def at(self, ops: Any, i: Any, j: Any) -> tuple[Pair, Any]:
        """The weight of a site, and whether there is one; 0 if not."""
        rows, columns = self.shape
        exists = (i >= 0.0) & (i < float(rows)) & (j >= 0.0) & (j < float(columns))
        index = ops.select(exists, i * float(columns) + j, 0.0)
        real, imag = (ops.lookup(table, index) for table in (self.real, self.imag))
        return Pair(ops.select(exists, real, 0.0), ops.select(exists, imag, 0.0)), exists


@dataclass(frozen=True)
class LatticeSites:
    """The weights as factors or one by one."""

    factors: tuple[ProfileFactor, ProfileFactor] | None
    """Where the weights are a product of two profiles."""
    weights: Weights


ArrayTables = RepeatedTables[LatticeSites]
# A kernel unrolls the element's sum over edges for the copies around a place; two stand for them.
_SUMS_PER_EDGE = 2


def _lattice(array: Array) -> Lattice | None:
    phased = array.phased
    if phased is None or not isinstance(_element(phased), Aperture):
        return None
    return phased.sites.lattice if len(array) >= _LEAST_ELEMENTS else None


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
    tables = tables_of(element, double)
    profiles = separated(lattice.weights)
    turns = (0.0, 0.0) if profiles is None else (profiles[0].turns, profiles[1].turns)
    factors, values = None, lattice.weights
    if profiles is not None:
        factors = (_scaled(profiles[0]), _scaled(profiles[1]))
        i, j = np.indices(values.shape)
        values = values * np.exp(-2j * np.pi * (turns[0] * i + turns[1] * j))
    frame = _frame(lattice, element, tables.frame, turns, double)
    sites = LatticeSites(factors, Weights(values))
    return RepeatedTables(frame, tables, tables.edges, sites, _SUMS_PER_EDGE)


def _scaled(profile: Profile) -> ProfileFactor:
    """The factor of a profile whose constant is not 1 in modulus takes it into its amplitudes."""
    size = abs(profile.factor)
    if profile.is_uniform and size == 1.0:
        return profile_factor(profile)
    amplitudes = tuple(size * amplitude for amplitude in profile.amplitudes)
    return profile_factor(Profile(amplitudes, profile.turns, profile.factor / size))


def _frame(
    lattice: Lattice, element: Aperture, frame: Frame, turns: Pair2, double: bool
) -> ArrayFrame:
    basis = np.array(lattice.basis)
    inverse = np.linalg.inv(basis.T)
    centre = np.array(frame.centre)
    outline = (np.concatenate(element.rings) - centre) @ inverse.T
    mean = (np.concatenate(automean(element).rings) - centre) @ inverse.T
    low, high = outline.min(axis=0).tolist(), outline.max(axis=0).tolist()
    origin = np.array(lattice.origin) + centre
    count = np.array(lattice.weights.shape) - 1
    middle = origin + (count / 2) @ basis
    spread = [b - a for a, b in zip(low, high, strict=True)]
    b1, b2 = lattice.basis
    i1, i2 = inverse.tolist()
    return ArrayFrame(
        frame,
        (float(origin[0]), float(origin[1])),
        (b1, b2),
        ((i1[0], i1[1]), (i2[0], i2[1])),
        turns,
        tuple(phases.doubled(float(c), double) for c in middle),
        _windows((2 * mean).min(axis=0), (2 * mean).max(axis=0), 0 * count, 2 * count + 1),
        _windows([-s for s in spread], spread, -count, 2 * count + 1),
        _windows(low, high, 0 * count, count + 1),
    )


def _windows(low: Any, high: Any, start: Any, steps: Any) -> tuple[Window, Window]:
    first, second = (
        Window(float(a), float(b), int(k), int(n))
        for a, b, k, n in zip(low, high, start, steps, strict=True)
    )
    return first, second


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
    frame, part = tables.frame, tables.part

    def term(k: Any, m: Any, dx: Any, dy: Any) -> tuple[Any]:
        sums = (first + k, second + m)
        if tables.sites.factors is not None:
            factor = along_1(k, sums[0]) * along_2(m, sums[1])
        elif table is not None:
            factor = table.at(ops, sums, taps)
        else:
            factor = _mean_factor(ops, tables.sites.weights, sums, (turns_1, turns_2))
        return (factor * wigner(ops, part, x - dx, y - dy, nu_x, nu_y),)

    table = None if tables.sites.factors is not None else tables.sites.weights.table(ops.double)
    if table is not None:
        taps = table.taps(ops, (turns_1, turns_2))
    if tables.sites.factors is not None:
        one, two = tables.sites.factors
        along_1 = _remembered(lambda index: one.at_mean(ops, index, turns_1))
        along_2 = _remembered(lambda index: two.at_mean(ops, index, turns_2))
    total: Values = ops.sum_of_long(_steps(frame, frame.means, 0.5), term, part.clips)
    return total


def _steps(
    frame: ArrayFrame, windows: tuple[Window, Window], scale: float
) -> list[tuple[float, float, float, float]]:
    """Numbers of steps from the first that counts, and the vector that they are in the frame."""
    counts = (range(window.count) for window in windows)
    return [(float(k), float(m), *frame.step(scale * k, scale * m)) for k, m in product(*counts)]


def _remembered(compute: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    """``compute`` of the second argument, once for every constant that comes first."""
    known: dict[float, Any] = {}

    def of(step: Any, argument: Any) -> Any:
        if not isinstance(step, float):  # a row of an engine's table
            return compute(argument)
        if step not in known:
            known[step] = compute(argument)
        return known[step]

    return of


def _mean_factor(ops: Any, weights: Weights, sums: Any, turns: Any) -> Any:
    """The factor of weights that are no product, by adding up all pairs of one midpoint."""
    rows, columns = weights.shape

    def term(i: Any, j: Any) -> tuple[Any]:
        other_i, other_j = sums[0] - i, sums[1] - j
        one, _ = weights.at(ops, i + 0.0 * sums[0], j + 0.0 * sums[1])
        other, _ = weights.at(ops, other_i, other_j)
        phase = (i - other_i) * turns[0] + (j - other_j) * turns[1]
        cosine, sine = cos_sin_turns(ops, phase)
        pair = one * Pair(other.real, -other.imag)
        return (pair.real * cosine + pair.imag * sine,)

    sites = [(float(i), float(j)) for i in range(rows) for j in range(columns)]
    (total,) = ops.sum_over(sites, term, 1, like=sums[0])
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
    frame, part = tables.frame, tables.part
    slope = frame.slope

    def term(k: Any, m: Any, dx: Any, dy: Any) -> tuple[Any, Any]:
        steps = (first + k, second + m)
        if tables.sites.factors is None:
            factor = _difference_factor(ops, tables.sites.weights, steps, (turns_1, turns_2))
        else:
            factor = along_1(k, steps[0]) * along_2(m, steps[1])
        if any(slope):
            phase = steps[0] * slope[0] + steps[1] * slope[1]
            factor = factor * Pair(*cos_sin_turns(ops, phase))
        cosine, sine = ambiguity.ambiguity(ops, part, upsilon_x, upsilon_y, xi_x - dx, xi_y - dy)
        part_here = factor * Pair(cosine, -sine)
        return part_here.real, -part_here.imag

    if tables.sites.factors is not None:
        one, two = tables.sites.factors
        along_1 = _remembered(lambda index: one.at_difference(ops, index, turns_1))
        along_2 = _remembered(lambda index: two.at_difference(ops, index, turns_2))
    rows = _steps(frame, frame.differences, 1.0)
    total: Values = ops.sum_of_long(rows, term, 4 * part.clips)
    return total


def _difference_factor(ops: Any, weights: Weights, steps: Any, turns: Any) -> Pair:
    rows, columns = weights.shape

    def term(i: Any, j: Any) -> tuple[Any, Any]:
        other, _ = weights.at(ops, i + 0.0 * steps[0], j + 0.0 * steps[1])
        one, _ = weights.at(ops, i + steps[0], j + steps[1])
        phase = (i + 0.5 * (steps[0] - (rows - 1.0))) * turns[0]
        phase = phase + (j + 0.5 * (steps[1] - (columns - 1.0))) * turns[1]
        cosine, sine = cos_sin_turns(ops, phase)
        pair = one * Pair(other.real, -other.imag) * Pair(cosine, -sine)
        return pair.real, pair.imag

    sites = [(float(i), float(j)) for i in range(rows) for j in range(columns)]
    return Pair(*ops.sum_over(sites, term, 2, like=steps[0]))


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
    frame, part = tables.frame, tables.part
    total = Pair(0.0, 0.0)
    for k, m, dx, dy in _steps(frame, frame.sites, 1.0):
        i, j = first + k, second + m
        weight, exists = tables.sites.weights.at(ops, i, j)
        phase = ops.select(exists, i * frame.slope[0] + j * frame.slope[1], 0.0)
        own = Pair(*field(ops, part, x - dx, y - dy))
        total = total + own * weight * Pair(*cos_sin_turns(ops, phase))
    return total.real, total.imag


WIGNER = Kernel(
    "wigner of a lattice",
    2,
    _tables,
    _enter_wigner,
    _wigner_sum,
    leave_real,
    copies=1,
    clips_per_term=4,
)
POSITION_MARGINAL = at_zero_frequency(WIGNER, "position marginal of a lattice", leads=False)
AMBIGUITY = Kernel(
    "ambiguity of a lattice",
    2,
    _tables,
    _enter_ambiguity,
    _ambiguity_sum,
    leave_wave,
    copies=2,
    clips_per_term=16,
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
