"""Transmission of power and polarisation along paths, computed with rays through a scene.

Rays are traced from the receiver to the emitter, through null surfaces, fog, masks and thin panes.
The reflectance of a pane is 2R/(1 + R) for each polarisation, where R is the reflectance of one
surface. Mitsuba's ``thindielectric`` uses the mean R of both polarisations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import takewhile
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.execution import Drjit
from polywigner.mitsuba.plugins.polariser import mueller_matrix
from polywigner.mitsuba.scenes.reflectors import MASK, THIN, Surface, bsdfs_in
from polywigner.mitsuba.scenes.surfaces import ShapeExtents, children_of
from polywigner.numerics import Floats

# Largest number of null surfaces per path. Paths through more surfaces count as blocked.
_MOST_PASSED = 64
# Number of samples of the fog density between two surfaces.
_FOG_SAMPLES = 32
# Largest angle between directions that count as equal [rad].
_SAME_DIRECTION = 1e-3
# Sampled wavelengths in spectral variants [nm].
_WAVELENGTHS = (450.0, 520.0, 590.0, 660.0)
# BSDFs that change the polarisation of transmitted light.
_FILTERS = ("LinearPolarizer", "LinearRetarder", "CircularPolarizer")


def point_batches(*arrays: NDArray[np.float64]) -> Iterator[tuple[Drjit, ...]]:
    """Convert arrays of shape (n, 2) or (n, 3) to points of Mitsuba, in batches.

    Compiled variants have one batch with n points, and scalar variants have n batches of one point
    each.
    """
    kinds = [{2: mi.Point2f, 3: mi.Point3f}[array.shape[1]] for array in arrays]
    if dr.is_jit_v(mi.Float):
        # Values are passed as lists, because kernels would depend on the alignment of NumPy memory.
        columns = [[mi.Float(column.tolist()) for column in array.T] for array in arrays]
        yield tuple(kind(*part) for kind, part in zip(kinds, columns, strict=True))
        return
    for rows in zip(*(array.tolist() for array in arrays), strict=True):
        yield tuple(kind(*row) for kind, row in zip(kinds, rows, strict=True))


def joined(values: Iterable[Drjit]) -> Floats:
    """Join the values of several batches into a flat NumPy array."""
    return np.concatenate([np.ravel(np.array(value, np.float64)) for value in values])


class Plane(NamedTuple):
    """Plane of a flat mirror, in scene units."""

    shape: Any
    normal: Drjit
    offset: float
    rounding: float
    """Largest distance between the plane and rounded hits on the mirror."""
    surfaces: tuple[Surface, Surface] | None
    """Front and back surface, or None if the reflectance is that of Mitsuba's BSDF."""


class Transmission(NamedTuple):
    """Transmission of rays along a path."""

    fraction: Drjit
    """Transmitted power fraction, or Mueller matrices in Mitsuba's axes."""
    first: Drjit
    last: Drjit
    panes: list[list[Drjit]]
    """Fields behind the panes of each segment, for incident fields along x, y and z."""


@dataclass(frozen=True, eq=False)
class _Pane:
    shape: Any
    surface: Surface
    masks: list[Any]

    def transmittances(self, si: Any, total: Any, active: Any) -> tuple[Drjit, Drjit]:
        """Return the power transmittances for s and p polarisation.

        ``total`` is Mitsuba's transmittance, including textures and masks.
        """
        cosine = dr.abs(dr.dot(si.to_world(si.wi), si.n))
        covered = _opacity(self.masks, si, active)
        mean, across, along = _on_host(self._pane_transmittances, cosine)
        # The scale includes the texture and the unmasked fraction of the surface.
        scale = dr.select(mean > 0.0, (total - 1.0 + covered) / dr.select(mean > 0.0, mean, 1.0), 0)
        return 1.0 - covered + scale * across, 1.0 - covered + scale * along

    def _pane_transmittances(self, cosine: Floats) -> list[Floats]:
        """Return Mitsuba's transmittance, and the transmittances for s and p polarisation."""
        fields = self.surface.coefficients(cosine)
        mean = 1.0 - self.surface.reflectance_in_mitsuba(cosine)
        return [mean, *(1.0 - np.abs(field) ** 2 for field in fields)]


