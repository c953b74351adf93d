"""Numbers, texts and tables of a source file, checked.

Whatever raises inside of `at(place)` says where in the file it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.quantities import (
    parse_angle,
    parse_coordinate,
    parse_decibels,
    parse_frequency,
    parse_length,
)

__all__ = [
    "Table",
    "angle",
    "at",
    "checked_list",
    "checked_table",
    "complex_numbers",
    "coordinates",
    "decibels",
    "drawing_options",
    "flag",
    "frequency",
    "length",
    "number",
    "numbers",
    "radius_of",
    "text",
    "whole",
]

Table = Mapping[str, Any]

# Polygons are lists (1) of rings (2) of vertices (3) of coordinates (4).
_DEEPEST = 4
_LONGEST_SHOWN = 60


@contextmanager
def at(place: str) -> Iterator[None]:
    """Put the place in front of the message of what is raised inside."""
    try:
        yield
    except PolywignerError as error:
        raise type(error)(f"{place}: {error}") from None


def checked_table(value: Any, required: Collection[str], optional: Collection[str] = ()) -> Table:
    """A table with all required keys and none beyond the optional ones."""
    if not isinstance(value, dict):
        raise FileFormatError(f"expected a table, got {shown(value)}")
    accepted = (*required, *optional)
    for key in value:
        if key not in accepted:
            raise FileFormatError(f"expected the keys {', '.join(accepted)}, got {shown(key)}")
    for key in required:
        if key not in value:
            raise FileFormatError(f"expected the key {key!r}, got a table without it")
    return value


def checked_list(value: Any) -> list[Any]:
    """A list."""
    if not isinstance(value, list):
        raise FileFormatError(f"expected a list, got {shown(value)}")
    return value


def shown(value: Any) -> str:
    """A value of a file as messages quote it: one short line."""
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    try:
        quoted = repr(value)
    except ValueError:  # a whole number of thousands of digits
        quoted = "a number of thousands of digits"
    return quoted if len(quoted) <= _LONGEST_SHOWN else quoted[:_LONGEST_SHOWN] + "..."


def number(value: Any) -> float:
    """A finite number."""
    try:
        plain = isinstance(value, (int, float)) and not isinstance(value, bool)
        result = float(value) if plain else math.nan
    except OverflowError:
        result = math.nan
    if not math.isfinite(result):
        raise FileFormatError(f"expected a finite number, got {shown(value)}")
    return result


def whole(value: Any) -> int:
    """A whole number."""
    if not isinstance(value, int) or isinstance(value, bool):
        raise FileFormatError(f"expected a whole number, got {shown(value)}")
    return value


def flag(value: Any) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise FileFormatError(f"expected true or false, got {shown(value)}")
    return value


def text(value: Any) -> str:
    """A text."""
    if not isinstance(value, str):
        raise FileFormatError(f"expected a text, got {shown(value)}")
    return value


def _quantity(value: Any, parse: Callable[[str], float]) -> float:
    return parse(value) if isinstance(value, str) else number(value)


def length(value: Any) -> float:
    """A length above zero: a text such as "10 mm", or metres."""
    return parse_length(value if isinstance(value, str) else number(value))


def radius_of(value: Any) -> float:
    """A radius of a curved wave: a length of either sign, or "inf" for a flat one."""
    if isinstance(value, str) and value.strip().lower() in ("inf", "flat"):
        return math.inf
    return _quantity(value, parse_coordinate)


def angle(value: Any) -> float:
    """An angle: a text such as "20 deg", or radians."""
    return _quantity(value, parse_angle)


def decibels(value: Any) -> float:
    """A level: a text such as "25 dB", or decibels."""
    return _quantity(value, parse_decibels)


def frequency(value: Any) -> float:
    """A frequency above zero: a text such as "94 GHz", or hertz."""
    return parse_frequency(value if isinstance(value, str) else number(value))


def _nested(value: Any, convert: Callable[[Any], Any], depth: int = _DEEPEST) -> Any:
    if not isinstance(value, list):
        return convert(value)
    if not depth:
        raise FileFormatError("expected numbers, got lists nested too deeply")
    return [_nested(item, convert, depth - 1) for item in value]


def numbers(value: Any) -> Any:
    """Finite numbers, or lists of them as they are nested."""
    return _nested(value, number)


def coordinates(value: Any) -> Any:
    """Lengths of either sign, as texts or metres, or lists of them as they are nested."""
    return _nested(value, lambda item: _quantity(item, parse_coordinate))


def complex_numbers(value: Any, depth: int = 1) -> Any:
    """Lists, nested `depth` deep, of complex numbers: real ones, or pairs [real, imaginary]."""
    if depth:
        return [complex_numbers(item, depth - 1) for item in checked_list(value)]
    if not isinstance(value, list):
        return complex(number(value))
    if len(value) != 2:
        raise FileFormatError(f"expected a complex number as [real, imaginary], got {shown(value)}")
    return complex(number(value[0]), number(value[1]))


def drawing_options(table: Table) -> dict[str, Any]:
    """Which layers of a drawing, and whether to join what overlaps."""
    layer = table.get("layer")
    names = [layer] if isinstance(layer, str) or layer is None else checked_list(layer)
    layers = tuple(text(name) for name in names if name is not None)
    return {"layer": layers or None, "union": flag(table.get("union", False))}
