"""Sections and overlaps of fields that are sums of plane waves (docs/projections.md, (P16)).

A wave only shifts the frequency at which the transform of a section, or of an overlap, is taken,
and multiplies it with a phase: what :mod:`sections` computes once per element is taken once per
wave, or once per pair of waves. Waves (or pairs) that shift by the same are taken together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polywigner.transforms.fields import PlaneField
from polywigner.transforms.sections import (
    Overlaps,
    Sections,
    overlap_spectra,
    section_lengths,
    section_spectra,
    sections,
)

__all__ = ["Pairing", "column_integrals", "column_spectra", "mutual_spectra"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

Pairing = Callable[[Array, Array], tuple[Array, Array]]
"""From the frequencies (m, 2) of the first and (m, 2) of the second wave of m pairs to a shift, to
subtract from the frequency of the overlap's transform (m, 2), and cycles (m, r) along r
coordinates."""

# Shifts that agree to this share of the largest are one: sums of the same terms in another order.
_EQUAL = 1e-12


def column_spectra(field: PlaneField, x: Array, nu: Array) -> Complex:
    """(n, m): the field's transform along y at abscissae x (n,), but for the centre's phase."""
    total = np.zeros((len(x), len(nu)), np.complex128)
    for own, found in _by_wave(field, x):
        total += section_spectra(found, nu - own)
    return total


def column_integrals(field: PlaneField, x: Array) -> NDArray[np.float64] | Complex:
    """(n,): the integral of the field along y at abscissae x (n,); real of real weights."""
    if not field.is_lit:
        return section_lengths(sections(field, x))
    return column_spectra(field, x, np.zeros(1))[:, 0]


def _by_wave(field: PlaneField, x: Array) -> list[tuple[float, Sections]]:
    """Frequencies along y, and the sections with the fields of all waves that have this one."""
    found = sections(field, x)
    if not field.is_lit:
        return [(0.0, found)]
    place = (x - field.centre[0])[found.row]
    weights: dict[float, Complex] = {}
    for k in range(len(field.outlines)):
        own = np.flatnonzero(found.element == k)
        amplitudes, frequencies = field.waves(k)
        for amplitude, (along, across) in zip(amplitudes, frequencies.tolist(), strict=True):
            weight = weights.setdefault(across, np.zeros(len(found.row), np.complex128))
            weight[own] += found.weight[own] * amplitude * np.exp(2j * np.pi * along * place[own])
    return [(across, replace(found, weight=weight)) for across, weight in weights.items()]


def mutual_spectra(
    field: PlaneField, found: Overlaps, nu: Array, places: Array, pairing: Pairing
) -> Complex:
    """(rows, m): the sum over all pairs of waves of the overlaps' transforms at (nu, 0).

    ``places``: (rows, r), what the phase of a pair runs along; see ``Pairing``.
    """
    if not field.is_lit:
        return overlap_spectra(found, nu)
    total = np.zeros((found.count, len(nu)), np.complex128)
    for own, first, second in _by_pair(found, len(field.outlines)):
        (one, ahead), (other, behind) = field.waves(first), field.waves(second)
        i, j = (index.ravel() for index in np.indices((len(one), len(other))))
        shifts, rates = pairing(ahead[i], behind[j])
        amplitudes = one[i] * other[j].conj()
        for shift, members in _groups(shifts):
            envelope = np.exp(2j * np.pi * (places @ rates[members].T)) @ amplitudes[members]
            lit = replace(own, weight=own.weight * envelope[own.row])
            total += overlap_spectra(lit, nu - shift[0], -shift[1])
    return total


def _by_pair(found: Overlaps, elements: int) -> Iterator[tuple[Overlaps, int, int]]:
    """The overlaps of every pair of elements that has some."""
    pair = found.first * elements + found.second
    for number in np.unique(pair).tolist():
        own = np.flatnonzero(pair == number)
        first, second = divmod(number, elements)
        part = replace(found, row=found.row[own], begin=found.begin[own], end=found.end[own])
        part = replace(part, first=found.first[own], second=found.second[own])
        yield replace(part, weight=found.weight[own]), first, second


def _groups(shifts: Array) -> Iterator[tuple[list[float], NDArray[np.intp]]]:
    """Shifts that are equal but for rounding, and which."""
    unit = _EQUAL * max(float(np.abs(shifts).max()), np.finfo(np.float64).tiny / _EQUAL)
    _, number = np.unique(np.round(shifts / unit), axis=0, return_inverse=True)
    for k in range(number.max() + 1):
        members = np.flatnonzero(number.ravel() == k)
        yield shifts[members].mean(axis=0).tolist(), members
