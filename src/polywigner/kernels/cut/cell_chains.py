"""The sides that an edge meets in a cell, as the bounds of convex sets.

docs/theory.md, (K1): sides that follow each other form chains, and the field of the other copy is
a sum over the parts of these chains that turn one way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from polywigner.kernels.cut.cell_edges import OutlineEdges
from polywigner.kernels.cut.cell_tree import Cells

__all__ = ["Chains", "with_sides_beyond"]

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Numbers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

# What lies to the left of sides that turn left by half a turn at most, the first and the last
# prolonged, is what lies to the left of each. A little more, and the two meet far outside.
_HALF_TURN = np.pi + 1e-9


class Chains:
    """The sides that each edge meets in each cell, as the bounds of convex sets.

    Neighbours are a chain, and the chain's jump of the field is the sum of those of its parts that
    turn one way, with their ends prolonged, less that of the line of each side that two such parts
    have in common. A part bounds a convex set: to its left, or if it turns to the right, to its
    right, where its weight counts negative.
    """

    key: Numbers
    """(g,) cell * n + edge of each edge that meets any side, ascending."""
    sets: Numbers
    """(g + 1,) the first set of each."""
    owner: Numbers
    """(c,) which edge in which cell each set is for."""
    first: Numbers
    """(c,) the first row of each set, and the end of its rows."""
    end: Numbers
    side: Numbers
    """(r,) the side of each row."""
    weight: Complexes
    """(c,) the field inside of a set."""
    right: Flags
    """(c,) whether a set lies to the right of its sides."""

    def __init__(self, edges: OutlineEdges, cells: Cells, sign: int, turn: Floats) -> None:
        key, self.side, chain, whole = _neighbours(edges, cells)
        new_key = np.append(True, key[1:] != key[:-1])[: len(key)]
        self.key = key[new_key]
        starts = np.append(True, chain[1:] != chain[:-1])[: len(chain)]
        ends = np.append(starts[1:], True)[: len(chain)]
        # a part is known by its first row, and the last
        first, last, right = self._one_way(edges, starts)
        before = ~starts[first]
        after = ~ends[last]
        # R, whose ends are common with others: the two half-planes, less what they have in common
        folded = right & (last == first + 1) & (before | after)
        own = key[last] // len(edges), key[last] % len(edges)
        track, corner = edges.segments.turned(turn), edges.start[self.side[last]] @ turn.T
        half = track.half[own[1]]
        seen = cells.meet(own[0], corner - sign * track.middle[own[1]], half, 0 * half)
        # the lines of common sides, one less for each, and one more for each half-plane
        joint = np.flatnonzero(before)
        extra = folded[joint].astype(int) + folded[joint - 1] - 1
        lines = [(first[joint], extra), (np.flatnonzero(starts & ends), 1)]
        lines += [(first[folded & ~before], 1), (last[folded & ~after], 1)]
        # of a whole ring, the first side is the last as well
        lines.append((np.flatnonzero(starts & whole[chain]), -1))
        kept = seen | ~folded
        line = np.concatenate([rows for rows, _ in lines])
        times = np.concatenate([np.broadcast_to(sign_, len(rows)) for rows, sign_ in lines])
        line, times = line[times != 0], times[times != 0]
        first, end = np.append(first[kept], line), np.append(last[kept], line) + 1
        times = np.append(np.where(right[kept], -1, 1), times)
        right = np.append((right & ~folded)[kept], np.zeros(len(line), np.bool_))
        owner = (np.cumsum(new_key) - 1)[first]
        order = np.argsort(owner, kind="stable")
        self.first, self.end, self.owner = first[order], end[order], owner[order]
        self.right = right[order]
        self.weight = times[order] * edges.weight[self.side[self.first]]
        self.sets = np.searchsorted(self.owner, np.arange(len(self.key) + 1))

    def _one_way(self, edges: OutlineEdges, starts: Flags) -> tuple[Numbers, Numbers, Flags]:
        """First and last row of each part of a chain that turns one way, and whether right."""
        # a vertex is known by the row of the side after it
        (vertex,) = np.nonzero(~starts)
        turn = edges.turns[self.side[vertex]]
        right = _filled(np.sign(turn)) < 0
        goes_on = (vertex[1:] == vertex[:-1] + 1) & (right[1:] == right[:-1])
        begins = _up_to(np.cumsum(np.abs(turn)), np.append(True, ~goes_on)[: len(vertex)])
        ends = np.append(begins[1:], True)[: len(vertex)]
        return vertex[begins] - 1, vertex[ends], right[begins]


def with_sides_beyond(edges: OutlineEdges, cells: Cells, sign: int, turn: Floats) -> Cells:
    """Cells that list the next side as well wherever a listed one ends on the track.

    A side that ends at the rim of a track may be found there, by rounding, and the next one not.
    Its prolongation would cut the track where the outline has turned off. Tracks are a little
    wider here than where sides were found: of those that end beyond, nothing comes back.
    """
    n, corner = len(edges), edges.start @ turn.T
    middle = edges.segments.turned(turn).middle
    half = edges.segments.turned(turn).half
    key, side = cells.cell.astype(np.int64) * n + cells.edge, cells.side.astype(np.int64)
    listed = key * n + side  # ascending
    new = listed
    while len(new):
        found = []
        for beyond, forward in ((edges.next, True), (edges.before, False)):
            key, side = new // n, new % n
            other = beyond[side]
            wanted = key * n + other
            missing = listed[np.searchsorted(listed, wanted) % len(listed)] != wanted
            key, side, wanted = key[missing], side[missing], wanted[missing]
            vertex = corner[other[missing] if forward else side]
            cell, edge = key // n, key % n
            h = half[edge]
            seen = cells.meet(cell, vertex - sign * middle[edge], h, np.zeros_like(h))
            found.append(wanted[seen])
        new = _distinct(np.concatenate(found))
        listed = np.insert(listed, np.searchsorted(listed, new), new)
    key, side = listed // n, listed % n
    return replace(cells, cell=key // n, edge=key % n, side=side)


def _distinct(numbers: Numbers) -> Numbers:
    """The different numbers, ascending: by sorting, which is faster here than NumPy's hashing."""
    ordered = np.sort(numbers)
    return ordered[np.append(True, ordered[1:] != ordered[:-1])[: len(ordered)]]