class RayTracer:
    """Tracer of rays along paths through a scene with hidden sources.

    ``polarised`` tracers return Mueller matrices. ``coherent`` tracers exclude the effects of
    mirrors and panes on fields; the caller applies these effects to field vectors.
    """

    def __init__(self, scene: Any, polarised: bool, coherent: bool) -> None:
        self._scene, self._polarised, self._coherent = scene, polarised, coherent
        self._extents = ShapeExtents(scene)
        self._panes, self._filters = [], []
        for shape in scene.shapes():
            nodes = bsdfs_in(shape.bsdf()) if shape.bsdf() is not None else []
            kinds = [node.class_name() for node in nodes]
            if kinds and kinds[-1] == THIN and set(kinds[:-1]) <= {MASK}:
                index = complex(float(np.ravel(np.array(mi.traverse(nodes[-1])["eta"]))[0]))
                self._panes.append(_Pane(shape, Surface(index, is_thin=True), nodes[:-1]))
            if set(kinds) & set(_FILTERS):
                self._filters.append(shape)

    @property
    def changes_fields(self) -> bool:
        """Whether panes change the electric fields that the tracer returns."""
        return self._coherent and bool(self._panes)

    def trace(self, medium: Any, planes: Sequence[Plane], points: list[Any]) -> Transmission:
        """Trace rays via mirrors, and return the transmission from the last to the first point.

        ``points``, in scene units, lie on the receiver, on the mirrors and on the emitter.
        ``medium`` is the fog at the first point. ``planes`` are the planes of the mirrors.
        """
        fraction, panes = self._full_transmission(), []
        first = direction = dr.normalize(points[1] - points[0])
        ray = mi.Ray3f(points[0], direction)
        if dr.size_v(type(ray.wavelengths)):
            ray.wavelengths = type(ray.wavelengths)(*_WAVELENGTHS)
        if dr.is_jit_v(mi.Float):
            medium = mi.MediumPtr(medium)
        for plane, end in zip(planes, points[2:], strict=True):
            si, passed, medium, columns = self._to_first_surface(ray, medium, plane)
            met = _is_shape(si.shape, plane.shape) & (_is_apart(si.p, plane) == mi.Bool(False))
            panes.append(columns)
            if not dr.any(met):
                return Transmission(0.0 * fraction, first, first, panes)
            fraction = fraction * dr.select(met, passed * self._reflectance(si, met, plane), 0.0)
            direction = dr.normalize(end - si.p)
            ray = self._extents.ray_from(si, direction)
        ray.maxt = dr.norm(points[-1] - ray.o)
        ray.d = direction = (points[-1] - ray.o) / ray.maxt
        si, passed, _, columns = self._to_first_surface(ray, medium)
        panes.append(columns)
        fraction = dr.select(si.is_valid(), 0.0, fraction * passed)
        return Transmission(fraction, first, direction, panes)

    def unobstructed(self, si: Any, point: Any) -> Drjit:
        """Return the transmission from a surface to a point of a light, without fog.

        The transmission is a Mueller matrix for polarised tracers, and zero if a surface blocks the
        light.
        """
        medium = mi.MediumPtr(None) if dr.is_jit_v(mi.Float) else None
        it, passed, _, _ = self._to_first_surface(si.spawn_ray_to(point), medium)
        return dr.select(it.is_valid(), 0.0, passed)

    def _full_transmission(self) -> Drjit:
        """Return a transmission of 1, or the identity as a Mueller matrix."""
        return mi.Spectrum(1.0) if self._polarised else mi.Float(1.0)

    def _to_first_surface(
        self, ray: Any, medium: Any, plane: Plane | None = None
    ) -> tuple[Drjit, Drjit, Drjit, list[Drjit]]:
        """Trace rays to the first surface that is not a null surface, or to a nearer mirror.

        The mirror lies in ``plane``. Return the intersection, the transmission up to it, the medium
        in front of it, and the fields behind all panes for incident fields along x, y and z.
        """
        fraction, moves = self._full_transmission(), mi.Bool(True)
        columns = [mi.Vector3f(*axis) for axis in np.eye(3).tolist()]
        for _ in range(_MOST_PASSED):
            si = self._scene.ray_intersect(ray)
            fraction = dr.select(moves, fraction * _through_fog(medium, ray, si), fraction)
            moves = moves & si.is_valid()
            if plane is not None:
                moves = moves & _is_apart(si.p, plane)
            if not dr.any(moves):
                break
            moves = moves & mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Null)
            if not dr.any(moves):
                break
            passed, columns = self._null_transmission(si, ray.d, columns, moves)
            fraction = dr.select(moves, fraction * passed, fraction)
            medium = _medium_behind(si, ray.d, medium, moves)
            onwards = self._extents.ray_from(si, ray.d)
            onwards.maxt = ray.maxt - dr.dot(onwards.o - ray.o, ray.d)
            ray = dr.select(moves, onwards, ray)
        return si, fraction, medium, columns

    def _null_transmission(
        self, si: Any, d: Any, columns: list[Any], active: Any
    ) -> tuple[Drjit, list[Drjit]]:
        """Return the transmission of a null surface, and the fields behind it.

        ``columns`` are fields in front of the surface, and ``d`` is the direction of the rays.
        """
        passed = si.bsdf().eval_null_transmission(si, active)
        total = _spectral_mean(passed, False)
        if self._polarised:
            passed = si.to_world_mueller(passed, si.wi, si.wi)
        fraction = _spectral_mean(passed, self._polarised)
        for shape in self._filters if self._coherent else ():
            if dr.any(active & _is_shape(si.shape, shape)):
                raise SceneError(
                    f"interfering paths through the polarising filter {shape.id()!r} are not "
                    "supported; omit coherent=True in received_power, and use a polarised variant"
                )
        for pane in self._panes:
            here = active & _is_shape(si.shape, pane.shape)
            if not dr.any(here):
                continue
            across, along = pane.transmittances(si, total, here)
            normal = _s_axis(si.n, d)
            roots = [dr.sqrt(dr.select(part > 0.0, part, 0.0)) for part in (across, along)]
            if self._coherent:
                transmitted = [
                    roots[1] * column + (roots[0] - roots[1]) * dr.dot(normal, column) * normal
                    for column in columns
                ]
                columns = [dr.select(here, a, b) for a, b in zip(transmitted, columns, strict=True)]
                of_pane: Any = 1.0
            elif self._polarised:
                of_pane = _mueller(roots, normal, -d, -d)
            else:
                of_pane = (across + along) / 2
            fraction = dr.select(here, of_pane, fraction)
        return fraction, columns

    def _reflectance(self, si: Any, active: Any, plane: Plane) -> Drjit:
        """Return the power reflectance of a mirror, or zero if a normal map tilts the ray.

        Polarised tracers return a Mueller matrix. Coherent tracers return the ratio of the
        reflectance to the Fresnel reflectance.
        """
        nodes = bsdfs_in(plane.shape.bsdf())
        masks = list(takewhile(lambda node: node.class_name() == MASK, nodes))
        bsdf = nodes[len(masks)]
        context = mi.BSDFContext()
        context.type_mask = mi.BSDFFlags.DeltaReflection
        sample, weight = bsdf.sample(context, si, 0.5, mi.Point2f(0.5), active)
        arrived = si.to_world(si.wi)
        mirrored = 2 * dr.dot(arrived, si.n) * si.n - arrived
        is_there = active & (dr.norm(si.to_world(sample.wo) - mirrored) < _SAME_DIRECTION)
        covered = dr.select(is_there, _opacity(masks, si, active), 0.0)
        if plane.surfaces is None:
            if self._polarised:
                weight = si.to_world_mueller(weight, -sample.wo, si.wi)
            return covered * _spectral_mean(weight, self._polarised)
        # Mitsuba's reflectance, divided by the Fresnel reflectance, contains only the textures and
        # factors of the BSDF.
        inverse, *roots = _on_host(partial(_both_sides, *plane.surfaces), dr.dot(arrived, si.n))
        scale = covered * _spectral_mean(weight, False) * inverse
        if self._coherent:
            return scale
        if not self._polarised:
            return scale * (roots[0] * roots[0] + roots[1] * roots[1]) / 2
        return scale * _mueller(roots, _s_axis(si.n, arrived), -mirrored, arrived)


