"""Power and polarisation that pass along paths of straight legs, by rays through a scene.

Rays run from the receiver to the emitter. They pass null surfaces, fog, masks and thin panes, and
are reflected by the flat mirrors of the path.

Mitsuba's ``thindielectric`` uses the mean R of the reflectances of both polarisations. Here each
polarisation has its own 2R/(1 + R), the sum of all internal reflections in power.
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
from polywigner.mitsuba.scenes.surfaces import Reaches, children_of

Floats = NDArray[np.float64]

# A path that passes more null surfaces than this counts as blocked.
_MOST_PASSED = 64
# Points in fog between two surfaces, over which uneven fog is averaged.
_IN_FOG = 32
# Directions agree within this, in rad.
_STRAIGHT = 1e-3
# Wavelengths of colours, in nm, of variants that have some.
_COLOURS = (450.0, 520.0, 590.0, 660.0)
# BSDFs that act on the polarisation of what they let through.
_FILTERS = ("LinearPolarizer", "LinearRetarder", "CircularPolarizer")


def point_batches(*arrays: NDArray[np.float64]) -> Iterator[tuple[Drjit, ...]]:
    """Yield rows (n, 2) or (n, 3) as Mitsuba's points: all at once, in scalar variants one by one.

    The coordinates are copied from lists, since Dr.Jit compiles the alignment of NumPy memory into
    kernels.
    """
    kinds = [{2: mi.Point2f, 3: mi.Point3f}[array.shape[1]] for array in arrays]
    if dr.is_jit_v(mi.Float):
        columns = [[mi.Float(column.tolist()) for column in array.T] for array in arrays]
        yield tuple(kind(*own) for kind, own in zip(kinds, columns, strict=True))
        return
    for rows in zip(*(array.tolist() for array in arrays), strict=True):
        yield tuple(kind(*row) for kind, row in zip(kinds, rows, strict=True))


def joined(values: Iterable[Drjit]) -> Floats:
    """Return numbers of several batches as one array (n,)."""
    return np.concatenate([np.ravel(np.array(value, np.float64)) for value in values])


class Plane(NamedTuple):
    """The plane of a mirror as rays meet it, in units of the scene."""

    shape: Any
    normal: Any
    offset: float
    rounding: float
    """Largest distance of a hit on the mirror from its plane."""
    surfaces: tuple[Surface, Surface] | None
    """Surfaces on the side of the normal and behind it; None: Mitsuba's reflectance counts."""


class Transmission(NamedTuple):
    """Transmission of rays along a path."""

    share: Any
    """Transmitted power; a Mueller matrix between Mitsuba's axes for polarised rays."""
    first: Any
    """Direction of a ray at the first point."""
    last: Any
    """Direction of a ray towards the last point."""
    panes: list[list[Any]]
    """Images of x, y and z under the transmission of the thin panes of each leg."""


@dataclass(frozen=True, eq=False)
class _Pane:
    """A shape of thin glass, perhaps masked in part."""

    shape: Any
    surface: Surface
    masks: list[Any]

    def transmittances(self, si: Any, total: Any, active: Any) -> tuple[Drjit, Drjit]:
        """Transmitted power across and in the plane of incidence; ``total``: Mitsuba's mean."""
        cosine = dr.abs(dr.dot(si.to_world(si.wi), si.n))
        covered = _opacity(self.masks, si, active)
        mean = _on_host(lambda c: 1.0 - self.surface.reflectance_in_mitsuba(c), cosine)
        # what the texture of the transmittance leaves, and the part of the surface that is glass
        scale = dr.select(mean > 0.0, (total - 1.0 + covered) / dr.select(mean > 0.0, mean, 1.0), 0)
        across, along = (
            _on_host(partial(_transmittance, number, self.surface), cosine) for number in (0, 1)
        )
        return 1.0 - covered + scale * across, 1.0 - covered + scale * along


