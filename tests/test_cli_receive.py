"""``polywigner receive`` on links with known couplings."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import polywigner as pw
from cli_scenes import PATH, WIGNER, receiver, rectangle, scene, source, written
from polywigner.cli import main
from polywigner.figures import draw_arrivals

pytestmark = pytest.mark.drjit

EXAMPLE = Path(__file__).parent.parent / "examples" / "link_77ghz" / "link.xml"

DISTANCE = '<default name="distance" value="1"/>'


def scene_file(folder: Path, walls: str = "") -> Path:
    pose = '<lookat origin="0, 0, $distance" target="0, 0, 0" up="0, 1, 0"/>'
    sent = source('<string name="power" value="10 dBm"/>')
    return written(folder, scene(DISTANCE, sent, receiver(WIGNER, pose=pose), walls))


@pytest.fixture
def coarse_map(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reduce the pixels of arrival maps in scalar variants."""
    pytest.importorskip("polywigner.mitsuba")
    monkeypatch.setattr("polywigner.mitsuba.receive.received_power._COARSE", (6, 1))


def received(path: Path, *options: str) -> list[dict[str, Any]]:
    out = path.parent / "out"
    words = ["receive", str(path), "--variant", "scalar_rgb", "--spp", "16", "--out", str(out)]
    assert main([*words, *options]) == 0
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    return json.loads(out.with_suffix(".json").read_text())["receivers"]


