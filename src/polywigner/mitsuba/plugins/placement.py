"""Sources and receivers with their pose in the scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np
import shapely

from polywigner.errors import SceneError
from polywigner.geometry import Aperture
from polywigner.mitsuba.plugins.mixtures import SceneSource
from polywigner.mitsuba.plugins.source_parameters import SourceParameters, pose_of, reach_of
from polywigner.mitsuba.scenes.surfaces import PLACE_ERROR, wigner_emitters
from polywigner.numerics import Floats
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source.normal_form import SourceElement, normal_form
from polywigner.source.obliquities import CONDITIONS, DEFAULT
from polywigner.source.polarisation import Stokes, stokes_fields
from polywigner.transforms.public_transforms import energy_of

if TYPE_CHECKING:
    from polywigner.mitsuba.scenes.reflectors import Mirror


# Relative tolerance for comparing frequencies, because parameters are in single precision.
_ROUNDING = 1e-6
# Factors of the x and y coordinates in a mirror image.
_MIRROR = np.array([-1.0, 1.0])


@dataclass(frozen=True, eq=False)
class PlacedSource(SourceParameters):
    """Source or receiver in a scene, with the translation of its pose in metres."""

    name: str = ""
    medium: Any = None
    """Medium (fog) around the receiver, or None."""
    extent: float = 0.0
    """Largest coordinate of the source and adjacent flat surfaces in m, which limits precision."""

    @property
    def fields(self) -> list[tuple[SceneSource, Stokes]]:
        """Scalar sources, each with a Stokes vector.

        The sum of the Stokes vectors, weighted by the irradiances of the scalar sources, is the
        Stokes vector of the light. A single vector may be unphysical, such as (0, 0, 1, 0).
        """
        if self.polarisation is None:
            return [(self.source, (1.0, 0.0, 0.0, 0.0))]
        return stokes_fields(self.source, self.polarisation)

    def mirrored(self, normal: Floats, offset: float) -> PlacedSource:
        """Return the mirror image of the source in the plane ``normal . p = offset``.

        ``normal`` is a unit vector in the frame of the scene, and ``offset`` is in m.
        """
        reflection = np.eye(4)
        reflection[:3, :3] -= 2 * np.outer(normal, normal)
        reflection[:3, 3] = 2 * offset * normal
        pose = reflection @ self.pose @ np.diag([-1.0, 1.0, 1.0, 1.0])
        return replace(self, source=_mirrored(self.source), pose=pose)

    def image(self, chain: Iterable[Mirror]) -> PlacedSource:
        """Return the mirror image of the source after successive reflections by mirrors."""
        image = self
        for mirror in chain:
            image = image.mirrored(mirror.normal, mirror.offset)
        return image

    def points(self, positions: Floats) -> Floats:
        """Convert positions (n, 2) in the source's frame to scene points (n, 3), all in metres."""
        return np.asarray(positions @ self.pose[:3, :2].T + self.pose[:3, 3])

    @property
    def centre(self) -> Floats:
        """Centre of the bounding box of the source in the scene in m, shape (3,)."""
        return self.points(np.reshape(self.source.bounds, (2, 2)).mean(axis=0))

    @property
    def normal(self) -> Floats:
        """Unit normal in the scene on the side that radiates or receives, shape (3,)."""
        return self.pose[:3, 2]

    def cosines_to(self, point: Floats) -> tuple[float, float]:
        """Return the direction cosines along the source's x and y axes from its centre to a point.

        The point is in the frame of the scene, in m.
        """
        away = self.pose[:3, :3].T @ (point - self.centre)
        alpha, beta, _ = (away / np.linalg.norm(away)).tolist()
        return alpha, beta

    def pose_of(self, other: PlacedSource) -> Floats:
        """Return the pose of another source relative to this source, in m."""
        result = np.eye(4)
        result[:3, :3] = self.pose[:3, :3].T @ other.pose[:3, :3]
        result[:3, 3] = self.pose[:3, :3].T @ (other.pose[:3, 3] - self.pose[:3, 3])
        return result


def _mirrored(source: SceneSource) -> SceneSource:
    """Return a source with the signs of all x coordinates and x frequencies changed."""

    def image(element: SourceElement) -> SourceElement:
        """Return an element with the signs of all x coordinates changed."""
        outline: Any = element.outline
        polygons = shapely.transform(outline.polygons, lambda points: points * _MIRROR)
        frequencies = element.frequencies * _MIRROR
        return replace(element, outline=Aperture(polygons), frequencies=frequencies)

    form = normal_form(source).in_plane
    images, copies = [image(element) for element in form.distinct], form.repeated
    content: Any = tuple(images)
    if copies is not None:
        content = replace(copies, element=images[0], positions=copies.positions * _MIRROR)
    centre, curvature = form.centre * _MIRROR, form.curvature * np.outer(_MIRROR, _MIRROR)
    mirrored = replace(form, content=content, centre=centre, curvature=curvature, paths=None)
    result: SceneSource = mirrored.public
    return result


def placed_emitters(scene: mi.Scene) -> list[PlacedSource]:
    """Return the coherent sources of a scene with their poses, sorted by shape id."""
    sources = []
    for number, emitter in enumerate(wigner_emitters(scene)):
        placed = _placed(scene, emitter, emitter.get_shape().id() or f"emitter {number}")
        sources.append(replace(placed, power=_unrounded(emitter.power, emitter.spec.power)))
    return sources


def placed_receiver(scene: mi.Scene, sensor: Any, number: int) -> PlacedSource:
    """Return a receiver with its pose; ``number`` replaces a missing id."""
    placed = _placed(scene, sensor, sensor.id() or f"receiver {number}")
    return replace(placed, medium=sensor.get_medium())


