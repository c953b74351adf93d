"""The Fourier transform of any source keeps its digits: at all sizes and directions of nu."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from identities.cases import (
    content_of,
    require,
    split_in_three,
    tolerance_of,
    waves_of,
)
from polywigner import transforms
from polywigner.errors import ArgumentError, GeometryError
from polywigner.execution import Precision
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits
from polywigner.geometry.arguments import checked_count, checked_generator
from polywigner.transforms.extremes import corners_of

# Errors that the package promises, relative to the content.
_TOLERANCE = {"double": 1e-13, "single": 2e-6}
_DECADES = range(-15, 4)
# Angles off an edge or a face, in radians: closed forms are 0/0 at the first.
_TILTS = (0.0, 1e-16, 1e-14, 1e-12, 1e-8, 1e-4)
# |nu| D up to which the second-order limit is good to (2 pi 1e-5)^3/6 = 4e-14.
_SMALL = 1e-5
# Half an ulp of float64: of what the vertex formula is made of.
_ULP = 2.0**-53
_FAR = 1000.0  # diameters

Array = NDArray[Any]


Point = tuple[Fraction, ...]


@dataclass(frozen=True)
class _Simplex:
    """d! times the signed content, and the corners in the space of nu."""

    weight: Fraction
    corners: tuple[Point, ...]


@dataclass(frozen=True)
class _Case:
    source: Any
    nu: Array
    """(n, d), n/len(_DECADES) for each decade of |nu| D."""
    decade: Array
    keywords: dict[str, Any]
    tolerance: float

    @property
    def content(self) -> float:
        return content_of(self.source)

    @property
    def allowed(self) -> float:
        return self.tolerance * self.content

    def transform(self) -> Any:
        return transforms.fourier(self.source, self.nu, **self.keywords)


def assert_fourier_stable(
    source: Slits | Aperture | PlacedAperture | Polyhedron,
    *,
    points: int = 190,
    seed: int = 0,
    precision: Precision = None,
    engine: str = "auto",
    tolerance: float | None = None,
) -> None:
    """Raise an AssertionError unless F keeps its digits at any size and direction of nu.

    |nu| D runs over the decades from 1e-15 to 1e3, D the diameter; the directions are random ones,
    and those along and across edges and faces, up to 0 to 1e-4 radians. F must be Hermitian and
    nowhere larger than F(0), the content; approach its limit at small nu, which exact moments give;
    agree with the vertex formula where that keeps its digits, with the sum over parts of the source
    (triangles, tetrahedra, pieces of slits), and with that of the same source a thousand diameters
    away, but for an exactly known phase; and it must not change by more than nu does. Of a source
    with an illumination this is asked of its outline, and F must be the sum over its waves.

    Parameters
    ----------
    source: Slits, Aperture, placed aperture or Polyhedron.
    points: number of frequencies.
    seed: of the random directions.
    precision, engine: as for :func:`polywigner.fourier`.
    tolerance: relative to the content (and to sum |c_m| of its waves); by default 1e-13 in double
        and 2e-6 in single precision, and more for bodies with thin walls, by how many times their
        tetrahedra exceed their volume.

    Raises
    ------
    AssertionError: names the first law that does not hold, where, and the two values.
    ArgumentError: for anything but these sources.
    """
    if not isinstance(source, Slits | Aperture | PlacedAperture | Polyhedron):
        raise ArgumentError(
            "expected Slits, an Aperture, a placed aperture or a Polyhedron, got "
            f"{type(source).__name__}; check an array with assert_array_identities"
        )
    outline = _without_field(source)
    simplices = _simplices_of(outline)
    count = checked_count(points, "points", 1)
    nu, decade = _frequencies(corners_of(source), count, checked_generator(seed))
    factor = _cancellation(simplices) / 10 if isinstance(source, Polyhedron) else 1.0
    tolerance = tolerance_of(tolerance, _TOLERANCE, precision, factor)
    case = _Case(outline, nu, decade, {"precision": precision, "engine": engine}, tolerance)
    _is_bounded_and_hermitian(case)
    _has_its_limit_at_small_frequencies(case, simplices)
    _agrees_with_the_vertex_formula(case, simplices)
    _is_the_sum_over_parts(case, simplices)
    _has_only_another_phase_far_away(case)
    _is_continuous(case)
    if source != outline:
        _is_the_sum_over_waves(case, source)


def _without_field(source: Any) -> Any:
    if isinstance(source, PlacedAperture):
        return PlacedAperture(source.aperture.with_illumination(None), source.pose)
    return source if isinstance(source, Polyhedron) else source.with_illumination(None)


def _is_the_sum_over_waves(case: _Case, source: Any) -> None:
    """Check F(nu) = sum c_m F_1(nu - kappa_m) about each wave, with the outline's F_1."""
    placed = isinstance(source, PlacedAperture)
    waves = waves_of(source.aperture if placed else source)
    kappa = waves.frequencies @ source.pose[:3, :2].T if placed else waves.frequencies
    reach = float(np.abs(corners_of(source)).max())
    for centre in kappa:
        nu = case.nu + centre
        offsets = nu[:, None] - kappa
        shifted = transforms.fourier(case.source, offsets, **case.keywords)
        # what rounding of the differences turns the phases by
        turns = reach * np.spacing(np.abs(nu).max() + np.abs(kappa).max())
        allowed = waves.strength * (case.allowed + 8 * np.pi * turns * case.content)
        got = transforms.fourier(source, nu, **case.keywords)
        require("F is the sum over waves", got, shifted @ waves.amplitudes, allowed, {"nu": nu})


