"""Readers of STL, PLY and OBJ meshes; corners that differ only by rounding are merged."""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError
from polywigner.geometry.arguments import check_most, warn_caller
from polywigner.geometry.io.limits import MOST_FACES, check_coordinates
from polywigner.geometry.polyhedron import heights_of, triangulate_faces
from polywigner.geometry.rings import extent
from polywigner.numerics import cluster_indices

MESH_SUFFIXES = (".stl", ".ply", ".obj")

Points = NDArray[np.float64]
Face = tuple[int, ...]

# Largest distance between vertices that are merged, as a fraction of the mesh size; CAD programs
# write the corners of each face with separate rounding errors of up to 1e-12.
_WELD = 1e-9
# Largest difference between float32 coordinates that are merged, in units of the last place.
_LAST_DIGITS = 2
# Largest distance of a vertex from the plane of its face, as a fraction of the mesh size;
# coordinates with six digits are accurate enough.
_PLANAR = 1e-5


@dataclass(frozen=True, eq=False)
class Mesh:
    """Vertices (n, 3) in the file's unit, and faces as lists of vertex indices."""

    vertices: Points
    faces: list[Face]
    precision: float
    """Relative rounding error of the coordinates in the file."""


_DOUBLE, _SINGLE = float(np.finfo(np.float64).eps), float(np.finfo(np.float32).eps)


def read_mesh(content: bytes, suffix: str) -> tuple[Points, NDArray[np.intp]]:
    """Return vertices (n, 3) in the file's unit and triangles (m, 3) of an STL, PLY or OBJ file.

    ``suffix``: ".stl", ".ply" or ".obj", in lower case. Raises FileFormatError if the file is
    damaged or contains no faces. Faces that are not planar cause a warning.
    """
    readers: dict[str, Callable[[bytes], Mesh]] = {".stl": _stl, ".ply": _ply, ".obj": _obj}
    kind = suffix.removeprefix(".").upper()
    try:
        mesh = readers[suffix](content)
    except FileFormatError:
        raise
    except (ValueError, IndexError, KeyError, OverflowError, TypeError) as error:
        raise FileFormatError(
            f"expected {kind}, got a file whose text or numbers do not follow the format "
            f"({type(error).__name__}); export the body again"
        ) from None
    if not mesh.faces:
        raise FileFormatError("the file contains no triangles; export the body as a mesh")
    check_most(len(mesh.faces), MOST_FACES, "triangles", "simplify the mesh", FileFormatError)
    least, most = min(map(min, mesh.faces)), max(map(max, mesh.faces))
    if least < 0 or most >= len(mesh.vertices):
        raise FileFormatError(
            f"expected {kind} faces with vertex numbers up to {len(mesh.vertices)}, got a vertex "
            "number outside this range; export the body again"
        )
    check_coordinates(mesh.vertices)
    mesh = _welded(mesh)
    if not mesh.faces:
        raise FileFormatError(
            "expected triangles with nonzero area, got only degenerate triangles; export the "
            "body again"
        )
    return _triangulated(mesh)


def _triangulated(mesh: Mesh) -> tuple[Points, NDArray[np.intp]]:
    """Return vertices (n, 3) and triangles (m, 3) of a mesh; warn of faces that are not planar."""
    heights = heights_of(mesh.vertices, mesh.faces)
    worst = int(heights.argmax())
    if heights[worst] > _PLANAR * extent(mesh.vertices):
        warn_caller(
            f"face {worst} of the mesh is not planar: a vertex is {heights[worst]:.3g} file units "
            "away from the plane of the face, so the body depends on the division of the face "
            "into triangles; export the mesh as triangles"
        )
    return mesh.vertices, triangulate_faces(mesh.vertices, mesh.faces)


