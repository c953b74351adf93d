"""Construction of the edge pairs that can cross, for each cell in the plane of offsets.

The offset is the displacement between two copies of an outline. Each cell lists the edges inside
the other copy and the edge pairs that can cross, in order along the rings, (K1) of
docs/theory/edges.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from polywigner.kernels.cut.pair_grid import (
    CLIPPED,
    CROSSING,
    INSIDE,
    LEAD,
    ROUNDED,
    START,
    WHOLE,
    Array,
    ClipGrid,
    Outline,
    PairGrid,
    crossing,
    limit_of,
)
from polywigner.numerics.grid_arithmetic import accurate_cross

# Start and vector of a placeholder edge. It does not cross any edge of an outline, and is not
# parallel to any edge.
_NO_EDGE = (877.0, 512.375, 1.0, 0.28125)
# Largest number of edge pairs per block, and largest product of the numbers of cells and edges. The
# arrays of a block fit into the cache of a core.
_BLOCK = 1 << 15
_DENSE = 1 << 18
# Margin around each cell, in units of the frame. It is far larger than rounding errors.
_MARGIN = 1e-12
# A level is the weighted winding number of the other copy of the outline. _NO_WEIGHT is the
# magnitude below which a level counts as zero, and 1/_LEVELS is the difference below which two
# levels count as equal. Both tolerances are relative to the largest weight.
_NO_WEIGHT, _LEVELS = 1e-15, 2.0**50
# Largest number of cells along each side of the grid of offsets, and largest total number of rows.
# If the outline is a regular 30-gon and the grid has 64 cells along each side, a cell contains
# about 4 edge pairs (benchmarks/call_rates.py).
_ACROSS, _MOST_ROWS = 64, 1 << 21


class _Exact:
    """Operations for :func:`crossing` on float64 arrays, with exact signs of cross products."""

    select = staticmethod(np.where)

    @staticmethod
    def cross(ax: Array, ay: Array, bx: Array, by: Array) -> Array:
        """Return the cross product of two vectors with an exact sign."""
        rough = np.asarray(ax * by - ay * bx)
        # ROUNDED is an upper bound on the error only for vectors shorter than 8.
        near = np.abs(rough) < ROUNDED
        if near.any():
            rough[near] = accurate_cross(*(v[near] for v in (ax, ay, bx, by)))
        return rough


@dataclass(frozen=True)
class _Cells:
    size: float
    """Side of a cell, a power of two, so that cell indices of offsets on the grid are exact."""
    nx: int
    ny: int

    @classmethod
    def of(cls, reach: Array, across: int) -> _Cells:
        """Return a grid for offsets up to ``reach``: about ``across`` cells on the longer side."""
        size = 2.0 ** math.floor(math.log2(2.0 * float(reach.max()) / across))
        nx, ny = (2 * (math.floor(float(r) / size) + 1) for r in reach)
        return cls(size, nx, ny)

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.nx * self.ny

    @property
    def corner(self) -> Array:
        """Lower left corner of the grid of cells, shape (2,)."""
        return -0.5 * self.size * np.array([self.nx, self.ny])

    def centre(self, cell: Array) -> tuple[Array, Array]:
        """Return x and y of the centres of cells, whose indices ``cell`` increase along x first."""
        x, y = self.corner
        return x + self.size * (cell % self.nx + 0.5), y + self.size * (cell // self.nx + 0.5)


@lru_cache(maxsize=256)
def cells_across(first: Outline, second: Outline, samples: int) -> int:
    """Return the number of cells along the longer side of the grid of offsets.

    Smaller cells have shorter lists, but the lists take more time to build and more memory.
    """
    size, outlines = float(_largest_offset(first, second).max()), (first, second)
    perimeters = [float(np.hypot(*(o.edges[:, 2:4] - o.vertices).T).sum()) for o in outlines]
    counts = [len(o.edges) for o in outlines]
    pairs, across = math.prod(counts), 2
    while across < _ACROSS:
        # Two edges cross for offsets in a parallelogram whose sides are the edges. With edge
        # lengths e and f and cell size c, the parallelogram meets about (1 + e/c)(1 + f/c) cells.
        finer = zip(counts, perimeters, strict=True)
        rows = math.prod(count + length * across / size for count, length in finer)
        pays = 4 * across * across < samples or rows < 2 * pairs
        if not pays or rows > max(_MOST_ROWS, 2 * pairs):
            break
        across *= 2
    return across


def pair_grid(
    first: Outline, second: Outline, across: int, *, is_clipped: bool = False
) -> PairGrid:
    """Return the edges and edge pairs of a grid with ``across`` cells along its longer side.

    If ``is_clipped`` is true, the result is a :class:`ClipGrid`, and the second outline must be
    convex. The second outline is mirrored: the offset T maps a point p to T - p. Pass the same
    outline twice for the Wigner function, and an outline and its rotated copy for the ambiguity
    function.
    """
    cells = _Cells.of(_largest_offset(first, second), across)
    far = max(float(np.abs(o.vertices[:, 0]).max()) for o in (first, second)) + first.step
    leads = _leads(first, far)
    edges, others = np.concatenate([first.edges, leads]), second.edges
    rings = None
    if is_clipped:
        rings = np.repeat(np.arange(len(second.starts) - 1), np.diff(second.starts))
    blocks = list(_rows_of_cells(first, cells, edges, others, rings))
    cell, table, level = (
        np.concatenate([part[k] for block in blocks for part in block[:2]]) for k in range(3)
    )
    inside = np.bincount(cell[table[:, 2] == INSIDE], minlength=cells.count)
    # In each cell, stable sorting keeps the edges inside the other copy of the outline before all
    # other rows.
    order = np.argsort(cell, kind="stable")
    rows, level = table[order], level[order]
    rows[:, 3], levels = _numbered(level, abs(others[:, 5] + 1j * others[:, 6]).max(initial=0.0))
    if is_clipped:
        sides_of = np.where(rows[:, 2] == CLIPPED, rows[:, 1], 0)
        rows[:, 2] = np.cumsum(sides_of)
        rows[:, 1] = rows[:, 2] - sides_of
    ends = np.zeros((cells.count + 1, 4), np.uint32)
    counts = np.bincount(cell, minlength=cells.count)
    ends[:-1, 2] = np.cumsum(counts)
    ends[:-1, 0] = ends[:-1, 2] - counts
    ends[:-1, 1] = ends[:-1, 0] + inside
    low, size = cells.corner, cells.size
    numbers = np.array([[*low, *-low, 1.0 / size, cells.nx, cells.count, first.step]], np.float64)
    no_edge = (*_NO_EDGE[:2], *np.add(_NO_EDGE[:2], _NO_EDGE[2:]), 0.0, 1.0, 0.0, 0.0)
    others = np.vstack([others, no_edge])
    # The subtractions are exact, because the vertices lie on a grid.
    for ends_of in (edges, others):
        ends_of[:, 2:4] -= ends_of[:, :2]
    names = np.vstack([first.names, np.zeros((len(leads), 4), np.uint32)])
    sides = np.concatenate([sides for *_, sides in blocks]).astype(np.uint32)[:, None]
    kind = ClipGrid if is_clipped else PairGrid
    return kind(numbers, ends, rows, edges, others, names, levels, sides)


def _largest_offset(first: Outline, second: Outline) -> Array:
    """Return the largest offset along x and along y at which two outlines overlap."""
    sizes = (np.abs(outline.vertices).max(axis=0) for outline in (first, second))
    return np.asarray(np.maximum(sum(sizes), 1e-300))


def _leads(outline: Outline, far: float) -> Array:
    """Return horizontal lines from x = -far and x = far to the first vertex of each ring.

    The rows have the format of ``Outline.edges``. The left line starts outside the second outline
    for offsets with x >= 0. The right line starts outside it for offsets with x < 0.
    """
    points = outline.vertices[outline.starts[:-1]]
    ends = np.repeat(points, 2, axis=0)
    starts = ends.copy()
    starts[:, 0] = np.tile([-far, far], len(points))
    return np.hstack([starts, ends, np.tile([0.0, 1.0, 0.0, 0.0], (len(ends), 1))])


def _rows_of_cells(
    outline: Outline,
    cells: _Cells,
    edges: Array,
    others: Array,
    rings: Array | None,
) -> Iterator[tuple[tuple[Array, ...], tuple[Array, ...], Array]]:
    """Yield (cell, row, level) for edges inside the second outline and for other rows, in blocks.

    The edges of the second outline are ``others``. For a `ClipGrid`, ``rings`` contains the ring of
    each of these edges, and the third array of a block contains the sides. The level holds for the
    centre of the cell. The level at the start of an edge can change within a cell only if this edge
    and the preceding edge both cross edges of the second outline in this cell.
    """
    count, null = len(outline.vertices), len(others)
    weights: Array = others[:, 5]
    if others[:, 6].any():
        weights = weights + 1j * others[:, 6]
    cell, edge, other = (
        np.concatenate(part) for part in zip(*_meeting(cells, edges, others, count), strict=True)
    )
    order = np.argsort(cell * len(edges) + edge, kind="stable")
    cell, edge, other = (part.take(order) for part in (cell, edge, other))
    unit = float(abs(weights).max(initial=0.0))
    preceding = np.empty(count, np.intp)
    preceding[outline.following] = np.arange(count)
    starts = outline.starts[:-1]
    ring_of = np.repeat(np.arange(len(starts)), np.diff(outline.starts))
    step = max(1, _DENSE // len(edges))
    for low in range(0, cells.count, step):
        size = min(step, cells.count - low)
        begin, end = np.searchsorted(cell, (low, low + size))
        at, i, j = (part[begin:end] for part in (cell, edge, other))
        centre, vectors = cells.centre(at), (_vectors(edges, i), _vectors(others, j))
        meets, enters, start, _ = crossing(_Exact, *vectors, *centre)
        shape, key = (size, len(edges)), (at - low) * len(edges) + i

        def summed(values: Array, shape: tuple[int, int] = shape, key: Array = key) -> Array:
            """Return sums of ``values`` over all edge pairs of each cell and edge."""
            return np.bincount(key, values, math.prod(shape)).reshape(shape)

        jump = weights.take(j) * (meets * (2.0 * enters - 1.0))
        jumps = (
            summed(jump.real) + 1j * summed(jump.imag) if np.iscomplexobj(jump) else summed(jump)
        )
        first = jumps[:, count::2] + jumps[:, count + 1 :: 2]
        jumps = jumps[:, :count]
        before = np.cumsum(jumps, axis=1) - jumps
        level = before + (first - before[:, starts])[:, ring_of]
        pairs = at - low, i, j
        if rings is None:
            has_pairs = summed(np.ones(len(at)))[:, :count] > 0.0
            changes = (summed(_touches(cells, *vectors, *centre))[:, :count] > 0.0) & has_pairs
            changes &= has_pairs[:, preceding]
            level_of_inside, sides = np.where(changes, 0.0, level), i[:0]
            at, *other_rows = _other_rows(pairs, starts, changes, level, null)
        else:
            *_, fx, fy = vectors[1]
            is_left = start > limit_of(_Exact, fx, fy, 1.0)
            (at, *other_rows), sides = _clipped_rows(pairs, is_left, rings, weights, level)
            level_of_inside = level
        at_inside, inside = np.nonzero(abs(level_of_inside) > _NO_WEIGHT * unit)
        rows = _table(inside, null, INSIDE), level_of_inside[at_inside, inside]
        yield (at_inside + low, *rows), (at + low, *other_rows), sides


def _clipped_rows(
    pairs: tuple[Array, Array, Array], is_left: Array, rings: Array, weights: Array, level: Array
) -> tuple[tuple[Array, Array, Array], Array]:
    """Return the list entries of edges that cross a convex ring, and the sides that they cross.

    ``is_left`` states, for each pair, whether the first edge starts to the left of the second edge
    at the centre of the cell. ``rings`` contains the ring of each edge of the second outline. The
    second column of the entries contains the number of sides. The weight of each ring with such an
    entry is subtracted from ``level`` if the edge starts inside this ring.
    """
    is_edge = pairs[1] < level.shape[1]
    at, i, j, is_left = (part[is_edge] for part in (*pairs, is_left))
    pieces = (at * level.shape[1] + i) * (rings.max() + 1) + rings[j]
    first = np.flatnonzero(np.diff(pieces, prepend=-1))
    counts = np.diff(np.append(first, len(pieces)))
    # If an edge crosses sides of a convex ring, its start lies inside the ring if it lies to the
    # left of all these sides.
    is_inside = np.add.reduceat(is_left, first, dtype=int) == counts if len(first) else first
    at, i, weight = at[first], i[first], weights[j[first]]
    np.subtract.at(level, (at, i), weight * is_inside)
    return (at, _table(i, counts, CLIPPED), weight), j


def _other_rows(
    pairs: tuple[Array, Array, Array], starts: Array, changes: Array, level: Array, null: int
) -> tuple[Array, Array, Array]:
    """Return (cell, row, level) of crossing edges and of edges whose level changes in a cell.

    ``changes`` (cells, edges) is true if the level at the start of an edge can change. ``starts``
    contains the first edge of each ring, and ``null`` is the index of the placeholder edge.
    """
    at, i, j = pairs
    count = changes.shape[1]
    # The level at the first vertex of a ring may change within a cell. It is then computed from the
    # crossings with the line that leads from outside to this vertex.
    led = changes[:, starts]
    led_cell, led_ring = led.nonzero()
    is_lead = i >= count
    lead_at, lead, lead_other = (part[is_lead] for part in pairs)
    ring = (lead - count) // 2
    (used,) = led[lead_at, ring].nonzero()
    at, i, j = (part[~is_lead] for part in pairs)
    whole_at, whole_edge = changes.nonzero()
    is_first = np.diff(at * count + i, prepend=-1) != 0
    kind = np.where(is_first & ~changes[at, i], START, CROSSING)
    rows = (
        _table(starts[led_ring], null, START),
        _table(lead[used], lead_other[used], LEAD),
        _table(whole_edge, null, WHOLE),
        _table(i, j, kind),
    )
    first = 4 * starts
    positions = first[led_ring] - 2, first[ring[used]] - 1, 4 * whole_edge, 4 * i + 1
    cell = np.concatenate([led_cell, lead_at[used], whole_at, at])
    order = np.lexsort((np.concatenate(positions), cell))
    values = np.zeros(len(cell), level.dtype)
    values[len(cell) - len(at) :] = level[at, i]
    return cell[order], np.concatenate(rows)[order], values[order]


def _numbered(level: Array, unit: float) -> tuple[Array, Array]:
    """Return the index of each winding number in a table of distinct numbers, and the table (k, 4).

    ``unit`` is the largest weight.
    """
    unit = float(unit) or 1.0
    scaled = np.rint(np.append(0.0, level) * (_LEVELS / unit))
    _, first, number = np.unique(scaled, return_index=True, return_inverse=True)
    values = np.append(0.0, level)[first]
    values[abs(values) <= _NO_WEIGHT * unit] = 0.0
    return number[1:], np.stack([values.real, values.imag, 0.0 * values.real, 0.0 * values.real], 1)


def _table(edge: Array, other: Array | int, kind: Array | int) -> Array:
    """Return rows (edge, other, kind, 0) of a `PairGrid`, with the level index 0."""
    rows = np.zeros((len(edge), 4), np.uint32)
    rows[:, 0], rows[:, 1], rows[:, 2] = edge, other, kind
    return rows


def _vectors(edges: Array, number: Array) -> tuple[Array, ...]:
    """Return x, y, vector x and vector y of the edges with the indices ``number``."""
    ax, ay, bx, by = (column.take(number) for column in edges.T[:4])
    return ax, ay, bx - ax, by - ay


def _meeting(
    cells: _Cells, edges: Array, others: Array, count: int
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield index arrays of cells, and of the two edges of each pair that can cross in the cell.

    Edges from index ``count`` on are lines to rings.
    """
    step = max(1, _BLOCK // len(others))
    c, d = others[:, :2], others[:, 2:4]
    for start in range(0, len(edges), step):
        number = np.arange(start, min(start + step, len(edges)))
        a, b = edges[number, None, :2], edges[number, None, 2:4]
        low = (np.minimum(a, b) + np.minimum(c, d) - cells.corner) / cells.size
        high = (np.maximum(a, b) + np.maximum(c, d) - cells.corner) / cells.size
        least, most = np.zeros((len(number), 1, 2)), np.full((len(number), 1, 2), cells.ny - 1.0)
        most[..., 0] = cells.nx - 1.0
        is_lead, is_right = number >= count, (number - count) % 2 == 1
        least[is_lead & ~is_right, :, 0] = cells.nx // 2
        most[is_lead & is_right, :, 0] = cells.nx // 2 - 1
        low, high = np.maximum(np.floor(low), least), np.minimum(np.floor(high), most)
        spans = np.maximum(high - low + 1.0, 0.0).astype(np.int64).reshape(-1, 2)
        counts = spans.prod(axis=1)
        pair = np.repeat(np.arange(len(counts)), counts)
        index = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
        row, column = np.divmod(index, spans[:, 0].take(pair))
        x, y = low.astype(np.int64).reshape(-1, 2).take(pair, axis=0).T
        cell = (y + row) * cells.nx + x + column
        meets = _near(cells, a, b, c, d, pair, cell)
        pair = pair[meets]
        i, j = np.divmod(pair, len(others))
        yield cell[meets], number.take(i), j


def _near(cells: _Cells, a: Array, b: Array, c: Array, d: Array, pair: Array, cell: Array) -> Array:
    """Return whether two edges can cross for an offset in a cell.

    The edges run from ``a`` (n, 1, 2) to ``b`` and from ``c`` (m, 2) to ``d``. ``pair`` is an index
    into all n m pairs.
    """
    e, f, centre = b - a, d - c, 0.5 * (a + b + c + d).reshape(-1, 2)
    half = 0.5 * cells.size + _MARGIN
    x, y = np.subtract(cells.centre(cell), centre.take(pair, axis=0).T)
    area = 0.5 * abs(e[..., 0] * f[:, 1] - e[..., 1] * f[:, 0])
    meets = np.ones(len(cell), bool)
    for vector in (e, f):
        u, v = (np.broadcast_to(vector[..., k], area.shape).ravel() for k in range(2))
        size = half * (abs(u) + abs(v))
        level = abs(u.take(pair) * y - v.take(pair) * x)
        meets &= level <= (area.ravel() + size).take(pair)
    return meets


def _touches(cells: _Cells, edge: Any, other: Any, x: Array, y: Array) -> Array:
    """Return whether ``edge`` can start on ``other`` for an offset in the cell around (x, y)."""
    (ax, ay, _, _), (cx, cy, fx, fy) = edge, other
    half = 0.5 * cells.size
    px, py = x - (ax + cx + 0.5 * fx), y - (ay + cy + 0.5 * fy)
    inside = abs(px) <= 0.5 * abs(fx) + half + _MARGIN
    inside &= abs(py) <= 0.5 * abs(fy) + half + _MARGIN
    return inside & (abs(fx * py - fy * px) <= half * (abs(fx) + abs(fy)) + _MARGIN)
