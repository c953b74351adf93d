"""Flat mirrors of a scene, conducting bodies beside it, and images of sources in mirrors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, Any, TypeVar

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, PolywignerError, SceneError
from polywigner.geometry.arguments import checked_count
from polywigner.geometry.shapes import square
from polywigner.mitsuba.scenes.surfaces import faces_of, sorted_shapes, vertices_of
from polywigner.reception.norms import NORMALISATIONS
from polywigner.scattering.cross_sections import MOST_BOUNCES
from polywigner.scattering.facets import Facets, facets_of, lights_itself
from polywigner.scattering.near_fields import Antenna

if TYPE_CHECKING:
    from polywigner.mitsuba.plugins.placement import PlacedSource

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# A body of more faces than this is taken for a curved one.
MOST_FACES = 32
# Chains of mirrors that are tried: some milliseconds each.
_MOST_CHAINS = 5000
# Departure from a plane, relative to the coordinates: rounding of single precision.
_FLAT = 1e-5
# Rounding of cosines in a normal: that of a wall along an axis is one. A hundred metres away the
# image in a wall that leans by it would be 10 um off, a radian of phase in the terahertz.
_AXIS = 2e-7
_SMOOTH = int(mi.BSDFFlags.DeltaReflection) | int(mi.BSDFFlags.DeltaTransmission)


@dataclass(frozen=True, eq=False)
class Mirror:
    """A plane of the points p with ``normal`` . p = ``offset``, in m."""

    name: str
    shape: Any
    normal: Floats
    offset: float

    def image_of(self, points: Floats) -> Floats:
        """Images (..., 3) of points behind the plane, in m."""
        height = points @ self.normal - self.offset
        result: Floats = points - 2 * height[..., None] * self.normal
        return result


@dataclass
class SmoothShapes:
    """Flat mirrors of a scene, and names of shapes whose smooth lobes are ignored."""

    mirrors: list[Mirror] = field(default_factory=list)
    curved: list[str] = field(default_factory=list)
    """Shapes that reflect but are curved, or have too many planes."""
    refracting: list[str] = field(default_factory=list)
    """Shapes that transmit and bend rays, flat ones included."""
    unnamed: list[str] = field(default_factory=list)
    """Stand-ins for the ids of mirrors without one."""


def smooth_shapes(scene: Any, unit: float) -> SmoothShapes:
    """Return the flat mirrors of a scene in units of ``unit`` metres, and other smooth shapes."""
    result = SmoothShapes()
    for number, shape in enumerate(sorted_shapes(scene)):
        flags = shape.bsdf().flags() if shape.bsdf() is not None else 0
        if not flags & _SMOOTH:
            continue
        name = shape.id() or f"shape {number}"
        if mi.has_flag(flags, mi.BSDFFlags.DeltaTransmission):
            result.refracting.append(name)
        if not mi.has_flag(flags, mi.BSDFFlags.DeltaReflection):
            continue
        planes = _planes(shape)
        if not planes:
            result.curved.append(name)
        elif not shape.id():
            result.unnamed.append(name)
        for face, (normal, offset) in enumerate(planes):
            own = f"{name}[{face}]" if len(planes) > 1 else name
            result.mirrors.append(Mirror(own, shape, normal, offset * unit))
    return result


def chains_of(mirrors: list[Mirror], most: int) -> Iterator[tuple[Mirror, ...]]:
    """All sequences of one to ``most`` mirrors, none twice in succession, in the light's order."""
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
    points, normals = _faces(shape) if has_faces else _centre(shape)
    size = max(float(np.abs(points).max(initial=0.0)), 1e-30)
    planes: list[tuple[Floats, float]] = []
    for own, place in zip(normals, points, strict=True):
        normal = np.where(np.abs(own) < _AXIS, 0.0, own)
        normal, offset = normal / np.linalg.norm(normal), float(place @ normal)
        if not any(_is_same(plane, normal, offset, size) for plane in planes):
            planes.append((normal, offset))
        if len(planes) > MOST_FACES:
            return []
    return planes


def _is_same(plane: tuple[Floats, float], normal: Floats, offset: float, size: float) -> bool:
    """Whether a face lies in a plane, whichever side it turns to."""
    sign = np.sign(normal @ plane[0])
    apart = np.abs(normal - sign * plane[0]).max()
    return bool(apart <= _FLAT and abs(offset - sign * plane[1]) <= _FLAT * size)


