"""Reader of the copper of one board layer in a Gerber file (RS-274X), parsed by gerbonara.

Statements that gerbonara would misread, such as step and repeat, raise an error.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from importlib import import_module
from itertools import groupby
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.illumination import turned_points
from polywigner.geometry.io.limits import check_coordinates, text_of
from polywigner.geometry.io.outlines import (
    Arc,
    Curve,
    Drawing,
    File,
    Points,
    allowed_distance,
    chords,
    filled,
    flattened,
)
from polywigner.geometry.parts import combined_on_grid, polygons_in, union_on_grid
from polywigner.geometry.rings import rings_of_polygon

_METRES = {"MM": 1e-3, "IN": 25.4e-3}

_PIECE = re.compile(r"\s*(?:G0?4[^*]*\*|%([^%]*)\*\s*%|([^%*]*)\*)")
_NUMBER = r"[+-]?\d+"
_LENGTH = r"\+?(?:\d+\.?\d*|\.\d+)"
_NAME = r"(?![CROP](?![\w.$-]))[A-Za-z_.$][\w.$-]*"

# Pattern of accepted macro blocks. gerbonara misreads other exposures, and does not rotate the
# centres of polygons.
_BLOCK = (
    r"\s*(?:(?:\$[1-9]\d*=|0*(?:1|4|20|21),\s*[01],|0*5,\s*[01],[^,*]+,\s*0,\s*0,)"
    r"[-+0-9.$xX/(),\s]+)?"
)
_STATEMENT = re.compile(
    rf"(?:G0?[123])?(?:X{_NUMBER})?(?:Y{_NUMBER})?"
    rf"(?:D0?[123]|(?:I{_NUMBER}(?:J{_NUMBER})?|J{_NUMBER})D0?1)"
    r"|G0?[123]|G3[67]|G7[45]|(?:G5[45])?D0*[1-9]\d{1,8}|M0?[02]"
    r"|%FS[LT]AX([1-7][1-7])Y\1|%MO(?P<unit>MM|IN)|%LP[DC]"
    rf"|%ADD0*[1-9]\d{{1,8}}(?:[CRO],{_LENGTH}(?:X{_LENGTH})*"
    rf"|P,{_LENGTH}X0*(?:[3-9]|1[0-2])(?:X0*\.?0*(?:X{_LENGTH})?)?"
    rf"|{_NAME}(?:,[+-]?{_LENGTH}(?:X[+-]?{_LENGTH})*)?)"
    rf"|%AM{_NAME}\*{_BLOCK}(?:\*{_BLOCK})*"
)
# Pattern of statements without effect on the copper: attributes, names, and identity
# transformations.
_NEUTRAL = re.compile(
    r"G90|%(?:T[FAOD].*|[IL]N.*|IPPOS|ASAXBY|MIA0B0|LMN|IR0|SR(?:X1Y1I0J0)?|"
    r"OFA0(?:\.0*)?B0(?:\.0*)?|SFA1(?:\.0*)?B1(?:\.0*)?|LR0(?:\.0*)?|LS1(?:\.0*)?)",
    re.DOTALL,
)
# Pattern of warnings about statements that gerbonara reads correctly.
_HARMLESS = ".*(Arc is missing|D01 interpolation with a zero-size)"
# Largest relative difference between the radii at the ends of an arc, due to rounded coordinates.
_RADII = 1e-3

Layers = Iterable[tuple[bool, BaseGeometry]]
"""Shapes in the order of drawing. A dark shape (True) adds copper, a clear shape removes copper."""


def _refusal(expected: str, got: str, advice: str = "export the layer again") -> FileFormatError:
    """Return a FileFormatError with the message "expected ..., got ...; advice"."""
    return FileFormatError(f"expected {expected}, got {got}; {advice}")


def _statements(text: str) -> Iterator[tuple[str, int]]:
    """Yield each statement, without its asterisk, and its line number.

    Extended statements begin with a percent sign.
    """
    position, line = 0, 1
    while match := _PIECE.match(text, position):
        extended, word = match.groups()
        if word:
            yield re.sub(r"\s", "", word), line
        elif extended:
            macro = extended.lstrip().startswith("AM")
            for part in [extended] if macro else extended.split("*"):
                yield "%" + part.strip(), line
        position, line = match.end(), line + match[0].count("\n")
    if text[position:].strip():
        raise _refusal(
            "statements that end with an asterisk", "text without an asterisk",
            "check whether the file is complete and is a Gerber file",
        )  # fmt: skip


def _checked_statements(text: str) -> tuple[str, str]:
    """Return a Gerber file's statements in a form that gerbonara accepts, and its unit.

    The unit is "MM" or "IN".

    Raises FileFormatError for unsupported statements and missing units.
    """
    statements: list[str] = []
    unit = ""
    for statement, line in _statements(text):
        same_unit = {"MM": ("%MOMM", "G71"), "IN": ("%MOIN", "G70")}.get(unit, ())
        if _NEUTRAL.fullmatch(statement) or statement in same_unit:
            continue
        comments = r"(?<=\*)\s*0(?![\d,.])[^*]*"
        statement = re.sub(comments, "", statement) if statement.startswith("%AM") else statement
        match = _STATEMENT.fullmatch(statement)
        if match is None:
            raise _refusal(
                "plain RS-274X", f"an unsupported statement in line {line}",
                "export the layer without panels, blocks, transformations and unusual macros",
            )  # fmt: skip
        unit = match["unit"] or unit
        # gerbonara accepts neither one-letter names nor G1 in place of G01, so both are rewritten.
        statement = re.sub(rf"^(%AM|%ADD\d+)(?={_NAME})", r"\1M_", statement)
        statement = re.sub(r"^G(?=[123](?:[XYIJD]|$))", "G0", statement)
        statements.append(statement + "*%\n" if statement[0] == "%" else statement + "*\n")
    regions = [words[:3] for words in statements if words in ("G36*\n", "G37*\n")]
    # gerbonara silently drops regions without G37, so they raise an error here.
    if regions != ["G36", "G37"] * (len(regions) // 2):
        raise _refusal("each G36 to be followed by G37", "another sequence")
    checked = "".join(statements)
    if not unit or "%FS" not in checked:
        raise _refusal(
            "the statements %FS and %MO before coordinates and apertures",
            "a file without both statements",
        )
    return checked, unit


def _objects_of(text: str) -> list[Any]:
    """Return gerbonara's graphical objects in the file's unit; raise its warnings as exceptions."""
    library: Any = import_module("gerbonara.rs274x")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=_HARMLESS)
        return list(library.GerberFile.from_string(text).objects)


def _copper(layers: Layers) -> BaseGeometry:
    """Return the copper that remains after all dark (additive) and clear (subtractive) shapes."""
    copper = np.array([], dtype=object)
    for dark, run in groupby(layers, key=lambda layer: layer[0]):
        shapes = [polygon for _, shape in run for polygon in polygons_in(shape)]
        if not shapes:
            continue
        changed = union_on_grid(shapes)
        # Only polygons near the shapes are updated, so that files with many polarity changes are
        # fast.
        is_near = shapely.intersects(copper, shapely.box(*changed.bounds))
        near = list(copper[is_near])
        if dark:
            changed = union_on_grid([*near, *polygons_in(changed)])
        elif near:
            changed = combined_on_grid(shapely.difference, shapely.MultiPolygon(near), changed)
        else:
            continue
        copper = np.append(copper[~is_near], np.array(polygons_in(changed), dtype=object))
    return shapely.MultiPolygon(list(copper))


def _circle(centre: Any, radius: float, start: float = 0.0, sweep: float = 2 * math.pi) -> Arc:
    """Return an arc of a circle, by default the full circle; angles are in radians."""
    u, v = radius * np.eye(2)
    return Arc(np.asarray(centre, dtype=float), u, v, start, sweep)


def _arc_between(start: Any, end: Any, clockwise: bool, about: Any) -> Arc:
    """Return the circular arc between two points about a centre.

    All coordinates are absolute. The centre is moved to equal distances from both points. If the
    points are equal, the arc is a full circle. Raises FileFormatError if the distances differ too
    much.
    """
    first_end, last_end, centre = np.array([start, end, about], dtype=float)
    first, last = np.hypot(*(first_end - centre)), np.hypot(*(last_end - centre))
    if not 0 < first < math.inf or abs(first - last) > _RADII * first:
        raise _refusal(
            "arcs with one radius", f"the radius {first:.6g} at the start and {last:.6g} at the end"
        )
    chord = last_end - first_end
    if chord.any():
        midpoint = (first_end + last_end) / 2
        centre = centre + chord * ((midpoint - centre) @ chord / (chord @ chord))
    begin, stop = (math.atan2(y, x) for x, y in (first_end - centre, last_end - centre))
    sweep = (begin - stop if clockwise else stop - begin) % (2 * math.pi) or 2 * math.pi
    radius = float(np.hypot(*(first_end - centre)))
    return _circle(centre, radius, begin, -sweep if clockwise else sweep)


def _corners(rectangle: Any) -> Points:
    """Return the counter-clockwise corners (4, 2) of a rotated rectangle of gerbonara."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (rectangle.w / 2, rectangle.h / 2)
    return turned_points(corners, rectangle.rotation) + np.array([rectangle.x, rectangle.y])


