"""Polygons and paths of a GDSII layout, as gdstk reads them."""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Iterable, Iterator
from graphlib import CycleError, TopologicalSorter
from typing import Any

import numpy as np

from polywigner.errors import ArgumentError, FileFormatError
from polywigner.geometry.io.curves import DEFAULT_TOLERANCE, Arc, flattened
from polywigner.geometry.io.limits import check_coordinates
from polywigner.geometry.io.outlines import Drawing, File, filled, overlap_remedy
from polywigner.geometry.rings import Ring

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


# Records of GDSII, and bits of STRANS.
_NAME_OF_CELL, _NAME_IN_REFERENCE, _TRANSFORM = 0x06, 0x12, 0x1A
_ABSOLUTE_MAGNIFICATION, _ABSOLUTE_ANGLE = 0x0004, 0x0002


def _absolute_references(content: bytes) -> dict[tuple[str, str], int]:
    """Return flags of references, which gdstk drops, by the names of both cells."""
    flags: dict[tuple[str, str], int] = {}
    position, cell, inner = 0, "", ""
    while position + 4 <= len(content):
        size, kind = int.from_bytes(content[position : position + 2], "big"), content[position + 2]
        if size < 4:
            break  # zeros after the end of the library
        value = content[position + 4 : position + size]
        if kind == _NAME_OF_CELL:
            cell = value.rstrip(b"\0").decode("latin-1")
        elif kind == _NAME_IN_REFERENCE:
            inner = value.rstrip(b"\0").decode("latin-1")
        elif kind == _TRANSFORM:
            found = int.from_bytes(value[:2], "big") & (_ABSOLUTE_MAGNIFICATION | _ABSOLUTE_ANGLE)
            flags[cell, inner] = flags.get((cell, inner), 0) | found
        position += size
    return flags


def _check_references(top: Any, content: bytes) -> None:
    """Raise for missing cells, and for absolute transformations inside of other ones."""
    flags = _absolute_references(content)
    waiting = [(top, 0)]  # cells with the kinds of transformations around them
    known: set[tuple[str, int]] = set()
    while waiting:
        cell, around = waiting.pop()
        if (cell.name, around) in known:
            continue
        known.add((cell.name, around))
        for reference in cell.references:
            inner = reference.cell
            name = inner if isinstance(inner, str) else inner.name
            if isinstance(inner, str):
                raise FileFormatError(
                    f"expected all cells in the file, got a reference in {cell.name!r} to the "
                    f"missing cell {name[:60]!r}; export the layout with its libraries"
                )
            if flags.get((cell.name, name), 0) & around:
                what = "an absolute magnification or angle"
                raise FileFormatError(
                    f"expected references that turn and scale with their cell, got {what} of "
                    f"{name[:60]!r} in {cell.name[:60]!r}, which is turned or scaled; flatten it"
                )
            scales = _ABSOLUTE_MAGNIFICATION if reference.magnification != 1 else 0
            turns = _ABSOLUTE_ANGLE if reference.rotation % (2 * math.pi) else 0
            waiting.append((inner, around | scales | turns))


def _check_cycles(cells: Iterable[Any]) -> None:
    """Raise FileFormatError for a cell that contains itself, on which gdstk ends the process."""
    inner = {
        cell.name: [ref.cell.name for ref in cell.references if not isinstance(ref.cell, str)]
        for cell in cells
        if hasattr(cell, "references")
    }
    try:
        TopologicalSorter(inner).prepare()
    except CycleError as error:
        raise FileFormatError(
            f"expected cells that do not contain themselves, got {' in '.join(error.args[1])[:120]}"
            "; correct the references"
        ) from None


def _draw_dots(cells: Iterable[Any]) -> None:
    """Replace paths of zero length, which gdstk drops, by polygons of their ends."""
    for cell in cells:
        for path in [path for path in cell.paths if path.scale_width and _is_dot(path)]:
            rings = _dot(path)
            cell.remove(path)
            polygon = importlib.import_module("gdstk").Polygon
            layer, kind = path.layers[0], path.datatypes[0]
            cell.add(*(polygon(ring, layer, kind) for ring in rings))


