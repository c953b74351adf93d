"""Files of apertures and bodies: GeoJSON, WKT, CSV, SVG, DXF, GDSII, Gerber; STL, PLY and OBJ.

Each format becomes polygons, each a list of rings with the exterior first, in the file's own unit.
Checking them is the business of :class:`Aperture` and :class:`Polyhedron`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polywigner.errors import (
    ArgumentError,
    FileFormatError,
    GeometryError,
    MissingExtraError,
    PolywignerError,
)
from polywigner.geometry.aperture import Aperture
from polywigner.geometry.exact import Ring
from polywigner.geometry.io.dxf import read_dxf
from polywigner.geometry.io.gds import read_gds
from polywigner.geometry.io.gerber import read_gerber
from polywigner.geometry.io.limits import bytes_of, check_polygons, text_of
from polywigner.geometry.io.mesh import MESH_SUFFIXES, read_mesh
from polywigner.geometry.io.outlines import (
    Drawing,
    checked_layers,
    checked_tolerance,
    checked_union,
)
from polywigner.geometry.io.svg import read_svg
from polywigner.geometry.io.svg_shapes import PIXEL
from polywigner.geometry.io.text import rings_of_csv, rings_of_geojson, rings_of_wkt
from polywigner.geometry.parts import merge_parts, part_of_rings, union_parts
from polywigner.geometry.polyhedron import Polyhedron
from polywigner.quantities import parse_unit

# Finding out what is wrong with a large outline takes seconds, which are not spent twice.
_MOST_REPEATED = 50_000


@dataclass(frozen=True, eq=False)
class _File:
    """A file with the options of the caller."""

    path: Path
    content: bytes
    unit_metres: float
    tolerance: float | None
    layers: tuple[str, ...] = ()
    union: bool = False


def _check_no_layers(file: _File) -> None:
    if file.layers:
        raise ArgumentError(
            "expected a layer of a drawing (SVG, DXF, GDSII) only, got one of a file that has "
            "no layers; leave it out"
        )


def _polygons(reader: Callable[[str], list[list[Any]]]) -> Callable[[_File], Drawing]:
    """A reader of text that knows neither units nor curves."""

    def read(file: _File) -> Drawing:
        _check_no_layers(file)
        return Drawing(reader(text_of(file.content)), file.unit_metres)

    return read


def _svg(file: _File) -> Drawing:
    return read_svg(file.content, file.unit_metres, file.tolerance, file.layers)


def _dxf(file: _File) -> Drawing:
    return read_dxf(
        file.path, file.content, file.unit_metres, file.tolerance, file.layers, file.union
    )


def _gds(file: _File) -> Drawing:
    return read_gds(file.path, file.content, file.layers)


def _gerber(file: _File) -> Drawing:
    _check_no_layers(file)
    return read_gerber(file.content, file.tolerance)


_GEOJSON = _polygons(rings_of_geojson)
_WKT = _polygons(rings_of_wkt)
_CSV = _polygons(rings_of_csv)
_READERS = {
    ".geojson": _GEOJSON, ".json": _GEOJSON, ".wkt": _WKT, ".csv": _CSV, ".svg": _svg,
    ".dxf": _dxf, ".gds": _gds,
    ".gbr": _gerber, ".ger": _gerber, ".gtl": _gerber, ".gbl": _gerber, ".art": _gerber,
}  # fmt: skip

# The first bytes of files of another suffix (.txt, or none), by format.
_STARTS = (
    (rb"[{\[]", _GEOJSON),
    (rb"AutoCAD Binary DXF|(?:999\r?\n[^\n]*\n\s*)*0\s*\r?\n\s*SECTION", _dxf),
    (rb"\x00\x06\x00\x02", _gds),
    (rb"<", _svg),
    (rb"G0?4|%(?:FS|MO|T[FA]|AM|AD|IN|LN|IP|AS|SF)|G7[015]\*", _gerber),
    (rb"(?i:SRID|MULTI|POINT|LINE|POLYGON|GEOMETRY|C[A-Z]+|TIN|TRI)", _WKT),
)
_NOT_READ = (".shp", ".dwg", ".svgz", ".pdf", ".eps", ".step", ".stp", ".iges", ".igs")


def _reader_for(file: _File) -> Callable[[_File], Drawing]:
    suffix = file.path.suffix.lower()
    known = _READERS.get(suffix)
    if known is not None:
        return known
    if suffix in MESH_SUFFIXES:
        raise FileFormatError(
            f"expected an aperture, got {suffix}, which holds a body; read it with "
            "polywigner.read_polyhedron"
        )
    if suffix in _NOT_READ:
        raise FileFormatError(
            f"expected GeoJSON, WKT, CSV, SVG, DXF, GDSII or Gerber, got {suffix}, which is not "
            "read; export the outline as one of these"
        )
    start = file.content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
    return next((reader for pattern, reader in _STARTS if re.match(pattern, start)), _CSV)


def _scaled(points: Any, metres: float) -> Ring:
    """Coordinates in metres. Dividing by 1000 rather than multiplying by 0.001 rounds correctly."""
    array = np.asarray(points, dtype=np.float64)
    per_metre = round(1 / metres) if 1e-15 < metres < 1 else 0
    return array / per_metre if per_metre and 1 / per_metre == metres else array * metres


def _aperture(drawing: Drawing, union: bool) -> Aperture:
    polygons = drawing.polygons
    vertices = check_polygons(polygons)
    single = len(polygons) == 1
    names = ["the polygon" if single else f"polygon {number}" for number in range(len(polygons))]

    advice = {} if drawing.remedy is None else {"remedy": drawing.remedy}

    def build(scale: float) -> Aperture:
        scaled = [[_scaled(ring, scale) for ring in rings] for rings in polygons]
        named = zip(scaled, names, strict=True)
        parts = [part_of_rings(rings, name, **advice) for rings, name in named]
        return Aperture._of_parts(union_parts(parts) if union else merge_parts(parts, **advice))

    try:
        return build(drawing.metres)
    except GeometryError:
        if vertices <= _MOST_REPEATED:
            build(1.0)  # raises the same with places in the file's own unit
        raise


def _metres(unit: str | float) -> float:
    return float(PIXEL) if isinstance(unit, str) and unit.strip() == "px" else parse_unit(unit)


def _about(path: Path, error: PolywignerError) -> PolywignerError:
    """The error with the file's name, and without characters that a terminal would obey."""
    text = f"{path}: {error}"
    return type(error)("".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text))


