"""The faces of a polyhedron as physics sees them: facets that join smoothly are one."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry import Polyhedron

__all__ = ["least_area"]

# Facets that meet at less than this are of one bent face, as in meshes of smooth bodies.
_SMOOTH = math.cos(math.radians(30))


def least_area(body: Polyhedron) -> float:
    """The area of the smallest face in m^2."""
    corners = body.vertices[body.triangles]
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(vectors, axis=1)
    normals = vectors / np.maximum(areas, np.finfo(float).tiny)[:, None]
    begin, end = body.triangles.ravel(), np.roll(body.triangles, -1, axis=1).ravel()
    count = len(body.vertices)
    keys = np.minimum(begin, end) * count + np.maximum(begin, end)
    order = np.argsort(keys, kind="stable")
    shared = keys[order][1:] == keys[order][:-1]
    one, other = order[:-1][shared] // 3, order[1:][shared] // 3
    smooth = (normals[one] * normals[other]).sum(axis=1) > _SMOOTH
    labels = _connected(len(areas), one[smooth], other[smooth])
    sums = np.bincount(labels, areas / 2)
    return float(sums[np.bincount(labels) > 0].min())


def _connected(count: int, one: NDArray[np.intp], other: NDArray[np.intp]) -> NDArray[np.intp]:
    """Numbers (count,) that those have in common who are joined, directly or by others."""
    labels = np.arange(count)
    while True:
        least = np.minimum(labels[one], labels[other])
        before = labels.copy()
        for side in (one, other):
            np.minimum.at(labels, labels[side], least)
        labels = labels[labels]
        if (labels == before).all():
            return labels
