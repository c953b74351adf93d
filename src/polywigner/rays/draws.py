"""Random and quasi-random numbers for rays, and cones of directions from them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_generator, checked_number, real_numbers
from polywigner.propagation.rays_sampling import sobol_numbers
from polywigner.transforms.sampling import Weights

__all__ = [
    "BATCHES",
    "Cone",
    "RaySampling",
    "cone_of",
    "normal_numbers",
    "numbers_of",
    "positions_by",
]

RaySampling = Literal["uniform", "marginal", "quasi-random"]

Values = NDArray[np.float64]

# Independent sets of quasi-random numbers, from whose scatter the error follows, to a fifth.
BATCHES = 16
# Directions as unit vectors that have passed through single precision.
_UNIT = 1e-6
# Of the hemisphere a radius may round to one: factors such as 1/cos^2 stay finite.
_LEAST_COSINE = 1e-8


def positions_by(sampling: Any) -> Weights:
    """The density of positions of a sampling; ArgumentError for one that is not known."""
    if not isinstance(sampling, str) or sampling not in get_args(RaySampling):
        names = ", ".join(f'"{name}"' for name in get_args(RaySampling))
        raise ArgumentError(f"expected sampling to be one of {names}, got {sampling!r}")
    return "marginal" if sampling == "marginal" else "uniform"


def numbers_of(
    sampling: str, count: int, seed: Any, block: int, others: int = 0
) -> Iterator[tuple[Values, int | None]]:
    """Numbers (m, k) in [0, 1), m up to ``block``, two for the direction first; and their batch.

    After them those for the position, two or with "marginal" four, and then ``others``.
    Random ones are independent of each other, without a batch; those of one batch of quasi-random
    ones are not. Raises MissingExtraError for quasi-random numbers without scipy.
    """
    generator = checked_generator(seed)
    if sampling != "quasi-random":
        columns = (6 if sampling == "marginal" else 4) + others
        for start in range(0, count, block):
            yield generator.random((min(block, count - start), columns)), None
        return
    for batch in range(BATCHES):
        size = (count + batch) // BATCHES  # as equal as whole numbers are
        numbers = sobol_numbers(size, 4 + others, generator)
        for start in range(0, size, block):
            yield numbers[start : start + block], batch


def normal_numbers(numbers: Values) -> Values:
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

        Per solid angle projected along z: the mean over directions is that of the cone.
        ``slope`` (n, 2): by which direction cosines the beam of each ray is off the axis. Rays
        are densest there, or where the rim of the cone is nearest.
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
    angle = math.pi / 2
    if half_angle is not None:
        angle = checked_number(half_angle, "cone", "a half angle in rad, above 0 and up to pi/2")
    if not 0 < angle <= math.pi / 2:
        raise ArgumentError(
            f"expected cone as a half angle in rad, above 0 and up to pi/2, got {half_angle!r}"
        )
    try:
        middle = real_numbers(axis)
    except ValueError as error:
        raise ArgumentError(f"expected axis as a unit vector (3,), got {error}") from None
    if middle.shape != (3,) or not abs(float(np.linalg.norm(middle)) - 1) <= _UNIT:
        raise ArgumentError(f"expected axis as a unit vector (3,), got {middle.tolist()}")
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
