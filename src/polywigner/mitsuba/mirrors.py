"""Flat mirrors of a scene, and the images of sources in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.mitsuba.scene_order import sorted_shapes

Floats = NDArray[np.float64]

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
# Places on a side of a shape that is looked at.
_PLACES = 5


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
    points, normals = _faces(params) if has_faces else _samples(shape)
    size = max(float(np.abs(points).max(initial=0.0)), 1e-30)
    planes: list[tuple[Floats, float]] = []
    for own, place in zip(normals, points, strict=True):
        normal = np.where(np.abs(own) < _AXIS, 0.0, own)
        normal, offset = normal / np.linalg.norm(normal), float(place @ normal)
        if not any(_is_same(plane, normal, offset, size) for plane in planes):
            planes.append((normal, offset))
        if len(planes) > (MOST_FACES if has_faces else 1):
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
    # rounding of places turns a plane's own, and evens out in the middle
    return np.broadcast_to(points.mean(axis=0), points.shape), normals


# More null surfaces than this on a way count as a wall.
_MOST_PASSED = 64
# Places in fog between two surfaces, of which uneven fog is the mean.
_IN_FOG = 32
# Directions agree within this, in rad.
_STRAIGHT = 1e-3
# Wavelengths of colours, in nm, of variants that have some.
_COLOURS = (450.0, 520.0, 590.0, 660.0)


class Plane(NamedTuple):
    """The plane of a mirror as rays meet it, in units of the scene."""

    shape: Any
    normal: Any
    offset: float
    surfaces: tuple[Surface, Surface] | None = None
    """Before and behind it: their reflectances are left out; None: they count."""


def trace_way(
    scene: Any,
    medium: Any,
    normal: Any,
    planes: Sequence[Plane],
    rounding: float,
    points: list[Any],
    polarised: bool,
) -> tuple[Any, Any, Any]:
    """The share of power that passes from the last to the first of the points, and directions.

    A Mueller matrix between Mitsuba's axes if ``polarised``; directions at the first and last point
    as seen from the first. ``medium``: fog at the first. ``normal``: of its surface. ``planes``: of
    mirrors at the points between, which are met within ``rounding``.
    """
    it = dr.zeros(mi.SurfaceInteraction3f)
    it.p, it.n = points[0], normal
    if dr.size_v(type(it.wavelengths)):
        it.wavelengths = type(it.wavelengths)(*_COLOURS)
    if dr.is_jit_v(mi.Float):
        medium = mi.MediumPtr(medium)
    share = _whole(polarised)
    first = None
    for plane, point in zip(planes, points[1:-1], strict=True):
        ray = it.spawn_ray(it.spawn_ray_to(point).d)  # ends behind the mirror
        first = first or ray
        it, passed, medium = _first_surface(scene, ray, medium, polarised, plane, rounding)
        shape = plane.shape if not dr.is_jit_v(mi.Float) else mi.ShapePtr(plane.shape)
        met = (it.shape == shape) & (_is_apart(it.p, plane, rounding) == mi.Bool(False))
        if not dr.any(met):
            return 0.0 * share, ray.d, ray.d
        share = share * dr.select(met, passed * _reflectance(it, met, plane, polarised), 0.0)
    last = it.spawn_ray_to(points[-1])
    it, passed, _ = _first_surface(scene, last, medium, polarised)
    return dr.select(it.is_valid(), 0.0, share * passed), (first or last).d, last.d


def _whole(polarised: bool) -> Any:
    """All of the power, in its polarisation where there is one."""
    return mi.Spectrum(1.0) if polarised else mi.Float(1.0)


def share_unobstructed(scene: Any, si: Any, point: Any) -> Any:
    """The share of power that passes from a point to a surface, through null surfaces, no fog."""
    medium = mi.MediumPtr(None) if dr.is_jit_v(mi.Float) else None
    it, passed, _ = _first_surface(scene, si.spawn_ray_to(point), medium, mi.is_polarized)
    return dr.select(it.is_valid(), 0.0, passed)


def _first_surface(
    scene: Any,
    ray: Any,
    medium: Any,
    polarised: bool,
    plane: Plane | None = None,
    rounding: float = 0.0,
) -> tuple[Any, Any, Any]:
    """First surface that is not null or lies in a mirror's plane; transmission; fog behind it."""
    share, moves = _whole(polarised), mi.Bool(True)
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
        passed = si.bsdf().eval_null_transmission(si, moves)
        if polarised:
            passed = si.to_world_mueller(passed, si.wi, si.wi)
        share = dr.select(moves, share * _mean(passed, polarised), share)
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
    left = dr.mean(dr.exp(-depth * (length / _IN_FOG)))
    return dr.select(is_there, left, 1.0)


def _behind(si: Any, direction: Any, medium: Any, active: Any) -> Any:
    """The fog behind a surface."""
    changes = active & si.is_medium_transition()
    if not dr.is_jit_v(mi.Float):
        return si.target_medium(direction) if changes else medium
    return dr.select(changes, si.target_medium(direction), medium)


def _is_apart(point: Any, plane: Plane, rounding: float) -> Any:
    return dr.abs(dr.dot(point, plane.normal) - plane.offset) > rounding


