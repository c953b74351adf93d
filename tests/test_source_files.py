"""Source files: what was written comes back equal, what people write means what it says, and what
cannot be understood is refused with its place."""

from __future__ import annotations

import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from polywigner import arrays
from polywigner.errors import (
    ArgumentError,
    FileFormatError,
    GeometryError,
    MissingExtraError,
    PolywignerError,
    QuantityError,
)
from polywigner.quantities import SPEED_OF_LIGHT

WAVELENGTH = SPEED_OF_LIGHT / 77e9
RNG = np.random.default_rng(12)

HOLED = pw.Aperture(shapely.box(0, 0, 0.1, 0.3) - shapely.box(0.03, 0.1, 0.07, 0.2))
APART = pw.shapes.hexagonal_segments(0.1, gap=0.003, rings=1)
SQUARE = pw.shapes.square(1 / 3)
TAPERED = pw.shapes.rectangle(1e-3 / 3, 2e-3).with_illumination(
    pw.taylor_taper(1e-3 / 3, 2e-3, sll=25, nbar=3) * pw.steering((0.1, 0.7), WAVELENGTH)
)
FAR = pw.Aperture([[0, 0], [1, -1e-9], [2, 0], [2, 1], [0, 1]]).moved((0, 1e8))  # now straight
SLITS = pw.Slits([[-0.3, -0.1], [0.0, 0.1], [0.2, 1 / 3]])
LIT_SLITS = SLITS.with_illumination(pw.steering(0.3, 0.01) * (0.25 - 1j))
NEAR_SLITS = pw.Slits([[-1, -1e-9], [1e-9, 1.0]]).moved(1e6 / 3)  # nearer than those may be given
TETRAHEDRON = pw.Polyhedron(
    [[0, 0, 0], [0.1, 0, 0], [0, 1 / 3, 0], [0, 0, 0.7]],
    [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
)


def pose(seed: int) -> np.ndarray:
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    matrix[:3, 3] = [0.1, -1 / 3, 1e-17]
    return matrix


GRID = arrays.grid_positions(4, 3, 0.1)
SOURCES = {
    "aperture": SQUARE,
    "aperture with a hole": HOLED,
    "disjoint parts": APART,
    "triangles of a bow-tie": pw.Aperture.from_ring([[0, 0], [1, 1], [1, 0], [0, 1]]),
    "automean": pw.automean(pw.shapes.chevron(0.02, 0.012, 0.004)),
    "tapered aperture": TAPERED,
    "aperture far away": FAR,
    "tapered aperture far away": TAPERED.moved((7.1, -1e3 / 3)),
    "slits": SLITS,
    "lit slits": LIT_SLITS,
    "slits far away": NEAR_SLITS,
    "placed aperture": HOLED.placed(pose(1)),
    "placed tapered aperture": TAPERED.placed(pose(2)),
    "polyhedron": TETRAHEDRON,
    "array": pw.Array([HOLED, TAPERED, SQUARE], RNG.normal(size=3) + 1j * RNG.normal(size=3)),
    "array in space": pw.Array(
        [HOLED.placed(pose(k)) for k in range(3)] + [TETRAHEDRON, SQUARE], [1, -0.5, 0.25, 2, 3]
    ),
    "array of slits": pw.Array([SLITS, LIT_SLITS]),
    "phased array": pw.phased_array(
        TAPERED, GRID, arrays.steering_weights(GRID, (0.3, 0.1), WAVELENGTH)
    ),
    "tapered array": pw.phased_array(SQUARE, GRID * 7, np.linspace(0.1, 1, 12)),
    "uniform array": pw.phased_array(APART, arrays.triangular_positions(3, 3, 1.1)),
    "phased slits": pw.phased_array(LIT_SLITS, np.arange(5) / 0.3, np.arange(5) - 2j),
}
formats = pytest.mark.parametrize("suffix", [".toml", ".json"])


@formats
@pytest.mark.parametrize("name", SOURCES)
def test_a_source_that_was_written_comes_back_equal(name: str, suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"source{suffix}"
    pw.write_source(SOURCES[name], file)
    again = pw.read_source(file)
    assert again == SOURCES[name]
    assert type(again) is type(SOURCES[name])
    assert [path.name for path in tmp_path.iterdir()] == [file.name]
    # and what is written the second time is the same text
    written = file.read_text()
    pw.write_source(again, file)
    assert file.read_text() == written
    # the parts of the last one touch, and would come back in another order
    marked = ("aperture far away", "slits far away", "triangles of a bow-tie")
    assert ("verbatim" in written) == (name in marked)


PATCH = """
kind = "phased-array"
frequency = "77 GHz"

[element]
kind = "aperture"
shape = {name = "rectangle", a = "1.2 mm", b = "0.9 mm"}
illumination = {kind = "cosine_taper", width = "1.2 mm"}

[positions]
kind = "grid"
nx = 12
ny = 16
pitch_x = "1.9 mm"
pitch_y = "2.1 mm"

[[weights]]
kind = "window"
window = ["taylor", "chebyshev"]
sll = 25
nbar = 4

[[weights]]
kind = "steering"
theta = "20 deg"
phi = "-90 deg"
"""


def test_a_file_written_by_hand_is_what_python_makes(tmp_path: Path) -> None:
    (tmp_path / "array.toml").write_text(PATCH)
    element = pw.shapes.rectangle(1.2e-3, 0.9e-3).with_illumination(pw.cosine_taper(1.2e-3))
    places = arrays.grid_positions(12, 16, 1.9e-3, 2.1e-3)
    theta, phi = np.radians(20), np.radians(-90)
    s = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    weights = arrays.window_weights((12, 16), ("taylor", "chebyshev"), sll=25, nbar=4)
    expected = pw.phased_array(
        element, places, weights * arrays.steering_weights(places, s, WAVELENGTH)
    )
    read = pw.read_source(tmp_path / "array.toml")
    assert isinstance(read, pw.Array)
    assert read.repeated is not None
    assert read.repeated[0] == element
    np.testing.assert_array_equal(read.repeated[1], places)
    np.testing.assert_allclose(read.weights, expected.weights, rtol=1e-12)
    # towards -y, and nowhere else
    nu = np.array([[0, -1], [0, 1], [1, 0]]) * np.sin(theta) / WAVELENGTH
    lobes = np.abs(pw.fourier(read, nu))
    assert lobes[0] > 10 * lobes[1:].max()


FIELDS = [
    ({"kind": "uniform"}, pw.uniform()),
    ({"kind": "steering", "direction": [0.6, 0.0, 0.8], "wavelength": "4 mm"},
     pw.steering((0.6, 0, 0.8), 4e-3)),
    ({"kind": "steering", "direction": [0.1, -0.2], "frequency": 77e9},
     pw.steering((0.1, -0.2), WAVELENGTH)),
    ({"kind": "steering", "theta": "0 deg", "frequency": "77 GHz"},
     pw.steering((0, 0, 1), WAVELENGTH)),
    ({"kind": "cosine_taper", "height": "6 mm", "power": 2}, pw.cosine_taper(None, 6e-3, 2)),
    ({"kind": "taylor_taper", "width": 0.01, "height": "6 mm", "sll": 25, "nbar": 5},
     pw.taylor_taper(0.01, 6e-3, sll=25, nbar=5)),
    ({"kind": "te_mode", "width": "10 mm", "height": "6 mm"}, pw.te_mode(0.01, 6e-3)),
    ({"kind": "te_mode", "width": "10 mm", "height": "6 mm", "m": 2, "n": 1, "component": "x"},
     pw.te_mode(0.01, 6e-3, 2, 1, "x")),
    ({"kind": "fourier_taper", "width": "10 mm", "coefficients": [[0, 0.5], 1, [0, -0.5]]},
     pw.fourier_taper(0.01, coefficients=[0.5j, 1, -0.5j])),
    ({"kind": "fourier_taper", "width": 1, "height": 2, "coefficients": [[1, 2, [3, -1]]]},
     pw.fourier_taper(1, 2, coefficients=[[1, 2, 3 - 1j]])),
    ({"kind": "waves", "amplitudes": [1, [0, 2]], "frequencies": [[1, 2], [3, 4.5]]},
     pw.Illumination([1, 2j], [[1, 2], [3, 4.5]])),
    ([{"kind": "te_mode", "width": "10 mm", "height": "6 mm"},
      {"kind": "steering", "direction": [0.1, -0.2], "frequency": "77 GHz"}],
     pw.te_mode(0.01, 6e-3) * pw.steering((0.1, -0.2), WAVELENGTH)),
]  # fmt: skip


def test_the_examples_of_the_documents_are_sources(tmp_path: Path) -> None:
    page = Path(__file__).parent.parent / "docs" / "illumination.md"
    blocks = re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) == 2
    for number, block in enumerate(blocks):
        (tmp_path / f"{number}.toml").write_text(block)
    array, horn = (pw.read_source(tmp_path / f"{number}.toml") for number in range(2))
    assert isinstance(array, pw.Array)
    assert len(array) == 192
    field = pw.te_mode(12e-3, 9e-3)
    steered = pw.steering((np.sin(np.radians(10)), 0.0), SPEED_OF_LIGHT / 94e9)
    expected = pw.shapes.rectangle(12e-3, 9e-3).with_illumination(field * steered)
    x = np.random.default_rng(1).uniform(-4e-3, 4e-3, (20, 2))
    np.testing.assert_allclose(horn.illumination(x), expected.illumination(x), rtol=1e-12)
    assert horn.with_illumination(None) == expected.with_illumination(None)


def read_table(table: dict[str, Any], folder: Path) -> Any:
    file = folder / "source.json"
    file.write_text(json.dumps(table))
    return pw.read_source(file)


@pytest.mark.parametrize(("table", "expected"), FIELDS)
def test_fields_may_be_named(table: Any, expected: pw.Illumination, tmp_path: Path) -> None:
    shape = {"name": "square", "a": "10 mm"}
    source = read_table({"kind": "aperture", "shape": shape, "illumination": table}, tmp_path)
    assert source == pw.shapes.square(0.01).with_illumination(expected)


def test_fields_of_slits_are_one_dimensional(tmp_path: Path) -> None:
    table = {"kind": "slits", "intervals": [["-5 mm", "5 mm"]], "wavelength": "4 mm"}
    fields = {
        "cosine": ({"kind": "cosine_taper", "width": "10 mm"}, pw.cosine_taper(0.01, dimension=1)),
        "steering": ({"kind": "steering", "direction": 0.25}, pw.steering(0.25, 4e-3)),
        "angle": ({"kind": "steering", "theta": "-90 deg"}, pw.steering(-1, 4e-3)),
        "uniform": ({"kind": "uniform"}, pw.uniform(1)),
    }
    for given_field, expected in fields.values():
        source = read_table({**table, "illumination": given_field}, tmp_path)
        assert source == pw.Slits([-5e-3, 5e-3]).with_illumination(expected)


LAYOUTS = [
    ({"kind": "grid", "nx": 3, "ny": 2, "pitch_x": "1 mm"}, arrays.grid_positions(3, 2, 1e-3)),
    ({"kind": "triangular", "nx": 3, "ny": 2, "pitch_x": "1 mm"},
     arrays.triangular_positions(3, 2, 1e-3)),
    ({"kind": "rings", "radii": [0, "1 mm"], "counts": [1, 6]},
     arrays.ring_positions([0, 1e-3], [1, 6])),
    ([["-1 mm", 0], [0.5, "2 mm"]], np.array([[-1e-3, 0], [0.5, 2e-3]])),
]  # fmt: skip


@pytest.mark.parametrize(("table", "expected"), LAYOUTS)
def test_layouts_may_be_named(table: Any, expected: np.ndarray, tmp_path: Path) -> None:
    element = {"kind": "aperture", "shape": {"name": "square", "a": 1e-4}}
    weights = {"kind": "focusing", "point": ["1 mm", 0, "60 mm"], "frequency": "77 GHz"}
    source = read_table(
        {"kind": "phased-array", "element": element, "positions": table, "weights": weights},
        tmp_path,
    )
    focused = arrays.focusing_weights(expected, (1e-3, 0, 60e-3), WAVELENGTH)
    assert source == pw.phased_array(pw.shapes.square(1e-4), expected, focused)


def test_outlines_may_be_in_other_files_and_placed(tmp_path: Path) -> None:
    (tmp_path / "outlines").mkdir()
    (tmp_path / "outlines" / "patch.wkt").write_text("POLYGON ((0 0, 3 0, 3 2, 0 0))")
    outline = {"kind": "aperture", "file": "outlines/patch.wkt", "unit": "cm"}
    triangle = pw.Aperture([[0, 0], [0.03, 0], [0.03, 0.02]])
    assert read_table(outline, tmp_path) == triangle
    matrix = [[0, 0, 1, "2 mm"], [1, 0, 0, 0], [0, 1, 0, "-1 m"], [0, 0, 0, 1]]
    placed = read_table({**outline, "to_world": matrix}, tmp_path)
    expected = [[0, 0, 1, 2e-3], [1, 0, 0, 0], [0, 1, 0, -1], [0, 0, 0, 1]]
    assert placed == triangle.placed(expected)
    both = read_table({"kind": "array", "elements": [outline, outline]}, tmp_path)
    assert both == pw.Array([triangle, triangle])
    corners = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\n"
    (tmp_path / "body.obj").write_text(corners + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    body = read_table({"kind": "polyhedron", "file": "body.obj", "unit": "cm"}, tmp_path)
    assert isinstance(body, pw.Polyhedron)
    assert body.volume == pytest.approx(1e-6, rel=1e-12, abs=0.0)
    tiles = [[[[0, 0], [1, 0], [1, 1], [0, 1]]], [[[1, 1], [1, 0], [2, 0], [2, 1]]]]
    merged = read_table({"kind": "aperture", "polygons": tiles}, tmp_path)
    assert merged == pw.Aperture([[0, 0], [2, 0], [2, 1], [0, 1]])


def test_a_row_of_slits_has_a_window_and_is_steered(tmp_path: Path) -> None:
    row = {
        "kind": "phased-array",
        "wavelength": "4 mm",
        "element": {"kind": "slits", "intervals": [[-1e-3, 1e-3]]},
        "positions": {"kind": "row", "count": 8, "pitch": "3 mm"},
        "weights": [
            {"kind": "window", "window": "chebyshev", "sll": "25 dB"},
            {"kind": "steering", "theta": 0.2},
        ],
    }
    places = arrays.grid_positions(8, 1, 3e-3)[:, 0]
    weights = arrays.window_weights(8, "chebyshev", sll=25)
    steered = weights * arrays.steering_weights(places, np.sin(0.2), 4e-3)
    assert read_table(row, tmp_path) == pw.phased_array(pw.Slits([-1e-3, 1e-3]), places, steered)
    row["weights"] = {"kind": "window", "window": "chebyshev", "sll": "25 mm"}
    with pytest.raises(QuantityError, match=r"sll: expected a level .* got '25 mm'"):
        read_table(row, tmp_path)


def test_a_drawing_is_read_by_its_layers_and_joined_as_the_table_says(tmp_path: Path) -> None:
    """The file is read anew for other layers."""
    shapes = [f'<g id="{name}"><rect x="{x}" width="2" height="1"/></g>'
              for name, x in (("pad", 0), ("feed", 1), ("mark", 5))]  # fmt: skip
    (tmp_path / "antenna.svg").write_text(f"<svg>{''.join(shapes)}</svg>")
    drawn = {"kind": "aperture", "file": "antenna.svg"}
    tables = [
        drawn | {"layer": "pad"},
        drawn | {"layer": ["pad", "feed"], "union": True},
        drawn | {"union": True},
    ]
    array = read_table({"kind": "array", "elements": tables}, tmp_path)
    areas = [element.area * 1e6 for element in array.elements]
    assert areas == pytest.approx([2, 3, 5], rel=1e-12)  # the union's grid is 6e-14
    with pytest.raises(ArgumentError, match="got 'board'; it has"):
        read_table(drawn | {"layer": "board"}, tmp_path)


APERTURE = {"kind": "aperture", "shape": {"name": "square", "a": 1.0}}
SLIT = {"kind": "slits", "intervals": [[0, 1]]}
PHASED = {"kind": "phased-array", "element": APERTURE, "positions": [[0, 0], [2, 0]]}
UNIT = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
CLOCKWISE = [[[[0, 0], [0, 1], [1, 1], [1, 0]]]]


def lit(**field: Any) -> dict[str, Any]:
    return {**APERTURE, "illumination": field}


BAD = [
    ([], "table"),
    ({"kind": "horn"}, "aperture, slits, polyhedron, array, phased-array, got 'horn'"),
    ({**APERTURE, "version": 2}, "version: expected 1, got 2"),
    ({**APERTURE, "taper": 1}, "expected the keys kind, file, polygons, shape.*got 'taper'"),
    ({"kind": "aperture"}, "one of the keys file, polygons, shape, got none"),
    ({**APERTURE, "file": "a.wkt"}, "got file and shape"),
    ({**APERTURE, "unit": "mm"}, "'unit' with 'file' only"),
    ({**APERTURE, "verbatim": True}, "'verbatim' with 'polygons' only"),
    ({**APERTURE, "frequency": 1, "wavelength": 1}, "got both"),
    ({**APERTURE, "frequency": "77 mm"}, "frequency: .*GHz"),
    ({"kind": "aperture", "file": "none.wkt"}, "none.wkt: expected"),
    ({"kind": "aperture", "shape": {"name": "circlet"}}, "name of a shape out of bow_tie"),
    ({"kind": "aperture", "shape": {"name": "square"}}, "expected the key 'a'"),
    ({"kind": "aperture", "shape": {"name": "square", "b": 1, "a": 1}}, "name, a, got 'b'"),
    ({"kind": "aperture", "shape": {"name": "square", "a": [1]}}, "square: expected a"),
    ({"kind": "aperture", "shape": {"name": "disc", "radius": 1, "n": 10**9}}, "at most 4096"),
    ({"kind": "aperture", "shape": {"name": "disc", "radius": 1, "n": 8.0}}, "n: .*whole"),
    ({"kind": "aperture", "polygons": [[0, 0], [1, 0], [1, 1]]}, "list of polygons"),
    ({"kind": "aperture", "polygons": [[[[[0]]]]]}, "nested too deeply"),
    ({"kind": "aperture", "polygons": [[[[0, 0], [1, 1], [1, 0], [0, 1]]]]}, "crosses itself"),
    ({"kind": "aperture", "polygons": [[[[0, 0], [1, 0], [1, True]]]]}, "got True"),
    ({"kind": "aperture", "polygons": CLOCKWISE, "verbatim": True}, "counter-clockwise"),
    ({"kind": "aperture", "polygons": [[[[0, 0], [1]]]], "verbatim": True}, "rings of vertices"),
    ({"kind": "aperture", "polygons": [[[[0, 0], [3, 0], [1, 1], [2, 2], [1, 0]]]],
      "verbatim": True}, "leave verbatim out"),
    ({**APERTURE, "to_world": UNIT[:3]}, r"to_world: .*\(4, 4\)"),
    ({**APERTURE, "to_world": [[2, 0, 0, 0], *UNIT[1:]]}, "to_world: .*scales"),
    ({**SLIT, "to_world": UNIT}, "expected the keys kind, intervals, shape"),
    ({"kind": "slits", "intervals": [[0, 1], [0.5, 2]]}, "intervals: .*overlap"),
    ({"kind": "slits", "intervals": [[0, 1], [0.5, 2]], "verbatim": True}, "ascending"),
    ({"kind": "slits", "shape": {"name": "square", "a": 1.0}}, "a shape that is an? Slits"),
    ({"kind": "polyhedron", "file": "a.obj", "faces": []}, "kind, file, unit, got 'faces'"),
    ({"kind": "polyhedron", "vertices": [[0, 0, 0]], "faces": 1}, "faces: expected a list, got 1"),
    ({"kind": "polyhedron", "vertices": [[0, 0, 0]], "faces": [[0.0]]}, "faces: .*whole"),
    ({"kind": "array", "elements": APERTURE}, "elements: expected a list, got a table"),
    ({"kind": "array", "elements": [APERTURE, 3]}, "element 1: .*without a kind"),
    ({"kind": "array", "elements": [APERTURE, PHASED]}, "element 1: .*'phased-array'"),
    ({"kind": "array", "elements": [APERTURE], "weights": [[1, 2, 3]]}, r"\[real, imaginary\]"),
    ({"kind": "array", "elements": [APERTURE, SLIT]}, "one space"),
    ({**PHASED, "element": {**APERTURE, "to_world": UNIT}}, "without a pose"),
    ({**PHASED, "positions": [[0, 0, 0]]}, r"positions: .*\(n, 2\)"),
    ({**PHASED, "positions": {"kind": "spiral"}}, "row, grid, triangular, rings, got 'spiral'"),
    ({**PHASED, "positions": {"kind": "grid", "nx": 10**6, "ny": 10**6, "pitch_x": 1}},
     "positions: grid: .*1048576"),
    ({**PHASED, "positions": {"kind": "row", "count": 2, "pitch": 1}}, r"\(n, 2\)"),
    ({**PHASED, "weights": {"kind": "window", "window": "taylor"}}, "kind row, grid or triangular"),
    ({**PHASED, "weights": {"kind": "steering", "theta": 0.1}}, "top of the file"),
    ({**PHASED, "weights": [{"kind": "steering", "theta": 0.1, "wavelength": -1}]},
     "weights: number 0: steering: wavelength: .*above zero"),
    ({**PHASED, "weights": [1, {"kind": "steering"}]}, "number 0: .*window, steering, focusing"),
    ({**PHASED, "weights": {"kind": "focusing", "point": [0, 0, -1], "wavelength": 1}},
     "above zero"),
    (lit(kind="gaussian"), "uniform, steering, cosine_taper.*got 'gaussian'"),
    (lit(kind="cosine_taper", widht=1), "cosine_taper: expected the keys.*got 'widht'"),
    (lit(kind="cosine_taper"), "width to taper"),
    (lit(kind="cosine_taper", width="1 GHz"), "cosine_taper: width: .*length"),
    (lit(kind="te_mode", width=1), "expected the key 'height'"),
    (lit(kind="steering"), "direction or the angle theta, got neither"),
    (lit(kind="steering", phi=0.1, direction=[0, 0, 1], wavelength=1), "phi with theta only"),
    (lit(kind="waves", amplitudes=[1, 2], frequencies=[[1], [1, 2]]), "complex amplitudes"),
    (lit(kind="fourier_taper", width=1, height=1, coefficients=[[1], [1, 2]]), "different lengths"),
    ({**APERTURE, "a\nb\x1b[31m": 1}, r"got 'a\\nb\\x1b"),
    ({"kind": "aperture", "file": "a\nb\x1b.wkt"}, "a\N{REPLACEMENT CHARACTER}b"),
    ({**PHASED, "positions": {"kind": "rings", "radii": [[1], [1, 2]], "counts": [1, 1]}}, "radii"),
    ({**APERTURE, "illumination": 2 * [{"kind": "taylor_taper", "width": 1, "height": 1,
      "nbar": 100}]}, "at most 1000000 plane waves"),
    ({**SLIT, "illumination": {"kind": "te_mode", "width": 1, "height": 1}}, "got slits"),
    ({**SLIT, "illumination": {"kind": "steering", "theta": 1, "phi": 1, "wavelength": 1}},
     "no phi for slits"),
]  # fmt: skip


@pytest.mark.parametrize(("table", "complaint"), BAD)
def test_what_is_not_understood_is_refused_with_its_place(
    table: Any, complaint: str, tmp_path: Path
) -> None:
    with pytest.raises(PolywignerError, match=complaint) as caught:
        read_table(table, tmp_path)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "source.json"))
    assert "\n" not in message
    assert len(message) < 1100


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("a.toml", b"", "empty"),
        ("a.toml", b"kind = 'aperture", "expected TOML"),
        ("a.toml", b"kind = 1\nkind = 2", "expected TOML"),
        ("a.json", b"{'kind': 1}", "expected JSON"),
        ("a.json", b'{"kind": 1, "kind": 2}', "'kind' twice"),
        ("a.json", b'{"kind": NaN}', "got NaN"),
        ("a.json", b'{"kind": "slits", "intervals": [0, 1e999]}', "finite number, got inf"),
        ("a.toml", b'kind = "slits"\nintervals = [0, 1979-05-27]', "finite number"),
        ("a.json", b'{"kind": "slits", "intervals": [0, 1' + b"0" * 400 + b"]}", "finite number"),
        ("a.json", b"[" * 100_000, "nested too deeply"),
        ("a.toml", b"a = " + b"[" * 100_000, "nested too deeply|expected TOML"),
        ("a.yaml", b"kind: aperture", ".toml or .json, got '.yaml'"),
    ],
)
def test_text_that_is_no_source_is_refused(
    name: str, content: bytes, complaint: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileFormatError, match=complaint):
        pw.read_source(tmp_path / name)


