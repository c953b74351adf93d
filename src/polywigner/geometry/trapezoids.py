"""An outline as trapezoids, and the map of the unit square onto them that preserves area.

The outline is cut by vertical lines through its vertices into trapezoids, and a point of the unit
square is mapped to one of them: the first coordinate picks the trapezoid and the abscissa, the
second the ordinate. For a rectangle this is an affine map and for any convex polygon the abscissa
is monotone in the first coordinate, so stratified samples stay stratified; a triangle mesh, with
its fold along every diagonal, would lose that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

# Vertices that should share an abscissa and differ in the last digits make trapezoids of no
# account; dropping them changes the density by less than single precision can tell.
_NEGLIGIBLE = 1e-12

# Smaller than any height of an aperture and above zero in single precision.
_TINY = 1e-30


@dataclass(frozen=True, eq=False)
class Trapezoids:
    """Trapezoids with vertical parallel sides; read-only float64 arrays (n,), metres."""

    left: npt.NDArray[np.float64]
    width: npt.NDArray[np.float64]
    low_left: npt.NDArray[np.float64]
    low_right: npt.NDArray[np.float64]
    high_left: npt.NDArray[np.float64]
    high_right: npt.NDArray[np.float64]

    @property
    def areas(self) -> npt.NDArray[np.float64]:
        """Areas (n,), m^2."""
        heights = self.high_left - self.low_left + self.high_right - self.low_right
        return 0.5 * self.width * heights

    @property
    def rows(self) -> npt.NDArray[np.float64]:
        """(n, 6): all numbers of each."""
        sides = (self.low_left, self.low_right, self.high_left, self.high_right)
        return np.stack([self.left, self.width, *sides], axis=-1)

    @property
    def middles(self) -> npt.NDArray[np.float64]:
        """Midpoints of their middle lines, (n, 2)."""
        y = 0.25 * (self.low_left + self.low_right + self.high_left + self.high_right)
        return np.stack([self.left + 0.5 * self.width, y], axis=-1)

    def divided(self, count: int) -> Trapezoids:
        """Each in ``count`` strips of equal width, these in as many pieces of equal height."""
        step = np.arange(count + 1) / count
        u, v = step[:, None, None], step[:, None]
        low = self.low_left + u * (self.low_right - self.low_left)
        high = self.high_left + u * (self.high_right - self.high_left)
        side = low + v * (high - low)  # (strip, piece, n)
        left = self.left + u[:-1] * self.width
        found = (
            left, self.width / count,
            side[:-1, :-1], side[1:, :-1], side[:-1, 1:], side[1:, 1:],
        )  # fmt: skip
        return Trapezoids(*(a.reshape(-1) for a in np.broadcast_arrays(*found)))

    @property
    def columns(self) -> tuple[npt.NDArray[np.float64], ...]:
        """The constants of :func:`point_in_trapezoid`, each (n,).

        Heights are differences of coordinates: formed here, in double precision.
        """
        return (
            self.left,
            self.width,
            self.high_left - self.low_left,
            self.high_right - self.low_right,
            self.low_left,
            self.low_right,
        )


def trapezoids(rings: Sequence[npt.NDArray[np.float64]]) -> Trapezoids:
    """The trapezoids between the boundary rings (n, 2) of an aperture, from left to right.

    Cost: number of vertices times number of edges.
    """
    start = np.concatenate(rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    rightwards = start[:, :1] <= end[:, :1]
    start, end = np.where(rightwards, start, end), np.where(rightwards, end, start)
    cuts = np.unique([*start[:, 0], *end[:, 0]])
    rows: list[npt.NDArray[np.float64]] = []
    for left, right in pairwise(cuts):
        rows.extend(_slab(start, end, left, right))
    table = np.array(rows).reshape(-1, 6)
    found = Trapezoids(*table.T)
    kept = table[found.areas > _NEGLIGIBLE * found.areas.sum()].T.copy()
    kept.flags.writeable = False
    return Trapezoids(*kept)


def _slab(
    start: npt.NDArray[np.float64], end: npt.NDArray[np.float64], left: float, right: float
) -> npt.NDArray[np.float64]:
    """The trapezoids between two neighbouring cuts, from below upwards."""
    across = (start[:, 0] <= left) & (end[:, 0] >= right)
    a, b = start[across], end[across]
    slope = (b[:, 1] - a[:, 1]) / (b[:, 0] - a[:, 0])
    at_left = a[:, 1] + slope * (left - a[:, 0])
    at_right = a[:, 1] + slope * (right - a[:, 0])
    order = np.argsort(at_left + at_right, kind="stable")
    # Edges alternate between entering and leaving the aperture; touching parts tie, and either
    # order of a tie gives the same trapezoids.
    low, high = order[0::2], order[1::2]
    sides = (at_left[low], at_right[low], at_left[high], at_right[high])
    return np.stack([np.full(low.shape, left), np.full(low.shape, right - left), *sides], axis=-1)


def point_in_trapezoid(ops: Any, row: Sequence[Any], u: Any, v: Any) -> tuple[Any, Any]:
    """The point of a trapezoid, uniform by area, for (u, v) uniform in the unit square.

    ``row``: what :attr:`Trapezoids.columns` holds for it; ``ops``: the namespace of their type.
    """
    left, width, height_left, height_right, low_left, low_right = row
    # Solves (h0 t + (h1 - h0) t^2 / 2) = u (h0 + h1) / 2 without cancellation.
    root = ops.sqrt((1.0 - u) * height_left * height_left + u * height_right * height_right)
    below = height_left + root
    t = u * (height_left + height_right) / ops.select(below > _TINY, below, _TINY)
    low = low_left + t * (low_right - low_left)
    height = height_left + t * (height_right - height_left)
    return left + t * width, low + v * height
