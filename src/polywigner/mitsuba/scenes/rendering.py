"""Exposures: what decides the values of an image, rendered strip by strip; limits of integrators.

Strips bound the memory and report progress.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError, StoreError
from polywigner.geometry.arguments import checked_count
from polywigner.mitsuba.plugins.diffraction import scene_known
from polywigner.mitsuba.plugins.films import (
    CAMERAS,
    Tiling,
    accepted_samples,
    changed,
    check_seed,
    check_spp,
    coarse,
    cropped,
    depths_of,
    fineness,
    refined,
    rendering_errors,
    seed_of,
    silent,
    tiling_of,
)
from polywigner.mitsuba.plugins.polariser import Polariser
from polywigner.mitsuba.scenes.scenes import has_wigner_emitter, translate_error
from polywigner.mitsuba.scenes.surfaces import (
    PLACE_ERROR,
    is_receiver,
    is_source,
    matrix_of,
    receivers_of,
    sensors_of,
    vertices_of,
    wigner_emitters,
)

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class Exposure:
    """All that decides the values of an image."""

    scene: Any
    camera: Any
    integrator: Any
    cut: Tiling
    seed: int

    def image(self, strip: int, done: Callable[[], None] = lambda: None) -> Floats:
        """Render a strip, the mean of its passes."""
        cut = self.cut
        top = strip * cut.rows
        rows = min(cut.rows, cut.height - top)
        image: Floats | float = 0.0
        for index in range(cut.passes):
            # passes of almost equal length: a short last one would be badly stratified
            samples = cut.samples // cut.passes + (index < cut.samples % cut.passes)
            seed = seed_of(self.seed, strip * cut.passes + index)
            with cropped(self.camera, top, rows), _quietly():
                rendered = _rendered(self, samples, seed)
            image = image + samples / cut.samples * rendered
            done()
        return _finite(np.asarray(image))

    def picture(self, done: Callable[[], None]) -> npt.NDArray[np.float32]:
        """Render all strips: (height, width, channels)."""
        strips = [self.image(strip, done) for strip in range(self.cut.strips)]
        return np.concatenate(strips).astype(np.float32)

    def channels(self) -> int:
        """Number of channels of the image, from one pixel: integrators add to the film's."""
        one = 1 if self.camera.class_name() in CAMERAS else self.cut.height
        with cropped(self.camera, 0, one, one), _quietly():
            return int(_rendered(self, 1, 0).shape[-1])


def check_is_whole(integrator: Any) -> None:
    """Raise StoreError for a render that ended before its time."""
    if integrator.should_stop():
        raise StoreError(
            "expected a part that is rendered to its end, got one that Ctrl-C or a timeout of "
            "the integrator has cut short; start the same run again, without a timeout"
        )


_DELTA = mi.EmitterFlags.DeltaPosition, mi.EmitterFlags.DeltaDirection


def _rendered(exposure: Exposure, spp: int, seed: int) -> Floats:
    """An image that Mitsuba renders in one go."""
    scene, camera, integrator = exposure.scene, exposure.camera, exposure.integrator
    factor, lights = fineness(camera, spp), scene.emitters()
    # zeros of matrices, and samples of delta lights, are literals, which loops of one sample fold
    is_delta = any(mi.has_flag(e.flags(), delta) for e in lights for delta in _DELTA)
    fewest = 2 if mi.is_polarized or is_delta else 1
    finer = accepted_samples(camera.sampler(), max(fewest, math.ceil(spp / factor**2)))
    with rendering_errors(integrator.class_name()), scene_known(scene), refined(camera, factor):
        image = mi.render(scene, sensor=camera, integrator=integrator, spp=finer, seed=seed)
        return coarse(np.array(image, dtype=np.float64), factor)


def _finite(image: Floats) -> Floats:
    bad = int(np.count_nonzero(~np.isfinite(image).all(axis=-1)))
    if bad:
        raise SceneError(
            f"expected radiance that is finite, got {bad} of {image[..., 0].size} pixels that are "
            "not; check frequency, power and radiances of the scene, and their units"
        )
    return image


def _quietly() -> AbstractContextManager[None]:
    """The scalar variants log each negative sample that a film takes, and draw a progress bar."""
    return nullcontext() if dr.is_jit_v(mi.Float) else silent()


