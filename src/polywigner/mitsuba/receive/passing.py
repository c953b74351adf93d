"""Shares of power that pass on ways of light between two sources, straight and by flat mirrors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, SceneError
from polywigner.geometry.silhouettes import Obstacles
from polywigner.mitsuba.plugins.diffraction import before_plane, in_frame
from polywigner.mitsuba.plugins.placement import PlacedSource
from polywigner.mitsuba.plugins.polariser import turned
from polywigner.mitsuba.plugins.samplers import Frame, cells_with_field
from polywigner.mitsuba.receive.ray_transmission import Plane, RayTracer, Transmission
from polywigner.mitsuba.scenes.reflectors import THIN, Mirror, bsdfs_in, surface_of
from polywigner.mitsuba.scenes.surfaces import ROUNDING, bodies_of, bounds_of
from polywigner.propagation.equivalent_points import RadiatingPoint, radiating_points
from polywigner.propagation.shadows import diffracted

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mesh = tuple[Floats, NDArray[np.intp]]
"""Corners (n, 3) and triangles (t, 3)."""

RAYS = 4096
# A hit lies in the plane of a mirror within this, relative to the coordinates.
_IN_PLANE = 4 * ROUNDING


class PassingRays(NamedTuple):
    """Rays that leave a source, meet the planes of all mirrors and arrive."""

    points: list[Floats]
    """Points (n, 3) in m on the receiver, on mirrors from the last to the first, on the emitter."""
    shares: Floats
    """(n, k, k) transmitted power; k is 4 in polarised variants: Mueller matrices between the axes
    x and y of both ends."""
    panes: list[Floats]
    """Matrix (3, 3) of each leg, in the order of light, by which thin panes change a field: the
    mean over rays."""


def passing_share(
    scene: Any, emitter: PlacedSource, receiver: PlacedSource, chain: Sequence[Mirror] = ()
) -> Floats:
    """The mean share of power that arrives by these mirrors, of 4096 rays: (1, 1)."""
    share: Floats = passing_rays(scene, emitter, receiver, chain).shares.sum(axis=0) / RAYS
    return share


def passing_rays(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    chain: Sequence[Mirror] = (),
    coherent: bool = False,
) -> PassingRays:
    """Trace 4096 rays from one source to another by flat mirrors.

    ``emitter`` is the source itself, not its image. ``coherent``: without the polarisation and the
    Fresnel reflectance of mirrors and thin panes.
    """
    way = _way(emitter, receiver, chain)
    if way is None:
        return _none(chain)
    start, end = way[-1], way[0]
    leaves = np.einsum("ij,j->i", way[-2] - start, emitter.normal) > 0
    arrives = np.einsum("ij,j->i", way[1] - end, receiver.normal) > 0
    valid = leaves & arrives & np.all([np.isfinite(point).all(axis=1) for point in way], axis=0)
    if not valid.any():
        return _none(chain)
    rays = [point[valid] for point in way]
    ends = (receiver, emitter)
    return PassingRays(rays, *traced(scene, rays, receiver.medium, ends, chain, coherent))


def _none(chain: Sequence[Mirror]) -> PassingRays:
    size = 4 if mi.is_polarized else 1
    return PassingRays([], np.zeros((0, size, size)), [np.eye(3)] * (len(chain) + 1))


def _way(
    emitter: PlacedSource, receiver: PlacedSource, chain: Sequence[Mirror]
) -> list[Floats] | None:
    """Places (4096, 3) on the receiver, on mirrors from the last to the first, on the emitter."""
    draws = _draws(RAYS)
    start = emitter.points(_places(emitter, draws[:, :2]))
    end = points_on(receiver, RAYS)
    found = corners(start, end, chain)
    return None if found is None else [end, *found, start]


def points_on(receiver: PlacedSource, count: int) -> Floats:
    """Points (n, 3) in m on a receiver in proportion to |u|^2."""
    return receiver.points(_places(receiver, _draws(count)[:, 2:]))


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
    met: Floats = meeting_rays(scene, emitter, receiver, chain).shares.sum(axis=0) / RAYS
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
    coherent: bool = False,
) -> PassingRays:
    """`passing_rays` that meet all mirrors, as they reflect, whatever is between."""
    plain = replace(receiver, medium=None)
    if not chain:
        return passing_rays(mi.load_dict({"type": "scene"}), emitter, plain, coherent=coherent)
    if mi.is_polarized and not coherent:
        raise SceneError(
            f"expected no flat mirrors with diffraction in polarised light, got {chain[0].name!r}; "
            "leave diffraction out, use a variant without polarisation, or let ways interfere"
        )
    way = _way(emitter, receiver, chain)
    if way is None:
        return _none(chain)
    valid = np.all([np.isfinite(point).all(axis=1) for point in way], axis=0)
    rays, share = [point[valid] for point in way], np.ones((int(valid.sum()), 1, 1))
    for k, mirror in enumerate(reversed(chain), 1):
        before, place, after = rays[k - 1 : k + 2]
        near = [place + _CLOSE * (before - place), place, place + _CLOSE * (after - place)]
        share = share * traced(scene, near, None, (plain, None), [mirror], coherent)[0]
    return PassingRays(rays, share, [np.eye(3)] * (len(chain) + 1))


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


def traced(
    scene: Any,
    points: list[Floats],
    medium: Any,
    ends: tuple[PlacedSource, PlacedSource | None],
    chain: Sequence[Mirror],
    coherent: bool = False,
) -> tuple[Floats, list[Floats]]:
    """Trace rays through given points.

    Parameters
    ----------
    scene : the ``mi.Scene``, whose sources are hidden.
    points : (n, 3) each in m: on the receiver, on the mirrors from the last to the first, on the
        emitter.
    medium : fog that the receiver is in.
    ends : receiver and emitter. Rays start and end a little in front of the planes of those that
        the first and last point lie in; None: the point is free.
    chain : mirrors in the order of light.
    coherent : as of :func:`passing_rays`.

    Returns
    -------
    The transmission (n, k, k), and the matrices of thin panes as of :class:`PassingRays`.
    """
    receiver, emitter = ends
    unit = receiver.scene_unit
    way = [point / unit for point in points]
    reach = max(float(np.abs(point).max()) for point in way)
    height = ROUNDING * max(reach, *(end.reach / unit for end in ends if end is not None))
    way[0] = way[0] + height * receiver.normal
    if emitter is not None:
        way[-1] = way[-1] + height * emitter.normal
    planes = [_plane(mirror, unit, reach, coherent) for mirror in reversed(chain)]
    is_jit, polarised = dr.is_jit_v(mi.Float), mi.is_polarized and not coherent
    if emitter is not None:
        across = emitter.middle - receiver.middle
        line = mi.Vector3f(*(across / np.linalg.norm(across)).tolist())
    tracer = RayTracer(scene, polarised, coherent)
    size, count = 4 if polarised else 1, len(way[0])

    def trace(rays: list[Any], count: int) -> tuple[Floats, Floats]:
        found = tracer.trace(medium, planes, rays)
        share = found.share
        if polarised:
            if not chain and emitter is not None:
                # along the line between the centres, as amplitudes count it
                found = found._replace(first=line, last=line)
            share = _between_axes(share, found, ends)
        colours = dr.size_v(mi.UnpolarizedSpectrum) if polarised else 1
        values = np.array(share, np.float64).reshape(size, size, colours, -1)[:, :, 0]
        shares = np.broadcast_to(np.moveaxis(values, -1, 0), (count, size, size))
        legs = [[np.array(column, np.float64) for column in leg] for leg in found.panes]
        legs += [legs[0]] * (len(chain) + 1 - len(legs))  # of rays that miss a mirror
        columns = [[column.reshape(3, -1) for column in leg] for leg in legs]
        matrices = [[np.broadcast_to(c, (3, count)) for c in leg] for leg in columns]
        return shares, np.moveaxis(np.array(matrices), -1, 0)

    if is_jit:
        rays = [mi.Point3f(*(mi.Float(c.tolist()) for c in place.T)) for place in way]
        shares, panes = trace(rays, count)
    else:
        each = [
            trace([mi.Point3f(*point) for point in ray], 1)
            for ray in zip(*(place.tolist() for place in way), strict=True)
        ]
        shares, panes = (np.concatenate(parts) for parts in zip(*each, strict=True))
    weights = np.sqrt(np.maximum(shares[:, 0, 0], 0.0))
    total = weights.sum()
    # rays run against the light: first leg last, and their images of x, y and z are rows for it
    mean = np.einsum("n,nlij->lij", weights, panes)[::-1] / total if total > 0 else panes[0]
    return shares, list(mean)


def _plane(mirror: Mirror, unit: float, reach: float, coherent: bool) -> Plane:
    """The plane of a mirror on paths with coordinates up to ``reach`` in scene units."""
    rounding = _IN_PLANE * max(reach, float(np.abs(bounds_of(mirror.shape)).max()))
    normal = mi.Vector3f(*mirror.normal.tolist())
    surfaces = None
    if coherent or bsdfs_in(mirror.shape.bsdf())[-1].class_name() == THIN:
        surfaces = surface_of(mirror, True), surface_of(mirror, False)
    return Plane(mirror.shape, normal, mirror.offset / unit, rounding, surfaces)


def _between_axes(
    share: Any, found: Transmission, ends: tuple[PlacedSource, PlacedSource | None]
) -> Any:
    """A Mueller matrix between the axes of both ends; of an end without axes, as it is."""
    frames = [
        None
        if end is None
        else Frame(mi, mi.Transform4f(mi.Matrix4f(end.pose.tolist())), np.zeros(2))
        for end in ends
    ]
    leaves = None if frames[1] is None else (frames[1], -found.last)
    return turned(mi, share, (frames[0], found.first), leaves)


def _rows(points: Any) -> Floats:
    """(n, 2) from a point, or from an array of them."""
    return np.stack([np.ravel(np.array(c, np.float64)) for c in (points.x, points.y)], axis=-1)
