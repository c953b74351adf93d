"""Readers of apertures (GeoJSON, WKT, CSV, SVG, DXF, GDSII, Gerber) and bodies (STL, PLY, OBJ)."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from polywigner.errors import (
    ArgumentError,
    FileFormatError,
    GeometryError,
    PolywignerError,
    at_key,
    missing_extra,
)
from polywigner.geometry.aperture import Aperture, PlacedAperture
from polywigner.geometry.arguments import check_most, checked_flag, checked_length, checked_path
from polywigner.geometry.io.dxf import load_dxf
from polywigner.geometry.io.gds import load_gds
from polywigner.geometry.io.gerber import load_gerber
from polywigner.geometry.io.limits import (
    MOST_RINGS,
    MOST_VERTICES,
    bytes_of,
    checked_suffix,
    text_of,
)
from polywigner.geometry.io.meshes import MESH_SUFFIXES, read_mesh
from polywigner.geometry.io.outlines import OVERLAP_REMEDY, Drawing, File
from polywigner.geometry.io.svg import PIXEL, load_svg
from polywigner.geometry.parts import merge_parts, part_of_rings, polygons_in, union_parts
from polywigner.geometry.polyhedron import Polyhedron
from polywigner.geometry.rings import Ring, rings_of_polygon
from polywigner.quantities import parse_unit

T = TypeVar("T")


def load_geojson(file: File) -> Drawing:
    """Load all polygons in order, including those in features and collections."""
    return _drawing_from_text(file, shapely.from_geojson, "GeoJSON with polygons")


def load_wkt(file: File) -> Drawing:
    """Load the polygons of a file in well-known text (WKT)."""
    return _drawing_from_text(file, shapely.from_wkt, "WKT such as POLYGON ((0 0, 1 0, 1 1, 0 0))")


def _drawing_from_text(file: File, parse: Callable[[str], BaseGeometry], expected: str) -> Drawing:
    """Load polygons with a parser of shapely; ``expected`` names the content in error messages."""
    try:
        # NaN causes no warning here, because it raises an error later, which names the vertex.
        with np.errstate(invalid="ignore"):
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


_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)


def table_rows(text: str) -> list[tuple[int, list[str]]]:
    """Return the line number and the columns of each nonblank line; # starts a comment."""
    lines = enumerate(text.splitlines(), start=1)
    return [(n, columns) for n, line in lines if (columns := _columns_of(line.split("#", 1)[0]))]


def _columns_of(line: str) -> list[str]:
    """Split a line at semicolons (decimal commas become points), else at commas or at blanks."""
    if ";" in line:
        fields = line.replace(",", ".").split(";")
    elif "," in line:
        fields = line.split(",")
    else:
        fields = line.split()
    stripped = [field.strip().strip("\"'") for field in fields]
    while stripped and not stripped[-1]:
        stripped.pop()
    return stripped


def load_csv(file: File) -> Drawing:
    """Load a ring from a table with one vertex per line and an optional header line."""
    rows = table_rows(text_of(file.content))
    has_header = rows and not any(map(_NUMBER.match, rows[0][1]))
    vertices = []
    for number, fields in rows[1 if has_header else 0 :]:
        if len(fields) != 2 or not all(map(_NUMBER.fullmatch, fields)):
            raise FileFormatError(
                f'expected two numbers such as "1.5, -2" in line {number}, got other text'
            )
        vertices.append((float(fields[0]), float(fields[1])))
    if not vertices:
        raise FileFormatError(
            "the file contains no vertices; write one vertex per line, as two numbers"
        )
    return Drawing([[np.array(vertices)]], file.unit_metres)


LOADERS: dict[str, Callable[[File], Drawing]] = {
    ".geojson": load_geojson,
    ".json": load_geojson,
    ".wkt": load_wkt,
    ".csv": load_csv,
    ".svg": load_svg,
    ".dxf": load_dxf,
    ".gds": load_gds,
    **dict.fromkeys((".gbr", ".ger", ".gtl", ".gbl", ".art"), load_gerber),
}
"""Loader for each file name suffix."""

_WITH_LAYERS = (load_svg, load_dxf, load_gds)
# First bytes of each format, for files with an unknown suffix.
_STARTS = (
    (rb"AutoCAD Binary DXF|(?:999\r?\n[^\n]*\n\s*)*0\s*\r?\n\s*SECTION", load_dxf),
    (rb"\x00\x06\x00\x02", load_gds),
    (rb"[{\[]", load_geojson),
    (rb"G0?4|%(?:FS|MO|T[FA]|AM|AD|IN|LN|IP|AS|SF)|G7[015]\*", load_gerber),
    (rb"<", load_svg),
    (rb"(?i:SRID|MULTI|POINT|LINE|POLYGON|GEOMETRY|C[A-Z]+|TIN|TRI)", load_wkt),
)
_NOT_READ = (".shp", ".dwg", ".svgz", ".pdf", ".eps", ".step", ".stp", ".iges", ".igs")


