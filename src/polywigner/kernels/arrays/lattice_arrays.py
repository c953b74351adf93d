"""Phased arrays on a lattice: the element's functions near x or xi, times array factors.

For copies of one element at the sites p_k of a lattice, a pair of sites contributes to W(x, nu)
what the element alone has at x less the midpoint of the sites, and to A(upsilon, xi) what it has
at xi less their difference (docs/theory.md, (L1), (L2)). Only the few midpoints (or differences)
within an element's size of x (or xi) count, however many elements there are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture, automean
from polywigner.illumination import Array
from polywigner.illumination.lattices import Lattice, Profile, separated
from polywigner.kernels.arrays.factors import ProfileFactor, profile_factor
from polywigner.kernels.arrays.repeated import (
    ElementSum,
    RepeatedTables,
    ambiguity,
    at_both_ends,
    element_tables,
    field,
    wigner,
)
from polywigner.kernels.arrays.site_weights import LatticeSites, Weights
from polywigner.kernels.arrays.weight_tables import fits_a_table
from polywigner.kernels.cut.clipping import AHEAD, BEHIND, MIRRORED
from polywigner.kernels.functions.plane import product_of_both
from polywigner.kernels.kernel import (
    Kernel,
    Values,
    at_zero_frequency,
    leave_real,
    leave_wave,
)
from polywigner.kernels.outline.frame import Frame
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
    "ArrayFrame",
    "Window",
    "array_frame",
    "is_on_lattice",
    "steps_of",
]

# A place within this of the edge of a region contributes less than rounding.
_EDGE = 4e-15
# Margin around an element's region, in its size: more than single precision rounds.
_MARGIN = 1e-4


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
    """Middle of the elements' centres."""
    means: tuple[Window, Window]
    differences: tuple[Window, Window]
    sites: tuple[Window, Window]
    support: tuple[Pair2, Pair2]
    """Low and high corner, in the element's frame, of what its automean lies within."""

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

    def may_count(self, x: Any, y: Any) -> Any:
        """Whether W of the element may differ from 0 at a place of its frame."""
        low, high = self.support
        return (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])

    def step(self, first: float, second: float) -> tuple[Any, Any]:
        """A constant number of steps, in the frame."""
        exact = np.array(self.basis).T @ np.array([first, second])
        (shifted,) = self.element.vertices((exact + np.array(self.element.centre))[None, :])
        return float(shifted[0]), float(shifted[1])


def array_frame(
    lattice: Lattice, element: Aperture, frame: Frame, turns: Pair2, double: bool
) -> ArrayFrame:
    basis = np.array(lattice.basis)
    inverse = np.linalg.inv(basis.T)
    centre = np.array(frame.centre)
    outline = (np.concatenate(element.rings) - centre) @ inverse.T
    region = np.concatenate(automean(element).rings)
    mean = (region - centre) @ inverse.T
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
        _box(frame.vertices(region)),
    )


def _box(points: NDArray[np.float64]) -> tuple[Pair2, Pair2]:
    """Corners of the points' box, larger than it by far more than rounding."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * (high - low)
    (x0, y0), (x1, y1) = (low - margin).tolist(), (high + margin).tolist()
    return (x0, y0), (x1, y1)


def _windows(low: Any, high: Any, start: Any, steps: Any) -> tuple[Window, Window]:
    first, second = (
        Window(float(a), float(b), int(k), int(n))
        for a, b, k, n in zip(low, high, start, steps, strict=True)
    )
    return first, second


def steps_of(
    frame: ArrayFrame, windows: tuple[Window, Window], scale: float
) -> list[tuple[float, float, float, float]]:
    """Numbers of steps from the first that counts, and the vector that they are in the frame."""
    counts = (range(window.count) for window in windows)
    return [(float(k), float(m), *frame.step(scale * k, scale * m)) for k, m in product(*counts)]


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
