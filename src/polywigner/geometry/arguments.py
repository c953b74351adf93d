"""Checks of numbers, lengths and counts that people pass to functions."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError
from polywigner.geometry.numbers import real_numbers

__all__ = [
    "checked_count",
    "checked_generator",
    "checked_length",
    "checked_number",
    "checked_path",
    "checked_row",
    "checked_wavelength",
    "shape_of",
]


def shape_of(value: Any) -> str:
    """The shape of an array or of nested lists, for messages."""
    try:
        return str(np.shape(value))
    except ValueError:
        return "of lists of different lengths"


# Most vertices, as of a file; a slip of a few zeros would fill the memory.
_MOST = 1_000_000


def checked_number(value: Any, name: str, meaning: str) -> float:
    """A finite number, or ArgumentError: expected `name` as `meaning`."""
    try:
        number = math.nan if isinstance(value, (str, bytes, bool)) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise ArgumentError(f"expected {name} as {meaning}, got {value!r}")
    return number


def checked_row(values: Any, expected: str) -> NDArray[np.float64]:
    """Real numbers (k,), one or more; ArgumentError that begins with ``expected``."""
    try:
        numbers = np.atleast_1d(real_numbers(values))
    except ValueError as error:
        raise ArgumentError(f"{expected}, got {error}") from None
    if numbers.ndim != 1 or not numbers.size:
        raise ArgumentError(f"{expected}, got shape {shape_of(values)}")
    return numbers


def checked_length(value: Any, name: str, zero: bool = False) -> float:
    """A finite number above zero (or zero, if allowed), or ArgumentError."""
    meaning = "a length of at least zero" if zero else "a length above zero"
    number = checked_number(value, name, meaning)
    if number < 0 or (number == 0 and not zero):
        raise ArgumentError(f"expected {name} as {meaning}, got {value!r}")
    return number


def checked_wavelength(value: Any) -> float:
    """A wavelength in metres, and that of which 1/wavelength^2 is finite; ArgumentError if not."""
    if isinstance(value, str):
        raise ArgumentError(
            f"expected a wavelength as a number in metres, got the text {value[:40]!r}; quantities "
            "with units are for files and the command line, here write 3e-3 or 299792458 / 94e9"
        )
    wavelength = checked_length(value, "wavelength")
    if not (0.0 < wavelength * wavelength < math.inf and 1.0 / wavelength**2 < math.inf):
        raise ArgumentError(f"expected a wavelength in metres, got {wavelength!r}; check its unit")
    return wavelength


_RANDOM = (np.random.Generator, np.random.BitGenerator, np.random.SeedSequence, type(None))


def checked_generator(seed: Any) -> np.random.Generator:
    """NumPy's random numbers of a seed; ArgumentError for what is none.

    NumPy itself ends the process for some, such as a ``numpy.matrix``.
    """
    entries = seed if isinstance(seed, (list, tuple)) and seed else [seed]
    whole = all(isinstance(k, (int, np.integer)) and not isinstance(k, bool) for k in entries)
    if not isinstance(seed, _RANDOM) and not (whole and min(entries) >= 0):
        raise ArgumentError(
            f"expected seed as a whole number of at least zero or a Generator, got {seed!r}"
        )
    return np.random.default_rng(seed)


def checked_count(value: Any, name: str, least: int, most: int | None = None) -> int:
    """A whole number within bounds, or ArgumentError."""
    if most is None and isinstance(value, (int, np.integer)) and value > _MOST:
        raise ArgumentError(f"expected {name} as a whole number up to {_MOST}, got {value}")
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or value < least or (most is not None and value > most):
        bounds = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise ArgumentError(f"expected {name} as a whole number {bounds}, got {value!r}")
    return int(value)


def checked_path(path: Any) -> Path:
    """An absolute path; ArgumentError for anything that is none."""
    try:
        text = os.fspath(path)
    except TypeError:
        text = None
    if not isinstance(text, str) or not text or "\0" in text:
        raise ArgumentError(f"expected a path of a file or folder, got {path!r}")
    return Path(os.path.abspath(text))  # noqa: PTH100 (a pathlib path keeps the "..")
