"""Antennas of a radar: directions, polarisations, places, and fields near a body."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, GeometryError, value_text
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_vectors, rigid_poses
from polywigner.propagation import amplitude, field
from polywigner.propagation.boundary import Radiator, boundary_field, cosines_of, radiator_of
from polywigner.propagation.vector_fields import edge_integrals
from polywigner.reception.norms import root_of_norm
from polywigner.scattering.facets import Facets
from polywigner.source import Array
from polywigner.source.obliquities import DEFAULT, DERIVATIVE_OF, OBLIQUITIES, BoundaryCondition
from polywigner.source.tapers import checked_unit_vectors as unit_vectors_as_given

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

Channel = Literal["vv", "hh", "vh", "hv"]
Polarisation = Channel | str | Sequence[Any]

_EXPECTED = "expected polarisation as None, or one of 'vv', 'hh', 'vh', 'hv' (receiver first)"

# Vectors that passed through single precision pass.
_UNIT = 1e-6


def checked_unit_vectors(name: str, vectors: Any) -> Floats:
    """Unit vectors (..., 3), of length 1 after rounding; ArgumentError for anything else."""
    array = unit_vectors_as_given(name, vectors)
    return np.asarray(array / np.linalg.norm(array, axis=-1, keepdims=True))


def checked_wavelengths(wavelength: Any) -> Floats:
    """Wavelengths (...) in m; ArgumentError for anything but finite numbers above zero."""
    expected = "expected wavelengths as numbers above zero, in m"
    array = checked_vectors(wavelength, expected, ())
    usable = (array > 0) & np.isfinite(array)
    if not usable.all():
        raise ArgumentError(f"{expected}, got {array[~usable].flat[0]:g}; check its unit")
    return array


def broadcast_shape(*shapes: tuple[int, ...]) -> tuple[int, ...]:
    """The shape of results; ArgumentError for shapes of arguments that do not broadcast."""
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise ArgumentError(
            "expected wavelengths, directions and polarisations that broadcast, got shapes "
            f"{', '.join(map(str, shapes))}; add axes of length 1"
        ) from None


def checked_channel(polarisation: Any) -> Channel:
    """The name of a channel; ArgumentError for anything else."""
    if not isinstance(polarisation, str) or polarisation not in get_args(Channel):
        raise ArgumentError(f"{_EXPECTED}, got {value_text(polarisation)}")
    return cast(Channel, polarisation)


def checked_polarisations(
    polarisation: Polarisation, to_radar: Floats, to_transmitter: Floats
) -> tuple[Complex, Complex]:
    """Polarisations of the receiver and of the transmitter (..., 3), across their directions.

    Raises ArgumentError for anything but names of channels and such vectors.
    """
    ends = to_radar, to_transmitter
    if isinstance(polarisation, str):
        names = zip(checked_channel(polarisation), ends, strict=True)
        q, p = (spherical_axes(towards)[name].astype(np.complex128) for name, towards in names)
        return q, p
    expected = f"{_EXPECTED}, or a pair of unit vectors (..., 3) across each one's direction"
    try:
        q, p = (np.array(vectors, np.complex128) for vectors in polarisation)
        if q.shape[-1:] != (3,) or p.shape[-1:] != (3,):
            raise ValueError
        along = [(v * towards).sum(axis=-1) for v, towards in zip((q, p), ends, strict=True)]
    except (TypeError, ValueError):
        raise ArgumentError(f"{expected}, got {value_text(polarisation)}") from None
    for name, vectors, part in zip(("receiver", "transmitter"), (q, p), along, strict=True):
        lengths, lean = np.linalg.norm(vectors, axis=-1), np.abs(part).max(initial=0.0)
        wrong = ~(np.abs(lengths - 1) <= _UNIT)
        got = f"of length {lengths[wrong][0]:.6g}" if wrong.any() else ""
        if not got and lean > _UNIT:
            got = f"that leans by {np.degrees(np.arcsin(min(1, lean))):.3g} degrees towards it"
        if got:
            raise ArgumentError(f"{expected}, got one of the {name} {got}")
    return q, p


def spherical_axes(towards: Floats) -> dict[str, Floats]:
    """Unit vectors of the polar angle from +z (v) and of the azimuth (h) at directions (..., 3).

    Along z the azimuth counts as 0.
    """
    x, y, z = np.moveaxis(towards, -1, 0)
    across = np.hypot(x, y)
    at_pole = across == 0
    divisor = np.where(at_pole, 1.0, across)
    cosine, sine = np.where(at_pole, 1.0, x / divisor), y / divisor
    return {
        "v": np.stack([z * cosine, z * sine, -across], axis=-1),
        "h": np.stack([-sine, cosine, np.zeros_like(z)], axis=-1),
    }


Source = Aperture | Array

# Currents of those of polarised antennas.
_MODEL = "huygens"


@dataclass(frozen=True, eq=False)
class Antenna:
    """A source at its place beside a body, whose triangles are about the middle of their box."""

    source: Source
    pose: Floats
    """(4, 4) maps the body's frame into the source's."""
    wavelength: float
    normalise: str
    """Power by which fields are divided: "radiated", or "aperture"."""
    tolerance: float
    """Error of fields, relative to a field whose parts all arrive in phase."""
    jones: Complex | None = None
    """Jones vector (2,) in the source's axes, or (k, 2) of its elements; None: scalar fields."""
    condition: BoundaryCondition = DEFAULT
    """Boundary condition of scalar fields."""

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
        method = self.condition if self.jones is None else _MODEL
        return root_of_norm(self.source, self.wavelength, method, self.normalise, self.jones)

    def inside(self, places: Floats) -> Floats:
        """Places (n, 3) of the body's frame in the source's frame."""
        return np.asarray(places @ self.frame.T + self.pose[:3, 3])

    def field(self, places: Floats) -> Complex:
        """The field per square root of watts, (n,)."""
        return np.asarray(self._amplitude(places)[0] / self.root_of_power)

    def _amplitude(self, places: Floats) -> tuple[Complex, Floats]:
        """Field and its error for |u|^2 in W/m^2."""
        how: Any = self.wavelength, self.condition
        options: Any = {"tolerance": self.tolerance, "return_error": True}
        field, error = amplitude(self.source, self.inside(places), *how, **options)
        return np.asarray(field), np.asarray(error)

    def wave(self, places: Floats) -> tuple[Complex, Complex, Floats]:
        """Field, slope and direction of the wave per root of watts at places (n, 3).

        Of scalar antennas the field (n,) and its gradient over ik (n, 3); else E, and H times the
        impedance of free space, (n, 3). The direction (n, 3) is 1 long, or shorter near nulls and
        where waves cross.
        """
        if self.jones is None:
            how = self.wavelength, self.condition, self.tolerance
            gradient = field_gradient(radiator_of(self.source), self.inside(places), *how)
            scale = self.wavelength / (2j * np.pi * self.root_of_power)
            field, slope = self.field(places), (gradient @ self.frame) * scale
            strength, flow = np.abs(field) ** 2, field.conj()[:, None] * slope
        else:
            field, slope = self._vectors(places)
            strength, flow = np.square(np.abs(field)).sum(axis=1), np.cross(field, slope.conj())
        rate = flow.real / np.maximum(strength, np.finfo(float).tiny)[:, None]
        return field, slope, rate / np.maximum(np.linalg.norm(rate, axis=1, keepdims=True), 1.0)

    def _vectors(self, places: Floats) -> tuple[Complex, Complex]:
        assert self.jones is not None
        # H of currents is E of the dual ones, and Huygens' are their own
        turned = np.stack([-self.jones[..., 1], self.jones[..., 0]], axis=-1)
        electric, magnetic = (
            field(self.source, self.inside(places), self.wavelength, p, tolerance=self.tolerance)
            for p in (self.jones, turned)
        )
        scale = self.frame / self.root_of_power
        return electric @ scale, magnetic @ scale

    def power_at_middle(self) -> float:
        """|U|^2 at the body's middle over watts; 0 in a null, where no more than its error is."""
        if self.jones is not None:
            return float(np.square(np.abs(self._vectors(np.zeros(3))[0])).sum())
        found, error = self._amplitude(np.zeros(3))
        return float(abs(found) / self.root_of_power) ** 2 if abs(found) > error else 0.0

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
    array = checked_vectors(given, expected, ())
    if array.shape[-2:] == (4, 4):
        poses = rigid_poses(array, name)
        poses[..., :3, 3] += poses[..., :3, :3] @ middle
        return poses
    array = checked_vectors(array, expected, (3,))
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


