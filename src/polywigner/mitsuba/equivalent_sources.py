"""Equivalent point sources of a source: few places that radiate as all of it does. Source: (B8).

What leaves a source is known from its far field: the waves that its transform gives at spatial
frequencies up to 1/wavelength. Points on a grid of Gauss nodes over the bounds of the source, with
weights such that their transform is the same there, radiate the same waves. They take two points
for each wavelength of a side and some more, whatever outline, field or elements are between.
What they do not share with the source are evanescent waves, which decay within three wavelengths.

Lengths are in wavelengths, relative to the middle of the source.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import IlluminationError
from polywigner.illumination.obliquities import Obliquity, times_direction_cosine
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.phases import cos_sin_turns
from polywigner.plans.cuts import sums_over_points
from polywigner.propagation.panels import Radiator
from polywigner.transforms import fourier

__all__ = ["AWAY", "EquivalentSources", "equivalent_sources"]

Floats = NDArray[np.float64]

AWAY = 3.0
"""Nearest distance from the bounds of the source in wavelengths. Measured before squares, an L,
chevrons, tapers and arrays of up to 10 wavelengths, |U|^2 was within 7e-5 of its peak from there
on, and within 1e-3 at a third of it."""
# Error allowed of |F|^2 over its peak, a seventh of what is promised of |U|^2.
_ERROR = 1.5e-5
# Nodes a wavelength that are always needed, and most beyond these.
_PITCH, _MOST_MORE = 1.5, 24
# The far field is compared at so many directions for each node's length, and so many more.
_DIRECTIONS, _MORE_DIRECTIONS = 4.0, 24
# Singular values of plane waves at the nodes that are rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class EquivalentSources:
    """Points of a grid in the plane of a source, with what they radiate.

    Lines of points are rows of a table, points of a line are code.
    """

    half: tuple[float, ...]
    """Half the sides of the bounds along x and y."""
    along: tuple[float, ...]
    """Places on a line over half its length."""
    lines: tuple[tuple[float, ...], ...]
    """Where a line is; then of each of its points the weights: of the field's share and of its
    slope's, as far as there are any, as real parts or as real and imaginary parts."""
    is_real: bool
    has_field: bool
    is_swapped: bool
    """Whether lines are along x instead of y."""

    def field(self, ops: Any, half: Any, x: Any, y: Any, z: Any) -> tuple[Any, Any]:
        """The field at a point, relative to the phase of the distance from the middle.

        ``half``: as the attribute, of the engine's kind.
        """
        distance = ops.sqrt(x * x + (y * y + z * z))
        length = half[0] if self.is_swapped else half[1]
        aside, along = (y, x) if self.is_swapped else (x, y)
        points = []
        for place in (length * share for share in self.along):
            points.append((along - place, place * (place - 2.0 * along)))

        def line(at: Any, *weights: Any) -> tuple[Any, Any]:
            step = len(weights) // len(points)
            across = aside - at
            foot2, shift = across * across + z * z, at * (at - 2.0 * aside)
            total = Pair(0.0, 0.0)
            for k, (offset, own_shift) in enumerate(points):
                radius = ops.sqrt(offset * offset + foot2)
                # one division for 1/radius, and for the turns over radius + distance
                whole = radius + distance
                both = 1.0 / (radius * whole)
                inverse = whole * both
                wave = Pair(*cos_sin_turns(ops, (shift + own_shift) * (radius * both)))
                own = weights[k * step : (k + 1) * step]
                total = total + self._sent(z * inverse, inverse, wave.scaled(inverse), own)
            return total.real, total.imag

        real, imag = ops.sum_over(self.lines, line, 2, like=x, unroll=False)
        return real, imag

    def _sent(self, cosine: Any, inverse: Any, wave: Pair, weights: tuple[Any, ...]) -> Pair:
        """The waves of one point; of the field with Rayleigh and Sommerfeld's term in 1/(k r)."""
        step = 1 if self.is_real else 2
        waves = []
        for k in range(0, len(weights), step):
            own = wave
            if self.has_field and k == 0:
                near = inverse * (1 / (2 * math.pi))
                own = Pair(wave.real - wave.imag * near, wave.imag + wave.real * near)
                own = own.scaled(cosine)
            waves.append(
                own.scaled(weights[k]) if self.is_real else own * Pair(*weights[k : k + 2])
            )
        return waves[0] if len(waves) == 1 else waves[0] + waves[1]


def equivalent_sources(
    source: Any, radiator: Radiator, wavelength: float, condition: Obliquity, panels: int
) -> EquivalentSources | None:
    """Those of a source; None where a sum over them takes longer than over so many panels."""
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
    spectra: list[NDArray[np.complex128]] = []
    for more in range(1, _MOST_MORE):
        counts = [math.ceil(2 * _PITCH * h) + more for h in half]
        if not sums_over_points(counts, panels):
            return None
        # not before it is known that there are few
        spectra = spectra or [
            part * _spectrum(field, sines, radiator.centre, wavelength) for field, part in fields
        ]
        nodes = [np.polynomial.legendre.leggauss(n)[0] for n in counts]
        places = [h * x for h, x in zip(half, nodes, strict=True)]
        weights = [_fitted(spectrum, sines, places) for spectrum in spectra]
        if all(found is not None for found in weights):
            return _as_lines(
                half, nodes, [w for w in weights if w is not None], bool(condition.field)
            )
    return None


def _as_lines(
    half: Floats, nodes: list[Floats], weights: list[NDArray[np.complex128]], has_field: bool
) -> EquivalentSources:
    """As much code as the shorter side of the grid has points."""
    table = np.stack(weights, axis=-1)
    is_swapped = len(nodes[0]) < len(nodes[1])
    across, along = 0, 1
    if is_swapped:
        table, across, along = np.swapaxes(table, 0, 1), 1, 0
    is_real = bool(np.abs(table.imag).max() < _ROUNDING * np.abs(table).max())
    parts = table.real if is_real else np.stack([table.real, table.imag], axis=-1)
    rows = np.column_stack([half[across] * nodes[across], parts.reshape(len(parts), -1)])
    lines = tuple(map(tuple, rows.tolist()))
    along_ = tuple(nodes[along].tolist())
    return EquivalentSources(tuple(half.tolist()), along_, lines, is_real, has_field, is_swapped)


def _spectrum(
    field: Any, sines: list[Floats], middle: Floats, wavelength: float
) -> NDArray[np.complex128]:
    """The far field in units of a square wavelength, seen from the middle."""
    nu = np.stack(np.meshgrid(*sines, indexing="ij"), axis=-1) / wavelength
    return fourier(field, nu) * np.exp(2j * math.pi * (nu @ middle)) / wavelength**2


def _fitted(
    spectrum: NDArray[np.complex128], sines: list[Floats], places: list[Floats]
) -> NDArray[np.complex128] | None:
    """The weights of a grid of places with this far field; None if they miss it."""
    waves = [np.exp(-2j * math.pi * np.outer(s, x)) for s, x in zip(sines, places, strict=True)]
    first, second = (np.linalg.pinv(wave, rcond=_ROUNDING) for wave in waves)
    weights = first @ spectrum @ second.T
    found = waves[0] @ weights @ waves[1].T
    seen = np.add.outer(sines[0] ** 2, sines[1] ** 2) <= 1.0
    expected = np.abs(spectrum[seen]) ** 2
    missed = np.abs(np.abs(found[seen]) ** 2 - expected).max()
    return weights if missed <= _ERROR * expected.max() else None
