"""Flat mirrors and conducting bodies of a scene, and paths that they reflect."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, TypeVar

import mitsuba as mi
import numpy as np

from polywigner.errors import SceneError, at_key
from polywigner.geometry.arguments import check_most, checked_count, checked_type
from polywigner.geometry.polyhedron import axes_across, normals_of
from polywigner.geometry.shapes import square
from polywigner.mitsuba.scenes.surfaces import faces_of, sorted_shapes, vertices_of
from polywigner.numerics import Complex, Floats
from polywigner.reception.couplings import NORMALISATIONS
from polywigner.scattering.cross_sections import MOST_BOUNCES
from polywigner.scattering.facets import Facets, facets_of, illuminates_itself
from polywigner.scattering.near_fields import Antenna

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.placement import PlacedSource


# Number of planes above which a shape counts as curved.
MOST_FACES = 32
# Largest number of mirror sequences; each sequence takes a few milliseconds.
_MOST_CHAINS = 5000
# Advice for scenes with too many paths.
_FEWER_PATHS = "allow fewer reflections, or give small mirrors a rough BSDF"
# Largest difference between the normals of planes that count as equal, and largest difference
# between their offsets, relative to the coordinates.
_FLAT = 1e-5
# Components of a normal below this value are treated as rounding errors. A tilt by this angle
# shifts an image at 100 m by 10 um, which is about a radian of phase at terahertz frequencies.
_AXIS = 2e-7
_SMOOTH = int(mi.BSDFFlags.DeltaReflection) | int(mi.BSDFFlags.DeltaTransmission)


@dataclass(frozen=True, eq=False)
class Mirror:
    """Flat mirror in the plane ``normal . p = offset``, in m."""

    name: str
    shape: mi.Shape
    normal: Floats
    offset: float

    def image_of(self, points: Floats) -> Floats:
        """Return the mirror images of points (..., 3) in m."""
        height = points @ self.normal - self.offset
        return np.asarray(points - 2 * height[..., None] * self.normal)


Chain = tuple[Mirror, ...]
"""Mirrors along a path, in the order of reflection."""


def reflected_points(points: Floats, chain: Chain) -> Floats:
    """Return the mirror images of points (..., 3) in m after successive reflections by mirrors."""
    for mirror in chain:
        points = mirror.image_of(points)
    return points


def mirrors_in(scene: mi.Scene, unit: float, reflections: int) -> tuple[list[Mirror], list[str]]:
    """Return the flat mirrors of a scene, and notes on reflections that are not included.

    ``unit`` is the length of a scene unit in m, and ``reflections`` the maximum number of
    reflections.
    """
    mirrors: list[Mirror] = []
    curved, refracting = [], []
    for number, shape in enumerate(sorted_shapes(scene)):
        flags = shape.bsdf().flags() if shape.bsdf() is not None else 0
        if not flags & _SMOOTH:
            continue
        name = shape.id() or f"shape {number}"
        if mi.has_flag(flags, mi.BSDFFlags.DeltaTransmission):
            refracting.append(name)
        if not mi.has_flag(flags, mi.BSDFFlags.DeltaReflection):
            continue
        planes = _planes(shape)
        if not planes:
            curved.append(name)
        for face, (normal, offset) in enumerate(planes):
            full_name = f"{name}[{face}]" if len(planes) > 1 else name
            mirrors.append(Mirror(full_name, shape, normal, offset * unit))
    notes = []
    if curved:
        notes.append(
            f"not included: reflections from {_quoted(curved)} (curved, or with more than "
            f"{MOST_FACES} planes)"
        )
    if refracting:
        notes.append(f"not included: refraction through {_quoted(refracting)}")
    if mirrors:
        limit = f"paths with more than {reflections} reflection{'' if reflections == 1 else 's'}"
        notes.append(
            f"not included: {limit if reflections else 'reflections from flat mirrors'}, light "
            "that flat mirrors reflect to rough surfaces, and diffraction at the edges of mirrors"
        )
    return mirrors, notes


def _quoted(names: list[str]) -> str:
    """Return names in quotation marks, separated by commas."""
    return ", ".join(map(repr, names))


def chains_of(mirrors: list[Mirror], most: int) -> Iterator[Chain]:
    """Yield sequences of 1 to ``most`` mirrors in which no mirror follows itself.

    Raises SceneError for too many sequences.
    """
    count = len(mirrors)
    total = sum(count * (count - 1) ** k for k in range(most)) if count else 0
    things = f"paths via {count} flat mirrors with up to {most} reflections"
    check_most(total, _MOST_CHAINS, things, _FEWER_PATHS, SceneError)
    chains: list[Chain] = [()]
    for _ in range(most):
        chains = [(*chain, m) for chain in chains for m in mirrors if chain[-1:] != (m,)]
        yield from chains


def _planes(shape: mi.Shape) -> list[tuple[Floats, float]]:
    """Return the normals and offsets of the planes of a shape, or no planes if it is curved.

    Normals are unit vectors, and offsets are in scene units.
    """
    params = mi.traverse(shape)
    has_faces = "vertex_positions" in params and "faces" in params
    points, normals = _corners_and_normals(shape) if has_faces else _centre_and_normal(shape)
    size = max(float(np.abs(points).max(initial=0.0)), 1e-30)
    planes: list[tuple[Floats, float]] = []
    for face_normal, point in zip(normals, points, strict=True):
        normal = np.where(np.abs(face_normal) < _AXIS, 0.0, face_normal)
        normal, offset = normal / np.linalg.norm(normal), float(point @ normal)
        if not any(_is_same_plane(plane, normal, offset, size) for plane in planes):
            planes.append((normal, offset))
        if len(planes) > MOST_FACES:
            return []
    return planes


def _is_same_plane(plane: tuple[Floats, float], normal: Floats, offset: float, size: float) -> bool:
    """Return whether two planes are equal, even if their normals are opposite.

    ``size`` is the largest coordinate of the shape.
    """
    sign = np.sign(normal @ plane[0])
    difference = np.abs(normal - sign * plane[0]).max()
    return bool(difference <= _FLAT and abs(offset - sign * plane[1]) <= _FLAT * size)


def _corners_and_normals(shape: mi.Mesh) -> tuple[Floats, Floats]:
    """Return a corner and the unit normal of each triangle with an area, shapes (n, 3)."""
    corners = vertices_of(shape)[faces_of(shape)]
    normals = normals_of(corners)
    lengths = np.linalg.norm(normals, axis=1)
    has_area = lengths > 0
    return corners[has_area, 0], normals[has_area] / lengths[has_area, None]


def _centre_and_normal(shape: mi.Shape) -> tuple[Floats, Floats]:
    """Return the centre and unit normal of a rectangle or disk, shapes (1, 3), or empty arrays."""
    if shape.class_name() not in ("Rectangle", "Disk"):
        return np.empty((0, 3)), np.empty((0, 3))
    sample = shape.sample_position(0.0, mi.Point2f(0.5, 0.5))
    point, normal = (np.array(v, np.float64).reshape(1, 3) for v in (sample.p, sample.n))
    return point, normal


MASK, THIN = "MaskBSDF", "ThinDielectric"
_TWO_SIDED, _CONDUCTOR = "TwoSidedBRDF", "SmoothConductor"
_SURFACES = (_CONDUCTOR, THIN, "SmoothDielectric", "SmoothPlastic")
# Sine of the largest angle of incidence that counts as normal incidence.
_NORMAL_INCIDENCE = 1e-9


def bsdfs_in(bsdf: mi.BSDF) -> list[mi.BSDF]:
    """Return a BSDF and its nested BSDFs, outermost first."""
    return [node for node in mi.traverse(bsdf).hierarchy if isinstance(node, mi.BSDF)]


@dataclass(frozen=True)
class Surface:
    """Smooth surface of a mirror, as seen from one side."""

    index: complex | None
    """Ratio of the refractive indices n + ik behind and in front; None for a perfect conductor."""
    is_thin: bool = False
    """Whether the surface is a thin sheet, with incoherent internal reflections."""

    def coefficients(self, cosine: Any) -> tuple[Complex, Complex]:
        """Return the reflection coefficients of the electric field for s and p polarisation.

        ``cosine`` is the cosine of the angle of incidence. The unit vector of p polarisation is s x
        k before and after reflection, so a perfect conductor has the coefficients -1 and +1. The
        modulus for a sheet is the square root of 2R/(1 + R), with the reflectance R of one face.
        The time factor is exp(-i omega t).
        """
        faces = self._of_one_face(cosine)
        if not self.is_thin:
            return faces
        powers = [_sheet_reflectance(np.square(np.abs(r))) for r in faces]
        across, along = (np.sign(r.real) * np.sqrt(p) for r, p in zip(faces, powers, strict=True))
        return across, along

    def reflectance_in_mitsuba(self, cosine: Any) -> Floats:
        """Return the reflectance of Mitsuba's BSDF, which assumes unpolarised light."""
        mean = np.mean([np.square(np.abs(r)) for r in self._of_one_face(cosine)], axis=0)
        return _sheet_reflectance(mean) if self.is_thin else mean

    def _of_one_face(self, cosine: Any) -> tuple[Complex, Complex]:
        """Return the Fresnel coefficients of one interface for s and p polarisation."""
        if self.index is None:
            return -np.ones_like(cosine, complex), np.ones_like(cosine, complex)
        square = self.index**2
        # A positive imaginary part describes a wave that decays behind the surface.
        behind = np.sqrt(square - 1 + np.square(cosine) + 0j)
        return (
            (cosine - behind) / (cosine + behind),
            (square * cosine - behind) / (square * cosine + behind),
        )


