"""The shapes of an SVG file as closed curves, and the viewports they stand in."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polywigner.errors import FileFormatError
from polywigner.geometry.formats.curves import Arc, Curve, Points, ends, transformed
from polywigner.geometry.formats.limits import LARGEST_NUMBER
from polywigner.geometry.formats.svg_style import Style
from polywigner.geometry.formats.svg_values import closed, length, numbers_of, subpaths_of

__all__ = ["SHAPES", "Place", "Shape", "corner", "fitted", "shape_of", "view_box"]

SHAPES = frozenset({"path", "rect", "circle", "ellipse", "polygon", "polyline"})
"""The elements with an inside."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where an element stands: the map to the picture, styles and the size of 100 %."""

    matrix: Points
    offset: Points
    style: Style
    viewport: tuple[float | None, float | None]
    depth: int = 0
    layer: str = ""
    """The name of the group around it."""
    is_asked: bool = True
    """Whether it lies on a layer that is read."""
    unchecked: tuple[tuple[Style, str], ...] = ()
    """Styles and tags around it that matter only if it is."""

    def moved(self, matrix: Points, offset: Points) -> Place:
        return replace(self, matrix=matrix @ self.matrix, offset=offset @ self.matrix + self.offset)


@dataclass(frozen=True, eq=False)
class Shape:
    subpaths: list[list[Curve]]
    rule: str
    layer: str


def view_box(element: Any) -> tuple[float, float, float, float] | None:
    text = element.get("viewBox")
    if text is None:
        return None
    values = numbers_of(text, "the viewBox")
    sizes = len(values) == 4 and all(1 / LARGEST_NUMBER < v < LARGEST_NUMBER for v in values[2:])
    if not sizes or not all(map(math.isfinite, values)):
        raise FileFormatError(
            f"expected a viewBox of four numbers, the last two above zero, got {text[:60]!r}"
        )
    return values[0], values[1], values[2], values[3]


def fitted(
    fit: str, box: tuple[float, float, float, float], size: tuple[float, float]
) -> tuple[Points, Points]:
    """Scale and shift that put a viewBox into a viewport of this size."""
    x, y, width, height = box
    scale = np.array([size[0] / width, size[1] / height])
    words = fit.split() or ["xMidYMid"]
    align = next((word for word in words if word not in ("defer", "meet", "slice")), "xMidYMid")
    if align != "none":
        scale[:] = scale.max() if "slice" in words else scale.min()
    spare = np.array(size) - scale * (width, height)
    shares = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}
    share = [shares.get(align[1:4], 0.5), shares.get(align[5:8], 0.5)]
    return scale, share * spare - scale * (x, y)


def corner(element: Any, place: Place) -> Points:
    return np.array([_length(element, name, place, k) for k, name in enumerate("xy")])


def _attribute(element: Any, name: str, place: Place) -> str | None:
    """An attribute that tells the geometry; in SVG 2 a style may set it, and is the stronger."""
    text: str | None = place.style.own.get(name, element.get(name))
    return text


def _length(element: Any, name: str, place: Place, axis: int | None) -> float:
    """A length in user units; 0 where it is missing. `axis` None: of the mean size."""
    text = _attribute(element, name, place)
    if text is None:
        return 0.0
    width, height = place.viewport
    reference = place.viewport[axis] if axis is not None else None
    if axis is None and width is not None and height is not None:
        reference = math.hypot(width, height) / math.sqrt(2)
    return length(text, f"the {name} of an element", reference)


def shape_of(element: Any, tag: str, place: Place) -> Shape:
    if tag == "path":
        subpaths = subpaths_of(_attribute(element, "d", place) or "")
    elif tag in ("polygon", "polyline"):
        subpaths = _polygon(element)
    elif tag == "rect":
        subpaths = _rectangle(element, place)
    else:
        subpaths = _ellipse(element, tag, place)
    image = [
        [transformed(curve, place.matrix, place.offset) for curve in subpath]
        for subpath in subpaths
    ]
    return Shape(image, place.style.inherited.get("fill-rule", "nonzero"), place.layer)


def _polygon(element: Any) -> list[list[Curve]]:
    values = numbers_of(element.get("points", ""), "the points")
    if len(values) % 2:
        raise FileFormatError("expected points as pairs of numbers, got an odd number of them")
    return [closed([np.array(values).reshape(-1, 2)])] if len(values) >= 4 else []


def _size(element: Any, name: str, place: Place, axis: int | None) -> float:
    value = _length(element, name, place, axis)
    if value < 0:
        raise FileFormatError(f"expected the {name} of an element from zero up, got {value:g}")
    return value


def _ellipse(element: Any, tag: str, place: Place) -> list[list[Curve]]:
    centre = np.array([_length(element, name, place, k) for k, name in enumerate(("cx", "cy"))])
    if tag == "circle":
        radii = [_size(element, "r", place, None)] * 2
    else:
        rx, ry = (_radius(element, name, place, k) for k, name in enumerate(("rx", "ry")))
        radii = [rx if rx is not None else ry or 0.0, ry if ry is not None else rx or 0.0]
    if not all(radii):
        return []
    u, v = np.diag(radii)
    return [[Arc(centre, u, v, 0.0, 2 * math.pi)]]


def _radius(element: Any, name: str, place: Place, axis: int) -> float | None:
    """A radius that may be missing or "auto"."""
    missing = (_attribute(element, name, place) or "auto").strip() == "auto"
    return None if missing else _size(element, name, place, axis)


def _rectangle(element: Any, place: Place) -> list[list[Curve]]:
    x, y = corner(element, place)
    width, height = _size(element, "width", place, 0), _size(element, "height", place, 1)
    if not width or not height:
        return []
    rx, ry = (_radius(element, name, place, k) for k, name in enumerate(("rx", "ry")))
    rx, ry = (rx if rx is not None else ry or 0.0), (ry if ry is not None else rx or 0.0)
    rx, ry = min(rx, width / 2), min(ry, height / 2)
    corners = np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])
    if not rx or not ry:
        return [closed([corners])]
    outline: list[Curve] = []
    inward = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (rx, ry)
    for k, centre in enumerate(corners + inward):
        arc = Arc(
            centre, np.array([rx, 0.0]), np.array([0.0, ry]), (k - 2) * math.pi / 2, math.pi / 2
        )
        start = arc.at(np.array([arc.start]))[0]
        if outline:
            outline.append(np.array([ends(outline[-1])[1], start]))
        outline.append(arc)
    return [closed(outline)]
