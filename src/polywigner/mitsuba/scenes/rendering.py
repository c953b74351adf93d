"""Rendering of images in strips, and temporary changes of a scene."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError, StoreError
from polywigner.execution.progress import slow_bar
from polywigner.geometry.arguments import checked_count
from polywigner.mitsuba.plugins import films
from polywigner.mitsuba.plugins.diffraction import scene_known
from polywigner.mitsuba.plugins.placement import placed_receiver
from polywigner.mitsuba.plugins.polariser import Polariser
from polywigner.mitsuba.plugins.registration import one_at_a_time, set_mesh
from polywigner.mitsuba.receive.direct_light import delta_lights, delta_paths
from polywigner.mitsuba.scenes import surfaces
from polywigner.mitsuba.scenes.reflectors import chains_of, mirrors_in
from polywigner.mitsuba.scenes.scenes import translate_error
from polywigner.numerics import Complex, Floats

Image = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Exposure:
    """Parameters that determine an image."""

    scene: mi.Scene
    camera: mi.Sensor
    integrator: mi.Integrator
    cut: films.Tiling
    seed: int

    def image(self, strip: int, done: Callable[[], None] = lambda: None) -> Floats:
        """Render a strip of the image, averaged over all passes, shape (rows, width, channels).

        ``done`` is called after each pass.
        """
        cut = self.cut
        top = strip * cut.rows
        rows = min(cut.rows, cut.height - top)
        image: Floats | float = 0.0
        for index in range(cut.passes):
            # A small last pass would be poorly stratified, so all passes have about the same size.
            samples = cut.samples // cut.passes + (index < cut.samples % cut.passes)
            seed = films.seed_of(self.seed, strip * cut.passes + index)
            with films.cropped(self.camera, top, rows), _quietly():
                image = image + samples / cut.samples * self._one_pass(samples, seed)
            done()
        return films.checked_finite(np.asarray(image), "values of the image")

    def full_image(self, done: Callable[[], None]) -> Image:
        """Render all strips of the image, shape (height, width, channels)."""
        strips = [self.image(strip, done) for strip in range(self.cut.strips)]
        return np.concatenate(strips).astype(np.float32)

    def channels(self) -> int:
        """Return the number of channels of the image."""
        size = 1 if self.camera.class_name() in films.CAMERAS else self.cut.height
        with films.cropped(self.camera, 0, size, size), _quietly():
            return int(self._one_pass(1, 0).shape[-1])

    def _one_pass(self, spp: int, seed: int) -> Floats:
        """Render the cropped film, shape (rows, columns, channels)."""
        scene, camera, integrator = self.scene, self.camera, self.integrator
        factor, lights = films.fineness(camera, spp), scene.emitters()
        # Dr.Jit cannot record a loop over a single sample if the loop contains literals, such as
        # zeros of Mueller matrices or samples of delta lights.
        is_delta = any(mi.has_flag(e.flags(), delta) for e in lights for delta in _DELTA)
        fewest = 2 if mi.is_polarized or is_delta else 1
        finer_spp = max(fewest, math.ceil(spp / factor**2))
        finer_spp = films.accepted_samples(camera.sampler(), finer_spp)
        errors = films.rendering_errors(integrator.class_name())
        with errors, scene_known(scene), films.refined(camera, factor):
            image = mi.render(scene, sensor=camera, integrator=integrator, spp=finer_spp, seed=seed)
            return films.coarse(np.array(image, dtype=np.float64), factor)


_DELTA = mi.EmitterFlags.DeltaPosition, mi.EmitterFlags.DeltaDirection


def check_is_complete(integrator: mi.Integrator) -> None:
    """Raise StoreError if a render has been interrupted."""
    if integrator.should_stop():
        raise StoreError(
            "the image is incomplete: Ctrl-C or a timeout of the integrator has interrupted the "
            "render; start the same run again, without a timeout"
        )


def _quietly() -> AbstractContextManager[None]:
    """Suppress the log of scalar variants, which reports each negative sample."""
    return nullcontext() if dr.is_jit_v(mi.Float) else films.log_only_to()


# Class names of integrators whose shadow rays pass through null surfaces.
_TRANSPARENT = ("Volumetric", "Volpath")


def may_shadow(scene: mi.Scene) -> bool:
    """Return whether the surface of a source may block another source or light."""
    lights = [emitter for emitter in scene.emitters() if not emitter.is_environment()]
    return any(
        surfaces.is_source(source)
        and source.spec.visible
        and mi.has_flag(source.get_shape().bsdf().flags(), mi.BSDFFlags.Null)
        and _shines_on(other, surfaces.vertices_of(source.get_shape()))
        for source, other in permutations(lights, 2)
    )


def _shines_on(light: mi.Emitter, points: Floats) -> bool:
    """Return whether a light radiates towards one of the points (n, 3) in scene units."""
    if not surfaces.is_source(light):
        return True
    pose = np.array(surfaces.matrix_of(light.to_world))
    heights = (points - pose[:3, 3]) @ pose[:3, 2]
    rounding = surfaces.PLACE_ERROR * max(np.abs(points).max(), np.abs(pose).max())
    return bool(heights.max() > rounding)


def exposed(
    scene: mi.Scene,
    integrator: Any = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    warn: bool = True,
) -> Exposure:
    """Check the arguments of :func:`render`, and return an exposure."""
    camera = _camera(scene, sensor)
    samples = films.check_spp(camera.sampler().sample_count() if spp is None else spp)
    entropy = films.check_seed(seed)
    method, inner = _integrator(scene, integrator)
    if warn:
        _warn_of_shadows(scene, inner)
    return Exposure(scene, camera, method, films.tiling_of(camera, samples), entropy)


def default_integrator(scene: mi.Scene) -> str:
    """Return "path", or "volpath" if sources would cast shadows."""
    return "volpath" if may_shadow(scene) else "path"


def default_spp(scene: mi.Scene, sensor: int = 0) -> int:
    """Return the number of samples per pixel of a sensor's sampler."""
    return films.check_spp(_camera(scene, sensor).sampler().sample_count())


