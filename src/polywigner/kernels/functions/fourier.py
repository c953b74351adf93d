"""Fourier transform of polygons: signed sums over the triangles (origin, p, p') of their edges.

One triangle contributes ``cross(p, p') exp[0, a, b]``, the second divided difference of the
exponential at ``0``, ``a = -2 pi i nu.p`` and ``b = -2 pi i nu.p'``. Unlike the edge sum of the
paper's eq. (FVT) it has no division by nu, stays accurate for slivers, and a boundary that closes
only up to rounding costs no more than rounding (docs/theory.md, (F2)). Bodies are sums of
tetrahedra in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.kernels.outline.frame import Frame, Matrix, frame_of, times
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.divided_differences import simplex_complex_wave, simplex_plane_wave
from polywigner.numerics.grid_arithmetic import accurate_cross
from polywigner.numerics.phases import cos_sin_turns, sinc, sinc_less_one

Values = tuple[Any, ...]
Array = npt.NDArray[Any]

# Edge vectors this close, in the frame, count as equal: congruent elements have them after
# rounding. Their mean stands for them, which moves the transform no more than that rounding did.
_EQUAL = 2.0**-51


@dataclass(frozen=True, eq=False)
class Family:
    """Edges with one vector (ex, ey) up to sign; a component that is rounding only is 0."""

    ex: float
    ey: float
    middles: npt.NDArray[np.float64]
    """(n, 2) their midpoints."""
    weights: npt.NDArray[np.complex128]
    """(n,) the field on the edge's element, for an edge along (ex, ey); minus that against it."""

    @property
    def straight(self) -> bool:
        """Whether the edges run along an axis."""
        return self.ex == 0.0 or self.ey == 0.0


def families_of(edges: Sequence[Sequence[float]], field: npt.ArrayLike = 1.0) -> tuple[Family, ...]:
    """Edges (begin x, y, end x, y, ...) sorted into families, with the field on their elements."""
    corners = np.array(edges)
    begin, end = corners[:, :2], corners[:, 2:4]
    vectors, middles = end - begin, (begin + end) / 2
    vectors[np.abs(vectors) <= _EQUAL] = 0.0
    backwards = (vectors[:, 1] < 0) | ((vectors[:, 1] == 0) & (vectors[:, 0] < 0))
    signs = np.where(backwards, -1.0, 1.0)
    weights = signs * np.asarray(field, np.complex128)
    vectors *= signs[:, None]
    families = []
    for members in _clusters(vectors):
        ex, ey = vectors[members].mean(axis=0).tolist()
        families.append(Family(ex, ey, middles[members], weights[members]))
    return tuple(families)


def _clusters(vectors: npt.NDArray[np.float64]) -> list[list[int]]:
    """Numbers of the vectors that agree with the first of their cluster in both components."""
    found: list[list[int]] = []
    near: list[list[int]] = []  # clusters that the next vector in order of x may still belong to
    for k in np.lexsort((vectors[:, 1], vectors[:, 0])).tolist():
        near = [c for c in near if vectors[k, 0] - vectors[c[0], 0] <= _EQUAL]
        for cluster in near:
            if abs(vectors[k, 1] - vectors[cluster[0], 1]) <= _EQUAL:
                cluster.append(k)
                break
        else:
            near.append([k])
            found.append(near[-1])
    return found


@dataclass(frozen=True)
class OutlineTables:
    """A boundary in a frame; nothing is cut here, so neither lines nor convex pieces are needed."""

    frame: Any
    edges: tuple[tuple[float, ...], ...]
    """Begin (x, y) and end of every edge, and cross(begin, end), twice the area of its triangle."""
    following: tuple[int, ...] = ()
    """The number of the edge that begins where each ends; vertices are numbered like edges."""


