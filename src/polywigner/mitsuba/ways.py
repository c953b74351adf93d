"""What passes on ways of light by flat mirrors, of one ray or of arrays of them.

Rays pass null surfaces with what these let through, lose in fog what it scatters and absorbs, and
end at anything else but the mirrors that they are to meet.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = ["share_unobstructed", "trace_way"]

# More null surfaces than this on a way count as a wall.
_MOST_PASSED = 64
# Places in fog between two surfaces, of which uneven fog is the mean.
_IN_FOG = 32
# Directions agree within this, in rad.
_STRAIGHT = 1e-3
# Wavelengths of colours, in nm, of variants that have some.
_COLOURS = (450.0, 520.0, 590.0, 660.0)

Plane = tuple[Any, Any, float]


def trace_way(
    scene: Any,
    medium: Any,
    normal: Any,
    planes: Sequence[Plane],
    rounding: float,
    points: list[Any],
) -> Any:
    """The share of power that passes from the last to the first of the points.

    ``medium``: fog at the first, or None. ``normal``: of its surface. ``planes``: shape, normal and
    offset of the mirrors at the points between, which are met within ``rounding``.
    """
    it = dr.zeros(mi.SurfaceInteraction3f)
    it.p, it.n = points[0], normal
    if dr.size_v(type(it.wavelengths)):
        it.wavelengths = type(it.wavelengths)(*_COLOURS)
    if dr.is_jit_v(mi.Float):
        medium = mi.MediumPtr(medium)
    share = mi.Float(1.0)
    for plane, point in zip(planes, points[1:-1], strict=True):
        ray = it.spawn_ray(it.spawn_ray_to(point).d)  # ends behind the mirror
        it, passed, medium = _first_surface(scene, ray, medium, plane, rounding)
        met = _is_shape(it, plane[0]) & (_is_apart(it.p, plane, rounding) == mi.Bool(False))
        if not dr.any(met):
            return mi.Float(0.0)
        share = share * dr.select(met, passed * _reflectance(it, met), 0.0)
    it, passed, _ = _first_surface(scene, it.spawn_ray_to(points[-1]), medium)
    return dr.select(it.is_valid(), 0.0, share * passed)


def share_unobstructed(scene: Any, si: Any, point: Any) -> Any:
    """The share of power that passes from a point to a surface, through null surfaces, no fog."""
    medium = mi.MediumPtr(None) if dr.is_jit_v(mi.Float) else None
    it, passed, _ = _first_surface(scene, si.spawn_ray_to(point), medium)
    return dr.select(it.is_valid(), 0.0, passed)


def _first_surface(
    scene: Any, ray: Any, medium: Any, plane: Plane | None = None, rounding: float = 0.0
) -> tuple[Any, Any, Any]:
    """The first surface that is not null, or lies in a mirror's plane; what passes; its fog."""
    share, moves = mi.Float(1.0), mi.Bool(True)
    for _ in range(_MOST_PASSED):
        si = scene.ray_intersect(ray)
        share = dr.select(moves, share * _through_fog(medium, ray, si), share)
        moves = moves & si.is_valid()
        if plane is not None:
            moves = moves & _is_apart(si.p, plane, rounding)
        if not dr.any(moves):
            break
        moves = moves & mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Null)
        if not dr.any(moves):
            break
        passed = _mean(si.bsdf().eval_null_transmission(si, moves))
        share = dr.select(moves, share * passed, share)
        medium = _behind(si, ray.d, medium, moves)
        onwards = si.spawn_ray(ray.d)
        onwards.maxt = ray.maxt - si.t
        ray = dr.select(moves, onwards, ray)
    return si, share, medium


def _through_fog(medium: Any, ray: Any, si: Any) -> Any:
    """What fog leaves of the light between the start of a ray and what it meets."""
    is_jit = dr.is_jit_v(mi.Float)
    is_there = medium != mi.MediumPtr(None) if is_jit else medium is not None
    length = dr.minimum(si.t, ray.maxt)
    is_there = is_there & (length < dr.largest(mi.Float32) if is_jit else dr.isfinite(length))
    if not dr.any(is_there):
        return mi.Float(1.0)
    length = dr.select(is_there, length, 0.0)
    place = dr.zeros(mi.MediumInteraction3f)
    place.wavelengths = ray.wavelengths
    depth: Any = 0.0
    for step in range(_IN_FOG):
        along = (step + 0.5) / _IN_FOG
        place.p = ray.o + ray.d * (length * (dr.opaque(mi.Float, along) if is_jit else along))
        depth = depth + medium.get_scattering_coefficients(place, is_there)[2]
        dr.eval(depth)  # one small kernel, again and again
    return dr.select(is_there, _mean(dr.exp(-depth * (length / _IN_FOG))), 1.0)


def _behind(si: Any, direction: Any, medium: Any, active: Any) -> Any:
    """The fog behind a surface."""
    changes = active & si.is_medium_transition()
    if not dr.is_jit_v(mi.Float):
        return si.target_medium(direction) if changes else medium
    return dr.select(changes, si.target_medium(direction), medium)


def _is_apart(point: Any, plane: Plane, rounding: float) -> Any:
    _, normal, offset = plane
    return dr.abs(dr.dot(point, normal) - offset) > rounding


def _reflectance(si: Any, active: Any) -> Any:
    """Of the smooth lobe, in power; zero where a normal map turns it elsewhere."""
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.DeltaReflection
    sample, weight = si.bsdf().sample(context, si, 0.5, mi.Point2f(0.5), active)
    arrived = si.to_world(si.wi)
    mirrored = 2 * dr.dot(arrived, si.n) * si.n - arrived
    is_there = active & (dr.norm(si.to_world(sample.wo) - mirrored) < _STRAIGHT)
    return dr.select(is_there, _mean(weight), 0.0)


def _mean(spectrum: Any) -> Any:
    """Over colours: pictures and received powers are means of them too."""
    return dr.mean(mi.unpolarized_spectrum(spectrum))


def _is_shape(si: Any, shape: Any) -> Any:
    return si.shape == mi.ShapePtr(shape) if dr.is_jit_v(mi.Float) else si.shape is shape
