"""Source files: apertures with their fields, and arrays, read and written in TOML or JSON.

Each msgspec.Struct is one table, whose fields are the keys; docs/source_files.md lists all tables.
"""

from __future__ import annotations

import json
import math
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar

import msgspec
import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from polywigner import geometry
from polywigner.errors import ArgumentError, FileFormatError, at_key, value_text
from polywigner.geometry import Aperture, PlacedAperture, Slits, Wavefront
from polywigner.geometry.arguments import checked_path, only_given, rigid_pose, write_lines
from polywigner.geometry.io.limits import bytes_of, checked_suffix, text_of
from polywigner.geometry.parts import merge_parts, part_of_rings
from polywigner.geometry.rings import oriented, polygon_of_part
from polywigner.quantities import parse_wavelength
from polywigner.source.array import Array, Element, PathLengths, phased_array
from polywigner.source.polarisation import checked_polarisation
from polywigner.source.source_tables import (
    Complex,
    Coordinate,
    Coordinates,
    FieldTable,
    Frequency,
    Kind,
    LayoutTable,
    Length,
    Radii,
    ShapeTable,
    Table,
    WeightTable,
    call_table,
    converted,
    product_of,
    required_wavelength,
)

if TYPE_CHECKING:
    import xarray

VERSION = 1
"""Version of the format; files with any other version are rejected."""

SOURCE_COORDINATE = "source_json"
"""Name of the coordinate of a dataset that contains the text of its source file."""

_Item = TypeVar("_Item")
NonEmpty = Annotated[list[_Item], msgspec.Meta(min_length=1)]
Ring = Annotated[list[tuple[Coordinate, Coordinate]], msgspec.Meta(min_length=3)]


class Context(NamedTuple):
    """Folder of a source file, whether files outside it are allowed, and the wavelength in m."""

    folder: Path
    allow_outside: bool
    wavelength: float | None

    def path(self, name: str) -> Path:
        """Return the path of a file, from its path relative to the folder.

        Raises FileFormatError if the file is outside the folder, unless this is allowed.
        """
        path = (self.folder / name).resolve()
        if self.allow_outside or path.is_relative_to(self.folder.resolve()):
            return path
        raise FileFormatError(
            "expected the name of a file in the folder of the source file or below, got "
            f"{value_text(name)}; move the file there, or allow files outside with "
            "allow_outside=True (--allow-outside)"
        )


def _only_key(table: Table, *origins: str) -> str:
    """Return the one key of ``origins`` that a table contains, or raise FileFormatError."""
    present = only_given({key: getattr(table, key) for key in origins}, FileFormatError)
    for key in ("unit", "layer", "union"):
        if present != "file" and getattr(table, key, None):
            raise FileFormatError(
                f"the key {key!r} applies only to the key 'file', got the key {present!r}"
            )
    return present


class _Illuminated(Kind):
    shape: ShapeTable | None = None  # type: ignore[valid-type]
    illumination: FieldTable | NonEmpty[FieldTable] | None = None  # type: ignore[valid-type]

    def illuminated(self, outline: Any, kind: type, context: Context) -> Any:
        """Return an outline of type ``kind`` with the field of this table, if there is one.

        Raises FileFormatError if the outline has another type.
        """
        got = type(outline).__name__
        if got != kind.__name__:
            raise FileFormatError(f"shape: expected a shape of type {kind.__name__}, got {got}")
        if self.illumination is None:
            return outline
        d = 1 if kind is Slits else 2
        with at_key("illumination"):
            field = product_of(self.illumination, context.wavelength, dimension=d)
            return outline.with_illumination(field)


class ApertureTable(_Illuminated, tag="aperture"):
    file: str | None = None
    unit: str | None = None
    layer: str | list[str] | None = None
    union: bool = False
    polygons: NonEmpty[NonEmpty[Ring]] | None = None
    to_world: Coordinates | None = None

    def source(self, context: Context) -> Aperture | PlacedAperture:
        """Return the aperture of the table, with its field and its pose."""
        with at_key(_only_key(self, "file", "polygons", "shape")):
            if self.file is not None:
                path, unit = context.path(self.file), self.unit or "mm"
                outline: Any = geometry.read_aperture(path, unit, None, self.layer, self.union)
            elif self.polygons is not None:
                outline = _aperture_of_polygons(self.polygons)
            else:
                outline = call_table(self.shape)
        aperture: Aperture = self.illuminated(outline, Aperture, context)
        if self.to_world is None:
            return aperture
        with at_key("to_world"):
            pose = rigid_pose(self.to_world)
        # A pose written by polywigner is read back unchanged.
        is_rigid = np.allclose(self.to_world, pose, rtol=0.0, atol=1e-15)
        return PlacedAperture(aperture, np.array(self.to_world) if is_rigid else pose)


