"""Outlines and hatches of a DXF drawing, which ezdxf parses.

An area inside an odd number of outlines is open. Hatches are painted: one on the other is a union.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely

from polywigner.errors import FileFormatError
from polywigner.geometry.io.curves import (
    DEFAULT_TOLERANCE,
    Arc,
    Curve,
    Points,
    Spline,
    flattened,
    sampled,
    transformed,
)
from polywigner.geometry.io.limits import check_coordinates
from polywigner.geometry.io.outlines import (
    Drawing,
    File,
    check_known,
    depths,
    filled,
    nested,
    overlap_remedy,
    without_duplicates,
)
from polywigner.geometry.parts import polygons_in, union_on_grid
from polywigner.geometry.rings import Ring, rings_of_polygon

_IGNORED = frozenset({
    "TEXT", "MTEXT", "ATTRIB", "ATTDEF", "DIMENSION", "ARC_DIMENSION", "LARGE_RADIAL_DIMENSION",
    "LEADER", "MULTILEADER", "MLEADER", "TOLERANCE", "POINT", "RAY", "XLINE", "VIEWPORT", "IMAGE",
    "WIPEOUT", "OLE2FRAME", "ACAD_TABLE", "LIGHT", "SUN",
})  # fmt: skip
"""Annotation: nothing that could be an outline."""

_JOINT = 1e-6
"""Largest gap between ends that belong together, in diagonals of the drawing's bounds.

CAD programs write six decimals or more; ends of a drawing of 100 units meet within 1e-4.
"""

# A drawing is plane if its heights differ by less than rounding, in diagonals.
_FLAT = 1e-9
# Relative difference of angles and points that are the same up to rounding.
_SAME = 1e-9
# Nesting depths of the boundaries that a hatch fills between, by its style: all, outermost two
# (the islands are open, and what lies in them), outermost only.
_DEEPEST = {0: 1_000_000, 1: 1, 2: 0}

# Metres of $INSUNITS; units without an exact length (light years, survey units) are refused.
_UNITS = {
    1: 0.0254, 2: 0.3048, 3: 1609.344, 4: 1e-3, 5: 1e-2, 6: 1.0, 7: 1e3, 8: 2.54e-8, 9: 2.54e-5,
    10: 0.9144, 11: 1e-10, 12: 1e-9, 13: 1e-6, 14: 0.1, 15: 10.0, 16: 100.0, 17: 1e9,
}  # fmt: skip

Path = list[Curve]
"""Curves of which each starts where the one before it ends."""


@dataclass(frozen=True, eq=False)
class _Shape:
    """An outline or a part of one, or the boundaries of an area that is painted."""

    boundaries: list[list[Path]]
    layer: str
    style: int | None = None
    """Style of a hatch; None for outlines, which have one path."""

    def transformed(self, matrix: Points, offset: Points) -> _Shape:
        """Return the image under p -> p @ matrix + offset."""
        images = [
            [[transformed(curve, matrix, offset) for curve in path] for path in paths]
            for paths in self.boundaries
        ]
        return replace(self, boundaries=images)


def _size(points: Points) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _rough(path: Path) -> Points:
    """Return some points (n, 3) along a path, its vertices and ends among them."""
    return np.concatenate([sampled(curve, 8) for curve in path])


def _ends(path: Path) -> Points:
    return np.stack([sampled(path[0])[0], sampled(path[-1])[-1]])


def _is_round(path: Path) -> bool:
    return isinstance(path[0], Arc) and path[0].is_closed


def _reversed(path: Path) -> Path:
    return [
        curve[::-1] if isinstance(curve, np.ndarray) else curve.reversed() for curve in path[::-1]
    ]


# ---- entities ------------------------------------------------------------------------------------


def _array(points: Iterable[Any]) -> Points:
    """Return an array (n, 3) of points of ezdxf in two or three dimensions."""
    array = np.array([[*p, 0.0][:3] for p in points], dtype=np.float64).reshape(-1, 3)
    check_coordinates(array)
    return array


def _elliptic(centre: Points, u: Points, v: Points, start: float, end: float) -> Arc:
    """Return the arc from one angle to another (radians); equal ones are a full turn apart."""
    sweep = (end - start) % math.tau
    is_full = abs(math.remainder(sweep, math.tau)) <= _SAME * math.tau
    return Arc(centre, u, v, start, math.tau if is_full else sweep)


def _curves(kind: str, item: Any) -> Path:
    """Return the curves of a line, arc, circle, ellipse or spline: an entity, or a hatch's edge."""
    data = getattr(item, "dxf", item)
    if kind == "LINE":
        return [_array([data.start, data.end])]
    if kind in ("ARC", "CIRCLE"):
        (centre,), (x, y, _) = _array([data.center]), data.radius * np.eye(3)
        angles = (0.0, 0.0) if kind == "CIRCLE" else (data.start_angle, data.end_angle)
        return [_elliptic(centre, x, y, math.radians(angles[0]), math.radians(angles[1]))]
    tool = item.construction_tool()
    if kind == "ELLIPSE":
        centre, x, y = _array([tool.center, tool.major_axis, tool.minor_axis])
        return [_elliptic(centre, x, y, tool.start_param, tool.end_param)]
    control = _array(tool.control_points)
    # ezdxf's own flattening leaves the range of the knots of a spline that is not clamped.
    breaks = np.unique(list(tool.knots())[tool.degree : len(control) + 1])
    spline: Path = [Spline(control, lambda t: _array(tool.points(t.tolist())), breaks)]
    ends = _ends(spline)
    is_open = getattr(item, "closed", False) and _size(ends) > _SAME * _size(control)
    return [*spline, ends[::-1]] if is_open else spline