def _camera(scene: mi.Scene, number: int) -> mi.Sensor:
    """Return a sensor of a scene; raise an error unless it exists and has pixels."""
    sensors = surfaces.sensors_of(scene)
    if not sensors:
        raise SceneError("the scene has no <sensor>; add a sensor with a film")
    checked_count(number, "sensor", 0, len(sensors) - 1)
    width, height = sensors[number].film().crop_size()
    if width < 1 or height < 1:
        raise SceneError(
            f"the film must have at least one pixel, got {width} x {height}; set its width and "
            "height"
        )
    return sensors[number]


_STOKES = "stokes"


def _integrator(scene: mi.Scene, integrator: Any) -> tuple[mi.Integrator, mi.Integrator]:
    """Return an integrator and its nested radiance integrator (the same if nothing is nested)."""
    adds_stokes = isinstance(integrator, str) and integrator.split()[:1] == [_STOKES]
    if adds_stokes:
        integrator = integrator.strip()[len(_STOKES) :].strip() or None
        if not mi.is_polarized:
            raise SceneError(
                f"the integrator {_STOKES} requires a polarised variant, got {mi.variant()}; "
                "select one with polywigner.mitsuba.choose_variant(polarised=True)"
            )
    if integrator is None:
        integrator = scene.integrator() or default_integrator(scene)
    if not isinstance(integrator, str) and not hasattr(integrator, "class_name"):
        raise ArgumentError(
            "expected integrator to be an integrator object or the name of its plugin, got "
            f"{integrator!r}"
        )
    try:
        if isinstance(integrator, str):
            integrator = mi.load_dict({"type": integrator})
        if not adds_stokes or integrator.class_name() == "StokesIntegrator":
            return integrator, integrator
        return mi.load_dict({"type": _STOKES, "nested": integrator}), integrator
    except RuntimeError as error:
        raise translate_error(error) from None


