"""Pictures of parts in a store: the bits of one run, whoever renders them, killed or not."""

import pickle
import shutil
import sys
from functools import partial

import numpy as np
import pytest

from polywigner.cli import main
from polywigner.errors import ArgumentError, EngineError, PolywignerWarning, SceneError, StoreError
from polywigner.propagation.stores import one_run

pytestmark = pytest.mark.drjit

_EXTRA = "the extra `volume` is not installed"
for _library in ("xarray", "zarr", "dask", "distributed"):
    pytest.importorskip(_library, reason=_EXTRA)


SCENE = """<scene version="3.0.0">
    <default name="height" value="64"/>
    <default name="samples" value="4"/>
    <default name="sensor" value="orthographic"/>
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="$sensor">
        <transform name="to_world">
            <scale x="0.02" y="0.02"/>
            <lookat origin="0, 0, 0.5" target="0, 0, 1" up="0, 1, 0"/>
        </transform>
        <sampler type="independent"><integer name="sample_count" value="$samples"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="8"/>
            <integer name="height" value="$height"/>
            <string name="pixel_format" value="luminance"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <shape type="wigner">
        <string name="aperture" value="square.wkt"/>
        <string name="frequency" value="94 GHz"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate x="1" angle="180"/><translate z="1"/></transform>
        <bsdf type="diffuse"/>
    </shape>
</scene>
"""
# Of a strip of the film, 64 rows high: four parts.
ROWS = 16
PARTS = 4


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "square.wkt").write_text("POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    path = tmp_path / "scene.xml"
    path.write_text(SCENE)
    return path


@pytest.fixture(autouse=True)
def short_strips(monkeypatch):
    import polywigner.mitsuba  # noqa: F401 (chooses the LLVM library)

    monkeypatch.setattr("polywigner.mitsuba.films._SCALAR_ROWS", ROWS)


def rendered(path, **options):
    """By one thread: in how many Mitsuba's scalar variants cut a small strip depends on them."""
    import polywigner.mitsuba as pwm

    return pwm.render_file(path, **{"variant": "scalar_rgb", "threads": 1, **options})


def parts_of(store):
    """The finished parts, and when each was written."""
    files = (store / "radiance" / "c").rglob("*") if store.exists() else ()
    found = (file for file in files if not file.name.endswith(".partial"))
    return {file: file.stat().st_mtime_ns for file in found if file.is_file()}


def test_a_picture_of_parts_is_that_of_one_run_and_is_not_rendered_twice(scene, tmp_path):
    whole, store = rendered(scene), tmp_path / "parts.zarr"
    assert whole.shape == (64, 8, 1) and whole.max() > 0
    assert np.array_equal(rendered(scene, store=store), whole)
    before = parts_of(store)
    assert len(before) == PARTS
    assert np.array_equal(rendered(scene, store=store), whole)
    assert parts_of(store) == before


def test_only_parts_that_are_missing_or_damaged_are_rendered_anew(scene, tmp_path):
    store = tmp_path / "parts.zarr"
    whole = rendered(scene, store=store)
    kept, lost, torn, other = sorted(before := parts_of(store))
    lost.unlink()
    content = bytearray(torn.read_bytes())
    content[100] ^= 1
    torn.write_bytes(content)
    with pytest.warns(PolywignerWarning, match="1 of the 4 chunks"):
        assert np.array_equal(rendered(scene, store=store), whole)
    after = parts_of(store)
    assert {file for file in after if after[file] != before[file]} == {lost, torn}
    assert {kept, other} <= set(after)


def test_another_picture_is_not_mixed_with_the_parts_that_are_there(scene, tmp_path):
    store = tmp_path / "parts.zarr"
    rendered(scene, store=store)
    before = parts_of(store)
    for options, named in (
        ({"seed": 1}, "seed 1 "),
        ({"integrator": "direct"}, "integrator 'direct'"),
        ({"parameters": {"samples": 8}}, "parameters"),
    ):
        with pytest.raises(StoreError, match=f"differs in {named}"):
            rendered(scene, store=store, **options)
    (tmp_path / "square.wkt").write_text("POLYGON ((-4 -5, 5 -5, 5 5, -5 5, -4 -5))")
    with pytest.raises(StoreError, match=r"differs in file square\.wkt"):
        rendered(scene, store=store)
    assert parts_of(store) == before


def test_parts_that_are_sent_to_another_process_load_the_scene_there(scene):
    import polywigner as pw
    import polywigner.mitsuba as pwm
    from polywigner.mitsuba.rendering import exposed
    from polywigner.mitsuba.scene_renders import SceneFile, SceneJob, tile

    scene.write_text(scene.read_text().replace("square.wkt", "$key"))
    key = pwm.register_source(pw.shapes.square(3e-3))
    file = SceneFile(scene, "scalar_rgb", None, {"key": key})
    scene_here = file.load()
    cut = exposed(scene_here).cut
    parts = SceneJob(file, scene_here, partial(tile, cut, None, 0, 0))
    copy = pickle.loads(pickle.dumps(parts))
    assert copy.scene is None
    for top in (0, 48):
        place = ((0, top, 0, 0), (1, 16, 8, 3))
        assert np.array_equal(copy(*place), parts(*place))
    copy.check()
    scene.write_text(scene.read_text() + "<!-- of another machine -->")
    with pytest.raises(StoreError, match=r"see the scene's file .*scene\.xml, got another one on"):
        copy.check()
    copy.mitsuba = "3.0.0"
    with pytest.raises(StoreError, match=r"mitsuba 3\.0\.0 on every worker"):
        copy.check()


def test_bad_requests_are_refused_and_leave_nothing(scene, tmp_path, monkeypatch):
    monkeypatch.setattr("polywigner.propagation.stores._PATIENCE", 0.3)
    before, store = set(tmp_path.iterdir()), tmp_path / "parts.zarr"
    with pytest.raises(ArgumentError, match="store with a scheduler"):
        rendered(scene, scheduler="tcp://127.0.0.1:1")
    with pytest.raises(EngineError, match="scheduler at 'tcp://127"):
        rendered(scene, scheduler="tcp://127.0.0.1:1", store=store)
    with pytest.raises(ArgumentError, match="threads"):
        rendered(scene, threads=0)
    with pytest.raises(SceneError, match="no_such_integrator"):
        rendered(scene, integrator="no_such_integrator", store=store)
    assert set(tmp_path.iterdir()) == before


def command_line(scene, *options):
    out = str(scene.parent / "out" / "picture")
    words = ["render", str(scene), "--variant", "scalar_rgb", "--threads", "1", "--out", out]
    return main([*words, *options])


def test_the_command_sweeps_the_parts_when_the_picture_is_done(scene, capfd):
    out = scene.parent / "out"
    assert command_line(scene) == 0
    whole = (out / "picture.exr").read_bytes()
    names = sorted(path.name for path in out.iterdir())
    assert command_line(scene, "--resumable") == 0
    assert sorted(path.name for path in out.iterdir()) == names
    assert (out / "picture.exr").read_bytes() == whole
    shutil.rmtree(out)
    capfd.readouterr()
    assert command_line(scene, "--resumable") == 0
    assert capfd.readouterr().err == f"polywigner: made the folder {out}\n"


def test_a_second_start_is_refused_in_one_line(scene, capfd):
    store = scene.parent / "out" / "picture.parts.zarr"
    whole = rendered(scene, store=store)
    with one_run(store):
        assert command_line(scene, "--resumable") == 2
    first = capfd.readouterr().err
    assert "expected no other run to write to" in first and first.count("\n") == 1
    assert np.array_equal(rendered(scene, store=store), whole)


def test_without_the_extra_the_command_names_it(scene, capfd, monkeypatch):
    monkeypatch.setitem(sys.modules, "zarr", None)
    assert command_line(scene, "--scheduler", "tcp://127.0.0.1:1") == 2
    stderr = capfd.readouterr().err
    assert 'pip install ".[volume]"' in stderr and stderr.count("\n") == 1
    assert not (scene.parent / "out").exists()
