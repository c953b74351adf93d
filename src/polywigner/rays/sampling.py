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
from polywigner.reception.norms import root_of_norm
from polywigner.source.obliquities import (
    ObliquityName,
    obliquity_of,
)
from polywigner.transforms import sample_automean, wigner
from polywigner.transforms.automean_samples import Weights
from polywigner.transforms.wavefronts import flat_of, is_partly_coherent

if TYPE_CHECKING:
    import xarray

RaySampling = Literal["uniform", "marginal", "quasi-random"]

Values = NDArray[np.float64]

# Rays at a time: some 200 MB.
_BLOCK = 1 << 20
# Independent sets of quasi-random numbers, from whose scatter the error follows, to a fifth.
BATCHES = 16
# Cones whose axes passed through single precision may reach so far behind the source, in pi/2.
_UNIT = 1e-6
# Of the hemisphere a radius may round to one: factors such as 1/cos^2 stay finite.
_LEAST_COSINE = 1e-8


def _numbers(
    sampling: str, count: int, seed: Any, tilts: int
) -> Iterator[tuple[Values, int | None]]:
    """Numbers (m, k) in [0, 1), and the batch of quasi-random ones, which depend on each other.

    Two for the direction, two or with "marginal" four for the position, and those for the tilt.
    Raises MissingExtraError for quasi-random numbers without scipy.
    """
    generator = checked_generator(seed)
    if sampling != "quasi-random":
        columns = (6 if sampling == "marginal" else 4) + tilts
        for start in range(0, count, _BLOCK):
            yield generator.random((min(_BLOCK, count - start), columns)), None
        return
    library = require("scipy.stats.qmc", "arrays", "has quasi-random numbers (Sobol)")
    for batch in range(BATCHES):
        size = (count + batch) // BATCHES  # as equal as whole numbers are
        sequence = library.Sobol(4 + tilts, scramble=True, seed=generator)
        numbers = sequence.random_base2(math.ceil(math.log2(size)))[:size]
        numbers = np.minimum(numbers, 1 - 2.0**-53)  # scrambled numbers may round to 1
        for start in range(0, size, _BLOCK):
            yield numbers[start : start + _BLOCK], batch


def _normal_numbers(numbers: Values) -> Values:
    """Standard normal numbers (n, 2) of numbers (n, 2) in [0, 1), neighbours of neighbours.

    The square of the radius is exponential (Box and Muller 1958).
    """
    plane = _disc(numbers)
    before = (plane**2).sum(axis=1)
    # the rim is infinitely far away
    after = -2 * np.log1p(-np.minimum(before, 1 - np.finfo(np.float64).epsneg))
    outward = np.sqrt(np.divide(after, before, out=np.full_like(before, 2.0), where=before > 0))
    return np.asarray(plane * outward[:, None])


@dataclass(frozen=True)
class Cone:
    """Directions of a cone, uniform in the solid angle projected along its axis."""

    frame: Values
    """(3, 3), the axis last."""
    radius: float
    """The sine of the half angle."""
    width: float
    """The sine of the angle up to which rays are densest, of a beam; infinity: of none."""

    def directions(self, numbers: Values, slope: Values | None = None) -> tuple[Values, Values]:
        """Unit vectors (n, 3) for numbers (n, 2), and the inverse of their density.

        Per solid angle projected along z. ``slope`` (n, 2): by which direction cosines the beam of
        each ray is off the axis. Rays are densest there, or where the rim of the cone is nearest.
        """
        middle = None if slope is None or math.isinf(self.width) else self._middle(slope)
        ratio = self.width / self.radius
        # infinity rather than an error
        plane, share = _concentrated(_disc(numbers), ratio * ratio, middle)
        plane *= self.radius
        along = np.sqrt(np.maximum(1.0 - (plane**2).sum(axis=1), 0.0))
        found = np.column_stack([plane, along]) @ self.frame.T
        found[:, 2] = np.maximum(found[:, 2], _LEAST_COSINE)
        solid = math.pi * self.radius**2 * found[:, 2] / np.maximum(along, _LEAST_COSINE)
        return found, share * solid

    def _middle(self, slope: Values) -> Values:
        """Where beams are in the unit disc that directions are drawn in."""
        cosines = self.frame[:2, 2] + slope
        cosines /= np.maximum(np.hypot(*cosines.T), 1.0)[:, None]  # at most along the plane
        along = np.sqrt(np.maximum(1.0 - (cosines**2).sum(axis=1), 0.0))
        plane = np.column_stack([cosines, along]) @ self.frame[:, :2] / self.radius
        return np.asarray(plane / np.maximum(np.hypot(*plane.T), 1.0)[:, None])


