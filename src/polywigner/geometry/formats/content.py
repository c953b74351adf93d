"""A file's bytes or text, or one error that says why not."""

from __future__ import annotations

from pathlib import Path

from polywigner.errors import FileFormatError

__all__ = ["LARGEST_FILE", "bytes_of", "text_of"]

LARGEST_FILE = 64 * 2**20
"""Bytes of any file; an outline of a million vertices takes about 40 MB as text."""


def bytes_of(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """The content of a regular file of sensible size.

    Raises FileFormatError for a missing, empty, unreadable or oversized file, a directory, a
    device and a pipe.
    """
    try:
        if not path.exists():
            raise FileFormatError("expected a file, got a path that does not exist")
        if path.is_dir():
            raise FileFormatError("expected a file, got a directory")
        if not path.is_file():
            raise FileFormatError("expected a regular file, got a device or pipe")
        size = path.stat().st_size
        if size > largest:
            raise FileFormatError(
                f"expected at most {largest >> 20} MiB, got {size / 2**20:.0f} MiB; "
                "simplify what it describes"
            )
        content = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"expected a readable file, got: {error}") from None
    if not content.strip():
        raise FileFormatError("expected content, got an empty file")
    return content


def text_of(content: bytes) -> str:
    """The text, which must be UTF-8."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise FileFormatError("expected text in UTF-8, got binary data; save it as text")
    if not text.strip():
        raise FileFormatError("expected content, got an empty file")
    return text
