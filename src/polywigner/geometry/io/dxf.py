"""Reader of outlines and hatches in a DXF drawing, parsed by ezdxf."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np
import shapely

from polywigner.errors import FileFormatError
from polywigner.geometry.io.limits import check_coordinates
from polywigner.geometry.io.outlines import (
    Arc,
    Curve,
    Drawing,
    File,
    Points,
    Spline,
    allowed_distance,
    check_known,
    chords,
    filled,
    nested,
    nesting_depths,
    sampled,
    transformed,
)
from polywigner.geometry.parts import polygons_in, union_on_grid
from polywigner.geometry.rings import Ring, extent, rings_of_polygon

_IGNORED = frozenset({
    "TEXT", "MTEXT", "ATTRIB", "ATTDEF", "DIMENSION", "ARC_DIMENSION", "LARGE_RADIAL_DIMENSION",
    "LEADER", "MULTILEADER", "MLEADER", "TOLERANCE", "POINT", "RAY", "XLINE", "VIEWPORT", "IMAGE",
    "WIPEOUT", "OLE2FRAME", "ACAD_TABLE", "LIGHT", "SUN",
})  # fmt: skip
"""Types of annotations, which cannot be outlines."""

_JOINT = 1e-6
"""Largest gap between two ends that are connected, as a fraction of the drawing's diagonal.

