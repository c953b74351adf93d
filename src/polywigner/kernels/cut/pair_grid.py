"""Edge pairs that can cross, for two copies of an outline, and edge clipping with NumPy.

The second copy is mirrored: the offset T maps a point p to T - p. Two edges cross if T lies in a
parallelogram whose sides are the edges. The plane of offsets is divided into square cells, each
with a list of edge pairs, (K1) of docs/theory/edges.md.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.kernels.outline import Tables
from polywigner.numerics import Number
from polywigner.numerics.grid_arithmetic import accurate_cross

# Kinds of rows. CROSSING: two edges that cross. START: a crossing before which the winding number
# is set. WHOLE: an unclipped edge. INSIDE: an edge inside the other copy of the outline (START and
# WHOLE). LEAD: a crossing with the line from outside to the first vertex of a ring. CLIPPED: an
# edge that crosses sides of a convex ring. START is bit 0, WHOLE bit 1.
CROSSING, START, WHOLE, INSIDE, LEAD, CLIPPED = range(6)
# Upper bound on the rounding error of a cross product of vectors in the frame.
ROUNDED = 1e-13
# Normal floating-point number below the magnitudes of all nonzero cross products on the grid. These
# magnitudes are at least 2^-106 in double precision and 2^-48 in single precision.
NO_LEVEL = 1e-35

Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Outline:
    """Elements with the same field; their vertices lie on a grid.

    On the grid, sums and differences of an offset and two vertices are exact, (K2) of
    docs/theory/edges.md.
    """

    step: float
    """Spacing of the grid, a power of two."""
    edges: Array
    """For each edge: start, end, 0, complex weight, and 0. The polygon lies to the left of its
    edges. Shape (n, 8)."""
    starts: Array
    """Index of the first edge of each ring, followed by the number of edges."""
    names: Array
    """For each edge: indices of the start vertex, the end vertex and the element, and 0. Shape (n,
    4)."""

    @property
    def vertices(self) -> Array:
        """Start points of the edges, shape (n, 2)."""
        return self.edges[:, :2]

    @property
    def following(self) -> Array:
        """Index of the next edge along the ring, for each edge."""
        following = np.arange(1, len(self.edges) + 1)
        following[self.starts[1:] - 1] = self.starts[:-1]
        return following

    @cached_property
    def is_convex(self) -> bool:
        """Whether each ring is a convex polygon without holes."""
        vectors = self.edges[:, 2:4] - self.vertices
        (ex, ey), (fx, fy) = vectors.T, vectors[self.following].T
        turns = accurate_cross(ex, ey, fx, fy)
        angles = np.arctan2(turns, ex * fx + ey * fy)
        # All turns of a convex polygon are to the left, and the turns add up to a single full turn.
        # The turns of a ring that the grid reduces to a point add up to 0.
        once = abs(np.add.reduceat(angles, self.starts[:-1]) - 2.0 * np.pi) < np.pi
        return bool((turns >= 0.0).all() and once.all())

    @cached_property
    def rotated(self) -> Outline:
        """The outline rotated by 180 degrees about the centre of its frame."""
        return replace(self, edges=self.edges * np.repeat([-1.0, 1.0], 4))


@lru_cache(maxsize=128)
def outline_of(tables: Tables, group: int, double: bool) -> Outline:
    """Return the edges of the elements with the same field, with vertices on a grid."""
    in_group = tables.names[:, 3] == group
    names = np.zeros((int(in_group.sum()), 4), np.uint32)
    names[:, :3] = tables.names[in_group, :3]
    starts = np.flatnonzero(np.append(True, names[1:, 0] != names[:-1, 1])[: len(names)])
    vertices, weights = tables.edges[in_group, :2], tables.edges[in_group, 4:]
    step = tables.frame.grid_step(double)
    edges = np.zeros((len(vertices), 8))
    edges[:, :2] = np.rint(vertices / step) * step
    outline = Outline(step, edges, np.append(starts, len(edges)), names)
    edges[:, 2:4] = edges[outline.following, :2]
    edges[:, 5:7] = weights
    return outline


@dataclass(frozen=True, eq=False)
class PairGrid:
    """Edges and edge pairs of each cell, as NumPy or Dr.Jit tables."""

    numbers: Any
    """Lower and upper corner of the cells, cells per unit length, cells in a row, number of cells,
    and spacing of the grid. Shape (1, 8)."""
    cells: Any
    """First row of each cell, first row that is not INSIDE, end of the rows, and 0. The last cell
    is empty and covers all offsets outside the grid. Shape (number of cells + 1, 4)."""
    rows: Any
    """Edge of the first outline, edge of the second outline, kind, and index of the level, for each
    row. Shape (k, 4)."""
    first: Any
    """For each edge of the first outline: start, vector, 0, complex weight, and 0. The last rows
    are the lines to the rings, with a weight of 1. Shape (n, 8)."""
    second: Any
    """Edges of the second outline, in the form of ``first``. The last edge crosses no other
    edge."""
    names: Any
    """``Outline.names`` of the first outline."""
    levels: Any
    """Real and imaginary part of each weighted winding number, and two zeros. Shape (k, 4)."""

    sides: Any
    """Sides that clip the edges in a :class:`ClipGrid`, otherwise an empty table."""

    @cached_property
    def copies(self) -> dict[Hashable, Any]:
        """Copies of the tables on devices, with the engine as the key."""
        return {}

    @cached_property
    def cell_map(self) -> CellMap:
        """The cells in the layout that :func:`rows_at` requires."""
        low_x, low_y, _, _, per_unit, across, count, step = self.numbers[0].tolist()
        nx, ny = round(across), round(count / across)
        spans = np.zeros((ny + 2, nx + 2, 2), np.intp)
        spans[1:-1, 1:-1] = self.cells[:-1, (2, 0)].reshape(ny, nx, 2)
        spans[..., 1] = spans[..., 0] - spans[..., 1]
        low, counts = np.array([[low_x], [low_y]]), np.array([[nx], [ny]], np.float64)
        return CellMap(low, per_unit, counts, step, spans.reshape(-1, 2))

    @cached_property
    def pair_rows(self) -> PairRows:
        """The rows in the layout that :func:`cut_edges` requires."""
        number, other, kind, level = self.rows.T
        edges = np.concatenate([self.first, self.second])
        starts, vectors, weights = (edges[:, k] + 1j * edges[:, k + 1] for k in (0, 2, 5))
        falls = (vectors.imag < 0.0) | ((vectors.imag == 0.0) & (vectors.real < 0.0))
        pair = np.stack([number, other + np.uint32(len(self.first))])
        (ex, ey), (fx, fy) = (edges[index, 2:4].T for index in pair)
        cross = ex * fy - ey * fx
        near = abs(cross) < _SLANTED * abs(vectors)[pair].prod(axis=0)
        cross[near] = accurate_cross(ex[near], ey[near], fx[near], fy[near])
        index = np.arange(len(number))
        first = np.maximum.accumulate(np.where(kind & START, index, 0))
        levels = self.levels[:, 0] + 1j * self.levels[:, 1]
        is_complex = levels.imag.any() or weights.imag.any()
        return PairRows(
            np.stack([*pair, kind, level.take(first), index - first]).astype(np.uint32),
            np.stack([cross, np.where(near, abs(cross), 0.0) + ROUNDED]),
            np.stack([starts, vectors, np.where(falls, -NO_LEVEL, 0.0), weights], axis=-1),
            levels if is_complex else levels.real,
            bool((weights == 1.0).all()),
        )

    @property
    def nbytes(self) -> int:
        """Size of the NumPy tables in bytes."""
        return sum(getattr(self, part.name).nbytes for part in fields(self))

    def on_device(self, send: Callable[[Array], Any]) -> PairGrid:
        """Return the tables in the memory of an engine. ``send`` copies a single table."""
        tables = {f.name: getattr(self, f.name) for f in fields(self)}
        # Dr.Jit cannot read from empty arrays.
        return replace(self, **{k: send(v if len(v) else _NONE) for k, v in tables.items()})


_NONE = np.zeros((1, 4), np.uint32)


class ClipGrid(PairGrid):
    """Lists of edges to clip, if each ring of the second outline is convex.

    Each row of ``rows`` describes a part of an edge inside one ring: the edge, the first row and
    the end of its rows in ``sides``, and the index of the ring's weight. The part lies to the left
    of all these sides. Each row of ``sides`` is the index of an edge of the second outline. An edge
    that lies inside rings for all offsets in the cell has no sides. The level of such an edge is a
    sum over these rings.
    """


@dataclass(frozen=True, eq=False)
class CellMap:
    """Cells of a :class:`PairGrid` for NumPy, with a border of empty cells."""

    low: Array
    """Lower left corner of the cells without the border, shape (2, 1)."""
    per_unit: float
    counts: Array
    """Number of cells along x and along y without the border, shape (2, 1)."""
    step: float
    spans: Array
    """End of the rows of each cell, and number of these rows. Shape (n, 2)."""

    def at(self, offsets: Array) -> Array:
        """Return the indices in ``spans`` of the cells that contain offsets, shape (2, n).

        Offsets outside the grid, and NaN, belong to empty cells.
        """
        cell = np.floor((offsets - self.low) * self.per_unit)
        column, row = np.fmin(np.fmax(cell, -1.0), self.counts)
        across = self.counts.item(0) + 2.0
        return np.asarray(row * across + (column + (across + 1.0))).astype(np.intp)


@dataclass(frozen=True, eq=False)
class PairRows:
    """Rows of a :class:`PairGrid` for NumPy, with points as complex numbers."""

    rows: Array
    """First edge, second edge and kind of each row, level at the last START row, and number of rows
    since that row. Edges and levels are indices. Shape (5, n)."""
    crosses: Array
    """Cross product of both edges of each row, and bound below which the sign of other cross
    products is not reliable. Shape (2, n)."""
    edges: Array
    """Start, vector, tie limit and weight of each edge of both outlines. Shape (k, 4)."""
    levels: Array
    is_uniform: bool
    """Whether all weights are 1."""


# The weight of an edge is the level times the first factor plus the jump times the second factor.
# The columns are the kinds of rows on the host.
_FACTORS = np.array([[0.0, 0.0, 1.0, 1.0, 0.0], [1.0, 1.0, 0.0, 0.0, 0.0]])
# Sine of the angle between two edges below which their intersection needs exact cross products.
_SLANTED = 1 / 16


def rows_at(cells: CellMap, t: Array) -> tuple[Array, Array]:
    """Return the rows (k,) of the cells at offsets ``t`` (n,), and each row's offset index (k,)."""
    ends, counts = cells.spans.take(cells.at(t.view(np.float64).reshape(-1, 2).T), axis=0).T
    owner = np.arange(len(t)).repeat(counts)
    return np.arange(len(owner)) + (ends - counts.cumsum()).take(owner), owner


