"""What a reader of a format hands over, and the library it needs."""

from __future__ import annotations

import importlib
import logging
from dataclasses import dataclass
from typing import Any

from polywigner.errors import MissingExtraError
from polywigner.geometry.exact import Ring

__all__ = ["Drawing", "required"]


@dataclass(frozen=True, eq=False)
class Drawing:
    """Polygons of a file, each a list of rings with the exterior first, in the file's own unit."""

    polygons: list[list[Ring]]
    metres: float
    """Length of the file's unit."""


def required(library: str, kind: str) -> Any:
    """Import a library that the extra `formats` brings.

    Raises MissingExtraError where it is not installed.
    """
    try:
        module = importlib.import_module(library)
    except ImportError:
        raise MissingExtraError(
            f"expected {library.partition('.')[0]} to be installed, which reads {kind} files, got "
            "none; install it with: pip install polywigner[formats]"
        ) from None
    # What a library says about a damaged file goes to those who listen, not to the terminal.
    logger = logging.getLogger(library.partition(".")[0])
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())
    return module
