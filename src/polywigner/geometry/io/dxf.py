"""Outlines and hatches of a DXF drawing, which ezdxf reads, places and flattens.

An area inside an odd number of outlines is open. Hatches are painted: one on the other is a union.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
import shapely

from polywigner.errors import FileFormatError
from polywigner.geometry.io.curves import DEFAULT_TOLERANCE, Arc, Curve, Points, chords
from polywigner.geometry.io.drawing import Drawing, File, check_known, overlap_remedy
from polywigner.geometry.io.limits import check_coordinates, check_vertices
from polywigner.geometry.io.outlines import depths, filled, nested, without_duplicates
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


_Placed = Callable[[Any], Any]
"""Map of a point of ezdxf to the coordinates of the world."""

# Relative difference of angles and points that are the same up to rounding.
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class _Spline:
    """A B-spline over its own range of knots; ezdxf flattens one that is not clamped beyond it."""

    tool: Any
    placed: _Placed
    is_closed: bool = False

    def chords(self, distance: float) -> Points:
        """Return vertices (n, 3) of chords within a distance; infinite: rough ones."""
        control, knots = _array(self.tool.control_points), np.array(list(self.tool.knots()))
        if not min(self.tool.weights(), default=1.0) > 0:
            raise FileFormatError("expected weights of a spline above zero, got others")
        size = _size(control)
        breaks = np.unique(knots[self.tool.degree : len(control) + 1])
        t = np.interp(np.arange(4 * len(breaks) - 3) / 4, np.arange(len(breaks)), breaks)
        while True:
            check_vertices(len(t))
            points, middle = self._at(t), (t[1:] + t[:-1]) / 2
            # The distance to the middle of a chord bounds the distance to the chord.
            off = np.linalg.norm(self._at(middle) - (points[1:] + points[:-1]) / 2, axis=1)
            if (off <= min(distance, 0.05 * size)).all():
                break
            t = np.union1d(t, middle[off > min(distance, 0.05 * size)])
        is_open = self.is_closed and _size(points[[0, -1]]) > _SAME * size
        return np.concatenate([points, points[:is_open]])

    def _at(self, t: Points) -> Points:
        return _array(map(self.placed, self.tool.points(t.tolist())))


@dataclass(frozen=True, eq=False)
class _Path:
    """Curves that follow each other, each in either direction."""

    curves: list[Curve | _Spline]
    layer: str

    @property
    def is_round(self) -> bool:
        """Whether the path is a full circle or ellipse."""
        return isinstance(self.curves[0], Arc) and self.curves[0].is_closed

    def points(self, distance: float = math.inf) -> Points:
        """Return vertices (n, 3) of chords within a distance; rough ones by default."""
        runs = [
            curve.chords(distance) if isinstance(curve, _Spline) else chords(curve, distance)
            for curve in self.curves
        ]
        check_vertices(sum(map(len, runs)))
        return _joined(runs)


@dataclass(frozen=True, eq=False)
class _Hatch:
    """Closed boundaries of an area that is painted."""

    boundaries: list[list[_Path]]
    style: int
    layer: str


def _joined(runs: list[Points]) -> Points:
    """Return one run of points (n, 3) from runs that follow each other, in either direction."""
    if len(runs) == 1:
        return runs[0]
    # The first run starts at its end that is farther from the second one.
    gaps = np.abs(runs[0][[0, -1], None] - runs[1][[0, -1]]).max(axis=2).min(axis=1)
    pieces = [runs[0] if gaps[1] <= gaps[0] else runs[0][::-1]]
    for run in runs[1:]:
        near, far = np.abs(run[[0, -1]] - pieces[-1][-1]).max(axis=1)
        pieces.append(run if near <= far else run[::-1])
    return np.concatenate([*(piece[:-1] for piece in pieces), pieces[-1][-1:]])


def _size(points: Points) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _array(points: Iterable[Any]) -> Points:
    array = np.array([[p.x, p.y, p.z if len(p) > 2 else 0.0] for p in points]).reshape(-1, 3)
    check_coordinates(array)
    return array


def _unmoved(point: Any) -> Any:
    return point


def _elliptic(centre: Any, u: Any, v: Any, angles: tuple[float, float], placed: _Placed) -> Arc:
    """Return the arc from one angle to another (radians); equal ones are a full turn apart."""
    origin, first, second = _array(map(placed, (centre, centre + u, centre + v)))
    sweep = (angles[1] - angles[0]) % math.tau
    is_full = abs(math.remainder(sweep, math.tau)) <= _SAME * math.tau
    return Arc(origin, first - origin, second - origin, angles[0], math.tau if is_full else sweep)


def _arc(centre: Any, radius: float, degrees: tuple[float, float], placed: _Placed) -> Arc:
    if not radius >= 0:
        raise FileFormatError(f"expected a radius from zero up, got {radius:g}; correct it")
    vector = importlib.import_module("ezdxf.math").Vec3
    angles = math.radians(degrees[0]), math.radians(degrees[1])
    return _elliptic(vector(centre), vector(radius, 0), vector(0, radius), angles, placed)


def _ellipse(tool: Any, placed: _Placed) -> Arc:
    angles = tool.start_param, tool.end_param
    return _elliptic(tool.center, tool.major_axis, tool.minor_axis, angles, placed)


def _curve(entity: Any) -> Curve | _Spline:
    """Return the curve of a line, arc, circle, ellipse or spline."""
    kind, dxf = entity.dxftype(), entity.dxf
    if kind == "LINE":
        return _array([dxf.start, dxf.end])
    if kind == "SPLINE":
        return _Spline(entity.construction_tool(), _unmoved, entity.closed)
    if kind == "ELLIPSE":
        return _ellipse(entity.construction_tool(), _unmoved)
    degrees = (0.0, 0.0) if kind == "CIRCLE" else (dxf.start_angle, dxf.end_angle)
    return _arc(dxf.center, dxf.radius, degrees, entity.ocs().to_wcs)


def _curve_of_edge(edge: Any, placed: _Placed) -> Curve | _Spline:
    """Return the curve of an edge of a hatch boundary."""
    kind = type(edge).__name__
    if kind == "LineEdge":
        return _array(map(placed, (edge.start, edge.end)))
    if kind == "ArcEdge":
        return _arc(edge.center, edge.radius, (edge.start_angle, edge.end_angle), placed)
    tool = edge.construction_tool()
    return _ellipse(tool, placed) if kind == "EllipseEdge" else _Spline(tool, placed, False)


def _full_circle(curves: list[Any]) -> Arc | None:
    """Return the circle of two arcs that make one, whose chords keep its area."""
    if len(curves) != 2 or not all(isinstance(curve, Arc) for curve in curves):
        return None
    one, other = curves
    apart = np.abs([one.centre - other.centre, one.u - other.u, one.v - other.v]).max()
    turn = one.sweep + other.sweep - math.tau
    is_full = apart <= _SAME * one.stretch and abs(turn) <= _SAME
    return replace(one, sweep=math.tau) if is_full else None


def _polyline(polyline: Any, layer: str) -> _Path | _Hatch | None:
    """Return the path of a polyline, or the ring of a donut: two half circles with one width."""
    if polyline.dxftype() == "POLYLINE" and not (
        polyline.is_2d_polyline or polyline.is_3d_polyline
    ):
        raise FileFormatError("expected plane polylines, got a POLYLINE that is a mesh; remove it")
    curves = [_curve(piece) for piece in polyline.virtual_entities()]
    circle, widths = _full_circle(curves), _widths_of(polyline)
    width = max(map(max, widths), default=0.0)
    if not width:
        return _Path([circle] if circle else curves, layer) if curves else None
    if not circle or widths != {(width, width)}:
        raise FileFormatError(
            f"expected polylines of width zero or donuts, got one of width {width:g} on layer "
            f"{layer[:60]!r}; set its width to zero, or draw its area as a hatch"
        )
    factors = 1 + width / 2 / circle.stretch, 1 - width / 2 / circle.stretch
    rings = [replace(circle, u=f * circle.u, v=f * circle.v) for f in factors if f > 0]
    return _Hatch([[_Path([ring], layer)] for ring in rings], 0, layer)


def _widths_of(polyline: Any) -> set[tuple[float, float]]:
    """Return the widths at the start and the end of the segments of a polyline."""
    dxf = polyline.dxf
    if polyline.dxftype() == "LWPOLYLINE":
        width = float(dxf.get("const_width", 0.0))
        found = {(float(s), float(e)) for s, e in polyline.get_points("se")}
        return {(width, width)} if found <= {(0.0, 0.0)} else found
    usual = float(dxf.get("default_start_width", 0.0)), float(dxf.get("default_end_width", 0.0))
    return {
        (float(v.dxf.get("start_width", usual[0])), float(v.dxf.get("end_width", usual[1])))
        for v in polyline.vertices
    }


def _hatch(hatch: Any, layer: str) -> _Hatch:
    to_wcs, height = hatch.ocs().to_wcs, hatch.dxf.elevation.z
    polylines = [hasattr(boundary, "vertices") for boundary in hatch.paths]
    for boundary in hatch.paths.paths:
        boundary.is_closed = True  # edges close by their ends
    hatch.paths.polyline_to_edge_paths(just_with_bulge=False)
    boundaries = []
    for boundary, in_sequence in zip(hatch.paths, polylines, strict=True):
        curves = [_curve_of_edge(e, lambda p: to_wcs((p[0], p[1], height))) for e in boundary.edges]
        circle = _full_circle(curves)
        runs: Any = [[circle]] if circle else [curves] if in_sequence else [[c] for c in curves]
        boundaries.append([_Path(run, layer) for run in runs if run])
    return _Hatch(boundaries, int(hatch.dxf.get("hatch_style", 0)), layer)


def _shapes_of(entity: Any, layer: str) -> Iterator[_Path | _Hatch]:
    """Yield the paths and painted areas of one entity."""
    kind = entity.dxftype()
    if kind in ("LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE"):
        yield _Path([_curve(entity)], layer)
    elif kind in ("LWPOLYLINE", "POLYLINE"):
        shape = _polyline(entity, layer)
        yield from [shape] if shape else []
    elif kind == "HATCH":
        yield _hatch(entity, layer)
    elif kind in ("SOLID", "TRACE"):
        yield _Hatch([[_Path([_array(entity.wcs_vertices(close=True))], layer)]], 0, layer)
    else:
        raise FileFormatError(
            f"expected lines, curves, hatches and blocks, got a {kind[:40]}; convert it to "
            "polylines, or move it to a layer that is off"
        )


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

    def shapes(
        self, entities: Iterable[Any], around: str | None = None
    ) -> Iterator[_Path | _Hatch]:
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
                yield from _shapes_of(entity, layer)

    def _inserted(self, insert: Any, layer: str) -> Iterator[_Path | _Hatch]:
        block, name = insert.block(), str(insert.dxf.name)[:60]
        clip = importlib.import_module("ezdxf.xclip").XClip
        if block is None:
            raise FileFormatError(f"expected a block named {name!r}, got none; save it again")
        if block.block.is_xref:
            raise FileFormatError(f"expected one drawing, got external reference {name!r}; bind it")
        if clip(insert).has_clipping_path:
            raise FileFormatError(f"expected whole blocks, got {name!r}, which is clipped; trim it")
        scale = insert.dxf.get("xscale", 1), insert.dxf.get("yscale", 1)
        if abs(scale[0]) != abs(scale[1]):  # ezdxf drops widths here
            for entity in block.query("LWPOLYLINE POLYLINE"):
                if not _widths_of(entity) <= {(0.0, 0.0)}:
                    raise FileFormatError(
                        f"expected polylines of width zero, got another in {name!r}, which is "
                        "stretched; explode it"
                    )
        for copy in insert.multi_insert() if insert.mcount > 1 else (insert,):
            content = copy.virtual_entities(skipped_entity_callback=_refuse_skipped)
            yield from self.shapes(content, layer)


def _refuse_skipped(entity: Any, reason: str) -> None:
    if entity.dxftype() not in _IGNORED:
        raise FileFormatError(
            f"expected blocks that can be exploded, got a {entity.dxftype()[:40]} in one "
            f"({reason[:60]}); explode them before export"
        )


def _assembled(shapes: list[_Path | _Hatch], metres: float, file: File) -> Drawing:
    """Return polygons of hatches, and of outlines that are no border of a hatch."""
    hatches = [shape for shape in shapes if isinstance(shape, _Hatch)]
    paths = [shape for shape in shapes if isinstance(shape, _Path)]
    every = paths + [path for hatch in hatches for side in hatch.boundaries for path in side]
    if not every:
        raise FileFormatError(
            "expected outlines in the model space, got none; draw closed polylines, circles or "
            "hatches on a layer that is on"
        )
    points = np.concatenate([path.points() for path in every])
    gap, tolerance = _JOINT * _size(points), file.tolerance and file.tolerance / metres
    painted = [
        [ring for side in hatch.boundaries for ring, _ in _outlines(side, gap, tolerance)]
        for hatch in hatches
    ]
    borders = [ring for rings in painted for ring in rings]
    if borders:
        paths = [path for path in paths if not _is_border(path, borders, gap, tolerance)]
    closed = _outlines(paths, gap, tolerance)
    outlines = [ring for ring, _ in closed]
    if not outlines + borders:
        raise FileFormatError("expected outlines that enclose an area, got none that do")
    heights = np.concatenate([ring[:, 2] for ring in outlines + borders])
    if np.ptp(heights) > _FLAT * (_size(points) + np.abs(points).max()):
        raise FileFormatError(
            f"expected a plane drawing, got heights from {heights.min():g} to {heights.max():g}; "
            "flatten it"
        )
    rings, edges = [ring[:, :2] for ring in outlines], [ring[:, :2] for ring in borders]
    layers = [layer for _, layer in closed]
    layers += [hatch.layer for hatch, some in zip(hatches, painted, strict=True) for _ in some]
    remedy = overlap_remedy(rings + edges, layers)
    polygons = nested(without_duplicates(rings, gap), file.union, remedy) if rings else []
    return Drawing(polygons + _painted(hatches, painted), metres, remedy)


def _painted(hatches: Sequence[_Hatch], painted: Sequence[list[Ring]]) -> list[list[Ring]]:
    """Return polygons of the union of all hatches, from the boundaries of each."""
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


def _reach(points: Points, tolerance: float | None) -> float:
    """Return the largest distance between a curve and its chords, for rough points of it."""
    return max(tolerance or DEFAULT_TOLERANCE * _size(points), np.finfo(float).tiny)


def _outlines(
    paths: Sequence[_Path], gap: float, tolerance: float | None
) -> list[tuple[Ring, str]]:
    """Return rings (n, 3) of closed paths, and of paths whose ends meet, with their layers."""
    runs, loose = [], []
    for path in paths:
        points = path.points()
        if path.is_round or (_size(points) > gap and _size(points[[0, -1]]) <= gap):
            runs.append([path])
        elif _size(points) > gap:  # anything shorter is a point
            loose.append(path)
    tips = [path.points()[[0, -1]] for path in loose]
    runs += [[loose[k] for k in run] for run in _chains(tips, gap)]
    found: list[tuple[Any, str]] = []
    for run in runs:
        reach = _reach(np.concatenate([path.points() for path in run]), tolerance)
        ring = _joined([path.points(reach) for path in run])[:-1]
        found += [(ring, run[0].layer)] if len(ring) > 2 else []
    return found


def _chains(tips: Sequence[Points], gap: float) -> list[list[int]]:
    """Return closed runs of paths, by number, whose ends (2, d) meet in pairs within `gap`."""
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
    runs: list[list[int]] = []
    used: set[int] = set()
    for start in range(len(tips)):
        run, end = [], 2 * start  # ends 2 k and 2 k + 1 belong to path k
        while end // 2 not in used:
            used.add(end // 2)
            run.append(end // 2)
            end = int(partner[end ^ 1])
        runs += [run] if run else []
    return runs


def _is_border(path: _Path, borders: Sequence[Ring], gap: float, tolerance: float | None) -> bool:
    """Whether a path runs along boundaries of hatches, up to the chords of both."""
    lines = [np.concatenate([border, border[:1]])[:, :2] for border in borders]
    reach = _reach(path.points(), tolerance)
    slack = gap + reach + max(_reach(border, tolerance) for border in borders)
    chords = path.points(reach)[:, :2]
    steps = np.linspace(0, 1, 5)[:-1, None, None]
    dense = np.concatenate([*(chords[:-1] + steps * np.diff(chords, axis=0)), chords[-1:]])
    boundaries = shapely.MultiLineString(lines)
    shapely.prepare(boundaries)
    return bool(shapely.dwithin(boundaries, shapely.points(dense), slack).all())
