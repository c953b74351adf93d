"""Reading source files."""

from __future__ import annotations

import json
import os
import re
import tomllib
from pathlib import Path
from typing import Any, NoReturn, Protocol, runtime_checkable

from polywigner.errors import FileFormatError, PolywignerError
from polywigner.geometry.formats.limits import (
    LARGEST_TOML,
    bytes_of,
    check_values,
    place_of,
    text_of,
)
from polywigner.illumination.files.fields import wavelength_in
from polywigner.illumination.files.tables import Source, source_of

__all__ = ["SOURCE_COORDINATE", "Source", "parsed", "read_source", "read_with_wavelength"]

_LONGEST_MESSAGE = 1000

# Names joined by dots, for each of which tables are looked through from the outermost one.
_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){32}""")


SOURCE_COORDINATE = "source_json"
"""Name of the coordinate of a dataset that holds its source, as the text of a source file."""


@runtime_checkable
class Dataset(Protocol):
    """An ``xarray.Dataset``, or the labelled arrays that stand for it without xarray."""

    @property
    def attrs(self) -> Any: ...

    @property
    def coords(self) -> Any: ...


def read_source(path: str | os.PathLike[str] | Dataset, allow_outside: bool = False) -> Source:
    """Read an aperture with its field, slits, a body, or an array from a TOML or JSON file.

    The format is described in docs/illumination.md. Whatever :func:`write_source` wrote comes back
    equal to what it was. In files written by hand, lengths, angles and frequencies may be texts
    ("10 mm", "20 deg", "77 GHz"; plain numbers are metres, radians and hertz), fields, layouts and
    weights may be named, and outlines may be taken from other files, relative to this one.

    Parameters
    ----------
    path
        The file; or a dataset that polywigner computed, which holds its source.
    allow_outside
        Whether the file may name others that are not in its own folder or below, once links are
        followed. Leave it out for files of strangers, which might name any file of yours.

    Returns
    -------
    Aperture, placed aperture, Slits, Polyhedron or Array.

    Raises
    ------
    FileFormatError
        The file is missing, empty, too large (64 MiB; of TOML 8 MiB), not of its format, describes
        more than docs/files.md allows, names a file elsewhere, or has a key or a value that is not
        understood; the message says where, and what is. A dataset has no source, or
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
        return source_of(parsed(_text_in(path), ".json"), Path(), allow_outside)
    return read_with_wavelength(path, allow_outside)[0]


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


def read_with_wavelength(
    path: str | os.PathLike[str], allow_outside: bool = False
) -> tuple[Source, float | None]:
    """The source of a file, and the wavelength in metres that stands at its top, if any.

    Raises as :func:`read_source` does.
    """
    file = Path(path)
    try:
        table = parsed(text_of(bytes_of(file)), file.suffix)
        return source_of(table, file.parent, allow_outside), wavelength_in(table)
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
            _check_toml(text)
            return tomllib.loads(text)
        if suffix.lower() == ".json":
            check_values(text)
            return json.loads(text, parse_constant=_refused, object_pairs_hook=_each_key_once)
    except RecursionError:
        raise FileFormatError("expected tables and lists, got some nested too deeply") from None
    except FileFormatError:
        raise
    except ValueError as error:
        raise FileFormatError(
            f"expected {suffix[1:].upper()}, got text that does not parse{place_of(error)}"
        ) from None
    raise FileFormatError(
        f"expected a source file with the suffix .toml or .json, got {suffix or 'none'!r}; "
        "outlines alone are read by polywigner.read_aperture"
    )


def _check_toml(text: str) -> None:
    """Raise for TOML on which Python's parser, written in Python, spends long."""
    if len(text) > LARGEST_TOML:
        raise FileFormatError(
            f"expected at most {LARGEST_TOML >> 20} MiB of TOML, got {len(text) / 2**20:.0f} MiB; "
            "use JSON"
        )
    if _LONG_KEY.search(text):
        raise FileFormatError("expected keys of a few names, got one of many, joined by dots")


def _refused(name: str) -> NoReturn:
    raise FileFormatError(f"expected finite numbers, got {name}")


def _each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for key, value in pairs:
        if key in table:
            raise FileFormatError(f"expected each key once, got {key!r} twice")
        table[key] = value
    return table