def check_match(emitter: PlacedSource, receiver: PlacedSource) -> None:
    """Raise SceneError unless the frequency bands and scene units of two sources match."""
    bandwidth = receiver.noise["bandwidth"]
    ends = f"of emitter {emitter.name!r} and receiver {receiver.name!r}"
    frequencies = [SPEED_OF_LIGHT / end.wavelength for end in (emitter, receiver)]
    difference = abs(frequencies[0] - frequencies[1])
    if difference > max((bandwidth or 0.0) / 2, _ROUNDING * frequencies[1]):
        band = "" if bandwidth is None else f" within a band of {bandwidth:.6g} Hz"
        raise SceneError(
            f"the wavelengths {ends} must be equal{band}, got {emitter.wavelength:.6g} m and "
            f"{receiver.wavelength:.6g} m, which differ by {difference:.6g} Hz; set the same "
            "frequency for both, or a receiver bandwidth of at least twice the difference"
        )
    check_unit(emitter, receiver)


def check_unit(emitter: PlacedSource, receiver: PlacedSource) -> None:
    """Raise SceneError if an emitter and a receiver have different scene units."""
    if emitter.scene_unit != receiver.scene_unit:
        ends = f"of emitter {emitter.name!r} and receiver {receiver.name!r}"
        raise SceneError(
            f"the scene_unit {ends} must be equal, got {emitter.scene_unit:g} m and "
            f"{receiver.scene_unit:g} m; set the unit of the scene for both"
        )


def _placed(scene: mi.Scene, plugin: Any, name: str) -> PlacedSource:
    """Return the source of an emitter or receiver plugin with its present pose and wavelength."""
    spec = plugin.spec
    wavelength = _unrounded(getattr(plugin, "wavelength", spec.wavelength), spec.wavelength)
    changed = {"pose": pose_of(plugin), "wavelength": wavelength}
    extent = reach_of(scene, plugin) * spec.scene_unit
    return PlacedSource(**vars(spec) | changed, name=name, extent=extent)


def _unrounded(value: Any, known: float) -> float:
    """Return a parameter in double precision: ``known``, unless a user has changed the value."""
    number = float(np.asarray(value, dtype=np.float64).ravel()[0])
    return known if np.float32(number) == np.float32(known) else number


def check_obliquity(link: str, first: str, second: str) -> None:
    """Raise SceneError unless both ends of a link have the same boundary condition.

    ``link`` names the link in messages; ``first`` and ``second`` are the obliquities of its ends.
    """
    if first != second:
        raise SceneError(
            f"{link}: the obliquity must be the same at both ends, got {first!r} and {second!r}; "
            "set one boundary condition for both"
        )
    if first not in CONDITIONS:
        raise SceneError(
            f'{link}: the obliquity "paper" is not available for links, which require a boundary '
            f"condition; use {DEFAULT!r}"
        )


@dataclass(frozen=True, eq=False)
class FacingParts:
    """Parts of an emitter and a receiver that lie in front of each other's planes."""

    emitter: PlacedSource
    receiver: PlacedSource
    fraction: float
    """Product of the fractions of |u|^2 that the two parts contain."""


def facing_parts(emitter: PlacedSource, receiver: PlacedSource) -> FacingParts | None:
    """Return the parts of two sources that lie in front of each other's planes.

    The result is None if one of the sources has no such part.
    """
    sizes = [
        max(float(np.abs(values).max()) for values in (end.pose[:3, 3], end.source.bounds))
        for end in (emitter, receiver)
    ]
    parts, fraction = [], 1.0
    for end, other in ((emitter, receiver), (receiver, emitter)):
        pose = end.pose_of(other)
        normal = pose[:3, 2]
        least = float(normal @ pose[:3, 3]) + PLACE_ERROR * max(sizes)
        part = _part_in_front(end.source, normal, least)
        if part is None:
            return None
        if part is not end.source:
            fraction *= energy_of(part) / energy_of(end.source)
        parts.append(replace(end, source=part))
    return FacingParts(parts[0], parts[1], fraction)


def _part_in_front(source: SceneSource, normal: Floats, least: float) -> SceneSource | None:
    """Return the part of a source where ``normal . x > least``, or None if there is none.

    ``normal`` (3,) and x are in the frame of the source, and ``least`` is in m.
    """
    form = normal_form(source).in_plane
    parts = [_part_of_outline_in_front(element.outline, normal, least) for element in form.elements]
    pairs = list(zip(form.elements, parts, strict=True))
    if all(part is element.outline for element, part in pairs):
        return source
    in_front = [replace(element, outline=part) for element, part in pairs if part is not None]
    return form.with_elements(in_front, paths=None).public if in_front else None


def _part_of_outline_in_front(outline: Any, normal: Floats, least: float) -> Aperture | None:
    """Return the part of an outline that :func:`_part_in_front` retains, or None."""
    heights = np.concatenate(outline.rings) @ normal[:2] - least
    if (heights > 0).all():
        return outline
    if not (heights > 0).any():
        return None
    slope = float(np.hypot(*normal[:2]))
    ahead = normal[:2] / slope
    aside = np.array([-ahead[1], ahead[0]])
    far = 2 * (outline.diameter + float(np.abs(heights).max()) / slope)
    foot = outline.centre - ahead * (float(outline.centre @ normal[:2]) - least) / slope
    box = [foot + aside * far * s + ahead * far * a for s, a in ((1, 0), (-1, 0), (-1, 1), (1, 1))]
    return outline & Aperture(box)
