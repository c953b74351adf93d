"""A film that sorts what arrives by the length of its path, and a sensor that looks as another.

The integrators of mitransient hand over each contribution with the length of its path; its own film
has bins of one width, adds them in single precision and drops what lies outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError
from polywigner.mitsuba.films import fineness
from polywigner.mitsuba.parts import CAMERAS, WAVEFRONT, seed_of
from polywigner.mitsuba.receiver import is_receiver, receiving
from polywigner.mitsuba.transients import require_transients

__all__ = ["check_sums", "sorted_by_range"]

Floats = npt.NDArray[np.float64]

# Sums of pixels and bins, in float64: 2 GiB.
_MOST_SUMS = 2**28


def sorted_by_range(
    scene: Any, sensor: Any, integrator: Any, edges: Floats, spp: int, seed: int
) -> Floats:
    """What a sensor reads by the lengths of paths: (height, width, bins + 2), in its own unit.

    ``edges``: of bins, in units of the scene. The first number is of all shorter paths, the last of
    longer ones. Films of receivers are summed up to one pixel; other films keep size and crop, with
    a box filter.
    """
    width, height = sensor.film().crop_size()
    passes = math.ceil(spp / max(1, WAVEFRONT // (int(width) * int(height))))
    total: Any = 0.0
    for index in range(passes):
        samples = spp // passes + (index < spp % passes)
        rendered = _rendered(scene, sensor, integrator, edges, samples, seed_of(seed, index))
        total = total + samples / spp * rendered
    bad = int(np.count_nonzero(~np.isfinite(total)))
    if bad:
        raise SceneError(
            f"expected power that is finite, got {bad} bins of it that are not; check frequency, "
            "power and radiances of the scene, and their units"
        )
    return np.asarray(total)


def _rendered(
    scene: Any, sensor: Any, integrator: Any, edges: Floats, spp: int, seed: int
) -> Floats:
    """What is rendered in one go, with the samples of :func:`polywigner.mitsuba.render`."""
    factor = fineness(sensor, spp)
    ranged = _ranged(sensor, edges, factor)
    try:
        with receiving(scene):
            integrator.render(scene, ranged, seed=seed, spp=math.ceil(spp / factor**2))
        found = ranged.film().found()
    except RuntimeError as error:
        cause = error.__cause__ or error
        raise SceneError(
            f"expected a scene that {type(integrator).__name__} can render: {cause}"
        ) from error
    finally:
        ranged.release()
    if is_receiver(sensor):
        return np.asarray(found.sum(axis=(0, 1), keepdims=True) / factor**2)
    return np.asarray(found)


def _ranged(own: Any, edges: Floats, factor: int) -> Any:
    """A sensor that looks as this one and has a film by range, of so many times the pixels."""
    film = own.film()
    size, window, offset = (
        [int(pair[0]) * factor, int(pair[1]) * factor]
        for pair in (film.size(), film.crop_size(), film.crop_offset())
    )
    check_sums(window, edges)
    about = mi.Properties("range_film")
    for name, pair in (("", size), ("crop_", window)):
        about[f"{name}width"], about[f"{name}height"] = pair
    about["crop_offset_x"], about["crop_offset_y"] = offset
    about["rfilter"] = mi.load_dict({"type": "box"})
    base = require_transients().films.transient_hdr_film.TransientHDRFilm
    ranged_film = _film_class(base, mi.variant())(about, edges)
    props = mi.Properties("range_sensor")
    props["film"], props["sampler"] = ranged_film, own.sampler()
    return _sensor_class(mi.variant())(own, ranged_film, props)


def check_sums(size: Sequence[int], edges: Floats) -> None:
    """ArgumentError for more bins of all pixels than fit into memory."""
    count = int(size[0]) * int(size[1]) * (len(edges) + 1)
    if count > _MOST_SUMS:
        raise ArgumentError(
            f"expected at most {_MOST_SUMS} bins of all pixels, got {count}; use fewer bins or "
            "pixels"
        )


@cache
def _film_class(base: Any, variant: str) -> Any:
    m = getattr(mi, variant)

    class RangeFilm(base):
        """Sums of double precision for each pixel: before the bins, in each, behind them."""

        def __init__(self, props: Any, edges: Floats) -> None:
            super().__init__(props)
            self._edges = m.Float(edges.tolist())
            self._count = len(edges)
            self._sums: Any = None
            self.late: Any = 0.0
            """Length of each path before its ray starts."""

        def prepare_transient_(self, aovs: Any) -> int:
            size = self.crop_size()
            self._shape = (int(size[1]), int(size[0]), self._count + 1)
            self._sums = dr.zeros(m.Float64, int(np.prod(self._shape)))
            return 1

        def add_transient_data(
            self,
            pos: Any,
            distance: Any,
            wavelengths: Any,
            spec: Any,
            ray_weight: Any,
            active: Any,
            **_: Any,
        ) -> None:
            length = distance + self.late
            passed = dr.binary_search(
                0, self._count, lambda k: dr.gather(m.Float, self._edges, k) <= length
            )
            offset = self.crop_offset()
            column, row = m.Int32(pos.x) - int(offset[0]), m.Int32(pos.y) - int(offset[1])
            pixel = m.UInt32(row * self._shape[1] + column)
            value = m.Float64(_luminance(m, spec * m.Spectrum(ray_weight), wavelengths))
            place = pixel * self._shape[2] + passed
            dr.scatter_reduce(dr.ReduceOp.Add, self._sums, value, place, active)

        def develop(self, raw: bool = False) -> tuple[Any, Any]:
            return None, self._sums

        def found(self) -> Floats:
            """(height, width, bins + 2)."""
            return np.array(self._sums, dtype=np.float64).reshape(self._shape)

    return RangeFilm


def _luminance(m: Any, value: Any, wavelengths: Any) -> Any:
    """What a film of one channel keeps."""
    plain = m.unpolarized_spectrum(value)
    if mi.is_monochromatic:
        return plain.x
    return m.luminance(m.spectrum_to_srgb(plain, wavelengths) if mi.is_spectral else plain)


@cache
def _sensor_class(variant: str) -> Any:
    m = getattr(mi, variant)
    base: Any = m.Sensor

    class RangeSensor(base):
        """Rays and weights of a sensor, on a film by range."""

        def __init__(self, looks: Any, film: Any, props: Any) -> None:
            super().__init__(props)
            self._looks, self._sorts = looks, film
            self.m_needs_sample_3 = looks.needs_aperture_sample()

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> Any:
            ray, weight = self._looks.sample_ray_differential(
                time, sample1, sample2, sample3, active
            )
            self._sorts.late = self._late(ray)
            return ray, weight

        def _late(self, ray: Any) -> Any:
            """How far from the sensor a ray starts: a near clip, or a receiver's small step."""
            if is_receiver(self._looks):
                return dr.dot(self._looks.lift, ray.d)
            if self._looks.class_name() not in CAMERAS:
                return 0.0
            middle = self._looks.world_transform().translation()
            return dr.dot(ray.o - m.Point3f(middle), ray.d)

        def bbox(self) -> Any:
            return self._looks.bbox()

        def release(self) -> None:
            """Let go of the sensor and its film."""
            self._looks = self._sorts = None

    return RangeSensor
