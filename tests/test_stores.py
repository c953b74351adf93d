"""Large arrays on disk: a run that is taken up equals one that was not disturbed, nothing half
written can pass for a result, and what is there already is never overwritten."""

import json
import resource
import shutil
import signal
import sys
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from polywigner.errors import (
    ArgumentError,
    EngineError,
    MissingExtraError,
    PolywignerWarning,
    StoreError,
)
from polywigner.propagation.stores import write_dataset
from polywigner.propagation.stores_checks import Layout
from polywigner.transforms.xarray_arguments import labelled_array
from stored import chunk_files, hashes

_EXTRA = "the extra `volume` is not installed"
xarray = pytest.importorskip("xarray", reason=_EXTRA)
for _library in ("zarr", "dask", "distributed"):
    pytest.importorskip(_library, reason=_EXTRA)

X, Y = np.linspace(-1.0, 1.0, 23), np.linspace(0.0, 3.0, 17)
LAYOUT = Layout(
    "gaussian",
    "float64",
    {
        "x": labelled_array(X, ("x",), {"units": "m"}),
        "y": labelled_array(Y, ("y",), {"units": "m"}),
    },
    (8, 5),
    {"units": "W m-2"},
    {"title": "a beam"},
)
SETTINGS = {"waist": 0.7}


@dataclass(frozen=True)
class Beam:
    """A Gaussian beam's profile; counts the blocks that it is asked for by files in a folder."""

    counted: Path | None = None

    def __call__(self, origin, shape):
        if self.counted is not None:
            (self.counted / "-".join(map(str, origin))).touch()
        x, y = (axis[o : o + n] for axis, o, n in zip((X, Y), origin, shape, strict=True))
        return np.exp(-(x[:, None] ** 2 + y**2) / 0.7**2)


def test_a_store_holds_the_values_the_axes_and_their_units(tmp_path):
    written = write_dataset(tmp_path / "beam.zarr", LAYOUT, Beam(), SETTINGS)
    with xarray.open_zarr(tmp_path / "beam.zarr") as found:
        assert found.identical(written)
        np.testing.assert_array_equal(found["gaussian"], Beam()((0, 0), (23, 17)))
        np.testing.assert_array_equal(found["x"], X)
        assert found["gaussian"].dims == ("x", "y")
        assert found["gaussian"].attrs["units"] == "W m-2"
        assert found["y"].attrs["units"] == "m"
        assert found.attrs["title"] == "a beam"
        assert json.loads(found.attrs["polywigner_settings"])["waist"] == 0.7
        assert found["gaussian"].chunks == ((8, 8, 7), (5, 5, 5, 2))


def test_a_run_that_is_taken_up_computes_only_what_is_missing(tmp_path):
    store, counted = tmp_path / "beam.zarr", tmp_path / "counted"
    counted.mkdir()
    write_dataset(store, LAYOUT, Beam(), SETTINGS)
    whole = hashes(store)
    for name in ("gaussian/c/1/2", "gaussian/c/2/0"):
        (store / name).unlink()
    write_dataset(store, LAYOUT, Beam(counted), SETTINGS)
    assert {file.name for file in counted.iterdir()} == {"8-10", "16-0"}
    assert hashes(store) == whole
    found = write_dataset(store, LAYOUT, lambda origin, shape: None, SETTINGS)  # is only opened
    assert float(found["gaussian"][11, 0]) == 1.0


def test_chunks_of_nothing_but_nan_are_results_too(tmp_path):
    def outside(origin, shape):
        return np.full(shape, np.nan)

    write_dataset(tmp_path / "nan.zarr", LAYOUT, outside, {})
    assert len(hashes(tmp_path / "nan.zarr")) == LAYOUT.count + len(LAYOUT.coords)


def test_what_a_killed_run_left_half_written_is_swept(tmp_path):
    store = tmp_path / "beam.zarr"
    write_dataset(store, LAYOUT, Beam(), SETTINGS)
    whole = hashes(store)
    partial = store / "gaussian/c/0/0.0123.partial"
    partial.write_bytes(b"half a chu")
    (store / "gaussian/c/0/1").write_bytes(b"")  # a power cut, on some file systems
    with pytest.warns(PolywignerWarning, match="1 of the 12 chunks"):
        write_dataset(store, LAYOUT, Beam(), SETTINGS)
    assert not partial.exists()
    assert hashes(store) == whole


def test_a_chunk_that_comes_after_its_store_was_removed_does_not_bring_it_back(tmp_path):
    store = tmp_path / "beam.zarr"

    def removes(origin, shape):
        shutil.rmtree(store, ignore_errors=True)
        return Beam()(origin, shape)

    with pytest.raises(StoreError, match="got none any more"):
        write_dataset(store, LAYOUT, removes, SETTINGS, exclusive=False, threads=1)
    assert not list(tmp_path.iterdir())


def test_a_link_where_the_store_is_made_is_neither_followed_nor_removed(tmp_path):
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "data").write_text("of others")
    link = tmp_path / "beam.zarr.partial"
    link.symlink_to(tmp_path / "precious")
    with pytest.raises(StoreError, match="expected to make the folder"):
        write_dataset(tmp_path / "beam.zarr", LAYOUT, Beam(), SETTINGS)
    assert link.is_symlink() and [p.name for p in (tmp_path / "precious").iterdir()] == ["data"]


