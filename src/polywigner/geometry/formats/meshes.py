"""Bodies of STL, PLY and OBJ files: trimesh parses, vertices at the same place become one."""

from __future__ import annotations

import io
import re
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError
from polywigner.geometry.formats.drawing import required
from polywigner.geometry.formats.limits import LARGEST_NUMBER, MOST_FACES

__all__ = ["MESH_SUFFIXES", "read_mesh"]

MESH_SUFFIXES = (".stl", ".ply", ".obj")

# trimesh makes a mesh of each solid of an STL file.
_MOST_SOLIDS = 1000

# Vertices, normals, faces and the rest of OBJ, and rows of PLY.
_MOST_LINES = 2_000_000


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
            f"expected {kind.upper()}, got a file that trimesh does not read: "
            f"{type(error).__name__} {' '.join(str(error).split())[:200]}"
        ) from None
    _check(vertices, faces)
    vertices, places = np.unique(vertices + 0.0, axis=0, return_inverse=True)
    faces = places.reshape(-1)[faces]
    a, b, c = faces.T
    return vertices, faces[(a != b) & (b != c) & (c != a)]


def _bounded(content: bytes, kind: str) -> bytes:
    """The content, made UTF-8 where it is text; raises where it announces too much."""
    if kind == "ply":
        header = content[: content.find(b"end_header")]
        for element, count in re.findall(rb"element\s+(\w+)\s+(\d{1,20})", header):
            _check_number(int(count), MOST_FACES if element == b"face" else _MOST_LINES)
        return content
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
        _check_number(content.lower().count(b"endfacet"))
        _check_number(content.lower().count(b"endsolid"), _MOST_SOLIDS)
    else:
        _check_number(content.count(b"\nf"))
        _check_number(content.count(b"\n"), _MOST_LINES)
    return content.decode("utf-8", "replace").encode()


def _check_number(count: int, most: int = MOST_FACES) -> None:
    if count > most:
        what = {_MOST_SOLIDS: "solids", _MOST_LINES: "lines"}.get(most, "triangles")
        raise FileFormatError(f"expected at most {most} {what}, got {count}; simplify the mesh")


def _check(vertices: NDArray[Any], faces: NDArray[Any]) -> None:
    if not len(faces):
        raise FileFormatError("expected triangles, got none; export the body as a mesh")
    _check_number(len(faces))
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FileFormatError(
            f"expected vertex numbers up to {len(vertices)}, got a face with another; correct it"
        )
    if not (np.abs(vertices) <= LARGEST_NUMBER).all():  # also for a NaN
        raise FileFormatError(
            f"expected finite coordinates below {LARGEST_NUMBER:g}, got one beyond; correct it"
        )
