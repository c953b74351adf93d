"""Sources of the tables of source files: apertures, slits, bodies, arrays and their waves."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

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
from polywigner.geometry.io import limits
from polywigner.geometry.parts import merge_parts, part_of_rings
from polywigner.geometry.rings import Part, oriented, polygon_of_part
from polywigner.illumination.array import Array, Element, PathLengths, phased_array
from polywigner.illumination.polarisation import checked_polarisation
from polywigner.illumination.source_values import (
    HEAD,
    KEYS,
    Around,
    Converter,
    Kind,
    Table,
    at,
    check_keys,
    complex_numbers,
    coordinates,
    field_of,
    flag,
    made,
    name_in,
    positions_of,
    shown,
    values_of,
    wavelength_in,
    weights_of,
    whole,
)

Source = Element | Array | Wavefront

# A rotation that is the nearest one to within rounding is taken as it is.
_ROUNDING = 1e-15


class FileContent(NamedTuple):
    """The source of a file, with the numbers at its top."""

    source: Source
    wavelength: float | None
    """In m, that stands at its top, if any."""
    polarisation: NDArray[np.complex128] | None
    """Jones vector (2,), or one for each element (n, 2), that stands at its top, if any."""


def content_of(table: Any, folder: Path, allow_outside: bool = False) -> FileContent:
    """The source that a file's whole table describes, and the numbers at its top."""
    if not isinstance(table, dict):
        raise FileFormatError(f"expected a table with the key 'kind', got {shown(table)}")
    kinds = _ELEMENTS | _ARRAYS
    name_in(table, kinds)  # first: of a file that is no source file, nothing is quoted
    head = values_of(table, HEAD)
    wavelength = wavelength_in(head, None)
    around = Around(folder, allow_outside, wavelength)
    body = {key: value for key, value in table.items() if key not in HEAD}
    wave = body.pop("wavefront", None)
    source = flat = made(body, kinds, around)
    if wave is not None:
        with at("wavefront"):
            source = _with_wave(source, wave, wavelength)
    jones = None
    if "polarisation" in head:
        with at("polarisation"):
            jones = _polarisation(head["polarisation"], flat)
    return FileContent(source, wavelength, jones)


def _polarisation(value: Any, source: Any) -> NDArray[np.complex128]:
    """Jones vectors of a text, a list of texts, or lists of numbers: pairs where complex."""
    if isinstance(value, list) and not all(isinstance(item, str) for item in value):
        is_deep = isinstance(value[0], list) and any(isinstance(part, list) for part in value[0])
        value = complex_numbers(value, 2 if is_deep else 1)
    return checked_polarisation(value, source)


# Outlines and bodies.


def _aperture(values: dict[str, Any], around: Around) -> Aperture | PlacedAperture:
    origin = _only_one(values, ("file", "polygons", "shape"))
    only = {"unit": "file", "layer": "file", "union": "file", "verbatim": "polygons"}
    for key, of in only.items():
        if key in values and origin != of:
            raise FileFormatError(f"expected {key!r} with {of!r} only, got it with {origin!r}")
    with at(origin):
        if origin == "file":
            layer, union = values.get("layer"), values.get("union", False)
            aperture = _from_file(values, around, read_aperture, layer=layer, union=union)
        elif origin == "shape":
            aperture = _shape(values["shape"], Aperture)
        else:
            aperture = _of_polygons(values["polygons"], values.get("verbatim", False))
    if origin != "file":
        around.count(**_size(aperture))
    lit = _illuminated(aperture, values, around)
    return _placed(lit, values["to_world"]) if "to_world" in values else lit


def _slits(values: dict[str, Any], around: Around) -> Slits:
    origin = _only_one(values, ("intervals", "shape"))
    with at(origin):
        if origin == "shape":
            slits = _shape(values["shape"], Slits)
        else:
            make = _slits_as_they_are if values.get("verbatim", False) else Slits
            slits = make(values["intervals"])
    around.count(rings=1, vertices=len(slits.intervals))
    lit: Slits = _illuminated(slits, values, replace(around, dimension=1))
    return lit


