"""Clouds of scatterers of an illuminated scene, for programs that generate radar signals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, SceneError
from polywigner.geometry.arguments import checked_count, checked_type, finite_array
from polywigner.mitsuba.plugins.diffraction import scene_known
from polywigner.mitsuba.plugins.films import checked_finite, depths_of
from polywigner.mitsuba.plugins.placement import placed_emitters
from polywigner.mitsuba.plugins.polariser import polarisation_summary
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.radar.range_film import check_is_compiled
from polywigner.mitsuba.receive.power_results import ReceiveOptions, Variables, described
from polywigner.mitsuba.receive.ray_transmission import joined, point_batches
from polywigner.mitsuba.receive.received_power import index_of, matched_ends
from polywigner.mitsuba.receive.scattered import BATCHES, aimed, standard_error
from polywigner.mitsuba.receive.scattering_steps import Events, Motion, Paths, events_of
from polywigner.mitsuba.receive.specular_paths import even_points
from polywigner.mitsuba.scenes.rendering import hide_emitters
from polywigner.mitsuba.scenes.surfaces import (
    is_source,
    number_of,
    receivers_of,
    sorted_emitters,
    sorted_shapes,
    wigner_emitters,
)
from polywigner.numerics import Floats
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source import Array

if TYPE_CHECKING:
    import xarray


# Number of rays per launch; each ray takes a few hundred bytes.
_WAVEFRONT = 2**17


def _selected_events(
    events: Events, count: int, rng: np.random.Generator, for_elements: bool
) -> tuple[Events, float]:
    """Select up to ``count`` random events so that sums of powers and intensities are unbiased.

    Return the events, and the standard error of their total power in W due to the selection. The
    probabilities are proportional to the power. With ``for_elements``, the probabilities are
    proportional to the mean of the relative power and the relative intensity, so that the nulls of
    an array do not depend on a few events. Systematic sampling in order of path length preserves
    the distribution of path lengths. Source: W. G. Madow, Ann. Math. Stat. 20 (1949) 333.
    """
    if len(events) <= count:
        return events, 0.0
    measure = np.abs(events.power) / np.abs(events.power).sum()
    if for_elements:
        measure += np.abs(events.intensity) / np.abs(events.intensity).sum()
    probabilities = _probabilities(measure, count)
    order = np.argsort(events.length, kind="stable")
    steps = np.floor(np.cumsum(probabilities[order]) + rng.random())
    selected = np.sort(order[np.diff(steps, prepend=0.0) > 0])
    chance, events = probabilities[selected], events[selected]
    events.power /= chance
    events.intensity /= chance
    return events, _thinning_error(events.power, chance)


def _all_events(
    scene: Any, sensor: Any, count: int, depth: int, rng: np.random.Generator, motion: Motion | None
) -> tuple[Events, float]:
    """Trace at least ``count`` rays from a receiver; the sources of the scene must be hidden.

    Return all scattering events with powers in W and radiant intensities in W/sr, and the standard
    error of their total power. ``depth`` is the maximum path depth.
    """
    size = -(-count // BATCHES)
    batches = [_events_of_batch(scene, sensor, size, depth, rng, motion) for _ in range(BATCHES)]
    error = standard_error(np.array([batch["power"].sum() for batch in batches]))
    events = np.concatenate(batches).view(np.recarray)
    events.power /= BATCHES
    events.intensity /= BATCHES
    return events, float(error)


def _events_of_batch(
    scene: Any, sensor: Any, count: int, depth: int, rng: np.random.Generator, motion: Motion | None
) -> Events:
    """Trace ``count`` rays, and return the events with their powers and intensities."""
    meets_lights = len(wigner_emitters(scene)) < len(scene.emitters())
    unit = sensor.spec.scene_unit
    # The unused seventh dimension ensures that existing seeds still produce the same clouds.
    draws = even_points(count, 7, np.append(rng.random(6), 0.0))[:, :6]
    draws = np.minimum(draws, np.nextafter(np.float32(1.0), np.float32(0.0)))
    parts = []
    for start in range(0, count, _WAVEFRONT):
        numbers = draws[start : start + _WAVEFRONT]
        paths, watts, solid_angle = _random_paths(sensor, numbers)
        for events in events_of(scene, paths, rng, numbers[:, 4:], depth - 1, meets_lights, motion):
            irradiance = events.radiance * (solid_angle / count)[events.ray]
            events.power = irradiance * watts[events.ray]
            events.intensity = irradiance * (unit * events.distance) ** 2
            checked_finite(events.power, "scattered powers")
            parts.append(events)
    return np.concatenate(parts)


def _random_paths(sensor: Any, draws: Floats) -> tuple[Paths, Floats, Floats]:
    """Return random paths from a receiver, and their weights and solid angles.

    A radiance times the weight and the solid angle is a power in W. ``draws`` (n, 6) are uniform
    random numbers for the direction, the position and the wavelengths.
    """
    ((direction, position, others),) = point_batches(draws[:, :2], draws[:, 2:4], draws[:, 4:])
    angles, density = sensor.directions.sample(direction)
    ray, watts, weight = sensor.ray_along(angles, 0.0, others.x, position)
    if sensor.spec.polarisation is not None:
        weight = sensor.spectral_weight(weight, 1.0, angles)
    paths = Paths.along(mi.Ray3f(ray), weight, 0.0 * density)
    dr.eval(paths, watts, density)
    return paths, joined([watts]), 1.0 / joined([density])


def _probabilities(measure: Floats, count: int) -> Floats:
    """Return probabilities that sum to ``count``, proportional to ``measure`` but at most 1."""
    ordered = np.sort(measure)
    sums = np.cumsum(ordered)
    # If k probabilities are 1, the remaining probabilities must have the sum count - k.
    certain = np.arange(count)
    remainder = sums[len(sums) - 1 - certain]
    scale = (count - certain) / np.where(remainder > 0.0, remainder, 1.0)
    fits = scale * ordered[len(ordered) - 1 - certain] <= 1.0
    return np.asarray(np.clip(measure * scale[np.argmax(fits)], 0.0, 1.0))


def _thinning_error(power: Floats, probabilities: Floats) -> float:
    """Return the standard error in W due to random selection, by Hajek's approximation."""
    missing = 1.0 - probabilities
    if not missing.any():
        return 0.0
    mean = float((missing * power).sum() / missing.sum())
    return math.sqrt(float((missing * (power - mean) ** 2).sum()))


