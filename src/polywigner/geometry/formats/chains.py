"""Loose lines and arcs of a drawing joined, end to end, into closed outlines."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
import shapely

from polywigner.errors import FileFormatError
from polywigner.geometry.formats.curves import (
    Arc,
    Curve,
    Points,
    ends,
    reversed_curve,
    rough_points,
)

__all__ = ["JOINT", "chained", "is_closed"]

JOINT = 1e-6
"""Largest gap between ends that belong together, in diagonals of the drawing's bounds.

CAD programs write six decimals or more; ends of a drawing of 100 units meet within 1e-4.
"""

Path = list[Curve]


def is_closed(path: Path, gap: float) -> bool:
    """Whether it is an outline by itself: a whole ellipse, or a run of which the ends meet."""
    if isinstance(path[0], Arc) and path[0].is_closed:
        return True
    closes = np.abs(ends(path[0])[0] - ends(path[-1])[1]).max() <= gap
    return bool(closes and (len(path) > 1 or np.ptp(rough_points(path[0]), axis=0).max() > gap))


def chained(paths: Sequence[Path], gap: float) -> list[Path]:
    """Closed outlines from open paths whose ends meet in pairs within `gap`, in any direction.

    Raises FileFormatError where an end is left over, or more than two meet.
    """
    if not paths:
        return []
    tips = np.array([[ends(path[0])[0], ends(path[-1])[1]] for path in paths])
    joints = _joints(tips.reshape(-1, tips.shape[-1]), gap)
    meeting: dict[int, list[int]] = defaultdict(list)
    for end, joint in enumerate(joints):
        meeting[joint].append(end)
    for members in meeting.values():
        if len(members) != 2:
            _refuse(tips.reshape(-1, tips.shape[-1])[members[0]], len(members))
    outlines, used = [], set()
    for first in range(len(paths)):
        if first in used:
            continue
        outline, end = [], 2 * first
        while end // 2 not in used:
            number, backwards = divmod(end, 2)
            used.add(number)
            outline += _run(paths[number], bool(backwards))
            a, b = meeting[joints[end ^ 1]]  # ends 2 k and 2 k + 1 belong to path k
            end = b if a == end ^ 1 else a
        outlines.append(outline)
    return outlines


def _run(path: Path, backwards: bool) -> Path:
    return [reversed_curve(curve) for curve in reversed(path)] if backwards else path


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
