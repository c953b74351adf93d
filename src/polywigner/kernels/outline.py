"""Edges, weights and fields of a source, in normalised coordinates.

The normalised coordinates, called the frame of the source, are centred and scaled to about unit
size. Long, narrow outlines are also rotated to their axes and stretched, so an aspect ratio of 1e-6
is as accurate as a square. Vertices are converted with the exact inverse of the float matrix that
converts frequencies. With a rounded inverse, the ends of a narrow outline would move by many ulps
of its width.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from operator import mul, sub
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from polywigner.geometry import Aperture
from polywigner.geometry.rings import whole_numbers
from polywigner.kernels.wave_pairs import (
    UNIFORM,
    Waves,
    carrier_of,
    difference_pairs,
    waves_in_frame,
)
from polywigner.numerics import Floats, phases
from polywigner.source.normal_form import Source

# Aspect ratio above which frames are rotated and stretched. At smaller aspect ratios, the rounding
# errors of the frame are smaller than the rounding errors of the kernels.
NEEDLE_ASPECT = 8.0

Matrix = tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class Frame:
    """Normalised coordinates of a source in d = 2 dimensions, or d = 1 for slits.

    A position x has the coordinates ``matrix (x - centre) / norm`` in the frame, and a frequency nu
    has the components ``rows nu``. The matrix ``rows`` is exactly the inverse transpose of ``matrix
    / norm``. ``measure`` is the area of a unit square of the frame in the user's units. ``reach``
    contains the largest absolute coordinates of the source in the frame.
    """

    centre: tuple[float, ...]
    matrix: Matrix
    rows: Matrix
    norm: float
    measure: float
    reach: tuple[float, ...]
    carrier: tuple[float, ...] = (0.0, 0.0)
    """Frequency of the carrier, in the user's units. Stored fields are relative to the carrier."""

    def position(self, ops: Any, *x: Any) -> tuple[Any, ...]:
        """Return the coordinates of a point of the aperture plane in the frame."""
        # For a long, narrow outline, the products in ``vector`` cancel almost completely, so
        # rounding errors of the differences matter.
        subtract: Any = sub if self.is_diagonal else phases.difference
        return self.vector(ops, *map(subtract, x, self.centre))

    @cached_property
    def is_diagonal(self) -> bool:
        """Whether the axes of the frame are parallel to the user's axes."""
        return _diagonal(self.matrix) is not None

    def grid_step(self, double: bool) -> float:
        """Return the grid spacing of vertices and offsets in the frame, a power of two.

        An offset minus two vertices is at most four times the largest coordinate of the source, and
        is exact in float64 or float32 on this grid.
        """
        return power_of_two(4.001 * max(self.reach)) * 2.0 ** (-53 if double else -24)

    def vector(self, ops: Any, *x: Any) -> tuple[Any, ...]:
        """Return the components of a difference of two points in the frame."""
        components = matrix_times(ops, self.matrix, *x)
        if self.is_diagonal:
            return components
        return tuple(component * (1 / self.norm) for component in components)

    def frequency(self, ops: Any, *nu: Any) -> tuple[Any, ...]:
        """Return the components of a spatial frequency in the frame."""
        return matrix_times(ops, self.rows, *nu)

    def detuned(self, ops: Any, *nu: Any) -> tuple[Any, ...]:
        """Return the components of a spatial frequency minus the carrier frequency in the frame."""
        if any(self.carrier):
            nu = tuple(n - c if c else n for n, c in zip(nu, self.carrier, strict=True))
        return self.frequency(ops, *nu)

    def exact_frequency(self, *nu: float) -> tuple[float, ...]:
        """Return the correctly rounded components of a constant frequency in the frame."""
        rows = [[Fraction(m) for m in row] for row in self.rows]
        exact = [Fraction(n) for n in nu]
        return tuple(float(sum(m * n for m, n in zip(row, exact, strict=True))) for row in rows)

    def vertices(self, points: Floats) -> Floats:
        """Return the correctly rounded coordinates of points in the frame, shape (n, 2)."""
        return vertices_for(self.rows, self.centre, points)


def enter_position_and_frequency(
    ops: Any, frame: Frame, x: Any, y: Any, nu_x: Any, nu_y: Any
) -> tuple[Any, ...]:
    """Return the position, and the frequency minus the carrier, in the frame."""
    return (*frame.position(ops, x, y), *frame.detuned(ops, nu_x, nu_y))


def matrix_times(ops: Any, matrix: Matrix, *nu: Any) -> tuple[Any, ...]:
    """Return the product of a matrix and a frequency, accurate to about an ulp.

    If the matrix is not diagonal, its entries and the components of the frequency may be `Doubled`.
    """
    diagonal = _diagonal(matrix)
    if diagonal is not None:
        return tuple(map(mul, nu, diagonal))
    return tuple(total + low for total, low in (phases.dot(ops, nu, row) for row in matrix))


