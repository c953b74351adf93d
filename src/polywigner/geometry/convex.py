"""Triangulation and convex cover of an aperture, using only its own vertices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.exact import Ring, cross_products, orientations, shoelace
from polywigner.geometry.rings import Part, extent, polygon_of_part

__all__ = ["convex_pieces", "triangulate_part"]

Indices = NDArray[np.intp]

# A piece may be dented by this fraction of area/diameter: the region that its half-planes enclose
# then misses at most this fraction of the area, a tenth of the accuracy of the transforms.
_DENT = 2.0**-48

# Greedy merging depends on the order of the diagonals; some random orders find fewer pieces.
_RESTARTS = 32
_LARGEST_SHUFFLED = 400


def triangulate_part(part: Part) -> tuple[Ring, Indices]:
    """Constrained Delaunay triangles: vertices (n, 2) and counter-clockwise indices (m, 3).

    Zero-area triangles (of vertices on one line) may be among them: they keep neighbours
    connected. Raises GeometryError if the triangles do not tile the part exactly.
    """
    vertices = np.unique(np.concatenate(part), axis=0)
    index = {vertex.tobytes(): number for number, vertex in enumerate(vertices)}
    found = shapely.constrained_delaunay_triangles(polygon_of_part(part))
    corners = shapely.get_coordinates(found).reshape(-1, 4, 2)[:, :3] + 0.0
    triangles = np.array(
        [[index[corner.tobytes()] for corner in triangle] for triangle in corners], dtype=np.intp
    ).reshape(-1, 3)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    clockwise = orientations(a, b, c) < 0
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    if shoelace(vertices[triangles]) != shoelace(part):
        raise GeometryError(
            "expected an outline that can be triangulated, got one whose triangles miss its area; "
            "round its coordinates, for instance with shapely.set_precision"
        )
    return vertices, triangles


def _is_convex(ring: Ring, dent: float) -> bool:
    """Whether every vertex lies left of every edge's line, or right of it by at most `dent`."""
    start, end = ring, np.roll(ring, -1, axis=0)
    value, bound = cross_products(start[:, None], end[:, None], ring[None, :])
    slack = dent * np.hypot(*(end - start).T)[:, None]
    if np.any(value < -bound - slack):
        return False
    unsure = np.nonzero(value < bound - slack)
    if not len(unsure[0]):
        return True
    i, j = unsure
    signs = orientations(start[i], end[i], ring[j])
    # Right of the line: the float value then is known to be within `bound` of the dent's limit,
    # which is at rounding level itself.
    return bool(np.all((signs >= 0) | (value[i, j] >= -slack[i, 0])))


def _winds_once(ring: Ring) -> bool:
    """For a ring with left turns only: whether they add up to one turn, not to several."""
    edges = np.roll(ring, -1, axis=0) - ring
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    turns = (np.roll(angles, -1) - angles) % (2 * np.pi)
    return float(turns.sum()) < 3 * np.pi


class _Merger:
    """Pieces as cycles of vertex numbers, merged across diagonals while they stay convex."""

    def __init__(self, vertices: Ring, triangles: Indices, dent: float) -> None:
        self.vertices = vertices
        self.dent = dent
        self.pieces: list[list[int]] = [list(map(int, t)) for t in triangles]
        self.owner = {
            (piece[k - 1], piece[k]): n for n, piece in enumerate(self.pieces) for k in range(3)
        }

    def diagonals(self) -> list[tuple[int, int]]:
        return [(i, j) for i, j in self.owner if i < j and (j, i) in self.owner]

    def try_merge(self, i: int, j: int) -> bool:
        left, right = self.owner[i, j], self.owner[j, i]
        if left == right:
            return False
        ahead, back = self.pieces[left], self.pieces[right]
        p, q = ahead.index(j), back.index(i)
        # From j round the left piece to i, then from i round the right piece to j.
        merged = (ahead[p:] + ahead[:p])[:-1] + (back[q:] + back[:q])[:-1]
        if len(set(merged)) < len(merged) or not _is_convex(self.vertices[merged], self.dent):
            return False
        self.pieces[left], self.pieces[right] = merged, []
        for k in range(len(merged)):
            self.owner[merged[k - 1], merged[k]] = left
        del self.owner[i, j], self.owner[j, i]
        return True

    def run(self, order: Sequence[tuple[int, int]]) -> list[list[int]]:
        for i, j in order:
            self.try_merge(i, j)
        return [piece for piece in self.pieces if piece]


def _fewest_pieces(vertices: Ring, triangles: Indices, dent: float) -> list[list[int]]:
    diagonals = _Merger(vertices, triangles, dent).diagonals()
    ends = vertices[np.array(diagonals, dtype=np.intp).reshape(-1, 2)]
    longest_first = np.argsort(-np.hypot(*(ends[:, 1] - ends[:, 0]).T), kind="stable")
    shuffle = np.random.default_rng(0).permutation
    restarts = _RESTARTS if len(triangles) <= _LARGEST_SHUFFLED else 0
    orders = [longest_first, longest_first[::-1]]
    orders += [shuffle(len(diagonals)) for _ in range(restarts)]
    covers = [
        _Merger(vertices, triangles, dent).run([diagonals[k] for k in order]) for order in orders
    ]
    return min(covers, key=len)


def convex_pieces(part: Part) -> list[Ring]:
    """Convex counter-clockwise polygons that tile the part, with its own vertices only.

    A convex part is its own single piece. Otherwise constrained Delaunay triangles are merged
    greedily while convex (Hertel and Mehlhorn 1983: at most four times the fewest possible),
    over several orders of merging.
    """
    area = float(shoelace(part))
    dent = _DENT * area / extent(part[0])
    if len(part) == 1:
        ring = part[0]
        turns = orientations(np.roll(ring, 1, axis=0), ring, np.roll(ring, -1, axis=0))
        if np.all(turns >= 0) and _winds_once(ring):
            return [ring]
        if len(ring) <= 2000 and np.count_nonzero(turns < 0) < 3 and _is_convex(ring, dent):
            return [ring]
    vertices, triangles = triangulate_part(part)
    pieces = [vertices[piece] for piece in _fewest_pieces(vertices, triangles, dent)]
    return [piece for piece in pieces if shoelace([piece]) > 0]
