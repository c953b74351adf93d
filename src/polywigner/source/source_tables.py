"""Tables and short strings in source files and options: fields, layouts, weights and shapes.

The keys of a table are the parameters of a function; docs/source_files.md lists all tables. Errors
begin with the path of the key, such as ``weights[1].sll``.
"""

from __future__ import annotations

import functools
import inspect
import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from polywigner import quantities
from polywigner.errors import ArgumentError, FileFormatError, QuantityError, at_key, value_text
from polywigner.geometry import Aperture, Slits, Wavefront, shapes
from polywigner.geometry.arguments import checked_type
from polywigner.geometry.illumination import Illumination
from polywigner.source import arrays, tapers
from polywigner.source.array import Array, phased_array, repeated_element


class Length(float):
    """A length above zero in m, or a string such as "10 mm"."""


class Coordinate(float):
    """A length of either sign in m, or a string such as "-2 mm"."""


class Angle(float):
    """An angle in rad, or a string such as "20 deg"."""


class Frequency(float):
    """A frequency in Hz, or a string such as "77 GHz"."""


class Decibels(float):
    """A level in dB, or a string such as "25 dB"."""


class Coordinates(list[Any]):
    """A coordinate, or coordinates in nested lists of any depth."""


class Radii(list[float]):
    """A radius of curvature in m, or a radius for each axis; "inf" for a flat wave."""


class Complex(complex):
    """A real number, or a pair [real, imaginary]."""


def _in_metres(values: Any) -> Any:
    """Convert numbers, or strings such as "2 mm", to metres. Lists may be nested."""
    if isinstance(values, list):
        return [_in_metres(value) for value in values]
    is_number = type(values) is float and math.isfinite(values)
    return values if is_number else quantities.parse_coordinate(values)


def _as_list(value: Any) -> list[Any]:
    """Return a list unchanged, and any other value as a list with one entry."""
    return value if isinstance(value, list) else [value]


_FLAT = ("inf", math.inf)
_PARSERS: dict[type, Callable[[Any], Any]] = {
    Length: quantities.parse_length,
    Coordinate: _in_metres,
    Angle: quantities.parse_angle,
    Frequency: quantities.parse_frequency,
    Decibels: quantities.parse_decibels,
    Coordinates: lambda values: _in_metres(_as_list(values)),
    Radii: lambda radii: [float(r) if r in _FLAT else _in_metres(r) for r in _as_list(radii)],
    Complex: lambda number: complex(*converted(_as_list(number), list[float])),
}


def converted(table: Any, kind: Any, strict: bool = True, key: str = "") -> Any:
    """Convert a table to the type ``kind``; raise FileFormatError for an invalid key or value.

    If not ``strict``, strings are converted to numbers. ``key``: key of the table, for messages.
    """
    try:
        hook: Any = lambda kind, value: kind(_PARSERS[kind](value))  # noqa: E731
        return msgspec.convert(table, kind, strict=strict, dec_hook=hook)
    except msgspec.ValidationError as error:
        text = "".join(c if c.isprintable() else " " for c in str(error))
        fault, _, path = text.replace(" | null", "").partition(" - at `$")
        fault, path = fault[0].lower() + fault[1:], f"{key}{path}".strip(".`")
        raise FileFormatError(f"{path}: {fault}" if path else fault) from None


def required_wavelength(wavelength: float | None) -> float:
    """Return the wavelength in m; raise FileFormatError if it is None."""
    if wavelength is None:
        raise FileFormatError("expected a frequency or a wavelength, got neither; add one of them")
    return wavelength


class Table(msgspec.Struct, forbid_unknown_fields=True):
    """A table with fixed keys."""


class Kind(Table, tag_field="kind"):
    """A table whose key "kind" selects the class."""


class _Shape(Table, tag_field="name"):
    """A table whose key "name" selects a shape of the catalogue."""


_OF_ANNOTATION: dict[str, Any] = {
    "float": Coordinate, "ArrayLike": Coordinates, "int": int, "bool": bool, "str": str,
}  # fmt: skip
_OF_KEY: dict[str, Any] = {
    "wavelength": Length, "frequency": Frequency, "sll": Decibels, "window": str | list[str],
    "counts": list[int], "amplitudes": list[Complex],
    "frequencies": list[float | list[float]],
}  # fmt: skip
# Parameters whose values follow from other tables.
_FROM_CONTEXT = ("dimension", "positions", "shape")

_FUNCTIONS: dict[type, Callable[..., Any]] = {}


