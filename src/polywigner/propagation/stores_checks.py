"""Stores on disk (zarr, format 3): layout, settings, missing and damaged chunks.

zarr's own codec writes a CRC-32C behind every chunk, so that all readers of zarr notice a damaged
one. The metadata carry a SHA-256, coordinates and source one each. Chunks of one array that have
changed places are not noticed: a checksum is one of bytes, not of their place.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from polywigner.errors import ArgumentError, FileFormatError, MissingExtraError, StoreError, require
from polywigner.execution.progress import progress_bar
from polywigner.geometry.arguments import checked_path
from polywigner.geometry.io.limits import bytes_of
from polywigner.illumination.source_files import SOURCE_COORDINATE, json_of, table_of
from polywigner.transforms.xarray_arguments import labelled_array

if TYPE_CHECKING:
    import xarray

# Of the folder, and of each array in it: its metadata.
METADATA = "zarr.json"
# Attributes of the whole store.
SETTINGS = "polywigner_settings"
CHECKSUM = "polywigner_checksum"
# Beyond this a source is told by its digest alone.
_LONGEST_SOURCE = 1 << 16
# Of a description, which is shown with a dataset.
_LONGEST_ATTRIBUTE = 200
# Chunks that a message names.
_NAMED = 8

Index = tuple[int, ...]
"""One number for each dimension: of a chunk, of its first sample, or of samples in it."""


def required(name: str) -> Any:
    """Return a module of the extra ``volume``; raise MissingExtraError without it."""
    return require(name, "volume", "large results are stored and shared out with")


def require_stores(scheduler: str | None = None) -> None:
    """Raise MissingExtraError without all that stores, or a scheduler beside them, take."""
    for module in ("zarr", "dask", *(() if scheduler is None else ("distributed",))):
        required(module)


@dataclass(frozen=True, eq=False)
class Layout:
    """An array of one variable on labelled axes, cut into chunks; attributes as JSON keeps them."""

    name: str
    dtype: DTypeLike
    coords: Mapping[str, xarray.Variable]
    """Dimension -> its values (n,), with a unit; in the order of the array's axes."""
    chunks: Index
    """Samples of a chunk along each axis; chunks at the end may be cut short."""
    attrs: Mapping[str, Any] = field(default_factory=dict)
    dataset_attrs: Mapping[str, Any] = field(default_factory=dict)

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

    def extent(self, index: Index) -> tuple[Index, Index]:
        """Origin and shape of a chunk, in samples."""
        origin = tuple(i * c for i, c in zip(index, self.chunks, strict=True))
        ends = zip(origin, self.chunks, self.shape, strict=True)
        return origin, tuple(min(c, n - o) for o, c, n in ends)


