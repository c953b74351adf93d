"""Random positions in the automean, and rays drawn from the Wigner function of a source."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, require
from polywigner.execution import Engine, NumpyOperations
from polywigner.geometry import Aperture, PlacedAperture, Slits, Wavefront, automean
from polywigner.geometry.arguments import (
    checked_choice,
    checked_count,
    checked_generator,
    checked_length,
    checked_number,
    checked_wavelength,
    real_array,
    rigid_pose,
    takes_frequency,
)
from polywigner.geometry.convex import point_in_trapezoid, trapezoids
from polywigner.kernels import kernel_for
from polywigner.numerics import Floats
from polywigner.propagation.far_fields import check_slopes, radiated_power
from polywigner.propagation.stores import source_attrs
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.radiometry.directions import (
    PlaneSource,
    checked_radiator,
    largest_lag,
)
from polywigner.rays.bundles import rays_dataset
from polywigner.source import Array
from polywigner.source.obliquities import ObliquityName, obliquity_of
from polywigner.source.tapers import checked_unit_vectors
from polywigner.transforms import wigner
from polywigner.transforms.checked_calls import PhaseSpaceSource
from polywigner.transforms.wavefronts import flat_source, is_partly_coherent

if TYPE_CHECKING:
    import xarray


def sample_automean(
    source: PhaseSpaceSource,
    samples: int | ArrayLike,
    *,
    seed: int | np.random.Generator | None = None,
) -> tuple[Floats, Floats]:
    """Draw uniformly distributed positions from the automean of a source.

    The automean is the set of positions x at which the Wigner function ``W(x, nu)`` can differ from
    zero. The mean of ``W(x, nu)/density`` over the positions is an unbiased estimate of the
    integral ``int W dx = |F(nu)|^2``. The density is the reciprocal of the area of the automean.

    Random numbers in the unit square are mapped to the automean with constant density. For this
    purpose, vertical lines divide the automean into trapezoids (docs/projections.md, (P14)). Points
    that are close together in the unit square mostly remain close together. Stratified and
    quasi-random points therefore keep their properties.

    Parameters
    ----------
    source : Aperture, Slits, Array or Wavefront
        Source in d = 2 dimensions, or d = 1 for slits. The curvature of a Wavefront has no effect.
    samples : int or array_like, shape (n, d)
        Number of random samples, or numbers in [0, 1) to map to positions.
    seed : int or numpy.random.Generator, optional
        Seed of the random numbers. By default, each call draws different numbers.

    Returns
    -------
    positions : ndarray of float, shape (n, d)
        Positions in m.
    density : ndarray of float, shape (n,)
        Probability density in 1/m^d.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range.
    GeometryError
        If an Array has elements outside the plane z = 0.

    Examples
    --------
    >>> import polywigner as pw
    >>> positions, density = pw.sample_automean(pw.shapes.square(1.0), 100, seed=1)
    >>> positions.shape, round(float(density.sum()), 6)
    ((100, 2), 100.0)
    """
    # The curvature of a wave does not change the automean, which is the set of midpoints of all
    # pairs of source points.
    flat: Any = flat_source(source)
    numbers = _checked_numbers(samples, kernel_for("wigner", flat).dimension, seed)
    support = _automean(flat)
    if isinstance(support, Slits):
        begins, ends = support.intervals.T
        part, u = _chosen(ends - begins, numbers[:, 0])
        positions = (begins[part] + u * (ends - begins)[part])[:, None]
        return positions, np.full(len(positions), 1.0 / support.length)
    # Positions are relative to the centre, because coordinates far from the origin would lose
    # digits.
    cells = trapezoids([ring - support.centre for ring in support.rings])
    part, u = _chosen(cells.areas, numbers[:, 0])
    row = [column[part] for column in cells]
    inner = point_in_trapezoid(NumpyOperations(), row, u, numbers[:, 1])
    positions = np.column_stack(inner) + support.centre
    return positions, np.full(len(positions), 1.0 / support.area)


# Largest number of samples; their positions and densities take 6 GiB.
_MOST_SAMPLES = 1 << 28


def _checked_numbers(samples: Any, columns: int, seed: Any) -> Floats:
    """Draw random numbers (n, columns), or check and return numbers from the caller."""
    if isinstance(samples, int | np.integer) and not isinstance(samples, bool):
        count = checked_count(samples, "samples", 1, _MOST_SAMPLES)
        return checked_generator(seed).random((count, columns))
    expected = f"expected samples to be a count, or numbers of shape (n, {columns}) in [0, 1)"
    array = real_array(samples, expected, (None, columns))
    # The comparison is also false for NaN.
    inside = (array >= 0.0) & (array < 1.0)
    if not inside.all():
        raise ArgumentError(f"{expected}, got {array[~inside][0]}")
    return array


def _automean(source: Any) -> Aperture | Slits:
    """Return the automean of a flat source or of slits."""
    if isinstance(source, Array) and source.dimension > 1:
        return automean(source.support)
    if isinstance(source, Aperture):
        return automean(source)
    ends = np.concatenate([element.intervals for element in source.elements_in_plane]) / 2
    # The midpoints of all pairs of points in two slits form an interval. The lower and the upper
    # ends of all such intervals are sorted separately. The union of the intervals has a gap between
    # ends[k] and begins[k + 1] if begins[k + 1] is larger.
    begins, ends = np.sort((ends[:, None] + ends).reshape(-1, 2), axis=0).T
    gaps = np.flatnonzero(begins[1:] > ends[:-1])
    return Slits(np.column_stack([begins[np.append(0, gaps + 1)], ends[np.append(gaps, -1)]]))


def _chosen(sizes: Floats, numbers: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Map numbers in [0, 1) to cells in proportion to their sizes.

    Returns the index of each cell, and the position within the cell in [0, 1].
    """
    ends = np.cumsum(sizes)
    at = numbers * ends[-1]
    index = np.minimum(np.searchsorted(ends, at, side="right"), len(sizes) - 1)
    return index, np.clip((at - (ends[index] - sizes[index])) / sizes[index], 0.0, 1.0)


