"""Antennas of a radar near a body: where they stand, and their fields as waves about places."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, GeometryError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import real_numbers, shape_of
from polywigner.illumination import Array
from polywigner.propagation import amplitude
from polywigner.propagation.field_slopes import FieldSlopes
from polywigner.propagation.panels import radiator_of
from polywigner.reception.norms import root_of_norm
from polywigner.reception.poses import checked_poses
from polywigner.scattering.facets import Facets
from polywigner.scattering.polarisations import spherical_axes

__all__ = ["Antenna", "Source", "checked_places", "directions_of"]

Source = Aperture | Array
Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Boundary condition of the fields of antennas.
_CONDITION = "rayleigh-sommerfeld-1"


@dataclass(frozen=True, eq=False)
class Antenna:
    """A source at its place beside a body, whose triangles are about the middle of their box."""

    source: Source
    pose: Floats
    """(4, 4) maps the body's frame into that of the source."""
    wavelength: float
    normalise: str
    """Power by which fields are divided: "radiated", or "aperture"."""
    tolerance: float
    """Of fields, relative to what reaches a place in phase."""

    @cached_property
    def extent(self) -> float:
        """Diagonal of the box around the source."""
        radiator = radiator_of(self.source)
        return float(np.linalg.norm(radiator.high - radiator.low))

    @cached_property
    def place(self) -> Floats:
        """The centre of the source, (3,) in the body's frame."""
        centre = np.append(radiator_of(self.source).centre, 0.0)
        return np.asarray((centre - self.pose[:3, 3]) @ self.pose[:3, :3])

    @property
    def frame(self) -> Floats:
        """Rows x, y and z of the source in the body's frame."""
        return self.pose[:3, :3]

    @cached_property
    def root_of_power(self) -> float:
        """Root of the power in W for |u|^2 in W/m^2."""
        return root_of_norm(self.source, self.wavelength, _CONDITION, self.normalise)

    def inside(self, places: Floats) -> Floats:
        """Places (n, 3) of the body's frame in that of the source."""
        return np.asarray(places @ self.pose[:3, :3].T + self.pose[:3, 3])

    def field(self, places: Floats) -> Complex:
        """The field per square root of watts, (n,)."""
        found = amplitude(
            self.source, self.inside(places), self.wavelength, tolerance=self.tolerance
        )
        return np.asarray(found / self.root_of_power)

    def power_at_middle(self) -> float:
        """|U|^2 at the body's middle over watts; 0 in a null, where no more than its error is."""
        place = self.inside(np.zeros(3))
        found, error = amplitude(
            self.source, place, self.wavelength, tolerance=self.tolerance, return_error=True
        )
        return float(abs(found) / self.root_of_power) ** 2 if abs(found) > error else 0.0

    def gradient(self, places: Floats) -> Complex:
        """Gradient of the field over ik, (n, 3) in the body's frame: of a wave, it times k."""
        slopes = FieldSlopes(
            self.source, self.wavelength, _CONDITION, self.tolerance, by_waves=False
        )
        found = slopes.of_points(self.inside(places)) @ self.pose[:3, :3].astype(np.complex128)
        return found * (self.wavelength / (2j * np.pi * self.root_of_power))

    def check_in_front(self, facets: Facets, name: str) -> None:
        """Raises GeometryError unless all of a body lies in front of the source's plane."""
        lowest = float(self.inside(facets.corners.reshape(-1, 3))[:, 2].min())
        if not lowest > 0:
            raise GeometryError(
                f"expected all of the body in front of the {name}'s plane, got a part at z = "
                f"{lowest:.6g} m of its frame; it radiates along its own +z, so turn it towards "
                "the body, or move it back"
            )


def checked_places(name: str, given: ArrayLike, middle: Floats) -> Floats:
    """Poses (..., 4, 4) that map the frame about the body's middle into the source's.

    From rigid poses that map the body's frame into the source's; or from vectors (..., 3) from the
    body's middle to the source, which looks back, with its y axis upwards.
    Raises ArgumentError or GeometryError for anything else.
    """
    expected = (
        f"expected {name} with a source as vectors (..., 3) in m from the body's middle to the "
        "source, or poses (..., 4, 4) that map the body's frame into the source's"
    )
    try:
        array = real_numbers(given)
    except ValueError as error:
        raise ArgumentError(f"{expected}, got {error}") from None
    if array.shape[-2:] == (4, 4):
        poses = checked_poses(array, name)
        poses[..., :3, 3] += poses[..., :3, :3] @ middle
        return poses
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ArgumentError(f"{expected}, got shape {shape_of(given)}")
    with np.errstate(over="ignore"):
        distance = np.linalg.norm(array, axis=-1, keepdims=True)
    if not (np.isfinite(distance) & (distance > 0)).all():
        raise ArgumentError(f"{expected}, got a vector that is zero or not finite")
    poses = np.zeros((*array.shape[:-1], 4, 4))
    towards = array / distance
    axes = spherical_axes(towards)
    poses[..., :3, :3] = -np.stack([axes["h"], axes["v"], towards], axis=-2)
    poses[..., 2, 3] = distance[..., 0]
    poses[..., 3, 3] = 1.0
    return poses


def directions_of(poses: Any) -> Floats:
    """Unit vectors (..., 3) from the body's middle towards the origin of each source's frame."""
    away = -np.einsum("...ji,...j->...i", poses[..., :3, :3], poses[..., :3, 3])
    with np.errstate(invalid="ignore"):  # inside the body, which is refused further on
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))
