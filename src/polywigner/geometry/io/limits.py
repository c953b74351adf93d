"""Checks used by all file readers: type and size of the file, encoding, and numbers."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.arguments import check_most

# Largest sizes of outline and scene files [bytes]; a million vertices take about 40 MB as text.
LARGEST_FILE = 64 * 2**20
LARGEST_SCENE = 8 * 2**20

# Largest numbers of vertices and outlines of an aperture, which take about 10 s to check.
MOST_VERTICES = 1_000_000
MOST_RINGS = 10_000

# Largest number of triangles of a body, which take about 10 s to check.
MOST_FACES = 200_000

# Largest coordinate; products of larger numbers overflow.
LARGEST_NUMBER = 1e100


def check_bytes(size: int, largest: int, kind: str = "") -> None:
    """Raise FileFormatError for a file of more than `largest` bytes."""
    things = f"MiB{kind and f' of {kind}'}"
    remedy = "simplify the content, or save only a part of it"
    check_most(size / 2**20, largest / 2**20, things, remedy, FileFormatError)


def check_coordinates(points: NDArray[Any]) -> None:
    """Raise FileFormatError for coordinates that are not finite or exceed 1e100."""
    # The condition is negated, so that NaN also raises an error.
    if not (np.abs(points) <= LARGEST_NUMBER).all():
        raise FileFormatError(
            f"expected finite numbers below {LARGEST_NUMBER:g}, got a larger number or "
            "NaN; correct the file"
        )


_NUMBER = re.compile(r"[-+.,;:\s0-9eE]{1,12}", re.ASCII)


def token(text: str, known: tuple[str, ...] = ()) -> str:
    """Return the text that represents a token of a file in error messages.

    Numbers and ``known`` words are quoted; other text is replaced by its length.
    """
    if text in known or _NUMBER.fullmatch(text):
        return repr(text)
    return f"{len(text)} characters of text" if text else "nothing"


def checked_suffix(
    path: Path,
    known: Collection[str],
    remedy: str = "use another format",
    error: type[PolywignerError] = FileFormatError,
) -> str:
    """Return the suffix of a path in lower case; raise an error for unknown suffixes."""
    suffix = path.suffix.lower()
    if suffix not in known:
        got = f"got {suffix or 'none'!r}; {remedy}"
        raise error(f"expected a file with the suffix {', '.join(known)}, {got}")
    return suffix


def check_regular(path: Path) -> None:
    """Raise FileFormatError if a path is missing or is not a regular file."""
    if not path.is_file():
        kind = "a directory or a device" if path.exists() else "a path that does not exist"
        raise FileFormatError(f"expected the path of a file, got {kind}")


def bytes_of(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """Return the content of a regular file of 1 to `largest` bytes.

    Raises FileFormatError for other files, and for files that contain only blanks.
    """
    try:
        check_regular(path)
        check_bytes(path.stat().st_size, largest)
        content = path.read_bytes()
    except OSError as error:
        raise FileFormatError(f"cannot read the file: {error}") from None
    if not content.strip():
        raise FileFormatError("the file is empty; export it again")
    return content


def text_of(content: bytes) -> str:
    """Decode the text of a file in UTF-8; raise FileFormatError for binary data and blank text."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise FileFormatError("expected text in UTF-8, got binary data; save it as text")
    if not text.strip():
        raise FileFormatError("the file is empty; export it again")
    return text
