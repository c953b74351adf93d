"""Valid sets of polygons from rings: simple polygons that do not overlap, merged if they touch.

GEOS tests the validity of polygons exactly. Vertices that differ by up to 64 ulp are merged.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from polywigner.errors import GeometryError
from polywigner.geometry.arguments import checked_choice
from polywigner.geometry.rings import (
    Part,
    Ring,
    clean_ring,
    edges_of_rings,
    extent,
    hull_spans_area,
    orientations,
    oriented,
    part_of_polygon,
    polygon_of_part,
    rings_of_polygon,
    rounding_tolerance,
    spans_area,
)

# Grid spacing as a fraction of the extent. It is larger than rounding errors, and smaller than the
# accuracy of 1e-12.
_GRID = 2.0**-44


def grid_size(points: Ring) -> float:
    """Return a power of two near 2^-44 of the extent or largest coordinate, whichever is larger."""
    scale = max(extent(points), float(np.abs(points).max()))
    return float(_GRID * 2.0 ** np.ceil(np.log2(scale)))


def polygons_in(geometry: BaseGeometry) -> list[shapely.Polygon]:
    """Return the polygons of a geometry, without its points and lines."""
    if geometry.geom_type == "Polygon":
        return [] if geometry.is_empty else [geometry]
    return [p for part in getattr(geometry, "geoms", ()) for p in polygons_in(part)]


def shifted(polygons: NDArray[Any], shifts: Ring) -> NDArray[Any]:
    """Return polygons (n,), each shifted by one of the vectors (n, 2)."""
    points, number = shapely.get_coordinates(polygons, return_index=True)
    moved: NDArray[Any] = shapely.set_coordinates(polygons.copy(), points + shifts[number])
    return moved


def snapped(geometry: BaseGeometry, originals: Ring, distance: float) -> BaseGeometry:
    """Return a geometry with vertices moved to the nearest `originals` (n, 2) within `distance`.

    If the result would be invalid, the geometry is returned unchanged.
    """
    tree = shapely.STRtree(shapely.points(originals))

    def moved(points: Ring) -> Ring:
        """Return points (n, 2), moved to the nearest original points within the distance."""
        index, nearest = tree.query_nearest(
            shapely.points(points), max_distance=distance, all_matches=False
        )
        result = points.copy()
        result[index] = originals[nearest]
        return result

    exact = shapely.transform(geometry, moved)
    return exact if shapely.is_valid(exact) else geometry


def straightened(geometry: BaseGeometry, distance: float) -> BaseGeometry:
    """Drop vertices within a distance of the line between their neighbours, if the result is valid.

    If no vertex can be dropped, the result is the same object.
    """
    # The polygons are normalised, so that the result does not depend on the starting vertex.
    array = np.array(polygons_in(geometry), dtype=object)
    polygons = shapely.simplify(shapely.normalize(array), distance)
    simple = polygons[0] if len(polygons) == 1 else shapely.MultiPolygon(polygons.tolist())
    fewer = shapely.get_num_coordinates(simple) < shapely.get_num_coordinates(geometry)
    return simple if fewer and shapely.is_valid(simple) else geometry


def _is_hairline(region: BaseGeometry, width: float) -> bool:
    """Return whether the area of a region is at most its perimeter times ``width``."""
    return bool(region.area <= width * region.length)


def connected(count: int, first: NDArray[np.intp], second: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return labels (count,) of the connected components of a graph with edges (first, second).

    The label of a component is its smallest node number.
    """
    labels = np.arange(count)
    while True:
        least = np.minimum(labels[first], labels[second])
        before = labels.copy()
        for side in (first, second):
            np.minimum.at(labels, labels[side], least)
        labels = labels[labels]
        if (labels == before).all():
            return labels


def _union_by_groups(geometries: Sequence[BaseGeometry], grid: float) -> BaseGeometry:
    """Return the union of geometries on a grid, computed separately for distant groups."""
    array = np.array(geometries, dtype=object)
    boxes = shapely.box(*(shapely.bounds(array) + grid * np.array([-1, -1, 1, 1])).T)
    labels = connected(len(array), *shapely.STRtree(boxes).query(boxes))
    groups = [array[labels == label] for label in np.unique(labels)]
    if len(groups) == 1:
        return shapely.union_all(array, grid_size=grid)
    unions = [
        shapely.union_all(group, grid_size=grid) if len(group) > 1 else group[0] for group in groups
    ]
    return shapely.MultiPolygon([polygon for part in unions for polygon in polygons_in(part)])


