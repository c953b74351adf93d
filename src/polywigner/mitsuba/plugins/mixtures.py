"""Partially coherent and broadband sources in scenes, their radiance and their power."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from polywigner.errors import SceneError
from polywigner.geometry import Aperture, Wavefront
from polywigner.mitsuba.plugins.registration import scene_errors, unsuitable_source
from polywigner.numerics import Floats
from polywigner.propagation.far_fields import check_slopes, powers_of
from polywigner.propagation.irradiances import mixture_parts
from polywigner.radiometry.directions import (
    checked_bandwidth,
    checked_radiator,
    directions_and_weights,
    largest_lag,
    longest_path,
    wavelengths_of_band,
)
from polywigner.reception.couplings import NORMALISATIONS
from polywigner.source import Array
from polywigner.source.array import mutual_support
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import OBLIQUITIES, Forms, grazing_error
from polywigner.transforms import fourier
from polywigner.transforms.public_transforms import energy_of
from polywigner.transforms.wavefronts import flat_source, tilts_of

SceneSource = Aperture | Array | Wavefront
"""A source that can radiate in a scene."""


def depends_on_wavelength(source: SceneSource, obliquity: str) -> bool:
    """Return whether the terms of `emissions` depend on the wavelength."""
    waves = normal_form(flat_source(source)).frequencies
    return OBLIQUITIES[obliquity].needs_normal_derivative and bool(waves.any())


def emissions(
    source: SceneSource, wavelength: float, obliquity: str
) -> list[tuple[SceneSource, Forms]]:
    """Return the source and the obliquity factor h of each term of a source's radiance.

    The sum of h times the Wigner function over all terms is the radiance times the square of the
    wavelength. Raises IlluminationError if all waves graze the plane of the source.
    """
    check_slopes(source, obliquity)
    terms = OBLIQUITIES[obliquity].terms(flat_source(source), wavelength)
    if not any(any(forms) for _, forms in terms):
        raise grazing_error(wavelength)
    if isinstance(source, Wavefront):
        return [(source.on(flat), forms) for flat, forms in terms]
    return terms


# Relative tolerance of the power of partially coherent and broadband sources. The measured error is
# at most 2e-5.
_POWER_ERROR = 1e-5
# Largest spatial lag in the power integral [wavelengths].
_LONGEST_LAG = 4.0


@dataclass(frozen=True)
class Mixture:
    """Coherence width and bandwidth of a source."""

    coherence_width: float = math.inf
    """Coherence width in m, or infinity for coherent light."""
    bandwidth: float | None = None
    """Bandwidth of the light in Hz, or None for a single wavelength."""

    def __str__(self) -> str:
        parts = []
        if self.coherence_width < math.inf:
            parts.append(f"a coherence width of {self.coherence_width:g} m")
        if self.bandwidth is not None:
            parts.append(f"a bandwidth of {self.bandwidth:g} Hz")
        return " and ".join(parts) or "coherent light of one wavelength"

    @property
    def is_plain(self) -> bool:
        """Whether the light is coherent and has a single wavelength."""
        return self == Mixture()

    def parts(
        self, source: SceneSource, wavelength: float, error: float = 1e-7
    ) -> Iterator[tuple[SceneSource, float, float]]:
        """Yield coherent sources, their wavelengths in m and their weights.

        The weighted mean of their irradiances is the irradiance of the mixture, with an error of
        ``error`` times the largest irradiance.
        """
        return mixture_parts(self._with_coherence_width(source), wavelength, self.bandwidth, error)

    def nodes(self, source: SceneSource, wavelength: float) -> Floats:
        """Return waves whose weighted mean power is the power of the mixture, shape (n, 4).

        Each row contains the shift of the inverse wavelength, the tilts along x and y (all in 1/m),
        and the weight.
        """
        tilts, weights = np.zeros((1, 2)), np.ones(1)
        wave = self._with_coherence_width(source)
        if isinstance(wave, Wavefront) and not wave.is_coherent:
            tilts, weights = tilts_of(wave, _POWER_ERROR, _LONGEST_LAG * wavelength)
        return np.array(
            [
                (1 / length - 1 / wavelength, *tilt, tilt_weight * weight)
                for tilt, tilt_weight in zip(tilts.tolist(), weights.tolist(), strict=True)
                for length, weight in self._wavelengths(source, wavelength)
            ]
        )

    def power(self, source: Any, wavelength: float, obliquity: str) -> float:
        """Return the power in W that a source of this mixture radiates, with |u|^2 in W/m^2."""
        if self.is_plain:
            return powers_of(source, wavelength, obliquity)[0]
        total = 0.0
        for shift, *tilt, weight in self.nodes(source, wavelength).tolist():
            inverse = 1 / wavelength + shift
            terms = OBLIQUITIES[obliquity].terms(source.at_wavelength(1 / inverse), wavelength)
            for s, solid_angles in directions_and_weights(largest_lag(source), 1 / inverse):
                for term, forms in terms:
                    far = np.square(np.abs(fourier(term, s[:, :2] * inverse - tilt)))
                    scale = weight * inverse**2
                    total += scale * float(far @ (forms.irradiance(s[:, 2]) * solid_angles))
        return total

    def _with_coherence_width(self, source: SceneSource) -> SceneSource:
        """Return a coherent source with the coherence width of this mixture."""
        if self.coherence_width == math.inf:
            return source
        return source.partially_coherent(self.coherence_width)

    def _wavelengths(self, source: SceneSource, wavelength: float) -> list[tuple[float, float]]:
        """Return pairs of a wavelength in m and its weight, which represent the band."""
        if self.bandwidth is None:
            return [(wavelength, 1.0)]
        return wavelengths_of_band(wavelength, self.bandwidth, longest_path(source), _POWER_ERROR)


def mixture_of(
    source: Any, wavelength: float, bandwidth: float | None
) -> tuple[SceneSource, Mixture]:
    """Return the coherent form of a source, and its coherence width and bandwidth."""
    if bandwidth is not None:
        bandwidth = checked_bandwidth(bandwidth, wavelength)
        if getattr(flat_source(source), "paths", None) is not None:
            raise SceneError(
                "pistons and tilts of segments cannot be combined with a bandwidth in scenes; "
                "compute the wavelengths one by one, or use polywigner.irradiance(bandwidth=)"
            )
    if not isinstance(source, Wavefront) or source.is_coherent:
        return source, Mixture(bandwidth=bandwidth)
    return source.coherent, Mixture(source.coherence_width, bandwidth)


# The norm of a source is cached, because it is required three times: to create a scene entry, to
# load the entry, and to change a parameter.
@lru_cache(maxsize=64)
def norm_of(
    source: SceneSource,
    wavelength: float,
    obliquity: str,
    mixture: Mixture = Mixture(),
    normalise: str = NORMALISATIONS[0],
) -> float:
    """Return the power of the unscaled field of a source in W, with |u|^2 in W/m^2.

    If ``normalise`` is "radiated", this power is the mean power radiated into the front hemisphere.
    If ``normalise`` is "aperture", the power is the integral of |u|^2. Raises SceneError if the
    power is zero.
    """
    if normalise == "aperture":
        return _energy(flat_source(source))
    with scene_errors():
        return mixture.power(checked_radiator(source), wavelength, obliquity)


def _energy(source: Aperture | Array) -> float:
    """Return the integral of |u|^2 in m^2; raise SceneError if it is zero."""
    energy = energy_of(source)
    if not energy > 0:
        raise SceneError(
            "the fields of the elements cancel each other everywhere, so the source radiates "
            "nothing; change the weights of the elements"
        )
    return energy


def support_of(source: Any, obliquity: str) -> Aperture:
    """Return the region of the source plane where the Wigner function is not zero."""
    if not isinstance(flat_source(source), Aperture | Array):
        raise unsuitable_source(source)
    with scene_errors():
        check_slopes(source, obliquity)
        return _support(flat_source(source))


# The region is cached, because creating a scene entry and loading the scene both require it.
@lru_cache(maxsize=16)
def _support(source: Aperture | Array) -> Aperture:
    """Return the region where the Wigner function is not zero; raise SceneError without a field."""
    _energy(source)  # Raises SceneError for a source without a field.
    return mutual_support(source)