RaySampling = Literal["uniform", "quasi-random"]


# Number of rays per block; a block takes about 200 MB.
_BLOCK = 1 << 20
# Number of independent sets of quasi-random numbers. The standard error is estimated from their
# scatter, with an uncertainty of about a fifth.
BATCHES = 16
# Angle by which a cone may extend behind the source, as a fraction of pi/2. It allows for axes in
# single precision.
_UNIT = 1e-6
# Smallest cosine between a ray and the normal, which keeps 1/cos^2 finite.
_LEAST_COSINE = 1e-8


def _random_blocks(
    sampling: str, count: int, seed: Any, tilts: int
) -> Iterator[tuple[Floats, int | None]]:
    """Yield blocks of random numbers in [0, 1), shape (m, 4 + tilts), and the batch index or None.

    The columns are direction (2), position (2) and tilt (``tilts``).
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
        numbers = np.minimum(numbers, 1 - 2.0**-53)  # Scrambled numbers may round to 1.
        for start in range(0, size, _BLOCK):
            yield numbers[start : start + _BLOCK], batch


def _normal_numbers(numbers: Floats) -> Floats:
    """Map uniform numbers (n, 2) continuously to standard normal numbers (Box and Muller 1958)."""
    plane = _disc_points(numbers)
    square = (plane**2).sum(axis=1)
    # The limit keeps results at the rim of the disc finite.
    normal_square = -2 * np.log1p(-np.minimum(square, 1 - np.finfo(np.float64).epsneg))
    unset = np.full_like(square, 2.0)
    return np.asarray(plane * _root_of_ratio(normal_square, square, unset)[:, None])


def _root_of_ratio(numerator: Floats, divisor: Floats, limit: Floats) -> Floats:
    """Return sqrt(numerator/divisor), or sqrt(limit) if the divisor is zero."""
    return np.sqrt(np.divide(numerator, divisor, out=limit, where=divisor > 0))


@dataclass(frozen=True)
class Cone:
    """Cone of ray directions; the directions may be concentrated in a narrower beam."""

    frame: Floats
    """Rotation matrix with the axis in its last column, shape (3, 3)."""
    radius: float
    """Sine of the half angle."""
    width: float
    """Sine of the beam's half width; infinite for uniform directions."""

    def directions(self, numbers: Floats, slope: Floats | None = None) -> tuple[Floats, Floats]:
        """Map random numbers (n, 2) to unit vectors (n, 3); also return the inverse density (n,).

        The vectors are in the frame of the source, and the density is per solid angle projected
        along its z axis. ``slope`` (n, 2): x and y components of the beam directions minus the
        components of the axis; None for a beam along the axis.
        """
        centre = None if slope is None or math.isinf(self.width) else self._beam_centres(slope)
        ratio = self.width / self.radius
        # Unlike ratio**2, ratio * ratio overflows to infinity without an error.
        plane, area = _concentrated(_disc_points(numbers), ratio * ratio, centre)
        plane *= self.radius
        along = np.sqrt(np.maximum(1.0 - (plane**2).sum(axis=1), 0.0))
        vectors = np.column_stack([plane, along]) @ self.frame.T
        vectors[:, 2] = np.maximum(vectors[:, 2], _LEAST_COSINE)
        solid = math.pi * self.radius**2 * vectors[:, 2] / np.maximum(along, _LEAST_COSINE)
        return vectors, area * solid

    def _beam_centres(self, slope: Floats) -> Floats:
        """Return the centres (n, 2) of beams in the unit disc.

        Directions are projected along the cone's axis, divided by ``radius``, and limited to the
        disc. ``slope`` (n, 2): direction cosines of beams minus the cosines of the axis.
        """
        cosines = self.frame[:2, 2] + slope
        # Limit beams to directions in front of the plane.
        cosines /= np.maximum(np.hypot(*cosines.T), 1.0)[:, None]
        along = np.sqrt(np.maximum(1.0 - (cosines**2).sum(axis=1), 0.0))
        plane = np.column_stack([cosines, along]) @ self.frame[:, :2] / self.radius
        return np.asarray(plane / np.maximum(np.hypot(*plane.T), 1.0)[:, None])