CAD programs write six decimals or more, so the ends meet within 1e-4 in a drawing of 100 units.
"""

# Largest difference between heights in a planar drawing, as a fraction of its diagonal.
_FLAT = 1e-9
# Largest deviation of an arc from a full circle that counts as rounding error, as a fraction of the
# circle.
_SAME = 1e-9
# Deepest nesting level of the hatch boundaries that are used, for the hatch styles normal (0),
# outer (1, islands are not filled) and ignore (2).
_DEEPEST = {0: 1_000_000, 1: 1, 2: 0}

# Metres per drawing unit, for each value of $INSUNITS.
_UNITS = {
    1: 0.0254, 2: 0.3048, 3: 1609.344, 4: 1e-3, 5: 1e-2, 6: 1.0, 7: 1e3, 8: 2.54e-8, 9: 2.54e-5,
    10: 0.9144, 11: 1e-10, 12: 1e-9, 13: 1e-6, 14: 0.1, 15: 10.0, 16: 100.0, 17: 1e9,
}  # fmt: skip

Path = list[Curve]
"""List of curves, each starting at the end of the previous curve."""


@dataclass(frozen=True, eq=False)
class _Shape:
    """The boundaries of one entity, each as a list of paths that form one closed outline."""

    boundaries: list[list[Path]]
    style: int | None = None
    """Style of a hatch; None for outlines, which have only one path."""

    def transformed(self, matrix: Points, offset: Points) -> _Shape:
        """Return the image of the shape under the map p -> p @ matrix + offset."""
        images = [
            [[transformed(curve, matrix, offset) for curve in path] for path in paths]
            for paths in self.boundaries
        ]
        return replace(self, boundaries=images)


def _sample_points(path: Path) -> Points:
    """Return some points (n, d) along a path, which approximate its extent."""
    return np.concatenate([sampled(curve, 8) for curve in path])


def _ends(path: Path) -> Points:
    """Return the first and the last point of a path, shape (2, d)."""
    return np.stack([sampled(path[0])[0], sampled(path[-1])[-1]])


def _spatial(points: Iterable[Any]) -> Points:
    """Return points as an array (n, 3), with z = 0 for plane points.

    Raises FileFormatError for coordinates that are not finite or too large.
    """
    array = np.array([[*p, 0.0][:3] for p in points], dtype=np.float64).reshape(-1, 3)
    check_coordinates(array)
    return array


def _elliptic_arc(centre: Points, u: Points, v: Points, start: float, end: float) -> Arc:
    """Return the counter-clockwise arc of an ellipse between two angles in radians.

    ``u`` and ``v``: semi-axes (3,). The angles are values of the parameter t of :class:`Arc`. Equal
    angles result in the full ellipse.
    """
    sweep = (end - start) % math.tau
    is_full = abs(math.remainder(sweep, math.tau)) <= _SAME * math.tau
    return Arc(centre, u, v, start, math.tau if is_full else sweep)


def _path_of(kind: str, item: Any) -> Path:
    """Convert a line, arc, circle, ellipse or spline of ezdxf to a path of one curve.

    ``kind``: type of the entity or edge in capital letters. The path is in the coordinates of the
    entity, not of the world.
    """
    data = getattr(item, "dxf", item)
    if kind == "LINE":
        return [_spatial([data.start, data.end])]
    if kind in ("ARC", "CIRCLE"):
        (centre,), (x, y, _) = _spatial([data.center]), data.radius * np.eye(3)
        angles = (0.0, 0.0) if kind == "CIRCLE" else (data.start_angle, data.end_angle)
        return [_elliptic_arc(centre, x, y, math.radians(angles[0]), math.radians(angles[1]))]
    tool = item.construction_tool()
    if kind == "ELLIPSE":
        centre, x, y = _spatial([tool.center, tool.major_axis, tool.minor_axis])
        return [_elliptic_arc(centre, x, y, tool.start_param, tool.end_param)]
    control = _spatial(tool.control_points)
    # The range of knots is used, because ezdxf would evaluate unclamped splines outside this range.
    breaks = np.unique(list(tool.knots())[tool.degree : len(control) + 1])
    return [Spline(control, lambda t: _spatial(tool.points(t.tolist())), breaks)]


def _path_of_bulges(rows: Points, is_closed: bool, height: float = 0.0) -> Path:
    """Return the lines and arcs of a polyline, from rows (n, 3) of x, y and bulge.

    A bulge is the tangent of a quarter of the sweep of the arc from its vertex to the next vertex,
    positive for counter-clockwise arcs. ``height``: z coordinate.
    """
    rows = np.concatenate([rows, rows[: int(is_closed)]])
    points, bulges = np.insert(rows[:, :2], 2, height, axis=1), rows[:-1, 2]
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
    return curves


def _path_of_polyline(polyline: Any, layer: str) -> Path:
    """Convert a plane polyline to a path; raise FileFormatError if it has a width.

    ``layer``: name of its layer, for the error message.
    """
    if polyline.has_width:
        raise FileFormatError(
            "expected polylines of width zero, got a polyline with a width on layer "
            f"{layer[:60]!r}; set its width to zero, or draw its area as a hatch"
        )
    if polyline.dxftype() == "LWPOLYLINE":
        rows, height = polyline.get_points("xyb"), polyline.dxf.elevation
    else:
        rows = [(*v.dxf.location.vec2, v.dxf.get("bulge", 0.0)) for v in polyline.vertices]
        height = polyline.dxf.elevation.z
    return _path_of_bulges(np.array(rows).reshape(-1, 3), polyline.is_closed, height)


def _hatch_boundaries(hatch: Any) -> list[list[Path]]:
    """Return the boundaries of a hatch; each is a list of paths that form one outline."""
    boundaries = []
    for boundary in hatch.paths:
        if hasattr(boundary, "vertices"):
            rows = np.array(boundary.vertices, dtype=np.float64).reshape(-1, 3)
            boundaries.append([_path_of_bulges(rows, True)] if len(rows) else [])
        else:
            kinds = [type(edge).__name__.removesuffix("Edge").upper() for edge in boundary.edges]
            boundaries.append([_path_of(*pair) for pair in zip(kinds, boundary.edges, strict=True)])
    return boundaries


def _shape_of(entity: Any, layer: str) -> _Shape:
    """Convert an entity to a shape in world coordinates.

    Raises FileFormatError for unsupported types. ``layer``: name of its layer, for the error
    message.
    """
    kind = entity.dxftype()
    if kind in ("LINE", "ELLIPSE", "SPLINE"):
        return _Shape([[_path_of(kind, entity)]])
    if kind in ("SOLID", "TRACE"):
        return _Shape([[[_spatial(entity.wcs_vertices(close=True))]]], 0)
    if kind == "POLYLINE" and entity.is_3d_polyline:
        points = _spatial(v.dxf.location for v in entity.vertices)
        return _Shape([[[np.concatenate([points, points[: int(entity.is_closed)]])]]])
    offset = np.zeros(3)
    if kind in ("ARC", "CIRCLE"):
        shape = _Shape([[_path_of(kind, entity)]])
    elif kind == "LWPOLYLINE" or (kind == "POLYLINE" and entity.is_2d_polyline):
        shape = _Shape([[_path_of_polyline(entity, layer)]])
    elif kind == "HATCH":
        shape = _Shape(_hatch_boundaries(entity), int(entity.dxf.get("hatch_style", 0)))
        offset[2] = entity.dxf.elevation.z
    else:
        raise FileFormatError(
            f"expected lines, plane polylines, curves, hatches and blocks, got a {kind[:40]}; "
            "convert it to polylines, or move it to a layer that is off"
        )
    # The coordinates of planar DXF entities refer to an object coordinate system.
    axes = _spatial(map(entity.ocs().to_wcs, np.eye(3).tolist()))
    return shape.transformed(axes, offset @ axes)


def load_dxf(file: File) -> Drawing:
    """Load the outlines and hatches on visible or requested layers of a DXF file's model space."""
    document = importlib.import_module("ezdxf").readfile(file.path)
    # Without $INSUNITS, ezdxf would assume metres.
    code = document.header.get("$INSUNITS", 0) if b"$INSUNITS" in file.content else 0
    if code not in (0, *_UNITS):
        raise FileFormatError(
            f"expected a drawing unit ($INSUNITS) from 0 to {max(_UNITS)}, got {code!r}; save "
            "the drawing in millimetres"
        )
    space = _Space(document, file.layers)
    shapes = list(space.shapes(document.modelspace()))
    return _drawing_of(shapes, _UNITS.get(code, file.unit_metres), file)