def vertices_for(matrix: Matrix, centre: Sequence[float], points: Floats) -> Floats:
    """Return the correctly rounded coordinates of points in a frame, shape (n, d).

    ``matrix`` converts frequencies to the frame. The product (matrix nu).x', where x' are the
    returned coordinates, equals nu.(x - centre) for each frequency nu and point x.
    """
    diagonal = _diagonal(matrix)
    if diagonal is not None:
        return (points - np.asarray(centre)) / np.asarray(diagonal)
    points, exponent = whole_numbers(np.vstack([np.asarray(centre, np.float64), points]))
    rows, row_exponent = whole_numbers(np.asarray(matrix, np.float64))
    cofactors, divisor = _cofactors(rows.tolist()), determinant(rows.tolist())
    sums = (points[1:] - points[0]) @ np.array(cofactors, dtype=object).T
    power = exponent - row_exponent
    if power < 0:
        divisor <<= -power
    # Python rounds the quotient of two integers only once.
    return ((sums << max(power, 0)) / divisor).astype(np.float64)


def _cofactors(matrix: list[list[int]]) -> list[list[int]]:
    """Return the matrix of the cofactors of an integer matrix."""
    n = len(matrix)

    def cofactor(i: int, j: int) -> int:
        """Return the signed minor without row ``i`` and column ``j``."""
        minor = [[matrix[a][b] for b in range(n) if b != j] for a in range(n) if a != i]
        return (-1) ** (i + j) * int(determinant(minor))

    return [[cofactor(i, j) for j in range(n)] for i in range(n)]


def determinant(matrix: Sequence[Sequence[Any]]) -> Any:
    """Return the determinant of a matrix. The result is exact if the entries are exact numbers."""
    if len(matrix) == 1:
        return matrix[0][0]
    minors = ([[*row[:k], *row[k + 1 :]] for row in matrix[1:]] for k in range(len(matrix)))
    return sum(
        (-1) ** k * first * determinant(minor)
        for k, (first, minor) in enumerate(zip(matrix[0], minors, strict=True))
    )


@lru_cache(maxsize=256)
def _diagonal(matrix: Matrix) -> tuple[Any, ...] | None:
    """Return the diagonal if all entries off the diagonal are the constant 0.0, otherwise None."""
    others = (value for i, row in enumerate(matrix) for j, value in enumerate(row) if i != j)
    if all(isinstance(value, float) and value == 0.0 for value in others):
        return tuple(row[k] for k, row in enumerate(matrix))
    return None