def _sheet_reflectance(power: Any) -> Floats:
    """Return the reflectance 2R/(1 + R) of a thin sheet whose faces each have the reflectance R."""
    return 2 * power / (1 + power)


def surface_of(mirror: Mirror, is_before: bool) -> Surface:
    """Return the front surface of a mirror if ``is_before`` is true, otherwise its back surface.

    The front is the side of the mirror's normal. Raises SceneError if the phase of the reflection
    is not defined.
    """
    nodes = bsdfs_in(mirror.shape.bsdf())
    smooth = [node for node in nodes if node.class_name() in _SURFACES]
    kinds = {node.class_name() for node in nodes}
    if not smooth or kinds - {MASK, _TWO_SIDED, *_SURFACES}:
        raise SceneError(
            f"the mirror {mirror.name!r} has the BSDF {mirror.shape.bsdf().class_name()}, whose "
            "reflection has no phase; make it a conductor, dielectric, thindielectric or "
            "plastic, or a rough surface"
        )
    bsdf = smooth[0 if is_before else -1]
    params = mi.traverse(bsdf)
    if bsdf.class_name() == _CONDUCTOR:
        index = complex(*(_mean_number(t.mean()) for t in list(params.hierarchy)[1:3]))
        # Mitsuba's perfect conductor has the index 1i.
        return Surface(None if index == 1j else index)
    ratio = _mean_number(params["eta"])
    is_inside = not (is_before or _TWO_SIDED in kinds or bsdf.class_name() == THIN)
    return Surface(complex(1 / ratio if is_inside else ratio), bsdf.class_name() == THIN)


