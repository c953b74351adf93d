"""Bodies of STL, PLY and OBJ files: trimesh parses, vertices at the same place become one."""

from __future__ import annotations

import io
import re
import warnings
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError
from polywigner.geometry.io.drawing import required
from polywigner.geometry.io.limits import (
    LONGEST_LINE,
    MOST_FACES,
    check_coordinates,
    check_most,
)

MESH_SUFFIXES = (".stl", ".ply", ".obj")

# The sizes of the numbers of PLY, by the names of their types.
_PLY_TYPES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
    "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8,
    "float64": 8,
}  # fmt: skip
_FACE = re.compile(rb"(?:\A|[\r\n])[ \t]*f\b([^\r\n]*)")
_Element = tuple[str, int, list[list[str]]]
"""Name and number of an element of PLY, with the types of its properties."""

_MOST_IN_A_FACE = 1000
# Solids of an STL file, of each of which trimesh makes a mesh; lines of OBJ, and rows of PLY.
_MOST_SOLIDS = 1000
_MOST_LINES = 2_000_000

_STL_WORDS = (b"facet", b"endfacet", b"vertex")
_STL_LINES = [re.compile(rb"(?i)(?:\A|[\r\n])[ \t]*+%b\b" % word) for word in _STL_WORDS]


def read_mesh(content: bytes, suffix: str) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Vertices (n, 3) in the file's unit and triangles (m, 3) of vertex numbers.

    Faces with more than three vertices become fans of triangles. Vertices with the very same
    coordinates are merged (an STL file repeats them for each triangle), and triangles that use a
    vertex twice afterwards are dropped.

    Raises
    ------
    FileFormatError, MissingExtraError.
    """
    kind = suffix.removeprefix(".")
    trimesh = required("trimesh", kind.upper())
    content = _bounded(content, kind)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy warns of numbers that are none, and goes on
            mesh = trimesh.load_mesh(
                io.BytesIO(content), file_type=kind, process=False, skip_materials=True
            )
        vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except MemoryError:
        raise FileFormatError("expected a mesh that fits into memory, got a larger one") from None
    except Exception as error:  # a damaged file can fail anywhere in trimesh, with any exception
        raise FileFormatError(
            f"expected {kind.upper()}, got a file that trimesh does not read "
            f"({type(error).__name__}); export the body again"
        ) from None
    _check(vertices, faces)
    vertices, places = np.unique(vertices + 0.0, axis=0, return_inverse=True)
    faces = places.reshape(-1)[faces]
    a, b, c = faces.T
    return vertices, faces[(a != b) & (b != c) & (c != a)]


def _bounded(content: bytes, kind: str) -> bytes:
    """The content, made UTF-8 where it is text; raises where it announces too much."""
    if kind == "ply":
        return _bounded_ply(content)
    if kind == "stl":
        count = int.from_bytes(content[80:84], "little")
        if len(content) == 84 + 50 * count:
            _check_number(count)
            return content
    if b"\0" in content:
        raise FileFormatError(
            f"expected binary STL of 84 + 50 n bytes, got {len(content)} that announce {count} "
            "triangles; export the body again"
            if kind == "stl"
            else "expected OBJ as text, got zeros; export the body again"
        )
    if kind == "stl":
        _check_number(content.lower().count(b"endsolid"), _MOST_SOLIDS)
        begun, ended, corners = (len(pattern.findall(content)) for pattern in _STL_LINES)
        _check_number(max(begun, ended))
        if begun > ended or corners != 3 * ended:
            raise FileFormatError(
                f"expected three vertices in each facet, got {ended} facets that end and {corners} "
                "vertices; the file may be cut short: export it again"
            )
    else:
        _check_number(content.count(b"\n"), _MOST_LINES)
        triangles = 0
        for found in _FACE.finditer(content):
            size = found.end() - found.start()  # in memory a line is its words
            count = len(found[1].split()) if size <= LONGEST_LINE else size
            if count > _MOST_IN_A_FACE:
                raise FileFormatError(
                    f"expected faces of at most {_MOST_IN_A_FACE} vertices, got one of more"
                )
            triangles += max(1, count - 2)
        _check_number(triangles)
    return content.decode("utf-8", "replace").encode()


def _bounded_ply(content: bytes) -> bytes:
    """The content; raises where it holds less, or more, than its header announces."""
    end = content.find(b"end_header")
    header = content[: min(end, 2**16)].decode("ascii", "replace").split("\n")
    words = [line.split() for line in header if line.split()]
    kinds = [line[1] for line in words if line[0] == "format" and len(line) > 1]
    body = content[end:].partition(b"\n")[2]
    elements: list[_Element] = []
    for line in words:
        if line[0] == "element" and len(line) == 3 and line[2].isdecimal() and len(line[2]) < 20:
            elements.append((line[1], int(line[2]), []))
            _check_number(elements[-1][1], MOST_FACES if line[1] == "face" else _MOST_LINES)
        elif line[0] == "property" and elements and len(line) in (3, 5):
            elements[-1][2].append(line[1:-1])
    if end < 0 or len(kinds) != 1:
        raise FileFormatError(
            "expected PLY, got a file that is not read: it has no header; export it again"
        )
    announced = sum(count for _, count, _ in elements)
    if kinds[0] == "ascii":
        _check_number(body.count(b"\n"), _MOST_LINES)
        rows = sum(1 for line in body.splitlines() if line.strip())
        _check_announced(announced, rows, "rows")
    else:
        length = _check_binary_ply(body, elements, "big" if "big" in kinds[0] else "little")
        return content[: len(content) - len(body) + length]
    return content


def _check_binary_ply(
    body: bytes, elements: list[_Element], order: Literal["big", "little"]
) -> int:
    """Check the bytes of all elements, where lists tell their lengths."""
    place = 0
    for name, count, properties in elements:
        if not all(map(_is_ply_type, properties)):
            raise FileFormatError(f"expected PLY of numbers, got another type in {name[:40]!r}")
        fixed, lists = 0, []
        for types in properties:
            if len(types) == 3:
                lists.append((fixed, *(_PLY_TYPES[kind] for kind in types[1:])))
                fixed = 0
            else:
                fixed += _PLY_TYPES[types[0]]
        _check_number(count * len(lists), _MOST_LINES)
        if not lists:
            place += count * fixed
            continue
        for _ in range(count):
            for before, head, item in lists:
                place += before
                size = int.from_bytes(body[place : place + head], order)
                place += head + size * item
            place += fixed
            if place > len(body):
                break
    if place > len(body) or body[place:].strip():
        _check_announced(place, len(body), "bytes")
    return place


def _is_ply_type(types: list[str]) -> bool:
    """Whether words are the type of a number, or "list" with the types of length and entries."""
    numbers = types[1:] if len(types) == 3 and types[0] == "list" else types
    return len(numbers) == len(types) // 2 + 1 and set(numbers) <= _PLY_TYPES.keys()


def _check_announced(announced: int, found: int, what: str) -> None:
    if found != announced:
        raise FileFormatError(
            f"expected {announced} {what} after the header, which announces them, got {found}; the "
            "file may be cut short: export it again"
        )


def _check_number(count: int, most: int = MOST_FACES) -> None:
    what = {_MOST_SOLIDS: "solids", _MOST_LINES: "lines"}.get(most, "triangles")
    check_most(count, most, what, "simplify the mesh")


def _check(vertices: NDArray[Any], faces: NDArray[Any]) -> None:
    if not len(faces):
        raise FileFormatError("expected triangles, got none; export the body as a mesh")
    _check_number(len(faces))
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FileFormatError(
            f"expected vertex numbers up to {len(vertices)}, got a face with another; correct it"
        )
    check_coordinates(vertices)
