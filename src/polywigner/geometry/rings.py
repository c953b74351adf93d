"""Rings of callers made clean: float64, finite, no repeats, known orientation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.exact import (
    Ring,
    area_and_error,
    cross_products,
    estimated_area,
    orientations,
    shoelace,
    signed_area,
    turn,
)

Part = tuple[Ring, ...]
"""One polygon: its exterior (counter-clockwise) followed by its holes (clockwise)."""

# Beyond these the area over- or underflows float64; a change of unit is the answer.
LARGEST_COORDINATE = 1e100
SMALLEST_EXTENT = 1e-100

# Points on a slanted line are off it by about one unit in the last place u = 2^-53 of the largest
# coordinate m, so such a ring of diameter d spans an area up to a few u * m * d: that is "zero".
_ZERO_AREA = 2.0**-50


def rounding_tolerance(coordinates: Ring) -> float:
    """64 ulp of the largest coordinate: more than rotating, shifting and printing move a vertex."""
    return float(2.0**-46 * np.abs(coordinates).max())


def extent(points: Ring) -> float:
    """Diagonal of the bounding box, an upper bound on the diameter."""
    size = points.max(axis=0) - points.min(axis=0)
    return float(np.hypot(size[0], size[1]))


def _as_array(vertices: Any, name: str) -> NDArray[np.float64]:
    expected = f"expected {name} as an (n, 2) array of numbers"
    if np.ma.is_masked(vertices):
        raise GeometryError(f"{expected}, got masked elements; leave those vertices out")
    try:
        raw = np.asarray(vertices)
    except (ValueError, TypeError) as error:
        raise GeometryError(f"{expected}, got {type(vertices).__name__} ({error})") from None
    if raw.dtype.kind not in "iufO":
        raise GeometryError(f"{expected}, got values of type {raw.dtype}; give real numbers")
    try:
        array = np.array(raw, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        raise GeometryError(f"{expected}, got values that are not real numbers") from None
    if array.ndim != 2 or array.shape[1] != 2:
        hint = "; drop the z column" if array.ndim == 2 and array.shape[1] == 3 else ""
        raise GeometryError(f"{expected}, got shape {array.shape}{hint}")
    return array


def _without_repeats(ring: Ring) -> Ring:
    """Drop vertices equal to their predecessor, the closing one included."""
    return ring[np.any(ring != np.roll(ring, 1, axis=0), axis=1)]


def without_straight_vertices(ring: Ring) -> Ring:
    """Drop vertices that lie exactly on the segment between their neighbours.

    The region stays exactly the same. The tips of spikes (out and straight back) are kept, so
    that validation can find and name them.
    """
    before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
    onward = np.sum((ring - before) * (after - ring), axis=1) > 0
    kept = ring[~(onward & (orientations(before, ring, after) == 0))]
    return kept if len(kept) >= 3 else ring


def _certainly_within(points: Ring, start: Ring, end: Ring, reach: float) -> NDArray[np.bool_]:
    """Mask of points that lie within reach of segments, whatever the rounding."""
    chord = end - start
    value, bound = cross_products(start, end, points)
    near = np.abs(value) + bound <= reach * np.hypot(chord[..., 0], chord[..., 1])
    between = np.sum((points - start) * chord, axis=-1) > 0
    return near & between & (np.sum((end - points) * chord, axis=-1) > 0)


def without_slight_bends(ring: Ring, reach: float) -> Ring:
    """Drop vertices within `reach` of the segment between the kept vertices next to them.

    Runs of such vertices go as a whole or stay as a whole, so that a second pass changes nothing
    and it does not matter where the ring starts. A closing repeat is dropped.
    """
    ring = _without_repeats(ring)
    slight = _certainly_within(ring, np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0), reach)
    anchors = np.nonzero(~slight)[0]
    if len(anchors) < 3 or len(anchors) == len(ring):
        return ring
    run = np.cumsum(~slight)[slight] - 1  # the number of the anchor before; -1 is the last one
    first, last = ring[anchors[run]], ring[anchors[(run + 1) % len(anchors)]]
    bent = ~_certainly_within(ring[slight], first, last, reach)
    keep = ~slight
    keep[slight] = np.isin(run % len(anchors), run[bent] % len(anchors))
    return ring[keep]


def different_vertices(ring: Ring) -> int:
    """Number of different vertices of a ring; 3 for more than three."""
    for count in range(3):
        if not len(ring):
            return count
        ring = ring[(ring != ring[0]).any(axis=1)]
    return 3


def clean_ring(vertices: Any, name: str = "a ring") -> Ring:
    """Check one ring and return it as float64 without repeats and straight vertices.

    The orientation is left as given. Raises GeometryError for anything but at least three
    different, finite vertices that span an area.
    """
    ring = _as_array(vertices, name)
    if not np.isfinite(ring).all():
        row = int(np.argmin(np.isfinite(ring).all(axis=1)))
        x, y = ring[row]
        raise GeometryError(
            f"expected finite coordinates in {name}, got ({x}, {y}) as vertex {row}; remove it"
        )
    if len(ring) and np.abs(ring).max() > LARGEST_COORDINATE:
        raise GeometryError(
            f"expected coordinates below {LARGEST_COORDINATE:g} in {name}, "
            f"got {np.abs(ring).max():g}; choose a larger unit"
        )
    ring = ring + 0.0  # turns -0.0 into 0.0, so that content compares
    count = different_vertices(ring)
    if count < 3:
        raise GeometryError(f"expected at least 3 different vertices in {name}, got {count}")
    size = extent(ring)
    if size < SMALLEST_EXTENT:
        raise GeometryError(
            f"expected {name} to be larger than {SMALLEST_EXTENT:g}, got a size of {size:g}; "
            "choose a smaller unit"
        )
    return without_straight_vertices(_without_repeats(ring))


def spans_area(ring: Ring) -> bool:
    """Whether the ring's area is more than rounding of its coordinates could make it."""
    zero = _ZERO_AREA * extent(ring) * float(np.abs(ring).max())
    area, error = area_and_error(ring)
    if abs(abs(area) - zero) <= error:
        area = signed_area(ring)
    return abs(area) > zero