def outline_tables(
    rings: Sequence[npt.NDArray[np.float64]], frame: Frame | None = None
) -> OutlineTables:
    """The tables of a polygon to the left of its rings, in its own frame or a wider one."""
    frame = frame or frame_of(np.concatenate(rings))
    edges: list[tuple[float, ...]] = []
    following: list[int] = []
    for ring in rings:
        corners = frame.vertices(ring).tolist()
        first = len(edges)
        following += [*range(first + 1, first + len(corners)), first]
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
            edges.append((*a, *b, accurate_cross(*a, *b)))
    return OutlineTables(frame, tuple(edges), tuple(following))


@dataclass(frozen=True)
class LinearFrame:
    """nu' = rows nu, and x' with nu'.x' = nu.(x - centre); entries may be ``Doubled``."""

    centre: tuple[Any, ...]
    rows: Matrix
    content: float
    reach: tuple[float, ...]

    def frequency(self, ops: Any, *nu: Any) -> Values:
        return times(ops, self.rows, *nu)


def fan_sum(ops: Any, tables: Any, turns: Any, *nu: Any) -> Values:
    """F(nu) in the frame, as (cosine part, sine part) with F = cosine - i sine. Source: (F2), (F3).

    Each row of the tables is a simplex with one corner at the origin: its other corners, and their
    determinant, its signed content times 2 or 6.
    """

    def term(*row: Any) -> Values:
        corners = (_dot(ops, nu, corner) for corner in _corners(row, len(nu)))
        cosine, sine = simplex_plane_wave(ops, *corners)
        return cosine * row[-1], sine * row[-1]

    found: Values = ops.sum_over(tables.edges, term, 2, like=nu[0], unroll=_is_short(nu))
    return found