def _layer_of(entity: Any) -> str:
    """Return the name of the layer of an entity; by default "0"."""
    return str(entity.dxf.get("layer", "0"))


class _Space:
    """The layers of a drawing, including the layers to be read."""

    def __init__(self, document: Any, layers: Sequence[str]) -> None:
        """Determine the layers to be read; raise ArgumentError if a requested layer is missing."""
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
            # Entities on layer 0 of a block belong to the layer on which the block is inserted.
            layer = around if layer == "0" and around else layer
            if kind in _IGNORED or entity.dxf.get("invisible", 0):
                continue
            if kind == "INSERT":
                # Frozen layers hide inserted blocks; layers that are off do not.
                if layer.lower() not in self.frozen:
                    yield from self._shapes_of_insert(entity, layer)
            elif layer.lower() not in self.hidden and (
                not self.requested or layer.lower() in self.requested
            ):
                yield _shape_of(entity, layer)

    def _shapes_of_insert(self, insert: Any, layer: str) -> Iterator[_Shape]:
        """Yield the shapes of an inserted block, at each of its positions.

        ``layer``: layer on which the block is inserted. Raises FileFormatError if the block is
        missing, external or clipped.
        """
        block, clip = insert.block(), importlib.import_module("ezdxf.xclip").XClip
        if block is None or block.block.is_xref or clip(insert).has_clipping_path:
            raise FileFormatError(
                "expected a block that the drawing contains, got block "
                f"{str(insert.dxf.name)[:60]!r}, which is missing, external or clipped; bind "
                "it, or explode it and trim its outlines"
            )
        content = list(self.shapes(block, layer))
        for copy in insert.multi_insert() if insert.mcount > 1 else (insert,):
            matrix = np.array(list(copy.matrix44().rows()))
            for shape in content:
                yield shape.transformed(matrix[:3, :3], matrix[3, :3])


def _drawing_of(shapes: list[_Shape], metres: float, file: File) -> Drawing:
    """Return the polygons of plane shapes: nested outlines, and the union of all hatches.

    ``metres``: length of the drawing unit. Raises FileFormatError if the shapes do not all have
    the same z, or enclose no area.
    """
    paths = [path for shape in shapes for boundary in shape.boundaries for path in boundary]
    if not paths:
        raise FileFormatError(
            "the model space contains no outlines; draw closed polylines, circles or hatches "
            "on a layer that is on"
        )
    points = np.concatenate([_sample_points(path) for path in paths])
    check_coordinates(points)
    heights = points[:, 2]
    if np.ptp(heights) > _FLAT * (extent(points) + np.abs(points).max()):
        raise FileFormatError(
            f"expected a plane drawing, got heights from {heights.min():g} to "
            f"{heights.max():g}; move all entities to one height"
        )
    gap, tolerance = _JOINT * extent(points), file.tolerance and file.tolerance / metres
    shapes = [shape.transformed(np.eye(3)[:, :2], np.zeros(2)) for shape in shapes]
    hatches = [shape for shape in shapes if shape.style is not None]
    painted = [
        [ring for paths in hatch.boundaries for ring in _closed_rings(paths, gap, tolerance)]
        for hatch in hatches
    ]
    single = [shape.boundaries[0][0] for shape in shapes if shape.style is None]
    rings = _closed_rings(single, gap, tolerance)
    if not any([rings, *painted]):
        raise FileFormatError(
            "expected outlines that enclose an area, got only outlines of zero area"
        )
    polygons = nested(rings, file.union) if rings else []
    return Drawing(polygons + _union_of_hatches(hatches, painted), metres)


