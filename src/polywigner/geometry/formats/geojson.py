"""Polygons of a GeoJSON text (RFC 7946), as lists of rings."""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

from polywigner.errors import FileFormatError
from polywigner.geometry.formats.limits import check_values, check_vertices
from polywigner.geometry.formats.quoting import place_of, token

__all__ = ["rings_of_geojson"]

Vertex = tuple[float, float]

_OTHER_TYPES = ("Point", "MultiPoint", "LineString", "MultiLineString", "Topology")
_KNOWN_TYPES = "Polygon, MultiPolygon, Feature, FeatureCollection or GeometryCollection"


def _refuse_constant(name: str) -> NoReturn:
    raise FileFormatError(f"expected finite coordinates, got {name}; remove that vertex")


def _loaded(text: str) -> Any:
    # Each opens a list or an object, of which Python makes a hundred bytes.
    check_vertices(text.count("[") + text.count("{"))
    check_values(text)
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