def _reflectance(si: Any, active: Any, plane: Plane, polarised: bool) -> Any:
    """Reflectance of the smooth lobe, in power; zero where a normal map turns it."""
    bsdf = plane.shape.bsdf()
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.DeltaReflection
    opacity: Any = 1.0
    while bsdf.class_name() == _MASK:  # without its null lobe it samples nothing
        opacity = opacity * (1.0 - _mean(bsdf.eval_null_transmission(si, active), False))
        bsdf = _nested(bsdf)[1]
    sample, weight = bsdf.sample(context, si, 0.5, mi.Point2f(0.5), active)
    arrived = si.to_world(si.wi)
    mirrored = 2 * dr.dot(arrived, si.n) * si.n - arrived
    is_there = active & (dr.norm(si.to_world(sample.wo) - mirrored) < _STRAIGHT)
    if polarised:
        weight = si.to_world_mueller(weight, -sample.wo, si.wi)
    share = dr.select(is_there, opacity * _mean(weight, polarised), 0.0)
    return share if plane.surfaces is None else share / _expected(plane, dr.dot(arrived, si.n))


def _expected(plane: Plane, cosine: Any) -> Any:
    """Fresnel's reflectance at Mitsuba's own cosines: rays start 1e-4 off a surface."""
    ahead = np.abs(np.array(cosine, np.float64))
    before, behind = (surface.reflectance(ahead) for surface in plane.surfaces or ())
    found = np.where(np.array(cosine) > 0.0, before, behind)
    found = np.where(found > 0.0, found, 1.0)
    return mi.Float(found.tolist()) if dr.is_jit_v(mi.Float) else float(found)


def _mean(spectrum: Any, polarised: bool) -> Any:
    """Over colours: pictures and received powers are means of them too."""
    if not polarised:
        return dr.mean(mi.unpolarized_spectrum(spectrum))
    matrix = dr.zeros(mi.Spectrum)
    for row, column in np.ndindex(4, 4):
        matrix[row, column] = mi.UnpolarizedSpectrum(dr.mean(spectrum[row, column]))
    return matrix


# ---- waves, with their phase and their polarisation ---------------------------------------------

_MASK, _TWO_SIDED = "MaskBSDF", "TwoSidedBRDF"
_CONDUCTOR, _THIN = "SmoothConductor", "ThinDielectric"
_SURFACES = (_CONDUCTOR, _THIN, "SmoothDielectric", "SmoothPlastic")
# |n x k| of a wave along the normal: any vector across it serves.
_ALONG = 1e-9


def _nested(bsdf: Any) -> list[Any]:
    """A BSDF and all that it is made of, from outside inwards."""
    return [node for node in mi.traverse(bsdf).hierarchy if isinstance(node, mi.BSDF)]


@dataclass(frozen=True)
class Surface:
    """The smooth surface of a mirror, as a wave on one of its sides meets it."""

    index: complex | None
    """Refractive index n + ik behind it over that before it; None: a perfect conductor."""
    is_thin: bool = False
    """A sheet, whose inner reflections add up in power."""

    def coefficients(self, cosine: Any) -> tuple[Any, Any]:
        """Fresnel's coefficients of E across the plane of incidence and of E in it.

        Waves go as exp(-i omega t); both vectors in the plane are s x k, so that a perfect
        conductor has -1 and +1 at any angle.
        """
        if self.index is None:
            return -np.ones_like(cosine, complex), np.ones_like(cosine, complex)
        square = self.index**2
        behind = np.sqrt(square - 1 + np.square(cosine) + 0j)  # n cos, decays for Im > 0
        found = (
            (cosine - behind) / (cosine + behind),
            (square * cosine - behind) / (square * cosine + behind),
        )
        if not self.is_thin:
            return found
        powers = [np.square(np.abs(r)) for r in found]
        sheets = [np.sqrt(2 * power / (1 + power)) for power in powers]
        across, along = (np.sign(r.real) * sheet for r, sheet in zip(found, sheets, strict=True))
        return across, along

    def reflectance(self, cosine: Any) -> Any:
        """Share of the power of unpolarised light."""
        across, along = self.coefficients(cosine)
        return (np.square(np.abs(across)) + np.square(np.abs(along))) / 2


def surface_of(mirror: Mirror, is_before: bool) -> Surface:
    """The surface that a wave meets from where the normal points, or from behind."""
    nodes = _nested(mirror.shape.bsdf())
    smooth = [node for node in nodes if node.class_name() in _SURFACES]
    kinds = {node.class_name() for node in nodes}
    if not smooth or kinds - {_MASK, _TWO_SIDED, *_SURFACES}:
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
    is_inside = not (is_before or _TWO_SIDED in kinds or own.class_name() == _THIN)
    return Surface(complex(1 / ratio if is_inside else ratio), own.class_name() == _THIN)


def _single(value: Any) -> float:
    return float(np.ravel(np.array(value, np.float64)).mean())


def reflected(field: Any, direction: Floats, normal: Floats, surface: Surface) -> Any:
    """E (3,) complex of a plane wave along the unit vector ``direction`` after its reflection."""
    across = np.cross(normal, direction)
    if np.linalg.norm(across) < _ALONG:
        across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across = across / np.linalg.norm(across)
    turned = direction - 2 * (normal @ direction) * normal
    r_across, r_along = surface.coefficients(abs(float(normal @ direction)))
    before, after = np.cross(across, direction), np.cross(across, turned)
    return r_across * (field @ across) * across + r_along * (field @ before) * after
