"""Rendering strip by strip: bounded memory, progress, and the integrators' known limits."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError
from polywigner.mitsuba.scenes import has_wigner_emitter, translate_error

__all__ = ["render"]

# Samples in flight at once in the compiled variants: Mitsuba keeps some 100 bytes of each.
_WAVEFRONT = 2**24

# The scalar variants keep nothing; they are cut only so that progress can be told. Their threads
# share out squares of 32 pixels.
_SCALAR_STRIPS = 20
_SCALAR_ROWS = 32

_CAMERAS = ("PerspectiveCamera", "ThinLensCamera", "OrthographicCamera")
"""Sensors whose film can be rendered in parts."""


def render(
    scene: Any,
    integrator: Any = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> npt.NDArray[np.float32]:
    """The image of a scene: signed radiance, float32, (height, width, channels).

    Parameters
    ----------
    scene: a ``mi.Scene``; its sensor brings film and sampler.
    integrator: plugin name or ``mi.Integrator``; default: the scene's own.
    spp: samples per pixel; default: the sampler's own. Samplers may round it up.
    seed: of the random numbers; every strip and pass derives its own from it.
    sensor: index of the scene's sensor.
    progress: called after each part with the number of parts done, and of all parts.

    The film is rendered in strips of whole rows, each with all its samples: cutting the samples
    into passes instead would cost a stratified sampler most of its advantage (four passes of 64
    against one of 256: 5 dB more noise in the median). Passes are left to sensors that cannot be
    cropped, and averaged. Noise can make pixels negative, and so can the Wigner radiance itself
    where the aperture is seen directly.

    Raises
    ------
    ArgumentError for an spp below one or a sensor that is not there; SceneError for an unknown
    integrator, or one that cannot render this scene.
    """
    sensors = scene.sensors()
    if not 0 <= sensor < len(sensors):
        raise ArgumentError(f"expected a sensor below {len(sensors)}, got {sensor}")
    camera = sensors[sensor]
    total = camera.sampler().sample_count() if spp is None else int(spp)
    if total < 1:
        raise ArgumentError(f"expected at least one sample per pixel, got {spp}")
    method = _integrator(scene, integrator)
    _warn_of_limits(scene, method)
    strips = _strips(camera, total)
    passes = _passes(camera, total, strips[0][1])
    seeds = np.random.SeedSequence(seed).generate_state(len(strips) * len(passes))
    images = []
    for number, (top, rows) in enumerate(strips):
        image: npt.NDArray[np.float64] | float = 0.0
        for index, samples in enumerate(passes):
            own = number * len(passes) + index
            with _cropped(camera, top, rows), _without_complaints():
                part = _part(scene, camera, method, samples, int(seeds[own]))
            image = image + samples / total * part
            if progress is not None:
                progress(own + 1, len(seeds))
        images.append(image)
    return np.concatenate(images).astype(np.float32)


def _strips(camera: Any, total: int) -> list[tuple[int, int]]:
    """First row, from the top of the crop window, and number of rows of each strip."""
    width, height = camera.film().crop_size()
    if camera.class_name() not in _CAMERAS:
        return [(0, height)]
    if dr.is_jit_v(mi.Float):
        count = math.ceil(total * width * height / _WAVEFRONT)
    else:
        count = min(_SCALAR_STRIPS, height // _SCALAR_ROWS)
    rows = math.ceil(height / max(1, min(count, height)))
    return [(top, min(rows, height - top)) for top in range(0, height, rows)]


def _part(scene: Any, camera: Any, integrator: Any, spp: int, seed: int) -> npt.NDArray[np.float64]:
    """What Mitsuba renders in one go."""
    try:
        image = mi.render(scene, sensor=camera, integrator=integrator, spp=spp, seed=seed)
        return np.array(image, dtype=np.float64)
    except RuntimeError as error:
        # Dr.Jit says only that something failed; what failed is the cause.
        cause = error.__cause__ or error
        raise SceneError(
            f"expected a scene that {integrator.class_name()} can render: {cause}"
        ) from error


def _passes(camera: Any, total: int, rows: int) -> list[int]:
    """Samples per pixel of each pass over a strip of so many rows."""
    width, _ = camera.film().crop_size()
    longest = max(1, _WAVEFRONT // (width * rows)) if dr.is_jit_v(mi.Float) else total
    count = math.ceil(total / longest)
    # Of almost equal length, rather than a last one that is short and badly stratified.
    return [total // count + (index < total % count) for index in range(count)]


@contextmanager
def _cropped(camera: Any, top: int, rows: int) -> Iterator[None]:
    """A narrower crop window, put back afterwards."""
    size, offset = camera.film().crop_size(), camera.film().crop_offset()
    if rows == size[1]:
        yield
        return
    _set_crop(camera, (size[0], rows), (offset[0], offset[1] + top))
    try:
        yield
    finally:
        _set_crop(camera, size, offset)


@contextmanager
def _without_complaints() -> Iterator[None]:
    """The films of the scalar variants keep negative samples, but log a line for each of them."""
    if dr.is_jit_v(mi.Float):
        yield
        return
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        mi.set_log_level(level)


def _set_crop(camera: Any, size: Any, offset: Any) -> None:
    parameters = mi.traverse(camera)
    parameters["film.crop_size"] = size
    parameters["film.crop_offset"] = offset
    parameters.update()


def _integrator(scene: Any, integrator: Any) -> Any:
    if integrator is None:
        return scene.integrator()
    if not isinstance(integrator, str):
        return integrator
    entry: dict[str, Any] = {"type": integrator}
    if integrator == "ptracer":
        entry["rr_depth"] = 2**30
    try:
        return mi.load_dict(entry)
    except RuntimeError as error:
        raise translate_error(error) from None


def _warn_of_limits(scene: Any, integrator: Any) -> None:
    if not has_wigner_emitter(scene):
        return
    name = integrator.class_name()
    surfaces = [emitter for emitter in scene.emitters() if emitter.get_shape() is not None]
    if name == "DirectIntegrator" and len(surfaces) > 1:
        warnings.warn(
            "the integrator 'direct' lets the surfaces of light sources cast shadows, even those "
            "with a null BSDF; use 'volpath' where one source stands in front of another",
            RuntimeWarning,
            stacklevel=3,
        )
    if name == "ParticleTracerIntegrator":
        warnings.warn(
            "Russian roulette in 'ptracer' ends the paths of negative radiance, which biases the "
            "image: set its rr_depth above its max_depth, or use 'path'",
            RuntimeWarning,
            stacklevel=3,
        )
