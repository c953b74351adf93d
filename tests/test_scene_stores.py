"""Renders and received power of scene files, in parts on disk or on a cluster."""

import pickle
import sys
from functools import partial

import numpy as np
import pytest

import polywigner as pw
from cli_scenes import camera, receiver, rectangle, scene, written
from polywigner.cli import main
from polywigner.errors import ArgumentError, EngineError, SceneError, StoreError

pytestmark = pytest.mark.drjit

_EXTRA = "the extra `datasets` is not installed"
for _library in ("xarray", "zarr", "dask", "distributed"):
    pytest.importorskip(_library, reason=_EXTRA)

SENSOR = camera(
    0.02, '<lookat origin="0, 0, 0.5" target="0, 0, 1" up="0, 1, 0"/>', (2, 64), "$samples"
)
SAMPLER = '<sampler type="independent"><integer name="sample_count" value="16"/></sampler>'
FLOOR = rectangle('<rotate x="1" angle="180"/><translate z="1"/>', '<bsdf type="diffuse"/>')
DEFAULTS = """<default name="samples" value="4"/><default name="outline" value="square.wkt"/>
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>"""
# Number of rows per strip of a film with 64 rows, number of strips, and number of batches.
ROWS, STRIPS, BATCHES = 16, 4, 16
# Rounding error, because the threads of the renderer add in any order.
LAST = 1e-5


def scene_of(folder, *parts):
    return written(folder, scene(DEFAULTS, *parts, FLOOR))


def tx(name="tx", estimator="exact"):
    return f"""<shape type="wigner" id="{name}">
        <string name="aperture" value="$outline"/>
        <string name="frequency" value="94 GHz"/>
        <string name="estimator" value="{estimator}"/>
    </shape>"""


def rx(name="rx", x=0.0):
    return receiver(SAMPLER, pose=f'<translate x="{x}"/>', name=name)


@pytest.fixture
def camera_scene(tmp_path):
    return scene_of(tmp_path, SENSOR, tx(estimator="wigner"))


@pytest.fixture
def receiver_scene(tmp_path):
    return scene_of(tmp_path, rx(), rx("other", 0.05), tx(), tx("second"))


@pytest.fixture(autouse=True)
def short_strips(monkeypatch):
    import polywigner.mitsuba  # noqa: F401 (chooses the LLVM library)

    monkeypatch.setattr("polywigner.mitsuba.plugins.films._SCALAR_ROWS", ROWS)


def rendered(path, **options):
    """Render with one thread, because the number of threads affects scalar variants."""
    import polywigner.mitsuba as pwm

    return pwm.render_file(path, **{"variant": "scalar_rgb", "threads": 1, **options})


def received(path, seed=0, **options):
    from polywigner.mitsuba.receive.power_results import ReceiveOptions
    from polywigner.mitsuba.scenes.scene_renders import SceneFile, receive_parts

    file = SceneFile(path, "scalar_rgb")
    powers, _ = receive_parts(file, file.load(), ReceiveOptions(seed=seed), threads=1, **options)
    return np.array([[part.scattered for part in one.contributions] for one in powers])


def parts_of(store, name):
    """Return the time at which each complete part was written."""
    files = (store / name / "c").rglob("*")
    return {file: file.stat().st_mtime_ns for file in files if file.is_file()}