def _union_of(functions: Mapping[str, Callable[..., Any]], base: type = Kind) -> Any:
    """Return the union of table types, one for each function, with its parameters as keys."""
    tables = []
    for name, function in functions.items():
        fields: list[Any] = []
        for key, parameter in inspect.signature(function).parameters.items():
            annotation, _, null = parameter.annotation.partition(" | ")
            if key == "direction":
                fields += [("theta", Angle), ("phi", Angle, 0.0)]
            elif key not in _FROM_CONTEXT:
                kind = _OF_KEY.get(key) or _OF_ANNOTATION[annotation]
                has_default = parameter.default is not parameter.empty
                is_optional = has_default or null or key == "wavelength"
                default = parameter.default if has_default else None
                fields.append((key, kind | None, default) if is_optional else (key, kind))
        tables.append(msgspec.defstruct(name, fields, bases=(base,), tag=name, kw_only=True))
        _FUNCTIONS[tables[-1]] = function
    return functools.reduce(operator.or_, tables)


def _row_positions(count: int, pitch: float) -> NDArray[np.float64]:
    """Return the positions (count, 1) in m of slits in a row, centred at 0."""
    return arrays.grid_positions(count, 1, pitch)[:, :1]


FieldTable = _union_of({
    "uniform": tapers.uniform, "steering": tapers.steering, "waves": Illumination,
    "cosine_taper": tapers.cosine_taper, "taylor_taper": tapers.taylor_taper,
    "te_mode": tapers.te_mode,
})  # fmt: skip
LayoutTable = _union_of({
    "row": _row_positions, "grid": arrays.grid_positions, "triangular": arrays.triangular_positions,
    "rings": arrays.ring_positions,
})  # fmt: skip
WeightTable = _union_of({
    "window": arrays.window_weights, "steering": arrays.steering_weights,
    "focusing": arrays.focusing_weights,
})  # fmt: skip
ShapeTable = _union_of({name: getattr(shapes, name) for name in shapes.__all__}, _Shape)


def call_table(
    table: Any, wavelength: float | None = None, layout: Any = None, **context: Any
) -> Any:
    """Return the result of the function that a table specifies, called with the table's values.

    ``wavelength``: default in m. ``layout``: table of the positions, required by windows.
    ``context``: further arguments, which are passed if the function accepts them.
    """
    function, values = _FUNCTIONS[type(table)], msgspec.structs.asdict(table)
    parameters = inspect.signature(function).parameters
    if "wavelength" in values:
        given = quantities.parse_wavelength(values.pop("frequency"), values["wavelength"])
        values["wavelength"] = required_wavelength(wavelength if given is None else given)
    if "theta" in values:
        direction = tapers.direction_of(values.pop("theta"), values.pop("phi"))
        values["direction"] = direction[: context["dimension"]]
    if "shape" in parameters:
        counts = (getattr(layout, key, None) for key in ("count", "nx", "ny"))
        values["shape"] = [count for count in counts if isinstance(count, int)]
        if not values["shape"]:
            raise FileFormatError(
                "a window requires positions of the kind row, grid or triangular, got another "
                "kind; omit the window"
            )
    return function(**values, **{key: value for key, value in context.items() if key in parameters})


def product_of(tables: Any, wavelength: float | None, **context: Any) -> Any:
    """Return the product of the fields or weights that one or several tables describe."""
    factors = (call_table(table, wavelength, **context) for table in _as_list(tables))
    return functools.reduce(operator.mul, factors)


SOURCE_TEXTS = ("taper", "array", "window", "steering", "focus", "curved", "coherence")
"""Names of the short strings that :func:`apply_texts` accepts."""

_SIDELOBES = r"(?: +(?P<sll>[\d.]+) *dB(?: +(?P<nbar>\d{1,3}))?)?"
_AXIS = r"(?: +(?P<axis>[xy]))?"
_LATTICE = r"(?P<nx>\d{1,7}) *[x×] *(?P<ny>\d{1,7}) *,(?P<pitch_x>[^,]+)(?:,(?P<pitch_y>[^,]+))?"

_PATTERNS: dict[str, dict[str, str]] = {
    "taper": {
        "cosine_taper": r"cosine(?: *(?P<power>\d{1,2}))?" + _AXIS,
        "taylor_taper": "taylor" + _SIDELOBES + _AXIS,
        "te_mode": r"te(?P<m>\d)(?P<n>\d)",
    },
    "array": {"grid": _LATTICE, "triangular": "triangular +" + _LATTICE},
    "window": {"window": "(?P<window>[a-z]+)" + _SIDELOBES},
}
_EXPECTED = {
    "taper": 'a taper such as "cosine", "cosine 2 x", "te10", "taylor 30 dB"',
    "array": 'an array such as "12 x 16, 2 mm" or "triangular 12 x 16, 2 mm, 1.9 mm"',
    "window": 'a window such as "taylor 25 dB" or "hamming"',
}