def read_aperture(
    path: str | os.PathLike[str],
    unit: str | float = "mm",
    tolerance: float | None = None,
    layer: str | Sequence[str] | None = None,
    union: bool = False,
) -> Aperture:
    """Read an aperture from a file; returns it in metres.

    Parameters
    ----------
    path
        ``.geojson`` or ``.json``: Polygon, MultiPolygon, or Features and collections of them;
        ``.wkt``: Polygon or MultiPolygon; ``.csv``: one vertex of a single ring per line,
        with comma, semicolon or blanks between x and y, an optional header line and ``#``
        comments (with semicolons, a decimal comma is understood); ``.svg``: filled shapes, turned
        so that y points up; ``.dxf``: closed outlines in the model space, those inside others
        being holes; ``.gds``: polygons and paths of a cell; ``.gbr``, ``.ger``, ``.gtl``, ``.gbl``
        or ``.art``: the copper of a Gerber layer. Any other suffix: by content. SVG, DXF, GDSII
        and Gerber need the extra `formats`.
    unit
        What 1 stands for in the file: a unit's name ("mm", "um", "in") or a length ("0.1 mm");
        "px" is 1/96 inch. An SVG file whose width or height is in mm, cm, Q, in, pt or pc, and a
        DXF file with $INSUNITS, state it themselves, as GDSII and Gerber do; then `unit` has no
        effect.
    tolerance
        Largest distance in metres between a curve (SVG, DXF, Gerber) and the chords that replace
        it. None: 1/2000 of the diagonal of each outline. Whole circles and ellipses keep their
        area.
    layer
        Of a drawing, the layers to read alone: a name, or several. DXF: layers, in capitals or not;
        SVG: groups or shapes by id or by the name that Inkscape shows. Those that are named are
        read even where they are hidden. GDSII: layers as "1" or "1/0", and a cell by its name.
        None: all that is visible.
    union
        Whether to join shapes that overlap, such as a pad and its feed, rather than to refuse them.
        Those of a Gerber file are always joined.

    Raises
    ------
    FileFormatError
        The file is missing, empty, too large (64 MiB), damaged, not of its format, or holds
        something that is no outline; docs/files.md lists what is read and the limits.
    GeometryError
        The outline is not a polygon: see :class:`Aperture`. Places are in the file's unit.
    QuantityError
        The unit does not parse.
    ArgumentError
        The tolerance is not a length above zero, or the path is none, or there is no such layer.
    MissingExtraError
        The format needs a library that is not installed.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "slot.wkt"
    >>> _ = path.write_text("POLYGON ((0 0, 4 0, 4 1, 0 1, 0 0))")
    >>> pw.read_aperture(path, unit="mm").bounds
    (0.0, 0.0, 0.004, 0.001)
    """
    metres, reach, source = _metres(unit), checked_tolerance(tolerance), _path(path)
    layers, joins = checked_layers(layer), checked_union(union)
    try:
        file = _File(source, bytes_of(source), metres, reach, layers, joins)
        # Numbers beyond the range of float64 are reported where they arrive, with a place.
        with np.errstate(all="ignore"):
            return _aperture(_reader_for(file)(file), joins)
    except (FileFormatError, GeometryError, MissingExtraError, ArgumentError) as error:
        raise _about(source, error) from None


