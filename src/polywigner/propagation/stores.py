"""Results larger than memory: lazy xarray datasets, written to zarr stores region by region.

A region is one chunk of one variable. zarr's local store renames finished chunk files into place,
so a chunk exists complete or not at all, and a second run computes the missing ones only. The
attributes and coordinates of a store are the settings of its run. (docs/large_runs.md)
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import re
import shutil
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

from polywigner import execution
from polywigner.errors import ArgumentError, EngineError, StoreError, require
from polywigner.execution import MOST_THREADS
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import checked_count, checked_path
from polywigner.interruption import atomic_path
from polywigner.source.source_files import SOURCE_COORDINATE, source_json
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray
    from distributed.deploy import Cluster

Index = tuple[int, ...]
"""One number for each dimension: of a chunk, of its first sample, or of samples in it."""
Block = Callable[[Index, Index], NDArray[Any]]
"""(origin, shape), in samples -> the values there."""
Scheduler: TypeAlias = "str | Cluster | None"
"""Address of a dask.distributed scheduler, or a cluster object such as ``LocalCluster``."""

# Longest description of a source in an attribute.
_LONGEST_ATTRIBUTE = 200
# Most samples in memory: 16 GiB of float32.
_MOST_IN_MEMORY = 1 << 32
_ADDRESS = r"inproc://\S+|((tcp|tls|ws|wss)://)?[^\s/]+:\d+/?"
# Seconds to wait for a scheduler, and for its first worker.
_PATIENCE = 10.0
# Codecs that decode numbers and texts only; others may run code (numcodecs' pickle, for one).
_CODECS = {
    "bytes", "crc32c", "zstd", "gzip", "blosc", "transpose", "sharding_indexed", "vlen-utf8",
}  # fmt: skip


def required(name: str) -> Any:
    """Return a module of the extra ``datasets``; raise MissingExtraError without it."""
    return require(name, "datasets", "large results are stored and shared out with")


def require_stores(scheduler: Scheduler = None) -> None:
    """Raise MissingExtraError unless the libraries of stores, or of schedulers, are installed."""
    for module in ("zarr", "dask", *(() if scheduler is None else ("distributed",))):
        required(module)


def check_memory(shape: Sequence[int]) -> None:
    """Raise ArgumentError for arrays that are too large to be computed in memory."""
    if math.prod(shape) > _MOST_IN_MEMORY:
        raise ArgumentError(
            f"expected at most {_MOST_IN_MEMORY} samples in memory, got {math.prod(shape):.3g}; "
            "use chunks, or write them to disk with out"
        )


def chunks_within(shape: Sequence[int], samples: int) -> Index:
    """Return chunks of at most ``samples`` samples, by halving the longest axis again and again."""
    chunks = list(shape)
    while math.prod(chunks) > samples:
        longest = chunks.index(max(chunks))
        chunks[longest] = -(-chunks[longest] // 2)
    return tuple(chunks)


def digest_of(text: str) -> str:
    """Return the SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()


def source_text(source: Any) -> str:
    """Return a source file in JSON."""
    return source_json(source)


def source_attrs(source: Any) -> dict[str, str]:
    """Return the dataset attribute that describes a source in one line."""
    text = repr(source)
    is_long = len(text) > _LONGEST_ATTRIBUTE
    return {"source": f"{text[: _LONGEST_ATTRIBUTE - 3]}..." if is_long else text}


def source_coords(source: Any) -> dict[str, xarray.Variable]:
    """Return the coordinate that holds a source as JSON."""
    # object: NumPy's texts of fixed length take four times the memory, and zarr has none
    values = np.array(source_text(source), dtype=object)
    return {SOURCE_COORDINATE: labelled_array(values, (), {"long_name": "source file in JSON"})}


