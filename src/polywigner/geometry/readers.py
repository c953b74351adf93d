"""Aperture files: GeoJSON, WKT and a ring as CSV.

Each format becomes a list of polygons, each a list of rings with the exterior first, in the file's
own unit. Checking the outlines is the business of :class:`Aperture`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from polywigner.errors import FileFormatError, GeometryError
from polywigner.geometry.aperture import Aperture
from polywigner.geometry.exact import Ring
from polywigner.geometry.geojson import rings_of_geojson
from polywigner.geometry.grid import polygons_in
from polywigner.geometry.parts import merge_parts, part_of_rings
from polywigner.geometry.rings import rings_of_polygon
from polywigner.quantities import parse_unit

__all__ = ["read_aperture"]

# An outline of a million vertices takes about 40 MB as text.
_LARGEST_FILE = 64 * 2**20

# GEOS reads nested collections by recursion in C++, where too deep a stack ends the process.
_DEEPEST_WKT = 32

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_WKT_START = re.compile(r"\s*(?:SRID|MULTI|POINT|LINE|POLYGON|GEOMETRY|C[A-Z]+|TIN|TRI)", re.I)


def _text_of(path: Path) -> str:
    """The file's text; anything but a readable text file of sensible size raises."""
    try:
        if not path.exists():
            raise FileFormatError("expected an aperture file, got a path that does not exist")
        if path.is_dir():
            raise FileFormatError("expected an aperture file, got a directory")
        if not path.is_file():
            raise FileFormatError("expected a regular file, got a device or pipe")
        size = path.stat().st_size
        if size > _LARGEST_FILE:
            raise FileFormatError(
                f"expected at most {_LARGEST_FILE >> 20} MiB, got {size / 2**20:.0f} MiB; "
                "simplify the outline"
            )
        content = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"expected a readable file, got: {error}") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise FileFormatError("expected text in UTF-8, got binary data; export as GeoJSON or WKT")
    if not text.strip():
        raise FileFormatError("expected an outline, got an empty file")
    return text


def _polygons_of_wkt(text: str) -> list[list[Ring]]:
    depth = deepest = 0
    for bracket in re.findall(r"[()]", text):
        depth += 1 if bracket == "(" else -1
        deepest = max(deepest, depth)
    if deepest > _DEEPEST_WKT:
        raise FileFormatError(f"expected WKT nested at most {_DEEPEST_WKT} deep, got {deepest}")
    try:
        with np.errstate(invalid="ignore"):  # a NaN is reported below, with its vertex
            geometry = shapely.from_wkt(text.strip())
    except (shapely.errors.GEOSException, ValueError, NotImplementedError) as error:
        raise FileFormatError(
            f"expected WKT such as POLYGON ((0 0, 1 0, 1 1, 0 0)), got text that does not parse: "
            f"{str(error)[:200]}"
        ) from None
    if geometry.geom_type not in ("Polygon", "MultiPolygon"):
        raise FileFormatError(f"expected a WKT Polygon or MultiPolygon, got a {geometry.geom_type}")
    if geometry.is_empty:
        raise FileFormatError(f"expected at least one polygon, got {text.strip()[:60]}")
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


def _polygons_of_csv(text: str) -> list[list[Ring]]:
    vertices: list[tuple[float, float]] = []
    header_allowed = True
    for number, line in enumerate(text.splitlines(), start=1):
        fields = _fields(line.split("#", 1)[0])
        if not fields:
            continue
        if header_allowed and not any(_NUMBER.match(field) for field in fields):
            header_allowed = False
            continue
        header_allowed = False
        if len(fields) != 2 or not all(_NUMBER.fullmatch(field) for field in fields):
            got = f"{line.strip()[:60]!r} in line {number}"
            raise FileFormatError(f'expected two numbers such as "1.5, -2", got {got}')
        vertices.append((float(fields[0]), float(fields[1])))
    if not vertices:
        raise FileFormatError("expected lines of two numbers, got none")
    return [[np.array(vertices)]]


_Reader = Callable[[str], list[list[Any]]]
_READERS: dict[str, _Reader] = {
    ".geojson": rings_of_geojson,
    ".json": rings_of_geojson,
    ".wkt": _polygons_of_wkt,
    ".csv": _polygons_of_csv,
}


def _reader_for(suffix: str, text: str) -> _Reader:
    """By suffix; by the first characters where the suffix is unknown or says little (.txt)."""
    known = _READERS.get(suffix.lower())
    if known is not None:
        return known
    if suffix.lower() in (".svg", ".dxf", ".gds", ".stl", ".shp"):
        raise FileFormatError(
            f"expected GeoJSON, WKT or CSV, got {suffix}, which is not read yet; export the "
            "outline as GeoJSON or WKT"
        )
    if text.lstrip()[:1] in ("{", "["):
        return rings_of_geojson
    return _polygons_of_wkt if _WKT_START.match(text) else _polygons_of_csv


def _scaled(rings: list[Any], metres: float) -> list[Ring]:
    """Rings in metres. Dividing by 1000 rather than multiplying by 0.001 rounds correctly."""
    per_metre = round(1 / metres) if metres < 1 else 0
    if per_metre and 1 / per_metre == metres:
        return [np.asarray(ring, dtype=np.float64) / per_metre for ring in rings]
    return [np.asarray(ring, dtype=np.float64) * metres for ring in rings]


def _aperture(polygons: list[list[Any]], metres: float) -> Aperture:
    single = len(polygons) == 1
    names = ["the polygon" if single else f"polygon {number}" for number in range(len(polygons))]

    def build(scale: float) -> Aperture:
        scaled = [_scaled(rings, scale) for rings in polygons]
        parts = [part_of_rings(rings, name) for rings, name in zip(scaled, names, strict=True)]
        return Aperture._of_parts(merge_parts(parts))

    try:
        return build(metres)
    except GeometryError:
        build(1.0)  # raises the same with places in the file's own unit
        raise


def read_aperture(path: str | os.PathLike[str], unit: str | float = "mm") -> Aperture:
    """Read an aperture from a file; returns it in metres.

    Parameters
    ----------
    path
        ``.geojson`` or ``.json``: Polygon, MultiPolygon, or Features and collections of them;
        ``.wkt``: Polygon or MultiPolygon; ``.csv``: one vertex of a single ring per line,
        with comma, semicolon or blanks between x and y, an optional header line and ``#``
        comments (with semicolons, a decimal comma is understood). Any other suffix: by content.
    unit
        What 1 stands for in the file: a unit's name ("mm", "um", "in") or a length ("0.1 mm").

    Raises
    ------
    FileFormatError
        The file is missing, empty, too large (64 MiB), binary, or not of its format.
    GeometryError
        The outline is not a polygon: see :class:`Aperture`. Places are in the file's unit.
    QuantityError
        The unit does not parse.
    """
    metres = parse_unit(unit)
    source = Path(path)
    try:
        text = _text_of(source)
        return _aperture(_reader_for(source.suffix, text)(text), metres)
    except (FileFormatError, GeometryError) as error:
        raise type(error)(f"{source}: {error}") from None
