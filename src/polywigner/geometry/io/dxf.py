"""Outlines and hatches of a DXF drawing, which ezdxf reads, places and flattens.

An area inside an odd number of outlines is open. Hatches are painted: one on the other is a union.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import shapely

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.exact import Ring
from polywigner.geometry.io.curves import DEFAULT_TOLERANCE, JOINT, Points, chains
from polywigner.geometry.io.drawing import Drawing, File, Format, check_known, overlap_remedy
from polywigner.geometry.io.dxf_entities import Hatch, Path, shapes_of, widths_of
from polywigner.geometry.io.limits import check_coordinates, place_of
from polywigner.geometry.io.outlines import depths, filled, nested, without_duplicates
from polywigner.geometry.parts import polygons_in, union_on_grid
from polywigner.geometry.rings import rings_of_polygon

IGNORED = frozenset({
    "TEXT", "MTEXT", "ATTRIB", "ATTDEF", "DIMENSION", "ARC_DIMENSION", "LARGE_RADIAL_DIMENSION",
    "LEADER", "MULTILEADER", "MLEADER", "TOLERANCE", "POINT", "RAY", "XLINE", "VIEWPORT", "IMAGE",
    "WIPEOUT", "OLE2FRAME", "ACAD_TABLE", "LIGHT", "SUN",
})  # fmt: skip
"""Annotation: nothing that could be an outline."""

# Blocks inserted in blocks.
_MOST_NESTED = 16
# A drawing is plane if its heights differ by less than rounding, in diagonals.
_FLAT = 1e-9
# Nesting depths of the boundaries that a hatch fills between, by its style: all, outermost two
# (the islands are open, and what lies in them), outermost only.
_DEEPEST = {0: 1_000_000, 1: 1, 2: 0}


# $INSUNITS; those without an exact length (light years, survey units) are refused.
_UNITS = {
    1: Fraction(254, 10**4), 2: Fraction(3048, 10**4), 3: Fraction(1609344, 1000),
    4: Fraction(1, 1000), 5: Fraction(1, 100), 6: Fraction(1), 7: Fraction(1000),
    8: Fraction(254, 10**10), 9: Fraction(254, 10**7), 10: Fraction(9144, 10**4),
    11: Fraction(1, 10**10), 12: Fraction(1, 10**9), 13: Fraction(1, 10**6), 14: Fraction(1, 10),
    15: Fraction(10), 16: Fraction(100), 17: Fraction(10**9),
}  # fmt: skip


def read_dxf(file: File) -> Drawing:
    """Read the outlines and hatches in the model space of a DXF file, on layers that are on."""
    ezdxf: Any = importlib.import_module("ezdxf")
    try:
        document = ezdxf.readfile(file.path)
        metres = _metres(document, file)
        space = _Space(document, file.layers)
        shapes = list(space.shapes(document.modelspace(), "0", 0))
        return _assembled(shapes, metres, file)
    except (PolywignerError, MemoryError):
        raise
    except Exception as error:  # a damaged file can fail anywhere in ezdxf, with any exception
        why = f"{type(error).__name__}{place_of(error)}"
        raise FileFormatError(f"expected DXF, got a file that ezdxf does not read: {why}") from None


def _metres(document: Any, file: File) -> float:
    # ezdxf gives metres to a drawing without units of its own.
    code = document.header.get("$INSUNITS", 0) if b"$INSUNITS" in file.content else 0
    if code == 0:
        return file.unit_metres
    if code not in _UNITS:
        raise FileFormatError(
            f"expected $INSUNITS from 0 to {max(_UNITS)}, got {code!r}; save in millimetres"
        )
    return float(_UNITS[code])


def _layer_of(entity: Any) -> str:
    return str(entity.dxf.get("layer", "0"))


class _Space:
    """The visible entities of a drawing, or those on the requested layers."""

    def __init__(self, document: Any, layers: Sequence[str]) -> None:
        self.requested = {name.lower() for name in layers}
        table = {layer.dxf.name.lower(): layer for layer in document.layers}
        frozen = {name for name, layer in table.items() if layer.is_frozen()}
        off = {name for name, layer in table.items() if layer.is_off()} | {"defpoints"}
        self.frozen, self.hidden = frozen - self.requested, (off | frozen) - self.requested
        if self.requested:
            known = {layer.dxf.name for layer in document.layers}
            known |= {_layer_of(entity) for entity in document.chain_layouts_and_blocks()}
            names = {name.lower(): name for name in known}
            check_known([names.get(name.lower(), name) for name in layers], known)

    def shapes(self, entities: Iterable[Any], around: str, depth: int) -> Iterator[Path | Hatch]:
        """The shapes of entities in the model space, or in a block inserted on layer `around`."""
        if depth > _MOST_NESTED:
            raise FileFormatError(
                f"expected blocks nested at most {_MOST_NESTED} deep, got more (or a block "
                "that contains itself); explode them"
            )
        for entity in entities:
            kind, layer = entity.dxftype(), _layer_of(entity)
            # Layer 0 of a block stands for the layer that the block is inserted on.
            layer = around if layer == "0" and depth else layer
            if kind in IGNORED or entity.dxf.get("invisible", 0):
                continue
            if kind == "INSERT":
                # A layer that is off hides no more than its own entities; a frozen one hides all.
                if layer.lower() not in self.frozen:
                    yield from self._inserted(entity, layer, depth)
            elif layer.lower() not in self.hidden and (
                not self.requested or layer.lower() in self.requested
            ):
                yield from shapes_of(entity, layer)

    def _inserted(self, insert: Any, layer: str, depth: int) -> Iterator[Path | Hatch]:
        block, name = insert.block(), str(insert.dxf.name)[:60]
        if block is None:
            raise FileFormatError(f"expected a block named {name!r}, got none; save it again")
        if block.block.is_xref:
            raise FileFormatError(
                f"expected one drawing, got the external reference {name!r}; bind it"
            )
        if importlib.import_module("ezdxf.xclip").XClip(insert).has_clipping_path:
            raise FileFormatError(f"expected whole blocks, got {name!r}, which is clipped; trim it")
        if not any(entity.dxftype() not in IGNORED for entity in block):
            return
        scale = insert.dxf.get("xscale", 1), insert.dxf.get("yscale", 1)
        if abs(scale[0]) != abs(scale[1]):  # ezdxf drops widths here
            for entity in block.query("LWPOLYLINE POLYLINE"):
                if not widths_of(entity) <= {(0.0, 0.0)}:
                    raise FileFormatError(
                        f"expected polylines of width zero, got another in {name!r}, which is "
                        "stretched; explode it"
                    )
        for copy in insert.multi_insert() if insert.mcount > 1 else (insert,):
            content = copy.virtual_entities(skipped_entity_callback=_refuse_skipped)
            yield from self.shapes(content, layer, depth + 1)


def _refuse_skipped(entity: Any, reason: str) -> None:
    if entity.dxftype() not in IGNORED:
        raise FileFormatError(
            f"expected blocks that can be exploded, got a {entity.dxftype()[:40]} in one "
            f"({reason[:60]}); explode them before export"
        )


def _assembled(shapes: list[Path | Hatch], metres: float, file: File) -> Drawing:
    """Polygons of hatches, and of outlines that are no border of a hatch."""
    hatches = [shape for shape in shapes if isinstance(shape, Hatch)]
    paths = [shape for shape in shapes if isinstance(shape, Path)]
    every = paths + [path for hatch in hatches for side in hatch.boundaries for path in side]
    if not every:
        raise FileFormatError(
            "expected outlines in the model space, got none; draw closed polylines, circles or "
            "hatches on a layer that is on"
        )
    points = np.concatenate([path.points() for path in every])
    check_coordinates(points)
    ground = _Ground(points, file.tolerance and file.tolerance / metres)
    painted = [
        [ring for side in hatch.boundaries for ring, _ in ground.outlines(side)]
        for hatch in hatches
    ]
    borders = [ring for rings in painted for ring in rings]
    if borders:
        paths = [
            path for path, b in zip(paths, ground.are_borders(paths, borders), strict=True) if not b
        ]
    closed = [(ring, path.layer) for ring, path in ground.outlines(paths)]
    if not closed and not borders:
        raise FileFormatError("expected outlines that enclose an area, got none that do")
    ground.check_plane([ring for ring, _ in closed] + borders)
    rings = [ring[:, :2] for ring, _ in closed]
    layers = [layer for _, layer in closed]
    layers += [hatch.layer for hatch, some in zip(hatches, painted, strict=True) for _ in some]
    remedy = overlap_remedy(rings + [ring[:, :2] for ring in borders], layers)
    polygons = nested(without_duplicates(rings, ground.gap), file.union, remedy) if rings else []
    return Drawing(polygons + _painted(hatches, painted), metres, remedy)


def _painted(hatches: Sequence[Hatch], painted: Sequence[list[Ring]]) -> list[list[Ring]]:
    """Polygons of the union of all hatches, from the boundaries of each."""
    polygons = []
    for hatch, boundaries in zip(hatches, painted, strict=True):
        rings = [ring[:, :2] for ring in boundaries]
        deepest = _DEEPEST.get(hatch.style, 0)
        rings = [ring for ring, d in zip(rings, depths(rings), strict=True) if d <= deepest]
        polygons += filled(rings, "evenodd")
    if len(hatches) < 2:
        return polygons
    union = union_on_grid([shapely.Polygon(outer, holes) for outer, *holes in polygons])
    return [rings_of_polygon(polygon) for polygon in polygons_in(union)]


class _Ground:
    """Tolerances of a drawing, by which its paths become rings (n, 3)."""

    def __init__(self, points: Points, tolerance: float | None) -> None:
        self.size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self.gap = JOINT * self.size
        self.tolerance = tolerance
        self.reach = float(np.abs(points).max())

    def distance(self, points: Points) -> float:
        """Largest distance between a curve and its chords, for an outline with these points."""
        own = DEFAULT_TOLERANCE * float(np.linalg.norm(np.ptp(points, axis=0)))
        return max(self.tolerance or own, np.finfo(float).tiny)

    def outlines(self, paths: Sequence[Path]) -> list[tuple[Ring, Path]]:
        """Rings of closed paths, and of paths whose ends meet, each with the first of its paths."""
        closed, loose = [], []
        for path in paths:
            points = path.points()
            if path.curves[0].is_round:
                closed.append([(path, False)])
            elif np.ptp(points, axis=0).max() > self.gap:  # anything shorter is a point
                closes = np.abs(points[0] - points[-1]).max() <= self.gap
                (closed.append([(path, False)]) if closes else loose.append(path))
        tips = [path.points()[[0, -1]] for path in loose]
        runs = [[(loose[k], back) for k, back in run] for run in chains(tips, self.gap)]
        found = [(self._ring(run), run[0][0]) for run in closed + runs]
        return [(ring, path) for ring, path in found if len(ring) > 2]

    def _ring(self, run: Sequence[tuple[Path, bool]]) -> Ring:
        distance = self.distance(np.concatenate([path.points() for path, _ in run]))
        pieces = [path.points(distance)[:: -1 if back else 1] for path, back in run]
        return np.concatenate([piece[:-1] for piece in pieces])

    def are_borders(self, paths: Sequence[Path], borders: Sequence[Ring]) -> list[bool]:
        """Whether each path runs along boundaries of hatches, up to the chords of both."""
        lines = [np.concatenate([border, border[:1]])[:, :2] for border in borders]
        boundaries = shapely.MultiLineString(lines)
        shapely.prepare(boundaries)
        slack = self.gap + max(self.distance(border) for border in borders)
        steps = np.linspace(0, 1, 5)[:-1, None, None]
        found = []
        for path in paths:
            distance = self.distance(path.points())
            chords = path.points(distance)[:, :2]
            dense = np.concatenate([*(chords[:-1] + steps * np.diff(chords, axis=0)), chords[-1:]])
            near = shapely.dwithin(boundaries, shapely.points(dense), slack + distance)
            found.append(bool(near.all()))
        return found

    def check_plane(self, rings: Sequence[Ring]) -> None:
        heights = np.concatenate([ring[:, 2] for ring in rings])
        if np.ptp(heights) > _FLAT * max(self.size, self.reach):
            raise FileFormatError(
                f"expected a plane drawing, got heights from {heights.min():g} to "
                f"{heights.max():g}; flatten it"
            )


FORMATS = (
    Format(
        "DXF", (".dxf",), read_dxf,
        rb"AutoCAD Binary DXF|(?:999\r?\n[^\n]*\n\s*)*0\s*\r?\n\s*SECTION",
        ("ezdxf",), True,
    ),
)  # fmt: skip
