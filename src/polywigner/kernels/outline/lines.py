"""The supporting lines of segments, in clusters of direction: docs/theory/edges.md.

What makes coincident edges come out right, under rounding, is that both copies are cut with the
same numbers. In a cluster of *parallel* lines all share one direction, and both copies compare the
same three floats. In a cluster of nearly parallel lines vertices are rounded to a grid so coarse
that every cut is as if computed in exact arithmetic. Lines of different clusters are more than
``NEARLY_PARALLEL`` apart, and meet at a well-conditioned point.

Neighbours at a small angle are in one cluster as well. Where an edge runs along a line of the
other copy, to within rounding, its neighbours decide where it ends. An edge in a cluster of
parallel lines is as good as moved by an ulp, and its end by an ulp over the angle. A regular
polygon at its centre has as many such ends as vertices.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from polywigner.numerics.exact import accurate_cross, exact_cross

# sine of the angle below which two lines count as nearly parallel: an intersection of lines at
# this angle is off by 1/0.03 ulps
NEARLY_PARALLEL = 0.03
# Angle below which neighbours are in one cluster: those of a regular polygon from 21 vertices on.
# Above it, ends of coincident edges are off by up to 1/0.3 ulps each. What that is of the area
# grows with perimeter over area: in the frame 4 to 8 for a disc, 400 to 800 for a ring of 0.99.
_LINKED, _STOUT = 0.3, 40.0
# A cluster counts as parallel if its lines agree to this angle, which moves an edge by less than
# 1e-14 (1e-7) of the diameter, and if no two of them lie so close that this could matter: their
# offsets either agree to the first of these figures, and are one line, or differ by the second.
# All other clusters go the exact way, so nothing depends on the values.
_PARALLEL = {True: 1e-14, False: 1e-7}  # by double precision or not
_SEPARATE = {True: 1e-12, False: 1e-5}
_SAME_OFFSET = {True: 3e-16, False: 1e-14}


@dataclass(frozen=True)
class Line:
    """All points p with cross(direction, p) = offset; left of it the cross product is larger."""

    dx: Any
    dy: Any
    offset: Any
    cluster: Any
    exact: bool
    px: Any  # a point of the line; on the grid if the line is exact
    py: Any


def linking_angle(rings: Sequence[npt.NDArray[np.float64]], double: bool) -> float:
    """The angle below which neighbours are in one cluster; ``rings`` in the frame.

    In single precision the grid of exact clusters costs thin outlines more than angles do.
    """
    if not double:
        return _LINKED
    sides = [(ring, np.roll(ring, -1, axis=0)) for ring in rings]
    perimeter = sum(np.hypot(*(b - a).T).sum() for a, b in sides)
    area = 0.5 * abs(sum((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() for a, b in sides))
    return float(_LINKED * max(1.0, perimeter / max(_STOUT * area, 1e-300)))


def _clusters(
    angles: npt.NDArray[np.float64], after: npt.NDArray[np.intp], linked: float
) -> npt.NDArray[np.intp]:
    """Cluster number of each direction in [0, pi): single linkage, the circle closed.

    Neighbours along the axes are not linked: their lines are known without rounding.
    """
    order = np.argsort(angles)
    sorted_angles = angles[order]
    starts = np.diff(sorted_angles, prepend=sorted_angles[:1]) > NEARLY_PARALLEL
    labels = np.cumsum(starts, dtype=np.intp)
    if sorted_angles[0] + np.pi - sorted_angles[-1] <= NEARLY_PARALLEL:
        labels[labels == labels[-1]] = 0
    result = np.empty_like(labels)
    result[order] = labels
    apart = np.abs(angles - angles[after])
    turned = np.isin(angles, (0.0, np.pi / 2), invert=True)
    near = np.minimum(apart, np.pi - apart) <= linked
    for k in np.flatnonzero(near & (turned | turned[after])):
        result[result == result[k]] = result[after[k]]
    return result


def _canonical(ex: float, ey: float) -> int:
    """+1 if a segment's direction lies in [0, pi), else -1."""
    return 1 if ey > 0 or (ey == 0 and ex > 0) else -1


