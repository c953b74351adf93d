"""Fourier transforms as sums over simplices that tile a source, each with its own exact phase.

A fan around one origin covers what is thin many times over with either sign, and loses as many
digits. The terms of a tiling are all positive at nu = 0; each has its own corner, whose phase nu.p
is an error-free product, and its own vectors from there. So nothing is lost however thin, long or
scattered the source is: slits always, and apertures whose fan would cancel, go this way
(docs/theory.md, (F5), (S1)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from polywigner.geometry import Aperture, PlacedAperture, Slits, triangulate
from polywigner.kernels.functions.plane import placed_frame
from polywigner.kernels.kernel import Kernel, Values, leave_complex, leave_wave
from polywigner.kernels.outline.frame import Matrix, frame_of, power_of_two, times_doubled
from polywigner.numerics import phases
from polywigner.numerics.complex_pairs import Pair, mean_wave
from polywigner.numerics.divided_differences import simplex_complex_wave, simplex_plane_wave
from polywigner.numerics.phases import Doubled, cos_sin_turns, doubled, sinc

# A fan's terms are rounded to ulps of (perimeter times half the diameter) and not of the area: up
# to here that costs 3e-14 of the area (2e-16 each, measured), and a fan has fewer terms.
_MOST_CANCELLING = 128.0

Row = tuple[float, ...]


@dataclass(frozen=True)
class SimplexTables:
    """A tiling in a frame of uniform scale; ``edges`` are what a sum runs over, the simplices.

    An interval: its middle as two floats and its length. A triangle: a corner and the two vectors
    to the others, each component as two floats, and twice the area.
    """

    frame: Any
    edges: tuple[Row, ...]


@dataclass(frozen=True)
class UniformFrame:
    """x' = (x - centre)/scale, nu' = scale nu; the scale is a power of two."""

    centre: tuple[float, ...]
    scale: float
    reach: tuple[float, ...]

    @property
    def content(self) -> float:
        return self.scale ** len(self.centre)

    @property
    def rows(self) -> Matrix:
        n = len(self.centre)
        return tuple(tuple(self.scale * (i == j) for j in range(n)) for i in range(n))


def _frame_around(points: Any) -> UniformFrame:
    """The frame of points (n, d)."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low) / 2
    scale = power_of_two(float(np.linalg.norm(high - low)))
    centre, reach = (low + half).tolist(), (half / scale).tolist()
    return UniformFrame(tuple(centre), scale, tuple(reach))


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
    frame = _frame_around(slits.intervals.reshape(-1, 1))
    rows = []
    for (a,), (b,) in np.reshape(_inside(frame, slits.intervals.reshape(-1, 1)), (-1, 2, 1)):
        rows.append((*doubled((a + b) / 2, double), float(b - a)))
    return SimplexTables(frame, tuple(rows))


@lru_cache(maxsize=256)
def _triangle_tables(aperture: Aperture, double: bool) -> SimplexTables:
    vertices, triangles = triangulate(aperture)
    frame = _frame_around(vertices)
    exact = _inside(frame, vertices)
    rows = []
    for p, q, r in (exact[corners] for corners in triangles):
        a, b = q - p, r - p
        parts = [part for v in (*p, *a, *b) for part in doubled(v, double)]
        rows.append((*parts, float(a[0] * b[1] - a[1] * b[0])))
    return SimplexTables(frame, tuple(row for row in rows if row[-1]))


def _inside(frame: UniformFrame, points: Any) -> Any:
    """Points (n, d) in the frame as fractions."""
    centre, scale = [Fraction(c) for c in frame.centre], Fraction(frame.scale)
    exact = [
        [(Fraction(x) - c) / scale for x, c in zip(point, centre, strict=True)]
        for point in points.tolist()
    ]
    return np.array(exact, dtype=object)


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


def _dot(ops: Any, nu: tuple[Doubled, ...], vector: tuple[Doubled, ...]) -> Any:
    total, rest = phases.dot(ops, nu, vector)
    return total + rest


