"""Surfaces in contact: pairs of meshes that meet, cross, or come closer than a length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
import shapely
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Pairs of triangles at a time: some 50 MB.
_PAIRS = 1 << 14


def contacts(
    meshes: Sequence[Floats], rims: Sequence[Floats | None], within: float
) -> list[tuple[int, int]]:
    """Return pairs of meshes (t, 3, 3) that cross, or whose distance is at most ``within``.

    ``rims``: edges (m, 2, 3) of the rims of sheets, None for closed meshes. A sheet is in contact
    where something comes close to its rim, or passes through it: not where something stands on it.
    """
    boxes = np.array([[mesh.min(axis=(0, 1)), mesh.max(axis=(0, 1))] for mesh in meshes])
    # edges as triangles without area
    ends = [
        mesh if rim is None else rim[:, [0, 1, 1]] for mesh, rim in zip(meshes, rims, strict=True)
    ]
    pairs = []
    for one, other in np.column_stack(_overlapping(boxes, boxes, within)).tolist():
        if one < other and (
            _meet(ends[one], ends[other], within)
            or any(_cross(*some, within).any() for some in _near(meshes[one], meshes[other], 0.0))
        ):
            pairs.append((one, other))
    return pairs


def _overlapping(boxes: Floats, others: Floats, within: float) -> tuple[Indices, Indices]:
    """Numbers of boxes (n, 2, 3) and (m, 2, 3), lowest and highest corner, that are near."""
    low, high = boxes[:, 0] - within, boxes[:, 1] + within
    tree = shapely.STRtree(shapely.box(*others[:, 0, :2].T, *others[:, 1, :2].T))
    one, other = tree.query(shapely.box(*low[:, :2].T, *high[:, :2].T))
    near = (others[other, 0, 2] <= high[one, 2]) & (others[other, 1, 2] >= low[one, 2])
    return one[near], other[near]


def _meet(one: Floats, other: Floats, within: float) -> bool:
    """Whether two meshes cross or are within a distance of each other."""
    return any(_are_near(*some, within) for some in _near(one, other, within))


def _near(one: Floats, other: Floats, within: float) -> Iterator[tuple[Floats, Floats]]:
    """Triangles (n, 3, 3) of both meshes whose boxes are near, some at a time."""
    boxes = [np.stack([mesh.min(axis=1), mesh.max(axis=1)], axis=1) for mesh in (one, other)]
    rows = []
    for mine, theirs in (boxes, boxes[::-1]):
        if not len(theirs):
            return
        low, high = theirs[:, 0].min(axis=0) - within, theirs[:, 1].max(axis=0) + within
        rows.append(np.flatnonzero(((mine[:, 0] <= high) & (mine[:, 1] >= low)).all(axis=1)))
    first, second = _overlapping(boxes[0][rows[0]], boxes[1][rows[1]], within)
    for start in range(0, len(first), _PAIRS):
        some = slice(start, start + _PAIRS)
        yield one[rows[0][first[some]]], other[rows[1][second[some]]]


def _are_near(one: Floats, other: Floats, within: float) -> bool:
    """Whether any pair of triangles (n, 3, 3) crosses or is within a distance of each other."""
    for mine, theirs in ((one, other), (other, one)):
        if any((_from_face(mine[:, k], theirs) <= within).any() for k in range(3)):
            return True
    for k, j in product(range(3), repeat=2):
        ends = one[:, k], one[:, (k + 1) % 3], other[:, j], other[:, (j + 1) % 3]
        if (_between_segments(*ends) <= within).any():
            return True
    return bool(_cross(one, other, 0.0).any())


def _from_face(points: Floats, triangles: Floats) -> Floats:
    """Heights (n,) of points above triangles (n, 3, 3); infinite beside them."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    above = np.ones(len(points), bool)
    for k in range(3):
        side = triangles[:, (k + 1) % 3] - triangles[:, k]
        above &= _dot(points - triangles[:, k], np.cross(normal, side)) >= 0.0
    height = np.abs(_dot(points - triangles[:, 0], normal))
    size = np.linalg.norm(normal, axis=1)
    return np.where(above & (size > 0.0), height / np.maximum(size, 1e-300), np.inf)


def _between_segments(start: Floats, end: Floats, begin: Floats, stop: Floats) -> Floats:
    """Distances (n,) of pairs of segments (Ericson, Real-Time Collision Detection, 5.1.9)."""
    along, beside, apart = end - start, stop - begin, start - begin
    a, e, b = _dot(along, along), _dot(beside, beside), _dot(along, beside)
    c, f = _dot(along, apart), _dot(beside, apart)
    area = a * e - b * b
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(area > 1e-12 * a * e, np.clip((b * f - c * e) / area, 0.0, 1.0), 0.0)
        t = np.where(e > 0.0, np.clip((b * s + f) / e, 0.0, 1.0), 0.0)
        s = np.where(a > 0.0, np.clip((b * t - c) / a, 0.0, 1.0), 0.0)
    return np.linalg.norm(apart + s[:, None] * along - t[:, None] * beside, axis=1)


def _cross(one: Floats, other: Floats, depth: float) -> NDArray[np.bool_]:
    """Whether a side of one triangle (n, 3, 3) passes through the other, by more than a depth."""
    found = np.zeros(len(one), bool)
    for mine, theirs in ((one, other), (other, one)):
        a, b, c = np.moveaxis(theirs, 1, 0)
        normal = np.cross(b - a, c - a)
        height = np.stack([_dot(mine[:, k] - a, normal) for k in range(3)])
        far = np.abs(height) > depth * np.linalg.norm(normal, axis=1)
        for k in range(3):
            j = (k + 1) % 3
            p, along = mine[:, k], mine[:, j] - mine[:, k]
            sides = (a, b), (b, c), (c, a)
            turns = np.stack([_dot(np.cross(s - p, e - p), along) for s, e in sides])
            inside = (turns > 0.0).all(axis=0) | (turns < 0.0).all(axis=0)
            found |= inside & far[k] & far[j] & (height[k] * height[j] < 0.0)
    return found


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("nk,nk->n", a, b))
