"""Shadows that diffract: the field of a source behind opaque bodies and plates. Source: (SB1).

The source is a grid of points that radiate as it does from some wavelengths on (B8). Behind bodies
the wave of each point is cut off where it is hidden, and the boundary waves (SB3) of the edges of
the silhouette that it sees are added (Maggi and Rubinowicz): the sum is smooth across the boundary
of the shadow. Waves over two edges, and those that creep around a body, are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError, IlluminationError
from polywigner.execution import NumpyOperations
from polywigner.geometry import Wavefront
from polywigner.geometry.arguments import checked_number, warn_caller
from polywigner.geometry.silhouettes import Obstacles, Silhouette
from polywigner.illumination.obliquities import CONDITIONS, Obliquity, times_direction_cosine
from polywigner.kernels.boundary.edge_waves import (
    EdgeRule,
    Point,
    angle_about,
    edge_wave,
    edge_wave_and_rate,
)
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.jets import JetOperations, slopes_of
from polywigner.numerics.phases import cos_sin_turns
from polywigner.propagation.boundary import Radiator, radiator_of
from polywigner.propagation.curved_fields import cells_of_wave, lit_nodes
from polywigner.propagation.screens import PointSource
from polywigner.transforms import fourier
from polywigner.transforms.wavefronts import flat_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Nodes a cycle, and nodes beyond these, of grids that are tried one after the other: uniform
# apertures need the first ones, arrays and tapers the last.
_GRIDS = (*((1.5, more) for more in range(2, 25, 2)), (1.75, 24), (2.0, 24))
# Singular values of plane waves at nodes that are rounding, over the largest.
_ROUNDING = 1e-9
# Sines beyond those of the directions that matter, times the length of a side in wavelengths.
_MARGIN = 4.0
# Triangles at a time, of 400 nodes each.
_CELLS = 1 << 6
# The far field is compared at so many directions for each node's length, and so many more.
_DIRECTIONS, _MORE_DIRECTIONS = 4.0, 24


@dataclass(frozen=True)
class EquivalentGrid:
    """Gauss nodes over the bounds of a source. Lengths in wavelengths, from its middle."""

    nodes: tuple[Floats, Floats]
    """Along x and y, as shares of half the sides."""
    half: Floats
    """Half the sides (2,)."""
    weights: tuple[Complex, ...]
    """(nx, ny) each, in units of u times a square wavelength: for the field's share of the
    obliquity and for its slope's, as far as there are any."""


Sines = tuple[tuple[float, float], tuple[float, float]]
"""Least and largest sine of directions from a source, along x and along y."""
_ALL_SINES: Sines = ((-1.0, 1.0), (-1.0, 1.0))


def equivalent_grid(
    source: Any,
    radiator: Radiator,
    wavelength: float,
    condition: Obliquity,
    error: float,
    allowed: Callable[[Sequence[int]], bool],
    sines: Sines = _ALL_SINES,
) -> EquivalentGrid | None:
    """Return a small grid whose |F|^2 is within ``error`` of its peak in directions of ``sines``.

    None if ``allowed`` rejects the numbers of nodes along x and y.
    """
    half = (radiator.high - radiator.low) / (2 * wavelength)
    middles, widths = np.mean(sines, axis=1), np.ptp(sines, axis=1) / 2
    # cycles over half a side that directions differ by
    cycles = half * widths
    waves: list[Floats] = []
    spectra: list[Complex] = []
    for pitch, more in _GRIDS:
        counts = [math.ceil(2 * pitch * c) + more for c in cycles]
        if not allowed(counts):
            return None
        if not spectra:  # not before it is known that there are few
            numbers = [math.ceil(2 * _DIRECTIONS * c) + _MORE_DIRECTIONS for c in cycles]
            waves = [
                m + w * np.cos(math.pi * (np.arange(n) + 0.5) / n)
                for m, w, n in zip(middles, widths, numbers, strict=True)
            ]
            spectra = _spectra(source, waves, radiator.centre, wavelength, condition)
            if not spectra:
                return None
        x, y = (np.polynomial.legendre.leggauss(n)[0] for n in counts)
        weights = [_fitted(s, waves, (half[0] * x, half[1] * y), error) for s in spectra]
        if all(found is not None for found in weights):
            return EquivalentGrid((x, y), half, tuple(w for w in weights if w is not None))
    return None


