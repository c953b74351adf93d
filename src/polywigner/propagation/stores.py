"""Arrays larger than memory: chunks, computed in any order, each written to disk when it is done.

A run that is killed, at any moment and by any means, is taken up by starting it again: only what
is missing is computed, and the result is, bit by bit, that of a run that was not disturbed, for the
same engine and type of processor. (docs/large_runs)
"""

from __future__ import annotations

import errno
import importlib.metadata
import json
import math
import os
import platform
import re
import shutil
import stat
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import (
    ArgumentError,
    EngineError,
    PolywignerError,
    StoreError,
)  # fmt: skip
from polywigner.execution import MOST_THREADS
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import checked_count, checked_path, warn_caller
from polywigner.propagation.stores_checks import (
    CHECKSUM,
    METADATA,
    SETTINGS,
    Index,
    Layout,
    as_store_error,
    checksum_of,
    chunk_faults,
    chunk_file,
    digest_of,
    open_array,
    recorded,
    require_stores,
    required,
    source_coordinate,
    stored_array,
    with_digest,
)
from polywigner.transforms.xarray_arguments import labelled_arrays

# Number of the format: it changes with the files' content and layout.
_FORMAT = 1
# Libraries on whose rounding a value may depend.
_LIBRARIES = ("numpy", "drjit")
# Seconds to wait for a scheduler's answer, and for its first worker.
_PATIENCE = 10.0
# What a lock holds: nothing yet, or the process and its machine.
_OWNER = r"|\d+ on [^\n]*"

Block = Callable[[Index, Index], NDArray[Any]]
"""(origin, shape), in samples -> the values there. A method ``check``, if there is one, raises on
every worker, before any chunk is begun, what keeps it from computing: lost files, for one."""


def versions() -> dict[str, str]:
    """Versions of all on which the last digits of a value may depend, beside the processor."""
    from polywigner import __version__

    libraries = {name: importlib.metadata.version(name) for name in _LIBRARIES}
    return {"polywigner": __version__, **libraries}


def _run_of(layout: Layout, settings: Mapping[str, Any]) -> dict[str, Any]:
    """All that the numbers of a run depend on, as JSON keeps it."""
    whole = {
        "format": _FORMAT,
        **versions(),
        "variable": layout.name,
        "dtype": np.dtype(layout.dtype).name,
        "shape": layout.shape,
        "chunks": layout.chunks,
        **{f"coordinate {name}": digest_of(a.values) for name, a in layout.coords.items()},
        **with_digest(settings),
    }
    run: dict[str, Any] = json.loads(json.dumps(whole, allow_nan=False))
    return run


@contextmanager
def one_run(path: Path) -> Iterator[None]:
    """Hold the place of a store for this run. Raises StoreError while another run holds it.

    The system's lock on the file NAME.lock beside the store ends with its process; the next run
    takes over the file of a killed one, and removes it. Workers of a cluster take no lock. Nothing
    is locked on Windows, on file systems without locks, and in folders that are read-only.
    """
    file, owner = path.with_name(f"{path.name}.lock"), ""
    with ExitStack() as stack:
        try:
            import fcntl  # not on Windows

            file.parent.mkdir(parents=True, exist_ok=True)
            careful = os.O_NOFOLLOW | os.O_NONBLOCK  # a link, a pipe
            number = os.open(file, os.O_RDWR | os.O_CREAT | careful, 0o666)
            held = stack.enter_context(os.fdopen(number, "r+", encoding="utf-8", errors="replace"))
            status, owner = os.fstat(number), held.read(300)
            if not stat.S_ISREG(status.st_mode) or not re.fullmatch(_OWNER, owner):
                raise OSError(errno.ELOOP, "another file")
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.fstat(number).st_nlink:  # of a run that is ending, and removed it
                raise BlockingIOError
            stack.callback(file.unlink, missing_ok=True)  # while it is locked
            held.seek(0)
            held.truncate()
            held.write(f"{os.getpid()} on {platform.node()}")
            held.flush()
        except BlockingIOError:
            raise StoreError(
                f"expected no other run to write to {path}, got one that does (process {owner}); "
                "wait for its end, or choose another name"
            ) from None
        except (ImportError, OSError) as error:
            # if it cannot be written there, writing says why
            if isinstance(error, OSError) and error.errno == errno.ELOOP:
                raise StoreError(
                    f"expected {file} as the lock of a run, got a link or another file; remove it"
                ) from None
        yield


