"""The constants of a polygon that the kernels are traced with.

A slice of the autocorrelation is the intersection of two copies of the polygon. Its boundary is
made of the true edges of either copy, cut to the parts that lie inside the other, and "inside" is
decided line by line against the convex pieces of the other copy. So a table lists edges, the
supporting lines of edges and pieces (``supporting_lines``), and the pieces as sets of (line, side).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import islice
from operator import attrgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.kernels.outline.frame import Frame, frame_of
from polywigner.kernels.outline.lines import Line, LineBook, linking_angle
from polywigner.kernels.outline.waves import (
    UNIFORM,
    Waves,
    carrier_of,
    common_factor,
    difference_pairs,
    waves_in_frame,
)
from polywigner.numerics.exact import (
    GRID,
    exact_cross,
    rounded,
    signed_convex_pieces,
    with_vertices_on_sides,
)
from polywigner.plans import cut_for, waves_fit_code

# Cost of a further wave on the cut edge, in cuts: 5 to 20 ms to compile.
_CLIPS_PER_WAVE = 24


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
    """Offset of the edge's line."""
    cluster: Any
    """Cluster of the edge's line."""
    real: Any = 1.0
    """The complex weight of the element that the edge bounds."""
    imag: Any = 0.0
    group: Any = 0
    """Number of the weight's field in ``Tables.groups``."""
    line: Any = 0
    """The number of the edge's line, and the side of it on which the polygon lies."""
    side: Any = 1
    begin: Any = 0
    """Numbers of the vertices a and b among all vertices of all rings of all elements."""
    end: Any = 0
    element: Any = 0
    """The number of the element that the edge bounds."""


# `dataclasses.astuple` copies each number deeply: half of the time of a call with one sample.
numbers_of: Callable[[Edge], tuple[Any, ...]] = attrgetter(*(part.name for part in fields(Edge)))
"""The numbers of an edge, as a row of a table."""


@dataclass(frozen=True)
class Piece:
    """A convex piece: (line, side) with side +1 where the piece lies left of the line."""

    sides: tuple[tuple[int, int], ...]
    real: float  # the element's weight; its negative for a triangle turned over by rounding
    imag: float = 0.0
    group: int = 0
    corners: tuple[tuple[float, float], ...] = ()  # counter-clockwise
    element: int = 0
    sign: float = 1.0  # -1 for a triangle turned over by rounding


def cut_of(target: str, tables: Tables, samples: int = 0) -> str:
    """The cut of edges: as planned, or as suits a target; ``samples`` of NumPy at a time."""
    found: str | None = tables.cut
    return found or cut_for(target, tables.clips, tables.fits_pairs, samples)


@dataclass(frozen=True, eq=False)  # by identity: to compare all numbers takes long
class Tables:
    """Everything the kernels need to know of a polygon, in its frame."""

    frame: Frame
    edges: tuple[Edge, ...]
    lines: tuple[Line, ...]
    pieces: tuple[Piece, ...]
    grid: float | None  # spacing to which offsets must be rounded; None if no line needs it
    uniform: bool = True  # all weights are 1
    phased: bool = False  # not all weights are real
    groups: tuple[Waves, ...] = (UNIFORM,)  # the different fields on the elements, less weights
    factors: tuple[complex, ...] = (1.0,)  # of each element: its weight here over the user's
    cut: str | None = None
    """Cut of edges, by `polywigner.plans`; None where nothing has been planned."""
    coherence: Any = None
    """The degree of coherence of light that is partly coherent, by lags of the frame."""
    variants: dict[str, Tables] = field(default_factory=dict, repr=False)
    """Copies of these tables with other cuts, by cut."""
    pairs: dict[Any, Any] = field(default_factory=dict, repr=False)
    """Lists of the pairs of edges that can meet, as engines hold them."""

    @cached_property
    def clips(self) -> int:
        """Number of (edge, side of a piece) pairs: the cost of one slice.

        More than one wave counts as further sides: it is integrated over what is left of each edge.
        """
        more = _CLIPS_PER_WAVE * (self.waves_per_cut - 1)
        return self.cuts + more * len(self.edges) * len(self.pieces)

    @property
    def cuts(self) -> int:
        """Number of (edge, side of a piece) pairs, waves not counted."""
        return len(self.edges) * sum(len(piece.sides) for piece in self.pieces)

    @cached_property
    def waves_per_cut(self) -> int:
        """Number of plane waves that are integrated over a part of an edge."""
        return max(
            sum(len(difference_pairs(one, other)) for other in self.groups) for one in self.groups
        )

    @property
    def fits_pairs(self) -> bool:
        """Whether a kernel that looks up pairs of edges may have code for each pair of waves."""
        return waves_fit_code(len(self.groups) ** 2 * self.waves_per_cut)

    def cut_by(self, cut: str | None) -> Tables:
        """A copy of the tables with edges to be cut in a given way; one object for each way."""
        if cut is None or cut == self.cut:
            return self
        return self.variants.setdefault(cut, replace(self, cut=cut))

    def mutual(self, edge: Edge, piece: Piece) -> tuple[Any, Any]:
        """Weight of the edge's element times the conjugate of the piece's: (real, imag)."""
        if self.uniform:
            return piece.real, 0.0
        if not self.phased:
            return edge.real * piece.real, 0.0
        return (
            edge.real * piece.real + edge.imag * piece.imag,
            edge.imag * piece.real - edge.real * piece.imag,
        )


_Member = tuple[complex, int, complex]


@dataclass(frozen=True)
class Element:
    """A polygon and the field on it, from which tables are built."""

    rings: Sequence[npt.NDArray[np.float64]]
    """The polygon to their left."""
    convex_cover: Sequence[npt.NDArray[np.float64]]
    weight: complex = 1.0
    illumination: Any = None
    """The field that the weight multiplies, an Illumination; None for 1."""