def _spectra(
    source: Any, sines: list[Floats], middle: Floats, wavelength: float, condition: Obliquity
) -> list[Complex]:
    """Far fields of the field's part of a boundary condition and of its slope's, if there are any.

    In units of a square wavelength, seen from the middle.
    """
    nu = np.stack(np.meshgrid(*sines, indexing="ij"), axis=-1) / wavelength
    phase = np.exp(2j * math.pi * (nu @ middle)) / wavelength**2
    spectra = []
    if condition.field:
        spectra.append(condition.field * fourier(source, nu) * phase)
    if condition.slope and isinstance(source, Wavefront) and not source.is_flat:
        spectra.append(condition.slope * _slope_spectrum(source, sines, wavelength) * phase)
    elif condition.slope:
        with suppress(IlluminationError):  # all waves graze the plane: their cosines are zero
            slopes = times_direction_cosine(flat_of(source), wavelength)
            spectra.append(condition.slope * fourier(slopes, nu) * phase)
    return spectra


def _slope_spectrum(wave: Wavefront, sines: list[Floats], wavelength: float) -> Complex:
    """The transform of the normal derivative of a curved wave, over ik."""
    total = np.zeros([len(s) for s in sines], np.complex128)
    for part, cells in cells_of_wave(wave, wavelength):
        for start in range(0, len(cells), _CELLS):
            nodes, _, slopes = lit_nodes(
                wave, part, cells[start : start + _CELLS], wavelength, True
            )
            x, y = (
                np.exp(-2j * math.pi / wavelength * np.multiply.outer(s, nodes[..., k].ravel()))
                for k, s in enumerate(sines)
            )
            total += (x * slopes.ravel()) @ y.T
    return total


def _fitted(
    spectrum: Complex, sines: list[Floats], places: tuple[Floats, Floats], error: float
) -> Complex | None:
    """The weights of a grid of places with this far field; None if they miss it."""
    waves = [np.exp(-2j * math.pi * np.outer(s, x)) for s, x in zip(sines, places, strict=True)]
    first, second = (np.linalg.pinv(wave, rcond=_ROUNDING) for wave in waves)
    weights = first @ spectrum @ second.T
    found = waves[0] @ weights @ waves[1].T
    seen = np.add.outer(sines[0] ** 2, sines[1] ** 2) <= 1.0
    expected = np.abs(spectrum[seen]) ** 2
    missed = np.abs(np.abs(found[seen]) ** 2 - expected).max()
    return weights if missed <= error * expected.max() else None


def sines_towards(low: Floats, high: Floats, boxes: Floats) -> Sines:
    """Bounds on the sines of directions from a rectangle (2,) to (2,) at z = 0 to boxes (n, 2, 3).

    Wider by what the ends of a source of this size tell apart.
    """
    start = np.column_stack([low, high]).T
    first, last = boxes[:, 0].copy(), boxes[:, 1].copy()
    first[:, :2] -= start[1]
    last[:, :2] -= start[0]
    near = np.where((first < 0.0) & (last > 0.0), 0.0, np.minimum(abs(first), abs(last)))
    far = np.maximum(abs(first), abs(last))
    bounds = []
    for k in range(2):
        others = [m for m in range(3) if m != k]
        closest, farthest = (np.linalg.norm(part[:, others], axis=1) for part in (near, far))
        margin = _MARGIN / max(high[k] - low[k], 1e-9)
        # a sine grows with its own component, and falls with the others unless it is negative
        largest = last[:, k] / np.hypot(last[:, k], np.where(last[:, k] > 0.0, closest, farthest))
        least = first[:, k] / np.hypot(first[:, k], np.where(first[:, k] < 0.0, closest, farthest))
        bounds.append(
            (max(-1.0, float(least.min()) - margin), min(1.0, float(largest.max()) + margin))
        )
    return bounds[0], bounds[1]