def _union_of_hatches(hatches: Sequence[_Shape], painted: Sequence[list[Ring]]) -> list[list[Ring]]:
    """Return the polygons of the union of all hatches.

    ``painted``: the rings of each hatch. Rings nested too deep for the hatch style are ignored.
    """
    polygons = []
    for hatch, rings in zip(hatches, painted, strict=True):
        deepest = _DEEPEST.get(hatch.style or 0, 0)
        outer = [ring for ring, d in zip(rings, nesting_depths(rings), strict=True) if d <= deepest]
        polygons += filled(outer, "evenodd")
    if len(hatches) < 2:
        return polygons
    union = union_on_grid([shapely.Polygon(outer, holes) for outer, *holes in polygons])
    return [rings_of_polygon(polygon) for polygon in polygons_in(union)]


def _closed_rings(paths: Sequence[Path], gap: float, tolerance: float | None) -> list[Ring]:
    """Return rings (n, 2) of closed paths, and of chains of paths whose ends meet.

    ``gap``: largest distance between ends that meet. ``tolerance``: largest distance of chords from
    curves; see :func:`allowed_distance` for the default. Both distances are in the drawing's unit.
    Raises FileFormatError if an open end does not meet exactly one other end.
    """
    # Paths shorter than the gap count as points and are dropped.
    paths = [path for path in paths if extent(_sample_points(path)) > gap]
    is_open = [extent(_ends(path)) > gap for path in paths]
    runs = [[(path, False)] for path in compress(paths, np.logical_not(is_open))]
    loose = list(compress(paths, is_open))
    for chain in _closed_chains([_ends(path) for path in loose], gap):
        runs.append([(loose[k], is_reversed) for k, is_reversed in chain])
    rings = []
    for run in runs:
        distance = allowed_distance([curve for path, _ in run for curve in path], tolerance)
        pieces = [_path_chords(path, distance)[:: -1 if back else 1] for path, back in run]
        rings.append(np.concatenate([piece[:-1] for piece in pieces]))
    return [ring for ring in rings if len(ring) > 2]


def _path_chords(path: Path, distance: float) -> Points:
    """Return the distinct vertices (n, d) of chords that lie within ``distance`` of a path."""
    pieces = [chords(curve, distance) for curve in path]
    return np.concatenate([*(piece[:-1] for piece in pieces[:-1]), pieces[-1]])


def _closed_chains(tips: Sequence[Points], gap: float) -> list[list[tuple[int, bool]]]:
    """Connect paths whose ends are at most `gap` apart into closed chains.

    ``tips``: ends (2, 3) of each path. A chain is a list of (path number, whether it is reversed).
    Raises FileFormatError if an end does not meet exactly one other end.
    """
    if not tips:
        return []
    points = np.concatenate(tips)
    geometries = shapely.points(points[:, :2])
    first, second = shapely.STRtree(geometries).query(geometries, predicate="dwithin", distance=gap)
    counts = np.bincount(first)
    if (counts != 2).any():
        worst = int(np.argmax(counts != 2))
        x, y = points[worst, :2]
        raise FileFormatError(
            f"expected lines and arcs whose ends meet in pairs, got an end at ({x:.6g}, "
            f"{y:.6g}) that meets {counts[worst] - 1} others; close the outline, or move "
            "unrelated lines to a layer that is off"
        )
    partner = np.empty_like(counts)
    partner[first[first != second]] = second[first != second]
    runs: list[list[tuple[int, bool]]] = []
    used: set[int] = set()
    for start in range(len(tips)):
        # The ends of path k have the indices 2 k and 2 k + 1.
        run, end = [], 2 * start
        while end // 2 not in used:
            used.add(end // 2)
            run.append((end // 2, end % 2 == 1))
            end = int(partner[end ^ 1])
        runs += [run] if run else []
    return runs
