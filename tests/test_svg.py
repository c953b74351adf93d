"""SVG files: lengths, transforms, fill rules and curves."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely

import polywigner as pw
from outlines import difference
from polywigner.errors import ArgumentError, FileFormatError, GeometryError
from polywigner.geometry.io.outlines import DEFAULT_TOLERANCE

MILLIMETRES = 'width="20mm" height="10mm" viewBox="0 0 20 10"'

# Rounding error of a few additions and products.
ROUNDING = 1e-14

# The area between a chord and its curve is at most the length times the largest distance.
SLACK = 1 + 1e-9

Read = Callable[..., pw.Aperture]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read_drawing(body: str, root: str = MILLIMETRES, **options: object) -> pw.Aperture:
        path = tmp_path / "drawing.svg"
        path.write_text(
            '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
            f"{root}>{body}</svg>"
        )
        return pw.read_aperture(path, **options)  # type: ignore[arg-type]

    return read_drawing


def rectangle(x0: float, y0: float, x1: float, y1: float) -> pw.Aperture:
    """Return a rectangle in millimetres with y downwards."""
    return pw.Aperture(np.array([[x0, -y1], [x1, -y1], [x1, -y0], [x0, -y0]]) / 1000)


@pytest.mark.parametrize(
    ("root", "options", "metres"),
    [
        ('width="20mm" viewBox="0 0 20 10"', {}, 1e-3),
        ('height="1cm" viewBox="5 5 20 10"', {"unit": "in"}, 1e-3),
        ('width="4in" height="2in" viewBox="0 0 4 2"', {}, 0.0254),
        ('width="72pt" height="36pt" viewBox="0 0 1 .5"', {}, 0.0254),
        ('width="80Q" viewBox="0 0 20 10"', {}, 1e-3),
        ('width="20mm" height="10mm"', {}, 0.0254 / 96),
        ('viewBox="0 0 20 10"', {}, 1e-3),
        ('width="100%" height="auto" viewBox="0 0 20 10"', {"unit": "px"}, 0.0254 / 96),
        ("", {"unit": "px"}, 0.0254 / 96),
    ],
)  # fmt: skip
def test_a_stated_size_rules_and_the_unit_is_for_files_without(
    read: Read, root: str, options: dict[str, str], metres: float
) -> None:
    drawn = read('<rect x="1" y="2" width="5" height="3"/>', root, **options)
    assert drawn.bounds == pytest.approx(np.array([1, -5, 6, -2]) * metres, rel=ROUNDING)


def test_rectangles_are_exact_and_merge(read: Read) -> None:
    assert read('<rect x="1" y="2" width="5" height="3"/>') == rectangle(1, 2, 6, 5)
    touching = '<rect width="5" height="5"/><rect x="5" width="5" height="5"/>'
    assert read(touching) == rectangle(0, 0, 10, 5)


@pytest.mark.parametrize("tolerance", [None, 1e-5])
def test_a_circle_is_the_disc_of_the_same_area_and_transform(
    read: Read, tolerance: float | None
) -> None:
    radius = 3e-3
    drawn = read('<circle cx="5" cy="4" r="3"/>', tolerance=tolerance)
    assert drawn.area == pytest.approx(math.pi * radius**2, rel=ROUNDING, abs=0.0)
    count = len(drawn.rings[0])
    disc = pw.shapes.disc(radius, n=count)
    nu = np.random.default_rng(5).normal(0, 1 / radius, (40, 2))
    shift = np.exp(-2j * math.pi * nu @ (5e-3, -4e-3))
    # disc() has the same first vertex, so that the polygons agree up to rounding.
    assert np.abs(pw.fourier(drawn, nu) - shift * pw.fourier(disc, nu)).max() < 1e-13 * disc.area
    reach = tolerance or DEFAULT_TOLERANCE * math.sqrt(8) * radius
    distances = np.hypot(*(drawn.rings[0] - (5e-3, -4e-3)).T)
    apothem = distances * math.cos(math.pi / count)
    assert np.abs(distances - radius).max() <= reach
    assert np.abs(apothem - radius).max() <= reach
    assert count <= 1.1 * math.pi * math.sqrt(radius / (3 * reach)) + 4  # few vertices


@pytest.mark.parametrize(
    ("path", "area", "length"),
    [
        ("M0 0 Q 5 10 10 0 Z", 100 / 3, 15),  # parabola: 2/3 of base times height, height 5
        ("M0 0 C 0 10 10 10 10 0", 60.0, 20),  # (3/20) (...) of the control points
        ("M-4 0 A 4 4 0 0 1 4 0", 8 * math.pi, 13),
        ("M-4 0 A 4 2 0 0 0 4 0 Z", 4 * math.pi, 11),
        ("M 2 0 a 2 2 0 1 1 -2 -2 l 0 2 z", 3 * math.pi, 10),
        ("M0 0 A 1 1 0 0 1 8 0", 8 * math.pi, 13),  # too small a radius is enlarged
    ],
)
def test_curves_enclose_their_area_within_the_tolerance(
    read: Read, path: str, area: float, length: float
) -> None:
    tolerance = 1e-6
    drawn = read(f'<path d="{path}"/>', tolerance=tolerance)
    assert abs(drawn.area - area * 1e-6) <= tolerance * length * 1e-3 * SLACK


def test_the_fill_rule_decides_what_overlapping_subpaths_enclose(read: Read) -> None:
    same_way = "M0 0h8v8h-8z M2 2h2v2h-2z"
    other_way = "M0 0h8v8h-8z M2 2v2h2v-2z"
    solid, holed = 64e-6, 60e-6
    for data, rule, area in (
        (same_way, "nonzero", solid),
        (same_way, "evenodd", holed),
        (other_way, "nonzero", holed),
        (other_way, "evenodd", holed),
    ):
        group = f'<g style="fill-rule: {rule}"><path d="{data}"/></g>'
        assert read(group).area == pytest.approx(area)
    assert read(f'<path fill-rule="evenodd" d="{same_way}"/>').area == pytest.approx(holed)
    assert read(f'<path d="{same_way}"/>').area == pytest.approx(solid)


def test_a_self_crossing_path_is_split_where_it_crosses(read: Read) -> None:
    pentagram = "M5 0 L8 9 L0 3.5 L10 3.5 L2 9 Z"
    star = read(f'<path d="{pentagram}"/>')
    pierced = read(f'<path fill-rule="evenodd" d="{pentagram}"/>')
    assert len(star.rings) == 1 and len(star.rings[0]) == 10
    assert pierced.area < star.area
    assert len(pierced.polygons.geoms) == 5
    assert len(read('<path d="M0 0L4 4V0L0 4z"/>').polygons.geoms) == 2


@pytest.mark.parametrize(
    ("body", "same"),
    [
        ('<polygon points="1,2 6,2 6,5 1,5"/>', "<rect {}/>"),
        ('<polyline points="1 2 6 2 6 5 1 5"/>', "<rect {}/>"),
        ('<path d="M1 2h5v3h-5"/>', "<rect {}/>"),
        ('<path d="m1 2 5 0 0 3 -5 0z"/>', "<rect {}/>"),
        ('<path d="M1 2h5v3h-5zm20 20z"/>', "<rect {}/>"),
        ('<rect x="1px" y="20%" width="25%" height="30%"/>', "<rect {}/>"),
        ('<g transform="translate(1,2) scale(5 3)"><path d="M0 0H1V1H0z"/></g>', "<rect {}/>"),
        ('<rect width="3" height="5" transform="translate(6 2) rotate(90)"/>', "<rect {}/>"),
        ('<rect x="2" y="-6" width="3" height="5" transform="rotate(90)"/>', "<rect {}/>"),
        ('<rect width="5" height="3" transform="matrix(1 0 0 1 1 2)"/>', "<rect {}/>"),
        ('<defs><rect id="r" width="5" height="3"/></defs><use href="#r" x="1" y="2"/>',
         "<rect {}/>"),
        ('<defs><g id="g"><use xlink:href="#r" y="2"/></g><rect id="r" width="5" height="3"/>'
         '</defs><use href="#g" x="1"/>', "<rect {}/>"),
        ('<switch><foreignObject requiredExtensions="x"/><g><rect {}/></g></switch>', "<rect {}/>"),
        ('<rect {}/><rect width="9" height="9" fill="none" stroke="black"/>', "<rect {}/>"),
        ('<rect {}/><rect width="9" height="9" visibility="hidden"/>', "<rect {}/>"),
        ('<rect {}/><g display="none"><rect width="9" height="9"/><text>no</text></g>',
         "<rect {}/>"),
        ('<rect {}/><g style="opacity: 0"><rect width="9" height="9"/></g>', "<rect {}/>"),
        ('<rect {}/><line x2="9" y2="9"/><title>t</title><path d="M3 3L4 4z"/>', "<rect {}/>"),
        ('<rect {}/><rect width="9" height="9" fill="RGBA(9, 9, 9, 0.0)"/>', "<rect {}/>"),
        ('<rect {}/><rect width="9" height="9" fill="#1230"/>', "<rect {}/>"),
        ('<rect {}/><rect width="9" height="9" fill="#12345600"/>', "<rect {}/>"),
        ('<rect {} fill="rgba(9, 9, 0, 0.01)"/>', "<rect {}/>"),
        ('<circle cx="5" cy="5" r="9" style="r: 2"/>', '<circle cx="5" cy="5" r="2"/>'),
        ('<linearGradient id="g"/><circle cx="5" cy="5" r="2" fill="url(#g)"/>',
         '<circle cx="5" cy="5" r="2"/>'),
        ('<rect fill="currentColor" color="blue" {}/>', "<rect {}/>"),
    ],
)  # fmt: skip
def test_many_ways_to_draw_the_same(read: Read, body: str, same: str) -> None:
    place = 'x="1" y="2" width="5" height="3"'
    assert difference(read(body.replace("{}", place)), read(same.replace("{}", place))) < ROUNDING


DATA = Path(__file__).parent / "data" / "readers"


def test_files_of_reported_faults_have_the_areas_that_are_black() -> None:
    for name, square_mm in (("white", 100 - 4 * math.pi), ("bg", 4 * math.pi)):
        for union in (False, True):
            drawn = pw.read_aperture(DATA / f"{name}.svg", union=union)
            assert drawn.area == pytest.approx(square_mm * 1e-6, rel=1e-12, abs=0.0)


PLATE, HOLE, CORE = (
    f'<rect x="{x}" y="{x}" width="{20 - 2 * x}" height="{20 - 2 * x}" {{}}/>' for x in (0, 3, 7)
)


@pytest.mark.parametrize(
    "white",
    ['fill="white"', 'fill="#FFF"', 'style="fill: rgb(255, 255, 255)"', 'fill="hsl(0, 0%, 100%)"',
     'fill="#ffff"', 'fill="currentColor" color="White"', 'fill="rgba(255,255,255,1)"'],
)  # fmt: skip
def test_white_shapes_in_any_notation_are_holes(read: Read, white: str) -> None:
    body = PLATE.format('fill="#123"') + HOLE.format(white)
    assert read(body).area == pytest.approx((400 - 196) * 1e-6, rel=1e-12, abs=0.0)


OVERLAP = '<rect width="6" height="6"/><rect x="4" width="6" height="6"/>'
WHITE = {
    "hides what lies below, and nothing above": (
        PLATE.format('fill="#123"') + HOLE.format('fill="white"') + CORE.format('fill="red"'),
        {}, 400 - 196 + 36),
    "below": (HOLE.format('fill="white"') + CORE.format(""), {}, 36),
    "page": (PLATE.format("") + PLATE.format('fill="white"') + CORE.format(""), {}, 36),
    "cuts all shapes below": (
        '<rect width="6" height="6"/><rect x="10" width="6" height="6"/>'
        '<rect x="4" y="2" width="8" height="2" fill="white"/>', {}, 72 - 8),
    "leaves overlaps to be joined": (
        OVERLAP + '<rect x="1" y="1" width="1" height="1" fill="white"/>', {"union": True}, 59),
    "alone": (
        '<g fill="white"><rect width="5" height="5"/><rect x="9" width="5" height="5"/></g>',
        {}, 50),
}  # fmt: skip


@pytest.mark.parametrize(("body", "options", "square_mm"), WHITE.values(), ids=WHITE)
def test_white_shapes_hide_what_lies_below_and_are_open_alone(
    read: Read, body: str, options: dict[str, bool], square_mm: float
) -> None:
    assert read(body, **options).area == pytest.approx(square_mm * 1e-6, rel=1e-12, abs=0.0)


@pytest.mark.parametrize(
    "fill", ['fill="yellow"', 'fill="white" opacity="0.8"', 'fill="white" fill-opacity="50%"',
             'fill="#ffffff80"', 'fill="#fefefe"'],
)  # fmt: skip
def test_other_colours_on_each_other_are_refused_with_advice(read: Read, fill: str) -> None:
    body = PLATE.format("") + HOLE.format(fill)
    with pytest.raises(GeometryError, match=r"union=True \(--union\)"):
        read(body)


def test_a_rounded_rectangle_lacks_four_corners(read: Read) -> None:
    drawn = read('<rect width="8" height="5" rx="2" ry="1"/>', tolerance=1e-7)
    assert drawn.area == pytest.approx((40 - (4 - math.pi) * 2) * 1e-6, rel=1e-4)


def test_a_drawing_by_matplotlib_reads_with_its_doctype(tmp_path: Path) -> None:
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    figure = Figure(figsize=(4, 2), frameon=False)
    figure.add_artist(Circle((0.5, 0.5), 0.25, transform=figure.dpi_scale_trans))
    path = tmp_path / "circle.svg"
    FigureCanvasSVG(figure).print_svg(path)
    assert "<!DOCTYPE" in path.read_text()
    # Matplotlib's circles consist of eight cubic curves with an error of 4e-6; chords remove up to
    # 0.2 %.
    assert pw.read_aperture(path).area == pytest.approx(math.pi * (0.25 * 0.0254) ** 2, rel=2e-3)


BAD = {
    "no shapes": ("", FileFormatError, "contains no filled shapes"),
    "only strokes": ('<path fill="none" d="M0 0h1v1z"/>', FileFormatError, "set a fill"),
    "only points": ('<path d="M0 0 Z M1 1 L 2 2"/>', FileFormatError, "enclose an area"),
    "nested svg": ("<svg><rect/></svg>", FileFormatError, "a nested svg element"),
    "symbol": ('<symbol id="s"/><use href="#s"/>', FileFormatError, "a group or shape"),
    "colour": ('<rect width="9" height="9" fill="rgb(9 9 9 / 0%)"/>', FileFormatError, "a fill"),
    "text": ("<text>W</text>", FileFormatError, "got a text element"),
    "image": ('<image href="/etc/passwd"/>', FileFormatError, "got a image element"),
    "clipped": ('<g clip-path="url(#c)"><rect/></g>', FileFormatError, "element with clip-path"),
    "masked": ('<rect style="mask: url(#m)"/>', FileFormatError, "element with mask"),
    "negative radius": ('<circle r="-1"/>', FileFormatError, "lengths of zero or more"),
    "infinite": ('<rect width="1e999" height="1"/>', FileFormatError, "finite"),
    "huge": ('<path d="M0 0H1e200V1z"/>', FileFormatError, "below 1e\\+100"),
    "nan in a path": ('<path d="M0 0 L nan 1 Z"/>', FileFormatError, "path data"),
    "odd points": ('<polygon points="0 0 1 0 1"/>', FileFormatError, "or points"),
    "no start": ('<path d="L 1 1 2 2z"/>', FileFormatError, "starts with M"),
    "missing number": ('<path d="M0 0L1 1 2z"/>', FileFormatError, "path data"),
    "dotted number": ('<path d="M0. 0H1V1z"/>', FileFormatError, r"path data|does not read"),
    "unknown transform": ('<g transform="turn(3)"><rect/></g>', FileFormatError, "a transform"),
    "percent": ('<circle cx="10%" r="1"/>', FileFormatError, "the cx without a percent sign"),
    "em": ('<rect width="1em" height="1"/>', FileFormatError, "in px, mm"),
    "foreign use": ('<use href="other.svg#a"/>', FileFormatError, "in the same file"),
    "use of itself": ('<g id="a"><use href="#a"/></g>', FileFormatError, "contains itself"),
    "style sheet": ("<style>.a {stroke: red; fill :none}</style>", FileFormatError, "style sheet"),
    "sheet of sizes": ("<style>rect{width:5px}</style>", FileFormatError, "style sheet"),
    "white page": (HOLE.format("") + PLATE.format('fill="white"'), FileFormatError,
                   "white shapes cover"),
    "white on an overlap": (OVERLAP + '<rect x="1" width="1" height="1" fill="white"/>',
                            GeometryError, "an overlap"),
    "overlap": ('<rect width="5" height="5"/><circle r="2"/>', GeometryError, "an overlap"),
    "twice": ('<rect width="5" height="5"/>' * 2, GeometryError, "overlap"),
}  # fmt: skip


@pytest.mark.parametrize(("body", "kind", "words"), BAD.values(), ids=BAD)
def test_what_is_no_outline_raises_one_error(
    read: Read, body: str, kind: type[Exception], words: str
) -> None:
    with pytest.raises(kind, match=words) as raised:
        read(body)
    assert "\n" not in str(raised.value)
    assert "drawing.svg: " in str(raised.value)


@pytest.mark.parametrize("root", ['viewBox="0 0 0 1"', 'viewBox="0 0 1"', 'width="1 mm"',
                                  'width="-1mm"', 'width="1e999mm"', 'width="3em"',
                                  'width="2mm" height="5mm" viewBox="0 0 2 1"'])  # fmt: skip
def test_a_size_that_is_none_raises(read: Read, root: str) -> None:
    with pytest.raises(FileFormatError, match=r"viewBox|width"):
        read('<rect width="1" height="1"/>', root)


@pytest.mark.parametrize("tolerance", [0, -1e-5, math.nan, "1 mm", True])
def test_a_tolerance_is_a_length_above_zero(read: Read, tolerance: object) -> None:
    with pytest.raises(ArgumentError, match="tolerance to be a length in m above zero"):
        read('<circle r="3"/>', tolerance=tolerance)
    with pytest.raises(FileFormatError, match="larger tolerance"):
        read('<circle r="3"/>', tolerance=1e-18)


TRANSFORMS = (
    "translate(3 -2)", "translate(4)", "scale(2)", "scale(0.5 3)", "rotate(33)", "rotate(-70 2 5)",
    "skewX(25)", "skewY(-40)", "matrix(1 0.5 -0.7 1.3 4 -6)", "translate(1,2) rotate(20) scale(2)",
)  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_nested_transforms_agree_with_another_reader(read: Read, seed: int) -> None:
    """svgelements reads the same document."""
    import io

    from svgelements import SVG, Path

    dice = np.random.default_rng(seed)
    first, second, third, fourth = (TRANSFORMS[k] for k in dice.permutation(10)[:4])
    body = (
        f'<defs><polygon id="p" transform="{first}" points="0,0 5,1 4,6 1,3"/></defs>'
        f'<g transform="{second}"><g transform="{third}"><use href="#p" x="2" y="3" '
        f'transform="{fourth}"/></g></g>'
    )
    root = 'viewBox="0 0 100 100" width="100" height="100"'
    document = (
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f"{root}>{body}</svg>"
    )
    shapes = [
        shapely.Polygon([(p.x, -p.y) for p in Path(shape).as_points()])
        for shape in SVG.parse(io.StringIO(document), reify=True).elements()
        if type(shape).__name__ == "Polygon"
    ]
    assert len(shapes) == 1
    assert difference(read(body, root, unit="m"), pw.Aperture(shapes)) < ROUNDING


# Relative rounding error of unions, which have a grid of 2^-44 of the size.
UNION = 1e-12

BOARD = (
    '<g id="layer1" inkscape:label="Board" inkscape:groupmode="layer" filter="{effect}">'
    '<rect width="20" height="10"/>{text}</g>'
    '<g id="layer2" inkscape:label="Pads" style="{style}">'
    '<rect id="left" x="1" y="2" width="3" height="4"/><rect x="3" y="2" width="5" height="4"/></g>'
)
INKSCAPE = f'{MILLIMETRES} xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"'


def test_a_group_is_read_alone_by_its_name_or_id_even_if_hidden(read: Read) -> None:
    pads = rectangle(1, 2, 8, 6)
    for style in ("", "display:none"):
        body = BOARD.format(effect="url(#blur)", text="<text>top</text>", style=style)
        for layer in ("Pads", "layer2", ["Pads"]):
            joined = read(body, INKSCAPE, layer=layer, union=True)
            assert difference(joined, pads) < UNION
        assert read(body, INKSCAPE, layer="left") == rectangle(1, 2, 4, 6)


def test_an_effect_around_a_layer_is_refused_with_it(read: Read) -> None:
    body = '<g mask="url(#m)"><g id="pads"><rect width="1" height="1"/></g></g>'
    with pytest.raises(FileFormatError, match="expected plain shapes, got a g element with mask"):
        read(body, layer="pads")
    assert read(body + '<g id="b"><rect width="9" height="9"/></g>', layer="b").area > 0


def test_overlapping_shapes_are_refused_with_advice_for_a_drawing(read: Read) -> None:
    body = BOARD.format(effect="none", text="", style="")
    with pytest.raises(GeometryError, match=r"\(--layer\), or pass union=True \(--union\)"):
        read(body, INKSCAPE)
    assert read(body, INKSCAPE, union=True) == rectangle(0, 0, 20, 10)


def test_an_unknown_group_is_answered_with_those_there_are(read: Read) -> None:
    body = BOARD.format(effect="none", text="", style="")
    with pytest.raises(
        ArgumentError, match="no layer 'pads'; its layers are Board, Pads, layer1, layer2"
    ):
        read(body, INKSCAPE, layer="pads")


def test_files_without_layers_have_none_to_choose(tmp_path: Path) -> None:
    path = tmp_path / "square.wkt"
    path.write_text("MULTIPOLYGON (((0 0, 2 0, 2 2, 0 2, 0 0)), ((1 0, 3 0, 3 2, 1 2, 1 0)))")
    with pytest.raises(ArgumentError, match="layer applies only to drawings"):
        pw.read_aperture(path, layer="pads")
    assert pw.read_aperture(path, union=True).area == pytest.approx(6e-6, rel=UNION, abs=0.0)
