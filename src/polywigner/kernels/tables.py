"""The constants of a polygon that the kernels are traced with.

A slice of the autocorrelation is the intersection of two copies of the polygon. Its boundary is
made of the true edges of either copy, cut to the parts that lie inside the other, and "inside" is
decided line by line against the convex pieces of the other copy. So a table lists edges, the
supporting lines of edges and pieces, and the pieces as sets of (line, side).

What makes coincident edges come out right, under rounding, is that both copies are cut with the
same numbers. Lines fall into clusters of direction, more than ``_TRANSVERSAL`` apart:

- In a cluster of *parallel* lines all share one direction, and whether an edge lies to the left
  of a line is one comparison of one float (the offset of the copies) with a sum or difference
  of two others. The two copies see the identical comparison.
- In a cluster of nearly parallel lines the vertices are rounded to a grid so coarse that their
  sums and differences are exact; every cut is then the quotient of an exactly known number and
  of a cross product with an error of one ulp, as if computed in exact arithmetic.
- Lines of different clusters meet at a well-conditioned point; rounding moves it by a few ulps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.kernels.frame import Frame, frame_of
from polywigner.kernels.lattice import (
    Lattice,
    exact_cross,
    signed_convex_pieces,
    with_vertices_on_sides,
)

__all__ = ["Edge", "Line", "Piece", "Tables", "build_tables"]

# sine of the angle below which two lines count as nearly parallel: an intersection of lines at
# this angle is off by 1/0.03 ulps
_TRANSVERSAL = 0.03
# A cluster counts as parallel if its lines agree to this angle, which moves an edge by less than
# 1e-14 (1e-7) of the diameter, and if no two of them lie so close that this could matter: their
# offsets either agree to the first of these figures, and are one line, or differ by the second.
# All other clusters go the exact way, so nothing depends on the values.
_PARALLEL = {True: 1e-14, False: 1e-7}  # by double precision or not
_SEPARATE = {True: 1e-12, False: 1e-5}
_SAME_OFFSET = 1e-14


@dataclass(frozen=True)
class Line:
    """All points p with cross(direction, p) = offset; left of it the cross product is larger."""

    dx: float
    dy: float
    offset: float
    cluster: int
    exact: bool
    px: float  # a point of the line; on the grid if the line is exact
    py: float


@dataclass(frozen=True)
class Edge:
    """A true boundary edge from a to b = a + e, the polygon to its left.

    All fields are numbers, so that a table of edges can also be a table of an engine's memory.
    """

    ax: Any
    ay: Any
    bx: Any
    """The next edge's ax: the same float, which ax + ex need not be."""
    by: Any
    ex: Any
    ey: Any
    area: Any
    """cross(a, e): twice the signed area of the triangle (origin, a, a + e)."""
    ux: Any
    uy: Any
    length: Any
    """e = length u, with one unit vector u for all parallel edges."""
    offset: Any
    """Of the edge's line."""
    cluster: Any
    """Of the edge's line."""


@dataclass(frozen=True)
class Piece:
    """A convex piece: (line, side) with side +1 where the piece lies left of the line."""

    sides: tuple[tuple[int, int], ...]
    weight: float  # -1 for a triangle that rounding to the grid has turned over


@dataclass(frozen=True)
class Tables:
    """Everything the kernels need to know of a polygon, in its frame."""

    frame: Frame
    edges: tuple[Edge, ...]
    lines: tuple[Line, ...]
    pieces: tuple[Piece, ...]
    grid: float | None  # spacing to which offsets must be rounded; None if no line needs it

    @cached_property
    def clips(self) -> int:
        """Number of (edge, side of a piece) pairs: the cost of one slice."""
        return len(self.edges) * sum(len(piece.sides) for piece in self.pieces)


