"""Cross sections of bodies near a radar, by physical optics and reciprocity, equation (SC3).

Illuminated parts are divided into pieces on which the exact fields of both antennas are nearly
plane waves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from shapely.errors import GEOSException

from polywigner.errors import ArgumentError, GeometryError, value_text
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import (
    broadcast_shape,
    check_most,
    checked_choice,
    real_array,
    rigid_poses,
    warn_caller,
)
from polywigner.numerics import Complex, Floats, index_blocks
from polywigner.propagation import amplitude_with_error, field
from polywigner.propagation.boundary import Radiator, boundary_field, cosines_of, radiator_of
from polywigner.propagation.point_grids import tolerance_from
from polywigner.propagation.vector_fields import edge_integrals
from polywigner.radiometry.directions import checked_source
from polywigner.reception.couplings import NORMALISATIONS, root_of_norm
from polywigner.scattering.facet_beams import sums_of_beams
from polywigner.scattering.facets import (
    Facets,
    Pieces,
    Visible,
    facing_point,
    less_hidden,
    triangle_transforms,
    visible_from,
    visible_pieces,
    warn_of_reflections,
)
from polywigner.source import Array
from polywigner.source.obliquities import DEFAULT, DERIVATIVE_OF, OBLIQUITIES, BoundaryCondition
from polywigner.source.polarisation import checked_pair
from polywigner.source.tapers import checked_unit_vectors

Channel = Literal["vv", "hh", "vh", "hv"]
Polarisation = Channel | str | Sequence[Any]
Source = Aperture | Array

# Tolerance for unit vectors in single precision.
_UNIT = 1e-6


def normalised_vectors(name: str, vectors: Any, *shape: Any) -> Floats:
    """Return unit vectors (..., 3), or a vector of ``shape`` (3,), normalised to length 1."""
    array = checked_unit_vectors(name, vectors, *shape)
    return np.asarray(array / np.linalg.norm(array, axis=-1, keepdims=True))


def checked_polarisations(
    polarisation: Polarisation, to_radar: Floats, to_transmitter: Floats
) -> tuple[Complex, Complex]:
    """Return the polarisation vectors of receiver and transmitter, each of shape (..., 3).

    Raises ArgumentError unless the polarisation is a name such as "vh" or transverse unit vectors.
    """
    ends = to_radar, to_transmitter
    if isinstance(polarisation, str):
        channel = checked_choice(polarisation, "polarisation", get_args(Channel))
        names = zip(channel, ends, strict=True)
        q, p = (spherical_axes(towards)[name].astype(np.complex128) for name, towards in names)
        return q, p
    expected = (
        "expected polarisation to be None, one of 'vv', 'hh', 'vh', 'hv' (receiver first), or a "
        "pair of unit vectors (..., 3) normal to the directions"
    )
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
        if wrong.any():
            raise ArgumentError(
                f"{expected}, got a vector of length {lengths[wrong][0]:.6g} for the {name}"
            )
        if lean > _UNIT:
            angle = np.degrees(np.arcsin(min(1, lean)))
            raise ArgumentError(
                f"{expected}, got a vector for the {name} that is {angle:.3g} degrees from normal"
            )
    return q, p


def spherical_axes(towards: Floats) -> dict[str, Floats]:
    """Return unit vectors along the polar angle ("v") and the azimuth ("h"), shape (..., 3).

    Both angles increase along these vectors. For directions along z, the azimuth is 0.
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


# Model of the equivalent currents of polarised antennas.
_MODEL = "huygens"


