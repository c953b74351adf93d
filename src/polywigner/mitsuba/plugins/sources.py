"""Sources as emitters and receivers see them: centred, with power and mixture of their light."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.errors import PolywignerError, SceneError
from polywigner.geometry import Aperture, PlacedAperture, Slits, Wavefront
from polywigner.geometry.parts import union_on_grid
from polywigner.propagation.far_fields import check_slopes, powers_of
from polywigner.propagation.irradiances import parts_of
from polywigner.radiometry.directions import (
    checked_bandwidth,
    checked_radiator,
    directions_and_weights,
    largest_lag,
    longest_path,
    wavelengths_of_band,
)
from polywigner.reception.norms import NORMALISATIONS
from polywigner.source import Array, Illumination
from polywigner.source.obliquities import (
    OBLIQUITIES,
    Forms,
    fields_of,
    grazing_error,
    irradiance_factor,
    weighted_sources,
)
from polywigner.source.polarisation import Stokes, stokes_fields
from polywigner.source.support import moved_source, mutual_support
from polywigner.transforms import fourier
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.wavefronts import checked_wavefront, flat_of, principal_axes, tilts_of

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


def checked_name(kind: str, name: str, known: Iterable[str]) -> str:
    """Return ``name``, or raise a SceneError that lists the known names; ``kind``: "a sampling"."""
    if name not in known:
        raise SceneError(f"expected {kind}, got {name!r}; use one of {', '.join(known)}")
    return name


def depends_on_wavelength(source: Any, name: str) -> bool:
    """Whether `emissions` do: if the directions of waves matter and there are oblique ones."""
    fields = fields_of(flat_of(source))
    return OBLIQUITIES[name].takes_slopes and any(field is not None for field in fields)


def emissions(source: Any, wavelength: float, name: str) -> list[tuple[Any, Forms]]:
    """Sources whose W, each times h of its forms, add up to the radiance times wavelength^2."""
    check_slopes(source, checked_name("an obliquity", name, OBLIQUITIES))
    found = weighted_sources(flat_of(source), name, wavelength)
    if not any(any(forms) for _, forms in found):
        raise grazing_error(wavelength)
    if isinstance(source, Wavefront):
        return [(source.on(one), forms) for one, forms in found]
    return found


# Error of means over tilts and wavelengths where a number is asked for, as a share of the largest.
_ERROR = 1e-7
# Relative error of the mean power; and wavelengths, beyond which lags add next to nothing to it: it
# is an integral of the correlation times a transform of g that oscillates and falls. Measured, two
# slits and squares of 0.5 to 100 wavelengths, coherent over 0.3 to 30: 2e-5 of the power at most.
_OF_POWER, _LONGEST = 1e-5, 4.0
# Values of F at a time: 16 MB.
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
    ) -> Iterator[tuple[Any, float, float]]:
        """Coherent sources, wavelengths in m, and weights, whose mean is the mixture."""
        wave = source
        if self.coherence_width < math.inf:
            wave = source.partially_coherent(self.coherence_width)
        return parts_of(wave, wavelength, self.bandwidth, error)

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
        fields = weighted_sources(lit, obliquity, wavelength)
        total = 0.0
        for s, solid_angle in directions_and_weights(largest_lag(source), 1 / inverse.max()):
            step = max(1, _BLOCK // len(s))
            for first in range(0, len(waves), step):
                some = slice(first, first + step)
                nu = s[:, :2] * inverse[some, None, None] - waves[some, None, 1:3]
                weights = waves[some, 3] * inverse[some] ** 2
                for one, forms in fields:
                    g = irradiance_factor(forms, s[:, 2])
                    far = np.square(np.abs(fourier(one, nu)))
                    total += float(weights @ far @ (g * solid_angle))
        return total


PLAIN = Mixture()
"""Coherent light of one wavelength."""


def mixture_of(
    source: Any, wavelength: float, bandwidth: float | None = None
) -> tuple[Any, Mixture]:
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


# Error of a curved wave as plane waves, relative to its modulus; sum of their moduli, which single
# precision multiplies by 6e-8; and their periods over the size of an element: the shorter
# the more waves, the longer the larger they are.
_OF_CURVED, _LARGEST_SUM, _PERIODS = 1e-5, 30.0, (1.2, 1.5, 2.0, 3.0)
# Three samples of a shorter row cost more than the few midpoints that they cancel.
_LEAST_SHIFTED = 4
# Shares of singular values that are rounding; most waves along an axis.
_ROUNDING = 1e-9
_MOST_WAVES = 64


@lru_cache(maxsize=16)
def plane_waves_of(source: Any) -> Any:
    """The source with its curved wave as a sum of plane waves on each of its elements."""
    if not isinstance(source, Wavefront):
        return source
    flat, weights = source.source, getattr(source.source, "weights", [1.0])
    elements = []
    for element in flat.elements_in_plane:
        own = _curved_on(element, source)
        flat_field = element.illumination
        whole = own if flat_field is None else own * flat_field
        elements.append(element.with_illumination(whole))
    return elements[0] if isinstance(flat, Aperture) else Array(elements, weights)


def _curved_on(element: Aperture, wave: Wavefront) -> Illumination:
    """Plane waves whose sum is the curved wave on an element: a product over its two axes."""
    curvatures, axes = principal_axes(wave.curvature)
    places = (np.concatenate(element.rings) - wave.centre) @ axes
    amplitudes, frequencies = np.ones(1, np.complex128), np.zeros((1, 2))
    for q, own, axis in zip(curvatures.tolist(), places.T, axes.T, strict=True):
        values, along = _chirp(q, float(own.min()), float(own.max()))
        values = values * np.exp(-2j * math.pi * along * (wave.centre @ axis))
        amplitudes = np.outer(amplitudes, values).ravel()
        frequencies = (frequencies[:, None] + along[:, None] * axis).reshape(-1, 2)
    return Illumination(amplitudes, frequencies)


def _chirp(q: float, low: float, high: float) -> tuple[Complexes, Floats]:
    """Amplitudes and frequencies of waves whose sum is exp(i pi q y^2) from ``low`` to ``high``."""
    middle, size = (low + high) / 2, high - low
    turns = abs(q) * size * size
    if turns < _OF_CURVED:
        centred = np.ones(1, np.complex128), np.zeros(1)
    else:
        count = 8 * math.ceil(min(turns, _MOST_WAVES) + 20)
        places = -np.cos(np.linspace(0.0, math.pi, count)) * size / 2
        wanted = np.exp(1j * math.pi * q * places * places)
        # its frequencies spread over as many steps of 1/size as it has turns
        fits = (
            _fit(places, wanted, np.linspace(-0.5, 0.5, n) * ((n - 1) / (period * size)))
            for n in range(3 + 2 * int(min(turns, _MOST_WAVES) / 2), _MOST_WAVES + 1, 2)
            for period in _PERIODS
        )
        found = next((fit for fit in fits if fit is not None), None)
        if found is None:
            raise SceneError(
                'expected a wave of less curvature with the estimator "exact", got one that turns '
                f"{turns / 8:.3g} times from the middle to the edge of its element; use the "
                'estimator "wigner"'
            )
        centred = found
    amplitudes, frequencies = centred
    # about the middle: q y^2 = q (y - m)^2 + 2 q m (y - m) + q m^2
    shifted = frequencies + q * middle
    phase = q * middle * middle / 2 - shifted * middle
    return amplitudes * np.exp(2j * math.pi * phase), shifted


def _fit(
    places: Floats,
    wanted: Complexes,
    frequencies: Floats,
) -> tuple[Complexes, Floats] | None:
    """Amplitudes of these waves with the wanted sum; None if they miss it, or are too large."""
    waves = np.exp(2j * math.pi * np.outer(places, frequencies))
    found = np.asarray(np.linalg.lstsq(waves, wanted, rcond=_ROUNDING)[0], np.complex128)
    fits = np.abs(waves @ found - wanted).max() <= _OF_CURVED
    return (found, frequencies) if fits and np.abs(found).sum() <= _LARGEST_SUM else None


@dataclass(frozen=True, eq=False)
class CentredSource:
    """A source in the plane with its numbers for an emitter, in SI units."""

    source: Any
    """An Aperture or an Array, or one with a curved wave."""
    centre: Floats
    """(2,), of the region that radiates, read-only."""
    support: Aperture
    """Region relative to the centre; W is zero outside."""
    energy: float
    """int |u|^2 dx, in m^2 for fields of unit 1."""
    shifts: Floats
    """(k, 3): a sample of a position stands for those at these shifts (x, y), by weights that add
    up to 1; read-only."""

    @property
    def at_origin(self) -> Any:
        """The source relative to the centre, for single precision resolves 6e-8 of a position."""
        if isinstance(self.source, Wavefront):
            return self.source.on(moved_source(self.source.source, -self.centre), -self.centre)
        return moved_source(self.source, -self.centre)


def unfit_source(source: Any) -> SceneError:
    """The error for a source that cannot radiate in a scene."""
    advice = "make one with polywigner.Aperture(vertices)"
    if isinstance(source, PlacedAperture):
        advice = "leave its pose out, and give it as the to_world of the shape"
    elif isinstance(source, Slits):
        advice = "make rectangles of slits"
    return SceneError(f"expected an Aperture or an Array, got {type(source).__name__}; {advice}")


def centred_source(source: Any, obliquity: str, antithetic: bool = False) -> CentredSource:
    """An aperture, or an array of apertures in the plane z = 0, prepared for an emitter."""
    if not isinstance(flat_of(source), Aperture | Array):
        raise unfit_source(source)
    checked_name("an obliquity", obliquity, OBLIQUITIES)
    try:
        check_slopes(source, obliquity)
        if isinstance(source, Wavefront):
            flat = _prepared(checked_wavefront(source).source, antithetic)
            return replace(flat, source=source)
        return _prepared(source, antithetic)
    except PolywignerError as error:
        raise SceneError(str(error)) from None


# Read when an entry is made, when its scene is loaded, and whenever a parameter changes.
@lru_cache(maxsize=64)
def norm_of(
    source: Any,
    wavelength: float,
    obliquity: str,
    mixture: Mixture = PLAIN,
    normalise: str = NORMALISATIONS[0],
) -> float:
    """Power of a source's field in W for |u|^2 in W/m^2, as ``normalise`` counts it.

    ``radiated``: the power that leaves through the hemisphere in front, by the obliquity and, of a
    mixture, the mean over its waves. ``aperture``: int |u|^2.

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