def _hull(outlines: Sequence[Points]) -> BaseGeometry:
    """Return the convex hull of the vertices of several outlines."""
    return shapely.convex_hull(shapely.MultiPoint(np.concatenate(outlines)))


class _Converter:
    """Converter of graphical objects of gerbonara to polygons; caches flashed apertures."""

    def __init__(self, tolerance: float | None) -> None:
        self._tolerance = tolerance
        self._flashes: dict[int, BaseGeometry] = {}

    def layers(self, item: Any) -> Layers:
        """Yield pairs (whether the shape adds copper, shape) for a graphical object.

        A shape that does not add copper removes it. Raises FileFormatError for unsupported objects.
        """
        kind = type(item).__name__
        if kind == "Region":
            shapes = [self._region(item)]
        elif item.aperture is None:
            raise _refusal("an aperture before the first D01 or D03", "none")
        elif kind == "Flash":
            shapes = [self._flash(item)]
        else:
            shapes = self._stroke(item, kind)
        for shape in shapes:
            yield bool(item.polarity_dark), shape

    def _polygon(self, outline: Sequence[Curve]) -> BaseGeometry:
        """Return the polygons inside a closed outline of curves, by the nonzero rule."""
        rings = flattened([outline], self._tolerance)
        return shapely.MultiPolygon([(outer, holes) for outer, *holes in filled(rings, "nonzero")])

    def _round_stroke(self, start: Any, end: Any, width: float) -> BaseGeometry:
        """Return the area of a straight stroke with round ends."""
        ends = np.array([start, end], dtype=float)
        along = ends[1] - ends[0]
        if not along.any():
            return self._polygon([_circle(ends[0], width / 2)])
        # Half circles have vertices where the straight sides begin.
        half = _circle((0, 0), width / 2, math.atan2(along[1], along[0]) + math.pi / 2, math.pi)
        discs = [_circle(end, width / 2) for end in ends]
        side = chords(half, allowed_distance(discs, self._tolerance))
        return _hull([ends[1] - side, ends[0] + side])

    def _primitive(self, primitive: Any) -> BaseGeometry:
        """Return the area of a primitive (circle, line, rectangle or polygon) of an aperture."""
        kind, p = type(primitive).__name__, primitive
        if kind == "Circle":
            return self._polygon([_circle((p.x, p.y), p.r)])
        if kind == "Line":
            return self._round_stroke((p.x1, p.y1), (p.x2, p.y2), p.width)
        points = np.array(p.outline) if kind == "ArcPoly" else _corners(p)
        return self._polygon([np.concatenate([points, points[:1]])])

    def _region(self, region: Any) -> BaseGeometry:
        """Return the area of a region; raise FileFormatError if its outline is open."""
        points = [tuple(point) for point in region.outline]
        if points[0] != points[-1]:
            x, y = points[0]
            raise _refusal(
                "closed region outlines", f"an open outline that starts at ({x:g}, {y:g})"
            )
        sides = zip(points[:-1], points[1:], region.arc_centers, strict=True)
        outline: list[Curve] = [
            _arc_between(start, end, *arc) if arc else np.array([start, end])
            for start, end, arc in sides
        ]
        return self._polygon(outline)

    def _flash(self, flash: Any) -> BaseGeometry:
        """Return the area of an aperture that is flashed at a position."""
        number, position = id(flash.aperture), np.array([flash.x, flash.y])
        check_coordinates(position)
        if number not in self._flashes:
            primitives = flash.aperture.flash(0.0, 0.0, flash.aperture.unit)
            self._flashes[number] = _copper(
                (primitive.polarity_dark, self._primitive(primitive)) for primitive in primitives
            )
        return shapely.transform(self._flashes[number], lambda points: points + position)

    def _stroke(self, stroke: Any, kind: str) -> list[BaseGeometry]:
        """Return polygons that together cover a line or an arc drawn with an aperture.

        ``kind``: "Line" or "Arc". Raises FileFormatError unless the aperture is round, or
        rectangular for a line.
        """
        pen = stroke.aperture
        is_round = hasattr(pen, "diameter")
        if pen.hole_dia or (kind == "Arc" and not is_round):
            raise _refusal(
                "lines drawn with round or rectangular apertures without holes, or arcs "
                "drawn with round apertures",
                "strokes with other apertures",
                "export the strokes as regions",
            )
        if kind == "Line" and is_round:
            return [self._round_stroke(stroke.p1, stroke.p2, pen.diameter)]
        if kind == "Line":
            ends = (stroke.p1, stroke.p2)
            return [_hull([_corners(next(iter(pen.flash(*end, pen.unit)))) for end in ends])]
        path = _arc_between(stroke.p1, stroke.p2, stroke.clockwise, stroke.center)
        half = pen.diameter / 2
        radius, start, sweep = path.semi_major_axis, path.start, path.sweep
        outer = _circle(path.centre, radius + half, start, sweep)
        inner = _circle(path.centre, max(radius - half, 0.0), start + sweep, -sweep)
        if path.is_closed:
            ring, hole = flattened([[outer], [inner]], self._tolerance)
            return [shapely.Polygon(ring, [hole] if radius > half else [])]
        (begin, stop), (back, first) = outer.at(np.arange(2.0)), inner.at(np.arange(2.0))
        sector: list[Curve] = [outer, np.array([stop, back]), inner, np.array([first, begin])]
        discs = [self._polygon([_circle(end, half)]) for end in (stroke.p1, stroke.p2)]
        return [self._polygon(sector), *discs]


def load_gerber(file: File) -> Drawing:
    """Load the copper of a layer from a Gerber file."""
    text, unit = _checked_statements(text_of(file.content))
    metres = _METRES[unit]
    converter = _Converter(file.tolerance and file.tolerance / metres)
    try:
        copper = _copper(layer for item in _objects_of(text) for layer in converter.layers(item))
    except (PolywignerError, ImportError):
        raise
    # gerbonara does not document its exceptions, so all exceptions are caught.
    except Exception as error:
        # gerbonara's line numbers are removed, because they refer to the rewritten statements.
        why = re.sub(r"^<unknown>:\d+ ", "", str(error.__cause__ or error).partition("\n")[0])
        raise _refusal("a Gerber file that gerbonara can read", why[:200].rstrip(".")) from None
    polygons = [rings_of_polygon(polygon) for polygon in polygons_in(copper)]
    if not polygons:
        raise FileFormatError(
            "the layer contains no copper (dark regions, flashes or strokes); choose another "
            "layer of the board"
        )
    return Drawing(polygons, metres)