def _faces(shape: Any) -> tuple[Floats, Floats]:
    """A corner and the unit normal of each triangle."""
    a, b, c = np.moveaxis(vertices_of(shape)[faces_of(shape)], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    there = lengths > 0
    return a[there], normals[there] / lengths[there, None]


def _centre(shape: Any) -> tuple[Floats, Floats]:
    """The centre of a rectangle or disk with its normal; nothing for other shapes."""
    if shape.class_name() not in ("Rectangle", "Disk"):
        return np.empty((0, 3)), np.empty((0, 3))
    sample = shape.sample_position(0.0, mi.Point2f(0.5, 0.5))
    point, normal = (np.array(v, np.float64).reshape(1, 3) for v in (sample.p, sample.n))
    return point, normal


# ---- waves, with their phase and their polarisation ---------------------------------------------

MASK, THIN = "MaskBSDF", "ThinDielectric"
_TWO_SIDED, _CONDUCTOR = "TwoSidedBRDF", "SmoothConductor"
_SURFACES = (_CONDUCTOR, THIN, "SmoothDielectric", "SmoothPlastic")
# |n x k| of a wave along the normal: any vector across it serves.
_ALONG = 1e-9


def bsdfs_in(bsdf: Any) -> list[mi.BSDF]:
    """Return a BSDF and the BSDFs nested in it, the outermost first."""
    return [node for node in mi.traverse(bsdf).hierarchy if isinstance(node, mi.BSDF)]


@dataclass(frozen=True)
class Surface:
    """The smooth surface of a mirror, as a wave on one of its sides meets it."""

    index: complex | None
    """Refractive index n + ik behind it over that before it; None: a perfect conductor."""
    is_thin: bool = False
    """A sheet, whose inner reflections add up in power."""

    def coefficients(self, cosine: Any) -> tuple[Complexes, Complexes]:
        """Return the reflection coefficients of E across the plane of incidence and of E in it.

        Waves go as exp(-i omega t); both vectors in the plane are s x k, so that a perfect
        conductor has -1 and +1 at any angle. A sheet has the root of 2R/(1 + R) with the sign of
        the coefficient of its first face.
        """
        if self.index is None:
            return -np.ones_like(cosine, complex), np.ones_like(cosine, complex)
        found = self._of_one_face(cosine)
        if not self.is_thin:
            return found
        powers = [_of_sheet(np.square(np.abs(r))) for r in found]
        across, along = (np.sign(r.real) * np.sqrt(p) for r, p in zip(found, powers, strict=True))
        return across, along

    def reflectance_in_mitsuba(self, cosine: Any) -> Floats:
        """Return the reflectance of Mitsuba's BSDF, which has no polarisation in a sheet."""
        found = self._of_one_face(cosine) if self.index is not None else self.coefficients(cosine)
        mean = np.mean([np.square(np.abs(r)) for r in found], axis=0)
        return _of_sheet(mean) if self.is_thin else mean

    def _of_one_face(self, cosine: Any) -> tuple[Complexes, Complexes]:
        """Fresnel's coefficients."""
        assert self.index is not None
        square = self.index**2
        behind = np.sqrt(square - 1 + np.square(cosine) + 0j)  # n cos, decays for Im > 0
        return (
            (cosine - behind) / (cosine + behind),
            (square * cosine - behind) / (square * cosine + behind),
        )


def _of_sheet(power: Any) -> Floats:
    """Reflectance of two faces of reflectance ``power``, all internal reflections added."""
    return 2 * power / (1 + power)


def surface_of(mirror: Mirror, is_before: bool) -> Surface:
    """The surface that a wave meets from where the normal points, or from behind."""
    nodes = bsdfs_in(mirror.shape.bsdf())
    smooth = [node for node in nodes if node.class_name() in _SURFACES]
    kinds = {node.class_name() for node in nodes}
    if not smooth or kinds - {MASK, _TWO_SIDED, *_SURFACES}:
        raise SceneError(
            f"expected the mirror {mirror.name!r} to be a conductor, dielectric, thindielectric or "
            f"plastic, whose reflection has a phase, got {mirror.shape.bsdf().class_name()}; give "
            "it one of these, or make it rough"
        )
    own = smooth[0 if is_before else -1]
    params = mi.traverse(own)
    if own.class_name() == _CONDUCTOR:
        index = complex(*(_single(t.mean()) for t in list(params.hierarchy)[1:3]))
        return Surface(None if index == 1j else index)  # Mitsuba's "none" is 0 + 1i
    ratio = _single(params["eta"])
    is_inside = not (is_before or _TWO_SIDED in kinds or own.class_name() == THIN)
    return Surface(complex(1 / ratio if is_inside else ratio), own.class_name() == THIN)


def _single(value: Any) -> float:
    return float(np.ravel(np.array(value, np.float64)).mean())


def reflected(field: Any, direction: Floats, normal: Floats, surface: Surface) -> Complexes:
    """E (3,) complex of a plane wave along the unit vector ``direction`` after its reflection."""
    across = np.cross(normal, direction)
    if np.linalg.norm(across) < _ALONG:
        across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across = across / np.linalg.norm(across)
    turned = direction - 2 * (normal @ direction) * normal
    r_across, r_along = surface.coefficients(abs(float(normal @ direction)))
    before, after = np.cross(across, direction), np.cross(across, turned)
    return r_across * (field @ across) * across + r_along * (field @ before) * after


# ---- conducting bodies --------------------------------------------------------------------------

# Error of an echo relative to that of all lit parts in phase, far below physical optics' own.
OF_ECHO = 1e-3
# Ways that are tried: some milliseconds each.
_MOST_WAYS = 5000


@dataclass(frozen=True, eq=False)
class Body:
    """A perfect conductor in the scene's frame, in m."""

    name: str
    facets: Facets
    bounces: int
    """Reflections on it that count."""

    def standing_in(self, image: PlacedSource, like: PlacedSource) -> PlacedSource:
        """A square in the middle that looks at the image of a source, for rays between both."""
        z = image.middle - self.facets.centre
        z /= np.linalg.norm(z)
        x = np.cross(np.eye(3)[np.abs(z).argmin()], z)
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3] = np.stack([x, np.cross(z, x), z, self.facets.centre], axis=-1)
        return replace(like, source=square(self.facets.size / 2), pose=pose)

    def antenna(self, image: PlacedSource, wavelength: float) -> Antenna:
        """The image of a source beside the body."""
        pose: Floats = np.asarray(np.linalg.inv(image.pose), np.float64)
        pose[:3, 3] += pose[:3, :3] @ self.facets.centre
        condition: Any = image.obliquity
        return Antenna(
            image.source, pose, wavelength, NORMALISATIONS[0], 0.1 * OF_ECHO, condition=condition
        )

    def is_in_front(self, image: PlacedSource) -> bool:
        """Whether all of it is in front of the plane of the image of a source."""
        corners = self.facets.corners + self.facets.centre
        return bool(((corners - image.pose[:3, 3]) @ image.normal > 0.0).all())

    def doubts(self, wavelength: float, ways: list[Floats]) -> list[str]:
        """Notes on the ways (n, 3) of light from both ends to the body."""
        last = [way[-1] - way[-2] for way in ways]
        near, far = min(map(np.linalg.norm, last)), 2 * self.facets.size**2 / wavelength
        notes = []
        if self.facets.least_face < wavelength:
            notes.append(f"a face of {self.name!r} is smaller than a square wavelength")
        if self.bounces == 1 and lights_itself(self.facets, np.array(last)):
            notes.append(
                f"faces of {self.name!r} light each other: later reflections are left out; give it "
                "as a pair (body, 3)"
            )
        if self.bounces > 1 and near < far:
            notes.append(
                f"{self.name!r} is nearer than 2 D^2/lambda, {far:.3g} m: its second and third "
                "reflections count as those of plane waves"
            )
        return notes


