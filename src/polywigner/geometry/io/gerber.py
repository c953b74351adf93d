"""Copper of one layer of a board in Gerber (RS-274X): objects that gerbonara reads, as polygons.

gerbonara passes over or mistakes statements that it does not know (step and repeat, blocks,
transformed apertures): they are refused first. Its places and parameters are used, not its drawing.
"""

from __future__ import annotations

import importlib
import math
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from polywigner.errors import FileFormatError
from polywigner.geometry.io.curves import Arc, Curve, flattened
from polywigner.geometry.io.drawing import Drawing, File, Format
from polywigner.geometry.io.limits import LARGEST_NUMBER, check_coordinates, text_of, token
from polywigner.geometry.io.outlines import filled
from polywigner.geometry.parts import combined_on_grid, polygons_in, union_on_grid
from polywigner.geometry.rings import rings_of_polygon
from polywigner.geometry.wavefront import turned_points

_PIECE = re.compile(r"\s*(?:(G0?4[^*]*)\*|%([^%]*)%|([^%*]*)\*)")
# A word of codes and numbers, which messages quote; of any other text they tell the length.
_PLAIN = re.compile(r"(?:[GDMXYIJ][-+.\d]{1,12}){1,6}", re.ASCII)
_NUMBER = r"[+-]?\d+"
_LENGTH = r"\+?(?:\d+\.?\d*|\.\d+)"
_NAME = r"[A-Za-z_.$][\w.$-]*"

_OPERATION = re.compile(
    rf"(?P<mode>G0?[123])?(?:X{_NUMBER})?(?:Y{_NUMBER})?"
    rf"(?P<centre>I{_NUMBER}(?:J{_NUMBER})?|J{_NUMBER})?D0?(?P<code>[123])"
)
_FORMAT = re.compile(r"FS[LT]A(X[1-7][1-7])Y(?P<same>[1-7][1-7])")
_SHAPE = re.compile(
    rf"ADD0*(?P<number>[1-9]\d{{1,8}})(?:[CRO],{_LENGTH}(?:X{_LENGTH})*|"
    rf"(?P<polygon>P),{_LENGTH}X\d+(?:X(?P<turn>[+-]?{_LENGTH}))?(?:X{_LENGTH})?|"
    rf"(?P<macro>{_NAME})(?:,[+-]?{_LENGTH}(?:X[+-]?{_LENGTH})*)?)"
)
_MACRO = re.compile(rf"AM(?P<name>{_NAME})\*(?P<body>.*)", re.DOTALL)
_MACRO_BLOCK = re.compile(r"(?:\$[1-9]\d*=|(?P<code>\d+),)[-+0-9.$xX/(),]+")
_MACRO_CODES = (1, 4, 5, 20, 21)
_STANDARD = ("C", "R", "O", "P")
# Before names of macros: gerbonara does not read those of one letter.
_PREFIX = "M_"

# Statements that change nothing: attributes, names, and transformations that are none.
_ZERO = r"[+-]?0*\.?0*"
_ONE = r"\+?0*1(?:\.0*)?"
_NEUTRAL = re.compile(
    r"T[FAOD].*|[IL]N.*|IPPOS|ASAXBY|MI(?:A0)?(?:B0)?|LMN|IR0+|SR|"
    rf"OF(?:A{_ZERO})?(?:B{_ZERO})?|SF(?:A{_ONE})?(?:B{_ONE})?|LR{_ZERO}|LS{_ONE}|"
    rf"SRX0*1Y0*1(?:I{_ZERO})?(?:J{_ZERO})?",
    re.DOTALL,
)
# What is refused, by how it begins, and what to do about it.
_REFUSED = {
    ("SR",): "step and repeat; export the board without panelling",
    ("AB", "LM", "LR", "LS"): "an aperture block or transformed apertures; export plain apertures",
    ("IP", "AS", "MI", "IR", "OF", "SF"): "a transformed image; export without transformations",
    ("IF",): "another file to include; export a single file",
    ("FS", "G91"): "coordinates that are not absolute, or not alike in x and y; export with %FSLA",
    ("X", "Y"): "coordinates without D01, D02 or D03, or not whole numbers; export it as RS-274X",
    ("",): "which is not read; export it anew as RS-274X",
}


