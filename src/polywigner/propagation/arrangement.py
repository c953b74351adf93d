"""Where the Wigner function is smooth in position: the cells between its kinks, as triangles.

W(x, nu) is the transform of the slice 2(G - x) & 2(x - G), whose corners move linearly with x until
a vertex of one copy meets an edge of the other. That happens on the segments

    [(V_k + V_i)/2, (V_k + V_{i+1})/2]      for all vertices k and edges i                  (T5)

of the source, and between them W is an analytic function of x. Rules of Gauss on the cells of this
arrangement converge spectrally, where any rule that ignores it gains little from more nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.geometry import Aperture
from polywigner.geometry.exact import grid_size, polygons_in
from polywigner.illumination import Array
from polywigner.illumination.support import mutual_support

__all__ = [
    "Triangles",
    "has_few_kinks",
    "kink_count",
    "kinks",
    "smooth_triangles",
    "triangulated",
]

Triangles = NDArray[np.float64]
"""Corners (n, 3, 2)."""


def kinks(source: Aperture | Array) -> NDArray[np.float64]:
    """The segments (T5), each once: (m, 2, 2), ends in the plane of the source.

    Of copies of one element they are the element's own around all midpoints of two copies.
    """
    phased = source.phased if isinstance(source, Array) else None
    if phased is None or phased.repeated is None:
        return _distinct(_own_kinks(source), _grid(source))
    element, positions = phased.repeated
    assert isinstance(element, Aperture)
    means = (positions[:, None] / 2 + positions / 2).reshape(-1, 1, 2)
    grid = grid_size(np.concatenate([np.concatenate(element.rings), positions]))
    (places,) = _distinct(means, grid).transpose(1, 0, 2)
    own = _distinct(_own_kinks(element), grid)
    return _distinct((own + places[:, None, None]).reshape(-1, 2, 2), grid)


def kink_count(source: Aperture | Array) -> int:
    """How many segments (T5) there may be."""
    phased = source.phased if isinstance(source, Array) else None
    if phased is None or phased.repeated is None:
        return int(sum(len(ring) for ring in _rings(source)) ** 2)
    element, positions = phased.repeated
    assert isinstance(element, Aperture)
    grid = grid_size(positions) if positions.any() else 1.0
    means = (positions[:, None] / 2 + positions / 2).reshape(-1, 1, 2)
    return len(_distinct(means, grid)) * len(np.concatenate(element.rings)) ** 2


def _rings(source: Aperture | Array) -> list[NDArray[np.float64]]:
    return [ring for element in source.elements_in_plane for ring in element.rings]


def _grid(source: Aperture | Array) -> float:
    return grid_size(np.concatenate(_rings(source)))


def _own_kinks(source: Aperture | Array) -> NDArray[np.float64]:
    rings = _rings(source)
    vertices = np.concatenate(rings)
    ends = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    first = vertices[:, None] / 2 + vertices / 2
    second = vertices[:, None] / 2 + ends / 2
    return np.stack([first, second], axis=-2).reshape(-1, 2, 2)


def _distinct(shapes: NDArray[np.float64], grid: float) -> NDArray[np.float64]:
    """Points (n, 1, 2) or segments (n, 2, 2) without repetitions, coordinates rounded to the grid.

    Segments that run opposite ways count as one, and those that shrink to a point as none.
    """
    whole = np.rint(shapes / grid)
    first, last = whole[:, 0], whole[:, -1]
    swapped = (first[:, 0] > last[:, 0]) | (
        (first[:, 0] == last[:, 0]) & (first[:, 1] > last[:, 1])
    )
    whole[swapped] = whole[swapped, ::-1]
    result: NDArray[np.float64] = np.unique(whole.reshape(len(whole), -1), axis=0) * grid
    result = result.reshape(-1, *shapes.shape[1:])
    if shapes.shape[1] == 1:
        return result
    return result[(result[:, 0] != result[:, 1]).any(axis=-1)]


# Segments of which more are not looked for, some seconds' work, and places where they meet.
_MOST_KINKS, _MOST_MEETINGS = 1 << 16, 1 << 20
_LOOKED_AT = 256


@lru_cache(maxsize=64)
def has_few_kinks(source: Aperture | Array) -> bool:
    """Whether the arrangement can be had: up to 65,536 segments that meet some million times.

    A regular polygon of 256 vertices is the last one; 40 squares at random have 48,000 cells.
    """
    if kink_count(source) > _MOST_KINKS:
        return False
    segments = kinks(source)
    lines = shapely.linestrings(segments)
    step = max(1, len(lines) // _LOOKED_AT)
    tree = shapely.STRtree(lines)
    looked_at = lines[::step]
    found = tree.query(looked_at, predicate="intersects").shape[1]
    return bool(found / len(looked_at) * len(lines) / 2 <= _MOST_MEETINGS)


@lru_cache(maxsize=64)
def smooth_triangles(source: Aperture | Array) -> Triangles:
    """Triangles (n, 3, 2) that tile the automean of a source and that no kink of W crosses."""
    segments = kinks(source)
    grid = grid_size(segments.reshape(-1, 2))
    noded = shapely.union_all(shapely.linestrings(segments), grid_size=grid)
    cells = np.array(polygons_in(shapely.polygonize([noded])), dtype=object)
    support = mutual_support(source).polygons
    shapely.prepare(support)
    inside = shapely.contains_properly(support, shapely.point_on_surface(cells))
    return triangulated(cells[inside])


def triangulated(polygons: Sequence[shapely.Polygon] | NDArray[np.object_]) -> Triangles:
    """Constrained Delaunay triangles (n, 3, 2) of polygons."""
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(np.asarray(polygons)))
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    corners.setflags(write=False)
    return corners
