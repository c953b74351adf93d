"""Outlines of drawings: curves and their chords, and polygons with holes by fill rule or nesting.

A curve is a polyline (n, d), an :class:`Arc`, a :class:`Bezier` or a :class:`Spline`. An outline is
a closed sequence of curves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, FileFormatError
from polywigner.geometry.arguments import check_most
from polywigner.geometry.io.limits import MOST_VERTICES, check_coordinates
from polywigner.geometry.parts import (
    check_overlaps,
    connected,
    enclosed,
    part_of_ring,
    polygons_in,
    union_on_grid,
)
from polywigner.geometry.rings import (
    Ring,
    clean_ring,
    extent,
    hull_spans_area,
    rings_of_polygon,
    signed_area,
)

DEFAULT_TOLERANCE = 1 / 2000
"""Largest distance between a curve and its chords, as a fraction of the diagonal of the outline.

A circle becomes a polygon with 52 vertices. A rounded corner, which is a quarter circle with a
tenth of the outline's size, becomes 8 chords. For an outline ten wavelengths across, the distance
is 1/200 of a wavelength.
"""

# Largest angle that a chord spans [rad]; even small circles have eight chords.
_LARGEST_STEP = math.pi / 4

Points = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Arc:
    """Points centre + u cos t + v sin t, with t from start to start + sweep in radians."""

    centre: Points
    u: Points
    v: Points
    start: float = 0.0
    sweep: float = 2 * math.pi

    @property
    def is_closed(self) -> bool:
        """Whether the arc is a full ellipse, up to the rounding of angles in degrees."""
        return abs(self.sweep) >= 2 * math.pi * (1 - 1e-12)

    @property
    def semi_major_axis(self) -> float:
        """Semi-major axis of the ellipse."""
        return float(np.linalg.norm(np.stack([self.u, self.v]), 2))

    def at(self, t: Points) -> Points:
        """Return points (n, d) at fractions (n,) of the sweep."""
        angles = self.start + self.sweep * t
        return self.centre + np.cos(angles)[:, None] * self.u + np.sin(angles)[:, None] * self.v

    def transformed(self, matrix: Points, offset: Points) -> Arc:
        """Return the image of the curve under the map p -> p @ matrix + offset."""
        centre = self.centre @ matrix + offset
        return Arc(centre, self.u @ matrix, self.v @ matrix, self.start, self.sweep)

    def chords(self, distance: float) -> Points:
        """Return vertices (n, d) on the arc; a full ellipse becomes a polygon of the same area.

        The chords are within ``distance`` of the arc. The first vertex of an ellipse is repeated at
        the end.

        The polygon has n = 4 k corners and is scaled by a, with a^2 = x/sin(x) and x = 2 pi/n. The
        corners of the polygon lie outside the ellipse by less than 1.04 (pi/n)^2/3 of the
        semi-major axis, for n >= 8.
        """
        if not self.is_closed:
            steps = max(math.sqrt(self.semi_major_axis / (8 * distance)), 1 / _LARGEST_STEP)
            return sampled(self, _chord_count(abs(self.sweep) * steps))
        quarter = 1.04 * math.pi * math.sqrt(self.semi_major_axis / (3 * distance)) / 4
        n = 4 * max(2, _chord_count(quarter))
        x = 2 * math.pi / n
        grown = math.sqrt(x / math.sin(x))
        sweep = math.copysign(2 * math.pi, self.sweep)
        return sampled(Arc(self.centre, grown * self.u, grown * self.v, self.start, sweep), n)


@dataclass(frozen=True, eq=False)
class Bezier:
    """A Bezier curve of degree p, with control points (p + 1, d)."""

    points: Points

    def at(self, t: Points) -> Points:
        """Return points (n, d) at parameters (n,) from 0 to 1."""
        degree = len(self.points) - 1
        powers = np.arange(degree + 1)
        factors = [math.comb(degree, k) for k in range(degree + 1)]
        return (
            factors * t[:, None] ** powers * (1 - t[:, None]) ** (degree - powers)
        ) @ self.points

    def transformed(self, matrix: Points, offset: Points) -> Bezier:
        """Return the image of the curve under the map p -> p @ matrix + offset."""
        return Bezier(self.points @ matrix + offset)

    def chords(self, distance: float) -> Points:
        """Return vertices (n, d), at equal steps, of chords within ``distance`` of the curve.

        The number of parameter steps follows from a bound on the second derivative.
        """
        degree = len(self.points) - 1
        second = np.linalg.norm(np.diff(self.points, 2, axis=0), axis=1).max(initial=0.0)
        return sampled(self, _chord_count(math.sqrt(degree * (degree - 1) / 8 * second / distance)))


@dataclass(frozen=True, eq=False)
class Spline:
    """A curve of several polynomial pieces, such as a B-spline."""

    points: Points
    """Control points, shape (n, d), whose bounds approximate the bounds of the curve."""
    evaluate: Callable[[Points], Points]
    """Function of parameters (m,) that returns the points (m, d) of the curve."""
    breaks: Points
    """Parameters at the start, between the pieces, and at the end."""

    def at(self, t: Points) -> Points:
        """Return points (n, d) at fractions (n,) of the curve; each piece is an equal fraction."""
        count = len(self.breaks)
        return self.evaluate(np.interp(t * (count - 1), np.arange(count), self.breaks))

    def transformed(self, matrix: Points, offset: Points) -> Spline:
        """Return the image of the curve under the map p -> p @ matrix + offset."""
        evaluate = self.evaluate
        points = self.points @ matrix + offset
        return Spline(points, lambda t: evaluate(t) @ matrix + offset, self.breaks)

    def chords(self, distance: float) -> Points:
        """Return vertices (n, d) of chords within `distance` of the curve."""
        pieces = 4 * (len(self.breaks) - 1)
        t = np.arange(pieces + 1) / pieces
        while True:
            points, midpoints = self.at(t), (t[1:] + t[:-1]) / 2
            # This length is an upper bound on the distance of the curve from the chord.
            off = np.linalg.norm(self.at(midpoints) - (points[1:] + points[:-1]) / 2, axis=1)
            if (off <= distance).all():
                return points
            t = np.union1d(t, midpoints[off > distance])
            _chord_count(len(t))


Curve = Points | Arc | Bezier | Spline


def transformed(curve: Curve, matrix: Points, offset: Points) -> Curve:
    """Return the image of a curve under the map p -> p @ matrix + offset.

    The matrix has shape (d, e) and the offset shape (e,).
    """
    if isinstance(curve, np.ndarray):
        return curve @ matrix + offset
    return curve.transformed(matrix, offset)


def sampled(curve: Curve, steps: int = 1) -> Points:
    """Return `steps` + 1 points at equal steps along a curve; all vertices of a polyline."""
    return curve if isinstance(curve, np.ndarray) else curve.at(np.arange(steps + 1) / steps)


def chords(curve: Curve, distance: float) -> Points:
    """Return vertices (n, d) of chords that deviate from a curve by at most `distance`."""
    return curve if isinstance(curve, np.ndarray) else curve.chords(distance)


def allowed_distance(outline: Sequence[Curve], tolerance: float | None) -> float:
    """Return the largest distance allowed between an outline and its chords.

    The distance is `tolerance`, or 1/2000 of the diagonal of the outline if `tolerance` is None.
    Raises FileFormatError for coordinates beyond 1e100.
    """
    points = np.concatenate([
        curve.points if isinstance(curve, Bezier | Spline) else sampled(curve, 8)
        for curve in outline
    ])  # fmt: skip
    check_coordinates(points)
    distance = DEFAULT_TOLERANCE * extent(points) if tolerance is None else tolerance
    # The distance is at least the rounding error of the coordinates.
    return max(distance, 1e-15 * float(np.abs(points).max()), np.finfo(float).tiny)


def flattened(outlines: Sequence[Sequence[Curve]], tolerance: float | None) -> list[Ring]:
    """Return each outline as a ring (n, d) without a repeated first vertex.

    Chords deviate from the curves by at most `tolerance`, by default 1/2000 of the diagonal of the
    outline. Full ellipses keep their area. Raises FileFormatError for coordinates beyond 1e100 and
    for more than a million chords.
    """
    distances = [allowed_distance(outline, tolerance) for outline in outlines]
    return [
        np.concatenate([chords(curve, distance)[:-1] for curve in outline])
        for outline, distance in zip(outlines, distances, strict=True)
    ]


def _chord_count(steps: float) -> int:
    """Round a number of chords up, to at least 1; raise FileFormatError if it exceeds a million."""
    remedy = "simplify the outlines, or pass a larger tolerance for curves"
    check_most(steps, MOST_VERTICES, "vertices", remedy, FileFormatError)
    return max(1, math.ceil(steps))


OVERLAP_REMEDY = (
    "join them in the drawing, read fewer layers (--layer), or pass union=True (--union)"
)
"""Remedy in the error message for outlines that overlap."""

Polygon = list[Ring]
"""Rings of a polygon, with the exterior first."""


@dataclass(frozen=True, eq=False)
class File:
    """A file to be read, with the options of the caller."""

    path: Path
    content: bytes
    unit_metres: float
    """Length of the file's unit in metres; ignored if the file itself specifies its unit."""
    tolerance: float | None
    """Largest distance in metres between a curve and its chords; see :func:`flattened` for None."""
    layers: tuple[str, ...]
    """Names of the layers to read, even if they are hidden; if empty, all visible layers are
    read."""
    union: bool
    """Whether overlapping outlines are joined."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """Polygons of a file in the file's unit; each is a list of rings with the exterior first."""

    polygons: Sequence[Sequence[Any]]
    metres: float
    """Length of the file's unit in metres."""


