"""One step of paths that leave a receiver: to the next surface, to a light, and on from there."""

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
from polywigner.mitsuba.scenes.surfaces import Reaches

SAMPLES = 6
"""Uniform numbers for a step: of a light (2), a direction (3), and the end of a path."""

# From this bounce on, paths end by chance in proportion to what they carry, as in Mitsuba.
_ROULETTE = 5
_SURVIVORS = 0.95
# The integral of the eye's sensitivity over wavelengths, in nm, as Mitsuba's films have it.
_CIE_Y = 106.7502593994140625


def number_of(kind: str, thing: Any) -> Drjit:
    """The number by which rays know a shape ("Shape") or light ("Emitter"); 0: none."""
    if not dr.is_jit_v(mi.Float):
        return 0 if thing is None else id(thing)
    return dr.reinterpret_array(mi.UInt32, getattr(mi, f"{kind}Ptr")(thing))


@dataclass
class Paths:
    """Where paths are; one path in a scalar variant."""

    ray: Any
    active: Any
    carried: Any
    """Radiance here per radiance at the next surface: a spectrum."""
    bounces: Any
    last: Any
    """The surface of the last bounce."""
    density: Any
    """Probability density of the direction, per solid angle."""
    is_smooth: Any
    """Whether no sample of a light can take this direction."""

    @classmethod
    def along(cls, ray: Any, share: Any, zero: Any) -> Paths:
        """Start paths with rays from a receiver, weights for colours included."""
        there = zero == 0.0
        none = dr.zeros(mi.SurfaceInteraction3f, dr.width(zero))
        return cls(ray, there, mi.Spectrum(share) + zero, mi.UInt32(zero), none, zero, there)


class Steps:
    """The steps of all paths in a scene, whose coherent sources are unseen."""

    def __init__(self, scene: Any, most_bounces: int, meets_lights: bool) -> None:
        self._scene, self._most = scene, most_bounces
        self._meets_lights = meets_lights
        self._context = mi.BSDFContext()
        self._tracer = RayTracer(scene, mi.is_polarized, coherent=False)
        self._reaches = Reaches(scene)

    def __call__(self, paths: Paths, samples: list[Any]) -> tuple[Paths, dict[str, Drjit]]:
        """Continue paths behind the next surface; return surfaces met and lights sampled there."""
        scene, active = self._scene, paths.active
        si = scene.ray_intersect(paths.ray, active)
        is_met = active & si.is_valid()
        found = {
            "is_met": is_met,
            "t": si.t,
            "p": si.p,
            "n": si.n,
            "d": paths.ray.d,
            "shape": number_of("Shape", si.shape),
        }
        if self._meets_lights:
            found |= self._met(paths, si)
        if not dr.is_jit_v(mi.Float) and not is_met:
            paths.active = False
            return paths, found | {"sampled": 0.0, "is_bounce": False}
        bsdf = si.bsdf()
        found |= self._sampled(paths, si, bsdf, is_met, mi.Point2f(*samples[:2]))
        paths, is_bounce = self._onwards(paths, si, bsdf, is_met, samples[2:])
        return paths, found | {"is_bounce": is_bounce}

    def _met(self, paths: Paths, si: Any) -> dict[str, Drjit]:
        """The light that rays meet: radiance along the path, and the number of the light."""
        light = si.emitter(self._scene, paths.active)
        if not dr.is_jit_v(mi.Float) and light is None:
            return {"met": 0.0, "met_light": 0, "is_met_far": False}
        seen = mi.DirectionSample3f(self._scene, si, paths.last)
        asked = paths.active & (paths.is_smooth ^ True)
        other = self._scene.pdf_emitter_direction(paths.last, seen, asked)
        both = paths.density + other
        share = dr.select(paths.is_smooth, 1.0, paths.density / dr.select(both > 0.0, both, 1.0))
        value = _brightness(paths.carried * light.eval(si, paths.active), si)
        return {
            "met": dr.select(paths.active, value * share, 0.0),
            "met_light": number_of("Emitter", light),
            "is_met_far": si.is_valid() ^ True,
        }

    def _sampled(
        self, paths: Paths, si: Any, bsdf: Any, is_met: Any, sample: Any
    ) -> dict[str, Drjit]:
        """A light that the surface scatters: radiance along the path, its number and distance."""
        scatters = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        active = is_met & scatters & (paths.bounces < self._most)
        if not dr.is_jit_v(mi.Float) and not active:
            return {"sampled": 0.0}
        seen, weight = self._scene.sample_emitter_direction(si, sample, False, active)
        active = active & (seen.pdf > 0.0)
        if not dr.is_jit_v(mi.Float) and not active:
            return {"sampled": 0.0}
        towards = si.to_local(seen.d)
        value, density = bsdf.eval_pdf(self._context, si, towards, active)
        value = si.to_world_mueller(value, -towards, si.wi)
        share = dr.select(seen.delta, 1.0, seen.pdf / (seen.pdf + density))
        passed = self._tracer.unobstructed(si, seen.p)
        if mi.is_polarized:
            weight = passed * weight
        else:
            share = share * passed
        light = seen.emitter
        return {
            "sampled": dr.select(
                active, _brightness(paths.carried * value * weight, si) * share, 0.0
            ),
            "light": number_of("Emitter", light),
            "is_far": mi.has_flag(light.flags(), mi.EmitterFlags.Infinite),
            "to_light": seen.dist,
            "light_d": seen.d,
        }

    def _onwards(
        self, paths: Paths, si: Any, bsdf: Any, is_met: Any, samples: list[Any]
    ) -> tuple[Paths, Drjit]:
        """Paths in directions that the surface scatters to, and whether they have bounced."""
        one, direction = samples[0], mi.Point2f(*samples[1:3])
        sample, weight = bsdf.sample(self._context, si, one, direction, is_met)
        weight = si.to_world_mueller(weight, -sample.wo, si.wi)
        passes = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        is_bounce = is_met & (passes ^ True)
        carried = paths.carried * weight
        bounces = paths.bounces + dr.select(is_bounce, mi.UInt32(1), mi.UInt32(0))
        largest = dr.max(mi.unpolarized_spectrum(carried))
        active = is_met & (largest > 0.0) & (bounces < self._most + self._meets_lights)
        likely = dr.select(largest < _SURVIVORS, largest, _SURVIVORS)
        survives = dr.select(bounces >= _ROULETTE, likely, 1.0)
        active = active & (samples[3] < survives)
        carried = carried * (1.0 / dr.select(survives > 0.0, survives, 1.0))
        smooth = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        following = Paths(
            self._reaches.leave(si, si.to_world(sample.wo)),
            active,
            carried,
            bounces,
            dr.select(is_bounce, si, paths.last),
            dr.select(is_bounce, sample.pdf, paths.density),
            dr.select(is_bounce, smooth, paths.is_smooth),
        )
        return following, is_bounce


