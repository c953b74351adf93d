"""Outlines of a drawing: polygons with holes by a fill rule or by nesting, and layers."""

from __future__ import annotations

import importlib
import logging
import math
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, GeometryError, MissingExtraError, install_command
from polywigner.geometry.exact import Ring, estimated_area
from polywigner.geometry.io.limits import MOST_CROSSINGS, Work, check_rings, check_vertices
from polywigner.geometry.parts import enclosed, part_of_ring, polygons_in, union_on_grid
from polywigner.geometry.rings import (
    clean_ring,
    different_vertices,
    hull_spans_area,
    rings_of_polygon,
    rounding_tolerance,
    spans_area,
)


@dataclass(frozen=True, eq=False)
class Drawing:
    """Polygons of a file, each a list of rings with the exterior first, in the file's own unit."""

    polygons: list[list[Ring]]
    metres: float
    """Length of the file's unit."""
    remedy: str | None = None
    """What to do in a drawing about outlines that overlap."""


def required(library: str, kind: str) -> Any:
    """Import a library that the extra `formats` brings.

    Raises MissingExtraError where it is not installed.
    """
    try:
        module = importlib.import_module(library)
    except ImportError:
        raise MissingExtraError(
            f"expected {library.partition('.')[0]} to be installed, which reads {kind} files, got "
            f"none; run {install_command('formats')}"
        ) from None
    # Messages of a library about a damaged file go to a user's handlers, not to the terminal.
    logger = logging.getLogger(library.partition(".")[0])
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())
    return module


def checked_tolerance(tolerance: Any) -> float | None:
    """A length in metres above zero, or None; ArgumentError for any other."""
    if tolerance is None:
        return None
    number = isinstance(tolerance, (int, float, np.number)) and not isinstance(tolerance, bool)
    if not number or not 0 < tolerance < math.inf:
        raise ArgumentError(
            f"expected a tolerance in metres above zero, got {tolerance!r}; give one such as 1e-5"
        )
    return float(tolerance)


_MOST_NAMED = 12


def checked_layers(layer: Any) -> tuple[str, ...]:
    """The names that a caller gives: one, several, or None for all layers."""
    given = () if layer is None else (layer,) if isinstance(layer, str) else layer
    names = tuple(given) if isinstance(given, Iterable) else (given,)
    if not all(isinstance(name, str) and name for name in names):
        raise ArgumentError(
            f"expected a layer by its name, or several names, got {layer!r}; give for example "
            'layer="pads" or layer=["pads", "feed"]'
        )
    return names


def checked_union(union: Any) -> bool:
    """The flag itself, or ArgumentError."""
    if not isinstance(union, bool | np.bool_):
        raise ArgumentError(f"expected union as True or False, got {union!r}; give one of them")
    return bool(union)


def check_known(asked: Iterable[str], known: Iterable[str]) -> None:
    """Raise ArgumentError for a layer that the drawing does not have."""
    names = sorted(set(known))
    for name in asked:
        if name not in names:
            listed = ", ".join(shown[:60] for shown in names[:_MOST_NAMED])
            more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
            raise ArgumentError(
                f"expected a layer of the drawing, got {name[:60]!r}; "
                + (f"it has {listed}{more}" if names else "it names none, so leave layer out")
            )


def overlap_remedy(rings: Sequence[Ring], layers: Sequence[str]) -> str:
    """Advice for outlines (n, 2) on `layers` that cross, overlap, or touch inside another."""
    frame = _frame(rings)
    if frame is None:
        return "join them in the drawing, or give union=True (--union)"
    others = sorted(set(layers) - {layers[frame]} - {""})
    place = f"the outline on layer {layers[frame][:60]!r}" if layers[frame] else "one outline"
    if not others:
        return f"{place} lies around all others: move it to a layer that is not read"
    if len(others) > 3:
        return f"{place} lies around all others: read the others with layer={others[:3]} and so on"
    listed = repr(others[0] if len(others) == 1 else others)
    options = " ".join(f"--layer {shlex.quote(name)}" for name in others)
    return f"{place} lies around all others: read the others with layer={listed} ({options})"


def _frame(rings: Sequence[Ring]) -> int | None:
    """The number of the ring around two others or more, if it is around all."""
    if len(rings) < 3:
        return None
    boxes = np.array([[*ring.min(axis=0), *-ring.max(axis=0)] for ring in rings])
    around = (boxes <= boxes.min(axis=0)).all(axis=1)
    if not around.any():
        return None
    frame = int(np.argmax(around))
    points = np.concatenate([ring for k, ring in enumerate(rings) if k != frame])
    outline = shapely.Polygon(rings[frame])
    shapely.prepare(outline)
    return frame if shapely.intersects_xy(outline, points).all() else None


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
    return len(ring) ** 2 <= MOST_CROSSINGS and bool(shapely.is_valid(shapely.Polygon(ring)))


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
