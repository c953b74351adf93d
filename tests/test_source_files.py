"""Source files: round trips, tables of docs/source_files.md, and errors."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

import polywigner as pw
from oracles.poses import pose
from polywigner import arrays
from polywigner.cli import main
from polywigner.errors import (
    ArgumentError,
    FileFormatError,
    MissingExtraError,
    PolywignerError,
)
from polywigner.quantities import SPEED_OF_LIGHT
from polywigner.source import source_files, source_tables
from polywigner.source.source_tables import SOURCE_TEXTS

DOCS = Path(__file__).parent.parent / "docs"
WAVELENGTH = SPEED_OF_LIGHT / 77e9
RNG = np.random.default_rng(12)

HOLED = pw.Aperture(shapely.box(0, 0, 0.1, 0.3) - shapely.box(0.03, 0.1, 0.07, 0.2))
APART = pw.shapes.hexagonal_segments(0.1, gap=0.003, rings=1)
SQUARE = pw.shapes.square(1 / 3)
TAPERED = pw.shapes.rectangle(1e-3 / 3, 2e-3).with_illumination(
    pw.taylor_taper(1e-3 / 3, 2e-3, sll=25, nbar=3) * pw.steering((0.1, 0.7), WAVELENGTH)
)
SLITS = pw.Slits([[-0.3, -0.1], [0.0, 0.1], [0.2, 1 / 3]])
LIT_SLITS = SLITS.with_illumination(pw.steering(0.3, 0.01) * (0.25 - 1j))
GRID = arrays.grid_positions(4, 3, 0.1)
TURNED = pose(0.1, -1 / 3, 1e-17, 0.7, 2.0)


SOURCES = {
    "aperture": SQUARE,
    "hole": HOLED,
    "disjoint parts": APART,
    "triangles that touch": pw.Aperture.from_ring([[0, 0], [1, 1], [1, 0], [0, 1]]),
    "automean": pw.automean(pw.shapes.chevron(0.02, 0.012, 0.004)),
    "far away": pw.Aperture([[0, 0], [1, -1e-9], [2, 0], [2, 1], [0, 1]]).moved((0, 1e8)),
    "tapered": TAPERED.moved((7.1, -1e3 / 3)),
    "slits": SLITS,
    "lit slits": LIT_SLITS,
    "placed": TAPERED.placed(TURNED),
    "array": pw.Array([HOLED, TAPERED, SQUARE], RNG.normal(size=3) + 1j * RNG.normal(size=3)),
    "array in space": pw.Array(
        [HOLED.placed(pose(k, 0, 1e-17, k / 7, 0.3)) for k in range(3)] + [SQUARE],
        [1, -0.5, 0.25, 2],
    ),
    "array of slits": pw.Array([SLITS, LIT_SLITS]),
    "phased array": pw.phased_array(
        TAPERED, GRID, arrays.steering_weights(GRID, (0.3, 0.1), WAVELENGTH)
    ),
    "uniform array": pw.phased_array(APART, arrays.triangular_positions(3, 3, 1.1)),
    "phased slits": pw.phased_array(LIT_SLITS, np.arange(5) / 0.3, np.arange(5) - 2j),
    "curved": TAPERED.curved((0.1, -1 / 3), WAVELENGTH, (1e-4, 0)),
    "partially coherent": SLITS.partially_coherent(0.1 / 3),
    "segments": pw.segmented_pupil(APART, 1 / 3, [0.1, 0, 1, -2 / 3, 0, 0], [0.1, -1 / 3]),
    "curved copies": pw.phased_array(SQUARE.curved(0.3, 1 / 3), [(0, 0), (1.2, 0)]),
}


@pytest.mark.parametrize("suffix", [".toml", ".json"])
@pytest.mark.parametrize("name", SOURCES)
def test_a_source_that_was_written_is_read_back_equal(
    name: str, suffix: str, tmp_path: Path
) -> None:
    file = tmp_path / f"source{suffix}"
    pw.write_source(SOURCES[name], file)
    again = pw.read_source(file)
    assert again == SOURCES[name]
    if isinstance(again, pw.Array | pw.Wavefront):  # with phases of path lengths
        assert again.at_wavelength(0.2) == SOURCES[name].at_wavelength(0.2)
    assert type(again) is type(SOURCES[name])
    written = file.read_text()
    pw.write_source(again, file)
    assert file.read_text() == written


def lit(field: Any) -> dict[str, Any]:
    return {"kind": "aperture", "shape": {"name": "square", "a": "10 mm"}, "illumination": field}


def repeated(positions: Any, weights: Any = None) -> dict[str, Any]:
    element = {"kind": "aperture", "shape": {"name": "square", "a": 1e-4}}
    table = {"kind": "phased-array", "element": element, "positions": positions}
    return table if weights is None else {**table, "weights": weights, "frequency": "77 GHz"}


WIDE, SMALL = pw.shapes.square(0.01), pw.shapes.square(1e-4)
SLIT = {"kind": "slits", "intervals": [["-5 mm", "5 mm"]], "wavelength": "4 mm"}
ROW = arrays.grid_positions(8, 1, 3e-3)[:, 0]
TILES = [[[[0, 0], [1, 0], [1, 1], [0, 1]]], [[[1, 1], [1, 0], [2, 0], [2, 1]]]]
UNIT = np.eye(4, dtype=int).tolist()
STEERED = {"kind": "steering", "theta": "20 deg", "phi": "-60 deg", "frequency": "77 GHz"}
TOWARDS = (np.sin(np.pi / 9) * np.cos(np.pi / 3), -np.sin(np.pi / 9) * np.sin(np.pi / 3))
LATTICE = {"nx": 3, "ny": 2, "pitch_x": "1 mm"}
ELLIPTIC = {"radius": ["40 mm", "inf"], "centre": ["1 mm", 0]}


def illuminated(field: pw.Illumination) -> pw.Aperture:
    return WIDE.with_illumination(field)


# Tables of a file, and the source that the Python functions with the same names return.
VALID = [
    ({"kind": "aperture", "polygons": TILES}, pw.Aperture([[0, 0], [2, 0], [2, 1], [0, 1]])),
    ({"kind": "aperture", "polygons": [[[[0, 0], [0, 1], [1, 1], ["0.5 m", 0], [0, 0]]]]},
     pw.Aperture([[0, 0], [0.5, 0], [1, 1], [0, 1]])),
    ({"kind": "aperture", "shape": {"name": "disc", "radius": "2 mm", "n": 8}},
     pw.shapes.disc(2e-3, 8)),
    ({"kind": "slits", "shape": {"name": "slit_pair", "widths": ["1 mm", 2], "offsets": [0, 5]}},
     pw.shapes.slit_pair([1e-3, 2], [0, 5])),
    ({**lit({"kind": "uniform"}), "to_world": [[0, 0, 1, "2 mm"], [1, 0, 0, 0], [0, 1, 0, -1],
                                               [0, 0, 0, 1]]},
     illuminated(pw.uniform()).placed([[0, 0, 1, 2e-3], [1, 0, 0, 0], [0, 1, 0, -1],
                                       [0, 0, 0, 1]])),
    (lit({"kind": "steering", "theta": 0.25, "wavelength": "4 mm"}),
     illuminated(pw.steering((np.sin(0.25), 0.0), 4e-3))),
    (lit({"kind": "steering", "theta": "0 deg", "frequency": 77e9}),
     illuminated(pw.steering((0, 0, 1), WAVELENGTH))),
    (lit({"kind": "cosine_taper", "height": "6 mm", "power": 2}),
     illuminated(pw.cosine_taper(None, 6e-3, 2))),
    (lit({"kind": "taylor_taper", "width": 0.01, "height": "6 mm", "sll": "25 dB", "nbar": 5}),
     illuminated(pw.taylor_taper(0.01, 6e-3, sll=25, nbar=5))),
    (lit({"kind": "te_mode", "width": "10 mm", "height": "6 mm", "m": 2, "n": 1,
          "component": "x"}), illuminated(pw.te_mode(0.01, 6e-3, 2, 1, "x"))),
    (lit({"kind": "waves", "amplitudes": [1, [0, 2]], "frequencies": [[1, 2], [3, 4.5]]}),
     illuminated(pw.Illumination([1, 2j], [[1, 2], [3, 4.5]]))),
    (lit([{"kind": "te_mode", "width": "10 mm", "height": "6 mm"}, STEERED]),
     illuminated(pw.te_mode(0.01, 6e-3) * pw.steering(TOWARDS, WAVELENGTH))),
    ({**SLIT, "illumination": {"kind": "cosine_taper", "width": "10 mm"}},
     pw.Slits([-5e-3, 5e-3]).with_illumination(pw.cosine_taper(0.01, dimension=1))),
    ({**SLIT, "illumination": {"kind": "steering", "theta": "-90 deg"}},
     pw.Slits([-5e-3, 5e-3]).with_illumination(pw.steering(-1, 4e-3))),
    (repeated([["-1 mm", 0], [0.5, "2 mm"]], [1, [0, -1]]),
     pw.phased_array(SMALL, [[-1e-3, 0], [0.5, 2e-3]], [1, -1j])),
    (repeated({"kind": "triangular", **LATTICE}),
     pw.phased_array(SMALL, arrays.triangular_positions(3, 2, 1e-3))),
    (repeated({"kind": "rings", "radii": [0, "1 mm"], "counts": [1, 6]},
              {"kind": "focusing", "point": ["1 mm", 0, "60 mm"]}),
     pw.phased_array(SMALL, rings := arrays.ring_positions([0, 1e-3], [1, 6]),
                     arrays.focusing_weights(rings, (1e-3, 0, 60e-3), WAVELENGTH))),
    (repeated({"kind": "grid", **LATTICE, "pitch_y": "2 mm"},
              [{"kind": "window", "window": ["taylor", "hamming"], "sll": 25, "nbar": 3}, STEERED]),
     pw.phased_array(SMALL, grid := arrays.grid_positions(3, 2, 1e-3, 2e-3),
                     arrays.window_weights((3, 2), ("taylor", "hamming"), sll=25, nbar=3)
                     * arrays.steering_weights(grid, TOWARDS, WAVELENGTH))),
    ({"kind": "phased-array", "wavelength": "4 mm",
      "element": {"kind": "slits", "intervals": [[-1e-3, 1e-3]]},
      "positions": {"kind": "row", "count": 8, "pitch": "3 mm"},
      "weights": [{"kind": "window", "window": "chebyshev", "sll": "25 dB"},
                  {"kind": "steering", "theta": 0.2}]},
     pw.phased_array(pw.Slits([-1e-3, 1e-3]), ROW, arrays.window_weights(8, "chebyshev", sll=25)
                     * arrays.steering_weights(ROW, np.sin(0.2), 4e-3))),
    ({"kind": "aperture", "polygons": TILES[:1], "frequency": "77 GHz", "wavefront": ELLIPTIC},
     pw.shapes.square(1).moved((0.5, 0.5)).curved((0.04, np.inf), WAVELENGTH, (1e-3, 0))),
    ({"kind": "aperture", "polygons": TILES[:1],
      "wavefront": {"curvature": [[3, 1], [1, 4]], "coherence_width": "1 cm"}},
     pw.Wavefront(pw.shapes.square(1).moved((0.5, 0.5)), [[3, 1], [1, 4]], None, 0.01)),
]  # fmt: skip


def read_table(table: Any, folder: Path) -> Any:
    file = folder / "source.json"
    file.write_text(json.dumps(table))
    return pw.read_source(file)


@pytest.mark.parametrize(("table", "expected"), VALID)
def test_tables_call_the_functions_that_they_name(
    table: Any, expected: Any, tmp_path: Path
) -> None:
    assert read_table(table, tmp_path) == expected


def test_the_page_has_examples_that_are_sources_and_every_key(tmp_path: Path) -> None:
    page = (DOCS / "source_files.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    for number, block in enumerate(blocks):
        (tmp_path / f"{number}.toml").write_text(block)
    array, horn = (pw.read_source(tmp_path / f"{number}.toml") for number in range(2))
    # The beam points towards theta = 20 deg along y.
    nu = np.array([[0, 1], [0, -1], [1, 0]]) * np.sin(np.radians(20)) / WAVELENGTH
    beam = np.abs(pw.fourier(array, nu))
    assert beam[0] > 10 * beam[1:].max()
    steered = pw.steering((np.sin(np.radians(10)), 0.0), SPEED_OF_LIGHT / 94e9)
    x = np.random.default_rng(1).uniform(-4e-3, 4e-3, (20, 2))
    field = (pw.te_mode(12e-3, 9e-3) * steered)(x)
    assert horn.illumination(x) == pytest.approx(field, rel=1e-12)
    named = set(re.findall(r"`([a-z_-]+)`", page))
    tables = [source_files.Top, source_files.WavefrontTable, source_files.Paths]
    unions = [source_tables.FieldTable, source_tables.LayoutTable, source_tables.WeightTable]
    kinds: Any = source_files.SourceTable | unions[0] | unions[1] | unions[2]
    for kind in kinds.__args__:
        assert kind.__struct_config__.tag in named
        tables.append(kind)
    for table in tables:
        assert set(table.__struct_fields__) <= named, table
    assert set(SOURCE_TEXTS) <= named


def test_outlines_and_bodies_may_be_in_other_files(tmp_path: Path) -> None:
    (tmp_path / "outlines").mkdir()
    (tmp_path / "outlines" / "patch.wkt").write_text("POLYGON ((0 0, 3 0, 3 2, 0 0))")
    outline = {"kind": "aperture", "file": "outlines/patch.wkt", "unit": "cm"}
    triangle = pw.Aperture([[0, 0], [0.03, 0], [0.03, 0.02]])
    both = read_table({"kind": "array", "elements": [outline, outline]}, tmp_path)
    assert both == pw.Array([triangle, triangle])
    shapes = [f'<g id="{name}"><rect x="{x}" width="2" height="1"/></g>'
              for name, x in (("pad", 0), ("feed", 1), ("mark", 5))]  # fmt: skip
    (tmp_path / "antenna.svg").write_text(f"<svg>{''.join(shapes)}</svg>")
    drawn = {"kind": "aperture", "file": "antenna.svg", "union": True}
    tables = [drawn | {"layer": "pad"}, drawn | {"layer": ["pad", "feed"]}, drawn]
    areas = [1e6 * read_table(table, tmp_path).area for table in tables]
    assert areas == pytest.approx([2, 3, 5], rel=1e-12)


def test_a_source_names_files_below_its_own_folder_alone(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    inner = tmp_path / "source"
    (inner / "outlines").mkdir(parents=True)
    for folder in (tmp_path, inner / "outlines"):
        (folder / "a.wkt").write_text("POLYGON ((0 0, 1 0, 1 1, 0 0))")
    (inner / "link.wkt").symlink_to(tmp_path / "a.wkt")
    file = inner / "source.toml"
    for name in ("outlines/a.wkt", "outlines/../outlines/a.wkt"):
        file.write_text(f"kind = \"aperture\"\nfile = '{name}'\n")
        assert isinstance(pw.read_source(file), pw.Aperture)
    for name in (str(tmp_path / "a.wkt"), "link.wkt", "/etc/passwd", "../a.wkt"):
        file.write_text(f"kind = \"aperture\"\nfile = '{name}'\n")
        with pytest.raises(FileFormatError, match="in the folder of the source file or below"):
            pw.read_source(file)
    assert main(["transform", str(file), "--out", str(tmp_path / "out")]) == 2
    message = capfd.readouterr().err
    assert "--allow-outside" in message and "source.toml: file:" in message.replace("\n", "")
    assert isinstance(pw.read_source(file, allow_outside=True), pw.Aperture)


APERTURE = {"kind": "aperture", "shape": {"name": "square", "a": 1.0}}
PHASED = repeated([[0, 0], [2, 0]])
GRID_TABLE = {"kind": "grid", "nx": 2, "ny": 2, "pitch_x": 1}
CROSSED = [[0, 0], [3, 0], [1, 1], [2, 2], [1, 0]]

# Invalid tables, and parts of their error messages: path of the key, accepted values, and value.
BAD = [
    ([], "expected `object`, got `array`"),
    ({}, "missing required field `kind`"),
    ({"kind": "apertur"}, "kind: invalid value 'apertur'"),
    ({**APERTURE, "version": 2}, "version: expected `int` <= 1"),
    ({**APERTURE, "taper": 1}, "unknown field `taper`"),
    ({**APERTURE, "unit": "mm"}, "'unit' applies only to the key 'file'"),
    ({**APERTURE, "polygons": TILES}, "expected exactly one of | got polygons and shape"),
    ({**APERTURE, "frequency": 1, "wavelength": 1}, "got both"),
    ({"kind": "aperture", "file": "none.wkt"}, "file: | none.wkt: expected"),
    ({"kind": "aperture", "shape": {"name": "circlet"}}, "shape.name: invalid value 'circlet'"),
    ({"kind": "aperture", "shape": {"name": "disc", "radius": 1, "n": 8.0}}, "shape.n: | `int"),
    ({"kind": "aperture", "polygons": [[[[0, 0], [1, 0], [1, True]]]]}, "[0][0][2][1]: | got True"),
    ({"kind": "aperture", "polygons": [[CROSSED]]}, "polygons: | polygon 0"),
    ({"kind": "aperture", "polygons": [[[[0, 0], [1, 0], [2, 0]]]]}, "polygons: | area"),
    ({"kind": "aperture", "polygons": TILES[:1] * 2}, "polygons: | overlap"),
    ({"kind": "aperture", "polygons": [[]]}, "polygons[0]: | length >= 1"),
    ({**APERTURE, "to_world": [[2, 0, 0, 0], *UNIT[1:]]}, "to_world: | scales"),
    ({"kind": "slits", "shape": {"name": "square", "a": 1.0}}, "shape: | Slits, got Aperture"),
    ({"kind": "array", "elements": APERTURE}, "elements: expected `array`, got `object`"),
    ({"kind": "array", "elements": [APERTURE, PHASED]}, "elements[1].kind: | 'phased-array'"),
    ({**PHASED, "element": {**APERTURE, "to_world": UNIT}}, "to repeat, got PlacedAperture"),
    ({**PHASED, "positions": [[0, "1 GHz"]]}, "positions[0]: expected a length | '1 GHz'"),
    ({**PHASED, "positions": [0, 1]}, "positions of shape (n, 2)"),
    ({**PHASED, "positions": {"kind": "spiral"}}, "positions.kind: | 'spiral'"),
    ({**PHASED, "weights": {"kind": "window", "window": "taylor"}}, "row, grid or triangular"),
    (repeated(GRID_TABLE, {"kind": "window", "window": "taylor", "sll": "25 mm"}),
     "weights.sll: expected a level | '25 mm'"),
    ({**PHASED, "weights": [{"kind": "steering", "theta": 0.1, "wavelength": -1}]},
     "weights[0].wavelength: | got -1; the quantity must be above zero"),
    ({**PHASED, "weights": [1, {"kind": "steering", "theta": 1}]}, "weights[1]: | got `object`"),
    (lit({"kind": "cosine_taper", "widht": 1}), "illumination: | unknown field `widht`"),
    (lit([{"kind": "cosine_taper", "width": "1 GHz"}]), "illumination[0].width: | '1 GHz'"),
    (lit({"kind": "steering", "wavelength": 1}), "illumination: | missing required field `theta`"),
    (lit({"kind": "steering", "theta": 1}), "illumination: expected a frequency or a wavelength"),
    ({**APERTURE, "wavefront": {"radius": 1}}, "wavefront: expected a frequency or a wavelength"),
    ({**APERTURE, "wavefront": {"curvature": [[1]]}}, "wavefront: | symmetric matrix"),
    ({**APERTURE, "to_world": UNIT, "wavefront": {}}, "wavefront: | got PlacedAperture"),
    ({**APERTURE, "polarisation": []}, "polarisation: | length >= 1"),
    ({**APERTURE, "a\nb\x1b[31m": 1}, "unknown field `a b [31m`"),
]  # fmt: skip


@pytest.mark.parametrize(("table", "words"), BAD)
def test_errors_name_the_file_the_key_and_the_value(table: Any, words: str, tmp_path: Path) -> None:
    with pytest.raises(PolywignerError) as caught:
        read_table(table, tmp_path)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'source.json'}: ")
    for word in words.split(" | "):
        assert word in message
    assert "\n" not in message and len(message) < 600


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.toml", b"", "empty"),
        ("a.toml", b"kind = 'aperture", "invalid TOML"),
        ("a.toml", b"kind = 1\nkind = 2", "invalid TOML"),
        ("a.json", b"{'kind': 1}", "invalid JSON.*line 1 column 2"),
        ("a.json", b'{"kind": NaN}', "kind: .*`float`"),
        ("a.toml", b'kind = "slits"\nintervals = [[0, nan]]', "finite"),
        ("a.toml", b'kind = "slits"\nintervals = [[0, 1979-05-27]]', r"intervals: .*1979"),
        ("a.json", b'{"kind": "slits", "intervals": [[0, 1' + b"0" * 400 + b"]]}", "finite"),
        ("a.json", b"[" * 100_000, "invalid JSON"),
        ("a.yaml", b"kind: aperture", r".toml, .json, got '.yaml'"),
    ],
)
def test_text_that_is_no_source_is_refused(
    name: str, content: bytes, words: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(PolywignerError, match=words):
        pw.read_source(tmp_path / name)


def test_missing_files_and_libraries_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(FileFormatError, match="does not exist"):
        pw.read_source(tmp_path / "none.toml")
    with pytest.raises(ArgumentError, match="expected the path"):
        pw.read_source(None)  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "scipy.signal.windows", None)
    with pytest.raises(MissingExtraError, match=r"weights: .*polywigner\[arrays\]"):
        read_table(repeated(GRID_TABLE, {"kind": "window", "window": "taylor"}), tmp_path)


def test_a_file_is_replaced_as_a_whole_or_not_written_at_all(tmp_path: Path) -> None:
    (tmp_path / "taken.json").mkdir()
    (tmp_path / "taken.json" / "a.toml").touch()
    for source, name, error, words in (
        (SQUARE, "taken.json/a.toml/a.toml", ArgumentError, "cannot write"),
        (SQUARE, "taken.json", ArgumentError, "cannot write"),
        (SQUARE, "a.txt", FileFormatError, r"\.toml, \.json"),
        (3, "a.toml", ArgumentError, "got int"),
    ):
        with pytest.raises(error, match=words):
            pw.write_source(source, tmp_path / name)  # type: ignore[arg-type]
    assert [path.name for path in tmp_path.iterdir()] == ["taken.json"]
    file = tmp_path / "a.toml"
    pw.write_source(SOURCES["phased array"], file)
    assert pw.read_source(file) == SOURCES["phased array"]
    pw.write_source(SQUARE, file)
    assert pw.read_source(file) == SQUARE


H = np.sqrt(0.5)
ROW = pw.phased_array(SQUARE, GRID[:3] * 7)


@pytest.mark.parametrize("suffix", [".toml", ".json"])
@pytest.mark.parametrize(
    ("source", "polarisation", "jones"),
    [
        (TAPERED, "right", [H, 1j * H]),
        (TAPERED.curved(0.1, WAVELENGTH), (0.6j, 0.8), [0.6j, 0.8]),
        (ROW, ["x", "45 deg", "left"], [[1, 0], [H, H], [H, -1j * H]]),
        (ROW, (0.6j, 0.8), [0.6j, 0.8]),
        (pw.Array([SQUARE, HOLED], [1, 1j]), [(1, 0), (0, 1j)], [[1, 0], [0, 1j]]),
    ],
)
def test_a_polarisation_is_kept_next_to_the_source(
    tmp_path: Path, source: Any, polarisation: Any, jones: Any, suffix: str
) -> None:
    path = tmp_path / f"antenna{suffix}"
    pw.write_source(source, path, polarisation=polarisation)
    assert pw.read_source(path) == source
    assert pw.read_polarisation(path) == pytest.approx(np.array(jones), rel=1e-15)


def test_polarisations_by_hand_are_texts_or_numbers(tmp_path: Path) -> None:
    path = tmp_path / "antenna.json"
    for given, jones in (("45 deg", [H, H]), ([3, 4], [0.6, 0.8]), ([[1, 0], [0, 1]], [H, 1j * H])):
        path.write_text(json.dumps({**APERTURE, "polarisation": given}))
        assert pw.read_polarisation(path) == pytest.approx(np.array(jones))
    path.write_text(json.dumps(APERTURE))
    assert pw.read_polarisation(path) is None
