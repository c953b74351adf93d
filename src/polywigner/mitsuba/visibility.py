"""How much of the light between two sources passes the scene, by rays, mirrors on the way included.

Rays run from the receiver to the emitter, between places drawn in proportion to |u|^2 of both, and
must meet the mirrors of a chain where the straight line to the image crosses them (module `ways`).
Light does not bend round obstacles here.
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
from polywigner.mitsuba.ways import trace_way

__all__ = ["RAYS", "passing_share"]

Floats = NDArray[np.float64]

RAYS = 4096
# A hit lies in the plane of a mirror within this, relative to the coordinates: Mitsuba starts rays
# 1e-4 off a surface.
_IN_PLANE = 1e-4


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
    return float(_passed(scene, scaled, receiver, chain).sum() / RAYS)


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
    scene: Any, way: list[Floats], receiver: PlacedSource, chain: Sequence[Mirror]
) -> Floats:
    """The share of each ray that passes; ``way`` in scene units, from the receiver on."""
    rounding = _IN_PLANE * max(float(np.abs(place).max()) for place in way)
    planes = [
        (mirror.shape, mi.Vector3f(*mirror.normal.tolist()), mirror.offset / receiver.scene_unit)
        for mirror in reversed(chain)
    ]
    normal = mi.Normal3f(*receiver.normal.tolist())
    trace = partial(trace_way, scene, receiver.medium, normal, planes, rounding)
    if dr.is_jit_v(mi.Float):
        points = [mi.Point3f(*(mi.Float(c.tolist()) for c in place.T)) for place in way]
        return np.broadcast_to(np.array(trace(points), np.float64), len(way[0]))
    rays = zip(*(place.tolist() for place in way), strict=True)
    return np.array([float(trace([mi.Point3f(*point) for point in ray])) for ray in rays])


def _rows(points: Any) -> Floats:
    """(n, 2) from a point, or from an array of them."""
    return np.stack([np.ravel(np.array(c, np.float64)) for c in (points.x, points.y)], axis=-1)