def _loader_of(path: Path, content: bytes) -> Callable[[File], Drawing]:
    """Return the loader for a file's suffix, or for its first bytes if the suffix is unknown.

    Raises FileFormatError for suffixes of unsupported formats.
    """
    suffix = path.suffix.lower()
    if suffix in MESH_SUFFIXES:
        raise FileFormatError(
            f"expected an aperture, got {suffix}, which contains a body; read it with "
            "polywigner.read_polyhedron"
        )
    if suffix in _NOT_READ:
        raise FileFormatError(
            f"expected a file with one of the suffixes {', '.join(LOADERS)}, got {suffix}; "
            "export the outline in one of these formats"
        )
    start = content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
    by_start = (loader for pattern, loader in _STARTS if re.match(pattern, start))
    return LOADERS.get(suffix) or next(by_start, load_csv)


def _load_any_format(file: File) -> Drawing:
    """Load a file of any format; errors of libraries become errors of polywigner."""
    loader = _loader_of(file.path, file.content)
    if file.layers and loader not in _WITH_LAYERS:
        raise ArgumentError(
            "layer applies only to drawings (SVG, DXF, GDSII), got a file without layers; omit "
            "layer"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return loader(file)
    except PolywignerError:
        raise
    except ModuleNotFoundError as error:
        library = str(error.name).partition(".")[0]
        raise missing_extra(library, "formats", f"reads {file.path.suffix} files") from None
    except RecursionError:
        raise FileFormatError(
            "the elements are nested too deeply, or an element contains itself; ungroup the "
            "elements"
        ) from None
    # The libraries document only a few of their exceptions, so all exceptions are caught.
    except Exception as error:
        raise FileFormatError(
            f"the library for this format cannot read the file ({type(error).__name__}); the "
            "file may be damaged: export the drawing again"
        ) from None


def _in_metres(points: Any, metres: float) -> Ring:
    """Convert coordinates to metres; ``metres`` is the length of their unit in metres.

    A division by 1000 is more accurate than a multiplication by 0.001.
    """
    array = np.asarray(points, dtype=np.float64)
    per_metre = round(1 / metres) if 1e-15 < metres < 1 else 0
    return array / per_metre if per_metre and 1 / per_metre == metres else array * metres


def _aperture_of(drawing: Drawing, union: bool) -> Aperture:
    """Return the aperture of a drawing in metres; ``union`` states whether polygons may overlap."""
    polygons = drawing.polygons
    sizes = [len(ring) for rings in polygons for ring in rings]
    remedy = "use fewer outlines, such as one element of an array"
    check_most(len(sizes), MOST_RINGS, "outlines", remedy, FileFormatError)
    check_most(sum(sizes), MOST_VERTICES, "vertices", "simplify the outline", FileFormatError)
    single = len(polygons) == 1
    names = ["the polygon" if single else f"polygon {number}" for number in range(len(polygons))]

    def build(scale: float) -> Aperture:
        """Return the aperture with coordinates multiplied by ``scale``."""
        scaled = [[_in_metres(ring, scale) for ring in rings] for rings in polygons]
        named = zip(scaled, names, strict=True)
        parts = [part_of_rings(rings, name, OVERLAP_REMEDY) for rings, name in named]
        return Aperture._of_parts(
            union_parts(parts) if union else merge_parts(parts, OVERLAP_REMEDY)
        )

    try:
        return build(drawing.metres)
    except GeometryError:
        # The aperture is built again in the unit of the file, so that the message contains the
        # file's coordinates.
        build(1.0)
        raise


def _metres(unit: str | float) -> float:
    """Return the length in metres of a unit (a name or a length); "px" is a CSS pixel."""
    return float(PIXEL) if isinstance(unit, str) and unit.strip() == "px" else parse_unit(unit)


def _checked_layers(layer: Any) -> tuple[str, ...]:
    """Return the names of requested layers as a tuple, which is empty for None.

    Raises ArgumentError for values other than names.
    """
    layers = () if layer is None else (layer,) if isinstance(layer, str) else layer
    names = tuple(layers) if isinstance(layers, Iterable) else (layers,)
    if not all(isinstance(name, str) and name for name in names):
        raise ArgumentError(
            f"expected layer to be one name or several names, got {layer!r}; pass for example "
            'layer="pads" or layer=["pads", "feed"]'
        )
    return names


def read_aperture(
    path: str | os.PathLike[str],
    unit: str | float = "mm",
    tolerance: float | None = None,
    layer: str | Sequence[str] | None = None,
    union: bool = False,
) -> Aperture:
    """Read an aperture from a file.

    Parameters
    ----------
    path : str or path-like
        ``.geojson`` or ``.json``: Polygon, MultiPolygon, Feature or a collection; ``.wkt``: Polygon
        or MultiPolygon; ``.csv``: a ring, one vertex per line, with comma, semicolon (then a comma
        is a decimal sign) or blanks between x and y, an optional header line and ``#`` comments;
        ``.svg``: filled shapes, with y up; ``.dxf``: closed outlines (an outline inside another
        is a hole) and hatches; ``.gds``: polygons and paths of a cell; ``.gbr``, ``.ger``,
        ``.gtl``, ``.gbl`` or ``.art``: the copper of a Gerber layer. The format of any other suffix
        is detected from the content. SVG, DXF, GDSII and Gerber need the extra `formats`.
    unit : str or float, default "mm"
        Unit of the coordinates: a name ("mm", "um", "in"), a length ("0.1 mm"), or metres; "px" is
        1/96 inch. The unit has no effect for files that specify their unit: SVG with a width or
        height in mm, cm, Q, in, pt or pc, DXF with $INSUNITS, GDSII and Gerber.
    tolerance : float, optional
        Largest distance in metres between a curve (SVG, DXF, Gerber) and its chords. The default is
        1/2000 of the diagonal of each outline. Full circles and ellipses keep their area.
    layer : str or sequence of str, optional
        Names of the layers to read, even if they are hidden. DXF: layers, regardless of case; SVG:
        groups or shapes by id or by their name in Inkscape; GDSII: layers as "1" or "1/0", and a
        cell by its name. By default all visible layers are read.
    union : bool, default False
        Whether to join shapes that overlap, such as a pad and its feed. Otherwise overlaps raise a
        GeometryError. The shapes of a Gerber file are always joined.

    Returns
    -------
    Aperture
        The aperture in metres.

    Raises
    ------
    FileFormatError
        If the file is missing, empty, too large (64 MiB), damaged, or contains unsupported elements
        (docs/files.md).
    GeometryError
        If the outline is not a polygon, see :class:`Aperture`. Positions in the message are in the
        unit of the file.
    QuantityError
        If the unit cannot be parsed.
    ArgumentError
        If the tolerance is not a length above zero, the path is invalid, or the drawing does not
        contain the layer.
    MissingExtraError
        If the library of the format is not installed.

    Examples
    --------
    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "slot.wkt"
    >>> _ = path.write_text("POLYGON ((0 0, 4 0, 4 1, 0 1, 0 0))")
    >>> pw.read_aperture(path, unit="mm").bounds
    (0.0, 0.0, 0.004, 0.001)
    """
    metres, source, expected = _metres(unit), checked_path(path), "a length in m above zero"
    if tolerance is not None:
        tolerance = checked_length(tolerance, "tolerance", meaning=expected)
    layers, joins = _checked_layers(layer), checked_flag(union, "union")
    with at_key(str(source)), np.errstate(all="ignore"):
        file = File(source, bytes_of(source), metres, tolerance, layers, joins)
        return _aperture_of(_load_any_format(file), joins)


def read_polyhedron(path: str | os.PathLike[str], unit: str | float = "mm") -> Polyhedron:
    """Read a body from a mesh file (``.stl``, ``.ply``, ``.obj``).

    Vertices that differ by less than 1e-9 of the mesh's size are merged (in single precision: by at
    most two units in the last place). Faces of more than three vertices, convex or not, are split
    into triangles. Colours, normals and materials are ignored. A closed surface that is inside out
    is reversed; a surface inside another one is a cavity (see :class:`Polyhedron`).

    Parameters
    ----------
    path : str or path-like
        Mesh file, text or binary.
    unit : str or float, default "mm"
        Length of one unit of the file, as for :func:`read_aperture`. None of these formats
        specifies its unit.

    Returns
    -------
    Polyhedron
        The body in metres.

    Raises
    ------
    FileFormatError
        If the file is missing, empty, too large (64 MiB, 200 000 triangles) or damaged.
    GeometryError
        If a face crosses itself, or a surface is not closed, not consistently oriented, or encloses
        no volume.
    QuantityError
        If the unit cannot be parsed.
    ArgumentError
        If the path is invalid.

    Warns
    -----
    PolywignerWarning
        If a face is not planar.

    Examples
    --------
    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "body.obj"
    >>> faces = "f 1 3 2\\nf 1 2 4\\nf 2 3 4\\nf 1 4 3\\n"
    >>> _ = path.write_text("v 0 0 0\\nv 1 0 0\\nv 0 1 0\\nv 0 0 1\\n" + faces)
    >>> round(pw.read_polyhedron(path, unit="m").volume, 6)
    0.166667
    """
    return _read_mesh_file(path, unit, Polyhedron)


def read_sheets(path: str | os.PathLike[str], unit: str | float = "mm") -> list[PlacedAperture]:
    """Read a mesh file (``.stl``, ``.ply``, ``.obj``), open or closed, as thin plates.

    Each plate has two sides. Triangles in one plane form one plate. :func:`rcs` takes the list as a
    body, and :func:`amplitude` takes it as obstacles. Read closed bodies with
    :func:`read_polyhedron`: their inner sides are not illuminated, and their facets can form smooth
    surfaces.

    Parameters
    ----------
    path : str or path-like
        Mesh file, text or binary.
    unit : str or float, default "mm"
        Length of one unit of the file, as for :func:`read_polyhedron`.

    Returns
    -------
    list of PlacedAperture
        The plates in metres.

    Raises
    ------
    GeometryError
        If no triangle has an area. Other errors are the same as for :func:`read_polyhedron`.

    Examples
    --------
    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "corner.obj"
    >>> faces = "f 1 2 3\\nf 1 3 4\\nf 1 4 2\\n"
    >>> _ = path.write_text("v 0 0 0\\nv 1 0 0\\nv 0 1 0\\nv 0 0 1\\n" + faces)
    >>> [round(plate.aperture.area, 6) for plate in pw.read_sheets(path, unit="m")]
    [0.5, 0.5, 0.5]
    """
    return _read_mesh_file(path, unit, _plates_of)


def read_triangles(
    path: str | os.PathLike[str], unit: str | float
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return vertices (n, 3) in metres and triangles (m, 3), as vertex indices, of a mesh file.

    ``unit`` and errors are the same as for :func:`read_polyhedron`, but open meshes are accepted.
    """
    return _read_mesh_file(path, unit, lambda vertices, triangles: (vertices, triangles))


def _read_mesh_file(
    path: str | os.PathLike[str],
    unit: str | float,
    build: Callable[[NDArray[np.float64], NDArray[np.intp]], T],
) -> T:
    """Read a mesh file, and return ``build(vertices, triangles)`` with vertices in metres.

    The path is added to the messages of errors.
    """
    metres, source = _metres(unit), checked_path(path)
    with at_key(str(source)), np.errstate(all="ignore"):
        kind = checked_suffix(source, MESH_SUFFIXES, "read outlines with polywigner.read_aperture")
        vertices, triangles = read_mesh(bytes_of(source), kind)
        return build(_in_metres(vertices, metres), triangles)


# Step to which normals and relative heights are rounded; triangles with equal rounded values form
# one plate.
_ONE_PLANE = 1e-12
# Largest relative loss of area in a union that counts as rounding error.
_LOST = 1e-9


def _plates_of(vertices: NDArray[np.float64], faces: NDArray[np.intp]) -> list[PlacedAperture]:
    """Return plates made of triangles (m, 3) with vertices (n, 3), one plate for each plane."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    longest = np.ptp(corners, axis=1).max(axis=1)
    wide = lengths > _ONE_PLANE * longest**2
    if not wide.any():
        raise GeometryError(
            "expected triangles with nonzero area, got only degenerate triangles; export the "
            "mesh again"
        )
    corners, normals = corners[wide], normals[wide] / lengths[wide, None]
    # Plates have no front, so the normals of parallel triangles are given the same sign.
    largest = np.take_along_axis(normals, np.abs(normals).argmax(axis=1)[:, None], axis=1)
    normals = normals * np.sign(largest)
    heights = (normals * corners[:, 0]).sum(axis=1, keepdims=True) / np.ptp(vertices, axis=0).max()
    rows = np.round(np.concatenate([normals, heights], axis=1) / _ONE_PLANE) + 0.0
    number = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(number, kind="stable")
    groups = np.split(corners[order], np.flatnonzero(np.diff(number[order])) + 1)
    return [plate for group in groups for plate in _plates_in_plane(group)]


def _plates_in_plane(corners: NDArray[np.float64]) -> list[PlacedAperture]:
    """Return triangles (n, 3, 3) in one plane as one plate, or as n plates if GEOS loses area."""
    origin, sides = corners[0, 0], corners[0, 1:] - corners[0, 0]
    x = sides[0] / np.linalg.norm(sides[0])
    z = np.cross(*sides)
    z /= np.linalg.norm(z)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), origin
    triangles = shapely.polygons((corners - origin) @ pose[:3, :2])
    union = shapely.union_all(triangles)
    is_lossy = shapely.area(triangles).sum() - union.area > _LOST * union.area
    outlines = triangles if is_lossy and len(corners) > 1 else [union]
    return [Aperture(outline).placed(pose) for outline in outlines]