def lazy_array(
    block: Block,
    shape: Index,
    chunks: Any,
    dtype: DTypeLike,
    *,
    compiled: bool = True,
    threads: int | None = None,
) -> Any:
    """Return a dask array whose chunks are values of a block.

    Parameters
    ----------
    block : can be pickled.
    chunks : as dask takes them.
    compiled : the block uses Dr.Jit's pool of threads, which serves one chunk at a time.
    threads : size of that pool; None: as it is, and on a dask worker its number of threads.
    """
    arrays, core, dask = (required(n) for n in ("dask.array", "dask.array.core", "dask"))
    try:
        sizes = core.normalize_chunks(chunks, shape, dtype=dtype)
        if not all(n > 0 for axis in sizes for n in axis):
            raise ValueError("chunks without samples")
    except (TypeError, ValueError, ArithmeticError) as error:
        raise ArgumentError(
            f"expected chunks as dask takes them, a number, a tuple of {len(shape)}, or 'auto', "
            f"got {chunks!r}: {error}"
        ) from None
    if threads is not None:
        threads = checked_count(threads, "threads", 1, MOST_THREADS)
    return arrays.map_blocks(
        _values,
        chunks=sizes,
        dtype=dtype,
        meta=np.empty((0,) * len(shape), dtype),
        # a node of the graph: a worker receives it once, and reuses its caches
        block=dask.delayed(block, traverse=False),
        compiled=compiled,
        threads=threads,
    )


def _values(
    block: Block, compiled: bool, threads: int | None, block_info: Any = None
) -> NDArray[Any]:
    """Compute one chunk."""
    location = block_info[None]["array-location"]
    origin, shape = tuple(a for a, _ in location), tuple(b - a for a, b in location)
    with execution.kernel_threads(threads or _worker_threads()) if compiled else nullcontext():
        return np.asarray(block(origin, shape))


def _worker_threads() -> int | None:
    """Return the number of threads of the dask worker that runs this task; None elsewhere."""
    if "distributed" not in sys.modules:
        return None
    from distributed import get_worker

    try:
        return int(get_worker().state.nthreads)
    except ValueError:
        return None


def write_store(
    path: str | os.PathLike[str],
    dataset: xarray.Dataset,
    *,
    compiled: bool = True,
    scheduler: Scheduler = None,
    threads: int | None = None,
    progress: bool | None = None,
) -> xarray.Dataset:
    """Write a lazy dataset to a zarr store (format 3), and return it as read from there, lazily.

    A store of the same dataset is completed: only missing chunks are computed.

    Parameters
    ----------
    path : folder of the store.
    dataset : variables of :func:`lazy_array`. Its attributes and coordinates are the settings that
        a store must have to be completed.
    compiled : chunks are computed one after the other, since each uses all cores; else there are
        as many at a time as ``threads``.
    scheduler, threads, progress : as for :func:`wigner_table`.

    Raises
    ------
    StoreError for a path that cannot be written to, has too little space, or holds something else;
    EngineError for a scheduler that does not respond; MissingExtraError without zarr or dask; and
    the errors of the blocks.
    """
    require_stores(scheduler)
    folder, dataset = checked_path(path), dataset.assign_attrs(written="chunk by chunk")
    is_new = not os.path.lexists(folder)
    if is_new:
        _check_space(folder, dataset.nbytes)
    else:
        _check_same(folder, dataset)
    regions = [
        (str(name), index)
        for name, array in dataset.data_vars.items()
        for index in np.ndindex(array.data.numblocks)
    ]
    missing = [region for region in regions if not _chunk_file(folder, *region).is_file()]
    if not missing:
        return open_store(folder)
    with nullcontext() if scheduler is None else _connected(scheduler) as client:
        if is_new:  # after the scheduler has responded
            _create(folder, dataset)
        done, tasks = len(regions) - len(missing), _tasks(folder, dataset, missing)
        with progress_bar(folder.name, len(regions), done, progress) as advance:
            if client is None:
                _compute_here(tasks, 1 if compiled else threads or os.cpu_count() or 1, advance)
            else:
                _compute_on(client, tasks, advance)
    return open_store(folder)


def _chunk_file(folder: Path, name: str, index: Index) -> Path:
    return folder.joinpath(name, "c", *map(str, index))