def _to_disk(file: Path) -> None:
    """Wait until the content of a file is on the disk."""
    with file.open("rb+") as content:
        os.fsync(content.fileno())


def _create(path: Path, layout: Layout, run: dict[str, Any], source: str | None) -> None:
    """Make a store without chunks, whole or not at all; StoreError where it cannot be written."""
    zarr, checksum = required("zarr"), [required("zarr.codecs").Crc32cCodec()]
    scratch = path.with_name(f"{path.name}.partial")  # one name: swept by the next run
    dtype = np.dtype(layout.dtype)
    attrs = {**layout.dataset_attrs, SETTINGS: json.dumps(run)}
    labels = labelled_arrays({}, {**layout.coords, **source_coordinate(source)}, attrs)
    with ExitStack() as stack:
        remedy = "choose another place, or free this one"
        stack.enter_context(as_store_error(f"to make the folder {path}", remedy))
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()  # what is no folder of a killed run stays
        stack.callback(shutil.rmtree, scratch, ignore_errors=True)
        stack.enter_context(warnings.catch_warnings())
        # zarr warns that other readers may not know the consolidated copy; they need not
        warnings.simplefilter("ignore")
        # in one chunk each, so that nothing goes on being written after an error
        whole = {
            name: {"compressors": checksum, "chunks": labels[name].shape} for name in labels.coords
        }
        labels.to_zarr(scratch, mode="w-", zarr_format=3, consolidated=False, encoding=whole)
        zarr.open_group(scratch).create_array(
            layout.name,
            shape=layout.shape,
            chunks=layout.chunks,
            dtype=dtype,
            # chunks that are missing are read as NaN
            fill_value=complex(np.nan, np.nan) if dtype.kind == "c" else np.nan,
            # not compressed: the size of the store is then known before the run
            compressors=checksum,
            dimension_names=tuple(layout.coords),
            attributes=dict(layout.attrs),
        )
        zarr.consolidate_metadata(scratch)
        file = scratch / METADATA
        table = json.loads(file.read_bytes())
        table["attributes"][CHECKSUM] = checksum_of(table)
        file.write_text(json.dumps(table, indent=2), encoding="utf-8")
        for entry in filter(Path.is_file, scratch.rglob("*")):
            _to_disk(entry)
        scratch.rename(path)


@cache
def _checked_array(path: str, name: str, run: str) -> Any:
    """The array, if this process sees the store of that run and has the same versions."""
    settings = json.loads(run)
    if recorded(Path(path)) != settings:
        raise StoreError(
            f"expected every worker to see the store {path}, got none of this run on "
            f"{platform.node()}; put it on a file system that all workers share"
        )
    own = versions()
    planned = {name: settings[name] for name in own}
    if planned != own:
        raise StoreError(
            f"expected the versions {planned} on every worker, got {own} on {platform.node()}; "
            "install the same everywhere"
        )
    return open_array(Path(path), name)


@dataclass(frozen=True, eq=False)
class ChunkWriter:
    """Computes chunks and writes them; goes to other processes as it is."""

    path: str
    run: str
    """Settings of the run in JSON."""
    layout: Layout
    block: Block
    exclusive: bool
    """The block occupies all cores by itself, by Dr.Jit's pool of threads."""
    threads: int | None
    """Size of that pool; None to leave it as it is."""

    def check(self) -> None:
        """Raises StoreError where this process does not see the store of this run."""
        _checked_array(self.path, self.layout.name, self.run)
        if hasattr(self.block, "check"):
            self.block.check()

    def __call__(self, index: Index) -> None:
        array = _checked_array(self.path, self.layout.name, self.run)
        origin, shape = self.layout.extent(index)
        with execution.kernel_threads(self.threads) if self.exclusive else nullcontext():
            values = np.asarray(self.block(origin, shape))
        if values.shape != shape or values.dtype != self.layout.dtype:
            raise ArgumentError(
                f"expected the block at {origin} to be {shape} of {self.layout.dtype}, got "
                f"{values.shape} of {values.dtype}"
            )
        if not Path(self.path, METADATA).is_file():  # writing would make its folders again
            raise StoreError(f"expected the store {self.path}, got none any more; start again")
        remedy = "put that right and start the same run again: what is finished stays"
        with as_store_error(f"to write to {self.path}", remedy):
            array.blocks[index] = values  # written under another name, and renamed
            _to_disk(chunk_file(array, index))


