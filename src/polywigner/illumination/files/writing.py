"""Writing source files: exactly, and whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from polywigner.errors import FileFormatError, GeometryError, PolywignerError
from polywigner.geometry.text_files import write_lines
from polywigner.illumination.files.encoding import json_of, table_of, toml_of
from polywigner.illumination.files.reading import parsed
from polywigner.illumination.files.tables import Source, source_of

__all__ = ["write_source"]


def write_source(source: Source, path: str | os.PathLike[str]) -> None:
    """Write a source to a ``.toml`` or ``.json`` file, from which :func:`read_source` has it back.

    All floats come back as they are, so that the source that is read equals the one written. The
    file appears whole or not at all; one that is there already is replaced.

    Parameters
    ----------
    source
        Aperture, placed aperture, Slits, Polyhedron or Array, with fields and weights.
    path
        The suffix chooses the format.

    Raises
    ------
    ArgumentError
        Anything but a source, and a place that cannot be written to.
    FileFormatError
        Another suffix.
    GeometryError
        A source whose outline rounding has made invalid, as by a shift by more than 10^15 times
        its size.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "antenna.toml"
    >>> pw.write_source(pw.shapes.square(10e-3), path)
    >>> pw.read_source(path) == pw.shapes.square(10e-3)
    True
    """
    file = Path(path)
    writers = {".toml": toml_of, ".json": json_of}
    if file.suffix.lower() not in writers:
        raise FileFormatError(
            f"{file}: expected a source file with the suffix .toml or .json, got "
            f"{file.suffix or 'none'!r}"
        )
    text = writers[file.suffix.lower()](table_of(source)).rstrip("\n")
    _check_same(source, text, file)
    write_lines(file, [text])


def _check_same(source: Source, text: str, file: Path) -> None:
    """Refuse to write what would not come back."""
    try:
        again = source_of(parsed(text, file.suffix), file.parent)
    except PolywignerError as error:
        raise GeometryError(f"expected a source that is valid to write, got: {error}") from None
    if again != source:
        raise GeometryError(
            f"expected a source that can be written exactly, got {source!r}, of which another "
            "came back; build it anew from its vertices"
        )