def _cancellation(simplices: list[_Simplex]) -> float:
    weights = [float(s.weight) for s in simplices]
    return math.fsum(map(abs, weights)) / abs(math.fsum(weights))


def _frequencies(corners: Array, points: int, rng: np.random.Generator) -> tuple[Array, Array]:
    diameter = max(np.linalg.norm(corners - p, axis=1).max() for p in corners)
    decade = np.resize(np.array(_DECADES), points)
    size = 10.0 ** (decade - rng.random(points) / 2) / diameter
    directions = np.array([_direction(rng, corners) for _ in range(points)])
    return size[:, None] * directions, decade


def _direction(rng: np.random.Generator, corners: Array) -> Array:
    """A unit vector: any, along or across an edge, or normal to a face; tilted."""
    d = corners.shape[1]
    anywhere = rng.normal(size=d)
    random = anywhere / np.linalg.norm(anywhere)
    i, j, k = rng.choice(len(corners), 3, replace=len(corners) < 3)
    vector = corners[i] - corners[j]
    kind = rng.integers(4)
    if d == 2 and kind > 1:
        vector = np.array([-vector[1], vector[0]])
    if d == 3 and kind > 1:
        vector = np.cross(vector, corners[k] - corners[j] if kind == 2 else random)
    length = float(np.linalg.norm(vector))
    if kind == 0 or not length > 0.0:
        return np.asarray(random)
    return np.asarray(vector / length + rng.choice(_TILTS) * random)


def _is_bounded_and_hermitian(case: _Case) -> None:
    zero = np.zeros((1, case.nu.shape[1]))
    at_zero = transforms.fourier(case.source, zero, **case.keywords)
    require("F(0) = content", at_zero, case.content, case.allowed, {"nu": zero})
    value, here = case.transform(), {"nu": case.nu}
    mirrored = transforms.fourier(case.source, -case.nu, **case.keywords)
    require("F(-nu) = conj F(nu)", mirrored, value.conj(), case.allowed, here)
    size = np.abs(value)
    require("|F(nu)| <= F(0)", size, np.minimum(size, case.content), case.allowed, here)


def _has_its_limit_at_small_frequencies(case: _Case, simplices: list[_Simplex]) -> None:
    corners = corners_of(case.source)
    centre = ((corners.min(axis=0) + corners.max(axis=0)) / 2).tolist()
    small = 10.0**case.decade <= _SMALL
    expected = [_small_frequency_limit(simplices, centre, nu) for nu in case.nu[small].tolist()]
    law = "F(nu) at small nu, from the moments of the source"
    require(law, case.transform()[small], expected, case.allowed, {"nu": case.nu[small]})


