"""Tables of source nodes and shadow edges for compiled kernels.

Lengths are in wavelengths, in the source's frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polywigner.geometry.silhouettes import Obstacles, Silhouette, pyramids
from polywigner.propagation import shadows
from polywigner.propagation.shadows import NO_SURFACE
from polywigner.propagation.source_nodes import EDGE_AMPLITUDE, NEAR, SourceNodes

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# Largest phase step between samples along an edge [rad], and largest number of samples per edge.
# The error of linear interpolation is step^2/24. The phase is calculated for a half size of the
# source of at least _SLANT wavelengths.
_STEP, _MOST_SAMPLES, _SLANT = 0.25, 1024, 1.0
_NO_PLANE, _ALL_BEHIND = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, -1.0)
# Largest gap between edges that count as adjacent, as a fraction of the largest coordinate.
_GAP = 1e-6
# Reference direction, chosen so that edges are unlikely to be perpendicular to it.
_AXIS = np.array([0.57, 0.31, 0.76])
# Finite stand-in for an infinite detour [wavelengths].
_ALWAYS = 1e30


class NodeTables(NamedTuple):
    """Nodes of a source and their radiating points."""

    nodes: Floats
    """Rows (k + 1, 4) of the nodes, then of the centre: x, y, and two zeros."""
    points: Floats
    """Rows (n, 8) of the radiating points: x, y, z, both weights (4 numbers), and 0.

    If there are fewer nodes than points, further columns contain the fraction of the point that
    each node represents, padded with zeros to a multiple of four columns.
    """


class EdgeTables(NamedTuple):
    """Edges of silhouettes, grouped by the surface that blocks their waves."""

    groups: Floats
    """Rows (g, 13) of the groups.

    Columns 0-2: midpoint of the edges; 3-6: plane in front of all hidden points; 7-8, 9-10 and
    11-12: first and end row in ``edges``, ``triangles`` and ``rims``.
    """
    edges: Floats
    """Rows (m, 20) of the edges.

    Columns 0-5: ends of the edge seen from the centre; 6-9: plane of the face behind the edge;
    10-11: first and end node; 12-13: first row in ``ends`` and row step between nodes; 14-15: first
    row in ``samples`` and number of intervals; 16: detour below which weights are waves at the
    point; 17: detour above which the centre replaces the nodes; 18: squared relative amplitude of
    the edge wave times the detour; 19: zero.
    """
    ends: Floats
    """Rows (e, 8) of edges seen from a node: both ends (6) and two zeros."""
    samples: Floats
    """Rows (s, 6), one per interval of an edge and per node or centre.

    Columns 0-3: wave at both ends of the interval (real, imaginary); 4-5: dipole contribution
    without obliquity at the midpoint.
    """
    triangles: Floats
    """Rows (t, 10) of the triangles of blocking surfaces.

    Columns 0-8: normals of the planes through the group's midpoint and each side; 9: distance of
    the triangle's plane from the midpoint along its normal.
    """
    rims: Floats
    """Ends (m, 6) of the boundary edges of blocking surfaces."""


def node_tables(nodes: SourceNodes) -> NodeTables:
    """Return the nodes of a source, with the points that contribute to their waves."""
    positions = np.concatenate([nodes.positions, nodes.centre[None]])
    points = np.array([[*point.row, 0.0] for point in nodes.points])
    if nodes.is_reduced:
        points = np.column_stack([points, nodes.fractions.T])
        points = np.pad(points, ((0, 0), (0, -points.shape[1] % 4)))
    return NodeTables(np.pad(positions[:, :2], ((0, 0), (0, 2))), points)


def edge_tables(
    obstacles: Obstacles, nodes: SourceNodes, silhouettes: Sequence[Silhouette], margin: float
) -> EdgeTables:
    """Return the tables of the edges of silhouettes, seen from the nodes of a source.

    Parameters
    ----------
    obstacles : Obstacles
        Bodies in the source's frame, in wavelengths.
    nodes : SourceNodes
        Nodes of the source.
    silhouettes : sequence of Silhouette
        One silhouette for each node, or a single silhouette for all nodes.
    margin : float
        Tolerance for positions on a face, as a fraction of the distance from the source's centre to
        the edge in front of the face.
    """
    blocked = shadows.blocked_edges(obstacles, silhouettes, nodes.centre)
    parts: list[_Edges] = []
    groups = []
    origins = np.concatenate([nodes.positions, nodes.centre[None]])
    for part, numbers in _edges_by_nodes(nodes, silhouettes, blocked.groups):
        parts.append(part)
        groups.append(np.maximum(numbers, NO_SURFACE))
        if (numbers == shadows.OWN_SURFACE).any():
            parts.append(part.rows(numbers == shadows.OWN_SURFACE).shadow_lines(origins))
            groups.append(np.full(len(parts[-1].planes), NO_SURFACE))
    ends, edges, samples = _edge_rows(nodes, parts)
    group = np.concatenate(groups)
    planes = edges[:, 6:10]
    planes[group == NO_SURFACE] = _NO_PLANE
    # Rounding to single precision can move points of a surface behind the surface.
    planes[:, 3] += margin * np.linalg.norm(edges[:, 3:6], axis=1) * (group >= 0)
    order = np.argsort(group, kind="stable")
    edges, group = edges[order], group[order]
    spans, triangles, rims = [], [np.empty((0, 10))], [np.empty((0, 6))]
    sizes = [0, 0]
    for number, blocker in enumerate([None, *blocked.blockers], NO_SURFACE):
        first, end = np.searchsorted(group, [number, number + 1])
        plane = edges[first, 6:10] if first < end else _NO_PLANE
        if (edges[first:end, 6:9] != plane[:3]).any():
            plane = _ALL_BEHIND  # A convex body can hide points in front of one of its faces.
        before, origin = list(sizes), np.zeros(3)
        if blocker is not None:
            origin = blocker.origin
            triangles.append(pyramids(blocker.triangles - origin))
            rims.append(blocker.rim.reshape(-1, 6))
            sizes = [sizes[0] + len(triangles[-1]), sizes[1] + len(rims[-1])]
        rows = [first, end, before[0], sizes[0], before[1], sizes[1]]
        spans.append([*origin, *plane, *rows])
    return EdgeTables(
        np.array(spans), edges, ends, samples, np.concatenate(triangles), np.concatenate(rims)
    )


class _Edges(NamedTuple):
    """Edges of silhouettes, as seen from one range of nodes."""

    ends: Floats
    """Ends (m, v, 6) seen from v nodes."""
    lines: Floats
    """Ends (m, 6) of the union of all pieces of an edge."""
    pieces: Floats
    """Ends (m, 6) of the union of the pieces in front of the same face."""
    planes: Floats
    """Planes (m, 4) of the faces behind the edges."""
    span: tuple[int, int]
    """First and end node."""

    def are_fixed(self) -> NDArray[np.bool_]:
        """Return whether each edge (m,) lies on one line for all nodes.

        The shadow line of an edge on another surface moves with the node.
        """
        start, end = self.lines[:, None, None, :3], self.lines[:, None, None, 3:]
        ends = self.ends.reshape(*self.ends.shape[:2], 2, 3)
        across = np.linalg.norm(np.cross(ends - start, end - start), axis=-1).max(axis=(1, 2))
        length = np.linalg.norm(end - start, axis=-1)[:, 0, 0]
        return np.asarray(across <= _GAP * np.abs(self.lines).max(axis=1) * length)

    def rows(self, some: NDArray[np.bool_]) -> _Edges:
        """Return the edges for which a mask (m,) is true."""
        return _Edges(
            self.ends[some], self.lines[some], self.pieces[some], self.planes[some], self.span
        )

    def shadow_lines(self, origins: Floats) -> _Edges:
        """Return the shadow lines on the faces behind the edges.

        ``origins`` (k + 1, 3) contains the nodes and the centre.
        """
        is_shared = self.ends.shape[1] == len(origins)
        seen_from = origins if is_shared else origins[slice(*self.span)]
        ends = [
            _shadow_lines(origin, some, self.planes)
            for origin, some in zip(seen_from, np.moveaxis(self.ends, 1, 0), strict=True)
        ]
        line = _shadow_lines(seen_from[-1], self.pieces, self.planes)
        free = np.tile(_NO_PLANE, (len(self.planes), 1))
        return _Edges(np.stack(ends, axis=1), line, line, free, self.span)


def _shadow_lines(origin: Floats, ends: Floats, planes: Floats) -> Floats:
    """Return the shadow lines (m, 6) of edges (m, 6) on planes (m, 4) for a point source."""
    start = np.tile([*origin, *np.zeros(4)], (len(ends), 1))
    return shadows.shadow_lines(np.column_stack([start, ends, planes]))[:, 7:13]


def _edges_by_nodes(
    nodes: SourceNodes, silhouettes: Sequence[Silhouette], groups: Sequence[Indices]
) -> Iterator[tuple[_Edges, Indices]]:
    """Yield the edges common to all silhouettes, then the remaining edges of each silhouette.

    The second item of each pair contains the groups of the edges. A mesh edge is common if all
    silhouettes contain the same number of its pieces per face.
    """
    count = len(silhouettes)
    view, ends, planes, labels = _joined(silhouettes, groups)
    group = labels[:, -1]
    _, key = np.unique(labels, axis=0, return_inverse=True)
    key = key.ravel()
    order = np.lexsort([_positions_along(ends, 0), view, key])
    pieces = np.bincount(key * count + view, minlength=count * (key.max(initial=-1) + 1))
    pieces = pieces.reshape(-1, count)
    is_common = (pieces == pieces[:, :1]).all(axis=1)
    first = np.cumsum(pieces.ravel()) - pieces.ravel()
    piece = np.empty(len(key), np.intp)
    piece[order] = np.arange(len(key)) - first[(key * count + view)[order]]
    rows = np.lexsort([view, piece, key])
    rows = rows[is_common[key[rows]]].reshape(-1, count)
    central = np.linalg.norm(nodes.positions - nodes.centre, axis=1).argmin()
    seen_by = [*range(count), central] if count > 1 else [0] * (len(nodes.positions) + 1)
    # Segments that belong to no mesh edge are never joined.
    single = np.where(labels[:, 0] < 0, np.arange(len(key)), -1)
    lines = _hulls(ends, np.column_stack([labels[:, :3], single]))
    pieces_behind = _hulls(ends, np.column_stack([labels[:, :4], single]))
    ends = ends.reshape(-1, 6)

    def edges(rows: Indices, seen: Floats, span: tuple[int, int]) -> tuple[_Edges, Indices]:
        """Return the edges with indices ``rows`` for a span of nodes, and the edges' groups."""
        return _Edges(seen, lines[rows], pieces_behind[rows], planes[rows], span), group[rows]

    yield edges(rows[:, 0], ends[rows][:, seen_by], (0, len(nodes.positions)))
    for k in range(count):
        (own,) = np.nonzero(~is_common[key] & (view == k))
        yield edges(own, ends[own][:, None], (k, k + 1))