DEFAULT_TOLERANCE = 1e-6
"""Relative error of fields behind obstacles: far below the error of black edges, one at a time."""
LEAST_TOLERANCE = 1e-8
"""The smallest tolerance of fields behind obstacles."""

# From a tolerance on, nodes of an edge, and coarser ones whose difference is the estimated error.
# Measured before 40,000 edges at random, half near shadows' boundaries, the largest errors were
# 1.5e-6 and 2e-5, 5e-9 and 3e-7, 4e-10 and 2e-7 of the wave.
_RULES = (
    (1e-4, EdgeRule.of(1.0, 12, 5), EdgeRule.of(1.0, 10, 4)),
    (1e-6, EdgeRule.of(2.0, 24, 5), EdgeRule.of(2.0, 20, 5)),
    (0.0, EdgeRule.of(4.0, 40, 5), EdgeRule.of(4.0, 32, 4)),
)
# Share of the tolerance that points in place of the source may take.
_OF_GRID = 0.1
# How far beside a point it is asked what is lit, as a share of its distance: beyond rounding.
_ASIDE = 1e-8
# Where derivatives are taken beside a point, in wavelengths.
_OFF = 1e-8
# Most points that stand for a source: a quarter of an hour for 1,000 points behind a box.
_MOST_SOURCES = 1 << 14
# Nearer to the source than this, in wavelengths, its waves that fade are not left out unseen.
_NEAR = 1.0


def checked_shadow_tolerance(tolerance: float | None) -> float:
    """A tolerance that fields behind obstacles keep; ArgumentError for others."""
    if tolerance is None:
        return DEFAULT_TOLERANCE
    meaning = f"a number from {LEAST_TOLERANCE:g} to 0.1 with obstacles"
    number = checked_number(tolerance, "tolerance", meaning)
    if not LEAST_TOLERANCE <= number <= 0.1:
        raise ArgumentError(f"expected tolerance as {meaning}, got {tolerance!r}")
    return number


def shadow_of(
    source: Any,
    bodies: Obstacles,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str,
    with_error: bool = False,
) -> tuple[Complex, NDArray[np.bool_], Floats]:
    """Return the change that obstacles make to the field at points (n, 3), in m, of a source.

    ``bodies`` in wavelengths. Also whether a point is in a body, where the field is zero, and the
    estimated error (n,); zeros unless ``with_error``. ``source``: whatever :func:`equivalent_grid`
    takes, or a PointSource.

    Raises ArgumentError for obstacles around the source, and sources that take too many points.
    """
    places = points / wavelength
    sources, seen = _seen(source, bodies, places, wavelength, method, tolerance)
    change, free, off = diffracted(bodies, sources, seen, places, engine, with_error, tolerance)
    if with_error and len(sources) > 1:
        off += _OF_GRID * tolerance * np.abs(free).max(initial=0.0)
    return change, bodies.inside(places), off


def diffracted(
    bodies: Obstacles,
    sources: Sequence[RadiatingPoint],
    seen: Sequence[Silhouette],
    places: Floats,
    engine: str,
    with_error: bool = False,
    tolerance: float = DEFAULT_TOLERANCE,
) -> tuple[Complex, Complex, Floats]:
    """Change by bodies, free field, and error at places (n, 3) of points with their silhouettes."""
    shadow = _Shadow.of(bodies, sources, seen, places)
    rule, coarser = next(rules for least, *rules in _RULES if tolerance >= least)
    is_oblique = any(point.field for point in sources)
    term = partial(_edge, rule, coarser if with_error else None, is_oblique)
    real, imag, off = execution.evaluate_rows(
        term, shadow.table, shadow.samples, np.zeros(1), 3, engine
    )
    total, free = real + 1j * imag, np.zeros(len(places), np.complex128)
    for point in sources:
        wave = point.wave(places.T)
        total -= np.where(shadow.hidden(point), wave, 0.0)
        free += wave
    return total, free, off


