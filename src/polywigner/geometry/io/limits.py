"""Limits of files from elsewhere: size, time, memory, and numbers of parts."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from polywigner.apart import ChildError, run_apart
from polywigner.errors import FileFormatError

Result = TypeVar("Result")

# Files, in bytes: any (a million vertices take about 40 MB as text), TOML, which Python parses in
# Python, 1 MiB in up to a second, and Mitsuba XML, whose meshes stand in files of their own.
LARGEST_FILE = 64 * 2**20
LARGEST_TOML = 8 * 2**20
LARGEST_SCENE = 8 * 2**20

# Commas in JSON: three for each of a million positions, and as much again for properties.
MOST_JSON_VALUES = 6_000_000

# Of one aperture: a valid ring of so many vertices, or so many rectangles, take about 10 s.
MOST_VERTICES = 1_000_000
MOST_RINGS = 10_000

# Coordinates beyond it are refused before anything is computed from them.
LARGEST_NUMBER = 1e100

# Characters in a line of a table: a line is in memory as its columns.
LONGEST_LINE = 2**16

# Triangles of a body; checking so many takes about 10 s.
MOST_FACES = 200_000

# Elements of a Mitsuba scene, with those of scenes that it includes, and elements of XML in each
# other, `use` of SVG included.
MOST_SCENE_ELEMENTS = 200_000
MOST_NESTED = 64

# Of source files: elements that an array lists one by one (a millisecond each; a lattice counts as
# one), vertices and the like of a shape by name (a slip of the keyboard must not fill memory), and
# plane waves of all fields, products of tapers counted before they are multiplied.
MOST_LISTED = 10_000
LARGEST_PART = 4096
MOST_WAVES = 1_000_000


def check_most(count: int, most: int, things: str, remedy: str = "simplify the drawing") -> None:
    """Raise FileFormatError where a file has more things than are read."""
    if count > most:
        raise FileFormatError(f"expected at most {most} {things}, got {count}; {remedy}")


def check_values(text: str) -> None:
    """Raise for JSON of more values than are read."""
    check_most(text.count(","), MOST_JSON_VALUES, "values of JSON", "simplify it")


def check_vertices(count: int) -> None:
    """Raise where a file has more vertices than are read."""
    check_most(count, MOST_VERTICES, "vertices", "simplify the outline")


def check_rings(count: int) -> None:
    """Raise where a file has more outlines than are read."""
    check_most(count, MOST_RINGS, "outlines", "use fewer, such as one element of an array")


def check_bytes(size: int, largest: int, kind: str = "") -> None:
    """Raise for a file of more bytes than are read."""
    if size > largest:
        raise FileFormatError(
            f"expected at most {largest >> 20} MiB{kind and f' of {kind}'}, got "
            f"{size / 2**20:.0f} MiB; simplify what it describes, or save a part of it"
        )


def check_coordinates(points: NDArray[Any]) -> None:
    """Raise for coordinates that are not finite, or too large to compute with."""
    if not (np.abs(points) <= LARGEST_NUMBER).all():  # also for a NaN
        raise FileFormatError(
            f"expected finite coordinates below {LARGEST_NUMBER:g}, got one beyond; "
            "correct that number"
        )


_PLACE = re.compile(r"\bline (\d{1,9})(?:,? col(?:umn)? (\d{1,9}))?")
_NUMBER = re.compile(r"[-+.,;:\s0-9eE]{1,12}", re.ASCII)


def place_of(error: Exception) -> str:
    """ " in line 3, column 7" where the message of an error says so, else nothing."""
    found = _PLACE.search(str(error))
    if found is None:
        return ""
    return f" in line {found[1]}" + (f", column {found[2]}" if found[2] else "")


def token(text: str, known: tuple[str, ...] = ()) -> str:
    """A text as messages quote it: a short number, or a known word; of any other its length."""
    if text in known or _NUMBER.fullmatch(text):
        return repr(text)
    return f"{len(text)} characters of text" if text else "nothing"


def check_regular(path: Path) -> None:
    """Raise FileFormatError for anything but a file: missing, a directory, a device, a pipe."""
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


# Bytes of a file that says a size of zero.
_OF_NO_SIZE = 1 << 20


def bytes_of(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """The content of a regular file, not empty, of at most so many bytes."""
    check_regular(path)
    try:
        # Should a pipe have taken the file's place meanwhile, opening it must not wait.
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with os.fdopen(os.open(path, flags), "rb") as file:
            found = os.fstat(file.fileno())
            _check_mode(found.st_mode)
            check_bytes(found.st_size, largest)
            # files of the system say a size of zero; room is made for as much as is asked for
            content = file.read(min(max(found.st_size, _OF_NO_SIZE), largest) + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"expected a readable file, got: {error}") from None
    check_bytes(len(content), largest)
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


SMALL = 2**14
"""Bytes of plain text that are read where the caller is: in milliseconds."""

# Of the processor; a machine that does other work may take six times as long.
_SECONDS = 20
_MEMORY = 1 << 30


def within_limits(read: Callable[[], Result], modules: Sequence[str], kind: str) -> Result:
    """Return ``read()``, called in a process apart, which a damaged file may end.

    FileFormatError where it takes more time or memory than a file may, or fails.
    """
    try:
        return run_apart(read, _SECONDS, _MEMORY, modules=modules)
    except ChildError as error:
        got = f"takes more {error.failure}; simplify it, or save a part of it"
        if error.failure not in ("time", "memory"):
            got = "its library does not read; it may be damaged, or take more: export it anew"
        raise FileFormatError(
            f"expected {kind} that is read within {_SECONDS} s and {_MEMORY >> 30} GiB, got a file "
            f"that {got}"
        ) from None
