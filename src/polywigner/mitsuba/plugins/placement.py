"""Sources and receivers with their pose in the scene, in metres."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.geometry import Aperture, Wavefront
from polywigner.mitsuba.plugins.emissions import SceneSource
from polywigner.mitsuba.plugins.source_parameters import SourceParameters, pose_of
from polywigner.mitsuba.scenes.surfaces import PLACE_ERROR
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source.array import Array, repeated_element
from polywigner.source.obliquities import CONDITIONS, DEFAULT
from polywigner.source.polarisation import Stokes, stokes_fields
from polywigner.transforms.phase_space import energy_of
from polywigner.transforms.wavefronts import flat_of

Floats = NDArray[np.float64]

# Rounding of parameters held in single precision.
_ROUNDING = 1e-6
# x changes its sign.
_MIRROR = np.array([-1.0, 1.0])


@dataclass(frozen=True, eq=False)
class PlacedSource(SourceParameters):
    """A source or receiver with its pose in space; the translation of ``pose`` is in metres."""

    name: str = ""
    medium: Any = None
    """Fog that the receiver stands in, as its sensor specifies; None: none."""
    reach: float = 0.0
    """Largest coordinate of the flat surfaces that touch it, in m; see module `surfaces`."""

    @property
    def fields(self) -> list[tuple[SceneSource, Stokes]]:
        """Scalar sources, and the Stokes numbers by which their light adds up to the source's."""
        if self.polarisation is None:
            return [(self.source, (1.0, 0.0, 0.0, 0.0))]
        return stokes_fields(self.source, self.polarisation)

    def mirrored(self, normal: Floats, offset: float) -> PlacedSource:
        """Its image behind the plane of the points p with ``normal`` . p = ``offset``, in m."""
        reflection = np.eye(4)
        reflection[:3, :3] -= 2 * np.outer(normal, normal)
        reflection[:3, 3] = 2 * offset * normal
        pose = reflection @ self.pose @ np.diag([-1.0, 1.0, 1.0, 1.0])
        flat = _mirrored(flat_of(self.source))
        if not isinstance(self.source, Wavefront):
            return replace(self, source=flat, pose=pose)
        wave = self.source
        mirrored = wave._with(
            source=flat,
            curvature=wave.curvature * np.outer(_MIRROR, _MIRROR),
            centre=wave.centre * _MIRROR,
        )
        return replace(self, source=mirrored, pose=pose)

    def image(self, chain: Iterable[Any]) -> PlacedSource:
        """Its image in mirrors, each with a ``normal`` and an ``offset``, in the light's order."""
        image = self
        for mirror in chain:
            image = image.mirrored(mirror.normal, mirror.offset)
        return image

    def points(self, places: Floats) -> Floats:
        """Places (n, 2) of its plane in space, (n, 3) in m."""
        result: Floats = places @ self.pose[:3, :2].T + self.pose[:3, 3]
        return result

    def touching(self, scene: Any) -> PlacedSource:
        """Itself, with the ``reach`` of surfaces of a scene."""
        return replace(self, reach=self.reach_in(scene, self.pose) * self.scene_unit)

    @property
    def middle(self) -> Floats:
        """(3,) in m, of the source's bounds."""
        result: Floats = self.points(np.reshape(self.source.bounds, (2, 2)).mean(axis=0)[None])[0]
        return result

    @property
    def normal(self) -> Floats:
        """(3,): where it radiates, or receives from."""
        return self.pose[:3, 2]

    def cosines_to(self, point: Floats) -> tuple[float, float]:
        """Direction cosines from the middle to a point (3,) in m, in the source's frame."""
        away = self.pose[:3, :3].T @ (point - self.middle)
        alpha, beta, _ = (away / np.linalg.norm(away)).tolist()
        return alpha, beta

    def pose_of(self, other: PlacedSource) -> Floats:
        """(4, 4), in m: of the other's frame in this one's."""
        result = np.eye(4)
        result[:3, :3] = self.pose[:3, :3].T @ other.pose[:3, :3]
        result[:3, 3] = self.pose[:3, :3].T @ (other.pose[:3, 3] - self.pose[:3, 3])
        return result


def _mirrored(source: Any) -> Any:
    """An aperture or an array, with its field, as a mirror shows it: u(-x, y)."""
    if isinstance(source, Aperture):
        copy = Aperture(shapely.transform(source.polygons, lambda points: points * _MIRROR))
        field: Any = source.illumination
        if field is None:
            return copy
        waves = field._from(field.amplitudes, field.frequencies * _MIRROR)
        return copy.with_illumination(waves)
    if source.repeated is not None:
        element, positions = source.repeated
        return repeated_element(_mirrored(element), positions * _MIRROR, source.weights)
    return Array([_mirrored(element) for element in source.elements_in_plane], source.weights)


def placed_emitter(emitter: Any, number: int) -> PlacedSource:
    """A wigner emitter; ``number`` names one without an id."""
    name = emitter.get_shape().id() or f"emitter {number}"
    return replace(_placed(emitter, name), power=_single(emitter.power, emitter.spec.power))


def placed_receiver(sensor: Any, number: int) -> PlacedSource:
    """A wigner receiver; ``number`` names one without an id."""
    placed = _placed(sensor, sensor.id() or f"receiver {number}")
    return replace(placed, medium=sensor.get_medium())


