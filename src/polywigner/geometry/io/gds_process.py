"""gdstk reads the polygons of a GDSII file, in a process of its own (``library_process``).

Nothing of this package is imported here.
"""

from __future__ import annotations

import importlib
from typing import Any

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
        raise LookupError(f"expected {wanted}, got the cells {listed}; name a cell as layer")
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


def _polygons(path: str, cell: str | None, layers: list[list[int]], most: int) -> dict[str, Any]:
    gdstk: Any = importlib.import_module("gdstk")
    library = gdstk.read_gds(path)
    chosen = _chosen(library, cell)
    if _count(chosen, {}) > _MOST_POLYGONS:
        raise LookupError(
            f"expected at most {_MOST_POLYGONS} polygons in a cell, those of references counted "
            "each time, got more; choose another cell"
        )
    polygons = chosen.get_polygons()
    there = sorted({(polygon.layer, polygon.datatype) for polygon in polygons})
    for wanted in layers:
        if not any(list(pair[: len(wanted)]) == wanted for pair in there):
            listed = ", ".join(f"{layer}/{kind}" for layer, kind in there[:12])
            raise LookupError(
                f"expected a layer of the cell, got {'/'.join(map(str, wanted))}; it has {listed}"
            )
    kept = [
        polygon
        for polygon in polygons
        if not layers
        or any([polygon.layer, polygon.datatype][: len(wanted)] == wanted for wanted in layers)
    ]
    if sum(polygon.size for polygon in kept) > most:
        raise LookupError(f"expected at most {most} vertices, got more; choose a cell or layer")
    return {
        "unit": library.unit,
        "rings": [polygon.points.tolist() for polygon in kept],
        "layers": [f"{polygon.layer}/{polygon.datatype}" for polygon in kept],
    }


def answer(asked: dict[str, Any]) -> dict[str, Any]:
    """Return rings with their layers, and the unit; LookupError for a missing layer."""
    return _polygons(asked["path"], asked["cell"], asked["layers"], asked["most"])
