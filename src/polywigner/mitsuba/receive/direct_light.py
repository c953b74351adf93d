"""Direct light at a receiver, along the line of sight and along specular paths.

The received power P from a light of radiant intensity I at the point y, and from a plane wave of
irradiance E from the direction s, follows from (RX8) of docs/received_power.md:

    P = (lambda^2/N) |U(y)|^2 I                   P = (g |F(s)|^2/N) E = D(s) lambda^2/(4 pi) E

U is the field that the receiver would transmit to y, F the Fourier transform of its source field, g
the obliquity factor, N the power that the receiver would radiate, and D its directivity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from polywigner.errors import SceneError
from polywigner.execution import Drjit
from polywigner.mitsuba.plugins.mixtures import norm_of
from polywigner.mitsuba.plugins.placement import (
    FacingParts,
    PlacedSource,
    check_obliquity,
    facing_parts,
)
from polywigner.mitsuba.plugins.registration import scene_errors
from polywigner.mitsuba.receive.power_results import DirectPath
from polywigner.mitsuba.receive.ray_transmission import joined, point_batches
from polywigner.mitsuba.receive.specular_paths import (
    BLOCKED,
    diffracted_ratio,
    obstacles_of,
    open_path,
    points_by,
    points_on,
    trace_rays,
)
from polywigner.mitsuba.scenes.reflectors import Chain, names_of, paths_by, reflected_points
from polywigner.mitsuba.scenes.surfaces import bounds_of, is_source, sorted_emitters
from polywigner.numerics import Floats
from polywigner.propagation.amplitudes import amplitude
from polywigner.reception import coupling
from polywigner.source.obliquities import CONDITIONS
from polywigner.source.polarisation import Stokes


def free_space_coupling(parts: FacingParts, tolerance: float) -> float:
    """Return the ratio of received to radiated power in free space, without polarisation.

    The ratio is the weighted sum of |b|^2 over the mutually incoherent waves of emitter and
    receiver, where b is the result of :func:`polywigner.coupling`.
    """
    emitter, receiver = parts.emitter, parts.receiver
    link = f"the link from emitter {emitter.name!r} to receiver {receiver.name!r}"
    check_obliquity(link, emitter.obliquity, receiver.obliquity)
    pose = emitter.pose_of(receiver)
    method: Any = emitter.obliquity
    total = 0.0
    # For some obliquities, coupling() and norm_of() scale the source field differently. The
    # difference cancels in ratios of radiated powers. The waves of a mixture, however, require a
    # common scale: the integral of |u|^2.
    is_plain = emitter.mixture.is_plain and receiver.mixture.is_plain
    normalise: Any = "radiated" if is_plain else "aperture"
    with scene_errors(f"{link}: "):
        for sent, wavelength, weight in emitter.mixture.parts(emitter.source, emitter.wavelength):
            for taken, _, other in receiver.mixture.parts(receiver.source, wavelength):
                b = coupling(sent, taken, pose, wavelength, method, tolerance, normalise=normalise)
                total += weight * other * float(abs(b) ** 2)
    for placed in (emitter, receiver):
        norm = norm_of(placed.source, placed.wavelength, method, normalise=normalise)
        total *= norm / placed.norm
    return float(total)


@dataclass(frozen=True)
class DirectLight:
    """Direct paths from an emitter to a receiver, and notes on effects that are not included."""

    paths: tuple[DirectPath, ...] = ()
    notes: tuple[str, ...] = ()
    interfering: float | None = None
    """Total power in W of interfering paths, or None."""

    @property
    def power(self) -> float:
        """Received power in W."""
        if self.interfering is not None:
            return self.interfering
        return math.fsum(path.power for path in self.paths)


Term = tuple[float, Stokes, Stokes]
"""Coupling |b|^2 of two polarised fields, and their Stokes vectors."""


def direct_light(
    scene: Any,
    emitter: PlacedSource,
    receiver: PlacedSource,
    chains: list[Chain],
    tolerance: float,
) -> DirectLight:
    """Return the direct paths from an emitter to a receiver; the scene's sources must be hidden.

    ``chains`` starts with the empty chain for the line of sight.
    """
    meshes = obstacles_of(scene, emitter, receiver, receiver.wavelength)

    def find(chain: Chain) -> tuple[DirectPath, list[str]] | str:
        """Return the path via mirrors and its notes, or the reason why no power arrives."""
        result = open_path(scene, emitter, receiver, chain, meshes)
        if isinstance(result, str):
            return result
        image, matrix = emitter.image(chain), result.rays.power
        if meshes is not None:
            ends = result.facing, result.parts.receiver
            ratio = diffracted_ratio(meshes, *ends, chain, receiver.wavelength)
            matrix = matrix * abs(ratio) ** 2
        transmission = float(matrix[0, 0])
        if transmission == 0.0:
            return BLOCKED
        terms = _coupling_terms(image, receiver, tolerance)
        coupling, matched = _coupling_and_match(terms, receiver, matrix)
        path = DirectPath(
            names_of(chain),
            emitter.power * coupling * transmission * matched,
            coupling,
            transmission,
            result.parts.receiver.cosines_to(result.parts.emitter.centre),
            matched,
            length=math.dist(image.centre, receiver.centre),
        )
        return path, result.notes

    paths, notes = paths_by(chains, f"from {emitter.name!r} to {receiver.name!r}", find)
    if paths and paths[0].mirrors:
        notes[0] += "; its direct power arrives via reflections"
    return DirectLight(tuple(paths), tuple(notes))


def _coupling_terms(image: PlacedSource, receiver: PlacedSource, tolerance: float) -> list[Term]:
    """Return the free-space coupling for each pair of polarised fields of emitter and receiver."""
    terms = []
    for (sent, stokes_sent), (taken, stokes_taken) in product(image.fields, receiver.fields):
        parts = facing_parts(replace(image, source=sent), replace(receiver, source=taken))
        assert parts is not None
        terms.append((free_space_coupling(parts, tolerance), stokes_sent, stokes_taken))
    return terms


def _coupling_and_match(
    terms: list[Term], receiver: PlacedSource, transmission: Floats
) -> tuple[float, float]:
    """Return the total coupling in free space, and the matched fraction of the transmitted power.

    The matched power is the power in the receiver's polarisation. ``transmission`` is the mean
    transmission of the path, shape (1, 1), or a Mueller matrix (4, 4).
    """
    size = len(transmission)
    weight = 1.0 if receiver.polarisation is None else 0.5
    total = math.fsum(b_squared * sent[0] * taken[0] for b_squared, sent, taken in terms)
    received = weight * math.fsum(
        b_squared * float(np.array(taken[:size]) @ transmission @ np.array(sent[:size]))
        for b_squared, sent, taken in terms
    )
    passed = total * float(transmission[0, 0])
    # Rounding can make the power in a crossed polarisation negative.
    return total, max(received / passed, 0.0) if passed > 0 else 0.0


# Distance of a point that represents a direction, in units of max(R^2/wavelength, R) for a receiver
# of radius R.
_FAR = 1e6
# Relative tolerance of fields.
_TOLERANCE = 1e-6


class DeltaLight(NamedTuple):
    """Light that reaches each point from a single direction (delta light)."""

    name: str
    emitter: Any
    is_infinite: bool


def delta_lights(scene: Any) -> list[DeltaLight]:
    """Return the point, spot, projector and directional lights of a scene.

    Raises SceneError for lights that radiate from a surface in a single direction.
    """
    lights = []
    for number, emitter in enumerate(sorted_emitters(scene)):
        flags, name = emitter.flags(), emitter.id() or f"light {number}"
        is_infinite = mi.has_flag(flags, mi.EmitterFlags.Infinite)
        has_position = mi.has_flag(flags, mi.EmitterFlags.DeltaPosition)
        has_direction = mi.has_flag(flags, mi.EmitterFlags.DeltaDirection)
        if is_source(emitter) or not (has_position or has_direction):
            continue
        if not (has_position or is_infinite):
            raise SceneError(
                f"the light {name!r} ({emitter.class_name()}) is not supported by receivers, "
                "because it radiates from a surface in a single direction; use a spot or an area "
                "light"
            )
        lights.append(DeltaLight(name, emitter, is_infinite))
    return lights


def delta_direct_light(scene: Any, receiver: PlacedSource, chains: list[Chain]) -> DirectLight:
    """Return the direct light of all delta lights at a receiver."""
    paths, notes = delta_paths(scene, receiver, chains), []
    if paths and receiver.diffraction:
        notes.append(
            f"obstacles cast shadows of the light {paths[0].light!r}, computed along rays, "
            "without diffraction"
        )
    return DirectLight(tuple(paths), tuple(notes))


def delta_paths(scene: Any, receiver: PlacedSource, chains: list[Chain]) -> list[DirectPath]:
    """Return the paths along which power arrives from delta lights at a receiver."""
    lights = delta_lights(scene)
    if lights and receiver.obliquity not in CONDITIONS:
        raise SceneError(
            f"receiver {receiver.name!r} has the obliquity {receiver.obliquity!r}, which is not "
            f"available for the light {lights[0].name!r}; use one of {', '.join(CONDITIONS)}"
        )
    paths = (_delta_path(scene, receiver, *pair) for pair in product(lights, chains))
    return [path for path in paths if path is not None and path.power > 0.0]


def _delta_path(
    scene: Any, receiver: PlacedSource, light: DeltaLight, chain: Chain
) -> DirectPath | None:
    """Return the path from a light via mirrors to a receiver, or None if no ray arrives."""
    end = points_on(receiver)
    start, image = _starts(scene, receiver, light, end, chain)
    points = points_by(start, end, chain)
    arrives = (points[1] - points[0]) @ receiver.normal > 0
    if not arrives.any():
        return None
    points = [point[arrives] for point in points]
    emission = _emission(light, points[-2] / receiver.scene_unit, receiver.scene_unit)
    strength = float(emission.mean())
    if strength == 0.0:
        return None
    transmitted, _ = trace_rays(scene, points, receiver, None, chain)
    matrix = np.einsum("n,nij->ij", emission, transmitted) / (strength * len(end))
    terms = _effective_areas(receiver, image, light.is_infinite)
    coupling, matched = _coupling_and_match(terms, receiver, matrix)
    transmission = float(matrix[0, 0])
    total = strength if light.is_infinite else 4 * math.pi * strength
    return DirectPath(
        names_of(chain),
        total * coupling * transmission * matched,
        coupling,
        transmission,
        receiver.cosines_to(image),
        matched,
        length=math.inf if light.is_infinite else math.dist(image, receiver.centre),
        light=light.name,
    )


def _starts(
    scene: Any, receiver: PlacedSource, light: DeltaLight, end: Floats, chain: Chain
) -> tuple[Floats, Floats]:
    """Return start points (n, 3) of rays from a light to ``end``, and the light's image, in m.

    The image of a directional light is a point 1 m away from the receiver, towards the light.
    """
    unit = receiver.scene_unit
    ((centre,),) = point_batches(receiver.centre[None] / unit)
    sample, _ = _sampled_light(light, centre)
    if not light.is_infinite:
        point = _first(sample.p) * unit
        return np.broadcast_to(point, end.shape), reflected_points(point, chain)
    # Rays of directional lights start outside the scene and its mirror images.
    shapes = [np.abs(bounds_of(shape)).max() for shape in scene.shapes()]
    size = 4.0 * max([float(np.abs(end).max()) / unit, *shapes, 1e-30]) * unit
    direction = reflected_points(_first(sample.d), chain) - reflected_points(np.zeros(3), chain)
    image = end + size * (2 * len(chain) + 1) * direction
    return reflected_points(image, chain[::-1]), receiver.centre + direction


def _first(point: Drjit) -> Floats:
    """Return the first vector (3,) of a Dr.Jit array of vectors."""
    return np.array(point, np.float64).reshape(3, -1)[:, 0]


def _sampled_light(
    light: DeltaLight, point: Any, wavelengths: Any = None
) -> tuple[mi.DirectionSample3f, Drjit]:
    """Return the direction from a point to a light, and the spectrum of its irradiance."""
    it = dr.zeros(mi.SurfaceInteraction3f)
    if wavelengths is not None:
        it.wavelengths = wavelengths
    it.p = point
    return light.emitter.sample_direction(it, mi.Point2f(0.5, 0.5), True)


def _emission(light: DeltaLight, points: Floats, unit: float) -> Floats:
    """Return the radiant intensity in W/sr or, for directional lights, the irradiance in W/m^2.

    ``points`` (n, 3) are the illuminated points in scene units of ``unit`` metres.
    """
    total: Any = 0.0
    white = 0.0
    for wavelengths in _wavelength_samples():
        samples = [_sampled_light(light, point, wavelengths) for (point,) in point_batches(points)]
        values = [mi.luminance(mi.unpolarized_spectrum(v), wavelengths) for _, v in samples]
        total = total + joined(values)
        white += float(joined([mi.luminance(dr.ones(mi.UnpolarizedSpectrum), wavelengths)])[0])
    if not light.is_infinite:
        total = total * (joined([sample.dist for sample, _ in samples]) * unit) ** 2
    return np.broadcast_to(total / white, len(points))


# Number of samples of a spectrum, each with the wavelengths of one ray.
_SAMPLES = 24


def _wavelength_samples() -> list[Drjit]:
    """Return wavelength samples in nm, or one empty sample if the variant has no wavelengths."""
    none = dr.zeros(mi.SurfaceInteraction3f).wavelengths
    kind, count = type(none), dr.size_v(type(none))
    if not count:
        return [none]
    low, high = mi.MI_CIE_MIN, mi.MI_CIE_MAX
    grid = low + (high - low) * (np.arange(_SAMPLES * count) + 0.5) / (_SAMPLES * count)
    return [kind(*row) for row in grid.reshape(_SAMPLES, count).tolist()]


def _effective_areas(receiver: PlacedSource, image: Floats, is_infinite: bool) -> list[Term]:
    """Return the effective area of each polarised field of a receiver in m^2.

    ``image`` is the position of the light or its mirror image in m. If the light ``is_infinite``,
    this position only specifies a direction. Each area is returned in the form of a coupling term
    with unpolarised light.
    """
    axes = receiver.pose[:3, :3]
    point, scale = axes.T @ (image - receiver.pose[:3, 3]), 1 / (4 * math.pi)
    if is_infinite:
        radius = float(np.abs(receiver.source.bounds).max())
        distance = _FAR * radius * max(radius / receiver.wavelength, 1.0)
        point, scale = axes.T @ (image - receiver.centre), distance**2
        point *= distance / float(np.linalg.norm(point))
    method: Any = receiver.obliquity
    terms = []
    with scene_errors(f"cannot compute the direct light at receiver {receiver.name!r}: "):
        for taken, stokes in receiver.fields:
            area = 0.0
            for part, wavelength, weight in receiver.mixture.parts(taken, receiver.wavelength):
                field = amplitude(part, point, wavelength, method, tolerance=_TOLERANCE)
                area += weight * wavelength**2 * abs(complex(field)) ** 2
            terms.append((area * scale / receiver.norm, (1.0, 0.0, 0.0, 0.0), stokes))
    return terms
