"""Specular paths between emitters and receivers, their transmission, and diffraction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.execution import Drjit
from polywigner.geometry.silhouettes import Obstacles
from polywigner.mitsuba.plugins.placement import FacingParts, PlacedSource, facing_parts
from polywigner.mitsuba.plugins.polariser import axis_rotation, mueller_matrix
from polywigner.mitsuba.plugins.registration import scene_errors
from polywigner.mitsuba.plugins.samplers import Frame, cells_with_field
from polywigner.mitsuba.receive.ray_transmission import (
    Plane,
    RayTracer,
    Transmission,
    point_batches,
)
from polywigner.mitsuba.scenes.reflectors import (
    THIN,
    Chain,
    Mirror,
    bsdfs_in,
    reflected,
    surface_of,
)
from polywigner.mitsuba.scenes.surfaces import (
    ROUNDING,
    before_plane,
    bodies_of,
    bounds_of,
    in_frame,
    meshes_in,
)
from polywigner.numerics import Complex, Floats
from polywigner.propagation.equivalent_points import RadiatingPoint, radiating_points
from polywigner.propagation.shadows import diffracted
from polywigner.source.polarisation import ludwig_axes

Mesh = tuple[Floats, NDArray[np.intp]]
"""Vertices (n, 3) of a mesh, and vertex indices (t, 3) of its triangles."""

# Tolerance for points in the plane of a mirror, relative to the coordinates.
_IN_PLANE = 4 * ROUNDING


def _ray_count() -> int:
    """Return the number of rays between two sources."""
    return 4096 if dr.is_jit_v(mi.Float) else 1024


class PassingRays(NamedTuple):
    """Rays from an emitter via mirrors to a receiver."""

    points: list[Floats]
    """Points on the receiver, on the mirrors in reverse order, and on the emitter, in m."""
    fractions: Floats
    """Transmission of each ray, shape (n, 1, 1), or Mueller matrices, shape (n, 4, 4)."""
    panes: list[Floats]
    """Mean matrix (3, 3) of the panes on each segment, which multiplies the electric field."""

    @property
    def power(self) -> Floats:
        """Mean power transmission including blocked rays, shape (1, 1) or (4, 4)."""
        return np.asarray(self.fractions.sum(axis=0) / _ray_count())

    @property
    def amplitude(self) -> float:
        """Mean square root of the transmission, including blocked rays.

        If mirrors form a corner, each order of the mirrors reflects only a part of the rays, and
        the values of all orders add up to the value of the corner.
        """
        return float(np.sqrt(self.fractions[:, 0, 0]).sum() / _ray_count())


def passing_rays(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    chain: Sequence[Mirror] = (),
    coherent: bool = False,
) -> PassingRays:
    """Trace 4096 rays, or 1024 in scalar variants, from an emitter via flat mirrors to a receiver.

    If ``coherent`` is true, the effects of mirrors and panes on the field are excluded.
    """
    points = _rays_between(emitter, receiver, chain)
    leaves = (points[-2] - points[-1]) @ emitter.normal > 0
    arrives = (points[1] - points[0]) @ receiver.normal > 0
    points = [point[leaves & arrives] for point in points]
    if not len(points[0]):  # Empty arrays crash Dr.Jit.
        size = 4 if mi.is_polarized else 1
        return PassingRays(points, np.zeros((0, size, size)), [np.eye(3)] * (len(chain) + 1))
    return PassingRays(points, *trace_rays(scene, points, receiver, emitter, chain, coherent))


def _rays_between(
    emitter: PlacedSource, receiver: PlacedSource, chain: Sequence[Mirror]
) -> list[Floats]:
    """Return the points of rays from an emitter via mirrors to a receiver, as in `points_by`."""
    return points_by(points_on(emitter, slice(0, 2)), points_on(receiver, slice(2, 4)), chain)


def points_by(start: Floats, end: Floats, chain: Sequence[Mirror]) -> list[Floats]:
    """Return the points, in m, of specular rays via the planes of mirrors.

    ``start`` and ``end`` are points (n, 3). The order of the result is: end, mirrors in reverse
    order, start. Rays that miss a plane are omitted.
    """
    images = [start]
    for mirror in chain:
        images.append(mirror.image_of(images[-1]))
    points = [end]
    for mirror, image in zip(reversed(chain), reversed(images[1:]), strict=True):
        here, there = (point @ mirror.normal - mirror.offset for point in (points[-1], image))
        crosses = here * there < 0
        along = np.where(crosses, here / np.where(crosses, here - there, 1.0), np.nan)
        points.append(points[-1] + along[:, None] * (image - points[-1]))
    meets_all = np.isfinite(points[-1]).all(axis=1)
    return [point[meets_all] for point in (*points, start)]


class CentralPath(NamedTuple):
    """Specular path between the centres of an emitter and a receiver."""

    points: Floats
    """Points (n, 3) from the emitter to the receiver in m."""
    panes: list[Floats]
    """Matrix of the panes on each segment, which multiplies the electric field."""

    @classmethod
    def between(
        cls, emitter: PlacedSource, receiver: PlacedSource, chain: Chain, rays: PassingRays
    ) -> CentralPath:
        """Return the path between the centres, or the first ray if this path misses a mirror."""
        points = points_by(emitter.centre[None], receiver.centre[None], chain)
        if not len(points[0]):
            points = rays.points
        return cls(np.array([point[0] for point in reversed(points)]), rays.panes)

    @property
    def length(self) -> float:
        """Length in m."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    @property
    def transmission(self) -> float:
        """Amplitude transmission of the panes on the first segment, RMS over polarisations."""
        along = self.points[1] - self.points[0]
        along /= np.linalg.norm(along)
        across = self.panes[0] @ (np.eye(3) - np.outer(along, along))
        return float(np.linalg.norm(across) / math.sqrt(2.0))

    def arriving(self, jones: Complex, axes: Floats, chain: Sequence[Mirror] = ()) -> Complex:
        """Return the electric field (3,) at the end of the path for a Jones vector at its start.

        The field is in the axes of the scene. The distance changes neither phase nor modulus.
        ``axes`` (3, 3) are the axes of the source in its columns, and the Jones vector is in
        Ludwig's axes.
        """
        steps = np.diff(self.points, axis=0)
        steps /= np.linalg.norm(steps, axis=1)[:, None]
        field = self.panes[0] @ (axes @ (jones @ np.array(ludwig_axes(*(steps[0] @ axes)))))
        for mirror, step, panes in zip(chain, steps, self.panes[1:], strict=False):
            surface = surface_of(mirror, bool(step @ mirror.normal < 0))
            field = panes @ reflected(field, step, mirror.normal, surface)
        return np.asarray(field)


