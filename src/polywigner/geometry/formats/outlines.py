"""From the outlines of a drawing to polygons with holes: by a fill rule, or by nesting."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, GeometryError
from polywigner.geometry.exact import Ring, signed_area
from polywigner.geometry.formats.limits import (
    MOST_CROSSINGS,
    MOST_NEAR_EDGES,
    MOST_NEAR_RINGS,
    MOST_NEAR_VERTICES,
    check_rings,
    check_vertices,
)
from polywigner.geometry.grid import polygons_in, union_on_grid
from polywigner.geometry.parts import part_of_ring
from polywigner.geometry.rings import (
    clean_ring,
    rings_of_polygon,
    rounding_tolerance,
    spans_area,
)
from polywigner.geometry.winding import enclosed

__all__ = ["check_crossings", "check_polygons", "filled", "nested", "without_duplicates"]

# Bounds the memory of one step.
_PAIRS_AT_ONCE = 4_000_000

Points = NDArray[np.float64]

Polygon = list[Ring]
"""Rings with the exterior first."""


def filled(rings: Sequence[Ring], rule: str) -> list[Polygon]:
    """The region that a path of several rings fills by the rule "nonzero" or "evenodd".

    Rings that enclose no area are passed over; where none crosses or touches another, those that
    bound the region are returned as they are.
    """
    kept = [ring for ring in rings if _encloses(ring)]
    if not kept:
        return []
    check_rings(len(kept))
    check_near(kept)
    clean = [clean_ring(ring, "a ring") for ring in kept]
    check_crossings(clean)
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
    check_near(rings)
    check_crossings(rings)
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
    """The rings less those that repeat an earlier one up to `gap`, wherever they start."""
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
    if len(np.unique(ring, axis=0)) < 3:
        return False
    # The hull, since the areas of a figure of eight cancel.
    return spans_area(shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(ring))))


def _lines(rings: Sequence[Ring]) -> shapely.MultiLineString:
    return shapely.MultiLineString([np.concatenate([ring, ring[:1]]) for ring in rings])


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
        check_near([part[0] for part in arrays])
        check_crossings(rings)
    return vertices


def check_crossings(rings: Sequence[Ring]) -> None:
    """Raise for outlines that cross themselves or each other in very many places, or nearly do.

    Quick also where they do, while GEOS needs minutes to tell where 100 000 edges cross. What GEOS
    does grows with the pairs of edges whose bounding boxes meet, so these are counted first.
    """
    start = np.concatenate(rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    tree = shapely.STRtree(shapely.linestrings(np.stack([start, end], axis=1)))
    near = found = 0
    for first, last in _steps(np.minimum(start, end), np.maximum(start, end)):
        one, other = tree.query(tree.geometries[first:last])
        one += first
        near += int((one < other).sum())
        apart = (one < other) & ~(start[other] == end[one]).all(axis=1)
        apart &= ~(start[one] == end[other]).all(axis=1)
        one, other = one[apart], other[apart]
        found += _crossings(start[one], end[one], start[other], end[other])
        if near > MOST_NEAR_EDGES:
            raise FileFormatError(
                f"expected at most {MOST_NEAR_EDGES} pairs of edges near each other, got more; "
                "simplify the outlines"
            )
        if found > MOST_CROSSINGS:
            raise FileFormatError(
                f"expected outlines that cross in at most {MOST_CROSSINGS} places, got more; "
                "simplify them"
            )


def _steps(low: Points, high: Points) -> Iterator[tuple[int, int]]:
    """Ranges of boxes (low and high corners (n, 2)) that meet few enough others for memory."""
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
        yield first, last
        first = last


def _crossings(a: Points, b: Points, c: Points, d: Points) -> int:
    """How many segments a-b cross c-d, up to rounding: they are only counted."""
    apart = _side(a, b, c) * _side(a, b, d) < 0
    a, b, c, d = a[apart], b[apart], c[apart], d[apart]
    return int((_side(c, d, a) * _side(c, d, b) < 0).sum())


def _side(a: Points, b: Points, c: Points) -> Points:
    along, across = (b - a).T, (c - a).T
    return np.sign(along[0] * across[1] - along[1] * across[0])


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
    """Polygons of rings that do not cross: which rings a ring lies in says what it bounds."""
    areas = np.array([signed_area(ring) for ring in rings])
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


def check_near(rings: Sequence[Ring]) -> None:
    """Raise for very many outlines upon or inside each other, which are compared in pairs."""
    low, high = (np.array([bound(ring, axis=0) for ring in rings]) for bound in (np.min, np.max))
    tree = shapely.STRtree(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
    sizes = np.array([len(ring) for ring in rings])
    pairs = vertices = 0
    for first, last in _steps(low, high):
        one, other = tree.query(tree.geometries[first:last])
        one += first
        later = one < other
        pairs += int(later.sum())
        vertices += int(sizes[one[later]].sum() + sizes[other[later]].sum())
        if pairs > MOST_NEAR_RINGS or vertices > MOST_NEAR_VERTICES:
            raise FileFormatError(
                f"expected at most {MOST_NEAR_RINGS} pairs of outlines that are near or inside "
                f"each other, and {MOST_NEAR_VERTICES} vertices of such pairs, got more; use fewer"
            )


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
