"""Bodies for tests: prisms, spheres, tori and others."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import polywigner as pw


def prism(ring: Any, low: float, high: float) -> pw.Polyhedron:
    """Return a prism over a counter-clockwise ring (n, 2), with the ring as bottom and top faces.

    The ring must be star-shaped about its first vertex.
    """
    points, n = np.asarray(ring, dtype=float), len(ring)
    levels = [np.column_stack([points, np.full(n, z)]) for z in (low, high)]
    sides = [(k, (k + 1) % n, (k + 1) % n + n, k + n) for k in range(n)]
    faces = [(0, *range(n - 1, 0, -1)), tuple(range(n, 2 * n)), *sides]
    return pw.Polyhedron(np.concatenate(levels), faces)


def extruded(ring: Any, height: float) -> pw.Polyhedron:
    """Return a prism on the plane z = 0."""
    return prism(ring, 0.0, height)


def box(low: Any, high: Any) -> pw.Polyhedron:
    """Return a box between two corners, with its sides along the axes."""
    (a, b, c), (d, e, f) = low, high
    return prism([(a, b), (d, b), (d, e), (a, e)], c, f)


def sphere(splits: int) -> pw.Polyhedron:
    """Return 20 4^splits facets of a unit sphere: an icosahedron with halved edges."""
    g = (1 + 5**0.5) / 2
    rows = [(s * 1.0, t * g, 0.0) for s in (-1, 1) for t in (-1, 1)]
    points = np.array([np.roll(row, k) for k in range(3) for row in rows])
    near = np.linalg.norm(points[:, None] - points, axis=2) < 2.1
    faces = np.array(
        [
            (a, b, c) if np.linalg.det(points[[a, b, c]]) > 0 else (a, c, b)
            for a in range(12)
            for b in range(a + 1, 12)
            for c in range(b + 1, 12)
            if near[a, b] and near[b, c] and near[a, c]
        ]
    )
    for _ in range(splits):
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]))
        ends, number = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = number.reshape(3, -1) + len(points)
        points = np.concatenate([points, points[ends].mean(axis=1)])
        a, b, c = faces.T
        faces = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
        )
    return pw.Polyhedron(points / np.linalg.norm(points, axis=1, keepdims=True), faces)


def ball(radius: float, steps: int) -> pw.Polyhedron:
    """Return a ball with 2 * steps meridians and its equator in the plane z = 0."""
    from scipy.spatial import ConvexHull

    theta = np.pi * np.arange(1, steps) / steps
    phi = np.pi * np.arange(2 * steps) / steps
    t, p = (a.ravel() for a in np.meshgrid(theta, phi))
    points = np.column_stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
    points = radius * np.concatenate([points, [[0, 0, 1], [0, 0, -1]]])
    hull = ConvexHull(points)
    faces = [
        face if np.cross(*(points[face[1:]] - points[face[0]])) @ points[face].mean(0) > 0
        else face[::-1]
        for face in hull.simplices
    ]  # fmt: skip
    return pw.Polyhedron(points, faces)


def torus(count: int, around: int) -> pw.Polyhedron:
    """Return a torus with 2 * count * around facets and the radii 1 and 0.4."""
    i, j = (k.ravel() for k in np.meshgrid(np.arange(count), np.arange(around), indexing="ij"))
    a, b = 2 * np.pi * i / count, 2 * np.pi * j / around
    out = 1 + 0.4 * np.cos(b)
    points = np.stack([out * np.cos(a), out * np.sin(a), 0.4 * np.sin(b)], axis=1)

    def number(i: Any, j: Any) -> Any:
        return i % count * around + j % around

    p, q, r, s = number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)
    return pw.Polyhedron(
        points, np.concatenate([np.stack([p, q, r], axis=1), np.stack([p, r, s], axis=1)])
    )


def joined(parts: Any) -> pw.Polyhedron:
    """Return a body with the triangles of several closed bodies."""
    points, faces, count = [], [], 0
    for part in parts:
        points.append(part.vertices)
        faces += [tuple(int(v) + count for v in triangle) for triangle in part.triangles]
        count += len(part.vertices)
    return pw.Polyhedron(np.concatenate(points), faces)


def hollow(body: pw.Polyhedron, inner: Any) -> pw.Polyhedron:
    """Return a body with a cavity, whose corners are the corners of the body moved inwards."""
    inwards = [[k + len(inner) for k in face[::-1]] for face in body.faces]
    return pw.Polyhedron(np.concatenate([body.vertices, inner]), [*body.faces, *inwards])


def moved(body: pw.Polyhedron, x: float, y: float, z: float) -> pw.Polyhedron:
    return pw.Polyhedron(body.vertices + np.array([x, y, z]), body.faces)


def block(x: float, y: float, z: float) -> pw.Polyhedron:
    """Return a box on the plane z = 0 about the z axis."""
    return extruded([(-x / 2, -y / 2), (x / 2, -y / 2), (x / 2, y / 2), (-x / 2, y / 2)], z)


def drone(sides: int) -> pw.Polyhedron:
    """Return a box of 0.2 m with four arms, and a prism at the end of each arm."""
    parts = [moved(block(0.2, 0.2, 0.06), 0, 0, -0.03)]
    angles = 2 * np.pi * np.arange(sides) / sides
    prism = 0.03 * np.column_stack([np.cos(angles), np.sin(angles)])
    for k in range(4):
        c, s = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])[k]
        arm = np.array([(0.05, -0.01), (0.32, -0.01), (0.32, 0.01), (0.05, 0.01)])
        parts.append(moved(extruded(arm @ np.array([[c, s], [-s, c]]), 0.02), 0, 0, -0.01))
        parts.append(moved(extruded(prism, 0.05), 0.32 * c, 0.32 * s, -0.005))
    return joined(parts)


def towards(polar: float, azimuth: float) -> np.ndarray:
    """Return a unit vector from angles in degrees."""
    a, b = math.radians(polar), math.radians(azimuth)
    return np.array([math.sin(a) * math.cos(b), math.sin(a) * math.sin(b), math.cos(a)])


def across(direction: np.ndarray) -> np.ndarray:
    """Return a unit vector perpendicular to a direction."""
    vector = np.cross(direction, (0.0, 0.6, 0.8))
    return np.asarray(vector / np.linalg.norm(vector))


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Return the pose of a translation."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def section_root(area: float, wavelength: float) -> float:
    """Return the square root of the cross section of a plate at normal incidence."""
    return math.sqrt(4 * math.pi) * area / wavelength


L_BODY = extruded([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)], 1.5)
STEPS = extruded([(0, 0), (3, 0), (3, 1), (2, 1), (2, 2), (1, 2), (1, 3), (0, 3)], 2.0)
BOX = extruded([(0, 0), (2, 0), (2, 1), (0, 1)], 0.5)
DIRECTIONS = np.array([towards(a, b) for a, b in ((20, 10), (55, 130), (80, 250), (140, 300))])