# Tolerance of the far-field pattern of radiating points, relative to its peak.
_POINTS_ERROR = 1e-6
# Distance between a mirror and the ends of its rays, relative to the length of the segment.
_GAP = 1e-3
# Half the step of the central difference that replaces a normal derivative [wavelengths]; the
# relative error is 7e-8.
_STEP = 1e-4


def diffracted_ratio(
    meshes: list[Mesh],
    emitter: PlacedSource,
    receiver: PlacedSource,
    chain: Sequence[Mirror],
    wavelength: float,
) -> complex:
    """Return the ratio b/b_0 of the couplings with and without obstacles, or 1 without obstacles.

    ``emitter`` is the real emitter, not its mirror image. ``meshes`` are the obstacles in the
    scene. Their vertices and the wavelength are in m.
    """
    image = emitter.image(chain)
    if chain:
        meshes = _unfolded(meshes, emitter, receiver, chain)
    pose = image.pose_of(receiver)
    bodies = Obstacles([in_frame(body, image.pose, 1.0 / wavelength) for body in bodies_of(meshes)])
    if not bodies.bodies:
        return 1.0
    with scene_errors("cannot compute the link with diffraction: "):
        emitting, receiving = (
            radiating_points(end.source, wavelength, end.obliquity, _POINTS_ERROR)
            for end in (image, receiver)
        )
    positions, weights = _receiving_points(receiving, pose[:3, :3], pose[:3, 3] / wavelength)
    silhouettes = [
        before_plane(part) for part in bodies.silhouettes([p.position for p in emitting])
    ]
    change, free, _ = diffracted(bodies, emitting, silhouettes, positions, "auto")
    with_edges = np.where(bodies.inside(positions), 0.0, free + change)
    return complex((weights @ with_edges) / (weights @ free))


