"""Stores of large results: values, continuation after interruptions, and NetCDF files."""

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import ArgumentError, EngineError, MissingExtraError, StoreError
from polywigner.propagation.stores import open_store, results_on_grid
from polywigner.transforms.xarray_arguments import labelled_array

_EXTRA = "the extra `datasets` is not installed"
xarray = pytest.importorskip("xarray", reason=_EXTRA)
for _library in ("zarr", "dask", "distributed", "h5netcdf", "h5py"):
    pytest.importorskip(_library, reason=_EXTRA)

X, Y = np.linspace(-1.0, 1.0, 23), np.linspace(0.0, 3.0, 17)
CHUNKS, REGIONS = (8, 5), 12


@dataclass(frozen=True)
class Beam:
    """A Gaussian profile; each evaluation adds a line to the file ``log``."""

    log: Path | None = None
    seconds: float = 0.0

    def __call__(self, origin, shape):
        if self.log is not None:
            with self.log.open("a") as file:
                file.write(f"{origin}\n")
        time.sleep(self.seconds)
        x, y = (axis[o : o + n] for axis, o, n in zip((X, Y), origin, shape, strict=True))
        return np.exp(-(x[:, None] ** 2 + y**2) / 0.7**2)


def beam(block=None, name="power", waist=0.7, chunks=CHUNKS, y=Y, dtype="float64"):
    """Return the arguments that describe the values of a block on a grid, and their chunks."""
    axes = {"x": labelled_array(X, ("x",), {"units": "m"}), "y": labelled_array(y, ("y",))}
    variables = {name: (block or Beam(), dtype, {"units": "W"})}
    return (variables, axes, {}, {"waist": waist}), {"chunks": chunks}


DIRECT = Beam()((0, 0), (len(X), len(Y)))


def written(path, described=None, threads=1, scheduler=None):
    values, options = described or beam()
    options |= {"out": path, "threads": threads, "scheduler": scheduler}
    return results_on_grid(*values, options, compiled=False)


def evaluations(log):
    return log.read_text().splitlines() if log.exists() else []


def chunk_files(store):
    """Return the time at which each chunk was written."""
    files = (p for name in open_store(store).data_vars for p in (store / name).glob("c/**/*"))
    return {p: p.stat().st_mtime_ns for p in files if p.is_file()}


@pytest.mark.parametrize("threads", [1, 3])
def test_a_second_run_computes_missing_regions_only(tmp_path, threads):
    store, log = tmp_path / "beam.zarr", tmp_path / "log"
    dataset = beam(Beam(log))
    written(store, dataset, threads)
    assert len(set(evaluations(log))) == len(evaluations(log)) == REGIONS
    log.unlink()
    np.testing.assert_array_equal(written(store, dataset, threads)["power"], DIRECT)
    assert not evaluations(log)
    for name in ("1/2", "2/0"):
        (store / "power" / "c" / name).unlink()
    assert np.isnan(open_store(store)["power"].values).sum() == 8 * 5 + 7 * 5
    np.testing.assert_array_equal(written(store, dataset, threads)["power"], DIRECT)
    assert sorted(evaluations(log)) == ["(16, 0)", "(8, 10)"]


def test_regions_of_nothing_but_nan_are_complete(tmp_path):
    def outside(origin, shape):
        return np.full(shape, np.nan)

    written(tmp_path / "nan.zarr", beam(outside))
    assert len(chunk_files(tmp_path / "nan.zarr")) == REGIONS
    written(tmp_path / "nan.zarr", beam(lambda origin, shape: 1 / 0))


_RUN = """
import sys
from pathlib import Path
import test_stores
if __name__ == "__main__":
    store, log, seconds, *scheduler = sys.argv[1:]
    dataset = test_stores.beam(test_stores.Beam(Path(log), float(seconds)))
    test_stores.written(Path(store), dataset, scheduler=scheduler[0] if scheduler else None)
"""


@contextmanager
def other_process(store, log, *scheduler, seconds=0.05):
    """Fill a store in another process, which is killed at the end of the block."""
    words = [sys.executable, "-c", _RUN, str(store), str(log), str(seconds), *scheduler]
    folders = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    with subprocess.Popen(words, env={**os.environ, "PYTHONPATH": folders}) as run:
        try:
            yield run
        finally:
            run.kill()


def wait_for(count, log, run):
    while len(evaluations(log)) < count:
        assert run.poll() is None, "the process has ended"
        time.sleep(0.005)