@dataclass(frozen=True, eq=False)
class Antenna:
    """A radar antenna near a body, in m from the body's centre."""

    source: Source
    pose: Floats
    """Pose that maps the body's frame to the source's frame, shape (4, 4)."""
    wavelength: float
    normalise: str
    """Definition of transmitted power, "radiated" or "aperture"."""
    tolerance: float
    """Allowed error relative to the field with all parts in phase."""
    jones: Complex | None = None
    """Jones vectors in the source's frame, shape (2,) or (k, 2); None for scalar fields."""
    condition: BoundaryCondition = DEFAULT
    """Boundary condition for scalar fields."""

    @cached_property
    def extent(self) -> float:
        """Diagonal of the source's bounding box in m."""
        radiator = radiator_of(self.source)
        return float(np.linalg.norm(radiator.high - radiator.low))

    @cached_property
    def position(self) -> Floats:
        """Vector (3,) in m from the body's centre to the source's centre, in the body's frame."""
        centre = np.append(radiator_of(self.source).centre, 0.0)
        return np.asarray((centre - self.pose[:3, 3]) @ self.frame)

    @property
    def frame(self) -> Floats:
        """Axes of the source in the body's frame, as rows."""
        return self.pose[:3, :3]

    @cached_property
    def root_of_power(self) -> float:
        """Square root of the power of the unscaled source, in W^0.5."""
        method = self.condition if self.jones is None else _MODEL
        return root_of_norm(self.source, self.wavelength, method, self.normalise, self.jones)

    def to_frame(self, points: Floats) -> Floats:
        """Map points (..., 3) from the body's frame to the source's frame.

        In all methods of this class, points in the body's frame are relative to the body's centre.
        """
        return np.asarray(points @ self.frame.T + self.pose[:3, 3])

    def field(self, points: Floats) -> Complex:
        """Return the scalar field at points of the body's frame for 1 W of transmitted power."""
        return np.asarray(self._amplitude(points)[0] / self.root_of_power)

    def _amplitude(self, points: Floats) -> tuple[Complex, Floats]:
        """Return the scalar field of the unscaled source at points of the body, and its error.

        The error is absolute.
        """
        how: Any = self.wavelength, self.condition
        points = self.to_frame(points)
        field, error = amplitude_with_error(self.source, points, *how, tolerance=self.tolerance)
        return np.asarray(field), np.asarray(error)

    def wave(self, points: Floats) -> tuple[Complex, Complex, Floats]:
        """Return the wave at points (n, 3) of the body's frame for 1 W, and its power flow (n, 3).

        Scalar waves: field (n,) and gradient divided by ik (n, 3). Polarised waves: electric field,
        and magnetic field times the impedance of free space, both (n, 3). The power flow is a unit
        vector, or a shorter vector near nulls and where waves cross. Vectors are in the body's
        frame.
        """
        if self.jones is None:
            how = self.wavelength, self.condition, self.tolerance
            gradient = field_gradient(radiator_of(self.source), self.to_frame(points), *how)
            scale = self.wavelength / (2j * np.pi * self.root_of_power)
            field, slope = self.field(points), (gradient @ self.frame) * scale
            strength, flow = np.abs(field) ** 2, field.conj()[:, None] * slope
        else:
            field, slope = self._fields(points)
            strength, flow = np.square(np.abs(field)).sum(axis=1), np.cross(field, slope.conj())
        rate = flow.real / np.maximum(strength, np.finfo(float).tiny)[:, None]
        return field, slope, rate / np.maximum(np.linalg.norm(rate, axis=1, keepdims=True), 1.0)

    def _fields(self, points: Floats) -> tuple[Complex, Complex]:
        """Return the electric field, and the magnetic field times the impedance, for 1 W.

        Points and both results have the shape (..., 3) in the body's frame.
        """
        assert self.jones is not None
        # The magnetic field times the impedance of free space equals the electric field of the dual
        # currents. The polarisation of dual Huygens' currents is rotated by 90 degrees.
        dual = np.stack([-self.jones[..., 1], self.jones[..., 0]], axis=-1)
        electric, magnetic = (
            field(self.source, self.to_frame(points), self.wavelength, p, tolerance=self.tolerance)
            for p in (self.jones, dual)
        )
        scale = self.frame / self.root_of_power
        return electric @ scale, magnetic @ scale

    def power_at_centre(self) -> float:
        """Return |U|^2, or |E|^2 of a polarised wave, in W/m^2 at the body's centre for 1 W.

        The value is 0 if |U| is at most its error.
        """
        if self.jones is not None:
            return float(np.square(np.abs(self._fields(np.zeros(3))[0])).sum())
        value, error = self._amplitude(np.zeros(3))
        return float(abs(value) / self.root_of_power) ** 2 if abs(value) > error else 0.0

    def check_in_front(self, facets: Facets, name: str) -> None:
        """Raise GeometryError if a part of a body is behind the plane of the antenna."""
        lowest = float(self.to_frame(facets.corners.reshape(-1, 3))[:, 2].min())
        if not lowest > 0:
            raise GeometryError(
                f"the entire body must be in front of the plane of the {name}, got a part at z = "
                f"{lowest:.6g} m in the frame of the {name}, which radiates along +z; turn the "
                f"{name} towards the body, or move it back"
            )