def _neighbours(edges: OutlineEdges, cells: Cells) -> tuple[Numbers, Numbers, Numbers, Flags]:
    """Key, side, and number of the chain of each row; whether a chain is a whole ring.

    Chains are in one piece, in their order; a whole ring ends with the side it begins with.
    """
    n = len(edges)
    key, side = cells.cell.astype(np.int64) * n + cells.edge, cells.side
    ring = np.repeat(np.arange(len(edges.rings) - 1), np.diff(edges.rings))
    follows = (key[1:] == key[:-1]) & (side[1:] == side[:-1] + 1)
    follows &= ring[side[1:]] == ring[side[:-1]]
    label = np.cumsum(np.append(True, ~follows)[: len(key)]) - 1
    # a chain that reaches the last side of a ring goes on at the first
    pair = key * len(edges.rings) + ring[side]
    (at_first,) = np.nonzero(np.isin(side, edges.rings[:-1]))
    (at_last,) = np.nonzero(np.isin(side, edges.rings[1:] - 1))
    _, first, last = np.intersect1d(pair[at_first], pair[at_last], return_indices=True)
    own = np.arange(label[-1] + 1 if len(label) else 0)
    own[label[at_first[first]]] = label[at_last[last]]
    moved = label != own[label]
    order = np.lexsort((np.arange(len(label)), moved, own[label], key))
    key, side, chain = key[order], side[order], own[label][order]
    size = np.bincount(chain)
    starts = np.flatnonzero(np.append(True, chain[1:] != chain[:-1])[: len(chain)])
    first = np.zeros(len(size), np.int64)
    first[chain[starts]] = starts
    whole = size == np.diff(edges.rings)[ring[side[first]]] if len(side) else size > 0
    (again,) = np.nonzero(whole[chain[starts]])
    ends = np.append(starts[1:], len(chain))[again]
    key, side, chain = (np.insert(a, ends, a[starts[again]]) for a in (key, side, chain))
    return key, side, chain, whole


def _up_to(angle: Floats, begins: Flags) -> Flags:
    """Where parts begin that turn by half a turn at most, as many vertices in each as can be.

    ``angle``: all that is turned up to each vertex; ``begins``: where a part has to.
    """
    result = begins.copy()
    (first,) = np.nonzero(begins)
    last = np.append(first[1:], len(begins))
    turned = np.append(0.0, angle)
    while len(first):
        first = np.searchsorted(angle, turned[first] + _HALF_TURN, side="right")
        inside = first < last
        first, last = first[inside], last[inside]
        result[first] = True
    return result


def _filled(signs: Floats) -> Floats:
    """Signs, with that of the one before where there is none, for which either is right."""
    known = np.maximum.accumulate(np.where(signs != 0, np.arange(len(signs)), 0))
    return signs[known] if len(signs) else signs
