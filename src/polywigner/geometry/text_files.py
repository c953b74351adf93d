"""Text files that appear whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from polywigner.errors import ArgumentError
from polywigner.interruption import unfinished

__all__ = ["write_lines"]


def write_lines(file: Path, lines: Iterable[str]) -> None:
    """Write lines, without their ends, to a file in UTF-8; one that is there is replaced.

    What ``lines`` raises leaves no file behind. Raises ArgumentError where it cannot be written.
    """
    text = "".join(f"{line}\n" for line in lines)
    scratch = file.with_name(f"{file.name}.{os.getpid()}.partial")
    try:
        with unfinished(scratch):
            scratch.write_text(text, encoding="utf-8", newline="\n")
            scratch.replace(file)
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise ArgumentError(f"expected to write {file}, got: {error}") from None
