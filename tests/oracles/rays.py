"""Physical optics by rays: a raster of them, each traced to the first triangle that it meets."""

from __future__ import annotations

from typing import Any

import numpy as np

import polywigner as pw


def lit_sum(
    body: pw.Polyhedron, s: Any, t: Any, wavelength: float, across: int
) -> tuple[np.ndarray, float]:
    """Sum of n exp(-2 pi i nu.x) dA over what is lit, (3,), and the area that the body covers.

    Lit from t, less what faces s and is not seen from there; nu = (s + t)/wavelength. Fans of all
    faces must cover them once.
    """
    corners = body.vertices[body.triangles]
    # off the directions of edges, along which all rays would miss by the same
    turn = np.array([[0.8, 0.6], [-0.6, 0.8]])
    axes = turn @ np.linalg.svd(t[None])[2][1:]
    flat = body.vertices @ axes.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    u, v = (low[k] + (np.arange(across) + 0.5) / across * (high - low)[k] for k in (0, 1))
    places = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2) @ axes
    start = places + 100 * t
    number, distance = _first_met(corners, start, -t)
    met = number >= 0
    start, number, distance = start[met], number[met], distance[met]
    points = start - distance[:, None] * t
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True))[number]
    outwards = np.sign((normals * t).sum(axis=1))[:, None] * normals
    hidden = _first_met(corners, points + 1e-6 * s, s)[0] >= 0
    counts = ~(hidden & (outwards @ s > 0)) if not np.array_equal(s, t) else np.ones(len(s), bool)
    cell = float(np.prod(high - low)) / across**2
    weight = cell / (outwards @ t) * np.exp(-2j * np.pi * points @ (s + t) / wavelength)
    weight = weight if np.array_equal(s, t) else weight * counts
    return (outwards * weight[:, None]).sum(axis=0), cell * len(points)


def _first_met(corners: np.ndarray, start: np.ndarray, along: np.ndarray) -> Any:
    """Numbers of the triangles that rays meet first, -1 for none, and how far from the start."""
    nearest, number = np.full(len(start), np.inf), np.full(len(start), -1)
    for k, (a, b, c) in enumerate(corners):
        normal = np.cross(b - a, c - a)
        slope = normal @ along
        if slope > -1e-12:
            continue  # rays enter a body through faces that look towards them
        distance = (a - start) @ normal / slope
        near = (distance > 0) & (distance < nearest)
        place = start[near] + distance[near, None] * along - a
        inside = np.ones(len(place), bool)
        for begin, end in ((a, b), (b, c), (c, a)):
            inside &= np.cross(end - begin, place - (begin - a)) @ normal >= 0
        rows = np.nonzero(near)[0][inside]
        nearest[rows], number[rows] = distance[rows], k
    return number, nearest