# A scene entry is checked when it is made, and read when the scene is loaded.
@lru_cache(maxsize=16)
def _prepared(source: Aperture | Array, antithetic: bool) -> CentredSource:
    shifts = _half_pitches(source) if antithetic else np.array([[0.0, 0.0, 1.0]])
    shifts.setflags(write=False)
    support = mutual_support(source)
    if len(shifts) > 1:
        support = Aperture(
            union_on_grid([support.moved(-shift).polygons for shift in shifts[:, :2]])
        )
    energy = _energy(source)
    return CentredSource(source, support.centre, support.moved(-support.centre), energy, shifts)


def _half_pitches(source: Aperture | Array) -> Floats:
    """(k, 3): places half a pitch apart, about 0, along each direction of a lattice; weights.

    W of a lattice of elements lives about the midpoints of pairs, half a pitch apart. Off the beams
    it changes its sign from each of them to the next, while its size grows evenly towards the
    middle (the number of pairs): second differences, 1/4, 1/2, 1/4, leave next to nothing.
    """
    lattice = None
    if isinstance(source, Array) and source.phased is not None:
        lattice = source.phased.sites.lattice
    found = np.array([[0.0, 0.0, 1.0]])
    if lattice is None:
        return found
    for count, pitch in zip(lattice.weights.shape, lattice.basis, strict=True):
        if count >= _LEAST_SHIFTED:
            steps = np.outer([-0.5, 0.0, 0.5], [*pitch, 0.0])
            steps[:, 2] = 0.25, 0.5, 0.25
            places = found[:, None, :2] + steps[:, :2]
            shares = found[:, None, 2:] * steps[:, 2:]
            found = np.concatenate([places, shares], axis=-1).reshape(-1, 3)
    return found


