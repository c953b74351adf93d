"""Exact arithmetic on vertices rounded to a grid.

The grid is so coarse that sums and differences of a few coordinates are exact in the kernel's
float type, and fine enough to move a vertex by half an ulp of the diameter. On the grid, cross
products are exact here, and one ulp accurate in the kernels (``ops.cross``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np
import numpy.typing as npt

__all__ = ["Lattice", "exact_cross", "signed_convex_pieces"]


@dataclass(frozen=True)
class Lattice:
    """Multiples of ``step``.

    In the frame, vertices lie within 1/2 of the origin and offsets 2x, xi within 1: the largest
    combination of an offset and two vertices is below 2: 53 (24) bits of this step.
    """

    step: float

    @classmethod
    def for_precision(cls, double: bool) -> Lattice:
        return cls(2.0**-52 if double else 2.0**-23)

    def rounded(self, polygon: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Vertices (n, 2) on the grid, without repeats."""
        points = np.round(polygon / self.step) * self.step + 0.0
        keep = (points != np.roll(points, 1, axis=0)).any(axis=1)
        return points[keep]


@lru_cache(maxsize=1 << 16)
def exact_cross(ax: float, ay: float, bx: float, by: float) -> float:
    """cross(a, b), correctly rounded: no digits are lost where a and b are nearly parallel."""
    return float(Fraction(ax) * Fraction(by) - Fraction(ay) * Fraction(bx))


def _turns(polygon: npt.NDArray[np.float64]) -> list[float]:
    """The turn at every vertex, twice the area of (previous, this, next), correctly rounded."""
    before = (polygon - np.roll(polygon, 1, axis=0)).tolist()
    after = (np.roll(polygon, -1, axis=0) - polygon).tolist()
    return [exact_cross(*a, *b) for a, b in zip(before, after, strict=True)]


def signed_convex_pieces(
    pieces: Sequence[npt.NDArray[np.float64]],
) -> list[tuple[npt.NDArray[np.float64], float]]:
    """Exactly convex pieces with weights whose sum is the same set as the rounded pieces'.

    Rounding may bend a piece or turn over a sliver. Such a piece is cut into triangles of either
    sign; since all of them share their sides exactly, the inner sides still cancel exactly.
    """
    result = []
    for piece in pieces:
        if len(piece) < 3:
            continue
        turns = _turns(piece)
        if min(turns) >= 0 < max(turns):
            result.append((piece, 1.0))
            continue
        for k in range(1, len(piece) - 1):
            triangle = piece[[0, k, k + 1]]
            turn = _turns(triangle)[1]
            if turn:
                result.append((triangle if turn > 0 else triangle[::-1], float(np.sign(turn))))
    return result