def _agrees_with_the_vertex_formula(case: _Case, simplices: list[_Simplex]) -> None:
    """F = sum w sum_k exp(z_k)/prod_j (z_k - z_j), z = -2 pi i nu.corner, with its own error."""
    corners = corners_of(case.source)
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    weights = np.array([float(s.weight) for s in simplices])
    middle = [Fraction(c) for c in centre.tolist()]
    exact = np.array(
        [
            [[float(x - c) for x, c in zip(p, middle, strict=True)] for p in s.corners]
            for s in simplices
        ]
    )
    turns = np.einsum("nd,skd->nsk", case.nu, exact)
    gaps = turns[..., :, None] - turns[..., None, :]
    order = turns.shape[-1]
    gaps = np.where(np.eye(order, dtype=bool), 1 / (-2j * np.pi), gaps) * (-2j * np.pi)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        terms = weights[:, None] / gaps.prod(axis=-1)
        total = (terms * np.exp(-2j * np.pi * turns)).sum(axis=(1, 2))
        # rounded: the waves, their phases, and the differences of these
        size = np.abs(gaps) + np.eye(order)
        lost = 4 + 2 * np.pi * np.abs(turns)
        relative = (2 * np.pi * np.abs(turns).max(axis=-1)[..., None, None] / size).sum(axis=-1)
        error = _ULP * (np.abs(terms) * (lost + 4 * relative)).sum(axis=(1, 2))
    good = error < case.allowed
    phase = np.array([_phase_of(nu, centre.tolist()) for nu in case.nu[good].tolist()])
    got, expected = case.transform()[good], total[good] * phase
    allowed = case.allowed + error[good]
    if good.any():
        require("F(nu) by the vertex formula", got, expected, allowed, {"nu": case.nu[good]})


def _is_the_sum_over_parts(case: _Case, simplices: list[_Simplex]) -> None:
    if isinstance(case.source, Polyhedron):
        parts, left_out = _tetrahedra(simplices)
    else:
        parts, left_out = [(1.0, piece) for piece in _pieces(case.source)], 0.0
    numpy = {**case.keywords, "engine": "numpy"}
    total = sum(sign * transforms.fourier(part, case.nu, **numpy) for sign, part in parts)
    covered = sum(content_of(part) for _, part in parts) / case.content
    allowed = case.allowed * max(1.0, covered) + left_out
    require("F is the sum over parts", case.transform(), total, allowed, {"nu": case.nu})


def _pieces(source: Any) -> list[Any]:
    if isinstance(source, PlacedAperture):
        return [PlacedAperture(piece, source.pose) for piece in _pieces(source.aperture)]
    return split_in_three(source)[0]