class SlitsTable(_Illuminated, tag="slits"):
    intervals: Coordinates | None = None

    def source(self, context: Context) -> Slits:
        """Return the slits of the table, with their field."""
        with at_key(_only_key(self, "intervals", "shape")):
            outline = call_table(self.shape) if self.intervals is None else Slits(self.intervals)
        slits: Slits = self.illuminated(outline, Slits, context)
        return slits


def _aperture_of_polygons(polygons: list[list[Any]]) -> Aperture:
    """Return an aperture made of polygons; the vertices of valid polygons are unchanged."""
    parts = [
        tuple(oriented(np.array(ring), n == 0) for n, ring in enumerate(rings))
        for rings in polygons
    ]
    region = shapely.MultiPolygon([polygon_of_part(part) for part in parts])
    different = shapely.get_num_coordinates(shapely.remove_repeated_points(region))
    is_clean = different == sum(len(ring) + 1 for part in parts for ring in part)
    if not is_clean or not shapely.is_valid(region):
        named = [part_of_rings(rings, f"polygon {k}") for k, rings in enumerate(polygons)]
        parts = merge_parts(named)
    return Aperture._of_parts(parts)


class Paths(Table):
    wavelength: Length
    cycles: list[float]
    slopes: list[tuple[float, float]]


class ArrayTable(Kind, tag="array"):
    elements: list[ApertureTable | SlitsTable]
    weights: list[Complex] | None = None
    paths: Paths | None = None

    def source(self, context: Context) -> Array:
        """Return the array of the table."""
        elements: list[Any] = []
        for k, table in enumerate(self.elements):
            with at_key(f"elements[{k}]"):
                elements.append(table.source(context))
        array = Array(elements, self.weights)
        if self.paths is None:
            return array
        cycles, slopes = np.array(self.paths.cycles), np.array(self.paths.slopes)
        return array.with_paths(PathLengths(cycles, slopes, float(self.paths.wavelength)))


class PhasedArrayTable(Kind, tag="phased-array"):
    element: ApertureTable | SlitsTable
    positions: LayoutTable | list[Coordinates]  # type: ignore[valid-type]
    weights: dict[str, Any] | NonEmpty[Any] | None = None

    def source(self, context: Context) -> Array:
        """Return the array of equal elements of the table."""
        with at_key("element"):
            element: Any = self.element.source(context)
        positions: Any = self.positions
        if not isinstance(positions, list):
            with at_key("positions"):
                positions = call_table(positions)
        weights: Any = self.weights
        if isinstance(weights, list) and not isinstance(weights[0], dict):
            weights = converted(weights, list[Complex], key="weights")
        elif weights is not None:
            kind = WeightTable | NonEmpty[WeightTable]  # type: ignore[valid-type]
            tables = converted(weights, kind, key="weights")
            of_array = {"positions": positions, "dimension": 1 if isinstance(element, Slits) else 2}
            with at_key("weights"):
                weights = product_of(tables, context.wavelength, layout=self.positions, **of_array)
        return phased_array(element, positions, weights)


SourceTable = ApertureTable | SlitsTable | ArrayTable | PhasedArrayTable


class WavefrontTable(Table):
    radius: Radii | None = None
    wavelength: Length | None = None
    curvature: list[list[float]] | None = None
    centre: Coordinates | None = None
    coherence_width: Length | None = None

    def on(self, source: Any, wavelength: float | None) -> Wavefront:
        """Return a source with this wave; ``wavelength`` is the file's wavelength in m, or None."""
        length = None if self.curvature is None else self.wavelength
        width = self.coherence_width or math.inf
        wave = Wavefront(source, self.curvature, self.centre, width, length)
        if self.radius is None:
            return wave
        return wave.curved(
            self.radius, required_wavelength(self.wavelength or wavelength), self.centre
        )


class Top(Table):
    """Keys at the top level of a file, in addition to the keys of the source."""

    version: Annotated[int, msgspec.Meta(ge=VERSION, le=VERSION)] = VERSION
    frequency: Frequency | None = None
    wavelength: Length | None = None
    polarisation: str | NonEmpty[str | float | NonEmpty[float | list[float]]] | None = None
    wavefront: WavefrontTable | None = None


class FileContent(NamedTuple):
    """The source of a file, its wavelength in m or None, and its polarisation or None.

    The polarisation is a Jones vector (2,), or one vector for each element (n, 2).
    """

    source: Element | Array | Wavefront
    wavelength: float | None
    polarisation: NDArray[np.complex128] | None