def cone_of(half_angle: Any, axis: Any, width: float) -> Cone:
    """Return a cone of directions, by default the hemisphere.

    ``half_angle`` is in rad, and None stands for pi/2. ``axis`` (3,) is a unit vector. ``width`` is
    the sine of the beam's half width, or infinite for uniform directions. Raises ArgumentError for
    cones that extend behind the source.
    """
    meaning = "a half angle in rad, above 0 and up to pi/2"
    angle = math.pi / 2
    if half_angle is not None:
        angle = checked_number(half_angle, "cone", meaning, lambda x: 0 < x <= math.pi / 2)
    vector = checked_unit_vectors("axis", axis, 3)
    vector = vector / np.linalg.norm(vector)
    tilt = math.atan2(math.hypot(*vector[:2]), vector[2])
    if tilt + angle > math.pi / 2 * (1 + _UNIT):
        raise ArgumentError(
            f"the cone must be in front of the source, got a half angle of {angle:.4g} rad about "
            f"an axis {tilt:.4g} rad from the normal; use a narrower cone, or omit cone and axis "
            "for all directions"
        )
    return Cone(_rotation(vector), math.sin(angle), width)


def _rotation(axis: Floats) -> Floats:
    """Return a rotation matrix with ``axis`` as its last column; the identity for the z axis."""
    x, y, z = axis
    # Orthonormal basis of Duff et al. (2017). The denominator is not zero, since z >= 0.
    a = -1.0 / (1.0 + z)
    b = x * y * a
    return np.array([[1 + x * x * a, b, x], [b, 1 + y * y * a, y], [-x, -y, z]])


