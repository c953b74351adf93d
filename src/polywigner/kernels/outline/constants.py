"""Edges, lines and convex pieces of outlines as constants of compiled code.

A slice of the autocorrelation is the intersection of two copies of the outline. Its boundary
consists of the true edges of either copy, cut to the parts inside the other copy. "Inside" is
decided line by line against the convex pieces of the other copy.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.geometry import Aperture
from polywigner.kernels.outline.frame import Frame
from polywigner.kernels.outline.lines import Line, LineBook, linking_angle
from polywigner.numerics.exact import (
    GRID,
    exact_cross,
    rounded,
    signed_convex_pieces,
    with_vertices_on_sides,
)

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Edge:
    """A true boundary edge from a to b = a + e, the polygon to its left."""

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
    """Offset of the edge's line."""
    cluster: Any
    """Cluster of the edge's line."""
    real: Any = 1.0
    """The complex weight of the element that the edge bounds."""
    imag: Any = 0.0
    group: Any = 0
    """Number of the weight's field in ``Tables.groups``."""
    begin: Any = 0
    """Numbers of the vertices a and b among all vertices of all rings of all elements."""
    end: Any = 0


@dataclass(frozen=True)
class Piece:
    """A convex piece: (line, side) with side +1 where the piece lies left of the line."""

    sides: tuple[tuple[int, int], ...]
    real: float
    """The element's weight; its negative for a triangle turned over by rounding."""
    imag: float = 0.0
    group: int = 0


@dataclass(frozen=True)
class Constants:
    """Edges, lines and convex pieces of all elements."""

    edges: tuple[Edge, ...]
    lines: tuple[Line, ...]
    pieces: tuple[Piece, ...]
    grid: float | None
    """Spacing to which offsets must be rounded; None if no line needs it."""


def constants_of(tables: Any) -> Constants:
    """Return the constants of tables, all elements with shared lines."""
    frame, double = tables.frame, tables.double
    group_of = dict(zip(tables.names[:, 2].tolist(), tables.names[:, 3].tolist(), strict=True))
    plain = [_in_frame(aperture, frame) for aperture in tables.apertures]
    linked = linking_angle([ring for outline in plain for ring in outline.rings], double)
    gridded = LineBook(*_segments_of_all(plain), linked, double).has_exact_lines
    step = GRID[double] if gridded else None
    outlines = plain if step is None else [_on_grid(a, frame, step) for a in tables.apertures]
    book = LineBook(*_segments_of_all(outlines), linked, double)
    edges: list[Edge] = []
    pieces: list[Piece] = []
    numbers = iter(zip(book.number_of, book.signs, strict=True))
    waves: dict[tuple[float, float], tuple[float, float]] = {}
    first = 0
    for number, (outline, weight) in enumerate(zip(outlines, tables.weights, strict=True)):
        group = group_of[number]
        for ring, own in zip(outline.rings, outline.numbers, strict=True):
            edges += _edges(ring, numbers, book, waves, complex(weight), (own + first, group))
        first += sum(len(ring) for ring in tables.apertures[number].rings)
        for piece, sign in outline.pieces:
            sides = dict.fromkeys((n, int(s)) for n, s in islice(numbers, len(piece)))
            real, imag = sign * weight.real, sign * weight.imag
            pieces.append(Piece(tuple(sides), real, imag, group))
    return Constants(tuple(edges), tuple(book.lines), tuple(pieces), step)


@dataclass(frozen=True)
class _Outline:
    """An element in the frame: its rings, and convex pieces with signs that add up to it."""

    rings: Sequence[Floats]
    pieces: Sequence[tuple[Floats, float]]
    numbers: Sequence[npt.NDArray[np.intp]]
    """Numbers of each ring's vertices among all vertices of the element before rounding."""


def _in_frame(aperture: Aperture, frame: Frame) -> _Outline:
    rings = [frame.vertices(ring) for ring in aperture.rings]
    pieces = [(frame.vertices(piece), 1.0) for piece in aperture.convex_cover]
    return _Outline(rings, pieces, _numbered(aperture.rings))


def _numbered(rings: Sequence[Floats]) -> list[npt.NDArray[np.intp]]:
    ends = np.cumsum([len(ring) for ring in rings])
    return [np.arange(end - len(ring), end) for end, ring in zip(ends, rings, strict=True)]


def _on_grid(aperture: Aperture, frame: Frame, step: float) -> _Outline:
    points = [rounded(frame.vertices(ring), step) for ring in aperture.rings]
    vertices = np.concatenate(list(aperture.rings))
    joined = (with_vertices_on_sides(piece, vertices) for piece in aperture.convex_cover)
    pieces = signed_convex_pieces([rounded(frame.vertices(piece), step)[0] for piece in joined])
    numbers = zip(_numbered(aperture.rings), points, strict=True)
    rings = [(ring, own[kept]) for own, (ring, kept) in numbers if len(ring) > 2]
    return _Outline([ring for ring, _ in rings], pieces, [own for _, own in rings])


def _segments_of(polygon: Floats) -> Floats:
    """Return start and vector of each side of a closed polygon (n, 2), (n, 4)."""
    return np.hstack([polygon, np.roll(polygon, -1, axis=0) - polygon])


def _segments_of_all(outlines: Sequence[_Outline]) -> tuple[Floats, npt.NDArray[np.intp]]:
    """Return the sides of all rings and pieces, as the book numbers them, and the next of each."""
    polygons = [p for o in outlines for p in (*o.rings, *(piece for piece, _ in o.pieces))]
    numbers = _numbered(polygons)
    after = np.concatenate([np.roll(own, -1) for own in numbers])
    return np.concatenate([_segments_of(polygon) for polygon in polygons]), after


def _edges(
    ring: Floats,
    numbers: Iterator[tuple[int, int]],
    book: LineBook,
    waves: dict[tuple[float, float], tuple[float, float]],
    weight: complex,
    names: tuple[npt.NDArray[np.intp], int],
) -> Iterator[Edge]:
    """``names``: the numbers of the ring's vertices, and the group of its element."""
    first, group = names[0].tolist(), names[1]
    ends = np.roll(ring, -1, axis=0).tolist()
    for k, ((ax, ay, ex, ey), (bx, by)) in enumerate(
        zip(_segments_of(ring).tolist(), ends, strict=True)
    ):
        number, sign = next(numbers)
        length = float(np.hypot(ex, ey))
        unit = (sign * ex / length, sign * ey / length)
        # directions equal up to rounding share one float pair, so that nu.direction is shared
        ux, uy = waves.setdefault((round(unit[0], 15), round(unit[1], 15)), unit)
        area, line = exact_cross(ax, ay, ex, ey), book.lines[number]
        yield Edge(
            ax, ay, bx, by, ex, ey, area, ux, uy,
            sign * length, line.offset, float(line.cluster), weight.real, weight.imag, group,
            first[k], first[(k + 1) % len(first)],
        )  # fmt: skip
