"""Points of a grid that radiate as a source does, from some wavelengths on. Source: (B8)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import IlluminationError
from polywigner.illumination.obliquities import Obliquity, times_direction_cosine
from polywigner.propagation.panels import Radiator
from polywigner.transforms import fourier

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Nodes a wavelength that are always needed, and most beyond these.
_PITCH, _MOST_MORE = 1.5, 24
# The far field is compared at so many directions for each node's length, and so many more.
_DIRECTIONS, _MORE_DIRECTIONS = 4.0, 24


@dataclass(frozen=True)
class EquivalentGrid:
    """Gauss nodes over the bounds of a source. Lengths in wavelengths, from its middle."""

    nodes: tuple[Floats, Floats]
    """Along x and y, as shares of half the sides."""
    half: Floats
    """Half the sides (2,)."""
    weights: tuple[Complex, ...]
    """(nx, ny) each, in units of u times a square wavelength: for the field's share of the
    obliquity and for its slope's, as far as there are any."""


def equivalent_grid(
    source: Any,
    radiator: Radiator,
    wavelength: float,
    condition: Obliquity,
    error: float,
    allowed: Callable[[Sequence[int]], bool],
) -> EquivalentGrid | None:
    """Return the smallest grid whose |F|^2 is within ``error`` of its peak.

    None where ``allowed`` refuses the numbers of nodes along x and y.
    """
    fields = [(source, condition.field)] if condition.field else []
    if condition.slope:
        with suppress(IlluminationError):  # all waves graze the plane: their cosines are zero
            fields.append((times_direction_cosine(source, wavelength), condition.slope))
    if not fields:
        return None
    half = (radiator.high - radiator.low) / (2 * wavelength)
    sines = [
        np.cos(math.pi * (np.arange(n) + 0.5) / n)
        for n in (math.ceil(2 * _DIRECTIONS * h) + _MORE_DIRECTIONS for h in half)
    ]
    spectra: list[Complex] = []
    for more in range(1, _MOST_MORE):
        counts = [math.ceil(2 * _PITCH * h) + more for h in half]
        if not allowed(counts):
            return None
        # not before it is known that there are few
        spectra = spectra or [
            part * _spectrum(field, sines, radiator.centre, wavelength) for field, part in fields
        ]
        x, y = (np.polynomial.legendre.leggauss(n)[0] for n in counts)
        weights = [_fitted(s, sines, (half[0] * x, half[1] * y), error) for s in spectra]
        if all(found is not None for found in weights):
            return EquivalentGrid((x, y), half, tuple(w for w in weights if w is not None))
    return None


def _spectrum(field: Any, sines: list[Floats], middle: Floats, wavelength: float) -> Complex:
    """The far field in units of a square wavelength, seen from the middle."""
    nu = np.stack(np.meshgrid(*sines, indexing="ij"), axis=-1) / wavelength
    return fourier(field, nu) * np.exp(2j * math.pi * (nu @ middle)) / wavelength**2


def _fitted(
    spectrum: Complex, sines: list[Floats], places: tuple[Floats, Floats], error: float
) -> Complex | None:
    """The weights of a grid of places with this far field; None if they miss it."""
    waves = [np.exp(-2j * math.pi * np.outer(s, x)) for s, x in zip(sines, places, strict=True)]
    # singular values of plane waves at the nodes that are rounding
    first, second = (np.linalg.pinv(wave, rcond=min(1e-9, 1e-4 * error)) for wave in waves)
    weights = first @ spectrum @ second.T
    found = waves[0] @ weights @ waves[1].T
    seen = np.add.outer(sines[0] ** 2, sines[1] ** 2) <= 1.0
    expected = np.abs(spectrum[seen]) ** 2
    missed = np.abs(np.abs(found[seen]) ** 2 - expected).max()
    return weights if missed <= error * expected.max() else None
