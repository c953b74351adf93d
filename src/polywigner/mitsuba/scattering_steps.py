"""One step of paths that leave a receiver: to the next surface, to a light, and on from there.

Lights are sampled at each surface, as by Mitsuba's integrator ``path``. Light that a ray meets by
itself counts as well, where there are lights but coherent sources; both ways share it by their
densities. Null surfaces let paths pass, and are no bounce.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from polywigner.mitsuba.ways import share_unobstructed

__all__ = ["SAMPLES", "Paths", "Steps", "number_of"]

SAMPLES = 6
"""Uniform numbers for a step: of a light (2), a direction (3), and the end of a path."""

# From this bounce on, paths end by chance in proportion to what they carry, as in Mitsuba.
_ROULETTE = 5
_SURVIVORS = 0.95
# The integral of the eye's sensitivity over wavelengths, in nm, as Mitsuba's films have it.
_CIE_Y = 106.7502593994140625


def number_of(kind: str, thing: Any) -> Any:
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
    """Of the direction, per solid angle."""
    is_smooth: Any
    """Whether no sample of a light can take this direction."""

    @classmethod
    def along(cls, ray: Any, share: Any, zero: Any) -> Paths:
        """Paths that start with rays from a receiver, and that of colours; so many zeros."""
        there = zero == 0.0
        none = dr.zeros(mi.SurfaceInteraction3f, dr.width(zero))
        return cls(ray, there, mi.Spectrum(share) + zero, mi.UInt32(zero), none, zero, there)


class Steps:
    """The steps of all paths in a scene, whose coherent sources are unseen."""

    def __init__(self, scene: Any, most_bounces: int, meets_lights: bool) -> None:
        self._scene, self._most = scene, most_bounces
        self._meets_lights = meets_lights
        self._context = mi.BSDFContext()

    def __call__(self, paths: Paths, samples: list[Any]) -> tuple[Paths, dict[str, Any]]:
        """Paths behind the next surface; what they have met, and the lights sampled there."""
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

    def _met(self, paths: Paths, si: Any) -> dict[str, Any]:
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
    ) -> dict[str, Any]:
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
        share = share * share_unobstructed(self._scene, si, seen.p)
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
    ) -> tuple[Paths, Any]:
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
        survives = dr.select(bounces >= _ROULETTE, _smaller(largest, _SURVIVORS), 1.0)
        active = active & (samples[3] < survives)
        carried = carried * (1.0 / dr.select(survives > 0.0, survives, 1.0))
        smooth = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        following = Paths(
            si.spawn_ray(si.to_world(sample.wo)),
            active,
            carried,
            bounces,
            dr.select(is_bounce, si, paths.last),
            dr.select(is_bounce, sample.pdf, paths.density),
            dr.select(is_bounce, smooth, paths.is_smooth),
        )
        return following, is_bounce


def _smaller(value: Any, limit: float) -> Any:
    return dr.select(value < limit, value, limit)


def _brightness(spectrum: Any, si: Any) -> Any:
    """The radiance of all colours, as films of one channel take it."""
    value = mi.luminance(mi.unpolarized_spectrum(spectrum), si.wavelengths)
    return value / _CIE_Y if dr.size_v(type(si.wavelengths)) else value
