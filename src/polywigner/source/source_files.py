"""Source files: apertures with their fields, and arrays, read and written in TOML or JSON."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, FileFormatError, GeometryError, PolywignerError, at_key
from polywigner.geometry import PlacedAperture, Polyhedron, Slits, Wavefront
from polywigner.geometry.arguments import checked_path, write_lines
from polywigner.geometry.io.limits import bytes_of, text_of
from polywigner.source.array import Array, Element
from polywigner.source.polarisation import checked_polarisation
from polywigner.source.source_schema import VERSION, FileContent, Source, content_of

if TYPE_CHECKING:
    import xarray

_LINE = 88

SOURCE_COORDINATE = "source_json"
"""Name of the coordinate of a dataset that holds its source, as the text of a source file."""


def read_source(
    path: str | os.PathLike[str] | xarray.Dataset, allow_outside: bool = False
) -> Source:
    """Read an aperture with its field, slits, a body, or an array from a TOML or JSON file.

    docs/source_files.md describes the format. A source that :func:`write_source` wrote is read
    back equal. In files written by hand, quantities may be texts with units ("10 mm", "20 deg",
    "77 GHz"), fields, layouts and weights may be named, and outlines may be in other files,
    relative to this one.

    Parameters
    ----------
    path : the file; or a dataset that polywigner computed, which contains its source.
    allow_outside : whether the file may name files outside its own folder, links followed. Keep
        the default for untrusted files.

    Returns
    -------
    Aperture, placed aperture, Slits, Polyhedron, Array or Wavefront.

    Raises
    ------
    FileFormatError
        The file is missing, empty, too large (64 MiB) or not TOML or JSON; names a file outside its
        folder; or has an unknown key or a wrong value. A dataset contains no source, or only the
        digest of a source longer than 64 KiB.
    GeometryError, IlluminationError, ArgumentError, QuantityError
        The values describe no valid source: see the functions and classes that the file names.
    MissingExtraError
        A library that a window or an outline needs is not installed.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "antenna.toml"
    >>> pw.write_source(pw.shapes.square(10e-3), path)
    >>> pw.read_source(path) == pw.shapes.square(10e-3)
    True
    """
    if not hasattr(path, "coords"):
        return read_content(path, allow_outside).source
    if SOURCE_COORDINATE not in path.coords:
        raise FileFormatError(
            f"expected a dataset with its source in the coordinate {SOURCE_COORDINATE}, got one "
            "without; sources longer than 64 KiB are not stored, write them by "
            "polywigner.write_source"
        )
    try:
        text = str(path.coords[SOURCE_COORDINATE].values.item())
    except (ValueError, RuntimeError) as error:  # from the codecs of a store
        raise FileFormatError(
            f"expected a dataset whose source can be read, got a damaged one ({error}); read a copy"
        ) from error
    return content_of(_parsed(text, ".json"), Path(), allow_outside).source


def read_polarisation(
    path: str | os.PathLike[str], allow_outside: bool = False
) -> NDArray[np.complex128] | None:
    """Read the polarisation at the top of a source file.

    A source is a scalar field; functions take its polarisation as a separate argument.

    Parameters
    ----------
    path, allow_outside : as for :func:`read_source`, which reads the source itself.

    Returns
    -------
    The Jones vector (2,) along the source's x and y, complex; one for each element (n, 2) if the
    file has a list of polarisations for an array; None if the file has no polarisation.

    Raises the errors of :func:`read_source`, and ArgumentError for an invalid polarisation.

    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "antenna.toml"
    >>> pw.write_source(pw.shapes.square(10e-3), path, polarisation="right")
    >>> pw.read_polarisation(path).round(3)
    array([0.707+0.j   , 0.   +0.707j])
    """
    return read_content(path, allow_outside).polarisation


def read_content(path: str | os.PathLike[str], allow_outside: bool = False) -> FileContent:
    """The source of a file and the settings at its top."""
    file = checked_path(path)
    with at_key(str(file)):
        tables = _parsed(text_of(bytes_of(file)), file.suffix)
        return content_of(tables, file.absolute().parent, allow_outside)


def _parsed(text: str, suffix: str) -> Any:
    """The tables of a text in TOML or JSON."""
    parsers = {".toml": tomllib.loads, ".json": json.loads}
    if suffix.lower() not in parsers:
        raise FileFormatError(
            f"expected a source file with the suffix .toml or .json, got {suffix or 'none'!r}; "
            "outlines alone are read by polywigner.read_aperture"
        )
    try:
        return parsers[suffix.lower()](text)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"expected valid {suffix[1:].upper()}: {error}") from None


def table_of(source: Source) -> dict[str, Any]:
    """The complete content of a source as tables, lists, texts and numbers."""
    if isinstance(source, Wavefront):
        wave = {"curvature": source.curvature.tolist(), "centre": source.centre.tolist()}
        if source.wavelength is not None:
            wave["wavelength"] = source.wavelength
        if not source.is_coherent:
            wave["coherence_width"] = source.coherence_width
        return {**table_of(source.source), "wavefront": wave}
    if isinstance(source, Array):
        return {"version": VERSION, **_array(source)}
    if isinstance(source, Element):
        return {"version": VERSION, **_element(source)}
    raise ArgumentError(
        "expected an Aperture, a placed aperture, Slits, a Polyhedron, an Array or a Wavefront, "
        f"got {type(source).__name__}"
    )


def _array(array: Array) -> dict[str, Any]:
    weights: dict[str, Any] = {}
    if not (array.weights == 1).all():
        weights["weights"] = _complex(array.weights)
    if array.repeated is not None:
        element, positions = array.repeated
        body = {"kind": "phased-array", "positions": positions.tolist(), **weights}
        return {**body, "element": _element(element)}
    if array.paths is not None:
        cycles, slopes = array.paths.cycles.tolist(), array.paths.slopes.tolist()
        length = array.paths.wavelength
        weights["paths"] = {"wavelength": length, "cycles": cycles, "slopes": slopes}
    elements = [_element(element) for element in array.elements]
    return {"kind": "array", **weights, "elements": elements}


def _element(element: Element) -> dict[str, Any]:
    if isinstance(element, PlacedAperture):
        return {**_element(element.aperture), "to_world": element.pose.tolist()}
    if isinstance(element, Polyhedron):
        faces = [list(face) for face in element.faces]
        return {"kind": "polyhedron", "vertices": element.vertices.tolist(), "faces": faces}
    if isinstance(element, Slits):
        table = {"kind": "slits", "intervals": element.intervals.tolist()}
    else:
        polygons = [[ring.tolist() for ring in part] for part in element._parts]
        table = {"kind": "aperture", "polygons": polygons, "verbatim": True}
    if element.illumination is not None:
        waves = element.illumination
        amplitudes, frequencies = _complex(waves.amplitudes), waves.frequencies.tolist()
        field = {"kind": "waves", "amplitudes": amplitudes, "frequencies": frequencies}
        table["illumination"] = field
    return table


def _complex(values: NDArray[np.complex128]) -> list[Any]:
    """Numbers if all are real, otherwise pairs [real, imaginary]."""
    if not values.imag.any():
        return values.real.tolist()
    return np.stack([values.real, values.imag], axis=-1).tolist()


def json_of(table: Mapping[str, Any]) -> str:
    """A table as JSON in one line."""
    return json.dumps(table)


def toml_of(table: Mapping[str, Any], path: str = "") -> str:
    """A table as TOML: values first, then nested tables under their full names."""
    lines, sections = [], []
    for key, value in table.items():
        name = f"{path}.{key}" if path else key
        if isinstance(value, Mapping):
            sections.append(f"\n[{name}]\n{toml_of(value, name)}")
        elif isinstance(value, list) and isinstance(value[0], Mapping):
            sections += [f"\n[[{name}]]\n{toml_of(item, name)}" for item in value]
        else:
            lines.append(f"{key} = {_list_of(value)}\n")
    return "".join(lines + sections)


def _list_of(value: Any, margin: str = "") -> str:
    """A number, text or list, which is the same in TOML and JSON, in lines of sensible length."""
    text = json.dumps(value)
    if len(text) <= _LINE or not isinstance(value, list):
        return text
    inner = margin + "  "
    items = ",\n".join(inner + _list_of(item, inner) for item in value)
    return f"[\n{items}\n{margin}]"


def write_source(
    source: Source, path: str | os.PathLike[str], *, polarisation: str | ArrayLike | None = None
) -> None:
    """Write a source to a ``.toml`` or ``.json`` file for :func:`read_source`.

    All floats are written exactly. The complete file appears at once and replaces an existing one.

    Parameters
    ----------
    source : Aperture, placed aperture, Slits, Polyhedron, Array or Wavefront, with fields and
        weights.
    path : the suffix selects the format.
    polarisation : as in :func:`polywigner.field`, for :func:`read_polarisation`; None writes none.

    Raises ArgumentError for another object, an invalid polarisation, or a path that cannot be
    written; FileFormatError for another suffix; GeometryError for a source that a file cannot
    represent exactly, such as an outline that a shift by 10^15 times its size has made invalid.

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
        table = {"version": table.pop("version"), "polarisation": pairs, **table}
    text = writers[file.suffix.lower()](table).rstrip("\n")
    try:
        is_same = content_of(_parsed(text, file.suffix), file.parent).source == source
    except PolywignerError as error:
        raise GeometryError(f"a file cannot represent {source!r} exactly: {error}") from None
    if not is_same:
        raise GeometryError(
            f"a file cannot represent {source!r} exactly; build the source anew from its vertices"
        )
    write_lines(file, [text])
