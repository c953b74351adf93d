"""The lit scene as a cloud of scatterers, for programs that make radar signals."""

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
from polywigner.execution import Drjit
from polywigner.geometry.arguments import checked_count, real_numbers
from polywigner.mitsuba.plugins.diffraction import scene_known
from polywigner.mitsuba.plugins.films import depths_of
from polywigner.mitsuba.plugins.placement import placed_emitter
from polywigner.mitsuba.plugins.polariser import polarisation_summary
from polywigner.mitsuba.plugins.registration import one_at_a_time
from polywigner.mitsuba.receive.passing import even_points
from polywigner.mitsuba.receive.ray_transmission import joined, point_batches
from polywigner.mitsuba.receive.received import ReceiveOptions, described
from polywigner.mitsuba.receive.received_power import chosen, matched
from polywigner.mitsuba.receive.scattered import BATCHES, aimed
from polywigner.mitsuba.receive.scattering_steps import Events, Motion, Paths, events_of, number_of
from polywigner.mitsuba.scenes.rendering import unseen
from polywigner.mitsuba.scenes.surfaces import (
    is_source,
    receivers_of,
    sorted_emitters,
    sorted_shapes,
    wigner_emitters,
)
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source import Array
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray


Floats = NDArray[np.float64]

# Rays in flight, with some hundred bytes each.
_WAVEFRONT = 2**17


@dataclass(frozen=True, eq=False)
class Cloud:
    """Events with their powers."""

    events: Events
    power: Floats
    """W, of each."""
    intensity: Floats
    """W/sr, towards the receiver."""
    standard_error: float
    """W, of the sum of powers."""

    def thinned(self, count: int, rng: np.random.Generator, for_elements: bool) -> Cloud:
        """At most ``count`` of the events, with values that stand for all.

        An event is kept with a probability in proportion to its power, at most 1, and its values
        are divided by that. ``for_elements``: in proportion to the mean of its shares of all power
        and all intensity, so that what elements of an array receive does not rest on a few events
        in the nulls of the whole. Systematic sampling along the paths keeps their distribution.
        Source: W. G. Madow, Ann. Math. Stat. 20 (1949) 333.
        """
        if len(self.power) <= count:
            return self
        measure = np.abs(self.power) / np.abs(self.power).sum()
        if for_elements:
            measure += np.abs(self.intensity) / np.abs(self.intensity).sum()
        shares = _shares(measure, count)
        order = np.argsort(self.events.length, kind="stable")
        steps = np.floor(np.cumsum(shares[order]) + rng.random())
        chosen = np.sort(order[np.diff(steps, prepend=0.0) > 0])
        kept = shares[chosen]
        power, intensity = self.power[chosen] / kept, self.intensity[chosen] / kept
        return Cloud(
            self.events[chosen],
            power,
            intensity,
            math.hypot(self.standard_error, _thinning_error(power, kept)),
        )