def slopes_of_shadow(
    source: Any,
    bodies: Obstacles,
    points: Floats,
    wavelength: float,
    method: str,
    tolerance: float,
    engine: str = "auto",
) -> tuple[Complex, NDArray[np.bool_]]:
    """Return the derivatives (n, 3), in 1/m, of the change that :func:`shadow_of` finds.

    They are those of the same sum over edges, the silhouettes of the points held: the field is
    smooth where these change. Also whether a point is in a body.
    """
    # off the boundaries of shadows, at which the field is smooth but roots in its formula are not
    places = points / wavelength + _OFF * np.array([0.57, 0.31, 0.76])
    sources, seen = _seen(source, bodies, places, wavelength, method, tolerance)
    shadow = _Shadow.of(bodies, sources, seen, places)
    term = partial(_edge_slopes, any(point.field for point in sources))
    parts = execution.evaluate_rows(term, shadow.table, shadow.samples, np.zeros(1), 6, engine)
    total = np.stack(parts[::2], axis=1) + 1j * np.stack(parts[1::2], axis=1)
    for point in sources:
        slopes = np.stack(point.slopes(shadow.samples[:, :3].T), axis=1)
        total -= np.where(shadow.hidden(point)[:, None], slopes, 0.0)
    return total / wavelength, bodies.inside(places)


def _seen(
    source: Any, bodies: Obstacles, places: Floats, wavelength: float, method: str, tolerance: float
) -> tuple[list[RadiatingPoint], list[Silhouette]]:
    """Points in place of a source, as bodies and places need them, and their silhouettes."""
    boxes = [np.stack([b.vertices.min(axis=0), b.vertices.max(axis=0)]) for b in bodies.bodies]
    targets = np.concatenate([np.stack(boxes), np.stack([places, places], axis=1)])
    error = _OF_GRID * tolerance
    sources = radiating_points(source, wavelength, method, error, targets=targets)
    _check_clearance(bodies, sources)
    return sources, bodies.silhouettes([place for place, *_ in sources])


class _Shadow(NamedTuple):
    """Obstacles as the points of a source see them, and points that may be in their shadow."""

    bodies: Obstacles
    table: Floats
    """Edges of silhouettes, a row for each and each point of the source."""
    samples: Floats
    """(n, 7): points, places aside, and 1 where the angles of edges tell light from shadow."""

    @classmethod
    def of(
        cls,
        bodies: Obstacles,
        sources: Sequence[RadiatingPoint],
        seen: Sequence[Silhouette],
        places: Floats,
    ) -> _Shadow:
        """Silhouettes that points see, for places (n, 3) in wavelengths."""
        # beyond all bodies the angles of all edges tell what is lit; else rays do
        reach = np.array([bodies.reach(place) for place, *_ in sources])
        away = np.min([np.linalg.norm(places - place, axis=1) for place, *_ in sources], axis=0)
        by_angles = (away > reach.max()) & all(edges.counts_everywhere for edges in seen)
        # at the boundary of a shadow, all is asked of a place so close beside it that it is on one
        # side
        aside = places + _ASIDE * away[:, None] * np.array([0.57, 0.31, 0.76])
        rows = [
            np.column_stack(
                [np.tile(point.row, (len(s.edges), 1)), s.edges.reshape(-1, 6), s.planes]
            )
            for point, s in zip(sources, seen, strict=True)
        ]
        samples = np.column_stack([places, aside, by_angles])
        return cls(bodies, np.concatenate(rows), samples)

    def hidden(self, point: RadiatingPoint) -> NDArray[np.bool_]:
        """Samples that rays from a point of the source do not reach, where rays are asked."""
        found, by_rays = np.zeros(len(self.samples), bool), self.samples[:, 6] == 0.0
        found[by_rays] = self.bodies.hide(point.place, self.samples[by_rays, 3:6])
        return found


