"""The schema of source files: the tables that a file may contain, and the sources they describe.

Each msgspec.Struct is one table, and its fields are the keys; docs/source_files.md lists them all.
msgspec checks keys and types. Errors begin with the path of the key in the file, such as
``weights[1].sll``.
"""

from __future__ import annotations

import difflib
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args

import msgspec
import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner import geometry
from polywigner.errors import FileFormatError, GeometryError, at_key, value_text
from polywigner.geometry import Aperture, PlacedAperture, Polyhedron, Slits, Wavefront
from polywigner.geometry.parts import merge_parts, part_of_rings
from polywigner.geometry.rings import oriented, polygon_of_part
from polywigner.source.array import Array, Element, PathLengths, phased_array
from polywigner.source.lattices import checked_positions
from polywigner.source.polarisation import checked_polarisation
from polywigner.source.source_functions import (
    PARSERS,
    Complex,
    FieldTable,
    Frequency,
    Kind,
    LayoutTable,
    Length,
    Metres,
    NonEmpty,
    Ring,
    ShapeTable,
    Table,
    WeightTable,
    called,
    complex_numbers,
    metres,
    product_of,
    radius_of,
    wavelength_in,
)

VERSION = 1
"""Version of the format; files of another version are refused."""

Source = Element | Array | Wavefront


# Outlines and bodies.


@dataclass(frozen=True)
class Context:
    """Settings of a file that its tables depend on."""

    folder: Path
    allow_outside: bool
    """Whether the file may name files outside its folder."""
    wavelength: float | None
    """Wavelength at the top of the file, in m."""

    def path(self, name: str) -> Path:
        """Return the path of another file, which has to be in the folder unless allowed."""
        folder = self.folder.resolve()
        path = (folder / name).resolve()
        if not self.allow_outside and not path.is_relative_to(folder):
            raise FileFormatError(
                "expected a file in the folder of the source file or below, got "
                f"{value_text(name)}; move it there, or trust the file with allow_outside=True "
                "(--allow-outside)"
            )
        return path


def _origin(table: Any, **origins: tuple[str, ...]) -> str:
    """The one of several keys that a table has; each is given with the keys that require it."""
    given = [key for key in origins if getattr(table, key) is not None]
    if len(given) != 1:
        got = " and ".join(given) or "none"
        raise FileFormatError(f"expected one of the keys {', '.join(origins)}, got {got}")
    for origin, keys in origins.items():
        for key in keys:
            if origin != given[0] and getattr(table, key) is not None:
                raise FileFormatError(f"expected {key!r} with {origin!r} only, got {given[0]!r}")
    return given[0]


class _Illuminated(Kind):
    shape: ShapeTable | None = None
    illumination: FieldTable | NonEmpty[FieldTable] | None = None

    def illuminated(self, outline: Any, kind: type, context: Context) -> Any:
        """Return an outline, which has to be of a type, with the field of this table."""
        got = type(outline).__name__
        if got != kind.__name__:
            raise FileFormatError(f"shape: expected a shape of type {kind.__name__}, got {got}")
        if self.illumination is None:
            return outline
        dimension = 1 if kind is Slits else 2
        waves = product_of(
            "illumination", self.illumination, context.wavelength, dimension=dimension
        )
        with at_key("illumination"):
            return outline.with_illumination(waves)


class ApertureTable(_Illuminated, tag="aperture"):
    file: str | None = None
    unit: str | None = None
    layer: str | list[str] | None = None
    union: bool | None = None
    polygons: NonEmpty[NonEmpty[Ring]] | None = None
    verbatim: bool | None = None
    to_world: list[list[Metres]] | None = None

    def source(self, context: Context) -> Aperture | PlacedAperture:
        origin = _origin(self, file=("unit", "layer", "union"), polygons=("verbatim",), shape=())
        with at_key(origin):
            if self.file is not None:
                options: dict[str, Any] = {"layer": self.layer, "union": bool(self.union)}
                outline: Any = geometry.read_aperture(
                    context.path(self.file), self.unit or "mm", **options
                )
            elif self.polygons is not None:
                outline = _aperture(metres(self.polygons), self.verbatim)
            else:
                outline = called(self.shape)
        aperture: Aperture = self.illuminated(outline, Aperture, context)
        if self.to_world is None:
            return aperture
        with at_key("to_world"):
            matrix = metres(self.to_world)
            pose = geometry.rigid_pose(matrix)
            # A pose that was written is read back equal: the nearest rotation may be rounded.
            is_nearest = float(np.abs(np.array(matrix) - pose).max()) <= 1e-15
            return PlacedAperture(aperture, np.array(matrix) if is_nearest else pose)


class SlitsTable(_Illuminated, tag="slits"):
    intervals: list[tuple[Metres, Metres]] | None = None

    def source(self, context: Context) -> Slits:
        with at_key(_origin(self, intervals=(), shape=())):
            is_shape = self.intervals is None
            outline = called(self.shape) if is_shape else Slits(metres(self.intervals))
        slits: Slits = self.illuminated(outline, Slits, context)
        return slits


