"""Chunks computed and written, by threads of this process or by workers of a cluster."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner import execution
from polywigner.errors import ArgumentError, StoreError
from polywigner.propagation.stores_checks import chunk_bytes, chunk_file, open_array, recorded
from polywigner.propagation.stores_disk import to_disk
from polywigner.propagation.stores_files import METADATA
from polywigner.propagation.stores_layout import Index, Layout, versions

__all__ = ["Block", "ChunkWriter"]

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
