"""Receivers of scene files by batches in a store: the watts of one run, whoever samples them."""

import numpy as np
import pytest

from polywigner.cli import main
from polywigner.errors import StoreError

pytestmark = pytest.mark.drjit

_EXTRA = "the extra `volume` is not installed"
for _library in ("xarray", "zarr", "dask", "distributed"):
    pytest.importorskip(_library, reason=_EXTRA)

FLOOR = """<shape type="rectangle">
        <transform name="to_world">
            <rotate x="1" angle="180"/><translate z="0.3"/>
        </transform>
        <bsdf type="diffuse"/>
    </shape>"""
RECEIVER = """<sensor type="wigner_receiver" id="{name}">
        <string name="aperture" value="square.wkt"/>
        <string name="frequency" value="94 GHz"/>
        <transform name="to_world"><translate x="{x}"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="1"/><integer name="height" value="1"/>
            <rfilter type="box"/>
        </film>
        <sampler type="independent"><integer name="sample_count" value="32"/></sampler>
    </sensor>"""
SOURCE = """<shape type="wigner" id="{name}">
        <string name="aperture" value="square.wkt"/>
        <string name="frequency" value="94 GHz"/>
        <string name="estimator" value="exact"/>
    </shape>"""
BATCHES = 16


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "square.wkt").write_text("POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    parts = [RECEIVER.format(name="rx", x=0), RECEIVER.format(name="other", x=0.05), FLOOR]
    parts += [SOURCE.format(name="tx"), SOURCE.format(name="second")]
    path = tmp_path / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{"".join(parts)}</scene>')
    return path


# Threads of the renderer add up in any order.
LAST = 1e-5


def same(found, whole):
    """Whether all watts of all receivers are."""
    return all(np.allclose(a, b, rtol=LAST, atol=0) for a, b in zip(found, whole, strict=True))


def received(path, seed=0, **options):
    from polywigner.mitsuba.received import ReceiveOptions
    from polywigner.mitsuba.scene_renders import SceneFile, receive_parts

    file = SceneFile(path, "scalar_rgb")
    asked = ReceiveOptions(seed=seed)
    found = receive_parts(file, file.load(), asked, threads=1, **options)
    return [[part.scattered for part in each.contributions] for each in found]


def batches_in(store):
    files = ((store / "power" / "c").rglob("*")) if store.exists() else ()
    return {file: file.stat().st_mtime_ns for file in files if file.is_file()}


def test_batches_of_a_store_are_those_of_one_run_and_only_missing_ones_are_sampled(scene, tmp_path):
    whole, store = received(scene), tmp_path / "parts.zarr"
    assert np.shape(whole) == (2, 2) and np.min(whole) > 0
    assert same(received(scene, store=store), whole)
    before = batches_in(store)
    assert len(before) == 2 * BATCHES
    missing = sorted(before)[5]
    missing.unlink()
    assert same(received(scene, store=store), whole)
    after = batches_in(store)
    assert {file for file in before if after[file] != before[file]} == {missing}
    with pytest.raises(StoreError, match="seed"):
        received(scene, seed=1, store=store)


@pytest.mark.slow
def test_workers_of_a_cluster_find_the_same_watts(scene, tmp_path):
    import distributed

    whole = received(scene)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        store = tmp_path / "parts.zarr"
        found = received(scene, store=store, scheduler=cluster.scheduler_address)
        assert same(found, whole)


@pytest.mark.slow
def test_the_command_sweeps_the_batches_when_the_watts_are_known(scene, capfd):
    out = scene.parent / "out" / "watts"
    words = ["receive", str(scene), "--variant", "scalar_rgb", "--threads", "1", "--out", str(out)]
    # as of a run that was killed while it removed its store
    (out.parent / "watts.parts.zarr.partial" / "power").mkdir(parents=True)
    (out.parent / "watts.parts.zarr.lock").write_text("1 on elsewhere")
    assert main([*words, "--resumable"]) == 0
    assert sorted(path.name for path in out.parent.iterdir()) == ["watts.json", "watts.png"]
    assert main([*words, "--threads", "0"]) == 2
    assert main([*words, "--scheduler", "tcp://nowhere"]) == 2
    errors = capfd.readouterr().err
    assert "--threads as a whole number from 1" in errors and "Traceback" not in errors
