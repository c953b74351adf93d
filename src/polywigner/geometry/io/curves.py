"""Curves of drawings, and chords that stay within a stated distance of them.

A curve is a run of straight lines ((n, d) vertices), an :class:`Arc` of an ellipse or a
:class:`Bezier`, in two or three dimensions. An outline is a sequence of curves, each of which
starts where the one before it ends; the last one ends where the first one starts.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import FileFormatError
from polywigner.geometry.exact import Ring
from polywigner.geometry.io.limits import MOST_VERTICES, check_coordinates

DEFAULT_TOLERANCE = 1 / 2000
"""Largest distance between a curve and its chords, in diagonals of the outline's bounds.

A circle becomes 52 vertices; a quarter circle in a rounded corner, of a tenth of the outline's
size, 8 chords. On an outline of ten wavelengths it is 1/200 of a wavelength.
"""

# A chord that spans more would leave a polygon of fewer than eight sides of a small circle.
_LARGEST_STEP = math.pi / 4

Points = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Arc:
    """centre + u cos t + v sin t for t from start to start + sweep (radians)."""

    centre: Points
    u: Points
    v: Points
    start: float
    sweep: float

    @property
    def is_closed(self) -> bool:
        """A whole ellipse, up to the rounding of angles in degrees."""
        return abs(self.sweep) >= 2 * math.pi * (1 - 1e-12)

    def at(self, angles: Points) -> Points:
        """Points (n, d) at these angles (n,)."""
        return self.centre + np.cos(angles)[:, None] * self.u + np.sin(angles)[:, None] * self.v


@dataclass(frozen=True, eq=False)
class Bezier:
    """A Bezier curve of control points (p + 1, d)."""

    points: Points


Curve = Points | Arc | Bezier


def ends(curve: Curve) -> Points:
    """First and last point, shape (2, d)."""
    if isinstance(curve, Arc):
        return curve.at(np.array([curve.start, curve.start + curve.sweep]))
    points = curve.points if isinstance(curve, Bezier) else curve
    return points[[0, -1]]


def transformed(curve: Curve, matrix: Points, offset: Points) -> Curve:
    """The image under p -> p @ matrix + offset; `matrix` (d, e), `offset` (e,)."""
    if isinstance(curve, Arc):
        centre = curve.centre @ matrix + offset
        return Arc(centre, curve.u @ matrix, curve.v @ matrix, curve.start, curve.sweep)
    if isinstance(curve, Bezier):
        return Bezier(curve.points @ matrix + offset)
    return curve @ matrix + offset


def rough_points(curve: Curve) -> Points:
    """Points with about the bounds of the curve, for the tolerance."""
    if isinstance(curve, Arc):
        return curve.at(curve.start + curve.sweep * np.linspace(0, 1, 9))
    return curve.points if isinstance(curve, Bezier) else curve


def flattened(outlines: Sequence[Sequence[Curve]], tolerance: float | None) -> list[Ring]:
    """Each outline as a ring (n, d) without a closing repeat, its chords within `tolerance`.

    `tolerance` in the units of the curves; None: 1/2000 of each outline's own size. A whole
    ellipse becomes a polygon of the same area; else all vertices lie on the curve.

    Raises
    ------
    FileFormatError for numbers beyond 1e100 and for more than a million vertices.
    """
    rings: list[Ring] = []
    left = MOST_VERTICES
    for outline in outlines:
        points = np.concatenate([rough_points(curve) for curve in outline])
        check_coordinates(points)
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        reach = DEFAULT_TOLERANCE * size if tolerance is None else tolerance
        # A point-like outline has no curves to follow; its ring is refused, or dropped, later.
        reach = max(reach, 1e-15 * float(np.abs(points).max()), np.finfo(float).tiny)
        pieces = []
        for curve in outline:
            pieces.append(_chords(curve, reach, left)[:-1])
            left -= len(pieces[-1])
        rings.append(np.concatenate(pieces))
    return rings


def _counted(steps: float, left: int) -> int:
    if not steps <= left:
        raise FileFormatError(
            f"expected at most {MOST_VERTICES} vertices, got more; simplify the outlines or give a "
            "larger tolerance for curves"
        )
    return max(1, math.ceil(steps))


def _chords(curve: Curve, reach: float, left: int) -> Points:
    """Vertices (n, d) of chords along the curve, its ends included."""
    if isinstance(curve, Arc):
        return _ellipse(curve, reach, left) if curve.is_closed else _arc(curve, reach, left)
    if isinstance(curve, Bezier):
        return _polynomial(curve.points, reach, left)
    _counted(len(curve) - 1, left)
    return curve


def _stretch(arc: Arc) -> float:
    """The larger half axis: by no more does the map from the unit circle stretch a distance."""
    return float(np.linalg.norm(np.stack([arc.u, arc.v]), 2))


def _arc(arc: Arc, reach: float, left: int) -> Points:
    """A chord over the angle d stays within stretch (1 - cos(d/2)) of its arc."""
    half = math.acos(max(-1.0, 1 - reach / max(_stretch(arc), reach)))
    steps = _counted(abs(arc.sweep) / min(2 * half, _LARGEST_STEP), left)
    return arc.at(arc.start + arc.sweep * np.arange(steps + 1) / steps)


def _ellipse(arc: Arc, reach: float, left: int) -> Points:
    """A polygon with 4 k vertices and the area of the ellipse: a^2 = x/sin(x), x = 2 pi/n.

    Its corners stand out by (a - 1) stretch < 1.0001 (pi/n)^2/3 stretch for n >= 48 (1.04 for
    n = 8), and its sides dip by half of that.
    """
    steps = 1.04 * math.pi * math.sqrt(_stretch(arc) / (3 * reach)) if reach else math.inf
    n = 4 * max(2, _counted(steps / 4, left // 4))
    x = 2 * math.pi / n
    grown = math.sqrt(x / math.sin(x))
    angles = arc.start + math.copysign(x, arc.sweep) * np.arange(n + 1)
    return Arc(arc.centre, grown * arc.u, grown * arc.v, 0, 0).at(angles)


def _polynomial(points: Points, reach: float, left: int) -> Points:
    """Equal steps of the parameter: the second derivative bounds the distance to a chord."""
    degree = len(points) - 1
    first = points[1:] - points[:-1]  # np.diff takes several times as long for few points
    second = np.linalg.norm(first[1:] - first[:-1], axis=1).max(initial=0.0)
    steps = _counted(math.sqrt(degree * (degree - 1) / 8 * float(second) / reach), left)
    t = np.arange(steps + 1)[:, None, None] / steps
    values = np.broadcast_to(points, (steps + 1, *points.shape))
    for _ in range(degree):  # de Casteljau
        values = values[:, :-1] + t * (values[:, 1:] - values[:, :-1])
    values = values[:, 0].copy()
    values[[0, -1]] = points[[0, -1]]
    return values


JOINT = 1e-6
"""Largest gap between ends that belong together, in diagonals of the drawing's bounds.

