"""What a store on disk is, what is missing in it, and what is damaged.

Every chunk carries its CRC-32C as zarr's own codec writes it, so that all readers of zarr notice a
damaged one. The metadata carry a SHA-256, coordinates and source one each. Stores of older versions
have sizes and the digests of coordinates only. Chunks of one array that have changed places are not
noticed: a checksum is one of bytes, not of their place.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polywigner.errors import MissingExtraError, StoreError
from polywigner.geometry.arguments import checked_path
from polywigner.illumination.source_files import SOURCE_COORDINATE
from polywigner.propagation.stores_files import (
    CHECKSUM,
    FINGERPRINT,
    METADATA,
    SETTINGS,
    Index,
    Layout,
    checksum_of,
    digest_of,
    recent_zarr,
    required,
    told_settings,
)
from polywigner.radiometry.progress import progress_bar
from polywigner.transforms.xarray_arguments import LabelledArray

__all__ = [
    "Record",
    "chunk_bytes",
    "chunk_file",
    "damaged",
    "missing",
    "open_array",
    "recorded",
    "stored_layout",
    "sweep",
    "verify_store",
]

# Chunks that a message names.
_NAMED = 8


@dataclass(frozen=True)
class Record:
    """What the metadata of a store say about the run."""

    fingerprint: str
    settings: dict[str, Any]


def recorded(path: Path) -> Record | None:
    """What a store says of its run; None for anything else at the path.

    Raises StoreError for a store whose metadata are damaged.
    """
    try:
        content = (path / METADATA).read_bytes()
    except OSError:
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
            if json.loads((path / name / METADATA).read_bytes()) != copy:
                raise ValueError(f"{name}/{METADATA} is not what it was")
        # older stores have the text of the source among their settings
        return Record(attrs[FINGERPRINT], told_settings(json.loads(attrs[SETTINGS])))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise _broken(path, "metadata", error) from error


def stored_layout(path: Path, settings: dict[str, Any]) -> Layout:
    """The layout that a store was made with, its coordinates read and compared with their digests.

    Raises StoreError for damaged coordinates, and for an array that is not of the settings.
    """
    part = "metadata"
    try:
        name = settings["variable"]
        array = open_array(path, name)
        expected = [settings[key] for key in ("shape", "chunks", "dtype")]
        if [list(array.shape), list(array.chunks), array.dtype.name] != expected:
            raise ValueError(f"{name} is not of the shape, chunks and type of the settings")
        coords = {}
        for axis, n in zip(array.metadata.dimension_names, array.shape, strict=True):
            part = f"coordinate {axis}"
            stored = open_array(path, axis)
            if stored.shape != (n,):  # before that much memory is taken
                raise ValueError(f"it has the shape {stored.shape} for {n} samples")
            values = stored[...]
            if digest_of(values) != settings[part]:
                raise ValueError("its digest is that of other values")
            coords[axis] = LabelledArray(values, (axis,))
        if (path / SOURCE_COORDINATE).exists():  # long sources are not kept
            part = f"coordinate {SOURCE_COORDINATE}"
            _check_source(path, settings["source_sha256"])
        return Layout(name, array.dtype, coords, array.chunks)
    except (StoreError, MissingExtraError):
        raise
    except Exception as error:  # zarr, its codecs and NumPy raise of many kinds
        raise _broken(path, part, error) from error


def _check_source(path: Path, digest: str) -> None:
    """Raises what zarr does, and ValueError for a text of another digest."""
    array = open_array(path, SOURCE_COORDINATE)
    if has_checksums(array):
        # First without zarr, which takes memory for as many texts as the first bytes say: before
        # the text there are the number of texts and its length, behind it the checksum.
        content = chunk_file(path, array, SOURCE_COORDINATE, ()).read_bytes()
        _compare(content[8:-4], digest)
    _compare(str(array[...]).encode(), digest)


def _compare(text: bytes, digest: str) -> None:
    if hashlib.sha256(text).hexdigest() != digest:
        raise ValueError("its digest is that of another text")


def _broken(path: Path, part: str, error: Exception) -> StoreError:
    reason = str(error) or type(error).__name__
    return StoreError(
        f"expected the store {path} as it was written, got damaged {part} ({reason[:200]}); put "
        "its files back from a copy, or delete that store and start again"
    )


def open_array(path: Path, name: str) -> Any:
    """An array of a store. Raises StoreError for damaged metadata."""
    zarr = recent_zarr()
    try:
        array = zarr.open_array(path / name, mode="r+")
        # A chunk of nothing but NaN is finished as well. (zarr.open_array ignores ``config``.)
        return array.with_config({"write_empty_chunks": True})
    except Exception as error:  # of many kinds
        raise _broken(path, f"metadata of {name}", error) from error


def chunk_file(path: Path, array: Any, name: str, index: Index) -> Path:
    """The file of a chunk."""
    return path / name / array.metadata.encode_chunk_key(index)


def has_checksums(array: Any) -> bool:
    """Whether an array's chunks carry checksums; those of older stores do not."""
    codec = required("zarr.codecs").Crc32cCodec
    return any(isinstance(one, codec) for one in array.compressors)


