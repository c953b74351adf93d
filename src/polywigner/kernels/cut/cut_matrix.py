"""All edges of one copy of an outline cut by all lines of the other, as matrices of NumPy.

What `clipping` does edge by edge and piece by piece, done for every edge,
side and place of a block at once: the same cuts and the same decisions, in a few dozen calls of
NumPy whatever the number of edges.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.kernels.cut.clipping import AHEAD, RowClipper, View
from polywigner.kernels.outline.lines import Line
from polywigner.kernels.outline.tables import Edge, Piece, Tables, numbers_of

__all__ = ["CutMatrix", "EdgeParts"]

# What rounding may part two pieces of a cut edge by, as a fraction of it.
_ADJOINING = 1e-13
# Pairs of an edge and a piece, or a side of those near it, at a time: temporary arrays of 2 MB.
_BLOCK = 1 << 18
# Pieces near an edge, about.
_NEAR = 3
# Boxes reach further by this, in the frame: no rounding may part what touches.
_MARGIN = 1e-9

_LINE_COLUMNS = attrgetter(*(field.name for field in fields(Line)))

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]


@dataclass(frozen=True)
class EdgeParts:
    """Parts (k,) of edges inside the other copy, those in adjoining pieces as one."""

    edge: Edge
    """The edge of each: arrays (k,)."""
    place: Numbers
    """The number of the place that each belongs to."""
    low: Floats
    high: Floats
    """From and to where on the edge, as fractions of it."""
    real: Any
    imag: Any
    """The mutual field there."""


class CutMatrix:
    """Cuts for vectors T = 2x or xi, (n,) each, of NumPy in double precision."""

    def __init__(self, ops: Any, tables: Tables, tx: Floats, ty: Floats) -> None:
        self.ops, self.tables = ops, tables
        clipper = RowClipper(ops, tables, tx, ty)  # puts them on the grid of the tables
        self.tx, self.ty = clipper.tx, clipper.ty

    def parts(self, view: View, group: int, other: int) -> Iterator[EdgeParts]:
        """The parts of one group's edges inside another's pieces, block by block of places."""
        columns = _edges_of(self.tables, group)
        for weight, pieces in _pieces_of(self.tables, other):
            sides = pieces.count.mean() * min(len(pieces.count), _NEAR)
            step = max(1, int(_BLOCK / max(1, len(columns) * max(len(pieces.count), sides))))
            for start in range(0, len(self.tx), step):
                places = slice(start, start + step)
                e, place, low, high = self._joined(columns, pieces, view, places)
                edge = Edge(*columns[e].T)
                real, imag = self.tables.mutual(edge, Piece((), *weight))
                yield EdgeParts(
                    edge, place + start, low, high, real, -imag if view is AHEAD else imag
                )

    def _joined(
        self, columns: Floats, pieces: _Pieces, view: View, places: slice
    ) -> tuple[Numbers, Numbers, Floats, Floats]:
        """(edge, place, from, to) of what is left of edges."""
        edge, piece, place = self._candidates(columns, pieces, view, places)
        low, high = self._intervals(columns, pieces, view, (edge, piece, place + places.start))
        (left,) = np.nonzero(high > low)
        left = left[np.lexsort((low[left], place[left], edge[left]))]
        edge, place, low, high = edge[left], place[left], low[left], high[left]
        goes_on = (edge[1:] == edge[:-1]) & (place[1:] == place[:-1])
        goes_on &= np.abs(low[1:] - high[:-1]) <= _ADJOINING
        first = np.append(True, ~goes_on)[: len(low)]
        last = np.append(~goes_on, True)[-len(low) :] if len(low) else first
        return edge[first], place[first], low[first], high[last]

    def _candidates(
        self, columns: Floats, pieces: _Pieces, view: View, places: slice
    ) -> tuple[Numbers, Numbers, Numbers]:
        """(edge, piece, place) wherever the boxes of the two meet."""
        near: Any = True
        edge = Edge(*columns.T[..., None, None])
        starts, vectors = (edge.ax, edge.ay), (edge.ex, edge.ey)
        for axis, offset in enumerate((self.tx[places], self.ty[places])):
            middle = view.point * (starts[axis] + 0.5 * vectors[axis])
            reach = 0.5 * abs(vectors[axis]) + pieces.half[:, axis, None] + _MARGIN
            away = (middle - pieces.middle[:, axis, None]) + view.offset * offset
            near = near & (abs(away) <= reach)
        e, piece, place = np.nonzero(near)
        return e, piece, place

    def _intervals(
        self,
        columns: Floats,
        pieces: _Pieces,
        view: View,
        candidates: tuple[Numbers, Numbers, Numbers],
    ) -> tuple[Floats, Floats]:
        """From and to where edges are inside pieces at places."""
        edge, _, place = candidates
        low, high = np.zeros(len(edge)), np.ones(len(edge))
        if not len(edge):
            return low, high
        owner, side = self._crossed(columns, pieces, view, candidates)
        if not len(owner):
            return low, high
        cut, rising = self._cuts(columns[edge[owner]], pieces.lines[side], view, place[owner])
        begins = rising == pieces.left[side]
        far = RowClipper.FAR
        first = np.flatnonzero(np.append(True, owner[1:] != owner[:-1]))
        owner = owner[first]
        low[owner] = np.maximum.reduceat(np.where(begins, cut, -far), first).clip(min=0.0)
        high[owner] = np.minimum.reduceat(np.where(begins, far, cut), first).clip(max=1.0)
        return low, high

    def _crossed(
        self,
        columns: Floats,
        pieces: _Pieces,
        view: View,
        candidates: tuple[Numbers, Numbers, Numbers],
    ) -> tuple[Numbers, Numbers]:
        """(candidate, side) wherever rounding leaves open that an edge lies inside a side.

        Most edges have both ends well inside of most sides, which is told by two products; where
        an edge has both well outside of one, that side alone stands for all.
        """
        edge, piece, place = candidates
        own = Edge(*columns[edge].T)
        moved = [
            view.point * start + view.offset * offset[place]
            for start, offset in ((own.ax, self.tx), (own.ay, self.ty))
        ]
        count = pieces.count[piece]
        owner = np.repeat(np.arange(len(edge)), count)
        first = np.cumsum(count) - count
        side = np.arange(len(owner)) + (pieces.first[piece] - first)[owner]
        x, y, ex, ey = (
            np.repeat(value, count) for value in (*moved, view.point * own.ex, view.point * own.ey)
        )
        dx, dy, offset = (column[side] for column in pieces.inward)
        start = dx * y - dy * x - offset
        end = start + (dx * ey - dy * ex)
        crossed = ~(np.minimum(start, end) > _MARGIN)
        outside = np.maximum(start, end) < -_MARGIN
        hidden = np.logical_or.reduceat(outside, first)
        (kept,) = np.nonzero(crossed & (outside | ~hidden[owner]))
        return owner[kept], side[kept]

    def _cuts(
        self, columns: Floats, lines: Floats, view: View, place: Numbers
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Where edges meet lines, and whether they enter the left side there; row by row."""
        cut, rising = np.empty(len(lines)), np.empty(len(lines), np.bool_)
        is_exact = lines[:, 4] > 0.0
        for exact in (False, True):
            (mine,) = np.nonzero(is_exact == exact)
            if len(mine):
                dx, dy, offset, cluster, _, px, py = lines[mine].T
                clipper = RowClipper(
                    self.ops, self.tables, self.tx[place[mine]], self.ty[place[mine]]
                )
                line = Line(dx, dy, offset, cluster, exact, px, py)
                cut[mine], rising[mine] = clipper.row_cut(Edge(*columns[mine].T), line, view)
        return cut, rising