def union_on_grid(
    geometries: Sequence[BaseGeometry], originals: Ring | None = None
) -> BaseGeometry:
    """Return the union of polygons, without gaps and overlaps due to rounding.

    Vertices near `originals` (n, 2), by default the input vertices, become equal to them.
    """
    points = shapely.get_coordinates(list(geometries)) if originals is None else originals
    grid = grid_size(points)
    return _without_slivers(_union_by_groups(geometries, grid), points, grid)


def combined_on_grid(
    operation: Callable[..., BaseGeometry], first: BaseGeometry, second: BaseGeometry
) -> BaseGeometry:
    """Apply a set operation of shapely; clean the result like :func:`union_on_grid`.

    If no part of the result is wider than the grid, the result is an empty MultiPolygon.
    """
    points = shapely.get_coordinates([first, second])
    grid = grid_size(points)
    result = operation(first, second, grid_size=grid)
    if all(_is_hairline(polygon, grid) for polygon in polygons_in(result)):
        return shapely.MultiPolygon()
    return _without_slivers(result, points, grid)


def _without_slivers(region: BaseGeometry, points: Ring, grid: float) -> BaseGeometry:
    """Remove the polygons and holes of a region that are thinner than the grid.

    Vertices near ``points`` (n, 2) become equal to them, and vertices on straight lines are
    dropped. If all polygons are thinner than the grid, they are kept.
    """
    polygons = []
    for polygon in polygons_in(region):
        holes = [h for h in polygon.interiors if not _is_hairline(shapely.Polygon(h), grid)]
        polygons.append(shapely.Polygon(polygon.exterior, holes))
    wide = [polygon for polygon in polygons if not _is_hairline(polygon, grid)] or polygons
    joined = wide[0] if len(wide) == 1 else shapely.MultiPolygon(wide)
    return straightened(snapped(joined, points, grid), grid)


def _welded(polygons: NDArray[np.object_]) -> NDArray[np.object_]:
    """Merge nearly equal vertices of polygons (n,), and add vertices where vertices touch edges.

    Vertices move by at most 64 ulp of the largest coordinate. Polygons that would become invalid
    stay unchanged.
    """
    coordinates, owner = shapely.get_coordinates(polygons, return_index=True)
    distance, points = rounding_tolerance(coordinates), shapely.points(coordinates)
    later, earlier = shapely.STRtree(points).query(points, predicate="dwithin", distance=distance)
    target = np.arange(len(points))
    np.minimum.at(target, later, earlier)
    kept, which = np.unique(target, return_inverse=True)
    number, near = shapely.STRtree(points[kept]).query(
        polygons, predicate="dwithin", distance=distance
    )
    # GEOS compares each edge with each reference point, so reference points that are vertices of
    # the polygon are omitted.
    is_vertex = (coordinates == coordinates[target]).all(axis=1)
    present = (owner * len(kept) + which)[is_vertex]
    missing = ~np.isin(number * len(kept) + near, present)
    touching, index = np.unique(number[missing], return_inverse=True)
    references = shapely.multipoints(points[kept[near[missing]]], indices=index)
    welded = polygons.copy()
    welded[touching] = shapely.snap(polygons[touching], references, distance)
    return np.where(shapely.is_valid(welded), welded, polygons)


# Largest distance of a dropped vertex from its chord, as a fraction of area/diameter. The relative
# change in area is then the same for thin and compact parts.
_STRAIGHT = 2.0**-48

_MERGE = "merge them with shapely.union_all, or give a hole as shapely.Polygon(outer, [hole])"

_COORDINATES = re.compile(r"\[(\S+) (\S+)\]")


def part_of_ring(vertices: object, name: str = "the ring") -> Part:
    """Convert a simple ring to a part without holes; raise GeometryError for other rings.

    The part is counter-clockwise and omits vertices on straight lines.
    """
    ring = clean_ring(vertices, name)
    spans = spans_area(ring)
    if not spans and not hull_spans_area(ring):
        raise GeometryError(f"expected {name} to enclose an area, got vertices on one line")
    reason = shapely.is_valid_reason(shapely.Polygon(ring))
    if reason != "Valid Geometry":
        what = "touches itself" if reason.startswith("Ring") else "crosses itself"
        point = _COORDINATES.search(reason)
        where = f" at ({point[1]}, {point[2]})" if point else ""
        raise GeometryError(
            f"expected a simple outline, got {name} that {what}{where}; split it with "
            'Aperture.from_ring(ring, winding="nonzero") or winding="evenodd"'
        )
    if not spans:
        raise GeometryError(f"expected {name} to enclose an area, got zero area")
    return _straightened((oriented(ring, True),))