def chunk_bytes(array: Any, layout: Layout) -> int:
    """Size of a chunk's file: its last four bytes are the checksum."""
    return layout.chunk_bytes + (4 if has_checksums(array) else 0)


def _files(folder: Path) -> Iterator[os.DirEntry[str]]:
    """All files below a folder."""
    folders = [str(folder)]
    while folders:
        with os.scandir(folders.pop()) as entries:
            for entry in entries:
                if entry.is_dir():
                    folders.append(entry.path)
                else:
                    yield entry


def sweep(path: Path, layout: Layout) -> None:
    """Remove the chunks that killed runs, or killed workers of this one, have half written."""
    for entry in _files(path / layout.name):
        if entry.name.endswith(".partial"):
            Path(entry.path).unlink(missing_ok=True)


def missing(path: Path, layout: Layout) -> list[Index]:
    """The chunks that are not there, or not in full size; all, where there is no store.

    Some file systems leave files of another size when the power fails.
    """
    if not path.exists():
        return list(layout.indices())
    sizes = {entry.path: entry.stat().st_size for entry in _files(path / layout.name)}
    array = open_array(path, layout.name)
    size = chunk_bytes(array, layout)
    return [
        index
        for index in layout.indices()
        if sizes.get(str(chunk_file(path, array, layout.name, index))) != size
    ]


def damaged(
    path: Path, layout: Layout, absent: Iterable[Index], progress: bool | None
) -> list[Index]:
    """The chunks, but for those known to be absent, whose checksum is not that of their bytes."""
    array, known = open_array(path, layout.name), set(absent)
    there = [index for index in layout.indices() if index not in known]
    if not there or not has_checksums(array):
        return []
    found = []
    with progress_bar(f"{path.name}: checksums", len(there), show=progress) as advance:
        for index in there:
            if not _is_whole(array, index):
                found.append(index)
            advance()
    return found


def _is_whole(array: Any, index: Index) -> bool:
    try:
        array.blocks[index]
    except ValueError:  # by the codec
        return False
    return True


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
    recent_zarr()
    folder = checked_path(path)
    record = recorded(folder)
    if record is None:
        raise StoreError(
            f"expected a store of polywigner at {folder}, got none; name the folder, such as "
            "field.zarr"
        )
    layout = stored_layout(folder, record.settings)
    try:
        absent = missing(folder, layout)
        faults = _faults(folder, layout, absent, damaged(folder, layout, absent, progress))
    except StoreError:
        raise
    except OSError as error:
        raise StoreError(
            f"expected to read {folder}, got {error.strerror or error}; check its permissions"
        ) from error
    if faults:
        raise StoreError(
            f"expected {layout.count} whole chunks in {folder}, got {'; '.join(faults)}; start the "
            "run that wrote it once more: it computes these anew"
        )
    if not has_checksums(open_array(folder, layout.name)):
        raise StoreError(
            f"expected checksums in {folder}, got a store of an older version without; its "
            f"{layout.count} chunks are all there and of the right size, and no more can be told"
        )
    return layout.count


def _faults(path: Path, layout: Layout, absent: list[Index], broken: list[Index]) -> list[str]:
    """What is wrong with chunks, in words."""
    array = open_array(path, layout.name)
    names = {i: array.metadata.encode_chunk_key(i) for i in (*absent, *broken)}
    lost = [i for i in absent if not chunk_file(path, array, layout.name, i).is_file()]
    wrong = sorted({*absent, *broken} - {*lost})
    kinds: list[tuple[str, list[Index]]] = [("missing", lost), ("damaged", wrong)]
    return [_listed(kind, layout.name, [names[i] for i in found]) for kind, found in kinds if found]


def _listed(kind: str, name: str, keys: list[str]) -> str:
    more = f" and {len(keys) - _NAMED} more" if len(keys) > _NAMED else ""
    return f"{len(keys)} {kind}: {', '.join(f'{name}/{key}' for key in keys[:_NAMED])}{more}"
