"""DXF files: units, bulges, chains of lines, holes, blocks and layers."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from outlines import difference
from polywigner.errors import ArgumentError, FileFormatError, GeometryError

ezdxf = pytest.importorskip("ezdxf")

DATA = Path(__file__).parent / "data" / "readers"

# Rounding error of a few products with sines.
ROUNDING = 1e-13
# Relative rounding error of unions, which have a grid of 2^-44 of the size.
UNION = 1e-12
# Options for chords with errors of 1e-8 m on curves of some millimetres.
FINE = {"tolerance": 1e-8}
BY_CHORDS = 1e-4

SQUARE = [(0, 0), (9, 0), (9, 9), (0, 9)]

Build = Callable[[Any], object]
Read = Callable[..., pw.Aperture]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read_drawing(
        build: Build, units: int = 4, version: str = "R2010", binary: bool = False, **options: Any
    ) -> pw.Aperture:
        """Read a drawing in model space, in millimetres by default."""
        document = ezdxf.new(version, units=units)
        build(document.modelspace())
        path = tmp_path / "drawing.dxf"
        document.saveas(path, fmt="bin" if binary else "asc")
        return pw.read_aperture(path, **options)

    return read_drawing


def ring(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float]]:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def outline(space: Any, points: Any, layer: str = "0", **options: Any) -> Any:
    return space.add_lwpolyline(points, close=True, dxfattribs={"layer": layer}, **options)


def square(space: Any) -> None:
    space.add_polyline2d(SQUARE, close=True)


@pytest.mark.parametrize(
    ("units", "metres"),
    [(1, 0.0254), (2, 0.3048), (4, 1e-3), (9, 2.54e-5), (13, 1e-6)],
)
def test_the_unit_of_the_drawing_rules(read: Read, units: int, metres: float) -> None:
    drawn = read(square, units=units, unit="km")
    assert drawn.bounds == pytest.approx((0, 0, 9 * metres, 9 * metres), rel=1e-15)


@pytest.mark.parametrize("version", ["R12", "R2018"])
@pytest.mark.parametrize("binary", [False, True])
def test_a_drawing_without_a_unit_takes_the_callers(read: Read, version: str, binary: bool) -> None:
    drawn = read(square, units=0, version=version, binary=binary, unit="0.1 mm")
    assert drawn == pw.Aperture(np.array(SQUARE) / 10_000)


@pytest.mark.parametrize("tolerance", [1e-5, 1e-8])
def test_a_bulge_of_one_is_a_half_circle(read: Read, tolerance: float) -> None:
    drawn = read(lambda s: outline(s, [(0, 0, 1), (2, 0, 0)], format="xyb"), tolerance=tolerance)
    missing = math.pi / 2 * 1e-6 - drawn.area
    assert 0 < missing <= tolerance * math.pi * 1e-3
    # A positive bulge is counter-clockwise, so it lies below a chord from left to right.
    assert drawn.bounds == pytest.approx((0, -1e-3, 2e-3, 0), abs=tolerance)
    xs, ys = drawn.rings[0].T
    on_arc = ys < 0
    assert np.hypot(xs - 1e-3, ys)[on_arc] == pytest.approx(1e-3, rel=ROUNDING)


@pytest.mark.parametrize("bulge", [-3.0, -0.2, 1e-7, 2.0])
def test_a_bulge_is_the_tangent_of_a_quarter_of_its_angle(read: Read, bulge: float) -> None:
    """The area of the segment is r^2 (theta - sin theta)/2."""
    angle = 4 * math.atan(bulge)
    segment = abs(2 / math.sin(angle / 2)) ** 2 * (angle - math.sin(angle)) / 2
    points = [(0, 0), (4, 0, bulge), (4, 4), (0, 4)]
    drawn = read(lambda space: outline(space, points, format="xyb"), **FINE)
    assert drawn.area == pytest.approx(abs(16 + segment) * 1e-6, rel=BY_CHORDS)


def nested_rings(space: Any) -> None:
    square(space)
    for radius in (4, 3, 2, 1):
        space.add_circle((4.5, 4.5), radius)


def slot(space: Any, gap: float = 0.0) -> None:
    """Draw a stadium of two lines and two arcs in any order and direction."""
    space.add_arc((5, 1), 1, -90, 90)
    space.add_line((0, 2 + gap), (5, 2))
    space.add_line((0, 0), (5, gap))
    space.add_arc((0, 1), 1, 90, 270)


def ellipses(space: Any) -> None:
    space.add_ellipse((0, 0), major_axis=(3, 4), ratio=0.3)
    space.doc.blocks.new("C").add_circle((1, 1), 1)
    space.add_blockref("C", (20, 0), dxfattribs={"xscale": 4, "yscale": 0.5, "rotation": 30})


def round_hatch(space: Any) -> None:
    paths = space.add_hatch().paths
    outer = paths.add_edge_path()
    outer.add_arc((5, 1), 1, -90, 90)
    outer.add_line((5, 2), (0, 2))
    outer.add_arc((0, 1), 1, 90, 270, ccw=True)
    outer.add_line((0, 0), (5, 0))
    paths.add_edge_path().add_ellipse((2.5, 1), major_axis=(1, 0), ratio=0.5)


def touching_hatch(space: Any) -> None:
    """Draw a boundary that touches itself at a corner, without its closing side."""
    points = [(0, 0), (4, 0), (2, 2), (4, 4), (0, 4), (2, 2)]
    space.add_hatch().paths.add_polyline_path(points, is_closed=False)


def overlapping_hatches(space: Any) -> None:
    for corners in ((0, 0, 4, 4), (2, 2, 6, 6), (5, 5, 5.5, 5.5)):
        space.add_hatch().paths.add_polyline_path(ring(*corners))
    space.add_solid([(20, 0), (24, 0), (20, 3), (24, 3)])
    space.add_solid([(22, 0), (26, 0), (22, 3), (26, 3)])


AREAS: dict[str, tuple[Build, dict[str, Any], float, float]] = {
    "holes and islands": (nested_rings, {}, 81 - math.pi * (16 - 9 + 4 - 1), ROUNDING),
    "a slot of lines and arcs": (slot, FINE, 10 + math.pi, BY_CHORDS),
    "a slot with small gaps": (lambda s: slot(s, gap=3e-6), FINE, 10 + math.pi, BY_CHORDS),
    "ellipses and stretched circles": (ellipses, {}, math.pi * (25 * 0.3 + 2), ROUNDING),
    "a hatch of arcs and an ellipse": (round_hatch, FINE, 10 + math.pi / 2, BY_CHORDS),
    "a hatch that touches itself": (touching_hatch, {}, 8, UNION),
    "hatches and solids that overlap": (overlapping_hatches, {}, 16 + 16 - 4 + 18, UNION),
}


@pytest.mark.parametrize(("build", "options", "square_mm", "error"), AREAS.values(), ids=AREAS)
def test_areas_of_drawings(
    read: Read, build: Build, options: dict[str, Any], square_mm: float, error: float
) -> None:
    assert read(build, **options).area == pytest.approx(square_mm * 1e-6, rel=error, abs=0.0)


def test_a_ring_in_a_ring_is_a_hole(read: Read) -> None:
    assert [len(p.interiors) for p in read(nested_rings).polygons.geoms] == [1, 1, 0]


def lines(space: Any) -> None:
    for k in range(4):
        space.add_line(SQUARE[k], SQUARE[k - 3])


def open_polylines(space: Any) -> None:
    space.add_lwpolyline(SQUARE[:3])
    space.add_lwpolyline([SQUARE[0], SQUARE[3], SQUARE[2]])


def hatch(space: Any) -> None:
    space.add_hatch().paths.add_polyline_path(SQUARE)


def hatch_edges(space: Any) -> None:
    path = space.add_hatch().paths.add_edge_path()
    for k in range(4):
        path.add_line(SQUARE[k], SQUARE[k - 3])


def mirrored(space: Any) -> None:
    points = [(-x, y) for x, y in SQUARE]
    space.add_lwpolyline(points, close=True, dxfattribs={"extrusion": (0, 0, -1)})


def inserted(space: Any) -> None:
    block = space.doc.blocks.new("B", base_point=(3, 3))
    block.add_lwpolyline([(3, 3), (6, 3), (6, 4), (3, 4)], close=True)
    space.add_blockref("B", (9, 0), dxfattribs={"xscale": 3, "yscale": 9, "rotation": 90})


def annotated(space: Any) -> None:
    square(space)
    space.add_text("aperture")
    space.add_point((4, 4))
    space.add_circle((4, 4), 2, dxfattribs={"layer": "hidden"})
    space.doc.layers.add("hidden").off()
    space.add_circle((4, 4), 2, dxfattribs={"invisible": 1})
    space.add_line((1, 1), (1, 1))


SAME: dict[str, Build] = {
    "lines": lines, "open polylines": open_polylines, "hatch": hatch, "hatch edges": hatch_edges,
    "mirrored": mirrored, "inserted": inserted, "annotated": annotated,
    "lifted": lambda s: s.add_lwpolyline(SQUARE, close=True, dxfattribs={"elevation": 7}),
    "polyline": lambda s: outline(s, SQUARE),
    "polyline in space": lambda s: s.add_polyline3d(SQUARE, close=True),
    "last point repeated": lambda s: s.add_lwpolyline([*SQUARE, SQUARE[0]]),
    "solid": lambda s: s.add_solid([SQUARE[0], SQUARE[1], SQUARE[3], SQUARE[2]]),
    "spline": lambda s: s.add_spline().set_closed([(*p, 0) for p in SQUARE], degree=1),
}  # fmt: skip


@pytest.mark.parametrize("build", SAME.values(), ids=SAME)
def test_the_same_region_drawn_in_many_ways(read: Read, build: Build) -> None:
    assert difference(read(build), pw.Aperture(np.array(SQUARE) / 1000)) < ROUNDING


def test_blocks_in_stretched_blocks_are_sheared(read: Read) -> None:
    """The matrices of both inserts are multiplied."""

    def build(space: Any) -> None:
        inner, outer = space.doc.blocks.new("INNER"), space.doc.blocks.new("OUTER")
        outline(inner, ring(1, 0, 3, 1))
        grid = {"column_count": 2, "column_spacing": 5, "extrusion": (0, 0, -1)}
        outer.add_blockref("INNER", (0, 2), dxfattribs={"rotation": 30, **grid})
        space.add_blockref("OUTER", (7, 1), dxfattribs={"xscale": -3, "yscale": 0.5})

    cos, sin = math.cos(math.pi / 6), math.sin(math.pi / 6)
    mirror = np.diag([-1.0, 1.0])  # An extrusion towards -z reverses the x axis.
    copies = []
    for shift in (0, 5):
        turned = np.add(ring(1, 0, 3, 1), (shift, 0)) @ [[cos, sin], [-sin, cos]] + (0, 2)
        copies.append((turned @ mirror @ np.diag([-3, 0.5]) + (7, 1)) / 1000)
    assert difference(read(build), pw.Aperture(copies)) < ROUNDING


def test_a_rational_spline_of_an_ellipse_is_the_ellipse(read: Read) -> None:
    from ezdxf.math import BSpline, ConstructionEllipse

    ellipse = ConstructionEllipse(center=(5, 5), major_axis=(3, 0), ratio=0.5)
    curve, tolerance = BSpline.from_ellipse(ellipse), 1e-7
    drawn = read(lambda s: s.add_spline().apply_construction_tool(curve), tolerance=tolerance)
    circumference = 2 * math.pi * 3e-3  # upper bound
    assert 0 < math.pi * 4.5e-6 - drawn.area <= tolerance * circumference
    x, y = (drawn.rings[0] - 5e-3).T
    assert (x / 3e-3) ** 2 + (y / 1.5e-3) ** 2 == pytest.approx(1, rel=1e-12)


def test_splines_that_are_not_clamped_run_over_their_own_knots(read: Read) -> None:
    interpolate = pytest.importorskip("scipy.interpolate")
    control = np.array([(0, 0), (9, 1), (8, 7), (1, 6), (0, 0), (9, 1), (8, 7)], float)
    points = [(*p, 0) for p in control[:4]]
    curve = interpolate.BSpline(np.arange(11.0), control, 3)(np.linspace(3, 7, 8_001))
    exact = shapely.Polygon(curve).area
    for tolerance, error in ((1e-5, 1e-2), (1e-8, 1e-5)):
        drawn = read(lambda s: s.add_spline().set_closed(points, degree=3), tolerance=tolerance)
        assert drawn.area == pytest.approx(exact * 1e-6, rel=error, abs=0.0)
        chords = shapely.LinearRing(drawn.rings[0] * 1e3)
        distances = shapely.distance(chords, shapely.points(curve))
        assert distances.max() <= tolerance * 1e3 * 1.01


def recursion(space: Any) -> None:
    block = space.doc.blocks.new("B")
    block.add_blockref("B", (1, 1))
    block.add_circle((0, 0), 1)
    space.add_blockref("B", (0, 0))


def crossing_circles(space: Any) -> None:
    space.add_circle((0, 0), 2)
    space.add_circle((2, 0), 2)


def star(space: Any) -> None:
    for k in range(3):
        space.add_line((0, 0), (math.cos(k), math.sin(k)))


def external(space: Any) -> None:
    space.doc.add_xref_def("other.dxf", "OTHER")
    space.add_blockref("OTHER", (0, 0))
    square(space)


def old_width(space: Any) -> None:
    space.add_polyline2d(SQUARE, close=True).dxf.default_end_width = 0.5


BAD: dict[str, tuple[Build, type[Exception], str]] = {
    "nothing": (lambda space: None, FileFormatError, "contains no outlines"),
    "a line": (lambda space: space.add_line((0, 0), (1, 0)), FileFormatError, "meets 0 others"),
    "a gap": (lambda s: slot(s, 0.01), FileFormatError, r"end at \(5, 0\) that meets 0 others"),
    "a star of lines": (star, FileFormatError, r"at \(0, 0\) that meets 2 others"),
    "a solid body": (lambda s: s.add_3dface([(0, 0), (1, 0), (1, 1)]), FileFormatError, "3DFACE"),
    "overlap": (crossing_circles, GeometryError, "an overlap between outlines 0 and 1"),
    "bow tie": (lambda s: outline(s, [(0, 0), (2, 2), (2, 0), (0, 2)]),
                GeometryError, r"crosses itself at \(1, 1\)"),
    "no area": (lambda s: outline(s, [(0, 0), (2, 2), (1, 1)]), GeometryError, "enclose an area"),
    "drawn twice": (lambda s: [square(s), square(s)], GeometryError, "union=True"),
    "not plane": (lambda s: s.add_polyline3d([(0, 0, 0), (1, 0, 1), (0, 1, 0)], close=True),
                  FileFormatError, "plane drawing"),
    "no block": (lambda s: s.add_blockref("missing", (0, 0)), FileFormatError, "which is missing"),
    "another drawing": (external, FileFormatError, "'OTHER', which is missing, external"),
    "nan": (lambda s: s.add_circle((0, math.nan), 1), FileFormatError, "finite numbers"),
    "huge": (lambda s: s.add_circle((0, 0), 1e200), FileFormatError, "below 1e\\+100"),
    "recursion": (recursion, FileFormatError, "contains itself"),
    "width": (lambda s: s.add_lwpolyline(SQUARE, close=True, dxfattribs={"const_width": 0.5}),
              FileFormatError, "width zero"),
    "tapered": (lambda s: s.add_lwpolyline([(0, 0, 0, 0.5), (5, 0, 0.5, 0)], format="xyse"),
                FileFormatError, "width zero"),
    "old width": (old_width, FileFormatError, "width zero"),
}  # fmt: skip


@pytest.mark.parametrize(("build", "kind", "words"), BAD.values(), ids=BAD)
def test_what_is_no_outline_raises_one_error(
    read: Read, build: Build, kind: type[Exception], words: str
) -> None:
    with pytest.raises(kind, match=rf"drawing\.dxf: .*{words}") as raised:
        read(build)
    assert "\n" not in str(raised.value)


PAD, PAIR, FEED = ring(1, 1, 3, 3), ring(3, 1, 5, 3), ring(2, 1.5, 6, 2)


def board(space: Any) -> None:
    """Draw a board with a solid around two pads that touch."""
    for start, end in zip(SQUARE, SQUARE[1:] + SQUARE[:1], strict=True):
        space.add_line(start, end, dxfattribs={"layer": "Edge Cuts"})
    outline(space, PAD, "PADS")
    outline(space, PAIR, "PADS")


def crossing(space: Any) -> None:
    outline(space, PAD, "PADS")
    outline(space, FEED, "FEED")
    space.add_circle((1.5, 2.5), 0.25, dxfattribs={"layer": "PADS"})


def test_one_layer_is_read_alone_and_solids_on_others_do_no_harm(read: Read) -> None:
    def build(space: Any) -> None:
        board(space)
        space.add_3dface([(0, 0), (1, 0), (1, 1)], dxfattribs={"layer": "Edge Cuts"})
        space.doc.layers.add("PADS").off()  # Layers that are off can be read by name.

    expected = pw.Aperture(np.array(ring(1, 1, 5, 3)) / 1000)
    assert read(build, layer="pads") == expected  # layer names are case-insensitive
    assert read(board, layer=["Edge Cuts"]) == pw.Aperture(np.array(SQUARE) / 1000)


def test_layer_zero_of_a_block_is_the_layer_it_is_inserted_on(read: Read) -> None:
    def build(space: Any) -> None:
        block = space.doc.blocks.new("PAD")
        outline(block, PAD)
        block.add_circle((20, 20), 1, dxfattribs={"layer": "MARKS"})
        space.add_blockref("PAD", (0, 0), dxfattribs={"layer": "PADS"})
        space.add_blockref("PAD", (50, 0), dxfattribs={"layer": "OTHERS"})

    assert read(build, layer="PADS") == pw.Aperture(np.array(PAD) / 1000)
    marks = read(build, layer="MARKS")
    assert marks.area == pytest.approx(2 * math.pi * 1e-6, rel=ROUNDING, abs=0.0)


def test_an_unknown_layer_is_answered_with_those_there_are(read: Read) -> None:
    with pytest.raises(ArgumentError, match=r"no layer 'COPPER'; its layers are .*Edge Cuts, PADS"):
        read(board, layer="COPPER")
    for wrong in ("", 3, [None]):
        with pytest.raises(ArgumentError, match="expected layer to be one name"):
            read(board, layer=wrong)
    with pytest.raises(ArgumentError, match="expected union to be True or False, got 'yes'"):
        read(board, union="yes")
    with pytest.raises(FileFormatError, match=r"INSUNITS\) from 0 to 17, got 20"):
        read(square, units=20)


def test_a_frame_around_touching_shapes_is_an_overlap(read: Read) -> None:
    with pytest.raises(GeometryError, match=r"\(--layer\), or pass union=True \(--union\)"):
        read(board)


def test_a_pad_and_its_feed_are_joined_when_asked_and_keep_their_hole(read: Read) -> None:
    with pytest.raises(GeometryError, match=r"pass union=True \(--union\)"):
        read(crossing)
    joined = read(crossing, union=True)
    both = shapely.union(shapely.Polygon(PAD), shapely.Polygon(FEED))
    assert joined.area * 1e6 == pytest.approx(both.area - math.pi * 0.25**2, rel=UNION)
    assert [len(part.interiors) for part in joined.polygons.geoms] == [1]


@pytest.mark.parametrize(
    ("name", "square_mm"),
    [
        ("ins_off", 8), ("nest_off2", math.pi), ("hatch_style0", 68), ("hatch_style1", 64),
        ("hatch_style2", 100), ("hatch_two", 100),
    ],
)  # fmt: skip
@pytest.mark.parametrize("union", [False, True])
def test_files_of_reported_faults_have_their_areas(
    name: str, square_mm: float, union: bool
) -> None:
    drawn = pw.read_aperture(DATA / f"{name}.dxf", union=union)
    assert drawn.area == pytest.approx(square_mm * 1e-6, rel=UNION, abs=0.0)


@pytest.mark.parametrize(
    ("state", "shown"),
    [({}, 1 + 4 + 9 + 16), ({"INS": "off"}, 4 + 9 + 16), ({"INS": "freeze"}, 16),
     ({"OWN": "off"}, 1 + 9 + 16), ({"OWN": "freeze"}, 1 + 9 + 16), ({"DEEP": "off"}, 1 + 4 + 16),
     ({"DEEP": "freeze"}, 1 + 4 + 16), ({"0": "off"}, 1 + 4 + 9), ({"0": "freeze"}, 1 + 4 + 9)],
)  # fmt: skip
def test_a_layer_that_is_off_hides_its_own_entities_and_a_frozen_one_its_inserts(
    read: Read, state: dict[str, str], shown: float
) -> None:
    """The sides are 1 on layer 0 of a block, 2 on another layer, 3 in a nested block, 4 outside."""

    def build(space: Any) -> None:
        for name in ("INS", "OWN", "DEEP"):
            space.doc.layers.add(name)
        for name, verb in state.items():
            getattr(space.doc.layers.get(name), verb)()
        inner, block = space.doc.blocks.new("INNER"), space.doc.blocks.new("B")
        outline(inner, ring(20, 0, 23, 3))
        outline(block, ring(0, 0, 1, 1))
        outline(block, ring(5, 0, 7, 2), "OWN")
        block.add_blockref("INNER", (0, 0), dxfattribs={"layer": "DEEP"})
        space.add_blockref("B", (50, 0), dxfattribs={"layer": "INS"})
        outline(space, ring(0, 0, 4, 4))

    assert read(build).area == pytest.approx(shown * 1e-6, rel=ROUNDING, abs=0.0)


SIDES = (11.0, 7.0, 5.0, 2.0)
STYLED = {0: 121 - 49 + 25 - 4, 1: 121 - 49, 2: 121}


def nested_hatch(space: Any, style: int, flags: bool = True, arcs: bool = False) -> Any:
    """Draw four nested squares, or discs with these diameters."""
    hatch = space.add_hatch(dxfattribs={"hatch_style": style})
    for k, side in enumerate(SIDES):
        kind = {"flags": (1, 16, 0, 0)[k]} if flags else {}
        if arcs:
            points = [(-side / 2, 3, 1.0), (side / 2, 3, 1.0)]
        else:
            points = [(x, y, 0.0) for x, y in ring(-side / 2, -side / 2, side / 2, side / 2)]
        hatch.paths.add_polyline_path(points, **kind)
    return hatch


@pytest.mark.parametrize("style", [0, 1, 2])
@pytest.mark.parametrize("flags", [False, True])
def test_a_hatch_fills_between_its_boundaries_by_its_style(
    read: Read, style: int, flags: bool
) -> None:
    drawn = read(lambda space: nested_hatch(space, style, flags))
    assert drawn.area == pytest.approx(STYLED[style] * 1e-6, rel=ROUNDING, abs=0.0)
    discs = read(lambda space: nested_hatch(space, style, flags, arcs=True), **FINE)
    assert discs.area == pytest.approx(math.pi / 4 * STYLED[style] * 1e-6, rel=BY_CHORDS, abs=0.0)


def test_a_hatch_and_its_border_are_joined_when_asked(read: Read) -> None:
    def build(space: Any) -> None:
        square(space)
        space.add_hatch().paths.add_polyline_path(SQUARE)

    with pytest.raises(GeometryError, match=r"do not overlap.*union=True"):
        read(build)
    assert read(build, union=True) == pw.Aperture(np.array(SQUARE) / 1000)


def test_a_hatch_inside_an_outline_is_refused(read: Read) -> None:
    def build(space: Any) -> None:
        outline(space, ring(0, 0, 9, 9), "PLATE")
        space.add_hatch(dxfattribs={"layer": "FILL"}).paths.add_polyline_path(ring(2, 2, 5, 5))

    with pytest.raises(GeometryError, match=r"do not overlap.*union=True"):
        read(build)
    assert read(build, layer="FILL").area == pytest.approx(9e-6)
    assert read(build, union=True).area == pytest.approx(81e-6)