class RayTracer:
    """Rays along given paths through one scene.

    Parameters
    ----------
    scene : the ``mi.Scene``, whose sources are hidden.
    polarised : whether to return Mueller matrices.
    coherent : whether mirrors and thin panes act on field vectors, outside of ``share``.
    """

    def __init__(self, scene: Any, polarised: bool, coherent: bool) -> None:
        self._scene, self._polarised, self._coherent = scene, polarised, coherent
        self._reaches = Reaches(scene)
        self._panes, self._filters = [], []
        for shape in scene.shapes():
            nodes = bsdfs_in(shape.bsdf()) if shape.bsdf() is not None else []
            kinds = [node.class_name() for node in nodes]
            if kinds and kinds[-1] == THIN and set(kinds[:-1]) <= {MASK}:
                index = complex(float(np.ravel(np.array(mi.traverse(nodes[-1])["eta"]))[0]))
                self._panes.append(_Pane(shape, Surface(index, is_thin=True), nodes[:-1]))
            if set(kinds) & set(_FILTERS):
                self._filters.append(shape)

    def trace(self, medium: Any, planes: Sequence[Plane], points: list[Any]) -> Transmission:
        """Transmission from the last to the first of the points.

        ``medium``: fog at the first point. ``planes``: of the mirrors at the points between.
        """
        share, panes = self._all(), []
        first = direction = dr.normalize(points[1] - points[0])
        ray = mi.Ray3f(points[0], direction)
        if dr.size_v(type(ray.wavelengths)):
            ray.wavelengths = type(ray.wavelengths)(*_COLOURS)
        if dr.is_jit_v(mi.Float):
            medium = mi.MediumPtr(medium)
        for plane, end in zip(planes, points[2:], strict=True):
            si, passed, medium, columns = self._first_surface(ray, medium, plane)
            met = _is(si.shape, plane.shape) & (_is_apart(si.p, plane) == mi.Bool(False))
            panes.append(columns)
            if not dr.any(met):
                return Transmission(0.0 * share, first, first, panes)
            share = share * dr.select(met, passed * self._reflectance(si, met, plane), 0.0)
            direction = dr.normalize(end - si.p)
            ray = self._reaches.leave(si, direction)
        ray.maxt = dr.norm(points[-1] - ray.o)
        ray.d = direction = (points[-1] - ray.o) / ray.maxt
        si, passed, _, columns = self._first_surface(ray, medium)
        panes.append(columns)
        share = dr.select(si.is_valid(), 0.0, share * passed)
        return Transmission(share, first, direction, panes)

    def unobstructed(self, si: Any, point: Any) -> Drjit:
        """Transmission to a surface from the point of a light that it has sampled, without fog."""
        medium = mi.MediumPtr(None) if dr.is_jit_v(mi.Float) else None
        it, passed, _, _ = self._first_surface(si.spawn_ray_to(point), medium)
        return dr.select(it.is_valid(), 0.0, passed)

    def _all(self) -> Drjit:
        """All of the power, in its polarisation if there is one."""
        return mi.Spectrum(1.0) if self._polarised else mi.Float(1.0)

    def _first_surface(
        self, ray: Any, medium: Any, plane: Plane | None = None
    ) -> tuple[Drjit, Drjit, Drjit, list[Drjit]]:
        """First surface that is not null or lies in the plane of a mirror.

        Returns the interaction, the transmission to there, the fog behind it, and the images of x,
        y and z under the transmission of thin panes.
        """
        share, moves = self._all(), mi.Bool(True)
        columns = [mi.Vector3f(*axis) for axis in np.eye(3).tolist()]
        for _ in range(_MOST_PASSED):
            si = self._scene.ray_intersect(ray)
            share = dr.select(moves, share * _through_fog(medium, ray, si), share)
            moves = moves & si.is_valid()
            if plane is not None:
                moves = moves & _is_apart(si.p, plane)
            if not dr.any(moves):
                break
            moves = moves & mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Null)
            if not dr.any(moves):
                break
            passed, columns = self._passed(si, ray.d, columns, moves)
            share = dr.select(moves, share * passed, share)
            medium = _behind(si, ray.d, medium, moves)
            onwards = self._reaches.leave(si, ray.d)
            onwards.maxt = ray.maxt - dr.dot(onwards.o - ray.o, ray.d)
            ray = dr.select(moves, onwards, ray)
        return si, share, medium, columns

    def _passed(
        self, si: Any, d: Any, columns: list[Any], active: Any
    ) -> tuple[Drjit, list[Drjit]]:
        """Transmission of a null surface, and the columns behind it."""
        passed = si.bsdf().eval_null_transmission(si, active)
        total = _mean(passed, False)
        if self._polarised:
            passed = si.to_world_mueller(passed, si.wi, si.wi)
        share = _mean(passed, self._polarised)
        for shape in self._filters if self._coherent else ():
            if dr.any(active & _is(si.shape, shape)):
                raise SceneError(
                    f"paths that interfere pass the polarising filter {shape.id()!r}, which is not "
                    "supported; use received_power without coherent in a polarised variant"
                )
        for pane in self._panes:
            here = active & _is(si.shape, pane.shape)
            if not dr.any(here):
                continue
            across, along = pane.transmittances(si, total, here)
            normal = _across(si.n, d)
            roots = [dr.sqrt(dr.select(part > 0.0, part, 0.0)) for part in (across, along)]
            if self._coherent:
                turned = [
                    roots[1] * column + (roots[0] - roots[1]) * dr.dot(normal, column) * normal
                    for column in columns
                ]
                columns = [dr.select(here, a, b) for a, b in zip(turned, columns, strict=True)]
                own: Any = 1.0
            elif self._polarised:
                own = _mueller(roots, normal, -d, -d)
            else:
                own = (across + along) / 2
            share = dr.select(here, own, share)
        return share, columns

    def _reflectance(self, si: Any, active: Any, plane: Plane) -> Drjit:
        """Reflectance of the smooth lobe, in power; zero where a normal map turns it."""
        nodes = bsdfs_in(plane.shape.bsdf())
        masks = list(takewhile(lambda node: node.class_name() == MASK, nodes))
        bsdf = nodes[len(masks)]
        context = mi.BSDFContext()
        context.type_mask = mi.BSDFFlags.DeltaReflection
        sample, weight = bsdf.sample(context, si, 0.5, mi.Point2f(0.5), active)
        arrived = si.to_world(si.wi)
        mirrored = 2 * dr.dot(arrived, si.n) * si.n - arrived
        is_there = active & (dr.norm(si.to_world(sample.wo) - mirrored) < _STRAIGHT)
        covered = dr.select(is_there, _opacity(masks, si, active), 0.0)
        if plane.surfaces is None:
            if self._polarised:
                weight = si.to_world_mueller(weight, -sample.wo, si.wi)
            return covered * _mean(weight, self._polarised)
        # the part of Mitsuba's reflectance that is not Fresnel's
        cosine = dr.dot(arrived, si.n)
        scale = covered * _mean(weight, False) * _on_sides(_inverse, plane, cosine)
        if self._coherent:
            return scale
        roots = [_on_sides(partial(_coefficient, number), plane, cosine) for number in (0, 1)]
        if not self._polarised:
            return scale * (roots[0] * roots[0] + roots[1] * roots[1]) / 2
        return scale * _mueller(roots, _across(si.n, arrived), -mirrored, arrived)