def test_a_run_that_was_killed_is_continued(tmp_path):
    store, log = tmp_path / "beam.zarr", tmp_path / "log"
    with other_process(store, log) as run:
        wait_for(4, log, run)
    assert 3 <= len(chunk_files(store)) < REGIONS
    np.testing.assert_array_equal(written(store, beam(Beam(log)))["power"], DIRECT)
    # Only the region in progress is computed twice.
    assert len(set(evaluations(log))) == REGIONS
    assert len(evaluations(log)) <= REGIONS + 1


@pytest.mark.slow
def test_a_killed_writer_and_a_killed_worker_of_a_cluster_lose_only_their_own_regions(tmp_path):
    from distributed import LocalCluster

    store, log = tmp_path / "beam.zarr", tmp_path / "log"
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        with other_process(store, log, cluster.scheduler_address, seconds=0.5) as run:
            wait_for(4, log, run)
        done, begun = len(evaluations(log)), []
        killer = threading.Thread(
            target=_kill_worker, args=(cluster, log, done + 2, begun), daemon=True
        )
        killer.start()
        result = written(store, beam(Beam(log, 0.2)), scheduler=cluster)
        killer.join()
    np.testing.assert_array_equal(result["power"], DIRECT)
    # Both workers were active when the writer was killed, and Dask recomputes all finished regions
    # of the killed worker, which are at most all regions of the second run so far.
    again = 2 + begun[0] - done
    assert len(set(evaluations(log))) == REGIONS
    assert len(evaluations(log)) <= REGIONS + again


def _kill_worker(cluster, log, count, begun):
    """Kill a worker after a number of regions, and record the number of regions at that time."""
    while len(evaluations(log)) < count:
        time.sleep(0.005)
    os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
    begun.append(len(evaluations(log)))


CHEVRON = pw.shapes.chevron(20e-3, 12e-3, 4e-3).with_illumination(
    pw.steering((0.48, 0.36, 0.8), 3.2e-3)
)
BOX = ((-20e-3, -15e-3, 30e-3), (10e-3, 15e-3, 60e-3))
AXIS, NU = np.linspace(-0.01, 0.01, 5), np.linspace(-300.0, 500.0, 4)
BOTH = {"method": ("wigner", "fraunhofer")}
AMPLITUDE = {"method": "rayleigh-sommerfeld-1", "quantity": "amplitude"}
CORNERS = ((-10e-3, 0, 30e-3), (10e-3, 0, 30e-3), (-10e-3, 5e-3, 50e-3))
BUILDERS = {
    "line": lambda **how: pw.line(CHEVRON, BOX, 7, 3.2e-3, **AMPLITUDE, **how),
    "plane": lambda **how: pw.plane(CHEVRON, CORNERS, (3, 4), 3.2e-3, method="fresnel", **how),
    "hemisphere": lambda **how: pw.hemisphere(
        CHEVRON, 50e-3, [-0.9, 0.0, 0.4], [0.0, 1.0], 3.2e-3, method="fraunhofer", **how
    ),
    "volume": lambda **how: pw.volume(CHEVRON, BOX, (4, 3, 3), 3.2e-3, **BOTH, **how),
    "wigner": lambda **how: pw.wigner_table(CHEVRON, AXIS, AXIS[1:], NU, NU[1:], **how),
    "ambiguity": lambda **how: pw.ambiguity_table(CHEVRON, NU, NU[1:], AXIS, AXIS[1:], **how),
}
SIZES = {
    "line": 3,
    "plane": (2, 3),
    "hemisphere": 2,
    "volume": (2, 3, 3),
    "wigner": (3, -1, -1, 2),
    "ambiguity": (-1, 2, -1, -1),
}


@pytest.mark.parametrize("name", BUILDERS)
def test_the_store_of_each_builder_is_the_direct_result_and_is_completed(name, tmp_path):
    direct, store = BUILDERS[name](), tmp_path / f"{name}.zarr"
    how = {"out": store, "chunks": SIZES[name], "engine": "numpy"}
    for _ in range(2):
        stored = BUILDERS[name](**how)
        for variable in direct.data_vars:
            scale = float(abs(direct[variable]).max())
            rounding = 1e-12 if direct[variable].dtype.itemsize > 8 else 5e-6
            np.testing.assert_allclose(
                stored[variable], direct[variable], rtol=0, atol=rounding * scale
            )
            assert stored[variable].attrs["units"] == direct[variable].attrs["units"]
        for axis in direct.coords:
            assert stored[axis].equals(direct[axis])
        assert pw.read_source(stored) == CHEVRON
        before = chunk_files(store)
        lost = max(before)
        assert chunk_files(store) == before
        BUILDERS[name](**how)  # computes nothing
        assert chunk_files(store) == before
        lost.unlink()
    assert not lost.exists()


