"""Tables of the edges whose waves scenes with diffraction add up, for loops on Dr.Jit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry.silhouettes import Obstacles, Silhouette
from polywigner.propagation.blockers import (
    NO_SURFACE,
    OWN_SURFACE,
    Blocker,
    blocked_edges,
    shadow_lines,
)
from polywigner.propagation.equivalent_points import RadiatingPoint

Floats = NDArray[np.float64]


class EdgeTables(NamedTuple):
    """Edges of silhouettes in groups, with the surface that blocks the waves of each group."""

    groups: Floats
    """(g, 13) midpoint of the edges; plane of the face behind; first and end of their edges, of
    the triangles of the surface, and of the edges of its rim."""
    edges: Floats
    """(k, 12) ends, plane of the face behind, first and end of the points of the source."""
    triangles: Floats
    """(t, 10) normals of the planes through the midpoint and each side, and their triple
    product."""
    rims: Floats
    """(m, 6)."""


def edge_tables(
    obstacles: Obstacles,
    points: Sequence[RadiatingPoint],
    seen: Sequence[Silhouette],
    margin: float,
) -> tuple[EdgeTables, list[Blocker | None]]:
    """Return the edges that points of a source see, and the blocker of each group.

    Parameters
    ----------
    obstacles : bodies, in wavelengths.
    points : points of the source.
    seen : a silhouette for each point, or one for all.
    margin : depth behind a face, as a fraction of its distance, up to which points lie on it.
    """
    shared = len(seen) < len(points)
    found = blocked_edges(obstacles, seen, np.mean([point.place for point in points], axis=0))
    parts, groups = [], []
    for k, (silhouette, group) in enumerate(zip(seen, found.groups, strict=True)):
        count, span = len(group), (0, len(points)) if shared else (k, k + 1)
        rows = np.column_stack([silhouette.edges.reshape(-1, 6), silhouette.planes])
        parts.append(np.column_stack([rows, np.tile(span, (count, 1))]))
        groups.append(np.maximum(group, NO_SURFACE))
        own = rows[group == OWN_SURFACE]
        for number in range(*span) if len(own) else ():
            table = np.column_stack([np.tile(points[number].row, (len(own), 1)), own])
            lines = shadow_lines(table)[:, 7:]
            parts.append(np.column_stack([lines, np.tile((number, number + 1), (len(own), 1))]))
            groups.append(np.full(len(own), NO_SURFACE))
    edges, group = np.concatenate(parts), np.concatenate(groups)
    planes = edges[:, 6:10]
    planes[group == NO_SURFACE] = 0.0, 0.0, 0.0, 1.0
    # places on the surface count as before it, which single precision rounds
    planes[:, 3] += margin * np.linalg.norm(edges[:, 3:6], axis=1) * (group >= 0)
    order = np.argsort(group, kind="stable")
    edges, group = edges[order], group[order]
    blockers: list[Blocker | None] = [None, *found.blockers]
    spans, triangles, rims = [], [np.empty((0, 10))], [np.empty((0, 6))]
    for number, blocker in enumerate(blockers, NO_SURFACE):
        first, end = np.searchsorted(group, [number, number + 1])
        plane = edges[first, 6:10] if first < end else np.array([0.0, 0.0, 0.0, 1.0])
        before = sum(map(len, triangles)), sum(map(len, rims))
        if blocker is not None:
            triangles.append(_pyramids(blocker.triangles - blocker.origin))
            rims.append(blocker.rim.reshape(-1, 6))
        after = sum(map(len, triangles)), sum(map(len, rims))
        origin = np.zeros(3) if blocker is None else blocker.origin
        spans.append([*origin, *plane, first, end, before[0], after[0], before[1], after[1]])
    tables = EdgeTables(np.array(spans), edges, np.concatenate(triangles), np.concatenate(rims))
    return tables, blockers


def _pyramids(corners: Floats) -> Floats:
    """(t, 10) normals of the sides of pyramids from the origin over triangles, and volumes."""
    a, b, c = np.moveaxis(corners, 1, 0)
    sides = [np.cross(b, c), np.cross(c, a), np.cross(a, b)]
    return np.column_stack([*sides, np.einsum("tk,tk->t", a, sides[0])])