def _bulged(points: Points, bulges: Points) -> Path:
    """Return the lines and arcs between points (n + 1, 3) in a plane z, by the bulges (n,)."""
    if not bulges.any():
        return [points]
    curves: Path = []
    for start, end, bulge in zip(points[:-1], points[1:], bulges.tolist(), strict=True):
        if bulge == 0:
            curves.append(np.stack([start, end]))
            continue
        across = np.array([start[1] - end[1], end[0] - start[0], 0.0])
        centre = (start + end) / 2 + (1 - bulge**2) / (4 * bulge) * across
        u = start - centre
        curves.append(Arc(centre, u, np.array([-u[1], u[0], 0.0]), 0.0, 4 * math.atan(bulge)))
    # The chords of a full circle keep its area.
    first = curves[0]
    is_round = len(bulges) == 2 and abs(bulges.prod() - 1) <= _SAME
    if isinstance(first, Arc) and is_round and (points[0] == points[2]).all():
        return [replace(first, sweep=math.copysign(math.tau, first.sweep))]
    return curves


def _rows_of(polyline: Any) -> tuple[Points, bool, float]:
    """Return x, y, bulge, start and end width (n, 5) of a polyline, and whether it is closed.

    The last value is the height of the polyline's plane.
    """
    dxf = polyline.dxf
    if polyline.dxftype() == "LWPOLYLINE":
        rows = np.array(polyline.get_points("xybse"), dtype=np.float64).reshape(-1, 5)
        if not rows[:, 3:].any():
            rows[:, 3:] = dxf.get("const_width", 0.0)
        return rows, polyline.closed, dxf.elevation
    usual = dxf.get("default_start_width", 0.0), dxf.get("default_end_width", 0.0)
    rows = np.array([
        (*v.dxf.location.vec2, v.dxf.get("bulge", 0.0),
         v.dxf.get("start_width", usual[0]), v.dxf.get("end_width", usual[1]))
        for v in polyline.vertices
    ]).reshape(-1, 5)  # fmt: skip
    return rows, polyline.is_closed, dxf.elevation.z