def is_fog_near(scene: Any, sensor: Any) -> bool:
    """Whether fog is nearer to a receiver of exact weights than 2 D^2/wavelength (Fraunhofer)."""
    if not is_receiver(sensor) or sensor.spec.estimator != "exact":
        return False
    if sensor.get_medium() is not None:
        return True
    spec = sensor.spec
    size = np.ptp(np.reshape(spec.source.bounds, (2, 2)), axis=0)
    far = 2 * float(size @ size) / spec.wavelength / spec.scene_unit
    middle = spec.pose[:3] @ [*spec.centre, 0.0, 1.0]
    bounds = (shape.bbox() for shape in scene.shapes() if shape.is_medium_transition())
    return any(float(box.distance(middle.tolist())) < far for box in bounds)


# Those that look behind null surfaces, and the particle tracer, whose light passes them.
_TRANSPARENT = ("Volumetric", "Volpath", "ParticleTracer")


def may_shadow(scene: Any) -> bool:
    """Whether the null surface of a source stands where another light but a sky shines.

    A source shines before its plane: sources side by side in one plane do not meet each other's
    light.
    """
    lights = [emitter for emitter in scene.emitters() if not emitter.is_environment()]
    for number, source in enumerate(lights):
        if not is_source(source):
            continue
        bsdf = source.get_shape().bsdf()
        if source.spec.visible and mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null):
            corners = vertices_of(source.get_shape())
            others = lights[:number] + lights[number + 1 :]
            if any(_shines_on(other, corners) for other in others):
                return True
    return False


def _shines_on(light: Any, points: Floats) -> bool:
    if not is_source(light):
        return True
    pose = np.array(matrix_of(light.to_world))
    heights = (points - pose[:3, 3]) @ pose[:3, 2]
    rounding = PLACE_ERROR * max(np.abs(points).max(), np.abs(pose).max())
    return bool(heights.max() > rounding)


_NEVER = 2**30
"""A depth for Russian roulette that no path reaches."""


def exposed(
    scene: Any,
    integrator: Any = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    warn: bool = True,
) -> Exposure:
    """Check the arguments of :func:`render`, without its radiance."""
    camera = _camera(scene, sensor)
    total = check_spp(camera.sampler().sample_count() if spp is None else spp)
    entropy = check_seed(seed)
    method, inner = _integrator(scene, integrator)
    if warn:
        _warn_of_limits(scene, inner, camera)
    return Exposure(scene, camera, method, tiling_of(camera, total), entropy)


def default_integrator(scene: Any) -> str:
    """For a scene that names none: ``path``, or ``volpath`` where ``path`` would make shadows."""
    return "volpath" if may_shadow(scene) else "path"


def default_spp(scene: Any, sensor: int = 0) -> int:
    """Return the samples per pixel of a scene; raises as :func:`render` does."""
    return check_spp(_camera(scene, sensor).sampler().sample_count())


def _camera(scene: Any, number: int) -> mi.Sensor:
    sensors = sensors_of(scene)
    if not sensors:
        raise SceneError(
            "expected a scene with a <sensor>, got one without; add a sensor with a film"
        )
    checked_count(number, "sensor", 0, len(sensors) - 1)
    width, height = sensors[number].film().crop_size()
    if width < 1 or height < 1:
        raise SceneError(
            f"expected a film of at least one pixel, got {width} x {height}; set its width and "
            "height"
        )
    return sensors[number]


_STOKES = "stokes"


def _integrator(scene: Any, integrator: Any) -> tuple[mi.Integrator, mi.Integrator]:
    """Return an integrator, and the integrator inside if it adds the Stokes numbers."""
    adds_stokes = isinstance(integrator, str) and integrator.split()[:1] == [_STOKES]
    if adds_stokes:
        integrator = integrator.strip()[len(_STOKES) :].strip() or None
        if not mi.is_polarized:
            raise SceneError(
                f"expected a polarised variant for the integrator {_STOKES}, got {mi.variant()}; "
                "set polywigner.mitsuba.choose_variant(polarised=True)"
            )
    if integrator is None:
        integrator = scene.integrator() or default_integrator(scene)
    if not isinstance(integrator, str) and not hasattr(integrator, "class_name"):
        raise ArgumentError(f"expected an integrator or the name of its plugin, got {integrator!r}")
    try:
        if isinstance(integrator, str):
            depth = {"rr_depth": _NEVER} if integrator == "ptracer" else {}
            integrator = mi.load_dict({"type": integrator} | depth)
        if not adds_stokes or integrator.class_name() == "StokesIntegrator":
            return integrator, integrator
        return mi.load_dict({"type": _STOKES, "nested": integrator}), integrator
    except RuntimeError as error:
        raise translate_error(error) from None


