"""Polygons and paths of a GDSII layout, as gdstk reads them in a process of its own."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from polywigner.errors import ArgumentError, FileFormatError
from polywigner.geometry.io import gds_process
from polywigner.geometry.io.limits import (
    LARGEST_GDS,
    LARGEST_NUMBER,
    MOST_VERTICES,
    Work,
    check_rings,
    in_process,
)
from polywigner.geometry.io.outlines import Drawing, filled, overlap_remedy, required

_REMEDIES = ("save one cell alone", "export it anew, or as DXF")
_LAYER = re.compile(r"\d{1,5}(?:/\d{1,5})?")


def read_gds(path: Path, content: bytes, layers: Sequence[str] = ()) -> Drawing:
    """The polygons of one cell, references included, in metres; paths have their widths.

    Parameters
    ----------
    path, content
        The file and its bytes.
    layers
        To read alone: "1" for a layer with all its data types, "1/0" for one of them. Any other
        text names the cell, which otherwise is the only one that no other contains.

    Raises
    ------
    FileFormatError, MissingExtraError; ArgumentError for several cells.
    """
    if len(content) > LARGEST_GDS:
        raise FileFormatError(
            f"expected at most {LARGEST_GDS >> 20} MiB of GDSII, got more; save one cell alone"
        )
    required("gdstk", "GDSII")
    cells = [name for name in layers if not _LAYER.fullmatch(name)]
    if len(cells) > 1:
        raise ArgumentError(f"expected one cell, got {', '.join(cells)}; read them one by one")
    asked = {
        "path": str(path.resolve()),
        "cell": cells[0] if cells else None,
        "layers": [[int(n) for n in name.split("/")] for name in layers if name not in cells],
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