@dataclass(eq=False)
class _State:
    """State of a Gerber file after the statements so far."""

    kept: list[str] = field(default_factory=list)
    unit: str = ""
    has_format: bool = False
    is_placed: bool = False
    in_region: bool = False
    quadrants: str = ""
    defined: set[str] = field(default_factory=set)
    is_ended: bool = False


def _checked_statements(text: str) -> tuple[str, str]:
    """Return the statements of a Gerber file that matter, and its unit "MM" or "IN"."""
    state = _State()
    for statement, is_extended in _statements(text):
        if state.is_ended:
            raise FileFormatError(
                f"expected nothing after M02, which ends a Gerber file, got {_shown(statement)}; "
                "give one layer in one file"
            )
        (_extended if is_extended else _word)(state, statement)
    if not state.is_ended:
        raise FileFormatError(
            "expected Gerber that ends with M02, got a file without; it may be cut short: "
            "export it anew"
        )
    if state.in_region:
        raise FileFormatError("expected G37 after each G36, got none; export it anew")
    return "\n".join(state.kept), state.unit


def _statements(text: str) -> Iterator[tuple[str, bool]]:
    """Each statement without its asterisk, and whether it stands between percent signs."""
    place = 0
    while found := _PIECE.match(text, place):
        place = found.end()
        comment, extended, word = found.groups()
        if extended is not None:
            whole = extended.strip()
            if not whole.endswith("*"):
                raise _unknown(whole)
            macro = whole.startswith("AM")
            for part in [whole] if macro else whole[:-1].split("*"):
                yield part.strip(), True
        elif comment is None and word.strip():
            yield re.sub(r"\s", "", word), False
    if text[place:].strip():
        raise FileFormatError(
            "expected Gerber statements that end with an asterisk, got text without one; "
            "the file may be cut short, or none of Gerber: export it anew"
        )


def _shown(statement: str) -> str:
    words = statement.strip()
    return repr(words) if _PLAIN.fullmatch(words) else token(words)


def _unknown(statement: str) -> FileFormatError:
    words = statement.strip()
    reason = next(why for starts, why in _REFUSED.items() if words.startswith(starts))
    return FileFormatError(f"expected one layer of plain Gerber, got {_shown(words)}: {reason}")


def _check(condition: bool, expected: str, statement: str) -> None:
    if not condition:
        raise FileFormatError(
            f"expected {expected}, got {_shown(statement)}; export it anew as RS-274X"
        )


def _word(state: _State, word: str) -> None:
    if found := _OPERATION.fullmatch(word):
        _operation(state, found)
    elif word in ("G36", "G37"):
        _check(state.in_region == (word == "G37"), "G36 and G37 by turns", word)
        state.in_region = word == "G36"
    elif word in ("G74", "G75"):
        state.quadrants = word
    elif word in ("G70", "G71"):
        agrees = state.unit == ("IN" if word == "G70" else "MM")
        _check(agrees, "one unit, by %MOMM*% or %MOIN*% first", word)
        return
    elif word == "G90":
        return
    elif re.fullmatch(r"M0?[02]", word):
        state.is_ended = True
    elif re.fullmatch(r"(?:G5[45])?D0*[1-9]\d{1,8}", word):
        number = word.partition("D")[2].lstrip("0")
        _check(number in state.defined, "an aperture that is defined", word)
    elif not re.fullmatch(r"G0?[123]", word):
        raise _unknown(word)
    state.kept.append(re.sub(r"^G(?=[123]\b|[123][XYIJD])", "G0", word) + "*")


def _operation(state: _State, found: re.Match[str]) -> None:
    word, code = found[0], found["code"]
    _check(bool(state.unit) and state.has_format, "%FS and %MO before coordinates", word)
    _check(code == "2" or state.is_placed or code == "3", "D02 before the first D01", word)
    _check(found["centre"] is None or code == "1", "I and J with D01 alone", word)
    if found["centre"]:
        _check(state.quadrants == "G75", "arcs after G75 (of up to a full turn)", word)
    state.is_placed = True


