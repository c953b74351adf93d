"""Source files: apertures with their fields, and arrays, read and written in TOML or JSON."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, FileFormatError, GeometryError, PolywignerError
from polywigner.geometry import Aperture, PlacedAperture, Slits, Wavefront
from polywigner.geometry.arguments import checked_path, write_lines
from polywigner.geometry.io.limits import (
    LARGEST_TOML,
    SMALL,
    bytes_of,
    check_bytes,
    check_values,
    place_of,
    text_of,
    within_limits,
)
from polywigner.illumination.array import Array, Element
from polywigner.illumination.polarisation import checked_polarisation
from polywigner.illumination.source_tables import (
    FileContent,
    Source,
    aperture_of_polygons,
    content_of,
)
from polywigner.illumination.source_values import VERSION

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

    docs/illumination.md describes the format. Whatever :func:`write_source` wrote comes back equal.
    In files written by hand, lengths, angles and frequencies may be texts ("10 mm", "20 deg", "77
    GHz"; plain numbers are metres, radians and hertz), fields, layouts and weights may be named,
    and outlines may stand in other files, relative to this one.

    Parameters
    ----------
    path : the file; or a dataset that polywigner computed, which holds its source.
    allow_outside : whether the file may name others that are not in its own folder or below, once
        links are followed. Leave it out for files of strangers.

    Returns
    -------
    Aperture, placed aperture, Slits, Polyhedron or Array.

    Raises
    ------
    FileFormatError
        The file is missing, empty, too large (64 MiB), not of its format, describes more than
        docs/files.md allows, names a file elsewhere, or has a key or a value that is not
        understood. A dataset has no source, or one so long (64 KiB) that its digest alone is kept.
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
        return content_of(_parsed(_text_in(path), ".json"), Path(), allow_outside).source
    return read_content(path, allow_outside).source


def read_polarisation(
    path: str | os.PathLike[str], allow_outside: bool = False
) -> NDArray[np.complex128] | None:
    """Read the polarisation at the top of a source file, None where there is none.

    A source is a scalar field; functions take its polarisation beside it.

    Parameters
    ----------
    path, allow_outside : as of :func:`read_source`, which reads the source itself.

    Returns
    -------
    The Jones vector (2,) along the source's x and y, complex; of an array whose elements have one
    each (n, 2).

    Raises as :func:`read_source`; ArgumentError for a polarisation that is none.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "antenna.toml"
    >>> pw.write_source(pw.shapes.square(10e-3), path, polarisation="right")
    >>> pw.read_polarisation(path).round(3)
    array([0.707+0.j   , 0.   +0.707j])
    """
    return read_content(path, allow_outside).polarisation


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


def read_content(path: str | os.PathLike[str], allow_outside: bool = False) -> FileContent:
    """The source of a file, and the numbers that stand at its top, if any."""
    file = checked_path(path)
    read = partial(_read, file.absolute(), allow_outside)
    try:
        if not file.is_file() or file.stat().st_size <= SMALL:
            return read()
        return within_limits(read, (__name__,), "a source file")
    except PolywignerError as error:
        whole = f"{file}: {error}"
        short = whole if len(whole) <= _LONGEST_MESSAGE else whole[:_LONGEST_MESSAGE] + "..."
        # without what a terminal would obey
        raise type(error)(
            "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in short)
        ) from None


def _read(file: Path, allow_outside: bool) -> FileContent:
    return content_of(_parsed(text_of(bytes_of(file)), file.suffix), file.parent, allow_outside)


def _parsed(text: str, suffix: str) -> Any:
    """The tables of a text in TOML or JSON, which the suffix tells."""
    try:
        if suffix.lower() == ".toml":
            check_bytes(len(text), LARGEST_TOML, "TOML")
            if _LONG_KEY.search(text):
                raise FileFormatError("expected keys of a few names, got one of many, with dots")
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


def _refused(name: str) -> NoReturn:
    raise FileFormatError(f"expected finite numbers, got {name}")


def _each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for key, value in pairs:
        if key in table:
            raise FileFormatError(f"expected each key once, got {key!r} twice")
        table[key] = value
    return table


_LINE = 88


def table_of(source: Source) -> dict[str, Any]:
    """All that makes up a source, as tables, lists, texts and numbers."""
    if isinstance(source, Wavefront):
        return {**table_of(source.source), "wavefront": _wave(source)}
    if isinstance(source, Array):
        body = _array(source)
    elif isinstance(source, Element):
        body = _element(source)
    else:
        raise ArgumentError(
            "expected an Aperture, a placed aperture, Slits, a Polyhedron or an Array, got "
            f"{type(source).__name__}"
        )
    return {"version": VERSION, **body}


def _wave(wave: Wavefront) -> dict[str, Any]:
    table: dict[str, Any] = {"curvature": wave.curvature.tolist(), "centre": wave.centre.tolist()}
    if wave.wavelength is not None:
        table["wavelength"] = wave.wavelength
    return table if wave.is_coherent else {**table, "coherence_width": wave.coherence_width}


def _array(array: Array) -> dict[str, Any]:
    if array.repeated is None:
        body = {"kind": "array", **_weights(array)}
        if array.paths is not None:
            cycles, slopes = array.paths.cycles.tolist(), array.paths.slopes.tolist()
            length = array.paths.wavelength
            body["paths"] = {"wavelength": length, "cycles": cycles, "slopes": slopes}
        return {**body, "elements": [_element(element) for element in array.elements]}
    element, positions = array.repeated
    body = {"kind": "phased-array", "positions": positions.tolist(), **_weights(array)}
    return {**body, "element": _element(element)}


def _weights(array: Array) -> dict[str, Any]:
    return {} if (array.weights == 1).all() else {"weights": _complex(array.weights)}


def _complex(values: NDArray[np.complex128]) -> list[Any]:
    """Real numbers where all are real, else pairs."""
    if not values.imag.any():
        return values.real.tolist()
    return np.stack([values.real, values.imag], axis=-1).tolist()


def _element(element: Element) -> dict[str, Any]:
    if isinstance(element, Aperture):
        return {"kind": "aperture", **_outline(element), **_field(element)}
    if isinstance(element, PlacedAperture):
        return {**_element(element.aperture), "to_world": element.pose.tolist()}
    if isinstance(element, Slits):
        return {"kind": "slits", **_intervals(element), **_field(element)}
    faces = [list(face) for face in element.faces]
    return {"kind": "polyhedron", "vertices": element.vertices.tolist(), "faces": faces}


def _field(source: Aperture | Slits) -> dict[str, Any]:
    if source.illumination is None:
        return {}
    waves = source.illumination
    return {
        "illumination": {
            "kind": "waves",
            "amplitudes": _complex(waves.amplitudes),
            "frequencies": waves.frequencies.tolist(),
        }
    }


def _outline(aperture: Aperture) -> dict[str, Any]:
    polygons = _polygons(aperture)
    # the same vertices in the same order: sums over edges are then rounded alike
    return _exact("polygons", polygons, lambda: _polygons(aperture_of_polygons(polygons)))


def _polygons(aperture: Aperture) -> list[list[Any]]:
    return [[ring.tolist() for ring in part] for part in aperture._parts]


def _intervals(slits: Slits) -> dict[str, Any]:
    intervals = slits.intervals.tolist()
    return _exact("intervals", intervals, lambda: Slits(intervals).intervals.tolist())


def _exact(key: str, values: list[Any], again: Callable[[], list[Any]]) -> dict[str, Any]:
    """An outline, verbatim where its constructor would make others of the values."""
    try:
        same = again() == values
    except PolywignerError:
        same = False
    return {key: values} if same else {key: values, "verbatim": True}


def json_of(value: Any, margin: str = "") -> str:
    """A table, list, text, whole number or finite float as JSON, in lines of sensible length."""
    inner = margin + "  "
    if isinstance(value, Mapping):
        items = [f"{inner}{json.dumps(k)}: {json_of(v, inner)}" for k, v in value.items()]
        return "{\n" + ",\n".join(items) + f"\n{margin}}}"
    if isinstance(value, list):
        items = [json_of(item, inner) for item in value]
        line = f"[{', '.join(items)}]"
        if len(line) <= _LINE and "\n" not in line:
            return line
        return "[\n" + ",\n".join(inner + item for item in items) + f"\n{margin}]"
    return json.dumps(value)


def toml_of(table: Mapping[str, Any], name: str = "") -> str:
    """A table as TOML: its values, then its tables, under their full names."""
    lines = []
    sections = []
    for key, value in table.items():
        whole = f"{name}.{key}" if name else key
        if isinstance(value, Mapping):
            sections.append(f"\n[{whole}]\n{toml_of(value, whole)}")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            sections += [f"\n[[{whole}]]\n{toml_of(item, whole)}" for item in value]
        else:
            # Lists of numbers, numbers, true, false and plain texts are the same in TOML and JSON.
            lines.append(f"{key} = {json_of(value)}\n")
    return "".join(lines + sections)


def write_source(
    source: Source, path: str | os.PathLike[str], *, polarisation: str | ArrayLike | None = None
) -> None:
    """Write a source to a ``.toml`` or ``.json`` file, from which :func:`read_source` has it back.

    All floats come back as they are. The file appears whole or not at all; one that is there
    already is replaced.

    Parameters
    ----------
    source : Aperture, placed aperture, Slits, Polyhedron or Array, with fields and weights.
    path : the suffix chooses the format.
    polarisation : as of :func:`polywigner.field`, for :func:`read_polarisation`; None: none is
        written.

    Raises ArgumentError for anything but a source or a polarisation, and a place that cannot be
    written to; FileFormatError for another suffix; GeometryError for an outline that rounding has
    made invalid, as by a shift by more than 10^15 times its size.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "antenna.toml"
    >>> pw.write_source(pw.shapes.square(10e-3), path)
    >>> pw.read_source(path) == pw.shapes.square(10e-3)
    True
    """
    file = checked_path(path)
    writers = {".toml": toml_of, ".json": json_of}
    if file.suffix.lower() not in writers:
        raise FileFormatError(
            f"{file}: expected a source file with the suffix .toml or .json, got "
            f"{file.suffix or 'none'!r}"
        )
    table = table_of(source)
    if polarisation is not None:
        parts = checked_polarisation(polarisation, source).view(np.float64)
        pairs = parts.reshape(*parts.shape[:-1], 2, 2).tolist()
        # before other tables, which TOML would take it into
        table = {"version": table.pop("version"), "polarisation": pairs, **table}
    text = writers[file.suffix.lower()](table).rstrip("\n")
    _check_same(source, text, file)
    write_lines(file, [text])


def _check_same(source: Source, text: str, file: Path) -> None:
    """Refuse to write a source that would be read back as another."""
    try:
        again = content_of(_parsed(text, file.suffix), file.parent).source
    except PolywignerError as error:
        raise GeometryError(f"expected a source that is valid to write, got: {error}") from None
    if again != source:
        raise GeometryError(
            f"expected a source that can be written exactly, got {source!r}, of which another "
            "came back; build it anew from its vertices"
        )
