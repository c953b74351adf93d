"""What an aperture is made of, rings and shapely polygons, as parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from polywigner.errors import GeometryError
from polywigner.geometry.grid import polygons_in
from polywigner.geometry.parts import part_of_ring, part_of_rings
from polywigner.geometry.rings import Part, rings_of_polygon

__all__ = ["parts_from"]


def _is_ring(vertices: Any) -> bool:
    """Whether this is one ring of (x, y) pairs rather than a sequence of rings."""
    if isinstance(vertices, np.ndarray) and vertices.dtype != object:
        return vertices.ndim <= 2
    if not len(vertices) or isinstance(vertices[0], shapely.Polygon):
        return not len(vertices)
    return np.ndim(np.asarray(vertices[0], dtype=object)) < 2


def _part_of_polygon(polygon: shapely.Polygon, name: str) -> Part:
    return part_of_rings(rings_of_polygon(polygon, name), name)


def parts_from(vertices: Any) -> list[Part]:
    """The parts of one ring (n, 2), of a list of rings, or of shapely polygons.

    Raises GeometryError for anything else.
    """
    if isinstance(vertices, (shapely.Polygon, shapely.MultiPolygon)):
        polygons = polygons_in(vertices)
        if not polygons:
            raise GeometryError("expected a polygon with vertices, got an empty one")
        single = len(polygons) == 1
        return [
            _part_of_polygon(p, "the polygon" if single else f"polygon {n}")
            for n, p in enumerate(polygons)
        ]
    if not isinstance(vertices, (np.ndarray, Sequence)) or isinstance(vertices, (str, bytes)):
        raise GeometryError(
            "expected an (n, 2) array of vertices, a list of such rings, or a shapely Polygon or "
            f"MultiPolygon, got {type(vertices).__name__}"
        )
    if _is_ring(vertices):
        return [part_of_ring(vertices)]
    return [
        _part_of_polygon(ring, f"part {n}")
        if isinstance(ring, shapely.Polygon)
        else part_of_ring(ring, f"ring {n}")
        for n, ring in enumerate(vertices)
    ]