def content_of(tables: Any, folder: Path, allow_outside: bool = False) -> FileContent:
    """Convert the tables of a file to a source and its top-level settings.

    ``folder``: folder to which file names in the tables are relative. ``allow_outside``: whether
    files may be outside this folder.
    """
    tables = converted(tables, dict[str, Any])
    at_top = {key: tables.pop(key) for key in Top.__struct_fields__ if key in tables}
    body, top = converted(tables, SourceTable), converted(at_top, Top)
    wavelength = parse_wavelength(top.frequency, top.wavelength)
    source = flat = body.source(Context(folder, allow_outside, wavelength))
    if top.wavefront is not None:
        with at_key("wavefront"):
            source = top.wavefront.on(flat, wavelength)
    jones: Any = top.polarisation
    if jones is not None:
        with at_key("polarisation"):
            if not isinstance(jones, str) and not isinstance(jones[0], str):
                is_deep = isinstance(jones[0], list) and isinstance(jones[0][0], list)
                jones = converted(jones, list[list[Complex]] if is_deep else list[Complex])
            jones = checked_polarisation(jones, flat)
    return FileContent(source, wavelength, jones)


def read_source(
    path: str | os.PathLike[str] | xarray.Dataset, allow_outside: bool = False
) -> Element | Array | Wavefront:
    """Read an aperture with its field, slits or an array from a TOML or JSON file.

    docs/source_files.md describes the format. A source written by :func:`write_source` is read back
    unchanged. In files written by hand, quantities may be strings with units ("10 mm", "20 deg",
    "77 GHz"). Fields, layouts and weights may be specified by name. Outlines may be in other files,
    with paths relative to this file.

    Parameters
    ----------
    path : str, path or xarray.Dataset
        The file; or a dataset that polywigner computed, which contains its source.
    allow_outside : bool, default False
        Whether the file may refer to files outside its own folder, after links are resolved. Keep
        the default for untrusted files.

    Returns
    -------
    Aperture, PlacedAperture, Slits, Array or Wavefront
        The source.

    Raises
    ------
    FileFormatError
        If the file is missing, empty, too large (64 MiB) or not TOML or JSON; refers to a file
        outside its folder; or has an unknown key or a wrong value; or if a dataset contains no
        source.
    GeometryError, IlluminationError, ArgumentError, QuantityError
        If the values do not describe a valid source, for the same reasons as in the functions and
        classes that the file specifies.
    MissingExtraError
        If a library that a window or an outline needs is not installed.

    Examples
    --------
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
            f"expected a dataset with its source in the coordinate {SOURCE_COORDINATE}, got a "
            "dataset without this coordinate"
        )
    text = str(path.coords[SOURCE_COORDINATE].values.item())
    return content_of(_parsed(text, ".json"), Path(), allow_outside).source


def read_polarisation(
    path: str | os.PathLike[str], allow_outside: bool = False
) -> NDArray[np.complex128] | None:
    """Read the polarisation at the top level of a source file.

    A source is a scalar field; functions take its polarisation as a separate argument.

    Parameters
    ----------
    path : str or path
        The source file, as in :func:`read_source`.
    allow_outside : bool, default False
        As in :func:`read_source`.

    Returns
    -------
    ndarray of complex, shape (2,) or (n, 2), or None
        Jones vector along the source's x and y, or one vector for each element of an array if the
        file has a list of polarisations; None if the file has no polarisation.

    Raises
    ------
    FileFormatError
        For the same files as in :func:`read_source`, whose other errors are raised as well.
    ArgumentError
        If the polarisation is invalid.

    Examples
    --------
    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "antenna.toml"
    >>> pw.write_source(pw.shapes.square(10e-3), path, polarisation="right")
    >>> pw.read_polarisation(path).round(3)
    array([0.707+0.j   , 0.   +0.707j])
    """
    return read_content(path, allow_outside).polarisation


def read_content(path: str | os.PathLike[str], allow_outside: bool = False) -> FileContent:
    """Read the source of a file and its top-level settings."""
    file = checked_path(path)
    with at_key(str(file)):
        tables = _parsed(text_of(bytes_of(file)), _format_of(file))
        return content_of(tables, file.parent, allow_outside)


def _format_of(file: Path) -> str:
    """Return the suffix .toml or .json in lower case; raise FileFormatError for other suffixes."""
    return checked_suffix(file, (".toml", ".json"), "read outlines with polywigner.read_aperture")


def _parsed(text: str, suffix: str) -> Any:
    """Return the content of a TOML or JSON text; raise FileFormatError if the text is invalid."""
    parse = json.loads if suffix == ".json" else tomllib.loads
    try:
        return parse(text)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"invalid {suffix[1:].upper()}: {error}") from None


def table_of(source: Any) -> dict[str, Any]:
    """Return a source as the content of a source file: dictionaries, lists and numbers.

    Raises ArgumentError for objects other than sources.
    """
    if not isinstance(source, Wavefront):
        return {"version": VERSION, **_flat_table(source)}
    wave = {"curvature": source.curvature.tolist(), "centre": source.centre.tolist()}
    if source.wavelength is not None:
        wave["wavelength"] = source.wavelength
    if not source.is_coherent:
        wave["coherence_width"] = source.coherence_width
    return {**table_of(source.source), "wavefront": wave}


def _flat_table(source: Any) -> dict[str, Any]:
    """Return a source without a wavefront as the content of a source file."""
    if isinstance(source, PlacedAperture):
        return {**_flat_table(source.aperture), "to_world": source.pose.tolist()}
    if isinstance(source, Array):
        return _array_table(source)
    if isinstance(source, Slits):
        table = {"kind": "slits", "intervals": source.intervals.tolist()}
    elif isinstance(source, Aperture):
        polygons = [[ring.tolist() for ring in part] for part in source._parts]
        table = {"kind": "aperture", "polygons": polygons}
    else:
        raise ArgumentError(
            "expected an Aperture, a placed aperture, Slits, an Array of these or a Wavefront, got "
            f"{type(source).__name__}"
        )
    if source.illumination is not None:
        amplitudes = _listed_numbers(source.illumination.amplitudes)
        frequencies = source.illumination.frequencies.tolist()
        field = {"kind": "waves", "amplitudes": amplitudes, "frequencies": frequencies}
        table["illumination"] = field
    return table


def _array_table(array: Array) -> dict[str, Any]:
    """Return an array as the content of a source file."""
    weights = {} if (array.weights == 1).all() else {"weights": _listed_numbers(array.weights)}
    if array.repeated is not None:
        element, positions = array.repeated
        body = {"kind": "phased-array", "positions": positions.tolist(), **weights}
        return {**body, "element": _flat_table(element)}
    table: dict[str, Any] = {"kind": "array", **weights}
    if array.paths is not None:
        paths = array.paths
        cycles, slopes = paths.cycles.tolist(), paths.slopes.tolist()
        table["paths"] = {"wavelength": paths.wavelength, "cycles": cycles, "slopes": slopes}
    return {**table, "elements": [_flat_table(element) for element in array.elements]}


def _listed_numbers(values: NDArray[np.complex128]) -> list[Any]:
    """Return a list of real numbers, or of pairs [real, imaginary] if any number is complex."""
    if not values.imag.any():
        return values.real.tolist()
    return values.view(np.float64).reshape(*values.shape, 2).tolist()


def source_json(source: Any) -> str:
    """Return a source as one line of JSON."""
    return json.dumps(table_of(source))


def _toml(table: Mapping[str, Any], path: str = "") -> str:
    """Format a table as TOML: values first, then nested tables under their full names."""
    lines, sections = [], []
    for key, value in table.items():
        name = f"{path}.{key}" if path else key
        if isinstance(value, Mapping):
            sections.append(f"\n[{name}]\n{_toml(value, name)}")
        elif isinstance(value, list) and isinstance(value[0], Mapping):
            sections += [f"\n[[{name}]]\n{_toml(item, name)}" for item in value]
        # TOML and JSON have the same syntax for numbers, strings and lists.
        else:
            lines.append(f"{key} = {json.dumps(value)}\n".replace("], [", "],\n  ["))
    return "".join(lines + sections)


def write_source(
    source: Element | Array | Wavefront,
    path: str | os.PathLike[str],
    *,
    polarisation: str | ArrayLike | None = None,
) -> None:
    """Write a source to a ``.toml`` or ``.json`` file for :func:`read_source`.

    All floats are written exactly. The file is written completely or not at all, and replaces an
    existing file.

    Parameters
    ----------
    source : Aperture, PlacedAperture, Slits, Array or Wavefront
        A source with its fields and weights.
    path : str or path
        The file; its suffix selects the format.
    polarisation : str or array_like, optional
        Polarisation for :func:`read_polarisation`, given as in :func:`polywigner.field`; default:
        none.

    Raises
    ------
    ArgumentError
        If the source is another object, the polarisation is invalid, or the path cannot be written.
    FileFormatError
        If the suffix of the path is neither .toml nor .json.

    Examples
    --------
    >>> import polywigner as pw
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "antenna.toml"
    >>> pw.write_source(pw.shapes.square(10e-3), path)
    >>> pw.read_source(path) == pw.shapes.square(10e-3)
    True
    """
    file, table = checked_path(path), table_of(source)
    if polarisation is not None:
        jones = checked_polarisation(polarisation, source)
        table["polarisation"] = jones.view(np.float64).reshape(*jones.shape, 2).tolist()
    with at_key(str(file)):
        is_json = _format_of(file) == ".json"
    write_lines(file, [json.dumps(table) if is_json else _toml(table).rstrip("\n")])