@pytest.mark.parametrize("library", ["zarr", "dask"])
def test_without_the_extra_the_error_names_it(tmp_path, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=r'pip install "\.\[volume\]"'):
        write_dataset(tmp_path / "beam.zarr", LAYOUT, Beam(), SETTINGS)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("layout", "settings", "named"),
    [
        (LAYOUT, {"waist": 0.8}, "waist 0.8 (there: 0.7)"),
        (replace(LAYOUT, chunks=(8, 6)), SETTINGS, "chunks [8, 6] (there: [8, 5])"),
        (replace(LAYOUT, dtype="float32"), SETTINGS, "dtype 'float32'"),
        (
            replace(LAYOUT, coords={**LAYOUT.coords, "y": labelled_array(2 * Y, ("y",))}),
            SETTINGS,
            "coordinate y",
        ),
    ],
)
def test_a_store_of_other_settings_is_refused_and_they_are_named(
    tmp_path, layout, settings, named, monkeypatch
):
    store = tmp_path / "beam.zarr"
    write_dataset(store, LAYOUT, Beam(), SETTINGS)
    whole = hashes(store)
    with pytest.raises(StoreError, match="same settings") as caught:
        write_dataset(store, layout, Beam(), settings)
    assert named in str(caught.value)
    assert hashes(store) == whole
    monkeypatch.setattr(pw, "__version__", "99.0")
    with pytest.raises(StoreError, match=r"polywigner '99\.0'"):
        write_dataset(store, LAYOUT, Beam(), SETTINGS)


@pytest.mark.parametrize("make", [Path.mkdir, lambda path: path.write_text("precious")])
def test_other_data_at_the_place_stays(tmp_path, make):
    place = tmp_path / "precious"
    make(place)
    with pytest.raises(StoreError, match="something else there"):
        write_dataset(place, LAYOUT, Beam(), SETTINGS)
    assert place.is_dir() or place.read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]


@pytest.mark.parametrize("path", ["", b"x.zarr"])
def test_what_is_no_path_is_refused(path):
    with pytest.raises(ArgumentError, match="expected a path"):
        write_dataset(path, LAYOUT, Beam(), SETTINGS)


def test_more_than_the_disk_has_is_refused_before_the_work(tmp_path):
    axis = labelled_array(np.arange(2.0**20), ("x",))
    vast = Layout("v", "float64", {"x": axis, "y": axis, "z": axis}, (2**20, 2**20, 2**20))
    with pytest.raises(StoreError, match="GiB of free space"):
        write_dataset(tmp_path / "vast.zarr", vast, Beam(), SETTINGS)
    assert not list(tmp_path.iterdir())


def test_a_write_that_the_system_refuses_is_one_clear_error(tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def line(samples):
        axis = labelled_array(np.random.default_rng(0).random(samples), ("x",))
        return Layout("v", "complex128", {"x": axis}, (samples,))

    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limits[1]))
        with pytest.raises(StoreError, match="expected to make the folder"):
            write_dataset(tmp_path / "axis.zarr", line(1 << 20), Beam(), {})
        assert not list(tmp_path.iterdir())
        store = tmp_path / "chunk.zarr"
        with pytest.raises(StoreError, match="expected to write to"):
            write_dataset(store, line(1 << 14), lambda origin, shape: np.ones(shape, complex), {})
        assert not list(tmp_path.iterdir())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)


def test_a_block_of_the_wrong_shape_is_not_stored(tmp_path):
    store = tmp_path / "beam.zarr"
    with pytest.raises(ArgumentError, match=r"expected the block at \(0, 0\) to be \(8, 5\)"):
        write_dataset(
            store, LAYOUT, lambda origin, shape: np.ones(3), SETTINGS, exclusive=False, threads=1
        )
    assert not list(tmp_path.iterdir())


def test_chunks_that_are_finished_stay_when_a_later_one_fails(tmp_path):
    def refuses(origin, shape):
        if origin[0]:
            raise EngineError("no engine")
        return Beam()(origin, shape)

    store = tmp_path / "beam.zarr"
    with pytest.raises(EngineError, match="no engine"):
        write_dataset(store, LAYOUT, refuses, SETTINGS, exclusive=False, threads=1)
    assert [name for name in chunk_files(store) if name.startswith("gaussian")]
    found = write_dataset(store, LAYOUT, Beam(), SETTINGS)
    assert np.array_equal(found["gaussian"], Beam()((0, 0), (len(X), len(Y))))


@pytest.mark.parametrize("address", ["http://127.0.0.1:8786", "tcp://host"])
def test_an_address_of_no_scheduler_is_refused_at_once(tmp_path, address):
    with pytest.raises(EngineError, match="address of a dask scheduler such as tcp://host:8786"):
        write_dataset(tmp_path / "beam.zarr", LAYOUT, Beam(), SETTINGS, scheduler=address)
    assert not (tmp_path / "beam.zarr").exists()


def test_a_worker_that_does_not_see_the_store_is_named_and_nothing_is_left(tmp_path, monkeypatch):
    class Client:
        """What a scheduler's client answers whose one worker has other disks."""

        def run(self, function, on_error):
            hidden = replace(function.__self__, path=str(tmp_path / "elsewhere"))
            try:
                return {"tcp://far:1": hidden.check()}
            except StoreError as error:
                return {"tcp://far:1": error}

    @contextmanager
    def connected(scheduler):
        yield Client()

    monkeypatch.setattr("polywigner.propagation.stores.connected", connected)
    with pytest.raises(StoreError, match="expected every worker to see the store"):
        write_dataset(tmp_path / "beam.zarr", LAYOUT, Beam(), SETTINGS, scheduler="tcp://here:1")
    assert not list(tmp_path.iterdir())
