"""From the outlines of a drawing to polygons with holes: by a fill rule, or by nesting."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, GeometryError
from polywigner.geometry.exact import Ring, signed_area
from polywigner.geometry.parts import part_of_ring
from polywigner.geometry.rings import (
    clean_ring,
    rings_of_polygon,
    rounding_tolerance,
    spans_area,
)
from polywigner.geometry.winding import enclosed

__all__ = ["MOST_CROSSINGS", "MOST_RINGS", "filled", "nested", "without_duplicates"]

MOST_RINGS = 10_000
"""Outlines of one drawing: 1e8 pairs that may lie in each other, tested in half a minute."""

MOST_CROSSINGS = 20_000
"""Places where the outlines of one path cross: twice as many faces, some 0.1 ms each."""

# Pairs of boxes looked at together: a few hundred MB at most.
_PAIRS_AT_ONCE = 4_000_000

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
    _check_number(kept)
    clean = [clean_ring(ring, "a ring") for ring in kept]
    if shapely.is_simple(_lines(clean)):
        return _by_nesting(clean, rule)
    _check_crossings(clean)
    return [rings_of_polygon(polygon) for polygon in enclosed(clean, rule)]


def nested(rings: Sequence[Ring]) -> list[Polygon]:
    """Polygons whose holes are the rings inside them, islands in holes and so on.

    Raises GeometryError for a ring that crosses itself and for rings that overlap; they may touch.
    """
    _check_number(rings)
    clean = [part_of_ring(ring, f"outline {k}")[0] for k, ring in enumerate(rings)]
    if not shapely.is_simple(_lines(clean)):
        _check_overlaps(clean)
    return _by_nesting(clean, "evenodd")


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


def _check_number(rings: Sequence[Ring]) -> None:
    if len(rings) > MOST_RINGS:
        raise FileFormatError(
            f"expected at most {MOST_RINGS} outlines, got {len(rings)}; use fewer, such as one "
            "element of an array"
        )


def _lines(rings: Sequence[Ring]) -> shapely.MultiLineString:
    return shapely.MultiLineString([np.concatenate([ring, ring[:1]]) for ring in rings])


def _check_crossings(rings: Sequence[Ring]) -> None:
    """Bounds the arrangement before it is built; looks at so many pairs at most as well."""
    points = np.concatenate(rings)
    following = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    edges = shapely.linestrings(np.stack([points, following], axis=1))
    tree = shapely.STRtree(edges)
    found, step = 0, max(1, _PAIRS_AT_ONCE // len(edges))
    for k in range(0, len(edges), step):
        found += tree.query(edges[k : k + step], predicate="crosses").shape[1]
        if found > 2 * MOST_CROSSINGS:  # each is found from either side
            raise FileFormatError(
                f"expected outlines that cross in at most {MOST_CROSSINGS} places, got more; "
                "simplify them"
            )


def _check_overlaps(rings: Sequence[Ring]) -> None:
    """Raise where the insides of two rings meet, and neither lies in the other."""
    polygons = np.array([shapely.Polygon(ring) for ring in rings], dtype=object)
    tree = shapely.STRtree(polygons)
    shift = max(rounding_tolerance(ring) for ring in rings)
    for i, polygon in enumerate(polygons):
        near = tree.query(polygon, predicate="overlaps")
        common = shapely.intersection(polygon, polygons[near])
        # As for parts: an edge displaced by rounding sweeps that much times its length.
        deep = shapely.area(common) > shift * np.minimum(polygon.length, shapely.length(common))
        if deep.any():
            j, spot = near[deep][0], shapely.point_on_surface(common[deep][0])
            raise GeometryError(
                f"expected outlines that do not overlap, got outlines {i} and {j} that cross "
                f"around ({spot.x:.6g}, {spot.y:.6g}); join them in the drawing"
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
