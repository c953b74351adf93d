"""Polygons and paths of a GDSII layout, as gdstk reads them in a process of its own."""

from __future__ import annotations

import re

import numpy as np

from polywigner.errors import ArgumentError, FileFormatError
from polywigner.geometry.io import gds_process
from polywigner.geometry.io.drawing import Drawing, File, Format, overlap_remedy
from polywigner.geometry.io.limits import (
    LARGEST_NUMBER,
    MOST_VERTICES,
    check_rings,
    in_process,
)
from polywigner.geometry.io.outlines import Work, filled

_REMEDIES = ("save one cell alone", "export it anew, or as DXF")
_LAYER = re.compile(r"\d{1,5}(?:/\d{1,5})?")


def read_gds(file: File) -> Drawing:
    """The polygons of one cell, references included, in metres; paths have their widths.

    Layers: "1" for a layer with all its data types, "1/0" for one of them. Any other text names the
    cell, which otherwise is the only one that no other contains.

    Raises FileFormatError; ArgumentError for several cells.
    """
    cells = [name for name in file.layers if not _LAYER.fullmatch(name)]
    if len(cells) > 1:
        raise ArgumentError(f"expected one cell, got {', '.join(cells)}; read them one by one")
    asked = {
        "path": str(file.path.resolve()),
        "cell": cells[0] if cells else None,
        "layers": [[int(n) for n in name.split("/")] for name in file.layers if name not in cells],
        "most": MOST_VERTICES,
    }
    found = in_process(gds_process, asked, "GDSII", "gdstk", _REMEDIES)
    rings = [np.asarray(ring, dtype=np.float64).reshape(-1, 2) for ring in found["rings"]]
    if not rings:
        raise FileFormatError("expected polygons or paths in the cell, got none")
    check_rings(len(rings))
    metres = float(found["unit"])
    if not 0 < metres < LARGEST_NUMBER or not all((abs(r) < LARGEST_NUMBER).all() for r in rings):
        raise FileFormatError("expected finite coordinates and a unit above zero, got others")
    # Holes of a polygon are cuts that lead to them: the rule opens them.
    work = Work()
    polygons = [polygon for ring in rings for polygon in filled([ring], "nonzero", work)]
    if not polygons:
        raise FileFormatError("expected polygons that enclose an area, got none that do")
    return Drawing(polygons, metres, overlap_remedy(rings, found["layers"]))


# 16 MiB hold some 250 000 rectangles.
FORMATS = (Format("GDSII", (".gds",), read_gds, rb"\x00\x06\x00\x02", 16 * 2**20, "gdstk", True),)