def _receiving_points(
    points: Sequence[RadiatingPoint], axes: Floats, origin: Floats
) -> tuple[Floats, Complex]:
    """Return the positions at which a receiver samples a field, and the samples' complex weights.

    The positions have the shape (n, 3), and the weights (n,). The positions, and the receiver's
    pose ``axes`` and ``origin``, are in the emitter's frame, in wavelengths. By reciprocity, a
    dipole receives the normal derivative of the field, computed as a finite difference.
    """
    positions = np.array([p.position for p in points]) @ axes.T + origin
    field, slope = (np.array(w) for w in zip(*((p.field, p.slope) for p in points), strict=True))
    if not field.any():
        return positions, slope
    rate, step = field * (0.25j / math.pi) / _STEP, _STEP * axes[:, 2]
    return np.concatenate([positions + step, positions - step]), np.concatenate(
        [0.5 * slope + rate, 0.5 * slope - rate]
    )


def unobstructed_rays(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    chain: Sequence[Mirror],
    coherent: bool = False,
) -> PassingRays:
    """Return the rays of `passing_rays`, as if the scene had no obstacles, panes or fog."""
    plain = replace(receiver, medium=None)
    if not chain:
        return passing_rays(mi.load_dict({"type": "scene"}), emitter, plain, coherent=coherent)
    if mi.is_polarized and not coherent:
        raise SceneError(
            f"flat mirrors ({chain[0].name!r}) and diffraction cannot be combined for polarised "
            "light; omit diffraction, use an unpolarised variant, or set coherent=True"
        )
    rays = _rays_between(emitter, receiver, chain)
    transmission = np.ones((len(rays[0]), 1, 1))
    for k, mirror in enumerate(reversed(chain if len(transmission) else ()), 1):
        before, point, after = rays[k - 1 : k + 2]
        near = [point + _GAP * (before - point), point, point + _GAP * (after - point)]
        transmission = transmission * trace_rays(scene, near, plain, None, [mirror], coherent)[0]
    return PassingRays(rays, transmission, [np.eye(3)] * (len(chain) + 1))


def _unfolded(
    meshes: list[Mesh], emitter: PlacedSource, receiver: PlacedSource, chain: Sequence[Mirror]
) -> list[Mesh]:
    """Return the obstacles in front of each segment, reflected at all later mirrors of the path.

    In the result, the path is a straight line from the emitter's image to the receiver.
    """
    points = points_by(emitter.centre[None], receiver.centre[None], chain)
    if not len(points[0]):
        points = _rays_between(emitter, receiver, chain)
    path = [point[0] for point in reversed(points)]
    unfolded = []
    for leg in range(len(chain) + 1):
        parts = meshes
        for k in (leg - 1, leg):
            if 0 <= k < len(chain):
                # Only obstacles on the same side of the mirror as the segment affect the segment.
                other = path[leg] if k == leg else path[leg + 1]
                side = math.copysign(1.0, float(other @ chain[k].normal) - chain[k].offset)
                plane = side * chain[k].normal, side * chain[k].offset
                parts = [_clipped_mesh(*mesh, *plane) for mesh in parts]
        for mirror in chain[leg:]:
            parts = [(mirror.image_of(p), f[:, ::-1]) for p, f in parts]
        unfolded += [(p, f) for p, f in parts if len(f)]
    return unfolded


def _clipped_mesh(points: Floats, faces: Any, normal: Floats, offset: float) -> Mesh:
    """Return the part of a mesh where ``normal . p > offset``.

    Triangles that cross the plane are cut.
    """
    height = points @ normal - offset
    height = np.where(np.abs(height) <= _IN_PLANE * np.abs(points).max(initial=1.0), 0.0, height)
    corners, number = list(points), {}
    triangles = []

    def cut(a: int, b: int) -> int:
        """Return the index of the vertex where the edge from a to b meets the plane."""
        a, b = min(a, b), max(a, b)
        if (a, b) not in number:
            number[a, b] = len(corners)
            fraction = height[a] / (height[a] - height[b])
            corners.append(points[a] + fraction * (points[b] - points[a]))
        return number[a, b]

    for face in faces[(height[faces] > 0.0).any(axis=1)].tolist():
        ring = []
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            if height[a] >= 0.0:
                ring.append(a)
            if height[a] * height[b] < 0.0:
                ring.append(cut(a, b))
        triangles += [[ring[0], ring[k], ring[k + 1]] for k in range(1, len(ring) - 1)]
    return np.array(corners), np.array(triangles, np.intp).reshape(-1, 3)