def hull_spans_area(ring: Ring) -> bool:
    """Whether the vertices are apart from one line; the areas of a figure of eight cancel."""
    return spans_area(shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(ring))))


def oriented(ring: Ring, counter_clockwise: bool) -> Ring:
    """The ring, reversed if it does not run the way asked for."""
    return ring if (estimated_area(ring) > 0) == counter_clockwise else ring[::-1]


def polygon_of_part(part: Part) -> shapely.Polygon:
    """The part as a shapely Polygon, same floats."""
    return shapely.Polygon(part[0], part[1:])


def part_of_polygon(polygon: shapely.Polygon) -> Part:
    """The rings of a valid shapely Polygon as a part."""
    outer, *holes = (clean_ring(ring) for ring in rings_of_polygon(polygon))
    return (oriented(outer, True), *(oriented(hole, False) for hole in holes))


def rings_of_polygon(polygon: shapely.Polygon, name: str = "the polygon") -> list[Ring]:
    """The vertices of a shapely Polygon as they are, exterior first; heights must be zero."""
    if polygon.is_empty:
        raise GeometryError(f"expected {name} to have vertices, got an empty polygon")
    if shapely.has_z(polygon):
        heights = shapely.get_coordinates(polygon, include_z=True)[:, 2]
        if np.any(heights != 0) and not np.isnan(heights).all():
            raise GeometryError(
                f"expected {name} in the plane z = 0, got other heights; "
                "drop them with shapely.force_2d(polygon)"
            )
    return [shapely.get_coordinates(ring) for ring in (polygon.exterior, *polygon.interiors)]


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
        """Distance of a corner's neighbours to the right of its edges' lines; 0 where convex."""
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
