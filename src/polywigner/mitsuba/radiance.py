"""The Wigner function of a source with the factors of its obliquity, traced into a render kernel.

The emitter's radiance is proportional to it, and so is the power that a receiver takes of one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from polywigner.execution import Traced, kernel_with_derivatives, ops_for
from polywigner.geometry import Wavefront
from polywigner.illumination.obliquities import emission_factor
from polywigner.kernels import kernel_for
from polywigner.mitsuba.mixtures import Wave
from polywigner.mitsuba.obliquity import emissions
from polywigner.transforms import fourier
from polywigner.transforms.wavefronts import flat_of

__all__ = ["WignerSum"]

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
        """The frequency less that of the curved wave at a place."""
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
