"""Images by range against path lengths, and figures of frames and profiles."""

import importlib.util
import json
import math

import numpy as np
import pytest

import cli_scenes
import polywigner as pw
from polywigner.cli import main
from polywigner.errors import ArgumentError
from polywigner.figures import draw_range_profile
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

RADAR = [
    pytest.mark.drjit,
    pytest.mark.llvm,
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("mitransient") is None, reason="mitransient is not installed"
    ),
]

CAMERA = """<sensor type="perspective" id="camera">
    <float name="fov" value="20"/><float name="near_clip" value="2"/>
    <transform name="to_world">
        <lookat origin="3, 0, 0" target="3, 0, 10" up="0, 1, 0"/>
    </transform>
    <film type="hdrfilm">
        <integer name="width" value="8"/><integer name="height" value="6"/>
        <string name="pixel_format" value="luminance"/><rfilter type="box"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
</sensor>"""
NOISE = '<string name="bandwidth" value="1 GHz"/><string name="temperature" value="290 K"/>'
SAMPLER = '<sampler type="independent"><integer name="sample_count" value="256"/></sampler>'
POWER = '<string name="estimator" value="exact"/><string name="power" value="1 W"/>'
WALL = '<rotate y="1" angle="180"/><scale value="8"/><translate z="10"/>'


@pytest.fixture
def scene(tmp_path):
    receiver = cli_scenes.receiver(NOISE, SAMPLER, pose="")
    parts = receiver, cli_scenes.source(POWER), cli_scenes.rectangle(WALL)
    text = cli_scenes.scene(cli_scenes.PATH.format(2), CAMERA, *parts)
    return cli_scenes.written(tmp_path, text)


class TestCameras:
    pytestmark = RADAR

    def test_frames_are_where_paths_are_as_long_and_add_up_to_the_picture(self, scene):
        pm = pytest.importorskip("polywigner.mitsuba")
        loaded = pm.load_scene(scene, "llvm_ad_mono")
        edges = np.linspace(9.0, 12.0, 61)
        reported: list[tuple[int, int]] = []
        frames = pm.range_frames(
            loaded, edges, spp=64, seed=3, progress=lambda *step: reported.append(step)
        )
        radiance = frames["radiance"].values
        assert radiance.shape == (60, 6, 8) and reported[-1] == (4, 4)
        total = radiance.sum(axis=0) + frames["before"].values + frames["after"].values
        picture = pm.render(loaded, spp=64, seed=5)[..., 0]
        np.testing.assert_allclose(total.mean(), picture.mean(), rtol=0.02)
        # Central rays of the pixels, from a camera whose near clip is 2 m.
        half = math.tan(math.radians(10.0))
        x = 10.0 * half * (np.arange(8) - 3.5) / 4
        y = 10.0 * half * (np.arange(6) - 2.5) / 4
        away = np.hypot(10.0, np.hypot(x, y[:, None]))
        expected = (away + np.hypot(10.0, np.hypot(3.0 - x, y[:, None]))) / 2
        middles = frames["range"].values
        result = (radiance * middles[:, None, None]).sum(axis=0) / radiance.sum(axis=0)
        np.testing.assert_allclose(result, expected, atol=0.06)
        with pytest.raises(ArgumentError, match="range_profile"):
            pm.range_frames(loaded, edges, sensor=1)
        with pytest.raises(ArgumentError, match="sensor to be a whole number"):
            pm.range_frames(loaded, edges, sensor="camera")

    def test_commands_write_what_functions_return(self, scene, tmp_path):
        xarray = pytest.importorskip("xarray")
        out = tmp_path / "out" / "echo"
        words = [str(scene), "--variant", "llvm_ad_mono", "--range", "9 m to 15 m", "--out"]
        assert main(["receive", *words, str(out), "--bins", "60", "--resumable"]) == 0
        record = json.loads(out.with_name("echo.json").read_text())
        with xarray.open_dataset(out.with_name("echo_range.nc")) as profile:
            power = profile["power"].values
            np.testing.assert_allclose(profile["range_edge"].values, np.linspace(9, 15, 61))
            assert profile["power"].attrs["units"] == "W"
            total = float(power.sum() + profile["before"] + profile["after"])
        np.testing.assert_allclose(total, record["receivers"][0]["scattered_w"], rtol=1e-12)
        assert power[:10].max() == 0 < power[10]
        assert main(["render", *words, str(out), "--bins", "3", "--spp", "4"]) == 0
        with xarray.open_dataset(out.with_name("echo_range.nc")) as frames:
            assert frames["radiance"].shape == (3, 6, 8)
        names = sorted(path.name for path in out.parent.iterdir())
        assert names == [
            "echo.exr", "echo.json", "echo.png", "echo_range.nc",
            "echo_range.png",
        ]  # fmt: skip

    def test_bins_that_single_precision_cannot_tell_apart_are_refused(self, scene, capsys):
        words = [str(scene), "--variant", "llvm_ad_mono", "--out", str(scene.parent / "echo")]
        words += ["--spp", "1000000000"]  # would take a day
        for command in ("render", "receive"):
            assert main([command, *words, "--range", "1 m to 1.0000001 m"]) == 2
            assert "single precision" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--range", "2 m to 1 m"], "ascending lengths"),
        (["--range", "0 m to 1 s"], "length"),
        (["--range", "0 m to 1 m", "--bins", "0"], "--bins"),
        (["--bins", "5"], "--bins requires --range"),
    ],
)
def test_bad_ranges_are_one_sentence(words, message, scene, capsys, monkeypatch):
    monkeypatch.chdir(scene.parent)  # default folder of results
    assert main(["receive" if len(words) == 2 else "render", str(scene), *words]) == 2
    errors = capsys.readouterr().err
    assert message in errors and errors.count("\n") == 1
    assert sorted(path.name for path in scene.parent.iterdir()) == ["scene.xml", "square.wkt"]


def profile(**other):
    edges = np.linspace(0.0, 4.0, 5)
    values = {
        "power": np.array([0.0, 1e-6, -1e-9, 1e-8]),
        "standard_error": np.full(4, 1e-9),
        "noise_power": np.array(1e-11),
        **other,
    }
    arrays = {name: labelled_array(v, ("range",) * np.ndim(v)) for name, v in values.items()}
    for name, value in (("path_range", 2.5), ("path_power", 1e-5)):
        arrays[name] = labelled_array(np.full((1, 1), value), ("emitter", "path"))
    return labelled_arrays(arrays, {"range_edge": labelled_array(edges, ("range_edge",))})


def test_a_profile_is_drawn_in_dbm_with_the_noise():
    axes = draw_range_profile(profile(), floor_db=-40.0).axes[0]
    drawn = axes.patches[-1].get_data().values
    np.testing.assert_allclose(drawn, [-85.0, -30.0, -85.0, -50.0])
    path, noise = axes.lines
    assert noise.get_ydata()[0] == pytest.approx(-80.0)
    assert (*path.get_xdata(), *path.get_ydata()) == pytest.approx((2.5, -20.0))
    assert axes.get_xlabel().endswith("(m)") and "dBm" in axes.get_ylabel()
    quiet = draw_range_profile(profile(noise_power=np.array(np.nan)), floor_db=-40.0).axes[0]
    assert quiet.get_ylim()[0] == pytest.approx(-70.0) and len(quiet.lines) == 1
    for bad in (None, pw.shapes.square(1.0)):
        with pytest.raises(ArgumentError, match="range_profile"):
            draw_range_profile(bad)
    with pytest.raises(ArgumentError, match="a single receiver"):
        draw_range_profile(profile(), 1)
