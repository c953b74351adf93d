"""Fourier transforms of polygons and polyhedra, as signed sums over triangles and tetrahedra.

An edge of a polygon from p to p' contributes ``cross(p, p') exp[0, a, b]``, the second divided
difference of the exponential function at ``0``, ``a = -2 pi i nu.p`` and ``b = -2 pi i nu.p'``,
(F2) of docs/theory.md. Unlike the edge sum of the paper's eq. (FVT), this sum contains no division
by nu and is accurate for narrow polygons. A triangle (a, b, c) of a polyhedron's face contributes
``det(a, b, c) exp[0, z_a, z_b, z_c]``, where z_p is -2 pi i nu.p, (F3).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.geometry import Polyhedron
from polywigner.geometry.rings import whole_numbers
from polywigner.kernels.kernel import Kernel, leave_wave
from polywigner.kernels.outline import (
    NEEDLE_ASPECT,
    Frame,
    Matrix,
    determinant,
    frame_of,
    matrix_times,
    power_of_two,
    vertices_for,
)
from polywigner.numerics import Number, cluster_indices, index_blocks, phases
from polywigner.numerics.grid_arithmetic import accurate_cross
from polywigner.numerics.phases import cos_sin_cycles, simplex_plane_wave, sinc

Values = tuple[Any, ...]
Array = npt.NDArray[Any]


@dataclass(frozen=True)
class OutlineTables:
    """Edges of a source in its frame, for Fourier transforms."""

    frame: Any
    edges: tuple[tuple[float, ...], ...]
    """Start and end of each edge, and twice the area of its triangle with the origin."""
    following: tuple[int, ...] = ()
    """Index of the next edge along the ring, for each edge."""


def outline_tables(
    rings: Sequence[npt.NDArray[np.float64]], frame: Frame | None = None
) -> OutlineTables:
    """Return the edges of the polygon to the left of the rings, by default in its frame."""
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
    """Coordinates of a source, for Fourier transforms only.

    A frequency nu has the components nu' = ``rows nu`` in the frame. A position x has coordinates
    x' with nu'.x' = nu.(x - centre).
    """

    centre: tuple[Any, ...]
    rows: Matrix
    measure: float

    def frequency(self, ops: Any, *nu: Any) -> Values:
        """Return the components of a spatial frequency in the frame."""
        return matrix_times(ops, self.rows, *nu)


def fan_sum(ops: Any, tables: Any, cycles: Any, *nu: Any) -> Values:
    """Return the real part and minus the imaginary part of a Fourier transform, (F2), (F3).

    The result does not include the factors exp(-2 pi i cycles) and ``frame.measure``; the argument
    ``cycles`` is not used. ``nu`` is the frequency in ``tables.frame``. Each row of
    ``tables.edges`` contains the vertices of a triangle or tetrahedron except the origin, and their
    determinant.
    """

    def term(*row: Any) -> Values:
        corners = (_dot(ops, nu, corner) for corner in _corners(row, len(nu)))
        cosine, sine = simplex_plane_wave(ops, *corners)
        return cosine * row[-1], sine * row[-1]

    # For the tetrahedra of a cube, unrolled code takes 3 s to compile and runs at half the speed of
    # a loop.
    is_plane = len(nu) == 2
    total: Values = ops.sum_over(tables.edges, term, 2, like=nu[0], unroll=is_plane)
    return total


def _corners(row: Values, dimension: int) -> list[Values]:
    """Return the vertices in a row: those of a triangle or tetrahedron except the origin."""
    return [row[k : k + dimension] for k in range(0, dimension**2, dimension)]


def _dot(ops: Any, nu: Values, point: Values) -> Number:
    """Return the scalar product nu.point, rounded."""
    total = nu[-1] * point[-1]
    for component, coordinate in zip(nu[-2::-1], point[-2::-1], strict=True):
        total = ops.fma(component, coordinate, total)
    return total


def enter_frequency(ops: Any, frame: Any, *nu: Any) -> Values:
    """Return the phase nu.c of the source's centre c in cycles, and the frequency in the frame."""
    return (phases.cycles_to_centre(ops, frame.centre, *nu), *frame.frequency(ops, *nu))


@dataclass(frozen=True)
class SolidTables:
    """Tetrahedra of a polyhedron in its frame, with one vertex at the origin.

    Each row of ``edges`` contains the other vertices and six times the signed volume.
    """

    frame: LinearFrame
    edges: tuple[tuple[float, ...], ...]

    @property
    def terms(self) -> int:
        """Number of terms in the sum, on which the choice of the engine depends.

        A tetrahedron counts as eight edges.
        """
        return 8 * len(self.edges)


