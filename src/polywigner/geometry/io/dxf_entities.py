"""Curves and painted areas of the entities of a DXF drawing, which ezdxf flattens."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from polywigner.errors import FileFormatError
from polywigner.geometry.io.curves import Arc, Points, flattened
from polywigner.geometry.io.limits import check_coordinates, check_vertices

# Chords this coarse, in sizes of a curve, have its ends and nearly its extent.
_ROUGH = 0.05
# Fraction of its size within which the ends of a spline are one point.
_CLOSED = 1e-9


@dataclass(frozen=True, eq=False)
class _Curve:
    """A curve that ezdxf flattens."""

    size: float
    chords: Callable[[float], Points]
    """Vertices (n, 3) of chords within a distance."""
    is_round: bool = False
    """Whether it is a whole circle or ellipse."""


@dataclass(frozen=True, eq=False)
class Path:
    """A sequence of connected curves: each starts at the end of the one before."""

    curves: list[_Curve]
    layer: str

    def points(self, distance: float | None = None) -> Points:
        """Vertices (n, 3) of chords within a distance; None: rough ones."""
        pieces = [c.chords(distance or _ROUGH * c.size) for c in self.curves]
        vertices = np.concatenate([*(piece[:-1] for piece in pieces), pieces[-1][-1:]])
        check_vertices(len(vertices))
        return vertices


@dataclass(frozen=True, eq=False)
class Hatch:
    """Closed boundaries of an area that is painted."""

    boundaries: list[list[Path]]
    style: int
    layer: str


def _array(points: Iterable[Any]) -> Points:
    return np.array([[p.x, p.y, p.z if len(p) > 2 else 0.0] for p in points]).reshape(-1, 3)


def _ellipse(centre: Any, u: Any, v: Any) -> _Curve:
    """A whole ellipse, whose chords keep its area."""
    middle, first, second = _array([centre, u, v])
    arc = Arc(middle, first, second, 0.0, 2 * math.pi)

    def chords(distance: float) -> Points:
        ring = flattened([[arc]], distance)[0]
        return np.concatenate([ring, ring[:1]])

    return _Curve(u.magnitude, chords, is_round=True)


def _curve(entity: Any) -> _Curve:
    """The curve of a line, arc, circle, ellipse or spline."""
    kind, dxf = entity.dxftype(), entity.dxf
    if kind == "LINE":
        ends = _array([dxf.start, dxf.end])
        return _Curve(0.0, lambda distance: ends)
    if kind == "SPLINE":
        return _spline(entity)
    if kind == "ELLIPSE":
        tool, size = entity.construction_tool(), dxf.major_axis.magnitude
        if _is_whole(dxf.end_param - dxf.start_param, math.tau):
            return _ellipse(tool.center, tool.major_axis, tool.minor_axis)
    else:
        size = float(dxf.radius)
        if not size >= 0:
            raise FileFormatError(f"expected a radius from zero up, got {size:g}; correct it")
        if kind == "CIRCLE" or _is_whole(dxf.end_angle - dxf.start_angle, 360.0):
            return _circle(entity, size)
    return _Curve(size, lambda distance: _array(entity.flattening(distance)))


def _is_whole(span: float, turn: float) -> bool:
    """Whether two angles differ by a whole turn up to rounding, or not at all."""
    return abs(math.remainder(span, turn)) <= 1e-9 * turn


# Parameters inside each chord of a spline at which its distance is measured.
_BETWEEN = np.array([0.25, 0.5, 0.75])


def _spline(entity: Any) -> _Curve:
    """A B-spline over its own range of knots; ezdxf flattens one that is not clamped beyond it."""
    tool = entity.construction_tool()
    control, knots = _array(tool.control_points), np.array(list(tool.knots()), dtype=np.float64)
    check_coordinates(control)
    weights, size = np.array(list(tool.weights())), float(np.linalg.norm(np.ptp(control, axis=0)))
    if not np.isfinite(knots).all() or (np.diff(knots) < 0).any():
        raise FileFormatError("expected knots of a spline in rising order, got others")
    if not (np.isfinite(weights) & (weights > 0)).all():
        raise FileFormatError("expected weights of a spline above zero, got others")
    ends = np.unique(knots[tool.degree : len(control) + 1])

    def chords(distance: float) -> Points:
        t, is_good = ends, np.zeros(len(ends) - 1, dtype=bool)
        while not is_good.all():
            check_vertices(len(t))
            places = t[:-1, None] + np.diff(t)[:, None] * _BETWEEN
            start, end = (_array(tool.points(x.tolist()))[:, None] for x in (t[:-1], t[1:]))
            between = _array(tool.points(places.ravel().tolist())).reshape(-1, len(_BETWEEN), 3)
            off = _distances(between - start, end - start).max(axis=1)
            is_good = off <= distance
            t = np.union1d(t, places[~is_good].ravel())
        points = _array(tool.points(t.tolist()))
        closes = np.abs(points[0] - points[-1]).max() <= _CLOSED * size
        return points if closes or not entity.closed else np.concatenate([points, points[:1]])

    return _Curve(size, chords)


def _distances(points: Points, chords: Points) -> Points:
    """Distances (k, n) of points (k, n, 3) from segments from the origin to chords (k, 1, 3)."""
    squares = np.maximum((chords**2).sum(axis=2), np.finfo(float).tiny)
    along = np.clip((points * chords).sum(axis=2) / squares, 0, 1)
    return np.asarray(np.linalg.norm(points - along[..., None] * chords, axis=2))


def _paths(entity: Any, layer: str) -> list[Path]:
    """The path of an entity that is a curve or a polyline; none without an extent."""
    kind = entity.dxftype()
    if kind not in ("LWPOLYLINE", "POLYLINE"):
        return [Path([_curve(entity)], layer)]
    if kind == "POLYLINE" and not (entity.is_2d_polyline or entity.is_3d_polyline):
        raise FileFormatError("expected plane polylines, got a POLYLINE that is a mesh; remove it")
    pieces = list(entity.virtual_entities())
    if _are_circle(pieces):
        return [Path([_circle(pieces[0], float(pieces[0].dxf.radius))], layer)]
    curves = [_curve(each) for each in pieces]
    return [Path(_in_sequence(curves), layer)] if curves else []


def _are_circle(pieces: list[Any]) -> bool:
    """Whether the pieces of a polyline are two arcs that make a whole circle."""
    if [piece.dxftype() for piece in pieces] != ["ARC", "ARC"]:
        return False
    one, other = (piece.dxf for piece in pieces)
    size = _CLOSED * one.radius
    return bool(
        abs(one.radius - other.radius) <= size
        and one.center.distance(other.center) <= size
        and _is_whole(one.end_angle - other.start_angle, 360.0)
        and _is_whole(other.end_angle - one.start_angle, 360.0)
    )


def _circle(arc: Any, radius: float) -> _Curve:
    """The circle of this radius around the centre of an arc."""
    ocs = arc.ocs()
    return _ellipse(ocs.to_wcs(arc.dxf.center), ocs.ux * radius, ocs.uy * radius)


def _in_sequence(curves: list[_Curve]) -> list[_Curve]:
    """Curves of a polyline, each turned to start where the one before it ends.

    ezdxf's arcs run counter-clockwise, whatever the sign of their bulge.
    """
    ends = [curve.chords(_ROUGH * curve.size)[[0, -1]] for curve in curves]
    # the first curve starts at its end that is farther from the second curve
    gaps = np.abs(ends[0][:, None] - ends[min(1, len(ends) - 1)]).max(axis=2).min(axis=1)
    last, sequence = ends[0][int(gaps.argmax())], []
    for curve, tips in zip(curves, ends, strict=True):
        near, far = np.abs(tips - last).max(axis=1)
        last = tips[1 if near <= far else 0]
        sequence.append(curve if near <= far else _reversed(curve))
    return sequence


def _reversed(curve: _Curve) -> _Curve:
    return _Curve(curve.size, lambda distance: curve.chords(distance)[::-1])


def widths_of(polyline: Any) -> set[tuple[float, float]]:
    """Widths at the begin and the end of the segments of a polyline."""
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


def _wide(polyline: Any, layer: str) -> list[Hatch]:
    """The ring of a donut, a closed polyline of two half circles with one width."""
    widths = widths_of(polyline)
    if widths <= {(0.0, 0.0)}:
        return []
    width = max(max(pair) for pair in widths)
    arcs = list(polyline.virtual_entities())
    if not _are_circle(arcs) or widths != {(width, width)}:
        raise FileFormatError(
            f"expected polylines of width zero or donuts, got one of width {width:g} on layer "
            f"{layer[:60]!r}; set its width to zero, or draw its area as a hatch"
        )
    radius = float(arcs[0].dxf.radius)
    radii = [r for r in (radius + width / 2, radius - width / 2) if r > 0]
    return [Hatch([[Path([_circle(arcs[0], r)], layer)] for r in radii], 0, layer)]


def _hatch(hatch: Any, layer: str) -> Hatch:
    entities: Any = importlib.import_module("ezdxf.entities")
    ocs, height = hatch.ocs(), _array([hatch.dxf.elevation])[0, 2]
    plane = {"extrusion": ocs.uz}
    boundaries = []
    for boundary in hatch.paths:
        if hasattr(boundary, "vertices"):
            polyline = entities.LWPolyline.new(dxfattribs=plane | {"elevation": height})
            polyline.set_points(boundary.vertices, format="xyb")
            polyline.closed = True
            boundaries.append(_paths(polyline, layer))
        else:
            edges = [_edge(edge, entities, ocs, height) for edge in boundary.edges]
            boundaries.append([Path([_curve(edge)], layer) for edge in edges])
    return Hatch(boundaries, int(hatch.dxf.get("hatch_style", 0)), layer)


def _edge(edge: Any, entities: Any, ocs: Any, height: float) -> Any:
    """The line, arc, ellipse or spline of an edge of a hatch boundary."""

    def lifted(points: Iterable[Any]) -> list[Any]:
        return [ocs.to_wcs((p.x, p.y, height)) for p in points]

    kind = type(edge).__name__
    if kind == "LineEdge":
        start, end = lifted([edge.start, edge.end])
        return entities.Line.new(dxfattribs={"start": start, "end": end})
    if kind == "ArcEdge":
        return entities.Arc.new(dxfattribs={
            "center": (edge.center.x, edge.center.y, height), "radius": edge.radius,
            "start_angle": edge.start_angle, "end_angle": edge.end_angle, "extrusion": ocs.uz,
        })  # fmt: skip
    if kind == "EllipseEdge":
        major = ocs.to_wcs((edge.major_axis.x, edge.major_axis.y, 0.0))
        return entities.Ellipse.new(dxfattribs={
            "center": lifted([edge.center])[0], "major_axis": major, "ratio": edge.ratio,
            "start_param": edge.start_param, "end_param": edge.end_param, "extrusion": ocs.uz,
        })  # fmt: skip
    spline, tool = entities.Spline(), edge.construction_tool()
    spline.apply_construction_tool(tool)
    spline.control_points = lifted(tool.control_points)
    return spline


def _solid(entity: Any, layer: str) -> Hatch:
    corners = _array(entity.wcs_vertices(close=True))
    return Hatch([[Path([_Curve(0.0, lambda distance: corners)], layer)]], 0, layer)


_CURVES = frozenset({"LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "LWPOLYLINE", "POLYLINE"})


def shapes_of(entity: Any, layer: str) -> Iterator[Path | Hatch]:
    """The paths and painted areas of one entity."""
    kind = entity.dxftype()
    if kind in _CURVES:
        wide = _wide(entity, layer) if kind.endswith("POLYLINE") else []
        yield from wide or _paths(entity, layer)
    elif kind == "HATCH":
        yield _hatch(entity, layer)
    elif kind in ("SOLID", "TRACE"):
        yield _solid(entity, layer)
    else:
        raise FileFormatError(
            f"expected lines, curves, hatches and blocks, got a {kind[:40]}; convert it to "
            "polylines, or move it to a layer that is off"
        )
