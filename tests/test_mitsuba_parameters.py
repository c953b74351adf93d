"""Parameters of the ``wigner`` shape from XML and from dictionaries."""

import re
import warnings
from operator import attrgetter
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import polywigner as pw
import polywigner.mitsuba as pwm
from cli_scenes import scene, written
from mitsuba_scenes import SQUARE, WAVELENGTH, light, pose, scene_of, use
from polywigner.errors import EngineError, PolywignerError, SceneError
from polywigner.mitsuba import translate_error
from polywigner.mitsuba.plugins.source_parameters import PARAMETERS

pytestmark = pytest.mark.drjit

WKT = "POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))"


def texts(**parameters):
    """Return string parameters in XML."""
    return "".join(f'<string name="{key}" value="{text}"/>' for key, text in parameters.items())


def element(kind, name, value):
    return f'<{kind} name="{name}" value="{value}"/>'


FILE = texts(aperture="patch.wkt")
GOOD = texts(aperture="patch.wkt", unit="mm", frequency="94 GHz")
FROM_FILE = texts(source="array.toml", frequency="94 GHz")


def write_scene(folder, inside):
    (folder / "patch.wkt").write_text(WKT)
    shape = f'<shape type="wigner" id="aperture">{inside}</shape>'
    return written(folder, scene('<integrator type="path"/>', shape))


def load(folder, inside):
    return pwm.load_scene(write_scene(folder, inside), "scalar_rgb").emitters()[0].spec


def test_a_file_is_found_beside_the_scene_and_read_in_its_unit(tmp_path):
    spec = load(tmp_path, GOOD)
    assert spec.source == SQUARE
    assert spec.wavelength == pytest.approx(WAVELENGTH, rel=1e-15)
    assert spec.power == pytest.approx(pw.radiated_power(SQUARE, WAVELENGTH), rel=1e-12)


@pytest.mark.parametrize("obliquity", ["rayleigh-sommerfeld-1", "paper"])
def test_of_an_aperture_power_the_share_that_the_obliquity_radiates_counts(tmp_path, obliquity):
    spec = load(tmp_path, GOOD + texts(obliquity=obliquity, aperture_power="10 dBm"))
    share = pw.radiated_power(SQUARE, WAVELENGTH, obliquity=obliquity) / SQUARE.area
    assert spec.power == pytest.approx(0.01 * share, rel=1e-9)


def test_layers_of_a_drawing_are_joined_and_its_curves_flattened_within_the_tolerance(tmp_path):
    shapes = [f'<g id="{name}"><rect x="{x}" width="2" height="1"/></g>'
              for name, x in (("pad", 0), ("feed", 1), ("mark", 5))]  # fmt: skip
    disc = '<g id="disc"><circle r="5" cx="20"/></g>'
    (tmp_path / "antenna.svg").write_text(f"<svg>{''.join(shapes)}{disc}</svg>")
    inside = GOOD.replace("patch.wkt", "antenna.svg") + texts(layer="pad; feed")
    joined = load(tmp_path, inside + element("boolean", "union", "true")).source
    assert joined.area == pytest.approx(3e-6, rel=1e-12, abs=0.0)
    inside = GOOD.replace("patch.wkt", "antenna.svg") + texts(layer="disc")
    for tolerance, vertices in (("", 52), (texts(tolerance="1 um"), 136)):
        assert len(load(tmp_path, inside + tolerance).source.rings[0]) == vertices


