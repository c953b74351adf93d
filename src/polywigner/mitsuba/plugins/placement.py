"""Sources and receivers with their pose in the scene, in metres."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.geometry import Wavefront
from polywigner.mitsuba.plugins.source_parameters import SourceParameters, rigid_pose
from polywigner.mitsuba.scenes.surfaces import matrix_of, reach_at
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source.polarisation import Stokes, stokes_fields
from polywigner.source.support import mirrored_source
from polywigner.transforms.wavefronts import flat_of

Floats = NDArray[np.float64]

# Error of positions held in single precision, relative to the largest coordinate: rotation and
# translation round by 6e-8 each, the positions once more.
PLACE_ERROR = 5e-7
# Rounding of parameters held in single precision.
_ROUNDING = 1e-6
_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class PlacedSource(SourceParameters):
    """A source or receiver with its pose in space; the translation of ``pose`` is in metres."""

    name: str = ""
    medium: Any = None
    """Fog that the receiver stands in, as its sensor specifies; None: none."""
    reach: float = 0.0
    """Largest coordinate of the flat surfaces that touch it, in m; see module `surfaces`."""

    @property
    def fields(self) -> list[tuple[Any, Stokes]]:
        """Scalar sources, and the Stokes numbers by which their light adds up to the source's."""
        if self.polarisation is None:
            return [(self.source, (1.0, 0.0, 0.0, 0.0))]
        return stokes_fields(self.source, self.polarisation)

    def mirrored(self, normal: Floats, offset: float) -> PlacedSource:
        """Its image behind the plane of the points p with ``normal`` . p = ``offset``, in m."""
        reflection = np.eye(4)
        reflection[:3, :3] -= 2 * np.outer(normal, normal)
        reflection[:3, 3] = 2 * offset * normal
        pose = reflection @ self.pose @ _MIRROR
        flat = mirrored_source(flat_of(self.source))
        if not isinstance(self.source, Wavefront):
            return replace(self, source=flat, pose=pose)
        sign = np.array([-1.0, 1.0])  # x changes its sign
        wave = self.source
        mirrored = wave._with(
            source=flat, curvature=wave.curvature * np.outer(sign, sign), centre=wave.centre * sign
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
        low, high = np.reshape(self.source.bounds, (2, 2))
        corners = [[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])]
        reach = reach_at(scene, self.points(np.array(corners)) / self.scene_unit)
        return replace(self, reach=reach * self.scene_unit)

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


def is_source(emitter: Any) -> bool:
    """Whether an emitter is one of a ``wigner`` shape."""
    return getattr(type(emitter), "is_wigner", False)


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
    matrix = np.array(matrix_of(plugin.to_world))
    # the pose of the scene in double precision, unless a user has changed it
    same = np.array_equal(matrix.astype(np.float32), spec.pose.astype(np.float32))
    pose = np.array(spec.pose if same else rigid_pose(matrix))
    pose[:3, 3] *= spec.scene_unit
    wavelength = _single(getattr(plugin, "wavelength", spec.wavelength), spec.wavelength)
    return PlacedSource(**vars(spec) | {"name": name, "pose": pose, "wavelength": wavelength})


def _single(value: Any, known: float) -> float:
    found = float(np.asarray(value, dtype=np.float64).ravel()[0])
    return known if np.float32(found) == np.float32(known) else found


def reach_of(scene: Any, plugin: Any) -> float:
    """Return the ``reach`` of a source or receiver in its scene; see module `surfaces`."""
    return _placed(plugin, "").touching(scene).reach / plugin.spec.scene_unit