def cone_of(half_angle: Any, axis: Any, width: float) -> Cone:
    """The cone of a half angle in rad about a direction; None: the hemisphere about z.

    Raises ArgumentError for other arguments, and for cones that reach behind the source.
    """
    meaning = "a half angle in rad, above 0 and up to pi/2"
    angle = math.pi / 2 if half_angle is None else checked_number(half_angle, "cone", meaning)
    if not 0 < angle <= math.pi / 2:
        raise ArgumentError(f"expected cone as {meaning}, got {value_text(half_angle)}")
    middle = checked_unit_vectors("axis", axis)
    if middle.ndim > 1:
        raise ArgumentError(f"expected axis as one unit vector (3,), got {middle.shape}")
    middle = middle / np.linalg.norm(middle)
    tilt = math.atan2(math.hypot(*middle[:2]), middle[2])
    if tilt + angle > math.pi / 2 * (1 + _UNIT):
        raise ArgumentError(
            f"expected a cone in front of the source, got one of {angle:.4g} rad about an axis "
            f"{tilt:.4g} rad from the normal; use a narrower cone, or none for all directions"
        )
    return Cone(_frame(middle), math.sin(angle), width)


def _frame(axis: Values) -> Values:
    """Rotation whose last column is the axis, the identity for z."""
    x, y, z = axis
    # in front of the source z >= 0: no pole (Duff and others 2017)
    a = -1.0 / (1.0 + z)
    b = x * y * a
    return np.array([[1 + x * x * a, b, x], [b, 1 + y * y * a, y], [-x, -y, z]])


def _concentrated(plane: Values, core: float, middle: Values | None) -> tuple[Values, Values]:
    """Points of the unit disc moved towards points of it, and the area that each is worth.

    With t the square of the distance from the middle, None for that of the disc, their density is
    in proportion to 1/(core + t), the decay of W across the edges of a polygon: its integral is
    ln(1 + t/core), inverted here on each line from the middle to the rim.
    """
    before = (plane**2).sum(axis=1)
    if math.isinf(core):
        return plane, np.ones_like(before)
    turns = np.log1p((1.0 if middle is None else _reach(plane, middle)) / core)
    after = core * np.expm1(turns * before)
    least = np.broadcast_to(core * turns, before.shape).copy()
    inward = np.sqrt(np.divide(after, before, out=least, where=before > 0))
    points = plane * inward[:, None]
    return points if middle is None else middle + points, (core + after) * turns


def _reach(plane: Values, middle: Values) -> Values:
    """Squares of the distances (n,) from points of the unit disc to its rim, along ``plane``."""
    length = np.hypot(*plane.T)
    along = np.divide(
        (plane * middle).sum(axis=1), length, out=np.zeros_like(length), where=length > 0
    )
    inside = np.maximum(1.0 - (middle**2).sum(axis=1), 0.0)
    chord = np.sqrt(along**2 + inside)
    # the difference of two near numbers loses digits: not where the rim is behind the middle
    reach = np.divide(inside, chord + along, out=chord - along, where=along > 0)
    return np.asarray(reach**2)


def _disc(numbers: Values) -> Values:
    """The unit square onto the unit disc, areas kept in proportion and neighbours near.

    Shirley and Chiu 1997: squares about the middle become circles.
    """
    a, b = 2 * numbers.T - 1
    is_wide = np.abs(a) > np.abs(b)
    radius = np.where(is_wide, a, b)
    other = np.where(is_wide, b, a)
    ratio = np.divide(other, radius, out=np.zeros_like(a), where=radius != 0)
    angle = np.where(is_wide, math.pi / 4 * ratio, math.pi / 2 - math.pi / 4 * ratio)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


Directions = Literal["beam", "uniform"]

