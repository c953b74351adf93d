"""``polywigner render`` on scenes whose radiance has a closed form."""

import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest

import polywigner as pw
from cli_scenes import LOOKING_DOWN, PATH, receiver, rectangle, scene, source, written
from polywigner.cli import main
from polywigner.quantities import wavelength_of

pytestmark = pytest.mark.drjit

WAVELENGTH = wavelength_of(94e9)

# Four standard errors of the mean over 64 pixels with 64 samples. The relative standard deviation
# of a sample is sqrt(16/9 - 1) = 0.88.
STATISTICAL = 4 * 0.88 / 64

CAMERA = """<sensor type="orthographic">
    <transform name="to_world"><scale x="{half}" y="{half}"/>{pose}</transform>
    <sampler type="multijitter"><integer name="sample_count" value="64"/></sampler>
    <film type="hdrfilm">
        <integer name="width" value="{size}"/>
        <integer name="height" value="{size}"/>
        {pixels}
        <rfilter type="box"/>
    </film>
</sensor>"""
DIFFUSE = '<bsdf type="diffuse"><spectrum name="reflectance" value="{0}"/></bsdf>'


def scene_of_the_aperture_itself(folder):
    """Write a scene with a camera in front of a square of 10 mm."""
    camera = CAMERA.format(half=6e-3, pose=LOOKING_DOWN, size=16, pixels="")
    # A black wall is required, because Mitsuba's path integrators omit emission in front of an
    # empty background.
    wall = rectangle('<translate z="-0.1"/>', DIFFUSE.format(0))
    return written(folder, scene(PATH.format(3), camera, source(), wall))


def scene_of_a_lit_floor(folder):
    """Write a scene with a floor of reflectance 0.5, 1 m in front of a square of 2 mm."""
    pose = '<lookat origin="0, 0, 0.5" target="0, 0, 1" up="0, 1, 0"/>'
    luminance = '<string name="pixel_format" value="luminance"/>'
    camera = CAMERA.format(half=5e-3, pose=pose, size=8, pixels=luminance)
    floor = rectangle('<rotate x="1" angle="180"/><translate z="1"/>', DIFFUSE.format(0.5))
    return written(folder, scene(PATH.format(3), camera, source(), floor), half=1)


def rendered(path, *options):
    """Render a scene; return the image (height, width, channels) and the record."""
    out = path.parent / "out" / "picture"
    assert main(["render", str(path), "--out", str(out), *options]) == 0
    import mitsuba as mi  # after the command, which selects the LLVM library

    from polywigner.mitsuba.plugins.films import threads_for_openexr

    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    with threads_for_openexr():
        bitmap = mi.Bitmap(str(out.with_suffix(".exr")))
    assert bitmap.component_format() == mi.Struct.Type.Float32
    image = np.array(bitmap)
    return image.reshape(*image.shape[:2], -1), json.loads(out.with_suffix(".json").read_text())


@pytest.mark.usefixtures("unrendered_figures")
def test_a_distant_floor_is_as_bright_as_the_far_field_says(tmp_path):
    image, record = rendered(scene_of_a_lit_floor(tmp_path), "--variant", "scalar_rgb")
    intensity = (2e-3) ** 4 / WAVELENGTH**2  # |F(0)|^2/lambda^2 at a distance of 1 m
    expected = 0.5 / math.pi * intensity
    assert image.mean() == pytest.approx(expected, rel=STATISTICAL)
    assert record["figure"]["unit"] == "W m^-2 sr^-1"
    assert record["figure"]["zero_db"] == pytest.approx(expected, rel=0.5)
    used = record["used"]  # setting of the scene
    assert (used["integrator"], used["spp"]) == ("PathIntegrator", 64)
    assert record["settings"]["spp"] is None


@pytest.mark.usefixtures("unrendered_figures")
def test_the_record_tells_settings_versions_and_times(tmp_path):
    _, record = rendered(
        scene_of_a_lit_floor(tmp_path),
        *("--variant", "scalar_rgb", "--spp", "4"),
        *("--integrator", "direct", "--seed", "7", "--db-floor", "-25"),
    )
    settings = record["settings"]
    assert (settings["spp"], settings["seed"], settings["floor_db"]) == (4, 7, -25)
    used = [record["used"][name] for name in ("variant", "integrator", "spp")]
    assert used == ["scalar_rgb", "direct", 4]
    versions = record["versions"]
    assert versions["polywigner"] == pw.__version__
    assert versions["python"] == ".".join(map(str, sys.version_info[:3]))
    assert versions["mitsuba"].startswith("3.")
    assert versions["llvm"] is None  # not used by this variant
    assert record["seconds"]["render"] > 0
    assert record["figure"]["floor_db"] == -25


@pytest.mark.usefixtures("unrendered_figures")
def test_a_receiver_gets_a_figure_of_its_pixels_in_watts(tmp_path):
    sampler = '<sampler type="independent"><integer name="sample_count" value="4"/></sampler>'
    floor = rectangle('<translate z="-1"/>', DIFFUSE.format(0.5))
    parts = receiver(sampler, pose="", pixels=4), source(), floor
    image, record = rendered(
        written(tmp_path, scene(PATH.format(3), *parts)), "--variant", "scalar_rgb"
    )
    assert image.shape[:2] == (4, 4) and record["figure"]["unit"] == "W"


def test_a_film_in_colour_is_kept_its_mean_is_drawn_and_only_paths_are_printed(tmp_path, capfd):
    path = scene_of_the_aperture_itself(tmp_path)
    image, _ = rendered(path, "--variant", "scalar_rgb", "--spp", "4")
    assert image.shape == (16, 16, 3)
    out, err = capfd.readouterr()
    stem = tmp_path / "out" / "picture"
    assert out.splitlines() == [f"{stem}{suffix}" for suffix in (".exr", ".png", ".json")]
    assert err == ""


@pytest.mark.slow
def test_without_llvm_rendering_goes_on_with_one_warning(tmp_path):
    path = scene_of_a_lit_floor(tmp_path)
    command = [sys.executable, "-m", "polywigner", "render", str(path)]
    command += ["--spp", "1", "--out", str(tmp_path / "a")]
    from polywigner.llvm import OFF_VARIABLE

    environment = {**os.environ, OFF_VARIABLE: "1"}
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert run.returncode == 0, run.stderr
    warnings = [line for line in run.stderr.splitlines() if line.startswith("polywigner: ")]
    assert len(warnings) == 1
    assert warnings[0].startswith("polywigner: warning: ")
    assert "scalar_rgb" in warnings[0]
    assert "slower" in warnings[0]
    assert json.loads((tmp_path / "a.json").read_text())["used"]["variant"] == "scalar_rgb"