# Default number of rays per scatterer, and smallest number of rays.
_RAYS = 4
_FEWEST_RAYS = 4096
# Largest speed [m/s]; up to this speed, the Doppler shift is linear to 1e-3.
_FASTEST = 1e5
# Largest number of scatterers, and largest number of rays. The events of all rays take up to 2 GB.
_MOST = 1_000_000
_MOST_RAYS = 10_000_000
_NO_LIMIT = 2**20


@one_at_a_time
def scatterers(
    scene: Any,
    count: int,
    *,
    seed: int = 0,
    velocities: Mapping[str, ArrayLike] | None = None,
    max_depth: int | None = None,
    receiver: int | str | None = None,
    rays: int | None = None,
) -> xarray.Dataset:
    """Return a cloud of scatterers, which represents the scattered field at a receiver.

    A scatterer is a point on a surface with a received power, a path length and a velocity. Rays
    from the receiver are scattered from surface to surface, and one light is sampled at each
    surface. Each sampled light results in a scatterer at the first surface of the ray's path. From
    these scatterers, ``count`` scatterers are selected at random, with probabilities proportional
    to their power. The total power of the cloud is an unbiased estimate of
    ``received_power(...).scattered``. Line-of-sight radiation of coherent sources is not included.
    See docs/scatterers.md.

    Parameters
    ----------
    scene : mi.Scene
        Scene of a compiled variant with a ``wigner_receiver`` sensor and lights, without fog.
    count : int
        Largest number of scatterers. The cloud contains fewer scatterers if fewer paths reach a
        light.
    seed : int, default 0
        Seed of the random numbers, zero or more.
    velocities : mapping of str to array_like, shape (3,), optional
        Velocities of shapes, emitters and the receiver in m/s. The keys are ids in the scene.
        Default: zero. Load the scene with :func:`load_scene`, which keeps ids. ``mi.load_dict``
        merges meshes with equal BSDFs into one mesh without an id.
    max_depth : int, optional
        Maximum depth of paths, as in Mitsuba's integrators: 2 for a single reflection, -1 for no
        limit. Default: the value of the scene's integrator.
    receiver : int or str, optional
        As in :func:`received_power`.
    rays : int, optional
        Number of rays from the receiver. Default: four times ``count``, but at least 4096.

    Returns
    -------
    xarray.Dataset
        Dataset with the dimension ``scatterer`` and the following variables:

        - ``position`` and ``normal`` (scatterer, axis): position in the scene in m, and unit normal
          of the first surface on the side of the receiver
        - ``power``: received power in W; the estimator ``wigner`` can make it negative
        - ``intensity``: radiant intensity in W/sr towards the receiver, for
          :func:`element_responses`
        - ``path_length``: length in m of the path from the emitter via all surfaces to the
          receiver, which is twice the range, and infinite for light from an environment
        - ``bounces``: number of surfaces on the path, 0 for a light that the receiver sees directly
        - ``shape``, ``emitter``: ids of the first surface and of the light
        - ``velocity`` (scatterer, axis) and ``path_rate``, if ``velocities`` is specified: velocity
          of the first surface in m/s, and the rate in m/s at which the path length increases, which
          is minus the Doppler shift times the wavelength

        Attributes: wavelength, frequency, receiver, to_world (16 numbers, the translation in m),
        obliquity, normalise, estimator, rays, seed, and ``standard_error`` of the sum of powers in
        W.

    Raises
    ------
    SceneError
        If the scene has no receiver, has no light or contains fog, if an emitter differs in
        wavelength, obliquity or scene unit, or if a radiance is infinite.
    ArgumentError
        If ``scene`` is not a scene, if there are several receivers and none is chosen, if an id is
        unknown, or if another argument is out of range.
    EngineError
        If the variant is scalar.
    """
    check_is_compiled("scatterers")
    size = checked_count(count, "count", 1, _MOST)
    launched = max(_RAYS * size, _FEWEST_RAYS)
    if rays is not None:
        launched = checked_count(rays, "rays", 1, _MOST_RAYS)
    depth = max_depth
    if depth is not None:
        is_endless = isinstance(depth, int) and depth == -1
        depth = _NO_LIMIT if is_endless else checked_count(depth, "max_depth", 1, _NO_LIMIT)
    options = ReceiveOptions(seed=seed)
    rng = np.random.default_rng(options.seed)
    receivers = receivers_of(scene)
    number = index_of(receivers, receiver)
    sensor = receivers[number][1]
    emitters, (placed,) = matched_ends(scene, [number], options)
    if sensor.spec.has_several:
        raise SceneError(
            "scatterers require the same polarisation for all elements of a receiver; set a "
            "single polarisation"
        )
    if sensor.get_medium() is not None or any(s.is_medium_transition() for s in scene.shapes()):
        raise SceneError(
            "scatterers are not supported in a scene with fog; remove the medium, or use "
            "received_power"
        )
    names = _Names.of(scene, placed.name)
    motion = None if velocities is None else names.motion(velocities, placed.scene_unit)
    depth = _depth_of(scene.integrator()) if depth is None else depth
    with hide_emitters(scene), aimed(scene), scene_known(scene):
        events, error = _all_events(scene, sensor, launched, depth, rng, motion)
    events, added_error = _selected_events(events, size, rng, isinstance(placed.source, Array))
    about = {
        "receiver": placed.name,
        "wavelength": placed.wavelength,
        "frequency": SPEED_OF_LIGHT / placed.wavelength,
        "to_world": placed.pose.ravel().tolist(),
        "obliquity": placed.obliquity,
        "normalise": sensor.spec.normalise,
        "polarisation": polarisation_summary([*emitters, placed], False),
        "estimator": sensor.spec.estimator,
        "rays": -(-launched // BATCHES) * BATCHES,
        "seed": options.seed,
        "standard_error": math.hypot(error, added_error),
    }
    return _dataset_of(events, names, motion, placed.scene_unit, about)


@dataclass(frozen=True)
class _Names:
    """Ids of shapes and lights by registry number."""

    shapes: dict[int, str]
    lights: dict[int, str]
    receiver: str

    @classmethod
    def of(cls, scene: Any, receiver: str) -> _Names:
        """Return the ids of all shapes and lights of a scene, with numbers for missing ids."""
        shapes = {
            _registry_number("Shape", shape): shape.id() or f"shape {k}"
            for k, shape in enumerate(sorted_shapes(scene))
        }
        lights, sources = {}, iter(placed_emitters(scene))
        for k, light in enumerate(sorted_emitters(scene)):
            name = light.id() or f"light {k}"
            if is_source(light):
                name = next(sources).name
            elif light.get_shape() is not None:
                name = light.get_shape().id() or name
            lights[_registry_number("Emitter", light)] = name
        return cls(shapes, lights, receiver)

    def motion(self, velocities: Mapping[str, ArrayLike], unit: float) -> Motion:
        """Convert velocities to scene units; raise ArgumentError for unknown ids."""
        speeds = {name: speed / unit for name, speed in checked_velocities(velocities).items()}
        names = {*self.shapes.values(), *self.lights.values(), self.receiver}
        for name in speeds:
            if name not in names:
                raise ArgumentError(
                    f"velocities: no object has the id {name!r}; the ids are "
                    f"{', '.join(map(repr, sorted(names)))}; if mi.load_dict merged the meshes of "
                    "several objects, load the scene with polywigner.mitsuba.load_scene, which "
                    "keeps ids"
                )
        return Motion(
            {number: speeds[name] for number, name in self.shapes.items() if name in speeds},
            {number: speeds[name] for number, name in self.lights.items() if name in speeds},
            speeds.get(self.receiver, np.zeros(3)),
        )


def _registry_number(kind: str, thing: Any) -> int:
    """Return the registry number of a "Shape" or an "Emitter" as an integer."""
    return int(np.ravel(np.array(number_of(kind, thing)))[0])


def checked_velocities(velocities: Mapping[str, ArrayLike]) -> dict[str, Floats]:
    """Check a mapping from ids to velocities in m/s, and return the velocities as arrays."""
    checked_type(velocities, "velocities to be a mapping from ids to (vx, vy, vz)", Mapping)
    checked = {}
    for name, value in velocities.items():
        expected = (
            f"expected the velocity of {name!r} to be three numbers in m/s with a speed below "
            f"{_FASTEST:.0e} m/s"
        )
        checked[name] = finite_array(value, expected, (3,))
        if not np.linalg.norm(checked[name]) < _FASTEST:
            raise ArgumentError(f"{expected}, got {value!r}")
    return checked


def _depth_of(integrator: Any) -> int:
    """Return the maximum path depth of a scene's integrator, or 2^20 if it has no limit."""
    depth = -1 if integrator is None else depths_of(integrator)["max_depth"]
    return depth if 0 < depth < _NO_LIMIT else _NO_LIMIT


def _dataset_of(
    events: Events, names: _Names, motion: Motion | None, unit: float, about: dict[str, Any]
) -> xarray.Dataset:
    """Return events as a cloud of scatterers, with lengths in m; ``unit`` is the scene unit."""
    along, in_space = ("scatterer",), ("scatterer", "axis")
    shapes, lights = _ids(names.shapes, events.first_shape), _ids(names.lights, events.light)
    values: Variables = {
        "position": (unit * events.position, in_space, "m", "position on the first surface"),
        "normal": (events.normal, in_space, "1", "normal of the first surface"),
    }
    if motion is not None:
        speeds = np.zeros_like(events.position)
        for number, velocity in motion.shapes.items():
            speeds[events.first_shape == number] = unit * velocity
        values["velocity"] = (speeds, in_space, "m/s", "velocity of the first surface")
    values |= {
        "power": (events.power, along, "W", "power towards the receiver"),
        "intensity": (events.intensity, along, "W/sr", "radiant intensity towards the receiver"),
        "path_length": (unit * events.length, along, "m", "path from emitter to receiver"),
        "bounces": (events.bounces, along, "1", "surfaces on the path"),
        "shape": (shapes, along, "", "id of the first surface"),
        "emitter": (lights, along, "", "id of the light"),
    }
    if motion is not None:
        values["path_rate"] = (unit * events.rate, along, "m/s", "growth of the path per second")
    return described(values, {"axis": ["x", "y", "z"]}, about)


def _ids(names: dict[int, str], numbers: NDArray[np.int64]) -> NDArray[np.str_]:
    """Return the ids of objects with the given registry numbers; unknown numbers have empty ids."""
    unique, inverse = np.unique(numbers, return_inverse=True)
    texts = np.array([names.get(int(n), "") for n in unique] or [""], np.str_)
    return np.asarray(texts[inverse.reshape(numbers.shape)])
