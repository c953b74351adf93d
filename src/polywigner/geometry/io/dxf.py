"""Closed outlines of a DXF drawing: an area inside an odd number of them is open."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.exact import Ring
from polywigner.geometry.io.curves import (
    JOINT,
    Arc,
    Curve,
    Points,
    bezier_spans,
    chained,
    ends,
    flattened,
    is_closed,
    reversed_curve,
    rough_points,
    transformed,
)
from polywigner.geometry.io.drawing import Drawing, File, Format, check_known, overlap_remedy
from polywigner.geometry.io.limits import check_coordinates, place_of
from polywigner.geometry.io.outlines import nested, without_duplicates

IGNORED = frozenset({
    "TEXT", "MTEXT", "ATTRIB", "ATTDEF", "DIMENSION", "ARC_DIMENSION", "LARGE_RADIAL_DIMENSION",
    "LEADER", "MULTILEADER", "MLEADER", "TOLERANCE", "POINT", "RAY", "XLINE", "VIEWPORT", "IMAGE",
    "WIPEOUT", "OLE2FRAME", "ACAD_TABLE", "LIGHT", "SUN",
})  # fmt: skip
"""Annotation: nothing that could be an outline."""

# Flatter than 1e-9 of its chord, an arc's centre is not known from its bulge; the chord is.
_FLATTEST_BULGE = 1e-9

_LARGEST_DEGREE = 25

# Blocks inserted in blocks.
_MOST_NESTED = 16

CurvePath = list[Curve]


def paths_of(entity: Any) -> list[CurvePath]:
    """The paths of one entity, (n, 3); open ones are to be joined with others."""
    reader = _READERS.get(entity.dxftype())
    if reader is None:
        raise FileFormatError(
            f"expected lines, curves, hatches and blocks, got a {entity.dxftype()[:40]}; convert "
            "it to polylines, or move it to a layer that is off"
        )
    return reader(entity)


def _vector(point: Any) -> Points:
    return np.array([float(point[k]) if k < len(point) else 0.0 for k in range(3)])


def _to_world(entity: Any, paths: Iterable[CurvePath], elevation: float = 0.0) -> list[CurvePath]:
    """From the entity's own plane, which its extrusion direction defines."""
    ocs = entity.ocs()
    axes = np.array([list(ocs.ux), list(ocs.uy), list(ocs.uz)])
    return [[transformed(c, axes, elevation * axes[2]) for c in path] for path in paths]


def _line(entity: Any) -> list[CurvePath]:
    return [[np.array([_vector(entity.dxf.start), _vector(entity.dxf.end)])]]


def _circular(centre: Points, radius: float, start: float, end: float) -> Arc:
    """From one angle counter-clockwise to the other (degrees); equal ones mean a whole circle."""
    if not radius >= 0:
        raise FileFormatError(f"expected a radius from zero up, got {radius:g}; correct it")
    sweep = math.fmod(end - start, 360.0)
    sweep = sweep + 360 if sweep <= 0 else sweep
    u, v = np.array([radius, 0.0, 0.0]), np.array([0.0, radius, 0.0])
    return Arc(centre, u, v, math.radians(start), math.radians(sweep))


def _round(entity: Any) -> list[CurvePath]:
    """A circle, or an arc."""
    dxf, angles = entity.dxf, (0.0, 360.0)
    if entity.dxftype() == "ARC":
        angles = float(dxf.start_angle), float(dxf.end_angle)
    return _to_world(entity, [[_circular(_vector(dxf.center), float(dxf.radius), *angles)]])


def _elliptic(centre: Points, major: Points, minor: Points, start: float, end: float) -> Arc:
    """From one parameter to the other (radians); equal ones mean a whole ellipse."""
    sweep = math.fmod(end - start, 2 * math.pi)
    # The parameters of a whole ellipse are 0 and 2 pi up to rounding.
    sweep = sweep + 2 * math.pi if sweep <= 1e-9 else sweep
    return Arc(centre, major, minor, start, sweep)


def _ellipse(entity: Any) -> list[CurvePath]:
    dxf = entity.dxf
    major, normal = _vector(dxf.major_axis), _vector(dxf.extrusion)
    minor = float(dxf.ratio) * np.cross(normal / np.linalg.norm(normal), major)
    centre = _vector(dxf.center)
    return [[_elliptic(centre, major, minor, float(dxf.start_param), float(dxf.end_param))]]