def checked_poses(name: str, positions: ArrayLike, centre: Floats) -> Floats:
    """Return poses (..., 4, 4) from the frame at the body's centre to the source's frame.

    ``positions``: rigid poses (..., 4, 4) from the body's frame, or vectors (..., 3) from the
    body's centre to a source that faces the centre with its y axis upwards. ``centre`` (3,): centre
    in the body's frame in m. Raises ArgumentError for other shapes and zero vectors, and
    GeometryError for other poses.
    """
    expected = (
        f"with a source, expected {name} to be vectors (..., 3) in m from the body's centre to the "
        "source, or poses (..., 4, 4) that map the body's frame into the source's frame"
    )
    array = real_array(positions, expected, (..., 4, 4), (..., 3))
    if array.shape[-2:] == (4, 4):
        poses = rigid_poses(array, name)
        poses[..., :3, 3] += poses[..., :3, :3] @ centre
        return poses
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
    """Return unit vectors (..., 3) in the body's frame, from its centre towards the sources."""
    away = -np.einsum("...ji,...j->...i", poses[..., :3, :3], poses[..., :3, 3])
    # A source at the centre gives NaN here, and is rejected by check_in_front.
    with np.errstate(invalid="ignore"):
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))


def field_gradient(
    radiator: Radiator, points: Floats, wavelength: float, method: str, tolerance: float
) -> Complex:
    """Return the gradient of the exact field at points, equations (G6) and (G7), shape (n, 3).

    Points (n, 3) in m and gradient are in the source's frame. The gradient is in the unit of the
    field per m.
    """
    gradient = np.zeros((len(points), 3), np.complex128)
    for axis in range(3):
        carried = radiator.times(partial(_rates, wavelength, axis))
        if any(element.amplitudes.any() for element in carried.elements):
            name = method if axis < 2 else DERIVATIVE_OF[method]
            how = (wavelength, name, tolerance, "auto")
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


def _rates(wavelength: float, axis: int, frequencies: Floats) -> Complex:
    """Return 2 pi i times a component of the frequencies (m, 2) of plane waves.

    ``axis``: 0 for x, 1 for y, 2 for z (p_z/wavelength, also for evanescent waves).
    """
    if axis < 2:
        return np.asarray(2j * math.pi * frequencies[:, axis])
    return np.asarray(2j * math.pi / wavelength * cosines_of(frequencies, wavelength, False))


# Number of pieces per block.
_BLOCK = 1 << 15
# Largest number of pieces, which take 4 GB.
_MOST = 1 << 24
# Largest deviation from plane waves, divided by the square root of the tolerance. After
# extrapolation, the error is about the square of the deviation.
_OF_ROOT = 0.7
# Variance of positions in an equilateral triangle, divided by its squared side, and in an antenna,
# divided by its squared extent.
_OF_TRIANGLE, _OF_ANTENNA = 1 / 24, 1 / 12


