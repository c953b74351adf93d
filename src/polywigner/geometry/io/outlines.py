"""Outlines of drawings: options of the caller; polygons with holes, by fill rule or nesting."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.parts import (
    check_pairs,
    connected,
    enclosed,
    part_of_ring,
    polygons_in,
    union_on_grid,
)
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

OVERLAP_REMEDY = (
    "join them in the drawing, read fewer layers (--layer), or give union=True (--union)"
)
"""Remedy in the error message for outlines that overlap."""

Polygon = list[Ring]
"""Rings of a polygon, with the exterior first."""


@dataclass(frozen=True, eq=False)
class File:
    """A file to be read, with the options of the caller."""

    path: Path
    content: bytes
    unit_metres: float
    """Length of the file's unit in metres; ignored if the file itself states its unit."""
    tolerance: float | None
    """Largest distance in metres between a curve and its chords; for None see
    :func:`~polywigner.geometry.io.curves.flattened`."""
    layers: tuple[str, ...]
    """Names of the layers to read, even if they are hidden; if empty, all visible layers are
    read."""
    union: bool
    """Whether overlapping outlines are joined."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """Polygons of a file in the file's unit; each is a list of rings with the exterior first."""

    polygons: Sequence[Sequence[Any]]
    metres: float
    """Length of the file's unit in metres."""


def check_known(requested: Iterable[str], known: Iterable[str]) -> None:
    """Raise ArgumentError for a requested layer that the drawing does not contain."""
    names = sorted(set(known))
    missing = [name for name in requested if name not in names]
    if missing:
        listed = ", ".join(name[:60] for name in names[:12]) + ", ..." * (len(names) > 12)
        raise ArgumentError(
            f"the drawing has no layer {missing[0][:60]!r}; "
            + (f"its layers are {listed}" if names else "it has no named layers, so omit layer")
        )


def filled(rings: Sequence[Ring], rule: str) -> list[Polygon]:
    """Return the region that a path of rings fills by the rule "nonzero" or "evenodd".

    Rings without an area are ignored. Rings that do not meet another ring stay unchanged.
    """
    rings = [
        ring
        for ring in rings
        if different_vertices(ring) >= 3 and (spans_area(ring) or hull_spans_area(ring))
    ]
    if not rings:
        return []
    if len(rings) == 1 and shapely.is_valid(shapely.Polygon(rings[0])):
        # The outlines are cleaned later, together with the aperture.
        return [rings]
    clean = [clean_ring(ring, "a ring") for ring in rings]
    return [rings_of_polygon(polygon) for polygon in enclosed(clean, rule)]


def depths(rings: Sequence[Ring]) -> NDArray[np.intp]:
    """Return the number of other rings around each ring (n, 2)."""
    return np.bincount(_containing(rings)[1], minlength=len(rings))


def nested(rings: Sequence[Ring], union: bool = False) -> list[Polygon]:
    """Return polygons whose holes are the rings inside them; rings inside holes are polygons.

    With `union`, rings that overlap or touch are joined first. Otherwise, overlaps raise a
    GeometryError.
    """
    is_simple = shapely.is_valid([shapely.Polygon(ring) for ring in rings])
    # Simple rings are cleaned later, together with the aperture.
    clean = [
        ring if simple else part_of_ring(ring, f"outline {k}")[0]
        for k, (ring, simple) in enumerate(zip(rings, is_simple.tolist(), strict=True))
    ]
    lines = shapely.MultiLineString([np.concatenate([ring, ring[:1]]) for ring in clean])
    if not shapely.is_simple(lines):
        if union:
            clean = _joined(clean)
        else:
            _check_overlaps(clean)
    return _by_nesting(clean)


def _joined(rings: Sequence[Ring]) -> list[Ring]:
    """Return the outlines of groups of rings that overlap or touch, and of rings inside others."""
    polygons = np.array([shapely.Polygon(ring) for ring in rings], dtype=object)
    tree = shapely.STRtree(polygons)
    pairs = [tree.query(polygons, predicate=relation) for relation in ("overlaps", "touches")]
    group = connected(len(rings), *np.concatenate(pairs, axis=1))
    joined: list[Ring] = []
    for number in np.unique(group):
        members = polygons[group == number]
        region = members[0] if len(members) == 1 else union_on_grid(list(members))
        joined += [ring for polygon in polygons_in(region) for ring in rings_of_polygon(polygon)]
    return joined


def _check_overlaps(rings: Sequence[Ring]) -> None:
    """Raise GeometryError if two rings overlap, unless one ring lies inside the other."""
    polygons = np.array([shapely.Polygon(ring) for ring in rings], dtype=object)
    first, second = shapely.STRtree(polygons).query(polygons, predicate="overlaps")
    once = first < second
    shift = max(rounding_tolerance(ring) for ring in rings)
    check_pairs(polygons, first[once], second[once], shift, "outlines", OVERLAP_REMEDY)


def _by_nesting(rings: Sequence[Ring]) -> list[Polygon]:
    """Return the polygons of rings that do not cross, from the number of rings around each ring."""
    outer, inner = _containing(rings)
    depth = np.bincount(inner, minlength=len(rings))
    order = np.argsort(depth[outer], kind="stable")
    innermost = dict(zip(inner[order].tolist(), outer[order].tolist(), strict=True))
    polygons = {k: [ring] for k, ring in enumerate(rings) if depth[k] % 2 == 0}
    for k, ring in enumerate(rings):
        if k not in polygons:
            polygons[innermost[k]].append(ring)
    return list(polygons.values())


def _containing(rings: Sequence[Ring]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of outer rings (m,), and of the rings inside them (m,)."""
    if not len(rings):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    polygons = [shapely.Polygon(ring) for ring in rings]
    sizes = np.abs([signed_area(ring) for ring in rings])
    points = shapely.STRtree(shapely.point_on_surface(polygons))
    outer, inner = points.query(polygons, predicate="contains")
    is_larger = sizes[outer] > sizes[inner]
    return outer[is_larger], inner[is_larger]