def _welded(mesh: Mesh) -> Mesh:
    """Merge vertices that differ only by rounding, and remove degenerate faces.

    Faces that have become lines or points are dropped.
    """
    points = mesh.vertices + 0.0
    reach = _WELD * extent(points)
    if mesh.precision > _DOUBLE:
        reach = max(reach, _LAST_DIGITS * mesh.precision * float(np.abs(points).max()))
    cluster = cluster_indices(points, reach)
    _, first = np.unique(cluster, return_index=True)
    numbers = cluster.tolist()
    faces = []
    for face in mesh.faces:
        merged = tuple(numbers[k] for k in face)
        if len(set(merged)) < len(merged):
            merged = tuple(k for n, k in enumerate(merged) if k != merged[n - 1])
        if len(set(merged)) > 2:
            faces.append(merged)
    return Mesh(points[first], faces, mesh.precision)


_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(rb"(?i)\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")
_END_OF_FACET = re.compile(rb"(?i)\bend\s*facet\b")
_END_OF_SOLID = re.compile(rb"^\s*end\s*solid\b[^\n]*\s*\Z", re.MULTILINE | re.IGNORECASE)


def _stl(content: bytes) -> Mesh:
    """Parse an STL file in binary or text format."""
    count = int.from_bytes(content[80:84], "little")
    if len(content) == 84 + 50 * count:
        corners = np.frombuffer(content, _FACET, count, 84)["corners"].astype(np.float64)
        return _of_corners(corners, _SINGLE)
    if b"\0" in content:
        raise FileFormatError(
            "expected a binary STL file of 84 + 50 n bytes for n triangles, got "
            f"{len(content)} bytes and {count} triangles in the header; export the body again"
        )
    vertices = _VERTEX.findall(content)
    facets = len(_END_OF_FACET.findall(content))
    if len(vertices) != 3 * facets:
        raise FileFormatError(
            f"expected three vertices in each facet of an STL file, got {len(vertices)} vertices "
            f"in {facets} facets; the file may be damaged or truncated: export the body again"
        )
    if facets and not _END_OF_SOLID.search(content):
        raise FileFormatError(
            "expected an STL file that ends with the line endsolid, got a file without this "
            "line, which may be truncated; export the body again, or add the line"
        )
    return _of_corners(
        np.array(vertices, dtype=bytes).astype(np.float64).reshape(-1, 3, 3), _DOUBLE
    )


def _of_corners(corners: Points, precision: float) -> Mesh:
    """Return a mesh of triangles with corners (m, 3, 3), which do not share vertices."""
    numbers = np.arange(3 * len(corners)).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), list(map(tuple, numbers.tolist())), precision)


def _obj(content: bytes) -> Mesh:
    """Parse the vertices and faces of an OBJ file; raise FileFormatError for curves."""
    vertices: list[list[float]] = []
    faces: list[Face] = []
    for line in content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        word, *values = line.partition(b"#")[0].split() or [b""]
        if word == b"v":
            x, y, z = values[:3]
            vertices.append([float(x), float(y), float(z)])
        elif word in (b"f", b"fo"):
            numbers = [int(value.partition(b"/")[0]) for value in values]
            # Negative OBJ indices count backwards from the latest vertex.
            faces.append(tuple(n - 1 if n > 0 else len(vertices) + n if n else -1 for n in numbers))
            if len(numbers) < 3:
                raise ValueError
        elif word in (b"curv", b"curv2", b"surf"):
            raise FileFormatError(
                "expected an OBJ file with polygons, got free-form curves or surfaces; "
                "export a mesh"
            )
    return Mesh(np.array(vertices, dtype=np.float64).reshape(-1, 3), faces, _DOUBLE)


_NUMBERS = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f",
    "double": "d", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "float32": "f", "float64": "d",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
_HEADER = re.compile(rb"ply\s(.*?)^end_header[ \t]*\r?\n?", re.MULTILINE | re.DOTALL)

Property = tuple[str, str, str]
"""Name of a PLY property, its type, and the type of the length if the property is a list."""
ReadNumbers = Callable[[str], Sequence[Any]]
"""Function that reads the next numbers, in a given `struct` format."""