def _extended(state: _State, words: str) -> None:
    if words.startswith("AM"):
        words = _macro(state, words)
    elif found := _SHAPE.fullmatch(words):
        _define(state, found["number"], words)
        if found["macro"]:
            place = found.start("macro")
            words = words[:place] + _PREFIX + words[place:]
        if found["turn"] and float(found["turn"]):
            raise FileFormatError(
                f"expected regular polygons with a corner on the right, got {_shown(words)}, which "
                "is rotated; export it as a region"
            )
    elif found := _FORMAT.fullmatch(words):
        _check(not state.has_format, "one %FS", words)
        if found[1][1:] != found["same"]:
            raise _unknown(words)
        state.has_format = True
    elif words in ("MOMM", "MOIN"):
        _check(state.unit in ("", words[2:]), "one unit", words)
        if state.unit:
            return
        state.unit = words[2:]
    elif words in ("LPD", "LPC"):
        _check(not state.in_region, "no change of polarity between G36 and G37", words)
    elif _NEUTRAL.fullmatch(words):
        return
    else:
        raise _unknown(words)
    state.kept.append(f"%{words}*%")


def _define(state: _State, name: str, words: str) -> None:
    _check(bool(state.unit), "%MO before apertures", words)
    _check(name not in state.defined, "each aperture defined once", words)
    state.defined.add(name)


def _macro(state: _State, words: str) -> str:
    """The macro without comments and blanks, of primitives that are read alone."""
    found = _MACRO.fullmatch(words)
    if not found:
        raise _unknown(words)
    _check(found["name"] not in _STANDARD, "names of macros other than C, R, O and P", words)
    _define(state, found["name"], words)
    blocks = []
    for text in found["body"].split("*"):
        block = text.strip()
        if not block or re.match(r"0(?![\d,.])", block):
            continue
        block = re.sub(r"\s", "", block)
        plain = _MACRO_BLOCK.fullmatch(block)
        if not plain or (plain["code"] and int(plain["code"]) not in _MACRO_CODES):
            raise FileFormatError(
                "expected macros of circles, outlines, polygons and lines "
                f"(codes 1, 4, 5, 20, 21), got {_shown(block)}; export it as a region"
            )
        blocks.append(block)
    return f"AM{_PREFIX}{found['name']}*" + "*".join(blocks)


# What gerbonara warns about and yet reads as Gerber says.
_HARMLESS = ".*(Arc is missing|D01 interpolation with a zero-size)"


def _objects_of(text: str) -> list[Any]:
    """Objects of gerbonara in the order of the file; its warnings are errors, too."""
    library: Any = importlib.import_module("gerbonara.rs274x")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", message=_HARMLESS)
            return list(library.GerberFile.from_string(text).objects)
    except Exception as error:
        raise _unreadable(error) from None


def _unreadable(error: Exception) -> FileFormatError:
    # Numbers of lines are those of the checked text, not of the file.
    why = re.sub(r"^<unknown>:\d+ ", "", str(error.__cause__ or error).partition("\n")[0])
    return FileFormatError(
        f"expected Gerber that gerbonara reads, got: {why[:200].rstrip('.')}; export it anew"
    )


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


