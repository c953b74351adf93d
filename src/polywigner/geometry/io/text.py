"""Polygons of GeoJSON (RFC 7946) and of well-known text, and the ring of a table of numbers."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import shapely

from polywigner.errors import FileFormatError
from polywigner.geometry.io.limits import check_coordinates, text_of
from polywigner.geometry.io.outlines import Drawing, File
from polywigner.geometry.parts import polygons_in
from polywigner.geometry.rings import Ring, rings_of_polygon

_TYPES = "Polygon, MultiPolygon, Feature, FeatureCollection or GeometryCollection"
_MEMBERS = {"FeatureCollection": "features", "GeometryCollection": "geometries"}


def load_geojson(file: File) -> Drawing:
    """Load all polygons in order, including the polygons of features and collections."""
    try:
        polygons = list(_polygons(json.loads(text_of(file.content))))
    except FileFormatError:
        raise
    except ValueError as error:  # JSONDecodeError, or an integer of thousands of digits
        line = f" in line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise FileFormatError(f"expected GeoJSON, got text that is not JSON{line}") from None
    if not polygons:
        raise FileFormatError("expected at least one polygon, got none")
    return Drawing(polygons, file.unit_metres)


def _polygons(item: Any) -> Iterator[list[Ring]]:
    kind = item.get("type") if isinstance(item, dict) else None
    if kind == "Feature":
        geometry = item.get("geometry")
        yield from () if geometry is None else _polygons(geometry)
    elif kind in _MEMBERS:
        for member in _listed(item.get(_MEMBERS[kind]), f"the {_MEMBERS[kind]} of a {kind}"):
            yield from _polygons(member)
    elif kind in ("Polygon", "MultiPolygon"):
        coordinates = _listed(item.get("coordinates"), f"the coordinates of a {kind}")
        for rings in [coordinates] if kind == "Polygon" else coordinates:
            yield [_ring(ring) for ring in _listed(rings, "the coordinates of a Polygon")]
    else:
        got = "another type" if kind else "a value without a type"
        raise FileFormatError(f"expected GeoJSON of type {_TYPES}, got {got}")


def _listed(value: Any, what: str) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise FileFormatError(f"expected {what} as a list that is not empty, got none")
    return value


def _ring(positions: Any) -> Ring:
    for position in _listed(positions, "a ring"):
        is_list = isinstance(position, list) and len(position) in (2, 3)
        if not is_list or not all(type(number) in (int, float) for number in position):
            raise FileFormatError("expected positions as [x, y], got a value of another kind")
        if position[2:] not in ([], [0]):
            raise FileFormatError(
                f"expected an outline in the plane z = 0, got a height of {position[2]}; drop it"
            )
    try:
        ring = np.array([position[:2] for position in positions], dtype=float)
    except OverflowError:
        ring = np.array([[np.inf, np.inf]])
    check_coordinates(ring)
    return ring


def load_wkt(file: File) -> Drawing:
    """Load the polygons of a WKT Polygon or MultiPolygon."""
    try:
        with np.errstate(invalid="ignore"):  # a NaN is reported below, with its vertex
            geometry = shapely.from_wkt(text_of(file.content).strip())
    except (shapely.errors.GEOSException, NotImplementedError) as error:
        raise FileFormatError(
            "expected WKT such as POLYGON ((0 0, 1 0, 1 1, 0 0)), got text that does not parse"
            + (
                "; write the first point of each closed ring again at its end"
                if "closed" in str(error)
                else ""
            )
        ) from None
    if geometry.geom_type not in ("Polygon", "MultiPolygon") or geometry.is_empty:
        got = "EMPTY" if geometry.is_empty else f"a {geometry.geom_type}"
        raise FileFormatError(f"expected a WKT Polygon or MultiPolygon, got {got}")
    polygons = enumerate(polygons_in(geometry))
    return Drawing([rings_of_polygon(p, f"polygon {n}") for n, p in polygons], file.unit_metres)


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
