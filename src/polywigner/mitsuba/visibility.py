"""How much of the light between two sources passes the scene, by rays, mirrors on the way included.

Rays run from the receiver to the emitter, between places drawn in proportion to |u|^2 of both. They
pass null surfaces with what these let through, and must meet the mirrors of a chain where the
straight line to the image crosses them. Light does not bend round obstacles here.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.mitsuba.mirrors import Mirror
from polywigner.mitsuba.placed_sources import PlacedSource
from polywigner.mitsuba.sampling import cells_with_field

__all__ = ["RAYS", "passing_share"]

Floats = NDArray[np.float64]

RAYS = 4096
# More null surfaces than this on a way count as a wall.
_MOST_PASSED = 64
# A hit belongs to a mirror within this, relative to the coordinates.
_NEAR = 1e-4
# Directions agree within this, in rad.
_STRAIGHT = 1e-3
# Wavelengths of colours, in nm, of variants that have some.
_COLOURS = (450.0, 520.0, 590.0, 660.0)


def passing_share(
    scene: Any, emitter: PlacedSource, receiver: PlacedSource, chain: Sequence[Mirror] = ()
) -> float:
    """The mean share of power that arrives by these mirrors, of 4096 rays.

    ``emitter`` itself, not its image.
    """
    unit = receiver.scene_unit
    draws = _draws(RAYS)
    start = emitter.points(_places(emitter, draws[:, :2]))
    end = receiver.points(_places(receiver, draws[:, 2:]))
    corners = _corners(start, end, chain)
    if corners is None:
        return 0.0
    way = [end, *corners, start]
    leaves = np.einsum("ij,j->i", way[-2] - start, emitter.normal) > 0
    arrives = np.einsum("ij,j->i", way[1] - end, receiver.normal) > 0
    valid = leaves & arrives & np.all([np.isfinite(point).all(axis=1) for point in way], axis=0)
    if not valid.any():
        return 0.0
    scaled = [point[valid] / unit for point in way]
    return float(_passed(scene, scaled, receiver.normal, chain, unit).sum() / RAYS)


def _draws(count: int) -> Floats:
    """(count, 4) points that fill the unit cube evenly: multiples of powers of one number.

    Source: M. Roberts, "The unreasonable effectiveness of quasirandom sequences" (2018).
    """
    root = 1.1673039782614187  # of x^5 = x + 1
    steps = root ** -np.arange(1.0, 5.0)
    result: Floats = (0.5 + np.arange(count)[:, None] * steps) % 1.0
    return result


def _places(source: PlacedSource, draws: Floats) -> Floats:
    """Places (n, 2) of a source in proportion to |u|^2, in m."""
    cells = cells_with_field(mi, source.source, 1.0)
    if dr.is_jit_v(mi.Float):
        return _rows(cells.sample(mi.Point2f(*(mi.Float(c.tolist()) for c in draws.T))))
    return np.concatenate([_rows(cells.sample(mi.Point2f(*draw))) for draw in draws.tolist()])


def _corners(start: Floats, end: Floats, chain: Sequence[Mirror]) -> list[Floats] | None:
    """Where the ways meet the mirrors, from the last to the first; nan where one does not.

    None where no way meets all of them.
    """
    images = [start]
    for mirror in chain:
        height = images[-1] @ mirror.normal - mirror.offset
        images.append(images[-1] - 2 * height[:, None] * mirror.normal)
    found, place = [], end
    for mirror, image in zip(reversed(chain), reversed(images[1:]), strict=True):
        here, there = (point @ mirror.normal - mirror.offset for point in (place, image))
        crosses = here * there < 0
        if not crosses.any():
            return None
        along = np.where(crosses, here / np.where(crosses, here - there, 1.0), np.nan)
        place = place + along[:, None] * (image - place)
        found.append(place)
    return found


def _passed(
    scene: Any, way: list[Floats], normal: Floats, chain: Sequence[Mirror], unit: float
) -> Floats:
    """The share of each ray that passes; ``way`` in scene units, from the receiver on."""
    near = _NEAR * max(float(np.abs(place).max()) for place in way)
    trace = partial(_traced, scene, normal, chain, unit, near)
    if dr.is_jit_v(mi.Float):
        points = [mi.Point3f(*(mi.Float(c.tolist()) for c in place.T)) for place in way]
        return np.broadcast_to(np.array(trace(points), np.float64), len(way[0]))
    rays = zip(*(place.tolist() for place in way), strict=True)
    return np.array([float(trace([mi.Point3f(*point) for point in ray])) for ray in rays])


def _traced(
    scene: Any,
    normal: Floats,
    chain: Sequence[Mirror],
    unit: float,
    near: float,
    points: list[Any],
) -> Any:
    """The share that passes of one ray, or of an array of them."""
    it = dr.zeros(mi.SurfaceInteraction3f)
    it.p, it.n = points[0], mi.Normal3f(*normal.tolist())
    if dr.size_v(type(it.wavelengths)):
        it.wavelengths = type(it.wavelengths)(*_COLOURS)
    share = mi.Float(1.0)
    for number, mirror in enumerate(reversed(chain), start=1):
        ray = it.spawn_ray(it.spawn_ray_to(points[number]).d)  # ends behind the mirror
        plane = mi.Vector3f(*mirror.normal.tolist()), mirror.offset / unit, near
        it, passed = _first_surface(scene, ray, plane)
        met = _is_shape(it, mirror.shape) & (_is_apart(it.p, plane) == mi.Bool(False))
        if not dr.any(met):
            return mi.Float(0.0)
        share = share * dr.select(met, passed * _reflectance(it, met), 0.0)
    it, passed = _first_surface(scene, it.spawn_ray_to(points[-1]))
    return dr.select(it.is_valid(), 0.0, share * passed)


def _first_surface(scene: Any, ray: Any, plane: Any = None) -> tuple[Any, Any]:
    """The first surface that is not null, or lies in the plane of a mirror; what passes others."""
    share = mi.Float(1.0)
    for _ in range(_MOST_PASSED):
        si = scene.ray_intersect(ray)
        is_null = si.is_valid()
        if plane is not None:
            is_null &= _is_apart(si.p, plane)
        if not dr.any(is_null):
            break
        bsdf = si.bsdf()
        is_null &= mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
        if not dr.any(is_null):
            break
        passed = _mean(bsdf.eval_null_transmission(si, is_null))
        share = dr.select(is_null, share * passed, share)
        onwards = si.spawn_ray(ray.d)
        onwards.maxt = ray.maxt - si.t
        ray = dr.select(is_null, onwards, ray)
    return si, share


def _is_apart(point: Any, plane: Any) -> Any:
    normal, offset, rounding = plane
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


def _rows(points: Any) -> Floats:
    """(n, 2) from a point, or from an array of them."""
    return np.stack([np.ravel(np.array(c, np.float64)) for c in (points.x, points.y)], axis=-1)