def _transmittance(number: int, surface: Surface, cosine: Floats) -> Floats:
    return np.asarray(1.0 - np.abs(surface.coefficients(cosine)[number]) ** 2)


def _coefficient(number: int, surface: Surface, cosine: Floats) -> Floats:
    return surface.coefficients(cosine)[number].real


def _inverse(surface: Surface, cosine: Floats) -> Floats:
    found = surface.reflectance_in_mitsuba(cosine)
    return 1.0 / np.where(found > 0.0, found, 1.0)


def _on_sides(function: Callable[[Surface, Floats], Floats], plane: Plane, cosine: Any) -> Drjit:
    """A function of the surface that a ray meets, and of the cosine there."""
    before, behind = plane.surfaces  # type: ignore[misc]

    def both(value: Floats) -> Floats:
        ahead = np.abs(value)
        return np.where(value > 0.0, function(before, ahead), function(behind, ahead))

    return _on_host(both, cosine)


def _on_host(function: Callable[[Floats], Floats], value: Any) -> Drjit:
    """A function of NumPy arrays, for a number of Mitsuba."""
    found = function(np.array(value, np.float64))
    return mi.Float(found.tolist()) if dr.is_jit_v(mi.Float) else float(found)


def _opacity(masks: list[Any], si: Any, active: Any) -> Drjit:
    """Fraction of a surface that masks, one in the other, leave there."""
    result: Any = mi.Float(1.0)
    for mask in masks:
        texture = next(child for child in children_of(mask) if isinstance(child, mi.Texture))
        result = result * texture.eval_1(si, active)
    return result


def _across(normal: Any, direction: Any) -> Drjit:
    """Unit vector across the plane of incidence; any at normal incidence."""
    across = dr.cross(mi.Vector3f(normal), direction)
    length = dr.norm(across)
    known = length > _ALONG
    return dr.select(
        known, across / dr.select(known, length, 1.0), mi.coordinate_system(direction)[0]
    )


# |n x k| of a wave along the normal, in single precision.
_ALONG = 1e-6


def _mueller(roots: Any, across: Any, arrives: Any, leaves: Any) -> Drjit:
    """Mueller matrix between Mitsuba's axes of real amplitudes across and in a plane of incidence.

    ``arrives`` and ``leaves`` : directions of travel. Axes are ``across`` and direction x across.
    """
    s, p = roots
    both, less, turned = (s * s + p * p) / 2, (s * s - p * p) / 2, s * p
    entries = {(0, 0): both, (0, 1): less, (1, 0): less, (1, 1): both}
    entries |= {(2, 2): turned, (3, 3): turned}
    matrix = mueller_matrix(mi, entries)
    ends = [(d, across, mi.mueller.stokes_basis(d)) for d in (arrives, leaves)]
    return mi.mueller.rotate_mueller_basis(matrix, *ends[0], *ends[1])


def _is(pointer: Any, shape: Any) -> Drjit:
    """Whether rays have met this shape."""
    return pointer == (mi.ShapePtr(shape) if dr.is_jit_v(mi.Float) else shape)


def _is_apart(point: Any, plane: Plane) -> Drjit:
    return dr.abs(dr.dot(point, plane.normal) - plane.offset) > plane.rounding


def _through_fog(medium: Any, ray: Any, si: Any) -> Drjit:
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
    left = dr.mean(dr.exp(-depth * (length / _IN_FOG)))
    return dr.select(is_there, left, 1.0)


def _behind(si: Any, direction: Any, medium: Any, active: Any) -> Drjit:
    """The fog behind a surface."""
    changes = active & si.is_medium_transition()
    if not dr.is_jit_v(mi.Float):
        return si.target_medium(direction) if changes else medium
    return dr.select(changes, si.target_medium(direction), medium)


def _mean(spectrum: Any, polarised: bool) -> Drjit:
    """Mean over colours, as of images and received powers."""
    if not polarised:
        return dr.mean(mi.unpolarized_spectrum(spectrum))
    return mueller_matrix(mi, {place: dr.mean(spectrum[place]) for place in np.ndindex(4, 4)})
