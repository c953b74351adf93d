"""Fourier transforms as sums over simplices that tile a source, each with its own exact phase.

A fan around one origin covers a thin shape many times over with either sign, and loses as many
digits. The terms of a tiling are all positive at nu = 0; each has its own corner, whose phase nu.p
is an error-free product, and its own vectors from there. So no digits are lost for thin, long or
scattered sources. Slits always use this method, and so do apertures whose fan would cancel
(docs/theory.md, (F5), (S1)).

A body is the signed sum of the tetrahedra (origin, a, b, c) over the triangles of its faces' fans.
Each contributes ``det(a, b, c) exp[0, z_a, z_b, z_c]`` with z = -2 pi i nu.p: no division by nu, no
face normals, and non-convex faces need no triangulation (docs/theory.md, (F3)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits, triangulate
from polywigner.geometry.rings import whole_numbers
from polywigner.kernels.functions.fourier import LinearFrame
from polywigner.kernels.functions.plane import fourier_kernels, placed_frame
from polywigner.kernels.kernel import Values
from polywigner.kernels.outline.frame import (
    NEEDLE_ASPECT,
    Matrix,
    determinant,
    frame_of,
    power_of_two,
    reach_of,
    times_doubled,
    vertices_for,
)
from polywigner.numerics import Number, phases
from polywigner.numerics.complex_pairs import Pair, unit_wave
from polywigner.numerics.divided_differences import simplex_complex_wave, simplex_plane_wave
from polywigner.numerics.phases import Doubled, doubled

# A fan's terms are rounded to ulps of (perimeter times half the diameter) and not of the area: up
# to here that costs 3e-14 of the area (2e-16 each, measured), and a fan has fewer terms.
_MOST_CANCELLING = 128.0


@dataclass(frozen=True)
class SimplexTables:
    """A tiling in a frame of uniform scale; sums run over ``edges``, the simplices.

    An interval or a triangle: a corner and the vectors to the others, each component as two floats,
    and the length or twice the area.
    """

    frame: Any
    edges: tuple[tuple[float, ...], ...]


def _frame_around(points: Any) -> LinearFrame:
    """The frame of points (n, d) whose scale, one for all axes, is a power of two."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low) / 2
    scale = power_of_two(float(np.linalg.norm(high - low)))
    centre, reach = (low + half).tolist(), (half / scale).tolist()
    rows = tuple(tuple(row) for row in (scale * np.eye(len(centre))).tolist())
    return LinearFrame(tuple(centre), rows, scale ** len(centre), tuple(reach))


@lru_cache(maxsize=256)
def fan_cancels(aperture: Aperture) -> bool:
    """Whether the aperture is so thin, even if stretched, that a fan of triangles loses digits."""
    frame = frame_of(np.concatenate(aperture.rings))
    rings = [frame.vertices(ring) for ring in aperture.rings]
    perimeter = sum(np.hypot(*(ring - np.roll(ring, 1, axis=0)).T).sum() for ring in rings)
    lever = math.hypot(*frame.reach)
    return bool(perimeter * lever > 2 * aperture.area / frame.content * _MOST_CANCELLING)


@lru_cache(maxsize=256)
def _interval_tables(slits: Slits, double: bool) -> SimplexTables:
    ends = slits.intervals.reshape(-1, 1)
    return _simplex_tables(ends, np.arange(len(ends)).reshape(-1, 2), double)


@lru_cache(maxsize=256)
def _triangle_tables(aperture: Aperture, double: bool) -> SimplexTables:
    return _simplex_tables(*triangulate(aperture), double)


def _simplex_tables(points: Any, simplices: Any, double: bool) -> SimplexTables:
    """The tables of simplices (k, d + 1), numbers of their corners among points (n, d)."""
    frame = _frame_around(points)
    centre, scale = [Fraction(c) for c in frame.centre], Fraction(frame.rows[0][0])
    exact = [
        [(Fraction(x) - c) / scale for x, c in zip(point, centre, strict=True)]
        for point in points.tolist()
    ]
    rows = []
    for first, *others in simplices.tolist():
        corner = exact[first]
        vectors = [[x - c for x, c in zip(exact[k], corner, strict=True)] for k in others]
        numbers = [number for vector in (corner, *vectors) for number in vector]
        parts = (part for number in numbers for part in doubled(number, double))
        rows.append((*parts, float(determinant(vectors))))
    return SimplexTables(frame, tuple(row for row in rows if row[-1]))


@lru_cache(maxsize=256)
def _placed_tables(source: PlacedAperture, double: bool) -> SimplexTables:
    plane = _triangle_tables(source.aperture, double)
    return SimplexTables(placed_frame(plane.frame, source.pose, double), plane.edges)


def _enter(ops: Any, frame: Any, *nu: Any) -> Values:
    """(phase of the centre, the components of nu in the frame as two floats each)."""
    return (phases.turns_to_centre(ops, frame.centre, *nu), *_in_frame(ops, frame, nu))


def _enter_complex(ops: Any, frame: Any, *nu: Any) -> Values:
    """(phase and growth of the centre, real and then imaginary parts of nu as two floats each)."""
    real, imag = nu[0::2], nu[1::2]
    turns = phases.turns_to_centre(ops, frame.centre, *real)
    inner = _in_frame(ops, frame, imag)
    growth = phases.growth_of(ops, frame, inner[0::2], *imag)
    return (turns, growth, *_in_frame(ops, frame, real), *inner)