def _polyline(polyline: Any, layer: str) -> _Shape | None:
    """Return the path of a plane polyline, or the ring of a donut: a circle with one width."""
    rows, is_closed, height = _rows_of(polyline)
    if len(rows) < 2:
        return None
    rows = np.concatenate([rows, rows[:1]]) if is_closed else rows
    points = np.insert(rows[:, :2], 2, height, axis=1)
    check_coordinates(points)
    path, widths = _bulged(points, rows[:-1, 2]), rows[:-1, 3:]
    if not widths.any():
        return _Shape([[path]], layer)
    circle, width = path[0], widths.max()
    if not (isinstance(circle, Arc) and circle.is_closed and (widths == width).all()):
        raise FileFormatError(
            f"expected polylines of width zero or donuts, got one of width {width:g} on layer "
            f"{layer[:60]!r}; set its width to zero, or draw its area as a hatch"
        )
    factors = 1 + width / 2 / circle.stretch, 1 - width / 2 / circle.stretch
    rings = [replace(circle, u=f * circle.u, v=f * circle.v) for f in factors if f > 0]
    return _Shape([[[ring]] for ring in rings], layer, 0)


def _hatch(hatch: Any, layer: str) -> _Shape:
    """Return the boundaries of a hatch: a polyline, or edges in any order and direction."""
    boundaries: list[list[Path]] = []
    for boundary in hatch.paths:
        if hasattr(boundary, "vertices"):
            rows = np.array([*boundary.vertices, *boundary.vertices[:1]]).reshape(-1, 3)
            path = _bulged(rows * (1, 1, 0), rows[:-1, 2])
            boundaries.append([path] if len(rows) else [])
        else:
            kinds = [type(edge).__name__.removesuffix("Edge").upper() for edge in boundary.edges]
            boundaries.append([_curves(*pair) for pair in zip(kinds, boundary.edges, strict=True)])
    height = np.array([0.0, 0.0, hatch.dxf.elevation.z])
    shape = _Shape(boundaries, layer, int(hatch.dxf.get("hatch_style", 0)))
    return shape.transformed(np.eye(3), height)


def _shape_of(entity: Any, layer: str) -> _Shape | None:
    """Return the path or the painted area of one entity."""
    kind = entity.dxftype()
    if kind in ("LINE", "ELLIPSE", "SPLINE"):
        return _Shape([[_curves(kind, entity)]], layer)
    if kind in ("SOLID", "TRACE"):
        return _Shape([[[_array(entity.wcs_vertices(close=True))]]], layer, 0)
    if kind == "POLYLINE" and entity.is_3d_polyline:
        points = _array(v.dxf.location for v in entity.vertices)
        closing = points[: int(entity.is_closed)]
        return _Shape([[[np.concatenate([points, closing])]]], layer) if len(points) > 1 else None
    if kind in ("ARC", "CIRCLE"):
        shape: _Shape | None = _Shape([[_curves(kind, entity)]], layer)
    elif kind == "LWPOLYLINE" or (kind == "POLYLINE" and entity.is_2d_polyline):
        shape = _polyline(entity, layer)
    elif kind == "HATCH":
        shape = _hatch(entity, layer)
    else:
        raise FileFormatError(
            f"expected lines, plane polylines, curves, hatches and blocks, got a {kind[:40]}; "
            "convert it to polylines, or move it to a layer that is off"
        )
    # These entities have a coordinate system of their own.
    axes = _array(map(entity.ocs().to_wcs, np.eye(3).tolist()))
    return shape.transformed(axes, np.zeros(3)) if shape and entity.ocs().transform else shape


# ---- drawings ------------------------------------------------------------------------------------


def load_dxf(file: File) -> Drawing:
    """Load the outlines and hatches in the model space of a DXF file, on layers that are on."""
    document = importlib.import_module("ezdxf").readfile(file.path)
    space = _Space(document, file.layers)
    return _assembled(list(space.shapes(document.modelspace())), _metres(document, file), file)


