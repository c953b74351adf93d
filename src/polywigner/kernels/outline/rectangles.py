"""Which outlines are rectangles, as far as the rounding of their coordinates tells.

A rectangle that is turned, or lies far from the origin, is one only up to the rounding of its
vertices: of an outline of size 1 at a distance of 10,000, right angles are off by 1e-12. What is
recognised is the rectangle nearest to the vertices if it misses none of them by more than that
rounding; W moves by no more than it does if one digit of a coordinate changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from polywigner.geometry import Aperture
from polywigner.kernels.outline.frame import Frame, frame_along, power_of_two

__all__ = ["Rectangle", "rectangle_of"]

# An outline is a rectangle if it misses one by less than this share of its shorter side,
_ROUNDING = 1e-14
# or by this many roundings of its largest coordinate: turning a point takes five (two products, two
# sums, and the shift), along each axis,
_ROUNDINGS = 8
# but never by more than this share of the shorter side: strips of a few ulps have no shape.
_SHAPELESS = 1e-6

_UNIT = np.finfo(np.float64).eps / 2

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rectangle:
    """Its corners, and the sides from the first one."""

    corners: Floats
    """(4, 2), counter-clockwise; if the rectangle is turned, its longest side is the first."""
    rounding: float
    """How far the corners may miss those of a true rectangle."""

    @cached_property
    def sides(self) -> tuple[float, float]:
        """Length and width; along x and y if it is not turned."""
        if not self.is_turned:
            length, width = np.ptp(self.corners, axis=0).tolist()
            return length, width
        first, second = self.corners[1] - self.corners[0], self.corners[3] - self.corners[0]
        return float(np.hypot(*first)), float(np.hypot(*second))

    @property
    def is_turned(self) -> bool:
        return bool((self.corners[1] - self.corners[0]).all())

    def frame(self) -> Frame:
        """The frame along its sides, around its centre."""
        low, high = self.corners.min(axis=0), self.corners.max(axis=0)
        sizes = (power_of_two(self.sides[0]), power_of_two(self.sides[1]))
        return frame_along(self.corners, low + (high - low) / 2, self._direction, sizes)

    @property
    def _direction(self) -> tuple[float, float]:
        """Along both longer sides."""
        if not self.is_turned:
            return 1.0, 0.0
        a, b, c, d = self.corners
        along = (b - a) + (c - d)
        length = np.hypot(*along)
        return float(along[0] / length), float(along[1] / length)

    def halves(self, frame: Frame) -> tuple[float, float]:
        """Half the length and width in the frame."""
        one, two = np.abs(frame.vertices(self.corners)).mean(axis=0).tolist()
        return one, two


def rectangle_of(aperture: Aperture) -> Rectangle | None:
    """The rectangle that an aperture is, with or without vertices on its sides, or None."""
    if len(aperture.rings) != 1:
        return None
    (ring,) = aperture.rings
    rounding = _ROUNDINGS * _UNIT * float(np.abs(ring).max())
    corners = ring[_distance_from_neighbours(ring) > max(rounding, 1e-12 * aperture.diameter)]
    if len(corners) != 4:
        return None
    first, second = corners[1] - corners[0], corners[3] - corners[0]
    long, short = sorted((float(np.hypot(*first)), float(np.hypot(*second))), reverse=True)
    skew = abs(first @ second) / long
    gap = float(np.hypot(*(corners[2] - corners[1] - second)))
    straight = _distance_from_sides(ring, corners)
    allowed = max(_ROUNDING * short, min(rounding, _SHAPELESS * short))
    if max(skew, gap, straight) > allowed:
        return None
    if np.hypot(*first) < np.hypot(*second):
        corners = np.roll(corners, -1, axis=0)
    return Rectangle(corners, allowed)


def _distance_from_neighbours(ring: Floats) -> Floats:
    """How far each vertex lies from the line through those before and after it."""
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    chord: Floats = np.hypot(*(before + after).T)
    return np.abs(turn) / np.maximum(chord, np.finfo(np.float64).tiny)


def _distance_from_sides(ring: Floats, corners: Floats) -> float:
    """How far the vertices lie from the nearest line through a side."""
    along = np.roll(corners, -1, axis=0) - corners
    along = along / np.hypot(*along.T)[:, None]
    apart = ring[:, None] - corners
    return float(np.abs(apart[..., 0] * along[:, 1] - apart[..., 1] * along[:, 0]).min(1).max())