def _interval_sum(ops: Any, tables: SimplexTables, turns: Any, *nu: Any) -> Values:
    frequency = _pairs(nu)

    def term(middle: Any, rest: Any, length: Any) -> Values:
        mean = sinc(ops, _dot(ops, frequency, ((length, 0.0),)))
        phase = phases.reduced(ops, phases.dot(ops, frequency, ((middle, rest),)))
        cosine, sine = cos_sin_turns(ops, phase)
        return cosine * mean * length, sine * mean * length

    return ops.sum_over(tables.edges, term, 2, like=nu[0])


def _triangle_sum(ops: Any, tables: SimplexTables, turns: Any, *nu: Any) -> Values:
    frequency = _pairs(nu)

    def term(*row: Any) -> Values:
        corner, first, second = (_pairs(row[k : k + 4]) for k in (0, 4, 8))
        wave = simplex_plane_wave(ops, _dot(ops, frequency, first), _dot(ops, frequency, second))
        phase = phases.reduced(ops, phases.dot(ops, frequency, corner))
        real, imag = phases.rotated(ops, phase, *wave)
        return real * row[12], -imag * row[12]

    return ops.sum_over(tables.edges, term, 2, like=nu[0])


def _complex_interval_sum(
    ops: Any, tables: SimplexTables, turns: Any, growth: Any, *nu: Any
) -> Values:
    wave_at = _ComplexWaves(ops, tables.frame, nu)

    def term(middle: Any, rest: Any, length: Any) -> Values:
        half = wave_at.turns(((length, 0.0),)).scaled(0.5)
        phase, level = wave_at.phase_and_level(((middle, rest),))
        total = (phase * mean_wave(ops, Pair(-half.real, -half.imag), half, level)).scaled(length)
        return total.real, total.imag

    return ops.sum_over(tables.edges, term, 2, like=nu[0])


def _complex_triangle_sum(
    ops: Any, tables: SimplexTables, turns: Any, growth: Any, *nu: Any
) -> Values:
    wave_at = _ComplexWaves(ops, tables.frame, nu)

    def term(*row: Any) -> Values:
        corner, first, second = (_pairs(row[k : k + 4]) for k in (0, 4, 8))
        phase, level = wave_at.phase_and_level(corner)
        wave = simplex_complex_wave(ops, wave_at.turns(first), wave_at.turns(second), level=level)
        total = (phase * wave).scaled(row[12])
        return total.real, total.imag

    return ops.sum_over(tables.edges, term, 2, like=nu[0])


class _ComplexWaves:
    """A complex frequency, and the phases that points have under it."""

    def __init__(self, ops: Any, frame: Any, nu: Values) -> None:
        self._ops = ops
        half = len(nu) // 2
        self._real, self._imag = _pairs(nu[:half]), _pairs(nu[half:])
        self._level = phases.level(frame, tuple(high for high, _ in self._imag))

    def turns(self, vector: tuple[Doubled, ...]) -> Pair:
        """nu.vector."""
        return Pair(_dot(self._ops, self._real, vector), _dot(self._ops, self._imag, vector))

    def phase_and_level(self, corner: tuple[Doubled, ...]) -> tuple[Pair, Any]:
        """exp(-2 pi i Re(nu).corner), and the level that is left for waves from there."""
        phase = phases.reduced(self._ops, phases.dot(self._ops, self._real, corner))
        cosine, sine = cos_sin_turns(self._ops, phase)
        return Pair(cosine, -sine), self._level - _dot(self._ops, self._imag, corner)


SLITS = Kernel("fourier of slits", 1, _interval_tables, _enter, _interval_sum, leave_wave)
SLITS_COMPLEX = Kernel(
    "fourier of slits, complex nu",
    1,
    _interval_tables,
    _enter_complex,
    _complex_interval_sum,
    leave_complex,
)
TILED = Kernel("fourier, tiled", 2, _triangle_tables, _enter, _triangle_sum, leave_wave)
TILED_COMPLEX = Kernel(
    "fourier, tiled, complex nu",
    2,
    _triangle_tables,
    _enter_complex,
    _complex_triangle_sum,
    leave_complex,
)
TILED_PLACED = Kernel(
    "fourier in space, tiled", 3, _placed_tables, _enter, _triangle_sum, leave_wave
)
TILED_PLACED_COMPLEX = Kernel(
    "fourier in space, tiled, complex nu",
    3,
    _placed_tables,
    _enter_complex,
    _complex_triangle_sum,
    leave_complex,
)
