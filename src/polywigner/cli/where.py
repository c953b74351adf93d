"""Places as commands are given them: texts to lines, planes and boxes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import NamedTuple

from polywigner.errors import ArgumentError, QuantityError
from polywigner.quantities import parse_angle, parse_coordinate, parse_length

Point = tuple[float, float, float]

_LONGEST = 200
_WIDEST = 80.0  # degrees from the axis, of an arc that does not say
_GRAZING = math.radians(89.5)  # of a hemisphere, as where suggested samples end
_MOST_POINTS = 1 << 26  # half a gigabyte for each method
_DIMENSIONS = {"line": 1, "arc": 1, "plane": 2, "hemisphere": 2}


class Place(NamedTuple):
    """Where a field is wanted: of a line ``points``; of an arc or hemisphere lists of angles.

    ``kind`` is "line", "arc", "plane" or "hemisphere"; ``shape`` is empty where nothing was said.
    """

    kind: str
    points: tuple[Point, ...]
    shape: tuple[int, ...]
    radius: float = 0.0
    phi: float = 0.0
    reach: float = 0.0


def place_text(place: Place) -> str:
    """Where a field is, as a picture says it."""
    from polywigner.figures.style import number_text
    from polywigner.geometry.display import length_unit

    values = [abs(value) for point in place.points for value in point]
    unit = length_unit(max(values, default=place.radius))

    def printed(*lengths: float) -> str:
        return ", ".join(number_text(float(f"{x / unit.metres:.4g}")) for x in lengths)

    if place.kind == "line":
        start, end = (f"({printed(*point)})" for point in place.points)
        return f"line from {start} to {end} {unit.name}"
    if place.kind == "plane":
        first, last = place.points
        fixed = next(k for k in range(3) if first[k] == last[k])
        return f"plane {'xyz'[fixed]} = {printed(first[fixed])} {unit.name}"
    cut = f", φ = {number_text(float(f'{math.degrees(place.phi):.4g}'))}°"
    return f"{place.kind} of radius {printed(place.radius)} {unit.name}" + (
        cut if place.kind == "arc" else ""
    )


def parse_place(texts: Mapping[str, str | None], samples: str | None) -> Place:
    """The one place among the texts of ``line``, ``arc``, ``plane`` and ``hemisphere``.

    Raises
    ------
    ArgumentError without one, for several, and for numbers of samples that are none; QuantityError
    for a text that says no such place. The message begins with the option.
    """
    given = {name: text for name, text in texts.items() if text is not None}
    if len(given) != 1:
        got = " and ".join(f"--{name}" for name in given) or "none"
        raise ArgumentError(
            f"expected one of {', '.join(f'--{name}' for name in texts)}, got {got}; say where the "
            "field is wanted"
        )
    ((kind, text),) = given.items()
    shape = () if samples is None else parse_shape("--samples", samples, _DIMENSIONS[kind])
    if shape and min(shape) < 2:
        raise ArgumentError(
            f"--samples: expected two or more along each axis, got {shown(str(samples))}; "
            "one point makes no picture"
        )
    if math.prod(shape) > _MOST_POINTS:
        raise ArgumentError(
            f"--samples: expected at most {_MOST_POINTS} points, got {math.prod(shape)}; use "
            "`polywigner volume`, which writes to disk"
        )
    try:
        return _PARSERS[kind](text, shape)
    except QuantityError as error:
        raise QuantityError(f"--{kind}: {error}") from None


def _line(text: str, shape: tuple[int, ...]) -> Place:
    ends = _split(text, r"\s+to\s+")
    if len(ends) != 2:
        raise QuantityError(
            'expected two points such as "0 mm, 0 mm, 2 mm to 0 mm, 0 mm, 150 mm", got '
            f"{shown(text)}"
        )
    return Place("line", tuple(_point(end) for end in ends), shape)


def _arc(text: str, shape: tuple[int, ...]) -> Place:
    parts = _split(text, ",")
    if not 1 <= len(parts) <= 3:
        raise QuantityError(
            'expected a distance such as "50 mm", and perhaps two angles, as in "50 mm, 45 deg, '
            f'80 deg", got {shown(text)}'
        )
    phi, reach = (parse_angle(a) for a in (*parts[1:], "0 deg", f"{_WIDEST:g} deg")[:2])
    if len(parts) == 2:
        reach = math.radians(_WIDEST)
    if not 0 < reach < math.pi / 2:
        raise QuantityError(
            f"expected a largest angle between 0 and 90 deg, got {shown(text)}; write degrees "
            'with their unit, such as "80 deg"'
        )
    return Place("arc", (), shape, _length(parse_length(parts[0]), parts[0]), phi, reach)


def _plane(text: str, shape: tuple[int, ...]) -> Place:
    low, high, ranges = _ranges(text)
    if ranges != 2:
        raise QuantityError(
            'expected two ranges and a coordinate such as "-30 mm to 30 mm, -30 mm to 30 mm, '
            f'90 mm", got {shown(text)}'
        )
    return Place("plane", (low, high), shape)


def _hemisphere(text: str, shape: tuple[int, ...]) -> Place:
    return Place("hemisphere", (), shape, _length(parse_length(text), text), 0.0, _GRAZING)


_PARSERS = {"line": _line, "arc": _arc, "plane": _plane, "hemisphere": _hemisphere}


def parse_box(text: str) -> tuple[Point, Point]:
    """The lowest and the highest corner of a box given by three ranges.

    Raises
    ------
    QuantityError for anything else.
    """
    try:
        low, high, ranges = _ranges(text)
        if ranges != 3:
            raise QuantityError(
                'expected three ranges such as "-30 mm to 30 mm, -30 mm to 30 mm, 2 mm to 120 mm", '
                f"got {shown(text)}"
            )
    except QuantityError as error:
        raise QuantityError(f"--box: {error}") from None
    return low, high


def _ranges(text: str) -> tuple[Point, Point, int]:
    """Both ends along x, y and z, and how many of them differ."""
    parts = _split(text, ",")
    if len(parts) != 3:
        raise QuantityError(f"expected x, y and z, separated by commas, got {shown(text)}")
    ends = []
    for part in parts:
        ends.append([_length(parse_coordinate(e), e) for e in _split(part, r"\s+to\s+")])
        if len(ends[-1]) > 2 or (len(ends[-1]) == 2 and not ends[-1][0] < ends[-1][1]):
            raise QuantityError(
                f'expected a coordinate, or a rising range such as "-30 mm to 30 mm", got '
                f"{shown(part)}"
            )
    low = (ends[0][0], ends[1][0], ends[2][0])
    high = (ends[0][-1], ends[1][-1], ends[2][-1])
    return low, high, sum(len(pair) for pair in ends) - 3


def parse_shape(option: str, text: str, dimensions: int) -> tuple[int, ...]:
    """Whole numbers above zero, as many as dimensions: ``"64 x 64 x 96"``.

    Raises
    ------
    ArgumentError for anything else.
    """
    parts = _split(text, "[x×]")
    if len(parts) != dimensions or not all(re.fullmatch(r"0*[1-9][0-9]{0,8}", p) for p in parts):
        example = " x ".join(("64", "64", "96")[:dimensions])
        raise ArgumentError(f'{option}: expected samples such as "{example}", got {shown(text)}')
    return tuple(int(part) for part in parts)


def parse_levels(option: str, text: str) -> tuple[float, ...]:
    """Numbers of decibels, separated by commas, with or without "dB".

    Raises
    ------
    QuantityError for anything else.
    """
    levels = []
    for part in _split(text, ","):
        match = re.fullmatch(r"([+-]?[0-9]{1,4}(?:\.[0-9]{0,6})?)(?:\s*dB)?", part)
        if match is None:
            raise QuantityError(
                f'{option}: expected levels such as "-6, -12, -18", got {shown(text)}'
            )
        levels.append(float(match[1]))
    return tuple(levels)


def _point(text: str) -> Point:
    parts = _split(text, ",")
    if len(parts) != 3:
        raise QuantityError(f'expected a point such as "0 mm, 0 mm, 80 mm", got {shown(text)}')
    x, y, z = (_length(parse_coordinate(part), part) for part in parts)
    return x, y, z


def _length(length: float, text: str) -> float:
    """One that grids take."""
    from polywigner.propagation.places import LARGEST

    if not abs(length) <= LARGEST:
        raise QuantityError(f"expected lengths of at most {LARGEST:g} m, got {shown(text)}")
    return length


def _split(text: str, pattern: str) -> list[str]:
    if len(text) > _LONGEST:
        raise QuantityError(f"expected up to {_LONGEST} characters, got {shown(text)}")
    return [part.strip() for part in re.split(pattern, text)]


def shown(text: str) -> str:
    """A text as messages quote it: in ASCII, and not without end."""
    return ascii(text) if len(text) <= _LONGEST else ascii(text[:_LONGEST]) + "..."