def even_points(count: int, dimensions: int, shift: float | Floats = 0.5) -> Floats:
    """Return quasi-random points (count, dimensions) in the unit cube.

    The first point has the coordinates ``shift``. Source: M. Roberts, "The unreasonable
    effectiveness of quasirandom sequences" (2018).
    """
    root = 1.0
    for _ in range(64):  # Root of x^(dimensions + 1) = x + 1.
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = np.arange(count)[:, None] * root ** -np.arange(1.0, dimensions + 1)
    return np.asarray((shift + steps) % 1)


def points_on(source: PlacedSource, dimensions: slice = slice(2, 4)) -> Floats:
    """Return quasi-random points (n, 3) on a source with the density |u|^2, in scene axes in m.

    ``dimensions`` selects two of four quasi-random numbers, so that two sources can use different
    numbers.
    """
    cells = cells_with_field(mi, source.source, 1.0)
    draws = even_points(_ray_count(), 4)[:, dimensions]
    batches = [np.array(cells.sample(draw), np.float64) for (draw,) in point_batches(draws)]
    return source.points(np.concatenate([batch.reshape(2, -1).T for batch in batches]))


def trace_rays(
    scene: Any,
    points: list[Floats],
    receiver: PlacedSource,
    emitter: PlacedSource | None,
    chain: Sequence[Mirror],
    coherent: bool = False,
) -> tuple[Floats, list[Floats]]:
    """Trace rays through ``points`` from a receiver to an emitter; sources must be hidden.

    The ``points`` are in m, on the receiver, on the mirrors in reverse order, and on the
    emitter. Rays end at the last point if ``emitter`` is None.

    Returns the transmission (n, k, k) of each ray, where k is 4 for Mueller matrices and otherwise
    1. Also returns the mean matrix (3, 3) of the panes on each segment, in the order from the
    emitter to the receiver.
    """
    unit = receiver.scene_unit
    ends = [receiver] if emitter is None else [receiver, emitter]
    path = [point / unit for point in points]
    extent = max(float(np.abs(point).max()) for point in path)
    height = ROUNDING * max(extent, *(end.extent / unit for end in ends))
    for end, k in zip(ends, (0, -1), strict=False):
        path[k] = path[k] + height * end.normal
    planes = [_plane(mirror, unit, extent, coherent) for mirror in reversed(chain)]
    polarised = mi.is_polarized and not coherent
    tracer = RayTracer(scene, polarised, coherent)
    size, count = 4 if polarised else 1, len(path[0])
    powers, panes = [], []
    for rays in point_batches(*path):
        result = tracer.trace(receiver.medium, planes, list(rays))
        power = result.fraction
        if polarised:
            power = _in_ludwig_axes(result, receiver, emitter, not chain)
        colours = dr.size_v(mi.UnpolarizedSpectrum) if polarised else 1
        powers.append(np.array(power, np.float64).reshape(size, size, colours, -1)[:, :, 0])
        if tracer.changes_fields:
            panes.append(_pane_matrices(result, len(chain) + 1))
    transmission = np.concatenate(powers, axis=-1)
    transmission = np.broadcast_to(np.moveaxis(transmission, -1, 0), (count, size, size))
    if not panes:
        return transmission, [np.eye(3)] * (len(chain) + 1)
    matrices = np.concatenate(panes)
    weights = np.sqrt(np.maximum(transmission[:, 0, 0], 0.0))
    total = weights.sum()
    # Rays go from the receiver to the emitter, so the order of the segments is reversed. The rows
    # of each matrix are the fields for incident x, y and z.
    mean = np.einsum("n,nlij->lij", weights, matrices)[::-1] / total if total > 0 else matrices[0]
    return transmission, list(mean)


def _pane_matrices(result: Transmission, legs: int) -> Floats:
    """Return the matrices of the panes on each of ``legs`` segments, shape (n, legs, 3, 3).

    Segments are in the order of the rays. The rows are the fields for incident fields along x, y
    and z.
    """
    # Segments are missing if all rays miss a mirror.
    columns = result.panes + [result.panes[0]] * (legs - len(result.panes))
    parts = [np.array(part, np.float64).reshape(3, -1) for leg in columns for part in leg]
    matrices = np.array(np.broadcast_arrays(*parts)).reshape(legs, 3, 3, -1)
    return np.moveaxis(matrices, -1, 0)


