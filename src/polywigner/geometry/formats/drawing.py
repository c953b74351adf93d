"""The result of a reader of a format, and the library it needs."""

from __future__ import annotations

import importlib
import logging
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from polywigner.errors import ArgumentError, MissingExtraError, install_command
from polywigner.geometry.exact import Ring

__all__ = [
    "Drawing",
    "checked_tolerance",
    "required",
]


@dataclass(frozen=True, eq=False)
class Drawing:
    """Polygons of a file, each a list of rings with the exterior first, in the file's own unit."""

    polygons: list[list[Ring]]
    metres: float
    """Length of the file's unit."""
    remedy: str | None = None
    """What to do in a drawing about outlines that overlap."""


def required(library: str, kind: str) -> Any:
    """Import a library that the extra `formats` brings.

    Raises MissingExtraError where it is not installed.
    """
    try:
        module = importlib.import_module(library)
    except ImportError:
        raise MissingExtraError(
            f"expected {library.partition('.')[0]} to be installed, which reads {kind} files, got "
            f"none; run {install_command('formats')}"
        ) from None
    # Messages of a library about a damaged file go to a user's handlers, not to the terminal.
    logger = logging.getLogger(library.partition(".")[0])
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())
    return module


def checked_tolerance(tolerance: Any) -> float | None:
    """A length in metres above zero, or None; ArgumentError for any other."""
    if tolerance is None:
        return None
    number = isinstance(tolerance, (int, float, np.number)) and not isinstance(tolerance, bool)
    if not number or not 0 < tolerance < math.inf:
        raise ArgumentError(
            f"expected a tolerance in metres above zero, got {tolerance!r}; give one such as 1e-5"
        )
    return float(tolerance)