def near_sums(
    facets: Facets,
    transmitter: Antenna,
    receiver: Antenna,
    polarisations: tuple[Complex, Complex],
    tolerance: float,
) -> Complex:
    """Return ratios b of received to transmitted amplitude, equation (SC3).

    ``polarisations``: vectors (..., 3) of receiver and transmitter. The vectors broadcast, and are
    normal to the directions from the body's centre. The result has the shape (...). At points other
    than the body's centre, the vectors are projected. For polarised antennas, only the shapes of
    the vectors are used. If both antennas are the same object, its fields are computed once. The
    result is NaN, with a warning, if the illuminated polygons cannot be computed.
    """
    try:
        lit = _illuminated(facets, transmitter, receiver)
    except GEOSException as error:
        warn_caller(
            f"the illuminated polygons cannot be computed and the result is NaN ({error}); rotate "
            "the body slightly, or simplify its mesh"
        )
        shape = np.broadcast_shapes(*(vectors.shape for vectors in polarisations))
        return np.full(shape[:-1], complex(np.nan, np.nan))
    pieces = _divided(lit, transmitter, receiver, math.sqrt(tolerance) * _OF_ROOT)
    sums = [_summed(pieces, split, transmitter, receiver, polarisations) for split in (False, True)]
    return np.asarray((4 * sums[1] - sums[0]) / 3)


def echo(
    facets: Facets,
    transmitter: Antenna,
    receiver: Antenna,
    polarisations: tuple[Complex, Complex],
    tolerance: float,
    bounces: int,
) -> complex:
    """Return the coupling of two scalar antennas by reflection from a body: -b of equation (SC3).

    Later reflections, up to ``bounces``, are computed for plane waves from the centre, equation
    (SC6).
    """
    total = near_sums(facets, transmitter, receiver, polarisations, tolerance)
    if bounces > 1:
        ahead, back = (
            end.position / -np.linalg.norm(end.position) for end in (transmitter, receiver)
        )
        lengths = np.array([transmitter.wavelength])
        _, later = sums_of_beams(facets, ahead[None], -back[None], lengths, False, bounces)
        if later is not None:
            q, p = (
                _transverse(vector, ray[None])[0]
                for vector, ray in zip(polarisations, (back, ahead), strict=True)
            )
            there = transmitter.field(np.zeros(3)) * receiver.field(np.zeros(3))
            total = total + there * (q @ later[0] @ np.cross(ahead, p))
    return -complex(total)


def _summed(
    pieces: Pieces,
    split: bool,
    transmitter: Antenna,
    receiver: Antenna,
    polarisations: tuple[Complex, Complex],
) -> Complex:
    """Return the sum of equation (SC3) over pieces; ``split`` divides each piece into four."""
    q, p = polarisations
    total = np.zeros(np.broadcast_shapes(q.shape, p.shape)[:-1], np.complex128)
    for some in index_blocks(len(pieces), _BLOCK):
        block = pieces.subset(some)
        block = _quartered(block) if split else block
        centre = block.corner + (block.first + block.second) / 3
        sent, slope, ahead = transmitter.wave(centre)
        is_same = receiver is transmitter
        back, _, behind = (sent, slope, ahead) if is_same else receiver.wave(centre)
        # The sum is the integral of the receiver's electric field times the currents n x H.
        if transmitter.jones is not None:
            parts = (back * np.cross(block.vector, slope)).sum(axis=-1)
        else:
            q_there = _transverse(q, centre - receiver.position)
            p_there = _transverse(p, centre - transmitter.position)
            parts = (q_there * slope).sum(axis=-1) * (p_there * block.vector).sum(axis=-1)
            parts -= (q_there * p_there).sum(axis=-1) * (slope * block.vector).sum(axis=-1)
            parts = parts * back
        nu = -(ahead + behind) / transmitter.wavelength
        cycles = [(nu * side).sum(axis=1) for side in (block.first, block.second)]
        weights = triangle_transforms(-(cycles[0] + cycles[1]) / 3, *cycles)
        total += (parts * weights).sum(axis=-1)
    return total


