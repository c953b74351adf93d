"""What lies in a store on disk, for the tests of stores and tables."""

from __future__ import annotations

import hashlib
from pathlib import Path


def chunk_files(store: Path) -> dict[str, Path]:
    """The files of all chunks, those of the coordinates as well."""
    return {
        str(file.relative_to(store)): file
        for file in sorted(store.rglob("*"))
        if file.is_file() and "c" in file.relative_to(store).parts
    }


def hashes(store: Path) -> dict[str, str]:
    """Of every chunk's file."""
    files = chunk_files(store)
    return {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in files.items()}