def _polyhedron(values: dict[str, Any], around: Around) -> Polyhedron:
    table = {"kind": "polyhedron", **values}
    if "file" in values:
        check_keys(table, ("kind", "file"), ("unit",))
        with at("file"):
            body: Polyhedron = _from_file(values, around, read_polyhedron)
            return body
    check_keys(table, ("kind", "vertices", "faces"))
    faces = values["faces"]
    limits.check_most(len(faces), limits.MOST_FACES, "faces")
    around.count(rings=1, vertices=len(faces))
    return Polyhedron(values["vertices"], faces)


_ELEMENTS: dict[str, Kind] = {
    "aperture": Kind(
        _aperture, "", "file polygons shape unit layer union verbatim illumination to_world"
    ),
    "slits": Kind(_slits, "", "intervals shape verbatim illumination"),
    "polyhedron": Kind(_polyhedron, "", "file unit vertices faces"),
}
"""Kinds of sources that may be elements of arrays."""


def _only_one(values: Table, keys: tuple[str, ...]) -> str:
    found = [key for key in keys if key in values]
    if len(found) != 1:
        got = " and ".join(found) or "none"
        raise FileFormatError(f"expected one of the keys {', '.join(keys)}, got {got}")
    return found[0]


def _illuminated(source: Any, values: dict[str, Any], around: Around) -> Any:
    if "illumination" not in values:
        return source
    with at("illumination"):
        return source.with_illumination(field_of(values["illumination"], around))


def _placed(aperture: Aperture, given: Any) -> PlacedAperture:
    with at("to_world"):
        pose = rigid_pose(given)
        exact = np.array(given)
        if float(np.abs(exact - pose).max()) <= _ROUNDING:
            exact.setflags(write=False)
            pose = exact  # as it was written: the nearest rotation is rounded elsewhere
        return PlacedAperture(aperture, pose)


def _from_file(values: Table, around: Around, read: Callable[..., Any], **options: Any) -> Any:
    name, unit = values["file"], values.get("unit", "mm")
    path = _path(around, name)
    key = (path, unit, *options.values())
    if key not in around.read:
        around.count(bytes=path.stat().st_size if path.is_file() else 0)
        found = read(path, unit, **options)
        around.count(**_size(found))
        around.read[key] = found
    return around.read[key]


def _size(source: Aperture | Polyhedron) -> dict[str, int]:
    """The numbers of outlines or bodies, and of their vertices or faces."""
    if isinstance(source, Polyhedron):
        return {"rings": 1, "vertices": len(source.faces)}
    rings = [ring for part in source._parts for ring in part]
    return {"rings": len(rings), "vertices": sum(map(len, rings))}


def _path(around: Around, name: str) -> Path:
    """Where another file is, all links followed; it may have to be in the folder or below."""
    try:
        folder = around.folder.resolve()
        path = (folder / name).resolve()
    except (OSError, ValueError, RuntimeError):  # links in a circle, a null character
        raise FileFormatError(f"expected the name of a file, got {shown(name)}") from None
    if not around.allow_outside and not path.is_relative_to(folder):
        raise FileFormatError(
            f"expected a file in the folder of the source file or below, got {shown(name)}; move "
            "it there, or trust the file with allow_outside=True (--allow-outside)"
        )
    return path


def _shape(table: Any, expected: type) -> Any:
    """A shape of the catalogue; its keys are the parameters of the function of that name."""
    plain = {name: getattr(shapes, name) for name in shapes.__all__}
    name = name_in(table, plain, "name", "the name of a shape")
    parameters = inspect.signature(plain[name]).parameters
    required = [p.name for p in parameters.values() if p.default is p.empty]
    check_keys(table, ("name", *required), [key for key in parameters if key not in required])
    plainer: dict[str, Converter] = {"int": whole, "bool": flag}
    values = values_of(
        table, {key: plainer.get(p.annotation, coordinates) for key, p in parameters.items()}
    )
    with at(name):
        _check_shape(values)
        shape = plain[name](**values)
    if not isinstance(shape, expected):
        raise FileFormatError(f"expected a shape that is an {expected.__name__}, got {name}")
    return shape


