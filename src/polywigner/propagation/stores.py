"""Datasets in memory, lazy or on disk: zarr stores written by chunks, and NetCDF files.

zarr renames a temporary file, so a chunk is either complete or missing. A second run with the same
settings computes only the missing chunks (docs/large_runs.md).
"""

from __future__ import annotations

import json
import math
import os
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict

import numpy as np
from numpy.typing import DTypeLike, NDArray

from polywigner.errors import (
    ArgumentError,
    EngineError,
    PolywignerError,
    StoreError,
    require,
    value_text,
)
from polywigner.execution import MOST_THREADS, kernel_threads
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import check_most, checked_count, checked_path, in_place
from polywigner.interruption import atomic_path
from polywigner.source.source_files import SOURCE_COORDINATE, source_json
from polywigner.transforms.xarray_arguments import labelled_array, labelled_arrays

if TYPE_CHECKING:
    import dask.array
    import xarray
    from distributed import Client
    from distributed.deploy import Cluster

Index = tuple[int, ...]
"""Index or number of samples along each dimension."""
Block = Callable[[Index, Index], NDArray[Any]]
"""Function of the first index and the shape that computes a block of a grid."""
Variable: TypeAlias = tuple[Block, DTypeLike, dict[str, Any]]
"""Function that computes blocks of a variable, its dtype, and its attributes."""
Chunks: TypeAlias = int | str | Sequence[int | str | Sequence[int] | None] | Mapping[int, Any]
"""Chunk sizes in a form that dask accepts."""
Scheduler: TypeAlias = "str | Cluster | None"
Stored: TypeAlias = "xarray.Dataset | xarray.DataArray | str | os.PathLike[str]"
"""Dataset, or path of a store."""

# Timeout [s] for a scheduler and its first worker.
_PATIENCE = 10.0

# Largest number of samples in memory (16 GiB of float32). The limit is needed because some systems
# accept allocations of any size.
_MOST_IN_MEMORY = 1 << 32

LARGEST_CHUNK = 1 << 22
"""Largest number of samples per chunk (16 MiB of float32), enough for the full speed of kernels."""


def required(*names: str) -> ModuleType:
    """Import modules of the extra ``datasets``, and return the last module.

    Raises MissingExtraError if a module is not installed.
    """
    modules: list[ModuleType] = [
        require(name, "datasets", "large results are stored and distributed with") for name in names
    ]
    return modules[-1]