def _mean_number(value: Any) -> float:
    """Return the mean of all numbers in a Dr.Jit value."""
    return float(np.ravel(np.array(value, np.float64)).mean())


def reflected(field: Any, direction: Floats, normal: Floats, surface: Surface) -> Complex:
    """Return the electric field of a plane wave after reflection, shape (3,).

    ``direction`` is the propagation direction. Both ``direction`` and ``normal`` are unit vectors;
    the normal may point to either side.
    """
    across = np.cross(normal, direction)
    if np.linalg.norm(across) < _NORMAL_INCIDENCE:
        across = axes_across(normal)[0]
    across = across / np.linalg.norm(across)
    outgoing = direction - 2 * (normal @ direction) * normal
    r_across, r_along = surface.coefficients(abs(float(normal @ direction)))
    before, after = np.cross(across, direction), np.cross(across, outgoing)
    return r_across * (field @ across) * across + r_along * (field @ before) * after


# Tolerance of an echo, relative to the coherent sum over all illuminated parts of the body. The
# error of physical optics is much larger.
ECHO_ERROR = 1e-3
# Largest number of paths via bodies; each path takes a few milliseconds.
_MOST_PATHS = 5000


@dataclass(frozen=True, eq=False)
class Body:
    """Perfectly conducting body, with positions in m in the frame of the scene."""

    name: str
    facets: Facets
    bounces: int

    def target_facing(self, image: PlacedSource, like: PlacedSource) -> PlacedSource:
        """Return a square at the body's centre that faces a source, as a target for rays.

        Its side is half the diagonal of the body's bounding box, and ``like`` provides its other
        parameters.
        """
        z = image.centre - self.facets.centre
        z /= np.linalg.norm(z)
        pose = np.eye(4)
        pose[:3] = np.stack([*axes_across(-z), z, self.facets.centre], axis=-1)
        return replace(like, source=square(self.facets.size / 2), pose=pose)

    def antenna(self, image: PlacedSource, wavelength: float) -> Antenna:
        """Return the ``image`` of an end as an antenna, in a frame at the centre of the body."""
        pose: Floats = np.asarray(np.linalg.inv(image.pose), np.float64)
        pose[:3, 3] += pose[:3, :3] @ self.facets.centre
        condition: Any = image.obliquity
        return Antenna(
            image.source, pose, wavelength, NORMALISATIONS[0], 0.1 * ECHO_ERROR, condition=condition
        )

    def is_in_front(self, image: PlacedSource) -> bool:
        """Return whether the entire body is in front of a source."""
        corners = self.facets.corners + self.facets.centre
        return bool(((corners - image.pose[:3, 3]) @ image.normal > 0.0).all())

    def accuracy_notes(self, wavelength: float, paths: list[Floats]) -> list[str]:
        """Return notes on the accuracy of the echo.

        ``paths`` contains the points (n, 3) of the paths from both ends to the body, in m.
        """
        last = [path[-1] - path[-2] for path in paths]
        near, far = min(map(np.linalg.norm, last)), 2 * self.facets.size**2 / wavelength
        notes = []
        if self.facets.least_face < wavelength:
            notes.append(
                f"the body {self.name!r} has a face smaller than a square wavelength, for "
                "which physical optics is inaccurate"
            )
        if self.bounces == 1 and illuminates_itself(self.facets, np.array(last)):
            notes.append(
                f"faces of the body {self.name!r} illuminate each other, but higher-order "
                "reflections between them are not included; pass a pair (body, 3) to include them"
            )
        if self.bounces > 1 and near < far:
            notes.append(
                f"the body {self.name!r} is closer than 2 D^2/lambda = {far:.3g} m, but its "
                "second and third reflections are computed for plane waves"
            )
        return notes