def _joined(
    silhouettes: Sequence[Silhouette], groups: Sequence[Indices]
) -> tuple[Indices, Floats, Floats, Indices]:
    """Join adjacent pieces of mesh edges in front of the same face, and drop edges of zero length.

    Returns indices of silhouettes (m,), ends (m, 2, 3), planes (m, 4), and labels (m, 5): mesh
    edge, body, direction along _AXIS, face behind the edge, and group.
    """
    view = np.repeat(np.arange(len(silhouettes)), [len(s.edges) for s in silhouettes])
    names = ("edges", "planes", "numbers", "bodies", "behind")
    ends, planes, number, body, behind = (
        np.concatenate([getattr(s, name) for s in silhouettes]) for name in names
    )
    direction = (ends[:, 1] - ends[:, 0]) @ _AXIS > 0.0
    labels = np.column_stack([number, body, direction, behind, np.concatenate(groups)])
    order = np.lexsort([_positions_along(ends, 0), *labels.T, view])
    view, ends, planes, labels = (part[order] for part in (view, ends, planes, labels))
    gap = np.abs(ends[1:, 0] - ends[:-1, 1]).max(axis=1)
    adjoins = (gap <= _GAP * np.abs(ends).max(initial=0.0)) & (labels[1:, 0] >= 0)
    adjoins &= (view[1:] == view[:-1]) & (labels[1:] == labels[:-1]).all(axis=1)
    first, last = np.append(True, ~adjoins)[: len(ends)], np.append(~adjoins, True)[: len(ends)]
    ends = np.stack([ends[first, 0], ends[last, 1]], axis=1)
    view, planes, labels = view[first], planes[first], labels[first]
    # Kernels compute in single precision, in which an edge without length has no direction.
    has_length = (np.diff(ends.astype(np.float32), axis=1) != 0.0).any(axis=(1, 2))
    return view[has_length], ends[has_length], planes[has_length], labels[has_length]


