"""Light of a source in a scene: terms of its radiance, mixtures of waves, power and region."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from polywigner.errors import PolywignerError, SceneError
from polywigner.geometry import Aperture, PlacedAperture, Slits, Wavefront
from polywigner.geometry.parts import union_on_grid
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
from polywigner.reception.norms import NORMALISATIONS
from polywigner.source import Array
from polywigner.source.normal_form import normal_form
from polywigner.source.obliquities import (
    OBLIQUITIES,
    Forms,
    grazing_error,
)
from polywigner.source.support import mutual_support
from polywigner.transforms import fourier
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.wavefronts import checked_wavefront, flat_of, tilts_of

Floats = npt.NDArray[np.float64]
SceneSource = Aperture | Array | Wavefront
"""A source that can radiate in a scene."""


def checked_name(kind: str, name: str, known: Iterable[str]) -> str:
    """Return ``name``, or raise a SceneError that lists the known names; ``kind``: "a sampling"."""
    if name not in known:
        raise SceneError(f"expected {kind}, got {name!r}; use one of {', '.join(known)}")
    return name


def depends_on_wavelength(source: Any, name: str) -> bool:
    """Whether `emissions` do: if the directions of waves matter and there are oblique ones."""
    waves = normal_form(flat_of(source)).frequencies
    return OBLIQUITIES[name].needs_normal_derivative and bool(waves.any())


def emissions(source: Any, wavelength: float, name: str) -> list[tuple[SceneSource, Forms]]:
    """Sources whose W, each times h of its forms, add up to the radiance times wavelength^2."""
    check_slopes(source, checked_name("an obliquity", name, OBLIQUITIES))
    found = OBLIQUITIES[name].terms(flat_of(source), wavelength)
    if not any(any(forms) for _, forms in found):
        raise grazing_error(wavelength)
    if isinstance(source, Wavefront):
        return [(source.on(one), forms) for one, forms in found]
    return found


# Error of means over tilts and wavelengths, relative to the largest value.
_ERROR = 1e-7
# Relative error of the mean power, and the largest lag in wavelengths: the power is an integral of
# the correlation times an oscillating, decaying transform of g. Measured error for two slits and
# squares of 0.5 to 100 wavelengths, coherence widths of 0.3 to 30: at most 2e-5 of the power.
_OF_POWER, _LONGEST = 1e-5, 4.0
# Values of F in a block: 16 MB.
_BLOCK = 1 << 20


@dataclass(frozen=True)
class Mixture:
    """The width of coherence and the bandwidth of a source."""

    coherence_width: float = math.inf
    """In m; infinite: coherent."""
    bandwidth: float | None = None
    """In Hz, of the light; None: one wavelength."""

    def __str__(self) -> str:
        parts = []
        if self.coherence_width < math.inf:
            parts.append(f"a source that is coherent over {self.coherence_width:g} m")
        if self.bandwidth is not None:
            parts.append(f"a bandwidth of {self.bandwidth:g} Hz")
        return " and ".join(parts) or "coherent light of one wavelength"

    @property
    def is_plain(self) -> bool:
        """Whether it is no mixture: coherent light of one wavelength."""
        return self.coherence_width == math.inf and self.bandwidth is None

    def parts(
        self, source: Any, wavelength: float, error: float = _ERROR
    ) -> Iterator[tuple[SceneSource, float, float]]:
        """Coherent sources, wavelengths in m, and weights, whose mean is the mixture."""
        wave = source
        if self.coherence_width < math.inf:
            wave = source.partially_coherent(self.coherence_width)
        return mixture_parts(wave, wavelength, self.bandwidth, error)

    def nodes(self, source: Any, wavelength: float) -> Floats:
        """Waves (n, 4) of the coherent ``source`` whose mean power is the mixture's.

        Difference of the inverse wavelength, tilts along x and y, all in 1/m, and weights.
        """
        tilts, shares = np.zeros((1, 2)), np.ones(1)
        if self.coherence_width < math.inf:
            wave = source.partially_coherent(self.coherence_width)
            tilts, shares = tilts_of(wave, _OF_POWER, _LONGEST * wavelength)
        band = [(wavelength, 1.0)]
        if self.bandwidth is not None:
            band = wavelengths_of_band(wavelength, self.bandwidth, longest_path(source), _OF_POWER)
        return np.array(
            [
                (1 / length - 1 / wavelength, *tilt, share * weight)
                for tilt, share in zip(tilts.tolist(), shares.tolist(), strict=True)
                for length, weight in band
            ]
        )

    def power(self, source: Any, wavelength: float, obliquity: str) -> float:
        """Radiated power in W of the coherent ``source`` in light of this mixture."""
        waves = self.nodes(source, wavelength)
        return sum(
            self._power_at(source, wavelength, obliquity, waves[waves[:, 0] == change])
            for change in np.unique(waves[:, 0])
        )

    def _power_at(self, source: Any, wavelength: float, obliquity: str, waves: Floats) -> float:
        """Part of the power of :meth:`nodes` (n, 4) with one wavelength."""
        inverse = 1 / wavelength + waves[:, 0]
        lit = source.at_wavelength(1 / inverse[0])
        fields = OBLIQUITIES[obliquity].terms(lit, wavelength)
        total = 0.0
        for s, solid_angle in directions_and_weights(largest_lag(source), 1 / inverse.max()):
            step = max(1, _BLOCK // len(s))
            for first in range(0, len(waves), step):
                some = slice(first, first + step)
                nu = s[:, :2] * inverse[some, None, None] - waves[some, None, 1:3]
                weights = waves[some, 3] * inverse[some] ** 2
                for one, forms in fields:
                    g = forms.irradiance(s[:, 2])
                    far = np.square(np.abs(fourier(one, nu)))
                    total += float(weights @ far @ (g * solid_angle))
        return total


PLAIN = Mixture()
"""Coherent light of one wavelength."""


def mixture_of(
    source: Any, wavelength: float, bandwidth: float | None = None
) -> tuple[SceneSource, Mixture]:
    """The source in coherent light, and the mixture that its light is; ``bandwidth`` in Hz."""
    try:
        if bandwidth is not None:
            bandwidth = checked_bandwidth(bandwidth, wavelength)
    except PolywignerError as error:
        raise SceneError(str(error)) from None
    if bandwidth is not None and getattr(flat_of(source), "paths", None) is not None:
        raise SceneError(
            "pistons and tilts of segments are not supported with a bandwidth in scenes; compute "
            "wavelengths one by one, or use polywigner.irradiance(bandwidth=)"
        )
    if not isinstance(source, Wavefront) or source.is_coherent:
        return source, Mixture(bandwidth=bandwidth)
    return source.coherent, Mixture(source.coherence_width, bandwidth)


UNPOLARISED = "unpolarised"
"""Value of ``polarisation`` for unpolarised light, and for receivers of all polarisations."""


# Read when an entry is made, when its scene is loaded, and whenever a parameter changes.
@lru_cache(maxsize=64)
def norm_of(
    source: Any,
    wavelength: float,
    obliquity: str,
    mixture: Mixture = PLAIN,
    normalise: str = NORMALISATIONS[0],
) -> float:
    """Return the power of a source's field in W for |u|^2 in W/m^2, as ``normalise`` counts it.

    ``radiated``: the power through the hemisphere in front, with the obliquity and the mean over
    the waves of a mixture. ``aperture``: int |u|^2.

    Raises SceneError for a source that radiates nothing.
    """
    if normalise == "aperture":
        return _energy(source)
    try:
        radiator = checked_radiator(source)
        if mixture.is_plain:
            return powers_of(radiator, wavelength, obliquity)[0]
        return mixture.power(radiator, wavelength, obliquity)
    except PolywignerError as error:
        raise SceneError(str(error)) from None


def _energy(source: Any) -> float:
    """int |u|^2 dx, in m^2 for fields of unit 1."""
    source = flat_of(source)
    if isinstance(source, Aperture) and source.illumination is None:
        return source.area
    energy = energy_of(source)
    if not energy > 0:
        raise SceneError(
            "expected a source with a field, got elements that cancel each other everywhere"
        )
    return energy


# ---- the region that radiates -------------------------------------------------------------------

# Three samples of a shorter row cost more than the few midpoints that they cancel.
_LEAST_SHIFTED = 4


class Region(NamedTuple):
    """The region of the plane where W of a source is not zero, for the samples of positions."""

    centre: Floats
    """(2,) in m, read-only."""
    support: Aperture
    """Outline relative to the centre."""
    shifts: Floats
    """(k, 3), read-only: a sample of a position stands for the positions at the shifts (x, y), with
    weights that add up to 1."""


def unfit_source(source: Any) -> SceneError:
    """Return the error for a source that cannot radiate in a scene."""
    advice = "make one with polywigner.Aperture(vertices)"
    if isinstance(source, PlacedAperture):
        advice = "leave its pose out, and give it as the to_world of the shape"
    elif isinstance(source, Slits):
        advice = "make rectangles of slits"
    return SceneError(f"expected an Aperture or an Array, got {type(source).__name__}; {advice}")


def region_of(source: Any, obliquity: str, antithetic: bool = False) -> Region:
    """Return the region of an aperture, or of an array of apertures in the plane z = 0.

    Raises SceneError for a source that cannot radiate in a scene.
    """
    if not isinstance(flat_of(source), Aperture | Array):
        raise unfit_source(source)
    checked_name("an obliquity", obliquity, OBLIQUITIES)
    try:
        check_slopes(source, obliquity)
        if isinstance(source, Wavefront):
            source = checked_wavefront(source).source
        return _region(source, antithetic)
    except PolywignerError as error:
        raise SceneError(str(error)) from None


# A scene entry is checked when it is made, and read when the scene is loaded.
@lru_cache(maxsize=16)
def _region(source: Aperture | Array, antithetic: bool) -> Region:
    _energy(source)  # or its error
    shifts = _half_pitches(source) if antithetic else np.array([[0.0, 0.0, 1.0]])
    shifts.setflags(write=False)
    support = mutual_support(source)
    if len(shifts) > 1:
        support = Aperture(
            union_on_grid([support.moved(-shift).polygons for shift in shifts[:, :2]])
        )
    return Region(support.centre, support.moved(-support.centre), shifts)


def _half_pitches(source: Aperture | Array) -> Floats:
    """Return (k, 3) shifts by half a pitch along each direction of a lattice, and weights.

    W of a lattice of elements is concentrated about the midpoints of pairs, half a pitch apart. Off
    the beams its sign alternates between midpoints, and its size grows evenly towards the centre
    with the number of pairs. Second differences, 1/4, 1/2, 1/4, cancel nearly all of it.
    """
    result = np.array([[0.0, 0.0, 1.0]])
    copies = normal_form(source).lattice
    lattice = None if copies is None else copies.sites
    if lattice is None:
        return result
    for count, pitch in zip(lattice.weights.shape, lattice.basis, strict=True):
        if count >= _LEAST_SHIFTED:
            steps = np.outer([-0.5, 0.0, 0.5], [*pitch, 0.0])
            steps[:, 2] = 0.25, 0.5, 0.25
            positions = result[:, None, :2] + steps[:, :2]
            weights = result[:, None, 2:] * steps[:, 2:]
            result = np.concatenate([positions, weights], axis=-1).reshape(-1, 3)
    return result