@dataclass(frozen=True)
class Echo:
    before: Chain
    body: Body
    after: Chain

    @property
    def position(self) -> Floats:
        """Centre in m of the body's mirror image that the receiver sees, shape (3,)."""
        return reflected_points(self.body.facets.centre, self.after)


Route = Chain | Echo


def names_of(route: Route) -> tuple[str, ...]:
    """Return the names of the mirrors and of the body along a route."""
    if isinstance(route, Echo):
        return (*names_of(route.before), route.body.name, *names_of(route.after))
    return tuple(mirror.name for mirror in route)


def checked_bodies(bodies: Any) -> tuple[Body, ...]:
    """Convert the argument ``bodies`` of :func:`polywigner.mitsuba.channel` to bodies."""
    if bodies is None:
        return ()
    expected = "bodies to be a dict of bodies, or pairs of a body and a number of reflections"
    checked_type(bodies, expected, Mapping)
    return tuple(_body(name, value) for name, value in bodies.items())


def _body(name: str, value: Any) -> Body:
    """Return a body from an item of the argument ``bodies``."""
    bounces = 1
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[1], int | np.integer):
        value, bounces = value
    with at_key(f"the body {name!r}"):
        return Body(name, facets_of(value), checked_count(bounces, "reflections", 1, MOST_BOUNCES))


def _echoes_of(bodies: Sequence[Body], mirrors: Sequence[Mirror], reflections: int) -> list[Echo]:
    """Return paths via one body and at most one mirror before and after it.

    ``reflections`` limits the number of mirrors.
    """
    for name in {body.name for body in bodies} & {mirror.name for mirror in mirrors}:
        raise SceneError(f"the name {name!r} belongs to a body and to a mirror; rename the body")
    single: list[Chain] = [(), *((mirror,) for mirror in mirrors if reflections)]
    pairs = [pair for pair in product(single, single) if sum(map(len, pair)) <= reflections]
    things = "paths via bodies and flat mirrors"
    check_most(len(bodies) * len(pairs), _MOST_PATHS, things, _FEWER_PATHS, SceneError)
    return [Echo(before, body, after) for body in bodies for before, after in pairs]


def routes_in(
    scene: mi.Scene, unit: float, reflections: int, bodies: Sequence[Body] = ()
) -> tuple[list[Route], list[str]]:
    """Return the line of sight (), routes via mirrors and via bodies, and notes on excluded routes.

    ``unit`` is the length of a scene unit in m.
    """
    mirrors, notes = mirrors_in(scene, unit, reflections)
    chains = chains_of(mirrors, reflections)
    return [(), *chains, *_echoes_of(bodies, mirrors, reflections)], notes


Result = TypeVar("Result")


def paths_by(
    routes: Iterable[Route], link: str, find: Callable[[Any], tuple[Result, list[str]] | str]
) -> tuple[list[Result], list[str]]:
    """Apply ``find`` to all routes of a link, and return all results and notes.

    ``find`` returns a result and its notes, or the reason why no power arrives. Such reasons become
    notes only for the line of sight and for echoes without mirrors. ``link`` names the link in
    notes.
    """
    results, notes = [], []
    for route in routes:
        result = find(route)
        if isinstance(result, str):
            reasons = [result] if len(names_of(route)) == isinstance(route, Echo) else []
        else:
            results.append(result[0])
            reasons = result[1]
        if reasons:
            by = link + "".join(f" by {name!r}" for name in names_of(route))
            notes.append(f"{by}: {' and '.join(reasons)}")
    return results, notes
