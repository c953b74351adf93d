"""Emitters and receivers of a scene as sources in space, as their parameters are now."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import SceneError
from polywigner.geometry import Aperture, Wavefront
from polywigner.illumination import Array
from polywigner.illumination.support import mirrored_source
from polywigner.mitsuba.given import rigid_pose
from polywigner.mitsuba.mixtures import PLAIN, Mixture
from polywigner.mitsuba.placement import matrix_of
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.transforms.wavefronts import flat_of

__all__ = ["PlacedSource", "check_match", "placed_emitter", "placed_receiver"]

Floats = NDArray[np.float64]

# Parameters are held in single precision.
_ROUNDING = 1e-6
_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class PlacedSource:
    """A source with its pose in space, in metres."""

    name: str
    source: Aperture | Array
    pose: Floats
    """(4, 4): of the source's frame in the scene's, the translation in m."""
    wavelength: float
    obliquity: str
    scene_unit: float
    norm: float
    """Power in W that the field as it is counts, all of the source: radiated, or int |u|^2."""
    power: float = 0.0
    """Radiated, in W."""
    mixture: Mixture = PLAIN
    """Of its light."""
    medium: Any = None
    """Fog that the source stands in, as the sensor says; None: none."""

    def mirrored(self, normal: Floats, offset: float) -> PlacedSource:
        """Its image behind the plane of the points p with ``normal`` . p = ``offset``, in m.

        A pose is a rotation: what the mirror turns inside out is the outline, and the field on it.
        """
        reflection = np.eye(4)
        reflection[:3, :3] -= 2 * np.outer(normal, normal)
        reflection[:3, 3] = 2 * offset * normal
        pose = reflection @ self.pose @ _MIRROR
        flat = mirrored_source(flat_of(self.source))
        if not isinstance(self.source, Wavefront):
            return replace(self, source=flat, pose=pose)
        sign = np.array([-1.0, 1.0])  # x changes its sign
        wave = self.source
        mirrored = Wavefront(flat, wave.curvature * np.outer(sign, sign), wave.centre * sign)
        return replace(self, source=mirrored, pose=pose)

    def points(self, places: Floats) -> Floats:
        """Places (n, 2) of its plane in space, (n, 3) in m."""
        result: Floats = places @ self.pose[:3, :2].T + self.pose[:3, 3]
        return result

    @property
    def normal(self) -> Floats:
        """(3,): where it radiates, or receives from."""
        return self.pose[:3, 2]

    def pose_of(self, other: PlacedSource) -> Floats:
        """(4, 4), in m: of the other's frame in this one's."""
        result = np.eye(4)
        result[:3, :3] = self.pose[:3, :3].T @ other.pose[:3, :3]
        result[:3, 3] = self.pose[:3, :3].T @ (other.pose[:3, 3] - self.pose[:3, 3])
        return result


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
    """Raise SceneError for an emitter that the receiver cannot receive, or in other units.

    ``bandwidth``: full width in Hz about the receiver's frequency; None: none.
    """
    both = f"of emitter {emitter.name!r} and receiver {receiver.name!r}"
    frequencies = [SPEED_OF_LIGHT / each.wavelength for each in (emitter, receiver)]
    apart = abs(frequencies[0] - frequencies[1])
    if apart > max((bandwidth or 0.0) / 2, _ROUNDING * frequencies[1]):
        band = "" if bandwidth is None else f", {bandwidth:.6g} Hz wide"
        raise SceneError(
            f"expected one wavelength {both}{band}, got {emitter.wavelength:.6g} m and "
            f"{receiver.wavelength:.6g} m, {apart:.6g} Hz apart; give both one frequency, or the "
            "receiver a bandwidth of twice that"
        )
    if emitter.scene_unit != receiver.scene_unit:
        raise SceneError(
            f"expected one scene_unit {both}, got {emitter.scene_unit:g} m and "
            f"{receiver.scene_unit:g} m; a scene has one unit"
        )


def _placed(plugin: Any, name: str) -> PlacedSource:
    spec = plugin.spec
    matrix = np.array(matrix_of(plugin.to_world)) if hasattr(plugin, "to_world") else spec.pose
    # those of the scene in double precision, unless somebody has changed them
    same = np.array_equal(matrix.astype(np.float32), spec.pose.astype(np.float32))
    pose = np.array(spec.pose if same else rigid_pose(matrix))
    pose[:3, 3] *= spec.scene_unit
    wavelength = _single(getattr(plugin, "wavelength", spec.wavelength), spec.wavelength)
    return PlacedSource(
        name,
        spec.source,
        pose,
        wavelength,
        spec.obliquity,
        spec.scene_unit,
        spec.norm,
        mixture=spec.mixture,
    )


def _single(value: Any, known: float) -> float:
    found = float(np.asarray(value, dtype=np.float64).ravel()[0])
    return known if np.float32(found) == np.float32(known) else found
