"""From the outlines of a drawing to polygons with holes: by a fill rule, or by nesting."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, GeometryError
from polywigner.geometry.exact import Ring, signed_area
from polywigner.geometry.formats.drawing import check_rings
from polywigner.geometry.grid import polygons_in, union_on_grid
from polywigner.geometry.parts import part_of_ring
from polywigner.geometry.rings import (
    clean_ring,
    rings_of_polygon,
    rounding_tolerance,
    spans_area,
)
from polywigner.geometry.winding import enclosed

__all__ = ["MOST_CROSSINGS", "check_crossings", "filled", "nested", "without_duplicates"]

MOST_CROSSINGS = 20_000
"""Places where outlines cross: twice as many faces, some 0.1 ms each."""

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
    boxes = np.array([[*ring.min(axis=0), *ring.max(axis=0)] for ring in rings])
    centres = shapely.points((boxes[:, :2] + boxes[:, 2:]) / 2)
    first, second = shapely.STRtree(centres).query(centres, predicate="dwithin", distance=gap)
    repeats = set()
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        alike = i < j and len(rings[i]) == len(rings[j])
        if alike and j not in repeats and np.abs(boxes[i] - boxes[j]).max() <= gap:
            distances = shapely.hausdorff_distance(*map(shapely.LinearRing, (rings[i], rings[j])))
            if distances <= gap:
                repeats.add(j)
    return [ring for k, ring in enumerate(rings) if k not in repeats]


def _encloses(ring: Ring) -> bool:
    if len(np.unique(ring, axis=0)) < 3:
        return False
    # The hull, since the areas of a figure of eight cancel.
    return spans_area(shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(ring))))


def _lines(rings: Sequence[Ring]) -> shapely.MultiLineString:
    return shapely.MultiLineString([np.concatenate([ring, ring[:1]]) for ring in rings])


def check_crossings(rings: Sequence[Ring]) -> None:
    """Raise for outlines that cross themselves or each other in very many places.

    Quick also where they do, while GEOS needs minutes to tell where 100 000 edges cross.
    """
    points = np.concatenate(rings)
    following = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    edges = shapely.linestrings(np.stack([points, following], axis=1))
    tree = shapely.STRtree(edges)
    found = start = 0
    step = 1
    while start < len(edges):
        crossings = tree.query(edges[start : start + step], predicate="crosses").shape[1]
        start += step
        found += crossings
        # Small steps where there are many pairs, which all take memory.
        step = min(2 * step, 10_000) if crossings < 1000 else max(1, step // 2)
        if found > 2 * MOST_CROSSINGS:  # each is found from either side
            raise FileFormatError(
                f"expected outlines that cross in at most {MOST_CROSSINGS} places, got more; "
                "simplify them"
            )


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


def _containing(
    rings: Sequence[Ring], sizes: NDArray[np.float64]
) -> list[tuple[int, NDArray[np.intp]]]:
    """Each ring's number with the numbers of the larger rings that it lies in."""
    polygons = [shapely.Polygon(ring) for ring in rings]
    tree = shapely.STRtree(polygons)
    spots = shapely.point_on_surface(polygons)
    result = []
    for k, spot in enumerate(spots):
        others = tree.query(spot, predicate="within")
        result.append((k, others[sizes[others] > sizes[k]]))
    return result
