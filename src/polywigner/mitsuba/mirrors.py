"""Flat mirrors of a scene, and the images of sources in them.

A mirror is a plane face of a shape whose BSDF has a smooth lobe of reflection: rectangles, disks
and the faces of meshes. Light that comes by a chain of them comes straight from the image of the
image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import SceneError

__all__ = ["Mirror", "chains_of", "mirrors_of"]

Floats = NDArray[np.float64]

# A body of more faces than this is taken for a curved one.
_MOST_FACES = 32
# Chains of mirrors that are tried: some milliseconds each.
_MOST_CHAINS = 5000
# Departure from a plane, relative to the coordinates: rounding of single precision.
_FLAT = 1e-5
_SMOOTH = int(mi.BSDFFlags.DeltaReflection) | int(mi.BSDFFlags.DeltaTransmission)
# Places on a side of a shape that is looked at.
_PLACES = 5


@dataclass(frozen=True, eq=False)
class Mirror:
    """A plane of the points p with ``normal`` . p = ``offset``, in m."""

    name: str
    shape: Any
    normal: Floats
    offset: float


def mirrors_of(scene: Any, unit: float) -> tuple[list[Mirror], list[str]]:
    """Flat mirrors of a scene in units of ``unit`` metres, and the names of other smooth shapes."""
    mirrors: list[Mirror] = []
    others = []
    for number, shape in enumerate(scene.shapes()):
        flags = shape.bsdf().flags() if shape.bsdf() is not None else 0
        if not flags & _SMOOTH:
            continue
        name = shape.id() or f"shape {number}"
        planes = _planes(shape) if mi.has_flag(flags, mi.BSDFFlags.DeltaReflection) else []
        if not planes or mi.has_flag(flags, mi.BSDFFlags.DeltaTransmission):
            others.append(name)
        for face, (normal, offset) in enumerate(planes):
            own = f"{name}[{face}]" if len(planes) > 1 else name
            mirrors.append(Mirror(own, shape, normal, offset * unit))
    return mirrors, others


def chains_of(mirrors: list[Mirror], most: int) -> Iterator[tuple[Mirror, ...]]:
    """All sequences of one to ``most`` mirrors, none twice in succession, in the light's order.

    Raises SceneError for more than some thousand.
    """
    count = len(mirrors)
    total = sum(count * (count - 1) ** k for k in range(most)) if count else 0
    if total > _MOST_CHAINS:
        raise SceneError(
            f"expected at most {_MOST_CHAINS} chains of flat mirrors, got {total} of {count} "
            f"mirrors with up to {most} reflections; ask for fewer reflections, or make small "
            "mirrors rough"
        )
    chains: list[tuple[Mirror, ...]] = [()]
    for _ in range(most):
        chains = [(*chain, m) for chain in chains for m in mirrors if chain[-1:] != (m,)]
        yield from chains


def _planes(shape: Any) -> list[tuple[Floats, float]]:
    """The planes of all faces of a shape; none if it is curved."""
    params = mi.traverse(shape)
    has_faces = "vertex_positions" in params and "faces" in params
    points, normals = _faces(params) if has_faces else _samples(shape)
    size = max(float(np.abs(points).max(initial=0.0)), 1e-30)
    offsets = np.einsum("ij,ij->i", points, normals)
    planes: list[tuple[Floats, float]] = []
    for normal, offset in zip(normals, offsets, strict=True):
        if not any(_is_same(plane, normal, offset, size) for plane in planes):
            planes.append((normal, float(offset)))
        if len(planes) > (_MOST_FACES if has_faces else 1):
            return []
    return planes


def _is_same(plane: tuple[Floats, float], normal: Floats, offset: float, size: float) -> bool:
    """Whether a face lies in a plane, whichever side it turns to."""
    sign = np.sign(normal @ plane[0])
    apart = np.abs(normal - sign * plane[0]).max()
    return bool(apart <= _FLAT and abs(offset - sign * plane[1]) <= _FLAT * size)


def _faces(params: Any) -> tuple[Floats, Floats]:
    """A corner and the unit normal of each triangle."""
    places = np.array(dr.detach(params["vertex_positions"]), dtype=np.float64).reshape(-1, 3)
    a, b, c = np.moveaxis(places[np.array(params["faces"]).reshape(-1, 3)], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    there = lengths > 0
    return a[there], normals[there] / lengths[there, None]


def _samples(shape: Any) -> tuple[Floats, Floats]:
    """Some points of a shape with their normals."""
    side = (np.arange(_PLACES) + 0.5) / _PLACES
    found = []
    try:
        for x in side.tolist():
            for y in side.tolist():
                sample = shape.sample_position(0.0, mi.Point2f(x, y))
                found.append([np.ravel(np.array(v, np.float64)) for v in (sample.p, sample.n)])
    except RuntimeError:  # a shape that has no such samples: not one of the flat ones
        return np.empty((0, 3)), np.empty((0, 3))
    points, normals = np.moveaxis(np.array(found), 1, 0)
    return points, normals
