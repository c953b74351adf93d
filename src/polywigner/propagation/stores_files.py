"""Chunked arrays on disk (zarr, format 3): layout, fingerprint of a run, lock, safe writes."""

from __future__ import annotations

import errno
import hashlib
import importlib.metadata
import json
import math
import os
import platform
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from polywigner.errors import ArgumentError, MissingExtraError, StoreError, install_command
from polywigner.illumination.source_files import SOURCE_COORDINATE, json_of, table_of
from polywigner.transforms.xarray_arguments import LabelledArray

__all__ = [
    "CHECKSUM",
    "FINGERPRINT",
    "METADATA",
    "SETTINGS",
    "Index",
    "Layout",
    "checksum_of",
    "chunks_within",
    "create",
    "digest_of",
    "fingerprint_of",
    "one_run",
    "recent_zarr",
    "require_stores",
    "required",
    "source_attrs",
    "source_coords",
    "source_settings",
    "to_disk",
    "told_settings",
    "versions",
]

try:
    import fcntl as _fcntl
except ImportError:  # Windows has no lock of this kind: its runs go on without
    _LOCKS: Any = None
else:
    _LOCKS = _fcntl


# What file systems answer that cannot be asked to write something out.
_NOT_KNOWN = {errno.EINVAL, errno.ENOTSUP, errno.ENOSYS}


@contextmanager
def one_run(path: Path) -> Iterator[None]:
    """Hold the place of a store for this run. Raises StoreError while another run holds it.

    The system's lock on the file NAME.lock beside the store ends with its process, whatever ends
    that. The next run takes over the file that a killed run leaves, and removes it. Workers of a
    cluster take no lock: theirs is the run of the process that started it.

    Nothing is locked on Windows, on file systems without such locks, and in folders that cannot be
    written to.
    """
    file = path.with_name(f"{path.name}.lock")
    descriptor = None if _LOCKS is None else _locked(file, path)
    try:
        yield
    finally:
        if descriptor is not None:
            file.unlink(missing_ok=True)  # first: who opens it now waits for nobody
            os.close(descriptor)


def _locked(file: Path, path: Path) -> int | None:
    """The file, open and locked; None where that cannot be."""
    while True:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            return None  # if there is something to write, writing says why it cannot
        try:
            _LOCKS.flock(descriptor, _LOCKS.LOCK_EX | _LOCKS.LOCK_NB)
            if _is_at(descriptor, file):
                os.ftruncate(descriptor, 0)
                os.write(descriptor, f"{os.getpid()} on {platform.node()}".encode())
                return descriptor
            os.close(descriptor)  # of a run that has just ended, and removed it
        except BlockingIOError:
            holder = os.read(descriptor, 300).decode(errors="replace")
            os.close(descriptor)
            raise StoreError(
                f"expected no other run to write to {path}, got one that does (process {holder}); "
                "wait for its end, or choose another name"
            ) from None
        except OSError:
            os.close(descriptor)
            file.unlink(missing_ok=True)
            return None


def _is_at(descriptor: int, file: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), file.stat())
    except FileNotFoundError:
        return False


def to_disk(path: Path) -> None:
    """Wait until the content of a file, or the names in a folder, are on the disk."""
    is_folder = path.is_dir()
    if is_folder and os.name == "nt":  # keeps no folder open
        return
    descriptor = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NOT_KNOWN:
            raise
    finally:
        os.close(descriptor)


Index = tuple[int, ...]
"""One number for each dimension: of a chunk, of its first sample, or of samples in it."""

# Number of the format: it changes with the files' content and layout.
_FORMAT = 1
# Libraries on whose rounding a value may depend.
_LIBRARIES = ("numpy", "drjit")
# Beyond this a source is told by its digest alone.
_LONGEST_SOURCE = 1 << 16
# Of a description, which is shown with a dataset.
_LONGEST_ATTRIBUTE = 200


