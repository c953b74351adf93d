"""Polygons and paths of a GDSII layout, as gdstk reads them."""

from __future__ import annotations

import importlib
import math
import re
import warnings
from collections.abc import Iterable, Iterator
from graphlib import CycleError, TopologicalSorter
from typing import Any

import numpy as np

from polywigner.errors import ArgumentError, FileFormatError
from polywigner.geometry.exact import Ring
from polywigner.geometry.io.curves import DEFAULT_TOLERANCE, Arc, flattened
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


# Records of GDSII, and bits of STRANS.
_NAME_OF_CELL, _REFERENCE, _ARRAY, _NAME_IN_REFERENCE, _TRANSFORM = 0x06, 0x0A, 0x0B, 0x12, 0x1A
_ABSOLUTE_MAGNIFICATION, _ABSOLUTE_ANGLE = 0x0004, 0x0002


def _absolute_references(content: bytes) -> dict[tuple[str, str], int]:
    """Flags of references by the names of their cell and the cell in it; gdstk drops the flags."""
    flags: dict[tuple[str, str], int] = {}
    place, cell, inner = 0, "", ""
    while place + 4 <= len(content):
        size, kind = int.from_bytes(content[place : place + 2], "big"), content[place + 2]
        if size < 4:
            break  # zeros after the end of the library
        value = content[place + 4 : place + size]
        if kind == _NAME_OF_CELL:
            cell = value.rstrip(b"\0").decode("latin-1")
        elif kind == _NAME_IN_REFERENCE:
            inner = value.rstrip(b"\0").decode("latin-1")
        elif kind == _TRANSFORM:
            found = int.from_bytes(value[:2], "big") & (_ABSOLUTE_MAGNIFICATION | _ABSOLUTE_ANGLE)
            flags[cell, inner] = flags.get((cell, inner), 0) | found
        place += size
    return flags


def _check_references(top: Any, content: bytes) -> None:
    """Raise for missing cells, and for absolute transformations inside of other ones."""
    flags = _absolute_references(content)
    waiting = [(top, 0)]  # cells with the kinds of transformations around them
    known = set()
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
    """The outline of a path of zero length: a disc, a rectangle along x, or nothing."""
    centre, width, end = path.spine()[0], float(path.widths()[0][0]), path.ends[0]
    if end == "round":
        disc = Arc(centre, np.array([width / 2, 0]), np.array([0, width / 2]), 0.0, 2 * math.pi)
        return flattened([[disc]], path.tolerance) if width else []
    before, after = {"flush": (0.0, 0.0), "extended": (width / 2, width / 2)}.get(
        end if isinstance(end, str) else "", end
    )
    corners = np.array([(-before, -1), (after, -1), (after, 1), (-before, 1)])
    return [centre + corners * (1, width / 2)] if width and before + after else []


def _shapes(cell: Any) -> Iterator[tuple[int, int, Ring]]:
    """Layer, data type and outline of each polygon and path of a cell and its references."""
    for polygon in cell.get_polygons(include_paths=False):
        yield polygon.layer, polygon.datatype, polygon.points
    for path in cell.get_paths():  # polygons of paths in references would lose absolute widths
        rings = _dot(path) if _is_dot(path) else [p.points for p in path.to_polygons()]
        for ring in rings:
            yield path.layers[0], path.datatypes[0], ring


def read_gds(file: File) -> Drawing:
    """Read the polygons of one cell, references included; paths have their widths.

    Layers: "1" for a layer with all its data types, "1/0" for one of them. Any other text names the
    cell, which otherwise is the only one that no other contains.
    """
    cells = [name for name in file.layers if not _LAYER.fullmatch(name)]
    if len(cells) > 1:
        raise ArgumentError(f"expected one cell, got {', '.join(cells)}; read them one by one")
    gdstk: Any = importlib.import_module("gdstk")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of missing cells and absolute flags, which are checked
        library = gdstk.read_gds(str(file.path))
    metres = float(library.unit)
    if not 0 < metres < LARGEST_NUMBER:
        raise FileFormatError(f"expected a unit above zero, got {metres:g} m; export it anew")
    cell = _chosen(library, cells[0] if cells else None)
    _check_cycles(library.cells)
    _check_references(cell, file.content)
    for path in [path for each in library.cells for path in each.paths]:
        size = float(np.hypot(*np.ptp(path.spine(), axis=0)) + path.widths().max())
        path.tolerance = file.tolerance / metres if file.tolerance else DEFAULT_TOLERANCE * size
    _draw_dots(library.cells)
    shapes = list(_shapes(cell))
    wanted = [[int(n) for n in name.split("/")] for name in file.layers if name not in cells]
    there = sorted({(layer, kind) for layer, kind, _ in shapes})
    for names in wanted:
        if not any(list(pair[: len(names)]) == names for pair in there):
            listed = ", ".join(f"{layer}/{kind}" for layer, kind in there[:12])
            raise FileFormatError(
                f"expected a layer of the cell, got {'/'.join(map(str, names))}; it has {listed}"
            )
    rings, layers = [], []
    for layer, kind, ring in shapes:
        is_wanted = not wanted or any([layer, kind][: len(names)] == names for names in wanted)
        if len(ring) and is_wanted:  # a boundary with one point has none left
            rings.append(ring)
            layers.append(f"{layer}/{kind}")
    if not rings:
        raise FileFormatError("expected polygons or paths in the cell, got none")
    if not all((np.abs(ring) < LARGEST_NUMBER).all() for ring in rings):
        raise FileFormatError("expected finite coordinates, got others; export the layout anew")
    # Holes of a polygon are cuts that lead to them: the rule opens them.
    filled_ones = [polygon for ring in rings for polygon in filled([ring], "nonzero")]
    if not filled_ones:
        raise FileFormatError("expected polygons that enclose an area, got none that do")
    return Drawing(filled_ones, metres, overlap_remedy(rings, layers))


FORMATS = (Format("GDSII", (".gds",), read_gds, rb"\x00\x06\x00\x02", ("gdstk",), True),)
