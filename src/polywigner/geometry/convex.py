"""Triangulation and convex cover of an aperture, using only its own vertices."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.exact import Ring, cross_products, orientations, shoelace, turn
from polywigner.geometry.rings import Part, extent, polygon_of_part

__all__ = ["convex_pieces", "triangulate_part"]

Indices = NDArray[np.intp]

# A piece may be dented by this fraction of area/diameter: the region that its half-planes enclose
# then misses at most this fraction of the area, a tenth of the accuracy of the transforms.
_DENT = 2.0**-48

# Larger dented pieces stay cut, because testing them is quadratic.
_LARGEST_DENTED = 512

# Greedy merging depends on the order of the diagonals: random orders are tried until so many in a
# row found nothing better, or until that many merges in all.
_PATIENCE = 16
_MOST_MERGES = 20_000


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
    if shoelace(vertices[triangles]) < 0:
        # All together: triangles of zero area, too, keep edges that run against their neighbours'.
        triangles = triangles[:, ::-1]
    if shoelace(vertices[triangles]) != shoelace(part):
        raise GeometryError(
            "expected an outline that can be triangulated, got one whose triangles miss its area; "
            "round its coordinates, for instance with shapely.set_precision"
        )
    return vertices, triangles


def _is_convex(ring: Ring, dent: float) -> bool:
    """Whether every vertex lies left of every edge's line, or right of it by at most `dent`.

    Edges times vertices in cost: refused for rings beyond _LARGEST_DENTED.
    """
    if len(ring) > _LARGEST_DENTED:
        return False
    start, end = ring, np.roll(ring, -1, axis=0)
    value, bound = cross_products(start[:, None], end[:, None], ring[None, :])
    slack = dent * np.hypot(*(end - start).T)[:, None]
    if np.any(value < -slack - bound):
        return False
    unsure = zip(*np.nonzero(value < bound - slack), strict=True)
    return all(
        turn(start[i].tolist(), end[i].tolist(), ring[j].tolist()) >= -slack[i, 0]
        for i, j in unsure
    )


class _Merger:
    """Pieces as cycles of vertex numbers, merged across diagonals while they stay convex."""

    def __init__(self, vertices: Ring, triangles: Indices, dent: float) -> None:
        self.vertices = vertices
        self.points = [(float(x), float(y)) for x, y in vertices]
        self.dent = dent
        self.dented: set[int] = set()
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
        at_i = self._dent_at(ahead[p - 2], i, back[(q + 1) % len(back)])
        at_j = self._dent_at(back[q - 2], j, ahead[(p + 1) % len(ahead)])
        if max(at_i, at_j) > self.dent:
            return False
        # From j round the left piece to i, then from i round the right piece to j.
        merged = (ahead[p:] + ahead[:p])[:-1] + (back[q:] + back[:q])[:-1]
        if at_i > 0 or at_j > 0 or left in self.dented or right in self.dented:
            # Dents at rounding level: how far they reach depends on the whole piece.
            if not _is_convex(self.vertices[merged], self.dent):
                return False
            self.dented.add(left)
        self.pieces[left], self.pieces[right] = merged, []
        for k in range(len(merged)):
            self.owner[merged[k - 1], merged[k]] = left
        del self.owner[i, j], self.owner[j, i]
        return True

    def _dent_at(self, before: int, corner: int, after: int) -> float:
        """How far the neighbours of a corner lie right of its edges' lines; 0 where convex."""
        a, b, c = self.points[before], self.points[corner], self.points[after]
        value = turn(a, b, c)
        if value >= 0:
            return 0.0
        shorter = min(math.hypot(b[0] - a[0], b[1] - a[1]), math.hypot(c[0] - b[0], c[1] - b[1]))
        return -value / shorter

    def run(self, order: Sequence[tuple[int, int]]) -> list[list[int]]:
        for i, j in order:
            self.try_merge(i, j)
        return [piece for piece in self.pieces if piece]


def _fewest_pieces(vertices: Ring, triangles: Indices, dent: float, enough: int) -> list[list[int]]:
    """The best of several orders of merging; `enough` pieces cannot be improved on."""
    diagonals = _Merger(vertices, triangles, dent).diagonals()

    def merged(order: Sequence[int] | Indices) -> list[list[int]]:
        return _Merger(vertices, triangles, dent).run([diagonals[k] for k in order])

    ends = vertices[np.array(diagonals, dtype=np.intp).reshape(-1, 2)]
    longest_first = np.argsort(-np.hypot(*(ends[:, 1] - ends[:, 0]).T), kind="stable")
    best = min(merged(longest_first), merged(longest_first[::-1]), key=len)
    shuffle = np.random.default_rng(0).permutation
    idle = 0
    for _ in range(_MOST_MERGES // (len(diagonals) + 1)):
        if len(best) <= enough or idle == _PATIENCE:
            break
        cover = merged(shuffle(len(diagonals)))
        idle = 0 if len(cover) < len(best) else idle + 1
        best = min(best, cover, key=len)
    return best


def _fewest_possible(part: Part) -> int:
    """Each dent needs a diagonal, one serves at most two, and one per hole makes no new piece."""
    dents = 0
    for ring in part:
        turns = orientations(np.roll(ring, 1, axis=0), ring, np.roll(ring, -1, axis=0))
        dents += int(np.count_nonzero(turns < 0))
    return max(1, (dents + 1) // 2 + 2 - len(part))


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
        if np.all(turns >= 0) or _is_convex(ring, dent):
            return [ring]
    vertices, triangles = triangulate_part(part)
    enough = _fewest_possible(part)
    pieces = [vertices[piece] for piece in _fewest_pieces(vertices, triangles, dent, enough)]
    return [piece for piece in pieces if shoelace([piece]) > 0]