def cut_edges(
    pairs: PairRows, row: Array, owner: Array, t: Array, side: float
) -> tuple[Array, Array, Array, Array]:
    """Return the parts of edges between a crossing and the end of the edge, for each offset.

    Parameters
    ----------
    row, owner : ndarray
        Rows, and the index of the offset for each row, as returned by `rows_at`.
    t : ndarray, shape (n,)
        Complex offsets on the grid.
    side : float
        1 or -1, the sign of the infinitesimal displacement of the offset that decides ties.

    Returns
    -------
    owner : ndarray, shape (k,)
        Index of the offset (ascending).
    end, vector : ndarray, shape (k,)
        End and vector of the part, as complex numbers.
    weight : ndarray, shape (k,)
        Weight of the edge times the conjugate of the level or of its change at the crossing.
    """
    table, (cross, bound) = pairs.rows.take(row, axis=1), pairs.crosses.take(row, axis=1)
    edge, other_edge = both = pairs.edges.take(table[:2], axis=0)
    p, vectors = t.take(owner) - other_edge[:, 0] - edge[:, 0], both[..., 1]
    # The sign of the cross product specifies on which side of one edge an end of the other edge
    # lies.
    levels = np.empty((2, *vectors.shape))
    levels[0] = (vectors.conj() * p).imag
    np.subtract(levels[0, 0], cross, out=levels[1, 0])
    np.add(levels[0, 1], cross, out=levels[1, 1])
    near: Array = abs(levels) < bound
    if np.count_nonzero(near):
        _make_exact(levels, np.flatnonzero(near.any(axis=(0, 1))), vectors, p)
    limits = both[..., 2].real
    is_left = levels > (limits if side > 0.0 else -NO_LEVEL - limits)
    meets = np.logical_and(*(is_left[0] ^ is_left[1]))
    jump: Array = meets * (2.0 * is_left[1, 1] - 1.0)
    before = jump.cumsum() - jump
    # The running sum of weights extends over all samples, so double precision would lose digits.
    if not pairs.is_uniform:
        is_complex = pairs.levels.dtype.kind == "c"
        jump = jump * (other_edge[:, 3] if is_complex else other_edge[:, 3].real)
        before = np.cumsum(jump, dtype=np.clongdouble if is_complex else np.longdouble) - jump
    # The level of a ring is set in the first row of the ring.
    first = np.arange(len(row)) - table[4]
    level = before - before.take(first) + pairs.levels.take(table[3])
    of_level, of_jump = _FACTORS.take(table[2], axis=1)
    weight = (of_level * level + of_jump * jump).astype(jump.dtype, copy=False)
    (parts,) = weight.nonzero()
    start, vector, _, factor = edge.take(parts, axis=0).T
    # The fraction of an unclipped edge is 1.
    weight, fraction, end_level = (a.take(parts) for a in (weight, of_level, levels[1, 1]))
    np.divide(end_level, cross.take(parts), out=fraction, where=meets.take(parts))
    if not pairs.is_uniform:
        weight = (factor if is_complex else factor.real) * weight.conj()
    return owner.take(parts), start + vector, fraction * vector, weight