def _clusters(angles: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
    """Cluster number of each direction in [0, pi): single linkage, the circle closed."""
    order = np.argsort(angles)
    sorted_angles = angles[order]
    starts = np.diff(sorted_angles, prepend=sorted_angles[:1]) > _TRANSVERSAL
    labels = np.cumsum(starts, dtype=np.intp)
    if sorted_angles[0] + np.pi - sorted_angles[-1] <= _TRANSVERSAL:
        labels[labels == labels[-1]] = 0
    result = np.empty_like(labels)
    result[order] = labels
    return result


def _canonical(segment: npt.NDArray[np.float64]) -> int:
    """+1 if a segment's direction lies in [0, pi), else -1."""
    ex, ey = segment
    return 1 if ey > 0 or (ey == 0 and ex > 0) else -1


class _LineBook:
    """Collects the supporting lines of segments and gives each geometric line one number."""

    def __init__(self, segments: npt.NDArray[np.float64], double: bool) -> None:
        """``segments`` (n, 4): start and vector of every segment that will be asked for."""
        vectors = segments[:, 2:]
        signs = np.array([_canonical(v) for v in vectors])
        angles = np.arctan2(signs * vectors[:, 1], signs * vectors[:, 0]) % np.pi
        clusters = _clusters(angles)
        self.lines: list[Line] = []
        self.number_of: list[int] = []
        self.signs: list[int] = []
        """+1 where a segment runs along its line, -1 where it runs against it."""
        shared = {
            int(cluster): _shared_direction(segments[clusters == cluster], double)
            for cluster in np.unique(clusters)
        }
        keys: dict[tuple[float, ...], int] = {}
        offsets: dict[int, list[float]] = {}
        for (ax, ay, ex, ey), sign, label in zip(segments.tolist(), signs, clusters, strict=True):
            cluster = int(label)
            direction = shared[cluster]
            if direction is None:
                start = (ax, ay) if sign > 0 else (ax + ex, ay + ey)
                dx, dy = sign * ex, sign * ey
                offset = exact_cross(dx, dy, *start)
                key: tuple[float, ...] = (*start, dx, dy)
            else:
                start = (ax, ay)
                dx, dy = direction
                sign = 1 if ex * dx + ey * dy > 0 else -1
                offset = _merged(dx * ay - dy * ax, offsets.setdefault(cluster, []))
                key = (cluster, offset)
            if key not in keys:
                keys[key] = len(self.lines)
                self.lines.append(Line(dx, dy, offset, cluster, direction is None, *start))
            self.number_of.append(keys[key])
            self.signs.append(int(sign))


def _shared_direction(
    segments: npt.NDArray[np.float64], double: bool
) -> tuple[float, float] | None:
    """The unit vector, in [0, pi), of a cluster whose lines are parallel, equal or well apart."""
    vectors = segments[:, 2:]
    lengths = np.hypot(vectors[:, 0], vectors[:, 1])
    longest = int(np.argmax(lengths))
    dx, dy = (_canonical(vectors[longest]) * vectors[longest] / lengths[longest]).tolist()
    angles = np.abs(dx * vectors[:, 1] - dy * vectors[:, 0]) / lengths
    offsets = np.sort(dx * segments[:, 1] - dy * segments[:, 0])
    parallel, separate = _PARALLEL[double], _SEPARATE[double]
    ends = np.flatnonzero(np.diff(offsets) > separate)
    spans = offsets[np.append(ends, -1)] - offsets[np.insert(ends + 1, 0, 0)]
    return (dx, dy) if max(angles) <= parallel and max(spans) <= _SAME_OFFSET else None


def _merged(offset: float, known: list[float]) -> float:
    """An offset already known that agrees with this one up to rounding, or this one."""
    for other in known:
        if abs(offset - other) <= _SAME_OFFSET:
            return other
    known.append(offset)
    return offset


def _segments_of(polygon: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Start and vector of each side of a closed polygon (n, 2) -> (n, 4)."""
    return np.hstack([polygon, np.roll(polygon, -1, axis=0) - polygon])


def _needs_grid(segments: npt.NDArray[np.float64], double: bool) -> bool:
    return any(line.exact for line in _LineBook(segments, double).lines)


def build_tables(
    rings: Sequence[npt.NDArray[np.float64]],
    convex_cover: Sequence[npt.NDArray[np.float64]],
    *,
    double: bool,
) -> Tables:
    """Tables of the polygon with these rings (the polygon to the left) and convex pieces.

    ``double``: for float64 kernels; else for float32 ones, whose grid is coarser.
    """
    frame = frame_of(np.concatenate(list(rings)))
    outlines = [frame.vertices(ring) for ring in rings]
    pieces = [frame.vertices(piece) for piece in convex_cover]
    segments = np.concatenate([_segments_of(p) for p in [*outlines, *pieces]])
    lattice = Lattice.for_precision(double)
    gridded = _needs_grid(segments, double)
    if gridded:
        outlines = [ring for ring in map(lattice.rounded, outlines) if len(ring) > 2]
        joined = with_vertices_on_sides(convex_cover, np.concatenate(list(rings)))
        pieces = [lattice.rounded(frame.vertices(piece)) for piece in joined]
    weighted = signed_convex_pieces(pieces) if gridded else [(p, 1.0) for p in pieces]
    parts = [*outlines, *(piece for piece, _ in weighted)]
    book = _LineBook(np.concatenate([_segments_of(p) for p in parts]), double)
    edge_count = sum(len(ring) for ring in outlines)
    numbers = iter(zip(book.number_of[edge_count:], book.signs[edge_count:], strict=True))
    table_pieces = tuple(
        Piece(tuple(dict.fromkeys((n, int(s)) for n, s in (next(numbers) for _ in p))), w)
        for p, w in weighted
    )
    edges = _edges(outlines, book)
    return Tables(frame, edges, tuple(book.lines), table_pieces, lattice.step if gridded else None)


def _edges(outlines: Sequence[npt.NDArray[np.float64]], book: _LineBook) -> tuple[Edge, ...]:
    waves: dict[tuple[float, float], tuple[float, float]] = {}
    edges = []
    segments = np.concatenate([_segments_of(ring) for ring in outlines]).tolist()
    ends = np.concatenate([np.roll(ring, -1, axis=0) for ring in outlines]).tolist()
    for number, ((ax, ay, ex, ey), (bx, by)) in enumerate(zip(segments, ends, strict=True)):
        sign = float(book.signs[number])
        length = float(np.hypot(ex, ey))
        unit = (sign * ex / length, sign * ey / length)
        # directions equal up to rounding share one float pair, so that nu.direction is shared
        unit = waves.setdefault((round(unit[0], 15), round(unit[1], 15)), unit)
        area = exact_cross(ax, ay, ex, ey)
        line = book.lines[book.number_of[number]]
        edges.append(
            Edge(
                ax, ay, bx, by, ex, ey, area, *unit, sign * length, line.offset, float(line.cluster)
            )
        )
    return tuple(edges)
