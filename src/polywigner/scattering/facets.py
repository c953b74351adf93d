"""Conducting bodies and plates as triangles, which is all that scattering sees of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, triangulate
from polywigner.geometry.arguments import warn_caller
from polywigner.illumination import Array
from polywigner.scattering.convexity import (
    corners_of_body,
    corners_where_parts_touch,
    is_convex,
    lit_corners,
)
from polywigner.scattering.sheets import least_area

__all__ = ["Body", "Facets", "facets_of", "warn_of_corners"]

Body = Aperture | PlacedAperture | Polyhedron | Array | Sequence[Any]
Floats = NDArray[np.float64]

_EXPECTED = "expected a body (Polyhedron, Aperture, placed Aperture, or an Array or list of these)"


@dataclass(frozen=True, eq=False)
class Facets:
    """Triangles (n,) in space, about the centre of the box around all of them."""

    corner: Floats
    """(n, 3)"""
    first: Floats
    """(n, 3) from the corner to the next one, counter-clockwise seen from outside."""
    second: Floats
    """(n, 3) from the corner to the last one."""
    is_plate: NDArray[np.bool_]
    """(n,) which triangles have two outer sides."""
    casts_shadows: bool
    """Whether one triangle may stand before another."""
    middle: Floats
    """(3,) the centre of the box, in the body's frame."""
    least_face: float
    """Root of the area of the smallest face; facets that join smoothly are one."""
    inner_corners: Floats
    """(m, 2, 3) normals of two faces that see each other from the edge where they meet."""

    @cached_property
    def vector(self) -> Floats:
        """Outward normals times twice the area, (n, 3)."""
        return np.cross(self.first, self.second)

    @cached_property
    def normal(self) -> Floats:
        """Outward unit normals, (n, 3)."""
        return self.vector / np.linalg.norm(self.vector, axis=1, keepdims=True)

    @cached_property
    def corners(self) -> Floats:
        """(n, 3, 3): triangle, corner, component."""
        return self.corner[:, None] + np.stack(
            [np.zeros_like(self.first), self.first, self.second], axis=1
        )

    @cached_property
    def size(self) -> float:
        """Diagonal of the box around all triangles."""
        points = self.corners.reshape(-1, 3)
        return float(np.linalg.norm(np.ptp(points, axis=0)))


def facets_of(body: Any) -> Facets:
    """The triangles of a body; found once for a body that is the same again.

    Raises ArgumentError for anything but bodies and plates of uniform metal.
    """
    return _facets(_parts(body))


def warn_of_corners(facets: Facets, travelling: Floats) -> None:
    """Warn of faces that light each other across an edge, of waves that travel along k (m, 3)."""
    if lit_corners(facets.inner_corners, travelling):
        warn_caller(
            "got faces that light each other across a concave edge: what comes back by two or three"
            " reflections is left out, which is most of it in corner reflectors (docs/rcs.md)"
        )


def _parts(body: Any) -> tuple[Any, ...]:
    if isinstance(body, Array):
        if not (body.weights == 1).all():
            raise ArgumentError(
                "expected an Array of bodies with all weights 1, got others; a conductor has no "
                "weight, so leave the weights out"
            )
        body = body.elements
    if isinstance(body, (Aperture, PlacedAperture, Polyhedron)):
        return (_checked(body),)
    try:
        parts = tuple(body)
    except TypeError:
        raise ArgumentError(f"{_EXPECTED}, got {type(body).__name__}") from None
    if not parts:
        raise ArgumentError(f"{_EXPECTED}, got an empty list")
    return tuple(_checked(part) for part in parts)


def _checked(part: Any) -> Any:
    if not isinstance(part, (Aperture, PlacedAperture, Polyhedron)):
        raise ArgumentError(f"{_EXPECTED}, got {type(part).__name__}")
    outline = part.aperture if isinstance(part, PlacedAperture) else part
    if isinstance(outline, Aperture) and outline.illumination is not None:
        raise ArgumentError(
            "expected a plate without an illumination, got one with; the radar lights it, so take "
            "it off by with_illumination(None)"
        )
    return part


# Hashes of bodies read all of their vertices, some ms for a million; building triangles takes more.
@lru_cache(maxsize=16)
def _facets(parts: tuple[Any, ...]) -> Facets:
    corners, plates = [], []
    for part in parts:
        found = _of_body(part) if isinstance(part, Polyhedron) else _of_plate(part)
        area = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
        found = found[np.abs(area).max(axis=1) > 0]
        corners.append(found)
        plates.append(np.full(len(found), not isinstance(part, Polyhedron)))
    every = np.concatenate(corners)
    low, high = every.min(axis=(0, 1)), every.max(axis=(0, 1))
    middle = low + (high - low) / 2
    every = every - middle
    alone = len(parts) == 1
    plane_or_convex = alone and (plates[0].all() or is_convex(parts[0]))
    first, second = every[:, 1] - every[:, 0], every[:, 2] - every[:, 0]
    is_plate = np.concatenate(plates)
    least = min(least_area(p) if isinstance(p, Polyhedron) else _outline(p).area for p in parts)
    shadows = not plane_or_convex
    inner = np.empty((0, 2, 3))
    if shadows:
        owner = np.repeat(np.arange(len(parts)), [len(found) for found in corners])
        own = [corners_of_body(part) for part in parts if isinstance(part, Polyhedron)]
        inner = np.concatenate([corners_where_parts_touch(every, is_plate, owner), *own])
    root = math.sqrt(least)
    return Facets(every[:, 0], first, second, is_plate, shadows, middle, root, inner)


def _outline(plate: Aperture | PlacedAperture) -> Aperture:
    return plate.aperture if isinstance(plate, PlacedAperture) else plate


def _of_plate(plate: Aperture | PlacedAperture) -> Floats:
    """(n, 3, 3)"""
    pose = plate.pose if isinstance(plate, PlacedAperture) else np.eye(4)
    points, triangles = triangulate(_outline(plate))
    placed: Floats = points @ pose[:3, :2].T + pose[:3, 3]
    return placed[triangles]


def _of_body(body: Polyhedron) -> Floats:
    """(n, 3, 3)"""
    triangles = [face for face in body.faces if len(face) == 3]
    others = [body.vertices[list(face)] for face in body.faces if len(face) > 3]
    found = [_split(points) for points in others]
    return np.concatenate([body.vertices[np.array(triangles, np.intp).reshape(-1, 3)], *found])


def _split(points: Floats) -> Floats:
    """The triangles (n - 2, 3, 3) of a plane polygon (n, 3), which need not be convex."""
    middle = points.mean(axis=0)
    relative = points - middle
    normal = np.cross(relative, np.roll(relative, -1, axis=0)).sum(axis=0)
    _, _, axes = np.linalg.svd(relative, full_matrices=False)
    across = np.cross(normal / np.linalg.norm(normal), axes[0])
    flat = np.column_stack([relative @ axes[0], relative @ across])
    if _turns_left(flat):
        fan = np.arange(1, len(points) - 1)
        return points[np.column_stack([np.zeros_like(fan), fan, fan + 1])]
    kept, triangles = triangulate(Aperture(flat))
    lifted: Floats = middle + kept @ np.stack([axes[0], across])
    return lifted[triangles]


def _turns_left(ring: Floats) -> bool:
    edges = np.roll(ring, -1, axis=0) - ring
    after = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    return bool((turns >= 0).all())
