"""Rendering in passes: bounded memory, progress, and the integrators' known limits."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError
from polywigner.mitsuba.scenes import has_wigner_emitter, translate_error

__all__ = ["render"]

# Samples per pass in the compiled variants: Mitsuba keeps some 100 bytes of each.
_WAVEFRONT = 2**25

# With a progress bar, about this many passes, but none so short that a stratified sampler loses
# what stratification brings.
_STEPS = 20
_SHORTEST_PASS = 64


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
    seed: of the random numbers; every pass derives its own from it.
    sensor: index of the scene's sensor.
    progress: called after each pass with the samples per pixel done, and to do in all.

    The passes are averaged by their numbers of samples. Noise can make pixels negative, and so
    can the Wigner radiance itself where the aperture is seen directly.

    Raises
    ------
    ArgumentError for an spp below one or a sensor that is not there; SceneError for an unknown
    integrator.
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
    passes = _passes(camera, total, progress is not None)
    seeds = np.random.SeedSequence(seed).generate_state(len(passes))
    image: npt.NDArray[np.float64] | float = 0.0
    done = 0
    for samples, own_seed in zip(passes, seeds, strict=True):
        part = mi.render(scene, sensor=sensor, integrator=method, spp=samples, seed=int(own_seed))
        image = image + samples / total * np.array(part, dtype=np.float64)
        done += samples
        if progress is not None:
            progress(done, total)
    return np.asarray(image, dtype=np.float32)


def _passes(camera: Any, total: int, stepwise: bool) -> list[int]:
    """Samples per pixel of each pass."""
    width, height = camera.film().crop_size()
    longest = max(1, _WAVEFRONT // (width * height)) if dr.is_jit_v(mi.Float) else total
    if stepwise:
        longest = min(longest, max(_SHORTEST_PASS, math.ceil(total / _STEPS)))
    count = math.ceil(total / longest)
    # Of almost equal length, rather than a last one that is short and badly stratified.
    return [total // count + (index < total % count) for index in range(count)]


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
            "with a null BSDF; use 'path' where one source stands in front of another",
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
