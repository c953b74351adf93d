"""Rendering strip by strip: bounded memory, progress, and the integrators' known limits."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import count
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from polywigner.errors import ArgumentError, SceneError
from polywigner.execution.progress import slow_bar
from polywigner.geometry.arguments import checked_callable, checked_count
from polywigner.mitsuba.plugins.films import Exposure, check_seed, check_spp, tiling_of
from polywigner.mitsuba.plugins.placement import PLACE_ERROR, is_source, placed_receiver
from polywigner.mitsuba.plugins.receiver import is_receiver, scene_known, sensors_of
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.receive.delta_lights import delta_lights, delta_paths
from polywigner.mitsuba.scenes.reflectors import chains_of, smooth_shapes
from polywigner.mitsuba.scenes.scenes import has_wigner_emitter, translate_error
from polywigner.mitsuba.scenes.surfaces import matrix_of, vertices_of


@contextmanager
def receiving(scene: Any) -> Iterator[None]:
    """Tell receivers the scene, for their estimator ``exact``; and all whose light diffracts.

    :func:`polywigner.mitsuba.render` does it by itself; for ``mi.render`` and other renderers.
    Mitsuba tells cameras written in Python nothing of their scene, and one that held it would keep
    it alive for ever.

    Warns of point, spot, projector and directional lights, whose direct light ``mi.render`` does
    not find.
    """
    if any(map(is_receiver, scene.sensors())):
        for light in delta_lights(scene):
            warnings.warn(
                f"mi.render does not find the light that a receiver gets straight from "
                f"{light.name!r}; use polywigner.mitsuba.render or received_power",
                RuntimeWarning,
                stacklevel=3,
            )
    with scene_known(scene):
        yield


def is_fog_near(scene: Any, sensor: Any) -> bool:
    """Whether fog is nearer to a receiver of exact weights than 2 D^2/wavelength (Fraunhofer)."""
    if not is_receiver(sensor) or sensor.spec.estimator != "exact":
        return False
    if sensor.get_medium() is not None:
        return True
    spec = sensor.spec
    size = np.ptp(np.reshape(spec.source.bounds, (2, 2)), axis=0)
    far = 2 * float(size @ size) / spec.wavelength / spec.scene_unit
    middle = spec.pose[:3] @ [*(spec.centred.centre / spec.scene_unit), 0.0, 1.0]
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


def _shines_on(light: Any, points: npt.NDArray[np.float64]) -> bool:
    if not is_source(light):
        return True
    pose = np.array(matrix_of(light.to_world))
    heights = (points - pose[:3, 3]) @ pose[:3, 2]
    rounding = PLACE_ERROR * max(np.abs(points).max(), np.abs(pose).max())
    return bool(heights.max() > rounding)


_NEVER = 2**30
"""A depth for Russian roulette that no path reaches."""

# What Mitsuba makes of -1, paths without end.
_ENDLESS = 2**32 - 1


@one_at_a_time
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
    integrator: plugin name or ``mi.Integrator``; default: the scene's own, else
        ``path``, or ``volpath`` where a source's surface stands in the light of another.
        ``stokes``: the same, or a plugin as in ``stokes volpath``, with the Stokes numbers of
        polarised light as further channels: :func:`polywigner.mitsuba.stokes_of`.
    spp: samples per pixel; default: the sampler's own. Samplers may round it up.
    seed: of the random numbers, zero or more; every strip and pass derives its own from it.
    sensor: index of the scene's sensor.
    progress: called after each part with the number of parts done, and of all parts.

    The film is rendered in strips of whole rows, each with all its samples, which keeps a
    stratified sampler's advantage (four passes of 64 samples have 5 dB more noise than one of 256).
    Sensors that cannot be cropped have passes, which are averaged. Noise can make pixels negative,
    and so can the Wigner radiance where the aperture is seen directly.

    Raises
    ------
    ArgumentError for what is no scene, an spp that is not from 1 to 2^30, a sensor that is not
    there or a negative seed; SceneError for a scene without sensor or pixels, an unknown
    integrator, one that cannot render this scene, or radiance that is not finite.
    """
    exposure = exposed(scene, integrator, spp, seed, sensor)
    checked_callable(progress, "progress")
    done, steps = count(1), exposure.cut.steps
    if progress is None:
        with slow_bar("render", steps) as advance:
            return with_delta_lights(exposure, exposure.picture(advance))
    return with_delta_lights(exposure, exposure.picture(lambda: progress(next(done), steps)))