def _concentrated(plane: Floats, core: float, centre: Floats | None) -> tuple[Floats, Floats]:
    """Concentrate points of the unit disc about a centre; return them with area weights.

    Weights (n,) are inverse densities relative to the uniform density. The density is proportional
    to ``1/(core + t)``, where t is the squared distance from the centre. W of a polygon decays
    similarly. The integral of the density, ``ln(1 + t/core)``, is inverted along lines from the
    centre. ``centre`` (n, 2): centres, or None for the centre of the disc. An infinite ``core``
    returns the points unchanged.
    """
    square = (plane**2).sum(axis=1)
    if math.isinf(core):
        return plane, np.ones_like(square)
    integral = np.log1p((1.0 if centre is None else _squared_reach(plane, centre)) / core)
    new_square = core * np.expm1(integral * square)
    limit = np.broadcast_to(core * integral, square.shape).copy()
    points = plane * _root_of_ratio(new_square, square, limit)[:, None]
    return points if centre is None else centre + points, (core + new_square) * integral


def _squared_reach(plane: Floats, centre: Floats) -> Floats:
    """Return squared distances from centres to the unit circle in the directions ``plane``.

    Directions and centres have the shape (n, 2). Directions may have any length, and centres must
    lie in the unit disc.
    """
    length = np.hypot(*plane.T)
    along = np.divide(
        (plane * centre).sum(axis=1), length, out=np.zeros_like(length), where=length > 0
    )
    inside = np.maximum(1.0 - (centre**2).sum(axis=1), 0.0)
    chord = np.sqrt(along**2 + inside)
    # This form avoids cancellation in chord - along.
    radius = np.divide(inside, chord + along, out=chord - along, where=along > 0)
    return np.asarray(radius**2)


def _disc_points(numbers: Floats) -> Floats:
    """Map the unit square to the unit disc with constant density (Shirley and Chiu 1997)."""
    a, b = 2 * numbers.T - 1
    is_wide = np.abs(a) > np.abs(b)
    radius = np.where(is_wide, a, b)
    other = np.where(is_wide, b, a)
    ratio = np.divide(other, radius, out=np.zeros_like(a), where=radius != 0)
    angle = np.where(is_wide, math.pi / 4 * ratio, math.pi / 2 - math.pi / 4 * ratio)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


Directions = Literal["beam", "uniform"]

