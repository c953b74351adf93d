"""A film that sorts light by the length of its path, and a sensor that looks as another."""

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
import numpy.typing as npt

from polywigner.errors import ArgumentError, EngineError, SceneError, require
from polywigner.execution import Drjit
from polywigner.mitsuba.plugins.diffraction import scene_known
from polywigner.mitsuba.plugins.films import (
    CAMERAS,
    WAVEFRONT,
    accepted_samples,
    depths_of,
    film_sizes,
    fineness,
    rendering_errors,
    seed_of,
)
from polywigner.mitsuba.plugins.registration import VariantPlugin, variant_class
from polywigner.mitsuba.scenes.scenes import checked_scene, translate_error
from polywigner.mitsuba.scenes.surfaces import is_receiver

_NAME = "mitransient"
_PATH, _VOLUME = "transient_path", "transient_prbvolpath"

TRANSIENT_INTEGRATORS = (_PATH, _VOLUME)
"""Plugins that sample receivers and cameras. ``transient_nlos_path`` needs a sensor of its own."""

_OWN = ("TransientPath", "TransientPRBVolpathIntegrator")

# The same light transport, by the class of the integrator without path lengths.
_COUNTERPARTS = {
    "PathIntegrator": _PATH,
    "DirectIntegrator": _PATH,
    "PRBIntegrator": _PATH,
    "BasicPRBIntegrator": _PATH,
    "VolumetricPathIntegrator": _VOLUME,
    "VolpathMisIntegratorImpl": _VOLUME,
    "PRBVolpathIntegrator": _VOLUME,
}
# Mitsuba's `direct` has no depth to tell: emitter, surface, receiver.
_DEPTH_OF_DIRECT = 2


def require_transients(variant: str | None = None) -> ModuleType:
    """mitransient for the variant that is set, its plugins registered."""
    if variant is not None:
        mi.set_variant(variant)
    variant = mi.variant()
    if variant is None or variant.startswith("scalar"):
        raise EngineError(
            f"expected a compiled variant such as llvm_ad_mono, got {variant}: ranges need "
            "mitransient, which has no integrators for others; set one that compiles"
        )
    found, films = (sys.modules.get(name) for name in (_NAME, f"{_NAME}.films.transient_hdr_film"))
    if found is not None:
        if films is not None and issubclass(films.TransientHDRFilm, mi.Film):
            return found
        for name in [name for name in sys.modules if name.split(".")[0] == _NAME]:
            del sys.modules[name]  # it was imported for another variant
    # an import of it chooses a variant for child processes too
    chosen = os.environ.get("MI_DEFAULT_VARIANT")
    try:
        return require(_NAME, "radar", "tells ranges")
    finally:
        if chosen is None:
            os.environ.pop("MI_DEFAULT_VARIANT", None)


def is_transient(integrator: Any) -> bool:
    """Whether an integrator is one of mitransient."""
    return type(integrator).__module__.startswith(f"{_NAME}.")


def transient_integrator(integrator: Any, scene: Any, sensor: Any) -> mi.Integrator:
    """The integrator that follows the same paths as this one and tells their lengths."""
    require_transients()
    checked_scene(scene)
    for emitter in scene.emitters():  # Mitsuba puts lights without a place on a sphere
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite):
            raise SceneError(
                "expected lights at places for ranges, got one that is infinitely far "
                f"({emitter.class_name()}); leave it out"
            )
    found = _counterpart(integrator)
    if type(found).__name__ != _OWN[1]:
        return found
    # mitransient leaves out fog around the sensor, and measures paths in uneven fog too short
    if sensor.get_medium() is not None:
        raise SceneError(
            "expected a sensor outside of fog for ranges, got one with a medium; take the medium "
            "out of the sensor, and set the bounds of the fog in front of it"
        )
    media = [m for s in scene.shapes() for m in (s.interior_medium(), s.exterior_medium())]
    if not all(medium is None or medium.is_homogeneous() for medium in media):
        raise SceneError(
            "expected even fog for ranges, got a heterogeneous medium, in which mitransient "
            "measures paths too short; use homogeneous ones"
        )
    return found


