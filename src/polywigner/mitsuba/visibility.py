"""Where rays start and end, so that they meet every surface but the one that they leave.

Mitsuba starts a ray 9e-5 (1 + |p|) off a surface and ends a shadow ray 9e-4 of its length before
the light: 9 cm on a path of 100 m, in which it meets no wall. Here a ray ends at a height above
the plane of a source or of a receiver that covers the rounding of single precision alone.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROUNDING = 2.0**-20
"""Height within which a ray may meet the surface at its end, relative to the coordinates: eight
times the last digit of single precision."""

# Shapes whose bounds stand for their faces; a curved one touches a plane in a point.
_FLAT = ("Rectangle", "Disk", "Instance")


def reach_at(scene: Any, corners: Floats) -> float:
    """Return the largest coordinate of an end of a path and of the flat surfaces that touch it.

    Parameters
    ----------
    scene : the ``mi.Scene``.
    corners : (n, 3) points that bound the end, in units of the scene.
    """
    low, high = corners.min(axis=0), corners.max(axis=0)
    result = float(np.abs(corners).max())
    for shape in scene.shapes():
        box = bounds_of(shape)
        size = np.abs(box).max()
        slack = ROUNDING * (size + result)
        if (box[0] > high + slack).any() or (box[1] < low - slack).any():
            continue
        if shape.class_name() in _FLAT:
            result = max(result, float(size))
        elif shape.is_mesh():
            result = max(result, _reach_of_triangles(shape, low - slack, high + slack))
    return result


def _reach_of_triangles(mesh: Any, low: Floats, high: Floats) -> float:
    """Largest coordinate of the triangles whose bounds meet a box; a large triangle rounds more."""
    corners = _vertices(mesh)[np.array(mi.traverse(mesh)["faces"]).reshape(-1, 3)]
    meets = (corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)
    return float(np.abs(corners[meets.all(axis=1)]).max(initial=0.0))


def bounds_of(shape: Any) -> Floats:
    """Return the bounds (2, 3) of a shape; Mitsuba has none for meshes that it has merged."""
    box = shape.bbox()
    if not box.valid() and shape.is_mesh():
        points = _vertices(shape)
        return np.array([points.min(axis=0), points.max(axis=0)])
    found = np.array([box.min, box.max], np.float64)
    return found if box.valid() else np.zeros((2, 3))


def _vertices(mesh: Any) -> Floats:
    points = dr.detach(mi.traverse(mesh)["vertex_positions"])
    return np.array(points, np.float64).reshape(-1, 3)


def largest(point: Any) -> Any:
    """Largest coordinate of a point of Mitsuba."""
    return dr.max(dr.abs(point))


def shadow_end(it: Any, end: Any, normal: Any, reach: Any) -> Any:
    """Return the point to which Mitsuba's ``spawn_ray_to`` sends a ray that ends at a source.

    ``spawn_ray_to`` shortens the ray by a fraction of its length, by which this point is farther.

    Parameters
    ----------
    it : interaction from which the source is looked for.
    end, normal : point of the source, and the unit vector on its front.
    reach : largest coordinate of the source, as of :func:`reach_at`.
    """
    p = dr.detach(it.p)
    short = end + normal * (ROUNDING * (largest(p) + reach))
    start = it.spawn_ray_to(short).o if dr.width(it.n) else p  # a point without a surface
    longer = 1.0 / (1.0 - float(mi.math.ShadowEpsilon))
    # a shift without derivatives: those of the direction are those of the point itself
    return end + dr.detach(start + (short - start) * longer - end)


class Reaches:
    """Largest coordinates of the shapes of a scene, for the rounding of points on them."""

    def __init__(self, scene: Any) -> None:
        self._table: Any = None
        self._sizes: dict[int, float] = {}
        shapes = scene.shapes()
        if dr.is_jit_v(mi.Float) and shapes:
            numbers = [int(_number(mi.ShapePtr(shape))[0]) for shape in shapes]
            self._last = max(numbers)
            sizes = np.zeros(self._last + 1)
            sizes[numbers] = [np.abs(bounds_of(shape)).max() for shape in shapes]
            self._table = mi.Float(sizes.tolist())

    def at(self, si: Any) -> Any:
        """Return the largest coordinate of the shape that a ray has met and of the point."""
        result = largest(si.p)
        if not dr.is_jit_v(mi.Float):
            known = id(si.shape)
            if known not in self._sizes:
                self._sizes[known] = float(np.abs(bounds_of(si.shape)).max())
            return max(result, self._sizes[known])
        if self._table is None:
            return result
        number = _number(si.shape)
        size = dr.gather(mi.Float, self._table, number, number <= self._last)  # else an instance's
        return dr.select(size > result, size, result)

    def leave(self, si: Any, direction: Any) -> Any:
        """Return a ray from a surface, from the side that the direction points to."""
        height = ROUNDING * self.at(si)
        side = dr.mulsign(mi.Vector3f(si.n), dr.dot(si.n, direction))
        return mi.Ray3f(si.p + side * height, direction, si.time, si.wavelengths)


def _number(pointer: Any) -> Any:
    return dr.reinterpret_array(mi.UInt32, pointer)
