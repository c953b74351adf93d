"""Writing source files: exactly, and whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polywigner.errors import ArgumentError, FileFormatError, GeometryError, PolywignerError
from polywigner.geometry import Aperture, PlacedAperture, Slits, Wavefront
from polywigner.geometry.arguments import write_lines
from polywigner.illumination.array import Array, Element
from polywigner.illumination.files.reading import parsed
from polywigner.illumination.files.tables import (
    VERSION,
    Source,
    aperture_of_polygons,
    source_of,
    table_of_wavefront,
)

__all__ = ["json_of", "table_of", "toml_of", "write_source"]

_LINE = 88


def table_of(source: Source) -> dict[str, Any]:
    """All that makes up a source, as tables, lists, texts and numbers.

    Raises ArgumentError for anything but a source.
    """
    if isinstance(source, Wavefront):
        return {**table_of(source.source), "wavefront": table_of_wavefront(source)}
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


def _array(array: Array) -> dict[str, Any]:
    if array.repeated is None:
        body = {"kind": "array", **_weights(array)}
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
    exact = {"polygons": _polygons(aperture)}
    try:
        # the same vertices in the same order: sums over edges are then rounded alike
        same = _polygons(aperture_of_polygons(exact["polygons"])) == exact["polygons"]
    except PolywignerError:
        same = False
    return exact if same else {**exact, "verbatim": True}


def _polygons(aperture: Aperture) -> list[list[Any]]:
    return [[ring.tolist() for ring in part] for part in aperture._parts]


def _intervals(slits: Slits) -> dict[str, Any]:
    exact = {"intervals": slits.intervals.tolist()}
    try:
        same = Slits(slits.intervals) == slits.with_illumination(None)
    except PolywignerError:
        same = False
    return exact if same else {**exact, "verbatim": True}


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
