"""Apertures and slits of a source file's numbers, checked anew or taken as they are written."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, GeometryError
from polywigner.geometry import (
    Aperture,
    Slits,
)
from polywigner.geometry.formats.work import check_polygons
from polywigner.geometry.parts import merge_parts, part_of_rings
from polywigner.geometry.rings import Part, oriented, polygon_of_part
from polywigner.illumination.files.values import (
    coordinates,
)

__all__ = ["aperture_of_polygons", "from_polygons", "slits_as_they_are"]


def from_polygons(value: Any, verbatim: bool) -> Aperture:
    """The aperture of a list of polygons; `verbatim`: with all its vertices as they are."""
    polygons = coordinates(value)
    listed = isinstance(polygons, list) and all(
        isinstance(rings, list) and rings and all(isinstance(ring, list) for ring in rings)
        for rings in polygons
    )
    if not listed or not polygons:
        raise FileFormatError(
            "expected a list of polygons, each a list of rings, each a list of vertices [x, y]"
        )
    check_polygons(polygons)
    return _aperture_as_it_is(polygons) if verbatim else aperture_of_polygons(polygons)


def aperture_of_polygons(polygons: list[list[Any]]) -> Aperture:
    """The aperture of polygons, each a list of rings with the exterior first."""
    parts = [part_of_rings(rings, f"polygon {k}") for k, rings in enumerate(polygons)]
    return Aperture._of_parts(merge_parts(parts))


def _aperture_as_it_is(polygons: list[list[Any]]) -> Aperture:
    """Outlines exactly as they were written, without a vertex dropped or moved.

    Apertures that were shifted far, say, have vertices that rounding has put on a line, which the
    constructor would drop.
    """
    parts: list[Part] = []
    for rings in polygons:
        part = tuple(_array_of(ring) for ring in rings)
        for n, ring in enumerate(part):
            if ring.ndim != 2 or ring.shape[1] != 2 or len(ring) < 3:
                raise FileFormatError(f"expected rings of vertices [x, y], got shape {ring.shape}")
            if oriented(ring, counter_clockwise=n == 0) is not ring:
                raise GeometryError(
                    "expected exteriors counter-clockwise and holes clockwise where verbatim is "
                    "true; leave verbatim out"
                )
        parts.append(part)
    reason = shapely.is_valid_reason(shapely.MultiPolygon([polygon_of_part(p) for p in parts]))
    if reason != "Valid Geometry":
        raise GeometryError(
            f"expected valid polygons where verbatim is true, got {reason}; leave verbatim out"
        )
    return Aperture._of_parts(parts)


def slits_as_they_are(intervals: Any) -> Slits:
    """Intervals exactly as they were written; see :func:`_aperture_as_it_is`."""
    array = _array_of(intervals)
    fits = array.ndim == 2 and array.shape[1] == 2 and len(array)
    if not fits or not (np.diff(array.ravel()) >= 0).all() or not (np.diff(array) > 0).all():
        raise GeometryError(
            "expected ascending slits wider than zero where verbatim is true; leave verbatim out"
        )
    return Slits._of_intervals(array)


def _array_of(numbers: Any) -> NDArray[np.float64]:
    try:
        return np.array(numbers, dtype=np.float64)
    except ValueError:  # lists of different lengths
        return np.empty(0)