class PolyhedronTable(Kind, tag="polyhedron"):
    file: str | None = None
    unit: str | None = None
    vertices: list[list[Metres]] | None = None
    faces: list[list[int]] | None = None

    def source(self, context: Context) -> Polyhedron:
        with at_key(_origin(self, file=("unit",), vertices=("faces",))):
            if self.file is None:
                return Polyhedron(metres(self.vertices), self.faces or [])
            return geometry.read_polyhedron(context.path(self.file), self.unit or "mm")


ElementTable = ApertureTable | SlitsTable | PolyhedronTable


def _aperture(polygons: list[list[Any]], verbatim: bool | None) -> Aperture:
    """The aperture of polygons, each a list of rings with the exterior first.

    If not verbatim, vertices on a line are dropped, and polygons that touch are joined and sorted.
    Shifts of an aperture can put vertices on a line.
    """
    if not verbatim:
        parts = [part_of_rings(rings, f"polygon {k}") for k, rings in enumerate(polygons)]
        return Aperture._of_parts(merge_parts(parts))
    parts = [
        tuple(oriented(np.array(ring, np.float64), n == 0) for n, ring in enumerate(rings))
        for rings in polygons
    ]
    reason = shapely.is_valid_reason(shapely.MultiPolygon([polygon_of_part(p) for p in parts]))
    if reason != "Valid Geometry":
        raise GeometryError(
            f"expected valid polygons with verbatim = true, got {reason}; leave verbatim out"
        )
    return Aperture._of_parts(parts)


# Arrays.


class Paths(Table):
    wavelength: Length
    cycles: list[float]
    slopes: list[tuple[float, float]]


class ArrayTable(Kind, tag="array"):
    elements: list[ElementTable]
    weights: list[Complex] | None = None
    paths: Paths | None = None

    def source(self, context: Context) -> Array:
        elements: list[Any] = []
        for k, table in enumerate(self.elements):
            with at_key(f"elements[{k}]"):
                elements.append(table.source(context))
        array = Array(elements, None if self.weights is None else complex_numbers(self.weights))
        if self.paths is None:
            return array
        with at_key("paths"):
            cycles, slopes = np.array(self.paths.cycles), np.array(self.paths.slopes)
            return array.with_paths(PathLengths(cycles, slopes, float(self.paths.wavelength)))


class PhasedArrayTable(Kind, tag="phased-array"):
    element: ApertureTable | SlitsTable
    positions: LayoutTable | list[Metres | list[Metres]]
    weights: WeightTable | NonEmpty[WeightTable | Complex] | None = None

    def source(self, context: Context) -> Array:
        with at_key("element"):
            element = self.element.source(context)
            if isinstance(element, PlacedAperture):
                raise FileFormatError("expected an aperture without a pose, or slits, to repeat")
        dimension = 1 if isinstance(element, Slits) else 2
        layout, weights, shape = self.positions, self.weights, None
        with at_key("positions"):
            is_list = isinstance(layout, list)
            positions = metres(layout) if is_list else called(layout)
            positions = checked_positions(positions, (dimension,))
        if not is_list:
            sizes = (getattr(layout, key, None) for key in ("count", "nx", "ny"))
            shape = tuple(size for size in sizes if size is not None) or None
        if isinstance(weights, list) and not all(isinstance(w, Kind) for w in weights):
            with at_key("weights"):
                weights = complex_numbers(weights)
        elif weights is not None:
            of_array = {"dimension": dimension, "positions": positions, "shape": shape}
            weights = product_of("weights", weights, context.wavelength, **of_array)
        return phased_array(element, positions, weights)


SourceTable = ApertureTable | SlitsTable | PolyhedronTable | ArrayTable | PhasedArrayTable


# The top of a file.


class WavefrontTable(Table):
    radius: Metres | list[Metres] | None = None
    wavelength: Length | None = None
    curvature: float | list[float | list[float]] | None = None
    centre: Metres | list[Metres] | None = None
    coherence_width: Length | None = None

    def on(self, source: Any, wavelength: float | None) -> Wavefront:
        """Return a source with this wave; the file has the wavelength in m, if any."""
        if not isinstance(source, Aperture | Slits | Array):
            raise FileFormatError("expected an aperture without a pose, slits or an array")
        if self.radius is not None and self.curvature is not None:
            raise FileFormatError("expected the key radius or curvature, got both")
        centre = None if self.centre is None else metres(self.centre)
        width = math.inf if self.coherence_width is None else float(self.coherence_width)
        length = None if self.wavelength is None else float(self.wavelength)
        given: Any = self.radius
        if given is None:
            length = None if self.curvature is None else length
            return Wavefront(source, self.curvature, centre, width, length)
        length = length or wavelength
        if length is None:
            raise FileFormatError("expected a frequency or wavelength in the file, got none")
        with at_key("radius"):
            radius = [radius_of(r) for r in given] if isinstance(given, list) else radius_of(given)
            return Wavefront(source, None, centre, width).curved(radius, length, centre)