@pytest.mark.parametrize(
    ("inside", "name", "value"),
    [
        (FILE + element("float", "frequency", 94e9), "wavelength", WAVELENGTH),
        (FILE + texts(wavelength="3.19 mm"), "wavelength", 3.19e-3),
        (FILE + element("float", "wavelength", 0.00319), "wavelength", 3.19e-3),
        (GOOD + texts(power="10 mW"), "power", 1e-2),
        (GOOD + element("float", "power", 2.5), "power", 2.5),
        (GOOD + texts(coherence="4 mm"), "mixture.coherence_width", 4e-3),
        (GOOD + texts(bandwidth="2 GHz"), "mixture.bandwidth", 2e9),
        (GOOD + texts(scene_unit="0.1 m"), "scene_unit", 0.1),
        (GOOD + element("boolean", "visible", "false"), "visible", False),
    ],
)
def test_parameters_are_texts_or_si_numbers(tmp_path, inside, name, value):
    assert attrgetter(name)(load(tmp_path, inside)) == pytest.approx(value, rel=1e-12)


def turned(inside):
    return GOOD + f'<transform name="to_world">{inside}</transform>'


NO_SOURCE = texts(source="source.toml", frequency="94 GHz")
# Invalid parameters of the shape, and parts of the resulting message.
REFUSED = {
    GOOD + texts(colour="red"): "parameters are aperture, unit | 'colour'",
    GOOD + element("float", "wavelength", 0.003): "exactly one of | got frequency and wavelength",
    FILE: "exactly one of frequency, wavelength | got none",
    texts(frequency="94 GHz"): "exactly one of aperture, source | got none",
    GOOD.replace("94 GHz", "94 GHx"): "frequency | 94 GHx",
    GOOD.replace("patch.wkt", "none.wkt"): "none.wkt",
    GOOD.replace("94 GHz", "1e-20 Hz"): "radiates only | 2.99792e+28 | check the unit",
    GOOD + element("boolean", "power", "true"): "power to be a number or a string | bool",
    GOOD + texts(obliquity="rs1"): "obliquity | 'rs1' | kirchhoff",
    turned('<scale value="2"/>'): "rotation and translation only | scales by 2, 2, 2",
    texts(aperture="memory:0123", frequency="94 GHz"): "no source with the key | mitsuba.aperture",
    GOOD + texts(taper="gauss"): "taper: expected a taper such as | \"te10\" | 'gauss'",
    GOOD + texts(array="9999 x 9999, 2 mm"): "array: expected at most 1048576 elements",
    GOOD + texts(window="hamming"): "window: expected an array of identical | specify array",
    GOOD + texts(source="array.toml"): "got aperture and source",
    FROM_FILE + texts(unit="mm"): "unit='mm' cannot be combined with a source file",
    NO_SOURCE.replace("source.toml", "cut.toml"): "cut.toml | TOML",
    NO_SOURCE.replace("source.toml", "slits.toml"): "got Slits | rectangles",
}  # fmt: skip


@pytest.mark.parametrize("inside", REFUSED, ids=lambda inside: inside.removeprefix(GOOD)[:60])
def test_a_bad_parameter_is_one_line_that_says_where(tmp_path, inside):
    pw.write_source(pw.phased_array(SQUARE, GRID), tmp_path / "array.toml")
    slits = "kind = 'slits'\nintervals = [[0, 1]]"
    for name, text in (("kind", "kind = 'apertur'"), ("cut", "kind = "), ("slits", slits)):
        (tmp_path / f"{name}.toml").write_text(text)
    with pytest.raises(PolywignerError) as caught:
        load(tmp_path, inside)
    message = str(caught.value)
    assert "\n" not in message and "Traceback" not in message
    assert message.startswith(f"{tmp_path / 'scene.xml'} (line 1")
    for fragment in REFUSED[inside].split(" | "):
        assert fragment in message


def test_a_scene_without_the_emitter_is_told_from_one_with_it(tmp_path):
    assert pwm.has_wigner_emitter(pwm.load_scene(write_scene(tmp_path, GOOD), "scalar_rgb"))
    bare = tmp_path / "bare.xml"
    bare.write_text('<scene version="3.0.0"><emitter type="constant"/></scene>')
    assert not pwm.has_wigner_emitter(pwm.load_scene(bare, "scalar_rgb"))