def chunks_within(shape: Sequence[int], samples: int) -> Index:
    """Return the shape of chunks of up to ``samples`` samples, by halving the longest sides."""
    chunks = list(shape)
    while math.prod(chunks) > samples:
        longest = chunks.index(max(chunks))
        chunks[longest] = -(-chunks[longest] // 2)
    return tuple(chunks)


def source_attrs(source: Any) -> dict[str, str]:
    """Return the attribute that describes a source in at most 200 characters."""
    return {"source": f"{source!r:.200}"}


def source_coords(source: Any) -> dict[str, xarray.Variable]:
    """Return the coordinate that contains a source as JSON."""
    # zarr cannot store strings of fixed length.
    values = np.array(source_json(source), dtype=object)
    return {SOURCE_COORDINATE: labelled_array(values, (), {"long_name": "source file in JSON"})}


class StoreOptions(TypedDict, total=False):
    """Options of lazy or stored datasets."""

    chunks: Chunks | None
    scheduler: Scheduler
    threads: int | None
    progress: bool | None


def results_on_grid(
    variables: Mapping[str, Variable],
    axes: Mapping[str, xarray.Variable],
    coords: Mapping[str, Any],
    attrs: Mapping[str, Any],
    options: Mapping[str, Any],
    *,
    block_size: int = LARGEST_CHUNK,
    chunk_size: int = LARGEST_CHUNK,
    compiled: bool = True,
) -> xarray.Dataset:
    """Return a dataset: by default in memory, lazy with ``chunks``, or stored with ``out``.

    ``options`` contains StoreOptions and ``out``. ``block_size`` limits the number of samples of a
    block in memory, and ``chunk_size`` the number of samples of a stored chunk. If ``compiled`` is
    true, all threads work on the same chunk. Otherwise, each thread computes a separate chunk.
    Raises ArgumentError, StoreError, EngineError or MissingExtraError.
    """
    from polywigner import __version__

    shape = tuple(axis.size for axis in axes.values())
    out, chunks, scheduler, threads, progress = (
        options.get(name) for name in ("out", "chunks", "scheduler", "threads", "progress")
    )
    if out is None and not (scheduler is None and threads is None):
        raise ArgumentError(
            "scheduler and threads require out: expected the path of a store, got None"
        )
    if threads is not None:
        threads = checked_count(threads, "threads", 1, MOST_THREADS)
    if out is not None and (chunks is None or chunks == "auto"):
        chunks = chunks_within(shape, chunk_size)
    data = {}
    for name, (block, dtype, about) in variables.items():
        if chunks is None:
            values: Any = _in_memory(name, block, shape, dtype, block_size, progress)
        else:
            values = _lazy_array(block, shape, chunks, dtype, compiled, threads)
        data[name] = tuple(axes), values, {**about, "polywigner_version": __version__}
    result = labelled_arrays(data, {**axes, **coords}, attrs)
    if out is None:
        return result
    _fill_store(checked_path(out), result, "synchronous" if compiled else "threads", options)
    return open_store(out)


def _in_memory(
    name: str, block: Block, shape: Index, dtype: DTypeLike, block_size: int, progress: bool | None
) -> NDArray[Any]:
    """Compute all blocks of a variable, and return its values."""
    remedy = "pass chunks for a lazy result, or out to write it to disk"
    check_most(math.prod(shape), _MOST_IN_MEMORY, "samples in memory", remedy)
    values, size = np.empty(shape, dtype), chunks_within(shape, block_size)
    origins = list(product(*(range(0, n, c) for n, c in zip(shape, size, strict=True))))
    with progress_bar(name, len(origins), show=progress) as advance:
        for origin in origins:
            part = values[tuple(slice(o, o + c) for o, c in zip(origin, size, strict=True))]
            part[...] = block(origin, part.shape)
            advance()
    return values


def _lazy_array(
    block: Block, shape: Index, chunks: Any, dtype: DTypeLike, compiled: bool, threads: int | None
) -> dask.array.Array:
    """Return a dask array whose chunks are computed on demand."""
    arrays, core = required("dask.array"), required("dask.array.core")
    try:
        sizes = core.normalize_chunks(chunks, shape, dtype=dtype)
        if not all(n > 0 for axis in sizes for n in axis):
            raise ValueError("chunks must contain at least one sample")
    except (TypeError, ValueError, ArithmeticError) as error:
        raise ArgumentError(
            f"expected chunks that dask accepts: a number, a tuple of {len(shape)} numbers, or "
            f"'auto', got {chunks!r}: {error}"
        ) from None
    # dask sends a node of the graph to each worker only once, together with the caches of the
    # function.
    node = required("dask").delayed(block, traverse=False)
    options = {"chunks": sizes, "dtype": dtype, "meta": np.empty((0,) * len(shape), dtype)}
    array: dask.array.Array = arrays.map_blocks(_compute_chunk, node, compiled, threads, **options)
    return array


def _compute_chunk(
    block: Block, compiled: bool, threads: int | None, block_info: Any = None
) -> NDArray[Any]:
    """Compute the chunk of an array whose location dask specifies in ``block_info``."""
    location = block_info[None]["array-location"]
    origin, shape = tuple(a for a, _ in location), tuple(b - a for a, b in location)
    if compiled and threads is None and "distributed" in sys.modules:
        # get_worker raises ValueError outside a worker.
        with suppress(ValueError):
            threads = sys.modules["distributed"].get_worker().state.nthreads
    with kernel_threads(threads) if compiled else nullcontext():
        return np.asarray(block(origin, shape))


def _fill_store(
    folder: Path, dataset: xarray.Dataset, default: str, options: Mapping[str, Any]
) -> None:
    """Compute the missing chunks of a store, which is created if necessary.

    ``default`` is the dask scheduler to use if the option ``scheduler`` is not specified.
    """
    scheduler, threads = options.get("scheduler"), options.get("threads")
    required("zarr", "dask")
    import dask
    from dask.callbacks import Callback

    is_new = not os.path.lexists(folder)
    if not is_new:
        _check_same(folder, dataset)
    tasks = _missing_tasks(folder, dataset)
    if not tasks:
        return
    keys, total = {task.key for task in tasks}, sum(a.data.npartitions for a in dataset.values())
    bar = progress_bar(folder.name, total, total - len(tasks), options.get("progress"))
    with nullcontext(default) if scheduler is None else _client(scheduler) as executor:
        try:
            # Create the store after connecting, so that a failed connection leaves no store.
            if is_new:
                _create_store(folder, dataset)
            with bar as advance, Callback(posttask=lambda key, *_: key in keys and advance()):
                dask.compute(*tasks, scheduler=executor, num_workers=threads)
        except OSError as error:
            if isinstance(error, PolywignerError):
                raise
            raise StoreError(
                f"cannot write to the store {folder}: {error}; correct the cause and start the "
                "same run again, which keeps finished chunks"
            ) from error


def _check_same(folder: Path, dataset: xarray.Dataset) -> None:
    """Raise StoreError if a store has other settings, coordinates or chunks than a dataset."""
    stored = open_store(folder)
    before, now = _settings_of(stored), _settings_of(dataset)
    different = [name for name in sorted(before | now) if before.get(name) != now.get(name)]
    if not stored.coords.equals(dataset.coords):
        different.append("coordinates")
    if different:
        raise StoreError(
            f"the store {folder} contains results for other settings (differences: "
            f"{', '.join(different)}); choose another path, or delete the store"
        )


def _settings_of(dataset: xarray.Dataset) -> dict[str, str]:
    """Return attributes, types and chunk sizes of a dataset as JSON texts."""
    settings: dict[str, Any] = dict(dataset.attrs)
    for name, array in dataset.data_vars.items():
        settings |= {f"{key} of {name}": value for key, value in array.attrs.items()}
        settings[f"type and chunks of {name}"] = [array.dtype.name, array.chunks]
    return {
        name: json.dumps(value, sort_keys=True, default=lambda numbers: numbers.tolist())
        for name, value in settings.items()
    }


def _create_store(folder: Path, dataset: xarray.Dataset) -> None:
    """Create a zarr store with coordinates and attributes, but without values."""
    # The values are not compressed, because compression would halve the speed, and rounding errors
    # do not compress.
    encoding: dict[Any, Any] = {
        name: {"compressors": (), "fill_value": array.dtype.type(np.nan)}  # NaN for missing chunks
        for name, array in dataset.data_vars.items()
    }
    folder.parent.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings(), atomic_path(folder) as scratch:
        # zarr warns about strings, and about missing consolidated metadata.
        warnings.simplefilter("ignore")
        try:
            dataset.to_zarr(scratch, mode="w-", compute=False, zarr_format=3, encoding=encoding)
        except ValueError as error:  # zarr requires chunks of equal size.
            raise ArgumentError(
                f"zarr cannot store these chunks: {error}; pass other chunks"
            ) from None


def _missing_tasks(folder: Path, dataset: xarray.Dataset) -> list[Any]:
    """Return a dask task for each chunk without a file, which computes and writes the chunk."""
    tasks = []
    for name, array in dataset.data_vars.items():
        path, meta = folder.absolute() / str(name), np.empty((0,) * array.ndim)
        # dask computes and writes a chunk in a single task.
        blocks = array.data.map_blocks(_write_region, path=path, meta=meta).to_delayed()
        for index in np.ndindex(blocks.shape):
            if not path.joinpath("c", *map(str, index)).is_file():
                tasks.append(blocks[index])
    return tasks


def _write_region(values: NDArray[Any], path: Path, block_info: Any = None) -> NDArray[Any]:
    """Write a chunk to a zarr array, and return an empty array."""
    region = tuple(slice(*ends) for ends in block_info[0]["array-location"])
    # A chunk without a file counts as missing, even if all its values are NaN.
    array = required("zarr").open_array(path, mode="r+")
    array.with_config({"write_empty_chunks": True})[region] = values
    return values[(slice(0),) * values.ndim].copy()


def _client(scheduler: Scheduler) -> Client:
    """Return a dask client with at least one worker; raise EngineError if there is none."""
    distributed = required("distributed")
    try:
        client = distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
        client.wait_for_workers(1, timeout=_PATIENCE)
    except Exception as error:  # Servers other than a dask scheduler raise errors of many types.
        raise EngineError(
            f"no dask scheduler with workers responds at {scheduler!r} ({type(error).__name__}: "
            f"{error!s:.300}); start `dask scheduler` and `dask worker`, and pass an address such "
            "as tcp://host:8786"
        ) from error
    return client


def open_store(path: str | os.PathLike[str]) -> xarray.Dataset:
    """Open a Zarr store of format 3 lazily; raise StoreError if the path is not such a store."""
    required("zarr", "dask")
    import xarray

    folder = checked_path(path)
    try:
        return xarray.open_zarr(folder, zarr_format=3, consolidated=False)
    except Exception as error:  # zarr and its codecs raise errors of many types.
        raise StoreError(
            f"there is no zarr store of format 3 at {folder} ({type(error).__name__}: "
            f"{error!s:.200}); choose another path"
        ) from error


def write_netcdf(dataset: Stored, path: str | os.PathLike[str]) -> None:
    """Write a dataset to a NetCDF 4 file for MATLAB, Julia, ParaView, xarray and other programs.

    NetCDF has no complex numbers, so a complex variable A becomes two variables A_real and A_imag.
    The function requires the extra ``datasets``.

    Parameters
    ----------
    dataset : xarray.Dataset, xarray.DataArray or path
        Dataset in memory or lazy, or the path of a zarr store. The dataset may be larger than
        memory.
    path : path
        Path of the file. An existing file is replaced. The file is written completely or not at
        all.

    Raises
    ------
    ArgumentError
        If ``dataset`` is not a dataset, or the file cannot be written.
    StoreError
        If there is no zarr store at the path ``dataset``.
    MissingExtraError
        If h5netcdf is not installed.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> table = pw.wigner_table(pw.shapes.square(1.0), [0.0], [0.0], [0.0, 0.5], [0.0])
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "w.nc"
    >>> pw.write_netcdf(table, path)
    >>> path.stat().st_size > 0
    True
    """
    required("h5netcdf", "h5py")
    parts = _real_parts(_as_dataset(dataset))
    with in_place(checked_path(path)) as scratch:
        parts.to_netcdf(scratch, engine="h5netcdf")


def write_zarr(dataset: Stored, path: str | os.PathLike[str]) -> None:
    """Write a dataset, which may be complex, to a zarr store of format 3.

    A store at the same path is replaced.
    """
    required("zarr")
    with in_place(checked_path(path)) as scratch, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # zarr warns about missing consolidated metadata.
        _as_dataset(dataset).to_zarr(scratch, mode="w-", zarr_format=3)


def _as_dataset(dataset: Stored) -> xarray.Dataset:
    """Convert a dataset, a data array or the store at a path to a dataset.

    An unnamed data array becomes the variable ``values``. Raises ArgumentError for other objects,
    and StoreError if there is no store at the path.
    """
    import xarray

    if isinstance(dataset, xarray.DataArray):
        return dataset.to_dataset(name=dataset.name or "values")
    if isinstance(dataset, xarray.Dataset):
        return dataset
    if isinstance(dataset, (str, os.PathLike)):
        return open_store(dataset)
    raise ArgumentError(
        f"expected dataset to be an xarray.Dataset or the path of a store, "
        f"got {value_text(dataset)}"
    )


def _real_parts(dataset: xarray.Dataset) -> xarray.Dataset:
    """Return a dataset with real variables, and attributes that NetCDF files can contain."""
    for name, array in dataset.data_vars.items():
        if array.dtype.kind == "c":
            parts = {f"{name}_real": array.real, f"{name}_imag": array.imag}
            dataset = dataset.drop_vars(name).assign(
                {key: part.assign_attrs(array.attrs) for key, part in parts.items()}
            )
    dataset = dataset.drop_encoding()
    plain = (str, int, float, np.ndarray, np.number)
    for item in (dataset, *(dataset[name] for name in dataset.variables)):
        item.attrs = {
            name: value
            if isinstance(value, plain) and not isinstance(value, bool)
            else json.dumps(value)
            for name, value in item.attrs.items()
        }
    return dataset