def complex_fan_sum(ops: Any, tables: Any, turns: Any, growth: Any, *nu: Any) -> Values:
    """F(nu) exp(-2 pi level) for complex nu in the frame: analytic in nu, no conjugate anywhere.

    All real parts of nu, then all imaginary ones. The level is that of the largest wave in the
    frame's box, so that no term overflows.
    """
    real, imag = nu[: len(nu) // 2], nu[len(nu) // 2 :]
    level = phases.level(tables.frame, imag)

    def term(*row: Any) -> Values:
        corners = (
            Pair(_dot(ops, real, corner), _dot(ops, imag, corner))
            for corner in _corners(row, len(real))
        )
        wave = simplex_complex_wave(ops, *corners, level=level).scaled(row[-1])
        return wave.real, wave.imag

    found: Values = ops.sum_over(tables.edges, term, 2, like=nu[0], unroll=_is_short(real))
    return found


def _is_short(nu: Values) -> bool:
    """Whether terms may be unrolled; of a cube's tetrahedra it takes 3 s and half the speed."""
    return len(nu) < 3


def _corners(row: Values, dimension: int) -> list[Values]:
    return [row[k : k + dimension] for k in range(0, dimension**2, dimension)]


def _dot(ops: Any, nu: Values, point: Values) -> Any:
    total = nu[-1] * point[-1]
    for component, coordinate in zip(nu[-2::-1], point[-2::-1], strict=True):
        total = ops.fma(component, coordinate, total)
    return total


# An edge's midpoint wave times nu x e/(2 pi |nu|^2) is rounded to an ulp: F errs by
# ulp * perimeter/(2 pi |nu|). Nearer to the origin than where that is this much of the area, (F1)
# is not used. Ulps are those of float64 and float32.
_LOSS = {True: 5e-15, False: 1e-6}
_ULP = {True: 2.0**-53, False: 2.0**-24}
_DTYPES: dict[bool, np.dtype[Any]] = {True: np.dtype(np.float64), False: np.dtype(np.float32)}
# Rounding the vertices costs 1e-14 of the area, times perimeter * lever / (this much area): as for
# a fan of triangles (``simplices``).
_MOST_SLENDER = 512.0
# Below this |q| (turns) sinc(q) is summed as a series; above it, it is a quotient of the sines and
# cosines of the axes, and those err by an ulp of 1. First omitted term: 0.31^12/13! = 1e-16 and
# 0.31^8/9! = 3e-10.
_NEAR = 0.1
_TERMS = {True: 5, False: 3}
# Values of a temporary array that stay in the cache of one core.
_BLOCK = 1 << 14
# Larger matrix products are shared among threads, which wait for each other: on a busy machine that
# takes up to a hundred times as long. A stack of smaller ones costs a tenth more, if they have rows
# by the four.
_SERIAL_PRODUCT, _LEAST_ROWS = 1 << 18, 4
# Edges whose waves are in memory at a time: some 40 MB for 512 x 512 points.
_MOST_EDGES = 1024

Waves = tuple[Array, Array]
"""Cosines and sines, (frequencies, positions)."""


@dataclass(frozen=True)
class GridTables:
    """The constants of a polygon for grids."""

    frame: Frame
    straight: tuple[Family, ...]
    """Edges along either axis."""
    oblique: tuple[Family, ...]
    terms: int
    """One for each edge."""
    perimeter_over_area: float

    @property
    def scales(self) -> tuple[float, float]:
        """Factors from the user's nu_x and nu_y to the frame's, in either order."""
        assert self.frame.axes is not None
        own = {axis: k for k, axis in enumerate(self.frame.axes)}
        x, y = (self.frame.inverse_transpose[own[axis]][axis] for axis in (0, 1))
        return x, y

    def floor(self, double: bool) -> float:
        """The least |nu| in the frame at which (F1) keeps its accuracy."""
        return self.perimeter_over_area * _ULP[double] / (2 * math.pi * _LOSS[double])


@dataclass(frozen=True, eq=False)
class OutlineSum:
    """A kernel's sum over all edges of an outline, with constants for grids of its arguments."""

    summed: Callable[..., tuple[Any, ...]]
    on_grid: Callable[[Any], GridTables | None]
    """source -> constants, None where it has none; cached."""

    def __call__(self, ops: Any, tables: Any, *inner: Any) -> tuple[Any, ...]:
        return self.summed(ops, tables, *inner)


def grid_tables(tables: OutlineTables, field: Sequence[complex]) -> GridTables | None:
    """The families of edges, the field on each edge's element given.

    None in a frame that is turned, where a grid is none any more, and for what is too slender.
    """
    if tables.frame.axes is None:
        return None
    families = families_of(tables.edges, field)
    straight = tuple(f for f in families if f.straight)
    oblique = tuple(f for f in families if not f.straight)
    perimeter = sum(float(np.abs(f.weights).sum()) * math.hypot(f.ex, f.ey) for f in families)
    area = sum(abs(w) * edge[-1] for w, edge in zip(field, tables.edges, strict=True)) / 2
    if not perimeter * math.hypot(*tables.frame.reach) < _MOST_SLENDER * area:
        return None
    return GridTables(tables.frame, straight, oblique, len(tables.edges), perimeter / area)


@dataclass(frozen=True)
class _Axis:
    """Frequencies along one axis: in the frame, and the turns of the centre."""

    nu: Array
    turns: Array

    def waves(self, ops: Any, positions: Array) -> Waves:
        """(cosine, sine) of 2 pi nu x."""
        cosine, sine = cos_sin_turns(ops, self.nu[:, None] * positions + self.turns[:, None])
        return cosine, sine


@dataclass(frozen=True)
class _Product:
    """Sums over midpoints, cosine and sine parts side by side, as one matrix product."""

    left: Array
    right: Array

    def rows(self, rows: slice) -> Array:
        left = self.left[rows]
        product = np.empty((len(left), self.right.shape[1]), left.dtype)
        few = _SERIAL_PRODUCT // self.right.size // _LEAST_ROWS * _LEAST_ROWS
        whole = len(left) // few * few if few else 0
        if whole:
            stack = (-1, few)
            np.matmul(
                left[:whole].reshape(*stack, left.shape[1]),
                self.right,
                out=product[:whole].reshape(*stack, product.shape[1]),
            )
        np.matmul(left[whole:], self.right, out=product[whole:])
        return product.reshape(len(product), 2, -1)


def _product(x: Waves, y: Waves, dtype: np.dtype[Any]) -> _Product:
    """cos(a + b) and sin(a + b) summed over the members, a along x and b along y."""
    (cos_x, sin_x), (cos_y, sin_y) = x, y
    left = np.concatenate([cos_x, sin_x], axis=1, dtype=dtype, casting="same_kind")
    right = np.block([[cos_y.T, sin_y.T], [-sin_y.T, cos_y.T]])
    return _Product(left, right.astype(dtype, order="C"))


def _weighted(waves: Waves, weights: Array) -> Waves:
    """(cosine - i sine) times complex weights, again as cosine and sine."""
    cosine, sine = waves
    if not weights.imag.any():
        return cosine * weights.real, sine * weights.real
    real = cosine * weights.real + sine * weights.imag
    return real, sine * weights.real - cosine * weights.imag


def _straight_product(
    ops: Any, families: Sequence[Family], x: _Axis, y: _Axis, dtype: np.dtype[Any]
) -> _Product:
    """pi (nu x e) sinc(nu.e) times the waves of the edges along the axes: all a product."""
    parts_x, parts_y = [], []
    for family in families:
        along_x = family.ey == 0.0
        waves_x = x.waves(ops, family.middles[:, 0])
        waves_y = y.waves(ops, family.middles[:, 1])
        if along_x:
            factor_x = -family.ex * math.pi * sinc(ops, x.nu * family.ex)
            factor_y = y.nu
        else:
            factor_x = x.nu
            factor_y = family.ey * math.pi * sinc(ops, y.nu * family.ey)
        parts_x.append([wave * factor_x[:, None] for wave in _weighted(waves_x, family.weights)])
        parts_y.append([wave * factor_y[:, None] for wave in waves_y])
    cos_x, sin_x = (np.concatenate(part, axis=1) for part in zip(*parts_x, strict=True))
    cos_y, sin_y = (np.concatenate(part, axis=1) for part in zip(*parts_y, strict=True))
    return _product((cos_x, sin_x), (cos_y, sin_y), dtype)


class _Oblique:
    """pi (nu x e) sinc(nu.e) times the sum of the waves of one family."""

    def __init__(self, ops: Any, family: Family, x: _Axis, y: _Axis, double: bool) -> None:
        self.ops, self.terms = ops, _TERMS[double]
        dtype = _DTYPES[double]
        waves_x = x.waves(ops, family.middles[:, 0])
        waves_x = _weighted(waves_x, family.weights)
        self.waves = _product(waves_x, y.waves(ops, family.middles[:, 1]), dtype)
        self.q_x, self.q_y = ((a.nu * e).astype(dtype) for a, e in ((x, family.ex), (y, family.ey)))
        self.c_x, self.c_y = ((a.nu * e).astype(dtype) for a, e in ((x, family.ey), (y, family.ex)))
        cos_x, sin_x = cos_sin_turns(ops, 0.5 * x.nu * family.ex)
        cos_y, sin_y = cos_sin_turns(ops, 0.5 * y.nu * family.ey)
        self.left = np.stack([sin_x, cos_x], axis=1).astype(dtype)
        self.right = np.stack([cos_y, sin_y]).astype(dtype)

    def rows(self, rows: slice) -> Array:
        q = self.q_x[rows, None] + self.q_y
        factor = self._sinc(q, rows)
        np.subtract(self.c_x[rows, None], self.c_y, out=q)
        factor *= q
        waves = self.waves.rows(rows)
        waves *= factor[:, None, :]
        return waves

    def _sinc(self, q: Array, rows: slice) -> Array:
        """pi sinc(q) = sin(pi q)/q."""
        is_near = np.abs(q) < _NEAR
        if is_near.all():
            return math.pi * (1.0 + sinc_less_one(self.ops, q, self.terms))
        near = np.flatnonzero(is_near)
        quotient = self.left[rows] @ self.right
        quotient /= q
        small = q.ravel()[near]
        quotient.ravel()[near] = math.pi * (1.0 + sinc_less_one(self.ops, small, self.terms))
        return quotient


def _axes(ops: Any, tables: GridTables, nu: tuple[Array, Array]) -> tuple[_Axis, _Axis]:
    """The axes of the grid in the frame, in the frame's order."""
    x, y = (
        _Axis(given * scale, phases.turns_to_centre(ops, (centre,), given))
        for given, scale, centre in zip(nu, tables.scales, tables.frame.centre, strict=True)
    )
    return (x, y) if tables.frame.axes == (0, 1) else (y, x)


def _batches(tables: GridTables) -> Iterator[list[Family]]:
    """All families, those with many members cut, in batches whose waves fit into memory."""
    batch: list[Family] = []
    for family in (*tables.straight, *tables.oblique):
        for start in range(0, len(family.weights), _MOST_EDGES):
            part = slice(start, start + _MOST_EDGES)
            cut = replace(family, middles=family.middles[part], weights=family.weights[part])
            if batch and sum(len(f.weights) for f in (*batch, cut)) > _MOST_EDGES:
                yield batch
                batch = []
            batch.append(cut)
    yield batch


def _terms(
    ops: Any, batch: Sequence[Family], x: _Axis, y: _Axis, double: bool
) -> list[_Product | _Oblique]:
    straight = [family for family in batch if family.straight]
    terms: list[_Product | _Oblique] = [
        _Oblique(ops, family, x, y, double) for family in batch if not family.straight
    ]
    if straight:
        terms.append(_straight_product(ops, straight, x, y, _DTYPES[double]))
    return terms


def _row_blocks(x: _Axis, y: _Axis) -> Iterator[slice]:
    step = max(1, _BLOCK // len(y.nu))
    return (slice(start, start + step) for start in range(0, len(x.nu), step))


def _edge_sums(ops: Any, tables: GridTables, x: _Axis, y: _Axis, double: bool) -> Array:
    """Sums over all edges, cosine and sine part: (nu_x, 2, nu_y)."""
    sums = np.empty((len(x.nu), 2, len(y.nu)), _DTYPES[double])
    for number, batch in enumerate(_batches(tables)):
        first, *others = _terms(ops, batch, x, y, double)
        for rows in _row_blocks(x, y):
            total = first.rows(rows)
            for term in others:
                total += term.rows(rows)
            sums[rows] = total if number == 0 else sums[rows] + total
    return sums


def fourier_on_grid(
    ops: Any, tables: GridTables, nu_x: Array, nu_y: Array, double: bool
) -> tuple[Array, Array, Array]:
    """Real and imaginary part at all (nu_x[i], nu_y[j]), and where they do not hold.

    ``ops`` for float64: the axes are done in it, and the grid in float64 (``double``) or float32.
    Values do not hold near the origin, at less than :meth:`GridTables.floor`. Source: (F4).
    """
    x, y = _axes(ops, tables, (nu_x, nu_y))
    sums = _edge_sums(ops, tables, x, y, double)
    real, imag = (np.empty((len(x.nu), len(y.nu)), sums.dtype) for _ in range(2))
    below = np.zeros(real.shape, bool)
    for rows in _row_blocks(x, y):
        square = x.nu[rows, None] ** 2 + y.nu**2
        below[rows] = square < tables.floor(double) ** 2
        square[below[rows]] = 1.0
        scale = (tables.frame.content / (2 * math.pi**2)) / square
        real[rows], imag[rows] = sums[rows, 1] * scale, sums[rows, 0] * scale
    if tables.frame.axes != (0, 1):
        return real.T, imag.T, below.T
    return real, imag, below
