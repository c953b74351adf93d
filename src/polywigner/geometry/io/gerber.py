"""Copper of one layer of a board in Gerber (RS-274X): objects that gerbonara reads, as polygons."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from polywigner.errors import FileFormatError
from polywigner.geometry.io.curves import Arc, Curve, flattened, turned
from polywigner.geometry.io.drawing import Drawing, File, Format
from polywigner.geometry.io.gerber_statements import checked_statements, objects_of
from polywigner.geometry.io.limits import LARGEST_NUMBER, check_coordinates, text_of
from polywigner.geometry.io.outlines import filled
from polywigner.geometry.parts import combined_on_grid, polygons_in, union_on_grid
from polywigner.geometry.rings import rings_of_polygon

Layers = list[tuple[bool, BaseGeometry]]
"""Shapes one upon the other, each dark (adds) or clear (cuts)."""


def composed(layers: Iterable[tuple[bool, BaseGeometry]]) -> BaseGeometry:
    """Region left when dark shapes add and clear ones cut, in their order."""
    copper = np.array([], dtype=object)
    for dark, run in groupby(layers, key=lambda layer: layer[0]):
        shapes = [shape for _, shape in run if not shape.is_empty]
        if not shapes:
            continue
        if len(shapes) > 1:
            shapes = [union_on_grid(shapes)]
        # The polygons apart from these shapes stay as they are.
        near = shapely.intersects(copper, shapely.box(*shapely.total_bounds(shapes)))
        if near.any():
            found = _combined(dark, copper[near], shapes[0])
        else:
            found = shapes[0] if dark else shapely.MultiPolygon()
        copper = np.concatenate([copper[~near], np.array(polygons_in(found), dtype=object)])
    return copper[0] if len(copper) == 1 else shapely.MultiPolygon(list(copper))


def _combined(dark: bool, polygons: Any, shape: BaseGeometry) -> BaseGeometry:
    if dark:
        return union_on_grid([*polygons, shape])
    return combined_on_grid(shapely.difference, shapely.MultiPolygon(list(polygons)), shape)


# By which the two radii of an arc may differ, whose ends and centre are whole numbers.
_RADII = 1e-3


def _circle(centre: Any, radius: float) -> Arc:
    return _arc(np.asarray(centre, dtype=float), radius, 0.0, 2 * math.pi)


def _arc(centre: Any, radius: float, start: float, sweep: float) -> Arc:
    return Arc(centre, np.array([radius, 0.0]), np.array([0.0, radius]), start, sweep)


def _closed(points: Any) -> list[Curve]:
    array = np.asarray(points, dtype=float).reshape(-1, 2)
    return [np.concatenate([array, array[:1]])]


def _rectangle(width: float, height: float) -> Any:
    return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (width / 2, height / 2)


def _regular(count: float, diameter: float) -> Any:
    if count not in range(3, 13):
        raise FileFormatError(
            f"expected regular polygons of 3 to 12 corners, got {count:g}; export it anew"
        )
    angles = 2 * math.pi * np.arange(count) / count
    return diameter / 2 * np.column_stack([np.cos(angles), np.sin(angles)])


def _capsule(start: Any, end: Any, width: float) -> list[Curve]:
    """Region that a round aperture sweeps along a line."""
    one, other, radius = np.asarray(start, float), np.asarray(end, float), width / 2
    along = other - one
    length = float(np.hypot(*along))
    if length == 0:
        return [_circle(one, radius)]
    side = radius * np.array([along[1], -along[0]]) / length
    angle = math.atan2(side[1], side[0])
    return [
        np.array([one + side, other + side]), _arc(other, radius, angle, math.pi),
        np.array([other - side, one - side]), _arc(one, radius, angle + math.pi, math.pi),
    ]  # fmt: skip


def _between(start: Any, end: Any, told: Sequence[Any]) -> Arc:
    """The arc from `start` to `end` about a centre, which is moved to be as far from both."""
    one, other = np.asarray(start, float), np.asarray(end, float)
    clockwise, centre = told[0], np.array(told[1:], float)
    first, last = float(np.hypot(*(one - centre))), float(np.hypot(*(other - centre)))
    if not 0 < first < LARGEST_NUMBER or abs(first - last) > _RADII * first:
        raise FileFormatError(
            f"expected arcs with one radius, got {first:.6g} at the start and {last:.6g} at the "
            f"end around ({one[0]:.6g}, {one[1]:.6g}); export it anew with more digits"
        )
    if (one == other).all():
        sweep = 2 * math.pi
    else:
        chord = other - one
        centre = centre + chord * (np.dot((one + other) / 2 - centre, chord) / np.dot(chord, chord))
        first = float(np.hypot(*(one - centre)))
        turn = math.atan2(*(other - centre)[::-1]) - math.atan2(*(one - centre)[::-1])
        sweep = (-turn if clockwise else turn) % (2 * math.pi)
    angle = math.atan2(*(one - centre)[::-1])
    return _arc(centre, first, angle, -sweep if clockwise else sweep)


class Shapes:
    """Polygons of objects; curves stay within `tolerance` (in the file's unit, or None)."""

    def __init__(self, apertures: Sequence[Sequence[Any]], tolerance: float | None) -> None:
        self._apertures = apertures
        self._tolerance = tolerance
        self._flashes: dict[int, BaseGeometry] = {}

    def of(self, told: Sequence[Any]) -> Layers:
        """The polygons of one object of the file."""
        kind, dark, *rest = told
        return [(dark, shape) for shape in getattr(self, f"_{kind.lower()}")(*rest)]

    def _annulus(self, outer: Arc, inner: Arc) -> BaseGeometry:
        around, within = flattened([[outer], [inner]], self._tolerance)
        found = shapely.Polygon(around, [within])
        if shapely.is_valid(found):
            return found
        return composed([(True, self._wound(around)), (False, self._wound(within))])

    def _convex(self, outline: Sequence[Curve]) -> BaseGeometry:
        """The polygon of an outline that is convex, quicker than by winding."""
        ring = flattened([outline], self._tolerance)[0]
        found = shapely.Polygon(ring)
        return found if shapely.is_valid(found) else self._wound(ring)

    def _polygon(self, outline: Sequence[Curve]) -> BaseGeometry:
        return self._wound(flattened([outline], self._tolerance)[0])

    def _wound(self, ring: Any) -> BaseGeometry:
        polygons = [shapely.Polygon(p[0], p[1:]) for p in filled([ring], "nonzero")]
        return polygons[0] if len(polygons) == 1 else shapely.MultiPolygon(polygons)

    def _region(self, points: Sequence[Any], arcs: Sequence[Any]) -> list[BaseGeometry]:
        if points[0] != points[-1]:
            x, y = points[0]
            raise FileFormatError(
                f"expected closed outlines of regions, got one from ({x:g}, {y:g}) that does not "
                "return; export it anew"
            )
        outline: list[Curve] = [
            np.array([start, end], dtype=float) if arc is None else _between(start, end, arc)
            for start, end, arc in zip(points[:-1], points[1:], arcs, strict=True)
        ]
        return [self._polygon(outline)]

    def _flash(self, number: int, x: float, y: float) -> list[BaseGeometry]:
        if number not in self._flashes:
            kind, *values = self._apertures[number]
            layers = self._macro(*values) if kind == "macro" else self._standard(kind, values)
            self._flashes[number] = composed(layers)
        place = np.array([x, y])
        check_coordinates(place)
        return [shapely.transform(self._flashes[number], lambda points: points + place)]

    def _standard(self, kind: str, values: Sequence[Any]) -> Layers:
        *sizes, hole = values
        if kind == "CircleAperture":
            outline: list[Curve] = [_circle((0, 0), sizes[0] / 2)]
        elif kind == "PolygonAperture":
            outline = _closed(_regular(sizes[1], sizes[0]))
        elif kind == "RectangleAperture":
            outline = _closed(_rectangle(*sizes))
        else:
            width = min(sizes)
            end = np.maximum(np.array(sizes) - width, 0) / 2
            outline = _capsule(-end, end, width)
        layers = [(True, self._polygon(outline))]
        return [*layers, (False, self._polygon([_circle((0, 0), hole / 2)]))] if hole else layers

    def _macro(self, primitives: Sequence[Sequence[Any]]) -> Layers:
        return [self._primitive(*primitive) for primitive in primitives]

    def _primitive(self, code: int, exposure: float, *values: Any) -> tuple[bool, BaseGeometry]:
        if exposure not in (0, 1):
            raise FileFormatError(
                f"expected macros with exposure 0 or 1, got {exposure:g}; export it as a region"
            )
        *sizes, turn = values
        if code == 1:
            circle = _circle(turned(sizes[1:], turn), sizes[0] / 2)
            return bool(exposure), self._polygon([circle])
        if code == 4:
            points = sizes[0]
        elif code == 5:
            points = _regular(sizes[0], sizes[3]) + sizes[1:3]
        elif code == 21:
            points = _rectangle(*sizes[:2]) + sizes[2:]
        else:
            start, end = np.array(sizes[1:3]), np.array(sizes[3:])
            length = max(float(np.hypot(*(end - start))), np.finfo(float).tiny)
            side = sizes[0] / 2 * np.array([start[1] - end[1], end[0] - start[0]]) / length
            points = [start - side, end - side, end + side, start + side]
        return bool(exposure), self._polygon(_closed(turned(points, turn)))

    def _pen(self, number: int) -> list[float]:
        """Diameter of a round aperture, or width and height; any other draws no strokes."""
        kind, *values = self._apertures[number]
        if kind not in ("CircleAperture", "RectangleAperture") or values[-1]:
            raise FileFormatError(
                "expected strokes of round or rectangular apertures without a hole, got another; "
                "export it as a region"
            )
        return values[:-1]

    def _line(self, number: int, start: Any, end: Any) -> list[BaseGeometry]:
        pen = self._pen(number)
        if len(pen) == 1:
            return [self._convex(_capsule(start, end, pen[0]))]
        corners = [_rectangle(*pen) + point for point in (start, end)]
        return [shapely.convex_hull(shapely.MultiPoint(np.concatenate(corners)))]

    def _arc(self, number: int, start: Any, end: Any, told: Any) -> list[BaseGeometry]:
        """A sector between two radii, and a disc at either end."""
        pen = self._pen(number)
        if len(pen) != 1:
            raise FileFormatError(
                "expected arcs of round apertures, got a rectangular one; export it as a region"
            )
        path, half = _between(start, end, told), pen[0] / 2
        if half == 0:
            return []
        radius = float(path.u[0])
        outer = _arc(path.centre, radius + half, path.start, path.sweep)
        inner = _arc(path.centre, max(radius - half, 0), path.start + path.sweep, -path.sweep)
        if path.is_closed:
            return [self._annulus(outer, inner) if radius > half else self._convex([outer])]
        corners = [outer.at(np.array([path.start + path.sweep])), inner.at(np.array([inner.start])),
                   inner.at(np.array([path.start])), outer.at(np.array([path.start]))]  # fmt: skip
        sector: list[Curve] = [
            outer,
            np.concatenate(corners[:2]),
            inner,
            np.concatenate(corners[2:]),
        ]
        discs: list[list[Curve]] = [[_circle(point, half)] for point in (start, end)]
        return [self._polygon(sector), *map(self._convex, discs)]


_METRES = {"MM": 1e-3, "IN": 25.4e-3}


def read_gerber(file: File) -> Drawing:
    """Read the copper after all objects: dark ones add, clear ones cut, in the file's order."""
    text, unit = checked_statements(text_of(file.content))
    objects, apertures = objects_of(text)
    metres = _METRES.get(unit, 1e-3)
    shapes = Shapes(apertures, file.tolerance and file.tolerance / metres)
    copper = composed([layer for told in objects for layer in shapes.of(told)])
    polygons = [rings_of_polygon(polygon) for polygon in polygons_in(copper)]
    if not polygons:
        raise FileFormatError(
            "expected copper (regions, flashes or strokes that are dark), got none; give another "
            "layer of the board"
        )
    return Drawing(polygons, metres)


FORMATS = (
    Format(
        "Gerber", (".gbr", ".ger", ".gtl", ".gbl", ".art"), read_gerber,
        rb"G0?4|%(?:FS|MO|T[FA]|AM|AD|IN|LN|IP|AS|SF)|G7[015]\*", ("gerbonara.rs274x",),
    ),
)  # fmt: skip