def _is_dot(path: Any) -> bool:
    return not np.ptp(path.spine(), axis=0).any()


def _dot(path: Any) -> list[Ring]:
    """Return the outline of a path of zero length: a disc, a rectangle along x, or none."""
    centre, width, end = path.spine()[0], float(path.widths()[0][0]), path.ends[0]
    if end == "round":
        disc = Arc(centre, np.array([width / 2, 0.0]), np.array([0.0, width / 2]))
        return flattened([[disc]], path.tolerance) if width else []
    before, after = {"flush": (0.0, 0.0), "extended": (width / 2, width / 2)}.get(
        end if isinstance(end, str) else "", end
    )
    corners = np.array([(-before, -1), (after, -1), (after, 1), (-before, 1)])
    return [centre + corners * (1, width / 2)] if width and before + after else []


def _shapes(cell: Any) -> Iterator[tuple[str, str, Ring]]:
    """Yield the outlines of polygons and paths, with their layer and "layer/data type"."""
    for polygon in cell.get_polygons(include_paths=False):
        yield f"{polygon.layer}", f"{polygon.layer}/{polygon.datatype}", polygon.points
    for path in cell.get_paths():  # polygons of paths in references would lose absolute widths
        rings = _dot(path) if _is_dot(path) else [p.points for p in path.to_polygons()]
        for ring in rings:
            yield f"{path.layers[0]}", f"{path.layers[0]}/{path.datatypes[0]}", ring


def load_gds(file: File) -> Drawing:
    """Load the polygons of one cell, references included; paths have their widths.

    Layers: "1" for a layer with all its data types, "1/0" for one of them. Any other text names the
    cell, which otherwise is the only one that no other contains.
    """
    cells = [name for name in file.layers if not _LAYER.fullmatch(name)]
    if len(cells) > 1:
        raise ArgumentError(f"expected one cell, got {', '.join(cells)}; read them one by one")
    gdstk: Any = importlib.import_module("gdstk")
    library = gdstk.read_gds(str(file.path))
    metres = float(library.unit)
    if not 0 < metres < math.inf:
        raise FileFormatError(f"expected a unit above zero, got {metres:g} m; export it anew")
    cell = _chosen(library, cells[0] if cells else None)
    _check_cycles(library.cells)
    _check_references(cell, file.content)
    for path in [path for each in library.cells for path in each.paths]:
        size = float(np.hypot(*np.ptp(path.spine(), axis=0)) + path.widths().max())
        path.tolerance = file.tolerance / metres if file.tolerance else DEFAULT_TOLERANCE * size
    _draw_dots(library.cells)
    shapes = [shape for shape in _shapes(cell) if len(shape[2])]  # boundaries of a point have none
    requested = {re.sub(r"\b0+(?=\d)", "", name) for name in file.layers if name not in cells}
    if missing := requested - {name for layer, kind, _ in shapes for name in (layer, kind)}:
        listed = ", ".join(sorted({kind for _, kind, _ in shapes})[:12])
        raise FileFormatError(f"expected a layer of the cell, got {min(missing)}; it has {listed}")
    shapes = [s for s in shapes if not requested or not requested.isdisjoint(s[:2])]
    rings, layers = [ring for _, _, ring in shapes], [kind for _, kind, _ in shapes]
    if not rings:
        raise FileFormatError("expected polygons or paths in the cell, got none")
    check_coordinates(np.concatenate(rings))
    # Holes of a polygon are cuts that lead to them: the rule opens them.
    polygons = [polygon for ring in rings for polygon in filled([ring], "nonzero")]
    if not polygons:
        raise FileFormatError("expected polygons that enclose an area, got none that do")
    return Drawing(polygons, metres, overlap_remedy(rings, layers))