def _in_frame(ops: Any, frame: Any, nu: Values) -> Values:
    pairs = (phases.halves(ops, number) for number in times_doubled(ops, frame.rows, *nu))
    return tuple(part for pair in pairs for part in pair)


def _pairs(values: Values) -> tuple[Doubled, ...]:
    return tuple(zip(values[0::2], values[1::2], strict=True))


def _dot(ops: Any, nu: tuple[Doubled, ...], vector: tuple[Doubled, ...]) -> Number:
    total, rest = phases.dot(ops, nu, vector)
    return total + rest


def _sum(ops: Any, tables: SimplexTables, turns: Any, *nu: Any) -> Values:
    frequency = _pairs(nu)

    def term(*row: Any) -> Values:
        corner, *vectors = _vectors(row, len(frequency))
        wave = simplex_plane_wave(ops, *(_dot(ops, frequency, vector) for vector in vectors))
        phase = phases.reduced(ops, phases.dot(ops, frequency, corner))
        real, imag = phases.rotated(ops, phase, *wave)
        return real * row[-1], -imag * row[-1]

    total: Values = ops.sum_over(tables.edges, term, 2, like=nu[0])
    return total


def _complex_sum(ops: Any, tables: SimplexTables, turns: Any, growth: Any, *nu: Any) -> Values:
    numbers = _pairs(nu)
    real, imag = numbers[: len(numbers) // 2], numbers[len(numbers) // 2 :]
    highest = phases.level(tables.frame, tuple(high for high, _ in imag))

    def term(*row: Any) -> Values:
        corner, *vectors = _vectors(row, len(real))
        phase = phases.reduced(ops, phases.dot(ops, real, corner))
        turns = (Pair(_dot(ops, real, vector), _dot(ops, imag, vector)) for vector in vectors)
        wave = simplex_complex_wave(ops, *turns, level=highest - _dot(ops, imag, corner))
        total = (unit_wave(ops, phase).conjugate() * wave).scaled(row[-1])
        return total.real, total.imag

    total: Values = ops.sum_over(tables.edges, term, 2, like=nu[0])
    return total


def _vectors(row: Values, dimension: int) -> list[tuple[Doubled, ...]]:
    """The corner of a simplex and the vectors from there to the others."""
    size = 2 * dimension
    return [_pairs(row[k : k + size]) for k in range(0, size * (dimension + 1), size)]


_STEPS = (_enter, _enter_complex), (_sum, _complex_sum)
SLITS, SLITS_COMPLEX = fourier_kernels("fourier of slits", 1, _interval_tables, *_STEPS)
TILED, TILED_COMPLEX = fourier_kernels("fourier, tiled", 2, _triangle_tables, *_STEPS)
TILED_PLACED, TILED_PLACED_COMPLEX = fourier_kernels(
    "fourier in space, tiled", 3, _placed_tables, *_STEPS
)


# ---- polyhedra -------------------------------------------------------------------------------


@dataclass(frozen=True)
class SolidTables:
    """The body in its frame; sums run over ``edges``.

    Each is a tetrahedron: ax, ay, az, bx, ..., cz, and det(a, b, c), six times its signed volume.
    """

    frame: LinearFrame
    edges: tuple[tuple[float, ...], ...]

    @property
    def terms(self) -> int:
        """Number of terms, for the choice of an engine: a tetrahedron counts as eight edges."""
        return 8 * len(self.edges)


@lru_cache(maxsize=64)
def solid_tables(body: Polyhedron, double: bool) -> SolidTables:
    """The tables of a polyhedron; the same for either precision."""
    centre, rows = _axes(body)
    inner = vertices_for(rows, centre, body.vertices)
    # signed fans: opposite faces of thin bodies are split alike, so that their errors cancel
    fans = [(f[0], f[k], f[k + 1]) for f in body.faces for k in range(1, len(f) - 1)]
    corners = inner[np.array(fans, np.intp)]
    tetrahedra = np.column_stack([corners.reshape(-1, 9), _volumes(corners)]).tolist()
    content = abs(float(determinant([[Fraction(m) for m in row] for row in rows])))
    frame = LinearFrame(centre, rows, content, reach_of(inner))
    return SolidTables(frame, tuple(tuple(row) for row in tetrahedra if row[-1]))


def _axes(body: Polyhedron) -> tuple[tuple[float, float, float], Matrix]:
    """The centre of the body's box, and its axes as rows times the power of two of its extents.

    World axes and one scale for all, unless the body is a needle or a plate. The box is that along
    these axes: the centre of another one would lie far outside a plate, in units of its thickness.
    """
    mean = body.vertices.mean(axis=0)
    # without full_matrices=False, NumPy makes a matrix of vertices times vertices.
    _, _, principal = np.linalg.svd(body.vertices - mean, full_matrices=False)
    # right-handed, so that volumes keep their sign
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
    """det(a, b, c) of each row of corners (n, 3, 3), correctly rounded."""
    integers, exponent = whole_numbers(corners)
    exact: Any = determinant(list(np.moveaxis(integers, 0, 2)))
    scale = 1 << abs(3 * exponent)
    return np.asarray(exact / scale if exponent < 0 else exact * scale, dtype=np.float64)


BODY, BODY_COMPLEX = fourier_kernels("fourier of a body", 3, solid_tables)
