"""Shadows that diffract: the field of a source behind opaque bodies and plates. Source: (SB1).

The source is a grid of points that radiate as it does from some wavelengths on (B8). Behind bodies
the wave of each point is cut off where it is hidden, and the boundary waves (SB3) of the edges of
the silhouette that it sees are added (Maggi and Rubinowicz): the sum is smooth across the boundary
of the shadow. Waves over two edges, and those that creep around a body, are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_number, warn_caller
from polywigner.geometry.silhouettes import Obstacles, Silhouette
from polywigner.kernels.boundary.edge_waves import (
    EdgeRule,
    Point,
    angle_about,
    edge_wave,
    edge_wave_and_rate,
)
from polywigner.numerics.complex_pairs import Pair
from polywigner.numerics.jets import JetOperations, slopes_of
from polywigner.propagation.equivalent_points import (
    RadiatingPoint,
    oblique_change,
    radiating_points,
    wave_ahead,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

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
# Distance of a place from the line through the source and a corner, over the root of its distance
# from the source, in wavelengths: below the first number derivatives lose digits, at the second
# they do not. Lines at an angle whose cosine is below one less the third are not looked at.
_CORNER, _BESIDE, _ALIGNED = 1e-5, 1e-4, 1e-8
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
    change, free, off = _summed(bodies, sources, seen, places, engine, with_error, tolerance)
    near, across = _near_corners(sources, seen, places)
    if near.any():
        # the mean over places on a line, an error of the fourth order in their distance
        change[near] = 0.0
        for number, share in ((1, 4 / 6), (-1, 4 / 6), (2, -1 / 6), (-2, -1 / 6)):
            beside = places[near] + number * across
            change[near] += share * _summed(bodies, sources, seen, beside, engine)[0]
    return change, free, off


def _near_corners(
    sources: Sequence[RadiatingPoint], seen: Sequence[Silhouette], places: Floats
) -> tuple[NDArray[np.bool_], Floats]:
    """Whether places (n, 3) are on a line through a point of the source and a corner.

    There the derivatives (SB5) of the two edges grow without bound, and their sum loses its digits.
    Also displacements (k, 3) across the line of these places, over which the field is smooth.
    """
    near = np.zeros(len(places), bool)
    for point, silhouette in zip(sources, seen, strict=True):
        if not point.field:
            continue
        corners = silhouette.edges.reshape(-1, 3) - point.place
        corners /= np.linalg.norm(corners, axis=1)[:, None]
        axes = places - point.place
        distance = np.linalg.norm(axes, axis=1)
        rows, columns = np.nonzero(axes @ corners.T > (1.0 - _ALIGNED) * distance[:, None])
        aside = np.linalg.norm(np.cross(axes[rows], corners[columns]), axis=1)
        near[rows[aside < _CORNER * np.sqrt(distance[rows])]] = True
    axes = places[near] - np.mean([place for place, *_ in sources], axis=0)
    across = np.cross(axes, [0.57, 0.31, 0.76])
    length = np.linalg.norm(across, axis=1) / np.sqrt(np.linalg.norm(axes, axis=1))
    return near, _BESIDE * across / np.maximum(length, 1e-300)[:, None]


def _summed(
    bodies: Obstacles,
    sources: Sequence[RadiatingPoint],
    seen: Sequence[Silhouette],
    places: Floats,
    engine: str,
    with_error: bool = False,
    tolerance: float = DEFAULT_TOLERANCE,
) -> tuple[Complex, Complex, Floats]:
    """See :func:`diffracted`."""
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