def read_polyhedron(path: str | os.PathLike[str], unit: str | float = "mm") -> Polyhedron:
    """Read a body from a mesh file (``.stl``, ``.ply``, ``.obj``); returns it in metres.

    Needs the extra `formats`. Vertices with equal coordinates are merged; faces of more than three
    vertices become fans of triangles; colours, normals and materials are passed over.

    Parameters
    ----------
    path
        The file, in text or binary form where the format has both.
    unit
        What 1 stands for in the file, as for :func:`read_aperture`; none of these formats says.

    Raises
    ------
    FileFormatError
        The file is missing, empty, too large (64 MiB, 200 000 triangles), damaged, or not of its
        format.
    GeometryError
        The surface is not closed, not consistently oriented, or encloses no volume.
    QuantityError
        The unit does not parse.
    ArgumentError
        The path is none.
    MissingExtraError
        trimesh is not installed.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "body.obj"
    >>> faces = "f 1 3 2\\nf 1 2 4\\nf 2 3 4\\nf 1 4 3\\n"
    >>> _ = path.write_text("v 0 0 0\\nv 1 0 0\\nv 0 1 0\\nv 0 0 1\\n" + faces)
    >>> round(pw.read_polyhedron(path, unit="m").volume, 6)
    0.166667
    """
    metres, source = _metres(unit), _path(path)
    try:
        if source.suffix.lower() not in MESH_SUFFIXES:
            raise FileFormatError(
                f"expected a mesh with the suffix {', '.join(MESH_SUFFIXES)}, got "
                f"{source.suffix or 'no suffix'!r}; outlines are read by polywigner.read_aperture"
            )
        with np.errstate(all="ignore"):
            vertices, faces = read_mesh(bytes_of(source), source.suffix.lower())
            return Polyhedron(_scaled(vertices, metres), faces)
    except (FileFormatError, GeometryError, MissingExtraError) as error:
        raise _about(source, error) from None


def _path(path: Any) -> Path:
    try:
        return Path(os.fsdecode(path))
    except TypeError:
        raise ArgumentError(f"expected the path of a file, got {type(path).__name__}") from None