def _counterpart(integrator: Any) -> mi.Integrator:
    python_name = type(integrator).__name__
    if is_transient(integrator):
        if python_name not in _OWN:
            raise SceneError(
                f"expected {' or '.join(TRANSIENT_INTEGRATORS)}, got {python_name} of mitransient; "
                "it needs a sensor of its own"
            )
        if integrator.camera_unwarp:
            raise SceneError(
                "expected whole lengths of paths, got camera_unwarp, which leaves the last way "
                "out; leave it out of the integrator"
            )
        return integrator
    known = integrator.class_name()  # the same of all that are written in Python
    name = known if known in _COUNTERPARTS else python_name
    if name not in _COUNTERPARTS:
        raise SceneError(
            f"expected an integrator whose paths have lengths, got {name}; use path, direct, prb, "
            f"volpath, volpathmis, prbvolpath or {' or '.join(TRANSIENT_INTEGRATORS)}"
        )
    is_direct = name == "DirectIntegrator"
    depths = {"max_depth": _DEPTH_OF_DIRECT} if is_direct else depths_of(integrator)
    hides = bool(integrator.hide_emitters)
    try:
        return mi.load_dict({"type": _COUNTERPARTS[name], "hide_emitters": hides, **depths})
    except RuntimeError as error:
        raise translate_error(error) from None


Floats = npt.NDArray[np.float64]

# Sums of pixels and bins, in float64: 2 GiB.
_MOST_SUMS = 2**28


def sorted_by_range(
    scene: Any, sensor: Any, integrator: Any, edges: Floats, spp: int, seed: int
) -> Floats:
    """Render a sensor by lengths of paths: (height, width, bins + 2), in its own unit.

    ``edges``: of bins, in units of the scene; the first number is of shorter, the last of longer
    paths. Films of receivers are summed up to one pixel.
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
    """Render in one go, with the samples of :func:`polywigner.mitsuba.render`."""
    factor = fineness(sensor, spp)
    ranged = _ranged(sensor, edges, factor)
    try:
        with rendering_errors(type(integrator).__name__), scene_known(scene):
            samples = accepted_samples(ranged.sampler(), math.ceil(spp / factor**2))
            integrator.render(scene, ranged, seed=seed, spp=samples)
            found = ranged.film().found()
    finally:
        ranged.release()
    if is_receiver(sensor):
        return np.asarray(found.sum(axis=(0, 1), keepdims=True) / factor**2)
    return np.asarray(found)


def _ranged(own: Any, edges: Floats, factor: int) -> RangeSensor:
    """A sensor that looks as this one and has a film by range, of so many times the pixels."""
    size, window, offset = film_sizes(own, factor)
    check_sums(window, edges)
    about = mi.Properties("range_film")
    for name, pair in (("", size), ("crop_", window)):
        about[f"{name}width"], about[f"{name}height"] = pair
    about["crop_offset_x"], about["crop_offset_y"] = offset
    about["rfilter"] = mi.load_dict({"type": "box"})
    base = require_transients().films.transient_hdr_film.TransientHDRFilm
    ranged_film = variant_class(RangeFilm, base, mi.variant())(about, edges)
    props = mi.Properties("range_sensor")
    props["film"], props["sampler"] = ranged_film, own.sampler()
    return variant_class(RangeSensor, "Sensor", mi.variant())(own, ranged_film, props)


def check_sums(size: Sequence[int], edges: Floats) -> None:
    """ArgumentError for more bins of all pixels than fit into memory."""
    count = int(size[0]) * int(size[1]) * (len(edges) + 1)
    if count > _MOST_SUMS:
        raise ArgumentError(
            f"expected at most {_MOST_SUMS} bins of all pixels, got {count}; use fewer bins or "
            "pixels"
        )


class RangeFilm(VariantPlugin):
    """Film with sums of double precision for each pixel: before the bins, in each, behind them."""

    crop_size: Callable[[], Any]
    """Method of Mitsuba's base class."""
    crop_offset: Callable[[], Any]
    """Method of Mitsuba's base class."""

    def __init__(self, props: mi.Properties, edges: Floats) -> None:
        self.base.__init__(self, props)
        self._edges = self.m.Float(edges.tolist())
        self._count = len(edges)
        self._sums: Drjit = None
        self.late: Drjit = 0.0
        """Length of each path before its ray starts."""

    def prepare_transient_(self, aovs: Any) -> int:
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
        m, length = self.m, distance + self.late
        passed = dr.binary_search(
            0, self._count, lambda k: dr.gather(m.Float, self._edges, k) <= length
        )
        offset = self.crop_offset()
        column, row = m.Int32(pos.x) - int(offset[0]), m.Int32(pos.y) - int(offset[1])
        pixel = m.UInt32(row * self._shape[1] + column)
        value = m.Float64(_luminance(m, m.Spectrum(ray_weight) * spec, wavelengths))
        place = pixel * self._shape[2] + passed
        dr.scatter_reduce(dr.ReduceOp.Add, self._sums, value, place, active)

    def develop(self, raw: bool = False) -> tuple[None, Drjit]:
        return None, self._sums

    def found(self) -> Floats:
        """(height, width, bins + 2)."""
        return np.array(self._sums, dtype=np.float64).reshape(self._shape)


