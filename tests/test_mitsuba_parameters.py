"""Parameters of the ``wigner`` shape, from XML and from dictionaries, good and bad."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from mitsuba_scenes import MONO, SQUARE, WAVELENGTH, light, pose, use
from polywigner.errors import EngineError, PolywignerError, SceneError

pytestmark = pytest.mark.drjit

WKT = "POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))"
GOOD = (
    '<string name="aperture" value="patch.wkt"/><string name="unit" value="mm"/>'
    '<string name="frequency" value="94 GHz"/>'
)


def write_scene(folder: Path, inside: str, name: str = "scene.xml") -> Path:
    (folder / "patch.wkt").write_text(WKT)
    file = folder / name
    shape = f'<shape type="wigner" id="aperture">{inside}</shape>'
    file.write_text(f'<scene version="3.0.0"><integrator type="path"/>{shape}</scene>')
    return file


def load(folder: Path, inside: str) -> Any:
    import polywigner.mitsuba as pwm

    return pwm.load_scene(write_scene(folder, inside), "scalar_rgb").emitters()[0].spec


def test_a_file_is_found_beside_the_scene_and_read_in_its_unit(tmp_path: Path) -> None:
    spec = load(tmp_path, GOOD)
    assert spec.source == SQUARE
    assert spec.wavelength == pytest.approx(WAVELENGTH, rel=1e-15)
    assert spec.power == pytest.approx(pw.radiated_power(SQUARE, WAVELENGTH), rel=1e-12)


@pytest.mark.parametrize("obliquity", ["rayleigh-sommerfeld-1", "paper"])
def test_of_an_aperture_power_the_share_that_the_obliquity_radiates_counts(
    tmp_path: Path, obliquity: str
) -> None:
    inside = f'{GOOD}<string name="obliquity" value="{obliquity}"/>'
    spec = load(tmp_path, inside + '<string name="aperture_power" value="10 dBm"/>')
    share = pw.radiated_power(SQUARE, WAVELENGTH, obliquity=obliquity) / SQUARE.area
    assert spec.power == pytest.approx(0.01 * share, rel=1e-9)


@pytest.mark.parametrize(
    ("tolerance", "vertices"),
    [("", 52), ('<string name="tolerance" value="1 um"/>', 136),
     ('<float name="tolerance" value="1e-6"/>', 136)],
)  # fmt: skip
def test_a_drawing_is_read_as_finely_as_asked(
    tmp_path: Path, tolerance: str, vertices: int
) -> None:
    (tmp_path / "disc.svg").write_text('<svg viewBox="0 0 10 10"><circle r="5"/></svg>')
    spec = load(tmp_path, GOOD.replace("patch.wkt", "disc.svg") + tolerance)
    assert len(spec.source.rings[0]) == vertices
    assert spec.source.area == pytest.approx(np.pi * 25e-6, rel=1e-12)


def test_layers_of_a_drawing_are_read_and_joined_as_asked(tmp_path: Path) -> None:
    shapes = [f'<g id="{name}"><rect x="{x}" width="2" height="1"/></g>'
              for name, x in (("pad", 0), ("feed", 1), ("mark", 5))]  # fmt: skip
    (tmp_path / "antenna.svg").write_text(f"<svg>{''.join(shapes)}</svg>")
    inside = GOOD.replace("patch.wkt", "antenna.svg")
    layers = '<string name="layer" value="pad; feed"/><boolean name="union" value="true"/>'
    assert load(tmp_path, inside + layers).source.area == pytest.approx(3e-6, rel=1e-12, abs=0.0)


@pytest.mark.parametrize(
    ("parameter", "name", "value"),
    [
        ('<float name="frequency" value="94e9"/>', "wavelength", WAVELENGTH),
        ('<string name="wavelength" value="3.19 mm"/>', "wavelength", 3.19e-3),
        ('<float name="wavelength" value="0.00319"/>', "wavelength", 3.19e-3),
    ],
)
def test_frequency_and_wavelength_are_texts_or_si_numbers(
    tmp_path: Path, parameter: str, name: str, value: float
) -> None:
    spec = load(tmp_path, f'<string name="aperture" value="patch.wkt"/>{parameter}')
    assert getattr(spec, name) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("parameter", "name", "value"),
    [
        ('<string name="power" value="10 mW"/>', "power", 1e-2),
        ('<float name="power" value="2.5"/>', "power", 2.5),
        ('<integer name="power" value="2"/>', "power", 2.0),
        ('<string name="obliquity" value="kirchhoff"/>', "obliquity", "kirchhoff"),
        ('<string name="scene_unit" value="mm"/>', "scene_unit", 1e-3),
        ('<string name="scene_unit" value="0.1 m"/>', "scene_unit", 0.1),
        ('<float name="sampling_weight" value="3"/>', "sampling_weight", 3.0),
        ('<boolean name="visible" value="false"/>', "visible", False),
    ],
)
def test_optional_parameters(tmp_path: Path, parameter: str, name: str, value: Any) -> None:
    assert getattr(load(tmp_path, GOOD + parameter), name) == value


@pytest.mark.parametrize(
    ("inside", "fragments"),
    [
        (GOOD + '<string name="colour" value="red"/>', ["parameters aperture, unit", "'colour'"]),
        (GOOD + '<float name="wavelength" value="0.003"/>', ["both", "give one"]),
        ('<string name="aperture" value="patch.wkt"/>', ["neither", "give one"]),
        ('<string name="frequency" value="94 GHz"/>', ["'aperture'", "none"]),
        (GOOD.replace("94 GHz", "94 GHx"), ["frequency", "94 GHx"]),
        (GOOD.replace("94 GHz", "-94 GHz"), ["frequency above zero", "-94 GHz"]),
        (GOOD.replace("94 GHz", "0"), ["frequency above zero"]),
        (GOOD.replace('value="mm"', 'value="furlong"'), ["furlong"]),
        (GOOD.replace("patch.wkt", "none.wkt"), ["none.wkt"]),
        (GOOD.replace("patch.wkt", "memory:123"), ["expected no unit"]),
        (GOOD + '<string name="power" value="much"/>', ["power", "much"]),
        (GOOD + '<float name="power" value="-1"/>', ["power above zero"]),
        (GOOD + '<string name="aperture_power" value="10 dB"/>', ["aperture_power", "dBm"]),
        (
            GOOD + '<float name="power" value="1"/><float name="aperture_power" value="1"/>',
            ["power or aperture_power", "both", "hemisphere"],
        ),
        (GOOD + '<float name="radiated_power" value="1"/>', ["power, aperture_power", "'radiated"]),
        (GOOD + '<float name="power" value="1e300"/>', ["a power that single", "check its unit"]),
        (GOOD.replace("94 GHz", "1e200 Hz"), ["wavelength that single precision", "2.99792e-192"]),
        (GOOD.replace("94 GHz", "1e-20 Hz"), ["that radiates", "2.99792e+28", "check the unit"]),
        (GOOD + '<boolean name="power" value="true"/>', ["number or a text as power", "bool"]),
        (GOOD + '<float name="obliquity" value="1"/>', ['<string name="obliquity"', "float"]),
        (GOOD + '<string name="obliquity" value="rs1"/>', ["obliquity", "'rs1'", "kirchhoff"]),
        (GOOD + '<float name="sampling_weight" value="-1"/>', ["sampling_weight"]),
        (GOOD + '<string name="antithetic" value="yes"/>', ['<boolean name="antithetic"', "str"]),
        (GOOD + '<string name="visible" value="no"/>', ['<boolean name="visible"', "str"]),
        (GOOD + '<emitter type="area"/>', ["no emitter inside", "brings its own"]),
        (
            GOOD + '<transform name="to_world"><scale value="2"/></transform>',
            ["rotations and translations only", "scales by 2, 2, 2", "scale the aperture itself"],
        ),
        (
            GOOD + '<transform name="to_world"><scale x="-1"/></transform>',
            ["mirror"],
        ),
        (
            GOOD.replace("patch.wkt", "memory:0123"). replace(
                '<string name="unit" value="mm"/>', ""
            ),
            ["key of a source", "polywigner.mitsuba.aperture"],
        ),
    ],
)  # fmt: skip
def test_a_bad_parameter_is_one_line_that_says_where(
    tmp_path: Path, inside: str, fragments: list[str]
) -> None:
    with pytest.raises(PolywignerError) as caught:
        load(tmp_path, inside)
    message = str(caught.value)
    assert "\n" not in message
    assert "Traceback" not in message
    assert message.startswith(f"{tmp_path / 'scene.xml'} (line 1")
    for fragment in fragments:
        assert fragment in message


def test_the_message_is_in_what_mitsuba_itself_raises(tmp_path: Path) -> None:
    mi = use("scalar_rgb")
    file = write_scene(tmp_path, GOOD + '<string name="colour" value="red"/>')
    with pytest.raises(RuntimeError, match=r"expected the parameters aperture, unit.*'colour'"):
        mi.load_file(str(file))


@pytest.mark.parametrize(
    "text",
    [
        "<scene",
        '<scene version="3.0.0"><shape type="no_such_plugin"/></scene>',
        '<bsdf version="3.0.0" type="diffuse"/>',
    ],
)
def test_a_scene_that_mitsuba_cannot_load_is_one_line(tmp_path: Path, text: str) -> None:
    import polywigner.mitsuba as pwm

    file = tmp_path / "scene.xml"
    file.write_text(text)
    with pytest.raises(SceneError, match=r"expected a .*scene") as caught:
        pwm.load_scene(file, "scalar_rgb")
    assert "\n" not in str(caught.value)


def test_a_missing_scene_and_an_unknown_variant_are_refused(tmp_path: Path) -> None:
    import polywigner.mitsuba as pwm

    with pytest.raises(SceneError, match="not a file"):
        pwm.load_scene(tmp_path / "none.xml", "scalar_rgb")
    with pytest.raises(EngineError, match="expected a variant"):
        pwm.load_scene(write_scene(tmp_path, GOOD), "scalar_mono")


def test_a_scene_without_the_emitter_is_told_from_one_with_it(tmp_path: Path) -> None:
    import polywigner.mitsuba as pwm

    assert pwm.has_wigner_emitter(pwm.load_scene(write_scene(tmp_path, GOOD), "scalar_rgb"))
    bare = tmp_path / "bare.xml"
    bare.write_text('<scene version="3.0.0"><emitter type="constant"/></scene>')
    assert not pwm.has_wigner_emitter(pwm.load_scene(bare, "scalar_rgb"))


def test_a_sampler_given_at_loading_replaces_those_of_the_scene(tmp_path: Path) -> None:
    import polywigner.mitsuba as pwm

    file = tmp_path / "scene.xml"
    film = '<film type="hdrfilm"/>'
    own = '<sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>'
    sensors = f'<sensor type="perspective">{film}</sensor><sensor type="perspective">{film}{own}'
    file.write_text(
        f'<scene version="3.0.0"><default name="spp" value="9"/>{sensors}</sensor></scene>'
    )
    scene = pwm.load_scene(file, "scalar_rgb", sampler="stratified", spp=25)
    assert [s.sampler().class_name() for s in scene.sensors()] == ["StratifiedSampler"] * 2
    assert scene.sensors()[1].sampler().sample_count() == 25


SPACING, SIDE = 12e-3, 10e-3
GRID = pw.arrays.grid_positions(3, 4, SPACING)
THETA, PHI = np.radians([20, 90])
TILTED = np.array([np.sin(THETA) * np.cos(PHI), np.sin(THETA) * np.sin(PHI), np.cos(THETA)])
COSINE = SQUARE.with_illumination(pw.cosine_taper(SIDE, SIDE))


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        ({"taper": "cosine"}, COSINE),
        (
            {"taper": "Cosine 2 y"},
            SQUARE.with_illumination(pw.cosine_taper(None, SIDE, power=2)),
        ),
        ({"taper": "te10"}, SQUARE.with_illumination(pw.te_mode(SIDE, SIDE))),
        (
            {"taper": "te02"},
            SQUARE.with_illumination(pw.te_mode(SIDE, SIDE, 0, 2, component="x")),
        ),
        ({"taper": "taylor"}, SQUARE.with_illumination(pw.taylor_taper(SIDE, SIDE))),
        (
            {"taper": "taylor 40 dB 7 x"},
            SQUARE.with_illumination(pw.taylor_taper(SIDE, sll=40, nbar=7)),
        ),
        (
            {"steering": "20 deg, 90 deg"},
            SQUARE.with_illumination(pw.steering(TILTED, WAVELENGTH)),
        ),
        (
            {"taper": "cosine", "steering": "20 deg, 90 deg"},
            SQUARE.with_illumination(pw.cosine_taper(SIDE, SIDE) * pw.steering(TILTED, WAVELENGTH)),
        ),
        ({"array": "3 x 4, 12 mm"}, pw.phased_array(SQUARE, GRID)),
        (
            {"array": "3x4,12 mm,13 mm", "taper": "cosine"},
            pw.phased_array(COSINE, pw.arrays.grid_positions(3, 4, SPACING, 13e-3)),
        ),
        (
            {"array": "triangular 3 x 4, 12 mm"},
            pw.phased_array(SQUARE, pw.arrays.triangular_positions(3, 4, SPACING)),
        ),
        (
            {"array": "3 x 4, 12 mm", "window": "hamming"},
            pw.phased_array(SQUARE, GRID, pw.arrays.window_weights((3, 4), "hamming")),
        ),
        (
            {"array": "3 x 4, 12 mm", "window": "taylor 25 dB 3", "steering": "20 deg, 90 deg"},
            pw.phased_array(
                SQUARE,
                GRID,
                pw.arrays.window_weights((3, 4), "taylor", sll=25, nbar=3)
                * pw.arrays.steering_weights(GRID, TILTED, WAVELENGTH),
            ),
        ),
        (
            {"array": "3 x 4, 12 mm", "focus": "1 mm, -2 mm, 8 cm"},
            pw.phased_array(
                SQUARE,
                GRID,
                pw.arrays.focusing_weights(GRID, (1e-3, -2e-3, 0.08), WAVELENGTH),
            ),
        ),
    ],
    ids=str,
)
def test_texts_say_what_the_functions_of_python_do(
    tmp_path: Path, texts: dict[str, str], expected: pw.Aperture | pw.Array
) -> None:
    inside = "".join(f'<string name="{key}" value="{text}"/>' for key, text in texts.items())
    assert load(tmp_path, GOOD + inside).source == expected


@pytest.mark.parametrize(
    ("texts", "fragments"),
    [
        ({"taper": "gauss"}, ["taper: expected a taper such as", '"te10"', "'gauss'"]),
        ({"taper": "cosine 2 z"}, ["taper: expected a taper", "'cosine 2 z'"]),
        ({"taper": "cosine 99"}, ["taper: expected", "99"]),
        ({"taper": "te00"}, ["taper: expected", "TE_00"]),
        ({"taper": "te10 x"}, ["taper: expected a mode without an axis"]),
        ({"taper": "taylor 30"}, ["taper: expected a taper", "'taylor 30'"]),
        ({"taper": "taylor 300 dB"}, ["taper: expected sll", "300"]),
        ({"taper": "cosine" + " " * 200}, ["taper: expected a taper"]),
        ({"array": "12"}, ['array: expected an array such as "12 x 16, 2 mm"', "'12'"]),
        ({"array": "3 x 4"}, ["array: expected an array", "'3 x 4'"]),
        ({"array": "3 x 4, 1 mm, 1 mm, 1 mm"}, ["array: expected an array"]),
        ({"array": "3 x 4, 2 furlong"}, ["array: expected a length", "furlong"]),
        ({"array": "3 x 4, -2 mm"}, ["array: expected a length above zero"]),
        ({"array": "0 x 4, 2 mm"}, ["array: expected", "0"]),
        ({"array": "9999 x 9999, 2 mm"}, ["array: expected at most 1048576 elements"]),
        ({"array": "3 x 4, 2 mm", "window": "boxcar"}, ["window: expected one of", "'boxcar'"]),
        ({"array": "3 x 4, 2 mm", "window": "taylor 25"}, ["window: expected a window"]),
        ({"window": "hamming"}, ["window: expected an array for it, got none"]),
        ({"steering": "20 GHz"}, ["steering: expected a", "20 GHz"]),
        ({"steering": "20"}, ["within 90 deg of the normal", "with their unit"]),
        ({"steering": "1 deg, 2 deg, 3 deg"}, ["steering: expected a direction such as"]),
        ({"steering": "120 deg"}, ["steering: expected a direction within 90 deg", "120"]),
        ({"focus": "0 mm, 0 mm, 8 cm"}, ["focus: expected an array to focus"]),
        ({"array": "3 x 4, 2 mm", "focus": "8 cm"}, ["focus: expected three lengths"]),
        ({"array": "3 x 4, 2 mm", "focus": "0, 0, 0"}, ["focus: expected a point", "above zero"]),
        ({"source": "array.toml"}, ["got both"]),
    ],
    ids=str,
)  # fmt: skip
def test_a_text_that_says_nothing_is_one_line_that_names_it(
    tmp_path: Path, texts: dict[str, str], fragments: list[str]
) -> None:
    inside = "".join(f'<string name="{key}" value="{text}"/>' for key, text in texts.items())
    with pytest.raises(PolywignerError) as caught:
        load(tmp_path, GOOD + inside)
    message = str(caught.value)
    assert "\n" not in message and "Traceback" not in message
    for fragment in fragments:
        assert fragment in message


def test_a_source_file_is_what_was_written(tmp_path: Path) -> None:
    array = pw.phased_array(COSINE, GRID, pw.arrays.steering_weights(GRID, TILTED, WAVELENGTH))
    for name in ("array.toml", "array.json"):
        pw.write_source(array, tmp_path / name)
        inside = f'<string name="source" value="{name}"/><string name="frequency" value="94 GHz"/>'
        spec = load(tmp_path, inside)
        assert spec.source == array
        assert spec.power == pytest.approx(pw.radiated_power(array, WAVELENGTH), rel=1e-12)


@pytest.mark.parametrize(
    ("inside", "fragments"),
    [
        ('<string name="unit" value="mm"/>', ["no unit with a source file"]),
        ('<string name="layer" value="pads"/>', ["no layer with a source file"]),
        ('<string name="taper" value="cosine"/>', ["taper: expected an aperture", "Array"]),
        ('<string name="array" value="2 x 2, 1 mm"/>', ["array: expected an aperture", "Array"]),
        ('<string name="window" value="hamming"/>', ["window: expected an array for it"]),
    ],
)
def test_what_a_source_file_says_itself_is_not_said_again(
    tmp_path: Path, inside: str, fragments: list[str]
) -> None:
    pw.write_source(pw.phased_array(SQUARE, GRID), tmp_path / "array.toml")
    given = '<string name="source" value="array.toml"/><string name="frequency" value="94 GHz"/>'
    with pytest.raises(PolywignerError) as caught:
        load(tmp_path, given + inside)
    for fragment in fragments:
        assert fragment in str(caught.value)


def test_a_phased_array_of_a_file_is_steered_by_the_scene(tmp_path: Path) -> None:
    pw.write_source(pw.phased_array(SQUARE, GRID), tmp_path / "array.toml")
    inside = (
        '<string name="source" value="array.toml"/><string name="frequency" value="94 GHz"/>'
        '<string name="steering" value="20 deg, 90 deg"/>'
    )
    weights = pw.arrays.steering_weights(GRID, TILTED, WAVELENGTH)
    assert load(tmp_path, inside).source == pw.phased_array(SQUARE, GRID, weights)


@pytest.mark.parametrize(
    ("text", "fragments"),
    [
        ("kind = 'apertur'", ["source.toml", "kind"]),
        ("kind = ", ["source.toml", "TOML"]),
        ("kind = 'slits'\nintervals = [[0, 1]]", ["got Slits", "rectangles"]),
        (None, ["source.toml", "does not exist"]),
    ],
)
def test_a_bad_source_file_is_one_line(
    tmp_path: Path, text: str | None, fragments: list[str]
) -> None:
    if text is not None:
        (tmp_path / "source.toml").write_text(text)
    given = '<string name="source" value="source.toml"/><string name="frequency" value="94 GHz"/>'
    with pytest.raises(PolywignerError) as caught:
        load(tmp_path, given)
    assert "\n" not in str(caught.value)
    for fragment in fragments:
        assert fragment in str(caught.value)


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
def test_an_array_moves_with_its_mesh_and_keeps_its_place(variant: str) -> None:
    mi = use(variant)
    import polywigner.mitsuba as pwm

    array = pw.phased_array(SQUARE, GRID + np.array([0.5, -0.3]))
    entry = pwm.aperture(array, WAVELENGTH, to_world=pose((1.0, 2.0, 3.0)))
    scene = mi.load_dict({"type": "scene", "aperture": entry})
    params = mi.traverse(scene)
    for place in ((1.0, 2.0, 3.0), (-4.0, 0.0, 2.0)):
        params["aperture.emitter.to_world"] = mi.Transform4f(mi.ScalarTransform4f(pose(place)))
        params.update()
        corners = np.array(params["aperture.vertex_positions"], dtype=float).reshape(-1, 3)
        assert np.allclose(corners.mean(axis=0), np.add(place, (0.5, -0.3, 0.0)), atol=1e-6)
        ps, _ = scene.emitters()[0].sample_position(0.0, mi.Point2f(0.5, 0.5), True)
        middle = np.array(ps.p, dtype=float).ravel()
        assert np.allclose(middle, np.add(place, (0.5, -0.3, 0.0)), atol=1e-6)


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
def test_a_dictionary_entry_carries_all_parameters(variant: str) -> None:
    mi = use(variant)
    import polywigner.mitsuba as pwm

    placed = pose((1.0, 2.0, 3.0), about_x=0.5)
    entry = pwm.aperture(
        SQUARE, WAVELENGTH, to_world=placed, obliquity="paper", power=2.0, bsdf={"type": "diffuse"}
    )
    scene = mi.load_dict({"type": "scene", "aperture": entry})
    spec = scene.emitters()[0].spec
    assert (spec.source, spec.wavelength, spec.obliquity) == (SQUARE, WAVELENGTH, "paper")
    assert spec.power == 2.0
    assert np.allclose(spec.pose, placed, atol=1e-7)
    assert "Diffuse" in str(scene.shapes()[0].bsdf())


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        ({"wavelength": -1.0}, "above zero"),
        ({"wavelength": float("nan")}, "finite"),
        ({"wavelength": 1.0, "obliquity": "none"}, "obliquity"),
        ({"wavelength": 1.0, "power": 0.0}, "above zero"),
        ({"wavelength": 1.0, "aperture_power": 0.0}, "above zero"),
        ({"wavelength": 1.0, "aperture_power": 1.0, "power": 1.0}, "got both"),
        ({"wavelength": 1.0, "to_world": np.diag([2.0, 2.0, 2.0, 1.0])}, "scales by 2, 2, 2"),
        ({"wavelength": 1.0, "to_world": np.full((4, 4), np.nan)}, "finite"),
        ({"wavelength": 1.0, "to_world": np.diag([1.0, 1.0, 1e300, 1.0])}, "finite"),
        ({"wavelength": 1.0, "to_world": np.eye(3)}, r"\(4, 4\) matrix.*shape \(3, 3\)"),
        ({"wavelength": 1.0, "to_world": "abc"}, r"\(4, 4\) matrix.*str"),
        ({"wavelength": 1.0, "sampling_weight": "x"}, "sampling_weight.*'x'"),
        ({"wavelength": 1.0, "sampling_weight": -1}, "sampling_weight.*-1"),
        ({"wavelength": 1.0, "sampling_weight": float("inf")}, "sampling_weight.*inf"),
        ({"wavelength": 1.0, "sampling": "Marginal"}, "sampling, got 'Marginal'"),
        ({"wavelength": 1.0, "control_variate": "false"}, "control_variate.*'false'"),
        ({"wavelength": 1.0, "antithetic": "false"}, "antithetic.*'false'"),
        ({"wavelength": 1.0, "antithetic": None}, "antithetic.*None"),
        ({"wavelength": 1.0, "visible": "false"}, "visible.*'false'"),
        ({"wavelength": 1.0, "bsdf": 5}, "bsdf as a dictionary.*5"),
        ({"wavelength": 1.0, "bsdf": {}}, "bsdf as a dictionary"),
        ({"wavelength": 1.0, "power": float("inf")}, "finite"),
        ({"wavelength": 1.0, "power": 1e39}, "power that single precision"),
        ({"wavelength": 1e-10, "power": 1e20}, "power that single precision"),
        ({"wavelength": 1e-200}, "wavelength that single precision"),
        ({"wavelength": 1e28}, r"radiates at a wavelength of 1e\+28 m.*check the unit"),
        ({"wavelength": 1.0, "scene_unit": 1e-30}, "scene_unit that single precision"),
    ],
)
def test_a_bad_argument_of_an_entry_is_refused_at_once(
    arguments: dict[str, Any], fragment: str
) -> None:
    import polywigner.mitsuba as pwm

    with pytest.raises(PolywignerError, match=fragment):
        pwm.aperture(SQUARE, **arguments)


def test_the_former_name_of_the_power_still_does_and_says_the_new_one() -> None:
    import polywigner.mitsuba as pwm

    with pytest.warns(DeprecationWarning, match="write power="):
        entry = pwm.aperture(SQUARE, WAVELENGTH, radiated_power="10 dBm")
    assert entry["power"] == pytest.approx(0.01)
    with (
        pytest.warns(DeprecationWarning, match="write power="),
        pytest.raises(SceneError, match="both are one number"),
    ):
        pwm.aperture(SQUARE, WAVELENGTH, radiated_power=1.0, power=1.0)


@pytest.mark.parametrize("wavelength", [1e-10, 500e-9, 1.0, 1e6])
@pytest.mark.parametrize("power", [None, 1e-6, 1e3])
def test_waves_from_x_rays_to_kilohertz_are_within_range(
    wavelength: float, power: float | None
) -> None:
    import polywigner.mitsuba as pwm

    side = 1e3 * wavelength
    entry = pwm.aperture(pw.shapes.square(side), wavelength, power=power, scene_unit=side)
    assert entry["wavelength"] == wavelength


def test_only_apertures_are_kept_in_memory() -> None:
    import polywigner.mitsuba as pwm

    with pytest.raises(SceneError, match="expected an Aperture or an Array, got list"):
        pwm.register_source([[0, 0], [1, 0], [0, 1]])  # type: ignore[arg-type]


def test_a_gpu_variant_is_refused_at_once_where_there_is_no_gpu(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import drjit as dr

    import polywigner.mitsuba as pwm

    use("scalar_rgb")
    offered = [variant for variant in use("scalar_rgb").variants() if variant.startswith("cuda_")]
    assert offered
    for variant in offered:
        monkeypatch.setattr(dr, "has_backend", lambda backend: False)
        with pytest.raises(EngineError, match=f"{variant} needs an NVIDIA GPU.*use "):
            pwm.choose_variant(variant)
        monkeypatch.setattr(dr, "has_backend", lambda backend: backend == dr.JitBackend.CUDA)
        assert pwm.choose_variant(variant) == variant


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("wavelength", 0.0),
        ("wavelength", -1.0),
        ("wavelength", float("nan")),
        ("wavelength", float("inf")),
        ("wavelength", 1e-30),
        ("power", -1.0),
        ("power", float("nan")),
        ("power", float("inf")),
        ("power", 1e37),
    ],
)
def test_an_unusable_new_value_is_refused_when_the_scene_is_updated(
    variant: str, name: str, value: float
) -> None:
    mi = use(variant)
    import polywigner.mitsuba as pwm

    scene = mi.load_dict({"type": "scene", "aperture": pwm.aperture(SQUARE, WAVELENGTH)})
    params = mi.traverse(scene)
    params[f"aperture.emitter.{name}"] = value
    with pytest.raises(SceneError, match=name):
        params.update()


TILES = pw.phased_array(SQUARE, pw.arrays.grid_positions(5, 4, 0.011), np.ones(20))


@pytest.mark.parametrize(
    ("variant", "source", "name", "reason"),
    [
        ("scalar_rgb", SQUARE, "vertices", "a variant of Mitsuba that compiles"),
        pytest.param("llvm_ad_mono", COSINE, "vertices", "a uniform", marks=pytest.mark.llvm),
        pytest.param("llvm_ad_mono", SQUARE, "weights", "an array", marks=pytest.mark.llvm),
        pytest.param("llvm_ad_mono", TILES, "vertices", "got 6400 pairs", marks=pytest.mark.llvm),
    ],
)
def test_an_emitter_says_why_its_numbers_are_no_parameters(
    variant: str, source: Any, name: str, reason: str
) -> None:
    mi = use(variant)
    scene = mi.load_dict({"type": "scene", "aperture": light(source)})
    assert f"aperture.emitter.{name}" not in mi.traverse(scene)
    with pytest.raises(SceneError, match=reason):
        getattr(scene.emitters()[0], name)


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
def test_the_light_can_be_switched_off_and_on(variant: str) -> None:
    mi = use(variant)
    import polywigner.mitsuba as pwm

    scene = mi.load_dict({"type": "scene", "aperture": pwm.aperture(SQUARE, WAVELENGTH)})
    emitter, params = scene.emitters()[0], mi.traverse(scene)
    above = mi.Interaction3f()
    above.p = mi.Point3f(0.0, 0.0, 1.0)
    seen = []
    for power in (0.0, 2.0):
        params["aperture.emitter.power"] = power
        params.update()
        weight = emitter.sample_direction(above, mi.Point2f(0.5, 0.5), True)[1]
        seen.append(np.abs(np.array(weight, dtype=float)).max())
    assert seen[0] == 0.0
    assert seen[1] > 0.0


@pytest.mark.parametrize("variant", ["scalar_rgb", MONO])
def test_the_mesh_does_not_move_without_the_light(variant: str) -> None:
    mi = use(variant)
    import polywigner.mitsuba as pwm

    placed = pose((80.0, -50.0, 40.0), about_x=0.7)
    entry = pwm.aperture(pw.shapes.chevron(0.01, 0.01, 0.004), WAVELENGTH, to_world=placed)
    params = mi.traverse(mi.load_dict({"type": "scene", "aperture": entry}))
    params["aperture.emitter.to_world"] = mi.Transform4f(
        mi.ScalarTransform4f(pose((3.0, 2.0, 1.0)))
    )
    params.update()  # with the light it does
    moved = np.array(params["aperture.vertex_positions"], dtype=float).reshape(-1, 3)
    assert np.allclose(moved[:, 2], 1.0)
    params["aperture.vertex_positions"] = (moved + 0.001).ravel().tolist()
    with pytest.raises(SceneError, match=r"other vertex_positions; change emitter\.to_world"):
        params.update()


def test_the_page_on_the_plugin_lists_the_parameters_there_are() -> None:
    from polywigner.mitsuba.parameters import PARAMETERS

    page = (Path(__file__).parents[1] / "docs" / "plugin.md").read_text(encoding="utf-8")
    table = page.split("| parameter | type | meaning |")[1].split("\n\n")[0]
    names = [line.split("`")[1] for line in table.splitlines() if line.startswith("| `")]
    assert tuple(names) == PARAMETERS


def test_a_dictionary_that_does_not_load_has_a_one_line_reason(tmp_path: Path) -> None:
    mi = use("scalar_rgb")
    import polywigner.mitsuba as pwm
    from polywigner.errors import QuantityError

    (tmp_path / "patch.wkt").write_text(WKT)
    shape = {"type": "wigner", "aperture": str(tmp_path / "patch.wkt"), "frequency": "94 GHx"}
    with pytest.raises(RuntimeError) as caught:
        mi.load_dict(shape)
    reason = pwm.translate_error(caught.value)
    assert isinstance(reason, (SceneError, QuantityError))
    assert "94 GHx" in str(reason)
    assert "\n" not in str(reason)


def test_what_another_plugin_raised_ends_the_line() -> None:
    """Mitsuba puts the traceback before it."""
    from polywigner.mitsuba import translate_error

    text = (
        '[parser.cpp:1718] At a.xml (line 3, col 2): failed to instantiate plugin of type "b": '
        "Traceback (most recent call last):\n  File \"b.py\", line 6, in b\nKeyError: 'gold'"
    )
    reason = str(translate_error(RuntimeError(text)))
    assert reason.endswith("plugin of type \"b\": KeyError: 'gold'")
    assert "File" not in reason


def test_an_error_of_load_file_ends_with_the_packages_line(tmp_path: Path) -> None:
    """No lines of the package's own files stand between."""
    scene = '<scene version="3.0.0"><shape type="wigner">{}</shape></scene>'
    wrong = '<string name="aperture" value="none.wkt"/><string name="frequency" value="9 GHz"/>'
    (tmp_path / "scene.xml").write_text(scene.format(wrong))
    mi = use("scalar_rgb")
    with pytest.raises(RuntimeError) as caught:
        mi.load_file(str(tmp_path / "scene.xml"))
    *before, last = str(caught.value).splitlines()
    assert last == "FileFormatError: none.wkt: expected a file, got a path that does not exist"
    assert not any("readers.py" in line or "read_parameters" in line for line in before)


@pytest.mark.slow
def test_apertures_in_memory_are_shared_by_content_and_bounded() -> None:
    from polywigner.mitsuba import parameters

    first = parameters.register_source(pw.shapes.square(0.01))
    assert parameters.register_source(pw.shapes.square(0.01)) == first
    for k in range(parameters.CAPACITY):
        parameters.register_source(pw.shapes.square(0.02 + k))
    gc.collect()
    with pytest.raises(SceneError, match="key of a source"):
        parameters.registered_source(first)


def test_importing_the_plugin_sets_no_variant() -> None:
    import subprocess
    import sys

    code = "import polywigner.mitsuba, mitsuba; assert mitsuba.variant() is None"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_plugins_are_built_by_numpy_in_the_threads_of_mitsuba() -> None:
    """One of those threads that waited for a kernel has ended the process."""
    from polywigner.execution.choice import planned
    from polywigner.mitsuba.plugins import _built
    from polywigner.plans import Request

    request = Request("sum", samples=10**7, terms=100)
    engines = [planned(request).engine]
    _built(lambda variant, props: engines.append(planned(request).engine), "scalar_rgb", None)
    engines.append(planned(request).engine)
    assert engines == [engines[0], "numpy", engines[0]]
