"""Beyond the reach of the kernels: places and frequencies near the largest float, and huge waves.

Kernels multiply frequencies, places and sizes, and products of finite numbers may overflow, which
shows as NaN. There, and only there, values are found again here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits, Wavefront
from polywigner.geometry.exact import whole_numbers
from polywigner.geometry.rings import LARGEST_COORDINATE
from polywigner.illumination import Array
from polywigner.illumination.array import repeated_element
from polywigner.illumination.lattices import Sites
from polywigner.illumination.support import moved_source
from polywigner.kernels.arrays.element_pairs import is_scattered
from polywigner.kernels.arrays.lattice_arrays import is_on_lattice

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Beyond twice the largest coordinate nothing is lit; and a frequency of so many cycles across a
# source leaves a transform no larger than 1e-100 of the content.
_FARTHEST = 4 * LARGEST_COORDINATE
_MOST_CYCLES = 1e100
# Elements so many of their sizes apart have a few digits of their distance left ...
_WIDEST = 1e12
# ... and cells for lists of pairs can be counted.
_WIDEST_LISTED = 1e7
# exp of more overflows; of less underflows.
_LARGEST_EXPONENT = math.log(np.finfo(np.float64).max)
# Cycles at which a transform has about its asymptotic form and signs, and neither its square nor,
# of the second, its largest wave leaves the floats.
_CYCLES_TRIED = (1e60, 50.0)
# Cycles beyond which F itself underflows before its wave is put back.
_UNDERFLOW = 1e50


@lru_cache(maxsize=64)
def is_wide(array: Array, limit: float = _WIDEST) -> bool:
    """Whether elements are too far apart, in units of the smallest, to share one frame."""
    if array.repeated is not None:
        element, positions = array.repeated
        extent, size = float(np.ptp(positions, axis=0).max()), element.diameter
    else:
        low, high = np.reshape(array.bounds, (2, -1))
        extent = float((high - low).max())
        size = min(element.diameter for element in array.elements_in_plane)
    return extent > limit * size


def check_width(array: Array) -> None:
    """Raise GeometryError for an array whose elements are too far apart for W, A and R."""
    limit = _WIDEST
    if is_scattered(array) and not is_on_lattice(array):
        limit = _WIDEST_LISTED
    if is_wide(array, limit):
        raise GeometryError(
            f"expected elements within {limit:g} of their size of each other, got an array that "
            "is wider; fourier and array_factor take it"
        )


def within_reach(
    source: Any, points: list[tuple[str, Floats]], values: Any
) -> tuple[NDArray[np.bool_], list[Floats]] | None:
    """Where values of finite points are NaN, and the nearest points that have the same values.

    None where there are none. `points`: names and arrays (..., d) that broadcast. Places move to
    where nothing is lit all the same, frequencies to where the transform is 0 all the same.
    """
    missing = np.isnan(values)
    if not missing.any():
        return None
    shape = np.broadcast_shapes(*(p.shape[:-1] for _, p in points))
    full = [np.broadcast_to(p, (*shape, p.shape[-1])) for _, p in points]
    missing = np.asarray(missing & np.all([np.isfinite(p).all(axis=-1) for p in full], axis=0))
    if not missing.any():
        return None
    most = _MOST_CYCLES / _size(source)
    limits = [most if what in ("nu", "upsilon") else _FARTHEST for what, _ in points]
    return missing, [
        np.clip(p[missing].astype(np.float64), -limit, limit)
        for p, limit in zip(full, limits, strict=True)
    ]


def _size(source: Any) -> float:
    return float(np.abs(corners_of(source)).max())


def corners_of(source: Any) -> Floats:
    """All vertices (n, d) of a source, ends of slits, or vertices of an Array's elements."""
    if isinstance(source, Slits):
        return source.intervals.reshape(-1, 1)
    if isinstance(source, Polyhedron):
        return source.vertices
    if isinstance(source, PlacedAperture):
        return corners_of(source.aperture) @ source.pose[:3, :2].T + source.pose[:3, 3]
    if isinstance(source, Wavefront):
        return corners_of(source.source)
    if isinstance(source, Aperture):
        return np.concatenate(source.rings)
    if source.repeated is not None:
        element, positions = source.repeated
        own = corners_of(element)
        return np.asarray(positions[:, None] + own).reshape(-1, own.shape[1])
    corners = [corners_of(element) for element in source.elements]
    widest = max(c.shape[1] for c in corners)
    return np.concatenate([np.pad(c, ((0, 0), (0, widest - c.shape[1]))) for c in corners])


