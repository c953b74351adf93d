"""Outlines of a drawing: polygons with holes by a fill rule or by nesting."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.parts import enclosed, part_of_ring, polygons_in, union_on_grid
from polywigner.geometry.rings import (
    Ring,
    clean_ring,
    different_vertices,
    hull_spans_area,
    rings_of_polygon,
    rounding_tolerance,
    signed_area,
    spans_area,
)

Polygon = list[Ring]
"""Rings with the exterior first."""


def filled(rings: Sequence[Ring], rule: str) -> list[Polygon]:
    """The region that a path of several rings fills by the rule "nonzero" or "evenodd".

    Rings that enclose no area are passed over; rings that meet no other stay as they are.
    """
    kept = [ring for ring in rings if _encloses(ring)]
    if not kept:
        return []
    if len(kept) == 1 and shapely.is_valid(shapely.Polygon(kept[0])):
        return [kept]  # cleaned with the aperture
    clean = [clean_ring(ring, "a ring") for ring in kept]
    if shapely.is_simple(_lines(clean)):
        return _by_nesting(clean, rule)
    return [rings_of_polygon(polygon) for polygon in enclosed(clean, rule)]


def depths(rings: Sequence[Ring]) -> list[int]:
    """Return how many of the other rings (n, 2) lie around each ring."""
    sizes = np.abs([signed_area(ring) for ring in rings])
    return [len(others) for _, others in _containing(rings, sizes)] if len(rings) else []


def nested(
    rings: Sequence[Ring], union: bool = False, remedy: str = "join them in the drawing"
) -> list[Polygon]:
    """Polygons whose holes are the rings inside them, islands in holes and so on.

    `union` joins rings that overlap or touch first; else GeometryError with `remedy` where they
    overlap.
    """
    is_simple = shapely.is_valid([shapely.Polygon(ring) for ring in rings])
    clean = [  # simple ones are cleaned with the aperture
        ring if simple else part_of_ring(ring, f"outline {k}")[0]
        for k, (ring, simple) in enumerate(zip(rings, is_simple.tolist(), strict=True))
    ]
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
    """Return rings without repetitions of an earlier one up to `gap`, wherever they start."""
    lines = np.array([shapely.LinearRing(ring) for ring in rings], dtype=object)
    boxes, sizes = shapely.bounds(lines), np.array([len(ring) for ring in rings])
    corners = shapely.points(boxes[:, :2])
    i, j = shapely.STRtree(corners).query(corners, predicate="dwithin", distance=gap)
    near = (i < j) & (sizes[i] == sizes[j]) & (np.abs(boxes[i] - boxes[j]) <= gap).all(axis=1)
    repeats = set(j[near][shapely.hausdorff_distance(lines[i[near]], lines[j[near]]) <= gap])
    return [ring for k, ring in enumerate(rings) if k not in repeats]


def _encloses(ring: Ring) -> bool:
    return different_vertices(ring) == 3 and (spans_area(ring) or hull_spans_area(ring))


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