def _both_sides(before: Surface, behind: Surface, cosine: Floats) -> list[Floats]:
    """Return 1/(Mitsuba's reflectance) and the real amplitude coefficients for s and p waves.

    For a negative cosine, the surface ``behind`` is used.
    """

    def values(surface: Surface) -> list[Floats]:
        """Return the three results of `_both_sides` for one surface."""
        reflectance = surface.reflectance_in_mitsuba(np.abs(cosine))
        fields = surface.coefficients(np.abs(cosine))
        return [1.0 / np.where(reflectance > 0.0, reflectance, 1.0), *(r.real for r in fields)]

    pairs = zip(values(before), values(behind), strict=True)
    return [np.where(cosine > 0.0, *pair) for pair in pairs]


def _on_host(function: Callable[[Floats], list[Floats]], value: Any) -> list[Drjit]:
    """Evaluate a NumPy function for a Dr.Jit array; return Dr.Jit arrays."""
    results = function(np.array(value, np.float64))
    if dr.is_jit_v(mi.Float):
        return [mi.Float(result.tolist()) for result in results]
    return [float(result) for result in results]


def _opacity(masks: list[Any], si: Any, active: Any) -> Drjit:
    """Return the product of the opacities of masks at an intersection."""
    result: Any = mi.Float(1.0)
    for mask in masks:
        texture = next(child for child in children_of(mask) if isinstance(child, mi.Texture))
        result = result * texture.eval_1(si, active)
    return result