# Largest number of rays, which take 12 GB.
_MOST = 100_000_000


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
    """Draw rays from the Wigner function of a source, with positions, directions and weights.

    The sum of the weights is an unbiased estimate of the power radiated into the cone, by default
    into the hemisphere (:func:`radiated_power`). Trace the rays through the optics, and compute the
    irradiance with :func:`polywigner.rays.rebuild`.

    The weight of each of n rays is ``W(x, s_par/lambda) h/(lambda^2 p n)`` (docs/signed_rays.md,
    (Y1)). In this formula, x is the position of the ray, s_par is the part of its direction
    parallel to the source plane, and p is the density of rays per area and projected solid angle.
    The factor h = g/cos is the obliquity factor g of the boundary condition divided by the cosine
    of the polar angle.

    Parameters
    ----------
    source : Aperture, PlacedAperture, Array or Wavefront
        Source in the plane z = 0 with |u|^2 in W/m^2, which radiates to +z. A Wavefront may be
        curved or partially coherent. Each ray of a partially coherent wave has a random tilt.
    wavelength : float
        Wavelength in m, or ``frequency=`` in Hz.
    count : int
        Number of rays, up to 100 million.
    seed : int or numpy.random.Generator, default 0
        Seed of the random numbers.
    sampling : {"uniform", "quasi-random"}, default "uniform"
        Type of random numbers. "uniform": independent random numbers. "quasi-random": Sobol
        sequences, which have about half the noise and require scipy, part of the extra ``arrays``.
        Quasi-random rays form 16 independent sets, numbered by the coordinate ``batch``. Positions
        are uniform in the automean in both cases.
    cone : float, optional
        Half angle of the cone of directions in rad. Default: pi/2, the hemisphere.
    axis : array_like, shape (3,), default (0, 0, 1)
        Unit vector along the axis of the cone in the frame of the source; use the beam direction of
        a steered source.
    directions : {"beam", "uniform"}, default "beam"
        "beam": most rays are within wavelength/diameter of the axis, or of the local direction of a
        Wavefront. "uniform": rays are uniform in projected solid angle.
    to_world : array_like, shape (4, 4), optional
        Rigid pose of the source, with the translation in m. Default: the pose of a placed aperture,
        or the identity.
    obliquity : str, optional
        Boundary condition, as in :func:`irradiance`. The default has h = cos, and "paper" has h =
        1. A Wavefront supports only these two boundary conditions.
    power : float, optional
        Radiated power in W over all directions. Default: the power of the unscaled source.
    engine : str, default "auto"
        See :func:`fourier`.

    Returns
    -------
    xarray.Dataset
        ``position`` (ray, component) in m, ``direction`` (ray, component) and ``weight`` (ray) in
        W. The attributes contain the settings.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type, shape or range.
    GeometryError
        If a pose is not rigid, or an Array has elements outside the plane z = 0.
    IlluminationError
        If ``power`` is specified for a source that does not radiate.
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
    radiator, pose = _with_pose(source, to_world)
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
    scale = _power_scale(radiator, length, name, power)
    parts = condition.terms(flat, length)
    tilts = 2 if is_partly_coherent(radiator) else 0

    position, direction, weight = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    batch = np.empty(n, np.int32) if sampling == "quasi-random" else None
    start = 0
    for numbers, number in _random_blocks(sampling, n, seed, tilts):
        block = slice(start, start + len(numbers))
        first, tilt = np.split(numbers, [numbers.shape[1] - tilts], axis=1)
        points, per_area = sample_automean(flat, first[:, 2:])
        slope = None
        if isinstance(radiator, Wavefront):
            # The curvature shifts the frequency of W by Q (x - c), equation (Q2). The tilts are
            # normally distributed, equation (PC4).
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
        weight[block] = radiance * (scale / n / length**2) * solid_angle / per_area
        position[block] = points @ pose[:3, :2].T + pose[:3, 3]
        direction[block] = vectors @ pose[:3, :3].T
        if batch is not None and number is not None:
            batch[block] = number
        start += len(numbers)
    attrs = {
        "wavelength": length,
        "frequency": SPEED_OF_LIGHT / length,
        "count": n,
        "sampling": sampling,
        "obliquity": name,
        **source_attrs(radiator),
    }
    return rays_dataset(position, direction, weight, batch, attrs)


def _with_pose(source: Any, to_world: Any) -> tuple[PlaneSource | Wavefront, Floats]:
    """Return the source in its plane, and the pose (4, 4) of the source in the world.

    Raises ArgumentError if both the source and ``to_world`` specify a pose.
    """
    if not isinstance(source, PlacedAperture):
        radiator = checked_radiator(source, partly=True)
        return radiator, np.eye(4) if to_world is None else rigid_pose(to_world)
    if to_world is not None:
        raise ArgumentError(
            "to_world must be omitted for a placed aperture, which already has a pose"
        )
    return source.aperture, source.pose


def _power_scale(source: Any, wavelength: float, obliquity: str, power: Any) -> float:
    """Return the factor of all weights for a specified power in W; 1 for None."""
    if power is None:
        return 1.0
    watts = checked_length(power, "power", meaning="a number in W above zero")
    return watts / radiated_power(source, wavelength, obliquity)  # type: ignore[call-overload]
