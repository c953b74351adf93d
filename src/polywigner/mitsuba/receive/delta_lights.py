"""Light that a receiver gets from point, spot, projector and directional lights without scattering.

No ray meets such a light by chance, so that samples of a receiver never find it. A light of
radiant intensity I at the point y, and a plane wave of irradiance E from the direction s, give

    P = (lambda^2/N) |U(y)|^2 I                   P = (g |F(s)|^2/N) E = D(s) lambda^2/(4 pi) E

with U the field that the receiver would send to y, F its spectrum, N the power that it would
radiate and D its directivity: (RX8) of a point. A mirror shows an image of the light. The
transmission is the mean over rays from positions on the receiver, drawn in proportion to |u|^2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from polywigner.errors import PolywignerError, SceneError
from polywigner.mitsuba.plugins.placement import PlacedSource, is_source
from polywigner.mitsuba.receive.passing import RAYS, corners, points_on, traced
from polywigner.mitsuba.receive.received import DirectPath
from polywigner.mitsuba.scenes.reflectors import Mirror
from polywigner.mitsuba.scenes.surfaces import bounds_of, sorted_emitters
from polywigner.propagation.amplitudes import amplitude
from polywigner.source.obliquities import CONDITIONS

Floats = NDArray[np.float64]

# Distance of the point that stands for a direction: reaches squared over wavelengths, or reaches.
_FAR = 1e6
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class DeltaLight:
    """A light that illuminates each point from a single direction."""

    name: str
    emitter: Any

    @property
    def is_infinite(self) -> bool:
        return bool(mi.has_flag(self.emitter.flags(), mi.EmitterFlags.Infinite))


def delta_lights(scene: Any) -> list[DeltaLight]:
    """Return the lights of a scene that no ray meets by chance, coherent sources left out."""
    found = []
    for number, emitter in enumerate(sorted_emitters(scene)):
        if is_source(emitter):
            continue
        flags, name = emitter.flags(), emitter.id() or f"light {number}"
        if mi.has_flag(flags, mi.EmitterFlags.DeltaPosition):
            found.append(DeltaLight(name, emitter))
        elif mi.has_flag(flags, mi.EmitterFlags.DeltaDirection):
            if not mi.has_flag(flags, mi.EmitterFlags.Infinite):
                raise SceneError(
                    f"the light {name!r} ({emitter.class_name()}) shines in a single direction "
                    "from a surface, which receivers cannot take; use a spot or an area light"
                )
            found.append(DeltaLight(name, emitter))
    return found


def delta_paths(
    scene: Any, receiver: PlacedSource, ways: Sequence[tuple[Mirror, ...]]
) -> list[DirectPath]:
    """Return the paths by which delta lights reach a receiver, directly or by flat mirrors.

    Parameters
    ----------
    scene : the ``mi.Scene``.
    receiver : as of :func:`polywigner.mitsuba.plugins.placement.placed_receiver`.
    ways : chains of mirrors in the order of light.
    """
    lights = delta_lights(scene)
    if lights and receiver.obliquity not in CONDITIONS:
        raise SceneError(
            f"the receiver {receiver.name!r} has the obliquity {receiver.obliquity!r}, by which it "
            f"cannot take the light of {lights[0].name!r}; use one of {', '.join(CONDITIONS)}"
        )
    found = (_path(scene, receiver, light, tuple(chain)) for light in lights for chain in ways)
    return [path for path in found if path is not None and path.power > 0.0]


def _path(
    scene: Any, receiver: PlacedSource, light: DeltaLight, chain: tuple[Mirror, ...]
) -> DirectPath | None:
    end = points_on(receiver, RAYS)
    start, image = _starts(scene, receiver, light, end, chain)
    met = corners(start, end, chain)
    if met is None:
        return None
    way = [end, *met, start]
    arrives = (way[1] - end) @ receiver.normal > 0
    valid = arrives & np.all([np.isfinite(point).all(axis=1) for point in way], axis=0)
    if not valid.any():
        return None
    way = [point[valid] for point in way]
    emission = _emission(light, way[-2] / receiver.scene_unit, receiver.scene_unit)
    strength = float(emission.sum()) / len(emission)
    if strength == 0.0:
        return None
    shares, _ = traced(scene, way, receiver.medium, (receiver, None), chain)
    matrix = np.einsum("n,nij->ij", emission, shares) / (strength * RAYS)
    coupling, matched = _coupled(receiver, image, matrix, light.is_infinite)
    passing = float(matrix[0, 0])
    total = strength if light.is_infinite else 4 * math.pi * strength
    return DirectPath(
        tuple(mirror.name for mirror in chain),
        total * coupling * passing * matched,
        coupling,
        passing,
        receiver.cosines_to(image),
        matched,
        length=math.inf if light.is_infinite else math.dist(image, receiver.middle),
        light=light.name,
    )


def _image(points: Floats, chain: Sequence[Mirror]) -> Floats:
    for mirror in chain:
        points = mirror.image_of(points)
    return points


def _starts(
    scene: Any, receiver: PlacedSource, light: DeltaLight, end: Floats, chain: Sequence[Mirror]
) -> tuple[Floats, Floats]:
    """Points (n, 3) in m where rays to ``end`` start; the image of the light, (3,).

    A point at a distance of 1 m from the receiver's centre stands for the image of a direction.
    """
    unit = receiver.scene_unit
    sample, _ = _sampled(light, receiver.middle[None] / unit)
    if not light.is_infinite:
        place = _column(sample.p, 1) * unit
        return np.broadcast_to(place, end.shape), _image(place, chain)[0]
    # outside of all that the scene and the mirrors' images of it have
    shapes = [np.abs(bounds_of(shape)).max() for shape in scene.shapes()]
    size = 4.0 * max([float(np.abs(end).max()) / unit, *shapes, 1e-30]) * unit
    away = _column(sample.d, 1)
    origin = np.zeros((1, 3))
    turned = _image(away, chain) - _image(origin, chain)
    seen = end + size * (2 * len(chain) + 1) * turned
    return _image(seen, tuple(reversed(chain))), receiver.middle + turned[0]


def _sampled(light: DeltaLight, points: Floats, wavelengths: Any = None) -> tuple[Any, Any]:
    """Sample of the light from points (n, 3) in scene units, and its irradiance there."""
    it = dr.zeros(mi.SurfaceInteraction3f)
    if wavelengths is not None:
        it.wavelengths = wavelengths
    it.p = mi.Point3f(*points[0].tolist())
    if dr.is_jit_v(mi.Float):
        it.p = mi.Point3f(*(mi.Float(column.tolist()) for column in points.T))
    return light.emitter.sample_direction(it, mi.Point2f(0.5, 0.5), True)


def _emission(light: DeltaLight, points: Floats, unit: float) -> Floats:
    """Radiant intensity (n,) in W/sr towards points in scene units; or irradiance in W/m^2.

    The luminance of all colours, as films of one channel have it.
    """
    if not dr.is_jit_v(mi.Float) and len(points) > 1:
        return np.concatenate([_emission(light, point[None], unit) for point in points])
    total: Any = 0.0
    whole = 0.0
    for wavelengths in _colours():
        sample, value = _sampled(light, points, wavelengths)
        value = mi.unpolarized_spectrum(value)
        total = total + np.array(mi.luminance(value, wavelengths), np.float64).ravel()
        white = mi.luminance(dr.ones(mi.UnpolarizedSpectrum), wavelengths)
        whole += float(np.array(white, np.float64).ravel()[0])
    found = total / whole
    if not light.is_infinite:
        found = found * (np.array(sample.dist, np.float64).ravel() * unit) ** 2
    return np.broadcast_to(found, len(points))


# Sets of wavelengths that integrate the luminance of smooth spectra.
_SETS = 24


def _colours() -> list[Any]:
    """Wavelengths in nm of spectral variants, in sets of a sample each; others have none."""
    none = dr.zeros(mi.SurfaceInteraction3f).wavelengths
    kind, count = type(none), dr.size_v(type(none))
    if not count:
        return [none]
    low, high = mi.MI_CIE_MIN, mi.MI_CIE_MAX
    grid = low + (high - low) * (np.arange(_SETS * count) + 0.5) / (_SETS * count)
    return [kind(*row) for row in grid.reshape(_SETS, count).tolist()]


def _column(point: Any, count: int) -> Floats:
    return np.array(point, np.float64).reshape(3, -1).T[:count]


def _coupled(
    receiver: PlacedSource, image: Floats, matrix: Floats, is_infinite: bool
) -> tuple[float, float]:
    """Received power over the strength with nothing in between; fraction by its polarisation."""
    place = receiver.pose[:3, :3].T @ (image - receiver.pose[:3, 3])
    if is_infinite:
        reach = float(np.abs(receiver.source.bounds).max())
        away = receiver.pose[:3, :3].T @ (image - receiver.middle)
        distance = _FAR * reach * max(reach / receiver.wavelength, 1.0)
        place = away * (distance / float(np.linalg.norm(away)))
    scale = distance**2 if is_infinite else 1 / (4 * math.pi)
    size = len(matrix)
    whole = received = 0.0
    weight = 1.0 if receiver.polarisation is None else 0.5
    for taken, wanted in receiver.fields:
        area = _area(receiver, taken, place) * scale
        row = np.array(wanted[:size])
        whole += wanted[0] * area
        received += weight * float(row @ matrix[:, 0]) * area
    share = received / (whole * float(matrix[0, 0])) if whole > 0 and matrix[0, 0] > 0 else 0.0
    return whole, max(share, 0.0)


def _area(receiver: PlacedSource, taken: Any, place: Floats) -> float:
    """lambda^2 |U|^2/N at a point of the receiver's frame, the mean over a mixture."""
    total = 0.0
    method: Any = receiver.obliquity
    try:
        for part, wavelength, weight in receiver.mixture.parts(taken, receiver.wavelength):
            field = amplitude(part, place, wavelength, method, tolerance=_TOLERANCE)
            total += weight * wavelength**2 * abs(complex(field)) ** 2
    except PolywignerError as error:
        raise SceneError(f"the receiver {receiver.name!r}: {error}") from None
    return total / receiver.norm