def _warn_of_shadows(scene: mi.Scene, integrator: mi.Integrator) -> None:
    """Warn if an integrator loses light that passes the surface of a source."""
    # All integrators written in Python have the same C++ class name, so the Python class name is
    # added.
    names = integrator.class_name() + type(integrator).__name__
    if may_shadow(scene) and not any(name in names for name in _TRANSPARENT):
        warnings.warn(
            "with this integrator, the surface of a source may cast a shadow of another source, "
            "although its BSDF is null: 'direct' loses the shadowed light; 'path' and 'prb' lose "
            "it at the last bounce, and are noisy at earlier bounces; use 'volpath', or "
            "visible=False for sources that need not be visible",
            RuntimeWarning,
            stacklevel=4,
        )


@contextmanager
def receiving(scene: Any) -> Iterator[None]:
    """Give plugins access to the scene while ``mi.render`` or another renderer runs.

    Diffraction and the receiver estimator ``exact`` require the scene.
    :func:`polywigner.mitsuba.render` calls this function itself.

    Warns
    -----
    RuntimeWarning
        If a scene with a receiver has point, spot, projector or directional lights, because
        ``mi.render`` does not sample the direct light from these lights to a receiver.
    """
    if any(map(surfaces.is_receiver, scene.sensors())):
        for light in delta_lights(scene):
            warnings.warn(
                f"mi.render does not sample the direct light from {light.name!r} to a receiver; "
                "use polywigner.mitsuba.render or received_power",
                RuntimeWarning,
                stacklevel=3,
            )
    with scene_known(scene):
        yield