def chunks_within(shape: Sequence[int], samples: int) -> Index:
    """Chunks of at most ``samples`` samples: the longest axis is halved, the first among equals."""
    chunks = list(shape)
    while math.prod(chunks) > samples:
        longest = chunks.index(max(chunks))
        chunks[longest] = -(-chunks[longest] // 2)
    return tuple(chunks)


# Most samples in memory: 16 GiB of float32.
_MOST_IN_MEMORY = 1 << 32


def check_memory(shape: Sequence[int]) -> None:
    """Raise ArgumentError for arrays too large to be computed in memory."""
    if math.prod(shape) > _MOST_IN_MEMORY:
        raise ArgumentError(
            f"expected at most {_MOST_IN_MEMORY} samples in memory, got {math.prod(shape):.3g}; "
            "use chunks, or write them to disk with out"
        )


@contextmanager
def as_store_error(expected: str, remedy: str) -> Iterator[None]:
    """Turn errors of the system in the block into a StoreError."""
    try:
        yield
    except StoreError:
        raise
    except OSError as error:
        raise StoreError(f"expected {expected}, got {error.strerror or error}; {remedy}") from error


def digest_of(content: NDArray[Any] | str) -> str:
    """SHA-256 of a text, or of the bytes of values."""
    raw = content.encode() if isinstance(content, str) else np.ascontiguousarray(content).tobytes()
    return hashlib.sha256(raw).hexdigest()


def checksum_of(table: dict[str, Any]) -> str:
    """SHA-256 of the metadata of a store and its arrays, without the checksum itself."""
    attrs = {name: value for name, value in table["attributes"].items() if name != CHECKSUM}
    return digest_of(json.dumps({**table, "attributes": attrs}, sort_keys=True))


def with_digest(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with the digest of the source in place of its text."""
    rest = dict(settings)
    text = rest.pop("source", None)
    return rest if text is None else {**rest, "source_sha256": digest_of(str(text))}


def source_settings(source: Any) -> dict[str, Any]:
    """A source as a setting: the text of its source file, or the digest of a long one."""
    text = json_of(table_of(source))
    if len(text) <= _LONGEST_SOURCE:
        return {"source": text}
    return {"source_sha256": digest_of(text)}


def source_attrs(source: Any) -> dict[str, str]:
    """Attributes of a dataset that say in one line which source it is of."""
    text = repr(source)
    if len(text) > _LONGEST_ATTRIBUTE:
        text = f"{text[: _LONGEST_ATTRIBUTE - 3]}..."
    return {**source_settings(source), "source": text}


def source_coords(source: Any) -> dict[str, xarray.Variable]:
    """The coordinate of a dataset that holds the source; none for a long one."""
    return source_coordinate(source_settings(source).get("source"))


def source_coordinate(text: str | None) -> dict[str, xarray.Variable]:
    """The coordinate that holds the text of a source file; none without a text."""
    if text is None:
        return {}
    # objects: NumPy's texts of fixed length take four times the memory, and zarr has none
    values = np.array(text, dtype=object)
    return {SOURCE_COORDINATE: labelled_array(values, (), {"long_name": "source file in JSON"})}


def recorded(path: Path) -> dict[str, Any] | None:
    """Return the settings of the run that wrote a store; None for anything else at the path."""
    try:
        content = bytes_of(path / METADATA, _LARGEST_METADATA)
    except FileFormatError:
        return None
    try:
        table = json.loads(content)
        attrs = table.get("attributes", {}) if isinstance(table, dict) else {}
        if not isinstance(attrs, dict) or not any(key.startswith("polywigner_") for key in attrs):
            return None
        is_older = CHECKSUM not in attrs and b'"crc32c"' not in content
        if not is_older and attrs.get(CHECKSUM) != checksum_of(table):
            raise ValueError("its checksum is that of other content")
        for name, copy in table["consolidated_metadata"]["metadata"].items():
            if json.loads(bytes_of(path / name / METADATA, _LARGEST_METADATA)) != copy:
                raise ValueError(f"{name}/{METADATA} is not what it was")
        return with_digest(json.loads(attrs[SETTINGS]))  # older stores have the text there
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise _broken(path, "metadata", error) from error


def stored_array(path: Path, settings: dict[str, Any]) -> Any:
    """Open the array of a store whose coordinates and source match their digests."""
    part = "metadata"
    try:
        check_store(path)
        array = open_array(path, settings["variable"])
        digests = {axis: settings[f"coordinate {axis}"] for axis in array.metadata.dimension_names}
        if (path / SOURCE_COORDINATE).exists():  # long sources are not kept
            digests[SOURCE_COORDINATE] = settings["source_sha256"]
        for name, digest in digests.items():
            part = f"coordinate {name}"
            content = open_array(path, name)[...]
            if digest_of(str(content) if name == SOURCE_COORDINATE else content) != digest:
                raise ValueError("its digest is that of another content")
        return array
    except (MissingExtraError, StoreError):
        raise
    except Exception as error:  # zarr, its codecs and NumPy raise of many kinds
        raise _broken(path, part, error) from error


def _broken(path: Path, part: str, error: Exception) -> StoreError:
    reason = str(error) or type(error).__name__
    return StoreError(
        f"expected the store {path} as it was written, got damaged {part} ({reason[:200]}); put "
        "its files back from a copy, or delete that store and start again"
    )


# Codecs that decode numbers and texts; others may run code (numcodecs' pickle, for one).
_CODECS = {
    "bytes", "crc32c", "zstd", "gzip", "blosc", "transpose", "sharding_indexed", "vlen-utf8",
    "vlen-bytes",
}  # fmt: skip
_MOST_CHUNKS, _LARGEST_METADATA = 10**8, 1 << 22
# Of a chunk, which is in memory as a whole, and bytes of its file: four gigabytes.
_MOST_SAMPLES, _LARGEST_CHUNK = 1 << 28, (1 << 32) + (1 << 20)


def check_metadata(path: Path) -> None:
    """Raise StoreError for an array of another format, of strange codecs or of endless chunks."""
    try:
        table = json.loads(bytes_of(path / METADATA, _LARGEST_METADATA))
        inner = [codec.get("configuration") or {} for codec in table["codecs"]]  # of shards
        parts = [own.get(kind, ()) for own in inner for kind in ("codecs", "index_codecs")]
        codecs = [codec["name"] for codec in chain(table["codecs"], *parts)]
        chunks = table["chunk_grid"]["configuration"]["chunk_shape"]
        count = math.prod(-(-n // c) for n, c in zip(table["shape"], chunks, strict=True))
        if table["zarr_format"] != 3 or not set(codecs) <= _CODECS:
            raise ValueError(f"codecs {', '.join(codecs)[:200]}")
        if not 0 <= count <= _MOST_CHUNKS:
            raise ValueError(f"{count} chunks")
        if math.prod(chunks) > _MOST_SAMPLES:
            raise ValueError(f"chunks of {math.prod(chunks):g} samples")
    except (
        FileFormatError, ValueError, KeyError, TypeError, AttributeError, ZeroDivisionError
    ) as error:  # fmt: skip
        raise StoreError(
            f"expected an array of zarr, format 3, with its own codecs and at most "
            f"{_MOST_CHUNKS:g} chunks in {path}, got {error}"
        ) from None


def check_store(path: Path) -> None:
    """Check the files and metadata of all arrays in a folder before anything of it is decoded."""
    for folder, below, names in os.walk(path):
        for name in below:
            if os.path.islink(os.path.join(folder, name)):  # noqa: PTH114, PTH118 (ten times faster)
                raise StoreError(f"expected a store in one place, got a link at {folder}/{name}")
        for name in names:
            try:
                found = os.stat(os.path.join(folder, name))  # noqa: PTH116, PTH118
            except FileNotFoundError:  # half a chunk of a run that goes on, renamed meanwhile
                continue
            if not stat.S_ISREG(found.st_mode) or found.st_size > _LARGEST_CHUNK:
                raise StoreError(
                    f"expected files of a store of up to 4 GiB, got another one at {folder}/{name}"
                )
    for entry in sorted(path.iterdir()):
        if (entry / METADATA).is_file():
            check_metadata(entry)


def open_array(path: Path, name: str) -> Any:
    """Open an array of a store whose metadata are whole."""
    array = required("zarr").open_array(path / name, mode="r+", zarr_format=3)
    # A chunk of nothing but NaN is finished as well. (zarr.open_array ignores ``config``.)
    return array.with_config({"write_empty_chunks": True})


def chunk_file(array: Any, index: Index) -> Path:
    """The file of a chunk."""
    return Path(array.store.root, array.metadata.encode_chunk_key(index))


def chunk_faults(array: Any, progress: bool | None) -> tuple[list[Index], list[Index]]:
    """Return missing chunks, and chunks that zarr finds damaged."""
    title, missing, damaged = array.store.root.parent.name, [], []
    with progress_bar(f"{title}: checksums", array.nchunks, show=progress) as advance:
        for index in np.ndindex(array.cdata_shape):
            if not chunk_file(array, index).is_file():
                missing.append(index)
            else:
                try:
                    array.blocks[index]
                except ValueError:  # by the codec
                    damaged.append(index)
            advance()
    return missing, damaged


def verify_store(path: str | os.PathLike[str], *, progress: bool | None = None) -> int:
    """Read a store that `volume` or a table has written, and compare it with its checksums.

    Changes nothing, and may be called while a run writes to the store: chunks that are to come are
    then told as missing.

    Parameters
    ----------
    path : the folder of the store.
    progress : whether to draw a progress bar; None: on a terminal.

    Returns
    -------
    The number of chunks, all of which are there and as they were written.

    Raises
    ------
    StoreError for damaged or missing parts, which it names; for a store of an older version, which
    has no checksums; and for anything else at the path. MissingExtraError without zarr.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> out = pathlib.Path(tempfile.mkdtemp()) / "w.zarr"
    >>> found = pw.wigner_table(pw.shapes.square(1.0), [0.0], [0.0], [0.0, 0.5], [0.0], out)
    >>> pw.verify_store(out)
    1
    """
    required("zarr")
    folder = checked_path(path)
    settings = recorded(folder)
    if settings is None:
        raise StoreError(
            f"expected a store of polywigner at {folder}, got none; name the folder, such as "
            "field.zarr"
        )
    array = stored_array(folder, settings)
    with as_store_error(f"to read {folder}", "check its permissions"):
        missing, damaged = chunk_faults(array, progress)
    faults = []
    for kind, indices in (("missing", missing), ("damaged", damaged)):
        files = [chunk_file(array, index).relative_to(array.store.root.parent) for index in indices]
        named = ", ".join(file.as_posix() for file in files[:_NAMED])
        more = f" and {len(files) - _NAMED} more" if len(files) > _NAMED else ""
        faults += [f"{len(files)} {kind}: {named}{more}"] if files else []
    if faults:
        raise StoreError(
            f"expected {array.nchunks} whole chunks in {folder}, got {'; '.join(faults)}; start "
            "the run that wrote it once more: it computes these anew"
        )
    if not array.compressors:
        raise StoreError(
            f"expected checksums in {folder}, got a store of an older version without; its "
            f"{array.nchunks} chunks are all there and of the right size, and no more can be told"
        )
    return int(array.nchunks)