def _metres(document: Any, file: File) -> float:
    # ezdxf gives metres to a drawing without units of its own.
    code = document.header.get("$INSUNITS", 0) if b"$INSUNITS" in file.content else 0
    if code == 0:
        return file.unit_metres
    if code not in _UNITS:
        raise FileFormatError(
            f"expected $INSUNITS from 0 to {max(_UNITS)}, got {code!r}; save in millimetres"
        )
    return _UNITS[code]


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

    def shapes(self, entities: Iterable[Any], around: str | None = None) -> Iterator[_Shape]:
        """Yield the shapes of the model space, or of a block inserted on layer `around`."""
        for entity in entities:
            kind, layer = entity.dxftype(), _layer_of(entity)
            # Layer 0 of a block stands for the layer that the block is inserted on.
            layer = around if layer == "0" and around else layer
            if kind in _IGNORED or entity.dxf.get("invisible", 0):
                continue
            if kind == "INSERT":
                # A layer that is off hides no more than its own entities; a frozen one hides all.
                if layer.lower() not in self.frozen:
                    yield from self._inserted(entity, layer)
            elif layer.lower() not in self.hidden and (
                not self.requested or layer.lower() in self.requested
            ):
                shape = _shape_of(entity, layer)
                yield from [shape] if shape else []

    def _inserted(self, insert: Any, layer: str) -> Iterator[_Shape]:
        """Yield the shapes of a block, once or in an array."""
        block, name = insert.block(), str(insert.dxf.name)[:60]
        clip = importlib.import_module("ezdxf.xclip").XClip
        if block is None:
            raise FileFormatError(f"expected a block named {name!r}, got none; save it again")
        if block.block.is_xref:
            raise FileFormatError(f"expected one drawing, got external reference {name!r}; bind it")
        if clip(insert).has_clipping_path:
            raise FileFormatError(f"expected whole blocks, got {name!r}, which is clipped; trim it")
        content = list(self.shapes(block, layer))
        for copy in insert.multi_insert() if insert.mcount > 1 else (insert,):
            matrix = np.array(list(copy.matrix44().rows()))
            for shape in content:
                yield shape.transformed(matrix[:3, :3], matrix[3, :3])


def _assembled(shapes: list[_Shape], metres: float, file: File) -> Drawing:
    """Return polygons of hatches, and of outlines that are no border of a hatch."""
    paths = [path for shape in shapes for boundary in shape.boundaries for path in boundary]
    if not paths:
        raise FileFormatError(
            "expected outlines in the model space, got none; draw closed polylines, circles or "
            "hatches on a layer that is on"
        )
    points = np.concatenate([_rough(path) for path in paths])
    check_coordinates(points)
    gap, tolerance = _JOINT * _size(points), file.tolerance and file.tolerance / metres
    hatches = [shape for shape in shapes if shape.style is not None]
    painted = [
        [ring for paths in hatch.boundaries for ring, _ in
         _rings([(path, hatch.layer) for path in paths], gap, tolerance)]
        for hatch in hatches
    ]  # fmt: skip
    borders = [ring for rings in painted for ring in rings]
    single = [(shape.boundaries[0][0], shape.layer) for shape in shapes if shape.style is None]
    closed = _rings(_without_borders(single, borders, gap, tolerance), gap, tolerance)
    outlines, layers = [ring for ring, _ in closed], [layer for _, layer in closed]
    if not outlines + borders:
        raise FileFormatError("expected outlines that enclose an area, got none that do")
    heights = np.concatenate([ring[:, 2] for ring in outlines + borders])
    if np.ptp(heights) > _FLAT * (_size(points) + np.abs(points).max()):
        raise FileFormatError(
            f"expected a plane drawing, got heights from {heights.min():g} to {heights.max():g}; "
            "flatten it"
        )
    rings, edges = [ring[:, :2] for ring in outlines], [ring[:, :2] for ring in borders]
    layers += [hatch.layer for hatch, some in zip(hatches, painted, strict=True) for _ in some]
    remedy = overlap_remedy(rings + edges, layers)
    polygons = nested(without_duplicates(rings, gap), file.union, remedy) if rings else []
    return Drawing(polygons + _painted(hatches, painted), metres, remedy)