def _ply(content: bytes) -> Mesh:
    """Parse the vertices and faces of a PLY file in binary or text format."""
    header = _HEADER.match(content)
    if header is None:
        raise FileFormatError(
            "expected a PLY mesh, got a file without a PLY header; export the mesh again"
        )
    form, elements = _parsed_header(header[1].decode("ascii", "replace"))
    body = content[header.end() :]
    read, is_empty = _text_reader(body) if form == "ascii" else _binary_reader(body, _ORDERS[form])
    try:
        rows = {
            name: [_element_row(properties, read) for _ in range(count)]
            for name, count, properties in elements
        }
    # A StopIteration in a generator becomes a RuntimeError, so both exceptions are caught.
    except (StopIteration, RuntimeError, struct.error):
        raise _row_count_error("fewer") from None
    if not is_empty():
        raise _row_count_error("more")
    vertices = np.array([[row[axis] for axis in "xyz"] for row in rows["vertex"]], dtype=float)
    faces = [
        tuple(map(int, row.get("vertex_indices", row.get("vertex_index")) or ()))
        for row in rows.get("face", ())
    ]
    if any(len(face) < 3 for face in faces):
        raise ValueError
    types = {kind for name, _, properties in elements if name == "vertex"
             for axis, kind, _ in properties if axis in "xyz"}  # fmt: skip
    precision = _SINGLE if form != "ascii" and types == {"f"} else _DOUBLE
    return Mesh(vertices.reshape(-1, 3), faces, precision)


def _parsed_header(text: str) -> tuple[str, list[tuple[str, int, list[Property]]]]:
    """Return a PLY file's format, and the name, row count and properties of each element."""
    form = ""
    elements: list[tuple[str, int, list[Property]]] = []
    for line in text.splitlines():
        word, *values = line.split() or [""]
        if word == "format":
            form = values[0]
        elif word == "element":
            elements.append((values[0], int(values[1]), []))
        elif word == "property" and values[0] == "list":
            elements[-1][2].append((values[3], _NUMBERS[values[2]], _NUMBERS[values[1]]))
        elif word == "property":
            elements[-1][2].append((values[1], _NUMBERS[values[0]], ""))
    if form not in ("ascii", *_ORDERS):
        raise ValueError
    return form, elements


def _element_row(properties: list[Property], read: ReadNumbers) -> dict[str, Any]:
    """Read one row of an element of a PLY file: the value or list of each property."""
    return {
        name: read(kind * read(length)[0]) if length else read(kind)[0]
        for name, kind, length in properties
    }


def _text_reader(body: bytes) -> tuple[ReadNumbers, Callable[[], bool]]:
    """Return a reader of numbers in text, and a test that is true at the end of the text.

    The reader returns a number for each letter of a `struct` format, such as "fff". The test
    consumes a number, so call it only after the last call of the reader.
    """
    words = iter(body.split())

    def read(form: str) -> Sequence[Any]:
        """Read numbers; ``form`` contains the `struct` letter of the type of each number."""
        return [float(next(words)) if kind in "fd" else int(next(words)) for kind in form]

    return read, lambda: next(words, None) is None


def _binary_reader(body: bytes, order: str) -> tuple[ReadNumbers, Callable[[], bool]]:
    """Return a reader of binary numbers, and a test that is true at the end of the data.

    The reader returns a number for each letter of a `struct` format, such as "fff". ``order``: "<"
    for little-endian and ">" for big-endian numbers.
    """
    stream = io.BytesIO(body)

    def read(form: str) -> Sequence[Any]:
        """Read numbers; ``form`` contains the `struct` letter of the type of each number."""
        return struct.unpack(order + form, stream.read(struct.calcsize(order + form)))

    return read, lambda: not stream.read().strip()


def _row_count_error(got: str) -> FileFormatError:
    """Return the error for a PLY file with "fewer" or "more" rows than its header specifies."""
    return FileFormatError(
        f"expected as many rows as the header of the PLY file specifies, got {got}; the file may "
        "be truncated: export the mesh again"
    )