class LineBook:
    """Collects the supporting lines of segments and gives each geometric line one number."""

    def __init__(
        self,
        segments: npt.NDArray[np.float64],
        after: npt.NDArray[np.intp],
        linked: float,
        double: bool,
    ) -> None:
        """``segments`` (n, 4): start and vector of every segment that will be asked for.

        ``after`` (n,): the number of the one that begins where each ends. ``linked``: see
        :func:`linking_angle`.
        """
        vectors, plain = segments[:, 2:], list(map(tuple, segments.tolist()))
        signs = np.array([_canonical(ex, ey) for *_, ex, ey in plain])
        angles = np.arctan2(signs * vectors[:, 1], signs * vectors[:, 0]) % np.pi
        clusters = _clusters(angles, after, linked)
        self.lines: list[Line] = []
        self.number_of: list[int] = []
        self.signs: list[int] = []
        """+1 where a segment runs along its line, -1 where it runs against it."""
        members: dict[int, list[tuple[float, ...]]] = {}
        for segment, label in zip(plain, clusters.tolist(), strict=True):
            members.setdefault(label, []).append(segment)
        shared = {cluster: _shared_direction(own, double) for cluster, own in members.items()}
        keys: dict[tuple[float, ...], int] = {}
        offsets: dict[int, list[float]] = {}
        for (ax, ay, ex, ey), sign, cluster in zip(
            plain, signs.tolist(), clusters.tolist(), strict=True
        ):
            direction = shared[cluster]
            if direction is None:
                start = (ax, ay) if sign > 0 else (ax + ex, ay + ey)
                dx, dy = sign * ex, sign * ey
                offset = exact_cross(dx, dy, *start)
                key: tuple[float, ...] = (*start, dx, dy)
            else:
                start = (ax, ay)
                dx, dy = direction
                sign = 1 if ex * dx + ey * dy > 0 else -1
                known = offsets.setdefault(cluster, [])
                offset = _merged(dx * ay - dy * ax, known, _SAME_OFFSET[double])
                key = (cluster, offset)
            if key not in keys:
                keys[key] = len(self.lines)
                self.lines.append(Line(dx, dy, offset, cluster, direction is None, *start))
            self.number_of.append(keys[key])
            self.signs.append(sign)

    @property
    def has_exact_lines(self) -> bool:
        return any(line.exact for line in self.lines)


def _shared_direction(
    segments: Sequence[tuple[float, ...]], double: bool
) -> tuple[float, float] | None:
    """The unit vector, in [0, pi), of a cluster whose lines are parallel, equal or well apart.

    Numbers of Python: most clusters have two segments, an edge and the side of a piece.
    """
    lengths = [math.hypot(ex, ey) for *_, ex, ey in segments]
    longest = lengths.index(max(lengths))
    *_, ex, ey = segments[longest]
    size = math.copysign(lengths[longest], _canonical(ex, ey))
    dx, dy = ex / size, ey / size
    for (*_, ex, ey), length in zip(segments, lengths, strict=True):
        if not abs(dx * ey - dy * ex) / length <= _PARALLEL[double]:
            return None
    ends = [(ax, ay) for ax, ay, *_ in segments]
    ends += [(ax + ex, ay + ey) for ax, ay, ex, ey in segments]
    offsets = sorted(dx * y - dy * x for x, y in ends)
    first = offsets[0]
    for offset, after in zip(offsets, [*offsets[1:], math.inf], strict=True):
        if after - offset > _SEPARATE[double]:
            if offset - first > _SAME_OFFSET[double]:
                return None
            first = after
    return dx, dy


def _merged(offset: float, known: list[float], rounding: float) -> float:
    """An offset already known that agrees with this one up to rounding, or this one."""
    for other in known:
        if abs(offset - other) <= rounding:
            return other
    known.append(offset)
    return offset


def slope_of(line: Line, edge: Any) -> Any:
    """cross(direction, e); without rounding first where the two may be nearly parallel."""
    if line.exact:
        return accurate_cross(line.dx, line.dy, edge.ex, edge.ey)
    return line.dx * edge.ey - line.dy * edge.ex


def start_of(line: Line, edge: Any, sign: int) -> Any:
    """Distance of ``sign`` times an edge's start to the left of the line."""
    if line.exact:
        return accurate_cross(line.dx, line.dy, sign * edge.ax - line.px, sign * edge.ay - line.py)
    return sign * (line.dx * edge.ay - line.dy * edge.ax) - line.offset


def cross_with_constant(ops: Any, dx: float, dy: float, x: Any, y: Any) -> Any:
    """dx y - dy x without the products that a direction along an axis makes superfluous."""
    if dx == 0.0:
        return x * -dy
    if dy == 0.0:
        return y * dx
    return ops.fma(y, dx, x * -dy)