@pytest.mark.usefixtures("unrendered_figures", "coarse_map")
def test_a_table_is_printed_and_all_of_it_recorded(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = scene_file(tmp_path)
    (result,) = received(
        path, "--temperature", "290 K", "--bandwidth", "1 GHz", "--noise-figure", "3 dB"
    )
    facing = np.diag([-1.0, 1.0, -1.0, 1.0])
    facing[2, 3] = 1.0
    square = pw.shapes.square(10e-3)
    expected = 10 + 20 * math.log10(abs(pw.coupling(square, square, facing, frequency=94e9)))
    assert result["power_dbm"] == pytest.approx(expected, abs=1e-4)
    assert result["noise_power_w"] == pytest.approx(1.380649e-23 * 290 * 1e9 * 10**0.3)
    out, err = capfd.readouterr()
    assert re.search(r"^tx .* -19\.17 dBm$", out, re.MULTILINE)
    assert "signal-to-noise" in out and "polarisation: ignored" in out
    assert out.splitlines()[-2:] == [f"{tmp_path / 'out'}{suffix}" for suffix in (".json", ".png")]
    assert err == ""


@pytest.mark.usefixtures("unrendered_figures", "coarse_map")
def test_a_parameter_of_the_scene_can_be_defined(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    near, far = (received(path, "--define", f"distance={k}")[0]["power_w"] for k in (2, 4))
    assert near / far == pytest.approx(4, rel=0.01)  # far away


@pytest.mark.llvm
@pytest.mark.usefixtures("unrendered_figures")
def test_the_example_is_received_and_its_map_adds_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from polywigner.mitsuba.receive import received_power

    find, maps = received_power.shapes_in, []

    def kept(scene: Any, receiver: int, picture: Any) -> Any:
        maps.append((picture, find(scene, receiver, picture)))
        return maps[0][1]

    monkeypatch.setattr(received_power, "shapes_in", kept)
    out = tmp_path / "link"
    assert main(["receive", str(EXAMPLE), "--spp", "16384", "--out", str(out)]) == 0
    (result,) = json.loads(out.with_suffix(".json").read_text())["receivers"]
    straight, mirrored = result["emitters"][0]["paths"]
    # Friis' formula with the directivity of a uniform patch of 10 mm x 4 mm.
    wavelength, patch = result["wavelength_m"], pw.shapes.rectangle(10e-3, 4e-3)
    pattern = pw.radiation_pattern(patch, wavelength, 0.0, 0.0)
    gain = 10 ** (pattern.attrs["largest_directivity"] / 10)
    expected = (gain * wavelength / (4 * math.pi * 2.0)) ** 2
    assert straight["coupling"] == pytest.approx(expected, rel=1e-3)
    assert mirrored["mirrors"] == ["metal_wall"] and mirrored["power_w"] < straight["power_w"]
    assert 0 < 3 * result["standard_error_w"] < result["scattered_w"] < result["direct_w"]

    ((picture, places),) = maps
    total = picture.sum()
    # The receiver is above the floor; the box is on its right.
    assert list(places) == ["floor", "box"]
    assert abs(places["floor"][0]) < 0.05 and -0.6 < places["floor"][1] < -0.3
    assert -0.3 < places["box"][0] < -0.05 and -0.5 < places["box"][1] < -0.1
    # The map has 64 samples per pixel, so it agrees within the standard error only.
    assert total == pytest.approx(result["scattered_w"], abs=5 * result["standard_error_w"])


# Lamp above and to the right of the axis of a receiver that points to -z.
LAMP = """<shape type="sphere">
    <point name="center" x="1" y="0.5" z="0"/><float name="radius" value="0.4"/>
    <emitter type="area"><spectrum name="radiance" value="1"/></emitter>
</shape>"""
AWAY = '<transform name="to_world"><translate z="-5"/><rotate y="1" angle="180"/></transform>'


def test_pictures_are_seen_as_the_receiver_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The view is along the receiver's +z axis with +y upwards, so that +x points to the left."""
    from polywigner.mitsuba import load_scene, render
    from polywigner.mitsuba.receive.received_power import arrival_map

    monkeypatch.setattr("polywigner.mitsuba.receive.received_power._COARSE", (8, 4))
    path = written(tmp_path, scene(PATH.format(-1), source(AWAY), receiver(pixels=9), LAMP))
    loaded = load_scene(path, "scalar_rgb")
    for power in (arrival_map(loaded, 0), render(loaded, spp=4).mean(axis=-1)):
        row, column = np.unravel_index(power.argmax(), power.shape)
        s_x, s_y = (2 * (np.array([column, row]) + 0.5) / len(power) - 1).tolist()
        assert s_x < 0 < s_y
        axes = draw_arrivals(power).axes[0]
        (left, end), (low, high) = axes.get_xlim(), axes.get_ylim()
        assert end < s_x < left and low < s_y < high


WALL = rectangle(
    '<rotate y="1" angle="90"/><translate x="-0.2"/>',
    '<bsdf type="conductor"><string name="material" value="none"/></bsdf>',
    "wall",
)


@pytest.mark.usefixtures("unrendered_figures", "coarse_map")
def test_a_channel_is_written_with_its_ways_and_drawn(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    path = scene_file(tmp_path, WALL)
    (result,) = received(
        path, "--frequencies", "93 GHz to 95 GHz, 3", "--coherent", "--polarisation", "x"
    )
    with xarray.open_dataset(tmp_path / "out_channel.nc") as channel:
        h = channel["h_real"].values + 1j * channel["h_imag"].values
        assert channel["mirrors"].values.tolist() == ["", "wall"]
        assert channel.attrs["polarisation"] == result["polarisation"]
    assert result["power_w"] == pytest.approx(10e-3 * abs(h[1, 0, 0]) ** 2, rel=1e-5)
    assert (tmp_path / "out_channel.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.llvm
def test_a_map_is_drawn_while_another_scene_with_diffraction_is_loaded() -> None:
    from polywigner.mitsuba import load_scene
    from polywigner.mitsuba.receive.received_power import arrival_map

    other = load_scene(
        EXAMPLE.parents[1] / "patch_above_floor" / "scene.xml", "llvm_ad_mono", diffraction=True
    )
    assert arrival_map(load_scene(EXAMPLE, "llvm_ad_mono"), 0).sum() > 0
    del other
