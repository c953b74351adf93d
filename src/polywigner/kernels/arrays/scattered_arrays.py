"""Phased arrays off any lattice: pairs of elements from lists for the cell of a sample.

The pair (k, l) contributes to W(x, nu) what the element alone has at x less the pair's midpoint,
and to A(upsilon, xi) what it has at xi less its difference (docs/theory.md, (L1), (L2)). Of the n^2
pairs those within the element's size of x (or xi) matter. Cells of about that size list them: what
a sample costs grows linearly with the number of elements, if their density stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture, automean
from polywigner.illumination import Array
from polywigner.kernels.arrays.pair_lists import PairLists, pair_lists, sum_over_pairs
from polywigner.kernels.arrays.repeated import (
    ElementSum,
    ElementTables,
    RepeatedTables,
    ambiguity,
    at_both_ends,
    element_tables,
    field,
    wigner,
)
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
from polywigner.plans import sums_over_places

__all__ = [
    "AMBIGUITY",
    "AUTOCORRELATION",
    "LAG_MARGINAL",
    "POSITION_MARGINAL",
    "WIGNER",
    "ScatterFrame",
    "ScatterTables",
    "is_scattered",
    "pairs_by_difference",
    "pairs_by_mean",
    "sites_of",
]

Vector = tuple[float, float]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ScatterFrame:
    """The element's frame, moved to the middle of the array."""

    element: Frame
    middle: Vector
    """Middle of the elements' frames."""
    exact_middle: tuple[phases.Doubled, ...]

    @property
    def content(self) -> float:
        return self.element.content

    @property
    def carrier(self) -> tuple[float, ...]:
        return self.element.carrier


@dataclass(frozen=True)
class ScatteredSites:
    """The pairs by cells, and the elements."""

    lists: PairLists
    elements: tuple[tuple[float, ...], ...]
    """Place in the frame, as two floats a component, and weight, of each."""


ScatterTables = RepeatedTables[ScatteredSites]


def is_scattered(array: Array) -> bool:
    """Whether an array is one element, repeated at enough places."""
    phased = array.phased
    if phased is None or phased.repeated is None:
        return False
    return isinstance(phased.repeated[0], Aperture) and sums_over_places(len(array))


def _parts_of(array: Array) -> tuple[Aperture, Floats, NDArray[np.complex128]]:
    """The element, positions and weights of a scattered array."""
    phased = array.phased
    assert phased is not None and phased.repeated is not None
    element, positions = phased.repeated
    assert isinstance(element, Aperture)
    return element, positions, phased.weights


@dataclass(frozen=True, eq=False)
class _Sites:
    """The elements in the frame, relative to the middle, and their weights less the carrier."""

    frame: ScatterFrame
    tables: ElementTables
    places: Floats
    offsets: Floats
    """In the user's unit, from the middle."""
    weights: NDArray[np.complex128]


@lru_cache(maxsize=32)
def sites_of(array: Array, double: bool) -> _Sites:
    element, positions, weights = _parts_of(array)
    tables = element_tables(element, double)
    low, high = positions.min(axis=0), positions.max(axis=0)
    centre = np.array(tables.frame.centre)
    shift = low + (high - low) / 2
    offsets = positions - shift
    # fields are held relative to the element's carrier, which is counted with all of x or xi
    turns = positions @ np.array(tables.frame.carrier)
    weights = weights * np.exp(-2j * np.pi * (turns - np.rint(turns)))
    middle = shift + centre
    frame = ScatterFrame(
        tables.frame,
        (float(middle[0]), float(middle[1])),
        tuple(phases.doubled(float(c), double) for c in middle),
    )
    places = tables.frame.vertices(offsets + centre)
    return _Sites(frame, tables, places, offsets, weights)


@lru_cache(maxsize=32)
def pairs_by_mean(array: Array, double: bool) -> ScatterTables:
    """Pairs by their midpoints, each pair once: the other order is conjugate."""
    sites = sites_of(array, double)
    k, m = np.triu_indices(len(sites.places))
    means = (sites.places[k] + sites.places[m]) / 2
    apart = sites.offsets[k] - sites.offsets[m]
    mutual = sites.weights[k] * sites.weights[m].conj() * np.where(k == m, 1.0, 2.0)
    element, _, _ = _parts_of(array)
    support = np.concatenate([_in(sites, ring) for ring in automean(element).rings])
    return _tables(sites, means, apart, mutual, support, double)


@lru_cache(maxsize=32)
def pairs_by_difference(array: Array, double: bool) -> ScatterTables:
    """Pairs by their differences, in both orders."""
    sites = sites_of(array, double)
    k, m = (index.ravel() for index in np.indices((len(sites.places),) * 2))
    apart = sites.places[k] - sites.places[m]
    means = (sites.offsets[k] + sites.offsets[m]) / 2
    mutual = sites.weights[k] * sites.weights[m].conj()
    element, _, _ = _parts_of(array)
    outline = np.concatenate([_in(sites, ring) for ring in element.rings])
    spread = np.ptp(outline, axis=0)
    return _tables(sites, apart, means, mutual, np.stack([-spread, spread]), double)


def _in(sites: _Sites, ring: Floats) -> Floats:
    return sites.tables.frame.vertices(ring)


def _tables(
    sites: _Sites,
    centres: Floats,
    others: Floats,
    mutual: NDArray[np.complex128],
    support: Floats,
    double: bool,
) -> ScatterTables:
    high, rest = _split(centres, double)
    records = np.column_stack(
        [high[:, 0], rest[:, 0], high[:, 1], rest[:, 1], others, mutual.real, mutual.imag]
    )
    lists = pair_lists(centres, support, records)
    place, below = _split(sites.places, double)
    rows = np.column_stack(
        [place[:, 0], below[:, 0], place[:, 1], below[:, 1], sites.weights.real, sites.weights.imag]
    )
    table = tuple(tuple(row) for row in rows.tolist())
    found = ScatteredSites(lists, table)
    terms = len(sites.places)
    return RepeatedTables(sites.frame, sites.tables, found, terms)


def _split(values: Floats, double: bool) -> tuple[Floats, Floats]:
    """Numbers as the sum of a float of the kernel's and the rest."""
    if double:
        return values, np.zeros_like(values)
    high = values.astype(np.float32).astype(np.float64)
    return high, values - high


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
