"""Input that cannot be used: exit code 2, one line that says what was expected, nothing written."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from polywigner.cli import main
from polywigner.errors import ArgumentError

Captured = pytest.CaptureFixture[str]

SQUARE = "POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))"
GEOJSON = '{{"type": "Polygon", "coordinates": [[{0}]]}}'

# name of the file (its suffix tells the format), its content (None: there is no file), and words
# that the message has to contain
BAD_APERTURES = {
    "missing file": ("absent.geojson", None, ["absent.geojson"]),
    "folder in place of a file": ("folder.wkt", "", ["folder.wkt"]),
    "empty file": ("empty.geojson", "", ["empty.geojson"]),
    "empty csv": ("empty.csv", "", ["empty.csv"]),
    "only white space": ("blank.wkt", " \n\n", ["blank.wkt"]),
    "malformed json": ("cut.geojson", '{"type": "Polygon", "coord', ["cut.geojson"]),
    "malformed wkt": ("cut.wkt", "POLYGON ((0 0, 1 0, 1", ["cut.wkt"]),
    "malformed csv": ("words.csv", "x,y\n0,0\n1,zero\n1,1\n", ["words.csv"]),
    "not text": ("noise.geojson", b"\x89PNG\r\n\x1a\n\x00\xff\xfe", ["noise.geojson"]),
    "unknown format": ("aperture.docx", "PK some words", ["aperture.docx"]),
    "geojson point": ("p.geojson", '{"type": "Point", "coordinates": [0, 0]}', ["Point"]),
    "wkt line": ("line.wkt", "LINESTRING (0 0, 1 0, 1 1)", ["LineString"]),
    "json but not geojson": ("list.geojson", "[1, 2, 3]", ["list.geojson"]),
    "nan": ("nan.csv", "0,0\nnan,0\n1,1\n", ["'nan'", "line 2"]),
    "infinity": ("inf.csv", "0,0\ninf,0\n1,1\n", ["'inf'", "line 2"]),
    "overflow to infinity": ("inf.geojson", GEOJSON.format("[0,0],[1e999,0],[1,1],[0,0]"), []),
    "json nan": ("nan.geojson", GEOJSON.format("[0,0],[NaN,0],[1,1],[0,0]"), []),
    "two vertices": ("two.csv", "0,0\n1,0\n", ["vert"]),
    "the same two again": ("two.geojson", GEOJSON.format("[0,0],[1,0],[0,0]"), []),
    "zero area": ("flat.csv", "0,0\n1,1\n2,2\n", ["area"]),
    "svg that is no xml": ("cut.svg", "<svg><path d=", ["cut.svg", "XML"]),
    "svg with entities": (
        "laughs.svg",
        '<!DOCTYPE svg [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><svg>&b;</svg>',
        ["laughs.svg", "entities"],
    ),
    "svg of strokes": ("lines.svg", '<svg><path d="M0 0h1v1" fill="none"/></svg>', ["fill"]),
    "svg with noise": ("noise.svg", bytes(range(256)), ["noise.svg"]),
    "dxf that is none": ("notes.dxf", "0\nhello\n", ["notes.dxf", "DXF"]),
    "dxf with a gap": (
        "gap.dxf",
        "0\nSECTION\n2\nENTITIES\n0\nLINE\n10\n0\n20\n0\n11\n1\n21\n1\n0\nENDSEC\n0\nEOF\n",
        ["gap.dxf", "meets no other"],
    ),
    "a mesh": ("box.stl", "solid box\nendsolid box\n", ["box.stl", "read_polyhedron"]),
    "self-crossing": ("bow.csv", "0,0\n2,2\n2,0\n0,2\n", ["cross", "1"]),
}


@pytest.fixture(params=BAD_APERTURES, ids=lambda name: name.replace(" ", "-"))
def bad_aperture(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, list[str]]:
    name, content, words = BAD_APERTURES[request.param]
    path = tmp_path / "input" / name
    path.parent.mkdir()
    if request.param.startswith("folder"):
        path.mkdir()
    elif isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        path.write_text(content)
    return path, words


def test_a_library_that_is_missing_is_named_with_its_extra(
    tmp_path: Path, capfd: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    path = tmp_path / "patch.dxf"
    path.write_text("0\nSECTION\n2\nENTITIES\n0\nENDSEC\n0\nEOF\n")
    line = refusal(["transform", str(path)], tmp_path / "out", capfd.readouterr)
    assert 'pip install ".[formats]"' in line


@pytest.fixture
def square(tmp_path: Path) -> Path:
    path = tmp_path / "square.wkt"
    path.write_text(SQUARE)
    return path


def refusal(arguments: list[str], out: Path, captured: Callable[[], object]) -> str:
    """The one line with which the command refuses; asserts all else that a refusal has to be."""
    captured()
    code = main([*arguments, "--out", f"{out}/new/"])
    stdout, stderr = captured()  # type: ignore[misc]
    assert code == 2, stderr
    assert stdout == ""
    assert stderr.startswith("polywigner: error: "), stderr
    assert stderr.count("\n") == 1, stderr
    assert "Traceback" not in stderr
    assert not out.exists()
    return stderr


def test_a_bad_aperture_file_is_refused(
    bad_aperture: tuple[Path, list[str]], tmp_path: Path, capfd: Captured
) -> None:
    path, words = bad_aperture
    line = refusal(["transform", str(path)], tmp_path / "out", capfd.readouterr)
    for word in words:
        assert word.lower() in line.lower()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--unit", "parsec"], ["unit", "parsec", "mm"]),
        (["--unit", "-1 mm"], ["unit", "-1 mm"]),
        (["--tolerance", "0 mm"], ["above zero", "0 mm"]),
        (["--tolerance", "coarse"], ["length", "coarse"]),
        (["--taper", "gauss"], ["taper: expected a taper", "gauss"]),
        (["--array", "12 by 16"], ["array: expected an array", "12 by 16"]),
        (["--array", "2 x 2, 12 mm", "--window", "boxcar"], ["window: expected one", "boxcar"]),
        (["--window", "hamming"], ["window: expected an array"]),
        (["--steering", "20 deg"], ["steering: expected a frequency or a wavelength"]),
        (["--steering", "20", "--frequency", "94 GHz"], ["steering: expected a direction", "90"]),
        (["--focus", "0, 0, 1", "--frequency", "94 GHz"], ["focus: expected an array"]),
        (["--frequency", "94 GHy"], ["94 GHy", "GHz"]),
        (["--frequency", "0 GHz"], ["above zero", "0 GHz"]),
        (["--frequency", "-94 GHz"], ["above zero", "-94 GHz"]),
        (["--frequency", "nan"], ["frequency", "nan"]),
        (["--wavelength", "0 mm"], ["above zero", "0 mm"]),
        (["--frequency", "94 GHz", "--wavelength", "3 mm"], ["both"]),
        (["--x", "1 mm"], ["two lengths", "1 mm"]),
        (["--x", "1 mm,2 furlong"], ["furlong"]),
        (["--x", "5,0"], ["inside the automean", "unit"]),
        (["--xi", "20 mm,0 mm"], ["overlaps"]),
        (["--samples", "1"], ["at least 2"]),
        (["--samples", "-3"], ["at least 2"]),
        (["--samples", "100000"], ["at most 4096", "100000"]),
        (["--db-floor", "0"], ["below 0 dB"]),
        (["--db-floor", "nan"], ["below 0 dB"]),
        (["--db-floor", "-1e308"], ["down to -300 dB", "-1e+308"]),
        (["--frequency", "1e-299 Hz"], ["wavelength", "GHz", "aperture"]),
        (["--frequency", "1e-320"], ["finite frequency above 1e-300 Hz"]),
        (["--wavelength", "1e-299 m"], ["wavelength", "mm", "aperture"]),
    ],
)
def test_a_bad_option_of_transform_is_refused(
    options: list[str], words: list[str], square: Path, tmp_path: Path, capfd: Captured
) -> None:
    line = refusal(["transform", str(square), *options], tmp_path / "out", capfd.readouterr)
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("name", "text", "options", "words"),
    [
        ("a.toml", "kind = 'apertur'", [], ["a.toml", "kind"]),
        ("a.toml", "kind = ", [], ["a.toml", "TOML"]),
        ("a.json", '{"kind": "aperture"}', [], ["a.json", "polygons"]),
        ("a.toml", "kind = 'slits'\nintervals = [[0, 1]]", [], ["an aperture", "Slits"]),
        ("a.toml", "kind = 'slits'\nintervals = [[0, 1]]", ["--taper", "cosine"], ["Slits"]),
        ("a.toml", "kind = 'aperture'\nshape = {name = 'square', a = 1}", ["--unit", "mm"],
         ["no --unit with a source file"]),
    ],
)  # fmt: skip
def test_a_bad_source_file_is_refused(
    name: str, text: str, options: list[str], words: list[str], tmp_path: Path, capfd: Captured
) -> None:
    (tmp_path / name).write_text(text)
    arguments = ["transform", str(tmp_path / name), *options]
    line = refusal(arguments, tmp_path / "out", capfd.readouterr)
    for word in words:
        assert word in line


@pytest.mark.parametrize("name", ["", ".", "/", "absent", "a" * 300, "\udcff.wkt"], ids=ascii)
@pytest.mark.parametrize("command", ["transform", "render"])
def test_what_is_no_name_of_a_file_is_refused(
    command: str, name: str, tmp_path: Path, capfd: Captured
) -> None:
    line = refusal([command, name], tmp_path / "out", capfd.readouterr)
    assert "file" in line


UNUSABLE = {
    "empty": ("", "got nothing"),
    "suffix alone": ("{0}/out/.PNG", "suffix alone"),
    "long name": ("{0}/out/" + "a" * 300, "too long"),
    "long folder": ("{0}/out/" + "a" * 300 + "/a", "too long"),
    "long path": ("{0}/out/" + "a/" * 4000, "too long"),
    "file as folder": ("{0}/square.wkt/a", "square.wkt"),
    "not UTF-8": ("{0}/out/\udcff", "UTF-8"),
}


@pytest.mark.parametrize("command", ["transform", "render"])
@pytest.mark.parametrize("case", UNUSABLE)
def test_a_place_that_cannot_be_written_to_is_refused_before_the_work(
    case: str, command: str, square: Path, tmp_path: Path, capfd: Captured
) -> None:
    out, words = UNUSABLE[case]
    given = square if command == "transform" else square.rename(tmp_path / "square.xml")
    out = out.replace("square.wkt", given.name)
    assert main([command, str(given), "--out", out.format(tmp_path)]) == 2
    stdout, stderr = capfd.readouterr()
    assert stdout == ""
    assert stderr.startswith("polywigner: error: ")
    assert stderr.count("\n") == 1
    assert words.replace("square.wkt", given.name) in stderr
    assert list(tmp_path.iterdir()) == [given]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that refuses even root")
def test_a_folder_that_only_seems_writable_is_refused(square: Path, capfd: Captured) -> None:
    assert main(["transform", str(square), "--out", "/proc/polywigner"]) == 2
    assert "can be written to" in capfd.readouterr().err


SCENE = """<scene version="3.0.0">
    <integrator type="path"/>
    <sensor type="perspective">
        <film type="hdrfilm">
            <integer name="width" value="4"/>
            <integer name="height" value="4"/>
        </film>
        <sampler type="independent"><integer name="sample_count" value="1"/></sampler>
    </sensor>
    {shape}
    <shape type="rectangle"/>