def _make_exact(levels: Array, columns: Array, vectors: Array, p: Array) -> None:
    """Replace columns of the cross products ``levels`` by values accurate to an ulp.

    The rows are e x p, f x p, e x (p - f) and f x (p - e) for complex vectors.
    """
    (e, f), p = vectors[:, columns], p[columns]
    pairs = (e, p), (f, p), (e, p - f), (f, p - e)
    for row, (a, b) in zip(levels.reshape(4, -1), pairs, strict=True):
        row[columns] = accurate_cross(a.real, a.imag, b.real, b.imag)


def crossing(
    ops: Any, edge: Any, other: Any, tx: Any, ty: Any, side: float = 1.0
) -> tuple[Any, Any, Any, Any]:
    """Return whether and where an edge crosses an edge of the other outline, which is mirrored.

    Edges are (start x, start y, vector x, vector y). The offset (``tx``, ``ty``) maps a point p of
    the other outline to T - p. ``side`` is 1 or -1, the sign of the displacement that decides ties.

    The results are (crosses, enters, start, end). ``enters`` is true if the edge crosses to the
    left side of the other edge. ``start`` and ``end`` are cross products with exact signs.
    ``start`` is positive if the start of the edge lies to the left of the other edge, and ``end``
    is positive if its end does. The crossing lies at the fraction ``start / (start - end)`` of the
    edge.
    """
    (ax, ay, ex, ey), (cx, cy, fx, fy) = edge[:4], other[:4]
    px, py = (tx - cx) - ax, (ty - cy) - ay
    before = ops.cross(ex, ey, px, py)
    end_level = ops.cross(ex, ey, px - fx, py - fy)
    start, end = ops.cross(fx, fy, px, py), ops.cross(fx, fy, px - ex, py - ey)
    limit, other_limit = limit_of(ops, ex, ey, side), limit_of(ops, fx, fy, side)
    at_start, at_end = start > other_limit, end > other_limit
    return ((before > limit) ^ (end_level > limit)) & (at_start ^ at_end), at_end, start, end


def limit_of(ops: Any, ex: Any, ey: Any, side: float) -> Number:
    """Return the cross product above which a vertex lies to the left of an edge: 0 or just below 0.

    Ties are decided as if the offset were displaced by ``side`` (eps, -eps^2), with infinitesimal
    eps.
    """
    limits = (-NO_LEVEL, 0.0) if side > 0.0 else (0.0, -NO_LEVEL)
    return ops.select((ey < 0.0) | ((ey == 0.0) & (ex < 0.0)), *limits)