def _brightness(spectrum: Any, si: Any) -> Drjit:
    """The radiance of all colours, as films of one channel take it."""
    value = mi.luminance(mi.unpolarized_spectrum(spectrum), si.wavelengths)
    return value / _CIE_Y if dr.size_v(type(si.wavelengths)) else value


Floats = NDArray[np.float64]

# A path that passes more null surfaces is lost; Mitsuba's rays are as patient.
_MOST_STEPS = 1024


@dataclass(frozen=True)
class Motion:
    """Velocities in scene units per second, by the numbers of shapes and lights that have one."""

    shapes: dict[int, Floats]
    lights: dict[int, Floats]
    receiver: Floats


EVENT = np.dtype(
    [
        ("ray", np.int64),  # number of the ray that left the receiver
        ("radiance", np.float64),  # along that ray
        ("place", np.float64, 3),  # of the first surface
        ("normal", np.float64, 3),
        ("first_shape", np.int64),  # number of the first surface's shape
        ("distance", np.float64),  # to the first surface
        ("length", np.float64),  # of the whole path
        ("rate", np.float64),  # by which the path grows, per second
        ("bounces", np.int64),
        ("light", np.int64),  # number of the light
    ]
)
"""Light found along a path; lengths in scene units."""

Events = Any
"""Record array (n,) of `EVENT`."""