def out_of_floats(source: Any, nu: Complex, values: Any) -> NDArray[np.bool_]:
    """Where values at complex nu (..., d) are NaN, or 0 for want of range; not for bad nu."""
    lost = np.isnan(values)
    zero = values == 0
    if zero.any() and not isinstance(source, Sites):
        lost = lost | (zero & (np.abs(nu.imag).max(axis=-1) * _size(source) > _UNDERFLOW))
    return np.asarray(lost & np.isfinite(nu).all(axis=-1))


def largest_wave_apart(source: Any, nu: Complex, evaluate: Callable[[Any, Any], Any]) -> Complex:
    """F at complex nu (n, d) where waves on the source leave the floats.

    F of the source moved so that the largest wave is at the origin, and 1 there, times that wave:
    infinite, with the signs of its parts, where a float cannot hold the product. `evaluate`:
    (source, nu) -> F.
    """
    corners = corners_of(source)
    values = np.empty(len(nu), np.complex128)
    size = np.maximum(np.abs(nu.real), np.abs(nu.imag)).max(axis=-1)
    largest = np.argmax((nu.imag / size[:, None]) @ corners.T, axis=-1)
    for corner in np.unique(largest).tolist():
        here, moved = np.flatnonzero(largest == corner), _moved(source, corner)
        bounded = np.zeros(len(here), np.complex128)
        for cycles in _CYCLES_TRIED:  # along a direction F falls off, with the same signs
            lost = (bounded == 0) | np.isnan(bounded)
            scale = np.minimum(1.0, cycles / _size(source) / size[here[lost]])
            bounded[lost] = evaluate(moved, nu[here[lost]] * scale[:, None])
        for k, value in zip(here.tolist(), bounded.tolist(), strict=True):
            values[k] = _times_wave(value, nu[k], corners[corner])
    return values


def array_factor_apart(sites: Sites, nu: Complex) -> Complex:
    """The array factor at nu (n, d), complex or real, with exact phases and the largest wave apart.

    For nu at which waves or phases leave the floats; infinite where a float cannot hold it.
    """
    values = np.empty(len(nu), np.complex128)
    for k, frequency in enumerate(nu):
        size = max(float(np.abs(frequency.imag).max()), np.finfo(float).tiny)
        levels = sites.positions @ (frequency.imag / size)
        origin = sites.positions[int(np.argmax(levels))]
        with np.errstate(over="ignore"):
            sizes = np.exp(2 * np.pi * ((levels - levels.max()) * size))
        turns = _exact_turns(frequency.real, sites.positions - origin)
        bounded = complex((sites.weights * sizes) @ np.exp(-2j * np.pi * turns))
        values[k] = _times_wave(bounded, frequency, origin)
    return values


def _exact_turns(frequency: Floats, places: Floats) -> Floats:
    """frequency.place modulo 1 of each place (n, d)."""
    (nu, nu_exponent), (x, x_exponent) = whole_numbers(frequency), whole_numbers(places)
    turn = 1 << max(0, -(nu_exponent + x_exponent))
    whole = (x @ nu) << max(0, nu_exponent + x_exponent)
    return np.asarray(((whole + turn // 2) % turn - turn // 2) / turn, dtype=np.float64)


def _moved(source: Any, corner: int) -> Any:
    """The source with one of its corners, by its number, at the origin."""
    if isinstance(source, Array) and source.repeated is not None:
        element, positions = source.repeated
        own = corners_of(element)
        k, m = divmod(corner, len(own))
        return repeated_element(element.moved(-own[m]), positions - positions[k], source.weights)
    origin = corners_of(source)[corner]
    return moved_source(source, -origin)


def _times_wave(value: complex, frequency: Complex, origin: Floats) -> complex:
    """value exp(-2 pi i nu.origin), the exponent and the turns exact."""
    place = [Fraction(x) for x in origin.tolist()]
    growth = sum(Fraction(f) * x for f, x in zip(frequency.imag.tolist(), place, strict=True))
    turns = sum(Fraction(f) * x for f, x in zip(frequency.real.tolist(), place, strict=True))
    angle = -2 * math.pi * float(turns - round(turns))
    turned = value * complex(math.cos(angle), math.sin(angle))
    if turned == 0 or not np.isfinite(turned):
        return turned
    exponent = 2 * math.pi * float(min(max(growth, Fraction(-(10**6))), Fraction(10**6)))
    parts = (_grown(turned.real, exponent), _grown(turned.imag, exponent))
    return complex(*parts)


def _grown(part: float, exponent: float) -> float:
    """part exp(exponent)."""
    if part == 0:
        return part
    total = exponent + math.log(abs(part))
    size = math.inf if total > _LARGEST_EXPONENT else math.exp(total)
    return math.copysign(size, part)