def _check_space(folder: Path, needed: int) -> None:
    parent = next(p for p in folder.absolute().parents if p.exists())
    free = shutil.disk_usage(parent).free
    if needed > free:
        raise StoreError(
            f"expected {needed / 2**30:.3g} GiB of free space at {folder}, got "
            f"{free / 2**30:.3g} GiB; free some, or compute fewer samples"
        )


def _check_same(folder: Path, dataset: xarray.Dataset) -> None:
    """Raise StoreError unless a store has the settings of a dataset."""
    stored = open_store(folder)
    ours, theirs = _settings_of(dataset), _settings_of(stored)
    differ = [
        f"{name} {ours.get(name)!r:.60} (there: {theirs.get(name)!r:.60})"
        for name in sorted({*ours, *theirs})
        if ours.get(name) != theirs.get(name)
    ]
    differ += [
        f"coordinate {name}"
        for name, values in dataset.coords.items()
        if name not in stored.coords or not values.variable.equals(stored[name].variable)
    ]
    if differ:
        raise StoreError(
            f"expected {folder} to be a store of the same settings, got one that differs in "
            f"{', '.join(differ)}; choose another name, or delete that store"
        )


def _settings_of(dataset: xarray.Dataset) -> dict[str, Any]:
    """Return the attributes, types, and chunks of a dataset, as JSON stores them."""
    settings = dict(dataset.attrs)
    for name, array in dataset.data_vars.items():
        chunks = [axis[0] for axis in array.chunks or ()]
        about = {**array.attrs, "dtype": array.dtype.name, "shape": array.shape, "chunks": chunks}
        settings |= {f"{name}: {key}": value for key, value in about.items()}
    normalised: dict[str, Any] = json.loads(
        json.dumps(settings, default=lambda value: value.tolist())
    )
    return normalised


def _create(folder: Path, dataset: xarray.Dataset) -> None:
    """Write metadata and coordinates of a store without chunks."""
    encoding: dict[Any, Any] = {}
    for name, array in dataset.data_vars.items():
        if any(len({*axis[:-1]}) > 1 or axis[-1] > axis[0] for axis in array.chunks or ()):
            raise ArgumentError(f"expected chunks of equal size for a store, got {array.chunks}")
        encoding[name] = {
            "chunks": tuple(axis[0] for axis in array.chunks or ()),
            # not compressed: last digits are noise to a compressor, which halves the speed
            "compressors": (),
            # missing chunks are read as NaN
            "fill_value": complex(np.nan, np.nan) if array.dtype.kind == "c" else np.nan,
        }
    with _as_store_error(f"to make the folder {folder}"), warnings.catch_warnings():
        # zarr warns that other readers may not know its texts and consolidated metadata
        warnings.simplefilter("ignore")
        folder.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(folder) as scratch:
            dataset.to_zarr(scratch, mode="w-", compute=False, zarr_format=3, encoding=encoding)


@contextmanager
def _as_store_error(expected: str) -> Iterator[None]:
    """Turn errors of the system in the block into a StoreError."""
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"expected {expected}, got {error.strerror or error} on {platform.node()}; correct "
            "that and start the same run again: finished chunks stay"
        ) from error


def _tasks(
    folder: Path, dataset: xarray.Dataset, missing: Sequence[tuple[str, Index]]
) -> list[Any]:
    """Return a task for each region, which computes and writes it."""
    write = required("dask").delayed(_write_region)
    blocks = {name: dataset[name].data.to_delayed() for name in dict(missing)}
    tasks = []
    for name, index in missing:
        starts = [i * sizes[0] for i, sizes in zip(index, dataset[name].chunks, strict=True)]
        tasks.append(write(blocks[name][index], str(folder.absolute() / name), starts))
    return tasks


def _write_region(values: NDArray[Any], path: str, starts: Sequence[int]) -> None:
    """Write one chunk to the array of a store, from the sample with the numbers ``starts`` on."""
    region = tuple(slice(k, k + n) for k, n in zip(starts, values.shape, strict=True))
    with _as_store_error(f"to write to the store {path}"):
        # a chunk of nothing but NaN is complete as well
        array = required("zarr").open_array(path, mode="r+")
        array.with_config({"write_empty_chunks": True})[region] = values