def _segments_of(polygon: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Start and vector of each side of a closed polygon (n, 2) -> (n, 4)."""
    return np.hstack([polygon, np.roll(polygon, -1, axis=0) - polygon])


def build_tables(
    elements: Sequence[Element], *, double: bool, frame: Frame | None = None
) -> Tables:
    """Tables of the elements of a coherent collection, all in one frame and with shared lines.

    ``double``: for float64 kernels; else for float32 ones, whose grid is coarser. ``frame``: by
    default the one that all elements fill together.
    """
    if frame is None:
        frame = frame_of(np.concatenate([ring for element in elements for ring in element.rings]))
    frame = replace(frame, carrier=carrier_of((e.illumination for e in elements), 2))
    groups, members = grouped(elements, frame)
    plain = [_in_frame(element, frame) for element in elements]
    linked = linking_angle([ring for outline in plain for ring in outline.rings], double)
    gridded = LineBook(*_segments_of_all(plain), linked, double).has_exact_lines
    step = GRID[double] if gridded else None
    outlines = plain if step is None else [_on_grid(e, frame, step) for e in elements]
    book = LineBook(*_segments_of_all(outlines), linked, double)
    edges: list[Edge] = []
    pieces: list[Piece] = []
    numbers = iter(zip(book.number_of, book.signs, strict=True))
    waves: dict[tuple[float, float], tuple[float, float]] = {}
    vertices = 0
    for number, (outline, member) in enumerate(zip(outlines, members, strict=True)):
        weight, group, _ = member
        for ring, own in zip(outline.rings, outline.numbers, strict=True):
            edges += _edges(ring, numbers, book, waves, member, (own + vertices, number))
        vertices += sum(len(ring) for ring in elements[number].rings)
        for piece, sign in outline.pieces:
            sides = [(n, int(s)) for n, s in islice(numbers, len(piece))]
            corners = tuple((x, y) for x, y in piece.tolist())
            field = sign * weight.real, sign * weight.imag
            pieces.append(Piece(tuple(dict.fromkeys(sides)), *field, group, corners, number, sign))
    weights = [weight for weight, _, _ in members]
    return Tables(
        frame,
        tuple(edges),
        tuple(book.lines),
        tuple(pieces),
        step,
        uniform=all(weight == 1 for weight in weights),
        phased=any(weight.imag for weight in weights),
        groups=groups,
        factors=tuple(factor for _, _, factor in members),
    )


def grouped(elements: Sequence[Element], frame: Frame) -> tuple[tuple[Waves, ...], list[_Member]]:
    """The different fields on the elements; each element's weight, number of field, and factor."""
    groups: list[Waves] = []
    members = []
    for element in elements:
        waves = waves_in_frame(element.illumination, frame)
        factors = (common_factor(waves, group) for group in groups)
        found = next(((f, k) for k, f in enumerate(factors) if f is not None), None)
        if found is None:
            groups.append(waves)
            found = (1.0, len(groups) - 1)
        members.append((complex(element.weight) * found[0], found[1], complex(found[0])))
    return tuple(groups), members


@dataclass(frozen=True)
class _Outline:
    """An element in the frame: its rings, and convex pieces with signs that add up to it."""

    rings: Sequence[npt.NDArray[np.float64]]
    pieces: Sequence[tuple[npt.NDArray[np.float64], float]]
    numbers: Sequence[npt.NDArray[np.intp]]
    """Numbers of each ring's vertices among all vertices of the element before rounding."""


def _in_frame(element: Element, frame: Frame) -> _Outline:
    rings = [frame.vertices(ring) for ring in element.rings]
    pieces = [(frame.vertices(piece), 1.0) for piece in element.convex_cover]
    return _Outline(rings, pieces, _numbered(element.rings))


def _numbered(rings: Sequence[npt.NDArray[np.float64]]) -> list[npt.NDArray[np.intp]]:
    ends = np.cumsum([len(ring) for ring in rings])
    return [np.arange(end - len(ring), end) for end, ring in zip(ends, rings, strict=True)]


def _on_grid(element: Element, frame: Frame, step: float) -> _Outline:
    points = [rounded(frame.vertices(ring), step) for ring in element.rings]
    vertices = np.concatenate(list(element.rings))
    joined = (with_vertices_on_sides(piece, vertices) for piece in element.convex_cover)
    pieces = signed_convex_pieces([rounded(frame.vertices(piece), step)[0] for piece in joined])
    numbers = zip(_numbered(element.rings), points, strict=True)
    rings = [(ring, own[kept]) for own, (ring, kept) in numbers if len(ring) > 2]
    return _Outline([ring for ring, _ in rings], pieces, [own for _, own in rings])


def _segments_of_all(
    outlines: Sequence[_Outline],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.intp]]:
    """The sides of all rings and pieces, as the book numbers them, and the next of each."""
    polygons = [p for o in outlines for p in (*o.rings, *(piece for piece, _ in o.pieces))]
    numbers = _numbered(polygons)
    after = np.concatenate([np.roll(own, -1) for own in numbers])
    return np.concatenate([_segments_of(polygon) for polygon in polygons]), after


def _edges(
    ring: npt.NDArray[np.float64],
    numbers: Iterator[tuple[int, int]],
    book: LineBook,
    waves: dict[tuple[float, float], tuple[float, float]],
    member: _Member,
    names: tuple[npt.NDArray[np.intp], int],
) -> Iterator[Edge]:
    """``names``: the numbers of the ring's vertices and of the element."""
    weight, group, _ = member
    first, element = names[0].tolist(), names[1]
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
            number, int(sign), first[k], first[(k + 1) % len(first)], element,
        )  # fmt: skip
