"""Physical optics by ray tracing from a raster."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import polywigner as pw
from polywigner.geometry import triangulate


def scattered_field(
    corners: np.ndarray,
    s: Any,
    t: Any,
    p: Any,
    wavelength: float,
    bounces: int,
    across: int,
    meet: Callable[..., Any] | None = None,
) -> tuple[np.ndarray, float]:
    """Return the scattered far field (3,), and the area that rays hit.

    The field is the sum of n x (k x E) exp(-2 pi i s.x/wavelength) dA over all hits that the
    receiver in the direction s sees. Rays start in a raster across the direction t to the
    transmitter, with the field p. ``corners`` (n, 3, 3) are triangles, and ``meet`` is a function
    like :func:`first_met`.
    """
    meet = meet or partial(first_met, corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    start, cell = _raster(corners.reshape(-1, 3), t, across)
    k, field = np.tile(-t, (len(start), 1)), np.tile(np.asarray(p, complex), (len(start), 1))
    path, last = np.full(len(start), -100.0), np.full(len(start), -1)
    total, area = np.zeros(3, complex), 0.0
    for number in range(1, bounces + 1):
        met, distance = meet(start, k, last)
        hit = met >= 0
        k, field, path, last = k[hit], field[hit], path[hit] + distance[hit], met[hit]
        start = start[hit] + distance[hit, None] * k
        n = -np.sign((normals[last] * k).sum(axis=1))[:, None] * normals[last]
        slope = (n * k).sum(axis=1)
        towards, hidden = n @ s > 0, np.zeros(len(n), bool)
        ways = np.broadcast_to(s, start.shape)[towards]
        hidden[towards] = meet(start[towards], ways, last[towards])[0] >= 0
        counts = ~hidden if number == 1 else towards & ~hidden
        wave = np.exp(2j * np.pi * (path - start @ s) / wavelength) * cell / -slope * counts
        total += (np.cross(n, np.cross(k, field)) * wave[:, None]).sum(axis=0)
        area = max(area, cell * len(start))
        field = 2 * n * (n * field).sum(axis=1, keepdims=True) - field
        k = k - 2 * slope[:, None] * n
    return total, area


def _raster(points: np.ndarray, t: Any, across: int) -> tuple[np.ndarray, float]:
    """Return starts (n, 3) of rays across the direction t around points, and the area per ray."""
    # The raster is not parallel to edges, because all rays would miss a parallel edge by the same
    # distance.
    turn = np.array([[0.8, 0.6], [-0.6, 0.8]])
    axes = turn @ np.linalg.svd(np.asarray(t)[None])[2][1:]
    flat = points @ axes.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    u, v = (low[k] + (np.arange(across) + 0.5) / across * (high - low)[k] for k in (0, 1))
    places = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2) @ axes
    return places + 100 * t, float(np.prod(high - low)) / across**2


def first_met(corners: np.ndarray, start: np.ndarray, along: np.ndarray, last: Any) -> Any:
    """Return the first triangles that rays (n, 3) hit, or -1, and the distances of the hits.

    Rays do not hit the planes of the triangles ``last`` from which they start.
    """
    nearest, number = np.full(len(start), np.inf), np.full(len(start), -1)
    for j, (a, b, c) in enumerate(corners):
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        slope = along @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (a - start) @ normal / slope
        near = (np.abs(slope) > 1e-12) & (distance > 1e-9) & (distance < nearest) & (last != j)
        place = start[near] + distance[near, None] * along[near] - a
        inside = np.ones(len(place), bool)
        for begin, end in ((a, b), (b, c), (c, a)):
            inside &= np.cross(end - begin, place - (begin - a)) @ normal >= 0
        rows = np.nonzero(near)[0][inside]
        nearest[rows], number[rows] = distance[rows], j
    return number, np.where(number >= 0, nearest, 0.0)


def triangles_of(body: list[Any]) -> np.ndarray:
    """Return triangles (n, 3, 3) of plates, and of polyhedra with star-shaped faces."""
    return np.concatenate([_triangles(part) for part in body])


def _triangles(part: Any) -> np.ndarray:
    if isinstance(part, pw.Polyhedron):
        return part.vertices[part.triangles]
    pose = getattr(part, "pose", np.eye(4))
    points, triangles = triangulate(getattr(part, "aperture", part))
    placed: np.ndarray = points @ pose[:3, :2].T + pose[:3, 3]
    return placed[triangles]
