"""Bodies of STL, PLY and OBJ files: trimesh parses, vertices at the same place become one."""

from __future__ import annotations

import io
import re
import warnings
from importlib import import_module
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, GeometryError
from polywigner.geometry.aperture import Aperture, PlacedAperture
from polywigner.geometry.io.limits import MOST_FACES, check_coordinates, check_most

MESH_SUFFIXES = (".stl", ".ply", ".obj")


def read_mesh(content: bytes, suffix: str) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Vertices (n, 3) in the file's unit and triangles (m, 3) of vertex numbers.

    Faces of more vertices become fans; vertices with the very same coordinates are merged (STL
    repeats them for each triangle), and triangles that then use one twice are dropped.
    """
    kind = suffix.removeprefix(".")
    trimesh: Any = import_module("trimesh")
    content = _checked(content, kind)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy warns of numbers that are none, and goes on
            mesh = trimesh.load_mesh(
                io.BytesIO(content), file_type=kind, process=False, skip_materials=True
            )
        vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except MemoryError:
        raise
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


def _checked(content: bytes, kind: str) -> bytes:
    """The content, made UTF-8 where it is text; raises where trimesh would not see a cut."""
    if kind == "ply":
        _check_rows(content)
        return content
    count = int.from_bytes(content[80:84], "little") if kind == "stl" else 0
    if kind == "stl" and len(content) == 84 + 50 * count:
        return content
    if b"\0" in content:
        raise FileFormatError(
            f"expected binary STL of 84 + 50 n bytes, got {len(content)} that announce {count} "
            "triangles; export the body again"
            if kind == "stl"
            else "expected OBJ as text, got zeros; export the body again"
        )
    return content.decode("utf-8", "replace").encode()


_ELEMENT = re.compile(rb"^element[ \t]+\w+[ \t]+(\d{1,19})", re.MULTILINE)


def _check_rows(content: bytes) -> None:
    """Raise for PLY as text of less, or more, rows than its header announces."""
    header, _, body = content.partition(b"end_header")
    if b"format ascii" not in header:
        return  # trimesh compares bytes
    announced = sum(map(int, _ELEMENT.findall(header)))
    rows = sum(1 for line in body.partition(b"\n")[2].splitlines() if line.strip())
    if rows != announced:
        raise FileFormatError(
            f"expected {announced} rows after the header, which announces them, got {rows}; the "
            "file may be cut short: export it again"
        )


def _check(vertices: NDArray[Any], faces: NDArray[Any]) -> None:
    if not len(faces):
        raise FileFormatError("expected triangles, got none; export the body as a mesh")
    check_most(len(faces), MOST_FACES, "triangles", "simplify the mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FileFormatError(
            f"expected vertex numbers up to {len(vertices)}, got a face with another; correct it"
        )
    check_coordinates(vertices)


# Grid of normals and of heights over the size of a mesh: triangles on one point of it are one
# plate.
_ONE_PLANE = 1e-12
# Share of the area that rounding may take from a union.
_LOST = 1e-9


def plates_of(vertices: NDArray[np.float64], faces: NDArray[np.intp]) -> list[PlacedAperture]:
    """Return triangles (m, 3) of vertices (n, 3) as plates, one plate for each plane."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    longest = np.ptp(corners, axis=1).max(axis=1)
    wide = lengths > _ONE_PLANE * longest**2
    if not wide.any():
        raise GeometryError("expected triangles with an area, got none; export the mesh again")
    corners, normals = corners[wide], normals[wide] / lengths[wide, None]
    # both sides are the same: the largest component of a normal is positive
    largest = np.take_along_axis(normals, np.abs(normals).argmax(axis=1)[:, None], axis=1)
    normals = normals * np.sign(largest)
    heights = (normals * corners[:, 0]).sum(axis=1, keepdims=True) / np.ptp(vertices, axis=0).max()
    rows = np.round(np.concatenate([normals, heights], axis=1) / _ONE_PLANE) + 0.0
    number = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(number, kind="stable")
    groups = np.split(corners[order], np.flatnonzero(np.diff(number[order])) + 1)
    return [plate for group in groups for plate in _plates(group)]


def _plates(corners: NDArray[np.float64]) -> list[PlacedAperture]:
    """One plate of triangles (n, 3, 3) of a plane; or one of each, where GEOS loses some."""
    origin, sides = corners[0, 0], corners[0, 1:] - corners[0, 0]
    x = sides[0] / np.linalg.norm(sides[0])
    z = np.cross(*sides)
    z /= np.linalg.norm(z)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), origin
    triangles = shapely.polygons((corners - origin) @ pose[:3, :2])
    whole = shapely.union_all(triangles)
    lost = shapely.area(triangles).sum() - whole.area > _LOST * whole.area
    outlines = triangles if lost and len(corners) > 1 else [whole]
    return [Aperture(outline).placed(pose) for outline in outlines]
