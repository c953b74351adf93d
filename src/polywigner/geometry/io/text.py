"""Polygons of GeoJSON (RFC 7946) and of well-known text, and the ring of a table of numbers."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from polywigner.errors import FileFormatError
from polywigner.geometry.io.limits import text_of
from polywigner.geometry.io.outlines import Drawing, File
from polywigner.geometry.parts import polygons_in
from polywigner.geometry.rings import rings_of_polygon


def load_geojson(file: File) -> Drawing:
    """Load all polygons in order, including the polygons of features and collections."""
    return _polygons(file, shapely.from_geojson, "GeoJSON with polygons")


def load_wkt(file: File) -> Drawing:
    """Load the polygons of well-known text."""
    return _polygons(file, shapely.from_wkt, "WKT such as POLYGON ((0 0, 1 0, 1 1, 0 0))")


def _polygons(file: File, parse: Callable[[str], BaseGeometry], expected: str) -> Drawing:
    try:
        with np.errstate(invalid="ignore"):  # a NaN is reported below, with its vertex
            geometry = parse(text_of(file.content).strip())
    except (shapely.errors.GEOSException, NotImplementedError) as error:
        line = re.search(r" in line \d+", str(error).replace("at line", "in line"))
        closed = "; end each ring with its first point"
        raise FileFormatError(
            f"expected {expected}, got text that does not parse{line[0] if line else ''}"
            f"{closed if 'closed' in str(error) else ''}"
        ) from None
    polygons = polygons_in(geometry)
    count = sum(map(shapely.get_num_coordinates, polygons))
    if count == 0 or shapely.get_num_coordinates(geometry) > count:
        got = "points or lines" if shapely.get_num_coordinates(geometry) > count else "none"
        raise FileFormatError(f"expected {expected}, got {got}")
    named = [rings_of_polygon(p, f"polygon {n}") for n, p in enumerate(polygons)]
    return Drawing(named, file.unit_metres)


NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)


def fields_of(line: str) -> list[str]:
    """Return the columns of a line: split at semicolons, else commas, else blanks.

    With semicolons, a comma is a decimal sign, as in spreadsheets of many countries.
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


def load_csv(file: File) -> Drawing:
    """Load the ring of a table with a vertex per line, with a header line and # comments."""
    lines = enumerate(text_of(file.content).splitlines(), start=1)
    rows = [(n, fields) for n, line in lines if (fields := fields_of(line.split("#", 1)[0]))]
    has_header = rows and not any(map(NUMBER.match, rows[0][1]))
    vertices = []
    for number, fields in rows[1 if has_header else 0 :]:
        if len(fields) != 2 or not all(map(NUMBER.fullmatch, fields)):
            raise FileFormatError(
                f'expected two numbers such as "1.5, -2", got others in line {number}'
            )
        vertices.append((float(fields[0]), float(fields[1])))
    if not vertices:
        raise FileFormatError("expected lines of two numbers, got none")
    return Drawing([[np.array(vertices)]], file.unit_metres)