def _tetrahedra(simplices: list[_Simplex]) -> tuple[list[tuple[float, Any]], float]:
    """Signed tetrahedra, and the volume of those too flat to be polyhedra."""
    found, left_out = [], 0.0
    for simplex in simplices:
        corners = [[float(x) for x in corner] for corner in simplex.corners]
        try:
            part = Polyhedron(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
        except GeometryError:  # rounding has lifted a corner of a face that contains the apex
            left_out += abs(float(simplex.weight)) / 6
        else:
            found.append((math.copysign(1.0, simplex.weight), part))
    return found, left_out


def _has_only_another_phase_far_away(case: _Case) -> None:
    """Check a far copy with the same corners up to the rounding there."""
    corners = corners_of(case.source)
    size = float(np.ptp(corners, axis=0).max())
    shift = math.ldexp(1.0, math.frexp(_FAR * size)[1]) * np.array([1.0, -0.625, 0.75])
    shift = shift[: corners.shape[1]]
    try:
        far = _mapped(case.source, lambda x: x + shift[: x.shape[-1]])
        near = _mapped(far, lambda x: x - shift[: x.shape[-1]])
    except GeometryError:
        return  # so thin that its corners are one, that far away
    phase = np.array([_phase_of(nu, shift.tolist()) for nu in case.nu.tolist()])
    expected = phase * transforms.fourier(near, case.nu, **case.keywords)
    got = transforms.fourier(far, case.nu, **case.keywords)
    allowed = case.tolerance * max(content_of(near), case.content)
    law = "F of the source a thousand diameters away"
    require(law, got, expected, allowed, {"nu": case.nu, "shift": shift})


def _mapped(source: Any, move: Callable[[Array], Array]) -> Any:
    """The source with every corner moved, or a pose."""
    if isinstance(source, Slits):
        return Slits(move(source.intervals[..., None])[..., 0])
    if isinstance(source, Polyhedron):
        return Polyhedron(move(source.vertices), source.faces)
    if isinstance(source, PlacedAperture):
        pose = source.pose.copy()
        pose[:3, 3] = move(pose[:3, 3])
        return PlacedAperture(source.aperture, pose)
    return Aperture(shapely.transform(source.polygons, move))


def _is_continuous(case: _Case) -> None:
    """About the centre |F(nu) - F(nu')| <= 2 pi |nu - nu'| reach content."""
    corners = corners_of(case.source)
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    reach = float(np.linalg.norm(corners - centre, axis=1).max())
    rng = np.random.default_rng(len(case.nu))
    size = np.linalg.norm(case.nu, axis=1, keepdims=True)
    for step in (1e-14, 1e-12):
        random = rng.normal(size=case.nu.shape)
        there = case.nu + step * size * random / np.linalg.norm(random, axis=1, keepdims=True)
        moved = np.linalg.norm(there - case.nu, axis=1)
        allowed = 2 * case.allowed + 2 * np.pi * moved * reach * case.content
        values = [
            transforms.fourier(case.source, nu, **case.keywords)
            * np.array([_phase_of(row, centre.tolist()).conjugate() for row in nu.tolist()])
            for nu in (case.nu, there)
        ]
        require("F changes no faster than nu", values[1], values[0], allowed, {"nu": case.nu})


def _simplices_of(source: Any) -> list[_Simplex]:
    """Signed simplices with one corner in common, their first, whose sum the source is."""
    if isinstance(source, Slits):
        ends = [tuple((Fraction(x),) for x in pair) for pair in source.intervals.tolist()]
        return [_Simplex(b[0] - a[0], (a, b)) for a, b in ends]
    if isinstance(source, Polyhedron):
        corners = _exact(source.vertices)
        return _fan([[corners[k] for k in face] for face in source.triangles.tolist()])
    if isinstance(source, PlacedAperture):
        pose = [[Fraction(value) for value in row] for row in source.pose.tolist()]
        return [
            _Simplex(s.weight, tuple(_placed(pose, corner) for corner in s.corners))
            for s in _simplices_of(source.aperture)
        ]
    rings = [_exact(ring) for ring in source.rings]
    return _fan([[p, q] for r in rings for p, q in zip(r, r[1:] + r[:1], strict=True)])


def _exact(points: Array) -> list[Point]:
    return [tuple(Fraction(x) for x in point) for point in points.tolist()]


def _placed(pose: list[list[Fraction]], corner: Point) -> Point:
    x, y = corner
    return tuple(row[0] * x + row[1] * y + row[3] for row in pose[:3])


def _fan(faces: list[list[Point]]) -> list[_Simplex]:
    """The cones from one corner over all faces that do not contain it."""
    apex = faces[0][0]
    found = []
    for face in faces:
        rows = [[x - a for x, a in zip(corner, apex, strict=True)] for corner in face]
        weight = _determinant(rows)
        if weight:
            found.append(_Simplex(weight, (apex, *face)))
    return found


def _determinant(rows: Sequence[Sequence[Fraction]]) -> Fraction:
    if len(rows) == 2:
        return rows[0][0] * rows[1][1] - rows[0][1] * rows[1][0]
    (a, b, c), lower = rows[0], rows[1:]
    minors = [[[row[j] for j in range(3) if j != k] for row in lower] for k in range(3)]
    first, second, third = (_determinant(minor) for minor in minors)
    return a * first - b * second + c * third


def _phase_of(nu: Sequence[float], point: Sequence[Any]) -> complex:
    """exp(-2 pi i nu.point), the product exact and reduced modulo one turn."""
    turns = sum(Fraction(n) * Fraction(x) for n, x in zip(nu, point, strict=True))
    reduced = float(turns - round(turns))
    return complex(math.cos(2 * math.pi * reduced), -math.sin(2 * math.pi * reduced))


def _small_frequency_limit(
    simplices: list[_Simplex], centre: Sequence[float], nu: Sequence[float]
) -> complex:
    """F(nu) to second order in nu.(x - centre), from exact moments.

    The next term is (2 pi |nu| D)^3/6 of the content.
    """
    d = len(simplices[0].corners) - 1
    middle = [Fraction(c) for c in centre]
    frequency = [Fraction(n) for n in nu]
    zeroth = first = second = Fraction(0)
    for simplex in simplices:
        turns = [
            sum((n * (x - c) for n, x, c in zip(frequency, p, middle, strict=True)), Fraction(0))
            for p in simplex.corners
        ]
        total = sum(turns, Fraction(0))
        squares = sum((t * t for t in turns), Fraction(0))
        zeroth += simplex.weight / math.factorial(d)
        first += simplex.weight * total / math.factorial(d + 1)
        second += simplex.weight * (total * total + squares) / math.factorial(d + 2)
    turn = 2 * math.pi
    near = complex(float(zeroth) - turn**2 * float(second) / 2, -turn * float(first))
    return near * _phase_of(nu, centre)
