"""Closed outlines of a DXF drawing: what lies in an odd number of them is open.

ezdxf parses the file; circles, arcs, bulges and splines are followed here, to a stated tolerance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.exact import Ring
from polywigner.geometry.formats.chains import JOINT, chained, is_closed
from polywigner.geometry.formats.curves import Curve, Points, flattened, rough_points, transformed
from polywigner.geometry.formats.drawing import Drawing, required
from polywigner.geometry.formats.dxf_entities import IGNORED, paths_of, work_of
from polywigner.geometry.formats.layers import check_known, overlap_remedy
from polywigner.geometry.formats.limits import (
    LARGEST_DXF,
    LARGEST_NUMBER,
    MOST_NESTED_BLOCKS,
    check_number,
)
from polywigner.geometry.formats.outlines import nested, without_duplicates
from polywigner.geometry.formats.quoting import place_of

__all__ = ["read_dxf"]

_Drawn = tuple[list[Curve], str]
"""A path and the name of its layer."""

# $INSUNITS; those without an exact length (light years, survey units) are refused.
_UNITS = {
    1: Fraction(254, 10**4), 2: Fraction(3048, 10**4), 3: Fraction(1609344, 1000),
    4: Fraction(1, 1000), 5: Fraction(1, 100), 6: Fraction(1), 7: Fraction(1000),
    8: Fraction(254, 10**10), 9: Fraction(254, 10**7), 10: Fraction(9144, 10**4),
    11: Fraction(1, 10**10), 12: Fraction(1, 10**9), 13: Fraction(1, 10**6), 14: Fraction(1, 10),
    15: Fraction(10), 16: Fraction(100), 17: Fraction(10**9),
}  # fmt: skip

# A drawing is plane if its heights differ by less than rounding, in diagonals.
_FLAT = 1e-9


def read_dxf(
    path: Path,
    content: bytes,
    unit_metres: float,
    tolerance: float | None,
    layers: Sequence[str] = (),
    union: bool = False,
) -> Drawing:
    """The outlines in the model space of a DXF file, on layers that are on.

    Parameters
    ----------
    path, content
        The file, text or binary, and its bytes.
    unit_metres
        Metres of one unit, where the file's $INSUNITS does not say.
    tolerance
        Largest distance in metres between a curve and its chords; None: see `flattened`.
    layers
        Names of those to read alone, in capitals or not, even where they are off; none: all.
    union
        Whether to join outlines that overlap.

    Raises
    ------
    FileFormatError, GeometryError, MissingExtraError; ArgumentError for an unknown layer.
    """
    if len(content) > LARGEST_DXF:
        raise FileFormatError(
            f"expected at most {LARGEST_DXF >> 20} MiB of DXF, got more; save the outline alone"
        )
    ezdxf = required("ezdxf", "DXF")
    try:
        document = ezdxf.readfile(path)
        metres = _metres(document, content, unit_metres)
        paths = _Blocks(document, layers).drawn()
    except PolywignerError:
        raise
    except MemoryError:
        raise FileFormatError("expected a DXF that fits into memory, got a larger one") from None
    except Exception as error:  # a damaged file can fail anywhere in ezdxf, with any exception
        raise FileFormatError(
            f"expected DXF, got a file that ezdxf does not read: {_shown(error)}"
        ) from None
    rings, remedy = _rings(paths, None if tolerance is None else tolerance / metres)
    return Drawing(nested(rings, union, remedy), metres, remedy)


def _shown(error: Exception) -> str:
    return f"{type(error).__name__}{place_of(error)}"


def _metres(document: Any, content: bytes, unit_metres: float) -> float:
    # ezdxf gives metres to a drawing without units of its own.
    code = document.header.get("$INSUNITS", 0) if b"$INSUNITS" in content else 0
    if code == 0:
        return unit_metres
    if code not in _UNITS:
        raise FileFormatError(
            f"expected $INSUNITS from 0 to {max(_UNITS)}, got {code!r}; save in millimetres"
        )
    return float(_UNITS[code])


def _layer_of(entity: Any) -> str:
    return str(entity.dxf.get("layer", "0"))


class _Blocks:
    """The paths of layouts, with blocks read once however often they are inserted."""

    def __init__(self, document: Any, layers: Sequence[str]) -> None:
        self.document = document
        self.asked = {name.lower() for name in layers}
        self.known: dict[str, list[_Drawn]] = {}
        self.hidden = {
            layer.dxf.name.lower()
            for layer in document.layers
            if layer.is_off() or layer.is_frozen()
        } | {"defpoints"}
        self.hidden -= self.asked
        self.count = 0
        if self.asked:
            known = {layer.dxf.name for layer in document.layers}
            known |= {_layer_of(entity) for entity in document.chain_layouts_and_blocks()}
            names = {name.lower(): name for name in known}
            check_known([names.get(name.lower(), name) for name in layers], known)

    def drawn(self) -> list[_Drawn]:
        """The paths of the model space, each with its layer."""
        found = self.paths(self.document.modelspace())
        return [(path, layer) for path, layer in found if self._is_asked(layer)]

    def _is_asked(self, layer: str) -> bool:
        return not self.asked or layer.lower() in self.asked

    def paths(self, layout: Any, depth: int = 0) -> Iterator[_Drawn]:
        if depth > MOST_NESTED_BLOCKS:
            raise FileFormatError(
                f"expected blocks nested at most {MOST_NESTED_BLOCKS} deep, got more (or a block "
                "that contains itself); explode them"
            )
        for entity in layout:
            kind = entity.dxftype()
            layer = _layer_of(entity)
            if kind in IGNORED or layer.lower() in self.hidden or entity.dxf.get("invisible", 0):
                continue
            # Layer 0 of a block stands for the layer that the block is inserted on.
            if kind != "INSERT" and not (self._is_asked(layer) or (depth and layer == "0")):
                continue
            found = (
                self._inserted(entity, layer, depth)
                if kind == "INSERT"
                else ((path, layer) for path in paths_of(entity))
            )
            for path, own in found:
                self.count += sum(map(work_of, path))
                check_number(self.count)
                yield path, own

    def _inserted(self, insert: Any, layer: str, depth: int) -> Iterator[_Drawn]:
        name = str(insert.dxf.name)
        if name not in self.known:
            block = insert.block()
            if block is None:
                raise FileFormatError(f"expected a block named {name[:60]!r}, got none")
            self.known[name] = list(self.paths(block, depth + 1))
        content = self.known[name]
        rows = np.array(list(insert.matrix44().rows()))
        for offset in _grid(insert) if content else ():
            for path, own in content:
                moved = [transformed(curve, rows[:3, :3], rows[3, :3] + offset) for curve in path]
                yield moved, layer if own == "0" else own


def _grid(insert: Any) -> Iterator[Points]:
    """Offsets of a rectangular array, in the world; a spacing of zero repeats in place."""
    ocs = insert.ocs()
    angle = np.radians(insert.dxf.rotation)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    axes = turn @ np.array([list(ocs.ux), list(ocs.uy)])
    columns = insert.dxf.column_count if insert.dxf.column_spacing else 1
    for row in range(insert.dxf.row_count if insert.dxf.row_spacing else 1):
        for column in range(columns):
            yield (
                np.array([column * insert.dxf.column_spacing, row * insert.dxf.row_spacing]) @ axes
            )


def _rings(drawn: Sequence[_Drawn], tolerance: float | None) -> tuple[list[Ring], str]:
    """Flat rings (n, 2) of closed paths and of those that close when joined; and a remedy."""
    paths = [path for path, _ in drawn]
    if not paths:
        raise FileFormatError(
            "expected outlines in the model space, got none; draw closed polylines, circles or "
            "hatches on a layer that is on"
        )
    points = np.concatenate([rough_points(curve) for path in paths for curve in path])
    if not (np.abs(points) <= LARGEST_NUMBER).all():  # also for a NaN
        raise FileFormatError(
            f"expected finite coordinates below {LARGEST_NUMBER:g}, got one beyond; correct it"
        )
    gap = JOINT * float(np.linalg.norm(np.ptp(points, axis=0)))
    whole, loose = [], []
    for path in paths:
        if is_closed(path, gap):
            whole.append(path)
        elif len(path) > 1 or np.ptp(rough_points(path[0]), axis=0).max() > gap:
            loose.append(path)  # anything shorter is a point, up to rounding
    outlines = [*whole, *chained(loose, gap)]  # each begins with the first curve of some path
    layer_of = {id(path[0]): layer for path, layer in drawn}
    layers = [layer_of[id(outline[0])] for outline in outlines]
    found = zip(flattened(outlines, tolerance), layers, strict=True)
    closed = [(ring, layer) for ring, layer in found if len(ring) > 2]
    if not closed:
        raise FileFormatError("expected outlines that enclose an area, got none that do")
    heights = np.concatenate([ring[:, 2] for ring, _ in closed])
    if np.ptp(heights) > _FLAT * max(gap / JOINT, float(np.abs(points).max())):
        raise FileFormatError(
            f"expected a plane drawing, got heights from {heights.min():g} to {heights.max():g}; "
            "flatten it"
        )
    flat = [ring[:, :2] for ring, _ in closed]
    return without_duplicates(flat, gap), overlap_remedy(flat, [layer for _, layer in closed])
