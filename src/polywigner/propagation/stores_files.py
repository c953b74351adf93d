"""Chunked arrays on disk (zarr, format 3): made whole, filled chunk by chunk, taken up again.

A store appears whole, with all its metadata, by the renaming of a folder. Chunks are files that
zarr renames into place when they are written, so that one that exists is finished: no manifest has
to be kept, and whatever moment a run is killed at, nothing of it can be mistaken for a result.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError, MissingExtraError, StoreError, install_command
from polywigner.illumination.files.reading import SOURCE_COORDINATE
from polywigner.propagation.stores_layout import Index, Layout, told_settings, versions

__all__ = ["Block", "ChunkWriter", "create", "missing", "recent_zarr", "recorded", "required"]

Block = Callable[[Index, Index], NDArray[Any]]
"""(origin, shape), in samples -> the values there."""

_FINGERPRINT = "polywigner_fingerprint"
_SETTINGS = "polywigner_settings"


def required(name: str) -> Any:
    """A module of the extra ``volume``; MissingExtraError without it."""
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError(
            f"expected {name} to be installed, which large tables and volumes are stored with, "
            f"got none ({error}); run {install_command('volume')}"
        ) from error


def recent_zarr() -> Any:
    """zarr with a local store that renames finished files into place; else MissingExtraError."""
    zarr = required("zarr")
    if not hasattr(zarr.Array, "with_config"):  # is as old as that: 3.1.6
        raise MissingExtraError(
            f"expected zarr 3.1.6 or newer, got {zarr.__version__}, which may leave half a file; "
            "run `pip install --upgrade zarr`"
        )
    return zarr


def create(path: Path, layout: Layout, fingerprint: str, settings: dict[str, Any]) -> None:
    """A store without chunks, whole or not at all.

    Raises StoreError where it cannot be written.
    """
    zarr = recent_zarr()
    scratch = path.with_name(f"{path.name}.partial")  # one name: swept by the next run
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(scratch, ignore_errors=True)
        attrs = {**layout.dataset_attrs, _FINGERPRINT: fingerprint}
        attrs[_SETTINGS] = json.dumps(told_settings(settings))
        if "source" in settings:
            attrs["coordinates"] = SOURCE_COORDINATE  # to xarray it is none of the variables
        group = zarr.create_group(store=scratch, zarr_format=3, attributes=attrs)
        if "source" in settings:
            text = group.create_array(SOURCE_COORDINATE, shape=(), chunks=(), dtype="string")
            text[...] = settings["source"]
        for name, axis in layout.coords.items():
            group.create_array(
                name,
                data=axis.values,
                chunks=axis.shape,  # one, so that nothing goes on being written after an error
                dimension_names=(name,),
                attributes=axis.attrs,
            )
        dtype = np.dtype(layout.dtype)
        group.create_array(
            layout.name,
            shape=layout.shape,
            chunks=layout.chunks,
            dtype=dtype,
            # chunks that are missing are read as NaN
            fill_value=complex(np.nan, np.nan) if dtype.kind == "c" else np.nan,
            # the files' size is then known: before the run, and of every chunk that is finished
            compressors=None,
            dimension_names=layout.dims,
            attributes=dict(layout.attrs),
        )
        with warnings.catch_warnings():
            # zarr warns that other readers may not know the consolidated copy; they need not
            warnings.simplefilter("ignore")
            zarr.consolidate_metadata(scratch)
        scratch.rename(path)
    except OSError as error:
        raise StoreError(
            f"expected to make the folder {path}, got {error.strerror or error}; choose another "
            "place, or free this one"
        ) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def recorded(path: Path) -> tuple[str, dict[str, Any]] | None:
    """Fingerprint and settings of the store at a path; None for anything else that is there."""
    try:
        attrs = json.loads((path / "zarr.json").read_bytes())["attributes"]
        # older stores have the text of the source among their settings
        return attrs[_FINGERPRINT], told_settings(json.loads(attrs[_SETTINGS]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def missing(path: Path, layout: Layout) -> list[Index]:
    """The chunks that are not there yet; all, where there is no store.

    Removes what killed runs have left half written. A file of another size is one that the file
    system lost, as some do when the power fails.
    """
    if not path.exists():
        return list(layout.indices())
    sizes: dict[str, int] = {}
    folders = [str(path / layout.name)]
    while folders:
        with os.scandir(folders.pop()) as entries:
            for entry in entries:
                if entry.is_dir():
                    folders.append(entry.path)
                elif entry.name.endswith(".partial"):
                    Path(entry.path).unlink(missing_ok=True)
                else:
                    sizes[entry.path] = entry.stat().st_size
    metadata = _array(str(path), layout.name).metadata

    def finished(index: Index) -> bool:
        file = path / layout.name / metadata.encode_chunk_key(index)
        return sizes.get(str(file)) == layout.chunk_bytes

    return [index for index in layout.indices() if not finished(index)]


def _array(path: str, name: str) -> Any:
    array = recent_zarr().open_array(Path(path) / name, mode="r+")
    # A chunk of nothing but NaN is finished as well. (zarr.open_array ignores ``config``.)
    return array.with_config({"write_empty_chunks": True})


@cache
def _checked_array(path: str, name: str, fingerprint: str) -> Any:
    """The array, if this process sees the store of that run."""
    found = recorded(Path(path))
    if found is None or found[0] != fingerprint:
        raise StoreError(
            f"expected every worker to see the store {path}, got none of this run on "
            f"{platform.node()}; put it on a file system that all workers share"
        )
    own = versions()
    planned = {name: found[1].get(name) for name in own}
    if planned != own:
        raise StoreError(
            f"expected the versions {planned} on every worker, got {own} on {platform.node()}; "
            "install the same everywhere"
        )
    return _array(path, name)


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

    def __call__(self, index: Index) -> None:
        array = _checked_array(self.path, self.layout.name, self.fingerprint)
        if self._is_finished(array.metadata.encode_chunk_key(index)):
            return  # by another worker, that was thought dead
        origin, shape = self.layout.extent(index)
        values = self._values(origin, shape)
        if values.shape != shape or values.dtype != self.layout.dtype:
            raise ArgumentError(
                f"expected the block at {origin} to be {shape} of {self.layout.dtype}, got "
                f"{values.shape} of {values.dtype}"
            )
        where = tuple(slice(o, o + n) for o, n in zip(origin, shape, strict=True))
        try:
            array[where] = values
        except OSError as error:
            raise StoreError(
                f"expected to write to {self.path}, got {error.strerror or error}; put that right "
                "and start the same run again: what is finished stays"
            ) from error

    def _is_finished(self, key: str) -> bool:
        file = Path(self.path) / self.layout.name / key
        try:
            return file.stat().st_size == self.layout.chunk_bytes
        except OSError:
            return False

    def _values(self, origin: Index, shape: Index) -> NDArray[Any]:
        if not self.exclusive:
            return np.asarray(self.block(origin, shape))
        with execution.kernel_threads(self.threads):
            return np.asarray(self.block(origin, shape))
