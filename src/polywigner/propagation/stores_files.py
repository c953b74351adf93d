"""Chunked arrays on disk (zarr, format 3): made whole, filled chunk by chunk, taken up again.

A store appears whole, with all its metadata, by the renaming of a folder. Chunks are files that
zarr renames into place when they are written, so that one that exists is finished: no manifest has
to be kept, and whatever moment a run is killed at, nothing of it can be mistaken for a result. Each
ends with a checksum, for disks that lose or change bytes (``stores_checks``).
"""

from __future__ import annotations

import hashlib
import json
import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from polywigner.errors import MissingExtraError, StoreError, install_command
from polywigner.illumination.source_files import SOURCE_COORDINATE
from polywigner.propagation.stores_disk import to_disk
from polywigner.propagation.stores_layout import Layout, told_settings

__all__ = [
    "CHECKSUM",
    "FINGERPRINT",
    "METADATA",
    "SETTINGS",
    "checksum_of",
    "create",
    "recent_zarr",
    "require_stores",
    "required",
]

# Of the folder, of each array in it, and of a group: its metadata.
METADATA = "zarr.json"
# Attributes of the whole store.
FINGERPRINT = "polywigner_fingerprint"
SETTINGS = "polywigner_settings"
CHECKSUM = "polywigner_checksum"


def required(name: str) -> Any:
    """A module of the extra ``volume``; MissingExtraError without it."""
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError(
            f"expected {name} to be installed, which large results are stored and shared out with, "
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


def require_stores(scheduler: str | None = None) -> None:
    """Raise MissingExtraError without all that stores, or a scheduler beside them, take."""
    recent_zarr()
    for module in ("xarray", "dask", *(() if scheduler is None else ("distributed",))):
        required(module)


def create(path: Path, layout: Layout, fingerprint: str, settings: dict[str, Any]) -> None:
    """A store without chunks, whole or not at all.

    Raises StoreError where it cannot be written.
    """
    zarr = recent_zarr()
    scratch = path.with_name(f"{path.name}.partial")  # one name: swept by the next run
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(scratch, ignore_errors=True)
        checksum = [required("zarr.codecs").Crc32cCodec()]
        attrs = {**layout.dataset_attrs, FINGERPRINT: fingerprint}
        attrs[SETTINGS] = json.dumps(told_settings(settings))
        if "source" in settings:
            attrs["coordinates"] = SOURCE_COORDINATE  # to xarray it is none of the variables
        group = zarr.create_group(store=scratch, zarr_format=3, attributes=attrs)
        if "source" in settings:
            text = group.create_array(
                SOURCE_COORDINATE, shape=(), chunks=(), dtype="string", compressors=checksum
            )
            text[...] = settings["source"]
        for name, axis in layout.coords.items():
            group.create_array(
                name,
                data=axis.values,
                chunks=axis.shape,  # one, so that nothing goes on being written after an error
                compressors=checksum,
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
            # not compressed: the files' size is then known, before the run and of finished chunks
            compressors=checksum,
            dimension_names=layout.dims,
            attributes=dict(layout.attrs),
        )
        with warnings.catch_warnings():
            # zarr warns that other readers may not know the consolidated copy; they need not
            warnings.simplefilter("ignore")
            zarr.consolidate_metadata(scratch)
        _seal(scratch)
        for entry in (*scratch.rglob("*"), scratch):
            to_disk(entry)
        scratch.rename(path)
        to_disk(path.parent)
    except OSError as error:
        raise StoreError(
            f"expected to make the folder {path}, got {error.strerror or error}; choose another "
            "place, or free this one"
        ) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _seal(path: Path) -> None:
    """Write the checksum of a store's metadata into them."""
    file = path / METADATA
    table = json.loads(file.read_bytes())
    table["attributes"][CHECKSUM] = checksum_of(table)
    file.write_text(json.dumps(table, indent=2), encoding="utf-8")


def checksum_of(table: dict[str, Any]) -> str:
    """SHA-256 of a store's metadata, those of its arrays included, but for the checksum itself."""
    attrs = {name: value for name, value in table["attributes"].items() if name != CHECKSUM}
    text = json.dumps({**table, "attributes": attrs}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
