"""Clouds of scatterers as files: VTK points for ParaView, tables, NetCDF."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_path
from polywigner.propagation.exports import in_place, write_netcdf

SUFFIXES = (".vtp", ".csv", ".nc")

_KINDS = {"float64": "Float64", "int64": "Int64"}


def write_scatterers(cloud: Any, path: str | os.PathLike[str]) -> None:
    """Write a cloud of scatterers to a file, whole or not at all.

    Parameters
    ----------
    cloud : a dataset of :func:`scatterers`.
    path : ``.vtp``, points with their values for ParaView, VisIt and PyVista (ids of shapes and
        emitters as numbers, and their names in the order of these); ``.csv``, a row each with
        position_x, position_y, position_z, ... ; ``.nc``, NetCDF, which needs the extra
        ``volume``. A file that is there is replaced.

    Raises
    ------
    ArgumentError : no cloud, another suffix, a place that cannot be written to;
        MissingExtraError without what NetCDF needs.
    """
    place = checked_path(path)
    columns = _columns(cloud)
    kind = place.suffix.lower()
    if kind not in SUFFIXES:
        raise ArgumentError(
            f"expected a file of {', '.join(SUFFIXES)} for scatterers, got {str(place)!r}"
        )
    if kind == ".nc":
        write_netcdf(cloud, place)
        return
    with in_place(place) as scratch:
        (_write_points if kind == ".vtp" else _write_table)(columns, scratch)


def _columns(cloud: Any) -> dict[str, NDArray[Any]]:
    """(n,) or (n, 3) values by their names."""
    try:
        found = {str(name): np.asarray(array.values) for name, array in cloud.data_vars.items()}
        counts = {len(values) for values in found.values()}
        is_cloud = {"position", "power", "path_length"} <= set(found) and len(counts) == 1
    except (AttributeError, TypeError):
        is_cloud = False
    if not is_cloud:
        raise ArgumentError(
            f"expected a cloud of polywigner.mitsuba.scatterers, got {type(cloud).__name__}"
        )
    return found


def _write_table(columns: dict[str, NDArray[Any]], path: Path) -> None:
    flat: dict[str, list[Any]] = {}
    for name, values in columns.items():
        if values.ndim == 2:
            flat |= {f"{name}_{a}": values[:, k].tolist() for k, a in enumerate("xyz")}
        else:
            flat[name] = values.tolist()
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(flat)
        writer.writerows(zip(*flat.values(), strict=True))


def _write_points(columns: dict[str, NDArray[Any]], path: Path) -> None:
    count = len(columns["power"])
    texts = {name: values for name, values in columns.items() if values.dtype.kind in "UO"}
    of_points = {n: v for n, v in columns.items() if n != "position" and n not in texts}
    names = {}
    for name, values in texts.items():
        names[name], numbers = np.unique(values.astype(str), return_inverse=True)
        of_points[name] = numbers.reshape(-1)
    file = _Points()
    file.add("<FieldData>")
    for name, known in names.items():
        # VTK's texts: bytes that end with zero
        text = "".join(f"{word}\0" for word in known.tolist()).encode()
        codes = " ".join(str(byte) for byte in text)
        file.add(
            f'<DataArray type="String" Name="{name}_names" NumberOfTuples="{len(known)}" '
            f'format="ascii">{codes}</DataArray>'
        )
    file.add("</FieldData>")
    file.add(
        f'<Piece NumberOfPoints="{count}" NumberOfVerts="{count}" NumberOfLines="0" '
        'NumberOfStrips="0" NumberOfPolys="0">'
    )
    file.add('<PointData Scalars="power" Normals="normal">')
    for name, values in of_points.items():
        file.array(name, values)
    file.add("</PointData><Points>")
    file.array("position", columns["position"])
    file.add("</Points><Verts>")
    file.array("connectivity", np.arange(count))
    file.array("offsets", np.arange(1, count + 1))
    file.add("</Verts></Piece>")
    path.write_bytes(file.content())


class _Points:
    """VTK's XML of points, with its arrays behind it."""

    def __init__(self) -> None:
        self._lines = [
            '<?xml version="1.0"?>',
            '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" '
            'header_type="UInt64">',
            "<PolyData>",
        ]
        self._data = bytearray()

    def add(self, line: str) -> None:
        self._lines.append(line)

    def array(self, name: str, values: NDArray[Any]) -> None:
        """An array, (n,) or (n, 3)."""
        wide = np.asarray(values, np.float64 if values.dtype.kind == "f" else np.int64)
        parts = 1 if wide.ndim == 1 else wide.shape[1]
        self.add(
            f'<DataArray type="{_KINDS[wide.dtype.name]}" Name="{name}" '
            f'NumberOfComponents="{parts}" format="appended" offset="{len(self._data)}"/>'
        )
        self._data += np.uint64(wide.nbytes).astype("<u8").tobytes()
        self._data += wide.astype(wide.dtype.newbyteorder("<")).tobytes()

    def content(self) -> bytes:
        head = "\n".join([*self._lines, "</PolyData>", '<AppendedData encoding="raw">', "_"])
        return head.encode() + bytes(self._data) + b"\n</AppendedData>\n</VTKFile>\n"
