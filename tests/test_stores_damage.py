"""Stores that lost or changed bytes: a run computes chunks anew, everything else is told in one
sentence; and one run at a time."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import polywigner as pw
from polywigner.cli import main
from polywigner.errors import FileFormatError, PolywignerError, PolywignerWarning, StoreError
from polywigner.propagation.stores import one_run, write_dataset
from polywigner.propagation.stores_checks import Layout
from polywigner.transforms.xarray_arguments import labelled_array
from stored import hashes

_EXTRA = "the extra `volume` is not installed"
xarray = pytest.importorskip("xarray", reason=_EXTRA)
zarr = pytest.importorskip("zarr", reason=_EXTRA)
for _library in ("dask", "h5netcdf"):
    pytest.importorskip(_library, reason=_EXTRA)

X = np.linspace(-1.0, 1.0, 6)
LAYOUT = Layout(
    "ramp",
    "float64",
    {name: labelled_array(X, (name,), {"units": "m"}) for name in "xy"},
    (3, 3),
    {"units": "W m-2"},
)
SOURCE = json.dumps({"kind": "aperture"})
SETTINGS = {"slope": 0.7, "source": SOURCE}
VALUES = np.add.outer(X, 0.7 * X)


def ramp(origin, shape):
    (i, j), (m, n) = origin, shape
    return VALUES[i : i + m, j : j + n].copy()


def run(store):
    return write_dataset(store, LAYOUT, ramp, SETTINGS, exclusive=False, threads=1)


@pytest.fixture(scope="module")
def pristine(tmp_path_factory):
    store = tmp_path_factory.mktemp("whole") / "ramp.zarr"
    run(store)
    return store


@pytest.fixture
def store(pristine, tmp_path):
    shutil.copytree(pristine, tmp_path / "ramp.zarr")
    return tmp_path / "ramp.zarr"


def flipped(content, at):
    return content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]


def changed(file, change):
    file.write_bytes(change(file.read_bytes()))


def first(content):
    return flipped(content, 0)


CHUNK = Path("ramp", "c", "0", "1")


@pytest.mark.parametrize("change", [first, lambda content: content[:-3]])
def test_a_run_computes_damaged_chunks_anew_and_says_so(store, pristine, change):
    changed(store / CHUNK, change)
    kept = {file: file.stat().st_mtime_ns for file in store.rglob("*/c/*/*") if file.is_file()}
    with pytest.warns(PolywignerWarning, match="1 of the 4 chunks of .* were damaged"):
        assert np.array_equal(run(store)["ramp"], VALUES)
    assert hashes(store) == hashes(pristine)
    again = {file for file, time in kept.items() if file.stat().st_mtime_ns != time}
    assert again == {store / CHUNK}


def test_verification_names_what_is_damaged_and_what_is_missing(store):
    assert pw.verify_store(store) == LAYOUT.count
    changed(store / CHUNK, first)
    (store / "ramp/c/1/1").unlink()
    before = hashes(store)
    with pytest.raises(StoreError, match=r"1 missing: ramp/c/1/1; 1 damaged: ramp/c/0/1; start"):
        pw.verify_store(store)
    assert hashes(store) == before


def test_the_command_verifies_a_store(store, capfd):
    assert main(["volume", "--verify", str(store)]) == 0
    assert capfd.readouterr().out == f"{store}: 4 chunks, all there and as they were written\n"
    changed(store / CHUNK, first)
    assert main(["volume", "--verify", str(store)]) == 2
    out, err = capfd.readouterr()
    assert out == "" and "1 damaged: ramp/c/0/1" in err and err.count("\n") == 1
    assert main(["volume", "--verify", str(store / "nowhere")]) == 2
    assert "expected a store of polywigner" in capfd.readouterr().err


def as_an_older_version_wrote_it(store):
    """Without checksums, with zstd for coordinates."""
    shutil.rmtree(store)
    group = zarr.create_group(store, zarr_format=3)
    run(store.with_name("new.zarr"))
    attrs = json.loads((store.with_name("new.zarr") / "zarr.json").read_text())["attributes"]
    shutil.rmtree(store.with_name("new.zarr"))
    del attrs["polywigner_checksum"]
    group.attrs.update(attrs)
    for name in "xy":
        group.create_array(name, data=X, chunks=X.shape, dimension_names=(name,))
    text = group.create_array("source_json", shape=(), chunks=(), dtype="string")
    text[...] = SOURCE
    ramp = group.create_array(
        "ramp", data=VALUES, chunks=(3, 3), compressors=None, dimension_names=("x", "y")
    )
    assert not ramp.compressors
    zarr.consolidate_metadata(store)


@pytest.mark.filterwarnings("ignore:Consolidated")
def test_a_store_of_an_older_version_is_gone_on_with(store):
    as_an_older_version_wrote_it(store)
    (store / CHUNK).unlink()
    assert np.array_equal(run(store)["ramp"], VALUES)
    assert (store / CHUNK).stat().st_size == 9 * 8
    with pytest.raises(StoreError, match=r"older version without; its 4 chunks are all there"):
        pw.verify_store(store)


FILES = (
    "zarr.json",
    "ramp/zarr.json",
    "x/zarr.json",
    "source_json/zarr.json",
    "x/c/0",
    "source_json/c",
    "ramp/c/1/0",
)
CHANGES: dict[str, Callable[[bytes], bytes]] = {
    "half": lambda content: content[: len(content) // 2],
    "another type": lambda content: b"[]",
    "nested": lambda content: b"[" * 100_000,
    "nothing in it": lambda content: b"{}",
    "a bit": lambda content: flipped(content, len(content) // 3),
    "longer": lambda content: content + b"}",
    "another shape": lambda content: content.replace(b"\n    6", b"\n    7") + b"\n\n}",
}


def is_told(do):
    """The message, which is one of ours; None if there was no error."""
    try:
        do()
    except PolywignerError as error:
        return str(error)
    return None


def check_all_doors(store, pristine):
    """Verification tells the damage; readers and runs do, or have every value as it was."""
    assert is_told(lambda: pw.verify_store(store))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of chunks that are computed anew
        out = store.with_name("ramp.vti")
        if is_told(lambda: pw.write_vti(store, out)) is None:
            raw = out.read_bytes().partition(b'"raw">\n_')[2][8 : 8 + VALUES.nbytes]
            values = np.frombuffer(raw).reshape(VALUES.shape).T
            assert np.array_equal(values[~np.isnan(values)], VALUES[~np.isnan(values)])
        if is_told(lambda: run(store)) is None:
            assert hashes(store) == hashes(pristine)
            assert pw.verify_store(store) == LAYOUT.count


@pytest.mark.parametrize("file", [*FILES, "x/c", "ramp/c", "ramp", "source_json"])
def test_whatever_is_changed_lost_or_moved_nobody_gets_wrong_numbers_or_another_error(
    tmp_path, pristine, file
):
    def exchange(path):
        other = path.parents[len(Path(file).parts) - 1] / FILES[FILES.index(file) - 1]
        content = path.read_bytes()
        path.write_bytes(other.read_bytes())
        other.write_bytes(content)

    faults = [lambda path, change=change: changed(path, change) for change in CHANGES.values()]
    faults += [Path.unlink, exchange]
    for fault in faults if file in FILES else [shutil.rmtree]:
        store = tmp_path / "ramp.zarr"
        shutil.copytree(pristine, store)
        fault(store / file)
        check_all_doors(store, pristine)
        shutil.rmtree(store)


def test_a_damaged_coordinate_is_named_in_one_line(store, capfd):
    changed(store / "y/c/0", first)
    with pytest.raises(StoreError, match=r"got damaged coordinate y .* from a copy, or delete"):
        run(store)
    with pytest.raises(StoreError, match="got damaged coordinate y"):
        pw.write_vti(store, store.with_name("ramp.vti"))
    assert main(["volume", "--verify", str(store)]) == 2
    assert capfd.readouterr().err.count("\n") == 1


def test_a_damaged_chunk_ends_an_export_with_one_error_and_no_file(store):
    changed(store / CHUNK, first)
    for write, name in ((pw.write_netcdf, "ramp.nc"), (pw.write_vti, "ramp.vti")):
        with pytest.raises(StoreError, match="got a damaged one; verify_store names it"):
            write(store, store.with_name(name))
    assert [path.name for path in store.parent.iterdir()] == ["ramp.zarr"]


def test_a_damaged_source_is_told_by_its_reader(store):
    changed(store / "source_json/c", lambda content: flipped(content, 9))
    with pytest.raises(FileFormatError, match="source can be read, got a damaged one"):
        pw.read_source(xarray.open_zarr(store))


HOLDER = """
import sys
from pathlib import Path
from polywigner.propagation.stores import one_run