def _bulging(points: Points, bulges: Points, is_closed: bool) -> CurvePath:
    """Lines and arcs through the points; a bulge is the tangent of a quarter of the arc's angle."""
    following = np.roll(points, -1, axis=0)
    path: CurvePath = []
    for k in range(len(points) if is_closed else len(points) - 1):
        start, end, bulge = points[k], following[k], float(bulges[k])
        chord = end - start
        if not chord.any():
            continue
        if abs(bulge) < _FLATTEST_BULGE:
            path.append(np.array([start, end]))
            continue
        across = np.array([-chord[1], chord[0], 0.0])
        centre = start + chord / 2 + across * (1 / bulge - bulge) / 4
        u = start - centre
        path.append(Arc(centre, u, np.array([-u[1], u[0], 0.0]), 0.0, 4 * math.atan(bulge)))
    return path


def _flat(rows: Any, is_closed: bool) -> list[CurvePath]:
    """The path of vertices (x, y, bulge) in its own plane, if there is one."""
    points = np.array(rows, dtype=np.float64).reshape(-1, 3)
    path = _bulging(points * (1.0, 1.0, 0.0), points[:, 2], is_closed)
    return [path] if path else []


def _light_polyline(entity: Any) -> list[CurvePath]:
    paths = _flat(entity.get_points("xyb"), bool(entity.closed))
    return _to_world(entity, paths, float(entity.dxf.elevation))


def _polyline(entity: Any) -> list[CurvePath]:
    if not (entity.is_2d_polyline or entity.is_3d_polyline):
        raise FileFormatError("expected plane polylines, got a POLYLINE that is a mesh; remove it")
    # Bit 16 marks the frame points of a spline that the other vertices follow.
    vertices = [v for v in entity.vertices if not v.dxf.get("flags", 0) & 16]
    points = np.array([_vector(v.dxf.location) for v in vertices]).reshape(-1, 3)
    is_plane = not entity.is_3d_polyline
    bulges = np.array([float(v.dxf.get("bulge", 0.0)) if is_plane else 0.0 for v in vertices])
    path = _bulging(points, bulges, bool(entity.is_closed))
    paths = [path] if path else []
    return _to_world(entity, paths) if is_plane else paths


def _spline_curves(tool: Any) -> CurvePath:
    """The Bezier curves of ezdxf's B-spline."""
    control = np.array([_vector(p) for p in tool.control_points])
    knots = np.array(list(tool.knots()), dtype=np.float64)
    weights = np.array(list(tool.weights()), dtype=np.float64)
    degree = len(knots) - len(control) - 1
    if not 1 <= degree <= _LARGEST_DEGREE or len(control) <= degree:
        raise FileFormatError(
            f"expected a spline of degree 1 to {_LARGEST_DEGREE} with enough control points, got "
            f"{len(control)} points and {len(knots)} knots"
        )
    if not np.isfinite(knots).all() or (np.diff(knots) < 0).any():
        raise FileFormatError("expected knots of a spline in rising order, got others")
    if len(weights) and not (np.isfinite(weights) & (weights > 0)).all():
        raise FileFormatError("expected weights of a spline above zero, got others")
    return [*bezier_spans(control, knots, weights if len(weights) else None)]


def _spline(entity: Any) -> list[CurvePath]:
    path = _spline_curves(entity.construction_tool())
    if path and entity.closed:
        start, end = ends(path[0])[0], ends(path[-1])[1]
        path += [np.array([end, start])] if (start != end).any() else []
    return [path] if path else []


def _solid(entity: Any) -> list[CurvePath]:
    corners = [_vector(entity.dxf.get(f"vtx{k}", entity.dxf.vtx2)) for k in (0, 1, 3, 2, 0)]
    return _to_world(entity, [[np.array(corners)]])


def _edge(edge: Any) -> CurvePath:
    """One edge of a hatch boundary, in the hatch's plane, running the way it is listed."""
    kind = type(edge).__name__
    if kind == "LineEdge":
        return [np.array([_vector(edge.start), _vector(edge.end)])]
    if kind == "SplineEdge":
        return _spline_curves(edge.construction_tool())
    centre = _vector(edge.center)
    if kind == "ArcEdge":
        arc = _circular(centre, float(edge.radius), float(edge.start_angle), float(edge.end_angle))
    else:
        major = _vector(edge.major_axis)
        minor = float(edge.ratio) * np.array([-major[1], major[0], 0.0])
        arc = _elliptic(centre, major, minor, float(edge.start_param), float(edge.end_param))
    return [arc if edge.ccw else reversed_curve(arc)]


