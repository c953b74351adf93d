"""Elements off any lattice, and the pairs of them by midpoint and by difference, in cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Aperture, automean
from polywigner.illumination import Array
from polywigner.kernels.arrays.pair_lists import PairLists, pair_lists
from polywigner.kernels.arrays.repeated import RepeatedTables
from polywigner.kernels.functions.elements import ElementTables, element_tables
from polywigner.kernels.outline.frame import Frame
from polywigner.numerics import phases
from polywigner.plans import sums_over_places

__all__ = [
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