def _table_of_text(name: str, text: str) -> dict[str, Any]:
    """Return the table that is equivalent to a short string of the kind ``name``.

    Raises QuantityError for other text.
    """
    if name == "steering":
        return {"kind": name, **dict(zip(("theta", "phi"), parse_direction(text), strict=True))}
    if name == "focus":
        return {"kind": "focusing", "point": _split_at_commas(text)}
    written = text.strip() if name == "array" else text.strip().lower()
    for kind, pattern in _PATTERNS[name].items():
        match = re.fullmatch(pattern, written, re.IGNORECASE)
        if match is not None:
            groups = match.groupdict().items()
            return {"kind": kind, **{key: value for key, value in groups if value is not None}}
    raise QuantityError(f"expected {_EXPECTED[name]}, got {value_text(text)}")


def _split_at_commas(text: str) -> list[Any]:
    """Return the parts of a text between commas, without surrounding blanks."""
    return [part.strip() for part in text.split(",")]


def apply_texts(source: Any, texts: Mapping[str, str], wavelength: float | None) -> Any:
    """Apply the short strings for field, layout, weights and wave to a source.

    ``texts``: strings with their names, as in :data:`SOURCE_TEXTS`; docs/source_files.md describes
    the grammar. Without a unit, lengths are in metres and angles are in radians. ``wavelength`` in
    m is needed for steering, focus and curved waves. Errors begin with the name of the string.
    """
    for name in SOURCE_TEXTS:
        if name in texts:
            with at_key(name):
                source = _with_text(source, name, texts, wavelength)
    return source


def _with_text(source: Any, name: str, texts: Mapping[str, str], wavelength: float | None) -> Any:
    """Return a source to which the short string ``texts[name]`` is applied.

    Windows also use the layout ``texts["array"]``, if present.
    """
    text = texts[name]
    if name in ("curved", "coherence"):
        expected = "an aperture, slits or an array for this option"
        checked_type(source, expected, Aperture, Slits, Array, Wavefront)
        if name == "coherence":
            return source.partially_coherent(quantities.parse_length(text))
        low, high = np.reshape(source.bounds, (2, -1))
        radii = converted(_split_at_commas(text), Radii)
        return source.curved(radii, required_wavelength(wavelength), (low + high) / 2)
    table = _table_of_text(name, text)
    if name in ("taper", "array"):
        checked_type(source, "an aperture for this option", Aperture)
        if name == "taper":
            return _tapered(source, table)
        return phased_array(source, call_table(converted(table, LayoutTable, strict=False)))
    if name == "steering" and isinstance(source, Aperture):
        return _with_factor(
            source, call_table(converted(table, FieldTable), wavelength, dimension=2)
        )
    if not isinstance(source, Array) or source.repeated is None:
        raise ArgumentError(
            "expected an array of identical elements with a flat wave, got "
            f"{type(source).__name__}; specify array as well, or define the array in the source "
            "file"
        )
    layout = None
    if "array" in texts:
        layout = converted(_table_of_text("array", texts["array"]), LayoutTable, strict=False)
    element, positions = source.repeated
    weights = converted(table, WeightTable, strict=False)
    factor = call_table(weights, wavelength, layout, positions=positions, dimension=2)
    return repeated_element(element, positions, source.weights * factor)


def _tapered(aperture: Aperture, table: dict[str, Any]) -> Aperture:
    """Return an aperture whose field is multiplied by the taper of a table.

    The taper spans the bounding box of the aperture.
    """
    xmin, ymin, xmax, ymax = aperture.bounds
    sizes = {"width": xmax - xmin, "height": ymax - ymin}
    axis = table.pop("axis", None)
    if axis is not None:
        del sizes["height" if axis == "x" else "width"]
    if table.get("m") == "0":
        table["component"] = "x"
    field = call_table(converted(table | sizes, FieldTable, strict=False), dimension=2)
    return _with_factor(aperture, field.moved(aperture.centre))


def _with_factor(aperture: Aperture, field: Illumination) -> Aperture:
    """Return an aperture whose field is multiplied by another field."""
    other: Any = aperture.illumination
    return aperture.with_illumination(field if other is None else other * field)


def parse_direction(text: str) -> tuple[float, float]:
    """Parse "20 deg" or "20 deg, 90 deg" to theta >= 0 and phi in rad.

    Raises QuantityError for other text. By default phi is 0. A negative theta becomes positive, and
    phi is rotated by pi.
    """
    theta, *phi = map(quantities.parse_angle, _split_at_commas(text))
    # The condition also rejects degrees without a unit.
    if len(phi) > 1 or not abs(theta) < math.pi / 2:
        raise QuantityError(
            'expected a direction such as "20 deg" or "20 deg, 90 deg", within 90 deg of the '
            f"normal, got {value_text(text)}; write the unit deg after each angle in degrees"
        )
    if theta == 0:
        return 0.0, 0.0
    return abs(theta), (sum(phi) + (math.pi if theta < 0 else 0.0)) % (2 * math.pi)
