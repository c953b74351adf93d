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
from polywigner.geometry.grid import grid_size, polygons_in
from polywigner.illumination import Array
from polywigner.illumination.support import mutual_support

__all__ = ["Triangles", "kink_count", "kinks", "smooth_triangles"]

Triangles = NDArray[np.float64]
"""Corners (n, 3, 2)."""


def _elements(source: Aperture | Array) -> Sequence[Aperture]:
    if isinstance(source, Aperture):
        return (source,)
    return [element for element in source.coplanar if isinstance(element, Aperture)]


def kink_count(source: Aperture | Array) -> int:
    """How many segments (T5) there are: the square of the number of vertices."""
    if isinstance(source, Array) and source.repeated is not None:
        element, positions = source.repeated
        assert isinstance(element, Aperture)
        return (len(positions) * sum(map(len, element.rings))) ** 2
    return sum(len(ring) for element in _elements(source) for ring in element.rings) ** 2


def kinks(source: Aperture | Array) -> NDArray[np.float64]:
    """The segments (T5), each once: (m, 2, 2), ends in the plane of the source."""
    rings = [ring for element in _elements(source) for ring in element.rings]
    vertices = np.concatenate(rings)
    ends = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    first = vertices[:, None] / 2 + vertices / 2
    second = vertices[:, None] / 2 + ends / 2
    segments = np.stack([first, second], axis=-2).reshape(-1, 2, 2)
    return _distinct(segments, grid_size(vertices))


def _distinct(segments: NDArray[np.float64], grid: float) -> NDArray[np.float64]:
    """Without repetitions, whichever way they run; coordinates rounded to the grid."""
    whole = np.rint(segments / grid)
    swapped = (whole[:, 0, 0] > whole[:, 1, 0]) | (
        (whole[:, 0, 0] == whole[:, 1, 0]) & (whole[:, 0, 1] > whole[:, 1, 1])
    )
    whole[swapped] = whole[swapped, ::-1]
    result: NDArray[np.float64] = np.unique(whole.reshape(-1, 4), axis=0).reshape(-1, 2, 2) * grid
    return result[(result[:, 0] != result[:, 1]).any(axis=-1)]


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