def _illuminated(facets: Facets, transmitter: Antenna, receiver: Antenna) -> Pieces:
    """Return the parts of a body that are visible from transmitter and receiver."""
    if not facets.casts_shadows:
        signs = facing_point(facets, transmitter.position)
        return visible_pieces(facets, Visible(signs, np.full(len(signs), None)))
    visible = visible_from(facets, transmitter.position, transmitter.frame)
    if receiver is not transmitter:
        there = visible_from(facets, receiver.position, receiver.frame)
        visible = less_hidden(visible, there, facing_point(facets, receiver.position))
    return visible_pieces(facets, visible)


def _divided(pieces: Pieces, transmitter: Antenna, receiver: Antenna, tolerance: float) -> Pieces:
    """Divide pieces until the fields of both antennas on each piece are nearly plane waves.

    ``tolerance``: largest deviation, equation (SC4). Raises ArgumentError for too many pieces.
    """
    done, count = [pieces.subset(slice(0))], 0
    while len(pieces):
        coarse = _deviation(pieces, transmitter, receiver) > tolerance
        done.append(pieces.subset(~coarse))
        pieces = pieces.subset(coarse)
        count += len(done[-1])
        things = "pieces with plane waves on the illuminated parts of the body"
        remedy = "use a larger tolerance, or move the source away from the body"
        check_most(count + 4 * len(pieces), _MOST, things, remedy)
        pieces = _quartered(pieces)
    return Pieces.of(done)


def _deviation(pieces: Pieces, transmitter: Antenna, receiver: Antenna) -> Floats:
    """Return the mean relative deviation of fields from plane waves on each piece, shape (n,).

    The deviations of both antennas are added, equation (SC4).
    """
    sides = (pieces.first, pieces.second, pieces.second - pieces.first)
    longest = np.max([np.linalg.norm(side, axis=1) for side in sides], axis=0)
    centre = pieces.corner + (pieces.first + pieces.second) / 3
    total = np.zeros(len(pieces))
    for antenna in (transmitter, receiver):
        wave_number = 2 * np.pi / antenna.wavelength
        to_centre = np.linalg.norm(centre - antenna.position, axis=1)
        height = np.abs(antenna.to_frame(centre)[:, 2])
        distance = np.maximum(to_centre - antenna.extent / 2, height)
        total += wave_number * longest**2 * _OF_TRIANGLE / distance
        spread = antenna.extent / np.hypot(distance, antenna.extent)
        total += (wave_number * longest * spread) ** 2 * _OF_TRIANGLE * _OF_ANTENNA
    return total


def _quartered(pieces: Pieces) -> Pieces:
    """Divide each triangle into four congruent triangles."""
    corner, first, second = pieces.corner, pieces.first / 2, pieces.second / 2
    return Pieces(
        np.concatenate([corner, corner + first, corner + second, corner + first + second]),
        np.concatenate([first, first, first, -first]),
        np.concatenate([second, second, second, -second]),
        np.tile(pieces.vector / 4, (4, 1)),
    )


def _transverse(polarisation: Complex, ray: Floats) -> Complex:
    """Return the normalised projections of polarisations (..., 3) normal to n rays.

    Each polarisation is projected for each ray, so the result has the shape (..., n, 3). ``ray``
    (n, 3): vectors of any length.
    """
    along = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    vectors = polarisation[..., None, :]
    vectors = vectors - (vectors * along).sum(axis=-1, keepdims=True) * along
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


# Default and smallest tolerance.
_TOLERANCE, _LEAST = 1e-3, 1e-6
# Tolerance of antenna fields, as a fraction of the specified tolerance.
_OF_FIELD = 1e-2


