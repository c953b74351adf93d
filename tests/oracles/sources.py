"""Sources of every class for Fourier transforms, and frequencies that are numerically difficult.

Frequencies along and across edges and faces, up to a small angle, make terms of closed forms 0/0 or
cause cancellation. Sizes cover all decades of |nu| times diameter.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import shapely

import polywigner as pw
from oracles.meshes import extruded, hollow

DECADES = tuple(range(-15, 4))
# Angles from an edge or a face in radians.
TILTS = (0.0, 1e-16, 1e-15, 1e-14, 1e-13, 1e-12, 1e-8, 1e-4)

CUBE = extruded([(0, 0), (1, 0), (1, 1), (0, 1)], 1.0)
CHEVRON = np.array([[0, 0], [1, 0.5], [2, 0], [2, 0.6], [1, 1.1], [0, 0.6]])
ELL = np.array([[0, 0], [1.5, 0], [1.5, 0.4], [0.5, 0.4], [0.5, 1.2], [0, 1.2]])
NEEDLE, FAR = 1e-6, 1e3


def _box(width: float, height: float, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    half = np.array([width, height]) / 2
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half + [x, y]


def _turned(ring: Any, angle: float, shift: Any = (0.0, 0.0)) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(ring, float) @ np.array([[c, s], [-s, c]]) + shift


def _ngon(n: int, radius: float = 1.0) -> np.ndarray:
    angle = 0.1 + 2 * np.pi * np.arange(n) / n
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _star() -> np.ndarray:
    return _ngon(10) * np.where(np.arange(10) % 2, 0.4, 1.0)[:, None]


def rotation(seed: int) -> np.ndarray:
    """Return a random rotation matrix."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def _pose(seed: int, *shift: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation(seed), shift
    return pose


def cube(stretch: Any = (1.0, 1.0, 1.0), seed: int = 0, shift: Any = (0.0, 0.0, 0.0)) -> Any:
    """Return a box around the origin, rotated unless ``seed`` is 0, and shifted."""
    return _posed((CUBE.vertices - 0.5) * np.asarray(stretch), CUBE.faces, seed, shift)


def _posed(vertices: np.ndarray, faces: Any, seed: int, shift: Any) -> pw.Polyhedron:
    return pw.Polyhedron((vertices @ rotation(seed).T if seed else vertices) + shift, faces)


def _prism(outline: Any, height: float, seed: int = 0, shift: Any = (0.0, 0.0, 0.0)) -> Any:
    body = extruded(outline, height)
    bottom, *others = body.faces
    # Fans of triangles from these corners lose the fewest digits.
    return _posed(body.vertices, [[*bottom[1:], bottom[0]], *others], seed, shift)


def _hollow(wall: float, seed: int) -> Any:
    body = hollow(CUBE, CUBE.vertices * (1 - 2 * wall) + wall)
    return _posed(body.vertices, body.faces, seed, 0.0)


