"""The elements of a collection: what they may be, and how they lie in the plane z = 0."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, GeometryError
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits
from polywigner.illumination.waves import Illumination

__all__ = ["Element", "checked_elements", "in_plane", "placed"]

Element = Aperture | PlacedAperture | Polyhedron | Slits

# How far an element may lie off the plane z = 0, as a fraction of its diameter, and lean, in
# radians, and still be in it: what rounding does to a pose multiplied from several.
_IN_PLANE = 1e-12


def checked_elements(elements: Any) -> tuple[Element, ...]:
    expected = "expected a sequence of elements (Aperture, placed aperture, Polyhedron, Slits)"
    if isinstance(elements, Element):
        raise ArgumentError(f"{expected}, got one {type(elements).__name__}; put it into a list")
    try:
        found = tuple(elements)
    except TypeError:
        raise ArgumentError(f"{expected}, got {type(elements).__name__}") from None
    if not found:
        raise ArgumentError(f"{expected}, got none")
    for k, element in enumerate(found):
        if not isinstance(element, Element):
            nested = hasattr(element, "elements")  # an array, which cannot be imported here
            hint = "; join its elements and weights" if nested else ""
            raise ArgumentError(f"{expected}, got {type(element).__name__} at {k}{hint}")
    slits = [isinstance(element, Slits) for element in found]
    if any(slits) and not all(slits):
        raise ArgumentError(
            "expected elements of one space, got Slits (one dimension) and others; "
            "make rectangles of the slits with polywigner.shapes.rectangle"
        )
    return found


def placed(element: Element, pose: NDArray[np.float64]) -> Element:
    if isinstance(element, Aperture):
        return element.placed(pose)
    if isinstance(element, PlacedAperture):
        return element.aperture.placed(pose @ element.pose)
    if isinstance(element, Polyhedron):
        moved = element.vertices @ pose[:3, :3].T + pose[:3, 3]
        return Polyhedron(moved, element.faces)
    raise GeometryError("expected elements of the plane or of space to place, got Slits")


def in_plane(number: int, element: Element) -> Aperture:
    if isinstance(element, Aperture):
        return element
    advice = (
        "Wigner and ambiguity functions need all elements in the plane z = 0 "
        "(polywigner.fourier has the others)"
    )
    if not isinstance(element, PlacedAperture):
        raise GeometryError(
            f"expected elements of one plane, got {type(element).__name__} at {number}; {advice}"
        )
    rotation, shift = element.pose[:3, :3], element.pose[:3, 3]
    lean = float(np.arctan2(np.hypot(*rotation[:2, 2]), abs(rotation[2, 2])))
    if lean > _IN_PLANE:
        raise GeometryError(
            f"expected elements of one plane, got one that leans by {np.degrees(lean):.3g} degrees "
            f"at {number}; {advice}"
        )
    if abs(shift[2]) > _IN_PLANE * element.aperture.diameter:
        raise GeometryError(
            f"expected elements of one plane, got one at z = {shift[2]:.6g} at {number}; {advice}"
        )
    plane = rotation[:2, :2]
    outline = shapely.transform(element.aperture.polygons, lambda p: p @ plane.T + shift[:2])
    field = element.aperture.illumination
    if field is None:
        return Aperture(outline)
    turned = Illumination(field.amplitudes, field.frequencies @ plane.T)
    return Aperture(outline).with_illumination(turned.moved(shift[:2]))