SPACING, SIDE = 12e-3, 10e-3
GRID = pw.arrays.grid_positions(3, 4, SPACING)
THETA, PHI = np.radians([20, 90])
TILTED = np.array([np.sin(THETA) * np.cos(PHI), np.sin(THETA) * np.sin(PHI), np.cos(THETA)])
COSINE, STEERED = pw.cosine_taper(SIDE, SIDE), pw.steering(TILTED, WAVELENGTH)
BEAM = pw.arrays.steering_weights(GRID, TILTED, WAVELENGTH)


def layout(positions, weights=None, field=None):
    return pw.phased_array(SQUARE.with_illumination(field), positions, weights)


SAID: list[tuple[dict[str, str], Any]] = [
    ({"taper": "cosine", "steering": "20 deg, 90 deg"}, COSINE * STEERED),
    ({"array": "3 x 4, 12 mm", "window": "taylor 25 dB 3", "steering": "20 deg, 90 deg"},
     layout(GRID, pw.arrays.window_weights((3, 4), "taylor", sll=25, nbar=3) * BEAM)),
]  # fmt: skip


@pytest.mark.parametrize(("said", "expected"), SAID, ids=str)
def test_texts_say_what_the_functions_of_python_do(tmp_path, said, expected):
    is_array = isinstance(expected, pw.Array)
    result = load(tmp_path, GOOD + texts(**said)).source
    assert result == (expected if is_array else SQUARE.with_illumination(expected))


def test_a_source_file_is_what_was_written_and_may_be_steered(tmp_path):
    array = layout(GRID, BEAM, COSINE)
    for name in ("array.toml", "array.json"):
        pw.write_source(array, tmp_path / name)
        spec = load(tmp_path, texts(source=name, frequency="94 GHz"))
        assert spec.source == array
        assert spec.power == pytest.approx(pw.radiated_power(array, WAVELENGTH), rel=1e-12)
    pw.write_source(layout(GRID), tmp_path / "array.toml")
    result = load(tmp_path, FROM_FILE + texts(steering="20 deg, 90 deg")).source
    assert result == layout(GRID, BEAM)


def test_an_array_moves_with_its_mesh_and_keeps_its_place():
    mi = use("scalar_rgb")
    array = pw.phased_array(SQUARE, GRID + np.array([0.5, -0.3]))
    entry = pwm.aperture(array, WAVELENGTH, to_world=pose((1.0, 2.0, 3.0)))
    scene = scene_of(aperture=entry)
    params = mi.traverse(scene)
    for place in ((1.0, 2.0, 3.0), (-4.0, 0.0, 2.0)):
        params["aperture.emitter.to_world"] = mi.Transform4f(mi.ScalarTransform4f(pose(place)))
        params.update()
        corners = np.array(params["aperture.vertex_positions"], dtype=float).reshape(-1, 3)
        assert np.allclose(corners.mean(axis=0), np.add(place, (0.5, -0.3, 0.0)), atol=1e-6)


def test_a_dictionary_entry_carries_all_parameters():
    use("scalar_rgb")
    placed = pose((1.0, 2.0, 3.0), about_x=0.5)
    entry = pwm.aperture(
        SQUARE, WAVELENGTH, to_world=placed, obliquity="paper", power=2.0, bsdf={"type": "diffuse"}
    )
    scene = scene_of(aperture=entry)
    spec = scene.emitters()[0].spec
    assert (spec.source, spec.wavelength, spec.obliquity) == (SQUARE, WAVELENGTH, "paper")
    assert spec.power == 2.0
    assert np.allclose(spec.pose, placed, atol=1e-7)
    assert "Diffuse" in str(scene.shapes()[0].bsdf())


