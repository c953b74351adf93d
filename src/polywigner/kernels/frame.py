"""The normalised frame in which every kernel works.

Coordinates are centred on the aperture and mapped so that it fills a box of about unit size:
thresholds on |nu| times diameter become absolute ones, and float32 spends its digits on the
aperture. Needles are turned to their own axes and stretched there as well; the transforms are
covariant under affine maps, so a needle of aspect 1e-6 is as harmless as a square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

__all__ = ["Frame", "frame_of"]

# A box longer than this is stretched; below it the loss of digits (the aspect, in ulps of the
# width) is smaller than what the kernels lose anyway, and axis-parallel edges stay so.
_NEEDLE_ASPECT = 8.0

Matrix = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Frame:
    """x' = matrix (x - centre), nu' = inverse_transpose nu; ``content``: area of a unit square."""

    centre: tuple[float, float]
    matrix: Matrix
    inverse_transpose: Matrix
    content: float

    def position(self, ops: Any, x: Any, y: Any) -> tuple[Any, Any]:
        """A point of the aperture plane in the frame."""
        cx, cy = self.centre
        if _diagonal(self.matrix):
            return self.vector(ops, x - cx, y - cy)
        # Across a needle almost everything cancels: keep what the differences round away.
        dx, dy = x - cx, y - cy
        fine = self._cross_products(ops, _lost(x, cx, dx), _lost(y, cy, dy))
        coarse = self._cross_products(ops, dx, dy)
        return coarse[0] + fine[0], coarse[1] + fine[1]

    def vector(self, ops: Any, x: Any, y: Any) -> tuple[Any, Any]:
        """A difference of points in the frame."""
        if _diagonal(self.matrix):
            return x * self.matrix[0][0], y * self.matrix[1][1]
        return self._cross_products(ops, x, y)

    def frequency(self, ops: Any, x: Any, y: Any) -> tuple[Any, Any]:
        """A spatial frequency in the frame."""
        (xx, xy), (yx, yy) = self.inverse_transpose
        if _diagonal(self.inverse_transpose):
            return x * xx, y * yy
        return x * xx + y * xy, x * yx + y * yy

    def _cross_products(self, ops: Any, x: Any, y: Any) -> tuple[Any, Any]:
        (xx, xy), (yx, yy) = self.matrix
        return ops.cross(xx, -xy, y, x), ops.cross(yx, -yy, y, x)

    def vertices(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Points (n, 2) in the frame, correctly rounded."""
        if _diagonal(self.matrix):
            return (points - np.asarray(self.centre)) * np.diag(np.asarray(self.matrix))
        cx, cy = (Fraction(c) for c in self.centre)
        rows = [[Fraction(m) for m in row] for row in self.matrix]
        return np.array(
            [
                [float(mx * (Fraction(x) - cx) + my * (Fraction(y) - cy)) for mx, my in rows]
                for x, y in points.tolist()
            ]
        )


def _diagonal(matrix: Matrix) -> bool:
    return matrix[0][1] == 0.0 == matrix[1][0]


def _lost(a: Any, b: float, difference: Any) -> Any:
    """a - b minus its rounded value, exactly (Knuth)."""
    virtual = difference - a
    return (a - (difference - virtual)) - (b + virtual)


def frame_of(points: npt.NDArray[np.float64]) -> Frame:
    """The frame of a set of points (n, 2) that span a region of non-zero area."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre = low + (high - low) / 2
    corners = shapely.get_coordinates(shapely.oriented_envelope(shapely.MultiPoint(points)))
    sides = np.diff(corners[:3], axis=0)
    lengths = np.hypot(sides[:, 0], sides[:, 1])
    long, short = int(lengths.argmax()), int(lengths.argmin())
    diameter = float(np.hypot(*lengths))
    if not lengths[long] > _NEEDLE_ASPECT * lengths[short] > 0.0:
        scale = _power_of_two(diameter)
        matrix = ((1 / scale, 0.0), (0.0, 1 / scale))
        inverse_transpose = ((scale, 0.0), (0.0, scale))
        return Frame((float(centre[0]), float(centre[1])), matrix, inverse_transpose, scale**2)
    along = sides[long] / lengths[long]
    length, width = _power_of_two(lengths[long]), _power_of_two(lengths[short])
    c, s = float(along[0]), float(along[1])
    norm = c * c + s * s
    matrix = ((c / length, s / length), (-s / width, c / width))
    inverse_transpose = (
        (c * length / norm, s * length / norm),
        (-s * width / norm, c * width / norm),
    )
    return Frame(
        (float(centre[0]), float(centre[1])), matrix, inverse_transpose, length * width / norm
    )


def _power_of_two(size: float) -> float:
    """The power of two that brings ``size`` to [1/2, 1): a scale by it is exact."""
    return math.ldexp(1.0, math.frexp(size)[1])
