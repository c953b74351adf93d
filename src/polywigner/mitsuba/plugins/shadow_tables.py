"""Tables of the nodes of a source and of the edges of its shadows, for kernels of renders.

Lengths are in wavelengths, in the source's frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry.silhouettes import Obstacles, Silhouette
from polywigner.propagation import shadows
from polywigner.propagation.shadows import NO_SURFACE
from polywigner.propagation.source_nodes import EDGE_AMPLITUDE, NEAR, SourceNodes

Floats = NDArray[np.float64]

# Phase in rad by which the wave of the source at an edge changes between two samples, and largest
# number of samples. The error of linear interpolation is below phase^2/24 for uniform sources.
_STEP, _MOST_SAMPLES = 0.25, 1024
_NO_PLANE = (0.0, 0.0, 0.0, 1.0)
# Detour that represents infinity.
_ALWAYS = 1e30


class NodeTables(NamedTuple):
    """Nodes of a source, and the points that radiate their waves."""

    nodes: Floats
    """Rows (k + 1, 4) of the nodes, then of the centre: x, y, first and end row of its points."""
    points: Floats
    """Rows (r, 8) of the radiating points: x, y, z, both weights (4 numbers), and 0."""


class EdgeTables(NamedTuple):
    """Edges of silhouettes in groups, with the surface that blocks the waves of each group."""

    groups: Floats
    """Rows (g, 13) of the groups: midpoint of its edges (3), plane of the face behind the edges
    (4), and first and end row of its edges, of its blocker's triangles and of its blocker's rim
    (6).
    """
    edges: Floats
    """Rows (m, 20) of the edges.

    The columns contain the ends of the edge seen from the centre (6), the plane of the face behind
    the edge (4), the range of the nodes whose waves it diffracts (2), the row in ``ends`` and the
    step between nodes (2), the row in ``samples`` and the number of intervals (2), the detour up to
    which the waves of the nodes at the point are used, and the detour from which the centre is the
    only node (2), the square of the amplitude of its wave over the largest free field, times the
    square root of the detour (1), and 0.
    """
    ends: Floats
    """Rows (e, 8) of edges seen from a node: both ends (6), and two zeros."""
    samples: Floats
    """Rows (s, 4) for each interval and each node or the centre.

    The columns contain the real and imaginary parts of the wave at both ends of the interval.
    """
    triangles: Floats
    """Rows (t, 10) of the triangles of blockers: normals of the planes through the group's midpoint
    and each side (9), and the triple product of the corners (1).
    """
    rims: Floats
    """Rows (m, 6) of the edges of the blockers' rims: both ends (6)."""


def node_tables(nodes: SourceNodes) -> NodeTables:
    """Return the nodes of a source, with the points that contribute to their waves."""
    points = np.array([[*point.row, 0.0] for point in nodes.points])
    owner, which = np.nonzero(nodes.fractions)
    rows = points[which]
    rows[:, 3:] *= nodes.fractions[owner, which][:, None]
    ends = np.cumsum(np.bincount(owner))
    table = np.column_stack([nodes.positions[:, :2], np.append(0, ends[:-1]), ends])
    return NodeTables(np.concatenate([table, [[*nodes.centre[:2], 0, 0]]]), rows)


def edge_tables(
    obstacles: Obstacles, nodes: SourceNodes, silhouettes: Sequence[Silhouette], margin: float
) -> EdgeTables:
    """Return the edges of silhouettes, as seen from nodes of the source, in groups by blocker.

    Parameters
    ----------
    obstacles : Obstacles
        Bodies in the source's frame, in wavelengths.
    nodes : SourceNodes
        Nodes of the source.
    silhouettes : sequence of Silhouette
        One for each node, or a single one for all nodes.
    margin : float
        Points behind a face by less than this fraction of its distance count as points on it.
    """
    blocked = shadows.blocked_edges(obstacles, silhouettes, nodes.centre)
    is_shared = len(silhouettes) < len(nodes.positions)
    # A part contains the ends of edges seen from its nodes and from the centre, in this order, the
    # planes of the faces, and the range of its nodes.
    parts: list[tuple[Floats, Floats, tuple[int, int]]] = []
    groups = []
    for k, (silhouette, group) in enumerate(zip(silhouettes, blocked.groups, strict=True)):
        rows = np.column_stack([silhouette.edges.reshape(-1, 6), silhouette.planes])
        span = (0, len(nodes.positions)) if is_shared else (k, k + 1)
        parts.append((rows[:, None, :6], rows[:, 6:], span))
        groups.append(np.maximum(group, NO_SURFACE))
        lines = rows[group == shadows.OWN_SURFACE]
        if len(lines):
            seen_from = [*nodes.positions, nodes.centre] if is_shared else [nodes.positions[k]]
            ends = np.stack([_shadow_lines(origin, lines) for origin in seen_from], axis=1)
            parts.append((ends, np.tile(_NO_PLANE, (len(lines), 1)), span))
            groups.append(np.full(len(lines), NO_SURFACE))
    ends, edges, samples = _edge_rows(nodes, parts)
    group = np.concatenate(groups)
    planes = edges[:, 6:10]
    planes[group == NO_SURFACE] = _NO_PLANE
    # Rounding to single precision moves points of a surface behind the surface; they count as in
    # front.
    planes[:, 3] += margin * np.linalg.norm(edges[:, 3:6], axis=1) * (group >= 0)
    order = np.argsort(group, kind="stable")
    edges, group = edges[order], group[order]
    spans, triangles, rims = [], [np.empty((0, 10))], [np.empty((0, 6))]
    sizes = [0, 0]
    for number, blocker in enumerate([None, *blocked.blockers], NO_SURFACE):
        first, end = np.searchsorted(group, [number, number + 1])
        plane = edges[first, 6:10] if first < end else _NO_PLANE
        before, origin = list(sizes), np.zeros(3)
        if blocker is not None:
            origin = blocker.origin
            triangles.append(_pyramids(blocker.triangles - origin))
            rims.append(blocker.rim.reshape(-1, 6))
            sizes = [sizes[0] + len(triangles[-1]), sizes[1] + len(rims[-1])]
        numbers = [first, end, before[0], sizes[0], before[1], sizes[1]]
        spans.append([*origin, *plane, *numbers])
    return EdgeTables(
        np.array(spans), edges, ends, samples, np.concatenate(triangles), np.concatenate(rims)
    )