def field_gradient(
    radiator: Radiator, points: Floats, wavelength: float, method: str, tolerance: float
) -> Complex:
    """Gradient (n, 3) in 1/m of the exact field at points (n, 3): (G6), (G7).

    ``method``: one of the boundary conditions; ``tolerance``: as of :func:`boundary_field`.
    """
    gradient = np.zeros((len(points), 3), np.complex128)
    for axis in range(3):
        carried = _carried(radiator, wavelength, axis)
        if any(element.amplitudes.any() for element in carried.elements):
            name = method if axis < 2 else DERIVATIVE_OF.get(method, method)
            how = (wavelength, name, tolerance, True, "auto")
            gradient[:, axis] = boundary_field(carried, points, *how)[0]
    condition = OBLIQUITIES[method]
    of_field = condition.field / (2 * math.pi)
    for sums in edge_integrals(radiator, points, wavelength, tolerance):
        z, inward = sums.points[:, 2:], -sums.normal
        kernel = of_field * z * sums.rise - 1j * condition.slope * sums.cosine * sums.wave
        gradient[sums.where, :2] += kernel @ inward / wavelength
        distance = (sums.begin * inward).sum(axis=1) - sums.points[:, :2] @ inward.T
        across = (sums.plane * inward).sum(axis=1)
        height = distance * sums.rise + 2j * math.pi * across * sums.wave
        gradient[sums.where, 2] += of_field * height.sum(axis=1) / wavelength
    return gradient


def _carried(radiator: Radiator, wavelength: float, axis: int) -> Radiator:
    """A source whose waves are multiplied by 2 pi i times their frequencies along an axis."""
    elements = []
    for element in radiator.elements:
        rates = (
            element.frequencies.T[axis]
            if axis < 2
            else (cosines_of(element.frequencies, wavelength, False) / wavelength)
        )
        elements.append(replace(element, amplitudes=element.amplitudes * (2j * math.pi * rates)))
    return replace(radiator, elements=tuple(elements))
