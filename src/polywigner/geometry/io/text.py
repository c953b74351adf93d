"""Polygons of GeoJSON (RFC 7946), of well-known text, and one ring of a table of numbers."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np
import shapely

from polywigner.errors import FileFormatError
from polywigner.geometry.exact import Ring
from polywigner.geometry.io.drawing import Drawing, File, Format
from polywigner.geometry.io.limits import place_of, text_of, token
from polywigner.geometry.parts import polygons_in
from polywigner.geometry.rings import rings_of_polygon

Vertex = tuple[float, float]

_OTHER_TYPES = ("Point", "MultiPoint", "LineString", "MultiLineString", "Topology")
_KNOWN_TYPES = "Polygon, MultiPolygon, Feature, FeatureCollection or GeometryCollection"


def _refuse_constant(name: str) -> NoReturn:
    raise FileFormatError(f"expected finite coordinates, got {name}; remove that vertex")


def _loaded(text: str) -> Any:
    try:
        return json.loads(text, parse_constant=_refuse_constant)
    except RecursionError:
        raise FileFormatError("expected GeoJSON, got JSON nested too deeply") from None
    except FileFormatError:
        raise
    except ValueError as error:  # JSONDecodeError, or an integer of thousands of digits
        raise FileFormatError(
            f"expected GeoJSON, got text that is not JSON{place_of(error)}"
        ) from None


def _listed(value: Any, what: str) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise FileFormatError(f"expected {what} as a list that is not empty, got {_kind(value)}")
    return value


def _kind(value: Any) -> str:
    if value == []:
        return "an empty list"
    names = {dict: "an object without a type", list: "a list", str: "a text", type(None): "nothing"}
    return names.get(type(value), "a number")


def _vertex(position: Any) -> Vertex:
    numbers = isinstance(position, list) and all(
        isinstance(v, (int, float)) and not isinstance(v, bool) for v in position
    )
    if not numbers or len(position) not in (2, 3):
        raise FileFormatError(f"expected positions as [x, y], got {_kind(position)}")
    if len(position) == 3 and position[2] != 0:
        raise FileFormatError(
            f"expected an outline in the plane z = 0, got a height of {position[2]}; drop it"
        )
    try:
        x, y = float(position[0]), float(position[1])
    except OverflowError:
        x = y = math.inf
    if not (math.isfinite(x) and math.isfinite(y)):  # 1e999 is JSON, too
        raise FileFormatError("expected finite coordinates, got one beyond the largest float")
    return x, y


def _polygon(coordinates: Any) -> list[list[Vertex]]:
    rings = _listed(coordinates, "the coordinates of a Polygon")
    return [[_vertex(position) for position in _listed(ring, "a ring")] for ring in rings]


def rings_of_geojson(text: str) -> list[list[list[Vertex]]]:
    """All polygons of the text in order, each a list of rings with the exterior first.

    Features and collections are opened; a geometry that is null is passed over. Raises
    FileFormatError for anything else than polygons.
    """
    polygons: list[list[list[Vertex]]] = []
    waiting = [_loaded(text)]
    while waiting:
        item = waiting.pop()
        kind = item.get("type") if isinstance(item, dict) else None
        if kind == "Polygon":
            polygons.append(_polygon(item.get("coordinates")))
        elif kind == "MultiPolygon":
            members = _listed(item.get("coordinates"), "the coordinates of a MultiPolygon")
            polygons.extend(map(_polygon, members))
        elif kind == "Feature":
            geometry = item.get("geometry")
            waiting.extend([] if geometry is None else [geometry])
        elif kind in ("FeatureCollection", "GeometryCollection"):
            key = "features" if kind == "FeatureCollection" else "geometries"
            waiting.extend(reversed(_listed(item.get(key), f"the {key} of a {kind}")))
        else:
            got = f"type {token(str(kind), _OTHER_TYPES)}" if kind is not None else _kind(item)
            raise FileFormatError(f"expected GeoJSON of type {_KNOWN_TYPES}, got {got}")
    if not polygons:
        raise FileFormatError("expected at least one polygon, got none")
    return polygons


NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_PAIR = re.compile(rf"\s*+({NUMBER.pattern})(?:\s*+,\s*+|\s++)({NUMBER.pattern})\s*+", re.ASCII)
_NO_NUMBERS = ("nan", "NaN", "inf", "-inf", "Infinity", "-Infinity")


def rings_of_wkt(text: str) -> list[list[Ring]]:
    """The rings of each polygon of a WKT Polygon or MultiPolygon.

    Raises FileFormatError for anything else.
    """
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


def fields_of(line: str) -> list[str]:
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
    vertices: list[tuple[float, float]] = []
    header_allowed = True
    for number, line in enumerate(text.splitlines(), start=1):
        if pair := _PAIR.fullmatch(line):  # most lines, so that they take half the time
            vertices.append((float(pair[1]), float(pair[2])))
            continue
        fields = fields_of(line.split("#", 1)[0])
        if not fields:
            continue
        if header_allowed and not any(NUMBER.match(field) for field in fields):
            header_allowed = False
            continue
        header_allowed = False
        if len(fields) != 2 or not all(NUMBER.fullmatch(field) for field in fields):
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


def _reader(polygons: Callable[[str], list[list[Any]]]) -> Callable[[File], Drawing]:
    """A reader of text that knows neither units nor curves."""
    return lambda file: Drawing(polygons(text_of(file.content)), file.unit_metres)


_WKT = rb"(?i:SRID|MULTI|POINT|LINE|POLYGON|GEOMETRY|C[A-Z]+|TIN|TRI)"
FORMATS = (
    Format("GeoJSON", (".geojson", ".json"), _reader(rings_of_geojson), rb"[{\[]"),
    Format("WKT", (".wkt",), _reader(rings_of_wkt), _WKT),
    Format("CSV", (".csv",), _reader(rings_of_csv)),
)
