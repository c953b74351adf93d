"""Shares of power that pass on ways of light between two sources, straight and by flat mirrors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, SceneError
from polywigner.geometry.silhouettes import Obstacles
from polywigner.mitsuba.diffraction import before_plane, bodies_of, in_frame
from polywigner.mitsuba.mirrors import Mirror, Plane, surface_of, trace_way
from polywigner.mitsuba.placement import Frame, PlacedSource
from polywigner.mitsuba.polarisation import turned
from polywigner.mitsuba.sampling import cells_with_field
from polywigner.propagation.equivalent_points import RadiatingPoint, radiating_points
from polywigner.propagation.shadows import diffracted

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mesh = tuple[Floats, NDArray[np.intp]]
"""Corners (n, 3) and triangles (t, 3)."""

RAYS = 4096
# A hit lies in the plane of a mirror within this, relative to the coordinates: Mitsuba starts rays
# 1e-4 off a surface.
_IN_PLANE = 1e-4


def passing_share(
    scene: Any, emitter: PlacedSource, receiver: PlacedSource, chain: Sequence[Mirror] = ()
) -> Floats:
    """The mean share of power that arrives by these mirrors, of 4096 rays: (1, 1)."""
    share: Floats = passing_rays(scene, emitter, receiver, chain)[1].sum(axis=0) / RAYS
    return share


def passing_rays(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    chain: Sequence[Mirror] = (),
    bare: bool = False,
) -> tuple[list[Floats], Floats]:
    """Rays that leave, meet all mirrors' planes and arrive, and the share of power (n, k, k).

    Of 4096 rays their places (n, 3), in m, on the receiver, on mirrors from the last to the first,
    and on ``emitter``, itself, not its image. k is 4 in polarised variants: Mueller matrix between
    the axes x and y of both ends. ``bare``: without Fresnel's reflectances and polarisations.
    """
    way = _way(emitter, receiver, chain)
    if way is None:
        return [], _none()
    start, end = way[-1], way[0]
    leaves = np.einsum("ij,j->i", way[-2] - start, emitter.normal) > 0
    arrives = np.einsum("ij,j->i", way[1] - end, receiver.normal) > 0
    valid = leaves & arrives & np.all([np.isfinite(point).all(axis=1) for point in way], axis=0)
    if not valid.any():
        return [], _none()
    rays = [point[valid] for point in way]
    scaled = [ray / receiver.scene_unit for ray in rays]
    return rays, _passed(scene, scaled, receiver, chain, emitter, bare)


def _none() -> Floats:
    """Shares of no rays."""
    size = 4 if mi.is_polarized else 1
    return np.zeros((0, size, size))


def _way(
    emitter: PlacedSource, receiver: PlacedSource, chain: Sequence[Mirror]
) -> list[Floats] | None:
    """Places (4096, 3) on the receiver, on mirrors from the last to the first, on the emitter."""
    draws = _draws(RAYS)
    start = emitter.points(_places(emitter, draws[:, :2]))
    end = receiver.points(_places(receiver, draws[:, 2:]))
    found = corners(start, end, chain)
    return None if found is None else [end, *found, start]


# Error of |F|^2 over its peak, of points in place of either end.
_OF_POINTS = 1e-6
# Mirrors are looked at from so near, as a share of the way.
_CLOSE = 1e-3
# Half the distance in wavelengths of values whose difference is a derivative: errors of 7e-8.
_OFF = 1e-4


def diffracted_share(
    meshes: list[Mesh],
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    chain: Sequence[Mirror],
) -> Floats:
    """The share of power that arrives by these mirrors over the edges of obstacles: (k, k)."""
    met: Floats = meeting_rays(scene, emitter, receiver, chain)[1].sum(axis=0) / RAYS
    return met * abs(diffracted_ratio(meshes, emitter, receiver, chain)) ** 2 if met.any() else met


def diffracted_ratio(
    meshes: list[Mesh], emitter: PlacedSource, receiver: PlacedSource, chain: Sequence[Mirror]
) -> complex:
    """b/b_0 of the links with obstacles and without, by points in place of both ends."""
    wavelength = receiver.wavelength
    image = emitter.image(chain)
    if chain:
        meshes = _unfolded(meshes, emitter, receiver, chain)
    pose = image.pose_of(receiver)
    bodies = Obstacles([in_frame(body, image.pose, 1.0 / wavelength) for body in bodies_of(meshes)])
    if not bodies.bodies:
        return 1.0
    try:
        ends = [
            radiating_points(end.source, wavelength, end.obliquity, _OF_POINTS)
            for end in (image, receiver)
        ]
    except ArgumentError as error:
        raise SceneError(f"with diffraction: {error}") from None
    mine, taken = ends
    places, weights = _receiving(taken, pose[:3, :3], pose[:3, 3] / wavelength)
    seen = [before_plane(one) for one in bodies.silhouettes([p.place for p in mine])]
    change, free, _ = diffracted(bodies, mine, seen, places, "auto")
    with_edges = np.where(bodies.inside(places), 0.0, free + change)
    return complex((weights @ with_edges) / (weights @ free))


def _receiving(
    points: Sequence[RadiatingPoint], axes: Floats, origin: Floats
) -> tuple[Floats, Complex]:
    """Places (n, 3) at which points take a field, and the weights of its values there.

    By reciprocity the weight of a point's field takes the field's derivative along the normal.
    """
    places = np.array([p.place for p in points]) @ axes.T + origin
    field, slope = (np.array(w) for w in zip(*((p.field, p.slope) for p in points), strict=True))
    if not field.any():
        return places, slope
    rate, off = field * (0.25j / math.pi) / _OFF, _OFF * axes[:, 2]
    return np.concatenate([places + off, places - off]), np.concatenate(
        [0.5 * slope + rate, 0.5 * slope - rate]
    )


def meeting_rays(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    chain: Sequence[Mirror],
    bare: bool = False,
) -> tuple[list[Floats], Floats]:
    """`passing_rays` that meet all mirrors, as they reflect, whatever is between."""
    plain = replace(receiver, medium=None)
    if not chain:
        return passing_rays(mi.load_dict({"type": "scene"}), emitter, plain, bare=bare)
    if mi.is_polarized and not bare:
        raise SceneError(
            f"expected no flat mirrors with diffraction in polarised light, got {chain[0].name!r}; "
            "leave diffraction out, use a variant without polarisation, or let ways interfere"
        )
    way = _way(emitter, receiver, chain)
    if way is None:
        return [], _none()
    valid = np.all([np.isfinite(point).all(axis=1) for point in way], axis=0)
    rays, share = [point[valid] for point in way], np.ones((int(valid.sum()), 1, 1))
    for k, mirror in enumerate(reversed(chain), 1):
        before, place, after = rays[k - 1 : k + 2]
        near = [place + _CLOSE * (before - place), place, place + _CLOSE * (after - place)]
        scaled = [point / receiver.scene_unit for point in near]
        share = share * _passed(scene, scaled, plain, [mirror], emitter, bare)
    return rays, share


def _unfolded(
    meshes: list[Mesh], emitter: PlacedSource, receiver: PlacedSource, chain: Sequence[Mirror]
) -> list[Mesh]:
    """Meshes beside each leg of the way, as the receiver sees them in the last mirror."""
    start, end = (placed.points(np.zeros((1, 2))) for placed in (emitter, receiver))
    met = corners(start, end, chain)
    assert met is not None  # some way meets them all
    way = [start[0], *(corner[0] for corner in reversed(met)), end[0]]
    found = []
    for leg in range(len(chain) + 1):
        own = meshes
        for k in (leg - 1, leg):
            if 0 <= k < len(chain):
                # the side of the mirror where this leg begins or ends
                other = way[leg] if k == leg else way[leg + 1]
                side = math.copysign(1.0, float(other @ chain[k].normal) - chain[k].offset)
                own = [
                    _in_front(*mesh, side * chain[k].normal, side * chain[k].offset) for mesh in own
                ]
        for mirror in chain[leg:]:
            own = [(mirror.image_of(p), f[:, ::-1]) for p, f in own]
        found += [(p, f) for p, f in own if len(f)]
    return found


def _in_front(points: Floats, faces: Any, normal: Floats, offset: float) -> Mesh:
    """The part of a mesh in front of a plane, cut at it."""
    height = points @ normal - offset
    height = np.where(np.abs(height) <= _IN_PLANE * np.abs(points).max(initial=1.0), 0.0, height)
    places, number = list(points), {}
    kept = []

    def cut(a: int, b: int) -> int:
        a, b = min(a, b), max(a, b)
        if (a, b) not in number:
            number[a, b] = len(places)
            share = height[a] / (height[a] - height[b])
            places.append(points[a] + share * (points[b] - points[a]))
        return number[a, b]

    for face in faces[(height[faces] > 0.0).any(axis=1)].tolist():
        ring = []
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            if height[a] >= 0.0:
                ring.append(a)
            if height[a] * height[b] < 0.0:
                ring.append(cut(a, b))
        kept += [[ring[0], ring[k], ring[k + 1]] for k in range(1, len(ring) - 1)]
    return np.array(places), np.array(kept, np.intp).reshape(-1, 3)


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


def corners(start: Floats, end: Floats, chain: Sequence[Mirror]) -> list[Floats] | None:
    """Where the ways meet the mirrors, from the last to the first; nan where one does not."""
    images = [start]
    for mirror in chain:
        images.append(mirror.image_of(images[-1]))
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
    scene: Any,
    way: list[Floats],
    receiver: PlacedSource,
    chain: Sequence[Mirror],
    emitter: PlacedSource,
    bare: bool,
) -> Floats:
    """The share (n, k, k) of each ray that passes; ``way`` in scene units, from the receiver on."""
    rounding = _IN_PLANE * max(float(np.abs(place).max()) for place in way)
    planes = [
        Plane(
            mirror.shape,
            mi.Vector3f(*mirror.normal.tolist()),
            mirror.offset / receiver.scene_unit,
            (surface_of(mirror, True), surface_of(mirror, False)) if bare else None,
        )
        for mirror in reversed(chain)
    ]
    normal = mi.Normal3f(*receiver.normal.tolist())
    frames = [
        Frame(mi, mi.Transform4f(mi.Matrix4f(end.pose.tolist())), np.zeros(2))
        for end in (receiver, emitter)
    ]
    is_jit, polarised = dr.is_jit_v(mi.Float), mi.is_polarized and not bare

    def trace(points: list[Any]) -> Floats:
        share, first, last = trace_way(
            scene, receiver.medium, normal, planes, rounding, points, polarised
        )
        if polarised:
            share = turned(mi, share, (frames[0], first), (frames[1], -last))
        size, colours = (4, dr.size_v(mi.UnpolarizedSpectrum)) if polarised else (1, 1)
        values = np.array(share, np.float64).reshape(size, size, colours, -1)[:, :, 0]
        count = len(way[0]) if is_jit else 1
        return np.broadcast_to(np.moveaxis(values, -1, 0), (count, size, size))

    if is_jit:
        return trace([mi.Point3f(*(mi.Float(c.tolist()) for c in place.T)) for place in way])
    rays = zip(*(place.tolist() for place in way), strict=True)
    return np.concatenate([trace([mi.Point3f(*point) for point in ray]) for ray in rays])


def _rows(points: Any) -> Floats:
    """(n, 2) from a point, or from an array of them."""
    return np.stack([np.ravel(np.array(c, np.float64)) for c in (points.x, points.y)], axis=-1)