def check_match(
    emitter: PlacedSource, receiver: PlacedSource, bandwidth: float | None = None
) -> None:
    """Raise SceneError for an emitter that the receiver cannot receive, or in other units."""
    both = f"of emitter {emitter.name!r} and receiver {receiver.name!r}"
    frequencies = [SPEED_OF_LIGHT / each.wavelength for each in (emitter, receiver)]
    apart = abs(frequencies[0] - frequencies[1])
    if apart > max((bandwidth or 0.0) / 2, _ROUNDING * frequencies[1]):
        band = "" if bandwidth is None else f", {bandwidth:.6g} Hz wide"
        raise SceneError(
            f"expected one wavelength {both}{band}, got {emitter.wavelength:.6g} m, {apart:.6g} Hz "
            "off the receiver's; give both one frequency, or the receiver a bandwidth of twice that"
        )
    check_unit(emitter, receiver)


def check_unit(emitter: PlacedSource, receiver: PlacedSource) -> None:
    """Raise SceneError for two ends in other units."""
    if emitter.scene_unit != receiver.scene_unit:
        both = f"of emitter {emitter.name!r} and receiver {receiver.name!r}"
        raise SceneError(
            f"expected one scene_unit {both}, got {emitter.scene_unit:g} m and "
            f"{receiver.scene_unit:g} m; a scene has one unit"
        )


def _placed(plugin: Any, name: str) -> PlacedSource:
    spec = plugin.spec
    wavelength = _single(getattr(plugin, "wavelength", spec.wavelength), spec.wavelength)
    return PlacedSource(
        **vars(spec) | {"name": name, "pose": pose_of(plugin), "wavelength": wavelength}
    )


def _single(value: Any, known: float) -> float:
    found = float(np.asarray(value, dtype=np.float64).ravel()[0])
    return known if np.float32(found) == np.float32(known) else found


def check_obliquity(link: str, one: str, other: str) -> None:
    """Raise SceneError for a link without one boundary condition at both ends."""
    if one != other:
        raise SceneError(
            f"{link}: expected one obliquity, got {one!r} and {other!r}; a link has one boundary "
            "condition at both ends: give both the same"
        )
    if one not in CONDITIONS:
        raise SceneError(
            f'{link}: expected a boundary condition as obliquity, got "paper", of which there are '
            f"no links; use {DEFAULT!r}"
        )


@dataclass(frozen=True, eq=False)
class FacingParts:
    """Parts of two sources in front of each other's plane."""

    emitter: PlacedSource
    receiver: PlacedSource
    share: float
    """Product of the shares of int |u|^2 that face each other: 1 where all faces all."""


def facing_parts(emitter: PlacedSource, receiver: PlacedSource) -> FacingParts | None:
    """The parts that face each other; None where there are none, as in one plane."""
    sizes = [
        max(float(np.abs(values).max()) for values in (placed.pose[:3, 3], placed.source.bounds))
        for placed in (emitter, receiver)
    ]
    rounding = PLACE_ERROR * max(sizes)
    parts, share = [], 1.0
    for one, other in ((emitter, receiver), (receiver, emitter)):
        pose = one.pose_of(other)
        part = _part_in_front(one.source, pose[:3, 2], pose[:3, 3], rounding)
        if part is None:
            return None
        if part is not one.source:
            share *= energy_of(part) / energy_of(one.source)
        parts.append(replace(one, source=part))
    return FacingParts(parts[0], parts[1], share)


def _part_in_front(
    source: Any, normal: Floats, place: Floats, rounding: float
) -> SceneSource | None:
    """The part of a source in z = 0 before of the plane through ``place``."""
    if isinstance(source, Wavefront):
        flat = _part_in_front(source.source, normal, place, rounding)
        if flat is None or flat is source.source:
            return None if flat is None else source
        return source.on(flat)
    elements = source.elements_in_plane
    parts = [_cut(element, normal, float(normal @ place) + rounding) for element in elements]
    if all(part is element for part, element in zip(parts, elements, strict=True)):
        return source
    weights = source.weights if isinstance(source, Array) else np.ones(1)
    kept = [(part, w) for part, w in zip(parts, weights, strict=True) if part is not None]
    return Array([part for part, _ in kept], [w for _, w in kept]) if kept else None


def _cut(element: Aperture, normal: Floats, least: float) -> Aperture | None:
    """Where ``normal`` . x > ``least``; the very element where that is everywhere."""
    corners = np.concatenate(element.rings)
    heights = corners @ normal[:2] - least
    if (heights > 0).all():
        return element
    if not (heights > 0).any():
        return None
    slope = float(np.hypot(*normal[:2]))
    ahead = normal[:2] / slope
    beside = np.array([-ahead[1], ahead[0]])
    far = 2 * (element.diameter + float(np.abs(heights).max()) / slope)
    foot = element.centre - ahead * (float(element.centre @ normal[:2]) - least) / slope
    box = [foot + beside * far * s + ahead * far * a for s, a in ((1, 0), (-1, 0), (-1, 1), (1, 1))]
    found = shapely.intersection(element.polygons, shapely.Polygon(box))
    polygons = [part for part in shapely.get_parts(found) if part.area > 0]
    if not polygons:
        return None
    return Aperture(shapely.MultiPolygon(polygons)).with_illumination(element.illumination)