def frame_of(points: Floats) -> Frame:
    """Return the frame of three or more points, shape (n, 2), that are not collinear."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre = low + (high - low) / 2
    corners = shapely.get_coordinates(shapely.oriented_envelope(shapely.MultiPoint(points)))
    sides = np.diff(corners[:3], axis=0)
    lengths = np.hypot(sides[:, 0], sides[:, 1])
    long, short = int(lengths.argmax()), int(lengths.argmin())
    length = width = power_of_two(float(np.hypot(*lengths)))
    c, s = 1.0, 0.0
    if lengths[long] > NEEDLE_ASPECT * lengths[short] > 0.0:
        c, s = (sides[long] / lengths[long]).tolist()
        length, width = power_of_two(lengths[long]), power_of_two(lengths[short])
        if c == 0.0:
            # An outline along the y axis needs no rotation.
            (c, s), (length, width) = (1.0, 0.0), (width, length)
    return frame_along(points, centre, (c, s), (length, width))


def frame_along(
    points: Floats, centre: Floats, direction: tuple[float, float], sizes: tuple[float, float]
) -> Frame:
    """Return the frame with the specified direction of its first axis.

    The ``reach`` of the frame is computed from ``points`` (n, 2). ``sizes`` are the units of length
    along the two axes, which must be powers of two.
    """
    (c, s), (length, width) = direction, sizes
    norm = c * c + s * s
    matrix = ((c / length, s / length), (-s / width, c / width))
    rows = ((c * length, s * length), (-s * width, c * width))
    origin = (float(centre[0]), float(centre[1]))
    reach = tuple(np.abs(vertices_for(rows, origin, points)).max(axis=0).tolist())
    return Frame(origin, matrix, rows, norm, length * width * norm, reach)


def power_of_two(size: float) -> float:
    """Return the power of two by which ``size`` must be divided to lie between 1/2 and 1."""
    return math.ldexp(1.0, math.frexp(size)[1])


# Cost of each additional plane wave, in units of the cost of an edge pair.
_EDGES_PER_WAVE = 24
# Largest number of edges that are constants in compiled code. Such code is two to four times as
# fast as code that reads edges from memory, but takes 1 ms to compile for each edge pair and wave
# (benchmarks/wigner_cost.py).
_MOST_EDGES_AS_CODE = 16


# A comparison of all edges would be slow, so tables are compared by identity.
@dataclass(frozen=True, eq=False)
class Tables:
    """Edges, weights and fields of a coherent source, in the frame of the source."""

    frame: Frame
    edges: Floats
    """Start and end of each edge, and complex weight of its element. Shape (n, 6)."""
    names: npt.NDArray[np.intp]
    """Indices of the start vertex, the end vertex, the element and the group of each edge. Shape
    (n, 4)."""
    apertures: tuple[Aperture, ...]
    weights: tuple[Any, ...]
    """Complex weight of each element, relative to the field of its group."""
    factors: tuple[complex, ...]
    """Ratio of the stored weight of each element to the user's weight."""
    groups: tuple[Waves, ...]
    """Plane waves of each group. A group contains the elements with the same field."""
    double: bool
    coherence: Any = None
    """Matrix that converts lags in the frame to coherence widths, or None for coherent light."""
    pairs: dict[Any, Any] = field(default_factory=dict, repr=False)
    """Cached edge pairs that can cross."""
    lists: dict[Any, Any] = field(default_factory=dict, repr=False)
    """Cached edge pairs for NumPy, one entry for W and one for A."""

    @cached_property
    def uniform(self) -> bool:
        """Whether all weights are 1."""
        return all(weight == 1.0 for weight in self.weights)

    @cached_property
    def phased(self) -> bool:
        """Whether any weight is complex."""
        return any(weight.imag for weight in self.weights)

    @cached_property
    def clips(self) -> int:
        """Cost of one slice, in units of the cost of an edge pair."""
        return len(self.edges) * (len(self.edges) + _EDGES_PER_WAVE * (self.waves_per_cut - 1))

    @cached_property
    def waves_per_cut(self) -> int:
        """Number of plane waves that are integrated along each part of an edge."""
        return max(
            sum(len(difference_pairs(waves, other)) for other in self.groups)
            for waves in self.groups
        )

    @cached_property
    def fits_code(self) -> bool:
        """Whether edges may be constants in compiled code: few edges, one wave, coherent light."""
        is_short = len(self.edges) <= _MOST_EDGES_AS_CODE and self.waves_per_cut == 1
        return is_short and self.coherence is None

    @cached_property
    def by_element(self) -> Tables:
        """Copy of these tables in which each element is a group with a weight of 1."""
        edges, names = self.edges.copy(), self.names.copy()
        edges[:, 4:], names[:, 3] = (1.0, 0.0), names[:, 2]
        group_of = dict(zip(self.names[:, 2].tolist(), self.names[:, 3].tolist(), strict=True))
        count = len(self.weights)
        groups = tuple(self.groups[group_of.get(k, 0)] for k in range(count))
        return replace(
            self,
            edges=edges,
            names=names,
            weights=(1.0,) * count,
            groups=groups,
            pairs={},
            lists={},
        )

    def mutual(self, real: Any, imag: Any, level: Any, level_imag: Any) -> tuple[Any, Any]:
        """Return the product of real + i imag and the conjugate of level + i level_imag."""
        if self.uniform:
            return level, 0.0
        if not self.phased:
            return real * level, 0.0
        return real * level + imag * level_imag, imag * level - real * level_imag


def build_tables(source: Source, *, double: bool) -> Tables:
    """Return the edges, weights and fields of a coherent source, for float64 or float32 kernels."""
    elements, groups = source.in_plane.elements, source.in_plane.groups
    frame = frame_of(np.concatenate([ring for element in elements for ring in element.rings]))
    first = [elements[group.members[0]].illumination for group in groups]
    frame = replace(frame, carrier=carrier_of(first, 2))
    factors, group_of = np.ones(len(elements), np.complex128), np.zeros(len(elements), np.intp)
    for number, group in enumerate(groups):
        factors[group.members], group_of[group.members] = group.factors, number
    weights = tuple((source.weights * factors).tolist())
    edges, names, vertices = [], [], 0
    for number, element in enumerate(elements):
        for ring in element.rings:
            start = frame.vertices(ring)
            index = vertices + np.arange(len(ring))
            end, following = (np.roll(values, -1, axis=0) for values in (start, index))
            weight = np.full((len(ring), 2), (weights[number].real, weights[number].imag))
            edges.append(np.hstack([start, end, weight]))
            same = np.full((len(ring), 2), (number, group_of[number]))
            names.append(np.column_stack([index, following, same]))
            vertices += len(ring)
    return Tables(
        frame,
        np.concatenate(edges),
        np.concatenate(names),
        tuple(element.shape for element in elements),
        weights,
        tuple(factors.tolist()),
        tuple(waves_in_frame(illumination, frame) for illumination in first),
        double,
    )


def is_plain(tables: Tables) -> bool:
    """Return whether a source is uniform and coherent, with weights of 1."""
    return tables.groups == (UNIFORM,) and tables.uniform and tables.coherence is None