CAD programs write six decimals or more; ends of a drawing of 100 units meet within 1e-4.
"""


def chains(tips: Sequence[Points], gap: float) -> list[list[tuple[int, bool]]]:
    """Closed runs of paths whose ends (2, d) meet in pairs within `gap`, in any direction.

    Each run lists numbers of paths, and whether the path is run through backwards. Raises
    FileFormatError where an end is left over, or more than two meet.
    """
    if not tips:
        return []
    points = np.concatenate(tips)
    joints = _joints(points, gap)
    meeting: dict[int, list[int]] = defaultdict(list)
    for end, joint in enumerate(joints):
        meeting[joint].append(end)
    for members in meeting.values():
        if len(members) != 2:
            _refuse(points[members[0]], len(members))
    runs, used = [], set()
    for first in range(len(tips)):
        if first in used:
            continue
        run, end = [], 2 * first
        while end // 2 not in used:
            used.add(end // 2)
            run.append((end // 2, bool(end % 2)))
            a, b = meeting[joints[end ^ 1]]  # ends 2 k and 2 k + 1 belong to path k
            end = b if a == end ^ 1 else a
        runs.append(run)
    return runs


def _joints(points: Points, gap: float) -> list[int]:
    """A number for each point, the same for those within `gap` of one that was there before."""
    geometries = shapely.points(points[:, :2])
    first, second = shapely.STRtree(geometries).query(geometries, predicate="dwithin", distance=gap)
    numbers = np.arange(len(points))
    np.minimum.at(numbers, first, second)
    return [int(n) for n in numbers]


def _refuse(point: Points, count: int) -> None:
    place = f"({point[0]:.6g}, {point[1]:.6g})"
    if count == 1:
        raise FileFormatError(
            f"expected lines and arcs that close, got an end at {place} that meets no other; close "
            "the outline, or move what is no outline to a layer that is off"
        )
    raise FileFormatError(
        f"expected two ends wherever lines and arcs meet, got {count} at {place}; draw the "
        "outlines as closed polylines"
    )