def events_of(
    scene: Any,
    paths: Any,
    rng: np.random.Generator,
    first: Floats,
    most_bounces: int,
    meets_lights: bool,
    motion: Motion | None,
) -> Iterator[Events]:
    """The events of paths, all in one, or a list of single ones in a scalar variant, step by step.

    ``first`` : (n, 2) uniform numbers for the lights at the first surface.
    """
    state: Events = np.zeros(len(first), EVENT).view(np.recarray)  # the next event of each ray
    state.ray = np.arange(len(first))
    speeds = np.tile(np.zeros(3) if motion is None else motion.receiver, (len(first), 1))
    yield state[:0]
    for alive, found in _walk(paths, rng, first, Steps(scene, most_bounces, meets_lights)):
        here = _arrived(state[alive], found)
        own = speeds[alive]
        if motion is not None:
            before, own = own, _looked_up(motion.shapes, found["shape"])
            here.rate += _dot(own - before, found["d"])
        yield from _lights(here, found, own, motion)
        bounced = found["is_bounce"]
        # null surfaces leave path and first surface open
        state.length[alive] = here.length
        here.bounces += 1
        state[alive[bounced]] = here[bounced]
        speeds[alive[bounced]] = own[bounced]


def _arrived(here: Events, found: dict[str, Any]) -> Events:
    """Move events to the next surface, which is the first one of paths without a bounce."""
    here.length += np.where(found["is_met"], found["t"], 0.0)
    # to the side that the receiver looks at
    facing = -np.sign(_dot(found["n"], found["d"]))[:, None]
    is_first = here.bounces == 0
    values = {"place": found["p"], "normal": facing * found["n"], "first_shape": found["shape"]}
    for name, value in (values | {"distance": here.length}).items():
        here[name][is_first] = value[is_first]
    return here


def _lights(
    here: Events, found: dict[str, Any], own: Floats, motion: Motion | None
) -> Iterator[Events]:
    """Events at the surfaces that paths have come to."""
    lit = found["sampled"] != 0.0
    if lit.any():
        event, seen = here[lit], {name: value[lit] for name, value in found.items()}
        if motion is not None:
            apart = _looked_up(motion.lights, seen["light"]) - own[lit]
            event.rate += np.where(seen["is_far"], 0.0, _dot(apart, seen["light_d"]))
        event.radiance, event.light = seen["sampled"], seen["light"]
        event.length += np.where(seen["is_far"], np.inf, seen["to_light"])
        event.bounces += 1
        yield event
    if "met" in found:
        far = found["is_met_far"]
        # what is seen of a sky has no place
        met = (found["met"] != 0.0) & ~(far & (here.bounces == 0))
        event = here[met]
        event.radiance, event.light = found["met"][met], found["met_light"][met]
        event.length[far[met]] = np.inf
        yield event


def _walk(
    paths: Any, rng: np.random.Generator, first: Floats, steps: Steps
) -> Iterator[tuple[Drjit, dict[str, Drjit]]]:
    """Yield the numbers of rays and their events of each step."""
    count = len(first)
    alive = np.arange(count)
    for number in range(_MOST_STEPS):
        draws = rng.random((count, SAMPLES))
        if number == 0:
            draws[:, :2] = first
        draws = np.minimum(draws, np.nextafter(np.float32(1.0), np.float32(0.0)))
        if dr.is_jit_v(mi.Float):
            paths, found = steps(paths, [mi.Float(column.tolist()) for column in draws.T])
            dr.eval(paths, found)
            yield alive, {name: _column(value, count) for name, value in found.items()}
            if not dr.any(paths.active):
                return
        else:
            pairs = [
                steps(paths[k], row) for k, row in zip(alive, draws[alive].tolist(), strict=True)
            ]
            yield alive, _columns([found for _, found in pairs])
            for k, (path, _) in zip(alive, pairs, strict=True):
                paths[k] = path
            alive = alive[[path.active for path, _ in pairs]]
            if not len(alive):
                return


def _column(value: Any, count: int) -> NDArray[Any]:
    """(n,) or (n, 3) of one of Mitsuba's arrays."""
    array = np.array(value)
    if array.dtype.kind == "f":
        array = array.astype(np.float64)
    elif array.dtype.kind in "iu":
        array = array.astype(np.int64)
    array = array.T
    return np.broadcast_to(array, (count, *array.shape[1:]))


def _columns(found: list[dict[str, Any]]) -> dict[str, NDArray[Any]]:
    """Transpose rows to columns; missing values become zero."""
    names = {name: value for row in found for name, value in row.items()}
    return {
        name: np.array([np.array(row.get(name, np.zeros_like(value))) for row in found])
        for name, value in names.items()
    }


def _looked_up(table: dict[int, Floats], numbers: NDArray[np.int64]) -> Floats:
    result = np.zeros((len(numbers), 3))
    for number, velocity in table.items():
        result[numbers == number] = velocity
    return result


def _dot(one: Floats, other: Floats) -> Floats:
    return np.einsum("ij,ij->i", one, other)
