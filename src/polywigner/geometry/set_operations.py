"""Union, intersection and difference of apertures, and their fields."""

from __future__ import annotations

from typing import TYPE_CHECKING

import shapely

from polywigner.errors import GeometryError, IlluminationError
from polywigner.geometry.grid import combined_on_grid, union_on_grid

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from polywigner.geometry.aperture import Aperture

__all__ = ["difference", "intersection", "union"]


def union(one: Aperture, other: Aperture) -> BaseGeometry:
    """What lies in either. Raises IlluminationError where their fields differ."""
    if one.illumination != other.illumination:
        raise IlluminationError(
            "expected one field on both apertures of a union, got two that differ; join outlines "
            "without a field, and give the union its own by with_illumination"
        )
    return union_on_grid([one.polygons, other.polygons])


def intersection(one: Aperture, other: Aperture) -> BaseGeometry:
    """What lies in both. Raises as :func:`_checked` does, GeometryError where nothing does."""
    found = combined_on_grid(shapely.intersection, one.polygons, _checked(one, other).polygons)
    return _not_empty(found, "apertures that overlap", "two without any area in common")


def difference(one: Aperture, other: Aperture) -> BaseGeometry:
    """What lies in the first alone. Raises as :func:`_checked` does, GeometryError for nothing."""
    found = combined_on_grid(shapely.difference, one.polygons, _checked(one, other).polygons)
    return _not_empty(found, "one that the other does not cover", "one of which nothing is left")


def _checked(one: Aperture, other: Aperture) -> Aperture:
    """The second aperture, an outline; IlluminationError where it has a field of its own."""
    if other.illumination is not None and other.illumination != one.illumination:
        raise IlluminationError(
            "expected a second aperture without a field, which cuts the first, got one with "
            "another field; take it off by with_illumination(None)"
        )
    return other


def _not_empty(found: BaseGeometry, expected: str, got: str) -> BaseGeometry:
    if found.is_empty:
        raise GeometryError(f"expected {expected}, got {got}")
    return found
