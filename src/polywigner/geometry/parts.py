"""From clean rings to a valid set of parts: simple, apart from each other, merged where they touch.

Validity is decided with exact predicates (GEOS), so it does not depend on the size or place of the
aperture. Where it fails, coordinates may differ by rounding only (tiles that were rotated, corners
of one part on an edge of another): such places are welded, by at most 64 ulp, and tried again.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import GeometryError
from polywigner.geometry.exact import shoelace
from polywigner.geometry.grid import polygons_in, straightened, union_on_grid
from polywigner.geometry.rings import (
    Part,
    clean_ring,
    extent,
    hull_spans_area,
    oriented,
    part_of_polygon,
    polygon_of_part,
    rounding_tolerance,
    spans_area,
)
from polywigner.geometry.weld import weld

__all__ = ["merge_parts", "part_of_ring", "part_of_rings", "union_parts"]

# In units of area/diameter: dropping vertices this near a line changes the area by about as small
# a fraction of itself, however thin the part is. In a unit square it is 16 ulp.
_STRAIGHT = 2.0**-48

# A block of parts that overlap all others is then intersected in about a second.
_VERTICES_AT_ONCE = 200_000

_MERGE = "merge them with shapely.union_all, or give a hole as shapely.Polygon(outer, [hole])"

_PLACE = re.compile(r"\[(\S+) (\S+)\]")


def _place(reason: str) -> str:
    found = _PLACE.search(reason)
    return f" at ({found[1]}, {found[2]})" if found else ""


def part_of_ring(vertices: object, name: str = "the ring") -> Part:
    """A simple ring as a part without holes; a self-crossing one raises with the place."""
    ring = clean_ring(vertices, name)
    spans = spans_area(ring)
    if not spans and not hull_spans_area(ring):
        raise GeometryError(f"expected {name} to enclose an area, got vertices on one line")
    reason = shapely.is_valid_reason(shapely.Polygon(ring))
    if reason != "Valid Geometry":
        what = "touches itself" if reason.startswith("Ring") else "crosses itself"
        raise GeometryError(
            f"expected a simple outline, got {name} that {what}{_place(reason)}; "
            'split it with Aperture.from_ring(ring, winding="nonzero") or winding="evenodd"'
        )
    if not spans:
        raise GeometryError(f"expected {name} to enclose an area, got one of zero area")
    return _straightened((oriented(ring, True),))


def _straightened(part: Part) -> Part:
    """Drop vertices on straight lines up to rounding, as densely sampled outlines have them.

    Without them others may be seen to lie on one: until none does, so that it is the same aperture
    however often its outline is taken out and in.
    """
    while True:
        polygon = polygon_of_part(part)
        simple = straightened(polygon, _STRAIGHT * polygon.area / extent(part[0]))
        if simple is polygon:
            return part
        part = part_of_polygon(simple)


def part_of_rings(
    rings: Sequence[object],
    name: str = "the polygon",
    remedy: str = "repair it with shapely.make_valid or shapely.difference",
) -> Part:
    """An exterior and its holes as a part; raises where one crosses itself or another.

    `remedy` ends the message about holes.
    """
    outer, *holes = (
        part_of_ring(ring, f"hole {number} of {name}" if number else f"the exterior of {name}")[0]
        for number, ring in enumerate(rings)
    )
    part = (outer, *(hole[::-1] for hole in holes))
    reason = shapely.is_valid_reason(polygon_of_part(part))
    if reason == "Valid Geometry":
        return part
    welded = weld([part])[0]
    if all(len(ring) >= 3 for ring in welded) and shapely.is_valid(polygon_of_part(welded)):
        return welded
    raise GeometryError(
        f"expected holes inside {name} and apart from each other, got {reason}; {remedy}"
    )


def _check_overlaps(
    parts: Sequence[Part], polygons: Sequence[shapely.Polygon], remedy: str
) -> bool:
    """Raise where two parts overlap by more than rounding; tell whether any two touch.

    Goes through the parts in blocks, since a thousand parts upon each other make a million pairs.
    """
    # Parts a rounding error apart are meant to touch, too.
    shift = max(rounding_tolerance(part[0]) for part in parts)
    array = np.array(polygons, dtype=object)
    tree = shapely.STRtree(array)
    step = max(1, _VERTICES_AT_ONCE // int(shapely.get_num_coordinates(array).sum()))
    touching = False
    for start in range(0, len(array), step):
        block = array[start : start + step]
        first, second = tree.query(block, predicate="dwithin", distance=shift)
        first += start
        pairs = first < second
        if pairs.any():
            touching = True
            _check_pairs(array, first[pairs], second[pairs], shift, remedy)
    return touching


def _check_pairs(
    array: NDArray[np.object_],
    first: NDArray[np.intp],
    second: NDArray[np.intp],
    shift: float,
    remedy: str,
) -> None:
    common = shapely.intersection(array[first], array[second])
    # An edge displaced by the rounding tolerance sweeps that tolerance times its length. Half of a
    # sliver is an overlap, however thin it is.
    allowed = shift * np.minimum(shapely.length(array[first]), shapely.length(array[second]))
    smaller = np.minimum(shapely.area(array[first]), shapely.area(array[second]))
    allowed = np.minimum(allowed, smaller / 2)
    excess = shapely.area(common) > allowed
    if excess.any():
        worst = int(np.argmax(shapely.area(common)))
        i, j = first[worst], second[worst]
        inside = [n for n, m in ((i, j), (j, i)) if shapely.covers(array[m], array[n])]
        relation = f"part {inside[0]} inside the other" if inside else "an overlap"
        spot = shapely.point_on_surface(common[worst])
        raise GeometryError(
            f"expected parts that do not overlap, got {relation} between parts {i} and {j} around "
            f"({spot.x:.15g}, {spot.y:.15g}); {remedy}"
        )


def _clean_union(parts: Sequence[Part]) -> list[Part] | None:
    """The union of touching parts if it is exact: same area, and no vertex that is new."""
    if any(len(ring) < 3 for part in parts for ring in part):
        return None  # a sliver that welding has closed
    try:
        merged = shapely.union_all([polygon_of_part(part) for part in parts])
    except shapely.errors.GEOSException:
        return None
    known = {vertex.tobytes() for part in parts for ring in part for vertex in ring}
    if not all((v + 0.0).tobytes() in known for v in shapely.get_coordinates(merged)):
        return None
    result = [part_of_polygon(polygon) for polygon in polygons_in(merged)]
    before = shoelace(ring for part in parts for ring in part)
    after = shoelace(ring for part in result for ring in part)
    return result if before == after and shapely.is_valid(merged) else None


def merge_parts(parts: Sequence[Part], remedy: str = _MERGE) -> list[Part]:
    """Parts whose union has no inner edges; touching ones are joined, overlapping ones raise.

    `remedy` ends the message about overlaps.
    """
    polygons = [polygon_of_part(part) for part in parts]
    if len(parts) == 1 or not _check_overlaps(parts, polygons, remedy):
        return list(parts)
    merged = _clean_union(weld(parts)) or _clean_union(parts)
    if merged is not None:
        # Corners of tiles along a side of the whole are on one line up to rounding: drop them.
        whole = shapely.MultiPolygon([polygon_of_part(part) for part in merged])
        reach = max(rounding_tolerance(part[0]) for part in merged)
        return [part_of_polygon(polygon) for polygon in polygons_in(straightened(whole, reach))]
    # Rare: the parts' edges run along each other at rounding distance without sharing vertices.
    return _joined_on_grid(polygons)


def union_parts(parts: Sequence[Part]) -> list[Part]:
    """Parts of the union of parts that may overlap; as :func:`merge_parts` where none does."""
    try:
        return merge_parts(parts)
    except GeometryError:
        return _joined_on_grid([polygon_of_part(part) for part in parts])


def _joined_on_grid(polygons: Sequence[shapely.Polygon]) -> list[Part]:
    return [part_of_polygon(polygon) for polygon in polygons_in(union_on_grid(polygons))]