def _compute_here(tasks: Sequence[Any], count: int, advance: Callable[[], None]) -> None:
    """Compute tasks in this process, up to ``count`` at a time."""

    def compute(task: Any) -> None:
        task.compute(scheduler="synchronous")

    if count == 1:
        for task in tasks:
            compute(task)
            advance()
        return
    stop = threading.Event()
    stops = execution.stop_this_thread_when
    with ThreadPoolExecutor(count, initializer=stops, initargs=(stop,)) as pool:
        try:
            for _ in pool.map(compute, tasks):
                advance()
        except BaseException:  # KeyboardInterrupt too
            stop.set()  # chunks may take minutes
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextmanager
def _connected(scheduler: Any) -> Iterator[Any]:
    """Connect to a scheduler that has workers of the same versions; EngineError without."""
    distributed = required("distributed")
    address = getattr(scheduler, "scheduler_address", scheduler)
    if not re.fullmatch(_ADDRESS, address if isinstance(address, str) else ""):
        # distributed would report the same later, with a traceback when its client is collected
        raise EngineError(
            f"expected the address of a dask scheduler such as tcp://host:8786, got {scheduler!r}"
        )
    try:
        client = distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
        client.wait_for_workers(1, timeout=_PATIENCE)
        of_all = client.get_versions(packages=["polywigner"])
        versions = {one["packages"]["polywigner"] for one in of_all["workers"].values()}
        if versions != {of_all["client"]["packages"]["polywigner"]}:
            raise ValueError(f"polywigner {', '.join(map(str, versions))} on workers")
    except Exception as error:  # of many types if something else responds
        raise EngineError(
            f"expected a dask scheduler with workers of the same versions at {scheduler!r}, got "
            f"{type(error).__name__}: {error!s:.300}; start `dask scheduler` and `dask worker`"
        ) from error
    with client:
        yield client


def _compute_on(client: Any, tasks: list[Any], advance: Callable[[], None]) -> None:
    """Compute tasks on the workers of a scheduler. Tasks of a dead worker go to other workers."""
    distributed = required("distributed")
    try:
        for future in distributed.as_completed(client.compute(tasks), loop=client.loop):
            if future.status != "finished":
                future.result()
            future.release()
            advance()
    except distributed.KilledWorker as error:
        raise StoreError(
            f"expected workers that live, got a chunk at which several died: {error}; give "
            "them more memory and start the same run again: finished chunks stay"
        ) from error


def open_store(path: str | os.PathLike[str]) -> xarray.Dataset:
    """Open a zarr store (format 3) lazily.

    Raises StoreError unless all of its arrays have codecs that decode numbers and texts only.
    """
    required("zarr"), required("dask")
    import xarray

    folder = checked_path(path)
    try:
        for file in (folder / "zarr.json", *folder.glob("*/zarr.json")):
            table = json.loads(file.read_bytes())
            unknown = {*_codec_names(table.get("codecs", ()))} - _CODECS
            if table["zarr_format"] != 3 or unknown:
                raise ValueError(f"format {table['zarr_format']!r:.20}, codecs {unknown!r:.100}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of other files in the folder
            # a consolidated copy of the metadata has not been checked
            return xarray.open_zarr(folder, zarr_format=3, consolidated=False)
    except Exception as error:  # zarr and its codecs raise many types
        raise StoreError(
            f"expected a zarr store of format 3 at {folder}, got something else there "
            f"({type(error).__name__}: {error!s:.200}); choose another name"
        ) from error


def _codec_names(codecs: Sequence[Any]) -> Iterator[str]:
    """Iterate over the names of codecs, those inside of shards included."""
    for codec in codecs:
        yield codec["name"]
        inner = codec.get("configuration") or {}
        yield from _codec_names([*inner.get("codecs", ()), *inner.get("index_codecs", ())])
