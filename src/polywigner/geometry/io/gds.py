"""Polygons and paths of a GDSII layout, as gdstk reads them in a process of its own."""

from __future__ import annotations

import importlib
import re
from functools import partial
from typing import Any

from polywigner.errors import ArgumentError, FileFormatError
from polywigner.geometry.exact import Ring
from polywigner.geometry.io.drawing import Drawing, File, Format, overlap_remedy
from polywigner.geometry.io.limits import (
    LARGEST_NUMBER,
    check_rings,
    check_vertices,
    in_process,
)
from polywigner.geometry.io.outlines import Work, filled

_LAYER = re.compile(r"\d{1,5}(?:/\d{1,5})?")


# Of all layers together: more than are read of one.
_MOST_POLYGONS = 200_000


def _chosen(library: Any, name: str | None) -> Any:
    cells = {cell.name: cell for cell in library.cells if hasattr(cell, "get_polygons")}
    top = [cell.name for cell in library.top_level() if cell.name in cells]
    if name is None and len(top) == 1:
        return cells[top[0]]
    if name not in cells:
        wanted = "one top cell" if name is None else f"a cell or layer of the file ({name!r})"
        listed = ", ".join(sorted(top if name is None else cells)[:12])
        raise FileFormatError(f"expected {wanted}, got the cells {listed}; name a cell as layer")
    return cells[name]


def _count(cell: Any, known: dict[str, int]) -> int:
    """The polygons and paths of a cell with all that it refers to."""
    if cell.name not in known:
        known[cell.name] = _MOST_POLYGONS + 1  # of a cell that contains itself
        own = (*cell.polygons, *cell.paths)
        count = sum(max(1, item.repetition.size) for item in own)
        for reference in cell.references:
            if hasattr(reference.cell, "references"):  # not one that is missing
                count += max(1, reference.repetition.size) * _count(reference.cell, known)
        known[cell.name] = count
    return known[cell.name]


def _polygons(
    path: str, cell: str | None, layers: list[list[int]]
) -> tuple[float, list[Ring], list[str]]:
    """The unit, the rings and their layers: run in a process of its own."""
    gdstk: Any = importlib.import_module("gdstk")
    library = gdstk.read_gds(path)
    chosen = _chosen(library, cell)
    if _count(chosen, {}) > _MOST_POLYGONS:
        raise FileFormatError(
            f"expected at most {_MOST_POLYGONS} polygons in a cell, those of references counted "
            "each time, got more; choose another cell"
        )
    polygons = chosen.get_polygons()
    there = sorted({(polygon.layer, polygon.datatype) for polygon in polygons})
    for wanted in layers:
        if not any(list(pair[: len(wanted)]) == wanted for pair in there):
            listed = ", ".join(f"{layer}/{kind}" for layer, kind in there[:12])
            raise FileFormatError(
                f"expected a layer of the cell, got {'/'.join(map(str, wanted))}; it has {listed}"
            )
    kept = [
        polygon
        for polygon in polygons
        if not layers
        or any([polygon.layer, polygon.datatype][: len(wanted)] == wanted for wanted in layers)
    ]
    check_vertices(sum(polygon.size for polygon in kept))
    return (
        float(library.unit),
        [polygon.points for polygon in kept],
        [f"{polygon.layer}/{polygon.datatype}" for polygon in kept],
    )


def read_gds(file: File) -> Drawing:
    """The polygons of one cell, references included, in metres; paths have their widths.

    Layers: "1" for a layer with all its data types, "1/0" for one of them. Any other text names the
    cell, which otherwise is the only one that no other contains.

    Raises FileFormatError; ArgumentError for several cells.
    """
    cells = [name for name in file.layers if not _LAYER.fullmatch(name)]
    if len(cells) > 1:
        raise ArgumentError(f"expected one cell, got {', '.join(cells)}; read them one by one")
    wanted = [[int(n) for n in name.split("/")] for name in file.layers if name not in cells]
    read = partial(_polygons, str(file.path.resolve()), cells[0] if cells else None, wanted)
    metres, rings, layers = in_process(
        read, "GDSII", "gdstk", "save one cell alone", "export it anew, or as DXF"
    )
    if not rings:
        raise FileFormatError("expected polygons or paths in the cell, got none")
    check_rings(len(rings))
    if not 0 < metres < LARGEST_NUMBER or not all((abs(r) < LARGEST_NUMBER).all() for r in rings):
        raise FileFormatError("expected finite coordinates and a unit above zero, got others")
    # Holes of a polygon are cuts that lead to them: the rule opens them.
    work = Work()
    polygons = [polygon for ring in rings for polygon in filled([ring], "nonzero", work)]
    if not polygons:
        raise FileFormatError("expected polygons that enclose an area, got none that do")
    return Drawing(polygons, metres, overlap_remedy(rings, layers))


# 16 MiB hold some 250 000 rectangles.
FORMATS = (Format("GDSII", (".gds",), read_gds, rb"\x00\x06\x00\x02", 16 * 2**20, "gdstk", True),)