with one_run(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def other_run(store):
    """A process that holds the place of the store."""
    command = [sys.executable, "-c", HOLDER, str(store)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "held\n"
        yield process
        process.send_signal(signal.SIGKILL)


def test_a_second_run_is_refused_sweeps_nothing_and_may_start_when_the_first_has_died(store):
    pytest.importorskip("fcntl", reason="this system has no locks of that kind")
    new, being_written = store.with_name("new.zarr"), store / f"{CHUNK}.0123.partial"
    (store / CHUNK).unlink()
    being_written.touch()
    with other_run(store) as first, one_run(new):
        for place, process in ((store, first.pid), (new, os.getpid())):
            with pytest.raises(StoreError, match=f"no other run .*process {process} on"):
                run(place)
        assert is_told(lambda: pw.verify_store(store)), "it is not complete"
        assert being_written.exists() and not new.exists()
    lock = store.with_name("ramp.zarr.lock")
    assert lock.exists(), "the file of a killed run, which locks nothing"
    assert np.array_equal(run(store)["ramp"], VALUES)
    assert not being_written.exists()
    assert [path.name for path in store.parent.iterdir()] == ["ramp.zarr"]


def test_a_disk_that_fails_to_keep_a_chunk_is_one_clear_error(store, monkeypatch):
    (store / CHUNK).unlink()

    def fails(descriptor):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(StoreError, match=r"expected to write to .* start the same run again"):
        run(store)


def test_a_lock_that_is_a_link_or_a_file_of_others_is_left_alone(tmp_path):
    path, precious = tmp_path / "ramp.zarr", tmp_path / "precious"
    precious.write_text("of others")
    lock = tmp_path / "ramp.zarr.lock"
    for make in (lambda: lock.symlink_to(precious), lambda: lock.write_text("of others")):
        make()
        with pytest.raises(StoreError, match="as the lock of a run"):
            run(path)
        assert precious.read_text() == lock.read_text() == "of others"
        lock.unlink()
    lock.write_text("1 on elsewhere")  # of a run that was killed
    run(path)
    assert not lock.exists()


def _with_codec(table):
    table["codecs"].append({"name": "numcodecs.pickle", "configuration": {}})


def _with_endless_chunks(table):
    table["shape"] = table["chunk_grid"]["configuration"]["chunk_shape"] = [10**5, 10**5]


@pytest.mark.parametrize(
    "change",
    [
        _with_codec,
        _with_endless_chunks,
        lambda table: table.update(shape=[10**9, 10**9]),
        lambda table: table.update(zarr_format=2),
    ],
)
def test_arrays_from_elsewhere_are_looked_at_before_they_are_decoded(tmp_path, change):
    folder = tmp_path / "x.zarr"
    xarray.Dataset({"u": (("x", "y"), np.ones((3, 4)))}).to_zarr(
        folder, zarr_format=3, consolidated=False
    )
    pw.write_netcdf(folder, tmp_path / "good.nc")
    table = json.loads((folder / "u" / "zarr.json").read_text())
    change(table)
    (folder / "u" / "zarr.json").write_text(json.dumps(table))
    with pytest.raises(PolywignerError, match="expected"):
        pw.write_netcdf(folder, tmp_path / "bad.nc")
    assert not (tmp_path / "bad.nc").exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize(
    ("name", "kind"), [("zarr.json", "pipe"), ("u/zarr.json", "device"), ("u/c/0/0", "pipe")]
)
def test_pipes_and_devices_in_a_store_are_refused(tmp_path, name, kind):
    folder = tmp_path / "x.zarr"
    held = xarray.Dataset({"u": (("x", "y"), np.ones((3, 4)))}, {"x": np.arange(3.0)})
    held.to_zarr(folder, zarr_format=3, consolidated=False)
    (folder / name).unlink()
    if kind == "pipe":
        os.mkfifo(folder / name)
    else:
        (folder / name).symlink_to("/dev/zero")
    with pytest.raises(PolywignerError, match="expected"):
        pw.write_netcdf(folder, tmp_path / "x.nc")
    with pytest.raises(PolywignerError, match="expected"):
        pw.verify_store(folder)


def test_a_copy_of_metadata_that_nobody_looked_at_is_not_read(tmp_path):
    folder = tmp_path / "x.zarr"
    xarray.Dataset({"u": (("x", "y"), np.ones((3, 4)))}).to_zarr(folder, zarr_format=3)
    table = json.loads((folder / "zarr.json").read_text())
    _with_codec(table["consolidated_metadata"]["metadata"]["u"])
    (folder / "zarr.json").write_text(json.dumps(table))
    pw.write_netcdf(folder, tmp_path / "x.nc")
    assert (xarray.open_dataset(tmp_path / "x.nc")["u"] == 1).all()


def test_a_damaged_chunk_of_another_program_is_told(tmp_path):
    folder = tmp_path / "x.zarr"
    xarray.Dataset({"u": (("x", "y"), np.ones((3, 4)))}).to_zarr(folder, zarr_format=3)
    (folder / "u" / "c" / "0" / "0").write_bytes(b"none of zstd")
    with pytest.raises(StoreError, match=r"x\.zarr, got a damaged one"):
        pw.write_netcdf(folder, tmp_path / "x.nc")


@pytest.mark.filterwarnings("error")
def test_folders_in_a_store_that_are_none_of_its_arrays_are_passed(tmp_path):
    folder = tmp_path / "x.zarr"
    held = xarray.Dataset({"u": (("x",), np.ones(3))})
    held.to_zarr(folder, zarr_format=3, consolidated=False)
    (folder / "other").mkdir()
    pw.write_netcdf(folder, tmp_path / "x.nc")
    assert (tmp_path / "x.nc").stat().st_size