def test_paths_that_are_none_and_large_files_are_refused(tmp_path: Path) -> None:
    with (tmp_path / "large.toml").open("wb") as file:
        file.truncate(65 * 2**20)
    for name, complaint in (("none.toml", "does not exist"), ("large.toml", "MiB, got 65 MiB")):
        with pytest.raises(FileFormatError, match=complaint):
            pw.read_source(tmp_path / name)
    for path in (tmp_path / "null\0.toml", None, SQUARE):
        with pytest.raises(ArgumentError, match="expected a path"):
            pw.read_source(path)  # type: ignore[arg-type]


def test_the_error_of_a_missing_library_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "scipy.signal.windows", None)
    (tmp_path / "array.toml").write_text(PATCH)
    with pytest.raises(MissingExtraError, match=r"window: .*\.\[arrays\]"):
        pw.read_source(tmp_path / "array.toml")


def test_a_file_is_replaced_as_a_whole_or_not_written_at_all(tmp_path: Path) -> None:
    (tmp_path / "taken.json").mkdir()
    for source, name, error, words in (
        (SQUARE, "no folder/a.toml", ArgumentError, "expected to write"),
        (SQUARE, "taken.json", ArgumentError, "expected to write"),
        (SQUARE, "a.txt", FileFormatError, r"\.toml or \.json"),
        (3, "a.toml", ArgumentError, "got int"),
    ):
        with pytest.raises(error, match=words):
            pw.write_source(source, tmp_path / name)  # type: ignore[arg-type]
    assert [path.name for path in tmp_path.iterdir()] == ["taken.json"]
    file = tmp_path / "a.toml"
    pw.write_source(SOURCES["phased array"], file)
    # all its vertices on one line
    flat = pw.Aperture([(0, 0), (4, 4), (8, 8.5)]).moved((1e16, 1e16))
    with pytest.raises(GeometryError, match="valid to write"):
        pw.write_source(flat, file)
    assert pw.read_source(file) == SOURCES["phased array"]
    pw.write_source(SQUARE, file)
    assert pw.read_source(file) == SQUARE