@dataclass(frozen=True)
class Echo:
    """A way by a body, with mirrors in the order of light before it and after it."""

    before: tuple[Mirror, ...]
    body: Body
    after: tuple[Mirror, ...]

    @property
    def names(self) -> tuple[str, ...]:
        before, after = (
            tuple(mirror.name for mirror in part) for part in (self.before, self.after)
        )
        return (*before, self.body.name, *after)

    @property
    def place(self) -> Floats:
        """The body's middle as the receiver sees it, (3,)."""
        place = self.body.facets.centre
        for mirror in self.after:
            place = mirror.image_of(place)
        return place


def checked_bodies(bodies: Any) -> tuple[Body, ...]:
    """Bodies by their names, each alone or with the number of its reflections."""
    if bodies is None:
        return ()
    if not isinstance(bodies, Mapping) or not all(isinstance(name, str) for name in bodies):
        raise ArgumentError(
            "expected bodies as a dict of bodies by their names, each one of pw.rcs or a pair of "
            f"it and a number of reflections, got {bodies!r:.100}"
        )
    return tuple(_body(name, given) for name, given in bodies.items())


def _body(name: str, given: Any) -> Body:
    if not name.strip():
        raise ArgumentError("expected names of bodies with letters, got an empty one; name it")
    bounces = 1
    if isinstance(given, tuple) and len(given) == 2 and isinstance(given[1], int | np.integer):
        given, bounces = given
    try:
        found = facets_of(given)
        return Body(name, found, checked_count(bounces, "reflections", 1, MOST_BOUNCES))
    except PolywignerError as error:
        raise ArgumentError(f"the body {name!r}: {error}") from None


