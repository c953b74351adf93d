"""The Wigner function of a source with the factors of its obliquity, traced into a render kernel.

The emitter's radiance is proportional to it, and so is the power that a receiver takes of one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import PolywignerError, SceneError
from polywigner.execution import Traced, kernel_with_derivatives, ops_for
from polywigner.geometry import Wavefront
from polywigner.illumination.obliquities import (
    OBLIQUITIES,
    Forms,
    emission_factor,
    fields_of,
    grazing_error,
    irradiance_factor,
    weighted_sources,
)
from polywigner.kernels import kernel_for
from polywigner.propagation.far_fields import check_slopes
from polywigner.propagation.irradiances import parts_of
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import checked_bandwidth, wavelengths_of_band
from polywigner.radiometry.hemisphere import directions_and_weights, largest_lag
from polywigner.transforms import fourier
from polywigner.transforms.wavefronts import flat_of, tilts_of


def check_obliquity(name: str) -> str:
    """Return ``name``, or raise a SceneError that lists the known names."""
    if name not in OBLIQUITIES:
        raise SceneError(
            f"expected an obliquity, got {name!r}; use one of {', '.join(OBLIQUITIES)}"
        )
    return name


def depends_on_wavelength(source: Any, name: str) -> bool:
    """Whether `emissions` do: if the directions of waves matter and there are oblique ones."""
    fields = fields_of(flat_of(source))
    return OBLIQUITIES[name].takes_slopes and any(field is not None for field in fields)


def emissions(source: Any, wavelength: float, name: str) -> list[tuple[Any, Forms]]:
    """Sources whose W, each times h of its forms, add up to the radiance times wavelength^2.

    Raises IlluminationError where nothing radiates, because all waves graze the aperture, and
    ArgumentError for an obliquity that takes the slopes of a curved wave.
    """
    check_slopes(source, check_obliquity(name))
    found = weighted_sources(flat_of(source), name, wavelength)
    if not any(any(forms) for _, forms in found):
        raise grazing_error(wavelength)
    if isinstance(source, Wavefront):
        return [(source.on(field), forms) for field, forms in found]
    return found


# Error of means over tilts and wavelengths where a number is asked for, as a share of the largest.
_ERROR = 1e-7
# Relative error of the mean power; and wavelengths, beyond which lags add next to nothing to it: it
# is an integral of the correlation times a transform of g that oscillates and falls. Measured, two
# slits and squares of 0.5 to 100 wavelengths, coherent over 0.3 to 30: 2e-5 of the power at most.
_OF_POWER, _LONGEST = 1e-5, 4.0
# Values of F at a time: 16 MB.
_BLOCK = 1 << 20
# Odd numbers whose multiples differ in all bits, for hashing; 2^32 over the golden ratio is one.
_FACTORS = (0x9E3779B9, 0x85EBCA6B, 0xC2B2AE35, 0x27D4EB2F)
_WORD = 0xFFFFFFFF


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

    def parts(self, source: Any, wavelength: float) -> Iterator[tuple[Any, float, float]]:
        """Coherent sources, wavelengths in m, and weights, whose mean is the mixture."""
        wave = source
        if self.coherence_width < math.inf:
            wave = source.partially_coherent(self.coherence_width)
        return parts_of(wave, wavelength, self.bandwidth, _ERROR)

    def nodes(self, source: Any, wavelength: float) -> NDArray[np.float64]:
        """Waves (n, 4) of the coherent ``source`` in m whose mean power is the mixture's.

        By how much the inverse of their wavelength differs, tilts along x and y, both in 1/m, and
        weights.
        """
        tilts, shares = np.zeros((1, 2)), np.ones(1)
        if self.coherence_width < math.inf:
            wave = source.partially_coherent(self.coherence_width)
            tilts, shares = tilts_of(wave, _OF_POWER, _LONGEST * wavelength)
        band = [(wavelength, 1.0)]
        if self.bandwidth is not None:
            band = wavelengths_of_band(wavelength, self.bandwidth, largest_lag(source), _OF_POWER)
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
        inverse = 1 / wavelength + waves[:, 0]
        fields = weighted_sources(source, obliquity, wavelength)
        total = 0.0
        for s, solid_angle in directions_and_weights(largest_lag(source), 1 / inverse.max()):
            step = max(1, _BLOCK // len(s))
            for first in range(0, len(waves), step):
                some = slice(first, first + step)
                nu = s[:, :2] * inverse[some, None, None] - waves[some, None, 1:3]
                weights = waves[some, 3] * inverse[some] ** 2
                for field, forms in fields:
                    g = irradiance_factor(forms, s[:, 2])
                    far = np.square(np.abs(fourier(field, nu)))
                    total += float(weights @ far @ (g * solid_angle))
        return total


PLAIN = Mixture()
"""Coherent light of one wavelength."""


def mixture_of(
    source: Any, wavelength: float, bandwidth: float | None = None
) -> tuple[Any, Mixture]:
    """The source in coherent light, and the mixture that its light is; ``bandwidth`` in Hz.

    Raises SceneError for a bandwidth out of range.
    """
    try:
        if bandwidth is not None:
            bandwidth = checked_bandwidth(bandwidth, wavelength)
    except PolywignerError as error:
        raise SceneError(str(error)) from None
    if not isinstance(source, Wavefront) or source.is_coherent:
        return source, Mixture(bandwidth=bandwidth)
    return source.coherent, Mixture(source.coherence_width, bandwidth)


def check_mixture(
    mixture: Mixture, source: Any, wavelength: float, obliquity: str, estimator: str
) -> Mixture:
    """The mixture; SceneError where an emitter or a receiver cannot draw waves from it."""
    if mixture.is_plain:
        return mixture
    if estimator != "wigner":
        raise SceneError(
            'expected coherent light of one wavelength with the estimator "exact", got '
            f'{mixture}; use the estimator "wigner", which draws a tilt and a wavelength for each '
            "sample"
        )
    oblique = mixture.coherence_width < math.inf and OBLIQUITIES[obliquity].takes_slopes
    if oblique or (mixture.bandwidth and depends_on_wavelength(source, obliquity)):
        raise SceneError(
            f'expected the obliquity "rayleigh-sommerfeld-1" or "paper" with {mixture}, got '
            f"{obliquity!r}, by which each wave of the mixture would have a factor of its own"
        )
    return mixture


class Wave(NamedTuple):
    """The wave of a sample."""

    inverse: Any
    """Of its wavelength, in 1/m."""
    tilt: Any
    """Spatial frequency (2D) in 1/m by which it is tilted; None: not at all."""


class DrawnWaves:
    """Draws the waves of a mixture, for one variant's arrays."""

    def __init__(self, m: Any, mixture: Mixture) -> None:
        self._m, self._jit, self._mixture = m, dr.is_jit_v(m.Float), mixture
        self._band = self._adjustable((mixture.bandwidth or 0.0) / SPEED_OF_LIGHT)
        self._tilt = self._adjustable(1 / (2 * math.pi * mixture.coherence_width))

    def _adjustable(self, value: float) -> Any:
        # opaque: as a literal, every new value would compile the render kernel again
        return dr.opaque(self._m.Float, value) if self._jit else value

    def wave(self, inverse: Any, x: Any, place: Any) -> Wave:
        """The wave of the sample that a position x (2D) and a point or direction (3D) belong to.

        ``inverse``: of the wavelength in the middle of the band.
        """
        if self._mixture.is_plain:
            return Wave(inverse, None)
        key = self._key(x.x, x.y), self._key(place.x, place.y, place.z)
        tilt = None
        if self._mixture.coherence_width < math.inf:
            sample = self._m.Point2f(*(_uniform(word) for word in self._words(*key)))
            tilt = self._m.warp.square_to_std_normal(sample) * self._tilt
        if self._mixture.bandwidth is not None:
            word = self._words(key[1], key[0])[0]
            inverse = inverse + self._band * (_uniform(word) - 0.5)
        return Wave(inverse, tilt)

    def _words(self, first: Any, second: Any) -> Any:
        return self._m.sample_tea_32(first, second, 5)

    def _key(self, *values: Any) -> Any:
        """32 bits of some floats."""
        key: Any = 0
        for value, factor in zip(values, _FACTORS, strict=False):
            key = key + self._bits(value) * factor
        return key if self._jit else key & _WORD

    def _bits(self, value: Any) -> Any:
        if self._jit:
            return dr.reinterpret_array(self._m.UInt32, dr.detach(self._m.Float(value)))
        return int(np.float32(value).view(np.uint32))


