"""Arrays larger than memory: chunks, computed in any order, each written to disk when it is done.

A run that is killed, at any moment and by any means, is taken up by starting it again: only what
is missing is computed, and the result is, bit by bit, that of a run that was not disturbed, for the
same engine and type of processor. (docs/large_runs)
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager
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
    PolywignerWarning,
    StoreError,
)
from polywigner.execution import MOST_THREADS
from polywigner.geometry.arguments import checked_count, checked_path
from polywigner.interruption import cleaned_up_by
from polywigner.propagation.stores_checks import (
    chunk_bytes,
    chunk_file,
    damaged,
    missing,
    open_array,
    recorded,
    stored_layout,
    sweep,
)
from polywigner.propagation.stores_files import (
    METADATA,
    Index,
    Layout,
    create,
    fingerprint_of,
    one_run,
    require_stores,
    required,
    to_disk,
    told_settings,
    versions,
)
from polywigner.radiometry.progress import progress_bar

__all__ = ["Block", "ChunkWriter", "connected", "on_cluster", "on_this_machine", "write_dataset"]

Block = Callable[[Index, Index], NDArray[Any]]
"""(origin, shape), in samples -> the values there.

One that has a method ``check`` raises there, on every worker and before any chunk is begun, what
keeps it from computing: files that are not there, for one.
"""


@cache
def _checked_array(path: str, name: str, fingerprint: str) -> Any:
    """The array, if this process sees the store of that run."""
    found = recorded(Path(path))
    if found is None or found.fingerprint != fingerprint:
        raise StoreError(
            f"expected every worker to see the store {path}, got none of this run on "
            f"{platform.node()}; put it on a file system that all workers share"
        )
    own = versions()
    planned = {name: found.settings.get(name) for name in own}
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
    fingerprint: str
    layout: Layout
    block: Block
    exclusive: bool
    """The block occupies all cores by itself, by Dr.Jit's pool of threads."""
    threads: int | None
    """Size of that pool; None to leave it as it is."""

    def check(self) -> None:
        """Raises StoreError where this process does not see the store of this run."""
        _checked_array(self.path, self.layout.name, self.fingerprint)
        if hasattr(self.block, "check"):
            self.block.check()

    def __call__(self, index: Index) -> None:
        array = _checked_array(self.path, self.layout.name, self.fingerprint)
        file = chunk_file(Path(self.path), array, self.layout.name, index)
        if self._is_finished(file, chunk_bytes(array, self.layout)):
            return  # by another worker, that was thought dead
        origin, shape = self.layout.extent(index)
        values = self._values(origin, shape)
        if values.shape != shape or values.dtype != self.layout.dtype:
            raise ArgumentError(
                f"expected the block at {origin} to be {shape} of {self.layout.dtype}, got "
                f"{values.shape} of {values.dtype}"
            )
        where = tuple(slice(o, o + n) for o, n in zip(origin, shape, strict=True))
        if not (Path(self.path) / METADATA).is_file():  # writing would make its folders again
            raise StoreError(f"expected the store {self.path}, got none any more; start again")
        try:
            array[where] = values
            self._keep(file)
        except OSError as error:
            raise StoreError(
                f"expected to write to {self.path}, got {error.strerror or error}; put that right "
                "and start the same run again: what is finished stays"
            ) from error

    def _is_finished(self, file: Path, size: int) -> bool:
        try:
            return file.stat().st_size == size
        except OSError:
            return False

    def _keep(self, file: Path) -> None:
        """Wait until a chunk, and the folders that it may be the first in, are on the disk."""
        to_disk(file)
        array = Path(self.path) / self.layout.name
        for folder in file.parents:
            to_disk(folder)
            if folder == array:
                return

    def _values(self, origin: Index, shape: Index) -> NDArray[Any]:
        if not self.exclusive:
            return np.asarray(self.block(origin, shape))
        with execution.kernel_threads(self.threads):
            return np.asarray(self.block(origin, shape))


Advance = Callable[[], None]

# Seconds to wait for a scheduler's answer, and for its first worker.
_PATIENCE = 10.0


