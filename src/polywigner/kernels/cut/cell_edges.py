"""The edges of a source as arrays, for the search of what can meet what in a cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from polywigner.kernels.cut.cell_finder import Segments
from polywigner.kernels.outline.tables import Edge
from polywigner.numerics.exact import accurate_cross

__all__ = ["OutlineEdges", "main_direction"]

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Numbers = npt.NDArray[np.int64]

# Vertices on one line up to this distance do not turn: the area at stake is below rounding.
_STRAIGHT = 4e-16


@dataclass(frozen=True)
class OutlineEdges:
    """The edges as arrays, (n, 2) or (n,); they are the sides of the other copy as well."""

    start: Floats
    vector: Floats
    offset: Floats
    cluster: Floats
    weight: Complexes
    line: Numbers
    side: Numbers
    rings: Numbers
    """The first edge of each ring, and n."""

    @classmethod
    def of(cls, edges: Sequence[Edge]) -> OutlineEdges:
        floats = np.array([(e.ax, e.ay, e.ex, e.ey, e.offset, e.cluster) for e in edges])
        numbers = np.array([(e.line, e.side) for e in edges], np.int64)
        weight = np.array([complex(e.real, e.imag) for e in edges])
        starts = [(e.ax, e.ay) for e in edges]
        first = [0]
        for k, edge in enumerate(edges):
            if (edge.bx, edge.by) == starts[first[-1]]:
                first.append(k + 1)
        return cls(
            floats[:, :2], floats[:, 2:4], floats[:, 4], floats[:, 5], weight,
            numbers[:, 0], numbers[:, 1], np.array(first),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.start)

    @property
    def segments(self) -> Segments:
        return Segments(self.start + self.vector / 2, self.vector / 2)

    @cached_property
    def before(self) -> Numbers:
        """The number of the edge before each."""
        before = np.arange(-1, len(self) - 1)
        before[self.rings[:-1]] = self.rings[1:] - 1
        return before

    @cached_property
    def next(self) -> Numbers:
        """The number of the edge after each."""
        return np.argsort(self.before)

    @property
    def turns(self) -> Floats:
        """The angle by which the outline turns to the left where each edge begins."""
        (ex, ey), (fx, fy) = self.vector[self.before].T, self.vector.T
        cross = accurate_cross(ex, ey, fx, fy)
        longer = np.maximum(np.hypot(ex, ey), np.hypot(fx, fy))
        ahead = ex * fx + ey * fy
        straight = (np.abs(cross) <= _STRAIGHT * longer) & (ahead > 0)
        return np.where(straight, 0.0, np.arctan2(cross, ahead))


def main_direction(vectors: Floats) -> float:
    """The angle, modulo a right angle, at which edges have the greatest length."""
    angles = np.arctan2(vectors[:, 1], vectors[:, 0]) % (np.pi / 2)
    bins = np.round(angles * 1e6).astype(np.int64)
    _, which = np.unique(bins, return_inverse=True)
    lengths = np.bincount(which.ravel(), np.hypot(*vectors.T))
    if lengths.max() < 2 * lengths.min():
        return 0.0
    return float(angles[which.ravel() == lengths.argmax()][0])