def _luminance(m: Any, value: Drjit, wavelengths: Drjit) -> Drjit:
    """Luminance, the one channel that a film keeps."""
    plain = m.unpolarized_spectrum(value)
    if mi.is_monochromatic:
        return plain.x
    return m.luminance(m.spectrum_to_srgb(plain, wavelengths) if mi.is_spectral else plain)


class RangeSensor(VariantPlugin):
    """Sensor with the rays and weights of another one, and a film by range."""

    film: Callable[[], RangeFilm]
    """Method of Mitsuba's base class."""
    sampler: Callable[[], Any]
    """Method of Mitsuba's base class."""
    world_transform: Callable[[], Any]
    """Method of Mitsuba's base class."""

    def __init__(self, looks: mi.Sensor, film: RangeFilm, props: mi.Properties) -> None:
        self.base.__init__(self, props)
        self._looks, self._sorts = looks, film
        self.m_needs_sample_3 = looks.needs_aperture_sample()

    def sample_ray_differential(
        self, time: Drjit, sample1: Drjit, sample2: Drjit, sample3: Drjit, active: Drjit = True
    ) -> tuple[mi.RayDifferential3f, Drjit]:
        ray, weight = self._looks.sample_ray_differential(time, sample1, sample2, sample3, active)
        self._sorts.late = self._late(ray)
        if is_receiver(self._looks) and self.m.is_polarized:
            weight = weight * self._turned_back(ray.d)
        return ray, weight

    def _turned_back(self, d: Drjit) -> Drjit:
        """Inverse of the turn into the sensor's axes with which mitransient starts paths."""
        m = self.m
        upright = m.Vector3f(self.world_transform() @ m.Vector3f(0.0, 1.0, 0.0))
        axes = dr.cross(d, upright), m.mueller.stokes_basis(-d)
        return m.Spectrum(m.mueller.rotate_stokes_basis(-d, *axes))

    def _late(self, ray: mi.Ray3f) -> Drjit:
        """Distance from the sensor at which a ray starts: near clip, or receiver's step."""
        if is_receiver(self._looks):
            return dr.dot(self._looks.lift, ray.d)
        if self._looks.class_name() not in CAMERAS:
            return 0.0
        middle = self._looks.world_transform().translation()
        return dr.dot(ray.o - self.m.Point3f(middle), ray.d)

    def bbox(self) -> mi.BoundingBox3f:
        return self._looks.bbox()

    def release(self) -> None:
        """Let go of the sensor and its film."""
        del self._looks, self._sorts