def _edge(
    rule: EdgeRule,
    coarser: EdgeRule | None,
    is_oblique: bool,
    ops: Any,
    row: Point,
    sample: Point,
    _: Point,
) -> Any:
    """Change of the field by an edge that a point of the source sees; and its error.

    ``is_oblique``: whether the point has a weight of the field, whose edge waves (SB5) depend on
    the direction from the point to the edge.
    """
    source, field, slope, start, end = row[:3], row[3:5], row[5:7], row[7:10], row[10:13]
    point, aside, by_angles = sample[:3], sample[3:6], sample[6]
    ends = source, point, start, end, aside
    ahead = tuple(a - b for a, b in zip(point, source, strict=True))
    bend = Pair(0.0, 0.0)
    if is_oblique:
        boundary, rate = edge_wave_and_rate(ops, rule, *ends)
        bend = oblique_change(ops, ahead, field, rate)
    else:
        boundary = Pair(*edge_wave(ops, rule, *ends))
    off = 0.0 * boundary.real
    wave = wave_ahead(ops, ahead, field, slope)
    if coarser is not None:
        other = boundary - Pair(*edge_wave(ops, coarser, *ends))
        off = ops.sqrt(wave.norm() * other.norm()) / (2.0 * math.pi)
    a, b, c, d = row[13:17]
    counts = a * point[0] + b * point[1] + c * point[2] + d >= 0.0
    change = (wave * boundary).scaled(-0.5 / math.pi) + bend
    angle = wave.scaled(by_angles * angle_about(ops, source, aside, start, end) / (2.0 * math.pi))
    return (
        angle.real + ops.select(counts, change.real, 0.0),
        angle.imag + ops.select(counts, change.imag, 0.0),
        off,
    )


def _edge_slopes(is_oblique: bool, ops: Any, row: Point, sample: Point, none: Point) -> Any:
    """Derivatives of :func:`_edge` in x, y and z, real and imaginary part of each."""
    jets = JetOperations(ops)
    point = (*jets.variables(sample[:3]), *jets.constants(sample[3:]))
    row = jets.constants(row)
    real, imag, _ = _edge(_RULES[1][1], None, is_oblique, jets, row, point, none)
    return slopes_of(real, imag)


def oblique_change(ops: Any, ahead: Point, field: Point, rate: Pair, turns: Any = None) -> Pair:
    """Return the term of (SB5) that turns the obliquity at the point into that at the edge.

    ``rate``: the derivative of the boundary wave in the z of the source. ``turns``: see
    :func:`spherical_wave`.
    """
    # i/(2 pi) of the derivative, times -1/(2 pi) of the boundary wave
    wave = spherical_wave(ops, ahead, turns) * Pair(*field) * rate
    return Pair(wave.imag, -wave.real).scaled(0.25 / math.pi**2)


def spherical_wave(ops: Any, ahead: Point, turns: Any = None) -> Pair:
    """exp(2 pi i R)/(i R), R the length of ``ahead``.

    ``turns``: of the wave, where they are known better than by the distance.
    """
    distance = ops.sqrt(sum(a * a for a in ahead))
    c, s = cos_sin_turns(ops, distance if turns is None else turns)
    return Pair(s, -c).scaled(1.0 / distance)


def wave_ahead(ops: Any, ahead: Point, field: Point, slope: Point, turns: Any = None) -> Pair:
    """The wave of a point that radiates, ``ahead`` of it; weights of its field and slope.

    ``turns``: see :func:`spherical_wave`.
    """
    inverse = 1.0 / ops.sqrt(sum(a * a for a in ahead))
    return spherical_wave(ops, ahead, turns) * _amplitude(ahead, inverse, field, slope)


def _amplitude(ahead: Point, inverse: Any, field: Point, slope: Point) -> Pair:
    """The amplitude of a point that radiates, ``ahead`` of it, before the wave turns and decays."""
    near = Pair(1.0, (0.5 / math.pi) * inverse).scaled(ahead[2] * inverse)
    return Pair(*field) * near + Pair(*slope)