def near_sections(
    facets: Facets,
    to_radar: ArrayLike,
    to_transmitter: ArrayLike | None,
    wavelengths: Floats,
    source: Source,
    receiver: Source | None,
    polarisation: Polarisation | None,
    tolerance: float,
    normalise: str,
) -> tuple[Floats, Floats]:
    """Return cross sections in m^2 and ratios of received to transmitted power, shapes (...).

    The arguments are those of :func:`rcs`, and broadcast against each other. The ratios follow from
    equation (SC3). If an antenna has a null at the centre of the body, the cross section is
    infinite or NaN, with a warning.
    """
    allowed = tolerance_from(tolerance, _TOLERANCE, _LEAST)
    checked_choice(normalise, "normalise", NORMALISATIONS)
    for antenna in (source, receiver):
        if antenna is not None:
            checked_source(antenna)
    here = checked_poses("to_radar", to_radar, facets.centre)
    there = here
    if to_transmitter is not None:
        there = checked_poses("to_transmitter", to_transmitter, facets.centre)
    to_sender = directions_of(there)
    warn_of_reflections(facets, -to_sender.reshape(-1, 3))
    ends = receiver or source, source
    jones, (q, p) = _polarisations(polarisation, *ends, directions_of(here), to_sender)
    shape = broadcast_shape(
        wavelengths.shape, here.shape[:-2], there.shape[:-2], q.shape[:-2], p.shape[:-2]
    )
    lengths = np.broadcast_to(wavelengths, shape)
    poses = [np.broadcast_to(pose, (*shape, 4, 4)) for pose in (here, there)]
    q, p = (np.broadcast_to(v, (*shape, *v.shape[-2:])) for v in (q, p))
    sections, powers = np.empty(shape), np.empty(shape)
    same = jones[0] is jones[1] or np.array_equal(*jones)
    is_single = receiver is None and to_transmitter is None and same
    for k in np.ndindex(*shape):
        how = float(lengths[k]), normalise, _OF_FIELD * allowed
        back, transmitter = (
            Antenna(end, pose[k], *how, vector)
            for end, pose, vector in zip(ends, poses, jones, strict=True)
        )
        transmitter.check_in_front(facets, "source")
        back.check_in_front(facets, "receiver")
        back = transmitter if is_single else back
        sums = near_sums(facets, transmitter, back, (q[k][:, None], p[k][None]), allowed)
        # Powers are summed over received polarisations, and averaged over transmitted
        # polarisations.
        powers[k] = (np.abs(sums) ** 2).sum() / sums.shape[1]
        there_and_back = transmitter.power_at_centre() * back.power_at_centre()
        with np.errstate(divide="ignore", invalid="ignore"):
            sections[k] = 4 * np.pi / lengths[k] ** 2 * powers[k] / there_and_back
    if not np.isfinite(sections[np.isfinite(powers)]).all():
        warn_caller(
            "the cross section is undefined, because an antenna has a null at the centre of the "
            "body; use the power ratio, with return_power=True"
        )
    return sections, powers


Pair = tuple[Complex, Complex]


def _polarisations(
    polarisation: Any, receiver: Source, transmitter: Source, to_radar: Floats, to_sender: Floats
) -> tuple[Pair | tuple[None, None], Pair]:
    """Return Jones vectors, or None for scalar antennas, and polarisation vectors (..., k, 3).

    Both results are pairs of a value for the receiver and a value for the transmitter. With a
    polarisation, k is 1. Without a polarisation, k is 2, and each antenna has two perpendicular
    vectors.
    """
    both = [spherical_axes(towards) for towards in (to_radar, to_sender)]
    q, p = (np.stack([axes["v"], axes["h"]], axis=-2).astype(np.complex128) for axes in both)
    if polarisation is None:
        return (None, None), (q, p)
    if isinstance(polarisation, str) and polarisation in get_args(Channel):
        q, p = checked_polarisations(polarisation, to_radar, to_sender)
        return (None, None), (q[..., None, :], p[..., None, :])
    # Electric fields contain both components, so a single vector is enough.
    return checked_pair(polarisation, receiver, transmitter), (q[..., :1, :], p[..., :1, :])
