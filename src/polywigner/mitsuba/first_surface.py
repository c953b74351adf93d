"""The first surface that a ray meets, null ones left out, inside a renderer."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = ["distance_to_surface"]


def distance_to_surface(m: Any, scene: Any, ray: Any, step: Any, far: Any, active: Any) -> Any:
    """The distance along a ray to the first surface that is not ``null``; ``far`` if there is none.

    Light passes null surfaces, those of sources and the bounds of fog, without a change. ``step``:
    how far behind one of them the ray goes on.
    """
    start, direction = m.Point3f(ray.o), m.Vector3f(ray.d)
    if not dr.is_jit_v(m.Float):
        return _plain_distance(m, scene, start, direction, step, far)
    zero = m.Float(0.0)
    state = (start, zero, m.Bool(active))

    def cond(place: Any, distance: Any, going: Any) -> Any:
        return going

    def body(place: Any, distance: Any, going: Any) -> Any:
        found, is_null = _next(m, scene, m.Ray3f(place, direction), far, going)
        found = dr.select(is_null, found + step, found)
        return m.Point3f(place + direction * found), distance + found, going & is_null

    _, distance, _ = dr.while_loop(state, cond, body, mode="symbolic")
    return distance


def _plain_distance(m: Any, scene: Any, start: Any, direction: Any, step: Any, far: Any) -> Any:
    distance = 0.0
    while True:
        found, is_null = _next(m, scene, m.Ray3f(start, direction), far, True)
        if not is_null:
            return distance + found
        distance += found + step
        start = start + direction * (found + step)


def _next(m: Any, scene: Any, ray: Any, far: Any, active: Any) -> tuple[Any, Any]:
    """Distance to the next surface, and whether that is ``null``."""
    surface = scene.ray_intersect_preliminary(ray, False, active)
    is_hit = surface.is_valid()
    found = dr.select(is_hit, surface.t, far)
    bsdf = surface.shape.bsdf() if dr.is_jit_v(m.Float) or is_hit else None
    if bsdf is None:
        return found, False
    return found, is_hit & _is_null(bsdf.flags())


def _is_null(flags: Any) -> Any:
    """Of a BSDF that does nothing but let light through; one with an opacity is not."""
    return (flags & int(mi.BSDFFlags.All)) == int(mi.BSDFFlags.Null)