</scene>
"""
WIGNER = """<shape type="wigner">
    <string name="aperture" value="square.wkt"/>
    <string name="frequency" value="94 GHz"/>
</shape>"""

# what replaces what in WIGNER, and words that the message has to contain
BAD_SHAPES = {
    "no emitter": (WIGNER, "", ["wigner", "without"]),
    "another emitter only": (WIGNER, '<emitter type="constant"/>', ["wigner", "without"]),
    "unknown parameter": ("</shape>", '<float name="colour" value="1"/></shape>', ["colour"]),
    "missing aperture file": ("square.wkt", "absent.wkt", ["absent.wkt"]),
    "self-crossing aperture": ("square.wkt", "bow.csv", ["cross"]),
    "bad unit": ("</shape>", '<string name="unit" value="parsec"/></shape>', ["parsec"]),
    "zero frequency": ("94 GHz", "0 GHz", ["above zero"]),
    "negative frequency": ("94 GHz", "-94 GHz", ["above zero"]),
    "no frequency": ('<string name="frequency" value="94 GHz"/>', "", ["frequency", "neither"]),
    "both": ("</shape>", '<string name="wavelength" value="3 mm"/></shape>', ["both"]),
    "unknown obliquity": (
        "</shape>",
        '<string name="obliquity" value="fraunhofer"/></shape>',
        ["obliquity", "fraunhofer", "kirchhoff"],
    ),
    "scaled pose": (
        "</shape>",
        '<transform name="to_world"><scale value="2"/></transform></shape>',
        ["to_world", "scale"],
    ),
    "unknown plugin": ("wigner", "winger", ["winger"]),
}


def write_scene(folder: Path, shape: str) -> Path:
    (folder / "square.wkt").write_text(SQUARE)
    (folder / "bow.csv").write_text("0,0\n2,2\n2,0\n0,2\n")
    path = folder / "scene.xml"
    path.write_text(SCENE.format(shape=shape))
    return path


@pytest.mark.drjit
@pytest.mark.parametrize("case", BAD_SHAPES)
def test_a_bad_scene_is_refused(case: str, tmp_path: Path, capfd: Captured) -> None:
    old, new, words = BAD_SHAPES[case]
    path = write_scene(tmp_path, WIGNER.replace(old, new))
    line = refusal(
        ["render", str(path), "--variant", "scalar_rgb"], tmp_path / "out", capfd.readouterr
    )
    for word in words:
        assert word in line


@pytest.mark.drjit
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, ["scene.xml"]),
        ("", ["scene"]),
        ("<scene version='3.0.0'><shape", ["scene"]),
        ("this is no XML", ["scene"]),
        ("<shape type='sphere' version='3.0.0'/>", ["<scene>"]),
        ("<scene version='3.0.0'><shape type='sphere'/></scene>", ["wigner"]),
    ],
    ids=["missing", "empty", "cut", "text", "no-scene", "no-emitter"],
)
def test_a_file_that_is_no_scene_is_refused(
    content: str | None, words: list[str], tmp_path: Path, capfd: Captured
) -> None:
    path = tmp_path / "scene.xml"
    if content is not None:
        path.write_text(content)
    line = refusal(
        ["render", str(path), "--variant", "scalar_rgb"], tmp_path / "out", capfd.readouterr
    )
    for word in words:
        assert word in line


BRIGHTER_THAN_SINGLE_PRECISION = """<emitter type="constant"><rgb name="radiance" value="3e38"/>
</emitter>
<shape type="rectangle"><transform name="to_world"><translate z="1"/></transform></shape>
"""

# a pattern in SCENE, what replaces it, and words that the message has to contain
BAD_SURROUNDINGS = {
    "no sensor": ("(?s)<sensor.*</sensor>", "", ["<sensor>", "without"]),
    "no pixels": ('(?<="width" value=)"4"', '"0"', ["0 x 4", "one pixel"]),
    "infinite": ("</sensor>", r"\g<0>" + BRIGHTER_THAN_SINGLE_PRECISION, ["pixels", "finite"]),
}


@pytest.mark.drjit
@pytest.mark.parametrize("case", BAD_SURROUNDINGS)
def test_a_scene_that_makes_no_picture_is_refused(
    case: str, tmp_path: Path, capfd: Captured
) -> None:
    pattern, new, words = BAD_SURROUNDINGS[case]
    path = write_scene(tmp_path, WIGNER)
    path.write_text(re.sub(pattern, new, path.read_text()).replace("perspective", "orthographic"))
    line = refusal(
        ["render", str(path), "--variant", "scalar_rgb"], tmp_path / "out", capfd.readouterr
    )
    for word in words:
        assert word in line


@pytest.mark.drjit
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--spp", "0"], ["at least 1", "0"]),
        (["--spp", "99999999999999999999"], ["at most", "99999999999999999999"]),
        (["--spp", "-4"], ["at least 1", "-4"]),
        (["--seed", "-1"], ["--seed", "-1"]),
        (["--variant", "llvm_mono_ad"], ["variant", "llvm_mono_ad", "scalar_rgb"]),
        (["--integrator", "pathfinder"], ["--integrator", "pathfinder", "volpath"]),
        (["--sampler", "dice"], ["--sampler", "dice", "multijitter"]),
        (["--db-floor", "40"], ["below 0 dB"]),
    ],
)
def test_a_bad_option_of_render_is_refused(
    options: list[str], words: list[str], tmp_path: Path, capfd: Captured
) -> None:
    path = write_scene(tmp_path, WIGNER)
    line = refusal(["render", str(path), *options], tmp_path / "out", capfd.readouterr)
    for word in words:
        assert word in line


@pytest.mark.parametrize("components", [1, 4])
@pytest.mark.parametrize("function", [pw.fourier, pw.wigner, pw.ambiguity])
def test_frequencies_with_the_wrong_number_of_components_are_refused(
    function: Callable[..., object], components: int
) -> None:
    square = pw.shapes.square(1.0)
    wrong, right = np.zeros((4, components)), np.zeros(2)
    arguments = {
        pw.fourier: (square, wrong),
        pw.wigner: (square, right, wrong),
        pw.ambiguity: (square, wrong, right),
    }[function]
    with pytest.raises(ArgumentError, match=rf"2.*got.*{components}"):
        function(*arguments)


@pytest.mark.parametrize(("name", "kind"), [("radar.csv", "an aperture"), ("a.toml", "a source")])
def test_an_aperture_is_not_rendered_but_sent_to_transform(
    name: str, kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_text("0,0\n1,0\n1,1\n")
    assert main(["render", str(path), "--out", str(tmp_path / "new" / "image")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"which is {kind}" in line
    assert f"polywigner transform {path}" in line
    assert [file.name for file in tmp_path.iterdir()] == [name]