def check_completed(compute, store, name, count):
    """Check that a store gives the direct result, and that only a lost part is recomputed."""
    direct = compute()
    assert np.isfinite(direct).all() and np.max(direct) > 0
    for _ in range(2):
        np.testing.assert_allclose(compute(store=store), direct, rtol=LAST)
        parts = parts_of(store, name)
    assert len(parts) == count
    lost = sorted(parts)[count // 3]
    lost.unlink()
    np.testing.assert_allclose(compute(store=store), direct, rtol=LAST)
    again = parts_of(store, name)
    assert {file for file in again if again[file] != parts.get(file)} == {lost}


def test_a_render_in_a_store_is_that_of_one_run_and_is_completed(camera_scene, tmp_path):
    check_completed(partial(rendered, camera_scene), tmp_path / "r.zarr", "radiance", STRIPS)


def test_received_powers_in_a_store_are_those_of_one_run(receiver_scene, tmp_path):
    store = tmp_path / "r.zarr"
    check_completed(partial(received, receiver_scene), store, "power", 2 * BATCHES)
    with pytest.raises(StoreError, match="other settings"):
        received(receiver_scene, seed=1, store=store)


def test_another_image_is_not_mixed_with_the_parts_in_a_store(camera_scene, tmp_path):
    store = tmp_path / "r.zarr"
    rendered(camera_scene, store=store)
    before = parts_of(store, "radiance")
    for options in ({"seed": 1}, {"integrator": "direct"}, {"parameters": {"samples": 8}}):
        with pytest.raises(StoreError, match="other settings"):
            rendered(camera_scene, store=store, **options)
    (tmp_path / "square.wkt").write_text("POLYGON ((-4 -5, 5 -5, 5 5, -5 5, -4 -5))")
    with pytest.raises(StoreError, match="other settings"):
        rendered(camera_scene, store=store)
    assert parts_of(store, "radiance") == before


def test_another_process_loads_the_scene_and_its_sources_itself(camera_scene):
    import polywigner.mitsuba as pwm
    from polywigner.mitsuba.scenes.rendering import exposed
    from polywigner.mitsuba.scenes.scene_renders import SceneFile, SceneParts, strip

    key = pwm.register_source(pw.shapes.square(3e-3))
    file = SceneFile(camera_scene, "scalar_rgb", {"outline": key})
    loaded = file.load()
    parts = SceneParts(file, loaded, partial(strip, exposed(loaded).cut, {}))
    copy = pickle.loads(pickle.dumps(parts))
    assert copy.scene is None
    for top in (0, 48):
        part = ((top, 0, 0), (16, 2, 3))
        np.testing.assert_array_equal(copy(*part), parts(*part))


@pytest.mark.slow
def test_workers_of_a_cluster_render_and_receive_the_same(camera_scene, tmp_path, monkeypatch):
    from distributed import LocalCluster

    image = rendered(camera_scene)
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        for number, scheduler in enumerate((cluster, cluster.scheduler_address)):
            store = tmp_path / f"{number}.zarr"
            result = rendered(camera_scene, store=store, scheduler=scheduler)
            np.testing.assert_allclose(result, image, rtol=LAST)
        (tmp_path / "b").mkdir()
        path = scene_of(tmp_path / "b", rx(), tx())
        power = received(path, store=tmp_path / "p.zarr", scheduler=cluster.scheduler_address)
    np.testing.assert_allclose(power, received(path), rtol=LAST)


def test_wrong_requests_leave_nothing(camera_scene, tmp_path, monkeypatch):
    monkeypatch.setattr("polywigner.propagation.stores._PATIENCE", 0.3)
    before, store = set(tmp_path.iterdir()), tmp_path / "r.zarr"
    for options, error, words in (
        ({"scheduler": "tcp://127.0.0.1:1"}, ArgumentError, "scheduler= requires a store"),
        ({"scheduler": "tcp://127.0.0.1:1", "store": store}, EngineError, "at 'tcp://127"),
        ({"threads": 0}, ArgumentError, "threads"),
        ({"integrator": "no_such", "store": store}, SceneError, "no_such"),
    ):
        with pytest.raises(error, match=words):
            rendered(camera_scene, **options)
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize("command", ["render", pytest.param("receive", marks=pytest.mark.slow)])
@pytest.mark.usefixtures("unrendered_figures")
def test_the_command_removes_the_parts_when_its_files_are_written(command, request, capfd):
    path = request.getfixturevalue("camera_scene" if command == "render" else "receiver_scene")
    out = path.parent / "out" / "result"
    words = [command, str(path), "--variant", "scalar_rgb", "--threads", "1", "--out", str(out)]
    assert main([*words, "--resumable"]) == 0
    files = {path.name for path in out.parent.iterdir()}
    exr = {"result.exr"} if command == "render" else set()
    assert files == {"result.json", "result.png"} | exr
    assert capfd.readouterr().err == ""
    parts = out.parent / "result.parts.zarr"
    parts.mkdir()
    assert main([*words, "--resumable"]) == 2
    assert main([*words, "--scheduler", "tcp://nowhere"]) == 2
    errors = capfd.readouterr().err
    assert "there is no zarr store" in errors and "Traceback" not in errors
    assert errors.count("\n") == 2


def test_without_the_extra_the_command_names_it(camera_scene, capfd, monkeypatch):
    monkeypatch.setitem(sys.modules, "zarr", None)
    assert main(["render", str(camera_scene), "--scheduler", "tcp://127.0.0.1:1"]) == 2
    stderr = capfd.readouterr().err
    assert 'pip install "polywigner[datasets]"' in stderr and stderr.count("\n") == 1