@one_at_a_time
def render(
    scene: Any,
    integrator: Any = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> npt.NDArray[np.float32]:
    """Render the signed radiance of a scene.

    Parameters
    ----------
    scene : mitsuba.Scene
        Scene with a sensor, its film and its sampler.
    integrator : str or mitsuba.Integrator, optional
        Plugin name or integrator. The default is the integrator of the scene. For a scene without
        an integrator, it is ``path``, or ``volpath`` if the surface of a source shadows another
        source. ``stokes``, or a string such as ``stokes volpath``, adds the Stokes parameters of
        polarised light as channels; see :func:`polywigner.mitsuba.stokes_of`.
    spp : int, default the sample count of the sampler
        Number of samples per pixel, 1 to 2^30. Samplers may round the number up.
    seed : int, default 0
        Seed of the random numbers, zero or more.
    sensor : int, default 0
        Index of the sensor in the scene.
    progress : callable, default a progress bar
        Function that is called after each part with the number of finished parts and the total
        number of parts.

    Returns
    -------
    ndarray, shape (height, width, channels)
        Radiance in W/(m^2 sr), float32. Pixels can be negative because of noise, and because the
        Wigner radiance of a visible aperture can be negative. Pixels of a ``wigner_receiver``
        contain the received power in W.

    Raises
    ------
    ArgumentError
        If ``spp``, ``sensor`` or ``seed`` is out of range.
    SceneError
        If ``scene`` is not a scene, has no sensor or no pixels, if the integrator is unknown or
        cannot render this scene, and if the radiance is not finite.

    Notes
    -----
    The film is rendered in strips of rows. All samples of a strip are rendered
    together, which preserves stratification. For comparison, the average of four passes of 64
    samples has 5 dB more noise than one pass of 256 samples. If a sensor cannot be cropped, the
    image is the average of several passes.
    """
    exposure = exposed(scene, integrator, spp, seed, sensor)
    with slow_bar("render", exposure.cut.steps, progress) as advance:
        return with_delta_lights(exposure, exposure.full_image(advance))


# Class names of integrators that render radiance.
_OF_RADIANCE = ("Path", "Direct", "PRB", "Volumetric", "Volpath")
# Largest number of specular reflections of the light from delta lights.
_MOST_MIRRORS = 2


def with_delta_lights(exposure: Exposure, image: Image) -> Image:
    """Add the direct light of delta lights to a copy of a receiver's image.

    Images of other sensors are returned unchanged.
    """
    scene, camera, method = exposure.scene, exposure.camera, exposure.integrator
    names = method.class_name() + type(method).__name__
    if not surfaces.is_receiver(camera) or method.hide_emitters or not delta_lights(scene):
        return image
    depth = films.depths_of(method)["max_depth"]
    if depth == 0 or not any(name in names for name in _OF_RADIANCE):
        return image
    receiver = placed_receiver(scene, camera, 0)
    most = _MOST_MIRRORS if depth < 0 else min(_MOST_MIRRORS, depth - 1)
    mirrors, _ = mirrors_in(scene, receiver.scene_unit, most)
    result = image.astype(np.float64)
    rows, columns, channels = image.shape
    for path in delta_paths(scene, receiver, [(), *chains_of(mirrors, most)]):
        column, row = (
            min(int((cosine + 1) / 2 * count), count - 1)
            for cosine, count in zip(path.arrives_from, (columns, rows), strict=True)
        )
        result[row, column, : 3 if channels >= 3 else 1] += path.power
    return result.astype(np.float32)


# Scale factor of the mesh of a hidden source. The mesh has zero radiance. The fraction of rays that
# still hit the mesh is the square of this factor.
_HIDDEN_SCALE = 1e-3


@contextmanager
def hide_emitters(scene: mi.Scene) -> Iterator[None]:
    """Hide coherent sources from rays within a ``with`` block.

    The hidden sources still illuminate the scene.
    """
    sources = surfaces.wigner_emitters(scene)
    null = mi.BSDFFlags.Null
    visible = [source.get_shape() for source in sources if source.spec.visible]
    shapes = [shape for shape in visible if mi.has_flag(shape.bsdf().flags(), null)]
    corners = [surfaces.vertices_of(shape) for shape in shapes]
    centres = [(points.min(axis=0) + points.max(axis=0)) / 2 for points in corners]
    shrunk = [c + _HIDDEN_SCALE * (points - c) for c, points in zip(centres, corners, strict=True)]
    # Visible sources check the position of their mesh, so they are hidden first.
    with films.changed([(s, "spec", replace(s.spec, visible=False)) for s in sources]):
        try:
            _move_vertices(scene, shapes, shrunk)
            yield
        finally:
            _move_vertices(scene, shapes, corners)


def polarised_by_default(
    scene: mi.Scene, polarisation: Complex | None
) -> AbstractContextManager[None]:
    """Set the polarisation of sources and receivers that have none, within a ``with`` block.

    ``polarisation`` is a Jones vector; None changes nothing.
    """
    changes: list[tuple[Any, str, Any]] = []
    if polarisation is not None and mi.is_polarized:
        sensors = [sensor for _, sensor in surfaces.receivers_of(scene)]
        for end in surfaces.wigner_emitters(scene) + sensors:
            if not end.spec.states_polarisation:
                changes.append((end, "spec", replace(end.spec, polarisation=polarisation)))
                changes.append((end, "polariser", Polariser(mi, polarisation)))
    return films.changed(changes)


def illuminated_by(sources: Sequence[Any], active: Any) -> AbstractContextManager[None]:
    """Set the power of all sources except ``active`` to zero within a ``with`` block.

    If ``active`` is None, the power of all ``sources`` is set to zero.
    """
    others = [source for source in sources if source is not active]
    return films.changed([(source, "power", source.adjustable(0.0)) for source in others])


def _move_vertices(scene: mi.Scene, shapes: list[mi.Mesh], corners: list[Floats]) -> None:
    """Set the vertices (n, 3) of each mesh in scene units, and update the scene."""
    for shape, points in zip(shapes, corners, strict=True):
        set_mesh(shape, vertex_positions=points)
    scene.parameters_changed([])  # Updates the surfaces that rays hit.