@lru_cache(maxsize=64)
def solid_tables(body: Polyhedron, double: bool) -> SolidTables:
    """Return the tetrahedra of a polyhedron. The tables for float64 and float32 are the same."""
    centre, rows = _axes(body)
    inner = vertices_for(rows, centre, body.vertices)
    # Triangle fans divide opposite faces of a thin body into the same triangles, so that rounding
    # errors cancel.
    fans = [(f[0], f[k], f[k + 1]) for f in body.faces for k in range(1, len(f) - 1)]
    corners = inner[np.array(fans, np.intp)]
    tetrahedra = np.column_stack([corners.reshape(-1, 9), _volumes(corners)]).tolist()
    measure = abs(float(determinant([[Fraction(m) for m in row] for row in rows])))
    frame = LinearFrame(centre, rows, measure)
    return SolidTables(frame, tuple(tuple(row) for row in tetrahedra if row[-1]))


def _axes(body: Polyhedron) -> tuple[tuple[float, float, float], Matrix]:
    """Return the centre of a polyhedron's bounding box, and its axes times their units of length.

    The units are powers of two. Long or flat bodies use their principal axes, with a separate unit
    for each axis.
    """
    mean = body.vertices.mean(axis=0)
    # By default NumPy would allocate a square matrix with one row for each vertex.
    _, _, principal = np.linalg.svd(body.vertices - mean, full_matrices=False)
    # Right-handed axes preserve the sign of volumes.
    principal = principal * np.sign(np.linalg.det(principal))
    axes = min(np.eye(3), principal, key=lambda rows: np.ptp(body.vertices @ rows.T, axis=0).prod())
    along = body.vertices @ axes.T
    low, extents = along.min(axis=0), np.ptp(along, axis=0)
    scales = [power_of_two(extent) for extent in extents.tolist()]
    if not extents.max() > NEEDLE_ASPECT * extents.min() > 0.0:
        axes = np.eye(3)
        low, extents = body.vertices.min(axis=0), np.ptp(body.vertices, axis=0)
        scales = [power_of_two(float(np.linalg.norm(extents)))] * 3
    x, y, z = (axes.T @ (low + extents / 2)).tolist()
    rows = (axes * np.array(scales)[:, None]).tolist()
    return (x, y, z), tuple(tuple(row) for row in rows)