def _positions_along(ends: Floats, side: int) -> Floats:
    """Return the projections (m,) of one end (0 or 1) of edges (m, 2, 3) on their directions."""
    along = ends[:, 1] - ends[:, 0]
    return np.asarray((ends[:, side] * along).sum(axis=1) / np.linalg.norm(along, axis=1))


def _hulls(ends: Floats, labels: Indices) -> Floats:
    """Return, for each edge (m, 2, 3), the ends (m, 6) of the union of all edges with its label."""
    _, label = np.unique(labels, axis=0, return_inverse=True)
    label = label.ravel()
    corners = []
    for side, sign in ((0, 1.0), (1, -1.0)):
        order = np.lexsort([sign * _positions_along(ends, side), label])
        _, first = np.unique(label[order], return_index=True)
        corners.append(ends[order[first], side][label])
    return np.column_stack(corners)


def _edge_rows(nodes: SourceNodes, parts: Sequence[_Edges]) -> tuple[Floats, Floats, Floats]:
    """Return the tables ``ends``, ``edges`` and ``samples`` of `EdgeTables` for all parts."""
    reach = float(np.linalg.norm(np.ptp(nodes.origins, axis=0))) / 2
    places = [_places(nodes, reach, edge) for part in parts for edge in part.lines]
    counts = np.array([len(some) for some in places])
    firsts = np.cumsum(counts) - counts
    at = np.concatenate(places)
    (waves, detours), dipoles = nodes.waves_at(at), nodes.dipoles_at(at)
    loudest = np.maximum.reduceat(np.abs(waves[:, -1]), firsts) * EDGE_AMPLITUDE / nodes.peak
    views = np.concatenate([np.full(len(part.ends), part.ends.shape[1]) for part in parts])
    is_fixed = (views > 1) & np.concatenate([part.are_fixed() for part in parts])
    limits = np.column_stack(
        [
            np.full(len(counts), NEAR if nodes.is_reduced else _ALWAYS),
            np.where(is_fixed, np.maximum.reduceat(detours, firsts), _ALWAYS),
            loudest**2,
            np.zeros(len(counts)),
        ]
    )
    width = waves.shape[1]
    rows = np.stack([waves[:-1], waves[1:], 0.5 * (dipoles[:-1] + dipoles[1:])], axis=2)
    # No interval connects the last sample of an edge to the first sample of the next edge.
    rows = np.delete(rows, firsts[1:] - 1, axis=0)
    samples = rows.reshape(-1, 3).view(np.float64)
    intervals = counts - 1
    numbers = np.column_stack([width * (np.cumsum(intervals) - intervals), intervals])
    numbers = np.column_stack([np.cumsum(views) - views, views > 1, numbers])
    spans = np.concatenate([np.tile(part.span, (len(part.ends), 1)) for part in parts])
    seen = np.concatenate([part.lines for part in parts])
    planes = np.concatenate([part.planes for part in parts])
    edges = np.column_stack([seen, planes, spans, numbers, limits])
    rows = np.concatenate([part.ends.reshape(-1, 6) for part in parts])
    return np.column_stack([rows, np.zeros((len(rows), 2))]), edges, samples


def _places(nodes: SourceNodes, reach: float, edge: Floats) -> Floats:
    """Return sample positions (n, 3) on an edge (6,) for linear interpolation of the wave.

    ``reach`` is half the size of the source.
    """
    start, end = edge[:3] - nodes.centre, edge[3:] - nodes.centre
    along = end - start
    foot = np.clip(-(start @ along) / (along @ along), 0.0, 1.0)
    nearest = float(np.linalg.norm(start + foot * along))
    phase = 2.0 * math.pi * max(reach, _SLANT) * float(np.linalg.norm(along)) / nearest
    most = _MOST_SAMPLES if nodes.is_reduced else 2
    count = min(max(1, math.ceil(phase / _STEP)), most)
    return edge[:3] + np.linspace(0.0, 1.0, count + 1)[:, None] * along