def _straightened(part: Part) -> Part:
    """Remove the vertices of a part that lie between their neighbours, up to rounding errors."""
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
    """Convert an exterior and its holes, of any orientation, to a part.

    Raises GeometryError if rings cross, or if a hole is outside the exterior. The message names the
    polygon ``name`` and ends with ``remedy``.
    """
    outer, *holes = (
        part_of_ring(ring, f"hole {number} of {name}" if number else f"the exterior of {name}")[0]
        for number, ring in enumerate(rings)
    )
    part = (outer, *(hole[::-1] for hole in holes))
    reason = shapely.is_valid_reason(polygon_of_part(part))
    if reason == "Valid Geometry":
        return part
    # Rounding may make a part invalid if its holes touch other rings.
    exterior, *interiors = _welded(np.array([shapely.Polygon(ring) for ring in part]))
    welded = shapely.Polygon(exterior.exterior, [hole.exterior for hole in interiors])
    if shapely.is_valid(welded):
        return part_of_polygon(welded)
    raise GeometryError(f"expected holes inside {name} that do not overlap, got {reason}; {remedy}")


def check_overlaps(
    polygons: Sequence[shapely.Polygon], things: str, remedy: str, nested: bool = False
) -> bool:
    """Return whether any polygons touch; raise GeometryError if any polygons overlap.

    ``things``: plural name of the polygons in the message. If ``nested`` is true, a polygon may
    cover another polygon, and contacts are not reported.
    """
    array = np.array(polygons, dtype=object)
    shift = rounding_tolerance(shapely.get_coordinates(array))
    predicate: dict[str, Any] = (
        {"predicate": "overlaps"} if nested else {"predicate": "dwithin", "distance": shift}
    )
    first, second = shapely.STRtree(array).query(array, **predicate)
    once = first < second
    first, second = first[once], second[once]
    if not len(first):
        return False
    common = shapely.intersection(array[first], array[second])
    # A shift of an edge by the rounding error changes the area by the error times the length.
    # Slivers may be thinner than the error, so at most half of the smaller area is allowed.
    allowed = shift * np.minimum(shapely.length(array[first]), shapely.length(array[second]))
    smaller = np.minimum(shapely.area(array[first]), shapely.area(array[second]))
    excess = shapely.area(common) - np.minimum(allowed, smaller / 2)
    if (excess > 0).any():
        worst = int(excess.argmax())
        i, j = first[worst], second[worst]
        thing, overlap = things[:-1], f"an overlap between {things} {i} and {j}"
        for n, m in ((j, i), (i, j)):
            if shapely.covers(array[m], array[n]):
                overlap = f"{thing} {n} inside {thing} {m}"
        spot = shapely.point_on_surface(common[worst])
        raise GeometryError(
            f"expected {things} that do not overlap, got {overlap} around "
            f"({spot.x:.15g}, {spot.y:.15g}); {remedy}"
        )
    return True


def merge_parts(parts: Sequence[Part], remedy: str = _MERGE) -> list[Part]:
    """Join parts that share a piece of boundary; raise GeometryError if parts overlap.

    Parts that touch only at a point stay separate. The message ends with ``remedy``.
    """
    polygons = [polygon_of_part(part) for part in parts]
    if len(parts) == 1 or not check_overlaps(polygons, "parts", remedy):
        return list(parts)
    return union_parts(parts)


def union_parts(parts: Sequence[Part]) -> list[Part]:
    """Return the union of parts that may overlap."""
    welded = _welded(np.array([polygon_of_part(part) for part in parts]))
    union = union_on_grid(welded.tolist())
    return [part_of_polygon(polygon) for polygon in polygons_in(union)]