def _volumes(corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return six times the signed volumes of tetrahedra that contain the origin as a vertex.

    ``corners`` contains the other vertices, shape (n, 3, 3). The products are exact.
    """
    integers, exponent = whole_numbers(corners)
    exact: Any = determinant(list(np.moveaxis(integers, 0, 2)))
    scale = 1 << abs(3 * exponent)
    return np.asarray(exact / scale if exponent < 0 else exact * scale, dtype=np.float64)


BODY = Kernel("fourier of a body", 3, solid_tables, enter_frequency, fan_sum, leave_wave)


# Largest error of F, as a fraction of the area, at which the sum (F4) is used, and rounding error
# of a wave. Rounding errors of the waves change F by _ULP * perimeter/(2 pi |nu|).
_LOSS, _ULP = 5e-15, 2.0**-53
# Largest slenderness of an outline for which the sum (F4) is used. The slenderness is the perimeter
# times the largest distance from the centre, divided by the area. At this limit, rounding errors of
# the vertices change F by 1e-14 of the area.
_MOST_SLENDER = 512.0
# Largest q for which sin(pi q)/q is computed directly, because a matrix product of sines would lose
# digits.
_NEAR = 0.1
# Number of values in a temporary array that fits into the cache of a core.
_BLOCK = 1 << 14
# Largest matrix product [multiplications] that BLAS does not divide among threads, and smallest
# number of rows of a product. On a busy machine, threads take up to a hundred times as long;
# dividing a product into these smaller products costs only a tenth more.
_SERIAL_PRODUCT, _LEAST_ROWS = 1 << 18, 4
# Largest number of edges whose waves are in memory at the same time. These waves take about 40 MB
# for 512 x 512 points.
_MOST_EDGES = 1024
# Difference of edge vectors, in units of the frame, below which the vectors are treated as equal.
# Edges of congruent elements differ by rounding errors.
_EQUAL = 2.0**-51


@dataclass(frozen=True, eq=False)
class Family:
    """Parallel edges of equal length, with the vector (ex, ey) or its negative."""

    ex: float
    ey: float
    midpoints: npt.NDArray[np.float64]
    weights: npt.NDArray[np.complex128]
    """Field on the element of each edge, with the opposite sign for edges with the vector -(ex,
    ey). Shape (n,)."""

    @property
    def is_straight(self) -> bool:
        """Whether the edges are parallel to an axis of the frame."""
        return self.ex == 0.0 or self.ey == 0.0


def families_of(edges: Sequence[Sequence[float]], field: npt.ArrayLike = 1.0) -> tuple[Family, ...]:
    """Group the edges of a polygon into families of parallel edges of equal length.

    The first four numbers of an edge are its start and its end. ``field`` is the field on the
    element of each edge.
    """
    corners = np.array(edges)
    begin, end = corners[:, :2], corners[:, 2:4]
    vectors, midpoints = end - begin, (begin + end) / 2
    vectors[np.abs(vectors) <= _EQUAL] = 0.0
    backwards = (vectors[:, 1] < 0) | ((vectors[:, 1] == 0) & (vectors[:, 0] < 0))
    signs = np.where(backwards, -1.0, 1.0)
    weights = signs * np.asarray(field, np.complex128)
    vectors *= signs[:, None]
    families = []
    number = cluster_indices(vectors, _EQUAL)
    for members in np.split(np.argsort(number), np.cumsum(np.bincount(number))[:-1]):
        ex, ey = vectors[members].mean(axis=0).tolist()
        for block in (members[k : k + _MOST_EDGES] for k in range(0, len(members), _MOST_EDGES)):
            families.append(Family(ex, ey, midpoints[block], weights[block]))
    return tuple(families)


@dataclass(frozen=True)
class GridTables:
    """Edges of a polygon, for the Fourier transform on grids of frequencies."""

    frame: Frame
    families: tuple[Family, ...]
    terms: int
    """Number of edges of the polygon."""
    perimeter_over_area: float

    @property
    def scales(self) -> tuple[float, float]:
        """Factors that convert the user's nu_x and nu_y to frequencies in the frame."""
        return self.frame.rows[0][0], self.frame.rows[1][1]

    @property
    def floor(self) -> float:
        """Smallest frequency in the frame for which the sum over edges on a grid is accurate."""
        return self.perimeter_over_area * _ULP / (2 * math.pi * _LOSS)


def grid_tables(tables: OutlineTables, field: Sequence[complex]) -> GridTables | None:
    """Return the edges of an outline for the Fourier transform on grids of frequencies.

    ``field`` is the field on the element of each edge. The result is None for slender outlines and
    rotated frames.
    """
    if not tables.frame.is_diagonal:
        return None
    families = families_of(tables.edges, field)
    perimeter = sum(float(np.abs(f.weights).sum()) * math.hypot(f.ex, f.ey) for f in families)
    area = sum(abs(w) * edge[-1] for w, edge in zip(field, tables.edges, strict=True)) / 2
    if not perimeter * math.hypot(*tables.frame.reach) < _MOST_SLENDER * area:
        return None
    return GridTables(tables.frame, families, len(tables.edges), perimeter / area)


class _FamilyTerm:
    """Contribution of a family of edges to the Fourier transform on a grid of frequencies, (F4).

    The contribution is pi (nu x e) sinc(nu.e), where e is the vector of the edges, times the sum of
    the waves at all midpoints. The sum of the waves is a matrix product. ``x`` and ``y`` contain
    the frequencies along each axis in the frame, and the phase of the centre in cycles.
    """

    def __init__(self, ops: Any, family: Family, x: Values, y: Values) -> None:
        self.ops = ops
        (nu_x, turns_x), (nu_y, turns_y) = x, y
        points = family.midpoints
        cos_x, sin_x = cos_sin_cycles(ops, nu_x[:, None] * points[:, 0] + turns_x[:, None])
        cos_y, sin_y = cos_sin_cycles(ops, nu_y[:, None] * points[:, 1] + turns_y[:, None])
        real, imag = family.weights.real, family.weights.imag
        cos_x, sin_x = cos_x * real + sin_x * imag, sin_x * real - cos_x * imag
        self.is_straight = family.is_straight
        # For edges parallel to an axis, the factor is a product of functions of nu_x and nu_y.
        if self.is_straight:
            along_x = family.ey == 0.0
            factor_x = -family.ex * math.pi * sinc(ops, nu_x * family.ex) if along_x else nu_x
            factor_y = nu_y if along_x else family.ey * math.pi * sinc(ops, nu_y * family.ey)
            cos_x, sin_x = cos_x * factor_x[:, None], sin_x * factor_x[:, None]
            cos_y, sin_y = cos_y * factor_y[:, None], sin_y * factor_y[:, None]
        self.left = np.concatenate([cos_x, sin_x], axis=1)
        self.right = np.block([[cos_y.T, sin_y.T], [-sin_y.T, cos_y.T]])
        # For oblique edges, nu.e and cross(nu, e) are sums of functions of nu_x and nu_y, and
        # sin(pi nu.e) is a matrix product.
        self.q = nu_x * family.ex, nu_y * family.ey
        self.c = nu_x * family.ey, nu_y * family.ex
        cos_x, sin_x = cos_sin_cycles(ops, 0.5 * nu_x * family.ex)
        cos_y, sin_y = cos_sin_cycles(ops, 0.5 * nu_y * family.ey)
        self.sines = np.stack([sin_x, cos_x], axis=1), np.stack([cos_y, sin_y])

    def rows(self, rows: slice) -> Array:
        """Return sums of cosines and sines at some nu_x and all nu_y, shape (rows, 2, n).

        The sums include all factors of the contribution.
        """
        if self.is_straight:
            return self._waves(self.left[rows])
        q = self.q[0][rows, None] + self.q[1]
        factor = self._sinc(q, rows)
        np.subtract(self.c[0][rows, None], self.c[1], out=q)
        factor *= q
        waves = self._waves(self.left[rows])
        waves *= factor[:, None, :]
        return waves

    def _waves(self, left: Array) -> Array:
        """Return the products of rows of ``left`` with ``right``, shape (rows, 2, columns)."""
        product = np.empty((len(left), self.right.shape[1]))
        count = _SERIAL_PRODUCT // self.right.size // _LEAST_ROWS * _LEAST_ROWS
        stacked = len(left) // count * count if count else 0
        if stacked:
            np.matmul(
                left[:stacked].reshape(-1, count, left.shape[1]),
                self.right,
                out=product[:stacked].reshape(-1, count, product.shape[1]),
            )
        np.matmul(left[stacked:], self.right, out=product[stacked:])
        return product.reshape(len(product), 2, -1)

    def _sinc(self, q: Array, rows: slice) -> Array:
        """Return pi sinc(q) for q = nu.e at some nu_x and all nu_y."""
        is_near = np.abs(q) < _NEAR
        if is_near.all():
            return np.asarray(math.pi * np.sinc(q))
        near = np.flatnonzero(is_near)
        quotient = self.sines[0][rows] @ self.sines[1]
        quotient /= q
        quotient.ravel()[near] = math.pi * np.sinc(q.ravel()[near])
        return quotient


def fourier_on_grid(
    ops: Any, tables: GridTables, nu_x: Array, nu_y: Array
) -> tuple[Array, Array, Array]:
    """Return the real and imaginary part of the Fourier transform on a grid, and a mask.

    The transform includes ``frame.measure`` and the phase of the centre. ``nu_x`` and ``nu_y`` are
    the axes of the grid in 1/m, and all results have the shape (len(nu_x), len(nu_y)). The mask is
    true for inaccurate values, because (F4) is inaccurate below `GridTables.floor`. The operations
    ``ops`` must be in float64.
    """
    x, y = (
        (nu * scale, phases.cycles_to_centre(ops, (centre,), nu))
        for nu, scale, centre in zip((nu_x, nu_y), tables.scales, tables.frame.centre, strict=True)
    )
    shape = len(x[0]), len(y[0])
    real, imag, below = np.empty(shape), np.empty(shape), np.zeros(shape, bool)
    blocks = index_blocks(shape[0], _BLOCK // shape[1])
    sums = np.zeros((shape[0], 2, shape[1]))
    for batch in _batches(tables.families):
        first, *others = _joined([_FamilyTerm(ops, family, x, y) for family in batch])
        for rows in blocks:
            total = first.rows(rows)
            for term in others:
                total += term.rows(rows)
            sums[rows] += total
    for rows in blocks:
        square = x[0][rows, None] ** 2 + y[0] ** 2
        below[rows] = square < tables.floor**2
        square[below[rows]] = 1.0
        scale = (tables.frame.measure / (2 * math.pi**2)) / square
        real[rows], imag[rows] = sums[rows, 1] * scale, sums[rows, 0] * scale
    return real, imag, below


def _joined(terms: list[_FamilyTerm]) -> list[_FamilyTerm]:
    """Return the terms, with all edges parallel to the axes combined into one term."""
    straight = [term for term in terms if term.is_straight]
    if straight:
        straight[0].left = np.concatenate([term.left for term in straight], axis=1)
        straight[0].right = np.concatenate([term.right for term in straight])
    return [*straight[:1], *(term for term in terms if not term.is_straight)]


def _batches(families: Sequence[Family]) -> Iterator[list[Family]]:
    """Yield families in groups with up to ``_MOST_EDGES`` edges."""
    batch: list[Family] = []
    for family in families:
        if sum(len(f.weights) for f in (*batch, family)) > _MOST_EDGES and batch:
            yield batch
            batch = []
        batch.append(family)
    yield batch
