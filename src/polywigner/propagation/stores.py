"""Results larger than memory: lazy xarray datasets, written to zarr stores region by region.

A region is one chunk of one variable. zarr's local store renames finished chunk files into place,
so a chunk exists complete or not at all, and a second run computes the missing ones only. The
attributes and coordinates of a store are the settings of its run. (docs/large_runs.md)
"""

from __future__ import annotations

import json
import math
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

from polywigner.errors import ArgumentError, EngineError, PolywignerError, StoreError, require
from polywigner.execution import MOST_THREADS, kernel_threads
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import checked_count, checked_path
from polywigner.interruption import atomic_path
from polywigner.source.source_files import SOURCE_COORDINATE, source_json
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray
    from distributed import Client
    from distributed.deploy import Cluster

Index = tuple[int, ...]
"""One number for each dimension: of a chunk, of its first sample, or of samples in it."""
Block = Callable[[Index, Index], NDArray[Any]]
"""(origin, shape), in samples -> the values there."""
Scheduler: TypeAlias = "str | Cluster | None"
"""Address of a dask.distributed scheduler, or a cluster object such as ``LocalCluster``."""

# Longest description of a source in an attribute.
_LONGEST_ATTRIBUTE = 200
# Seconds to wait for a scheduler, and for its first worker.
_PATIENCE = 10.0


def required(name: str) -> Any:
    """Return a module of the extra ``datasets``; raise MissingExtraError without it."""
    return require(name, "datasets", "large results are stored and shared out with")


def require_stores(scheduler: Scheduler = None) -> None:
    """Raise MissingExtraError unless the libraries of stores, or of schedulers, are installed."""
    for module in ("zarr", "dask", *(() if scheduler is None else ("distributed",))):
        required(module)


