"""Film that sorts power by path length, and a sensor with this film."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from polywigner.errors import EngineError, SceneError, require
from polywigner.execution import Drjit
from polywigner.geometry.arguments import check_most
from polywigner.mitsuba.plugins.diffraction import scene_known
from polywigner.mitsuba.plugins.films import (
    CAMERAS,
    WAVEFRONT,
    accepted_samples,
    checked_finite,
    depths_of,
    film_sizes,
    fineness,
    rendering_errors,
    seed_of,
)
from polywigner.mitsuba.plugins.registration import VariantPlugin, variant_class
from polywigner.mitsuba.scenes.scenes import checked_scene
from polywigner.mitsuba.scenes.surfaces import is_receiver
from polywigner.numerics import Floats

_NAME = "mitransient"
_PATH, _VOLUME = "transient_path", "transient_prbvolpath"

TRANSIENT_INTEGRATORS = (_PATH, _VOLUME)
"""Integrators of mitransient for receivers and cameras.

``transient_nlos_path`` requires a special sensor.
"""

_PYTHON_CLASSES = ("TransientPath", "TransientPRBVolpathIntegrator")

# Integrators of mitransient that trace the paths of Mitsuba's integrators, by class name.
_COUNTERPARTS = {
    "PathIntegrator": _PATH,
    "DirectIntegrator": _PATH,
    "PRBIntegrator": _PATH,
    "BasicPRBIntegrator": _PATH,
    "VolumetricPathIntegrator": _VOLUME,
    "VolpathMisIntegratorImpl": _VOLUME,
    "PRBVolpathIntegrator": _VOLUME,
}


def require_transients(variant: str | None = None) -> ModuleType:
    """Import mitransient for the current variant, and return it.

    The ``variant``, if specified, is set first. Raises EngineError for scalar variants.
    """
    if variant is not None:
        mi.set_variant(variant)
    check_is_compiled("ranges")
    loaded, films = (sys.modules.get(name) for name in (_NAME, f"{_NAME}.films.transient_hdr_film"))
    if loaded is not None:
        if films is not None and issubclass(films.TransientHDRFilm, mi.Film):
            return loaded
        for name in [name for name in sys.modules if name.split(".")[0] == _NAME]:
            del sys.modules[name]  # Imported for another variant.
    # mitransient sets this variable, which child processes would inherit.
    chosen = os.environ.get("MI_DEFAULT_VARIANT")
    try:
        return require(_NAME, "radar", "measures ranges")
    finally:
        if chosen is None:
            os.environ.pop("MI_DEFAULT_VARIANT", None)


def check_is_compiled(purpose: str) -> None:
    """Raise EngineError for scalar variants of Mitsuba."""
    variant = mi.variant()
    if variant is None or variant.startswith("scalar"):
        raise EngineError(
            f"{purpose} require a compiled variant such as llvm_ad_mono, got {variant}; set one "
            "with mi.set_variant(polywigner.mitsuba.choose_variant())"
        )


def is_transient(integrator: Any) -> bool:
    """Return whether an integrator belongs to mitransient."""
    return type(integrator).__module__.startswith(f"{_NAME}.")


def transient_integrator(integrator: Any, scene: Any, sensor: Any) -> mi.Integrator:
    """Return an integrator of mitransient that traces the same paths as ``integrator``.

    Raises SceneError for other integrators, lights at infinity, heterogeneous fog, and a sensor in
    fog.
    """
    require_transients()
    checked_scene(scene)
    # Mitsuba places lights at infinity on a sphere of arbitrary size.
    for emitter in scene.emitters():
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite):
            raise SceneError(
                "ranges require lights at finite distances, got a light at infinity "
                f"({emitter.class_name()}); remove the light"
            )
    counterpart = _with_path_lengths(integrator)
    if type(counterpart).__name__ != _PYTHON_CLASSES[1]:
        return counterpart
    # mitransient ignores fog around the sensor, and underestimates lengths in heterogeneous fog.
    if sensor.get_medium() is not None:
        raise SceneError(
            "ranges require a sensor outside of fog, got a sensor inside a medium; remove the "
            "medium of the sensor, and let the fog begin in front of the sensor"
        )
    media = [m for s in scene.shapes() for m in (s.interior_medium(), s.exterior_medium())]
    if not all(medium is None or medium.is_homogeneous() for medium in media):
        raise SceneError(
            "ranges require homogeneous fog, got a heterogeneous medium, in which mitransient "
            "underestimates path lengths; use homogeneous media"
        )
    return counterpart


def _with_path_lengths(integrator: Any) -> mi.Integrator:
    """Return the integrator of mitransient for an integrator of Mitsuba or mitransient."""
    python_name = type(integrator).__name__
    if is_transient(integrator):
        if python_name not in _PYTHON_CLASSES:
            raise SceneError(
                f"expected the integrator {' or '.join(TRANSIENT_INTEGRATORS)}, got {python_name} "
                "of mitransient, which requires a special sensor"
            )
        if integrator.camera_unwarp:
            raise SceneError(
                "the integrator has camera_unwarp, which omits the last leg of a path from its "
                "length; remove camera_unwarp"
            )
        return integrator
    class_name = integrator.class_name()
    name = class_name if class_name in _COUNTERPARTS else python_name
    if name not in _COUNTERPARTS:
        raise SceneError(
            f"the integrator {name} does not measure path lengths; use path, direct, prb, "
            f"volpath, volpathmis, prbvolpath or {' or '.join(TRANSIENT_INTEGRATORS)}"
        )
    hides = bool(integrator.hide_emitters)
    parameters = {"hide_emitters": hides, **depths_of(integrator)}
    return mi.load_dict({"type": _COUNTERPARTS[name], **parameters})


# Largest total number of bins of all pixels; these bins take 2 GiB in float64.
_MOST_SUMS = 2**28


def sorted_by_range(
    scene: Any, sensor: Any, integrator: Any, edges: Floats, spp: int, seed: int
) -> Floats:
    """Render power or radiance by path length, shape (height, width, bins + 2).

    The first and last values belong to paths shorter and longer than all bins. ``edges`` are path
    lengths (twice the range) in scene units. The result of a receiver has a single pixel, which
    contains powers in W.
    """
    width, height = sensor.film().crop_size()
    passes = math.ceil(spp / max(1, WAVEFRONT // (int(width) * int(height))))
    total: Any = 0.0
    for index in range(passes):
        samples = spp // passes + (index < spp % passes)
        rendered = _one_pass(scene, sensor, integrator, edges, samples, seed_of(seed, index))
        total = total + samples / spp * rendered
    return checked_finite(np.asarray(total), "range bins")


def _one_pass(
    scene: Any, sensor: Any, integrator: Any, edges: Floats, spp: int, seed: int
) -> Floats:
    """Render all samples at once; return the values of `sorted_by_range`."""
    factor = fineness(sensor, spp)
    ranged = _range_sensor(sensor, edges, factor)
    try:
        with rendering_errors(type(integrator).__name__), scene_known(scene):
            samples = accepted_samples(ranged.sampler(), math.ceil(spp / factor**2))
            integrator.render(scene, ranged, seed=seed, spp=samples)
            sums = ranged.film().sums()
    finally:
        ranged.release()
    if is_receiver(sensor):
        return np.asarray(sums.sum(axis=(0, 1), keepdims=True) / factor**2)
    return sums


def _range_sensor(sensor: Any, edges: Floats, factor: int) -> RangeSensor:
    """Return a sensor with the rays of ``sensor`` and a film that sorts by path length.

    The width and height of the film are multiplied by ``factor``.
    """
    size, window, offset = film_sizes(sensor, factor)
    check_bin_count(window, edges)
    about = mi.Properties("range_film")
    for name, pair in (("", size), ("crop_", window)):
        about[f"{name}width"], about[f"{name}height"] = pair
    about["crop_offset_x"], about["crop_offset_y"] = offset
    about["rfilter"] = mi.load_dict({"type": "box"})
    base = require_transients().films.transient_hdr_film.TransientHDRFilm
    ranged_film = variant_class(RangeFilm, base, mi.variant())(about, edges)
    props = mi.Properties("range_sensor")
    props["film"], props["sampler"] = ranged_film, sensor.sampler()
    return variant_class(RangeSensor, "Sensor", mi.variant())(sensor, ranged_film, props)


def check_bin_count(size: Sequence[int], edges: Floats) -> None:
    """Raise ArgumentError if the pixels (width, height) of a film have too many bins in total."""
    count = int(size[0]) * int(size[1]) * (len(edges) + 1)
    check_most(count, _MOST_SUMS, "range bins of all pixels", "use fewer bins or fewer pixels")


class RangeFilm(VariantPlugin):
    """Film that sums power by path length in double precision, including power outside all bins."""

    crop_size: Callable[[], Any]
    crop_offset: Callable[[], Any]

    def __init__(self, props: mi.Properties, edges: Floats) -> None:
        self.base.__init__(self, props)
        self._edges = self.m.Float(edges.tolist())
        self._count = len(edges)
        self._sums: Drjit = None
        self.start_distance: Drjit = 0.0
        """Distance from the sensor to the starts of rays, in scene units."""

    def prepare_transient_(self, aovs: Any) -> int:
        """Set all sums to zero (called by mitransient)."""
        size = self.crop_size()
        self._shape = (int(size[1]), int(size[0]), self._count + 1)
        self._sums = dr.zeros(self.m.Float64, int(np.prod(self._shape)))
        return 1

    def add_transient_data(
        self,
        pos: Drjit,
        distance: Drjit,
        wavelengths: Drjit,
        spec: Drjit,
        ray_weight: Drjit,
        active: Drjit,
        **_: Any,
    ) -> None:
        """Add the power of each path to the bin of its pixel and length (called by mitransient)."""
        m, length = self.m, distance + self.start_distance
        passed = dr.binary_search(
            0, self._count, lambda k: dr.gather(m.Float, self._edges, k) <= length
        )
        offset = self.crop_offset()
        column, row = m.Int32(pos.x) - int(offset[0]), m.Int32(pos.y) - int(offset[1])
        pixel = m.UInt32(row * self._shape[1] + column)
        value = m.Float64(_luminance(m, m.Spectrum(ray_weight) * spec, wavelengths))
        index = pixel * self._shape[2] + passed
        dr.scatter_reduce(dr.ReduceOp.Add, self._sums, value, index, active)

    def develop(self, raw: bool = False) -> tuple[None, Drjit]:
        """Return None for the image, and the flat array of all sums (called by mitransient)."""
        return None, self._sums

    def sums(self) -> Floats:
        """Return the power for each pixel and path-length bin, shape (height, width, bins + 2)."""
        return np.array(self._sums, dtype=np.float64).reshape(self._shape)


def _luminance(m: Any, value: Drjit, wavelengths: Drjit) -> Drjit:
    """Return the luminance of a spectrum."""
    plain = m.unpolarized_spectrum(value)
    if mi.is_monochromatic:
        return plain.x
    return m.luminance(m.spectrum_to_srgb(plain, wavelengths) if mi.is_spectral else plain)


class RangeSensor(VariantPlugin):
    """Sensor with the rays of another sensor and a film that sorts power by range."""

    film: Callable[[], RangeFilm]
    sampler: Callable[[], Any]
    world_transform: Callable[[], Any]

    def __init__(self, sensor: mi.Sensor, film: RangeFilm, props: mi.Properties) -> None:
        self.base.__init__(self, props)
        self._sensor, self._film = sensor, film
        self.m_needs_sample_3 = sensor.needs_aperture_sample()

    def sample_ray_differential(
        self, time: Drjit, sample1: Drjit, sample2: Drjit, sample3: Drjit, active: Drjit = True
    ) -> tuple[mi.RayDifferential3f, Drjit]:
        """Return a random ray of the original sensor, and its weight (called by Mitsuba)."""
        ray, weight = self._sensor.sample_ray_differential(time, sample1, sample2, sample3, active)
        self._film.start_distance = self._start_distance(ray)
        if is_receiver(self._sensor) and self.m.is_polarized:
            weight = weight * self._inverse_rotation(ray.d)
        return ray, weight

    def _inverse_rotation(self, d: Drjit) -> Drjit:
        """Return the Mueller matrix that undoes mitransient's rotation of Stokes vectors."""
        m = self.m
        upright = m.Vector3f(self.world_transform() @ m.Vector3f(0.0, 1.0, 0.0))
        axes = dr.cross(d, upright), m.mueller.stokes_basis(-d)
        return m.Spectrum(m.mueller.rotate_stokes_basis(-d, *axes))

    def _start_distance(self, ray: mi.Ray3f) -> Drjit:
        """Return the distance from the sensor to the start of a ray, in scene units.

        This is the near-clip distance of a camera, or the offset along the ray of a receiver.
        """
        if is_receiver(self._sensor):
            return dr.dot(self._sensor.ray_offset, ray.d)
        if self._sensor.class_name() not in CAMERAS:
            return 0.0
        centre = self._sensor.world_transform().translation()
        return dr.dot(ray.o - self.m.Point3f(centre), ray.d)

    def release(self) -> None:
        """Delete the references to the sensor and the film, so that both are freed."""
        del self._sensor, self._film