def _uniform(word: Any) -> Any:
    """A number in (0, 1) of 32 bits."""
    return ((word >> 9) + 0.5) * 2.0**-23


Values = tuple[Any, Any]


class WignerSum:
    """The sum of h W over the fields of a source (:func:`emissions`), for one variant's arrays.

    ``source`` relative to the middle of the region that radiates; ``unit``: metres in one unit of
    positions.
    """

    def __init__(self, m: Any, source: Any, wavelength: float, obliquity: str, unit: float) -> None:
        self._m, self._jit, self._unit = m, dr.is_jit_v(m.Float), unit
        self._ops = ops_for(m.Float)
        self._terms = []
        # (source, forms of h) as well, for the integral over positions
        self._fields = emissions(source, wavelength, obliquity)
        for field, forms in self._fields:
            flat = flat_of(field)
            kernel = kernel_for("wigner", flat)
            kernel = kernel.in_one_frame or kernel  # with derivatives
            self._terms.append((kernel, kernel.tables(flat, self._ops.double), forms))
        self._wave = source if isinstance(source, Wavefront) else None

    @property
    def is_single(self) -> bool:
        """Whether the source's own W makes it up."""
        return len(self._terms) == 1

    def at(self, x: Any, direction: Any, wave: Wave, own: Callable[..., Any] | None) -> Any:
        """The sum at positions (2D) and directions (3D unit vectors) of the source's frame.

        In m^2 for fields of unit 1; zero behind. ``own``: W in the place of that of the fields, of
        operations and four coordinates.
        """
        front = direction.z > 0.0
        cosine = dr.select(front, direction.z, 1.0)
        place = (x.x * self._unit, x.y * self._unit)
        frequency = self._sheared(*_frequency(direction, wave), place)
        density = 0.0
        for kernel, tables, forms in self._terms:
            point = (*place, *frequency)
            wigner = own(self._ops, *point) if own else self._wigner(kernel, tables, point)
            density = density + wigner * emission_factor(forms, cosine)
        return dr.select(front, density, 0.0)

    def _sheared(self, x: Any, y: Any, place: Values) -> Values:
        """The frequency relative to the curved wave's at a place."""
        if self._wave is None:
            return x, y
        (xx, xy), (_, yy) = self._wave.curvature.tolist()
        dx, dy = (a - c for a, c in zip(place, self._wave.centre.tolist(), strict=True))
        return x - (xx * dx + xy * dy), y - (xy * dx + yy * dy)

    def _wigner(self, kernel: Any, tables: Any, point: Any) -> Any:
        if not self._jit:
            return kernel(self._ops, tables, *point)[0]
        return kernel_with_derivatives(kernel, self._ops, tables, point, Traced())[0]

    def integral(self, direction: Any, wave: Wave, own: Callable[..., Any] | None) -> Any:
        """The integral over positions, |F|^2 in the place of W, in m^4; ``own``: |F|^2."""
        front = direction.z > 0.0
        cosine = dr.select(front, direction.z, 1.0)
        frequency = self._m.Vector2f(*_frequency(direction, wave))
        total = 0.0
        for field, forms in self._fields:
            square = own(self._ops, *frequency) if own else self._square(field, frequency)
            total = total + square * emission_factor(forms, cosine)
        return dr.select(front, total, 0.0)

    def _square(self, field: Any, frequency: Any) -> Any:
        """|F|^2."""
        amplitude = fourier(field, frequency if self._jit else [frequency.x, frequency.y])
        return amplitude.real * amplitude.real + amplitude.imag * amplitude.imag


def _frequency(direction: Any, wave: Wave) -> tuple[Any, Any]:
    """The two spatial frequencies at which a tilted wave leaves in a direction."""
    along = (direction.x * wave.inverse, direction.y * wave.inverse)
    if wave.tilt is None:
        return along
    return along[0] - wave.tilt.x, along[1] - wave.tilt.y
