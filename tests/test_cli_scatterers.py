"""``polywigner scatterers`` writes clouds, and refuses what it cannot use with one sentence."""

import csv

import numpy as np
import pytest

from cli_scenes import PATH, WIGNER, receiver, rectangle, scene, source, written
from polywigner.cli import main

pytestmark = pytest.mark.drjit
pytest.importorskip("mitsuba")


@pytest.fixture(name="scene")
def street(tmp_path):
    floor = rectangle('<rotate x="1" angle="180"/><scale value="2"/><translate z="$height"/>')
    beside = receiver(WIGNER, pose='<translate x="0.1"/>')
    height = '<default name="height" value="1"/>'
    return written(tmp_path, scene(height, PATH.format(2), source(), beside, floor), half=1)


def run(scene, *options):
    words = ["scatterers", str(scene), "--variant", "scalar_rgb", "--count", "10", "--rays", "32"]
    return main([*words, *options])


def test_a_cloud_is_written_and_summed_up(scene, capfd):
    out = scene.with_name("cloud.csv")
    options = ("--define", "height=2", "--velocity", "floor=0,0,-1", "--out", str(out))
    assert run(scene, *options) == 0
    said = capfd.readouterr().out
    assert "receiver      rx" in said and said.rstrip().endswith(str(out))
    with out.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 10 and {row["shape"] for row in rows} == {"floor"}
    assert np.allclose([float(row["position_z"]) for row in rows], 2.0, atol=1e-5)
    assert all(-2 <= float(row["path_rate"]) < 0 for row in rows)
    assert run(scene, "--out", str(scene.with_name("cloud.vtp"))) == 0
    assert scene.with_name("cloud.vtp").read_bytes().startswith(b'<?xml version="1.0"?>\n<VTKFile')
    assert run(scene, "--out", f"{scene.parent}/folder/") == 0
    assert (scene.parent / "folder" / "scene_scatterers.csv").is_file()
