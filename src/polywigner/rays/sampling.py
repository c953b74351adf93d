"""Rays drawn from the Wigner function of a source."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, require, value_text
from polywigner.execution import Engine
from polywigner.geometry import PlacedAperture, Wavefront
from polywigner.geometry.arguments import (
    checked_choice,
    checked_count,
    checked_generator,
    checked_number,
    checked_wavelength,
    rigid_pose,
    takes_frequency,
)
from polywigner.propagation.far_fields import check_slopes, radiated_power
from polywigner.propagation.stores import source_attrs
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import (
    PlaneSource,
    checked_radiator,
    checked_unit_vectors,
    largest_lag,
)
from polywigner.rays.bundles import bundle
from polywigner.source.obliquities import ObliquityName, obliquity_of
from polywigner.transforms import sample_automean, wigner
from polywigner.transforms.wavefronts import flat_source, is_partly_coherent

if TYPE_CHECKING:
    import xarray

RaySampling = Literal["uniform", "quasi-random"]

Values = NDArray[np.float64]

# Rays of one step: some 200 MB.
_BLOCK = 1 << 20
# Independent sets of quasi-random numbers, whose scatter gives the error within a fifth.
BATCHES = 16
# Cones may reach this fraction of pi/2 behind the source: axes may have single precision.
_UNIT = 1e-6
# Smallest cosine of the hemisphere after rounding, so that factors such as 1/cos^2 stay finite.
_LEAST_COSINE = 1e-8


def _numbers(
    sampling: str, count: int, seed: Any, tilts: int
) -> Iterator[tuple[Values, int | None]]:
    """Yield uniform numbers (m, k) in [0, 1), and the batch of quasi-random numbers.

    Two columns are for the direction, two for the position, and ``tilts`` for the tilt. Raises
    MissingExtraError for quasi-random numbers without scipy.
    """
    generator = checked_generator(seed)
    if sampling != "quasi-random":
        for start in range(0, count, _BLOCK):
            yield generator.random((min(_BLOCK, count - start), 4 + tilts)), None
        return
    library = require("scipy.stats.qmc", "arrays", "has quasi-random numbers (Sobol)")
    for batch in range(BATCHES):
        size = (count + batch) // BATCHES
        sequence = library.Sobol(4 + tilts, scramble=True, seed=generator)
        numbers = sequence.random_base2(math.ceil(math.log2(size)))[:size]
        numbers = np.minimum(numbers, 1 - 2.0**-53)  # scrambled numbers may round to 1
        for start in range(0, size, _BLOCK):
            yield numbers[start : start + _BLOCK], batch


def _normal_numbers(numbers: Values) -> Values:
    """Map uniform numbers (n, 2) continuously to standard normal numbers (n, 2).

    The square of the radius is exponential (Box and Muller 1958).
    """
    plane = _disc(numbers)
    before = (plane**2).sum(axis=1)
    # The rim of the disc is mapped to infinity, so the largest value is just below 1.
    after = -2 * np.log1p(-np.minimum(before, 1 - np.finfo(np.float64).epsneg))
    outward = np.sqrt(np.divide(after, before, out=np.full_like(before, 2.0), where=before > 0))
    return np.asarray(plane * outward[:, None])


@dataclass(frozen=True)
class Cone:
    """Directions in a cone, concentrated about a beam in the solid angle projected on its axis."""

    frame: Values
    """Rotation (3, 3), whose last column is the axis."""
    radius: float
    """Sine of the half angle."""
    width: float
    """Sine of the half width of the beam; infinity: uniform directions."""

    def directions(self, numbers: Values, slope: Values | None = None) -> tuple[Values, Values]:
        """Return unit vectors (n, 3) for numbers (n, 2), and the inverse of their density.

        The density is per solid angle projected on z. ``slope`` (n, 2): direction cosines of the
        beam of each ray relative to the axis, or None for the axis.
        """
        centre = None if slope is None or math.isinf(self.width) else self._beam_centres(slope)
        ratio = self.width / self.radius
        # ratio * ratio overflows to infinity, but ratio**2 raises an error.
        plane, area = _concentrated(_disc(numbers), ratio * ratio, centre)
        plane *= self.radius
        along = np.sqrt(np.maximum(1.0 - (plane**2).sum(axis=1), 0.0))
        vectors = np.column_stack([plane, along]) @ self.frame.T
        vectors[:, 2] = np.maximum(vectors[:, 2], _LEAST_COSINE)
        solid = math.pi * self.radius**2 * vectors[:, 2] / np.maximum(along, _LEAST_COSINE)
        return vectors, area * solid

    def _beam_centres(self, slope: Values) -> Values:
        """Return the beam centres in the unit disc of directions, or the nearest points of it."""
        cosines = self.frame[:2, 2] + slope
        cosines /= np.maximum(np.hypot(*cosines.T), 1.0)[:, None]  # at most along the plane
        along = np.sqrt(np.maximum(1.0 - (cosines**2).sum(axis=1), 0.0))
        plane = np.column_stack([cosines, along]) @ self.frame[:, :2] / self.radius
        return np.asarray(plane / np.maximum(np.hypot(*plane.T), 1.0)[:, None])


def cone_of(half_angle: Any, axis: Any, width: float) -> Cone:
    """Return the cone of a half angle in rad about a direction; None: the hemisphere about z.

    Raises ArgumentError for other arguments, and for cones that reach behind the source.
    """
    meaning = "a half angle in rad, above 0 and up to pi/2"
    angle = math.pi / 2 if half_angle is None else checked_number(half_angle, "cone", meaning)
    if not 0 < angle <= math.pi / 2:
        raise ArgumentError(f"expected cone as {meaning}, got {value_text(half_angle)}")
    vector = checked_unit_vectors("axis", axis)
    if vector.ndim > 1:
        raise ArgumentError(f"expected axis as one unit vector (3,), got {vector.shape}")
    vector = vector / np.linalg.norm(vector)
    tilt = math.atan2(math.hypot(*vector[:2]), vector[2])
    if tilt + angle > math.pi / 2 * (1 + _UNIT):
        raise ArgumentError(
            f"expected a cone in front of the source, got {angle:.4g} rad about an axis "
            f"{tilt:.4g} rad from the normal; use a narrower cone, or none for all directions"
        )
    return Cone(_frame(vector), math.sin(angle), width)


def _frame(axis: Values) -> Values:
    """Return a rotation whose last column is the axis, the identity for z."""
    x, y, z = axis
    # The axis has z >= 0, so the denominator is not zero (Duff and others 2017).
    a = -1.0 / (1.0 + z)
    b = x * y * a
    return np.array([[1 + x * x * a, b, x], [b, 1 + y * y * a, y], [-x, -y, z]])


def _concentrated(plane: Values, core: float, centre: Values | None) -> tuple[Values, Values]:
    """Move points of the unit disc towards centres; return points and area weights (n,).

    With t the square of the distance from the centre, None for the disc's centre, the density is
    proportional to 1/(core + t), the decay of W across the edges of a polygon. Its integral
    ln(1 + t/core) is inverted on each line from the centre to the rim.
    """
    before = (plane**2).sum(axis=1)
    if math.isinf(core):
        return plane, np.ones_like(before)
    integral = np.log1p((1.0 if centre is None else _reach(plane, centre)) / core)
    after = core * np.expm1(integral * before)
    least = np.broadcast_to(core * integral, before.shape).copy()
    inward = np.sqrt(np.divide(after, before, out=least, where=before > 0))
    points = plane * inward[:, None]
    return points if centre is None else centre + points, (core + after) * integral


def _reach(plane: Values, centre: Values) -> Values:
    """Return squared distances (n,) from centres in the unit disc to its rim, along ``plane``."""
    length = np.hypot(*plane.T)
    along = np.divide(
        (plane * centre).sum(axis=1), length, out=np.zeros_like(length), where=length > 0
    )
    inside = np.maximum(1.0 - (centre**2).sum(axis=1), 0.0)
    chord = np.sqrt(along**2 + inside)
    # The quotient avoids the cancellation in chord - along for positive values.
    reach = np.divide(inside, chord + along, out=chord - along, where=along > 0)
    return np.asarray(reach**2)


def _disc(numbers: Values) -> Values:
    """Map the unit square to the unit disc, continuously and with constant density.

    Shirley and Chiu 1997: squares about the centre become circles.
    """
    a, b = 2 * numbers.T - 1
    is_wide = np.abs(a) > np.abs(b)
    radius = np.where(is_wide, a, b)
    other = np.where(is_wide, b, a)
    ratio = np.divide(other, radius, out=np.zeros_like(a), where=radius != 0)
    angle = np.where(is_wide, math.pi / 4 * ratio, math.pi / 2 - math.pi / 4 * ratio)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


Directions = Literal["beam", "uniform"]

# 12 GB of rays.
_MOST = 100_000_000
# The squares of powers in W are summed for the error.
_MOST_WATTS = 1e100


@takes_frequency
def sample_rays(
    source: PlaneSource | Wavefront | PlacedAperture,
    wavelength: float,
    count: int,
    seed: int | np.random.Generator | None = 0,
    *,
    sampling: RaySampling = "uniform",
    cone: float | None = None,
    axis: ArrayLike = (0.0, 0.0, 1.0),
    directions: Directions = "beam",
    to_world: ArrayLike | None = None,
    obliquity: ObliquityName | None = None,
    power: float | None = None,
    engine: Engine = "auto",
) -> xarray.Dataset:
    """Draw rays of a source, weighted by its Wigner function: positions, directions and watts.

    Each of n rays has the weight ``W(x, s_par/lambda) h/(lambda^2 p n)``, with h = g/cos and p the
    density of rays per area and projected solid angle. The sum of weights is an unbiased estimate
    of the power in the cone, without ``cone`` of :func:`radiated_power`: docs/signed_rays.md, (Y1).
    Trace the rays through ray optics, then :func:`polywigner.rays.rebuild` the irradiance.

    Parameters
    ----------
    source : Aperture, PlacedAperture, Array or Wavefront
        Apertures in the plane z = 0 with any fields, |u|^2 in W/m^2; a Wavefront may be curved or
        partially coherent. Each ray of a partially coherent wave has a random tilt. The source
        radiates to +z.
    wavelength : float
        In m; or ``frequency=`` in Hz.
    count : int
        Number of rays, up to 100 million.
    seed : int or numpy.random.Generator, default 0
        Seed of the random numbers.
    sampling : {"uniform", "quasi-random"}, default "uniform"
        Positions uniform in the automean: from independent random numbers, or from Sobol sequences
        with about half the noise. Sobol sequences need scipy, of the extra ``arrays``; the rays are
        16 independent sets, numbered by the coordinate ``batch``.
    cone : float, optional
        Half angle in rad of the cone of directions; default: the hemisphere.
    axis : array_like, shape (3,), default (0, 0, 1)
        Unit vector along the axis of the cone in the frame of the source; use the beam direction of
        a steered source.
    directions : {"beam", "uniform"}, default "beam"
        "beam" draws most rays within wavelength/diameter of the axis, or of the local wave of a
        Wavefront; "uniform" is uniform in projected solid angle.
    to_world : array_like, shape (4, 4), optional
        Rigid pose of the source, translation in m; default: the pose of a placed aperture, or the
        identity.
    obliquity : str, optional
        As in :func:`irradiance`; None: h = cos; "paper": h = 1. Wavefronts support these two.
    power : float, optional
        Radiated power in W over all directions; default: the power of the unscaled source.
    engine : str, default "auto"
        See :func:`fourier`.

    Returns
    -------
    xarray.Dataset
        ``position`` (ray, component) in m, ``direction`` (ray, component) and ``weight`` (ray) in
        W. The settings are in its attributes.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range.
    GeometryError
        If a pose is not rigid, or an Array has elements outside the plane z = 0.
    IlluminationError
        If a power is requested of a source that radiates none.
    MissingExtraError
        If xarray or scipy is not installed.

    Examples
    --------
    >>> import polywigner as pw
    >>> square = pw.shapes.square(10e-3)
    >>> rays = pw.sample_rays(square, 3.2e-3, 4096)
    >>> abs(float(rays.weight.sum()) / pw.radiated_power(square, 3.2e-3) - 1) < 0.1
    True
    >>> bool((rays.weight < 0).any())
    True
    """
    radiator, pose = _placed(source, to_world)
    length = checked_wavelength(wavelength)
    checked_choice(sampling, "sampling", get_args(RaySampling))
    least = 2 * BATCHES if sampling == "quasi-random" else 1
    n = checked_count(count, "count", least, _MOST)
    checked_choice(directions, "directions", get_args(Directions))
    width = math.inf if directions == "uniform" else length / largest_lag(radiator)
    where = cone_of(cone, axis, width)
    condition = obliquity_of(obliquity)
    name = condition.name
    check_slopes(radiator, name)
    flat = flat_source(radiator)
    scale = _scale(radiator, length, name, power)
    parts = condition.terms(flat, length)
    tilts = 2 if is_partly_coherent(radiator) else 0

    position, direction, weight = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    batch = np.empty(n, np.int32) if sampling == "quasi-random" else None
    start = 0
    for numbers, number in _numbers(sampling, n, seed, tilts):
        some = slice(start, start + len(numbers))
        first, tilt = np.split(numbers, [numbers.shape[1] - tilts], axis=1)
        points, per_area = sample_automean(flat, first[:, 2:])
        slope = None
        if isinstance(radiator, Wavefront):
            # A curved wave shifts W of the flat source by its slope Q (x - c), (Q2); a partially
            # coherent wave is a mean over normal tilts, (PC4).
            slope = (points - radiator.centre) @ radiator.curvature
            if tilts:
                slope += _normal_numbers(tilt) / (2 * math.pi * radiator.coherence_width)
        offsets = None if slope is None else length * slope
        vectors, solid_angle = where.directions(first[:, :2], offsets)
        nu = vectors[:, :2] / length
        nu = nu if slope is None else nu - slope
        radiance = sum(
            wigner(part, points, nu, engine=engine) * forms.radiance(vectors[:, 2])
            for part, forms in parts
        )
        weight[some] = radiance * (scale / n / length**2) * solid_angle / per_area
        position[some] = points @ pose[:3, :2].T + pose[:3, 3]
        direction[some] = vectors @ pose[:3, :3].T
        if batch is not None and number is not None:
            batch[some] = number
        start += len(numbers)
    attrs = {
        "wavelength": length,
        "frequency": SPEED_OF_LIGHT / length,
        "count": n,
        "sampling": sampling,
        "obliquity": name,
        **source_attrs(radiator),
    }
    return bundle(position, direction, weight, batch, attrs)


def _placed(source: Any, to_world: Any) -> tuple[PlaneSource | Wavefront, Values]:
    """Return the source in the plane z = 0, and its pose (4, 4)."""
    if not isinstance(source, PlacedAperture):
        radiator = checked_radiator(source, partly=True)
        return radiator, np.eye(4) if to_world is None else rigid_pose(to_world)
    if to_world is not None:
        raise ArgumentError(
            "expected a placed aperture or to_world, got both; a placed aperture has a pose"
        )
    return source.aperture, source.pose


def _scale(source: Any, wavelength: float, obliquity: str, power: Any) -> float:
    """Return the requested power over the power of the unscaled source."""
    if power is None:
        return 1.0
    meaning = f"a number in W above zero and below {_MOST_WATTS:g}"
    watts = checked_number(power, "power", meaning)
    if not 0 < watts < _MOST_WATTS:
        raise ArgumentError(f"expected power as {meaning}, got {value_text(power)}")
    return watts / radiated_power(source, wavelength, obliquity)  # type: ignore[call-overload]