def _winding_numbers(start: Ring, end: Ring, points: Ring) -> NDArray[np.int64]:
    """Return the winding numbers (m,) of closed curves about points (m, 2).

    The curves consist of edges from start to end (n, 2); counter-clockwise is positive.
    """
    tree = shapely.STRtree(shapely.linestrings(np.stack([start, end], axis=1)))
    farthest = np.column_stack([np.full(len(points), start[:, 0].max()), points[:, 1]])
    rays = shapely.linestrings(np.stack([points, farthest], axis=1))
    of_point, edge = tree.query(rays)
    a, b, point = start[edge], end[edge], points[of_point]
    side = orientations(a, b, point)
    upward = (a[:, 1] <= point[:, 1]) & (b[:, 1] > point[:, 1]) & (side > 0)
    downward = (a[:, 1] > point[:, 1]) & (b[:, 1] <= point[:, 1]) & (side < 0)
    numbers = np.zeros(len(points), dtype=np.int64)
    np.add.at(numbers, of_point, upward.astype(np.int64) - downward)
    return numbers


def split_ring(vertices: Any, winding: str) -> list[Part]:
    """Return the parts inside a ring that may cross itself.

    ``winding``: the fill rule, "nonzero" or "evenodd". Raises GeometryError if the area is zero.
    """
    checked_choice(winding, "winding", ("nonzero", "evenodd"))
    ring = clean_ring(vertices, "the ring")
    if shapely.is_valid(shapely.Polygon(ring)):
        return [part_of_ring(ring)]
    polygons = enclosed([ring], winding)
    if not polygons:
        raise GeometryError(
            f"expected a ring that encloses an area, got zero area by the {winding!r} rule"
        )
    return [part_of_polygon(polygon) for polygon in polygons]


def enclosed(rings: Sequence[Ring], winding: str) -> list[shapely.Polygon]:
    """Return the polygons inside rings (n, 2), which may cross, under a fill rule.

    ``winding``: "nonzero" or "evenodd". The list is empty if the rings enclose no area.
    """
    # The grid avoids hairline faces along a curve that is traversed twice with different rounding.
    points, following = edges_of_rings(rings)
    # Each ring is one line, because GEOS takes many times as long with one line per edge.
    lines = [shapely.LineString(np.concatenate([ring, ring[:1]])) for ring in rings]
    noded = shapely.union_all(lines, grid_size=grid_size(points))
    faces = polygons_in(shapely.polygonize([noded]))
    inside = shapely.get_coordinates(shapely.point_on_surface(faces)).reshape(-1, 2)
    numbers = _winding_numbers(points, following, inside)
    chosen = numbers != 0 if winding == "nonzero" else numbers % 2 == 1
    inner = [face for face, is_inner in zip(faces, chosen, strict=True) if is_inner]
    return polygons_in(union_on_grid(inner, points)) if inner else []


def _is_ring(vertices: Any) -> bool:
    """Return whether an argument is one ring (n, 2), not a list of rings or polygons."""
    if isinstance(vertices, np.ndarray) and vertices.dtype != object:
        return vertices.ndim <= 2
    if not len(vertices) or isinstance(vertices[0], shapely.Polygon):
        return not len(vertices)
    return np.ndim(np.asarray(vertices[0], dtype=object)) < 2


def parts_from(vertices: Any) -> list[Part]:
    """Convert one ring (n, 2), a list of rings, or shapely polygons to parts, which may overlap.

    Each ring becomes a separate part; only shapely polygons have holes. Raises GeometryError for
    other arguments, and for rings that cross themselves.
    """
    if isinstance(vertices, (shapely.Polygon, shapely.MultiPolygon)):
        polygons = polygons_in(vertices)
        if not polygons:
            raise GeometryError("expected a polygon with vertices, got an empty polygon")
        names = [
            f"polygon {n}" if len(polygons) > 1 else "the polygon" for n in range(len(polygons))
        ]
        return [
            part_of_rings(rings_of_polygon(p, n), n) for p, n in zip(polygons, names, strict=True)
        ]
    if not isinstance(vertices, (np.ndarray, Sequence)) or isinstance(vertices, (str, bytes)):
        raise GeometryError(
            "expected an (n, 2) array of vertices, a list of such rings, or a shapely Polygon or "
            f"MultiPolygon, got {type(vertices).__name__}"
        )
    if _is_ring(vertices):
        return [part_of_ring(vertices)]
    return [
        part_of_rings(rings_of_polygon(ring, f"part {n}"), f"part {n}")
        if isinstance(ring, shapely.Polygon)
        else part_of_ring(ring, f"ring {n}")
        for n, ring in enumerate(vertices)
    ]
