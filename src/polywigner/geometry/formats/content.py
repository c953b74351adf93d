"""A file's bytes or text, or one error that says why not."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from polywigner.errors import FileFormatError
from polywigner.geometry.formats.limits import LARGEST_FILE

__all__ = ["bytes_of", "check_regular", "text_of"]


def check_regular(path: Path) -> None:
    """Raise FileFormatError for what is no file: missing, a directory, a device, a pipe."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise FileFormatError("expected a file, got a path that does not exist") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise FileFormatError(f"expected a readable file, got: {error}") from None
    _check_mode(mode)


def _check_mode(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise FileFormatError("expected a file, got a directory")
    if not stat.S_ISREG(mode):
        raise FileFormatError("expected a regular file, got a device or pipe")


def bytes_of(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """The content of a regular file of sensible size.

    Raises FileFormatError for a missing, empty, unreadable or oversized file, a directory, a
    device and a pipe.
    """
    check_regular(path)
    try:
        # Should a pipe have taken the file's place meanwhile, opening it must not wait.
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with os.fdopen(os.open(path, flags), "rb") as file:
            found = os.fstat(file.fileno())
            _check_mode(found.st_mode)
            _check_size(found.st_size, largest)
            content = file.read(largest + 1)  # files of the system say a size of zero
    except (OSError, ValueError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"expected a readable file, got: {error}") from None
    _check_size(len(content), largest)
    if not content.strip():
        raise FileFormatError("expected content, got an empty file")
    return content


def _check_size(size: int, largest: int) -> None:
    if size > largest:
        raise FileFormatError(
            f"expected at most {largest >> 20} MiB, got {size / 2**20:.0f} MiB; "
            "simplify what it describes"
        )


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