def cloud_of(
    scene: Any,
    sensor: Any,
    count: int,
    depth: int,
    rng: np.random.Generator,
    motion: Motion | None,
) -> Cloud:
    """The events of ``count`` rays or a few more, in a scene whose sources are unseen."""
    size = -(-count // BATCHES)
    parts = [_batch(scene, sensor, size, depth, rng, motion) for _ in range(BATCHES)]
    sums = [float(power.sum()) for _, power, _ in parts]
    events, power, intensity = zip(*parts, strict=True)
    return Cloud(
        np.concatenate(events).view(np.recarray),
        np.concatenate(power) / BATCHES,
        np.concatenate(intensity) / BATCHES,
        float(np.std(sums, ddof=1) / math.sqrt(BATCHES)),
    )


def _batch(
    scene: Any, sensor: Any, count: int, depth: int, rng: Any, motion: Motion | None
) -> tuple[Events, Floats, Floats]:
    """Events with power and intensity that estimate the whole."""
    meets_lights = len(wigner_emitters(scene)) < len(scene.emitters())
    unit = sensor.spec.scene_unit
    # six of seven columns, so that seeds keep their draws
    draws = even_points(count, 7, np.append(rng.random(6), 0.0))[:, :6]
    draws = np.minimum(draws, np.nextafter(np.float32(1.0), np.float32(0.0)))
    parts = []
    for start in range(0, count, _WAVEFRONT):
        own = draws[start : start + _WAVEFRONT]
        paths, watts, solid_angle = _paths(sensor, own)
        for events in events_of(scene, paths, rng, own[:, 4:], depth - 1, meets_lights, motion):
            value = events.radiance * (solid_angle / count)[events.ray]
            power = value * watts[events.ray]
            if not np.isfinite(power).all():
                raise SceneError(
                    "expected radiance that is finite, got some from the scene that is not; "
                    "check its materials"
                )
            parts.append((events, power, value * (unit * events.distance) ** 2))
    found = np.concatenate([events for events, _, _ in parts]).view(np.recarray)
    power, intensity = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
    return found, power, intensity


def _paths(sensor: Any, draws: Floats) -> tuple[Paths | list[Paths], Floats, Floats]:
    """Paths that leave a receiver; W per radiance and solid angle; the solid angle of each."""
    columns = draws[:, :2], draws[:, 2:4], draws[:, 4:]
    looks = [_looking(sensor, *points) for points in point_batches(*columns)]
    if dr.is_jit_v(mi.Float):
        dr.eval(looks)
    paths, watts, densities = zip(*looks, strict=True)
    first = paths[0] if dr.is_jit_v(mi.Float) else list(paths)
    return first, joined(watts), 1.0 / joined(densities)


def _looking(sensor: Any, direction: Any, place: Any, others: Any) -> tuple[Paths, Drjit, Drjit]:
    """A path by uniform numbers, W per radiance and solid angle, and density per solid angle."""
    angles, density = sensor.directions.sample(direction)
    ray, watts, share = sensor.look_along(angles, 0.0, others.x, place)
    if sensor.spec.polarisation is not None:
        share = sensor.weigh(share, 1.0, angles)
    return Paths.along(mi.Ray3f(ray), share, 0.0 * density), watts, density


def _shares(measure: Floats, count: int) -> Floats:
    """Probabilities, in proportion to a measure but at most 1, that add up to ``count``."""
    ordered = np.sort(measure)
    rest = np.cumsum(ordered)
    # with the k largest kept for certain, the others share count - k
    certain = np.arange(count)
    left = rest[len(rest) - 1 - certain]
    scale = (count - certain) / np.where(left > 0.0, left, 1.0)
    fits = scale * ordered[len(ordered) - 1 - certain] <= 1.0
    return np.asarray(np.clip(measure * scale[np.argmax(fits)], 0.0, 1.0))


def _thinning_error(power: Floats, shares: Floats) -> float:
    """W, of sums over events that were kept with these probabilities: Hajek's approximation."""
    away = 1.0 - shares
    if not away.any():
        return 0.0
    middle = float((away * power).sum() / away.sum())
    return math.sqrt(float((away * (power - middle) ** 2).sum()))


# Rays for each scatterer: more find more to choose from.
_RAYS = 4
_FEWEST_RAYS = 4096
# A gigabyte or two of events.
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
    """A lit scene as its receiver gets it: a cloud of points with power, path length and velocity.

    Rays leave the receiver and are scattered from surface to surface; at each a light is sampled.
    Each light found is a scatterer: it stands at the first surface that the receiver sees, and its
    path is the whole one. Of these, ``count`` are kept by chance, strong rather than weak ones: the
    sum over the cloud is an unbiased estimate of ``received_power(...).scattered``, without what
    comes straight from a coherent source. docs/scatterers.md.

    Parameters
    ----------
    scene : a ``mi.Scene`` with a ``wigner_receiver`` sensor and lights, without fog.
    count : scatterers wanted; there are fewer where rays find fewer.
    seed : of the random numbers, zero or more.
    velocities : (3,) in m/s by the ids of shapes, emitters and the receiver; others stand still.
        Load the scene with :func:`load_scene`, which keeps ids; ``mi.load_dict`` merges meshes of
        equal BSDFs into one without an id.
    max_depth : longest path as Mitsuba's integrators count, 2 is one reflection; -1: no limit.
        Default: that of the scene's integrator.
    receiver : as for :func:`received_power`.
    rays : from the receiver; default: four times ``count``, at least 4096.

    Returns
    -------
    xarray.Dataset over ``scatterer`` with

    - ``position``, ``normal`` (scatterer, axis): of the first surface, in m; the normal is on the
      receiver's side
    - ``power`` in W that the receiver gets; with the estimator ``wigner`` some are negative
    - ``intensity`` in W/sr towards the receiver: :func:`element_responses` says what others in its
      place would receive
    - ``path_length`` in m, from the emitter over all bounces to the receiver; half of it is the
      range. Infinite for the light of an environment
    - ``bounces``: surfaces on the path; 0 for a light that the receiver sees itself
    - ``shape``, ``emitter``: ids of the first surface and of the light
    - with ``velocities``: ``velocity`` (scatterer, axis) of the first surface, and ``path_rate``
      in m/s, by which the whole path grows: minus the Doppler shift times the wavelength

    Attributes: wavelength, frequency, receiver, to_world (16 numbers, the translation in m),
    obliquity, normalise, estimator, rays, seed, and ``standard_error`` of the sum of powers in W.

    Raises
    ------
    SceneError : no receiver, no light, fog; an emitter of another wavelength, obliquity or scene
        unit; radiance that is not finite. ArgumentError : no scene, several receivers and none
        named, ids that are not there, other arguments out of range.
    """
    size = checked_count(count, "count", 1, _MOST)
    launched = max(_RAYS * size, _FEWEST_RAYS)
    if rays is not None:
        launched = checked_count(rays, "rays", 1, _MOST_RAYS)
    depth = max_depth
    if depth is not None:  # -1: no limit
        is_endless = isinstance(depth, int) and depth == -1
        depth = _NO_LIMIT if is_endless else checked_count(depth, "max_depth", 1, _NO_LIMIT)
    options = ReceiveOptions(seed=seed)
    rng = np.random.default_rng(options.seed)
    found = receivers_of(scene)
    number = chosen(found, receiver)
    sensor = found[number][1]
    parties = matched(scene, [number], options)
    (place,) = parties.places
    if sensor.spec.has_several:
        raise SceneError(
            "expected one polarisation of all elements of a receiver for scatterers, got several; "
            "give it one"
        )
    if sensor.get_medium() is not None or any(s.is_medium_transition() for s in scene.shapes()):
        raise SceneError(
            "expected a scene without fog, whose drops are no scatterers here, got one with a "
            "medium; leave it out, or use received_power"
        )
    names = _Names.of(scene, place.name)
    motion = None if velocities is None else names.motion(velocities, place.scene_unit)
    depth = _longest_path(scene.integrator()) if depth is None else depth
    with unseen(scene), aimed(scene), scene_known(scene):
        cloud = cloud_of(scene, sensor, launched, depth, rng, motion)
    cloud = cloud.thinned(size, rng, isinstance(place.source, Array))
    about = {
        "receiver": place.name,
        "wavelength": place.wavelength,
        "frequency": SPEED_OF_LIGHT / place.wavelength,
        "to_world": place.pose.ravel().tolist(),
        "obliquity": place.obliquity,
        "normalise": sensor.spec.normalise,
        "polarisation": polarisation_summary([*parties.emitters, place], False),
        "estimator": sensor.spec.estimator,
        "rays": -(-launched // BATCHES) * BATCHES,
        "seed": options.seed,
        "standard_error": cloud.standard_error,
    }
    return _described(cloud, names, motion, place.scene_unit, about)


@dataclass(frozen=True)
class _Names:
    """Ids of shapes and lights by the numbers that rays know them by."""

    shapes: dict[int, str]
    lights: dict[int, str]
    receiver: str

    @classmethod
    def of(cls, scene: Any, receiver: str) -> _Names:
        shapes = {
            _number("Shape", shape): shape.id() or f"shape {k}"
            for k, shape in enumerate(sorted_shapes(scene))
        }
        lights, coherent = {}, 0
        for k, light in enumerate(sorted_emitters(scene)):
            name = light.id() or f"light {k}"
            if is_source(light):
                name = placed_emitter(light, coherent).name
                coherent += 1
            elif light.get_shape() is not None:
                name = light.get_shape().id() or name
            lights[_number("Emitter", light)] = name
        return cls(shapes, lights, receiver)

    def motion(self, velocities: Mapping[str, ArrayLike], unit: float) -> Motion:
        """Velocities in scene units by numbers; ArgumentError for unknown ids and other values."""
        if not isinstance(velocities, Mapping):
            raise ArgumentError(
                f"expected velocities as a mapping of ids to (vx, vy, vz), got {velocities!r}"
            )
        found = {name: _velocity(name, value) / unit for name, value in velocities.items()}
        known = {*self.shapes.values(), *self.lights.values(), self.receiver}
        for name in found:
            if name not in known:
                raise ArgumentError(
                    f"expected velocities of {', '.join(map(repr, sorted(known)))}, got one of "
                    f"{name!r}; mi.load_dict merges meshes of equal BSDFs: load the scene with "
                    "polywigner.mitsuba.load_scene, which keeps ids"
                )
        return Motion(
            {number: found[name] for number, name in self.shapes.items() if name in found},
            {number: found[name] for number, name in self.lights.items() if name in found},
            found.get(self.receiver, np.zeros(3)),
        )


def _number(kind: str, thing: Any) -> int:
    return int(np.ravel(np.array(number_of(kind, thing)))[0])


def _velocity(name: str, value: ArrayLike) -> Floats:
    try:
        found = real_numbers(value)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise ArgumentError(
            f"expected the velocity of {name!r} as three finite numbers in m/s, got {value!r}"
        )
    return found


def _longest_path(integrator: Any) -> int:
    """Longest path of an integrator, by its own parameters."""
    if integrator is None:
        return _NO_LIMIT
    if integrator.class_name() == "DirectIntegrator":
        return 2
    depth = depths_of(integrator)["max_depth"]
    return depth if 0 < depth < _NO_LIMIT else _NO_LIMIT


def _described(
    cloud: Cloud, names: _Names, motion: Motion | None, unit: float, about: dict[str, Any]
) -> xarray.Dataset:
    events, along, in_space = cloud.events, ("scatterer",), ("scatterer", "axis")
    shapes, lights = _named(names.shapes, events.first_shape), _named(names.lights, events.light)
    values: dict[str, tuple[Any, tuple[str, ...], str, str]] = {
        "position": (unit * events.place, in_space, "m", "first surface that the receiver sees"),
        "normal": (events.normal, in_space, "1", "normal of the first surface"),
    }
    if motion is not None:
        speeds = np.zeros_like(events.place)
        for number, velocity in motion.shapes.items():
            speeds[events.first_shape == number] = unit * velocity
        values["velocity"] = (speeds, in_space, "m/s", "velocity of the first surface")
    values |= {
        "power": (cloud.power, along, "W", "power towards the receiver"),
        "intensity": (cloud.intensity, along, "W/sr", "radiant intensity towards the receiver"),
        "path_length": (unit * events.length, along, "m", "path from emitter to receiver"),
        "bounces": (events.bounces, along, "1", "surfaces on the path"),
        "shape": (shapes, along, "", "id of the first surface"),
        "emitter": (lights, along, "", "id of the light"),
    }
    if motion is not None:
        values["path_rate"] = (unit * events.rate, along, "m/s", "growth of the path per second")
    axes = {"axis": labelled_array(np.array(["x", "y", "z"]), ("axis",))}
    return described(values, axes, about)


def _named(names: dict[int, str], numbers: NDArray[np.int64]) -> NDArray[np.str_]:
    unique, inverse = np.unique(numbers, return_inverse=True)
    texts = np.array([names.get(int(n), "") for n in unique] or [""], np.str_)
    return np.asarray(texts[inverse.reshape(numbers.shape)])