def echoes_of(bodies: Sequence[Body], mirrors: Sequence[Mirror], reflections: int) -> list[Echo]:
    """Ways by one body, with at most one of the mirrors before it and one after it."""
    for name in {body.name for body in bodies} & {mirror.name for mirror in mirrors}:
        raise SceneError(
            f"expected bodies with other names than mirrors, got {name!r} for both; rename the body"
        )
    single = [(), *((mirror,) for mirror in mirrors[: len(mirrors) if reflections else 0])]
    pairs = [pair for pair in product(single, single) if sum(map(len, pair)) <= reflections]
    if len(bodies) * len(pairs) > _MOST_WAYS:
        raise SceneError(
            f"expected at most {_MOST_WAYS} ways by bodies and flat mirrors, got "
            f"{len(bodies) * len(pairs)}; ask for fewer reflections, or make small mirrors rough"
        )
    return [Echo(before, body, after) for body in bodies for before, after in pairs]


Chain = tuple[Mirror, ...]
Way = Chain | Echo


def ways_in(
    scene: Any, unit: float, reflections: int, bodies: Sequence[Body] = ()
) -> tuple[list[Chain], list[Echo], list[str]]:
    """Return paths by up to ``reflections`` mirrors, paths by bodies, and notes on other paths.

    Raises SceneError for too many paths.
    """
    mirrors, notes = _mirrors_in(scene, unit, reflections)
    chains: list[Chain] = [(), *chains_of(mirrors, reflections)]
    return chains, echoes_of(bodies, mirrors, reflections), notes


def _mirrors_in(scene: Any, unit: float, reflections: int) -> tuple[list[Mirror], list[str]]:
    """Return the flat mirrors of a scene, and notes on the paths that are not included."""
    smooth = smooth_shapes(scene, unit)
    curved, refracting, unnamed = (
        ", ".join(map(repr, names)) for names in (smooth.curved, smooth.refracting, smooth.unnamed)
    )
    notes = []
    if curved:
        notes.append(
            f"not included: reflection from {curved}, curved or of more than {MOST_FACES} planes"
        )
    if refracting:
        notes.append(f"not included: refracted transmission through {refracting}")
    if smooth.mirrors:
        plural = "" if reflections == 1 else "s"
        limit = f"paths with more than {reflections} reflection{plural}"
        notes.append(
            f"not included: {limit if reflections else 'reflections from flat mirrors'}, light "
            "from mirrors to rough surfaces, and diffraction at the edges of mirrors"
        )
    if unnamed:
        notes.append(
            f"{unnamed} has no id, as after Mitsuba merges shapes with equal BSDFs; load the scene "
            "with polywigner.mitsuba.load_scene to keep ids"
        )
    return smooth.mirrors, notes


def names_of(way: Way) -> tuple[str, ...]:
    """Return the names of mirrors and bodies in the order of light."""
    return way.names if isinstance(way, Echo) else tuple(mirror.name for mirror in way)


Found = TypeVar("Found")


def paths_by(
    ways: Iterable[Way], link: str, find: Callable[[Any], tuple[Found, list[str]] | str]
) -> tuple[list[Found], list[str]]:
    """Collect the paths that ``find`` returns for ways between two ends, and notes on the link.

    ``find`` returns a path with its notes, or the reason why nothing arrives. The reason is noted
    for the line of sight and for echoes without mirrors: most chains of mirrors lead nowhere.
    """
    paths, notes = [], []
    for way in ways:
        found = find(way)
        if isinstance(found, str):
            reasons = [found] if len(names_of(way)) == isinstance(way, Echo) else []
        else:
            paths.append(found[0])
            reasons = found[1]
        if reasons:
            by = link + "".join(f" by {name!r}" for name in names_of(way))
            notes.append(f"{by}: {' and '.join(reasons)}")
    return paths, notes
