"""The layout of a chunked array on disk, and the fingerprint that tells one run from another."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from polywigner.errors import ArgumentError
from polywigner.illumination.source_files import SOURCE_COORDINATE, json_of, table_of
from polywigner.transforms.xarray_arguments import LabelledArray

__all__ = [
    "Index",
    "Layout",
    "chunks_within",
    "digest_of",
    "fingerprint_of",
    "source_attrs",
    "source_coords",
    "source_settings",
    "told_settings",
    "versions",
]

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