def _s_axis(normal: Any, direction: Any) -> Drjit:
    """Return the s axis: the unit vector along normal x direction.

    The axis is arbitrary at normal incidence.
    """
    across = dr.cross(mi.Vector3f(normal), direction)
    length = dr.norm(across)
    is_oblique = length > _NORMAL_INCIDENCE
    return dr.select(
        is_oblique, across / dr.select(is_oblique, length, 1.0), mi.coordinate_system(direction)[0]
    )


# Sine of the largest angle of incidence that counts as normal incidence.
_NORMAL_INCIDENCE = 1e-6


def _mueller(roots: Any, across: Any, arrives: Any, leaves: Any) -> Drjit:
    """Return the Mueller matrix of a reflection or transmission in Mitsuba's axes.

    ``roots`` are real amplitude coefficients for s and p polarisation, ``across`` is the s axis,
    and ``arrives`` and ``leaves`` are propagation directions.
    """
    s, p = roots
    mean, difference = (s * s + p * p) / 2, (s * s - p * p) / 2
    entries = {(0, 0): mean, (0, 1): difference, (1, 0): difference, (1, 1): mean}
    entries |= {(2, 2): s * p, (3, 3): s * p}
    matrix = mueller_matrix(mi, entries)
    ends = [(d, across, mi.mueller.stokes_basis(d)) for d in (arrives, leaves)]
    return mi.mueller.rotate_mueller_basis(matrix, *ends[0], *ends[1])


def _is_shape(pointer: Any, shape: Any) -> Drjit:
    """Return whether pointers refer to a shape."""
    return pointer == (mi.ShapePtr(shape) if dr.is_jit_v(mi.Float) else shape)


def _is_apart(point: Any, plane: Plane) -> Drjit:
    """Return whether the distance of a point from a plane exceeds the rounding errors."""
    return dr.abs(dr.dot(point, plane.normal) - plane.offset) > plane.rounding


def _through_fog(medium: Any, ray: Any, si: Any) -> Drjit:
    """Return the transmission of fog along a ray up to a surface."""
    is_jit = dr.is_jit_v(mi.Float)
    is_foggy = medium != mi.MediumPtr(None) if is_jit else medium is not None
    length = dr.minimum(si.t, ray.maxt)
    is_foggy = is_foggy & (length < dr.largest(mi.Float32) if is_jit else dr.isfinite(length))
    if not dr.any(is_foggy):
        return mi.Float(1.0)
    length = dr.select(is_foggy, length, 0.0)
    interaction = dr.zeros(mi.MediumInteraction3f)
    interaction.wavelengths = ray.wavelengths
    depth: Any = 0.0
    for step in range(_FOG_SAMPLES):
        along = (step + 0.5) / _FOG_SAMPLES
        scale = dr.opaque(mi.Float, along) if is_jit else along
        interaction.p = ray.o + ray.d * (length * scale)
        depth = depth + medium.get_scattering_coefficients(interaction, is_foggy)[2]
        dr.eval(depth)  # All steps use the same small kernel.
    return dr.select(is_foggy, dr.mean(dr.exp(-depth * (length / _FOG_SAMPLES))), 1.0)


def _medium_behind(si: Any, direction: Any, medium: Any, active: Any) -> Drjit:
    """Return the medium behind a surface; ``medium`` is the medium in front of it."""
    changes = active & si.is_medium_transition()
    return dr.select(changes, si.target_medium(direction), medium)


def _spectral_mean(spectrum: Any, polarised: bool) -> Drjit:
    """Return the mean over wavelengths of a spectrum, or of each element of Mueller matrices."""
    if not polarised:
        return dr.mean(mi.unpolarized_spectrum(spectrum))
    return mueller_matrix(mi, {entry: dr.mean(spectrum[entry]) for entry in np.ndindex(4, 4)})
