"""Random and quasi-random numbers for rays, and cones of directions from them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_generator, checked_number
from polywigner.geometry.numbers import real_numbers
from polywigner.propagation.rays_sampling import sobol_numbers
from polywigner.transforms.sampling import Weights

__all__ = ["BATCHES", "Cone", "RaySampling", "cone_of", "numbers_of", "positions_by"]

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
    sampling: str, count: int, seed: Any, block: int
) -> Iterator[tuple[Values, int | None]]:
    """Numbers (m, k) in [0, 1), m up to ``block``, two for the direction first; and their batch.

    Random ones are independent of each other, without a batch; those of one batch of quasi-random
    ones are not. Raises MissingExtraError for quasi-random numbers without scipy.
    """
    generator = checked_generator(seed)
    if sampling != "quasi-random":
        columns = 6 if sampling == "marginal" else 4
        for start in range(0, count, block):
            yield generator.random((min(block, count - start), columns)), None
        return
    for batch in range(BATCHES):
        size = (count + batch) // BATCHES  # as equal as whole numbers are
        numbers = sobol_numbers(size, 4, generator)
        for start in range(0, size, block):
            yield numbers[start : start + block], batch


@dataclass(frozen=True)
class Cone:
    """Directions of a cone, uniform in the solid angle projected along its axis."""

    frame: Values
    """(3, 3), the axis last."""
    radius: float
    """The sine of the half angle."""
    width: float
    """The sine of the angle up to which rays are densest, of a beam; infinity: of none."""

    def directions(self, numbers: Values) -> tuple[Values, Values]:
        """Unit vectors (n, 3) for numbers (n, 2), and the inverse of their density.

        Per solid angle projected along z: the mean over directions is that of the cone.
        """
        ratio = self.width / self.radius
        plane, share = _concentrated(_disc(numbers), ratio * ratio)  # infinity rather than an error
        plane *= self.radius
        along = np.sqrt(np.maximum(1.0 - (plane**2).sum(axis=1), 0.0))
        found = np.column_stack([plane, along]) @ self.frame.T
        found[:, 2] = np.maximum(found[:, 2], _LEAST_COSINE)
        solid = math.pi * self.radius**2 * found[:, 2] / np.maximum(along, _LEAST_COSINE)
        return found, share * solid


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


def _concentrated(plane: Values, core: float) -> tuple[Values, Values]:
    """Points of the unit disc moved inwards, and the area of the disc that each is worth.

    With t the square of the radius, their density is in proportion to 1/(core + t), the decay of
    W across the edges of a polygon: its integral is ln(1 + t/core), inverted here.
    """
    before = (plane**2).sum(axis=1)
    if math.isinf(core):
        return plane, np.ones_like(before)
    turns = math.log1p(1 / core)
    after = core * np.expm1(turns * before)
    inward = np.sqrt(
        np.divide(after, before, out=np.full_like(before, core * turns), where=before > 0)
    )
    return plane * inward[:, None], (core + after) * turns


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