def check_known(requested: Iterable[str], known: Iterable[str]) -> None:
    """Raise ArgumentError for a requested layer that the drawing does not contain."""
    names = sorted(set(known))
    missing = [name for name in requested if name not in names]
    if missing:
        listed = ", ".join(name[:60] for name in names[:12]) + ", ..." * (len(names) > 12)
        raise ArgumentError(
            f"the drawing has no layer {missing[0][:60]!r}; "
            + (f"its layers are {listed}" if names else "it has no named layers, so omit layer")
        )


def filled(rings: Sequence[Ring], rule: str) -> list[Polygon]:
    """Return the polygons that rings fill under the fill rule "nonzero" or "evenodd".

    Rings with all vertices on one line are ignored, and the list may be empty. Rings of the result
    may repeat their first vertex at the end.
    """
    rings = [ring for ring in rings if len(ring) > 1 and hull_spans_area(ring)]
    if not rings:
        return []
    if len(rings) == 1 and shapely.is_valid(shapely.Polygon(rings[0])):
        # A simple outline is returned unchanged, because it is cleaned later with the aperture.
        return [rings]
    clean = [clean_ring(ring, "a ring") for ring in rings]
    return [rings_of_polygon(polygon) for polygon in enclosed(clean, rule)]


def nesting_depths(rings: Sequence[Ring]) -> NDArray[np.intp]:
    """Return the number of other rings around each ring, shape (n,)."""
    return np.bincount(_containing(rings)[1], minlength=len(rings))


