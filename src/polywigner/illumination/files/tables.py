"""From the tables of a source file to sources."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from polywigner.errors import FileFormatError, GeometryError
from polywigner.geometry import (
    Aperture,
    PlacedAperture,
    Polyhedron,
    Slits,
    Wavefront,
    read_aperture,
    read_polyhedron,
    rigid_pose,
    shapes,
)
from polywigner.geometry.formats.limits import (
    LARGEST_FILE,
    LARGEST_PART,
    MOST_FACES,
    MOST_LISTED,
    MOST_RINGS,
    MOST_WAVES,
    check_polygons,
    check_rings,
    check_vertices,
)
from polywigner.geometry.parts import merge_parts, part_of_rings
from polywigner.geometry.rings import Part, oriented, polygon_of_part
from polywigner.illumination.array import Array, Element, phased_array
from polywigner.illumination.files.fields import (
    Table,
    at,
    checked_list,
    checked_table,
    complex_numbers,
    coordinates,
    drawing_options,
    flag,
    illumination_of,
    length,
    numbers,
    positions_of,
    radius_of,
    shown,
    text,
    wavelength_in,
    weights_of,
    whole,
)

__all__ = [
    "VERSION",
    "Counts",
    "Source",
    "aperture_of_polygons",
    "check_shape",
    "from_polygons",
    "slits_as_they_are",
    "source_of",
    "table_of_wavefront",
    "wavefront_of",
]


@dataclass
class Counts:
    """Sums over all elements of a file and the files that it names."""

    rings: int = 0
    vertices: int = 0
    waves: int = 0
    bytes: int = 0

    def add_outlines(self, rings: int, vertices: int) -> None:
        """Count outlines and their vertices."""
        self.rings += rings
        self.vertices += vertices
        check_rings(self.rings)
        check_vertices(self.vertices)

    def add_waves(self, count: int) -> None:
        """Count plane waves, before they are made."""
        self.waves += count
        if self.waves > MOST_WAVES:
            raise FileFormatError(
                f"expected fields of at most {MOST_WAVES} plane waves in a file, got more; use "
                "fewer or lower tapers"
            )

    def add_bytes(self, count: int) -> None:
        """Count what is read of another file."""
        self.bytes += count
        if self.bytes > LARGEST_FILE:
            raise FileFormatError(
                f"expected to read at most {LARGEST_FILE >> 20} MiB of other files, got more; "
                "simplify them"
            )


def check_shape(values: Mapping[str, Any]) -> None:
    """Raise for parameters of a shape by name that make it very large."""
    for name, value in values.items():
        if isinstance(value, int) and value > LARGEST_PART:
            raise FileFormatError(f"expected {name} of at most {LARGEST_PART}, got more")
    sizes = [len(v) if isinstance(v, list) else v if type(v) is int else 1 for v in values.values()]
    check_vertices(math.prod(max(1, size) for size in sizes))
    rings = values.get("rings", 0)
    if 3 * rings * rings > MOST_RINGS:  # of hexagons around each other
        raise FileFormatError(
            f"expected rings of at most {MOST_RINGS} segments, got {3 * rings * (rings + 1)}"
        )


def from_polygons(value: Any, verbatim: bool) -> Aperture:
    """The aperture of a list of polygons; `verbatim`: with all its vertices as they are."""
    polygons = coordinates(value)
    listed = isinstance(polygons, list) and all(
        isinstance(rings, list) and rings and all(isinstance(ring, list) for ring in rings)
        for rings in polygons
    )
    if not listed or not polygons:
        raise FileFormatError(
            "expected a list of polygons, each a list of rings, each a list of vertices [x, y]"
        )
    check_polygons(polygons)
    return _aperture_as_it_is(polygons) if verbatim else aperture_of_polygons(polygons)


def aperture_of_polygons(polygons: list[list[Any]]) -> Aperture:
    """The aperture of polygons, each a list of rings with the exterior first."""
    parts = [part_of_rings(rings, f"polygon {k}") for k, rings in enumerate(polygons)]
    return Aperture._of_parts(merge_parts(parts))


def _aperture_as_it_is(polygons: list[list[Any]]) -> Aperture:
    """Outlines exactly as they were written, without a vertex dropped or moved.

    Apertures that were shifted far, say, have vertices that rounding has put on a line, which the
    constructor would drop.
    """
    parts: list[Part] = []
    for rings in polygons:
        part = tuple(_array_of(ring) for ring in rings)
        for n, ring in enumerate(part):
            if ring.ndim != 2 or ring.shape[1] != 2 or len(ring) < 3:
                raise FileFormatError(f"expected rings of vertices [x, y], got shape {ring.shape}")
            if oriented(ring, counter_clockwise=n == 0) is not ring:
                raise GeometryError(
                    "expected exteriors counter-clockwise and holes clockwise where verbatim is "
                    "true; leave verbatim out"
                )
        parts.append(part)
    reason = shapely.is_valid_reason(shapely.MultiPolygon([polygon_of_part(p) for p in parts]))
    if reason != "Valid Geometry":
        raise GeometryError(
            f"expected valid polygons where verbatim is true, got {reason}; leave verbatim out"
        )
    return Aperture._of_parts(parts)


def slits_as_they_are(intervals: Any) -> Slits:
    """Intervals exactly as they were written; see :func:`_aperture_as_it_is`."""
    array = _array_of(intervals)
    fits = array.ndim == 2 and array.shape[1] == 2 and len(array)
    if not fits or not (np.diff(array.ravel()) >= 0).all() or not (np.diff(array) > 0).all():
        raise GeometryError(
            "expected ascending slits wider than zero where verbatim is true; leave verbatim out"
        )
    return Slits._of_intervals(array)


def _array_of(numbers: Any) -> NDArray[np.float64]:
    try:
        return np.array(numbers, dtype=np.float64)
    except ValueError:  # lists of different lengths
        return np.empty(0)


def wavefront_of(source: Any, table: Any, wavelength: float | None) -> Wavefront:
    """The source with the wave that a table describes; ``wavelength``: that of the file, in m."""
    keys = ("radius", "wavelength", "curvature", "centre", "coherence_width")
    checked_table(table, (), keys)
    if not isinstance(source, Aperture | Slits | Array):
        raise FileFormatError("expected it of an aperture without a pose, of slits or of an array")
    if "radius" in table and "curvature" in table:
        raise FileFormatError("expected the key radius or curvature, got both")
    with at("centre"):
        centre = coordinates(table["centre"]) if "centre" in table else None
    with at("curvature"):
        matrix = numbers(table["curvature"]) if "curvature" in table else None
    with at("coherence_width"):
        width = length(table["coherence_width"]) if "coherence_width" in table else math.inf
    wave = Wavefront(source, matrix, centre, width)
    if "radius" not in table:
        return wave
    with at("radius"):
        given = table["radius"]
        radii = [radius_of(r) for r in given] if isinstance(given, list) else radius_of(given)
        own = length(table["wavelength"]) if "wavelength" in table else wavelength
        if own is None:
            raise FileFormatError("expected a frequency or wavelength in the file, got none")
        return wave.curved(radii, own, centre)


def table_of_wavefront(wave: Wavefront) -> dict[str, Any]:
    """What :func:`wavefront_of` makes the same wave of."""
    table: dict[str, Any] = {"curvature": wave.curvature.tolist(), "centre": wave.centre.tolist()}
    return table if wave.is_coherent else {**table, "coherence_width": wave.coherence_width}


Source = Element | Array | Wavefront

VERSION = 1
"""Version of the format; files of another are refused."""

_HEAD = ("version", "frequency", "wavelength")

# A rotation that is the nearest one to within rounding is taken as it is.
_ROUNDING = 1e-15


@dataclass(frozen=True)
class _File:
    """Settings that all tables of a file share."""

    folder: Path
    wavelength: float | None
    allow_outside: bool = False
    """Whether other files may stand elsewhere than in the folder."""
    read: dict[tuple[Any, ...], Aperture | Polyhedron] = field(default_factory=dict)
    """Other files that were read, by path, unit and options."""
    counts: Counts = field(default_factory=Counts)


def source_of(table: Any, folder: Path, allow_outside: bool = False) -> Source:
    """The source that a file's whole table describes.

    Its aperture files are in `folder` or below, unless they are allowed to be outside.
    """
    if not isinstance(table, dict):
        raise FileFormatError(f"expected a table with the key 'kind', got {shown(table)}")
    kinds = {**_ELEMENTS, "array": _array, "phased-array": _phased_array}
    _kind_in(table, kinds)  # first: of a file that is no source file, nothing is quoted
    if "version" in table:
        with at("version"):
            if whole(table["version"]) != VERSION:
                raise FileFormatError(f"expected {VERSION}, got {shown(table['version'])}")
    body = {key: value for key, value in table.items() if key not in _HEAD}
    file = _File(folder, wavelength_in(table), allow_outside)
    wave = body.pop("wavefront", None)
    source = _of_kind(body, kinds, file)
    if wave is None:
        return source
    with at("wavefront"):
        return wavefront_of(source, wave, file.wavelength)


def _of_kind(table: Any, kinds: Mapping[str, Callable[[Table, _File], Any]], file: _File) -> Any:
    return kinds[_kind_in(table, kinds)](table, file)


def _kind_in(table: Any, kinds: Iterable[str]) -> str:
    name = table.get("kind") if isinstance(table, dict) else None
    if not isinstance(name, str) or name not in kinds:
        got = shown(name) if name is not None else f"{shown(table)} without a kind"
        raise FileFormatError(f"expected a kind out of {', '.join(kinds)}, got {got}")
    return name


def _aperture(table: Table, file: _File) -> Aperture | PlacedAperture:
    origins = ("file", "polygons", "shape")
    keys = (*origins, "unit", "layer", "union", "verbatim", "illumination", "to_world")
    checked_table(table, ("kind",), keys)
    origin = _only_one(table, origins)
    only = {"unit": "file", "layer": "file", "union": "file", "verbatim": "polygons"}
    for key, of in only.items():
        if key in table and origin != of:
            raise FileFormatError(f"expected {key!r} with {of!r} only, got it with {origin!r}")
    with at(origin):
        if origin == "file":
            aperture = _from_file(table, file, read_aperture, **drawing_options(table))
        elif origin == "shape":
            aperture = _shape(table["shape"], Aperture)
        else:
            aperture = from_polygons(table["polygons"], flag(table.get("verbatim", False)))
    if origin != "file":
        file.counts.add_outlines(*_size(aperture))
    lit = _illuminated(aperture, table, file)
    return lit if "to_world" not in table else _placed(lit, table["to_world"])


def _slits(table: Table, file: _File) -> Slits:
    checked_table(table, ("kind",), ("intervals", "shape", "verbatim", "illumination"))
    origin = _only_one(table, ("intervals", "shape"))
    with at(origin):
        if origin == "shape":
            slits = _shape(table["shape"], Slits)
        else:
            intervals = coordinates(table["intervals"])
            verbatim = flag(table.get("verbatim", False))
            slits = slits_as_they_are(intervals) if verbatim else Slits(intervals)
    file.counts.add_outlines(1, len(slits.intervals))
    return _illuminated(slits, table, file)


def _polyhedron(table: Table, file: _File) -> Polyhedron:
    if "file" in table:
        checked_table(table, ("kind", "file"), ("unit",))
        with at("file"):
            return _from_file(table, file, read_polyhedron)
    checked_table(table, ("kind", "vertices", "faces"))
    with at("vertices"):
        vertices = coordinates(table["vertices"])
    with at("faces"):
        faces = [[whole(k) for k in checked_list(face)] for face in checked_list(table["faces"])]
    if len(faces) > MOST_FACES:
        raise FileFormatError(f"expected at most {MOST_FACES} faces, got {len(faces)}")
    file.counts.add_outlines(1, len(faces))
    return Polyhedron(vertices, faces)


_ELEMENTS: dict[str, Callable[[Table, _File], Element]] = {
    "aperture": _aperture,
    "slits": _slits,
    "polyhedron": _polyhedron,
}
"""Kinds of sources that may be elements of arrays."""


def _array(table: Table, file: _File) -> Array:
    checked_table(table, ("kind", "elements"), ("weights",))
    with at("elements"):
        given = checked_list(table["elements"])
        if len(given) > MOST_LISTED:
            raise FileFormatError(
                f"expected at most {MOST_LISTED} elements, got {len(given)}; equal ones are one "
                'array of kind "phased-array"'
            )
    elements = []
    for k, element in enumerate(given):
        with at(f"element {k}"):
            elements.append(_of_kind(element, _ELEMENTS, file))
    with at("weights"):
        weights = complex_numbers(table["weights"]) if "weights" in table else None
    return Array(elements, weights)


def _phased_array(table: Table, file: _File) -> Array:
    checked_table(table, ("kind", "element", "positions"), ("weights",))
    with at("element"):
        element = _of_kind(table["element"], _ELEMENTS, file)
        if not isinstance(element, Aperture | Slits):
            raise FileFormatError("expected an aperture without a pose, or slits, to repeat")
    with at("positions"):
        positions = positions_of(table["positions"], 1 if isinstance(element, Slits) else 2)
    with at("weights"):
        given = table.get("weights")
        weights = None if given is None else weights_of(given, positions, file.wavelength)
    return phased_array(element, positions.places, weights)


def _only_one(table: Table, keys: tuple[str, ...]) -> str:
    found = [key for key in keys if key in table]
    if len(found) != 1:
        got = " and ".join(found) or "none"
        raise FileFormatError(f"expected one of the keys {', '.join(keys)}, got {got}")
    return found[0]


def _illuminated(source: Any, table: Table, file: _File) -> Any:
    if "illumination" not in table:
        return source
    with at("illumination"):
        dimension = 1 if isinstance(source, Slits) else 2
        return source.with_illumination(
            illumination_of(
                table["illumination"], dimension, file.wavelength, file.counts.add_waves
            )
        )


def _placed(aperture: Aperture, to_world: Any) -> PlacedAperture:
    with at("to_world"):
        given = coordinates(to_world)
        pose = rigid_pose(given)
        exact = np.array(given)
        if float(np.abs(exact - pose).max()) <= _ROUNDING:
            exact.setflags(write=False)
            pose = exact  # as it was written: the nearest rotation is rounded elsewhere
        return PlacedAperture(aperture, pose)


def _from_file(table: Table, file: _File, read: Callable[..., Any], **options: Any) -> Any:
    name, unit = text(table["file"]), text(table.get("unit", "mm"))
    path = _path(file, name)
    key = (path, unit, *options.values())
    if key not in file.read:
        file.counts.add_bytes(path.stat().st_size if path.is_file() else 0)
        found = read(path, unit, **options)
        file.counts.add_outlines(*_size(found))
        file.read[key] = found
    return file.read[key]


def _size(source: Aperture | Polyhedron) -> tuple[int, int]:
    """How many outlines or bodies it is, and their vertices or faces."""
    if isinstance(source, Polyhedron):
        return 1, len(source.faces)
    rings = [ring for part in source._parts for ring in part]
    return len(rings), sum(map(len, rings))


def _path(file: _File, name: str) -> Path:
    """Where another file is, all links followed; it may have to be in the folder or below."""
    try:
        folder = file.folder.resolve()
        path = (folder / name).resolve()
    except (OSError, ValueError, RuntimeError):  # links in a circle, a null character
        raise FileFormatError(f"expected the name of a file, got {shown(name)}") from None
    if not file.allow_outside and not path.is_relative_to(folder):
        raise FileFormatError(
            f"expected a file in the folder of the source file or below, got {shown(name)}; move "
            "it there, or trust the file with allow_outside=True (--allow-outside)"
        )
    return path


def _shape(table: Any, expected: type) -> Any:
    """A shape of the catalogue; its keys are the parameters of the function of that name."""
    plain = {name: getattr(shapes, name) for name in shapes.__all__}
    name = table.get("name") if isinstance(table, dict) else None
    if not isinstance(name, str) or name not in plain:
        got = shown(name) if name is not None else f"{shown(table)} without a name"
        raise FileFormatError(f"expected the name of a shape out of {', '.join(plain)}, got {got}")
    parameters = inspect.signature(plain[name]).parameters
    required = [p.name for p in parameters.values() if p.default is p.empty]
    checked_table(table, ("name", *required), [key for key in parameters if key not in required])
    convert = {"int": whole, "bool": flag}
    values = {}
    for key in parameters:
        if key in table:
            with at(key):
                values[key] = convert.get(parameters[key].annotation, coordinates)(table[key])
    with at(name):
        check_shape(values)
        shape = plain[name](**values)
    if not isinstance(shape, expected):
        raise FileFormatError(f"expected a shape that is an {expected.__name__}, got {name}")
    return shape