def _check_shape(values: Mapping[str, Any]) -> None:
    """Raise for parameters of a shape by name that make it very large."""
    for name, value in values.items():
        if isinstance(value, int) and value > limits.LARGEST_PART:
            raise FileFormatError(f"expected {name} of at most {limits.LARGEST_PART}, got more")
    sizes = [len(v) if isinstance(v, list) else v if type(v) is int else 1 for v in values.values()]
    limits.check_vertices(math.prod(max(1, size) for size in sizes))
    rings = values.get("rings", 0)
    if 3 * rings * rings > limits.MOST_RINGS:  # of hexagons around each other
        raise FileFormatError(
            f"expected rings of at most {limits.MOST_RINGS} segments, got {3 * rings * (rings + 1)}"
        )


def _of_polygons(polygons: Any, verbatim: bool) -> Aperture:
    """The aperture of a list of polygons; `verbatim`: with all its vertices as they are."""
    listed = isinstance(polygons, list) and all(
        isinstance(rings, list) and rings and all(isinstance(ring, list) for ring in rings)
        for rings in polygons
    )
    if not listed or not polygons:
        raise FileFormatError(
            "expected a list of polygons, each a list of rings, each a list of vertices [x, y]"
        )
    return _aperture_as_it_is(polygons) if verbatim else aperture_of_polygons(polygons)


def aperture_of_polygons(polygons: list[list[Any]]) -> Aperture:
    """The aperture of polygons, each a list of rings with the exterior first."""
    parts = [part_of_rings(rings, f"polygon {k}") for k, rings in enumerate(polygons)]
    return Aperture._of_parts(merge_parts(parts))


def _aperture_as_it_is(polygons: list[list[Any]]) -> Aperture:
    """Outlines exactly as they were written, without a vertex dropped or moved.

    Apertures that were shifted far have vertices on a line, which the constructor would drop.
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


def _slits_as_they_are(intervals: Any) -> Slits:
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


def _with_wave(source: Any, table: Any, wavelength: float | None) -> Wavefront:
    """The source with the wave that a table describes; ``wavelength``: at the top, in m."""
    check_keys(table, (), ("radius", "wavelength", "curvature", "centre", "coherence_width"))
    if not isinstance(source, Aperture | Slits | Array):
        raise FileFormatError("expected it of an aperture without a pose, of slits or of an array")
    values = values_of(table, KEYS)
    if "radius" in values and "curvature" in values:
        raise FileFormatError("expected the key radius or curvature, got both")
    centre = values.get("centre")
    width = values.get("coherence_width", math.inf)
    length = values.get("wavelength") if "curvature" in values else None
    wave = Wavefront(source, values.get("curvature"), centre, width, length)
    if "radius" not in values:
        return wave
    with at("radius"):
        own = values.get("wavelength", wavelength)
        if own is None:
            raise FileFormatError("expected a frequency or wavelength in the file, got none")
        return wave.curved(values["radius"], own, centre)


# Arrays.


def _array(values: dict[str, Any], around: Around) -> Array:
    given = values["elements"]
    advice = 'equal ones are one array of kind "phased-array"'
    limits.check_most(len(given), limits.MOST_LISTED, "elements", advice)
    elements = []
    for k, element in enumerate(given):
        with at(f"element {k}"):
            elements.append(made(element, _ELEMENTS, around))
    with at("weights"):
        weights = complex_numbers(values["weights"]) if "weights" in values else None
    array = Array(elements, weights)
    if "paths" not in values:
        return array
    with at("paths"):
        table = values["paths"]
        check_keys(table, ("wavelength", "cycles", "slopes"), ())
        paths = values_of(table, KEYS)
        return array.with_paths(
            PathLengths(np.array(paths["cycles"]), np.array(paths["slopes"]), paths["wavelength"])
        )


def _phased_array(values: dict[str, Any], around: Around) -> Array:
    with at("element"):
        element = made(values["element"], _ELEMENTS, around)
        if not isinstance(element, Aperture | Slits):
            raise FileFormatError("expected an aperture without a pose, or slits, to repeat")
    around = replace(around, dimension=1 if isinstance(element, Slits) else 2)
    with at("positions"):
        positions = positions_of(values["positions"], around)
    around = replace(around, dimension=positions.places.shape[1], positions=positions)
    with at("weights"):
        given = values.get("weights")
        weights = None if given is None else weights_of(given, around)
    return phased_array(element, positions.places, weights)


_ARRAYS: dict[str, Kind] = {
    "array": Kind(_array, "elements", "weights paths"),
    "phased-array": Kind(_phased_array, "element positions", "weights"),
}
