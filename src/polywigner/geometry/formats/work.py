"""Outlines that are near each other: pairs counted before anything is computed from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import FileFormatError
from polywigner.geometry.exact import Ring
from polywigner.geometry.formats.limits import (
    MOST_CROSSINGS,
    MOST_NEAR_EDGES,
    MOST_NEAR_RINGS,
    MOST_NEAR_VERTICES,
    check_rings,
    check_vertices,
)

__all__ = ["Work", "check_polygons"]

# Bounds the memory of one step.
_PAIRS_AT_ONCE = 4_000_000

Points = NDArray[np.float64]


class Work:
    """Pairs that the shapes of one file have asked for so far: its limits are those of all."""

    def __init__(self) -> None:
        self._edges = self._crossings = self._rings = self._vertices = 0

    def check_outlines(self, rings: Sequence[Ring]) -> None:
        """Raise for very many outlines upon or inside each other, which are compared in pairs."""
        if len(rings) < 2:
            return
        low = np.array([ring.min(axis=0) for ring in rings])
        high = np.array([ring.max(axis=0) for ring in rings])
        tree = shapely.STRtree(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
        sizes = np.array([len(ring) for ring in rings])
        for first, last in _steps(low, high):
            one, other = tree.query(tree.geometries[first:last])
            one += first
            later = one < other
            self._rings += int(later.sum())
            self._vertices += int(sizes[one[later]].sum() + sizes[other[later]].sum())
            if self._rings > MOST_NEAR_RINGS or self._vertices > MOST_NEAR_VERTICES:
                raise FileFormatError(
                    f"expected at most {MOST_NEAR_RINGS} pairs of outlines that are near or "
                    f"inside each other, and {MOST_NEAR_VERTICES} vertices of such pairs, got "
                    "more; use fewer"
                )

    def check_edges(self, rings: Sequence[Ring]) -> None:
        """Raise for outlines that cross themselves or each other in very many places, or nearly.

        Quick also where they do, while GEOS needs minutes to tell where 100 000 edges cross. What
        GEOS does grows with the pairs of edges whose bounding boxes meet, so these are counted.
        """
        start = np.concatenate(rings)
        end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
        tree = shapely.STRtree(shapely.linestrings(np.stack([start, end], axis=1)))
        for first, last in _steps(np.minimum(start, end), np.maximum(start, end)):
            one, other = tree.query(tree.geometries[first:last])
            one += first
            self._edges += int((one < other).sum())
            apart = (one < other) & ~(start[other] == end[one]).all(axis=1)
            apart &= ~(start[one] == end[other]).all(axis=1)
            one, other = one[apart], other[apart]
            self._crossings += _crossings(start[one], end[one], start[other], end[other])
            if self._edges > MOST_NEAR_EDGES:
                raise FileFormatError(
                    f"expected at most {MOST_NEAR_EDGES} pairs of edges near each other, got more; "
                    "simplify the outlines"
                )
            if self._crossings > MOST_CROSSINGS:
                raise FileFormatError(
                    f"expected outlines that cross in at most {MOST_CROSSINGS} places, got more; "
                    "simplify them"
                )


def check_polygons(polygons: Sequence[Sequence[Any]]) -> int:
    """The number of vertices of polygons, each a list of rings; raises for more work than is done.

    What is no ring is refused by those who make parts of them.
    """
    check_rings(sum(map(len, polygons)))
    vertices = sum(len(ring) for rings in polygons for ring in rings)
    check_vertices(vertices)
    try:
        arrays = [[np.asarray(ring, dtype=np.float64) for ring in rings] for rings in polygons]
    except (TypeError, ValueError):
        return vertices
    rings = [ring for part in arrays for ring in part]
    pairs = all(ring.ndim == 2 and ring.shape[1] == 2 and len(ring) for ring in rings)
    if pairs and np.isfinite(np.concatenate(rings)).all():
        work = Work()
        work.check_outlines([part[0] for part in arrays])
        work.check_edges(rings)
    return vertices


def _steps(low: Points, high: Points) -> Iterator[tuple[int, int]]:
    """Ranges of boxes (low and high corners (n, 2)) that meet few enough others for memory."""
    most = np.full(len(low), len(low))
    for k in range(2):  # those that meet along one axis are more than those that meet
        begun = np.searchsorted(np.sort(low[:, k]), high[:, k], side="right")
        ended = np.searchsorted(np.sort(high[:, k]), low[:, k], side="left")
        most = np.minimum(most, begun - ended)
    total = np.concatenate([[0], np.cumsum(most)])
    first = 0
    while first < len(low):
        last = int(np.searchsorted(total, total[first] + _PAIRS_AT_ONCE, side="right")) - 1
        last = min(max(last, first + 1), len(low))
        yield first, last
        first = last


def _crossings(a: Points, b: Points, c: Points, d: Points) -> int:
    """How many segments a-b cross c-d, up to rounding: they are only counted."""
    apart = _side(a, b, c) * _side(a, b, d) < 0
    a, b, c, d = a[apart], b[apart], c[apart], d[apart]
    return int((_side(c, d, a) * _side(c, d, b) < 0).sum())


def _side(a: Points, b: Points, c: Points) -> Points:
    along, across = (b - a).T, (c - a).T
    return np.sign(along[0] * across[1] - along[1] * across[0])