@pytest.mark.parametrize("suffix", [".toml", ".json"])
@pytest.mark.parametrize(
    ("source", "polarisation", "jones"),
    [
        (TAPERED, "right", [1, 1j]),
        (TAPERED.curved(0.1, WAVELENGTH), (0.3 - 0.1j, 0.4), [0.3 - 0.1j, 0.4]),
        (pw.phased_array(SQUARE, GRID[:2]), ["x", "45 deg"], [[1, 0], [1, 1]]),
        (pw.Array([SQUARE, HOLED], [1, 1j]), [(1, 0), (0, 1j)], [[1, 0], [0, 1j]]),
        (SQUARE, None, None),
    ],
)
def test_a_polarisation_stands_beside_the_source(
    tmp_path: Path, source: Any, polarisation: Any, jones: Any, suffix: str
) -> None:
    path = tmp_path / f"antenna{suffix}"
    pw.write_source(source, path, polarisation=polarisation)
    assert pw.read_source(path) == source
    found = pw.read_polarisation(path)
    if jones is None:
        assert found is None
        return
    size = np.linalg.norm(jones, axis=-1, keepdims=True)
    assert found == pytest.approx(np.array(jones) / size, rel=1e-15)


def test_polarisations_are_written_as_people_say_them(tmp_path: Path) -> None:
    path = tmp_path / "antenna.toml"
    texts = {
        '"45 deg"': [math.sqrt(0.5)] * 2,
        "[3, 4]": [0.6, 0.8],
        "[[1, 0], [0, 1]]": [math.sqrt(0.5), 1j * math.sqrt(0.5)],
    }
    for written, expected in texts.items():
        head = f'kind = "aperture"\npolarisation = {written}\n'
        path.write_text(head + '[shape]\nname = "square"\na = "1 mm"\n')
        assert pw.read_polarisation(path) == pytest.approx(np.array(expected))
    for written in ('"up"', "[1, 2, 3]", "[0, 0]", '["x", "y"]', "7", "[]"):
        head = f'kind = "aperture"\npolarisation = {written}\n'
        path.write_text(head + '[shape]\nname = "square"\na = "1 mm"\n')
        with pytest.raises(PolywignerError, match="polarisation"):
            pw.read_source(path)
