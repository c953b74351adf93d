"""The exceptions of polywigner: every error a user can cause derives from :class:`PolywignerError`.

Messages contain the expected value, the actual value, and advice. The command line prints them in
one line on stderr, with exit code 2.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

__all__ = [
    "ArgumentError",
    "EngineError",
    "FileFormatError",
    "GeometryError",
    "IlluminationError",
    "MissingExtraError",
    "PolywignerError",
    "PolywignerWarning",
    "QuantityError",
    "SceneError",
    "StoreError",
    "install_command",
]


# Largest length of a value in an error message [characters].
_LONGEST = 80


def value_text(value: object) -> str:
    """Return a value as one line of at most 80 characters, for an error message."""
    text = " ".join(repr(value).split())
    shape = getattr(value, "shape", ())
    if shape and len(text) > _LONGEST:
        return f"{type(value).__name__} of shape {shape}"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def install_command(extra: str = "") -> str:
    """Return the command that installs polywigner with one of its extras, for error messages."""
    return f'`pip install "polywigner{f"[{extra}]" if extra else ""}"`'


class PolywignerError(Exception):
    """Base class of the package's exceptions."""


@contextmanager
def at_key(key: str) -> Iterator[None]:
    """Prefix the messages of PolywignerErrors raised in the block with a key, name or path."""
    try:
        yield
    except PolywignerError as error:
        raise type(error)(f"{key}: {error}") from None


class ArgumentError(PolywignerError, ValueError):
    """A function was called with an argument of the wrong shape, type or range."""


class GeometryError(PolywignerError, ValueError):
    """A set of vertices does not describe a polygon."""


class IlluminationError(PolywignerError, ValueError):
    """An illumination (amplitudes, frequencies, weights) is invalid."""


class QuantityError(PolywignerError, ValueError):
    """A string such as ``"94 GHz"`` is not a quantity of the expected kind."""


class FileFormatError(PolywignerError, ValueError):
    """A file is missing, empty, or does not match its format."""


class SceneError(PolywignerError, ValueError):
    """A Mitsuba scene cannot be rendered with the Wigner emitter."""


class StoreError(PolywignerError, OSError):
    """Results cannot be written, or the existing store belongs to another computation."""


class EngineError(PolywignerError, RuntimeError):
    """No compute engine is available, or the requested engine cannot do the computation."""


class MissingExtraError(PolywignerError, ImportError):
    """A library of an optional extra of polywigner is not installed."""


def missing_extra(library: str, extra: str, purpose: str = "", got: str = "none") -> Exception:
    """Return the error for a library that is not installed.

    ``extra``: the extra of polywigner that contains the library. ``purpose``: for example "reads
    SVG files". ``got``: what is installed instead.
    """
    clause = f", which {purpose}" if purpose else ""
    return MissingExtraError(
        f"expected {library} to be installed{clause}, got {got}; run {install_command(extra)}"
    )


def require(name: str, extra: str, purpose: str = "") -> Any:
    """Import a module that belongs to an optional extra of polywigner.

    Raises :class:`MissingExtraError` if its library is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        library = name.partition(".")[0]
        raise missing_extra(library, extra, purpose, f"none ({error})") from error


class PolywignerWarning(UserWarning):
    """A result is less accurate than requested, or less accurate than usual for its method.

    This warning also reports arguments whose unit is probably wrong, and damaged chunks of a store.
    """
