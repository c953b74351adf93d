"""Edges that are equal up to a translation, as repeated elements and parallel sides have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Family", "families_of"]

# Edge vectors this close, in the frame, count as equal: congruent elements have them after
# rounding. Their mean stands for them, which moves the transform no more than that rounding did.
_EQUAL = 2.0**-51


@dataclass(frozen=True, eq=False)
class Family:
    """Edges with one vector (ex, ey) up to sign; a component that is rounding only is 0."""

    ex: float
    ey: float
    middles: npt.NDArray[np.float64]
    """(n, 2) their midpoints."""
    weights: npt.NDArray[np.complex128]
    """(n,) the field on the edge's element, for an edge along (ex, ey); minus that against it."""

    @property
    def straight(self) -> bool:
        """Whether the edges run along an axis."""
        return self.ex == 0.0 or self.ey == 0.0


def families_of(edges: Sequence[Sequence[float]], field: npt.ArrayLike = 1.0) -> tuple[Family, ...]:
    """Edges (begin x, y, end x, y, ...) sorted into families, with the field on their elements."""
    corners = np.array(edges)
    begin, end = corners[:, :2], corners[:, 2:4]
    vectors, middles = end - begin, (begin + end) / 2
    vectors[np.abs(vectors) <= _EQUAL] = 0.0
    backwards = (vectors[:, 1] < 0) | ((vectors[:, 1] == 0) & (vectors[:, 0] < 0))
    signs = np.where(backwards, -1.0, 1.0)
    weights = signs * np.asarray(field, np.complex128)
    vectors *= signs[:, None]
    families = []
    for members in _clusters(vectors):
        ex, ey = vectors[members].mean(axis=0).tolist()
        families.append(Family(ex, ey, middles[members], weights[members]))
    return tuple(families)


def _clusters(vectors: npt.NDArray[np.float64]) -> list[list[int]]:
    """Numbers of the vectors that agree with the first of their cluster in both components."""
    found: list[list[int]] = []
    near: list[list[int]] = []  # clusters that the next vector in order of x may still belong to
    for k in np.lexsort((vectors[:, 1], vectors[:, 0])).tolist():
        near = [c for c in near if vectors[k, 0] - vectors[c[0], 0] <= _EQUAL]
        for cluster in near:
            if abs(vectors[k, 1] - vectors[cluster[0], 1]) <= _EQUAL:
                cluster.append(k)
                break
        else:
            near.append([k])
            found.append(near[-1])
    return found