def _tetrahedron() -> Any:
    corners = [[0, 0, 0], [1, 0.1, 0], [0.3, 1.2, 0.1], [0.2, 0.4, 0.9]]
    return pw.Polyhedron(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def _sources() -> dict[str, dict[str, Any]]:
    square = _box(1, 1)
    holed = shapely.Polygon(_box(2, 1.2), [_box(0.75, 0.6, -0.125)])
    annulus = shapely.Polygon(_ngon(12), [_ngon(7, 0.6)])
    needle = _box(1, NEEDLE)
    return {
        "convex": {
            "square": pw.Aperture(square),
            "triangle": pw.Aperture([[0, 0], [1.3, 0.2], [0.4, 1.1]]),
            "64-gon": pw.Aperture(_ngon(64)),
            "rectangle, turned": pw.Aperture(_turned(_box(2, 0.5), 0.4)),
        },
        "concave": {
            "chevron": pw.Aperture(CHEVRON),
            "L, turned": pw.Aperture(_turned(ELL, 1.1)),
            "star": pw.Aperture(_star()),
        },
        "holed": {"frame": pw.Aperture(holed), "annulus": pw.Aperture(annulus)},
        "disjoint": {
            "two chevrons": pw.Aperture([CHEVRON, CHEVRON + np.array([0, 1.7])]),
            "squares in a corner": pw.Aperture([_box(1, 1), _box(1, 1, 1, 1)]),
        },
        "needle": {
            "needle": pw.Aperture(needle),
            "needle, turned": pw.Aperture(_turned(needle, 0.7, (0.3, 0.1))),
            "triangle": pw.Aperture(_turned([[0, 0], [1, 3e-7], [0.3, 1e-6]], 2.1, (0.3, 0.1))),
            "chevron": pw.Aperture(_turned(CHEVRON * [1, NEEDLE], 0.9, (0.3, 0.1))),
        },
        "off centre": {
            "chevron": pw.Aperture(_turned(CHEVRON, 0.4, (2 * FAR, -1.5 * FAR))),
            "frame": pw.Aperture(shapely.affinity.translate(holed, 1234.5, 1987.6)),
            "needle": pw.Aperture(_turned(needle, 0.7, (0.7 * FAR, -0.6 * FAR))),
        },
        "slits": {
            "two": pw.Slits([[-1.0, -0.4], [0.1, 0.9]]),
            "off centre": pw.Slits(np.array([[-1.0, -0.4], [0.1, 0.9]]) + 1234.567),
        },
        "thin slits": {
            "three of width 1e-6": pw.Slits([[-0.5, -0.499999], [0.1, 0.100002], [0.4, 0.400001]]),
        },
        "placed": {
            "chevron": pw.Aperture(CHEVRON).placed(_pose(3, 0.3, -2.0, 5.0)),
            "frame, off centre": pw.Aperture(holed).placed(_pose(4, 1300.3, -1002.0, 1005.0)),
            "needle": pw.Aperture(needle).placed(_pose(5, 0.1, 0.2, 0.3)),
        },
        "convex body": {
            "cube": cube(),
            "cube, turned": cube(seed=1),
            "tetrahedron": _tetrahedron(),
            "hexagonal prism": _prism(_ngon(6), 0.7),
        },
        "concave body": {
            "chevron prism": _prism(CHEVRON, 0.7, 2),
            "star prism": _prism(_star(), 0.3),
            "L prism": _prism(ELL, 0.5, 7),
        },
        "body with cavity": {"thick": _hollow(0.2, 1), "thin": _hollow(0.01, 2)},
        "body off centre": {
            "cube": cube(seed=1, shift=(1000.1, -900.7, 800.3)),
            "chevron prism": _prism(CHEVRON, 0.7, 2, (-900.2, 1300.4, 1000.9)),
        },
        "needle or plate body": {
            "plate": cube((1, 1, NEEDLE), 1, (0.3, 0.1, 0.7)),
            "needle": cube((1, NEEDLE, NEEDLE), 2, (0.3, 0.1, 0.7)),
            "blade": cube((1, 1e-3, NEEDLE), 3),
            "chevron plate": _prism(CHEVRON, NEEDLE, 4, (0.3, 0.1, 0.7)),
            # The centre of the bounds of this prism is far outside the prism.
            "triangular plate": _prism([[0, 0], [1.3, 0.2], [0.4, 1.1]], NEEDLE, 8),
            "needle, off centre": cube((1, NEEDLE, NEEDLE), 5, (700.1, -900.7, 500.3)),
        },
    }


SOURCES = _sources()
"""Class -> name -> source."""


def points_of(source: Any) -> np.ndarray:
    """Return the vertices (n, d) in the space of nu."""
    if isinstance(source, pw.Slits):
        return source.intervals.reshape(-1, 1)
    if isinstance(source, pw.Polyhedron):
        return source.vertices
    if isinstance(source, pw.Aperture):
        return np.concatenate(source.rings)
    flat = np.concatenate(source.aperture.rings)
    return flat @ source.pose[:3, :2].T + source.pose[:3, 3]


def content(source: Any) -> float:
    """Return the length, area or volume."""
    if isinstance(source, pw.Slits):
        return source.length
    return float(source.volume if isinstance(source, pw.Polyhedron) else source.area)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _direction(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    """Return a unit vector: random, or along or normal to edges and faces with a tilt."""
    d = points.shape[1]
    kind = rng.integers(4)
    i, j, k = rng.choice(len(points), 3, replace=len(points) < 3)
    edge, other = points[i] - points[j], points[k] - points[j]
    anywhere = _unit(rng.normal(size=d))
    if kind == 0 or not edge.any():
        return anywhere
    if d == 2 and kind > 1:
        edge = np.array([-edge[1], edge[0]])
    if d == 3 and kind > 1:
        normal = np.cross(edge, other if kind == 2 else anywhere)
        edge = normal if np.linalg.norm(normal) > 1e-9 * np.linalg.norm(edge) else edge
    return _unit(edge) + rng.choice(TILTS) * anywhere


def frequencies(rng: np.random.Generator, source: Any, decade: float, count: int) -> np.ndarray:
    """Return frequencies (count, d) with |nu| D from 10^(decade - 1/2) to 10^decade."""
    points = points_of(source)
    diameter = max(np.linalg.norm(points - p, axis=1).max() for p in points)

    size = 10.0 ** rng.uniform(decade - 0.5, decade, (count, 1)) / diameter
    return size * np.array([_direction(rng, points) for _ in range(count)])