def _between(start: Any, end: Any, clockwise: bool, middle: Any) -> Arc:
    """The arc from `start` to `end` about a centre, which is moved to be as far from both."""
    one, other = np.asarray(start, float), np.asarray(end, float)
    centre = np.array(middle, float)
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

    def __init__(self, tolerance: float | None) -> None:
        self._tolerance = tolerance
        self._flashes: dict[int, BaseGeometry] = {}

    def of(self, thing: Any) -> Layers:
        """The polygons of one object of gerbonara."""
        kind = type(thing).__name__.lower()
        if kind != "region" and thing.aperture is None:
            raise FileFormatError(
                "expected an aperture before D01 and D03, got none; export it anew"
            )
        return [(bool(thing.polarity_dark), shape) for shape in getattr(self, f"_{kind}")(thing)]

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

    def _region(self, region: Any) -> list[BaseGeometry]:
        points = [tuple(point) for point in region.outline]
        if points[0] != points[-1]:
            x, y = points[0]
            raise FileFormatError(
                f"expected closed outlines of regions, got one from ({x:g}, {y:g}) that does not "
                "return; export it anew"
            )
        outline: list[Curve] = [
            _between(start, end, *arc) if arc else np.array([start, end], dtype=float)
            for start, end, arc in zip(points[:-1], points[1:], region.arc_centers, strict=True)
        ]
        return [self._polygon(outline)]

    def _flash(self, flash: Any) -> list[BaseGeometry]:
        number = id(flash.aperture)
        if number not in self._flashes:
            is_macro = hasattr(flash.aperture, "macro")
            layers = (self._macro if is_macro else self._standard)(flash.aperture)
            self._flashes[number] = composed(layers)
        place = np.array([flash.x, flash.y])
        check_coordinates(place)
        return [shapely.transform(self._flashes[number], lambda points: points + place)]

    def _standard(self, aperture: Any) -> Layers:
        kind, hole = type(aperture).__name__, aperture.hole_dia
        if kind == "CircleAperture":
            outline: list[Curve] = [_circle((0, 0), aperture.diameter / 2)]
        elif kind == "PolygonAperture":
            outline = _closed(_regular(aperture.n_vertices, aperture.diameter))
        elif kind == "RectangleAperture":
            outline = _closed(_rectangle(aperture.w, aperture.h))
        else:
            width = min(aperture.w, aperture.h)
            end = np.maximum(np.array([aperture.w, aperture.h]) - width, 0) / 2
            outline = _capsule(-end, end, width)
        layers = [(True, self._polygon(outline))]
        return [*layers, (False, self._polygon([_circle((0, 0), hole / 2)]))] if hole else layers

    def _macro(self, aperture: Any) -> Layers:
        bound = dict(enumerate(aperture.parameters, start=1))

        def value(expression: Any) -> float:
            try:
                return float(expression.calculate(bound, aperture.unit))
            except Exception as error:  # of an expression, gerbonara may raise any
                raise _unreadable(error) from None

        return [self._primitive(primitive, value) for primitive in aperture.macro.primitives]

    def _primitive(self, primitive: Any, value: Any) -> tuple[bool, BaseGeometry]:
        def values(*names: str) -> list[float]:
            return [value(getattr(primitive, name)) for name in names]

        exposure, degrees = values("exposure", "rotation")
        turn = math.radians(degrees)
        if exposure not in (0, 1):
            raise FileFormatError(
                f"expected macros with exposure 0 or 1, got {exposure:g}; export it as a region"
            )
        points: Any
        if primitive.code == 1:
            diameter, x, y = values("diameter", "x", "y")
            circle = _circle(turned_points(np.array([[x, y]]), turn)[0], diameter / 2)
            return bool(exposure), self._polygon([circle])
        if primitive.code == 4:
            points = [[value(x), value(y)] for x, y in primitive.points]
        elif primitive.code == 5:
            points = _regular(*values("n_vertices", "diameter")) + values("x", "y")
        elif primitive.code == 21:
            points = _rectangle(*values("width", "height")) + values("x", "y")
        else:
            start, end = np.reshape(values("start_x", "start_y", "end_x", "end_y"), (2, 2))
            (width,) = values("width")
            length = max(float(np.hypot(*(end - start))), np.finfo(float).tiny)
            side = width / 2 * np.array([start[1] - end[1], end[0] - start[0]]) / length
            points = [start - side, end - side, end + side, start + side]
        return bool(exposure), self._polygon(_closed(turned_points(np.array(points), turn)))

    def _pen(self, aperture: Any) -> list[float]:
        """Diameter of a round aperture, or width and height; any other draws no strokes."""
        sizes = {"CircleAperture": ("diameter",), "RectangleAperture": ("w", "h")}
        names = sizes.get(type(aperture).__name__)
        if names is None or aperture.hole_dia:
            raise FileFormatError(
                "expected strokes of round or rectangular apertures without a hole, got another; "
                "export it as a region"
            )
        return [getattr(aperture, name) for name in names]

    def _line(self, line: Any) -> list[BaseGeometry]:
        pen, start, end = self._pen(line.aperture), line.p1, line.p2
        if len(pen) == 1:
            return [self._convex(_capsule(start, end, pen[0]))]
        corners = [_rectangle(*pen) + point for point in (start, end)]
        return [shapely.convex_hull(shapely.MultiPoint(np.concatenate(corners)))]

    def _arc(self, arc: Any) -> list[BaseGeometry]:
        """A sector between two radii, and a disc at either end."""
        pen, start, end = self._pen(arc.aperture), arc.p1, arc.p2
        if len(pen) != 1:
            raise FileFormatError(
                "expected arcs of round apertures, got a rectangular one; export it as a region"
            )
        path, half = _between(start, end, arc.clockwise, arc.center), pen[0] / 2
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
    text, unit = _checked_statements(text_of(file.content))
    metres = _METRES.get(unit, 1e-3)
    shapes = Shapes(file.tolerance and file.tolerance / metres)
    copper = composed([layer for thing in _objects_of(text) for layer in shapes.of(thing)])
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