@lru_cache(maxsize=64)
def _edges_of(tables: Tables, group: int) -> Floats:
    """(n, columns of an Edge) the edges of the elements with one field."""
    rows = [numbers_of(edge) for edge in tables.edges if edge.group == group]
    return np.array(rows, np.float64).reshape(len(rows), -1)


@lru_cache(maxsize=64)
def _pieces_of(tables: Tables, group: int) -> list[tuple[tuple[float, float], _Pieces]]:
    """The pieces of the elements with one field, by weight."""
    pieces: dict[tuple[float, float], list[Piece]] = {}
    for piece in tables.pieces:
        if piece.group == group:
            pieces.setdefault((piece.real, piece.imag), []).append(piece)
    return [(weight, _Pieces(mine, tables)) for weight, mine in pieces.items()]


class _Pieces:
    """The sides of convex pieces, one after the other, and their boxes."""

    def __init__(self, pieces: list[Piece], tables: Tables) -> None:
        sides = [side for piece in pieces for side in piece.sides]
        self.lines = np.array([_LINE_COLUMNS(tables.lines[n]) for n, _ in sides], np.float64)
        """(s, 7) the line of each side."""
        self.left = np.array([side > 0 for _, side in sides])
        """(s,) whether the piece lies to the left of it."""
        signs = np.where(self.left, 1.0, -1.0)
        self.inward = tuple(np.ascontiguousarray(column * signs) for column in self.lines.T[:3])
        """Direction and offset (s,) of each line, turned so that the piece lies to its left."""
        self.count = np.array([len(piece.sides) for piece in pieces])
        self.first = np.cumsum(self.count) - self.count
        """(p,) the first side of each piece."""
        low = np.array([np.min(piece.corners, axis=0) for piece in pieces])
        high = np.array([np.max(piece.corners, axis=0) for piece in pieces])
        self.middle, self.half = (low + high) / 2, (high - low) / 2
        """(p, 2) of the boxes around pieces."""