SLITS = pw.shapes.double_slit(2e-3, 12e-3, (-6e-3, 6e-3))
CURVED = SQUARE.curved((0.03, -0.05), WAVELENGTH, (1e-3, 0.0))
GRAZING = SQUARE.with_illumination(pw.Illumination([1], [(1 / WAVELENGTH, 0)]))
EXACT: dict[str, Any] = {"estimator": "exact"}
RECEIVED: dict[str, Any] = {"entry": pwm.receiver}


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        ({"aperture_power": 1.0, "power": 1.0}, "got both"),
        ({"to_world": np.diag([2.0, 2.0, 2.0, 1.0])}, "scales by 2, 2, 2"),
        ({"to_world": np.eye(3)}, r"\(4, 4\) matrix, got shape \(3, 3\)"),
        ({"visible": "false"}, "visible.*'false'"),
        ({"wavelength": 1e28}, r"radiates only .* at a wavelength of 1e\+28 m.*check the unit"),
        ({"estimator": "rays"}, "estimator to be one of .*, got 'rays'"),
        ({"source": SLITS.partially_coherent(8e-3), "obliquity": "kirchhoff"}, "the obliquity"),
        ({"source": SLITS, "bandwidth": 3e11}, "expected"),
        ({"source": CURVED, "obliquity": "kirchhoff"}, "for curved waves"),
        ({"source": GRAZING, "obliquity": "rayleigh-sommerfeld-2"},
         r"radiates only 0 W.*whether the waves of the source graze"),
        ({"source": pw.Slits([[0, 1e-3]])}, "Slits; use rectangles"),
        ({"source": SQUARE.placed(np.eye(4))}, "PlacedAperture; omit its pose"),
        ({"source": pw.Array([SQUARE.placed(pose((0, 0, 1.0))), SQUARE])}, "got z = 1"),
        ({"source": pw.Array([SQUARE, SQUARE], [1, -1])}, "cancel each other everywhere"),
        (EXACT | {"obliquity": "paper"}, "boundary condition.*'paper'"),
        (EXACT | {"source": SQUARE.partially_coherent(1e-3)}, "a coherence width of 0.001 m"),
        (EXACT | {"bandwidth": 1e9}, "a single wavelength, got a bandwidth"),
        (EXACT | {"source": pw.shapes.square(100.0)}, "at most 8192 pieces"),
        (EXACT | {"source": SQUARE.curved(4e-4, WAVELENGTH)}, "curvature of the wave is too large"),
        (EXACT | {"source": CURVED, "obliquity": "kirchhoff"}, "for curved waves and partially"),
        (RECEIVED | {"film": (0, 3)}, "each size in film to be a whole number from 1"),
        (RECEIVED | {"film": 64}, "film to be a pair"),
        (RECEIVED | {"noise_figure": -1.0}, "0 dB or more"),
        (RECEIVED | {"obliquity": "paper"}, "boundary condition"),
        (RECEIVED | {"to_world": np.diag([2.0, 1.0, 1.0, 1.0])}, "to_world"),
        (RECEIVED | {"source": CURVED, "estimator": "wigner", "obliquity": "kirchhoff"},
         "for curved waves"),
    ],
)  # fmt: skip
def test_a_bad_argument_of_an_entry_is_refused_at_once(arguments, fragment):
    how = {"source": SQUARE, "wavelength": WAVELENGTH, "entry": pwm.aperture} | arguments
    entry = how.pop("entry")
    with pytest.raises(PolywignerError, match=fragment):
        entry(**how)


@pytest.mark.parametrize(("wavelength", "power"), [(1e-10, 1e-6), (1e6, 1e3), (500e-9, None)])
def test_waves_from_x_rays_to_kilohertz_are_within_range(wavelength, power):
    side = 1e3 * wavelength
    entry = pwm.aperture(pw.shapes.square(side), wavelength, power=power, scene_unit=side)
    assert entry["wavelength"] == wavelength