Advance = Callable[[], None]


def _on_this_machine(
    writer: ChunkWriter, indices: Sequence[Index], threads: int | None, advance: Advance
) -> None:
    """Compute all chunks by threads of this process. Raises the first failure."""
    stop = threading.Event()
    # of a block that has all cores, one is computed while another is written
    count = 2 if writer.exclusive else threads or os.cpu_count()
    stops = execution.stop_this_thread_when
    with ThreadPoolExecutor(count, initializer=stops, initargs=(stop,)) as pool:
        futures = [pool.submit(writer, index) for index in indices]
        try:
            for future in as_completed(futures):
                future.result()
                advance()
        except BaseException:  # KeyboardInterrupt too
            stop.set()  # chunks begun are given up, since they may take minutes
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextmanager
def connected(scheduler: str) -> Iterator[Any]:
    """A client of the scheduler at an address, which has workers. Raises EngineError without."""
    distributed = required("distributed")
    if not re.fullmatch(r"((tcp|tls|ws|wss)://)?[^\s/]+:\d+/?", scheduler):
        # distributed would say the same later, and with a traceback when its client is collected
        raise EngineError(
            f"expected the address of a dask scheduler such as tcp://host:8786, got {scheduler!r}"
        )
    try:
        client = distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except Exception as error:  # of many kinds where something else answers
        raise EngineError(
            f"expected a dask scheduler at {scheduler!r}, got none that answers "
            f"({type(error).__name__}: {error}); start one by `dask scheduler`"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError as error:
            raise EngineError(
                f"expected workers at the scheduler {scheduler!r}, got none within "
                f"{_PATIENCE:g} s; start some by `dask worker {scheduler}`"
            ) from error
        yield client


def _on_cluster(
    writer: ChunkWriter, indices: Sequence[Index], client: Any, advance: Advance
) -> None:
    """Compute all chunks by the workers of a scheduler; others do the work of one that dies.

    Raises StoreError or EngineError, before any chunk is begun, for a worker that does not see the
    store or lacks polywigner; else what the first chunk to fail raises.
    """
    distributed, dask = required("distributed"), required("dask")
    for worker, answer in client.run(writer.check, on_error="return").items():
        if isinstance(answer, PolywignerError):
            raise answer
        if isinstance(answer, Exception) and not isinstance(answer, OSError):  # has just died
            raise EngineError(
                f"expected workers with polywigner, got none that works at {worker} "
                f"({type(answer).__name__}: {answer}); install the same everywhere"
            ) from answer
    # As a node of the graph it is sent once, and again to whoever replaces a dead worker.
    node = dask.delayed(writer, traverse=False, pure=False)
    call = dask.delayed(_write, pure=False)
    futures = client.compute([call(node, index) for index in indices])
    try:
        for future in distributed.as_completed(futures, loop=client.loop):
            if future.status != "finished":
                future.result()
            # Not kept by the worker, whose death would have it computed again.
            future.release()
            advance()
    except distributed.KilledWorker as error:
        raise StoreError(
            f"expected workers that live, got a chunk at which several died: {error}; give "
            "them more memory and start the same run again: what is finished stays"
        ) from error


def _write(writer: ChunkWriter, index: Index) -> None:
    from distributed import get_worker

    if writer.threads is None:
        # Its share of the machine's cores, since several workers may share the machine.
        writer = replace(writer, threads=get_worker().state.nthreads)
    writer(index)


def write_dataset(
    path: str | os.PathLike[str],
    layout: Layout,
    block: Block,
    settings: Mapping[str, Any],
    *,
    exclusive: bool = True,
    scheduler: str | None = None,
    threads: int | None = None,
    progress: bool | None = None,
) -> Any:
    """Fill a zarr store (format 3) with the values of a block; an xarray.Dataset, read lazily.

    Of a store that is there already, chunks that are missing or damaged are computed, the latter
    with a warning. A run that fails before a chunk is finished leaves no store behind.

    Parameters
    ----------
    path, scheduler, threads, progress : as of :func:`wigner_table`, of ``out`` the first.
    block : can be pickled if there is a ``scheduler``, and then keeps no caches when it is.
    settings : all that the values depend on beside the layout, as texts, numbers and lists.
        ``source`` is the text of a source file.
    exclusive : the block uses all cores by itself, as the engines "llvm" and "cuda" do; else
        (NumPy) as many blocks are computed at a time as there are threads.

    Raises
    ------
    StoreError for a place that cannot be written to or has too little space, and for a store that
    another run writes to, that is damaged beside its chunks, or that is of other settings or
    versions; EngineError for a scheduler that does not answer; MissingExtraError without zarr,
    xarray or dask; and what ``block`` raises.
    """
    import xarray

    if threads is not None:
        threads = checked_count(threads, "threads", 1, MOST_THREADS)
    require_stores(scheduler)
    folder = checked_path(path)
    run = _run_of(layout, settings)
    size = math.prod(layout.chunks) * np.dtype(layout.dtype).itemsize
    # workers may have been started elsewhere
    where = str(folder.absolute())
    writer = ChunkWriter(where, json.dumps(run), layout, block, exclusive, threads)
    is_new = not os.path.lexists(folder)
    with ExitStack() as stack:
        if is_new:
            _check_space(folder, layout.count * size)  # first: they may be too many to list
            indices = list(np.ndindex(layout.grid))
        else:
            array = _array_of_run(folder, run)
            stack.enter_context(one_run(folder))
            with as_store_error(f"to read and write {folder}", "check its permissions"):
                indices = _to_compute(array, progress)
            _check_space(folder, len(indices) * size)
        if not indices:
            return xarray.open_zarr(folder)
        client = None if scheduler is None else stack.enter_context(connected(scheduler))
        if is_new:  # only now, when whoever computes has answered
            stack.enter_context(one_run(folder))
            _create(folder, layout, run, settings.get("source"))
            stack.enter_context(_removed_if_empty(folder, layout.name))
        bar = stack.enter_context(
            progress_bar(folder.name, layout.count, layout.count - len(indices), progress)
        )
        if client is None:
            _on_this_machine(writer, indices, threads, bar)
        else:
            _on_cluster(writer, indices, client, bar)
            _sweep(folder / layout.name)  # what killed workers had begun
    return xarray.open_zarr(folder)


def _sweep(array: Path) -> None:
    """Remove the chunks that killed runs, or killed workers of this one, have half written."""
    for file in (array / "c").rglob("*.partial"):
        file.unlink(missing_ok=True)


@contextmanager
def _removed_if_empty(path: Path, name: str) -> Iterator[None]:
    """Within, a failure before the first chunk removes the store, to which nobody writes then."""

    def remove() -> None:
        entries = (path / name / "c").rglob("*")
        if all(entry.is_dir() or entry.suffix == ".partial" for entry in entries):
            shutil.rmtree(path, ignore_errors=True)

    try:
        yield
    except BaseException:
        remove()
        raise


def _array_of_run(path: Path, run: dict[str, Any]) -> Any:
    """Return the array of a store with the settings of the run; StoreError where they differ."""
    found = recorded(path)
    if found is None:
        raise StoreError(
            f"expected {path} to be free, or a store of this run, got something else there; choose "
            "another name"
        )
    differ = sorted(name for name in {*found, *run} if found.get(name) != run.get(name))
    if differ:
        told = ", ".join(
            f"{name} {run.get(name)!r:.60} (there: {found.get(name)!r:.60})" for name in differ
        )
        raise StoreError(
            f"expected {path} to be a store of the same settings, got one that differs in {told}; "
            "choose another name, or delete that store"
        )
    return stored_array(path, found)


def _check_space(path: Path, needed: int) -> None:
    with as_store_error(f"to read and write {path}", "check its permissions"):
        there = next(place for place in (path, *path.absolute().parents) if place.exists())
        free = shutil.disk_usage(there).free
    if needed > free:
        raise StoreError(
            f"expected {needed / 2**30:.3g} GiB of free space at {path}, got "
            f"{free / 2**30:.3g} GiB; free some, or ask for fewer samples"
        )


def _to_compute(array: Any, progress: bool | None) -> list[Index]:
    """The chunks that are missing or damaged; a warning tells of the latter."""
    path = array.store.root
    _sweep(path)
    missing, damaged = chunk_faults(array, progress)
    if damaged:
        warn_caller(
            f"{len(damaged)} of the {array.nchunks} chunks of {path.parent} were damaged, and are "
            "computed anew; look after the disk if no power failed"
        )
    return sorted(missing + damaged)