def _hatch(entity: Any) -> list[CurvePath]:
    paths: list[CurvePath] = []
    for boundary in entity.paths:
        if hasattr(boundary, "vertices"):
            paths += _flat(boundary.vertices, True)
        else:
            paths += _joined([_edge(edge) for edge in boundary.edges])
    return _to_world(entity, paths, _vector(entity.dxf.elevation)[2])


def _joined(edges: list[CurvePath]) -> list[CurvePath]:
    """The edges of one boundary; each whole circle among them is an outline of its own."""
    edges = [edge for edge in edges if edge]
    if not edges:
        return []
    points = np.concatenate([rough_points(curve) for edge in edges for curve in edge])
    gap = JOINT * float(np.linalg.norm(np.ptp(points, axis=0)))
    whole = [edge for edge in edges if is_closed(edge, gap)]
    return whole + chained([edge for edge in edges if not is_closed(edge, gap)], gap)


_READERS = {
    "LINE": _line, "ARC": _round, "CIRCLE": _round, "ELLIPSE": _ellipse, "SPLINE": _spline,
    "LWPOLYLINE": _light_polyline, "POLYLINE": _polyline, "HATCH": _hatch, "SOLID": _solid,
    "TRACE": _solid,
}  # fmt: skip


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


def read_dxf(file: File) -> Drawing:
    """The outlines in the model space of a DXF file, on layers that are on."""
    ezdxf: Any = importlib.import_module("ezdxf")
    try:
        document = ezdxf.readfile(file.path)
        metres = _metres(document, file)
        paths = _Blocks(document, file.layers).drawn()
    except (PolywignerError, MemoryError):
        raise
    except Exception as error:  # a damaged file can fail anywhere in ezdxf, with any exception
        why = f"{type(error).__name__}{place_of(error)}"
        raise FileFormatError(f"expected DXF, got a file that ezdxf does not read: {why}") from None
    rings, remedy = _rings(paths, file.tolerance and file.tolerance / metres)
    return Drawing(nested(rings, file.union, remedy), metres, remedy)


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
        if depth > _MOST_NESTED:
            raise FileFormatError(
                f"expected blocks nested at most {_MOST_NESTED} deep, got more (or a block "
                "that contains itself); explode them"
            )
        for entity in layout:
            kind = entity.dxftype()
            layer = _layer_of(entity)
            if kind in IGNORED or layer.lower() in self.hidden or entity.dxf.get("invisible", 0):
                continue
            if kind == "INSERT":
                yield from self._inserted(entity, layer, depth)
            # Layer 0 of a block stands for the layer that the block is inserted on.
            elif self._is_asked(layer) or (depth and layer == "0"):
                yield from ((path, layer) for path in paths_of(entity))

    def _inserted(self, insert: Any, layer: str, depth: int) -> Iterator[_Drawn]:
        name = str(insert.dxf.name)
        if name not in self.known:
            block = insert.block()
            if block is None:
                raise FileFormatError(f"expected a block named {name[:60]!r}, got none")
            self.known[name] = list(self.paths(block, depth + 1))
        content = self.known[name]
        for copy in insert.multi_insert() if content and insert.mcount > 1 else (insert,):
            rows = np.array(list(copy.matrix44().rows()))
            for path, own in content:
                moved = [transformed(curve, rows[:3, :3], rows[3, :3]) for curve in path]
                yield moved, layer if own == "0" else own


def _rings(drawn: Sequence[_Drawn], tolerance: float | None) -> tuple[list[Ring], str]:
    """Flat rings (n, 2) of closed paths and of paths that close when joined; and a remedy."""
    paths = [path for path, _ in drawn]
    if not paths:
        raise FileFormatError(
            "expected outlines in the model space, got none; draw closed polylines, circles or "
            "hatches on a layer that is on"
        )
    points = np.concatenate([rough_points(curve) for path in paths for curve in path])
    check_coordinates(points)
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


FORMATS = (
    Format(
        "DXF", (".dxf",), read_dxf,
        rb"AutoCAD Binary DXF|(?:999\r?\n[^\n]*\n\s*)*0\s*\r?\n\s*SECTION",
        ("ezdxf",), True,
    ),
)  # fmt: skip
