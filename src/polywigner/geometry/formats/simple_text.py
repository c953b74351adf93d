"""Polygons as well-known text, and one ring as a table of numbers."""

from __future__ import annotations

import re

import numpy as np
import shapely

from polywigner.errors import FileFormatError
from polywigner.geometry.exact import Ring
from polywigner.geometry.formats.limits import DEEPEST_WKT, LONGEST_LINE, check_vertices
from polywigner.geometry.formats.quoting import token
from polywigner.geometry.grid import polygons_in
from polywigner.geometry.rings import rings_of_polygon

__all__ = ["rings_of_csv", "rings_of_wkt"]

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_PAIR = re.compile(rf"\s*+({_NUMBER.pattern})(?:\s*+,\s*+|\s++)({_NUMBER.pattern})\s*+", re.ASCII)
_NO_NUMBERS = ("nan", "NaN", "inf", "-inf", "Infinity", "-Infinity")
_LINE_ENDS = "\n\r\v\f\x1c\x1d\x1e\x85\u2028\u2029"  # of str.splitlines


def rings_of_wkt(text: str) -> list[list[Ring]]:
    """The rings of each polygon of a WKT Polygon or MultiPolygon.

    Raises FileFormatError for anything else.
    """
    check_vertices(text.count(",") + text.count("("))
    depth = deepest = 0
    for bracket in re.finditer(r"[()]", text):
        depth += 1 if bracket[0] == "(" else -1
        deepest = max(deepest, depth)
    if deepest > DEEPEST_WKT:
        raise FileFormatError(f"expected WKT nested at most {DEEPEST_WKT} deep, got {deepest}")
    try:
        with np.errstate(invalid="ignore"):  # a NaN is reported below, with its vertex
            geometry = shapely.from_wkt(text.strip())
    except (shapely.errors.GEOSException, ValueError, NotImplementedError) as error:
        raise FileFormatError(
            "expected WKT such as POLYGON ((0 0, 1 0, 1 1, 0 0)), got text that does not parse"
            + ("; end each ring where it is to be closed" if "closed" in str(error) else "")
        ) from None
    if geometry.geom_type not in ("Polygon", "MultiPolygon"):
        raise FileFormatError(f"expected a WKT Polygon or MultiPolygon, got a {geometry.geom_type}")
    if geometry.is_empty:
        raise FileFormatError("expected at least one polygon, got one that is EMPTY")
    return [rings_of_polygon(p, f"polygon {n}") for n, p in enumerate(polygons_in(geometry))]


def _fields(line: str) -> list[str]:
    """The columns of a line: split at semicolons, else commas, else blanks.

    Where semicolons separate, a comma is a decimal sign, as spreadsheets write in many countries.
    """
    if ";" in line:
        fields = line.replace(",", ".").split(";")
    elif "," in line:
        fields = line.split(",")
    else:
        fields = line.split()
    stripped = [field.strip().strip("\"'") for field in fields]
    while stripped and not stripped[-1]:  # a trailing separator
        stripped.pop()
    return stripped


def rings_of_csv(text: str) -> list[list[Ring]]:
    """The one ring of a table with a vertex per line; header line and # comments allowed.

    Raises FileFormatError for a line that is not two numbers.
    """
    check_vertices(sum(map(text.count, _LINE_ENDS)) - text.count("\r\n"))
    vertices: list[tuple[float, float]] = []
    header_allowed = True
    for number, line in enumerate(text.splitlines(), start=1):
        if pair := _PAIR.fullmatch(line):  # most lines, so that they take half the time
            vertices.append((float(pair[1]), float(pair[2])))
            continue
        if len(line) > LONGEST_LINE:
            raise FileFormatError(
                f"expected lines of at most {LONGEST_LINE} characters, got {len(line)} in line "
                f"{number}"
            )
        fields = _fields(line.split("#", 1)[0])
        if not fields:
            continue
        if header_allowed and not any(_NUMBER.match(field) for field in fields):
            header_allowed = False
            continue
        header_allowed = False
        if len(fields) != 2 or not all(_NUMBER.fullmatch(field) for field in fields):
            got = (
                " and ".join(token(field, _NO_NUMBERS) for field in fields)
                if len(fields) == 2
                else ""
            )
            got = got or f"{len(fields)} column{'s' * (len(fields) > 1)}"
            raise FileFormatError(
                f'expected two numbers such as "1.5, -2", got {got} in line {number}'
            )
        vertices.append((float(fields[0]), float(fields[1])))
    if not vertices:
        raise FileFormatError("expected lines of two numbers, got none")
    return [[np.array(vertices)]]