def nested(rings: Sequence[Ring], union: bool = False) -> list[Polygon]:
    """Return polygons, each as a list of an outline and its holes, the rings directly inside it.

    A ring inside a hole starts a new polygon. The orientation of rings is arbitrary. Rings that
    cross themselves raise a GeometryError. Overlapping rings are joined if ``union`` is true, and
    otherwise also raise a GeometryError.
    """
    is_simple = shapely.is_valid([shapely.Polygon(ring) for ring in rings])
    clean = [
        ring if simple else part_of_ring(ring, f"outline {k}")[0]
        for k, (ring, simple) in enumerate(zip(rings, is_simple.tolist(), strict=True))
    ]
    lines = shapely.MultiLineString([np.concatenate([ring, ring[:1]]) for ring in clean])
    if not shapely.is_simple(lines):
        if union:
            clean = _join_overlapping(clean)
        else:
            polygons = [shapely.Polygon(ring) for ring in clean]
            check_overlaps(polygons, "outlines", OVERLAP_REMEDY, nested=True)
    return _by_nesting(clean)


def _join_overlapping(rings: Sequence[Ring]) -> list[Ring]:
    """Return the rings (including holes) of the unions of outlines that overlap or touch."""
    polygons = np.array([shapely.Polygon(ring) for ring in rings], dtype=object)
    tree = shapely.STRtree(polygons)
    pairs = [tree.query(polygons, predicate=relation) for relation in ("overlaps", "touches")]
    group = connected(len(rings), *np.concatenate(pairs, axis=1))
    joined: list[Ring] = []
    for number in np.unique(group):
        members = polygons[group == number]
        region = members[0] if len(members) == 1 else union_on_grid(list(members))
        joined += [ring for polygon in polygons_in(region) for ring in rings_of_polygon(polygon)]
    return joined


def _by_nesting(rings: Sequence[Ring]) -> list[Polygon]:
    """Return polygons of rings that do not cross: the rings at odd depths are holes."""
    outer, inner = _containing(rings)
    depth = np.bincount(inner, minlength=len(rings))
    order = np.argsort(depth[outer], kind="stable")
    innermost = dict(zip(inner[order].tolist(), outer[order].tolist(), strict=True))
    polygons = {k: [ring] for k, ring in enumerate(rings) if depth[k] % 2 == 0}
    for k, ring in enumerate(rings):
        if k not in polygons:
            polygons[innermost[k]].append(ring)
    return list(polygons.values())


def _containing(rings: Sequence[Ring]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of outer rings (m,), and of the rings inside them (m,)."""
    if not len(rings):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    polygons = [shapely.Polygon(ring) for ring in rings]
    sizes = np.abs([signed_area(ring) for ring in rings])
    points = shapely.STRtree(shapely.point_on_surface(polygons))
    outer, inner = points.query(polygons, predicate="contains")
    is_larger = sizes[outer] > sizes[inner]
    return outer[is_larger], inner[is_larger]