class RadiatingPoint(NamedTuple):
    """A point in place of a part of a source. Lengths in wavelengths."""

    place: Floats
    field: complex
    slope: complex

    @property
    def weights(self) -> list[tuple[float, float]]:
        """Real and imaginary parts of both weights."""
        return [(self.field.real, self.field.imag), (self.slope.real, self.slope.imag)]

    @property
    def row(self) -> Floats:
        """(7,): place, and real and imaginary parts of both weights."""
        return np.array([*self.place, *self.weights[0], *self.weights[1]])

    def wave(self, points: Floats) -> Complex:
        """Its wave at points (3, n)."""
        ahead = points - self.place[:, None]
        found = wave_ahead(NumpyOperations(double=True), tuple(ahead), *self.weights)
        return np.asarray(found.real + 1j * found.imag)

    def slopes(self, points: Floats) -> list[Complex]:
        """Derivatives of its wave at points (3, n) in x, y and z."""
        jets = JetOperations(NumpyOperations(double=True))
        weights = map(jets.constants, self.weights)
        wave = wave_ahead(jets, jets.variables(points - self.place[:, None]), *weights)
        found = slopes_of(wave.real, wave.imag)
        return [a + 1j * b for a, b in zip(found[::2], found[1::2], strict=True)]


def radiating_points(
    source: Any,
    wavelength: float,
    method: str,
    error: float,
    most: int = _MOST_SOURCES,
    targets: Floats | None = None,
) -> list[RadiatingPoint]:
    """Return points that radiate as a source does, but for an error of |F|^2 over its peak.

    ``targets`` (n, 2, 3): low and high corners, in wavelengths, of boxes that the points may be
    seen from; None: all directions.

    Raises ArgumentError at once for sources that need more than ``most`` points.
    """
    if isinstance(source, PointSource):
        # exp(ikR)/R is i/wavelength times exp(ikR)/(i R/wavelength)
        place = np.array(source.position) / wavelength
        return [RadiatingPoint(place, 0j, 1j * source.amplitude / wavelength)]
    radiator = radiator_of(flat_of(source))
    condition = CONDITIONS[method]
    low, high = radiator.low / wavelength, radiator.high / wavelength
    sines = _ALL_SINES if targets is None else sines_towards(low, high, targets)
    tried: list[int] = []

    def allowed(counts: Sequence[int]) -> bool:
        tried[:] = counts
        return math.prod(counts) <= most

    found = equivalent_grid(source, radiator, wavelength, condition, error, allowed, sines)
    if found is None:
        size, count = " × ".join(f"{side:.3g}" for side in high - low), math.prod(tried)
        raise ArgumentError(
            f"source of {size} wavelengths needs {count} or more equivalent points with obstacles, "
            f"the limit is {most}; move obstacles and points away from the source, or use a part "
            "of it"
            if count > most
            else f"no {count} equivalent points match the source of {size} wavelengths; increase "
            "the tolerance"
        )
    middle = radiator.centre / wavelength
    x, y = (m + h * n for m, h, n in zip(middle, found.half, found.nodes, strict=True))
    none = np.zeros_like(found.weights[0])
    field = found.weights[0] if condition.field else none
    slope = found.weights[-1] if len(found.weights) > bool(condition.field) else none
    return [
        RadiatingPoint(np.array([a, b, 0.0]), complex(field[i, j]), complex(slope[i, j]))
        for i, a in enumerate(x)
        for j, b in enumerate(y)
    ]


def _check_clearance(bodies: Obstacles, sources: Sequence[RadiatingPoint]) -> None:
    places = np.array([place for place, *_ in sources])
    if bodies.inside(places).any():
        raise ArgumentError("expected obstacles away from the source, got a body around it")
    nearest = min(float(body.distance(places).min()) for body in bodies.bodies)
    if nearest < _NEAR and len(sources) > 1:
        warn_caller(
            f"an obstacle is {nearest:.2g} wavelengths from the source: waves that fade within a "
            "wavelength are left out of its shadow"
        )