class Top(Table):
    """Keys at the top of a file in addition to the keys of the source."""

    version: Annotated[int, msgspec.Meta(ge=VERSION, le=VERSION)] = VERSION
    frequency: Frequency | None = None
    wavelength: Length | None = None
    polarisation: str | NonEmpty[str | float | NonEmpty[float | list[float]]] | None = None
    wavefront: WavefrontTable | None = None


class FileContent(NamedTuple):
    """The source of a file and the settings at its top."""

    source: Source
    wavelength: float | None
    """Wavelength in m; None if the file has none."""
    polarisation: NDArray[np.complex128] | None
    """Jones vector (2,), or one for each element (n, 2); None if the file has none."""


def content_of(table: Any, folder: Path, allow_outside: bool = False) -> FileContent:
    """The source that the tables of a file describe, and the settings at its top."""
    at_top: dict[str, Any] = {}
    if isinstance(table, dict):
        at_top = {key: table[key] for key in Top.__struct_fields__ if key in table}
        table = {key: value for key, value in table.items() if key not in at_top}
    body, top = converted(table, SourceTable), converted(at_top, Top)
    wavelength = wavelength_in(top.frequency, top.wavelength)
    source = flat = body.source(Context(folder, allow_outside, wavelength))
    if top.wavefront is not None:
        with at_key("wavefront"):
            source = top.wavefront.on(flat, wavelength)
    jones: Any = top.polarisation
    if jones is not None:
        with at_key("polarisation"):
            if not isinstance(jones, str) and not isinstance(jones[0], str):
                is_deep = isinstance(jones[0], list) and isinstance(jones[0][0], list)
                jones = complex_numbers(jones, 2 if is_deep else 1)
            jones = checked_polarisation(jones, flat)
    return FileContent(source, wavelength, jones)


# Errors of msgspec as errors of the package.

_UNIONS: dict[str, Any] = {
    "": SourceTable,
    "elements": ElementTable,
    "element": ApertureTable | SlitsTable,
    "illumination": FieldTable,
    "positions": LayoutTable,
    "weights": WeightTable,
    "shape": ShapeTable,
}
_WITHOUT_KIND: dict[str, Any] = {"paths": Paths, "wavefront": WavefrontTable}

_WORDS = {
    "object": "table", "array": "list", "str": "text", "int": "whole number", "float": "number",
    "bool": "true or false",
}  # fmt: skip


def converted(table: Any, kind: Any, strict: bool = True) -> Any:
    """A table as an object of the schema; FileFormatError with the path of a wrong key or value.

    Numbers may be texts if not strict.
    """
    try:
        hook: Any = lambda kind, value: kind(PARSERS[kind](value))  # noqa: E731
        return msgspec.convert(table, kind, strict=strict, dec_hook=hook)
    except msgspec.ValidationError as error:
        raise FileFormatError(_explained(str(error), table)) from None


def _explained(message: str, value: Any) -> str:
    """The message of a msgspec error with the path, the accepted values and the wrong one."""
    text, _, path = message.partition(" - at `$")
    path = path.strip(".`")
    steps = re.findall(r"([^.\[\]]+)|\[(\d+)\]", path)
    is_tag = text.startswith("Invalid value")
    key = ""  # of the innermost table
    for name, index in steps[:-1] if is_tag else steps:
        value, key = (value[int(index)], key) if index else (value[name], name)
    tag = "name" if key == "shape" else "kind"
    tables = {table.__struct_config__.tag: table for table in get_args(_UNIONS.get(key))}
    wrong_key = text.rstrip("`").rpartition("`")[2]
    if is_tag:
        text = _expected("one of", list(tables), value[tag])
    elif text.startswith("Object missing"):
        choice = f", one of {', '.join(tables)}" if wrong_key == tag else ""
        text = f"expected the key {wrong_key!r}{choice}, got none"
    elif text.startswith("Object contains unknown"):
        table = _WITHOUT_KIND.get(key) or tables[value[tag]]
        keys = [*([tag] if tables else []), *table.__struct_fields__]
        text = _expected("the keys", keys, wrong_key)
    elif text.startswith("Expected"):
        text = re.sub(r", got .*| \| null|`", "", text).replace(" | ", " or ")
        text = re.sub(r"\w+", lambda word: _WORDS.get(word[0], word[0]), text)
        text = f"{text.lower()}, got {value_text(value)}"
    return f"{path}: {text}" if path else text


def _expected(what: str, names: list[str], got: Any) -> str:
    """A message that lists known names and suggests the one nearest to the wrong one."""
    near = difflib.get_close_matches(str(got), names, 1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"expected {what} {', '.join(names)}, got {value_text(got)}{hint}"