def _painted(hatches: Sequence[_Shape], painted: Sequence[list[Ring]]) -> list[list[Ring]]:
    """Return polygons of the union of all hatches, from the boundaries of each."""
    polygons = []
    for hatch, boundaries in zip(hatches, painted, strict=True):
        rings = [ring[:, :2] for ring in boundaries]
        deepest = _DEEPEST.get(hatch.style or 0, 0)
        rings = [ring for ring, d in zip(rings, depths(rings), strict=True) if d <= deepest]
        polygons += filled(rings, "evenodd")
    if len(hatches) < 2:
        return polygons
    union = union_on_grid([shapely.Polygon(outer, holes) for outer, *holes in polygons])
    return [rings_of_polygon(polygon) for polygon in polygons_in(union)]


def _rings(
    paths: Sequence[tuple[Path, str]], gap: float, tolerance: float | None
) -> list[tuple[Ring, str]]:
    """Return rings (n, 3) of closed paths, and of paths whose ends meet, with their layers."""
    closed: list[tuple[Path, str]] = []
    loose: list[tuple[Path, str]] = []
    for path, layer in paths:
        if _is_round(path) or _size(_rough(path)) > gap:  # anything shorter is a point
            is_closed = _is_round(path) or _size(_ends(path)) <= gap
            (closed if is_closed else loose).append((path, layer))
    for chain in _chains([_ends(path) for path, _ in loose], gap):
        run = [_reversed(loose[k][0]) if back else loose[k][0] for k, back in chain]
        closed.append(([curve for path in run for curve in path], loose[chain[0][0]][1]))
    rings = flattened([path for path, _ in closed], tolerance)
    layers = [layer for _, layer in closed]
    return [pair for pair in zip(rings, layers, strict=True) if len(pair[0]) > 2]


def _chains(tips: Sequence[Points], gap: float) -> list[list[tuple[int, bool]]]:
    """Return closed runs of paths whose ends (2, 3) meet in pairs within `gap`.

    Each run lists the numbers of its paths, and whether these are reversed.
    """
    if not tips:
        return []
    points = np.concatenate(tips)
    geometries = shapely.points(points[:, :2])
    first, second = shapely.STRtree(geometries).query(geometries, predicate="dwithin", distance=gap)
    counts = np.bincount(first)  # each end meets itself
    if (counts != 2).any():
        worst = int(np.argmax(counts != 2))
        x, y = points[worst, :2]
        raise FileFormatError(
            "expected lines and arcs whose ends meet in pairs, got an end at "
            f"({x:.6g}, {y:.6g}) that meets {counts[worst] - 1} others; close the outline, or "
            "move other lines to a layer that is off"
        )
    partner = np.empty_like(counts)
    partner[first[first != second]] = second[first != second]
    runs: list[list[tuple[int, bool]]] = []
    used: set[int] = set()
    for start in range(len(tips)):
        run, end = [], 2 * start  # ends 2 k and 2 k + 1 belong to path k
        while end // 2 not in used:
            used.add(end // 2)
            run.append((end // 2, end % 2 == 1))
            end = int(partner[end ^ 1])
        runs += [run] if run else []
    return runs


def _without_borders(
    paths: list[tuple[Path, str]], borders: Sequence[Ring], gap: float, tolerance: float | None
) -> list[tuple[Path, str]]:
    """Return the paths that do not run along boundaries of hatches, up to the chords of both."""
    if not borders:
        return paths
    boundaries = shapely.MultiLineString([np.append(r, r[:1], axis=0)[:, :2] for r in borders])
    shapely.prepare(boundaries)
    largest, steps = max(map(_size, borders)), np.linspace(0, 1, 5)[:-1, None, None]
    kept = []
    for path, layer in paths:
        (ring,) = flattened([path], tolerance)
        chords = np.concatenate([ring, _ends(path)[1:]])[:, :2]
        dense = np.concatenate([*(chords[:-1] + steps * np.diff(chords, axis=0)), chords[-1:]])
        slack = gap + (
            2 * tolerance if tolerance else DEFAULT_TOLERANCE * (_size(chords) + largest)
        )
        if not shapely.dwithin(boundaries, shapely.points(dense), slack).all():
            kept.append((path, layer))
    return kept
