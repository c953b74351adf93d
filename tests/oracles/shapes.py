"""Apertures whose edges coincide, align, touch or are nearly parallel, as (outer, holes) lists."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

Polygons = list[tuple[np.ndarray, list[np.ndarray]]]

GOLDEN = (1 + math.sqrt(5)) / 2


def _box(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _parts(*rings: object) -> Polygons:
    return [(np.asarray(ring, float), []) for ring in rings]


def _turned(polygons: Polygons, angle: float, scale: float = 1.0, shift=(0.0, 0.0)) -> Polygons:
    c, s = math.cos(angle) * scale, math.sin(angle) * scale
    turn = np.array([[c, s], [-s, c]])
    return [(o @ turn + shift, [h @ turn + shift for h in holes]) for o, holes in polygons]


def _regular(n: int, radius: float, phase: float = 0.0, centre=(0.0, 0.0)) -> np.ndarray:
    angle = phase + 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle)]) * radius + centre


def _star(points: int, outer: float, inner: float) -> np.ndarray:
    ring = _regular(2 * points, outer, np.pi / 2)
    ring[1::2] *= inner / outer
    return ring


def _nearly_parallel() -> np.ndarray:
    """A strip whose edges lean by 1e-3, 1e-5, ..., 1e-13 against each other."""
    x = np.arange(7) / 6
    lower = np.cumsum([0, 1e-3, -1e-5, 1e-7, -1e-9, 1e-11, -1e-13]) / 6
    upper = 0.4 + np.cumsum([0, -1e-4, 1e-6, -1e-8, 1e-10, -1e-12, 0]) / 6
    return np.concatenate([np.column_stack([x, lower]), np.column_stack([x, upper])[::-1]])


def _with_redundant_corners(out: Sequence[float]) -> np.ndarray:
    """A square with three more corners on each side, moved out of it by these distances."""
    corners = _box(-0.5, -0.5, 0.5, 0.5)
    ring = []
    for k, (start, end) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        along = end - start
        outward = np.array([along[1], -along[0]])
        ring.append(start)
        ring += [start + (j + 1) / 4 * along + out[3 * k + j] * outward for j in range(3)]
    return np.array(ring)


BENDS = np.array([1e-5, -1e-6, 1e-7, -3e-8, 1e-8, -1e-8, 3e-9, -1e-9, 1e-9, -1e-10, 1e-11, 1e-13])


def _hexagons() -> Polygons:
    """Seven hexagonal segments with no gap; neighbours share whole edges."""
    radius = 1 / math.sqrt(3)
    centres = [(0.0, 0.0)] + [
        (math.cos(k * math.pi / 3 + math.pi / 6), math.sin(k * math.pi / 3 + math.pi / 6))
        for k in range(6)
    ]
    # one table of corners, so that shared corners are the same floats
    corners: list[np.ndarray] = []

    def shared(point: np.ndarray) -> np.ndarray:
        for known in corners:
            if np.hypot(*(known - point)) < 1e-9:
                return known
        corners.append(point)
        return point

    hexagons = (_regular(6, radius, 0.0, centre) for centre in centres)
    return _parts(*(np.array([shared(p) for p in ring]) for ring in hexagons))


CHEVRON = np.array([[0, 0], [1, 0.5], [2, 0], [2, 0.6], [1, 1.1], [0, 0.6]])
PLUS = np.array(
    [[1, 0], [2, 0], [2, 1], [3, 1], [3, 2], [2, 2], [2, 3], [1, 3], [1, 2], [0, 2], [0, 1], [1, 1]]
) - 1.5  # fmt: skip
ELL = np.array([[0, 0], [1.5, 0], [1.5, 0.4], [0.5, 0.4], [0.5, 1.2], [0, 1.2]])
U_SHAPE = np.array([[0, 0], [1.2, 0], [1.2, 1], [0.9, 1], [0.9, 0.3], [0.3, 0.3], [0.3, 1], [0, 1]])
VEE = np.array([[0, 0], [0.8, 1.3], [0.55, 1.3], [0, 0.40625], [-0.55, 1.3], [-0.8, 1.3]])


def awkward_shapes() -> dict[str, Polygons]:
    """Name -> polygons; the reference data keep the coordinates, so these may change freely."""
    touching = _parts(_box(0, 0, 1, 1), _box(1, 0, 2, 1))
    return {
        "square": _parts(_box(-0.5, -0.5, 0.5, 0.5)),
        "rectangle off centre": _parts(_box(-0.7, 0.1, 1.3, 0.8)),
        "10 mm square, rotated and shifted": _turned(
            _parts(_box(-0.005, -0.005, 0.005, 0.005)), 0.3, 1.0, (0.0123, -0.0047)
        ),
        "triangle": _parts([[0, 0], [1.3, 0.2], [0.4, 1.1]]),
        "chevron": _parts(CHEVRON),
        "two chevrons": _parts(CHEVRON, CHEVRON + np.array([0, 1.7])),
        "two touching squares": touching,
        "two touching squares, rotated": _turned(touching, GOLDEN),
        "L": _parts(ELL),
        "U": _parts(U_SHAPE),
        "V": _parts(VEE),
        "plus": _parts(PLUS),
        "plus, rotated": _turned(_parts(PLUS), 1 / GOLDEN, 0.1),
        "square annulus": [(_box(-1, -1, 1, 1), [_box(-0.5, -0.5, 0.5, 0.5)])],
        "holes aligned with edges": [
            (
                _box(0, 0, 3, 2),
                [_box(0.5, 0.5, 1.0, 1.5), _box(1.5, 0.5, 2.0, 1.0), _box(1.5, 1.25, 2.5, 1.5)],
            )
        ],
        "holed, rotated": _turned([(_box(-1, -0.6, 1, 0.6), [_box(-0.5, -0.3, 0.25, 0.3)])], 0.7),
        "hexagon": _parts(_regular(6, 1.0)),
        "16-gon": _parts(_regular(16, 1.0, 0.1)),
        "64-gon": _parts(_regular(64, 1.0)),
        "star": _parts(_star(5, 1.0, 0.45)),
        "bow tie, split": _parts(
            [[-1, -0.5], [0.1, 0.05], [-1, 0.6]], [[0.1, 0.05], [1, -0.5], [1, 0.6]]
        ),
        "nearly parallel edges": _parts(_nearly_parallel()),
        "nearly parallel edges, rotated": _turned(_parts(_nearly_parallel()), 1.1),
        "hexagonal segments without gap": _hexagons(),
        "double slit": _parts(_box(-0.6, -1, -0.3, 1), _box(0.25, -1, 0.55, 1)),
        "four patches": _parts(
            *(_box(x, y, x + 0.8, y + 0.8) for x in (0.0, 1.0) for y in (0.0, 1.0))
        ),
        "needle 1e-6": _parts([[-0.5, -5e-7], [0.5, -5e-7], [0.5, 5e-7], [-0.5, 5e-7]]),
        "needle 1e-3, rotated": _turned(
            _parts([[-0.5, -5e-4], [0.5, -5e-4], [0.5, 5e-4], [-0.5, 5e-4]]), 0.4
        ),
        "nearly collinear corners": _parts(_with_redundant_corners(BENDS)),
        "nearly collinear corners, rotated": _turned(_parts(_with_redundant_corners(BENDS)), 0.9),
        "corners collinear to 1e-9": _parts(_with_redundant_corners(1e-4 * BENDS[::-1])),
        "corners collinear to rounding, rotated": _turned(
            _parts(_with_redundant_corners(np.zeros(12))), 0.9
        ),
    }