def _warn_of_limits(scene: Any, integrator: Any, camera: Any) -> None:
    warn = partial(warnings.warn, category=RuntimeWarning, stacklevel=4)
    if is_fog_near(scene, camera):
        warn(
            'fog reaches into the near zone of a receiver with the estimator "exact", which weighs '
            "what it scatters by the surface behind it: what is scattered within 2 D^2/wavelength "
            'is not right; use the estimator "wigner"'
        )
    if not has_wigner_emitter(scene):
        return
    # integrators written in Python share a class name in Mitsuba
    names = integrator.class_name() + type(integrator).__name__
    if may_shadow(scene) and not any(name in names for name in _TRANSPARENT):
        warn(
            "the surface of a source stands in the light of another, and this integrator lets it "
            "cast shadows, although its BSDF is null: 'direct' loses that light; 'path' and 'prb' "
            "lose it at the last bounce, and find it with noise before; use 'volpath', or "
            "visible=False for a source that nobody looks at"
        )
    if integrator.class_name() == "ParticleTracerIntegrator" and _plays_roulette(integrator):
        warn(
            "Russian roulette in 'ptracer' ends the paths of negative radiance, which biases the "
            "image: set its rr_depth above its max_depth, or use 'path'"
        )


def _plays_roulette(tracer: Any) -> bool:
    """Whether some path of a particle tracer is long enough for Russian roulette."""
    depths = depths_of(tracer)
    longest = depths["max_depth"] % 2**32
    roulette = depths["rr_depth"]
    return roulette <= longest and roulette < _NEVER


# ---- states of a scene while it is rendered -----------------------------------------------------

# Of the size of a surface: its share of rays is the square, and those that meet it read zero.
_SHRUNK = 1e-3


@contextmanager
def unseen(scene: Any) -> Iterator[None]:
    """Within, coherent sources light the scene but rays that meet them read nothing."""
    sources = wigner_emitters(scene)
    null = mi.BSDFFlags.Null
    visible = [source.get_shape() for source in sources if source.spec.visible]
    shapes = [shape for shape in visible if mi.has_flag(shape.bsdf().flags(), null)]
    places = [vertices_of(shape) for shape in shapes]
    middles = [(place.min(axis=0) + place.max(axis=0)) / 2 for place in places]
    shrunk = [m + _SHRUNK * (place - m) for m, place in zip(middles, places, strict=True)]
    # meshes move while nothing is visible: one elsewhere than its emitter would be refused
    with changed([(source, "spec", replace(source.spec, visible=False)) for source in sources]):
        try:
            _move(scene, shapes, shrunk)
            yield
        finally:
            _move(scene, shapes, places)


def polarised_by_default(
    scene: Any, polarisation: Complexes | None
) -> AbstractContextManager[None]:
    """Within, ends without a polarisation have this Jones vector (2,), in polarised variants."""
    changes: list[tuple[Any, str, Any]] = []
    if polarisation is not None and mi.is_polarized:
        every = [*wigner_emitters(scene), *(sensor for _, sensor in receivers_of(scene))]
        for end in every:
            if not end.spec.states_polarisation:
                changes.append((end, "spec", replace(end.spec, polarisation=polarisation)))
                changes.append((end, "polariser", Polariser(mi, polarisation)))
    return changed(changes)


def lit_by(sources: Sequence[Any], lit: Any) -> AbstractContextManager[None]:
    """Within, all of these sources but ``lit`` (None: all of them) have a power of zero."""
    dark = [(source, "power", type(source.power)(0.0)) for source in sources if source is not lit]
    for _, _, power in dark:
        if dr.is_jit_v(power):
            dr.make_opaque(power)  # as a literal, it would compile the kernel again
    return changed(dark)


def _move(scene: Any, shapes: list[Any], places: list[Floats]) -> None:
    for shape, place in zip(shapes, places, strict=True):
        params = mi.traverse(shape)
        params["vertex_positions"] = place.ravel().tolist()
        params.update()
    scene.parameters_changed([])  # rays are traced among surfaces where they are now