def test_compiled_tables_do_not_depend_on_chunks_or_threads(tmp_path, llvm):
    import drjit

    before = drjit.thread_count()
    how = {"engine": "llvm", "precision": "double"}
    direct = BUILDERS["wigner"](**how)
    for threads in (1, None):
        out = tmp_path / f"{threads}.zarr"
        stored = BUILDERS["wigner"](out=out, threads=threads, chunks=(2, -1, -1, -1), **how)
        np.testing.assert_allclose(stored["W"], direct["W"], rtol=0, atol=1e-13 * CHEVRON.area)
    assert drjit.thread_count() == before


@pytest.mark.parametrize(
    "dataset",
    [
        lambda: beam(waist=0.8),
        lambda: beam(chunks=(8, 6)),
        lambda: beam(dtype="float32"),
        lambda: beam(y=2 * Y),
        lambda: beam(name="energy"),
    ],
    ids=["attribute", "chunks", "type", "coordinate", "variable"],
)
def test_a_store_of_other_settings_is_left_alone(tmp_path, dataset):
    store = tmp_path / "beam.zarr"
    written(store)
    before = chunk_files(store)
    with pytest.raises(StoreError, match=r"beam\.zarr contains results for other settings"):
        written(store, dataset())
    assert chunk_files(store) == before


@pytest.mark.parametrize("name", ["volume", "wigner"])
def test_another_source_engine_or_version_is_another_store(name, tmp_path, monkeypatch):
    how = {"out": tmp_path / "a.zarr", "chunks": SIZES[name]}
    BUILDERS[name](**how, engine="numpy")
    monkeypatch.setattr("test_stores.CHEVRON", pw.shapes.square(20e-3))
    with pytest.raises(StoreError, match="other settings"):
        BUILDERS[name](**how, engine="numpy")
    monkeypatch.undo()
    monkeypatch.setattr(pw, "__version__", "99.0")
    with pytest.raises(StoreError, match=r"\(differences: polywigner_version"):
        BUILDERS[name](**how, engine="numpy")


def _of_codec(path, codec):
    """Return a store whose chunks have another codec."""
    written(path)
    file = path / "power" / "zarr.json"
    table = json.loads(file.read_text())
    inner = {"name": "sharding_indexed", "configuration": {"codecs": [{"name": codec}]}}
    file.write_text(json.dumps({**table, "codecs": [inner]}))


@pytest.mark.parametrize(
    "make",
    [
        Path.mkdir,
        lambda path: path.write_text("precious"),
        lambda path: xarray.Dataset({"a": ("x", [1.0])}).to_zarr(path, zarr_format=2),
        lambda path: _of_codec(path, "numcodecs.pickle"),
        lambda path: (written(path), (path / "zarr.json").write_bytes(b'{"attributes"')),
    ],
    ids=["folder", "file", "format 2", "codec", "metadata"],
)
def test_something_else_at_the_path_is_one_error_and_stays(tmp_path, make):
    path = tmp_path / "precious.zarr"
    make(path)
    before = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*")}
    with pytest.raises(StoreError, match="there is no zarr store"):
        written(path)
    assert before == {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*")}
    with pytest.raises(StoreError, match="there is no zarr store"):
        pw.write_netcdf(path, tmp_path / "out.nc")


def test_a_path_that_cannot_be_written_to_is_one_error(tmp_path):
    (tmp_path / "file").write_text("precious")
    with pytest.raises(StoreError, match=r"cannot write to the store .*File exists"):
        written(tmp_path / "file" / "beam.zarr")
    with pytest.raises(ArgumentError, match="zarr cannot store these chunks"):
        written(tmp_path / "beam.zarr", beam(chunks=((3, 20), 17)))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("library", ["zarr", "dask"])
def test_without_the_extra_the_error_names_it(tmp_path, monkeypatch, library):
    dataset = beam()
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=r'pip install "polywigner\[datasets\]"'):
        written(tmp_path / "beam.zarr", dataset)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "scheduler", ["http://127.0.0.1:8786", "tcp://host", 3, "tcp://127.0.0.1:1"]
)
def test_a_scheduler_that_does_not_respond_leaves_nothing(tmp_path, monkeypatch, scheduler):
    monkeypatch.setattr("polywigner.propagation.stores._PATIENCE", 0.3)
    with pytest.raises(EngineError, match=r"no dask scheduler .* such as tcp://host:8786"):
        written(tmp_path / "beam.zarr", scheduler=scheduler)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "keywords", "words"),
    [
        ((AXIS, AXIS, AXIS, [[0.0]]), {}, r"expected nu_y to be finite numbers of shape \(n,\)"),
        ((AXIS, AXIS, [np.nan], AXIS), {}, "expected nu_x to be finite"),
        (
            (AXIS, AXIS, AXIS, AXIS),
            {"scheduler": "tcp://a:1"},
            "require out: expected the path of a store",
        ),
        ((AXIS, AXIS, AXIS, AXIS), {"precision": "half"}, "expected precision"),
        ((AXIS, AXIS, AXIS, AXIS, "w"), {"chunks": (2, 2)}, "expected chunks that dask accepts"),
        ((AXIS, AXIS, AXIS, AXIS, "w"), {"threads": 0}, "threads to be a whole number"),
        ((np.linspace(0, 1, 1000),) * 4, {}, "out to write it to disk"),
    ],
)
def test_wrong_arguments_of_a_table_leave_nothing(
    tmp_path, monkeypatch, arguments, keywords, words
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError, match=words):
        pw.wigner_table(CHEVRON, *arguments, **keywords)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "source",
    [
        CHEVRON,
        pw.Array([pw.shapes.square(4e-3), pw.shapes.square(5e-3)], weights=[1, 1j]),
        pw.phased_array(pw.shapes.square(4e-3), np.argwhere(np.ones((20, 20))) * 5e-3),
    ],
)
def test_sources_go_to_other_processes_without_what_they_have_cached(source):
    fresh = len(pickle.dumps(source))
    x, nu = np.random.default_rng(0).random((2, 50, 2))
    values = pw.wigner(source, x, nu, engine="numpy")
    for element in source.elements if isinstance(source, pw.Array) else (source,):
        _ = element.diameter, element.convex_cover, element.polygons, hash(element)
    again = pickle.dumps(source)
    assert len(again) == fresh
    np.testing.assert_array_equal(pw.wigner(pickle.loads(again), x, nu, engine="numpy"), values)