def test_the_preferred_variant_compiles_and_a_gpu_variant_needs_a_gpu(llvm, monkeypatch):
    use("scalar_rgb")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pwm.choose_variant() == "llvm_ad_mono"
        assert pwm.choose_variant("scalar_rgb") == "scalar_rgb"
    with pytest.raises(EngineError, match="Mitsuba has no variant"):
        pwm.choose_variant("llvm_ad_gold")
    monkeypatch.setattr(dr, "has_backend", lambda backend: False)
    with pytest.raises(EngineError, match=r"cuda_ad_mono requires an NVIDIA GPU.*use "):
        pwm.choose_variant("cuda_ad_mono")
    monkeypatch.setattr(dr, "has_backend", lambda backend: backend == dr.JitBackend.CUDA)
    assert pwm.choose_variant("cuda_ad_mono") == "cuda_ad_mono"


@pytest.mark.parametrize(("name", "value"), [("wavelength", 0.0), ("power", float("inf"))])
def test_an_unusable_new_value_is_refused_when_the_scene_is_updated(name, value):
    mi = use("scalar_rgb")
    scene = scene_of(aperture=pwm.aperture(SQUARE, WAVELENGTH))
    params = mi.traverse(scene)
    params[f"aperture.emitter.{name}"] = value
    with pytest.raises(SceneError, match=name):
        params.update()


OVERLAPPING = pw.Array([SQUARE, SQUARE.moved((1e-3, 0))])
TILES = pw.phased_array(SQUARE, pw.arrays.grid_positions(5, 4, 0.011), np.ones(20))


@pytest.mark.llvm
@pytest.mark.parametrize(
    ("variant", "source", "name"),
    [
        ("scalar_rgb", SQUARE, "vertices"),
        ("llvm_ad_mono", SQUARE.with_illumination(COSINE), "vertices"),
        ("llvm_ad_mono", SQUARE, "weights"),
        ("llvm_ad_mono", TILES, "vertices"),
        ("llvm_ad_mono", OVERLAPPING, "weights"),
    ],
)
def test_some_sources_have_no_differentiable_vertices_or_weights(variant, source, name):
    mi = use(variant)
    assert f"aperture.emitter.{name}" not in mi.traverse(scene_of(aperture=light(source)))


def test_the_mesh_does_not_move_without_the_light():
    mi = use("scalar_rgb")
    placed = pose((80.0, -50.0, 40.0), about_x=0.7)
    entry = pwm.aperture(pw.shapes.chevron(0.01, 0.01, 0.004), WAVELENGTH, to_world=placed)
    params = mi.traverse(scene_of(aperture=entry))
    params["aperture.emitter.to_world"] = mi.Transform4f(
        mi.ScalarTransform4f(pose((3.0, 2.0, 1.0)))
    )
    params.update()  # with its emission
    moved = np.array(params["aperture.vertex_positions"], dtype=float).reshape(-1, 3)
    assert np.allclose(moved[:, 2], 1.0)
    params["aperture.vertex_positions"] = (moved + 0.001).ravel().tolist()
    with pytest.raises(
        SceneError, match=r"vertex_positions.* were moved.* change emitter\.to_world"
    ):
        params.update()


def test_the_page_on_the_plugin_lists_the_parameters_there_are():
    page = (Path(__file__).parents[1] / "docs" / "plugin.md").read_text(encoding="utf-8")
    table = page.split("| parameter | type | meaning |")[1].split("\n\n")[0]
    cells = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    assert sorted(re.findall("`(.*?)`", " ".join(cells))) == sorted(PARAMETERS)


def test_what_another_plugin_raised_ends_the_line():
    """Mitsuba precedes the message by a traceback."""
    text = (
        '[parser.cpp:1718] At a.xml (line 3, col 2): failed to instantiate plugin of type "b": '
        "Traceback (most recent call last):\n  File \"b.py\", line 6, in b\nKeyError: 'gold'"
    )
    reason = str(translate_error(RuntimeError(text)))
    assert reason.endswith("plugin of type \"b\": KeyError: 'gold'")
    assert "File" not in reason


def test_importing_the_plugin_sets_no_variant():
    import subprocess
    import sys

    code = "import polywigner.mitsuba, mitsuba; assert mitsuba.variant() is None"
    subprocess.run([sys.executable, "-c", code], check=True)
