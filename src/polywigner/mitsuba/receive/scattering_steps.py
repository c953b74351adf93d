"""Paths of rays from a receiver, and the contributions of lights along them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.execution import Drjit
from polywigner.mitsuba.receive.ray_transmission import RayTracer
from polywigner.mitsuba.scenes.surfaces import ShapeExtents, number_of
from polywigner.numerics import Floats

# Random numbers per step: two for a light, three for a direction, one for termination.
_SAMPLES = 6
# Number of bounces before Russian roulette starts, and largest survival probability, as in Mitsuba.
_ROULETTE = 5
_SURVIVORS = 0.95
# Integral of the luminosity function [nm], as in Mitsuba's films.
_CIE_Y = 106.7502593994140625
# Largest number of steps per path, including null surfaces; longer paths are lost.
_MOST_STEPS = 1024


@dataclass
class Paths:
    """State of many paths."""

    ray: Drjit
    active: Drjit
    throughput: Drjit
    """Ratio of the radiance at the receiver to the radiance at the next surface."""
    bounces: Drjit
    last: Drjit
    density: Drjit
    """Probability density of the current direction [1/sr]."""
    is_smooth: Drjit
    """Whether the last bounce was specular, so that light sampling cannot find the direction."""

    @classmethod
    def along(cls, ray: Drjit, weight: Drjit, zero: Drjit) -> Paths:
        """Return paths that start along rays of a receiver; ``zero`` is 0 for each ray."""
        active = zero == 0.0
        none = dr.zeros(mi.SurfaceInteraction3f, dr.width(zero))
        throughput = mi.Spectrum(weight) + zero
        return cls(ray, active, throughput, mi.UInt32(zero), none, zero, active)


class Steps:
    """Function that moves all paths to the next surface; coherent sources must be hidden."""

    def __init__(self, scene: Any, most_bounces: int, meets_lights: bool) -> None:
        self._scene, self._most = scene, most_bounces
        self._meets_lights = meets_lights
        self._context = mi.BSDFContext()
        self._tracer = RayTracer(scene, mi.is_polarized, coherent=False)
        self._extents = ShapeExtents(scene)

    def __call__(self, paths: Paths, samples: list[Drjit]) -> tuple[Paths, dict[str, Drjit]]:
        """Return the paths after the next surface, and the values of this step by name."""
        si = self._scene.ray_intersect(paths.ray, paths.active)
        is_met = paths.active & si.is_valid()
        values = {"is_met": is_met, "t": si.t, "p": si.p, "n": si.n, "d": paths.ray.d}
        values["shape"] = number_of("Shape", si.shape)
        if self._meets_lights:
            values |= self._lights_hit(paths, si)
        bsdf = si.bsdf()
        values |= self._sampled_lights(paths, si, bsdf, is_met, mi.Point2f(*samples[:2]))
        paths, values["is_bounce"] = self._next_paths(paths, si, bsdf, is_met, samples[2:])
        return paths, values

    def _lights_hit(self, paths: Paths, si: Drjit) -> dict[str, Drjit]:
        """Return the lights that rays hit, and their radiances at the receiver with MIS weights."""
        light = si.emitter(self._scene, paths.active)
        direction = mi.DirectionSample3f(self._scene, si, paths.last)
        can_sample = paths.active & (paths.is_smooth ^ True)
        second = self._scene.pdf_emitter_direction(paths.last, direction, can_sample)
        total = paths.density + second
        weight = dr.select(paths.is_smooth, 1.0, paths.density / dr.select(total > 0.0, total, 1.0))
        value = _luminance(paths.throughput * light.eval(si, paths.active), si)
        return {
            "met": dr.select(paths.active, value * weight, 0.0),
            "met_light": number_of("Emitter", light),
            "is_met_far": si.is_valid() ^ True,
        }

    def _sampled_lights(
        self, paths: Paths, si: Drjit, bsdf: Drjit, is_met: Drjit, sample: Drjit
    ) -> dict[str, Drjit]:
        """Sample a light; return its radiance (with the MIS weight), distance and direction.

        ``is_met`` marks paths that meet a surface.
        """
        scatters = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        active = is_met & scatters & (paths.bounces < self._most)
        direction, weight = self._scene.sample_emitter_direction(si, sample, False, active)
        active = active & (direction.pdf > 0.0)
        towards = si.to_local(direction.d)
        value, density = bsdf.eval_pdf(self._context, si, towards, active)
        value = si.to_world_mueller(value, -towards, si.wi)
        balance = dr.select(direction.delta, 1.0, direction.pdf / (direction.pdf + density))
        passed = self._tracer.unobstructed(si, direction.p)
        if mi.is_polarized:
            weight = passed * weight
        else:
            balance = balance * passed
        radiance = _luminance(paths.throughput * value * weight, si) * balance
        return {
            "sampled": dr.select(active, radiance, 0.0),
            "light": number_of("Emitter", direction.emitter),
            "is_far": mi.has_flag(direction.emitter.flags(), mi.EmitterFlags.Infinite),
            "to_light": direction.dist,
            "light_d": direction.d,
        }

    def _next_paths(
        self, paths: Paths, si: Drjit, bsdf: Drjit, is_met: Drjit, samples: list[Drjit]
    ) -> tuple[Paths, Drjit]:
        """Sample new directions at surfaces.

        Return the paths that leave the surfaces, and a mask of the paths that were scattered.
        ``is_met`` marks paths that meet a surface.
        """
        direction = mi.Point2f(*samples[1:3])
        sample, weight = bsdf.sample(self._context, si, samples[0], direction, is_met)
        weight = si.to_world_mueller(weight, -sample.wo, si.wi)
        passes = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        is_bounce = is_met & (passes ^ True)
        throughput = paths.throughput * weight
        bounces = paths.bounces + dr.select(is_bounce, mi.UInt32(1), mi.UInt32(0))
        largest = dr.max(mi.unpolarized_spectrum(throughput))
        active = is_met & (largest > 0.0) & (bounces < self._most + self._meets_lights)
        likely = dr.select(largest < _SURVIVORS, largest, _SURVIVORS)
        survives = dr.select(bounces >= _ROULETTE, likely, 1.0)
        active = active & (samples[3] < survives)
        throughput = throughput * (1.0 / dr.select(survives > 0.0, survives, 1.0))
        smooth = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        following = Paths(
            self._extents.ray_from(si, si.to_world(sample.wo)),
            active,
            throughput,
            bounces,
            dr.select(is_bounce, si, paths.last),
            dr.select(is_bounce, sample.pdf, paths.density),
            dr.select(is_bounce, smooth, paths.is_smooth),
        )
        return following, is_bounce


def _luminance(spectrum: Drjit, si: Drjit) -> Drjit:
    """Return the luminance of a spectrum."""
    value = mi.luminance(mi.unpolarized_spectrum(spectrum), si.wavelengths)
    return value / _CIE_Y if dr.size_v(type(si.wavelengths)) else value


@dataclass(frozen=True)
class Motion:
    """Velocities in scene units per second, by registry number."""

    shapes: dict[int, Floats]
    lights: dict[int, Floats]
    receiver: Floats


EVENT = np.dtype(
    [
        ("ray", np.int64),  # index of the ray from the receiver
        ("radiance", np.float64),  # radiance along the ray
        ("power", np.float64),  # power and radiant intensity at the receiver, set by the caller
        ("intensity", np.float64),
        ("position", np.float64, 3),  # position on the first surface
        ("normal", np.float64, 3),  # normal of the first surface, on the receiver's side
        ("first_shape", np.int64),  # number of the shape of the first surface
        ("distance", np.float64),  # distance to the first surface
        ("length", np.float64),  # length of the complete path
        ("rate", np.float64),  # rate of change of the path length
        ("bounces", np.int64),
        ("light", np.int64),  # number of the light
    ]
)
"""Data type of the contribution of a light to a path, with lengths in scene units."""

Events = Any
_Step = dict[str, NDArray[Any]]


def events_of(
    scene: Any,
    paths: Paths,
    rng: np.random.Generator,
    first: Floats,
    most_bounces: int,
    meets_lights: bool,
    motion: Motion | None,
) -> Iterator[Events]:
    """Trace paths, and yield the events of each step, without powers and intensities.

    ``first`` (n, 2) are uniform random numbers that select the first lights. ``meets_lights`` is
    true if the scene has lights that rays can hit.
    """
    count, steps = len(first), Steps(scene, most_bounces, meets_lights)
    state: Events = np.zeros(count, EVENT).view(np.recarray)
    state.ray = np.arange(count)
    speeds = np.tile(np.zeros(3) if motion is None else motion.receiver, (count, 1))
    yield state[:0]
    for number in range(_MOST_STEPS):
        draws = rng.random((count, _SAMPLES))
        if number == 0:
            draws[:, :2] = first
        draws = np.minimum(draws, np.nextafter(np.float32(1.0), np.float32(0.0)))
        paths, values = steps(paths, [mi.Float(column.tolist()) for column in draws.T])
        dr.eval(paths, values)
        step = {name: _host_array(value, count) for name, value in values.items()}
        here, velocity = _at_surfaces(state.copy(), step), speeds
        if motion is not None:
            velocity = _velocities_of(motion.shapes, step["shape"])
            here.rate += np.vecdot(velocity - speeds, step["d"])
        yield from _events(here, step, velocity, motion)
        bounced = step["is_bounce"]
        # Null surfaces change only path lengths.
        state.length = here.length
        here.bounces += 1
        state[bounced] = here[bounced]
        speeds = np.where(bounced[:, None], velocity, speeds)
        if not dr.any(paths.active):
            return


def _at_surfaces(here: Events, step: _Step) -> Events:
    """Add the distance to the next surface to ``here`` in place, and store the first surfaces."""
    here.length += np.where(step["is_met"], step["t"], 0.0)
    facing = -np.sign(np.vecdot(step["n"], step["d"]))[:, None]
    is_first = here.bounces == 0
    values = {"position": step["p"], "normal": facing * step["n"], "first_shape": step["shape"]}
    for name, value in (values | {"distance": here.length}).items():
        here[name][is_first] = value[is_first]
    return here


def _events(here: Events, step: _Step, velocity: Floats, motion: Motion | None) -> Iterator[Events]:
    """Yield the events of one step at sampled lights, and at lights that rays hit.

    ``velocity`` (n, 3) are the velocities of the surfaces in scene units per second.
    """
    is_sampled = step["sampled"] != 0.0
    if is_sampled.any():
        event, sampled = here[is_sampled], {name: value[is_sampled] for name, value in step.items()}
        if motion is not None:
            relative = _velocities_of(motion.lights, sampled["light"]) - velocity[is_sampled]
            event.rate += np.where(sampled["is_far"], 0.0, np.vecdot(relative, sampled["light_d"]))
        event.radiance, event.light = sampled["sampled"], sampled["light"]
        event.length += np.where(sampled["is_far"], np.inf, sampled["to_light"])
        event.bounces += 1
        yield event
    if "met" in step:
        far = step["is_met_far"]
        # An environment that the receiver sees directly has no position.
        met = (step["met"] != 0.0) & ~(far & (here.bounces == 0))
        event = here[met]
        event.radiance, event.light = step["met"][met], step["met_light"][met]
        event.length[far[met]] = np.inf
        yield event


def _host_array(value: Drjit, count: int) -> NDArray[Any]:
    """Convert a Dr.Jit array to a NumPy array of shape (n,) or (n, k)."""
    array = np.array(value)
    if array.dtype.kind in "fiu":
        array = array.astype(np.float64 if array.dtype.kind == "f" else np.int64)
    array = array.T
    return np.broadcast_to(array, (count, *array.shape[1:]))


def _velocities_of(table: dict[int, Floats], numbers: NDArray[np.int64]) -> Floats:
    """Return the velocities (n, 3) of objects by registry number, or zero for unknown numbers."""
    result = np.zeros((len(numbers), 3))
    for number, velocity in table.items():
        result[numbers == number] = velocity
    return result
