"""Flat mirrors of a scene, and the images of sources in them.

A mirror is a plane face of a shape whose BSDF has a smooth lobe of reflection: rectangles, disks
and the faces of meshes. Light that comes by a chain of them comes straight from the image of the
image.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import SceneError

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
    """First surface that is not null or lies in a mirror's plane; transmission; fog behind it."""
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
    """Transmission of fog between the start of a ray and its first surface."""
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
    """Reflectance of the smooth lobe, in power; zero where a normal map turns it."""
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