def chunks_within(shape: Sequence[int], samples: int) -> Index:
    """Return chunks of at most ``samples`` samples, by halving the longest axis again and again."""
    chunks = list(shape)
    while math.prod(chunks) > samples:
        longest = chunks.index(max(chunks))
        chunks[longest] = -(-chunks[longest] // 2)
    return tuple(chunks)


def source_attrs(source: Any) -> dict[str, str]:
    """Return the dataset attribute that describes a source in one line."""
    text = repr(source)
    return {
        "source": text
        if len(text) <= _LONGEST_ATTRIBUTE
        else f"{text:.{_LONGEST_ATTRIBUTE - 3}}..."
    }


def source_coords(source: Any) -> dict[str, xarray.Variable]:
    """Return the coordinate that holds a source as JSON."""
    # object: NumPy's texts of fixed length take four times the memory, and zarr has none
    values = np.array(source_json(source), dtype=object)
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
    # a node of the graph: a worker receives it once, and reuses its caches
    node, meta = dask.delayed(block, traverse=False), np.empty((0,) * len(shape), dtype)
    how = {"block": node, "compiled": compiled, "threads": threads}
    return arrays.map_blocks(_values, chunks=sizes, dtype=dtype, meta=meta, **how)


def _values(
    block: Block, compiled: bool, threads: int | None, block_info: Any = None
) -> NDArray[Any]:
    """Compute one chunk."""
    location = block_info[None]["array-location"]
    origin, shape = tuple(a for a, _ in location), tuple(b - a for a, b in location)
    if compiled and threads is None and "distributed" in sys.modules:
        with suppress(ValueError):  # no task of a worker
            threads = sys.modules["distributed"].get_worker().state.nthreads
    with kernel_threads(threads) if compiled else nullcontext():
        return np.asarray(block(origin, shape))


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
    StoreError for a path that cannot be written to, or holds something else; EngineError for a
    scheduler that does not respond; MissingExtraError without zarr or dask; and the errors of the
    blocks.
    """
    require_stores(scheduler)
    folder, dataset = checked_path(path), dataset.assign_attrs(written="chunk by chunk")
    is_new = not os.path.lexists(folder)
    if not is_new:
        _check_same(folder, dataset)
    tasks = _missing(folder, dataset)
    if not tasks:
        return open_store(folder)
    total = sum(array.data.npartitions for array in dataset.data_vars.values())
    here = nullcontext("synchronous" if compiled else "threads")
    with here if scheduler is None else _connected(scheduler) as how:
        try:
            if is_new:  # after the scheduler has responded
                _create(folder, dataset)
            with progress_bar(folder.name, total, total - len(tasks), progress) as advance:
                keys, dask = {task.key for task in tasks}, required("dask")
                with required("dask.callbacks").Callback(
                    posttask=lambda key, *_: advance() if key in keys else None
                ):
                    dask.compute(*tasks, scheduler=how, num_workers=threads)
        except OSError as error:
            if isinstance(error, PolywignerError):
                raise
            raise StoreError(
                f"cannot write to the store {folder}: {error}; correct that and start the same "
                "run again, which keeps finished chunks"
            ) from error
    return open_store(folder)


def _check_same(folder: Path, dataset: xarray.Dataset) -> None:
    """Raise StoreError unless a store has the settings of a dataset."""
    stored = open_store(folder)
    before, now = _settings_of(stored), _settings_of(dataset)
    different = [name for name in sorted(before | now) if before.get(name) != now.get(name)]
    if not stored.coords.equals(dataset.coords):
        different.append("coordinates")
    if different:
        raise StoreError(
            f"{folder} holds results of other settings ({', '.join(different)}); choose another "
            "name, or delete that store"
        )


def _settings_of(dataset: xarray.Dataset) -> dict[str, str]:
    """Return the attributes, types and chunks of a dataset as JSON texts, by name."""
    settings: dict[str, Any] = {str(name): value for name, value in dataset.attrs.items()}
    for name, array in dataset.data_vars.items():
        settings |= {f"{key} of {name}": value for key, value in array.attrs.items()}
        chunks = [sizes[0] for sizes in array.chunks or ()]
        settings[f"type and chunks of {name}"] = [array.dtype.name, array.shape, chunks]
    return {
        name: json.dumps(value, sort_keys=True, default=lambda numbers: numbers.tolist())
        for name, value in settings.items()
    }


def _create(folder: Path, dataset: xarray.Dataset) -> None:
    """Write metadata and coordinates of a store without chunks."""
    # not compressed: last digits are noise to a compressor, which halves the speed
    encoding: dict[Any, Any] = {
        name: {"compressors": (), "fill_value": array.dtype.type(np.nan)}  # of missing chunks
        for name, array in dataset.data_vars.items()
    }
    folder.parent.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings(), atomic_path(folder) as scratch:
        # zarr warns that other readers may not know its texts and consolidated metadata
        warnings.simplefilter("ignore")
        try:
            dataset.to_zarr(scratch, mode="w-", compute=False, zarr_format=3, encoding=encoding)
        except ValueError as error:  # chunks of unequal sizes
            raise ArgumentError(f"expected chunks that zarr can store: {error}") from None


def _missing(folder: Path, dataset: xarray.Dataset) -> list[Any]:
    """Return a task for each chunk that a store does not have, which computes and writes it."""
    tasks = []
    for name, array in dataset.data_vars.items():
        path, meta = folder.absolute() / str(name), np.empty((0,) * array.ndim)
        # dask fuses both steps: a chunk is never computed without being written
        blocks = array.data.map_blocks(_write_region, path=path, meta=meta).to_delayed()
        for index in np.ndindex(blocks.shape):
            if not path.joinpath("c", *map(str, index)).is_file():
                tasks.append(blocks[index])
    return tasks


def _write_region(values: NDArray[Any], path: Path, block_info: Any = None) -> NDArray[Any]:
    """Write one chunk to the array of a store, and return an empty array."""
    region = tuple(slice(*ends) for ends in block_info[0]["array-location"])
    # a chunk of nothing but NaN is complete as well
    array = required("zarr").open_array(path, mode="r+")
    array.with_config({"write_empty_chunks": True})[region] = values
    return values[(slice(0),) * values.ndim].copy()


def _connected(scheduler: Scheduler) -> Client:
    """Connect to a scheduler that has workers; EngineError without."""
    distributed = required("distributed")
    try:
        client = distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
        client.wait_for_workers(1, timeout=_PATIENCE)
    except Exception as error:  # of many types if something else responds
        raise EngineError(
            f"no dask scheduler with workers responds at {scheduler!r} ({type(error).__name__}: "
            f"{error!s:.300}); start `dask scheduler` and `dask worker`, and pass an address such "
            "as tcp://host:8786"
        ) from error
    return client


def open_store(path: str | os.PathLike[str]) -> xarray.Dataset:
    """Open a zarr store (format 3) lazily; StoreError for anything else.

    zarr has no codecs that could run code from the store, such as pickles.
    """
    required("zarr"), required("dask")
    import xarray

    folder = checked_path(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of other files in the folder
            return xarray.open_zarr(folder, zarr_format=3, consolidated=False)
    except Exception as error:  # zarr and its codecs raise many types
        raise StoreError(
            f"expected a zarr store of format 3 at {folder}, got something else there "
            f"({type(error).__name__}: {error!s:.200}); choose another name"
        ) from error
