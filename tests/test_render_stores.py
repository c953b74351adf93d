"""Pictures of parts in a store: the bits of one run, whoever renders them, killed or not."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polywigner.cli import main
from polywigner.errors import (
    ArgumentError,
    EngineError,
    PolywignerWarning,
    SceneError,
    StoreError,
)
from polywigner.propagation.stores import one_run

pytestmark = pytest.mark.drjit

_EXTRA = "the extra `volume` is not installed"
for _library in ("xarray", "zarr", "dask", "distributed"):
    pytest.importorskip(_library, reason=_EXTRA)

Captured = pytest.CaptureFixture[str]

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
def scene(tmp_path: Path) -> Path:
    (tmp_path / "square.wkt").write_text("POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    path = tmp_path / "scene.xml"
    path.write_text(SCENE)
    return path


@pytest.fixture(autouse=True)
def short_strips(monkeypatch: pytest.MonkeyPatch) -> None:
    import polywigner.mitsuba  # noqa: F401 (chooses the LLVM library)

    monkeypatch.setattr("polywigner.mitsuba.films._SCALAR_ROWS", ROWS)


def rendered(path: Path, **options: Any) -> np.ndarray:
    """By one thread: in how many Mitsuba's scalar variants cut a small strip depends on them."""
    import polywigner.mitsuba as pwm

    return pwm.render_file(path, **{"variant": "scalar_rgb", "threads": 1, **options})


def parts_of(store: Path) -> dict[Path, int]:
    """The finished parts, and when each was written."""
    files = (store / "radiance" / "c").rglob("*") if store.exists() else ()
    found = (file for file in files if not file.name.endswith(".partial"))
    return {file: file.stat().st_mtime_ns for file in found if file.is_file()}


def test_a_picture_of_parts_is_that_of_one_run_and_is_not_rendered_twice(
    scene: Path, tmp_path: Path
) -> None:
    whole, store = rendered(scene), tmp_path / "parts.zarr"
    assert whole.shape == (64, 8, 1) and whole.max() > 0
    assert np.array_equal(rendered(scene, store=store), whole)
    before = parts_of(store)
    assert len(before) == PARTS
    assert np.array_equal(rendered(scene, store=store), whole)
    assert parts_of(store) == before


def test_only_parts_that_are_missing_or_damaged_are_rendered_anew(
    scene: Path, tmp_path: Path
) -> None:
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


def test_another_picture_is_not_mixed_with_the_parts_that_are_there(
    scene: Path, tmp_path: Path
) -> None:
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