def on_this_machine(
    writer: ChunkWriter, indices: Sequence[Index], threads: int | None, advance: Advance
) -> None:
    """All chunks, by threads of this process. Raises what the first chunk to fail raises.

    Of a block that has a pool of threads of its own, one is computed while another is written.
    """
    cores = os.cpu_count() or 1
    stop = threading.Event()
    with ThreadPoolExecutor(
        2 if writer.exclusive else threads or cores,
        initializer=execution.stop_this_thread_when,
        initargs=(stop,),
    ) as pool:
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
    if "://" not in scheduler and not re.fullmatch(r"[^\s/]+:\d+", scheduler):
        # distributed would say the same with a traceback when its client is collected
        raise EngineError(
            f"expected the address of a dask scheduler such as tcp://host:8786, got {scheduler!r}"
        )
    try:
        client = distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except Exception as error:  # of many kinds where something else answers, or it is no address
        raise EngineError(
            f"expected a dask scheduler at {scheduler!r}, got none that answers "
            f"({type(error).__name__}: {error}); start one by `dask scheduler`, or leave "
            "the address out"
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


def on_cluster(
    writer: ChunkWriter, indices: Sequence[Index], client: Any, advance: Advance
) -> None:
    """All chunks, by the workers of a client's scheduler.

    A worker that dies has its chunks computed by others. Raises, before any chunk is begun,
    StoreError if a worker does not see the store and EngineError if one lacks polywigner; else what
    the first chunk to fail raises.
    """
    distributed = required("distributed")
    dask = required("dask")
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
    except PolywignerError:
        raise
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
    """Fill a zarr store (format 3) with the values of a block function, chunk by chunk.

    If the store is there already, its chunks are read, and those that are missing or damaged are
    computed, the latter with a warning. A run that fails before a chunk is finished leaves no store
    behind. Needs the extra ``volume``. One run at a time writes to a store.

    Parameters
    ----------
    path : the folder to make, or to go on with.
    layout : axes, chunks and attributes. Memory: a few chunks, and what ``block`` needs.
    block : (origin, shape), in samples -> values of that shape and of the layout's dtype; can be
        pickled if there is a ``scheduler``, and then keeps no caches when it is.
    settings : all that the values depend on beside the layout, as texts, numbers and lists: a
        store of other settings is not gone on with.
    exclusive : the block uses all cores by itself, as the engines "llvm" and "cuda" do; else
        (NumPy) as many blocks are computed at a time as there are threads.
    scheduler : address of a dask.distributed scheduler whose workers see the same file system;
        None computes on this machine.
    threads : on this machine, or of each worker; None: all cores, or what each worker has.
    progress : whether to draw a bar; None: on a terminal.

    Returns
    -------
    xarray.Dataset, read lazily in the same chunks.

    Raises
    ------
    StoreError for a place that cannot be written to or has too little space, for other data there,
    for a store that another run writes to, whose metadata or coordinates are damaged, or that is of
    other settings or versions, which the message names; EngineError for a
    scheduler that does not answer; MissingExtraError without zarr, xarray or dask; and what
    ``block`` raises.
    """
    if threads is not None:
        threads = checked_count(threads, "threads", 1, MOST_THREADS)
    require_stores(scheduler)
    folder = checked_path(path)
    fingerprint, whole = fingerprint_of(layout, settings)
    is_new = not os.path.lexists(folder)
    if not is_new:
        _check_same_run(folder, fingerprint, whole)
    # workers may have been started elsewhere
    writer = ChunkWriter(str(folder.absolute()), fingerprint, layout, block, exclusive, threads)
    with ExitStack() as stack:
        if not is_new:
            stack.enter_context(one_run(folder))
        indices = _missing(folder, layout, progress)
        if not indices:
            return opened(folder)
        client = None if scheduler is None else stack.enter_context(connected(scheduler))
        if is_new:  # only now, when whoever computes has answered
            stack.enter_context(one_run(folder))
            create(folder, layout, fingerprint, whole)
            remove = _remove_if_empty(folder, layout)
            stack.enter_context(cleaned_up_by(remove))
            stack.push(lambda kind, *_: remove() if kind else None)
        bar = stack.enter_context(
            progress_bar(folder.name, layout.count, layout.count - len(indices), progress)
        )
        if client is None:
            on_this_machine(writer, indices, threads, bar)
        else:
            on_cluster(writer, indices, client, bar)
            sweep(folder, layout)  # what killed workers had begun
    return opened(folder)


def _remove_if_empty(path: Path, layout: Layout) -> Callable[[], None]:
    """What is called when a run fails: removes the store if that was before the first chunk.

    Nobody is writing then: threads have been waited for, and workers begin only when all of them
    see the store.
    """

    def remove() -> None:
        if len(missing(path, layout)) == layout.count:
            shutil.rmtree(path, ignore_errors=True)

    return remove


def opened(path: str | os.PathLike[str]) -> Any:
    """A store as an xarray.Dataset, lazily."""
    return required("xarray").open_zarr(path)


def _check_same_run(path: Path, fingerprint: str, settings: dict[str, Any]) -> None:
    found = recorded(path)
    if found is None:
        raise StoreError(
            f"expected {path} to be free, or a store of this run, got something else there; choose "
            "another name"
        )
    if found.fingerprint == fingerprint:
        stored_layout(path, found.settings)  # its coordinates are whole
        return
    settings = told_settings(settings)
    names = sorted({*found.settings, *settings})
    differ = [name for name in names if found.settings.get(name) != settings.get(name)]
    told = ", ".join(
        f"{name} {_short(settings.get(name))} (there: {_short(found.settings.get(name))})"
        for name in differ
    )
    raise StoreError(
        f"expected {path} to be a store of the same settings, got one that differs in {told}; "
        "choose another name, or delete that store"
    )


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _missing(path: Path, layout: Layout, progress: bool | None) -> list[Index]:
    """The chunks to compute, for which there is space; those that are damaged are removed."""
    try:
        there = next(place for place in (path, *path.absolute().parents) if place.exists())
        space = shutil.disk_usage(there)
        # chunks that the whole disk could not hold may be too many to list
        holds = layout.count * layout.chunk_bytes <= space.total
        indices = missing(path, layout) if holds else []
        if path.exists():
            sweep(path, layout)
            indices = sorted(indices + _removed(path, layout, indices, progress))
    except OSError as error:
        raise StoreError(
            f"expected to read and write {path}, got {error.strerror or error}; check its "
            "permissions"
        ) from error
    needed = (len(indices) if holds else layout.count) * layout.chunk_bytes
    if needed > space.free:
        raise StoreError(
            f"expected {needed / 2**30:.3g} GiB of free space at {path}, got "
            f"{space.free / 2**30:.3g} GiB; free some, or ask for fewer samples"
        )
    return indices


def _removed(path: Path, layout: Layout, absent: list[Index], progress: bool | None) -> list[Index]:
    """Whole-sized chunks that were damaged; all that were are removed, of any size."""
    broken = damaged(path, layout, absent, progress)
    array = open_array(path, layout.name)
    files = [chunk_file(path, array, layout.name, index) for index in (*absent, *broken)]
    there = [file for file in files if file.is_file()]
    for file in there:
        file.unlink()
    if there:
        warnings.warn(
            f"{len(there)} of the {layout.count} chunks of {path} were damaged, and are computed "
            "anew; look after the disk if no power failed",
            PolywignerWarning,
            stacklevel=4,
        )
    return broken