def _plane(mirror: Mirror, unit: float, extent: float, coherent: bool) -> Plane:
    """Return the plane of a mirror in scene units.

    ``unit`` is the length of a unit in m, and ``extent`` is the largest coordinate of the rays.
    """
    rounding = _IN_PLANE * max(extent, float(np.abs(bounds_of(mirror.shape)).max()))
    normal = mi.Vector3f(*mirror.normal.tolist())
    surfaces = None
    if coherent or bsdfs_in(mirror.shape.bsdf())[-1].class_name() == THIN:
        surfaces = surface_of(mirror, True), surface_of(mirror, False)
    return Plane(mirror.shape, normal, mirror.offset / unit, rounding, surfaces)


def _in_ludwig_axes(
    result: Transmission, receiver: PlacedSource, emitter: PlacedSource | None, is_direct: bool
) -> Drjit:
    """Convert the Mueller matrices of rays from Mitsuba's axes to Ludwig's axes at both ends.

    Without an emitter, only the axes at the receiver are converted. Without mirrors
    (``is_direct``), the axes of all rays are those of the ray between the centres.
    """
    first, last = result.first, result.last
    if is_direct and emitter is not None:
        # Amplitudes use the polarisation axes of the central ray.
        across = emitter.centre - receiver.centre
        first = last = mi.Vector3f(*(across / np.linalg.norm(across)).tolist())
    rotations = []
    for end, direction, sign in ((receiver, first, -1.0), (emitter, -last, 1.0)):
        if end is None:
            rotations.append(mi.Spectrum(1.0))
            continue
        frame = Frame(mi, mi.Transform4f(mi.Matrix4f(end.pose.tolist())), np.zeros(2))
        c, s = axis_rotation(mi, frame.to_local(direction), frame, sign * direction)
        entries = {(0, 0): 1, (1, 1): c, (1, 2): s, (2, 1): -sign * s, (2, 2): sign * c, (3, 3): 1}
        rotations.append(mueller_matrix(mi, entries))
    return rotations[0] * result.fraction * rotations[1]


BLOCKED = "there is no line-of-sight path: obstacles block it (ray test, without diffraction)"


class OpenPath(NamedTuple):
    """Unblocked path via flat mirrors."""

    parts: FacingParts
    """Parts of the emitter's image and of the receiver that face each other."""
    facing: PlacedSource
    """Part of the emitter whose image faces the receiver."""
    rays: PassingRays
    notes: list[str]


def open_path(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    chain: Chain,
    meshes: list[Mesh] | None,
    coherent: bool = False,
) -> OpenPath | str:
    """Trace rays from an emitter via mirrors to a receiver; if no ray arrives, return the reason.

    If ``meshes`` is not None, obstacles diffract, and only the mirrors affect the rays.
    """
    parts = facing_parts(emitter.image(chain), receiver)
    if parts is None:
        return (
            "there is no line-of-sight path: one end lies in the plane of the other end or "
            "behind it"
        )
    facing = parts.emitter.image(chain[::-1])
    send = passing_rays if meshes is None else unobstructed_rays
    rays = send(scene, facing, parts.receiver, chain, coherent)
    transmission = rays.amplitude if coherent else float(rays.power[0, 0])
    if transmission == 0.0:
        return BLOCKED
    notes = []
    if parts.fraction < 1:
        notes.append(
            "the part of one end that lies behind the plane of the other end is not included"
        )
    if transmission < 1 and not chain and meshes is None:
        notes.append(
            f"{transmission:.1%} of the line-of-sight {'amplitude' if coherent else 'power'} "
            "passes the obstacles (ray test, without diffraction)"
        )
    zone = math.sqrt(receiver.wavelength * math.dist(parts.emitter.centre, receiver.centre))
    notes += [
        f"the mirror {mirror.name!r} is narrower than a Fresnel zone of {zone:.3g} m: diffraction "
        "at its edges, which is not included, changes the reflected amplitude"
        for mirror in chain
        # The shorter side of a rectangle is at most the side of the square with the same diagonal.
        if math.dist(*bounds_of(mirror.shape)) / math.sqrt(2) * receiver.scene_unit < zone
    ]
    return OpenPath(parts, facing, rays, notes)


def obstacles_of(
    scene: Any, emitter: PlacedSource, receiver: PlacedSource, wavelength: float
) -> list[Mesh] | None:
    """Return the meshes of obstacles in m, or None if ``diffraction`` is False at both ends."""
    if not (emitter.diffraction or receiver.diffraction):
        return None
    unit = receiver.scene_unit
    return [(points * unit, faces) for points, faces in meshes_in(scene, wavelength / unit)]