SQUARE = pw.shapes.square(1.0)
FREQUENCIES = np.linspace(-2.0, 2.0, 5)


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Return a table of W on disk, in chunks that do not divide its axes."""
    store = tmp_path_factory.mktemp("table") / "w.zarr"
    x = np.linspace(-0.5, 0.5, 6)
    chunks = (4, 3, 2, 4)
    pw.wigner_table(
        SQUARE, x, x + 0.125, FREQUENCIES, FREQUENCIES, store, chunks=chunks, engine="numpy"
    )
    return store


def test_netcdf_has_the_values_axes_and_units_of_a_store(table, tmp_path):
    pw.write_netcdf(table, tmp_path / "w.nc")
    with xarray.open_dataset(tmp_path / "w.nc", engine="h5netcdf") as result:
        stored = xarray.open_zarr(table)
        xarray.testing.assert_equal(result, stored)
        assert result["W"].attrs["units"] == "m2"
        assert result["nu_x"].attrs["units"] == "1/m"
        assert result.attrs == stored.attrs
    assert [file.name for file in tmp_path.iterdir()] == ["w.nc"]


def test_complex_values_become_their_two_parts(tmp_path):
    lags = np.linspace(-0.5, 0.25, 4)
    result = pw.ambiguity_table(
        SQUARE.moved((0.1, 0)), FREQUENCIES, FREQUENCIES, lags, lags, precision="double"
    )
    pw.write_netcdf(result, tmp_path / "a.nc")
    assert abs(result["A"].imag).max() > 0.05
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as file:
        np.testing.assert_array_equal(file["A_real"] + 1j * file["A_imag"], result["A"])
        assert file["A_imag"].attrs["units"] == "m2"


def test_what_is_no_dataset_is_refused(tmp_path):
    for given in (3, np.zeros(3)):
        with pytest.raises(ArgumentError, match=r"xarray\.Dataset or the path of a store"):
            pw.write_netcdf(given, tmp_path / "out")
    with pytest.raises(StoreError, match=r"no zarr store of format 3 at .*nowhere"):
        pw.write_netcdf("nowhere.zarr", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_a_write_that_fails_leaves_what_was_there(table, tmp_path):
    part = xarray.open_zarr(table).isel(nu_y=1, drop=True)
    (tmp_path / "taken").mkdir()
    with pytest.raises(ArgumentError, match="cannot write"):
        pw.write_netcdf(part, tmp_path / "taken")
    (tmp_path / "old").write_text("old")
    broken = part.map_blocks(lambda block: block / 0 + undefined, template=part)  # noqa: F821
    with pytest.raises(NameError):
        pw.write_netcdf(broken, tmp_path / "old")
    assert (tmp_path / "old").read_text() == "old"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["old", "taken"]