def _shadow_lines(origin: Floats, rows: Floats) -> Floats:
    """Return the shadow lines (m, 6) of edges (m, 10) with planes, as a point sees them."""
    table = np.column_stack([np.tile([*origin, *np.zeros(4)], (len(rows), 1)), rows])
    return shadows.shadow_lines(table)[:, 7:13]


def _edge_rows(
    nodes: SourceNodes, parts: Sequence[tuple[Floats, Floats, tuple[int, int]]]
) -> tuple[Floats, Floats, Floats]:
    """Return the tables ``ends``, ``edges`` and ``samples`` of :class:`EdgeTables`."""
    reach = float(np.linalg.norm(np.ptp(nodes.origins, axis=0))) / 2
    places = [_places(nodes, reach, edge) for ends, *_ in parts for edge in ends[:, -1]]
    counts = np.array([len(some) for some in places])
    firsts = np.cumsum(counts) - counts
    waves, detours = nodes.waves_at(np.concatenate(places))
    loudest = np.maximum.reduceat(np.abs(waves[:, -1]), firsts) * EDGE_AMPLITUDE / nodes.peak
    limits = np.column_stack(
        [
            np.full(len(counts), NEAR if nodes.is_reduced else _ALWAYS),
            np.maximum.reduceat(detours, firsts),
            loudest**2,
            np.zeros(len(counts)),
        ]
    )
    width = waves.shape[1]
    pairs = np.stack([waves[:-1], waves[1:]], axis=2)
    # There is no interval between the last sample of an edge and the first sample of the next one.
    pairs = np.delete(pairs, firsts[1:] - 1, axis=0)
    samples = pairs.reshape(-1, 2).view(np.float64)
    intervals = counts - 1
    numbers = np.column_stack([width * (np.cumsum(intervals) - intervals), intervals])
    views = np.concatenate([np.full(len(ends), ends.shape[1]) for ends, *_ in parts])
    numbers = np.column_stack([np.cumsum(views) - views, views > 1, numbers])
    spans = np.concatenate([np.tile(span, (len(ends), 1)) for ends, _, span in parts])
    seen = np.concatenate([ends[:, -1] for ends, *_ in parts])
    planes = np.concatenate([planes for _, planes, _ in parts])
    edges = np.column_stack([seen, planes, spans, numbers, limits])
    rows = np.concatenate([ends.reshape(-1, 6) for ends, *_ in parts])
    return np.column_stack([rows, np.zeros((len(rows), 2))]), edges, samples


def _places(nodes: SourceNodes, reach: float, edge: Floats) -> Floats:
    """Return positions (n, 3) on an edge (6,), between which the wave of the source is linear.

    ``reach`` is half the size of the source.
    """
    start, end = edge[:3] - nodes.centre, edge[3:] - nodes.centre
    along = end - start
    foot = np.clip(-(start @ along) / (along @ along), 0.0, 1.0)
    nearest = float(np.linalg.norm(start + foot * along))
    phase = 2.0 * math.pi * reach * float(np.linalg.norm(along)) / nearest
    most = _MOST_SAMPLES if nodes.is_reduced else 2
    count = min(max(1, math.ceil(phase / _STEP)), most)
    return edge[:3] + np.linspace(0.0, 1.0, count + 1)[:, None] * along


def _pyramids(corners: Floats) -> Floats:
    """Return side normals and volumes (t, 10) of pyramids from the origin over triangles."""
    a, b, c = np.moveaxis(corners, 1, 0)
    sides = [np.cross(b, c), np.cross(c, a), np.cross(a, b)]
    return np.column_stack([*sides, np.einsum("tk,tk->t", a, sides[0])])