@dataclass(frozen=True, eq=False)
class Layout:
    """An array of one variable on labelled axes, cut into chunks."""

    name: str
    """Name of the variable."""
    dtype: DTypeLike
    """float32, float64, complex64 or complex128."""
    coords: Mapping[str, LabelledArray]
    """Dimension -> its values (n,), with a unit; in the order of the array's axes."""
    chunks: Index
    """Samples of a chunk along each axis; chunks at the end may be cut short."""
    attrs: Mapping[str, Any] = field(default_factory=dict)
    """Attributes of the variable, its ``units`` among them: texts and numbers."""
    dataset_attrs: Mapping[str, Any] = field(default_factory=dict)
    """Attributes of the whole dataset: texts and numbers."""

    def __post_init__(self) -> None:
        shapes = {name: axis.shape for name, axis in self.coords.items()}
        if not shapes or any(len(shape) != 1 or not shape[0] for shape in shapes.values()):
            raise ArgumentError(f"expected coordinates of shape (n,), n > 0, got shapes {shapes}")
        whole = all(isinstance(n, int) and n > 0 for n in self.chunks)
        if len(self.chunks) != len(shapes) or not whole:
            raise ArgumentError(
                f"expected chunks of {len(shapes)} whole numbers above zero, got {self.chunks}"
            )
        if np.dtype(self.dtype).kind not in "fc":
            raise ArgumentError(f"expected a dtype of floats, got {np.dtype(self.dtype)}")

    @property
    def dims(self) -> tuple[str, ...]:
        return tuple(self.coords)

    @property
    def shape(self) -> Index:
        return tuple(axis.shape[0] for axis in self.coords.values())

    @property
    def grid(self) -> Index:
        """The number of chunks along each axis."""
        return tuple(-(-n // c) for n, c in zip(self.shape, self.chunks, strict=True))

    @property
    def count(self) -> int:
        """The number of chunks."""
        return math.prod(self.grid)

    @property
    def chunk_bytes(self) -> int:
        """Size of a chunk's file, which is padded to a whole chunk."""
        return math.prod(self.chunks) * np.dtype(self.dtype).itemsize

    def indices(self) -> Iterator[Index]:
        """All chunks, in the order of the array."""
        return product(*map(range, self.grid))

    def extent(self, index: Index) -> tuple[Index, Index]:
        """Origin and shape of a chunk, in samples."""
        origin = tuple(i * c for i, c in zip(index, self.chunks, strict=True))
        ends = zip(origin, self.chunks, self.shape, strict=True)
        return origin, tuple(min(c, n - o) for o, c, n in ends)


def chunks_within(shape: Sequence[int], samples: int) -> Index:
    """Chunks of at most ``samples`` samples: the longest axis is halved, the first among equals.

    Chunks are then about as long along every axis, and so a slice through the array in any
    direction reads about the same number of them.
    """
    chunks = list(shape)
    while math.prod(chunks) > samples:
        longest = chunks.index(max(chunks))
        chunks[longest] = -(-chunks[longest] // 2)
    return tuple(chunks)


def source_settings(source: Any) -> dict[str, Any]:
    """A source as a setting: the text of its source file, or the digest of a long one.

    Raises ArgumentError for anything but a source.
    """
    text = json_of(table_of(source))
    if len(text) <= _LONGEST_SOURCE:
        return {"source": text}
    return {"source_sha256": _digest_of_text(text)}


def source_attrs(source: Any) -> dict[str, str]:
    """Attributes of a dataset that say in one line which source it is of."""
    text = repr(source)
    if len(text) > _LONGEST_ATTRIBUTE:
        text = f"{text[: _LONGEST_ATTRIBUTE - 3]}..."
    return {"source": text, **{k: v for k, v in source_settings(source).items() if k != "source"}}


def source_coords(source: Any) -> dict[str, LabelledArray]:
    """The coordinate of a dataset that holds the whole source; none for a long one."""
    text = source_settings(source).get("source")
    if text is None:
        return {}
    # objects: NumPy's texts of fixed length take four times the memory, and zarr has none
    values = np.array(text, dtype=object)
    return {SOURCE_COORDINATE: LabelledArray(values, (), {"long_name": "source file in JSON"})}


def told_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with the digest of the source in place of its text."""
    told = dict(settings)
    text = told.pop("source", None)
    return told if text is None else {**told, "source_sha256": _digest_of_text(str(text))}


def versions() -> dict[str, str]:
    """Versions of all on which the last digits of a value may depend, beside the processor."""
    from polywigner import __version__

    libraries = {name: importlib.metadata.version(name) for name in _LIBRARIES}
    return {"polywigner": __version__, **libraries}


def fingerprint_of(layout: Layout, settings: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """(digest, all that it is made of): equal for runs that write the same numbers."""
    axes = {name: digest_of(axis.values) for name, axis in layout.coords.items()}
    whole = {
        "format": _FORMAT,
        **versions(),
        "variable": layout.name,
        "dtype": np.dtype(layout.dtype).name,
        "shape": list(layout.shape),
        "chunks": list(layout.chunks),
        **{f"coordinate {name}": digest for name, digest in axes.items()},
        **settings,
    }
    text = json.dumps(whole, sort_keys=True, allow_nan=False)
    return _digest_of_text(text), json.loads(text)


def _digest_of_text(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def digest_of(values: NDArray[Any]) -> str:
    """SHA-256 of the bytes of values."""
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


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
