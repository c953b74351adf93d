"""Reading source files."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path
from typing import Any, NoReturn, Protocol, runtime_checkable

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.formats.content import bytes_of, text_of
from polywigner.illumination.files.fields import wavelength_in
from polywigner.illumination.files.tables import Source, source_of

__all__ = ["SOURCE_COORDINATE", "Source", "parsed", "read_source", "read_with_wavelength"]

_LONGEST_MESSAGE = 1000


SOURCE_COORDINATE = "source_json"
"""Name of the coordinate of a dataset that holds its source, as the text of a source file."""


@runtime_checkable
class Dataset(Protocol):
    """An ``xarray.Dataset``, or the labelled arrays that stand for it without xarray."""

    @property
    def attrs(self) -> Any: ...

    @property
    def coords(self) -> Any: ...


def read_source(path: str | os.PathLike[str] | Dataset) -> Source:
    """Read an aperture with its field, slits, a body, or an array from a TOML or JSON file.

    The format is described in docs/illumination.md. Whatever :func:`write_source` wrote comes back
    equal to what it was. In files written by hand, lengths, angles and frequencies may be texts
    ("10 mm", "20 deg", "77 GHz"; plain numbers are metres, radians and hertz), fields, layouts and
    weights may be named, and outlines may be taken from other files, relative to this one.

    Returns
    -------
    Aperture, placed aperture, Slits, Polyhedron or Array.

    Raises
    ------
    FileFormatError
        The file is missing, empty, too large (64 MiB), not of its format, or has a key or a value
        that is not understood; the message says where, and what is. A dataset has no source, or
        one so long (64 KiB) that its digest alone is kept.
    GeometryError, IlluminationError, ArgumentError, QuantityError
        What it describes is no source: see the functions and classes it names.
    MissingExtraError
        A library is not installed that a window or an outline needs.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "antenna.toml"
    >>> pw.write_source(pw.shapes.square(10e-3), path)
    >>> pw.read_source(path) == pw.shapes.square(10e-3)
    True
    """
    if isinstance(path, Dataset):
        return source_of(parsed(_text_in(path), ".json"), Path())
    return read_with_wavelength(path)[0]


def _text_in(found: Any) -> str:
    """The text of the source of a dataset."""
    try:
        if SOURCE_COORDINATE in found.coords:
            return str(found.coords[SOURCE_COORDINATE].values.item())
        # datasets and stores written before there was such a coordinate
        settings = json.loads(found.attrs.get("polywigner_settings", "{}"))
    except (ValueError, RuntimeError, MemoryError) as error:  # by a store's codecs
        raise FileFormatError(
            f"expected a dataset whose source can be read, got a damaged one ({error}); read a copy"
        ) from error
    for text in (found.attrs.get("source", ""), settings.get("source", "")):
        if text.startswith("{"):
            return str(text)
    raise FileFormatError(
        f"expected a dataset with its source in the coordinate {SOURCE_COORDINATE}, got one "
        "without; sources longer than 64 KiB are not kept, write them by polywigner.write_source"
    )


def read_with_wavelength(path: str | os.PathLike[str]) -> tuple[Source, float | None]:
    """The source of a file, and the wavelength in metres that stands at its top, if any.

    Raises as :func:`read_source` does.
    """
    file = Path(path)
    try:
        table = parsed(text_of(bytes_of(file)), file.suffix)
        return source_of(table, file.parent), wavelength_in(table)
    except PolywignerError as error:
        whole = f"{file}: {error}"
        short = whole if len(whole) <= _LONGEST_MESSAGE else whole[:_LONGEST_MESSAGE] + "..."
        # without what a terminal would obey
        raise type(error)(
            "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in short)
        ) from None


def parsed(text: str, suffix: str) -> Any:
    """The tables of a text in TOML or JSON, which the suffix tells."""
    try:
        if suffix.lower() == ".toml":
            return tomllib.loads(text)
        if suffix.lower() == ".json":
            return json.loads(text, parse_constant=_refused, object_pairs_hook=_each_key_once)
    except RecursionError:
        raise FileFormatError("expected tables and lists, got some nested too deeply") from None
    except FileFormatError:
        raise
    except ValueError as error:
        kind = suffix[1:].upper()
        raise FileFormatError(f"expected {kind}, got text that does not parse: {error}") from None
    raise FileFormatError(
        f"expected a source file with the suffix .toml or .json, got {suffix or 'none'!r}; "
        "outlines alone are read by polywigner.read_aperture"
    )


def _refused(name: str) -> NoReturn:
    raise FileFormatError(f"expected finite numbers, got {name}")


def _each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for key, value in pairs:
        if key in table:
            raise FileFormatError(f"expected each key once, got {key!r} twice")
        table[key] = value
    return table
