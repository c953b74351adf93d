"""Reader of polygons and paths in a GDSII layout, parsed by gdstk."""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Iterable, Iterator
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Any

import numpy as np

from polywigner.errors import ArgumentError, FileFormatError
from polywigner.geometry.io.limits import check_coordinates
from polywigner.geometry.io.outlines import DEFAULT_TOLERANCE, Drawing, File, filled
from polywigner.geometry.rings import Ring

if TYPE_CHECKING:
    import gdstk

_LAYER = re.compile(r"\d{1,5}(?:/\d{1,5})?")
# Type of the GDSII record STRANS, and mask of its bits for absolute magnification and angle.
_TRANSFORMATION, _ABSOLUTE = 0x1A, 0x0006


def _requested_cell(library: Any, name: str | None) -> gdstk.Cell:
    """Return the cell with a name, or the only top-level cell if the name is None.

    Raises FileFormatError if there is no such cell.
    """
    cells = {cell.name: cell for cell in library.cells if hasattr(cell, "get_polygons")}
    top = [cell.name for cell in library.top_level() if cell.name in cells]
    if name is None and len(top) == 1:
        return cells[top[0]]
    if name not in cells:
        expected = (
            "a layout with one top cell"
            if name is None
            else f"a cell or layer of the file ({name!r})"
        )
        listed = ", ".join(sorted(top if name is None else cells)[:12])
        raise FileFormatError(
            f"expected {expected}, got the cells {listed}; pass the name of a cell as layer"
        )
    return cells[name]


def _check_transformations(content: bytes) -> None:
    """Raise FileFormatError for absolute transformations, which gdstk treats as relative."""
    position = 0
    while size := int.from_bytes(content[position : position + 2], "big"):
        flags = content[position + 4 : position + 6]
        if content[position + 2] == _TRANSFORMATION and int.from_bytes(flags, "big") & _ABSOLUTE:
            raise FileFormatError(
                "expected references that rotate and scale with their cell, got an absolute "
                "magnification or angle; flatten the layout"
            )
        position += max(size, 4)


def _check_references(cells: Iterable[Any]) -> None:
    """Raise FileFormatError if a cell refers to a cell that the file does not contain."""
    for cell in cells:
        for reference in cell.references:
            if isinstance(reference.cell, str):
                raise FileFormatError(
                    f"cell {cell.name!r} refers to the cell {reference.cell[:60]!r}, which "
                    "the file does not contain; export the layout with its libraries"
                )


def _check_cycles(cells: Iterable[Any]) -> None:
    """Raise FileFormatError if a cell contains itself, which makes gdstk abort the process."""
    inner = {
        cell.name: [ref.cell.name for ref in cell.references if not isinstance(ref.cell, str)]
        for cell in cells
        if hasattr(cell, "references")
    }
    try:
        TopologicalSorter(inner).prepare()
    except CycleError as error:
        raise FileFormatError(
            "expected cells that do not contain themselves, got "
            f"{' in '.join(error.args[1])[:120]}; correct the references"
        ) from None


def _layer_names(layer: int, data_type: int) -> tuple[str, str]:
    """Return the two names of a layer, "layer" and "layer/data type"."""
    return f"{layer}", f"{layer}/{data_type}"


def _shapes(cell: Any) -> Iterator[tuple[str, str, Ring]]:
    """Yield two layer names and the outline (n, 2) of each polygon and path, in the file's unit.

    The polygons and paths of referenced cells are included.
    """
    for polygon in cell.get_polygons(include_paths=False):
        yield *_layer_names(polygon.layer, polygon.datatype), polygon.points
    # get_polygons loses the absolute widths of paths in references.
    for path in cell.get_paths():
        for polygon in path.to_polygons():
            yield *_layer_names(path.layers[0], path.datatypes[0]), polygon.points


def load_gds(file: File) -> Drawing:
    """Load the polygons and paths of one cell, including the cells to which it refers.

    A layer name is "1" for all data types of layer 1, or "1/0" for a single data type. Any other
    name selects the cell; the default is the only top-level cell.
    """
    cells = [name for name in file.layers if not _LAYER.fullmatch(name)]
    if len(cells) > 1:
        raise ArgumentError(
            f"expected the name of one cell, got {', '.join(cells)}; read each cell separately"
        )
    library: Any = importlib.import_module("gdstk").read_gds(str(file.path))
    metres = float(library.unit)
    if not 0 < metres < math.inf:
        raise FileFormatError(
            f"expected a database unit above zero, got {metres:g} m; export the layout again"
        )
    cell: Any = _requested_cell(library, cells[0] if cells else None)
    _check_cycles(library.cells)
    members = [cell, *cell.dependencies(True)]
    _check_references(members)
    _check_transformations(file.content)
    requested = {re.sub(r"\b0+(?=\d)", "", name) for name in file.layers if name not in cells}
    for path in [path for member in members for path in member.paths]:
        length = float(np.hypot(*np.ptp(path.spine(), axis=0)))
        names = _layer_names(path.layers[0], path.datatypes[0])
        if length == 0 and not (requested and requested.isdisjoint(names)):
            # gdstk silently drops paths of length zero, so they raise an error here.
            raise FileFormatError(
                "expected paths of nonzero length, got a path of length zero on layer "
                f"{names[1]}; draw a polygon instead"
            )
        size = length + float(path.widths().max())
        path.tolerance = file.tolerance / metres if file.tolerance else DEFAULT_TOLERANCE * size
    # Boundaries without extent have no points and are dropped.
    shapes = [shape for shape in _shapes(cell) if len(shape[2])]
    if missing := requested - {name for layer, kind, _ in shapes for name in (layer, kind)}:
        listed = ", ".join(sorted({kind for _, kind, _ in shapes})[:12])
        raise FileFormatError(f"the cell has no layer {min(missing)}; its layers are {listed}")
    shapes = [s for s in shapes if not requested or not requested.isdisjoint(s[:2])]
    rings = [ring for _, _, ring in shapes]
    if not rings:
        raise FileFormatError(
            "the cell contains no polygons or paths; choose another cell or layer"
        )
    check_coordinates(np.concatenate(rings))
    # Cuts connect a GDSII polygon to its holes; the fill rule removes these cuts.
    polygons = [polygon for ring in rings for polygon in filled([ring], "nonzero")]
    if not polygons:
        raise FileFormatError(
            "expected polygons that enclose an area, got only polygons of zero area"
        )
    return Drawing(polygons, metres)