def _energy(source: Aperture | Array | Wavefront) -> float:
    source = flat_of(source)
    if isinstance(source, Aperture) and source.illumination is None:
        return source.area
    energy = energy_of(source)
    if not energy > 0:
        raise SceneError(
            "expected a source with a field, got elements that cancel each other everywhere"
        )
    return energy


@dataclass(frozen=True, eq=False)
class SourceSpec:
    """Checked parameters of a ``wigner`` shape or a ``wigner_receiver`` sensor, in SI units."""

    centred: CentredSource
    wavelength: float
    norm: float
    """Power in W that the field of the source counts as it is: radiated, or int |u|^2."""
    pose: Floats
    """(4, 4), read-only; the translation in scene units."""
    obliquity: str
    estimator: str
    sampling: str
    scene_unit: float
    """Metres."""
    mixture: Mixture
    """Mixture of the light that it sends, or would send."""
    normalise: str = NORMALISATIONS[0]
    """Power that ``norm`` stands for: one of `NORMALISATIONS`."""
    power: float = 1.0
    """Radiated power in W; 1 for a receiver, whose power comes from the scene."""
    diffraction: bool = False
    """Whether shadows of the scene's surfaces diffract."""
    antithetic: bool = False
    control_variate: bool = False
    sampling_weight: float = 1.0
    visible: bool = True
    """Whether rays meet its surface."""
    noise: Mapping[str, float | None] = field(default_factory=dict)
    """Noise of a receiver, by the names of ``NOISE_PARSERS``."""
    polarisation: Complexes | None = None
    """Unit Jones vector (2,) in the source's x and y, or (n, 2) of elements; None: unpolarised."""
    states_polarisation: bool = False
    """Whether the scene specifies ``polarisation``, "unpolarised" included."""

    @property
    def source(self) -> Aperture | Array:
        """The source that the scene asked for, in coherent light."""
        return self.centred.source

    @property
    def has_several(self) -> bool:
        """Whether elements have different polarisations."""
        return self.polarisation is not None and self.polarisation.ndim == 2

    def fields(self, source: Any) -> list[tuple[Any, Stokes | None]]:
        """Return scalar sources, and Stokes numbers by which their light makes up the polarised."""
        if self.polarisation is None or self.polarisation.ndim == 1:
            return [(source, None)]
        return list(stokes_fields(source, self.polarisation))

    def norm_at(self, wavelength: float, normalise: str | None = None) -> float:
        """Power in W of the source's field at a wavelength, as ``normalise`` counts it."""
        counted = normalise or self.normalise
        return math.fsum(
            norm_of(field, wavelength, self.obliquity, self.mixture, counted)
            for field, stokes in self.fields(self.source)
            if stokes is None or stokes[0] > 0
        )
