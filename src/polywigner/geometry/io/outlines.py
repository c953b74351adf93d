"""Outlines of a drawing: polygons with holes by a fill rule or by nesting, within limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.exact import Ring, estimated_area
from polywigner.geometry.io.limits import check_most, check_rings, check_vertices
from polywigner.geometry.parts import enclosed, part_of_ring, polygons_in, union_on_grid
from polywigner.geometry.rings import (
    clean_ring,
    different_vertices,
    hull_spans_area,
    rings_of_polygon,
    rounding_tolerance,
    spans_area,
)

# Places where outlines cross (twice as many faces, some 0.1 ms each), pairs of edges whose bounding
# boxes meet (0.3 us each to count, and for GEOS to compare them), pairs of outlines whose bounds
# overlap (3 us each), and vertices of these, which GEOS intersects where they touch (20 ns each).
_MOST_CROSSINGS = 20_000
_MOST_NEAR_EDGES = 10_000_000
_MOST_NEAR_RINGS = 2_000_000
_MOST_NEAR_VERTICES = 200_000_000

# Bounds the memory of one step.
_PAIRS_AT_ONCE = 4_000_000

Points = NDArray[np.float64]


class Work:
    """Budget of pairs that the shapes of one file may compare."""

    def __init__(self) -> None:
        self._edges = self._crossings = self._rings = self._vertices = 0

    def check_outlines(self, rings: Sequence[Ring]) -> None:
        """Raise for very many outlines upon or inside each other, which are compared in pairs."""
        if len(rings) < 2:
            return
        low = np.array([ring.min(axis=0) for ring in rings])
        high = np.array([ring.max(axis=0) for ring in rings])
        sizes = np.array([len(ring) for ring in rings])
        for one, other in _near(low, high):
            self._rings += len(one)
            self._vertices += int(sizes[one].sum() + sizes[other].sum())
            check_most(self._rings, _MOST_NEAR_RINGS, "pairs of near outlines", "use fewer")
            check_most(self._vertices, _MOST_NEAR_VERTICES, "vertices of such pairs", "use fewer")

    def check_edges(self, rings: Sequence[Ring]) -> None:
        """Raise for outlines that cross themselves or each other in very many places, or nearly.

        Quick also where they do, while GEOS needs minutes to tell where 100 000 edges cross. What
        GEOS does grows with the pairs of edges whose bounding boxes meet, so these are counted.
        """
        start = np.concatenate(rings)
        end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
        for one, other in _near(np.minimum(start, end), np.maximum(start, end)):
            self._edges += len(one)
            check_most(self._edges, _MOST_NEAR_EDGES, "pairs of edges near each other")
            apart = (start[other] != end[one]).any(axis=1) & (start[one] != end[other]).any(axis=1)
            one, other = one[apart], other[apart]
            self._crossings += _crossings(start[one], end[one], start[other], end[other])
            check_most(self._crossings, _MOST_CROSSINGS, "places where outlines cross")


def check_polygons(polygons: Sequence[Sequence[Any]]) -> int:
    """The number of vertices of polygons, each a list of rings; raises for more work than is done.

    What is no ring is refused by those who make parts of them.
    """
    check_rings(sum(map(len, polygons)))
    vertices = sum(len(ring) for rings in polygons for ring in rings)
    check_vertices(vertices)
    try:
        arrays = [[np.asarray(ring, dtype=np.float64) for ring in rings] for rings in polygons]
    except (TypeError, ValueError):
        return vertices
    rings = [ring for part in arrays for ring in part]
    pairs = all(ring.ndim == 2 and ring.shape[1] == 2 and len(ring) for ring in rings)
    if pairs and np.isfinite(np.concatenate(rings)).all():
        work = Work()
        work.check_outlines([part[0] for part in arrays])
        work.check_edges(rings)
    return vertices


def _near(low: Points, high: Points) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Pairs of boxes (low and high corners (n, 2)) that meet, some of them at a time."""
    tree = shapely.STRtree(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
    most = np.full(len(low), len(low))
    for k in range(2):  # those that meet along one axis are more than those that meet
        begun = np.searchsorted(np.sort(low[:, k]), high[:, k], side="right")
        ended = np.searchsorted(np.sort(high[:, k]), low[:, k], side="left")
        most = np.minimum(most, begun - ended)
    total = np.concatenate([[0], np.cumsum(most)])
    first = 0
    while first < len(low):
        last = int(np.searchsorted(total, total[first] + _PAIRS_AT_ONCE, side="right")) - 1
        last = min(max(last, first + 1), len(low))
        one, other = tree.query(tree.geometries[first:last])
        later = one + first < other
        yield one[later] + first, other[later]
        first = last


def _crossings(a: Points, b: Points, c: Points, d: Points) -> int:
    """Number of segments a-b that cross c-d, up to rounding."""
    apart = _side(a, b, c) * _side(a, b, d) < 0
    a, b, c, d = a[apart], b[apart], c[apart], d[apart]
    return int((_side(c, d, a) * _side(c, d, b) < 0).sum())


def _side(a: Points, b: Points, c: Points) -> Points:
    along, across = (b - a).T, (c - a).T
    return np.sign(along[0] * across[1] - along[1] * across[0])


Polygon = list[Ring]
"""Rings with the exterior first."""


def filled(rings: Sequence[Ring], rule: str, work: Work) -> list[Polygon]:
    """The region that a path of several rings fills by the rule "nonzero" or "evenodd".

    Rings that enclose no area are passed over; where none crosses or touches another, those that
    bound the region are returned as they are. `work` is that of the file.
    """
    kept = [ring for ring in rings if _encloses(ring)]
    if not kept:
        return []
    check_rings(len(kept))
    clean = [clean_ring(ring, "a ring") for ring in kept]
    if len(clean) == 1 and _is_plain(clean[0]):
        return [clean]
    work.check_outlines(clean)
    work.check_edges(clean)
    if shapely.is_simple(_lines(clean)):
        return _by_nesting(clean, rule)
    return [rings_of_polygon(polygon) for polygon in enclosed(clean, rule)]


def nested(
    rings: Sequence[Ring], union: bool = False, remedy: str = "join them in the drawing"
) -> list[Polygon]:
    """Polygons whose holes are the rings inside them, islands in holes and so on.

    `union` joins rings that overlap or touch first. Raises GeometryError, which ends with
    `remedy`, for rings that overlap otherwise; they may touch. A ring that crosses itself raises.
    """
    check_rings(len(rings))
    work = Work()
    work.check_outlines(rings)
    work.check_edges(rings)
    clean = [part_of_ring(ring, f"outline {k}")[0] for k, ring in enumerate(rings)]
    if not shapely.is_simple(_lines(clean)):
        if union:
            clean = _joined(clean)
        else:
            _check_overlaps(clean, remedy)
    return _by_nesting(clean, "evenodd")


def _joined(rings: Sequence[Ring]) -> list[Ring]:
    """The outlines of groups of rings that overlap or touch; those inside others stay."""
    polygons = np.array([shapely.Polygon(ring) for ring in rings], dtype=object)
    tree = shapely.STRtree(polygons)
    pairs = [tree.query(polygons, predicate=relation) for relation in ("overlaps", "touches")]
    first, second = np.concatenate(pairs, axis=1)
    group = np.arange(len(rings))
    while (group[first] != group[second]).any():
        np.minimum.at(group, first, group[second])
    joined: list[Ring] = []
    for number in np.unique(group):
        members = polygons[group == number]
        region = members[0] if len(members) == 1 else union_on_grid(list(members))
        joined += [ring for polygon in polygons_in(region) for ring in rings_of_polygon(polygon)]
    return joined


def without_duplicates(rings: Sequence[Ring], gap: float) -> list[Ring]:
    """Rings without repetitions of an earlier one up to `gap`, wherever they start."""
    check_rings(len(rings))
    boxes = np.array([[*ring.min(axis=0), *ring.max(axis=0)] for ring in rings])
    corners = shapely.points(boxes[:, :2])
    tree = shapely.STRtree(corners)
    sizes = np.array([len(ring) for ring in rings])
    repeats = np.zeros(len(rings), dtype=bool)
    compared = 0
    for i, ring in enumerate(rings):
        if repeats[i]:
            continue
        near = tree.query(corners[i], predicate="dwithin", distance=gap)
        near = near[(near > i) & (sizes[near] == sizes[i]) & ~repeats[near]]
        near = near[(np.abs(boxes[near] - boxes[i]) <= gap).all(axis=1)]
        compared += len(near) * len(ring)
        check_vertices(compared)
        for j in near.tolist():
            distance = shapely.hausdorff_distance(*map(shapely.LinearRing, (ring, rings[j])))
            repeats[j] = distance <= gap
    return [ring for ring, again in zip(rings, repeats.tolist(), strict=True) if not again]


def _encloses(ring: Ring) -> bool:
    return different_vertices(ring) == 3 and (spans_area(ring) or hull_spans_area(ring))


def _is_plain(ring: Ring) -> bool:
    """Whether a ring is simple, and so short that nothing needs to be counted to find out."""
    return len(ring) ** 2 <= _MOST_CROSSINGS and bool(shapely.is_valid(shapely.Polygon(ring)))


def _lines(rings: Sequence[Ring]) -> shapely.MultiLineString:
    return shapely.MultiLineString([np.concatenate([ring, ring[:1]]) for ring in rings])


def _check_overlaps(rings: Sequence[Ring], remedy: str) -> None:
    """Raise where the insides of two rings meet, and neither lies in the other."""
    polygons = np.array([shapely.Polygon(ring) for ring in rings], dtype=object)
    tree = shapely.STRtree(polygons)
    shift = max(rounding_tolerance(ring) for ring in rings)
    for i, polygon in enumerate(polygons):
        near = tree.query(polygon, predicate="overlaps")
        common = shapely.intersection(polygon, polygons[near])
        # An edge displaced by rounding sweeps the shift times its length; as for parts.
        deep = shapely.area(common) > shift * np.minimum(polygon.length, shapely.length(common))
        if deep.any():
            j, spot = near[deep][0], shapely.point_on_surface(common[deep][0])
            raise GeometryError(
                f"expected outlines that do not overlap, got outlines {i} and {j} that cross "
                f"around ({spot.x:.6g}, {spot.y:.6g}); {remedy}"
            )


def _by_nesting(rings: Sequence[Ring], rule: str) -> list[Polygon]:
    """Polygons of rings that do not cross, by the number of rings around each."""
    areas = np.array([estimated_area(ring) for ring in rings])
    pairs = _containing(rings, np.abs(areas))
    turns = np.sign(areas).astype(np.int64)
    outside = np.zeros(len(rings), dtype=np.int64)
    depth = np.zeros(len(rings), dtype=np.int64)
    for ring, others in pairs:
        outside[ring] = turns[others].sum()
        depth[ring] = len(others)
    inside = outside + turns if rule == "nonzero" else depth + 1
    outside = outside if rule == "nonzero" else depth
    odd = rule == "evenodd"
    is_filled = (inside % 2 == 1) if odd else (inside != 0)
    is_surrounded = (outside % 2 == 1) if odd else (outside != 0)
    exteriors = is_filled & ~is_surrounded
    polygons = {k: [rings[k]] for k in np.nonzero(exteriors)[0].tolist()}
    for ring, others in pairs:
        if is_surrounded[ring] and not is_filled[ring]:
            around = others[exteriors[others]]
            polygons[int(around[np.argmax(depth[around])])].append(rings[ring])
    return list(polygons.values())


def _containing(
    rings: Sequence[Ring], sizes: NDArray[np.float64]
) -> list[tuple[int, NDArray[np.intp]]]:
    """Each ring's number with the numbers of the larger rings that it lies in."""
    polygons = [shapely.Polygon(ring) for ring in rings]
    spots = shapely.point_on_surface(polygons)
    x, y = shapely.get_coordinates(spots).T
    tree = shapely.STRtree(spots)
    around: list[list[int]] = [[] for _ in rings]
    for k, polygon in enumerate(polygons):
        near = tree.query(polygon)  # those within its bounds
        near = near[sizes[near] < sizes[k]]
        if len(near):
            shapely.prepare(polygon)  # many points in one polygon
            for other in near[shapely.contains_xy(polygon, x[near], y[near])].tolist():
                around[other].append(k)
            shapely.destroy_prepared(polygon)
    return [(k, np.array(others, dtype=np.intp)) for k, others in enumerate(around)]
