"""Polygons and paths of a GDSII layout, as gdstk reads them."""

from __future__ import annotations

import importlib
import re
from typing import Any

from polywigner.errors import ArgumentError, FileFormatError
from polywigner.geometry.io.drawing import Drawing, File, Format, overlap_remedy
from polywigner.geometry.io.limits import LARGEST_NUMBER
from polywigner.geometry.io.outlines import filled

_LAYER = re.compile(r"\d{1,5}(?:/\d{1,5})?")


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


def read_gds(file: File) -> Drawing:
    """The polygons of one cell, references included, in metres; paths have their widths.

    Layers: "1" for a layer with all its data types, "1/0" for one of them. Any other text names the
    cell, which otherwise is the only one that no other contains.
    """
    cells = [name for name in file.layers if not _LAYER.fullmatch(name)]
    if len(cells) > 1:
        raise ArgumentError(f"expected one cell, got {', '.join(cells)}; read them one by one")
    gdstk: Any = importlib.import_module("gdstk")
    library = gdstk.read_gds(str(file.path))
    polygons = _chosen(library, cells[0] if cells else None).get_polygons()
    wanted = [[int(n) for n in name.split("/")] for name in file.layers if name not in cells]
    there = sorted({(polygon.layer, polygon.datatype) for polygon in polygons})
    for layer in wanted:
        if not any(list(pair[: len(layer)]) == layer for pair in there):
            listed = ", ".join(f"{layer}/{kind}" for layer, kind in there[:12])
            raise FileFormatError(
                f"expected a layer of the cell, got {'/'.join(map(str, layer))}; it has {listed}"
            )
    rings, layers = [], []
    for polygon in polygons:
        pair = [polygon.layer, polygon.datatype]
        is_wanted = not wanted or any(pair[: len(layer)] == layer for layer in wanted)
        if polygon.size and is_wanted:  # a boundary with one point has no size
            rings.append(polygon.points)
            layers.append("/".join(map(str, pair)))
    if not rings:
        raise FileFormatError("expected polygons or paths in the cell, got none")
    metres = float(library.unit)
    if not 0 < metres < LARGEST_NUMBER or not all((abs(r) < LARGEST_NUMBER).all() for r in rings):
        raise FileFormatError("expected finite coordinates and a unit above zero, got others")
    # Holes of a polygon are cuts that lead to them: the rule opens them.
    filled_ones = [polygon for ring in rings for polygon in filled([ring], "nonzero")]
    if not filled_ones:
        raise FileFormatError("expected polygons that enclose an area, got none that do")
    return Drawing(filled_ones, metres, overlap_remedy(rings, layers))


FORMATS = (Format("GDSII", (".gds",), read_gds, rb"\x00\x06\x00\x02", ("gdstk",), True),)