# Integrators whose images are radiance, and most mirrors on a path that images take over.
_OF_RADIANCE = ("Path", "Direct", "PRB", "Volumetric", "Volpath")
_MOST_MIRRORS = 2


def with_delta_lights(
    exposure: Exposure, image: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """Add the direct light of point and directional lights to the image of a receiver."""
    scene, camera, method = exposure.scene, exposure.camera, exposure.integrator
    names = method.class_name() + type(method).__name__
    if not is_receiver(camera) or method.hide_emitters or not delta_lights(scene):
        return image
    depth = 2 if method.class_name() == "DirectIntegrator" else depths_of(method)["max_depth"]
    if depth == 0 or not any(name in names for name in _OF_RADIANCE):
        return image
    place = placed_receiver(camera, 0).touching(scene)
    most = _MOST_MIRRORS if depth < 0 else min(_MOST_MIRRORS, depth - 1)
    mirrors = smooth_shapes(scene, place.scene_unit).mirrors
    result = image.astype(np.float64)
    rows, columns, channels = image.shape
    for path in delta_paths(scene, place, [(), *chains_of(mirrors, most)]):
        column, row = (
            min(int((cosine + 1) / 2 * count), count - 1)
            for cosine, count in zip(path.arrives_from, (columns, rows), strict=True)
        )
        result[row, column, : 3 if channels >= 3 else 1] += path.power
    return result.astype(np.float32)


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
    name = _without_stokes(integrator)
    method = inner = _integrator(scene, name)
    if name is not integrator:
        method = _with_stokes(inner)
    if warn:
        _warn_of_limits(scene, inner, camera)
    return Exposure(scene, camera, method, tiling_of(camera, total), entropy)


def default_integrator(scene: Any) -> str:
    """For a scene that names none: ``path``, or ``volpath`` where ``path`` would make shadows."""
    return "volpath" if may_shadow(scene) else "path"


def default_spp(scene: Any, sensor: int = 0) -> int:
    """Return the samples per pixel of a scene; raises as :func:`render` does."""
    return check_spp(_camera(scene, sensor).sampler().sample_count())


def _camera(scene: Any, number: int) -> Any:
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


def _integrator(scene: Any, integrator: Any) -> Any:
    if integrator is None:
        integrator = scene.integrator() or default_integrator(scene)
    if not isinstance(integrator, str):
        if not hasattr(integrator, "class_name"):
            raise ArgumentError(
                f"expected an integrator or the name of its plugin, got {integrator!r}"
            )
        return integrator
    entry: dict[str, Any] = {"type": integrator}
    if integrator == "ptracer":
        entry["rr_depth"] = _NEVER
    try:
        return mi.load_dict(entry)
    except RuntimeError as error:
        raise translate_error(error) from None


_STOKES = "stokes"


def _without_stokes(integrator: Any) -> Any:
    """The name of the integrator inside of ``stokes`` or ``stokes path``; others as they are."""
    if isinstance(integrator, str) and integrator.split()[:1] == [_STOKES]:
        return integrator.strip()[len(_STOKES) :].strip() or None
    return integrator


def _with_stokes(inner: Any) -> Any:
    """An integrator with the Stokes numbers of its light as further channels of the picture."""
    if not mi.is_polarized:
        raise SceneError(
            f"expected a polarised variant for the integrator {_STOKES}, got {mi.variant()}; set "
            "polywigner.mitsuba.choose_variant(polarised=True)"
        )
    if inner.class_name() == "StokesIntegrator":
        return inner
    try:
        return mi.load_dict({"type": _STOKES, "nested": inner})
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


def depths_of(integrator: Any) -> dict[str, int]:
    """``max_depth``, -1 for paths without end, and ``rr_depth`` of an integrator."""
    # Mitsuba's own tell them in their text alone
    told = re.findall(r"(max_depth|rr_depth) = (-?\d+)", str(integrator))
    found: dict[str, int] = {"max_depth": -1, "rr_depth": 0}
    found.update((name, int(value)) for name, value in told)
    found.update((name, int(getattr(integrator, name, value))) for name, value in found.items())
    if found["max_depth"] == _ENDLESS:
        found["max_depth"] = -1
    return found