def test_sets_of_passes_of_a_sensor_that_has_no_strips_add_up_to_the_same_bits(
    scene: Path, tmp_path: Path, llvm: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("polywigner.mitsuba.films.WAVEFRONT", 8 * 64)
    store = tmp_path / "parts.zarr"
    # Mitsuba puts one pixel on the film of a radiance meter alone
    text = scene.read_text().replace('name="width" value="8"', 'name="width" value="1"')
    scene.write_text(text.replace('<scale x="0.02" y="0.02"/>', ""))
    parameters = {"height": 1, "samples": 3 * 8 * 64 - 1, "sensor": "radiancemeter"}
    options: dict[str, Any] = {"variant": "llvm_ad_mono", "parameters": parameters}
    whole = rendered(scene, **options)
    assert whole.shape == (1, 1, 1) and whole[0, 0, 0] > 0
    assert np.array_equal(rendered(scene, **options, store=store), whole)
    assert len(parts_of(store)) == 3


def test_samples_of_a_strip_are_cut_into_passes_only_where_one_row_has_too_many(
    llvm: object,
) -> None:
    from types import SimpleNamespace as Stub

    import mitsuba as mi

    from polywigner.mitsuba.films import tiling_of

    mi.set_variant("llvm_ad_mono")
    for width, height, samples in ((480, 480, 1600), (360, 180, 324), (1000, 999, 4099)):
        film = Stub(crop_size=lambda size=(width, height): size)
        camera = Stub(class_name=lambda: "PerspectiveCamera", film=lambda film=film: film)
        cut = tiling_of(camera, samples)
        assert cut.passes == cut.sets == 1
        assert cut.strips * cut.rows >= height > (cut.strips - 1) * cut.rows
    vast = tiling_of(camera, 2**24)
    assert (vast.rows, vast.passes, vast.sets) == (1, 1001, 67)
    assert [n for k in range(vast.sets) for n in vast.passes_of(k)] == list(range(vast.passes))


def test_parts_that_are_sent_to_another_process_load_the_scene_there(scene: Path) -> None:
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


def test_bad_requests_are_refused_and_leave_nothing(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


COUNTS_THREADS = """
import sys
import drjit
import numpy
import polywigner.mitsuba as pwm
import mitsuba
mitsuba.set_variant("scalar_rgb")
drjit.set_thread_count(3)
found = []
class Counts(mitsuba.SamplingIntegrator):
    def render(self, scene, sensor, *arguments, **options):
        found.append(drjit.thread_count())
        return mitsuba.TensorXf(numpy.zeros((64, 8, 1)))
mitsuba.register_integrator("counts_threads", Counts)
pwm.render_file(sys.argv[1], "counts_threads", variant="scalar_rgb", threads=1)
assert set(found) == {1}, found
assert drjit.thread_count() == 3
"""


def test_threads_are_those_asked_for_and_then_as_many_as_before_even_without_llvm(
    scene: Path,
) -> None:
    environment = {**os.environ, "POLYWIGNER_NO_LLVM": "1"}
    command = [sys.executable, "-c", COUNTS_THREADS, str(scene)]
    subprocess.run(command, check=True, timeout=60, env=environment)


def command_line(scene: Path, *options: str) -> int:
    out = str(scene.parent / "out" / "picture")
    words = ["render", str(scene), "--variant", "scalar_rgb", "--threads", "1", "--out", out]
    return main([*words, *options])


def test_the_command_sweeps_the_parts_when_the_picture_is_done(
    scene: Path, capfd: Captured
) -> None:
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


def test_a_second_start_and_other_settings_are_refused_in_one_line(
    scene: Path, capfd: Captured
) -> None:
    store = scene.parent / "out" / "picture.parts.zarr"
    whole = rendered(scene, store=store)
    with one_run(store):
        assert command_line(scene, "--resumable") == 2
    first = capfd.readouterr().err
    assert "expected no other run to write to" in first and first.count("\n") == 1
    assert command_line(scene, "--resumable", "--seed", "5") == 2
    second = capfd.readouterr().err
    assert "differs in seed 5 (there: 0)" in second and second.count("\n") == 1
    assert np.array_equal(rendered(scene, store=store), whole)


@pytest.mark.parametrize("library", ["zarr", "distributed"])
def test_without_the_extra_the_command_names_it(
    scene: Path, capfd: Captured, monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    assert command_line(scene, "--scheduler", "tcp://127.0.0.1:1") == 2
    stderr = capfd.readouterr().err
    assert 'pip install ".[volume]"' in stderr and stderr.count("\n") == 1
    assert not (scene.parent / "out").exists()


def wait_for(store: Path, count: int, until: float = 60.0) -> None:
    end = time.monotonic() + until
    while len(parts_of(store)) < count:
        assert time.monotonic() < end, f"{len(parts_of(store))} parts after {until} s"
        time.sleep(0.002)


@pytest.mark.slow
def test_a_killed_worker_costs_time_and_no_bit_of_the_picture(scene: Path, tmp_path: Path) -> None:
    import distributed

    store, many = tmp_path / "parts.zarr", {"height": 20 * ROWS, "samples": 8}
    whole = rendered(scene, parameters=many)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        victim, at_death = cluster.workers[0].pid, []

        def kill() -> None:
            wait_for(store, 4)
            os.kill(victim, signal.SIGKILL)
            at_death.append(len(parts_of(store)))

        killer = threading.Thread(target=kill)
        killer.start()
        image = rendered(scene, parameters=many, store=store, scheduler=cluster.scheduler_address)
        killer.join()
        assert 4 <= at_death[0] < 20 == len(parts_of(store))
        assert np.array_equal(image, whole)
        # what a worker finds wrong comes as an error of the package, and leaves nothing
        light = '<emitter type="constant"><rgb name="radiance" value="1e39"/></emitter>'
        scene.write_text(scene.read_text().replace("</scene>", f"{light}</scene>"))
        other = tmp_path / "other.zarr"
        with pytest.raises(SceneError, match="expected radiance that is finite"):
            rendered(scene, store=other, scheduler=cluster.scheduler_address)
        assert not other.exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_command_that_is_ended_goes_on_with_what_is_missing(
    scene: Path, number: signal.Signals
) -> None:
    text = scene.read_text().replace('"height" value="64"', '"height" value="640"')
    scene.write_text(text.replace('"samples" value="4"', '"samples" value="8"'))
    whole, store = rendered(scene), scene.parent / "picture.parts.zarr"
    command = [sys.executable, "-m", "polywigner", "render", str(scene), "--resumable"]
    command += ["--variant", "scalar_rgb", "--threads", "1", "--out", str(scene.parent / "picture")]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as run:
        wait_for(store, 3)
        run.send_signal(number)
        _, errors = run.communicate(timeout=20)
    expected = (130, b"polywigner: interrupted\n") if number == signal.SIGINT else (-number, b"")
    assert (run.returncode, errors) == expected
    before = parts_of(store)
    assert 3 <= len(before) < 20
    assert np.array_equal(rendered(scene, store=store), whole)
    after = parts_of(store)
    assert len(after) == 20 and {file: after[file] for file in before} == before
    assert subprocess.run(command, check=False).returncode == 0
    assert not store.exists() and (scene.parent / "picture.exr").exists()