# 12 GB of rays; of more draw several sets.
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
    aperture_power: float | None = None,
    engine: Engine = "auto",
) -> xarray.Dataset:
    """Rays of a source, weighted by its Wigner function: positions, directions and watts.

    Each of n rays carries ``W(x, s_par/lambda) h/(lambda^2 p n)``, h = g/cos, p the density of rays
    per area and projected solid angle: their sum is the power in the cone, without bias, and with
    no ``cone`` :func:`radiated_power`. Source: docs/signed_rays.md, (Y1). Trace them through ray
    optics, then :func:`polywigner.rays.rebuild` the irradiance.

    Parameters
    ----------
    source : Aperture, placed or not, or Array of apertures in the plane z = 0, |u|^2 on it in
        W/m^2, with any fields; or one with a curved or partly coherent wave, of which each ray
        has one tilt, drawn at random. It radiates to +z.
    wavelength : in m.
    count : how many rays, up to 100 million.
    seed : of the numbers, or a NumPy Generator.
    sampling : positions "uniform" in the automean, or in proportion to the position "marginal",
        see :func:`sample_automean`, from independent random numbers; or "quasi-random", uniform
        from Sobol sequences, with about half the noise (needs scipy, of the extra ``arrays``): 16
        independent sets, told apart by the coordinate ``batch``.
    cone : half angle in rad of the directions that rays are drawn in; None: the hemisphere.
    axis : unit vector (3,), the middle of the cone in the frame of the source; that of the beam,
        where the source is steered.
    directions : "beam" draws most of them within wavelength/diameter of the axis, or of the wave
        where it is curved or partly coherent; "uniform" is uniform in projected solid angle.
    to_world : (4, 4) rigid pose of the source; None: its own, or none. Units of m.
    obliquity : as of :func:`irradiance`: None: h = cos; "paper" is
        h = 1. Curved and partly coherent waves have these two.
    power : radiated in W, over all directions; None: the power of the field as it is.
    aperture_power : in place of power, int |u|^2 over the aperture in W.
    engine : see :func:`fourier`.

    Returns
    -------
    xarray.Dataset with ``position`` (ray, component) in m, ``direction`` (ray, component) and
    ``weight`` (ray) in W. The settings are in its attributes.

    Raises
    ------
    ArgumentError for arguments of the wrong type, shape or range; GeometryError for a pose that is
    not rigid, or an Array whose elements do not lie in the plane z = 0; IlluminationError for a
    power asked of a source without any; MissingExtraError without xarray or scipy.

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
    density: Weights = "marginal" if sampling == "marginal" else "uniform"
    least = 2 * BATCHES if sampling == "quasi-random" else 1
    n = checked_count(count, "count", least, _MOST)
    checked_choice(directions, "directions", get_args(Directions))
    # the sine of the angle up to which rays are densest
    width = math.inf if directions == "uniform" else length / largest_lag(radiator)
    where = cone_of(cone, axis, width)
    condition = obliquity_of(obliquity)
    name = condition.name
    check_slopes(radiator, name)
    flat = flat_of(radiator)
    scale = _scale(radiator, length, name, power, aperture_power)
    parts = condition.terms(flat, length)
    tilts = 2 if is_partly_coherent(radiator) else 0

    position, direction, weight = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    batch = np.empty(n, np.int32) if sampling == "quasi-random" else None
    start = 0
    for numbers, number in _numbers(sampling, n, seed, tilts):
        some = slice(start, start + len(numbers))
        first, tilt = np.split(numbers, [numbers.shape[1] - tilts], axis=1)
        places, per_area = sample_automean(flat, first[:, 2:], density, engine=engine)
        turn = None
        if isinstance(radiator, Wavefront):
            # W of the curved wave is that of the flat source less its slope Q (x - c), (Q2), and of
            # partly coherent light the mean over normal tilts, (PC4), of which each ray has one
            turn = (places - radiator.centre) @ radiator.curvature
            if tilts:
                turn += _normal_numbers(tilt) / (2 * math.pi * radiator.coherence_width)
        own, solid_angle = where.directions(first[:, :2], None if turn is None else length * turn)
        nu = own[:, :2] / length
        nu = nu if turn is None else nu - turn
        radiance = sum(
            wigner(part, places, nu, engine=engine) * forms.radiance(own[:, 2])
            for part, forms in parts
        )
        weight[some] = radiance * (scale / n / length**2) * solid_angle / per_area
        position[some] = places @ pose[:3, :2].T + pose[:3, 3]
        direction[some] = own @ pose[:3, :3].T
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
    """The source in its own plane, and its pose (4, 4)."""
    if not isinstance(source, PlacedAperture):
        radiator = checked_radiator(source, partly=True)
        return radiator, np.eye(4) if to_world is None else rigid_pose(to_world)
    if to_world is not None:
        raise ArgumentError(
            "expected a placed aperture or to_world, got both; a placed aperture has a pose"
        )
    return source.aperture, source.pose


def _scale(
    source: Any, wavelength: float, obliquity: str, power: Any, aperture_power: Any
) -> float:
    """Power in W that is wanted over the power that the field has as it is."""
    if power is not None and aperture_power is not None:
        raise ArgumentError(
            "expected power or aperture_power, got both; power leaves through the hemisphere in "
            "front, aperture_power is the integral of |u|^2 over the aperture: give one"
        )
    if power is None and aperture_power is None:
        return 1.0
    name, value = ("power", power) if aperture_power is None else ("aperture_power", aperture_power)
    meaning = f"a number in W above zero and below {_MOST_WATTS:g}"
    watts = checked_number(value, name, meaning)
    if not 0 < watts < _MOST_WATTS:
        raise ArgumentError(f"expected {name} as {meaning}, got {value_text(value)}")
    if power is None:
        return watts / root_of_norm(source, wavelength, obliquity, "aperture") ** 2
    return watts / radiated_power(source, wavelength, obliquity)  # type: ignore
